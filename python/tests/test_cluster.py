"""A trace on a cluster has the bits of one trace, however many workers there are and whatever happens to them."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nsq_gpu
from nsq_gpu import cluster
from nsq_gpu.export import export, to_json
from tests import live
from tests.test_session import command, session, singlet

pytestmark = pytest.mark.in_turn

distributed = pytest.importorskip("distributed", reason="Dask is not installed")
dask = pytest.importorskip("dask")
posix_only = pytest.mark.skipif(os.name == "nt", reason="signals and scripts are POSIX's")
NUM_RAYS = 50_000
RADII = {"L.r1": [50.0, 60.0, 70.0]}


@pytest.fixture(scope="module")
def expected() -> bytes:
    with session() as one:
        return one.trace(singlet(), NUM_RAYS, strict="on").detectors["image"].irradiance.tobytes()


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """Give a cluster of threads, and wait nowhere longer than a second for it."""
    limits = {"distributed.comm.timeouts.connect": "1s", "distributed.adaptive.interval": "100ms"}
    with dask.config.set(limits), distributed.LocalCluster(n_workers=workers, threads_per_worker=1, processes=False,
                                                           dashboard_address=None) as local:
        yield local


@pytest.fixture
def client() -> Iterator[Any]:
    with local_cluster(2) as local, distributed.Client(local) as found:
        yield found


@pytest.fixture
def one_worker() -> Iterator[Any]:
    """Give a client of a cluster that does task by task, in their order."""
    with local_cluster(1) as local, distributed.Client(local) as found:
        yield found


def traced(client: Any, parts: int | None = None, **options: Any) -> Any:
    return cluster.trace(options.pop("scene", singlet()), NUM_RAYS, client, parts,
                         **{"precision": "f64", "binary": live.binary(), **options})


def swept(client: Any, **options: Any) -> Any:
    return cluster.sweep(singlet(), RADII, 1000, client, **{"precision": "f64", "binary": live.binary(), **options})


def bits(result: Any) -> bytes:
    return result.detectors["image"].irradiance.tobytes()


def bits_of_the_first(rays: int) -> bytes:
    with session() as one:
        return bits(one.trace(singlet(), rays, strict="on"))


def tasks_left(client: Any) -> int:
    """Return how many tasks a cluster still knows, some time after they were cancelled."""
    deadline = time.monotonic() + 10
    while left := len(client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks))):
        if time.monotonic() > deadline:
            break
        time.sleep(0.05)
    return left


@pytest.mark.parametrize("parts", [1, 2, 3, 7, 20])
def test_the_bits_are_those_of_one_trace(client: Any, expected: bytes, parts: int) -> None:
    result = cluster.trace(singlet(), NUM_RAYS, client, parts, precision="f64", binary=live.binary())
    assert result.detectors["image"].irradiance.tobytes() == expected
    assert result.num_rays_total == NUM_RAYS


def test_paths_are_those_of_one_trace(client: Any) -> None:
    # Of several sources, and with a filter.
    path = live.ROOT / "scenes" / "coated_projector.json"
    for options in ({"paths": True}, {"paths": True, "where": "reflections < 2"}):
        with session() as one, live.quiet():
            whole = one.trace(live.load(path), 5000, **options)
        parts = cluster.trace(live.load(path), 5000, client, 5, precision="f64", binary=live.binary(), **options)
        assert len(whole.paths) > 20
        assert live.same_rows(parts.paths, whole.paths)
        assert parts.total_flux_detected == whole.total_flux_detected
        assert parts.diagnostics.flux_filtered_out == whole.diagnostics.flux_filtered_out
    assert parts.diagnostics.flux_filtered_out > 0.0


def test_a_filter_that_makes_no_sense_is_refused(client: Any) -> None:
    with pytest.raises(cluster.UsageError, match="column 1: `reflectons` is not known"):
        cluster.trace(singlet(), NUM_RAYS, client, 2, precision="f64", binary=live.binary(), where="reflectons == 2")


def test_ranges_add_up_in_any_order() -> None:
    text = to_json(export(singlet()).document, indent=None)
    options = [f"--of-rays={NUM_RAYS}", "--precision=f64", "--strict=on"]
    ends = [0, 10_000, 12_345, 40_000, NUM_RAYS]
    tallies = [cluster.trace_range(text, first, end - first, options, live.binary()).answer
               for first, end in zip(ends, ends[1:], strict=False)]
    again = cluster.trace_range(text, ends[1], ends[2] - ends[1], options, live.binary()).answer
    assert again == tallies[1], "a task that is run twice gives the same bytes"
    sums = set()
    for seed in range(3):
        random.Random(seed).shuffle(tallies)
        halves = [cluster.add(live.binary(), half, text)[0] for half in (tallies[:2], tallies[2:])]
        sums.add(cluster.add(live.binary(), halves, text)[0])
    assert len(sums) == 1


def test_an_error_of_a_task_is_the_callers(client: Any) -> None:
    with pytest.raises(cluster.NsqGpuError, match="rr-start-flux"):
        cluster.trace(singlet(), NUM_RAYS, client, 2, precision="f64", binary=live.binary(), rr_start_flux=-1.0)


def test_a_worker_that_dies_half_way_changes_no_bit(expected: bytes) -> None:
    # A nanny starts another process in its place.
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as local, \
            distributed.Client(local) as client:
        killed: list[int] = []

        def kill_one(done: int, num_rays: int, rate: float) -> None:
            if not killed and done < num_rays:
                killed.append(local.workers[0].pid)
                os.kill(killed[0], signal.SIGKILL)

        result = cluster.trace(singlet(), NUM_RAYS, client, 12, precision="f64", binary=live.binary(), progress=kill_one)
    assert killed, "a worker was killed before all ranges were done"
    assert result.detectors["image"].irradiance.tobytes() == expected


def test_progress_counts_every_ray_once(client: Any) -> None:
    seen: list[int] = []
    cluster.trace(singlet(), NUM_RAYS, client, 5, precision="f64", binary=live.binary(),
                  progress=lambda done, num_rays, rate: seen.append(done))
    assert len(seen) == 5
    assert seen == sorted(seen)
    assert seen[-1] == NUM_RAYS


def test_a_target_error_ends_at_a_prefix_that_has_the_bits_of_so_many_rays(client: Any) -> None:
    results = [cluster.trace(singlet(), 10 * NUM_RAYS, client, 50, precision="f64", binary=live.binary(), target_error=target)
               for target in ("1.5%", 0.015)]
    ended = {int(result.num_rays_total) for result in results}
    [rays] = ended
    assert rays < 10 * NUM_RAYS
    assert rays % (10 * NUM_RAYS // 50) == 0
    # It is the shortest: a range less is not certain enough.
    with session() as one:
        for traced, is_enough in ((rays, True), (rays - 10 * NUM_RAYS // 50, False)):
            text = to_json(export(singlet()).document, indent=None)
            report = one.request(text, {"num_rays": traced, "standard_error": "on"}).report
            assert (report["relative_error"] <= 0.015) == is_enough
        same = one.trace(singlet(), rays, standard_error="on")
    for result in results:
        assert result.detectors["image"].irradiance.tobytes() == same.detectors["image"].irradiance.tobytes()


def test_a_target_that_is_missed_is_said(client: Any) -> None:
    with pytest.warns(nsq_gpu.ToleranceWarning, match="above the target"):
        result = cluster.trace(singlet(), 20_000, client, 4, precision="f64", binary=live.binary(), target_error=1e-4)
    assert result.num_rays_total == 20_000


@pytest.mark.parametrize("target", ["a lot", 0, -0.1, "nan"])
def test_a_target_that_is_none_is_refused(target: Any) -> None:
    with pytest.raises(cluster.UsageError, match="target_error"):
        cluster.trace(singlet(), 1000, object(), target_error=target)


def test_a_sweep_on_a_cluster_is_that_of_a_session(client: Any) -> None:
    numbers = {"L.r1": [50.0, 60.0, 70.0], "L.z": [0.0, 1.0]}
    found = cluster.sweep(singlet(), numbers, 5000, client, maps=True, precision="f64", binary=live.binary())
    with session() as one:
        expected = one.sweep(singlet(), numbers, 5000, maps=True, strict="on")
    assert found.shape == (3, 2)
    assert found.maps["image"].tobytes() == expected.maps["image"].tobytes()
    assert {name: flux.tolist() for name, flux in found.flux.items()} == {
        name: flux.tolist() for name, flux in expected.flux.items()}


def test_a_number_of_nothing_is_refused_by_name(client: Any) -> None:
    with pytest.raises(cluster.NsqGpuError, match="did you mean `r1`"):
        cluster.sweep(singlet(), {"L.r3": [1.0]}, 1000, client, precision="f64", binary=live.binary())


# Guided rays


#: Above 2^18 rays, what a pilot learns depends on their number.
MANY_RAYS = 300_000
REFLECTED = "reflections == 2"


def guided_command(tmp_path: Path, *options: str, scene: Any = None) -> bytes:
    """Return the bits of the map that the command writes."""
    file = tmp_path / "scene.json"
    file.write_text(to_json(export(scene or singlet()).document), encoding="utf-8")
    found = command(file, tmp_path / "out", "--precision=f64", "--strict", "--max-depth=16", *options)
    return found["image", "irradiance"].tobytes()


def guided(client: Any, num_rays: int = MANY_RAYS, parts: int = 3, **options: Any) -> Any:
    scene = options.pop("scene", None) or singlet()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", nsq_gpu.ResultWarning)
        return cluster.trace(scene, num_rays, client, parts, precision="f64", binary=live.binary(), **options)


@pytest.mark.parametrize("where", [{}, {"where": REFLECTED}])
def test_guided_rays_have_the_bits_of_one_trace(client: Any, tmp_path: Path, where: dict[str, str]) -> None:
    one = guided_command(tmp_path, f"-n={MANY_RAYS}", "--guide", "--seed=5", *(f"--where={text}" for text in where.values()))
    assert bits(guided(client, guide=True, seed=5, **where)) == one


def test_a_guide_of_the_scene_itself_is_shared_too(client: Any, tmp_path: Path) -> None:
    scene = singlet()
    scene.guided_light = {"detector": None, "where": REFLECTED}
    assert bits(guided(client, 20_000, scene=scene)) == guided_command(tmp_path, "-n=20000", scene=scene)


def test_the_table_of_paths_of_guided_rays_is_that_of_one_trace(client: Any) -> None:
    with session() as one, live.quiet():
        whole = one.trace(singlet(), 20_000, paths=True, guide=True)
    parts = guided(client, 20_000, paths=True, guide=True)
    assert (whole.paths["reflections"] == 2).any()
    assert live.same_rows(parts.paths, whole.paths)


def test_a_prefix_and_what_is_done_are_guided_by_what_was_learned_for_all_rays(
        one_worker: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(done: int, num_rays: int, rate: float) -> None:
        raise KeyboardInterrupt

    # Of such a name, only this process can read a file: a worker's program runs in a folder of its own.
    monkeypatch.chdir(tmp_path)
    ended = guided(one_worker, parts=30, guide=True, guide_to="guide", target_error="30%")
    assert ended.num_rays_total < MANY_RAYS
    of_all = ("--guide-from=guide", f"--of-rays={MANY_RAYS}")
    assert bits(ended) == guided_command(tmp_path, f"-n={int(ended.num_rays_total)}", "--standard-error=on", *of_all)
    with pytest.raises(nsq_gpu.Interrupted) as caught:
        guided(one_worker, parts=30, guide_from="guide", progress=stop)
    assert bits(caught.value.partial) == guided_command(tmp_path, "-n=10000", *of_all)


def test_a_long_guide_is_sent_once(client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_LONG", 0)
    keys: set[str] = set()

    def look(done: int, num_rays: int, rate: float) -> None:
        keys.update(client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks)))

    assert bits(guided(client, 20_000, guide=True, progress=look)) == guided_command(tmp_path, "-n=20000", "--guide")
    assert sorted(key.split("-")[0] for key in keys) == ["str"] * 2 + ["trace_range"] * 3
    assert tasks_left(client) == 0


def test_a_guide_that_makes_no_sense_is_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "guide"
    for options, named in (({"guide_from": file}, f"{file}: No such file"), ({"guide": "maybe"}, "invalid value 'maybe'"),
                           ({"guide": True, "guide_from": file}, "cannot be used with"), ({"guide_to": file}, "--guide")):
        with pytest.raises(cluster.UsageError, match=named):
            guided(object(), 1000, **options)
    file.write_text("no guide")
    for options, named in (({"guide_from": file}, f"{file}: is no guide"), ({"guide": True, "guide_to": file}, str(file))):
        with pytest.raises(cluster.UsageError, match=named):
            guided(object(), 1000, **options)
    assert file.read_text() == "no guide"


# Workers that are not there yet


@pytest.mark.parametrize("address", [False, True])
def test_workers_may_come_later_than_any_limit_of_dask(address: bool, expected: bytes) -> None:
    # An address in the place of a client is as good.
    with local_cluster(0) as local, distributed.Client(local, timeout=1) as client:
        late = threading.Timer(3.0, lambda: local.scale(1))
        late.start()
        given = local.scheduler.address if address else client
        defaults: set[Any] = set()
        result = traced(given, 3, progress=lambda done, num_rays, rate: defaults.add(distributed.default_client()))
        assert bits(result) == expected
        assert defaults == {client}, "a client of the call's own is nobody's default"
        late.join()
        assert tasks_left(client) == 0
        assert len(client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.clients))) == 2, "its own is closed"


def test_a_sweep_waits_for_workers() -> None:
    with local_cluster(0) as local, distributed.Client(local, timeout=1) as client:
        late = threading.Timer(3.0, lambda: local.scale(1))
        late.start()
        assert np.isfinite(swept(client).flux["image"]).all()
        late.join()


def test_an_adaptive_cluster_may_begin_with_none(expected: bytes) -> None:
    with local_cluster(0) as local, distributed.Client(local, timeout=1) as client:
        local.adapt(minimum=0, maximum=2)
        seen: list[int] = []
        assert bits(traced(client, progress=lambda done, num_rays, rate: seen.append(done))) == expected
        assert len(seen) == 32, "ranges of eight workers"
        assert np.isfinite(swept(client).flux["image"]).all()


@pytest.mark.parametrize("call", [traced, swept])
def test_a_timeout_holds_while_no_worker_comes(call: Callable[..., Any]) -> None:
    with local_cluster(0) as local, distributed.Client(local, timeout=1) as client:
        start = time.monotonic()
        with pytest.raises(nsq_gpu.TraceTimeoutError, match="timeout = 2 s") as caught:
            call(client, timeout=2)
        assert 2.0 <= time.monotonic() - start < 4.0
        assert caught.value.partial is None
        assert tasks_left(client) == 0


def test_a_long_text_is_sent_once(client: Any, expected: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_LONG", 0)
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": 1}), warnings.catch_warnings():
        warnings.filterwarnings("error", "Sending large graph")
        keys: set[str] = set()

        def look(done: int, num_rays: int, rate: float) -> None:
            keys.update(client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.tasks)))

        assert bits(traced(client, 4, progress=look)) == expected
    assert sorted(key.split("-")[0] for key in keys) == ["str"] + ["trace_range"] * 4
    assert tasks_left(client) == 0


@posix_only
def test_a_timeout_holds_before_the_first_task(client: Any, tmp_path: Path) -> None:
    start = time.monotonic()
    with pytest.raises(nsq_gpu.TraceTimeoutError):
        traced(client, binary=str(script(tmp_path / "slow", "[ $1 = trace ] && exec sleep 30")), timeout=1)
    assert time.monotonic() - start < 4.0


# Clients


def test_an_asynchronous_client_is_refused_by_name() -> None:
    async def inside() -> Any:
        async with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
                                            asynchronous=True) as local, \
                distributed.Client(local, asynchronous=True) as client:
            for call in (traced, swept):
                with pytest.raises(cluster.UsageError, match="client is asynchronous.*asyncio.to_thread.*scheduler.address"):
                    call(client)
            # What the message says to do.
            return await asyncio.to_thread(traced, client.scheduler.address, 2)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert asyncio.run(inside()).num_rays_total == NUM_RAYS
        gc.collect()
    assert not [warning for warning in caught if "never awaited" in str(warning.message)]


@pytest.mark.parametrize("given", ["tcp://127.0.0.1:1", "tcp://nowhere", "silent"])
def test_an_address_where_nothing_answers_is_refused_by_name(given: str) -> None:
    # Dask itself waits without end for an answer of one that takes the connection.
    with socket.create_server(("127.0.0.1", 0)) as silent, dask.config.set({"distributed.comm.timeouts.connect": "2s"}):
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}" if given == "silent" else given
        start = time.monotonic()
        with pytest.raises(cluster.UsageError, match=f"no scheduler of Dask answers at '{address}'"):
            traced(address)
        if given != "tcp://nowhere":
            with pytest.raises(nsq_gpu.TraceTimeoutError):
                traced(address, timeout=1)
        assert time.monotonic() - start < 6.0
    # Dask closes one that did not start when it is collected as garbage, and then locks up what it starts meanwhile.
    assert not [one for one in gc.get_objects() if type(one) is distributed.Client and one.status != "closed"]


def test_what_is_no_client_is_refused_by_name(client: Any) -> None:
    for other, name in ((client.cluster, "LocalCluster"), (object(), "object"), (3, "int")):
        with pytest.raises(cluster.UsageError, match=f"client is of type {name}; give a dask.distributed.Client"):
            traced(other)
    client.close()
    for call in (traced, swept):
        with pytest.raises(cluster.UsageError, match="client is closed"):
            call(client)


# Drivers and builds


@pytest.fixture
def other_drivers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each worker a driver of its own name."""
    found = cluster._provenance

    def renamed(program: str, said: Any = None) -> cluster.Provenance:
        return found(program, said and said | {"driver": str(distributed.get_worker().name)})

    monkeypatch.setattr(cluster, "_provenance", renamed)


