"""The backend against NumpyBackend, and its conduct towards the program that it runs."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import math
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
import time
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import matplotlib
import numpy as np
import pytest
from optiland.nonsequential import LensConfig, MirrorConfig, NSQScene
from optiland.nonsequential.backends.base import TracerBackend
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.convert import sequential_to_nonsequential
from optiland.nonsequential.detectors.configs import (
    FarFieldDetectorConfig,
    RayDatabaseConfig,
    SpectralDetectorConfig,
)
from optiland.nonsequential.sources.configs import CollimatedSourceConfig, PointSourceConfig
from optiland.nonsequential.units import to_photometric
from optiland.samples.objectives import CookeTriplet

import nsq_gpu
from nsq_gpu import compare
from tests import live, parity
from tests.live import SCENES, agreement, assert_equals_numpy, assert_same_paths, backend, bench, cs, glass, in_turn, traced
from tests.oracle import Json

matplotlib.use("Agg")
NUM_RAYS = 4000

posix_only = pytest.mark.skipif(os.name == "nt", reason="the stand-ins for the program are shell scripts")


def side(name: str, scene: NSQScene, result: Any, figures: Json) -> compare.Side:
    hits = {detector: found["num_rays_hit"] for detector, found in figures["detectors"].items()}
    return compare.Side(name, result, hits, 1.0, 1.0, splits=scene.sampling_policy.split_depth > 0)


@pytest.mark.parametrize("path", in_turn(SCENES), ids=lambda path: path.stem)
def test_equals_numpy(path: Path) -> None:
    scene, capped = live.load(path), live.caps(path)
    result, ours = traced(scene, NUM_RAYS, backend(), record_paths=300)
    reference, theirs = traced(live.load_uncapped(path), NUM_RAYS, NumpyBackend(), record_paths=300)
    if parity.is_chaotic(path):
        sides = side("ours", scene, result, ours), side("theirs", scene, reference, theirs)
        text, agrees = compare.verdict(*sides, statistical=True)
        assert agrees, text
        return
    assert not agreement(ours, theirs, capped).violations
    assert_same_paths(result, reference)
    for name, detector in scene.detector_registry._registry.items():
        assert type(result.detectors[name]) is type(reference.detectors[name])
        # Standard errors, lux and the like are of results alone.
        for key, value in vars(detector.get_result()).items():
            assert np.array_equal(np.asarray(getattr(result.detectors[name], key)), np.asarray(value)), (name, key)


def all_detectors() -> NSQScene:
    """Return a scene of every kind of detector, one behind the other, and one that nothing reaches."""
    scene = bench()
    scene.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass(), 10.0))
    spectral = SpectralDetectorConfig(40.0, 40.0, 8, 8, wl_min=0.45, wl_max=0.65, num_bins=4, absorb=False)
    scene.add_detector("colours", cs(z=10.0), spectral)
    scene.add_detector("rays", cs(z=12.0), RayDatabaseConfig(40.0, 40.0, absorb=False))
    scene.add_detector("sky", cs(z=14.0), FarFieldDetectorConfig(18, 36, absorb=False))
    scene.add_detector("nobody", cs(z=-900.0), RayDatabaseConfig(1.0, 1.0))
    return scene


def test_every_kind_of_detector() -> None:
    assert_equals_numpy(all_detectors(), NUM_RAYS)


def test_private_state_of_detectors_is_as_numpy_leaves_it() -> None:
    ours, theirs = all_detectors(), all_detectors()
    traced(ours, NUM_RAYS, backend())
    traced(theirs, NUM_RAYS, NumpyBackend())
    for mine, other in zip(ours.detectors, theirs.detectors, strict=True):
        for key, value in vars(other).items():
            if key in ("cs", "geometry"):
                continue
            got = getattr(mine, key)
            if isinstance(value, list):
                assert sum(map(len, got)) == sum(map(len, value)), key
            elif isinstance(value, np.ndarray):
                assert got.shape == value.shape and got.dtype == value.dtype, key
                assert np.allclose(got, value, rtol=1e-9, atol=1e-12 * max(np.abs(value).max(), 1e-30)), key
            else:
                assert got == pytest.approx(value), key


def test_a_capped_live_database_is_as_numpy_leaves_it() -> None:
    """Which rows a cap keeps depends on the batches; how many, and the flux of all, do not."""
    capped = [], []
    for scenes, which in zip(capped, (backend(), NumpyBackend()), strict=True):
        scene = bench()
        scene.add_detector("rays", cs(z=12.0), RayDatabaseConfig(40.0, 40.0, max_rays=100, absorb=False))
        result, _ = traced(scene, NUM_RAYS, which)
        live_one = scene.detector_registry.get("rays")
        scenes.extend((live_one._num_rays_hit, live_one._total_flux, sum(map(len, live_one._x)), live_one.max_rays,
                       result.detectors["rays"].total_flux, float(live_one.get_result().flux.sum())))
    ours, theirs = capped
    assert ours[2] == 100 and ours[0] > 3000 and ours[1] > 10.0 * ours[4]
    assert ours == pytest.approx(theirs, rel=1e-11)


def test_a_second_trace_starts_from_nothing() -> None:
    scene = all_detectors()
    _, once = traced(scene, NUM_RAYS, backend())
    _, twice = traced(scene, NUM_RAYS, backend())
    assert not agreement(twice, once).violations


def test_is_a_backend_of_optiland_and_its_result_works_on() -> None:
    with live.quiet():
        scene = sequential_to_nonsequential(CookeTriplet(), detector_pixels=(40, 30))
    assert isinstance(backend(), TracerBackend)
    result, ours = traced(scene, NUM_RAYS, backend(), record_paths=50)
    _, theirs = traced(scene, NUM_RAYS, NumpyBackend())
    assert not agreement(ours, theirs).violations
    assert "NSQ trace diagnostics" in result.report()
    image = next(iter(result.detectors.values()))
    assert image.plot() is not None
    assert np.array_equal(np.asarray(image.data).shape, (image.irradiance.size,))
    with live.quiet():
        scene.view(result)


def test_the_example_of_the_readme_runs(capsys: pytest.CaptureFixture[str]) -> None:
    readme = (live.ROOT / "README.md").read_text(encoding="utf-8")
    example = readme.split("```python\n")[2].split("```")[0]
    names: dict[str, Any] = {}
    with mock.patch.dict(os.environ, {"NSQ_GPU_BINARY": live.binary()}), live.quiet():
        exec(compile(example.replace("1_000_000", "2_000"), "README.md", "exec"), names)
    assert "NSQ trace diagnostics" in capsys.readouterr().out
    assert names["result"].detectors["image"].total_flux > 0.3


def test_the_readme_shows_a_lens_and_its_ghosts(capsys: pytest.CaptureFixture[str]) -> None:
    example = (live.ROOT / "README.md").read_text(encoding="utf-8").split("```python\n")[1].split("```")[0]
    names: dict[str, Any] = {}
    with mock.patch.dict(os.environ, {"NSQ_GPU_BINARY": live.binary()}), live.quiet():
        exec(compile(example.replace("10_000_000", "20_000"), "README.md", "exec"), names)
    assert "surface 11: L4.back" in capsys.readouterr().out
    # By ten million rays 0.06386 W of 3 W launched; by so few rays the standard error is 5 %.
    assert names["result"].detectors["image"].total_flux == pytest.approx(0.06386, rel=0.15)


def test_to_photometric() -> None:
    scene = all_detectors()
    result, _ = traced(scene, NUM_RAYS, backend())
    reference, _ = traced(scene, NUM_RAYS, NumpyBackend())
    for name, wavelength in (("screen", 0.55), ("colours", None)):
        ours, theirs = (to_photometric(found.detectors[name], wavelength_um=wavelength)
                        for found in (result, reference))
        assert ours.total == pytest.approx(theirs.total, rel=1e-11)


def test_seeds() -> None:
    scene = bench()

    def flux(which: nsq_gpu.NsqGpuBackend, **options: int) -> bytes:
        return traced(scene, 500, which, **options)[0].detectors["screen"].irradiance.tobytes()

    assert flux(backend(seed=7)) == flux(backend(), seed=7) == flux(backend(seed=3), seed=7)
    assert flux(backend()) == flux(backend(seed=0)) != flux(backend(seed=7))
    # Optiland keys its draws by the seed modulo 2^64.
    assert flux(backend(seed=-1)) == flux(backend(seed=(1 << 64) - 1))
    _, theirs = traced(scene, 500, NumpyBackend(), seed=7)
    _, ours = traced(scene, 500, backend(seed=7))
    assert not agreement(ours, theirs).violations


def test_limits_reach_the_tracer() -> None:
    scene = bench()
    scene.add_mirror("M", cs(z=20.0), MirrorConfig(0.0, 0.9))
    scene.add_mirror("N", cs(z=-30.0), MirrorConfig(0.0, 0.9, aperture_radius=60.0))
    assert_equals_numpy(scene, NUM_RAYS, max_depth=2)
    assert_equals_numpy(scene, NUM_RAYS, min_flux_fraction=0.95)


def test_paths_are_recorded_as_asked() -> None:
    scene = bench()
    for asked in (True, 40, False, 0):
        ours, _ = traced(scene, 300, backend(), record_paths=asked)
        theirs, _ = traced(scene, 300, NumpyBackend(), record_paths=asked)
        if not asked:
            assert ours.ray_paths is None and theirs.ray_paths is None
        else:
            assert_same_paths(ours, theirs)


@pytest.mark.parametrize("names", [("a/b", "a\\b"), ("Det 1: focus", "why?"), ("Image", "image"), ("..", "."), ("con", ""),
                                   (" D ", "a\tb"), ("y" * 100 + "1", "y" * 100 + "2"), ("report", "ray_paths"),
                                   ("d\u00e9tecteur \U0001f4a1", "-n")], ids=repr)
def test_names_are_those_of_optiland(names: tuple[str, str]) -> None:
    def build() -> NSQScene:
        scene = bench()
        for index, name in enumerate(names):
            scene.add_source(f"lamp {name}", cs(z=-40.0 - index), live.PointSourceConfig(live.two_lines(), half_angle_deg=20.0))
            scene.add_detector(name, cs(z=20.0 + index), live.IrradianceDetectorConfig(40.0, 40.0, 4, 5, absorb=False))
            scene.add_mirror(f"mirror {name}", cs(z=300.0 + index), MirrorConfig(0.0, 0.9))
        return scene

    scene, numpys = build(), build()
    ours = scene.trace(500, seed=3, record_paths=True, backend=backend())
    theirs = numpys.trace(500, seed=3, record_paths=True, backend=NumpyBackend())
    assert list(ours.detectors) == list(theirs.detectors)
    for name in names:
        np.testing.assert_allclose(ours.detectors[name].data, theirs.detectors[name].data, rtol=1e-9, atol=1e-15)
    assert_same_paths(ours, theirs)


def test_paths_tell_detectors_from_surfaces() -> None:
    scene = bench()
    scene.add_mirror("M", cs(z=25.0), MirrorConfig(0.0, 0.9))
    part = scene.component_registry.get("M").surfaces[0]
    scene.remove_component("M")
    scene.add_component("screen", part)
    traced(scene, 300, backend())
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="'screen'.*rename"):
        scene.trace(300, backend=backend(), record_paths=True)


def test_report_of_the_program_is_kept() -> None:
    which = backend()
    traced(bench(), 300, which)
    assert which.report is not None and which.report["precision"] == "f64" and "ledger" in which.report


def test_precision_and_sampler_are_checked_at_once() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="f16.*auto, f32, f64"):
        nsq_gpu.NsqGpuBackend(precision="f16")
    with pytest.raises(nsq_gpu.UsageError, match="halton.*pcg, sobol"):
        nsq_gpu.NsqGpuBackend(sampler="halton")


def test_whole_numbers_are_whole_and_choices_are_choices() -> None:
    scene = bench()
    assert backend().trace(scene, 1e3).num_rays_total == 1000  # type: ignore[arg-type]
    for wrong in ({"num_rays": 1.5}, {"num_rays": np.inf}, {"num_rays": 9, "seed": 1.5}, {"num_rays": 9, "max_depth": "2"}):
        with pytest.raises(nsq_gpu.UsageError, match=r"is (\d\.5|inf|'2'); give a whole number"):
            backend().trace(scene, **wrong)
    with pytest.raises(nsq_gpu.UsageError, match="standard_error is 'yes'"):
        nsq_gpu.NsqGpuBackend(standard_error="yes")  # type: ignore[arg-type]


@posix_only
def test_a_program_that_is_another_is_named(tmp_path: Path) -> None:
    with pytest.raises(nsq_gpu.NsqGpuError, match="ended without an error, and without a result: is it nsq-gpu"):
        bench().trace(10, backend=backend(binary=script(tmp_path, "exit 0")))


def test_sobol_points_are_drawn_where_they_are_asked_for() -> None:
    expected = traced(bench(), 100_000, backend())[0].detectors["screen"].total_flux
    for sampler, limit in (("pcg", 0.05), ("sobol", 0.005)):
        which = backend(sampler=sampler)
        result, _ = traced(bench(), NUM_RAYS, which)
        assert which.report is not None and which.report["sampler"] == sampler
        assert result.detectors["screen"].total_flux == pytest.approx(expected, rel=limit)


# Progress


def test_progress_calls_back() -> None:
    seen: list[tuple[int, int, float]] = []
    traced(bench(), 3000, backend(progress=lambda *update: seen.append(update)))
    assert seen and seen[-1][:2] == (3000, 3000) and seen[-1][2] > 0.0
    assert [rays for rays, _, _ in seen] == sorted(rays for rays, _, _ in seen)


def test_progress_draws_a_bar() -> None:
    with mock.patch("sys.stderr", io.StringIO()) as stream:
        traced(bench(), 3000, backend(progress=True))
    assert "3.00k of 3.00k rays" in stream.getvalue() and stream.getvalue().endswith("\r")


def test_progress_bar_shows_the_error() -> None:
    with mock.patch("sys.stderr", io.StringIO()) as stream:
        traced(bench(), 10**7, backend(progress=True, target_error=0.5))
    assert "error" in stream.getvalue()


# Errors


def test_results_carry_standard_errors() -> None:
    scene = all_detectors()
    result, _ = traced(scene, NUM_RAYS, backend(standard_error=True))
    maps = {"screen": "irradiance", "colours": "irradiance", "sky": "intensity"}
    for name, key in maps.items():
        found = result.detectors[name]
        values = np.asarray(getattr(found, key))
        assert found.standard_error.shape == values.shape
        assert np.all((found.standard_error > 0.0) == (values > 0.0))
        assert 0.0 <= found.total_flux_standard_error < 0.1
    assert result.detectors["rays"].standard_error is None
    assert result.detectors["rays"].total_flux_standard_error is not None


def test_results_without_standard_errors_say_so() -> None:
    result, _ = traced(bench(), NUM_RAYS, backend(standard_error=False))
    assert result.detectors["screen"].standard_error is None
    assert result.detectors["screen"].total_flux_standard_error is None


def test_target_and_time_limit() -> None:
    result, _ = traced(bench(), 10**8, backend(target_error=0.5))
    assert result.num_rays_total < 10**8
    assert result.total_flux_in == pytest.approx(bench().sources[0].total_flux)
    with pytest.warns(nsq_gpu.ToleranceWarning, match="above the target") as caught:
        bench().trace(1000, backend=backend(target_error=1e-9))
    assert [warning.filename for warning in caught if warning.category is nsq_gpu.ToleranceWarning] == [__file__]
    which = backend(time_limit=0.3)
    result = bench().trace(10**13, backend=which)
    assert 0 < result.num_rays_total < 10**13
    assert which.report is not None and which.report["stopped_by"] == "time_limit"


# Failures


def script(folder: Path, body: str) -> str:
    """Write a stand-in for the program; it leaves its process id in the file ``pid``."""
    path = folder / "nsq-gpu"
    path.write_text(f"#!/bin/sh\necho $$ > {folder}/pid\n{body}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def assert_child_is_gone(folder: Path) -> None:
    pid = int((folder / "pid").read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@posix_only
def test_timeout_ends_the_child(tmp_path: Path) -> None:
    start = time.monotonic()
    with pytest.raises(nsq_gpu.TraceTimeoutError, match="timeout = 2 s"):
        bench().trace(100, backend=backend(binary=script(tmp_path, "exec sleep 60"), timeout=2))
    assert time.monotonic() - start < 10.0
    assert_child_is_gone(tmp_path)


def test_timeout_ends_the_real_program() -> None:
    with pytest.raises(TimeoutError):
        live.load(SCENES[0]).trace(10**12, backend=backend(timeout=2.0))


class _SlowToStart(subprocess.Popen[str]):
    """A child that runs long before the one who started it is told so."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        time.sleep(0.5)


