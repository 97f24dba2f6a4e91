"""Rays of files as sources: draws, files, refusals, and the program against NumPy ray by ray."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.components.configs import LensConfig
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig, RayDatabaseConfig
from optiland.nonsequential.rng import NSQRng
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import PointSourceConfig
from scipy.stats import chi2

import nsq_gpu
from nsq_gpu import process
from nsq_gpu.export import export, to_json
from nsq_gpu.photometry import luminous_efficacy
from nsq_gpu.scene_file import scene_from_dict
from nsq_gpu.sources import RaySource
from tests import live
from tests.live import cs, glass, two_lines

Columns = dict[str, np.ndarray]


def columns(count: int = 50, seed: int = 0, lines: Any = None) -> Columns:
    """Return rays of very different fluxes, some of them dark."""
    draw = np.random.default_rng(seed)
    L, M = draw.uniform(-0.3, 0.3, (2, count))
    rays = {"x": draw.normal(size=count), "y": draw.normal(size=count), "z": draw.uniform(-1.0, 1.0, count), "L": L, "M": M,
            "N": np.sqrt(1.0 - L**2 - M**2), "flux": np.where(draw.random(count) < 0.2, 0.0, draw.random(count) ** 4)}
    return rays if lines is None else {**rays, "wavelength": draw.choice(lines, count)}


def written(path: Path, rays: Columns, **changes: Any) -> Path:
    np.savez(path, **{**rays, **changes})
    return path


def source(path: Path, spectrum: Spectrum | None = None, **options: Any) -> RaySource:
    return RaySource.from_file(path, cs=options.pop("cs", cs()), spectrum=spectrum or two_lines(), **options)


def with_source(rays: RaySource) -> NSQScene:
    be.set_backend("numpy")
    be.set_precision("float64")
    scene = NSQScene()
    scene.source_registry.add("lamp", rays)
    scene.add_detector("screen", cs(z=20.0), IrradianceDetectorConfig(30.0, 30.0, 8, 8))
    return scene


def document(scene: NSQScene) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(to_json(export(scene).document))
    return content


def assert_same_rays(scene: NSQScene) -> Any:
    """Check that the program and NumPy trace the same rays, and return the program's result."""
    ours, theirs = (scene.trace(3000, seed=3, record_paths=True, backend=which) for which in (live.backend(), NumpyBackend(seed=3)))
    live.assert_same_paths(ours, theirs)
    assert ours.total_flux_in == pytest.approx(theirs.total_flux_in, rel=1e-12)
    return ours


# Draws


def test_rays_are_drawn_by_their_flux(tmp_path: Path) -> None:
    rays = columns()
    born = source(written(tmp_path / "rays.npz", rays)).generate(np.arange(100_000), NSQRng(5))
    chosen = np.abs(rays["x"] - born.x[:, None]).argmin(axis=1)
    np.testing.assert_array_equal(born.y, rays["y"][chosen])
    np.testing.assert_allclose(born.M, rays["M"][chosen], rtol=1e-15)
    lit = rays["flux"] > 0.0
    counts, expected = np.bincount(chosen, minlength=50), 1e5 * rays["flux"] / rays["flux"].sum()
    assert counts[~lit].sum() == 0
    full = expected >= 5.0
    deviation = ((counts - expected) ** 2)[full] / expected[full]
    assert 1e-4 < chi2.sf(deviation.sum(), full.sum() - 1) < 1.0 - 1e-4
    assert born.flux.sum() == pytest.approx(rays["flux"].sum())


def test_the_file_says_the_weights_of_its_wavelengths(tmp_path: Path) -> None:
    rays = columns(400, lines=[0.5, 0.601, 0.599])
    # Nothing is near the third, which gets no rays.
    lamp = source(written(tmp_path / "rays.npz", rays), Spectrum([0.6, 0.5, 0.7], [1.0, 1.0, 5.0]))
    born = lamp.generate(np.arange(50_000), NSQRng(5))
    assert set(born.wavelength) == {0.5, 0.6}
    share = rays["flux"][rays["wavelength"] == 0.5].sum() / rays["flux"].sum()
    assert (born.wavelength == 0.5).mean() == pytest.approx(share, abs=5.0 * math.sqrt(0.25 / 50_000))
    chosen = np.abs(rays["x"] - born.x[:, None]).argmin(axis=1)
    assert np.abs(rays["wavelength"][chosen] - born.wavelength).max() < 0.0011


