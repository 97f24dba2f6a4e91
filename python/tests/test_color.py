"""Colour: X, Y and Z beside colour-science, errors over seeds, the rainbow of a prism, files, pictures and slips."""

from __future__ import annotations

import copy
import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from optiland.colorimetry.core import xyz_to_srgb
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import (
    FarFieldDetectorConfig,
    IrradianceDetectorConfig,
    RayDatabaseConfig,
    SpectralDetectorConfig,
)
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig, PointSourceConfig

import nsq_gpu
import nsq_gpu.cluster
from nsq_gpu.color import WHO, Chromaticity, Color, _chromaticities, _covariance_of
from nsq_gpu.detectors import SphereFarField
from nsq_gpu.export import export
from nsq_gpu.photometry import PEAK
from tests import live
from tests.conftest import ROOT
from tests.live import cs
from tests.test_session import session

colour = pytest.importorskip("colour", reason="colour-science is not installed")
matplotlib.use("Agg")
# Few rays are enough for what is looked at.
pytestmark = pytest.mark.filterwarnings("ignore:.*undersampled", "ignore:no ray reached")

#: Whole nanometres, where the tables of both are those of the standard.
LINES = np.arange(400, 701, 20)
WHITE = Spectrum(np.array([0.45, 0.5, 0.55, 0.6, 0.65]), np.array([1.2, 1.0, 1.0, 0.9, 0.8]))
#: 95 % of 400 intervals are 92 to 98 %, and 68 % are 61 to 75 %: three standard deviations of the count, and more.
SEEDS = 400
WITHIN = {0.6827: (1.0, 0.61, 0.75), 0.95: (1.96, 0.92, 0.98)}


def curves(nm: Any) -> np.ndarray:
    """Return colour-science's colour-matching functions at whole nanometres, (3, ...)."""
    table = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    return np.moveaxis(table[np.asarray(nm, dtype=float)], -1, 0)


def wall(lines: np.ndarray, fluxes: np.ndarray, pixels: int = 2) -> NSQScene:
    """Return a wall that catches all light of one source a wavelength [nm], whose colour is exact."""
    scene = NSQScene()
    for nm, flux in zip(lines, fluxes, strict=True):
        scene.add_source(f"line {nm}", cs(), CollimatedSourceConfig(Spectrum(np.array([nm / 1000.0]), np.ones(1)),
                                                                    total_flux=float(flux), aperture_radius=1.0))
    scene.add_detector("wall", cs(z=10.0), IrradianceDetectorConfig(4.0, 4.0, pixels, pixels, splat="hard"))
    return scene


def lamp(half_angle: float = 60.0) -> NSQScene:
    """Return a lamp of five wavelengths, a wall that lets light pass, and the directions behind it."""
    scene = NSQScene()
    scene.add_source("lamp", cs(), PointSourceConfig(WHITE, half_angle_deg=half_angle))
    scene.add_detector("wall", cs(z=100.0), IrradianceDetectorConfig(400.0, 300.0, 8, 6, absorb=False))
    scene.add_detector("sky", cs(z=101.0), FarFieldDetectorConfig(9, 12))
    return scene


def truth(spectrum: Spectrum) -> np.ndarray:
    """Return X, Y and Z of 1 W of a spectrum [lm]."""
    weights = np.asarray(spectrum.weights) / np.sum(spectrum.weights)
    return PEAK * (curves(np.round(np.asarray(spectrum.wavelengths) * 1000.0)) * weights).sum(axis=-1)


@pytest.fixture(scope="module")
def result() -> nsq_gpu.Result:
    return lamp().trace(40_000, seed=3, backend=live.backend(color=True, standard_error=True))


@pytest.fixture(scope="module")
def plain() -> nsq_gpu.Result:
    return lamp().trace(2000, backend=live.backend(photometric=True))


# Numbers


#: Ten spectra, by colour-science's names.
SPECTRA = ["A", "B", "C", "D50", "D65", "E", "FL2", "FL11", "HP1", "LED-B3"]


