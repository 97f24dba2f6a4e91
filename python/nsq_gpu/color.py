"""The colour of what detectors saw, from X, Y and Z: chromaticity, colour temperature and pictures, with errors.

The observer is CIE 1931, of 2 degrees. Chromaticities are as in CIE 015:2018, sections 7.3 and 8.1. The program's
twin is ``src/result/color.rs``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nsq_gpu.arguments import missing, near
from nsq_gpu.errors import UsageError

if TYPE_CHECKING:
    from nsq_gpu.export import ExportedScene

Json = dict[str, Any]

#: What a call takes as ``color``: True of all detectors that can see it, or names.
ColorOf = bool | Iterable[str] | None

#: The key of a detector that sees colour, in a scene file and as an attribute of a live one, and its value.
KEY, SPACE = "color", "xyz"
#: Kinds of detectors that can see colour, and the unit of their X, Y and Z.
UNITS = {"irradiance": "lx", "far_field": "cd"}
WHO = "irradiance and far-field detectors see colour"
#: Names of X, Y and Z, and of the pairs of which covariances are known.
PARTS, PAIRS = ("X", "Y", "Z"), ("XY", "XZ", "YZ")
#: Curves over the polar angle, and what their axis says.
_CURVES = {"delta_uv": "Δu'v' from the middle", "cct": "CCT [K]", "duv": "Duv"}
#: A pixel that fewer rays hit has no error of its colour: a single ray has one colour, whatever the others have.
_FEW = 10
#: Light that is further from the Planckian curve, in u and v of CIE 1960, has no colour temperature: CIE 015:2018, section 9.5.
_MOST_DUV = 0.05
#: Colour temperatures that the search covers [K].
_TEMPERATURES = (1000.0, 100_000.0)
#: Step of u and v by which colour temperatures are differentiated, and chromaticities that are searched at once.
_STEP, _AT_ONCE = 1e-4, 4096
#: Linear sRGB of X, Y and Z, where white has Y = 1: IEC 61966-2-1.
_SRGB = np.array([[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]])


# What sees colour


def checked(color: ColorOf, photometric: bool | None = None) -> bool | tuple[str, ...] | None:
    """Return which detectors see colour.

    Raises:
        UsageError: They are given in another form, or lumens are refused.
    """
    if color is None or isinstance(color, bool):
        found: bool | tuple[str, ...] | None = color
    else:
        try:
            names = () if isinstance(color, str) else tuple(color)
        except TypeError:
            names = ()
        if isinstance(color, str) or not all(isinstance(name, str) for name in names) or not hasattr(color, "__iter__"):
            example = color if isinstance(color, str) and color != SPACE else "wall"
            raise UsageError(f"color is {color!r}; give True, or a list of names of detectors, such as [{example!r}]")
        found = names
    if found and photometric is False:
        raise UsageError("photometric is False, and color needs lumens; leave one of them out")
    return found


def colored(exported: ExportedScene, color: ColorOf) -> ExportedScene:
    """Return an exported scene in which these detectors see colour, and no others; None leaves the scene's own.

    Raises:
        UsageError: No such detector can see colour.
    """
    color = checked(color)
    if color is None:
        return exported
    entries = exported.document["detectors"]
    kinds = {entry["name"]: entry["type"] for entry in entries}
    able = [name for name, kind in kinds.items() if kind in UNITS]
    if color and not able:
        raise UsageError(f"color is {color!r}, and the scene has no irradiance and no far-field detector")
    names = tuple(able) if color is True else color or ()
    for name in names:
        if name not in kinds:
            raise UsageError(f"color names the detector {name!r}, which the scene has not; {near(name, able)}")
        if name not in able:
            raise UsageError(f"color names {name!r}, which is of the kind {kinds[name]}; {WHO}")
    seeing = [{**{key: value for key, value in entry.items() if key != KEY}, **({KEY: SPACE} if entry["name"] in names else {})}
              for entry in entries]
    return replace(exported, document={**exported.document, "detectors": seeing})


# Colours


@dataclass(frozen=True)
class Chromaticity:
    """Chromaticities: of each pixel, in the shape of its map, or of all light. Dark pixels have NaN."""

    #: X / (X + Y + Z) and Y / (X + Y + Z), of the diagram of CIE 1931.
    x: Any
    y: Any
    #: 4 X / (X + 15 Y + 3 Z) and 9 Y / (X + 15 Y + 3 Z), of the diagram of CIE 1976.
    u_prime: Any
    v_prime: Any
    #: Standard errors of the four, one behind the other; None if they are not known. NaN of a pixel with fewer than ten rays.
    standard_error: np.ndarray | None


@dataclass(frozen=True)
class ColorTemperature:
    """Correlated colour temperatures; NaN of light that is further than 0.05 from the Planckian curve."""

    #: Correlated colour temperature [K].
    cct: Any
    #: Distance from the Planckian curve in u and v of CIE 1960: above it, towards green, it is positive.
    duv: Any
    #: Standard errors; None if they are not known.
    cct_standard_error: Any
    duv_standard_error: Any


@dataclass(frozen=True)
class ColorOverAngle:
    """How far the colour of a far field is from that in its middle, by polar angle."""

    #: Polar angles [deg].
    theta: np.ndarray
    #: Distance in u' and v' from the middle, of the mean over all azimuths.
    delta_uv: np.ndarray
    #: Its standard error; None if it is not known.
    standard_error: np.ndarray | None
    #: The distance that noise alone gives, as a root of the mean square. A distance up to it says nothing.
    noise: np.ndarray | None
    #: Colour of the mean over all azimuths, by polar angle.
    chromaticity: Chromaticity
    #: Covariances of u' and v', (n_theta, 2, 2); None if they are not known.
    _covariance: np.ndarray | None = field(repr=False)

    def cct(self) -> ColorTemperature:
        """Return the correlated colour temperature of the mean over all azimuths and its Duv, by polar angle.

        Raises:
            MissingLibraryError: colour-science is not installed (``pip install 'nsq-gpu[color]'``).
        """
        return _color_temperature(self.chromaticity, self._covariance)


class Color:
    """The colour of what a detector saw. Detectors of a result have its methods."""

    def __init__(self, name: str, report: Json, arrays: dict[str, np.ndarray]) -> None:
        self._name = name
        self._kind = report["detectors"][name]["kind"]
        seen = ((report.get("photometry") or {}).get("detectors") or {}).get(name) or {}
        self._of_all: Json = seen.get("color") or {}
        self._arrays = arrays
        #: X, Y and Z in the shape of the map, one behind the other [lx], of a far field [cd]; None if colour is not known.
        self.xyz = np.stack([arrays[part] for part in PARTS]) if "X" in arrays else None
        #: Their standard errors, and the covariances of X and Y, X and Z, Y and Z [lx^2] or [cd^2]; None if they are not known.
        self.xyz_standard_error = arrays.get("standard_error_XYZ")
        self.xyz_covariance = arrays.get("covariance_XYZ")

    def chromaticity(self, whole: bool = False) -> Chromaticity:
        """Return the chromaticity of each pixel, or of all light, with standard errors to first order.

        Args:
            whole: True returns the chromaticity of all light, as the report has it. Its errors assume that light of one wavelength
                arrives equally well from every source. Errors of pixels assume nothing.

        Raises:
            UsageError: The detector saw no colour.
        """
        xyz = self._known()
        if whole:
            found = self._of_all.get("chromaticity")
            if found is None:
                return Chromaticity(*[np.nan] * 4, standard_error=None)
            errors = found["standard_error"]
            values = (found[key] for key in ("x", "y", "u_prime", "v_prime"))
            return Chromaticity(*values, standard_error=None if errors is None else np.array(errors))
        values, gradients = _chromaticities(xyz)
        covariance = self._covariance()
        if covariance is None:
            return Chromaticity(*values, standard_error=None)
        variances = np.einsum("ki...,ij...,kj...->k...", gradients, covariance, gradients)
        return Chromaticity(*values, standard_error=self._where_enough(np.sqrt(np.maximum(variances, 0.0))))

    def cct(self, whole: bool = False) -> ColorTemperature:
        """Return the correlated colour temperature of each pixel, or of all light, and its Duv, by Ohno's method of 2013.

        A map of 256 x 256 pixels takes about a minute.

        Args:
            whole: True returns the temperature of all light, with errors as in ``chromaticity(whole=True)``.

        Raises:
            UsageError: The detector saw no colour.
            MissingLibraryError: colour-science is not installed (``pip install 'nsq-gpu[color]'``).
        """
        known = self.chromaticity(whole)
        covariance = None
        if known.standard_error is not None:
            if whole:
                covariance = _covariance_of(known)
            else:
                _, by_xyz = _chromaticities(self._known())
                covariance = np.einsum("ki...,ij...,lj...->...kl", by_xyz[2:], self._covariance(), by_xyz[2:])
        found = _color_temperature(known, covariance)
        if whole:
            errors = (None if error is None else float(error) for error in (found.cct_standard_error, found.duv_standard_error))
            return ColorTemperature(float(found.cct), float(found.duv), *errors)
        if covariance is None:
            return found
        return ColorTemperature(found.cct, found.duv, self._where_enough(found.cct_standard_error),
                                self._where_enough(found.duv_standard_error))

    def srgb(self, white: float | None = None) -> np.ndarray:
        """Return the map as a picture in sRGB: numbers from 0 to 1, shape (ny, nx, 3); of a far field (n_theta, n_phi, 3).

        Hues outside sRGB, such as light of a single wavelength, are shown without what is negative. Light that is too bright for
        its hue becomes the brightest of this hue.

        Args:
            white: Y that is shown as white [lx], of a far field [cd]. None takes the largest of the map.

        Raises:
            UsageError: The detector saw no colour, or ``white`` is not positive.
        """
        return _srgb(self._known(), white)

    def plot_color(self, *, white: float | None = None, smooth: bool = True, ax: Any = None, **options: Any) -> Any:
        """Draw the map in its colours.

        Args:
            white: As in ``srgb``.
            smooth: A far field is drawn in cells of about equal solid angle, as ``result.plot`` draws it.
            ax: Matplotlib's axes; a far field's are polar. None makes a figure.
            options: Further options of ``imshow`` or ``pcolormesh``.

        Returns:
            The axes.

        Raises:
            UsageError: The detector saw no colour, or ``white`` is not positive.
        """
        from nsq_gpu.plotting import _PARTS, _axes, _edges, in_equal_solid_angles

        xyz = self._known()
        if self._kind == "far_field":
            theta, phi = self._arrays["theta"], self._arrays["phi"]
            image = _srgb(np.stack([in_equal_solid_angles(part, theta) for part in xyz]) if smooth else xyz, white)
            ax = _axes(ax, projection="polar")
            parts = max(_PARTS // len(phi), 1)
            corners = np.meshgrid(np.deg2rad(np.linspace(*_edges(phi), parts * len(phi) + 1)),
                                  np.linspace(*_edges(theta), len(theta) + 1))
            ax.pcolormesh(*corners, image.repeat(parts, axis=1), **options)
            ax.grid(False)
            ax.set_xlabel("theta [deg] outwards, phi [deg] around")
        else:
            image = _srgb(xyz, white)
            ax = _axes(ax)
            extent = (*_edges(self._arrays["x_coords"]), *_edges(self._arrays["y_coords"]))
            ax.imshow(image, **{"origin": "lower", "extent": extent, "interpolation": "nearest", **options})
            ax.set_xlabel("x [mm]")
            ax.set_ylabel("y [mm]")
        of_all = self.chromaticity(whole=True)
        ax.set_title(f"{self._name}: x {of_all.x:.4f}, y {of_all.y:.4f}")
        return ax

    def color_over_angle(self, middle: float = 5.0) -> ColorOverAngle:
        """Return how far the colour of a far field is from that in its middle, by polar angle.

        Args:
            middle: The middle is what lies within this angle [deg], but at least the first ring.

        Raises:
            UsageError: The detector is no far field, or saw no colour.
        """
        xyz = self._known()
        if self._kind != "far_field":
            raise UsageError(f"{self._name!r} has no angles: it is of the kind {self._kind}, and no far field")
        theta, covariance = self._arrays["theta"], self._covariance()
        rings = xyz.mean(axis=-1)
        weights = np.where(theta <= max(float(middle), theta[0]), np.sin(np.deg2rad(theta)), 0.0)
        weights /= weights.sum()
        values, by_xyz = _chromaticities(rings)
        of_middle, by_middle = _chromaticities((rings * weights).sum(axis=-1))
        apart = values[2:] - of_middle[2:, None]
        delta = np.sqrt((apart**2).sum(axis=0))
        if covariance is None:
            return ColorOverAngle(theta, delta, None, None, Chromaticity(*values, standard_error=None), None)
        # A ray lights one cell, so that cells have errors of their own. A ring of the middle has a share of the middle's.
        of_rings = covariance.sum(axis=-1) / xyz.shape[-1] ** 2
        of_colors = np.einsum("kit,ijt,ljt->klt", by_xyz, of_rings, by_xyz)
        by_xyz, by_middle = by_xyz[2:], by_middle[2:]
        shared = np.einsum("kit,ijt,lj->klt", by_xyz, of_rings * weights, by_middle)
        variances = (of_colors[2:, 2:] - shared - shared.swapaxes(0, 1)
                     + (by_middle @ (of_rings * weights**2).sum(axis=-1) @ by_middle.T)[..., None])
        noise = np.sqrt(np.maximum(np.trace(variances), 0.0))
        along = apart / np.where(delta > 0.0, delta, 1.0)
        error = np.sqrt(np.maximum(np.einsum("kt,klt,lt->t", along, variances, along), 0.0))
        few = self._arrays["hits"].sum(axis=-1) < _FEW
        errors = np.sqrt(np.maximum(np.einsum("kkt->kt", of_colors), 0.0))
        return ColorOverAngle(theta, delta, np.where(few, np.nan, error), np.where(few, np.nan, noise),
                              Chromaticity(*values, standard_error=np.where(few, np.nan, errors)),
                              np.where(few[:, None, None], np.nan, np.moveaxis(of_colors[2:, 2:], -1, 0)))

    def plot_color_over_angle(self, middle: float = 5.0, *, of: str = "delta_uv", ax: Any = None, **options: Any) -> Any:
        """Draw :meth:`color_over_angle`: a band has the standard error, and a dotted line what noise alone gives.

        Args:
            middle: As in :meth:`color_over_angle`.
            of: ``"delta_uv"``, the distance from the middle in u' and v'; or ``"cct"`` or ``"duv"``, by polar angle.
            ax: Matplotlib's axes. None makes a figure.
            options: Further options of ``plot``.

        Returns:
            The axes.

        Raises:
            UsageError: The detector is no far field, saw no colour, or has no such curve.
            MissingLibraryError: ``"cct"`` and ``"duv"`` need colour-science (``pip install 'nsq-gpu[color]'``).
        """
        from nsq_gpu.plotting import _axes

        if not isinstance(of, str) or of not in _CURVES:
            raise UsageError(f"of is {of!r}; give {', '.join(map(repr, list(_CURVES)[:-1]))} or {list(_CURVES)[-1]!r}")
        found = self.color_over_angle(middle)
        values, error, least = found.delta_uv, found.standard_error, 0.0
        if of != "delta_uv":
            temperature = found.cct()
            values, error, least = getattr(temperature, of), getattr(temperature, f"{of}_standard_error"), -np.inf
        ax = _axes(ax)
        (line,) = ax.plot(found.theta, values, **options)
        if error is not None:
            ax.fill_between(found.theta, np.maximum(values - error, least), values + error, color=line.get_color(), alpha=0.3,
                            linewidth=0.0)
            if of == "delta_uv":
                ax.plot(found.theta, found.noise, ":", color=line.get_color(), label="noise alone")
                ax.legend()
        ax.set_xlabel("theta [deg]")
        ax.set_ylabel(_CURVES[of])
        ax.set_title(self._name)
        return ax

    def _known(self) -> np.ndarray:
        if self.xyz is None and self._kind not in UNITS:
            raise UsageError(f"{self._name!r} is of the kind {self._kind}; {WHO}")
        if self.xyz is None:
            raise UsageError(f"the colour of {self._name!r} is not known; trace with color=True, or color=[{self._name!r}]")
        return self.xyz

    def _covariance(self) -> np.ndarray | None:
        """Return covariances of X, Y and Z, (3, 3, ...); None if they are not known."""
        if self.xyz_standard_error is None or self.xyz_covariance is None:
            return None
        found = np.empty((3, *self.xyz_standard_error.shape))
        for i in range(3):
            found[i, i] = self.xyz_standard_error[i] ** 2
        for (i, j), between in zip(((0, 1), (0, 2), (1, 2)), self.xyz_covariance, strict=True):
            found[i, j] = found[j, i] = between
        return found

    def _where_enough(self, errors: np.ndarray) -> np.ndarray:
        return np.where(self._arrays["hits"] < _FEW, np.nan, errors)


#: What a detector of a result has of its colour.
ATTRIBUTES = ("xyz", "xyz_standard_error", "xyz_covariance", "chromaticity", "cct", "srgb", "plot_color", "color_over_angle",
              "plot_color_over_angle")


def add_color(detector: Any, name: str, report: Json, arrays: dict[str, np.ndarray]) -> None:
    """Put colour on a detector's result: arrays, which are None if it is not known, and the methods of :class:`Color`."""
    found = Color(name, report, arrays)
    for key in ATTRIBUTES:
        setattr(detector, key, getattr(found, key))


