"""Operands of Optiland's optimisers: closed forms, noise, shared traces, and Optiland's own optimisers and tolerances."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
import pytest
from optiland.optic import Optic
from optiland.optimization import DifferentialEvolution, LeastSquares, OptimizationProblem, OptimizerGeneric
from optiland.optimization.operand.operand import operand_registry
from optiland.samples.objectives import CookeTriplet, DoubleGauss
from optiland.samples.telescopes import HubbleTelescope
from optiland.tolerancing.core import Tolerancing
from optiland.tolerancing.perturbation import RangeSampler
from optiland.tolerancing.sensitivity_analysis import SensitivityAnalysis

import nsq_gpu
from nsq_gpu.design import operand_estimate, operands, tracing
from nsq_gpu.export import export
from nsq_gpu.scene_file import parsed
from nsq_gpu.session import shared_session
from tests import live

pytestmark = pytest.mark.in_turn

#: Light that goes straight through.
DIRECT = "reflections == 0"


@pytest.fixture(autouse=True)
def program(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("NSQ_GPU_BINARY", live.binary())
    nsq_gpu.register_operands()
    with live.quiet():
        yield


def optic(faces: list[dict[str, Any]], diameter: float = 8.0, fields: tuple[float, ...] = (0.0,)) -> Optic:
    """Return a lens of these faces, with an object at infinity and green light."""
    found = Optic()
    found.surfaces.add(index=0, radius=be.inf, thickness=be.inf)
    for index, face in enumerate(faces, 1):
        found.surfaces.add(index=index, **face)
    found.surfaces.add(index=len(faces) + 1)
    found.set_aperture(aperture_type="EPD", value=diameter)
    found.fields.set_type(field_type="angle")
    for field in fields:
        found.fields.add(y=field)
    found.wavelengths.add(value=0.55, is_primary=True)
    return found


def plate() -> Optic:
    """Return a window of fused silica, before which light is parallel, and behind it an image."""
    return optic([{"radius": be.inf, "thickness": 3.0, "material": "N-BK7", "is_stop": True}, {"radius": be.inf, "thickness": 5.0}])


def reflectance() -> float:
    """Return the share of the light that a face of the window reflects at right angles."""
    n = float(np.ravel(plate().surfaces[1].material_post.n(0.55))[0])
    return ((n - 1) / (n + 1))**2


def singlet(thickness: float = 96.0) -> Optic:
    """Return a lens that focuses parallel light about 98 mm behind it."""
    return optic([{"radius": 100.0, "thickness": 4.0, "material": "N-BK7", "is_stop": True}, {"radius": -100.0, "thickness": thickness}], 20.0)


def spot(lens: Optic, **more: Any) -> dict[str, Any]:
    """Return the input data of the spot of a singlet."""
    return {"optic": lens, "where": DIRECT, "detector_size": (1.6, 1.6), "detector_pixels": (160, 160), "num_rays": 16_000, **more}


def focus(lens: Optic, target: float = 0.0) -> OptimizationProblem:
    """Return a problem that moves the image to the smallest spot."""
    problem = OptimizationProblem()
    problem.add_operand("nsq_rms_radius", target=target, weight=10, input_data=spot(lens))
    problem.add_variable(lens, "thickness", surface_number=2, min_val=94.0, max_val=99.0)
    return problem


def sequential_focus() -> float:
    """Return where Optiland's own spot is the smallest [mm behind the lens]. Its outermost ring counts in full: many are needed."""
    lens = singlet()
    problem = OptimizationProblem()
    problem.add_operand("rms_spot_size", target=0, weight=10, input_data={
        "optic": lens, "surface_number": -1, "Hx": 0, "Hy": 0, "num_rays": 200, "wavelength": 0.55, "distribution": "hexapolar"})
    problem.add_variable(lens, "thickness", surface_number=2)
    OptimizerGeneric(problem).optimize(tol=1e-10, disp=False)
    return float(lens.surfaces[2].thickness)


# Closed forms


