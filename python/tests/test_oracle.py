"""The scene loader against scenes built with Optiland's own classes: the traces must be the same bits."""

from __future__ import annotations

import copy
import json
import warnings

import numpy as np
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import IdealMaterial
from optiland.nonsequential import LensConfig, MirrorConfig, NSQMaterial, NSQScene
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.configs import InteractionType, SurfaceConfig
from optiland.nonsequential.components.geometry.analytic.annulus import AnnularPlaneGeometry
from optiland.nonsequential.components.geometry.analytic.frustum import CylindricalFrustumGeometry
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry, PlaneGeometry
from optiland.nonsequential.components.geometry.analytic.sphere import SphereGeometry
from optiland.nonsequential.components.reflective import ReflectiveComponent
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.nonsequential.convert import sequential_to_nonsequential
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig, RayDatabaseConfig, SpectralDetectorConfig
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.nonsequential.materials.nsq_material import VACUUM
from optiland.nonsequential.serialization import scene_to_dict
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import ExtendedSourceConfig, PointSourceConfig
from optiland.samples.objectives import CookeTriplet, TripletTelescopeObjective
from optiland.samples.simple import CementedAchromat, TelescopeDoublet

from tests.oracle import COUNTS, DETECTOR_ARRAYS, FLUXES, Json, TableMaterial, detector_kinds, scene_from_dict, trace
from tools import nouns

NUM_RAYS = 4000


def assert_same_bits(ours: Json, theirs: Json) -> None:
    for key in (*COUNTS, *FLUXES, "flux_conservation_error", "surface_hits", "absorbers"):
        assert ours[key] == theirs[key], key
    assert ours["diagnostics"] == theirs["diagnostics"]
    for name, detector in theirs["detectors"].items():
        for key in DETECTOR_ARRAYS[detector["kind"]]:
            assert np.array_equal(ours["detectors"][name][key], detector[key]), (name, key)


def test_converted_samples() -> None:
    for sample in (CookeTriplet, TripletTelescopeObjective, CementedAchromat, TelescopeDoublet):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            live = sequential_to_nonsequential(sample(), detector_pixels=(40, 30))
            document = json.loads(json.dumps(scene_to_dict(live)))
            kinds = detector_kinds(document)
            theirs = trace(live, kinds, NUM_RAYS)
            assert_same_bits(trace(scene_from_dict(document), kinds, NUM_RAYS), theirs)


def _live_scene() -> NSQScene:
    water = NSQMaterial(optiland_material=IdealMaterial(n=1.33, k=1e-6))
    flint = NSQMaterial(optiland_material=TableMaterial([0.5, 0.6], [1.65, 1.64], [0.0, 2e-6]))

    def silver(wavelength: np.ndarray) -> np.ndarray:
        return np.interp(wavelength, [0.5, 0.6], [0.9, 0.8])

    scene = NSQScene()
    outer = CoordinateSystem(x=1.0, y=2.0, z=-3.0, rx=0.1, ry=-0.2, rz=0.3)
    scene.add_component("floor", AbsorbingComponent(CoordinateSystem(z=90.0), PlaneGeometry(), name="floor"))
    scene.add_component("ball", RefractiveComponent(
        CoordinateSystem(z=8.0, ry=0.4, reference_cs=outer), SphereGeometry(6.0, 5.5), water, flint, name="ball"))
    scene.add_mirror("M", CoordinateSystem(z=60.0), MirrorConfig(
        radius=-90.0, reflectance=0.5, conic=-1.2, aperture_radius=30.0,
        surface=SurfaceConfig(aperture_radius=22.0, reflectance=silver)))
    scene.add_lens("L", CoordinateSystem(z=30.0), LensConfig(
        r1=50.0, r2=-60.0, thickness=6.0, material=water, front_aperture_radius=11.0, back_aperture_radius=12.0,
        conic1=-0.3, rim=SurfaceConfig(interaction=InteractionType.REFLECTIVE, reflectance=0.4)))
    scene.add_component("patch", ReflectiveComponent(
        CoordinateSystem(x=12.0, z=20.0, ry=1.2), FinitePlaneGeometry(width=9.0, height=14.0), silver, name="patch"))
    scene.add_component("cone", AbsorbingComponent(
        CoordinateSystem(), CylindricalFrustumGeometry(16.0, 20.0, 10.0, 26.0), name="cone"))
    scene.add_component("ring", RefractiveComponent(
        CoordinateSystem(z=45.0), AnnularPlaneGeometry(2.0, 20.0, 0.5), VACUUM, flint, name="ring"))
    scene.add_component("disk", RefractiveComponent(
        CoordinateSystem(z=45.0), FinitePlaneGeometry(aperture_radius=1.5), VACUUM, flint, name="disk"))
    both = Spectrum(wavelengths=np.array([0.5, 0.6]), weights=np.array([1.0, 3.0]))
    scene.add_source("lamp", CoordinateSystem(x=0.5), PointSourceConfig(spectrum=both, half_angle_deg=100.0,
                                                                        medium=water))
    scene.add_source("panel", CoordinateSystem(y=1.0, rz=0.3), ExtendedSourceConfig(
        spectrum=both, total_flux=2.0, aperture_radius=1.5, half_angle_deg=30.0))
    scene.add_detector("rows", CoordinateSystem(z=55.0), RayDatabaseConfig(width=30.0, height=20.0, max_rays=50,
                                                                           absorb=False))
    scene.add_detector("colours", CoordinateSystem(z=80.0), SpectralDetectorConfig(
        width=40.0, height=30.0, num_pixels_x=8, num_pixels_y=6, wl_min=0.45, wl_max=0.65, num_bins=2,
        splat="gaussian", splat_sigma=0.8))
    scene.add_detector("sky", CoordinateSystem(z=-30.0), FarFieldDetectorConfig(num_theta=12, num_phi=9))
    scene.sampling_policy = SamplingPolicy(reflect_prob=0.4, rr_start_flux=0.2)
    return scene


