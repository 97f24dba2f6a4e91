"""Measures error against time of every tier, sampler and setting, the error of arithmetic, and what Sobol points are worth.

It traces in a session of ``nsq-gpu serve``, as users of Python do, and asks Optiland for the same maps. Only the worth of
Sobol points can fail: exit code 6 where a claim does not hold. ``draw.py`` draws what it writes::

    python benches/accuracy.py --binary target/release/nsq-gpu --against optiland -o accuracy-out
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "python"), str(ROOT / "benches")]

import draw  # noqa: E402
from nsq_gpu.errors import NsqGpuError, UsageError  # noqa: E402
from nsq_gpu.session import Answer, Session  # noqa: E402

Json = dict[str, Any]

#: The precisions, from the coarsest to the finest.
PRECISIONS = ("f32", "df64", "f64")
#: Rays of a curve's first point, and of a peer's, which is slower. Each further point has ``STEP`` times as many.
FIRST_RAYS, FIRST_PEER_RAYS, STEP = 1 << 12, 1 << 10, 4
#: Traces of a group, whose spread estimates a variance. Each has a seed of its own, so that scrambles are independent.
GROUP = 8
#: First seeds of the answer and of the claims: no two kinds of traces share a draw.
ANSWER_SEED, PCG_SEED, SOBOL_SEED = 1 << 32, 1 << 37, 1 << 38
#: The least relative error. A smaller one is the sums' own, whose squares are rounded to 2^-52 a ray.
LEAST_ERROR = 1e-9
#: The confidence of a ratio's bounds.
CONFIDENCE = 0.99
SPLIT = {"split_depth": 6, "split_budget": 7.0}
TOLERANCE_MISSED = 6


@dataclass(frozen=True)
class Effort:
    """How much is measured: traces of a point, the time after which a curve and the answer end [s], most rays, rays whose
    paths are compared."""

    seeds: int
    seconds: float
    answer_seconds: float
    most_rays: int

    @property
    def paths(self) -> int:
        return min(1 << 14, self.most_rays // 4)


FULL = Effort(4, 1.0, 6.0, 1 << 22)
QUICK = Effort(2, 0.1, 0.2, 1 << 14)


@dataclass(frozen=True)
class Scene:
    """A scene and one of its detectors."""

    name: str
    detector: str
    max_depth: int = 16

    def document(self) -> Json:
        """The scene file."""
        return LAMP_FILE if self.name == "lamp" else json.loads((ROOT / "scenes" / f"{self.name}.json").read_text())

    def plain(self) -> Json:
        """The scene as it is measured: each ray lands in one pixel, with Optiland's default policy."""
        document = with_splat(self.document(), splat="hard")
        extra = {key: value for key, value in document.get("nsq_gpu", {"version": 1}).items() if key != "sampling"}
        return document | {"nsq_gpu": extra}


