"""Compares two results of one scene: ours with the oracle's, or the oracle's with its own.

Both are dictionaries as ``tests.oracle.trace`` returns them. Ray by ray the two agree to rounding, so counts must be
equal and maps equal within a tiny part of their peak. Chaotic scenes, where rounding decides the path, are compared
as samples of one distribution instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import stats
from scipy.spatial import cKDTree

from tests.oracle import COUNTS, FLUXES, Json

#: Largest difference of a map's bin, in units of the map's peak.
MAP_LIMIT = 1e-9
#: Largest relative difference of a total.
TOTAL_LIMIT = 1e-11
#: A total below this fraction of the launched flux is compared as if it were as large: it is a difference of larger
#: numbers, or a sum of few.
TOTAL_FLOOR = 1e-3
#: Largest difference of a ray database's column, in units of the column's largest magnitude.
ROW_LIMIT = 1e-9
#: Largest relative difference of an axis.
AXIS_LIMIT = 1e-12
#: Probability that a correct tracer fails the statistical comparison of a scene.
SIGNIFICANCE = 1e-3
#: Bins with fewer expected hits per run are pooled, because the test takes a bin's mean for normal.
MIN_HITS = 25.0

MAP_KEYS = {"irradiance": "irradiance", "spectral": "irradiance", "far_field": "intensity"}
AXIS_KEYS = {
    "irradiance": ("x_coords", "y_coords"),
    "spectral": ("x_coords", "y_coords", "wavelengths"),
    "far_field": ("theta", "phi"),
}
ROW_KEYS = ("x", "y", "z", "L", "M", "N", "flux", "wavelength")


@dataclass
class Agreement:
    """The worst deviations found, and what broke a limit."""

    worst: dict[str, float] = field(default_factory=lambda: {"map": 0.0, "total": 0.0, "rows": 0.0})
    count_differences: dict[str, int] = field(default_factory=dict)
    violations: list[str] = field(default_factory=list)

    def note(self, kind: str, what: str, deviation: float, limit: float) -> None:
        # A NaN is larger than every limit.
        deviation = float("inf") if np.isnan(deviation) else float(deviation)
        self.worst[kind] = max(self.worst.get(kind, 0.0), deviation)
        if deviation > limit:
            self.violations.append(f"{what}: {deviation:.3g} > {limit:.0e}")

    def count(self, what: str, ours: Any, theirs: Any) -> None:
        if ours != theirs:
            if isinstance(theirs, int) and isinstance(ours, int):
                self.count_differences[what] = ours - theirs
            self.violations.append(f"{what}: {ours!r}, not {theirs!r}")


def compare(ours: Json, theirs: Json, capped: Json | None = None) -> Agreement:
    """Compare two results ray for ray. ``capped`` maps capped ray databases to their ``max_rays``.

    ``theirs`` is then the result without the caps, since which rows a cap keeps depends on the batches.
    """
    capped = capped or {}
    theirs = _with_capped_totals(ours, theirs, capped)
    agreement = Agreement()
    for name in COUNTS:
        agreement.count(name, ours[name], theirs[name])
    for name in FLUXES:
        agreement.note("total", name, _total_deviation(ours[name], theirs[name], theirs), TOTAL_LIMIT)
    error = abs(ours["flux_conservation_error"] - theirs["flux_conservation_error"])
    agreement.note("total", "flux_conservation_error", error, TOTAL_LIMIT)
    _compare_diagnostics(agreement, ours["diagnostics"], theirs["diagnostics"])
    agreement.count("detectors", sorted(ours["detectors"]), sorted(theirs["detectors"]))
    for name in sorted(ours["detectors"].keys() & theirs["detectors"].keys()):
        _compare_detector(agreement, name, ours["detectors"][name], theirs["detectors"][name], theirs,
                          capped.get(name))
    return agreement


def _with_capped_totals(ours: Json, theirs: Json, capped: Json) -> Json:
    """Replace the flux of capped ray databases by ours in the other's totals: it is the sum of the rows kept."""
    theirs = dict(theirs)
    for name in capped:
        excess = ours["detectors"][name]["total_flux"] - theirs["detectors"][name]["total_flux"]
        theirs["total_flux_detected"] += excess
        if theirs["detectors"][name]["transmissive"]:
            theirs["total_flux_tapped"] += excess
    if capped:
        left = theirs["total_flux_in"] - theirs["total_flux_detected"] + theirs["total_flux_tapped"]
        left -= sum(theirs[f"total_flux_{sink}"] for sink in ("absorbed", "bulk_absorbed", "escaped", "lost"))
        theirs["flux_conservation_error"] = abs(left) / theirs["total_flux_in"]
    return theirs


