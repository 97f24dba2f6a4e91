"""``Problem``: gradients against differences, standard errors that hold, designs with a known optimum, stops and restarts."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.materials import IdealMaterial
from optiland.nonsequential import LensConfig, NSQMaterial, NSQScene
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig, IrradianceDetectorConfig
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from nsq_gpu.design import Design, EncircledEnergy, Flux, GhostFlux, GhostPeak, Log, MatchMap, Objective, Peak, RmsRadius, Step, Uniformity
from nsq_gpu.design.minimizing import METHODS, is_noise
from tests import live
from tests.live import cs

pytestmark = pytest.mark.in_turn

DIRECT = "reflections == 0"


@pytest.fixture(autouse=True)
def program(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("NSQ_GPU_BINARY", live.binary())
    with live.quiet():
        yield


def singlet(r1: float = 60.0, z: float = 52.0, splat: str = "bilinear", width: float = 4.0, beam: float = 8.0) -> NSQScene:
    """Return a lens in parallel light, whose rim the light keeps clear of, and a screen before its focus."""
    scene = NSQScene()
    glass = NSQMaterial(IdealMaterial(1.5168))
    scene.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(Spectrum([0.55], [1.0]), aperture_radius=beam))
    scene.add_lens("L", cs(), LensConfig(r1, -60.0, 5.0, glass, 14.0))
    scene.add_detector("image", cs(z=z), IrradianceDetectorConfig(width, width, 64, 64, splat=splat))
    return scene


def problem(*operands: Objective, scene: NSQScene | None = None, variables: Any = None, **options: Any) -> nsq_gpu.Problem:
    return nsq_gpu.Problem(scene or singlet(), variables or {"image.z": (50.0, 56.0), "L.r1": (55.0, 66.0)},
                           operands or (RmsRadius(detector="image", target=0, where=DIRECT),), **{"num_rays": 8000, **options})


SMOOTH = {
    "flux": Flux(detector="image", target=2.0, circle=(0.0, 0.0, 0.9), where=DIRECT),
    "uniformity": Uniformity(detector="image", target=1.0, kernel=0.1),
    "rms radius": RmsRadius(detector="image", target=0.0, where=DIRECT),
    "encircled energy": EncircledEnergy(detector="image", target=1.0, radius=0.8),
    "match": MatchMap(detector="image", target=0.0, wanted=np.hypot(*np.mgrid[-1:1:64j, -1:1:64j]) < 0.5),
    "peak": Peak(detector="image", target=0.0, kernel=0.1, order=4),
}


# Values and gradients


@pytest.mark.parametrize("name", SMOOTH)
def test_gradients_of_both_kinds_agree(name: str) -> None:
    """Rays that are walked back give what a difference of two traces by the same draws gives, and so do the errors."""
    walked = problem(SMOOTH[name], gradient="reverse").gradient()
    differences = problem(SMOOTH[name], gradient="differences", step=0.004).gradient()
    assert walked.found_by == ["reverse"] * 2 and differences.found_by == ["differences"] * 2
    # Decisions that change make the difference noisier; its error says by how much.
    sigma = np.hypot(walked.standard_errors, differences.standard_errors)
    assert (np.abs(walked.values - differences.values) < 3 * sigma).all()
    np.testing.assert_allclose(walked.values, differences.values, rtol=0.05, atol=2 * sigma.max() * 0.2)
    assert (np.abs(walked.values) > 3 * walked.standard_errors).any()


@pytest.mark.parametrize("gradient", ["reverse", "differences"])
def test_errors_of_values_and_gradients_are_their_spread_over_seeds(gradient: str) -> None:
    """Two operands, so that the adjoints are noisy, too."""
    found = []
    for seed in range(24):
        one = problem(SMOOTH["flux"], SMOOTH["rms radius"], seed=seed, gradient=gradient, num_rays=2000, variables={"image.z": (50.0, 56.0)})
        value, slope = one.value(), one.gradient()
        found.append((value.value, value.standard_error, slope.values[0], slope.standard_errors[0]))
    values, errors, slopes, slope_errors = np.array(found).T
    for numbers, their in ((values, errors), (slopes, slope_errors)):
        # A spread over 24 seeds is known to 15 %, a root mean square of errors of ten blocks to 4 %.
        assert np.sqrt((their**2).mean()) == pytest.approx(numbers.std(ddof=1), rel=0.45)
        # Student's t with nine degrees of freedom: 95 % lie within 2.26.
        assert (np.abs(numbers - numbers.mean()) < 2.26 * their).mean() >= 0.83


def test_a_merit_is_that_of_its_operands() -> None:
    found = problem(Flux(detector="image", target=2.0, weight=3.0), Flux(detector="image", max_val=0.5, name="too much")).value()
    flux = found.operands["flux on image"].value
    assert flux == pytest.approx(((1 - ((0.5168) / 2.5168)**2)**2), rel=0.02)
    assert float(found) == pytest.approx(9 * (flux - 2)**2 + (flux - 0.5)**2, rel=1e-12)


def test_light_that_crosses_edges_has_differences(tmp_path: Path) -> None:
    """A screen that is narrower than the light loses it across its edge, which rays that are walked back cannot see."""
    narrow = singlet(width=1.0)
    chosen = problem(Flux(detector="image", target=2.0), scene=narrow, variables={"image.z": (50.0, 56.0)})
    assert chosen.gradient().found_by == ["differences"]
    assert any("differences" in said or "is a difference" in said for _, said in chosen.log.notes)
    slope, step = chosen.gradient(), 0.2
    flux = [problem(Flux(detector="image", target=2.0), scene=singlet(z=52.0 + by, width=1.0), num_rays=80_000,
                    variables={"L.r1": (55.0, 66.0)}).value().value for by in (-step, step)]
    long = (flux[1] - flux[0]) / (2 * step)
    assert slope.values[0] == pytest.approx(long, abs=4 * slope.standard_errors[0] + 0.05 * abs(long))


def test_hard_pixels_and_guided_light_have_differences_and_the_log_says_so() -> None:
    for scene, operand, why in ((singlet(splat="hard"), Flux(detector="image", target=1.0), "pixels of image are hard"),
                                (singlet(), GhostFlux(detector="image", target=0.0), "is guided")):
        one = problem(operand, scene=scene, num_rays=2000)
        assert one.gradient().found_by == ["differences"] * 2
        assert any(why in said for _, said in one.log.notes)
        with pytest.raises(nsq_gpu.UsageError, match=why):
            problem(operand, scene=scene, gradient="reverse", num_rays=2000).gradient()


def test_ghosts_are_those_of_plain_rays() -> None:
    guided = problem(GhostFlux(detector="image", target=0.0), num_rays=40_000).value().operands["ghost flux on image"]
    plain = problem(GhostFlux(detector="image", target=0.0, guide=False), num_rays=400_000).value().operands["ghost flux on image"]
    assert abs(guided.value - plain.value) < 4 * np.hypot(guided.standard_error, plain.standard_error)
    assert guided.standard_error < 1.5 * plain.standard_error
    peak = problem(GhostPeak(detector="image", target=0.0, kernel=0.3, order=4), num_rays=40_000).value().operands["ghost peak on image"]
    assert 0.0 < peak.value < guided.value and peak.standard_error < peak.value


def test_one_trace_serves_all_operands_and_values_come_back() -> None:
    one = problem(*SMOOTH.values())
    one.value()
    first = one._tracer.num_traces
    # All light, and direct light, in ten blocks each.
    assert first == 20
    one.value()
    assert one._tracer.num_traces == first


# Designs


def test_all_methods_find_the_focus() -> None:
    focus = {"image.z": (58.0, 68.0)}
    expected = None
    for method in ("L-BFGS-B", "SLSQP", "TNC", "trust-constr", "Nelder-Mead", "Powell", "COBYLA"):
        found = problem(variables=focus, num_rays=4000, scene=singlet(z=60.0)).minimize(method, max_rays=4000, tolerance=1e-6)
        expected = expected or found
        error = np.hypot(found.standard_errors["image.z"], expected.standard_errors["image.z"])
        assert found.numbers["image.z"] == pytest.approx(expected.numbers["image.z"], abs=4 * error), method


def test_errors_of_variables_are_their_spread_over_seeds() -> None:
    found = []
    for seed in range(10):
        design = problem(variables={"image.z": (58.0, 68.0)}, num_rays=2000, seed=seed, scene=singlet(z=60.0)).minimize(max_rays=4000)
        found.append((design.numbers["image.z"], design.standard_errors["image.z"]))
    values, errors = np.array(found).T
    assert np.sqrt((errors**2).mean()) == pytest.approx(values.std(ddof=1), rel=0.6)
    assert (np.abs(values - values.mean()) < 3 * errors).mean() >= 0.8


def lens_on_a_screen(config: LensConfig, beam: float, z: float, width: float, pixels: int) -> NSQScene:
    """Return a lens in parallel light, and a screen."""
    scene = NSQScene()
    scene.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(Spectrum([0.55], [1.0]), aperture_radius=beam))
    scene.add_lens("L", cs(), config)
    scene.add_detector("image", cs(z=z), IrradianceDetectorConfig(width, width, pixels, pixels))
    return scene


def test_the_best_form_of_a_singlet_is_coddingtons() -> None:
    """For light from infinity a thin lens of index n has the least spherical aberration at q = 2 (n^2 - 1) / (n + 2)."""
    n, image = 1.5168, 200.0
    scene = lens_on_a_screen(LensConfig(132.0, -430.0, 6.0, NSQMaterial(IdealMaterial(n)), 26.0), 25.0, image, 4.8, 128)
    one = problem(scene=scene, variables={"L.r1": (110.0, 140.0), "L.r2": (-1200.0, -400.0)}, num_rays=10_000)
    design = one.minimize("Nelder-Mead", max_rays=10_000, tolerance=1e-5, steps=130, errors=False)
    r1, r2 = design.numbers["L.r1"], design.numbers["L.r2"]
    # The second radius may be far: q is what the aberration depends on. The lens is 6 mm thick.
    assert (r2 + r1) / (r2 - r1) == pytest.approx(2 * (n**2 - 1) / (n + 2), abs=0.03)
    focal = 1 / ((n - 1) * (1 / r1 - 1 / r2 + (n - 1) * 6.0 / (n * r1 * r2)))
    assert focal == pytest.approx(image, rel=0.02)
    assert design.fresh is not None and design.fresh.value < 0.1 * design.log.steps[0].merit


def test_a_hyperbola_focuses_where_its_formula_says() -> None:
    """A flat face and a hyperbola with the conic constant -n^2 bring parallel light to one point, r / (n - 1) behind the vertex."""
    n, r2 = 1.5168, -40.0
    focus = 4.0 - r2 / (n - 1)
    scene = lens_on_a_screen(LensConfig(1e6, r2, 4.0, NSQMaterial(IdealMaterial(n)), 13.0, conic2=-2.0), 10.0, focus + 0.4, 0.8, 200)
    # The spot is a point, and below a pixel of 0.004 mm all spots are alike. A target of 0 would keep line searches there.
    small = RmsRadius(detector="image", max_val=0.002, where=DIRECT)
    one = problem(small, scene=scene, variables={"L.conic2": (-3.0, -1.5), "image.z": (focus - 1.0, focus + 1.0)}, num_rays=4000)
    design = one.minimize("L-BFGS-B", max_rays=16_000, tolerance=1e-9, errors=False)
    assert design.numbers["L.conic2"] == pytest.approx(-(n**2), abs=0.05)
    assert design.numbers["image.z"] == pytest.approx(focus, abs=0.06)
    assert design.value.operands["rms radius on image"].value < 0.004


def radius_on_screen(rho: np.ndarray, conic: float, n: float, r2: float, thickness: float, screen: float) -> np.ndarray:
    """Return where a ray at the height rho of parallel light meets the screen, behind a flat face and a conic one, by Snell's law."""
    curvature = 1.0 / r2
    root = np.sqrt(1.0 - (1.0 + conic) * curvature**2 * rho**2)
    sag = curvature * rho**2 / (1.0 + root)
    slope = curvature * rho / root
    inside = np.arctan(slope)
    # The normal is turned by that angle; outside the ray is turned by the difference of both angles.
    outside = np.arcsin(n * np.sin(inside))
    return rho + np.tan(outside - inside) * (screen - thickness - sag)


