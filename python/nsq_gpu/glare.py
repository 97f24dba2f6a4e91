"""``veiling_glare``: the light in the image of a small black spot in a bright field (ISO 9358, integral method).

The bright field is at infinity, and shines into the scene through a disk, the opening. The same radiance fills all directions
within a cone about the spot's direction. Light is linear. So a trace of the cone without the spot's directions gives the irradiance E_b
in the image of a black spot, and a trace of the spot's directions alone gives E_s. Without the spot there is E_b + E_s, and the
veiling glare index is E_b / (E_b + E_s). Both traces see the same pixels, and nothing is subtracted.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.optic import Optic

from nsq_gpu.arguments import near, wrong_kind
from nsq_gpu.binary import find_binary
from nsq_gpu.convert import from_optic
from nsq_gpu.display import MOST_ROWS, Displayed, Summary, number
from nsq_gpu.errors import NsqGpuError, ResultWarning, TraceTimeoutError, UsageError, warn, with_partial
from nsq_gpu.export import to_json
from nsq_gpu.export.values import whole_number
from nsq_gpu.frames import frame, placed
from nsq_gpu.labelled import table, xarray
from nsq_gpu.process import seconds
from nsq_gpu.progress import Counter, Progress, Shown
from nsq_gpu.pst_trace import angles_of_axis
from nsq_gpu.results import warn_of
from nsq_gpu.scattering import ScatterProb, ScatterTo, answering, exported_of, is_file, keys_of, scattered
from nsq_gpu.session import EXPORTED, Json, Session, as_written, shared_session

#: Radiance of the field, of which arrays have the irradiance [W/(mm^2 sr)]: W/mm^2 are then sr.
_RADIANCE = 1.0
#: Distance of the disk from what is behind it, and by how much it is too large, as a share of the opening's radius.
_GAP = 0.01
#: Steps of the table of a source, whose intensity is linear between them [deg]: a cosine is then right to 3e-6.
_STEP = 0.25
#: Pixels along the region, on a detector's longer side when the spot's image is looked for, and at most.
_IN_REGION, _COARSE, _MOST = 6, 512, 2048
#: Rays by which the spot's image is found.
_PILOT_RAYS = 100_000
#: With fewer rays in the region than that, a standard error says little.
_FEW = 10


@dataclass(frozen=True, repr=False)
class VeilingGlare(Displayed):
    """The veiling glare index of a scene by the direction of the spot. Arrays have the axes (angle, azimuth).

    Of directions that were not traced, numbers are NaN and counts 0.
    """

    #: The detector's name.
    detector: str
    #: Angles of the spot off the axis [deg], shape (A,).
    angles_deg: np.ndarray
    #: Azimuths of the spot, from the x of the opening's frame towards its y [deg], shape (Z,).
    azimuths_deg: np.ndarray
    #: Veiling glare index [1], shape (A, Z), and its standard error.
    index: np.ndarray
    standard_error: np.ndarray
    #: Irradiance in the image of the black spot, over the field's radiance [sr], shape (A, Z), and its standard error.
    black: np.ndarray
    black_standard_error: np.ndarray
    #: Irradiance at the same place without the spot, over the field's radiance [sr], shape (A, Z), and its standard error.
    white: np.ndarray
    white_standard_error: np.ndarray
    #: Rays that came into the region in the image of the black spot, shape (A, Z).
    num_hits: np.ndarray
    #: Middle of the spot's image on the detector [mm], shape (A, Z, 2).
    centre: np.ndarray
    #: Radius of the spot's image, and of the region where light is looked at [mm], shape (A, Z).
    image_radius: np.ndarray
    region_radius: np.ndarray
    #: Half-angles of the black spot and of the field about it [deg].
    half_spot_deg: float
    half_field_deg: float
    #: Rays of each of the two traces of a direction.
    num_rays: int
    #: True if the call was stopped.
    partial: bool = False

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with a row a direction, azimuth by azimuth; ``attrs["units"]`` has the columns' units.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        azimuths, angles = np.meshgrid(self.azimuths_deg, self.angles_deg)
        columns = {"angle_deg": angles, "azimuth_deg": azimuths} | self._columns()
        units = {"angle_deg": "deg", "azimuth_deg": "deg"} | _UNITS
        return table({name: values.T.ravel() for name, values in columns.items()}, units)

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` over ``angle`` and ``azimuth`` [deg].

        Raises:
            MissingLibraryError: xarray is not installed (``pip install 'nsq-gpu[xarray]'``).
        """
        variables = {name: (("angle", "azimuth"), values, {"units": _UNITS[name]}) for name, values in self._columns().items()}
        coordinates = {"angle": ("angle", self.angles_deg, {"units": "deg"}),
                       "azimuth": ("azimuth", self.azimuths_deg, {"units": "deg"})}
        about = {"detector": self.detector, "half_spot_deg": self.half_spot_deg, "half_field_deg": self.half_field_deg,
                 "num_rays": self.num_rays, "partial": int(self.partial)}
        return xarray("to_xarray").Dataset(variables, coordinates, about)

    def plot(self, *, ax: Any = None, **options: Any) -> Any:
        """Draw the index over the angle, with standard errors; a line an azimuth.

        Args:
            ax: Matplotlib's axes. None makes a figure.
            options: Further options of Matplotlib's ``errorbar``.

        Returns:
            The axes.
        """
        from nsq_gpu.plotting import _axes

        ax = _axes(ax)
        for z, azimuth in enumerate(self.azimuths_deg):
            ax.errorbar(self.angles_deg, 100.0 * self.index[:, z], 100.0 * self.standard_error[:, z],
                        **{"label": f"azimuth {azimuth:g}°", "marker": ".", "capsize": 2, **options})
        ax.set_ylim(bottom=0.0)
        ax.set_xlabel("angle of the spot off the axis [deg]")
        ax.set_ylabel("veiling glare index [%]")
        ax.set_title(self.detector + (", stopped before its end" if self.partial else ""))
        if len(self.azimuths_deg) > 1:
            ax.legend(fontsize="small")
        return ax

    def _columns(self) -> dict[str, np.ndarray]:
        columns = {name: getattr(self, name) for name in _UNITS if hasattr(self, name)}
        return columns | {"centre_x": self.centre[..., 0], "centre_y": self.centre[..., 1]}

    def _summary(self) -> Summary:
        places = [(a, z) for z in range(len(self.azimuths_deg)) for a in range(len(self.angles_deg)) if np.isfinite(self.white[a, z])]
        rows = [[number(self.angles_deg[a]), number(self.azimuths_deg[z]), f"{100.0 * self.index[a, z]:.4g} %",
                 f"{100.0 * self.standard_error[a, z]:.2g} %", f"{self.num_hits[a, z]:,}"] for a, z in places[:MOST_ROWS]]
        title = (f"Veiling glare on {self.detector}: a black spot of {2.0 * self.half_spot_deg:g} deg in a field of "
                 f"{2.0 * self.half_field_deg:g} deg")
        note = [f"partial: {len(places)} of {self.index.size} directions"] if self.partial else []
        return Summary(title, ["angle [deg]", "azimuth [deg]", "index", "error", "rays in the region"], rows, len(places), note)


