"""Sources that Optiland's non-sequential engine lacks. They trace on its NumpyBackend and TorchBackend as well."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQMaterial
from optiland.nonsequential.ray_bundle import NSQRayBundle
from optiland.nonsequential.rng import EventSlot, NSQRng
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.collimated import CollimatedSource

from nsq_gpu.binary import find_binary
from nsq_gpu.errors import UnsupportedSceneError, UsageError, wants_gradient, without_gradient
from nsq_gpu.frames import number_of, placed
from nsq_gpu.intensity import IntensityTable
from nsq_gpu.photometry import PEAK, is_visible, luminous_efficacy, v_lambda, watts
from nsq_gpu.process import answer
from nsq_gpu.rayfiles import ENDINGS, read

#: Units of a table of intensity.
INTENSITY_UNITS = ("relative", "W/sr", "cd")
#: Largest difference of two fluxes that are one, by rounding, relative to them.
_SAME_FLUX = 1e-12
#: How rays of a file become rays of a trace.
ORDERS = ("drawn", "in_order")
#: Relative difference of two rays' fluxes that is taken for rounding.
_ROUNDED = 2.0**-20
#: A ray's wavelength is put to the nearest one of the source's spectrum, if that is so near [um].
_FARTHEST = 0.025


class _NotCollimated:
    """What Optiland finds in the place of a beam's radius: its tracers do not read it, and its files must not hold it."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def __float__(self) -> float:
        raise UnsupportedSceneError(f"Optiland's scene files know no {self._kind}; write the scene by nsq_gpu.export_scene")


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
        self.aperture_radius = _NotCollimated("PupilSource")
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
        return _born(self, ray_id, wavelength, starts, directions)


