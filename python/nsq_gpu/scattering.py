"""Scattering that is drawn on purpose: how often rays scatter at a surface, and towards what. No expectation changes.

A mirror of a telescope scatters a four-hundredth of its light, and a millionth of that meets the detector. ``scatter_prob`` has
more rays scatter, and ``scatter_to`` sends a share of them towards the detector. Weights are exact.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nsq_gpu.errors import SceneError, UsageError, without_gradient

if TYPE_CHECKING:
    from nsq_gpu.export import ExportedScene

Json = dict[str, Any]

#: What a call takes as ``scatter_prob``: a probability of all surfaces, or by the surface's name.
ScatterProb = float | Mapping[str, float] | None
#: What a call takes as ``scatter_to``: entries as a scene file has them, or targets by the surface's name.
ScatterTo = Sequence[Mapping[str, Any]] | Mapping[str, Any] | None

#: Keys of ``nsq_gpu.sampling`` in a scene file, and attributes of a scene.
KEYS = ("scatter_prob", "scatter_to")
#: The numbers of each shape of a target: whether one is a vector.
_SHAPES = {"cone": {"axis": True, "half_angle_deg": False}, "sphere": {"center": True, "radius": False},
           "disk": {"center": True, "normal": True, "radius": False}}
_PROB = 'give a number between 0 and 1, such as 0.5, or numbers by surface, such as {"M1*": 0.5}'
_TO = 'give targets by surface, such as {"M1*": "image"}, or a list such as [{"surface": "M1*", "target": "image", "share": 0.5}]'


def keys_of(scatter_prob: ScatterProb, scatter_to: ScatterTo) -> Json:
    """Return both as a scene file has them, without what is None.

    Raises:
        UsageError: One of them has another form.
    """
    found: Json = {}
    if scatter_prob is not None:
        found["scatter_prob"] = _prob(scatter_prob)
    if scatter_to is not None:
        found["scatter_to"] = [_entry(f"scatter_to[{place}]", entry) for place, entry in enumerate(_listed(scatter_to))]
    return found


def keys_of_scene(scene: object) -> Json:
    """Return what a live scene says: its attributes ``scatter_prob`` and ``scatter_to``, which files have in ``nsq_gpu.sampling``."""
    return keys_of(*(getattr(scene, key, None) for key in KEYS))


def scattered(exported: ExportedScene, keys: Json) -> ExportedScene:
    """Return an exported scene with these keys in the place of its own; an empty one takes its own away."""
    return replace(exported, document=document_of(exported.document, keys)) if keys else exported


def without(exported: ExportedScene) -> ExportedScene:
    """Return an exported scene whose scattering is not drawn on purpose."""
    return scattered(exported, {"scatter_prob": {}, "scatter_to": []})


def document_of(document: Json, keys: Json) -> Json:
    """Return a document with these keys in the place of its own; an empty one takes its own away."""
    block = document.get("nsq_gpu", {"version": 1})
    sampling = {key: value for key, value in {**block.get("sampling", {}), **keys}.items()
                if key not in KEYS or value not in ({}, [], None)}
    block = {key: value for key, value in {**block, "sampling": sampling}.items() if key != "sampling" or sampling}
    return {**document, "nsq_gpu": block} if "nsq_gpu" in document or sampling else document


@contextmanager
def answering(keys: Json) -> Iterator[None]:
    """Answer by the argument what the program refuses of its key in the exported scene.

    Raises:
        UsageError: In the place of SceneError, where ``keys`` hold the key.
    """
    try:
        yield
    except SceneError as error:
        found = re.search(r"nsq_gpu\.sampling\.((scatter_prob|scatter_to)\b.*)", str(error), re.DOTALL)
        if found is None or found[2] not in keys:
            raise
        raise UsageError(found[1], stderr=error.stderr) from None


def is_file(scene: object) -> bool:
    """Return whether a scene is given by the path of its file."""
    return isinstance(scene, str | os.PathLike)


def file_of(scene: Any, keys: Json, folder: Path) -> Path:
    """Return the file of a scene with these keys; where the scene is a file already, and there are none, that file.

    Files that a scene file names are then embedded.
    """
    # The exporter reads this module.
    from nsq_gpu.arguments import check_scene
    from nsq_gpu.export import to_json

    check_scene(scene, or_path=True)
    if is_file(scene) and not keys:
        return Path(scene)
    path = folder / "scene.json"
    path.write_text(to_json(scattered(exported_of(scene), keys).document, indent=None), encoding="utf-8")
    return path


def exported_of(scene: Any) -> ExportedScene:
    """Return the content of a scene's file, whether the scene is live or a file."""
    from nsq_gpu.arguments import check_scene
    from nsq_gpu.export import export
    from nsq_gpu.loading import load_scene

    check_scene(scene, or_path=True)
    return export(load_scene(scene) if is_file(scene) else scene)


