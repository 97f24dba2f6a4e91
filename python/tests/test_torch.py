"""The binary against TorchBackend in float64, live. ``make test-torch`` runs it; nothing else needs Torch."""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import optiland.backend as be  # noqa: E402
from optiland.coordinate_system import CoordinateSystem  # noqa: E402
from optiland.materials.base import BaseMaterial  # noqa: E402
from optiland.nonsequential import (  # noqa: E402
    CollimatedSourceConfig,
    IrradianceDetectorConfig,
    LensConfig,
    NSQMaterial,
    NSQScene,
    Spectrum,
)
from optiland.nonsequential.backends.numpy_backend import NumpyBackend  # noqa: E402
from optiland.nonsequential.backends.torch_backend import TorchBackend  # noqa: E402
from optiland.nonsequential.bsdf import HarveyShackBSDF, LambertianBSDF  # noqa: E402
from optiland.nonsequential.components.absorbing import AbsorbingComponent  # noqa: E402
from optiland.nonsequential.components.geometry.analytic.annulus import AnnularPlaneGeometry  # noqa: E402
from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry  # noqa: E402
from optiland.nonsequential.components.reflective import ReflectiveComponent  # noqa: E402
from optiland.nonsequential.components.refractive import RefractiveComponent  # noqa: E402
from optiland.nonsequential.materials.nsq_material import VACUUM  # noqa: E402

import nsq_gpu  # noqa: E402
from nsq_gpu.bsdf import ABg, KCorrelation  # noqa: E402
from nsq_gpu.export import export_wanted  # noqa: E402
from nsq_gpu.shapes import Aperture, ClippedConic, EvenAsphere  # noqa: E402
from nsq_gpu.sources import PupilSource, TabulatedSource  # noqa: E402
from tests import live, oracle, parity  # noqa: E402
from tests.conftest import ROOT  # noqa: E402
from tests.test_bsdf import lens_and_mirror  # noqa: E402
from tests.test_convert import pupil_scene  # noqa: E402
from tests.test_tabulated import lamp, lamp_scene, with_source  # noqa: E402
from tools import make_gradients  # noqa: E402

NUM_RAYS = 20_000
#: One of each shape, source, detector and finish but meshes, at which TorchBackend raises TypeError; it keeps every ray at
#: every bounce, so deep paths take minutes.
SCENES = [ROOT / "scenes" / f"{name}.json" for name in (
    "ball_lens_ghosts", "bench_lens", "coated_projector", "cooke_triplet", "filter_stack", "hubble_nasmyth",
    "integrating_sphere", "kaleidoscope", "lambertian_sphere", "nested_media", "newtonian_telescope", "opal_lamp",
    "scattering_telescope", "tessar_gaussian_beams", "triplet_telescope_ghosts")]
# Its threads spin while they wait, which starves a device in software on the same cores.
torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def numpy_afterwards() -> Iterator[None]:
    yield
    be.set_backend("numpy")


def trace_with_torch(document: oracle.Json) -> oracle.Json:
    # Built with NumPy: Optiland's check of a lens' volume fails where Torch is set.
    scene = oracle.scene_from_dict(parity.uncapped(document))
    be.set_backend("torch")
    # The default is float32, where traces are wrong without a word.
    be.set_precision("float64")
    with torch.no_grad():
        return oracle.trace(scene, oracle.detector_kinds(document), NUM_RAYS, backend=TorchBackend(seed=0))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_ray_for_ray(scene: Path, command: list[str], report) -> None:
    theirs = trace_with_torch(json.loads(scene.read_text(encoding="utf-8")))
    options = argparse.Namespace(num_rays=NUM_RAYS, seed=0, precision="f64")
    report("torch", scene, parity.check_ray_for_ray(command, scene, theirs, options))


