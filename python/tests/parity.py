"""Traces scenes with the binary and with the oracle, and compares.

``python -m tests.parity --binary PATH ../scenes/*.json [-n 1e5] [--seed 0] [--precision f64]`` from the folder
``python``: one line a scene with the worst deviations, then what broke a limit; exit code 1 if anything did.
A scene whose committed oracle says ``"chaotic": true`` is compared statistically, over independent seeds. In f32
counts may differ: their differences are printed per interaction, and limited by ``F32_LIMIT``.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from tests import oracle
from tests.agreement import Agreement, compare, compare_statistically
from tests.oracle import COUNTS, DETECTOR_ARRAYS, FLUXES, Json

ORACLE_DIR = Path(__file__).resolve().parents[2] / "tests" / "oracle"

#: The largest number of events of a ray on both sides: what Optiland takes where none is given.
OPTILANDS_DEPTH = 16
#: Runs a side of a statistical comparison; the rays are shared among them.
STATISTICAL_RUNS = 16
#: Seeds of the oracle's runs start here, so that they are independent of the binary's.
ORACLE_SEEDS = 1_000_000
#: Most rays per interaction that may end differently in f32.
F32_LIMIT = 1e-4


def trace_with_binary(command: list[str], scene: Path, num_rays: int, seed: int, precision: str) -> Json:
    """Run the binary and return its result as ``oracle.trace`` would."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["trace", str(scene), "-n", str(num_rays), "--seed", str(seed), "--precision", precision,
                     "--max-depth", str(OPTILANDS_DEPTH), "-o", folder, "--json"]
        run = subprocess.run([*command, *arguments], capture_output=True, text=True)
        if run.returncode != 0:
            raise RuntimeError(f"exit code {run.returncode}: {run.stderr.strip()[-500:]}")
        return load_result(Path(folder))


def load_result(folder: Path) -> Json:
    """Read ``report.json`` and the detectors' npz files."""
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    keys = (*COUNTS, *FLUXES, "flux_conservation_error", "diagnostics")
    detectors = {name: _load_detector(folder, spec) for name, spec in report["detectors"].items()}
    return {**{key: report[key] for key in keys}, "detectors": detectors}


def _load_detector(folder: Path, spec: Json) -> Json:
    with np.load(folder / spec["file"]) as arrays:
        loaded = {key: arrays[key] for key in DETECTOR_ARRAYS[spec["kind"]]}
        # The file repeats the report's totals; a difference between the two is the writer's fault.
        for key in ("total_flux", "num_rays_hit"):
            if key in arrays and float(arrays[key]) != float(spec[key]):
                raise RuntimeError(f"{spec['file']}: {key} differs from report.json")
    return {"kind": spec["kind"], "total_flux": spec["total_flux"], "num_rays_hit": spec["num_rays_hit"], **loaded}


def uncapped(document: Json) -> Json:
    """Return the file with its ray databases without their caps."""
    return {**document, "nsq_gpu": {**document.get("nsq_gpu", {"version": 1}), "detectors": {}}}


def trace_with_oracle(document: Json, num_rays: int, seed: int, folder: Path = oracle.SCENES_DIR) -> Json:
    """Trace a parsed file with NumpyBackend, its ray databases without their caps."""
    scene = oracle.scene_from_dict(uncapped(document), folder)
    return oracle.trace(scene, oracle.detector_kinds(document), num_rays, seed, max_depth=OPTILANDS_DEPTH)


def caps(document: Json) -> Json:
    """Return the ``max_rays`` of every capped ray database."""
    extras = document.get("nsq_gpu", {}).get("detectors", {})
    return {name: extra["max_rays"] for name, extra in extras.items() if extra.get("max_rays")}


def is_chaotic(scene: Path) -> bool:
    """Tell whether the committed oracle found that the scene disagrees with itself."""
    digest = ORACLE_DIR / scene.name
    return digest.exists() and json.loads(digest.read_text(encoding="utf-8"))["chaotic"]


def check(command: list[str], scene: Path, options: argparse.Namespace) -> Agreement:
    """Compare one scene."""
    document = json.loads(scene.read_text(encoding="utf-8"))
    if is_chaotic(scene):
        return check_statistically(command, scene, document, options)
    theirs = trace_with_oracle(document, options.num_rays, options.seed, scene.parent)
    return check_ray_for_ray(command, scene, theirs, options)


def check_ray_for_ray(command: list[str], scene: Path, theirs: Json, options: argparse.Namespace) -> Agreement:
    """Compare the binary with the oracle's result of the same rays."""
    document = json.loads(scene.read_text(encoding="utf-8"))
    ours = trace_with_binary(command, scene, options.num_rays, options.seed, options.precision)
    agreement = compare(ours, theirs, caps(document))
    if options.precision == "f32":
        return f32_agreement(agreement, theirs)
    return agreement


def check_statistically(command: list[str], scene: Path, document: Json, options: argparse.Namespace) -> Agreement:
    """Compare independent runs of either side."""
    num_rays = max(options.num_rays // STATISTICAL_RUNS, 1)
    seeds = range(options.seed, options.seed + STATISTICAL_RUNS)
    ours = [trace_with_binary(command, scene, num_rays, seed, options.precision) for seed in seeds]
    theirs = [trace_with_oracle(document, num_rays, ORACLE_SEEDS + seed, scene.parent) for seed in seeds]
    return compare_statistically(ours, theirs)


def f32_agreement(agreement: Agreement, theirs: Json) -> Agreement:
    """Judge an f32 result by its count differences per interaction; deviations of maps are printed only."""
    interactions = theirs["interactions_per_ray"] * theirs["num_rays_total"]
    judged = Agreement(worst=agreement.worst, count_differences=agreement.count_differences)
    for what, difference in agreement.count_differences.items():
        judged.note("count/interaction", what, abs(difference) / interactions, F32_LIMIT)
    return judged


def line(scene: Path, agreement: Agreement) -> str:
    """Return the one line of a scene."""
    worst = "  ".join(f"{kind} {value:.1e}" for kind, value in agreement.worst.items())
    differences = f"  {len(agreement.count_differences)} counts differ" if agreement.count_differences else ""
    verdict = "FAIL" if agreement.violations else "ok"
    return f"{verdict:4}  {scene.stem:28} {worst}{differences}"


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--binary", required=True, help="the program, possibly with leading arguments")
    parser.add_argument("-n", "--num-rays", type=lambda text: int(float(text)), default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--precision", choices=("f64", "f32", "df64"), default="f64")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> int:
    warnings.simplefilter("ignore")
    options = parse(arguments)
    command = shlex.split(options.binary)
    failed = 0
    for scene in options.scenes:
        start = time.perf_counter()
        try:
            agreement = check(command, scene, options)
        except (RuntimeError, OSError, KeyError, ValueError) as error:
            agreement = Agreement(violations=[f"{type(error).__name__}: {error}"])
        print(f"{line(scene, agreement)}  {time.perf_counter() - start:.1f} s", flush=True)
        for violation in agreement.violations:
            print(f"      {violation}")
        failed += bool(agreement.violations)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
