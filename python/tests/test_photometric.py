"""Lux, candela and lumens of results: by formulas, in files, tables and pictures; figures; far fields as files of lamps."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig, IrradianceDetectorConfig
from optiland.nonsequential.detectors.far_field import FarFieldDetector
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import ExtendedSourceConfig

import nsq_gpu
from nsq_gpu.detectors import SphereFarField
from nsq_gpu.photometry import luminous_efficacy
from nsq_gpu.plotting import in_equal_solid_angles
from nsq_gpu.sources import TabulatedSource
from tests import live
from tests.live import bench, cs

matplotlib.use("Agg")

NUM_RAYS = 100_000
HEIGHT = 1000.0  # [mm]
#: Of these lines the eye sees nothing of the last one.
WHITE = Spectrum(np.array([0.452, 0.5, 0.5555, 0.61, 0.9]), np.array([1.0, 2.0, 2.0, 3.0, 4.0]))
PHOTOMETRIC = ("illuminance", "illuminance_standard_error", "luminous_intensity", "luminous_intensity_standard_error",
               "luminous_flux", "luminous_flux_standard_error")


def lamp() -> NSQScene:
    """Return a small Lambertian lamp of 2 W, a desk that lets light pass, and the directions behind it."""
    scene = NSQScene()
    scene.add_source("lamp", cs(), ExtendedSourceConfig(WHITE, total_flux=2.0, aperture_radius=1.0))
    scene.add_detector("desk", cs(z=HEIGHT), IrradianceDetectorConfig(1600.0, 800.0, 8, 4, absorb=False))
    scene.add_detector("sky", cs(z=HEIGHT + 1.0), FarFieldDetectorConfig(9, 12))
    return scene


@pytest.fixture(scope="module")
def result() -> nsq_gpu.Result:
    return lamp().trace(NUM_RAYS, seed=5, backend=live.backend(photometric=True, standard_error=True))


@pytest.fixture(scope="module")
def watts() -> nsq_gpu.Result:
    return lamp().trace(NUM_RAYS, seed=5, backend=live.backend(standard_error=True))


def of_desk(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return lux of the lamp, by its formula, for a lumen."""
    return HEIGHT**2 / (np.pi * (HEIGHT**2 + x**2 + y**2) ** 2) * 1e6


# Numbers


def test_lux_candela_and_lumens_are_those_of_a_lambertian_lamp(result: nsq_gpu.Result) -> None:
    lumens = 2.0 * luminous_efficacy(WHITE)
    assert result.report_json["photometry"]["sources"]["lamp"]["flux_lm"] == pytest.approx(lumens, rel=1e-9)
    desk, sky = result.detectors["desk"], result.detectors["sky"]
    # The mean of 32 x 32 points of each pixel, which is 200 mm wide and high.
    x, y = ((np.arange(count * 32) + 0.5) * 200.0 / 32.0 - count * 100.0 for count in (8, 4))
    fine = of_desk(*np.meshgrid(x, y))
    lux = lumens * fine.reshape(4, 32, 8, 32).mean(axis=(1, 3))
    apart = (desk.illuminance - lux) / desk.illuminance_standard_error
    assert np.abs(apart).max() < 4.5 and 0.5 < np.sqrt((apart**2).mean()) < 1.5
    assert abs(desk.luminous_flux - lux.mean() * 1.28) < 4.5 * desk.luminous_flux_standard_error
    assert desk.luminous_flux == pytest.approx(desk.illuminance.mean() * 1.28, rel=1e-9)
    assert desk.luminous_intensity is None and desk.luminous_intensity_standard_error is None
    edges = np.radians(np.arange(0.0, 91.0, 10.0))
    candela = lumens / np.pi * np.diff(np.sin(edges) ** 2) / 2.0 / -np.diff(np.cos(edges))
    apart = (sky.luminous_intensity - candela[:, None]) / sky.luminous_intensity_standard_error
    assert np.abs(apart).max() < 4.5 and sky.illuminance is None
    assert abs(sky.luminous_flux - lumens) < 4.5 * sky.luminous_flux_standard_error


