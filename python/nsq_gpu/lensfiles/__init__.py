"""Lens files of Zemax, CODE V and OSLO: every card is carried, refused by its line, or remarked.

>>> from nsq_gpu.lensfiles import read_lens
>>> optic, reading = read_lens("lens.zmx")
>>> print("\\n".join(reading.remarks))
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from optiland.coatings import BaseCoating
from optiland.materials import BaseMaterial

from nsq_gpu.arguments import wrong_kind
from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.lensfiles import codev, oslo, zemax
from nsq_gpu.lensfiles.cards import Reading, decode
from nsq_gpu.lensfiles.glasses import plain
from nsq_gpu.lensfiles.system import System

#: What reads the text of a file, by the end of its name.
_TEXT: dict[str, Callable[[str, Reading], Any]] = {".zmx": zemax.read, ".seq": codev.read, ".len": oslo.read}
#: Ends of the names of files that are lenses.
SUFFIXES = (*_TEXT, ".json")
_LAMP = "a lamp, and no lens: read it by nsq_gpu.sources.TabulatedSource.from_file"
_SOLID = "a solid: nsq_gpu.from_step reads mounts and baffles as meshes; a lens needs its radii, from a lens file"
#: What to do with other files.
_INSTEAD = {
    ".zar": "unpack the archive, and read the .zmx file in it", ".zos": "save the lens as .zmx", ".zmf": "a catalogue of lenses: save one as .zmx",
    ".lens": "save the lens as CODE V's .seq", ".roa": "save the lens of rayoptics as .zmx or .seq", ".agf": "a catalogue of glasses, and no lens",
    ".stl": "a mesh: build a scene with it", ".step": _SOLID, ".stp": _SOLID, ".json5": "a scene: nsq-gpu trace reads it",
    ".ies": _LAMP, ".ldt": _LAMP}


def read_lens(path: str | os.PathLike[str], *, unknown: str = "refuse", glasses: Mapping[str, Any] | None = None,
              coatings: Mapping[str, Any] | None = None) -> tuple[Any, Reading]:
    """Return the Optic of a file, and what was to be said while it was read.

    Args:
        path: A file whose name ends with .zmx (Zemax), .seq (CODE V), .len (OSLO) or .json (Optiland).
        unknown: What becomes of an unknown card of a surface, and of a glass that no catalogue has: ``"refuse"``, or ``"remark"``,
            which leaves the card out, and takes the glass's nd and Vd where the file states them.
        glasses: Materials of Optiland for names of glasses.
        coatings: Coatings of Optiland for names of coatings.

    Raises:
        UsageError: The file is no lens, or cannot be read; with the line.
        UnsupportedSceneError: A card changes the light, and cannot be carried; with the line.
    """
    if not isinstance(path, str | os.PathLike):
        raise wrong_kind("path", path, "give the path of a lens file")
    path = Path(path)
    if unknown not in ("refuse", "remark"):
        raise UsageError(f"unknown is {unknown!r}; give 'refuse' or 'remark'")
    for what, given, kind in (("glasses", glasses, BaseMaterial), ("coatings", coatings, BaseCoating)):
        if not isinstance(given, Mapping | None) or not all(isinstance(name, str) and isinstance(value, kind) for name, value in (given or {}).items()):
            raise UsageError(f"{what} is {given!r}; give a dictionary of names and Optiland's {what}, {kind.__name__}")
    _check_path(path)
    reading = Reading(path, unknown, {plain(name): material for name, material in (glasses or {}).items()},
                      {name.upper(): coating for name, coating in (coatings or {}).items()})
    if path.suffix.lower() == ".json":
        return _optilands(path), reading
    try:
        found = _TEXT[path.suffix.lower()](decode(path), reading)
        if isinstance(found, System):
            found.check(reading)
            numbers = [surface.number for surface in found.surfaces]
            if numbers != list(range(len(numbers))):
                others = ", ".join(f"surface {index} is {number}" for index, number in enumerate(numbers) if index != number)
                reading.remark(None, f"coordinate breaks are no surfaces of the report. In the file its {others}")
            found = found.optic(reading)
    except NsqGpuError:
        raise
    except (ValueError, ArithmeticError, LookupError, TypeError, NotImplementedError) as error:
        raise UsageError(f"{path}: cannot read it as a lens: no optic of Optiland can be made of it: {type(error).__name__}: {error}") from error
    return found, reading


def _check_path(path: Path) -> None:
    suffix = path.suffix.lower()
    if path.is_dir():
        inside = sorted(item.name for item in path.iterdir() if item.suffix.lower() in SUFFIXES[:-1])
        hint = f"such as {path / inside[0]}" if inside else f"whose name ends with {', '.join(SUFFIXES)}"
        raise UsageError(f"{path}: this is a folder; name a lens file in it, {hint}")
    if suffix not in SUFFIXES:
        instead = f" ({_INSTEAD[suffix]})" if suffix in _INSTEAD else ""
        raise UsageError(f"{path}: a lens is read from a file whose name ends with {', '.join(SUFFIXES)}{instead}")
    if not path.is_file():
        raise UsageError(f"{path}: there is no such file")


def _optilands(path: Path) -> Any:
    from optiland.fileio import load_optiland_file

    try:
        document = json.loads(decode(path))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: this is no JSON: {error}") from error
    if isinstance(document, dict) and ("components" in document or "nsq_gpu" in document or "surfaces" in document and "sources" in document):
        raise UsageError(f"{path}: this is a scene, and no lens; call nsq_gpu.load_scene({str(path)!r}), or nsq-gpu trace {path}")
    try:
        return load_optiland_file(str(path))
    except Exception as error:
        raise UsageError(f"{path}: Optiland cannot read it as an optic: {type(error).__name__}: {error}") from error
