"""Results in folders: those of the command in all that is the same, read back whole, and never written over another."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nsq_gpu
from nsq_gpu.integrity import read_report
from nsq_gpu.storing import _cell, file_stems
from tests import live
from tests.live import bench
from tests.test_display import four

NUM_RAYS = 20_000
#: What depends on the moment, the file of the scene, and the bytes of files.
OF_ITS_OWN = {"trace_time_sec", "rays_per_sec", "first_rays_sec", "scene", "meta"}


def command(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([live.binary(), *arguments], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def result() -> nsq_gpu.Result:
    with nsq_gpu.Session(binary=live.binary(), precision="f64") as session:
        return session.trace(four(), NUM_RAYS, standard_error=True, paths=True, record_paths=50)


@pytest.fixture(scope="module")
def saved(result: nsq_gpu.Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("saved") / "run 1"
    result.save(folder)
    return folder


@pytest.fixture(scope="module")
def written(saved: Path) -> Path:
    """Return the folder of the command, by the same options."""
    folder = saved.parent / "command"
    done = command("trace", saved / "scene.json", f"--num-rays={NUM_RAYS}", "--seed=0", "--max-depth=16", "--precision=f64",
                   "--strict=on", "--standard-error=on", "--paths=on", "--record-paths=50", "--no-pictures", f"--output={folder}")
    assert done.returncode == 0, done.stderr
    return folder


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def arrays(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as found:
        return dict(found)


# The folder of the command


def test_a_folder_has_the_files_of_the_command(saved: Path, written: Path) -> None:
    assert files(saved) == files(written) - {"tally.bin"} | {"scene.json"}
    ours, theirs = read_report(saved), read_report(written)
    for report in (ours, theirs):
        assert set(report["meta"]["files"]) == files(saved if report is ours else written) - {"report.json"}
    assert {key: value for key, value in ours.items() if key not in OF_ITS_OWN} == \
        {key: value for key, value in theirs.items() if key not in OF_ITS_OWN}
    assert (saved / "paths.csv").read_bytes() == (written / "paths.csv").read_bytes()


def test_arrays_have_the_bits_of_the_command(saved: Path, written: Path) -> None:
    names = [name for name in files(saved) if name.endswith(".npz")]
    assert len(names) == 5
    for name in names:
        ours, theirs = arrays(saved / name), arrays(written / name)
        assert list(ours) == list(theirs)
        for key, array in ours.items():
            assert array.dtype == theirs[key].dtype and array.tobytes() == theirs[key].tobytes(), (name, key)


def test_the_commands_tools_read_a_folder(saved: Path, written: Path) -> None:
    same = command("compare", saved, written)
    assert same.returncode == 0 and "my wall" in same.stdout, same.stderr
    # And they name what was changed in it.
    data = bytearray((saved / "sky.npz").read_bytes())
    data[len(data) // 2] ^= 1
    other = saved.parent / "damaged"
    other.mkdir()
    for name in files(saved):
        (other / name).write_bytes(data if name == "sky.npz" else (saved / name).read_bytes())
    damaged = command("compare", other, written)
    assert damaged.returncode == 2 and "sky.npz" in damaged.stderr
    with pytest.raises(nsq_gpu.NsqGpuError, match="sky.npz: is damaged"):
        nsq_gpu.load(other)


def test_the_scene_that_was_saved_gives_the_result_again(saved: Path, result: nsq_gpu.Result) -> None:
    again = nsq_gpu.load_scene(saved / "scene.json").trace(NUM_RAYS, backend=live.backend(standard_error=True))
    assert np.array_equal(again.detectors["my wall"].irradiance, result.detectors["my wall"].irradiance)


def test_names_of_files_are_those_of_the_command(tmp_path: Path) -> None:
    names = ["a/b", "a_b", "A_B", "con", ".hidden", "-n", "ray_paths", "x" * 100, "é", "CON.x", " "]
    expected = ["a_b", "a_b_2", "A_B_3", "_con", "_.hidden", "_-n", "ray_paths_2", "x" * 60, "é", "_CON.x", "detector"]
    assert file_stems(names) == expected
    from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig

    scene = bench()
    for place, name in enumerate(names[:-1]):
        scene.add_detector(name, live.cs(z=31.0 + place), IrradianceDetectorConfig(10.0, 10.0, 2, 2))
    with pytest.warns(nsq_gpu.ResultWarning):
        scene.trace(100, backend=live.backend()).save(tmp_path / "ours")
    command("trace", tmp_path / "ours" / "scene.json", "--num-rays=100", "--no-pictures", f"--output={tmp_path / 'theirs'}")
    assert files(tmp_path / "ours") - {"scene.json"} == files(tmp_path / "theirs") - {"tally.bin"}


def test_numbers_of_tables_are_written_as_the_command_writes_them() -> None:
    assert [_cell(value) for value in (0.1, 1.0, 0.0, 123.456, 1e-300, 1e22, 3, None, "=1+1", "a,b")] == \
        ["1e-1", "1e0", "0e0", "1.23456e2", "1e-300", "1e22", "3", "", "'=1+1", "a,b"]


# Read back


def same_detectors(one: nsq_gpu.Result, other: nsq_gpu.Result) -> None:
    assert list(one.detectors) == list(other.detectors)
    for name, found in one.detectors.items():
        again = other.detectors[name]
        assert type(found) is type(again)
        for key, value in vars(found).items():
            if isinstance(value, np.ndarray | float | int):
                # A live map is computed from its watts: the last bit of a pixel may differ.
                assert np.allclose(value, getattr(again, key), rtol=1e-15 * 8, atol=0.0, equal_nan=True), (name, key)
        assert found.few_rays == again.few_rays


def test_a_result_is_read_back_whole(saved: Path, result: nsq_gpu.Result) -> None:
    found = nsq_gpu.load(saved)
    same_detectors(result, found)
    assert live.same_rows(found.paths, result.paths) and found.few_rays == result.few_rays
    assert found.diagnostics == result.diagnostics and found.report() == result.report()
    assert repr(found) == repr(result) and found.partial is False
    assert found.scene_json == result.scene_json
    events, expected = found.ray_paths["events"], result.ray_paths["events"]
    for key in ("ray_id", "x", "y", "z", "flux", "bounce"):
        assert np.array_equal(events[key], expected[key])
    assert found.to_xarray().equals(result.to_xarray()) if pytest.importorskip("xarray") else True
    found.plot("my wall")


def test_what_was_read_is_saved_again_as_it_was(saved: Path, tmp_path: Path) -> None:
    nsq_gpu.load(saved).save(tmp_path / "again")
    for name in files(saved) - {"report.json"}:
        assert (saved / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_folders_of_the_command_are_read(written: Path, result: nsq_gpu.Result) -> None:
    found = nsq_gpu.load(written)
    same_detectors(result, found)
    # The command's folder has no scene of its own.
    assert found.scene_json is None


def test_a_long_trace_and_a_stopped_one_are_saved_as_well(tmp_path: Path) -> None:
    long = bench().trace(1_200_000, backend=live.backend())
    long.save(tmp_path / "long")
    assert np.array_equal(nsq_gpu.load(tmp_path / "long").arrays["screen"]["hits"], long.arrays["screen"]["hits"])
    with nsq_gpu.Session(binary=live.binary()) as session, pytest.raises(nsq_gpu.TraceTimeoutError) as caught:
        session.trace(bench(), 10**11, timeout=3.0)
    caught.value.partial.save(tmp_path / "stopped")
    found = nsq_gpu.load(tmp_path / "stopped")
    assert found.partial and found.num_rays_total == caught.value.partial.num_rays_total > 0


@pytest.mark.parametrize(("made", "said"), [
    (lambda folder: None, "there is no such folder; give a folder that result.save or `nsq-gpu trace -o` wrote"),
    (lambda folder: folder.mkdir(), "has no report.json"),
    (lambda folder: (folder.mkdir(), (folder / "report.json").write_text("{")), "is damaged"),
    (lambda folder: command("diff", live.ROOT / "docs" / "example.json", "--set", "L1.r1=51", "-n", "1000", "--no-pictures", "-o",
                            folder), "is no result of a trace"),
])
def test_what_is_no_result_is_refused(tmp_path: Path, made: Any, said: str) -> None:
    made(tmp_path / "given")
    with pytest.raises(nsq_gpu.NsqGpuError, match=said):
        nsq_gpu.load(tmp_path / "given")


def test_an_edited_scene_is_refused(saved: Path, tmp_path: Path) -> None:
    nsq_gpu.load(saved).save(tmp_path / "edited")
    path = tmp_path / "edited" / "scene.json"
    path.write_text(path.read_text().replace("lamp", "lump"))
    with pytest.raises(nsq_gpu.NsqGpuError, match="scene.json: is damaged, was edited"):
        nsq_gpu.load(tmp_path / "edited")


# Files that are there


def test_nothing_is_written_over(result: nsq_gpu.Result, tmp_path: Path) -> None:
    for name in ("report.json", "my_wall.npz", "scene.json", "paths.csv"):
        folder = tmp_path / name.partition(".")[0]
        folder.mkdir()
        (folder / name).write_text("mine")
        with pytest.raises(nsq_gpu.UsageError, match="overwrite=True replaces it, or give another folder"):
            result.save(folder)
        assert files(folder) == {name} and (folder / name).read_text() == "mine"
    (tmp_path / "file").write_text("mine")
    with pytest.raises(nsq_gpu.UsageError, match="file: is no folder"):
        result.save(tmp_path / "file", overwrite=True)


def test_a_result_of_this_very_process_is_kept_as_well(result: nsq_gpu.Result, tmp_path: Path) -> None:
    result.save(tmp_path)
    before = (tmp_path / "report.json").read_bytes()
    with pytest.raises(nsq_gpu.UsageError, match="holds a result; overwrite=True replaces it"):
        bench().trace(1000, backend=live.backend()).save(tmp_path)
    assert (tmp_path / "report.json").read_bytes() == before


def test_overwrite_replaces_a_result_and_keeps_what_others_wrote(result: nsq_gpu.Result, tmp_path: Path) -> None:
    result.save(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "sky.npz").write_bytes(b"changed since")
    bench().trace(1000, backend=live.backend()).save(tmp_path, overwrite=True)
    # What nobody changed goes with its result.
    assert files(tmp_path) == {"screen.npz", "report.json", "scene.json", "notes.txt", "sky.npz"}
    assert list(nsq_gpu.load(tmp_path).detectors) == ["screen"]


def test_links_are_not_written_through(result: nsq_gpu.Result, tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "sky.npz").symlink_to(tmp_path / "mine")
    with pytest.raises(nsq_gpu.UsageError, match="is a link"):
        result.save(tmp_path / "folder", overwrite=True)
    assert (tmp_path / "mine").read_text() == "mine" and files(tmp_path / "folder") == {"sky.npz"}


def test_a_save_that_fails_leaves_the_old_result_whole(result: nsq_gpu.Result, tmp_path: Path,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    bench().trace(1000, backend=live.backend()).save(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    kept = nsq_gpu.placing._write_new

    def full(path: Path, data: bytes) -> None:
        if path.name == "sky.npz":
            raise OSError("no space left on device")
        kept(path, data)

    monkeypatch.setattr(nsq_gpu.placing, "_write_new", full)
    with pytest.raises(OSError, match="no space"):
        result.save(tmp_path, overwrite=True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_every_number_of_a_report_survives(saved: Path, result: nsq_gpu.Result) -> None:
    report = json.loads((saved / "report.json").read_text())
    assert report["ledger"] == result.report_json["ledger"] and report["total_flux_detected"] == result.total_flux_detected
