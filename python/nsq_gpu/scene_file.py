"""Scene files -> live scenes.

Optiland's own ``from_json`` knows nothing of the ``nsq_gpu`` block and leaves a source's medium as a string. This
module imports no other one of the package, but where a scene has a source, a shape, a coating or a scattering law of its own,
a flux in lumens, or a type without a class: ``nsq-bench`` carries it alone.

Which materials are one object matters to Optiland, because its medium stack compares identities: every component of
version 1 resolves its own catalog glass, a medium of the block is one object per name, and the block's surfaces and
the sources share one object per catalog name.
"""

from __future__ import annotations

import dataclasses
import json
import re
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coatings import BaseCoating, SimpleCoating
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import IdealMaterial
from optiland.materials.base import BaseMaterial
from optiland.materials.material_file import MaterialFile
from optiland.nonsequential import NSQMaterial, NSQScene
from optiland.nonsequential.bsdf import HarveyShackBSDF, LambertianBSDF, SpecularBRDF, TabulatedBSDF
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
from optiland.nonsequential.sources.configs import (
    CollimatedSourceConfig,
    ExtendedSourceConfig,
    PointSourceConfig,
)

Json = dict[str, Any]

SCHEMA_VERSION = 1
BLOCK_VERSION = 1

#: Per kind of v1 component: the slots of its config for overrides, and the surfaces that each slot covers. An override
#: names a surface, as in ``L1.front``.
OVERRIDE_SLOTS: dict[str, dict[str, tuple[str, ...]]] = {
    "lens": {"front": ("front",), "back": ("back",), "edge": ("edge",), "rim": ("rim",)},
    "doublet": {"front": ("front",), "cemented": ("cemented",), "back": ("back",),
                "edge": ("edge_crown", "edge_flint")},
    "mirror": {"surface": ("surface",)},
}

#: Classes of Optiland by the ``type`` in the file, but for those that are built of more than their keys.
_SHAPES: dict[str, Any] = {
    "conic": ConicGeometry,
    "annulus": AnnularPlaneGeometry,
    "frustum": CylindricalFrustumGeometry,
    "sphere": SphereGeometry,
}
_BSDFS: dict[str, Any] = {"lambertian": LambertianBSDF, "harvey_shack": HarveyShackBSDF, "specular": SpecularBRDF}
_SOURCES: dict[str, Any] = {"point": PointSourceConfig, "collimated": CollimatedSourceConfig, "extended": ExtendedSourceConfig}
_DETECTORS: dict[str, Any] = {
    "irradiance": IrradianceDetectorConfig,
    "spectral": SpectralDetectorConfig,
    "far_field": FarFieldDetectorConfig,
    "ray_database": RayDatabaseConfig,
}

_STRING = r'"[^"\\]*(?:\\.[^"\\]*)*"'
_STRING_OR_COMMENT = re.compile(rf"({_STRING})|//[^\n\r\u2028\u2029]*|/\*.*?\*/", re.DOTALL)
# A trailing comma follows a value. A comma that follows none is kept, so that JSON's parser refuses it.
_STRING_OR_TRAILING_COMMA = re.compile(rf"({_STRING}|[\[{{,:]\s*,)|,(?=\s*[\]}}])", re.DOTALL)


#: A wavelength in float32 differs from itself in float64 by so much, relative to it, at most.
_ROUNDING = 1e-6


