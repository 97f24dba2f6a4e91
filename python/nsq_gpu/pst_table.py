"""Point source transmittance by direction: tables, datasets, pictures and files."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nsq_gpu import placing
from nsq_gpu.display import MOST_ROWS, Displayed, Summary, number
from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.labelled import table, xarray
from nsq_gpu.units import identifiers

Json = dict[str, Any]
#: A direction's place in the arrays: the places of its angle and of its azimuth.
Place = tuple[int, int]

#: Files in a folder, as ``nsq-gpu pst -o`` writes them.
JSON, CSV = "pst.json", "pst.csv"
#: How light is parted in a picture, and how many lines it then has at most.
_BY = ("first_scatterer", "order")
_MOST_LINES = 8


@dataclass(frozen=True, repr=False)
class PstResult(Displayed):
    """Point source transmittance of a scene: the mean irradiance on a detector over the beam's, on a plane across it.

    Arrays have the axes (angle, azimuth). Of directions that were not traced, numbers are NaN and counts 0.

    >>> found.pst[:, 0], found.standard_error[:, 0]
    >>> found.plot(by="first_scatterer")
    """

    #: The detector's name; empty where a file does not say it.
    detector: str
    #: Angles of the source off its axis [deg], shape (A,).
    angles_deg: np.ndarray
    #: Azimuths of the source, from the x of its frame towards its y [deg], shape (Z,).
    azimuths_deg: np.ndarray
    #: Transmittance of all light [1], shape (A, Z).
    pst: np.ndarray
    #: Its standard error [1], shape (A, Z).
    standard_error: np.ndarray
    #: Rays that were traced, shape (A, Z).
    num_rays: np.ndarray
    #: Deposits on the detector, shape (A, Z).
    num_hits: np.ndarray
    #: True where the error that was asked for was reached, and where none was asked for; shape (A, Z).
    reached: np.ndarray
    #: Transmittance of light by the number of its scatterings [1], shape (4, A, Z): none, one, two, and three or more.
    by_order: np.ndarray
    by_order_standard_error: np.ndarray
    #: Transmittance by the surface that scattered first [1], each of shape (A, Z), the surface that does most first.
    by_first_scatterer: dict[str, np.ndarray]
    by_first_scatterer_standard_error: dict[str, np.ndarray]
    #: Transmittance of light whose path had no row in the table [1], shape (A, Z). It is in ``pst`` alone.
    unknown_path: np.ndarray
    unknown_path_standard_error: np.ndarray
    #: True if the call was stopped.
    partial: bool = False

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with a row a direction, azimuth by azimuth; ``attrs["units"]`` has the columns' units.

        Columns are ``angle_deg``, ``azimuth_deg``, ``pst``, ``standard_error``, ``num_rays``, ``num_hits``, ``reached``,
        ``order_0`` to ``order_3``, and ``first_NAME`` for each surface; the latter two have ``..._standard_error`` as well.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        azimuths, angles = np.meshgrid(self.azimuths_deg, self.angles_deg)
        columns = {"angle_deg": angles, "azimuth_deg": azimuths, "pst": self.pst, "standard_error": self.standard_error,
                   "num_rays": self.num_rays, "num_hits": self.num_hits, "reached": self.reached}
        for order, (values, errors) in enumerate(zip(self.by_order, self.by_order_standard_error, strict=True)):
            columns |= {f"order_{order}": values, f"order_{order}_standard_error": errors}
        for name, plain in identifiers(self.by_first_scatterer).items():
            columns |= {f"first_{plain}": self.by_first_scatterer[name],
                        f"first_{plain}_standard_error": self.by_first_scatterer_standard_error[name]}
        units = {name: "deg" if name.endswith("_deg") else "1" for name in columns}
        return table({name: values.T.ravel() for name, values in columns.items()}, units)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` over ``angle`` and ``azimuth`` [deg], and ``order`` and ``surface`` of the parts of the light.

        Raises:
            MissingLibraryError: xarray is not installed (``pip install 'nsq-gpu[xarray]'``).
        """
        library = xarray("to_xarray")
        dims, names = ("angle", "azimuth"), list(self.by_first_scatterer)
        variables: dict[str, Any] = {name: (dims, getattr(self, name), {"units": "1"}) for name in
                                     ("pst", "standard_error", "num_rays", "num_hits", "reached", "unknown_path",
                                      "unknown_path_standard_error")}
        shape = (len(names), *self.pst.shape)
        for suffix in ("", "_standard_error"):
            variables[f"by_order{suffix}"] = (("order", *dims), getattr(self, f"by_order{suffix}"), {"units": "1"})
            of_surfaces = getattr(self, f"by_first_scatterer{suffix}")
            stacked = np.stack([of_surfaces[name] for name in names]) if names else np.zeros(shape)
            variables[f"by_first_scatterer{suffix}"] = (("surface", *dims), stacked, {"units": "1"})
        coordinates = {"angle": ("angle", self.angles_deg, {"units": "deg"}), "order": np.arange(len(self.by_order)),
                       "azimuth": ("azimuth", self.azimuths_deg, {"units": "deg"}), "surface": np.array(names, dtype=object)}
        return library.Dataset(variables, coordinates, {"detector": self.detector, "partial": int(self.partial)})

    def plot(self, *, by: str | None = None, azimuth_deg: float | None = None, ax: Any = None, **options: Any) -> Any:
        """Draw the transmittance over the angle, on a logarithmic scale, with standard errors.

        Args:
            by: ``"first_scatterer"`` draws a line for each of the eight surfaces that do most, ``"order"`` one for each number of
                scatterings. None draws all light, a line an azimuth.
            azimuth_deg: The azimuth that is drawn [deg]. None draws all azimuths, and with ``by`` the first one.
            ax: Matplotlib's axes. None makes a figure.
            options: Further options of Matplotlib's ``errorbar``, such as ``linewidth=2``.

        Returns:
            The axes.

        Raises:
            UsageError: An argument makes no sense.
        """
        if by not in (None, *_BY):
            raise UsageError(f"by is {by!r}; give 'first_scatterer', 'order', or None")
        lines = self._lines(by, self._azimuths(by, azimuth_deg))
        from nsq_gpu.plotting import _axes

        ax = _axes(ax)
        for label, (values, errors) in lines.items():
            seen = values > 0.0
            if not seen.any():
                continue
            # A logarithmic scale has no place for what is not above 0: the lower ends of bars are cut off there.
            low = np.minimum(errors[seen], 0.999 * values[seen])
            ax.errorbar(self.angles_deg[seen], values[seen], np.stack([low, errors[seen]]),
                        **{"label": label, "marker": ".", "capsize": 2, **options})
        ax.set_yscale("log")
        ax.set_xlabel("angle off the axis [deg]")
        ax.set_ylabel("point source transmittance")
        ax.set_title((self.detector or "PST") + (", stopped before its end" if self.partial else ""))
        if len(lines) > 1 and ax.get_legend_handles_labels()[0]:
            ax.legend(fontsize="small")
        return ax

    def _azimuths(self, by: str | None, azimuth_deg: float | None) -> list[int]:
        """Return the places of the azimuths that are drawn."""
        if azimuth_deg is None:
            return [0] if by else list(range(len(self.azimuths_deg)))
        found = np.flatnonzero(self.azimuths_deg == azimuth_deg)
        if not found.size:
            raise UsageError(f"azimuth_deg is {azimuth_deg!r}; the azimuths are {', '.join(f'{value:g}' for value in self.azimuths_deg)}")
        return [int(found[0])]

    def _lines(self, by: str | None, azimuths: list[int]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return values and errors of the lines by their labels."""
        if by is None:
            return {f"azimuth {self.azimuths_deg[z]:g}°": (self.pst[:, z], self.standard_error[:, z]) for z in azimuths}
        (z,) = azimuths
        lines = {"all": (self.pst[:, z], self.standard_error[:, z])}
        if by == "order":
            labels = [f"{order} scatterings" for order in range(len(self.by_order))]
            labels[1:2], labels[-1] = ["1 scattering"], f"{labels[-1]} and more"
            return lines | {label: (self.by_order[order, :, z], self.by_order_standard_error[order, :, z])
                            for order, label in enumerate(labels)}
        lines["unscattered"] = self.by_order[0, :, z], self.by_order_standard_error[0, :, z]
        return lines | {name: (self.by_first_scatterer[name][:, z], self.by_first_scatterer_standard_error[name][:, z])
                        for name in list(self.by_first_scatterer)[:_MOST_LINES]}

    # Files

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write ``pst.json`` and ``pst.csv`` into a folder, as ``nsq-gpu pst -o`` does; :meth:`load` reads them back.

        Args:
            folder: The folder; it is made where it is not there.
            overwrite: True replaces files that are there.

        Raises:
            UsageError: A file is in the way.
        """
        folder = Path(folder)
        document = {"detector": self.detector, "angles_deg": self.angles_deg.tolist(), "azimuths_deg": self.azimuths_deg.tolist(),
                    "num_directions": self.pst.size, "partial": self.partial, "points": [self._point(place) for place in self._traced()]}
        for name in (CSV, JSON):
            placing.check(folder / name, overwrite)
        folder.mkdir(parents=True, exist_ok=True)
        placing.write(folder / CSV, self._csv(), overwrite)
        placing.write(folder / JSON, json.dumps(document, indent=2, allow_nan=False) + "\n", overwrite)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> PstResult:
        """Read a folder that :meth:`save` or ``nsq-gpu pst -o`` wrote, or its ``pst.json``.

        Raises:
            UsageError: There is no such file.
            NsqGpuError: It is damaged.
        """
        path = Path(folder) / JSON if Path(folder).is_dir() else Path(folder)
        if not path.is_file():
            raise UsageError(f"{folder}: has no {JSON}; give a folder that PstResult.save or `nsq-gpu pst -o` wrote")
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            points = document["points"]
            angles = document.get("angles_deg", list(dict.fromkeys(point["angle_deg"] for point in points)))
            azimuths = document.get("azimuths_deg", list(dict.fromkeys(point["azimuth_deg"] for point in points)))
            places = {(angles.index(point["angle_deg"]), azimuths.index(point["azimuth_deg"])): point for point in points}
            return of_points(document.get("detector", ""), angles, azimuths, places, bool(document["partial"]))
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise NsqGpuError(f"{path}: is no point source transmittance, or is damaged: {type(error).__name__}: {error}") from None

    def _traced(self) -> Iterable[Place]:
        """Yield the places of directions that were traced, azimuth by azimuth."""
        angles, azimuths = self.pst.shape
        return [(a, z) for z in range(azimuths) for a in range(angles) if self.num_rays[a, z]]

    def _point(self, place: Place) -> Json:
        """Return a direction as the command has it."""
        def part(values: np.ndarray, errors: np.ndarray) -> Json:
            return {"pst": float(values[place]), "standard_error": float(errors[place])}

        first = {name: part(values, self.by_first_scatterer_standard_error[name]) for name, values in self.by_first_scatterer.items()}
        return {"angle_deg": float(self.angles_deg[place[0]]), "azimuth_deg": float(self.azimuths_deg[place[1]]),
                **part(self.pst, self.standard_error), "num_rays": int(self.num_rays[place]), "num_hits": int(self.num_hits[place]),
                "reached": bool(self.reached[place]),
                "by_order": [part(*of_order) for of_order in zip(self.by_order, self.by_order_standard_error, strict=True)],
                "by_first_scatterer": {name: found for name, found in first.items() if found["pst"]},
                "unknown_path": part(self.unknown_path, self.unknown_path_standard_error)}

    def _csv(self) -> str:
        """Return a line a direction, as the command writes it."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        orders = [f"{order} scatterings" for order in range(len(self.by_order))]
        orders[-1] += " and more"
        writer.writerow(["angle [deg]", "azimuth [deg]", "pst", "standard error", "rays", "hits", *orders,
                         *(f"first scattered by {name}" for name in self.by_first_scatterer)])
        for a, z in self._traced():
            parts = [*self.by_order[:, a, z], *(values[a, z] for values in self.by_first_scatterer.values())]
            writer.writerow([float(cell) for cell in (self.angles_deg[a], self.azimuths_deg[z], self.pst[a, z], self.standard_error[a, z])]
                            + [int(self.num_rays[a, z]), int(self.num_hits[a, z]), *map(float, parts)])
        return text.getvalue()

    # Text

    def _summary(self) -> Summary:
        places = list(self._traced())
        rows = [[number(self.angles_deg[a]), number(self.azimuths_deg[z]), number(self.pst[a, z], 4), number(self.standard_error[a, z], 2),
                 f"{self.num_rays[a, z]:,}", self._most((a, z)), "" if self.reached[a, z] else "error not reached"]
                for a, z in places[:MOST_ROWS]]
        note = [f"partial: {len(places)} of {self.pst.size} directions"] if self.partial else []
        return Summary(f"Point source transmittance of {self.detector or 'a detector'}",
                       ["angle [deg]", "azimuth [deg]", "PST", "error", "rays", "most of it", ""], rows, len(places), note)

    def _most(self, place: Place) -> str:
        """Return what brings most of the light of a direction."""
        if not self.pst[place] > 0.0:
            return ""
        parts = {"unscattered": self.by_order[0][place], **{name: values[place] for name, values in self.by_first_scatterer.items()}}
        name = max(parts, key=lambda name: float(parts[name]))
        return f"{name} {100.0 * parts[name] / self.pst[place]:.0f} %"


def of_points(detector: str, angles_deg: Sequence[float] | np.ndarray, azimuths_deg: Sequence[float] | np.ndarray,
              points: Mapping[Place, Json], partial: bool) -> PstResult:
    """Return the result of points as the command's JSON has them, by their places in the arrays."""
    shape = (len(angles_deg), len(azimuths_deg))
    orders = max((len(point["by_order"]) for point in points.values()), default=4)

    def part(pick: Any, key: str) -> np.ndarray:
        values = np.full(shape, np.nan)
        for place, point in points.items():
            values[place] = pick(point)[key]
        return values

    def both(pick: Any) -> tuple[np.ndarray, np.ndarray]:
        return part(pick, "pst"), part(pick, "standard_error")

    def counted(key: str, kind: type) -> np.ndarray:
        values = np.zeros(shape, dtype=kind)
        for place, point in points.items():
            values[place] = point[key]
        return values

    none = {"pst": 0.0, "standard_error": 0.0}
    most: dict[str, float] = {}
    for point in points.values():
        for name, found in point["by_first_scatterer"].items():
            most[name] = max(most.get(name, 0.0), found["pst"])
    first = {name: both(lambda point, name=name: point["by_first_scatterer"].get(name, none))
             for name in sorted(most, key=lambda name: -most[name])}
    by_order = [both(lambda point, order=order: point["by_order"][order]) for order in range(orders)]
    return PstResult(
        detector, np.asarray(angles_deg, dtype=float), np.asarray(azimuths_deg, dtype=float), *both(lambda point: point),
        counted("num_rays", np.int64), counted("num_hits", np.int64), counted("reached", bool),
        np.stack([values for values, _ in by_order]), np.stack([errors for _, errors in by_order]),
        {name: values for name, (values, _) in first.items()}, {name: errors for name, (_, errors) in first.items()},
        *both(lambda point: point["unknown_path"]), partial)
