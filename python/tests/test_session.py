"""Sessions: the same results as the command's, whatever was traced before, by whom, and what went wrong meanwhile."""

from __future__ import annotations

import json
import multiprocessing
import os
import random
import signal
import struct
import subprocess
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import LensConfig, NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
import nsq_gpu.export
import nsq_gpu.session
from nsq_gpu.export import export, to_json
from nsq_gpu.results import warn_of
from nsq_gpu.session import Session
from tests import live
from tests.live import SCENES, cs, glass, in_turn

posix_only = pytest.mark.skipif(os.name == "nt", reason="signals and forks are POSIX's")
NUM_RAYS = 2000


def session(**options: Any) -> Session:
    return Session(**{"binary": live.binary(), "precision": "f64", **options})


def singlet(radius: float = 60.0, thickness: float = 5.0, z: float = 0.0, distance: float = 55.0) -> NSQScene:
    """Return one lens of N-BK7-like glass, a beam and a map: four numbers that a designer turns."""
    scene = NSQScene()
    scene.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=8.0))
    scene.add_lens("L", cs(z=z), LensConfig(radius, -radius, thickness, glass(), 10.0))
    scene.add_detector("image", cs(z=distance), IrradianceDetectorConfig(20.0, 20.0, 64, 64))
    return scene


def command(path: Path, folder: Path, *options: str) -> dict[str, np.ndarray]:
    """Return the arrays that the command writes, by file and name."""
    subprocess.run([live.binary(), "trace", str(path), "-o", str(folder), "--no-pictures", "--progress=never", *options],
                   check=True, capture_output=True)
    found = {}
    for file in folder.glob("*.npz"):
        with np.load(file) as arrays:
            found |= {(file.stem, name): arrays[name] for name in arrays.files}
    return found


@pytest.mark.parametrize("path", in_turn(SCENES), ids=lambda path: path.stem)
def test_a_session_has_the_bits_of_the_command(path: Path, tmp_path: Path) -> None:
    expected = command(path, tmp_path / "out", "-n", str(NUM_RAYS), "--precision=f64", "--strict")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    folders = {Path(entry["file"]).stem: name for name, entry in report["detectors"].items()}
    with session() as live_one:
        request = {"request": "trace", "scene": path.read_text(), "folder": str(path.parent),
                   "options": {"num_rays": NUM_RAYS, "precision": "f64"}}
        header, body = live_one._running().ask(request, None, None)
        answer = nsq_gpu.session.Answer(header, body)
    for (stem, name), array in expected.items():
        found = answer.arrays(folders[stem])[name]
        assert found.tobytes() == array.tobytes(), (stem, name)
    for key in ("ledger", "surfaces", "total_flux_detected", "max_depth", "driver"):
        assert answer.report[key] == report[key], key


def test_scenes_of_one_shape_share_a_shader_and_no_number_is_stale() -> None:
    draw = random.Random(0)
    with session() as one, session(live=False) as other:
        for _ in range(12):
            numbers = [draw.uniform(40.0, 90.0), draw.uniform(3.0, 6.0), draw.uniform(-2.0, 2.0), draw.uniform(30.0, 60.0)]
            ours, theirs = (which.trace(singlet(*numbers), NUM_RAYS) for which in (one, other))
            assert ours.detectors["image"].irradiance.tobytes() == theirs.detectors["image"].irradiance.tobytes()
        assert one.hello()["num_shaders"] == 1


def test_threads_take_turns() -> None:
    radii = [50.0 + index for index in range(8)]
    with session() as shared:
        def trace(radius: float) -> bytes:
            return shared.trace(singlet(radius), NUM_RAYS).detectors["image"].irradiance.tobytes()

        alone = [trace(radius) for radius in radii]
        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(trace, radii)) == alone
        assert len(set(alone)) == len(radii)


def _trace_in_fork(answers: Any) -> None:
    answers.put(nsq_gpu.session.shared_session(live.binary(), None).hello()["program"])
    answers.put(singlet().trace(NUM_RAYS, backend=live.backend()).detectors["image"].total_flux)


