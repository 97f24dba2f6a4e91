"""Prescriptions of lenses -> scenes.

>>> import nsq_gpu
>>> from optiland.samples.objectives import CookeTriplet
>>> scene = nsq_gpu.from_optic(CookeTriplet())
>>> print(scene.conversion_report.summary())
>>> scene.trace(1_000_000, backend=nsq_gpu.NsqGpuBackend())
"""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene
from optiland.nonsequential.bsdf.base import BaseBSDF
from optiland.optic import Optic

from nsq_gpu.arguments import wrong_kind
from nsq_gpu.convert import carried, obstructions, prescription
from nsq_gpu.convert.detector import add_detector
from nsq_gpu.convert.elements import build
from nsq_gpu.convert.fields import add_sources
from nsq_gpu.convert.report import LensReport
from nsq_gpu.convert.tensors import attach
from nsq_gpu.errors import NsqGpuError, UnsupportedSceneError, UsageError
from nsq_gpu.frames import placed
from nsq_gpu.lensfiles import read_lens
from nsq_gpu.lensfiles.origins import origins


def from_optic(optic: Any, *, detector_pixels: tuple[int, int] = (256, 256),
               detector_size: tuple[float, float] | None = None, edges: str | BaseBSDF = "absorbing",
               margin: float = 1.03) -> NSQScene:
    """Return a prescription as a scene: ``source_0`` and on, one a field; its lenses, mirrors and stops; and ``image``.

    Rays of the sequential engine go the same way in the scene. Faces without a stated aperture are as large as the rays of
    all fields need, times the margin. Light beside a stop, an aperture or a lens is absorbed, by its mount.

    Args:
        optic: Optiland's ``Optic``.
        detector_pixels: Pixels of the image along x and y.
        detector_size: Width and height of the image [mm]. None takes the image circle or the last element's width, whichever is
            larger; the report says which.
        edges: What the edges of lenses do: ``"absorbing"``, ``"polished"``, or a BSDF.
        margin: Radius of a face over the radius of its rays, where no aperture is stated.

    Returns:
        The scene; ``scene.conversion_report`` is a :class:`LensReport`. ``scene.elements`` lists lenses and mirrors, which move
        by names such as ``L4.y``, ``L4.rx`` and ``gap_3``.

    Raises:
        UnsupportedSceneError: A surface, an aperture, a coating or a field cannot be carried, by its name.
        UsageError: An argument makes no sense.
    """
    if not isinstance(optic, Optic):
        raise wrong_kind("optic", optic, "give Optiland's Optic, or the path of a file to nsq_gpu.from_file")
    if not isinstance(edges, BaseBSDF) and not (isinstance(edges, str) and edges in ("absorbing", "polished")):
        raise wrong_kind("edges", edges, "give 'absorbing', 'polished' or a BSDF")
    if not isinstance(margin, (int, float, np.number)) or not 1.0 <= margin < float("inf"):
        raise UsageError(f"margin is {margin!r}; give a number of 1 or more")
    _check_sizes(detector_pixels, detector_size)
    with prescription.in_double():
        scene = _scene(optic, detector_pixels, detector_size, edges, margin)
    attach(scene, optic, scene.conversion_report)
    return scene


def _scene(optic: Any, detector_pixels: tuple[int, int], detector_size: tuple[float, float] | None, edges: str | BaseBSDF,
           margin: float) -> NSQScene:
    """Return the scene of a prescription. None of its own numbers is a tensor that wants a gradient."""
    scene, report = NSQScene(), LensReport()
    try:
        with prescription.without_polarised_coatings(optic) as coatings:
            faces, rays = prescription.read(optic, coatings)
            _refuse_virtual(optic, rays, faces)
            add_sources(scene, optic, faces[0].before if faces else None, report)
    except NsqGpuError:
        raise
    except Exception as error:
        # Optiland's own, such as of an optic without a wavelength.
        raise UnsupportedSceneError(f"Optiland cannot trace this optic: {type(error).__name__}: {error}") from error
    faces = _before_image(optic, faces, report)
    elements, last = build(scene, faces, rays, edges, margin, report)
    add_detector(scene, optic, faces, rays, last, detector_pixels, detector_size, report)
    if elements and "behind" in elements[-1]:
        elements[-1]["behind"].append("image")
    scene.elements = elements
    report.carried = carried.parts(optic, faces, report)
    obstructions.tell(scene, faces, rays, report)
    scene.conversion_report = report
    return scene


