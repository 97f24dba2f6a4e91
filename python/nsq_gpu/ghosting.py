"""``ghosts``: traces each field of a lens, and collects its ghosts."""

from __future__ import annotations

import dataclasses
import os
import tempfile
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.optic import Optic

from nsq_gpu.arguments import near, wrong_kind
from nsq_gpu.binary import find_binary
from nsq_gpu.convert import from_optic
from nsq_gpu.convert.fields import field_unit, sources_of
from nsq_gpu.errors import SceneError, TraceTimeoutError, UsageError, with_partial
from nsq_gpu.export import ExportedScene, export, to_json
from nsq_gpu.export.values import whole_number
from nsq_gpu.frames import number_of
from nsq_gpu.ghost_table import Field, Ghosts, GhostsOfField
from nsq_gpu.integrity import load_arrays, read_report
from nsq_gpu.loading import load_scene
from nsq_gpu.process import run, seconds
from nsq_gpu.progress import Counter, Progress, Shown
from nsq_gpu.results import warn_of
from nsq_gpu.scene_file import scene_from_dict
from nsq_gpu.session import EXPORTED

Json = dict[str, Any]

GROUPS = ("faces", "sequence")
#: What is worse, and the key of a row that says how bad.
SORTS = {"flux": "flux", "peak": "peak_irradiance"}
#: Most ghosts of a field that have a column in the montage. The program writes the maps of fifty rows, others among them.
MOST_TOP = 20
#: Rays of fewer events are split. A ray has so many events for each face; a ghost of the first face and the last takes three.
_SPLITS, _EVENTS = 12, 4
#: Pixels of an Optic's detector.
_PIXELS = (128, 128)


def ghosts(optic_or_scene: Optic | NSQScene | Mapping[str, Any] | str | os.PathLike[str], fields: Sequence[Any] | None = None,
           top: int = 5, *, num_rays: int = 100_000, seed: int = 0, detector: str | None = None, group: str = "faces",
           sort: str = "flux", min_reflections: int = 2, split_depth: int | None = None, guide: bool = True,
           max_depth: int | None = None, precision: str = "auto", adapter: str | None = None,
           binary: str | os.PathLike[str] | None = None, timeout: float | None = None, progress: Progress = None) -> Ghosts:
    """Find the ghosts of a lens in each field: which faces make them, how bright they are, and what they look like.

    A ghost is light that was reflected at least twice, once or more by a face that refracts, and that was not scattered.
    The light of an Optic's field fills the entrance pupil, and no more. Its detector has 128 x 128 pixels; for another one
    make the scene by :func:`nsq_gpu.from_optic`, and name its sources as fields.

    >>> found = nsq_gpu.ghosts(CookeTriplet(), fields=[0, 7, 14, 20])
    >>> found.worst
    >>> found.plot()

    Args:
        optic_or_scene: Optiland's Optic; or a scene, its dictionary, or the path of its file.
        fields: Of an Optic, field angles along y [deg], or pairs (x, y); heights [mm] where its own fields are heights. The
            lens and its detector stay made for its own fields, which None takes. Of a scene, names of sources, each of
            which is traced alone; None traces all of them at once.
        top: So many ghosts of each field are its worst, and have maps; 1 to 20.
        num_rays: Rays of each field.
        seed: Seed of the draws, the same for all fields.
        detector: Name of an irradiance detector; it may be left out where there is one alone.
        group: ``"faces"``: light that the same faces reflect, in the same order, is one ghost. ``"sequence"``: light
            that also passes the same faces is.
        sort: What is worse: ``"flux"``, or ``"peak"``, the brightest pixel, which needs more rays to be known.
        min_reflections: Fewest reflections of a ghost. Reflections by mirrors and total ones count: give 4 where light
            of the image has two.
        split_depth: Rays of fewer events follow both branches at each face. None takes 12, unless rays are guided, or the
            scene has a sampling policy of its own.
        guide: True guides rays towards ghosts, which pays where faces are coated; False splits them, which pays where faces are
            bare. It counts where neither ``split_depth`` nor the scene says how
            it is sampled.
        max_depth: Largest number of events of a ray. None takes 4 for each face that refracts, but at least 16.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        adapter: A part of the adapter's name.
        binary: Path of the program.
        timeout: Longest time of the whole call [s].
        progress: As in :class:`nsq_gpu.NsqGpuBackend`, with the rays of all fields.

    Raises:
        UsageError: An argument makes no sense in this scene, such as a name of no detector; or no face refracts.
        NsqGpuError: One of its other subclasses, by what went wrong.
        Interrupted: Ctrl-C ended the call; ``partial`` has the fields that are done. So it is with TraceTimeoutError.
    """
    top = _checked(top, group, sort, min_reflections)
    rays, program = whole_number("num_rays", num_rays), find_binary(binary)
    lens = _lens(optic_or_scene, fields)
    exported = export(lens.scene)
    refracting = _refracting(lens.scene, exported)
    name = _detector(exported.document["detectors"], detector)
    options = {"num-rays": rays, "seed": whole_number("seed", seed), "precision": precision, "adapter": adapter, "detector": name,
               "group": group, "top": 2 * top, "split-depth": split_depth,
               "max-depth": max(16, _EVENTS * len(refracting)) if max_depth is None else whole_number("max_depth", max_depth)}
    command = [program, "paths", *_arguments(options, guide, lens.scene)]
    found, known = Ghosts(lens.scene, name, lens.unit, top, [], rays), set[str]()

    def trace(field: Field, left: float | None, counted: Counter, mode: str) -> GhostsOfField:
        with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as folder:
            document = _alone(exported.document, field)
            report = _traced([*command, f"--progress={mode}"], document, Path(folder), left, counted)
            warn_of(report, None, known)
            rows = _rows(report, field, refracting, min_reflections, SORTS[sort])
            return _of_field(report, Path(folder) / "out", field, rows, top, name)

    _trace_all(found, lens.fields, trace, timeout, progress)
    return found


