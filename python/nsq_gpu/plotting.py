"""Pictures drawn by Matplotlib, with their units: maps, far fields and spectra of a result, and polar diagrams of lamps."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from nsq_gpu import photometry
from nsq_gpu.errors import UsageError

if TYPE_CHECKING:
    from nsq_gpu.ghost_table import Ghosts
    from nsq_gpu.intensity import IntensityTable
    from nsq_gpu.results import Result

#: Most decades of a logarithmic scale.
_DECADES = 6
_PREFIXES = {"p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}
#: How much of a result's unit a unit is, and that unit. A foot-candle is a lumen per square foot.
_OF = {"W/mm2": (1.0, "W/mm2"), "W/cm2": (1e-2, "W/mm2"), "W/m2": (1e-6, "W/mm2"), "W/sr": (1.0, "W/sr"), "lx": (1.0, "lx"),
       "fc": (0.3048**-2, "lx"), "cd": (1.0, "cd")}
#: Sides that a circle is drawn with, at least.
_PARTS = 180
#: Kinds of detectors that have a picture, and the unit of their maps.
_UNITS = {"irradiance": "W/mm2", "spectral": "W/mm2", "far_field": "W/sr"}


def plot(result: Result, detector: str | None, *, kind: str | None, scale: str, unit: str | None, wavelength: float | str | None,
         smooth: bool, ax: Any, **options: Any) -> Any:
    """Draw what a detector saw; :meth:`nsq_gpu.results.Result.plot` says how."""
    name = _chosen(result, detector)
    entry, found = result.report_json["detectors"][name], result.detectors[name]
    of_kind = entry["kind"]
    _check_scale(scale)
    _check_kind(kind, name, of_kind, scale)
    if wavelength is not None and of_kind != "spectral":
        raise UsageError(f"wavelength is {wavelength!r}, and {name!r} has no wavelengths: it is of the kind {of_kind}")
    if of_kind == "spectral" and wavelength is None:
        if unit is not None:
            raise UsageError(f"unit is {unit!r}, and a spectrum is in W per bin; wavelength='all' draws the map of all light")
        ax = _axes(ax)
        _draw_spectrum(ax, found, entry, scale, options)
        title = f"{name}: {found.total_flux:.4g} W"
    elif of_kind == "far_field":
        values, base, flux = _seen(found, name, of_kind, unit, found.intensity)
        values = in_equal_solid_angles(values, found.theta) if smooth else values
        scaled = _scaled(values, unit, base, scale)
        ax = _axes(ax, projection="polar")
        if kind == "polar":
            _draw_planes_of(ax, found, *scaled[:2], options)
        else:
            _draw_far_field(ax, found, *scaled, options)
        title = f"{name}: {flux or f'{found.total_flux:.4g} W'}"
    else:
        values, at = _slice(found, wavelength)
        values, base, flux = _seen(found, name, of_kind, unit, values)
        scaled = _scaled(values, unit, base, scale)
        ax = _axes(ax)
        _draw_map(ax, found, *scaled, "Illuminance" if base == "lx" else "Irradiance", options)
        title = f"{name}{at}: {flux or f'{_flux(found, values):.4g} W'}"
    ax.set_title(title + (", stopped before the end" if result.partial else ""))
    return ax


def _check_kind(kind: str | None, name: str, of_kind: str, scale: str) -> None:
    if kind not in (None, "polar"):
        raise UsageError(f"kind is {kind!r}; give 'polar', or None for the map")
    if kind == "polar" and of_kind != "far_field":
        raise UsageError(f"kind is 'polar', and {name!r} has no angles: it is of the kind {of_kind}, and no far field")
    if kind == "polar" and scale != "linear":
        raise UsageError(f"scale is {scale!r}, and a polar diagram is linear; leave scale out")


def _seen(found: Any, name: str, kind: str, unit: str | None, values: np.ndarray) -> tuple[np.ndarray, str, str]:
    """Return a map, its unit, and the flux for a title, empty for watts: lumens where these are known and none asks for watts."""
    key, base = photometry.MAPS.get(kind, ("", ""))
    seen = getattr(found, key, None)
    asked = base if unit is None else _parsed(unit)[1]
    if seen is None and unit is not None and asked == base:
        raise UsageError(f"unit is {unit!r}, and lumens of {name!r} are not known; trace with photometric=True")
    if seen is None or asked == _UNITS[kind]:
        return values, _UNITS[kind], ""
    return seen, base, f"{found.luminous_flux:.4g} lm"


def _check_scale(scale: str) -> None:
    if scale not in ("linear", "log"):
        raise UsageError(f"scale is {scale!r}; give 'linear' or 'log'")


def _chosen(result: Result, detector: str | None) -> str:
    """Return the name of the detector that is meant."""
    kinds = {name: entry["kind"] for name, entry in result.report_json["detectors"].items()}
    with_map = [name for name, kind in kinds.items() if kind in _UNITS]
    listed = ", ".join(map(repr, with_map))
    if detector is None and len(with_map) == 1:
        return with_map[0]
    if not with_map:
        raise UsageError("the result has no map to draw: no detector is one of irradiance, a spectrum or a far field")
    if detector is None:
        raise UsageError(f"name the detector to draw, one of {listed}: result.plot({with_map[0]!r})")
    if detector not in kinds:
        raise UsageError(f"the result has no detector {detector!r}; it has {listed}")
    if detector not in with_map:
        raise UsageError(f"{detector!r} records single rays and has no map; {listed} can be drawn. "
                         f"Its columns are result.detectors[{detector!r}].x, .y, .flux, ...")
    return detector


def _axes(ax: Any, projection: str | None = None, what: str = "a far field") -> Any:
    """Return the axes that are given, or new ones."""
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained", subplot_kw={"projection": projection})[1]
    elif projection is not None and ax.name != projection:
        raise UsageError(f"{what} is drawn on polar axes, and ax is {ax.name}; make them by "
                         "plt.subplots(subplot_kw={'projection': 'polar'})")
    return ax


def _scaled(values: np.ndarray, unit: str | None, base: str, scale: str) -> tuple[np.ndarray, str, Any]:
    """Return values in their unit, its name for people, and what maps them to colours."""
    from matplotlib.colors import LogNorm, Normalize

    factor, label = _unit(unit, base, float(values.max(initial=0.0)))
    values = values / factor
    top = float(values.max(initial=0.0))
    if scale == "linear" or top <= 0.0:
        return values, label, Normalize(0.0, top or 1.0)
    lowest = float(values[values > 0.0].min())
    return values, label, LogNorm(max(lowest, top * 10.0**-_DECADES) if lowest < top else top / 10.0, top, clip=True)


def _unit(unit: str | None, base: str, top: float) -> tuple[float, str]:
    """Return how much of the base unit a unit is, and its name for people."""
    if unit is None:
        fitting = [prefix for prefix, factor in _PREFIXES.items() if factor <= top]
        unit = (fitting[-1] if fitting else "p" if top > 0.0 else "") + base
    factor, of, label = _parsed(unit)
    if of != base:
        raise UsageError(f"unit is {unit!r}, and the map is in {base}; give a unit such as {base!r}")
    return factor, label


def _parsed(unit: str) -> tuple[float, str, str]:
    """Return how much of a result's unit a unit is, that unit, and its own name for people."""
    found = re.fullmatch(f"([{''.join(_PREFIXES)}]?)({'|'.join(_OF)})", unit.replace("^", "").replace("²", "2"))
    if found is None:
        raise UsageError(f"unit is {unit!r}; give W/mm2, W/cm2, W/m2 or W/sr, with a prefix such as in 'mW/cm2'; or lx, fc or cd, of "
                         "a photometric trace")
    prefix, plain = found.groups()
    factor, of = _OF[plain]
    return _PREFIXES[prefix] * factor, of, prefix.replace("u", "µ") + plain.replace("2", "²")