def _check_sizes(pixels: Any, size: Any) -> None:
    def is_pair(value: Any, kinds: tuple[type, ...], least: float) -> bool:
        return (isinstance(value, Sequence | np.ndarray) and len(value) == 2
                and all(isinstance(item, kinds) and not isinstance(item, bool) and least <= item < float("inf") for item in value))

    if not is_pair(pixels, (int, np.integer), 1):
        raise UsageError(f"detector_pixels is {pixels!r}; give two whole numbers of 1 or more, such as (256, 256)")
    if size is not None and not is_pair(size, (int, float, np.number), 1e-9):
        raise UsageError(f"detector_size is {size!r}; give a width and a height in mm, such as (24.0, 36.0)")


def from_file(path: str | os.PathLike[str], *, unknown: str = "refuse", glasses: Mapping[str, Any] | None = None,
              coatings: Mapping[str, Any] | None = None, **options: Any) -> NSQScene:
    """Return a lens of a file of Zemax (.zmx), CODE V (.seq), OSLO (.len) or Optiland (.json) as a scene.

    Each card of the file is carried, or refused by its line, or stands in ``scene.conversion_report``.

    Args:
        path: The file.
        unknown: What becomes of an unknown card of a surface, and of a glass that no catalogue has: ``"refuse"``; or ``"remark"``,
            which leaves the card out, and takes the nd and Vd that the file states.
        glasses: Materials of Optiland for names of glasses: ``{"MYGLASS": IdealMaterial(1.5)}``.
        coatings: Coatings of Optiland for names of coatings (COAT, in files of Zemax).
        options: Options of :func:`from_optic`, which says what else is raised.

    Raises:
        UsageError: The file's name ends otherwise, the file cannot be read, or a card makes no sense.
        UnsupportedSceneError: A card changes the light, and no scene can carry it.
    """
    heard = io.StringIO()
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(heard):
        # What Optiland says, by warnings and by printing, stands in the report.
        warnings.simplefilter("always")
        optic, reading = read_lens(path, unknown=unknown, glasses=glasses, coatings=coatings)
        scene = from_optic(optic, **options)
    report = scene.conversion_report
    said = [*(str(warning.message) for warning in caught if not issubclass(warning.category, RuntimeWarning)), *heard.getvalue().splitlines()]
    report.remarks = [*reading.remarks, *dict.fromkeys(said), *report.remarks]
    report.passed_over = dict(reading.passed_over)
    report.glasses = dict(reading.glasses_found)
    report.carried = [replace(part, origins=origins(reading, part.index, part.kind) or part.origins) for part in report.carried]
    return scene


def _before_image(optic: Any, faces: list[prescription.Face], report: LensReport) -> list[prescription.Face]:
    """Leave out refracting surfaces in the image itself, behind which there is nothing."""
    image, _ = placed(optic.image_surface.geometry.cs)
    while faces and not faces[-1].is_mirror and np.abs(faces[-1].position - image).max() <= 1e-9:
        if faces[-1].stated is not None or faces[-1].coating is not None or not faces[-1].form.is_flat:
            raise UnsupportedSceneError(f"{faces[-1].place} lies in the image, and is no bare plane: a detector stands there alone")
        report.components[faces[-1].index] = ()
        report.remarks.append(f"{faces[-1].place} lies in the image: the detector is in its place")
        faces = faces[:-1]
    return faces


def _refuse_virtual(optic: Any, rays: prescription.Rays, faces: list[prescription.Face]) -> None:
    """Refuse a prescription whose light would have to run back: to a virtual image, or through a face behind the next one."""
    first = None if optic.object_surface.is_infinite else 0
    for one, other in prescription.acting(faces, len(rays.places) - 1, first):
        step = rays.places[other][rays.arrive] - rays.places[one][rays.arrive]
        ahead = (step * rays.directions[one][rays.arrive]).sum(axis=1)
        if np.median(ahead) < -1e-9:
            surfaces = optic.surfaces.surfaces
            names = [prescription.name_of(surfaces[index], index) for index in (one, other)]
            raise UnsupportedSceneError(f"{names[1]}: light that leaves {names[0]} would run back {-np.median(ahead):.4g} mm to it; "
                                        "a virtual object or image has no place in a scene, nor a surface that light meets out of order")