@pytest.mark.parametrize("name", SPECTRA)
def test_x_y_z_and_chromaticity_are_those_of_colour_science(name: str) -> None:
    whole = colour.SDS_ILLUMINANTS[name].copy().interpolate(colour.SpectralShape(400, 700, 20))
    fluxes = np.asarray(whole.values) / 100.0
    powers = dict.fromkeys(range(360, 781), 0.0) | dict(zip(LINES.tolist(), fluxes.tolist(), strict=True))
    expected = colour.sd_to_XYZ(colour.SpectralDistribution(powers), method="Integration", k=PEAK)
    seen = wall(LINES, fluxes).trace(1600, backend=live.backend(color=["wall"], standard_error=True)).detectors["wall"]
    # A wall of 16 mm^2, in lux.
    assert np.allclose(seen.xyz.mean(axis=(1, 2)) * 16e-6, expected, rtol=1e-9)
    assert np.allclose(seen.xyz[1], seen.illuminance, rtol=1e-12)
    xy = colour.XYZ_to_xy(expected)
    found = seen.chromaticity(whole=True)
    assert np.allclose([found.x, found.y], xy, rtol=1e-9)
    assert np.allclose([found.u_prime, found.v_prime], colour.xy_to_Luv_uv(xy), rtol=1e-9)
    by_pixel = seen.chromaticity()
    for here in np.ndindex(2, 2):
        xy = colour.XYZ_to_xy(seen.xyz[:, *here])
        assert np.allclose([by_pixel.x[here], by_pixel.y[here]], xy, rtol=1e-9)
        assert np.allclose([by_pixel.u_prime[here], by_pixel.v_prime[here]], colour.xy_to_Luv_uv(xy), rtol=1e-9)


def test_the_rainbow_of_a_prism_is_that_of_its_spectral_detector() -> None:
    document = json.loads((ROOT / "scenes" / "prism_spectrometer.json").read_text(encoding="utf-8"))
    lines = np.unique([nm for source in document["sources"] for nm in source["spectrum"]["wavelengths"]])
    seen = {}
    for kind in ("spectral", "irradiance"):
        of_kind = copy.deepcopy(document)
        entry = of_kind["detectors"][0]
        entry["type"] = kind
        if kind == "irradiance":
            for key in ("wl_min", "wl_max", "num_bins"):
                del entry[key]
            entry["color"] = "xyz"
        # The same rays come to either.
        with session() as one:
            seen[kind] = one.request(json.dumps(of_kind), {"num_rays": 100_000, "seed": 4}).arrays("spectrum")
    edges = seen["spectral"]["wavelength_edges"]
    bins = np.searchsorted(edges, lines) - 1
    assert len(set(bins)) == len(lines)
    nm = np.arange(380, 781)
    of_lines = np.array([np.interp(lines * 1000.0, nm, part) for part in curves(nm)])
    expected = 1e6 * PEAK * np.einsum("yxl,kl->kyx", seen["spectral"]["irradiance"][:, :, bins], of_lines)
    found = np.stack([seen["irradiance"][part] for part in "XYZ"])
    assert np.abs(found - expected).max() < 1e-9 * expected.max()
    # Blue on one side, red on the other.
    red, _, blue = (found.sum(axis=1) * np.arange(60)).sum(axis=1) / found.sum(axis=(1, 2))
    assert abs(red - blue) > 5.0


def test_the_far_field_has_the_colour_of_the_lamp(result: nsq_gpu.Result) -> None:
    sky = result.detectors["sky"]
    expected = _chromaticities(truth(WHITE))[0]
    found = sky.chromaticity(whole=True)
    apart = (np.array([found.x, found.y, found.u_prime, found.v_prime]) - expected) / found.standard_error
    assert np.abs(apart).max() < 4.5
    by_cell = sky.chromaticity()
    lit = np.isfinite(by_cell.standard_error[0])
    apart = (by_cell.x[lit] - expected[0]) / by_cell.standard_error[0][lit]
    assert lit.sum() > 60 and np.abs(apart).max() < 4.5 and 0.6 < apart.std() < 1.4
    # Behind the last cone there is no light, and no colour.
    assert np.isnan(by_cell.x[7:]).all() and np.isnan(by_cell.standard_error[:, 7:]).all()
    assert np.allclose(sky.xyz[1], sky.luminous_intensity, rtol=1e-12)


def test_a_pixel_of_few_rays_has_a_colour_and_no_error_of_it(result: nsq_gpu.Result) -> None:
    few = lamp().trace(300, backend=live.backend(color=True, standard_error=True)).detectors["wall"]
    found, hits = few.chromaticity(), few.chromaticity.__self__._arrays["hits"]
    assert ((hits < 10) == np.isnan(found.standard_error[0])).all() and (hits < 10).any() and (hits >= 10).any()
    assert np.isfinite(found.x[few.xyz.sum(axis=0) > 0.0]).all()


# Errors