_UNITS = {"index": "1", "standard_error": "1", "black": "sr", "black_standard_error": "sr", "white": "sr",
          "white_standard_error": "sr", "num_hits": "1", "image_radius": "mm", "region_radius": "mm", "centre_x": "mm",
          "centre_y": "mm"}


def veiling_glare(scene_or_optic: NSQScene | Optic | str | os.PathLike[str], detector: str | None = None, *, half_spot_deg: float,
                  half_field_deg: float = 90.0, angles_deg: Sequence[float] | np.ndarray = (0.0,),
                  azimuths_deg: Sequence[float] | np.ndarray = (0.0,), opening: str | tuple[Sequence[float], float] | None = None,
                  region: float = 0.2, num_rays: int = 1_000_000, scatter_prob: ScatterProb = None, scatter_to: ScatterTo = None,
                  seed: int = 0, max_depth: int | None = None, precision: str = "auto", adapter: str | None = None,
                  binary: str | os.PathLike[str] | None = None, timeout: float | None = None, progress: Progress = None,
                  **options: Any) -> VeilingGlare:
    """Say how bright the image of a small black spot in a bright field is: the veiling glare index.

    It is the irradiance in the middle of the image of a small round black spot in an extended field of uniform radiance, over the
    irradiance there without the spot (ISO 9358:1994, Veiling glare of image-forming systems, integral method). The field is at
    infinity, and fills a cone about the spot's direction. It shines into the scene through the opening alone, a disk across that
    direction, as through the port of an integrating sphere. The index is E_b / (E_b + E_s): E_b is from the field without
    the spot's directions, E_s from the spot's directions alone, each of a trace of its own.

    Irradiances are in watts. For the eye, weigh the spectrum of the first source by V(lambda).

    >>> nsq_gpu.veiling_glare(CookeTriplet(), half_spot_deg=1.0, angles_deg=[0, 10], num_rays=10_000_000, guide=True)

    Args:
        scene_or_optic: The live scene, its file, or Optiland's Optic of an object at infinity. The spectrum is the first
            source's.
        detector: Name of an irradiance detector; it may be left out where there is one alone.
        half_spot_deg: Half of the angle that the black spot subtends [deg].
        half_field_deg: Half of the angle that the field subtends, about the spot [deg]; 90 is half of all directions.
        angles_deg: Angles of the spot off the axis [deg].
        azimuths_deg: Azimuths of the spot [deg], from the x of the opening's frame towards its y.
        opening: Where light comes in: the name of a collimated source, whose beam has its size and axis; or its middle and its
            radius [mm], such as ``((0, 0, -5), 20.0)``, across the global z. None takes the first face of an Optic that refracts,
            or the only collimated source of a scene. Off the axis the disk is turned, and moved back along the light until all of
            it lies before the opening.
        region: Diameter of the region where light is looked at, in the middle of the spot's image, over the image's diameter.
        num_rays: Rays of each of the two traces of a direction.
        scatter_prob: As in :class:`nsq_gpu.NsqGpuBackend`.
        scatter_to: As in :class:`nsq_gpu.NsqGpuBackend`. The detector as a target stands for the region. A target that holds a part
            of the region alone makes errors too small: few rays then come to the rest.
        seed: Seed of the draws of the field; the spot's seed is one higher.
        max_depth: Largest number of events of a ray. None takes twice the surfaces that do not absorb, but at least 16.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        adapter: A part of the adapter's name.
        binary: Path of the program.
        timeout: Longest time of the call [s].
        progress: As in :class:`nsq_gpu.NsqGpuBackend`, with the rays of all directions.
        options: Further options of ``nsq-gpu trace`` by their names, such as ``guide=True``, with which ghosts have smaller errors.

    Raises:
        UsageError: An argument makes no sense in this scene, or no light of the spot comes to the detector.
        NsqGpuError: One of its other subclasses, by what went wrong; ``partial`` has the directions that are done.
        Interrupted: Ctrl-C ended the call; ``partial`` has the directions that are done. So it is with TraceTimeoutError.
    """
    angles, azimuths = angles_of_axis("angles_deg", angles_deg), angles_of_axis("azimuths_deg", azimuths_deg)
    if (np.abs(angles) >= 90.0).any():
        raise UsageError(f"angles_deg is {angles_deg!r}; give angles below 90 degrees")
    if not 0.0 < half_spot_deg < half_field_deg <= 90.0:
        raise UsageError(f"half_spot_deg is {half_spot_deg!r} and half_field_deg {half_field_deg!r}; give half-angles above 0 and up "
                         "to 90 degrees, the spot's below the field's")
    if not 0.0 < region <= 0.8:
        raise UsageError(f"region is {region!r}; give a number above 0 and up to 0.8, such as 0.2")
    keys, rays = keys_of(scatter_prob, scatter_to), whole_number("num_rays", num_rays)
    scene, port = _asked(scene_or_optic, opening)
    exported = exported_of(scene)
    name = _detector(exported.document["detectors"], detector)
    session = shared_session(find_binary(binary), adapter)
    fixed = {"precision": precision, "standard_error": "on", **as_written(options)}
    if max_depth is not None:
        fixed["max_depth"] = whole_number("max_depth", max_depth)
    limit = seconds(timeout)
    deadline = None if limit is None else time.monotonic() + limit
    half = (float(half_spot_deg), float(half_field_deg))
    found = _empty(name, angles, azimuths, half, rays)
    known: set[str] = set()
    done = 0
    with Shown(progress) as shown, answering(keys):
        counted = Counter(shown, 2 * found.index.size * rays)
        place = placed(scene.detector_registry.get(name).cs)
        looker = _Looker(session, scattered(exported, keys).document, name, place, fixed, deadline, known)
        try:
            for z, azimuth in enumerate(azimuths):
                for a, angle in enumerate(angles):
                    disk = port.towards(float(angle), float(azimuth), half[0])
                    _put(found, (a, z), looker, disk, half, region, rays, whole_number("seed", seed), counted)
                    done += 1
        except TraceTimeoutError as stop:
            late = TraceTimeoutError(f"the glare took longer than timeout = {limit:g} s and was ended")
            raise with_partial(late, _stopped(found, done)) from stop
        except (KeyboardInterrupt, NsqGpuError) as stop:
            raise with_partial(stop, _stopped(found, done))
    few = int((found.num_hits < _FEW).sum())
    if few:
        warn(f"in {few} of {found.index.size} directions fewer than {_FEW} rays came into the image of the black spot: the index and its "
             "error say little; give more rays by num_rays, a larger region, or guide=True", ResultWarning)
    return found


