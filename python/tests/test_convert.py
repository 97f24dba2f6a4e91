"""Prescriptions become scenes that image as the sequential engine does, or are refused by name."""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
import subprocess
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
import pytest
from optiland import coatings, geometries, interactions, physical_apertures
from optiland.coordinate_system import CoordinateSystem
from optiland.geometries.base import BaseGeometry
from optiland.interactions.base import BaseInteractionModel
from optiland.materials import IdealMaterial
from optiland.nonsequential import NSQMaterial, NSQScene
from optiland.nonsequential.bsdf import LambertianBSDF
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.reflective import ReflectiveComponent
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.nonsequential.sources.base import Spectrum
from optiland.optic import Optic
from optiland.physical_apertures import (
    EllipticalAperture,
    OffsetRadialAperture,
    PolygonAperture,
    RadialAperture,
    RectangularAperture,
)
from optiland.physical_apertures.base import BaseAperture
from optiland.samples.objectives import CookeTriplet

import nsq_gpu
from nsq_gpu.convert import forms, prescription
from nsq_gpu.convert.__main__ import main
from nsq_gpu.shapes import Aperture, Biconic, Chebyshev, ClippedConic, EvenAsphere, OddAsphere, Polynomial, Toroidal, Zernike
from nsq_gpu.sources import Aim, PupilSource
from tests import live
from tools.prescriptions import compare, samples, sequential, transmitted

pytestmark = pytest.mark.in_turn

#: Samples that are refused, and what the refusal names.
REFUSED = {"Microscope20x": "surface 11: light .* run back"}
#: Samples whose mirrors stand in each other's light, which the sequential engine does not see.
OBSCURED = {"UVReflectingMicroscope"}
#: Samples whose rays are aimed at the stop.
AIMED = {"WideAngle100FOV", "ProjectionLens120FOV", "ProjectionLens160FOV", "WideAngle170FOV"}


@pytest.mark.parametrize(("name", "kind"), list(samples()), ids=lambda value: value if isinstance(value, str) else "")
def test_rays_of_a_sample_go_the_way_of_the_sequential_engine(name: str, kind: type[Optic]) -> None:
    if name in REFUSED:
        with pytest.raises(nsq_gpu.UnsupportedSceneError, match=REFUSED[name]):
            nsq_gpu.from_optic(kind())
        return
    row = compare(name, kind(), binary=live.binary())
    assert row.refused == ""
    # Through the hole of the primary mirror light reaches the image straight.
    assert row.num_gained <= (0.02 * row.num_rays if name == "HubbleTelescope" else 0)
    assert row.distance < 1e-9
    assert row.direction < 1e-12
    if name not in OBSCURED:
        assert row.num_lost == 0
    assert row.num_lost <= 0.05 * row.num_sequential
    assert ("aimed" in row.remarks) == (name in AIMED)


def test_each_field_has_the_centroid_and_the_size_of_its_spot() -> None:
    optic = CookeTriplet()
    scene = nsq_gpu.from_optic(optic)
    events = transmitted(scene, 3000, binary=live.binary()).ray_paths["events"]
    births = np.sort(events[events["event_type"] == "birth"], order="ray_id")
    places, _, arrive = sequential(optic, births)
    ends = events[(events["event_type"] == "hit") & (events["component_name"] == "")]
    ends = ends[np.argsort(ends["ray_id"])]
    assert len(ends) == len(births)
    assert arrive.all()
    for source in range(3):
        own = births["component_name"] == f"source_{source}"
        ours, theirs = np.stack([ends["x"][own], ends["y"][own]]), places[-1][own, :2].T
        np.testing.assert_allclose(ours.mean(axis=1), theirs.mean(axis=1), atol=1e-10)
        np.testing.assert_allclose(ours.std(axis=1), theirs.std(axis=1), atol=1e-10)


def test_the_triplet_transmits_the_product_of_its_fresnel_factors() -> None:
    optic = CookeTriplet()
    scene = nsq_gpu.from_optic(optic)
    result = transmitted(scene, 3000, binary=live.binary())
    events = result.ray_paths["events"]
    births = np.sort(events[events["event_type"] == "birth"], order="ray_id")
    places, directions, _ = sequential(optic, births)
    factor = np.ones(len(births))
    for index in range(1, 7):
        surface = optic.surfaces.surfaces[index]
        before, behind = (np.array([float(np.squeeze(material.n(w))) for w in births["wavelength"]])
                          for material in (optic.surfaces.surfaces[index - 1].material_post, surface.material_post))
        extinction = np.array([float(np.squeeze(optic.surfaces.surfaces[index - 1].material_post.k(w))) for w in births["wavelength"]])
        start = places[index - 1] if index > 1 else np.stack([births[key] for key in "xyz"], axis=1)
        length = np.linalg.norm(places[index] - start, axis=1)
        factor *= np.exp(-4e3 * np.pi * extinction * length / births["wavelength"])
        # From the directions on both sides: the change of n d is along the normal.
        normal = behind[:, None] * directions[index] - before[:, None] * directions[index - 1]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        cos_in, cos_out = (np.abs((side * normal).sum(axis=1)) for side in (directions[index - 1], directions[index]))
        across = (before * cos_in - behind * cos_out) / (before * cos_in + behind * cos_out)
        along = (behind * cos_in - before * cos_out) / (behind * cos_in + before * cos_out)
        factor *= 1.0 - 0.5 * (across**2 + along**2)
    # The medium behind the last surface is air.
    expected = float(births["flux"] @ factor)
    assert result.detectors["image"].total_flux == pytest.approx(expected, rel=1e-6)