def test_watts_are_the_same_and_nothing_else_is_there_where_nobody_asked(result: nsq_gpu.Result, watts: nsq_gpu.Result) -> None:
    for name, found in watts.arrays.items():
        for key, array in found.items():
            assert key == "meta" or np.array_equal(array, result.arrays[name][key], equal_nan=True), (name, key)
    for found in watts.detectors.values():
        assert [getattr(found, key) for key in PHOTOMETRIC] == [None] * 6
    assert watts.report_json.get("photometry") is None and "lm" not in repr(watts)


def test_errors_are_none_where_they_are_not_asked_for() -> None:
    found = lamp().trace(2000, backend=live.backend(photometric=True, standard_error=False)).detectors["desk"]
    assert found.illuminance is not None and found.illuminance_standard_error is None
    assert found.luminous_flux > 0.0 and found.luminous_flux_standard_error is None


@pytest.mark.filterwarnings("ignore:.*undersampled")
def test_lumens_of_a_source_say_so_by_themselves_unless_they_are_refused() -> None:
    scene = lamp()
    scene.remove_source("lamp")
    scene.source_registry.add("lamp", TabulatedSource(cs(), WHITE, [0.0, 90.0], [1.0, 0.0], total_flux_lumens=500.0))
    for photometric, is_there in ((None, True), (False, False)):
        found = scene.trace(2000, backend=live.backend(photometric=photometric)).detectors["sky"]
        assert (found.luminous_flux is not None) == is_there


def test_a_long_trace_and_a_session_have_the_same_lux(result: nsq_gpu.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nsq_gpu.backend, "MOST_SESSION_RAYS", 0)
    alone = lamp().trace(NUM_RAYS, seed=5, backend=live.backend(photometric=True, standard_error=True))
    with nsq_gpu.Session(binary=live.binary(), precision="f64") as session:
        shared = session.trace(lamp(), NUM_RAYS, seed=5, photometric=True, standard_error=True)
        off = session.trace(lamp(), 2000, photometric=False)
    for found in (alone, shared):
        assert np.array_equal(found.detectors["desk"].illuminance, result.detectors["desk"].illuminance)
        assert found.detectors["sky"].luminous_flux_standard_error == result.detectors["sky"].luminous_flux_standard_error
    assert off.detectors["desk"].illuminance is None


def test_what_is_no_switch_is_refused() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="photometric is 'on'; give True, False or None"):
        nsq_gpu.NsqGpuBackend(photometric="on")  # type: ignore[arg-type]
    with nsq_gpu.Session(binary=live.binary()) as session, pytest.raises(nsq_gpu.UsageError, match="'lux' for '--photometric"):
        session.trace(bench(), 100, photometric="lux")


def test_sweeps_have_lumens() -> None:
    with nsq_gpu.Session(binary=live.binary()) as session:
        found = session.sweep(lamp(), {"lamp.total_flux": [1.0, 3.0]}, 2000, photometric=True)
        plain = session.sweep(lamp(), {"lamp.total_flux": [1.0, 3.0]}, 2000)
    assert found.luminous_flux["desk"][1] == pytest.approx(3.0 * found.luminous_flux["desk"][0])
    assert set(found.luminous_flux_standard_error) == {"desk", "sky"} and not plain.luminous_flux
    assert found._of_points()["desk_luminous_flux"][1] == "lm"


# Tables and files


