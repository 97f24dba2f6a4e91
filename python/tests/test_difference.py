"""Differences of two scenes: the same as of NumpyBackend's two traces by one seed, and with errors that hold."""

from __future__ import annotations

import numpy as np
import pytest
from optiland.coatings import SimpleCoating
from optiland.nonsequential import LensConfig, NSQScene, SurfaceConfig
from optiland.nonsequential.backends import NumpyBackend
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig, RayDatabaseConfig
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from tests import live
from tests.live import cs, glass

NUM_RAYS = 20_000


def singlet(radius: float, source: str = "beam") -> NSQScene:
    """Return one lens, a beam, a map, and behind it rays."""
    scene = NSQScene()
    scene.add_source(source, cs(z=-20.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=8.0))
    scene.add_lens("L", cs(), LensConfig(radius, -radius, 5.0, glass(), 10.0))
    scene.add_detector("image", cs(z=55.0), IrradianceDetectorConfig(20.0, 20.0, 16, 16))
    scene.add_detector("behind", cs(z=-30.0), RayDatabaseConfig(60.0, 60.0))
    return scene


def test_a_difference_is_that_of_two_numpy_traces() -> None:
    found = nsq_gpu.diff(singlet(60.0), singlet(62.0), NUM_RAYS, seed=3, precision="f64", binary=live.binary())
    a, b = (singlet(radius).trace(NUM_RAYS, seed=3, backend=NumpyBackend()) for radius in (60.0, 62.0))
    image = found.detectors["image"]
    theirs = [np.asarray(result.detectors["image"].irradiance) for result in (a, b)]
    np.testing.assert_allclose(image.map_a, theirs[0], rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(image.map, theirs[0] - theirs[1], rtol=1e-7, atol=1e-12)
    assert image.difference == pytest.approx(a.detectors["image"].total_flux - b.detectors["image"].total_flux, abs=1e-12)
    assert found.totals["escaped"].a == pytest.approx(a.total_flux_escaped, abs=1e-12)
    assert found.detectors["behind"].map is None and found.detectors["behind"].kind == "ray_database"
    # The same draws: the light that passes differs far less than the root of its rays would have it.
    independent = np.hypot(image.a, image.b) / np.sqrt(NUM_RAYS)
    assert 0 < image.standard_error < 0.3 * independent
    assert found.num_rays == NUM_RAYS and "image" in str(found)


def test_a_scene_less_itself_is_nothing() -> None:
    found = nsq_gpu.diff(singlet(60.0), singlet(60.0), 1000, binary=live.binary())
    assert all(row.difference == 0 and row.standard_error == 0
               for rows in (found.detectors, found.totals, found.surfaces) for row in rows.values())
    assert not found.detectors["image"].map.any()


def test_points_have_errors_of_what_is_detected() -> None:
    found = nsq_gpu.diff(singlet(60.0), singlet(62.0), NUM_RAYS, sampler="sobol", binary=live.binary())
    assert found.detectors["image"].standard_error > 0 and np.isnan(found.totals["escaped"].standard_error)


def test_ghosts_of_another_coating_are_compared_by_guided_rays() -> None:
    def lens(reflectance: float) -> NSQScene:
        scene = NSQScene()
        scene.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=8.0))
        face = SurfaceConfig(coating=SimpleCoating(1.0 - reflectance, reflectance))
        scene.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass(), 10.0, front=face, back=face))
        scene.add_detector("image", cs(z=55.0), IrradianceDetectorConfig(40.0, 40.0, 16, 16))
        return scene

    found = nsq_gpu.diff(lens(0.004), lens(0.002), NUM_RAYS, where="reflections == 2", guide=True, binary=live.binary())
    image = found.detectors["image"]
    assert image.a / image.b == pytest.approx(4.0 * (0.996 / 0.998)**2, rel=2e-3) and image.standard_error < 0.02 * image.difference
    with pytest.raises(nsq_gpu.UsageError, match="guide is 'on'; give True or False"):
        nsq_gpu.diff(lens(0.004), lens(0.002), 100, guide="on")  # type: ignore[arg-type]


def test_scenes_of_other_sources_are_refused() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="B has no source called `beam`"):
        nsq_gpu.diff(singlet(60.0), singlet(60.0, source="lamp"), 1000, binary=live.binary())
