"""Traces spread over a Dask cluster: the bits of one trace of all rays, whoever traced which of them.

``pip install nsq-gpu[cluster]``. A task traces a range of rays, a pure function of the scene's text, the first ray and
the count. So a task that is lost, repeated or run twice changes nothing. Its result is the bytes of a tally, and tallies
are summed by a tree, in any order.
"""

from __future__ import annotations

import itertools
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from optiland.nonsequential import NSQScene
from optiland.nonsequential.tracer import SimulationResult

from nsq_gpu.binary import find_binary
from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.export import export, to_json
from nsq_gpu.integrity import read_report
from nsq_gpu.process import ProgressCallback, Shown, Update, run
from nsq_gpu.results import check_paths, fill_scene, in_folder, warn_of
from nsq_gpu.session import EXPORTED, Answer, Session, as_written, shared_session
from nsq_gpu.sweeps import Point, Sweep
from nsq_gpu.sweeps import run as run_points

#: Tallies that a task of the tree adds up.
_ARITY = 8
#: How often a task is tried again, on whichever worker.
_RETRIES = 3
#: The sums in a folder of results.
_TALLY = "tally.bin"


def trace(scene: NSQScene, num_rays: int, client: Any = None, parts: int | None = None, *, seed: int = 0,
          max_depth: int = 16, precision: str = "auto", adapter: str | None = None, binary: str | None = None,
          any_driver: bool = False, target_error: float | str | None = None,
          progress: bool | ProgressCallback = False, **options: Any) -> SimulationResult:
    """Trace a scene on a Dask cluster; return Optiland's result, and leave live detectors as its own backends do.

    The bits are those of ``nsq-gpu trace -n NUM_RAYS`` with ``--strict``, where the adapters allow strict arithmetic.

    Args:
        scene: The live scene.
        num_rays: Rays to launch; with a target error the most of them.
        client: A ``dask.distributed.Client``. None starts a cluster on this machine, with one worker, and ends it.
        parts: Ranges of rays, a task each; by default four a worker, and 16 a worker with a target error.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray.
        precision: As that of :class:`nsq_gpu.NsqGpuBackend`; this process decides it, for all workers.
        adapter: A part of the adapter's name, here and on the workers.
        binary: Path of the program on this machine and on the workers.
        any_driver: True takes workers whose drivers differ from each other; the last bits may then depend on who traced
            which rays.
        target_error: Largest relative error, such as ``0.01`` or ``"1%"``. The result is the shortest prefix of the ranges,
            two or more, that is as certain as that. So it does not depend on who was fast, and its bits are those of
            ``-n`` that many rays ``--of-rays NUM_RAYS``. Ranges beyond it are thrown away.
        progress: True shows a bar; a function is called with rays done, rays in all, rays per second.
        options: Further options of ``nsq-gpu trace`` by their names, such as ``paths=True``. The table of paths is that
            of one trace of all rays.

    Raises:
        NsqGpuError: One of its subclasses, by what went wrong.
        UsageError: The workers' drivers differ.
    """
    if num_rays < 2 or parts is not None and parts < 1:
        raise UsageError(f"num_rays is {num_rays} and parts {parts}; give at least 2 rays and 1 part")
    target = None if target_error is None else _fraction(target_error)
    exported = export(scene)
    text = to_json(exported.document, indent=None)
    program = find_binary(binary)
    options = {name: value for name, value in as_written(options).items() if value is not None}
    if "record_paths" in options:
        check_paths(scene, exported.surface_labels)
    if adapter is not None:
        options["adapter"] = adapter
    if target is not None:
        options["standard_error"] = "on"
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as folder:
        decided = _decide(program, text, Path(folder), precision, adapter)
        arguments = [f"--{name.replace('_', '-')}={value}" for name, value in
                     {"seed": seed, "max_depth": max_depth, "of_rays": num_rays, **decided, **options}.items()]
        with _client(client) as used, Shown(progress) as shown:
            _check_drivers(used, binary, adapter, any_driver)
            workers = max(len(used.scheduler_info()["workers"]), 1)
            ranges = _Ranges(text, num_rays, parts or (4 if target is None else 16) * workers, arguments, binary)
            counted = _Progress(shown, num_rays)
            tallies = _sum(used, ranges, counted) if target is None else _prefix(used, ranges, counted, program, target)
        _merge(program, tallies, text, Path(folder))
        report = read_report(Path(folder) / "out")
        reached = report["relative_error"]
        missed = target is not None and (reached is None or reached > target)
        warn_of(report, f"nsq-gpu: the relative error is {reached}, above the target of {target}; give more rays" if missed else None)
        return fill_scene(scene, report, in_folder(Path(folder) / "out", report), exported.surface_labels,
                          report["ray_paths"] is not None)


