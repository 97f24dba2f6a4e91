"""Nothing that a user made is lost: stops keep what is done, bad points are named, and files are not written over."""

from __future__ import annotations

import csv
import json
import math
import os
import signal
import stat
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig

import nsq_gpu
from nsq_gpu import cluster, placing
from nsq_gpu.convert.__main__ import main as convert
from nsq_gpu.export import export_scene
from tests import live
from tests.test_difference import singlet as other_singlet
from tests.test_session import NUM_RAYS, session, singlet

posix_only = pytest.mark.skipif(os.name == "nt", reason="signals, pipes and modes are POSIX's")
#: More rays than any test waits for.
FOREVER = 10**11
pytestmark = [pytest.mark.filterwarnings("ignore::nsq_gpu.ResultWarning"), pytest.mark.in_turn]


@contextmanager
def interrupted_after(seconds: float) -> Iterator[None]:
    """Press Ctrl-C after so long."""
    # A script run in the background inherits a handler that ignores SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)


def stopped(act: Callable[[], Any], seconds: float = 3.0) -> Any:
    """Return what a call had computed when Ctrl-C ended it."""
    with interrupted_after(seconds):
        start = time.monotonic()
        with pytest.raises(nsq_gpu.Interrupted) as caught:
            act()
    # Uninterrupted, such a call takes minutes at least. A busy machine takes seconds to hand over what is done.
    assert time.monotonic() - start < seconds + 20.0
    assert caught.value.partial.partial is True
    return caught.value.partial


# Stops


@posix_only
def test_a_stopped_sweep_has_the_points_that_are_done(tmp_path: Path) -> None:
    with session() as one:
        one.trace(singlet(), NUM_RAYS)
        found = stopped(lambda: one.sweep(singlet(), {"L.r1": np.linspace(50.0, 60.0, 100_000)}, NUM_RAYS), seconds=6.0)
        known = found.num_rays > 0
        num = int(known.sum())
        assert 0 < num < 100_000 and known[:num].all()
        assert np.isfinite(found.flux["image"][:num]).all() and np.isnan(found.flux["image"][num:]).all()
        again = one.sweep(singlet(), {"L.r1": np.linspace(50.0, 60.0, 100_000)[:2]}, NUM_RAYS)
        assert again.flux["image"].tolist() == found.flux["image"][:2].tolist() and not again.partial
    found.to_json(tmp_path / "found.json")
    found.to_csv(tmp_path / "found.csv")
    document = json.loads((tmp_path / "found.json").read_text())
    assert document["partial"] is True and len(document["points"]) == num and document["num_points"] == 100_000
    rows = list(csv.reader((tmp_path / "found.csv").open()))
    assert len(rows) == num + 2 and rows[-1][-1] == f"partial: {num} of 100000 points"


@posix_only
def test_a_stopped_trace_has_the_rays_that_were_traced() -> None:
    with session() as one:
        found = stopped(lambda: one.trace(singlet(), FOREVER))
        assert 0 < found.num_rays_total < FOREVER
        assert found.detectors["image"].total_flux == pytest.approx(1.0, rel=0.2)
        assert one.trace(singlet(), NUM_RAYS).num_rays_total == NUM_RAYS, "the session goes on"
        with pytest.raises(nsq_gpu.TraceTimeoutError) as caught:
            one.trace(singlet(), FOREVER, timeout=2.0)
        assert 0 < caught.value.partial.num_rays_total < FOREVER and caught.value.partial.partial


@posix_only
def test_a_stopped_jacobian_has_the_derivatives_of_the_rays_that_were_traced() -> None:
    whole = nsq_gpu.jacobian(singlet(), "L.r1", 100_000, binary=live.binary())
    assert not whole.partial
    found = stopped(lambda: nsq_gpu.jacobian(singlet(), "L.r1", FOREVER, binary=live.binary()))
    assert 0 < found.report["num_rays_total"] < FOREVER and found.report["partial"]
    ours, theirs = found.maps["image"].sum(), whole.maps["image"].sum()
    assert ours == pytest.approx(theirs, rel=0.02)
    assert np.abs(found["L.r1", "image"].map).sum() == pytest.approx(np.abs(whole["L.r1", "image"].map).sum(), rel=0.3)


