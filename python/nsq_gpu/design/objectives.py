"""What a design is judged by: numbers of detectors' maps, with what a watt in each pixel adds to them.

Noise adds nothing to squares and higher powers of a map here: they are products of different blocks of rays.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nsq_gpu.arguments import flag, near
from nsq_gpu.design import checking
from nsq_gpu.design.maps import BlockMaps, Maps, by_pairs, by_powers, pairs, powers
from nsq_gpu.errors import ResultWarning, UsageError, warn

#: Light that is a ghost where no mirror is: reflected at least twice, and not scattered.
GHOSTS = "reflections >= 2 and scatterings == 0"
#: Lines of a grid within a pixel, by which the share of a pixel within a circle is found.
_LINES = 16

Adjoints = dict[str, np.ndarray]


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class Objective(ABC):
    """A number of what a detector sees, and what is wanted of it.

    Args:
        detector: Name of an irradiance detector.
        target: Value that is wanted. The merit gains ``(weight * (value - target))**2``.
        min_val: Without a target: least value that is wanted. The merit gains nothing where the value is above.
        max_val: Without a target: largest value that is wanted.
        weight: Weight of what is missing.
        where: Keeps the light whose path matches, such as ``"reflections == 0"``.
        guide: True guides rays towards that light. Derivatives are then found by differences.
        name: Name in logs and tables. None makes one.
    """

    detector: str
    target: float | None = None
    min_val: float | None = None
    max_val: float | None = None
    weight: float = 1.0
    where: str | None = None
    guide: bool = False
    name: str | None = None

    #: Fewest blocks of rays.
    fewest_blocks = 2

    def __post_init__(self) -> None:
        kind = type(self).__name__
        if self.name is not None:
            self._take(name=checking.text(f"{kind}: name", self.name, "a text, or None"))
        self._take(detector=checking.text(f"{self.name or kind}: detector", self.detector, 'the name of a detector, such as "image"'))
        self._take(where=checking.filter_of(f"{self.label}: where", self.where), guide=flag(f"{self.label}: guide", self.guide),
                   weight=checking.number(f"{self.label}: weight", self.weight, "a number of 0 or more", least=0.0))
        for key in ("target", "min_val", "max_val"):
            if getattr(self, key) is not None:
                self._take(**{key: checking.number(f"{self.label}: {key}", getattr(self, key))})
        if self.target is None and self.min_val is None and self.max_val is None:
            raise UsageError(f"{self.label}: say what is wanted: target, min_val or max_val")
        if self.target is not None and (self.min_val is not None or self.max_val is not None):
            raise UsageError(f"{self.label}: give a target, or min_val and max_val, and not both")
        if self.min_val is not None and self.max_val is not None and self.min_val > self.max_val:
            raise UsageError(f"{self.label}: min_val = {self.min_val:g} is larger than max_val = {self.max_val:g}; give the smaller one as "
                             "min_val")
        self._check()

    def _check(self) -> None:  # noqa: B027
        """Take arguments of the kind, or refuse them."""

    def _take(self, **taken: Any) -> None:
        """Keep arguments as they were taken: a number of NumPy's as one of Python's."""
        for key, value in taken.items():
            object.__setattr__(self, key, value)

    @property
    def label(self) -> str:
        """Return the objective's name."""
        kind = "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in type(self).__name__).strip()
        return self.name or f"{kind} on {self.detector}"

    @property
    def has_adjoints(self) -> bool:
        """Return whether rays can be walked back from the objective."""
        return not self.guide

    def missed(self, value: float) -> float:
        """Return by how much a value misses what is wanted: value minus target, or what is beyond a bound."""
        if self.target is not None:
            return value - self.target
        if self.min_val is not None and value < self.min_val:
            return value - self.min_val
        return value - self.max_val if self.max_val is not None and value > self.max_val else 0.0

    def value(self, maps: Maps) -> float:
        """Return the number."""
        return self.value_and_adjoints(maps)[0]

    @abstractmethod
    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        """Return the number, and what it gains by a watt in each pixel of each block, by detector."""