def sweep(scene: NSQScene, numbers: Mapping[str, Sequence[float]], num_rays: int, client: Any = None, *, zip: bool = False,
          common_draws: bool = True, maps: bool = False, seed: int = 0, max_depth: int = 16, precision: str = "auto",
          adapter: str | None = None, binary: str | None = None, any_driver: bool = False, **options: Any) -> Sweep:
    """Trace a scene with every combination of some numbers' values, a task each: :meth:`nsq_gpu.Session.sweep`.

    Each process of a worker keeps a session, so that scenes of one shape are compiled once there. Arguments are those of
    :meth:`nsq_gpu.Session.sweep` and of :func:`trace`.

    Raises:
        NsqGpuError: One of its subclasses, by what went wrong.
        UsageError: The workers' drivers differ, or a number is none of the scene.
    """
    text = to_json(export(scene).document, indent=None)
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as folder:
        decided = _decide(find_binary(binary), text, Path(folder), precision, adapter)
    named = {"num_rays": num_rays, "max_depth": max_depth, **decided, **options}

    with _client(client) as used:
        _check_drivers(used, binary, adapter, any_driver)
        [shared] = used.scatter([text], broadcast=True)

        def trace_all(points: list[Point]) -> Iterator[Answer]:
            known: set[str] = set()
            tasks = [used.submit(trace_point, shared, values, {**named, "seed": seed + index}, adapter, binary,
                                 pure=False, retries=_RETRIES, priority=-place)
                     for place, (values, index) in enumerate(points)]
            with _cancelling(used, tasks):
                for task in tasks:
                    answer = task.result()
                    warn_of(answer.report, answer.missed_target, known)
                    yield answer

        return run_points(trace_all, numbers, zip, common_draws, maps)


def trace_point(text: str, numbers: Mapping[str, float], options: Mapping[str, Any], adapter: str | None,
                binary: str | None) -> Answer:
    """Trace a scene's text with some numbers changed, in the session of this process."""
    return shared_session(find_binary(binary), adapter).request(text, options, name=EXPORTED, numbers=numbers)


def _fraction(target: float | str) -> float:
    """Return a target error, such as 0.01 or "1%", as a fraction."""
    try:
        found = float(target[:-1]) / 100 if isinstance(target, str) and target.endswith("%") else float(target)
    except ValueError:
        found = 0.0
    if not 0 < found < float("inf"):
        raise UsageError(f'target_error is {target!r}; give a number above 0, such as 0.01 or "1%"')
    return found


@contextmanager
def _client(client: Any) -> Iterator[Any]:
    """Give the client; without one, start a cluster on this machine, and end it."""
    distributed = _distributed()
    if client is not None:
        yield client
        return
    # One worker with one thread: workers in processes would share the adapter as well, and start slowly.
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1) as cluster, distributed.Client(cluster) as found:
        yield found


@contextmanager
def _cancelling(client: Any, tasks: list[Any]) -> Iterator[None]:
    """Cancel what is left of the tasks, whatever ends this."""
    try:
        yield
    finally:
        client.cancel(tasks)


class _Progress:
    """Counts the rays of ranges that are done, and shows how many."""

    def __init__(self, shown: Shown, num_rays: int) -> None:
        self._shown = shown
        self._num_rays = num_rays
        self._done = 0
        self._start = time.monotonic()

    def add(self, rays: int, relative_error: float | None = None) -> None:
        """Show that so many more rays are done."""
        self._done += rays
        rate = self._done / max(time.monotonic() - self._start, 1e-9)
        self._shown.show(Update({"rays": self._done, "num_rays": self._num_rays, "rays_per_sec": rate,
                                 "eta_sec": (self._num_rays - self._done) / rate, "relative_error": relative_error}))