class TableMaterial(BaseMaterial):  # type: ignore[no-untyped-call]
    """A medium given by n and k at listed wavelengths [um], in any order: linear between them, and refused beyond them."""

    def __init__(self, wavelengths: list[float], n: list[float], k: list[float] | None = None,
                 label: str = "a medium by table") -> None:
        super().__init__()
        order = np.argsort(wavelengths)
        self.wavelengths = np.asarray(wavelengths, dtype=np.float64)[order]
        self.index = np.asarray(n, dtype=np.float64)[order]
        self.extinction = np.zeros_like(self.index) if k is None else np.asarray(k, dtype=np.float64)[order]
        # An attribute `name` would pass for a catalog name with Optiland.
        self.label = label

    def _calculate_n(self, wavelength: Any, **kwargs: Any) -> Any:
        return self._at(wavelength, self.index)

    def _calculate_k(self, wavelength: Any, **kwargs: Any) -> Any:
        return self._at(wavelength, self.extinction)

    def _at(self, wavelength: Any, values: np.ndarray) -> Any:
        asked = np.asarray(be.to_numpy(wavelength), dtype=np.float64)
        first, last = self.wavelengths[[0, -1]]
        # Torch may hand on wavelengths in float32.
        beyond = asked[(asked < first * (1.0 - _ROUNDING)) | (asked > last * (1.0 + _ROUNDING))]
        if beyond.size:
            raise ValueError(f"{self.label}: the table has no value at {beyond.flat[0]:g} um; it is from {first:g} to {last:g} um")
        return be.array(np.interp(asked, self.wavelengths, values))


def _interpolate(wavelength: Any, wavelengths: Any, values: Any) -> Any:
    return be.array(np.interp(be.to_numpy(wavelength), wavelengths, values))


class Materials:
    """Resolves the material values of one scene file to NSQMaterial objects."""

    def __init__(self, media: Json) -> None:
        self._media = {name: _named(name, spec) for name, spec in media.items()}
        self._catalog: dict[str, NSQMaterial] = {}

    def shared(self, value: Any) -> NSQMaterial:
        """Return the material of a surface's side or of a source: one object per name."""
        if value is None:
            return VACUUM
        if isinstance(value, dict) and value["type"] == "medium":
            return self._media[value["name"]]
        name = value if isinstance(value, str) else value["name"]
        if name not in self._catalog:
            self._catalog[name] = _from_catalog(name)
        return self._catalog[name]

    def for_component(self, value: Any) -> str | NSQMaterial | None:
        """Return what a v1 config takes: a catalog name stays a name, as Optiland's loader leaves it."""
        if isinstance(value, dict) and value["type"] == "medium":
            return self._media[value["name"]]
        name = value["name"] if isinstance(value, dict) else value
        # Of an entry's path, Optiland's search knows nothing.
        return _from_catalog(name) if name is not None and "/" in name else name


def _from_catalog(name: str) -> NSQMaterial:
    """Return the material of a catalog name, or of an entry's path such as ``glass/schott/SF6``."""
    if "/" not in name:
        return NSQMaterial.from_glass(name)
    entry = Path(str(resources.files("optiland.database"))) / "data-nk" / f"{name}.yml"
    return NSQMaterial(optiland_material=MaterialFile(str(entry)))


def _named(name: str, spec: Json) -> NSQMaterial:
    material = NSQMaterial(optiland_material=_medium(name, spec))
    # For the exporter; an attribute `name` of the inner material would pass for a catalog name with Optiland.
    material.nsq_gpu_name = name  # type: ignore[attr-defined]
    return material


def _medium(name: str, spec: Json) -> BaseMaterial | None:
    kind = spec["type"]
    if kind == "constant":
        return IdealMaterial(n=spec["n"], k=spec.get("k", 0.0))
    if kind == "table":
        return TableMaterial(spec["wavelengths"], spec["n"], spec.get("k"), f"the medium {name!r}")
    if kind == "catalog":
        return _from_catalog(spec["name"]).optiland_material
    raise ValueError(f"unknown medium type {kind!r}")


def load_scene(path: str | Path) -> NSQScene:
    """Build the scene of a file, which is taken for valid; see :func:`read_document` for what its text may hold.

    Raises:
        OSError: The file, or one that it names, cannot be read.
        ValueError: It is not UTF-8, not JSON, of another version, or holds what Optiland has not.
        UnsupportedSceneError: It has a type for which there is no class in Python; the message has the place.
    """
    path = Path(path)
    return scene_from_dict(read_document(path), path.parent)


