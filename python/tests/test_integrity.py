"""Files of a result that are not as the command wrote them."""

from __future__ import annotations

import io
import json
import random
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from nsq_gpu import NsqGpuError
from nsq_gpu.integrity import load_arrays, read_report
from tests import live


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("integrity") / "out"
    scene = live.ROOT / "scenes" / "bench_lens.json"
    subprocess.run([live.binary(), "trace", scene, "-n", "1000", "-o", folder, "--no-pictures"], check=True,
                   capture_output=True)
    return folder


def _flipped(data: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(data)
    damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


@pytest.mark.parametrize("name", ["report.json", "D.npz"])
def test_flipped_bits_are_reported(result: Path, name: str) -> None:
    rng, path = random.Random(1), result / name
    report = read_report(result)
    arrays = load_arrays(result, "D.npz", report)
    assert "meta" in report and arrays["irradiance"].sum() > 0.0
    data = path.read_bytes()
    num_unreported = 0
    try:
        for _ in range(300):
            path.write_bytes(_flipped(data, rng))
            try:
                found = read_report(result)
                load_arrays(result, "D.npz", found)
            except NsqGpuError as error:
                assert name in str(error)
                continue
            # The name of the hashes' own field was hit: nothing else is another one.
            num_unreported += 1
            assert list(found.values())[:-1] == list(report.values())[:-1]
    finally:
        path.write_bytes(data)
    assert num_unreported <= 3


def test_old_results_still_open_and_bombs_are_refused(result: Path, tmp_path: Path) -> None:
    report = {key: value for key, value in read_report(result).items() if key != "meta"}
    (tmp_path / "report.json").write_text(json.dumps(report), encoding="utf-8")
    (tmp_path / "D.npz").write_bytes((result / "D.npz").read_bytes())
    assert load_arrays(tmp_path, "D.npz", read_report(tmp_path))["irradiance"].shape == (64, 64)
    np.savez_compressed(tmp_path / "D.npz", irradiance=np.zeros((4096, 4096)))
    with pytest.raises(NsqGpuError, match="would unpack to 134217856 bytes"):
        load_arrays(tmp_path, "D.npz", report)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 20, 1 << 20)})
    with zipfile.ZipFile(tmp_path / "D.npz", "w") as archive:
        archive.writestr("irradiance.npy", header.getvalue() + bytes(64))
    with pytest.raises(NsqGpuError, match=f"claims {8 << 40} bytes"):
        load_arrays(tmp_path, "D.npz", report)
