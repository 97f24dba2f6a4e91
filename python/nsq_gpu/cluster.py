"""Traces spread over a Dask cluster: the bits of one trace of all rays, whoever traced which of them.

``pip install nsq-gpu[cluster]``. A task traces a range of rays, a pure function of the scene's text, the first ray and
the count. So a task that is lost, repeated or run twice changes nothing. Its result is the bytes of a tally. This process
sums tallies as they come, in any order, and so keeps them when workers end.
"""

from __future__ import annotations

import asyncio
import functools
import hashlib
import itertools
import os
import platform
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent import futures
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from optiland.nonsequential import NSQScene

from nsq_gpu.arguments import missing
from nsq_gpu.binary import find_binary
from nsq_gpu.color import ColorOf, colored
from nsq_gpu.errors import NsqGpuError, SceneError, TraceTimeoutError, UsageError, with_partial
from nsq_gpu.export import export, to_json
from nsq_gpu.integrity import read_report
from nsq_gpu.process import run, seconds
from nsq_gpu.progress import Counter, Progress, Shown
from nsq_gpu.results import Result, check_paths, fill_scene, in_folder, warn_of
from nsq_gpu.scattering import ScatterProb, ScatterTo, answering, keys_of, scattered
from nsq_gpu.session import EXPORTED, Answer, Session, as_written, numbers_of_rays
from nsq_gpu.sweeps import Point, Sweep
from nsq_gpu.sweeps import run as run_points

#: Tallies that are added up at once, without a target error.
_ARITY = 10
#: Rays by which the precision of all workers is chosen: as many as the program looks at.
_PILOT_RAYS = 1 << 13
#: Workers that are reckoned with where none is there yet.
_WORKERS = 8
#: Longest text of a scene that goes with each task [characters].
_LONG = 100_000
#: How often a task is tried again, on whichever worker.
_RETRIES = 3
#: The sums in a folder of results.
_TALLY = "tally.bin"
#: What guides rays, in the folder of a trace.
_GUIDE = "guide.json"
#: Time limit of a trace that learns a guide: its pilot has no limit, and the first rays are enough.
_AT_ONCE = "1ms"
#: Options that say what guides rays.
_OF_GUIDES = ("guide", "guide_from", "guide_to")


class Provenance(NamedTuple):
    """The program that ran a task."""

    #: Name of the machine.
    machine: str
    #: Path of the program there.
    program: str
    #: Operating system and processor.
    platform: str
    version: str
    #: SHA-256 of the program's file.
    sha256: str
    #: Adapter and driver; None if the program refused the task.
    device: str | None = None


class Traced(NamedTuple):
    """What a task returns."""

    #: The bytes of a tally, the answer of a session, or why the program refuses the task.
    answer: Any
    by: Provenance


