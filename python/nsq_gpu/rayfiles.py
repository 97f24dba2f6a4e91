"""Ray files, read without the program: IES TM-25, source files of Zemax OpticStudio, and columns of a ray database.

The rays and their flux are those that the program reads, to the last bit. Its readers are in ``src/scene/ray_files``, and name
the sources of the layouts.
"""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from nsq_gpu.errors import UnsupportedSceneError, UsageError

#: Endings of the names of ray files.
ENDINGS = (".tm25ray", ".dat", ".sdf", ".npz")
#: Most rays of a file that are held.
MOST_RAYS = (1 << 20) - 1
#: Difference of a direction's length from 1 up to which it is taken for rounding.
_UNIT_LENGTH = 1e-3
#: Relative difference of a stated flux from the sum of the rays that is taken for rounding.
_ROUNDED_FLUX = 2.0**-20

_TM25, _VERSION = b"TM25", 2013
#: Columns that a flag of TM-25 stands for, in the order of the flags and of the columns.
_COLUMNS = (("position", 3), ("direction", 3), ("radiant flux", 1), ("wavelength", 1), ("luminous flux", 1),
            ("Stokes parameters", 6), ("tristimulus values X and Z", 2), ("spectrum index", 1))
#: The header of a TM-25 file, up to the texts, and bytes of the whole.
_TM25_HEADER = np.dtype({"names": ["version", "lumens", "watts", "num_rays", "identifier", "wavelength", "num_tables", "num_names",
                                   "text_bytes", "flags"],
                         "formats": ["<i4", "<f4", "<f4", "<u8", "<i4", "<f4", "<i4", "<i4", "<i4", ("<i4", 8)],
                         "offsets": [4, 12, 16, 20, 60, 64, 76, 80, 84, 256], "itemsize": 288})
_TM25_BYTES = 36_288
#: Tables end at a multiple of so many bytes; bytes of the name of an additional column; most pairs of a spectrum, and columns.
_ALIGNMENT, _NAME_BYTES, _MOST_PAIRS, _MOST_NAMES = 32, 512, 1 << 16, 1000

#: First words of a binary source file of OpticStudio, and its header.
_ZEMAX_VERSIONS = (1010, 8_675_309)
_ZEMAX_HEADER = np.dtype({"names": ["version", "num_rays", "flux", "wavelength", "unit", "format", "kind"],
                          "formats": ["<i4", "<u4", "<f4", "<f4", "<i4", "<i4", "<i4"], "offsets": [0, 4, 112, 116, 136, 192, 196],
                          "itemsize": 208})
#: Millimetres of the units of a source file: m, in, cm, ft, mm.
_MILLIMETRES = (1000.0, 25.4, 10.0, 304.8, 1.0)
#: Fewest bytes of a ray in a text file: seven digits and what parts them; and bytes that no line has.
_LEAST_LINE, _LONGEST_LINE = 13, 4096


@dataclass(frozen=True)
class Rays:
    """The rays of a file, checked."""

    #: Start points [mm] and unit directions, shape (N, 3).
    starts: np.ndarray
    directions: np.ndarray
    #: Flux of each ray, in ``unit``.
    flux: np.ndarray
    #: Wavelength of each ray [um]; None if the file has none, or a spectrum of all rays.
    wavelength: np.ndarray | None
    #: ``"W"`` or ``"lm"``; None if the file does not say.
    unit: str | None
    #: Flux of all rays, in ``unit``.
    total: float
    #: What the header states in its place; None if it states the same, nothing, or what does not bind.
    stated: float | None


def read(path: str) -> Rays:
    """Return the rays of a file. Its first bytes say which format it has; for text the name does.

    Raises:
        UsageError: It is no ray file, or something in it is not understood.
        UnsupportedSceneError: It has more than ``MOST_RAYS`` rays.
    """
    try:
        with open(path, "rb") as file:
            start = file.read(64)
        size = os.stat(path).st_size
        if start[:4] == _TM25:
            return _tm25(path, size)
        if start[:2] == b"PK":
            return _npz(path)
        if len(start) >= 4 and int.from_bytes(start[:4], "little", signed=True) in _ZEMAX_VERSIONS:
            return _zemax(path, size)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}; give the path of a ray file") from None
    ending = Path(path).suffix.lower()
    if ending in (".dat", ".sdf") and all(byte in b"\t\r\n" or 32 <= byte < 127 for byte in start):
        return _text(path, size)
    shown = " ".join(f"{byte:02x}" for byte in start[:4])
    what = "does not begin with TM25, but with" if ending == ".tm25ray" else "is of no known format: it begins with"
    if len(start) >= 4 and int.from_bytes(start[:4], "big", signed=True) in _ZEMAX_VERSIONS:
        _refuse(path, "it is a Zemax source file in big-endian order", "export it in little-endian order")
    _refuse(path, f"it {what} the bytes {shown}", "give rays as IES TM-25, as a Zemax source file, or as a ray database's .npz")


