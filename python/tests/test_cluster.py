"""A trace on a cluster has the bits of one trace, however many workers there are and whatever happens to them."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Iterator
from typing import Any

import pytest

import nsq_gpu
from nsq_gpu import cluster
from nsq_gpu.export import export, to_json
from tests import live
from tests.test_session import session, singlet

distributed = pytest.importorskip("distributed", reason="Dask is not installed")
NUM_RAYS = 50_000


@pytest.fixture(scope="module")
def expected() -> bytes:
    with session() as one:
        return one.trace(singlet(), NUM_RAYS, strict="on").detectors["image"].irradiance.tobytes()


@pytest.fixture
def client() -> Iterator[Any]:
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None) as local, \
            distributed.Client(local) as found:
        yield found


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
        assert (parts.paths == whole.paths).all()
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
    tallies = [cluster.trace_range(text, first, end - first, options, live.binary())
               for first, end in zip(ends, ends[1:], strict=False)]
    again = cluster.trace_range(text, ends[1], ends[2] - ends[1], options, live.binary())
    assert again == tallies[1], "a task that is run twice gives the same bytes"
    sums = set()
    for seed in range(3):
        random.Random(seed).shuffle(tallies)
        left, right = tallies[:2], tallies[2:]
        sums.add(cluster.add([cluster.add(left, text, live.binary()), cluster.add(right, text, live.binary())], text,
                             live.binary()))
    assert len(sums) == 1


def test_workers_of_different_drivers_are_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_driver", lambda binary, adapter, dask_worker=None: str(dask_worker.name))
    with pytest.raises(cluster.UsageError, match="different adapters or drivers .*any_driver"):
        cluster.trace(singlet(), NUM_RAYS, client, precision="f64", binary=live.binary())


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


def test_what_ends_the_call_cancels_the_ranges(client: Any) -> None:
    def stop(done: int, num_rays: int, rate: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cluster.trace(singlet(), NUM_RAYS, client, 30, precision="f64", binary=live.binary(), progress=stop)
    deadline = time.monotonic() + 30
    while any(client.processing().values()) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(client.processing().values())


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