def trace(scene: NSQScene, num_rays: int, client: Any = None, parts: int | None = None, *, seed: int = 0,
          max_depth: int = 16, precision: str = "auto", adapter: str | None = None, binary: str | None = None,
          any_driver: bool = False, target_error: float | str | None = None, timeout: float | None = None,
          progress: Progress = None, scatter_prob: ScatterProb = None, scatter_to: ScatterTo = None, color: ColorOf = None,
          **options: Any) -> Result:
    """Trace a scene on a Dask cluster; return Optiland's result, and leave live detectors as its own backends do.

    The bits are the same as of ``nsq-gpu trace -n NUM_RAYS`` with ``--strict``, where the adapters allow strict arithmetic.
    Workers may come at any time, and the call waits for them.

    With ``guide=True`` this process learns the guide once, for a trace of ``num_rays``, and sends it to all workers. So it is
    where the scene itself asks for a guide. The bits are the same as of ``--guide``, where the adapter here is as the workers'. Rays
    may then need a larger ``max_depth``, such as four events a face.

    Args:
        scene: The live scene.
        num_rays: Rays to launch; with a target error the most of them.
        client: A ``dask.distributed.Client`` that is not asynchronous, or the address of a scheduler. None starts a
            cluster on this machine, with one worker, and ends it.
        parts: Ranges of rays, a task each; by default four a worker, and 16 a worker with a target error. Where no
            worker is there yet, eight are reckoned with.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`; this process decides it, for all workers.
        adapter: A part of the adapter's name, here and on the workers.
        binary: Path of the program on this machine and on the workers.
        any_driver: True takes workers whose drivers differ from each other; the last bits may then depend on who traced
            which rays.
        target_error: Largest relative error, such as ``0.01`` or ``"1%"``. The result is the shortest prefix of the ranges,
            two or more, that is as certain as that. So it does not depend on who was fast, and its bits are the same as of
            ``-n`` that many rays ``--of-rays NUM_RAYS``, guided by what was learned for all. Ranges beyond it are thrown away.
        timeout: Longest time of the call [s], waits for workers included.
        progress: As in :class:`nsq_gpu.NsqGpuBackend`; a range counts when it is done.
        scatter_prob: As in :class:`nsq_gpu.NsqGpuBackend`.
        scatter_to: As in :class:`nsq_gpu.NsqGpuBackend`.
        color: As in :class:`nsq_gpu.NsqGpuBackend`.
        options: Further options of ``nsq-gpu trace`` by their names, such as ``paths=True``. The table of paths is the
            same as of one trace of all rays. Files of ``guide_from`` and ``guide_to`` are read and written here alone.

    Raises:
        NsqGpuError: One of its subclasses, by what went wrong.
        UsageError: A worker has another driver than the others, or another build of the program.
        TraceTimeoutError: The call took longer than ``timeout``.
        Interrupted: Ctrl-C ended the call. The ``partial`` of this and of the errors above is the result of the ranges that
            were done, where there are any; the live detectors hold it too.
    """
    num_rays, seed, max_depth = numbers_of_rays(num_rays, seed, max_depth).values()
    if num_rays < 2 or parts is not None and parts < 1:
        raise UsageError(f"num_rays is {num_rays} and parts {parts}; give at least 2 rays and 1 part")
    if options.pop("proof", False):
        raise UsageError("proof: the result of a cluster is in memory, without the sums that a proof stands beside; trace parts "
                         "by `nsq-gpu trace --first-ray N --proof -o DIR`, and add them up by `nsq-gpu merge`")
    deadline = _Deadline(timeout)
    target = None if target_error is None else _fraction(target_error)
    keys = keys_of(scatter_prob, scatter_to)
    exported = colored(scattered(export(scene), keys), color)
    text = to_json(exported.document, indent=None)
    program = find_binary(binary)
    options = {name: value for name, value in as_written(options).items() if value is not None}
    if "record_paths" in options:
        check_paths(scene, exported.surface_labels)
    if adapter is not None:
        options["adapter"] = adapter
    if target is not None:
        options["standard_error"] = "on"
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        guiding = _guiding(options, exported.document.get("nsq_gpu", {}).get("sampling"), folder)
        options = {name: value for name, value in options.items() if name not in _OF_GUIDES}
        traced = {"num_rays": num_rays, "seed": seed, "max_depth": max_depth, "precision": precision, **options, **guiding}
        with answering(keys):
            decided = _decide(program, text, folder, traced, timeout)
        file = guiding.get("guide_from", guiding.get("guide_to"))
        guide = None if file is None else Path(file).read_text(encoding="utf-8")
        arguments = [f"--{name.replace('_', '-')}={value}" for name, value in
                     {"seed": seed, "max_depth": max_depth, "of_rays": num_rays, **decided, **options}.items()]

        # The ranges that are done; their tallies, of which the first may be a sum; the same, in a single sum where it is known.
        done: list[tuple[int, int]] = []
        tallies: list[bytes] = []
        sums: list[bytes] = []

        def filled(partial: bool) -> Result:
            """Fill the scene with what is done; return its result."""
            _merge(program, tallies, text, folder, [*_range(*done[0]), *arguments])
            report = read_report(folder / "out")
            reached = report["relative_error"]
            missed = target is not None and not partial and (reached is None or reached > target)
            told = f"nsq-gpu: the relative error is {reached}, above the target of {target}; give more rays"
            warn_of(report, told if missed else None)
            return fill_scene(scene, report, in_folder(folder / "out", report), exported.surface_labels,
                              report["ray_paths"] is not None, partial=partial, text=text)

        try:
            with Shown(progress) as shown, _client(client, deadline) as used:
                workers = len(used.nthreads()) or _WORKERS
                ranges = _ranges(num_rays, parts or (4 if target is None else 16) * workers)
                counted = Counter(shown, num_rays)
                calls = [(first, count, arguments, binary) for first, count in ranges]
                with closing(_answers(used, trace_range, text, calls, program, any_driver, deadline,
                                      in_order=target is not None, guide=guide)) as answers:
                    for place, answer in answers:
                        if isinstance(answer, NsqGpuError):
                            raise answer
                        done.append(ranges[place])
                        sums = tallies = [*sums, answer]
                        error = None
                        if len(tallies) == (_ARITY if target is None else 2):
                            total, report = add(program, tallies, text)
                            sums, error = [total], report["relative_error"]
                        counted.add(ranges[place][1], error)
                        if target is not None and error is not None and error <= target:
                            break
            return filled(partial=False)
        except (KeyboardInterrupt, NsqGpuError) as stop:
            raise with_partial(stop, filled(partial=True) if tallies else None)