class TabulatedSource(CollimatedSource):
    """A lamp whose intensity is a table over two angles, as files of lamps have it.

    The polar angle gamma is 0 along the frame's +z. The azimuth is 0 towards its +x, and 90 towards its +y; plane C of a lamp's
    file lies at the azimuth 360 - C. Intensity is linear in both angles between the table's angles, and 0 outside the polar
    ones. Rays follow it exactly, all with the same flux.

    Rays start at the origin; or uniformly within a rectangle, ``width`` and ``height``, or within a disk, ``radius``, at z = 0.
    Each place then has the same intensity.

    >>> lamp = TabulatedSource(frame, spectrum, [0, 30, 60, 90], [400.0, 350.0, 120.0, 0.0], intensity_units="cd")

    Args:
        cs: Frame.
        spectrum: Wavelengths [um] and their weights.
        polar_angles_deg: Polar angles [deg], two or more, rising within 0 to 180.
        intensity: A row for each azimuth, with a number for each polar angle. Of a lamp of revolution, the row alone will do.
        azimuth_angles_deg: 0 alone for a lamp of revolution, or angles [deg] that rise from 0 to 90, 180 or 360. A table to 180
            is mirrored: I(a) = I(360 - a). One to 90 is so too, and I(a) = I(180 - a). One to 360 has equal rows at its ends.
        intensity_units: ``"relative"``, with a flux; or ``"W/sr"`` or ``"cd"``, where the flux is the table's integral.
        total_flux: Flux [W], of a relative table.
        total_flux_lumens: Flux [lm], of a relative table; the spectrum says how many watts that is.
        width: Width along x [mm]; it may be 0, for a line.
        height: Height along y [mm]; it may be 0, for a line.
        radius: Radius [mm]; 0 is a point.
        medium: Medium around the source; None is vacuum.

    Raises:
        UsageError: An argument makes no sense, or the light is given in lumens or candelas and is not visible.
    """

    def __init__(self, cs: CoordinateSystem, spectrum: Spectrum, polar_angles_deg: Any, intensity: Any,
                 azimuth_angles_deg: Any = (0.0,), *, intensity_units: str = "relative", total_flux: Any = None,
                 total_flux_lumens: float | None = None, width: float | None = None, height: float | None = None,
                 radius: float | None = None, medium: NSQMaterial | None = None) -> None:
        if not isinstance(intensity_units, str) or intensity_units not in INTENSITY_UNITS:
            raise UsageError(f"intensity_units is {intensity_units!r}; give 'relative', 'W/sr' or 'cd'")
        self._table = IntensityTable(polar_angles_deg, azimuth_angles_deg, intensity)
        #: ``"relative"``, ``"W/sr"`` or ``"cd"``.
        self.intensity_units = intensity_units
        #: Flux in lumens, where it was given so [lm].
        self.total_flux_lumens = None if total_flux_lumens is None else _above_zero("total_flux_lumens", total_flux_lumens)
        self.width, self.height, self.radius = _opening(width, height, radius)
        #: What a file of a lamp says beside its table, and what was to be said of it; empty where there was no file.
        self.keywords: dict[str, Any] = {}
        self.remarks: list[str] = []
        # Optiland's tracers take sources of its own classes alone; how rays are born, they ask the source itself.
        super().__init__(cs, spectrum, self._given_flux(spectrum, total_flux), medium=medium)
        self.aperture_radius = _NotCollimated("TabulatedSource")  # type: ignore[assignment]

    def _given_flux(self, spectrum: Spectrum, total_flux: Any) -> Any:
        """Return the flux [W] that the arguments say."""
        if self.intensity_units == "relative":
            if (total_flux is None) == (self.total_flux_lumens is None):
                what = "neither is given" if total_flux is None else "both are given"
                raise UsageError(f"total_flux, total_flux_lumens: {what}, and the table's intensity is relative; give one of "
                                 "them, or the unit of the intensity: intensity_units='cd'")
            if self.total_flux_lumens is not None:
                return watts(self.total_flux_lumens, spectrum)
            # A tensor stays one, for its gradient.
            _above_zero("total_flux", total_flux.detach() if hasattr(total_flux, "detach") else total_flux)
            return total_flux
        for name, value in (("total_flux", total_flux), ("total_flux_lumens", self.total_flux_lumens)):
            if value is not None:
                raise UsageError(f"{name} is {value!r}, and a table in {self.intensity_units} says its flux itself; leave it "
                                 "out, or give intensity_units='relative'")
        return self._flux_of_table(spectrum)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], *, cs: CoordinateSystem, spectrum: Spectrum, total_flux: Any = None,
                  total_flux_lumens: float | None = None, opening: bool = True, medium: NSQMaterial | None = None,
                  binary: str | os.PathLike[str] | None = None) -> TabulatedSource:
        """Return the lamp of a file of IES LM-63 (.ies) or EULUMDAT (.ldt), whose intensity is in cd.

        The program reads the file: ``nsq-gpu lamp FILE --json``. ``keywords`` are then the file's, and ``remarks`` what is
        to be said of it.

        Args:
            path: The file.
            cs: Frame.
            spectrum: Wavelengths [um] and their weights: files of lamps have none.
            total_flux: Flux [W] in the place of the file's.
            total_flux_lumens: Flux [lm] in the place of the file's.
            opening: Whether rays start within the luminous opening that the file states; False gives a point.
            medium: Medium around the source; None is vacuum.
            binary: Path of the program.

        Raises:
            UsageError: It is no file of a lamp, or an argument makes no sense.
            BinaryNotFoundError: The program is not there.
        """
        if not isinstance(path, str | os.PathLike) or Path(path).suffix.lower() not in (".ies", ".ldt"):
            raise UsageError(f"path is {path!r}; give the path of a lamp's file, whose name ends with .ies or .ldt")
        found = answer([find_binary(binary), "lamp", "--json", "--", str(path)])
        scaled = total_flux is not None or total_flux_lumens is not None
        shape = {key: value for key, value in found["opening"].items() if key != "type"} if opening else {}
        source = cls(cs, spectrum, found["polar_angles_deg"], found["intensity"], found["azimuth_angles_deg"],
                     intensity_units="relative" if scaled else "cd", total_flux=total_flux, total_flux_lumens=total_flux_lumens,
                     medium=medium, **shape)
        source.keywords, source.remarks = dict(found["keywords"]), list(found["remarks"])
        return source

    @property
    def polar_angles_deg(self) -> np.ndarray:
        """Polar angles of the table [deg]; another table is another source."""
        return self._table.polar_angles_deg

    @property
    def azimuth_angles_deg(self) -> np.ndarray:
        """Azimuths of the table [deg]."""
        return self._table.azimuth_angles_deg

    @property
    def intensity(self) -> np.ndarray:
        """The table, in ``intensity_units``, with a row for each azimuth."""
        return self._table.intensity

    @property
    def table(self) -> IntensityTable:
        """The table with its mirrors, which draws directions."""
        return self._table

    def _flux_of_table(self, spectrum: Spectrum) -> float:
        return watts(self._table.flux, spectrum) if self.intensity_units == "cd" else self._table.flux

    @property
    def is_of_its_table(self) -> bool:
        """Whether the table alone says the flux: its unit is W/sr or cd, and nobody has changed ``total_flux`` since."""
        return self.intensity_units != "relative" and _is_flux(self, lambda: self._flux_of_table(self.spectrum))

    def plot(self, *, ax: Any = None, **options: Any) -> Any:
        """Draw the polar diagram: gamma from 0 deg downwards, the planes C0-C180 and C90-C270, C0 and C90 to the right.

        Plane C lies at the azimuth 360 - C of the frame: C90 is towards -y, and C270 towards +y. Intensity is in cd where the
        table or the flux is in lumens or candelas, else in W/sr.

        Args:
            ax: Polar axes of Matplotlib. None makes a figure.
            options: Further options of Matplotlib's ``plot``, such as ``linewidth=2``.

        Returns:
            The axes.
        """
        from nsq_gpu.plotting import plot_lamp

        is_photometric = self.intensity_units == "cd" or self.total_flux_lumens is not None
        flux = number_of(self.total_flux) * (luminous_efficacy(self.spectrum) if is_photometric else 1.0)
        return plot_lamp(self._table, flux, "cd" if is_photometric else "W/sr", ax, options)

    def generate(self, ray_id: np.ndarray, rng: NSQRng) -> NSQRayBundle:
        """Return one ray an id, in the global frame, by the draws of Optiland's ExtendedSource."""
        bounce = np.zeros(len(ray_id), dtype=np.int32)
        u1, u2, u3, u4 = (rng.uniform(ray_id, bounce, slot) for slot in (
            EventSlot.SOURCE_U1, EventSlot.SOURCE_U2, EventSlot.SOURCE_U3, EventSlot.SOURCE_U4))
        starts = np.zeros((len(ray_id), 3))
        if self.radius is not None:
            distance, turn = self.radius * np.sqrt(u1), 2.0 * np.pi * u2
            starts[:, 0], starts[:, 1] = distance * np.cos(turn), distance * np.sin(turn)
        elif self.width is not None and self.height is not None:
            starts[:, 0], starts[:, 1] = (u1 - 0.5) * self.width, (u2 - 0.5) * self.height
        return _born(self, ray_id, self.spectrum.sample(ray_id, bounce, rng), starts, self._table.directions(u3, u4))