def test_what_the_source_is_now_counts(tmp_path: Path) -> None:
    path, ids = written(tmp_path / "rays.npz", columns()), np.arange(100)
    lamp = source(path)
    before = lamp.generate(ids, NSQRng(1))
    lamp.scale = 2.0
    np.testing.assert_array_equal(lamp.generate(ids, NSQRng(1)).x, 2.0 * before.x)
    lamp.spectrum = Spectrum([0.45], [1.0])
    assert (lamp.generate(ids, NSQRng(1)).wavelength == 0.45).all()
    written(path, columns(seed=9, count=60))
    assert lamp.total_flux == pytest.approx(columns(seed=9, count=60)["flux"].sum())
    lamp.total_flux = 7.0
    assert lamp.total_flux == 7.0 and not lamp.is_of_its_file


# Files


@pytest.mark.parametrize("options", [{}, {"total_flux": 2.5}, {"total_flux_lumens": 80.0, "scale": 2.0},
                                     {"cs": cs(x=1.0, ry=0.2), "medium": glass(1.3, 1e-5)}], ids=["bare", "W", "lm", "medium"])
def test_a_file_holds_the_source(options: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "rays.npz", columns(lines=[0.5, 0.6]))
    monkeypatch.chdir(tmp_path)
    lamp = source(Path("rays.npz"), **options)
    content = document(with_source(lamp))
    [entry] = content["sources"]
    assert entry.keys() == {"type", "name", "cs", "spectrum", "medium", "file", "order", "scale"} | (
        options.keys() & {"total_flux", "total_flux_lumens"})
    assert entry["type"] == "rays" and entry["order"] == "drawn" and entry["scale"] == lamp.scale
    assert entry["file"] == lamp.file == str(tmp_path / "rays.npz")
    again = scene_from_dict(content)
    assert document(again) == content and type(again.sources[0]) is RaySource
    one, other = (which.generate(np.arange(500), NSQRng(3)) for which in (lamp, again.sources[0]))
    for key in ("x", "y", "z", "L", "M", "N", "flux", "wavelength", "n_current", "k_current"):
        np.testing.assert_array_equal(getattr(one, key), getattr(other, key))


def test_a_scene_names_the_file_from_its_folder(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    written(tmp_path / "folder" / "rays.npz", columns())
    entry = {"type": "rays", "name": "lamp", "cs": {}, "file": "rays.npz", "total_flux": None,
             "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}
    lamp: Any = scene_from_dict({"nsq_schema_version": 1, "sources": [entry]}, tmp_path / "folder").sources[0]
    assert lamp.file == str(tmp_path / "folder" / "rays.npz") and lamp.scale == 1.0 and lamp.is_of_its_file


def test_the_live_flux_is_the_truth(tmp_path: Path) -> None:
    lamp = source(written(tmp_path / "rays.npz", columns(lines=[0.5, 0.6])), total_flux_lumens=80.0)
    rays = columns(lines=[0.5, 0.6])
    weights = [rays["flux"][rays["wavelength"] == line].sum() for line in (0.5, 0.6)]
    assert lamp.total_flux * luminous_efficacy(Spectrum([0.5, 0.6], weights)) == pytest.approx(80.0, rel=1e-14)
    lamp.total_flux = 7.0
    [entry] = document(with_source(lamp))["sources"]
    assert entry["total_flux"] == 7.0 and "total_flux_lumens" not in entry


# Refusals


@pytest.mark.parametrize(("changes", "words"), [
    ({"flux": np.zeros(50)}, "the file has no rays with light; give a file with rays"),
    ({"flux": np.full(50, -1.0)}, "the flux of ray 0 is none; give finite numbers of 0 or more"),
    ({"x": np.full(50, math.nan)}, "the position of ray 0 is none; give finite numbers"),
    ({"N": np.full(50, 0.5)}, "the direction of ray 0 is none; give unit vectors, to within 0.001"),
    ({"wavelength": np.zeros(50)}, "the wavelength of ray 0 is none; give finite numbers above 0"),
    ({"wavelength": np.full(50, 0.53)}, r"ray \d+ has a wavelength of 0.53 um, and the spectrum of the source has none within 25 nm"),
    ({"y": np.zeros(49)}, r"the column 'y' is no uncompressed array of f8 of shape \(50,\)"),
    ({"y": np.zeros(50, dtype=np.float32)}, "the column 'y' is no uncompressed array of f8"),
    ({"x": np.zeros(0)}, "the file has no rays with light"),
])
def test_rays_that_are_none_are_refused_by_their_place(changes: Columns, words: str, tmp_path: Path) -> None:
    path = written(tmp_path / "rays.npz", columns(), **changes)
    with pytest.raises(nsq_gpu.UsageError, match=f"rays.npz: {words}"):
        source(path)
    assert_refused_by_the_program(path)


def assert_refused_by_the_program(path: Path, **entries: Any) -> None:
    """Check that the program refuses what Python refuses, of a source with these entries."""
    good = path.with_name("good.npz")
    content = document(with_source(source(written(good, columns()))))
    content["sources"][0].update({"file": str(path), **entries})
    with nsq_gpu.Session(binary=live.binary(), precision="f64") as session, pytest.raises(nsq_gpu.NsqGpuError, match=r"sources\[0\]"):
        session.request(content, {"num_rays": 10})


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    for path in ("lamp.ies", "lamp", 5):
        with pytest.raises(nsq_gpu.UsageError, match="file is .*; give the path of a ray file, whose name ends with"):
            source(path)  # type: ignore[arg-type]
    for name in ("absent.npz", "absent.tm25ray"):
        with pytest.raises(nsq_gpu.UsageError, match=f"{name}', and there is no such file"):
            source(tmp_path / name)
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(nsq_gpu.UsageError, match="text.npz: it is of no known format: it begins with the bytes"):
        source(tmp_path / "text.npz")
    rays = columns()
    np.savez_compressed(tmp_path / "packed.npz", **rays)
    with pytest.raises(nsq_gpu.UsageError, match="the column 'x' is no uncompressed array"):
        source(tmp_path / "packed.npz")
    assert_refused_by_the_program(tmp_path / "packed.npz")
    del rays["M"]
    with pytest.raises(nsq_gpu.UsageError, match="there is no column 'M'; a ray file has the columns"):
        source(written(tmp_path / "less.npz", rays))
    assert_refused_by_the_program(tmp_path / "less.npz")


def test_arguments_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "rays.npz", columns())
    for options, words in (({"scale": 0.0}, "scale is 0.0; give a finite number above 0"),
                           ({"total_flux": -1.0}, "total_flux is -1.0; give a finite number above 0"),
                           ({"total_flux_lumens": "much"}, "total_flux_lumens is 'much'; give a finite number"),
                           ({"total_flux": 1.0, "total_flux_lumens": 1.0}, "total_flux, total_flux_lumens: both are given")):
        with pytest.raises(nsq_gpu.UsageError, match=words):
            source(path, **options)  # type: ignore[arg-type]
    with pytest.raises(nsq_gpu.UsageError, match="is not visible, and has no lumens"):
        _ = source(path, Spectrum([1.0], [1.0]), total_flux_lumens=5.0).total_flux
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="no RaySource; .*export_scene"):
        with_source(source(path)).to_json(str(tmp_path / "scene.json"))