def test_tables_have_lumens(result: nsq_gpu.Result, watts: nsq_gpu.Result) -> None:
    lines = repr(result).splitlines()
    assert lines[1].split() == ["flux", "[W]", "error", "[W]", "flux", "[lm]", "error", "[lm]", "rays"]
    assert f"{result.detectors['desk'].luminous_flux:.6g}" in lines[2] and "[lm]" in result._repr_html_()
    pytest.importorskip("xarray")
    found = result.to_xarray()
    for name, unit in (("desk_illuminance", "lx"), ("desk_illuminance_standard_error", "lx"), ("sky_luminous_intensity", "cd")):
        assert found[name].attrs["units"] == unit
    assert found.desk_illuminance.dims == ("desk_y", "desk_x") and "desk_illuminance" not in watts.to_xarray()
    frame = result.to_pandas()
    assert frame["luminous_flux"].to_list() == [found.luminous_flux for found in result.detectors.values()]
    assert frame.attrs["units"]["luminous_flux_standard_error"] == "lm" and "luminous_flux" not in watts.to_pandas()


def test_a_result_is_saved_and_read_with_its_lux(result: nsq_gpu.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "run")
    again = nsq_gpu.load(tmp_path / "run")
    assert repr(again) == repr(result)
    for name, found in result.detectors.items():
        for key in PHOTOMETRIC:
            ours, theirs = getattr(found, key), getattr(again.detectors[name], key)
            assert type(ours) is type(theirs) and np.array_equal(ours, theirs), (name, key)


# Pictures


def label(ax: Any) -> str:
    """Return what the colour bar says."""
    return ax.figure.axes[1].get_ylabel()


@pytest.fixture
def draw(result: nsq_gpu.Result) -> Any:
    """Return what draws the result, and close all pictures."""
    import matplotlib.pyplot as plt

    yield result.plot
    plt.close("all")


def test_maps_are_drawn_in_lux_unless_somebody_asks_for_watts(result: nsq_gpu.Result, draw: Callable[..., Any]) -> None:
    desk = result.detectors["desk"]
    for unit, values, said in ((None, desk.illuminance, "Illuminance [lx]"), ("klx", desk.illuminance / 1e3, "Illuminance [klx]"),
                               ("fc", desk.illuminance / 10.7639104, "Illuminance [fc]"),
                               ("W/m2", desk.irradiance * 1e6, "Irradiance [W/m²]")):
        ax = draw("desk", unit=unit)
        assert np.allclose(ax.images[0].get_array(), values, rtol=1e-7) and label(ax) == said
        expected = f"{desk.total_flux:.4g} W" if unit == "W/m2" else f"{desk.luminous_flux:.4g} lm"
        assert ax.get_title() == f"desk: {expected}"
    assert label(draw("sky")) == "Intensity [cd]" and label(draw("sky", unit="mW/sr")) == "Intensity [mW/sr]"


def test_the_disc_has_cells_of_about_equal_solid_angle(result: nsq_gpu.Result, draw: Callable[..., Any]) -> None:
    seen = result.detectors["sky"].luminous_intensity
    kept = seen.copy()
    smooth, each = (draw("sky", unit="cd", smooth=smooth).collections[0].get_array().reshape(9, 12, -1)[:, :, 0]
                    for smooth in (True, False))
    assert np.allclose(each, seen) and np.array_equal(seen, kept)
    # All twelve of the first ring, four of the second one, and each of the last one.
    assert np.allclose(smooth[0], seen[0].mean()) and np.allclose(smooth[8], seen[8])
    assert np.allclose(smooth[1].reshape(3, 4), seen[1].reshape(3, 4).mean(axis=1)[:, None])
    theta = np.array([22.5, 67.5])
    assert np.allclose(in_equal_solid_angles(np.array([[1.0, 3.0, 5.0], [0.0, 1.0, 2.0]]), theta), [[3.0] * 3, [0.0, 1.0, 2.0]])