@dataclasses.dataclass
class Seeds:
    """Traces of many seeds: figures (seeds, figures), their errors, and the truth."""

    values: np.ndarray
    errors: np.ndarray
    expected: np.ndarray

    def coverage(self, width: float) -> np.ndarray:
        return (np.abs(self.values - self.expected) <= width * self.errors).mean(axis=0)

    def is_right(self, figures: slice) -> bool:
        return all(((low <= self.coverage(width)[figures]) & (self.coverage(width)[figures] <= high)).all()
                   for width, low, high in WITHIN.values())


#: Which figures are of X, Y and Z of a pixel; x, y, u' and v' of it; x, y, u' and v' of all light.
XYZ, PIXEL, WHOLE = slice(0, 3), slice(3, 7), slice(7, 11)


@pytest.fixture(scope="module")
def over_seeds() -> Callable[[float], Seeds]:
    """Trace a beam that lights the pixels alike, over seeds; return figures with covariances times a factor."""
    scene = NSQScene()
    scene.add_source("beam", cs(), CollimatedSourceConfig(WHITE, total_flux=1.0, aperture_radius=1.0))
    scene.add_detector("wall", cs(z=10.0), IrradianceDetectorConfig(4.0, 4.0, 2, 2, splat="hard"))
    seen = []
    with session() as one:
        for seed in range(SEEDS):
            seen.append(one.trace(scene, 1500, seed=seed, color=True, standard_error=True).detectors["wall"])
    of_all = truth(WHITE)
    # A quarter of the light, on 4 mm^2.
    expected = np.concatenate([of_all / 4.0 / 4e-6, _chromaticities(of_all)[0], _chromaticities(of_all)[0]])

    def figures(factor: float) -> Seeds:
        values, errors = [], []
        for wall in seen:
            found = copy.copy(wall.chromaticity.__self__)
            found.xyz_covariance = factor * found.xyz_covariance
            pixel, whole = found.chromaticity(), found.chromaticity(whole=True)
            values.append([*wall.xyz[:, 0, 1], *(part[0, 1] for part in parts(pixel)), *parts(whole)])
            errors.append([*wall.xyz_standard_error[:, 0, 1], *pixel.standard_error[:, 0, 1], *whole.standard_error])
        return Seeds(np.array(values), np.array(errors), expected)

    return figures


def parts(found: Chromaticity) -> list[Any]:
    return [found.x, found.y, found.u_prime, found.v_prime]


@pytest.mark.parametrize("figures", [XYZ, PIXEL, WHOLE], ids=["XYZ", "pixel", "whole"])
def test_intervals_hold_the_truth_over_400_seeds(over_seeds: Callable[[float], Seeds], figures: slice) -> None:
    found = over_seeds(1.0)
    assert found.is_right(figures), {width: found.coverage(width)[figures] for width, *_ in WITHIN.values()}
    # No figure is off on average.
    bias = (found.values.mean(axis=0) - found.expected) / (found.values.std(axis=0) / np.sqrt(SEEDS))
    assert np.abs(bias[figures]).max() < 4.0


@pytest.mark.parametrize("factor", [0.0, -1.0, 0.7])
def test_wrong_covariances_are_noticed(over_seeds: Callable[[float], Seeds], factor: float) -> None:
    planted = over_seeds(factor)
    assert not planted.is_right(PIXEL) and planted.is_right(XYZ)


def test_the_covariance_of_all_light_follows_from_errors_of_the_report() -> None:
    random = np.random.default_rng(1)
    for _ in range(20):
        xyz, roots = random.uniform(0.2, 1.0, 3), random.normal(0.0, 0.01, (3, 3))
        values, gradients = _chromaticities(xyz)
        all_four = gradients @ (roots @ roots.T) @ gradients.T
        found = _covariance_of(Chromaticity(*values, standard_error=np.sqrt(np.diag(all_four))))
        assert np.allclose(found, all_four[2:, 2:], rtol=1e-6, atol=1e-12)


# Colour temperatures


def planck(kelvin: float, um: np.ndarray) -> np.ndarray:
    return um**-5.0 / np.expm1(14_388.0 / (um * kelvin))


