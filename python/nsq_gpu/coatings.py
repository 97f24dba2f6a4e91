"""Coatings that Optiland's non-sequential engine lacks: by the angle of incidence, as thin films have them.

>>> film = TabulatedCoating.from_coating(optilands_thin_film, wavelengths=[0.486, 0.588, 0.656])
>>> scene.add_lens("L1", frame, LensConfig(..., front=SurfaceConfig(coating=film)))

Optiland's NumpyBackend and TorchBackend know reflectances that are one number; on those a TabulatedCoating raises.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NoReturn

import numpy as np
import optiland.backend as be
from optiland.coatings import BaseCoating, FresnelCoating, SimpleCoating, ThinFilmCoating
from optiland.thin_film import ThinFilmStack

from nsq_gpu.errors import UnsupportedSceneError, without_gradient

#: Intervals of the cosine to begin with, before those are halved in which a straight line is not good enough.
_FIRST = 64
#: Halving ends at intervals of the cosine that are so narrow; the tracer wants steps of 1e-6.
_NARROWEST = 4e-6
#: Most angles of a table.
_MOST = 8192
#: R + T may exceed 1 by so much, by the glass's own absorption and rounding.
_EXCESS = 1e-6
#: A medium with a larger extinction coefficient absorbs within micrometres.
_OPAQUE = 1e-3

_KEYS = ("R", "T", "R_back", "T_back")


class TabulatedCoating(BaseCoating):
    """A coating by wavelength and angle of incidence, averaged over polarisation.

    Values are linear in the cosine of the angle between the table's angles. What R and T leave of 1 is absorbed, and
    booked as the coating's loss. Where reflection is total, R + T is reflected.

    Args:
        wavelengths_um: Wavelengths [um], shape (W,); all that the scene's sources emit, since they are not interpolated.
        angles_deg: Angles of incidence [deg], each in the medium that light comes from, ascending from 0 to 90; shape (A,).
        R: Reflectance of light from the front medium, shape (W, A).
        T: Transmittance of light from the front medium, shape (W, A).
        R_back: Reflectance of light from the back medium, shape (W, A).
        T_back: Transmittance of light from the back medium, shape (W, A).

    Raises:
        ValueError: A shape is wrong, or a number is out of range.
    """

    def __init__(self, wavelengths_um: Sequence[float], angles_deg: Sequence[float], R: Any, T: Any, R_back: Any,  # noqa: N803
                 T_back: Any) -> None:  # noqa: N803
        self.wavelengths_um = _array("wavelengths_um", wavelengths_um)
        self.angles_deg = _array("angles_deg", angles_deg)
        if not len(self.wavelengths_um) or len(np.unique(self.wavelengths_um)) < len(self.wavelengths_um):
            raise ValueError("wavelengths_um: give each wavelength once")
        if len(self.angles_deg) < 2 or self.angles_deg[0] != 0.0 or self.angles_deg[-1] != 90.0 or (np.diff(self.angles_deg) <= 0).any():
            raise ValueError("angles_deg: give ascending angles from 0 to 90, both included")
        shape = (len(self.wavelengths_um), len(self.angles_deg))
        self.R, self.T, self.R_back, self.T_back = (
            _array(key, values, shape) for key, values in zip(_KEYS, (R, T, R_back, T_back), strict=True))
        for r, t in (("R", "T"), ("R_back", "T_back")):
            if (getattr(self, r) + getattr(self, t) > 1.0 + 1e-12).any():
                raise ValueError(f"{r} + {t} exceeds 1: the coating gives more light than it gets")

    @classmethod
    def from_coating(cls, coating: BaseCoating, wavelengths: Sequence[float], *, error: float = 1e-5) -> TabulatedCoating:
        """Return a table of one of Optiland's coatings, from Optiland's own numbers.

        Where the second medium absorbs (k > 1e-3, such as a metal), no light comes from there: R_back and T_back are 0.

        Args:
            coating: A ThinFilmCoating, a FresnelCoating or a SimpleCoating. Its first medium is the table's front.
            wavelengths: Wavelengths [um]: all that the scene's sources emit.
            error: The largest error of R and T by interpolation. Next to a critical angle, in an interval of the cosine of
                4e-6, R and T are steeper than any table: there the error is up to about 0.005.

        Raises:
            UnsupportedSceneError: It is another coating, or too thick for a table of 8192 angles.
        """
        lines = _array("wavelengths", wavelengths)
        if not error > 0.0:
            raise ValueError(f"error is {error}; give a number above 0, such as 1e-5")
        if not len(lines) or not (lines > 0.0).all():
            raise ValueError("wavelengths: give those that the scene's sources emit, in um and above 0")
        if isinstance(coating, SimpleCoating):
            shares = {"reflectance": coating.reflectance, "transmittance": coating.transmittance}
            r, t = (np.full((len(lines), 2), float(without_gradient(name, value))) for name, value in shares.items())
            return cls(lines, [0.0, 90.0], r, t, r, t)
        if not isinstance(coating, FresnelCoating | ThinFilmCoating):
            raise UnsupportedSceneError(f"a {type(coating).__name__} cannot be tabulated; a ThinFilmCoating, a FresnelCoating and a "
                                        "SimpleCoating can")
        values = _values_of(_stack_of(coating), lines)
        cosines = _refined(values, _critical(coating, lines), error)
        found = values(cosines)
        # The tracer's table ascends in the angle.
        angles = np.degrees(np.arccos(cosines[::-1]))
        angles[0], angles[-1] = 0.0, 90.0
        return cls(lines, angles, *(column[:, ::-1] for column in found))

    def reversed(self) -> TabulatedCoating:
        """Return the coating as it is where front and back change places."""
        return TabulatedCoating(self.wavelengths_um, self.angles_deg, self.R_back, self.T_back, self.R, self.T)

    def at(self, wavelength_um: float, angles_deg: Any) -> dict[str, np.ndarray]:
        """Return R, T, R_back and T_back at a wavelength of the table [um], interpolated to angles [deg]."""
        found = np.flatnonzero(self.wavelengths_um == wavelength_um)
        if not len(found):
            raise ValueError(f"the table has no value at {wavelength_um} um, but at {self.wavelengths_um.tolist()}")
        cosines, wanted = _cosines(self.angles_deg)[::-1], _cosines(np.asarray(angles_deg, dtype=float))
        return {key: np.interp(wanted, cosines, getattr(self, key)[found[0], ::-1]) for key in _KEYS}

    def numbers(self) -> tuple[Any, ...]:
        """Return all its numbers, for comparison."""
        return tuple(getattr(self, key).tobytes() for key in ("wavelengths_um", "angles_deg", *_KEYS))

    def to_dict(self) -> dict[str, Any]:
        """Return the coating for Optiland's files."""
        return {"type": type(self).__name__, "wavelengths_um": self.wavelengths_um.tolist(), "angles_deg": self.angles_deg.tolist(),
                **{key: getattr(self, key).tolist() for key in _KEYS}}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TabulatedCoating:
        """Return the coating of a file."""
        return cls(**{key: value for key, value in data.items() if key != "type"})

    @property
    def reflectance(self) -> NoReturn:
        """Raise: Optiland's tracers read one number here, and there is none."""
        raise UnsupportedSceneError("Optiland's backends know no coating by angle: trace a scene with a TabulatedCoating by "
                                    "nsq_gpu.NsqGpuBackend, or give a SimpleCoating")

    transmittance = reflectance

    def reflect(self, rays: Any, nx: Any = None, ny: Any = None, nz: Any = None) -> NoReturn:
        """Raise: the coating is for scenes."""
        return self.reflectance

    def transmit(self, rays: Any, nx: Any = None, ny: Any = None, nz: Any = None) -> NoReturn:
        """Raise: the coating is for scenes."""
        return self.reflectance