def test_a_conic_flattens_a_spot_as_its_mapping_says() -> None:
    """Behind a lens a ring of light has the irradiance rho d(rho) / (r d(r)); one conic constant makes it the most even."""
    n, r2, thickness, screen, beam, inside = 1.5168, -30.0, 6.0, 84.0, 12.0, 4.0
    rho = np.linspace(1e-4, beam, 40_001)

    def uniformity(conic: float) -> float:
        r = np.abs(radius_on_screen(rho, conic, n, r2, thickness, screen))
        middle, area, light = (r[1:] + r[:-1]) / 2, np.abs(np.diff(r**2)), np.diff(rho**2)
        within = middle < inside
        # Mean and mean square of light / area over the circle; rays do not cross each other there.
        return light[within].sum()**2 / (inside**2 * (light**2 / area)[within].sum())

    conics = np.linspace(-4.0, 1.5, 111)
    expected = conics[np.argmax([uniformity(conic) for conic in conics])]
    assert -3.5 < expected < 1.0
    scene = lens_on_a_screen(LensConfig(1e6, r2, thickness, NSQMaterial(IdealMaterial(n)), 14.0, conic2=-0.5), beam, screen, 16.0, 160)
    even = Uniformity(detector="image", target=1.5, circle=(0.0, 0.0, inside), where=DIRECT)
    one = problem(even, scene=scene, variables={"L.conic2": (-4.0, 1.5)}, num_rays=40_000)
    for conic in (-2.5, -1.0, 0.5):
        found = one.value({"L.conic2": conic}).operands["uniformity on image"]
        assert found.value == pytest.approx(uniformity(conic), abs=4 * found.standard_error + 0.01)
    design = one.minimize(max_rays=160_000, errors=True)
    assert design.numbers["L.conic2"] == pytest.approx(expected, abs=0.05 + 4 * design.standard_errors["L.conic2"])


