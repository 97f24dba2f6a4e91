"""Writes the scene files in ``scenes/``: ``python -m tools.make_scenes [NAME ...]`` from the folder ``python``.

Each scene is one function below, named as its file, with a docstring that becomes its line in ``scenes/README.md``.
Numbers are written in full (``repr``), so that the file alone reproduces the scene bit for bit.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from optiland.samples.eyepieces import EyepieceErfle
from optiland.samples.infrared import InfraredTriplet
from optiland.samples.objectives import (
    CookeTriplet,
    DoubleGauss,
    HeliarLens,
    PetzvalLens,
    ReverseTelephoto,
    Telephoto,
    TessarLens,
    TripletTelescopeObjective,
)
from optiland.samples.simple import CementedAchromat, TelescopeDoublet
from optiland.samples.telescopes import HubbleTelescope

from tests.oracle import SCENES_DIR
from tools.nouns import (
    Json,
    annulus,
    beam_frame,
    catalog,
    coating,
    collimated,
    conic,
    constant,
    cs,
    document,
    extended,
    far_field,
    frustum,
    harvey_shack,
    height_field,
    irradiance,
    lambertian,
    lens,
    medium,
    mirror,
    plane,
    point,
    ray_database,
    reflectance_table,
    spectral_detector,
    spectrum,
    specular,
    sphere,
    surface,
    table,
    tabulated,
    tabulated_file,
)
from tools.sequential import Parts, converted_components, raw_parts

SCENES: dict[str, Callable[[], Json]] = {}

RIGHT_ANGLE = math.pi / 2.0


def scene(builder: Callable[[], Json]) -> Callable[[], Json]:
    """Register a builder under its own name."""
    SCENES[builder.__name__] = builder
    return builder


# Optiland's own benchmark scenes.


@scene
def bench_lens() -> Json:
    """Optiland's benchmark: one lens of constant index and a detector."""
    return document(
        [lens("L", cs(), 100.0, -100.0, 5.0, medium("glass"), 12.5)],
        [collimated("S", cs(z=-25.0), spectrum([0.55]), 10.0)],
        [irradiance("D", cs(z=150.0), 50.0, 50.0, 64, 64)],
        media={"glass": constant(1.5)},
    )


@scene
def bench_cavity() -> Json:
    """Optiland's benchmark: two flat mirrors face to face, a transmissive detector between them."""
    mirrors = [mirror(name, cs(z=z), math.inf, 0.98, 20.0) for name, z in (("M_far", 50.0), ("M_near", -50.0))]
    return document(
        mirrors,
        [collimated("S", cs(), spectrum([0.55]), 3.0)],
        [irradiance("D", cs(z=25.0), 12.0, 12.0, 32, 32, absorb=False)],
    )


@scene
def bench_surface_count_50() -> Json:
    """Optiland's benchmark: fifty mirrors that no ray meets."""
    decoys = [mirror(f"decoy_{i}", cs(x=500.0 * (i + 1), z=10.0), math.inf, 0.9, 5.0) for i in range(50)]
    return document(
        decoys,
        [collimated("S", cs(z=-10.0), spectrum([0.55]), 5.0)],
        [irradiance("D", cs(z=100.0), 20.0, 20.0, 64, 64)],
    )


# Samples that pass Optiland's converter.


@scene
def cooke_triplet() -> Json:
    """Converted sample: seven stars out of focus on a 256 x 256 image, ghost arcs on a logarithmic scale."""
    lines = spectrum([0.48, 0.55, 0.65])
    ring = [(9.0 * math.sin(0.2 + i * math.pi / 3.0), 9.0 * math.cos(0.2 + i * math.pi / 3.0)) for i in range(6)]
    stars = [collimated(f"star_{i}", beam_frame(y, 11.5, 40.0, x), lines, 5.6, 0.6 if i else 1.0)
             for i, (y, x) in enumerate([(0.0, 0.0), *ring])]
    return document(
        converted_components(CookeTriplet()),
        stars,
        [irradiance("image", cs(z=78.0), 36.0, 36.0, 256, 256), far_field("stray", cs(z=95.0), 60, 61)],
    )


@scene
def triplet_telescope_ghosts() -> Json:
    """Converted sample: telescope triplet with each face reflecting at probability 0.3, weights compounding."""
    return document(
        converted_components(TripletTelescopeObjective()),
        [collimated("axis", cs(z=-20.0, x=0.5), spectrum([0.4861, 0.5876, 0.6563]), 16.0),
         collimated("field", beam_frame(1.0, 0.0, 30.0), spectrum([0.5876]), 16.0, 0.25, sigma=9.0)],
        [irradiance("image", cs(z=93.3), 30.0, 30.0, 60, 60, "gaussian", 0.8),
         irradiance("ghosts", cs(z=-40.0, y=1.0), 120.0, 120.0, 40, 50, "hard")],
        sampling={"reflect_prob": 0.3},
    )


@scene
def cemented_achromat_auto() -> Json:
    """Converted sample: cemented doublet with reflect_prob auto, ray databases before and behind."""
    return document(
        converted_components(CementedAchromat()),
        [point("object", cs(y=0.8, z=-30.0), spectrum([0.48613270, 0.58756180, 0.65627250], [1.0, 3.0, 2.0]), 3.0),
         collimated("tilted", beam_frame(2.0, 0.0, 20.0, -1.0), spectrum([0.55]), 1.6, 0.5, sigma=0.9)],
        [ray_database("before", cs(z=-4.0, rx=0.05), 4.0, 3.0, absorb=False),
         ray_database("behind", cs(z=19.5), 6.0, 6.0),
         far_field("beside", cs(z=25.0), 30, 33),
         irradiance("back", cs(z=-40.0), 60.0, 60.0, 24, 24)],
        sampling={"reflect_prob": "auto"},
    )


@scene
def telescope_doublet_finder() -> Json:
    """Converted sample: air-spaced doublet as a finder scope with a ball eyepiece lens in a tube."""
    components = converted_components(TelescopeDoublet())
    tube = surface("tube", cs(z=-2.0), frustum(3.4, 3.2, 0.0, 51.0), "absorbing")
    eye = surface("eye", cs(z=53.0), sphere(4.0, 3.5), "refractive", None, catalog("N-LAK22"))
    return document(
        components,
        [collimated(f"star_{i}", beam_frame(a, 0.0, 9.0), spectrum([0.4861, 0.5876, 0.6563]), 2.98, 1.0 / (i + 1))
         for i, a in enumerate((0.0, 0.4, -0.8))],
        [irradiance("field_stop", cs(z=46.0), 3.0, 3.0, 40, 40, absorb=False),
         far_field("exit", cs(z=70.0), 72, 41)],
        surfaces=[tube, eye],
    )