@posix_only
@pytest.mark.parametrize("popen", [subprocess.Popen, _SlowToStart], ids=["running", "starting"])
def test_interrupt_ends_the_child(tmp_path: Path, popen: type) -> None:
    def interrupt() -> None:
        _eventually(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    # A script run in the background inherits a handler that ignores SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with mock.patch("subprocess.Popen", popen), pytest.raises(KeyboardInterrupt):
            bench().trace(100, backend=backend(binary=script(tmp_path, "exec sleep 60")))
    finally:
        signal.signal(signal.SIGINT, before)
    assert_child_is_gone(tmp_path)


def _is_running(pid: int) -> bool:
    """Tell whether a process runs; one that ended and that nobody has waited for does not."""
    said = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout.strip()
    return bool(said) and not said.startswith("Z")


@posix_only
@pytest.mark.skipif(shutil.which("ps") is None, reason="ps tells which processes run")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL], ids=["SIGTERM", "SIGKILL"])
def test_the_real_program_ends_with_the_process_that_traces(tmp_path: Path, how: signal.Signals) -> None:
    program = script(tmp_path, f'exec {live.binary()} "$@"')
    text = ("import sys; from tests import live; "
            "live.load(live.SCENES[0]).trace(10**15, backend=live.backend(binary=sys.argv[1]))")
    # What dies at once leaves its scene where temporary files lie.
    parent = subprocess.Popen([sys.executable, "-c", text, program], cwd=live.ROOT / "python",
                              env=os.environ | {"TMPDIR": str(tmp_path)})
    try:
        child = _eventually(lambda: int((tmp_path / "pid").read_text()) if (tmp_path / "pid").exists() else None)
        assert _is_running(child)
    finally:
        parent.send_signal(how)
        parent.wait()
    assert _eventually(lambda: not _is_running(child))