def test_rays_grow_between_stages_alone() -> None:
    design = problem(num_rays=2000, scene=singlet(z=60.0), variables={"image.z": (58.0, 68.0)}).minimize(max_rays=30_000)
    rays = [step.num_rays for step in design.log.steps]
    assert rays == sorted(rays) and set(rays) == {2000, 8000, 30_000}
    for one, other in zip(design.log.steps, design.log.steps[1:], strict=False):
        assert (one.num_rays == other.num_rays) == (one.stage == other.stage)
    assert sum("restart with" in said for _, said in design.log.notes) == 2
    assert design.fresh is not None and design.fresh.num_rays == 120_000
    assert "restart with 8,000 rays" in repr(design.log) and "image.z" in repr(design)


def pipe() -> dict[str, Any]:
    """Return a lamp in a mirrored pipe that opens towards a screen."""
    place = {"x": 0.0, "y": 0.0, "rx": 0.0, "ry": 0.0, "rz": 0.0, "reference_cs": None}
    source = {"type": "extended", "name": "led", "cs": {**place, "z": 0.1}, "spectrum": {"wavelengths": [0.55], "weights": [1.0]}, "total_flux": 1.0,
              "width": 1.0, "height": 1.0, "aperture_radius": 2.0, "half_angle_deg": 60.0, "medium": None}
    screen = {"type": "irradiance", "name": "screen", "cs": {**place, "z": 60.0}, "width": 60.0, "height": 60.0, "num_pixels_x": 60,
              "num_pixels_y": 60, "splat": "bilinear", "splat_sigma": 0.5, "absorb": True}
    shape = {"type": "frustum", "r_front": 3.0, "r_back": 9.0, "z_front": 0.0, "z_back": 30.0}
    surface = {"name": "pipe", "cs": {**place, "z": 0.0}, "shape": shape, "interaction": "reflective", "reflectance": 0.95}
    return {"nsq_schema_version": 1, "components": [], "sources": [source], "detectors": [screen],
            "nsq_gpu": {"version": 1, "surfaces": [surface]}}