@scene
def hubble_nasmyth() -> Json:
    """Converted sample: two hyperbolic mirrors of R < 1, a fold flat to the side, baffles; frames in a chain."""
    components = _hubble_mirrors(primary_reflectance=0.92, secondary_reflectance=0.88)
    secondary_z = components[1]["cs"]["z"]
    fold = cs(z=secondary_z + 4310.0)
    shade = surface("shade", cs(z=secondary_z - 40.0), plane(aperture_radius=240.0), "absorbing")
    tube = surface("tube", cs(z=secondary_z), frustum(1260.0, 1300.0, -200.0, 4000.0), "absorbing")
    flat = surface("flat", cs(rx=math.pi / 4.0, reference_cs=fold), plane(width=420.0, height=560.0), "reflective",
                   reflectance=reflectance_table([0.45, 0.55, 0.65], [0.95, 0.9, 0.8]))
    lines = spectrum([0.45, 0.55, 0.65], [1.0, 2.0, 1.0])
    stars = [collimated(f"star_{i}", beam_frame(y, 0.0, 6000.0, x), lines, 1200.0, flux)
             for i, (y, x, flux) in enumerate(((0.0, 0.0, 1.0), (0.1, 0.05, 0.5), (-0.06, 0.1, 0.3)))]
    return document(
        components,
        stars,
        [irradiance("camera", cs(y=2000.0, rx=RIGHT_ANGLE, reference_cs=fold), 360.0, 360.0, 90, 90),
         irradiance("entrance", cs(z=secondary_z - 100.0), 2600.0, 2600.0, 26, 26, "hard", absorb=False)],
        surfaces=[shade, tube, flat],
    )


def _hubble_mirrors(primary_reflectance: float, secondary_reflectance: float) -> list[Json]:
    """Hubble's mirrors, converted: its entrance plane goes first, because the converter refuses air-to-air surfaces."""
    optic = HubbleTelescope()
    optic.surfaces.remove(1)
    for face, radius in zip(optic.surfaces.surfaces[1:3], (1220.0, 152.0), strict=True):
        face.aperture, face.semi_aperture = None, radius
    components = converted_components(optic)
    for component, reflectance in zip(components, (primary_reflectance, secondary_reflectance), strict=True):
        component["config"]["reflectance"] = reflectance
    return components


# Samples as raw surfaces.


def _raw_document(parts: Parts, angles: tuple[tuple[float, float], ...], detectors: list[Json], /, *,
                  gaussian: bool = False, extra: tuple[Json, ...] = (), **block: Any) -> Json:
    """A prescription in overfilling beams at the given (y, x) field angles [deg], each half as bright as the last."""
    radius = 1.15 * parts.pupil_radius
    distance = 8.0 * radius + abs(parts.pupil_z)
    sources = [
        collimated(f"field_{i}", beam_frame(y, parts.pupil_z, distance, x), spectrum(parts.wavelengths), radius,
                   0.5**i, sigma=radius / 2.5 if gaussian else None)
        for i, (y, x) in enumerate(angles)
    ]
    media = {"media": parts.media} if parts.media else {}
    return document([], sources, detectors, surfaces=[*parts.surfaces, *extra], **media, **block)


@scene
def double_gauss() -> Json:
    """Sample: ten glass faces, annular stop, glasses as tables; image, colours and ghosts."""
    parts = raw_parts(DoubleGauss(), tables=True)
    return _raw_document(
        parts,
        ((0.0, 0.0), (9.0, 4.0), (-13.0, -2.0)),
        [irradiance("image", cs(z=parts.image_z - 1.0), 60.0, 60.0, 96, 96),
         spectral_detector("colours", cs(z=parts.image_z - 1.5), 70.0, 70.0, 16, 16, (0.45, 0.7, 5), "hard",
                           absorb=False)],
    )


@scene
def tessar_gaussian_beams() -> Json:
    """Sample: Tessar in Gaussian beams, image with Gaussian splats, all in a tilted and shifted frame chain."""
    parts = raw_parts(TessarLens())
    scene_file = _raw_document(
        parts,
        ((0.0, 0.0), (10.0, 3.0), (-17.0, 5.0)),
        [irradiance("image", cs(z=parts.image_z), 3.4, 3.4, 48, 48, "gaussian", 1.3),
         far_field("stray", cs(z=parts.image_z + 0.5), 30, 31)],
        gaussian=True,
    )
    bench = cs(x=12.0, y=-7.0, z=30.0, rx=0.3, ry=-0.5, rz=0.8, reference_cs=cs(x=-3.0, z=5.0, ry=0.2, rz=-1.1))
    return _mounted(scene_file, bench)


def _mounted(scene_file: Json, bench: Json) -> Json:
    """Put every frame of a scene onto another frame."""
    block = scene_file.get("nsq_gpu", {})
    for item in (*scene_file["components"], *scene_file["sources"], *scene_file["detectors"],
                 *block.get("surfaces", [])):
        item["cs"] = _rooted(item["cs"], bench)
    return scene_file


def _rooted(frame: Json, bench: Json) -> Json:
    reference = frame["reference_cs"]
    return {**frame, "reference_cs": bench if reference is None else _rooted(reference, bench)}


@scene
def heliar_ghosts() -> Json:
    """Sample: two cemented groups round a stop, reflect_prob auto, so that most rays are ghosts."""
    parts = raw_parts(HeliarLens())
    return _raw_document(
        parts,
        ((0.0, 0.0), (6.0, 0.0), (-4.0, 8.0)),
        [irradiance("image", cs(z=parts.image_z), 6.0, 6.0, 50, 50, "hard"),
         irradiance("back", cs(z=-14.0, ry=0.1), 40.0, 40.0, 24, 32)],
        sampling={"reflect_prob": "auto", "rr_start_flux": 1e-4},
    )


@scene
def petzval_projector() -> Json:
    """Sample: Petzval lens backwards, an extended film frame projected; edges and barrel catch the rest."""
    parts = raw_parts(PetzvalLens(), tables=True)
    gate = extended("film", cs(x=0.4, z=parts.image_z, ry=math.pi), spectrum(parts.wavelengths, [1.0, 2.0, 1.0]), 24.0,
                    width=8.0, height=5.0)
    lamp = extended("lamp", cs(y=1.0, z=parts.image_z + 0.5, rx=math.pi), spectrum(parts.wavelengths), 20.0,
                    radius=1.5, flux=0.4)
    barrel = surface("barrel", cs(), frustum(30.0, 30.0, -10.0, 80.0), "absorbing")
    return document(
        [],
        [gate, lamp],
        [irradiance("screen", cs(z=-900.0), 220.0, 160.0, 55, 40), far_field("sky", cs(z=-901.0), 45, 45)],
        media=parts.media,
        surfaces=[*parts.surfaces, barrel],
    )