@posix_only
@pytest.mark.skipif(shutil.which("ps") is None, reason="ps tells which processes run")
def test_the_real_program_ends_though_a_fork_lives_on(tmp_path: Path) -> None:
    program = script(tmp_path, f'exec {live.binary()} "$@"')
    # The fork has the pipe to the program's stdin open as well.
    text = """if True:
        import os, pathlib, sys, threading, time
        from tests import live
        folder = pathlib.Path(sys.argv[2])
        def fork():
            while not (folder / "pid").exists():
                time.sleep(0.01)
            time.sleep(1.0)
            fork = os.fork()
            if fork == 0:
                time.sleep(600.0)
                os._exit(0)
            (folder / "fork").write_text(str(fork))
        threading.Thread(target=fork, daemon=True).start()
        live.load(live.SCENES[0]).trace(10**15, backend=live.backend(binary=sys.argv[1]))"""
    parent = subprocess.Popen([sys.executable, "-c", text, program, str(tmp_path)], cwd=live.ROOT / "python",
                              env=os.environ | {"TMPDIR": str(tmp_path)})
    fork = child = None
    try:
        fork = _eventually(lambda: int((tmp_path / "fork").read_text()) if (tmp_path / "fork").exists() else None)
        child = int((tmp_path / "pid").read_text())
        assert _is_running(child)
        parent.kill()
        parent.wait()
        assert _is_running(fork)
        assert _eventually(lambda: not _is_running(child))
    finally:
        parent.kill()
        for left in (fork, child):
            if left is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(left, signal.SIGKILL)


