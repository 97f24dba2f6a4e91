"""Fluxes that rest on few rays say so in every result of the package."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import nsq_gpu
from nsq_gpu import NsqGpuBackend, load_scene
from nsq_gpu.errors import ResultWarning
from nsq_gpu.few_rays import FewRays

SCENE = """{
  "nsq_schema_version": 1,
  "components": [{
    "name": "L", "type": "lens", "cs": {"z": 5},
    "config": {"r1": 1000.0, "r2": -1000.0, "thickness": 2.0, "material": "N-BK7", "front_aperture_radius": 20.0}
  }],
  "sources": [{
    "name": "lamp", "type": "collimated", "total_flux": 1.0, "aperture_radius": 10.0, "cs": {"z": -10},
    "spectrum": {"wavelengths": [0.5876], "weights": [1]}
  }],
  "detectors": [
    {"name": "rare", "type": "irradiance", "width": 0.2, "height": 0.2, "num_pixels_x": 2, "num_pixels_y": 2, "cs": {"z": 20}},
    {"name": "rest", "type": "irradiance", "width": 50, "height": 50, "num_pixels_x": 5, "num_pixels_y": 5, "cs": {"z": 30}}
  ]
}"""
NUM_RAYS = 20_000


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a scene's file."""
    file = tmp_path / "scene.json"
    file.write_text(SCENE, encoding="utf-8")
    return file


def check(few: FewRays | None) -> None:
    """Check that a bound lies between that of no ray and that of ten."""
    assert few is not None and few.rests_on < 10
    assert 2.9 < few.upper_bound_95 * NUM_RAYS < 17.0
    assert "rests on" in str(few)


def test_results_and_paths_say_what_they_rest_on(path: Path) -> None:
    with pytest.warns(ResultWarning, match="detector 'rare' rests on"):
        result = load_scene(path).trace(NUM_RAYS, seed=0, backend=NsqGpuBackend(paths=True))
    check(result.few_rays["rare"])
    assert list(result.few_rays) == ["rare"]
    assert result.detectors["rare"].few_rays == result.few_rays["rare"]
    assert result.detectors["rest"].few_rays is None
    few = result.paths[result.paths["rests_on"] < 10]
    many = result.paths[result.paths["rests_on"] >= 10]
    assert len(few) and len(many)
    assert (few["upper_bound_95"] * NUM_RAYS > 2.9).all() and np.isnan(many["upper_bound_95"]).all()
    assert (many["rests_on"] == many["num_rays"]).all()


def test_differences_derivatives_and_sweeps_say_it_too(path: Path) -> None:
    changed = path.with_name("changed.json")
    changed.write_text(SCENE.replace('"width": 0.2', '"width": 0.3'), encoding="utf-8")
    found = nsq_gpu.diff(path, changed, NUM_RAYS)
    check(found.detectors["rare"].few_rays)
    assert found.totals["launched"].few_rays is None and "rests on" in str(found)

    with pytest.warns(ResultWarning):
        derivatives = nsq_gpu.jacobian(path, "L.r1", NUM_RAYS)
    assert derivatives["L.r1", "rest"].rests_on is None
    assert 0 < derivatives["L.r1", "rare"].rests_on < 10 and "rests on" in str(derivatives)

    with nsq_gpu.Session() as session:
        sweep = session.sweep(load_scene(path), {"rare.width": [0.2, 8.0]}, NUM_RAYS)
    assert 2.9 < sweep.upper_bound_95["rare"][0] * NUM_RAYS < 17.0 and sweep.rests_on["rare"][0] < 10
    assert math.isnan(sweep.upper_bound_95["rare"][1]) and np.isnan(sweep.upper_bound_95["rest"]).all()
    first, second = sweep.rows()
    assert first["rare upper bound 95 % [W]"] == sweep.upper_bound_95["rare"][0]
    assert "rest upper bound 95 % [W]" not in first and second.keys() == first.keys()
