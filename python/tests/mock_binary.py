"""Stands in for the binary: ``python -m tests.mock_binary trace ...`` writes the oracle's own result.

``NSQ_MOCK_FAULT`` names a fault to put in, for the tests of the comparison.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import warnings
from pathlib import Path

import numpy as np

from tests import oracle
from tests.agreement import MAP_KEYS
from tests.oracle import DETECTOR_ARRAYS, Json


def write_result(result: Json, folder: Path) -> None:
    """Write a result in the binary's form."""
    report = {key: value for key, value in result.items() if key not in ("detectors", "absorbers", "surface_hits")}
    report["detectors"] = {name: _write_detector(name, detector, folder)
                           for name, detector in result["detectors"].items()}
    (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")


def _write_detector(name: str, detector: Json, folder: Path) -> Json:
    arrays = {key: detector[key] for key in DETECTOR_ARRAYS[detector["kind"]]}
    totals = {key: detector[key] for key in ("total_flux", "num_rays_hit")}
    np.savez(folder / f"{name}.npz", **arrays, **(totals if detector["kind"] in MAP_KEYS else {}))
    return {"kind": detector["kind"], **totals, "file": f"{name}.npz"}


def inject(fault: str, result: Json) -> None:
    """Make a result wrong in one way."""
    name, detector = next(iter(result["detectors"].items()))
    if fault == "count":
        result["num_rays_escaped"] += 1
    elif fault == "total":
        result["total_flux_detected"] *= 1.0 + 1e-10
    elif fault == "pixel":
        values = detector[MAP_KEYS[detector["kind"]]]
        values.flat[np.argmax(values)] *= 1.0 + 1e-8
    elif fault == "nan":
        detector[MAP_KEYS[detector["kind"]]].flat[0] = np.nan
    elif fault == "row":
        detector["L"][0] += 1e-8
    elif fault == "hits":
        result["detectors"][name] = {**detector, "num_rays_hit": detector["num_rays_hit"] - 1}
    elif fault:
        raise ValueError(f"unknown fault {fault!r}")


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("command", choices=["trace"])
    parser.add_argument("scene", type=Path)
    parser.add_argument("-n", type=int, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--precision", required=True)
    parser.add_argument("--max-depth", type=int, required=True)
    parser.add_argument("-o", type=Path, required=True)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    result = oracle.run(options.scene, options.n, options.seed, max_depth=options.max_depth)
    inject(os.environ.get("NSQ_MOCK_FAULT", ""), result)
    write_result(result, options.o)


if __name__ == "__main__":
    main(sys.argv[1:])
