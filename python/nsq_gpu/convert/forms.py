"""The forms of surfaces, as Optiland has them and as a scene has them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import optiland.backend as be
from optiland import geometries

from nsq_gpu import shapes
from nsq_gpu.errors import UnsupportedSceneError
from nsq_gpu.frames import number_of

#: Coefficients of an asphere, and highest power of a polynomial, that a scene has place for.
MOST_COEFFICIENTS = 10
HIGHEST_POWER = 31
#: Directions in which a surface that is not round is looked at.
_TURNS = 64
#: A surface that is steeper than that ends there.
_STEEPEST = 50.0


@dataclass(frozen=True)
class Form:
    """A surface z = sag(x, y) without its aperture."""

    #: The class of the scene's shape; a conic, which a scene has in several shapes, is an EvenAsphere without coefficients.
    kind: type
    #: Its numbers by name, but for the aperture's.
    numbers: tuple[tuple[str, Any], ...]

    @property
    def is_conic(self) -> bool:
        """Return whether it is a conic of revolution or a plane."""
        return self.kind is shapes.EvenAsphere and not dict(self.numbers)["coefficients"]

    @property
    def is_round(self) -> bool:
        """Return whether it is the same in every direction from the axis."""
        return self.kind in (shapes.EvenAsphere, shapes.OddAsphere)

    @property
    def radius(self) -> float:
        """Return the radius of curvature of a conic [mm]."""
        return float(dict(self.numbers)["radius"])

    @property
    def conic(self) -> float:
        """Return the conic constant of a conic."""
        return float(dict(self.numbers)["conic"])

    @property
    def is_flat(self) -> bool:
        """Return whether it is a plane."""
        return self.is_conic and math.isinf(self.radius)

    def shape(self, aperture_radius: float, **changes: Any) -> Any:
        """Return the scene's shape with a semi-diameter [mm]."""
        return self.kind(aperture_radius=aperture_radius, **{**{key: _listed(value) for key, value in self.numbers}, **changes})

    def clipped(self, aperture_radius: float, aperture: shapes.Aperture) -> Any:
        """Return the scene's shape within an aperture and a semi-diameter [mm]."""
        if self.is_conic:
            return shapes.ClippedConic(self.radius, self.conic, aperture_radius, aperture)
        return self.shape(aperture_radius, aperture=aperture)

    def sag(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return z [mm]; NaN where the surface does not reach so far."""
        x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        with np.errstate(invalid="ignore", divide="ignore"):
            z = be.to_numpy(self._unbounded._sag(be.array(x), be.array(y)))
        return np.where(np.hypot(x, y) <= self.reach * (1.0 + 1e-12), z, np.nan)

    def around(self, radius: float, turned: float = 0.0) -> np.ndarray:
        """Return z at a distance from the axis, in directions all around, counted from a frame turned against the surface's.

        Args:
            radius: The distance [mm]; NaN comes where the surface does not reach so far.
            turned: By how much the frame is turned about the axis [rad].
        """
        turn = 2.0 * np.pi * np.arange(_TURNS) / _TURNS - turned
        return self.sag(radius * np.cos(turn), radius * np.sin(turn))

    def rim(self, radius: float) -> tuple[float, float]:
        """Return the lowest and the highest z at a distance from the axis [mm]; NaN where the surface does not reach so far."""
        z = self.around(radius)
        return float(z.min()), float(z.max())

    @cached_property
    def reach(self) -> float:
        """How far from the axis the surface reaches in every direction [mm]."""
        numbers = dict(self.numbers)
        ends = [float(numbers[key]) for key in ("norm_x", "norm_y", "norm_radius") if key in numbers]
        for radius, conic in (("radius", "conic"), ("radius_x", "conic_x"), ("radius_y", "conic_y"), ("radius_y", "conic")):
            if radius in numbers and conic in numbers and math.isfinite(numbers[radius]) and numbers[conic] > -1.0:
                ends.append(abs(numbers[radius]) / math.sqrt(1.0 + numbers[conic]))
        if self.kind is shapes.Toroidal and math.isfinite(numbers["radius_x"]):
            ends.append(self._turned_reach(min([abs(numbers["radius_x"]), *ends])))
        return min(ends, default=math.inf)

    def _turned_reach(self, most: float) -> float:
        """Return how far a toroid reaches, which is turned about an axis [mm]."""
        turn = 2.0 * np.pi * np.arange(_TURNS) / _TURNS
        for radius in np.linspace(0.0, most, 1001)[1:]:
            with np.errstate(invalid="ignore", divide="ignore"):
                _, along_x, along_y = self._unbounded._sag_and_gradient(be.array(radius * np.cos(turn)), be.array(radius * np.sin(turn)))
                slope = np.hypot(be.to_numpy(along_x), be.to_numpy(along_y))
            if not (slope < _STEEPEST).all():
                return float(radius - 1e-3 * most)
        return most

    @cached_property
    def _unbounded(self) -> Any:
        return self.shape(1.0)


def _listed(value: Any) -> Any:
    return [_listed(item) for item in value] if isinstance(value, tuple) else value


def _trimmed(values: Any) -> tuple[float, ...]:
    """Return coefficients without zeros at their end."""
    found = [number_of(value) for value in values]
    while found and found[-1] == 0.0:
        found.pop()
    return tuple(found)


def _table(values: Any) -> tuple[tuple[float, ...], ...]:
    rows = [_trimmed(row) for row in np.atleast_2d(be.to_numpy(values))]
    while rows and not rows[-1]:
        rows.pop()
    return tuple(rows)


def _base(geometry: Any) -> dict[str, Any]:
    return {"radius": number_of(geometry.radius), "conic": number_of(getattr(geometry, "k", 0.0))}


def _asphere(geometry: Any) -> dict[str, Any]:
    return {**_base(geometry), "coefficients": _trimmed(getattr(geometry, "coefficients", ()))}


def _radius(value: Any) -> float:
    """Return a radius; Optiland takes 0 for a straight line as well."""
    return number_of(value) or math.inf


def _biconic(geometry: Any) -> dict[str, Any]:
    return {"radius_x": _radius(geometry.Rx), "radius_y": _radius(geometry.Ry), "conic_x": number_of(geometry.kx),
            "conic_y": number_of(geometry.ky)}


def _toroidal(geometry: Any) -> dict[str, Any]:
    return {"radius_x": _radius(geometry.R_rot), "radius_y": _radius(geometry.R_yz), "conic": number_of(geometry.k_yz),
            "coeffs_poly_y": _trimmed(geometry.coeffs_poly_y)}


def _polynomial(geometry: Any) -> dict[str, Any]:
    return {**_base(geometry), "coefficients": _table(geometry.coefficients)}


def _chebyshev(geometry: Any) -> dict[str, Any]:
    return {**_polynomial(geometry), "norm_x": number_of(geometry.norm_x), "norm_y": number_of(geometry.norm_y)}


def _zernike(geometry: Any) -> dict[str, Any]:
    return {**_asphere(geometry), "zernike_type": geometry.zernike_type, "norm_radius": number_of(geometry.norm_radius)}


#: The scene's shape of each of Optiland's geometries, and what reads its numbers.
_KINDS: dict[type, tuple[type, Callable[[Any], dict[str, Any]]]] = {
    geometries.Plane: (shapes.EvenAsphere, _asphere),
    geometries.StandardGeometry: (shapes.EvenAsphere, _asphere),
    geometries.EvenAsphere: (shapes.EvenAsphere, _asphere),
    geometries.OddAsphere: (shapes.OddAsphere, _asphere),
    geometries.BiconicGeometry: (shapes.Biconic, _biconic),
    geometries.ToroidalGeometry: (shapes.Toroidal, _toroidal),
    geometries.PolynomialGeometry: (shapes.Polynomial, _polynomial),
    geometries.ChebyshevPolynomialGeometry: (shapes.Chebyshev, _chebyshev),
    geometries.ZernikePolynomialGeometry: (shapes.Zernike, _zernike),
}


def form_of(geometry: Any, place: str) -> Form:
    """Return the form of one of Optiland's geometries.

    Raises:
        UnsupportedSceneError: A scene has no such shape, or no place for so many coefficients.
    """
    if type(geometry) not in _KINDS:
        raise UnsupportedSceneError(f"{place}: its shape ({type(geometry).__name__}) cannot be carried; planes, conics, even and "
                                    "odd aspheres, biconics, toroids, polynomials, Chebyshev and Zernike surfaces can")
    kind, read = _KINDS[type(geometry)]
    numbers = read(geometry)
    if kind is shapes.OddAsphere and not numbers["coefficients"]:
        kind = shapes.EvenAsphere
    coefficients = numbers.get("coefficients", numbers.get("coeffs_poly_y", ()))
    most = HIGHEST_POWER + 1 if kind in (shapes.Polynomial, shapes.Chebyshev) else 256 if kind is shapes.Zernike else MOST_COEFFICIENTS
    count = max([len(coefficients), *(len(row) for row in coefficients if isinstance(row, tuple))])
    if count > most:
        raise UnsupportedSceneError(f"{place}: its shape ({type(geometry).__name__}) has {count} coefficients; {most} can be carried")
    return Form(kind, tuple(numbers.items()))