def _eventually(found: Callable[[], Any]) -> Any:
    """Return what is found as soon as something is, within a minute."""
    for _ in range(6000):
        with contextlib.suppress(ValueError):
            if value := found():
                return value
        time.sleep(0.01)
    raise AssertionError("it never came")


@posix_only
def test_an_exception_of_the_callback_ends_the_child(tmp_path: Path) -> None:
    def refuse(*update: float) -> None:
        raise ValueError("enough")

    said = """echo '{"rays": 1, "num_rays": 2, "rays_per_sec": 3.0, "eta_sec": 1.0}' >&2; exec sleep 60"""
    with pytest.raises(ValueError, match="enough"):
        bench().trace(10**7, backend=backend(binary=script(tmp_path, said), progress=refuse))
    assert_child_is_gone(tmp_path)


@posix_only
@pytest.mark.parametrize(("code", "expected"), [
    (1, nsq_gpu.NsqGpuError), (2, nsq_gpu.UsageError), (3, nsq_gpu.SceneError), (4, nsq_gpu.AdapterError),
    (5, nsq_gpu.DeviceError), (130, nsq_gpu.NsqGpuError),
])
def test_exit_codes_become_exceptions(tmp_path: Path, code: int, expected: type) -> None:
    program = script(tmp_path, f"echo 'error: it broke' >&2; exit {code}")
    with pytest.raises(nsq_gpu.NsqGpuError, match="^nsq-gpu: it broke$") as caught:
        bench().trace(100, backend=backend(binary=program))
    assert type(caught.value) is expected and caught.value.exit_code == code


