"""The exporter: what it writes traces as the live scene does, nothing that matters is dropped, the rest is refused."""

from __future__ import annotations

import dataclasses
import inspect
import json
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import trimesh
from optiland.coatings import FresnelCoating, SimpleCoating
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import AbbeMaterial, IdealMaterial, Material
from optiland.materials.base import BaseMaterial
from optiland.nonsequential import DoubletConfig, LensConfig, MirrorConfig, NSQMaterial, NSQScene
from optiland.nonsequential.bsdf import HarveyShackBSDF, LambertianBSDF, SpecularBRDF, TabulatedBSDF
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.base import BaseComponent
from optiland.nonsequential.components.configs import InteractionType, SurfaceConfig
from optiland.nonsequential.components.geometry.analytic.annulus import AnnularPlaneGeometry
from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry, ParaboloidGeometry
from optiland.nonsequential.components.geometry.analytic.frustum import CylindricalFrustumGeometry
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry, PlaneGeometry
from optiland.nonsequential.components.geometry.analytic.sphere import SphereGeometry
from optiland.nonsequential.components.geometry.mesh.mesh_geometry import MeshGeometry
from optiland.nonsequential.components.reflective import ReflectiveComponent
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.nonsequential.detectors.configs import (
    FarFieldDetectorConfig,
    IrradianceDetectorConfig,
    RayDatabaseConfig,
    SpectralDetectorConfig,
)
from optiland.nonsequential.detectors.far_field import FarFieldDetector
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.nonsequential.materials.nsq_material import VACUUM
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig, ExtendedSourceConfig, PointSourceConfig

from nsq_gpu import UnsupportedSceneError, export_scene
from nsq_gpu.bsdf import KCorrelation, MeasuredBSDF
from nsq_gpu.export import export, to_json
from nsq_gpu.export.surfaces import BSDFS, SHAPES
from nsq_gpu.scene_file import scene_from_dict
from nsq_gpu.shapes import Aperture, Biconic, Chebyshev, ClippedConic, EvenAsphere, OddAsphere, Polynomial, Toroidal, Zernike
from nsq_gpu.sources import Aim, PupilSource, RaySource
from tests import live
from tests.agreement import compare
from tests.live import (
    SCENES,
    agreement,
    backend,
    bench,
    cs,
    assert_agrees_with_numpy,
    glass,
    same,
    traced,
    two_lines,
)
from tests.oracle import Json
from tests.parity import load_result

NUM_RAYS = 1500


@pytest.fixture(scope="session")
def schema() -> jsonschema.Draft202012Validator:
    printed = subprocess.run([live.binary(), "schema"], check=True, capture_output=True, text=True).stdout
    return jsonschema.Draft202012Validator(json.loads(printed))


def document(scene: NSQScene) -> Json:
    """Return the content of the scene's file, as it is read back."""
    with live.quiet():
        return json.loads(to_json(export(scene).document))


def read_back(content: Json) -> NSQScene:
    with live.quiet():
        return scene_from_dict(content)


# Whole files


@pytest.mark.parametrize("path", live.in_turn(SCENES), ids=lambda path: path.stem)
def test_the_file_alone_traces_as_the_live_scene(
    path: Path, tmp_path: Path, schema: jsonschema.Draft202012Validator
) -> None:
    scene = live.load(path)
    with live.quiet():
        export_scene(scene, tmp_path / "scene.json")
    content = json.loads((tmp_path / "scene.json").read_text(encoding="utf-8"))
    schema.validate(content)
    assert document(read_back(content)) == content
    command = [live.binary(), "trace", str(tmp_path / "scene.json"), "-n", str(NUM_RAYS), "--precision", "f64",
               "--max-depth", "16", "-o", str(tmp_path / "out")]
    subprocess.run(command, check=True, capture_output=True)
    by_command = load_result(tmp_path / "out")
    _, by_backend = traced(scene, NUM_RAYS, backend())
    assert not compare(by_backend, by_command).violations


def test_a_plain_scene_is_plain_version_1(tmp_path: Path) -> None:
    scene = bench()
    scene.add_lens("L", cs(), LensConfig(60.0, 0.0, 5.0, "N-BK7", 10.0))
    content = document(scene)
    assert "nsq_gpu" not in content and content["components"][0]["config"]["material"] == "N-BK7"
    export_scene(scene, tmp_path / "new folder" / "scene.json")
    assert NSQScene.from_json(tmp_path / "new folder" / "scene.json").component_names == ["L"]


def test_files_are_strict_json() -> None:
    scene = bench()
    scene.add_lens("L", cs(), LensConfig(float("inf"), -60.0, 5.0, glass(), 10.0))
    assert "Infinity" not in to_json(export(scene).document)
    live.assert_equals_numpy(scene, NUM_RAYS)


def test_nothing_is_written_where_something_is_refused(tmp_path: Path) -> None:
    scene = bench()
    scene.sources[0].total_flux = float("nan")
    with pytest.raises(UnsupportedSceneError, match="source 'lamp': total_flux.*nan"):
        export_scene(scene, tmp_path / "scene.json")
    assert not list(tmp_path.iterdir())


# Drift: every field of everything that a scene is built of

Build = Callable[..., NSQScene]


def with_lens(**fields: Any) -> NSQScene:
    scene = bench()
    scene.add_lens("L", cs(), LensConfig(**fields))
    return scene


