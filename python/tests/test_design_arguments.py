"""Arguments of designs: a wrong kind is refused by name when it is given; numbers of NumPy's types are taken.

The tables go through all arguments of all constructors and functions. An argument without a row fails the first test.
"""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from optiland.optic import Optic
from optiland.optimization import OptimizationProblem

import nsq_gpu
from nsq_gpu.design import (
    EncircledEnergy,
    Flux,
    GhostFlux,
    GhostPeak,
    MatchMap,
    Objective,
    Peak,
    RmsRadius,
    TorchFunction,
    Uniformity,
    operand_estimate,
    operands,
    renew,
)
from tests.test_design_operands import plate, program  # noqa: F401
from tests.test_design_problem import pipe, singlet

NAN, INF = float("nan"), float("inf")


def refused(call: Callable[[], Any], *said: str) -> None:
    """Check that a call is refused by the package's error, which has these words, and what would be right."""
    with pytest.raises(nsq_gpu.UsageError) as caught:
        call()
    message = str(caught.value)
    for words in said:
        assert words in message, message
    assert any(advice in message for advice in ("give ", "did you mean", "known here", "say what is wanted", "name a scene file")), message


#: What is no finite number, no whole number, no text, and no truth value.
NO_NUMBER = ["1", NAN, INF, -INF, True, [1.0], 1j, 10**400]
NO_WHOLE = ["1e4", 1.5, NAN, INF, True, [3], None]
NO_TEXT = [7, "", ["image"], b"image"]
NO_FLAG = ["no", 1, None, 0.0, np.array([True, False])]


# Operands of problems

#: Operands with arguments that are right.
RIGHT: dict[type[Objective], dict[str, Any]] = {
    Flux: {}, GhostFlux: {}, Uniformity: {}, RmsRadius: {}, EncircledEnergy: {"radius": 1.0}, MatchMap: {"wanted": np.eye(3)},
    Peak: {"kernel": 0.5}, GhostPeak: {"kernel": 0.5}, TorchFunction: {"function": abs},
}
#: Values that are wrong, by the names of arguments; None is right where an argument may be missing.
WRONG: dict[str, list[Any]] = {
    "detector": [*NO_TEXT, None], "target": NO_NUMBER, "weight": [*NO_NUMBER, "2", None, -1.0], "where": [3, "", True], "guide": NO_FLAG,
    "name": NO_TEXT,
    "region": ["abcd", (1, 2), (0, 1, 0, "1"), (0, 1, 0, NAN), (0, 1, 1, 0), (1, 1, 0, 1), 5, {0, 1, 2, 3}, dict.fromkeys(range(4))],
    "circle": [(0, 0), (0, 0, -1), (0, 0, 0), "abc", (0, 0, INF), 3.0, (0, 0, True)], "radius": [*NO_NUMBER, 0, -1, None],
    "centre": [(0,), "ab", (0, NAN), 1.0, (0, 0, 0)], "shape": NO_FLAG, "order": [*NO_WHOLE, 1, -2, "8"], "function": [3, None, "sum"],
    "wanted": ["abc", [["1"]], None, 3.0, [[NAN]], [[0.0]], [[1.0], [1.0, 2.0]], [[1j]], [1.0, 2.0], [[1.0, -1.0]]],
}
KERNELS = {Uniformity: [-1, "1", NAN, INF, True], Peak: [-1, 0, None, "1", NAN, INF, True]}


def wrong_of(kind: type[Objective]) -> Iterator[tuple[str, Any]]:
    """Yield the wrong values of all arguments of a kind."""
    for field in dataclasses.fields(kind):
        of_kernel = next((values for of, values in KERNELS.items() if issubclass(kind, of)), [])
        key = "target" if field.name in ("min_val", "max_val") else field.name
        values = of_kernel if key == "kernel" else WRONG[key]
        assert values, f"{kind.__name__}: {key} has no row"
        yield from ((field.name, value) for value in values)


@pytest.mark.parametrize("kind", RIGHT, ids=lambda kind: kind.__name__)
def test_operands_refuse_what_is_of_a_wrong_kind(kind: type[Objective]) -> None:
    for key, value in wrong_of(kind):
        wanted = {} if key in ("target", "min_val", "max_val") else {"target": 0.0}
        refused(lambda: kind(**{"detector": "image", **RIGHT[kind], **wanted, key: value}), key)  # noqa: B023