def _empty(name: str, angles: np.ndarray, azimuths: np.ndarray, half: tuple[float, float], rays: int) -> VeilingGlare:
    shape = (len(angles), len(azimuths))
    unknown = [np.full(shape, np.nan) for _ in range(6)]
    return VeilingGlare(name, angles, azimuths, *unknown, np.zeros(shape, dtype=np.int64), np.full((*shape, 2), np.nan),
                        np.full(shape, np.nan), np.full(shape, np.nan), *half, rays)


def _stopped(found: VeilingGlare, done: int) -> VeilingGlare | None:
    return dataclasses.replace(found, partial=True) if done else None


# The opening


class _Disk(NamedTuple):
    """A disk that shines, across a direction."""

    position: np.ndarray
    #: Its axes, the columns of a rotation; light goes along the last.
    rotation: np.ndarray
    radius: float

    @property
    def area(self) -> float:
        return float(np.pi * self.radius**2)

    def source(self, template: Json, start_deg: float, end_deg: float) -> Json:
        """Return a source of the radiance within a range of angles about the axis [deg]."""
        count = max(int(np.ceil((end_deg - start_deg) / _STEP)), 4)
        polar = np.linspace(start_deg, end_deg, count + 1)
        intensity = np.maximum(np.cos(np.radians(polar)), 0.0)
        solid = np.pi * (np.sin(np.radians(end_deg)) ** 2 - np.sin(np.radians(start_deg)) ** 2)
        cs = frame(self.position, self.rotation)
        placement = {key: float(be.to_numpy(getattr(cs, key)).squeeze()) for key in ("x", "y", "z", "rx", "ry", "rz")}
        return {"type": "tabulated", "name": "field", "cs": placement, "spectrum": template["spectrum"],
                "medium": template.get("medium"), "polar_angles_deg": polar.tolist(), "azimuth_angles_deg": [0.0],
                "intensity": [intensity.tolist()], "total_flux": _RADIANCE * self.area * float(solid), "radius": self.radius}

    def towards(self, angle_deg: float, azimuth_deg: float, half_spot_deg: float) -> _Disk:
        """Return the disk that shines from a direction into this opening, from before it."""
        angle, azimuth = np.radians([angle_deg, azimuth_deg])
        # The spot lies towards (cos, sin) of the azimuth, so its light goes the other way.
        local = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        if angle_deg:
            axis = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
            cross = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
            local = local + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        rotation = self.rotation @ local
        spread = np.tan(np.radians(half_spot_deg))
        # The edge of the turned disk lies a sine of its radius nearer to the opening.
        tilt = abs(np.tan(angle))
        distance = self.radius * (tilt + _GAP) / max(1.0 - spread * tilt, 0.1)
        radius = (self.radius + distance * spread) * (1.0 + _GAP)
        distance = radius * tilt + _GAP * self.radius
        return _Disk(self.position - distance * rotation[:, 2], rotation, float(radius))


