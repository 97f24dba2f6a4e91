"""``pst``: point source transmittance, direction by direction, here or on a Dask cluster."""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from optiland.nonsequential import NSQScene

from nsq_gpu.binary import find_binary
from nsq_gpu.errors import (
    TOLERANCE_NOT_MET,
    NsqGpuError,
    NsqGpuWarning,
    SceneError,
    ToleranceWarning,
    TraceTimeoutError,
    UsageError,
    warn,
    with_partial,
)
from nsq_gpu.export import to_json
from nsq_gpu.export.values import whole_number
from nsq_gpu.process import run, seconds
from nsq_gpu.progress import Counter, Progress, Shown
from nsq_gpu.pst_table import JSON, Place, PstResult, of_points
from nsq_gpu.scattering import ScatterProb, ScatterTo, answering, exported_of, file_of, keys_of, scattered
from nsq_gpu.session import EXPORTED, as_written

Json = dict[str, Any]

#: Most angles, and most azimuths: a command's line has an end.
_MOST = 4000
#: Parts of the directions, of which each starts a program, where a bar or a function follows them.
_PARTS_SHOWN = 8
#: Parts for each worker of a cluster.
_PARTS = 4


def pst(scene: NSQScene | str | os.PathLike[str], angles_deg: Sequence[float] | np.ndarray, detector: str, *,
        azimuths_deg: Sequence[float] | np.ndarray = (0.0,), source: str | None = None, pivot: Sequence[float] | None = None,
        target_error: float | str | None = None, num_rays: int = 1_000_000, scatter_prob: ScatterProb = None,
        scatter_to: ScatterTo = None, seed: int = 0, max_depth: int | None = None, precision: str = "auto", client: Any = None,
        parts: int | None = None, adapter: str | None = None, binary: str | os.PathLike[str] | None = None,
        timeout: float | None = None, progress: Progress = None, **options: Any) -> PstResult:
    """Say how much of the light of a far point comes to a detector, by the angle off the axis: point source transmittance.

    PST is the mean irradiance on the detector over the irradiance of the beam on a plane across it (Fest, Stray Light Analysis
    and Control, SPIE 2013, section 2.2). The beam is turned about a pivot. Standard errors are those between rounds of rays.
    All directions take the same draws, so that errors of neighbours are alike.

    >>> found = nsq_gpu.pst(telescope, range(0, 61, 2), "image", target_error="10%", scatter_to={"M*": "image"})
    >>> found.plot(by="first_scatterer")

    Args:
        scene: The live scene, or its file.
        angles_deg: Angles of the source off its axis [deg].
        detector: The detector. It has an area: it is no far field.
        azimuths_deg: Azimuths of the source [deg], from the x of its frame towards its y.
        source: The collimated source that is turned. None takes a beam that overfills the scene in the place of all sources,
            along the axis and with the spectrum of the first.
        pivot: The point about which the source is turned [mm]; None is the middle of the scene.
        target_error: A direction ends at this relative standard error, such as ``0.1`` or ``"10%"``. ToleranceWarning says where it
            was not reached; ``reached`` of the result has it by direction.
        num_rays: Rays of each direction, at most where there is a target error.
        scatter_prob: As in :class:`nsq_gpu.NsqGpuBackend`.
        scatter_to: As in :class:`nsq_gpu.NsqGpuBackend`.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray. None takes twice the surfaces that do not absorb, but at least 16.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        client: A ``dask.distributed.Client``, or the address of a scheduler: workers share the directions. Bits are as in a call
            without it, where the adapters are alike. None traces here.
        parts: Parts of the directions, a task each; by default four a worker. Each starts a program and compiles the shaders.
        adapter: A part of the adapter's name, here and on workers.
        binary: Path of the program, here and on workers.
        timeout: Longest time of the call [s].
        progress: As in :class:`nsq_gpu.NsqGpuBackend`, with the rays of all directions. True and a function part the
            directions into eight, of which each starts a program. None shows no bar, unless there is a client.
        options: Further options of ``nsq-gpu pst`` by their names, such as ``guide=True`` or ``sampler="sobol"``.

    Raises:
        UsageError: An argument makes no sense in this scene, such as a name of no detector.
        NsqGpuError: One of its other subclasses, by what went wrong; ``partial`` has the directions that are done.
        Interrupted: Ctrl-C ended the call; ``partial`` has the directions that are done. So it is with TraceTimeoutError.
    """
    angles, azimuths = angles_of_axis("angles_deg", angles_deg), angles_of_axis("azimuths_deg", azimuths_deg)
    if not isinstance(detector, str):
        raise UsageError(f"detector is {detector!r}; give a name")
    if parts is not None and whole_number("parts", parts) < 1:
        raise UsageError(f"parts is {parts!r}; give 1 or more")
    keys, rays = keys_of(scatter_prob, scatter_to), whole_number("num_rays", num_rays)
    named = {"num_rays": rays, "seed": whole_number("seed", seed), "precision": precision, "detector": detector, "source": source,
             "pivot": None if pivot is None else point_of(pivot), "target_error": target_error, "adapter": adapter,
             "max_depth": None if max_depth is None else whole_number("max_depth", max_depth), **as_written(options)}
    arguments = [f"--{name.replace('_', '-')}={value}" for name, value in named.items() if value is not None]
    points: dict[Place, Json] = {}
    heard = _Heard()

    def partial() -> PstResult | None:
        return of_points(detector, angles, azimuths, points, True) if points else None

    try:
        # One program says nothing until its last direction is done.
        with Shown(progress if client is not None else progress or False) as shown, answering(keys):
            counted = Counter(shown, len(angles) * len(azimuths) * rays)
            if client is None:
                shares = _parts(angles, azimuths, _PARTS_SHOWN if progress else 1)
                found_by_part = _here(scene, keys, shares, arguments, binary, timeout)
            else:
                found_by_part = _on_cluster(scene, keys, angles, azimuths, arguments, binary, timeout, client, parts)
            with closing(found_by_part):
                for part, found in found_by_part:
                    points.update(part.places(found.points))
                    heard.add(found)
                    if found.failure is not None:
                        raise found.failure
                    counted.add(len(part.angles) * len(part.azimuths) * rays)
    except (KeyboardInterrupt, NsqGpuError) as stop:
        raise with_partial(stop, partial())
    heard.warn(len(points))
    return of_points(detector, angles, azimuths, points, False)


