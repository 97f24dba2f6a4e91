"""The far field of an LED of ams OSRAM, by published numbers.

The LED is SU CULCP1.VC, of UV-C. The numbers are those of its ray files, as the project holg/tm25ray states them in
``docs/format.md`` and ``tests/real_file.rs`` of 2026: intensity in rings of 10 degrees, flux, peak, half angle, places of the rays, and
sizes of the files. The maker's files themselves may not be passed on. So rays are drawn from the published far field, and written as
the maker writes them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig
from optiland.nonsequential.sources.base import Spectrum

from nsq_gpu import rayfiles
from nsq_gpu.sources import RaySource, TabulatedSource
from tests import live
from tests.live import cs
from tests.test_ray_source import assert_same_rays, with_source
from tests.test_rayfiles import tm25

#: Intensity in rings of 10 degrees, of the largest, printed with two digits.
PUBLISHED = np.array([0.99, 1.00, 0.98, 0.89, 0.72, 0.54, 0.30, 0.09, 0.00])
HALF_A_DIGIT = 0.005
#: Flux [W], and the peak [W/sr] with the tolerance that is stated for it.
WATTS, PEAK, PEAK_WITHIN = 0.051, 0.019, 0.003
#: The half angle [deg], "near 57".
HALF_ANGLE = 57.0
#: Rays of the file that is drawn here; and bytes of the maker's files, by their rays.
RAYS, FILES = 500_000, {100_000: 2_836_704, 500_000: 14_036_704}
#: Where rays start [mm].
PLACES = np.array([[-1.75, 1.61], [-1.61, 1.64], [-0.815, 0.0]])
EDGES = np.radians(np.linspace(0.0, 90.0, 10))
#: Solid angles of the rings [sr].
RINGS = -2.0 * np.pi * np.diff(np.cos(EDGES))
#: A spectrum with the published peak at 266 nm, and half of it or more from 262 to 272 nm.
NM = np.arange(220.0, 321.0, 2.0)
SPECTRUM = Spectrum(NM / 1000.0, np.exp(-np.log(2.0) * ((NM - 266.0) / np.where(NM < 266.0, 5.0, 7.0)) ** 2))
TRACED = 2_000_000


def drawn(count: int = RAYS) -> dict[str, np.ndarray]:
    """Return rays of the published far field, all of one flux."""
    draw = np.random.default_rng(0)
    ring = draw.choice(9, count, p=PUBLISHED * RINGS / (PUBLISHED * RINGS).sum())
    cosine, turn = draw.uniform(np.cos(EDGES[ring + 1]), np.cos(EDGES[ring])), draw.uniform(0.0, 2.0 * np.pi, count)
    sine = np.sqrt(1.0 - cosine**2)
    x, y, z = (draw.uniform(low, high, count) for low, high in PLACES)
    return {"x": x, "y": y, "z": z, "L": sine * np.cos(turn), "M": sine * np.sin(turn), "N": cosine, "flux": np.full(count, WATTS / count)}


def written(path: Path, count: int = RAYS) -> Path:
    table = list(zip(NM.tolist(), (100.0 * SPECTRUM.weights).tolist(), strict=True))
    return tm25(path, drawn(count), identifier=3, tables=(table,), total=WATTS)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("osram") / "led.tm25ray")


def far_field(source: Any) -> Any:
    """Return a trace of a source into rings of 10 degrees."""
    scene = NSQScene()
    scene.source_registry.add("LED", source)
    scene.add_detector("rings", cs(z=10.0), FarFieldDetectorConfig(9, 1))
    return scene.trace(TRACED, seed=5, backend=live.backend(standard_error=True))


def by_rays(path: Path) -> RaySource:
    return RaySource.from_file(path, cs=cs(), spectrum=SPECTRUM)


def by_table() -> TabulatedSource:
    """Return the LED by a table that is constant within each ring."""
    gamma = np.degrees(np.stack([EDGES[:-1] + 1e-6, EDGES[1:] - 1e-6], axis=1).ravel())
    gamma[[0, -1]] = 0.0, 90.0
    return TabulatedSource(cs(), SPECTRUM, gamma, PUBLISHED.repeat(2), total_flux=WATTS, radius=1.6)


@pytest.mark.parametrize("count", FILES)
def test_a_file_of_so_many_rays_has_the_published_size(count: int, tmp_path: Path) -> None:
    path = written(tmp_path / "led.tm25ray", count)
    assert path.stat().st_size == FILES[count]
    rays = rayfiles.read(str(path))
    assert len(rays.flux) == count and rays.unit == "W" and rays.wavelength is None and rays.stated is None
    assert rays.total == pytest.approx(WATTS, rel=1e-6) and np.allclose(rays.flux, WATTS / count, rtol=1e-6)
    assert (rays.starts > PLACES[:, 0] - 1e-6).all() and (rays.starts < PLACES[:, 1] + 1e-6).all()


@pytest.mark.parametrize("of", ["rays", "table"])
def test_the_far_field_is_the_published_one(of: str, file: Path) -> None:
    result = far_field(by_rays(file) if of == "rays" else by_table())
    seen = result.detectors["rings"]
    intensity, error = seen.intensity[:, 0], seen.standard_error[:, 0]
    if of == "rays":
        # The file is a draw, too.
        error = error * np.sqrt(1.0 + TRACED / RAYS)
    assert result.total_flux_in == pytest.approx(WATTS, rel=1e-6)
    largest = WATTS / (PUBLISHED * RINGS).sum()
    assert 4.0 * error.max() < 0.04 * largest and intensity[8] == 0.0
    assert np.abs((intensity / largest - PUBLISHED)[:8] / (error / largest)[:8]).max() < 4.0
    # As it is printed: of the largest, with two digits.
    relative = intensity / intensity.max()
    of_relative = np.hypot(error, relative * error[intensity.argmax()]) / intensity.max()
    assert (np.abs(relative - PUBLISHED) < HALF_A_DIGIT + 4.0 * of_relative).all()
    # What the far field was not made of.
    assert abs(intensity.max() - PEAK) < PEAK_WITHIN
    half = np.interp(-0.5, -relative[1:], np.arange(15.0, 90.0, 10.0))
    assert abs(half - HALF_ANGLE) < 0.5 + 4.0 * of_relative[5] * 10.0 / 0.24


def test_another_far_field_is_noticed(file: Path) -> None:
    """A Lambertian LED has no such far field: it is a few per cent wider."""
    gamma = np.linspace(0.0, 90.0, 91)
    lambertian = TabulatedSource(cs(), SPECTRUM, gamma, np.maximum(np.cos(np.radians(gamma)), 0.0), total_flux=WATTS, radius=1.6)
    seen = far_field(lambertian).detectors["rings"]
    intensity, error = seen.intensity[:, 0], seen.standard_error[:, 0]
    assert (np.abs(intensity / intensity.max() - PUBLISHED) > HALF_A_DIGIT + 4.0 * error / intensity.max()).sum() > 4


def test_numpy_traces_the_same_rays(file: Path) -> None:
    assert assert_same_rays(with_source(by_rays(file))).total_flux_in == pytest.approx(WATTS, rel=1e-6)
