"""Writes the scene files in ``scenes/``: ``python -m tools.make_scenes [NAME ...]`` from the folder ``python``.

Each scene is one function below, named as its file. Numbers are written in full (``repr``), so that the file alone
reproduces the scene bit for bit.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

Json = dict[str, Any]

SCENES_DIR = Path(__file__).resolve().parents[2] / "scenes"

SCENES: dict[str, Callable[[], Json]] = {}

#: Fraunhofer F, d and C lines [um].
FDC = ([0.4861, 0.5876, 0.6563], [1.0, 1.0, 1.0])


def scene(builder: Callable[[], Json]) -> Callable[[], Json]:
    """Register a builder under its own name."""
    SCENES[builder.__name__] = builder
    return builder


# Nouns of the file format. Lengths in mm, angles of frames in rad, wavelengths in um.


def cs(x: float = 0.0, y: float = 0.0, z: float = 0.0, *, rx: float = 0.0, ry: float = 0.0, rz: float = 0.0,
       reference_cs: Json | None = None) -> Json:
    return {"x": x, "y": y, "z": z, "rx": rx, "ry": ry, "rz": rz, "reference_cs": reference_cs}


def lens(name: str, frame: Json, r1: float, r2: float, thickness: float, material: Any, radius: float,
         back_radius: float | None = None, conic1: float = 0.0, conic2: float = 0.0) -> Json:
    config = {"r1": r1, "r2": r2, "thickness": thickness, "material": material, "front_aperture_radius": radius,
              "back_aperture_radius": back_radius, "conic1": conic1, "conic2": conic2}
    return {"type": "lens", "name": name, "cs": frame, "config": config}


def mirror(name: str, frame: Json, radius: float, reflectance: float, aperture_radius: float,
           conic: float = 0.0) -> Json:
    config = {"radius": radius, "reflectance": reflectance, "conic": conic, "aperture_radius": aperture_radius}
    return {"type": "mirror", "name": name, "cs": frame, "config": config}


def spectrum(wavelengths: list[float], weights: list[float] | None = None) -> Json:
    return {"wavelengths": wavelengths, "weights": weights or [1.0] * len(wavelengths)}


def point(name: str, frame: Json, spectral: Json, half_angle_deg: float, flux: float = 1.0,
          medium: Any = None) -> Json:
    return {"type": "point", "name": name, "cs": frame, "spectrum": spectral, "total_flux": flux,
            "half_angle_deg": half_angle_deg, "medium": medium}


def collimated(name: str, frame: Json, spectral: Json, radius: float, flux: float = 1.0, sigma: float | None = None,
               medium: Any = None) -> Json:
    """A parallel beam; ``sigma`` makes it Gaussian."""
    return {"type": "collimated", "name": name, "cs": frame, "spectrum": spectral, "total_flux": flux,
            "aperture_radius": radius, "profile": "tophat" if sigma is None else "gaussian",
            "gaussian_sigma": radius / 2.0 if sigma is None else sigma, "medium": medium}


def extended(name: str, frame: Json, spectral: Json, half_angle_deg: float, *, width: float = 1.0,
             height: float = 1.0, radius: float | None = None, flux: float = 1.0, medium: Any = None) -> Json:
    return {"type": "extended", "name": name, "cs": frame, "spectrum": spectral, "total_flux": flux, "width": width,
            "height": height, "aperture_radius": radius, "half_angle_deg": half_angle_deg, "medium": medium}


def irradiance(name: str, frame: Json, width: float, height: float, nx: int, ny: int, splat: str = "bilinear",
               sigma: float = 0.5, absorb: bool = True) -> Json:
    return {"type": "irradiance", "name": name, "cs": frame, "width": width, "height": height, "num_pixels_x": nx,
            "num_pixels_y": ny, "splat": splat, "splat_sigma": sigma, "absorb": absorb}


def spectral_detector(name: str, frame: Json, width: float, height: float, nx: int, ny: int,
                      bins: tuple[float, float, int], splat: str = "bilinear", sigma: float = 0.5,
                      absorb: bool = True) -> Json:
    return {"type": "spectral", "name": name, "cs": frame, "width": width, "height": height, "num_pixels_x": nx,
            "num_pixels_y": ny, "wl_min": bins[0], "wl_max": bins[1], "num_bins": bins[2], "splat": splat,
            "splat_sigma": sigma, "absorb": absorb}


def far_field(name: str, frame: Json, num_theta: int, num_phi: int, absorb: bool = True) -> Json:
    return {"type": "far_field", "name": name, "cs": frame, "num_bins_theta": num_theta, "num_bins_phi": num_phi,
            "absorb": absorb}


def ray_database(name: str, frame: Json, width: float, height: float, absorb: bool = True) -> Json:
    return {"type": "ray_database", "name": name, "cs": frame, "width": width, "height": height, "absorb": absorb}


def medium(name: str) -> Json:
    return {"type": "medium", "name": name}


def catalog(name: str) -> Json:
    return {"type": "catalog", "name": name}


def constant(n: float, k: float = 0.0) -> Json:
    return {"type": "constant", "n": n, "k": k}


def surface(name: str, frame: Json, shape: Json, interaction: str, front: Any = None, back: Any = None,
            reflectance: Any = None) -> Json:
    spec = {"name": name, "cs": frame, "shape": shape, "interaction": interaction, "material_front": front,
            "material_back": back}
    return spec if reflectance is None else {**spec, "reflectance": reflectance}


def conic(radius: float, k: float, aperture_radius: float) -> Json:
    return {"type": "conic", "radius": radius, "conic": k, "aperture_radius": aperture_radius}


def sphere(radius: float, aperture_radius: float | None = None) -> Json:
    return {"type": "sphere", "radius": radius, "aperture_radius": aperture_radius}


def annulus(inner: float, outer: float, z_offset: float = 0.0) -> Json:
    return {"type": "annulus", "inner_radius": inner, "outer_radius": outer, "z_offset": z_offset}


def frustum(r_front: float, r_back: float, z_front: float, z_back: float) -> Json:
    return {"type": "frustum", "r_front": r_front, "r_back": r_back, "z_front": z_front, "z_back": z_back}


def plane(**outline: float) -> Json:
    """A plane: infinite, or of a width and height, or of an aperture_radius."""
    return {"type": "plane", **outline}


def document(components: list[Json], sources: list[Json], detectors: list[Json], **block: Any) -> Json:
    """A whole file; keywords become the ``nsq_gpu`` block."""
    v1 = {"nsq_schema_version": 1, "components": components, "sources": sources, "detectors": detectors}
    return {**v1, "nsq_gpu": {"version": 1, **block}} if block else v1


# Optiland's own benchmark scenes.


@scene
def bench_lens() -> Json:
    return document(
        [lens("L", cs(), 100.0, -100.0, 5.0, medium("glass"), 12.5)],
        [collimated("S", cs(z=-25.0), spectrum([0.55]), 10.0)],
        [irradiance("D", cs(z=150.0), 50.0, 50.0, 64, 64)],
        media={"glass": constant(1.5)},
    )


@scene
def bench_cavity() -> Json:
    mirrors = [mirror(name, cs(z=z), math.inf, 0.98, 20.0) for name, z in (("M_far", 50.0), ("M_near", -50.0))]
    return document(
        mirrors,
        [collimated("S", cs(), spectrum([0.55]), 3.0)],
        [irradiance("D", cs(z=25.0), 12.0, 12.0, 32, 32, absorb=False)],
    )


@scene
def bench_surface_count_50() -> Json:
    decoys = [mirror(f"decoy_{i}", cs(x=500.0 * (i + 1), z=10.0), math.inf, 0.9, 5.0) for i in range(50)]
    return document(
        decoys,
        [collimated("S", cs(z=-10.0), spectrum([0.55]), 5.0)],
        [irradiance("D", cs(z=100.0), 20.0, 20.0, 64, 64)],
    )


@scene
def ball_lens_ghosts() -> Json:
    """A glass ball and a half-ball, point source: sphere with and without an aperture, ghosts, far field."""
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
def cooke_triplet() -> Json:
    """Optiland's sample, converted: three field angles, three wavelengths, a picture behind it."""
    import warnings

    from optiland.nonsequential.convert import sequential_to_nonsequential
    from optiland.nonsequential.serialization import scene_to_dict
    from optiland.samples.objectives import CookeTriplet

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        v1 = scene_to_dict(sequential_to_nonsequential(CookeTriplet()))
    lines = spectrum([0.48, 0.55, 0.65])
    fields = [collimated(f"field_{angle}", _field_frame(angle, 11.5, 40.0), lines, 5.0, 1.0 / (1 + i))
              for i, angle in enumerate((0, 7, 14, 20))]
    return document(
        v1["components"], fields,
        [irradiance("image", cs(z=60.17), 50.0, 50.0, 256, 256),
         far_field("stray", cs(z=75.0), 60, 61)],
    )


def _field_frame(angle_deg: float, pupil_z: float, distance: float, x_angle_deg: float = 0.0) -> Json:
    """The frame of a beam that crosses the axis in the entrance pupil at a field angle."""
    y, x = math.radians(angle_deg), math.radians(x_angle_deg)
    # R = Ry Rx sends local z to (sin x cos y, sin y, cos x cos y) for rx = -y, ry = x.
    direction = (math.sin(x) * math.cos(y), math.sin(y), math.cos(x) * math.cos(y))
    position = [-distance * component for component in direction]
    return cs(position[0], position[1], pupil_z + position[2], rx=-y, ry=x)


def write(name: str) -> None:
    """Write one scene file."""
    path = SCENES_DIR / f"{name}.json"
    path.write_text(json.dumps(SCENES[name](), indent=1) + "\n", encoding="utf-8")
    print(path.name)


def main() -> None:
    SCENES_DIR.mkdir(exist_ok=True)
    for name in sys.argv[1:] or SCENES:
        write(name)


if __name__ == "__main__":
    main()
