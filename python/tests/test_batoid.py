"""Ghosts of a telescope of batoid's beside its own: the same sequences of faces, with their fluxes, places and sizes.

batoid traces by sequence and Optiland's scenes do not: light may pass beside a lens. So sequences are compared.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from optiland.coatings import SimpleCoating
from optiland.materials import IdealMaterial
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.configs import CollimatedSourceConfig
from optiland.optic import Optic
from optiland.physical_apertures import RadialAperture

import nsq_gpu
from tests import live
from tests.live import cs

batoid = pytest.importorskip("batoid", reason="batoid is not installed")

#: Reflectance of each face, wavelength [um], and the beam: its tilt [rad], radius and distance before the first face [mm].
REFLECTANCE, LINE, TILT, BEAM, BEFORE = 0.02, 0.55, np.deg2rad(0.4), 30.0, 50.0
#: Rays on either side: batoid's lie on a spiral, each of which stands for the same flux.
NUM_RAYS = 50_000
SIGMAS = 4.0


def telescope() -> list[Any]:
    """Return the faces of a triplet apochromat and its detector, each of the same reflectance from either side."""
    from batoid.coating import SimpleCoating as Coating

    optic = batoid.Optic.fromYaml("donsoptikz1.yaml")
    lenses, faces = optic.items[:-1], [face for lens in optic.items[:-1] for face in lens.items]
    assert len(lenses) == 3 and len(faces) == 6
    for face in faces:
        face.forwardCoating = face.reverseCoating = Coating(REFLECTANCE, 1.0 - REFLECTANCE)
    optic.items[-1].obscuration = None
    return [optic, *faces, optic.items[-1]]


def theirs() -> dict[tuple[str, ...], tuple[float, float, float]]:
    """Return flux, y and rms radius [mm] of each sequence that arrives, such as ``("T 0", "R 1", "R 0", "T 1")``."""
    optic, *faces = telescope()
    places = {face.name: index for index, face in enumerate(faces)}
    count = np.arange(NUM_RAYS) + 0.5
    radius, turn = BEAM * np.sqrt(count / NUM_RAYS), np.pi * (1.0 + np.sqrt(5.0)) * count
    along, up = np.array([0.0, np.sin(TILT), np.cos(TILT)]), np.array([0.0, np.cos(TILT), -np.sin(TILT)])
    starts = -BEFORE * along + (radius * np.cos(turn))[:, None] * np.array([1.0, 0.0, 0.0]) + (radius * np.sin(turn))[:, None] * up
    # batoid's light runs towards -z, in metres.
    position, direction = starts * np.array([1e-3, 1e-3, -1e-3]), np.broadcast_to(along * np.array([1, 1, -1]), starts.shape)
    rays = batoid.RayVector(*position.T.copy(), *direction.T.copy(), wavelength=LINE * 1e-6, flux=1.0 / NUM_RAYS)
    found = {}
    for part in optic.traceSplit(rays, minFlux=1e-7 / NUM_RAYS)[0]:
        arrives = ~part.vignetted & ~part.failed
        if arrives.any():
            path = [places[name] for name in part.path]
            turns = [False, *(step * next_step < 0 for step, next_step in zip(np.diff(path), np.diff(path)[1:], strict=False))]
            steps = tuple(f"{'R' if turn else 'T'} {place}" for turn, place in zip(turns, path[:-1], strict=True))
            found[steps] = _figures(part.flux[arrives], 1e3 * part.x[arrives], 1e3 * part.y[arrives])
    return found


def _figures(flux: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    middle_x, middle_y = np.average(x, weights=flux), np.average(y, weights=flux)
    return float(flux.sum()), middle_y, float(np.sqrt(np.average((x - middle_x) ** 2 + (y - middle_y) ** 2, weights=flux)))


def scene() -> NSQScene:
    """Return the same lens, beam and detector as a scene."""
    _, *faces = telescope()
    z = [-1e3 * face.coordSys.origin[2] for face in faces]
    optic = Optic()
    optic.surfaces.add(index=0, thickness=np.inf)
    for index, face in enumerate(faces[:-1]):
        n = face.outMedium.getN(LINE * 1e-6)
        optic.surfaces.add(index=index + 1, radius=-1e3 * face.surface.R, thickness=z[index + 1] - z[index], is_stop=index == 0,
                           material=IdealMaterial(n) if n > 1.001 else "air", aperture=RadialAperture(1e3 * face.obscuration.original.radius))
        optic.surfaces.surfaces[-1].interaction_model.coating = SimpleCoating(transmittance=1.0 - REFLECTANCE, reflectance=REFLECTANCE)
    optic.surfaces.add(index=len(faces))
    optic.set_aperture("EPD", 2.0 * BEAM)
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.wavelengths.add(value=LINE, is_primary=True)
    found = nsq_gpu.from_optic(optic)
    found.remove_source("source_0")
    found.remove_detector("image")
    found.add_detector("image", cs(z=z[-1]), IrradianceDetectorConfig(400.0, 400.0, 64, 64))
    line = live.Spectrum(np.array([LINE]), np.array([1.0]))
    found.add_source("beam", cs(y=-BEFORE * np.sin(TILT), z=-BEFORE * np.cos(TILT), rx=-TILT), CollimatedSourceConfig(line, aperture_radius=BEAM))
    return found


def test_ghosts_are_those_of_batoid() -> None:
    built, known = scene(), theirs()
    numbers = {name: str(index) for index, (name,) in enumerate(built.conversion_report.components[index] for index in range(1, 7))}
    with live.quiet():
        found = nsq_gpu.ghosts(built, group="sequence", num_rays=NUM_RAYS, seed=3, split_depth=12, max_depth=32, guide=False, precision="f64",
                               binary=live.binary())
    rows = {}
    for row in found.fields[0].rows:
        steps = tuple(f"{step.split(' ')[0]} {numbers.get(step.split(' ')[1], '')}" for step in row["sequence"].split(" > ")[1:-1])
        rows[steps] = row
    ghosts = sorted((steps for steps in known if any(step[0] == "R" for step in steps)), key=lambda steps: -known[steps][0])
    assert len(ghosts) > 40
    for steps in ghosts[:5]:
        (flux, y, radius), row = known[steps], rows[steps]
        assert row["num_rays"] > 40 and abs(row["flux"] - flux) < SIGMAS * row["standard_error"], steps
        error = radius / np.sqrt(2.0 * row["num_rays"])
        assert abs(row["centroid_y"] - y) < SIGMAS * error and abs(row["rms_radius"] - radius) < SIGMAS * error, steps
    # The strongest ghost alone has rays enough for more than that.
    assert rows[ghosts[0]]["flux"] == pytest.approx(known[ghosts[0]][0], rel=0.02)