def test_a_window_lets_through_what_its_formula_says() -> None:
    r = reflectance()
    for name, where, expected in (("nsq_flux", None, (1 - r) / (1 + r)), ("nsq_flux", DIRECT, (1 - r)**2),
                                  ("nsq_ghost_flux", None, (1 - r)**2 * r**2 / (1 - r**2))):
        # The window absorbs a few parts in 1e5.
        found = operand_estimate(name, optic=plate(), where=where, num_rays=64_000)
        assert found.standard_error < 0.03 * expected
        assert abs(found.value - expected) < 4 * found.standard_error + 1e-4 * expected, (name, where)


def test_a_flat_disk_has_the_peak_the_radius_and_the_uniformity_of_its_formula() -> None:
    r, radius = reflectance(), 4.0
    data = {"optic": plate(), "num_rays": 64_000, "detector_size": (10.0, 10.0)}
    peak = operand_estimate("nsq_ghost_peak", **{**data, "num_rays": 400_000}, kernel=0.3)
    # Of a disk that is wide beside the kernel, the mean of order 8 is the irradiance, but for the rim.
    x = (np.arange(480) - 239.5) * 0.025
    blurred = disk_after_gaussian(x, radius, 0.3)
    shape = (blurred**8).sum() / (blurred**7).sum()
    expected = (1 - r)**2 * r**2 / (np.pi * radius**2) * shape
    assert 0.97 < shape < 1.0 and peak.standard_error < 0.05 * expected
    assert abs(peak.value - expected) < 4 * peak.standard_error + 2e-3 * expected
    width = operand_estimate("nsq_rms_radius", **data, where=DIRECT)
    assert abs(width.value - radius / np.sqrt(2)) < 4 * width.standard_error + 1e-4
    even = operand_estimate("nsq_uniformity", **data, where=DIRECT, circle=(0, 0, 3.5))
    assert abs(even.value - 1.0) < 4 * even.standard_error < 0.02
    filled = operand_estimate("nsq_uniformity", **data, where=DIRECT, region=(-4, 4, -4, 4), kernel=0.1)
    # Blurred by the kernel, and by the weights of pixels, whose mean square is a sixth of a pixel's.
    inside = np.abs(x) <= 4.0
    blurred = disk_after_gaussian(x, radius, np.sqrt(0.1**2 + (10.0 / 128)**2 / 6))[np.ix_(inside, inside)]
    expected = blurred.mean()**2 / (blurred**2).mean()
    assert np.pi / 4 < expected < 0.82
    assert abs(filled.value - expected) < 4 * filled.standard_error + 1e-3


def disk_after_gaussian(x: np.ndarray, radius: float, width: float) -> np.ndarray:
    """Return a disk of height 1 after a Gaussian, by a Fourier transform, which shares no code with the operand."""
    disk = (np.hypot(x, x[:, None]) <= radius).astype(float)
    frequency = np.fft.fftfreq(len(x), x[1] - x[0])
    gaussian = np.exp(-2 * (np.pi * width)**2 * (frequency**2 + frequency[:, None]**2))
    return np.fft.ifft2(np.fft.fft2(disk) * gaussian).real.clip(0)


def test_standard_errors_hold_the_truth_as_often_as_they_should() -> None:
    r, window = reflectance(), plate()
    truth = {"nsq_flux": (1 - r) / (1 + r), "nsq_ghost_flux": (1 - r)**2 * r**2 / (1 - r**2)}
    for name, expected in truth.items():
        found = [operand_estimate(name, optic=window, seed=seed, num_rays=8_000, guide=False) for seed in range(60)]
        scores = np.array([(each.value - expected) / each.standard_error for each in found])
        # Student's t with 15 degrees of freedom: 95 % lie within 2.13.
        assert abs(scores.mean()) < 4 / np.sqrt(60), name
        assert 0.85 <= (np.abs(scores) < 2.13).mean() <= 1.0 and 0.75 < scores.std() < 1.4, name


# What is shared, and what is refused