def test_light_beside_an_aperture_is_absorbed_and_slips_past_nothing() -> None:
    optic = CookeTriplet()
    optic.surfaces.surfaces[3].aperture = RadialAperture(r_max=3.0)
    row = compare("clipped", optic, binary=live.binary())
    assert row.num_sequential < row.num_rays
    assert (row.num_lost, row.num_gained) == (0, 0)
    scene = nsq_gpu.from_optic(optic)
    result = transmitted(scene, 3000, binary=live.binary())
    hits = result.ray_paths["events"]
    ends = {}
    for event in hits[hits["event_type"] == "hit"]:
        ends[int(event["ray_id"])] = event["component_name"]
    assert set(ends.values()) <= {"", "L1.edge", "L1.mount", "L2.edge", "L2.mount"}


@pytest.mark.parametrize("aperture", [
    RadialAperture(r_max=4.0, r_min=1.5),
    OffsetRadialAperture(r_max=3.0, r_min=0.5, offset_x=1.0, offset_y=-0.5),
    EllipticalAperture(4.0, 2.0, offset_x=0.5, offset_y=0.25),
    RectangularAperture(-3.0, 2.0, -1.0, 4.0),
], ids=lambda aperture: type(aperture).__name__)
@pytest.mark.parametrize("index", [1, 4], ids=["front", "stop"])
def test_apertures_clip_what_the_sequential_engine_clips(aperture: Any, index: int) -> None:
    optic = CookeTriplet()
    optic.surfaces.surfaces[index].aperture = aperture
    row = compare("clipped", optic, binary=live.binary())
    assert 0 < row.num_sequential < row.num_rays
    assert (row.num_lost, row.num_gained) == (0, 0)
    assert row.distance < 1e-9


