"""Sources that Optiland's non-sequential engine lacks. They trace on its NumpyBackend and TorchBackend as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQMaterial
from optiland.nonsequential.ray_bundle import NSQRayBundle
from optiland.nonsequential.rng import EventSlot, NSQRng
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.collimated import CollimatedSource

from nsq_gpu.errors import UnsupportedSceneError, without_gradient
from nsq_gpu.frames import placed


class _NotCollimated:
    """What Optiland finds in the place of a beam's radius: its tracers do not read it, and its files must not hold it."""

    def __float__(self) -> float:
        raise UnsupportedSceneError("Optiland's scene files know no PupilSource; write the scene by nsq_gpu.export_scene")


@dataclass(frozen=True)
class Aim:
    """What rays of one wavelength add that are aimed at the stop: ``table[i][j]`` of p_x^i p_y^j, with powers up to 15."""

    #: Wavelength [um].
    wavelength: float
    #: To where rays start, along x and y [mm].
    x: Sequence[Sequence[float]] = ()
    y: Sequence[Sequence[float]] = ()
    #: To the vector along the ray, along x and y [mm].
    vector_x: Sequence[Sequence[float]] = ()
    vector_y: Sequence[Sequence[float]] = ()

    def at(self, pupil: np.ndarray) -> np.ndarray:
        """Return what is added to x, y, and the vector's x and y, at points of the unit disk: shape (N, 4) of (N, 2)."""
        columns = []
        for table in (self.x, self.y, self.vector_x, self.vector_y):
            total = np.zeros(len(pupil))
            for row in reversed(table):
                inner = np.zeros(len(pupil))
                for coefficient in reversed(row):
                    inner = inner * pupil[:, 1] + coefficient
                total = total * pupil[:, 0] + inner
            columns.append(total)
        return np.stack(columns, axis=1)


class PupilSource(CollimatedSource):
    """The light of one field of a lens, which fills the entrance pupil uniformly, as a sequential engine does.

    With p in the unit disk, a ray starts at ``(beam_radii[0] p_x, beam_radii[1] p_y, 0)`` and runs along ``chief +
    (pupil_radii[0] p_x, pupil_radii[1] p_y, 0)``, in the source's frame. Rays that are aimed at the stop of a wide-angle lens
    fill the pupil unevenly, and by wavelength: ``aimed`` says what they add.

    Args:
        cs: Frame: its origin is where the chief ray starts.
        spectrum: Wavelengths [um] and their weights.
        total_flux: Flux [W].
        beam_radii: Semi-axes of the beam at z = 0 [mm]; 0 and 0 for a field at a finite distance.
        chief: A vector along the chief ray [mm], with z > 0.
        pupil_radii: What the rim of the pupil adds to the vector [mm]; 0 and 0 for a field at infinity.
        medium: Medium around the source; None is vacuum.
        aimed: For each wavelength of the spectrum what aimed rays add; empty for nothing.
    """

    def __init__(self, cs: CoordinateSystem, spectrum: Spectrum, total_flux: float = 1.0,
                 beam_radii: Sequence[float] = (0.0, 0.0), chief: Sequence[float] = (0.0, 0.0, 1.0),
                 pupil_radii: Sequence[float] = (0.0, 0.0), medium: NSQMaterial | None = None, aimed: Sequence[Aim] = ()) -> None:
        # Optiland's tracers take sources of its own classes alone; how rays are born, they ask the source itself.
        super().__init__(cs, spectrum, total_flux, medium=medium)
        self.aperture_radius = _NotCollimated()
        given = {"beam_radii": beam_radii, "chief": chief, "pupil_radii": pupil_radii}
        self.beam_radii, self.chief, self.pupil_radii = (
            tuple(float(without_gradient(name, value)) for value in values) for name, values in given.items())
        self.aimed = tuple(aimed)

    def local_rays(self, pupil: np.ndarray, wavelength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return starts [mm] and unit directions, shape (N, 3), of points of the unit disk, shape (N, 2).

        Args:
            pupil: The points.
            wavelength: Wavelengths [um], shape (N,).
        """
        zeros = np.zeros(len(pupil))
        starts = np.stack([self.beam_radii[0] * pupil[:, 0], self.beam_radii[1] * pupil[:, 1], zeros], axis=1)
        vectors = np.stack([self.chief[0] + self.pupil_radii[0] * pupil[:, 0],
                            self.chief[1] + self.pupil_radii[1] * pupil[:, 1], zeros + self.chief[2]], axis=1)
        for aim in self.aimed:
            own = wavelength == aim.wavelength
            added = aim.at(pupil[own])
            starts[own, :2] += added[:, :2]
            vectors[own, :2] += added[:, 2:]
        return starts, vectors / np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))

    def generate(self, ray_id: np.ndarray, rng: NSQRng) -> NSQRayBundle:
        """Return one ray an id, in the global frame."""
        bounce = np.zeros(len(ray_id), dtype=np.int32)
        radius = np.sqrt(rng.uniform(ray_id, bounce, EventSlot.SOURCE_U1))
        turn = 2.0 * np.pi * rng.uniform(ray_id, bounce, EventSlot.SOURCE_U2)
        wavelength = self.spectrum.sample(ray_id, bounce, rng)
        pupil = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
        starts, directions = self.local_rays(pupil, np.asarray(be.to_numpy(wavelength), dtype=float))
        position, rotation = placed(self.cs)
        (x, y, z), (L, M, N) = (starts @ rotation.T + position).T, (directions @ rotation.T).T
        n, k = _indices(self.medium, wavelength)
        return NSQRayBundle(x=x.copy(), y=y.copy(), z=z.copy(), L=L.copy(), M=M.copy(), N=N.copy(),
                            flux=be.ones(len(ray_id)) * (self.total_flux / len(ray_id)), wavelength=wavelength, n_current=n,
                            bounce=bounce, alive=np.ones(len(ray_id), dtype=bool), ray_id=ray_id, k_current=k)


def _indices(medium: Any, wavelength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if medium is None:
        return np.ones(len(wavelength)), np.zeros(len(wavelength))
    return tuple(np.broadcast_to(np.asarray(of(wavelength), dtype=float), wavelength.shape).copy()
                 for of in (medium.n, medium.k))
