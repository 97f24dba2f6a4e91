"""Runs the command as a child process that never outlives the call."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import IO

from nsq_gpu.errors import TraceTimeoutError, error_of

#: Called with the rays done, the rays in all, and the rays per second.
ProgressCallback = Callable[[int, int, float], None]

#: Longest time between two looks at the clock, and so at Ctrl-C on systems where a wait hides it [s].
_TICK = 0.1


def run(command: Sequence[str], timeout: float | None = None, progress: ProgressCallback | None = None) -> None:
    """Run a command; what it writes to stderr goes to the exception if it fails.

    Whatever ends the call early, a timeout, Ctrl-C or an exception of the callback, ends the child first. And the
    child's stdin is a pipe that this process holds: what ends the process, be it SIGKILL, closes the pipe, and the
    command ends with it.

    Raises:
        NsqGpuError: The exit code was not 0; the class says which.
        TraceTimeoutError: It ran longer than ``timeout`` [s].
    """
    child = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        encoding="utf-8", errors="replace",
    )
    try:
        said = _listen(child, timeout, progress)
    except BaseException:
        child.kill()
        raise
    finally:
        code = child.wait()
        assert child.stdin is not None
        child.stdin.close()
    if code != 0:
        raise error_of(code, "\n".join(said))


def _listen(child: subprocess.Popen[str], timeout: float | None, progress: ProgressCallback | None) -> list[str]:
    """Return the lines of stderr when it closes; lines of progress go to the callback, in the caller's thread."""
    deadline = None if timeout is None else time.monotonic() + timeout
    lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    assert child.stderr is not None
    threading.Thread(target=_pump, args=(child.stderr, lines), daemon=True).start()
    said: list[str] = []
    while True:
        if deadline is not None and time.monotonic() > deadline:
            raise TraceTimeoutError(f"the trace took longer than timeout = {timeout:g} s and was ended")
        try:
            line = lines.get(timeout=_TICK)
        except queue.Empty:
            continue
        if line is None:
            return said
        update = _update_in(line)
        if update is None:
            said.append(line.rstrip("\n"))
        elif progress is not None:
            progress(*update)


def _pump(stream: IO[str], lines: queue.SimpleQueue[str | None]) -> None:
    with stream:
        for line in stream:
            lines.put(line)
    lines.put(None)


def _update_in(line: str) -> tuple[int, int, float] | None:
    if not line.startswith("{"):
        return None
    try:
        update = json.loads(line)
        return int(update["rays"]), int(update["num_rays"]), float(update["rays_per_sec"])
    except (ValueError, KeyError, TypeError):
        return None


class ProgressBar:
    """A one-line bar on stderr. Python draws it, because a notebook shows nothing that a child writes."""

    _CELLS = 32

    def __init__(self, stream: IO[str] | None = None) -> None:
        self._stream = stream or sys.stderr
        self._width = 0

    def __call__(self, rays: int, num_rays: int, rays_per_sec: float) -> None:
        share = rays / max(num_rays, 1)
        bar = ("=" * round(share * self._CELLS)).ljust(self._CELLS)
        left = (num_rays - rays) / max(rays_per_sec, 1e-9)
        text = f"[{bar}] {share:4.0%}  {rays:,} of {num_rays:,} rays, {rays_per_sec:,.0f}/s, {left:.0f} s left"
        self._write(text)

    def close(self) -> None:
        """Take the bar away."""
        if self._width:
            self._write("")
            self._stream.write("\r")
            self._stream.flush()

    def _write(self, text: str) -> None:
        self._stream.write("\r" + text.ljust(self._width))
        self._stream.flush()
        self._width = max(self._width, len(text))
