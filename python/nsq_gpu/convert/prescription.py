"""Reads an Optic: what is at each surface, where rays of all fields meet it, and whether it can be carried at all."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coatings import BaseCoatingPolarized, FresnelCoating, SimpleCoating, ThinFilmCoating
from optiland.coordinate_system import CoordinateSystem
from optiland.interactions.refractive_reflective_model import RefractiveReflectiveModel
from optiland.nonsequential import NSQMaterial
from optiland.physical_apertures import (
    DifferenceAperture,
    EllipticalAperture,
    FileAperture,
    IntersectionAperture,
    OffsetRadialAperture,
    PolygonAperture,
    RadialAperture,
    RectangularAperture,
    UnionAperture,
)

from nsq_gpu.coatings import TabulatedCoating
from nsq_gpu.convert.forms import Form, form_of
from nsq_gpu.errors import UnsupportedSceneError
from nsq_gpu.frames import frame, number_of, placed
from nsq_gpu.lensfiles.system import moved_in_pupil
from nsq_gpu.shapes import ENDLESS, Aperture

#: Apertures made of two others.
_COMBINED = {UnionAperture: "union", IntersectionAperture: "intersection", DifferenceAperture: "difference"}
_APERTURES = (RadialAperture, OffsetRadialAperture, EllipticalAperture, RectangularAperture, PolygonAperture, FileAperture, *_COMBINED)
#: How deep apertures may be made of apertures, and the most corners of a polygon, in a scene.
_DEEPEST, _MOST_CORNERS = 16, 4096

#: Directions in the pupil along which its outermost ray is looked for, and shares of that ray's place that are traced.
_TURNS = 64
_SHARES = (1.0, 0.9, 0.75, 0.6, 0.45, 0.3, 0.15)
#: Halvings of the search for the outermost ray that reaches the image, where the rim's does not.
_HALVINGS = 20
#: Indices of refraction closer to 1 than that are a vacuum's.
_VACUUM = 1e-12
#: Indices of a coating's media that differ by less from the surface's are meant to be the same.
_SAME_INDEX = 1e-6


@dataclass
class Face:
    """A surface of the prescription, in its own frame, whose vertex is the origin and whose z is the axis. Lengths in mm."""

    index: int
    #: What errors call it.
    place: str
    position: np.ndarray
    rotation: np.ndarray
    #: Its shape without the aperture.
    form: Form
    is_stop: bool
    is_mirror: bool
    #: True if light runs towards +z of the frame before the surface.
    is_forward: bool
    #: Media before and behind it along the light; None is vacuum.
    before: NSQMaterial | None
    behind: NSQMaterial | None
    #: Optiland's own, or a table of it whose front is the side of -z of the frame.
    coating: SimpleCoating | TabulatedCoating | None
    #: The stated aperture, beyond which light is absorbed: a disk's radius, or what is no disk about the axis.
    stated: float | Aperture | None
    #: The largest distance from the axis of any ray that reaches the image.
    ray_radius: float

    @property
    def does_nothing(self) -> bool:
        """Return whether light passes it as if it were not there: media are the same, and no aperture clips."""
        return not self.is_mirror and self.before is self.behind

    @property
    def clips(self) -> bool:
        """Return whether it absorbs the light beside its opening."""
        return self.is_stop or self.stated is not None

    def frame(self) -> CoordinateSystem:
        """Return its frame for Optiland."""
        return frame(self.position, self.rotation)


@dataclass
class Rays:
    """Rays of all fields and wavelengths, at every surface: global places [mm], shape (surfaces, rays, 3)."""

    places: np.ndarray
    directions: np.ndarray
    #: True of rays that reach the image.
    arrive: np.ndarray


def acting(faces: list[Face], image: int, first: int | None = None) -> Iterator[tuple[int, int]]:
    """Yield the indices of surfaces that light goes between: those that do something to it, from the first to the image."""
    indices = [*([] if first is None else [first]), *(face.index for face in faces if not face.does_nothing), image]
    return itertools.pairwise(indices)


@contextmanager
def in_double() -> Iterator[None]:
    """Compute in float64 and without a graph, whatever Optiland is set to: a lens is then the same lens."""
    if be.get_backend() != "torch":
        yield
        return
    import torch

    precision, wants_gradient = be.get_precision(), be.grad_mode.requires_grad
    be.set_precision("float64")
    be.grad_mode.disable()
    try:
        with torch.no_grad():
            yield
    finally:
        be.set_precision(f"float{precision}")
        be.grad_mode.requires_grad = wants_gradient


@contextmanager
def without_polarised_coatings(optic: Any) -> Iterator[list[Any]]:
    """Trace without coatings that the sequential engine cannot ask for a number, or only with a state of polarisation: they
    bend no ray. Yield the coatings of all surfaces."""
    models = [surface.interaction_model for surface in optic.surfaces.surfaces]
    kept = [getattr(model, "coating", None) for model in models]
    stripped = [(model, coating) for model, coating in zip(models, kept, strict=True) if isinstance(coating, BaseCoatingPolarized | TabulatedCoating)]
    try:
        for model, _ in stripped:
            model.coating = None
        yield kept
    finally:
        for model, coating in stripped:
            model.coating = coating


def read(optic: Any, coatings: list[Any]) -> tuple[list[Face], Rays]:
    """Return all surfaces between object and image, which have these coatings, and the rays that were traced.

    Raises:
        UnsupportedSceneError: A surface, a field or a setting has no place in a scene, by name.
    """
    _check(optic)
    _check_coatings(optic, coatings)
    surfaces = optic.surfaces.surfaces
    rays = _rays(optic)
    media = _Media(optic)
    faces = [_face(surfaces, index, coatings[index], rays, media) for index in range(1, len(surfaces) - 1)]
    for face in faces:
        if face.does_nothing and face.coating is not None:
            raise UnsupportedSceneError(f"{face.place}: its coating lies between equal media, where a scene has no face; put it on "
                                        "a face of glass")
    return faces, rays


def _check(optic: Any) -> None:
    if getattr(optic.polarization, "is_polarized", False):
        raise UnsupportedSceneError("the light's polarisation: rays of a scene carry none; set an unpolarised state, or "
                                    'optic.set_polarization("ignore")')
    image = optic.surfaces.surfaces[-1]
    if image.aperture is not None:
        raise _on_image("aperture", image.aperture)
    if optic.apodization:
        raise UnsupportedSceneError(f"the pupil's apodisation ({type(optic.apodization).__name__}): a source of a scene "
                                    "fills the pupil uniformly; set optic.apodization to None")
    for index, surface in enumerate(optic.surfaces.surfaces[1:-1], start=1):
        place = name_of(surface, index)
        form_of(surface.geometry, place)
        model = surface.interaction_model
        if type(model) is not RefractiveReflectiveModel:
            raise UnsupportedSceneError(f"{place}: a {type(model).__name__} has no place in a scene; only refracting and "
                                        "reflecting surfaces have")
        if model.bsdf is not None:
            raise UnsupportedSceneError(f"{place}: its BSDF ({type(model.bsdf).__name__}) cannot be carried; give one to "
                                        "the scene's component")
        _check_aperture(surface.aperture, place)


def _check_aperture(aperture: Any, place: str, depth: int = 0) -> None:
    if type(aperture) not in (type(None), *_APERTURES):
        raise UnsupportedSceneError(f"{place}: its aperture ({type(aperture).__name__}) cannot be carried; disks, rings, ellipses, "
                                    "rectangles, polygons, and unions, intersections and differences of these can")
    if type(aperture) in _COMBINED:
        for part in (aperture.a, aperture.b):
            _check_aperture(part, place, depth + 1)
    if depth > _DEEPEST:
        raise UnsupportedSceneError(f"{place}: its aperture is made of apertures more than {_DEEPEST} deep")
    corners = len(be.to_numpy(aperture.x)) if type(aperture) in (PolygonAperture, FileAperture) else 0
    if corners > _MOST_CORNERS:
        raise UnsupportedSceneError(f"{place}: its aperture has {corners} corners; {_MOST_CORNERS} can be carried")


def _on_image(what: str, value: Any) -> UnsupportedSceneError:
    return UnsupportedSceneError(f"the image's {what} ({type(value).__name__}) cannot be carried; remove it, or put it on a surface "
                                 "before the image")


def _check_coatings(optic: Any, coatings: list[Any]) -> None:
    if coatings[-1] is not None:
        raise _on_image("coating", coatings[-1])
    for index, surface in enumerate(optic.surfaces.surfaces[1:-1], start=1):
        known = (type(None), SimpleCoating, ThinFilmCoating, TabulatedCoating)
        if not surface.interaction_model.is_reflective:
            known += (FresnelCoating,)
        kind = type(coatings[index])
        if kind not in known:
            raise UnsupportedSceneError(f"{name_of(surface, index)}: a {kind.__name__} cannot be carried; a SimpleCoating, a "
                                        "ThinFilmCoating and a TabulatedCoating can, and bare glass reflects by Fresnel's law")


def name_of(surface: Any, index: int) -> str:
    """Return what errors and reports call a surface."""
    return f"surface {index}" + (f" ({surface.comment})" if surface.comment else "")


def _rays(optic: Any) -> Rays:
    """Trace rays all over the part of the pupil from which light reaches the image, of all fields and wavelengths."""
    turn = 2.0 * math.pi * np.arange(_TURNS) / _TURNS
    across = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    traced: list[Rays] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for hx, hy, field in fields_of(optic):
            for line in optic.wavelengths.wavelengths:

                def at(pupil: np.ndarray, hx: float = hx, hy: float = hy, field: Any = field, line: Any = line) -> Rays:
                    return trace(optic, rays_of(optic, hx, hy, field, pupil, float(line.value)))

                outermost = _outermost(at, across)
                # At once, since aiming takes its time.
                traced.append(at(np.concatenate([*(share * outermost for share in _SHARES), np.zeros((1, 2)), across])))
    found = Rays(np.concatenate([rays.places for rays in traced], axis=1),
                 np.concatenate([rays.directions for rays in traced], axis=1),
                 np.concatenate([rays.arrive for rays in traced]))
    if not found.arrive.any():
        raise UnsupportedSceneError("no ray of any field reaches the image, so nothing says how large the surfaces are")
    return found


def _outermost(at: Callable[[np.ndarray], Rays], across: np.ndarray) -> np.ndarray:
    """Return the outermost points of the pupil, along each direction, whose rays reach the image."""
    known, missing = np.zeros((len(across), 1)), np.ones((len(across), 1))
    arrive = at(across).arrive[:, None]
    known = np.where(arrive, 1.0, known)
    for _ in range(_HALVINGS):
        if arrive.all():
            break
        middle = np.where(arrive, 1.0, 0.5 * (known + missing))
        reach = at(middle * across).arrive[:, None]
        known, missing = np.where(reach, middle, known), np.where(reach, missing, middle)
    return known * across


def fields_of(optic: Any) -> Iterator[tuple[float, float, Any]]:
    """Yield each field's coordinates, as shares of the largest field, and the field."""
    largest = number_of(optic.fields.max_field) or 1.0
    for field in optic.fields.fields:
        yield number_of(field.x) / largest, number_of(field.y) / largest, field


