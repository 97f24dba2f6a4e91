"""Measured scattering with azimuth: tables about the mirrored ray, from files of Zemax (``.bsdf``) or from CSV.

>>> paint = MeasuredBSDF.from_file("black.bsdf")
>>> scene.add_mirror("baffle", frame, MirrorConfig(math.inf, 1.0, surface=SurfaceConfig(bsdf=paint)))
"""

from __future__ import annotations

import math
import re
from collections import deque
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import optiland.backend as be
from optiland.backend.utils import to_numpy
from optiland.nonsequential.bsdf import TabulatedBSDF
from optiland.nonsequential.bsdf.lambertian import _orthonormal_basis
from optiland.nonsequential.rng import EventSlot

from nsq_gpu.errors import UsageError
from nsq_gpu.intensity import IntensityTable, _between, _polar_knots, numbers

#: Where the normal is nearer to the reference direction than that [rad], azimuth 0 is a tangent of the normal.
_NORMAL = 1e-5
#: Azimuths end at 180, 360, or one step below 360, within so much [deg].
_END = 1e-3
#: Nodes and weights of Gauss and Legendre on 0 to 1.
_NODES, _WEIGHTS = (0.5 * (np.polynomial.legendre.leggauss(24)[0] + 1.0), 0.5 * np.polynomial.legendre.leggauss(24)[1])
#: Sums round.
_EXCESS = 1e-9

_AXES = {"angleofincidence": "angle_of_incidence_deg", "scatterazimuth": "scatter_azimuth_deg", "scatterradial": "scatter_radial_deg"}
#: Lines of a Zemax file that have one word, and what that may be.
_WORDS = {"symmetry": ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical4D"), "spectralcontent": ("Monochrome", "XYZ"),
          "scattertype": ("BRDF", "BTDF")}
_COLUMNS = (*_AXES.values(), "bsdf")
_EXAMPLE = "angle_of_incidence_deg,scatter_azimuth_deg,scatter_radial_deg,bsdf"