def test_the_taper_of_a_light_pipe_makes_its_spot_even(tmp_path: Path) -> None:
    """The reference is a scan over the taper by other draws, and by the plain formula of map and mean."""
    file = tmp_path / "pipe.json"
    file.write_text(json.dumps(pipe()))
    even = Uniformity(detector="screen", target=1.0, circle=(0.0, 0.0, 15.0))
    one = nsq_gpu.Problem(file, {"pipe.r_back": (8.0, 12.7)}, [even], num_rays=20_000)
    # Another maximum lies at 14 mm, beyond the bounds.
    design = one.minimize("Nelder-Mead", max_rays=80_000, tolerance=1e-3)
    assert design.fresh is not None
    found = design.fresh.operands["uniformity on screen"]
    scan, other = {}, nsq_gpu.Problem(file, {"pipe.r_back": (8.0, 12.7)}, [even], num_rays=400_000, seed=9)
    for radius in (9.0, 10.0, 11.0, 11.25, 11.5, 11.75, 12.0, 12.25, 12.5):
        map_ = other.maps([radius])["screen"]
        inside = np.hypot(map_.x, map_.y[:, None]) < 15.0
        scan[radius] = map_.mean[inside].mean()**2 / (map_.mean[inside]**2).mean()
    best = max(scan, key=lambda radius: scan[radius])
    assert scan[9.0] < 0.8 and 11.5 <= best <= 12.25
    assert design.numbers["pipe.r_back"] == pytest.approx(best, abs=0.3)
    # Noise of pixels makes the plain formula a little too small.
    assert found.value > max(scan.values()) - 3 * found.standard_error