def test_one_trace_serves_all_operands_of_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    lens, made = CookeTriplet(), []
    monkeypatch.setattr(operands, "from_optic", lambda *args, **options: made.append(1) or nsq_gpu.from_optic(*args, **options))
    data = {"optic": lens, "num_rays": 1600, "seed": 77}
    problem = OptimizationProblem()
    for name in ("nsq_flux", "nsq_uniformity", "nsq_rms_radius"):
        problem.add_operand(name, target=0, input_data=data)
    for name in ("nsq_ghost_flux", "nsq_ghost_peak"):
        problem.add_operand(name, target=0, input_data=data)
    problem.sum_squared()
    tracer = next(iter(operands._state.tracers.values()))
    made.clear()
    before = tracer.num_traces
    lens.updater.set_radius(22.1, 1)
    problem.sum_squared()
    # Three fields of 16 blocks: once of all light, once of ghosts.
    assert tracer.num_traces - before == 2 * 3 * 16
    problem.sum_squared()
    assert tracer.num_traces - before == 2 * 3 * 16
    # The image's size is known after the first lens: two scenes at most are made of one lens.
    assert len(made) == 1


@pytest.mark.parametrize("make", [CookeTriplet, DoubleGauss, HubbleTelescope, singlet])
def test_the_scene_of_an_operand_is_that_of_from_optic(make: Any) -> None:
    lens = make()
    with operands._one_path(lens):
        ours = export(nsq_gpu.from_optic(lens)).document
    assert ours == export(nsq_gpu.from_optic(make())).document
    assert "build_paraxial_path" not in vars(lens.surfaces)


def test_values_are_the_same_bits_when_a_lens_comes_back() -> None:
    lens, data = singlet(), {}
    data = spot(lens)
    first = operand_registry.get("nsq_rms_radius")(**data)
    lens.updater.set_thickness(97.0, 2)
    other = operand_registry.get("nsq_rms_radius")(**data)
    lens.updater.set_thickness(96.0, 2)
    assert operand_registry.get("nsq_rms_radius")(**data) == first != other


@pytest.mark.parametrize(("operand", "data", "said"), [
    ("nsq_flux", {"detecter": "image"}, "did you mean 'detector'"),
    ("nsq_flux", {"detector": "imag"}, "did you mean 'image'"),
    ("nsq_flux", {"kernel": 0.1}, "takes no 'kernel'"),
    ("nsq_flux", {"fields": [1]}, "numbers of the optic's fields, 0 to 0"),
    ("nsq_flux", {"fields": 0}, "give a list"),
    ("nsq_flux", {"where": 3}, "where is 3"),
    ("nsq_flux", {"where": "reflection == 2"}, "reflection"),
    ("nsq_flux", {"blocks": 2}, "give 4 or more"),
    ("nsq_flux", {"num_rays": 3}, "at least one for each of the 16 blocks"),
    ("nsq_flux", {"num_rays": 0}, "at least one for each"),
    ("nsq_flux", {"region": (1, 2)}, "give 4 numbers"),
    ("nsq_flux", {"region": (20, 30, 20, 30)}, "lies beside the detector"),
    ("nsq_ghost_peak", {"order": 16}, "give 17 or more"),
    ("nsq_ghost_peak", {"order": 1}, "2 or more"),
    ("nsq_ghost_peak", {"kernel": 1e-3}, "less than half of a pixel"),
    ("nsq_ghost_peak", {"guide": "yes"}, "guide is 'yes'"),
])
def test_what_makes_no_sense_is_refused_by_name(operand: str, data: dict[str, Any], said: str) -> None:
    with pytest.raises(nsq_gpu.NsqGpuError, match=said):
        operand_registry.get(operand)(optic=plate(), **{"num_rays": 1600, **data})


def test_no_optic_and_no_operand_are_refused() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="no face of the optic refracts"):
        operand_registry.get("nsq_ghost_flux")(optic=HubbleTelescope())
    with pytest.raises(nsq_gpu.UsageError, match="optic"):
        operand_registry.get("nsq_flux")(detector="image")
    with pytest.raises(nsq_gpu.UsageError, match="did you mean 'nsq_flux'"):
        operand_estimate("nsq_fluxx", optic=plate())


def test_a_lens_that_cannot_be_traced_is_nan_once_one_could() -> None:
    lens = singlet()
    value = operand_registry.get("nsq_rms_radius")
    assert np.isfinite(value(**spot(lens)))
    # Light does not reach a face of so small a radius.
    lens.updater.set_radius(5.0, 1)
    assert np.isnan(value(**spot(lens)))
    assert any("its value is NaN" in said for _, said in nsq_gpu.register_operands().notes)
    other = singlet()
    other.updater.set_radius(5.0, 1)
    with pytest.raises(nsq_gpu.NsqGpuError, match="no value|surface|rays"):
        value(**spot(other))