def test_the_light_of_illuminant_a_has_its_colour_temperature() -> None:
    nm = np.arange(380, 781, 5)
    kelvin = 2848.0 * 1.4388 / 1.435
    lines = wall(nm, planck(kelvin, nm / 1000.0) / 1e3)
    exact = lines.trace(810, backend=live.backend(color=True, standard_error=False)).detectors["wall"].cct(whole=True)
    assert exact.cct == pytest.approx(kelvin, abs=0.1) and abs(exact.duv) < 1e-5 and exact.cct_standard_error is None
    scene = NSQScene()
    spectrum = Spectrum(nm[::4] / 1000.0, planck(kelvin, nm[::4] / 1000.0))
    scene.add_source("lamp", cs(), CollimatedSourceConfig(spectrum, aperture_radius=1.0))
    scene.add_detector("wall", cs(z=10.0), IrradianceDetectorConfig(4.0, 4.0, 2, 2, splat="hard"))
    expected = _chromaticities(truth(spectrum))[0]
    cct, duv = colour.temperature.uv_to_CCT_Ohno2013(expected[2:] * [1.0, 2.0 / 3.0])
    seen = scene.trace(20_000, backend=live.backend(color=True, standard_error=True)).detectors["wall"]
    whole, pixels = seen.cct(whole=True), seen.cct()
    assert pixels.cct.shape == pixels.duv_standard_error.shape == (2, 2)
    assert np.abs((pixels.cct - cct) / pixels.cct_standard_error).max() < 4.5
    assert np.abs((pixels.duv - duv) / pixels.duv_standard_error).max() < 4.5
    assert abs(whole.cct - cct) < 4.5 * whole.cct_standard_error and abs(whole.duv - duv) < 4.5 * whole.duv_standard_error
    # A quarter of the rays has twice the error.
    assert whole.cct_standard_error == pytest.approx(pixels.cct_standard_error.mean() / 2.0, rel=0.1)
    assert 1.0 < whole.cct_standard_error < 60.0


def test_errors_of_colour_temperatures_are_those_of_many_draws(result: nsq_gpu.Result) -> None:
    seen = result.detectors["wall"]
    of_color = seen.chromaticity.__self__
    here = (3, 4)
    found = seen.cct()
    covariance = of_color._covariance()[:, :, *here]
    draws = np.random.default_rng(2).multivariate_normal(seen.xyz[:, *here], covariance / 100.0, 2000)
    uv = _chromaticities(draws.T)[0][2:].T * [1.0, 2.0 / 3.0]
    drawn = colour.temperature.uv_to_CCT_Ohno2013(uv)
    for part, error in ((0, found.cct_standard_error), (1, found.duv_standard_error)):
        assert error[here] / 10.0 == pytest.approx(drawn[:, part].std(), rel=0.08)


def test_light_that_is_no_white_has_no_colour_temperature() -> None:
    seen = wall(np.array([530]), np.ones(1)).trace(100, backend=live.backend(color=True, standard_error=True)).detectors["wall"]
    assert np.isnan(seen.cct().cct).all() and np.isnan(seen.cct(whole=True).duv)
    assert np.isnan(seen.cct(whole=True).cct_standard_error)


def test_a_library_that_is_not_there_is_named(result: nsq_gpu.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "colour.temperature", None)
    with pytest.raises(nsq_gpu.MissingLibraryError, match=r"colour-science is not installed.*pip install 'nsq-gpu\[color\]'"):
        result.detectors["wall"].cct()


# Pictures


@pytest.fixture(autouse=True)
def no_pictures() -> Iterator[None]:
    yield
    matplotlib.pyplot.close("all")


def test_srgb_is_that_of_colour_science_and_of_optiland(result: nsq_gpu.Result) -> None:
    seen = result.detectors["wall"]
    found = seen.srgb()
    assert found.shape == (6, 8, 3) and found.min() >= 0.0 and found.max() <= 1.0
    white = 1.7 * seen.xyz[1].max()
    expected = colour.XYZ_to_sRGB(np.moveaxis(seen.xyz / white, 0, -1))
    assert np.abs(seen.srgb(white=white) - np.clip(expected, 0.0, 1.0)).max() < 2e-4
    optilands = np.stack(xyz_to_srgb(*(seen.xyz / white * 100.0)), axis=-1)
    assert np.abs(seen.srgb(white=white) * 255.0 - optilands).max() < 1.0 + 1e-9
    assert result.detectors["sky"].srgb().shape == (9, 12, 3)
    for wrong in (0.0, -1.0, "D65", np.nan):
        with pytest.raises(nsq_gpu.UsageError, match="white is .*; give the Y that is white, a positive number"):
            seen.srgb(white=wrong)


