"""What a shell shows of a result, pictures of it, and the names and units of its tables."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Iterator
from typing import Any
from unittest import mock

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import (
    FarFieldDetectorConfig,
    IrradianceDetectorConfig,
    RayDatabaseConfig,
    SpectralDetectorConfig,
)

import nsq_gpu
from nsq_gpu.display import MOST_ROWS, Summary, of_scene
from nsq_gpu.paths import path_table
from nsq_gpu.units import identifiers, unit_of
from tests import live
from tests.live import bench, cs

NUM_RAYS = 20_000


def four() -> NSQScene:
    """Return a scene with a detector of each kind; rays pass the first three."""
    scene = bench()
    scene.remove_detector("screen")
    scene.add_detector("my wall", cs(z=10.0), IrradianceDetectorConfig(40.0, 30.0, 8, 6, absorb=False))
    scene.add_detector("colours", cs(z=20.0), SpectralDetectorConfig(60.0, 60.0, 5, 4, wl_min=0.45, wl_max=0.65, num_bins=4,
                                                                     absorb=False))
    scene.add_detector("sky", cs(z=25.0), FarFieldDetectorConfig(12, 8, absorb=False))
    scene.add_detector("rays", cs(z=30.0), RayDatabaseConfig(60.0, 60.0))
    return scene


@pytest.fixture(scope="module")
def result() -> nsq_gpu.Result:
    return four().trace(NUM_RAYS, backend=live.backend(standard_error=True, paths=True))


@pytest.fixture(scope="module")
def sweep() -> nsq_gpu.Sweep:
    with nsq_gpu.Session(binary=live.binary()) as session:
        return session.sweep(four(), {"lamp.z": [-20.0, -19.0, -18.0], "my wall.width": [40.0, 42.0]}, 2000, maps=True)


@pytest.fixture
def axes() -> Iterator[Any]:
    """Return Matplotlib, without windows, and close all pictures."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    yield plt
    plt.close("all")


# Tables


def test_a_result_is_shown_with_its_detectors_and_its_ledger(result: nsq_gpu.Result) -> None:
    text = repr(result)
    assert text.startswith("Result: 20,000 rays in ") and "The ledger closes." in text
    for name, flux in ((name, found.total_flux) for name, found in result.detectors.items()):
        assert f"{float(flux):.6g}" in next(line for line in text.splitlines() if line.startswith(name))
    assert isinstance(result, nsq_gpu.results.SimulationResult) and len(text) < 2000
    # It goes to other processes whole. A copy by parts has Optiland's fields, and is shown by these.
    assert repr(pickle.loads(pickle.dumps(result))) == text
    assert repr(dataclasses.replace(result, num_rays_total=7)).startswith("SimulationResult(num_rays_total=7, ")


def test_a_stopped_result_says_so() -> None:
    scene = bench()
    with nsq_gpu.Session(binary=live.binary()) as session, pytest.raises(nsq_gpu.TraceTimeoutError) as caught:
        session.trace(scene, 10**11, timeout=3.0)
    assert "stopped before its end" in repr(caught.value.partial)


def test_long_tables_show_their_first_rows(sweep: nsq_gpu.Sweep) -> None:
    assert len(repr(sweep).splitlines()) == 1 + 1 + 6 and repr(sweep).startswith("Sweep: 3 x 2 points of lamp.z, my wall.width")
    row = {"rank": 1, "flux": 1.0, "share": 0.5, "standard_error": None, "num_rays": 3, "reflections": 0, "scatterings": 0,
           "detector": "D", "sequence": "S > D", "steps": [], "where": None}
    shown = repr(path_table([row] * 1000))
    assert shown.startswith("PathTable: 1000 paths") and len(shown.splitlines()) == MOST_ROWS + 3
    assert shown.splitlines()[-1] == f"... and {1000 - MOST_ROWS} more rows"


def test_columns_and_other_views_of_a_table_are_shown_as_numpy_shows_them(result: nsq_gpu.Result) -> None:
    assert result.paths is not None
    assert repr(result.paths["flux"]).startswith("array(")
    assert result.paths[["rank", "flux"]]._repr_html_() is None
    assert repr(result.paths[["rank", "flux"]]).startswith("PathTable([(1,")
    assert repr(result.paths[:1]).startswith("PathTable: 1 paths")


def test_derivatives_and_differences_are_shown_without_their_arrays() -> None:
    options = {"precision": "f64", "binary": live.binary()}
    found = nsq_gpu.jacobian(bench(), ["lamp.total_flux", "screen.z"], NUM_RAYS, **options)
    assert repr(found).startswith("Jacobian: 20,000 rays\n") and "W/mm" in repr(found) and "array" not in repr(found)
    assert repr(found["lamp.total_flux", "screen"]).startswith("Derivative: ") and "12 x 12" in \
        repr(found["lamp.total_flux", "screen"])
    difference = nsq_gpu.diff(bench(), bench(), NUM_RAYS, **options)
    assert "A - B [W]" in repr(difference) and "array" not in repr(difference) and len(repr(difference)) < 2000
    assert len(repr(difference.detectors["screen"])) < 200