def _chromaticities(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x, y, u' and v' of X, Y and Z (3, ...), and their derivatives by these (4, 3, ...); NaN in the dark."""
    x, y, z = xyz
    ones = np.ones(3)
    wide = np.array([1.0, 15.0, 3.0])
    total = np.where(x + y + z > 0.0, x + y + z, np.nan)
    wider = np.where(total > 0.0, x + 15.0 * y + 3.0 * z, np.nan)
    values, gradients = [], []
    for part, factor, by, below in ((0, 1.0, total, ones), (1, 1.0, total, ones), (0, 4.0, wider, wide), (1, 9.0, wider, wide)):
        value = factor * xyz[part] / by
        own = np.zeros(3)
        own[part] = factor
        values.append(value)
        gradients.append(np.stack([(own[i] - below[i] * value) / by for i in range(3)]))
    return np.stack(values), np.stack(gradients)


def _covariance_of(known: Chromaticity) -> np.ndarray:
    """Return the covariances of u' and v', (2, 2), from standard errors of x, y, u' and v'.

    To first order, x and y are linear in u' and v', so that their errors give the covariance. Two equations have it; the
    result is the one of least squares.
    """
    assert known.standard_error is not None
    of_x, of_y, of_u, of_v = known.standard_error**2
    u, v = known.u_prime, known.v_prime
    below = 6.0 * u - 16.0 * v + 12.0
    by_u = np.array([9.0 * below - 54.0 * u, -24.0 * v]) / below**2
    by_v = np.array([144.0 * u, 4.0 * below + 64.0 * v]) / below**2
    rests = np.array([of_x, of_y]) - by_u**2 * of_u - by_v**2 * of_v
    factors = 2.0 * by_u * by_v
    between = float((factors * rests).sum() / (factors**2).sum())
    return np.array([[of_u, between], [between, of_v]])


def _color_temperature(known: Chromaticity, covariance: np.ndarray | None) -> ColorTemperature:
    """Return colour temperatures of chromaticities, of which u' and v' have covariances (..., 2, 2); None if not known."""
    # To u and v of CIE 1960.
    scale = np.array([1.0, 2.0 / 3.0])
    uv = np.stack([known.u_prime, known.v_prime], axis=-1) * scale
    values, gradients = _temperatures(uv, differentiated=covariance is not None)
    if covariance is None:
        return ColorTemperature(values[..., 0], values[..., 1], None, None)
    variances = np.einsum("...ki,...ij,...kj->...k", gradients, covariance * np.outer(scale, scale), gradients)
    errors = np.sqrt(np.maximum(variances, 0.0))
    return ColorTemperature(values[..., 0], values[..., 1], errors[..., 0], errors[..., 1])


def _temperatures(uv: np.ndarray, differentiated: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return colour temperature and Duv of u and v (..., 2) of CIE 1960, and their derivatives (..., 2, 2).

    Of what is no white, all are NaN.
    """
    try:
        from colour.temperature import uv_to_CCT_Ohno2013
    except ImportError:
        raise missing("colour-science", "color", "the colour temperature needs") from None

    def found(points: np.ndarray) -> np.ndarray:
        values = np.full_like(points, np.nan)
        known = np.flatnonzero(np.isfinite(points).all(axis=-1))
        with warnings.catch_warnings():
            # Of light that is no white, of which nothing is taken.
            warnings.simplefilter("ignore")
            for first in range(0, len(known), _AT_ONCE):
                some = known[first : first + _AT_ONCE]
                values[some] = uv_to_CCT_Ohno2013(points[some])
        return values

    flat = uv.reshape(-1, 2)
    values = found(flat)
    low, high = _TEMPERATURES
    with np.errstate(invalid="ignore"):
        is_white = (np.abs(values[:, 1]) <= _MOST_DUV) & (values[:, 0] > low) & (values[:, 0] < high)
    values = np.where(is_white[:, None], values, np.nan)
    gradients = np.full((len(flat), 2, 2), np.nan)
    if differentiated and is_white.any():
        for part, step in enumerate(np.eye(2) * _STEP):
            gradients[is_white, :, part] = (found(flat[is_white] + step) - found(flat[is_white] - step)) / (2.0 * _STEP)
    return values.reshape(uv.shape), gradients.reshape(*uv.shape, 2)


def _srgb(xyz: np.ndarray, white: float | None) -> np.ndarray:
    """Return sRGB, (..., 3), of X, Y and Z (3, ...)."""
    level = float(xyz[1].max(initial=0.0)) or 1.0 if white is None else white
    if not isinstance(level, int | float | np.number) or not level > 0.0:
        raise UsageError(f"white is {white!r}; give the Y that is white, a positive number")
    linear = np.maximum(np.einsum("ki,i...->...k", _SRGB, xyz / level), 0.0)
    # Light that is too bright for its hue becomes the brightest of this hue.
    linear = linear / np.maximum(linear.max(axis=-1, keepdims=True, initial=0.0), 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
