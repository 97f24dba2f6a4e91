"""Detectors that Optiland's non-sequential engine lacks. They record on its NumpyBackend and TorchBackend as well."""

from __future__ import annotations

from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential.detectors.far_field import FarFieldDetector

from nsq_gpu.errors import UnsupportedSceneError, UsageError
from nsq_gpu.frames import placed


class _BinsOfSphere(int):
    """A number of bins that Optiland's own files must not hold: they would say that the bins end at 90 degrees."""

    def __int__(self) -> int:
        raise UnsupportedSceneError("Optiland's scene files know no SphereFarField; write the scene by nsq_gpu.export_scene")


class SphereFarField(FarFieldDetector):
    """A far field over the sphere: the polar angle goes to 180 degrees, and light from behind has cells of its own.

    Optiland's far field ends at 90 degrees, and adds light from behind to the light forwards. In scene files this one is
    ``"sphere": true``.

    >>> scene.detector_registry.add("sky", SphereFarField(frame))

    Args:
        cs: Frame. The polar angle is 0 along its +z.
        num_bins_theta: Bins of the polar angle, from 0 to 180 degrees; an even number.
        num_bins_phi: Bins of the azimuth, from -180 to 180 degrees.
        name: Name of the detector's events in recorded paths.
        absorb: Whether a hit ends the ray.

    Raises:
        UsageError: The bins of the polar angle do not part at 90 degrees.
    """

    def __init__(self, cs: CoordinateSystem, num_bins_theta: int = 180, num_bins_phi: int = 360, name: str = "",
                 absorb: bool = True) -> None:
        if num_bins_theta < 2 or num_bins_theta % 2:
            raise UsageError(f"num_bins_theta is {num_bins_theta!r}; give an even number, so that bins part at 90 degrees")
        super().__init__(cs, 180.0, num_bins_theta, num_bins_phi, name=name, absorb=absorb)
        self.num_bins_theta = _BinsOfSphere(num_bins_theta)

    def record(self, rays: Any, t: Any, hit_mask: Any) -> None:
        """Record the rays that hit, shape (N,): Optiland calls it."""
        hit = np.asarray(be.to_numpy(hit_mask), dtype=bool)
        if not hit.any():
            return
        directions = np.stack([np.asarray(be.to_numpy(part))[hit] for part in (rays.L, rays.M, rays.N)], axis=1)
        directions, flux = directions @ placed(self.cs)[1], np.asarray(be.to_numpy(rays.flux))[hit]
        polar = np.degrees(np.arccos(np.clip(directions[:, 2], -1.0, 1.0)))
        azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
        place = tuple(np.clip(np.searchsorted(edges, angles, side="right") - 1, 0, len(edges) - 2)
                      for edges, angles in ((self._theta_edges, polar), (self._phi_edges, azimuth)))
        steps = np.radians([self._theta_edges[1], self._phi_edges[1] - self._phi_edges[0]])
        centres = np.radians((self._theta_edges[:-1] + self._theta_edges[1:]) / 2.0)
        np.add.at(self._intensity, place, flux / (np.sin(centres[place[0]]) * steps.prod()))
        self._num_rays_hit += int(hit.sum())
        self._total_flux += float(flux.sum())