def _arguments(options: Mapping[str, Any], guide: bool, scene: NSQScene) -> list[str]:
    """Return options of the command. Where nothing says how the scene is sampled, rays are guided, or else split."""
    is_free = (options["split-depth"] is None and getattr(scene, "sampling_policy", None) in (None, SamplingPolicy())
               and getattr(scene, "scatter_prob", None) is None)
    is_guided = is_free and guide
    named = {**options, "split-depth": _SPLITS} if is_free and not is_guided else options
    return [*(f"--{key}={value}" for key, value in named.items() if value is not None), *["--guide"] * is_guided]


def _trace_all(found: Ghosts, fields: Sequence[Field], trace: Callable[[Field, float | None, Counter, str], GhostsOfField],
               timeout: float | None, progress: Progress) -> None:
    """Trace each field; what ends that early takes the fields that are done along."""
    timeout = seconds(timeout)
    deadline = None if timeout is None else time.monotonic() + timeout
    with Shown(progress) as shown:
        counted = Counter(shown, len(fields) * found.num_rays)
        try:
            for field in fields:
                left = None if deadline is None else max(deadline - time.monotonic(), 0.0)
                found.fields.append(trace(field, left, counted, shown.mode))
                counted.add(found.num_rays)
        except TraceTimeoutError as stop:
            late = TraceTimeoutError(f"the ghosts took longer than timeout = {timeout:g} s and were ended")
            raise with_partial(late, _partial(found)) from stop
        except KeyboardInterrupt as stop:
            raise with_partial(stop, _partial(found))


def _partial(found: Ghosts) -> Ghosts | None:
    return dataclasses.replace(found, partial=True) if found.fields else None