def rays_of(optic: Any, hx: float, hy: float, field: Any, pupil: np.ndarray, wavelength: float) -> Any:
    """Return Optiland's rays of a field through points of the pupil, shape (N, 2), before the first surface."""
    pupil = moved_in_pupil(optic, field, pupil)
    return optic.ray_tracer.ray_generator.generate_rays(hx, hy, be.array(pupil[:, 0]), be.array(pupil[:, 1]), wavelength)


def trace(optic: Any, rays: Any) -> Rays:
    """Trace Optiland's rays through a prescription by its sequential engine."""
    surfaces = optic.surfaces.surfaces
    optic.surfaces.trace(rays)
    count = len(be.to_numpy(surfaces[-1].x))

    def all_of(names: str) -> np.ndarray:
        # The surface of the object may have recorded one ray for all.
        columns = [[np.broadcast_to(be.to_numpy(getattr(surface, name)), count) for name in names] for surface in surfaces]
        return np.moveaxis(np.array(columns, dtype=float), 1, -1)

    places = all_of("xyz")
    arrive = (be.to_numpy(surfaces[-1].intensity) > 0.0) & np.isfinite(places[1:]).all(axis=(0, 2))
    return Rays(places, all_of("LMN"), arrive)


def _face(surfaces: list[Any], index: int, coating: Any, rays: Rays, media: _Media) -> Face:
    surface = surfaces[index]
    position, rotation = placed(surface.geometry.cs)
    local = (rays.places[index][rays.arrive] - position) @ rotation
    # Directions are those behind a surface: those before it stand at the one before.
    came = rays.directions[index - 1][rays.arrive] @ rotation
    mirror = bool(surface.interaction_model.is_reflective)
    before = media.of(surfaces[index - 1].material_post)
    is_forward = float(np.median(came[:, 2])) > 0.0
    return Face(
        index=index,
        place=name_of(surface, index),
        position=position,
        rotation=rotation,
        form=form_of(surface.geometry, name_of(surface, index)),
        is_stop=bool(surface.is_stop),
        is_mirror=mirror,
        is_forward=is_forward,
        before=before,
        behind=before if mirror else media.of(surface.material_post),
        coating=_coating(surfaces, index, coating, media, is_forward),
        stated=_stated_or_none(surface),
        ray_radius=float(np.hypot(local[:, 0], local[:, 1]).max()),
    )


