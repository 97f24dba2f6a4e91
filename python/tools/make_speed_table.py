"""Writes tables of speeds from every bench.json in a folder of benches/results/: into docs/speed.md the newest of each
case on processors and of each on GPUs, into the README some of the former, into benches/README.md how these stand with
what was set out to be reached, into benches/results/README.md all of them.

usage, in python/: python -m tools.make_speed_table
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
SPEED = ROOT / "docs" / "speed.md"
BENCHES = ROOT / "benches" / "README.md"
RESULTS = ROOT / "benches" / "results"
ALL_TABLES = RESULTS / "README.md"
BEGIN = "<!-- Written by python/tools/make_speed_table.py. -->\n"
END = "<!-- End of the table of speeds. -->\n"
BEGIN_GPUS = "<!-- GPUs, written by python/tools/make_speed_table.py. -->\n"
PRECISIONS = ("f32", "f64")
#: What the README shows: a lens in a short and a long trace, many events, many surfaces, a mesh, a whole command.
HIGHLIGHTS = ("rays_1e5", "rays_1e7", "depth_16", "surfaces_200", "mesh_100k", "cooke_triplet")
TITLE = """# Measured speeds

What was measured on which machine, and what the code could do by then, is said in [`benches/`](../README.md#the-files);
`python -m tools.make_speed_table` (in `python/`) writes this page from the files here, the newest first.

"""


def newest_of_each(reports: dict[str, dict]) -> list[tuple[str, dict]]:
    """Every case with the newest folder that has it, in the order in which cases came to be measured."""
    oldest_first = list(reversed(reports.items()))
    newest = {case["name"]: (folder, case) for folder, report in oldest_first for case in report["cases"]}
    return list(newest.values())


def summary(reports: dict[str, dict], results: str = "benches/results", names: tuple[str, ...] | None = None) -> str:
    """The newest of each case, or of those with these names, as Markdown, with the folder it is from; ``results`` is the
    way there, from the root by default.
    """
    rows = [(folder, case) for folder, case in newest_of_each(reports) if names is None or case["name"] in names]
    lines = table([case for _, case in rows], [f"[{folder}]({results}/{folder}/bench.csv)" for folder, _ in rows])
    return "\n".join(lines) + "\n"


def table(cases: list[dict], folders: list[str] | None = None) -> list[str]:
    """The cases as Markdown: median rates [M rays/s], of whole commands times [s], and ratios to the peers."""
    peers = sorted({peer["name"] for case in cases for peer in case["peers"]})
    columns = ["case", "rays", "f32 [M rays/s]", "f64 [M rays/s]", *(f"f32 / f64 over {name}" for name in peers)]
    rows = [_row(case, peers) for case in cases]
    if folders is not None:
        columns.append("measured")
        rows = [[*row, folder] for row, folder in zip(rows, folders, strict=True)]
    return [_line(columns), "|" + "---|" * len(columns), *map(_line, rows)]


def _row(case: dict, peers: list[str]) -> list[str]:
    measured = by_precision(case)
    rates = [_rate(case, measured[p]) if p in measured else "" for p in PRECISIONS]
    ratios = [_ratios(measured, name) for name in peers]
    return [f"`{case['name']}`", _short(f"{case['num_rays']:.0e}"), *rates, *ratios]


def by_precision(case: dict) -> dict[str, dict]:
    """The measurements of a case."""
    return {m["precision"]: m for m in case["measurements"]}


def _rate(case: dict, measured: dict) -> str:
    if case["kind"] == "trace":
        return f"{measured['rays_per_sec']['median'] / 1e6:.3g}"
    return f"{seconds(case, measured):.3g} s"


def seconds(case: dict, measured: dict) -> float:
    """Median time of a run [s]."""
    return case["num_rays"] / measured["rays_per_sec"]["median"]


def _short(number: str) -> str:
    return number.replace("e+0", "e")


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _ratios(measured: dict, peer: str) -> str:
    ratios = [measured[p]["ratios"].get(peer) if p in measured else None for p in PRECISIONS]
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
    return f"## [{folder}]({folder}/bench.csv)\n\n{heading(report)}.\n\n" + "\n".join(lines) + "\n"


def all_tables(reports: dict[str, dict]) -> str:
    """The page of all tables."""
    return TITLE + "\n".join(section(folder, report) for folder, report in reports.items())


@dataclass(frozen=True)
class Bar:
    """What was set out to be reached, in f32 and in f64."""

    what: str
    #: Lower ends, or upper ends where less is better.
    ends: tuple[float, float]
    #: The figure of a report's cases in a precision; `KeyError` where the report does not have it.
    figure: Callable[[dict[str, dict], str], float]
    unit: str = ""
    less_is_better: bool = False

    def line(self, reports: dict[str, dict]) -> str:
        """The newest report's figures against it."""
        for folder, report in reports.items():
            cases = {case["name"]: case for case in report["cases"]}
            try:
                figures = [self.figure(cases, precision) for precision in PRECISIONS]
            except KeyError:
                continue
            met = [self.is_met(*pair) for pair in zip(figures, self.ends, strict=True)]
            is_met = "yes" if all(met) else f"in {PRECISIONS[met.index(True)]}" if any(met) else "no"
            link = f"[{folder}](results/{folder}/bench.csv)"
            return _line([self.what, self._both(self.ends), self._both(figures), is_met, link])
        return _line([self.what, self._both(self.ends), "not measured", "", ""])

    def is_met(self, figure: float, end: float) -> bool:
        """Whether a figure reaches its end."""
        return figure <= end if self.less_is_better else figure >= end

    def _both(self, figures: list[float] | tuple[float, float]) -> str:
        return " / ".join(f"{figure:.3g}" for figure in figures) + self.unit


def over(peer: str, *names: str) -> Callable[[dict[str, dict], str], float]:
    """The least ratio of some cases to a peer."""
    return lambda cases, precision: min(by_precision(cases[name])[precision]["ratios"][peer] for name in names)


def million_casts(name: str) -> Callable[[dict[str, dict], str], float]:
    """Casts of a case [M/s]."""
    return lambda cases, precision: by_precision(cases[name])[precision]["casts_per_sec"]["median"] / 1e6


def times(name: str, other: str) -> Callable[[dict[str, dict], str], float]:
    """The time of a case over that of another one."""
    return lambda cases, precision: time_of(name)(cases, precision) / time_of(other)(cases, precision)


def time_of(name: str) -> Callable[[dict[str, dict], str], float]:
    """The time of a case [s]."""
    return lambda cases, precision: seconds(cases[name], by_precision(cases[name])[precision])


LENSES = [f"lens_{i}" for i in range(10)]
#: Rates of peers on the machine of the first day: NumPy's 0.35 M rays/s of the lens, Dr.Jit's 114 (f32) and 79 (f64).
BARS = [
    Bar("`rays_1e7`, over Dr.Jit", (80 / 114, 0.75), over("drjit", "rays_1e7")),
    Bar("`rays_1e7`, over Dr.Jit: the goal", (1, 1), over("drjit", "rays_1e7")),
    Bar("`lens_0` to `lens_9`, the least over NumPy", (80 / 0.35, 60 / 0.35), over("optiland", *LENSES)),
    Bar("`depth_16`", (300, 300), million_casts("depth_16"), " M casts/s"),
    Bar("`depth_32`", (300, 300), million_casts("depth_32"), " M casts/s"),
    Bar("`surfaces_200`, time over `surfaces_0`", (2, 2), times("surfaces_200", "surfaces_0"), less_is_better=True),
    Bar("`surfaces_1000`, time over `surfaces_0`", (3, 3), times("surfaces_1000", "surfaces_0"), less_is_better=True),
    Bar("`spheres_100`, over Mitsuba (f32)", (1, 1), over("mitsuba", "spheres_100")),
    Bar("`mesh_100k`, over Mitsuba (f32)", (1, 1), over("mitsuba", "mesh_100k")),
    Bar("`cooke_triplet`, whole command over NumPy's", (50, 50), over("optiland", "cooke_triplet")),
    Bar("`condenser_array`, whole command over NumPy's", (50, 50), over("optiland", "condenser_array")),
    Bar("`cold_start`, whole command", (0.25, 0.25), time_of("cold_start"), " s", less_is_better=True),
]


def bars(reports: dict[str, dict]) -> str:
    """How it stands with the bars, as seen from benches/."""
    columns = ["what", "bar, f32 / f64", "measured last, f32 / f64", "met", "where"]
    lines = [_line(columns), "|" + "---|" * len(columns), *(bar.line(reports) for bar in BARS)]
    return "\n".join(lines) + "\n"


def replaced(text: str, table_of: str, begin: str = BEGIN) -> str:
    """A page with its table made anew."""
    head, rest = text.split(begin, 1)
    tail = rest.split(END, 1)[1]
    return head + begin + "\n" + table_of + "\n" + END + tail


def read_reports() -> dict[str, dict]:
    """What every folder holds, the newest first: folders of one day are named for other things."""
    reports = [(path.parent.name, json.loads(path.read_text())) for path in RESULTS.glob("*/bench.json")]
    return dict(sorted(reports, key=lambda report: report[1]["date"], reverse=True))


def is_of_gpu(report: dict) -> bool:
    """Whether a report is of a GPU, not of a processor."""
    return report["adapter"]["kind"] != "Cpu"


def pages(reports: dict[str, dict]) -> dict[Path, str]:
    """The text of every page with a table, each made anew."""
    of_processors = {folder: report for folder, report in reports.items() if not is_of_gpu(report)}
    of_gpus = {folder: report for folder, report in reports.items() if is_of_gpu(report)}
    speed = replaced(SPEED.read_text(), summary(of_processors, "../benches/results"))
    return {
        README: replaced(README.read_text(), summary(of_processors, names=HIGHLIGHTS)),
        SPEED: replaced(speed, summary(of_gpus, "../benches/results"), BEGIN_GPUS),
        BENCHES: replaced(BENCHES.read_text(), bars(of_processors)),
        ALL_TABLES: all_tables(reports),
    }


if __name__ == "__main__":
    for page, text in pages(read_reports()).items():
        page.write_text(text)