@scene
def telephoto_spectral() -> Json:
    """Sample: telephoto with catalog glasses; colours by Gaussian splats into bins that start on a wavelength."""
    parts = raw_parts(Telephoto())
    return _raw_document(
        parts,
        ((0.0, 0.0), (5.0, -3.0), (-9.0, 2.0)),
        [spectral_detector("image", cs(z=parts.image_z), 44.0, 44.0, 20, 20, (0.4861327, 0.6562725, 4), "gaussian",
                           0.7),
         ray_database("pupil", cs(z=parts.pupil_z + 3.0), 40.0, 40.0, absorb=False)],
        detectors={"pupil": {"max_rays": 100}},
    )


@scene
def reverse_telephoto_wide() -> Json:
    """Sample: six elements over a 60 degree field; ghosts rouletted early."""
    parts = raw_parts(ReverseTelephoto())
    return _raw_document(
        parts,
        ((0.0, 0.0), (20.0, 0.0), (-28.0, 5.0), (12.0, 24.0)),
        [irradiance("image", cs(z=parts.image_z), 2.6, 2.6, 64, 64)],
        sampling={"reflect_prob": 0.12, "rr_start_flux": 0.2},
    )


@scene
def erfle_eyepiece() -> Json:
    """Sample: Erfle eyepiece backwards, a point and a disk on its field stop, the eye as a far field."""
    parts = raw_parts(EyepieceErfle())
    lines = spectrum(parts.wavelengths)
    return document(
        [],
        [point("reticle", cs(x=4.0, y=6.0, z=parts.image_z, ry=math.pi), lines, 9.0),
         extended("scene", cs(x=-2.0, z=parts.image_z + 1.0, ry=math.pi), lines, 12.0, radius=14.0, flux=2.0)],
        [irradiance("exit_pupil", cs(z=parts.pupil_z - 2.0), 60.0, 60.0, 48, 48, absorb=False),
         far_field("eye", cs(z=parts.pupil_z - 40.0), 60, 45)],
        surfaces=parts.surfaces,
        **({"media": parts.media} if parts.media else {}),
    )


@scene
def infrared_triplet_ghosts() -> Json:
    """Sample: uncoated germanium (n = 4) and ZnSe, 36 percent reflected a face."""
    parts = raw_parts(InfraredTriplet())
    return _raw_document(
        parts,
        ((0.0, 0.0), (2.5, 1.0), (-1.0, -3.5)),
        [irradiance("image", cs(z=parts.image_z), 8.0, 8.0, 40, 40),
         irradiance("narcissus", cs(z=-60.0), 90.0, 90.0, 30, 30, "hard")],
    )


# Shapes, solids and cavities.


@scene
def ball_lens_ghosts() -> Json:
    """A glass ball and a capped ball lit by a point: spheres with and without an aperture, far field of three lines."""
    ball = surface("ball", cs(z=20.0), sphere(5.0), "refractive", None, medium("n1.5"))
    cap = surface("cap", cs(x=1.0, z=40.0, rx=0.2), sphere(6.0, 4.5), "refractive", None, medium("n1.7"))
    return document(
        [],
        [point("S", cs(x=0.3, y=-0.2), spectrum([0.45, 0.55, 0.65], [1.0, 2.0, 1.0]), 14.0, 2.0)],
        [irradiance("near", cs(x=0.1, z=31.0), 14.0, 14.0, 48, 40, "hard", absorb=False),
         far_field("sky", cs(z=90.0), 45, 37)],
        media={"n1.5": constant(1.5), "n1.7": constant(1.7)},
        surfaces=[ball, cap],
    )


@scene
def nested_media() -> Json:
    """A lamp born in a water ball with a glass ball and an air bubble in it: media in media, all of them absorbing."""
    balls = [
        surface("water", cs(), sphere(30.0), "refractive", None, medium("water")),
        surface("glass", cs(x=6.0, z=4.0), sphere(14.0), "refractive", medium("water"), medium("flint")),
        surface("bubble", cs(x=8.0, y=-3.0, z=6.0), sphere(5.0), "refractive", medium("flint"), None),
    ]
    lines = [0.45, 0.55, 0.65]
    return document(
        [],
        [point("lamp", cs(x=-15.0, y=2.0, z=-8.0), spectrum(lines, [1.0, 1.0, 2.0]), 180.0, 3.0, medium("water")),
         point("spark", cs(x=8.5, y=-2.0, z=6.0, ry=0.7), spectrum([0.55]), 90.0)],
        [far_field("front", cs(z=45.0), 36, 45), far_field("back", cs(z=-45.0), 36, 45)],
        media={"water": table(lines, [1.340, 1.334, 1.331], [2e-7, 4e-7, 9e-7]),
               "flint": table(lines, [1.67, 1.65, 1.64], [1e-6, 3e-7, 2e-7])},
        surfaces=balls,
    )


@scene
def light_pipe() -> Json:
    """A square rod of six planes, lit from within by a Lambertian rectangle born in the glass: total reflection."""
    length, side = 60.0, 8.0
    glass = medium("acrylic")
    walls = [
        surface(f"wall_{i}", cs(x=side / 2.0, z=length / 2.0, ry=RIGHT_ANGLE, reference_cs=cs(rz=i * RIGHT_ANGLE)),
                plane(width=length, height=side), "refractive", glass, None)
        for i in range(4)
    ]
    ends = [surface("entry", cs(), plane(width=side, height=side), "refractive", None, glass),
            surface("exit", cs(z=length), plane(width=side, height=side), "refractive", glass, None)]
    lines = [0.47, 0.53, 0.63]
    scene_file = document(
        [],
        [extended("led", cs(x=0.7, y=-0.4, z=0.5), spectrum(lines, [1.0, 1.0, 1.5]), 90.0, width=2.0, height=1.0,
                  flux=4.0, medium=glass),
         collimated("laser", cs(x=-1.0, y=0.3, z=3.0, rx=0.35, ry=-0.6), spectrum([0.53]), 0.5, 0.7, sigma=0.2,
                    medium=glass)],
        [irradiance("exit_map", cs(z=length + 1.5), 20.0, 20.0, 40, 40, "hard"),
         far_field("spill", cs(z=length + 40.0), 30, 41)],
        media={"acrylic": table(lines, [1.4985, 1.4935, 1.4880], [2e-8, 3e-8, 8e-8])},
        surfaces=[*walls, *ends],
        sampling={"rr_start_flux": 0.05},
    )
    return _mounted(scene_file, cs(x=20.0, y=10.0, z=-40.0, rx=-0.4, ry=0.9, rz=0.25))


