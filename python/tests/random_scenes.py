"""Random scenes, seeded: each feature alone, then in pairs, then in threes.

A feature adds something to a bench at a place along z of its own. What the features draw stays clear of the cases in
which this program differs from Optiland on purpose; the README lists them.
"""

from __future__ import annotations

import dataclasses
import itertools
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
import trimesh
from optiland.coatings import SimpleCoating
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import AbbeMaterial, IdealMaterial
from optiland.nonsequential import DoubletConfig, LensConfig, MirrorConfig, NSQMaterial, NSQScene
from optiland.nonsequential.bsdf import HarveyShackBSDF, LambertianBSDF, SpecularBRDF, TabulatedBSDF
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.configs import InteractionType, SurfaceConfig
from optiland.nonsequential.components.geometry.analytic.annulus import AnnularPlaneGeometry
from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry
from optiland.nonsequential.components.geometry.analytic.frustum import CylindricalFrustumGeometry
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry
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
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.nonsequential.materials.nsq_material import VACUUM
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig, ExtendedSourceConfig, PointSourceConfig

Random = np.random.Generator
#: Adds a feature called ``name`` about ``z`` [mm].
Feature = Callable[[NSQScene, Random, str, float], None]

#: Distance between the places of features [mm].
PITCH = 30.0
FEATURES: dict[str, Feature] = {}


def feature(add: Feature) -> Feature:
    FEATURES[add.__name__] = add
    return add


def some(random: Random, low: float, high: float) -> float:
    return float(random.uniform(low, high))


def place(random: Random, z: float, tilt: float = 0.15) -> CoordinateSystem:
    """Return a place near the axis, tilted a little; at times within a frame of its own."""
    x, y, rx, ry, rz = (some(random, -bound, bound) for bound in (1.0, 1.0, tilt, tilt, 1.0))
    if random.random() < 0.3:
        return CoordinateSystem(x=x, rx=rx, reference_cs=CoordinateSystem(y=y, z=z, ry=ry, rz=rz))
    return CoordinateSystem(x=x, y=y, z=z, rx=rx, ry=ry, rz=rz)


def glass(random: Random) -> NSQMaterial:
    return NSQMaterial(optiland_material=IdealMaterial(n=some(random, 1.3, 1.9)))


def lens(random: Random, **changes: Any) -> LensConfig:
    return LensConfig(**{
        "r1": some(random, 30.0, 90.0), "r2": -some(random, 30.0, 90.0), "thickness": some(random, 4.0, 6.0),
        "material": glass(random), "front_aperture_radius": some(random, 9.0, 11.0), "conic1": some(random, -1.5, 0.5),
        "conic2": some(random, -1.5, 0.5), **changes,
    })


def mirror(random: Random, **changes: Any) -> MirrorConfig:
    return MirrorConfig(**{"radius": -some(random, 60.0, 200.0), "reflectance": some(random, 0.5, 1.0),
                           "conic": some(random, -2.0, 0.0), "aperture_radius": some(random, 3.0, 6.0), **changes})


def by_wavelength(random: Random) -> Callable[[Any], Any]:
    offset, slope = some(random, 0.1, 0.5), some(random, -0.2, 0.4)
    return lambda wavelength: offset + slope * wavelength


def scatterer(scene: NSQScene, random: Random, name: str, z: float, bsdf: Any) -> None:
    """Put a scatter model on a lens or on a mirror."""
    surface = SurfaceConfig(bsdf=bsdf, scatter_fraction=some(random, 0.1, 1.0))
    if random.random() < 0.5:
        scene.add_lens(name, place(random, z), lens(random, front=surface))
    else:
        scene.add_mirror(name, place(random, z), mirror(random, surface=surface))


# Features


