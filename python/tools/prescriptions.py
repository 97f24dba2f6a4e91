"""Converts prescriptions, traces them here and by Optiland's sequential engine, and writes the table of how they compare.

    python -m tools.prescriptions                  # Optiland's samples
    python -m tools.prescriptions FOLDER_OR_FILE.. # and files of lenses, such as the ones of Optiland's own tests
    python -m tools.prescriptions --page ../docs/how-to/lenses.md optiland-0.6.3/tests/zemax_files optiland-0.6.3/tests/test_fileio
    python -m tools.prescriptions --rayoptics peer/bin/python FILE.. # beside rayoptics, which reads files by a reader of its own

Rays of all fields and wavelengths are traced by ``nsq-gpu`` in f64 without reflections, and from the same starts by the
sequential engine. A row has the largest distance between the two on any surface, among rays that reach both images. Newton's
method of the sequential engine runs to 1e-13 mm here, also where a file's reader says 1e-6.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optiland.samples
from optiland.nonsequential import NSQScene
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.optic import Optic
from optiland.rays import RealRays

import nsq_gpu
from nsq_gpu.convert import from_optic
from nsq_gpu.convert.prescription import fields_of, rays_of, trace, without_polarised_coatings
from nsq_gpu.lensfiles import SUFFIXES, read_lens

RAYS_PER_FIELD = 200
#: Where a page has the table.
BEGIN, END = "<!-- Written by python/tools/prescriptions.py. -->", "<!-- End of the table of prescriptions. -->"
#: What the table says of a report's remarks.
REMARKS = {"rays are aimed": "aimed at the stop", "image is curved": "curved image", "where light goes": "faces cross in the light", "stands in the light": "something stands in the light",
           "no edge": "faces without an edge", "light beside its aperture": "a mirror with an aperture"}


@dataclass
class Row:
    """How a prescription fared."""

    name: str
    #: Why it is not carried, or "".
    refused: str = ""
    num_surfaces: int = 0
    num_fields: int = 0
    num_rays: int = 0
    #: Rays that reach the image in the sequential engine, and of those the ones that do not reach the detector.
    num_sequential: int = 0
    num_lost: int = 0
    #: Rays that reach the detector, and are lost in the sequential engine: outside of an aperture, or without a crossing.
    num_gained: int = 0
    #: Largest distance on any surface [mm], and largest difference of a direction.
    distance: float = 0.0
    direction: float = 0.0
    seconds: float = 0.0
    #: Of a file: the largest distance [mm] between the optic and rayoptics on any surface, and why there is none.
    peer: float | None = None
    peer_failed: str = ""
    #: What the report remarks.
    remarks: str = ""


def samples() -> Iterator[tuple[str, type[Optic]]]:
    """Yield Optiland's samples by name."""
    for module in pkgutil.iter_modules(optiland.samples.__path__):
        found = importlib.import_module(f"optiland.samples.{module.name}")
        for name, kind in vars(found).items():
            if inspect.isclass(kind) and issubclass(kind, Optic) and kind is not Optic and kind.__module__ == found.__name__:
                yield name, kind


