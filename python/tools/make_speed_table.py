"""Writes the tables of speeds: into docs/speed.md one of a processor and one of a GPU, into the README the former, each from
one run. The files of benches/results/ hold all figures.

usage, in python/: python -m tools.make_speed_table
"""

import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
SPEED = ROOT / "docs" / "speed.md"
RESULTS = ROOT / "benches" / "results"
BEGIN = "<!-- Written by python/tools/make_speed_table.py. -->\n"
END = "<!-- End of the table of speeds. -->\n"
BEGIN_GPUS = "<!-- GPUs, written by python/tools/make_speed_table.py. -->\n"
PRECISIONS = ("f32", "f64")
#: The rows: the case of the benchmark, and what a user calls it.
ROWS = {
    "rays_1e4": "one lens, a short trace",
    "rays_1e7": "one lens, a long trace",
    "lens_0": "another lens, off axis",
    "depth_16": "16 events a ray",
    "surfaces_200": "200 mirrors that no ray meets",
    "spheres_100": "100 spheres",
    "mesh_100k": "a mesh of 100,352 triangles",
    "cooke_triplet": "a Cooke triplet, the whole command",
    "cold_start": "one lens, the whole command, shaders not in the driver's cache",
}
#: What the columns of ratios are called.
PEERS = {"optiland": "Optiland (NumPy)", "drjit": "Dr.Jit, a kernel by hand", "mitsuba": "Mitsuba 3 (Embree, f32)"}


def table(report: dict) -> str:
    """A run's rows as Markdown: median rates [M rays/s], of whole commands times [s], and ratios to the peers of the run."""
    cases = {case["name"]: case for case in report["cases"]}
    peers = [name for name in PEERS if name in report["peers"]]
    columns = ["what is traced", "case", "rays", "f32", "f64", *(f"over {PEERS[name]}" for name in peers)]
    rows = [[what, *_row(cases[name], peers)] for name, what in ROWS.items() if name in cases]
    return "\n".join([_line(columns), "|" + "---|" * len(columns), *map(_line, rows)]) + "\n"


def _row(case: dict, peers: list[str]) -> list[str]:
    measured = {m["precision"]: m for m in case["measurements"]}
    rates = [_rate(case, measured[p]) if p in measured else "" for p in PRECISIONS]
    ratios = [_ratios(measured, name) for name in peers]
    return [f"`{case['name']}`", _short(f"{case['num_rays']:.0e}"), *rates, *ratios]


def _rate(case: dict, measured: dict) -> str:
    rate = measured["rays_per_sec"]["median"]
    if case["kind"] == "trace":
        return f"{_rounded(rate / 1e6)} M rays/s"
    return f"{_rounded(case['num_rays'] / rate)} s"


def _ratios(measured: dict, peer: str) -> str:
    ratios = [measured[p]["ratios"].get(peer) if p in measured else None for p in PRECISIONS]
    return " / ".join("" if ratio is None else _rounded(ratio) for ratio in ratios) if any(ratios) else ""


def _rounded(number: float) -> str:
    return f"{number:.0f}" if number >= 100 else f"{number:#.3g}"


def _short(number: str) -> str:
    return number.replace("e+0", "e")


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def heading(report: dict) -> str:
    """What was measured on, when, and beside whom."""
    machine, adapter = report["machine"], report["adapter"]
    parts = [f"{machine['processor']}, {machine['num_cores']} cores", adapter["driver"], report["date"][:10]]
    parts += [f"{name} {versions[name]}" for name, versions in report["peers"].items()]
    return "; ".join([*parts, f"medians of {report['num_runs']} runs"])


def section(folder: str, report: dict, results: str) -> str:
    """A run's table, and what was measured on; ``results`` is the way to the folders."""
    return f"{table(report)}\n{heading(report)}. All figures: [{folder}]({results}/{folder}/bench.csv).\n"


def replaced(text: str, table_of: str, begin: str = BEGIN) -> str:
    """A page with its table made anew."""
    head, rest = text.split(begin, 1)
    tail = rest.split(END, 1)[1]
    return head + begin + "\n" + table_of + "\n" + END + tail


def read_reports() -> dict[str, dict]:
    """What every folder holds, the newest first."""
    reports = [(path.parent.name, json.loads(path.read_text())) for path in RESULTS.glob("*/bench.json")]
    return dict(sorted(reports, key=lambda report: report[1]["date"], reverse=True))


def newest(reports: dict[str, dict], *, of_gpu: bool) -> tuple[str, dict]:
    """The newest run on a GPU, or on a processor, with its folder."""
    return next(pair for pair in reports.items() if (pair[1]["adapter"]["kind"] != "Cpu") == of_gpu)


def pages(reports: dict[str, dict]) -> dict[Path, str]:
    """The text of every page with a table, each made anew."""
    processor, gpu = newest(reports, of_gpu=False), newest(reports, of_gpu=True)
    speed = replaced(SPEED.read_text(), section(*processor, "../benches/results"))
    return {
        README: replaced(README.read_text(), section(*processor, "benches/results")),
        SPEED: replaced(speed, section(*gpu, "../benches/results"), BEGIN_GPUS),
    }


if __name__ == "__main__":
    for page, text in pages(read_reports()).items():
        page.write_text(text)
