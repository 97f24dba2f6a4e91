"""Derivatives of what detectors record, by numbers of a scene: maps, fluxes, and their standard errors."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene

from nsq_gpu.arguments import answering, check_scene
from nsq_gpu.binary import find_binary
from nsq_gpu.display import Displayed, Summary, error_of, number
from nsq_gpu.edges import check_options
from nsq_gpu.errors import ResultWarning, UsageError, warn
from nsq_gpu.export import export, to_json
from nsq_gpu.few_rays import rests_on
from nsq_gpu.progress import Progress, Shown
from nsq_gpu.session import EXPORTED, Answer, numbers_of_rays, shared_session
from nsq_gpu.results import warn_of
from nsq_gpu.units import unit_of

#: The array of a detector's map, by its kind.
MAPS = {"irradiance": "irradiance", "spectral": "irradiance", "far_field": "intensity"}


@dataclass(frozen=True, repr=False)
class Derivative(Displayed):
    """What one parameter does to one detector, per unit of the parameter.

    The unit is mm, um, rad, W or 1, and degrees where the file has degrees.
    """

    #: Derivative of the flux [W per unit].
    flux: float
    #: Its standard error; NaN where it is not known.
    standard_error: float
    #: Derivative of the map, in the shape of the detector's array: W/mm^2 per unit, of far fields W/sr per unit. None of a
    #: ray database.
    map: np.ndarray | None
    #: Standard errors of ``map``.
    map_standard_error: np.ndarray | None
    #: Rays that the detector's flux rests on, where they are fewer than ten: the standard error then says little. None else.
    rests_on: int | None = None
    #: The same of the interior alone, where ``edges=True`` was asked for; else None.
    interior: Derivative | None = None

    def _summary(self) -> Summary:
        known = "" if self.map is None else f", with a map of {' x '.join(map(str, self.map.shape))}"
        error = rests_on(self.rests_on) if self.rests_on is not None else f"error {number(self.standard_error, 2) or 'not known'}"
        return Summary(f"Derivative: {number(self.flux)} W per unit, {error}{known}")


@dataclass(frozen=True, repr=False)
class Jacobian(Displayed):
    """Derivatives of all detectors by some parameters: ``found["L1.r1", "image"].map``."""

    #: By the names of parameter and detector.
    derivatives: dict[tuple[str, str], Derivative]
    #: The maps themselves, by detector.
    maps: dict[str, np.ndarray]
    #: The report of the trace.
    report: dict[str, Any]
    #: True if the trace was stopped. Derivatives are of the rays that were traced, and some may be missing.
    partial: bool = False

    def __getitem__(self, names: tuple[str, str]) -> Derivative:
        return self.derivatives[names]

    def __str__(self) -> str:
        lines = [f"{'parameter':<20}{'detector':<16}{'d flux [W/.]':>15}{'error':>12}"]
        lines += [f"{parameter:<20}{detector:<16}{found.flux:>15.5g}{found.standard_error:>12.2g}{_remark(found)}"
                  for (parameter, detector), found in self.derivatives.items()]
        return "\n".join(lines)

    def _summary(self) -> Summary:
        rows = [[parameter, detector, number(found.flux, 5), error_of(found.standard_error, found.rests_on)]
                for (parameter, detector), found in self.derivatives.items()]
        units = [f"W/{unit_of(row[0]) or 'unit'}" for row in rows]
        rows = [[*row, unit] for row, unit in zip(rows, units, strict=True)]
        title = f"Jacobian: {self.report['num_rays_total']:,} rays" + (", stopped before its end" if self.partial else "")
        return Summary(title, ["parameter", "detector", "d flux", "error", "unit"], rows)


def _remark(found: Derivative) -> str:
    return "" if found.rests_on is None else f"  {rests_on(found.rests_on)}"


def jacobian(scene: NSQScene | str | os.PathLike[str], parameters: str | Sequence[str], num_rays: int, *,
             where: str | None = None, edges: bool = False, progress: Progress = None, seed: int = 0,
             max_depth: int = 16, precision: str = "auto", adapter: str | None = None,
             binary: str | os.PathLike[str] | None = None, timeout: float | None = None) -> Jacobian:
    """Differentiate what all detectors record by numbers of a scene.

    The derivative is the interior's: of light that goes on through the surfaces that it meets. What a change moves
    across an edge, such as the rim of a lens, is not in it, unless ``edges=True`` asks for that.

    >>> found = nsq_gpu.jacobian(scene, ["L1.r1", "L1.z"], 1_000_000)
    >>> found["L1.r1", "image"].map

    Args:
        scene: The live scene, or its file.
        parameters: Names of numbers, or one name, as in :meth:`nsq_gpu.Session.sweep`: ``L1.r1``, ``lamp.total_flux``.
        num_rays: Rays to launch.
        where: Keeps on detectors the light whose path matches: ``"reflections == 2"``.
        edges: True finds each derivative by a difference of two traces by the same draws, edges included. That takes two
            more traces for each parameter. ``interior`` of each derivative then has it without edges.
        progress: As in :class:`nsq_gpu.NsqGpuBackend`.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        adapter: A part of the adapter's name.
        binary: Path of the program.
        timeout: Longest time [s].

    Raises:
        UnknownNameError: A name of nothing.
        UsageError: A number by which nothing can be differentiated.
        NsqGpuError: One of its other subclasses, by what went wrong.
        Interrupted: Ctrl-C ended the trace; ``partial`` is the Jacobian of the rays that were traced. So it is with
            TraceTimeoutError.
    """
    check_options(where, edges)
    names, text, place = _asked(scene, parameters)
    session = shared_session(find_binary(binary), adapter)
    options = numbers_of_rays(num_rays, seed, max_depth) | {"precision": precision, "where": where}
    with answering(text, names), Shown(progress) as shown:
        return session.kept(text, options, lambda answer, partial: of_answer(answer, partial, edges), timeout=timeout,
                            progress=shown.of_json, gradient=names, gradient_edges=edges, **place)


class LossGradient(dict[str, float]):
    """What a loss gains by a unit of each parameter, by the parameter's name."""

    def _repr_html_(self) -> str:
        errors = self.standard_errors or {}
        rows = [[name, number(value, 5), number(errors.get(name), 2), f"1/{unit_of(name) or 'unit'}"]
                for name, value in self.items()]
        return Summary("LossGradient", ["parameter", "d loss", "error", "unit"], rows).html()

    #: Why some parameters were differentiated forward, four a pass over the rays; None if all were differentiated back.
    why_forward: str | None = None
    #: With ``edges=True`` the standard errors of the values, by the parameter's name; else None. NaN from too few rays.
    standard_errors: dict[str, float] | None = None
    #: With ``edges=True`` the values of the interior alone; else None.
    interior: dict[str, float] | None = None