@pytest.mark.parametrize("kind", RIGHT, ids=lambda kind: kind.__name__)
def test_operands_refuse_names_that_they_do_not_take(kind: type[Objective]) -> None:
    right = {"detector": "image", "target": 0.0, **RIGHT[kind]}
    refused(lambda: kind(**right, wieght=2.0), f"{kind.__name__} takes no 'wieght'", "did you mean 'weight'")
    refused(lambda: kind("image", target=0.0), f"{kind.__name__} takes none of its arguments without a name")
    refused(lambda: kind(target=0.0), f"{kind.__name__} lacks 'detector'")
    refused(lambda: kind(), f"{kind.__name__} lacks 'detector'")
    assert next(iter(inspect.signature(kind).parameters)) == "detector"


@pytest.mark.parametrize("kind", RIGHT, ids=lambda kind: kind.__name__)
def test_operands_take_numbers_of_all_types(kind: type[Objective]) -> None:
    of_region = {"circle": np.array([0, 0, 2], dtype=np.int64)} if "circle" in kind.__dataclass_fields__ else {}
    of_peak = {"order": np.float64(4.0)} if issubclass(kind, Peak) else {}
    found = kind(**{"detector": np.str_("image"), **RIGHT[kind], "min_val": np.float32(0.5), "max_val": np.array(2), "weight": np.int8(3),
                    "guide": np.True_, **of_region, **of_peak})
    assert (found.min_val, found.max_val, found.weight, found.guide) == (0.5, 2.0, 3.0, True)
    for value in vars(found).values():
        assert not isinstance(value, np.generic) or isinstance(value, np.ndarray), value
    if of_region:
        assert found.circle == (0.0, 0.0, 2.0)  # type: ignore[attr-defined]
    if of_peak:
        assert type(found.order) is int  # type: ignore[attr-defined]
        assert found.fewest_blocks == 5
    # As a user writes them, they are the same.
    one, other = (kind(**{**RIGHT[kind], "detector": "image", "target": target}) for target in (1, np.float64(1)))
    assert repr(one) == repr(other)
    assert vars(copy.copy(found)) == vars(found)
    if kind not in (TorchFunction, MatchMap):
        assert pickle.loads(pickle.dumps(found)) == found
    assert dataclasses.replace(found, weight=2).weight == 2.0


def test_limits_the_wrong_way_round_are_refused() -> None:
    refused(lambda: Flux(detector="image", min_val=2, max_val=1), "min_val = 2 is larger than max_val = 1")
    refused(lambda: EncircledEnergy(detector="image", target=1), "radius is 0.0")


def test_a_long_value_is_refused_by_its_kind() -> None:
    with pytest.raises(nsq_gpu.UsageError) as caught:
        Flux(detector="image", target=np.zeros((100, 100)))  # type: ignore[arg-type]
    assert "target is a ndarray" in str(caught.value)
    with pytest.raises(nsq_gpu.UsageError) as caught:
        Flux(detector="image", target=1, region=list(range(1000)))
    assert "region is a long list" in str(caught.value)
    with pytest.raises(nsq_gpu.UsageError, match="detector is the class NSQScene"):
        Flux(detector=type(singlet()), target=1)  # type: ignore[arg-type]


# Problems

#: Wrong values of ``Problem``, by its arguments.
OF_PROBLEM: dict[str, list[Any]] = {
    "scene": [3, None, Optic, "no_such_file.json"], "variables": [["L.r1"], {}, 3, "L.r1", {3: (1, 2)}],
    "operands": [3, None, [], "Flux", [Flux], {"flux": 1}, [3]], "num_rays": [*NO_WHOLE, 0, -5, 3], "blocks": [*NO_WHOLE, 1, 3, -4],
    "seed": [*NO_WHOLE, -1, 2**64], "gradient": ["revers", 3, None, ["auto"], np.array(["auto", "reverse"])],
    "step": [*NO_NUMBER, 0, -0.1, 0.2, None], "max_depth": [*(value for value in NO_WHOLE if value is not None), 0, -3, 2**21],
    "precision": ["f33", 32, None], "adapter": [3, ""], "binary": [3, ["nsq-gpu"]],
}
#: What the error has where it is not the argument's name.
SAID = {("scene", Optic): "scene is the class Optic"}
RANGES = [(2, 1), (1, 1), 5, (1,), (1, 2, 3), "12", ("55", "66"), (NAN, 60), (55, INF), {55, 66}, {55: 66}, None, (True, 60)]


def right_problem(**options: Any) -> nsq_gpu.Problem:
    flux = Flux(detector="image", target=1.0)
    return nsq_gpu.Problem(**{"scene": singlet(), "variables": {"L.r1": (55.0, 66.0)}, "operands": flux, "num_rays": 2000, **options})


@cache
def one_problem() -> nsq_gpu.Problem:
    return right_problem()


@pytest.mark.parametrize("key", OF_PROBLEM)
def test_problems_refuse_what_is_of_a_wrong_kind(key: str) -> None:
    for value in OF_PROBLEM[key]:
        refused(lambda: right_problem(**{key: value}), key)  # noqa: B023


