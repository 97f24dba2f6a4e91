"""Traces spread over a Dask cluster: the bits of one trace of all rays, whoever traced which of them.

``pip install nsq-gpu[cluster]``. A task traces a range of rays, a pure function of the scene's text, the first ray and
the count. So a task that is lost, repeated or run twice changes nothing. Its result is the bytes of a tally, and tallies
are summed by a tree, in any order.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from optiland.nonsequential import NSQScene
from optiland.nonsequential.tracer import SimulationResult

from nsq_gpu.binary import find_binary
from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.export import export, to_json
from nsq_gpu.integrity import read_report
from nsq_gpu.process import run
from nsq_gpu.results import check_paths, fill_scene, in_folder, warn_of

#: Tallies that a task of the tree adds up.
_ARITY = 8
#: The sums in a folder of results.
_TALLY = "tally.bin"


def trace(scene: NSQScene, num_rays: int, client: Any = None, parts: int | None = None, *, seed: int = 0,
          max_depth: int = 16, precision: str = "auto", adapter: str | None = None, binary: str | None = None,
          any_driver: bool = False, **options: Any) -> SimulationResult:
    """Trace a scene on a Dask cluster; return Optiland's result, and leave live detectors as its own backends do.

    The bits are those of ``nsq-gpu trace -n NUM_RAYS`` with ``--strict``, where the adapters allow strict arithmetic.

    Args:
        scene: The live scene.
        num_rays: Rays to launch.
        client: A ``dask.distributed.Client``. None starts a cluster on this machine, with one worker, and ends it.
        parts: Ranges of rays, a task each; by default four a worker.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray.
        precision: As that of :class:`nsq_gpu.NsqGpuBackend`; this process decides it, for all workers.
        adapter: A part of the adapter's name, here and on the workers.
        binary: Path of the program on this machine and on the workers.
        any_driver: True takes workers whose drivers differ from each other; the last bits may then depend on who traced
            which rays.
        options: Further options of ``nsq-gpu trace`` by their names.

    Raises:
        NsqGpuError: One of its subclasses, by what went wrong.
        UsageError: The workers' drivers differ.
    """
    distributed = _distributed()
    if num_rays < 2 or parts is not None and parts < 1:
        raise UsageError(f"num_rays is {num_rays} and parts {parts}; give at least 2 rays and 1 part")
    exported = export(scene)
    text = to_json(exported.document, indent=None)
    program = find_binary(binary)
    if options.get("record_paths") is not None:
        check_paths(scene, exported.surface_labels)
    if adapter is not None:
        options["adapter"] = adapter
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as folder:
        decided = _decide(program, text, Path(folder), precision, adapter)
        arguments = [f"--{name.replace('_', '-')}={value}" for name, value in
                     {"seed": seed, "max_depth": max_depth, "of_rays": num_rays, **decided, **options}.items()]
        # One worker with threads of its own: workers in processes would share the adapter as well, and start slowly.
        cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1) if client is None else nullcontext()
        with cluster, (distributed.Client(cluster) if client is None else nullcontext(client)) as used:
            _check_drivers(used, binary, adapter, any_driver)
            tallies = _spread(used, text, num_rays, parts or 4 * max(len(used.scheduler_info()["workers"]), 1), arguments, binary)
        return _read(scene, exported, program, text, tallies, Path(folder))


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
    from nsq_gpu.session import Session

    with Session(binary=binary, adapter=adapter) as session:
        said = session.hello()
    return f"{said['adapter']}, {said['driver']}, version {said['version']}"


def _spread(client: Any, text: str, num_rays: int, parts: int, arguments: list[str],
            binary: str | None) -> list[bytes]:
    """Submit a task a range and a tree of sums; return the last sums, two or more."""
    parts = max(2, min(parts, num_rays))
    ends = [num_rays * index // parts for index in range(parts + 1)]
    [scene] = client.scatter([text], broadcast=True)
    level = [client.submit(trace_range, scene, first, end - first, arguments, binary, retries=3)
             for first, end in zip(ends, ends[1:], strict=False)]
    while len(level) > _ARITY:
        groups = [level[index : index + _ARITY] for index in range(0, len(level), _ARITY)]
        level = [client.submit(add, group, scene, binary, retries=3) if len(group) > 1 else group[0] for group in groups]
    try:
        return client.gather(level)
    except BaseException:
        client.cancel(level)
        raise


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
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
        folder = Path(name)
        _merge(find_binary(binary), tallies, text, folder)
        return (folder / "out" / _TALLY).read_bytes()


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


def _read(scene: NSQScene, exported: Any, program: str, text: str, tallies: Sequence[bytes], folder: Path) -> SimulationResult:
    """Add up tallies, read the sum out as files, and those into the live scene."""
    _merge(program, tallies, text, folder)
    report = read_report(folder / "out")
    warn_of(report, None)
    load = in_folder(folder / "out", report)
    return fill_scene(scene, report, load, exported.surface_labels, report["ray_paths"] is not None)
