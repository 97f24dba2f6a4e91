"""Paths: the table and the filter against those that Python makes from the events that NumpyBackend records."""

from __future__ import annotations

import functools
import itertools
import math
import statistics
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene

import nsq_gpu
import nsq_gpu.backend
from nsq_gpu import NsqGpuBackend, PathTable, UsageError
from tests import live, parity, random_scenes, sequences
from tests.agreement import MAP_KEYS
from tests.oracle import Json
from tests.sequences import Path, Table
from tests.test_session import session, singlet

NUM_RAYS = 2000
#: Rays where the two sides draw otherwise, and only expectations are the same.
NUM_INDEPENDENT_RAYS = 10_000
#: Largest relative difference of the flux of a row.
FLUX_LIMIT = 1e-9
#: Largest difference of the flux of a row in standard errors, where the two sides draw otherwise.
SIGMAS = 4.0

FILES = {path.stem: path for path in live.SCENES}
COMBINATIONS = dict(enumerate(itertools.islice(random_scenes.combinations(1), random_scenes.NUM_COVERING)))
NAMES = [*FILES, *(f"{number}:{'+'.join(features)}" for number, features in COMBINATIONS.items())]


def build(name: str) -> NSQScene:
    """Return the scene of a file, or a random one."""
    if name in FILES:
        return live.load_uncapped(FILES[name])
    number = int(name.split(":")[0])
    with live.quiet():
        return random_scenes.build(COMBINATIONS[number], 1000 + number)


def is_alike_ray_by_ray(name: str) -> bool:
    """Tell whether both sides trace the same rays: none is split, and rounding decides no way."""
    is_chaotic = name in FILES and parity.is_chaotic(FILES[name])
    return not is_chaotic and build(name).sampling_policy.split_depth == 0


@functools.cache
def num_rays(name: str) -> int:
    return NUM_RAYS if is_alike_ray_by_ray(name) else NUM_INDEPENDENT_RAYS


def trace(name: str, **options: Any) -> tuple[Any, Json, Json]:
    """Trace a scene; return the result, its figures and the program's report."""
    backend = live.backend(**options)
    result, figures = live.traced(build(name), num_rays(name), backend)
    assert backend.report is not None
    return result, figures, backend.report


@functools.cache
def ours(name: str) -> tuple[Any, Json, Json]:
    return trace(name, paths=True)


@functools.cache
def theirs(name: str) -> Table:
    seed = 0 if is_alike_ray_by_ray(name) else parity.ORACLE_SEEDS
    return sequences.numpy_table(build(name), num_rays(name), seed)


def by_sequence(paths: PathTable) -> dict[str, Any]:
    rows = {row["sequence"]: row for row in paths}
    assert len(rows) == len(paths)
    return rows


def path_of(row: Any) -> Path:
    return Path(row["sequence"].split(" > ")[0], row["steps"], row["detector"])


@pytest.fixture(scope="module", params=live.in_turn(NAMES))
def name(request: pytest.FixtureRequest) -> str:
    """A scene. Tests of one scene are neighbours, which share its traces."""
    return request.param


# The table


def test_the_table_is_that_of_numpys_events(name: str) -> None:
    result, _, report = ours(name)
    table = theirs(name)
    assert "paths_without_row" not in report
    if is_alike_ray_by_ray(name):
        assert_equal(result.paths, table, report)
    else:
        assert_alike(result.paths, table)
    assert_whole(result.paths, report)


def assert_equal(paths: PathTable, table: Table, report: Json) -> None:
    """Check that a table has the same rows: equal counts, and fluxes that are the same to rounding."""
    rows = by_sequence(paths)
    assert rows.keys() == {path.text for path in table.paths}
    launched = report["ledger"]["launched"]
    # A deposit is rounded to a quantum, and the square of its weight to a quantum's.
    per_quantum = launched["flux"] / int(launched["quanta"])
    per_ray = launched["flux"] / launched["count"]
    for path, found in table.paths.items():
        row = rows[path.text]
        assert row["num_rays"] == found.num_rays, path.text
        assert abs(row["flux"] - found.flux) <= FLUX_LIMIT * found.flux + found.num_rays * per_quantum, path.text
        assert row["steps"] == path.steps, path.text
        assert row["detector"] == path.detector, path.text
        assert row["reflections"] == path.count("R"), path.text
        assert row["scatterings"] == path.count("ST", "SR"), path.text
        apart = abs(row["standard_error"] ** 2 - table.error(path) ** 2)
        rounding = 1e-14 * found.flux**2 + found.num_rays * 2.0**-51 * per_ray**2
        assert apart <= 2.0 * FLUX_LIMIT * table.error(path) ** 2 + rounding, path.text


