"""A lens is the same lens whatever backend Optiland computes with, and keeps its tensors. ``make test-torch`` runs it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

torch = pytest.importorskip("torch")

import optiland.backend as be  # noqa: E402
from optiland.coatings import SimpleCoating  # noqa: E402
from optiland.materials import IdealMaterial  # noqa: E402
from optiland.nonsequential.ir.scene_ir import SamplingPolicy  # noqa: E402
from optiland.optic import Optic  # noqa: E402
from optiland.samples.objectives import CookeTriplet  # noqa: E402

import nsq_gpu  # noqa: E402
from tests import live  # noqa: E402
from tests.lens_texts import seq, zmx  # noqa: E402

torch.set_num_threads(1)
PRECISIONS = ("float64", "float32")


@pytest.fixture(autouse=True)
def numpy_afterwards() -> Iterator[None]:
    yield
    be.grad_mode.disable()
    be.set_precision("float64")
    be.set_backend("numpy")


def under_torch(precision: str = "float64") -> None:
    be.set_backend("torch")
    be.set_precision(precision)


def flux(scene: Any) -> float:
    with live.quiet():
        result = scene.trace(20_000, seed=1, max_depth=32, backend=live.backend(precision="f64"))
    return float(result.detectors["image"].total_flux)


def numbers(scene: Any) -> list[Any]:
    """Return what a scene is: names, frames and report."""
    frames = [[round(float(getattr(part.cs, key)), 5) for key in ("x", "y", "z", "rx", "ry", "rz")] for part in (*scene.surfaces, *scene.sources, *scene.detectors)]
    return [scene.component_names, scene.source_names, frames, scene.conversion_report.components, scene.conversion_report.max_depth]


@pytest.mark.parametrize("with_gradients", [False, True], ids=["", "gradients"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_lens_is_the_lens_that_it_is_with_numpy(precision: str, with_gradients: bool, tmp_path: Path) -> None:
    texts = {"lens.zmx": zmx(["RAIM 0 0 1 1", "VDYN 0 0.1"], ["TYPE EVENASPH", "PARM 2 1e-6", "CLAP 1 4 0"]), "lens.seq": seq(face=["ASP", "A 1e-6"])}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    made = {"triplet": lambda: nsq_gpu.from_optic(CookeTriplet()), **{name: lambda name=name: nsq_gpu.from_file(tmp_path / name) for name in texts}}
    wanted = {name: (numbers(scene), flux(scene)) for name, make in made.items() for scene in [make()]}
    under_torch(precision)
    if with_gradients:
        be.grad_mode.enable()
    for name, make in made.items():
        scene = make()
        assert numbers(scene) == wanted[name][0]
        assert flux(scene) == pytest.approx(wanted[name][1], rel=1e-9 if precision == "float64" else 1e-5)
    # What the user set stays set.
    assert be.get_precision() == int(precision.removeprefix("float"))
    assert be.grad_mode.requires_grad == with_gradients


def singlet(radius: Any, thickness: Any, back: Any, index: Any = 1.5, conic: Any = 0.0) -> Optic:
    optic = Optic()
    optic.surfaces.add(index=0, thickness=be.inf)
    optic.surfaces.add(index=1, thickness=thickness, radius=radius, conic=conic, material=IdealMaterial(n=index), is_stop=True)
    optic.surfaces.add(index=2, thickness=back, radius=-60.0)
    optic.surfaces.add(index=3)
    optic.set_aperture("EPD", 10.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.fields.add(y=2.0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    return optic


def spread(scene: Any) -> Any:
    """Return the second moment of the image about its middle [W, in units of the detector's half width]."""
    # No ray is reflected, so that no ray takes another branch in a scene that differs a little.
    scene.sampling_policy = SamplingPolicy(reflect_prob=0.0, rr_start_flux=0.0)
    with live.quiet():
        data = scene.trace(100_000, seed=3, max_depth=8, backend=live.backend(precision="f64")).detectors["image"].data.reshape(256, 256)
    place = torch.linspace(-1.0, 1.0, 256, dtype=torch.float64)
    return (data * (place[None, :] ** 2 + place[:, None] ** 2)).sum()


def test_a_loss_reaches_radii_thicknesses_and_indices() -> None:
    under_torch()
    values = [60.0, 5.0, 40.0, 1.5, -0.3]
    tensors = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in values]
    scene = nsq_gpu.from_optic(singlet(*tensors), detector_size=(8.0, 8.0))
    assert any("tensors that want gradients are kept" in remark for remark in scene.conversion_report.remarks)
    spread(scene).backward()
    for place, tensor in enumerate(tensors):
        step = 1e-3 * abs(values[place])
        sides = [float(spread(nsq_gpu.from_optic(singlet(*(value + sign * step * (place == other) for other, value in enumerate(values))),
                                                 detector_size=(8.0, 8.0)))) for sign in (1.0, -1.0)]
        difference = (sides[0] - sides[1]) / (2.0 * step)
        assert float(tensor.grad) == pytest.approx(difference, rel=2e-3), place