class _Ranges:
    """The ranges of rays of a trace, as tasks. The first have the highest priority."""

    def __init__(self, text: str, num_rays: int, parts: int, arguments: Sequence[str], binary: str | None) -> None:
        parts = max(2, min(parts, num_rays))
        ends = [num_rays * index // parts for index in range(parts + 1)]
        #: The first ray and the number of rays of each.
        self.ranges = [(first, end - first) for first, end in itertools.pairwise(ends)]
        self.text = text
        self.binary = binary
        self._arguments = arguments

    def submit(self, client: Any) -> tuple[Any, list[Any]]:
        """Submit all; return the scene's text on the workers, and the tasks."""
        [scene] = client.scatter([self.text], broadcast=True)
        return scene, [client.submit(trace_range, scene, first, count, self._arguments, self.binary, pure=False,
                                     retries=_RETRIES, priority=-place)
                       for place, (first, count) in enumerate(self.ranges)]


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise NsqGpuError("Dask is not installed; `pip install nsq-gpu[cluster]`") from None
    return distributed


def _decide(program: str, text: str, folder: Path, precision: str, adapter: str | None) -> dict[str, str]:
    """Return what all workers are told alike: the precision, and whether arithmetic is strict."""
    scene = folder / "scene.json"
    scene.write_text(text, encoding="utf-8")
    _run(folder, [program, "trace", scene.name, "--num-rays=1", f"--precision={precision}", "--progress=never",
                  "--output=pilot", "--no-pictures", *([] if adapter is None else [f"--adapter={adapter}"])])
    report = read_report(folder / "pilot")
    return {"precision": report["precision"], "strict": "on" if report["driver"].endswith(", strict") else "off"}


def _check_drivers(client: Any, binary: str | None, adapter: str | None, any_driver: bool) -> None:
    """Refuse workers of different drivers, since last bits may depend on them."""
    drivers = client.run(_driver, binary, adapter)
    if len(set(drivers.values())) > 1 and not any_driver:
        told = "; ".join(f"{worker}: {driver}" for worker, driver in sorted(drivers.items()))
        raise UsageError(f"the workers have different adapters or drivers ({told}); any_driver=True takes them all the same")


def _driver(binary: str | None, adapter: str | None) -> str:
    """Return the adapter and the driver of a worker."""
    with Session(binary=binary, adapter=adapter) as session:
        said = session.hello()
    return f"{said['adapter']}, {said['driver']}, version {said['version']}"


def _sum(client: Any, ranges: _Ranges, progress: _Progress) -> list[bytes]:
    """Trace all ranges and sum them by a tree; return the last sums, two or more."""
    scene, tasks = ranges.submit(client)
    counts = {task.key: count for task, (_, count) in zip(tasks, ranges.ranges, strict=True)}
    level, waited_for = tasks, tasks[:]
    while len(level) > _ARITY:
        groups = [level[index : index + _ARITY] for index in range(0, len(level), _ARITY)]
        level = [client.submit(add, group, scene, ranges.binary, pure=False, retries=_RETRIES) if len(group) > 1 else group[0]
                 for group in groups]
        waited_for += level
    with _cancelling(client, waited_for):
        # Its own results are not kept, so that bytes of ranges stay where they are added up.
        for task in _distributed().as_completed(tasks):
            if task.status == "error":
                task.result()
            progress.add(counts[task.key])
        return client.gather(level)


def _prefix(client: Any, ranges: _Ranges, progress: _Progress, program: str, target: float) -> list[bytes]:
    """Trace ranges until the first of them are as certain as the target; return their sums, two."""
    _, tasks = ranges.submit(client)
    with _cancelling(client, tasks):
        total = tasks[0].result()
        progress.add(ranges.ranges[0][1])
        for task, (_, count) in zip(tasks[1:], ranges.ranges[1:], strict=True):
            pair = [total, task.result()]
            total, report = _added(program, pair, ranges.text)
            progress.add(count, report["relative_error"])
            if report["relative_error"] is not None and report["relative_error"] <= target:
                break
        return pair


def trace_range(text: str, first: int, count: int, arguments: Sequence[str], binary: str | None) -> bytes:
    """Trace rays ``first`` to ``first + count`` of a scene's text; return the bytes of their tally."""
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        (folder / "scene.json").write_text(text, encoding="utf-8")
        _run(folder, [find_binary(binary), "trace", "scene.json", f"--num-rays={count}", f"--first-ray={first}", *arguments,
                      "--progress=never", "--output=out", "--no-pictures"])
        return (folder / "out" / _TALLY).read_bytes()


def add(tallies: Sequence[bytes], text: str, binary: str | None) -> bytes:
    """Return the bytes of the sum of tallies of disjoint rays, in whatever order."""
    return _added(find_binary(binary), tallies, text)[0]


def _added(program: str, tallies: Sequence[bytes], text: str) -> tuple[bytes, dict[str, Any]]:
    """Return the bytes of the sum, and its report."""
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        _merge(program, tallies, text, folder)
        return (folder / "out" / _TALLY).read_bytes(), read_report(folder / "out")


def _merge(program: str, tallies: Sequence[bytes], text: str, folder: Path) -> None:
    (folder / "scene.json").write_text(text, encoding="utf-8")
    files = [f"{index}.bin" for index in range(len(tallies))]
    for file, tally in zip(files, tallies, strict=True):
        (folder / file).write_bytes(tally)
    _run(folder, [program, "merge", *files, "--scene=scene.json", "--output=out", "--no-pictures"])


def _run(folder: Path, command: Sequence[str]) -> None:
    """Run the program in a folder: results hold the names of files, which must not depend on where the folder is."""
    command = [os.path.abspath(command[0]), *command[1:]]
    run([*command, "--watch-stdin"] if command[1] == "trace" else command, folder=str(folder))

