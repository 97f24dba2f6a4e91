"""The binary against TorchBackend in float64, live. ``make test-torch`` runs it; nothing else needs Torch."""

from __future__ import annotations

import argparse
import json
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
from nsq_gpu.sources import PupilSource  # noqa: E402
from tests import live, oracle, parity  # noqa: E402
from tests.conftest import ROOT  # noqa: E402
from tests.test_bsdf import lens_and_mirror  # noqa: E402
from tests.test_convert import pupil_scene  # noqa: E402
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


@pytest.mark.filterwarnings("ignore")
def test_shapes_and_sources_of_the_package() -> None:
    be.set_backend("numpy")
    scene = pupil_scene()
    found = scene.trace(5000, seed=3, backend=live.backend())
    ours = {name: np.array(detector.irradiance) for name, detector in found.detectors.items()}
    be.set_backend("torch")
    be.set_precision("float64")
    with torch.no_grad():
        theirs = scene.trace(5000, seed=3, backend=TorchBackend(seed=3))
    for name, expected in ours.items():
        assert expected.sum() > 0.0
        np.testing.assert_allclose(be.to_numpy(theirs.detectors[name].irradiance), expected, rtol=1e-9, atol=1e-12)


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
    ):
        with pytest.raises(nsq_gpu.UnsupportedSceneError, match=f"(?i){name}: it has requires_grad"):
            take()


def test_a_tensor_is_exported_by_its_name_or_refused(torch_in_f64: None) -> None:
    def tensor(value: float) -> Any:
        return torch.tensor(value, dtype=torch.float64, requires_grad=True)

    def names(make: Any) -> list[str]:
        scene = make_gradients.singlet({"L.r1": 60.0, "L.r2": -45.0, "glass.n": 1.52})
        make(scene)
        return list(export_wanted(scene).wanted)

    def mirror(scene: NSQScene, reflectance: Any = 0.9, shape: Any = None, **more: Any) -> None:
        scene.add_component("M", ReflectiveComponent(
            CoordinateSystem(z=60.0), shape or ConicGeometry(-80.0, 0.0, 10.0), reflectance, **more))

    assert names(lambda scene: mirror(scene, lambda _: [tensor(0.9)])) == ["M.reflectance.values.0"]
    lobe = LambertianBSDF(reflectance_value=0.5)
    assert names(lambda scene: mirror(scene, bsdf=lobe, scatter_fraction=tensor(1.0))) == ["M.scatter_fraction"]

    def replaced(scene: NSQScene) -> None:
        scene.component_registry.compounds[0].surfaces[0].geometry.radius = tensor(60.0)

    assert names(replaced) == ['"L.front".radius']
    clipped = ClippedConic(-80.0, 0.0, 10.0, Aperture("ellipse", tensor(5.0), 4.0))
    assert names(lambda scene: mirror(scene, shape=clipped)) == ["M.aperture.semi_axis_x"]
    both = Aperture("union", parts=(Aperture("ellipse", tensor(5.0), 4.0), Aperture("ellipse", 1.0, 9.0)))
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="the number has no name"):
        names(lambda scene: mirror(scene, shape=ClippedConic(-80.0, 0.0, 10.0, both)))


@pytest.mark.filterwarnings("ignore")
def test_what_acts_at_edges_alone_is_refused_backward(torch_in_f64: None) -> None:
    def build(radius: Any) -> NSQScene:
        scene = make_gradients.singlet({"L.r1": 60.0, "L.r2": -45.0, "glass.n": 1.52})
        scene.add_component("stop", AbsorbingComponent(
            CoordinateSystem(z=10.0), AnnularPlaneGeometry(radius, torch.tensor(20.0, dtype=torch.float64)), VACUUM))
        return scene

    radius = torch.tensor(2.5, dtype=torch.float64, requires_grad=True)
    data = build(radius).trace(2000, seed=1, backend=live.backend(precision="f64")).detectors["screen"].data
    with pytest.raises(nsq_gpu.UsageError, match="stop.inner_radius.*edges alone"):
        data.sum().backward()
    # No light meets the stop's edge: the derivative that is computed is 0.
    radius = torch.tensor(8.0, dtype=torch.float64, requires_grad=True)
    build(radius).trace(2000, seed=1, backend=live.backend(precision="f64")).detectors["screen"].data.sum().backward()
    assert radius.grad == 0.0


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


@pytest.mark.filterwarnings("ignore")
def test_without_gradients_tensors_are_traced_or_refused(torch_in_f64: None) -> None:
    tensor = torch.tensor(40.0, dtype=torch.float64, requires_grad=True)
    scene = make_gradients.singlet({"L.r1": tensor, "L.r2": -45.0, "glass.n": 1.52})
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="requires_grad"):
        scene.trace(100, backend=live.backend(gradient=None))
    with pytest.raises(nsq_gpu.UsageError, match="sobol"):
        scene.trace(100, backend=live.backend(sampler="sobol"))


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
