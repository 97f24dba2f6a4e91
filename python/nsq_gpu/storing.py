"""Results in folders, as ``nsq-gpu trace -o`` writes them: ``report.json``, an ``.npz`` a detector, tables, and the scene.

The program's twin is ``src/result/output.rs``.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from optiland.nonsequential.diagnostics import DetectorDiagnostic, Diagnostics
from optiland.nonsequential.path_recording import _EVENT_DTYPE
from optiland.nonsequential.results import FarFieldPattern, IrradianceMap, RayDatabase, SpectralResult

from nsq_gpu import placing
from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.integrity import REPORT, load_arrays, read_report
from nsq_gpu.pst_table import JSON as PST
from nsq_gpu.results import ROWS, Result, result_of, with_ledger

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

Json = dict[str, Any]

RAY_PATHS = "ray_paths.npz"
PATHS = "paths.csv"
SCENE = "scene.json"
_NO_HASH = "0" * 64
#: Longest name of a detector's file, without its ending.
_MOST_CHARACTERS = 60


# Writing


def save(result: Result, folder: Path, overwrite: bool) -> None:
    """Write a result into a folder; :meth:`nsq_gpu.results.Result.save` says how."""
    files, report = _files(result, folder)
    _check_place(folder, [*files, REPORT], overwrite)
    meta = {name: {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()} for name, data in files.items()}
    # Names of files and scenes stand before the hash, and might be zeros as well: the last zeros count.
    text = json.dumps(report | {"meta": {"files": meta, "sha256": _NO_HASH}}, indent=2, allow_nan=False)
    before, _, after = text.rpartition(_NO_HASH)
    sealed = before + hashlib.sha256(text.encode()).hexdigest() + after
    folder.mkdir(parents=True, exist_ok=True)
    placing.write_all(folder, files | {REPORT: sealed.encode()}, overwrite, leave=_files_of_result(folder) - set(files))


def _files(result: Result, folder: Path) -> tuple[dict[str, bytes], Json]:
    """Return the bytes of all files but the report by their names, and the report that knows them."""
    report = {key: value for key, value in result.report_json.items() if key != "meta"}
    names = dict(zip(report["detectors"], file_stems(report["detectors"]), strict=True))
    files = {f"{stem}.npz": _npz(result.arrays[name]) for name, stem in names.items()}
    report["detectors"] = {name: {**entry, "file": f"{names[name]}.npz", "picture": None}
                           for name, entry in report["detectors"].items()}
    report["ray_paths"] = None
    if None in result.arrays:
        files[RAY_PATHS] = _npz(result.arrays[None])
        report["ray_paths"] = RAY_PATHS
    if report.get("paths") is not None:
        files[PATHS] = _csv(report["paths"]).encode()
        report["paths_file"] = PATHS
    if result.scene_json is not None:
        files[SCENE] = result.scene_json.encode()
        report["scene"] = os.path.abspath(folder / SCENE)
    return files, report


def _check_place(folder: Path, names: Iterable[str], overwrite: bool) -> None:
    """Refuse a folder in which something would be lost, before anything is written."""
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder}: is no folder; give the name of one, such as {str(folder.with_suffix(''))!r}")
    for name in names:
        path = folder / name
        if os.path.lexists(path) and not overwrite:
            what = "holds a result" if (folder / REPORT).exists() else f"holds {name}"
            raise UsageError(f"{folder}: {what}; overwrite=True replaces it, or give another folder")
        placing.check(path, overwrite)


def _files_of_result(folder: Path) -> set[str]:
    """Return the files of the result that is in a folder, as they were written; those that somebody changed are not his."""
    try:
        report = read_report(folder)
    except (OSError, NsqGpuError):
        return set()
    known = (report.get("meta") or {}).get("files", {})
    return {name for name, entry in known.items() if Path(name).name == name and _is_as_written(folder / name, entry["sha256"])}


def _is_as_written(path: Path, sha256: str) -> bool:
    return path.is_file() and not path.is_symlink() and hashlib.sha256(path.read_bytes()).hexdigest() == sha256


def file_stems(names: Iterable[str]) -> list[str]:
    """Return names of files for detectors, without an ending: safe on every system, and no two of them equal."""
    taken, found = {"ray_paths", "gradients"}, []
    for name in names:
        stem = free = _safe_stem(name)
        number = 2
        while free.upper().lower() in taken:
            free, number = f"{stem}_{number}", number + 1
        taken.add(free.upper().lower())
        found.append(free)
    return found


def _safe_stem(name: str) -> str:
    stem = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name.strip())[:_MOST_CHARACTERS]
    base = stem.partition(".")[0].upper()
    is_reserved = base in ("CON", "PRN", "AUX", "NUL") or len(base) == 4 and base.startswith(("COM", "LPT"))
    return f"_{stem}" if stem.startswith((".", "-")) or is_reserved else stem or "detector"


def _npz(arrays: dict[str, np.ndarray]) -> bytes:
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _csv(rows: list[Json]) -> str:
    """Return a table of paths as the command writes it."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["rank", "flux_W", "share", "standard_error_W", "num_rays", "reflections", "scatterings", "detector",
                     "centroid_x_mm", "centroid_y_mm", "rms_radius_mm", "peak_irradiance_W_mm2", "sequence", "rests_on",
                     "upper_bound_95_W"])
    for row in rows:
        x, y = row["centroid"] or (None, None)
        writer.writerow([_cell(cell) for cell in (
            row["rank"], row["flux"], row["share"], row["standard_error"], row["num_rays"], row["reflections"],
            row["scatterings"], row["detector"], x, y, row["rms_radius"], row["peak_irradiance"],
            row["sequence"], row.get("rests_on"), row.get("upper_bound_95"))])
    return text.getvalue()


