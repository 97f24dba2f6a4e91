"""Media by table: linear between their wavelengths, as Optiland's are, and refused beyond them."""

from __future__ import annotations

import copy
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
import pytest
from optiland.materials.data import DataMaterial
from optiland.nonsequential import LensConfig, NSQMaterial, NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from nsq_gpu.export import export
from nsq_gpu.scene_file import TableMaterial, scene_from_dict
from tests import live
from tests.live import cs

#: A flint that is sampled at some wavelengths [um]; sources emit between those, and at the first and the last.
SAMPLES, INDICES, EXTINCTIONS = [0.45, 0.5, 0.57, 0.7], [1.6412, 1.6321, 1.6243, 1.6158], [2e-6, 1e-6, 0.0, 4e-6]
LINES = [0.45, 0.4861, 0.5461, 0.5876, 0.6563, 0.7]


def optilands() -> DataMaterial:
    extinction = {"kind": "tabulated_k", "wavelengths_um": SAMPLES, "values": EXTINCTIONS}
    return DataMaterial.from_samples(SAMPLES, INDICES, name="flint", extinction=extinction)


def scene(lines: list[float] = LINES) -> NSQScene:
    """Return a lens of a glass that Optiland has as a table."""
    glass = NSQMaterial(optiland_material=optilands())
    found = NSQScene()
    spectrum = Spectrum(np.array(lines), np.ones(len(lines)))
    found.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(spectrum, aperture_radius=8.0))
    found.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass, 12.0))
    found.add_detector("image", cs(z=40.0), IrradianceDetectorConfig(12.0, 12.0, 16, 16))
    return found


def by_table(shuffled: bool = False, **changes: Any) -> dict[str, Any]:
    """Return the scene's file with the table itself, not its values where the sources emit."""
    document = copy.deepcopy(export(scene()).document)
    [medium] = document["nsq_gpu"]["media"].values()
    order = [2, 0, 3, 1] if shuffled else [0, 1, 2, 3]
    medium.update({key: [values[i] for i in order] for key, values in
                   (("wavelengths", SAMPLES), ("n", INDICES), ("k", EXTINCTIONS))}, **changes)
    return document


@pytest.mark.parametrize("shuffled", [False, True], ids=["ascending", "shuffled"])
def test_a_table_in_a_file_is_between_its_wavelengths_what_optiland_interpolates(shuffled: bool) -> None:
    theirs, _ = live.traced(scene(), 5000, NumpyBackend(), seed=3)
    with nsq_gpu.Session(binary=live.binary(), precision="f64") as session:
        options = {"num_rays": 5000, "seed": 3, "max_depth": 16}
        ours = session.request(json.dumps(by_table(shuffled)), options).arrays("image")["irradiance"]
        exact = session.request(export(scene()).document, options).arrays("image")["irradiance"]
    # The exporter writes what Optiland interpolates.
    np.testing.assert_array_equal(ours, exact)
    np.testing.assert_allclose(ours, theirs.detectors["image"].irradiance, rtol=1e-9, atol=1e-15)
    assert ours.sum() > 0.0


def test_the_loaders_table_interpolates_as_optilands() -> None:
    table = TableMaterial(*([values[i] for i in (2, 0, 3, 1)] for values in (SAMPLES, INDICES, EXTINCTIONS)))
    theirs = optilands()
    asked = be.array(np.linspace(0.45, 0.7, 101))
    for which in ("n", "k"):
        one, other = (be.to_numpy(getattr(material, which)(asked)) for material in (table, theirs))
        np.testing.assert_array_equal(one, other)
    # Wavelengths in float32 are the same wavelengths.
    assert float(np.squeeze(be.to_numpy(table.n(float(np.float32(0.7)))))) == pytest.approx(INDICES[3], abs=1e-7)


@pytest.mark.parametrize("line", [0.44, 0.71])
def test_beyond_a_table_light_is_refused_by_name_and_wavelength_with_the_range(line: float) -> None:
    document = by_table()
    document["sources"][0]["spectrum"] = {"wavelengths": [line], "weights": [1.0]}
    [name] = document["nsq_gpu"]["media"]
    with nsq_gpu.Session(binary=live.binary()) as session, \
            pytest.raises(nsq_gpu.SceneError, match=rf"{name}.*no value at {line} um.*from 0.45 to 0.7 um"):
        session.request(json.dumps(document), {"num_rays": 10})
    loaded = scene_from_dict(document)
    said = rf"the medium '{name}': the table has no value at {line} um; it is from 0.45 to 0.7 um"
    with pytest.raises(ValueError, match=said):
        loaded.trace(10, backend=NumpyBackend())
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match=rf"no value at {line} um"):
        export(loaded)


def test_a_coarse_table_is_said_to_be_coarse() -> None:
    with nsq_gpu.Session(binary=live.binary()) as session:
        report = session.request(json.dumps(by_table()), {"num_rays": 10}).report
        exact = session.request(export(scene()).document, {"num_rays": 10}).report
    coarse = "n at 0.5461 um is interpolated between 0.5 and 0.57 um, where n differs by 7.8e-3"
    assert any(coarse in said for said in report["scene_warnings"])
    assert not any("interpolated" in said for said in exact["scene_warnings"])


def test_a_wavelength_has_no_derivative_where_a_medium_is_a_table(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_text(json.dumps(by_table()), encoding="utf-8")
    [name] = by_table()["nsq_gpu"]["media"]
    said = f"is a wavelength, and the medium \"{name}\" is a table.*nsq-gpu diff"
    which, ones = "beam.spectrum.wavelengths.1", {"image": np.ones((16, 16))}
    for given in (scene(), tmp_path / "scene.json"):
        with pytest.raises(nsq_gpu.UsageError, match=said):
            nsq_gpu.jacobian(given, [which], 100, binary=live.binary())
        with pytest.raises(nsq_gpu.UsageError, match=said):
            nsq_gpu.loss_gradient(given, which, ones, 100, binary=live.binary())
    # Other numbers have derivatives.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = nsq_gpu.jacobian(tmp_path / "scene.json", ["L.r1"], 2000, binary=live.binary())
    assert found["L.r1", "image"].map is not None