@scene
def tapered_light_guide() -> Json:
    """An absorbing glass cone with a lensed end: conical frustum, plane disk and conic as one solid."""
    wide, narrow, length, radius = 6.0, 3.0, 40.0, -15.0
    sag = -(15.0 - math.sqrt(15.0**2 - wide**2))
    glass = medium("tinted")
    faces = [
        surface("cone", cs(), frustum(narrow, wide, 0.0, length + sag), "refractive", glass, None),
        surface("entry", cs(), plane(aperture_radius=narrow), "refractive", None, glass),
        surface("exit", cs(z=length), conic(radius, 0.0, wide), "refractive", glass, None),
    ]
    return document(
        [],
        [extended("phosphor", cs(x=0.2, z=0.8), spectrum([0.45, 0.6]), 62.0, radius=2.2, flux=1.5, medium=glass),
         extended("pump", cs(y=-0.3, z=-2.0), spectrum([0.45]), 120.0, radius=1.0, flux=0.5)],
        [irradiance("plane", cs(z=70.0), 60.0, 60.0, 60, 60, "gaussian", 0.6), far_field("sky", cs(z=72.0), 45, 45)],
        media={"tinted": constant(1.55, 4e-8)},
        surfaces=faces,
    )


@scene
def kaleidoscope() -> Json:
    """Three plane mirrors, three coloured shapes: reflectance by wavelength, roulette from 0.4 of a ray's flux."""
    side, length = 20.0, 150.0
    apothem = side / (2.0 * math.sqrt(3.0))
    silver = reflectance_table([0.46, 0.53, 0.62], [0.78, 0.86, 0.93])
    walls = [
        surface(f"mirror_{i}", cs(x=apothem, z=length / 2.0, ry=RIGHT_ANGLE,
                                  reference_cs=cs(rz=0.1 + i * 2.0 * math.pi / 3.0)),
                plane(width=length, height=side), "reflective", reflectance=silver)
        for i in range(3)
    ]
    shapes = [
        extended("red", cs(x=1.5, y=2.0, z=-0.5), spectrum([0.62]), 32.0, width=3.0, height=1.0, flux=1.0),
        extended("green", cs(x=-2.0, y=1.0, z=-0.5, rz=0.6), spectrum([0.53]), 32.0, radius=0.8, flux=0.7),
        extended("blue", cs(x=0.5, y=-2.5, z=-0.5, rz=1.0), spectrum([0.46]), 32.0, width=0.6, height=3.0, flux=0.5),
    ]
    return document(
        [],
        shapes,
        [spectral_detector("eye", cs(z=length + 60.0), 220.0, 220.0, 48, 48, (0.42, 0.66, 3)),
         irradiance("window", cs(z=length + 0.5), 24.0, 24.0, 32, 32, "hard", absorb=False)],
        surfaces=walls,
        sampling={"rr_start_flux": 0.4},
    )


@scene
def integrating_sphere() -> Json:
    """A mirror-walled sphere with a lamp, a baffle ring and a small detector inside: deep paths and roulette."""
    wall = surface("wall", cs(), sphere(50.0), "reflective",
                   reflectance=reflectance_table([0.5, 0.6], [0.97, 0.9]))
    baffle = surface("baffle", cs(x=4.0, z=12.0, ry=0.3), annulus(3.0, 9.0, 1.5), "absorbing")
    return document(
        [],
        [point("lamp", cs(x=11.0, y=-3.0, z=-7.0, rx=0.5), spectrum([0.5, 0.6]), 120.0)],
        [irradiance("port", cs(x=-20.0, y=5.0, z=30.0, ry=-0.6), 18.0, 18.0, 18, 18),
         irradiance("probe", cs(y=-25.0, rx=1.1), 20.0, 16.0, 10, 8, "hard", absorb=False)],
        surfaces=[wall, baffle],
        sampling={"rr_start_flux": 0.7},
    )


@scene
def newtonian_telescope() -> Json:
    """A paraboloid of R = 0.9, a round fold mirror, tube and front ring; spots on a Gaussian splat."""
    flat = surface("flat", cs(z=-330.0, ry=math.pi / 4.0), plane(aperture_radius=17.0), "reflective",
                   reflectance=reflectance_table([0.48, 0.55, 0.64], [0.7, 0.93, 0.81]))
    shade = surface("shade", cs(z=-350.0), plane(aperture_radius=13.0), "absorbing")
    tube = surface("tube", cs(), frustum(64.0, 64.0, -420.0, -350.0), "absorbing")
    front = surface("front_ring", cs(z=-420.0), annulus(59.0, 64.0), "absorbing")
    lines = spectrum([0.48, 0.55, 0.64])
    return document(
        [mirror("M1", cs(), -800.0, 0.9, 65.0, -1.0)],
        [collimated(f"star_{i}", beam_frame(y, 0.0, 500.0, x), lines, 60.0, flux)
         for i, (y, x, flux) in enumerate(((0.0, 0.0, 1.0), (0.25, 0.1, 0.4), (-0.1, -0.3, 0.2)))],
        [irradiance("camera", cs(x=70.5, z=-330.0, ry=RIGHT_ANGLE), 9.0, 9.0, 45, 45, "gaussian", 1.0),
         ray_database("pupil", cs(x=30.0, z=-330.0, ry=RIGHT_ANGLE), 30.0, 30.0, absorb=False)],
        surfaces=[flat, shade, tube, front],
        overrides={"M1.surface": {"aperture_radius": 58.0}},
    )


@scene
def aspheric_collimator() -> Json:
    """Hyperboloid, ellipsoids and an oblate face: a point collimated (far field at its pole) and focused again."""
    return document(
        [
            lens("collimator", cs(z=20.0), 10.0, math.inf, 6.0, medium("n1.5"), 9.0, conic1=-2.25),
            lens("focuser", cs(z=45.0), 18.0, 0.0, 9.0, catalog("N-BK7"), 9.0, conic1=-0.434),
            lens("field", cs(z=60.0), 30.0, -22.0, 6.0, catalog("N-BK7"), 8.0, conic1=0.8, conic2=-3.5),
        ],
        [point("pinhole", cs(), spectrum([0.5876]), 24.0),
         point("off_axis", cs(x=-0.4, y=0.7), spectrum([0.48, 0.65]), 22.0, 0.5)],
        [far_field("collimated", cs(z=40.0), 90, 45, absorb=False),
         irradiance("focus", cs(z=78.0), 16.0, 16.0, 64, 64),
         far_field("miss", cs(z=90.0), 18, 9)],
        media={"n1.5": constant(1.5)},
    )


