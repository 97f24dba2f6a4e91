"""Tables of intensity over two angles, as lamps have them, and directions drawn from them by an exact inverse."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from nsq_gpu.errors import UsageError, without_gradient

#: Longest step between polar knots [rad]; over it the series of sine and cosine are exact to 1e-13.
_STEP = 0.02
#: The nearer knot of an interval is at most so many times nearer to a pole. Beyond that, Newton's steps would not converge.
_MOST_NEARER = 3.0
#: Most halvings that see to it. An interval that is left at a pole has little of the light where the steps do not converge.
_HALVINGS = 8
#: Steps of Newton's method.
_NEWTON_STEPS = 5
#: Angles rise by at least so much [deg].
_LEAST_STEP = 1e-9
#: The first and the last row of a full circle may differ by so much of the largest intensity, by rounding.
_ROUNDING = 1e-9
#: Where a table over azimuths may end [deg].
_ENDS = (90.0, 180.0, 360.0)


class IntensityTable:
    """Intensity over the polar angle gamma and the azimuth, linear in each of them between the table's angles.

    Gamma is 0 along +z; the azimuth is 0 towards +x, and 90 towards +y. Outside the polar angles the intensity is 0. A table
    of the azimuth 0 alone is one of revolution. A table to 180 is mirrored: I(a) = I(360 - a). One to 90 is so too, and
    I(a) = I(180 - a).

    Args:
        polar_angles_deg: Polar angles [deg], two or more, rising within 0 to 180.
        azimuth_angles_deg: The number 0, or azimuths [deg] that rise from 0 to 90, 180 or 360.
        intensity: A row for each azimuth, with a number for each polar angle, in any unit. Of revolution, the row alone will do.

    Raises:
        UsageError: An argument is no such table.
    """

    def __init__(self, polar_angles_deg: Any, azimuth_angles_deg: Any, intensity: Any) -> None:
        self.polar_angles_deg = _polar_angles(polar_angles_deg)
        self.azimuth_angles_deg = _azimuth_angles(azimuth_angles_deg)
        self.intensity = _rows(intensity, len(self.azimuth_angles_deg), len(self.polar_angles_deg))
        if self.azimuth_angles_deg[-1] == 360.0:
            _close(self.intensity)
        for array in (self.polar_angles_deg, self.azimuth_angles_deg, self.intensity):
            array.setflags(write=False)
        self._circle_deg, self._rows = _full_circle(self.azimuth_angles_deg, self.intensity)
        # Squares of very large and very small numbers have no place in a float.
        self._scale = float(self.intensity.max())
        self._theta = _polar_knots(np.radians(self.polar_angles_deg))
        self._prepare()

    def _prepare(self) -> None:
        theta, phi, polar = self._theta, np.radians(self._circle_deg), np.radians(self.polar_angles_deg)
        # Shape (polar knots, azimuth knots).
        self._phi = phi
        self._at_knots = np.stack([np.interp(theta, polar, row / self._scale) for row in self._rows], axis=1)
        steps = 0.5 * (self._at_knots[:, 1:] + self._at_knots[:, :-1]) * np.diff(phi)
        self._up_to = np.concatenate([np.zeros((len(theta), 1)), np.cumsum(steps, axis=1)], axis=1)
        self._widths = np.diff(theta)
        self._sines, self._cosines = np.sin(theta), np.cos(theta)
        self._density = _density(self._up_to[:, -1], self._widths, self._sines[:-1], self._cosines[:-1])
        self._fluxes = _integral(self._density, self._widths)
        total = np.cumsum(self._fluxes)
        self._shares = np.concatenate([[0.0], total / total[-1]])
        #: Integral over all directions, in the unit of the intensity times sr.
        self.flux = float(total[-1]) * self._scale
        if not np.isfinite(self.flux):
            raise UsageError(f"intensity: numbers up to {self._scale:g} are too large to sum; give a larger unit")

    @property
    def is_of_revolution(self) -> bool:
        """Whether the table has one azimuth, for all of them."""
        return len(self.azimuth_angles_deg) == 1

    def at(self, polar_deg: Any, azimuth_deg: Any) -> np.ndarray:
        """Return the intensity at polar angles and azimuths [deg], which are broadcast."""
        gamma, c = np.broadcast_arrays(np.asarray(polar_deg, dtype=np.float64), np.asarray(azimuth_deg, dtype=np.float64) % 360.0)
        i, x = _between(self._circle_deg, c)
        j, y = _between(self.polar_angles_deg, gamma)
        one, other = ((1.0 - y) * self._rows[row, j] + y * self._rows[row, j + 1] for row in (i, i + 1))
        found = (1.0 - x) * one + x * other
        is_inside = (gamma >= self.polar_angles_deg[0]) & (gamma <= self.polar_angles_deg[-1])
        return np.asarray(np.where(is_inside, found, 0.0))

    def directions(self, u1: np.ndarray, u2: np.ndarray) -> np.ndarray:
        """Return unit directions, shape (N, 3), of two draws each in [0, 1): the first is for gamma, the second for C."""
        k = np.clip(np.searchsorted(self._shares, u1, side="right") - 1, 0, len(self._widths) - 1)
        s = self._offsets(k, (u1 - self._shares[k]) / (self._shares[k + 1] - self._shares[k]))
        phi = self._azimuths(k, s / self._widths[k], u2)
        c, n = 1.0 - s * s / 2.0 + s**4 / 24.0, s - s**3 / 6.0 + s**5 / 120.0
        sine, cosine = self._sines[k] * c + self._cosines[k] * n, self._cosines[k] * c - self._sines[k] * n
        return np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=1)

    def _offsets(self, k: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return how far beyond knots k [rad] the shares of their intervals' flux lie."""
        width, density, target = self._widths[k], self._density[k], share * self._fluxes[k]
        # The start takes the density for a line between its ends.
        first, last = density[:, 0], _value(density, width)
        below = first + np.sqrt(np.maximum(first * first + (last * last - first * first) * share, 0.0))
        s = np.asarray(width * (first + last) * share / np.where(below > 0.0, below, 1.0))
        for _ in range(_NEWTON_STEPS):
            slope = _value(density, s)
            step = (_integral(density, s) - target) / np.where(slope != 0.0, slope, 1.0)
            s = np.clip(np.where(slope != 0.0, s - step, s), 0.0, width)
        return s

    def _azimuths(self, k: np.ndarray, t: np.ndarray, u2: np.ndarray) -> np.ndarray:
        """Return azimuths [rad] at the parts t of the way from knots k to the next ones."""
        def at(table: np.ndarray, column: np.ndarray | int) -> np.ndarray:
            return np.asarray((1.0 - t) * table[k, column] + t * table[k + 1, column])

        wanted = u2 * at(self._up_to, -1)
        # The last knot that is not beyond what is wanted, by bisection.
        j, beyond = np.zeros(len(k), dtype=np.intp), np.full(len(k), len(self._phi) - 1)
        for _ in range(int(len(self._phi) - 1).bit_length()):
            middle = (j + beyond) // 2
            is_reached = at(self._up_to, middle) <= wanted
            j, beyond = np.where(is_reached, middle, j), np.where(is_reached, beyond, middle)
        width = self._phi[j + 1] - self._phi[j]
        a, b, rest = at(self._at_knots, j), at(self._at_knots, j + 1), 2.0 * (wanted - at(self._up_to, j)) / width
        below = a + np.sqrt(np.maximum(a * a + (b - a) * rest, 0.0))
        x = np.where(below > 0.0, rest / np.where(below > 0.0, below, 1.0), 0.0)
        return np.asarray(self._phi[j] + np.clip(x, 0.0, 1.0) * width)