def test_problems_refuse_ranges_that_are_none() -> None:
    for given in RANGES:
        refused(lambda: right_problem(variables={"L.r1": given}), "L.r1", "give its least and its largest value")  # noqa: B023


def test_all_arguments_of_a_problem_and_of_minimize_have_a_row() -> None:
    assert set(inspect.signature(nsq_gpu.Problem).parameters) == set(OF_PROBLEM)
    assert set(inspect.signature(nsq_gpu.Problem.minimize).parameters) - {"self", "options"} == set(OF_MINIMIZE)
    for kind, entry in operands.KINDS.items():
        assert set(operands._COMMON) | set(entry.own) <= set(OF_INPUT), kind


def test_a_problem_refuses_before_a_program_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is wrong with an argument needs no session."""
    monkeypatch.setattr(nsq_gpu.design.problem, "shared_session", lambda *_: pytest.fail("a session was asked for"))
    for key in ("num_rays", "blocks", "seed", "gradient", "step", "max_depth", "precision", "adapter", "binary"):
        for value in OF_PROBLEM[key]:
            refused(lambda: right_problem(**{key: value}), key)  # noqa: B023


def test_problems_take_numbers_of_all_types() -> None:
    one = right_problem(num_rays=np.float64(2e3), blocks=np.int64(8), seed=np.uint8(3), step=np.float32(0.01), max_depth=20.0,
                        variables={"L.r1": np.array([55, 66])})
    settings = one.settings()
    assert (one.num_rays, settings["blocks"], settings["seed"], settings["max_depth"]) == (2000, 8, 3, 20)
    assert all(type(settings[key]) is int for key in ("blocks", "seed", "max_depth")) and type(settings["step"]) is float
    assert settings["variables"] == {"L.r1": [55.0, 66.0]}
    one.num_rays = np.float64(4e3)
    assert one.num_rays == 4000 and type(one.num_rays) is int
    value = float(one.value(np.array([60], dtype=np.int32)))
    assert float(one.value({"L.r1": np.float32(60.0)})) == float(one.value([60])) == float(one.value((60.0,))) == value


#: Wrong values of ``Problem.minimize``.
OF_MINIMIZE: dict[str, list[Any]] = {
    "method": ["LBFGS", 3, None, ["L-BFGS-B"]],
    "x0": ["a", ["60"], [NAN], {"L.r2": 60}, {}, [60.0, 1.0], [True], [1j], [None], [[60.0], [1.0, 2.0]]],
    "max_rays": ["1e4", 1.5, NAN, True, -1000, 0, 3], "budget": [*NO_NUMBER, 0, -1], "steps": [*NO_WHOLE, 0, -1],
    "growth": [*NO_WHOLE, 1, 0], "tolerance": [*NO_NUMBER, -1, None], "errors": NO_FLAG, "callback": [3, "print"], "log": [3, "", ["a"]],
    "resume": [3, ["a"], {"steps": []}],
}


@pytest.mark.parametrize("key", OF_MINIMIZE)
def test_minimize_refuses_what_is_of_a_wrong_kind(key: str) -> None:
    one = one_problem()
    before = one.num_rays, len(one.log)
    for value in OF_MINIMIZE[key]:
        refused(lambda: one.minimize(**{key: value}), "x" if key == "x0" else key)  # noqa: B023
    assert (one.num_rays, len(one.log)) == before


def test_minimize_takes_numbers_of_all_types() -> None:
    design = one_problem().minimize(max_rays=np.float64(2e3), steps=2.0, growth=np.int64(2), tolerance=np.float32(0.5),
                                    budget=np.int64(10**6), errors=np.False_, x0=np.array([60]))
    assert 1 <= len(design.log) <= 2


@pytest.mark.parametrize(("call", "said"), [
    (lambda of: of.renew("1"), "seed is '1'"),
    (lambda of: of.renew(-1), "seed is -1"),
    (lambda of: of.renew(1.5), "seed is 1.5"),
    (lambda of: of.renew(sead=1), "did you mean 'seed'"),
    (lambda of: setattr(of, "num_rays", "2000"), "num_rays is '2000'"),
    (lambda of: setattr(of, "num_rays", 3), "num_rays is 3"),
    (lambda of: of.maps(where=3), "where is 3"),
    (lambda of: of.maps(guide="no"), "guide is 'no'"),
    (lambda of: of.maps(guid=True), "did you mean 'guide'"),
    (lambda of: of.gradient(errors="no"), "errors is 'no'"),
    (lambda of: of.gradient(error=True), "did you mean 'errors'"),
    (lambda of: of.value(["60"]), "x is ['60']"),
    (lambda of: of.value({"L.r1": "60"}), "x is ['60']"),
    (lambda of: of.value(y=[60.0]), "Problem.value takes no 'y'"),
    (lambda of: of.value([60.0], [61.0]), "takes 1 of its arguments without a name, and has 2"),
    (lambda of: of.numbers(), "lacks 'x'"),
    (lambda of: of.spread("a"), "x is 'a'"),
    (lambda of: of.loss([60.0]), "x is [60.0]; give a tensor of Torch"),
    (lambda of: of.minimize(max_ray=5), "did you mean 'max_rays'"),
    (lambda of: right_problem(num_ray=5), "did you mean 'num_rays'"),
    (lambda of: nsq_gpu.Problem(singlet(), {"L.r1": (55, 66)}), "Problem lacks 'operands'"),
    (lambda of: nsq_gpu.Problem(pipe(), {"L.r1": (55, 66)}, []), "scene is a dict"),
    (lambda of: operand_estimate(3), "operand is 3"),
    (lambda of: operand_estimate(["nsq_flux"]), "operand is ['nsq_flux']"),
    (lambda of: operand_estimate("nsq_flu", optic=plate()), "did you mean 'nsq_flux'"),
    (lambda of: operand_estimate(), "lacks 'operand'"),
    (lambda of: renew(3), "optic is 3"),
    (lambda of: renew(), "lacks 'optic'"),
    (lambda of: renew(optik=3), "did you mean 'optic'"),
])
def test_functions_refuse_what_they_do_not_take(call: Any, said: str) -> None:
    with pytest.raises(nsq_gpu.UsageError) as caught:
        call(one_problem())
    assert said in str(caught.value)


def test_register_operands_takes_nothing() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="register_operands takes no arguments"):
        nsq_gpu.register_operands(3)  # type: ignore[call-arg]


# Operands of Optiland's optimisers

#: Wrong values of input data.
OF_INPUT: dict[str, list[Any]] = {
    "optic": [None, 3, Optic, "lens"], "detector": [7, "", ["image"], None, "imag"], "where": [3, "", True], "fields":
    [0, "0", [], [1], [-1], [0.5], [True], ["0"], {"0": 1}, np.array(0)], "num_rays": [*NO_WHOLE, 0, -5, 3], "seed": [*NO_WHOLE, -1, 2**64],
    "blocks": [*NO_WHOLE, 1, 3, -4], "guide": ["no", 1, 0.0], "max_depth": ["16", 1.5, NAN, True, 0, -1], "precision": ["f33", 32, None],
    "adapter": [3, ""], "binary": [3, ["nsq-gpu"]], "detector_pixels": [64, (64,), "ab", (64.5, 64), (0, 64), ("64", "64"), None],
    "detector_size": [4.0, (4.0,), "ab", (0, 1), (-1, 1), (NAN, 1), ("4", "4")], "edges": [3, "absorbin", None],
    "margin": [*NO_NUMBER, 0.5, None], "region": ["abcd", (1, 2), (0, 1, 0, "1"), (1, 0, 0, 1)],
    "circle": [(0, 0), (0, 0, -1), "abc"], "kernel": [-1, "1", NAN, True], "order": ["8", 1.5, 1, True],
}


@pytest.mark.parametrize("kind", operands.KINDS)
def test_input_data_of_a_wrong_kind_are_refused(kind: str) -> None:
    entry = operands.KINDS[kind]
    window = plate()
    for key in {**operands._COMMON, **entry.own}:
        for value in OF_INPUT[key]:
            problem = OptimizationProblem()
            problem.add_operand(kind, target=0, input_data={"optic": window, "num_rays": 1600, key: value})
            refused(lambda: problem.sum_squared(), key, f"{kind}: " if key != "edges" else "edges")  # noqa: B023


@pytest.mark.parametrize("kind", operands.KINDS)
def test_misspelt_input_data_are_answered_by_the_name_that_was_meant(kind: str) -> None:
    refused(lambda: operand_estimate(kind, optic=plate(), num_ray=1600), f"{kind} takes no 'num_ray'", "did you mean 'num_rays'")


def test_input_data_take_numbers_of_all_types() -> None:
    window = plate()
    plain = {"num_rays": 1600, "seed": 3, "blocks": 8, "max_depth": 20, "fields": [0],
             "detector_size": (10.0, 10.0), "detector_pixels": (64, 64)}
    others = {"num_rays": 1.6e3, "seed": np.int64(3), "blocks": np.float64(8.0), "max_depth": np.uint8(20), "fields": np.array([0]),
              "detector_size": np.array([10, 10]), "detector_pixels": np.array([64.0, 64.0])}
    one = operand_estimate("nsq_ghost_peak", optic=window, kernel=1, order=4, **plain)
    assert one == operand_estimate("nsq_ghost_peak", optic=window, kernel=np.float32(1.0), order=4.0, **others)