def _slice(found: Any, wavelength: float | str | None) -> tuple[np.ndarray, str]:
    """Return the map of all light, or the map of the bin next to a wavelength, and how a title names it."""
    if found.irradiance.ndim == 2:
        return found.irradiance, ""
    if wavelength == "all":
        return found.irradiance.sum(axis=2), ""
    if isinstance(wavelength, str):
        raise UsageError(f"wavelength is {wavelength!r}; give a number [um], or 'all'")
    place = int(np.argmin(np.abs(found.wavelengths - wavelength)))
    return found.irradiance[:, :, place], f" at {found.wavelengths[place]:.4g} µm"


def _edges(centres: np.ndarray) -> tuple[float, float]:
    """Return where the first pixel begins and the last one ends."""
    half = (centres[-1] - centres[0]) / max(len(centres) - 1, 1) / 2.0 or abs(centres[0]) or 0.5
    return float(centres[0] - half), float(centres[-1] + half)


def _flux(found: Any, values: np.ndarray) -> float:
    (left, right), (low, high) = _edges(found.x_coords), _edges(found.y_coords)
    return float(values.sum()) * (right - left) * (high - low) / values.size


def _draw_map(ax: Any, found: Any, values: np.ndarray, label: str, norm: Any, what: str, options: Any) -> None:
    extent = (*_edges(found.x_coords), *_edges(found.y_coords))
    image = ax.imshow(values, **{"origin": "lower", "extent": extent, "norm": norm, "interpolation": "nearest", **options})
    ax.figure.colorbar(image, ax=ax, label=f"{what} [{label}]")
    ax.set_xlabel("x [mm]")
    ax.set_ylabel("y [mm]")


