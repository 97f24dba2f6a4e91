"""Keyword arguments reach every trace that a call makes: none is dropped on the way to the program."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import LensConfig, NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
import nsq_gpu.cluster
import nsq_gpu.difference
from nsq_gpu.edges import shape_of
from nsq_gpu.session import Session
from tests import live
from tests.live import cs, glass

#: Keyword arguments that say how the program is run, and not what it traces: tests/test_session.py has them.
ELSEWHERE = {"adapter", "binary", "timeout"}


def scene(beam: float = 13.0) -> NSQScene:
    """Return one lens, a beam that fills it beyond its rim of 12 mm, or stays clear of it, and a map."""
    built = NSQScene()
    built.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=beam))
    built.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass(), 12.0))
    built.add_detector("image", cs(z=40.0), IrradianceDetectorConfig(12.0, 12.0, 8, 8))
    return built


class Told(Exception):
    """What a request had."""


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], Any]:
    """Return what asks for a trace and returns the request instead."""
    def ask(self: Session, header: Any, timeout: Any, progress: Any, *more: Any, **options: Any) -> None:
        raise Told(header)

    def run(command: list[str], *more: Any, **options: Any) -> None:
        raise Told(command)

    monkeypatch.setattr(Session, "_ask", ask)
    def run_in(folder: Any, command: list[str], *more: Any) -> None:
        raise Told(command)

    monkeypatch.setattr(nsq_gpu.difference, "run", run)
    monkeypatch.setattr(nsq_gpu.cluster, "_run", run_in)

    def request(call: Callable[[], Any]) -> Any:
        with pytest.raises(Told) as found:
            call()
        return found.value.args[0]

    return request


def keywords(call: Callable[..., Any]) -> set[str]:
    """Return the names of a function's keyword arguments."""
    parameters = inspect.signature(call).parameters.values()
    return {parameter.name for parameter in parameters if parameter.kind is inspect.Parameter.KEYWORD_ONLY} - ELSEWHERE


#: A value of each keyword argument of a derivative, and where the request has it.
DERIVATIVES = {
    "where": ("reflections == 2", lambda header: header["options"]["where"]),
    "edges": (True, lambda header: header["gradient_edges"]),
    "progress": (True, lambda header: header["progress"]),
    "seed": (7, lambda header: header["options"]["seed"]),
    "max_depth": (9, lambda header: header["options"]["max_depth"]),
    "precision": ("f32", lambda header: header["options"]["precision"]),
}
#: The same of a difference, whose command has it.
DIFFERENCE = {"where": "reflections == 2", "seed": 7, "max_depth": 9, "precision": "f32", "sampler": "sobol", "progress": True,
              "guide": True}


@pytest.mark.parametrize("name", ["jacobian", "loss_gradient"])
def test_a_derivative_hands_on_each_keyword(name: str, told: Callable[..., Any]) -> None:
    function = getattr(nsq_gpu, name)
    assert keywords(function) == set(DERIVATIVES), "each keyword has a line"
    adjoints = () if name == "jacobian" else ({"image": np.ones((8, 8))},)
    for keyword, (value, of_header) in DERIVATIVES.items():
        header = told(lambda: function(scene(), ["L.r1"], *adjoints, 1000, binary=live.binary(), **{keyword: value}))
        assert of_header(header) == value, keyword


def test_a_difference_hands_on_each_keyword(told: Callable[..., Any]) -> None:
    assert keywords(nsq_gpu.diff) == set(DIFFERENCE), "each keyword has a line"
    for keyword, value in DIFFERENCE.items():
        command = told(lambda: nsq_gpu.diff(scene(), scene(), 1000, binary=live.binary(), **{keyword: value}))
        flags = {"progress": "--progress=json", "guide": "--guide"}
        expected = flags.get(keyword, f"--{keyword.replace('_', '-')}={value}")
        assert expected in command, keyword


def test_the_pilot_of_a_cluster_hears_of_all_options(told: Callable[..., Any]) -> None:
    options = {"seed": 7, "max_depth": 9, "precision": "f32", "where": "reflections == 2", "reflect_prob": 0.5, "paths": True}
    expected = {"--num-rays=8192", "--seed=7", "--max-depth=9", "--precision=f32", "--where=reflections == 2",
                "--reflect-prob=0.5", "--paths=on"}
    cluster = {"binary": live.binary(), **options}
    assert expected <= set(told(lambda: nsq_gpu.cluster.trace(scene(), 100_000, **cluster)))
    assert expected <= set(told(lambda: nsq_gpu.cluster.sweep(scene(), {"L.r1": [50.0]}, 100_000, **cluster)))


REFUSED = {"target_error": "1%", "time_limit": "60s", "first_ray": 10, "of_rays": 100_000, "paths": "on", "standard_error": "on",
           "record_paths": "all", "photometric": "on"}