def sweep(scene: NSQScene, numbers: Mapping[str, Sequence[float]], num_rays: int, client: Any = None, *, zip: bool = False,
          common_draws: bool = True, maps: bool = False, seed: int = 0, max_depth: int = 16, precision: str = "auto",
          adapter: str | None = None, binary: str | None = None, any_driver: bool = False, timeout: float | None = None,
          progress: Progress = None, scatter_prob: ScatterProb = None, scatter_to: ScatterTo = None, **options: Any) -> Sweep:
    """Trace a scene with every combination of some numbers' values, a task each: :meth:`nsq_gpu.Session.sweep`.

    Each process of a worker keeps a session, so that scenes of one shape are compiled once there. Arguments are as in
    :meth:`nsq_gpu.Session.sweep` and :func:`trace`.

    Raises:
        NsqGpuError: One of its subclasses, by what went wrong.
        UsageError: A worker has another driver or build than the others, or a number is none of the scene.
        TraceTimeoutError: The call took longer than ``timeout``.
        Interrupted: Ctrl-C ended the call. The ``partial`` of this and of the errors above is the sweep of the points that
            were done, where there are any.
    """
    num_rays, seed, max_depth = numbers_of_rays(num_rays, seed, max_depth).values()
    deadline = _Deadline(timeout)
    keys = keys_of(scatter_prob, scatter_to)
    text = to_json(scattered(export(scene), keys).document, indent=None)
    program = find_binary(binary)
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as folder:
        traced = {"num_rays": num_rays, "seed": seed, "max_depth": max_depth, "precision": precision, "adapter": adapter}
        with answering(keys):
            decided = _decide(program, text, Path(folder), traced | as_written(options), timeout)
    named = {"num_rays": num_rays, "max_depth": max_depth, **decided, **options}

    with Shown(progress) as shown, _client(client, deadline) as used:
        def trace_all(points: list[Point]) -> Iterator[Answer | NsqGpuError]:
            known: set[str] = set()
            counted = Counter(shown, len(points) * num_rays)
            calls = [(values, {**named, "seed": seed + index}, adapter, binary) for values, index in points]
            with closing(_answers(used, trace_point, text, calls, program, any_driver, deadline, in_order=True)) as answers:
                for _, answer in answers:
                    if isinstance(answer, Answer):
                        warn_of(answer.report, answer.missed_target, known)
                    counted.add(num_rays)
                    yield answer

        return run_points(trace_all, numbers, zip, common_draws, maps)


def spread(task: Callable[..., Traced], text: str, calls: Callable[[int], Sequence[tuple[Any, ...]]], client: Any, program: str,
           timeout: float | None) -> Iterator[tuple[int, Any]]:
    """Yield place and answer of each call of a task with a scene's text, in whichever order they are done.

    ``calls`` gets how many workers there are, or are reckoned with where none is there yet. Whatever ends this cancels what is left.
    """
    deadline = _Deadline(timeout)
    with _client(client, deadline) as used:
        found = _answers(used, task, text, calls(len(used.nthreads()) or _WORKERS), program, True, deadline, in_order=False)
        with closing(found) as answers:
            yield from answers