def test_maps_are_drawn_in_their_colours(result: nsq_gpu.Result) -> None:
    seen = result.detectors["wall"]
    ax = seen.plot_color()
    assert np.allclose(ax.images[0].get_array(), seen.srgb()) and ax.images[0].get_extent() == [-200.0, 200.0, -150.0, 150.0]
    assert ax.get_title().startswith("wall: x 0.31") and ax.get_xlabel() == "x [mm]"
    polar = result.detectors["sky"].plot_color(smooth=False)
    assert polar.name == "polar" and polar.get_title().startswith("sky: x 0.31")
    assert np.allclose(polar.collections[0].get_array()[:, ::15], result.detectors["sky"].srgb())
    with pytest.raises(nsq_gpu.UsageError, match="drawn on polar axes"):
        result.detectors["sky"].plot_color(ax=ax)


def two_lamps() -> NSQScene:
    """Return a bluish narrow lamp in a reddish wide one, and their far field."""
    scene = NSQScene()
    for name, nm, half in (("blue", 0.47, 20.0), ("red", 0.61, 60.0)):
        scene.add_source(name, cs(), PointSourceConfig(Spectrum(np.array([nm]), np.ones(1)), half_angle_deg=half))
    scene.add_detector("sky", cs(z=10.0), FarFieldDetectorConfig(18, 12))
    return scene


def test_colour_over_angle_is_that_of_both_lamps() -> None:
    seen = two_lamps().trace(60_000, backend=live.backend(color=True, standard_error=True)).detectors["sky"]
    found = seen.color_over_angle(middle=12.0)
    # Per solid angle, of a point that shines alike in its cone.
    within = [1.0 / (1.0 - np.cos(np.radians(half))) for half in (20.0, 60.0)]
    of_both = _chromaticities((curves([470, 610]) * within).sum(axis=-1))[0][2:]
    of_red = _chromaticities(curves([610])[:, 0])[0][2:]
    expected = np.where(found.theta < 20.0, 0.0, np.hypot(*(of_red - of_both)))
    inner, outer = found.theta < 20.0, (found.theta > 20.0) & (found.theta < 60.0)
    assert (found.delta_uv[inner] < 4.0 * found.noise[inner]).all() and (found.noise[inner] > 0.0).all()
    assert np.abs((found.delta_uv - expected)[outer] / found.standard_error[outer]).max() < 4.0
    assert np.isnan(found.delta_uv[found.theta > 60.0]).all()
    ax = seen.plot_color_over_angle(12.0, color="k")
    assert np.allclose(ax.lines[0].get_ydata(), found.delta_uv, equal_nan=True) and len(ax.collections) == 1
    assert ax.get_ylabel() == "Δu'v' from the middle" and ax.get_xlabel() == "theta [deg]"


def white_lamps() -> NSQScene:
    """Return a bluish narrow white in a reddish wide one, and their far field."""
    scene = NSQScene()
    for name, weights, half in (("cool", [1.5, 1.0, 0.8, 0.6, 0.5], 20.0), ("warm", [0.4, 0.7, 1.0, 1.4, 1.0], 60.0)):
        scene.add_source(name, cs(), PointSourceConfig(Spectrum(WHITE.wavelengths, np.array(weights)), half_angle_deg=half))
    scene.add_detector("sky", cs(z=10.0), FarFieldDetectorConfig(18, 12))
    return scene


def test_colour_temperature_over_angle_is_that_of_both_lamps() -> None:
    scene = white_lamps()
    seen = scene.trace(200_000, backend=live.backend(color=True, standard_error=True)).detectors["sky"]
    found = seen.color_over_angle()
    temperature = found.cct()
    cool, warm = (truth(source.spectrum) / (1.0 - np.cos(np.radians(half)))
                  for source, half in zip(scene.sources, (20.0, 60.0), strict=True))
    inner, outer = found.theta < 20.0, (found.theta > 20.0) & (found.theta < 60.0)
    for where, xyz in ((inner, cool + warm), (outer, warm)):
        values = _chromaticities(xyz)[0]
        cct, duv = colour.temperature.uv_to_CCT_Ohno2013(values[2:] * [1.0, 2.0 / 3.0])
        apart = (np.stack(parts(found.chromaticity))[:, where] - values[:, None]) / found.chromaticity.standard_error[:, where]
        assert np.abs(apart).max() < 4.5
        assert np.abs((temperature.cct - cct) / temperature.cct_standard_error)[where].max() < 4.5
        assert np.abs((temperature.duv - duv) / temperature.duv_standard_error)[where].max() < 4.5
    assert np.isnan(temperature.cct[found.theta > 60.0]).all() and "_covariance" not in repr(found)
    for of, label in (("cct", "CCT [K]"), ("duv", "Duv")):
        ax = seen.plot_color_over_angle(of=of, color="k")
        assert np.array_equal(ax.lines[0].get_ydata(), getattr(temperature, of), equal_nan=True)
        assert ax.get_ylabel() == label and len(ax.collections) == len(ax.lines) == 1
    with pytest.raises(nsq_gpu.UsageError, match="of is 'CCT'; give 'delta_uv', 'cct' or 'duv'"):
        seen.plot_color_over_angle(of="CCT")