def assert_alike(paths: PathTable, table: Table) -> None:
    """Check that a table agrees with one of other draws: row by row, and by what many rows share."""
    rows = {path_of(row): row for row in paths}
    kinds: list[Callable[[Path], Any]] = [
        lambda path: path,
        lambda path: (path.detector, path.count("R"), path.count("SR", "ST")),
        # Where nearly all rays have rows of their own, rows alone would tell little.
        lambda path: (path.detector, path.steps[:2]),
        lambda path: (path.detector, path.steps[-2:]),
    ]
    for kind in kinds:
        flux: dict[Any, float] = {}
        error: dict[Any, float] = {}
        for path in rows.keys() | table.paths.keys():
            mine = (rows[path]["flux"], rows[path]["standard_error"]) if path in rows else (0.0, 0.0)
            other = (table.paths[path].flux, table.error(path)) if path in table.paths else (0.0, 0.0)
            assert math.isfinite(mine[1])
            flux[kind(path)] = flux.get(kind(path), 0.0) + mine[0] - other[0]
            # Of one ray's branches: their errors are not independent, and their sum is not too small.
            error[kind(path)] = error.get(kind(path), 0.0) + math.hypot(mine[1], other[1])
        far = {key: apart / error[key] for key, apart in flux.items() if not abs(apart) <= SIGMAS * error[key]}
        assert not far


def assert_whole(paths: PathTable, report: Json) -> None:
    """Check that rows are sorted, shares are those of their detectors, and all light has a row."""
    assert paths["rank"].tolist() == list(range(1, len(paths) + 1))
    assert (np.diff(paths["flux"]) <= 0.0).all()
    launched = report["ledger"]["launched"]
    for name, detector in report["detectors"].items():
        of_detector = paths[paths["detector"] == name]
        assert of_detector["num_rays"].sum() == detector["num_rays_hit"]
        flux = of_detector["flux"].sum()
        # A detector's cells are rounded on their own.
        assert abs(flux - detector["total_flux"]) <= 1e-12 * launched["flux"], name
        assert np.allclose(of_detector["share"] * flux, of_detector["flux"], rtol=1e-12, atol=0.0)


def test_most_scenes_are_compared_ray_by_ray() -> None:
    assert sum(not is_alike_ray_by_ray(name) for name in NAMES) <= 5


def test_the_scenes_have_all_kinds_of_steps() -> None:
    for name in ("opal_lamp", "scattering_telescope"):
        assert is_alike_ray_by_ray(name)
        assert {letters for path in theirs(name).paths for letters, _ in path.steps} == {"T", "R", "ST", "SR"}


# The filter

#: Expressions, by the paths of a scene (the strongest first), a surface, and its component.
EXPRESSIONS: list[Callable[[list[Path], str, str], str]] = [
    lambda paths, surface, component: "reflections == 0 and scatterings == 0",
    lambda paths, surface, component: f'hit("{surface}")',
    lambda paths, surface, component: f'not hit("{component}") or reflections >= 2',
    lambda paths, surface, component: f'sequence("{paths[0].text}")',
    lambda paths, surface, component: f'sequence("* > R {surface} > *")',
    lambda paths, surface, component: f"events <= {statistics.median_low(len(path.steps) for path in paths)}",
    lambda paths, surface, component: f'first("{surface}") or last("{component}")',
    lambda paths, surface, component: f'source("{paths[-1].source}") and sequence("* > {paths[-1].detector}")',
    lambda paths, surface, component: f'transmitted("{component}") and not reflected("{surface}")',
    lambda paths, surface, component: f'scattered("*") or transmissions < {paths[0].count("T")}',
    lambda paths, surface, component:
        f'(reflections > 0 or scatterings != 0) and not sequence("{paths[0].source} > * {component} > *")',
    lambda paths, surface, component: f'sequence("* > R * > * > SR * > *") or sequence("* > R * > * > T {surface} > *")',
    lambda paths, surface, component: f'sequence("{paths[len(paths) // 2].text}") or reflected("{component}")',
]


def expressions(name: str) -> list[str]:
    """Return an expression or two that keep some paths of a scene and not all. Their kinds take turns among scenes."""
    paths = [path_of(row) for row in ours(name)[0].paths]
    surfaces = sorted({surface for path in paths for _, surface in path.steps})
    if len(paths) < 2 or not surfaces:
        return ["reflections == 0"]
    index = NAMES.index(name)
    surface = surfaces[index % len(surfaces)]
    component = surface.rpartition(".")[0] or surface
    written = [EXPRESSIONS[(2 * index + i) % len(EXPRESSIONS)](paths, surface, component) for i in range(len(EXPRESSIONS))]
    telling = [expression for expression in written if len({sequences.keeps(expression, path) for path in paths}) == 2]
    assert telling
    return telling[: 2 if name in FILES else 1]


