"""``nsq_gpu.verify`` hands on what the command finds."""

import json
import subprocess
from pathlib import Path

import nsq_gpu
import pytest

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "scenes/newtonian_telescope.json"


@pytest.fixture(scope="module")
def traced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verify") / "out"
    subprocess.run([nsq_gpu.find_binary(), "trace", str(SCENE), "-n", "20000", "--proof", "--no-pictures", "-o", str(folder)],
                   check=True, capture_output=True)
    return folder


def test_a_result_with_a_proof_is_proven(traced: Path) -> None:
    found = nsq_gpu.verify(traced, sample=5)
    assert (found.verdict, found.holds, found.findings) == ("proven", True, [])
    assert len(found.report["proof"]["sampled"]) == 5


def test_damage_is_returned_by_file(traced: Path) -> None:
    path = traced / "camera.npz"
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    try:
        found = nsq_gpu.verify(traced)
    finally:
        path.write_bytes(data)
    assert (found.verdict, found.holds) == ("damaged", False)
    assert [finding.file for finding in found.findings] == ["camera.npz"]


def test_another_scene_is_different_and_no_scene_is_told(traced: Path, tmp_path: Path) -> None:
    found = nsq_gpu.verify(traced, scene=ROOT / "scenes/cooke_triplet.json")
    assert (found.verdict, found.holds) == ("different", False)
    with pytest.raises(nsq_gpu.UsageError, match="missing.json"):
        nsq_gpu.verify(traced, scene=tmp_path / "missing.json")


def test_what_is_no_result_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(nsq_gpu.UsageError, match=r"no such folder.*trace -o"):
        nsq_gpu.verify(tmp_path / "resluts")
    with pytest.raises(nsq_gpu.UsageError, match=r"has no report\.json"):
        nsq_gpu.verify(tmp_path)
    (tmp_path / "report.json").write_text(json.dumps({"mete": 1}))
    found = nsq_gpu.verify(tmp_path)
    assert (found.verdict, found.findings[0].file) == ("damaged", "report.json")


def test_a_cluster_refuses_a_proof_by_name() -> None:
    cluster = pytest.importorskip("nsq_gpu.cluster")
    scene = nsq_gpu.load_scene(SCENE)
    with pytest.raises(nsq_gpu.UsageError, match=r"proof: .*--first-ray"):
        cluster.trace(scene, 1000, proof=True)


def test_a_result_in_memory_is_consistent_until_it_is_changed() -> None:
    scene = nsq_gpu.load_scene(SCENE)
    with nsq_gpu.Session() as session:
        result = session.trace(scene, 20_000)
    found = result.verify()
    assert (found.verdict, found.holds) == ("consistent", True), found
    result.report_json["detectors"]["camera"]["total_flux"] *= 1.5
    found = result.verify()
    assert (found.verdict, found.findings[0].place) == ("damaged", "detectors.camera.total_flux")