@scene
def prism_spectrometer() -> Json:
    """A slit, an SF11 prism of two planes and an absorbing base, a camera lens: seven lines on hard spectral bins."""
    half_apex, face, deviation = math.radians(30.0), 24.0, math.radians(66.4)
    x, z = face / 2.0 * math.cos(half_apex), face / 4.0
    lines = [0.4358, 0.4861, 0.5461, 0.5876, 0.6328, 0.6563, 0.7065]
    # Minimum deviation: the beam enters and leaves in the middle of the faces, under the same angle.
    prism = cs(z=60.0, ry=-deviation / 2.0)
    side = z * math.sin(deviation / 2.0)
    camera = cs(x=-side, z=60.0 + z * math.cos(deviation / 2.0), ry=-deviation)
    surfaces = [
        surface("in", cs(z=-z, ry=-half_apex, reference_cs=prism), plane(width=face, height=30.0), "refractive", None,
                catalog("SF11")),
        surface("out", cs(z=z, ry=half_apex, reference_cs=prism), plane(width=face, height=30.0), "refractive",
                catalog("SF11"), None),
        surface("base", cs(x=-x, ry=RIGHT_ANGLE, reference_cs=prism), plane(width=face, height=30.0), "absorbing"),
        surface("slit", cs(x=side, z=20.0), annulus(1.2, 40.0), "absorbing"),
        surface("table_top", cs(y=-40.0, rx=RIGHT_ANGLE), plane(), "absorbing"),
    ]
    return document(
        [lens("camera", cs(z=45.0, reference_cs=camera), 70.0, -70.0, 7.0, "N-BK7", 16.0)],
        [collimated("lamp", cs(x=side, z=-10.0), spectrum(lines, [3.0, 1.0, 4.0, 2.0, 1.5, 2.0, 1.0]), 2.5, sigma=0.7),
         collimated("guide", cs(x=side - 0.3, y=0.2, z=10.0, ry=0.004), spectrum([0.5461]), 1.0, 0.1),
         point("room", cs(x=20.0, y=30.0, z=-15.0), spectrum([0.5461, 0.5876]), 180.0, 0.2)],
        [spectral_detector("spectrum", cs(z=112.0, reference_cs=camera), 30.0, 12.0, 60, 6, (0.42, 0.72, 12), "hard"),
         irradiance("reflected", cs(x=80.0, z=112.0, ry=RIGHT_ANGLE), 90.0, 60.0, 30, 20)],
        surfaces=surfaces,
    )


@scene
def filter_stack() -> Json:
    """Infinite planes: coloured and grey absorbing glass, Lambertian and point sources, on a tilted bench."""
    lines = [0.45, 0.55, 0.65]
    walls = []
    for i, (near, far, name) in enumerate(((10.0, 12.0, "red"), (20.0, 23.0, "grey"), (26.0, 27.0, "blue"))):
        walls += [surface(f"front_{i}", cs(z=near), plane(), "refractive", None, medium(name)),
                  surface(f"back_{i}", cs(z=far), plane(), "refractive", medium(name), None)]
    scene_file = document(
        [],
        [point("bulb", cs(x=2.0, y=-1.0), spectrum(lines, [1.0, 2.0, 3.0]), 65.0, 1.0),
         extended("panel", cs(x=-3.0, z=1.0), spectrum(lines), 90.0, width=6.0, height=2.0, flux=3.0),
         extended("disk", cs(y=4.0, z=2.0), spectrum([0.55]), 90.0, radius=1.5, flux=0.5)],
        [ray_database("between", cs(z=16.0, rz=0.4), 30.0, 20.0, absorb=False),
         spectral_detector("behind", cs(z=31.0), 80.0, 60.0, 20, 15, (0.4, 0.7, 6), "bilinear"),
         far_field("rest", cs(z=34.0), 18, 27),
         irradiance("returned", cs(z=-4.0), 60.0, 60.0, 15, 15, "hard")],
        media={"red": table(lines, [1.53, 1.52, 1.515], [2e-5, 1e-5, 1e-7]), "grey": constant(1.5, 3e-6),
               "blue": table(lines, [1.62, 1.61, 1.60], [1e-7, 8e-6, 4e-5])},
        surfaces=walls,
    )
    return _mounted(scene_file, cs(x=5.0, z=3.0, rx=0.2, reference_cs=cs(y=-8.0, ry=-0.7, rz=0.3)))


@scene
def searchlight() -> Json:
    """A paraboloid behind a Lambertian disk, a reflecting cone and ring, a front window: a far field."""
    return document(
        [mirror("dish", cs(z=60.0), -80.0, 0.85, 55.0, -1.0),
         lens("window", cs(z=-30.0, ry=0.05), 0.0, 0.0, 5.0, "N-BK7", 60.0)],
        [extended("arc", cs(x=0.5, z=20.0), spectrum([0.45, 0.55, 0.65], [2.0, 2.0, 1.0]), 120.0, radius=1.5,
                  flux=10.0),
         point("leak", cs(z=19.0, y=1.0), spectrum([0.55]), 150.0, 2.0)],
        [far_field("beam", cs(z=-60.0), 90, 45), irradiance("behind", cs(z=75.0), 200.0, 200.0, 20, 20)],
        surfaces=[
            surface("cone", cs(), frustum(58.0, 40.0, -20.0, 12.0), "reflective",
                    reflectance=reflectance_table([0.45, 0.55, 0.65], [0.6, 0.7, 0.75])),
            surface("ring", cs(z=8.0), annulus(12.0, 30.0, -2.0), "reflective", reflectance=0.8),
            surface("lamp_base", cs(z=17.5), plane(aperture_radius=2.0), "absorbing"),
        ],
        sampling={"rr_start_flux": 0.5},
    )