def transmitted(scene: NSQScene, num_rays: int, **options: Any) -> Any:
    """Trace a scene without reflections, in f64, and record all paths."""
    scene.sampling_policy = SamplingPolicy(reflect_prob=0.0, rr_start_flux=0.0)
    backend = nsq_gpu.NsqGpuBackend(precision="f64", **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return scene.trace(num_rays, max_depth=scene.conversion_report.max_depth + 2, min_flux_fraction=0.0, backend=backend,
                           record_paths=True)


def compare(name: str, optic: Any, *, detector_size: tuple[float, float] | None = None, **options: Any) -> Row:
    """Convert a prescription and compare the rays of both engines."""
    start = time.perf_counter()
    row = Row(name)
    for surface in optic.surfaces.surfaces:
        # Readers set 1e-6 mm, which would be all that is seen.
        if hasattr(surface.geometry, "tol"):
            surface.geometry.tol = min(surface.geometry.tol, 1e-13)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Light that slips past a lens must show.
            scene = from_optic(optic, detector_size=detector_size)
    except nsq_gpu.NsqGpuError as error:
        row.refused = str(error)
        return row
    row.seconds = time.perf_counter() - start
    report = scene.conversion_report
    row.remarks = "; ".join([f"no edge on {name}: {reason}" for name, reason in report.without_edge.items()] + report.remarks)
    row.num_surfaces, row.num_fields = len(report.components), len(scene.sources)
    events = transmitted(scene, RAYS_PER_FIELD * row.num_fields, **options).ray_paths["events"]
    births = events[events["event_type"] == "birth"]
    births = births[np.argsort(births["ray_id"])]
    row.num_rays = len(births)
    places, directions, arrive = sequential(optic, births)
    hits = events[events["event_type"] == "hit"]
    index_of = {int(ray): place for place, ray in enumerate(births["ray_id"])}
    ended = np.zeros(row.num_rays, dtype=bool)
    ours = np.full((len(optic.surfaces.surfaces), row.num_rays, 6), np.nan)
    expected = [index for index, names in report.components.items() if names and not names[0].startswith("stop")]
    names = {index: report.components[index][0] for index in expected}
    sequence = [names[index] for index in expected] + ["image"]
    places_of = [*expected, len(optic.surfaces.surfaces) - 1]
    for ray in np.unique(hits["ray_id"]):
        own = hits[hits["ray_id"] == ray]
        own = own[np.argsort(own["bounce"], kind="stable")]
        # Optiland names no detector.
        path = [name or "image" for name in own["component_name"]]
        if path == sequence:
            place = index_of[int(ray)]
            ended[place] = True
            for surface, event in zip(places_of, own, strict=True):
                ours[surface, place] = [event[key] for key in ("x", "y", "z", "L", "M", "N")]
    if any("the image is curved" in remark for remark in report.remarks):
        places_of = places_of[:-1]
    both = arrive & ended
    row.num_sequential, row.num_lost = int(arrive.sum()), int((arrive & ~ended).sum())
    # Whatever way they took.
    images = {int(event["ray_id"]) for event in hits if event["component_name"] == ""}
    row.num_gained = sum(int(ray) in images and not arrives for ray, arrives in zip(births["ray_id"], arrive, strict=True))
    if both.any():
        distance = np.linalg.norm(ours[places_of][:, both, :3] - places[places_of][:, both], axis=-1)
        row.distance = float(distance.max())
        # An event has the direction before it, the sequential engine the one behind a surface.
        before = [surface - 1 for surface in places_of]
        row.direction = float(np.abs(ours[places_of][:, both, 3:] - directions[before][:, both]).max())
    return row


def sequential(optic: Any, births: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Trace rays from their births; return places [mm] and directions, shape (surfaces, rays, 3), and who arrives."""
    places = np.full((len(optic.surfaces.surfaces), len(births), 3), np.nan)
    directions = np.full_like(places, np.nan)
    arrive = np.zeros(len(births), dtype=bool)
    for wavelength in np.unique(births["wavelength"]):
        chosen = births["wavelength"] == wavelength
        own = births[chosen]
        rays = RealRays(*(own[key].copy() for key in ("x", "y", "z", "L", "M", "N")), np.ones(len(own)),
                        np.full(len(own), wavelength))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with without_polarised_coatings(optic):
                found = trace(optic, rays)
        places[:, chosen], directions[:, chosen], arrive[chosen] = found.places, found.directions, found.arrive
    return places, directions, arrive


def beside_rayoptics(row: Row, path: Path, optic: Any, unit: float, python: str) -> None:
    """Fill in how far rays of the optic are from the rays of rayoptics, which reads the same file."""
    pupil = np.array([[0.0, 0.0], [0.7, 0.0], [0.0, 0.9], [-0.5, -0.5], [0.0, -0.9]])
    wavelength = float(optic.primary_wavelength)
    rays, places = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for field in fields_of(optic):
            born = rays_of(optic, *field, pupil, wavelength)
            rays.append(np.stack([np.broadcast_to(getattr(born, key), len(pupil)).astype(float) for key in "xyzLMN"], axis=1))
            places.append(trace(optic, born).places)
    job = [{"file": str(path), "unit": unit, "wavelength": [wavelength] * sum(map(len, rays)), "rays": np.concatenate(rays).tolist()}]
    done = subprocess.run([python, str(Path(__file__).with_name("rayoptics_peer.py"))], input=json.dumps(job), capture_output=True, text=True)
    [answer] = json.loads(done.stdout) if done.returncode == 0 else [{"error": done.stderr.strip().splitlines()[-1]}]
    if "error" in answer:
        row.peer_failed = answer["error"]
        return
    theirs, ours = np.array(answer["places"], dtype=float), np.concatenate(places, axis=1)
    # Coordinate breaks are surfaces there: then the image alone is compared.
    both = (theirs[1:], ours[1:]) if len(theirs) == len(ours) else (theirs[-1:], ours[-1:])
    distance = np.linalg.norm(both[0] - both[1], axis=2)
    if np.isnan(distance[-1]).any():
        row.peer_failed = f"{np.isnan(distance[-1]).sum()} of {distance.shape[1]} rays are lost there"
    else:
        row.peer = float(distance.max())


def line(row: Row) -> str:
    """Return a row of the table."""
    if row.refused:
        return f"| `{row.name}` {'| ' * 10}{row.refused} |"
    said = ", ".join(short for long, short in REMARKS.items() if long in row.remarks)
    return (f"| `{row.name}` | {row.num_surfaces} | {row.num_fields} | {row.num_sequential} of {row.num_rays} | {row.num_lost} | "
            f"{row.num_gained} | {row.distance:.1e} | {row.direction:.1e} | {row.seconds:.2f} | "
            f"{f'{row.peer:.1e}' if row.peer is not None else '-' if row.peer_failed else ''} | {said} |")


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="*", help="files of lenses, or folders of them")
    parser.add_argument("--binary", help="the built command")
    parser.add_argument("--rayoptics", metavar="PYTHON", help="a Python that has rayoptics, see tools/rayoptics_peer.py")
    parser.add_argument("--page", type=Path, help="a page whose table is written anew")
    given = parser.parse_args()
    found = [(name, None, kind) for name, kind in samples()]
    for path in given.files:
        files = sorted(file for file in path.rglob("*") if file.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
        found += [(file.name, file, None) for file in files]
    rows = ["| lens | surfaces | fields | rays | lost | gained | distance [mm] | direction | time [s] | rayoptics [mm] | |", f"|{'---|' * 11}"]
    for name, path, kind in found:
        try:
            optic, reading = (kind(), None) if path is None else read_lens(path)
            row = compare(name, optic, binary=given.binary)
            if given.rayoptics and path is not None and path.suffix.lower() in (".zmx", ".seq"):
                beside_rayoptics(row, path.resolve(), optic, reading.unit, given.rayoptics)
                if row.peer_failed:
                    print(f"{name}: rayoptics: {row.peer_failed}", file=sys.stderr)
        except nsq_gpu.NsqGpuError as error:
            row = Row(name, refused=re.sub(rf"^{re.escape(name)}:", "line ", str(error)))
        rows.append(line(row))
        print(rows[-1], flush=True)
    if given.page is not None:
        text = given.page.read_text(encoding="utf-8")
        head, rest = text.split(BEGIN)
        tail = rest.split(END)[1]
        given.page.write_text(f"{head}{BEGIN}\n\n" + "\n".join(rows).replace("[mm]", "\\[mm\\]").replace("[s]", "\\[s\\]")
                              + f"\n\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
