"""Scattering laws: spellings, closed forms, and traces against NumPy ray by ray."""

from __future__ import annotations

import json
import math
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.bsdf import HarveyShackBSDF, LambertianBSDF, SpecularBRDF, TabulatedBSDF
from optiland.nonsequential.components.configs import LensConfig, MirrorConfig, SurfaceConfig
from scipy.integrate import quad

import nsq_gpu
from nsq_gpu.bsdf import ABg, KCorrelation, by_tis, tis
from tests import live
from tests.live import cs, glass

LENS: dict[str, Any] = {"r1": 60.0, "r2": -60.0, "thickness": 5.0, "material": glass(), "front_aperture_radius": 10.0}


def lens_and_mirror(**finish: Any) -> NSQScene:
    """Return a lens and a tilted mirror with one finish: oblique incidence, both branches and both sides."""
    scene = live.bench()
    scene.add_lens("L", cs(), LensConfig(**LENS, front=SurfaceConfig(**finish)))
    scene.add_mirror("M", cs(z=15.0, rx=0.7), MirrorConfig(-90.0, 0.9, aperture_radius=8.0, surface=SurfaceConfig(**finish)))
    return scene


def written(scene: NSQScene, folder: Path) -> dict[str, Any]:
    nsq_gpu.export_scene(scene, folder / "scene.json")
    document: dict[str, Any] = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
    return document


def table(folder: Path, rows: dict[float, list[float]]) -> TabulatedBSDF:
    """Return a table at 0, 30 and 90 degrees of scatter."""
    lines = [f"{i},{s},{value}" for i, values in rows.items() for s, value in zip((0.0, 30.0, 90.0), values, strict=True)]
    (folder / "table.csv").write_text("\n".join(lines), encoding="utf-8")
    return TabulatedBSDF(folder / "table.csv")


# ABg


@pytest.mark.parametrize(("A", "B", "g"), [(1e-3, 1e-4, 2.0), (0.02, 1e-3, 1.5), (3.0, 2.5, 3.3)])
def test_abg_is_the_harvey_shack_lobe_of_its_formula(A: float, B: float, g: float, tmp_path: Path) -> None:  # noqa: N803
    lobe = ABg(A, B, g, 0.25)
    beta = np.geomspace(1e-5, 2.0, 40)
    np.testing.assert_allclose(lobe._abg(beta), A / (B + beta**g), rtol=1e-13)
    spelled = HarveyShackBSDF(A / B, B ** (1.0 / g), g, 0.25)
    assert type(lobe) is HarveyShackBSDF and vars(lobe) == vars(spelled)
    (tmp_path / "one").mkdir()
    (tmp_path / "other").mkdir()
    scenes = [lens_and_mirror(bsdf=bsdf, scatter_fraction=0.5) for bsdf in (lobe, spelled)]
    assert written(scenes[0], tmp_path / "one") == written(scenes[1], tmp_path / "other")
    for which in (live.backend, live.NumpyBackend):
        one, other = (live.traced(scene, 400, which())[1] for scene in scenes)
        assert live.same(one, other)
    live.assert_equals_numpy(scenes[0], 2000)


