"""Tables of light by its path: which surfaces reflected it, let it pass or scattered it on its way to a detector."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nsq_gpu.display import MOST_ROWS, Displayed, Summary, error_of, number
from nsq_gpu.errors import ResultWarning, UsageError, warn
from nsq_gpu.labelled import table as labelled_table

if TYPE_CHECKING:
    from optiland.nonsequential import NSQScene

Json = dict[str, Any]

#: The fields of a row. Fields of objects are texts, or None; ``steps`` is a tuple of pairs such as ``("R", "L1.back")``.
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


#: The fields of a face in a rank of coatings. ``face`` and ``reason`` are texts.
RANK_FIELDS = np.dtype([
    ("face", object),
    ("reflectance", np.float64),
    ("derivative", np.float64),
    ("standard_error", np.float64),
    ("share", np.float64),
    ("reason", object),
])


class _Table(Displayed, np.ndarray):
    """A structured array that shows itself as a table while it has all columns, and an axis of rows."""

    _FIELDS: np.dtype

    def __getitem__(self, key: Any) -> Any:
        found = super().__getitem__(key)
        is_table = isinstance(found, _Table) and found.dtype.names is not None
        return found if is_table or not isinstance(found, _Table) else found.view(np.ndarray)

    def _labelled(self, *in_watts: str) -> Any:
        return labelled_table({name: self[name] for name in self.dtype.names or ()}, dict.fromkeys(in_watts, "W"))

    def __repr__(self) -> str:
        return super().__repr__() if self._is_table() else np.ndarray.__repr__(self)

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str | None:
        return super()._repr_html_() if self._is_table() else None

    def _is_table(self) -> bool:
        return self.dtype == self._FIELDS and self.ndim == 1


class PathTable(_Table):
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

    _FIELDS = FIELDS
    #: The text of the scene that was traced, as far as it is known.
    _scene: str | None = None
    #: The faces whose coatings are others than in the trace, with old and new R and T; empty where there are none.
    recoated: tuple[Json, ...] = ()
    #: How many rows the table of the trace has, of which these may be some.
    _num_rows: int = 0
    #: Rays were split at so many of their first events.
    _split_depth: int = 0

    def __array_finalize__(self, other: Any) -> None:
        for name in ("_scene", "_split_depth", "recoated", "_num_rows"):
            setattr(self, name, getattr(other, name, getattr(PathTable, name)))

    def recoat(self, coatings: Mapping[str, float | tuple[float, float]], *,
               scene: NSQScene | str | os.PathLike[str] | None = None, binary: str | None = None) -> PathTable:
        """Return the table that other coatings of faces would give, without another trace.

        >>> result.paths.recoat({"L3.back": 0.002})

        A coating is a reflectance, or a pair of reflectance and transmittance. Without a transmittance the face absorbs as
        before. Each row is multiplied by what its reflections and passages there gain: this is exact where R and T of the
        face are the same at every angle and wavelength. ``share`` is NaN where these are not all rows of the trace.

        Args:
            coatings: R, or R and T, by the names of the faces.
            scene: The scene that was traced, or its file; by default the one that the result knows.
            binary: Path of the program.

        Raises:
            UsageError: A face is unknown, bare, or coated by the angle or wavelength; it reflected nothing in the trace; R or T
                is no fraction; or a row stands for several paths.
        """
        from nsq_gpu.arguments import check_mapping

        check_mapping("coatings", coatings, '{"L3.back": 0.002}')
        answer = self._ask(scene, coatings, binary, rank=False)
        return self._with_factors(np.array(answer["factors"], dtype=np.float64), answer["recoated"])

    def rank_coatings(self, *, detector: str | None = None, scene: NSQScene | str | os.PathLike[str] | None = None,
                      binary: str | None = None) -> CoatingTable:
        """Return the faces whose coatings matter most to ghosts, which are rows of at least two reflections.

        Args:
            detector: The detector whose ghosts count; by default all detectors' ghosts.
            scene: The scene that was traced, or its file; by default the one that the result knows.
            binary: Path of the program.

        Raises:
            UsageError: There is no such detector, or a row stands for several paths.
        """
        known = sorted({name for name in self["detector"] if name is not None})
        if detector is not None and detector not in known:
            raise UsageError(f"detector is {detector!r}, and no row of the table ends there; rows end on: {', '.join(known)}")
        rows = self if detector is None else self[self["detector"] == detector]
        return coating_table(rows._ask(scene, {}, binary, rank=True)["coatings"])

    def _ask(self, scene: Any, coatings: Mapping[str, Any], binary: str | None, *, rank: bool) -> Json:
        """Ask the program what coatings do to the rows, and give its warnings."""
        from nsq_gpu.session import asked_of_paths

        if self.recoated:
            faces = ", ".join(str(face["face"]) for face in self.recoated)
            raise UsageError(f"the table has new coatings of {faces} already; start from the trace's table, and name all "
                             "coatings at once")
        text = self._scene if scene is None else scene
        if text is None:
            raise UsageError("the table does not know the scene that was traced; name it: scene=\"lens.json\"")
        answer = asked_of_paths(text, binary, is_text=scene is None, rows=[_as_asked(row) for row in self],
                                coatings=[_new_coating(face, wanted) for face, wanted in coatings.items()], rank=rank,
                                split_depth=self._split_depth)
        for warning in answer["warnings"]:
            warn(warning, ResultWarning)
        return answer

    def _with_factors(self, factors: np.ndarray, recoated: list[Json]) -> PathTable:
        table = self.copy()
        for name in ("flux", "standard_error", "upper_bound_95"):
            table[name] *= factors
        # Light that a coating takes to the last bit is known to be none.
        is_dark = factors == 0.0
        table["upper_bound_95"][is_dark] = np.nan
        table["rests_on"][is_dark] = table["num_rays"][is_dark]
        for detector in set(self["detector"]):
            own = self["detector"] == detector
            lit = own & (self["flux"] > 0.0)
            # Light without a row keeps its coatings.
            total = np.median(self["flux"][lit] / self["share"][lit]) if lit.any() else np.nan
            total += table["flux"][own].sum() - self["flux"][own].sum()
            table["share"][own] = table["flux"][own] / total if len(self) == self._num_rows else np.nan
        table = table[np.argsort(-table["flux"], kind="stable")]
        table["rank"] = np.arange(1, len(table) + 1)
        table.recoated = tuple(recoated)
        return table

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with the same columns; ``attrs["units"]`` has the units of those in watts.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        return self._labelled("flux", "standard_error", "upper_bound_95")

    def _summary(self) -> Summary:
        headings = ["rank", "flux [W]", "share", "error [W]", "detector", "sequence"]
        rows = [[str(row["rank"]), number(row["flux"], 4), f"{row['share']:.3%}",
                 error_of(row["standard_error"], row["rests_on"] if row["upper_bound_95"] == row["upper_bound_95"] else None),
                 row["detector"] or "", row["sequence"]] for row in self[:MOST_ROWS]]
        return Summary(f"PathTable: {len(self)} paths", headings, rows, len(self))


class CoatingTable(_Table):
    """Faces by how much their coatings matter: a structured array, the face first whose removal takes most flux.

    ==================  ============================================================================================
    ``face``            its name
    ``reflectance``     R; NaN where that is no constant
    ``derivative``      dF/dR [W]: how the flux F of all ghosts changes with R, where T = 1 - R - A; NaN where ``reason``
                        says why
    ``standard_error``  its standard error [W]; NaN where it is not known
    ``share``           the share of the ghosts' flux that the face reflects at least once
    ``reason``          why there is no derivative; None if there is one
    ==================  ============================================================================================
    """

    _FIELDS = RANK_FIELDS

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with the same columns; ``attrs["units"]`` has the units of those in watts.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        return self._labelled("derivative", "standard_error")

    def _summary(self) -> Summary:
        headings = ["face", "R", "dF/dR [W]", "error [W]", "of ghosts", ""]
        rows = [[row["face"], number(row["reflectance"], 4), number(row["derivative"], 4), number(row["standard_error"], 2),
                 f"{row['share']:.2%}", row["reason"] or ""] for row in self[:MOST_ROWS]]
        return Summary(f"CoatingTable: {len(self)} faces", headings, rows, len(self))


def coating_table(ranks: Sequence[Json]) -> CoatingTable:
    """Return ranks of coatings as a table."""
    table = np.empty(len(ranks), dtype=RANK_FIELDS)
    for index, rank in enumerate(ranks):
        values = [rank.get(name) for name in RANK_FIELDS.names or ()]
        table[index] = tuple(np.nan if value is None and RANK_FIELDS[place] != object else value
                             for place, value in enumerate(values))
    return table.view(CoatingTable)


def _as_asked(row: Any) -> Json:
    """Return a row as the program takes it."""
    error = float(row["standard_error"])
    return {"sequence": row["sequence"], "steps": [list(step) for step in row["steps"]], "detector": row["detector"],
            "flux": float(row["flux"]), "standard_error": error if error == error else None}


def _new_coating(face: str, wanted: Any) -> Json:
    """Return a coating as the program takes it."""
    try:
        values = [float(value) for value in np.atleast_1d(wanted)]
    except (TypeError, ValueError):
        values = []
    if len(values) not in (1, 2) or not np.isfinite(values).all():
        raise UsageError(f"the coating of {face!r} is {wanted!r}; give a reflectance, or a pair of reflectance and "
                         "transmittance")
    return {"face": str(face), "reflectance": values[0], "transmittance": values[1] if len(values) == 2 else None}


def path_table(rows: Sequence[Json], scene: str | None = None, recoated: Sequence[Json] = (), split_depth: int = 0) -> PathTable:
    """Return the rows of a report as a table; ``scene`` is the text that was traced, split at so many of the rays' first events."""
    table = np.empty(len(rows), dtype=FIELDS)
    for index, row in enumerate(rows):
        # A number that is not known is null.
        error = np.nan if row["standard_error"] is None else row["standard_error"]
        steps = tuple((letters, name) for letters, name in row["steps"])
        few = {"rests_on": row["num_rays"], "upper_bound_95": np.nan}
        read = {**few, **row, "standard_error": error, "steps": steps}
        table[index] = tuple(read[name] for name in FIELDS.names or ())
    found = table.view(PathTable)
    found._scene, found.recoated, found._num_rows, found._split_depth = scene, tuple(recoated), len(rows), split_depth
    return found