def _coating(surfaces: list[Any], index: int, coating: Any, media: _Media, is_forward: bool) -> SimpleCoating | TabulatedCoating | None:
    surface = surfaces[index]
    if type(coating) is TabulatedCoating:
        return coating if is_forward else coating.reversed()
    if type(coating) is not ThinFilmCoating:
        return coating if type(coating) is SimpleCoating else None
    sides = [("before", coating.material_pre, surfaces[index - 1].material_post)]
    if not surface.interaction_model.is_reflective:
        sides.append(("behind", coating.material_post, surface.material_post))
    for side, assumed, real in sides:
        difference = float(np.abs(media.indices(assumed) - media.indices(real)).max())
        if difference > _SAME_INDEX:
            raise UnsupportedSceneError(f"{name_of(surface, index)}: its ThinFilmCoating was designed for another medium {side} the "
                                        f"surface, whose index differs by {difference:.3g}; give it the surface's own")
    # Light comes from the first medium of the coating.
    table = TabulatedCoating.from_coating(coating, np.unique(media.wavelengths))
    return table if is_forward else table.reversed()


def _stated_or_none(surface: Any) -> float | Aperture | None:
    return _stated(surface.aperture) if type(surface.aperture) in _APERTURES else None


def _stated(aperture: Any) -> float | Aperture | None:
    """Return the radius of a disk about the axis, another aperture, or None for one without an end."""
    if type(aperture) in _COMBINED:
        one, other = (_combinable(_stated(part)) for part in (aperture.a, aperture.b))
        return Aperture(_COMBINED[type(aperture)], parts=(one, other))
    if type(aperture) in (PolygonAperture, FileAperture):
        corners = np.stack([be.to_numpy(aperture.x), be.to_numpy(aperture.y)], axis=1).astype(float)
        return Aperture("polygon", vertices=tuple(map(tuple, corners.tolist())))
    if type(aperture) is RectangularAperture:
        x, y = (tuple(min(max(number_of(getattr(aperture, f"{axis}_{end}")), -ENDLESS), ENDLESS) for end in ("min", "max"))
                for axis in "xy")
        return Aperture("rectangle", 0.5 * (x[1] - x[0]), 0.5 * (y[1] - y[0]), 0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]))
    middle = [number_of(getattr(aperture, f"offset_{axis}", 0.0)) for axis in "xy"]
    if type(aperture) is EllipticalAperture:
        return Aperture("ellipse", min(number_of(aperture.a), ENDLESS), min(number_of(aperture.b), ENDLESS), *middle)
    radius, hole = number_of(aperture.r_max), number_of(aperture.r_min)
    if hole <= 0.0 and middle == [0.0, 0.0]:
        return radius if radius < ENDLESS else None
    return Aperture("ellipse", min(radius, ENDLESS), min(radius, ENDLESS), *middle, max(hole, 0.0))