def test_the_polar_diagram_of_a_far_field_has_the_planes_of_a_lamps_file(result: nsq_gpu.Result, draw: Callable[..., Any]) -> None:
    sky = result.detectors["sky"]
    ax = draw("sky", kind="polar", smooth=False)
    assert ax.get_theta_offset() == pytest.approx(1.5 * np.pi) and "Intensity [cd]" in ax.get_xlabel()
    assert ax.get_title() == f"sky: {sky.luminous_flux:.4g} lm"
    assert [line.get_label() for line in ax.lines] == ["C0–C180", "C90–C270"]
    # On the right C0 and C90, of which the latter is phi = -90 deg; between two bins each.
    assert np.allclose(sky.phi[[2, 3, 5, 6, 8, 9]], [-105, -75, -15, 15, 75, 105])
    for line, right, left in zip(ax.lines, ([5, 6], [2, 3]), ([0, 11], [8, 9]), strict=True):
        angles, shown = np.degrees(line.get_xdata()), line.get_ydata()
        for sign, bins in ((1.0, right), (-1.0, left)):
            at_bins = [np.flatnonzero(np.isclose(angles, sign * theta))[0] for theta in sky.theta]
            assert np.allclose(shown[at_bins], sky.luminous_intensity[:, bins].mean(axis=1))
    assert "[mW/sr]" in draw("sky", kind="polar", unit="mW/sr").get_xlabel()


@pytest.mark.parametrize(("arguments", "said"), [
    ({"detector": "desk", "unit": "cd"}, "unit is 'cd', and the map is in lx; give a unit such as 'lx'"),
    ({"detector": "desk", "unit": "lux"}, "unit is 'lux'; give W/mm2, .*; or lx, fc or cd, of a photometric trace"),
    ({"detector": "desk", "kind": "polar"}, "'desk' has no angles: it is of the kind irradiance"),
    ({"detector": "sky", "kind": "disc"}, "kind is 'disc'; give 'polar', or None"),
    ({"detector": "sky", "kind": "polar", "scale": "log"}, "a polar diagram is linear; leave scale out"),
])
def test_pictures_that_there_are_not_are_refused(draw: Callable[..., Any], arguments: dict[str, Any], said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=said):
        draw(**arguments)


def test_lux_that_are_not_known_are_refused_with_what_to_do(watts: nsq_gpu.Result) -> None:
    for name, unit in (("desk", "klx"), ("sky", "cd")):
        with pytest.raises(nsq_gpu.UsageError, match=f"lumens of '{name}' are not known; trace with photometric=True"):
            watts.plot(name, unit=unit)


# Figures


def of_command(folder: Path, *arguments: str) -> Any:
    done = subprocess.run([live.binary(), "figures", str(folder), "--json", *arguments], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)["detectors"]


def as_json(found: nsq_gpu.figures.Figures) -> Any:
    def named(figures: Any) -> Any:
        return {name: figure._asdict() for name, figure in figures.items()}

    return {name: {"unit": one.unit, "flux_unit": one.flux_unit, "cells": list(one.cells), "whole": named(one.whole),
                   "regions": [named(region.figures) for region in one.regions], "remarks": one.remarks}
            for name, one in found.items()}


def test_figures_are_those_of_the_command(result: nsq_gpu.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "run")
    calls: list[tuple[dict[str, Any], list[str]]] = [
        ({}, []),
        ({"detector": "desk", "regions": [(-400, 400, -200, 200.0)], "circles": [(0, 100, 250)], "cells": (4, 2)},
         ["--detector=desk", "--region=-400,400,-200,200", "--circle=0,100,250", "--cells=4,2"]),
        ({"cones": [30, 60.0]}, ["--cone=30", "--cone=60"]),
    ]
    for options, arguments in calls:
        expected = of_command(tmp_path / "run", *arguments)
        for entry in expected.values():
            entry["regions"] = [region["figures"] for region in entry["regions"]]
        assert as_json(result.figures(**options)) == expected
    found = result.figures("desk", regions=[(-400, 400, -200, 200)])
    desk = found["desk"].whole["min_over_mean"]
    x, y = np.meshgrid(np.linspace(-800, 800, 321), np.linspace(-400, 400, 161))
    assert 0.5 < desk.value < 1.0 and 0.0 < desk.standard_error < 0.1
    assert found["desk"].regions[0].figures["mean"].value > found["desk"].whole["mean"].value
    assert of_desk(x, y).min() / of_desk(x, y).mean() < desk.value + 5.0 * desk.standard_error
    text = repr(found)
    assert text.startswith("Figures: desk in ") and "min_over_mean" in text and "lx" in text and "<table>" in found._repr_html_()
    assert "x -400 to 400 mm, y -200 to 200 mm" in text
    assert "within 30 deg of the axis" in repr(result.figures("sky", cones=[30]))


