"""What a lens file says, free of its format: surfaces in millimetres, frames, light; and Optiland's Optic of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from optiland.fields import Field
from optiland.optic import Optic
from optiland.physical_apertures import (
    DifferenceAperture,
    EllipticalAperture,
    OffsetRadialAperture,
    PolygonAperture,
    RadialAperture,
    RectangularAperture,
)
from optiland.physical_apertures.base import BaseAperture

from nsq_gpu.frames import angles_of, number_of
from nsq_gpu.lensfiles.cards import Card, Reading
from nsq_gpu.lensfiles.glasses import index_of
from nsq_gpu.shapes import ENDLESS

#: A distance beyond that is infinite, in units of the file.
INFINITE = 1e10


@dataclass(eq=False)
class FileSurface:
    """A surface of a file. Lengths in mm, in the surface's own frame, whose origin is the vertex."""

    #: The card that begins it, and its number in the file.
    card: Card
    number: int
    comment: str = ""
    #: One of Optiland's surface types, and the numbers that it takes.
    shape: str = "standard"
    numbers: dict[str, Any] = field(default_factory=lambda: {"radius": math.inf, "conic": 0.0})
    #: Optiland's material behind it, "air" or "mirror".
    material: Any = "air"
    coating: Any = None
    aperture: BaseAperture | None = None
    is_stop: bool = False
    #: The distance to the next surface along its axis [mm].
    thickness: float = 0.0
    #: Its place [mm] and axes, the columns of a rotation.
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))


class VignettedField(Field):
    """A field whose pupil is compressed, as Optiland has it, and moved besides.

    The point p of the unit disk becomes ``(decenter_x + (1 - vx) p_x, decenter_y + (1 - vy) p_y)`` in units of the pupil's radius.
    """

    def __init__(self, x: float, y: float, vx: float, vy: float, weight: float, decenter_x: float, decenter_y: float) -> None:
        super().__init__(x, y, vx, vy, weight)
        self.decenter_x, self.decenter_y = decenter_x, decenter_y


def moved_in_pupil(optic: Any, field: Field, pupil: np.ndarray) -> np.ndarray:
    """Return the points of the pupil that Optiland is to aim at, so that a field's pupil is compressed and moved: shape (N, 2).

    Optiland compresses a paraxial pupil itself, and leaves a pupil as it is where it aims at the stop.
    """
    if not isinstance(field, VignettedField):
        return pupil
    open_share = np.array([1.0 - field.vx, 1.0 - field.vy])
    moved = pupil * open_share + [field.decenter_x, field.decenter_y]
    return moved / open_share if optic.ray_tracer.ray_aiming_config["mode"] == "paraxial" else moved


@dataclass
class FileField:
    """A field of a file: degrees, or mm."""

    x: float = 0.0
    y: float = 0.0
    weight: float = 1.0
    #: How much the pupil is compressed and moved, as shares of its radius.
    compress: tuple[float, float] = (0.0, 0.0)
    decenter: tuple[float, float] = (0.0, 0.0)