@pytest.mark.usefixtures("other_drivers")
def test_workers_of_different_drivers_are_refused(client: Any, expected: bytes) -> None:
    for call in (traced, swept):
        with pytest.raises(cluster.UsageError, match=r"different adapters or drivers \(.*, [01]; .*, [01]\); any_driver=True"):
            call(client)
    assert bits(traced(client, any_driver=True)) == expected
    assert np.isfinite(swept(client, any_driver=True).flux["image"]).all()


@contextmanager
def worker_of(address: str, program: Path) -> Iterator[Any]:
    """Give a worker, a process of its own, that finds this program."""
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads=1", "--no-dashboard", "--no-nanny"]
    worker = subprocess.Popen(command, env={**os.environ, "NSQ_GPU_BINARY": str(program)}, stderr=subprocess.DEVNULL)
    try:
        yield worker
    finally:
        worker.kill()
        worker.wait()


def script(path: Path, *lines: str) -> Path:
    """Write a program that ends as the program under test."""
    path.write_text("\n".join(["#!/bin/sh", *lines, f'exec {live.binary()} "$@"']) + "\n")
    path.chmod(0o755)
    return path


@posix_only
def test_a_worker_of_another_build_that_comes_late_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NSQ_GPU_BINARY", live.binary())
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
                                  host="127.0.0.1", protocol="tcp") as local, distributed.Client(local) as client, \
            contextlib.ExitStack() as stack:
        def late(done: int, num_rays: int, rate: float) -> None:
            if len(client.nthreads()) == 1:
                stack.enter_context(worker_of(local.scheduler.address, script(tmp_path / "other")))
                client.wait_for_workers(2, timeout=60)

        named = f"the program is another build .*{tmp_path / 'other'}, .*SHA-256"
        with pytest.raises(cluster.UsageError, match=named) as caught:
            traced(client, 40, binary=None, any_driver=True, progress=late)
        assert caught.value.partial.num_rays_total in range(1250, NUM_RAYS, 1250), "those of the first worker are kept"
        with pytest.raises(cluster.UsageError, match=named):
            swept(client, binary=None)
        assert tasks_left(client) == 0