@posix_only
def test_a_killed_program_is_named(tmp_path: Path) -> None:
    with pytest.raises(nsq_gpu.NsqGpuError, match="signal 9") as caught:
        bench().trace(100, backend=backend(binary=script(tmp_path, "kill -9 $$")))
    assert caught.value.exit_code == -9


def test_the_program_says_what_it_refuses() -> None:
    scene = bench()
    scene.add_mirror("M", cs(z=1e15), MirrorConfig(0.0, 0.9))
    with pytest.raises(nsq_gpu.SceneError, match=r"components\[0\].cs.z"):
        scene.trace(100, backend=backend())
    with pytest.raises(nsq_gpu.AdapterError, match="no such adapter"):
        bench().trace(100, backend=backend(adapter="no such adapter"))


def test_failure_leaves_the_live_scene_alone() -> None:
    scene = bench()
    traced(scene, 500, backend())
    before = scene.detectors[0].get_result().irradiance.copy()
    with pytest.raises(nsq_gpu.AdapterError):
        scene.trace(100, backend=backend(adapter="no such adapter"))
    assert np.array_equal(scene.detectors[0].get_result().irradiance, before)


def test_warnings_of_the_program_are_python_warnings() -> None:
    scene = bench()
    scene.add_mirror("M", cs(z=-40.0, ry=90.0), MirrorConfig(0.0, 0.9))
    with pytest.warns(nsq_gpu.NsqGpuWarning, match="radians") as caught:
        scene.trace(100, backend=backend())
    assert caught[0].filename == __file__


