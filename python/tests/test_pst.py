"""Point source transmittance and lists of surfaces: closed forms, files, tables and pictures, stops, and a cluster."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import warnings
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.bsdf import LambertianBSDF
from optiland.nonsequential.components.configs import MirrorConfig, SurfaceConfig
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from nsq_gpu import pst_trace
from nsq_gpu.bsdf import KCorrelation, by_tis
from tests import live
from tests.live import cs
from tests.test_nothing_lost import interrupted_after
from tests.test_scattering import wall

pytestmark = pytest.mark.in_turn

matplotlib.use("Agg")
posix_only = pytest.mark.skipif(os.name == "nt", reason="signals are POSIX's")

#: Focal length and diameter of the parabola, and its scattering law.
F, D = 1000.0, 250.0
B0, B, S = 0.01, 100.0, 1.5
#: Places of detectors in the focal plane [mm].
PLACES = (0.0, 1.0, 5.0, 10.0, 20.0)
LINE = Spectrum(np.array([0.55]), np.array([1.0]))
#: After so long a call of many directions has done some of them [s].
LONG = 8.0
OPTIONS = {"source": "star", "num_rays": 20_000, "seed": 3}


def parabola() -> NSQScene:
    """Return a parabola whose polish scatters, a star, and small detectors in its focal plane, which let light pass."""
    scene = NSQScene()
    polish = SurfaceConfig(reflectance=1.0, **by_tis(KCorrelation(B0, B, S)))
    scene.add_mirror("M", cs(), MirrorConfig(-2.0 * F, 1.0, conic=-1.0, aperture_radius=D / 2.0, surface=polish))
    # Before the detectors, which its beam does not pass.
    scene.add_source("star", cs(z=-900.0), CollimatedSourceConfig(LINE, aperture_radius=D / 2.0))
    for x in PLACES:
        scene.add_detector(f"x{x:g}", cs(x=x, z=-F), IrradianceDetectorConfig(0.4, 0.4, 1, 1, absorb=False))
    return scene


def closed_form(x: float) -> float:
    """Return the transmittance x from the image of a star on the axis, of light that scattered once (paraxial).

    Each place of the mirror has the radiance b(beta) E, with beta = x / f from its specular direction. The detector sees the mirror
    within pi (D / 2f)^2 of solid angle.
    """
    return B0 * np.pi * (D / (2.0 * F)) ** 2 * (1.0 + (B * x / F) ** 2) ** (-S / 2.0)


def found_of(scene: Any, *args: Any, **options: Any) -> nsq_gpu.PstResult:
    with live.quiet():
        return nsq_gpu.pst(scene, *args, binary=live.binary(), **{**OPTIONS, **options})


def toward(name: str) -> dict[str, Any]:
    return {"scatter_to": [{"surface": "M*", "target": name, "share": 0.9}], "scatter_prob": 0.9}


def same(one: nsq_gpu.PstResult, other: nsq_gpu.PstResult) -> bool:
    """Tell whether two results are the same to the bit."""
    def equal(a: Any, b: Any) -> bool:
        if isinstance(a, dict):
            return list(a) == list(b) and all(equal(a[key], b[key]) for key in a)
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f") if isinstance(a, np.ndarray) else a == b

    return all(equal(getattr(one, part.name), getattr(other, part.name)) for part in dataclasses.fields(one))


@pytest.fixture(scope="module")
def turned() -> nsq_gpu.PstResult:
    return found_of(parabola(), [0.0, 0.5, 1.0], "x5", azimuths_deg=[0.0, 90.0], **toward("x5"))


# Numbers


@pytest.mark.parametrize("x", PLACES)
def test_scatter_in_the_field_of_a_parabola_is_its_closed_form(x: float) -> None:
    found = found_of(parabola(), [0.0], f"x{x:g}", **toward(f"x{x:g}"))
    once, error = found.by_order[1, 0, 0], found.by_order_standard_error[1, 0, 0]
    assert once == pytest.approx(closed_form(x), rel=0.02) and error < 0.015 * once
    assert np.array_equal(found.by_first_scatterer["M.surface"], found.by_order[1:].sum(axis=0))
    assert closed_form(x) / B0 == pytest.approx({0.0: 0.049087, 1.0: 0.048722, 5.0: 0.041523, 10.0: 0.029188, 20.0: 0.014681}[x], abs=1e-6)


def test_a_turned_star_is_a_shift_in_the_focal_plane() -> None:
    angle = np.degrees(np.arctan(10.0 / F))
    found = found_of(parabola(), [angle], "x0", azimuths_deg=[0.0, 180.0, 90.0], pivot=(0, 0, 0), **toward("x0"))
    for z in range(3):
        assert found.by_order[1, 0, z] == pytest.approx(closed_form(10.0), rel=0.02)


def test_rays_on_purpose_bring_the_light_of_plain_rays() -> None:
    with_target = found_of(wall(), [0.0, 20.0], "image", source="beam", pivot=(0, 0, 0), num_rays=40_000, scatter_to={"wall*": "image"})
    plain = found_of(wall(), [0.0, 20.0], "image", source="beam", pivot=(0, 0, 0), num_rays=400_000)
    assert (np.abs(with_target.pst - plain.pst) < 4.5 * np.hypot(with_target.standard_error, plain.standard_error)).all()
    assert (with_target.standard_error < plain.standard_error).all() and (with_target.num_hits > plain.num_hits).all()


def test_orders_surfaces_and_unknown_paths_are_all_light(turned: nsq_gpu.PstResult) -> None:
    assert turned.pst.shape == (3, 2) and turned.by_order.shape == (4, 3, 2)
    assert turned.pst == pytest.approx(turned.by_order.sum(axis=0) + turned.unknown_path, rel=1e-9)
    assert turned.pst == pytest.approx(turned.by_order[0] + sum(turned.by_first_scatterer.values()) + turned.unknown_path, rel=1e-9)
    assert turned.reached.all() and (turned.num_rays == 20_000).all() and (turned.num_hits > 1000).all()
    # Where nothing is turned, the azimuth does not matter.
    assert turned.pst[0, 0] == turned.pst[0, 1]
    # Azimuth 0 lies towards +x, and its image towards -x, away from the detector.
    assert turned.pst[1, 0] < turned.pst[1, 1] < turned.pst[0, 0]


def test_without_a_source_a_beam_overfills_the_scene() -> None:
    scene = wall()
    scene.remove_detector("sky")
    found = found_of(scene, [0.0], "image", source=None, num_rays=40_000, scatter_to={"wall*": "image"})
    # The beam also meets the detector straight; of what scatters, the whole mirror sends some.
    assert found.by_order[1, 0, 0] > 0.0 and found.by_order[0, 0, 0] > 0.0


def test_a_target_error_ends_early_or_is_warned_of() -> None:
    easy = found_of(parabola(), [0.0], "x5", target_error="5%", num_rays=1_000_000, **toward("x5"))
    assert easy.reached.all() and easy.num_rays[0, 0] < 1_000_000 and easy.standard_error[0, 0] <= 0.05 * easy.pst[0, 0]
    with pytest.warns(nsq_gpu.ToleranceWarning, match="2 of 2 directions have not reached target_error; give more rays by num_rays"):
        hard = nsq_gpu.pst(parabola(), [0.0, 0.1], "x5", binary=live.binary(), target_error=1e-5, **OPTIONS)
    assert not hard.reached.any() and not hard.partial and "error not reached" in repr(hard)


def test_a_file_traces_as_the_scene_does(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    nsq_gpu.export_scene(parabola(), path)
    expected = found_of(parabola(), [0.0, 0.5], "x5", **toward("x5"))
    assert same(found_of(path, [0.0, 0.5], "x5", **toward("x5")), expected)
    scene = parabola()
    scene.scatter_prob, scene.scatter_to = toward("x5")["scatter_prob"], toward("x5")["scatter_to"]
    nsq_gpu.export_scene(scene, path, overwrite=True)
    assert same(found_of(path, [0.0, 0.5], "x5"), expected)


# Tables, pictures, files


def test_a_table_and_a_dataset_have_all_directions(turned: nsq_gpu.PstResult) -> None:
    pytest.importorskip("pandas")
    xarray = pytest.importorskip("xarray")
    frame = turned.to_pandas()
    assert list(frame["angle_deg"]) == [0.0, 0.5, 1.0] * 2 and list(frame["azimuth_deg"]) == [0.0] * 3 + [90.0] * 3
    assert list(frame["pst"]) == list(turned.pst.T.ravel()) and frame.attrs["units"]["angle_deg"] == "deg"
    assert {"order_0", "order_3_standard_error", "first_M.surface", "first_M.surface_standard_error"} <= set(frame.columns)
    data = turned.to_xarray()
    assert isinstance(data, xarray.Dataset) and data["pst"].dims == ("angle", "azimuth")
    assert float(data["by_first_scatterer"].sel(surface="M.surface", angle=0.5, azimuth=90.0)) == turned.by_first_scatterer["M.surface"][1, 1]
    assert data["by_order"].sel(order=1).equals(data["by_order"][1]) and data["angle"].attrs["units"] == "deg"


def test_it_is_shown_as_a_table_and_a_picture(turned: nsq_gpu.PstResult) -> None:
    text = repr(turned)
    assert text.startswith("Point source transmittance of x5\n") and "M.surface 100 %" in text and len(text.splitlines()) == 8
    assert "<table>" in turned._repr_html_()
    ax = turned.plot()
    assert ax.get_yscale() == "log" and [line.get_text() for line in ax.get_legend().get_texts()] == ["azimuth 0°", "azimuth 90°"]
    assert ax.get_xlabel() == "angle off the axis [deg]" and ax.get_ylabel() == "point source transmittance"
    labels = [line.get_text() for line in turned.plot(by="first_scatterer", azimuth_deg=90).get_legend().get_texts()]
    assert labels == ["all", "M.surface"]
    assert "1 scattering" in [line.get_text() for line in turned.plot(by="order").get_legend().get_texts()]
    with pytest.raises(nsq_gpu.UsageError, match="by is 'colour'; give 'first_scatterer', 'order', or None"):
        turned.plot(by="colour")
    with pytest.raises(nsq_gpu.UsageError, match="azimuth_deg is 45; the azimuths are 0, 90"):
        turned.plot(azimuth_deg=45)


def test_a_folder_is_that_of_the_command_and_is_read_back(turned: nsq_gpu.PstResult, tmp_path: Path) -> None:
    folder = tmp_path / "saved"
    turned.save(folder)
    assert same(nsq_gpu.PstResult.load(folder), turned) and same(nsq_gpu.PstResult.load(folder / "pst.json"), turned)
    scene = parabola()
    scene.scatter_prob, scene.scatter_to = toward("x5")["scatter_prob"], toward("x5")["scatter_to"]
    nsq_gpu.export_scene(scene, tmp_path / "scene.json")
    subprocess.run([live.binary(), "pst", str(tmp_path / "scene.json"), "--angles=0:1:0.5", "--azimuths=0,90", "--detector=x5", "--source=star",
                    "-n", "20000", "--seed=3", "-o", str(tmp_path / "command")], check=True, capture_output=True)
    theirs = nsq_gpu.PstResult.load(tmp_path / "command")
    assert same(dataclasses.replace(theirs, detector="x5"), turned)
    ours, others = (list(map(str.split, (at / "pst.csv").read_text().splitlines())) for at in (folder, tmp_path / "command"))
    assert ours[0] == others[0] and len(ours) == len(others) == 7
    numbers = [[float(cell) for line in (folder_ / "pst.csv").read_text().splitlines()[1:] for cell in line.split(",")]
               for folder_ in (folder, tmp_path / "command")]
    assert numbers[0] == numbers[1]


def test_files_are_kept_and_what_is_none_is_refused(turned: nsq_gpu.PstResult, tmp_path: Path) -> None:
    (tmp_path / "pst.json").write_text("mine")
    with pytest.raises(nsq_gpu.UsageError, match="pst.json: exists; overwrite=True"):
        turned.save(tmp_path)
    assert not (tmp_path / "pst.csv").exists()
    with pytest.raises(nsq_gpu.NsqGpuError, match="is no point source transmittance, or is damaged"):
        nsq_gpu.PstResult.load(tmp_path)
    with pytest.raises(nsq_gpu.UsageError, match="has no pst.json; give a folder"):
        nsq_gpu.PstResult.load(tmp_path / "nothing")
    turned.save(tmp_path, overwrite=True)
    with pytest.raises(nsq_gpu.UsageError, match="holds a point source transmittance; read it by nsq_gpu.PstResult.load"):
        nsq_gpu.load(tmp_path)


# Stops, bars, clusters


def test_a_function_follows_the_parts_and_changes_no_bit(turned: nsq_gpu.PstResult) -> None:
    seen: list[tuple[int, int]] = []
    found = found_of(parabola(), [0.0, 0.5, 1.0], "x5", azimuths_deg=[0.0, 90.0], **toward("x5"),
                     progress=lambda rays, num_rays, rate: seen.append((rays, num_rays)))
    assert same(found, turned)
    assert seen == [(20_000 * count, 120_000) for count in range(1, 7)]


def stopped(how: str) -> Any:
    """Return the exception of a call that is stopped after some directions."""
    ends = interrupted_after(LONG) if how == "ctrl-c" else nullcontext()
    expected = nsq_gpu.Interrupted if how == "ctrl-c" else nsq_gpu.TraceTimeoutError
    with ends, pytest.raises(expected) as caught:
        found_of(parabola(), np.linspace(0.0, 2.0, 2000), "x5", num_rays=20_000, timeout=LONG if how == "timeout" else None, **toward("x5"))
    return caught.value


@posix_only
@pytest.mark.parametrize("how", ["ctrl-c", "timeout"])
def test_a_stop_keeps_the_directions_that_are_done(how: str) -> None:
    partial = stopped(how).partial
    done = int((partial.num_rays > 0).sum())
    assert partial.partial and 0 < done < 2000
    assert (partial.num_rays[:done, 0] == 20_000).all() and np.isfinite(partial.pst[:done]).all() and np.isnan(partial.pst[done:]).all()
    assert f"partial: {done} of 2000 directions" in repr(partial)
    assert "stopped before its end" in partial.plot().get_title()


def test_a_stop_between_parts_keeps_them(tmp_path: Path) -> None:
    def stop(rays: int, *more: float) -> None:
        if rays >= 40_000:
            raise KeyboardInterrupt

    with pytest.raises(nsq_gpu.Interrupted) as caught:
        found_of(parabola(), [0.0, 0.5, 1.0, 1.5], "x5", progress=stop)
    partial = caught.value.partial
    assert (partial.num_rays[:, 0] > 0).tolist() == [True, True, False, False]
    partial.save(tmp_path / "partial")
    again = nsq_gpu.PstResult.load(tmp_path / "partial")
    assert same(again, partial) and again.partial


def test_ctrl_c_before_a_direction_is_python_s(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pst_trace, "run", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        found_of(parabola(), [0.0], "x5")
    assert caught.type is KeyboardInterrupt


def test_an_error_of_a_later_part_keeps_the_earlier_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    traced, calls = pst_trace.traced, []

    def failing(*args: Any) -> Any:
        calls.append(args)
        if len(calls) == 3:
            raise nsq_gpu.DeviceError("the device was lost")
        return traced(*args)

    monkeypatch.setattr(pst_trace, "traced", failing)
    with pytest.raises(nsq_gpu.DeviceError, match="the device was lost") as caught:
        found_of(parabola(), [0.0, 0.5, 1.0], "x5", progress=lambda *_: None)
    assert (caught.value.partial.num_rays[:, 0] > 0).tolist() == [True, True, False]


def test_a_cluster_has_the_bits_of_one_call(turned: nsq_gpu.PstResult) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as local, \
            distributed.Client(local) as client:
        seen: list[int] = []
        found = found_of(parabola(), [0.0, 0.5, 1.0], "x5", azimuths_deg=[0.0, 90.0], client=client, parts=4, **toward("x5"),
                         progress=lambda rays, *_: seen.append(rays))
        assert same(found, turned) and seen[-1] == 120_000 and len(seen) == 4
        with pytest.raises(nsq_gpu.UsageError, match="`x6` is no detector; did you mean `x0`"):
            found_of(parabola(), [0.0, 0.5], "x6", client=client)
        with pytest.raises(nsq_gpu.UsageError, match=r"^scatter_to\[0\].target: `imge` is no detector"):
            found_of(parabola(), [0.0, 0.5], "x5", client=client, scatter_to={"*": "imge"})

        def stop(rays: int, *more: float) -> None:
            raise KeyboardInterrupt

        with pytest.raises(nsq_gpu.Interrupted) as caught:
            found_of(parabola(), [0.0, 0.5, 1.0, 1.5], "x5", client=client, parts=4, progress=stop)
        assert (caught.value.partial.num_rays > 0).sum() == 1
    with pytest.raises(nsq_gpu.UsageError, match="client is of type int"):
        found_of(parabola(), [0.0], "x5", client=3)


# Refusals


@pytest.mark.parametrize(("options", "said"), [
    ({"angles_deg": []}, r"angles_deg is \[\]; give angles from -360 to 360 degrees"),
    ({"angles_deg": [0.0, 400.0]}, "angles_deg is .*; give angles"),
    ({"angles_deg": "0:80:2"}, "angles_deg is '0:80:2'; give angles"),
    ({"angles_deg": [1.0, 1.0]}, "angles_deg has an angle twice"),
    ({"angles_deg": np.linspace(0, 80, 5000)}, "angles_deg has 5000 angles; give at most 4000"),
    ({"azimuths_deg": [np.nan]}, "azimuths_deg is"),
    ({"detector": "x6"}, "`x6` is no detector; did you mean `x0`"),
    ({"detector": None}, "detector is None; give a name"),
    ({"source": "sun"}, "`sun` is no source"),
    ({"pivot": (0, 0)}, r"pivot is \(0, 0\); give three numbers"),
    ({"parts": 0}, "parts is 0; give 1 or more"),
    ({"target_error": -1}, "target-error"),
    ({"where": "reflections == 2"}, "--where belongs to a trace"),
    ({"scatter_to": {"N": "x0"}}, r"^scatter_to\[0\].surface: `N` is no surface; these scatter: `M.surface`"),
    ({"scene": 3}, "scene is 3; give a scene, an NSQScene, or the path of its file"),
], ids=str)
def test_what_makes_no_sense_is_refused_by_name(options: dict[str, Any], said: str) -> None:
    given = {"angles_deg": [0.0], "detector": "x5", "scene": parabola(), **options}
    with pytest.raises(nsq_gpu.UsageError, match=said):
        found_of(given.pop("scene"), given.pop("angles_deg"), given.pop("detector"), **given)


def test_a_far_field_changes_nothing_of_a_beam_that_overfills_the_scene() -> None:
    options = {"source": None, "num_rays": 20_000, "scatter_to": {"wall*": "image"}}
    without = wall()
    without.remove_detector("sky")
    assert found_of(wall(), [0.0], "image", **options).pst[0, 0] == pytest.approx(found_of(without, [0.0], "image", **options).pst[0, 0])


def test_a_far_field_has_no_irradiance() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="the detector `sky` has no area"):
        found_of(wall(), [0.0], "sky", source="beam")


def test_a_warning_of_all_directions_is_given_once() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        nsq_gpu.pst(parabola(), [0.0, 0.5], "x5", binary=live.binary(), **OPTIONS)
    said = [str(warning.message) for warning in caught if issubclass(warning.category, nsq_gpu.NsqGpuWarning)]
    assert len([text for text in said if "lobe of" in text]) == 1 and not any("no ray reached" in text for text in said)


# Surfaces


def box() -> NSQScene:
    """Return a mirror that scatters, a detector beside its light, and a screen that the detector sees and no light meets."""
    scene = wall()
    dark = SurfaceConfig(reflectance=1.0, bsdf=LambertianBSDF(0.5), scatter_fraction=0.5)
    scene.add_mirror("screen", cs(y=40.0), MirrorConfig(np.inf, 1.0, aperture_radius=20.0, surface=dark))
    return scene


def test_surfaces_are_listed_by_what_they_send() -> None:
    found = nsq_gpu.stray_surfaces(box(), "image", num_rays=50_000, scatter_to={"wall*": "image"}, binary=live.binary())
    assert list(found["name"]) == ["wall.surface", "screen.surface"]
    first, second = found
    assert first["receives"] == pytest.approx(1.0, rel=1e-6) and second["receives"] == 0.0
    assert first["sends"] > 0.0 and 0.0 < first["sends_standard_error"] < 0.1 * first["sends"]
    # The trace of the light alone gives the same.
    with live.quiet():
        whole = box().trace(50_000, seed=1, backend=live.backend(scatter_to={"wall*": "image"}, standard_error=True)).detectors["image"]
    assert abs(first["sends"] - whole.total_flux) < 4.5 * np.hypot(first["sends_standard_error"], whole.total_flux_standard_error)
    assert 0.0 < first["seen"] < 0.1 and second["seen"] > first["seen"]
    assert list(found[(found["receives"] > 0) & (found["seen"] > 0)]["name"]) == [first["name"]]
    text = repr(found)
    assert "lit and seen" in text.splitlines()[2] and "seen by the detector" in text
    pytest.importorskip("pandas")
    frame = found.to_pandas()
    assert list(frame.columns) == ["name", "receives", "sends", "sends_standard_error", "seen"]
    assert frame.attrs["units"] == {"receives": "W", "sends": "W", "sends_standard_error": "W", "seen": "1"}


def test_surfaces_of_a_file_are_those_of_the_command(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    nsq_gpu.export_scene(box(), path)
    found = nsq_gpu.stray_surfaces(path, "image", num_rays=5000, seed=2, binary=live.binary())
    done = subprocess.run([live.binary(), "surfaces", str(path), "--detector=image", "-n", "5000", "--seed=2", "--json"], check=True,
                          capture_output=True)
    assert [tuple(row) for row in found] == [tuple(entry.values()) for entry in json.loads(done.stdout)["surfaces"]]


def test_what_surfaces_cannot_heed_is_refused_by_name() -> None:
    for options, said in (({"detector": "imag"}, "`imag` is no detector; did you mean `image`"), ({"target_error": 0.1}, "target-error"),
                          ({"detector": 3}, "detector is 3; give a name"),
                          ({"scatter_prob": {"x": 0.5}}, "^scatter_prob: `x` is no surface")):
        with pytest.raises(nsq_gpu.UsageError, match=said):
            nsq_gpu.stray_surfaces(box(), **{"detector": "image", "num_rays": 1000, "binary": live.binary(), **options})
    with pytest.raises(nsq_gpu.TraceTimeoutError, match="took longer than timeout = 0.01 s"):
        nsq_gpu.stray_surfaces(box(), "image", num_rays=1_000_000, timeout=0.01, binary=live.binary())
