"""Turns Optiland's sequential samples into scene parts.

Few samples pass ``sequential_to_nonsequential``: it refuses an air-spaced stop, and its watertightness check refuses
every element whose rim centroid lies outside the glass, which is most menisci and thin negative elements. The others
are written as raw surfaces: conic faces, cone edges, and an annulus for the stop.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from optiland.materials import IdealMaterial
from optiland.nonsequential import NSQMaterial
from optiland.nonsequential.convert import sequential_to_nonsequential
from optiland.nonsequential.serialization import scene_to_dict
from optiland.optic import Optic

from tools import nouns
from tools.nouns import Json

#: Clear aperture over the outermost real ray.
APERTURE_MARGIN = 1.03
#: Outer radius of a stop's annulus over its opening.
STOP_RIM = 4.0


@dataclass
class Parts:
    """What a prescription contributes to a scene file."""

    surfaces: list[Json]
    media: Json
    image_z: float
    pupil_z: float
    pupil_radius: float
    wavelengths: list[float]


def converted_components(optic: Optic) -> list[Json]:
    """Return the v1 components that Optiland's own converter makes of a sample."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return scene_to_dict(sequential_to_nonsequential(optic))["components"]


def raw_parts(optic: Optic, *, tables: bool = False) -> Parts:
    """Return a sample as raw surfaces; ``tables`` writes every glass as a table over the sample's wavelengths."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        radii = APERTURE_MARGIN * _ray_extents(optic)
        wavelengths = [float(line.value) for line in optic.wavelengths.wavelengths]
        media = _Media(wavelengths, tables)
        surfaces = _surfaces(optic, radii, media)
        return Parts(
            surfaces=surfaces,
            media=media.table,
            image_z=_vertex_z(optic.image_surface),
            pupil_z=_vertex_z(optic.surfaces.surfaces[1]) + float(np.squeeze(optic.paraxial.EPL())),
            pupil_radius=float(np.squeeze(optic.paraxial.EPD())) / 2.0,
            wavelengths=wavelengths,
        )


def _ray_extents(optic: Optic) -> np.ndarray:
    """Return the largest distance from the axis of any traced ray, per surface [mm]."""
    extents = np.zeros(len(optic.surfaces.surfaces))
    for field_x, field_y in optic.fields.get_field_coords():
        optic.trace(Hx=field_x, Hy=field_y, wavelength=optic.primary_wavelength, num_rays=12, distribution="hexapolar")
        extents = np.maximum(extents, np.nanmax(np.hypot(optic.surfaces.x, optic.surfaces.y), axis=1))
    return extents


class _Media:
    """Names the glasses of a prescription: a catalog entry where its name alone gives the same n and k."""

    def __init__(self, wavelengths: list[float], tables: bool) -> None:
        self._wavelengths = wavelengths
        self._tables = tables
        self.table: Json = {}

    def value(self, material: Any) -> Any:
        if isinstance(material, IdealMaterial):
            index, extinction = float(material.index.item()), float(material.absorp.item())
            return None if index == 1.0 else self._named(f"n{index:g}", nouns.constant(index, extinction))
        n, k = self._listed(material)
        if not self._tables and self._listed(NSQMaterial.from_glass(material.name)) == (n, k):
            return nouns.catalog(material.name)
        return self._named(material.name, {"type": "table", "wavelengths": self._wavelengths, "n": n, "k": k})

    def _named(self, name: str, spec: Json) -> Json:
        self.table[name] = spec
        return nouns.medium(name)

    def _listed(self, material: Any) -> tuple[list[float], list[float]]:
        lines = np.array(self._wavelengths)
        n, k = material.n(lines), np.broadcast_to(material.k(lines), lines.shape)
        return [float(v) for v in n], [float(v) for v in k]


def _surfaces(optic: Optic, radii: np.ndarray, media: _Media) -> list[Json]:
    """Faces and edges in the order of the light, then the stop."""
    sequence = optic.surfaces.surfaces
    faces: list[Json] = []
    stops: list[Json] = []
    for i in range(1, len(sequence) - 1):
        front, back = (media.value(sequence[j].material_post) for j in (i - 1, i))
        if front is None and back is None:
            stops.append(_stop(sequence[i], float(radii[i])))
            continue
        shape = nouns.conic(*_curve(sequence[i]), float(radii[i]))
        faces.append(nouns.surface(f"face_{i}", nouns.cs(z=_vertex_z(sequence[i])), shape, "refractive", front, back))
        if back is not None:
            faces.append(_edge(i, sequence, radii))
    return faces + stops


def _stop(surface: Any, radius: float) -> Json:
    opening = radius / APERTURE_MARGIN
    shape = nouns.annulus(opening, STOP_RIM * opening)
    return nouns.surface("stop", nouns.cs(z=_vertex_z(surface)), shape, "absorbing")


def _edge(i: int, sequence: list[Any], radii: np.ndarray) -> Json:
    """The absorbing cone from the rim of face i to the rim of the next."""
    rims = [_vertex_z(sequence[j]) + _sag(*_curve(sequence[j]), float(radii[j])) for j in (i, i + 1)]
    if rims[0] >= rims[1]:
        raise ValueError(f"the element after surface {i} has no edge: its faces meet inside the aperture")
    shape = nouns.frustum(float(radii[i]), float(radii[i + 1]), rims[0], rims[1])
    return nouns.surface(f"edge_{i}", nouns.cs(), shape, "absorbing")


def _vertex_z(surface: Any) -> float:
    return float(np.squeeze(surface.geometry.cs.z))


def _curve(surface: Any) -> tuple[float, float]:
    return float(surface.geometry.radius), float(getattr(surface.geometry, "k", 0.0))


def _sag(radius: float, conic: float, height: float) -> float:
    if not math.isfinite(radius):
        return 0.0
    return height**2 / (radius * (1.0 + math.sqrt(1.0 - (1.0 + conic) * (height / radius) ** 2)))
