"""Veiling glare: the closed form of a mirror that scatters, a lens whose field is the sum of its parts, stops and refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from optiland.nonsequential import LensConfig, NSQScene
from optiland.nonsequential.bsdf import LambertianBSDF
from optiland.nonsequential.components.configs import MirrorConfig, SurfaceConfig
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig, IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig
from optiland.samples.objectives import CookeTriplet

import nsq_gpu
from nsq_gpu import glare
from tests import live
from tests.live import cs

matplotlib.use("Agg")

pytestmark = pytest.mark.in_turn

F, RADIUS, SHARE = 1000.0, 125.0, 0.3
#: Half-angles of the spot and of the field [deg].
SPOT, FIELD = 0.2, 5.0
LINE = Spectrum(np.array([0.55]), np.array([1.0]))


def telescope() -> NSQScene:
    """Return a parabola that scatters a share of its light evenly, an opening before it, and a detector in its focus."""
    scene = NSQScene()
    surface = SurfaceConfig(reflectance=1.0, bsdf=LambertianBSDF(1.0), scatter_fraction=SHARE)
    scene.add_mirror("M", cs(), MirrorConfig(-2.0 * F, 1.0, conic=-1.0, aperture_radius=RADIUS, surface=surface))
    # All directions of the field come to all of the mirror.
    scene.add_source("beam", cs(z=-900.0), CollimatedSourceConfig(LINE, aperture_radius=RADIUS + 900.0 * np.tan(np.radians(FIELD)) + 1.0))
    scene.add_detector("image", cs(z=-F), IrradianceDetectorConfig(20.0, 20.0, absorb=False))
    return scene


def found_of(scene: Any, *args: Any, **options: Any) -> nsq_gpu.VeilingGlare:
    with live.quiet():
        return nsq_gpu.veiling_glare(scene, *args, binary=live.binary(),
                                     **{"half_spot_deg": SPOT, "half_field_deg": FIELD, "num_rays": 100_000,
                                        "scatter_to": [{"surface": "M*", "target": "image", "share": 0.9}], **options})


def squared_sine(angle_deg: float) -> float:
    return float(np.sin(np.radians(angle_deg)) ** 2)


def test_the_closed_form_of_a_mirror_that_scatters_evenly() -> None:
    """A radiance of 1 gives the mirror pi sin^2 of irradiance, of which a share is an even radiance of the mirror.

    The detector sees the mirror within pi sin^2 of the angle of its edge; straight light has the radiance 1 - share there.
    """
    found = found_of(telescope(), num_rays=400_000)
    seen = np.pi * (RADIUS / (F + RADIUS**2 / (4.0 * F))) ** 2
    black = SHARE * (squared_sine(FIELD) - squared_sine(SPOT)) * seen
    white = ((1.0 - SHARE) + SHARE * squared_sine(FIELD)) * seen
    assert abs(found.black[0, 0] - black) < 4.5 * found.black_standard_error[0, 0] < 0.1 * black
    assert abs(found.white[0, 0] - white) < 4.5 * found.white_standard_error[0, 0] < 0.1 * white
    assert abs(found.index[0, 0] - black / white) < 4.5 * found.standard_error[0, 0] < 0.15 * black / white
    assert found.index[0, 0] == found.black[0, 0] / found.white[0, 0] and found.num_hits[0, 0] > 1000
    assert found.image_radius[0, 0] == pytest.approx(F * np.tan(np.radians(SPOT)), rel=0.02)
    assert found.region_radius[0, 0] == pytest.approx(0.2 * found.image_radius[0, 0]) and np.abs(found.centre).max() < 0.1


def test_the_error_of_the_index_is_that_of_its_parts() -> None:
    found = found_of(telescope())
    black, white = found.black, found.white
    bright = white - black
    error = np.hypot(bright * found.black_standard_error, black * np.sqrt(found.white_standard_error**2 - found.black_standard_error**2))
    assert found.standard_error == pytest.approx(error / white**2, rel=1e-6)


def test_the_parts_of_a_field_add_up() -> None:
    # A field with a small spot, and one with a large spot: without either the light is the same.
    options = {"num_rays": 400_000, "region": 0.2, "half_field_deg": 1.0}
    small, large = (found_of(telescope(), half_spot_deg=spot, **options) for spot in (0.15, 0.2))
    error = np.hypot(small.white_standard_error, large.white_standard_error)
    assert (np.abs(small.white - large.white) < 4.5 * error).all() and (error < 0.06 * small.white).all()


def test_a_spot_off_the_axis_has_its_image_there() -> None:
    scene = telescope()
    found = found_of(scene, angles_deg=[0.0, 0.3], azimuths_deg=[0.0, 90.0], half_field_deg=2.0, num_rays=50_000)
    shift = F * np.tan(np.radians(0.3))
    # A mirror images what lies towards +x on the side of -x.
    assert found.centre[1, 0] == pytest.approx([-shift, 0.0], abs=0.1) and found.centre[1, 1] == pytest.approx([0.0, -shift], abs=0.1)
    assert found.white == pytest.approx(np.full((2, 2), found.white[0, 0]), rel=0.2)
    assert found.index.shape == found.standard_error.shape == (2, 2) and found.centre.shape == (2, 2, 2)


def test_a_lens_of_an_optic_has_glare_of_ghosts() -> None:
    found = found_of(CookeTriplet(), half_spot_deg=3.0, half_field_deg=20.0, scatter_to=None, region=0.5, num_rays=100_000, guide=True)
    assert 0.0 < found.index[0, 0] < 0.2 and found.num_hits[0, 0] >= 3
    # The triplet has 50 mm of focal length and 1 : 5; bare faces lose a part of the light.
    assert 0.7 * np.pi * 0.01 < found.white[0, 0] < np.pi * 0.01
    assert found.image_radius[0, 0] == pytest.approx(50.0 * np.tan(np.radians(3.0)), rel=0.05)


def test_a_file_and_far_fields_around_the_scene_give_the_same(tmp_path: Path) -> None:
    scene = telescope()
    expected = found_of(scene, num_rays=20_000)
    nsq_gpu.export_scene(scene, tmp_path / "scene.json")
    assert np.array_equal(found_of(tmp_path / "scene.json", num_rays=20_000).index, expected.index)
    scene.add_detector("sky", cs(z=-500.0), FarFieldDetectorConfig(9, 12))
    assert found_of(scene, num_rays=20_000).white == pytest.approx(expected.white, rel=0.3)
    named = found_of(telescope(), "image", opening="beam", num_rays=20_000)
    by_numbers = found_of(telescope(), opening=((0, 0, -900), scene.sources[0].aperture_radius), num_rays=20_000)
    assert np.array_equal(named.index, expected.index) and np.array_equal(by_numbers.index, expected.index)
    assert scene.source_names == ["beam"]


def test_it_is_shown_and_tabulated() -> None:
    found = found_of(telescope(), angles_deg=[0.0, 0.1], num_rays=20_000)
    assert repr(found).startswith("Veiling glare on image: a black spot of 0.4 deg in a field of 10 deg\n") and "%" in repr(found)
    assert found.plot().get_ylabel() == "veiling glare index [%]"
    pytest.importorskip("xarray")
    frame, data = found.to_pandas(), found.to_xarray()
    assert list(frame["index"]) == list(found.index[:, 0]) and frame.attrs["units"]["black"] == "sr"
    assert data["index"].dims == ("angle", "azimuth") and data.attrs["half_field_deg"] == FIELD


def test_few_rays_are_warned_of() -> None:
    with pytest.warns(nsq_gpu.ResultWarning, match="in 1 of 1 directions fewer than 10 rays came into the image of the black spot"):
        nsq_gpu.veiling_glare(telescope(), half_spot_deg=SPOT, half_field_deg=FIELD, num_rays=5000, binary=live.binary())


@pytest.mark.parametrize("how", ["ctrl-c", "timeout"])
def test_a_stop_keeps_the_directions_that_are_done(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    put, calls = glare._put, []

    def stopped(*args: Any) -> None:
        calls.append(args)
        if len(calls) == 2:
            raise KeyboardInterrupt if how == "ctrl-c" else nsq_gpu.TraceTimeoutError("late")
        put(*args)

    monkeypatch.setattr(glare, "_put", stopped)
    with pytest.raises(nsq_gpu.Interrupted if how == "ctrl-c" else nsq_gpu.TraceTimeoutError) as caught:
        found_of(telescope(), angles_deg=[0.0, 0.1], num_rays=5000, timeout=600)
    partial = caught.value.partial
    assert partial.partial and np.isfinite(partial.index[0, 0]) and np.isnan(partial.index[1, 0]) and "1 of 2 directions" in repr(partial)


def test_a_timeout_ends_the_call() -> None:
    with pytest.raises(nsq_gpu.TraceTimeoutError, match="the glare took longer than timeout = 0.05 s and was ended"):
        found_of(telescope(), num_rays=10_000_000, timeout=0.05)


def test_progress_counts_both_traces_of_all_directions() -> None:
    seen: list[tuple[int, int]] = []
    found_of(telescope(), angles_deg=[0.0, 0.1], num_rays=5000, progress=lambda rays, num_rays, _: seen.append((rays, num_rays)))
    assert seen[-1] == (20_000, 20_000)


def two_detectors() -> NSQScene:
    scene = telescope()
    scene.add_detector("second", cs(z=-1100.0), IrradianceDetectorConfig(5.0, 5.0))
    return scene


def without_a_beam() -> NSQScene:
    scene = NSQScene()
    scene.add_lens("L", cs(), LensConfig(50.0, -50.0, 5.0, live.glass(), 12.0))
    scene.add_source("lamp", cs(z=-20.0), live.PointSourceConfig(spectrum=LINE))
    scene.add_detector("image", cs(z=50.0), IrradianceDetectorConfig(5.0, 5.0))
    return scene


@pytest.mark.parametrize(("scene", "options", "said"), [
    (telescope, {"half_spot_deg": 6.0}, "half_spot_deg is 6.0 and half_field_deg 5.0; give half-angles above 0"),
    (telescope, {"half_field_deg": 100.0}, "half_field_deg 100.0"),
    (telescope, {"region": 1.0}, "region is 1.0; give a number above 0 and up to 0.8"),
    (telescope, {"angles_deg": [90.0]}, "angles_deg is .*; give angles below 90"),
    (telescope, {"detector": "imag"}, "detector is 'imag', which is no irradiance detector of the scene; did you mean 'image'"),
    (two_detectors, {}, "name the detector, one of 'image', 'second'"),
    (telescope, {"opening": "bem"}, "opening is 'bem', which is no collimated source; did you mean 'beam'"),
    (telescope, {"opening": (0, 0, 1)}, r"opening is \(0, 0, 1\); give its middle and radius"),
    (without_a_beam, {}, "opening is None, and the scene has 0 collimated sources; give its middle and radius"),
    (int, {}, "scene_or_optic is 0; give Optiland's Optic, an NSQScene, or the path of its file"),
    (telescope, {"scatter_to": {"N": "image"}}, r"^scatter_to\[0\].surface: `N` is no surface"),
    (telescope, {"opening": ((500, 0, -900), 10.0)}, "no light of the spot at 0 degrees comes to 'image'"),
    (telescope, {"half_spot_deg": 1e-4}, "the image of the spot at 0 degrees has a radius of"),
])
def test_what_makes_no_sense_is_refused_by_name(scene: Any, options: dict[str, Any], said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=said):
        found_of(scene(), **{"num_rays": 2000, **options})
