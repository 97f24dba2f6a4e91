"""The oracle: builds a scene file with Optiland and traces it with NumpyBackend in float64.

A scene file is Optiland's v1 JSON plus an optional ``nsq_gpu`` block. The scene is built here rather than by
Optiland's ``from_json``, which knows nothing of the block and leaves a source's medium as a string.

Which materials are one object matters to Optiland, because its medium stack compares identities: every v1 component
resolves its own catalog glass, a medium of the block is one object per name, and the block's surfaces and the
sources share one object per catalog name.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coatings import SimpleCoating
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import IdealMaterial
from optiland.materials.base import BaseMaterial
from optiland.nonsequential import NSQMaterial, NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.bsdf import BaseBSDF, HarveyShackBSDF, LambertianBSDF, SpecularBRDF, TabulatedBSDF
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.base import BaseComponent
from optiland.nonsequential.components.configs import (
    DoubletConfig,
    InteractionType,
    LensConfig,
    MirrorConfig,
    SurfaceConfig,
)
from optiland.nonsequential.components.geometry.analytic.annulus import AnnularPlaneGeometry
from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry
from optiland.nonsequential.components.geometry.analytic.frustum import CylindricalFrustumGeometry
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry, PlaneGeometry
from optiland.nonsequential.components.geometry.analytic.sphere import SphereGeometry
from optiland.nonsequential.components.geometry.base import ComponentGeometry
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
from optiland.nonsequential.sources.configs import (
    CollimatedSourceConfig,
    ExtendedSourceConfig,
    PointSourceConfig,
)

Json = dict[str, Any]

SCENES_DIR = Path(__file__).resolve().parents[2] / "scenes"

SCHEMA_VERSION = 1
BLOCK_VERSION = 1

#: Per kind of v1 component: the slots of its config for overrides, and the surfaces that each slot covers. An override
#: names a surface, as in ``L1.front``.
OVERRIDE_SLOTS = {
    "lens": {"front": ("front",), "back": ("back",), "edge": ("edge",), "rim": ("rim",)},
    "doublet": {"front": ("front",), "cemented": ("cemented",), "back": ("back",),
                "edge": ("edge_crown", "edge_flint")},
    "mirror": {"surface": ("surface",)},
}

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

#: Arrays of a detector's result, by its kind, under Optiland's own npz keys.
DETECTOR_ARRAYS = {
    "irradiance": ("irradiance", "x_coords", "y_coords"),
    "spectral": ("irradiance", "x_coords", "y_coords", "wavelengths"),
    "far_field": ("intensity", "theta", "phi"),
    "ray_database": ("x", "y", "z", "L", "M", "N", "flux", "wavelength"),
}


class TableMaterial(BaseMaterial):
    """A medium given by n and k at listed wavelengths, linear between them and constant outside."""

    def __init__(self, wavelengths: list[float], n: list[float], k: list[float] | None = None) -> None:
        super().__init__()
        self.wavelengths = np.asarray(wavelengths, dtype=np.float64)
        self.index = np.asarray(n, dtype=np.float64)
        self.extinction = np.zeros_like(self.index) if k is None else np.asarray(k, dtype=np.float64)

    def _calculate_n(self, wavelength: np.ndarray, **kwargs: Any) -> np.ndarray:
        return np.interp(wavelength, self.wavelengths, self.index)

    def _calculate_k(self, wavelength: np.ndarray, **kwargs: Any) -> np.ndarray:
        return np.interp(wavelength, self.wavelengths, self.extinction)


class Materials:
    """Resolves the material values of one scene file to NSQMaterial objects."""

    def __init__(self, media: Json) -> None:
        self._media = {name: NSQMaterial(optiland_material=_medium(spec)) for name, spec in media.items()}
        self._catalog: dict[str, NSQMaterial] = {}

    def shared(self, value: Any) -> NSQMaterial:
        """Return the material of a surface's side or of a source: one object per name."""
        if value is None:
            return VACUUM
        if isinstance(value, dict) and value["type"] == "medium":
            return self._media[value["name"]]
        name = value if isinstance(value, str) else value["name"]
        if name not in self._catalog:
            self._catalog[name] = NSQMaterial.from_glass(name)
        return self._catalog[name]

    def for_component(self, value: Any) -> str | NSQMaterial | None:
        """Return what a v1 config takes: a catalog name stays a name, as Optiland's loader leaves it."""
        if isinstance(value, dict):
            return value["name"] if value["type"] == "catalog" else self._media[value["name"]]
        return value


def _medium(spec: Json) -> BaseMaterial:
    kind = spec["type"]
    if kind == "constant":
        return IdealMaterial(n=spec["n"], k=spec.get("k", 0.0))
    if kind == "table":
        return TableMaterial(spec["wavelengths"], spec["n"], spec.get("k"))
    if kind == "catalog":
        return NSQMaterial.from_glass(spec["name"]).optiland_material
    raise ValueError(f"unknown medium type {kind!r}")


def load_scene(path: str | Path) -> NSQScene:
    """Build the scene of a file."""
    path = Path(path)
    return scene_from_dict(json.loads(path.read_text(encoding="utf-8")), path.parent)