@scene
def mangin_catadioptric() -> Json:
    """Overrides: a lens with a silvered back, a polished edge and a mirrored rim; a blackened mirror; order changed."""
    return document(
        [
            lens("corrector", cs(z=-60.0), 0.0, 0.0, 6.0, "N-BK7", 30.0),
            lens("mangin", cs(z=40.0), -120.0, -180.0, 11.0, "N-SF11", 30.0, 33.0),
            {"type": "doublet", "name": "relay", "cs": cs(z=-20.0),
             "config": {"r1": 30.0, "r2": -24.0, "r3": -90.0, "thickness1": 5.0, "thickness2": 3.5,
                        "material1": "N-BK7", "material2": catalog("N-SF5"), "aperture_radius": 9.0,
                        "conic1": 0.0, "conic2": 0.0, "conic3": -0.5}},
            mirror("black", cs(z=70.0, rx=0.1), math.inf, 1.0, 60.0),
        ],
        [collimated("beam", beam_frame(1.0, 40.0, 140.0, 0.5), spectrum([0.4861, 0.5876, 0.6563]), 29.0),
         collimated("pencil", cs(x=31.0, z=-90.0, ry=0.01), spectrum([0.5876]), 1.5, 0.2, sigma=0.6)],
        [irradiance("focus", cs(z=-32.0), 16.0, 16.0, 40, 40),
         far_field("lost", cs(z=-150.0), 30, 45)],
        overrides={
            "mangin.back": {"interaction": "reflective",
                            "reflectance": reflectance_table([0.4861, 0.5876, 0.6563], [0.92, 0.96, 0.89])},
            "mangin.edge": {"interaction": "reflective", "reflectance": 0.5},
            "mangin.rim": {"interaction": "reflective", "reflectance": 0.3},
            "relay.edge_crown": {"interaction": "reflective", "reflectance": 0.4},
            "relay.edge_flint": {"interaction": "reflective", "reflectance": 0.4},
            "black.surface": {"interaction": "absorbing", "aperture_radius": 55.0},
        },
        order=["black", "mangin", "stop", "relay", "corrector"],
        surfaces=[surface("stop", cs(z=-50.0), annulus(27.0, 40.0), "absorbing")],
    )


@scene
def stacked_plates_ghosts() -> Json:
    """Five plates of n = 1.8 with reflect_prob 0.25: deep ghost paths until max_depth, weights up and down."""
    plates = [lens(f"plate_{i}", cs(z=12.0 * i, rx=0.02 * i, ry=-0.01 * i), math.inf, 0.0, 4.0, medium("dense"), 25.0)
              for i in range(5)]
    return document(
        plates,
        [collimated("laser", cs(x=1.0, y=0.5, z=-20.0), spectrum([0.633]), 6.0, sigma=2.5),
         collimated("tilted", beam_frame(8.0, 30.0, 60.0), spectrum([0.488, 0.633]), 5.0, 0.3)],
        [irradiance("through", cs(z=90.0), 60.0, 60.0, 30, 30),
         irradiance("back", cs(z=-25.0), 60.0, 60.0, 30, 30, "hard")],
        media={"dense": constant(1.8, 1e-7)},
        sampling={"reflect_prob": 0.25, "rr_start_flux": 0.01},
    )


@scene
def mirror_ball_billiard() -> Json:
    """Convex mirror balls in a mirror box: each reflection magnifies a difference, so rounding decides (chaotic)."""
    half = 20.0
    turns = [{}, {"rx": RIGHT_ANGLE}, {"rx": -RIGHT_ANGLE}, {"ry": RIGHT_ANGLE}, {"ry": -RIGHT_ANGLE}, {"rx": math.pi}]
    walls = [surface(f"wall_{i}", cs(z=half, reference_cs=cs(**turn)), plane(width=2 * half, height=2 * half),
                     "reflective", reflectance=0.98) for i, turn in enumerate(turns)]
    centres = [(0.5, 1.0, 0.0), *itertools.product((-12.0, 12.0), repeat=3)]
    balls = [surface(f"ball_{i}", cs(*centre), sphere(7.0), "reflective", reflectance=0.99)
             for i, centre in enumerate(centres)]
    return document(
        [],
        [point("lamp", cs(x=-1.0, y=-12.0, z=14.0), spectrum([0.55]), 180.0)],
        [irradiance("slot", cs(y=15.0, rx=RIGHT_ANGLE), 12.0, 12.0, 12, 12),
         irradiance("gauze", cs(x=-15.0, ry=RIGHT_ANGLE), 30.0, 30.0, 15, 15, "hard", absorb=False)],
        surfaces=[*walls, *balls],
        sampling={"rr_start_flux": 0.8},
    )


# Scattering and coatings.


@scene
def lambertian_sphere() -> Json:
    """A white sphere lit through its own scatter: Lambertian walls on mirrors of R by wavelength, port and probe."""
    wall = surface("wall", cs(x=3.0, y=-2.0, z=1.0, rx=0.3, ry=0.5), sphere(50.0), "reflective",
                   reflectance=reflectance_table([0.5, 0.6], [0.99, 0.95]), bsdf=lambertian(0.97),
                   scatter_fraction=0.9)
    return document(
        [],
        [point("lamp", cs(x=11.0, y=-3.0, z=-7.0, rx=0.5), spectrum([0.5, 0.6]), 40.0)],
        [irradiance("port", cs(x=-20.0, y=5.0, z=30.0, ry=-0.6), 18.0, 18.0, 18, 18),
         irradiance("probe", cs(y=-25.0, rx=1.1), 20.0, 16.0, 10, 8, "hard", absorb=False)],
        surfaces=[wall],
        sampling={"rr_start_flux": 0.6},
    )


@scene
def scattering_telescope() -> Json:
    """Polish errors: a window that scatters by Harvey-Shack either way, mirrors rough and dusty, edges of a lens."""
    window = [
        surface("window_in", cs(z=-60.0), plane(aperture_radius=34.0), "refractive", None, medium("clear"),
                bsdf=harvey_shack(0.5, 0.02, 2.2, 0.8), scatter_fraction=0.15),
        surface("window_out", cs(z=-52.0, rx=0.01), plane(aperture_radius=34.0), "refractive", medium("clear"), None,
                bsdf=harvey_shack(1.0, 0.3, 1.5, 1.0), scatter_fraction=0.4),
    ]
    tube = surface("tube", cs(), frustum(36.0, 36.0, -65.0, 40.0), "absorbing")
    dust = surface("flat", cs(y=25.0, z=-20.0, rx=-0.6), plane(width=40.0, height=50.0), "reflective",
                   reflectance=0.9, bsdf=specular(), scatter_fraction=0.3)
    return document(
        [mirror("primary", cs(z=120.0), -340.0, 0.94, 34.0, -1.0), lens("relay", cs(z=5.0, y=1.0), 40.0, -45.0, 6.0,
                                                                       medium("clear"), 9.0)],
        [collimated("star", cs(x=2.0, y=5.0, z=-80.0), spectrum([0.48, 0.55, 0.65]), 24.0),
         point("lamp", cs(x=-20.0, y=10.0, z=-78.0), spectrum([0.55]), 50.0, 0.3)],
        [irradiance("focus", cs(z=-42.0), 40.0, 40.0, 48, 48),
         far_field("scattered", cs(z=-90.0), 45, 45),
         irradiance("behind", cs(z=160.0), 300.0, 300.0, 20, 20)],
        media={"clear": table([0.48, 0.55, 0.65], [1.5228, 1.5185, 1.5145], [0.0, 0.0, 0.0])},
        surfaces=[*window, tube, dust],
        overrides={
            "primary.surface": {"bsdf": harvey_shack(20.0, 0.05, 2.5), "scatter_fraction": 0.25},
            "relay.edge": {"interaction": "reflective", "reflectance": 0.3, "bsdf": lambertian(0.8)},
        },
    )