@posix_only
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_fork_has_a_process_of_its_own() -> None:
    expected = singlet().trace(NUM_RAYS, backend=live.backend()).detectors["image"].total_flux
    context = multiprocessing.get_context("fork")
    answers = context.Queue()
    child = context.Process(target=_trace_in_fork, args=(answers,))
    child.start()
    assert answers.get(timeout=60.0) == "nsq-gpu" and answers.get(timeout=60.0) == expected
    child.join(60.0)
    assert child.exitcode == 0
    again = singlet().trace(NUM_RAYS, backend=live.backend()).detectors["image"].total_flux
    assert again == expected


def test_a_scene_that_is_refused_leaves_the_session_alone() -> None:
    with session() as one:
        expected = one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux
        process = one._running()
        with pytest.raises(nsq_gpu.SceneError, match=r"components\[0\].config: the key `r1` is missing"):
            one.request({**json.loads(json.dumps(nsq_gpu.export.export(singlet()).document)), "components": [
                {"type": "lens", "name": "L", "cs": {}, "config": {"thickness": -1.0}}]}, {"num_rays": 10})
        with pytest.raises(nsq_gpu.UsageError, match="num-rays"):
            one.request("{}", {"num_rays": "many"})
        with pytest.raises(nsq_gpu.UsageError, match="unexpected argument '--num-ray'"):
            one.request("{}", {"num_ray": 10})
        assert one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux == expected
        assert one._running() is process


def test_a_timeout_cancels_the_trace_and_the_session_goes_on() -> None:
    with session() as one:
        expected = one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux
        process = one._running()
        start = time.monotonic()
        with pytest.raises(nsq_gpu.TraceTimeoutError, match="timeout = 0.5 s"):
            one.trace(singlet(), 10**12, timeout=0.5)
        assert time.monotonic() - start < 5.0
        assert one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux == expected
        assert one._running() is process


@posix_only
def test_an_interrupt_cancels_the_trace_and_the_session_goes_on() -> None:
    with session() as one:
        expected = one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux
        process = one._running()
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
            with pytest.raises(KeyboardInterrupt):
                one.trace(singlet(), 10**12)
        finally:
            signal.signal(signal.SIGINT, before)
        assert one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux == expected
        assert one._running() is process


@posix_only
def test_a_process_that_dies_costs_one_trace() -> None:
    with session() as one:
        expected = one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux
        threading.Timer(0.5, one._running()._process.kill).start()
        with pytest.raises(nsq_gpu.NsqGpuError, match="signal 9"):
            one.trace(singlet(), 10**12)
        assert one.trace(singlet(), NUM_RAYS).detectors["image"].total_flux == expected


def test_an_exception_of_the_callback_cancels_the_trace() -> None:
    def refuse(*update: float) -> None:
        raise ValueError("enough")

    which = live.backend(progress=refuse)
    with pytest.raises(ValueError, match="enough"):
        singlet().trace(10**6, backend=which)
    assert singlet().trace(NUM_RAYS, backend=live.backend()).num_rays_total == NUM_RAYS


def test_closing_ends_the_process() -> None:
    one = session()
    one.start()
    process = one._running()._process
    one.close()
    assert process.poll() is not None
    assert one.trace(singlet(), 100).num_rays_total == 100
    one.close()


# The messages themselves


def _frame(header: bytes, arrays: bytes = b"") -> bytes:
    return struct.pack("<IQ", len(header), len(arrays)) + header + arrays


def _answers(stream: bytes) -> list[dict[str, Any]]:
    """Return the headers of what the program answers to a stream of messages."""
    done = subprocess.run([live.binary(), "serve"], input=stream, capture_output=True, check=False)
    found, at = [], 0
    while at < len(done.stdout):
        header, arrays = struct.unpack_from("<IQ", done.stdout, at)
        found.append(json.loads(done.stdout[at + 12 : at + 12 + header]))
        at += 12 + header + arrays
    return found