@pytest.mark.parametrize("option", REFUSED)
def test_what_derivatives_cannot_heed_is_refused_by_name(option: str) -> None:
    text = nsq_gpu.export.to_json(nsq_gpu.export.export(scene()).document)
    options = {"num_rays": 1000, option: REFUSED[option]}
    with Session(binary=live.binary()) as session:
        with pytest.raises(nsq_gpu.UsageError, match=f"options.{option} and gradient do not go together"):
            session.request(text, options, gradient=["L.r1"])
        with pytest.raises(nsq_gpu.UsageError, match=f"options.{option} and adjoints do not go together"):
            session.loss_gradient(text, options, ["L.r1"], {"image": np.ones((8, 8))})


def test_what_is_no_text_or_no_answer_is_refused() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="where is 2; give a text"):
        nsq_gpu.jacobian(scene(), ["L.r1"], 1000, where=2, binary=live.binary())
    with pytest.raises(nsq_gpu.UsageError, match="edges is 'absorbing'; give True or False"):
        nsq_gpu.loss_gradient(scene(), ["L.r1"], {"image": np.ones((8, 8))}, 1000, edges="absorbing", binary=live.binary())


def differences(where: str | None, step: float = 0.05) -> Any:
    """Return the difference of two scenes, whose lens is larger by a step in one of them."""
    def changed(change: float) -> NSQScene:
        built = NSQScene()
        built.add_source("beam", cs(z=-20.0), CollimatedSourceConfig(live.two_lines(), aperture_radius=13.0))
        built.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass(), 12.0 + change))
        built.add_detector("image", cs(z=40.0), IrradianceDetectorConfig(12.0, 12.0, 8, 8))
        return built

    options = {"where": where, "seed": 3, "precision": "f64", "binary": live.binary()}
    return nsq_gpu.diff(changed(step), changed(-step), 100_000, **options).detectors["image"], 2 * step


@pytest.mark.parametrize("where", [None, "reflections == 0"])
def test_a_derivative_with_edges_is_that_of_a_difference(where: str | None) -> None:
    name, seen = "L.front_aperture_radius", []
    options = {"where": where, "edges": True, "seed": 3, "precision": "f64", "binary": live.binary()}
    found = nsq_gpu.jacobian(scene(), [name], 100_000, progress=lambda *status: seen.append(status), **options)
    ours = found[name, "image"]
    theirs, distance = differences(where)
    error = np.hypot(ours.standard_error, theirs.standard_error / distance)
    assert abs(ours.flux - theirs.difference / distance) < 4.5 * error < 0.4 * ours.flux
    # The interior sees nothing of the rim.
    assert ours.interior.flux == 0.0 and not ours.interior.map.any()
    pixel_area = 12.0 * 12.0 / 64
    assert ours.map.sum() * pixel_area == pytest.approx(ours.flux, rel=1e-9)
    assert ours.map_standard_error.shape == ours.map.shape
    # One pass for the interior, and two for the difference.
    assert seen[-1][:2] == (300_000, 300_000)
    adjoints = np.linspace(0.5, 2.0, 64).reshape(8, 8)
    loss = nsq_gpu.loss_gradient(scene(), [name], {"image": adjoints}, 100_000, **options)
    assert loss[name] == pytest.approx((ours.map * adjoints).sum() * pixel_area, rel=1e-9)
    assert loss.interior == {name: 0.0} and 0.0 < loss.standard_errors[name] < 0.2 * loss[name]


def test_where_keeps_light_of_a_derivative_and_of_a_loss() -> None:
    options = {"where": "reflections == 2", "precision": "f64", "binary": live.binary()}
    ghosts = nsq_gpu.jacobian(scene(8.0), ["beam.total_flux"], 50_000, **options)["beam.total_flux", "image"].flux
    loss = nsq_gpu.loss_gradient(scene(8.0), ["beam.total_flux"], {"image": np.ones((8, 8))}, 50_000, **options)
    backend = live.backend(where="reflections == 2")
    flux = scene(8.0).trace(50_000, backend=backend).detectors["image"].total_flux
    # The flux of a source is a factor of all light.
    assert 0.0 < ghosts < 0.01
    assert ghosts == pytest.approx(flux, rel=1e-9) and loss["beam.total_flux"] == pytest.approx(flux, rel=1e-9)


def test_scenes_that_differ_in_numbers_alone_have_one_shape() -> None:
    document = {"components": [{"name": "L", "r1": 50.0, "coefficients": [1.0, 2.0], "absorb": True}]}
    other = {"components": [{"name": "L", "r1": 60.0, "coefficients": [3.0, 2.0], "absorb": True}]}
    shape = shape_of(document, {}, ["L.r1"])
    assert shape_of(other, {"where": None}, ["L.r1"]) == shape
    another = {"components": [{"name": "M", "r1": 50.0, "coefficients": [1.0, 2.0], "absorb": True}]}
    for differs in (shape_of(document, {"where": "events > 0"}, ["L.r1"]), shape_of(document, {}, ["L.r2"]),
                    shape_of(another, {}, ["L.r1"])):
        assert differs != shape
