"""A slip of the caller is answered by what is wrong, and by what would be right."""

from __future__ import annotations

import builtins
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.bsdf import LambertianBSDF
from optiland.samples.objectives import CookeTriplet

import nsq_gpu
from nsq_gpu import NsqGpuBackend, default, sweeps
from tests import live
from tests.conftest import ROOT
from tests.test_gradients import singlet


def answer(call: Callable[[], Any]) -> nsq_gpu.NsqGpuError:
    with pytest.raises(nsq_gpu.NsqGpuError) as caught:
        call()
    return caught.value


# Backends and scenes


@pytest.mark.parametrize(("given", "said"), [
    ("f32", "backend is 'f32', which is a precision; write NsqGpuBackend(precision='f32')"),
    ("df64", "write NsqGpuBackend(precision='df64')"),
    ("sobol", "which is a sampler; write NsqGpuBackend(sampler='sobol')"),
    ("cuda", "backend is 'cuda'; give a backend, such as NsqGpuBackend()"),
    (NumpyBackend, "backend is the class NumpyBackend; give an instance: NumpyBackend()"),
    (3, "backend is 3; give a backend"),
], ids=str)
def test_use_takes_backends_and_says_what_else_was_meant(given: Any, said: str) -> None:
    assert said in str(answer(lambda: nsq_gpu.use(given)))
    # What was in use goes on.
    assert default._chosen is None
    assert NSQScene.trace is default._optilands


def test_use_of_the_class_is_use_of_its_defaults() -> None:
    try:
        nsq_gpu.use(NsqGpuBackend)
        assert isinstance(default._chosen, NsqGpuBackend)
    finally:
        nsq_gpu.use(None)


def test_a_class_in_the_place_of_an_instance_is_answered_by_the_call_that_makes_one(tmp_path: Path) -> None:
    scene = singlet()
    for call, said in (
        (lambda: scene.trace(10, backend=NsqGpuBackend), "the class NsqGpuBackend; give an instance: NsqGpuBackend()"),
        (lambda: nsq_gpu.from_optic(CookeTriplet), "optic is the class CookeTriplet; give an instance: CookeTriplet()"),
        (lambda: nsq_gpu.from_optic(CookeTriplet(), edges=LambertianBSDF), "edges is the class LambertianBSDF"),
        (lambda: nsq_gpu.jacobian(NSQScene, ["L.r1"], 10), "scene is the class NSQScene; give an instance: NSQScene()"),
        (lambda: nsq_gpu.loss_gradient(NSQScene, ["L.r1"], {}, 10), "scene is the class NSQScene"),
        (lambda: nsq_gpu.diff(scene, NSQScene, 10, binary=live.binary()), "scene is the class NSQScene"),
        (lambda: nsq_gpu.export_scene(NSQScene, tmp_path / "scene.json"), "scene is the class NSQScene"),
        (lambda: nsq_gpu.export_scene(CookeTriplet(), tmp_path / "a.json"), "make a scene of it: nsq_gpu.from_optic"),
        (lambda: nsq_gpu.export_scene("scene.json", tmp_path / "a.json"), "read it: nsq_gpu.load_scene('scene.json')"),
        (lambda: nsq_gpu.jacobian(CookeTriplet(), ["L.r1"], 10), "make a scene of it"),
        (lambda: nsq_gpu.from_file(CookeTriplet()), "make a scene of it: nsq_gpu.from_optic"),
        (lambda: NsqGpuBackend("f32"), "seed is 'f32', which is a precision; write NsqGpuBackend(precision='f32')"),
    ):
        found = answer(call)
        assert isinstance(found, nsq_gpu.UsageError)
        assert said in str(found)
    assert not list(tmp_path.iterdir())


def test_a_method_of_the_class_still_takes_its_instance() -> None:
    result = NsqGpuBackend.trace(live.backend(), singlet(), 100)
    assert result.detectors["image"].total_flux > 0.0


# Names of numbers


