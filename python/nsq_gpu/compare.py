"""Traces a scene file with this backend and with Optiland's, and prints them side by side.

    python -m nsq_gpu.compare SCENE.json -n 1e5 [--seed 0] [--precision f64] [--torch]

All of them draw the same numbers, so a ray should meet the same surfaces in each. Two measures are printed: how far
sums and maps are apart, in sigmas of their own Monte Carlo noise and in ulps of the map's peak, and how many rays,
of a recorded subset, meet other surfaces than with NumPy. The exit code is 6 if a difference exceeds SIGMAS, or if
more than FATES of the recorded rays go elsewhere. Where a side splits rays, its children draw numbers of their own:
there expectations of flux are the same, so the verdict goes by fluxes and maps alone. Where rounding decides a ray's
way, as after many reflections between curved mirrors, ``--statistical`` leaves the rays' fates out of the verdict.

Other exit codes are the same as of ``nsq-gpu``: 2 for wrong options or a file that cannot be read, 3 for an invalid scene or
one that Optiland cannot build, 4 without an adapter, 5 where the device fails.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQScene
from optiland.nonsequential.backends.base import TracerBackend
from optiland.nonsequential.backends.numpy_backend import NumpyBackend

from nsq_gpu.backend import PRECISIONS, NsqGpuBackend
from nsq_gpu.binary import find_binary
from nsq_gpu.errors import NsqGpuError, SceneError, UsageError
from nsq_gpu.loading import check_scene
from nsq_gpu.scene_file import load_scene

#: Exit code where the backends disagree: the command's own for a tolerance that is not met.
DISAGREE = 6
#: Largest difference of a sum or of a map's bin, in standard deviations of its own noise.
SIGMAS = 5.0
#: Largest share of recorded rays that may go elsewhere.
FATES = 1e-3
#: Rays whose paths are recorded.
RECORDED = 2000
#: Largest number of events of a ray where none is given: Optiland's.
MAX_DEPTH = 16

COUNTS = ("num_rays_total", "num_rays_absorbed", "num_rays_escaped", "num_rays_flux_killed", "num_rays_depth_killed")
FLUXES = ("total_flux_in", "total_flux_detected", "total_flux_tapped", "total_flux_absorbed",
          "total_flux_bulk_absorbed", "total_flux_escaped", "total_flux_lost", "flux_conservation_error")


@dataclass
class Side:
    """One backend's result."""

    name: str
    result: Any
    hits: dict[str, int]
    seconds: float
    #: Rays per second of the trace itself, without starting a program.
    rays_per_sec: float
    #: True if this backend splits the scene's rays.
    splits: bool = False
    fates: dict[int, tuple[str, ...]] = field(default_factory=dict)


@dataclass
class Difference:
    """How far a side is from the reference."""

    what: str
    sigmas: float
    detail: str = ""
    is_count: bool = False


def trace_side(name: str, load: Callable[[], NSQScene], backend: TracerBackend, num_rays: int, seed: int,
               max_depth: int = MAX_DEPTH) -> Side:
    """Trace a scene that is loaded for this backend alone."""
    scene = load()
    # Optiland leaves detectors without a name, and a ray's fate is the names that it met.
    for detector, live in zip(scene.detector_names, scene.detectors, strict=True):
        live.name = detector
    start = time.perf_counter()
    result = scene.trace(num_rays, max_depth=max_depth, seed=seed, backend=backend,
                         record_paths=min(RECORDED, num_rays))
    seconds = time.perf_counter() - start
    hits = {detector: int(live._num_rays_hit)
            for detector, live in zip(scene.detector_names, scene.detectors, strict=True)}
    # TorchBackend does not split.
    splits = scene.sampling_policy.split_depth > 0 and name != "Torch"
    return Side(name, result, hits, seconds, num_rays / max(result.trace_time_sec, 1e-9), splits, fates_of(result))


def fates_of(result: Any) -> dict[int, tuple[str, ...]]:
    """Return what every recorded ray met, in order."""
    if result.ray_paths is None:
        return {}
    events = result.ray_paths["events"]
    rank = np.select([events["event_type"] == "birth", events["event_type"] == "death"], [0, 2], 1)
    events = events[np.lexsort((rank, events["bounce"], events["ray_id"]))]
    fates: dict[int, list[str]] = {}
    for ray, met in zip(events["ray_id"].tolist(), events["component_name"].tolist(), strict=True):
        fates.setdefault(ray, []).append(met)
    return {ray: tuple(met) for ray, met in fates.items()}


