"""Bars of progress: on every call that lasts, in a terminal and nowhere that nobody sees it."""

from __future__ import annotations

import importlib.util
import inspect
import io
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

import nsq_gpu
import nsq_gpu.cluster
from nsq_gpu import NsqGpuBackend, Session, progress
from nsq_gpu.progress import Counter, Shown, Update
from tests import live
from tests.live import bench

pytestmark = pytest.mark.in_turn

RADII = {"screen.z": [30.0, 31.0, 32.0]}
NUM_RAYS = 50_000

#: A call of each function that traces, with a keyword ``progress``, and the rays that it traces in all.
CALLS: dict[str, tuple[Callable[..., Any], int]] = {
    "backend": (lambda **more: bench().trace(NUM_RAYS, backend=live.backend(**more)), NUM_RAYS),
    "a process of its own": (lambda **more: bench().trace(1_200_000, backend=live.backend(**more)), 1_200_000),
    "session": (lambda **more: _session("trace", NUM_RAYS, **more), NUM_RAYS),
    "sweep": (lambda **more: _session("sweep", RADII, NUM_RAYS, **more), 3 * NUM_RAYS),
    "jacobian": (lambda **more: nsq_gpu.jacobian(bench(), "lamp.total_flux", NUM_RAYS, binary=live.binary(), **more), NUM_RAYS),
    "loss_gradient": (lambda **more: nsq_gpu.loss_gradient(bench(), "lamp.total_flux", {"screen": np.ones((12, 12))}, NUM_RAYS,
                                                           binary=live.binary(), **more), NUM_RAYS),
    "diff": (lambda **more: nsq_gpu.diff(bench(), bench(), NUM_RAYS, binary=live.binary(), **more), 2 * NUM_RAYS),
    "cluster.trace": (lambda **more: nsq_gpu.cluster.trace(bench(), NUM_RAYS, parts=2, binary=live.binary(), **more), NUM_RAYS),
    "cluster.sweep": (lambda **more: nsq_gpu.cluster.sweep(bench(), RADII, NUM_RAYS, binary=live.binary(), **more),
                      3 * NUM_RAYS),
}


def _session(method: str, *arguments: Any, **more: Any) -> Any:
    with Session(binary=live.binary()) as session:
        return getattr(session, method)(bench(), *arguments, **more)


def update(rays: int, num_rays: int = 1000, **more: Any) -> Update:
    return Update({"rays": rays, "num_rays": num_rays, "rays_per_sec": 1.0, "eta_sec": 4.0, **more})


@contextmanager
def watched() -> Iterator[io.StringIO]:
    """Give what is written to a terminal. A fixture could not: pytest puts its own stderr in place when a test begins."""
    stream = io.StringIO()
    stream.isatty = lambda: True  # type: ignore[method-assign]
    with mock.patch("sys.stderr", stream):
        yield stream


@pytest.mark.parametrize("name", CALLS)
def test_every_call_that_lasts_counts_its_rays(name: str) -> None:
    call, num_rays = CALLS[name]
    seen: list[tuple[int, int, float]] = []
    call(progress=lambda *status: seen.append(status))
    done = [rays for rays, _, _ in seen]
    assert done == sorted(done) and seen[-1][:2] == (num_rays, num_rays) and seen[-1][2] > 0.0


@pytest.mark.parametrize("name", CALLS)
def test_every_call_that_lasts_shows_a_bar_where_a_terminal_is(name: str) -> None:
    # A call that nobody asked for a bar shows one all the same, as soon as it lasts.
    with watched() as stream, mock.patch.object(progress, "UNASKED_AFTER", 0.0):
        CALLS[name][0]()
    # Neither the width of the bar nor the rate is certain.
    assert re.search(r"100%\|[█#]+\| \S+ of \S+ rays \[\d\d:\d\d, \S+ rays/s, 0 s left", stream.getvalue())


def test_all_that_take_rays_take_progress() -> None:
    functions = [nsq_gpu.jacobian, nsq_gpu.loss_gradient, nsq_gpu.diff, nsq_gpu.cluster.trace, nsq_gpu.cluster.sweep,
                 Session.trace, Session.sweep, NsqGpuBackend]
    public = [function for function in vars(nsq_gpu).values() if inspect.isfunction(function)]
    assert all("progress" in inspect.signature(function).parameters for function in functions
               + [function for function in public if "num_rays" in inspect.signature(function).parameters])
    assert all(inspect.signature(function).parameters["progress"].default is None for function in functions)


def test_nobody_is_shown_a_bar_of_a_call_that_is_over_soon() -> None:
    with watched() as stream:
        CALLS["sweep"][0]()
        CALLS["backend"][0]()
    assert stream.getvalue() == ""


