"""Ghosts over the fields of a lens: the table, the worst ones and the montage, beside separate traces, closed forms and others' numbers."""

from __future__ import annotations

import functools
import json
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import LogNorm
from optiland.nonsequential import LensConfig, NSQScene
from optiland.nonsequential.components.configs import MirrorConfig
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig, RayDatabaseConfig
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.nonsequential.sources.configs import CollimatedSourceConfig
from optiland.optic import Optic
from optiland.samples.objectives import CookeTriplet

import nsq_gpu
from nsq_gpu import ghosting
from tests import live
from tests.live import cs, glass

matplotlib.use("Agg")

pytestmark = pytest.mark.in_turn

NUM_RAYS = 4000
#: What a trace of each field needs in the place of the defaults, for speed and for the same rays as those of separate traces.
OPTIONS = {"num_rays": NUM_RAYS, "seed": 7, "precision": "f64", "guide": False, "max_depth": 24, "split_depth": 6, "progress": False}


def found_of(given: Any, *args: Any, **options: Any) -> nsq_gpu.Ghosts:
    with live.quiet():
        return nsq_gpu.ghosts(given, *args, binary=live.binary(), **{**OPTIONS, **options})


@functools.cache
def triplet() -> nsq_gpu.Ghosts:
    """Return the ghosts of a lens with three fields."""
    return found_of(CookeTriplet(), top=4)


def rows_of(found: nsq_gpu.Ghosts, index: int = 0) -> list[dict[str, Any]]:
    return found.fields[index].rows


def faces_of(path: Any) -> str:
    return " > ".join(name for letters, name in path["steps"] if letters == "R")


def plate(thickness: float = 5.0, n: float = 1.5) -> NSQScene:
    """Return a beam that meets a bare plate at normal incidence, and a map behind it."""
    scene = NSQScene()
    scene.add_source("beam", cs(z=-10.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=2.0))
    scene.add_lens("P", cs(), LensConfig(np.inf, np.inf, thickness, glass(n), 10.0))
    scene.add_detector("image", cs(z=20.0), IrradianceDetectorConfig(10.0, 10.0, 10, 10))
    return scene


def refused(message: str, *args: Any, **options: Any) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=message):
        found_of(*args, **options)


# Fields of an Optic


def test_each_field_is_a_trace_of_its_own() -> None:
    found = triplet()
    assert [of_field.field.label for of_field in found.fields] == ["0°", "14°", "20°"]
    for index, of_field in enumerate(found.fields):
        scene = nsq_gpu.from_optic(CookeTriplet(), detector_pixels=(128, 128))
        for name in set(scene.source_names) - {f"source_{index}"}:
            scene.remove_source(name)
        scene.sampling_policy = SamplingPolicy(split_depth=6)
        with live.quiet():
            result = scene.trace(NUM_RAYS, seed=7, max_depth=24, backend=live.backend(paths=True))
        paths = result.paths[result.paths["detector"] == "image"]
        assert of_field.flux == pytest.approx(result.detectors["image"].total_flux, rel=1e-12)
        sums: dict[str, float] = {}
        for row in paths[(paths["reflections"] >= 2) & (paths["scatterings"] == 0)]:
            sums[faces_of(row)] = sums.get(faces_of(row), 0.0) + row["flux"]
        assert {row["faces"]: row["flux"] for row in of_field.rows} == pytest.approx(sums, rel=1e-9)


def test_ghosts_and_the_image_are_all_light() -> None:
    found = triplet()
    for of_field in found.fields:
        image = of_field.flux - sum(row["flux"] for row in of_field.rows)
        share = 1.0 - sum(row["share"] for row in of_field.rows)
        assert 0.9 < share < 1.0 and share == pytest.approx(image / of_field.flux, rel=1e-9)