def _asked(given: Any, opening: Any) -> tuple[NSQScene, _Disk]:
    """Return the scene, and the opening through which it gets light."""
    if isinstance(given, Optic):
        scene = from_optic(given)
        return scene, _first_face(scene) if opening is None else _opening(scene, opening)
    if not isinstance(given, NSQScene) and not is_file(given):
        raise wrong_kind("scene_or_optic", given, "give Optiland's Optic, an NSQScene, or the path of its file")
    if is_file(given):
        from nsq_gpu.loading import load_scene

        given = load_scene(given)
    if not given.source_names:
        raise UsageError("the scene has no source; the field has the spectrum of the first one")
    return given, _opening(given, opening)


def _first_face(scene: NSQScene) -> _Disk:
    """Return the opening of an Optic: before its first face."""
    face = scene.surfaces[0]
    radius = float(getattr(face.geometry, "aperture_radius", None) or 0.0)
    if not isinstance(face, RefractiveComponent) or not radius:
        raise UsageError("the first face of the Optic does not refract, or has no edge; give the opening: opening=((x, y, z), radius)")
    position, rotation = placed(face.cs)
    edge = 0.999 * radius
    starts = np.array([[edge, 0.0, -10.0 * radius], [0.0, edge, -10.0 * radius]])
    t, _, hit, _ = face.geometry.ray_intersect(be.array(starts), be.array(np.tile([0.0, 0.0, 1.0], (2, 1))))
    rims = (be.to_numpy(t) - 10.0 * radius)[be.to_numpy(hit).astype(bool)]
    return _Disk(position + rotation[:, 2] * min(0.0, float(rims.min(initial=0.0))), rotation, radius)