def _checked(top: Any, group: Any, sort: Any, min_reflections: Any) -> int:
    """Refuse arguments that make no sense whatever the scene is; return ``top``."""
    for name, given, right in (("group", group, GROUPS), ("sort", sort, tuple(SORTS))):
        if given not in right:
            raise UsageError(f"{name} is {given!r}; give one of {', '.join(map(repr, right))}")
    if whole_number("min_reflections", min_reflections) < 1:
        raise UsageError(f"min_reflections is {min_reflections!r}; give 1 or more")
    if not 1 <= whole_number("top", top) <= MOST_TOP:
        raise UsageError(f"top is {top!r}; give 1 to {MOST_TOP}")
    return whole_number("top", top)


# What is traced


class _Lens(NamedTuple):
    """A scene with the sources of all fields, these, and the unit of their coordinates."""

    scene: NSQScene
    fields: list[Field]
    unit: str | None


def _lens(given: Any, fields: Any) -> _Lens:
    """Return what an argument stands for."""
    if fields is not None and (isinstance(fields, str | bytes) or not isinstance(fields, Sequence | np.ndarray) or len(fields) == 0):
        raise UsageError(f"fields is {fields!r}; give a list, such as [{fields!r}], or None")
    if isinstance(given, Optic):
        return _lens_of_optic(given, fields)
    if isinstance(given, Mapping):
        scene = scene_from_dict(dict(given))
    elif isinstance(given, str | os.PathLike):
        scene = load_scene(Path(given))
    elif isinstance(given, NSQScene):
        scene = given
    else:
        raise wrong_kind("optic_or_scene", given, "give Optiland's Optic, an NSQScene, its dictionary, or the path of its file")
    return _Lens(scene, [Field("all")] if fields is None else [_source(scene, name) for name in fields], None)


def _source(scene: NSQScene, name: Any) -> Field:
    """Return a source of a scene as a field."""
    if not isinstance(name, str):
        raise UsageError(f"fields has {name!r}, and a scene has sources in the place of angles; give their names, of "
                         f"{', '.join(map(repr, scene.source_names))}, or the Optic itself in the place of the scene")
    if name not in scene.source_names:
        raise UsageError(f"fields has {name!r}, which is no source of the scene; {near(name, scene.source_names)}")
    return Field(name, source=name)


def _lens_of_optic(optic: Optic, fields: Any) -> _Lens:
    """Return the scene of an Optic, whose own fields give it its size, with sources for the fields that are asked for."""
    scene, unit = from_optic(optic, detector_pixels=_PIXELS), field_unit(optic)
    if fields is not None:
        places = [_place(field, unit) for field in fields]
        sources = sources_of(optic, places, scene.sources[0].medium)
        for name in list(scene.source_names):
            scene.remove_source(name)
        for name, source in sources.items():
            scene.source_registry.add(name, source)
    else:
        places = [(number_of(field.x), number_of(field.y)) for field in optic.fields.fields]
    return _Lens(scene, [Field(_label(x, y, unit), x, y, name) for name, (x, y) in zip(scene.source_names, places, strict=True)], unit)


def _place(given: Any, unit: str) -> tuple[float, float]:
    """Return the coordinates of a field as it was asked for."""
    try:
        place = np.asarray(given, dtype=float)
        x, y = (0.0, float(place)) if place.ndim == 0 else map(float, place)
    except (TypeError, ValueError):
        x = y = np.nan
    if not np.isfinite([x, y]).all():
        raise UsageError(f"fields has {given!r}; give a number in {unit}, or a pair of x and y, such as (0, 14)")
    return x, y


def _label(x: float, y: float, unit: str) -> str:
    sign = "\N{DEGREE SIGN}" if unit == "deg" else f" {unit}"
    return f"({x:g}{sign}, {y:g}{sign})" if x else f"{y:g}{sign}"


def _refracting(scene: NSQScene, exported: ExportedScene) -> set[str]:
    """Return the names of faces that refract."""
    found = {label for label, live in zip(exported.surface_labels, scene.surfaces, strict=True) if isinstance(live, RefractiveComponent)}
    if not found:
        raise UsageError("no face of the scene refracts, and without one there are no ghosts; for other stray light trace it by "
                         "NsqGpuBackend(paths=True)")
    return found