def singlet(**changes: Any) -> Optic:
    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    optic.surfaces.add(index=1, thickness=5.0, radius=60.0, material="N-BK7", is_stop=True, **changes)
    optic.surfaces.add(index=2, thickness=60.0, radius=-60.0)
    optic.surfaces.add(index=3)
    optic.set_aperture(aperture_type="EPD", value=10.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.fields.add(y=3.0, weight=2.0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    optic.wavelengths.add(value=0.65, weight=3.0)
    return optic


def test_fields_and_wavelengths_keep_their_weights() -> None:
    scene = nsq_gpu.from_optic(singlet(), detector_pixels=(16, 8), detector_size=(3.0, 2.0))
    assert scene.source_names == ["source_0", "source_1"]
    assert [source.total_flux for source in scene.sources] == [1.0, 2.0]
    for source in scene.sources:
        assert source.spectrum.wavelengths.tolist() == [0.55, 0.65]
        assert source.spectrum.weights.tolist() == [1.0, 3.0]
    [image] = scene.detectors
    assert scene.detector_names == ["image"]
    assert (image.num_pixels_x, image.num_pixels_y, float(image.width), float(image.height)) == (16, 8, 3.0, 2.0)
    report = scene.conversion_report
    assert report.components == {1: ("L1.front",), 2: ("L1.back",)}
    assert report.max_depth == 3
    assert "surface 1: L1.front" in report.summary()


@pytest.mark.parametrize(("edges", "kind"), [("absorbing", AbsorbingComponent), ("polished", object), (LambertianBSDF(0.5), object)],
                         ids=["absorbing", "polished", "BSDF"])
def test_edges_are_as_asked_for(edges: Any, kind: type) -> None:
    scene = nsq_gpu.from_optic(singlet(), edges=edges)
    edge = dict(zip(scene.component_names, scene.surfaces, strict=True))["L1.edge"]
    assert isinstance(edge, kind)
    assert isinstance(edge, AbsorbingComponent) == (edges == "absorbing")
    assert (edge.bsdf is None) == isinstance(edges, str)
    scene.trace(500, backend=live.backend())


@pytest.mark.parametrize("options", [{"edges": "rough"}, {"margin": 0.9}, {"margin": float("nan")}, {"margin": "wide"},
                                     {"detector_pixels": (0, 4)}, {"detector_pixels": 5}, {"detector_pixels": (2.5, 3)},
                                     {"detector_size": 3.0}, {"detector_size": (-1.0, 1.0)}], ids=str)
def test_arguments_that_make_no_sense_are_refused(options: Any) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=next(iter(options))):
        nsq_gpu.from_optic(singlet(), **options)


# Light of odd optics


def lens(*surfaces: dict[str, Any], thickness: float = np.inf, field: float = 0.0, kind: str = "angle", pupil: float = 10.0) -> Optic:
    """Return an optic of these surfaces, with fields at 0 and at a value."""
    optic = Optic()
    optic.surfaces.add(index=0, thickness=thickness)
    for index, surface in enumerate(surfaces, start=1):
        optic.surfaces.add(index=index, **surface)
    optic.surfaces.add(index=len(surfaces) + 1)
    optic.set_aperture(aperture_type="EPD", value=pupil)
    optic.fields.set_type(kind)
    optic.fields.add(y=0.0)
    if field:
        optic.fields.add(y=field)
    optic.wavelengths.add(value=0.55, is_primary=True)
    return optic


FRONT = {"thickness": 5.0, "radius": 60.0, "material": "N-BK7", "is_stop": True}
BACK = {"thickness": 60.0, "radius": -60.0}
ODD = {
    "a stop in glass": lambda: lens({"thickness": 3.0, "radius": 30.0, "material": IdealMaterial(1.5)},
                                    {"thickness": 3.0, "material": IdealMaterial(1.5), "is_stop": True,
                                     "aperture": RadialAperture(2.0)}, {"thickness": 30.0, "radius": -30.0}, field=5.0),
    "an aperture that is smaller than the beam": lambda: lens({**FRONT, "aperture": RadialAperture(3.0)}, BACK, field=3.0),
    "a face into the image's medium": lambda: lens({"thickness": 80.0, "radius": 30.0, "material": "N-BK7", "is_stop": True,
                                                    "aperture": RadialAperture(3.0)}),
    "two lenses in contact": lambda: lens(FRONT, {"thickness": 0.0, "radius": -60.0},
                                          {"thickness": 3.0, "radius": -60.0, "material": "SF6"},
                                          {"thickness": 60.0, "radius": -200.0}, field=3.0),
    "a finite object": lambda: lens(FRONT, BACK, thickness=150.0, field=5.0, kind="object_height"),
    "a tilted plate": lambda: lens({"thickness": 4.0, "material": "N-BK7", "rx": 0.4}, {"thickness": 20.0, "rx": 0.4}, FRONT, BACK),
    "a cemented triplet": lambda: lens(FRONT, {"thickness": 2.0, "radius": -60.0, "material": "SF6"},
                                       {"thickness": 3.0, "radius": 80.0, "material": "N-BK7"}, {"thickness": 60.0, "radius": -90.0}),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_optics_pass_and_stop_what_the_sequential_engine_does(name: str) -> None:
    row = compare(name, ODD[name](), detector_size=(60.0, 60.0), binary=live.binary())
    assert row.refused == ""
    assert row.num_sequential > 0
    assert (row.num_lost, row.num_gained) == (0, 0)
    assert row.distance < 1e-9


def mangin(**second: Any) -> Optic:
    """Return a mirror of glass, whose front face light meets twice."""
    optic = lens({"thickness": 5.0, "radius": -100.0, "material": "N-BK7", "is_stop": True},
                 {"thickness": -5.0, "radius": -150.0, "material": "mirror"}, {"thickness": -60.0, "radius": -100.0})
    for key, value in second.items():
        setattr(optic.surfaces.surfaces[3] if key == "aperture" else optic.surfaces.surfaces[3].interaction_model, key, value)
    return optic


def test_a_face_that_light_meets_twice_is_one() -> None:
    scene = nsq_gpu.from_optic(mangin())
    assert scene.conversion_report.components[1] == scene.conversion_report.components[3]


def changed(change: Any) -> Optic:
    optic = lens(FRONT, BACK, {"thickness": 1.0})
    change(optic)
    return optic


@pytest.mark.parametrize(("optic", "said"), [
    (lambda: mangin(coating=coatings.SimpleCoating(0.3, 0.1)), "surface 3 is a second passage of surface 1, with another coating"),
    (lambda: mangin(aperture=RadialAperture(3.0)), "surface 3 is a second passage of surface 1, with another aperture"),
    (lambda: lens(FRONT, BACK, thickness=-100.0, field=5.0, kind="object_height"), "surface 1: .* virtual object"),
    (lambda: changed(lambda optic: setattr(optic.surfaces.surfaces[3].interaction_model, "coating", coatings.SimpleCoating(0.3, 0.1))),
     "surface 3: its coating lies between equal media"),
    (lambda: changed(lambda optic: setattr(optic.surfaces.surfaces[-1], "aperture", RadialAperture(0.5))), "the image's aperture"),
    (lambda: changed(lambda optic: optic.wavelengths.wavelengths.clear()), "Optiland cannot trace this optic"),
    (Optic, "Optiland cannot trace this optic"),
], ids=["coating", "aperture", "virtual", "filter", "image", "no wavelength", "empty"])
def test_what_cannot_be_carried_is_refused_by_name(optic: Any, said: str) -> None:
    with live.quiet(), pytest.raises(nsq_gpu.UnsupportedSceneError, match=said):
        nsq_gpu.from_optic(optic())


@pytest.mark.parametrize("optic", [3, None, "lens.zmx"])
def test_what_is_no_optic_is_refused(optic: Any) -> None:
    with pytest.raises(nsq_gpu.UsageError, match="give Optiland's Optic, or the path of a file to nsq_gpu.from_file"):
        nsq_gpu.from_optic(optic)


def test_what_stands_in_the_light_is_said() -> None:
    # Two mirrors on one axis, with an image behind the first one, which has no hole.
    optic = lens({"thickness": 100.0}, {"thickness": -60.0, "radius": -300.0, "material": "mirror", "is_stop": True},
                 {"thickness": 80.0, "material": "mirror"})
    remarks = nsq_gpu.from_optic(optic).conversion_report.remarks
    assert any("M2 stands in the light between the object and M1" in remark for remark in remarks)
    assert any("M1 stands in the light between M2 and the image" in remark for remark in remarks)
    row = compare("mirrors", optic, binary=live.binary())
    assert row.num_lost > 0.9 * row.num_sequential


def test_fresnels_law_as_a_coating_is_bare_glass() -> None:
    optic = lens(FRONT, BACK)
    optic.surfaces.set_fresnel_coatings()
    scene = nsq_gpu.from_optic(optic)
    assert scene.conversion_report.uncoated_surfaces == ["L1.front", "L1.back"]
    assert all(type(surface.interaction_model.coating) is coatings.FresnelCoating for surface in optic.surfaces.surfaces[1:3])


# Nothing is flattened without a word


def subclasses(package: Any, base: type) -> list[type]:
    """Return all classes of a package that derive from a base, and can be made."""
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)
    found, left = set(), [base]
    while left:
        left.extend(new := set(left.pop().__subclasses__()) - found)
        found |= new
    return sorted((kind for kind in found if kind.__module__.startswith("optiland") and not inspect.isabstract(kind)),
                  key=lambda kind: kind.__name__)


@pytest.mark.parametrize("kind", subclasses(geometries, BaseGeometry), ids=lambda kind: kind.__name__)
def test_every_shape_of_optiland_is_carried_or_refused_by_name(kind: type) -> None:
    optic = singlet()
    surface = optic.surfaces.surfaces[1]
    if kind in forms._KINDS:
        return
    # An object of the class without its numbers: the class alone decides.
    other = object.__new__(kind)
    other.__dict__.update(surface.geometry.__dict__)
    other.__dict__["coefficients"] = np.array([1e-5])
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match=rf"surface 1: its shape \({kind.__name__}\)"):
        forms.form_of(other, "surface 1")