def test_noise_decides_over_all_directions() -> None:
    """Across a valley the gradient is noisy, and along it is not: each component is within its error, all together are not."""
    rng = np.random.default_rng(1)
    across, along = np.array([1.0, 1.0]) / np.sqrt(2), np.array([1.0, -1.0]) / np.sqrt(2)

    def decides(signal: float) -> bool:
        # Ten blocks, of which each is a tenth of the gradient.
        blocks = rng.normal(size=(10, 1)) * across * 10.0 + rng.normal(size=(10, 1)) * along * 0.1 + signal * along
        total = blocks.mean(axis=0)
        return is_noise(total, (total - blocks) / 9.0)

    # Of no gradient noise is told nearly always, of ten errors along the valley nearly never.
    assert sum(decides(0.0) for _ in range(200)) > 185
    assert sum(decides(0.3) for _ in range(200)) < 10


def test_a_scene_that_cannot_be_traced_is_a_bad_design() -> None:
    # Where the screen stands within the lens the program refuses the scene, or no light comes.
    one = problem(variables={"L.thickness": (-3.0, 8.0)}, num_rays=2000)
    with pytest.raises(nsq_gpu.SceneError):
        one.value({"L.thickness": -1.0})
    design = one.minimize("differential_evolution", max_rays=2000, maxiter=1, popsize=5, errors=False)
    assert design.numbers["L.thickness"] > 0.0
    assert any("cannot be traced" in said for _, said in design.log.notes)


# Stops and restarts


def test_an_interrupt_keeps_the_best(tmp_path: Path) -> None:
    def interrupt(step: Step) -> None:
        if step.step == 2:
            raise KeyboardInterrupt

    file = tmp_path / "log.json"
    one = problem(num_rays=2000)
    with pytest.raises(nsq_gpu.Interrupted) as stop:
        one.minimize(max_rays=64_000, callback=interrupt, log=file)
    design = stop.value.partial
    assert isinstance(design, Design) and design.partial and design.fresh is None
    assert design.value.value == min(step.merit for step in design.log.steps)
    known = Log.load(file)
    assert known.steps == design.log.steps and "interrupted; the best is kept" in known.notes[-1][1]
    again = problem(num_rays=2000)
    found = again.minimize(max_rays=8000, resume=file)
    assert found.log.steps[:3] == known.steps
    assert found.value.value <= design.value.value * 1.05
    assert found.log.steps[3].x == pytest.approx(design.x)
    assert found.log.steps[-1].rays_so_far > known.steps[-1].rays_so_far


def test_a_log_of_another_problem_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "log.json"
    problem(num_rays=2000).minimize(max_rays=2000, steps=1, log=file, errors=False)
    with pytest.raises(nsq_gpu.UsageError, match="seed differ"):
        problem(num_rays=2000, seed=3).minimize(resume=file)
    with pytest.raises(nsq_gpu.UsageError, match="operands differ"):
        problem(SMOOTH["flux"], num_rays=2000).minimize(resume=file)
    file.write_text("{}")
    with pytest.raises(nsq_gpu.UsageError, match="is no log"):
        problem(num_rays=2000).minimize(resume=file)


def test_a_callback_a_budget_and_steps_end_it() -> None:
    assert problem(num_rays=2000).minimize(callback=lambda step: step.step >= 1, errors=False).reason == "the callback stopped it"
    assert problem(num_rays=2000).minimize(steps=2, errors=False).reason == "2 steps are done"
    found = problem(num_rays=2000).minimize(budget=9000, errors=False)
    assert "budget of 9,000 rays" in found.reason


def test_other_draws_are_a_restart_that_the_log_has() -> None:
    one = problem(num_rays=2000)
    first = float(one.value())
    one.renew()
    assert float(one.value()) != first and any("restart: seed 1" in said for _, said in one.log.notes)
    one.renew(seed=0)
    assert float(one.value()) == first