def _total_deviation(ours: float, theirs: float, result: Json) -> float:
    scale = max(abs(theirs), TOTAL_FLOOR * result["total_flux_in"])
    return abs(ours - theirs) / scale if scale > 0.0 else abs(ours - theirs)


def _compare_diagnostics(agreement: Agreement, ours: Json, theirs: Json) -> None:
    agreement.count("unreached_geometry", sorted(ours["unreached_geometry"]), sorted(theirs["unreached_geometry"]))
    for name in ("medium_stack_underflows", "split_budget_saturated"):
        agreement.count(name, ours[name], theirs[name])
    for name in ("depth_truncated_flux_fraction", "rr_killed_flux_fraction"):
        agreement.note("total", name, abs(ours[name] - theirs[name]), TOTAL_LIMIT)


def _compare_detector(agreement: Agreement, name: str, ours: Json, theirs: Json, result: Json,
                      max_rays: int | None) -> None:
    agreement.count(f"{name}.kind", ours["kind"], theirs["kind"])
    agreement.count(f"{name}.num_rays_hit", ours["num_rays_hit"], theirs["num_rays_hit"])
    if ours["kind"] != theirs["kind"]:
        return
    if max_rays:
        _compare_capped_rows(agreement, name, ours, theirs, max_rays)
        return
    deviation = _total_deviation(ours["total_flux"], theirs["total_flux"], result)
    agreement.note("total", f"{name}.total_flux", deviation, TOTAL_LIMIT)
    if theirs["kind"] == "ray_database":
        agreement.count(f"{name}.rows", len(ours["x"]), len(theirs["x"]))
        if len(ours["x"]) == len(theirs["x"]):
            agreement.note("rows", f"{name}.rows", row_deviation(ours, theirs), ROW_LIMIT)
        return
    key = MAP_KEYS[theirs["kind"]]
    agreement.count(f"{name}.shape", ours[key].shape, theirs[key].shape)
    if ours[key].shape == theirs[key].shape:
        agreement.note("map", f"{name}.{key}", map_deviation(ours, theirs), MAP_LIMIT)
    for axis in AXIS_KEYS[theirs["kind"]]:
        scale = np.abs(theirs[axis]).max()
        agreement.note("axis", f"{name}.{axis}", _largest(ours[axis] - theirs[axis]) / scale, AXIS_LIMIT)


def map_deviation(ours: Json, theirs: Json) -> float:
    """Return the largest difference of two maps in units of the second one's peak."""
    key = MAP_KEYS[theirs["kind"]]
    mine, other = ours[key], theirs[key]
    peak = np.abs(other).max()
    difference = mine - other
    if theirs["kind"] == "far_field":
        # On the axis the azimuth is rounding noise, so of the ring at the pole only the sum is defined.
        difference = np.concatenate([[difference[0].sum()], difference[1:].ravel()])
    worst = _largest(difference)
    return worst / peak if peak > 0.0 else worst


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max()) if values.size else 0.0


def row_deviation(ours: Json, theirs: Json) -> float:
    """Return how far the rows of two ray databases are apart as sets, each way.

    Not as sorted lists: rows that differ by rounding sort differently where a detector sees one ray twice.
    """
    mine, other = _scaled_rows(ours, theirs), _scaled_rows(theirs, theirs)
    if len(mine) == 0 or len(other) == 0:
        return 0.0 if len(mine) == len(other) else float("inf")
    sums = _largest(mine.sum(axis=0) - other.sum(axis=0)) / len(other)
    return max(_largest_distance(mine, other), _largest_distance(other, mine), sums)


def _largest_distance(rows: np.ndarray, among: np.ndarray) -> float:
    if not np.isfinite(rows).all():
        return float("inf")
    distances, _ = cKDTree(among).query(rows, p=np.inf)
    return float(distances.max())


def _scaled_rows(database: Json, reference: Json) -> np.ndarray:
    # Without rows, flux and wavelength still hold one zero each.
    columns = [database[key][: len(database["x"])] for key in ROW_KEYS]
    extent = max(_largest(reference[key]) for key in ("x", "y", "z")) or 1.0
    scales = [extent] * 3 + [1.0] * 3 + [_largest(reference["flux"]) or 1.0, 1.0]
    return np.stack([column / scale for column, scale in zip(columns, scales, strict=True)], axis=1)