def assert_torch_has(maps: dict[str, np.ndarray], scene: NSQScene) -> None:
    """Optiland's tracer on Torch has these maps of irradiance of the scene."""
    be.set_backend("torch")
    be.set_precision("float64")
    with torch.no_grad():
        theirs = scene.trace(5000, seed=3, backend=TorchBackend(seed=3))
    for name, expected in maps.items():
        assert expected.sum() > 0.0
        np.testing.assert_allclose(be.to_numpy(theirs.detectors[name].irradiance), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.filterwarnings("ignore")
def test_shapes_and_sources_of_the_package() -> None:
    be.set_backend("numpy")
    scene = pupil_scene()
    found = scene.trace(5000, seed=3, backend=live.backend())
    ours = {name: np.array(detector.irradiance) for name, detector in found.detectors.items()}
    assert_torch_has(ours, scene)


@pytest.mark.filterwarnings("ignore")
def test_lamps_by_table_are_those_of_numpy() -> None:
    scene = lamp_scene()
    ours = scene.trace(5000, seed=3, backend=NumpyBackend(seed=3))
    expected = {name: np.array(found.irradiance) for name, found in ours.detectors.items()}
    assert_torch_has(expected, scene)


@pytest.mark.filterwarnings("ignore")
def test_the_flux_of_a_lamp_by_table_has_a_gradient() -> None:
    flux = torch.tensor(3.0, dtype=torch.float64, requires_grad=True)
    scene = with_source(lamp("bilateral", CoordinateSystem(z=-20.0), total_flux=flux))
    scene.add_detector("screen", CoordinateSystem(z=30.0), IrradianceDetectorConfig(60.0, 60.0, 12, 12))
    assert list(export_wanted(scene).wanted) == ["lamp.total_flux"]
    be.set_backend("torch")
    be.set_precision("float64")
    detected = scene.trace(2000, seed=3, backend=TorchBackend(seed=3)).detectors["screen"].total_flux
    detected.backward()
    assert flux.grad.item() == pytest.approx(detected.item() / 3.0, rel=1e-12)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("bsdf", [ABg(0.01, 1e-3, 1.5, 0.4), KCorrelation(0.3, 12.0, 2.5, 0.4), KCorrelation(0.3, 12.0, 2.0)])
def test_scattering_laws_of_the_package(bsdf: HarveyShackBSDF) -> None:
    scene = lens_and_mirror(bsdf=bsdf, scatter_fraction=0.5)
    ours = np.array(scene.trace(5000, seed=3, backend=live.backend()).detectors["screen"].irradiance)
    be.set_backend("torch")
    be.set_precision("float64")
    with torch.no_grad():
        theirs = scene.trace(5000, seed=3, backend=TorchBackend(seed=3)).detectors["screen"].irradiance
    assert ours.sum() > 0.0
    np.testing.assert_allclose(be.to_numpy(theirs), ours, rtol=1e-9, atol=1e-12)


# Gradients


def gradients_of(build: Any, values: dict[str, float], backend: Any, **more: Any) -> tuple[float, dict[str, float]]:
    """Return a loss that is not linear in the map, and its gradient."""
    tensors = {name: torch.tensor(value, dtype=torch.float64, requires_grad=True) for name, value in values.items()}
    result = build(tensors).trace(2000, seed=1, backend=backend, **more)
    data = result.detectors["screen"].data
    weights = torch.linspace(0.5, 2.0, data.numel(), dtype=torch.float64)
    loss = (weights * data * data).sum() + 3.0 * result.detectors["screen"].total_flux
    loss.backward()
    return loss.item(), {name: tensor.grad.item() for name, tensor in tensors.items()}


@pytest.fixture
def torch_in_f64() -> None:
    be.set_backend("torch")
    be.set_precision("float64")


@pytest.fixture
def every_constant(torch_in_f64: None) -> Iterator[None]:
    """Let Optiland make every constant a leaf that wants a gradient."""
    be.grad_mode.enable()
    yield
    be.set_backend("torch")
    be.grad_mode.disable()


def leaf(value: float) -> Any:
    return torch.tensor(value, dtype=torch.float64, requires_grad=True)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case", make_gradients.CASES, ids=lambda case: case.name)
def test_gradients_are_those_of_torch(case: Any, torch_in_f64: None) -> None:
    check_gradients(case.build, case.all_values)


def check_gradients(build: Any, values: dict[str, float], sizes: dict[str, float] | None = None) -> dict[str, float]:
    """Compare with TorchBackend; each gradient counts as a change of its parameter by the parameter's size does."""
    loss, theirs = gradients_of(build, values, TorchBackend())
    found, ours = gradients_of(build, values, live.backend(precision="f64"))
    assert found == pytest.approx(loss, rel=1e-9)
    changes = {name: theirs[name] * (sizes or values)[name] for name in values}
    most = max(map(abs, changes.values()))
    for name, change in changes.items():
        assert ours[name] * (sizes or values)[name] == pytest.approx(change, abs=1e-8 * most), name
    return ours


class Cauchy(BaseMaterial):
    """n = A + B / wavelength^2."""

    def __init__(self, a: Any, b: Any, k: Any = 0.0) -> None:
        super().__init__()
        self.a, self.b, self.k_value = a, b, k

    def _calculate_n(self, wavelength: Any, **kwargs: Any) -> Any:
        return self.a + self.b / wavelength**2

    def _calculate_k(self, wavelength: Any, **kwargs: Any) -> Any:
        return self.k_value * wavelength


@pytest.mark.filterwarnings("ignore")
def test_gradients_of_a_dispersion_formula(torch_in_f64: None) -> None:
    def build(p: dict[str, Any]) -> NSQScene:
        scene = NSQScene()
        make_gradients.beam(scene, wavelengths=(0.45, 0.55, 0.65))
        scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
            r1=p["r1"], r2=-45.0, thickness=5.0, material=NSQMaterial(Cauchy(p["a"], p["b"], p["k"])), front_aperture_radius=10.0))
        make_gradients.screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0))
        return scene

    check_gradients(build, {"r1": 60.0, "a": 1.5, "b": 0.005, "k": 1e-5})


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("as_one", [True, False])
def test_gradients_of_an_asphere_that_begins_as_a_sphere(torch_in_f64: None, as_one: bool) -> None:
    def build(p: dict[str, Any]) -> NSQScene:
        coefficients = [p["A2"], p["A4"], p["A6"], 1e-9]
        if as_one:
            coefficients = torch.stack([torch.as_tensor(value, dtype=torch.float64) for value in coefficients])
        scene = NSQScene()
        make_gradients.beam(scene)
        glass = make_gradients.glass("glass", 1.52)
        scene.add_component("front", RefractiveComponent(
            CoordinateSystem(z=20.0), EvenAsphere(p["r1"], 0.0, 10.0, coefficients), VACUUM, glass))
        scene.add_component("back", RefractiveComponent(CoordinateSystem(z=25.0), ConicGeometry(-45.0, 0.0, 10.0), glass, VACUUM))
        make_gradients.screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0))
        return scene

    # Coefficients of 0, in sizes that move the rim by 0.1 mm.
    sizes = {"r1": 60.0, "A2": 1e-3, "A4": 1e-5, "A6": 1e-7}
    found = check_gradients(build, {"r1": 60.0, "A2": 0.0, "A4": 2e-6, "A6": 0.0}, sizes)
    assert all(found.values())


