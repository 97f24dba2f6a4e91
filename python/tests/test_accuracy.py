"""``benches/accuracy.py``: that it runs, that its numbers hang together, and that its statistics are right."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "benches"))

import accuracy
import draw
from accuracy import CLAIMS, GROUP, Estimate, Variances

pytestmark = pytest.mark.in_turn

PNG = b"\x89PNG\r\n\x1a\n"


def measured(command: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> dict[str, list[dict]]:
    """The rows of the written tables, of few rays; no clock ends a curve."""
    monkeypatch.setattr(accuracy, "QUICK", accuracy.Effort(2, 1e3, 0.2, 1 << 14))
    assert accuracy.main(["--binary", *command, "--quick", "-o", str(folder), *arguments]) == 0
    return {path.name: list(csv.DictReader(path.open(newline=""))) for path in folder.glob("*.csv")}


def test_error_falls_and_tiers_agree(command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = ("bench_lens", "light_pipe")
    tables = measured(command, tmp_path, monkeypatch, "--scenes", ",".join((*scenes, "lamp")))
    for chart in draw.OF_ACCURACY:
        assert (tmp_path / chart).read_bytes()[:8] == PNG, chart
    for scene in scenes:
        def of(method: str, column: str, scene: str = scene) -> list[float]:
            return [float(row[column]) for row in tables["accuracy.csv"] if (row["scene"], row["method"]) == (scene, method)]

        maps = of("f32", "map_rms_error")
        assert len(maps) == 2 and maps[1] < maps[0], scene
        # Four times the rays halve the error: over some hundred pixels that are lit alike, to a few percent. At the end of
        # the pipe one pixel holds a beam, and most of the error.
        assert scene != "bench_lens" or 1.7 < maps[0] / maps[1] < 2.3
        assert of("sobol", "map_rms_error")[-1] < maps[-1]
        # A splat moves flux between pixels alone.
        assert of("bilinear splat", "flux_error") == pytest.approx(of("f64", "flux_error"), rel=1e-5)
        # The same draws take the same paths: a pixel's error is the same to what few rays do otherwise.
        assert maps == pytest.approx(of("f64", "map_rms_error"), rel=1e-2)
    for row in tables["numerical.csv"]:
        numbers = {name: float(row[name]) for name in accuracy.NUMERICAL[3:]}
        assert numbers["position_rms_mm"] <= numbers["position_max_mm"] < 0.1, row
        assert numbers["flux_rms"] <= numbers["flux_max"] and 0 <= numbers["share_of_other_fate"] <= 0.01, row
        assert numbers["num_arrivals"] > 1000, row
        in_f32 = row["shader"].startswith("f32")
        assert numbers["position_rms_mm"] > 1e-9 if in_f32 else numbers["position_rms_mm"] < 1e-10, row
    assert len(tables["sobol.csv"]) >= 4
    for row in tables["sobol.csv"]:
        for what in ("map", "flux"):
            low, value, high = (float(row[f"{what}_ratio{end}"]) for end in ("_low", "", "_high"))
            # Few traces prove nothing, and so nothing is claimed.
            assert 0 < low <= value <= high and row[f"{what}_least"] == "", row


def test_claims_alone_write_their_files_and_no_ratio_where_nothing_errs(
        command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    tables = measured(command, tmp_path, monkeypatch, "--claims", "--scenes", "bench_surface_count_50")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["accuracy.txt", "sobol.csv"]
    (row,) = tables["sobol.csv"]
    # Every ray ends on the detector.
    assert float(row["map_ratio"]) > 1 and row["flux_ratio"] == ""
    printed = capsys.readouterr().out
    assert printed == (tmp_path / "accuracy.txt").read_text() and "no error" in printed
    with pytest.raises(SystemExit, match="2"):
        accuracy.main(["--claims", "-o", str(tmp_path)])
    assert "--overwrite" in capsys.readouterr().err


def test_a_claim_that_does_not_hold_is_told_by_the_exit_code(
        command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    short = accuracy.replace(CLAIMS[0], num_rays=512, traces=(16, 16))
    for least, code in ((1.0, 0), (1e6, accuracy.TOLERANCE_MISSED)):
        monkeypatch.setattr(accuracy, "CLAIMS", (accuracy.replace(short, least=least),))
        assert accuracy.main(["--binary", *command, "--claims"]) == code
        assert ("less than is claimed" in capsys.readouterr().err) == bool(code)


def test_unknown_scenes_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        accuracy.main(["--scenes", "cooke_tripler"])
    assert "cooke_triplet" in capsys.readouterr().err


def test_optiland_traces_the_same_map(command: list[str], tmp_path: Path) -> None:
    scene, tracer, peer = accuracy.SCENES[0], accuracy.Tracer(command[0], None), accuracy.Peer("numpy", tmp_path)
    (_, theirs), ours = peer.tracing(scene.plain(), scene)(4000, 0), tracer.trace(scene.plain(), 4000, precision="f64")
    peer.close()
    tracer.close()
    ours = Estimate.of(ours, scene.detector)
    assert theirs.cells.shape == ours.cells.shape
    # Six standard errors of a share of 0.92 of 4000 rays, twice.
    assert theirs.total == pytest.approx(ours.total, abs=6 * np.sqrt(2 * 0.92 * 0.08 / 4000))


def test_cells_of_every_kind_of_detector_add_up_to_its_flux(command: list[str]) -> None:
    tracer = accuracy.Tracer(command[0], None)
    for name, detector in (("nested_media", "front"), ("filter_stack", "behind"), ("cooke_triplet", "image")):
        answer = tracer.trace(accuracy.Scene(name, detector).document(), 1000, precision="f32")
        estimate = Estimate.of(answer, detector)
        assert estimate.cells.sum() == pytest.approx(estimate.total, rel=1e-12)
    tracer.close()


def test_every_scene_is_held_to_a_claim_on_its_first_map() -> None:
    for path in (ROOT / "scenes").glob("*.json"):
        if path.stem != "coated_projector":
            detectors = [claim.scene.detector for claim in CLAIMS if claim.scene.name == path.stem]
            first = next(one["name"] for one in json.loads(path.read_text())["detectors"] if one["type"] != "ray_database")
            assert detectors and set(detectors) == {first}, path.stem


def test_rays_of_another_fate_are_counted_apart() -> None:
    def paths(*events: tuple[int, str, str, float, float]) -> accuracy.Paths:
        ray, kind, name, x, flux = (np.array(column) for column in zip(*events, strict=True))
        return {"ray_id": ray, "event_type": kind, "component_name": name, "x": x, "y": 0 * x, "z": 0 * x, "flux": flux}

    truth = [(0, "hit", "lens", 0.0, 1.0), (0, "hit", "D", 1.0, 1.0), (1, "hit", "D", 2.0, 0.5), (2, "hit", "E", 5.0, 1.0),
             (3, "hit", "D", 1.0, 1.0)]
    # One ray arrives on another detector, and one has another fate.
    found = [truth[0], (0, "hit", "D", 1.3, 1.0), (1, "hit", "D", 2.4, 0.51), (2, "hit", "E", 99.0, 1.0),
             (3, "hit", "lens", 99.0, 1.0)]
    row = accuracy.compare(paths(*found), paths(*truth), "D")
    assert (row["num_arrivals"], row["share_of_other_fate"]) == (2, 0.25)
    assert row["position_max_mm"] == pytest.approx(0.4) and row["position_rms_mm"] == pytest.approx(0.125**0.5)
    assert row["flux_max"] == pytest.approx(0.02)


def test_ratios_are_of_means_and_their_intervals_shrink_with_groups() -> None:
    one = Variances(np.ones(100), 1.0)
    few, many = (Variances(np.tile([8.0, 12.0], count), 1.0).ratio_to(one) for count in (1, 50))
    assert few.value == many.value == 10.0
    assert few.low < many.low < 10.0 < many.high < few.high
    # Standard deviation of a mean of 100: 2 %.
    assert np.log(many.high / many.low) == pytest.approx(2 * 2.365 * 0.0201, rel=1e-2)


def test_what_makes_no_error_has_no_ratio() -> None:
    exact, noisy = Variances(np.zeros(8), 1.0), Variances(np.array([1e-4, 2e-4]), 1.0)
    assert exact.ratio_to(exact) is None and exact.ratio_to(noisy).value == 0.0
    row = {f"{what}_{part}": value for what in ("map", "flux") for part, value in
           (("ratio", 1.0), ("ratio_low", 0.96), ("ratio_high", 2.0), ("least", 0.95))}
    assert accuracy.holds(row) and accuracy.holds(row | {"map_ratio": None, "map_least": 10.0})
    assert not accuracy.holds(row | {"map_ratio_low": 0.94}) and not accuracy.holds(row | {"flux_ratio_low": float("nan")})


def test_the_variance_of_a_group_has_no_bias() -> None:
    numbers = np.arange(GROUP, dtype=float)
    traces = [(Estimate(np.array([number, 1.0]), number), None) for number in numbers]
    of_map, of_flux = accuracy.variances(iter(traces))
    # Two cells, of which one varies: their squares are in units of the mean cell.
    assert of_flux.of_groups == pytest.approx([numbers.var(ddof=1)])
    assert of_map.of_groups == pytest.approx([2 * numbers.var(ddof=1)])
    by_rays = accuracy.variances(iter([(estimate, 0.5) for estimate, _ in traces]))[1]
    assert by_rays.of_groups == pytest.approx([0.5])


@pytest.mark.parametrize(("law", "groups", "least", "most"), [
    # Three standard errors of the count are 0.5 %.
    *[("normal", groups, 0.985, 0.9955) for groups in ((5, 5), (16, 16), (64, 64), (64, 256), (256, 16))],
    # Fluxes of thousands of rays are not as far from normal as this.
    *[("laplace", groups, 0.975, 1.0) for groups in ((5, 5), (64, 64), (256, 64))],
])
def test_intervals_hold_the_true_ratio(law: str, groups: tuple[int, int], least: float, most: float) -> None:
    draws = getattr(np.random.default_rng(1), law)
    held = np.zeros(2)
    for _ in range(4000):
        ours, theirs = (Variances(draws(size=(count, GROUP)).var(1, ddof=1), 1.0) for count in groups)
        ratio = ours.ratio_to(theirs)
        held += (ratio.low <= 1, ratio.high >= 1)
    assert (least < held / 4000).all() and (held / 4000 <= most).all()


def test_rates_and_growth_are_drawn(tmp_path: Path) -> None:
    summary = {"median": 2.0, "min": 1.0, "max": 3.0}
    engine = {"precision": "f32", "rays_per_sec": summary}
    cases = [{"name": name, "kind": kind, "measurements": [engine], "peers": [engine | {"name": "optiland"}]}
             for name, kind in (("rays_1e3", "trace"), ("cooke_triplet", "command"))]
    report = {"program": "nsq-gpu", "version": "0", "date": "2026-01-31T00:00:00Z", "num_runs": 1, "note": None,
              "adapter": {"name": "a device"}, "cases": cases}
    (tmp_path / "bench.json").write_text(json.dumps(report))
    rows = [(mirrors, rays, depth) for mirrors, rays, depths in
            ((100, 1000, (64, 100000)), (1000, 1000, (64, 100000)), (1000, 1000, (64, 256, 100000)), (1000, 10000, (64, 100000)))
            for depth in depths]
    lines = [f"{mirrors:>8}{rays:>10}{depth:>8}     0.0100     0.0090     0.0200    1.00" for mirrors, rays, depth in rows]
    (tmp_path / "growth.txt").write_text("\n".join(["a device, f32", "", "a heading", *lines]) + "\n")
    assert draw.folder(tmp_path) == ["bench.png", "growth.png"]
    assert all((tmp_path / name).read_bytes()[:8] == PNG for name in ("bench.png", "growth.png"))
    (tmp_path / "bench.json").write_text(json.dumps(report | {"cases": []}))
    assert draw.bars(tmp_path, "") == []
