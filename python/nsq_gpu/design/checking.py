"""Arguments of designs: each is returned as what it must be, or refused by its name, with what would be right.

>>> Flux(detector="screen", target="1")
UsageError: flux on screen: target is '1'; give a finite number

Numbers may be of NumPy's types, or tensors of one element. Whole numbers may be written as 1e4.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import wraps
from numbers import Real
from typing import Any, TypeVar

import numpy as np

from nsq_gpu.arguments import near, refused
from nsq_gpu.errors import UsageError, wants_gradient

#: Seeds are below this one. Checks and fresh draws take larger seeds, which must fit into 64 bits.
_SEEDS = 2**63
#: The largest depth that the program takes.
_DEEPEST = 2**20

_T = TypeVar("_T")


def _refuse_gradient(name: str, value: object) -> None:
    """Refuse a tensor that wants a gradient, which it would not get."""
    if wants_gradient(value):
        raise UsageError(f"{name} has requires_grad=True, and nothing is differentiated by it here; detach it")


def _real(name: str, value: Any) -> Any:
    """Return a real number as Python has it; None of what is no such number. Truth values are none."""
    _refuse_gradient(name, value)
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    return value if isinstance(value, Real) and not isinstance(value, bool) else None


def number(name: str, value: object, wanted: str = "a finite number", *, least: float = -np.inf, above: float = -np.inf,
           most: float = np.inf) -> float:
    """Return a finite number within limits; ``wanted`` says what would be right."""
    found = _real(name, value)
    try:
        found = np.nan if found is None else float(found)
    except OverflowError:
        found = np.inf
    if not (np.isfinite(found) and found >= least and above < found <= most):
        raise refused(name, value, wanted)
    return float(found)


def whole(name: str, value: object, least: int, few: str | None = None, *, most: int | None = None) -> int:
    """Return a whole number of at least ``least``; ``few`` says what to give where there are fewer."""
    found = _real(name, value)
    try:
        is_whole = found is not None and int(found) == found
    except (ValueError, OverflowError):
        is_whole = False
    if not is_whole:
        raise refused(name, value, f"a whole number of {least} or more")
    if found < least:
        raise refused(name, value, few or f"{least} or more")
    if most is not None and found > most:
        raise refused(name, value, f"a whole number from {least} to {most}")
    return int(found)


def seed_of(name: str, value: object) -> int:
    """Return a seed."""
    return whole(name, value, 0, most=_SEEDS - 1)


def rays_of(name: str, value: object, blocks: int) -> int:
    """Return a number of rays, one or more for each block."""
    return whole(name, value, blocks, f"at least one for each of the {blocks} blocks")


def depth_of(name: str, value: object) -> int:
    """Return a largest number of events of a ray."""
    return whole(name, value, 1, most=_DEEPEST)


def numbers(name: str, value: object, count: int, wanted: str, *, above: float = -np.inf) -> tuple[float, ...]:
    """Return so many finite numbers, which stand in an order."""
    return tuple(_each(name, value, count, wanted, lambda item: number(name, item, above=above)))


def wholes(name: str, value: object, count: int | None, wanted: str, least: int) -> list[int]:
    """Return so many whole numbers of at least ``least``, which stand in an order; one or more where ``count`` is None."""
    return _each(name, value, count, wanted, lambda item: whole(name, item, least))


def _each(name: str, value: object, count: int | None, wanted: str, take: Callable[[Any], _T]) -> list[_T]:
    """Return the items of a list, each as it is taken; where one is refused, the list is."""
    found = listed(value)
    if not found or len(found) != (count or len(found)):
        raise refused(name, value, wanted)
    try:
        return [take(item) for item in found]
    except UsageError:
        if any(map(wants_gradient, found)):
            raise
        raise refused(name, value, wanted) from None


def listed(value: object) -> list[Any] | None:
    """Return the items of a list, a tuple or an array; None of what has no order, or is a text."""
    if not isinstance(value, Iterable) or isinstance(value, str | bytes | Mapping | AbstractSet):
        return None
    try:
        return list(value)
    except TypeError:
        # An array of no dimension.
        return None


def array(name: str, value: Any, wanted: str, kinds: str = "iuf") -> np.ndarray:
    """Return an array of numbers, which need not be finite. Texts of numbers are none; ``kinds`` are NumPy's letters."""
    _refuse_gradient(name, value)
    try:
        found = np.asarray(value.cpu() if hasattr(value, "cpu") else value)
        if found.dtype == object and all(_real(name, item) is not None for item in found.ravel()):
            found = found.astype(float)
    except (TypeError, ValueError, OverflowError):
        raise refused(name, value, wanted) from None
    if found.dtype.kind not in kinds:
        raise refused(name, value, wanted)
    return np.array(found, dtype=float)


