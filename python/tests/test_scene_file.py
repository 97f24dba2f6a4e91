"""The text of scene files: what Python reads of JSON5, and what it refuses."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from nsq_gpu import SceneError, UnsupportedSceneError, load_scene
from nsq_gpu.binary import ENVIRONMENT
from nsq_gpu.scene_file import read_document, scene_from_dict
from tests import live

EXAMPLE = (live.ROOT / "docs" / "example.json").read_text(encoding="utf-8")


def written(folder: Path, text: str) -> Path:
    path = folder / "scene.json"
    path.write_text(text, encoding="utf-8")
    return path


def test_loads_a_scene_with_comments_trailing_commas_and_a_mark_as_the_command_does(tmp_path: Path) -> None:
    text = "\ufeff// it's a \"scene\", {\n" + EXAMPLE.rstrip().removesuffix("}") + ", /* the * end, ] */ } // done"
    path = written(tmp_path, text)
    subprocess.run([live.binary(), "check", str(path)], check=True, capture_output=True)
    assert read_document(path) == json.loads(EXAMPLE)
    with live.quiet():
        assert load_scene(path).component_names == load_scene(written(tmp_path, EXAMPLE)).component_names


@pytest.mark.parametrize(("text", "expected"), [
    ("[1, 2, // two\n]", [1, 2]),
    ("[[1,],/**/]", [[1]]),
    ("[1/* , */,\r\n/* // */2]", [1, 2]),
    ('{"a": "//", "b": "/* , ] */", "c": ",]",}', {"a": "//", "b": "/* , ] */", "c": ",]"}),
    (r'["\"//", "\\", /* " */ ",}",]', ['"//', "\\", ",}"]),
    ("[-Infinity,]", [float("-inf")]),
])
def test_nothing_but_comments_and_trailing_commas_goes(text: str, expected: object, tmp_path: Path) -> None:
    assert read_document(written(tmp_path, text)) == expected


@pytest.mark.parametrize("text", [
    "", "[,]", "{,}", "[1,,]", '{"a":,}', "[1] ,", "[1 /* no end", "[1 / 2]", "1/**/2", '["no end // ]',
    '["two\nlines"]', "['quotes']", "{key: 1}", "[0x10]", "[.5]", "[+1]",
])
def test_refuses_the_rest_and_says_so(text: str, tmp_path: Path) -> None:
    with pytest.raises(json.JSONDecodeError, match="comments, trailing commas.*no more of JSON5"):
        read_document(written(tmp_path, text))


def test_errors_name_the_place_in_the_file(tmp_path: Path) -> None:
    with pytest.raises(json.JSONDecodeError, match=r"line 3 column 15 \("):
        read_document(written(tmp_path, '{ // one\n/* two\n*/ "a": [1,], b: 2}'))


@pytest.mark.parametrize(("old", "new", "said"), [
    ('"irradiance"', '"iradiance"', "detectors\\[0\\].type: unknown type"),
    ('"thickness"', '"thicknes"', "did you mean `thickness`"),
])
def test_what_the_command_refuses_is_refused_with_its_place(old: str, new: str, said: str, tmp_path: Path) -> None:
    with mock.patch.dict(os.environ, {ENVIRONMENT: live.binary()}), pytest.raises(SceneError, match=said):
        load_scene(written(tmp_path, EXAMPLE.replace(old, new)))


def with_a_dish() -> Any:
    document = json.loads(EXAMPLE)
    document["nsq_gpu"]["surfaces"].append({
        "name": "dish", "cs": {"z": 500.0}, "interaction": "reflective", "reflectance": 0.9,
        "shape": {"type": "conic", "radius": -80.0, "conic": -1.0, "aperture_radius": 9.0},
        "bsdf": {"type": "harvey_shack", "b0": 1.0, "l0": 0.1, "s": 2.0}})
    document["nsq_gpu"]["overrides"]["L1.back"] = {"bsdf": {"type": "lambertian"}, "scatter_fraction": 0.5}
    return document


@pytest.mark.parametrize(("place", "keys"), [
    ("nsq_gpu.surfaces[2].shape", ("nsq_gpu", "surfaces", 2, "shape")),
    ("nsq_gpu.surfaces[2].bsdf", ("nsq_gpu", "surfaces", 2, "bsdf")),
    ('nsq_gpu.overrides["L1.back"].bsdf', ("nsq_gpu", "overrides", "L1.back", "bsdf")),
    ("sources[0]", ("sources", 0)),
    ("detectors[0]", ("detectors", 0)),
])
def test_a_type_without_a_class_is_refused_with_its_place(place: str, keys: tuple[Any, ...]) -> None:
    document = with_a_dish()
    with live.quiet():
        scene_from_dict(document)
    entry = document
    for key in keys:
        entry = entry[key]
    # As a kind that the program alone has.
    entry["type"] = "newest"
    with pytest.raises(UnsupportedSceneError) as error, live.quiet():
        scene_from_dict(document)
    assert str(error.value).startswith(f"{place}: the type 'newest' has no class in Python")
    assert "nsq-gpu trace SCENE -o FOLDER" in str(error.value) and "nsq_gpu.load(FOLDER)" in str(error.value)
