"""Writes the README's tables of speeds from every bench.json below benches/results/, the newest first.

usage, in python/: python -m tools.make_speed_table
"""

import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
BEGIN = "<!-- Written by python/tools/make_speed_table.py. -->\n"
END = "<!-- End of the tables of speeds. -->\n"


def newest_first() -> list[Path]:
    """Every bench.json: folders are named by date."""
    return sorted((ROOT / "benches" / "results").glob("*/bench.json"), reverse=True)


def table(report: dict) -> str:
    """The cases as Markdown: median rates [M rays/s] and ratios to the peers."""
    peers = sorted({peer["name"] for case in report["cases"] for peer in case["peers"]})
    lines = [
        "| case | rays | f32 [M rays/s] | f64 [M rays/s] |" + "".join(f" f32 / f64 over {name} |" for name in peers),
        "|---|---|---|---|" + "---|" * len(peers),
    ]
    for case in report["cases"]:
        measured = {m["precision"]: m for m in case["measurements"]}
        rates = [f"{measured[p]['rays_per_sec']['median'] / 1e6:.3g}" if p in measured else "" for p in ("f32", "f64")]
        ratios = [_ratios(measured, name) for name in peers]
        lines.append("| " + " | ".join([f"`{case['name']}`", f"{case['num_rays']:.0e}", *rates, *ratios]) + " |")
    return "\n".join(lines).replace("e+0", "e") + "\n"


def heading(report: dict) -> str:
    """What was measured on, when, and beside whom."""
    machine, adapter = report["machine"], report["adapter"]
    parts = [f"{machine['processor']}, {machine['num_cores']} cores", adapter["driver"], report["date"][:10]]
    parts += [f"{name} {_versions(versions)}" for name, versions in report["peers"].items()]
    return "; ".join([*parts, f"medians of {report['num_runs']} runs"])


def _versions(versions: dict) -> str:
    return ", ".join(dict.fromkeys(versions.values()))


def _ratios(measured: dict, peer: str) -> str:
    ratios = [measured[p]["ratios"].get(peer) if p in measured else None for p in ("f32", "f64")]
    return " / ".join("" if ratio is None else f"{ratio:.3g}" for ratio in ratios) if any(ratios) else ""


def section(path: Path) -> str:
    """One results folder: its name, what was measured on, its table."""
    report = json.loads(path.read_text())
    folder = path.parent.relative_to(ROOT).as_posix()
    return f"**[{path.parent.name}]({folder})**: {heading(report)}.\n\n{table(report)}\n"


def replaced(readme: str, paths: list[Path]) -> str:
    """The README with its tables made anew."""
    head, rest = readme.split(BEGIN, 1)
    tail = rest.split(END, 1)[1]
    return head + BEGIN + "\n" + "".join(map(section, paths)) + END + tail


if __name__ == "__main__":
    README.write_text(replaced(README.read_text(), newest_first()))
