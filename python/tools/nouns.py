"""The nouns of a scene file as functions. Lengths in mm, angles of frames in rad, wavelengths in um."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

Json = dict[str, Any]


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
            reflectance: Any = None, **finish: Any) -> Json:
    """A single surface; ``finish`` takes ``bsdf``, ``scatter_fraction`` and ``coating``."""
    spec = {"name": name, "cs": frame, "shape": shape, "interaction": interaction, "material_front": front,
            "material_back": back, **finish}
    return spec if reflectance is None else {**spec, "reflectance": reflectance}


def lambertian(reflectance_value: float = 1.0, transmissive_fraction: float = 0.0) -> Json:
    return {"type": "lambertian", "reflectance_value": reflectance_value,
            "transmissive_fraction": transmissive_fraction}


def harvey_shack(b0: float, l0: float, s: float, transmissive_fraction: float = 0.0) -> Json:
    return {"type": "harvey_shack", "b0": b0, "l0": l0, "s": s, "transmissive_fraction": transmissive_fraction}


def tabulated(theta_i: list[float], theta_s: list[float], rows: list[list[float]],
              transmissive_fraction: float = 0.0) -> Json:
    return {"type": "tabulated", "theta_i": theta_i, "theta_s": theta_s, "bsdf": rows,
            "transmissive_fraction": transmissive_fraction}


def tabulated_file(path: str, transmissive_fraction: float = 0.0) -> Json:
    return {"type": "tabulated", "path": path, "transmissive_fraction": transmissive_fraction}


def specular() -> Json:
    return {"type": "specular"}


def coating(reflectance: float, transmittance: float) -> Json:
    return {"type": "simple", "reflectance": reflectance, "transmittance": transmittance}


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


def mesh(vertices: list[list[float]], faces: list[list[int]]) -> Json:
    """Triangles, counter-clockwise seen from the side that the normal points to."""
    return {"type": "mesh", "vertices": vertices, "faces": faces}


def height_field(half_width: float, half_height: float, squares: int, height: Callable[[float, float], float]) -> Json:
    """A mesh of squares x squares rectangles over local x and y, each cut in two; its normal has a part along +z."""
    side = squares + 1
    steps = [-1.0 + 2.0 * i / squares for i in range(side)]
    points = [(half_width * x, half_height * y) for y in steps for x in steps]
    corners = [row * side + column for row in range(squares) for column in range(squares)]
    faces = [face for a in corners for face in ([a, a + 1, a + side + 1], [a, a + side + 1, a + side])]
    return mesh([[x, y, height(x, y)] for x, y in points], faces)


def document(components: list[Json], sources: list[Json], detectors: list[Json], /, **block: Any) -> Json:
    """A whole file; keywords become the ``nsq_gpu`` block."""
    v1 = {"nsq_schema_version": 1, "components": components, "sources": sources, "detectors": detectors}
    return {**v1, "nsq_gpu": {"version": 1, **block}} if block else v1


def beam_frame(angle_deg: float, pupil_z: float, distance: float, x_angle_deg: float = 0.0) -> Json:
    """The frame of a beam that starts a distance before the entrance pupil and crosses the axis in it."""
    y, x = math.radians(angle_deg), math.radians(x_angle_deg)
    # Rotation Ry Rx with rx = -y, ry = x sends local z to this direction.
    direction = (math.sin(x) * math.cos(y), math.sin(y), math.cos(x) * math.cos(y))
    position = [-distance * component for component in direction]
    return cs(position[0], position[1], pupil_z + position[2], rx=-y, ry=x)


def table(wavelengths: list[float], n: list[float], k: list[float]) -> Json:
    return {"type": "table", "wavelengths": wavelengths, "n": n, "k": k}


def reflectance_table(wavelengths: list[float], values: list[float]) -> Json:
    return {"wavelengths": wavelengths, "values": values}
