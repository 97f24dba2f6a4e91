"""Other coatings from a table of paths: closed forms, traces with those coatings, and refusals."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from optiland.coatings import SimpleCoating
from optiland.nonsequential import LensConfig, NSQScene, SurfaceConfig
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from nsq_gpu import CoatingTable, PathTable, ResultWarning, UsageError
from tests import live
from tests.live import cs, glass
from tests.test_session import singlet

R1, T1, R2, T2 = 0.2, 0.7, 0.3, 0.65


def plate(front: tuple[float, float] = (R1, T1), back: tuple[float, float] = (R2, T2)) -> NSQScene:
    """Return a plate in a beam, whose faces have these R and T."""
    scene = NSQScene()
    scene.add_source("lamp", cs(z=-10.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=1.0))
    scene.add_lens("P", cs(), LensConfig(float("inf"), float("inf"), 3.0, glass(), 10.0, front=coated(*front), back=coated(*back)))
    scene.add_detector("image", cs(z=20.0), IrradianceDetectorConfig(20.0, 20.0, 4, 4))
    return scene


def coated(reflectance: float, transmittance: float) -> SurfaceConfig:
    return SurfaceConfig(coating=SimpleCoating(transmittance, reflectance))


def traced(scene: NSQScene, num_rays: int = 50_000) -> PathTable:
    with live.quiet():
        paths = scene.trace(num_rays, seed=3, backend=live.backend(paths=True)).paths
    assert paths is not None
    return paths


@pytest.fixture(scope="module")
def paths() -> PathTable:
    return traced(plate())


def order(paths: PathTable, number: int) -> np.void:
    row, = paths[paths["reflections"] == 2 * number]
    return row


def test_rows_are_multiplied_by_what_each_reflection_and_passage_gains(paths: PathTable) -> None:
    found = paths.recoat({"P.front": 0.05, "P.back": (0.6, 0.3)})
    assert isinstance(found, PathTable) and len(found) == len(paths)
    for number in range(3):
        # The absorption of the front face is held.
        factor = (0.05 / R1 * 0.6 / R2) ** number * (0.85 / T1) * (0.3 / T2)
        old, new = order(paths, number), order(found, number)
        for field in ("flux", "standard_error"):
            assert new[field] == pytest.approx(factor * old[field], rel=1e-12), (number, field)
        assert new["num_rays"] == old["num_rays"]
    assert found["share"].sum() == pytest.approx(1.0, rel=1e-12)
    assert found["rank"].tolist() == list(range(1, len(found) + 1))
    assert (np.diff(found["flux"]) <= 0.0).all()
    assert {face["face"]: (face["reflectance"], face["transmittance"]) for face in found.recoated} == {
        "P.front": (0.05, pytest.approx(0.85)), "P.back": (0.6, 0.3)}
    # The table of the trace is as it was.
    assert not paths.recoated and order(paths, 0)["flux"] == pytest.approx(T1 * T2, rel=0.02)


def test_rows_are_those_of_a_trace_with_the_new_coatings(paths: PathTable) -> None:
    found, expected = paths.recoat({"P.back": 0.6}), traced(plate(back=(0.6, 0.35)))
    for number in range(3):
        new, own = order(found, number), order(expected, number)
        error = np.hypot(new["standard_error"], own["standard_error"])
        assert abs(new["flux"] - own["flux"]) < 4.0 * error, number
        assert new["share"] == pytest.approx(own["share"], abs=5.0 * error)


def test_some_rows_have_no_shares(paths: PathTable) -> None:
    found = paths[paths["reflections"] > 0].recoat({"P.front": 0.05})
    assert np.isnan(found["share"]).all() and found["rank"][0] == 1


def test_a_face_that_reflects_nothing_leaves_the_direct_light(paths: PathTable) -> None:
    found = paths.recoat({"P.front": 0.0})
    assert (found["flux"][1:] == 0.0).all() and found["share"][0] == 1.0
    assert np.isnan(found["upper_bound_95"]).all()


def test_the_rank_has_the_derivatives_of_differences(paths: PathTable) -> None:
    ranks = paths.rank_coatings()
    assert isinstance(ranks, CoatingTable) and sorted(ranks["face"]) == ["P.back", "P.front"]
    ghosts = paths[paths["reflections"] >= 2]
    for face, reflectance in (("P.front", R1), ("P.back", R2)):
        rank, = ranks[ranks["face"] == face]
        high, low = (ghosts.recoat({face: reflectance + step})["flux"].sum() for step in (1e-5, -1e-5))
        assert rank["derivative"] == pytest.approx((high - low) / 2e-5, rel=1e-7)
        assert (rank["reflectance"], rank["share"], rank["reason"]) == (reflectance, 1.0, None)
        # A ray brings one ghost at most.
        transmittance = {"P.front": T1, "P.back": T2}[face]
        slopes = ghosts["reflections"] / 2 / reflectance - 1.0 / transmittance
        assert rank["standard_error"] == pytest.approx(np.sqrt(np.sum((slopes * ghosts["standard_error"]) ** 2)), rel=1e-9) \
            or np.isnan(ghosts["standard_error"]).any()
    gains = np.abs(ranks["derivative"]) * ranks["reflectance"]
    assert gains[0] >= gains[1]
    assert "CoatingTable: 2 faces" in repr(ranks)
    assert paths.rank_coatings(detector="image")["face"].tolist() == ranks["face"].tolist()


def test_errors_of_the_rank_know_of_rays_that_an_option_split(tmp_path: Path) -> None:
    """A ray that is split brings all ghosts at once, so that errors of rows add up; also of a result from a folder."""
    scene = plate()
    with live.quiet(), nsq_gpu.Session() as session:
        by_option = session.trace(scene, 2000, split_depth=7, paths=True, standard_error=True).paths
        scene.sampling_policy = dataclasses.replace(scene.sampling_policy, split_depth=7)
        by_scene = session.trace(scene, 2000, paths=True, standard_error=True)
        by_scene.save(tmp_path / "saved")
    assert by_option is not None and by_scene.paths is not None
    expected = by_scene.paths.rank_coatings()
    assert (expected["standard_error"] > 0.0).all()
    for found in (by_option, by_option[:], nsq_gpu.load(tmp_path / "saved").paths):
        assert found.rank_coatings(scene=plate())["standard_error"] == pytest.approx(expected["standard_error"], rel=1e-12)


def test_a_bare_face_has_a_reason_in_the_place_of_a_derivative() -> None:
    ranks = traced(singlet()).rank_coatings()
    assert np.isnan(ranks["derivative"]).all() and (ranks["share"] == 1.0).all()
    assert all("is bare" in reason for reason in ranks["reason"])


@pytest.mark.parametrize(("coatings", "said"), [
    ({"P.frnt": 0.1}, "did you mean `P.front`"),
    ({"P.front": 1.5}, "cannot reflect 1.5"),
    ({"P.front": (0.6, 0.6)}, "more light than it gets"),
    ({"P.front": 0.95}, "absorbs 0.1"),
    ({"P.front": "low"}, "give a reflectance, or a pair"),
    ({"P.front": (0.1, 0.2, 0.3)}, "give a reflectance, or a pair"),
    ({"P.front": float("nan")}, "give a reflectance, or a pair"),
    ([("P.front", 0.1)], "coatings"),
])
def test_what_makes_no_sense_is_refused(paths: PathTable, coatings: Mapping[str, float], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        paths.recoat(coatings)


def test_a_bare_face_is_refused() -> None:
    with pytest.raises(UsageError, match="recoat L.back: the face is bare.*constant coating first"):
        traced(singlet(), 1000).recoat({"L.back": 0.01})


def test_new_coatings_are_named_at_once(paths: PathTable) -> None:
    found = paths.recoat({"P.front": 0.1})
    for again in (lambda: found.recoat({"P.back": 0.1}), found.rank_coatings, lambda: found[1:].recoat({"P.back": 0.1})):
        with pytest.raises(UsageError, match="has new coatings of P.front already"):
            again()
    with pytest.raises(UsageError, match="no row of the table ends there"):
        paths.rank_coatings(detector="imag")


def test_light_that_may_be_totally_reflected_is_named() -> None:
    scene = NSQScene()
    scene.add_source("lamp", cs(z=-10.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=8.0))
    scene.add_lens("L", cs(), LensConfig(12.0, -12.0, 8.0, glass(), 9.0, front=coated(R1, T1), back=coated(R2, T2)))
    scene.add_detector("image", cs(z=20.0), IrradianceDetectorConfig(40.0, 40.0, 4, 4))
    with pytest.warns(ResultWarning, match="L.back: in .* light may have been totally reflected there"):
        traced(scene, 5000).recoat({"L.back": 0.1})


def test_results_of_the_command_are_recoated_by_their_scene(tmp_path: Path) -> None:
    file = tmp_path / "plate.json"
    nsq_gpu.export_scene(plate(), file)

    def result(name: str, *options: str) -> nsq_gpu.Result:
        command = [live.binary(), "paths", str(file), "-n", "5000", "-o", str(tmp_path / name), "--no-pictures", *options]
        subprocess.run(command, check=True, capture_output=True)
        return nsq_gpu.load(tmp_path / name)

    alone, grouped = result("alone").paths, result("grouped", "--group=faces").paths
    new = result("new", "--recoat=P.front=0.05").paths
    assert alone is not None and grouped is not None and new is not None
    with pytest.raises(UsageError, match='name it: scene="lens.json"'):
        alone.recoat({"P.front": 0.05})
    found = alone.recoat({"P.front": 0.05}, scene=file)
    np.testing.assert_allclose(found["flux"], new["flux"], rtol=1e-12)
    np.testing.assert_allclose(found["share"], new["share"], rtol=1e-12)
    assert found.recoated == new.recoated
    with pytest.raises(UsageError, match='stands for several paths.*group="sequence"'):
        grouped.recoat({"P.front": 0.05}, scene=file)
    with pytest.raises(UsageError, match="has new coatings"):
        new.recoat({"P.front": 0.05}, scene=file)
    with pytest.raises(UsageError, match="is no path to a detector of this scene"):
        alone.recoat({"L.front": 0.05}, scene=singlet())
    ranked = json.loads(subprocess.run([live.binary(), "paths", str(file), "-n", "5000", "--rank-coatings", "--json"],
                                       check=True, capture_output=True).stdout)["coatings"]
    ranks = alone.rank_coatings(scene=file)
    assert ranks["face"].tolist() == [rank["face"] for rank in ranked]
    np.testing.assert_allclose(ranks["derivative"], [rank["derivative"] for rank in ranked], rtol=1e-12)
    np.testing.assert_allclose(ranks["share"], [rank["share"] for rank in ranked], rtol=1e-12)


def test_saved_results_are_recoated(paths: PathTable, tmp_path: Path) -> None:
    with live.quiet():
        result = plate().trace(2000, seed=3, backend=live.backend(paths=True))
    result.save(tmp_path / "saved")
    loaded = nsq_gpu.load(tmp_path / "saved").paths
    assert loaded is not None
    assert loaded.recoat({"P.front": 0.05})["flux"].tolist() == result.paths.recoat({"P.front": 0.05})["flux"].tolist()