def _same_scene_as_document() -> Json:
    outer = nouns.cs(1.0, 2.0, -3.0, rx=0.1, ry=-0.2, rz=0.3)
    silver = nouns.reflectance_table([0.5, 0.6], [0.9, 0.8])
    water, flint = nouns.medium("water"), nouns.medium("flint")
    both = nouns.spectrum([0.5, 0.6], [1.0, 3.0])
    colours = nouns.spectral_detector("colours", nouns.cs(z=80.0), 40.0, 30.0, 8, 6, (0.45, 0.65, 2), "gaussian", 0.8)
    return nouns.document(
        [nouns.mirror("M", nouns.cs(z=60.0), -90.0, 0.5, 30.0, -1.2),
         nouns.lens("L", nouns.cs(z=30.0), 50.0, -60.0, 6.0, water, 11.0, 12.0, conic1=-0.3)],
        [nouns.point("lamp", nouns.cs(x=0.5), both, 100.0, medium=water),
         nouns.extended("panel", nouns.cs(y=1.0, rz=0.3), both, 30.0, radius=1.5, flux=2.0)],
        [nouns.ray_database("rows", nouns.cs(z=55.0), 30.0, 20.0, absorb=False), colours,
         nouns.far_field("sky", nouns.cs(z=-30.0), 12, 9)],
        media={"water": nouns.constant(1.33, 1e-6), "flint": nouns.table([0.5, 0.6], [1.65, 1.64], [0.0, 2e-6])},
        surfaces=[
            nouns.surface("floor", nouns.cs(z=90.0), nouns.plane(), "absorbing"),
            nouns.surface("ball", nouns.cs(z=8.0, ry=0.4, reference_cs=outer), nouns.sphere(6.0, 5.5), "refractive",
                          water, flint),
            nouns.surface("patch", nouns.cs(x=12.0, z=20.0, ry=1.2), nouns.plane(width=9.0, height=14.0),
                          "reflective", reflectance=silver),
            nouns.surface("cone", nouns.cs(), nouns.frustum(16.0, 20.0, 10.0, 26.0), "absorbing"),
            nouns.surface("ring", nouns.cs(z=45.0), nouns.annulus(2.0, 20.0, 0.5), "refractive", None, flint),
            nouns.surface("disk", nouns.cs(z=45.0), nouns.plane(aperture_radius=1.5), "refractive", None, flint),
        ],
        overrides={"M.surface": {"aperture_radius": 22.0, "reflectance": silver},
                   "L.rim": {"interaction": "reflective", "reflectance": 0.4}},
        order=["floor", "ball", "M", "L", "patch", "cone", "ring", "disk"],
        detectors={"rows": {"max_rays": 50}},
        sampling={"reflect_prob": 0.4, "rr_start_flux": 0.2},
    )


def test_every_part_of_the_block() -> None:
    document = json.loads(json.dumps(_same_scene_as_document()))
    kinds = detector_kinds(document)
    theirs = trace(_live_scene(), kinds, NUM_RAYS)
    assert_same_bits(trace(scene_from_dict(document), kinds, NUM_RAYS), theirs)
    # The scene must reach what it is there for.
    assert theirs["diagnostics"]["unreached_geometry"] == ["L.edge"] or not theirs["diagnostics"]["unreached_geometry"]
    assert theirs["num_rays_flux_killed"] > 0 and len(theirs["detectors"]["rows"]["x"]) == 50


def test_sampling_matters() -> None:
    document = _same_scene_as_document()
    kinds = detector_kinds(document)
    base = trace(scene_from_dict(document), kinds, NUM_RAYS)
    changed = copy.deepcopy(document)
    changed["nsq_gpu"]["sampling"] = {}
    assert trace(scene_from_dict(changed), kinds, NUM_RAYS)["surface_hits"] != base["surface_hits"]


def test_refusals() -> None:
    document = _same_scene_as_document()
    for change in ({"nsq_schema_version": 2}, {"nsq_gpu": {"version": 2}}):
        try:
            scene_from_dict({**document, **change})
        except ValueError:
            continue
        raise AssertionError(f"{change} was accepted")
