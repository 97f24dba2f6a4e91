"""Live values -> plain numbers, or a refusal that names the place."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coordinate_system import CoordinateSystem

from nsq_gpu.errors import ResultWarning, UnsupportedSceneError, UsageError, wants_gradient, warn

Json = dict[str, Any]


def refuse(place: str, problem: str, remedy: str) -> UnsupportedSceneError:
    """Return the exception for something that no scene file can hold."""
    return UnsupportedSceneError(f"{place}: {problem}; {remedy}")


def refuse_type(place: str, what: str, value: object, known: str) -> UnsupportedSceneError:
    """Return the exception for an object of an unknown class: a subclass may do anything, so it is unknown too."""
    return refuse(place, f"{what} is a {type(value).__qualname__}, which has no place in a scene file",
                  f"use {known}")


class Wanted(float):
    """A number by whose tensor a result is to be differentiated."""

    tensor: Any
    place: str

    def __eq__(self, other: object) -> bool:
        """Return whether another number is the same, and wanted by the same leaf: a plain one has no tensor."""
        if not isinstance(other, Wanted) or float(self) != float(other):
            return False
        # What is computed from tensors is computed anew with every component.
        return self.tensor is other.tensor or not (self.tensor.is_leaf or other.tensor.is_leaf)

    def __hash__(self) -> int:
        return super().__hash__()


def all_want_gradients() -> bool:
    """Return whether Optiland makes every constant a tensor that wants a gradient, so that nobody names those that do."""
    return be.get_backend() == "torch" and be.grad_mode.requires_grad


@dataclass
class _Gradients:
    """Which tensors want gradients while a scene is exported with them."""

    #: Whether somebody named those that do.
    are_named: bool
    #: Tensors that get none and were warned of, by their identity.
    dropped: dict[int, Any] = field(default_factory=dict)


#: None if tensors are values.
_gradients: ContextVar[_Gradients | None] = ContextVar("_gradients", default=None)


@contextmanager
def wanted_gradients() -> Iterator[None]:
    """Let tensors that want gradients become :class:`Wanted` numbers. Constants that are made meanwhile want none."""
    everything = all_want_gradients()
    token = _gradients.set(_Gradients(are_named=not everything))
    if everything:
        be.grad_mode.disable()
    try:
        yield
    finally:
        if everything:
            be.grad_mode.enable()
        _gradients.reset(token)


def drop_gradient(value: Any, place: str, problem: str, remedy: str = "detach it") -> None:
    """Refuse a tensor that wants a gradient and can have none; where nobody named it, warn once."""
    gradients = _gradients.get()
    if gradients is None or not wants_gradient(value):
        return
    problem = f"there is no derivative by it: {problem}"
    if gradients.are_named:
        raise refuse(place, f"it has requires_grad=True, and {problem}", remedy)
    if id(value) not in gradients.dropped:
        gradients.dropped[id(value)] = value
        warn(f"{place}: {problem}; it gets no gradient", ResultWarning)


def number(value: Any, place: str) -> float:
    """Return a finite number."""
    plain = _plain(value, place)
    if not math.isfinite(plain):
        raise refuse(place, f"it is {plain}", "give a finite number")
    return plain


def radius(value: Any, place: str) -> float:
    """Return a vertex radius [mm]; infinity, which JSON has no word for, becomes 0: both mean flat."""
    plain = _plain(value, place)
    if math.isinf(plain):
        drop_gradient(value, place, "it is infinite, and a flat face has none by its radius",
                      "give a large radius, such as 1e6, or detach it")
    return 0.0 if math.isinf(plain) else number(plain, place)


def whole_number(name: str, number: float) -> int:
    """Return the whole number that an option was given, be it written as 1e6; what its least is, the program says.

    Raises:
        UsageError: It is no whole number.
    """
    try:
        whole = int(number)
    except (TypeError, ValueError, OverflowError):
        whole = None
    if whole is None or whole != number or isinstance(number, bool | np.bool_):
        raise UsageError(f"{name} is {number!r}; give a whole number")
    return whole


def optional(value: Any, place: str) -> float | None:
    """Return a number, or None."""
    return None if value is None else number(value, place)


def numbers(values: Any, place: str) -> list[float]:
    """Return a list of finite numbers."""
    if isinstance(values, list | tuple):
        return [plain for value in values for plain in numbers(value, place)]
    if _gradients.get() and wants_gradient(values):
        return [number(value, place) for value in values.reshape(-1)]
    return [number(value, place) for value in np.asarray(be.to_numpy(values), dtype=np.float64).ravel().tolist()]


def rows(values: Any, place: str) -> list[list[float]]:
    """Return rows of finite numbers, which may differ in length."""
    try:
        listed = [list(row) for row in values]
    except TypeError as error:
        raise refuse(place, f"{values!r} are no rows of numbers", "give a list of lists of numbers") from error
    return [[number(value, f"{place}[{i}][{j}]") for j, value in enumerate(row)] for i, row in enumerate(listed)]


def _plain(value: Any, place: str) -> float:
    if isinstance(value, Wanted):
        return value
    if _gradients.get() and wants_gradient(value) and value.numel() == 1:
        wanted = Wanted(value.item())
        wanted.tensor, wanted.place = value, place
        return wanted
    try:
        return float(value.item() if hasattr(value, "item") else value)
    except (TypeError, ValueError, RuntimeError) as error:
        raise refuse(place, f"{value!r} is no number", "give a number") from error


def coordinate_system(cs: CoordinateSystem, place: str) -> Json:
    """Return a coordinate system with all those it stands in."""
    if type(cs) is not CoordinateSystem:
        raise refuse_type(place, "its coordinate system", cs, "optiland's CoordinateSystem")
    axes = {axis: number(getattr(cs, axis), f"{place}: cs.{axis}") for axis in ("x", "y", "z", "rx", "ry", "rz")}
    reference = cs.reference_cs
    # A frame that several components stand in may have a name, by which its numbers are called.
    name = {"name": cs.name} if isinstance(getattr(cs, "name", None), str) else {}
    return {**name, **axes, "reference_cs": coordinate_system(reference, place) if reference is not None else None}
