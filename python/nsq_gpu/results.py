"""The files of a trace -> live detectors, absorbers' counters and Optiland's own result objects."""

from __future__ import annotations

import dataclasses
import os
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.detectors.far_field import FarFieldDetector
from optiland.nonsequential.detectors.irradiance import IrradianceDetector
from optiland.nonsequential.detectors.ray_database import RayDatabaseDetector
from optiland.nonsequential.detectors.spectral import SpectralDetector
from optiland.nonsequential.diagnostics import Diagnostics, build_diagnostics
from optiland.nonsequential.path_recording import _EVENT_DTYPE
from optiland.nonsequential.tracer import SimulationResult

from nsq_gpu.color import add_color
from nsq_gpu.detectors import SphereFarField
from nsq_gpu.display import Displayed, Summary, error_of, number
from nsq_gpu.errors import (
    NsqGpuError,
    NsqGpuWarning,
    ResultWarning,
    ToleranceWarning,
    UnsupportedSceneError,
    wants_gradient,
    warn,
)
from nsq_gpu.few_rays import FewRays, few_rays
from nsq_gpu.integrity import load_arrays
from nsq_gpu.paths import PathTable, path_table
from nsq_gpu.photometry import ARRAYS

if TYPE_CHECKING:
    from nsq_gpu.figures import Figures
    from nsq_gpu.verifying import Verification

Json = dict[str, Any]

#: Fields of SimulationResult that the report holds under the same names.
_SAME = (
    "num_rays_total", "num_rays_absorbed", "num_rays_escaped", "num_rays_flux_killed", "num_rays_depth_killed",
    "total_flux_in", "total_flux_detected", "total_flux_tapped", "total_flux_absorbed", "total_flux_bulk_absorbed",
    "total_flux_escaped", "total_flux_lost", "flux_conservation_error", "trace_time_sec",
)
#: What light is taken by, or gained from, that Optiland's figure of the energy has no term for; keys of the ledger.
_ONLY_IN_LEDGER = {
    "surface": "mirrors", "coating": "coatings", "bsdf": "scattering surfaces", "importance_loss": "importance sampling",
    "roulette_gain": "gained by roulette", "importance_gain": "gained by importance sampling",
    "bsdf_gain": "gained by sampling of scattering",
}
#: A figure in a text, but none within a name, such as L1.r1.
_FIGURE = re.compile(r"(?<![\w.'\"])\d[\d,.]*(?:e[+-]?\d+)?(?![\w'\"])")
#: Longest name in an event [characters].
ROWS = ("x", "y", "z", "L", "M", "N", "flux", "wavelength")


@dataclass(frozen=True)
class LedgerDiagnostics(Diagnostics):
    """Optiland's diagnostics with what the program's ledger says.

    ``flux_conservation_error`` is Optiland's figure. It has no term for what mirrors, coatings and scattering surfaces
    take, and closes only in expectation where branches are drawn by importance or rays end by roulette. The ledger has
    a bin for each of these, so it alone says whether light was lost.
    """

    #: Quanta that no bin accounts for.
    ledger_imbalance_quanta: int = 0
    #: Deposits that were no numbers.
    invalid_deposits: int = 0
    #: Flux that Optiland's figure has no term for [W], by what took it.
    flux_only_in_ledger: dict[str, float] = dataclasses.field(default_factory=dict)
    #: Flux that came to detectors that end rays, by paths that a filter does not keep [W]. It is not lost, and
    #: ``flux_conservation_error`` does not count it.
    flux_filtered_out: float = 0.0
    #: Rays that took the inside of a solid for its outside: ``entered_twice`` and ``ended_inside`` by the names of
    #: surfaces and detectors, and ``warnings``. Empty where there are none.
    wrong_sides: Json = dataclasses.field(default_factory=dict)

    @property
    def ledger_closes(self) -> bool:
        """True if every quantum is accounted for."""
        return self.ledger_imbalance_quanta == 0 and self.invalid_deposits == 0

    def warnings(self) -> list[str]:
        """Return Optiland's warnings; of the energy, the ledger's."""
        said = Diagnostics.warnings(dataclasses.replace(self, flux_conservation_error=0.0))
        said = [*said, *self.wrong_sides.get("warnings", [])]
        return said if self.ledger_closes else [self._ledger(), *said]

    def report(self) -> str:
        """Return Optiland's report, and what the ledger says."""
        return f"{super().report()}\n{self._ledger()}"

    def _ledger(self) -> str:
        if not self.ledger_closes:
            return (f"THE LEDGER DOES NOT CLOSE: {self.ledger_imbalance_quanta} quanta unaccounted for, "
                    f"{self.invalid_deposits} invalid deposits")
        text = "The ledger closes: every quantum is accounted for."
        if self.flux_only_in_ledger:
            taken = ", ".join(f"{what} {flux:.6g} W" for what, flux in self.flux_only_in_ledger.items())
            text += f" Optiland's flux_conservation_error has no term for: {taken}."
        if self.flux_filtered_out > 0.0:
            text += f" The filter of paths kept {self.flux_filtered_out:.6g} W from the detectors."
        return text


