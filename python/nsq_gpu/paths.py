"""Tables of light by its path: which surfaces reflected it, let it pass or scattered it on its way to a detector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from nsq_gpu.display import MOST_ROWS, Displayed, Summary, error_of, number
from nsq_gpu.labelled import table as labelled_table

Json = dict[str, Any]

#: The fields of a row. Those of objects are texts, or None; ``steps`` is a tuple of pairs such as ``("R", "L1.back")``.
FIELDS = np.dtype([
    ("rank", np.int64),
    ("flux", np.float64),
    ("share", np.float64),
    ("standard_error", np.float64),
    ("num_rays", np.int64),
    ("reflections", np.int64),
    ("scatterings", np.int64),
    ("detector", object),
    ("sequence", object),
    ("steps", object),
    ("where", object),
    ("rests_on", np.int64),
    ("upper_bound_95", np.float64),
])


class PathTable(Displayed, np.ndarray):
    """The paths of a trace: a structured array with a row for each sequence of events, the most flux first.

    ``table["flux"]`` is a column and ``table[0]`` a row. ``table[table["reflections"] == 2]`` is a table of those rows.

    ==================  ============================================================================================
    ``rank``            the place in the table, from 1 on
    ``flux``            [W]
    ``share``           the fraction of all light that came to the row's detector
    ``standard_error``  standard error of the flux [W]; NaN where it is not known
    ``num_rays``        rays that brought the light
    ``reflections``     specular reflections along the path
    ``scatterings``     scatterings along the path
    ``detector``        the detector's name
    ``sequence``        the path as a text, from its source to its detector
    ``steps``           pairs of what happened and where: T transmitted, R reflected, ST and SR scattered through and back
    ``where``           an expression that keeps this row's light alone: ``NsqGpuBackend(where=...)``
    ``rests_on``        rays that the flux rests on, each counted by what it brought, where they are fewer than ten; else
                        ``num_rays``
    ``upper_bound_95``  the flux is below this [W], with 95 % confidence, where it rests on fewer than ten rays; else NaN
    ==================  ============================================================================================
    """

    def __getitem__(self, key: Any) -> Any:
        found = super().__getitem__(key)
        is_table = isinstance(found, PathTable) and found.dtype.names is not None
        return found if is_table or not isinstance(found, PathTable) else found.view(np.ndarray)

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with the same columns; ``attrs["units"]`` has the units of those in watts.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        return labelled_table({name: self[name] for name in self.dtype.names or ()},
                              {"flux": "W", "standard_error": "W", "upper_bound_95": "W"})

    def __repr__(self) -> str:
        return super().__repr__() if self._is_table() else np.ndarray.__repr__(self)

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str | None:
        return super()._repr_html_() if self._is_table() else None

    def _is_table(self) -> bool:
        """Tell whether it has all columns, and an axis of rows."""
        return self.dtype == FIELDS and self.ndim == 1

    def _summary(self) -> Summary:
        headings = ["rank", "flux [W]", "share", "error [W]", "detector", "sequence"]
        rows = [[str(row["rank"]), number(row["flux"], 4), f"{row['share']:.3%}",
                 error_of(row["standard_error"], row["rests_on"] if row["upper_bound_95"] == row["upper_bound_95"] else None),
                 row["detector"] or "", row["sequence"]] for row in self[:MOST_ROWS]]
        return Summary(f"PathTable: {len(self)} paths", headings, rows, len(self))


def path_table(rows: Sequence[Json]) -> PathTable:
    """Return the rows of a report as a table."""
    table = np.empty(len(rows), dtype=FIELDS)
    for index, row in enumerate(rows):
        # A number that is not known is null.
        error = np.nan if row["standard_error"] is None else row["standard_error"]
        steps = tuple((letters, name) for letters, name in row["steps"])
        few = {"rests_on": row["num_rays"], "upper_bound_95": np.nan}
        read = {**few, **row, "standard_error": error, "steps": steps}
        table[index] = tuple(read[name] for name in FIELDS.names or ())
    return table.view(PathTable)
