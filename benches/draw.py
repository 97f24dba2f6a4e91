"""Draws what was measured: ``python benches/draw.py DIR`` for each table of ``nsq-bench -o DIR`` or ``accuracy.py -o DIR``.

==============  ========================================
``bench.json``      ``bench.png``: rays per second of every case
``growth.txt``      ``growth.png``: how the cost of a ray grows
``accuracy.csv``    ``accuracy.png``, ``accuracy_flux.png``: error against time
``numerical.csv``   ``numerical.png``: the error of arithmetic
==============  ========================================
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

Row = dict[str, Any]

#: What ``accuracy.py`` draws.
OF_ACCURACY = ("accuracy.png", "accuracy_flux.png", "numerical.png")


def folder(path: Path, note: str = "") -> list[str]:
    """Draw every table of a folder, and return the names of the pictures."""
    drawn = []
    for name, draw in (("bench.json", bars), ("growth.txt", growth), ("accuracy.csv", accuracy), ("numerical.csv", numerical)):
        if (path / name).exists():
            drawn += draw(path, note)
    return drawn


def _written(figure: plt.Figure, path: Path, title: str, note: str) -> str:
    figure.suptitle(f"{title}\n{note}" if note else title, fontsize=10)
    figure.savefig(path, dpi=120)
    plt.close(figure)
    return path.name


def _panels(count: int, height: float = 3.4) -> tuple[plt.Figure, list[plt.Axes]]:
    """Panels in rows of three, on logarithmic axes."""
    rows = -(-count // 3)
    figure, axes = plt.subplots(rows, min(count, 3), figsize=(4.2 * min(count, 3), height * rows + 1), squeeze=False,
                                layout="constrained")
    for unused in axes.flat[count:]:
        unused.set_visible(False)
    for panel in axes.flat:
        panel.set(xscale="log", yscale="log")
        panel.grid(alpha=0.3)
    return figure, list(axes.flat[:count])


def _key(figure: plt.Figure, panels: list[plt.Axes]) -> None:
    """One key for all panels, of every curve in any of them."""
    lines = {line.get_label(): line for panel in panels for line in panel.get_lines() if not line.get_label().startswith("_")}
    figure.legend(list(lines.values()), list(lines), loc="outside lower center", ncols=4, fontsize=8)


def bars(path: Path, note: str) -> list[str]:
    """Rays per second of every case and engine: medians of the runs, and their range."""
    report = json.loads((path / "bench.json").read_text())
    if not report["cases"]:
        return []
    rates = [(case["name"], f"{engine['name']} {engine['precision']}", engine["rays_per_sec"])
             for case in report["cases"]
             for engine in [*({"name": report["program"], **ours} for ours in case["measurements"]), *case["peers"]]]
    cases, engines = (list(dict.fromkeys(column)) for column in list(zip(*rates, strict=True))[:2])
    figure, axes = plt.subplots(figsize=(8, 0.6 + 0.16 * len(rates) + 0.1 * len(cases)), layout="constrained")
    places, place = {}, 0.0
    for name, engine, _ in rates:
        place += 1.0 if any(case == name for case, _ in places) else 1.8
        places[name, engine] = place
    for index, engine in enumerate(engines):
        own = [(places[name, engine], rate) for name, of, rate in rates if of == engine]
        median = [rate["median"] for _, rate in own]
        reach = [[abs(rate["median"] - rate[end]) for _, rate in own] for end in ("min", "max")]
        axes.barh([at for at, _ in own], median, 0.9, xerr=reach, label=engine, color=f"C{index % 10}",
                  error_kw={"linewidth": 0.8})
    middles = [sum(own) / len(own) for own in ([at for (case, _), at in places.items() if case == name] for name in cases)]
    kinds = {case["name"]: case["kind"] for case in report["cases"]}
    axes.set_yticks(middles, [name if kinds[name] == "trace" else f"{name}, whole command" for name in cases], fontsize=7)
    axes.set(xscale="log", xlabel="rays per second", ylim=(place + 1, 0.5))
    axes.grid(axis="x", alpha=0.3)
    axes.legend(fontsize=8)
    head = f"{report['program']} {report['version']}, {report['date'][:10]}, {report['num_runs']} runs"
    return [_written(figure, path / "bench.png", f"Rays per second on {report['adapter']['name']}",
                     "; ".join(filter(None, (head, report["note"], note))))]


def growth(path: Path, note: str) -> list[str]:
    """Time of a ray over mirrors, depth and rays, at the least depth and at the greatest."""
    head, _, _, *lines = (path / "growth.txt").read_text().splitlines()
    rows = [[float(cell) for cell in line.split()] for line in lines]
    # The sweep over depths comes second: the first point with more than two depths.
    points: list[list[list[float]]] = []
    for row in rows:
        if points and points[-1][0][:2] == row[:2] and row[2] > points[-1][-1][2]:
            points[-1].append(row)
        else:
            points.append([row])
    depths = next(index for index, point in enumerate(points) if len(point) > 2)
    figure, panels = _panels(3)
    for panel, name, column, own in ((panels[0], "mirrors", 0, points[:depths]), (panels[2], "rays", 1, points[depths + 1:])):
        for end, style in ((0, "C0o-"), (-1, "C1s--")):
            panel.plot([point[end][column] for point in own], [point[end][3] / point[end][1] for point in own], style,
                       label=f"at most {own[0][end][2]:g} events")
        panel.set(title=name, xlabel="number")
    panels[1].plot([row[2] for row in points[depths]], [row[3] / row[1] for row in points[depths]], "C2^-")
    panels[1].set(title="most events", xlabel="number")
    panels[0].set_ylabel("time a ray [s]")
    _key(figure, panels)
    return [_written(figure, path / "growth.png", "How the cost grows", f"mirrors in random places, {head}{note and '; '}{note}")]


def _rows(path: Path) -> list[Row]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def accuracy(path: Path, note: str) -> list[str]:
    """Error of the map and of the flux against time, a panel a scene."""
    rows = _rows(path / "accuracy.csv")
    scenes = list(dict.fromkeys((row["scene"], row["detector"]) for row in rows))
    labels = list(dict.fromkeys(_label(row) for row in rows))
    pictures = []
    for name, what, column, floor in (("accuracy.png", "the map", "map_rms_error", "answer_map_error"),
                                      ("accuracy_flux.png", "the flux", "flux_error", "answer_flux_error")):
        figure, panels = _panels(len(scenes))
        for panel, scene in zip(panels, scenes, strict=True):
            own = [row for row in rows if (row["scene"], row["detector"]) == scene and float(row[column]) > 0]
            for index, label in enumerate(labels):
                curve = [row for row in own if _label(row) == label]
                panel.plot([float(row["median_seconds"]) for row in curve], [100 * float(row[column]) for row in curve],
                           f"C{index % 10}o{'--' if index >= 10 else '-'}", markersize=3, linewidth=1, label=label)
            if own:
                panel.axhline(100 * float(own[0][floor]), color="grey", linestyle="--", linewidth=0.8)
            panel.set(title=": ".join(scene), xlabel="time from the first ray to the map [s]")
        panels[0].set_ylabel(f"RMS error of {what} [%]")
        _key(figure, panels)
        pictures.append(_written(figure, path / name, f"Error of {what} against time",
                                 f"{note}\neach point has four times as many rays; dashed: the error of the answer itself"))
    return pictures


def _label(row: Row) -> str:
    return row["method"] if row["engine"] == "nsq-gpu" else row["engine"]


def numerical(path: Path, note: str) -> list[str]:
    """Error of arithmetic against the time of a ray, from the coarsest tier to the finest."""
    rows = _rows(path / "numerical.csv")
    figure, panels = _panels(3)
    for panel, title, column in zip(panels, ("distance on the detector, RMS [mm]", "greatest distance [mm]", "flux of a ray, RMS"),
                                    ("position_rms_mm", "position_max_mm", "flux_rms"), strict=True):
        for scene in dict.fromkeys(row["scene"] for row in rows):
            own = [row for row in rows if row["scene"] == scene and float(row[column]) > 0]
            panel.plot([float(row["ns_per_ray"]) for row in own], [float(row[column]) for row in own], "o-", label=scene)
        panel.set(title=title, xlabel="time of a ray [ns]")
    _key(figure, panels)
    return [_written(figure, path / "numerical.png", "Error of arithmetic against time", note)]


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        for picture in folder(Path(argument)):
            print(f"written: {Path(argument) / picture}")
