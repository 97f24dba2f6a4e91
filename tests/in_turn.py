"""What is tested in turns, where there is not the time for all of it."""

import time
from collections.abc import Iterator, Sequence
from typing import TypeVar

T = TypeVar("T")


def in_turn(items: Sequence[T], first: int, until: float) -> Iterator[T]:
    """Yield items from the one of this number on, and round, until this time of `time.time`."""
    first %= len(items)
    for item in [*items[first:], *items[:first]]:
        if time.time() > until:
            return
        yield item