def with_doublet(**fields: Any) -> NSQScene:
    scene = bench()
    scene.add_doublet("D", cs(), DoubletConfig(**fields))
    return scene


def with_mirror(**fields: Any) -> NSQScene:
    scene = bench()
    scene.add_detector("back", cs(z=-30.0), IrradianceDetectorConfig(90.0, 90.0, 9, 9))
    scene.add_mirror("M", cs(), MirrorConfig(**fields))
    return scene


def with_surface_config(**fields: Any) -> NSQScene:
    return with_lens(**{**LENS, "front": SurfaceConfig(**fields)})


def with_source(config: type, **fields: Any) -> NSQScene:
    scene = bench()
    # A glass of dispersion, so that the wavelength shows.
    scene.add_lens("L", cs(), LensConfig(**{**LENS, "material": "N-BK7"}))
    with live.quiet():
        scene.add_source("second", cs(x=1.0, z=-15.0, ry=0.1), config(**fields))
    return scene


def with_detector(config: type, **fields: Any) -> NSQScene:
    scene = bench()
    scene.add_detector("second", cs(x=1.0, z=20.0, ry=0.1), config(**fields))
    return scene


def with_sampling(**fields: Any) -> NSQScene:
    scene = with_lens(**LENS)
    scene.sampling_policy = SamplingPolicy(**fields)
    return scene


def with_spectrum(**fields: Any) -> NSQScene:
    return with_source(PointSourceConfig, spectrum=Spectrum(**fields))


def with_material(**fields: Any) -> NSQScene:
    return with_lens(**{**LENS, "material": NSQMaterial(**fields)})


def with_frame(**fields: Any) -> NSQScene:
    scene = bench()
    scene.add_lens("L", CoordinateSystem(**fields), LensConfig(**LENS))
    return scene


def with_surface(shape: type, **fields: Any) -> NSQScene:
    """Return a scene with a mirror of this shape, so that every change of the shape shows."""
    scene = bench()
    scene.add_detector("back", cs(z=-30.0), IrradianceDetectorConfig(90.0, 90.0, 9, 9))
    scene.add_component("S", ReflectiveComponent(cs(y=0.5), shape(**fields), 0.8, name="S"))
    return scene


def with_component(component: type, **fields: Any) -> NSQScene:
    scene = bench()
    scene.add_detector("back", cs(z=-30.0), IrradianceDetectorConfig(90.0, 90.0, 9, 9))
    scene.add_component("S", component(**fields))
    return scene


def with_aperture(**fields: Any) -> NSQScene:
    return with_surface(ClippedConic, radius=-60.0, conic=0.0, aperture_radius=12.0, aperture=Aperture(**fields))


def with_pupil(**fields: Any) -> NSQScene:
    scene = bench()
    scene.add_lens("L", cs(), LensConfig(**{**LENS, "material": "N-BK7"}))
    scene.source_registry.add("second", PupilSource(**fields))
    return scene


def with_rays(**fields: Any) -> NSQScene:
    scene = bench()
    scene.add_lens("L", cs(), LensConfig(**{**LENS, "material": "N-BK7"}))
    scene.source_registry.add("second", RaySource(**fields))
    return scene


def ray_file(seed: int, even: bool = False) -> Path:
    """Write a file of rays without wavelengths, which the spectrum of the source gives them; ``even`` gives all one flux."""
    draw = np.random.default_rng(seed)
    x, y, L, M = draw.uniform(-1.0, 1.0, (4, 20)) * np.array([2.0, 2.0, 0.2, 0.2])[:, None]
    path = Path(RAY_FILES.name) / f"{seed}.npz"
    np.savez(path, x=x, y=y, z=draw.uniform(-1.0, 0.0, 20), L=L, M=M, N=np.sqrt(1.0 - L**2 - M**2),
             flux=np.full(20, 0.05) if even else draw.uniform(0.0, 1.0, 20))
    return path


def with_bsdf(model: type, **fields: Any) -> NSQScene:
    return with_surface_config(interaction=InteractionType.REFLECTIVE, reflectance=0.9, bsdf=model(**fields))


def with_coating(**fields: Any) -> NSQScene:
    return with_surface_config(coating=SimpleCoating(**fields))


#: Of the walk, until the tests end.
RAY_FILES = tempfile.TemporaryDirectory(prefix="nsq-gpu-rays-")
LENS: Json = {"r1": 60.0, "r2": -60.0, "thickness": 5.0, "material": glass(), "front_aperture_radius": 10.0}
BLACK = SurfaceConfig(interaction=InteractionType.ABSORBING)
SHINY = SurfaceConfig(interaction=InteractionType.REFLECTIVE, reflectance=0.5)
SPECTRUM = two_lines()
SMALL: Json = {"width": 20.0, "height": 20.0}
PIXELS: Json = {**SMALL, "num_pixels_x": 5, "num_pixels_y": 5, "splat": "gaussian"}
REFRACTIVE: Json = {"cs": cs(), "geometry": FinitePlaneGeometry(20.0, 20.0), "material_front": VACUUM,
                    "material_back": VACUUM}
REFLECTIVE: Json = {"cs": cs(), "geometry": FinitePlaneGeometry(20.0, 20.0), "reflectance": 0.8}
ABSORBING: Json = {"cs": cs(), "geometry": FinitePlaneGeometry(20.0, 20.0)}


def by_wavelength(wavelength: Any) -> Any:
    return 0.5 + 0.5 * wavelength


