"""Finishes by name: figures of their sources, closed forms, and what traces scatter."""

from __future__ import annotations

import json
import math
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.bsdf import HarveyShackBSDF, LambertianBSDF
from optiland.nonsequential.components.configs import LensConfig, MirrorConfig, SurfaceConfig
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig
from scipy.integrate import quad

import nsq_gpu
from nsq_gpu.bsdf import _albedo, tis
from nsq_gpu.finishes import _DUST, DIAMOND_TURNED, FINISHES, coverage, dusty, finish, ground, polished
from tests import live
from tests.live import cs, glass

#: What came back from the samples of LOFT at 650 nm, by the angle of incidence [deg]: the integral of all the measured BSDF.
ANODISED = {10.0: 0.0523, 30.0: 0.0533, 50.0: 0.0583, 70.0: 0.0947}
NICKEL = {10.0: 0.0644, 30.0: 0.0635, 50.0: 0.0673, 70.0: 0.0997}


def sent_back(config: dict[str, Any], incidence: float = 0.0, num_rays: int = 100_000) -> dict[str, float]:
    """Return what a mirror of a finish sends back of 1 W, by the number of scatterings, and what is left of the ledger [W]."""
    scene, slant = NSQScene(), math.radians(incidence)
    scene.add_source("beam", cs(x=-20.0 * math.sin(slant), z=-20.0 * math.cos(slant), ry=slant), CollimatedSourceConfig(
        spectrum=Spectrum(np.array([0.55]), np.array([1.0])), total_flux=1.0, aperture_radius=0.1))
    scene.add_mirror("wall", cs(), MirrorConfig(math.inf, 0.5, aperture_radius=5.0, surface=SurfaceConfig(**config)))
    scene.add_detector("sky", cs(z=-100.0, rx=math.pi), FarFieldDetectorConfig(num_theta=18, num_phi=36))
    which = live.backend(paths=True)
    with live.quiet():
        paths = scene.trace(num_rays, seed=0, backend=which).paths
    scattered = paths["scatterings"] == 1
    ledger = which.report["ledger"]
    assert ledger["imbalance_quanta"] == "0"
    return {"scattered": float(paths["flux"][scattered].sum()), "mirrored": float(paths["flux"][~scattered].sum()),
            "mirror loss": ledger["surface"]["flux"], "scatter loss": ledger["bsdf"]["flux"]}


def spread(share: float, num_rays: int = 100_000) -> float:
    """Return four standard errors of a share of so many rays."""
    return 4.0 * math.sqrt(share * (1.0 - share) / num_rays)


# Black surfaces


def test_every_finish_names_its_source_and_what_it_leaves_out() -> None:
    for name, entry in FINISHES.items():
        assert re.search(r"(19|20)\d\d", entry.source) and entry.left_out.endswith("."), name
        assert 0.0 < entry.reflectance < 0.1, name
    # 1 - the solar absorptance.
    absorptances = {"black paint": 0.95, "chemglaze black paint": 0.96, "catalac black paint": 0.96, "parsons black paint": 0.98,
                    "black delrin": 0.96, "black polyethylene": 0.93}
    assert {name: round(1.0 - FINISHES[name].reflectance, 9) for name in absorptances} == absorptances


@pytest.mark.parametrize("name", FINISHES)
def test_a_finish_sends_back_what_its_source_says(name: str) -> None:
    config = finish(name)
    assert tis(config["bsdf"]) * config["reflectance"] == pytest.approx(FINISHES[name].reflectance, rel=1e-3)
    found = sent_back(config)
    assert found["scattered"] == pytest.approx(FINISHES[name].reflectance, rel=0.01)
    assert found["mirrored"] == 0.0
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("name", "measured"), [("black anodised aluminium", ANODISED), ("black nickel", NICKEL)])
def test_measured_finishes_send_back_at_each_incidence_what_the_sample_did(name: str, measured: dict[float, float]) -> None:
    entry = FINISHES[name]
    assert entry.rows is not None and entry.theta_s is not None
    for incidence, share in measured.items():
        # A straight line every 10 degrees, instead of every 5.
        assert _albedo(np.radians(entry.theta_s), np.array(entry.rows[incidence])) == pytest.approx(share, rel=0.015)
        assert sent_back(finish(name), incidence)["scattered"] == pytest.approx(share, rel=0.02)
    # Optiland cuts what is above 1 / pi: nothing is.
    assert max(max(row) for row in entry.rows.values()) < 1.0 / math.pi
    # Beyond the measured incidences, the next one's values stay.
    assert sent_back(finish(name), 80.0)["scattered"] == pytest.approx(sent_back(finish(name), 70.0)["scattered"], rel=0.02)