# The program


def recorded(folder: Path, *arguments: str) -> Path:
    """Return the rays that the program recorded behind a lens, as its file has them; it may take more arguments."""
    scene = NSQScene()
    scene.add_source("lamp", cs(z=-20.0), PointSourceConfig(two_lines(), half_angle_deg=25.0, total_flux=3.0))
    scene.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass(), 12.0))
    scene.add_detector("plane", cs(z=8.0), RayDatabaseConfig(30.0, 30.0))
    nsq_gpu.export_scene(scene, folder / "scene.json")
    process.run([live.binary(), "trace", str(folder / "scene.json"), "-n", "500", "-o", str(folder / "out"), *arguments], None)
    return folder / "out" / "plane.npz"


@pytest.mark.parametrize("options", [{}, {"total_flux": 2.0}, {"total_flux_lumens": 100.0}], ids=["bare", "W", "lm"])
def test_the_program_traces_a_recorded_lamp_as_numpy(options: dict[str, Any], tmp_path: Path) -> None:
    path = recorded(tmp_path)
    scene = with_source(source(path, cs=cs(x=1.0, z=-4.0, ry=0.2), **options))
    scene.add_lens("L", cs(z=8.0), LensConfig(60.0, -60.0, 5.0, glass(), 15.0))
    launched = assert_same_rays(scene).total_flux_in
    if not options:
        with np.load(path) as rays:
            assert len(rays["flux"]) > 100 and launched == pytest.approx(rays["flux"].sum())


@pytest.mark.filterwarnings("ignore::nsq_gpu.NsqGpuWarning")
@pytest.mark.parametrize("lines", [None, [0.55], [0.501, 0.499, 0.61]], ids=["none", "one", "three"])
def test_the_program_draws_as_numpy(lines: Any, tmp_path: Path) -> None:
    spectrum = Spectrum([0.5, 0.6, 0.55, 0.7], [1.0, 2.0, 1.0, 3.0])
    path = written(tmp_path / "rays.npz", columns(1000, lines=lines))
    assert_same_rays(with_source(source(path, spectrum, cs=cs(y=1.0, rx=0.2), scale=0.5, medium=glass(1.2, 1e-5))))


def test_a_source_among_others(tmp_path: Path) -> None:
    scene = with_source(source(written(tmp_path / "rays.npz", columns(lines=[0.5, 0.6]))))
    scene.add_source("second", cs(z=-3.0), PointSourceConfig(two_lines(), half_angle_deg=20.0))
    live.assert_equals_numpy(scene, 5000)
    assert_same_rays(scene)
