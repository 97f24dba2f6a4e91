"""What a change does: two scenes by the same draws, their difference, and its own standard errors."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene

from nsq_gpu.arguments import check_scene, flag
from nsq_gpu.binary import find_binary
from nsq_gpu.display import Displayed, Summary, number
from nsq_gpu.errors import NsqGpuError, NsqGpuWarning, SceneError, TraceTimeoutError, warn, with_partial
from nsq_gpu.export import export, to_json
from nsq_gpu.export.values import whole_number
from nsq_gpu.few_rays import FewRays, few_rays, in_table
from nsq_gpu.process import run
from nsq_gpu.progress import Progress, Shown

Json = dict[str, Any]


@dataclass(frozen=True, repr=False)
class FluxDifference(Displayed):
    """A flux of both scenes [W]."""

    #: Its value in scene A.
    a: float
    #: Its value in scene B.
    b: float
    #: A - B.
    difference: float
    #: Standard error of the difference; NaN where it is not known.
    standard_error: float
    #: What is known of a difference that fewer than ten rays make; None else. The bound is one of its size.
    few_rays: FewRays | None = field(default=None, kw_only=True)

    def _summary(self) -> Summary:
        error = self.few_rays or f"error {number(self.standard_error, 2) or 'not known'}"
        return Summary(f"{type(self).__name__}: {number(self.difference, 4)} W, {error}; A {number(self.a)} W, B {number(self.b)} W")


@dataclass(frozen=True, repr=False)
class DetectorDifference(FluxDifference):
    """What a detector saw of both scenes: its flux [W], and its map in its own unit (W/mm^2, of far fields W/sr)."""

    #: Optiland's name of the kind.
    kind: str
    #: A - B cell by cell, in the shape of the detector's array; None if the scenes have no map of the same cells.
    map: np.ndarray | None
    #: Standard errors of ``map``.
    map_standard_error: np.ndarray | None
    #: The maps of A and of B.
    map_a: np.ndarray | None
    map_b: np.ndarray | None


@dataclass(frozen=True, repr=False)
class Difference(Displayed):
    """A - B by the same draws. Print it for a table."""

    #: By the detectors' names.
    detectors: dict[str, DetectorDifference]
    #: Lines of the ledger: ``launched``, ``detected``, ``absorbed``, ``escaped``, ...
    totals: dict[str, FluxDifference]
    #: Surfaces that took light, by their names.
    surfaces: dict[str, FluxDifference]
    #: The command's report, as it stands in ``report.json``.
    report: Json
    #: True if the traces were stopped. The difference is then of the rays that both scenes had traced.
    partial: bool = False

    @property
    def num_rays(self) -> int:
        """Rays of each scene."""
        return int(self.report["num_rays"])

    def _summary(self) -> Summary:
        rows = [[name, number(row.a, 7), number(row.b, 7), number(row.difference, 4),
                 str(row.few_rays or number(row.standard_error, 2))]
                for group in (self.detectors, self.totals, self.surfaces) for name, row in group.items()]
        title = f"Difference: {self.num_rays:,} rays of each scene" + (", stopped before the end" if self.partial else "")
        return Summary(title, ["", "A [W]", "B [W]", "A - B [W]", "error [W]"], rows)

    def __str__(self) -> str:
        rows = [(name, row) for group in (self.detectors, self.totals, self.surfaces) for name, row in group.items()]
        lines = [f"{'':<20}{'A [W]':>14}{'B [W]':>14}{'A - B [W]':>14}{'error [W]':>12}"]
        lines += [f"{name:<20}{row.a:>14.7g}{row.b:>14.7g}{row.difference:>14.4g}{row.standard_error:>12.2g}"
                  f"{in_table(row.few_rays)}"
                  for name, row in rows]
        return "\n".join(lines)


def diff(a: NSQScene | str | os.PathLike[str], b: NSQScene | str | os.PathLike[str], num_rays: int, *, seed: int = 0,
         max_depth: int | None = None, precision: str = "auto", sampler: str = "pcg", where: str | None = None,
         guide: bool = False, adapter: str | None = None, binary: str | os.PathLike[str] | None = None, timeout: float | None = None,
         progress: Progress = None) -> Difference:
    """Trace two scenes by the same draws; return A - B with standard errors of its own.

    What the change does not touch cancels to the bit, so that the error of the difference is far below either scene's
    own. Nothing need be differentiable: apertures, glasses, meshes and whole lenses may change.

    >>> found = nsq_gpu.diff(scene, changed, 1_000_000)
    >>> found.detectors["image"].difference, found.detectors["image"].standard_error

    Args:
        a: Scene A, or its file.
        b: Scene B, or its file: sources of the same names, and a detector of a name that A has as well.
        num_rays: Rays of each scene.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray. None takes what the scene needs: two for each surface that does not
            absorb, with a guide four, and at least 16.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        sampler: ``"pcg"`` or ``"sobol"``; with the latter, lines of the ledger have no errors.
        where: Keeps on detectors the light whose path matches: ``"reflections == 2"``.
        guide: True guides the rays of both scenes to rare light: ghosts of coated lenses, and what faint scatterers send.
        adapter: A part of the adapter's name.
        binary: Path of the program.
        timeout: Longest time [s].
        progress: As in :class:`nsq_gpu.NsqGpuBackend`.

    Raises:
        NsqGpuError: One of its subclasses, by what went wrong.
        Interrupted: Ctrl-C ended the traces; ``partial`` is the difference of the rays that both scenes had traced. So it
            is with TraceTimeoutError.
    """
    guide = flag("guide", guide)
    program = find_binary(binary)
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        files = [_file(scene, folder, side) for side, scene in (("A", a), ("B", b))]
        options = {"num-rays": whole_number("num_rays", num_rays), "seed": whole_number("seed", seed),
                   "max-depth": None if max_depth is None else whole_number("max_depth", max_depth),
                   "precision": precision, "sampler": sampler, "where": where, "adapter": adapter}
        command = [program, "diff", *files, *(f"--{key}={value}" for key, value in options.items() if value is not None),
                   *["--guide"] * guide, f"--output={folder / 'out'}", "--no-pictures", "--watch-stdin"]
        try:
            with Shown(progress) as shown:
                run([*command, f"--progress={shown.mode}"], timeout, shown, keeps=True)
        except SceneError as error:
            said = str(error)
            for side in "AB":
                said = said.replace(f"{folder / side}.json: ", f"the exported scene {side}: ")
            raise SceneError(said, stderr=error.stderr) from None
        except (KeyboardInterrupt, TraceTimeoutError) as stop:
            raise with_partial(stop, _read(folder / "out"))
        found = _read(folder / "out")
    if found is None:
        raise NsqGpuError(f"{program} ended without an error, and without a result: is it nsq-gpu?")
    return found


def _read(folder: Path) -> Difference | None:
    """Return the difference in a folder of results; None if there is none."""
    if not (folder / "report.json").exists():
        return None
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    for warning in report["scene_warnings"]:
        warn(warning, NsqGpuWarning)
    detectors = {key: _detector(entry, folder) for key, entry in report["detectors"].items()}
    return Difference(detectors, _fluxes(report["totals"]), _fluxes(report["surfaces"]), report, report["partial"])


def _file(scene: NSQScene | str | os.PathLike[str], folder: Path, side: str) -> str:
    """Return the file of a scene; a live one is written into ``folder``."""
    check_scene(scene, or_path=True)
    if not isinstance(scene, NSQScene):
        return os.fspath(scene)
    path = folder / f"{side}.json"
    path.write_text(to_json(export(scene).document, indent=None), encoding="utf-8")
    return str(path)


def _numbers(entry: Mapping[str, Any]) -> dict[str, float]:
    numbers = {key: entry[key] for key in ("a", "b", "difference", "standard_error")}
    return {key: np.nan if value is None else float(value) for key, value in numbers.items()}


def _fluxes(entries: Mapping[str, Json]) -> dict[str, FluxDifference]:
    return {name: FluxDifference(**_numbers(entry), few_rays=few_rays(entry)) for name, entry in entries.items()}


def _detector(entry: Json, folder: Path) -> DetectorDifference:
    with np.load(folder / entry["file"]) as arrays:
        found = {key: arrays[name] if name in arrays else None for key, name in
                 (("map", "difference"), ("map_standard_error", "standard_error"), ("map_a", "a"), ("map_b", "b"))}
    return DetectorDifference(**_numbers(entry), kind=entry["kind"], few_rays=few_rays(entry), **found)