def _opening(scene: NSQScene, given: Any) -> _Disk:
    """Return the opening of a scene."""
    beams = {name: live for name, live in zip(scene.source_names, scene.sources, strict=True) if _is_beam(live)}
    advice = "give its middle and radius, such as opening=((0, 0, -5), 20.0), or the name of a collimated source"
    if given is None:
        if len(beams) != 1:
            raise UsageError(f"opening is None, and the scene has {len(beams)} collimated sources; {advice}")
        given = next(iter(beams))
    if isinstance(given, str):
        if given not in beams:
            raise UsageError(f"opening is {given!r}, which is no collimated source; "
                             + (near(given, beams) if beams else advice))
        position, rotation = placed(beams[given].cs)
        return _Disk(position, rotation, float(be.to_numpy(beams[given].aperture_radius)))
    try:
        middle, radius = given
        position, radius = np.array([float(part) for part in middle]), float(radius)
    except (TypeError, ValueError):
        position, radius = np.zeros(0), 0.0
    if position.shape != (3,) or not np.isfinite(position).all() or not 0.0 < radius < np.inf:
        raise UsageError(f"opening is {given!r}; {advice}")
    return _Disk(position, np.eye(3), radius)


def _is_beam(source: Any) -> bool:
    from optiland.nonsequential.sources.collimated import CollimatedSource

    # Subclasses have no radius of a beam.
    return type(source) is CollimatedSource