@dataclass(frozen=True)
class _RayGroup:
    """Rays of one wavelength, or of all, with the rows of their shares (A. J. Walker's alias tables)."""

    #: Wavelength [um]; None for rays of any wavelength.
    wavelength: float | None
    #: Start points [mm] and unit directions, shape (N, 3).
    starts: np.ndarray
    directions: np.ndarray
    #: Of each row, the share of its draws that stay, and the row that has the others.
    stays: np.ndarray
    other: np.ndarray

    def draw(self, u1: np.ndarray, u2: np.ndarray) -> np.ndarray:
        """Return the numbers of the rays that these draws take, as the program's shader does."""
        # A draw is a whole number over 2^32, and there are fewer rows than 2^20: the product is exact.
        row = np.floor(u1 * len(self.stays)).astype(np.intp)
        return np.where(u2 < self.stays[row], row, self.other[row])


@dataclass(frozen=True)
class _InTurn:
    """Rays that are taken in their order."""

    #: Start points [mm] and unit directions, shape (N, 3); wavelengths [um], None for rays of any wavelength.
    starts: np.ndarray
    directions: np.ndarray
    wavelength: np.ndarray | None


@dataclass(frozen=True)
class _RaySet:
    """The rays of a file, by the wavelengths of a spectrum or in their order, the spectrum that they have, and their flux."""

    rays: tuple[_RayGroup, ...] | _InTurn
    spectrum: Spectrum
    #: Flux in ``unit``, W or lm; None if the file does not say it.
    flux: float
    unit: str | None
    #: What the header states in place of this flux; None if it states the same or nothing.
    stated: float | None