def test_what_is_frozen_stays() -> None:
    one = problem(num_rays=2000)
    settings = one.settings()
    assert settings["precision"] in ("f32", "f64", "df64") and settings["max_depth"] >= 16
    design = one.minimize(max_rays=2000, errors=False)
    assert design.log.settings == settings == one.settings()


def test_scipy_takes_a_problem_as_it_is() -> None:
    from scipy import optimize

    one = problem(scene=singlet(z=60.0), variables={"image.z": (58.0, 68.0)})
    found = optimize.minimize(**one.for_scipy(), method="L-BFGS-B")
    assert found.x[0] == pytest.approx(one.minimize(max_rays=8000).numbers["image.z"], abs=0.05)


def test_a_log_has_a_plot() -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    design = problem(num_rays=2000).minimize(max_rays=8000, errors=False)
    axes = design.plot()
    assert axes.get_ylabel() == "merit" and len(axes.containers[0][0].get_xdata()) == len(design.log)


# Light at edges, seen late


def past_its_screen(r1: float = 60.0) -> NSQScene:
    """Return a lens whose light, where r1 is large, lies over a screen's edge."""
    return singlet(r1=r1, z=40.0, width=8.0)


FAR = {"L.r1": (40.0, 400.0)}


@pytest.mark.parametrize("rays", [8000, 20_000])
def test_few_rays_see_light_at_edges(rays: int) -> None:
    """Rays that are walked back see 1e-9 of a slope of 1e-4."""
    gradient = problem(Flux(detector="image", target=1.0), scene=past_its_screen(), variables=FAR, num_rays=rays).gradient([300.0])
    assert gradient.found_by == ["differences"]
    assert abs(gradient.values[0]) > 3e-5


def test_a_verdict_on_edges_is_of_its_place() -> None:
    """At the first place the operand is met, so that the merit is flat there, and no light lies at the edge."""
    one = problem(Flux(detector="image", min_val=0.85), scene=past_its_screen(), variables=FAR, num_rays=20_000)
    assert one.gradient([60.0]).found_by == ["reverse"]
    late = one.gradient([300.0])
    assert late.found_by == ["differences"]
    fresh = problem(Flux(detector="image", min_val=0.85), scene=past_its_screen(), variables=FAR, num_rays=20_000,
                    gradient="differences").gradient([300.0])
    assert late.values[0] == pytest.approx(fresh.values[0])
    assert sum("light crosses edges where L.r1" in said for _, said in one.log.notes) == 1


def test_a_met_operand_says_nothing_of_edges() -> None:
    """The adjoints of a merit that is met are 0; those of its operand are not."""
    one = problem(Flux(detector="image", max_val=5.0), scene=past_its_screen(), variables=FAR, num_rays=8000)
    assert one.gradient([300.0]).found_by == ["differences"]


# Runs


@pytest.mark.parametrize("method", ["L-BFGS-B", "SLSQP", "TNC"])
def test_small_merits_are_minimized_too(method: str) -> None:
    """SciPy's tests of convergence are against 1; a merit of 1e-8 is far below."""
    focus: dict[str, Any] = {"variables": {"image.z": (55.0, 70.0)}, "num_rays": 2000, "scene": singlet(z=56.0)}
    design = problem(RmsRadius(detector="image", target=0, weight=1e-4, where=DIRECT), **focus).minimize(method, max_rays=2000, errors=False)
    assert design.log.steps[0].merit < 1e-8
    assert design.value.value < 0.2 * design.log.steps[0].merit
    assert design.numbers["image.z"] == pytest.approx(61.06, abs=0.3)


def test_each_run_has_its_own_steps_and_rays() -> None:
    one = problem(num_rays=2000)
    first = one.minimize(max_rays=4000, growth=2, steps=2, errors=False)
    assert one.num_rays == 2000 and len(first.log) == 2
    other = one.minimize(max_rays=4000, growth=2, steps=3, errors=False)
    assert one.num_rays == 2000 and len(first.log) == 2
    assert other.log.steps[0].step == 0 and other.log.steps[0].stage == 0 and other.log.steps[0].num_rays == 2000
    assert other.log is one.log and other.log is not first.log and other.log.settings == first.log.settings


def test_rays_are_whole_blocks() -> None:
    one = problem(num_rays=39)
    assert one.num_rays == 30
    assert {step.num_rays for step in one.minimize(max_rays=65, growth=2, steps=3, errors=False, tolerance=0.1).log} <= {30, 60}