def _detector(detectors: Sequence[Json], name: str | None) -> str:
    """Return the name of the detector that is meant."""
    with_map = [entry["name"] for entry in detectors if entry["type"] == "irradiance"]
    if not with_map:
        raise UsageError("the scene has no irradiance detector, on which ghosts have maps; add one")
    if name is None and len(with_map) > 1:
        raise UsageError(f"name the detector, one of {', '.join(map(repr, with_map))}: ghosts(..., detector={with_map[0]!r})")
    if name is not None and name not in with_map:
        raise UsageError(f"detector is {name!r}, which is no irradiance detector of the scene; {near(str(name), with_map)}")
    return with_map[0] if name is None else name


def _alone(document: Json, field: Field) -> Json:
    """Return a scene with the light of one field alone. What moves as one is of no use here, and may name other sources."""
    if field.source is None:
        return document
    block = {key: value for key, value in document.get("nsq_gpu", {}).items() if key != "elements"}
    sources = [source for source in document["sources"] if source["name"] == field.source]
    return document | {"sources": sources, **({"nsq_gpu": block} if "nsq_gpu" in document else {})}


# What is found


def _traced(command: Sequence[str], document: Json, folder: Path, timeout: float | None, counted: Counter) -> Json:
    """Trace into ``folder / "out"``; return the report."""
    file = folder / "scene.json"
    file.write_text(to_json(document, indent=None), encoding="utf-8")
    try:
        run([*command, f"--output={folder / 'out'}", "--no-pictures", str(file)], timeout, counted)
    except SceneError as error:
        # The file is ours, and gone when the message is read.
        raise SceneError(str(error).replace(f"{file}: ", f"{EXPORTED}: "), stderr=error.stderr) from None
    return read_report(folder / "out")


def _rows(report: Json, field: Field, refracting: Collection[str], least: int, key: str) -> list[Json]:
    """Return the ghosts among the rows of a report, the worst first."""
    rows = [_row(row, field) for row in report["paths"] if row["scatterings"] == 0 and row["reflections"] >= least
            and any(letters == "R" and name in refracting for letters, name in row["steps"])]
    rows.sort(key=lambda row: -np.inf if np.isnan(row[key]) else row[key], reverse=True)
    return [row | {"rank": rank} for rank, row in enumerate(rows, 1)]


def _row(row: Json, field: Field) -> Json:
    """Return a row of a report as a row of the table. What is not known is NaN."""
    known = {name: np.nan if row.get(name) is None else float(row[name])
             for name in ("flux", "standard_error", "share", "rms_radius", "peak_irradiance", "rests_on", "upper_bound_95")}
    x, y = row.get("centroid") or (np.nan, np.nan)
    where = row["where"] if field.source is None or row["where"] is None else f'source("{field.source}") and {row["where"]}'
    return {"field": field.label, "field_x": field.x, "field_y": field.y, "rank_of_all": row["rank"],
            "faces": " > ".join(name for letters, name in row["steps"] if letters == "R"), **known, "centroid_x": x, "centroid_y": y,
            "num_rays": row["num_rays"], "reflections": row["reflections"], "sequence": row["sequence"], "where": where}


def _of_field(report: Json, folder: Path, field: Field, rows: list[Json], top: int, detector: str) -> GhostsOfField:
    """Return what a field makes, with the maps of its first rows."""
    def arrays(name: str) -> Any:
        entry = report["detectors"].get(name)
        return None if entry is None else load_arrays(folder, entry["file"], report)

    places = [row.pop("rank_of_all") for row in rows]
    found = (arrays(f"path_{place}") for place in places[:top])
    pixels = arrays(detector)
    return GhostsOfField(field, rows, [None if map is None else map["irradiance"] for map in found],
                         report["detectors"][detector]["total_flux"], pixels["x_coords"], pixels["y_coords"])
