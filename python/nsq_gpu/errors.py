"""What can go wrong between a live scene and its result.

The classes follow the exit codes of the command; ``exit_code`` is ``None`` where no command ran or it was ended.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from typing import Any

import optiland


#: Characters that move a terminal's cursor, or turn the order in which text is read; names in files of others may hold them.
_ACTIVE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def _plain(message: str) -> str:
    """Return a message that cannot garble a terminal."""
    return _ACTIVE.sub(lambda found: found[0].encode("unicode_escape").decode(), str(message))


class NsqGpuError(RuntimeError):
    """A trace or an export failed; the message says where and why."""

    #: Exit code of the command.
    exit_code: int | None = None
    #: What was computed before, as the call would have returned it, with ``partial`` set; None if nothing was.
    partial: Any = None

    def __init__(self, message: str, exit_code: int | None = None, stderr: str = "") -> None:
        super().__init__(_plain(message))
        self.exit_code = exit_code if exit_code is not None else type(self).exit_code
        #: All that the command wrote to stderr.
        self.stderr = stderr


class UsageError(NsqGpuError):
    """Options that the command refuses, or a file that it cannot read or write."""

    exit_code = 2


class MissingLibraryError(NsqGpuError, ImportError):
    """A library that a call needs is not installed; the message has the command that installs it."""


class SceneError(NsqGpuError):
    """The tracer refuses the scene."""

    exit_code = 3


class UnknownNameError(UsageError, SceneError, KeyError):
    """Nothing in the scene has this name; the message has the nearest name that is right.

    Older versions gave UsageError for a name of no entry, and SceneError for a name of no number. It is both.
    """

    # KeyError's own shows the message in quotes.
    __str__ = RuntimeError.__str__


class UnsupportedSceneError(SceneError):
    """The scene holds something that a scene file cannot express; nothing was written or traced."""


class AdapterError(NsqGpuError):
    """No adapter, or none that fits the request."""

    exit_code = 4


class DeviceError(NsqGpuError):
    """The device was lost or ran out of memory."""

    exit_code = 5


class TraceTimeoutError(NsqGpuError, TimeoutError):
    """The trace took longer than ``timeout`` and was ended."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C ended a call that had computed something.

    >>> try:
    ...     found = session.sweep(scene, {"L1.r1": radii}, 1_000_000)
    ... except nsq_gpu.Interrupted as stop:
    ...     found = stop.partial

    Where nothing was computed yet, a plain KeyboardInterrupt is raised. In a notebook, ``sys.last_value.partial`` is what
    the stopped cell had computed.
    """

    def __init__(self, partial: Any) -> None:
        super().__init__("interrupted; what was computed is in the exception's `partial`: in a notebook, or a shell of Python, "
                         "`import sys; sys.last_value.partial`")
        #: What was computed, as the call would have returned it, with ``partial`` set.
        self.partial = partial


def with_partial(stop: BaseException, partial: Any) -> BaseException:
    """Return the exception of a stop or an error, with what was computed before; None if nothing was."""
    if isinstance(stop, KeyboardInterrupt):
        return stop if partial is None else Interrupted(partial)
    stop.partial = partial  # type: ignore[attr-defined]
    return stop


class BinaryNotFoundError(NsqGpuError, FileNotFoundError):
    """The program ``nsq-gpu`` is not where it was looked for."""


class NsqGpuWarning(UserWarning):
    """What the tracer finds doubtful in a scene, such as rotations that look like degrees."""


class ResultWarning(NsqGpuWarning):
    """Numbers of a result that are not what was asked for: light cut off by the depth limit, maps that are noise."""


class ToleranceWarning(NsqGpuWarning):
    """The rays or the time ended before the target for the error was met; the result is what was reached."""


def wants_gradient(value: object) -> bool:
    """Return whether a value is a tensor that wants a gradient."""
    return bool(getattr(value, "requires_grad", False))


def without_gradient(name: str, value: Any, remedy: str = "detach it") -> Any:
    """Return a number as it is, unless it is a tensor that wants a gradient, which its taker would drop.

    Raises:
        UnsupportedSceneError: It is such a tensor.
    """
    if wants_gradient(value):
        raise UnsupportedSceneError(f"{name}: it has requires_grad=True, and nothing is differentiated by it here; {remedy}")
    return value


#: Exit code of a trace that is whole but whose target was not met.
TOLERANCE_NOT_MET = 6

_BY_EXIT_CODE: dict[int, type[NsqGpuError]] = {
    cls.exit_code: cls for cls in (UsageError, SceneError, AdapterError, DeviceError) if cls.exit_code is not None
}


def error_of(exit_code: int, stderr: str) -> NsqGpuError:
    """Return the exception that an exit code and the text on stderr stand for."""
    message = re.sub(r"^(nsq-gpu: |error: )+", "", stderr.strip()) or "the command said nothing"
    if exit_code < 0:
        message = f"ended by signal {-exit_code}: {message}"
    return _BY_EXIT_CODE.get(exit_code, NsqGpuError)(f"nsq-gpu: {message}", exit_code, stderr)


#: Folders whose frames are none of the user's.
_OURS = tuple(os.path.dirname(os.path.abspath(file)) + os.sep for file in (__file__, optiland.__file__ or __file__))


def warn(message: str, category: type[Warning]) -> None:
    """Give a warning as one of the user's line, which called this package, Optiland, or Torch, which calls this package."""
    def is_users(frame: Any) -> bool:
        is_torchs = str(frame.f_globals.get("__name__", "")).startswith("torch.")
        return not is_torchs and not os.path.abspath(frame.f_code.co_filename).startswith(_OURS)

    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and not is_users(frame):
        frame, level = frame.f_back, level + 1
    warnings.warn(_plain(message), category, stacklevel=level)
