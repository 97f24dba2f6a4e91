"""The files of a trace -> live detectors, absorbers' counters and Optiland's own result objects."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.detectors.far_field import FarFieldDetector
from optiland.nonsequential.detectors.irradiance import IrradianceDetector
from optiland.nonsequential.detectors.ray_database import RayDatabaseDetector
from optiland.nonsequential.detectors.spectral import SpectralDetector
from optiland.nonsequential.diagnostics import build_diagnostics
from optiland.nonsequential.path_recording import _EVENT_DTYPE
from optiland.nonsequential.tracer import SimulationResult

from nsq_gpu.errors import NsqGpuError
from nsq_gpu.integrity import load_arrays

Json = dict[str, Any]

#: Fields of SimulationResult that the report holds under the same names.
_SAME = (
    "num_rays_total", "num_rays_absorbed", "num_rays_escaped", "num_rays_flux_killed", "num_rays_depth_killed",
    "total_flux_in", "total_flux_detected", "total_flux_tapped", "total_flux_absorbed", "total_flux_bulk_absorbed",
    "total_flux_escaped", "total_flux_lost", "flux_conservation_error", "trace_time_sec",
)
#: Longest name in an event [characters].
_NAME_LENGTH = _EVENT_DTYPE["component_name"].itemsize // 4
_ROWS = ("x", "y", "z", "L", "M", "N", "flux", "wavelength")


def fill_scene(scene: NSQScene, report: Json, folder: Path, surface_labels: list[str]) -> SimulationResult:
    """Put a trace into the live scene, as a trace of Optiland's leaves it, and return its result."""
    _check_names(report, surface_labels, scene.detector_names)
    _fill_absorbers(scene, report)
    arrays = {name: load_arrays(folder, report["detectors"][name]["file"], report) for name in scene.detector_names}
    for name, live in zip(scene.detector_names, scene.detectors, strict=True):
        _fill_detector(live, report["detectors"][name], arrays[name])
    detectors = {name: live.get_result() for name, live in zip(scene.detector_names, scene.detectors, strict=True)}
    for name, detector in detectors.items():
        _add_errors(detector, report["detectors"][name], arrays[name])
    return SimulationResult(
        **{key: report[key] for key in _SAME},
        detectors=detectors,
        ray_paths=_ray_paths(scene, report, folder, surface_labels),
        diagnostics=_diagnostics(scene, report, detectors),
    )


def _check_names(report: Json, surface_labels: list[str], detector_names: list[str]) -> None:
    """Check that the report speaks of this scene, since surfaces are matched by their order."""
    surfaces = [surface["name"] for surface in report["surfaces"]]
    if surfaces != surface_labels or list(report["detectors"]) != detector_names:
        raise NsqGpuError(f"the command traced {surfaces} and {list(report['detectors'])}, not {surface_labels} and "
                          f"{detector_names}; program and package are of different versions")


def _fill_absorbers(scene: NSQScene, report: Json) -> None:
    for surface, live in zip(report["surfaces"], scene.surfaces, strict=True):
        if isinstance(live, AbsorbingComponent):
            live._absorbed_count = surface["num_rays_absorbed"]
            live._absorbed_flux = surface["total_flux_absorbed"]


# Detectors


def _fill_detector(live: Any, spec: Json, arrays: Any) -> None:
    live.reset()
    _FILL[type(live)](live, spec, arrays)
    live._num_rays_hit = spec["num_rays_hit"]


def _add_errors(detector: Any, spec: Json, arrays: Any) -> None:
    """Put the standard errors on a result, where Optiland's has no field for them."""
    detector.total_flux_standard_error = spec["total_flux_standard_error"]
    detector.standard_error = arrays.get("standard_error")


def _pixel_area(live: Any) -> float:
    return float(live.width) / int(live.num_pixels_x) * (float(live.height) / int(live.num_pixels_y))


def _fill_irradiance(live: Any, spec: Json, arrays: Any) -> None:
    live._data = be.array((arrays["irradiance"] * _pixel_area(live)).ravel())


def _fill_spectral(live: Any, spec: Json, arrays: Any) -> None:
    live._flux_map = arrays["irradiance"] * _pixel_area(live)


def _fill_far_field(live: Any, spec: Json, arrays: Any) -> None:
    live._intensity = arrays["intensity"]
    live._total_flux = spec["total_flux"]


def _fill_ray_database(live: Any, spec: Json, arrays: Any) -> None:
    # Of a capped database the live detector counts every row, its result those that were kept.
    live._total_flux = spec["total_flux_recorded"]
    # Without rows Optiland's own detector holds no arrays at all.
    if len(arrays["x"]):
        for key in _ROWS:
            getattr(live, f"_{key}").append(arrays[key])


_FILL: dict[type, Callable[[Any, Json, Any], None]] = {
    IrradianceDetector: _fill_irradiance,
    SpectralDetector: _fill_spectral,
    FarFieldDetector: _fill_far_field,
    RayDatabaseDetector: _fill_ray_database,
}


# Diagnostics and paths


def _diagnostics(scene: NSQScene, report: Json, detectors: dict[str, Any]) -> Any:
    launched, said = report["total_flux_in"], report["diagnostics"]
    reached = {index for index, surface in enumerate(report["surfaces"]) if surface["reached"]}
    return build_diagnostics(
        scene,
        reached,
        report["num_rays_total"],
        launched,
        said["depth_truncated_flux_fraction"] * launched,
        said["rr_killed_flux_fraction"] * launched,
        report["flux_conservation_error"],
        said["split_budget_saturated"],
        detectors,
        medium_stack_underflows=said["medium_stack_underflows"],
    )


def _ray_paths(scene: NSQScene, report: Json, folder: Path, surface_labels: list[str]) -> Json | None:
    if report["ray_paths"] is None:
        return None
    columns = load_arrays(folder, report["ray_paths"], report)
    events = np.empty(len(columns["ray_id"]), dtype=_EVENT_DTYPE)
    for key in _EVENT_DTYPE.names or ():
        events[key] = columns[key]
    events["component_name"] = _optilands_names(scene, events, surface_labels)
    return {"events": events}


def _optilands_names(scene: NSQScene, events: np.ndarray, surface_labels: list[str]) -> np.ndarray:
    """Return the events' names as Optiland's own traces write them.

    Its births read ``source_0`` and its detectors have no name, whatever the registry calls them, and programs that
    read its paths expect that.
    """
    sources = {name: getattr(live, "name", f"source_{index}")
               for index, (name, live) in enumerate(zip(scene.source_names, scene.sources, strict=True))}
    surfaces = {label: live.name or f"component_{index}"
                for index, (label, live) in enumerate(zip(surface_labels, scene.surfaces, strict=True))}
    detectors = {name: live.name for name, live in zip(scene.detector_names, scene.detectors, strict=True)}
    names = events["component_name"].copy()
    for which, known in (("birth", sources), ("hit", surfaces | detectors)):
        chosen = events["event_type"] == which
        found, inverse = np.unique(events["component_name"][chosen], return_inverse=True)
        # The field cuts long names.
        cut = {name[:_NAME_LENGTH]: renamed for name, renamed in known.items()}
        names[chosen] = np.array([cut[str(name)] for name in found], dtype=names.dtype)[inverse]
    return names