#: A disk shines through a stop onto a map: four dimensions.
LAMP_FILE: Json = {
    "nsq_schema_version": 1,
    "components": [],
    "sources": [{"type": "extended", "name": "S", "cs": {"z": 0.0}, "total_flux": 1.0, "aperture_radius": 5.0,
                 "half_angle_deg": 30.0, "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}],
    "detectors": [{"type": "irradiance", "name": "D", "cs": {"z": 20.0}, "width": 30.0, "height": 30.0,
                   "num_pixels_x": 32, "num_pixels_y": 32, "absorb": True}],
    "nsq_gpu": {"version": 1, "surfaces": [{"name": "stop", "cs": {"z": 10.0}, "interaction": "absorbing",
                                            "shape": {"type": "annulus", "inner_radius": 6.0, "outer_radius": 100.0}}]},
}

#: The scenes of the charts.
SCENES = (
    Scene("bench_lens", "D"),
    Scene("cooke_triplet", "image"),
    Scene("heliar_ghosts", "back"),
    Scene("light_pipe", "exit_map"),
    Scene("integrating_sphere", "port", 64),
    Scene("scattering_telescope", "focus"),
)


@dataclass(frozen=True)
class Claim:
    """A claim about Sobol points in a scene: how many random numbers each is worth at least."""

    scene: Scene
    num_rays: int
    #: Traces with random numbers, and with Sobol points: whole groups.
    traces: tuple[int, int]
    least: float | None
    #: What the scene's sampling is changed to.
    split: tuple[int, float] | None = None

    def quick(self) -> Claim:
        """The claim with few rays and traces, which is not judged."""
        return replace(self, num_rays=min(self.num_rays, 1 << 10), traces=(6 * GROUP, 6 * GROUP), least=None)

    def document(self) -> Json:
        document = self.scene.document()
        return with_sampling(document, reflect_prob="fresnel", split_depth=self.split[0], split_budget=self.split[1]) \
            if self.split else document


def _claim(name: str, detector: str, num_rays: int, pcg: int, sobol: int, least: float = 10.0, **more: Any) -> Claim:
    return Claim(Scene(name, detector), num_rays, (pcg, sobol), least, **more)


def _not_worse(name: str, detector: str, pcg: int = 512, sobol: int = 512) -> Claim:
    return _claim(name, detector, 1 << 13, pcg, sobol, 0.95)


#: All claims. The first scenes have few dimensions. In some, only the source draws, because rays decide nothing after their
#: birth; in a singlet two reflections are added. Then come lenses whose rays are split.
#:
#: All other scenes of the repository follow, so that no scene is chosen by its result. The exception is
#: ``coated_projector``, whose scattering is in a file of its own. Each scene is judged by its first detector with cells.
#: With enough rays, a lamp's map has the ratio of few dimensions: its pixels see all four.
#:
#: A pilot with its own seeds estimated the ratios. From it follows the number of traces that decides a claim, with three
#: standard errors to spare. Closer claims need more traces.
CLAIMS = (
    _claim("bench_surface_count_50", "D", 1 << 13, 128, 128),
    _claim("bench_cavity", "D", 1 << 13, 128, 128),
    _claim("newtonian_telescope", "camera", 1 << 14, 128, 128),
    _claim("hubble_nasmyth", "camera", 1 << 14, 128, 128),
    _claim("lamp", "D", 1 << 22, 40, 64),
    _claim("bench_lens", "D", 1 << 14, 128, 128),
    _claim("bench_lens", "D", 1 << 12, 64, 64, split=(4, 5.0)),
    _claim("cooke_triplet", "image", 1 << 16, 40, 40, split=(6, 7.0)),
    _claim("lamp", "D", 1 << 14, 64, 64, 0.95),
    _claim("lambertian_sphere", "port", 1000, 512, 8192, 0.95),
    _not_worse("aspheric_collimator", "collimated"),
    _not_worse("ball_lens_ghosts", "near"),
    _not_worse("cemented_achromat_auto", "beside"),
    _not_worse("cooke_triplet", "image"),
    _not_worse("double_gauss", "image"),
    _not_worse("erfle_eyepiece", "exit_pupil"),
    _not_worse("filter_stack", "behind"),
    _not_worse("heliar_ghosts", "image", sobol=2048),
    _not_worse("infrared_triplet_ghosts", "image"),
    _not_worse("integrating_sphere", "port"),
    _not_worse("kaleidoscope", "eye"),
    _not_worse("lambertian_sphere", "port", sobol=16384),
    _not_worse("light_pipe", "exit_map"),
    _not_worse("mangin_catadioptric", "focus"),
    _not_worse("mesh_lens", "focus", 128, 128),
    _not_worse("mesh_prism", "image", 256, 256),
    _not_worse("mirror_ball_billiard", "slot", sobol=2048),
    _not_worse("nested_media", "front"),
    _not_worse("opal_lamp", "down", sobol=2048),
    _not_worse("petzval_projector", "screen"),
    _not_worse("prism_spectrometer", "spectrum"),
    _not_worse("reverse_telephoto_wide", "image", sobol=1024),
    _not_worse("scattering_telescope", "focus"),
    _not_worse("searchlight", "beam"),
    _not_worse("split_ghosts", "image", 128, 128),
    _not_worse("stacked_plates_ghosts", "through", sobol=2048),
    _not_worse("tapered_light_guide", "plane"),
    _not_worse("telephoto_spectral", "image"),
    _not_worse("telescope_doublet_finder", "field_stop"),
    _not_worse("tessar_gaussian_beams", "image"),
    _not_worse("triplet_telescope_ghosts", "image", sobol=1024),
)


def with_sampling(document: Json, **settings: Any) -> Json:
    """The scene with these settings of its sampling."""
    extra = document.get("nsq_gpu", {"version": 1})
    return document | {"nsq_gpu": extra | {"sampling": extra.get("sampling", {}) | settings}}


def with_splat(document: Json, **splat: Any) -> Json:
    """The scene with this splat on all maps."""
    def changed(detector: Json) -> Json:
        rest = {key: value for key, value in detector.items() if not key.startswith("splat")}
        return rest | splat if detector["type"] == "irradiance" else detector

    return document | {"detectors": [changed(detector) for detector in document["detectors"]]}


class Tracer:
    """Sessions of the program, by whether numbers lie in a table and whether arithmetic is strict."""

    def __init__(self, binary: str | None, adapter: str | None) -> None:
        self._open: dict[tuple[bool, bool], Session] = {}
        self._where = {"binary": binary, "adapter": adapter}

    def trace(self, document: Json, num_rays: int, *, live: bool = True, strict: bool = True, **options: Any) -> Answer:
        """Trace a scene file's document."""
        key = (live, strict)
        if key not in self._open:
            self._open[key] = Session(live=live, strict=strict, **self._where)
        options = {"num_rays": num_rays, "standard_error": "off", "max_depth": 16} | options
        return self._open[key].request(json.dumps(document), options, folder=str(ROOT / "scenes"))

    def precisions(self, wanted: str) -> list[str]:
        """Those that are wanted and that the adapter has."""
        def can(precision: str) -> bool:
            try:
                self.trace(LAMP_FILE, 1, precision=precision)
            except NsqGpuError:
                return False
            return True

        names = {"all": PRECISIONS, "both": ("f32", "f64")}.get(wanted, (wanted,))
        return list(names) if len(names) == 1 else [precision for precision in names if can(precision)]

    def hello(self) -> Json:
        return next(iter(self._open.values())).hello()

    def close(self) -> None:
        for session in self._open.values():
            session.close()


@dataclass(frozen=True)
class Estimate:
    """A detector's cells and their sum, as shares of the launched flux."""

    cells: np.ndarray
    total: float

    @classmethod
    def of(cls, answer: Answer, name: str) -> Estimate:
        """The estimate of a detector in an answer."""
        head, arrays = answer.report["detectors"][name], answer.arrays(name)
        if head["kind"] == "far_field":
            theta, phi = np.radians(arrays["theta"]), np.radians(arrays["phi"])
            # As Optiland has it: the solid angle by the middle of a bin.
            flux = arrays["intensity"] * np.sin(theta)[:, None] * (theta[1] - theta[0]) * (phi[1] - phi[0])
        else:
            flux = arrays["irradiance"] * (head["width"] * head["height"] / math.prod(arrays["irradiance"].shape[:2]))
        launched = answer.report["total_flux_in"]
        return cls(flux.ravel() / launched, head["total_flux"] / launched)

    def errors(self, answer: Estimate) -> np.ndarray:
        """The error of the map, as RMS over the cells in units of their mean, and of the flux, in units of the flux."""
        cells = np.sqrt(np.sum((self.cells - answer.cells) ** 2) * len(self.cells))
        return np.array([cells, abs(self.total - answer.total)]) / answer.total


def mean_of(estimates: list[Estimate]) -> Estimate:
    """The mean of some estimates of one detector."""
    return Estimate(np.mean([one.cells for one in estimates], 0), float(np.mean([one.total for one in estimates])))


# 1 and 2. Error against time.

#: Traces this many rays with this seed: the time [s], and the estimate.
Trace = Callable[[int, int], tuple[float, Estimate]]


def is_refractive(tracer: Tracer, document: Json) -> bool:
    """True if there is a choice between reflection and refraction."""
    return any(surface["kind"] == "refractive" for surface in tracer.trace(document, 1).report["surfaces"])


def methods(plain: Json, refractive: bool, precisions: list[str]) -> Iterator[tuple[str, Json, Json]]:
    """The ways to trace a scene: a name, the scene, options. The settings are measured in the last precision."""
    last = {"precision": precisions[-1]}
    sobol = last | {"sampler": "sobol"}
    for precision in precisions:
        yield precision, plain, {"precision": precision}
    yield "sobol", plain, sobol
    if refractive:
        split, name = with_sampling(plain, **SPLIT), f"split_depth {SPLIT['split_depth']}"
        yield "reflect_prob auto", with_sampling(plain, reflect_prob="auto"), last
        yield name, split, last
        yield f"{name}, sobol", split, sobol
    yield "rr_start_flux 0.5", with_sampling(plain, rr_start_flux=0.5), last
    yield "bilinear splat", with_splat(plain, splat="bilinear"), last
    yield "gaussian splat", with_splat(plain, splat="gaussian", splat_sigma=1.0), last


def points(trace: Trace, answer: Estimate, effort: Effort, is_peer: bool = False) -> list[Json]:
    """The points of a curve, with ``STEP`` times as many rays each, until one would take longer than the effort allows.

    The first seed decides how far all go. A peer is slower: it begins with fewer rays, and may be traced once alone.
    """
    num_rays, factor = (FIRST_PEER_RAYS, 2) if is_peer else (FIRST_RAYS, STEP)
    is_slow = trace(num_rays, 0)[0] > effort.seconds and is_peer
    seconds, found = 0.0, []
    while num_rays <= effort.most_rays and factor * seconds <= effort.seconds:
        times, estimates = zip(*(trace(num_rays, seed) for seed in range(1 if is_slow else effort.seeds)), strict=True)
        map_error, flux_error = np.sqrt(np.mean([one.errors(answer) ** 2 for one in estimates], 0))
        found.append({"num_rays": num_rays, "median_seconds": float(np.median(times)), "min_seconds": min(times),
                      "max_seconds": max(times), "map_rms_error": float(map_error), "flux_error": float(flux_error)})
        num_rays, seconds = STEP * num_rays, times[0]
    return found


def converged(trace: Trace, effort: Effort) -> tuple[Estimate, np.ndarray]:
    """The answer, of two long traces, and its own errors: half of their difference."""
    num_rays, seconds = FIRST_RAYS, trace(FIRST_RAYS, ANSWER_SEED)[0]
    while STEP * num_rays <= 16 * effort.most_rays and STEP * seconds <= effort.answer_seconds:
        num_rays *= STEP
        seconds = trace(num_rays, ANSWER_SEED)[0]
    both = [trace(num_rays, ANSWER_SEED + seed)[1] for seed in (0, 1)]
    return mean_of(both), 0.5 * both[0].errors(both[1])


def curves(tracer: Tracer, scene: Scene, precisions: list[str], peers: list[Peer], effort: Effort) -> Iterator[Json]:
    """The rows of ``accuracy.csv`` about a scene."""
    plain = scene.plain()
    refractive = is_refractive(tracer, plain)

    def tracing(document: Json, options: Json) -> Trace:
        def trace(num_rays: int, seed: int) -> tuple[float, Estimate]:
            answer = tracer.trace(document, num_rays, seed=seed, max_depth=scene.max_depth, **options)
            return answer.report["trace_time_sec"], Estimate.of(answer, scene.detector)

        return trace

    best = with_sampling(plain, **SPLIT) if refractive else plain
    answer, (map_floor, flux_floor) = converged(tracing(best, {"precision": precisions[-1], "sampler": "sobol"}), effort)
    found = [("nsq-gpu", name, points(tracing(*how), answer, effort)) for name, *how in methods(plain, refractive, precisions)]
    found += [(peer.name, "f64", points(peer.tracing(plain, scene), answer, effort, is_peer=True)) for peer in peers]
    for engine, method, row in ((engine, method, row) for engine, method, rows in found for row in rows):
        yield {"scene": scene.name, "detector": scene.detector, "engine": engine, "method": method, **row,
               "answer_map_error": float(map_floor), "answer_flux_error": float(flux_floor)}


class Peer:
    """Optiland's NumPy or Torch backend, in a process of its own."""

    def __init__(self, backend: str, folder: Path) -> None:
        self.name = f"optiland {backend}"
        self._scene = folder / f"{backend}.json"
        script = [sys.executable, str(ROOT / "python" / "tools" / "bench_peer.py"), backend]
        self._child = subprocess.Popen(script, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.versions = self._answer()

    def _answer(self) -> Json:
        line = self._child.stdout.readline()
        if not line:
            raise UsageError(f"{self.name} gave no answer; is Optiland installed in {sys.executable}?")
        return json.loads(line)

    def tracing(self, document: Json, scene: Scene) -> Trace:
        self._scene.write_text(json.dumps(document))

        def trace(num_rays: int, seed: int) -> tuple[float, Estimate]:
            request = {"scene": str(self._scene), "num_rays": num_rays, "max_depth": scene.max_depth, "seed": seed,
                       "map": scene.detector}
            self._child.stdin.write(json.dumps(request) + "\n")
            self._child.stdin.flush()
            answer = self._answer()
            cells = np.array(answer["map"])
            return answer["seconds"], Estimate(cells, float(cells.sum()))

        return trace

    def close(self) -> None:
        self._child.stdin.close()
        self._child.wait()


# 3. The error of arithmetic alone.

Paths = dict[str, np.ndarray]


def paths_of(tracer: Tracer, scene: Scene, precision: str, num_rays: int, **form: Any) -> Paths:
    """Recorded paths, by ray and event."""
    answer = tracer.trace(scene.plain(), num_rays, precision=precision, max_depth=scene.max_depth, record_paths="all", **form)
    return answer.arrays(None)


def compare(found: Paths, truth: Paths, detector: str) -> Json:
    """Differences at a detector of rays that meet the same surfaces and end in the same way, and the share of the others."""
    def fates(paths: Paths) -> dict[int, tuple[slice, bytes]]:
        ids, starts = np.unique(paths["ray_id"], return_index=True)
        kinds = np.char.add(paths["event_type"], np.char.add(" ", paths["component_name"])).astype("U64")
        ends = [*starts[1:], len(kinds)]
        return {ray: (slice(a, b), kinds[a:b].tobytes()) for ray, a, b in zip(ids.tolist(), starts, ends, strict=True)}

    ours, theirs = fates(found), fates(truth)
    same = [ray for ray in theirs if ray in ours and ours[ray][1] == theirs[ray][1]]
    at = [np.concatenate([np.r_[side[ray][0]] for ray in same] or [np.zeros(0, int)]) for side in (ours, theirs)]
    arrived = (found["component_name"][at[0]] == detector) & (found["event_type"][at[0]] != "birth")
    a, b = at[0][arrived], at[1][arrived]
    position = np.sqrt(sum((found[axis][a] - truth[axis][b]) ** 2 for axis in "xyz"))
    with np.errstate(divide="ignore", invalid="ignore"):
        # A ray that is scattered to nowhere weighs nothing.
        flux = np.where(found["flux"][a] == truth["flux"][b], 0.0, np.abs(found["flux"][a] / truth["flux"][b] - 1))

    def of(values: np.ndarray) -> tuple[float, float]:
        return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0, float(max(values, default=0.0))

    (position_rms, position_max), (flux_rms, flux_max) = of(position), of(flux)
    return {"num_arrivals": len(a), "position_rms_mm": position_rms, "position_max_mm": position_max, "flux_rms": flux_rms,
            "flux_max": flux_max, "share_of_other_fate": 1 - len(same) / len(theirs)}


def numerical(tracer: Tracer, scene: Scene, precisions: list[str], num_rays: int) -> Iterator[Json]:
    """The rows of ``numerical.csv`` about a scene.

    Every tier is compared with the finest. The finest is also compared with itself, to show its own rounding: with numbers
    in a table and arithmetic that is not strict.
    """
    finest = precisions[-1]
    truth = paths_of(tracer, scene, finest, num_rays, live=False)
    forms = [(precision, False, True, "compiled in") for precision in precisions[:-1]] + [(finest, True, False, "in tables")]
    for precision, live, strict, name in forms:
        options = {"precision": precision, "max_depth": scene.max_depth}
        seconds = [tracer.trace(scene.plain(), 16 * num_rays, **options).report["trace_time_sec"] for _ in range(2)][1]
        found = paths_of(tracer, scene, precision, num_rays, live=live, strict=strict)
        yield {"scene": scene.name, "shader": f"{precision} {name}", "against": f"{finest} compiled in", "num_rays": num_rays,
               "ns_per_ray": 1e9 * seconds / (16 * num_rays), **compare(found, truth, scene.detector)}


# 4. What Sobol points are worth.


@dataclass(frozen=True)
class Ratio:
    """A ratio, and its bounds with a confidence of 99 % each."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Variances:
    """Estimates of a variance without bias, one a group of traces, and the mean share of the flux that is detected."""

    of_groups: np.ndarray
    flux: float

    @property
    def relative_error(self) -> float:
        """The standard deviation, in units of the mean cell or of the flux."""
        return float(np.sqrt(self.of_groups.mean()) / self.flux)

    @property
    def spread(self) -> float:
        """Square of the relative standard error of the mean over groups."""
        return float(np.var(self.of_groups, ddof=1) / len(self.of_groups) / np.mean(self.of_groups) ** 2)

    def ratio_to(self, other: Variances) -> Ratio | None:
        """The ratio of this variance to another; None if neither has an error.

        Its bounds are quantiles of the F distribution. The spreads of the estimates give the degrees of freedom n:
        chi-squared over n has a relative variance of 2/n. Heavier tails have a larger spread, and so a smaller n. Each
        spread is itself of few groups: the normal deviate of the quantile is Student's, with the degrees of freedom of a
        sum of spreads (Welch, Biometrika 34, 1947).
        """
        if max(self.relative_error, other.relative_error) < LEAST_ERROR:
            return None
        value = float(self.of_groups.mean() / other.of_groups.mean())
        if value == 0.0:
            return Ratio(0.0, 0.0, 0.0)
        a, b = (max(one.spread, 1e-9) for one in (self, other))
        freedom = (a + b) ** 2 / (a**2 / (len(self.of_groups) - 1) + b**2 / (len(other.of_groups) - 1))
        share = special.ndtr(special.stdtrit(freedom, CONFIDENCE))
        return Ratio(value, value / special.fdtri(2 / a, 2 / b, share), value * special.fdtri(2 / b, 2 / a, share))


def variances(traces: Iterator[tuple[Estimate, float | None]]) -> tuple[Variances, Variances]:
    """Variances of the map and of the flux between traces.

    The variance of the flux is the mean of those that come with the traces: rays are independent where their draws are
    random, so that each trace determines it.
    """
    groups = []
    for group in zip(*[traces] * GROUP, strict=True):
        estimates, by_rays = zip(*group, strict=True)
        middle = mean_of(list(estimates))
        squares = np.array([(one.errors(middle) * middle.total) ** 2 for one in estimates]).sum(0) / (GROUP - 1)
        groups.append((squares[0], squares[1] if by_rays[0] is None else np.mean(by_rays), middle.total))
    of_map, of_flux, flux = np.array(groups).T
    return Variances(of_map, flux.mean()), Variances(of_flux, flux.mean())


def judge(tracer: Tracer, claim: Claim, precision: str) -> Json:
    """The row of ``sobol.csv`` about a claim."""
    document = claim.document()

    def traces(sampler: str, first_seed: int, count: int) -> Iterator[tuple[Estimate, float | None]]:
        is_random = sampler == "pcg"
        options = {"sampler": sampler, "precision": precision, "max_depth": claim.scene.max_depth,
                   "standard_error": "on" if is_random else "off"}
        for seed in range(first_seed, first_seed + count):
            answer = tracer.trace(document, claim.num_rays, seed=seed, **options)
            head = answer.report["detectors"][claim.scene.detector]
            by_rays = (head["total_flux_standard_error"] / answer.report["total_flux_in"]) ** 2 if is_random else None
            yield Estimate.of(answer, claim.scene.detector), by_rays

    pcg = variances(traces("pcg", PCG_SEED, claim.traces[0]))
    sobol = variances(traces("sobol", SOBOL_SEED, claim.traces[1]))
    row = {"scene": claim.scene.name, "detector": claim.scene.detector, "split_depth": claim.split[0] if claim.split else 0,
           "num_rays": claim.num_rays, "pcg_traces": claim.traces[0], "sobol_traces": claim.traces[1],
           "map_pcg_error": pcg[0].relative_error}
    for what, ours, theirs in zip(("map", "flux"), pcg, sobol, strict=True):
        ratio = ours.ratio_to(theirs)
        row |= {f"{what}_ratio": ratio and ratio.value, f"{what}_ratio_low": ratio and ratio.low,
                f"{what}_ratio_high": ratio and ratio.high, f"{what}_least": claim.least}
    return row


def holds(row: Json) -> bool:
    """True if the ratios are at least the claimed ones, with confidence. Nothing is claimed of what makes no error."""
    return all(row[f"{what}_least"] is None or row[f"{what}_ratio"] is None or row[f"{what}_ratio_low"] >= row[f"{what}_least"]
               for what in ("map", "flux"))


# What is written.

CURVES = ("scene", "detector", "engine", "method", "num_rays", "median_seconds", "min_seconds", "max_seconds",
          "map_rms_error", "flux_error", "answer_map_error", "answer_flux_error")
NUMERICAL = ("scene", "shader", "against", "num_rays", "ns_per_ray", "num_arrivals", "position_rms_mm", "position_max_mm",
             "flux_rms", "flux_max", "share_of_other_fate")
SOBOL = ("scene", "detector", "split_depth", "num_rays", "pcg_traces", "sobol_traces", "map_pcg_error",
         *(f"{what}_{part}" for what in ("map", "flux") for part in ("ratio", "ratio_low", "ratio_high", "least")))
#: The files of -o.
FILES = ("accuracy.txt", "accuracy.csv", "numerical.csv", "sobol.csv", *draw.OF_ACCURACY)


def csv_text(columns: tuple[str, ...], rows: list[Json]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: f"{value:.6g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
    return text.getvalue()


def claim_line(row: Json) -> str:
    def shown(what: str) -> str:
        value, low, high, least = (row[f"{what}_{part}"] for part in ("ratio", "ratio_low", "ratio_high", "least"))
        mark = "!" if least is not None and value is not None and not low >= least else " "
        ratio = "no error" if value is None else f"{value:.3f} ({low:.3f} to {high:.3f})"
        return f"{ratio:>30}{'-' if least is None else f'{least:g}':>6}{mark}"

    return (f"{row['scene']:<26}{row['split_depth'] or '-':<8}{row['num_rays']:>9}{row['sobol_traces']:>8}"
            f"{shown('map')}{shown('flux')}")


def table(head: str, of_curves: list[Json], of_numbers: list[Json], of_claims: list[Json]) -> str:
    """The tables for people."""
    lines = [head]
    if of_curves:
        lines += ["", "Error and time with the most rays of each method",
                  f"{'scene':<22}{'engine':<16}{'method':<22}{'rays':>10}{'time':>12}{'map':>12}{'flux':>12}"]
        last = {(row["scene"], row["engine"], row["method"]): row for row in of_curves}
        lines += [f"{scene:<22}{engine:<16}{method:<22}{row['num_rays']:>10}{row['median_seconds']:>10.3f} s"
                  f"{100 * row['map_rms_error']:>10.3f} %{100 * row['flux_error']:>10.4f} %"
                  for (scene, engine, method), row in last.items()]
    if of_numbers:
        lines += ["", "Arithmetic alone: the same draws along the same paths",
                  f"{'scene':<22}{'shader':<17}{'against':<17}{'ns/ray':>9}{'position rms':>14}{'greatest':>14}{'flux rms':>12}"
                  f"{'other fate':>12}"]
        lines += [f"{row['scene']:<22}{row['shader']:<17}{row['against']:<17}{row['ns_per_ray']:>9.1f}"
                  f"{row['position_rms_mm']:>11.1e} mm{row['position_max_mm']:>11.1e} mm{row['flux_rms']:>12.1e}"
                  f"{row['share_of_other_fate']:>12.1e}" for row in of_numbers]
    if of_claims:
        lines += ["", "Random numbers that a Sobol point is worth, between its bounds at 99 %",
                  f"{'scene':<26}{'split':<8}{'rays':>9}{'traces':>8}{'by the map':>30}{'least':>6} {'by the flux':>30}{'least':>6}"]
        lines += [claim_line(row) for row in of_claims]
    return "\n".join(lines) + "\n"


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--binary", help="the program; by default the one of the package nsq_gpu")
    parser.add_argument("--adapter", help="a part of the adapter's name")
    parser.add_argument("--quick", action="store_true", help="few rays and traces: claims are shown but not judged")
    parser.add_argument("--claims", action="store_true", help="only what Sobol points are worth")
    parser.add_argument("--scenes", type=lambda text: text.split(","), default=[], metavar="NAMES")
    parser.add_argument("--precision", choices=(*PRECISIONS, "both", "all"), default="all")
    parser.add_argument("--against", choices=("optiland",), help="compare with its NumPy backend, and with Torch where installed")
    parser.add_argument("--note", help="for readers of the files, such as who else uses the machine")
    parser.add_argument("-o", "--output", type=Path, metavar="DIR", help="write tables and charts here")
    parser.add_argument("--overwrite", action="store_true", help="let -o replace files that exist")
    options = parser.parse_args(arguments)
    names = sorted({scene.name for scene in SCENES} | {claim.scene.name for claim in CLAIMS})
    for unknown in sorted(set(options.scenes) - set(names)):
        parser.error(f"no scene is named `{unknown}`; there are {', '.join(names)}")
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        there = [name for name in FILES if (options.output / name).exists()]
        if there and not options.overwrite:
            parser.error(f"{options.output / there[0]} exists; --overwrite replaces it, or give another folder")
    return options


def peers_of(options: argparse.Namespace, folder: Path) -> list[Peer]:
    """Optiland's NumPy backend, and its Torch backend where it is installed."""
    if not options.against:
        return []
    numpy = Peer("numpy", folder)
    return [numpy, Peer("torch", folder)] if "torch" in numpy.versions else [numpy]


def main(arguments: list[str] | None = None) -> int:
    options = parsed(arguments)
    effort = QUICK if options.quick else FULL
    chosen: Callable[[Scene], bool] = lambda scene: not options.scenes or scene.name in options.scenes  # noqa: E731
    tracer = Tracer(options.binary, options.adapter)
    say = lambda text: print(text, file=sys.stderr, flush=True)  # noqa: E731
    with tempfile.TemporaryDirectory() as folder:
        peers = peers_of(options, Path(folder))
        try:
            precisions = tracer.precisions(options.precision)
            of_curves, of_numbers, of_claims = [], [], []
            for scene in filter(chosen, () if options.claims else SCENES):
                say(f"{scene.name}: error against time")
                of_curves += curves(tracer, scene, precisions, peers, effort)
                of_numbers += numerical(tracer, scene, precisions, effort.paths)
            for claim in (claim for claim in CLAIMS if chosen(claim.scene)):
                of_claims.append(judge(tracer, claim.quick() if options.quick else claim, precisions[-1]))
                say(claim_line(of_claims[-1]))
            hello = tracer.hello() if of_curves or of_claims else {}
        finally:
            for each in (*peers, tracer):
                each.close()
    day = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    head = f"nsq-gpu {hello.get('version')} on {hello.get('adapter')}, {day}"
    text = table(head, of_curves, of_numbers, of_claims)
    print(text, end="")
    if options.output:
        files = {"accuracy.txt": text}
        for name, columns, rows in (("accuracy.csv", CURVES, of_curves), ("numerical.csv", NUMERICAL, of_numbers),
                                    ("sobol.csv", SOBOL, of_claims)):
            files |= {name: csv_text(columns, rows)} if rows else {}
        for name, contents in files.items():
            (options.output / name).write_text(contents)
        pictures = draw.folder(options.output, f"{head}{f'; {options.note}' if options.note else ''}")
        say("\n".join(f"written: {options.output / name}" for name in (*files, *pictures)))
    faults = [claim_line(row) for row in of_claims if not holds(row)]
    if faults and not options.quick:
        say("less than is claimed:\n" + "\n".join(faults))
        return TOLERANCE_MISSED
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except NsqGpuError as error:
        print(f"accuracy.py: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