def _array(name: str, values: Any, shape: tuple[int, ...] | None = None) -> np.ndarray:
    array = np.array(values, dtype=np.float64)
    if array.ndim != (1 if shape is None else len(shape)) or (shape is not None and array.shape != shape):
        raise ValueError(f"{name} has the shape {array.shape}, not {'(N,)' if shape is None else shape}")
    highest = np.inf if shape is None else 1.0
    if not np.isfinite(array).all() or (array < 0.0).any() or (array > highest).any():
        raise ValueError(f"{name}: a number is not finite, negative or too large")
    return array


def _cosines(angles_deg: np.ndarray) -> np.ndarray:
    return np.where(angles_deg == 90.0, 0.0, np.cos(np.radians(angles_deg)))


def _stack_of(coating: FresnelCoating | ThinFilmCoating) -> ThinFilmStack:
    """Return the layers between the coating's own media: on a mirror Optiland gives the stack the air before it as substrate."""
    stack = ThinFilmStack(coating.material_pre, coating.material_post)
    if isinstance(coating, ThinFilmCoating):
        stack.layers = list(coating.stack.layers)
    return stack


class _Entry:
    """The medium before a stack, without the little that glass absorbs: the reflected and the incident wave would mix there,
    and R + T exceed 1."""

    def __init__(self, material: Any) -> None:
        self.n = material.n
        self._calculate_n = material._calculate_n

    def k(self, wavelength: Any) -> Any:
        return be.zeros_like(be.array(wavelength))

    _calculate_k = k