@posix_only
def test_a_stopped_difference_is_of_the_rays_that_both_have_traced() -> None:
    a, b = other_singlet(60.0), other_singlet(62.0)
    whole = nsq_gpu.diff(a, b, 100_000, binary=live.binary())
    found = stopped(lambda: nsq_gpu.diff(a, b, FOREVER, binary=live.binary()))
    assert 0 < found.num_rays < FOREVER and found.report["partial"] and not whole.partial
    image, expected = found.detectors["image"], whole.detectors["image"]
    assert np.abs(image.map).sum() == pytest.approx(np.abs(expected.map).sum(), rel=0.1)
    assert image.a == pytest.approx(expected.a, rel=0.02)
    with pytest.raises(nsq_gpu.TraceTimeoutError) as caught:
        nsq_gpu.diff(a, b, FOREVER, timeout=3.0, binary=live.binary())
    assert 0 < caught.value.partial.num_rays < FOREVER


def test_a_timeout_ends_a_whole_sweep_and_keeps_its_points() -> None:
    with session() as one:
        one.trace(singlet(), NUM_RAYS)
        start = time.monotonic()
        with pytest.raises(nsq_gpu.TraceTimeoutError, match="the sweep took longer than timeout = 4 s") as caught:
            one.sweep(singlet(), {"L.r1": np.linspace(50.0, 60.0, 100_000)}, NUM_RAYS, timeout=4.0)
        assert time.monotonic() - start < 12.0
        assert caught.value.partial.partial and caught.value.partial.num_rays.any()


@posix_only
def test_a_timeout_holds_where_the_program_does_not_read() -> None:
    with session() as one:
        one.trace(singlet(), NUM_RAYS)
        child = one._running()._process
        os.kill(child.pid, signal.SIGSTOP)
        scene = json.dumps({"filler": "x" * (1 << 20)})
        start = time.monotonic()
        with pytest.raises(nsq_gpu.TraceTimeoutError):
            one.request(scene, {"num_rays": 10}, timeout=1.0)
        assert time.monotonic() - start < 6.0
        assert one.trace(singlet(), NUM_RAYS).num_rays_total == NUM_RAYS


def test_a_timeout_is_a_time() -> None:
    with session() as one:
        for endless in (math.inf, 1e30, None):
            assert one.trace(singlet(), NUM_RAYS, timeout=endless).num_rays_total == NUM_RAYS
        calls: tuple[Callable[[Any], Any], ...] = (
            lambda timeout: one.trace(singlet(), NUM_RAYS, timeout=timeout),
            lambda timeout: one.sweep(singlet(), {"L.r1": [60.0]}, NUM_RAYS, timeout=timeout),
            lambda timeout: nsq_gpu.diff(singlet(), singlet(), NUM_RAYS, timeout=timeout, binary=live.binary()),
            lambda timeout: cluster.trace(singlet(), NUM_RAYS, object(), timeout=timeout))
        for call in calls:
            for wrong in (math.nan, -1.0, "soon"):
                with pytest.raises(nsq_gpu.UsageError, match="timeout is .*; give a number of seconds"):
                    call(wrong)


def test_a_process_that_one_thread_ends_costs_no_other_trace() -> None:
    with session() as one:
        for _ in range(5):
            one.trace(singlet(), NUM_RAYS)
            one._running().end()
            assert one.trace(singlet(), NUM_RAYS).num_rays_total == NUM_RAYS
        child = one._running()
        child._turn.acquire()
        waiting: list[Any] = []
        thread = threading.Thread(target=lambda: waiting.append(one.trace(singlet(), NUM_RAYS)))
        thread.start()
        time.sleep(0.3)
        child.end()
        child._turn.release()
        thread.join(60.0)
        assert waiting[0].num_rays_total == NUM_RAYS


# One bad point


def test_a_bad_point_is_named_and_the_others_are_returned(tmp_path: Path) -> None:
    values = {"L.thickness": [5.0, -1.0], "L.r1": [60.0, float("nan"), 70.0]}
    with session() as one:
        with pytest.warns(nsq_gpu.NsqGpuWarning) as warned:
            found = one.sweep(singlet(), values, NUM_RAYS)
        good = one.sweep(singlet(), {"L.thickness": [5.0], "L.r1": [60.0, 70.0]}, NUM_RAYS)
    assert found.flux["image"][0, [0, 2]].tolist() == good.flux["image"][0].tolist()
    assert set(found.refused) == {(0, 1), (1, 0), (1, 1), (1, 2)} and not found.partial
    assert np.isnan(found.flux["image"][1]).all() and np.isnan(found.flux["image"][0, 1])
    [told] = [str(warning.message) for warning in warned if warning.category is nsq_gpu.NsqGpuWarning]
    said = told.splitlines()
    assert any(text.startswith("point 1 (L.thickness = 5, L.r1 = nan) is left out: L.r1 is nan") for text in said)
    assert any(text.startswith("point 3 (L.thickness = -1, L.r1 = 60) is left out: the exported scene") for text in said)
    found.to_csv(tmp_path / "found.csv")
    rows = list(csv.DictReader((tmp_path / "found.csv").open()))
    assert len(rows) == 6 and [bool(row["problem"]) for row in rows] == [False, True, False, True, True, True]
    assert rows[1]["image [W]"] == "" and float(rows[0]["image [W]"]) == found.flux["image"][0, 0]
    found.to_json(tmp_path / "found.json")
    document = json.loads((tmp_path / "found.json").read_text())
    assert document["num_refused"] == 4 and "error" in document["points"][1]