#: A table that depends on both angles; pi times its values stays below 1, where Optiland would cut it.
TABLE_THETA_I = [0.0, 20.0, 45.0, 70.0, 90.0]
TABLE_THETA_S = [0.0, 10.0, 30.0, 50.0, 75.0, 90.0]


def _diffuser_table() -> list[list[float]]:
    return [[round(0.3 * math.cos(math.radians(0.7 * s)) * (1.0 - 0.006 * i) + 0.0001 * i, 6) for s in TABLE_THETA_S]
            for i in TABLE_THETA_I]


@scene
def coated_projector() -> Json:
    """Coatings that absorb, drawn with reflect_prob auto; a tabulated screen, a diffuser plate from a file, a fold."""
    diffuser = tabulated_file("data/diffuser.csv", 0.75)
    surfaces = [
        surface("plate_in", cs(z=22.0), plane(width=24.0, height=24.0), "refractive", None, medium("opal"),
                bsdf=diffuser, scatter_fraction=0.5, coating=coating(0.02, 0.97)),
        surface("plate_out", cs(z=24.0), plane(width=24.0, height=24.0), "refractive", medium("opal"), None),
        surface("fold", cs(z=60.0, ry=0.7), plane(width=60.0, height=60.0), "reflective", coating=coating(0.85, 0.1)),
        surface("screen", cs(x=-70.0, z=10.0, ry=RIGHT_ANGLE + 0.2), plane(width=90.0, height=90.0), "reflective",
                reflectance=1.0, bsdf=tabulated(TABLE_THETA_I, TABLE_THETA_S, _diffuser_table())),
    ]
    return document(
        [lens("condenser", cs(z=8.0), 25.0, -25.0, 8.0, "N-BK7", 10.0),
         lens("dense", cs(z=32.0, rx=0.1), 30.0, -60.0, 5.0, medium("dense"), 12.0)],
        [extended("film", cs(x=0.3), spectrum([0.48, 0.55, 0.65]), 40.0, width=6.0, height=4.0),
         collimated("laser", cs(x=-3.0, z=-5.0, ry=0.12), spectrum([0.55]), 1.5, 0.4)],
        [far_field("room", cs(z=-300.0), 45, 30),
         irradiance("seat", cs(x=-20.0, z=30.0, ry=RIGHT_ANGLE + 0.2), 50.0, 50.0, 20, 20, absorb=False),
         irradiance("straight", cs(z=110.0), 120.0, 120.0, 40, 40)],
        media={"opal": constant(1.5, 4e-6), "dense": constant(1.9, 1e-7)},
        surfaces=surfaces,
        overrides={
            "condenser.front": {"coating": coating(0.005, 0.99)},
            "condenser.back": {"coating": coating(0.3, 0.6)},
            "dense.front": {"coating": coating(0.0, 1.0)},
            "dense.edge": {"interaction": "reflective", "reflectance": 0.6},
        },
        sampling={"reflect_prob": "auto", "rr_start_flux": 0.02},
    )


@scene
def opal_lamp() -> Json:
    """An opal ball of absorbing glass round a lamp: Lambertian lobes to either side decide the medium."""
    lines = [0.45, 0.55, 0.65]
    ball = surface("ball", cs(x=1.0), sphere(12.0), "refractive", None, medium("opal"),
                   bsdf=lambertian(0.96, 0.45), scatter_fraction=0.7)
    bulb = surface("bulb", cs(x=2.0, y=1.0, z=-1.0), sphere(5.0), "refractive", medium("opal"), None,
                   bsdf=lambertian(0.99, 0.5))
    shade = surface("shade", cs(z=-5.0), frustum(14.0, 30.0, 0.0, 25.0), "reflective",
                    reflectance=reflectance_table(lines, [0.7, 0.8, 0.9]), bsdf=lambertian(0.9, 0.1),
                    scatter_fraction=0.8)
    return document(
        [],
        [point("lamp", cs(x=1.0, y=0.5), spectrum(lines, [1.0, 2.0, 2.0]), 180.0, 5.0),
         collimated("pointer", cs(x=-4.0, y=2.0, z=60.0, ry=math.pi), spectrum([0.65]), 2.0, 0.5)],
        [far_field("down", cs(z=70.0), 30, 36), far_field("up", cs(z=-70.0), 30, 36)],
        media={"opal": table(lines, [1.52, 1.51, 1.50], [3e-6, 2e-6, 1e-6])},
        surfaces=[ball, bulb, shade],
        sampling={"rr_start_flux": 0.3},
    )


def write_table() -> None:
    """Write the table that ``coated_projector`` reads: the same for every angle of incidence."""
    rows = [f"{i}, {s}, {round(0.31 * math.cos(math.radians(s)) ** 0.5, 6)}" for i in (0.0, 90.0)
            for s in (0.0, 15.0, 30.0, 45.0, 60.0, 80.0, 90.0)]
    path = SCENES_DIR / "data" / "diffuser.csv"
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join(["# theta_i [deg], theta_s [deg], bsdf [1/sr]", *rows]) + "\n", encoding="utf-8")


# Triangle meshes.