def differing_fates(side: Side, reference: Side) -> int:
    """Return how many recorded rays met something else, or were recorded by one side alone."""
    rays = side.fates.keys() | reference.fates.keys()
    return sum(side.fates.get(ray) != reference.fates.get(ray) for ray in rays)


def differences(side: Side, reference: Side) -> list[Difference]:
    """Return how far every count, flux and map of a side is from the reference's."""
    num_rays, launched = reference.result.num_rays_total, reference.result.total_flux_in
    found = [_of_counts(name, getattr(side.result, name), getattr(reference.result, name), num_rays)
             for name in COUNTS]
    weight = launched / max(num_rays, 1)
    # What roulette and the depth limit take depends on which rays they meet.
    lost = ("total_flux_lost",) if _splits(side, reference) else ()
    found += [_of_fluxes(name, getattr(side.result, name), getattr(reference.result, name), weight)
              for name in FLUXES[1:-1] if name not in lost]
    for name, theirs in reference.result.detectors.items():
        ours = side.result.detectors[name]
        found.append(_of_counts(f"{name}: hits", side.hits[name], reference.hits[name], num_rays))
        found.append(_of_fluxes(f"{name}: flux", _number(ours.total_flux), _number(theirs.total_flux), weight))
        maps = map_of(ours), map_of(theirs)
        if maps[0] is not None and maps[1] is not None:
            # Children are many and light, but all of one ray may meet in one bin: so many rays the flux stands for.
            hits = _number(theirs.total_flux) / weight if _splits(side, reference) else reference.hits[name]
            found.append(_of_maps(f"{name}: map", maps[0], maps[1], hits))
    return found


def _splits(*sides: Side) -> bool:
    return any(side.splits for side in sides)


def map_of(result: Any) -> np.ndarray | None:
    """Return the map of a detector's result, if it has one."""
    for key in ("irradiance", "intensity"):
        if hasattr(result, key):
            return np.asarray(getattr(result, key), dtype=np.float64)
    return None


def _number(value: Any) -> float:
    return float(be.to_numpy(value))


def _of_counts(what: str, ours: int, theirs: int, num_rays: int) -> Difference:
    # A ray may hit a detector more than once, so a count can exceed the rays.
    noise = np.sqrt(max(theirs * (1.0 - min(theirs / max(num_rays, 1), 1.0)), 1.0))
    detail = f"{ours - theirs:+d}" if ours != theirs else ""
    return Difference(what, abs(ours - theirs) / noise, detail, is_count=True)


def _of_fluxes(what: str, ours: float, theirs: float, weight: float) -> Difference:
    noise = np.sqrt(max(theirs, weight) * weight)
    relative = abs(ours - theirs) / abs(theirs) if theirs else abs(ours - theirs)
    return Difference(what, abs(ours - theirs) / noise if noise else 0.0, f"{relative:.1e} relative")


def _of_maps(what: str, ours: np.ndarray, theirs: np.ndarray, hits: float) -> Difference:
    """Compare bin by bin; a bin's noise is the noise of as many hits as its share of the map stands for."""
    apart = np.abs(ours - theirs)
    peak = float(np.abs(theirs).max(initial=0.0))
    per_hit = float(theirs.sum()) / max(hits, 1)
    noise = np.sqrt(np.maximum(theirs, per_hit) * per_hit)
    worst = float(apart.max(initial=0.0))
    sigmas = float((apart / np.where(noise > 0.0, noise, np.inf)).max(initial=0.0))
    ulps = worst / np.spacing(peak) if peak > 0.0 else worst
    return Difference(what, sigmas, f"{ulps:.3g} ulp of the peak")


# Printing


def table(sides: list[Side]) -> str:
    """Return the figures of all sides, one column each."""
    rows = [["", *(side.name for side in sides)]]
    rows += [[name, *(f"{getattr(side.result, name):,d}" for side in sides)] for name in COUNTS]
    rows += [[name, *(f"{getattr(side.result, name):.9g}" for side in sides)] for name in FLUXES]
    for name in sides[0].result.detectors:
        rows.append([f"{name}: hits", *(f"{side.hits[name]:,d}" for side in sides)])
        rows.append([f"{name}: flux [W]",
                     *(f"{_number(side.result.detectors[name].total_flux):.9g}" for side in sides)])
    rows.append(["seconds", *(f"{side.seconds:.2f}" for side in sides)])
    rows.append(["rays/s", *(f"{side.rays_per_sec:,.0f}" for side in sides)])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join([row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width
                                                   in zip(row[1:], widths[1:], strict=True))]) for row in rows]
    return "\n".join(line.rstrip() for line in lines)