def read_document(path: Path) -> Json:
    """Return the tree of a file: JSON, with comments, trailing commas and a byte order mark as the command takes them.

    Raises:
        OSError: The file cannot be read.
        json.JSONDecodeError: The text is something else, such as the rest of JSON5; the message says where.
        UnicodeDecodeError: It is not UTF-8.
    """
    return parsed(path.read_text(encoding="utf-8-sig"))


def parsed(text: str) -> Json:
    """Return the tree of a file's text; see :func:`read_document`."""
    bare = _STRING_OR_TRAILING_COMMA.sub(_blank, _STRING_OR_COMMENT.sub(_blank, text))
    try:
        document: Json = json.loads(bare)
    except json.JSONDecodeError as error:
        limits = "Python reads JSON with comments, trailing commas, Infinity and NaN, and no more of JSON5"
        raise json.JSONDecodeError(f"{error.msg}; {limits}", text, error.pos) from None
    return document


def _blank(found: re.Match[str]) -> str:
    """Return what is to be kept, group 1, or as many blanks, so that errors still name the right place."""
    return found[1] or re.sub(r"[^\n]", " ", found[0])


def scene_from_dict(document: Json, folder: Path | None = None) -> NSQScene:
    """Build the scene of a parsed file; files that it names are looked for from ``folder``."""
    block = document.get("nsq_gpu") or {}
    folder = folder or Path()
    _check_versions(document, block)
    materials = Materials(block.get("media", {}))
    scene = NSQScene()
    _add_components(scene, document, block, materials, folder)
    for index, spec in enumerate(document.get("sources", [])):
        _add_source(scene, spec, f"sources[{index}]", materials, folder)
    for index, spec in enumerate(document.get("detectors", [])):
        extra = block.get("detectors", {}).get(spec["name"], {})
        _add_detector(scene, spec, f"detectors[{index}]", extra)
    sampling = dict(block.get("sampling") or {})
    # Optiland's policy has no place for these.
    for key, attribute in (("guide", "guided_light"), ("scatter_prob", "scatter_prob"), ("scatter_to", "scatter_to")):
        if key in sampling:
            setattr(scene, attribute, sampling.pop(key))
    scene.sampling_policy = SamplingPolicy(**sampling)
    if block.get("elements"):
        scene.elements = block["elements"]
    return scene


def _check_versions(document: Json, block: Json) -> None:
    if document.get("nsq_schema_version") != SCHEMA_VERSION:
        raise ValueError(f"nsq_schema_version is {document.get('nsq_schema_version')!r}, not {SCHEMA_VERSION}")
    if block and block.get("version") != BLOCK_VERSION:
        raise ValueError(f"nsq_gpu.version is {block.get('version')!r}, not {BLOCK_VERSION}")


def _class_of(spec: Json, classes: dict[str, Any], place: str) -> Any:
    """Return the class of an object of the file, which stands at ``place`` there.

    Raises:
        UnsupportedSceneError: There is none of its type.
    """
    kind = spec["type"]
    if kind not in classes:
        from nsq_gpu.errors import UnsupportedSceneError

        raise UnsupportedSceneError(f"{place}: the type {kind!r} has no class in Python, so the file cannot become a live scene; trace "
                                    "the file itself by `nsq-gpu trace SCENE -o FOLDER`, and read its result by nsq_gpu.load(FOLDER)")
    return classes[kind]


def _frame(spec: Json) -> CoordinateSystem:
    reference = spec.get("reference_cs")
    placement = {key: spec.get(key, 0.0) for key in ("x", "y", "z", "rx", "ry", "rz")}
    frame = CoordinateSystem(**placement, reference_cs=_frame(reference) if reference else None)
    if spec.get("name") is not None:
        # For the exporter, as the names of elements.
        frame.name = spec["name"]
    return frame