@scene
def mesh_prism() -> Json:
    """Triangle meshes: a prism of three copies of one face, dispersion into a dish of 128 triangles, ghosts."""
    half_side, distance = 10.0, 10.0 / math.sqrt(3.0)
    face = height_field(half_side, half_side, 3, lambda x, y: 0.0)
    # A dish of focal length 30; the ratios of its mesh keep edges away from the beam's axis.
    dish = height_field(9.0, 9.0, 8, lambda x, y: ((x - 0.3) ** 2 + (y + 0.4) ** 2) / 120.0)

    def side(name: str, normal_deg: float, interaction: str) -> Json:
        """A face of the prism, its normal at an angle from z towards y."""
        y, z = math.sin(math.radians(normal_deg)), math.cos(math.radians(normal_deg))
        frame = cs(0.0, distance * y, distance * z, rx=math.radians(-normal_deg))
        glass = medium("flint")
        return surface(name, frame, face, interaction, glass, None if interaction == "refractive" else glass)

    def along(angle_deg: float, length: float, start: tuple[float, float]) -> tuple[float, float]:
        """The point (y, z) at a length from a start, in a direction from z towards y."""
        angle = math.radians(angle_deg)
        return start[0] + length * math.sin(angle), start[1] + length * math.cos(angle)

    # Near minimum deviation: up into one face, along z inside, down out of the other.
    enters, leaves = along(150.0, distance, (0.0, 0.0)), along(30.0, distance, (0.0, 0.0))
    up = 19.7
    lamp_y, lamp_z = along(up + 180.0, 20.0, enters)
    dish_y, dish_z = along(-up, 25.0, leaves)
    image_y, image_z = along(180.0 + 30.0, 25.0, (dish_y, dish_z))
    ghost_y, ghost_z = along(300.0 - 180.0 - up, 20.0, enters)
    # The dish faces the middle between where the beam comes from and where it is to go.
    dish_rx = -math.radians((180.0 - up + 180.0 + 30.0) / 2.0)
    return document(
        [],
        [collimated("beam", cs(0.15, lamp_y, lamp_z, rx=-math.radians(up)), spectrum([0.45, 0.55, 0.65], [1.0, 2.0, 1.0]),
                    3.0),
         point("stray", cs(-2.0, 9.0, -12.0, rx=math.radians(30.0)), spectrum([0.55]), 25.0, 0.3)],
        [irradiance("image", cs(0.0, image_y, image_z, rx=math.radians(-30.0)), 12.0, 12.0, 40, 40),
         irradiance("ghost", cs(0.0, ghost_y, ghost_z, rx=math.radians(up - 120.0)), 30.0, 30.0, 30, 30),
         irradiance("beyond", cs(z=45.0), 120.0, 120.0, 30, 30)],
        media={"flint": table([0.45, 0.55, 0.65], [1.545, 1.527, 1.518], [2e-7, 1e-7, 3e-7])},
        surfaces=[side("entry", 150.0, "refractive"), side("exit", 30.0, "refractive"),
                  side("base", -90.0, "absorbing"),
                  surface("dish", cs(0.0, dish_y, dish_z, rx=dish_rx), dish, "reflective",
                          reflectance=reflectance_table([0.45, 0.55, 0.65], [0.85, 0.9, 0.8]))],
    )


@scene
def mesh_lens() -> Json:
    """A lens of two copies of one mesh of 512 triangles in a barrel images two lamps, reflect_prob auto."""
    face = height_field(9.0, 9.0, 16, lambda x, y: (x * x + y * y) / 60.0)
    glass = medium("crown")
    # The normal of either face points into the glass.
    faces = [surface(name, cs(z=z, rx=rx), face, "refractive", None, glass)
             for name, z, rx in (("front", -2.0, 0.0), ("back", 2.0, math.pi))]
    return document(
        [],
        [point("lamp", cs(0.37, -0.21, -60.0), spectrum([0.48, 0.62], [2.0, 1.0]), 6.0),
         collimated("sun", beam_frame(3.0, -2.0, 30.0, 1.0), spectrum([0.55]), 5.0, 0.5, sigma=2.0)],
        [spectral_detector("focus", cs(x=-0.4, z=31.0), 8.0, 8.0, 16, 16, (0.45, 0.65, 4), absorb=False),
         irradiance("image", cs(z=62.0), 30.0, 30.0, 50, 50, "gaussian", 0.7),
         far_field("ghosts", cs(z=-80.0, rx=math.pi), 18, 24)],
        media={"crown": table([0.48, 0.55, 0.62], [1.53, 1.52, 1.51], [0.0, 1e-7, 0.0])},
        surfaces=[*faces, surface("barrel", cs(), frustum(8.0, 8.0, -2.5, 2.5), "absorbing")],
        sampling={"reflect_prob": "auto"},
    )


# Splitting.


@scene
def split_ghosts() -> Json:
    """Bounded splitting: a biconvex singlet, a smoked window and a lossy coat; every ghost of three splits."""
    crown, smoked = medium("crown"), medium("smoked")
    faces = [surface("front", cs(), conic(70.0, 0.0, 12.0), "refractive", None, crown),
             surface("back", cs(z=5.0), conic(-90.0, 0.0, 12.0), "refractive", crown, None),
             surface("window.front", cs(z=12.0, rx=0.03), plane(width=30.0, height=30.0), "refractive", None, smoked,
                     coating=coating(0.1, 0.85)),
             surface("window.back", cs(z=14.0, rx=0.03), plane(width=30.0, height=30.0), "refractive", smoked, None)]
    return document(
        [],
        [collimated("star", beam_frame(1.5, -4.0, 40.0, 0.5), spectrum([0.48, 0.62], [2.0, 1.0]), 8.0, 2.0)],
        [irradiance("image", cs(z=60.0), 30.0, 30.0, 16, 16), irradiance("ghosts", cs(z=-60.0), 60.0, 60.0, 16, 16),
         far_field("stray", cs(z=-61.0), 12, 18)],
        media={"crown": table([0.48, 0.62], [1.63, 1.61], [1e-7, 2e-7]), "smoked": constant(1.5, 4e-6)},
        surfaces=faces,
        sampling={"reflect_prob": "auto", "split_depth": 3, "split_budget": 4.0, "rr_start_flux": 0.0},
    )


def write(name: str) -> None:
    """Write one scene file."""
    path = SCENES_DIR / f"{name}.json"
    path.write_text(json.dumps(SCENES[name](), indent=1) + "\n", encoding="utf-8")
    print(path.name)


def write_index() -> None:
    """Write the list of scenes."""
    lines = [f"| `{name}` | {(builder.__doc__ or '').strip()} |" for name, builder in SCENES.items()]
    text = "\n".join(["# Scenes", "", "Written by `python/tools/make_scenes.py`.", "", "| file | shows |", "|---|---|",
                      *lines])
    (SCENES_DIR / "README.md").write_text(text + "\n", encoding="utf-8")


def main() -> None:
    SCENES_DIR.mkdir(exist_ok=True)
    write_table()
    for name in sys.argv[1:] or SCENES:
        write(name)
    write_index()


if __name__ == "__main__":
    main()
