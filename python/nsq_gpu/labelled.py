"""Results as datasets of xarray and tables of pandas: with units, and names without spaces."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nsq_gpu import color, photometry
from nsq_gpu.arguments import missing
from nsq_gpu.units import identifiers

if TYPE_CHECKING:
    from nsq_gpu.results import Result


class MapOf(NamedTuple):
    """The map of a kind of detectors."""

    #: The array that holds it.
    array: str
    unit: str
    #: Its axes, with the array of their coordinates and its unit.
    axes: dict[str, tuple[str, str]]


_PIXELS = {"y": ("y_coords", "mm"), "x": ("x_coords", "mm")}
MAPS = {
    "irradiance": MapOf("irradiance", "W/mm^2", _PIXELS),
    "spectral": MapOf("irradiance", "W/mm^2 per bin", _PIXELS | {"wavelength": ("wavelengths", "um")}),
    "far_field": MapOf("intensity", "W/sr", {"theta": ("theta", "deg"), "phi": ("phi", "deg")}),
}
_ROW_UNITS = {"x": "mm", "y": "mm", "z": "mm", "L": "1", "M": "1", "N": "1", "flux": "W", "wavelength": "um"}


def xarray(what: str) -> Any:
    """Return xarray.

    Raises:
        MissingLibraryError: It is not installed.
    """
    return _library("xarray", what)


def pandas(what: str) -> Any:
    """Return pandas.

    Raises:
        MissingLibraryError: It is not installed.
    """
    return _library("pandas", what)


def _library(name: str, what: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise missing(name, name, f"{what} needs") from None


def table(columns: Mapping[str, Any], units: Mapping[str, str]) -> Any:
    """Return a ``pandas.DataFrame`` that knows its units: ``frame.attrs["units"]["flux"]``."""
    frame = pandas("to_pandas").DataFrame(dict(columns))
    frame.attrs["units"] = {name: unit for name, unit in units.items() if name in columns}
    return frame


def labels(kind: str, coordinates: Mapping[str, np.ndarray], plain: str) -> dict[str, Any]:
    """Return coordinates of a detector's axes as xarray takes them; its plain name is a part of theirs."""
    return {f"{plain}_{axis}": (f"{plain}_{axis}", values, {"units": MAPS[kind].axes[axis][1]})
            for axis, values in coordinates.items()}


def of_result(result: Result) -> Any:
    """Return all that detectors recorded; :meth:`nsq_gpu.results.Result.to_xarray` says how."""
    library = xarray("to_xarray")
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    entries = result.report_json["detectors"]
    for name, plain in identifiers(entries).items():
        kind, arrays = entries[name]["kind"], result.arrays[name]
        if kind not in MAPS:
            for key, unit in _ROW_UNITS.items():
                variables[f"{plain}_{key}"] = (f"{plain}_ray", arrays[key], {"units": unit})
            continue
        key, unit, axes = MAPS[kind]
        found = labels(kind, {axis: arrays[of_axis] for axis, (of_axis, _) in axes.items()}, plain)
        coordinates |= found
        variables[plain] = (list(found), arrays[key], {"units": unit, "total_flux_W": entries[name]["total_flux"]})
        if "standard_error" in arrays:
            variables[f"{plain}_standard_error"] = (list(found), arrays["standard_error"], {"units": unit})
        seen, unit = photometry.MAPS.get(kind, ("", ""))
        for key in (seen, f"{seen}_standard_error"):
            if key in arrays:
                variables[f"{plain}_{key}"] = (list(found), arrays[key], {"units": unit})
        _add_colors(variables, coordinates, plain, list(found), result.detectors[name], unit)
    about = {key: result.report_json[key] for key in ("version", "seed", "precision", "sampler", "max_depth", "adapter")}
    return library.Dataset(variables, coordinates, about | {"num_rays": result.num_rays_total, "partial": int(result.partial)})


def _add_colors(variables: dict[str, Any], coordinates: dict[str, Any], plain: str, axes: list[str], detector: Any,
                unit: str) -> None:
    """Add X, Y and Z of a detector, their errors and covariances, where they are known."""
    for key, axis, of in (("xyz", "tristimulus", unit), ("xyz_standard_error", "tristimulus", unit),
                          ("xyz_covariance", "pair", f"{unit}^2")):
        if (values := getattr(detector, key)) is not None:
            coordinates[f"{plain}_{axis}"] = list(color.PAIRS if axis == "pair" else color.PARTS)
            variables[f"{plain}_{key}"] = ([f"{plain}_{axis}", *axes], values, {"units": of})


def detector_table(result: Result) -> Any:
    """Return a row a detector; :meth:`nsq_gpu.results.Result.to_pandas` says how."""
    entries = result.report_json["detectors"]

    def column(key: str) -> list[Any]:
        return [np.nan if entry.get(key) is None else entry[key] for entry in entries.values()]

    columns = {"detector": list(entries), "kind": column("kind"), "flux": column("total_flux"),
               "standard_error": column("total_flux_standard_error"), "num_rays_hit": column("num_rays_hit"),
               "rests_on": column("rests_on"), "upper_bound_95": column("upper_bound_95")}
    if result.report_json.get("photometry"):
        for key in ("luminous_flux", "luminous_flux_standard_error"):
            found = [getattr(result.detectors[name], key) for name in entries]
            columns[key] = [np.nan if value is None else value for value in found]
    return table(columns, {"flux": "W", "standard_error": "W", "upper_bound_95": "W", "luminous_flux": "lm",
                           "luminous_flux_standard_error": "lm"})
