"""Mounts and baffles of a CAD program's STEP file, as meshes in a scene.

>>> scene = nsq_gpu.from_optic(CookeTriplet())
>>> nsq_gpu.from_step("mount.step", {"barrel*": "black anodised aluminium", "vane*": "black paint", "lens*": None}, scene=scene)

Lenses stay lenses: a mesh's facets of width c on a radius R tilt its normals by c / (2 R), which is milliradians. That is nothing to a
black barrel, and too much for an image. ``pip install cascadio trimesh`` is needed.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
import re
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.configs import InteractionType, SurfaceConfig
from optiland.nonsequential.components.reflective import ReflectiveComponent

from nsq_gpu.arguments import check_mapping, check_scene, near, wrong_kind
from nsq_gpu.errors import MissingLibraryError, NsqGpuWarning, UnsupportedSceneError, UsageError, warn
from nsq_gpu.finishes import finish

#: A GLB file is in metres.
_MM = 1000.0
#: Faces that meet at less than this angle are taken as flat [rad].
_FLAT = 1e-4
_EXAMPLE = '{"barrel*": "black paint", "lens*": None}'


def from_step(path: str | os.PathLike[str], surfaces: Mapping[str, Any], *, scene: NSQScene | None = None, scale: float = 1.0,
              tolerance: float = 0.05, angular_tolerance: float = 0.1) -> NSQScene:
    """Add the parts of a STEP file to a scene, each as a mesh that reflects, scatters or absorbs.

    A part stands where its assembly puts it, in mm whatever the file's unit is. Its component has its name, and moves by that:
    ``barrel.y``. A second part of a name gets a number: ``screw 2``.

    Args:
        path: The STEP file (.step, .stp).
        surfaces: A finish by a pattern of names, such as ``"barrel*"`` (fnmatch: ``*``, ``?``, ``[ab]``; case counts). The first
            pattern that fits counts. A finish is a name of :func:`nsq_gpu.finish`, keywords or a SurfaceConfig of Optiland with a
            reflectance, ``"absorbing"``, or None, which leaves the part out. Each part needs a pattern.
        scene: The scene that the parts are added to; None makes one.
        scale: What all lengths are multiplied by.
        tolerance: Largest distance of a facet from the part's face [mm of the file].
        angular_tolerance: Largest angle between facets of a curved face [rad].

    Returns:
        The scene.

    Raises:
        UsageError: The file cannot be read, a part has no pattern, a pattern no part, or an argument makes no sense.
        UnknownNameError: There is no finish of a name.
        UnsupportedSceneError: A part is to refract.
        MissingLibraryError: cascadio or trimesh is not installed.
        NsqGpuWarning: A curved part is to mirror, and by how much its facets tilt the normals.
    """
    check_mapping("surfaces", surfaces, _EXAMPLE)
    if scene is not None:
        check_scene(scene)
    configs = {pattern: _config(pattern, given) for pattern, given in surfaces.items()}
    found = _parts(path, scale, tolerance, angular_tolerance)
    chosen = _chosen(path, found, configs)
    scene = NSQScene() if scene is None else scene
    taken = {*scene.component_names, *scene.source_names, *scene.detector_names}
    for part, config in chosen:
        if config is None:
            continue
        name = _unused(part.name, taken)
        scene.add_component(name, _component(name, part.mesh, config, angular_tolerance))
        taken.add(name)
    return scene


def parts(path: str | os.PathLike[str], *, scale: float = 1.0, tolerance: float = 0.05, angular_tolerance: float = 0.1) -> dict[str, Any]:
    """Return the parts of a STEP file by name: meshes of trimesh, placed, in mm.

    >>> for name, mesh in nsq_gpu.step.parts("mount.step").items():
    ...     print(name, mesh.extents, mesh.volume)

    The arguments and errors are as in :func:`from_step`.
    """
    named: dict[str, Any] = {}
    for part in _parts(path, scale, tolerance, angular_tolerance):
        named[_unused(part.name, named)] = part.mesh
    return named


@dataclasses.dataclass
class _Part:
    #: Its name in the assembly, and as a product, which several parts may share.
    name: str
    product: str
    #: In mm, where the assembly puts it.
    mesh: Any

    def fits(self, pattern: str) -> bool:
        return fnmatchcase(self.name, pattern) or fnmatchcase(self.product, pattern)


def _parts(path: str | os.PathLike[str], scale: float, tolerance: float, angular_tolerance: float) -> list[_Part]:
    for name, value in (("scale", scale), ("tolerance", tolerance), ("angular_tolerance", angular_tolerance)):
        if not isinstance(value, int | float | np.number) or not 0.0 < value < float("inf"):
            raise UsageError(f"{name} is {value!r}; give a number above 0")
    cascadio, trimesh = _libraries()
    if Path(path).suffix.lower() not in (".step", ".stp"):
        raise UsageError(f"{os.fspath(path)!r} is no STEP file by its name; give one that ends in .step or .stp")
    try:
        content = Path(path).read_bytes()
    except OSError as error:
        raise UsageError(f"{os.fspath(path)!r} cannot be read: {error.strerror}") from error
    glb = cascadio.load(content, file_type="step", tol_linear=float(tolerance), tol_angular=float(angular_tolerance))
    if not glb:
        raise UsageError(f"{os.fspath(path)!r} has no solid or face that cascadio can read; is it a STEP file?")
    given = _names(glb)
    tree = trimesh.load_scene(io.BytesIO(glb), file_type="glb", process=False)
    found = []
    for node in tree.graph.nodes_geometry:
        placement, geometry = tree.graph[node]
        mesh = trimesh.Trimesh(tree.geometry[geometry].vertices, tree.geometry[geometry].faces, process=False)
        # Each face of the solid has its own corners: edges would leak.
        mesh.merge_vertices()
        mesh.update_faces(mesh.nondegenerate_faces())
        mesh.apply_transform(placement)
        mesh.apply_scale(_MM * float(scale))
        product = _given(geometry, given)
        # Where the assembly names no part, names are these.
        name = product if re.fullmatch(r"=>.*|NAUO\d*", node) else _given(node, given)
        found.append(_Part(name, product, mesh))
    # trimesh turns their order round.
    found.reverse()
    if not found:
        raise UsageError(f"{os.fspath(path)!r} has no solid or face")
    return found


def _names(glb: bytes) -> set[str]:
    """Return the names of a GLB file: its first chunk is JSON, after 12 bytes of the file's head and 8 of its own."""
    document = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    return {entry["name"] for key in ("nodes", "meshes") for entry in document.get(key, ()) if "name" in entry}