def traced_by(program: str, answer: Any) -> Traced:
    """Return what a task returns: its answer, and the program that gave it."""
    return Traced(answer, _provenance(program))


def trace_range(text: str, first: int, count: int, arguments: Sequence[str], binary: str | None,
                guide: str | None = None) -> Traced:
    """Trace rays ``first`` to ``first + count`` of a scene's text; return the bytes of their tally.

    ``guide`` is the text of a file that ``--guide-to`` wrote.
    """
    program = find_binary(binary)
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        (folder / "scene.json").write_text(text, encoding="utf-8")
        if guide is not None:
            (folder / _GUIDE).write_text(guide, encoding="utf-8")
            arguments = [*arguments, f"--guide-from={_GUIDE}"]
        try:
            _run(folder, [program, "trace", "scene.json", *_range(first, count), *arguments, "--progress=never", "--output=out",
                          "--no-pictures"])
        except (UsageError, SceneError) as error:
            # No other worker would do better: an exception would be tried again.
            return Traced(error, _provenance(program))
        return Traced((folder / "out" / _TALLY).read_bytes(), _provenance(program, read_report(folder / "out")))


def trace_point(text: str, numbers: Mapping[str, float], options: Mapping[str, Any], adapter: str | None,
                binary: str | None) -> Traced:
    """Trace a scene's text with some numbers changed, in a session that this process keeps."""
    program = find_binary(binary)
    build = _provenance(program)
    session = _session(program, adapter, build.sha256)
    by = _provenance(program, session.hello())
    try:
        return Traced(session.request(text, options, name=EXPORTED, numbers=numbers), by)
    except (UsageError, SceneError) as error:
        return Traced(error, by)


@functools.lru_cache(maxsize=4)
def _session(program: str, adapter: str | None, sha256: str) -> Session:
    """Return the session of this process on that build: a file that was replaced is started anew."""
    return Session(adapter=adapter, binary=program)


def _fraction(target: float | str) -> float:
    """Return a target error, such as 0.01 or "1%", as a fraction."""
    try:
        found = float(target[:-1]) / 100 if isinstance(target, str) and target.endswith("%") else float(target)
    except ValueError:
        found = 0.0
    if not 0 < found < float("inf"):
        raise UsageError(f'target_error is {target!r}; give a number above 0, such as 0.01 or "1%"')
    return found


class _Deadline:
    """The end of a call's time, if it has one."""

    def __init__(self, timeout: float | None) -> None:
        self.timeout = seconds(timeout)
        self._start = time.monotonic()

    def left(self) -> float | None:
        """Return how much time is left [s].

        Raises:
            TraceTimeoutError: None is.
        """
        if self.timeout is None:
            return None
        left = self._start + self.timeout - time.monotonic()
        if left <= 0.0:
            raise self.error()
        return left

    def error(self) -> TraceTimeoutError:
        """Return the exception that says that no time is left."""
        return TraceTimeoutError(f"the trace took longer than timeout = {self.timeout:g} s and was ended")


@contextmanager
def _client(client: Any, deadline: _Deadline) -> Iterator[Any]:
    """Give the client; of an address, make one; without one, start a cluster on this machine, and end it."""
    distributed = _distributed()
    if client is None:
        # One worker with one thread: workers in processes would share the adapter as well, and start slowly.
        with distributed.LocalCluster(n_workers=1, threads_per_worker=1) as cluster, \
                distributed.Client(cluster, set_as_default=False) as found:
            yield found
    elif isinstance(client, str):
        with _connected(client, deadline) as found:
            yield found
    elif not isinstance(client, distributed.Client):
        raise UsageError(f"client is of type {type(client).__name__}; give a dask.distributed.Client, or the address of a "
                         "scheduler, such as tcp://127.0.0.1:8786")
    elif client.asynchronous:
        raise UsageError("client is asynchronous, and this call waits; give the address in its place, in a thread: "
                         "`await asyncio.to_thread(cluster.trace, scene, num_rays, client.scheduler.address)`")
    elif client.status in ("closing", "closed"):
        raise UsageError("client is closed; give one that is open, or the address of the scheduler")
    else:
        yield client