def _cell(value: Any) -> str:
    """Return a number with all of its digits, or a text that no spreadsheet takes for a formula."""
    if isinstance(value, float):
        return np.format_float_scientific(value, trim="-", exp_digits=1).replace("e+", "e")
    text = "" if value is None else str(value)
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r", "\n")) else text


# Reading


def load(folder: str | os.PathLike[str]) -> Result:
    """Read a result that :meth:`nsq_gpu.results.Result.save` or ``nsq-gpu trace -o`` wrote.

    Detectors have NumPy's arrays. Recorded paths have the names of the scene file, and not those that Optiland gives them.

    Raises:
        UsageError: There is no result, or it is one of ``diff``.
        NsqGpuError: A file is damaged, or was edited.
    """
    folder = Path(folder)
    if not (folder / REPORT).is_file():
        if (folder / PST).is_file():
            raise UsageError(f"{folder}: holds a point source transmittance; read it by nsq_gpu.PstResult.load({str(folder)!r})")
        what = "there is no such folder" if not folder.exists() else f"has no {REPORT}"
        raise UsageError(f"{folder}: {what}; give a folder that result.save or `nsq-gpu trace -o` wrote")
    report = read_report(folder)
    if report.get("kind") is not None or "ledger" not in report:
        raise UsageError(f"{folder}: is no result of a trace; `nsq-gpu view` shows one of diff")
    arrays: dict[str | None, dict[str, np.ndarray]] = {}
    detectors = {}
    # Maps of single paths stand among the detectors, with a title.
    entries = {name: entry for name, entry in report["detectors"].items() if not entry.get("title")}
    for name, entry in entries.items():
        if entry["file"] is None:
            raise UsageError(f"{folder / REPORT}: names no file of detector {name!r}; write one with `nsq-gpu trace -o`")
        arrays[name] = load_arrays(folder, entry["file"], report)
        detectors[name] = _DETECTORS[entry["kind"]](arrays[name], entry)
    ray_paths = None
    if report["ray_paths"] is not None:
        arrays[None] = load_arrays(folder, report["ray_paths"], report)
        ray_paths = {"events": _events(arrays[None])}
    return result_of({**report, "detectors": entries}, arrays, detectors, ray_paths, _diagnostics(report), report["partial"],
                     _scene(folder, report))


def _scene(folder: Path, report: Json) -> str | None:
    """Return the text of the scene that was saved along."""
    known = (report.get("meta") or {}).get("files", {}).get(SCENE)
    if known is None:
        return None
    path = folder / SCENE
    if not _is_as_written(path, known["sha256"]):
        raise NsqGpuError(f"{path}: is damaged, was edited, or belongs to another trace: {REPORT} has another hash of it")
    return path.read_text(encoding="utf-8")


def _irradiance(arrays: dict[str, np.ndarray], entry: Json) -> IrradianceMap:
    irradiance = arrays["irradiance"]
    num_y, num_x = irradiance.shape
    data = (irradiance * (float(entry["width"]) / num_x * (float(entry["height"]) / num_y))).ravel()
    return IrradianceMap(irradiance, arrays["x_coords"], arrays["y_coords"], entry["total_flux"], entry["num_rays_hit"], data)


def _spectral(arrays: dict[str, np.ndarray], entry: Json) -> SpectralResult:
    names = ("irradiance", "x_coords", "y_coords", "wavelengths")
    return SpectralResult(*(arrays[name] for name in names), entry["total_flux"], entry["num_rays_hit"])


def _far_field(arrays: dict[str, np.ndarray], entry: Json) -> FarFieldPattern:
    return FarFieldPattern(arrays["intensity"], arrays["theta"], arrays["phi"], entry["total_flux"], entry["num_rays_hit"])


#: Optiland's result of each kind, from the arrays and the entry of a report.
_DETECTORS: dict[str, Callable[[dict[str, np.ndarray], Json], Any]] = {
    "irradiance": _irradiance,
    "spectral": _spectral,
    "far_field": _far_field,
    "ray_database": lambda arrays, entry: RayDatabase(*(arrays[name] for name in ROWS)),
}


def _events(columns: dict[str, np.ndarray]) -> np.ndarray:
    events = np.empty(len(columns["ray_id"]), dtype=_EVENT_DTYPE)
    for key in _EVENT_DTYPE.names or ():
        events[key] = columns[key]
    return events


def _diagnostics(report: Json) -> Diagnostics:
    said = report["diagnostics"]
    same = ("depth_truncated_flux_fraction", "rr_killed_flux_fraction", "flux_conservation_error", "medium_stack_underflows",
            "split_budget_saturated")
    of_detectors = tuple(DetectorDiagnostic(**entry) for entry in said["detectors"])
    return with_ledger(Diagnostics(**{key: said[key] for key in same}, unreached_geometry=tuple(said["unreached_geometry"]),
                                   detectors=of_detectors), report)
