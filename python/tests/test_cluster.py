"""A trace on a cluster has the bits of one trace, however many workers there are and whatever happens to them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import pytest

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
