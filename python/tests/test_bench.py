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


def test_the_readme_has_the_newest_of_each_case() -> None:
    def case(name: str, rate: float) -> dict:
        return {"name": name, "kind": "trace", "num_rays": 1000, "peers": [],
                "measurements": [{"precision": "f64", "rays_per_sec": {"median": rate}, "ratios": {}}]}

    reports = {"newer": {"cases": [case("b", 3e6)]}, "older": {"cases": [case("a", 1e6), case("b", 2e6)]}}
    assert make_speed_table.summary(reports).splitlines()[2:] == [
        "| `a` | 1e3 |  | 1 | [older](benches/results/older/bench.csv) |",
        "| `b` | 1e3 |  | 3 | [newer](benches/results/newer/bench.csv) |",
    ]


def test_a_bar_is_held_against_the_newest_report_that_has_it() -> None:
    def report(ratios: dict[str, tuple[float, float]]) -> dict:
        measurements = [
            {"precision": precision, "rays_per_sec": {"median": 1e6}, "ratios": {peer: pair[i] for peer, pair in ratios.items()}}
            for i, precision in enumerate(["f32", "f64"])
        ]
        return {"cases": [{"name": "a", "kind": "command", "num_rays": 500_000, "measurements": measurements}]}

    reports = {"newest": report({}), "newer": report({"x": (2, 0.5)}), "older": report({"x": (3, 3)})}
    bar = make_speed_table.Bar("a over x", (2, 2), make_speed_table.over("x", "a"))
    assert bar.line(reports) == "| a over x | 2 / 2 | 2 / 0.5 | in f32 | [newer](results/newer/bench.csv) |"
    time = make_speed_table.Bar("a", (0.4, 0.6), make_speed_table.time_of("a"), " s", less_is_better=True)
    assert time.line(reports) == "| a | 0.4 / 0.6 s | 0.5 / 0.5 s | in f64 | [newest](results/newest/bench.csv) |"
    unknown = make_speed_table.Bar("b", (1, 1), make_speed_table.time_of("b"))
    assert unknown.line(reports) == "| b | 1 / 1 | not measured |  |  |"