def in_equal_solid_angles(values: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Return a far field in cells of about equal solid angle, shown in its own cells, as ``nsq-gpu figures`` judges it.

    Cells of a ring go into groups of neighbours, which share their mean. A group has on average at least the solid angle of the
    largest cell. So single rays near the pole make no spikes.
    """
    num = values.shape[1]
    sizes = -np.diff(np.cos(np.deg2rad(np.linspace(*_edges(theta), len(theta) + 1))))
    shown = np.empty_like(values)
    for ring, row, share in zip(shown, values, sizes / sizes.max(), strict=True):
        # Rounding must not double a cell of the full size.
        groups = min(max(int(num * share * (1.0 + 1e-9)), 1), num)
        bounds = np.arange(groups + 1) * num // groups
        ring[:] = (np.add.reduceat(row, bounds[:-1]) / np.diff(bounds)).repeat(np.diff(bounds))
    return shown


def _draw_far_field(ax: Any, found: Any, values: np.ndarray, label: str, norm: Any, options: Any) -> None:
    def edges(centres: np.ndarray, parts: int) -> np.ndarray:
        return np.linspace(*_edges(centres), parts * len(centres) + 1)

    # Cells have straight sides, which of wide ones cut off a part of the circle.
    parts = max(_PARTS // len(found.phi), 1)
    phi, theta = np.meshgrid(np.deg2rad(edges(found.phi, parts)), edges(found.theta, 1))
    image = ax.pcolormesh(phi, theta, values.repeat(parts, axis=1), **{"norm": norm, **options})
    ax.grid(False)
    ax.figure.colorbar(image, ax=ax, label=f"Intensity [{label}]", pad=0.1)
    ax.set_xlabel("theta [deg] outwards, phi [deg] around")


def _draw_spectrum(ax: Any, found: Any, entry: dict[str, Any], scale: str, options: Any) -> None:
    area = _flux(found, np.ones(found.irradiance.shape[:2])) / np.prod(found.irradiance.shape[:2])
    flux = found.irradiance.sum(axis=(0, 1)) * area
    ax.stairs(flux, np.linspace(*_edges(found.wavelengths), len(flux) + 1), **{"fill": scale == "linear", **options})
    ax.set_xlabel("wavelength [µm]")
    ax.set_ylabel("flux [W per bin]")
    ax.set_yscale(scale)


def plot_lamp(table: IntensityTable, flux: float, unit: str, ax: Any, options: Any) -> Any:
    """Draw the polar diagram of a lamp; :meth:`nsq_gpu.sources.TabulatedSource.plot` says how.

    Args:
        table: The lamp's intensity, of which the flux says the level.
        flux: Flux [lm] or [W].
        unit: Unit of the intensity, cd or W/sr.
        ax: Polar axes; None makes a figure.
        options: Options of Matplotlib's ``plot``.
    """
    ax = _axes(ax, "polar", "a lamp")
    _draw_planes(ax, table.polar_angles_deg, lambda gamma, azimuth: table.at(gamma, azimuth) * (flux / table.flux), unit,
                 table.is_of_revolution, options)
    ax.set_title(f"{flux:.4g} {'lm' if unit == 'cd' else 'W'}")
    return ax


def _draw_planes_of(ax: Any, found: Any, values: np.ndarray, unit: str, options: Any) -> None:
    """Draw the polar diagram of a far field."""
    def at(gamma: np.ndarray, azimuth: float) -> np.ndarray:
        plane = [np.interp(azimuth, found.phi, ring, period=360.0) for ring in values]
        # All planes meet at the pole.
        return np.interp(gamma, [0.0, *found.theta], [values[0].mean(), *plane])

    _draw_planes(ax, np.array([0.0, *found.theta, _edges(found.theta)[1]]), at, unit, len(found.phi) == 1, options)


def _draw_planes(ax: Any, polar: np.ndarray, at: Callable[[np.ndarray, float], np.ndarray], unit: str, is_of_revolution: bool,
                 options: Any) -> None:
    """Draw a polar diagram of an intensity, linear between polar angles [deg], of which ``at`` takes angles and an azimuth [deg].

    Plane C lies at the azimuth 360 - C.
    """
    # Between angles of the table, intensity is no straight line in these axes.
    parts = max(int(np.ceil(_PARTS * (polar[-1] - polar[0]) / 180.0 / (len(polar) - 1))), 1)
    gamma = np.interp(np.arange(parts * (len(polar) - 1) + 1) / parts, np.arange(len(polar)), polar)
    # Outside the table there is no light.
    edges = np.concatenate([polar[:1] if polar[0] > 0.0 else [], gamma, polar[-1:] if polar[-1] < 180.0 else []])
    inside = np.concatenate([[0.0] if polar[0] > 0.0 else [], np.ones(len(gamma)), [0.0] if polar[-1] < 180.0 else []])
    planes = ((0.0, "all planes", "-"),) if is_of_revolution else ((0.0, "C0–C180", "-"), (270.0, "C90–C270", "--"))
    for azimuth, label, style in planes:
        right, left = (at(edges, of_side) * inside for of_side in (azimuth, (azimuth + 180.0) % 360.0))
        angles, values = np.concatenate([-edges[::-1], edges]), np.concatenate([left[::-1], right])
        ax.plot(np.deg2rad(angles), values, **{"label": label, "linestyle": style, **options})
    ax.set_theta_zero_location("S")
    marks = np.arange(0, 360, 30)
    ax.set_thetagrids(marks, [f"{min(mark, 360 - mark)}°" for mark in marks])
    ax.set_rlim(bottom=0.0)
    ax.set_xlabel(f"Intensity [{unit}], gamma around")
    ax.legend(loc="upper right", bbox_to_anchor=(1.2, 1.1), fontsize="small")


def plot_ghosts(found: Ghosts, top: int | None, scale: str, unit: str | None, options: Any) -> Any:
    """Draw the maps of the worst ghosts; :meth:`nsq_gpu.Ghosts.plot` says how."""
    import matplotlib.pyplot as plt

    _check_scale(scale)
    if top is not None and not 1 <= top <= found.top:
        raise UsageError(f"top is {top!r}, and {found.top} ghosts of a field have maps; give 1 to {found.top}")
    places = [(i, j) for i, of_field in enumerate(found.fields) for j, known in enumerate(of_field.maps[:top]) if known is not None]
    if not places:
        raise UsageError("there is no ghost to draw; trace more rays: ghosts(..., num_rays=1_000_000)")
    values, label, norm = _scaled(np.stack([found.fields[i].maps[j] for i, j in places]), unit, _UNITS["irradiance"], scale)
    shape = (len(found.fields), max(j for _, j in places) + 1)
    figure, axes = plt.subplots(*shape, figsize=(2.4 * shape[1] + 1.2, 2.7 * shape[0]), layout="constrained", sharex=True,
                                sharey=True, squeeze=False)
    for (i, j), map in zip(places, values, strict=True):
        of_field, row = found.fields[i], found.fields[i].rows[j]
        extent = (*_edges(of_field.x), *_edges(of_field.y))
        image = axes[i, j].imshow(map, **{"origin": "lower", "extent": extent, "norm": norm, "interpolation": "nearest", **options})
        axes[i, j].set_title(f"{of_field.field.label}: {row['faces']}\n{100.0 * row['share']:.2g} % of the light", fontsize="small")
        axes[i, j].set_facecolor(image.get_cmap()(0.0))
    for place in np.ndindex(shape):
        axes[place].set_visible(place in places)
    figure.colorbar(image, ax=axes, label=f"Irradiance [{label}]")
    figure.supxlabel("x [mm]")
    figure.supylabel("y [mm]")
    return axes