def test_finishes_equal_numpy_ray_by_ray() -> None:
    for config in (finish("black paint"), finish("black nickel"), dusty(750, 0.5, 0.9), polished(0.008, 0.5, 0.8), ground(0.03, 0.5, 0.8)):
        scene = live.bench()
        scene.add_mirror("M", cs(z=5.0, rx=0.4), MirrorConfig(-90.0, 0.5, aperture_radius=8.0, surface=SurfaceConfig(**config)))
        live.assert_equals_numpy(scene, 2000)


def test_an_edge_of_a_lens_is_painted() -> None:
    scene = live.bench()
    scene.add_lens("L", cs(z=5.0, rx=0.3), LensConfig(60.0, -60.0, 5.0, glass(), 10.0, edge=SurfaceConfig(**finish("black paint"))))
    assert [type(surface).__name__ for surface in scene.surfaces] == ["RefractiveComponent", "RefractiveComponent", "ReflectiveComponent"]
    live.assert_equals_numpy(scene, 2000)


def test_names_are_found_in_other_spellings_and_misspelt_ones_answered() -> None:
    for name in ("Black Anodized Aluminum", "black-anodised_aluminium", "anodised"):
        assert vars(finish(name)["bsdf"]).keys() == vars(finish("black anodised aluminium")["bsdf"]).keys()
    assert finish("Aeroglaze Z306")["reflectance"] == 0.04
    with pytest.raises(nsq_gpu.UnknownNameError, match="there is no finish 'blak paint'; did you mean 'black paint'"):
        finish("blak paint")
    with pytest.raises(nsq_gpu.UnknownNameError, match="known here: 'black paint', 'chemglaze black paint'"):
        finish("unobtainium")
    with pytest.raises(nsq_gpu.UsageError, match="name is 5; give the name of a finish, such as 'black paint'"):
        finish(5)  # type: ignore[arg-type]
    assert finish("black paint")["bsdf"] is not finish("black paint")["bsdf"]


def test_black_paint_is_one_recipe_in_the_file_and_in_python(tmp_path: Path) -> None:
    """The recipe of the page, traced by the command, sends back what finish() does."""
    page = (live.ROOT / "docs" / "reference" / "scene-files.md").read_text(encoding="utf-8")
    recipe = json.loads(re.search(r"## Black paint.*?```json\n(.*?)```", page, re.S)[1])  # type: ignore[index]
    scene = NSQScene()
    scene.add_source("beam", cs(), CollimatedSourceConfig(spectrum=Spectrum(np.array([0.55]), np.array([1.0])), aperture_radius=3.0))
    scene.add_mirror("baffle", cs(z=20.0), MirrorConfig(math.inf, 0.5, aperture_radius=30.0, surface=SurfaceConfig(**finish("black paint"))))
    scene.add_detector("sky", cs(z=-5.0, rx=math.pi), FarFieldDetectorConfig(num_theta=18, num_phi=36))
    nsq_gpu.export_scene(scene, tmp_path / "python.json")
    document = json.loads((tmp_path / "python.json").read_text(encoding="utf-8"))
    override = document["nsq_gpu"]["overrides"]["baffle.surface"]
    keys = ("interaction", "reflectance", "scatter_fraction")
    assert {key: recipe[key] for key in keys if key in override} == {key: override[key] for key in keys if key in override}
    assert {"reflectance_value": 1.0, "transmissive_fraction": 0.0, **recipe["bsdf"]} == override["bsdf"]
    document.update(components=[], nsq_gpu={"version": 1, "surfaces": [recipe]})
    (tmp_path / "file.json").write_text(json.dumps(document), encoding="utf-8")
    found = {}
    for name in ("python", "file"):
        numbers = ("-n", "20000", "--seed", "0", "--precision", "f64")
        subprocess.run([live.binary(), "trace", tmp_path / f"{name}.json", *numbers, "-o", tmp_path / name], check=True, capture_output=True)
        found[name] = json.loads((tmp_path / name / "report.json").read_text(encoding="utf-8"))["total_flux_detected"]
    assert found["python"] == found["file"] == pytest.approx(0.05, rel=0.01)