@feature
def plain_lens(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.add_lens(name, place(random, z), lens(random, back_aperture_radius=some(random, 9.0, 14.0)))


@feature
def doublet(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.add_doublet(name, place(random, z), DoubletConfig(
        r1=some(random, 40.0, 90.0), r2=-some(random, 40.0, 90.0), r3=-some(random, 80.0, 300.0),
        thickness1=some(random, 5.0, 6.0), thickness2=some(random, 3.0, 4.0), material1=glass(random),
        material2=glass(random), aperture_radius=some(random, 8.0, 11.0)))


@feature
def constant_mirror(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.add_mirror(name, place(random, z, tilt=0.6), mirror(random))


@feature
def coloured_mirror(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.add_mirror(name, place(random, z), mirror(random, reflectance=by_wavelength(random)))


@feature
def coating(scene: NSQScene, random: Random, name: str, z: float) -> None:
    reflected = some(random, 0.0, 0.3)
    thin = SimpleCoating(transmittance=some(random, 0.3, 1.0 - reflected), reflectance=reflected)
    scene.add_lens(name, place(random, z), lens(random, front=SurfaceConfig(coating=thin),
                                                back=SurfaceConfig(coating=SimpleCoating(0.95, 0.01))))


@feature
def coated_mirror(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.add_component(name, ReflectiveComponent(
        place(random, z), ConicGeometry(-some(random, 50.0, 90.0), some(random, -2.0, 0.0), some(random, 3.0, 6.0)),
        SimpleCoating(transmittance=0.1, reflectance=some(random, 0.3, 0.9)), name=name))


@feature
def override(scene: NSQScene, random: Random, name: str, z: float) -> None:
    changes = {slot: SurfaceConfig(interaction=interaction, reflectance=some(random, 0.2, 0.9))
               for slot in ("front", "back", "edge")
               if (interaction := random.choice([None, InteractionType.REFLECTIVE, InteractionType.ABSORBING]))}
    scene.add_lens(name, place(random, z), lens(random, **changes))


@feature
def lambertian(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scatterer(scene, random, name, z, LambertianBSDF(some(random, 0.3, 1.0), some(random, 0.0, 1.0)))


@feature
def harvey_shack(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scatterer(scene, random, name, z, HarveyShackBSDF(some(random, 0.1, 2.0), some(random, 0.02, 0.3),
                                                      some(random, 1.5, 3.0), some(random, 0.0, 1.0)))


@feature
def specular(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scatterer(scene, random, name, z, SpecularBRDF())


@feature
def tabulated(scene: NSQScene, random: Random, name: str, z: float) -> None:
    # Not above 1/pi, where Optiland cuts off, and one row repeated, since Optiland mistakes the angle of incidence.
    incident, scattered = np.linspace(0.0, 90.0, 3), np.linspace(0.0, 90.0, 7)
    values = random.uniform(0.02, 0.3, scattered.size)
    rows = [f"{i},{s},{value!r}" for i in incident for s, value in zip(scattered, values.tolist(), strict=True)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scatter.csv"
        path.write_text("\n".join(rows), encoding="utf-8")
        scatterer(scene, random, name, z, TabulatedBSDF(path, some(random, 0.0, 1.0)))


@feature
def solid_mesh(scene: NSQScene, random: Random, name: str, z: float) -> None:
    # Not of glass: within a closed mesh Optiland finds the triangle that a ray stands on, and takes it for a miss.
    size = some(random, 5.0, 9.0)
    shape = MeshGeometry((trimesh.creation.box((size, size, 4.0)), trimesh.creation.icosphere(2, 0.5 * size),
                          trimesh.creation.cylinder(0.5 * size, 5.0, sections=17))[random.choice([0, 1, 2])])
    frame = place(random, z, tilt=0.7)
    shiny = random.random() < 0.5
    scene.add_component(name, ReflectiveComponent(frame, shape, some(random, 0.3, 1.0), name=name) if shiny
                        else AbsorbingComponent(frame, shape, name=name))


@feature
def mesh_of_glass(scene: NSQScene, random: Random, name: str, z: float) -> None:
    inside = glass(random)
    dish = MeshGeometry(_dish(some(random, 8.0, 11.0), some(random, 40.0, 90.0)))
    for index, (front, back) in enumerate(((VACUUM, inside), (inside, VACUUM))):
        frame = CoordinateSystem(x=0.013, z=z + 5.0 * index, rx=some(random, -0.1, 0.1), rz=some(random, -1.0, 1.0))
        scene.add_component(f"{name}.{index}", RefractiveComponent(frame, dish, front, back, name=f"{name}.{index}"))


def _dish(half: float, radius: float) -> trimesh.Trimesh:
    """Return a square dish about the axis, its faces turned to +z."""
    count = 9
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-half, half, count)], indexing="ij"))
    corner = np.arange(count * count).reshape(count, count)
    squares = [part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])]
    faces = np.concatenate([np.stack([squares[i] for i in triangle], axis=1) for triangle in ((0, 1, 2), (0, 2, 3))])
    return trimesh.Trimesh(np.stack([x, y, (x * x + y * y) / (2.0 * radius)], axis=1), faces, process=False)


@feature
def absorbing_medium(scene: NSQScene, random: Random, name: str, z: float) -> None:
    smoked = IdealMaterial(n=some(random, 1.4, 1.8), k=10.0 ** some(random, -6.0, -4.5))
    scene.add_lens(name, place(random, z), lens(random, material=NSQMaterial(optiland_material=smoked)))


@feature
def dispersive_medium(scene: NSQScene, random: Random, name: str, z: float) -> None:
    abbe = AbbeMaterial(some(random, 1.5, 1.7), some(random, 40.0, 60.0), model="buchdahl")
    material: Any = NSQMaterial(optiland_material=abbe) if random.random() < 0.5 else "N-BK7"
    scene.add_lens(name, place(random, z), lens(random, material=material))


@feature
def raw_sphere(scene: NSQScene, random: Random, name: str, z: float) -> None:
    cap = some(random, 4.0, 6.0) if random.random() < 0.5 else None
    scene.add_component(name, RefractiveComponent(
        place(random, z), SphereGeometry(some(random, 6.0, 9.0), cap), glass(random), VACUUM, name=name))


@feature
def raw_plates(scene: NSQScene, random: Random, name: str, z: float) -> None:
    inside = glass(random)
    for index, (front, back) in enumerate(((VACUUM, inside), (inside, VACUUM))):
        shape = (FinitePlaneGeometry(20.0, 22.0), FinitePlaneGeometry(aperture_radius=10.0),
                 AnnularPlaneGeometry(some(random, 1.0, 3.0), 11.0, some(random, -0.5, 0.5)))[random.choice([0, 1, 2])]
        scene.add_component(f"{name}.{index}", RefractiveComponent(
            CoordinateSystem(z=z + 3.0 * index, rx=0.1), shape, front, back, name=f"{name}.{index}"))


@feature
def raw_cylinder(scene: NSQScene, random: Random, name: str, z: float) -> None:
    radius = some(random, 3.0, 4.5)
    shape = CylindricalFrustumGeometry(radius, radius, -some(random, 2.0, 5.0), some(random, 2.0, 8.0))
    frame = place(random, z, tilt=0.05)
    shiny = random.random() < 0.5
    scene.add_component(name, ReflectiveComponent(frame, shape, 0.8, name=name) if shiny
                        else AbsorbingComponent(frame, shape, name=name))


@feature
def detectors_in_passing(scene: NSQScene, random: Random, name: str, z: float) -> None:
    splat = {"splat": str(random.choice(["hard", "bilinear", "gaussian"])), "splat_sigma": some(random, 0.3, 1.0)}
    size = {"width": some(random, 20.0, 30.0), "height": some(random, 20.0, 30.0), "absorb": False}
    pixels = {**size, **splat, "num_pixels_x": 11, "num_pixels_y": 7}
    scene.add_detector(f"{name}.colours", place(random, z), SpectralDetectorConfig(**pixels, wl_min=0.45, wl_max=0.62,
                                                                                 num_bins=3))
    scene.add_detector(f"{name}.map", place(random, z + 6.0), IrradianceDetectorConfig(**pixels))
    scene.add_detector(f"{name}.rows", place(random, z + 12.0), RayDatabaseConfig(**size))


@feature
def far_field(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.add_detector(name, CoordinateSystem(z=300.0, rx=some(random, -0.2, 0.2)),
                       FarFieldDetectorConfig(num_theta=9, num_phi=10))


@feature
def sources(scene: NSQScene, random: Random, name: str, z: float) -> None:
    lines = Spectrum(np.array([0.48, 0.55, 0.63]), random.uniform(0.2, 1.0, 3))
    kinds: list[Any] = [
        CollimatedSourceConfig(lines, total_flux=some(random, 0.5, 2.0), aperture_radius=3.0),
        CollimatedSourceConfig(lines, total_flux_lumens=100.0, aperture_radius=3.0, profile="gaussian",
                               gaussian_sigma=some(random, 0.5, 2.0)),
        ExtendedSourceConfig(lines, width=2.0, height=3.0, half_angle_deg=some(random, 5.0, 60.0)),
        ExtendedSourceConfig(lines, aperture_radius=2.0),
    ]
    for index in random.choice(len(kinds), 2, replace=False):
        frame = CoordinateSystem(x=some(random, -3.0, 3.0), z=-18.0 + index, rx=some(random, -0.2, 0.2), rz=0.4)
        scene.add_source(f"{name}.{index}", frame, kinds[index])


@feature
def reflect_prob(scene: NSQScene, random: Random, name: str, z: float) -> None:
    probability = "auto" if random.random() < 0.5 else some(random, 0.1, 0.9)
    scene.sampling_policy = dataclasses.replace(scene.sampling_policy, reflect_prob=probability)
    plain_lens(scene, random, name, z)


@feature
def roulette(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.sampling_policy = dataclasses.replace(scene.sampling_policy, rr_start_flux=some(random, 0.3, 0.9))
    scene.add_lens(name, place(random, z), lens(random, front=SurfaceConfig(coating=SimpleCoating(0.6, 0.2))))


@feature
def splitting(scene: NSQScene, random: Random, name: str, z: float) -> None:
    scene.sampling_policy = dataclasses.replace(scene.sampling_policy, split_depth=int(random.integers(1, 5)),
                                                split_budget=some(random, 1.2, 6.0))
    plain_lens(scene, random, name, z)


# Scenes

#: So many scenes have each feature alone and each in a pair.
NUM_COVERING = len(FEATURES) + (len(FEATURES) + 1) // 2


def combinations(seed: int) -> Iterator[tuple[str, ...]]:
    """Yield which features a scene has: each alone, the pairs so that the first ones have every feature, threes."""
    random = np.random.default_rng(seed)
    names = list(FEATURES)
    yield from ((name,) for name in names)
    ring = [names[index] for index in random.permutation(len(names))]
    first = list(zip(ring[::2], [*ring[1::2], ring[0]][: len(ring[::2])], strict=True))
    yield from first
    rest = [pair for pair in itertools.combinations(names, 2) if pair not in first and pair[::-1] not in first]
    yield from (rest[index] for index in random.permutation(len(rest)))
    while True:
        yield tuple(names[index] for index in random.choice(len(names), 3, replace=False))


def build(features: tuple[str, ...], seed: int) -> NSQScene:
    """Return a scene with these features."""
    be.set_backend("numpy")
    be.set_precision("float64")
    random = np.random.default_rng(seed)
    scene = NSQScene()
    scene.sampling_policy = SamplingPolicy()
    lines = Spectrum(np.array([0.5, 0.6]), np.array([1.0, 2.0]))
    scene.add_source("lamp", CoordinateSystem(z=-25.0), PointSourceConfig(lines, half_angle_deg=some(random, 10.0, 25.0)))
    for index, name in enumerate(features):
        FEATURES[name](scene, random, name, PITCH * index)
    for name, z in (("screen", PITCH * len(features)), ("back", -40.0)):
        scene.add_detector(name, CoordinateSystem(z=z), IrradianceDetectorConfig(80.0, 80.0, 10, 12))
    return scene
