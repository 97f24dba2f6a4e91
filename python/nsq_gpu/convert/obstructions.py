"""Finds what stands in the light of a converted lens: a sequential engine goes from surface to surface, whatever lies between."""

from __future__ import annotations

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQScene

from nsq_gpu.convert.prescription import Face, Rays, acting
from nsq_gpu.convert.report import LensReport
from nsq_gpu.frames import placed

#: Nearer to an end of a ray's stretch than that, nothing is in its way [mm].
_END = 1e-6


def tell(scene: NSQScene, faces: list[Face], rays: Rays, report: LensReport) -> None:
    """Add a remark for each component and detector that rays meet on their way from one surface to the next."""
    for one, other in acting(faces, len(rays.places) - 1, first=0):
        chosen = rays.arrive & np.isfinite(rays.places[one]).all(axis=1)
        starts, way = rays.places[one][chosen], rays.places[other][chosen] - rays.places[one][chosen]
        lengths = np.linalg.norm(way, axis=1)
        moves = lengths > 2.0 * _END
        if not moves.any():
            continue
        starts, lengths = starts[moves], lengths[moves]
        directions = way[moves] / lengths[:, None]
        own = report.components.get(one, ()) + report.components.get(other, ())
        # The last stretch ends on the detector.
        things = [*zip(scene.component_names, scene.surfaces, strict=True)]
        if other < len(rays.places) - 1:
            things += [(f"the detector {name!r}", thing) for name, thing in zip(scene.detector_names, scene.detectors, strict=True)]
        for name, component in things:
            if name in own:
                continue
            position, rotation = placed(component.cs)
            t, _, hit, _ = component.geometry.ray_intersect(be.array((starts - position) @ rotation), be.array(directions @ rotation))
            met = be.to_numpy(hit) & (be.to_numpy(t) > _END) & (be.to_numpy(t) < lengths - _END)
            if met.any():
                between = f"{_name(report, one, 'the object')} and {_name(report, other, 'the image')}"
                report.remarks.append(f"{name} stands in the light between {between}: it meets {met.mean():.2g} of the rays looked at")


def _name(report: LensReport, index: int, otherwise: str) -> str:
    return next(iter(report.components.get(index, ())), otherwise)