@dataclasses.dataclass(frozen=True)
class With:
    """A changed value that shows only together with other fields, which the base gets as well."""

    value: Any
    base: Json


DISK, SLIT = Aperture("ellipse", 6.0, 5.0), Aperture("rectangle", 2.0, 7.0, x=1.0)
POLYGON = {"outline": "polygon", "semi_axis_x": None, "semi_axis_y": None, "vertices": ((-6.0, -6.0), (7.0, -5.0), (0.0, 8.0))}
UNION = {"outline": "union", "semi_axis_x": None, "semi_axis_y": None, "parts": (DISK, SLIT)}

#: Of every class: how to build a scene, the fields of the base, and another value for every field.
WALKS: dict[type, tuple[Build, Json, Json]] = {
    LensConfig: (with_lens, LENS, {
        "r1": 50.0, "r2": -50.0, "thickness": 6.0, "material": glass(1.6), "front_aperture_radius": 9.0,
        "back_aperture_radius": 11.0, "conic1": -3.0, "conic2": -3.0, "front": BLACK, "back": BLACK, "edge": SHINY,
        "rim": With(SHINY, {"back_aperture_radius": 14.0}),
    }),
    DoubletConfig: (with_doublet, {
        "r1": 60.0, "r2": -60.0, "r3": -200.0, "thickness1": 5.0, "thickness2": 3.0, "material1": glass(1.5),
        "material2": glass(1.7), "aperture_radius": 10.0,
    }, {
        "r1": 50.0, "r2": -50.0, "r3": -100.0, "thickness1": 6.0, "thickness2": 4.0, "material1": glass(1.55),
        "material2": glass(1.75), "aperture_radius": 9.0, "conic1": -3.0, "conic2": -3.0, "conic3": -30.0,
        "front": BLACK, "cemented": BLACK, "back": BLACK, "edge": SHINY,
    }),
    MirrorConfig: (with_mirror, {"radius": -100.0, "reflectance": 0.9, "aperture_radius": 12.0}, {
        "radius": -80.0, "reflectance": 0.8, "conic": -2.0, "aperture_radius": 11.0,
        "surface": SurfaceConfig(reflectance=0.7),
    }),
    SurfaceConfig: (with_surface_config, {}, {
        "bsdf": LambertianBSDF(0.9), "scatter_fraction": With(0.5, {"bsdf": LambertianBSDF(0.9)}),
        "coating": SimpleCoating(0.9, 0.05), "aperture_radius": 10.0000005, "interaction": InteractionType.ABSORBING,
        "reflectance": With(0.4, {"interaction": InteractionType.REFLECTIVE, "reflectance": 0.9}),
    }),
    PointSourceConfig: (lambda **fields: with_source(PointSourceConfig, **fields), {
        "spectrum": SPECTRUM, "half_angle_deg": 30.0}, {
        "spectrum": Spectrum(np.array([0.45]), np.array([1.0])), "total_flux": 2.0, "total_flux_lumens": 100.0,
        "half_angle_deg": 20.0, "medium": glass(1.3, 1e-5),
    }),
    CollimatedSourceConfig: (lambda **fields: with_source(CollimatedSourceConfig, **fields), {
        "spectrum": SPECTRUM, "aperture_radius": 4.0}, {
        "spectrum": Spectrum(np.array([0.45]), np.array([1.0])), "total_flux": 2.0, "total_flux_lumens": 100.0,
        "aperture_radius": 3.0, "profile": "gaussian",
        "gaussian_sigma": With(1.0, {"profile": "gaussian"}), "medium": glass(1.3, 1e-5),
    }),
    ExtendedSourceConfig: (lambda **fields: with_source(ExtendedSourceConfig, **fields), {
        "spectrum": SPECTRUM, "half_angle_deg": 30.0}, {
        "spectrum": Spectrum(np.array([0.45]), np.array([1.0])), "total_flux": 2.0, "total_flux_lumens": 100.0,
        "width": 2.0, "height": 2.0, "aperture_radius": 3.0, "half_angle_deg": 20.0, "medium": glass(1.3, 1e-5),
    }),
    IrradianceDetectorConfig: (lambda **fields: with_detector(IrradianceDetectorConfig, **fields), PIXELS, {
        "width": 18.0, "height": 18.0, "num_pixels_x": 6, "num_pixels_y": 6, "splat": "hard", "splat_sigma": 0.7,
        "absorb": False,
    }),
    SpectralDetectorConfig: (lambda **fields: with_detector(SpectralDetectorConfig, **fields),
                             {**PIXELS, "num_bins": 3}, {
        "width": 18.0, "height": 18.0, "num_pixels_x": 6, "num_pixels_y": 6, "wl_min": 0.45, "wl_max": 0.65,
        "num_bins": 4, "splat": "hard", "splat_sigma": 0.7, "absorb": False,
    }),
    FarFieldDetectorConfig: (lambda **fields: with_detector(FarFieldDetectorConfig, **fields),
                             {"num_theta": 9, "num_phi": 12}, {"num_theta": 10, "num_phi": 13, "absorb": False}),
    RayDatabaseConfig: (lambda **fields: with_detector(RayDatabaseConfig, **fields), SMALL, {
        "width": 18.0, "height": 18.0, "max_rays": 7, "absorb": False}),
    SamplingPolicy: (with_sampling, {}, {
        "reflect_prob": "auto", "split_depth": 2, "split_budget": With(1.5, {"split_depth": 4}),
        "rr_start_flux": With(0.99, {"reflect_prob": 0.5})}),
    Spectrum: (with_spectrum, {"wavelengths": np.array([0.5, 0.6]), "weights": np.array([1.0, 1.0])}, {
        "wavelengths": np.array([0.5, 0.65]), "weights": np.array([1.0, 3.0])}),
    NSQMaterial: (with_material, {"optiland_material": IdealMaterial(1.5)}, {"optiland_material": IdealMaterial(1.6)}),
    CoordinateSystem: (with_frame, {}, {
        "x": 1.0, "y": 1.0, "z": 1.0, "rx": 0.1, "ry": 0.1, "rz": With(0.1, {"rx": 0.1}),
        "reference_cs": cs(x=0.5, ry=0.2)}),
    IdealMaterial: (lambda **fields: with_material(optiland_material=IdealMaterial(**fields)), {"n": 1.5}, {
        "n": 1.6, "k": 1e-5}),
    AbbeMaterial: (lambda **fields: with_material(optiland_material=AbbeMaterial(**fields)), {
        "n": 1.5, "abbe": 60.0, "model": "buchdahl"}, {"n": 1.6, "abbe": 50.0, "model": "polynomial"}),
    Material: (lambda **fields: with_material(optiland_material=Material(**fields)), {"name": "SF6"}, {
        "name": "N-BK7", "reference": "schott", "catalog": "hikari"}),
    SimpleCoating: (with_coating, {"transmittance": 0.9}, {"transmittance": 0.8, "reflectance": 0.05}),
    LambertianBSDF: (lambda **fields: with_bsdf(LambertianBSDF, **fields), {}, {
        "reflectance_value": 0.5, "transmissive_fraction": 0.3}),
    HarveyShackBSDF: (lambda **fields: with_bsdf(HarveyShackBSDF, **fields), {"b0": 0.1, "l0": 0.1, "s": 2.0}, {
        "b0": 0.2, "l0": 0.2, "s": 3.0, "transmissive_fraction": 0.3}),
    KCorrelation: (lambda **fields: with_bsdf(KCorrelation, **fields), {"b0": 0.1, "B": 10.0, "s": 2.0}, {
        "b0": 0.2, "B": 5.0, "s": 3.0, "transmissive_fraction": 0.3}),
    MeasuredBSDF: (lambda **fields: with_bsdf(MeasuredBSDF, **fields), {
        "angle_of_incidence_deg": [0.0, 40.0], "scatter_azimuth_deg": [0.0, 90.0, 180.0], "scatter_radial_deg": [0.0, 20.0, 90.0],
        "values": [[[0.4, 0.2, 0.0]] * 3, [[0.5, 0.3, 0.1], [0.5, 0.2, 0.1], [0.5, 0.1, 0.0]]]}, {
        "angle_of_incidence_deg": [0.0, 20.0], "scatter_azimuth_deg": [0.0, 120.0, 240.0], "scatter_radial_deg": [0.0, 30.0, 80.0],
        "values": [[[0.4, 0.1, 0.0]] * 3] * 2, "tis": [0.1, 0.3], "scatter_type": "BTDF"}),
    PlaneGeometry: (lambda **fields: with_surface(PlaneGeometry, **fields), {}, {}),
    FinitePlaneGeometry: (lambda **fields: with_surface(FinitePlaneGeometry, **fields), {}, {
        "width": 9.0, "height": 9.0, "aperture_radius": 4.0}),
    ConicGeometry: (lambda **fields: with_surface(ConicGeometry, **fields), {
        "radius": -60.0, "conic": 0.0, "aperture_radius": 12.0}, {"radius": -50.0, "conic": -2.0,
                                                                  "aperture_radius": 11.0}),
    ParaboloidGeometry: (lambda **fields: with_surface(ParaboloidGeometry, **fields), {
        "radius": -60.0, "aperture_radius": 12.0}, {"radius": -50.0, "aperture_radius": 11.0}),
    ClippedConic: (lambda **fields: with_surface(ClippedConic, **fields), {
        "radius": -60.0, "conic": 0.0, "aperture_radius": 12.0, "aperture": Aperture("ellipse", 10.0, 8.0)}, {
        "radius": -50.0, "conic": -2.0, "aperture_radius": 8.5, "aperture": Aperture("rectangle", 6.0, 5.0)}),
    Aperture: (with_aperture, {"outline": "ellipse", "semi_axis_x": 6.0, "semi_axis_y": 5.0}, {
        "outline": "rectangle", "semi_axis_x": 5.0, "semi_axis_y": 4.0, "x": 1.0, "y": 1.0, "hole_radius": 2.0,
        "inverted": True, "vertices": With(((-5.0, -4.0), (6.0, -3.0), (0.0, 6.0)), POLYGON),
        "parts": With((Aperture("difference", parts=(DISK, SLIT)), Aperture("intersection", parts=(DISK, SLIT))), UNION)}),
    EvenAsphere: (lambda **fields: with_surface(EvenAsphere, **fields), {
        "radius": -60.0, "conic": 0.0, "aperture_radius": 12.0, "coefficients": [1e-5]}, {
        "radius": -50.0, "conic": -2.0, "aperture_radius": 11.0, "coefficients": [2e-5, 1e-7], "aperture": SLIT}),
    OddAsphere: (lambda **fields: with_surface(OddAsphere, **fields), {
        "radius": -60.0, "conic": 0.0, "aperture_radius": 12.0, "coefficients": [0.01]}, {
        "radius": -50.0, "conic": -2.0, "aperture_radius": 11.0, "coefficients": [0.02, 1e-4], "aperture": SLIT}),
    Biconic: (lambda **fields: with_surface(Biconic, **fields), {
        "radius_x": -60.0, "radius_y": 40.0, "aperture_radius": 12.0}, {
        "radius_x": -50.0, "radius_y": 30.0, "aperture_radius": 8.0, "conic_x": -2.0, "conic_y": 1.0, "aperture": SLIT}),
    Toroidal: (lambda **fields: with_surface(Toroidal, **fields), {
        "radius_x": -60.0, "radius_y": 40.0, "aperture_radius": 12.0, "coeffs_poly_y": [1e-4]}, {
        "radius_x": -50.0, "radius_y": 30.0, "aperture_radius": 8.0, "conic": -2.0, "coeffs_poly_y": [2e-4, 1e-6], "aperture": SLIT}),
    Polynomial: (lambda **fields: with_surface(Polynomial, **fields), {
        "radius": -60.0, "conic": 0.0, "aperture_radius": 12.0, "coefficients": [[0.0, 0.01], [0.02]]}, {
        "radius": -50.0, "conic": -2.0, "aperture_radius": 8.0, "coefficients": [[0.0, 0.01], [0.02, 1e-3]], "aperture": SLIT}),
    Chebyshev: (lambda **fields: with_surface(Chebyshev, **fields), {
        "radius": -60.0, "conic": 0.0, "aperture_radius": 12.0, "coefficients": [[0.0, 0.1], [0.2]], "norm_x": 12.0, "norm_y": 13.0}, {
        "radius": -50.0, "conic": -2.0, "aperture_radius": 8.0, "coefficients": [[0.0, 0.1, -0.1], [0.2, 0.1]], "norm_x": 14.0,
        "norm_y": 15.0, "aperture": SLIT}),
    Zernike: (lambda **fields: with_surface(Zernike, **fields), {
        "radius": -60.0, "conic": 0.0, "aperture_radius": 12.0, "coefficients": [0.0, 0.1, 0.0, 0.0, 0.3], "norm_radius": 12.0,
        "zernike_type": "noll"}, {
        "radius": -50.0, "conic": -2.0, "aperture_radius": 8.0, "coefficients": With([0.0, 0.1, -0.2], {"zernike_type": "standard"}),
        "zernike_type": "fringe",
        "norm_radius": 13.0, "aperture": SLIT}),
    PupilSource: (with_pupil, {
        "cs": cs(x=1.0, z=-15.0, ry=0.1), "spectrum": SPECTRUM, "beam_radii": (2.0, 2.0), "chief": (0.0, 0.0, 1.0)}, {
        "cs": cs(x=1.0, z=-16.0, ry=0.1), "spectrum": Spectrum(np.array([0.45]), np.array([1.0])), "total_flux": 2.0,
        "beam_radii": (3.0, 1.0), "chief": (0.1, 0.0, 1.0), "pupil_radii": (0.1, 0.05), "medium": glass(1.3, 1e-5),
        "aimed": [Aim(float(line), x=[[0.5], [0.1, 0.3]], y=[[0.0, 0.2]], vector_x=[[0.0, 0.02]], vector_y=[[0.01], [line / 10.0]])
                  for line in SPECTRUM.wavelengths]}),
    RaySource: (with_rays, {"cs": cs(x=1.0, z=-15.0, ry=0.1), "spectrum": SPECTRUM, "file": ray_file(1)}, {
        "cs": cs(x=1.0, z=-16.0, ry=0.1), "spectrum": Spectrum(np.array([0.45]), np.array([1.0])), "file": ray_file(2), "scale": 2.0,
        "total_flux": 2.0, "total_flux_lumens": 100.0, "medium": glass(1.3, 1e-5),
        "order": With("in_order", {"file": ray_file(3, even=True)})}),
    AnnularPlaneGeometry: (lambda **fields: with_surface(AnnularPlaneGeometry, **fields), {
        "inner_radius": 3.0, "outer_radius": 12.0}, {"inner_radius": 4.0, "outer_radius": 11.0, "z_offset": 1.0}),
    CylindricalFrustumGeometry: (lambda **fields: with_surface(CylindricalFrustumGeometry, **fields), {
        "r_front": 8.0, "r_back": 6.0, "z_front": -3.0, "z_back": 9.0}, {
        "r_front": 9.0, "r_back": 5.0, "z_front": -4.0, "z_back": 10.0}),
    SphereGeometry: (lambda **fields: with_surface(SphereGeometry, **fields), {"radius": 8.0}, {
        "radius": 7.0, "aperture_radius": 5.0}),
    MeshGeometry: (lambda **fields: with_surface(MeshGeometry, **fields), {
        "mesh": trimesh.creation.box((8.0, 8.0, 8.0))}, {"mesh": trimesh.creation.box((7.0, 8.0, 8.0))}),
    RefractiveComponent: (lambda **fields: with_component(RefractiveComponent, **fields), REFRACTIVE, {
        "cs": cs(z=1.0), "geometry": FinitePlaneGeometry(18.0, 18.0), "material_front": glass(), "material_back":
        glass(), "bsdf": LambertianBSDF(), "scatter_fraction": With(0.5, {"bsdf": LambertianBSDF()}),
        "coating": SimpleCoating(0.9, 0.05),
    }),
    ReflectiveComponent: (lambda **fields: with_component(ReflectiveComponent, **fields), REFLECTIVE, {
        "cs": cs(z=1.0), "geometry": FinitePlaneGeometry(18.0, 18.0), "reflectance": by_wavelength,
        "bsdf": LambertianBSDF(), "material_front": glass(), "scatter_fraction": With(0.5, {"bsdf": LambertianBSDF()}),
    }),
    AbsorbingComponent: (lambda **fields: with_component(AbsorbingComponent, **fields), ABSORBING, {
        "cs": cs(z=1.0), "geometry": FinitePlaneGeometry(18.0, 18.0), "material_front": glass()}),
}