@pytest.mark.parametrize("kind", subclasses(interactions, BaseInteractionModel), ids=lambda kind: kind.__name__)
def test_every_interaction_of_optiland_is_carried_or_refused_by_name(kind: type) -> None:
    optic = singlet()
    surface = optic.surfaces.surfaces[1]
    if kind is type(surface.interaction_model):
        return
    model = object.__new__(kind)
    model.__dict__.update(surface.interaction_model.__dict__)
    surface.interaction_model = model
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match=f"surface 1: a {kind.__name__}"):
        prescription._check(optic)


def test_every_coating_of_optiland_is_carried_or_refused_by_name() -> None:
    found = [kind for _, kind in inspect.getmembers(coatings, inspect.isclass)
             if issubclass(kind, coatings.BaseCoating) and not inspect.isabstract(kind)]
    assert len(found) > 4
    for kind in found:
        if kind in (coatings.SimpleCoating, coatings.FresnelCoating, coatings.ThinFilmCoating):
            continue
        optic = singlet()
        optic.surfaces.surfaces[1].interaction_model.coating = object.__new__(kind)
        with pytest.raises(nsq_gpu.UnsupportedSceneError, match=f"surface 1: a {kind.__name__}"):
            nsq_gpu.from_optic(optic)


def test_every_aperture_of_optiland_is_carried_and_another_is_refused_by_name() -> None:
    assert set(subclasses(physical_apertures, BaseAperture)) == set(prescription._APERTURES)

    class Star(PolygonAperture):
        pass

    for aperture in (Star([0, 1, 0], [0, 0, 1]), RadialAperture(5.0) - Star([0, 1, 0], [0, 0, 1])):
        optic = singlet()
        optic.surfaces.surfaces[1].aperture = aperture
        with pytest.raises(nsq_gpu.UnsupportedSceneError, match=r"surface 1: its aperture \(Star\)"):
            prescription._check(optic)