def test_what_would_drop_a_tensor_refuses_it(torch_in_f64: None) -> None:
    tensor = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    spectrum = Spectrum.monochromatic(0.55)
    for name, take in (
        ("a", lambda: ABg(tensor, 1e-3, 1.5)),
        ("b0", lambda: KCorrelation(tensor, 12.0, 2.5)),
        ("beam_radii", lambda: PupilSource(CoordinateSystem(), spectrum, beam_radii=(tensor, 1.0))),
        ("intensity", lambda: TabulatedSource(CoordinateSystem(), spectrum, [0, 90], torch.stack([tensor] * 2), total_flux=1.0)),
        ("total_flux_lumens", lambda: TabulatedSource(CoordinateSystem(), spectrum, [0, 90], [1, 1], total_flux_lumens=tensor)),
    ):
        with pytest.raises(nsq_gpu.UnsupportedSceneError, match=f"(?i){name}: it has requires_grad"):
            take()


def test_a_tensor_is_exported_by_its_name_or_refused(torch_in_f64: None) -> None:
    def names(make: Any) -> list[str]:
        scene = make_gradients.singlet({"L.r1": 60.0, "L.r2": -45.0, "glass.n": 1.52})
        make(scene)
        return list(export_wanted(scene).wanted)

    def mirror(scene: NSQScene, reflectance: Any = 0.9, shape: Any = None, **more: Any) -> None:
        scene.add_component("M", ReflectiveComponent(
            CoordinateSystem(z=60.0), shape or ConicGeometry(-80.0, 0.0, 10.0), reflectance, **more))

    assert names(lambda scene: mirror(scene, lambda _: [leaf(0.9)])) == ["M.reflectance.values.0"]
    lobe = LambertianBSDF(reflectance_value=0.5)
    assert names(lambda scene: mirror(scene, bsdf=lobe, scatter_fraction=leaf(1.0))) == ["M.scatter_fraction"]

    def replaced(scene: NSQScene) -> None:
        scene.component_registry.compounds[0].surfaces[0].geometry.radius = leaf(60.0)

    assert names(replaced) == ['"L.front".radius']
    clipped = ClippedConic(-80.0, 0.0, 10.0, Aperture("ellipse", leaf(5.0), 4.0))
    assert names(lambda scene: mirror(scene, shape=clipped)) == ["M.aperture.semi_axis_x"]
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="the number has no name"):
        names(lambda scene: with_unnamed(scene, leaf(5.0)))