def _detector(detectors: Sequence[Json], name: str | None) -> str:
    """Return the name of the detector that is meant."""
    with_map = [entry["name"] for entry in detectors if entry["type"] == "irradiance"]
    if not with_map:
        raise UsageError("the scene has no irradiance detector; add one where the image is")
    if name is None and len(with_map) > 1:
        raise UsageError(f"name the detector, one of {', '.join(map(repr, with_map))}: veiling_glare(..., detector={with_map[0]!r})")
    if name is not None and name not in with_map:
        raise UsageError(f"detector is {name!r}, which is no irradiance detector of the scene; {near(str(name), with_map)}")
    return with_map[0] if name is None else name


# What is seen


class _Seen(NamedTuple):
    """A map of a detector [W/mm^2], its errors and hits, and where its pixels are [mm]."""

    values: np.ndarray
    errors: np.ndarray
    hits: np.ndarray
    x: np.ndarray
    y: np.ndarray

    def within(self, centre: np.ndarray, radius: float) -> tuple[float, float, int]:
        """Return the mean of pixels that lie within a circle, its standard error, and the hits there."""
        x, y = (np.abs(places - middle) + _step(places) / 2.0 for places, middle in zip((self.x, self.y), centre, strict=True))
        farthest = np.hypot(*np.meshgrid(x, y))
        chosen = farthest <= max(radius, float(farthest.min()))
        count = int(chosen.sum())
        return (float(self.values[chosen].sum()) / count, float(np.sqrt((self.errors[chosen] ** 2).sum())) / count,
                int(round(float(self.hits[chosen].sum()))))

    def disk(self) -> tuple[np.ndarray, float]:
        """Return the middle and the radius of an even disk [mm]: by medians, because light far away must not count."""
        total = self.values.sum()
        middle = np.array([_median(places, self.values.sum(axis=axis)) for places, axis in ((self.x, 0), (self.y, 1))])
        x, y = np.meshgrid(self.x - middle[0], self.y - middle[1])
        order = np.argsort(np.hypot(x, y), axis=None)
        share = np.cumsum(self.values.ravel()[order]) / total
        # Half of an even disk lies within its radius over the root of 2.
        radius = np.hypot(x, y).ravel()[order][int(np.searchsorted(share, 0.5))]
        return middle, float(np.sqrt(2.0) * radius)


def _median(places: np.ndarray, weights: np.ndarray) -> float:
    """Return the place with half of the weight on either side, linear within a pixel."""
    share = np.cumsum(weights) / weights.sum()
    step = _step(places)
    return float(np.interp(0.5, np.concatenate([[0.0], share]), np.concatenate([places[:1] - step / 2, places + step / 2])))


def _step(places: np.ndarray) -> float:
    return float(places[1] - places[0]) if len(places) > 1 else 0.0


@dataclass(frozen=True)
class _Looker:
    """Traces one source into a detector."""

    session: Session
    document: Json
    detector: str
    #: Origin of the detector [mm], and its axes, the columns of a rotation.
    place: tuple[np.ndarray, np.ndarray]
    options: Mapping[str, Any]
    deadline: float | None
    known: set[str]

    def see(self, source: Json, pixels: tuple[int, int], rays: int, seed: int, counted: Counter | None,
            region: Json | None = None) -> _Seen:
        """Return what the detector sees of a source alone, in so many pixels along x and y; rays for it scatter to the region, a shape."""
        entries = []
        for entry in self.document["detectors"]:
            if entry["name"] == self.detector:
                entry = {**entry, "num_pixels_x": pixels[0], "num_pixels_y": pixels[1], "splat": "hard"}
            # A far field around the scene would take the light before it is in.
            entries.append({**entry, "absorb": False} if entry["type"] == "far_field" else entry)
        block = {key: value for key, value in self.document.get("nsq_gpu", {}).items() if key != "elements"}
        targets = block.get("sampling", {}).get("scatter_to")
        if region is not None and targets:
            targets = [{**to, "target": region} if to["target"] == self.detector else to for to in targets]
            block["sampling"] = {**block["sampling"], "scatter_to": targets}
        document = {**self.document, "sources": [source], "detectors": entries, **({"nsq_gpu": block} if block else {})}
        left = None if self.deadline is None else max(self.deadline - time.monotonic(), 0.0)
        answer = self.session.request(to_json(document, indent=None), {**self.options, "num_rays": rays, "seed": seed}, timeout=left,
                                      name=EXPORTED, progress=None if counted is None else counted.of_json)
        self._warn(answer.report)
        if counted is not None:
            counted.add(rays)
        arrays = answer.arrays(self.detector)
        return _Seen(*(arrays[key] for key in ("irradiance", "standard_error", "hits", "x_coords", "y_coords")))

    def _warn(self, report: Json) -> None:
        # Of the map its region is what counts.
        beside = ("undersampled", "no ray reached ")
        grave = [said for said in report["diagnostics"]["grave"] if not any(part in said for part in beside)]
        warn_of({**report, "diagnostics": {**report["diagnostics"], "grave": grave}}, None, self.known)


