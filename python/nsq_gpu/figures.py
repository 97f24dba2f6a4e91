"""How even, how wide and how strong the light of a result is, and its far field as a file: ``nsq-gpu figures`` and ``export``."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nsq_gpu.binary import find_binary
from nsq_gpu.display import Displayed, Summary, number
from nsq_gpu.errors import UsageError
from nsq_gpu.process import answer, run

if TYPE_CHECKING:
    from nsq_gpu.results import Result

Json = dict[str, Any]

#: Options of the command by regions of each kind: how many numbers one has, and an example.
_REGIONS = {"regions": ("region", 4, "[(-200, 200, -100, 100)]"), "circles": ("circle", 3, "[(0, 0, 50)]"),
            "cones": ("cone", 1, "[30]")}
#: Options of the command that its messages name, as this package has them.
_NAMES = {"--photometric": "photometric=True", "--forward": "forward=True", "--overwrite": "overwrite=True", "--detector": "detector",
          "--region": "regions", "--circle": "circles", "--cone": "cones"}


class Figure(NamedTuple):
    """A figure of the light."""

    value: float
    #: Standard error, in the unit of the value; None if it is not known.
    standard_error: float | None
    #: About how much noise has added to the value; None if that is not known. A maximum is too high, a minimum too low.
    noise_bias: float | None


class Region(NamedTuple):
    """A part of a detector, and its figures."""

    #: ``"Rectangle"`` or ``"Ellipse"``; a cone is one of these.
    outline: str
    #: Unit of the centre, and of half of the width and of the height: mm, or deg of a cone.
    unit: str
    centre: tuple[float, float]
    half: tuple[float, float]
    figures: dict[str, Figure]

    def __str__(self) -> str:
        (x, y), (width, height) = self.centre, self.half
        if self.outline == "Rectangle":
            return f"x {x - width:g} to {x + width:g} mm, y {y - height:g} to {y + height:g} mm"
        return f"within {width:g} {self.unit} of " + (f"({x:g}, {y:g}) mm" if self.unit == "mm" else "the axis")


@dataclass(frozen=True)
class DetectorFigures:
    """The figures of a detector, by their names, such as ``min_over_mean``; names say where units are others than here."""

    #: Unit of ``min``, ``mean`` and ``max``.
    unit: str
    flux_unit: str
    #: Columns and rows of the cells over which figures were found.
    cells: tuple[int, int]
    whole: dict[str, Figure]
    #: Parts that were asked for, in their order: rectangles before circles.
    regions: list[Region]
    #: What noise does to the figures.
    remarks: list[str]

    def unit_of(self, name: str) -> str:
        """Return the unit of a figure by its name; empty for a ratio."""
        given = {"flux": self.flux_unit, **dict.fromkeys(("min", "mean", "max"), self.unit)}
        return given.get(name, next((unit for unit in ("mm", "deg") if name.endswith(f"_{unit}")), ""))


class Figures(Displayed, dict[str, DetectorFigures]):
    """Figures by detector, shown as a table."""

    def _summary(self) -> Summary:
        rows = [[name, part, label, number(figure.value), number(figure.standard_error, 2), of_detector.unit_of(label)]
                for name, of_detector in self.items()
                for part, figures in (("", of_detector.whole), *((str(region), region.figures) for region in of_detector.regions))
                for label, figure in figures.items()]
        cells = ", ".join(f"{name} in {found.cells[0]} x {found.cells[1]} cells" for name, found in self.items())
        notes = [f"{name}: {remark}" for name, found in self.items() for remark in found.remarks]
        return Summary(f"Figures: {cells}", ["", "part", "figure", "value", "error", "unit"], rows, notes=notes)


def figures(result: Result, detector: str | None, regions: Mapping[str, Sequence[Any]], cells: Sequence[int] | None,
            binary: str | None) -> Figures:
    """Return the figures of a result; :meth:`nsq_gpu.results.Result.figures` says how."""
    arguments = [] if detector is None else [f"--detector={detector}"]
    for name, given in regions.items():
        option, count, example = _REGIONS[name]
        arguments += [f"--{option}={text}" for text in _written(name, given, count, example)]
    if cells is not None:
        arguments += [f"--cells={text}" for text in _written("cells", [cells], 2, "(16, 8)")]
    with _saved(result) as folder:
        found = answer([find_binary(binary), "figures", "--json", *arguments, "--", folder])
    return Figures({name: _of_detector(entry) for name, entry in found["detectors"].items()})


def export_lamp(result: Result, path: str | os.PathLike[str], detector: str | None, forward: bool, overwrite: bool,
                binary: str | None) -> None:
    """Write a far field as the file of a lamp; :meth:`nsq_gpu.results.Result.export_lamp` says how."""
    ending = Path(path).suffix.lower() if isinstance(path, str | os.PathLike) else ""
    if ending not in (".ies", ".ldt"):
        raise UsageError(f"path is {path!r}; give the path of a lamp's file, whose name ends with .ies or .ldt")
    arguments = [f"--{ending[1:]}={os.fspath(path)}", *["--forward"] * forward, *["--overwrite"] * overwrite]
    arguments += [] if detector is None else [f"--detector={detector}"]
    with _saved(result) as folder:
        run([find_binary(binary), "export", *arguments, "--", folder])


@contextmanager
def _saved(result: Result) -> Iterator[str]:
    """Save a result for the command, and answer in this package's words what it refuses."""
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as folder:
        result.save(folder)
        try:
            yield folder
        except UsageError as error:
            said = str(error)
            for option, name in _NAMES.items():
                said = said.replace(option, name)
            raise UsageError(said, stderr=error.stderr) from None


def _written(name: str, given: Any, count: int, example: str) -> list[str]:
    """Return regions as the command takes them."""
    try:
        parts = [[float(number) for number in (part if count > 1 else [part])] for part in given]
    except (TypeError, ValueError):
        parts = [[]]
    if any(len(part) != count for part in parts):
        shown = given[0] if name == "cells" else given
        raise UsageError(f"{name} is {shown!r}; give numbers, such as {example}")
    return [",".join(f"{number:.17g}" for number in part) for part in parts]


def _of_detector(entry: Json) -> DetectorFigures:
    def named(found: Json) -> dict[str, Figure]:
        return {name: Figure(**figure) for name, figure in found.items()}

    unit = "deg" if entry["unit"] in ("cd", "W/sr") else "mm"
    regions = [Region(part["region"]["outline"], unit, tuple(part["region"]["centre"]), tuple(part["region"]["half"]),
                      named(part["figures"])) for part in entry["regions"]]
    return DetectorFigures(entry["unit"], entry["flux_unit"], tuple(entry["cells"]), named(entry["whole"]), regions, entry["remarks"])