def _refuse(path: str, problem: str, remedy: str) -> NoReturn:
    raise UsageError(f"{path}: {problem}; {remedy}")


def _rays(path: str, starts: np.ndarray, directions: np.ndarray, flux: np.ndarray, wavelength: np.ndarray | None, unit: str | None,
          stated: float = math.nan) -> Rays:
    """Check rays, and return them with directions of length 1."""
    square = directions * directions
    length = np.sqrt(square[:, 0] + square[:, 1] + square[:, 2])
    _check(path, np.isfinite(starts).all(axis=1), "position", "give finite numbers")
    # A NaN is not within.
    _check(path, np.abs(length - 1.0) <= _UNIT_LENGTH, "direction", "give unit vectors, to within 0.001")
    _check(path, np.isfinite(flux) & (flux >= 0.0), "flux", "give finite numbers of 0 or more")
    if wavelength is not None:
        _check(path, np.isfinite(wavelength) & (wavelength > 0.0), "wavelength", "give finite numbers above 0")
    total = math.fsum(flux)
    differs = stated > 0.0 and abs(total - stated) > _ROUNDED_FLUX * max(total, stated)
    return Rays(starts, directions / length[:, None], flux, wavelength, unit, total, stated if differs else None)


def _check(path: str, right: np.ndarray, what: str, remedy: str) -> None:
    if not right.all():
        _refuse(path, f"the {what} of ray {np.flatnonzero(~right)[0]} is none", remedy)


def _check_count(path: str, count: int) -> None:
    if count > MOST_RAYS:
        raise UnsupportedSceneError(f"{path}: it has {count} rays, and for Optiland's backends at most {MOST_RAYS} are read; trace the "
                                    "scene by NsqGpuBackend, which takes more, or give a smaller file")
    if count == 0:
        _refuse(path, "the file has no rays with light", "give a file with rays")


def _records(path: str, size: int, start: int, count: int, columns: int) -> np.ndarray:
    """Return the f4 records of a file as f8, (count, columns). The file must end with its last ray."""
    end = start + 4 * columns * count
    if end != size:
        remedy = "the file is cut off, or its header is wrong" if end > size else "a ray file ends with its last ray"
        _refuse(path, f"{count} rays of {4 * columns} bytes end at byte {end}, and the file has {size} bytes",
                f"{remedy}: fetch or export it again")
    _check_count(path, count)
    return np.fromfile(path, "<f4", count * columns, offset=start).reshape(count, columns).astype(np.float64)


def _header(path: str, size: int, layout: np.dtype, num_bytes: int) -> np.void:
    if size < num_bytes:
        _refuse(path, f"the file ends within its header of {num_bytes} bytes", "the file is cut off: fetch or export it again")
    header: np.void = np.fromfile(path, layout, 1)[0]
    return header


# IES TM-25


def _tm25(path: str, size: int) -> Rays:
    header = _header(path, size, _TM25_HEADER, _TM25_BYTES)
    if header["version"] != _VERSION:
        _refuse(path, f"the version is {header['version']}", "version 2013 is read: export the rays as that")
    flags = [int(flag) for flag in header["flags"]]
    for i, (flag, (name, _)) in enumerate(zip(flags, _COLUMNS, strict=True)):
        if flag not in ((1,) if i < 2 else (0, 1)):
            _refuse(path, f"the flag of the {name} is {flag}", "flags are 0 or 1, and 1 for position and direction")
    if not flags[2] and not flags[4]:
        _refuse(path, "its rays have neither radiant nor luminous flux", "set one of the two flags; the standard asks for it")
    places = np.cumsum([0, *(width * flag for flag, (_, width) in zip(flags, _COLUMNS, strict=True))]).tolist()
    unit, flux, stated = ("W", places[2], header["watts"]) if flags[2] else ("lm", places[4], header["lumens"])
    if stated < 0.0 or math.isinf(stated):
        _refuse(path, f"the total flux is {stated}", "it is 0 or more, or NaN if it is unknown")
    start = _end_of_tables(path, size, int(header["num_tables"]), int(header["identifier"]) == 3)
    single = float(header["wavelength"])
    _check_identifier(path, int(header["identifier"]), single, bool(flags[3]), int(header["num_tables"]))
    num_names, text_bytes = int(header["num_names"]), int(header["text_bytes"])
    if not 0 <= num_names <= _MOST_NAMES:
        _refuse(path, f"the number of additional columns is {num_names}", "0 to 1000 are read")
    start += _NAME_BYTES * num_names + max(text_bytes, 0)
    if text_bytes < 0 or start > size:
        _refuse(path, f"{num_names} additional columns and a text of {text_bytes} bytes, in a file of {size}",
                "the file is cut off, or its header is wrong")
    table = _records(path, size, start, int(header["num_rays"]), places[-1] + num_names)
    wavelength = None
    if header["identifier"] == 1:
        wavelength = np.full(len(table), single * 1e-3)
    elif header["identifier"] == 2:
        wavelength = table[:, places[3]] * 1e-3
    return _rays(path, table[:, :3], table[:, 3:6], table[:, flux], wavelength, unit, float(stated))