def _add_components(scene: NSQScene, document: Json, block: Json, materials: Materials, folder: Path) -> None:
    """Add v1 components and raw surfaces in the file's component order."""
    components = {spec["name"]: spec for spec in document.get("components", [])}
    surfaces = {spec["name"]: (spec, f"nsq_gpu.surfaces[{index}]") for index, spec in enumerate(block.get("surfaces", []))}
    overrides = block.get("overrides", {})
    for name in block.get("order") or [*components, *surfaces]:
        if name in components:
            _add_compound(scene, components[name], overrides, materials, folder)
        else:
            scene.add_component(name, _raw_surface(*surfaces[name], materials, folder))


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
            config[slot] = _surface_config(chosen[0], f'nsq_gpu.overrides["{name}.{parts[0]}"]', folder)
    if "reflectance" in config:
        config["reflectance"] = reflectance(config["reflectance"])
    if kind == "lens":
        scene.add_lens(name, _frame(spec["cs"]), LensConfig(**config))
    elif kind == "doublet":
        scene.add_doublet(name, _frame(spec["cs"]), DoubletConfig(**config))
    else:
        scene.add_mirror(name, _frame(spec["cs"]), MirrorConfig(**config))


def _surface_config(spec: Json, place: str, folder: Path) -> SurfaceConfig:
    interaction = spec.get("interaction")
    return SurfaceConfig(
        **_scattering(spec, place, folder),
        coating=_coating(spec.get("coating")),
        interaction=InteractionType(interaction) if interaction else None,
        aperture_radius=spec.get("aperture_radius"),
        reflectance=reflectance(spec.get("reflectance")),
    )


def reflectance(value: Any) -> Any:
    """Turn a reflectance into what Optiland takes: a number, or a function of the wavelength [um]."""
    if not isinstance(value, dict):
        return value
    wavelengths, values = value["wavelengths"], value["values"]
    return lambda wavelength: _interpolate(wavelength, wavelengths, values)


def _coating(spec: Json | None) -> BaseCoating | None:
    if spec is None:
        return None
    if spec["type"] == "tabulated":
        from nsq_gpu.coatings import TabulatedCoating

        return TabulatedCoating(*(spec[key] for key in ("wavelengths", "angles", "reflectance", "transmittance", "reflectance_back",
                                                        "transmittance_back")))
    if isinstance(spec["reflectance"], dict) or isinstance(spec["transmittance"], dict):
        raise ValueError("Optiland has no coating that varies with the wavelength; give numbers")
    return SimpleCoating(transmittance=spec["transmittance"], reflectance=spec["reflectance"])


def _scattering(spec: Json, place: str, folder: Path) -> Json:
    """Return the ``bsdf`` and the ``scatter_fraction`` of a surface."""
    bsdf, fraction = _bsdf(spec.get("bsdf"), f"{place}.bsdf", folder), spec.get("scatter_fraction")
    if fraction != "tis":
        return {"bsdf": bsdf, "scatter_fraction": 1.0 if fraction is None else fraction}
    if bsdf is None:
        raise ValueError("scatter_fraction is 'tis', the total integrated scatter of a bsdf, and the surface has none")
    from nsq_gpu.bsdf import by_tis

    return by_tis(bsdf)


def _bsdf(spec: Json | None, place: str, folder: Path) -> Any:
    if spec is None:
        return None
    parameters = {key: value for key, value in spec.items() if key != "type"}
    if spec["type"] == "tabulated":
        return _tabulated(spec, folder)
    if spec["type"] == "k_correlation":
        from nsq_gpu.bsdf import KCorrelation

        return KCorrelation(**parameters)
    if spec["type"] == "measured":
        from nsq_gpu.bsdf import MeasuredBSDF

        path = parameters.pop("path", None)
        return MeasuredBSDF(**parameters) if path is None else MeasuredBSDF.from_file(folder / path)
    return _class_of(spec, _BSDFS, place)(**parameters)


def _tabulated(spec: Json, folder: Path) -> TabulatedBSDF:
    """Return a tabulated model; Optiland reads only files, so inline values go through one."""
    fraction = spec.get("transmissive_fraction", 0.0)
    if spec.get("path") is not None:
        return TabulatedBSDF(folder / spec["path"], fraction)
    rows = [f"{incident!r},{scattered!r},{value!r}"
            for incident, values in zip(spec["theta_i"], spec["bsdf"], strict=True)
            for scattered, value in zip(spec["theta_s"], values, strict=True)]
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "bsdf.csv"
        path.write_text("\n".join(rows), encoding="utf-8")
        return TabulatedBSDF(path, fraction)


