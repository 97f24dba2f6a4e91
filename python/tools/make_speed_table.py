"""Writes tables of speeds from every bench.json in a folder of benches/results/: into the README the newest of each case,
into benches/results/README.md all of them.

usage, in python/: python -m tools.make_speed_table
"""

import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
RESULTS = ROOT / "benches" / "results"
ALL_TABLES = RESULTS / "README.md"
BEGIN = "<!-- Written by python/tools/make_speed_table.py. -->\n"
END = "<!-- End of the table of speeds. -->\n"
TITLE = """# Measured speeds

What was measured on which machine, and what the code could do by then, is said in [`benches/`](../README.md#the-files);
`python -m tools.make_speed_table` (in `python/`) writes this page from the files here, the newest first.

"""


def newest_of_each(reports: dict[str, dict]) -> list[tuple[str, dict]]:
    """Every case with the newest folder that has it, in the order in which cases came to be measured."""
    oldest_first = list(reversed(reports.items()))
    newest = {case["name"]: (folder, case) for folder, report in oldest_first for case in report["cases"]}
    return list(newest.values())


def summary(reports: dict[str, dict]) -> str:
    """The newest of each case as Markdown, with the folder it is from, as seen from the root."""
    rows = newest_of_each(reports)
    lines = table([case for _, case in rows], [f"[{folder}](benches/results/{folder})" for folder, _ in rows])
    return "\n".join(lines) + "\n"


def table(cases: list[dict], folders: list[str] | None = None) -> list[str]:
    """The cases as Markdown: median rates [M rays/s] and ratios to the peers."""
    peers = sorted({peer["name"] for case in cases for peer in case["peers"]})
    columns = ["case", "rays", "f32 [M rays/s]", "f64 [M rays/s]", *(f"f32 / f64 over {name}" for name in peers)]
    rows = [_row(case, peers) for case in cases]
    if folders is not None:
        columns.append("measured")
        rows = [[*row, folder] for row, folder in zip(rows, folders, strict=True)]
    return [_line(columns), "|" + "---|" * len(columns), *map(_line, rows)]


def _row(case: dict, peers: list[str]) -> list[str]:
    measured = {m["precision"]: m for m in case["measurements"]}
    rates = [f"{measured[p]['rays_per_sec']['median'] / 1e6:.3g}" if p in measured else "" for p in ("f32", "f64")]
    ratios = [_ratios(measured, name) for name in peers]
    return [f"`{case['name']}`", _short(f"{case['num_rays']:.0e}"), *rates, *ratios]


def _short(number: str) -> str:
    return number.replace("e+0", "e")


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _ratios(measured: dict, peer: str) -> str:
    ratios = [measured[p]["ratios"].get(peer) if p in measured else None for p in ("f32", "f64")]
    return " / ".join("" if ratio is None else _short(f"{ratio:.3g}") for ratio in ratios) if any(ratios) else ""


def heading(report: dict) -> str:
    """What was measured on, when, and beside whom."""
    machine, adapter = report["machine"], report["adapter"]
    parts = [f"{machine['processor']}, {machine['num_cores']} cores", adapter["driver"], report["date"][:10]]
    parts += [f"{name} {_versions(versions)}" for name, versions in report["peers"].items()]
    return "; ".join([*parts, f"medians of {report['num_runs']} runs"])


def _versions(versions: dict) -> str:
    return ", ".join(dict.fromkeys(versions.values()))


def section(folder: str, report: dict) -> str:
    """One results folder: its name, what was measured on, its table."""
    lines = table(report["cases"])
    return f"## [{folder}]({folder})\n\n{heading(report)}.\n\n" + "\n".join(lines) + "\n"


def all_tables(reports: dict[str, dict]) -> str:
    """The page of all tables."""
    return TITLE + "\n".join(section(folder, report) for folder, report in reports.items())


def replaced(readme: str, reports: dict[str, dict]) -> str:
    """The README with its table made anew."""
    head, rest = readme.split(BEGIN, 1)
    tail = rest.split(END, 1)[1]
    return head + BEGIN + "\n" + summary(reports) + "\n" + END + tail


def read_reports() -> dict[str, dict]:
    """What every folder holds, the newest first: folders of one day are named for other things."""
    reports = [(path.parent.name, json.loads(path.read_text())) for path in RESULTS.glob("*/bench.json")]
    return dict(sorted(reports, key=lambda report: report[1]["date"], reverse=True))


if __name__ == "__main__":
    found = read_reports()
    README.write_text(replaced(README.read_text(), found))
    ALL_TABLES.write_text(all_tables(found))
