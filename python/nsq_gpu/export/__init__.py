"""Live scenes -> scene files that hold all that a trace depends on: Optiland's schema version 1 and the ``nsq_gpu``
block beside it. What a file cannot hold is refused by name (UnsupportedSceneError), never dropped.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from optiland.nonsequential import NSQScene
from optiland.nonsequential.ir.scene_ir import SamplingPolicy

from nsq_gpu import placing
from nsq_gpu.arguments import PARTS, check_scene
from nsq_gpu.export.components import components
from nsq_gpu.export.detectors import detectors
from nsq_gpu.export.materials import Media
from nsq_gpu.export.sources import sources, spectra
from nsq_gpu.export.values import Json, Wanted, drop_gradient, number, refuse_type, wanted_gradients
from nsq_gpu.scattering import keys_of_scene

#: Version of Optiland's schema that is written.
SCHEMA_VERSION = 1
#: Version of the ``nsq_gpu`` block that is written.
BLOCK_VERSION = 1


@dataclass(frozen=True)
class ExportedScene:
    """A scene as the content of a file, and how the file calls its surfaces, in the order of ``scene.surfaces``."""

    document: Json
    surface_labels: list[str]
    #: Tensors that want gradients, by the names of their numbers; a number of each name.
    wanted: dict[str, Any] = field(default_factory=dict)


def export_scene(scene: NSQScene, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a scene to a file which alone, given to the command ``nsq-gpu trace``, traces as the live scene does.

    Folders that are missing are made, as ``nsq-gpu trace -o`` makes them. The file appears whole or not at all.

    Args:
        scene: The live scene.
        path: The file. A file that exists already is kept, unless this process wrote it, or its text is the same.
        overwrite: True replaces a file that exists.

    Raises:
        UnsupportedSceneError: The scene holds something that no file can; nothing is written.
        UsageError: The place is taken.
        OSError: The file cannot be written.
    """
    text = to_json(export(scene).document)
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    placing.write(path, text, overwrite)


def to_json(document: Json, indent: int | None = 2) -> str:
    """Return a document as strict JSON."""
    return json.dumps(document, indent=indent, allow_nan=False) + "\n"


def export(scene: NSQScene) -> ExportedScene:
    """Return what :func:`export_scene` writes; a tensor that wants a gradient counts as its value."""
    check_scene(scene)
    media = Media(wavelength for spectrum in spectra(scene) for wavelength in spectrum["wavelengths"])
    parts = components(scene, media)
    source_list = sources(scene, media)
    detector_list, extras = detectors(scene)
    used = _media_in([parts.components, parts.surfaces, source_list])
    block = {
        # Glasses that are written by their names stand in no table.
        "media": {name: document for name, document in media.documents.items() if name in used},
        "surfaces": parts.surfaces,
        "overrides": parts.overrides,
        "order": parts.order if parts.order_needed() else None,
        "elements": elements(scene, {*parts.order, *(item["name"] for item in (*source_list, *detector_list))}),
        "detectors": extras,
        "sampling": sampling(getattr(scene, "sampling_policy", None), getattr(scene, "guided_light", None), keys_of_scene(scene)),
    }
    document: Json = {
        "nsq_schema_version": SCHEMA_VERSION,
        "components": parts.components,
        "sources": source_list,
        "detectors": detector_list,
    }
    filled = {key: value for key, value in block.items() if value}
    if filled:
        document["nsq_gpu"] = {"version": BLOCK_VERSION, **filled}
    return ExportedScene(document, parts.labels)


def export_wanted(scene: NSQScene) -> ExportedScene:
    """Return what :func:`export` does, and the tensors that want gradients, which :func:`export` takes as values.

    Where Optiland makes every constant such a tensor, a warning names those that get no gradient.

    Raises:
        UnsupportedSceneError: Such a tensor stands where no number has a name.
    """
    with wanted_gradients():
        found = export(scene)
        wanted = _named(found.document)
    return ExportedScene(found.document, found.surface_labels, wanted)


def _named(document: Json) -> dict[str, Any]:
    """Return the tensors of numbers that are wanted, by the numbers' names."""
    block = document.get("nsq_gpu", {})
    lists = [*(document[key] for key in ("components", "sources", "detectors")), block.get("surfaces", [])]
    entries = [(entry["name"], entry) for entries in lists for entry in entries]
    entries += [pair for key in ("media", "overrides") for pair in block.get(key, {}).items()]
    wanted = {}
    for name, entry in entries:
        label = f'"{name}"' if "." in name or "," in name else name
        for way, value in _wanted_in(entry):
            # The program looks for a key in these parts of an entry.
            inner = way[1:] if way[0] in PARTS and way[:2] != ["cs", "reference_cs"] else way
            # Places in lists end a name.
            is_place = [key.isdigit() for key in inner]
            if is_place != sorted(is_place):
                continue
            wanted[".".join([label, *inner])] = value
    named = {id(value) for value in wanted.values()}
    for _, value in _wanted_in(document):
        if id(value) not in named:
            drop_gradient(value.tensor, value.place, "the number has no name")
    return {name: value.tensor for name, value in wanted.items()}


def _wanted_in(tree: Any, way: list[str] | None = None) -> list[tuple[list[str], Wanted]]:
    """Return numbers that want gradients, with the keys, and the places in lists, that lead to them."""
    way = way or []
    if isinstance(tree, Wanted):
        return [(way, tree)]
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [found for key, item in items for found in _wanted_in(item, [*way, str(key)])]


def _media_in(tree: Any) -> set[str]:
    """Return the names of the media that some part of a document refers to."""
    if isinstance(tree, dict):
        own = {tree["name"]} if tree.get("type") == "medium" else set()
        return own.union(*map(_media_in, tree.values()))
    return set().union(*map(_media_in, tree)) if isinstance(tree, list) else set()


def elements(scene: NSQScene, known: set[str]) -> list[Json]:
    """Return what moves as one, ``scene.elements``, without what the scene no longer has.

    Where a face is gone, so is its element. Where something behind an element is gone, the spaces between elements have no name.
    """
    given = [dict(element) for element in getattr(scene, "elements", None) or ()]
    found = [element for element in given if known.issuperset(element["faces"])]
    behind = {name for element in given for name in element.get("behind") or ()}
    for element in found:
        if "parts" in element:
            element["parts"] = [name for name in element["parts"] if name in known]
        if len(found) < len(given) or not behind <= known:
            element.pop("behind", None)
    return found


def sampling(policy: Any, guide: Json | None = None, scattering: Json | None = None) -> Json | None:
    """Return a sampling policy with the light to which rays are guided, and how they scatter, unless it is the default."""
    guided = {**({} if guide is None else {"guide": guide}), **{key: value for key, value in (scattering or {}).items() if value}}
    if policy is None or policy == SamplingPolicy():
        return guided or None
    if type(policy) is not SamplingPolicy:
        raise refuse_type("scene.sampling_policy", "it", policy, "a SamplingPolicy")
    place = "sampling_policy"
    named = isinstance(policy.reflect_prob, str)
    return {
        "reflect_prob": policy.reflect_prob if named else number(policy.reflect_prob, f"{place}.reflect_prob"),
        "split_depth": int(policy.split_depth),
        "split_budget": number(policy.split_budget, f"{place}.split_budget"),
        "rr_start_flux": number(policy.rr_start_flux, f"{place}.rr_start_flux"),
        **guided,
    }