def _shares(maps: BlockMaps, region: Sequence[float] | None, circle: Sequence[float] | None) -> np.ndarray:
    """Return which share of each pixel lies within a region, shape (ny, nx)."""
    width, height = maps.pixel
    if region is not None:
        x0, x1, y0, y1 = region
        along = np.clip((np.minimum(maps.x + width / 2, x1) - np.maximum(maps.x - width / 2, x0)) / width, 0.0, 1.0)
        across = np.clip((np.minimum(maps.y + height / 2, y1) - np.maximum(maps.y - height / 2, y0)) / height, 0.0, 1.0)
        return np.asarray(across[:, None] * along)
    if circle is not None:
        cx, cy, radius = circle
        steps = (np.arange(_LINES) + 0.5) / _LINES - 0.5
        x = (maps.x[:, None] + steps * width).ravel() - cx
        y = (maps.y[:, None] + steps * height).ravel() - cy
        inside = (x**2 + y[:, None]**2 <= radius**2).astype(float)
        return np.asarray(inside.reshape(len(maps.y), _LINES, len(maps.x), _LINES).mean(axis=(1, 3)))
    return np.ones((len(maps.y), len(maps.x)))


def _is_pixels(maps: BlockMaps, kernel: float | None, label: str) -> None:
    """Refuse a kernel that pixels do not resolve."""
    if kernel and kernel < 0.5 * max(maps.pixel):
        raise UsageError(f"{label}: kernel = {kernel:g} mm is less than half of a pixel, {max(maps.pixel):.3g} mm; give a wider one, or "
                         "the detector more pixels")


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class _InRegion(Objective):
    """An objective of a part of a detector.

    Args:
        region: Rectangle (x0, x1, y0, y1) of the detector [mm]. None takes the whole detector.
        circle: Circle (x, y, radius) of the detector [mm], in place of a rectangle.
    """

    region: Sequence[float] | None = None
    circle: Sequence[float] | None = None

    def _check(self) -> None:
        for key, count, example in (("region", 4, "(-5, 5, -5, 5)"), ("circle", 3, "(0, 0, 5)")):
            if getattr(self, key) is not None:
                wanted = f"{count} numbers [mm], such as {example}"
                self._take(**{key: checking.numbers(f"{self.label}: {key}", getattr(self, key), count, wanted)})
        if self.region is not None and self.circle is not None:
            raise UsageError(f"{self.label}: give a region or a circle, and not both")
        if self.region is not None and not (self.region[0] < self.region[1] and self.region[2] < self.region[3]):
            raise UsageError(f"{self.label}: region is {self.region!r}; give (x0, x1, y0, y1) with x0 < x1 and y0 < y1")
        if self.circle is not None and not self.circle[2] > 0.0:
            raise UsageError(f"{self.label}: the circle's radius is {self.circle[2]!r}; give more than 0 mm")

    def shares(self, maps: BlockMaps) -> np.ndarray:
        """Return which share of each pixel counts."""
        shares = _shares(maps, self.region, self.circle)
        if not shares.any():
            raise UsageError(f"{self.label}: the region lies beside the detector, which reaches from x = {maps.x[0]:.4g} to "
                             f"{maps.x[-1]:.4g} mm and from y = {maps.y[0]:.4g} to {maps.y[-1]:.4g} mm")
        return shares


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class Flux(_InRegion):
    """Flux in a region of a detector [W].

    >>> Flux(detector="screen", region=(-5, 5, -5, 5), target=1.0)

    It is linear in the map, so noise adds nothing to it.
    """

    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        of = maps[self.detector]
        shares = self.shares(of)
        return float((of.mean * shares).sum()), {self.detector: np.broadcast_to(shares / of.num_blocks, of.flux.shape)}


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class Uniformity(_InRegion):
    """How even the light in a region is: the square of the mean irradiance over the mean of its square.

    1 is even light. Near 1 it is 1 - c^2, where c is the standard deviation over the mean. Light that fills half of the region
    evenly has 1/2. Noise of pixels adds nothing to the mean of squares, which is a mean of products of different blocks of rays.
    So the value may be a little above 1.

    >>> Uniformity(detector="screen", region=(-5, 5, -5, 5), target=1.0)

    Args:
        kernel: Width of a Gaussian by which the map is blurred first [mm]; None blurs by pixels alone. What it spreads beyond the
            detector is lost, so a rim that is lit looks darker than it is. Let the region end two widths before the rim.
    """

    kernel: float | None = None

    def _check(self) -> None:
        super()._check()
        if self.kernel is not None:
            wanted = "the width of a Gaussian, 0 mm or more, or None"
            self._take(kernel=checking.number(f"{self.label}: kernel", self.kernel, wanted, least=0.0))

    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        of = maps[self.detector]
        _is_pixels(of, self.kernel, self.label)
        shares = self.shares(of)
        x = of.blurred(self.kernel)
        sums = (x * shares).sum(axis=(1, 2))
        area = float(shares.sum())
        square, mean_square = float(pairs(sums, sums)), float((pairs(x, x) * shares).sum())
        if mean_square <= 0.0:
            return 0.0, {self.detector: np.zeros_like(of.flux)}
        value = square / (area * mean_square)
        # Each product counts twice: by its first factor, and by its second.
        adjoint = 2.0 * (by_pairs(sums)[:, None, None] * shares / (area * mean_square)
                         - value / mean_square * by_pairs(x) * shares)
        return value, {self.detector: of.spread_by(adjoint, self.kernel)}


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class RmsRadius(Objective):
    """Root mean square distance of the light from its centroid [mm].

    What pixels add to the mean square is taken off, and noise of the centroid adds nothing. A radius of less than a pixel is
    known badly: ResultWarning says so.
    """

    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        of = maps[self.detector]
        x, y = of.x[None, :], of.y[:, None]
        basis = [np.ones_like(x * y), x + 0.0 * y, y + 0.0 * x, x**2 + y**2]
        sums = [(of.flux * weights).sum(axis=(1, 2)) for weights in basis]
        flux, sum_x, sum_y, squares = sums
        whole = float(pairs(flux, flux))
        if whole <= 0.0:
            return float("nan"), {self.detector: np.zeros_like(of.flux)}
        top = float(pairs(squares, flux) - pairs(sum_x, sum_x) - pairs(sum_y, sum_y))
        square = top / whole - of.spread
        pixel = of.pixel[0]**2 + of.pixel[1]**2
        if square < 0.5 * pixel:
            warn(f"{self.label}: the light's radius is less than a pixel, {max(of.pixel):.3g} mm, and known to a pixel alone; give "
                 "the detector smaller pixels", ResultWarning)
        # The radius of a small spot is at least a thousandth of a pixel, and does not change there.
        least = 1e-6 * pixel
        if square < least:
            return float(np.sqrt(least)), {self.detector: np.zeros_like(of.flux)}
        value = float(np.sqrt(square))
        by = [by_pairs(squares) / whole - 2.0 * top / whole**2 * by_pairs(flux), -2.0 * by_pairs(sum_x) / whole,
              -2.0 * by_pairs(sum_y) / whole, by_pairs(flux) / whole]
        adjoint = sum(factor[:, None, None] * weights for factor, weights in zip(by, basis, strict=True))
        return value, {self.detector: np.asarray(adjoint) / (2.0 * value)}


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class EncircledEnergy(Objective):
    """Share of the light within a circle about its centroid.

    The circle's rim is a pixel wide, in which a pixel counts in part.

    Args:
        radius: Radius of the circle [mm].
        centre: Middle of the circle [mm]. None takes the light's centroid.
    """

    radius: float = 0.0
    centre: tuple[float, float] | None = None

    def _check(self) -> None:
        self._take(radius=checking.number(f"{self.label}: radius", self.radius, "more than 0 mm", above=0.0))
        if self.centre is not None:
            self._take(centre=checking.numbers(f"{self.label}: centre", self.centre, 2, "2 numbers [mm], such as (0, 0), or None"))

    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        of = maps[self.detector]
        mean, x, y = of.mean, of.x[None, :], of.y[:, None]
        flux = float(mean.sum())
        if flux <= 0.0:
            return 0.0, {self.detector: np.zeros_like(of.flux)}
        rim = max(of.pixel)
        cx, cy = self.centre or (float((mean * x).sum()) / flux, float((mean * y).sum()) / flux)
        apart = np.maximum(np.hypot(x - cx, y - cy), 1e-300)
        inside = np.clip((self.radius - apart) / rim + 0.5, 0.0, 1.0)
        value = float((mean * inside).sum()) / flux
        adjoint = (inside - value) / flux
        if self.centre is None:
            at_rim = mean * ((inside > 0.0) & (inside < 1.0)) / (rim * apart) / flux
            by_cx, by_cy = float((at_rim * (x - cx)).sum()), float((at_rim * (y - cy)).sum())
            adjoint = adjoint + (by_cx * (x - cx) + by_cy * (y - cy)) / flux
        return value, {self.detector: np.broadcast_to(adjoint / of.num_blocks, of.flux.shape)}


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class MatchMap(Objective):
    """How far a map is from a wanted one: the sum of squares of what is missing, over the wanted map's sum of squares.

    0 is a match. Noise adds nothing, so the value may be a little below 0.

    Args:
        wanted: The map that is wanted, in the detector's shape, in W/mm^2 or, with ``shape``, in any unit.
        shape: True compares shapes: both maps are divided by their sums first.
    """

    wanted: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)), compare=False)
    shape: bool = True

    def _check(self) -> None:
        wanted = checking.array(f"{self.label}: wanted", self.wanted, "an array of numbers in the detector's shape", "biuf")
        self._take(wanted=wanted, shape=flag(f"{self.label}: shape", self.shape))
        if wanted.ndim != 2 or not np.isfinite(wanted).all() or not wanted.any():
            raise UsageError(f"{self.label}: wanted has no finite map; give an array in the detector's shape")
        if self.shape and not wanted.sum() > 0.0:
            raise UsageError(f"{self.label}: the sum of wanted is {wanted.sum():g}; give a map whose sum is more than 0, or shape=False")

    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        of = maps[self.detector]
        wanted = self.wanted
        if wanted.shape != of.flux.shape[1:]:
            raise UsageError(f"{self.label}: wanted has the shape {wanted.shape}, and the detector has {of.flux.shape[1:]}")
        wanted = wanted / wanted.sum() if self.shape else wanted * of.area
        norm, count = float((wanted**2).sum()), of.num_blocks
        x = of.flux
        if not self.shape:
            value = float((pairs(x, x) - 2.0 * x.mean(axis=0) * wanted).sum()) / norm + 1.0
            return value, {self.detector: 2.0 * (by_pairs(x) - wanted / count) / norm}
        sums = x.sum(axis=(1, 2))
        flux, squares = float(sums.mean()), float(pairs(sums, sums))
        if squares <= 0.0:
            return 1.0, {self.detector: np.zeros_like(x)}
        own, common = float(pairs(x, x).sum()), float((x.mean(axis=0) * wanted).sum())
        value = (own / squares - 2.0 * common / flux) / norm + 1.0
        by_sums = -own / squares**2 * 2.0 * by_pairs(sums) + 2.0 * common / flux**2 / count
        adjoint = (2.0 * by_pairs(x) / squares + by_sums[:, None, None] - 2.0 * wanted / flux / count) / norm
        return value, {self.detector: adjoint}


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class Peak(_InRegion):
    """The brightest place after a Gaussian kernel, as a mean that is smooth [W/mm^2].

    It is the sum of E^p over the sum of E^(p-1), with p = ``order``, where E is the irradiance after the kernel. It is never above
    the largest E. Of a flat spot it is the irradiance, of a Gaussian one (p - 1) / p of it. A maximum is too large
    by its noise. Here each power is a mean of products of different blocks of rays, to which noise adds nothing.

    Args:
        kernel: Width (sigma) of the Gaussian [mm]. What it spreads beyond the detector is lost, so a rim that is lit looks darker
            than it is.
        order: p, 2 or more; at most the number of blocks.
    """

    kernel: float | None = None
    order: int = 8

    def _check(self) -> None:
        super()._check()
        kernel = checking.number(f"{self.label}: kernel", self.kernel, "the width of the Gaussian, more than 0 mm", above=0.0)
        self._take(kernel=kernel, order=checking.whole(f"{self.label}: order", self.order, 2))

    @property
    def fewest_blocks(self) -> int:  # type: ignore[override]
        """Return the fewest blocks: one for each factor, and one that is left out for a standard error."""
        return self.order + 1

    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        return self._found(maps, True)

    def value(self, maps: Maps) -> float:
        return self._found(maps, False)[0]

    def _found(self, maps: Maps, is_walked_back: bool) -> tuple[float, Adjoints]:
        of = maps[self.detector]
        _is_pixels(of, self.kernel, self.label)
        shares = self.shares(of)
        x = of.blurred(self.kernel) / of.area
        scale = float(x.mean(axis=0).max())
        if scale <= 0.0:
            return 0.0, {self.detector: np.zeros_like(of.flux)}
        x = x / scale
        found = powers(x, self.order)
        top, bottom = (float((found[order] * shares).sum()) for order in (self.order, self.order - 1))
        if bottom <= 0.0:
            # Too few rays: no place has light of so many blocks.
            return float("nan"), {self.detector: np.zeros_like(of.flux)}
        value = top / bottom
        if not is_walked_back:
            return value * scale, {}
        adjoint = (by_powers(x, self.order) - value * by_powers(x, self.order - 1)) * shares / bottom
        return value * scale, {self.detector: of.spread_by(adjoint, self.kernel) / of.area}


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class GhostFlux(Flux):
    """Flux of ghosts [W]: light that was reflected at least twice, and not scattered. Rays are guided towards it."""

    where: str | None = GHOSTS
    guide: bool = True


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class GhostPeak(Peak):
    """The brightest place of ghosts [W/mm^2], as :class:`Peak` has it. Rays are guided towards them."""

    where: str | None = GHOSTS
    guide: bool = True