def scene_from_dict(document: Json, folder: Path = SCENES_DIR) -> NSQScene:
    """Build the scene of a parsed file, whose paths start from a folder."""
    be.set_backend("numpy")
    be.set_precision("float64")
    block = document.get("nsq_gpu", {})
    _check_versions(document, block)
    materials = Materials(block.get("media", {}))
    scene = NSQScene()
    _add_components(scene, document, block, materials, folder)
    for spec in document.get("sources", []):
        scene.add_source(spec["name"], _frame(spec["cs"]), _source_config(spec, materials))
    for spec in document.get("detectors", []):
        extra = block.get("detectors", {}).get(spec["name"], {})
        scene.add_detector(spec["name"], _frame(spec["cs"]), _detector_config(spec, extra))
    scene.sampling_policy = SamplingPolicy(**block.get("sampling", {}))
    return scene


def _check_versions(document: Json, block: Json) -> None:
    if document.get("nsq_schema_version") != SCHEMA_VERSION:
        raise ValueError(f"nsq_schema_version is {document.get('nsq_schema_version')!r}, not {SCHEMA_VERSION}")
    if block and block.get("version") != BLOCK_VERSION:
        raise ValueError(f"nsq_gpu.version is {block.get('version')!r}, not {BLOCK_VERSION}")


def _frame(spec: Json) -> CoordinateSystem:
    reference = spec.get("reference_cs")
    placement = {key: spec.get(key, 0.0) for key in ("x", "y", "z", "rx", "ry", "rz")}
    return CoordinateSystem(**placement, reference_cs=_frame(reference) if reference else None)


def _add_components(scene: NSQScene, document: Json, block: Json, materials: Materials, folder: Path) -> None:
    """Add v1 components and raw surfaces in the file's component order."""
    components = {spec["name"]: spec for spec in document.get("components", [])}
    surfaces = {spec["name"]: spec for spec in block.get("surfaces", [])}
    overrides = block.get("overrides", {})
    for name in block.get("order", [*components, *surfaces]):
        if name in components:
            _add_compound(scene, components[name], overrides, materials, folder)
        else:
            scene.add_component(name, _raw_surface(surfaces[name], materials, folder))


def _add_compound(scene: NSQScene, spec: Json, overrides: Json, materials: Materials, folder: Path) -> None:
    name, kind = spec["name"], spec["type"]
    config = dict(spec["config"])
    for key in ("material", "material1", "material2"):
        if key in config:
            config[key] = materials.for_component(config[key])
    for slot, parts in OVERRIDE_SLOTS[kind].items():
        chosen = [overrides.get(f"{name}.{part}") for part in parts]
        if any(override != chosen[0] for override in chosen):
            raise ValueError(f"Optiland cannot override {name}'s surfaces {parts} differently")
        if chosen[0] is not None:
            config[slot] = _surface_config(chosen[0], folder)
    if "reflectance" in config:
        config["reflectance"] = reflectance(config["reflectance"])
    if kind == "lens":
        scene.add_lens(name, _frame(spec["cs"]), LensConfig(**config))
    elif kind == "doublet":
        scene.add_doublet(name, _frame(spec["cs"]), DoubletConfig(**config))
    else:
        scene.add_mirror(name, _frame(spec["cs"]), MirrorConfig(**config))


def _surface_config(spec: Json, folder: Path) -> SurfaceConfig:
    interaction = spec.get("interaction")
    finish = _finish(spec, folder)
    return SurfaceConfig(
        interaction=InteractionType(interaction) if interaction else None,
        aperture_radius=spec.get("aperture_radius"),
        coating=finish.pop("coating"),
        reflectance=_mirror_reflectance(spec),
        **finish,
    )


def _finish(spec: Json, folder: Path) -> Json:
    """Return how a surface scatters, and its coating."""
    return {
        "bsdf": _bsdf(spec["bsdf"], folder) if spec.get("bsdf") else None,
        "scatter_fraction": spec.get("scatter_fraction", 1.0),
        "coating": _coating(spec["coating"]) if spec.get("coating") else None,
    }


def _bsdf(spec: Json, folder: Path) -> BaseBSDF:
    parameters = {key: value for key, value in spec.items() if key != "type"}
    if spec["type"] == "tabulated":
        return _tabulated(parameters, folder)
    kinds = {"specular": SpecularBRDF, "lambertian": LambertianBSDF, "harvey_shack": HarveyShackBSDF}
    return kinds[spec["type"]](**parameters)


def _tabulated(spec: Json, folder: Path) -> TabulatedBSDF:
    """Load a table with Optiland's reader; one that stands in the scene is written to a file first."""
    fraction = spec.get("transmissive_fraction", 0.0)
    if "path" in spec:
        return TabulatedBSDF(folder / spec["path"], fraction)
    rows = [[theta_i, theta_s, value] for theta_i, row in zip(spec["theta_i"], spec["bsdf"], strict=True)
            for theta_s, value in zip(spec["theta_s"], row, strict=True)]
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "table.csv"
        path.write_text("\n".join(",".join(map(repr, row)) for row in rows), encoding="utf-8")
        return TabulatedBSDF(path, fraction)


