"""Solids inside out, and meshes in other units."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nsq_gpu
from tests import live

GUIDE = live.ROOT / "scenes" / "light_pipe.json"


def _turned(folder: Path, name: str) -> Path:
    """Return the light guide with the media of one of its faces exchanged."""
    scene = json.loads(GUIDE.read_text(encoding="utf-8"))
    face = next(surface for surface in scene["nsq_gpu"]["surfaces"] if surface["name"] == name)
    face["material_front"], face["material_back"] = face.get("material_back"), face.get("material_front")
    path = folder / "scene.json"
    path.write_text(json.dumps(scene), encoding="utf-8")
    return path


def test_a_turned_wall_is_warned_of_by_name(tmp_path: Path) -> None:
    with live.quiet():
        right = nsq_gpu.load_scene(GUIDE)
        wrong = nsq_gpu.load_scene(_turned(tmp_path, "wall_1"))
        told = [scene.trace(2000, seed=1, backend=live.backend()).diagnostics for scene in (right, wrong)]
    assert told[0].wrong_sides == {}
    assert not any("inside out" in warning for warning in told[0].warnings())
    entered = told[1].wrong_sides["entered_twice"]
    assert max(entered, key=entered.get) == "wall_1"
    assert any(warning.startswith("`wall_1` is turned inside out") for warning in told[1].warnings())
    assert "`wall_1` is turned inside out" in told[1].report()
    with pytest.warns(nsq_gpu.ResultWarning, match="`wall_1` is turned inside out"):
        wrong.trace(2000, seed=1, backend=live.backend())


@pytest.mark.parametrize("key", ["embedded", "file"])
def test_a_mesh_is_scaled_as_the_program_scales_it(tmp_path: Path, key: str) -> None:
    scene = json.loads((live.ROOT / "scenes" / "mesh_lens.json").read_text(encoding="utf-8"))
    texts = [json.dumps(scene)]
    for surface in scene["nsq_gpu"]["surfaces"]:
        shape = surface["shape"]
        if shape["type"] != "mesh":
            continue
        vertices = np.asarray(shape["vertices"]) / 4.0
        shape["scale"] = 4.0
        if key == "embedded":
            shape["vertices"] = vertices.tolist()
            continue
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
        lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in shape["faces"]]
        path = tmp_path / f"{surface['name']}.obj"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        del shape["vertices"], shape["faces"]
        shape["path"] = path.name
    texts.append(json.dumps(scene))
    fluxes = []
    for number, text in enumerate(texts):
        path = tmp_path / f"scene_{number}.json"
        path.write_text(text, encoding="utf-8")
        with live.quiet():
            loaded = nsq_gpu.load_scene(path)
            result = loaded.trace(3000, seed=2, backend=live.backend())
        fluxes.append([detector.get_result().total_flux for detector in loaded.detectors])
        assert result.diagnostics.ledger_closes
    assert fluxes[0] == fluxes[1]
    assert sum(fluxes[0]) > 0.0
