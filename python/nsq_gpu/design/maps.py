"""Maps by blocks of rays, and what keeps noise out of a number that is computed from them.

A trace of N rays is K blocks of N / K rays, each with a seed of its own. So a power of a map is a product of different blocks. Noise
of different blocks is independent, and adds nothing to such a product on average.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import comb
from typing import Any

import numpy as np

#: Fewest blocks whose spread says something of a standard error.
FEWEST_BLOCKS = 4
#: Widths of a Gaussian after which it is cut.
_WIDTHS = 5.0


@dataclass(frozen=True)
class BlockMaps:
    """The maps of a detector by block of rays. Each block's map is an estimate of the whole light."""

    #: Flux in each pixel [W], shape (K, ny, nx).
    flux: np.ndarray
    #: Middles of the pixels [mm], shapes (nx,) and (ny,).
    x: np.ndarray
    y: np.ndarray
    #: Width and height of a pixel [mm].
    pixel: tuple[float, float]
    #: How a ray's light is spread over pixels: ``"bilinear"``, ``"gaussian"`` or ``"hard"``.
    splat: str = "bilinear"
    #: Width of a Gaussian splat [pixels].
    splat_sigma: float = 0.0
    #: The same flux after Gaussians, by their widths [mm]; filled when it is asked for.
    _blurred: dict[float, np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    @property
    def num_blocks(self) -> int:
        """Return how many blocks there are."""
        return len(self.flux)

    @property
    def area(self) -> float:
        """Return the area of a pixel [mm^2]."""
        return self.pixel[0] * self.pixel[1]

    @property
    def mean(self) -> np.ndarray:
        """Return the map of all rays [W]."""
        return np.asarray(self.flux.mean(axis=0))

    @property
    def spread(self) -> float:
        """Return what pixels and splats add to the mean square of x plus the mean square of y [mm^2].

        A hard pixel adds a twelfth of its square, and linear weights add another one (Sheppard, 1898). A Gaussian splat adds
        the mean square of its weights, which end after three widths.
        """
        squares = self.pixel[0]**2 + self.pixel[1]**2
        found = {"hard": 1.0 / 12.0, "bilinear": 1.0 / 6.0}.get(self.splat)
        return squares * (_square_of_gaussian(self.splat_sigma) if found is None else found)

    def without(self, block: int) -> BlockMaps:
        """Return all blocks but one."""
        blurred = {width: np.delete(flux, block, axis=0) for width, flux in self._blurred.items()}
        return replace(self, flux=np.delete(self.flux, block, axis=0), _blurred=blurred)

    def blurred(self, kernel: float | None) -> np.ndarray:
        """Return the flux after a Gaussian of the width ``kernel`` [mm]."""
        if not kernel:
            return self.flux
        if kernel not in self._blurred:
            self._blurred[kernel] = self.spread_by(self.flux, kernel)
        return self._blurred[kernel]

    def spread_by(self, pixels: np.ndarray, kernel: float | None) -> np.ndarray:
        """Return pixels after a Gaussian; what it spreads beyond the detector is lost. It is its own transpose."""
        if not kernel:
            return pixels
        for axis, step in ((-1, self.pixel[0]), (-2, self.pixel[1])):
            pixels = _along(pixels, axis, kernel / step)
        return pixels

    def added(self, other: BlockMaps) -> BlockMaps:
        """Return the light of two traces together."""
        return replace(self, flux=self.flux + other.flux, _blurred={})


@functools.cache
def _square_of_gaussian(width: float) -> float:
    """Return the mean square of a Gaussian splat about the hit, of a width in pixels, over all places of the hit in its pixel."""
    reach = int(np.ceil(3.0 * width))
    # The window lies about the pixel whose middle is the last one before the hit.
    away = np.arange(-reach, reach + 1) - (np.arange(1000)[:, None] + 0.5) / 1000
    weights = np.exp(-0.5 * (away / width)**2)
    return float(np.mean((weights * away**2).sum(axis=1) / weights.sum(axis=1)))


def _along(pixels: np.ndarray, axis: int, width: float) -> np.ndarray:
    """Return pixels after a Gaussian along an axis, of a width in pixels.

    Sums of shifted arrays take one thread. Products of small matrices wait for threads where other programs run.
    """
    count = pixels.shape[axis]
    weights = np.exp(-0.5 * (np.arange(int(_WIDTHS * width) + 2) / width)**2)
    weights /= weights[0] + 2.0 * weights[1:].sum()
    moved = np.moveaxis(pixels, axis, 0)
    found = weights[0] * moved
    for shift, weight in enumerate(weights[1:count], 1):
        found[shift:] += weight * moved[:-shift]
        found[:-shift] += weight * moved[shift:]
    return np.moveaxis(found, 0, axis)


Maps = dict[str, BlockMaps]


def pairs(a: np.ndarray, b: np.ndarray) -> Any:
    """Return the mean of the products of ``a`` and ``b`` of different blocks, along the first axis."""
    count = len(a)
    return (a.sum(axis=0) * b.sum(axis=0) - (a * b).sum(axis=0)) / (count * (count - 1))


def by_pairs(b: np.ndarray) -> np.ndarray:
    """Return the derivative of :func:`pairs` by its first argument."""
    count = len(b)
    return np.asarray((b.sum(axis=0) - b) / (count * (count - 1)))


def powers(x: np.ndarray, most: int) -> list[np.ndarray]:
    """Return the powers 0 to ``most`` of a mean over blocks, each from products of different blocks.

    Such a power is an elementary symmetric polynomial over the number of its products. Its mean is the power of the mean.
    """
    count = len(x)
    sums = [np.ones_like(x[0]), *(np.zeros_like(x[0]) for _ in range(most))]
    for block in x:
        for order in range(most, 0, -1):
            sums[order] = sums[order] + block * sums[order - 1]
    return [found / comb(count, order) for order, found in enumerate(sums)]


def by_powers(x: np.ndarray, order: int) -> np.ndarray:
    """Return the derivative of the power ``order`` of :func:`powers` by each block."""
    count = len(x)
    found = np.empty_like(x)
    for block in range(count):
        others = powers(np.delete(x, block, axis=0), order - 1)[order - 1]
        found[block] = others * comb(count - 1, order - 1) / comb(count, order)
    return found


@dataclass(frozen=True)
class Estimate:
    """A number of a trace, with what is known of its noise."""

    value: float
    #: Standard error, from the spread between blocks of rays.
    standard_error: float
    #: About how much noise has added to the value; it is not taken off.
    bias: float = 0.0

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        return f"{self.value:.6g} ± {self.standard_error:.2g}"


def jackknife(value: float, others: np.ndarray) -> Estimate:
    """Return an estimate from its value and the values without one block each (Efron and Stein, 1981)."""
    return Estimate(value, float(jackknife_errors(others)), (len(others) - 1) * (float(np.mean(others)) - value))


def jackknife_errors(others: np.ndarray) -> Any:
    """Return standard errors from values without one block each, along the first axis."""
    count = len(others)
    return np.sqrt((count - 1) / count * ((others - others.mean(axis=0))**2).sum(axis=0))


def estimate(function: Callable[[Maps], float], maps: Maps) -> Estimate:
    """Return what a function makes of maps, with a standard error."""
    count = min(of.num_blocks for of in maps.values())
    others = np.array([function({name: of.without(block) for name, of in maps.items()}) for block in range(count)])
    return jackknife(function(maps), others)