def _connected(address: str, deadline: _Deadline) -> Any:
    """Return a client of the scheduler at an address."""
    import dask

    distributed = _distributed()
    left = deadline.left()
    longest = dask.utils.parse_timedelta(dask.config.get("distributed.comm.timeouts.connect"))
    limit = longest if left is None else min(left, longest)
    answered: futures.Future[None] = futures.Future()

    async def greet() -> None:
        arguments = distributed.security.Security().get_connection_args("client")
        comm = await distributed.comm.connect(address, timeout=limit, **arguments)
        await comm.close()

    def ask() -> None:
        try:
            answered.set_result(asyncio.run(asyncio.wait_for(greet(), limit)))
        except Exception as error:
            answered.set_exception(error)

    # A client waits without end where the connection is taken and nothing is said. And one that did not start may lock up
    # whatever Dask starts later, when it is collected as garbage. The thread is there because the caller's may have a loop.
    threading.Thread(target=ask, daemon=True).start()
    try:
        answered.result()
    except Exception as error:
        deadline.left()
        why = str(error) or f"nothing came in {limit:g} s"
        raise UsageError(f"client: no scheduler of Dask answers at {address!r}: {why}") from None
    return distributed.Client(address, set_as_default=False)


def _answers(client: Any, task: Callable[..., Traced], text: str, calls: Sequence[tuple[Any, ...]], program: str,
             any_driver: bool, deadline: _Deadline, in_order: bool, guide: str | None = None) -> Iterator[tuple[int, Any]]:
    """Submit calls with the scene's text, and a guide's; yield place and answer of each when it is done, or in their order.

    The first calls have the highest priority. Whatever ends this cancels what is left.
    """
    import dask

    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
        # A long text is the result of a task: it needs no worker yet, and is computed again where it is lost. A short one
        # goes with each task, because Dask prefers workers that have what a task takes, and would leave others idle.
        scene, *guides = [client.submit(str, sent, pure=False) if len(sent) > _LONG else sent
                          for sent in (text, guide) if sent is not None]
        tasks = [client.submit(task, scene, *arguments, *guides, pure=False, retries=_RETRIES, priority=-place)
                 for place, arguments in enumerate(calls)]
    places = {future.key: place for place, future in enumerate(tasks)}
    checked = _Provenances(_provenance(program), any_driver)
    try:
        for future in tasks if in_order else _distributed().as_completed(tasks, loop=client.loop, timeout=deadline.left()):
            traced = future.result(deadline.left())
            checked.check(traced.by)
            yield places[future.key], traced.answer
    except NsqGpuError:
        raise
    except Exception as error:
        if isinstance(error, TimeoutError) and deadline.timeout is not None:
            raise deadline.error() from None
        raise NsqGpuError(f"a task failed on the cluster: {type(error).__name__}: {error}") from error
    finally:
        # A scheduler that is gone has nothing to cancel.
        with suppress(Exception):
            client.cancel(tasks)


class _Provenances:
    """Refuses a program of another build than the one here, or that runs on another driver than the first."""

    def __init__(self, own: Provenance, any_driver: bool) -> None:
        self._own = own
        self._any_driver = any_driver
        #: The first program of each platform: files of different platforms cannot be the same.
        self._builds = {own.platform: own}
        self._first: Provenance | None = None

    def check(self, found: Provenance) -> None:
        """Check the program of a task.

        Raises:
            UsageError: It is another one.
        """
        build = self._builds.setdefault(found.platform, found)
        for other in (self._own, build):
            if found.version != other.version or found.platform == other.platform and found.sha256 != other.sha256:
                raise UsageError(f"the program is another build on {found.machine} than on {other.machine} ({_build(found)}; "
                                 f"{_build(other)}); install the same one on both")
        if found.device is None or self._any_driver:
            return
        self._first = self._first or found
        if found.device != self._first.device:
            raise UsageError(f"the workers have different adapters or drivers ({self._first.machine}: {self._first.device}; "
                             f"{found.machine}: {found.device}); any_driver=True takes them all the same")


def _build(found: Provenance) -> str:
    return f"{found.machine}: {found.program}, {found.version} for {found.platform}, SHA-256 {found.sha256[:16]}"


