"""The binary against TorchBackend in float64, live. ``make test-torch`` runs it; nothing else needs Torch."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import optiland.backend as be  # noqa: E402
from optiland.nonsequential.backends.torch_backend import TorchBackend  # noqa: E402
from optiland.nonsequential.bsdf import HarveyShackBSDF  # noqa: E402

from nsq_gpu.bsdf import ABg, KCorrelation  # noqa: E402
from tests import live, oracle, parity  # noqa: E402
from tests.conftest import ROOT  # noqa: E402
from tests.test_bsdf import lens_and_mirror  # noqa: E402
from tests.test_convert import pupil_scene  # noqa: E402

NUM_RAYS = 20_000
#: One of each shape, source, detector and finish but meshes, at which TorchBackend raises TypeError; it keeps every ray at
#: every bounce, so deep paths take minutes.
SCENES = [ROOT / "scenes" / f"{name}.json" for name in (
    "ball_lens_ghosts", "bench_lens", "coated_projector", "cooke_triplet", "filter_stack", "hubble_nasmyth",
    "integrating_sphere", "kaleidoscope", "lambertian_sphere", "nested_media", "newtonian_telescope", "opal_lamp",
    "scattering_telescope", "tessar_gaussian_beams", "triplet_telescope_ghosts")]
# Its threads spin while they wait, which starves a device in software on the same cores.
torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def numpy_afterwards() -> Iterator[None]:
    yield
    be.set_backend("numpy")


def trace_with_torch(document: oracle.Json) -> oracle.Json:
    # Built with NumPy: Optiland's check of a lens' volume fails where Torch is set.
    scene = oracle.scene_from_dict(parity.uncapped(document))
    be.set_backend("torch")
    # The default is float32, where traces are wrong without a word.
    be.set_precision("float64")
    with torch.no_grad():
        return oracle.trace(scene, oracle.detector_kinds(document), NUM_RAYS, backend=TorchBackend(seed=0))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("scene", SCENES, ids=lambda path: path.stem)
def test_ray_for_ray(scene: Path, command: list[str], report) -> None:
    theirs = trace_with_torch(json.loads(scene.read_text(encoding="utf-8")))
    options = argparse.Namespace(num_rays=NUM_RAYS, seed=0, precision="f64")
    report("torch", scene, parity.check_ray_for_ray(command, scene, theirs, options))


@pytest.mark.filterwarnings("ignore")
def test_shapes_and_sources_of_the_package() -> None:
    be.set_backend("numpy")
    scene = pupil_scene()
    found = scene.trace(5000, seed=3, backend=live.backend())
    ours = {name: np.array(detector.irradiance) for name, detector in found.detectors.items()}
    be.set_backend("torch")
    be.set_precision("float64")
    with torch.no_grad():
        theirs = scene.trace(5000, seed=3, backend=TorchBackend(seed=3))
    for name, expected in ours.items():
        assert expected.sum() > 0.0
        np.testing.assert_allclose(be.to_numpy(theirs.detectors[name].irradiance), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("bsdf", [ABg(0.01, 1e-3, 1.5, 0.4), KCorrelation(0.3, 12.0, 2.5, 0.4), KCorrelation(0.3, 12.0, 2.0)])
def test_scattering_laws_of_the_package(bsdf: HarveyShackBSDF) -> None:
    scene = lens_and_mirror(bsdf=bsdf, scatter_fraction=0.5)
    ours = np.array(scene.trace(5000, seed=3, backend=live.backend()).detectors["screen"].irradiance)
    be.set_backend("torch")
    be.set_precision("float64")
    with torch.no_grad():
        theirs = scene.trace(5000, seed=3, backend=TorchBackend(seed=3)).detectors["screen"].irradiance
    assert ours.sum() > 0.0
    np.testing.assert_allclose(be.to_numpy(theirs), ours, rtol=1e-9, atol=1e-12)