# Polish and ground glass


def test_a_polish_scatters_the_total_integrated_scatter_of_its_roughness() -> None:
    """At normal incidence (4 pi sigma / wavelength)^2 of what is reflected (Bennett and Porteus, 1961)."""
    expected = (4.0 * math.pi * 0.008 / 0.6) ** 2
    config = polished(0.008, 0.6, reflectance=0.9)
    assert tis(config["bsdf"]) == pytest.approx(expected, rel=1e-12)
    found = sent_back(config)
    assert found["scattered"] == pytest.approx(0.9 * expected, abs=0.9 * spread(expected))
    assert found["mirrored"] == pytest.approx(0.9 * (1.0 - config["scatter_fraction"]), abs=0.9 * spread(config["scatter_fraction"]))
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-6)
    # A face of a lens sees the step of the index, and sends what is scattered along with the light.
    face = polished(0.008, 0.6, delta_n=0.5)
    assert tis(face["bsdf"]) == pytest.approx(expected / 16.0, rel=1e-12)
    assert face.keys() == {"bsdf", "scatter_fraction"} and face["bsdf"].transmissive_fraction == 1.0


def test_the_shapes_of_polishes_are_those_of_their_sources() -> None:
    # FRED's default, b0 = 0.1 /sr at L = 0.01 and S = -1.5, is the polish of 17 Angstrom at its wavelength.
    lobe = polished(0.00169, 0.6328, reflectance=1.0)["bsdf"]
    assert (lobe.b0, 1.0 / lobe.B, lobe.s) == (pytest.approx(0.1, rel=0.01), pytest.approx(0.01, rel=1e-12), 1.5)
    # The model of Proba-V has 82 /sr for 6 nm at 0.65 um, l = 0.002 and s = -2; of its own TIS that is 5 % off.
    lobe = polished(0.006, 0.65, reflectance=1.0, **DIAMOND_TURNED)["bsdf"]
    assert (lobe.b0, 1.0 / lobe.B, lobe.s) == (pytest.approx(82.0, rel=0.06), pytest.approx(0.002, rel=1e-12), 2.0)


def test_a_ground_surface_mirrors_what_its_roughness_leaves() -> None:
    left = math.exp(-((4.0 * math.pi * 0.05 / 0.6) ** 2))
    found = sent_back(ground(0.05, 0.6, reflectance=0.9))
    assert found["mirrored"] == pytest.approx(0.9 * left, abs=0.9 * spread(left))
    assert found["scattered"] == pytest.approx(0.9 * (1.0 - left), abs=0.9 * spread(left))
    # Far below the wavelength it is the law of smooth surfaces.
    assert ground(0.0005, 0.6, reflectance=1.0)["scatter_fraction"] == pytest.approx((4.0 * math.pi * 0.0005 / 0.6) ** 2, rel=1e-4)
    face = ground(0.5, 0.55, delta_n=0.52)
    assert face["scatter_fraction"] > 0.999 and vars(face["bsdf"]) == vars(LambertianBSDF(1.0, 1.0))


