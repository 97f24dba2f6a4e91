"""Live scenes for the tests of the backend and the exporter, and how their traces are compared.

The program is the one that ``nsq_gpu.find_binary`` finds, else the one that cargo built in ``../target``.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import optiland.backend as be
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import IdealMaterial
from optiland.nonsequential import NSQMaterial, NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import PointSourceConfig

from nsq_gpu import BinaryNotFoundError, NsqGpuBackend, find_binary
from tests import oracle, parity
from tests.agreement import Agreement, compare, compare_split
from tests.oracle import Json

T = TypeVar("T")
ROOT = Path(__file__).resolve().parents[2]
SCENES = sorted((ROOT / "scenes").glob("*.json"))
KINDS = {"IrradianceDetector": "irradiance", "SpectralDetector": "spectral", "FarFieldDetector": "far_field",
         "RayDatabaseDetector": "ray_database", "SphereFarField": "far_field"}
#: Largest difference of a recorded path's column, in units of its largest magnitude.
PATH_LIMIT = 1e-9


def in_turn(items: Iterable[T]) -> list[T]:
    """Return this run's third of some items, of two one: that of the number `NSQ_GPU_TURN`. Without it, or where it is `all`: all.

    As in tests/zoo/files.rs. `make test` counts commits, so three in a row take all.
    """
    turn, every = os.environ.get("NSQ_GPU_TURN", "all"), list(items)
    if turn == "all":
        return every
    turns = min(max(len(every), 1), 3)
    return [item for number, item in enumerate(every) if (number + number // turns) % turns == int(turn) % turns]


def same_rows(table: np.ndarray, other: np.ndarray) -> bool:
    """Whether two tables of paths have the same rows; what is not known is NaN, and the same in both."""
    fields = table.dtype.names or ()
    same = (np.array_equal(table[name], other[name], equal_nan=table[name].dtype.kind == "f") for name in fields)
    return table.shape == other.shape and all(same)


def binary() -> str:
    """Return the program under test."""
    try:
        return find_binary()
    except BinaryNotFoundError:
        target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
        return find_binary(target / "debug" / "nsq-gpu")


def backend(**options: Any) -> NsqGpuBackend:
    """Return the backend in float64, where it equals NumpyBackend ray by ray."""
    return NsqGpuBackend(**{"binary": binary(), "precision": "f64", **options})


@contextmanager
def quiet() -> Iterator[None]:
    """Hide warnings of Optiland, such as those of ambiguous glass names."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def load(path: Path) -> NSQScene:
    """Load a scene file as a live scene."""
    with quiet():
        return oracle.load_scene(path)


def load_uncapped(path: Path) -> NSQScene:
    """Load a scene file, its ray databases without their caps: which rows a cap keeps depends on the batches."""
    with quiet():
        return oracle.scene_from_dict(parity.uncapped(json.loads(path.read_text(encoding="utf-8"))))


def caps(path: Path) -> Json:
    """Return the ``max_rays`` of every capped ray database of a file."""
    return parity.caps(json.loads(path.read_text(encoding="utf-8")))


def kinds(scene: NSQScene) -> dict[str, str]:
    """Return the kind of every detector."""
    return {name: KINDS[type(live).__name__] for name, live in zip(scene.detector_names, scene.detectors, strict=True)}


def traced(scene: NSQScene, num_rays: int, which: Any, **options: Any) -> tuple[Any, Json]:
    """Trace a scene; return the result and all its figures."""
    with quiet():
        result = scene.trace(num_rays, backend=which, **options)
    return result, oracle.figures(scene, kinds(scene), result)