def _put(found: VeilingGlare, place: tuple[int, int], looker: _Looker, disk: _Disk, half: tuple[float, float], region: float, rays: int,
         seed: int, counted: Counter) -> None:
    """Trace a direction, and put what is found into the arrays."""
    template = looker.document["sources"][0]
    spot = disk.source(template, 0.0, half[0])
    entry = next(entry for entry in looker.document["detectors"] if entry["name"] == looker.detector)
    size = np.array([entry["width"], entry["height"]], dtype=float)
    centre, radius = _image(looker, spot, size, seed, found, place)
    pitch = 2.0 * region * radius / _IN_REGION
    pixels = np.ceil(size / pitch).astype(int)
    if pixels.max() > _MOST:
        raise UsageError(f"the image of the spot has a radius of {radius:.3g} mm, and {found.detector!r} {size.max():g} mm: the region "
                         "would need too many pixels; give a larger half_spot_deg or region, or a smaller detector")
    grid = (int(pixels[0]), int(pixels[1]))
    within = region * radius
    # A target in the scene's frame.
    position, axes = looker.place
    middle = position + axes[:, :2] @ centre
    shape = {"disk": {"center": middle.tolist(), "normal": axes[:, 2].tolist(), "radius": within}}
    black, black_error, hits = looker.see(disk.source(template, *half), grid, rays, seed, counted, shape).within(centre, within)
    bright, bright_error, _ = looker.see(spot, grid, rays, seed + 1, counted, shape).within(centre, within)
    white = black + bright
    if not bright > 0.0:
        raise UsageError(f"no light of the spot came to the middle of its image on {found.detector!r}; give more rays by num_rays")
    found.black[place], found.black_standard_error[place] = black / _RADIANCE, black_error / _RADIANCE
    found.white[place], found.white_standard_error[place] = white / _RADIANCE, float(np.hypot(black_error, bright_error)) / _RADIANCE
    found.index[place] = black / white
    # Of the ratio, by the errors of two traces that are independent.
    found.standard_error[place] = float(np.hypot(bright * black_error, black * bright_error)) / white**2
    found.num_hits[place], found.centre[place] = hits, centre
    found.image_radius[place], found.region_radius[place] = radius, within


def _image(looker: _Looker, spot: Json, size: np.ndarray, seed: int, found: VeilingGlare,
           place: tuple[int, int]) -> tuple[np.ndarray, float]:
    """Return the middle and the radius of the spot's image [mm]."""
    direction = f"{found.angles_deg[place[0]]:g} degrees"
    for finest in (_COARSE, _MOST):
        pixels = np.maximum(np.ceil(finest * size / size.max()), 1).astype(int)
        seen = looker.see(spot, (int(pixels[0]), int(pixels[1])), _PILOT_RAYS, seed + 1, None)
        if not seen.values.sum() > 0.0:
            raise UsageError(f"no light of the spot at {direction} comes to {found.detector!r}; look at the opening and the detector's "
                             "size")
        centre, radius = seen.disk()
        if radius > 4.0 * size.max() / finest:
            return centre, radius
    raise UsageError(f"the image of the spot at {direction} has a radius of {radius:.2g} mm, some pixels of {found.detector!r} or less; "
                     "give a larger half_spot_deg, or a smaller detector")