def _raw_surface(spec: Json, place: str, materials: Materials, folder: Path) -> BaseComponent:
    frame, shape, name = _frame(spec["cs"]), _shape(spec["shape"], f"{place}.shape", folder), spec["name"]
    front = materials.shared(spec.get("material_front"))
    if spec["interaction"] not in ("refractive", "reflective"):
        return AbsorbingComponent(frame, shape, front, name=name)
    scatter = _scattering(spec, place, folder)
    if spec["interaction"] == "refractive":
        back = materials.shared(spec.get("material_back"))
        return RefractiveComponent(frame, shape, front, back, name=name, coating=_coating(spec.get("coating")),
                                   **scatter)
    # The file gives either of the two; Optiland takes a coating as a reflectance.
    coating = _coating(spec.get("coating"))
    reflects = reflectance(spec["reflectance"]) if coating is None else coating
    return ReflectiveComponent(frame, shape, reflects, material_front=front, name=name, **scatter)


def _shape(spec: Json, place: str, folder: Path) -> Any:
    parameters = {key: value for key, value in spec.items() if key != "type" and value is not None}
    if spec["type"] == "plane":
        return FinitePlaneGeometry(**parameters) if parameters else PlaneGeometry()
    if spec["type"] == "mesh":
        return _mesh(spec, folder)
    if spec["type"] == "clipped_conic":
        from nsq_gpu.shapes import ClippedConic

        return ClippedConic(spec["radius"], spec.get("conic", 0.0), spec["aperture_radius"], _aperture(spec["aperture"]))
    if parameters.get("aperture") is not None:
        parameters["aperture"] = _aperture(parameters["aperture"])
    if spec["type"] in ("even_asphere", "odd_asphere", "polynomial", "chebyshev", "zernike"):
        from nsq_gpu.shapes import Chebyshev, EvenAsphere, OddAsphere, Polynomial, Zernike

        kinds: dict[str, Any] = {"even_asphere": EvenAsphere, "odd_asphere": OddAsphere, "polynomial": Polynomial,
                                 "chebyshev": Chebyshev, "zernike": Zernike}
        return kinds[spec["type"]](**{"conic": 0.0, **parameters})
    if spec["type"] in ("biconic", "toroidal"):
        from nsq_gpu.shapes import Biconic, Toroidal

        return (Biconic if spec["type"] == "biconic" else Toroidal)(**parameters)
    return _class_of(spec, _SHAPES, place)(**parameters)


def _aperture(spec: Json) -> Any:
    from nsq_gpu.shapes import Aperture

    given = {key: value for key, value in spec.items() if value is not None}
    if "vertices" in given:
        given["vertices"] = tuple(map(tuple, given["vertices"]))
    if "parts" in given:
        given["parts"] = tuple(map(_aperture, given["parts"]))
    return Aperture(**given)


def _mesh(spec: Json, folder: Path) -> MeshGeometry:
    # Optiland needs trimesh for meshes alone.
    try:
        import trimesh
    except ImportError:
        from nsq_gpu.arguments import missing

        raise missing("trimesh", "mesh", "Optiland's meshes need") from None

    if spec.get("path") is not None:
        mesh = trimesh.load_mesh(folder / spec["path"], process=False)
    else:
        mesh = trimesh.Trimesh(spec["vertices"], spec["faces"], process=False)
    if spec.get("scale") is not None:
        mesh.apply_scale(spec["scale"])
    return MeshGeometry(mesh)