@dataclass
class System:
    """All of a file that a scene needs."""

    name: str | None = None
    surfaces: list[FileSurface] = field(default_factory=list)
    #: Kind and value: "EPD" [mm], "stop_radius" [mm], "image_fno" (f / EPD), "working_fno" (by the slope at the image), "image_na"
    #: (by the sine there), "object_na", "object_cone" (half the angle, degrees).
    aperture: tuple[str, float] = ("EPD", 0.0)
    #: The card that states the aperture.
    aperture_card: Card | None = None
    field_type: str = "angle"
    fields: list[FileField] = field(default_factory=list)
    #: Wavelengths [um] and weights.
    wavelengths: list[tuple[float, float]] = field(default_factory=list)
    primary: int = 0
    is_telecentric: bool = False
    aims_at_stop: bool = False

    def check(self, reading: Reading) -> None:
        """Refuse an incomplete lens; leave out apertures and coatings of the object and the image."""
        if len(self.surfaces) < 3:
            reading.broken(f"cannot read it as a lens: there are {len(self.surfaces)} surfaces; an object, a face and "
                           "an image are the fewest")
        if not self.wavelengths:
            reading.broken("cannot read it as a lens: it states no wavelength")
        if self.aperture_card is None:
            reading.broken("cannot read it as a lens: it states no aperture, such as the diameter of the pupil")
        for one in self.surfaces:
            if not (math.isfinite(one.thickness) or one is self.surfaces[0]):
                one.card.broken("its thickness is infinite; only the object's may be")
        first = self.surfaces[0]
        if first.material == "mirror":
            first.card.broken("the object is a mirror; a surface behind it must be")
        if not first.thickness > -math.inf or first.thickness == 0.0:
            first.card.broken(f"the object's distance is {first.thickness:g}; write one above 0, or an infinite one")
        if self.is_telecentric and self.field_type == "angle":
            first.card.broken("object space is telecentric, but fields are angles; give heights of the object")
        for index, one in enumerate(self.fields):
            for other in self.fields[:index]:
                if (one.x, one.y) == (other.x, other.y) and (one.compress, one.decenter) != (other.compress, other.decenter):
                    reading.broken(f"cannot read it as a lens: field {index + 1} is in the place of an earlier one, with other "
                                   "vignetting factors; move one of them a little")
        image = self.surfaces[-1]
        if image.aperture is not None or image.coating is not None:
            reading.remark(image.card, "the image's aperture or coating was left out: its detector takes all light")
            image.aperture = image.coating = None
        if first.aperture is not None or first.coating is not None:
            reading.remark(first.card, "the object's aperture or coating was left out: the light of a field comes from one point")
            first.aperture = first.coating = None

    def optic(self, reading: Reading) -> Any:
        """Return Optiland's Optic."""
        optic = Optic(self.name)
        for index, given in enumerate(self.surfaces):
            distance = float(given.position[2])
            pose = dict(zip(("x", "y", "z", "rx", "ry", "rz"), (*given.position[:2], distance, *angles_of(given.rotation)), strict=True))
            optic.surfaces.add(index=index, surface_type=given.shape, comment=given.comment, material=given.material,
                               is_stop=given.is_stop, aperture=given.aperture, coating=given.coating,
                               **{key: float(value) for key, value in pose.items()}, **given.numbers)
            optic.surfaces.surfaces[index].thickness = given.thickness
            self._check_indices(given, reading)
        optic.fields.set_type(self.field_type)
        for one in self.fields:
            optic.fields.fields.append(VignettedField(one.x, one.y, *one.compress, one.weight, *one.decenter))
        for index, (wavelength, weight) in enumerate(self.wavelengths):
            optic.wavelengths.add(value=wavelength, is_primary=index == self.primary, weight=weight)
        optic.set_aperture(*self._optilands_aperture(optic))
        if self.is_telecentric:
            optic.obj_space_telecentric = True
        if self.aims_at_stop:
            optic.ray_tracer.set_aiming("robust", cache=True)
        return optic

    def _finite(self, value: float) -> float:
        if not (math.isfinite(value) and value > 0.0):
            self.aperture_card.broken("the lens is afocal, so an aperture at the image says nothing of the pupil; state its diameter")
        return value

    def _check_indices(self, given: FileSurface, reading: Reading) -> None:
        """Refuse a material that has no index at a wavelength of the file; say where its formula is used beyond its range."""
        if isinstance(given.material, str):
            return
        lowest, highest = getattr(given.material, "covers", (0.0, math.inf))
        beyond = [f"{wavelength:g}" for wavelength, _ in self.wavelengths if not lowest <= wavelength <= highest]
        if beyond:
            reading.remark(given.card, f"the index of {given.material.name} at {', '.join(beyond)} um is extrapolated: its catalogue has it from {lowest:g} to "
                           f"{highest:g} um")
        for wavelength, _ in self.wavelengths:
            try:
                index = index_of(given.material, wavelength)
            except Exception:
                index = math.nan
            if not math.isfinite(index):
                given.card.broken(f"the glass {getattr(given.material, 'name', '')!r} has no index at {wavelength:g} um; give another glass or wavelength")

    def _optilands_aperture(self, optic: Any) -> tuple[str, float]:
        kind, value = self.aperture
        is_far = not math.isfinite(self.surfaces[0].thickness)

        def index(place: int) -> float:
            material = optic.surfaces.surfaces[place].material_pre if place else optic.surfaces.surfaces[0].material_post
            return number_of(material.n(optic.primary_wavelength))

        if kind == "EPD":
            return "EPD", value
        if kind == "stop_radius":
            return "float_by_stop_size", 2.0 * value
        if kind == "image_fno":
            return "imageFNO", value
        if kind == "object_na":
            return "objectNA", value
        if kind == "object_cone":
            return "objectNA", index(0) * math.sin(math.radians(value))
        # Those at the image: f / EPD for a far object, and the object's NA by the magnification for a near one.
        aperture = 0.5 / value if kind == "working_fno" else value
        optic.set_aperture("EPD", 1.0)
        if is_far:
            return "EPD", self._finite(2.0 * abs(number_of(optic.paraxial.f2())) * aperture / index(-1))
        at_object = self._finite(abs(number_of(optic.paraxial.magnification())) * aperture)
        return "objectNA", index(0) * math.sin(math.atan(at_object / index(0))) if kind == "working_fno" else at_object