def test_names_of_others_are_no_markup() -> None:
    summary = Summary("<b>", ["<i>"], [["<script>alert(1)</script>"]], notes=["a & b"])
    assert "<script>" not in summary.html() and "&lt;script&gt;" in summary.html()
    assert "<b>" not in summary.html() and "a &amp; b" in summary.html()


def test_a_scene_is_shown_with_all_that_stands_in_it() -> None:
    text = of_scene(live.load(live.ROOT / "scenes" / "cooke_triplet.json")).text()
    assert "Lens" in text and "mm" in text
    scene = four()
    lines = of_scene(scene).text().splitlines()
    assert lines[0] == "NSQScene: 0 components with 0 surfaces, 1 sources, 4 detectors" and len(lines) == 2 + 5
    assert "40 x 30 mm, 8 x 6 pixels" in lines[3] and lines[2].split()[-2:] == ["1", "W"]


# Pictures


def test_a_map_is_drawn_with_its_pixels_unit_and_colour_bar(result: nsq_gpu.Result, axes: Any) -> None:
    ax = result.plot("my wall", unit="mW/cm2")
    image = ax.images[0]
    # W/mm^2 -> mW/cm^2.
    assert np.allclose(image.get_array(), result.detectors["my wall"].irradiance * 1e5)
    assert image.get_extent() == [-20.0, 20.0, -15.0, 15.0] and image.origin == "lower"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [mm]", "y [mm]")
    assert ax.figure.axes[1].get_ylabel() == "Irradiance [mW/cm²]"
    assert ax.get_title() == f"my wall: {result.detectors['my wall'].total_flux:.4g} W"


def test_a_logarithmic_scale_has_six_decades_at_most_and_no_black(result: nsq_gpu.Result, axes: Any) -> None:
    found = result.detectors["my wall"]
    kept = found.irradiance
    try:
        found.irradiance = np.geomspace(1e-12, 1.0, 48).reshape(6, 8)
        found.irradiance[0, 0] = 0.0
        norm = result.plot("my wall", scale="log", unit="W/mm2").images[0].norm
        assert (norm.vmin, norm.vmax) == (1e-6, 1.0) and norm(0.0) == 0.0 and norm(1e-3) == pytest.approx(0.5)
        found.irradiance = np.zeros((6, 8))
        for scale in ("linear", "log"):
            result.plot("my wall", scale=scale).figure.canvas.draw()
    finally:
        found.irradiance = kept


def test_a_far_field_and_spectra_are_drawn_in_their_units(result: nsq_gpu.Result, axes: Any) -> None:
    sky = result.plot("sky", unit="W/sr", smooth=False)
    assert sky.name == "polar" and sky.figure.axes[1].get_ylabel() == "Intensity [W/sr]"
    # Eight cells around the axis, each of 22 parts.
    drawn = sky.collections[0].get_array().reshape(12, 8, 22)
    assert np.allclose(drawn, result.detectors["sky"].intensity[:, :, None])
    spectrum = result.plot("colours")
    values, edges, _ = spectrum.patches[0].get_data()
    assert values.sum() == pytest.approx(result.detectors["colours"].total_flux) and np.allclose(edges, [0.45, 0.5, 0.55, 0.6, 0.65])
    assert (spectrum.get_xlabel(), spectrum.get_ylabel()) == ("wavelength [µm]", "flux [W per bin]")
    all_light = result.plot("colours", wavelength="all", unit="W/mm2").images[0].get_array()
    one_bin = result.plot("colours", wavelength=0.61, unit="W/mm2").images[0].get_array()
    assert np.allclose(all_light, result.detectors["colours"].irradiance.sum(axis=2))
    assert np.allclose(one_bin, result.detectors["colours"].irradiance[:, :, 3])


def test_a_picture_may_go_into_axes_of_ones_own(result: nsq_gpu.Result, axes: Any) -> None:
    figure, (left, right) = axes.subplots(1, 2)
    assert result.plot("my wall", ax=left, cmap="magma") is left and left.images[0].get_cmap().name == "magma"
    with pytest.raises(nsq_gpu.UsageError, match="polar axes, and ax is rectilinear"):
        result.plot("sky", ax=right)


@pytest.mark.parametrize(("arguments", "said"), [
    ({}, r"name the detector to draw, one of 'my wall', 'colours', 'sky': result.plot\('my wall'\)"),
    ({"detector": "walls"}, "no detector 'walls'; it has 'my wall', 'colours', 'sky'"),
    ({"detector": "rays"}, r"'rays' records single rays and has no map; .*result.detectors\['rays'\].x"),
    ({"detector": "sky", "scale": "logarithmic"}, "scale is 'logarithmic'; give 'linear' or 'log'"),
    ({"detector": "sky", "unit": "W/mm2"}, "unit is 'W/mm2', and the map is in W/sr"),
    ({"detector": "my wall", "unit": "lux"}, "unit is 'lux'; give W/mm2, W/cm2"),
    ({"detector": "my wall", "wavelength": 0.5}, "'my wall' has no wavelengths"),
    ({"detector": "colours", "unit": "mW/mm2"}, "a spectrum is in W per bin"),
    ({"detector": "colours", "wavelength": "red"}, r"wavelength is 'red'; give a number \[um\], or 'all'"),
])
def test_what_cannot_be_drawn_is_refused_by_what_there_is(result: nsq_gpu.Result, axes: Any, arguments: dict[str, Any],
                                                          said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=said):
        result.plot(**arguments)
    assert not axes.get_fignums()


