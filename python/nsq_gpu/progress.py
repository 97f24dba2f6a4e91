"""How far a call is: in tqdm's bar, of the terminal or of the notebook, or by a function of the caller."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

from nsq_gpu.arguments import missing
from nsq_gpu.errors import UsageError

#: Called with the rays done, the rays in all, and the rays per second.
ProgressCallback = Callable[[int, int, float], None]
#: What calls take: True shows a bar, False none, None one of a call that lasts, where somebody sees it.
Progress = bool | ProgressCallback | None

#: A bar that nobody asked for comes after so long [s].
UNASKED_AFTER = 2.0
#: Shortest time between two drawings of a bar [s].
_INTERVAL = 0.1
#: tqdm knows nothing of targets and time limits: the time that is left is the program's.
_FORMAT = "{l_bar}{bar}| {n_fmt} of {total_fmt} rays [{elapsed}, {rate_fmt}{postfix}]"


class Update:
    """One line of progress."""

    def __init__(self, said: dict[str, Any]) -> None:
        self.rays = int(said["rays"])
        self.num_rays = int(said["num_rays"])
        self.rays_per_sec = float(said["rays_per_sec"])
        #: Time to the end [s]: the last ray, the target or the time limit.
        self.eta_sec = float(said["eta_sec"])
        #: The largest relative standard error; None as long as it is not known.
        self.relative_error: float | None = said.get("relative_error")


class Shown:
    """Where the progress of a call is shown: in a bar, by a function, or nowhere.

    Raises:
        UsageError: ``progress`` is neither.
        MissingLibraryError: A bar was asked for, and tqdm is not installed.
    """

    def __init__(self, progress: Progress) -> None:
        self._call = progress if callable(progress) else None
        self._bar: _Bar | None = None
        if progress is None:
            self._bar = _Bar(UNASKED_AFTER) if _is_watched() and find_spec("tqdm") is not None else None
        elif self._call is None and progress not in (True, False):
            raise UsageError(f"progress is {progress!r}; give True, False, None, or a function of the rays done, the rays in "
                             "all and the rays per second")
        elif self._call is None and progress:
            if find_spec("tqdm") is None:
                raise missing("tqdm", "notebook", "progress=True needs")
            self._bar = _Bar(0.0)

    def __enter__(self) -> Shown:
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close(is_whole=kind is None)

    @property
    def is_wanted(self) -> bool:
        """Return whether somebody wants to hear how far the call is."""
        return self._call is not None or self._bar is not None

    @property
    def mode(self) -> str:
        """What the command is given as ``--progress``."""
        return "json" if self.is_wanted else "never"

    def show(self, update: Update) -> None:
        """Show how far a call is."""
        if self._bar is not None:
            self._bar.show(update)
        elif self._call is not None:
            self._call(update.rays, update.num_rays, update.rays_per_sec)

    def begin(self, num_rays: int) -> None:
        """Show a bar of a call that has done nothing yet, and says nothing for a while."""
        if self._bar is not None:
            self._bar.show(Update({"rays": 0, "num_rays": num_rays, "rays_per_sec": 0.0, "eta_sec": 0.0}))

    @property
    def of_json(self) -> Callable[[dict[str, Any]], None] | None:
        """What shows a line of the program's; None if nobody wants to hear."""
        return (lambda said: self.show(Update(said))) if self.is_wanted else None


class Counter:
    """Counts the rays of traces of which a call consists, and shows how many are done."""

    def __init__(self, shown: Shown, num_rays: int) -> None:
        self._shown = shown
        self._num_rays = num_rays
        self._done = 0
        self._start = time.monotonic()
        shown.begin(num_rays)

    def show(self, update: Update) -> None:
        """Show how far the trace that runs is."""
        self._show(update.rays)

    def add(self, rays: int, relative_error: float | None = None) -> None:
        """Show that so many more rays are done."""
        self._done += rays
        self._show(0, relative_error)

    @property
    def of_json(self) -> Callable[[dict[str, Any]], None] | None:
        """What shows a line of the program's about the trace that runs; None if nobody wants to hear."""
        return (lambda said: self._show(int(said["rays"]))) if self._shown.is_wanted else None

    def _show(self, rays: int, relative_error: float | None = None) -> None:
        done = self._done + rays
        rate = done / max(time.monotonic() - self._start, 1e-9)
        left = (self._num_rays - done) / rate if done else 0.0
        self._shown.show(Update({"rays": done, "num_rays": self._num_rays, "rays_per_sec": rate, "eta_sec": left,
                                 "relative_error": relative_error}))


def _is_watched() -> bool:
    """Return whether somebody sees a bar: stderr is a terminal, or this is a notebook's kernel."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return hasattr(shell, "kernel") or bool(getattr(sys.stderr, "isatty", bool)())


class _Bar:
    """A bar of tqdm's, which comes after a while and vanishes when the call is done."""

    def __init__(self, after: float) -> None:
        self._start = time.time()
        self._due = time.monotonic() + after
        self._tqdm: Any = None

    def show(self, update: Update) -> None:
        """Draw the bar anew, unless it was drawn just now."""
        now = time.monotonic()
        if now < self._due and (self._tqdm is None or update.rays < update.num_rays):
            return
        self._due = now + _INTERVAL
        if self._tqdm is None:
            self._tqdm = self._made(update.num_rays)
        self._tqdm.total, self._tqdm.n = update.num_rays, update.rays
        left = f"{update.eta_sec:.0f} s left" if update.rays else "waiting"
        if update.relative_error is not None:
            left += f", error {100.0 * update.relative_error:.2g} %"
        self._tqdm.set_postfix_str(left)

    def close(self, is_whole: bool) -> None:
        """Take the bar away; a notebook keeps the bar of a call that failed, in red."""
        if self._tqdm is None:
            return
        if is_whole:
            # With a target error fewer rays than all are enough.
            self._tqdm.total = self._tqdm.n
        self._tqdm.close()

    def _made(self, num_rays: int) -> Any:
        from tqdm.auto import tqdm

        made = tqdm(total=num_rays, unit=" rays", unit_scale=True, leave=False, dynamic_ncols=True, bar_format=_FORMAT)
        # The call began before its bar came.
        made.start_t = self._start
        return made
