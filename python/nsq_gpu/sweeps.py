"""Sweeps: a scene traced again and again, with some of its numbers changed; labelled results with errors."""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from nsq_gpu import placing
from nsq_gpu.display import MOST_ROWS, Displayed, Summary, error_of, number
from nsq_gpu.errors import NsqGpuError, NsqGpuWarning, SceneError, UsageError, warn, with_partial
from nsq_gpu.labelled import MAPS, labels, table, xarray
from nsq_gpu.paths import path_table
from nsq_gpu.units import attributes, identifiers, unit_of

Json = dict[str, Any]
#: Numbers by their names, and what is added to the seed.
Point = tuple[dict[str, float], int]

#: Fluxes of a report beside the detectors', by the names that a sweep has for them.
TOTALS = {"absorbed": "total_flux_absorbed", "bulk absorbed": "total_flux_bulk_absorbed",
          "escaped": "total_flux_escaped", "lost": "total_flux_lost"}
#: Most points that a warning names because they cannot be traced.
_MOST_NAMED = 10


@dataclass(frozen=True, repr=False)
class Sweep(Displayed):
    """The results of a sweep. Its arrays have an axis for each number, in their order; with ``zip`` one axis, ``point``."""

    #: The values of each number, by its name.
    values: dict[str, np.ndarray]
    #: True if the numbers changed together.
    zipped: bool
    #: Fluxes [W] by detector, and ``absorbed``, ``bulk absorbed``, ``escaped`` and ``lost``.
    flux: dict[str, np.ndarray]
    #: Standard errors of detectors' fluxes [W]; NaN where they are not known.
    standard_error: dict[str, np.ndarray]
    #: Maps by detector, with the axes of the numbers first, where they were asked for: W/mm^2, of far fields W/sr. Where
    #: points have maps of different shapes, an array of dtype object holds them.
    maps: dict[str, np.ndarray] = field(default_factory=dict)
    #: Rays of each point.
    num_rays: np.ndarray = field(default_factory=lambda: np.zeros(0))
    #: The table of paths of each point, of dtype object; None if they were not asked for (``paths=True``).
    paths: np.ndarray | None = None
    #: Why a point could not be traced, by its place in the arrays. Its fluxes are NaN.
    refused: dict[tuple[int, ...], str] = field(default_factory=dict)
    #: Rays that detectors' fluxes rest on, where they are fewer than ten; NaN elsewhere.
    rests_on: dict[str, np.ndarray] = field(default_factory=dict)
    #: Upper bounds of detectors' fluxes [W], with 95 % confidence, where these rest on fewer than ten rays; NaN elsewhere.
    upper_bound_95: dict[str, np.ndarray] = field(default_factory=dict)
    #: Detectors' lumens [lm] and their standard errors, of photometric traces.
    luminous_flux: dict[str, np.ndarray] = field(default_factory=dict)
    luminous_flux_standard_error: dict[str, np.ndarray] = field(default_factory=dict)
    #: True if the sweep was stopped. Points that were not traced have 0 rays, and their fluxes are NaN.
    partial: bool = False
    #: The kind of each detector with maps, and the coordinates along their axes; those in which points differ are missing.
    axes: dict[str, tuple[str, dict[str, np.ndarray]]] = field(default_factory=dict)

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
                if np.isfinite(self.upper_bound_95.get(name, np.nan)).any():
                    row[f"{name} upper bound 95 % [W]"] = float(self.upper_bound_95[name][place])
            yield row

    def to_csv(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write a row a point. A number that is not known is an empty cell; a last column says why a point has none.

        Args:
            path: The file. A file that exists already is kept, unless this process wrote it.
            overwrite: True replaces a file that exists.
        """
        has_problems = self.partial or bool(self.refused)
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        for index, ((place, _), row) in enumerate(zip(self.points(), self.rows(), strict=True)):
            if index == 0:
                writer.writerow([_harmless(name) for name in row] + ["problem"] * has_problems)
            if self._is_known(place):
                cells = ["" if math.isnan(value) else value for value in row.values()]
                writer.writerow(cells + [_harmless(self.refused.get(place, ""))] * has_problems)
        if self.partial:
            writer.writerow([""] * len(row) + [f"partial: {self._num_known()} of {math.prod(self.shape)} points"])
        placing.write(path, text.getvalue(), overwrite)

    def to_json(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the points as ``nsq-gpu sweep -o FILE.json`` writes them, but for seeds.

        Args:
            path: The file. A file that exists already is kept, unless this process wrote it.
            overwrite: True replaces a file that exists.
        """
        def entry(index: int, place: tuple[int, ...], numbers: dict[str, float]) -> Json:
            def error(name: str) -> float | None:
                found = self.standard_error.get(name)
                return None if found is None or np.isnan(found[place]) else float(found[place])

            # JSON has finite numbers alone.
            numbers = {name: value if math.isfinite(value) else str(value) for name, value in numbers.items()}
            if place in self.refused:
                return {"index": index, "set": numbers, "error": self.refused[place]}
            def bound(name: str) -> Json:
                found = self.upper_bound_95.get(name)
                if found is None or np.isnan(found[place]):
                    return {}
                return {"rests_on": int(self.rests_on[name][place]), "upper_bound_95": float(found[place])}

            fluxes = {name: {"flux": float(flux[place]), "standard_error": error(name), **bound(name)}
                      for name, flux in self.flux.items()}
            return {"index": index, "set": numbers, "num_rays": int(self.num_rays[place]), "fluxes": fluxes}

        points = [entry(index, *point) for index, point in enumerate(self.points()) if self._is_known(point[0])]
        document = {"num_points": math.prod(self.shape), "num_refused": len(self.refused), "partial": self.partial,
                    "points": points}
        placing.write(path, json.dumps(document, indent=2, allow_nan=False) + "\n", overwrite)

    def _is_known(self, place: tuple[int, ...]) -> bool:
        """Return whether a stop came after a point."""
        return bool(self.num_rays[place]) or place in self.refused

    def _num_known(self) -> int:
        return sum(self._is_known(place) for place, _ in self.points())

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with a row a point: numbers, ``NAME_flux``, ``NAME_standard_error``, ...

        ``attrs["units"]`` has the columns' units.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        points = [point for _, point in self.points()]
        plain = identifiers(self.values)
        columns: dict[str, Any] = {plain[name]: [point[name] for point in points] for name in self.values}
        units = {plain[name]: unit for name in self.values if (unit := unit_of(name)) is not None}
        for name, (found, unit) in self._of_points().items():
            columns[name] = found.ravel()
            units |= {name: unit} if unit else {}
        return table(columns, units)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset``: variables ``NAME_flux``, ``NAME_standard_error`` and ``NAME_map``, with units.

        Coordinates are the numbers by their names, such as ``L1.r1`` in mm. Spaces in names become underscores.

        Raises:
            MissingLibraryError: xarray is not installed (``pip install 'nsq-gpu[xarray]'``).
        """
        library = xarray("to_xarray")
        plain = identifiers(self.values)
        names = ["point"] if self.zipped else list(plain.values())
        coordinates: dict[str, Any] = {plain[name]: ("point" if self.zipped else plain[name], values, attributes(name))
                                       for name, values in self.values.items()}
        variables: dict[str, Any] = {name: (names, found, {"units": unit} if unit else {})
                                     for name, (found, unit) in self._of_points().items()}
        of_detectors = identifiers(self.flux)
        for name, found in self.maps.items():
            (kind, of_axes), plain_name = self.axes[name], of_detectors[name]
            # Maps of different shapes lie in an array of objects, without axes of their own.
            axes = [f"{plain_name}_{axis}" for axis in MAPS[kind].axes] if found.dtype != object else []
            coordinates |= labels(kind, of_axes, plain_name) if axes else {}
            variables[f"{plain_name}_map"] = ([*names, *axes], found, {"units": MAPS[kind].unit})
        refused = [f"point {place}: {problem}" for place, problem in self.refused.items()]
        return library.Dataset(variables, coordinates, {"partial": int(self.partial), "refused": "\n".join(refused)})

    def _of_points(self) -> dict[str, tuple[np.ndarray, str]]:
        """Return what each point has a number of, by names without spaces, with the unit."""
        found: dict[str, tuple[np.ndarray, str]] = {}
        for name, plain in identifiers(self.flux).items():
            for what, arrays, unit in (("flux", self.flux, "W"), ("standard_error", self.standard_error, "W"),
                                       ("rests_on", self.rests_on, "1"), ("upper_bound_95", self.upper_bound_95, "W"),
                                       ("luminous_flux", self.luminous_flux, "lm"),
                                       ("luminous_flux_standard_error", self.luminous_flux_standard_error, "lm")):
                if name in arrays:
                    found[f"{plain}_{what}"] = arrays[name], unit
        return found | {"num_rays": (self.num_rays, "1")}

    def _summary(self) -> Summary:
        shown = [name for name in self.flux if name in self.standard_error or np.nansum(self.flux[name])]
        headings = [f"{name} [{unit}]" if (unit := unit_of(name)) else name for name in self.values]
        headings += [part for name in shown for part in ([f"{name} [W]", "error [W]"] if name in self.standard_error
                                                         else [f"{name} [W]"])]
        rows = []
        for place, point in itertools.islice(self.points(), MOST_ROWS):
            row = [number(value) for value in point.values()]
            for name in shown:
                row.append(number(self.flux[name][place]))
                if name in self.standard_error:
                    row.append(error_of(self.standard_error[name][place], self.rests_on[name][place]))
            rows.append(row)
        notes = [f"{len(self.refused)} points cannot be traced: see `refused`"] if self.refused else []
        notes += [f"partial: {self._num_known()} of {math.prod(self.shape)} points"] if self.partial else []
        size = " x ".join(map(str, self.shape))
        return Summary(f"Sweep: {size} points of {', '.join(self.values)}", headings, rows, math.prod(self.shape), notes)


def run(trace_all: Callable[[list[Point]], Iterable[Any]], numbers: Mapping[str, Sequence[float]], zipped: bool,
        common_draws: bool, keep_maps: bool) -> Sweep:
    """Trace all points by a function that yields an answer of a session for each, in their order.

    Of a point that cannot be traced, the function yields the error. Whatever ends the function early, a stop, a timeout or
    a lost device, takes the points before it along, as ``partial``.
    """
    values = {name: _values(name, given) for name, given in numbers.items()}
    if not values:
        raise UsageError("a sweep needs a number that changes, such as {'L1.r1': [50, 55, 60]}")
    lengths = {name: len(given) for name, given in values.items()}
    if zipped and len(set(lengths.values())) > 1:
        raise UsageError(f"zip=True needs as many values for each number; there are {lengths}")
    combinations = zip(*values.values(), strict=True) if zipped else itertools.product(*values.values())
    shape = (len(next(iter(values.values()))),) if zipped else tuple(lengths.values())
    points = [(dict(zip(values, map(float, point), strict=True)), 0 if common_draws else index)
              for index, point in enumerate(combinations)]
    found = Sweep(values, zipped, {}, {}, num_rays=np.zeros(shape, dtype=np.int64))
    bad = {index: _not_finite(point) for index, (point, _) in enumerate(points)}
    answers = iter(trace_all([point for index, point in enumerate(points) if bad[index] is None]))
    first: NsqGpuError | None = None
    problems: list[str] = []
    try:
        for index, (place, (point, _)) in enumerate(zip(np.ndindex(*shape), points, strict=True)):
            answer = bad[index] or next(answers)
            if not isinstance(answer, NsqGpuError):
                found = _with(found, place, answer, keep_maps)
                continue
            # What is wrong with the first point's names or options is wrong with all points'.
            if index == 0 and isinstance(answer, UsageError):
                raise answer
            problem = str(answer).removeprefix("nsq-gpu: ")
            label = f"point {index} ({', '.join(f'{name} = {value:g}' for name, value in point.items())})"
            first = first or type(answer)(f"{label}: {problem}", answer.exit_code, answer.stderr)
            found.refused[place] = problem
            problems.append(f"{label} is left out: {problem}")
    except (KeyboardInterrupt, NsqGpuError) as stop:
        raise with_partial(stop, dataclasses.replace(found, partial=True) if found.num_rays.any() else None)
    if first is not None and len(found.refused) == len(points):
        raise first
    if problems:
        more = f"\nand {len(problems) - _MOST_NAMED} more: see `refused`" if len(problems) > _MOST_NAMED else ""
        warn("\n".join(problems[:_MOST_NAMED]) + more, NsqGpuWarning)
    return found


def _with(found: Sweep, place: tuple[int, ...], answer: Any, keep_maps: bool) -> Sweep:
    """Put an answer into the arrays of a sweep."""
    report = answer.report

    def put(arrays: dict[str, np.ndarray], name: str, value: Any) -> None:
        value = np.asarray(value)
        if name not in arrays:
            arrays[name] = np.full((*found.shape, *value.shape), np.nan)
        if arrays[name].dtype != object and arrays[name].shape[len(found.shape):] != value.shape:
            maps = np.full(found.shape, None, dtype=object)
            for other in np.ndindex(*found.shape):
                if found.num_rays[other]:
                    maps[other] = arrays[name][other]
            arrays[name] = maps
        arrays[name][place] = value

    paths = found.paths
    if report.get("paths") is not None:
        paths = np.full(found.shape, None, dtype=object) if paths is None else paths
        paths[place] = path_table(report["paths"], split_depth=report.get("split_depth", 0))
    for name, entry in report["detectors"].items():
        put(found.flux, name, entry["total_flux"])
        error = entry["total_flux_standard_error"]
        put(found.standard_error, name, np.nan if error is None else error)
        put(found.rests_on, name, entry.get("rests_on", np.nan))
        put(found.upper_bound_95, name, entry.get("upper_bound_95", np.nan))
        if keep_maps and entry["kind"] in MAPS:
            arrays, kind = answer.arrays(name), entry["kind"]
            put(found.maps, name, arrays[MAPS[kind].array])
            given = {axis: arrays[key] for axis, (key, _) in MAPS[kind].axes.items()}
            known = found.axes.get(name, (kind, given))[1]
            found.axes[name] = kind, {axis: values for axis, values in known.items() if np.array_equal(values, given[axis])}
    for name, seen in (report.get("photometry") or {"detectors": {}})["detectors"].items():
        error = seen["flux_lm_standard_error"]
        put(found.luminous_flux, name, seen["flux_lm"])
        put(found.luminous_flux_standard_error, name, np.nan if error is None else error)
    for name, key in TOTALS.items():
        # A detector may have the name of a total.
        put(found.flux, f"{name} (total)" if name in report["detectors"] else name, report[key])
    # Last: a point has rays when all of its numbers are there.
    found.num_rays[place] = report["num_rays_total"]
    return dataclasses.replace(found, paths=paths)


def _values(name: str, given: Any) -> np.ndarray:
    """Return the values of a number: one axis of floats. Tensors are values, whether they want gradients or not."""
    def plain(value: Any) -> Any:
        return value.detach().cpu().numpy() if hasattr(value, "detach") else value

    try:
        values = plain(given)
        if not isinstance(values, np.ndarray) and not np.isscalar(values):
            values = list(map(plain, values))
        values = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name}: {given!r} are no numbers; give a list of numbers") from error
    if values.ndim > 1:
        raise UsageError(f"{name} has values of the shape {values.shape}; give them along one axis, such as values.ravel()")
    if values.size == 0:
        raise UsageError(f"{name} has no values; give at least one")
    return np.atleast_1d(values)


def _not_finite(point: Mapping[str, float]) -> SceneError | None:
    """Return the error of a point of which a number is NaN or infinite."""
    wrong = next((name for name, value in point.items() if not math.isfinite(value)), None)
    return None if wrong is None else SceneError(f"{wrong} is {point[wrong]}; give a finite number")


def _harmless(text: str) -> str:
    """Return a text that no spreadsheet takes for a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r", "\n")) else text