#: Fields that Optiland's tracer does not read, and why.
UNREAD = {
    (NSQMaterial, "bsdf"): "no surface asks its material for a scatter model",
    (RefractiveComponent, "name"): "the registry's name is the file's",
    (ReflectiveComponent, "name"): "the registry's name is the file's",
    (AbsorbingComponent, "name"): "the registry's name is the file's",
    (IdealMaterial, "propagation_model"): "non-sequential rays go straight",
    (Material, "propagation_model"): "non-sequential rays go straight",
    (Material, "robust_search"): "n and k are evaluated by the live object",
    (Material, "min_wavelength"): "n and k are evaluated by the live object",
    (Material, "max_wavelength"): "n and k are evaluated by the live object",
    (Material, "match_policy"): "n and k are evaluated by the live object",
    (Material, "bounds"): "n and k are evaluated by the live object",
}
#: Changes that these few rays cannot show: there the file alone must change.
UNSEEN = {
    (SurfaceConfig, "aperture_radius"): "watertight lenses allow a nanometre",
    (AbsorbingComponent, "material_front"): "nothing is left to travel in it",
    (ReflectiveComponent, "material_front"): "a reflected ray stays in the medium that it came through",
    (HarveyShackBSDF, "b0"): "the lobe's shape depends on l0 and s alone",
    (KCorrelation, "b0"): "the lobe's shape depends on B and s alone",
}