def _check_identifier(path: str, identifier: int, single: float, has_wavelength: bool, num_tables: int) -> None:
    problem, remedy = "", ""
    if identifier == 1 and not (math.isfinite(single) and single > 0.0):
        problem, remedy = f"1, and a wavelength of {single} nm", "identifier 1 goes with one above 0"
    elif identifier == 2 and not has_wavelength:
        problem, remedy = "2, without a wavelength of each ray", "set the wavelength flag at byte 268"
    elif identifier == 3 and num_tables != 1:
        problem, remedy = f"3, with {num_tables} spectral tables", "identifier 3 goes with one for all rays"
    elif identifier == 4:
        problem = "4: rays choose among several spectra"
        remedy = "export a wavelength for each ray (identifier 2), or one file for each spectrum"
    elif identifier not in (0, 1, 2, 3):
        problem, remedy = str(identifier), "0 none, 1 one wavelength, 2 one for each ray, 3 one spectrum, 4 several"
    if problem:
        _refuse(path, f"the spectral identifier is {problem}", remedy)


def _end_of_tables(path: str, size: int, count: int, is_used: bool) -> int:
    """Return the byte behind the spectral tables. The spectrum itself is the source's, and is only checked."""
    if count < 0:
        _refuse(path, f"the number of spectral tables is {count}", "it is 0 or more")
    place = _TM25_BYTES
    for number in range(1, count + 1):
        if place + 4 > size:
            _refuse(path, f"the file ends before spectral table {number} of {count}", "fetch or export it again")
        pairs = int(np.fromfile(path, "<i4", 1, offset=place)[0])
        if not 1 <= pairs <= _MOST_PAIRS:
            _refuse(path, f"spectral table {number} has {pairs} pairs", "a spectrum has 1 to 65536 pairs of wavelength and weight")
        if (end := place + 4 + 8 * pairs) > size:
            _refuse(path, f"spectral table {number} ends at byte {end}, and the file at {size}", "fetch or export it again")
        if number == 1:
            nm, weights = np.fromfile(path, "<f4", 2 * pairs, offset=place + 4).reshape(pairs, 2).T.astype(np.float64)
            right = np.isfinite(nm) & (np.diff(nm, prepend=0.0) > 0.0) & np.isfinite(weights) & (weights >= 0.0)
            if not right.all():
                wrong = np.flatnonzero(~right)[0]
                _refuse(path, f"the spectrum has the pair {nm[wrong]:g} nm, {weights[wrong]:g}",
                        "wavelengths rise from above 0, and weights are 0 or more")
        place = end
    return _TM25_BYTES + math.ceil((place - _TM25_BYTES) / _ALIGNMENT) * _ALIGNMENT


# Zemax OpticStudio


def _millimetres(path: str, unit: float) -> float:
    if unit not in range(len(_MILLIMETRES)):
        _refuse(path, f"the unit of length is {unit:g}", "0 is for m, 1 for in, 2 for cm, 3 for ft, 4 for mm")
    return _MILLIMETRES[int(unit)]