@checking.by_names
@dataclass(frozen=True, kw_only=True)
class TorchFunction(Objective):
    """Any function of a detector's map, in Torch: it takes the irradiance [W/mm^2] as a tensor, and returns a number.

    A function that is not linear in the map is moved by noise. ``Estimate.bias`` says about how much.

    >>> TorchFunction(detector="screen", function=lambda map: (map[8:24] ** 0.5).mean(), target=1.0)
    """

    function: Any = field(default=None, compare=False)

    def _check(self) -> None:
        checking.function(f"{self.label}: function", self.function, "lambda map: map.sum()")

    def value_and_adjoints(self, maps: Maps) -> tuple[float, Adjoints]:
        import torch

        of = maps[self.detector]
        map_ = torch.tensor(of.mean / of.area, dtype=torch.float64, requires_grad=True)
        with torch.enable_grad():
            value = self.function(map_)
            if not isinstance(value, torch.Tensor) or value.numel() != 1:
                raise UsageError(f"{self.label}: the function returned {type(value).__name__}; it must return one number of a tensor")
            adjoint = torch.autograd.grad(value, map_, allow_unused=True)[0] if value.requires_grad else None
        slope = np.zeros_like(of.mean) if adjoint is None else adjoint.numpy()
        return float(value.detach()), {self.detector: np.broadcast_to(slope / of.area / of.num_blocks, of.flux.shape)}


def merit(objectives: Sequence[Objective], values: Sequence[float]) -> float:
    """Return the merit of values: the sum of squares of what is missed, each with its weight."""
    return float(sum((of.weight * of.missed(value))**2 for of, value in zip(objectives, values, strict=True)))


def check_objectives(given: Any, detectors: Mapping[str, str]) -> list[Objective]:
    """Return objectives, each of a detector with a map; refuse others by name."""
    listed = checking.listed(given)
    listed = [given] if listed is None else listed
    if not listed:
        raise UsageError('operands is empty; give one at least, such as nsq_gpu.design.Flux(detector="screen", target=1.0)')
    for of in listed:
        if not isinstance(of, Objective):
            raise UsageError(f"operands has {of!r}; give operands of nsq_gpu.design, such as Flux(detector=\"screen\", target=1.0)")
        if of.detector not in detectors:
            raise UsageError(f"{of.label}: the scene has no detector {of.detector!r}; {near(of.detector, detectors)}")
        if detectors[of.detector] != "irradiance":
            raise UsageError(f"{of.label}: {of.detector} is a detector of the kind {detectors[of.detector]!r}; operands take irradiance detectors")
    return listed