def fields_of(cls: type) -> list[str]:
    """Return what an object of a class is built of."""
    if dataclasses.is_dataclass(cls):
        return [field.name for field in dataclasses.fields(cls)]
    if cls.__init__ is object.__init__:
        return []
    return [name for name in inspect.signature(cls.__init__).parameters if name != "self"]


#: Figures of bases, which most fields of a class share.
traced_bases: dict[tuple[type, str], Json] = {}


def steps() -> list[Any]:
    return [pytest.param(cls, name, id=f"{cls.__name__}.{name}")
            for cls in WALKS for name in fields_of(cls) if (cls, name) not in UNREAD]


@pytest.mark.parametrize(("cls", "name"), steps())
def test_no_field_is_dropped(cls: type, name: str, schema: jsonschema.Draft202012Validator) -> None:
    build, base, changes = WALKS[cls]
    assert name in changes, f"{cls.__name__}.{name} is new: say here how it is to be changed, and export it"
    change = changes[name] if isinstance(changes[name], With) else With(changes[name], {})
    base = {**base, **change.base}
    with live.quiet():
        before, after = build(**base), build(**{**base, name: change.value})
    old, new = document(before), document(after)
    schema.validate(new)
    assert new != old
    assert document(read_back(new)) == new
    key = (cls, name if change.base else "")
    if key not in traced_bases:
        traced_bases[key] = assert_agrees_with_numpy(before, 400)
    figures = assert_agrees_with_numpy(after, 400)
    if (cls, name) not in UNSEEN:
        assert not same(figures, traced_bases[key]), "the change makes no difference to the trace"


