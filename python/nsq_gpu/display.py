"""What a shell and a notebook show of a result: a short table, as a text and as HTML.

>>> result
Result: 10,000 rays in 0.86 s, f64, llvmpipe (LLVM 15.0.6)
           flux [W]  error [W]  rays
image      0.679102     0.0029  8498  irradiance
...
"""

from __future__ import annotations

import html
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import optiland.backend as be
from optiland.nonsequential import NSQScene

from nsq_gpu.few_rays import rests_on
from nsq_gpu.frames import number_of

#: Most rows of a table that is shown.
MOST_ROWS = 12


@dataclass(frozen=True)
class Summary:
    """A title, a table and remarks."""

    title: str
    headings: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    #: Rows that there are, where these are the first ones.
    num_rows: int | None = None
    notes: Sequence[str] = field(default_factory=tuple)

    def text(self) -> str:
        """Return it as lines, with numbers in columns."""
        table = [self.headings, *self.rows] if self.rows else []
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        is_number = [_is_number(column) for column in zip(*self.rows, strict=True)]
        lines = ["  ".join(cell.rjust(width) if right else cell.ljust(width)
                           for cell, width, right in zip(row, widths, is_number, strict=True)).rstrip() for row in table]
        return "\n".join([self.title, *lines, *self._remarks()])

    def html(self) -> str:
        """Return it as a table of HTML; names from files of others are texts there, and no markup."""
        is_number = [_is_number(column) for column in zip(*self.rows, strict=True)]

        def row(cells: Sequence[str], tag: str) -> str:
            styled = ((cell, "right" if right else "left") for cell, right in zip(cells, is_number, strict=True))
            return "<tr>" + "".join(f'<{tag} style="text-align: {side}">{html.escape(cell)}</{tag}>'
                                    for cell, side in styled) + "</tr>"

        table = "" if not self.rows else (f"<table><thead>{row(self.headings, 'th')}</thead><tbody>"
                                          + "".join(row(cells, "td") for cells in self.rows) + "</tbody></table>")
        notes = "".join(f"<p>{html.escape(note)}</p>" for note in self._remarks())
        return f"<div><p><strong>{html.escape(self.title)}</strong></p>{table}{notes}</div>"

    def _remarks(self) -> list[str]:
        more = (self.num_rows or 0) - len(self.rows)
        return [f"... and {more:,} more rows"] * (more > 0) + list(self.notes)


class Displayed:
    """Shows a summary in the place of all arrays."""

    def _summary(self) -> Summary:
        raise NotImplementedError

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()


def number(value: float | None, digits: int = 6) -> str:
    """Return a number as a table has it; an empty text where it is not known."""
    return "" if value is None or value != value else f"{value:.{digits}g}"


def error_of(error: float | None, rests: int | None, bound: float | None = None) -> str:
    """Return a standard error, or what stands in its place where a flux rests on few rays."""
    if rests is None or rests != rests:
        return number(error, 2)
    return rests_on(int(rests)) + ("" if bound is None else f", at most {bound:.2g}")


def _is_number(cells: Sequence[str]) -> bool:
    def is_float(cell: str) -> bool:
        try:
            float(cell.replace(",", "") or 0)
        except ValueError:
            return False
        return True

    return any(cells) and all(map(is_float, cells))


# Optiland's scenes


def of_scene(scene: NSQScene) -> Summary:
    """Return what is in a scene: an entry a row, with its kind and its place."""
    def row(what: str, name: str, entry: Any, said: str = "") -> list[str]:
        place = _place(entry)
        return [what, name, type(entry).__name__, *(number(part) for part in place), said]

    elements = [(name, _shown_as(scene.component_registry.get(name))) for name in scene.component_names]
    rows = [row("component", name, entry) for name, entry in elements]
    rows += [row("source", name, live, f"{number_of(live.total_flux):.6g} W" if hasattr(live, "total_flux") else "")
             for name, live in zip(scene.source_names, scene.sources, strict=True)]
    rows += [row("detector", name, live, _pixels(live)) for name, live in zip(scene.detector_names, scene.detectors, strict=True)]
    title = f"NSQScene: {len(elements)} components with {len(scene.surfaces)} surfaces, {len(scene.sources)} sources, " \
            f"{len(scene.detectors)} detectors"
    return Summary(title, ["", "name", "kind", "x [mm]", "y [mm]", "z [mm]", ""], rows)


def _shown_as(component: Any) -> Any:
    """Return the surface in the place of the wrapper that Optiland gives a single one."""
    surfaces = component.surfaces
    return surfaces[0] if type(component).__name__.startswith("_") and len(surfaces) == 1 else component


def _place(entry: Any) -> list[float | None]:
    cs = getattr(entry, "coordinate_system", getattr(entry, "cs", None))
    if cs is None:
        return [None] * 3
    return [float(part) for part in be.to_numpy(cs.get_effective_transform()[0]).ravel()]


def _pixels(live: Any) -> str:
    nx, ny = getattr(live, "num_pixels_x", None), getattr(live, "num_pixels_y", None)
    return "" if nx is None else f"{number_of(live.width):.6g} x {number_of(live.height):.6g} mm, {nx} x {ny} pixels"


def register() -> None:
    """Have IPython show scenes, whose class is Optiland's; nothing of the class is changed."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is not None:
        formatters = shell.display_formatter.formatters
        formatters["text/plain"].for_type(NSQScene, lambda scene, printer, cycle: printer.text(of_scene(scene).text()))
        formatters["text/html"].for_type(NSQScene, lambda scene: of_scene(scene).html())