def test_maps_hold_the_light_of_their_rows() -> None:
    found = triplet()
    for of_field in found.fields:
        assert len(of_field.maps) == found.top == 4
        area = float((of_field.x[1] - of_field.x[0]) * (of_field.y[1] - of_field.y[0]))
        for row, map in zip(of_field.rows, of_field.maps, strict=False):
            assert map is not None and map.sum() * area == pytest.approx(row["flux"], rel=1e-9)
            assert map.max() == pytest.approx(row["peak_irradiance"], rel=1e-9)


def test_a_row_has_the_expression_that_keeps_it_alone() -> None:
    found = triplet()
    row = rows_of(found, 1)[0]
    with live.quiet():
        alone = found.scene.trace(3_000, max_depth=24, backend=live.backend(where=row["where"], paths=True)).paths
    assert alone.size and {faces_of(path) for path in alone} == {row["faces"]}
    assert {path["sequence"].split(" > ")[0] for path in alone} == {"source_1"}


def test_other_fields_leave_the_lens_as_it_is() -> None:
    found = found_of(CookeTriplet(), [14, (5, 0)], top=1)
    assert [of_field.field.label for of_field in found.fields] == ["14°", "(5°, 0°)"]
    own, other = triplet().fields[1], found.fields[0]
    assert np.array_equal(own.x, other.x)
    assert [row["flux"] for row in other.rows] == pytest.approx([row["flux"] for row in own.rows], rel=1e-9)
    assert rows_of(found, 1)[0]["flux"] > 0.0


def test_a_lens_of_heights_has_fields_in_mm() -> None:
    optic = Optic()
    optic.surfaces.add(index=0, thickness=100.0)
    optic.surfaces.add(index=1, radius=50.0, thickness=5.0, material="N-BK7", is_stop=True)
    optic.surfaces.add(index=2, radius=-50.0, thickness=95.0)
    optic.surfaces.add(index=3)
    optic.set_aperture(aperture_type="EPD", value=10)
    optic.fields.set_type("object_height")
    optic.fields.add(y=0)
    optic.fields.add(y=5)
    optic.wavelengths.add(value=0.55, is_primary=True)
    found = found_of(optic)
    assert [of_field.field.label for of_field in found.fields] == ["0 mm", "5 mm"] and found.unit == "mm"
    assert [row["faces"] for row in rows_of(found, 1)][0] == "L1.back > L1.front"


# Scenes