def test_one_azimuth_and_many_have_one_colour_over_angle() -> None:
    """Far fields of one ring and of twelve cells a ring see the same rays."""
    scene = white_lamps()
    scene.add_detector("ring", cs(z=11.0), FarFieldDetectorConfig(18, 1))
    scene.detector_registry.get("sky").absorb = False
    traced = scene.trace(20_000, backend=live.backend(color=True, standard_error=True))
    many, one = (traced.detectors[name] for name in ("sky", "ring"))
    rings, cells = many.color_over_angle(), one.cct()
    assert np.allclose(rings.cct().cct, cells.cct[:, 0], rtol=1e-9, equal_nan=True)
    assert np.allclose(rings.cct().cct_standard_error[:12], cells.cct_standard_error[:12, 0], rtol=0.02)


def test_errors_over_angle_are_those_of_many_seeds() -> None:
    values, errors = [], []
    with session() as one:
        for seed in range(100):
            found = one.trace(two_lamps(), 3000, seed=seed, color=True, standard_error=True).detectors["sky"].color_over_angle(12.0)
            values.append(found.delta_uv[[1, 5, 9]])
            errors.append([found.noise[1], *found.standard_error[[5, 9]]])
    spread = np.sqrt((np.array(values)[:, 0] ** 2).mean()), *np.array(values)[:, 1:].std(axis=0)
    assert np.abs(np.sqrt((np.array(errors) ** 2).mean(axis=0)) / spread - 1.0).max() < 0.25


# Who asks


def test_the_exporter_writes_what_sees_colour(tmp_path: Path) -> None:
    scene = lamp()
    scene.detector_registry.get("sky").color = "xyz"
    nsq_gpu.export_scene(scene, tmp_path / "scene.json")
    again = nsq_gpu.load_scene(tmp_path / "scene.json")
    assert export(again).document == export(scene).document
    assert [entry.get("color") for entry in export(again).document["detectors"]] == [None, "xyz"]
    with session() as one:
        for color, seen in ((None, [False, True]), (["wall"], [True, False]), (True, [True, True]), ([], [False, False])):
            found = one.trace(again, 200, color=color)
            assert [live.xyz is not None for live in found.detectors.values()] == seen
    # The live scene stays as it was.
    assert export(again).document == export(scene).document


def test_a_detector_of_a_sphere_sees_colour(tmp_path: Path) -> None:
    scene = lamp()
    scene.remove_detector("sky")
    scene.detector_registry.add("sky", SphereFarField(cs(z=101.0), num_bins_theta=12, num_bins_phi=4))
    scene.detector_registry.get("sky").color = "xyz"
    nsq_gpu.export_scene(scene, tmp_path / "scene.json")
    again = nsq_gpu.load_scene(tmp_path / "scene.json")
    entry = export(again).document["detectors"][1]
    assert (entry["sphere"], entry["color"]) == (True, "xyz")
    seen = again.trace(2000, backend=live.backend(standard_error=True)).detectors["sky"].color_over_angle()
    assert seen.theta[-1] == 172.5 and np.isnan(seen.delta_uv[6:]).all() and np.isfinite(seen.delta_uv[:3]).all()


@pytest.mark.parametrize(("color", "said"), [
    ("wall", r"color is 'wall'; give True, or a list of names of detectors, such as \['wall'\]"),
    ("xyz", r"color is 'xyz'; give True, or a list of names of detectors, such as \['wall'\]"),
    (1.5, "color is 1.5; give True, or a list"),
    ([3], r"color is \[3\]; give True, or a list"),
    (["wal"], "color names the detector 'wal', which the scene has not; did you mean 'wall'?"),
    (["zzz"], "which the scene has not; known here: 'wall', 'sky'"),
    (["rays"], "color names 'rays', which is of the kind ray_database; irradiance and far-field detectors see colour"),
    (["bins"], "color names 'bins', which is of the kind spectral"),
])
def test_what_cannot_see_colour_is_refused(color: Any, said: str) -> None:
    scene = lamp()
    scene.add_detector("rays", cs(z=200.0), RayDatabaseConfig(1.0, 1.0))
    scene.add_detector("bins", cs(z=300.0), SpectralDetectorConfig(1.0, 1.0))
    with pytest.raises(nsq_gpu.UsageError, match=said):
        scene.trace(100, backend=live.backend(color=color))
    with session() as one, pytest.raises(nsq_gpu.UsageError, match=said):
        one.trace(scene, 100, color=color)


