"""The detector of a converted lens: how large it is, and why."""

from __future__ import annotations

from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig

from nsq_gpu.convert.elements import Element
from nsq_gpu.convert.prescription import Face, Rays, acting
from nsq_gpu.convert.report import LensReport
from nsq_gpu.frames import frame, placed

#: What is free around the light of all fields on the detector, as a share of its extent.
_FREE = 0.1
#: The detector is at least so wide [mm].
_LEAST = 1e-3
#: A ray that ends nearer to the detector's plane than that does not cross the plane [mm].
_END = 1e-6


def add_detector(scene: NSQScene, optic: Any, faces: list[Face], rays: Rays, last: Element | None,
                 pixels: tuple[int, int], size: tuple[float, float] | None, report: LensReport) -> None:
    """Add the detector on the image, and say in the report how large it is.

    Ghosts of a lens are as wide as its last element, so the detector is as wide as that or as the image circle.
    """
    position, rotation = placed(optic.image_surface.geometry.cs)
    local = (rays.places[-1][rays.arrive] - position) @ rotation
    directions = rays.directions[-2][rays.arrive] @ rotation
    on_plane = local - directions * (local[:, 2] / directions[:, 2])[:, None]
    # The middle of the detector is on the axis, as a film's is.
    circle = max(2.0 * (1.0 + _FREE) * float(np.hypot(on_plane[:, 0], on_plane[:, 1]).max()), _LEAST)
    reason = "as given"
    if size is None:
        width, reason = circle, "as wide as the image circle"
        if last is not None and last.width > width:
            if _is_clear(faces, rays, position, rotation, width, last.width):
                width, reason = last.width, f"as wide as the last element, {last.name}"
            else:
                reason += (f"; as wide as the last element, {last.name} ({last.width:.4g} mm), it would stand in the "
                           "light")
        size = (width, width)
    report.detector_size = (float(size[0]), float(size[1]))
    report.image_circle = circle
    report.detector_reason = reason
    curved = np.abs(local[:, 2]).max()
    if curved > 1e-9:
        report.remarks.append(f"the image is curved: its light is up to {curved:.3g} mm off the detector, a plane in its "
                              "vertex")
    scene.add_detector("image", frame(position, rotation), IrradianceDetectorConfig(*size, *pixels))


def _is_clear(faces: list[Face], rays: Rays, position: np.ndarray, rotation: np.ndarray, least: float,
              width: float) -> bool:
    """Return whether a detector of this width takes no light on its way that a detector of the least width leaves."""
    local = (rays.places[:, rays.arrive] - position) @ rotation
    directions = rays.directions[:, rays.arrive] @ rotation
    pairs = list(acting(faces, len(local) - 1))
    if not pairs:
        return True
    first = pairs[0][0]
    # Light comes from far away to the first surface, if it is not from an object.
    start = np.where(np.isfinite(local[0]), local[0], local[first] - 1e9 * directions[0])
    stretches = [(start, local[first]), *((local[one], local[other]) for one, other in pairs[:-1])]
    for before, after in stretches:
        crosses = (before[:, 2] * after[:, 2] < 0.0) & (np.abs(after[:, 2]) > _END)
        share = np.divide(before[:, 2], before[:, 2] - after[:, 2], out=np.zeros(len(crosses)), where=crosses)
        place = before + share[:, None] * (after - before)
        reach = 2.0 * np.abs(place[crosses, :2]).max(axis=1)
        if ((reach > least) & (reach < width)).any():
            return False
    return True