def angles_of_axis(name: str, given: Any) -> np.ndarray:
    """Return angles [deg] of one axis, each once."""
    try:
        found = np.atleast_1d(np.asarray(list(given) if not np.isscalar(given) else given, dtype=float))
    except (TypeError, ValueError):
        found = np.array([np.nan])
    if found.ndim != 1 or not found.size or not (np.abs(found) <= 360.0).all():
        raise UsageError(f"{name} is {given!r}; give angles from -360 to 360 degrees, such as [0, 5, 10]")
    if len(np.unique(found)) < found.size:
        raise UsageError(f"{name} has an angle twice; give each once")
    if found.size > _MOST:
        raise UsageError(f"{name} has {found.size} angles; give at most {_MOST}")
    return found


def point_of(given: Any) -> str:
    """Return a point [mm] as the program reads it."""
    try:
        parts = [float(part) for part in given]
    except (TypeError, ValueError):
        parts = []
    if len(parts) != 3 or not np.isfinite(parts).all():
        raise UsageError(f"pivot is {given!r}; give three numbers, such as (0, 0, -100) [mm]")
    return _listed(parts)


def _listed(numbers: Sequence[float] | np.ndarray) -> str:
    return ",".join(repr(float(number)) for number in numbers)


# Parts of the directions


class Part(NamedTuple):
    """Directions that one program traces: all angles of a range, at all azimuths of a range."""

    angles: np.ndarray
    azimuths: np.ndarray
    #: Places of the first ones among all.
    first: Place

    def arguments(self) -> list[str]:
        """Return the options that say them."""
        return [f"--angles={_listed(self.angles)}", f"--azimuths={_listed(self.azimuths)}"]

    def places(self, points: Sequence[Json]) -> dict[Place, Json]:
        """Return points in the program's order by their places among all directions."""
        rows = len(self.angles)
        return {(self.first[0] + index % rows, self.first[1] + index // rows): point for index, point in enumerate(points)}


def _parts(angles: np.ndarray, azimuths: np.ndarray, most: int) -> list[Part]:
    """Return about so many parts; of one azimuth each, unless it is one part."""
    if most <= 1:
        return [Part(angles, azimuths, (0, 0))]
    # Each azimuth has as many parts.
    count = min(max(most // len(azimuths), 1), len(angles))
    ends = [len(angles) * index // count for index in range(count + 1)]
    return [Part(angles[start:end], azimuths[z : z + 1], (start, z)) for z in range(len(azimuths))
            for start, end in zip(ends, ends[1:], strict=False)]


class Found(NamedTuple):
    """What a program says of a part."""

    #: Directions, in its order; after a stop the last ones are missing.
    points: list[Json]
    warnings: list[str]
    #: True where a target error was not reached.
    missed: bool = False
    #: What ended it before its end.
    failure: NsqGpuError | None = None


class _Heard:
    """What programs said of their parts."""

    def __init__(self) -> None:
        self._warnings: dict[str, None] = {}
        self._missed = 0

    def add(self, found: Found) -> None:
        self._warnings |= dict.fromkeys(found.warnings)
        if found.missed:
            self._missed += sum(not point["reached"] for point in found.points)

    def warn(self, num_directions: int) -> None:
        for warning in self._warnings:
            warn(warning, NsqGpuWarning)
        if self._missed:
            warn(f"{self._missed} of {num_directions} directions have not reached target_error; give more rays by num_rays, or send "
                 "more of them to the detector by scatter_to and scatter_prob", ToleranceWarning)


def traced(program: str, scene: str, part: Part, arguments: Sequence[str], timeout: float | None, folder: Path) -> Found:
    """Trace a part of the directions of a scene's file; results go through a folder.

    Raises:
        KeyboardInterrupt: Ctrl-C; so it is with TraceTimeoutError. What is done is then in the folder: :func:`left`.
    """
    command = [program, "pst", *part.arguments(), *arguments, f"--output={folder}", "--", scene]
    try:
        code, said = run(command, timeout, accepted=(0, TOLERANCE_NOT_MET), keeps=True)
    except (KeyboardInterrupt, TraceTimeoutError):
        raise
    except NsqGpuError as error:
        found = left(folder)
        if found is None:
            raise
        return found._replace(failure=error)
    found = left(folder)
    if found is None:
        raise NsqGpuError(f"{program} ended without an error, and without a result: is it nsq-gpu?")
    lines = said.splitlines()
    warnings = [line.removeprefix("warning: ") for line in lines if line.startswith("warning: ")]
    # Which other detectors see no light in some direction is nothing to warn of.
    warnings = [warning for warning in warnings if not warning.startswith("no ray reached ")]
    return found._replace(warnings=warnings, missed=code == TOLERANCE_NOT_MET)


def left(folder: Path) -> Found | None:
    """Return what a program has left in a folder; None if it has done nothing."""
    file = folder / JSON
    return Found(json.loads(file.read_text(encoding="utf-8"))["points"], []) if file.exists() else None


@contextmanager
def _named(file: Path, folder: Path) -> Iterator[None]:
    """Call a file of ours in an error what it is; it is gone when the message is read."""
    try:
        yield
    except SceneError as error:
        if file.parent != folder:
            raise
        raise type(error)(str(error).replace(f"{file}: ", f"{EXPORTED}: "), stderr=error.stderr) from None


def _here(scene: Any, keys: Json, parts: Sequence[Part], arguments: Sequence[str], binary: Any,
          timeout: float | None) -> Iterator[tuple[Part, Found]]:
    """Yield each part of the directions with what this machine found. What ends it early comes after what was done before."""
    program, timeout = find_binary(binary), seconds(timeout)
    end = None if timeout is None else time.monotonic() + timeout
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        file = file_of(scene, keys, folder)
        for number, part in enumerate(parts):
            rest = None if end is None else max(end - time.monotonic(), 0.0)
            out = folder / f"out_{number}"
            try:
                with _named(file, folder):
                    yield part, traced(program, str(file), part, arguments, rest, out)
            except (KeyboardInterrupt, TraceTimeoutError) as stop:
                if (found := left(out)) is not None:
                    yield part, found
                if isinstance(stop, TraceTimeoutError):
                    raise TraceTimeoutError(f"the directions took longer than timeout = {timeout:g} s and were ended") from None
                raise


def _on_cluster(scene: Any, keys: Json, angles: np.ndarray, azimuths: np.ndarray, arguments: Sequence[str], binary: Any,
                timeout: float | None, client: Any, parts: int | None) -> Iterator[tuple[Part, Found]]:
    """Yield each part of the directions with what a worker found, in whichever order they are done."""
    from nsq_gpu import cluster

    text = to_json(scattered(exported_of(scene), keys).document, indent=None)
    shares: list[Part] = []

    def calls(workers: int) -> list[tuple[Any, ...]]:
        shares[:] = _parts(angles, azimuths, max(parts or _PARTS * workers, 2))
        return [(part, arguments, binary) for part in shares]

    for place, answer in cluster.spread(trace_part, text, calls, client, find_binary(binary), timeout):
        if isinstance(answer, NsqGpuError):
            raise answer
        yield shares[place], answer


def trace_part(text: str, part: Part, arguments: Sequence[str], binary: str | None) -> Any:
    """Trace a part of the directions of a scene's text, on a worker."""
    from nsq_gpu import cluster

    program = find_binary(binary)

    def found(folder: Path) -> Found | NsqGpuError:
        file = folder / "scene.json"
        file.write_text(text, encoding="utf-8")
        try:
            with _named(file, folder):
                return traced(os.path.abspath(program), str(file), part, arguments, None, folder / "out")
        except (UsageError, SceneError) as error:
            # No other worker would do better: an exception would be tried again.
            return error

    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        return cluster.traced_by(program, found(Path(name)))