def test_every_known_class_is_walked() -> None:
    known = {*SHAPES, *BSDFS, RefractiveComponent, ReflectiveComponent, AbsorbingComponent}
    assert known - {TabulatedBSDF} <= WALKS.keys()


def test_tabulated_bsdf_is_embedded(tmp_path: Path, schema: jsonschema.Draft202012Validator) -> None:
    # The same for every incidence and below 1 / pi: for the others Optiland's transmissive lobes are wrong (README).
    rows = [(i, s, 0.1 + 0.002 * s) for i in (0.0, 45.0, 90.0) for s in (0.0, 30.0, 60.0, 90.0)]
    (tmp_path / "scatter.csv").write_text("\n".join(",".join(map(str, row)) for row in rows))
    scene = with_surface_config(bsdf=TabulatedBSDF(tmp_path / "scatter.csv", 0.25))
    (tmp_path / "scatter.csv").unlink()
    content = document(scene)
    schema.validate(content)
    written = content["nsq_gpu"]["overrides"]["L.front"]["bsdf"]
    assert written["theta_i"] == [0.0, 45.0, 90.0] and written["theta_s"] == [0.0, 30.0, 60.0, 90.0]
    assert np.array(written["bsdf"]).ravel().tolist() == [value for _, _, value in rows]
    assert written["transmissive_fraction"] == 0.25
    assert document(read_back(content)) == content
    assert_agrees_with_numpy(scene, 400)


def test_specular_bsdf_is_written() -> None:
    scene = with_surface_config(interaction=InteractionType.REFLECTIVE, reflectance=0.9, bsdf=SpecularBRDF())
    assert document(scene)["nsq_gpu"]["overrides"]["L.front"]["bsdf"] == {"type": "specular"}
    assert_agrees_with_numpy(scene, 400)