TRIANGLE = PolygonAperture([-6.0, 7.0, 0.5], [-5.0, -4.0, 6.0])
APERTURES: dict[str, BaseAperture] = {
    "polygon": TRIANGLE,
    "union": RectangularAperture(-6.0, -1.0, -3.0, 5.0) | RadialAperture(3.0),
    "intersection": TRIANGLE & RadialAperture(4.5, 1.0),
    "difference": RadialAperture(7.0) - EllipticalAperture(2.0, 1.0, 1.5, -0.5),
    "spider": RadialAperture(7.0) - (RectangularAperture(-0.5, 0.5, -9.0, 9.0) | RectangularAperture(-9.0, 9.0, -0.5, 0.5)),
    "ellipse": EllipticalAperture(5.0, 3.0, 0.5, -1.0),
}


@pytest.mark.parametrize("shape", ["standard", "even_asphere", "biconic", "zernike"])
@pytest.mark.parametrize("name", APERTURES)
def test_apertures_of_any_surface_pass_and_stop_what_the_sequential_engine_does(name: str, shape: str) -> None:
    kinds: dict[str, dict[str, Any]] = {"standard": {"radius": 50.0}, **{kind.split()[0]: spec for kind, spec in FREEFORMS.items()},
                                        "even_asphere": {"surface_type": "even_asphere", "radius": 35.0, "coefficients": [1e-4, -2e-7]}}
    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    optic.surfaces.add(index=1, thickness=8.0, material="N-BK7", is_stop=True, aperture=APERTURES[name], **kinds[shape])
    optic.surfaces.add(index=2, thickness=50.0, radius=-200.0)
    optic.surfaces.add(index=3)
    optic.set_aperture(aperture_type="EPD", value=16.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.fields.add(x=2.0, y=4.0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    optic.surfaces.surfaces[1].geometry.tol = 1e-13
    row = compare(name, optic, binary=live.binary())
    assert (row.refused, row.num_lost, row.num_gained) == ("", 0, 0)
    assert 0 < row.num_sequential < row.num_rays
    assert row.distance < 1e-9
    # What the aperture leaves out of the face absorbs.
    assert "L1.front.mask" in nsq_gpu.from_optic(optic).component_names


@pytest.mark.parametrize("kind", ["even_asphere", "odd_asphere"])
def test_rays_meet_an_asphere_where_the_sequential_engine_does(kind: str) -> None:
    optic = Optic()
    coefficients = [1e-4, -2e-6, 3e-8] if kind == "even_asphere" else [0.0, 2e-4, -3e-5, 2e-6, 1e-7]
    optic.surfaces.add(index=0, thickness=np.inf)
    optic.surfaces.add(index=1, thickness=6.0, radius=35.0, conic=-0.7, material="N-BK7", is_stop=True, surface_type=kind,
                       coefficients=coefficients)
    optic.surfaces.add(index=2, thickness=50.0, radius=-200.0)
    optic.surfaces.add(index=3)
    optic.set_aperture(aperture_type="EPD", value=16.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.fields.add(y=6.0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    row = compare(kind, optic, binary=live.binary())
    assert (row.refused, row.num_lost, row.num_gained) == ("", 0, 0)
    assert row.distance < 1e-9
    assert row.direction < 1e-12
    changed = nsq_gpu.from_optic(optic).surfaces[0].geometry
    assert changed.coefficients == coefficients


FREEFORMS: dict[str, dict[str, Any]] = {
    "biconic": {"surface_type": "biconic", "radius_x": 35.0, "radius_y": 60.0, "conic_x": -0.7, "conic_y": 0.4},
    "toroidal": {"surface_type": "toroidal", "radius": 35.0, "radius_x": 60.0, "conic": -0.5, "toroidal_coeffs_poly_y": [1e-4, -3e-7]},
    "cylinder": {"surface_type": "toroidal", "radius": 35.0, "radius_x": np.inf},
    "polynomial": {"surface_type": "polynomial", "radius": 40.0, "conic": -0.5,
                   "coefficients": [[0.0, 1e-3, 2e-4], [-2e-3, 1e-4, 3e-6], [1e-4, -2e-6, 0.0]]},
    "chebyshev": {"surface_type": "chebyshev", "radius": 40.0, "conic": -0.5, "norm_x": 14.0, "norm_y": 16.0,
                  "coefficients": [[0.0, 0.01, 0.03], [-0.02, 0.01, 0.005], [0.04, -0.01, 0.002]]},
    **{f"zernike {kind}": {"surface_type": "zernike", "radius": 40.0, "conic": -0.5, "norm_radius": 15.0, "zernike_type": kind,
                           "coefficients": [0.0, 0.02, -0.03, 0.05, 0.03, -0.02, 0.01, 0.006, 0.02, -0.01, 0.004]}
       for kind in ("standard", "noll", "fringe")},
}


@pytest.mark.parametrize("name", FREEFORMS)
def test_rays_meet_a_freeform_where_the_sequential_engine_does(name: str) -> None:
    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    optic.surfaces.add(index=1, thickness=8.0, material="N-BK7", is_stop=True, **FREEFORMS[name])
    optic.surfaces.add(index=2, thickness=50.0, radius=-200.0)
    optic.surfaces.add(index=3)
    optic.set_aperture(aperture_type="EPD", value=16.0)
    optic.fields.set_type("angle")
    for x, y in ((0.0, 0.0), (0.0, 5.0), (3.0, -2.0)):
        optic.fields.add(x=x, y=y)
    optic.wavelengths.add(value=0.55, is_primary=True)
    optic.surfaces.surfaces[1].geometry.tol = 1e-13
    row = compare(name, optic, binary=live.binary())
    assert (row.refused, row.num_lost, row.num_gained) == ("", 0, 0)
    assert row.distance < 1e-9
    assert row.direction < 1e-12
    scene = nsq_gpu.from_optic(optic)
    assert type(scene.surfaces[0].geometry).__name__.lower() == ("toroidal" if name == "cylinder" else name.split()[0])
    assert "L1.edge" in scene.component_names
    assert not any("stands in the light" in remark for remark in scene.conversion_report.remarks)


def test_a_detector_in_the_light_is_told() -> None:
    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    optic.surfaces.add(index=1, thickness=150.0, is_stop=True)
    optic.surfaces.add(index=2, thickness=-100.0, radius=-200.0, conic=-1.0, material="mirror")
    optic.surfaces.add(index=3)
    optic.set_aperture(aperture_type="EPD", value=20.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.fields.add(y=1.0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    row = compare("newton", optic, binary=live.binary())
    assert row.num_lost > 0
    assert "the detector 'image' stands in the light between the object and M1" in row.remarks


@pytest.mark.parametrize(("change", "said"), [
    (lambda scene: setattr(scene.sources[0], "aimed", (Aim(0.5, [0.1]),)), r"aimed\[0\]: x: \[0.1\] are no rows"),
    (lambda scene: setattr(scene.sources[0], "aimed", (1.0,)), r"aimed\[0\]: it is a float"),
    (lambda scene: setattr(scene.surfaces[0].geometry, "aperture", Aperture("polygon", vertices=(1.0, 2.0))), "vertices: .* are no rows"),
])
def test_what_is_no_table_is_refused_by_its_place(change: Any, said: str, tmp_path: Path) -> None:
    scene = pupil_scene()
    change(scene)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match=said):
        nsq_gpu.export_scene(scene, tmp_path / "scene.json")


def test_faces_that_run_along_each_other_do_not_cross() -> None:
    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    for index, thickness, material in ((1, 2.0, "N-BK7"), (2, 60.0, "air")):
        optic.surfaces.add(index=index, thickness=thickness, material=material, is_stop=index == 1, surface_type="biconic", radius_x=50.0,
                           radius_y=np.inf)
    optic.surfaces.add(index=3)
    optic.set_aperture(aperture_type="EPD", value=28.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    report = nsq_gpu.from_optic(optic).conversion_report
    assert not any("cross" in remark for remark in report.remarks)
    assert "room for a frustum" in report.without_edge["L1.edge"]


def test_a_cylinder_that_is_longer_than_its_radius_is_refused_by_name() -> None:
    optic = singlet(surface_type="toroidal", radius_x=10.0)
    optic.surfaces.surfaces[1].geometry.R_rot = np.float64(4.0)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="surface 1: rays meet it up to .* Toroidal ends"):
        nsq_gpu.from_optic(optic)


def test_an_asphere_with_more_coefficients_than_a_scene_has_is_refused() -> None:
    geometry = geometries.EvenAsphere(CoordinateSystem(), 50.0, coefficients=[1e-9] * 11)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match=r"surface 1: its shape \(EvenAsphere\) has 11 coefficients; 10"):
        forms.form_of(geometry, "surface 1")


def test_a_coating_is_carried() -> None:
    optic = singlet()
    optic.surfaces.surfaces[1].interaction_model.coating = coatings.SimpleCoating(0.7, 0.2)
    scene = nsq_gpu.from_optic(optic)
    assert scene.conversion_report.coated_surfaces == ["L1.front"]
    assert transmitted(scene, 1000, binary=live.binary()).total_flux_absorbed < 1e-12
    found = scene.surfaces[0].coating
    assert (found.transmittance, found.reflectance) == (0.7, 0.2)


def test_apodisation_is_refused() -> None:
    from optiland.apodization import GaussianApodization

    optic = singlet()
    optic.apodization = GaussianApodization(0.5)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="GaussianApodization"):
        nsq_gpu.from_optic(optic)


# Files


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "iso-8859-1"])
def test_a_zemax_file_is_read_whatever_its_encoding(tmp_path: Path, encoding: str) -> None:
    from optiland.fileio import save_zemax_file

    path = tmp_path / "lens.zmx"
    save_zemax_file(CookeTriplet(), str(path))
    path.write_bytes(path.read_text(encoding="utf-8", errors="ignore").encode(encoding, errors="ignore"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = nsq_gpu.from_file(path)
    assert len(scene.conversion_report.components) == 6


def test_the_command_writes_a_scene_that_traces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from optiland.fileio import save_optiland_file

    lens, scene = tmp_path / "lens.json", tmp_path / "scene.json"
    save_optiland_file(CookeTriplet(), str(lens))
    assert main([str(lens), "-o", str(scene), "--pixels", "32"]) == 0
    assert "surface 6: L3.back" in capsys.readouterr().out
    subprocess.run([live.binary(), "trace", str(scene), "-n", "1000", "-o", str(tmp_path / "out"), "--no-pictures"],
                   check=True, capture_output=True)
    assert json.loads((tmp_path / "out" / "report.json").read_text())["detectors"]["image"]["num_rays_hit"] > 500


def test_what_is_no_lens_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "lens.txt"
    other.write_text("lens")
    broken = tmp_path / "lens.zmx"
    broken.write_text("no lens")
    for path, said in ((other, r"\.zmx"), (tmp_path / "none.zmx", "no such file"), (broken, "cannot read it")):
        with pytest.raises(nsq_gpu.UsageError, match=said):
            nsq_gpu.from_file(path)
        assert main([str(path)]) == 2
    assert "error: " in capsys.readouterr().err


# The source and the shape


def pupil_scene() -> NSQScene:
    scene = NSQScene()
    lines = Spectrum([0.5, 0.6], [1.0, 2.0])
    water = NSQMaterial(optiland_material=IdealMaterial(n=1.33, k=1e-6))
    field = PupilSource(CoordinateSystem(x=1.0, y=-2.0, z=3.0, rx=0.1, ry=-0.2, rz=0.3), lines, 2.0, beam_radii=(3.0, 1.0),
                        chief=(0.1, -0.2, 1.0), pupil_radii=(0.3, 0.1), medium=water)
    scene.source_registry.add("field", field)
    scene.source_registry.add("star", PupilSource(CoordinateSystem(z=-10.0), lines, 1.0, beam_radii=(2.0, 2.0), chief=(0.0, 0.1, 1.0)))
    scene.source_registry.add("point", PupilSource(CoordinateSystem(z=-20.0), lines, 1.0, pupil_radii=(0.2, 0.2)))
    mirror = ClippedConic(-50.0, -1.0, 8.0, Aperture("ellipse", 6.0, 4.0, 0.5, 1.0, hole_radius=1.0))
    scene.add_component("mirror", ReflectiveComponent(CoordinateSystem(z=20.0), mirror, 0.9, name="mirror"))
    rest = ClippedConic(-50.0, -1.0, 8.0, Aperture("rectangle", 7.0, 2.0, -0.5, 1.0, inverted=True))
    scene.add_component("rest", AbsorbingComponent(CoordinateSystem(z=25.0), rest, name="rest"))
    flat = ClippedConic(float("inf"), 0.0, 5.0, Aperture("rectangle", 2.0, 1.0))
    scene.add_component("flat", AbsorbingComponent(CoordinateSystem(z=15.0, rx=0.2), flat, name="flat"))
    bowl = EvenAsphere(30.0, -0.5, 9.0, [1e-4, -2e-6, 3e-9])
    scene.add_component("bowl", ReflectiveComponent(CoordinateSystem(z=30.0, ry=0.1), bowl, 0.8, name="bowl"))
    cone = OddAsphere(float("inf"), 0.0, 12.0, [0.1, 0.0, -1e-4])
    scene.add_component("cone", ReflectiveComponent(CoordinateSystem(z=-25.0, rx=0.1), cone, 0.7, name="cone"))
    disk, slot = Aperture("ellipse", 7.0, 6.0), Aperture("rectangle", 1.0, 9.0, x=1.0)
    triangle = Aperture("polygon", vertices=((-6.0, -5.0), (7.0, -4.0), (0.5, 6.0)))
    freeforms = [
        Biconic(40.0, -30.0, 8.0, 0.5, -1.0, aperture=Aperture("difference", parts=(disk, slot))),
        Toroidal(-35.0, 50.0, 8.0, -0.5, [1e-3, -1e-6], aperture=triangle),
        Polynomial(float("inf"), 0.0, 8.0, [[0.0, 0.02, -1e-3], [0.03, 1e-3], [2e-3]], aperture=Aperture("union", parts=(triangle, slot))),
        Chebyshev(60.0, -0.5, 8.0, [[0.0, 0.1, -0.05], [0.05, 0.02, 0.01]], 9.0, 10.0),
        Zernike(-70.0, 0.0, 8.0, [0.0, 0.05, -0.02, 0.1, 0.03, -0.02, 0.01], "noll", 9.0, Aperture("intersection", parts=(disk, triangle))),
    ]
    for number, shape in enumerate(freeforms):
        name = type(shape).__name__
        frame = CoordinateSystem(x=6.0 * (number - 2.0), y=3.0, z=35.0 + number, rx=0.1 * number)
        scene.add_component(name, ReflectiveComponent(frame, shape, 0.9, name=name))
    aimed = [Aim(float(line), x=[[0.1], [0.0, 0.5]], y=[[0.0, 0.2]], vector_x=[[], [0.02]], vector_y=[[0.0, line / 10.0]])
             for line in lines.wavelengths]
    scene.source_registry.add("aimed", PupilSource(CoordinateSystem(z=-5.0), lines, 2.0, beam_radii=(12.0, 6.0), aimed=aimed))
    scene.add_detector("back", CoordinateSystem(z=-21.0), IrradianceDetectorConfig(60.0, 60.0, 32, 32, absorb=False))
    scene.add_detector("front", CoordinateSystem(z=28.5), IrradianceDetectorConfig(60.0, 60.0, 32, 32, absorb=False))
    return scene


def test_the_source_and_the_shape_trace_as_on_numpy() -> None:
    scene = pupil_scene()
    theirs = scene.trace(20_000, seed=3)
    ours = scene.trace(20_000, seed=3, backend=live.backend())
    for name in scene.detector_names:
        one, other = ours.detectors[name].irradiance, theirs.detectors[name].irradiance
        assert other.sum() > 0.0
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    assert ours.num_rays_absorbed == theirs.num_rays_absorbed > 0


def test_a_scene_that_is_moved_as_a_whole_is_the_same_scene() -> None:
    options = {"backend": live.backend(), "record_paths": 500, "seed": 5}
    plain = live.sorted_paths(pupil_scene().trace(500, **options))
    scene = pupil_scene()
    frame = CoordinateSystem(x=300.0, y=-200.0, z=1e4, rx=0.7, ry=-1.1, rz=2.0)
    for part in (*scene.surfaces, *scene.sources, *scene.detectors):
        part.cs.reference_cs = frame
    moved = live.sorted_paths(scene.trace(500, **options))
    for key in ("ray_id", "event_type", "bounce", "component_name"):
        np.testing.assert_array_equal(moved[key], plain[key])
    position, rotation = prescription.placed(frame)
    places, directions = (np.stack([moved[axis] for axis in axes], axis=1) for axes in ("xyz", "LMN"))
    np.testing.assert_allclose((places - position) @ rotation, np.stack([plain[axis] for axis in "xyz"], axis=1), atol=1e-9)
    np.testing.assert_allclose(directions @ rotation, np.stack([plain[axis] for axis in "LMN"], axis=1), atol=1e-11)


def test_scene_files_hold_the_source_and_the_shape(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    nsq_gpu.export_scene(pupil_scene(), path)
    again = nsq_gpu.load_scene(path)
    one, other = (scene.trace(5000, seed=1, backend=live.backend()) for scene in (pupil_scene(), again))
    for name in one.detectors:
        assert one.detectors[name].irradiance.tobytes() == other.detectors[name].irradiance.tobytes()


def test_optilands_own_files_refuse_the_source(tmp_path: Path) -> None:
    scene = NSQScene()
    scene.source_registry.add("star", PupilSource(CoordinateSystem(), Spectrum([0.5], [1.0])))
    scene.add_detector("image", CoordinateSystem(z=10.0), IrradianceDetectorConfig(2.0, 2.0, 2, 2))
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="export_scene"):
        scene.to_json(str(tmp_path / "scene.json"))


def test_a_session_takes_lenses_of_one_shape_as_one() -> None:
    with nsq_gpu.Session(binary=live.binary(), precision="f64") as session:
        for radius in (50.0, 60.0, 70.0):
            optic = singlet()
            optic.surfaces.surfaces[2].geometry.radius = be.array(-radius)
            scene = nsq_gpu.from_optic(optic)
            ours = session.trace(scene, 5000)
            expected = scene.trace(5000, backend=live.backend())
            np.testing.assert_array_equal(ours.detectors["image"].irradiance, expected.detectors["image"].irradiance)
        assert session.hello()["num_shaders"] == 1