class RaySource(CollimatedSource):
    """The rays of a file: those that a maker measured of a lamp, or that another trace recorded.

    A ray of the trace takes one of the file's, drawn by its share of the light, independently of the others; or its own in turn, where
    all have one flux: ``order="in_order"``.

    The program reads IES TM-25 (.tm25ray), source files of Zemax OpticStudio (.dat, .sdf), and the columns of a ray database (.npz).
    For Optiland's own backends this package reads them, up to 1,048,575 rays, and takes the rays that the program takes.

    Rays that have wavelengths in the file take the nearest one of the spectrum, within 25 nm; the file then says how strong each
    is. Where the file has none, they are drawn by the spectrum. The flux is the file's, unless one is given.

    Scene files name the ray file by its absolute path: on a cluster it must lie there on every machine.

    Args:
        cs: Frame, in which the file has its rays.
        spectrum: Wavelengths [um] and their weights.
        file: The file.
        order: ``"drawn"``; or ``"in_order"``: ray 0 of the trace is ray 0 of the file, and so on, and after the last the first.
        scale: What lengths in the file are multiplied by.
        total_flux: Flux [W] in the place of the file's.
        total_flux_lumens: Flux [lm] in the place of the file's.
        medium: Medium around the source; None is vacuum.

    Raises:
        UsageError: It is no ray file, or an argument makes no sense.
    """

    def __init__(self, cs: CoordinateSystem, spectrum: Spectrum, file: str | os.PathLike[str], *, order: str = "drawn",
                 scale: float = 1.0, total_flux: Any = None, total_flux_lumens: float | None = None, medium: NSQMaterial | None = None) -> None:
        if not isinstance(file, str | os.PathLike) or Path(file).suffix.lower() not in ENDINGS:
            raise UsageError(f"file is {file!r}; give the path of a ray file, whose name ends with .tm25ray, .dat, .sdf or .npz")
        #: The absolute path of the file.
        self.file = os.path.abspath(file)
        if not Path(self.file).is_file():
            raise UsageError(f"file is {self.file!r}, and there is no such file; give the path of a ray file")
        if not isinstance(order, str) or order not in ORDERS:
            raise UsageError(f"order is {order!r}; give 'drawn' or 'in_order'")
        #: ``"drawn"`` or ``"in_order"``.
        self.order = order
        #: What lengths in the file are multiplied by.
        self.scale = _above_zero("scale", scale)
        if total_flux is not None and total_flux_lumens is not None:
            raise UsageError("total_flux, total_flux_lumens: both are given; give one of them, or none for the flux of the file")
        if total_flux is not None:
            # A tensor stays one, for its gradient.
            _above_zero("total_flux", total_flux.detach() if hasattr(total_flux, "detach") else total_flux)
        self._held: tuple[Any, _RaySet] | None = None
        # Optiland's tracers take sources of its own classes alone; how rays are born, they ask the source itself.
        super().__init__(cs, spectrum, total_flux, medium=medium)
        #: Flux in lumens, where it was given so [lm].
        self.total_flux_lumens = None if total_flux_lumens is None else _above_zero("total_flux_lumens", total_flux_lumens)
        self.aperture_radius = _NotCollimated("RaySource")  # type: ignore[assignment]
        if Path(self.file).suffix.lower() == ".npz":
            # The program traces more rays than this package holds.
            with contextlib.suppress(UnsupportedSceneError):
                self._rays()

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], *, cs: CoordinateSystem, spectrum: Spectrum, order: str = "drawn",
                  scale: float = 1.0, total_flux: Any = None, total_flux_lumens: float | None = None,
                  medium: NSQMaterial | None = None) -> RaySource:
        """Return the rays of a file; the class says what the arguments are.

        >>> lamp = RaySource.from_file("led.tm25ray", cs=frame, spectrum=white, total_flux_lumens=120.0)

        Raises:
            UsageError: It is no ray file, or an argument makes no sense.
        """
        return cls(cs, spectrum, path, order=order, scale=scale, total_flux=total_flux, total_flux_lumens=total_flux_lumens,
                   medium=medium)

    @property
    def total_flux(self) -> Any:
        """Flux [W]: the one that is given, or the file's. Who sets it takes the place of the file.

        Raises:
            UsageError: It is no ray file; or the file alone says the flux, and says none or two.
            UnsupportedSceneError: It has more rays than this package holds.
        """
        if self.is_of_its_file:
            rays = self._rays()
            if rays.unit is None:
                raise UsageError(f"{self.file}: the file does not say whether its flux is in W or in lm; give total_flux or "
                                 "total_flux_lumens")
            if rays.stated is not None:
                raise UsageError(f"{self.file}: it states {rays.stated:g} {rays.unit}, and the flux of its rays is {rays.flux:g} "
                                 f"{rays.unit} in all; correct the file, or give total_flux or total_flux_lumens")
            return rays.flux if rays.unit == "W" else watts(rays.flux, rays.spectrum)
        return self._flux if self.total_flux_lumens is None else watts(number_of(self.total_flux_lumens), self._rays().spectrum)

    @total_flux.setter
    def total_flux(self, value: Any) -> None:
        self._flux, self.total_flux_lumens = value, None

    @property
    def is_of_its_file(self) -> bool:
        """Whether the file alone says the flux."""
        return self._flux is None and self.total_flux_lumens is None

    def generate(self, ray_id: np.ndarray, rng: NSQRng) -> NSQRayBundle:
        """Return one ray an id, in the global frame.

        Raises:
            UsageError: It is no ray file.
            UnsupportedSceneError: It has more rays than this package holds.
        """
        rays = self._rays()
        bounce = np.zeros(len(ray_id), dtype=np.int32)
        if isinstance(rays.rays, _InTurn):
            taken = np.asarray(ray_id) % len(rays.rays.starts)
            own_lines = rays.rays.wavelength
            line = rays.spectrum.sample(ray_id, bounce, rng) if own_lines is None else own_lines[taken]
            return _born(self, ray_id, line, rays.rays.starts[taken], rays.rays.directions[taken])
        u1, u2 = (rng.uniform(ray_id, bounce, slot) for slot in (EventSlot.SOURCE_U1, EventSlot.SOURCE_U2))
        wavelength = rays.spectrum.sample(ray_id, bounce, rng)
        starts, directions = np.zeros((len(ray_id), 3)), np.zeros((len(ray_id), 3))
        for group in rays.rays:
            own = np.full(len(ray_id), True) if group.wavelength is None else wavelength == group.wavelength
            chosen = group.draw(u1[own], u2[own])
            starts[own], directions[own] = group.starts[chosen], group.directions[chosen]
        return _born(self, ray_id, wavelength, starts, directions)

    def _rays(self) -> _RaySet:
        """Return the rays of the file as the source now is; they are read again where the file has changed."""
        try:
            state = os.stat(self.file)
        except OSError as error:
            raise UsageError(f"{self.file}: {error.strerror}; give the path of a ray file") from None
        listed, weights = (np.asarray(be.to_numpy(part), dtype=float) for part in (self.spectrum.wavelengths, self.spectrum.weights))
        key = (self.file, state.st_mtime_ns, state.st_size, number_of(self.scale), self.order, listed.tobytes(), weights.tobytes(),
               self.total_flux_lumens is not None)
        if self._held is None or self._held[0] != key:
            self._held = key, _taken(self.file, key[3], self.order, self.spectrum, listed, in_lumens=key[-1])
        return self._held[1]