def test_scenes_and_switches_without_colour_are_refused() -> None:
    scene = lamp()
    with pytest.raises(nsq_gpu.UsageError, match="photometric is False, and color needs lumens; leave one of them out"):
        live.backend(photometric=False, color=["wall"])
    assert live.backend(photometric=False, color=[]).color == ()
    with session() as one, pytest.raises(nsq_gpu.UsageError, match="the detector `wall` has a `color`, which is photometric"):
        one.trace(scene, 100, color=["wall"], photometric=False)
    scene.detector_registry.get("wall").color = "lab"
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="detector 'wall': color: 'lab' is unknown; give 'xyz'"):
        export(scene)
    alone = NSQScene()
    alone.add_source("lamp", cs(), PointSourceConfig(WHITE))
    alone.add_detector("bins", cs(z=300.0), SpectralDetectorConfig(1.0, 1.0))
    with pytest.raises(nsq_gpu.UsageError, match="color is True, and the scene has no irradiance and no far-field detector"):
        alone.trace(100, backend=live.backend(color=True))
    alone.detector_registry.get("bins").color = "xyz"
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="detector 'bins': color: 'xyz' of a detector of the kind spectral"):
        export(alone)


def test_colour_that_is_not_known_is_refused_with_what_to_do(plain: nsq_gpu.Result, result: nsq_gpu.Result) -> None:
    seen = plain.detectors["wall"]
    assert seen.xyz is None and seen.xyz_standard_error is None and seen.xyz_covariance is None
    for call in (seen.chromaticity, seen.cct, seen.srgb, seen.plot_color, plain.detectors["sky"].color_over_angle):
        with pytest.raises(nsq_gpu.UsageError, match="the colour of '(wall|sky)' is not known; trace with color=True, or color="):
            call()
    with pytest.raises(nsq_gpu.UsageError, match="'wall' has no angles: it is of the kind irradiance, and no far field"):
        result.detectors["wall"].plot_color_over_angle()
    scene = lamp()
    scene.add_detector("rays", cs(z=200.0), RayDatabaseConfig(1.0, 1.0))
    rays = scene.trace(100, backend=live.backend(color=True)).detectors["rays"]
    with pytest.raises(nsq_gpu.UsageError, match=f"'rays' is of the kind ray_database; {WHO}"):
        rays.chromaticity()


def test_errors_are_none_where_they_are_not_asked_for() -> None:
    seen = lamp().trace(2000, backend=live.backend(color=True, standard_error=False)).detectors
    assert seen["wall"].xyz is not None and seen["wall"].xyz_standard_error is None and seen["wall"].xyz_covariance is None
    for whole in (False, True):
        assert seen["wall"].chromaticity(whole).standard_error is None and seen["wall"].cct(whole).duv_standard_error is None
    found = seen["sky"].color_over_angle()
    assert found.standard_error is None and found.chromaticity.standard_error is None and found.cct().cct_standard_error is None
    assert all(len(seen["sky"].plot_color_over_angle(of=of).lines) == 1 for of in ("delta_uv", "cct", "duv"))


def test_the_dark_has_no_colour() -> None:
    scene = lamp(half_angle=5.0)
    scene.add_detector("behind", cs(z=-10.0), IrradianceDetectorConfig(1.0, 1.0, 2, 2))
    seen = scene.trace(500, backend=live.backend(color=True, standard_error=True)).detectors["behind"]
    assert np.isnan(seen.chromaticity().x).all() and np.isnan(seen.chromaticity(whole=True).v_prime)
    assert np.isnan(seen.cct().cct).all() and np.isnan(seen.cct(whole=True).cct) and (seen.srgb() == 0.0).all()


# Files


def test_a_result_is_saved_and_read_with_its_colour(result: nsq_gpu.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "run")
    again = nsq_gpu.load(tmp_path / "run")
    for name, seen in result.detectors.items():
        for key in ("xyz", "xyz_standard_error", "xyz_covariance"):
            assert np.array_equal(getattr(again.detectors[name], key), getattr(seen, key), equal_nan=True)
        assert again.detectors[name].cct(whole=True) == seen.cct(whole=True)
        mine, other = seen.chromaticity(), again.detectors[name].chromaticity()
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(vars(mine).values(), vars(other).values(), strict=True))