def verdict(side: Side, reference: Side, statistical: bool) -> tuple[str, bool]:
    """Return the differences of a side as text, and whether it agrees."""
    found = differences(side, reference)
    astray, recorded = differing_fates(side, reference), max(len(reference.fates), 1)
    splits = _splits(side, reference)
    apart = [difference for difference in found
             if not difference.sigmas <= SIGMAS and not (splits and difference.is_count)]
    agrees = not apart and (statistical or splits or astray <= FATES * recorded)
    lines = [f"{side.name} against {reference.name}:"]
    lines += [_line(difference, judged=not (splits and difference.is_count))
              for difference in found if difference.sigmas > 0.0]
    lines.append(f"  rays with another fate: {astray} of {recorded} recorded")
    lines.append(f"  {'agree' if agrees else 'DISAGREE'}")
    return "\n".join(lines), agrees


def _line(difference: Difference, judged: bool) -> str:
    # Where rays split, one leaves many hits: the noise of their number is not the noise of single rays.
    sigmas = f"{difference.sigmas:8.2g} sigma" if judged else "    not judged"
    return f"  {difference.what:32} {sigmas}  {difference.detail}".rstrip()


# The command


def parse(arguments: list[str]) -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(prog="python -m nsq_gpu.compare", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, metavar="SCENE")
    parser.add_argument("-n", "--num-rays", type=_count, default=100_000, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--max-depth", type=int, default=MAX_DEPTH, metavar="N",
                        help="largest number of events of a ray, on every side (default: Optiland's %(default)s)")
    parser.add_argument("--precision", choices=PRECISIONS, default="auto")
    parser.add_argument("--adapter", metavar="NAME", help="part of the adapter's name")
    parser.add_argument("--binary", metavar="PATH", help="the program nsq-gpu")
    parser.add_argument("--torch", action="store_true", help="compare TorchBackend as well, in float64")
    parser.add_argument("--statistical", action="store_true", help="do not judge by single rays' fates")
    return parser.parse_args(arguments)


def _count(text: str) -> int:
    """Return a number of rays, such as 1e5."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not value.is_integer() or value < 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of rays; write 250000 or 1e5")
    return int(value)


def _check(options: argparse.Namespace) -> None:
    """Refuse what cannot be traced, before anything is.

    Raises:
        UsageError: Torch is missing, or the file cannot be read.
        SceneError: The command refuses the scene.
    """
    if options.torch and importlib.util.find_spec("torch") is None:
        raise UsageError("--torch: Torch is not installed; `pip install torch`, or compare with NumPy alone")
    # The loader takes scenes for valid, and drops some keys that it does not know. The command names the place.
    check_scene(find_binary(options.binary), options.scene)


def trace_all(options: argparse.Namespace) -> list[Side]:
    """Trace with every backend; the first side is ours, the second the reference.

    Raises:
        NsqGpuError: One of its subclasses, by what went wrong.
    """
    def load() -> NSQScene:
        try:
            return load_scene(options.scene)
        except (ImportError, OSError, ValueError) as error:
            raise SceneError(f"{options.scene}: it cannot be built in Python: {error}") from error

    _check(options)
    be.set_backend("numpy")
    be.set_precision("float64")
    ours = NsqGpuBackend(precision=options.precision, adapter=options.adapter, binary=options.binary)
    run = options.num_rays, options.seed, options.max_depth
    sides = [trace_side("nsq-gpu", load, ours, *run)]
    assert ours.report is not None
    sides[0].name = f"nsq-gpu {ours.report['precision']}"
    sides.append(trace_side("NumPy", load, NumpyBackend(), *run))
    return [*sides, _torch_side(load, options)] if options.torch else sides


def _torch_side(load: Callable[[], NSQScene], options: argparse.Namespace) -> Side:
    # Gigabytes to install, so only where it is asked for.
    from optiland.nonsequential.backends.torch_backend import TorchBackend

    be.set_backend("torch")
    # Torch's default of float32 gives wrong results without a word.
    be.set_precision("float64")
    try:
        return trace_side("Torch", load, TorchBackend(), options.num_rays, options.seed, options.max_depth)
    finally:
        be.set_backend("numpy")


def main(arguments: list[str]) -> int:
    """Compare, print, and return the exit code."""
    options = parse(arguments)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            sides = trace_all(options)
    except NsqGpuError as error:
        print(error, file=sys.stderr)
        return error.exit_code or 1
    print(table(sides))
    reference = sides[1]
    agreed = True
    for side in (sides[0], *sides[2:]):
        text, agrees = verdict(side, reference, options.statistical)
        print(f"\n{text}")
        agreed = agreed and agrees
    return 0 if agreed else DISAGREE


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