class Result(Displayed, SimulationResult):
    """Optiland's result, with what it has no field for, and with pictures, files and tables.

    >>> result.plot("image", scale="log")
    >>> result.save("run_1")
    >>> nsq_gpu.load("run_1").to_xarray()
    """

    #: Light by its path; None if it was not asked for.
    paths: PathTable | None = None
    #: What is known of fluxes that rest on fewer than ten rays, by detector.
    few_rays: dict[str, FewRays] = MappingProxyType({})  # type: ignore[assignment]
    #: True if the trace was stopped.
    partial: bool = False
    #: The program's report, as ``report.json`` has it.
    report_json: Json = MappingProxyType({})  # type: ignore[assignment]
    #: The program's arrays by detector, as the ``.npz`` files have them; under None the arrays of recorded paths.
    arrays: dict[str | None, dict[str, np.ndarray]] = MappingProxyType({})  # type: ignore[assignment]
    #: The text of the scene that was traced, as a scene file has it; None if it is not known.
    scene_json: str | None = None

    def plot(self, detector: str | None = None, *, kind: str | None = None, scale: str = "linear", unit: str | None = None,
             wavelength: float | str | None = None, smooth: bool = True, ax: Any = None, **options: Any) -> Any:
        """Draw what a detector saw: a map with its colour bar, a far field, or a spectrum.

        Of a photometric trace, maps are in lx and far fields in cd.

        Args:
            detector: Its name; it may be left out where one alone has a map.
            kind: ``"polar"`` draws a far field as the polar diagram of a luminaire: planes C0-C180 and C90-C270, gamma 0 deg
                downwards, C0 and C90 to the right. Plane C lies at the azimuth 360 - C of the detector's frame, as in a
                lamp's file: C90 is phi = -90 deg, and C270 is phi = 90 deg. None draws the map.
            scale: ``"linear"``, or ``"log"``: over at most six decades below the largest value. Polar diagrams are linear.
            unit: Such as ``"mW/cm2"``, ``"klx"``, ``"cd"``, or ``"fc"``, which is 10.7639 lx. By default lx or cd where these
                are known, else W/mm^2 or W/sr, with the prefix that fits.
            wavelength: Of a spectral detector the map at this wavelength [um], or of ``"all"`` light. None draws the spectrum.
            smooth: A far field is drawn in cells of about equal solid angle. In each polar ring so many neighbours share their
                mean as together have at least the solid angle of the largest cell. False draws each cell. Arrays stay as they are.
            ax: Matplotlib's axes; a far field's are polar. None makes a figure.
            options: Further options of ``imshow``, ``pcolormesh``, ``stairs`` or ``plot``, such as ``cmap="magma"``.

        Returns:
            The axes.

        Raises:
            UsageError: Several detectors have a map, or none of this name has; the message has the names. Or lumens are not known.
        """
        from nsq_gpu.plotting import plot

        return plot(self, detector, kind=kind, scale=scale, unit=unit, wavelength=wavelength, smooth=smooth, ax=ax, **options)

    def save(self, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the result into a folder, as ``nsq-gpu trace -o`` does; :func:`nsq_gpu.load` reads it back.

        ``nsq-gpu view``, ``compare`` and ``verify`` read it as well. It has no pictures, and no ``tally.bin``, so that
        ``merge`` and ``--resume`` do not take it. ``scene.json`` is the scene that was traced.

        Args:
            folder: The folder; it is made where it is not there. Files of others in it stay.
            overwrite: True replaces the files of a result that is there.

        Raises:
            UsageError: A file is in the way.
        """
        from nsq_gpu.storing import save

        save(self, Path(folder), overwrite)

    def verify(self, *, sample: int = 3, adapter: str | None = None, binary: str | None = None) -> Verification:
        """Say whether other rays of the scene give this result; :func:`nsq_gpu.verify` asks more of a folder with sums.

        Args:
            sample: So many 64ths of the rays are traced, but at least 65,536 rays.
            adapter: A part of the adapter's name.
            binary: Path of the program.
        """
        from nsq_gpu.verifying import verify

        with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as folder:
            self.save(folder)
            return verify(folder, sample=sample, adapter=adapter, binary=binary)

    def figures(self, detector: str | None = None, *, regions: Sequence[Sequence[float]] = (),
                circles: Sequence[Sequence[float]] = (), cones: Sequence[float] = (), cells: Sequence[int] | None = None,
                binary: str | None = None) -> Figures:
        """Say how even, how wide and how strong the light is, with standard errors: ``nsq-gpu figures``.

        >>> result.figures("desk")["desk"].whole["min_over_mean"].value

        Args:
            detector: Its name; None takes all that have a map in W/mm^2 or W/sr.
            regions: Rectangles (x0, x1, y0, y1) of a detector [mm], which are judged as well.
            circles: Circles (x, y, radius) of a detector [mm].
            cones: Half angles of cones about the axis of a far field [deg].
            cells: Columns and rows of cells over which figures are found, made of whole pixels. None takes the finest whose
                errors are 1 % on average.
            binary: Path of the program.

        Raises:
            UsageError: There is no such detector, or a region is none of its kind.
        """
        from nsq_gpu.figures import figures

        return figures(self, detector, {"regions": regions, "circles": circles, "cones": cones}, cells, binary)

    def export_lamp(self, path: str | os.PathLike[str], detector: str | None = None, *, forward: bool = False,
                    overwrite: bool = False, binary: str | None = None) -> None:
        """Write a far field in candela as the file of a lamp: IES LM-63 (.ies) or EULUMDAT (.ldt).

        Intensities belong to cells of about equal solid angle. Plane C90 of the file is phi = -90 deg.

        Args:
            path: The file; its ending says which format.
            detector: The far field; it may be left out where there is one alone.
            forward: True says that no light comes from behind. The far fields of Optiland add that to the light forwards.
            overwrite: True replaces a file that is there.
            binary: Path of the program.

        Raises:
            UsageError: The trace was not photometric, the far field may hold light from behind, or a file is in the way.
        """
        from nsq_gpu.figures import export_lamp

        export_lamp(self, path, detector, forward, overwrite, binary)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` of all maps, with units on coordinates: ``image`` and ``image_standard_error``.

        Of a photometric trace it has ``image_illuminance`` [lx] or ``sky_luminous_intensity`` [cd] as well.

        Raises:
            MissingLibraryError: xarray is not installed (``pip install 'nsq-gpu[xarray]'``).
        """
        from nsq_gpu.labelled import of_result

        return of_result(self)

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with a row a detector; ``attrs["units"]`` has the columns' units.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        from nsq_gpu.labelled import detector_table

        return detector_table(self)

    def _summary(self) -> Summary:
        report = self.report_json
        if not report:
            # Such as a copy by dataclasses.replace, which takes Optiland's fields alone.
            return Summary(SimulationResult.__repr__(self))
        title = (f"Result: {self.num_rays_total:,} rays in {self.trace_time_sec:.3g} s, {report['precision']}, "
                 f"{report['adapter']}" + (", stopped before its end" if self.partial else ""))
        rows = []
        lumens = (report.get("photometry") or {}).get("detectors")
        for name, entry in report["detectors"].items():
            error = error_of(entry["total_flux_standard_error"], entry.get("rests_on"), entry.get("upper_bound_95"))
            seen = _in_lumens(lumens.get(name), entry) if lumens else []
            rows.append([name, number(entry["total_flux"]), error, *seen, f"{entry['num_rays_hit']:,}", entry["kind"]])
        blank = [""] * 2 if lumens else []
        for what, flux in (("launched", self.total_flux_in), ("absorbed", self.total_flux_absorbed),
                           ("bulk absorbed", self.total_flux_bulk_absorbed), ("escaped", self.total_flux_escaped),
                           ("lost", self.total_flux_lost)):
            if flux:
                rows.append([what, number(flux), "", *blank, "", ""])
        warnings = self.diagnostics.warnings()
        notes = ["The ledger closes."] if self.diagnostics.ledger_closes else []
        notes += [f"{len(warnings)} warnings: see print(result.report())"] if warnings else []
        of_lumens = ["flux [lm]", "error [lm]"] if lumens else []
        return Summary(title, ["", "flux [W]", "error [W]", *of_lumens, "rays", ""], rows, notes=notes)


def _in_lumens(seen: Json | None, entry: Json) -> list[str]:
    """Return the lumens of a detector, and their standard error, as a table has them."""
    return ["", ""] if seen is None else [number(seen["flux_lm"]), error_of(seen["flux_lm_standard_error"], entry.get("rests_on"))]


#: Gives the arrays of a detector by its name, or with None the arrays of the recorded paths.
Load = Callable[[str | None], dict[str, np.ndarray]]


def in_folder(folder: Path, report: Json) -> Load:
    """Return what loads the arrays of a report from the files beside it."""
    return lambda name: load_arrays(folder, report["ray_paths"] if name is None else report["detectors"][name]["file"], report)


def fill_scene(scene: NSQScene, report: Json, load: Load, surface_labels: list[str],
               records_paths: bool = False, attach: Callable[[], None] | None = None,
               partial: bool = False, text: str | None = None) -> Result:
    """Put a trace into the live scene, as a trace of Optiland's leaves it, and return its result.

    ``attach`` is called when the live detectors hold their maps, and may put these on a graph. ``partial`` marks the result
    of a trace that was stopped. ``text`` is the scene as it was traced.
    """
    _check_names(report, surface_labels, scene.detector_names)
    _fill_absorbers(scene, report)
    arrays: dict[str | None, dict[str, np.ndarray]] = {name: load(name) for name in scene.detector_names}
    if records_paths:
        arrays[None] = load(None)
    for name, live in zip(scene.detector_names, scene.detectors, strict=True):
        _fill_detector(live, report["detectors"][name], arrays[name])
    if attach is not None:
        attach()
    detectors = {name: live.get_result() for name, live in zip(scene.detector_names, scene.detectors, strict=True)}
    ray_paths = _ray_paths(scene, arrays[None], surface_labels) if records_paths else None
    return result_of(report, arrays, detectors, ray_paths, _diagnostics(scene, report, detectors), partial, text)


def result_of(report: Json, arrays: dict[str | None, dict[str, np.ndarray]], detectors: dict[str, Any], ray_paths: Json | None,
              diagnostics: Diagnostics, partial: bool, text: str | None) -> Result:
    """Return a result of these parts."""
    for name, detector in detectors.items():
        _add_errors(detector, report["detectors"][name], arrays[name])
        add_color(detector, name, report, arrays[name])
    result = Result(**{key: report[key] for key in _SAME}, detectors=detectors, ray_paths=ray_paths, diagnostics=diagnostics)
    rows = report.get("paths")
    result.paths = None if rows is None else path_table(rows, text, report.get("recoated", ()), report.get("split_depth", 0))
    result.few_rays = {name: found for name, spec in report["detectors"].items() if (found := few_rays(spec))}
    result.partial = partial
    result.report_json, result.arrays, result.scene_json = report, arrays, text
    return result


def warn_of(report: Json, missed_target: str | None, known: set[str] | None = None) -> None:
    """Give the warnings of a trace as warnings of the user's line, but for those ``known``, to which they are added. Warnings
    that differ in their figures alone count as one, since each point of a sweep has figures of its own.
    """
    told: list[tuple[str, type[Warning]]] = [] if missed_target is None else [(missed_target, ToleranceWarning)]
    told += [(warning, NsqGpuWarning) for warning in report["scene_warnings"]]
    told += [(warning, ResultWarning) for warning in report["diagnostics"]["grave"]]
    for message, category in told:
        without_figures = _FIGURE.sub("#", message)
        if known is None or without_figures not in known:
            warn(message, category)
        if known is not None:
            known.add(without_figures)


def check_paths(scene: NSQScene, surface_labels: list[str]) -> None:
    """Refuse paths that could not part a detector from a surface, since an event knows both by name alone."""
    for name in scene.detector_names:
        if name in surface_labels:
            raise UnsupportedSceneError(f"a detector and a surface are both called {name!r}, so recorded paths could "
                                        "not keep them apart; rename one, or trace without record_paths")


def _check_names(report: Json, surface_labels: list[str], detector_names: list[str]) -> None:
    """Check that the report speaks of this scene, since surfaces are matched by their order."""
    surfaces = [surface["name"] for surface in report["surfaces"]]
    if surfaces != surface_labels or list(report["detectors"]) != detector_names:
        raise NsqGpuError(f"the command traced {surfaces} and {list(report['detectors'])}, not {surface_labels} and "
                          f"{detector_names}; program and package are of different versions")


def _fill_absorbers(scene: NSQScene, report: Json) -> None:
    for surface, live in zip(report["surfaces"], scene.surfaces, strict=True):
        if isinstance(live, AbsorbingComponent):
            live._absorbed_count = surface["num_rays_absorbed"]
            live._absorbed_flux = surface["total_flux_absorbed"]


# Detectors


def _fill_detector(live: Any, spec: Json, arrays: Any) -> None:
    live.reset()
    _FILL[type(live)](live, spec, arrays)
    live._num_rays_hit = spec["num_rays_hit"]


def _add_errors(detector: Any, spec: Json, arrays: Any) -> None:
    """Put standard errors, lux, candela and lumens on a result, where Optiland's has no field for them."""
    detector.total_flux_standard_error = spec["total_flux_standard_error"]
    detector.standard_error = arrays.get("standard_error")
    detector.few_rays = few_rays(spec)
    for name in (key + suffix for key in ARRAYS for suffix in ("", "_standard_error")):
        found = arrays.get(name)
        setattr(detector, name, float(found) if found is not None and found.ndim == 0 else found)


def _pixel_area(live: Any) -> float:
    return float(live.width) / int(live.num_pixels_x) * (float(live.height) / int(live.num_pixels_y))


def _fill_irradiance(live: Any, spec: Json, arrays: Any) -> None:
    data = be.array((arrays["irradiance"] * _pixel_area(live)).ravel())
    # Where Optiland makes every constant a leaf that wants a gradient, the map is one too.
    live._data = data.detach() if wants_gradient(data) else data


def _fill_spectral(live: Any, spec: Json, arrays: Any) -> None:
    live._flux_map = arrays["irradiance"] * _pixel_area(live)


def _fill_far_field(live: Any, spec: Json, arrays: Any) -> None:
    live._intensity = arrays["intensity"]
    live._total_flux = spec["total_flux"]


def _fill_ray_database(live: Any, spec: Json, arrays: Any) -> None:
    # Of a capped database the live detector counts every row, its result those that were kept.
    live._total_flux = spec["total_flux_recorded"]
    # Without rows Optiland's own detector holds no arrays at all.
    if len(arrays["x"]):
        for key in ROWS:
            getattr(live, f"_{key}").append(arrays[key])


_FILL: dict[type, Callable[[Any, Json, Any], None]] = {
    IrradianceDetector: _fill_irradiance,
    SpectralDetector: _fill_spectral,
    FarFieldDetector: _fill_far_field,
    SphereFarField: _fill_far_field,
    RayDatabaseDetector: _fill_ray_database,
}


# Diagnostics and paths


def _diagnostics(scene: NSQScene, report: Json, detectors: dict[str, Any]) -> Any:
    launched, said = report["total_flux_in"], report["diagnostics"]
    reached = {index for index, surface in enumerate(report["surfaces"]) if surface["reached"]}
    optilands = build_diagnostics(
        scene,
        reached,
        report["num_rays_total"],
        launched,
        said["depth_truncated_flux_fraction"] * launched,
        said["rr_killed_flux_fraction"] * launched,
        report["flux_conservation_error"],
        said["split_budget_saturated"],
        detectors,
        medium_stack_underflows=said["medium_stack_underflows"],
    )
    return with_ledger(optilands, report)


def with_ledger(optilands: Diagnostics, report: Json) -> LedgerDiagnostics:
    """Return Optiland's diagnostics with what the report says of the ledger."""
    ledger = report["ledger"]
    return LedgerDiagnostics(
        **vars(optilands),
        ledger_imbalance_quanta=int(ledger["imbalance_quanta"]),
        invalid_deposits=ledger["invalid_deposits"],
        flux_only_in_ledger={what: ledger[key]["flux"] for key, what in _ONLY_IN_LEDGER.items()
                             if ledger[key]["flux"] > 0.0},
        flux_filtered_out=ledger["filtered_out"]["flux"],
        wrong_sides=report["diagnostics"].get("wrong_sides", {}),
    )


def _ray_paths(scene: NSQScene, columns: dict[str, np.ndarray], surface_labels: list[str]) -> Json:
    events = np.empty(len(columns["ray_id"]), dtype=_EVENT_DTYPE)
    for key in _EVENT_DTYPE.names or ():
        events[key] = columns[key]
    names = columns["component_name"]
    events["component_name"] = _optilands_names(scene, events["event_type"], names, surface_labels)
    return {"events": events}


def _optilands_names(scene: NSQScene, event_types: np.ndarray, ours: np.ndarray, surface_labels: list[str]) -> np.ndarray:
    """Return the events' names as Optiland's own traces write them.

    Its births read ``source_0`` and its detectors have no name, whatever the registry calls them, and programs that
    read its paths expect that. The field cuts long names, as it does there.
    """
    sources = {name: getattr(live, "name", f"source_{index}")
               for index, (name, live) in enumerate(zip(scene.source_names, scene.sources, strict=True))}
    surfaces = {label: live.name or f"component_{index}"
                for index, (label, live) in enumerate(zip(surface_labels, scene.surfaces, strict=True))}
    detectors = {name: live.name for name, live in zip(scene.detector_names, scene.detectors, strict=True)}
    names = ours.astype(_EVENT_DTYPE["component_name"])
    for which, known in (("birth", sources), ("hit", surfaces | detectors)):
        chosen = event_types == which
        found, inverse = np.unique(ours[chosen], return_inverse=True)
        # NumPy's texts have no NUL at their ends.
        stripped = {name.rstrip("\0"): renamed for name, renamed in known.items()}
        names[chosen] = np.array([stripped[str(name)] for name in found], dtype=names.dtype)[inverse]
    return names
