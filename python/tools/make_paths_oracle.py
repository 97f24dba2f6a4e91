"""Writes ``tests/data/paths.json``: ``python -m tools.make_paths_oracle`` from the folder ``python``.

The recorded paths of a few scenes, sorted by ray and then by event: which rays a request for about so many selects,
and every event of theirs.
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
from optiland.nonsequential.backends.numpy_backend import NumpyBackend

from tests import oracle
from tests.oracle import Json
from tools.make_scenes import SCENES_DIR

PATHS_FILE = SCENES_DIR.parent / "tests" / "data" / "paths.json"

SCENES = ("double_gauss", "kaleidoscope", "nested_media")
NUM_RAYS = 20_000
NUM_RECORDED = 30
SEED = 5
#: Order of events that share a count of events.
RANKS = {"birth": 0, "hit": 1, "death": 2}
NUMBERS = ("x", "y", "z", "L", "M", "N", "flux", "wavelength")


def events(scene: Path) -> list[Json]:
    """Return the events of a scene's recorded paths.

    Optiland logs the names of its sources and detectors, but a scene's registry does not give them theirs.
    """
    live = oracle.load_scene(scene)
    for name, item in (*zip(live.source_names, live.sources, strict=True),
                       *zip(live.detector_names, live.detectors, strict=True)):
        item.name = name
    result = live.trace(num_rays=NUM_RAYS, seed=SEED, backend=NumpyBackend(seed=SEED), record_paths=NUM_RECORDED)
    rows = result.ray_paths["events"]
    rank = np.array([RANKS[kind] for kind in rows["event_type"]])
    order = np.lexsort((rank, rows["bounce"], rows["ray_id"]))
    return [_event(row) for row in rows[order]]


def _event(row: np.void) -> Json:
    return {
        "ray_id": int(row["ray_id"]),
        "event_type": str(row["event_type"]),
        "bounce": int(row["bounce"]),
        "component_name": str(row["component_name"]),
        "numbers": [float(row[name]) for name in NUMBERS],
    }


def dumps(scenes: dict[str, list[Json]]) -> str:
    """One line for each event."""
    bodies = []
    for name, rows in scenes.items():
        lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in rows)
        bodies.append(f"{json.dumps(name)}: [\n{lines}\n]")
    head = {"num_rays": NUM_RAYS, "num_recorded": NUM_RECORDED, "seed": SEED, "numbers": NUMBERS}
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in head.items()]
    return "{\n" + ",\n".join([*lines, '"scenes": {\n' + ",\n".join(bodies) + "\n}"]) + "\n}\n"


def main() -> None:
    warnings.simplefilter("ignore")
    scenes = {name: events(SCENES_DIR / f"{name}.json") for name in SCENES}
    PATHS_FILE.write_text(dumps(scenes), encoding="utf-8")


if __name__ == "__main__":
    main()
