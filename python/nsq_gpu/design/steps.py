"""Tiny steps of a scene, made long enough for a difference of two traces.

Optimisers without gradients of their own move a variable by 1e-8 of it. So short a step moves no ray to another branch, and none
across a rim: what such light adds would be missing. So an operand goes on in the direction of the step, by half a percent, on both
sides, with common draws.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from nsq_gpu.edges import without_numbers

Json = dict[str, Any]

#: Steps below this count as tiny. They are steps of differences: line searches take longer ones.
TINY = 1e-5
#: Length of the step that takes their place: the largest change of a number, over the number's scale.
LONG = 5e-3
#: A number's scale: lengths and angles that are 0 may move by so many mm or rad, and by half a percent of it at a time.
_LEAST = 1.0
#: The same of a place along an axis, whose origin says nothing [mm].
_PLACE = 10.0
#: A length at which a coefficient of a shape counts [mm].
_REACH = 10.0


def numbers_of(document: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], float]]:
    """Yield the numbers of a scene file with the way to each."""
    items = document.items() if isinstance(document, dict) else enumerate(document) if isinstance(document, list) else ()
    for key, value in items:
        yield from numbers_of(value, (*way, key))
    if isinstance(document, int | float) and not isinstance(document, bool):
        yield way, float(document)


def scale_of(way: tuple[Any, ...], value: float) -> float:
    """Return by how much a number changes when it changes by all that it is."""
    if any(isinstance(key, str) and re.match(r"coeff|zernike|chebyshev", key) for key in way):
        power = sum(key for key in way[3:] if isinstance(key, int))
        return max(abs(value), float(_REACH**-(2.0 * (power + 1))))
    return _PLACE if way[-1:] in (("x",), ("y",), ("z",)) else max(abs(value), _LEAST)


def step_between(base: Any, other: Any) -> float | None:
    """Return the largest change from one scene to the other, over scales; None if they differ in more than numbers."""
    if without_numbers(base) != without_numbers(other):
        return None
    return max((abs(there - here) / scale_of(way, here) for (way, here), (_, there) in zip(numbers_of(base), numbers_of(other), strict=True)),
               default=0.0)


def along(base: Any, other: Any, share: float) -> Any:
    """Return the scene at ``share`` of the way from one scene to the other."""
    if isinstance(base, dict):
        return {key: along(value, other[key], share) for key, value in base.items()}
    if isinstance(base, list):
        return [along(value, there, share) for value, there in zip(base, other, strict=True)]
    is_number = isinstance(base, int | float) and not isinstance(base, bool)
    return base + share * (other - base) if is_number and other != base else base
