"""Compares what two programs report about every scene, but for times, and says which keys differ.

    python3 tests/house/same_reports.py OLD NEW            every scene, by every precision; paths; three gradients
    python3 tests/house/same_reports.py OLD NEW lens       scenes whose names have this
    python3 tests/house/same_reports.py OLD NEW --quick    one precision a scene, by turns

What OLD prints is kept in a folder beside it, OLD.reports, and taken from there the next time. Both run with strict arithmetic
and this machine's adapter, on the scenes of this tree. Refusals are compared as well. Exit code 1 if a report differs.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[2]
NUM_RAYS = "1e4"
PRECISIONS = ["auto", "f32", "df64", "f64"]
# What differs from run to run of one program.
TIMES = re.compile(r"time|seconds|elapsed|per_sec|_sec$|version|duration")
GRADIENTS = {"cooke_triplet": "L1.r1,L3.z", "bench_lens": "L.r1,L.z", "aspheric_collimator": "collimator.r1,focuser.z"}


def commands(part, quick):
    """The names and arguments of all runs."""
    scenes = [scene for scene in sorted(ROOT.glob("scenes/*.json")) if part in scene.stem]
    for number, scene in enumerate(scenes):
        path = f"scenes/{scene.name}"
        for precision in [PRECISIONS[number % len(PRECISIONS)]] if quick else PRECISIONS:
            yield f"{scene.stem} trace {precision}", ["trace", path, "-n", NUM_RAYS, "--json", "--precision", precision, "--strict=on"]
        yield f"{scene.stem} paths", ["paths", path, "-n", NUM_RAYS, "--json", "--top", "20", "--strict=on"]
        if scene.stem in GRADIENTS:
            names = GRADIENTS[scene.stem]
            yield f"{scene.stem} gradient", ["trace", path, "-n", NUM_RAYS, "--json", "--gradient", names, "--strict=on"]


def report(program, arguments):
    done = subprocess.run([program, *arguments], capture_output=True, text=True, cwd=ROOT)
    if done.returncode:
        # The tests hold the words of refusals.
        return {"exit_code": done.returncode, "error": done.stderr.strip().splitlines()[-1:]}
    return json.loads(done.stdout)


def leaves(value, path=""):
    """Every value of a report that is no time, by its place."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not TIMES.search(key):
                yield from leaves(inner, f"{path}.{key}")
    elif isinstance(value, list):
        yield f"{path}.length", len(value)
        for number, inner in enumerate(value):
            yield from leaves(inner, f"{path}[{number}]")
    else:
        yield path, value


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("part", nargs="?", default="")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    old, new = options.old.resolve(), options.new.resolve()
    kept = old.with_name(f"{old.name}.reports")
    kept.mkdir(exist_ok=True)

    def differences(run):
        name, arguments = run
        file = kept / f"{name}.json"
        if not file.exists():
            file.write_text(json.dumps(report(old, arguments)))
        before, after = dict(leaves(json.loads(file.read_text()))), dict(leaves(report(new, arguments)))
        keys = [key for key in before | after if before.get(key, "absent") != after.get(key, "absent")]
        return name, [f"{key}: {before.get(key, 'absent')!r} -> {after.get(key, 'absent')!r}" for key in keys], len(before), "error" in before or ".error.length" in before

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        results = list(threads.map(differences, commands(options.part, options.quick)))
    differ = [(name, keys) for name, keys, _, _ in results if keys]
    for name, keys in differ:
        print(f"{name}: {len(keys)} keys differ\n" + "".join(f"  {key}\n" for key in keys[:8]), end="")
    refused = [name for name, _, _, is_refused in results if is_refused]
    num_values = sum(num for _, _, num, _ in results)
    print(f"{len(results) - len(differ)} of {len(results)} reports are the same, of {num_values:,} values; refused by the old program: {', '.join(refused) or 'none'}")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