def _compare_capped_rows(agreement: Agreement, name: str, ours: Json, theirs: Json, max_rays: int) -> None:
    """A cap keeps any of the rows that were hit."""
    agreement.count(f"{name}.rows", len(ours["x"]), min(max_rays, theirs["num_rays_hit"]))
    if len(ours["x"]):
        distance = _largest_distance(_scaled_rows(ours, theirs), _scaled_rows(theirs, theirs))
        agreement.note("rows", f"{name}.rows", distance, ROW_LIMIT)
    kept = abs(ours["total_flux"] - ours["flux"].sum()) / max(abs(ours["total_flux"]), 1e-300)
    agreement.note("total", f"{name}.total_flux", kept, TOTAL_LIMIT)


def compare_statistically(ours: list[Json], theirs: list[Json], figures: tuple[str, ...] = (*COUNTS, *FLUXES),
                          hits: bool = True) -> Agreement:
    """Compare runs of independent seeds: Welch's t of every figure, total and bin, with a Sidak bound over all.

    ``hits`` tells whether detectors' numbers of rays are compared as well.
    """
    samples = _samples(ours, theirs, figures, hits)
    tests = sum(a.shape[1] for _, a, _ in samples)
    level = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / tests)
    agreement = Agreement(worst={"t": 0.0})
    for what, a, b in samples:
        t, p = _welch(a, b)
        agreement.worst["t"] = max(agreement.worst["t"], float(t.max()))
        if (p < level).any():
            agreement.violations.append(f"{what}: p = {p.min():.2g} < {level:.2g} in {int((p < level).sum())} bins")
    return agreement


def compare_split(ours: list[Json], theirs: list[Json]) -> Agreement:
    """Compare runs of a scene that splits rays, where only expectations of flux are the same.

    Optiland counts children of no flux and plays roulette with others; of two budgets either draws other branches.
    """
    return compare_statistically(ours, theirs, tuple(name for name in FLUXES if name != "total_flux_lost"), hits=False)


def _samples(ours: list[Json], theirs: list[Json], figures: tuple[str, ...],
             hits: bool) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Pair up every statistic: its name and one row per run on either side."""
    samples = [(name, _column(ours, name), _column(theirs, name)) for name in figures]
    for name, detector in theirs[0]["detectors"].items():
        sides = [[run["detectors"][name] for run in runs] for runs in (ours, theirs)]
        for key in ("num_rays_hit", "total_flux") if hits else ("total_flux",):
            samples.append((f"{name}.{key}", _column(sides[0], key), _column(sides[1], key)))
        if detector["kind"] in MAP_KEYS:
            samples.append((f"{name}.map", *_pooled(*sides)))
    return samples


def _column(runs: list[Json], key: str) -> np.ndarray:
    return np.array([[float(run[key])] for run in runs])


def _pooled(ours: list[Json], theirs: list[Json]) -> tuple[np.ndarray, np.ndarray]:
    """Return one row of bins per run, the bins of few hits pooled into one."""
    key = MAP_KEYS[theirs[0]["kind"]]
    sides = [np.stack([run[key].ravel() for run in runs]) for runs in (ours, theirs)]
    mean = sides[1].mean(axis=0)
    hits = np.mean([run["num_rays_hit"] for run in theirs]) * mean / max(mean.sum(), 1e-300)
    common = hits >= MIN_HITS
    pooled = [np.column_stack([side[:, common], side[:, ~common].sum(axis=1)]) for side in sides]
    return pooled[0], pooled[1]


def _welch(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return |t| and the two-sided p of each column; a column that never varies must be equal."""
    difference = np.abs(a.mean(axis=0) - b.mean(axis=0))
    va, vb = a.var(axis=0, ddof=1) / len(a), b.var(axis=0, ddof=1) / len(b)
    scale = np.maximum(np.abs(b).max(axis=0), 1e-300)
    constant = va + vb <= (1e-12 * scale) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        t = difference / np.sqrt(va + vb)
        degrees = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
        p = 2.0 * stats.t.sf(t, degrees)
    equal = difference <= TOTAL_LIMIT * scale
    t = np.where(constant, np.where(equal, 0.0, np.inf), t)
    return t, np.where(constant, np.where(equal, 1.0, 0.0), p)