def test_a_sweep_whose_points_are_all_bad_is_an_error() -> None:
    with session() as one, \
            pytest.raises(nsq_gpu.SceneError, match=r"point 0 \(L.thickness = -1\): the exported scene"):
        one.sweep(singlet(), {"L.thickness": [-1.0, -2.0]}, NUM_RAYS)


def test_maps_of_other_shapes_stand_side_by_side() -> None:
    with session() as one:
        found = one.sweep(singlet(), {"image.num_pixels_x": [16, 32, 16]}, NUM_RAYS, maps=True)
    assert [found.maps["image"][i].shape for i in range(3)] == [(64, 16), (64, 32), (64, 16)]
    assert np.array_equal(found.maps["image"][0], found.maps["image"][2])


@pytest.mark.parametrize(("values", "words"), [
    ([[1.0, 2.0]], r"shape \(1, 2\).*one axis"), (["a"], "are no numbers"), ([], "no values"), (None, "are no numbers")])
def test_values_that_are_none_are_refused(values: Any, words: str) -> None:
    with session() as one, pytest.raises(nsq_gpu.UsageError, match=words):
        one.sweep(singlet(), {"L.r1": values}, NUM_RAYS)


# Sessions


def test_a_trace_from_a_callback_of_its_own_session_is_refused() -> None:
    with session() as one, session() as other:
        found: list[Any] = []

        def nested(_: Any) -> None:
            if not found:
                found.append(other.trace(singlet(), NUM_RAYS))
                one.trace(singlet(), NUM_RAYS)

        start = time.monotonic()
        with pytest.raises(nsq_gpu.UsageError, match="in another Session"):
            one.request(nsq_gpu.export.to_json(nsq_gpu.export.export(singlet()).document),
                        {"num_rays": FOREVER}, progress=nested)
        assert time.monotonic() - start < 20.0 and found[0].num_rays_total == NUM_RAYS
        assert one.trace(singlet(), NUM_RAYS).num_rays_total == NUM_RAYS


@pytest.mark.parametrize("call", [
    "self.session.trace(self.scene, 1000)", "self.session.request(self.text, self.options)",
    "session().request(self.text, self.options)", "process.run(['true'])"])
def test_a_trace_when_python_ends_is_an_error_and_no_hang(call: str) -> None:
    script = textwrap.dedent(f"""
        from nsq_gpu import process
        from nsq_gpu.export import export, to_json
        from tests.test_session import session, singlet

        class Late:
            def __init__(self):
                self.session = session()
                self.scene, self.options = singlet(), {{"num_rays": 1000}}
                self.text = to_json(export(self.scene).document)
                self.session.trace(self.scene, 1000)

            def __del__(self):
                {call}

        late = Late()
    """)
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    # Where a module is imported late, Python itself says so.
    assert ended.returncode == 0 and ("Python is ending" in ended.stderr or "shutting down" in ended.stderr), ended.stderr


def test_whole_numbers_are_asked_for_alike() -> None:
    with session() as one:
        assert one.trace(singlet(), 1e3).num_rays_total == 1000  # type: ignore[arg-type]
        calls = (lambda rays: one.trace(singlet(), rays), lambda rays: one.sweep(singlet(), {"L.r1": [60.0]}, rays),
                 lambda rays: nsq_gpu.diff(singlet(), singlet(61.0), rays, binary=live.binary()),
                 lambda rays: nsq_gpu.jacobian(singlet(), "L.r1", rays, binary=live.binary()),
                 lambda rays: live.backend().trace(singlet(), rays),
                 lambda rays: cluster.trace(singlet(), rays, object()),
                 lambda rays: cluster.sweep(singlet(), {"L.r1": [60.0]}, rays, object()))
        for call in calls:
            for rays in (1000.5, "many", math.nan):
                with pytest.raises(nsq_gpu.UsageError, match="num_rays is .*; give a whole number"):
                    call(rays)


# Files


def scene_detector() -> IrradianceDetectorConfig:
    return IrradianceDetectorConfig(20.0, 20.0, 8, 8)