def _provenance(program: str, said: Mapping[str, Any] | None = None) -> Provenance:
    """Return what a program is, and from a report or a greeting on what it ran."""
    status = os.stat(program)
    version, sha256 = _identified(program, status.st_mtime_ns, status.st_size)
    return Provenance(platform.node(), program, f"{sys.platform} {platform.machine()}", version, sha256,
                      said and f"{said['adapter']}, {said['driver']}")


@functools.lru_cache
def _identified(program: str, mtime_ns: int, size: int) -> tuple[str, str]:
    """Return the version of a program and the hash of its file, as long as the file is not another one."""
    version = subprocess.run([program, "--version"], capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL).stdout
    with Path(program).open("rb") as stream:
        return version.strip(), hashlib.file_digest(stream, "sha256").hexdigest()


def _ranges(num_rays: int, parts: int) -> list[tuple[int, int]]:
    """Return the first ray and the number of rays of each range, two or more."""
    parts = max(2, min(parts, num_rays))
    ends = [num_rays * index // parts for index in range(parts + 1)]
    return [(first, end - first) for first, end in itertools.pairwise(ends)]


def _range(first: int, count: int) -> list[str]:
    return [f"--num-rays={count}", f"--first-ray={first}"]


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise missing("Dask", "cluster", "a cluster needs") from None
    return distributed


def _guiding(options: Mapping[str, Any], sampling: Mapping[str, Any] | None, folder: Path) -> dict[str, Any]:
    """Return options of a trace here that guides rays as all workers will. It reads a guide, or learns and writes one."""
    found = {name: options[name] for name in _OF_GUIDES if options.get(name, "off") != "off"}
    # The trace runs in another folder.
    found |= {name: os.path.abspath(found[name]) for name in ("guide_from", "guide_to") if name in found}
    if "guide" in found or "guide" in (sampling or {}) and "guide_from" not in found:
        # The program writes what a scene learns for itself where --guide says something, were it off.
        return {"guide": "off", "guide_to": str(folder / _GUIDE), **found}
    return found


def _decide(program: str, text: str, folder: Path, options: Mapping[str, Any], timeout: float | None) -> dict[str, str]:
    """Return what all workers are given alike, as a trace of these options has it: the precision, and if arithmetic is strict."""
    scene = folder / "scene.json"
    scene.write_text(text, encoding="utf-8")
    few = {**options, "target_error": None, "time_limit": None}
    # What is learned depends on how many rays there will be.
    few |= {"time_limit": _AT_ONCE} if "guide_to" in options else {"num_rays": min(options["num_rays"], _PILOT_RAYS)}
    arguments = [f"--{name.replace('_', '-')}={value}" for name, value in few.items() if value is not None]
    _run(folder, [program, "trace", scene.name, *arguments, "--progress=never", "--output=pilot", "--no-pictures"], timeout)
    report = read_report(folder / "pilot")
    return {"precision": report["precision"], "strict": "on" if report["driver"].endswith(", strict") else "off"}


def add(program: str, tallies: Sequence[bytes], text: str) -> tuple[bytes, dict[str, Any]]:
    """Return the bytes of the sum of tallies of disjoint rays, in whatever order, and its report."""
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        _merge(program, tallies, text, folder)
        return (folder / "out" / _TALLY).read_bytes(), read_report(folder / "out")


def _merge(program: str, tallies: Sequence[bytes], text: str, folder: Path, arguments: Sequence[str] = ()) -> None:
    """Write the result of tallies; one alone is a trace, of those arguments, that is done."""
    (folder / "scene.json").write_text(text, encoding="utf-8")
    files = [f"{index}.bin" for index in range(len(tallies))]
    for file, tally in zip(files, tallies, strict=True):
        (folder / file).write_bytes(tally)
    if len(files) > 1:
        command = ["merge", *files, "--scene=scene.json"]
    else:
        command = ["trace", "scene.json", f"--resume={files[0]}", "--progress=never", *arguments]
    _run(folder, [program, *command, "--output=out", "--no-pictures"])


def _run(folder: Path, command: Sequence[str], timeout: float | None = None) -> None:
    """Run the program in a folder: results hold the names of files, which must not depend on where the folder is."""
    command = [os.path.abspath(command[0]), *command[1:]]
    run([*command, "--watch-stdin"] if command[1] == "trace" else command, timeout, folder=str(folder))

