"""Lamps by table: far fields against the table, draws against closed forms, fluxes, refusals, files, and the program."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import optiland.backend as be
import pytest
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.components.configs import LensConfig
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig, IrradianceDetectorConfig
from optiland.nonsequential.rng import NSQRng
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.collimated import CollimatedSource
from optiland.nonsequential.sources.configs import CollimatedSourceConfig, ExtendedSourceConfig, PointSourceConfig
from optiland.nonsequential.sources.extended import ExtendedSource
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import chi2

import nsq_gpu
from nsq_gpu.export import export, to_json
from nsq_gpu.intensity import IntensityTable
from nsq_gpu.photometry import luminous_efficacy, v_lambda, watts
from nsq_gpu.scene_file import scene_from_dict
from nsq_gpu.sources import PupilSource, TabulatedSource
from tests import live
from tests.live import cs, glass, two_lines

matplotlib.use("Agg")

GREEN = Spectrum(np.array([0.555]), np.array([1.0]))
INFRARED = Spectrum(np.array([1.0]), np.array([1.0]))
EIGHTH = np.arange(0.0, 91.0, 15.0)
HALF = np.arange(0.0, 181.0, 15.0)
CIRCLE = np.arange(0.0, 361.0, 15.0)
DOWN = np.arange(0.0, 91.0, 5.0)
ALL = np.arange(0.0, 181.0, 5.0)

#: Of a lamp: its azimuths and polar angles [deg], and the intensity there, by C and gamma [rad]; over the full circle.
LAMPS: dict[str, tuple[Any, Any, Callable[[Any, Any], Any]]] = {
    "isotropic": ([0.0], [0.0, 180.0], lambda c, gamma: 1.0 + 0.0 * c * gamma),
    "power of the cosine": ([0.0], DOWN, lambda c, gamma: np.abs(np.cos(gamma)) ** 4 + 0.0 * c),
    # The density over gamma is 0 at both ends of the only interval.
    "pencil": ([0.0], [0.0, 1.0], lambda c, gamma: 1.0 - np.degrees(gamma) + 0.0 * c),
    "batwing": (EIGHTH, DOWN, lambda c, gamma: np.sin(gamma) ** 2 * np.abs(np.cos(gamma)) * (1.0 + 0.5 * np.cos(2.0 * c))),
    "bilateral": (HALF, DOWN, lambda c, gamma: (np.cos(gamma) + 1e-16) * (1.0 + 0.8 * np.cos(c) * np.sin(gamma))),
    "zero band": (CIRCLE, ALL, lambda c, gamma: np.where((gamma > 0.6) & (gamma < 1.1) | (c > 1.5) & (c < 2.7), 0.0,
                                                         2.0 + np.sin(c % (2.0 * np.pi)) * np.sin(gamma))),
    "one side": (CIRCLE, np.arange(20.0, 71.0, 5.0), lambda c, gamma: (1.0 + np.sin(c) * np.cos(3.0 * c)) * gamma),
}


def values(name: str, azimuths: Any = None) -> np.ndarray:
    """Return the rows of a lamp."""
    own, polar, intensity = LAMPS[name]
    c, gamma = np.meshgrid(np.radians(own if azimuths is None else azimuths), np.radians(polar), indexing="ij")
    rows = np.asarray(intensity(c, gamma))
    if len(rows) > 1 and (own if azimuths is None else azimuths)[-1] == 360.0:
        rows[-1] = rows[0]
    return rows


def lamp(name: str, frame: CoordinateSystem | None = None, spectrum: Spectrum = GREEN, **options: Any) -> TabulatedSource:
    own, polar, _ = LAMPS[name]
    if not options.keys() & {"intensity_units", "total_flux", "total_flux_lumens"}:
        options["total_flux"] = 1.0
    return TabulatedSource(frame or cs(), spectrum, polar, values(name), own, **options)


def plain(polar: Any = (0.0, 90.0), intensity: Any = (1.0, 1.0), azimuths: Any = (0.0,), **options: Any) -> TabulatedSource:
    return TabulatedSource(cs(), options.pop("spectrum", GREEN), polar, intensity, azimuths, **options)


def with_source(source: Any) -> NSQScene:
    be.set_backend("numpy")
    be.set_precision("float64")
    scene = NSQScene()
    scene.source_registry.add("lamp", source)
    return scene


def lamp_scene() -> NSQScene:
    """Return lamps of every kind of table and of opening, and a lens between screens."""
    scene = with_source(lamp("bilateral", cs(x=1.0, z=-20.0, ry=0.2), two_lines(), total_flux=2.0))
    scene.source_registry.add("pane", lamp("batwing", cs(y=2.0, z=-25.0, rx=-0.1), two_lines(), intensity_units="cd", width=4.0,
                                           height=2.0))
    scene.source_registry.add("disk", lamp("zero band", cs(z=-15.0, rz=0.4), two_lines(), total_flux_lumens=300.0, radius=1.5))
    scene.source_registry.add("wet", lamp("one side", cs(z=-18.0), two_lines(), intensity_units="W/sr", medium=glass(1.3, 1e-5)))
    scene.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass(), 12.0))
    scene.add_detector("screen", cs(z=30.0), IrradianceDetectorConfig(60.0, 60.0, 12, 12))
    scene.add_detector("back", cs(z=-40.0), IrradianceDetectorConfig(60.0, 60.0, 12, 12))
    return scene


def document(scene: NSQScene) -> dict[str, Any]:
    written: dict[str, Any] = json.loads(to_json(export(scene).document))
    return written


def entry(source: Any) -> dict[str, Any]:
    """Return what the file of a scene says of its only source."""
    return dict(document(with_source(source))["sources"][0])


def read_back(written: dict[str, Any]) -> Any:
    return scene_from_dict({"nsq_schema_version": 1, "sources": [written]}).sources[0]


# Far fields


def cells(name: str) -> np.ndarray:
    """Return the shares of the light in cells of 5 by 15 degrees, shape (36, 24), of C from -180 deg: by quadrature."""
    own, polar, _ = LAMPS[name]
    circle = CIRCLE if len(own) > 1 else np.array([0.0, 360.0])
    table = RegularGridInterpolator((circle, polar), values(name, circle), bounds_error=False, fill_value=0.0)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    places, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    gamma = 5.0 * (np.arange(36)[:, None] + places)
    c = (15.0 * (np.arange(24)[:, None] + places) - 180.0) % 360.0
    gamma_grid, c_grid = np.meshgrid(gamma.ravel(), c.ravel(), indexing="ij")
    density = table(np.stack([c_grid, gamma_grid], axis=-1)) * np.sin(np.radians(gamma_grid))
    shares = np.einsum("aibj,i,j->ab", density.reshape(36, 6, 24, 6), weights, weights)
    return np.asarray(shares / shares.sum())


def counted(scene: NSQScene, num_rays: int, **options: Any) -> np.ndarray:
    """Return the rays in the cells of :func:`cells`: of a far field in front of the source, and one behind it."""
    scene.add_detector("front", cs(z=1.0), FarFieldDetectorConfig(num_theta=18, num_phi=24))
    scene.add_detector("behind", cs(z=-1.0), FarFieldDetectorConfig(num_theta=18, num_phi=24))
    result = scene.trace(num_rays, **options)
    front, behind = result.detectors["front"], result.detectors["behind"]
    solid = np.sin(np.radians(front.theta)) * np.radians(5.0) * np.radians(15.0)
    intensity = np.concatenate([front.intensity, behind.intensity[::-1]])
    rays = intensity * np.concatenate([solid, solid[::-1]])[:, None] / (scene.sources[0].total_flux / num_rays)
    # Those detectors end 1e6 mm from their middle: a ray along them may miss both.
    assert num_rays - 5 <= front.num_rays_hit + behind.num_rays_hit <= num_rays
    return np.asarray(rays)


def assert_follows(rays: np.ndarray, shares: np.ndarray) -> None:
    """Check by chi-square that rays fall into cells as these shares say."""
    assert rays[shares == 0.0].sum() == 0.0
    expected = shares * rays.sum()
    full = expected >= 5.0
    found = np.append(rays[full], rays[~full].sum())
    wanted = np.append(expected[full], expected[~full].sum())
    deviation = ((found - wanted) ** 2 / np.where(wanted > 0.0, wanted, 1.0)).sum()
    assert 1e-4 < chi2.sf(deviation, full.sum() - 1) < 1.0 - 1e-4


@pytest.mark.parametrize("name", LAMPS)
def test_the_far_field_of_a_bare_lamp_is_its_table(name: str) -> None:
    rays = counted(with_source(lamp(name)), 200_000, seed=5, backend=NumpyBackend(seed=5))
    assert_follows(rays, cells(name))


def test_the_test_of_far_fields_notices_a_wrong_table() -> None:
    rays = counted(with_source(lamp("bilateral")), 200_000, seed=5, backend=NumpyBackend(seed=5))
    with pytest.raises(AssertionError):
        assert_follows(np.roll(rays, 1, axis=1), cells("bilateral"))
    # The mirror is one of the table.
    assert_follows(rays[:, ::-1], cells("bilateral"))


# Draws


def draws(many: int, few: int) -> tuple[np.ndarray, ...]:
    """Return the pairs of draws of a grid."""
    grids = [(np.arange(size) + 0.5) / size for size in (many, few)]
    return tuple(part.ravel() for part in np.meshgrid(*grids, indexing="ij"))


def test_means_are_those_of_closed_forms() -> None:
    u1, u2 = draws(20_000, 12)
    # Isotropic: all first moments are 0, and all second ones a third.
    found = IntensityTable([0.0, 180.0], 0.0, [1.0, 1.0]).directions(u1, u2)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(found.T @ found / len(found), np.eye(3) / 3.0, atol=1e-6)
    # Intensity 1 - gamma / 90 deg: of a flux of 2 pi (1 - 2 / pi), the mean cosine is (1 / 4) / (1 - 2 / pi).
    cone = IntensityTable([0.0, 90.0], 0.0, [1.0, 0.0])
    assert cone.flux == pytest.approx(2.0 * np.pi * (1.0 - 2.0 / np.pi), rel=1e-12)
    assert cone.directions(u1, u2)[:, 2].mean() == pytest.approx(0.25 / (1.0 - 2.0 / np.pi), rel=1e-6)
    # Over azimuths 1 - C / 180 deg, mirrored: the mean of cos C is 4 / pi^2, and that of sin C is 0.
    fan = IntensityTable([89.99, 90.01], [0.0, 180.0], [[1.0, 1.0], [0.0, 0.0]])
    np.testing.assert_allclose(fan.directions(*draws(12, 20_000)).mean(axis=0), [4.0 / np.pi**2, 0.0, 0.0], atol=1e-6)


#: The ends of all draws, and others between them.
DRAWS = np.concatenate([np.arange(1000) / 2.0**32, np.linspace(0.0, 1.0, 20_001)[:-1], 1.0 - np.arange(1, 1000) / 2.0**32])


@pytest.mark.parametrize(("polar", "intensity", "light_within"), [
    ((0.0, 180.0), (1.0, 1.0), lambda a: (1.0 - np.cos(a)) / 2.0),
    ((0.0, 90.0), (1.0, 0.0), lambda a: (1.0 - np.cos(a) - (np.sin(a) - a * np.cos(a)) * 2.0 / np.pi) / (1.0 - 2.0 / np.pi)),
    ((0.0, 90.0), (0.0, 1.0), lambda a: np.sin(a) - a * np.cos(a)),
])
def test_gamma_is_the_exact_inverse_of_the_light_within_it(polar: Any, intensity: Any, light_within: Any) -> None:
    found = IntensityTable(polar, 0.0, intensity).directions(DRAWS, np.zeros(len(DRAWS)))
    np.testing.assert_allclose(light_within(np.arctan2(np.hypot(found[:, 0], found[:, 1]), found[:, 2])), DRAWS, atol=5e-13)


@pytest.mark.parametrize(("polar", "intensity"), [
    ((0.0, 1.0), (1.0, 0.0)), ((0.0, 1.0), (0.0, 1.0)), ((0.0, 1.0), (1.0, 1e-6)), ((179.0, 180.0), (0.0, 1.0)),
    ((179.0, 180.0), (1.0, 0.0)), ((0.0, 0.01, 1.0), (1.0, 1.0, 0.0)), ((0.0, 0.01, 1.0), (0.0, 0.0, 1.0)),
    ((0.0, 1e-9, 5.0), (1.0, 0.0, 1.0)),
    ((0.0, 30.0, 30.0 + 1e-8, 60.0), (1e-200, 1e-200, 0.0, 0.0)), ((0.0, 1.0), (1e300, 0.0)),
])
def test_narrow_beams_and_steps_are_inverted_too(polar: Any, intensity: Any) -> None:
    found = IntensityTable(polar, 0.0, intensity).directions(DRAWS, np.zeros(len(DRAWS)))
    sine = np.hypot(found[:, 0], found[:, 1])
    gamma = np.where(found[:, 2] > 0.0, np.arcsin(sine), np.pi - np.arcsin(sine))

    def light_within(a: np.ndarray) -> np.ndarray:
        """By the antiderivative of (p + q x) sin x, which is q (sin x - x cos x) - p cos x; about the nearer pole."""
        pole = np.pi if min(polar) > 90.0 else 0.0
        total = np.zeros_like(a)
        knots, values = np.radians(polar), np.asarray(intensity) / max(intensity)
        for low, high, one, other in zip(knots[:-1], knots[1:], values[:-1], values[1:], strict=True):
            nodes, weights = np.polynomial.legendre.leggauss(12)
            end = np.clip(a, low, high)
            x = low + (end - low)[:, None] * 0.5 * (nodes + 1.0)
            density = (one + (other - one) * (x - low) / (high - low)) * np.sin(np.abs(pole - x))
            total += 0.5 * (end - low) * (density * weights).sum(axis=1)
        return total

    whole = light_within(np.radians(polar[-1:]))
    np.testing.assert_allclose(light_within(gamma) / whole, DRAWS, atol=2e-10)


def test_azimuths_are_the_exact_inverse_of_the_light_within_them() -> None:
    # Along gamma the rows are in proportion: every gamma has the same density over C, 1 + C / 180 deg, mirrored.
    table = IntensityTable([0.0, 40.0, 90.0], [0.0, 60.0, 180.0], np.outer([1.0, 4.0 / 3.0, 2.0], [0.5, 1.0, 0.25]))
    found = table.directions(np.full(len(DRAWS), 0.3), DRAWS)
    c = np.arctan2(found[:, 1], found[:, 0]) % (2.0 * np.pi)
    mirrored = np.minimum(c, 2.0 * np.pi - c)
    within = (mirrored + mirrored**2 / (2.0 * np.pi)) / (3.0 * np.pi)
    # A draw of 0 may come out as 360 deg, by rounding.
    np.testing.assert_allclose(np.where(c <= np.pi, within, 1.0 - within) % 1.0, DRAWS, atol=1e-13)


def test_directions_have_the_length_1() -> None:
    u1, u2 = np.random.default_rng(1).random((2, 10_000))
    for name in LAMPS:
        np.testing.assert_allclose((lamp(name).table.directions(u1, u2) ** 2).sum(axis=1), 1.0, rtol=0.0, atol=2e-13)


def test_more_angles_on_the_same_lines_change_no_ray() -> None:
    u1, u2 = np.random.default_rng(2).random((2, 10_000))
    table = lamp("bilateral").table
    finer, turns = np.union1d(DOWN, [0.1, 7.3, 88.0]), np.arange(0.0, 361.0, 5.0)
    rows = table.at(finer, turns[:, None])
    np.testing.assert_allclose(IntensityTable(finer, turns, rows).directions(u1, u2), table.directions(u1, u2), atol=1e-11)


def test_intensity_at_angles_is_bilinear_and_mirrored() -> None:
    for name, (own, polar, intensity) in LAMPS.items():
        table = lamp(name).table
        circle = own if len(own) == 1 else CIRCLE[:-1]
        np.testing.assert_allclose(table.at(np.asarray(polar), np.asarray(circle)[:, None]), values(name, circle), atol=1e-15)
        assert table.at(polar[-1] + 1.0, 30.0) == 0.0
        if polar[0] > 0.0:
            assert table.at(polar[0] - 1.0, 30.0) == 0.0
    table = IntensityTable([0.0, 10.0], [0.0, 90.0], [[1.0, 2.0], [3.0, 8.0]])
    assert table.at(2.5, 45.0) == pytest.approx(0.75 * 2.0 + 0.25 * 5.0)
    np.testing.assert_allclose(table.at(2.5, [135.0, 225.0, 315.0, -45.0, 405.0]), table.at(2.5, 45.0))


def test_draws_of_a_ray_do_not_depend_on_its_batch() -> None:
    for source in (lamp("batwing"), lamp("zero band", cs(x=1.0, rx=0.3), width=2.0, height=1.0)):
        whole = source.generate(np.arange(1000), NSQRng(4))
        for ids in (np.arange(1), np.arange(300, 317), np.arange(999, -1, -7)):
            part = source.generate(ids, NSQRng(4))
            for key in ("x", "y", "z", "L", "M", "N", "wavelength"):
                np.testing.assert_allclose(getattr(part, key), getattr(whole, key)[ids], rtol=0.0, atol=1e-15)
    scene = lamp_scene()
    one, other = (scene.trace(3000, seed=2, batch_size=size, backend=NumpyBackend(seed=2)) for size in (3000, 701))
    np.testing.assert_allclose(one.detectors["back"].irradiance, other.detectors["back"].irradiance, rtol=1e-12)
    assert one.num_rays_escaped == other.num_rays_escaped > 0


# Births


@pytest.mark.parametrize("opening", [{"width": 3.0, "height": 2.0}, {"width": 0.0, "height": 2.0}, {"radius": 1.5},
                                     {"radius": 0.0}])
def test_births_are_those_of_an_extended_source(opening: Any) -> None:
    frame, ids = cs(x=1.0, y=2.0, z=3.0, rx=0.1, ry=-0.2, rz=0.3), np.arange(5000)
    theirs = {"aperture_radius": opening["radius"]} if "radius" in opening else opening
    expected = ExtendedSource(frame, two_lines(), **theirs).generate(ids, NSQRng(7))
    found = lamp("batwing", frame, two_lines(), **opening).generate(ids, NSQRng(7))
    for key in ("x", "y", "z", "wavelength"):
        np.testing.assert_allclose(getattr(found, key), getattr(expected, key), rtol=0.0, atol=1e-14)


def test_a_point_and_an_opening_have_the_same_directions() -> None:
    ids = np.arange(5000)
    point, disk = (lamp("batwing", cs(x=1.0, y=2.0), **opening).generate(ids, NSQRng(7)) for opening in ({}, {"radius": 2.0}))
    assert (point.x == 1.0).all() and (point.y == 2.0).all() and (point.z == 0.0).all()
    for key in ("L", "M", "N"):
        np.testing.assert_array_equal(getattr(point, key), getattr(disk, key))
    # Places and directions are independent.
    assert abs(np.corrcoef(np.hypot(disk.x - 1.0, disk.y - 2.0), disk.N)[0, 1]) < 0.05


def test_the_frame_turns_the_lamp() -> None:
    ids = np.arange(100)
    straight, turned = (lamp("bilateral", frame).generate(ids, NSQRng(1)) for frame in (cs(), cs(ry=np.pi / 2.0)))
    np.testing.assert_allclose(turned.L, straight.N, atol=1e-15)
    np.testing.assert_allclose(turned.M, straight.M, atol=1e-15)
    np.testing.assert_allclose(turned.N, -straight.L, atol=1e-15)


def test_a_source_in_a_medium_and_its_flux() -> None:
    rays = lamp("batwing", total_flux=3.0, medium=glass(1.4, 1e-6)).generate(np.arange(100), NSQRng(1))
    assert (rays.n_current == 1.4).all() and (rays.k_current == 1e-6).all()
    assert rays.flux.sum() == pytest.approx(3.0)


# Flux


def test_one_candela_everywhere_is_4_pi_lumens() -> None:
    source = plain([0.0, 180.0], [1.0, 1.0], intensity_units="cd")
    assert source.total_flux * luminous_efficacy(GREEN) == pytest.approx(4.0 * np.pi, rel=1e-12)
    assert source.total_flux_lumens is None
    assert plain([0.0, 180.0], [1.0, 1.0], intensity_units="W/sr").total_flux == pytest.approx(4.0 * np.pi, rel=1e-12)


def test_the_flux_of_a_table_is_its_integral() -> None:
    # Per azimuth the integral over gamma is linear in the row, and over azimuths rows weigh as a trapezoid's.
    source = plain([0.0, 180.0], [[1.0, 1.0], [3.0, 3.0], [2.0, 2.0]], [0.0, 60.0, 180.0], intensity_units="W/sr")
    assert source.total_flux == pytest.approx(2.0 * 2.0 * np.pi * (60.0 * 2.0 + 120.0 * 2.5) / 180.0, rel=1e-12)
    narrow = plain([10.0, 20.0], [1.0, 1.0], intensity_units="W/sr")
    cosines = np.cos(np.radians([10.0, 20.0]))
    assert narrow.total_flux == pytest.approx(2.0 * np.pi * (cosines[0] - cosines[1]), rel=1e-12)


def test_a_thousand_lumens_stay_a_thousand_lumens() -> None:
    for spectrum in (GREEN, two_lines()):
        source = plain(spectrum=spectrum, total_flux_lumens=1000.0)
        assert source.total_flux_lumens == 1000.0
        assert source.total_flux * luminous_efficacy(spectrum) == pytest.approx(1000.0, rel=1e-14)
        assert entry(source)["total_flux_lumens"] == 1000.0
        again = read_back(entry(source))
        assert again.total_flux_lumens == 1000.0 and again.total_flux == source.total_flux
    assert plain(total_flux=2.5).total_flux == 2.5 and plain(total_flux=2.5).total_flux_lumens is None


def test_the_eye_is_that_of_1931() -> None:
    assert v_lambda(0.555) == 1.0
    assert v_lambda([0.379, 0.781, 10.0]).tolist() == [0.0, 0.0, 0.0]
    assert (v_lambda([0.380, 0.780]) > 0.0).all()
    assert v_lambda(0.5505) == pytest.approx((v_lambda(0.550) + v_lambda(0.551)) / 2.0, rel=1e-12)
    assert v_lambda(0.650) == pytest.approx(0.107, abs=1e-4)
    assert luminous_efficacy(GREEN) == 683.002
    mixed = Spectrum([0.555, 0.65, 1.0], [1.0, 3.0, 4.0])
    assert luminous_efficacy(mixed) == pytest.approx(683.002 * (1.0 + 3.0 * float(v_lambda(0.65))) / 8.0, rel=1e-14)
    assert watts(683.002, GREEN) == 1.0


# Refusals


@pytest.mark.parametrize(("arguments", "words"), [
    ({"polar": [0.0]}, r"polar_angles_deg: it has the shape \(1,\); give a list of at least two angles"),
    ({"polar": [[0.0, 90.0]]}, "polar_angles_deg: it has the shape"),
    ({"polar": [0.0, 0.0]}, r"polar_angles_deg\[1\]: it is 0, after 0; give angles that rise"),
    ({"polar": [90.0, 0.0]}, r"polar_angles_deg\[1\]: it is 0, after 90; give angles that rise"),
    ({"polar": [-1.0, 90.0]}, r"polar_angles_deg\[0\]: it is -1; give angles from 0 to 180 deg"),
    ({"polar": [0.0, 181.0]}, r"polar_angles_deg\[1\]: it is 181; give angles from 0 to 180 deg"),
    ({"polar": [0.0, math.nan]}, r"polar_angles_deg\[1\]: it is nan; give a finite number"),
    ({"polar": ["a", "b"]}, "polar_angles_deg: could not convert string.*; give numbers"),
    ({"azimuths": [10.0]}, r"azimuth_angles_deg\[0\]: it is 10; give angles that begin with 0 deg"),
    ({"azimuths": []}, "azimuth_angles_deg: it has the shape.*or 0 for a lamp of revolution"),
    ({"azimuths": [0.0, 100.0]}, r"azimuth_angles_deg\[1\]: it is 100; give angles that end with 90, 180 or 360 deg, or 0 alone"),
    ({"azimuths": [0.0, 200.0, 180.0]}, r"azimuth_angles_deg\[2\]: it is 180, after 200; give angles that rise"),
    ({"azimuths": [0.0, 90.0]},
     r"intensity: it has the shape \(2,\); give a row for each of 2 azimuths, with a number for each of 2 polar angles: "),
    ({"intensity": [1.0, 1.0, 1.0]}, r"intensity: it has the shape \(1, 3\); give a row for each of 1 azimuths"),
    ({"intensity": [[1.0, 1.0], [1.0]]}, "intensity: .*; give numbers"),
    ({"intensity": [1.0, -1.0]}, r"intensity\[0\]\[1\]: it is -1; give numbers of 0 or more"),
    ({"intensity": [1.0, math.inf]}, r"intensity\[1\]: it is inf; give a finite number"),
    ({"intensity": [0.0, 0.0]}, "intensity: all numbers are 0, and the lamp is dark; give one above 0"),
    ({"intensity": [1.7e308, 1.7e308]}, r"intensity: numbers up to 1.7e\+308 are too large to sum; give a larger unit"),
    ({"azimuths": [0.0, 180.0, 360.0], "intensity": [[1.0, 1.0], [1.0, 1.0], [1.0, 2.0]]},
     r"intensity\[2\]\[1\]: it is 2 at the azimuth 360, and 1 at 0, the same direction; give equal rows"),
    ({"intensity_units": "lm"}, "intensity_units is 'lm'; give 'relative', 'W/sr' or 'cd'"),
    ({"total_flux": None},
     "total_flux, total_flux_lumens: neither is given, and the table's intensity is relative; give one of them, or the unit"),
    ({"total_flux_lumens": 1.0}, "total_flux, total_flux_lumens: both are given"),
    ({"total_flux": 0.0}, "total_flux is 0.0; give a finite number above 0"),
    ({"total_flux": math.nan}, "total_flux is nan; give a finite number above 0"),
    ({"total_flux": "much"}, "total_flux is 'much'; give a finite number above 0"),
    ({"total_flux": None, "total_flux_lumens": -1.0}, "total_flux_lumens is -1.0; give a finite number above 0"),
    ({"intensity_units": "W/sr"},
     "total_flux is 1.0, and a table in W/sr says its flux itself; leave it out, or give intensity_units='relative'"),
    ({"intensity_units": "cd", "total_flux": None, "total_flux_lumens": 5.0},
     "total_flux_lumens is 5.0, and a table in cd says its flux itself"),
    ({"total_flux": None, "total_flux_lumens": 5.0, "spectrum": INFRARED},
     "spectrum: its light, at 1 um, is not visible, and has no lumens; give total_flux in W"),
    ({"total_flux": None, "intensity_units": "cd", "spectrum": INFRARED}, "spectrum: its light, at 1 um, is not visible"),
    ({"width": 1.0}, "height: it is missing, and width is given; give both for a rectangle, or none for a point"),
    ({"height": 1.0}, "width: it is missing, and height is given"),
    ({"width": 1.0, "height": 1.0, "radius": 1.0}, "radius: it is given beside width or height.*; leave one of them out"),
    ({"radius": -1.0}, "radius is -1.0; give a finite number of 0 or more"),
    ({"width": math.inf, "height": 1.0}, "width is inf; give a finite number of 0 or more"),
    ({"width": 0.0, "height": 0.0}, "width, height: both are 0; leave them out for a point"),
])
def test_what_makes_no_sense_is_refused_by_its_place(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=words):
        plain(**{"total_flux": 1.0, **arguments})


def test_rows_of_a_full_circle_may_differ_by_rounding() -> None:
    rows = [[1.0, 1.0], [2.0, 1.0], [1.0, 1.0 + 1e-15]]
    source = plain(intensity=rows, azimuths=[0.0, 180.0, 360.0], total_flux=1.0)
    assert source.intensity[-1].tolist() == [1.0, 1.0] and rows[-1][1] != 1.0


def test_a_table_cannot_be_changed_unnoticed() -> None:
    source = lamp("batwing")
    with pytest.raises(ValueError, match="read-only"):
        source.intensity[0, 0] = 5.0
    with pytest.raises(AttributeError):
        source.intensity = values("batwing")  # type: ignore[misc]


# Files


@pytest.mark.parametrize("options", [
    {"total_flux": 2.5}, {"total_flux_lumens": 800.0}, {"intensity_units": "cd"}, {"intensity_units": "W/sr"},
    {"total_flux": 1.0, "width": 3.0, "height": 2.0}, {"intensity_units": "cd", "radius": 1.5, "medium": glass(1.3, 1e-5)},
], ids=["W", "lm", "cd", "per sr", "rectangle", "disk"])
@pytest.mark.parametrize("name", LAMPS)
def test_a_file_holds_the_lamp(name: str, options: dict[str, Any]) -> None:
    source = lamp(name, cs(x=1.0, ry=0.2), two_lines(), **options)
    content = document(with_source(source))
    written = content["sources"][0]
    keys = {"type", "name", "cs", "spectrum", "polar_angles_deg", "azimuth_angles_deg", "intensity", "intensity_units", "medium"}
    assert written.keys() == keys | options.keys()
    assert written["type"] == "tabulated" and np.shape(written["intensity"]) == source.intensity.shape
    scene = scene_from_dict(content)
    assert document(scene) == content
    again = scene.sources[0]
    assert type(again) is TabulatedSource and again.total_flux == source.total_flux
    one, other = (which.generate(np.arange(500), NSQRng(3)) for which in (source, again))
    for key in ("x", "y", "z", "L", "M", "N", "flux", "wavelength", "n_current", "k_current"):
        np.testing.assert_array_equal(getattr(one, key), getattr(other, key))


def test_every_argument_is_in_the_file() -> None:
    base = {"cs": cs(), "spectrum": two_lines(), "polar_angles_deg": [0.0, 90.0], "intensity": [[1.0, 2.0], [3.0, 4.0]],
            "azimuth_angles_deg": [0.0, 90.0], "intensity_units": "cd"}
    relative = {**base, "intensity_units": "relative", "total_flux": 1.0}
    changes = [{"cs": cs(x=1.0)}, {"spectrum": GREEN}, {"polar_angles_deg": [0.0, 80.0]}, {"intensity": [[1.0, 2.0], [3.0, 5.0]]},
               {"azimuth_angles_deg": [0.0, 180.0]}, {"intensity_units": "W/sr"}, {"width": 1.0, "height": 2.0},
               {"width": 1.0, "height": 3.0}, {"width": 2.0, "height": 2.0}, {"radius": 1.0}, {"medium": glass(1.3)}, relative,
               {**relative, "total_flux": 2.0},
               {**relative, "total_flux": None, "total_flux_lumens": 2.0}]
    written = [json.dumps(document(with_source(TabulatedSource(**{**base, **change})))) for change in ({}, *changes)]
    assert len(set(written)) == len(written)


def test_the_live_flux_is_the_truth() -> None:
    for options in ({"intensity_units": "cd"}, {"intensity_units": "W/sr"}, {"total_flux_lumens": 100.0}):
        source = lamp("batwing", **options)
        source.total_flux = 7.0
        written = entry(source)
        assert written["intensity_units"] == "relative" and written["total_flux"] == 7.0 and "total_flux_lumens" not in written
        assert read_back(written).total_flux == 7.0
    source = lamp("batwing", total_flux_lumens=100.0)
    flux, source.spectrum = source.total_flux, INFRARED
    assert entry(source)["total_flux"] == flux


@pytest.mark.parametrize("config", [PointSourceConfig, CollimatedSourceConfig, ExtendedSourceConfig])
def test_other_sources_keep_their_lumens_from_file_to_file(config: type) -> None:
    scene = with_source(PupilSource(cs(), two_lines(), beam_radii=(1.0, 1.0)))
    scene.add_source("second", cs(), config(two_lines()))
    content = document(scene)
    for written in content["sources"]:
        del written["total_flux"]
        written["total_flux_lumens"] = 500.0
    again = scene_from_dict(content)
    assert [source.total_flux for source in again.sources] == [watts(500.0, two_lines())] * 2
    assert document(again) == content
    again.sources[1].total_flux = 2.0
    assert document(again)["sources"][1]["total_flux"] == 2.0
    # Optiland keeps no lumens: of a config, the watts are written.
    scene.add_source("third", cs(), config(two_lines(), total_flux_lumens=100.0))
    assert "total_flux_lumens" not in document(scene)["sources"][2]


def test_a_null_is_no_flux_in_lumens() -> None:
    written = {**entry(lamp("batwing", total_flux=2.0)), "total_flux_lumens": None, "radius": None}
    assert read_back(written).total_flux == 2.0
    written = {**entry(CollimatedSource(cs(), GREEN, 3.0)), "total_flux_lumens": None}
    assert read_back(written).total_flux == 3.0


def test_optilands_own_files_refuse_the_lamp(tmp_path: Path) -> None:
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="no TabulatedSource; .*export_scene"):
        with_source(lamp("batwing")).to_json(str(tmp_path / "scene.json"))


class MyLamp(TabulatedSource):
    pass


def test_a_class_derived_from_it_is_refused() -> None:
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="source 'lamp': it is a MyLamp.*or TabulatedSource"):
        entry(MyLamp(cs(), GREEN, [0.0, 90.0], [1.0, 1.0], total_flux=1.0))


# Lamps' files

#: What the program says of a file.
ANSWER: dict[str, Any] = {
    "polar_angles_deg": [0.0, 45.0, 90.0], "azimuth_angles_deg": [0.0, 90.0],
    "intensity": [[100.0, 80.0, 0.0], [90.0, 70.0, 1.0]],
    "opening": {"type": "rectangle", "width": 600.0, "height": 300.0}, "lumens": 245.0, "lamp_lumens": None, "watts": 30.0,
    "keywords": {"MANUFAC": "Nobody"}, "remarks": ["its lumens are not those of its table"]}


def program(folder: Path, answer: str, error: str = "", code: int = 0) -> Path:
    """Return a program that writes down what it was asked, and answers so."""
    path = folder / "nsq-gpu"
    path.write_text(f"#!{sys.executable}\nimport json, sys\njson.dump(sys.argv[1:], open({str(folder / 'asked')!r}, 'w'))\n"
                    f"sys.stdout.write({answer!r})\nsys.stderr.write({error!r})\nsys.exit({code})\n", encoding="utf-8")
    path.chmod(0o755)
    return path


def test_a_lamps_file_is_read_by_the_program(tmp_path: Path) -> None:
    binary = program(tmp_path, json.dumps(ANSWER))
    source = TabulatedSource.from_file(tmp_path / "lamp.IES", cs=cs(z=1.0), spectrum=GREEN, binary=binary)
    assert json.loads((tmp_path / "asked").read_text()) == ["lamp", "--json", "--", str(tmp_path / "lamp.IES")]
    assert source.intensity_units == "cd" and (source.width, source.height, source.radius) == (600.0, 300.0, None)
    assert source.intensity.tolist() == ANSWER["intensity"] and source.cs.z == 1.0
    assert source.keywords == {"MANUFAC": "Nobody"} and source.remarks == ANSWER["remarks"]
    lumens = source.table.flux
    assert source.total_flux == pytest.approx(lumens / 683.002)
    options = {"cs": cs(), "spectrum": GREEN, "binary": binary, "opening": False}
    bare = TabulatedSource.from_file(str(tmp_path / "lamp.ldt"), medium=glass(1.4), **options)
    assert (bare.width, bare.height, bare.radius) == (None, None, None) and bare.medium is not None
    scaled = TabulatedSource.from_file(tmp_path / "lamp.ldt", total_flux_lumens=1000.0, **options)
    assert scaled.intensity_units == "relative" and scaled.total_flux_lumens == 1000.0
    assert TabulatedSource.from_file(tmp_path / "lamp.ldt", total_flux=3.0, **options).total_flux == 3.0
    with pytest.raises(nsq_gpu.UsageError, match="both are given"):
        TabulatedSource.from_file(tmp_path / "lamp.ldt", total_flux=3.0, total_flux_lumens=5.0, **options)


@pytest.mark.parametrize(("opening", "expected"), [
    ({"type": "point"}, (None, None, None)), ({"type": "disk", "radius": 50.0}, (None, None, 50.0)),
    ({"type": "rectangle", "width": 2.0, "height": 3.0}, (2.0, 3.0, None)),
    ({"type": "rectangle", "width": 0.0, "height": 3.0}, (0.0, 3.0, None))])
def test_openings_of_a_lamps_file(opening: Any, expected: Any, tmp_path: Path) -> None:
    binary = program(tmp_path, json.dumps({**ANSWER, "opening": opening}))
    source = TabulatedSource.from_file("lamp.ies", cs=cs(), spectrum=GREEN, binary=binary)
    assert (source.width, source.height, source.radius) == expected


def test_a_scene_may_name_a_lamps_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NSQ_GPU_BINARY", str(program(tmp_path, json.dumps(ANSWER))))
    written = {"type": "tabulated", "name": "lamp", "cs": {}, "spectrum": {"wavelengths": [0.555], "weights": [1.0]},
               "file": "lamp.ies"}

    def source(**more: Any) -> Any:
        return scene_from_dict({"nsq_schema_version": 1, "sources": [{**written, **more}]}, tmp_path / "folder").sources[0]

    plain_one = source()
    assert json.loads((tmp_path / "asked").read_text())[-1] == str(tmp_path / "folder" / "lamp.ies")
    assert plain_one.intensity_units == "cd" and plain_one.width == 600.0
    # What is exported has the table itself, and no file.
    assert entry(plain_one)["intensity"] == ANSWER["intensity"] and "file" not in entry(plain_one)
    disk = source(radius=5, total_flux_lumens=100.0)
    assert (disk.width, disk.height, disk.radius) == (None, None, 5.0) and disk.total_flux_lumens == 100.0


def test_errors_of_a_lamps_file(tmp_path: Path) -> None:
    options = {"cs": cs(), "spectrum": GREEN}
    for path in ("lamp.zmx", "lamp", 5):
        with pytest.raises(nsq_gpu.UsageError, match="path is .*; give the path of a lamp's file, whose name ends with"):
            TabulatedSource.from_file(path, **options)  # type: ignore[arg-type]
    binary = program(tmp_path, "", "nsq-gpu: error: lamp.ies: line 7: no number", 2)
    with pytest.raises(nsq_gpu.UsageError, match="nsq-gpu: lamp.ies: line 7: no number"):
        TabulatedSource.from_file("lamp.ies", binary=binary, **options)
    binary = program(tmp_path, "hello")
    with pytest.raises(nsq_gpu.NsqGpuError, match="its answer is no JSON.*; install a program of this package's version"):
        TabulatedSource.from_file("lamp.ies", binary=binary, **options)
    with pytest.raises(nsq_gpu.BinaryNotFoundError):
        TabulatedSource.from_file("lamp.ies", binary=tmp_path / "absent", **options)


# Pictures


def test_the_polar_diagram() -> None:
    import matplotlib.pyplot as plt

    source = lamp("bilateral", intensity_units="cd")
    axes = source.plot(linewidth=2)
    assert axes.name == "polar" and axes.get_theta_offset() == pytest.approx(1.5 * np.pi)
    assert [line.get_label() for line in axes.lines] == ["C0–C180", "C90–C270"]
    for line, plane in zip(axes.lines, (0.0, 270.0), strict=True):
        angles, shown = np.degrees(line.get_xdata()), line.get_ydata()
        expected = source.table.at(np.abs(angles), np.where(angles >= 0.0, plane, (plane + 180.0) % 360.0))
        np.testing.assert_allclose(shown[1:-1], expected[1:-1], rtol=1e-12)
        assert shown[0] == shown[-1] == 0.0
        assert line.get_linewidth() == 2
    assert "[cd]" in axes.get_xlabel() and axes.get_title().endswith(" lm")
    plt.close(axes.figure)
    # A relative table is shown in the unit of its flux.
    for options, unit, flux in (({"total_flux": 2.0}, "W/sr", 2.0), ({"total_flux_lumens": 500.0}, "cd", 500.0)):
        axes = lamp("isotropic", **options).plot()
        assert [line.get_label() for line in axes.lines] == ["all planes"]
        np.testing.assert_allclose(axes.lines[0].get_ydata(), flux / (4.0 * np.pi))
        assert f"[{unit}]" in axes.get_xlabel()
        plt.close(axes.figure)
    figure, plain_axes = plt.subplots()
    with pytest.raises(nsq_gpu.UsageError, match="a lamp is drawn on polar axes, and ax is rectilinear"):
        source.plot(ax=plain_axes)
    plt.close(figure)


# Backends


def test_numpy_traces_the_lamps() -> None:
    scene = lamp_scene()
    result = scene.trace(20_000, seed=3, backend=NumpyBackend(seed=3))
    assert result.total_flux_in == pytest.approx(sum(source.total_flux for source in scene.sources))
    assert abs(result.flux_conservation_error) < 1e-9
    assert all(result.detectors[name].irradiance.sum() > 0.0 for name in scene.detector_names)


# The program


def assert_same_rays(scene: NSQScene) -> None:
    """Check that the program and NumPy trace the same rays, to 1e-9, in all that is recorded of them."""
    backends = (live.backend(), NumpyBackend(seed=3))
    ours, theirs = (scene.trace(2000, seed=3, record_paths=True, backend=which) for which in backends)
    live.assert_same_paths(ours, theirs)


@pytest.mark.parametrize("opening", [{}, {"width": 3.0, "height": 2.0}, {"radius": 1.5}], ids=["point", "rectangle", "disk"])
@pytest.mark.parametrize("name", LAMPS)
def test_the_program_traces_a_lamp_as_numpy(name: str, opening: Any) -> None:
    scene = with_source(lamp(name, cs(x=1.0, y=-2.0, rx=0.3, rz=0.2), two_lines(), **opening))
    scene.add_detector("front", cs(z=1.0), FarFieldDetectorConfig(num_theta=18, num_phi=24))
    assert_same_rays(scene)


@pytest.mark.parametrize("options", [{"intensity_units": "cd"}, {"intensity_units": "W/sr"}, {"total_flux_lumens": 7.0}], ids=str)
def test_the_program_has_the_flux_of_numpy(options: Any) -> None:
    scene = with_source(lamp("bilateral", spectrum=two_lines(), **options))
    scene.add_detector("front", cs(z=1.0), FarFieldDetectorConfig(num_theta=18, num_phi=24))
    ours, theirs = (scene.trace(2000, seed=3, backend=which) for which in (live.backend(), NumpyBackend(seed=3)))
    assert ours.total_flux_in == pytest.approx(theirs.total_flux_in, rel=1e-12)


def test_the_program_traces_lamps_and_a_lens_as_numpy() -> None:
    live.assert_equals_numpy(lamp_scene(), 20_000)
    assert_same_rays(lamp_scene())


def test_the_program_takes_lumens_of_other_sources() -> None:
    scene = with_source(PupilSource(cs(), two_lines(), beam_radii=(1.0, 1.0)))
    scene.add_source("second", cs(), PointSourceConfig(two_lines()))
    scene.add_detector("front", cs(z=1.0), FarFieldDetectorConfig(num_theta=18, num_phi=24))
    content = document(scene)
    for written in content["sources"]:
        del written["total_flux"]
        written["total_flux_lumens"] = 500.0
    again = scene_from_dict(content)
    ours, theirs = (again.trace(2000, seed=3, backend=which) for which in (live.backend(), NumpyBackend(seed=3)))
    assert ours.total_flux_in == pytest.approx(theirs.total_flux_in, rel=1e-12)


IES = """IESNA:LM-63-2002
[TEST] none
[MANUFAC] Nobody
TILT=NONE
1 1000 1 3 2 1 2 0.6 0.3 0
1 1 30
0 45 90
0 90
100 80 0
90 70 1
"""


def test_the_program_reads_a_lamps_file(tmp_path: Path) -> None:
    (tmp_path / "lamp.ies").write_text(IES, encoding="ascii")
    options = {"cs": cs(), "spectrum": GREEN, "binary": live.binary()}
    source = TabulatedSource.from_file(tmp_path / "lamp.ies", **options)
    assert source.polar_angles_deg.tolist() == [0.0, 45.0, 90.0]
    expected = IntensityTable(*(ANSWER[key] for key in ("polar_angles_deg", "azimuth_angles_deg", "intensity")))
    gamma, c = np.arange(0.0, 91.0, 5.0), np.arange(0.0, 360.0, 15.0)[:, None]
    np.testing.assert_allclose(source.table.at(gamma, c), expected.at(gamma, c), rtol=1e-12)
    assert source.table.flux == pytest.approx(expected.flux, rel=1e-12)
    # The length of an opening, the second of the two, lies along C0.
    assert (source.width, source.height) == pytest.approx((300.0, 600.0))
    assert source.keywords["MANUFAC"] == "Nobody"
    (tmp_path / "broken.ies").write_text(IES.replace("70", "seventy"), encoding="ascii")
    with pytest.raises(nsq_gpu.NsqGpuError, match="broken.ies"):
        TabulatedSource.from_file(tmp_path / "broken.ies", **options)