@pytest.mark.filterwarnings("ignore")
def test_what_acts_at_edges_alone_is_refused_backward(torch_in_f64: None) -> None:
    radius = leaf(2.5)
    data = map_of(with_stop(one_lens(60.0), radius))
    with pytest.raises(nsq_gpu.UsageError, match="stop.inner_radius.*edges alone"):
        data.sum().backward()
    # No light meets the stop's edge: the derivative that is computed is 0.
    radius = leaf(8.0)
    map_of(with_stop(one_lens(60.0), radius)).sum().backward()
    assert radius.grad == 0.0


def edge_warnings(stop: float | None, num_rays: int = 20_000, **options: Any) -> list[str]:
    """Return what is said of edges where a loss is differentiated by the radius of a lens, with a stop behind it or without."""
    scene = one_lens(leaf(30.0))
    if stop is not None:
        scene.add_component("stop", AbsorbingComponent(
            CoordinateSystem(z=32.0), AnnularPlaneGeometry(stop, torch.tensor(20.0, dtype=torch.float64)), VACUUM))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = map_of(scene, num_rays, **options)
        (torch.linspace(0.5, 2.0, data.numel(), dtype=torch.float64) * data.ravel()).sum().backward()
    return [str(warning.message) for warning in caught
            if issubclass(warning.category, nsq_gpu.ResultWarning) and "crosses edges" in str(warning.message)]