def loss_gradient(scene: NSQScene | str | os.PathLike[str], parameters: str | Sequence[str],
                  adjoints: Mapping[str, np.ndarray], num_rays: int, *, where: str | None = None, edges: bool = False,
                  progress: Progress = None, seed: int = 0, max_depth: int = 16,
                  precision: str = "auto", adapter: str | None = None, binary: str | os.PathLike[str] | None = None,
                  timeout: float | None = None) -> LossGradient:
    """Differentiate a loss by any number of a scene's numbers, in one pass over the rays.

    A loss is a number that you compute from what detectors record, such as the flux beyond a spot. Say what the loss gains by
    a watt in each pixel; rays are then walked back from there. As with :func:`jacobian`, the derivative is the
    interior's, unless ``edges=True``.

    >>> flux = result.detectors["image"].irradiance * pixel_area      # [W]
    >>> nsq_gpu.loss_gradient(scene, ["L1.r1", "L1.z"], {"image": 2 * (flux - wanted)}, 1_000_000)
    {'L1.r1': -0.0031, 'L1.z': 0.0102}

    Args:
        scene: The live scene, or its file.
        parameters: Names of numbers, as in :func:`jacobian`.
        adjoints: By detector, an array in the shape of its map: what the loss gains by a watt in each cell [1/W]. For a ray
            database, one number. Detectors that are missing do not count.
        num_rays: Rays to launch.
        where: Keeps on detectors the light whose path matches: ``"reflections == 2"``.
        edges: True finds each value by a difference of two traces by the same draws, edges included. That takes two more
            traces for each parameter.
        progress: As in :class:`nsq_gpu.NsqGpuBackend`.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        adapter: A part of the adapter's name.
        binary: Path of the program.
        timeout: Longest time [s].

    Returns:
        What the loss gains by a unit of each parameter; ``why_forward`` says whether rays could not be walked back.

    Raises:
        UnknownNameError: A name of nothing.
        UsageError: A number by which nothing can be differentiated.
        NsqGpuError: One of its other subclasses, by what went wrong.
    """
    check_options(where, edges)
    names, text, place = _asked(scene, parameters)
    session = shared_session(find_binary(binary), adapter)
    options = numbers_of_rays(num_rays, seed, max_depth) | {"precision": precision, "where": where}
    with answering(text, names), Shown(progress) as shown:
        answer = session.loss_gradient(text, options, names, adjoints, timeout=timeout, progress=shown.of_json, edges=edges, **place)
    warn_of_lost(answer["num_lost"])
    found = LossGradient(zip(names, answer["values"], strict=True))
    if edges:
        with_edges = dict(zip(names, answer["with_edges"], strict=True))
        found.interior = dict(found)
        found.standard_errors = {name: _known(of_name["standard_error"]) for name, of_name in with_edges.items()}
        found.update({name: of_name["value"] for name, of_name in with_edges.items()})
    found.why_forward = answer["why_forward"]
    return found