def test_a_filter_keeps_what_it_says(name: str) -> None:
    everything = ours(name)
    for number, expression in enumerate(expressions(name)):
        kept = trace(name, where=expression)
        assert kept[0].paths is None
        assert_kept(name, expression, kept)
        if number == 0:
            rest = trace(name, where=f"not ({expression})")
            assert_kept(name, f"not ({expression})", rest)
            assert_add_up(kept, rest, everything)


def assert_kept(name: str, expression: str, kept: tuple[Any, Json, Json]) -> None:
    """Check that detectors hold the light of the paths that Python keeps."""
    result, figures, report = kept
    launched = report["ledger"]["launched"]
    rows = [(path_of(row), row) for row in ours(name)[0].paths]
    of_ours = [(path, row["num_rays"], row["flux"]) for path, row in rows]
    of_theirs = [(path, found.num_rays, found.flux) for path, found in theirs(name).paths.items()]
    # Of other draws only the table of this program's own rays says what is kept.
    for paths in (of_ours, of_theirs) if is_alike_ray_by_ray(name) else (of_ours,):
        for detector, found in figures["detectors"].items():
            of_detector = [(count, flux) for path, count, flux in paths
                           if path.detector == detector and sequences.keeps(expression, path)]
            flux = math.fsum(flux for _, flux in of_detector)
            assert found["num_rays_hit"] == sum(count for count, _ in of_detector), (expression, detector)
            assert abs(found["total_flux"] - flux) <= FLUX_LIMIT * flux + 1e-15 * launched["flux"], (expression, detector)
    assert report["ledger"]["imbalance_quanta"] == "0"
    assert abs(result.flux_conservation_error - ours(name)[0].flux_conservation_error) < 1e-12


def assert_add_up(kept: tuple[Any, Json, Json], rest: tuple[Any, Json, Json], everything: tuple[Any, Json, Json]) -> None:
    """Check that a filter and its negation share all light: maps to rounding, the ledger exactly."""
    for name, whole in everything[1]["detectors"].items():
        parts = [figures["detectors"][name] for _, figures, _ in (kept, rest)]
        assert sum(part["num_rays_hit"] for part in parts) == whole["num_rays_hit"]
        if whole["kind"] in MAP_KEYS:
            key = MAP_KEYS[whole["kind"]]
            apart = np.abs(sum(part[key] for part in parts) - whole[key]).max()
            assert apart <= 1e-12 * np.abs(whole[key]).max(), name
        else:
            assert sum(len(part["x"]) for part in parts) == len(whole["x"])
    kept_ledger, rest_ledger, ledger = (report["ledger"] for _, _, report in (kept, rest, everything))

    def quanta(ledger: Json, line: str) -> int:
        return int(ledger[line]["quanta"])

    for line in ("detected", "tapped"):
        assert quanta(kept_ledger, line) + quanta(rest_ledger, line) == quanta(ledger, line), line
    assert quanta(kept_ledger, "filtered_out") == quanta(rest_ledger, "detected")
    assert quanta(rest_ledger, "filtered_out") == quanta(kept_ledger, "detected")
    assert quanta(ledger, "filtered_out") == 0
    lines = {line for line, entry in ledger.items() if isinstance(entry, dict)} - {"detected", "tapped", "filtered_out"}
    assert {"launched", "absorbed", "escaped", "depth", "roulette_loss"} <= lines
    for line in lines:
        assert kept_ledger[line] == rest_ledger[line] == ledger[line], line