def test_a_spot_smaller_than_a_pixel_is_warned_of() -> None:
    with pytest.warns(nsq_gpu.ResultWarning, match="less than a pixel"):
        operand_estimate("nsq_rms_radius", **spot(singlet(), detector_size=(40.0, 40.0), detector_pixels=(16, 16)))


def test_each_operand_of_an_optic_raises_at_first() -> None:
    lens = singlet()
    value = operand_registry.get("nsq_flux")
    assert np.isfinite(value(**spot(lens, num_rays=1600)))
    # No light is reflected seven times, so the second operand has no value from the beginning.
    with pytest.raises(nsq_gpu.SceneError, match="no value"):
        operand_registry.get("nsq_rms_radius")(**spot(lens, num_rays=1600, where="reflections == 7"))


@pytest.mark.parametrize("error", [nsq_gpu.DeviceError, nsq_gpu.AdapterError, nsq_gpu.TraceTimeoutError, nsq_gpu.NsqGpuError])
def test_what_is_no_fault_of_a_lens_is_raised(error: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    lens, value = singlet(), operand_registry.get("nsq_flux")
    assert np.isfinite(value(**spot(lens, num_rays=1600)))

    def fails(*_: Any, **__: Any) -> None:
        raise error("not the lens")

    monkeypatch.setattr(operands.Tracer, "maps", fails)
    with pytest.raises(error, match="not the lens"):
        value(**spot(lens, num_rays=1600))


def test_a_guide_stays_with_its_optic() -> None:
    """A lens of the same shape that was traced before changes nothing."""
    data = {"num_rays": 1600, "fields": [0], "seed": 5}
    other = CookeTriplet()
    other.updater.set_radius(30.0, 1)
    operands._state.tracers.clear()
    operand_estimate("nsq_ghost_flux", optic=other, **data)
    after = operand_estimate("nsq_ghost_flux", optic=CookeTriplet(), **data)
    operands._state.tracers.clear()
    assert operand_estimate("nsq_ghost_flux", optic=CookeTriplet(), **data) == after


def test_a_guide_is_of_the_precision_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[list[str]] = []

    def said(command: list[str]) -> None:
        commands.append(command)
        raise nsq_gpu.SceneError("enough")

    monkeypatch.setattr(tracing, "run", said)
    with pytest.raises(nsq_gpu.SceneError, match="enough"):
        operand_estimate("nsq_ghost_flux", optic=CookeTriplet(), num_rays=1600, precision="f32")
    assert "--precision=f32" in commands[0]


def test_a_guide_finds_the_files_that_a_scene_names() -> None:
    scenes = Path(__file__).parents[2] / "scenes"
    document = parsed((scenes / "coated_projector.json").read_text(encoding="utf-8"))
    document["nsq_gpu"]["sampling"] = {}
    program = live.binary()
    tracer = tracing.Tracer(shared_session(program, None), program, name="coated_projector.json", folder=str(scenes))
    file, is_new = tracer.guide(document, None)
    assert is_new and Path(file).is_file()


def test_an_image_that_a_lens_outgrows_is_noted_and_renewed() -> None:
    lens = CookeTriplet()
    data = {"optic": lens, "num_rays": 1600}
    value = operand_registry.get("nsq_rms_radius")
    value(**data)
    before = nsq_gpu.register_operands().notes.copy()
    lens.scale_system(4)
    small = float(value(**data))
    notes = nsq_gpu.register_operands().notes[len(before):]
    assert any("the image keeps its first size" in said for _, said in notes)
    operands.renew(lens)
    again = CookeTriplet()
    again.scale_system(4)
    assert float(value(**data)) == float(value(optic=again, num_rays=1600)) != small


# Optimisers


def test_tiny_steps_have_the_slope_of_long_ones() -> None:
    lens = singlet(95.0)
    value = operand_registry.get("nsq_rms_radius")
    here = value(**spot(lens))
    lens.updater.set_thickness(95.0 + 1e-7, 2)
    slope = (value(**spot(lens)) - here) / 1e-7
    sides = []
    for step in (-0.05, 0.05):
        lens.updater.set_thickness(95.0 + step, 2)
        sides.append(value(**spot(lens)))
    assert slope == pytest.approx((sides[1] - sides[0]) / 0.1, rel=1e-3)
    assert any("tiny steps" in said for _, said in nsq_gpu.register_operands().notes)


def test_tiny_steps_are_known_among_operands_and_after_other_lenses() -> None:
    """Operands of two detectors take turns, and the optimiser looks at another lens before it takes its differences."""
    lens, value = singlet(95.0), operand_registry.get("nsq_rms_radius")
    both = [spot(lens), spot(lens, detector_size=(2.0, 2.0))]
    here = [value(**data) for data in both]
    lens.updater.set_thickness(95.5, 2)
    assert [value(**data) for data in both] != here
    slopes = []
    for step in (1e-7, 2e-7):
        lens.updater.set_thickness(95.0 + step, 2)
        slopes.append([(value(**data) - first) / step for data, first in zip(both, here, strict=True)])
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)
    sides = []
    for step in (-0.05, 0.05):
        lens.updater.set_thickness(95.0 + step, 2)
        sides.append([value(**data) for data in both])
    assert slopes[0] == pytest.approx((np.array(sides[1]) - sides[0]) / 0.1, rel=1e-3)


