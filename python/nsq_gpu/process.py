"""Runs the command as a child process that never outlives the call."""

from __future__ import annotations

import json
import math
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from concurrent import futures
from typing import IO, Any

from nsq_gpu.errors import NsqGpuError, TraceTimeoutError, UsageError, error_of
from nsq_gpu.progress import Counter, Shown, Update

#: Longest time between two looks at the clock, and so at Ctrl-C on systems where a wait hides it [s].
TICK = 0.1
#: How long a program that has heard of a stop may take to hand over what it has [s]. A second Ctrl-C ends the wait.
LONG_GRACE = 60.0
#: Why nothing is traced when Python ends: threads that would listen no longer run.
ENDING = "Python is ending, and traces nothing any more; trace before the end of the script"


def seconds(timeout: float | None) -> float | None:
    """Return a timeout as locks and clocks take it: None for one without end.

    Raises:
        UsageError: It is no time.
    """
    try:
        given = math.inf if timeout is None else float(timeout)
    except (TypeError, ValueError):
        given = math.nan
    if not given >= 0.0:
        raise UsageError(f"timeout is {timeout!r}; give a number of seconds, or None for no end")
    return None if given > threading.TIMEOUT_MAX else given


def check_not_ending() -> None:
    """Refuse a trace that begins when Python ends, such as in ``__del__``: it would wait for ever.

    Raises:
        NsqGpuError: Python is ending.
    """
    if sys.is_finalizing():
        raise NsqGpuError(ENDING)


def answer(command: Sequence[str], timeout: float | None = None) -> Any:
    """Return the JSON that a short command prints, whatever its exit code says beside it.

    Raises:
        NsqGpuError: It printed none; the class says why.
        TraceTimeoutError: It ran longer than ``timeout`` [s].
    """
    try:
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False, timeout=seconds(timeout))
    except subprocess.TimeoutExpired:
        raise TraceTimeoutError(f"the command took longer than timeout = {timeout:g} s and was ended") from None
    try:
        return json.loads(done.stdout)
    except ValueError as error:
        if done.returncode != 0:
            raise error_of(done.returncode, done.stderr.decode(errors="replace")) from None
        name = " ".join(command[:2])
        raise NsqGpuError(f"{name}: its answer is no JSON: {error}; install a program of this package's version") from None


def run(command: Sequence[str], timeout: float | None = None, progress: Shown | Counter | None = None,
        accepted: Sequence[int] = (0,), folder: str | None = None, keeps: bool = False) -> tuple[int, str]:
    """Run a command, in ``folder`` if one is given; what it writes to stderr goes to the exception if it fails.

    Returns the exit code, one of those ``accepted``, and what was said. Whatever ends the call early, a timeout, Ctrl-C
    or an exception of the callback, ends the child first. With ``keeps`` the child is asked to stop, as by Ctrl-C, and
    has a moment to write what it has. And the child's stdin is a pipe that this process holds: what
    ends the process, be it SIGKILL, closes the pipe, and the command ends with it.

    Raises:
        NsqGpuError: The exit code was none of those; the class says which.
        TraceTimeoutError: It ran longer than ``timeout`` [s].
    """
    # Ctrl-C interrupts the main thread wherever it is. Were that inside Popen, nobody would hold the child: another
    # thread starts it.
    starting: futures.Future[subprocess.Popen[str]] = futures.Future()
    check_not_ending()
    try:
        threading.Thread(target=_start, args=(command, folder, starting, keeps), daemon=True).start()
        child = starting.result()
        said = _listen(child, timeout, progress)
        code = _end(child)
    except BaseException:
        if not starting.cancel() and starting.exception() is None:
            try:
                if keeps:
                    _stop(starting.result())
            finally:
                starting.result().kill()
                _end(starting.result())
        raise
    text = "\n".join(said)
    if code not in accepted:
        raise error_of(code, text)
    return code, text


def _stop(child: subprocess.Popen[str]) -> None:
    """Ask a child to stop, as by Ctrl-C, and wait for its end.

    Not by SIGINT: a script that a shell runs in the background has that one ignored, and so has its child.
    """
    child.send_signal(signal.SIGTERM)
    try:
        child.wait(LONG_GRACE)
    except subprocess.TimeoutExpired:
        pass


def _start(command: Sequence[str], folder: str | None, starting: futures.Future[subprocess.Popen[str]],
           is_apart: bool) -> None:
    if not starting.set_running_or_notify_cancel():
        return
    try:
        starting.set_result(subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            encoding="utf-8", errors="replace", cwd=folder,
            # A terminal's Ctrl-C is for this process, which stops the child; twice would end the child at once.
            start_new_session=is_apart and os.name != "nt",
        ))
    except BaseException as error:
        starting.set_exception(error)


def _end(child: subprocess.Popen[str]) -> int:
    """Wait for a child that ends; return its exit code."""
    code = child.wait()
    assert child.stdin is not None
    child.stdin.close()
    return code


def _listen(child: subprocess.Popen[str], timeout: float | None, progress: Shown | Counter | None) -> list[str]:
    """Return the lines of stderr when it closes; lines of progress are shown, in the caller's thread."""
    timeout = seconds(timeout)
    deadline = None if timeout is None else time.monotonic() + timeout
    lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    assert child.stderr is not None
    threading.Thread(target=_pump, args=(child.stderr, lines), daemon=True).start()
    said: list[str] = []
    while True:
        if deadline is not None and time.monotonic() > deadline:
            raise TraceTimeoutError(f"the trace took longer than timeout = {timeout:g} s and was ended")
        try:
            line = lines.get(timeout=TICK)
        except queue.Empty:
            continue
        if line is None:
            return said
        update = _update_in(line)
        if update is None:
            said.append(line.rstrip("\n"))
        elif progress is not None:
            progress.show(update)


def _pump(stream: IO[str], lines: queue.SimpleQueue[str | None]) -> None:
    with stream:
        for line in stream:
            lines.put(line)
    lines.put(None)


def _update_in(line: str) -> Update | None:
    if not line.startswith("{"):
        return None
    try:
        return Update(json.loads(line))
    except (ValueError, KeyError, TypeError):
        return None
