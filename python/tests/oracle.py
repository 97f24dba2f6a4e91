"""The oracle: builds a scene file with Optiland (``nsq_gpu.scene_file``) and traces it with NumpyBackend in float64."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.base import BaseComponent
from optiland.nonsequential.diagnostics import Diagnostics

from nsq_gpu import scene_file
from nsq_gpu.scene_file import TableMaterial

__all__ = ["TableMaterial"]

Json = dict[str, Any]

COUNTS = (
    "num_rays_total",
    "num_rays_absorbed",
    "num_rays_escaped",
    "num_rays_flux_killed",
    "num_rays_depth_killed",
)
FLUXES = (
    "total_flux_in",
    "total_flux_detected",
    "total_flux_tapped",
    "total_flux_absorbed",
    "total_flux_bulk_absorbed",
    "total_flux_escaped",
    "total_flux_lost",
)

SCENES_DIR = Path(__file__).resolve().parents[2] / "scenes"

#: Arrays of a detector's result, by its kind, under Optiland's own npz keys.
DETECTOR_ARRAYS = {
    "irradiance": ("irradiance", "x_coords", "y_coords"),
    "spectral": ("irradiance", "x_coords", "y_coords", "wavelengths"),
    "far_field": ("intensity", "theta", "phi"),
    "ray_database": ("x", "y", "z", "L", "M", "N", "flux", "wavelength"),
}


def load_scene(path: str | Path) -> NSQScene:
    """Build the scene of a file, in float64."""
    _use_numpy()
    return scene_file.load_scene(path)


def scene_from_dict(document: Json, folder: Path = SCENES_DIR) -> NSQScene:
    """Build the scene of a parsed file, in float64; files that it names lie in ``folder``."""
    _use_numpy()
    return scene_file.scene_from_dict(document, folder)


def _use_numpy() -> None:
    be.set_backend("numpy")
    be.set_precision("float64")


def detector_kinds(document: Json) -> dict[str, str]:
    """Return the kind of every detector of a parsed file, by name."""
    return {spec["name"]: spec["type"] for spec in document["detectors"]}


def run(path: str | Path, num_rays: int, seed: int = 0, **kwargs: Any) -> Json:
    """Trace a scene file; ``kwargs`` go to ``NSQScene.trace``."""
    document = json.loads(Path(path).read_text(encoding="utf-8"))
    return trace(scene_from_dict(document, Path(path).parent), detector_kinds(document), num_rays, seed, **kwargs)


def trace(scene: NSQScene, kinds: dict[str, str], num_rays: int, seed: int = 0, **kwargs: Any) -> Json:
    """Trace a live scene and return every figure of the result as plain Python and NumPy values.

    ``kwargs`` go to ``NSQScene.trace``; its backend is NumpyBackend unless they name another.
    """
    hits = _count_surface_hits(scene)
    kwargs.setdefault("backend", NumpyBackend(seed=seed))
    result = scene.trace(num_rays=num_rays, seed=seed, **kwargs)
    found = figures(scene, kinds, result)
    recorded = sum(detector["num_rays_hit"] for detector in found["detectors"].values())
    return {
        **found,
        "seed": seed,
        "surface_hits": hits,
        "interactions_per_ray": (sum(hits.values()) + recorded) / num_rays,
    }


def figures(scene: NSQScene, kinds: dict[str, str], result: Any) -> Json:
    """Return every figure of a result, and of the live scene that it was traced in."""
    detectors = {
        name: _detector_result(kinds[name], live, result.detectors[name])
        for name, live in zip(scene.detector_names, scene.detectors, strict=True)
    }
    return {
        **{name: int(getattr(result, name)) for name in COUNTS},
        **{name: float(getattr(result, name)) for name in FLUXES},
        "flux_conservation_error": float(result.flux_conservation_error),
        "trace_time_sec": float(result.trace_time_sec),
        "detectors": detectors,
        "absorbers": _absorbers(scene),
        "diagnostics": _diagnostics(result),
    }


def _count_surface_hits(scene: NSQScene) -> dict[str, int]:
    """Count the hits of every surface from now on, by name (Optiland keeps counters for absorbers only)."""
    hits: dict[str, int] = {}
    for surface in scene.surfaces:
        hits[surface.name] = 0
        surface.interact = _counting(surface, hits)
    return hits


def _counting(surface: BaseComponent, hits: dict[str, int]) -> Any:
    interact = type(surface).interact

    def counted(rays: Any, t: Any, normals: Any, hit_mask: Any, *args: Any, **kwargs: Any) -> None:
        hits[surface.name] += int(np.count_nonzero(hit_mask))
        interact(surface, rays, t, normals, hit_mask, *args, **kwargs)

    return counted


def _detector_result(kind: str, live: Any, result: Any) -> Json:
    # The live detector's counter, because a RayDatabase has none and Optiland's diagnostics read 0 for it.
    arrays = {key: np.array(getattr(result, key), dtype=np.float64) for key in DETECTOR_ARRAYS[kind]}
    return {
        "kind": kind,
        "total_flux": float(be.to_numpy(result.total_flux)),
        "num_rays_hit": int(live._num_rays_hit),
        "transmissive": not live.absorb,
        **arrays,
    }


def _absorbers(scene: NSQScene) -> Json:
    return {
        surface.name: {"num_rays": int(surface._absorbed_count), "flux": float(surface._absorbed_flux)}
        for surface in scene.surfaces
        if isinstance(surface, AbsorbingComponent)
    }


def _diagnostics(result: Any) -> Json:
    diagnostics = dataclasses.asdict(result.diagnostics)
    diagnostics["unreached_geometry"] = list(diagnostics["unreached_geometry"])
    diagnostics["detectors"] = list(diagnostics["detectors"])
    # Optiland's own, also of our results, which say of the energy what the ledger says.
    diagnostics["warnings"] = Diagnostics.warnings(result.diagnostics)
    return diagnostics