def test_a_tiny_step_finds_ghosts_that_a_rim_cuts() -> None:
    """The derivative of ghosts that decisions and rims make is that of a long difference; a difference of 1e-7 has none of it."""
    lens = CookeTriplet()
    data = {"optic": lens, "fields": [0], "num_rays": 160_000}
    value = operand_registry.get("nsq_ghost_flux")
    here, radius = value(**data), 22.01359
    lens.updater.set_radius(radius * (1 + 1e-8), 1)
    slope = (value(**data) - here) / (radius * 1e-8)
    sides = []
    for side in (-1, 1):
        lens.updater.set_radius(radius * (1 + 0.01 * side), 1)
        sides.append(operand_estimate("nsq_ghost_flux", **data))
    long = (sides[1].value - sides[0].value) / (0.02 * radius)
    # Common draws make the error of the difference smaller than this.
    error = np.hypot(sides[0].standard_error, sides[1].standard_error) / (0.02 * radius)
    assert abs(slope - long) < 2 * error
    assert slope < 0 > long


@pytest.mark.parametrize("optimizer", ["L-BFGS-B", "Nelder-Mead", "least squares", "differential evolution"])
def test_optimisers_find_the_focus_of_the_sequential_engine(optimizer: str) -> None:
    lens = singlet(96.5)
    problem = focus(lens)
    if optimizer == "least squares":
        LeastSquares(problem).optimize(maxiter=12, tol=1e-6, method_choice="trf")
    elif optimizer == "differential evolution":
        np.random.seed(1)
        DifferentialEvolution(problem).optimize(maxiter=4, disp=False, workers=1)
    else:
        OptimizerGeneric(problem).optimize(method=optimizer, maxiter=20, disp=False, tol=1e-7)
    assert float(lens.surfaces[2].thickness) == pytest.approx(sequential_focus(), abs=0.03)


def test_operands_stand_beside_optilands() -> None:
    lens = CookeTriplet()
    problem = OptimizationProblem()
    problem.add_operand("f2", target=50, weight=1, input_data={"optic": lens})
    problem.add_operand("nsq_ghost_flux", max_val=0.0, weight=10, input_data={"optic": lens, "fields": [0], "num_rays": 3200})
    terms = problem.fun_array()
    assert terms.shape == (2,) and np.isfinite(terms).all() and terms[1] > 0


def test_tolerances_take_operands() -> None:
    lens = singlet(97.0)
    tolerancing = Tolerancing(lens)
    tolerancing.add_operand("nsq_rms_radius", input_data=spot(lens))
    tolerancing.add_perturbation("thickness", RangeSampler(96.5, 97.5, 3), surface_number=2)
    analysis = SensitivityAnalysis(tolerancing)
    analysis.run()
    found = analysis.get_results()
    column = next(name for name in found.columns if "nsq rms radius" in name)
    # Behind the focus a cone opens whose radius grows by the aperture's radius over the focal length.
    slope = np.diff(found[column].to_numpy()[:2])[0] / 0.5
    assert slope == pytest.approx(10.0 / float(lens.paraxial.f2()) / np.sqrt(2), rel=0.05)
