"""Writes the README's table of speeds from the newest bench.json below benches/results/.

usage, in python/: python -m tools.make_speed_table
"""

import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
BEGIN = "<!-- Written by python/tools/make_speed_table.py from {path}. -->\n"
END = "<!-- End of the table of speeds. -->\n"


def newest() -> Path:
    """The newest bench.json: folders are named by date."""
    return sorted((ROOT / "benches" / "results").glob("*/bench.json"))[-1]


def table(report: dict) -> str:
    """The cases as Markdown: median rates [M rays/s] and ratios to the peers."""
    machine, adapter = report["machine"], report["adapter"]
    peers = sorted({peer["name"] for case in report["cases"] for peer in case["peers"]})
    lines = [
        f"{machine['processor']}, {machine['num_cores']} cores; {adapter['driver']}; {report['date'][:10]}"
        + "".join(f"; {name} {_versions(report['peers'].get(name, {}))}" for name in peers)
        + f"; medians of {report['num_runs']} runs.",
        "",
        "| case | rays | f32 [M rays/s] | f64 [M rays/s] |" + "".join(f" f32 / f64 over {name} |" for name in peers),
        "|---|---|---|---|" + "---|" * len(peers),
    ]
    for case in report["cases"]:
        measured = {m["precision"]: m for m in case["measurements"]}
        rates = [f"{measured[p]['rays_per_sec']['median'] / 1e6:.3g}" if p in measured else "" for p in ("f32", "f64")]
        ratios = [_ratios(measured, name) for name in peers]
        lines.append("| " + " | ".join([f"`{case['name']}`", f"{case['num_rays']:.0e}", *rates, *ratios]) + " |")
    return "\n".join(lines).replace("e+0", "e") + "\n"


def _versions(versions: dict) -> str:
    return ", ".join(dict.fromkeys(versions.values()))


def _ratios(measured: dict, peer: str) -> str:
    ratios = [measured[p]["ratios"].get(peer) if p in measured else None for p in ("f32", "f64")]
    return " / ".join("" if ratio is None else f"{ratio:.3g}" for ratio in ratios) if any(ratios) else ""


def replaced(readme: str, path: Path) -> str:
    """The README with its table made anew."""
    head, rest = readme.split(BEGIN.split("{")[0], 1)
    tail = rest.split(END, 1)[1]
    begin = BEGIN.format(path=path.relative_to(ROOT).as_posix())
    return head + begin + table(json.loads(path.read_text())) + END + tail


if __name__ == "__main__":
    README.write_text(replaced(README.read_text(), newest()))