def deep(num_lenses: int) -> NSQScene:
    """Return the bench with so many plates of two faces each."""
    scene = bench()
    for index in range(num_lenses):
        scene.add_lens(f"L{index}", cs(z=-15.0 + 3.0 * index), LensConfig(np.inf, np.inf, 1.0, glass(), 60.0))
    return scene


def test_a_detector_that_the_depth_limit_leaves_dark_is_a_warning_with_the_number_to_give() -> None:
    scene = deep(10)
    with pytest.warns(nsq_gpu.ResultWarning, match="screen got no light") as caught:
        dark = scene.trace(NUM_RAYS, backend=backend())
    assert dark.detectors["screen"].total_flux == 0.0
    said = next(str(warning.message) for warning in caught if "max_depth" in str(warning.message))
    assert {warning.filename for warning in caught} == {__file__}
    given = int(said.split("NsqGpuBackend(max_depth=")[1].rstrip(")"))
    assert given >= 2 * 20
    # The backend's number takes the place of the 16 that Optiland passes.
    which = backend(max_depth=given)
    result, _ = traced(deep(10), NUM_RAYS, which)
    assert which.report is not None and which.report["max_depth"] == given
    reference, _ = traced(deep(10), NUM_RAYS, NumpyBackend(), max_depth=given)
    assert float(reference.detectors["screen"].total_flux) > 0.1
    assert result.detectors["screen"].total_flux == pytest.approx(float(reference.detectors["screen"].total_flux))


def test_a_map_that_is_noise_is_a_warning() -> None:
    with pytest.warns(nsq_gpu.ResultWarning, match=r"'screen' is undersampled: .* rays would bring it to 5 %"):
        bench().trace(100, backend=backend())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bench().trace(100_000, backend=backend())


def test_sources_without_a_ray_are_a_warning() -> None:
    scene = bench()
    for index in range(4):
        scene.add_source(f"spare{index}", cs(z=-20.0), PointSourceConfig(spectrum=live.two_lines(), half_angle_deg=5.0))
    with pytest.warns(nsq_gpu.ResultWarning, match="2 of 5 sources have no ray: spare2, spare3"):
        scene.trace(3, backend=backend())


def test_rays_on_the_rim_of_a_wide_gaussian_beam_are_a_warning_that_tells_their_share() -> None:
    num_rays, radius = 40_000, 3.0
    scene = NSQScene()
    beam = CollimatedSourceConfig(live.two_lines(), aperture_radius=radius, profile="gaussian", gaussian_sigma=2.0 * radius)
    scene.add_source("beam", cs(), beam)
    scene.add_detector("rays", cs(z=5.0), RayDatabaseConfig(40.0, 40.0))
    with pytest.warns(nsq_gpu.NsqGpuWarning, match="beam.* 1.8 % of its rays start on the rim"):
        result = scene.trace(num_rays, backend=backend())
    rays = result.detectors["rays"]
    found = float(np.mean(np.hypot(rays.x, rays.y) > (1.0 - 1e-9) * radius))
    share = math.exp(-4.0)
    assert abs(found - share) < 4.5 * math.sqrt(share / num_rays)