@pytest.mark.parametrize("method", ["SLSQP", "Adam"])
def test_scenes_that_cannot_be_traced_end_no_run(method: str) -> None:
    """A radius below that of the rim has no lens; the start is good, and the optimiser leaps."""
    if method == "Adam":
        pytest.importorskip("torch")
    one = problem(scene=singlet(z=30.0, width=12.0), variables={"L.r1": (8.0, 66.0)}, num_rays=2000)
    with pytest.raises(nsq_gpu.SceneError):
        one.value([9.0])
    design = one.minimize(method, max_rays=2000, steps=12, **({"lr": 0.2} if method == "Adam" else {}))
    assert design.value.value < 0.5 * design.log.steps[0].merit
    assert any("cannot be traced" in said for _, said in design.log.notes)


@pytest.mark.parametrize("method", ["L-BFGS-B", "Nelder-Mead"])
def test_no_light_at_the_start_is_said(method: str) -> None:
    one = problem(RmsRadius(detector="image", target=0, where="reflections == 7"), num_rays=2000)
    with pytest.raises(nsq_gpu.UsageError, match="no value at the start.*x0"):
        one.minimize(method, max_rays=2000)


def test_a_variable_of_edges_alone_is_found_late(monkeypatch: pytest.MonkeyPatch) -> None:
    one = problem(num_rays=2000)
    assert one.gradient().found_by == ["reverse", "reverse"]
    walked = one._walked

    def refuses(numbers: Any, names: Any, errors: bool) -> Any:
        if "L.r1" in names:
            raise nsq_gpu.UsageError("nsq-gpu: `L.r1` acts at edges alone, such as rims")
        return walked(numbers, names, errors)

    monkeypatch.setattr(one, "_walked", refuses)
    gradient = one.gradient([52.1, 60.0])
    assert gradient.found_by == ["reverse", "differences"]
    assert any("L.r1 acts at edges alone" in said for _, said in one.log.notes)


def test_an_error_keeps_the_best() -> None:
    one = problem(num_rays=2000)

    def fails(step: Step) -> None:
        if step.step == 1:
            raise nsq_gpu.DeviceError("the device was lost")

    with pytest.raises(nsq_gpu.DeviceError, match="lost") as stop:
        one.minimize(callback=fails)
    design = stop.value.partial
    assert isinstance(design, Design) and design.partial and len(design.log) == 2 and "lost" in design.reason
    assert one.num_rays == 2000


def test_no_file_is_written_over(tmp_path: Path) -> None:
    scene = tmp_path / "scene.json"
    scene.write_text(json.dumps(pipe()))
    before = scene.read_text()
    one = problem(num_rays=2000)
    with pytest.raises(nsq_gpu.UsageError, match="is no log of an optimisation; name another file"):
        one.minimize(log=scene)
    assert scene.read_text() == before
    with pytest.raises(nsq_gpu.UsageError, match="is no file"):
        one.minimize(log=tmp_path)
    with pytest.raises(nsq_gpu.UsageError, match="folder .* cannot be made"):
        one.minimize(log=scene / "log.json")
    assert one._tracer.num_traces == 0
    file = tmp_path / "new" / "log.json"
    done = one.minimize(max_rays=2000, steps=1, log=file, errors=False)
    with pytest.raises(nsq_gpu.UsageError, match="log of another run.*resume="):
        one.minimize(log=file)
    for is_named in (True, False):
        done = one.minimize(max_rays=2000, steps=1, log=file, resume=file if is_named else done.log, errors=False)
        assert Log.load(file).steps == done.log.steps
    assert len(done.log) == 3 and not list(file.parent.glob(".*"))


def test_a_log_knows_functions_by_their_code() -> None:
    from nsq_gpu.design import TorchFunction

    def operands(function: Any) -> Any:
        return problem(TorchFunction(detector="image", target=0.0, function=function), num_rays=2000).settings()["operands"]

    one, same, other = operands(lambda map_: map_.sum()), operands(lambda map_: map_.sum()), operands(lambda map_: (map_**2).sum())
    assert one == same != other
    assert problem(step=0.01).settings() != problem().settings() != problem(gradient="differences").settings()


def test_numbers_beyond_the_bounds_are_said() -> None:
    with pytest.warns(nsq_gpu.NsqGpuWarning, match="L.r1 = 99: beyond the bounds"):
        problem(num_rays=2000).value([52.0, 99.0])