def _coating(spec: Json) -> SimpleCoating:
    return SimpleCoating(spec["transmittance"], spec["reflectance"])


def _mirror_reflectance(spec: Json) -> Any:
    """Return a mirror's reflectance: its own, or its coating."""
    if spec.get("reflectance") is None and spec.get("coating"):
        return _coating(spec["coating"])
    return reflectance(spec.get("reflectance"))


def reflectance(value: Any) -> Any:
    """Turn a reflectance into what Optiland takes: a number, or a function of the wavelength [um]."""
    if not isinstance(value, dict):
        return value
    wavelengths, values = value["wavelengths"], value["values"]
    return lambda wavelength: np.interp(wavelength, wavelengths, values)


def _raw_surface(spec: Json, materials: Materials, folder: Path) -> BaseComponent:
    frame, shape, name = _frame(spec["cs"]), _shape(spec["shape"]), spec["name"]
    front = materials.shared(spec.get("material_front"))
    finish = _finish(spec, folder)
    if spec["interaction"] == "refractive":
        back = materials.shared(spec.get("material_back"))
        return RefractiveComponent(frame, shape, front, back, name=name, **finish)
    if spec["interaction"] == "reflective":
        del finish["coating"]
        return ReflectiveComponent(
            frame, shape, _mirror_reflectance(spec), material_front=front, name=name, **finish
        )
    return AbsorbingComponent(frame, shape, front, name=name)


def _shape(spec: Json) -> ComponentGeometry:
    parameters = {key: value for key, value in spec.items() if key != "type"}
    if spec["type"] == "plane":
        return FinitePlaneGeometry(**parameters) if parameters else PlaneGeometry()
    shapes = {
        "conic": ConicGeometry,
        "annulus": AnnularPlaneGeometry,
        "frustum": CylindricalFrustumGeometry,
        "sphere": SphereGeometry,
    }
    return shapes[spec["type"]](**parameters)


def _source_config(spec: Json, materials: Materials) -> Any:
    configs = {"point": PointSourceConfig, "collimated": CollimatedSourceConfig, "extended": ExtendedSourceConfig}
    config = configs[spec["type"]]
    fields = {field.name for field in dataclasses.fields(config)} - {"spectrum", "medium"}
    medium = spec.get("medium")
    return config(
        spectrum=Spectrum(**spec["spectrum"]),
        medium=None if medium is None else materials.shared(medium),
        **{key: spec[key] for key in fields & spec.keys()},
    )


def _detector_config(spec: Json, extra: Json) -> Any:
    configs = {
        "irradiance": IrradianceDetectorConfig,
        "spectral": SpectralDetectorConfig,
        "far_field": FarFieldDetectorConfig,
        "ray_database": RayDatabaseConfig,
    }
    # The one pair of names that differs between v1 and the config.
    names = {"num_bins_theta": "num_theta", "num_bins_phi": "num_phi"} if spec["type"] == "far_field" else {}
    parameters = {names.get(key, key): value for key, value in spec.items() if key not in ("type", "name", "cs")}
    return configs[spec["type"]](**parameters, **extra)


def detector_kinds(document: Json) -> dict[str, str]:
    """Return the kind of every detector of a parsed file, by name."""
    return {spec["name"]: spec["type"] for spec in document["detectors"]}


def run(path: str | Path, num_rays: int, seed: int = 0, **kwargs: Any) -> Json:
    """Trace a scene file; ``kwargs`` go to ``NSQScene.trace``."""
    path = Path(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    return trace(scene_from_dict(document, path.parent), detector_kinds(document), num_rays, seed, **kwargs)


def trace(scene: NSQScene, kinds: dict[str, str], num_rays: int, seed: int = 0, **kwargs: Any) -> Json:
    """Trace a live scene and return every figure of the result as plain Python and NumPy values.

    ``kwargs`` go to ``NSQScene.trace``; its backend is NumpyBackend unless they name another.
    """
    hits = _count_surface_hits(scene)
    kwargs.setdefault("backend", NumpyBackend(seed=seed))
    result = scene.trace(num_rays=num_rays, seed=seed, **kwargs)
    detectors = {
        name: _detector_result(kinds[name], live, result.detectors[name])
        for name, live in zip(scene.detector_names, scene.detectors, strict=True)
    }
    recorded = sum(detector["num_rays_hit"] for detector in detectors.values())
    return {
        **{name: int(getattr(result, name)) for name in COUNTS},
        **{name: float(getattr(result, name)) for name in FLUXES},
        "flux_conservation_error": float(result.flux_conservation_error),
        "trace_time_sec": float(result.trace_time_sec),
        "seed": seed,
        "detectors": detectors,
        "absorbers": _absorbers(scene),
        "surface_hits": hits,
        "interactions_per_ray": (sum(hits.values()) + recorded) / num_rays,
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
    diagnostics["warnings"] = result.diagnostics.warnings()
    return diagnostics