def _combinable(stated: float | Aperture | None) -> Aperture:
    if isinstance(stated, Aperture):
        return stated
    radius = ENDLESS if stated is None else stated
    return Aperture("ellipse", radius, radius)


class _Media:
    """One medium of the scene for each material of the prescription that is one."""

    def __init__(self, optic: Any) -> None:
        self.wavelengths = np.array([float(line.value) for line in optic.wavelengths.wavelengths])
        self._known: list[tuple[Any, np.ndarray, NSQMaterial | None]] = []

    def indices(self, material: Any) -> np.ndarray:
        """Return n at the wavelengths of the prescription."""
        return np.broadcast_to(be.to_numpy(material.n(be.array(self.wavelengths))).astype(float).ravel(), self.wavelengths.shape)

    def of(self, material: Any) -> NSQMaterial | None:
        n, k = (np.broadcast_to(be.to_numpy(part).astype(float).ravel(), self.wavelengths.shape)
                for part in (material.n(be.array(self.wavelengths)), material.k(be.array(self.wavelengths))))
        numbers = np.stack([n, k])
        for known, its, medium in self._known:
            if known is material or (type(known) is type(material) and np.array_equal(its, numbers)):
                return medium
        is_vacuum = bool((np.abs(n - 1.0) < _VACUUM).all() and (k == 0.0).all())
        medium = None if is_vacuum else NSQMaterial(optiland_material=material)
        self._known.append((material, numbers, medium))
        return medium