def test_builds_of_one_platform_are_one_file_and_all_have_one_version() -> None:
    def build(machine: str, platform: str = "linux x86_64", version: str = "1.0.0", sha256: str = "a") -> cluster.Provenance:
        return cluster.Provenance(machine, "nsq-gpu", platform, version, sha256)

    def check(*found: cluster.Provenance) -> None:
        checked = cluster._Provenances(build("here"), any_driver=True)
        for one in found:
            checked.check(one)

    check(build("a"), build("b"), build("c", "win32 AMD64", sha256="b"), build("d", "win32 AMD64", sha256="b"))
    for wrong in ([build("b", sha256="c")], [build("b", "win32 AMD64", "1.0.1")],
                  [build("a", "win32 AMD64", sha256="b"), build("b", "win32 AMD64", sha256="c")]):
        with pytest.raises(cluster.UsageError, match="another build on b than on"):
            check(*wrong)


@posix_only
def test_a_program_that_was_replaced_is_hashed_and_started_anew(tmp_path: Path) -> None:
    text = to_json(export(singlet()).document, indent=None)
    program = script(tmp_path / "program")
    first = cluster.trace_point(text, {}, {"num_rays": 100}, None, str(program))
    script(program, f"[ $1 = serve ] && touch {tmp_path / 'started'}")
    second = cluster.trace_point(text, {}, {"num_rays": 100}, None, str(program))
    assert first.by.sha256 != second.by.sha256
    assert (tmp_path / "started").exists()