def agreement(ours: Json, theirs: Json, capped: Json | None = None) -> Agreement:
    """Compare two results in every figure, absorbers' counters included."""
    found = compare(ours, theirs, capped)
    found.count("absorbers", sorted(ours["absorbers"]), sorted(theirs["absorbers"]))
    for name in sorted(ours["absorbers"].keys() & theirs["absorbers"].keys()):
        counter = theirs["absorbers"][name]
        found.count(f"{name}: absorbed", ours["absorbers"][name]["num_rays"], counter["num_rays"])
        apart = abs(ours["absorbers"][name]["flux"] - counter["flux"]) / max(counter["flux"], 1e-3)
        found.note("total", f"{name}: absorbed flux", apart, 1e-11)
    mine, other = (figures["diagnostics"] for figures in (ours, theirs))
    if not capped:
        found.count("diagnostics: detectors", mine["detectors"], other["detectors"])
        # Their words hold rounded numbers, which two roundings of one figure may differ in.
        found.count("diagnostics: warnings", len(mine["warnings"]), len(other["warnings"]))
    return found


def assert_equals_numpy(scene: NSQScene, num_rays: int, **options: Any) -> Json:
    """Check that a scene gives the same figures either way, and return ours."""
    _, ours = traced(scene, num_rays, backend(), **options)
    _, theirs = traced(scene, num_rays, NumpyBackend(), **options)
    assert not (violations := agreement(ours, theirs).violations), violations
    return ours


def assert_agrees_with_numpy(scene: NSQScene, num_rays: int) -> Json:
    """Do likewise, but where rays are split, whose draws are their own on either side, over runs of several seeds."""
    if scene.sampling_policy.split_depth == 0:
        return assert_equals_numpy(scene, num_rays)
    runs = range(parity.STATISTICAL_RUNS)
    ours = [traced(scene, num_rays, backend(seed=seed))[1] for seed in runs]
    theirs = [traced(scene, num_rays, NumpyBackend(seed=parity.ORACLE_SEEDS + seed))[1] for seed in runs]
    assert not (violations := compare_split(ours, theirs).violations), violations
    return ours[0]


def same(one: Any, other: Any) -> bool:
    """Tell whether two results are the same to the last bit, the time that they took aside."""
    if isinstance(one, dict):
        keys = one.keys() - {"trace_time_sec"}
        return keys == other.keys() - {"trace_time_sec"} and all(same(one[key], other[key]) for key in keys)
    return np.array_equal(one, other) if isinstance(one, np.ndarray) else one == other


def sorted_paths(result: Any) -> np.ndarray:
    """Return recorded events by ray, in the order in which they happened."""
    events = result.ray_paths["events"]
    rank = np.select([events["event_type"] == "birth", events["event_type"] == "death"], [0, 2], 1)
    return events[np.lexsort((rank, events["bounce"], events["ray_id"]))]


def assert_same_paths(ours: Any, theirs: Any) -> None:
    """Check that both recorded the same events, in all twelve fields."""
    mine, other = sorted_paths(ours), sorted_paths(theirs)
    assert mine.dtype == other.dtype
    for key in ("ray_id", "event_type", "bounce", "component_name"):
        assert np.array_equal(mine[key], other[key]), key
    extent = max(np.abs(other[key]).max() for key in ("x", "y", "z"))
    scales = {**dict.fromkeys("xyz", extent), "flux": other["flux"].max()}
    for key in ("x", "y", "z", "L", "M", "N", "flux", "wavelength"):
        assert np.abs(mine[key] - other[key]).max() <= PATH_LIMIT * scales.get(key, 1.0), key


# Scenes built by hand


def cs(x: float = 0.0, y: float = 0.0, z: float = 0.0, **rotations: float) -> CoordinateSystem:
    return CoordinateSystem(x, y, z, **rotations)


def glass(n: float = 1.5, k: float = 0.0) -> NSQMaterial:
    return NSQMaterial(optiland_material=IdealMaterial(n=n, k=k))


def two_lines() -> Spectrum:
    return Spectrum(np.array([0.5, 0.6]), np.array([1.0, 2.0]))


def bench() -> NSQScene:
    """Return a scene of a wide source and a detector behind the place of what is tested, which is z = 0."""
    be.set_backend("numpy")
    be.set_precision("float64")
    scene = NSQScene()
    scene.add_source("lamp", cs(z=-20.0), PointSourceConfig(spectrum=two_lines(), half_angle_deg=35.0))
    scene.add_detector("screen", cs(z=30.0), IrradianceDetectorConfig(width=60.0, height=60.0, num_pixels_x=12,
                                                                      num_pixels_y=12))
    return scene