def test_every_broken_message_is_answered_by_an_error() -> None:
    draw = random.Random(1)
    scene = nsq_gpu.export.to_json(nsq_gpu.export.export(singlet()).document, indent=None)
    whole = json.dumps({"id": 1, "request": "trace", "scene": scene, "options": {"num_rays": 10}}).encode()
    broken = []
    for number in range(10_000):
        data = bytearray(whole)
        kind = number % 4
        if kind == 0:
            for _ in range(draw.randint(1, 8)):
                data[draw.randrange(len(data))] = draw.randrange(256)
        elif kind == 1:
            del data[draw.randrange(len(data)) :]
        elif kind == 2:
            data = bytearray(draw.randbytes(draw.randint(0, 60)))
        else:
            data = bytearray(json.dumps({"id": number, "request": draw.choice(["trace", "fly", 7, None]),
                                         "scene": draw.choice([scene[:50], {}, [], 3]), "more": 1}).encode())
        broken.append(bytes(data))
    stream = b"".join(map(_frame, broken)) + _frame(json.dumps({"id": "last", "request": "hello"}).encode())
    answers = _answers(stream)
    assert answers[-1]["reply"] == "hello" and answers[-1]["protocol"] == nsq_gpu.session.PROTOCOL
    # What was changed into another whole message, such as one of other numbers, has a result; a cancel has no answer.
    assert len(answers) == len(broken) + 1
    assert {answer["reply"] for answer in answers[:-1]} <= {"error", "result"}
    assert sum(answer["reply"] == "error" for answer in answers) > 9500
    assert not any("internal" in answer.get("message", "") for answer in answers)


def test_a_frame_that_makes_no_sense_ends_the_session_with_an_error() -> None:
    answers = _answers(_frame(b'{"id": 1, "request": "hello"}') + b"\xff" * 12)
    assert [answer["reply"] for answer in answers] == ["hello", "error"]
    assert "announces" in answers[1]["message"]


# Sweeps, and the default backend


def test_a_sweep_is_its_traces_with_labels(tmp_path: Path) -> None:
    radii, places = [50.0, 60.0, 75.0], [0.0, 1.0]
    scene = singlet()
    with session() as one:
        found = one.sweep(scene, {"L.r1": radii, "L.z": places}, NUM_RAYS, maps=True, standard_error="on")
        for i, radius in enumerate(radii):
            for j, z in enumerate(places):
                text = nsq_gpu.export.export(scene).document
                text["components"][0]["config"]["r1"] = radius
                text["components"][0]["cs"]["z"] = z
                answer = one.request(text, {"num_rays": NUM_RAYS, "max_depth": 16, "standard_error": "on"})
                assert found.flux["image"][i, j] == answer.report["detectors"]["image"]["total_flux"]
                assert found.standard_error["image"][i, j] == answer.report["detectors"]["image"]["total_flux_standard_error"]
                assert np.array_equal(found.maps["image"][i, j], answer.arrays("image")["irradiance"])
        assert one.hello()["num_shaders"] == 1
        zipped = one.sweep(scene, {"L.r1": radii[:2], "L.z": places}, NUM_RAYS, zip=True, standard_error="on")
        assert zipped.flux["image"].tolist() == [found.flux["image"][0, 0], found.flux["image"][1, 1]]
        own = one.sweep(scene, {"L.r1": radii[:2]}, NUM_RAYS, common_draws=False)
        assert own.flux["image"][0] == found.flux["image"][0, 0] and own.flux["image"][1] != found.flux["image"][1, 0]
    found.to_csv(tmp_path / "found.csv")
    found.to_json(tmp_path / "found.json")
    scene_file = tmp_path / "scene.json"
    nsq_gpu.export_scene(scene, scene_file)
    subprocess.run([live.binary(), "sweep", str(scene_file), "--set=L.r1=50,60,75", "--set=L.z=0:1:2", "-n", str(NUM_RAYS),
                    "--precision=f64", "--max-depth=16", "--standard-error=on", "-o", str(tmp_path / "command.csv")],
                   check=True, capture_output=True)
    ours, theirs = ((tmp_path / name).read_text().splitlines() for name in ("found.csv", "command.csv"))
    assert ours[0] == theirs[0]
    for mine, other in zip(ours[1:], theirs[1:], strict=True):
        assert [float(cell) for cell in mine.split(",")] == [float(cell) for cell in other.split(",")]
    assert len(json.loads((tmp_path / "found.json").read_text())["points"]) == 6


def test_a_sweep_has_axes_with_units() -> None:
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    with session() as one:
        found = one.sweep(singlet(), {"L.r1": [50.0, 60.0]}, 100, maps=True).to_xarray()
    assert isinstance(found, xarray.Dataset)
    assert found["image_flux"].dims == ("L.r1",) and found["image_flux"].attrs["units"] == "W"
    assert found["image_map"].sizes["L.r1"] == 2 and list(found["L.r1"].values) == [50.0, 60.0]