def rotation_about(axis: int, degrees: float) -> np.ndarray:
    """Return a right-handed rotation about x (0), y (1) or z (2)."""
    turn = math.radians(degrees)
    # Quarter turns are exact.
    cos, sin = (round(math.cos(turn)), round(math.sin(turn))) if degrees % 90.0 == 0.0 else (math.cos(turn), math.sin(turn))
    one, other = (axis + 1) % 3, (axis + 2) % 3
    found = np.eye(3)
    found[one, one] = found[other, other] = cos
    found[one, other], found[other, one] = -sin, sin
    return found


def tilted(angles: Sequence[float], *, reverse: bool = False) -> np.ndarray:
    """Return the axes of a frame that is turned about its x, then its new y, then its new z; by z, y, x if reversed. Degrees."""
    x, y, z = (rotation_about(axis, angle) for axis, angle in enumerate(angles))
    return z @ y @ x if reverse else x @ y @ z


# Apertures


def disk(radius: float, hole: float = 0.0, x: float = 0.0, y: float = 0.0) -> BaseAperture:
    """Return a disk [mm], with a hole in its middle."""
    if x == 0.0 and y == 0.0:
        return RadialAperture(r_max=radius, r_min=hole)
    return OffsetRadialAperture(r_max=radius, r_min=hole, offset_x=x, offset_y=y)


def rectangle(half_x: float, half_y: float, x: float = 0.0, y: float = 0.0, degrees: float = 0.0) -> BaseAperture:
    """Return a rectangle [mm], turned about its middle."""
    if degrees == 0.0:
        return RectangularAperture(x - half_x, x + half_x, y - half_y, y + half_y)
    corners = np.array([[-half_x, -half_y], [half_x, -half_y], [half_x, half_y], [-half_x, half_y]])
    corners = corners @ rotation_about(2, degrees)[:2, :2].T + [x, y]
    return PolygonAperture(corners[:, 0].tolist(), corners[:, 1].tolist())


def ellipse(half_x: float, half_y: float, x: float = 0.0, y: float = 0.0) -> BaseAperture:
    """Return an ellipse [mm]."""
    return EllipticalAperture(half_x, half_y, x, y)


def all_but(obstacle: BaseAperture) -> BaseAperture:
    """Return everything beside an obstacle."""
    return DifferenceAperture(RadialAperture(r_max=ENDLESS), obstacle)


def both(one: BaseAperture | None, other: BaseAperture | None) -> BaseAperture | None:
    """Return what two apertures let through; None lets everything through."""
    if one is None or other is None:
        return one or other
    return one & other
