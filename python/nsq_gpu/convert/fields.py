"""The light of a prescription's fields, as sources that fill the entrance pupil."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQMaterial, NSQScene
from optiland.nonsequential.sources.base import Spectrum

from nsq_gpu.convert.prescription import frame
from nsq_gpu.errors import UnsupportedSceneError
from nsq_gpu.sources import PupilSource

#: Largest difference between a ray of the sequential engine and of the source, in units of the pupil's size.
_TOLERANCE = 1e-10


def add_sources(scene: NSQScene, optic: Any, medium: NSQMaterial | None) -> None:
    """Add a source a field, ``source_0`` and on, with the weights of fields and wavelengths.

    Raises:
        UnsupportedSceneError: The rays of a field are no linear function of the pupil, by its name.
    """
    lines = optic.wavelengths.wavelengths
    spectrum = Spectrum([float(line.value) for line in lines], [float(line.weight) for line in lines])
    weights = [float(given.weight) for given in optic.fields.fields]
    for number, ((hx, hy), weight) in enumerate(zip(optic.fields.get_field_coords(), weights, strict=True)):
        source = _source(optic, number, float(hx), float(hy), spectrum, medium)
        source.total_flux = weight
        scene.source_registry.add(f"source_{number}", source)


def _rays(optic: Any, hx: float, hy: float, pupil: np.ndarray, wavelength: float) -> tuple[np.ndarray, np.ndarray]:
    """Return starts [mm] and unit directions of the sequential engine's rays, shape (N, 3)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rays = optic.ray_tracer.ray_generator.generate_rays(hx, hy, pupil[:, 0], pupil[:, 1], wavelength)
    # A point of the object is one for all of its rays.
    columns = [[np.broadcast_to(be.to_numpy(part).astype(float), len(pupil)) for part in parts]
               for parts in ((rays.x, rays.y, rays.z), (rays.L, rays.M, rays.N))]
    return np.stack(columns[0], axis=1), np.stack(columns[1], axis=1)


def _source(optic: Any, number: int, hx: float, hy: float, spectrum: Spectrum, medium: NSQMaterial | None) -> PupilSource:
    """Return the source of a field, found from a few of its rays and compared with others."""
    place = f"field {number}"
    wavelength = float(optic.primary_wavelength)
    probes = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    starts, directions = _rays(optic, hx, hy, probes, wavelength)
    if (directions[:, 2] <= 0.0).any():
        raise UnsupportedSceneError(f"{place}: its chief ray is more than 90 degrees off the axis, which no pupil source is")
    # Of a ray the length is free: take slopes, which are linear in the pupil.
    slopes = directions / directions[:, 2:]
    source = PupilSource(frame(starts[0], np.eye(3)), spectrum,
                         beam_radii=(starts[1, 0] - starts[0, 0], starts[2, 1] - starts[0, 1]), chief=slopes[0],
                         pupil_radii=(slopes[1, 0] - slopes[0, 0], slopes[2, 1] - slopes[0, 1]), medium=medium)
    turn = 2.0 * np.pi * np.arange(7) / 7.0
    others = np.concatenate([probes, np.stack([np.cos(turn), np.sin(turn)], axis=1), [[0.3, 0.4], [-0.5, 0.1]]])
    size = max(1.0, float(np.abs(starts).max()))
    for line in optic.wavelengths.wavelengths:
        expected = _rays(optic, hx, hy, others, float(line.value))
        found_starts, found_directions = source.local_rays(others)
        found = (found_starts + starts[0], found_directions)
        if any(np.abs(one - other).max() > _TOLERANCE * scale
               for one, other, scale in zip(found, expected, (size, 1.0), strict=True)):
            raise UnsupportedSceneError(f"{place}: its rays are aimed ({_aiming(optic)}) so that they are no linear function "
                                        "of the pupil; set paraxial aiming")
    return source


def _aiming(optic: Any) -> str:
    return str(getattr(optic.ray_tracer, "ray_aiming_config", {}).get("mode", "unknown"))