#: A wrong name, and what the answer says.
NAMES = [
    ("L.r3", r"`L.r3`: \"L\" has no number `r3`; did you mean `r1`\? Its numbers: .*`r1`, `r2`, `thickness`"),
    ("L.thicknes", "did you mean `thickness`"),
    ("image.widht", "\"image\" has no number `widht`; did you mean `width`"),
    ("M.r1", "nothing in the scene is called \"M\"; did you mean `L`"),
    ("L.front.r1", "`L` has no `front` in the scene file"),
    ("r1", "`r1` names no number; .*numbers of this name: `L.r1`"),
]


@pytest.mark.parametrize(("name", "said"), NAMES, ids=[name for name, _ in NAMES])
def test_a_wrong_name_is_answered_alike_by_derivatives_and_by_sweeps(name: str, said: str, tmp_path: Path) -> None:
    scene, file = singlet(), tmp_path / "scene.json"
    nsq_gpu.export_scene(scene, file)
    options = {"binary": live.binary()}
    with nsq_gpu.Session(binary=live.binary()) as session:
        calls = [
            lambda: nsq_gpu.jacobian(scene, ["L.r1", name], 100, **options),
            lambda: nsq_gpu.jacobian(str(file), name, 100, **options),
            lambda: nsq_gpu.loss_gradient(scene, ["L.r1", name], {"image": np.ones((8, 8))}, 100, **options),
            lambda: session.sweep(scene, {name: [1.0, 2.0]}, 100),
        ]
        texts = set()
        for call in calls:
            found = answer(call)
            assert isinstance(found, nsq_gpu.UnknownNameError)
            # As callers of older versions, and of dictionaries, catch it.
            assert isinstance(found, nsq_gpu.UsageError)
            assert isinstance(found, nsq_gpu.SceneError)
            assert isinstance(found, KeyError)
            assert found.exit_code == 2
            texts.add(str(found))
    [text] = texts
    with pytest.raises(nsq_gpu.UnknownNameError, match=said):
        raise nsq_gpu.UnknownNameError(text)


def test_other_errors_are_not_of_names() -> None:
    for call in (lambda: nsq_gpu.jacobian(singlet(), ["L.material"], 100, binary=live.binary()),
                 lambda: nsq_gpu.jacobian(singlet(), ["L.r1"], 100, precision="f16", binary=live.binary())):
        assert not isinstance(answer(call), nsq_gpu.UnknownNameError)


# Libraries


def test_a_library_that_is_missing_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = builtins.__import__

    def without(name: str, *args: Any, **more: Any) -> Any:
        if name in ("trimesh", "xarray", "pandas", "distributed"):
            raise ImportError(f"No module named {name!r}")
        return plain(name, *args, **more)

    scene = json.loads((ROOT / "scenes" / "mesh_lens.json").read_text(encoding="utf-8"))
    for name in ("trimesh", "xarray", "pandas", "distributed"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(builtins, "__import__", without)
    empty = sweeps.Sweep({"L.r1": np.array([1.0])}, False, {}, {})
    for call, library, extra in (
        (lambda: nsq_gpu.scene_file.scene_from_dict(scene, ROOT / "scenes"), "trimesh", "mesh"),
        (empty.to_xarray, "xarray", "xarray"),
        (nsq_gpu.paths.path_table([]).to_pandas, "pandas", "pandas"),
    ):
        found = answer(call)
        assert isinstance(found, nsq_gpu.MissingLibraryError)
        assert isinstance(found, ImportError)
        assert f"{library} is not installed" in str(found)
        assert str(found).endswith(f"pip install 'nsq-gpu[{extra}]'")


def test_lists_in_the_place_of_dictionaries_are_refused_by_name() -> None:
    with nsq_gpu.Session() as session:
        found = answer(lambda: session.sweep(singlet(), ["L1.r1"], 100))  # type: ignore[arg-type]
        assert str(found) == 'numbers is a list; give a dictionary, such as {"L1.r1": [50, 55]}'
    found = answer(lambda: nsq_gpu.loss_gradient(singlet(), ["L1.r1"], np.ones((4, 4)), 100))  # type: ignore[arg-type]
    assert str(found) == 'adjoints is a ndarray; give a dictionary, such as {"image": array}'


def test_one_name_will_do_for_numbers() -> None:
    with nsq_gpu.Session() as session:
        assert session.numbers(singlet(), "L.r1") == session.numbers(singlet(), ["L.r1"])