def _zemax(path: str, size: int) -> Rays:
    header = _header(path, size, _ZEMAX_HEADER, _ZEMAX_HEADER.itemsize)
    scale, layout, kind = _millimetres(path, int(header["unit"])), int(header["format"]), int(header["kind"])
    if layout not in (0, 2):
        _refuse(path, f"the format of rays is {layout}",
                "0 is for flux only, 2 for spectral color; export the rays in one of these")
    if kind not in ((0, 1) if layout == 0 else (0,)):
        _refuse(path, f"the kind of flux is {kind}", "0 is for W, and 1 for lm, which goes with the format flux only")
    table = _records(path, size, _ZEMAX_HEADER.itemsize, int(header["num_rays"]), 8 if layout == 2 else 7)
    single = float(header["wavelength"])
    wavelength = None
    if layout == 2:
        wavelength = table[:, 7]
    elif math.isfinite(single) and single > 0.0:
        wavelength = np.full(len(table), single)
    # The flux of the header binds nothing: OpticStudio does not read it.
    return _rays(path, table[:, :3] * scale, table[:, 3:6], table[:, 6], wavelength, "lm" if kind == 1 else "W")


def _text(path: str, size: int) -> Rays:
    with open(path, encoding="utf-8", newline="\n") as file:
        try:
            return _lines(path, size, file)
        except UnicodeDecodeError:
            _refuse(path, "it is no text", "a text source file holds numbers alone")


def _lines(path: str, size: int, file: Iterable[str]) -> Rays:
    # The mark for the end of a file, of old systems, is no line.
    lines = (line for line in file if line.strip("\x1a \t\r\n\v\f"))
    remedy = "the first line is the number of rays and the unit of length: 0 m, 1 in, 2 cm, 3 ft, 4 mm"
    header = next(lines, None)
    if header is None:
        _refuse(path, "the file is empty", remedy)
    first = _numbers(header) or []
    # Some programs pad it with zeros to the width of a ray.
    if len(first) < 2 or any(first[2:]):
        _refuse(path, "its first line is no header of a text source file", remedy)
    if not (first[0] >= 0.0 and first[0].is_integer() and _LEAST_LINE * first[0] <= size + 1):
        _refuse(path, f"{first[0]:g} rays cannot be, in a file of {size} bytes", remedy)
    count, scale = int(first[0]), _millimetres(path, first[1])
    _check_count(path, count)
    rows: list[list[float]] = []
    for line in lines:
        if len(rows) == count:
            _refuse(path, f"more lines follow the {count} rays of the first line",
                    "correct the number of rays, or remove the lines")
        numbers = _numbers(line)
        if numbers is None or len(numbers) not in (7, 8) or (rows and len(numbers) != len(rows[0])):
            width = len(rows[0]) if rows else 7
            _refuse(path, f"ray {len(rows)} is {line.strip()[:80]!r}, and not {width} numbers",
                    "a ray is x y z L M N flux, and all rays or none have a wavelength in um")
        rows.append(numbers)
    if len(rows) < count:
        _refuse(path, f"the file ends after {len(rows)} of {count} rays", "fetch or export it again, or correct its first line")
    table = np.array(rows)
    return _rays(path, table[:, :3] * scale, table[:, 3:6], table[:, 6], table[:, 7] if table.shape[1] == 8 else None, None)


def _numbers(line: str) -> list[float] | None:
    """Return the numbers of a line; None if it has something else."""
    # Python takes more for a number: underscores between digits, and digits of other scripts.
    if len(line) >= _LONGEST_LINE or "_" in line or not line.isascii():
        return None
    try:
        return [float(word) for word in line.split()]
    except ValueError:
        return None


# Ray databases


def _npz(path: str) -> Rays:
    names = ("x", "y", "z", "L", "M", "N", "flux", "wavelength")
    try:
        with zipfile.ZipFile(path) as archive:
            packed = [member.filename for member in archive.infolist() if member.compress_type != zipfile.ZIP_STORED]
        with np.load(path) as file:
            found = {name: np.asarray(file[name]) for name in names if name in file.files}
    # What zipfile and NumPy raise of damaged archives; RuntimeError where one is encrypted.
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        _refuse(path, str(error) or "the archive ends too soon", "give a ray database's file, as the program and numpy.savez write it")
    for name in names[:-1]:
        if name not in found:
            _refuse(path, f"there is no column {name!r}", "a ray file has the columns x, y, z, L, M, N, flux, and wavelength")
    count = len(found["x"]) if found["x"].ndim else 0
    _check_count(path, count)
    for name, column in found.items():
        # The program reads columns where they lie in the file.
        if f"{name}.npy" in packed or column.dtype != np.dtype("<f8") or column.shape != (count,):
            _refuse(path, f"the column {name!r} is no uncompressed array of f8 of shape ({count},)",
                    "write the columns by numpy.savez")
    starts, directions = (np.stack([found[name] for name in part], axis=1) for part in (names[:3], names[3:6]))
    return _rays(path, starts, directions, found["flux"], found.get("wavelength"), "W")