def test_the_expression_of_a_row_keeps_its_light_alone() -> None:
    paths = ours("nested_media")[0].paths
    for row in paths[[0, len(paths) // 2, -1]]:
        kept = trace("nested_media", paths=True, where=row["where"])[0].paths
        assert len(kept) == 1
        [only] = kept
        assert only["share"] == 1.0
        for name in set(only.dtype.names) - {"rank", "share"}:
            assert only[name] == row[name] or math.isnan(only[name]) and math.isnan(row[name]), name


# The package


def test_without_paths_there_are_none() -> None:
    with live.quiet():
        assert singlet().trace(100, backend=live.backend()).paths is None
        assert singlet().trace(100, backend=live.backend(where="reflections == 0")).paths is None


@pytest.fixture
def paths() -> PathTable:
    with live.quiet():
        return singlet().trace(20_000, backend=live.backend(paths=True)).paths


def test_a_table_is_an_array_with_fields(paths: PathTable) -> None:
    assert isinstance(paths, PathTable)
    assert paths["sequence"].tolist() == ["beam > T L.front > T L.back > image",
                                          "beam > T L.front > R L.back > R L.front > T L.back > image"]
    assert paths[0]["steps"] == (("T", "L.front"), ("T", "L.back"))
    assert paths["reflections"].tolist() == [0, 2]
    # A column is a plain array, and rows are a table.
    assert type(paths["flux"]) is np.ndarray
    assert isinstance(paths[paths["reflections"] == 2], PathTable)
    assert paths[paths["reflections"] == 2]["rank"] == [2]
    assert np.sort(paths, order="flux")[0]["rank"] == 2


def test_a_table_goes_to_pandas(paths: PathTable) -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = paths.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == list(paths.dtype.names)
    assert frame["flux"].tolist() == paths["flux"].tolist()
    assert frame[frame["detector"] == "image"]["num_rays"].sum() == paths["num_rays"].sum()
    assert paths[1:].to_pandas()["rank"].tolist() == [2]


def test_pandas_that_is_missing_is_named(paths: PathTable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(nsq_gpu.NsqGpuError, match=r"pip install 'nsq-gpu\[pandas\]'"):
        paths.to_pandas()


def test_an_error_that_is_not_known_is_nan() -> None:
    # One ray says nothing of the error of its flux.
    with live.quiet():
        paths = singlet().trace(1, backend=live.backend(paths=True)).paths
    assert paths["num_rays"].tolist() == [1]
    assert np.isnan(paths["standard_error"]).all()


def test_a_process_of_its_own_has_the_same_table(paths: PathTable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nsq_gpu.backend, "MOST_SESSION_RAYS", 0)
    with live.quiet():
        assert live.same_rows(singlet().trace(20_000, backend=live.backend(paths=True)).paths, paths)
        kept = singlet().trace(20_000, backend=live.backend(paths=True, where='hit("L") and reflections > 0'))
    assert kept.paths["sequence"].tolist() == paths["sequence"].tolist()[1:]
    assert abs(kept.total_flux_detected - paths["flux"][1]) < 1e-12


def test_the_report_says_what_a_filter_kept_away() -> None:
    backend = live.backend(where="reflections == 2")
    with live.quiet():
        result = singlet().trace(20_000, backend=backend)
    assert backend.report is not None
    filtered = backend.report["ledger"]["filtered_out"]["flux"]
    assert filtered > 0.9
    assert result.diagnostics.flux_filtered_out == filtered
    assert result.flux_conservation_error < 1e-12
    assert result.total_flux_lost == 0.0
    assert "The ledger closes" in result.report()
    assert f"The filter of paths kept {filtered:.6g} W from the detectors." in result.report()
    assert not any("conservation" in warning for warning in result.diagnostics.warnings())
    with live.quiet():
        assert "filter" not in singlet().trace(100, backend=live.backend()).report()


@pytest.mark.parametrize(("where", "said"), [
    ("reflectons == 2", "column 1: `reflectons` is not known; did you mean `reflections`"),
    ('hit("L.frnt")', "column 5: .* did you mean `L.front`"),
    ("reflections == 2 and", "column 21: the expression ends here"),
    ("", "column 1"),
])
@pytest.mark.parametrize("most", [0, 1_000_000])
def test_a_filter_that_makes_no_sense_is_refused(where: str, said: str, most: int,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nsq_gpu.backend, "MOST_SESSION_RAYS", most)
    with pytest.raises(UsageError, match=said):
        singlet().trace(100, backend=live.backend(where=where))


@pytest.mark.parametrize("options", [{"paths": "yes"}, {"paths": None}, {"where": 2}])
def test_arguments_of_other_types_are_refused(options: Json) -> None:
    with pytest.raises(UsageError, match=next(iter(options))):
        NsqGpuBackend(**options)


def test_a_session_takes_true_and_false(paths: PathTable) -> None:
    with session() as one, live.quiet():
        found = one.trace(singlet(), 20_000, paths=True, standard_error=True, record_paths=True)
        assert found.paths["sequence"].tolist() == paths["sequence"].tolist()
        assert found.detectors["image"].standard_error is not None
        assert found.ray_paths is not None
        found = one.trace(singlet(), 20_000, paths=False, standard_error=False, record_paths=False)
        assert found.paths is None
        assert found.detectors["image"].standard_error is None
        assert found.ray_paths is None


def test_a_sweep_has_a_table_a_point() -> None:
    with session() as one, live.quiet():
        found = one.sweep(singlet(), {"L.r1": [50.0, 60.0], "L.z": [0.0]}, 2000, paths=True, where="reflections == 0")
        assert found.paths is not None
        assert found.paths.shape == (2, 1)
        for place, table in np.ndenumerate(found.paths):
            assert isinstance(table, PathTable)
            assert abs(table["flux"].sum() - found.flux["image"][place]) < 1e-12
        assert one.sweep(singlet(), {"L.r1": [50.0]}, 100).paths is None