def test_a_plate_has_the_ghosts_of_its_closed_form() -> None:
    found = found_of(plate(), num_rays=50_000, top=2)
    reflected = ((1.5 - 1.0) / (1.5 + 1.0)) ** 2
    assert [of_field.field.label for of_field in found.fields] == ["all"]
    assert found.fields[0].flux == pytest.approx((1 - reflected) / (1 + reflected), rel=1e-3)
    # Each pass back and forth takes two reflections more.
    for row, power in zip(rows_of(found), (2, 4), strict=False):
        assert row["reflections"] == power and row["faces"] == " > ".join(["P.back", "P.front"] * (power // 2))
        assert abs(row["flux"] - (1 - reflected) ** 2 * reflected**power) <= max(4 * row["standard_error"], 1e-9 * row["flux"])
    first = rows_of(found)[0]
    assert first["rms_radius"] == pytest.approx(2.0 / np.sqrt(2.0), rel=0.01) and abs(first["centroid_x"]) < 0.02


@pytest.mark.parametrize("kind", ["dictionary", "path", "text"])
def test_a_scene_may_be_given_as_a_file_or_its_dictionary(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "plate.json"
    nsq_gpu.export_scene(plate(), file)
    given = {"dictionary": nsq_gpu.export.export(plate()).document, "path": file, "text": str(file)}[kind]
    assert rows_of(found_of(given))[0]["flux"] == rows_of(found_of(plate()))[0]["flux"]


def test_sources_of_a_scene_are_fields_by_their_names() -> None:
    scene = plate()
    scene.add_source("my lamp", cs(z=-10.0), CollimatedSourceConfig(live.two_lines(), total_flux=3.0, aperture_radius=1.0))
    found = found_of(scene, ["my lamp", "beam"])
    assert [of_field.field.label for of_field in found.fields] == ["my lamp", "beam"]
    assert rows_of(found)[0]["flux"] == pytest.approx(3.0 * rows_of(found, 1)[0]["flux"], rel=1e-6)
    assert scene.source_names == ["beam", "my lamp"]
    assert rows_of(found_of(scene))[0]["flux"] == pytest.approx(4.0 * rows_of(found, 1)[0]["flux"], rel=1e-6)


def test_mirrors_alone_make_no_ghost() -> None:
    scene = NSQScene()
    scene.add_source("beam", cs(z=-10.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=1.0))
    scene.add_mirror("M1", cs(rx=np.pi / 4), MirrorConfig(np.inf, 1.0, 10.0))
    scene.add_mirror("M2", cs(y=20.0, rx=np.pi / 4), MirrorConfig(np.inf, 1.0, 10.0))
    scene.add_detector("image", cs(y=20.0, z=60.0), IrradianceDetectorConfig(10.0, 10.0, 4, 4))
    refused("no face of the scene refracts.*NsqGpuBackend", scene)
    # A window in front of the detector: light of the image has two reflections, and is none; ghosts have four.
    scene.add_lens("W", cs(y=20.0, z=40.0), LensConfig(np.inf, np.inf, 2.0, glass(1.5), 10.0))
    found = found_of(scene, num_rays=20_000)
    assert found.fields[0].flux > 0.9
    assert rows_of(found)[0]["faces"] == "M1.surface > M2.surface > W.back > W.front"
    assert rows_of(found)[0]["flux"] == pytest.approx(0.96**2 * 0.04**2, rel=0.02)
    assert len(rows_of(found_of(scene, min_reflections=5))) < len(rows_of(found))


def test_groups_are_pairs_of_faces_or_sequences() -> None:
    scene = plate()
    scene.add_lens("Q", cs(z=10.0), LensConfig(np.inf, np.inf, 5.0, glass(), 10.0))
    pairs, sequences = rows_of(found_of(scene)), rows_of(found_of(scene, group="sequence"))
    assert len(sequences) >= len(pairs) and sequences[0]["sequence"].startswith("beam > T P.front > ")
    assert sum(row["flux"] for row in sequences) == pytest.approx(sum(row["flux"] for row in pairs), rel=1e-9)


def test_the_brightest_may_come_first() -> None:
    by_peak = rows_of(found_of(CookeTriplet(), [14], sort="peak"))
    peaks = [row["peak_irradiance"] for row in by_peak]
    known = [peak for peak in peaks if not np.isnan(peak)]
    assert known == sorted(known, reverse=True) and not np.isnan(peaks[: len(known)]).any() and len(known) < len(peaks)
    assert [row["rank"] for row in by_peak] == list(range(1, len(by_peak) + 1))
    assert {row["faces"] for row in by_peak} == {row["faces"] for row in rows_of(triplet(), 1)}


def test_each_option_reaches_the_program(monkeypatch: pytest.MonkeyPatch) -> None:
    class Told(Exception):
        """The command."""

    def told(command: list[str], *more: Any) -> None:
        raise Told(command)

    monkeypatch.setattr(ghosting, "_traced", told)

    def command(scene: NSQScene, **options: Any) -> list[str]:
        with pytest.raises(Told) as caught:
            nsq_gpu.ghosts(scene, binary=live.binary(), **options)
        return caught.value.args[0]

    given = {"num_rays": 1e3, "seed": 5, "max_depth": 9, "split_depth": 3, "precision": "f32", "adapter": "llvm", "detector": "image"}
    whole = command(plate(), progress=True, **given)
    expected = {f"--{name.replace('_', '-')}={int(value) if isinstance(value, float) else value}" for name, value in given.items()}
    assert expected | {"--group=faces", "--progress=json"} <= set(whole) and "--guide" not in whole
    # Rays are guided or split, unless the caller or the scene says how it is sampled.
    free = command(plate())
    assert "--guide" in free and "--split-depth=12" not in free and "--max-depth=16" in free
    assert "--guide" not in command(plate(), guide=False) and "--split-depth=12" in command(plate(), guide=False)
    own = plate()
    own.sampling_policy = SamplingPolicy(reflect_prob=0.2)
    assert not {"--guide", "--split-depth=12"} & set(command(own))


# What is shown


def test_the_table_has_labels_and_units() -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    found = triplet()
    assert isinstance(found.table, pandas.DataFrame) and len(found.table) == sum(len(of_field.rows) for of_field in found.fields)
    assert found.table.attrs["units"] | {"field_y": "deg", "flux": "W", "peak_irradiance": "W/mm^2"} == found.table.attrs["units"]
    assert not any(" " in name for name in found.table.columns)
    assert len(found.worst) == 3 * 4 and found.worst["rank"].max() == 4
    over_fields = found.worst.pivot_table(index="faces", columns="field_y", values="flux")
    assert list(over_fields.columns) == [0.0, 14.0, 20.0]


def test_without_pandas_the_table_is_a_list(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    rows = triplet().worst
    assert isinstance(rows, list) and len(rows) == 12 and rows[0]["field_y"] == 0.0


def test_a_dataset_has_maps_of_all_fields() -> None:
    pytest.importorskip("xarray", reason="xarray is not installed")
    found = triplet()
    data = found.to_xarray()
    assert data.irradiance.dims == ("field", "ghost", "y", "x") and data.irradiance.shape == (3, 4, 128, 128)
    assert data.field_y.values.tolist() == [0.0, 14.0, 20.0] and data.field_y.attrs["units"] == "deg"
    assert float(data.flux.sel(field="14°", ghost=1)) == rows_of(found, 1)[0]["flux"]
    assert str(data.faces.values[2, 0]) == rows_of(found, 2)[0]["faces"]
    # A plate has fewer ghosts than a row of the dataset.
    few = found_of(plate(), top=20, split_depth=0).to_xarray()
    assert np.isnan(few.flux.values[0, -1]) and np.isnan(few.irradiance.values[0, -1]).all() and few.faces.values[0, -1] == ""


def test_the_summary_has_a_column_a_field() -> None:
    text, page = repr(triplet()), triplet()._repr_html_()
    lines = text.splitlines()
    assert lines[0] == "Ghosts: flux [W] on image, 4,000 rays a field"
    assert lines[1].split() == ["reflected", "by", "0°", "14°", "20°"]
    assert all(" > " in line and "±" in line for line in lines[2:6])
    assert "14°" in page and page.count("<table>") == 1


def test_the_montage_has_one_scale_of_colours() -> None:
    axes = triplet().plot(cmap="inferno")
    assert axes.shape == (3, 4)
    norms = {id(axis.images[0].norm) for axis in axes.flat}
    assert len(norms) == 1 and isinstance(axes[0, 0].images[0].norm, LogNorm)
    [bar] = [axis for axis in axes[0, 0].figure.axes if axis not in set(axes.flat)]
    assert bar.get_ylabel() == "Irradiance [µW/mm²]"
    row = rows_of(triplet(), 1)[2]
    assert axes[1, 2].get_title() == f"14°: {row['faces']}\n{100 * row['share']:.2g} % of the light"
    assert triplet().plot(2).shape == (3, 2)
    assert not isinstance(triplet().plot(1, scale="linear", unit="mW/cm2")[0, 0].images[0].norm, LogNorm)
    with pytest.raises(nsq_gpu.UsageError, match="top is 9, and 4 ghosts"):
        triplet().plot(9)
    with pytest.raises(nsq_gpu.UsageError, match="scale is 'lin'; give 'linear' or 'log'"):
        triplet().plot(scale="lin")


def test_without_a_ghost_there_is_nothing_to_draw() -> None:
    found = found_of(plate(n=1.0 + 1e-9), num_rays=100)
    assert rows_of(found) == [] and "Ghosts: " in repr(found) and len(found.table) == 0
    with pytest.raises(nsq_gpu.UsageError, match="no ghost to draw; trace more rays"):
        found.plot()


# What goes wrong


def test_slips_are_answered_by_what_is_right() -> None:
    refused(r"detector is 'imag', which is no irradiance detector of the scene; did you mean 'image'\?", plate(), detector="imag")
    refused(r"detector is 'xyz', which is no irradiance detector of the scene; known here: 'image'", plate(), detector="xyz")
    refused(r"fields is 14; give a list, such as \[14\], or None", CookeTriplet(), 14)
    refused(r"fields is 'beam'; give a list, such as \['beam'\]", plate(), "beam")
    refused(r"fields has 'a'; give a number in deg, or a pair of x and y, such as \(0, 14\)", CookeTriplet(), ["a"])
    refused(r"fields has \(1, 2, 3\); give a number in deg", CookeTriplet(), [(1, 2, 3)])
    refused(r"fields has 14, and a scene has sources .* names, of 'beam', or the Optic itself", plate(), [14])
    refused(r"fields has 'baem', which is no source of the scene; did you mean 'beam'\?", plate(), ["baem"])
    refused("group is 'order'; give one of 'faces', 'sequence'", plate(), group="order")
    refused("sort is 'share'; give one of 'flux', 'peak'", plate(), sort="share")
    refused("top is 0; give 1 to 20", plate(), top=0)
    refused("min_reflections is 0; give 1 or more", plate(), min_reflections=0)
    refused("optic_or_scene is 3; give Optiland's Optic, an NSQScene", 3)


def test_of_several_detectors_one_is_named() -> None:
    scene = plate()
    scene.add_detector("rows", cs(z=18.0), RayDatabaseConfig(10.0, 10.0, absorb=False))
    assert rows_of(found_of(scene))
    scene.add_detector("second", cs(z=19.0), IrradianceDetectorConfig(10.0, 10.0, 4, 4, absorb=False))
    refused(r"name the detector, one of 'image', 'second': ghosts\(..., detector='image'\)", scene)
    refused("detector is 'rows', which is no irradiance detector", scene, detector="rows")
    assert rows_of(found_of(scene, detector="second"))[0]["flux"] == pytest.approx(rows_of(found_of(scene, detector="image"))[0]["flux"])


@pytest.mark.parametrize("how", ["ctrl-c", "timeout"])
def test_a_stop_keeps_the_fields_that_are_done(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    traced, calls = ghosting._traced, []

    def stopped(*args: Any) -> Any:
        calls.append(args)
        if len(calls) == 3:
            raise KeyboardInterrupt if how == "ctrl-c" else nsq_gpu.TraceTimeoutError("late")
        return traced(*args)

    monkeypatch.setattr(ghosting, "_traced", stopped)
    with pytest.raises(nsq_gpu.Interrupted if how == "ctrl-c" else nsq_gpu.TraceTimeoutError) as caught:
        found_of(CookeTriplet(), num_rays=500, timeout=600)
    partial = caught.value.partial
    assert [of_field.field.label for of_field in partial.fields] == ["0°", "14°"] and partial.partial
    assert "stopped before its end" in repr(partial) and partial.plot().shape[0] == 2
    calls[:] = [(), ()]
    with pytest.raises(KeyboardInterrupt if how == "ctrl-c" else nsq_gpu.TraceTimeoutError) as caught:
        found_of(CookeTriplet(), num_rays=500, timeout=600)
    assert getattr(caught.value, "partial", None) is None


def test_an_interrupt_within_the_first_field_ends_the_program() -> None:
    def stop(rays: int, *more: float) -> None:
        if rays > 0:
            raise KeyboardInterrupt

    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt) as caught:
        found_of(CookeTriplet(), num_rays=100_000_000, progress=stop)
    assert not isinstance(caught.value, nsq_gpu.Interrupted) and time.monotonic() - start < 60.0


def test_a_timeout_ends_the_call() -> None:
    with pytest.raises(nsq_gpu.TraceTimeoutError, match="the ghosts took longer than timeout = 0.2 s and were ended"):
        found_of(CookeTriplet(), num_rays=10_000_000, timeout=0.2)


def test_progress_counts_the_rays_of_all_fields() -> None:
    seen: list[tuple[int, int]] = []
    found_of(CookeTriplet(), [0, 14], num_rays=1000, progress=lambda rays, num_rays, rate: seen.append((rays, num_rays)))
    assert seen[-1] == (2000, 2000) and [rays for rays, _ in seen] == sorted(rays for rays, _ in seen)


def test_a_warning_of_all_fields_is_given_once() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        nsq_gpu.ghosts(CookeTriplet(), [0, 14], binary=live.binary(), **{**OPTIONS, "num_rays": 500, "max_depth": 8})
    said = [str(warning.message) for warning in caught if "depth limit" in str(warning.message)]
    assert len(said) == 1 and caught[0].filename == __file__


# Others' numbers

#: The ghost of the Cooke triplet in article 249 of Zemax' knowledge base: faces that reflect, and heights of a ray that comes in at
#: 5 mm, by places a little off the faces that light meets next, from the vertex of the first face on; the last is the image [mm].
ARTICLE_FACES = "L1.back > L1.front"
ARTICLE_HEIGHTS = {9.26651 - 1e-6: -2.2309, 10.26648 + 1e-6: -2.7766, 15.01689 - 1e-6: -7.3909, 17.96897 + 1e-6: -9.0530, 60.17675: -34.6809}
#: Where the ghost is in focus, from the image; its focal length; and its f-number for a beam of 10 mm.
ARTICLE_FOCUS, ARTICLE_LENGTH, ARTICLE_F_NUMBER = -57.1176, 8.2347, 0.823473


def test_a_ghost_of_the_cooke_triplet_goes_where_zemax_has_it(command: list[str], tmp_path: Path) -> None:
    """A thin beam near the axis: how high the middle of its ghost is, over how high it came in."""
    height, places = 0.01, list(ARTICLE_HEIGHTS)
    scene = nsq_gpu.from_optic(CookeTriplet())
    for name in list(scene.source_names):
        scene.remove_source(name)
    line = live.Spectrum(np.array([0.55]), np.array([1.0]))
    scene.add_source("beam", cs(y=height, z=-5.0), CollimatedSourceConfig(line, aperture_radius=1e-6))
    for place in places[:-1]:
        scene.add_detector(f"{place:g}", cs(z=place), IrradianceDetectorConfig(1.0, 1.0, 4, 4, absorb=False))
    nsq_gpu.export_scene(scene, tmp_path / "beam.json")
    paths = [*command, "paths", str(tmp_path / "beam.json"), "-n500", "--precision=f64", "--split-depth=6", "--max-depth=24", "--group=faces",
             "--json", "--top=10000"]
    rows = json.loads(subprocess.run(paths, capture_output=True, check=True).stdout)["paths"]
    steps = [["R", name] for name in ARTICLE_FACES.split(" > ")]
    centroids = {row["detector"]: row["centroid"][1] for row in rows if row["steps"] == steps}
    found = [centroids[name] / height * 5.0 for name in [*(f"{place:g}" for place in places[:-1]), "image"]]
    assert found == pytest.approx(list(ARTICLE_HEIGHTS.values()), abs=1e-4, rel=1e-5)
    slope = (found[-1] - found[-2]) / (places[-1] - places[-2])
    assert -found[-1] / slope == pytest.approx(ARTICLE_FOCUS, rel=1e-5)
    assert -5.0 / slope == pytest.approx(ARTICLE_LENGTH, rel=1e-5)
    assert -0.5 / slope == pytest.approx(ARTICLE_F_NUMBER, rel=1e-5)
    [ghost] = [row for row in rows_of(found_of(scene, detector="image", num_rays=500)) if row["faces"] == ARTICLE_FACES]
    assert ghost["centroid_y"] == pytest.approx(centroids["image"], rel=1e-5)