def test_light_that_crosses_edges_is_told_once_by_backward(torch_in_f64: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from nsq_gpu.session import shared_session

    monkeypatch.setattr(shared_session(live.binary(), None), "checked_shapes", set())
    assert edge_warnings(1.5, check_edges=False) == []
    (said,) = edge_warnings(1.5)
    assert "L.r1" in said and "edges=True" in said and "check_edges=False" in said
    # The same shape is not asked again; light by another path is.
    assert edge_warnings(1.5) == []
    assert len(edge_warnings(1.5, where="reflections == 0")) == 1


def test_what_stays_clear_of_edges_is_not_warned_of(torch_in_f64: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from nsq_gpu.session import shared_session

    for num_rays in (200, 2_000, 20_000):
        monkeypatch.setattr(shared_session(live.binary(), None), "checked_shapes", set())
        assert edge_warnings(None, num_rays=num_rays) == []


@pytest.mark.filterwarnings("ignore")
def test_a_graph_can_be_walked_again_and_has_no_second_derivative(torch_in_f64: None) -> None:
    r1 = torch.tensor(40.0, dtype=torch.float64, requires_grad=True)
    scene = make_gradients.singlet({"L.r1": r1, "L.r2": -1.1 * r1, "glass.n": 1.52})
    data = scene.trace(2000, seed=1, backend=live.backend(precision="f64")).detectors["screen"].data
    loss = (data * data).sum()
    (first,) = torch.autograd.grad(loss, r1, retain_graph=True)
    (again,) = torch.autograd.grad(loss, r1, retain_graph=True)
    assert first == again != 0
    theirs = scene.trace(2000, seed=1, backend=TorchBackend()).detectors["screen"].data
    (expected,) = torch.autograd.grad((theirs * theirs).sum(), r1, retain_graph=True)
    assert first.item() == pytest.approx(expected.item(), rel=1e-8)
    (slope,) = torch.autograd.grad(loss, r1, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.backward()


@pytest.mark.filterwarnings("ignore")
def test_backward_may_draw_otherwise(torch_in_f64: None) -> None:
    values = {"L.r1": 40.0, "L.r2": -45.0, "glass.n": 1.52}
    loss, same = gradients_of(make_gradients.singlet, values, live.backend(precision="f64"))
    found, other = gradients_of(make_gradients.singlet, values, live.backend(precision="f64", backward_seed=9))
    assert found == loss and other["L.r1"] != same["L.r1"]
    assert other["L.r1"] == pytest.approx(same["L.r1"], rel=0.3)


def one_lens(r1: Any = 40.0) -> NSQScene:
    return make_gradients.singlet({"L.r1": r1, "L.r2": -45.0, "glass.n": 1.52})


def with_stop(scene: NSQScene, radius: Any, name: str = "stop") -> NSQScene:
    scene.add_component(name, AbsorbingComponent(
        CoordinateSystem(z=10.0), AnnularPlaneGeometry(radius, torch.tensor(20.0, dtype=torch.float64)), VACUUM))
    return scene


def with_unnamed(scene: NSQScene, width: Any) -> NSQScene:
    """Add a mirror, whose aperture holds a number without a name."""
    outline = Aperture("union", parts=(Aperture("ellipse", width, 4.0), Aperture("ellipse", 1.0, 9.0)))
    scene.add_component("M", ReflectiveComponent(CoordinateSystem(z=60.0), ClippedConic(-80.0, 0.0, 10.0, outline), 0.9))
    return scene


def map_of(scene: NSQScene, num_rays: int = 2000, **options: Any) -> Any:
    return scene.trace(num_rays, seed=1, backend=live.backend(**options)).detectors["screen"].data


MODES = pytest.mark.parametrize("mode", ["torch_in_f64", "every_constant"])


@pytest.mark.filterwarnings("ignore")
@MODES
@pytest.mark.parametrize("without", [torch.no_grad, torch.inference_mode, None])
def test_without_gradients_tensors_are_values(without: Any, mode: str, request: pytest.FixtureRequest) -> None:
    request.getfixturevalue("torch_in_f64")
    expected = map_of(with_unnamed(one_lens(), 5.0))
    request.getfixturevalue(mode)
    options = {} if without else {"gradient": None}
    with without() if without else torch.enable_grad():
        found = map_of(with_unnamed(one_lens(leaf(40.0)), leaf(5.0)), **options)
        # A trace that writes files.
        written = map_of(one_lens(leaf(40.0)), 1_000_001, **options)
    assert torch.equal(found, expected)
    assert not found.requires_grad and not written.requires_grad


@pytest.mark.filterwarnings("ignore")
@MODES
def test_where_nothing_is_differentiated_tensors_are_values(mode: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    def found(r1: Any) -> list[Any]:
        scene, file = one_lens(r1), tmp_path / "scene.json"
        file.unlink(missing_ok=True)
        nsq_gpu.export_scene(scene, file)
        difference = nsq_gpu.diff(scene, one_lens(50.0), 2000, precision="f64", binary=live.binary())
        where = {"precision": "f64", "binary": live.binary()}
        with nsq_gpu.Session(**where) as session:
            traced = session.trace(scene, 2000, seed=1).detectors["screen"].data.tolist()
            sweep = session.sweep(scene, {"L.r1": [40.0, 45.0]}, 2000).flux["screen"].tolist()
        # What names its own numbers.
        jacobian = nsq_gpu.jacobian(scene, ["L.r1", "glass.n"], 2000, **where)["glass.n", "screen"].flux
        gradient = nsq_gpu.loss_gradient(scene, ["L.r1"], {"screen": np.ones((12, 12))}, 2000, **where)
        return [file.read_text(encoding="utf-8"), difference.detectors["screen"].difference, traced, sweep, jacobian, gradient]

    request.getfixturevalue("torch_in_f64")
    expected = found(40.0)
    request.getfixturevalue(mode)
    assert found(leaf(40.0)) == expected
    with pytest.raises(nsq_gpu.UsageError, match="edges alone"):
        nsq_gpu.jacobian(with_stop(one_lens(), leaf(2.5)), ["stop.inner_radius"], 2000, binary=live.binary())


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case", [make_gradients.CASES[0], make_gradients.CASES[3]], ids=lambda case: case.name)
def test_gradients_are_those_of_torch_where_every_constant_wants_one(case: Any, every_constant: None) -> None:
    check_gradients(case.build, case.all_values)
    assert be.grad_mode.requires_grad


def test_what_the_export_computes_with_wants_no_gradient(every_constant: None) -> None:
    scene = NSQScene()
    make_gradients.beam(scene)
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(60.0, -45.0, 5.0, "N-BK7", 10.0))
    found = export_wanted(scene)
    # The back's own frame holds leaves that are no number of the lens, and the glass its coefficients; nothing absorbs.
    assert {name.rpartition(".")[0] for name in found.wanted} == {
        "beam", '"L.front"', '"L.back"', '"L.back".cs.reference_cs', '"L.edge"', "N-BK7.n"}


@pytest.mark.filterwarnings("ignore")
def test_constants_get_the_gradients_of_their_numbers(every_constant: None) -> None:
    scene = one_lens()
    data = map_of(scene)
    (data * data).sum().backward()
    lens = scene.component_registry.compounds[0]
    leaves = {"L.x": lens.coordinate_system.x, "L.z": lens.coordinate_system.z, "L.rx": lens.coordinate_system.rx,
              "screen.z": scene.detectors[0].cs.z, "beam.ry": scene.sources[0].cs.ry,
              "glass.n": lens.surfaces[0].material_back.optiland_material.index}
    adjoints = {"screen": 2.0 * data.detach().numpy().reshape(12, 12)}
    expected = nsq_gpu.loss_gradient(scene, [*leaves, "L.thickness"], adjoints, 2000, seed=1, precision="f64",
                                     binary=live.binary())
    leaves["L.thickness"] = lens.surfaces[1].cs.z
    for name, tensor in leaves.items():
        assert tensor.is_leaf and expected[name] != 0.0
        assert tensor.grad.item() == pytest.approx(expected[name], rel=1e-9), name


def test_what_acts_at_edges_alone_is_a_warning_where_nobody_named_it(every_constant: None) -> None:
    r1, radius = leaf(40.0), leaf(2.5)
    backend = live.backend()
    warned: list[str] = []
    for _ in range(2):
        scene = with_stop(one_lens(r1), radius)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            scene.trace(2000, seed=1, backend=backend).detectors["screen"].data.sum().backward()
        warned += [str(warning.message) for warning in caught if issubclass(warning.category, nsq_gpu.ResultWarning)]
    assert radius.grad == 0.0 != r1.grad
    (told,) = [text for text in warned if "stop.inner_radius" in text]
    assert "acts at edges alone" in told and "its gradient is 0" in told
    assert len(set(warned)) == len(warned)


@pytest.mark.filterwarnings("ignore")
def test_a_number_without_a_name_is_a_warning_where_nobody_named_it(every_constant: None) -> None:
    width, weights = leaf(5.0), leaf(1.0)
    scene = with_unnamed(one_lens(), width)
    scene.sources[0].spectrum.weights = weights.reshape(1)
    with pytest.warns(nsq_gpu.ResultWarning) as caught:
        map_of(scene).sum().backward()
    told = [str(warning.message) for warning in caught if "no derivative by it" in str(warning.message)]
    assert len(told) == 2
    assert any("surface 'M': aperture: parts[0]" in text and "semi_axis_x" in text and "no name" in text for text in told)
    assert any("source 'beam': weights" in text for text in told)
    assert width.grad is None and weights.grad is None


@pytest.mark.filterwarnings("ignore")
def test_an_infinite_radius_has_no_gradient(torch_in_f64: None, request: pytest.FixtureRequest) -> None:
    flat = leaf(float("inf"))
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="radius: .*infinite.*1e6"):
        map_of(one_lens(flat))
    request.getfixturevalue("every_constant")
    with pytest.warns(nsq_gpu.ResultWarning, match="radius: .*infinite"):
        map_of(one_lens(flat)).sum().backward()
    assert flat.grad is None


@pytest.mark.filterwarnings("ignore")
def test_a_leaf_that_replaces_another_of_its_value_gets_the_gradient(torch_in_f64: None) -> None:
    old, new = leaf(40.0), leaf(40.0)
    scene = one_lens(old)
    scene.component_registry.compounds[0].surfaces[0].geometry.radius = new
    map_of(scene).square().sum().backward()
    assert old.grad is None and new.grad != 0.0


@pytest.mark.filterwarnings("ignore")
def test_gradients_go_with_paths(torch_in_f64: None) -> None:
    def traced(r1: Any, **more: Any) -> Any:
        return one_lens(r1).trace(2000, seed=1, backend=live.backend(paths="paths" in more), record_paths="paths" in more)

    r1, alone = leaf(40.0), leaf(40.0)
    result = traced(r1, paths=True)
    result.detectors["screen"].data.square().sum().backward()
    traced(alone).detectors["screen"].data.square().sum().backward()
    assert len(result.paths) > 1 and len(result.ray_paths["events"]) > 2000
    assert r1.grad == alone.grad != 0.0


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("options", [{"sampler": "sobol"}, {"target_error": 0.5}, {"time_limit": 60.0}],
                         ids=lambda options: next(iter(options)))
def test_options_that_do_not_go_with_gradients(options: dict[str, Any], torch_in_f64: None,
                                              request: pytest.FixtureRequest) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=next(iter(options))):
        map_of(one_lens(leaf(40.0)), **options)
    request.getfixturevalue("every_constant")
    with pytest.warns(nsq_gpu.ResultWarning, match=f"{next(iter(options))}.*no graph"):
        assert not map_of(one_lens(leaf(40.0)), **options).requires_grad


@pytest.mark.filterwarnings("ignore")
def test_a_scene_is_optimised_as_by_torch(torch_in_f64: None) -> None:
    """Optiland's notebook 11, with one word changed: the same radii and losses, step by step."""
    def steps(backend: Any) -> list[tuple[float, float]]:
        r1 = torch.tensor(120.0, requires_grad=True, dtype=torch.float64)
        optimizer = torch.optim.Adam([r1], lr=5.0)
        found = []
        for _ in range(8):
            optimizer.zero_grad()
            scene = NSQScene()
            scene.add_source("S1", CoordinateSystem(z=0.0), CollimatedSourceConfig(
                spectrum=Spectrum.monochromatic(0.55), total_flux=1.0, aperture_radius=10.0))
            scene.add_lens("L1", CoordinateSystem(z=100.0), LensConfig(
                r1=r1, r2=float("inf"), thickness=5.0, material="N-BK7", front_aperture_radius=10.0))
            scene.add_detector("D1", CoordinateSystem(z=210.0), IrradianceDetectorConfig(
                width=20.0, height=20.0, num_pixels_x=32, num_pixels_y=32, splat="bilinear"))
            result = backend.trace(scene, num_rays=2000, max_depth=8)
            map_ = result.detectors["D1"].data.reshape(32, 32) / (20.0 / 32) ** 2
            loss = torch.mean((map_ - 0.002) ** 2)
            loss.backward()
            optimizer.step()
            found.append((loss.item(), r1.item()))
        return found

    theirs, ours = steps(TorchBackend(seed=7)), steps(live.backend(seed=7, precision="f64"))
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)
    assert ours[-1][0] < 0.8 * ours[0][0]