def _given(name: str, given: set[str]) -> str:
    """Return a name as the file has it; trimesh numbers equal ones."""
    return name if name in given else re.sub(r"_\d+$", "", name)


def _libraries() -> tuple[Any, Any]:
    try:
        import cascadio
        import trimesh
    except ImportError as error:
        raise MissingLibraryError(f"{error.name} is not installed, and STEP files need it: pip install cascadio trimesh") from None
    return cascadio, trimesh


def _chosen(path: str | os.PathLike[str], found: list[_Part], configs: Mapping[str, SurfaceConfig | None]) -> list[tuple[_Part, Any]]:
    """Return each part with its finish; nothing is left out that nobody left out."""
    names = list(dict.fromkeys(part.name for part in found))
    for pattern in configs:
        if not any(part.fits(pattern) for part in found):
            raise UsageError(f"surfaces: no part of {os.fspath(path)!r} fits the pattern {pattern!r}; {near(pattern.strip('*?'), names)}")
    chosen, without = [], []
    for part in found:
        pattern = next((pattern for pattern in configs if part.fits(pattern)), None)
        if pattern is None:
            without.append(part.name)
        else:
            chosen.append((part, configs[pattern]))
    if without:
        listed = ", ".join(map(repr, dict.fromkeys(without)))
        raise UsageError(f"surfaces: no pattern fits {listed}; give each a finish, or None to leave it out: {_EXAMPLE}")
    return chosen


def _config(pattern: str, given: Any) -> SurfaceConfig | None:
    """Return what a finish is to Optiland; None leaves a part out."""
    what = f"surfaces[{pattern!r}]"
    if given is None:
        return None
    if given == "absorbing" or given is InteractionType.ABSORBING:
        return SurfaceConfig(interaction=InteractionType.ABSORBING)
    if isinstance(given, str):
        return SurfaceConfig(**finish(given))
    if isinstance(given, Mapping):
        try:
            given = SurfaceConfig(**given)
        except TypeError as error:
            raise UsageError(f"{what}: these are no keywords of SurfaceConfig: {error}") from None
    if not isinstance(given, SurfaceConfig):
        raise wrong_kind(what, given, "give the name of a finish, keywords of SurfaceConfig, 'absorbing', or None to leave the part out")
    if given.interaction is InteractionType.ABSORBING:
        return given
    if given.interaction is InteractionType.REFRACTIVE or given.coating is not None or given.reflectance is None:
        raise UnsupportedSceneError(
            f"{what}: it has no reflectance, so the part would refract, and a mesh cannot: facets of width c on a radius R tilt its normals "
            "by c / (2 R). Give a finish that reflects or 'absorbing', or None to leave the part out, and add the lens as a lens: "
            "nsq_gpu.from_file, or scene.add_lens")
    if given.aperture_radius is not None:
        raise UsageError(f"{what}: a mesh has no aperture_radius")
    return given


def _component(name: str, mesh: Any, config: SurfaceConfig, angular_tolerance: float) -> Any:
    from optiland.nonsequential.components.geometry.mesh.mesh_geometry import MeshGeometry

    shape = MeshGeometry(mesh)
    if config.interaction is InteractionType.ABSORBING:
        return AbsorbingComponent(CoordinateSystem(), shape, name=name)
    if config.bsdf is None or config.scatter_fraction < 1.0:
        tilt = _tilt(mesh, angular_tolerance)
        if tilt > _FLAT:
            warn(f"{name} mirrors, and its facets tilt its normals by up to {1e3 * tilt:.2g} mrad, so mirrored rays go wrong by twice that; "
                 "a smaller angular_tolerance lessens it, a mirror of Optiland's own has none", NsqGpuWarning)
    return ReflectiveComponent(CoordinateSystem(), shape, config.reflectance, config.bsdf, name=name, scatter_fraction=config.scatter_fraction)


def _tilt(mesh: Any, angular_tolerance: float) -> float:
    """Return by how much facets of curved faces tilt the normals at most [rad]; edges between faces do not count."""
    angles = np.asarray(mesh.face_adjacency_angles)
    curved = angles[(angles > _FLAT) & (angles < 1.5 * angular_tolerance)]
    return float(0.5 * curved.max()) if len(curved) else 0.0


def _unused(name: str, taken: Any) -> str:
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name} {number}"
    return free
