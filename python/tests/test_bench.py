"""``nsq-bench --against optiland`` runs the installed Optiland on the benchmark's own scenes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from tools import make_speed_table

CASES = ["rays_1e3", "surfaces_5", "depth_2", "lens_0", "spheres_100", "double_gauss"]


def test_optiland_traces_every_kind_of_case(command: list[str]) -> None:
    bench = os.environ.get("NSQ_BENCH_BINARY") or Path(command[0]).with_name("nsq-bench")
    arguments = ["--max-rays", "100", "--runs", "1", "--precision", "f32", "--json"]
    arguments += ["--scenes", ",".join(CASES), "--against", "optiland", "--python", sys.executable]
    done = subprocess.run([bench, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["peers"]["optiland"]["optiland"] == "0.6.3"
    assert [case["name"] for case in report["cases"]] == CASES
    for case in report["cases"]:
        (peer,) = case["peers"]
        (ours,) = case["measurements"]
        assert peer["num_rays"] == ours["counts"]["launched"] == 100
        assert ours["ratios"]["optiland"] > 0


def test_the_tables_of_speeds_are_those_of_the_benchmarks() -> None:
    for page, text in make_speed_table.pages(make_speed_table.read_reports()).items():
        assert page.read_text() == text, page


def test_a_table_is_of_one_run_and_has_few_rows() -> None:
    reports = make_speed_table.read_reports()
    for of_gpu in (False, True):
        _, report = make_speed_table.newest(reports, of_gpu=of_gpu)
        rows = make_speed_table.table(report).splitlines()[2:]
        assert 5 <= len(rows) <= 10


def test_a_row_has_rates_of_traces_times_of_commands_and_ratios() -> None:
    def case(name: str, kind: str, rate: float, ratios: dict[str, float]) -> dict:
        return {"name": name, "kind": kind, "num_rays": 1_000_000,
                "measurements": [{"precision": "f64", "rays_per_sec": {"median": rate}, "ratios": ratios}]}

    cases = [case("rays_1e7", "trace", 1.23456e8, {"drjit": 0.9}), case("cooke_triplet", "command", 2e6, {"optiland": 50.26})]
    report = {"cases": [*cases, case("not_a_row", "trace", 1e6, {})], "peers": {"drjit": {}, "optiland": {}}}
    assert make_speed_table.table(report).splitlines()[2:] == [
        "| one lens, a long trace | `rays_1e7` | 1e6 |  | 123 M rays/s |  |  / 0.900 |",
        "| a Cooke triplet, the whole command | `cooke_triplet` | 1e6 |  | 0.500 s |  / 50.3 |  |",
    ]
