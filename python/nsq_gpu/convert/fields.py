"""The light of a prescription's fields, as sources that fill the entrance pupil."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.fields import Field
from optiland.fields.field_types import AngleField
from optiland.nonsequential import NSQMaterial, NSQScene
from optiland.nonsequential.sources.base import Spectrum

from nsq_gpu.convert.prescription import fields_of, in_double, rays_of, without_polarised_coatings
from nsq_gpu.convert.report import LensReport
from nsq_gpu.errors import UnsupportedSceneError
from nsq_gpu.frames import frame
from nsq_gpu.lensfiles.system import VignettedField
from nsq_gpu.sources import Aim, PupilSource

#: Largest difference between a ray of the sequential engine and of the source that is rounding, in units of the numbers.
_ROUNDING = 1e-10
#: Order of the polynomials that say where aimed rays start, and rings and directions of the pupil that they are fitted to.
_ORDER = 7
_RINGS, _TURNS = 8, 16
#: Largest share of the pupil's width by which rays that are aimed may miss their places.
_MOST_MISS = 1e-3

#: Coordinates of a field, as shares of the largest one, and Optiland's field.
_Field = tuple[float, float, Any]


def add_sources(scene: NSQScene, optic: Any, medium: NSQMaterial | None, report: LensReport) -> None:
    """Add a source a field, ``source_0`` and on, with the weights of fields and wavelengths.

    With paraxial aiming the source's rays are the sequential engine's. Where rays are aimed at the stop itself, the
    source has a polynomial of the pupil for each wavelength, and the report says how near that is.

    Raises:
        UnsupportedSceneError: The rays of a field are no such polynomial of the pupil, by its name.
    """
    lines = optic.wavelengths.wavelengths
    spectrum = Spectrum([float(line.value) for line in lines], [float(line.weight) for line in lines])
    for number, field in enumerate(fields_of(optic)):
        source = _source(optic, number, field, spectrum, medium, report)
        source.total_flux = float(field[2].weight)
        if isinstance(field[2], VignettedField) and (field[2].decenter_x or field[2].decenter_y):
            report.remarks.append(f"field {number + 1} (source_{number}): vignetting moves its pupil by {field[2].decenter_x:.4g} along x and "
                                  f"{field[2].decenter_y:.4g} along y, in units of the pupil's radius")
        scene.source_registry.add(f"source_{number}", source)


def field_unit(optic: Any) -> str:
    """Return the unit of the coordinates of an Optic's fields: deg of angles, else mm."""
    return "deg" if isinstance(optic.fields.field_definition, AngleField) else "mm"


def sources_of(optic: Any, fields: Sequence[tuple[float, float]], medium: NSQMaterial | None) -> dict[str, PupilSource]:
    """Return the light of other fields, 1 W each, as ``source_0`` and on; the Optic keeps its own.

    Args:
        optic: Optiland's Optic.
        fields: Pairs of x and y, in the unit of its fields.
        medium: Medium around the sources.

    Raises:
        UnsupportedSceneError: The rays of a field are none of a pupil source's, by its name.
    """
    scene, own = NSQScene(), optic.fields.fields
    with in_double(), without_polarised_coatings(optic):
        try:
            optic.fields.fields = [Field(x=x, y=y) for x, y in fields]
            add_sources(scene, optic, medium, LensReport())
        finally:
            optic.fields.fields = own
    return dict(zip(scene.source_names, scene.sources, strict=True))


