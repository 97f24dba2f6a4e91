"""Units of a scene's numbers, and names that tables and datasets take.

The program's twin of the units is ``src/scene/units.rs``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

#: Keys of lengths, beside those that have ``radius`` in them.
_LENGTHS = {"x", "y", "z", "thickness", "thickness1", "thickness2", "width", "height", "z_front", "z_back", "z_offset", "r_front",
            "r_back", "gaussian_sigma", "r1", "r2", "r3"}
_OTHERS = {"rx": "rad", "ry": "rad", "rz": "rad", "wavelengths": "um", "wl_min": "um", "wl_max": "um", "total_flux": "W"}


def unit_of(name: str) -> str | None:
    """Return the unit of a number by its name, such as mm of ``L1.r1``; None if it has none that is known."""
    key = name.rpartition(".")[2]
    if key in _OTHERS:
        return _OTHERS[key]
    if key.endswith("_deg"):
        return "deg"
    return "mm" if key in _LENGTHS or "radius" in key or re.fullmatch(r"gap_\d+", name) else None


def attributes(name: str) -> dict[str, str]:
    """Return the attributes of a coordinate with that name."""
    unit = unit_of(name)
    return {} if unit is None else {"units": unit}


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return a name without spaces, and a different one, for each name: ``my wall`` becomes ``my_wall``."""
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        plain = free = re.sub(r"\s+", "_", name.strip())
        number = 2
        while free in taken:
            free, number = f"{plain}_{number}", number + 1
        taken.add(free)
        found[name] = free
    return found