def test_watts_have_figures_as_well(watts: nsq_gpu.Result) -> None:
    found = watts.figures("sky")["sky"]
    assert (found.unit, found.flux_unit) == ("W/sr", "W")
    # Half of the intensity is where the cosine is a half.
    assert found.whole["beam_angle_deg"].value == pytest.approx(120.0, abs=10.0)


@pytest.mark.parametrize(("options", "said"), [
    ({"detector": "dusk"}, "no detector is called `dusk`; there are desk, sky"),
    ({"detector": "sky", "regions": [(0, 1, 0, 1)]}, "a far field has cones; give cones"),
    ({"regions": (0, 1, 0, 1)}, r"regions is \(0, 1, 0, 1\); give numbers, such as \[\(-200, 200, -100, 100\)\]"),
    ({"circles": [(0, 1)]}, r"circles is \[\(0, 1\)\]; give numbers"),
    ({"cones": 30}, r"cones is 30; give numbers, such as \[30\]"),
    ({"cells": 16}, r"cells is 16; give numbers, such as \(16, 8\)"),
])
def test_figures_that_there_are_not_are_refused(result: nsq_gpu.Result, options: dict[str, Any], said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=said):
        result.figures(**options)


# Files of lamps


@pytest.mark.parametrize("ending", ["ies", "ldt"])
def test_a_far_field_goes_to_a_lamps_file_and_back(result: nsq_gpu.Result, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"lamp.{ending}"
    result.export_lamp(path, forward=True)
    back = TabulatedSource.from_file(path, cs=cs(), spectrum=WHITE, binary=live.binary())
    # The table is scaled to the lumens that were measured. EULUMDAT states them to four digits or so.
    assert back.table.flux == pytest.approx(result.detectors["sky"].luminous_flux, rel=0.002)
    shown = in_equal_solid_angles(result.detectors["sky"].luminous_intensity, result.detectors["sky"].theta)
    # EULUMDAT has four digits or so for 1,000 lm.
    at_bins = back.table.at(result.detectors["sky"].theta[:, None], result.detectors["sky"].phi % 360.0)
    scale = at_bins.sum() / shown.sum()
    assert scale == pytest.approx(1.0, abs=0.02)
    assert np.allclose(at_bins, scale * shown, atol=0.002 * shown.max())
    with pytest.raises(nsq_gpu.UsageError, match="exists; overwrite=True replaces it"):
        result.export_lamp(path, forward=True)
    result.export_lamp(str(path), "sky", forward=True, overwrite=True)


@pytest.mark.parametrize(("of", "arguments", "said"), [
    ("result", ["lamp.ies"], "sky has light from behind .* or give forward=True"),
    ("result", ["lamp.txt"], "path is .*lamp.txt.*; give the path of a lamp's file, whose name ends with .ies or .ldt"),
    ("result", ["lamp.ies", "desk"], "desk is no far field"),
    ("watts", ["lamp.ies"], "sky has no candela: trace with photometric=True"),
])
def test_files_of_lamps_that_cannot_be_are_refused(result: nsq_gpu.Result, watts: nsq_gpu.Result, tmp_path: Path, of: str,
                                                   arguments: list[str], said: str) -> None:
    place, *more = arguments
    with pytest.raises(nsq_gpu.UsageError, match=said):
        (result if of == "result" else watts).export_lamp(tmp_path / place, *more)
    assert not list(tmp_path.iterdir())


# Over the sphere


def around(photometric: bool = True) -> NSQScene:
    """Return a lamp that shines on both sides, and the directions of all of its light."""
    scene = NSQScene()
    polar = np.linspace(0.0, 180.0, 181)
    flux = {"total_flux_lumens": 100.0} if photometric else {"total_flux": 1.0}
    scene.source_registry.add("lamp", TabulatedSource(cs(), WHITE, polar, 1.0 + np.cos(np.radians(polar)) ** 2, **flux))
    scene.detector_registry.add("sky", SphereFarField(cs(), 18, 12))
    return scene


def test_a_far_field_over_the_sphere_is_that_of_optilands_backends() -> None:
    live.assert_equals_numpy(around(photometric=False), 5000)


def test_a_far_field_over_the_sphere_is_read_traced_and_written(tmp_path: Path) -> None:
    path, again = tmp_path / "scene.json", tmp_path / "again.json"
    scene = around()
    nsq_gpu.export_scene(scene, path)
    entry = json.loads(path.read_text())["detectors"][0]
    assert (entry["sphere"], entry["num_bins_theta"], entry["num_bins_phi"], entry["absorb"]) == (True, 18, 12, True)
    found = nsq_gpu.load_scene(path)
    assert type(found.detectors[0]) is SphereFarField
    nsq_gpu.export_scene(found, again)
    assert again.read_text() == path.read_text()
    result = found.trace(20_000, seed=2, backend=live.backend())
    sky = result.detectors["sky"]
    assert sky.intensity.shape == sky.luminous_intensity.shape == (18, 12) and list(sky.theta[[0, -1]]) == [5.0, 175.0]
    edges = np.radians(np.arange(0.0, 181.0, 10.0))
    assert np.array_equal(sky.intensity, scene.trace(20_000, seed=2, backend=live.backend()).detectors["sky"].intensity)
    assert sky.total_flux == pytest.approx((sky.intensity.mean(axis=1) * 2.0 * np.pi * np.sin((edges[1:] + edges[:-1]) / 2.0)
                                            * np.radians(10.0)).sum(), rel=1e-9)
    result.export_lamp(tmp_path / "lamp.ies")
    assert "[LUMINAIRE] sky" in (tmp_path / "lamp.ies").read_text()
    result.plot("sky", kind="polar")
    result.save(tmp_path / "saved")
    assert np.array_equal(nsq_gpu.load(tmp_path / "saved").detectors["sky"].luminous_intensity, sky.luminous_intensity)


def test_false_and_defaults_of_a_file_are_optilands(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    nsq_gpu.export_scene(around(), path)
    document = json.loads(path.read_text())
    for written, kind, bins in (({"sphere": False}, FarFieldDetector, (90, 360)), ({"sphere": True}, SphereFarField, (180, 360)),
                                ({"sphere": True, "num_bins_theta": 4}, SphereFarField, (4, 360))):
        document["detectors"] = [{"type": "far_field", "name": "sky", "cs": {}, **written}]
        path.write_text(json.dumps(document))
        found = nsq_gpu.load_scene(path).detectors[0]
        assert type(found) is kind and (found.num_bins_theta, found.num_bins_phi) == bins
        assert found._intensity.shape == bins


def test_a_far_field_over_the_sphere_refuses_odd_bins_and_optilands_files(tmp_path: Path) -> None:
    with pytest.raises(nsq_gpu.UsageError, match="num_bins_theta is 9; give an even number"):
        SphereFarField(cs(), 9)
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="Optiland's scene files know no SphereFarField"):
        scene = lamp()
        scene.detector_registry.add("all", SphereFarField(cs(), 18, 12))
        scene.to_json(tmp_path / "scene.json")
