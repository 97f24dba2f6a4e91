"""Traces of a design: by blocks of common draws, kept by what they are of, and guided by what was learned once."""

from __future__ import annotations

import tempfile
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nsq_gpu.design.maps import BlockMaps, Maps
from nsq_gpu.edges import shape_of
from nsq_gpu.errors import NsqGpuError
from nsq_gpu.export import to_json
from nsq_gpu.process import run
from nsq_gpu.results import warn_of
from nsq_gpu.session import EXPORTED, Session

Json = dict[str, Any]

#: Traces that are kept, and the bytes of their maps.
_MOST_KEPT, _MOST_BYTES = 128, 2**28
#: Rays of the trace that writes a guide. The pilot before it has rays of its own.
_GUIDE_RAYS = 1000
#: Keys of a scene that name files.
_OF_FILES = ("file", "path")
#: Words of warnings that are no news of a block, which has few rays.
_OF_BLOCKS = ("noise", "the flux of detector", "no light", "no ray")


def block_seeds(seed: int, count: int) -> list[int]:
    """Return the seeds of blocks of rays. Another seed gives others."""
    return [int(found) for found in np.random.SeedSequence(seed % 2**64).generate_state(count, np.uint64) >> np.uint64(12)]


@dataclass(frozen=True)
class Asked:
    """What is traced of a scene, and how."""

    #: Rays of all blocks together.
    num_rays: int
    blocks: int = 16
    seed: int = 0
    max_depth: int | None = None
    precision: str = "auto"
    where: str | None = None
    #: File of the guide; None of plain rays.
    guide: str | None = None

    @property
    def num_traced(self) -> int:
        """Return the rays that are traced: all blocks have the same number."""
        return max(self.num_rays // self.blocks, 1) * self.blocks

    def options(self, block: int) -> Json:
        """Return the options of a block."""
        named = {"num_rays": self.num_traced // self.blocks, "seed": block_seeds(self.seed, self.blocks)[block],
                 "max_depth": self.max_depth, "precision": self.precision, "where": self.where, "guide_from": self.guide}
        return {key: value for key, value in named.items() if value is not None}


class Tracer:
    """Traces scenes in one session, and keeps their maps and their guides."""

    def __init__(self, session: Session, program: str, *, name: str = EXPORTED, folder: str | None = None) -> None:
        self.session = session
        self._program = program
        #: What errors call the scene, and where its files are.
        self.place: dict[str, Any] = {"name": name, "folder": folder}
        #: By the text of the scene, what was asked, and the numbers that were set. A guide's file is written once.
        self._kept: OrderedDict[tuple[Any, ...], Maps] = OrderedDict()
        self._guides: dict[str, str] = {}
        self._num_guides = 0
        self._folder = tempfile.TemporaryDirectory(prefix="nsq-gpu-")
        self._known: set[str] = set()
        #: Traces of a block that were made, and rays of these.
        self.num_traces = 0
        self.num_rays = 0
        #: Precision and depth of the last trace, as the program has it.
        self.frozen: Json = {}

    def maps(self, text: str, asked: Asked, numbers: Mapping[str, float] | None = None,
             detectors: Sequence[Json] = ()) -> Maps:
        """Return the maps of all irradiance detectors; ``detectors`` are the entries of the scene."""
        key = text, asked, tuple(sorted((numbers or {}).items()))
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        blocks = [self._traced(text, asked.options(block), numbers) for block in range(asked.blocks)]
        found = {}
        for entry in detectors:
            if entry["type"] == "irradiance":
                first = blocks[0][entry["name"]]
                nx, ny = len(first["x_coords"]), len(first["y_coords"])
                report = first["report"]
                pixel = (report["width"] / nx, report["height"] / ny)
                flux = np.stack([of[entry["name"]]["irradiance"] for of in blocks]).astype(np.float64) * (pixel[0] * pixel[1])
                found[entry["name"]] = BlockMaps(flux, np.array(first["x_coords"]), np.array(first["y_coords"]), pixel,
                                                 entry.get("splat", "hard"), float(entry.get("splat_sigma", 0.0)))
        self._kept[key] = found
        while len(self._kept) > 1 and (len(self._kept) > _MOST_KEPT or sum(map(_bytes, self._kept.values())) > _MOST_BYTES):
            self._kept.popitem(last=False)
        return found

    def forget(self) -> None:
        """Drop the maps that are kept."""
        self._kept.clear()

    def _traced(self, text: str, options: Json, numbers: Mapping[str, float] | None) -> dict[str, Json]:
        """Return the arrays of a block by detector, with the detector's part of the report."""
        answer = self.session.request(text, options, numbers=numbers, **self.place)
        report = answer.report
        self.num_traces += 1
        self.num_rays += int(report["num_rays_total"])
        self.frozen = {"precision": report["precision"], "max_depth": report["max_depth"]}
        grave = [said for said in report["diagnostics"]["grave"] if not any(word in said for word in _OF_BLOCKS)]
        warn_of(report | {"diagnostics": {"grave": grave}}, None, self._known)
        return {name: {**answer.arrays(name), "report": entry} for name, entry in report["detectors"].items()
                if entry["kind"] == "irradiance"}

    def gradient(self, text: str, asked: Asked, block: int, names: Sequence[str], adjoints: Mapping[str, np.ndarray],
                 numbers: Mapping[str, float] | None = None, *, check_edges: bool = False) -> tuple[np.ndarray, Json]:
        """Return what a number gains by a unit of each parameter, from what it gains by a watt in each pixel of a block."""
        answer = self.session.loss_gradient(text, asked.options(block), names, adjoints, numbers=numbers, check_edges=check_edges,
                                            **self.place)
        self.num_traces += 1
        self.num_rays += asked.options(block)["num_rays"]
        return np.array(answer["values"], dtype=float), answer

    def guide(self, document: Json, where: str | None, *, max_depth: int | None = None, seed: int = 0, precision: str = "auto",
              known: dict[str, str] | None = None) -> tuple[str, bool]:
        """Return the file of a guide for scenes of this shape, and whether it was learned now.

        ``known`` has the guides of one optic, and gains what is learned. None takes this tracer's guides.
        """
        known = self._guides if known is None else known
        shape = shape_of(_guided_shape(document), {"where": where}, ()) + f"-{max_depth}-{seed}"
        if shape in known:
            return known[shape], False
        folder = Path(self._folder.name)
        scene, guide = folder / "scene.json", folder / f"guide_{self._num_guides}.json"
        scene.write_text(to_json(_with_whole_paths(document, Path(self.place["folder"] or "")), indent=None), encoding="utf-8")
        command = [self._program, "trace", str(scene), "-n", str(_GUIDE_RAYS), "--guide", f"--guide-to={guide}", f"--seed={seed}",
                   f"--output={folder / f'out_{self._num_guides}'}", "--no-pictures", "--progress=never", "--watch-stdin"]
        command += [f"--where={where}"] * (where is not None) + [f"--max-depth={max_depth}"] * (max_depth is not None)
        adapter = self.session._adapter
        command += [f"--adapter={adapter}"] * (adapter is not None) + [f"--precision={precision}"] * (precision != "auto")
        try:
            run(command)
        except NsqGpuError as error:
            raise type(error)(str(error).replace(f"{scene}: ", f"{self.place['name']}: "), stderr=error.stderr) from None
        self._num_guides += 1
        known[shape] = str(guide)
        return str(guide), True

    def forget_guides(self) -> None:
        """Drop the guides; the next trace learns one anew."""
        self._guides.clear()


def _with_whole_paths(tree: Any, folder: Path) -> Any:
    """Return a scene in which files are named by their whole paths, so that it may lie in another folder."""
    if isinstance(tree, dict):
        return {key: str((folder / value).resolve()) if key in _OF_FILES and isinstance(value, str) and (folder / value).is_file()
                else _with_whole_paths(value, folder) for key, value in tree.items()}
    return [_with_whole_paths(value, folder) for value in tree] if isinstance(tree, list) else tree


def _bytes(maps: Maps) -> int:
    return sum(of.flux.nbytes for of in maps.values())


def _guided_shape(document: Json) -> Json:
    """Return what a guide depends on: all but the numbers of a scene; names count, and how many entries there are."""
    return {key: document[key] for key in ("components", "sources", "detectors", "nsq_gpu") if key in document}