def test_overrides_on_every_face() -> None:
    half = SurfaceConfig(interaction=InteractionType.REFLECTIVE, reflectance=by_wavelength)
    scene = bench()
    scene.add_lens("L", cs(), LensConfig(**{**LENS, "back_aperture_radius": 12.0, "front": half, "back": half,
                                            "edge": half, "rim": half}))
    scene.add_doublet("D", cs(z=12.0), DoubletConfig(60.0, -60.0, 0.0, 4.0, 3.0, glass(), glass(1.7), 10.0, front=half,
                                                     cemented=half, back=half, edge=half))
    scene.add_mirror("M", cs(z=25.0, rx=0.4), MirrorConfig(0.0, 0.9, aperture_radius=8.0, surface=half))
    overrides = document(scene)["nsq_gpu"]["overrides"]
    assert sorted(overrides) == ["D.back", "D.cemented", "D.edge_crown", "D.edge_flint", "D.front", "L.back", "L.edge",
                                 "L.front", "L.rim", "M.surface"]
    assert overrides["L.front"]["reflectance"] == {"wavelengths": [0.5, 0.6], "values": [0.75, 0.8]}
    live.assert_equals_numpy(scene, NUM_RAYS)


def test_a_mirror_of_a_function_becomes_a_single_surface() -> None:
    scene = with_mirror(radius=-100.0, reflectance=by_wavelength)
    content = document(scene)
    assert content["components"] == [] and content["nsq_gpu"]["surfaces"][0]["name"] == "M"
    live.assert_equals_numpy(scene, NUM_RAYS)


def test_coating_as_reflectance() -> None:
    scene = with_component(ReflectiveComponent, **{**REFLECTIVE, "reflectance": SimpleCoating(0.1, 0.6)})
    assert document(scene)["nsq_gpu"]["surfaces"][0]["reflectance"] == 0.6
    live.assert_equals_numpy(scene, NUM_RAYS)


# Live objects that are no longer what they were built as


def test_surfaces_are_the_truth_not_configs() -> None:
    scene = with_lens(**LENS)
    scene.surfaces[0].geometry.radius = 45.0
    content = document(scene)
    assert content["components"] == []
    assert [part["name"] for part in content["nsq_gpu"]["surfaces"]] == ["L.front", "L.back", "L.edge"]
    live.assert_equals_numpy(scene, NUM_RAYS)


def test_a_moved_component_is_exported_where_it_is() -> None:
    scene = with_lens(**LENS)
    scene.surfaces[0].cs.x = 1.5
    assert document(scene)["components"][0]["cs"]["x"] == 1.5
    live.assert_equals_numpy(scene, NUM_RAYS)


def test_a_changed_config_has_no_say() -> None:
    scene = with_lens(**LENS)
    before = live.assert_equals_numpy(scene, NUM_RAYS)
    scene.component_registry.get("L")._config.r1 = 45.0
    assert not agreement(live.assert_equals_numpy(scene, NUM_RAYS), before).violations


def test_order_of_components() -> None:
    scene = bench()
    scene.add_component("first", AbsorbingComponent(cs(z=20.0), FinitePlaneGeometry(4.0, 4.0)))
    scene.add_lens("L", cs(), LensConfig(**LENS))
    scene.add_component("last", AbsorbingComponent(cs(z=20.0), FinitePlaneGeometry(8.0, 8.0)))
    assert document(scene)["nsq_gpu"]["order"] == ["first", "L", "last"]
    live.assert_equals_numpy(scene, NUM_RAYS)


def test_nameless_and_renamed_surfaces() -> None:
    scene = with_lens(**LENS)
    scene.add_component("trap", AbsorbingComponent(cs(z=20.0), FinitePlaneGeometry(4.0, 4.0)))
    scene.surfaces[1].name = "the back"
    ours, theirs = (traced(scene, 300, which, record_paths=True)[0]
                    for which in (backend(), live.NumpyBackend()))
    live.assert_same_paths(ours, theirs)
    assert "component_3" in ours.ray_paths["events"]["component_name"]
    assert "the back" in ours.ray_paths["events"]["component_name"]


# Materials


def test_catalog_names_are_kept_only_where_they_are_sure() -> None:
    def written(name: str) -> Any:
        with live.quiet():
            return document(with_lens(**{**LENS, "material": name}))["components"][0]["config"]["material"]

    assert written("N-BK7") == "N-BK7"
    # The gas, by Optiland's search; and a name that is no entry's own.
    assert written("SF6") == {"type": "medium", "name": "SF6"}
    assert written("BK7") == {"type": "medium", "name": "BK7"}


def test_media_are_as_the_live_object_evaluates_them() -> None:
    class Sellmeier(BaseMaterial):
        def _calculate_n(self, wavelength: Any, **kwargs: Any) -> Any:
            return np.sqrt(1.0 + 1.2 * wavelength**2 / (wavelength**2 - 0.01))

        def _calculate_k(self, wavelength: Any, **kwargs: Any) -> Any:
            return 1e-6 * wavelength

    glass_of_mine = Sellmeier()
    scene = with_material(optiland_material=glass_of_mine)
    medium = document(scene)["nsq_gpu"]["media"]["Sellmeier"]
    assert medium["wavelengths"] == [0.5, 0.6] and medium["k"] == [5e-7, 6e-7]
    assert medium["n"] == [float(glass_of_mine.n(wavelength)) for wavelength in (0.5, 0.6)]
    live.assert_equals_numpy(scene, NUM_RAYS)