def _prob(given: Any) -> Any:
    if not isinstance(given, Mapping):
        return _number("scatter_prob", given, _PROB)
    if not all(isinstance(name, str) for name in given):
        raise UsageError(f"scatter_prob is {given!r}; {_PROB}")
    return {name: _number(f"scatter_prob[{name!r}]", value, _PROB) for name, value in given.items()}


def _listed(given: Any) -> list[Any]:
    """Return entries, of whichever form."""
    if isinstance(given, Mapping):
        if {"surface", "target"} <= given.keys():
            raise UsageError(f"scatter_to is one entry, {dict(given)!r}; give a list of it: scatter_to=[{dict(given)!r}]")
        return [{"surface": surface, "target": target} for surface, target in given.items()]
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise UsageError(f"scatter_to is {given!r}; {_TO}")
    return list(given)


def _entry(place: str, given: Any) -> Json:
    if not isinstance(given, Mapping) or not {"surface", "target"} <= given.keys():
        raise UsageError(f"{place} is {given!r}; {_TO}")
    unknown = [key for key in given if key not in ("surface", "target", "share")]
    if unknown:
        raise UsageError(f"{place} has {unknown[0]!r}; an entry has surface, target and share")
    if not isinstance(given["surface"], str):
        raise UsageError(f"{place}: surface is {given['surface']!r}; give a name, in which * stands for any characters")
    share = {} if given.get("share") is None else {"share": _number(f"{place}: share", given["share"], "give a number, such as 0.5")}
    return {"surface": given["surface"], "target": _target(f"{place}: target", given["target"]), **share}


def _target(place: str, given: Any) -> Any:
    if isinstance(given, str):
        return given
    shapes = given.keys() & _SHAPES.keys() if isinstance(given, Mapping) else set()
    if len(shapes) != 1 or len(given) != 1:
        raise UsageError(f'{place} is {given!r}; give the name of a detector or a surface, or one shape: {{"sphere": {{"center": '
                         '[x, y, z], "radius": r}}, {"disk": {"center", "normal", "radius"}}, {"cone": {"axis", "half_angle_deg"}}')
    (kind,), (shape,) = shapes, given.values()
    wanted = _SHAPES[kind]
    if not isinstance(shape, Mapping) or shape.keys() != wanted.keys():
        raise UsageError(f"{place}: {kind} is {shape!r}; it has {', '.join(wanted)}")
    return {kind: {key: (_vector if is_vector else _number)(f"{place}: {kind}: {key}", shape[key])
                   for key, is_vector in wanted.items()}}


def _number(place: str, given: Any, right: str = "give a number") -> float:
    value = without_gradient(place, given)
    try:
        found = np.nan if isinstance(value, str | bool) else float(value)
    except (TypeError, ValueError):
        found = np.nan
    if not np.isfinite(found):
        raise UsageError(f"{place} is {given!r}; {right}")
    return found


def _vector(place: str, given: Any) -> list[float]:
    try:
        parts = list(given)
    except TypeError:
        parts = []
    if isinstance(given, str) or len(parts) != 3:
        raise UsageError(f"{place} is {given!r}; give three numbers, such as [0, 0, -100]")
    return [_number(place, part) for part in parts]