def _add_source(scene: NSQScene, spec: Json, place: str, materials: Materials, folder: Path) -> None:
    frame, medium, lumens = _frame(spec["cs"]), spec.get("medium"), spec.get("total_flux_lumens")
    around = None if medium is None else materials.shared(medium)
    if spec["type"] == "tabulated":
        scene.source_registry.add(spec["name"], _lamp(spec, frame, around, folder))
        return
    if spec["type"] == "rays":
        from nsq_gpu.sources import RaySource

        given = {key: spec[key] for key in ("order", "scale", "total_flux", "total_flux_lumens") if spec.get(key) is not None}
        rays = RaySource.from_file(folder / spec["file"], cs=frame, spectrum=Spectrum(**spec["spectrum"]), medium=around, **given)
        scene.source_registry.add(spec["name"], rays)
        return
    if lumens is not None:
        from nsq_gpu.photometry import watts

        # Optiland's own conversion has V in steps of 10 nm.
        spec = {**spec, "total_flux": watts(lumens, Spectrum(**spec["spectrum"]))}
    if spec["type"] != "pupil":
        scene.add_source(spec["name"], frame, _source_config(spec, place, materials))
    else:
        from nsq_gpu.sources import Aim, PupilSource

        numbers = {key: spec[key] for key in ("total_flux", "beam_radii", "chief", "pupil_radii") if key in spec}
        aimed = [Aim(**aim) for aim in spec.get("aimed", ())]
        pupil = PupilSource(frame, Spectrum(**spec["spectrum"]), **numbers, aimed=aimed, medium=around)
        scene.source_registry.add(spec["name"], pupil)
    if lumens is not None:
        # For the exporter.
        source: Any = scene.source_registry.get(spec["name"])
        source.total_flux_lumens = lumens


def _lamp(spec: Json, frame: CoordinateSystem, medium: NSQMaterial | None, folder: Path) -> Any:
    from nsq_gpu.sources import TabulatedSource

    others = ("type", "name", "cs", "spectrum", "medium", "file")
    given = {key: value for key, value in spec.items() if key not in others and value is not None}
    spectrum = Spectrum(**spec["spectrum"])
    if spec.get("file") is None:
        return TabulatedSource(frame, spectrum, **given, medium=medium)
    # The scene's area is in the place of the file's.
    area = {key: given[key] for key in ("width", "height", "radius") if key in given}
    flux = {key: given[key] for key in ("total_flux", "total_flux_lumens") if key in given}
    lamp = TabulatedSource.from_file(folder / spec["file"], cs=frame, spectrum=spectrum, opening=not area, medium=medium, **flux)
    for key, value in area.items():
        setattr(lamp, key, float(value))
    return lamp


def _source_config(spec: Json, place: str, materials: Materials) -> Any:
    config = _class_of(spec, _SOURCES, place)
    fields = {field.name for field in dataclasses.fields(config)} - {"spectrum", "medium", "total_flux_lumens"}
    medium = spec.get("medium")
    return config(
        spectrum=Spectrum(**spec["spectrum"]),
        medium=None if medium is None else materials.shared(medium),
        **{key: spec[key] for key in fields & spec.keys()},
    )


def _add_detector(scene: NSQScene, spec: Json, place: str, extra: Json) -> None:
    frame = _frame(spec["cs"])
    if not spec.get("sphere"):
        scene.add_detector(spec["name"], frame, _detector_config(spec, place, extra))
    else:
        from nsq_gpu.detectors import SphereFarField

        given = {key: spec[key] for key in ("num_bins_theta", "num_bins_phi", "absorb") if spec.get(key) is not None}
        scene.detector_registry.add(spec["name"], SphereFarField(frame, **given))
    if spec.get("color") is not None:
        # For the exporter.
        live: Any = scene.detector_registry.get(spec["name"])
        live.color = spec["color"]


def _detector_config(spec: Json, place: str, extra: Json) -> Any:
    # The one pair of names that differs between v1 and the config.
    names = {"num_bins_theta": "num_theta", "num_bins_phi": "num_phi"} if spec["type"] == "far_field" else {}
    parameters = {names.get(key, key): value for key, value in spec.items()
                  if key not in ("type", "name", "cs", "sphere", "color") and value is not None}
    return _class_of(spec, _DETECTORS, place)(**parameters, **extra)
