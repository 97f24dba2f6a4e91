"""Ghosts of a lens: which pairs of faces make them, how bright they are in each field, and what they look like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene

from nsq_gpu.display import MOST_ROWS, Displayed, Summary, error_of, number
from nsq_gpu.labelled import table, xarray

Json = dict[str, Any]

#: Units of a ghost's numbers, by their columns.
_UNITS = {"flux": "W", "standard_error": "W", "share": "1", "num_rays": "1", "reflections": "1", "centroid_x": "mm", "centroid_y": "mm",
          "rms_radius": "mm", "peak_irradiance": "W/mm^2", "rests_on": "1", "upper_bound_95": "W"}
_TEXTS = ("sequence", "where")


@dataclass(frozen=True)
class Field:
    """Light that is traced alone: a field of an Optic, a source of a scene, or all light of a scene."""

    #: What tables and pictures call it, such as ``14°``.
    label: str
    #: Its coordinates, in the unit of the Optic's fields; NaN where it is no field of an Optic.
    x: float = np.nan
    y: float = np.nan
    #: The source's name; None of all light.
    source: str | None = None


@dataclass(frozen=True)
class GhostsOfField:
    """What one field makes."""

    field: Field
    #: All ghosts, the worst first: the columns of :attr:`Ghosts.table` by their names.
    rows: list[Json]
    #: Maps of the first ones [W/mm^2]; None of a ghost without a map.
    maps: list[np.ndarray | None]
    #: All light of the field that came to the detector [W].
    flux: float
    #: Centres of the detector's pixels [mm].
    x: np.ndarray
    y: np.ndarray


@dataclass(frozen=True, repr=False)
class Ghosts(Displayed):
    """The ghosts of a lens over its fields: tables, and a montage of the worst ones' maps.

    >>> found = nsq_gpu.ghosts(CookeTriplet())
    >>> found.table.pivot_table(index="faces", columns="field_y", values="flux")
    >>> found.plot()
    """

    #: The scene, with the sources of all fields.
    scene: NSQScene
    #: The detector's name.
    detector: str
    #: Unit of the fields' coordinates: ``"deg"`` or ``"mm"``; None if they have none.
    unit: str | None
    #: How many ghosts of a field are its worst.
    top: int
    #: What each field makes, in the order of the fields. After a stop the last ones are missing.
    fields: list[GhostsOfField]
    #: Rays of each field.
    num_rays: int
    #: True if the call was stopped.
    partial: bool = False

    @property
    def table(self) -> Any:
        """All ghosts of all fields, a row each: a ``pandas.DataFrame``, or a list of dictionaries without pandas.

        ===================  =======================================================================================
        ``field``            the field's label; ``field_x`` and ``field_y`` are its coordinates
        ``rank``             the ghost's place in its field, from 1 on
        ``faces``            the faces that reflect, in the order of the light, such as ``L1.back > L1.front``
        ``flux``             [W], with its ``standard_error`` [W]
        ``share``            the fraction of all light of the field that came to the detector
        ``num_rays``         rays that brought the light
        ``reflections``      reflections along the path
        ``centroid_x``       where the middle of the light lies on the detector [mm]; so does ``centroid_y``
        ``rms_radius``       root of the mean square of the distance from there [mm]
        ``peak_irradiance``  the brightest pixel [W/mm^2]; too high where rays are few. NaN beyond the fifty brightest rows
        ``rests_on``         rays that the flux rests on, where they are fewer than ten; else NaN
        ``upper_bound_95``   the flux is then below this [W], with 95 % confidence; else NaN
        ``sequence``         the path as a text: see :class:`nsq_gpu.PathTable`
        ``where``            an expression that keeps this light alone: ``NsqGpuBackend(where=...)``; None if there is none
        ===================  =======================================================================================

        ``attrs["units"]`` of the frame has the columns' units.
        """
        return self._framed(None)

    @property
    def worst(self) -> Any:
        """The first ``top`` rows of each field, as :attr:`table` has them."""
        return self._framed(self.top)

    def plot(self, top: int | None = None, *, scale: str = "log", unit: str | None = None, **options: Any) -> Any:
        """Draw the maps of the worst ghosts: a row a field, a column a ghost, one scale of colours for all.

        Args:
            top: Columns; None draws all that have maps.
            scale: ``"log"``: over at most six decades below the largest value; or ``"linear"``.
            unit: Such as ``"mW/cm2"``; by default W/mm^2 with the prefix that fits.
            options: Further options of ``imshow``, such as ``cmap="magma"``.

        Returns:
            The axes, an array of the shape (fields, columns).

        Raises:
            UsageError: There is no ghost to draw, or an argument makes no sense.
        """
        from nsq_gpu.plotting import plot_ghosts

        return plot_ghosts(self, top, scale, unit, options)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` of the worst ghosts: each column of :attr:`worst`, and the maps, ``irradiance``.

        Dimensions are ``field`` and ``ghost``, the rank; maps also have ``y`` and ``x``. What a field lacks is NaN.

        Raises:
            MissingLibraryError: xarray is not installed (``pip install 'nsq-gpu[xarray]'``).
        """
        library = xarray("to_xarray")
        shape = (len(self.fields), self.top)
        dims = ("field", "ghost")
        texts = {name: np.full(shape, "", dtype=object) for name in ("faces", *_TEXTS)}
        columns: dict[str, np.ndarray] = {name: np.full(shape, np.nan) for name in _UNITS} | texts
        x, y = self.fields[0].x, self.fields[0].y
        maps = np.full((*shape, len(y), len(x)), np.nan)
        for i, of_field in enumerate(self.fields):
            for j, row in enumerate(of_field.rows[: self.top]):
                for name, column in columns.items():
                    column[i, j] = "" if row[name] is None else row[name]
                maps[i, j] = np.nan if of_field.maps[j] is None else of_field.maps[j]
        variables = {name: (dims, column, {"units": _UNITS[name]} if name in _UNITS else {}) for name, column in columns.items()}
        variables["irradiance"] = ((*dims, "y", "x"), maps, {"units": "W/mm^2"})
        variables["detected"] = ("field", [of_field.flux for of_field in self.fields], {"units": "W"})
        given = {} if self.unit is None else {"units": self.unit}
        coordinates: dict[str, Any] = {"field": [of_field.field.label for of_field in self.fields],
                                       "ghost": np.arange(1, self.top + 1),
                                       "y": ("y", y, {"units": "mm"}), "x": ("x", x, {"units": "mm"})}
        for axis in "xy":
            coordinates[f"field_{axis}"] = ("field", [getattr(of_field.field, axis) for of_field in self.fields], given)
        about = {"detector": self.detector, "num_rays": self.num_rays, "partial": int(self.partial)}
        return library.Dataset(variables, coordinates, about)

    def _framed(self, most: int | None) -> Any:
        rows = [row for of_field in self.fields for row in of_field.rows[:most]]
        try:
            import pandas  # noqa: F401
        except ImportError:
            return rows
        names = ["field", "field_x", "field_y", "rank", "faces", *_UNITS, *_TEXTS]
        given = {} if self.unit is None else dict.fromkeys(("field_x", "field_y"), self.unit)
        return table({name: [row[name] for row in rows] for name in names}, given | _UNITS)

    def _summary(self) -> Summary:
        """Return a row a pair of faces, the worst of all fields first, and a column a field."""
        of_fields = [{_without_source(row): row for row in of_field.rows} for of_field in self.fields]
        worst = [row for of_field in self.fields for row in of_field.rows[: self.top]]
        pairs = {_without_source(row): row["faces"] for row in sorted(worst, key=lambda row: -row["flux"])}
        rows = [[faces, *(_cell(found.get(key)) for found in of_fields)] for key, faces in pairs.items()][:MOST_ROWS]
        title = f"Ghosts: flux [W] on {self.detector}, {self.num_rays:,} rays a field"
        title += ", stopped before its end" if self.partial else ""
        return Summary(title, ["reflected by", *(of_field.field.label for of_field in self.fields)], rows, len(pairs))


def _without_source(row: Json) -> str:
    return str(row["sequence"].partition(" > ")[2])


def _cell(row: Json | None) -> str:
    if row is None:
        return ""
    is_few = not np.isnan(row["rests_on"])
    return f"{number(row['flux'], 3)}, {error_of(None, row['rests_on'])}" if is_few else \
        f"{number(row['flux'], 3)} ± {number(row['standard_error'], 1)}"
