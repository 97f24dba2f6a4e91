"""What a conversion carried beside radii, distances and glasses, and from which surface."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from nsq_gpu.coatings import TabulatedCoating
from nsq_gpu.convert.forms import Form
from nsq_gpu.convert.prescription import Face, name_of
from nsq_gpu.convert.report import Carried, LensReport
from nsq_gpu.frames import angles_of, placed
from nsq_gpu.shapes import Aperture

#: What reports call the shapes that are no conics.
_SHAPES = {"EvenAsphere": "even asphere", "OddAsphere": "odd asphere", "Biconic": "biconic", "Toroidal": "toroid",
           "Polynomial": "XY polynomial", "Chebyshev": "Chebyshev surface", "Zernike": "Zernike surface"}
#: Nearer to the axis than that a surface is on it [mm], and turned by less than that it is straight.
_ON_AXIS = 1e-12


def parts(optic: Any, faces: list[Face], report: LensReport) -> list[Carried]:
    """Return what was carried of each surface, in the order of the surfaces."""
    surfaces = optic.surfaces.surfaces
    found: list[Carried] = []

    def add(index: int, component: str, kinds: Iterator[tuple[str, str]]) -> None:
        place = (name_of(surfaces[index], index),)
        found.extend(Carried(index, kind, component, what, place) for kind, what in kinds)

    for face in faces:
        names = report.components.get(face.index)
        if names:
            add(face.index, names[0], _of_face(face))
    add(len(surfaces) - 1, "image", _of_frame(*placed(optic.image_surface.geometry.cs)))
    return found


def _of_face(face: Face) -> Iterator[tuple[str, str]]:
    """Yield kind and description of each part of a face."""
    shape = _shape(face.form)
    if shape:
        yield "shape", shape
    yield from _of_frame(face.position, face.rotation)
    if isinstance(face.coating, TabulatedCoating):
        yield "coating", "coating by wavelength and angle"
    elif face.coating is not None:
        transmittance, reflectance = float(face.coating.transmittance), float(face.coating.reflectance)
        yield "coating", f"coating, T = {transmittance:.6g}, R = {reflectance:.6g}"
    if isinstance(face.stated, Aperture):
        yield "aperture", f"aperture, {face.stated.outline}"
    elif face.stated is not None:
        yield "aperture", f"aperture, disk of radius {face.stated:.6g} mm"


def _of_frame(position: np.ndarray, rotation: np.ndarray) -> Iterator[tuple[str, str]]:
    """Yield the decentre and the tilt of a frame, against the frame of the whole prescription."""
    if np.abs(position[:2]).max() > _ON_AXIS:
        yield "decentre", f"decentre, x = {_rounded(position[0]):.6g} mm, y = {_rounded(position[1]):.6g} mm"
    if np.abs(rotation - np.eye(3)).max() > _ON_AXIS:
        angles = ", ".join(f"{axis} = {_rounded(math.degrees(angle)):.6g}"
                           for axis, angle in zip(("rx", "ry", "rz"), angles_of(rotation), strict=True))
        yield "tilt", f"tilt, {angles} degrees"


def _rounded(value: float) -> float:
    """Return a number without the rounding of frames, and 0 without a sign."""
    return round(float(value), 12) + 0.0


def _shape(form: Form) -> str:
    """Return what a shape is that is neither a sphere nor a plane; an empty text for those."""
    if form.is_conic:
        return f"conic constant {form.conic:.6g}" if form.conic and not form.is_flat else ""
    numbers = dict(form.numbers)
    coefficients = numbers.get("coefficients", numbers.get("coeffs_poly_y", ()))
    count = sum(value != 0.0 for row in coefficients for value in (row if isinstance(row, tuple) else (row,)))
    what = _SHAPES[form.kind.__name__]
    return what if not count else f"{what}, {count} coefficient{'s' if count > 1 else ''}"
