"""Live detectors -> ``detectors`` and ``nsq_gpu.detectors``."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry
from optiland.nonsequential.detectors.far_field import FarFieldDetector
from optiland.nonsequential.detectors.irradiance import IrradianceDetector
from optiland.nonsequential.detectors.ray_database import RayDatabaseDetector
from optiland.nonsequential.detectors.spectral import SpectralDetector
from optiland.nonsequential.scene import NSQScene

from nsq_gpu.color import KEY, SPACE, UNITS, WHO
from nsq_gpu.detectors import SphereFarField
from nsq_gpu.export.values import Json, coordinate_system, number, numbers, refuse, refuse_type

#: Radius of the disk that stands for the far field [mm].
FAR_FIELD_RADIUS = 1e6
#: Largest relative difference between given bin edges and evenly spaced ones.
_EVEN = 1e-12
_SPLATS = ("bilinear", "gaussian", "hard")


def detectors(scene: NSQScene) -> tuple[list[Json], dict[str, Json]]:
    """Return every detector, in order, and what version 1 lacks of them."""
    named = list(zip(scene.detector_names, scene.detectors, strict=True))
    extras = {name: {"max_rays": int(live.max_rays)} for name, live in named
              if isinstance(live, RayDatabaseDetector) and live.max_rays}
    return [_detector(name, live) for name, live in named], extras


def _detector(name: str, live: Any) -> Json:
    place = f"detector {name!r}"
    kind = _KINDS.get(type(live))
    if kind is None:
        raise refuse_type(place, "it", live, "an irradiance, spectral, far-field or ray-database detector of Optiland")
    return {"type": kind[0], "name": name, "cs": coordinate_system(live.cs, place), **kind[1](live, place),
            "absorb": bool(live.absorb), **_color(kind[0], live, place)}


def _color(kind: str, live: Any, place: str) -> Json:
    """Return whether it sees colour: a live detector has it as an attribute, for which Optiland has no field."""
    color = getattr(live, KEY, None)
    if color is None:
        return {}
    if kind not in UNITS:
        raise refuse(f"{place}: {KEY}", f"{color!r} of a detector of the kind {kind}", WHO)
    if color != SPACE:
        raise refuse(f"{place}: {KEY}", f"{color!r} is unknown", f"give {SPACE!r}")
    return {KEY: color}


def _rectangle(live: Any, place: str) -> Json:
    """Return the size of the rectangle that rays can hit."""
    geometry = live.geometry
    if type(geometry) is not FinitePlaneGeometry or geometry.aperture_radius is not None:
        raise refuse(place, "its geometry is no rectangle", "give it a FinitePlaneGeometry of a width and a height")
    return {key: number(getattr(geometry, key), f"{place}: {key}") for key in ("width", "height")}


def _pixels(live: Any, place: str) -> Json:
    size = _rectangle(live, place)
    for key, value in size.items():
        if number(getattr(live, key), f"{place}: {key}") != value:
            raise refuse(f"{place}: {key}", f"its pixels span {getattr(live, key)} mm, its geometry {value} mm",
                         "build the detector anew instead of changing one of the two")
    if live.splat not in _SPLATS:
        raise refuse(f"{place}: splat", f"{live.splat!r} is unknown", f"give one of {', '.join(_SPLATS)}")
    return {**size, "num_pixels_x": int(live.num_pixels_x), "num_pixels_y": int(live.num_pixels_y),
            "splat": live.splat, "splat_sigma": number(live.splat_sigma, f"{place}: splat_sigma")}


def _spectral(live: Any, place: str) -> Json:
    edges = numbers(live.wavelength_bins, f"{place}: wavelength_bins")
    _check_even(edges, np.linspace(edges[0], edges[-1], len(edges)), f"{place}: wavelength_bins")
    return {**_pixels(live, place), "wl_min": edges[0], "wl_max": edges[-1], "num_bins": len(edges) - 1}


def _check_even(edges: Any, even: np.ndarray, place: str) -> None:
    if not np.allclose(edges, even, rtol=_EVEN, atol=_EVEN * float(np.abs(even).max())):
        raise refuse(place, f"its bin edges are not {len(even)} even steps from {even[0]:g} to {even[-1]:g}",
                     "a scene file holds only even ones")


def _far_field(live: Any, place: str) -> Json:
    is_sphere = type(live) is SphereFarField
    _check_even(live._theta_edges, np.linspace(0.0, 180.0 if is_sphere else 90.0, live.num_bins_theta + 1), f"{place}: theta")
    _check_even(live._phi_edges, np.linspace(-180.0, 180.0, live.num_bins_phi + 1), f"{place}: phi")
    geometry = live.geometry
    if type(geometry) is not FinitePlaneGeometry or geometry.aperture_radius != FAR_FIELD_RADIUS:
        raise refuse(place, "its aperture is not Optiland's default", f"leave it at {FAR_FIELD_RADIUS:g} mm")
    bins = {"num_bins_theta": operator.index(live.num_bins_theta), "num_bins_phi": int(live.num_bins_phi)}
    return {**bins, "sphere": True} if is_sphere else bins


def _ray_database(live: Any, place: str) -> Json:
    if not live.store_rays:
        raise refuse(f"{place}: store_rays", "it is False, which a scene file cannot say",
                     "use an irradiance detector of one pixel")
    return _rectangle(live, place)


_KINDS: dict[type, tuple[str, Callable[[Any, str], Json]]] = {
    IrradianceDetector: ("irradiance", _pixels),
    SpectralDetector: ("spectral", _spectral),
    FarFieldDetector: ("far_field", _far_field),
    SphereFarField: ("far_field", _far_field),
    RayDatabaseDetector: ("ray_database", _ray_database),
}