@pytest.mark.parametrize(("call", "kind", "words"), [
    (lambda: polished(0.02, 0.55, 0.9), ValueError, r"roughness_um is 0\.02: 0\.209 of the light would scatter.*take ground\(\)"),
    (lambda: polished(0.0, 0.55, 0.9), ValueError, r"roughness_um is 0\.0; give a number above 0"),
    (lambda: polished(0.001, 0.55), nsq_gpu.UsageError, "give a mirror's reflectance.*or a lens's delta_n"),
    (lambda: ground(0.5, 0.55, 0.9, delta_n=0.5), nsq_gpu.UsageError, "one of the two"),
    (lambda: polished(0.001, 0.55, 1.5), ValueError, r"reflectance is 1\.5; give a number from 0 to 1"),
    (lambda: dusty(300, 0.55, None), nsq_gpu.UsageError, "reflectance is None; give the clean mirror's"),
    (lambda: dusty(5000, 0.55, 0.9), ValueError, r"level is 5000\.0; give a number from 5 to 1000"),
    (lambda: dusty(300, 10.6, 0.9), ValueError, r"wavelength_um is 10\.6; give a number from 0\.36 to 2"),
])
def test_what_no_surface_is_is_refused(call: Any, kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        call()


# Dust


@pytest.mark.parametrize("level", [5.0, 100.0, 300.0, 1000.0])
def test_coverage_is_the_integral_over_the_particles_of_the_standard(level: float) -> None:
    def number(x: float) -> float:
        return 10.0 ** (0.926 * (math.log10(level) ** 2 - math.log10(x) ** 2))

    # Of 0.1 m^2; the largest particle of a level is as large as the level, and there is one.
    assert number(level) == 1.0
    area = quad(lambda u: 0.25 * math.pi * math.exp(2.0 * u) * number(math.exp(u)) * 2.0 * 0.926 * u / math.log(10.0), 0.0, math.log(level),
                epsabs=0.0, limit=200)[0]
    assert coverage(level) == pytest.approx(area * 1e-12 / 0.1, rel=1e-9)


def test_dust_scatters_twice_the_light_that_it_covers() -> None:
    """Large particles: as much is diffracted as is blocked (Babinet)."""
    for wavelength in (0.4, 0.55, 0.65, 1.0, 1.6):
        assert tis(dusty(500, wavelength, 1.0)["bsdf"]) == pytest.approx(2.0 * coverage(500), rel=0.15), wavelength
    # In proportion to what is covered.
    assert tis(dusty(500, 0.65, 1.0)["bsdf"]) / tis(dusty(300, 0.65, 1.0)["bsdf"]) == pytest.approx(coverage(500) / coverage(300), rel=1e-9)
    config = dusty(750, 0.65, 0.9)
    found = sent_back(config)
    expected = tis(config["bsdf"])
    assert found["scattered"] == pytest.approx(0.9 * expected, abs=0.9 * spread(expected))
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-6)
    # No step at a wavelength of the source.
    shares = [tis(dusty(500, wavelength, 1.0)["bsdf"]) for wavelength in np.geomspace(0.36, 2.0, 60)]
    assert max(abs(np.diff(np.log(shares)))) < 0.03


def test_the_lobe_of_dust_stands_for_the_two_of_its_source() -> None:
    """b, s and l of the two lobes by the wavelength, for 1000 ppm: ESA's model of Proba-V's stray light."""
    source = {0.45: ((8.13, 2.17, 0.0026), (0.00244, 0.881, 0.0431513)), 0.65: ((3.93, 2.35, 0.00411), (0.00429, 1.11, 0.0431513)),
              0.825: ((2.63, 2.23, 0.00472), (0.00441, 1.06467, 0.0431513)),
              1.6: ((0.557, 1.36716, 0.0025166), (0.37724, 2.40281, 0.0116923))}
    assert source.keys() == _DUST.keys()
    for wavelength, lobes in source.items():
        def both(beta: Any, lobes: Any = lobes) -> Any:
            return sum(b * (1.0 + (beta / length) ** 2) ** (-0.5 * s) for b, s, length in lobes)

        total = quad(lambda z: 2.0 * math.pi * math.exp(2.0 * z) * both(math.exp(z)), math.log(1e-7), 0.0, limit=200)[0]
        a, b, g = _DUST[wavelength]
        one = HarveyShackBSDF(a / b, b ** (1.0 / g), g)
        assert tis(one) == pytest.approx(total, rel=2e-3)
        assert tis(dusty(300, wavelength, 1.0)["bsdf"]) == pytest.approx(coverage(300) / 1e-3 * tis(one), rel=1e-9)
        beta = np.geomspace(1e-3, 1.0, 50)
        assert np.abs(np.log(one._abg(beta) / both(beta))).max() < math.log(2.0)