def test_one_live_object_is_one_medium() -> None:
    shared, other = glass(), glass()
    scene = bench()
    for index, material in enumerate((shared, shared, other)):
        scene.add_lens(f"L{index}", cs(z=8.0 * index), LensConfig(**{**LENS, "material": material}))
    names = [item["config"]["material"]["name"] for item in document(scene)["components"]]
    assert names == ["n = 1.5", "n = 1.5", "n = 1.5 2"]


def test_a_source_in_a_medium() -> None:
    scene = bench()
    sphere = SphereGeometry(5.0)
    inside = glass(1.5, 1e-6)
    scene.add_component("ball", RefractiveComponent(cs(), sphere, VACUUM, inside, name="ball"))
    scene.add_source("spark", cs(), PointSourceConfig(two_lines(), half_angle_deg=180.0, medium=inside))
    live.assert_equals_numpy(scene, NUM_RAYS)


# Refusals


class MyBSDF(LambertianBSDF):
    pass


class MyShape(SphereGeometry):
    pass


class MyMirror(ReflectiveComponent):
    pass


def changed(change: Callable[[NSQScene], None], build: Callable[[], NSQScene]) -> NSQScene:
    scene = build()
    change(scene)
    return scene


def lens() -> NSQScene:
    return with_lens(**LENS)


def _set(pick: Callable[[NSQScene], Any], name: str, value: Any) -> Callable[[NSQScene], None]:
    return lambda scene: setattr(pick(scene), name, value)


def front(scene: NSQScene) -> BaseComponent:
    return scene.surfaces[0]


def my_mirror() -> NSQScene:
    return with_component(MyMirror, **REFLECTIVE)


def uneven_bins() -> NSQScene:
    scene = with_detector(SpectralDetectorConfig, **SMALL, num_bins=3)
    scene.detectors[1].wavelength_bins = np.array([0.4, 0.5, 0.55, 0.7])
    return scene


def narrow_far_field() -> NSQScene:
    scene = bench()
    scene.detector_registry.add("narrow", FarFieldDetector(cs(), 45.0, 9, 12))
    return scene


def gas() -> NSQScene:
    return with_material(optiland_material=AbbeMaterial(1.5, 60.0, model="polynomial"))


REFUSALS: dict[str, tuple[Callable[[], NSQScene], Callable[[NSQScene], None], str]] = {
    "polarised coating": (lens, _set(front, "coating", FresnelCoating(IdealMaterial(1.0), IdealMaterial(1.5))),
                          "surface 'L.front': coating: a FresnelCoating is polarised"),
    "scatter model": (lens, _set(front, "bsdf", MyBSDF()), "surface 'L.front': bsdf: it is a MyBSDF"),
    "shape": (lens, _set(front, "geometry", MyShape(9.0)), "surface 'L.front': its shape is a MyShape"),
    "component": (my_mirror, lambda scene: None, "surface 'S': it is a MyMirror"),
    "coating": (lens, _set(front, "coating", object()), "surface 'L.front': coating: it is a object"),
    "bins": (uneven_bins, lambda scene: None, "detector 'second': wavelength_bins: .*even"),
    "far field": (narrow_far_field, lambda scene: None, "detector 'narrow': theta: .*even"),
    "rows that are not stored": (lambda: with_detector(RayDatabaseConfig, **SMALL),
                                 lambda scene: setattr(scene.detectors[1], "store_rays", False),
                                 "detector 'second': store_rays"),
    "pixels beside the geometry": (bench, lambda scene: setattr(scene.detectors[0], "width", 50.0),
                                   "detector 'screen': width: its pixels span 50.0 mm"),
    "not a number": (lens, lambda scene: setattr(front(scene).geometry, "conic", float("nan")),
                     "surface 'L.front': conic: it is nan"),
    "medium out of range": (gas, lambda scene: setattr(scene.sources[0].spectrum, "wavelengths", np.array([0.5, 1.5])),
                            "surface 'L.front': n of AbbeMaterial.*out of range"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_no_file_can_hold_is_refused_by_name(case: str) -> None:
    build, change, message = REFUSALS[case]
    with live.quiet():
        scene = changed(change, build)
        with pytest.raises(UnsupportedSceneError, match=message):
            export(scene)


class Wanting(float):
    """Stands in for a tensor that wants a gradient."""

    requires_grad = True


@pytest.mark.parametrize("change", [
    lambda scene: setattr(front(scene).geometry, "radius", Wanting(60.0)),
    lambda scene: setattr(scene.sources[0], "total_flux", Wanting(scene.sources[0].total_flux)),
    lambda scene: setattr(scene.detectors[0].cs, "_z", Wanting(scene.detectors[0].cs.z)),
    lambda scene: setattr(scene.sources[0].spectrum, "weights", list(map(Wanting, scene.sources[0].spectrum.weights))),
], ids=["radius", "flux", "frame", "spectrum"])
def test_what_wants_a_gradient_is_a_value(change: Callable[[NSQScene], None]) -> None:
    assert document(changed(change, lens)) == document(lens())


def test_torch_tensors_are_values() -> None:
    torch = pytest.importorskip("torch")
    for wants in (False, True):
        radius = torch.tensor(60.0, dtype=torch.float64, requires_grad=wants)
        assert document(with_lens(**{**LENS, "r1": radius})) == document(with_lens(**LENS))