def test_a_thickness_that_optiland_sets_again_keeps_its_graph() -> None:
    under_torch()
    gradients = []
    for sets in (False, True):
        back = torch.tensor(40.0, dtype=torch.float64, requires_grad=True)
        optic = singlet(60.0, 5.0, 40.0 if sets else back)
        if sets:
            optic.updater.set_thickness(back, 2)
        spread(nsq_gpu.from_optic(optic, detector_size=(8.0, 8.0))).backward()
        gradients.append(float(back.grad))
    assert gradients[0] == pytest.approx(gradients[1], rel=1e-9)
    assert gradients[0] != 0.0


def test_an_asphere_and_a_mirror_keep_their_tensors() -> None:
    under_torch()
    coefficient, reflectance = (torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (1e-5, 0.8))
    scene = Optic()
    scene.surfaces.add(index=0, thickness=be.inf)
    scene.surfaces.add(index=1, thickness=-50.0, radius=-200.0, material="mirror", is_stop=True, surface_type="even_asphere",
                       coefficients=[0.0, coefficient], coating=SimpleCoating(0.0, reflectance))
    scene.surfaces.add(index=2)
    scene.set_aperture("EPD", 10.0)
    scene.fields.set_type("angle")
    scene.fields.add(y=5.0)
    scene.wavelengths.add(value=0.55, is_primary=True)
    made = nsq_gpu.from_optic(scene, detector_size=(8.0, 8.0))
    with live.quiet():
        found = made.trace(20_000, seed=1, max_depth=8, backend=live.backend(precision="f64")).detectors["image"]
    (found.data.reshape(256, 256) * torch.linspace(-1.0, 1.0, 256, dtype=torch.float64)[:, None] ** 2).sum().backward()
    assert float(coefficient.grad) != 0.0
    # The light is in proportion to the reflectance.
    loss = float((found.data.detach().reshape(256, 256) * torch.linspace(-1.0, 1.0, 256, dtype=torch.float64)[:, None] ** 2).sum())
    assert float(reflectance.grad) == pytest.approx(loss / 0.8, rel=1e-9)


@pytest.mark.parametrize(("kind", "value"), [
    (lambda number: {"surface_type": "even_asphere", "radius": 60.0, "coefficients": [number, 1e-6]}, 1e-4),
    (lambda number: {"surface_type": "odd_asphere", "radius": 60.0, "coefficients": [0.0, 0.0, number]}, 1e-5),
    (lambda number: {"radius": 60.0, "rx": number}, 0.02)], ids=["even_asphere", "odd_asphere", "tilt"])
