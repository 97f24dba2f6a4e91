"""Derivatives without Torch: those of committed traces of TorchBackend, and those of differences."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from optiland.nonsequential import LensConfig, NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig, RayDatabaseConfig
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from tests import live
from tests.conftest import ROOT
from tests.live import cs, glass

ORACLE = ROOT / "tests" / "oracle" / "gradients"


def singlet(r1: float = 60.0) -> NSQScene:
    """Return one lens, a beam that stays clear of its rim, a map, and behind it rays."""
    scene = NSQScene()
    scene.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=8.0))
    scene.add_lens("L", cs(), LensConfig(r1, -60.0, 5.0, glass(), 12.0))
    scene.add_detector("image", cs(z=40.0), IrradianceDetectorConfig(12.0, 12.0, 8, 8))
    scene.add_detector("behind", cs(z=-30.0), RayDatabaseConfig(60.0, 60.0))
    return scene


def test_a_file_has_the_derivatives_of_torch() -> None:
    known = json.loads((ORACLE / "absorbing_singlet.json").read_text(encoding="utf-8"))
    found = nsq_gpu.jacobian(ORACLE / "absorbing_singlet.scene.json", list(known["parameters"]), known["num_rays"],
                             seed=known["seed"], max_depth=known["max_depth"], precision="f64", binary=live.binary())
    for name, expected in known["parameters"].items():
        data = np.array(expected["data"])
        ours = found[name, "screen"].map.ravel()
        # Pixels have one area, which is the quotient of flux and irradiance.
        area = sum(known["data"]) / found.maps["screen"].sum()
        np.testing.assert_allclose(ours * area, data, rtol=0, atol=1e-9 * np.abs(data).sum())
        assert found[name, "screen"].standard_error > 0


def test_a_live_scene_has_the_derivatives_of_its_differences() -> None:
    found = nsq_gpu.jacobian(singlet(), ["L.r1"], 200_000, precision="f64", binary=live.binary())
    difference = nsq_gpu.diff(singlet(60.5), singlet(59.5), 200_000, precision="f64", binary=live.binary())
    image, ours = difference.detectors["image"], found["L.r1", "image"]
    sigma = np.hypot(image.map_standard_error, ours.map_standard_error)
    score = (image.map - ours.map)[sigma > 0] / sigma[sigma > 0]
    assert np.sqrt(np.mean(score**2)) < 1.3 and np.abs(score).max() < 4.5
    assert (np.abs(ours.map) > 5 * ours.map_standard_error).sum() > 20
    assert found["L.r1", "behind"].map is None and "L.r1" in str(found)


def test_what_has_no_derivative_is_refused() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="did you mean"):
        nsq_gpu.jacobian(singlet(), ["M.r1"], 1000, binary=live.binary())
    with pytest.raises(nsq_gpu.UsageError, match="name a parameter"):
        nsq_gpu.jacobian(singlet(), [], 1000, binary=live.binary())
    mesh = Path(ROOT / "scenes" / "mesh_lens.json")
    source = json.loads(mesh.read_text(encoding="utf-8"))["sources"][0]["name"]
    with pytest.raises(nsq_gpu.UsageError, match="meshes have no derivatives"):
        nsq_gpu.jacobian(mesh, [f"{source}.total_flux"], 1000, binary=live.binary())


def test_a_loss_has_the_gradient_that_maps_of_derivatives_give() -> None:
    scene, names = singlet(), ["L.r1", "L.z", "image.z"]
    maps = nsq_gpu.jacobian(scene, names, 20_000, seed=3, precision="f64", binary=live.binary())
    shape = maps.maps["image"].shape
    adjoints = np.linspace(-1.0, 2.0, maps.maps["image"].size).reshape(shape)
    found = nsq_gpu.loss_gradient(scene, names, {"image": adjoints}, 20_000, seed=3, precision="f64", binary=live.binary())
    detector = scene.detectors[0]
    area = float(detector.width) * float(detector.height) / maps.maps["image"].size
    assert found.why_forward is None
    assert list(found) == names
    for name in names:
        map_ = maps[name, "image"].map
        assert map_ is not None
        assert found[name] == pytest.approx(float((adjoints * map_).sum()) * area, rel=1e-9)


def test_adjoints_of_a_wrong_shape_are_refused_by_the_detectors_name() -> None:
    def refused(adjoints: dict[str, np.ndarray], message: str) -> None:
        with pytest.raises(nsq_gpu.UsageError, match=message):
            nsq_gpu.loss_gradient(singlet(), ["L.r1"], adjoints, 1000, binary=live.binary())

    refused({"image": np.zeros((3, 5))}, r"adjoints of `image` have the shape \[3, 5\]; its map has")
    refused({"nowhere": np.zeros(1)}, "no detector has this name")
    refused({"image": np.full(nsq_gpu.jacobian(singlet(), ["L.r1"], 100, binary=live.binary()).maps["image"].shape, np.nan)},
            "adjoint of `image` is NaN")
