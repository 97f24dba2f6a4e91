"""Writes ``tests/oracle/<scene>.json``: ``python -m tools.make_oracle [SCENE.json ...]`` from the folder ``python``.

A file holds every count and total of one trace in full, small maps whole, and of large maps the sums along each axis
and some single bins. It also says whether the oracle agrees with itself when its sources move by rounding errors;
where it does not, paths are decided by rounding. There, and where rays are split (``"chaotic": true``), means over
independent runs are added for a statistical comparison.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQScene

from tests import oracle
from tests.agreement import AXIS_KEYS, MAP_KEYS, ROW_KEYS, Agreement, compare
from tests.oracle import COUNTS, FLUXES, Json
from tests.parity import STATISTICAL_RUNS, caps, trace_with_oracle
from tools.make_scenes import SCENES_DIR

ORACLE_DIR = SCENES_DIR.parent / "tests" / "oracle"

NUM_RAYS = 100_000
SEED = 0
#: Maps of at most so many bins are written whole.
WHOLE_MAP = 700
#: Single bins written of a larger map.
SAMPLED_BINS = 200
#: Rows written from each end of a sorted ray database.
SAMPLED_ROWS = 50


def digest(scene: Path) -> Json:
    """Trace a scene and return what its file will hold."""
    text = scene.read_text(encoding="utf-8")
    document = json.loads(text)
    result = trace_with_oracle(document, NUM_RAYS, SEED)
    self_agreement = compare(_trace_moved(document), result)
    # Rays that are split draw numbers of their own here and there: as in a chaotic scene, expectations are the same.
    chaotic = bool(self_agreement.violations) or splits(document)
    statistics = {"statistics": _statistics(document)} if chaotic else {}
    return {
        "scene": scene.name,
        "scene_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "optiland": version("optiland"),
        "num_rays": NUM_RAYS,
        "seed": SEED,
        "chaotic": chaotic,
        "self_deviation": _self_deviation(self_agreement),
        **{key: result[key] for key in (*COUNTS, *FLUXES, "flux_conservation_error", "interactions_per_ray",
                                        "surface_hits", "absorbers", "diagnostics")},
        "detectors": {name: _detector(detector) for name, detector in result["detectors"].items()},
        "max_rays": caps(document),
        **statistics,
    }


def splits(document: Json) -> bool:
    """Return whether the scene splits rays."""
    return document.get("nsq_gpu", {}).get("sampling", {}).get("split_depth", 0) > 0


def _self_deviation(agreement: Agreement) -> Json:
    return {**agreement.worst, "count_differences": agreement.count_differences}


def _trace_moved(document: Json) -> Json:
    """Trace with every source moved by one rounding error of the scene's largest coordinate.

    That is the error which any other order of the same operations makes; a step of one ulp of the source's own
    position would vanish at the origin.
    """
    uncapped = {**document, "nsq_gpu": {**document.get("nsq_gpu", {"version": 1}), "detectors": {}}}
    scene = oracle.scene_from_dict(uncapped)
    step = np.finfo(np.float64).eps * _extent(scene)
    for source in scene.sources:
        source.cs.x, source.cs.y, source.cs.z = (float(v) + step for v in (source.cs.x, source.cs.y, source.cs.z))
    return oracle.trace(scene, oracle.detector_kinds(document), NUM_RAYS, SEED)


def _extent(scene: NSQScene) -> float:
    frames: list[CoordinateSystem] = [item.cs for item in (*scene.surfaces, *scene.sources, *scene.detectors)]
    return max(1.0, *(float(np.abs(frame.get_effective_transform()[0]).max()) for frame in frames))


def _detector(detector: Json) -> Json:
    common = {key: detector[key] for key in ("kind", "total_flux", "num_rays_hit", "transmissive")}
    body = _rows(detector) if detector["kind"] == "ray_database" else _map(detector)
    return {**common, **body}


def _map(detector: Json) -> Json:
    """Describe a map: its flat index runs over the last axis fastest."""
    values = detector[MAP_KEYS[detector["kind"]]]
    axes = {axis: [float(detector[axis][0]), float(detector[axis][-1])] for axis in AXIS_KEYS[detector["kind"]]}
    head = {"shape": list(values.shape), "peak": float(values.max()), "axis_ends": axes}
    if values.size <= WHOLE_MAP:
        return {**head, "values": values.ravel().tolist()}
    bins = _sampled_bins(values)
    return {
        **head,
        "axis_sums": _axis_sums(values, detector["kind"]),
        "bins": bins.tolist(),
        "bin_values": values.ravel()[bins].tolist(),
    }


def _axis_sums(values: np.ndarray, kind: str) -> list[list[float]]:
    """Sum a map over all axes but one.

    Of a far field's ring at the pole only the sum is defined, the first sum of the first axis: the azimuth of a ray
    along the axis is rounding noise. So the ring stays out of the sums of the azimuth.
    """
    sums = []
    for axis in range(values.ndim):
        summed = values[1:] if kind == "far_field" and axis == 1 else values
        sums.append(summed.sum(axis=tuple(other for other in range(values.ndim) if other != axis)).tolist())
    return sums


def _sampled_bins(values: np.ndarray) -> np.ndarray:
    """Choose bins at random, lit ones first: dark bins of a sparse map would say little."""
    order = np.random.default_rng(SEED).permutation(values.size)
    lit = values.ravel()[order] > 0.0
    return np.sort(np.concatenate([order[lit], order[~lit]])[:SAMPLED_BINS])


def _rows(detector: Json) -> Json:
    """Describe a ray database: sums of its columns and the ends of its rows, sorted by x, then y, and so on."""
    columns = np.stack([detector[key][: len(detector["x"])] for key in ROW_KEYS], axis=1)
    order = np.lexsort(columns.T[::-1])
    return {
        "columns": list(ROW_KEYS),
        "rows": len(columns),
        "column_sums": columns.sum(axis=0).tolist(),
        "column_square_sums": (columns**2).sum(axis=0).tolist(),
        "first_rows": columns[order[:SAMPLED_ROWS]].tolist(),
        "last_rows": columns[order[-SAMPLED_ROWS:]].tolist(),
    }


def _statistics(document: Json) -> Json:
    """Return mean and standard error of every count, total and bin over independent runs."""
    num_rays = NUM_RAYS // STATISTICAL_RUNS
    runs = [trace_with_oracle(document, num_rays, 1 + seed) for seed in range(STATISTICAL_RUNS)]
    detectors = {name: _detector_statistics([run["detectors"][name] for run in runs]) for name in runs[0]["detectors"]}
    return {"runs": STATISTICAL_RUNS, "num_rays_per_run": num_rays,
            **{key: _mean(runs, key) for key in (*COUNTS, *FLUXES)}, "detectors": detectors}


def _detector_statistics(runs: list[Json]) -> Json:
    totals = {key: _mean(runs, key) for key in ("total_flux", "num_rays_hit")}
    key = MAP_KEYS.get(runs[0]["kind"])
    return {**totals, "map": _mean(runs, key)} if key else totals


def _mean(runs: list[Json], key: str) -> Json:
    values = np.stack([np.ravel(run[key]) for run in runs]).astype(np.float64)
    error = values.std(axis=0, ddof=1) / np.sqrt(len(runs))
    return {"mean": values.mean(axis=0).tolist(), "standard_error": error.tolist()}


def dumps(result: Json) -> str:
    """One line for each top-level key, so that a difference shows where it is."""
    lines = [f"{json.dumps(key)}: {json.dumps(value, separators=(',', ':'))}" for key, value in result.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def main(arguments: list[str]) -> None:
    warnings.simplefilter("ignore")
    ORACLE_DIR.mkdir(parents=True, exist_ok=True)
    for scene in [Path(argument) for argument in arguments] or sorted(SCENES_DIR.glob("*.json")):
        start = time.perf_counter()
        result = digest(scene)
        (ORACLE_DIR / scene.name).write_text(dumps(result), encoding="utf-8")
        print(summary(scene, result, time.perf_counter() - start), flush=True)


def summary(scene: Path, result: Json, seconds: float) -> str:
    """Return one line on a scene: what it costs, and how well it agrees with itself."""
    worst: dict[str, Any] = {key: f"{value:.0e}" for key, value in result["self_deviation"].items()
                             if isinstance(value, float)}
    return (f"{scene.stem:28} {result['interactions_per_ray']:6.2f} interactions/ray  {seconds:5.1f} s  "
            f"{'CHAOTIC' if result['chaotic'] else 'stable':8} {worst}")


if __name__ == "__main__":
    main(sys.argv[1:])