def test_a_coefficient_and_a_tilt_have_the_derivative_of_a_difference(kind: Any, value: float) -> None:
    under_torch()

    def loss(number: Any) -> Any:
        optic = singlet(60.0, 5.0, 40.0)
        made = Optic()
        made.surfaces.add(index=0, thickness=be.inf)
        made.surfaces.add(index=1, thickness=5.0, material=IdealMaterial(n=1.5), is_stop=True, **kind(number))
        made.surfaces.add(index=2, thickness=40.0, radius=-60.0)
        made.surfaces.add(index=3)
        made.aperture, made.fields, made.wavelengths = optic.aperture, optic.fields, optic.wavelengths
        return spread(nsq_gpu.from_optic(made, detector_size=(8.0, 8.0)))

    tensor = torch.tensor(value, dtype=torch.float64, requires_grad=True)
    loss(tensor).backward()
    step = 1e-3 * value
    assert float(tensor.grad) == pytest.approx(float(loss(value + step) - loss(value - step)) / (2.0 * step), rel=2e-3)


def test_a_norm_is_no_tensor_that_is_dropped() -> None:
    under_torch()
    norm = torch.tensor(15.0, dtype=torch.float64, requires_grad=True)
    optic = singlet(60.0, 5.0, 40.0)
    made = Optic()
    made.surfaces.add(index=0, thickness=be.inf)
    made.surfaces.add(index=1, thickness=5.0, radius=60.0, material=IdealMaterial(n=1.5), is_stop=True, surface_type="zernike", norm_radius=norm,
                      zernike_type="standard", coefficients=[0.0, 0.02, -0.03, 0.05])
    made.surfaces.add(index=2, thickness=40.0, radius=-60.0)
    made.surfaces.add(index=3)
    made.aperture, made.fields, made.wavelengths = optic.aperture, optic.fields, optic.wavelengths
    scene = nsq_gpu.from_optic(made)
    assert scene.surfaces[0].geometry.norm_radius is norm


def test_tensors_that_would_be_dropped_are_refused() -> None:
    under_torch()
    wanted = torch.tensor(200.0, dtype=torch.float64, requires_grad=True)
    optic = singlet(60.0, 5.0, 60.0)
    optic.fields.set_type("object_height")
    optic.surfaces.surfaces[0].thickness = wanted
    optic.surfaces.surfaces[0].geometry.cs.z = be.array(-200.0)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="the object's distance wants a gradient"):
        nsq_gpu.from_optic(optic)
    optic = singlet(60.0, torch.tensor(5.0, dtype=torch.float64, requires_grad=True), 40.0)
    optic.surfaces.surfaces[1].geometry.cs.rx = be.array(0.01)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="frames are tilted"):
        nsq_gpu.from_optic(optic)


def test_a_face_that_is_met_twice_gets_its_gradient_where_nobody_named_it() -> None:
    """Where every constant is a leaf, a face's second passage has leaves of its own."""
    def mangin(radius: Any) -> Any:
        optic, lens = singlet(60.0, 5.0, 40.0), Optic()
        lens.surfaces.add(index=0, thickness=be.inf)
        lens.surfaces.add(index=1, thickness=5.0, radius=radius, material=IdealMaterial(n=1.5), is_stop=True)
        lens.surfaces.add(index=2, thickness=-5.0, radius=-150.0, material="mirror")
        lens.surfaces.add(index=3, thickness=-60.0, radius=radius, material="air")
        lens.surfaces.add(index=4)
        lens.aperture, lens.fields, lens.wavelengths = optic.aperture, optic.fields, optic.wavelengths
        return nsq_gpu.from_optic(lens, detector_size=(8.0, 8.0))

    under_torch()
    named = torch.tensor(-100.0, dtype=torch.float64, requires_grad=True)
    spread(mangin(named)).backward()
    be.grad_mode.enable()
    with pytest.warns(nsq_gpu.ResultWarning, match="surface 3 is the same face as surface 1.*its radius .*no gradient"):
        scene = mangin(-100.0)
    spread(scene).backward()
    first = scene.surfaces[0].geometry.radius
    assert first.is_leaf and float(first.grad) == pytest.approx(float(named.grad), rel=1e-9)
    assert named.grad != 0.0