def _known(error: float | None) -> float:
    """Return a standard error; NaN where it is not known."""
    return np.nan if error is None else error


def warn_of_lost(num_lost: int) -> None:
    """Warn of rays that are missing in a gradient."""
    if num_lost:
        warn(f"{num_lost} derivatives were no numbers, or too large: they are missing", ResultWarning)


def _asked(scene: NSQScene | str | os.PathLike[str],
           parameters: str | Sequence[str]) -> tuple[list[str], str, dict[str, str | None]]:
    """Return names of parameters, the text of a scene, and what errors call the scene and where its files are."""
    names = [parameters] if isinstance(parameters, str) else list(parameters)
    if not names:
        raise UsageError('name a parameter, such as "L1.r1"')
    check_scene(scene, or_path=True)
    if isinstance(scene, NSQScene):
        return names, to_json(export(scene).document, indent=None), {"name": EXPORTED, "folder": None}
    path = Path(scene)
    return names, path.read_text(encoding="utf-8"), {"name": str(path), "folder": str(path.parent.resolve())}


def of_answer(answer: Answer, partial: bool = False, edges: bool = False) -> Jacobian:
    """Return the derivatives of a session's answer; with ``edges`` the ones of which a stop left differences of two traces."""
    warn_of(answer.report, answer.missed_target)
    arrays = answer.arrays(None)
    derivatives = {}
    for row in answer.report["gradients"]:
        if row["num_lost"]:
            warn(f"{row['detector']} by {row['parameter']}: derivatives of {row['num_lost']} deposits were no numbers, or "
                 "too large: they are missing", ResultWarning)
        name = f"{row['detector']}/{row['parameter']}"
        few = answer.report["detectors"][row["detector"]].get("rests_on")
        found = Derivative(row["flux"], _known(row["standard_error"]), arrays.get(name), arrays.get(f"{name}/standard_error"),
                           few)
        if edges and (with_edges := row.get("with_edges")) is None:
            continue
        if edges:
            name += "/with_edges"
            found = Derivative(with_edges["flux"], _known(with_edges["standard_error"]), arrays.get(name),
                               arrays.get(f"{name}/standard_error"), with_edges.get("rests_on", few), found)
        derivatives[row["parameter"], row["detector"]] = found
    maps = {name: answer.arrays(name)[MAPS[entry["kind"]]]
            for name, entry in answer.report["detectors"].items() if entry["kind"] in MAPS}
    return Jacobian(derivatives, maps, answer.report, partial)
