"""Scattering that is drawn on purpose: the same light on average, smaller errors, files that carry it, and refusals by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.bsdf import LambertianBSDF
from optiland.nonsequential.components.configs import MirrorConfig, SurfaceConfig
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig, IrradianceDetectorConfig
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from nsq_gpu import cluster
from nsq_gpu.export import export
from nsq_gpu.scattering import keys_of
from tests import live
from tests.live import cs

#: A target of each form.
SPHERE = {"sphere": {"center": [0.0, 6.0, -50.0], "radius": 2.0}}
DISK = {"disk": {"center": [0.0, 6.0, -50.0], "normal": [0.0, 0.0, 1.0], "radius": 3.0}}
CONE = {"cone": {"axis": [0.0, 6.0, -50.0], "half_angle_deg": 4.0}}


def wall(share: float = 0.4) -> NSQScene:
    """Return a mirror that scatters a share of a beam, and a small detector beside the beam."""
    scene = NSQScene()
    surface = SurfaceConfig(reflectance=1.0, bsdf=LambertianBSDF(0.8), scatter_fraction=share)
    scene.add_mirror("wall", cs(), MirrorConfig(np.inf, 1.0, aperture_radius=10.0, surface=surface))
    scene.add_source("beam", cs(z=-60.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=2.0))
    scene.add_detector("image", cs(y=6.0, z=-50.0), IrradianceDetectorConfig(3.0, 3.0, 1, 1))
    scene.add_detector("sky", cs(z=-100.0), FarFieldDetectorConfig(9, 12))
    return scene


def flux(scene: NSQScene, num_rays: int, **options: Any) -> tuple[float, float]:
    """Return the flux on the small detector, and its standard error [W]."""
    with live.quiet():
        found = scene.trace(num_rays, seed=4, backend=live.backend(standard_error=True, **options)).detectors["image"]
    return found.total_flux, found.total_flux_standard_error


@pytest.fixture(scope="module")
def plain() -> tuple[float, float]:
    return flux(wall(), 400_000)


@pytest.mark.parametrize("options", [
    {"scatter_prob": 0.9},
    {"scatter_prob": {"wall*": 0.9}},
    {"scatter_to": {"wall*": "image"}},
    {"scatter_to": [{"surface": "wall.surface", "target": "image", "share": 0.9}]},
    {"scatter_to": {"*": SPHERE}, "scatter_prob": 0.8},
    {"scatter_to": {"*": DISK}},
    {"scatter_to": {"*": CONE}},
], ids=str)
def test_the_light_is_that_of_plain_rays(options: dict[str, Any], plain: tuple[float, float]) -> None:
    found, error = flux(wall(), 50_000, **options)
    assert abs(found - plain[0]) < 4.5 * np.hypot(error, plain[1])
    if "scatter_to" in options and options["scatter_to"] != {"*": CONE}:
        # An eighth of the rays.
        assert error < plain[1]


def test_the_closed_form_of_a_lambertian_wall() -> None:
    found, error = flux(wall(), 100_000, scatter_to={"wall*": "image"}, scatter_prob=0.9)
    # cos cos / (pi r^2) from each place of the beam to each of the detector.
    x, y = np.meshgrid(np.linspace(-2.0, 2.0, 41), np.linspace(-2.0, 2.0, 41))
    starts = np.stack([x, y], axis=-1)[x**2 + y**2 <= 4.0]
    u = (np.arange(21) + 0.5) / 7.0 - 1.5
    ends = np.stack(np.meshgrid(u, u + 6.0), axis=-1).reshape(-1, 2)
    squares = ((starts[:, None] - ends) ** 2).sum(axis=-1) + 50.0**2
    assert abs(found - 0.4 * 0.8 * 9.0 * (50.0**2 / (np.pi * squares**2)).mean()) < 4.5 * error < 0.02 * found


def test_sessions_sweeps_and_long_traces_take_it_as_well(monkeypatch: pytest.MonkeyPatch, plain: tuple[float, float]) -> None:
    given = {"scatter_to": {"wall*": "image"}, "scatter_prob": 0.7}
    expected = flux(wall(), 20_000, **given)
    with nsq_gpu.Session(binary=live.binary(), precision="f64") as session, live.quiet():
        found = session.trace(wall(), 20_000, seed=4, standard_error=True, **given)
        swept = session.sweep(wall(), {"beam.total_flux": [1.0, 2.0]}, 20_000, seed=4, **given)
    assert found.detectors["image"].total_flux == expected[0]
    assert swept.flux["image"] == pytest.approx([expected[0], 2.0 * expected[0]], rel=1e-9)
    assert json.loads(found.scene_json)["nsq_gpu"]["sampling"]["scatter_prob"] == 0.7
    monkeypatch.setattr(nsq_gpu.backend, "MOST_SESSION_RAYS", 0)
    assert flux(wall(), 20_000, **given) == expected


def test_a_cluster_takes_it_as_well() -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is not installed")
    given = {"scatter_to": {"wall*": SPHERE}, "scatter_prob": 0.7}
    with nsq_gpu.Session(binary=live.binary(), precision="f64") as session, live.quiet():
        expected = session.trace(wall(), 20_000, seed=4, strict="on", **given).detectors["image"].total_flux
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as local, \
            distributed.Client(local) as client, live.quiet():
        found = cluster.trace(wall(), 20_000, client, 2, seed=4, precision="f64", binary=live.binary(), **given)
        with pytest.raises(nsq_gpu.UsageError, match=r"^scatter_to\[0\].target: `imge` is no detector"):
            cluster.trace(wall(), 20_000, client, 2, binary=live.binary(), scatter_to={"*": "imge"})
    assert found.detectors["image"].total_flux == expected


# Scenes and files


def test_a_scene_says_it_and_files_carry_it(tmp_path: Path, plain: tuple[float, float]) -> None:
    scene = wall()
    scene.scatter_prob = {"wall*": 0.9}
    scene.scatter_to = [{"surface": "wall*", "target": "image", "share": 0.6}, {"surface": "*", "target": SPHERE}]
    path = tmp_path / "scene.json"
    # Shares of one surface add up to less than 1.
    scene.scatter_to[1]["share"] = 0.2
    nsq_gpu.export_scene(scene, path)
    sampling = json.loads(path.read_text())["nsq_gpu"]["sampling"]
    assert sampling == {"scatter_prob": scene.scatter_prob, "scatter_to": scene.scatter_to}
    again = nsq_gpu.load_scene(path)
    assert (again.scatter_prob, again.scatter_to) == (scene.scatter_prob, scene.scatter_to)
    assert export(again).document["nsq_gpu"]["sampling"] == sampling
    assert again.sampling_policy == SamplingPolicy()
    found, error = flux(again, 20_000)
    assert abs(found - plain[0]) < 4.5 * np.hypot(error, plain[1]) and error < 0.05 * found


def test_an_argument_takes_the_place_of_the_scene_s_own() -> None:
    scene = wall()
    scene.scatter_prob, scene.scatter_to = 0.9, {"wall*": "image"}
    scene.guided_light = None

    def sampling(**options: Any) -> Any:
        with live.quiet():
            text = scene.trace(1000, backend=live.backend(**options)).scene_json
        return json.loads(text).get("nsq_gpu", {}).get("sampling")

    own = {"scatter_prob": 0.9, "scatter_to": [{"surface": "wall*", "target": "image"}]}
    assert sampling() == own
    assert sampling(scatter_prob=0.5) == own | {"scatter_prob": 0.5}
    assert sampling(scatter_to=[]) == {"scatter_prob": 0.9}
    assert sampling(scatter_to=[], scatter_prob={}) is None


# Refusals


@pytest.mark.parametrize(("options", "said"), [
    ({"scatter_prob": 1.0}, "scatter_prob: the probability 1 leaves one branch undrawn; give a number between 0 and 1"),
    ({"scatter_prob": {"wal": 0.5}}, "scatter_prob: `wal` is no surface; these scatter: `wall.surface`"),
    ({"scatter_to": {"wall*": "imge"}}, r"scatter_to\[0\].target: `imge` is no detector and no surface; the detectors are `image`"),
    ({"scatter_to": {"mall*": "image"}}, r"scatter_to\[0\].surface: `mall\*` is no surface; these scatter: `wall.surface`"),
    ({"scatter_to": [{"surface": "*", "target": "image", "share": 1.5}]}, r"scatter_to\[0\].share: the share 1.5 is none between 0 and 1"),
    ({"scatter_to": {"*": {"sphere": {"center": [0, 0, 0], "radius": 0}}}}, r"scatter_to\[0\].target: the shape is none; a sphere has"),
])
def test_what_makes_no_sense_in_the_scene_is_refused_by_the_argument(options: dict[str, Any], said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=f"^{said}"):
        wall().trace(1000, backend=live.backend(**options))
    with nsq_gpu.Session(binary=live.binary()) as session:
        with pytest.raises(nsq_gpu.UsageError, match=f"^{said}"):
            session.trace(wall(), 1000, **options)
        with pytest.raises(nsq_gpu.UsageError, match=f"^{said}"):
            session.sweep(wall(), {"beam.total_flux": [1.0]}, 1000, **options)


def test_what_a_scene_itself_says_is_refused_as_that_of_the_scene() -> None:
    scene = wall()
    scene.scatter_to = {"wall*": "imge"}
    with pytest.raises(nsq_gpu.SceneError, match=r"nsq_gpu.sampling.scatter_to\[0\].target: `imge`"):
        scene.trace(1000, backend=live.backend(scatter_prob=0.5))


@pytest.mark.parametrize(("options", "said"), [
    ({"scatter_prob": "0.5"}, "scatter_prob is '0.5'; give a number between 0 and 1, such as 0.5, or numbers by surface"),
    ({"scatter_prob": True}, "scatter_prob is True; give a number"),
    ({"scatter_prob": {1: 0.5}}, "scatter_prob is {1: 0.5}"),
    ({"scatter_prob": {"M1": None}}, r"scatter_prob\['M1'\] is None"),
    ({"scatter_to": "image"}, "scatter_to is 'image'; give targets by surface"),
    ({"scatter_to": {"surface": "M1", "target": "image"}}, "scatter_to is one entry, .*; give a list of it"),
    ({"scatter_to": ["image"]}, r"scatter_to\[0\] is 'image'; give targets"),
    ({"scatter_to": [{"surface": "M1", "target": "image", "part": 1}]}, r"scatter_to\[0\] has 'part'; an entry has surface, target"),
    ({"scatter_to": [{"surface": 1, "target": "image"}]}, r"scatter_to\[0\]: surface is 1; give a name"),
    ({"scatter_to": {"M1": 3}}, r"scatter_to\[0\]: target is 3; give the name of a detector or a surface, or one shape"),
    ({"scatter_to": {"M1": {**SPHERE, **CONE}}}, r"scatter_to\[0\]: target is .*one shape"),
    ({"scatter_to": {"M1": {"sphere": {"center": [0, 0, 0]}}}}, r"scatter_to\[0\]: target: sphere is .*; it has center, radius"),
    ({"scatter_to": {"M1": {"sphere": {"center": 3, "radius": 1}}}}, "sphere: center is 3; give three numbers"),
    ({"scatter_to": [{"surface": "M1", "target": "image", "share": "half"}]}, "share is 'half'; give a number"),
], ids=str)
def test_what_has_another_form_is_refused_before_a_trace(options: dict[str, Any], said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=f"^{said}" if said.startswith("scatter") else said):
        nsq_gpu.NsqGpuBackend(**options)


def test_numbers_of_numpy_will_do() -> None:
    keys = keys_of(np.float32(0.5), {"M1": {"sphere": {"center": np.zeros(3), "radius": np.int64(2)}}})
    assert json.loads(json.dumps(keys)) == {"scatter_prob": 0.5, "scatter_to": [
        {"surface": "M1", "target": {"sphere": {"center": [0.0, 0.0, 0.0], "radius": 2.0}}}]}


def test_a_gradient_takes_plain_rays() -> None:
    torch = pytest.importorskip("torch", reason="Torch is not installed")
    try:
        be.set_backend("torch")
        be.set_precision("float64")
        scene = wall()
        scene.sources[0].total_flux = torch.tensor(1.0, requires_grad=True)
        backend = live.backend(scatter_to={"wall*": "image"}, check_edges=False)
        with live.quiet():
            total = scene.trace(200_000, backend=backend).detectors["image"].data.sum()
            total.backward()
        # The flux is a factor of all light; about 70 plain rays come.
        assert float(scene.sources[0].total_flux.grad) == pytest.approx(total.item(), rel=0.6)
    finally:
        be.set_backend("numpy")