# What is done is kept


@pytest.mark.parametrize(("how", "ranges"), [("ctrl-c", 1), ("ctrl-c", 3), ("ctrl-c", 12), ("timeout", 2)])
def test_what_ends_the_call_keeps_the_ranges_that_are_done(one_worker: Any, ranges: int, how: str) -> None:
    told: list[int] = []

    def stop(done: int, num_rays: int, rate: float) -> None:
        told.append(done)
        if len(told) == ranges:
            if how == "ctrl-c":
                raise KeyboardInterrupt
            time.sleep(5.0)

    scene = singlet()
    with pytest.raises(nsq_gpu.Interrupted if how == "ctrl-c" else nsq_gpu.TraceTimeoutError) as caught:
        traced(one_worker, 50, scene=scene, progress=stop, timeout=5.0 if how == "timeout" else None, record_paths=True)
    partial = caught.value.partial
    assert partial.partial is True
    assert partial.num_rays_total == ranges * 1000
    assert set(partial.ray_paths["events"]["ray_id"]) == set(range(ranges * 1000))
    assert bits(partial) == bits_of_the_first(ranges * 1000)
    assert scene.detectors[0].get_result().irradiance.tobytes() == bits(partial)
    assert tasks_left(one_worker) == 0


def test_ctrl_c_before_anything_is_done_is_python_s(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cluster._Provenances, "check", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        traced(client)
    assert caught.type is KeyboardInterrupt
    assert tasks_left(client) == 0


def test_with_a_target_error_the_prefix_is_kept(client: Any) -> None:
    def stop(done: int, num_rays: int, rate: float) -> None:
        if done == 4000:
            raise KeyboardInterrupt

    with pytest.raises(nsq_gpu.Interrupted) as caught:
        traced(client, 50, target_error=1e-4, progress=stop)
    assert caught.value.partial.partial is True
    assert bits(caught.value.partial) == bits_of_the_first(4000)


@posix_only
def test_ctrl_c_that_ends_the_workers_too_loses_nothing(tmp_path: Path) -> None:
    # As in a terminal and in a notebook: the signal goes to all processes.
    (tmp_path / "main.py").write_text(f"""
import os, signal, time
import nsq_gpu
from nsq_gpu import cluster
from tests.test_session import singlet

def stop(done, num_rays, rate):
    if done == 3000:
        os.killpg(0, signal.SIGINT)
        time.sleep(2)

if __name__ == "__main__":
    try:
        cluster.trace(singlet(), 50_000, parts=50, precision="f64", binary={live.binary()!r}, progress=stop)
    except nsq_gpu.Interrupted as found:
        print("kept", found.partial.num_rays_total)
""")
    found = subprocess.run([sys.executable, tmp_path / "main.py"], capture_output=True, text=True, start_new_session=True,
                           env={**os.environ, "PYTHONPATH": str(live.ROOT / "python")}, timeout=60)
    assert found.stdout == "kept 3000\n", found.stderr


def test_a_sweep_that_ends_early_keeps_its_points(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    checked: list[Any] = []

    def interrupt(self: Any, found: cluster.Provenance) -> None:
        checked.append(found)
        if len(checked) == 3:
            raise error

    monkeypatch.setattr(cluster._Provenances, "check", interrupt)
    for error in (KeyboardInterrupt(), nsq_gpu.TraceTimeoutError("timeout")):
        checked.clear()
        with pytest.raises((nsq_gpu.Interrupted, nsq_gpu.TraceTimeoutError)) as caught:
            swept(client)
        assert caught.value.partial.partial is True
        assert np.isfinite(caught.value.partial.flux["image"]).tolist() == [True, True, False]
        assert tasks_left(client) == 0


def test_points_that_are_refused_do_not_end_a_sweep(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[Any] = []
    points = [{"L.r1": 50.0}, {"L.r1": 0.5}, {"L.r1": 60.0}]
    monkeypatch.setattr(cluster, "run_points", lambda trace_all, *_: found.extend(trace_all([(point, 0) for point in points])))
    swept(client)
    assert [type(answer).__name__ for answer in found] == ["Answer", "SceneError", "Answer"]


# Workers that are lost


@posix_only
def test_a_task_that_ends_its_workers_is_an_error_of_ours(tmp_path: Path) -> None:
    deadly = script(tmp_path / "deadly", f'[ $PPID = {os.getpid()} ] || kill -9 $PPID')
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}), \
            distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as local, \
            distributed.Client(local) as client, pytest.raises(cluster.NsqGpuError, match="failed on the cluster: KilledWorker"):
        traced(client, 2, binary=str(deadly))


def test_a_scheduler_that_ends_is_an_error_of_ours(one_worker: Any) -> None:
    def close(done: int, num_rays: int, rate: float) -> None:
        if done == 1000:
            one_worker.cluster.close()

    with pytest.raises(cluster.NsqGpuError, match="failed on the cluster: .*Cancelled") as caught:
        traced(one_worker, 50, progress=close)
    assert bits(caught.value.partial) == bits_of_the_first(int(caught.value.partial.num_rays_total))