def half_mirror() -> NSQScene:
    scene = bench()
    scene.add_mirror("M", cs(), MirrorConfig(0.0, 0.5))
    return scene


def test_what_a_mirror_takes_is_no_error_of_the_energy() -> None:
    result, _ = traced(half_mirror(), NUM_RAYS, backend())
    reference, _ = traced(half_mirror(), NUM_RAYS, NumpyBackend())
    # Optiland's figure stays, and Optiland's report takes it for a bug.
    assert result.flux_conservation_error == pytest.approx(reference.flux_conservation_error) and "bug" in reference.report()
    assert result.flux_conservation_error > 0.2
    report = result.report()
    assert "bug" not in report and not any("conservation" in warning for warning in result.diagnostics.warnings()), report
    taken = result.total_flux_in * result.flux_conservation_error
    assert "The ledger closes: every quantum is accounted for." in report and f"mirrors {taken:.6g} W" in report, report
    assert result.diagnostics.ledger_closes
    broken = dataclasses.replace(result.diagnostics, ledger_imbalance_quanta=-3)
    assert "THE LEDGER DOES NOT CLOSE: -3 quanta" in broken.warnings()[0] and "CLOSE" in broken.report()


# Installation


def test_pip_builds_the_release(tmp_path: Path) -> None:
    """The build itself takes a quarter of an hour: a stand-in for cargo tells what it was asked for."""
    project = live.ROOT / "python"
    settings = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))
    assert settings["tool"]["maturin"]["profile"] == "release"
    pytest.importorskip("maturin", reason="pip installs maturin for itself")
    said, cargo = tmp_path / "said", shutil.which("cargo")
    body = f'#!/bin/sh\ncase "$1" in metadata|--version) exec {cargo} "$@";; esac\necho "$@" >> {said}\nexit 1\n'
    stand_in = tmp_path / "cargo"
    stand_in.write_text(body, encoding="utf-8")
    stand_in.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "CARGO": str(stand_in)}
    subprocess.run([sys.executable, "-m", "pip", "wheel", "--no-build-isolation", "--no-deps", "-w", str(tmp_path),
                    str(project)], env=environment, capture_output=True, check=False)
    asked = said.read_text(encoding="utf-8")
    assert "--release" in asked or "--profile release" in asked, asked


# Where the program is


def test_a_missing_program_says_where_was_looked(tmp_path: Path) -> None:
    nowhere = {"PATH": str(tmp_path), "NSQ_GPU_BINARY": ""}
    with (
        mock.patch.dict(os.environ, nowhere),
        mock.patch("nsq_gpu.binary._scripts_folders", return_value=iter([tmp_path / "bin"])),
        pytest.raises(nsq_gpu.BinaryNotFoundError) as caught,
    ):
        bench().trace(100, backend=nsq_gpu.NsqGpuBackend())
    for word in (str(tmp_path / "bin"), "PATH", "NSQ_GPU_BINARY", "pip install", "binary="):
        assert word in str(caught.value)


@posix_only
def test_the_order_of_search(tmp_path: Path) -> None:
    folders = {name: tmp_path / name for name in ("argument", "environment", "scripts", "path")}
    for folder in folders.values():
        folder.mkdir()
        script(folder, "true")
    programs = {name: str(folder / "nsq-gpu") for name, folder in folders.items()}
    found = []
    with (
        mock.patch.dict(os.environ, {"PATH": str(folders["path"]), "NSQ_GPU_BINARY": programs["environment"]}),
        mock.patch("nsq_gpu.binary._scripts_folders", side_effect=lambda: iter([folders["scripts"]])),
    ):
        found.append(nsq_gpu.find_binary(programs["argument"]))
        found.append(nsq_gpu.find_binary())
        del os.environ["NSQ_GPU_BINARY"]
        found.append(nsq_gpu.find_binary())
        Path(programs["scripts"]).unlink()
        found.append(nsq_gpu.find_binary())
    assert found == list(programs.values())