@posix_only
def test_no_file_is_written_over_that_is_not_meant(tmp_path: Path) -> None:
    with session() as one:
        found = one.sweep(singlet(), {"L.r1": [50.0, 60.0]}, NUM_RAYS)
    writers: dict[str, Callable[..., None]] = {
        "scene.json": lambda path, **more: export_scene(singlet(), path, **more), "found.csv": found.to_csv,
        "found.json": found.to_json}
    for name, write in writers.items():
        folder = tmp_path / name
        folder.mkdir()
        mine, place = folder / "mine", folder / name
        mine.write_text("mine")
        (folder / "link").symlink_to(mine)
        (folder / "dangling").symlink_to(folder / "nowhere")
        os.mkfifo(folder / "pipe")
        (folder / "folder").mkdir()
        for taken in ("link", "dangling", "pipe", "folder"):
            for overwrite in (False, True):
                with pytest.raises(nsq_gpu.UsageError, match=taken):
                    write(folder / taken, overwrite=overwrite)
        with pytest.raises(nsq_gpu.UsageError, match="exists; overwrite=True"):
            write(mine)
        assert mine.read_text() == "mine" and not (folder / "nowhere").exists()
        write(place)
        first = place.read_text()
        write(place)
        assert place.read_text() == first, "the same text is no loss"
        place.write_text("changed")
        with pytest.raises(nsq_gpu.UsageError, match="exists; overwrite=True"):
            write(place)
        write(place, overwrite=True)
        if name == "scene.json":
            export_scene(singlet(61.0), place)
            assert place.read_text() != first, "what this process wrote it may replace"
        mine.chmod(0o600)
        write(mine, overwrite=True)
        assert mine.read_text() == first and stat.S_IMODE(mine.stat().st_mode) == 0o600
        assert not list(folder.glob(".nsq-gpu-*"))


@posix_only
def test_a_full_disk_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text("mine")
    # The limit of a file's size stands for a full disk.
    code = textwrap.dedent("""
        import resource, signal, sys
        from nsq_gpu import placing
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        try:
            placing.write(sys.argv[1], "x" * 10000, overwrite=True)
        except OSError as error:
            sys.exit(error.errno)
    """)
    ended = subprocess.run([sys.executable, "-c", code, str(path)], timeout=60)
    assert ended.returncode != 0
    assert path.read_text() == "mine" and [entry.name for entry in tmp_path.iterdir()] == ["scene.json"]


def test_a_file_that_appears_meanwhile_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "found.csv"
    before = os.link

    def late(*arguments: Any) -> None:
        path.write_text("mine")
        before(*arguments)

    monkeypatch.setattr(os, "link", late)
    with pytest.raises(nsq_gpu.UsageError, match="meanwhile"):
        placing.write(path, "ours")
    assert path.read_text() == "mine" and [entry.name for entry in tmp_path.iterdir()] == ["found.csv"]


def test_convert_writes_over_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tests import lens_texts

    lens, scene = tmp_path / "lens.zmx", tmp_path / "scene.json"
    lens.write_text(lens_texts.zmx())
    text = lens.read_text()
    scene.write_text("mine")
    for output, more in ((lens, []), (lens, ["--overwrite"]), (scene, [])):
        assert convert([str(lens), "-o", str(output), *more]) == 2
        assert str(output) in capsys.readouterr().err
    assert lens.read_text() == text and scene.read_text() == "mine"
    assert convert([str(lens), "-o", str(scene), "--overwrite"]) == 0
    assert json.loads(scene.read_text())["components"] or json.loads(scene.read_text())["nsq_gpu"]


def test_no_name_garbles_a_terminal() -> None:
    scene = singlet()
    scene.add_detector("a\x1b[2J\u202e\x9b", live.cs(z=60.0), scene_detector())
    with session() as one, pytest.raises(nsq_gpu.UsageError) as caught:
        one.trace(scene, NUM_RAYS, where="hit(\x1b[2J\u202e)")
    assert str(caught.value).isprintable()
    with pytest.warns(nsq_gpu.NsqGpuWarning) as warned, session() as one:
        one.trace(scene, NUM_RAYS)
    assert all(str(warning.message).isprintable() for warning in warned)


def test_no_name_becomes_a_formula(tmp_path: Path) -> None:
    found = nsq_gpu.Sweep({'"=1+1".r1': np.array([1.0])}, False, {"@SUM(A1)": np.array([2.0])}, {}, num_rays=np.array([5]))
    found.to_csv(tmp_path / "found.csv")
    title = next(csv.reader((tmp_path / "found.csv").open()))
    assert not any(cell.startswith(("=", "+", "-", "@")) for cell in title)