def test_a_detector_that_is_the_only_one_need_not_be_named(axes: Any) -> None:
    assert bench().trace(1000, backend=live.backend()).plot().get_title().startswith("screen: ")


# Names and units


def test_units_are_those_of_the_scene_file() -> None:
    for name, unit in {"L1.r1": "mm", "L1.z": "mm", "L1.rx": "rad", "lamp.total_flux": "W", "lamp.half_angle_deg": "deg",
                       "stop.aperture_radius": "mm", "gap_3": "mm", "camera.wl_min": "um", "glass.n": None,
                       "M.reflectance": None, '"a.b".width': "mm"}.items():
        assert unit_of(name) == unit, name


def test_names_have_no_spaces_and_stay_different() -> None:
    assert identifiers(["a b", "a_b", " a\tb"]) == {"a b": "a_b", "a_b": "a_b_2", " a\tb": "a_b_3"}


def test_a_result_goes_to_xarray_with_units(result: nsq_gpu.Result) -> None:
    pytest.importorskip("xarray")
    found = result.to_xarray()
    assert not any(" " in str(name) for name in [*found.variables, *found.dims])
    assert all(found[name].attrs["units"] for name in found.variables)
    assert found.my_wall.dims == ("my_wall_y", "my_wall_x") and found.my_wall.attrs["units"] == "W/mm^2"
    assert found.my_wall_x.attrs == {"units": "mm"} and found.my_wall_x.values[0] == -17.5
    assert found.colours_wavelength.attrs == {"units": "um"} and found.sky_theta.attrs == {"units": "deg"}
    assert np.array_equal(found.my_wall_standard_error, result.detectors["my wall"].standard_error)
    area = float(found.my_wall_x.diff("my_wall_x")[0] * found.my_wall_y.diff("my_wall_y")[0])
    assert float(found.my_wall.sum() * area) == pytest.approx(result.detectors["my wall"].total_flux)
    assert float(found.rays_flux.sum()) == pytest.approx(result.detectors["rays"].total_flux)
    assert found.attrs["num_rays"] == NUM_RAYS


def test_tables_of_pandas_know_their_units(result: nsq_gpu.Result, sweep: nsq_gpu.Sweep) -> None:
    pytest.importorskip("pandas")
    frame = result.to_pandas()
    assert list(frame["detector"]) == list(result.detectors) and frame.attrs["units"]["flux"] == "W"
    assert np.allclose(frame["flux"], [float(found.total_flux) for found in result.detectors.values()])
    assert result.paths is not None and result.paths.to_pandas().attrs["units"]["flux"] == "W"
    points = sweep.to_pandas()
    assert not any(" " in name for name in points.columns) and len(points) == 6
    assert points.attrs["units"] == {"lamp.z": "mm", "my_wall.width": "mm"} | {
        name: "1" if name.endswith(("rests_on", "num_rays")) else "W" for name in points.columns[2:]}
    assert points["my_wall_flux"].to_list() == sweep.flux["my wall"].ravel().tolist()
    assert points["lamp.z"].to_list() == [-20.0, -20.0, -19.0, -19.0, -18.0, -18.0]


def test_a_sweep_goes_to_xarray_with_units_on_coordinates(sweep: nsq_gpu.Sweep) -> None:
    pytest.importorskip("xarray")
    found = sweep.to_xarray()
    assert not any(" " in str(name) for name in [*found.variables, *found.dims])
    assert found["lamp.z"].attrs == {"units": "mm"} and found["my_wall.width"].attrs == {"units": "mm"}
    assert found.my_wall_flux.dims == ("lamp.z", "my_wall.width") and found.my_wall_flux.attrs == {"units": "W"}
    assert found.colours_map.dims == ("lamp.z", "my_wall.width", "colours_y", "colours_x", "colours_wavelength")
    assert found.colours_wavelength.attrs == {"units": "um"} and found.sky_map.attrs == {"units": "W/sr"}
    # The wall's pixels lie elsewhere at each width: along x they have no coordinates.
    assert "my_wall_y" in found.coords and "my_wall_x" not in found.coords
    assert float(found.my_wall_flux.sel({"lamp.z": -19.0, "my_wall.width": 42.0})) == sweep.flux["my wall"][1, 1]


@pytest.mark.parametrize("library", ["pandas", "xarray"])
def test_a_library_that_is_missing_is_named_with_its_command(result: nsq_gpu.Result, sweep: nsq_gpu.Sweep, library: str) -> None:
    with mock.patch.dict("sys.modules", {library: None}):
        for table in (result, sweep):
            with pytest.raises(nsq_gpu.MissingLibraryError, match=rf"{library} is not installed, and to_{library} needs it: pip "
                                                                  rf"install 'nsq-gpu\[{library}\]'"):
                getattr(table, f"to_{library}")()