def test_a_bar_that_nobody_asked_for_comes_after_two_seconds() -> None:
    now = [100.0]
    with watched() as stream, mock.patch.object(time, "monotonic", lambda: now[0]), Shown(None) as shown:
        for seconds in (0.1, 1.8):
            now[0] += seconds
            shown.show(update(300))
            assert stream.getvalue() == ""
        now[0] += 0.2
        shown.show(update(300))
        assert "30%" in stream.getvalue()


def test_a_bar_that_nobody_sees_is_not_drawn() -> None:
    with mock.patch("sys.stderr", io.StringIO()) as stream, mock.patch.object(progress, "UNASKED_AFTER", 0.0):
        CALLS["sweep"][0]()
    assert stream.getvalue() == ""
    with mock.patch("sys.stderr", None), Shown(None) as shown:
        assert not shown.is_wanted


def test_false_shows_none_anywhere() -> None:
    with watched() as stream, mock.patch.object(progress, "UNASKED_AFTER", 0.0):
        for name in ("backend", "sweep", "diff"):
            CALLS[name][0](progress=False)
    assert stream.getvalue() == ""


def test_the_bar_shows_the_error_and_the_time_that_the_program_expects() -> None:
    with watched() as stream, Shown(True) as shown:
        shown.show(update(500, relative_error=0.0123))
        text = stream.getvalue()
        assert "50%" in text and "500 of 1.00k rays" in text and "4 s left, error 1.2 %" in text
    # It is taken away.
    assert re.search(r"\r +\r$", stream.getvalue())


def test_a_call_without_tqdm_shows_none_and_names_the_command_that_installs_it() -> None:
    found = importlib.util.find_spec
    with watched(), mock.patch.object(progress, "find_spec", lambda name: None if name == "tqdm" else found(name)):
        with Shown(None) as shown:
            assert not shown.is_wanted
        with pytest.raises(nsq_gpu.MissingLibraryError, match=r"tqdm is not installed, and progress=True needs it: "
                                                              r"pip install 'nsq-gpu\[notebook\]'"):
            CALLS["sweep"][0](progress=True)


@pytest.mark.parametrize("wrong", ["yes", 2, [True]])
def test_what_is_no_progress_is_refused(wrong: Any) -> None:
    with pytest.raises(nsq_gpu.UsageError, match="progress is .*; give True, False, None, or a function"):
        CALLS["session"][0](progress=wrong)


def test_points_that_cannot_be_traced_count_as_well() -> None:
    seen: list[tuple[int, int, float]] = []
    with Session(binary=live.binary()) as session, pytest.warns(nsq_gpu.NsqGpuWarning, match="is left out"):
        session.sweep(bench(), {"screen.width": [60.0, -1.0, np.nan]}, NUM_RAYS, progress=lambda *status: seen.append(status))
    # A point with a number that is none is never sent.
    assert seen[-1][:2] == (2 * NUM_RAYS, 2 * NUM_RAYS)


def test_a_counter_adds_up_traces() -> None:
    seen: list[tuple[int, int, float]] = []
    counted = Counter(Shown(lambda *status: seen.append(status)), 200)
    of_trace = counted.of_json
    assert of_trace is not None
    of_trace({"rays": 40})
    counted.add(100)
    of_trace({"rays": 40})
    counted.add(100)
    assert [rays for rays, _, _ in seen] == [40, 100, 140, 200]


def test_a_terminal_of_its_own_has_the_bar_and_is_clean_afterwards(tmp_path: Path) -> None:
    pty = pytest.importorskip("pty")
    import fcntl
    import struct
    import termios

    script = tmp_path / "script.py"
    script.write_text("import nsq_gpu.progress\nfrom tests.test_progress import CALLS\n"
                      "nsq_gpu.progress.UNASKED_AFTER = 0.0\nCALLS['sweep'][0]()\n", encoding="utf-8")
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    folder = Path(__file__).resolve().parents[1]
    child = subprocess.Popen([sys.executable, script], stderr=theirs, stdout=subprocess.DEVNULL, cwd=folder,
                             env={**os.environ, "PYTHONPATH": str(folder), "NSQ_GPU_BINARY": live.binary()})
    os.close(theirs)
    said = b""
    while True:
        try:
            block = os.read(ours, 4096)
        except OSError:
            break
        said += block
    os.close(ours)
    assert child.wait() == 0
    drawn = [line for line in said.decode().split("\r") if line.strip()]
    assert drawn and "150k of 150k rays" in drawn[-1] and len(drawn[-1].rstrip()) <= 100
    assert re.search(rb"\r +\r$", said)
