"""Fluxes that rest on few rays: on how many, and an upper bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class FewRays:
    """What is known of a flux that rests on fewer than ten rays.

    So few rays give no standard error: the next one may bring a hundred times as much. Of a difference or a derivative,
    the rays are those that make it.
    """

    #: Rays that the flux rests on, each counted by what it brought.
    rests_on: int
    #: The flux is below this, with 95 % confidence [W].
    upper_bound_95: float

    def __str__(self) -> str:
        return f"{rests_on(self.rests_on)}, at most {self.upper_bound_95:.2g} W"


def rests_on(rays: int) -> str:
    """Return ``rests on 3 rays``."""
    return "rests on " + {0: "no ray", 1: "1 ray"}.get(rays, f"{rays} rays")


def few_rays(entry: Mapping[str, Any]) -> FewRays | None:
    """Return what an entry of a report says; None if its flux rests on ten rays or more."""
    return FewRays(entry["rests_on"], entry["upper_bound_95"]) if "rests_on" in entry else None


def in_table(entry: FewRays | None) -> str:
    """Return the end of a row of a table."""
    return "" if entry is None else f"  {entry}"