# What is refused


def with_far_field() -> NSQScene:
    scene = singlet()
    scene.add_detector("sky", cs(z=80.0), FarFieldDetectorConfig())
    return scene


@pytest.mark.parametrize(("make", "said"), [
    (lambda: problem(variables={"L.rr1": (1, 2)}), "L.rr1|no number"),
    (lambda: problem(variables={"M.r1": (1, 2)}), "M.r1"),
    (lambda: problem(variables={"L.r1": (2, 1)}), "least and its largest"),
    (lambda: problem(variables={"L.r1": 5}), "least and its largest"),
    (lambda: problem(variables=["L.r1"]), "give a dictionary"),
    (lambda: problem(Flux(detector="imag", target=1)), "did you mean 'image'"),
    (lambda: problem(Flux(detector="sky", target=1), scene=with_far_field()), "far_field"),
    (lambda: problem(3), "give operands of nsq_gpu.design"),
    (lambda: problem(gradient="revers"), "did you mean 'reverse'"),
    (lambda: problem(blocks=3), "give 4 or more"),
    (lambda: problem(Peak(detector="image", target=0, kernel=0.2, order=10)), "give 11 or more"),
    (lambda: problem(step=0.5), "share of the range"),
    (lambda: problem(num_rays=5), "at least one for each"),
    (lambda: problem().minimize("LBFGS"), "did you mean 'L-BFGS-B'"),
    (lambda: problem().minimize(x0={"L.r": 3}), "did you mean 'L.r1'"),
    (lambda: problem().minimize(x0={"L.r1": 60}), "lacks 'image.z'"),
    (lambda: problem().minimize(x0=[50.0, 200.0]), "beyond the bounds of L.r1"),
    (lambda: problem().minimize(growth=1), "2 or more"),
    (lambda: problem().minimize(max_ray=5), "no option 'max_ray'; did you mean 'max_rays'"),
    (lambda: problem().minimize("Nelder-Mead", xtol=1), "did you mean 'xatol'"),
    (lambda: problem().minimize(budget="abc"), "budget is 'abc'"),
    (lambda: problem().minimize(budget=-1), "more than 0"),
    (lambda: problem().minimize(budget=np.nan), "budget is nan"),
    (lambda: problem().minimize(tolerance="a"), "tolerance is 'a'"),
    (lambda: problem().minimize(tolerance=-1), "0 or more"),
    (lambda: problem(step="a"), "step is 'a'"),
    (lambda: problem().value(["a", 1]), "x is"),
    (lambda: problem().value([1.0]), "give 2"),
    (lambda: problem().value([np.nan, 1.0]), "finite"),
    (lambda: problem(Flux(detector="image", target=1, where="reflection == 1")).value(), "reflection"),
    (lambda: problem(MatchMap(detector="image", target=0, wanted=np.ones((3, 3)))).value(), "shape"),
])
def test_what_makes_no_sense_is_refused_by_name(make: Any, said: str) -> None:
    with pytest.raises(nsq_gpu.NsqGpuError, match=said):
        make()


def test_every_method_is_named_once() -> None:
    assert len(set(METHODS)) == len(METHODS)


def test_meshes_and_split_rays_have_differences_and_are_refused_to_walk_back() -> None:
    """Two cells of the table of derivatives."""
    mesh = live.ROOT / "scenes" / "mesh_lens.json"
    split = singlet()
    split.sampling_policy = SamplingPolicy(split_depth=2)
    for scene, variables, detector in ((mesh, None, None), (split, {"image.z": (50.0, 56.0)}, "image")):
        if variables is None:
            entries = json.loads(mesh.read_text(encoding="utf-8"))
            z = entries["sources"][0]["cs"]["z"]
            variables = {f"{entries['sources'][0]['name']}.z": (z - 1.0, z + 1.0)}
            detector = next(entry["name"] for entry in entries["detectors"] if entry["type"] == "irradiance")
        options: dict[str, Any] = {"scene": scene, "variables": variables, "num_rays": 2000}
        one = problem(Flux(detector=detector, target=0.0), **options)
        assert one.gradient().found_by == ["differences"]
        assert any("differences" in said for _, said in one.log.notes)
        with pytest.raises(nsq_gpu.UsageError):
            problem(Flux(detector=detector, target=0.0), gradient="reverse", **options).gradient()