def _taken(path: str, scale: float, order: str, spectrum: Spectrum, listed: np.ndarray, *, in_lumens: bool) -> _RaySet:
    """Read a file, and put its rays to the wavelengths of the spectrum that are listed.

    ``in_lumens`` says what fluxes of a file without a unit are.
    """
    rays = read(path)
    lit = rays.flux > 0.0
    if not lit.any():
        raise UsageError(f"{path}: the file has no rays with light; give a file with rays")
    numbers = np.flatnonzero(lit)
    starts, directions, shares = rays.starts[lit] * scale, rays.directions[lit], rays.flux[lit]
    if rays.wavelength is None:
        if order == "in_order":
            _check_one_flux(path, rays.flux)
            return _RaySet(_InTurn(starts, directions, None), spectrum, rays.total, rays.unit, rays.stated)
        return _RaySet((_RayGroup(None, starts, directions, *_rows(shares)),), spectrum, rays.total, rays.unit, rays.stated)
    own = rays.wavelength[lit]
    nearest = np.zeros(len(own), dtype=np.intp)
    apart = np.abs(listed[0] - own)
    for i, line in enumerate(listed[1:], start=1):
        nearer = np.abs(line - own) < apart
        nearest[nearer], apart[nearer] = i, np.abs(line - own[nearer])
    if (far := np.flatnonzero(apart > _FARTHEST)).size:
        raise UsageError(f"{path}: ray {numbers[far[0]]} has a wavelength of {own[far[0]]:g} um, and the spectrum of the source has "
                         f"none within {1e3 * _FARTHEST:g} nm; add wavelengths to the spectrum")
    total, unit = rays.total, rays.unit
    if unit == "lm" or unit is None and in_lumens:
        # Lumens of rays that have wavelengths are watts.
        shares = _in_watts(path, shares, listed[nearest], numbers)
        total, unit = math.fsum(shares), "W"
    used = np.unique(nearest)
    of_file = Spectrum(listed[used], np.array([_sum(shares[nearest == i]) for i in used]))
    if order == "in_order":
        _check_one_flux(path, shares if lit.all() else rays.flux)
        return _RaySet(_InTurn(starts, directions, listed[nearest]), of_file, total, unit, rays.stated)
    groups = tuple(_RayGroup(float(listed[i]), starts[nearest == i], directions[nearest == i], *_rows(shares[nearest == i]))
                   for i in used)
    return _RaySet(groups, of_file, total, unit, rays.stated)