class _Exit:
    """The medium behind a stack, with a trace of absorption.

    Where reflection is total, Optiland takes the root of a negative number for the medium behind. Without absorption that
    root is the wave that grows (`_snell_cos` of thin_film/core.py), and R of a film that absorbs is wrong.
    """

    _TRACE = 1e-30

    def __init__(self, material: Any) -> None:
        self._material = material
        self.n = material.n
        self._calculate_n = material._calculate_n

    def k(self, wavelength: Any) -> Any:
        return self._material.k(wavelength) + self._TRACE

    def _calculate_k(self, wavelength: Any) -> Any:
        return self._material._calculate_k(wavelength) + self._TRACE


def _values_of(stack: ThinFilmStack, lines: np.ndarray) -> Callable[[np.ndarray], list[np.ndarray]]:
    """Return what gives R and T from the front, then from the back, at cosines: each of shape (W, A)."""
    ends = (stack.incident_material, stack.substrate_material)
    ways = [ThinFilmStack(_Entry(ends[0]), _Exit(ends[1])), ThinFilmStack(_Entry(ends[1]), _Exit(ends[0]))]
    ways[0].layers, ways[1].layers = stack.layers, list(reversed(stack.layers))
    absorbs = [float(np.max(be.to_numpy(material.k(be.array(lines))))) > _OPAQUE for material in ends]

    def values(cosines: np.ndarray) -> list[np.ndarray]:
        found = []
        for way, comes_from_none in zip(ways, absorbs, strict=True):
            if comes_from_none:
                found += [np.zeros((len(lines), len(cosines)))] * 2
                continue
            # At a right angle all is reflected; there the matrices divide by zero.
            angles = np.arccos(np.where(cosines == 0.0, 0.5, cosines))
            numbers = way.compute_rtRTA(be.array(lines), be.array(angles), "u")
            r, t = (np.where(cosines == 0.0, grazing, np.real(be.to_numpy(numbers[key])))
                    for key, grazing in (("R", 1.0), ("T", 0.0)))
            total = float((r + t).max())
            if not total <= 1.0 + _EXCESS or min(r.min(), t.min()) < -_EXCESS:
                raise UnsupportedSceneError(f"the stack gives R + T = {total}, not 1 or less: one of its materials amplifies")
            r = np.clip(r, 0.0, 1.0)
            found += [r, np.clip(t, 0.0, 1.0 - r)]
        return found

    return values


def _critical(coating: FresnelCoating | ThinFilmCoating, lines: np.ndarray) -> list[float]:
    """Return cosines just beyond the critical angles, at which R and T are not smooth, and the matrices divide by zero."""
    n_front, n_back = (np.broadcast_to(be.to_numpy(material.n(be.array(lines))).astype(float).ravel(), lines.shape)
                       for material in (coating.material_pre, coating.material_post))
    sines = np.minimum(n_front, n_back) / np.maximum(n_front, n_back)
    return [float(cosine) * (1.0 - 1e-12) for cosine in np.sqrt(1.0 - sines * sines) if cosine > 0.0]


def _refined(values: Callable[[np.ndarray], list[np.ndarray]], kinks: list[float], error: float) -> np.ndarray:
    """Return cosines from 0 to 1 between which R and T are straight lines to this error."""
    knots = np.unique(np.concatenate([np.linspace(0.0, 1.0, _FIRST + 1), kinks]))
    knots = knots[np.concatenate([[True], np.diff(knots) > _NARROWEST])]
    knots[-1] = 1.0
    while True:
        widths = np.diff(knots)
        at_knots = np.stack(values(knots))
        bad = np.zeros(len(widths), dtype=bool)
        for part in (0.25, 0.5, 0.75):
            line = (1.0 - part) * at_knots[..., :-1] + part * at_knots[..., 1:]
            bad |= (np.abs(np.stack(values(knots[:-1] + part * widths)) - line) > error).any(axis=(0, 1))
        bad &= widths > 2.0 * _NARROWEST
        if not bad.any():
            return knots
        if len(knots) + bad.sum() > _MOST:
            raise UnsupportedSceneError(f"the coating needs more than {_MOST} angles for an error of {error}; give a larger error")
        knots = np.sort(np.concatenate([knots, (knots[:-1] + 0.5 * widths)[bad]]))