def _density(whole: np.ndarray, width: np.ndarray, sine: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Return the density over s of each interval, (M + B s) sin(theta + s), as coefficients of s^0 to s^6."""
    m, b = whole[:-1], np.diff(whole) / width
    return np.stack([m * sine, m * cosine + b * sine, b * cosine - m * sine / 2.0, -m * cosine / 6.0 - b * sine / 2.0,
                     m * sine / 24.0 - b * cosine / 6.0, m * cosine / 120.0 + b * sine / 24.0, b * cosine / 120.0], axis=1)


def _value(density: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return densities at s."""
    found = np.zeros(len(s))
    for power in range(density.shape[1] - 1, -1, -1):
        found = found * s + density[:, power]
    return found


def _integral(density: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return the integrals of densities from 0 to s."""
    return np.asarray(_value(density / np.arange(1.0, density.shape[1] + 1.0), s) * s)


def _polar_knots(polar: np.ndarray) -> np.ndarray:
    """Return the polar angles [rad] with others between them, where steps are long, or long beside their distance to a pole."""
    knots: list[float] = []
    for low, high in pairwise(polar):
        parts = int(np.ceil((high - low) / _STEP)) if high - low > _STEP else 1
        knots += [low + (high - low) * (i / parts) for i in range(parts)]
    knots.append(polar[-1])
    lower = [np.pi - distance for distance in _nearer([np.pi - knot for knot in reversed(knots)])]
    return np.unique([*knots, *_nearer(knots), *lower])


def _nearer(distances: list[float]) -> Iterator[float]:
    """Yield distances from a pole between the rising ones that are given, where those are far apart."""
    for near, far in pairwise(distances):
        for _ in range(_HALVINGS):
            if far > _MOST_NEARER * near:
                far /= 2.0
                yield far


def _full_circle(azimuths: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return azimuths [deg] from 0 to 360, and a row for each: mirrored tables without their mirrors."""
    if len(azimuths) == 1:
        return np.array([0.0, 360.0]), np.repeat(rows, 2, axis=0)
    for end in (90.0, 180.0):
        if azimuths[-1] == end:
            azimuths = np.concatenate([azimuths, 2.0 * end - azimuths[-2::-1]])
            rows = np.concatenate([rows, rows[-2::-1]])
    return azimuths, rows


def _between(knots: np.ndarray, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the knots before what is asked for, and the part of the way to the next knot."""
    place = np.clip(np.searchsorted(knots, asked, side="right") - 1, 0, len(knots) - 2)
    return place, np.clip((asked - knots[place]) / (knots[place + 1] - knots[place]), 0.0, 1.0)


def numbers(name: str, values: Any) -> np.ndarray:
    """Return an argument as finite numbers in an array of its own.

    Raises:
        UsageError: It holds something else.
        UnsupportedSceneError: It is a tensor that wants a gradient.
    """
    _check_gradients(name, values)
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name}: {error}; give numbers") from error
    if not np.isfinite(array).all():
        place = "".join(f"[{index}]" for index in np.argwhere(~np.isfinite(array))[0])
        raise UsageError(f"{name}{place}: it is {array[~np.isfinite(array)][0]}; give a finite number")
    return array


def _check_gradients(name: str, values: Any) -> None:
    without_gradient(name, values)
    if isinstance(values, list | tuple):
        for place, value in enumerate(values):
            _check_gradients(f"{name}[{place}]", value)


def _rising(name: str, angles: np.ndarray) -> None:
    for place in np.flatnonzero(np.diff(angles) < _LEAST_STEP):
        raise UsageError(f"{name}[{place + 1}]: it is {angles[place + 1]:g}, after {angles[place]:g}; give angles that rise, by "
                         "1e-9 deg or more")


def _polar_angles(values: Any) -> np.ndarray:
    name, angles = "polar_angles_deg", numbers("polar_angles_deg", values)
    if angles.ndim != 1 or len(angles) < 2:
        raise UsageError(f"{name}: it has the shape {angles.shape}; give a list of at least two angles")
    _rising(name, angles)
    for place in np.flatnonzero((angles < 0.0) | (angles > 180.0)):
        raise UsageError(f"{name}[{place}]: it is {angles[place]:g}; give angles from 0 to 180 deg")
    return angles


def _azimuth_angles(values: Any) -> np.ndarray:
    name, angles = "azimuth_angles_deg", np.atleast_1d(numbers("azimuth_angles_deg", values))
    if angles.ndim != 1 or not len(angles):
        raise UsageError(f"{name}: it has the shape {angles.shape}; give a list of angles, or 0 for a lamp of revolution")
    _rising(name, angles)
    if angles[0] != 0.0:
        raise UsageError(f"{name}[0]: it is {angles[0]:g}; give angles that begin with 0 deg")
    if len(angles) > 1 and angles[-1] not in _ENDS:
        raise UsageError(f"{name}[{len(angles) - 1}]: it is {angles[-1]:g}; give angles that end with 90, 180 or 360 deg, or 0 "
                         "alone for a lamp of revolution")
    return angles


def _rows(values: Any, num_azimuths: int, num_polar: int) -> np.ndarray:
    rows = numbers("intensity", values)
    if rows.ndim == 1 and num_azimuths == 1:
        rows = rows[None]
    if rows.shape != (num_azimuths, num_polar):
        raise UsageError(f"intensity: it has the shape {rows.shape}; give a row for each of {num_azimuths} azimuths, with a "
                         f"number for each of {num_polar} polar angles: {(num_azimuths, num_polar)}")
    for row, column in np.argwhere(rows < 0.0):
        raise UsageError(f"intensity[{row}][{column}]: it is {rows[row, column]:g}; give numbers of 0 or more")
    if not rows.any():
        raise UsageError("intensity: all numbers are 0, and the lamp is dark; give one above 0")
    # A -0 is a 0.
    return rows + 0.0


def _close(rows: np.ndarray) -> None:
    """Make the last row of a full circle the first one, of which it is a repetition."""
    apart = np.abs(rows[-1] - rows[0])
    place = int(np.argmax(apart))
    if apart[place] > _ROUNDING * rows.max():
        raise UsageError(f"intensity[{len(rows) - 1}][{place}]: it is {rows[-1, place]:g} at the azimuth 360, and "
                         f"{rows[0, place]:g} at 0, the same direction; give equal rows")
    rows[-1] = rows[0]