def _rays(optic: Any, field: _Field, pupil: np.ndarray, wavelength: float) -> tuple[np.ndarray, np.ndarray]:
    """Return starts [mm] and unit directions of the sequential engine's rays, shape (N, 3)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rays = rays_of(optic, *field, pupil, wavelength)
    # A point of the object is one for all of its rays.
    columns = [[np.broadcast_to(be.to_numpy(part).astype(float), len(pupil)) for part in parts]
               for parts in ((rays.x, rays.y, rays.z), (rays.L, rays.M, rays.N))]
    return np.stack(columns[0], axis=1), np.stack(columns[1], axis=1)


def _source(optic: Any, number: int, field: _Field, spectrum: Spectrum, medium: NSQMaterial | None,
            report: LensReport) -> PupilSource:
    """Return the source of a field, found from a few of its rays and compared with others."""
    place = f"field {number + 1} (source_{number})"
    turn = 2.0 * np.pi * np.arange(8) / 8.0
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pupil = np.concatenate([[[0.0, 0.0]], rim, 0.5 * rim])
    starts, directions = _rays(optic, field, pupil, float(optic.primary_wavelength))
    if not (directions[:, 2] > 0.0).all():
        raise UnsupportedSceneError(f"{place}: some of its rays are more than 90 degrees off the axis, or have no direction; no "
                                    "pupil source emits those")
    # Of a ray the length is free: take slopes, which are linear in the pupil where starts are.
    columns = np.concatenate([starts, directions[:, :2] / directions[:, 2:]], axis=1)
    middle, across, up = np.linalg.lstsq(np.concatenate([np.ones((len(pupil), 1)), pupil], axis=1), columns, rcond=None)[0]
    source = PupilSource(frame(middle[:3], np.eye(3)), spectrum, beam_radii=(across[0], up[1]),
                         chief=(middle[3], middle[4], 1.0), pupil_radii=(across[3], up[4]), medium=medium)
    if _miss(optic, field, source, middle, pupil) == 0.0:
        return source
    source.aimed = tuple(_aim(optic, field, source, middle, float(line.value)) for line in optic.wavelengths.wavelengths)
    others = _in_pupil(5, 11, 0.3)
    miss = _miss(optic, field, source, middle, others)
    if not miss <= _MOST_MISS:
        raise UnsupportedSceneError(f"{place}: its rays are aimed ({_aiming(optic)}) so that they are no smooth function of the "
                                    f"pupil: they would miss their places by {miss:.2%} of its width; set paraxial aiming")
    how_well = f"to {miss:.1g} of the pupil's width" if miss > 0.0 else "to rounding"
    report.remarks.append(f"{place}: its rays are aimed ({_aiming(optic)}); a polynomial of order {_ORDER} for each wavelength has "
                          f"them {how_well}")
    return source


def _in_pupil(rings: int, turns: int, twist: float) -> np.ndarray:
    """Return points of the unit disk on rings that are closer together towards the rim, each turned against the last."""
    radii = np.cos((np.arange(rings) + 0.5) * np.pi / (2 * rings))
    turn = 2.0 * np.pi * np.arange(turns) / turns
    return np.concatenate([np.stack([r * np.cos(turn + i * twist), r * np.sin(turn + i * twist)], axis=1) for i, r in enumerate(radii)])


def _miss(optic: Any, field: _Field, source: PupilSource, middle: np.ndarray, pupil: np.ndarray) -> float:
    """Return by which share of the pupil's width rays miss their places, over all wavelengths; 0 if rounding hides it."""
    miss = 0.0
    for line in optic.wavelengths.wavelengths:
        starts, directions = _rays(optic, field, pupil, float(line.value))
        found_starts, found_directions = source.local_rays(pupil, np.full(len(pupil), float(line.value)))
        for found, expected in ((found_starts + middle[:3], starts), (found_directions, directions)):
            off = float(np.abs(found - expected).max())
            if not off <= _ROUNDING * max(1.0, float(np.abs(expected).max())):
                miss = max(miss, off / max(float(np.ptp(expected, axis=0).max()), _ROUNDING))
    return miss


def _aim(optic: Any, field: _Field, source: PupilSource, middle: np.ndarray, wavelength: float) -> Aim:
    """Return what rays of a wavelength add to the plain source's rays."""
    pupil = _in_pupil(_RINGS, _TURNS, 0.13)
    starts, directions = _rays(optic, field, pupil, wavelength)
    plain_starts, plain_directions = source.local_rays(pupil, np.full(len(pupil), np.nan))
    columns = np.concatenate([(starts - middle[:3] - plain_starts)[:, :2],
                              directions[:, :2] / directions[:, 2:] - plain_directions[:, :2] / plain_directions[:, 2:]], axis=1)
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    terms = np.stack([pupil[:, 0]**i * pupil[:, 1]**j for i, j in powers], axis=1)
    # What no ray adds beyond rounding is nothing, so that parallel rays stay parallel.
    found = np.linalg.lstsq(terms, columns, rcond=None)[0] * (np.abs(columns).max(axis=0) > _ROUNDING)
    tables = [[[float(column[powers.index((i, j))]) for j in range(_ORDER + 1 - i)] for i in range(_ORDER + 1)] if column.any() else []
              for column in found.T]
    return Aim(wavelength, *tables)


def _aiming(optic: Any) -> str:
    return str(getattr(optic.ray_tracer, "ray_aiming_config", {}).get("mode", "unknown"))
