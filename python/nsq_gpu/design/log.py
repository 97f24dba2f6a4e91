"""What an optimisation did: its steps, and notes of what was chosen on the way, such as a restart."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from nsq_gpu.display import MOST_ROWS, Displayed, Summary, number
from nsq_gpu.errors import UsageError

#: Notes go here as well, for whoever listens: ``logging.getLogger("nsq_gpu.design").setLevel("INFO")``.
LOGGER = logging.getLogger("nsq_gpu.design")
#: Version of the file.
VERSION = 1


@dataclass(frozen=True)
class Step:
    """A step that an optimiser took."""

    #: Number of the step, from 0.
    step: int
    #: Number of the stage; a stage has one seed, one guide and one number of rays.
    stage: int
    x: list[float]
    merit: float
    standard_error: float
    #: Values of the operands, and their standard errors.
    values: list[float]
    standard_errors: list[float]
    #: Rays of each trace, and all rays so far.
    num_rays: int
    rays_so_far: int
    #: Seconds since the start.
    seconds: float


@dataclass(frozen=True, repr=False)
class Log(Displayed):
    """Steps and notes, in their order."""

    #: Names of the variables and of the operands.
    variables: list[str] = field(default_factory=list)
    operands: list[str] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    #: Notes: the number of steps before it, and what was said.
    notes: list[tuple[int, str]] = field(default_factory=list)
    #: What was frozen: scene, seed, precision, depth and more.
    settings: dict[str, Any] = field(default_factory=dict)

    def note(self, message: str) -> None:
        """Keep a note, and hand it to Python's logging."""
        self.notes.append((len(self.steps), message))
        LOGGER.info(message)

    def note_once(self, message: str) -> None:
        """Keep a note, unless it is known."""
        if all(message != known for _, known in self.notes):
            self.note(message)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the log as JSON. The file appears whole or not at all.

        Raises:
            UsageError: The file cannot be written.
        """
        path = Path(path)
        content = {"version": VERSION, **asdict(self)}
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_text(json.dumps(content, indent=1), encoding="utf-8")
            part.replace(path)
        except OSError as error:
            raise UsageError(f"log: {path} cannot be written: {error.strerror or error}; name another file") from None

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Log:
        """Read a log that :meth:`save` wrote.

        Raises:
            UsageError: The file is no such log.
        """
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            if content.pop("version") != VERSION:
                raise UsageError(f"{path}: a log of another version; this package reads version {VERSION}")
            content["steps"] = [Step(**step) for step in content["steps"]]
            content["notes"] = [(count, said) for count, said in content["notes"]]
            return cls(**content)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise UsageError(f"{path} is no log of an optimisation: {error}") from None

    @staticmethod
    def check_file(path: str | os.PathLike[str], resume: Log | str | os.PathLike[str] | None = None) -> None:
        """Refuse a file that holds something else than the log that is resumed, or that cannot be written.

        Raises:
            UsageError: It is such a file.
        """
        if not isinstance(path, str | os.PathLike) or not os.fspath(path):
            raise UsageError(f"log is {path!r}; give the name of a file, such as 'design.json'")
        file = Path(path)
        if not os.path.lexists(file):
            try:
                file.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise UsageError(f"log: the folder {file.parent} cannot be made: {error.strerror}; name another file") from None
        elif not file.is_file():
            raise UsageError(f"log: {file} is no file; name a file, such as 'design.json'")
        elif file.stat().st_size:
            try:
                known = Log.load(file)
            except UsageError:
                raise UsageError(f"log: {file} exists, and is no log of an optimisation; name another file") from None
            if isinstance(resume, Log):
                is_named = known.steps == resume.steps
            else:
                is_named = resume is not None and os.path.realpath(file) == os.path.realpath(resume)
            if not is_named:
                raise UsageError(f"log: {file} is the log of another run; name another file, or go on from it by resume={str(file)!r}")
        if not os.access(file.parent, os.W_OK):
            raise UsageError(f"log: nothing can be written into the folder {file.parent}; name another file")

    def __iter__(self) -> Iterator[Step]:
        return iter(self.steps)

    def __len__(self) -> int:
        return len(self.steps)

    def plot(self, *, ax: Any = None, **options: Any) -> Any:
        """Draw the merit over the steps, with standard errors; a line stands where a stage begins.

        Args:
            ax: Matplotlib's axes. None makes a figure.
            options: Further options of Matplotlib's ``errorbar``.

        Returns:
            The axes.
        """
        from nsq_gpu.plotting import _axes

        ax = _axes(ax)
        places = [step.step for step in self.steps]
        ax.errorbar(places, [step.merit for step in self.steps], [step.standard_error for step in self.steps],
                    **{"marker": ".", "capsize": 2, **options})
        for one, other in zip(self.steps, self.steps[1:], strict=False):
            if one.stage != other.stage:
                ax.axvline(other.step - 0.5, color="0.7", linestyle="--")
                ax.annotate(f" {other.num_rays:,} rays", (other.step - 0.5, 1.0), xycoords=("data", "axes fraction"), va="top",
                            fontsize="small", color="0.4")
        if self.steps and min(step.merit for step in self.steps) > 0.0:
            ax.set_yscale("log")
        ax.set_xlabel("step")
        ax.set_ylabel("merit")
        return ax

    def _summary(self) -> Summary:
        rows = [[f"{step.step}", f"{step.stage}", f"{step.num_rays:,}", number(step.merit, 5), number(step.standard_error, 2),
                 *(number(value, 5) for value in (*step.x, *step.values))] for step in self.steps[-MOST_ROWS:]]
        headings = ["step", "stage", "rays", "merit", "error", *self.variables, *self.operands]
        notes = [f"after {count} steps: {said}" if self.steps else said for count, said in self.notes[-MOST_ROWS:]]
        return Summary(f"Log: {len(self.steps)} steps" if self.steps else f"Log: {len(self.notes)} notes", headings, rows, notes=notes)