class MeasuredBSDF(TabulatedBSDF):
    """A BSDF by the angle of incidence, and by radial angle and azimuth about the reference direction.

    The reference direction is the mirrored ray's; of a BTDF, the ray's own. The azimuth is 0 towards the normal, and
    grows counter-clockwise as somebody sees it whom that ray reaches. Values are linear in all three angles. They are 0 beyond the
    last radial angle and below the surface. Beyond the angles of incidence, the nearest ones count.

    To Optiland it is a tabulated lobe whose sampling is its own.

    Args:
        angle_of_incidence_deg: Angles of incidence [deg], rising within 0 to 90, shape (K,).
        scatter_azimuth_deg: Azimuths [deg] that rise from 0, shape (J,): to 180, where they are mirrored; to 360, or one step below;
            or 0 alone, for all.
        scatter_radial_deg: Radial angles [deg] that rise from 0, to 180 at most, shape (I,).
        values: The BSDF [1/sr], shape (K, J, I).
        tis: Of each angle of incidence, the share of the light that scatters; the integral of BSDF cos(theta) if None.
        scatter_type: "BRDF" or "BTDF".

    Raises:
        ValueError: An argument is out of range.
    """

    def __init__(self, angle_of_incidence_deg: Any, scatter_azimuth_deg: Any, scatter_radial_deg: Any, values: Any, tis: Any = None,
                 scatter_type: str = "BRDF") -> None:
        self.angle_of_incidence_deg = _angles("angle_of_incidence_deg", angle_of_incidence_deg, 90.0)
        self.scatter_azimuth_deg = _azimuths("scatter_azimuth_deg", scatter_azimuth_deg)
        self.scatter_radial_deg = _radial_angles("scatter_radial_deg", scatter_radial_deg)
        shape = tuple(map(len, (self.angle_of_incidence_deg, self.scatter_azimuth_deg, self.scatter_radial_deg)))
        self.values = _amounts("values", values, shape, "angle of incidence, azimuth and radial angle")
        self.given_tis = None if tis is None else _amounts("tis", tis, shape[:1], "angle of incidence")
        if scatter_type not in _WORDS["scattertype"]:
            raise ValueError(f"scatter_type is {scatter_type!r}; give 'BRDF' or 'BTDF'")
        self.scatter_type = scatter_type
        # What Optiland asks of a table.
        self.path: Path | None = None
        self.transmissive_fraction = float(scatter_type == "BTDF")
        self._prepare()

    @classmethod
    def from_file(cls, path: str | Path) -> MeasuredBSDF:
        """Read a tabular BSDF of Zemax (``.bsdf``), or a CSV file.

        A CSV file begins with the names of its columns, in any order: angle_of_incidence_deg, scatter_azimuth_deg, scatter_radial_deg
        and bsdf. Every combination stands in it once, in any order. A comment "# scatter_type: BTDF" makes it a BTDF.

        Raises:
            OSError: The file cannot be read.
            ValueError: It is no such file; the message has the line.
        """
        path = Path(path)
        readers = {".bsdf": _Zemax, ".csv": _Csv}
        reader = readers.get(path.suffix.lower())
        if reader is None:
            raise ValueError(f"{path.name}: the name ends with {path.suffix!r}; give a Zemax file, .bsdf, or a table, .csv")
        found = reader(path.name, path.read_text(encoding="utf-8-sig", errors="replace"))
        try:
            bsdf = cls(**found.fields)
        except ValueError as error:
            # Every message begins with the argument.
            name = re.match(r"\w*(\[\d+\])?", str(error))[0]  # type: ignore[index]
            line = found.places.get(name, found.places.get(name.partition("[")[0]))
            raise ValueError(f"{path.name}:{line}: {error}" if line else f"{path.name}: {error}") from error
        bsdf.path = path
        return bsdf

    def _prepare(self) -> None:
        circle, order = _full_circle(self.scatter_azimuth_deg)
        self._rows = [_Row(self.scatter_radial_deg, circle, values[order]) if values.any() else None for values in self.values]
        within = np.array([_within_hemisphere(incidence, circle, self.scatter_radial_deg, values[order])
                           for incidence, values in zip(self.angle_of_incidence_deg, self.values, strict=True)])
        #: Of each angle of incidence, the share of the light that scatters.
        self.tis = within.copy() if self.given_tis is None else self.given_tis
        for k in np.flatnonzero((within == 0.0) & (self.tis > 0.0)):
            raise ValueError(f"tis[{k}] is {self.tis[k]:g}, and all values above the surface there are 0; give 0, or values above 0")
        scale = np.divide(self.tis, within, out=np.ones_like(within), where=within > 0.0)
        self._levels = scale * np.array([row.flux if row else 0.0 for row in self._rows])
        for array in (self.angle_of_incidence_deg, self.scatter_azimuth_deg, self.scatter_radial_deg, self.values, self.tis):
            array.setflags(write=False)

    def with_tis_1(self) -> MeasuredBSDF:
        """Return this BSDF over its total integrated scatter at the first angle of incidence."""
        first = self.tis[0]
        values, tis = (self.values / first, None) if self.given_tis is None else (self.values, self.given_tis / first)
        return MeasuredBSDF(self.angle_of_incidence_deg, self.scatter_azimuth_deg, self.scatter_radial_deg, values, tis, self.scatter_type)

    def sample(self, num_rays: int, incident_dirs: Any, normals: Any, wavelengths: Any, rng: Any, ray_id: Any,
               bounce: Any) -> tuple[Any, Any, Any]:
        """Draw scattered directions, weights and sides: Optiland's own contract."""
        incident, facing = (np.asarray(to_numpy(given), dtype=np.float64) for given in (incident_dirs, normals))
        is_btdf = self.scatter_type == "BTDF"
        reference = incident if is_btdf else incident - 2.0 * _dot(incident, facing) * facing
        normal = np.where(_dot(reference, facing) < 0.0, -facing, facing)
        cosine = _dot(reference, normal)
        across = normal - cosine * reference
        sine = np.linalg.norm(across, axis=1, keepdims=True)
        # Optiland's basis has another sign at a normal whose z is -0.
        tangent = _orthonormal_basis(facing + 0.0)[0]
        across = np.where(sine < _NORMAL, tangent - _dot(tangent, reference) * reference, across)
        across = _unit(across)
        # An arc cosine would have few digits near normal incidence.
        k, level, share = self._shares(np.degrees(np.arctan2(sine, cosine))[:, 0])
        u1, u2 = (np.asarray(rng.uniform(ray_id, bounce, slot)) for slot in (EventSlot.BSDF_U1, EventSlot.BSDF_U2))
        is_upper = u1 < share
        u1 = np.where(is_upper, u1 / np.where(is_upper, share, 1.0), (u1 - share) / np.where(is_upper, 1.0, 1.0 - share))
        chosen = k + is_upper
        local = np.tile([0.0, 0.0, 1.0], (len(chosen), 1))
        for place in np.unique(chosen[level > 0.0]):
            here, row = (chosen == place) & (level > 0.0), self._rows[place]
            assert row is not None
            local[here] = row.directions(u2[here], u1[here])
        scattered = local[:, :1] * across + local[:, 1:2] * np.cross(reference, across) + local[:, 2:] * reference
        scattered = _unit(scattered)
        weights = level * np.maximum(_dot(scattered, normal)[:, 0], 0.0)
        # Without weight, a ray keeps the specular direction, as beyond Optiland's other lobes.
        scattered = np.where((weights > 0.0)[:, None], scattered, reference)
        return be.array(scattered), be.array(weights), be.array(np.full(len(chosen), is_btdf))

    def _shares(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rows before angles of incidence [deg], the level there, and the next row's share of it."""
        if len(self._rows) == 1:
            k, at = np.zeros(len(theta), dtype=np.intp), np.zeros(len(theta))
        else:
            k, at = _between(self.angle_of_incidence_deg, theta)
        upper = at * np.append(self._levels, 0.0)[k + 1]
        level = (1.0 - at) * self._levels[k] + upper
        return k, level, np.divide(upper, level, out=np.zeros_like(level), where=level > 0.0)

    def reflectance(self, incident_dirs: Any, normals: Any, wavelengths: Any) -> Any:
        """Return the share of the light that scatters."""
        incident, facing = (np.asarray(to_numpy(given), dtype=np.float64) for given in (incident_dirs, normals))
        theta = np.degrees(np.arccos(np.clip(np.abs(_dot(incident, facing)[:, 0]), 0.0, 1.0)))
        return be.array(np.interp(theta, self.angle_of_incidence_deg, self.tis))


class _Row(IntensityTable):
    """What one angle of incidence scatters into radial angles and azimuths, drawn as the light of a lamp is."""

    def __init__(self, radial_deg: np.ndarray, circle_deg: np.ndarray, values: np.ndarray) -> None:
        # Unlike a lamp's, values may differ at the azimuths 0 and 360.
        self.polar_angles_deg, self._circle_deg, self._rows = radial_deg, circle_deg, values
        self._scale = float(values.max())
        self._theta = _polar_knots(np.radians(radial_deg))
        self._prepare()


def _full_circle(azimuths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return azimuths [deg] from 0 to 360, and which of the table's azimuths has the values of each."""
    order = np.arange(len(azimuths))
    if len(azimuths) == 1:
        return np.array([0.0, 360.0]), np.zeros(2, dtype=np.intp)
    if azimuths[-1] == 180.0:
        return np.concatenate([azimuths, 360.0 - azimuths[-2::-1]]), np.concatenate([order, order[-2::-1]])
    if azimuths[-1] == 360.0:
        return azimuths, order
    return np.append(azimuths, 360.0), np.append(order, 0)


def _within_hemisphere(incidence_deg: float, circle_deg: np.ndarray, radial_deg: np.ndarray, values: np.ndarray) -> float:
    """Return the integral of f cos(theta) over the hemisphere; theta is the angle from the normal.

    Over azimuth it is a closed form. Over the radial angle it is summed between the table's angles, and between those at which the
    horizon meets the table's azimuths, where the sum has kinks.
    """
    sine, cosine = math.sin(math.radians(incidence_deg)), math.cos(math.radians(incidence_deg))
    radial, phi = np.radians(radial_deg), np.radians(circle_deg)
    horizon = np.arctan2(cosine, -sine * np.cos(np.append(phi, np.pi)))
    edges = np.unique(np.concatenate([radial, horizon[horizon < radial[-1]]]))
    total = 0.0
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        # The horizon begins and ends with half powers of the angle; of the square, those are smooth.
        r = low + (high - low) * np.sin(0.5 * np.pi * _NODES) ** 2
        steps = (high - low) * 0.5 * np.pi * np.sin(np.pi * _NODES) * _WEIGHTS
        level, swing = (cosine * np.cos(r))[:, None], (sine * np.sin(r))[:, None]
        end = np.arccos(np.clip(np.divide(-level, swing, out=-np.sign(level), where=swing > 0.0), -1.0, 1.0))
        i, part = _between(radial, r)
        f = ((1.0 - part) * values[:, i] + part * values[:, i + 1]).T
        slope = np.diff(f, axis=1) / np.diff(phi)
        start = f[:, :-1] - slope * phi[:-1]

        def up_to(a: np.ndarray) -> np.ndarray:
            return np.asarray(start * (level * a + swing * np.sin(a))
                              + slope * (0.5 * level * a * a + swing * (a * np.sin(a) + np.cos(a))))

        first = up_to(np.minimum(phi[1:], end)) - up_to(np.minimum(phi[:-1], end))
        last = up_to(np.maximum(phi[1:], 2.0 * np.pi - end)) - up_to(np.maximum(phi[:-1], 2.0 * np.pi - end))
        total += float(((first + last).sum(axis=1) * np.sin(r) * steps).sum())
    return max(total, 0.0)


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.asarray((one * other).sum(axis=1, keepdims=True))


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Return unit vectors; of rays that hit nothing, zeros stay."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 1e-12)


def _numbers(name: str, values: Any) -> np.ndarray:
    try:
        return numbers(name, values) + 0.0
    except UsageError as error:
        raise ValueError(str(error)) from error


def _angles(name: str, values: Any, most: float) -> np.ndarray:
    angles = _numbers(name, values)
    if angles.ndim != 1 or not len(angles):
        raise ValueError(f"{name} has the shape {angles.shape}; give a list of angles")
    for place in np.flatnonzero((angles < 0.0) | (angles > most)):
        raise ValueError(f"{name}[{place}] is {angles[place]:g}; give angles from 0 to {most:g} deg")
    for place in np.flatnonzero(np.diff(angles) < 1e-9):
        raise ValueError(f"{name}[{place + 1}] is {angles[place + 1]:g}, after {angles[place]:g}; give angles that rise")
    return angles


def _from_0(name: str, values: Any, most: float) -> np.ndarray:
    angles = _angles(name, values, most)
    if angles[0] != 0.0:
        raise ValueError(f"{name}[0] is {angles[0]:g}; give angles that begin with 0 deg")
    return angles


def _azimuths(name: str, values: Any) -> np.ndarray:
    angles = _from_0(name, values, 360.0)
    if len(angles) == 1:
        return angles
    for end in (180.0, 360.0):
        if abs(angles[-1] - end) < _END:
            angles[-1] = end
            return angles
    if abs(2.0 * angles[-1] - angles[-2] - 360.0) > _END:
        raise ValueError(f"{name}[{len(angles) - 1}] is {angles[-1]:g}; give angles that end with 180, with 360 or one step below 360 deg, "
                         "or 0 alone for all azimuths")
    return angles


def _radial_angles(name: str, values: Any) -> np.ndarray:
    angles = _from_0(name, values, 180.0)
    if len(angles) < 2:
        raise ValueError(f"{name} has one angle; give two or more")
    return angles


def _amounts(name: str, values: Any, shape: tuple[int, ...], of_each: str) -> np.ndarray:
    """Return numbers of 0 or more, one of each."""
    array = _numbers(name, values)
    if array.shape != shape:
        raise ValueError(f"{name} has the shape {array.shape}; give a number for each {of_each}: {shape}")
    for place in np.argwhere(array < 0.0):
        raise ValueError(f"{name}{''.join(f'[{i}]' for i in place)} is {array[tuple(place)]:g}; give numbers of 0 or more")
    return array


class _File:
    """The lines of a file with words in them, and what they say."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.text = text.split("\n")
        #: Arguments of the BSDF, and the lines that they are from.
        self.fields: dict[str, Any] = {}
        self.places: dict[str, int] = {}
        self.read()

    def read(self) -> None:
        raise NotImplementedError

    def refuse(self, line: int | None, what: str) -> NoReturn:
        raise ValueError(f"{self.name}: {what}" if line is None else f"{self.name}:{line}: {what}")

    def numbers(self, line: int, words: list[str], least: float) -> list[float]:
        found = []
        for word in words:
            try:
                number = float(word)
            except ValueError:
                number = math.nan
            if not math.isfinite(number) or "_" in word:
                self.refuse(line, f"{word!r} stands where a number is due; give a number, such as 0.05")
            if number < least:
                self.refuse(line, f"it has the number {word}; give numbers of {least:g} or more")
            found.append(number)
        return found


class _Zemax(_File):
    """A tabular BSDF of Zemax."""

    def read(self) -> None:
        lines = ((number, line.partition("#")[0].split()) for number, line in enumerate(self.text, 1))
        self.lines = deque((number, words) for number, words in lines if words)
        said: dict[str, int] = {}
        while True:
            line, (word, *rest) = self.next("DataBegin")
            key = word.lower()
            if key in said:
                self.refuse(line, f"{word} stands here a second time, after line {said[key]}; one of them must go")
            said[key] = line
            if key == "databegin":
                break
            if key in _AXES or key == "samplerotation":
                self.axis(key, line, word, rest)
            elif key in _WORDS:
                self.word(key, line, word, rest)
            elif key not in ("source", "monochrome"):
                self.refuse(line, f"{word!r} is no word of a tabular BSDF; remove the line, or begin it with # as a comment")
        for key in ("ScatterType", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial"):
            if key.lower() not in said:
                self.refuse(line, f"the data begins, and there was no line {key}; add it above")
        self.data()

    def next(self, what: str) -> tuple[int, list[str]]:
        if not self.lines:
            self.refuse(None, f"the file ends, and {what} is due; is it cut off?")
        return self.lines.popleft()

    def axis(self, key: str, line: int, word: str, rest: list[str]) -> None:
        """Read how many angles there are, and the angles, on this line or the next ones."""
        if not rest or not rest[0].isdecimal():
            self.refuse(line, f"{word} has no number of angles; write it as {word} 2, and two angles on the next line")
        count = int(rest[0])
        if key == "samplerotation" and count > 1:
            self.refuse(line, f"SampleRotation has {count} angles: the sample is anisotropic, and surfaces are not; give a file of one rotation")
        found, last = self.numbers(line, rest[1:], -math.inf), line
        while len(found) < count:
            last, words = self.next(f"angle {len(found) + 1} of {count} of {word}")
            found += self.numbers(last, words, -math.inf)
        if len(found) > count:
            self.refuse(last, f"{word} has {len(found)} angles, and {count} in its number of angles; make them agree")
        if key in _AXES:
            self.fields[_AXES[key]], self.places[_AXES[key]] = found, line

    def word(self, key: str, line: int, word: str, rest: list[str]) -> None:
        known = {name.lower(): name for name in _WORDS[key]}
        found = known.get(" ".join(rest).lower())
        if found is None:
            self.refuse(line, f"{word} is {' '.join(rest)!r}; give {', '.join(known.values())}")
        if found == "XYZ":
            self.refuse(line, "SpectralContent is XYZ, a BSDF by colours; give a file of the content Monochrome")
        if key == "scattertype":
            self.fields["scatter_type"] = found

    def data(self) -> None:
        incidences, azimuths, radials = (self.fields[name] for name in _AXES.values())
        values: list[list[list[float]]] = []
        shares: dict[int, float] = {}
        for k, incidence in enumerate(incidences):
            rows: list[list[float]] = []
            while len(rows) < len(azimuths):
                what = f"the row of the azimuth {azimuths[len(rows)]:g} at the incidence {incidence:g}"
                line, words = self.next(what)
                if words[0].lower() == "tis" and not rows and k not in shares:
                    shares[k], self.places[f"tis[{k}]"] = self.share(line, words), line
                    continue
                if words[0].lower() in ("tis", "dataend"):
                    self.refuse(line, f"{words[0]} stands where {what} is due; add the row")
                found = self.numbers(line, words, 0.0)
                if len(found) != len(radials):
                    self.refuse(line, f"the row has {len(found)} values, and there are {len(radials)} radial angles; give one for each")
                rows.append(found)
            values.append(rows)
        line, words = self.next("DataEnd")
        if words[0].lower() != "dataend":
            self.refuse(line, "the rows of all angles are read, and DataEnd is due; remove what is too much")
        if self.lines:
            self.refuse(self.lines[0][0], "there is more after DataEnd; remove it")
        if shares and len(shares) < len(incidences):
            missing = next(incidences[k] for k in range(len(incidences)) if k not in shares)
            self.refuse(line, f"the incidence {missing:g} has no TIS, and others have; give it to all or to none")
        self.fields |= {"values": values, "tis": list(shares.values()) or None}

    def share(self, line: int, words: list[str]) -> float:
        if len(words) != 2:
            self.refuse(line, "TIS has one number; write it as TIS 0.05")
        share = self.numbers(line, words[1:], 0.0)[0]
        if share > 1.0 + _EXCESS:
            self.refuse(line, f"TIS is {words[1]}, more light than there is; give a share from 0 to 1")
        return share


class _Csv(_File):
    """A table with a header."""

    def read(self) -> None:
        order: list[int] | None = None
        found: dict[tuple[float, ...], float] = {}
        lines: dict[tuple[float, ...], int] = {}
        for line, text in enumerate(self.text, 1):
            content, _, comment = text.partition("#")
            if (stated := re.match(r"\s*scatter_type\s*:\s*(\S*)", comment, re.IGNORECASE)) is not None:
                self.fields["scatter_type"], self.places["scatter_type"] = stated[1].upper(), line
            words = [word.strip() for word in content.split(",")]
            if words == [""]:
                continue
            if order is None:
                order = self.header(line, [word.lower() for word in words])
                continue
            if len(words) != len(_COLUMNS):
                self.refuse(line, f"it has {len(words)} columns, and the header has {len(_COLUMNS)}; give a number in each")
            *key, value = (self.numbers(line, [words[place]], 0.0)[0] for place in order)
            if (angles := tuple(key)) in found:
                self.refuse(line, f"{self.combination(angles)} stands here a second time, after line {lines[angles]}; one of them must go")
            found[angles], lines[angles] = value, line
        if not found:
            self.refuse(None, f"there is no row; begin the file with the line {_EXAMPLE}, and rows below it")
        axes = [sorted(set(axis)) for axis in zip(*found, strict=True)]
        for angles in ((i, a, r) for i in axes[0] for a in axes[1] for r in axes[2]):
            if angles not in found:
                self.refuse(None, f"{self.combination(angles)} is missing; give every combination of the three angles")
        values = [[[found[i, a, r] for r in axes[2]] for a in axes[1]] for i in axes[0]]
        self.fields |= {**dict(zip(_AXES.values(), axes, strict=True)), "values": values}

    def header(self, line: int, words: list[str]) -> list[int]:
        """Return where the columns stand."""
        if sorted(words) != sorted(_COLUMNS):
            self.refuse(line, f"it names the columns {', '.join(words)}; write {_EXAMPLE}, in any order")
        return [words.index(column) for column in _COLUMNS]

    def combination(self, angles: tuple[float, ...]) -> str:
        return "incidence {:g}, azimuth {:g}, radial {:g}".format(*angles)
