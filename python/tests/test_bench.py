"""``nsq-gpu bench --against optiland`` runs the installed Optiland on the benchmark's own scenes."""

from __future__ import annotations

import json
import subprocess
import sys

from tools import make_speed_table

CASES = ["rays_1e3", "surfaces_5", "depth_2", "lens_0", "spheres_100", "double_gauss"]


def test_optiland_traces_every_kind_of_case(command: list[str]) -> None:
    arguments = ["bench", "--max-rays", "100", "--runs", "1", "--precision", "f32", "--json"]
    arguments += ["--scenes", ",".join(CASES), "--against", "optiland", "--python", sys.executable]
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, check=False)
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
    reports = make_speed_table.read_reports()
    readme = make_speed_table.README.read_text()
    assert make_speed_table.replaced(readme, reports) == readme
    assert make_speed_table.ALL_TABLES.read_text() == make_speed_table.all_tables(reports)


def test_the_readme_has_the_newest_of_each_case() -> None:
    def case(name: str, rate: float) -> dict:
        return {"name": name, "num_rays": 1000, "peers": [],
                "measurements": [{"precision": "f64", "rays_per_sec": {"median": rate}, "ratios": {}}]}

    reports = {"newer": {"cases": [case("b", 3e6)]}, "older": {"cases": [case("a", 1e6), case("b", 2e6)]}}
    assert make_speed_table.summary(reports).splitlines()[2:] == [
        "| `a` | 1e3 |  | 1 | [older](benches/results/older) |",
        "| `b` | 1e3 |  | 3 | [newer](benches/results/newer) |",
    ]
