"""Sweeps: a scene traced again and again, with some of its numbers changed; labelled results with errors."""

from __future__ import annotations

import csv
import itertools
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.paths import path_table

Json = dict[str, Any]
#: Numbers by their names, and what is added to the seed.
Point = tuple[dict[str, float], int]

#: Fluxes of a report beside those of detectors, by the names that a sweep has for them.
TOTALS = {"absorbed": "total_flux_absorbed", "bulk absorbed": "total_flux_bulk_absorbed",
          "escaped": "total_flux_escaped", "lost": "total_flux_lost"}
#: The array of a detector's map, by its kind.
MAPS = {"irradiance": "irradiance", "spectral": "irradiance", "far_field": "intensity"}


@dataclass(frozen=True)
class Sweep:
    """The results of a sweep. Its arrays have an axis for each number, in their order; with ``zip`` one axis, ``point``."""

    #: The values of each number, by its name.
    values: dict[str, np.ndarray]
    #: True if the numbers changed together.
    zipped: bool
    #: Fluxes [W] by detector, and ``absorbed``, ``bulk absorbed``, ``escaped`` and ``lost``.
    flux: dict[str, np.ndarray]
    #: Standard errors of detectors' fluxes [W]; NaN where they are not known.
    standard_error: dict[str, np.ndarray]
    #: Maps by detector, with the axes of the numbers first, where they were asked for: W/mm^2, of far fields W/sr.
    maps: dict[str, np.ndarray] = field(default_factory=dict)
    #: Rays of each point.
    num_rays: np.ndarray = field(default_factory=lambda: np.zeros(0))
    #: The table of paths of each point, of dtype object; None where they were not asked for (``paths=True``).
    paths: np.ndarray | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """The lengths of the axes."""
        lengths = tuple(len(values) for values in self.values.values())
        return lengths[:1] if self.zipped else lengths

    def points(self) -> Iterator[tuple[tuple[int, ...], dict[str, float]]]:
        """Yield each point: its place in the arrays, and its numbers."""
        for place in np.ndindex(*self.shape):
            at = place * len(self.values) if self.zipped else place
            yield place, {name: float(values[i]) for (name, values), i in zip(self.values.items(), at, strict=True)}

    def rows(self) -> Iterator[dict[str, float]]:
        """Yield each point as a row: numbers, fluxes [W] and their standard errors [W]."""
        for place, numbers in self.points():
            row = dict(numbers)
            for name, flux in self.flux.items():
                row[f"{name} [W]"] = float(flux[place])
                if name in self.standard_error:
                    row[f"{name} standard error [W]"] = float(self.standard_error[name][place])
            yield row

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write a row a point."""
        rows = list(self.rows())
        with Path(path).open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, fieldnames=list(rows[0]) if rows else [])
            writer.writeheader()
            writer.writerows(rows)

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the points as ``nsq-gpu sweep -o FILE.json`` writes them, but for seeds."""
        def entry(place: tuple[int, ...], numbers: dict[str, float]) -> Json:
            def error(name: str) -> float | None:
                found = self.standard_error.get(name)
                return None if found is None or np.isnan(found[place]) else float(found[place])

            fluxes = {name: {"flux": float(flux[place]), "standard_error": error(name)} for name, flux in self.flux.items()}
            return {"set": numbers, "num_rays": int(self.num_rays[place]), "fluxes": fluxes}

        document = {"points": [entry(*point) for point in self.points()]}
        Path(path).write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset``: variables ``NAME flux``, ``NAME standard_error`` and ``NAME map``, with units.

        Raises:
            NsqGpuError: xarray is not installed (``pip install nsq-gpu[xarray]``).
        """
        try:
            import xarray
        except ImportError:
            raise NsqGpuError("xarray is not installed; `pip install nsq-gpu[xarray]`, or use to_csv") from None
        names = ["point"] if self.zipped else list(self.values)
        coordinates = {name: ("point" if self.zipped else name, values) for name, values in self.values.items()}
        variables = {}
        for name, flux in self.flux.items():
            variables[f"{name} flux"] = (names, flux, {"units": "W"})
        for name, error in self.standard_error.items():
            variables[f"{name} standard_error"] = (names, error, {"units": "W"})
        for name, found in self.maps.items():
            axes = [f"{name} axis {i}" for i in range(found.ndim - len(names))]
            variables[f"{name} map"] = ([*names, *axes], found, {"units": "W/mm^2, of far fields W/sr"})
        return xarray.Dataset(variables, coordinates)


def run(trace_all: Callable[[list[Point]], Iterable[Any]], numbers: Mapping[str, Sequence[float]], zipped: bool,
        common_draws: bool, keep_maps: bool) -> Sweep:
    """Trace all points by a function that yields an answer of a session for each, in their order."""
    values = {name: np.atleast_1d(np.asarray(given, dtype=float)) for name, given in numbers.items()}
    if not values:
        raise UsageError("a sweep needs a number that changes, such as {'L1.r1': [50, 55, 60]}")
    lengths = {name: len(given) for name, given in values.items()}
    if zipped and len(set(lengths.values())) > 1:
        raise UsageError(f"zip=True needs as many values for each number; there are {lengths}")
    combinations = zip(*values.values(), strict=True) if zipped else itertools.product(*values.values())
    shape = (len(next(iter(values.values()))),) if zipped else tuple(lengths.values())
    flux: dict[str, np.ndarray] = {}
    errors: dict[str, np.ndarray] = {}
    maps: dict[str, np.ndarray] = {}
    num_rays = np.zeros(shape, dtype=np.int64)
    paths: np.ndarray | None = None

    def put(arrays: dict[str, np.ndarray], name: str, place: tuple[int, ...], value: Any) -> None:
        value = np.asarray(value)
        if name not in arrays:
            arrays[name] = np.full((*shape, *value.shape), np.nan)
        arrays[name][place] = value

    points = [(dict(zip(values, map(float, point), strict=True)), 0 if common_draws else index)
              for index, point in enumerate(combinations)]
    for place, answer in zip(np.ndindex(*shape), trace_all(points), strict=True):
        report = answer.report
        num_rays[place] = report["num_rays_total"]
        if report.get("paths") is not None:
            paths = np.full(shape, None, dtype=object) if paths is None else paths
            paths[place] = path_table(report["paths"])
        for name, entry in report["detectors"].items():
            put(flux, name, place, entry["total_flux"])
            error = entry["total_flux_standard_error"]
            put(errors, name, place, np.nan if error is None else error)
            if keep_maps and entry["kind"] in MAPS:
                put(maps, name, place, answer.arrays(name)[MAPS[entry["kind"]]])
        for name, key in TOTALS.items():
            # A detector may have the name of a total.
            put(flux, f"{name} (total)" if name in report["detectors"] else name, place, report[key])
    return Sweep(values, zipped, flux, errors, maps, num_rays, paths)