def _check_one_flux(path: str, flux: np.ndarray) -> None:
    """Refuse fluxes of rays that are taken in order, unless all are the same but for rounding."""
    wrong = ~((np.abs(flux - flux[0]) <= _ROUNDED * flux[0]) & (flux > 0.0))
    if wrong.any():
        i = np.flatnonzero(wrong)[0]
        raise UsageError(f"{path}: rays are taken in order, so all must have the same flux; ray {i} of the file has {flux[i]:g}, and "
                         f"ray 0 has {flux[0]:g}; take rays drawn by their flux, with order='drawn'")


def _in_watts(path: str, lumens: np.ndarray, wavelength: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the watts of rays' lumens; ``numbers`` are the rays' numbers in the file."""
    efficacies = PEAK * v_lambda(wavelength)
    if (dark := np.flatnonzero(~is_visible(efficacies))).size:
        raise UsageError(f"{path}: ray {numbers[dark[0]]} has a flux in lm, and nobody sees light of its wavelength; give a file "
                         "whose flux is in W")
    return np.asarray(lumens / efficacies)


def _sum(numbers: np.ndarray) -> float:
    """Return the sum in order, as the program rounds it."""
    return float(np.cumsum(numbers)[-1])


def _rows(shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Walker's rows, as Vose makes them: one row that has too little takes from one that has too much.

    The order of the steps is the program's, so that its rows are the same to the last bit.
    """
    left = (shares / (_sum(shares) / len(shares))).tolist()
    stays, other = [1.0] * len(left), list(range(len(left)))
    small = [i for i, share in enumerate(left) if share < 1.0]
    large = [i for i, share in enumerate(left) if not share < 1.0]
    while small and large:
        poor, rich = small.pop(), large[-1]
        stays[poor], other[poor] = left[poor], rich
        left[rich] -= 1.0 - left[poor]
        if left[rich] < 1.0:
            small.append(large.pop())
    return np.array(stays), np.array(other, dtype=np.intp)


def is_of_its_lumens(source: Any) -> bool:
    """Return whether a source has its flux in lumens, as ``total_flux_lumens``, and nobody has changed ``total_flux`` since."""
    lumens = getattr(source, "total_flux_lumens", None)
    return lumens is not None and _is_flux(source, lambda: watts(number_of(lumens), source.spectrum))


def _is_flux(source: Any, expected: Callable[[], float]) -> bool:
    """Return whether a source's flux is what is expected, and no tensor that wants a gradient."""
    if wants_gradient(source.total_flux):
        return False
    try:
        return math.isclose(number_of(source.total_flux), expected(), rel_tol=_SAME_FLUX)
    except UsageError:
        # Its spectrum was changed, to one without visible light.
        return False


def _of_zero_or_more(name: str, value: Any, wanted: str = "of 0 or more") -> float:
    try:
        number = float(without_gradient(name, value))
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 <= number < math.inf:
        raise UsageError(f"{name} is {value!r}; give a finite number {wanted}")
    return number


def _above_zero(name: str, value: Any) -> float:
    number = _of_zero_or_more(name, value, "above 0")
    if number == 0.0:
        raise UsageError(f"{name} is {value!r}; give a finite number above 0")
    return number


def _opening(width: Any, height: Any, radius: Any) -> tuple[float | None, float | None, float | None]:
    given = {"width": width, "height": height, "radius": radius}
    width, height, radius = (None if value is None else _of_zero_or_more(name, value) for name, value in given.items())
    if radius is not None and (width is not None or height is not None):
        raise UsageError("radius: it is given beside width or height, and rays start within a disk or a rectangle; leave one "
                         "of them out")
    if (width is None) != (height is None):
        there, absent = ("width", "height") if height is None else ("height", "width")
        raise UsageError(f"{absent}: it is missing, and {there} is given; give both for a rectangle, or none for a point")
    if width == height == 0.0:
        raise UsageError("width, height: both are 0; leave them out for a point")
    return width, height, radius


def _born(source: Any, ray_id: np.ndarray, wavelength: np.ndarray, starts: np.ndarray, directions: np.ndarray) -> NSQRayBundle:
    """Return rays in the global frame, of starts [mm] and unit directions in the source's own, shape (N, 3)."""
    position, rotation = placed(source.cs)
    (x, y, z), (L, M, N) = (starts @ rotation.T + position).T, (directions @ rotation.T).T
    n, k = _indices(source.medium, wavelength)
    return NSQRayBundle(x=x.copy(), y=y.copy(), z=z.copy(), L=L.copy(), M=M.copy(), N=N.copy(),
                        flux=be.ones(len(ray_id)) * (source.total_flux / len(ray_id)), wavelength=wavelength, n_current=n,
                        bounce=np.zeros(len(ray_id), dtype=np.int32), alive=np.ones(len(ray_id), dtype=bool), ray_id=ray_id,
                        k_current=k)


def _indices(medium: Any, wavelength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if medium is None:
        return np.ones(len(wavelength)), np.zeros(len(wavelength))
    return tuple(np.broadcast_to(np.asarray(of(wavelength), dtype=float), wavelength.shape).copy()
                 for of in (medium.n, medium.k))