def text(name: str, value: object, wanted: str) -> str:
    """Return a text of one letter or more."""
    if not isinstance(value, str) or not value:
        raise refused(name, value, wanted)
    return str(value)


def filter_of(name: str, value: object) -> str | None:
    """Return a filter of paths, or None; what its words mean, the program says."""
    return None if value is None else text(name, value, 'a text, such as "reflections == 0", or None')


def one_of(name: str, value: object, known: Sequence[str]) -> str:
    """Return one of the known words."""
    if not isinstance(value, str):
        raise refused(name, value, f"one of {', '.join(map(repr, known))}")
    if value not in known:
        raise UsageError(f"{name} is {value!r}; {near(value, known)}")
    return value


def path(name: str, value: object) -> Any:
    """Return the name of a file."""
    if not isinstance(value, str | os.PathLike) or not os.fspath(value):
        raise refused(name, value, "the path of a file")
    return value


def function(name: str, value: object, example: str) -> Any:
    """Return what can be called."""
    if not callable(value):
        raise refused(name, value, f"a function, such as {example}")
    return value


def by_names(of: _T) -> _T:
    """Answer a name that a call does not take by the nearest name that it takes. Missing arguments are named, too.

    It decorates a function, or a class, whose constructor then does so.
    """
    if isinstance(of, type):
        setattr(of, "__init__", by_names(vars(of)["__init__"]))  # noqa: B010
        return of
    called: Callable[..., Any] = of  # type: ignore[assignment]
    signature = inspect.signature(called)
    label = called.__qualname__.removesuffix(".__init__")

    @wraps(called)
    def named(*given: Any, **words: Any) -> Any:
        try:
            signature.bind(*given, **words)
        except TypeError as error:
            raise _misnamed(label, signature, given, words, error) from None
        return called(*given, **words)

    return named  # type: ignore[return-value]


def _misnamed(label: str, signature: inspect.Signature, given: Sequence[Any], words: Mapping[str, Any], error: TypeError) -> UsageError:
    """Return the error of a call whose arguments do not fit a signature."""
    parameters = [of for of in signature.parameters.values() if of.name != "self"]
    given = given[1:] if "self" in signature.parameters else given
    known = [of.name for of in parameters if of.kind in (of.POSITIONAL_OR_KEYWORD, of.KEYWORD_ONLY)]
    first = [of.name for of in parameters if of.kind is of.POSITIONAL_OR_KEYWORD]
    if not known:
        return UsageError(f"{label} takes no arguments; leave them away")
    for word in words:
        if word not in known and not any(of.kind is of.VAR_KEYWORD for of in parameters):
            return UsageError(f"{label} takes no {word!r}; {near(word, known)}")
    if len(given) > len(first):
        return UsageError(f"{label} takes {len(first) or 'none'} of its arguments without a name, and has {len(given)}; "
                          f"give the others by name: {', '.join(known[len(first):])}")
    missing = [of.name for of in parameters if of.default is of.empty and of.name in known and of.name not in (*first[:len(given)], *words)]
    if missing:
        return UsageError(f"{label} lacks {', '.join(map(repr, missing))}; give it, as in {label}({missing[0]}=...)")
    return UsageError(f"{label}: {error}; give each argument once")