@pytest.mark.parametrize(("arguments", "words"), [
    ((0.0, 1e-3, 2.0), "A is 0.0: the lobe scatters nothing; give a number above 0"),
    ((-1.0, 1e-3, 2.0), "A is -1.0"),
    ((1.0, 0.0, 2.0), "B is 0: then the BSDF has no level at the specular direction, where it is A / B; give a number above 0"),
    ((1.0, -1e-3, 2.0), "B is -0.001: the BSDF would be negative"),
    ((1.0, 1e-3, 0.0), "g is 0: then the BSDF is the same in all directions; give a number above 0, or a LambertianBSDF"),
    ((1.0, 1e-3, -2.0), "g is -2.0; give a number from 0 to 1000"),
    ((1.0, 1e-3, math.inf), "g is inf; give a finite number"),
    ((1.0, 1e-30, 2.0), r"the shoulder B\^\(1/g\) is 1e-15; give a B whose shoulder lies from 1e-12 to 1e12"),
    ((1.0, 10.0, 1e-3), r"the shoulder B\^\(1/g\) is inf"),
    ((1e30, 1e-3, 2.0), "the level at the specular direction, is 1e.33; give at most 1e30"),
    ((1.0, 1e-3, 2.0, 1.5), "transmissive_fraction is 1.5; give a number from 0 to 1"),
    (("much", 1e-3, 2.0), "A is 'much'; give a number"),
])
def test_abg_refuses_what_no_surface_has(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ABg(*arguments)


# K-correlation


@pytest.mark.parametrize("s", [0.0, 0.5, 2.0, 2.0 + 1e-12, 2.5, 4.0, 60.0])
@pytest.mark.parametrize("B", [0.1, 3.0, 50.0, 1e4])
def test_the_closed_form_is_the_integral_and_its_inverse(B: float, s: float) -> None:  # noqa: N803
    lobe = KCorrelation(0.5, B, s)
    for beta in (0.01, 1.0, 2.0):
        # Over ln(1 + B beta), in which the lobe is smooth.
        by_quadrature = quad(lambda z: 2.0 * math.pi * lobe._abg(math.expm1(z) / B) * math.expm1(z) * math.exp(z) / B**2, 0.0,
                             math.log1p(B * beta), limit=400, epsabs=0.0)[0]
        assert lobe.scattered_within(beta) == pytest.approx(by_quadrature, rel=1e-8)
    shares = np.array([0.0, 1e-9, 1e-3, 0.2, 0.5, 0.9, 1.0 - 2.0**-32])
    found = [lobe.scattered_within(beta) / lobe.scattered_within(2.0) for beta in lobe.offset(shares)]
    np.testing.assert_allclose(found, shares, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("s", [1.0, 2.0, 2.5, 6.0])
@pytest.mark.parametrize("transmissive_fraction", [0.0, 0.6, 1.0])
def test_k_correlation_equals_numpy_ray_by_ray(s: float, transmissive_fraction: float, tmp_path: Path) -> None:
    lobe = KCorrelation(0.3, 12.0, s, transmissive_fraction)
    scene = lens_and_mirror(bsdf=lobe, scatter_fraction=0.7)
    live.assert_equals_numpy(scene, 4000)
    document = written(scene, tmp_path)
    expected = {"type": "k_correlation", "b0": 0.3, "B": 12.0, "s": s, "transmissive_fraction": transmissive_fraction}
    assert [override["bsdf"] for override in document["nsq_gpu"]["overrides"].values()] == [expected, expected]
    (tmp_path / "again").mkdir()
    read = nsq_gpu.load_scene(tmp_path / "scene.json")
    assert type(read.surfaces[0].bsdf) is KCorrelation
    assert written(read, tmp_path / "again") == document


def test_a_k_correlation_lobe_is_not_the_harvey_shack_lobe_that_optiland_takes_it_for() -> None:
    lobes = KCorrelation(0.3, 12.0, 3.0), HarveyShackBSDF(0.3, 1.0 / 12.0, 3.0)
    figures = [live.assert_equals_numpy(lens_and_mirror(bsdf=lobe), 1000) for lobe in lobes]
    assert not live.same(*figures)


def test_a_polished_mirror_scatters_what_the_worked_example_of_zemax_says() -> None:
    """Gangadhara, How to Model Surface Scattering via the K-Correlation Distribution, 2008: about 0.017."""
    lobe = KCorrelation.from_roughness(0.003, 2.0 * math.pi * 0.8, 3.0, 0.3, reference_wavelength_um=0.6328)
    rougher = (1.0 - (1.0 + (5.02655 / 0.3) ** 2) ** -0.5) / (1.0 - (1.0 + (5.02655 / 0.6328) ** 2) ** -0.5)
    assert math.sqrt(rougher) == pytest.approx(1.037, abs=1e-3)
    assert tis(lobe) == pytest.approx((4.0 * math.pi * 0.003 / 0.3) ** 2 * rougher, rel=1e-5)
    assert tis(lobe) == pytest.approx(0.017, abs=5e-5)
    assert (lobe.B, lobe.s) == (pytest.approx(2.0 * math.pi * 0.8 / 0.3), 3.0)
    # Glass in air, at the wavelength of the measurement.
    assert tis(KCorrelation.from_roughness(0.002, 10.0, 2.0, 0.5, delta_n=0.5)) == pytest.approx((math.pi * 0.002 / 0.5) ** 2)


@pytest.mark.parametrize(("arguments", "words"), [
    ((0.0, 9.0, 2.0), "b0 is 0.0: the lobe scatters nothing; give a number above 0"),
    ((1.0, 0.0, 2.0), "B is 0.0; give a number from 1e-12 to 1e.12"),
    ((1.0, 9.0, -1.0), "s is -1.0; give a number from 0 to 1000"),
    ((1.0, 9.0, 2.0, -0.5), "transmissive_fraction is -0.5; give a number from 0 to 1"),
    ((1.0, None, 2.0), "B is None; give a number"),
])
def test_k_correlation_refuses_what_no_surface_has(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        KCorrelation(*arguments)
    with pytest.raises(ValueError, match=r"sigma_um is 0\.0; give a number above 0"):
        KCorrelation.from_roughness(0.0, 9.0, 2.0, 0.5)


# Total integrated scatter


def test_tis_is_the_integral_over_the_hemisphere(tmp_path: Path) -> None:
    # pi b0 l0^2 ln(1 + 1 / l0^2) and pi b0 / B^2 ln(1 + B^2): for slope 2 the two lobes are one.
    expected = math.pi * 0.2 * 0.03**2 * math.log1p(1.0 / 0.03**2)
    assert tis(HarveyShackBSDF(0.2, 0.03, 2.0)) == pytest.approx(expected, rel=1e-10)
    assert tis(KCorrelation(0.2, 1.0 / 0.03, 2.0)) == pytest.approx(expected, rel=1e-14)
    # A step: all within the shoulder.
    assert tis(HarveyShackBSDF(0.2, 0.03, 1e3)) == pytest.approx(math.pi * 0.2 * 0.03**2, rel=1e-4)
    assert tis(ABg(1e-3, 1e-4, 1.5)) == pytest.approx(
        quad(lambda beta: 2.0 * math.pi * beta * 1e-3 / (1e-4 + beta**1.5), 0.0, 1.0, limit=400)[0], rel=1e-7)
    assert tis(LambertianBSDF(0.3)) == 0.3
    measured = table(tmp_path, {0.0: [0.2, 0.1, 0.0], 90.0: [0.3, 0.3, 0.3]})
    by_quadrature = quad(lambda theta: np.interp(theta, np.radians([0.0, 30.0, 90.0]), [0.2, 0.1, 0.0]) * math.pi * math.sin(2.0 * theta),
                         0.0, math.pi / 2.0, points=[math.pi / 6.0])[0]
    assert tis(measured) == pytest.approx(by_quadrature, rel=1e-12)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="a SpecularBRDF has no total integrated scatter that is known"):
        tis(SpecularBRDF())


def test_by_tis_is_what_tis_means_in_a_file(tmp_path: Path) -> None:
    # The same everywhere: of other tables of total integrated scatter 1, Optiland cuts what is above 1 / pi.
    measured = table(tmp_path, dict.fromkeys((0.0, 45.0, 90.0), [0.12, 0.12, 0.12]))
    spectrum = {"wavelengths": [0.5], "weights": [1.0]}
    written_models: dict[str, tuple[Any, dict[str, Any]]] = {
        "harvey_shack": (HarveyShackBSDF(2.0, 0.1, 2.2), {"b0": 2.0, "l0": 0.1, "s": 2.2}),
        "k_correlation": (KCorrelation(2.0, 10.0, 2.2), {"b0": 2.0, "B": 10.0, "s": 2.2}),
        "lambertian": (LambertianBSDF(0.4), {"reflectance_value": 0.4}),
        "tabulated": (measured, {"path": "table.csv"}),
    }
    for kind, (model, keys) in written_models.items():
        wall = {"name": "wall", "cs": {"z": 10.0, "rx": 0.4}, "shape": {"type": "plane"}, "interaction": "reflective", "reflectance": 0.9,
                "bsdf": {"type": kind, **keys}, "scatter_fraction": "tis"}
        path = tmp_path / f"{kind}.json"
        path.write_text(json.dumps({
            "nsq_schema_version": 1, "components": [], "nsq_gpu": {"version": 1, "surfaces": [wall]},
            "sources": [{"type": "point", "name": "lamp", "cs": {}, "spectrum": spectrum, "total_flux": 1.0, "half_angle_deg": 20.0}],
            "detectors": [{"type": "irradiance", "name": "map", "cs": {"z": -5.0}, "width": 60.0, "height": 60.0, "num_pixels_x": 6,
                           "num_pixels_y": 6}],
        }), encoding="utf-8")
        read = nsq_gpu.load_scene(path)
        found = by_tis(model)
        assert read.surfaces[0].scatter_fraction == found["scatter_fraction"], kind
        assert vars(read.surfaces[0].bsdf).keys() == vars(found["bsdf"]).keys()
        # The command's own reading of the file, and NumPy's trace of what Python makes of it.
        live.assert_equals_numpy(read, 4000)
        numbers = ("-n", "4000", "--seed", "0", "--precision", "f64", "--max-depth", "16")
        subprocess.run([live.binary(), "trace", path, *numbers, "-o", tmp_path / kind], check=True, capture_output=True)
        report = json.loads((tmp_path / kind / "report.json").read_text(encoding="utf-8"))
        by_numpy = live.traced(read, 4000, live.NumpyBackend())[1]
        assert report["detectors"]["map"]["total_flux"] == pytest.approx(by_numpy["detectors"]["map"]["total_flux"], rel=1e-11), kind


def test_a_surface_by_tis_has_the_level_of_its_bsdf() -> None:
    lobe = ABg(0.01, 1e-3, 1.5)
    assert by_tis(lobe) == {"bsdf": lobe, "scatter_fraction": pytest.approx(lobe.total_integrated_scatter, rel=1e-14)}
    # What is drawn beyond the hemisphere has no direction: without it, the number to give would be too small.
    assert tis(lobe) < 0.75 * by_tis(lobe)["scatter_fraction"]
    assert by_tis(LambertianBSDF(0.4, 0.3))["scatter_fraction"] == 0.4
    assert vars(by_tis(LambertianBSDF(0.4, 0.3))["bsdf"]) == {"reflectance_value": 1.0, "transmissive_fraction": 0.3}


def test_by_tis_refuses_more_light_than_there_is() -> None:
    with pytest.raises(ValueError, match=r"HarveyShackBSDF is 28\.97.*give a BSDF of 0\.0345.* times the height or less"):
        by_tis(HarveyShackBSDF(500.0, 0.05, 2.0))
    with pytest.raises(ValueError, match="LambertianBSDF scatters nothing at normal incidence"):
        by_tis(LambertianBSDF(0.0))
    with pytest.raises(ValueError, match="tis"):
        live.bench().add_mirror("M", cs(), MirrorConfig(0.0, 0.9, surface=SurfaceConfig(bsdf=ABg(1e-3, 1e-3, 2.0), scatter_fraction="tis")))  # type: ignore[arg-type]