def test_a_named_program_must_exist(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="the argument binary names .*nowhere"):
        nsq_gpu.find_binary(tmp_path / "nowhere")
    with (
        mock.patch.dict(os.environ, {"NSQ_GPU_BINARY": str(tmp_path / "nowhere")}),
        pytest.raises(FileNotFoundError, match="NSQ_GPU_BINARY names .*nowhere"),
    ):
        nsq_gpu.find_binary()


# The comparison


def test_compare_agrees(capsys: pytest.CaptureFixture[str]) -> None:
    path = live.ROOT / "scenes" / "cooke_triplet.json"
    code = compare.main([str(path), "-n", "2e3", "--precision", "f64", "--binary", live.binary()])
    printed = capsys.readouterr().out
    assert code == 0 and "NumPy" in printed and "rays with another fate: 0 of" in printed, printed


def wrong(**changes: int) -> Any:
    """Make the backend trace with other options than it was given."""
    trace = nsq_gpu.NsqGpuBackend.trace

    def changed(self: nsq_gpu.NsqGpuBackend, scene: NSQScene, **options: Any) -> Any:
        return trace(self, scene, **{**options, **changes})

    return mock.patch.object(nsq_gpu.NsqGpuBackend, "trace", changed)


def test_compare_finds_a_difference(capsys: pytest.CaptureFixture[str]) -> None:
    path = live.ROOT / "scenes" / "cooke_triplet.json"
    options = [str(path), "-n", "2e3", "--precision", "f64", "--binary", live.binary()]
    # Another seed goes the other ways, but is no statistical difference.
    with wrong(seed=99):
        assert compare.main(options) == compare.DISAGREE
        assert compare.main([*options, "--statistical"]) == 0
    # A shallower trace is.
    with wrong(max_depth=3):
        assert compare.main([*options, "--statistical"]) == compare.DISAGREE
    assert "DISAGREE" in capsys.readouterr().out


def test_compare_judges_split_rays_by_their_flux(capsys: pytest.CaptureFixture[str]) -> None:
    path = live.ROOT / "scenes" / "split_ghosts.json"
    options = [str(path), "-n", "2e3", "--precision", "f64", "--binary", live.binary()]
    assert compare.main(options) == 0
    with wrong(max_depth=3):
        assert compare.main(options) == compare.DISAGREE
    assert "DISAGREE" in capsys.readouterr().out


def test_compare_reports_errors(capsys: pytest.CaptureFixture[str]) -> None:
    path = live.ROOT / "scenes" / "bench_lens.json"
    assert compare.main([str(path), "-n", "10", "--binary", live.binary(), "--adapter", "none such"]) == 4
    assert "none such" in capsys.readouterr().err


@pytest.mark.parametrize(("change", "code", "said"), [
    (None, 2, "No such file"),
    (lambda text: "", 3, "line 1, column 1"),
    (lambda text: text[:-3], 3, "is the file whole"),
    (lambda text: text.replace("thickness", "thicknes", 1), 3, "did you mean `thickness`"),
    # The loader would drop it without a word.
    (lambda text: text.replace("total_flux", "total_flix", 1), 3, "total_flix"),
    # JSON5 that the command reads.
    (lambda text: text.replace('"L1"', "'L1'", 1), 3, "no more of JSON5"),
], ids=["missing", "empty", "cut", "misspelt", "dropped", "JSON5"])
def test_compare_refuses_files_in_one_line(change: Callable[[str], str] | None, code: int, said: str, tmp_path: Path,
                                           capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scene.json"
    if change is not None:
        path.write_text(change((live.ROOT / "docs" / "example.json").read_text(encoding="utf-8")), encoding="utf-8")
    assert compare.main([str(path), "-n", "10", "--binary", live.binary()]) == code
    out, err = capsys.readouterr()
    assert not out and err.count("\n") == 1 and said in err and "scene.json" in err, err


def test_compare_without_torch_says_so_before_it_traces(capsys: pytest.CaptureFixture[str]) -> None:
    with mock.patch.dict(sys.modules, {"torch": None}):
        assert compare.main(["nowhere.json", "--torch"]) == 2
    assert capsys.readouterr().err.startswith("--torch: Torch is not installed")


@pytest.mark.parametrize("count", ["nan", "inf", "1.5", "0", "many"])
def test_compare_says_which_numbers_of_rays_it_takes(count: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        compare.main(["nowhere.json", "-n", count])
    assert f"'{count}' is not a number of rays; write 250000 or 1e5" in capsys.readouterr().err