def test_a_sweep_of_nothing_is_refused_by_name() -> None:
    with session() as one:
        with pytest.raises(nsq_gpu.UsageError, match=r"`M.r1`: nothing in the scene is called \"M\"; did you mean `L`"):
            one.sweep(singlet(), {"M.r1": [1.0]}, 10)
        with pytest.raises(nsq_gpu.SceneError, match="thicknes.*did you mean `thickness`"):
            one.sweep(singlet(), {"L.thicknes": [1.0]}, 10)
        with pytest.raises(nsq_gpu.UsageError, match="zip=True needs as many values"):
            one.sweep(singlet(), {"L.r1": [1.0], "L.z": [1.0, 2.0]}, 10, zip=True)


def test_use_makes_the_backend_the_default_until_it_is_told_otherwise() -> None:
    from optiland.nonsequential.backends.numpy_backend import NumpyBackend

    scene = singlet()
    numpys = scene.trace(NUM_RAYS, seed=0).detectors["image"].irradiance
    which = live.backend()
    nsq_gpu.use(which)
    try:
        ours = scene.trace(NUM_RAYS, seed=0)
        assert which.report is not None and which.report["num_rays_total"] == NUM_RAYS
        np.testing.assert_allclose(ours.detectors["image"].irradiance, numpys, rtol=1e-9, atol=1e-15)
        which.report = None
        scene.trace(NUM_RAYS, seed=0, backend=NumpyBackend())
        assert which.report is None
    finally:
        nsq_gpu.use(None)
    scene.trace(NUM_RAYS, seed=0)
    assert which.report is None


def test_warnings_are_those_of_the_users_line() -> None:
    scene = singlet()
    with session() as one, pytest.warns(nsq_gpu.ResultWarning, match="undersampled") as caught:
        one.trace(scene, 50)
    assert {warning.filename for warning in caught} == {__file__}
    nsq_gpu.use(live.backend())
    try:
        with pytest.warns(nsq_gpu.ResultWarning, match="undersampled") as caught:
            scene.trace(50)
    finally:
        nsq_gpu.use(None)
    assert {warning.filename for warning in caught} == {__file__}


def test_a_sweep_gives_a_warning_once_though_its_figures_differ() -> None:
    said = [f"{name} is undersampled: errors add up to {error} % of {flux} W" for name, error, flux in
            (("'d1'", "12.5", "1,000"), ("'d1'", "3e-05", "1.5"), ("'d2'", "12.5", "1,000"), ("d3.r1", "1", "1"), ("d4.r1", "1", "1"))]
    known: set[str] = set()
    with pytest.warns(nsq_gpu.ResultWarning) as caught:
        for text in said:
            warn_of({"scene_warnings": [], "diagnostics": {"grave": [text]}}, None, known)
    assert [str(warning.message) for warning in caught] == [said[0], *said[2:]]


def test_what_no_json_holds_is_refused_and_the_session_goes_on() -> None:
    with session() as one:
        process = one._running()
        with pytest.raises(nsq_gpu.SceneError, match=r"point 0 \(L.r1 = nan\): L.r1 is nan; give a finite number"):
            one.sweep(singlet(), {"L.r1": [np.nan]}, 10)
        with pytest.raises(nsq_gpu.UsageError, match="not finite"):
            one.request(to_json(export(singlet()).document), {"num_rays": 10, "min_flux_fraction": np.nan})
        assert one.trace(singlet(), np.int64(100)).num_rays_total == 100  # type: ignore[arg-type]
        assert one._running() is process


def test_a_timeout_of_one_thread_leaves_the_traces_of_others() -> None:
    with session() as one:
        process = one._running()
        with ThreadPoolExecutor(2) as pool:
            long = pool.submit(one.trace, singlet(), 10**8, time_limit="3s")
            time.sleep(0.3)
            start = time.monotonic()
            with pytest.raises(nsq_gpu.TraceTimeoutError, match="waited longer than timeout = 1 s"):
                pool.submit(one.trace, singlet(), NUM_RAYS, timeout=1.0).result()
            assert time.monotonic() - start < 2.0 and not long.done()
            short = pool.submit(one.trace, singlet(), NUM_RAYS, timeout=60.0)
            assert short.result().num_rays_total == NUM_RAYS and long.result().num_rays_total > NUM_RAYS
        assert one._running() is process


def test_a_session_that_is_dropped_ends_its_process() -> None:
    one = session()
    one.start()
    process = one._running()._process
    del one
    assert process.poll() is not None