def test_merged_and_resumed_results_keep_colour(tmp_path: Path) -> None:
    scene = lamp()
    for name in scene.detector_names:
        scene.detector_registry.get(name).color = "xyz"
    file = tmp_path / "scene.json"
    nsq_gpu.export_scene(scene, file)

    def command(*arguments: str) -> None:
        subprocess.run([live.binary(), *arguments, "--no-pictures"], check=True, capture_output=True, cwd=tmp_path)

    def trace(folder: str, *arguments: str) -> None:
        command("trace", str(file), "--standard-error=on", "--precision=f64", "-o", folder, *arguments)

    trace("whole", "-n", "4000")
    trace("a", "-n", "1500", "--of-rays=4000")
    trace("b", "-n", "2500", "--first-ray=1500", "--of-rays=4000")
    command("merge", "a", "b", "-o", "merged", "--scene", str(file))
    trace("part", "-n", "4000", "--batch-size=500", "--time-limit=1ms", "--checkpoint=sums.bin")
    assert 0 < nsq_gpu.load(tmp_path / "part").num_rays_total < 4000
    trace("resumed", "-n", "4000", "--resume=sums.bin")
    whole = nsq_gpu.load(tmp_path / "whole").detectors
    for folder in ("merged", "resumed"):
        for name, seen in nsq_gpu.load(tmp_path / folder).detectors.items():
            assert np.array_equal(seen.xyz, whole[name].xyz) and np.array_equal(seen.xyz_covariance, whole[name].xyz_covariance)
            assert vars(seen.chromaticity(whole=True)).keys() == vars(whole[name].chromaticity(whole=True)).keys()
            assert seen.chromaticity(whole=True).x == whole[name].chromaticity(whole=True).x


def test_a_cluster_keeps_colour() -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    from tests.test_cluster import distributed, local_cluster

    with session() as one:
        expected = one.trace(lamp(), 4000, color=["sky"], standard_error=True, strict="on").detectors
    with local_cluster(1) as local, distributed.Client(local) as client:
        found = nsq_gpu.cluster.trace(lamp(), 4000, client, 2, precision="f64", binary=live.binary(), color=["sky"],
                                      standard_error=True).detectors
    assert np.array_equal(found["sky"].xyz, expected["sky"].xyz) and found["wall"].xyz is None
    assert np.array_equal(found["sky"].xyz_covariance, expected["sky"].xyz_covariance)


def test_a_long_trace_has_the_same_colour_and_watts(result: nsq_gpu.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nsq_gpu.backend, "MOST_SESSION_RAYS", 0)
    alone = lamp().trace(40_000, seed=3, backend=live.backend(color=True, standard_error=True))
    watts = lamp().trace(40_000, seed=3, backend=live.backend(standard_error=True))
    for name, seen in result.detectors.items():
        assert np.array_equal(alone.detectors[name].xyz, seen.xyz)
        assert np.array_equal(alone.arrays[name]["standard_error"], watts.arrays[name]["standard_error"])
        assert watts.detectors[name].xyz is None


def test_datasets_have_colour(result: nsq_gpu.Result, plain: nsq_gpu.Result) -> None:
    pytest.importorskip("xarray")
    found = result.to_xarray()
    assert found.wall_xyz.dims == ("wall_tristimulus", "wall_y", "wall_x") and found.wall_xyz.attrs["units"] == "lx"
    assert found.sky_xyz_covariance.dims == ("sky_pair", "sky_theta", "sky_phi")
    assert found.sky_xyz_covariance.attrs["units"] == "cd^2" and found.wall_xyz_standard_error.attrs["units"] == "lx"
    assert np.array_equal(found.wall_xyz.sel(wall_tristimulus="Y"), found.wall_illuminance)
    assert list(found.wall_pair.values) == ["XY", "XZ", "YZ"] and "wall_xyz" not in plain.to_xarray()


def test_a_detector_with_colour_is_copied_and_pickled(result: nsq_gpu.Result) -> None:
    import pickle

    seen = result.detectors["wall"]
    for again in (copy.deepcopy(seen), pickle.loads(pickle.dumps(seen))):
        assert np.array_equal(again.chromaticity().x, seen.chromaticity().x)
    assert isinstance(seen.chromaticity.__self__, Color)
