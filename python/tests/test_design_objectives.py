"""What a design is judged by: no bias of noise, adjoints that are those of differences, and standard errors that hold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from nsq_gpu.design.maps import BlockMaps, Estimate, estimate, pairs, powers
from nsq_gpu.design.objectives import EncircledEnergy, Flux, MatchMap, Objective, Peak, RmsRadius, Uniformity, merit
from tests.live import cs

pytestmark = pytest.mark.in_turn

X = (np.arange(24) - 11.5) * 0.5
Y = (np.arange(20) - 9.5) * 0.5


def truth() -> np.ndarray:
    """Return a map of two spots [W]."""
    one = np.exp(-((X - 1.0)**2 + (Y[:, None] + 0.5)**2) / (2 * 1.5**2))
    return one + 0.4 * np.exp(-((X + 2.5)**2 + (Y[:, None] - 1.0)**2) / (2 * 1.0**2)) + 0.02


def noisy(rng: np.random.Generator, blocks: int, rays: float) -> dict[str, BlockMaps]:
    """Return maps by blocks with the noise of so many rays a block."""
    mean = truth()
    weight = mean.sum() / rays
    return {"d": BlockMaps(rng.poisson(mean / weight, (blocks, *mean.shape)) * weight, X, Y, (0.5, 0.5), "hard")}


def exact(blocks: int = 10) -> dict[str, BlockMaps]:
    return {"d": BlockMaps(np.broadcast_to(truth(), (blocks, *truth().shape)).copy(), X, Y, (0.5, 0.5), "hard")}


WANTED = 1.0 + 0.1 * (X + Y[:, None])**2
OBJECTIVES: dict[str, Callable[[], Objective]] = {
    "flux": lambda: Flux(detector="d", target=0),
    "flux in a region": lambda: Flux(detector="d", target=0, region=(-2.3, 1.1, -1.0, 2.2)),
    "flux in a circle": lambda: Flux(detector="d", target=0, circle=(0.5, 0.0, 2.2)),
    "uniformity": lambda: Uniformity(detector="d", target=1, circle=(0.0, 0.0, 3.0)),
    "uniformity after a kernel": lambda: Uniformity(detector="d", target=1, kernel=0.7),
    "rms radius": lambda: RmsRadius(detector="d", target=0),
    "encircled energy": lambda: EncircledEnergy(detector="d", target=1, radius=2.0),
    "encircled energy about a point": lambda: EncircledEnergy(detector="d", target=1, radius=2.0, centre=(0.0, 0.0)),
    "match of shapes": lambda: MatchMap(detector="d", target=0, wanted=WANTED),
    "match": lambda: MatchMap(detector="d", target=0, wanted=WANTED, shape=False),
    "peak": lambda: Peak(detector="d", target=0, kernel=0.6, order=6),
    "peak in a region": lambda: Peak(detector="d", target=0, kernel=0.6, order=4, region=(-4.0, -1.0, -1.0, 3.0)),
}
#: Those whose value does not depend on how noisy the map is; the others are known to a part of their error.
OF_RATIOS = {"encircled energy"}


@pytest.mark.parametrize("name", OBJECTIVES)
def test_adjoints_are_those_of_differences(name: str) -> None:
    rng = np.random.default_rng(3)
    objective, maps = OBJECTIVES[name](), noisy(rng, 10, 3e5)
    _, adjoints = objective.value_and_adjoints(maps)
    direction = rng.normal(size=maps["d"].flux.shape) * maps["d"].flux.mean()
    sides = []
    for side in (-1e-5, 1e-5):
        moved = BlockMaps(maps["d"].flux + side * direction, X, Y, (0.5, 0.5), "hard")
        sides.append(objective.value({"d": moved}))
    found = float((adjoints["d"] * direction).sum())
    assert found == pytest.approx((sides[1] - sides[0]) / 2e-5, rel=2e-5, abs=1e-12)


@pytest.mark.parametrize("name", OBJECTIVES)
def test_noise_adds_nothing(name: str) -> None:
    rng = np.random.default_rng(4)
    objective = OBJECTIVES[name]()
    expected = objective.value(exact())
    found = [estimate(objective.value, noisy(rng, 10, 1500.0)) for _ in range(300)]
    values = np.array([each.value for each in found])
    error = values.std() / np.sqrt(len(values))
    # What is left is of second order in the noise of sums; the estimate says how much.
    left = abs(np.mean([each.bias for each in found]))
    assert abs(values.mean() - expected) < 4 * error + 2.0 * left
    assert abs(values.mean() - expected) < 0.5 * values.std()


@pytest.mark.parametrize("name", OBJECTIVES)
def test_standard_errors_are_the_spread_over_seeds(name: str) -> None:
    rng = np.random.default_rng(5)
    objective = OBJECTIVES[name]()
    found = [estimate(objective.value, noisy(rng, 12, 4000.0)) for _ in range(300)]
    values, errors = np.array([(each.value, each.standard_error) for each in found]).T
    assert np.sqrt((errors**2).mean()) == pytest.approx(values.std(), rel=0.15)
    # Student's t with 11 degrees of freedom: 95 % lie within 2.20.
    held = (np.abs(values - values.mean()) < 2.2 * errors).mean()
    assert 0.90 < held < 0.99


def test_a_plain_maximum_and_a_plain_variance_are_too_large_by_noise() -> None:
    """The fault that products of blocks keep out is there without them, and larger than ten standard errors."""
    rng = np.random.default_rng(6)
    smooth = Peak(detector="d", target=0, kernel=0.6, order=6)
    even = Uniformity(detector="d", target=1, circle=(0.0, 0.0, 3.0))
    values: dict[str, list[float]] = {name: [] for name in ("peak", "maximum", "even", "plain")}
    inside = even.shares(exact()["d"])
    for _ in range(200):
        maps = noisy(rng, 10, 300.0)
        mean = maps["d"].mean
        values["peak"].append(smooth.value(maps))
        values["maximum"].append(mean.max())
        values["even"].append(even.value(maps))
        values["plain"].append((mean * inside).sum()**2 / (inside.sum() * (mean**2 * inside).sum()))
    exactly = {"peak": smooth.value(exact()), "maximum": truth().max(), "even": even.value(exact()), "plain": even.value(exact())}
    apart = {name: (np.mean(found) - exactly[name]) / (np.std(found) / np.sqrt(200)) for name, found in values.items()}
    assert abs(apart["peak"]) < 4 and abs(apart["even"]) < 4
    assert apart["maximum"] > 10 and apart["plain"] < -10


def test_powers_are_products_of_different_blocks() -> None:
    x = np.array([[2.0], [3.0], [5.0], [7.0]])
    found = [float(power[0]) for power in powers(x, 3)]
    assert found == pytest.approx([1.0, 17 / 4, (6 + 10 + 14 + 15 + 21 + 35) / 6, (30 + 42 + 70 + 105) / 4])
    assert float(pairs(x, x)[0]) == pytest.approx(found[2])


@pytest.mark.parametrize(("splat", "width"), [("hard", 0.5), ("bilinear", 0.5), ("gaussian", 0.3), ("gaussian", 0.5), ("gaussian", 1.0), ("gaussian", 2.0)])
def test_the_radius_of_a_disk_does_not_depend_on_the_splat(splat: str, width: float) -> None:
    radius = 6.3
    scene = NSQScene()
    scene.add_source("beam", cs(x=0.31, y=-0.17, z=-10.0), CollimatedSourceConfig(Spectrum([0.5], [1.0]), aperture_radius=radius))
    scene.add_detector("d", cs(), IrradianceDetectorConfig(48.0, 48.0, 48, 48, splat=splat, splat_sigma=width))
    problem = nsq_gpu.Problem(scene, {"beam.x": (-2.0, 2.0)}, RmsRadius(detector="d", target=0), num_rays=200_000, seed=1)
    found, = problem.value().operands.values()
    assert found.standard_error < 5e-3 and abs(found.value - radius / np.sqrt(2)) < 4.0 * found.standard_error


def test_figures_are_those_of_their_formulas() -> None:
    gaussian = np.exp(-(X**2 + Y[:, None]**2) / (2 * 0.8**2))
    gaussian /= gaussian.sum()
    maps = {"d": BlockMaps(np.broadcast_to(gaussian, (9, *gaussian.shape)).copy(), X, Y, (0.5, 0.5), "hard")}
    # Values at the middles of pixels have no spread of pixels, which is taken off.
    assert RmsRadius(detector="d", target=0).value(maps) == pytest.approx(np.sqrt(2 * 0.8**2 - maps["d"].spread), rel=1e-3)
    peak = Peak(detector="d", target=0, kernel=0.5, order=5).value(maps)
    assert peak == pytest.approx(4 / 5 / (2 * np.pi * (0.8**2 + 0.5**2)), rel=1e-3)
    even = Uniformity(detector="d", target=0).value(maps)
    assert even == pytest.approx(4 * np.pi * 0.8**2 / (12.0 * 10.0), rel=1e-3)
    fine = (np.arange(120) - 59.5) * 0.1
    narrow = np.exp(-(fine**2 + fine[:, None]**2) / (2 * 0.8**2))
    finer = {"d": BlockMaps(np.broadcast_to(narrow, (9, *narrow.shape)).copy(), fine, fine, (0.1, 0.1), "hard")}
    inside = EncircledEnergy(detector="d", target=0, radius=1.2).value(finer)
    assert inside == pytest.approx(1 - np.exp(-1.2**2 / (2 * 0.8**2)), abs=1e-3)
    assert Flux(detector="d", target=0, region=(0, 6, -5, 5)).value(maps) == pytest.approx(0.5, rel=1e-6)
    assert MatchMap(detector="d", target=0, wanted=7.0 * gaussian).value(maps) == pytest.approx(0.0, abs=1e-12)
    assert MatchMap(detector="d", target=0, wanted=gaussian / 0.25, shape=False).value(maps) == pytest.approx(0.0, abs=1e-12)


def test_a_merit_is_the_sum_of_squares_of_what_is_missed() -> None:
    objectives = [Flux(detector="d", target=2.0, weight=3.0), Flux(detector="d", max_val=1.0), Flux(detector="d", min_val=0.0, max_val=4.0)]
    assert merit(objectives, [1.0, 1.5, 2.0]) == pytest.approx(9.0 + 0.25)


@pytest.mark.parametrize(("make", "said"), [
    (lambda: Flux(detector="d"), "say what is wanted"),
    (lambda: Flux(detector="d", target=1, max_val=2), "not both"),
    (lambda: Flux(detector="d", min_val=3, max_val=2), "larger than max_val"),
    (lambda: Flux(detector="d", target=float("nan")), "target is nan"),
    (lambda: Flux(detector="d", target=1, region=(1, 0, 0, 1)), "x0 < x1"),
    (lambda: Flux(detector="d", target=1, region=(0, 1, 0, 1), circle=(0, 0, 1)), "not both"),
    (lambda: Flux(detector="d", target=1, circle=(0, 0, 0)), "more than 0 mm"),
    (lambda: EncircledEnergy(detector="d", target=1), "radius is 0.0"),
    (lambda: Peak(detector="d", target=1), "kernel is None"),
    (lambda: MatchMap(detector="d", target=0), "no finite map"),
])
def test_what_makes_no_sense_is_refused(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=said):
        make()


def test_an_estimate_is_a_number_with_an_error() -> None:
    assert float(Estimate(1.5, 0.25)) == 1.5 and str(Estimate(1.5, 0.25)) == "1.5 ± 0.25"


def test_a_spot_of_no_size_has_no_slope() -> None:
    """Its radius stays at the least one, so no pixel changes it."""
    flux = np.zeros((8, len(Y), len(X)))
    flux[:, 10, 12] = 1.0
    with pytest.warns(nsq_gpu.ResultWarning, match="less than a pixel"):
        value, adjoints = RmsRadius(detector="d", target=0).value_and_adjoints({"d": BlockMaps(flux, X, Y, (0.5, 0.5), "bilinear")})
    assert value == pytest.approx(1e-3 * np.hypot(0.5, 0.5)) and not adjoints["d"].any()
