"""Shapes that Optiland's non-sequential engine lacks. They trace on its NumpyBackend and TorchBackend as well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import optiland.backend as be
from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry
from optiland.zernike import ZernikeFringe, ZernikeNoll, ZernikeStandard

#: An aperture of that size has no end [mm].
ENDLESS = 1e6


@dataclass(frozen=True)
class Aperture:
    """A part of the plane across the axis of a surface, which need be neither round nor on the axis.

    >>> slit = Aperture("rectangle", 5.0, 1.0, y=2.0)
    >>> triangle = Aperture("polygon", vertices=((-1.0, -1.0), (1.0, -1.0), (0.0, 1.0)))
    >>> both = Aperture("union", parts=(slit, triangle))
    """

    #: What bounds it; of a union, an intersection and a difference the ``parts`` do.
    outline: Literal["ellipse", "rectangle", "polygon", "union", "intersection", "difference"]
    #: Semi-axes along x and y of an ellipse or a rectangle [mm].
    semi_axis_x: float | None = None
    semi_axis_y: float | None = None
    #: Its middle [mm].
    x: float = 0.0
    y: float = 0.0
    #: Radius of a round hole about its middle [mm].
    hole_radius: float = 0.0
    #: True for all that it leaves out.
    inverted: bool = False
    #: Corners of a polygon [mm].
    vertices: tuple[tuple[float, float], ...] = ()
    #: Two apertures.
    parts: tuple[Aperture, ...] = ()

    def holds(self, x: Any, y: Any) -> Any:
        """Return an array that is True at points of the aperture; x and y are in mm."""
        return self._surrounds(x, y) != self.inverted

    def _surrounds(self, x: Any, y: Any) -> Any:
        if self.outline == "polygon":
            return self._is_within(x, y)
        if self.parts:
            one, other = (part.holds(x, y) for part in self.parts)
            if self.outline == "union":
                return one | other
            return one & (other if self.outline == "intersection" else ~other)
        semi_axis_x, semi_axis_y = self._semi_axes()
        u, v = x - self.x, y - self.y
        along, across = u * (1.0 / semi_axis_x), v * (1.0 / semi_axis_y)
        if self.outline == "rectangle":
            inside = (abs(along) <= 1.0) & (abs(across) <= 1.0)
        else:
            inside = along * along + across * across <= 1.0
        return inside & ((u * u + v * v > self.hole_radius * self.hole_radius) if self.hole_radius else True)

    def _is_within(self, x: Any, y: Any) -> Any:
        """Return whether an odd number of sides crosses the line from a point towards +x."""
        inside = x != x
        for (from_x, from_y), (to_x, to_y) in zip((self.vertices[-1], *self.vertices), self.vertices, strict=False):
            if from_y != to_y:
                crosses = (from_y > y) != (to_y > y)
                inside = inside ^ (crosses & (x < (to_x - from_x) * (y - from_y) / (to_y - from_y) + from_x))
        return inside

    def _semi_axes(self) -> tuple[float, float]:
        if self.semi_axis_x is None or self.semi_axis_y is None:
            raise ValueError(f"an aperture of the outline {self.outline!r} needs semi_axis_x and semi_axis_y")
        return self.semi_axis_x, self.semi_axis_y

    def reach(self) -> float:
        """Return a distance from the axis beyond which it has no point [mm], were it not inverted."""
        if self.outline == "polygon":
            return max(math.hypot(*corner) for corner in self.vertices)
        if self.parts:
            one, other = (math.inf if part.inverted else part.reach() for part in self.parts)
            return {"union": max(one, other), "intersection": min(one, other), "difference": one}[self.outline]
        semi_axis_x, semi_axis_y = self._semi_axes()
        if self.outline == "rectangle":
            return math.hypot(abs(self.x) + semi_axis_x, abs(self.y) + semi_axis_y)
        return math.hypot(self.x, self.y) + max(semi_axis_x, semi_axis_y)

    def inverse(self) -> Aperture:
        """Return all that it leaves out."""
        return replace(self, inverted=not self.inverted)


class ClippedConic(ConicGeometry):
    """A conic within a semi-diameter and an aperture.

    Args:
        radius: Radius of curvature at the vertex [mm]; infinite for a plane.
        conic: Conic constant.
        aperture_radius: Semi-diameter [mm], beyond which there is nothing whatever the aperture says.
        aperture: The part across the axis that there is.
    """

    def __init__(self, radius: float, conic: float, aperture_radius: float, aperture: Aperture) -> None:
        super().__init__(radius, conic, aperture_radius)
        self.aperture = aperture

    def _root_valid(self, *arguments: Any) -> tuple[Any, Any, Any]:
        valid, x, y = super()._root_valid(*arguments)
        return valid & self.aperture.holds(x, y), x, y


class _Sag(ConicGeometry):
    """A surface z = sag(x, y) within a semi-diameter, whose crossings are found along the ray."""

    #: Pieces of a ray that are looked at for a crossing, and halvings of the first piece that has one.
    _PIECES = 256
    _HALVINGS = 40
    #: Rays at a time: the pieces of all are held at once.
    _CHUNK = 8192
    #: Crossings beside the aperture that a ray may have before the one that counts.
    _MOST_BESIDE = 16

    def __init__(self, radius: float, conic: float, aperture_radius: float, aperture: Aperture | None = None) -> None:
        super().__init__(radius, conic, aperture_radius)
        self.aperture = aperture

    def _sag_and_gradient(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        raise NotImplementedError

    def _sag(self, x: Any, y: Any) -> Any:
        return self._sag_and_gradient(x, y)[0]

    def ray_intersect(self, origins: Any, directions: Any) -> tuple[Any, Any, Any, Any]:
        """Return distances, normals against the rays, which rays hit, and normals towards +z: Optiland's own contract."""
        rays = be.to_numpy(origins).astype(float), be.to_numpy(directions).astype(float)
        heights = self._heights()
        parts = [self._first(rays[0][at : at + self._CHUNK], rays[1][at : at + self._CHUNK], heights)
                 for at in range(0, len(rays[0]), self._CHUNK)]
        found = np.concatenate(parts) if parts else np.zeros(0)
        hit = np.isfinite(found)
        # One step of Newton's method has the derivatives of the crossing, with a backend that keeps them.
        t = be.array(np.where(hit, found, 0.0))
        # A comparison gives what the backend has for True and False.
        met = be.array(np.where(hit, 1.0, 0.0)) > 0.5
        place = [origins[:, axis] + t * directions[:, axis] for axis in range(3)]
        sag, along_x, along_y = self._sag_and_gradient(place[0], place[1])
        rate = directions[:, 2] - along_x * directions[:, 0] - along_y * directions[:, 1]
        t = t - be.where(met, (place[2] - sag) / be.where(rate == 0.0, be.ones_like(rate), rate), be.zeros_like(rate))
        # The normal is the one at the place after the step: it has the derivatives of the place.
        _, along_x, along_y = self._sag_and_gradient(*(origins[:, axis] + t * directions[:, axis] for axis in range(2)))
        length = (1.0 + along_x * along_x + along_y * along_y) ** 0.5
        outward = be.stack([-along_x / length, -along_y / length, 1.0 / length], axis=1)
        against = be.where((directions * outward).sum(axis=1, keepdims=True) > 0, -outward, outward)
        return be.where(met, t, be.ones_like(t) * be.inf), against, met, outward

    def _heights(self) -> tuple[float, float]:
        """Return heights between which the surface lies [mm]."""
        radius = float(be.to_numpy(self.aperture_radius))
        x, y = np.meshgrid(*[np.linspace(-radius, radius, 201)] * 2)
        inside = x * x + y * y <= radius * radius
        sag = be.to_numpy(self._sag(be.array(x[inside]), be.array(y[inside])))
        room = 0.05 * (sag.max() - sag.min()) + 1e-3 * radius
        return float(sag.min() - room), float(sag.max() + room)

    def _first(self, origins: np.ndarray, directions: np.ndarray, heights: tuple[float, float]) -> np.ndarray:
        """Return the distances of the first crossings ahead, between two heights; infinity where there is none."""
        eps, limit = 1e-9, float(be.to_numpy(self.aperture_radius)) ** 2
        low, high = heights
        with np.errstate(divide="ignore", invalid="ignore"):
            square = (directions[:, :2] ** 2).sum(axis=1)
            middle = (origins[:, :2] * directions[:, :2]).sum(axis=1)
            beside = (origins[:, :2] ** 2).sum(axis=1) - limit * (1.0 + 1e-9)
            root = np.sqrt(middle**2 - square * beside)
            ends = np.where(square > 0.0, [(-middle - root) / square, (-middle + root) / square],
                            np.where(beside <= 0.0, [[-np.inf], [np.inf]], [[np.nan], [np.nan]]))
            planes = np.sort([(low - origins[:, 2]) / directions[:, 2], (high - origins[:, 2]) / directions[:, 2]], axis=0)
            level = directions[:, 2] == 0.0
            within = (origins[:, 2] >= low) & (origins[:, 2] <= high)
            planes = np.where(level, np.where(within, [[-np.inf], [np.inf]], [[np.nan], [np.nan]]), planes)
            near, far = np.maximum(np.maximum(ends[0], planes[0]), eps), np.minimum(ends[1], planes[1])
            crosses = np.isfinite(near) & (near < far)
        near, far = np.where(crosses, near, 0.0), np.where(crosses, far, 1.0)
        share = np.linspace(0.0, 1.0, self._PIECES + 1)
        values = self._value(origins, directions, near[:, None] + share * (far - near)[:, None])
        changes = (values[:, 1:] < 0.0) != (values[:, :-1] < 0.0)
        found = np.full(len(near), np.inf)
        for _ in range(1 if self.aperture is None else self._MOST_BESIDE):
            t, piece = self._bisected(origins, directions, near, far, values, changes)
            crosses = crosses & changes.any(axis=1)
            is_part = crosses if self.aperture is None else crosses & self.aperture.holds(*(
                origins[:, axis] + t * directions[:, axis] for axis in (0, 1)))
            found = np.where(is_part, t, found)
            # The next crossing, where this one lies beside the aperture.
            crosses = crosses & ~is_part
            if not crosses.any():
                break
            changes[np.arange(len(piece)), piece] = False
        return found

    def _bisected(self, origins: np.ndarray, directions: np.ndarray, near: np.ndarray, far: np.ndarray, values: np.ndarray,
                  changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the place of each ray's first change of sign, and the piece that has it."""
        share = np.linspace(0.0, 1.0, self._PIECES + 1)
        first = changes.argmax(axis=1)
        low_t, high_t = (near + share[first + end] * (far - near) for end in (0, 1))
        is_low = values[np.arange(len(first)), first] < 0.0
        for _ in range(self._HALVINGS):
            half = 0.5 * (low_t + high_t)
            is_before = (self._value(origins, directions, half[:, None])[:, 0] < 0.0) == is_low
            low_t, high_t = np.where(is_before, half, low_t), np.where(is_before, high_t, half)
        return 0.5 * (low_t + high_t), first

    def _value(self, origins: np.ndarray, directions: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return z less the sag at distances along rays, shape (rays, distances)."""
        x, y, z = (origins[:, axis, None] + t * directions[:, axis, None] for axis in range(3))
        return z - be.to_numpy(self._sag(be.array(x), be.array(y)))


class _Asphere(_Sag):
    """A conic and powers of the distance from the axis."""

    #: The step from power to power.
    _STEP = 2

    def __init__(self, radius: float, conic: float, aperture_radius: float, coefficients: Sequence[float] = (),
                 aperture: Aperture | None = None) -> None:
        super().__init__(radius, conic, aperture_radius, aperture)
        self.coefficients = list(coefficients)

    def _sag_and_gradient(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        square = x * x + y * y
        curvature = self._curvature()
        root = be.abs(1.0 - (1.0 + self.conic) * curvature**2 * square) ** 0.5
        sag, slope = curvature * square / (1.0 + root), curvature / root
        # The distance from the axis, but for the axis itself, where a tip has no slope.
        r = be.where(square > 0.0, square, be.ones_like(square)) ** 0.5
        for index, coefficient in enumerate(self.coefficients):
            power = self._STEP * (index + 1)
            if power % 2 == 0:
                sag = sag + coefficient * square ** (power // 2)
                slope = slope + power * coefficient * square ** (power // 2 - 1)
            else:
                sag = sag + be.where(square > 0.0, coefficient * r**power, be.zeros_like(square))
                slope = slope + be.where(square > 0.0, power * coefficient * r ** (power - 2), be.zeros_like(square))
        return sag, slope * x, slope * y


class EvenAsphere(_Asphere):
    """A conic and even powers of the distance from the axis.

    Args:
        radius: Radius of curvature of the conic part at the vertex [mm]; infinite for a plane.
        conic: Conic constant.
        aperture_radius: Semi-diameter [mm].
        coefficients: Of r^2, r^4, r^6 and so on, up to ten; lengths are in mm.
        aperture: The part across the axis that there is; None for all.
    """


class OddAsphere(_Asphere):
    """A conic and all powers of the distance from the axis.

    Args:
        radius: Radius of curvature of the conic part at the vertex [mm]; infinite for a plane.
        conic: Conic constant.
        aperture_radius: Semi-diameter [mm].
        coefficients: Of r, r^2, r^3 and so on, up to ten; lengths are in mm.
        aperture: The part across the axis that there is; None for all.
    """

    _STEP = 1


def _profile(curvature: Any, conic: Any, height: Any) -> tuple[Any, Any]:
    """Return the height of a conic at a distance from the axis, and its slope over that distance."""
    square = height * height
    root = be.abs(1.0 - (1.0 + conic) * curvature**2 * square) ** 0.5
    return curvature * square / (1.0 + root), curvature / root


def _inverse(radius: Any) -> Any:
    return 0.0 if float(be.to_numpy(radius)) in (0.0, math.inf, -math.inf) else 1.0 / radius


class Biconic(_Sag):
    """Two conic profiles, one along x and one along y, whose heights add up.

    Args:
        radius_x: Radius of curvature at the vertex along x [mm]; infinite for a line.
        radius_y: Radius of curvature at the vertex along y [mm].
        aperture_radius: Semi-diameter [mm].
        conic_x: Conic constant along x.
        conic_y: Conic constant along y.
        aperture: The part across the axis that there is; None for all.
    """

    def __init__(self, radius_x: float, radius_y: float, aperture_radius: float, conic_x: float = 0.0, conic_y: float = 0.0,
                 aperture: Aperture | None = None) -> None:
        super().__init__(math.inf, 0.0, aperture_radius, aperture)
        self.radius_x, self.radius_y, self.conic_x, self.conic_y = radius_x, radius_y, conic_x, conic_y

    def _sag_and_gradient(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        sag_x, slope_x = _profile(_inverse(self.radius_x), self.conic_x, x)
        sag_y, slope_y = _profile(_inverse(self.radius_y), self.conic_y, y)
        return sag_x + sag_y, slope_x * x, slope_y * y


class Toroidal(_Sag):
    """A profile along y, turned about the line z = radius_x, x = 0.

    Args:
        radius_x: Radius of rotation: the radius of curvature at the vertex along x [mm]; infinite for a cylinder.
        radius_y: Radius of curvature of the profile at the vertex [mm].
        aperture_radius: Semi-diameter [mm].
        conic: Conic constant of the profile.
        coeffs_poly_y: Of y^2, y^4, y^6 and so on, up to ten; lengths are in mm.
        aperture: The part across the axis that there is; None for all.
    """

    def __init__(self, radius_x: float, radius_y: float, aperture_radius: float, conic: float = 0.0,
                 coeffs_poly_y: Sequence[float] = (), aperture: Aperture | None = None) -> None:
        super().__init__(radius_y, conic, aperture_radius, aperture)
        self.radius_x, self.radius_y = radius_x, radius_y
        self.coeffs_poly_y = list(coeffs_poly_y)

    def _sag_and_gradient(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        profile, slope = _profile(_inverse(self.radius_y), self.conic, y)
        for index, coefficient in enumerate(self.coeffs_poly_y):
            profile = profile + coefficient * y ** (2 * index + 2)
            slope = slope + (2 * index + 2) * coefficient * y ** (2 * index)
        bent = _inverse(self.radius_x)
        w = 1.0 - bent * profile
        turned = be.abs(w * w - (bent * x) ** 2) ** 0.5
        return profile + bent * x * x / (w + turned), bent * x / turned, w * slope * y / turned


class _Freeform(_Sag):
    """A conic and a polynomial of x and y."""

    def _sag_and_gradient(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        conic, slope = _profile(self._curvature(), self.conic, (x * x + y * y) ** 0.5)
        value, along_x, along_y = self._polynomial(x, y)
        return conic + value, slope * x + along_x, slope * y + along_y

    def _polynomial(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Return the polynomial and its derivatives along x and y."""
        raise NotImplementedError


class Polynomial(_Freeform):
    """A conic and powers of x times powers of y.

    Args:
        radius: Radius of curvature of the conic part at the vertex [mm]; infinite for a plane.
        conic: Conic constant.
        aperture_radius: Semi-diameter [mm].
        coefficients: ``coefficients[i][j]`` of x^i y^j, powers up to 31; lengths are in mm.
        aperture: The part across the axis that there is; None for all.
    """

    def __init__(self, radius: float, conic: float, aperture_radius: float, coefficients: Sequence[Sequence[float]] = (),
                 aperture: Aperture | None = None) -> None:
        super().__init__(radius, conic, aperture_radius, aperture)
        self.coefficients = [list(row) for row in coefficients]

    def _polynomial(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        return _powers(self.coefficients, x, y)


def _powers(coefficients: Sequence[Sequence[float]], x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Return the sum of coefficients[i][j] x^i y^j, and its derivatives."""
    value, along_x, along_y = be.zeros_like(x), be.zeros_like(x), be.zeros_like(x)
    for row in reversed(coefficients):
        inner, rate = be.zeros_like(x), be.zeros_like(x)
        for coefficient in reversed(row):
            rate = rate * y + inner
            inner = inner * y + coefficient
        along_x = along_x * x + value
        along_y = along_y * x + rate
        value = value * x + inner
    return value, along_x, along_y


class Chebyshev(_Freeform):
    """A conic and products of Chebyshev polynomials of the first kind.

    Args:
        radius: Radius of curvature of the conic part at the vertex [mm]; infinite for a plane.
        conic: Conic constant.
        aperture_radius: Semi-diameter [mm], at most ``norm_x`` and ``norm_y``.
        coefficients: ``coefficients[i][j]`` of T_i(x / norm_x) T_j(y / norm_y) [mm], orders up to 31.
        norm_x: What x is divided by [mm].
        norm_y: What y is divided by [mm].
        aperture: The part across the axis that there is; None for all.
    """

    def __init__(self, radius: float, conic: float, aperture_radius: float, coefficients: Sequence[Sequence[float]] = (),
                 norm_x: float = 1.0, norm_y: float = 1.0, aperture: Aperture | None = None) -> None:
        super().__init__(radius, conic, aperture_radius, aperture)
        self.coefficients = [list(row) for row in coefficients]
        self.norm_x, self.norm_y = norm_x, norm_y

    def _polynomial(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        width = max((len(row) for row in self.coefficients), default=0)
        along_u, along_v = _chebyshev(len(self.coefficients), x / self.norm_x), _chebyshev(width, y / self.norm_y)
        value, along_x, along_y = be.zeros_like(x), be.zeros_like(x), be.zeros_like(x)
        for row, (t, rate_t) in zip(self.coefficients, along_u, strict=True):
            for coefficient, (s, rate_s) in zip(row, along_v, strict=False):
                value = value + coefficient * t * s
                along_x = along_x + coefficient / self.norm_x * rate_t * s
                along_y = along_y + coefficient / self.norm_y * t * rate_s
        return value, along_x, along_y


def _chebyshev(count: int, u: Any) -> list[tuple[Any, Any]]:
    """Return the first Chebyshev polynomials and their derivatives."""
    found = [(be.ones_like(u), be.zeros_like(u)), (u, be.ones_like(u))]
    while len(found) < count:
        (t, rate), (before, rate_before) = found[-1], found[-2]
        found.append((2.0 * u * t - before, 2.0 * (t + u * rate) - rate_before))
    return found[:count]


class Zernike(_Freeform):
    """A conic and Zernike polynomials.

    Args:
        radius: Radius of curvature of the conic part at the vertex [mm]; infinite for a plane.
        conic: Conic constant.
        aperture_radius: Semi-diameter [mm], at most ``norm_radius``.
        coefficients: Of the first polynomials of the convention [mm], orders up to 31.
        zernike_type: ``"standard"`` (OSA/ANSI), ``"noll"`` or ``"fringe"``.
        norm_radius: Radius of the disk on which the polynomials are defined [mm].
        aperture: The part across the axis that there is; None for all.
    """

    def __init__(self, radius: float, conic: float, aperture_radius: float, coefficients: Sequence[float] = (),
                 zernike_type: Literal["standard", "noll", "fringe"] = "standard", norm_radius: float = 1.0,
                 aperture: Aperture | None = None) -> None:
        super().__init__(radius, conic, aperture_radius, aperture)
        self.coefficients = list(coefficients)
        self.zernike_type, self.norm_radius = zernike_type, norm_radius

    def _polynomial(self, x: Any, y: Any) -> tuple[Any, Any, Any]:
        value, along_x, along_y = _powers(self._in_powers(), x / self.norm_radius, y / self.norm_radius)
        return value, along_x / self.norm_radius, along_y / self.norm_radius

    def _in_powers(self) -> list[list[Any]]:
        """Return the coefficients of powers of x and y, over the norm."""
        kinds = {"standard": ZernikeStandard, "noll": ZernikeNoll, "fringe": ZernikeFringe}
        terms = kinds[self.zernike_type](self.coefficients)
        size = max((int(n) for n, _ in terms.indices), default=0) + 1
        powers: list[list[Any]] = [[0.0] * size for _ in range(size)]
        for coefficient, (n, m) in zip(self.coefficients, terms.indices, strict=True):
            n, turns = int(n), abs(int(m))
            norm = coefficient * float(be.to_numpy(terms._norm_constant(n, m)))
            for k in range((n - turns) // 2 + 1):
                radial = (-1) ** k * math.comb(n - k, k) * math.comb(n - 2 * k, (n - turns) // 2 - k)
                rings = (n - turns) // 2 - k
                # (x^2 + y^2)^rings times the real or the imaginary part of (x + i y)^turns.
                for ring in range(rings + 1):
                    for turn in range(int(m < 0), turns + 1, 2):
                        sign = (-1) ** (turn // 2)
                        factor = radial * math.comb(rings, ring) * sign * math.comb(turns, turn)
                        i, j = 2 * (rings - ring) + turns - turn, 2 * ring + turn
                        powers[i][j] = powers[i][j] + norm * factor
        return powers
