"""Ray files read by this package: rays, flux and refusals are those of the program's readers, draw by draw."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.components.configs import LensConfig
from optiland.nonsequential.rng import NSQRng
from optiland.nonsequential.sources.base import Spectrum

import nsq_gpu
from nsq_gpu import rayfiles
from nsq_gpu.photometry import luminous_efficacy
from nsq_gpu.scene_file import scene_from_dict
from tests import live
from tests.live import cs, glass
from tests.test_ray_source import (
    Columns,
    assert_refused_by_the_program,
    assert_same_rays,
    columns,
    document,
    recorded,
    source,
    with_source,
)
from tests.test_session import session

# Files have f4, so that wavelengths are a little beside those of the source.
pytestmark = pytest.mark.filterwarnings("ignore::nsq_gpu.NsqGpuWarning")

#: Columns of a TM-25 ray by its flags, and their width.
WIDTHS = {"position": 3, "direction": 3, "watts": 1, "wavelength": 1, "lumens": 1, "stokes": 6, "tristimulus": 2, "index": 1}


def tm25(path: Path, rays: Columns, *, has: tuple[str, ...] = ("watts",), identifier: int = 0, single: float = math.nan,
         tables: tuple[list[tuple[float, float]], ...] = (), names: tuple[str, ...] = (), text: bytes = b"", total: float = 0.0) -> Path:
    """Write an IES TM-25 file; ``total`` is stated for all rays."""
    count = len(rays["x"])
    head = bytearray(36_288)
    struct.pack_into("<4sii2fQ", head, 0, b"TM25", 2013, 0, total if "lumens" in has else 0.0, total if "watts" in has else 0.0, count)
    struct.pack_into("<i3f3i", head, 60, identifier, single, math.nan, math.nan, len(tables), len(names), len(text))
    struct.pack_into("<8i", head, 256, *[int(name in ("position", "direction", *has)) for name in WIDTHS])
    shared = b"".join(struct.pack("<i", len(table)) + np.array(table, "<f4").tobytes() for table in tables)
    shared += bytes(-len(shared) % 32)
    written = b"".join(name.encode("utf-32-le").ljust(512, b"\0") for name in names) + text
    known = {"position": [rays[name] for name in "xyz"], "direction": [rays[name] for name in "LMN"], "watts": [rays["flux"]],
             "lumens": [rays["flux"]], "wavelength": [1000.0 * rays.get("wavelength", np.zeros(count))]}
    parts: list[np.ndarray] = []
    for name, width in WIDTHS.items():
        if name in ("position", "direction", *has):
            # What is not read is nonsense.
            parts += known.get(name, [np.full(count, -7.0)] * width)
    table = np.stack(parts + [np.full(count, math.nan)] * len(names), axis=1)
    path.write_bytes(bytes(head) + shared + written + table.astype("<f4").tobytes())
    return path


def zemax(path: Path, rays: Columns, *, layout: int = 2, kind: int = 0, unit: int = 4, single: float = 0.0, version: int = 1010) -> Path:
    """Write a binary source file of OpticStudio, whose header states another flux, which binds nothing."""
    head = bytearray(208)
    struct.pack_into("<iI", head, 0, version, len(rays["x"]))
    struct.pack_into("<2f", head, 112, 77.0, single)
    struct.pack_into("<i", head, 136, unit)
    struct.pack_into("<2i", head, 192, layout, kind)
    path.write_bytes(bytes(head) + np.stack([rays[name] for name in ordered(layout == 2)], axis=1).astype("<f4").tobytes())
    return path


def text(path: Path, rays: Columns, *, unit: int = 4, head: str | None = None, end: str = "\n", wavelength: bool = False) -> Path:
    """Write a text source file of OpticStudio."""
    rows = zip(*(rays[name].tolist() for name in ordered(wavelength)), strict=True)
    first = f"{len(rays['x'])} {unit}" if head is None else head
    path.write_bytes(end.join([first, *(" ".join(map(repr, row)) for row in rows), ""]).encode())
    return path


def ordered(wavelength: bool) -> tuple[str, ...]:
    return ("x", "y", "z", "L", "M", "N", "flux", "wavelength") if wavelength else ("x", "y", "z", "L", "M", "N", "flux")


#: Rays without wavelengths and with them, of fluxes that differ.
BARE, COLORED = columns(400), columns(400, lines=[0.501, 0.499, 0.612])
LISTED = Spectrum([0.5, 0.6, 0.55, 0.7], [1.0, 2.0, 1.0, 3.0])

Writer = Callable[[Path], Path]
#: Files that say their flux: what writes them, and the flux of their rays in W by hand.
FILES: dict[str, tuple[str, Writer]] = {
    "TM-25, bare": ("a.tm25ray", lambda path: tm25(path, BARE)),
    "TM-25, its name in capitals": ("a.TM25RAY", lambda path: tm25(path, BARE)),
    "TM-25, one wavelength": ("a.tm25ray", lambda path: tm25(path, BARE, identifier=1, single=612.5)),
    "TM-25, a wavelength of each ray": ("a.tm25ray", lambda path: tm25(path, COLORED, has=("watts", "wavelength"), identifier=2)),
    "TM-25, a spectrum": ("a.tm25ray", lambda path: tm25(path, BARE, identifier=3, tables=([(450.0, 0.5), (460.0, 1.0), (470.0, 0.0)],))),
    "TM-25, spectra that are not used": ("a.tm25ray", lambda path: tm25(path, BARE, tables=([(450.0, 0.5)], [(300.0, 1.0)] * 7))),
    "TM-25, lumens": ("a.tm25ray", lambda path: tm25(path, BARE, has=("lumens",))),
    "TM-25, lumens of each wavelength": ("a.tm25ray", lambda path: tm25(path, COLORED, has=("lumens", "wavelength"), identifier=2)),
    "TM-25, watts and lumens": ("a.tm25ray", lambda path: tm25(path, BARE, has=("watts", "lumens"))),
    "TM-25, all columns": ("a.tm25ray", lambda path: tm25(path, COLORED, has=tuple(WIDTHS), identifier=2, names=("phase", "field"),
                                                          text=b"of a lamp")),
    "TM-25, the flux stated": ("a.tm25ray", lambda path: tm25(path, BARE, total=float(BARE["flux"].astype("<f4").astype(float).sum()))),
    "Zemax, W": ("a.dat", lambda path: zemax(path, COLORED)),
    "Zemax, W, no wavelength": ("a.sdf", lambda path: zemax(path, BARE, layout=0)),
    "Zemax, W, one wavelength": ("a.sdf", lambda path: zemax(path, BARE, layout=0, single=0.6)),
    "Zemax, lm, one wavelength": ("a.dat", lambda path: zemax(path, BARE, layout=0, kind=1, single=0.51)),
    "Zemax, lm": ("a.dat", lambda path: zemax(path, BARE, layout=0, kind=1, version=8_675_309)),
    "Zemax, inches": ("a.dat", lambda path: zemax(path, COLORED, unit=1)),
}
#: Files of text do not say W or lm.
TEXTS: dict[str, Writer] = {
    "bare": lambda path: text(path, BARE),
    "wavelengths, in cm": lambda path: text(path, COLORED, unit=2, wavelength=True),
    "padded and blank lines": lambda path: text(path, BARE, head="\r\n400 3 0 0 0 0 0", end="\r\n\r\n"),
    "an old mark at its end": lambda path: with_byte(lambda made: text(made, BARE), b"\x1a")(path),
}


@pytest.mark.parametrize("name", FILES)
def test_numpy_traces_the_rays_that_the_program_traces(name: str, tmp_path: Path) -> None:
    file, write = FILES[name]
    lamp = source(write(tmp_path / file), LISTED, cs=cs(y=1.0, rx=0.2), scale=0.5, medium=glass(1.2, 1e-5))
    launched = assert_same_rays(with_source(lamp)).total_flux_in
    assert lamp.is_of_its_file and launched == pytest.approx(flux_by_hand(name), rel=1e-6)


def flux_by_hand(name: str) -> float:
    """Return the watts of a file of ``FILES``, from the rays that it was written of."""
    own = COLORED if name in ("TM-25, a wavelength of each ray", "TM-25, lumens of each wavelength", "TM-25, all columns", "Zemax, W",
                              "Zemax, inches") else BARE
    if "lm" not in name and ("lumens" not in name or "watts" in name):
        return float(own["flux"].sum())
    if own is BARE:
        return float(own["flux"].sum() / luminous_efficacy(Spectrum([0.5], [1.0]) if "one wavelength" in name else LISTED))
    watts = (own["flux"][own["wavelength"] < 0.55].sum() / luminous_efficacy(Spectrum([0.5], [1.0]))
             + own["flux"][own["wavelength"] > 0.55].sum() / luminous_efficacy(Spectrum([0.6], [1.0])))
    return float(watts)


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("flux", [{"total_flux": 2.0}, {"total_flux_lumens": 100.0}], ids=["W", "lm"])
def test_numpy_traces_the_rays_of_a_text(name: str, flux: dict[str, float], tmp_path: Path) -> None:
    path = TEXTS[name](tmp_path / "a.dat")
    assert_same_rays(with_source(source(path, LISTED, **flux)))
    with pytest.raises(nsq_gpu.UsageError, match="the file does not say whether its flux is in W or in lm; give total_flux or"):
        _ = source(path, LISTED).total_flux
    assert_refused_by_the_program(path)


#: Rays of one flux, which may be taken in order.
EVEN_BARE, EVEN = ({**rays, "flux": np.full(400, 0.25)} for rays in (BARE, COLORED))


@pytest.mark.parametrize(("file", "write", "is_bare"), [
    ("a.tm25ray", lambda path: tm25(path, EVEN_BARE), True),
    ("a.tm25ray", lambda path: tm25(path, EVEN, has=("watts", "wavelength"), identifier=2), False),
    ("a.dat", lambda path: zemax(path, EVEN), False),
    ("a.npz", lambda path: np.savez(path, **EVEN) or path, False),
], ids=["bare", "wavelengths", "Zemax", "columns"])
def test_rays_are_taken_in_their_order(file: str, write: Writer, is_bare: bool, tmp_path: Path) -> None:
    lamp = source(write(tmp_path / file), LISTED, order="in_order", scale=0.5)
    content = document(with_source(lamp))
    assert content["sources"][0]["order"] == "in_order"
    again: Any = scene_from_dict(content).sources[0]
    assert again.order == "in_order" and document(with_source(again)) == content
    born = lamp.generate(np.arange(1000), NSQRng(1))
    np.testing.assert_allclose(born.x, 0.5 * np.tile(EVEN["x"], 3)[:1000], rtol=1e-6)
    if not is_bare:
        assert np.abs(born.wavelength - np.tile(EVEN["wavelength"], 3)[:1000]).max() < 0.0121
    assert assert_same_rays(with_source(lamp)).total_flux_in == pytest.approx(100.0, rel=1e-6)


def test_rays_of_several_fluxes_have_no_order(tmp_path: Path) -> None:
    path = zemax(tmp_path / "a.dat", COLORED)
    lamp = source(path, LISTED, order="in_order")
    with pytest.raises(nsq_gpu.UsageError, match=r"a.dat: rays are taken in order, so all must have the same flux; ray \d+ of the file has"):
        lamp.generate(np.arange(5), NSQRng(1))
    assert_refused_by_the_program(path, order="in_order")
    # Lumens of several wavelengths are several fluxes.
    path = tm25(tmp_path / "a.tm25ray", EVEN, has=("lumens", "wavelength"), identifier=2)
    with pytest.raises(nsq_gpu.UsageError, match="rays are taken in order, so all must have the same flux"):
        source(path, LISTED, order="in_order").generate(np.arange(5), NSQRng(1))
    assert_refused_by_the_program(path, order="in_order")
    with pytest.raises(nsq_gpu.UsageError, match="order is 'turn'; give 'drawn' or 'in_order'"):
        source(path, LISTED, order="turn")


def test_lengths_have_the_unit_of_the_file(tmp_path: Path) -> None:
    sizes = []
    for unit in range(5):
        for write in (lambda path, unit=unit: zemax(path, COLORED, unit=unit), lambda path, unit=unit: text(path, COLORED, unit=unit)):
            rays = rayfiles.read(str(write(tmp_path / "a.dat")))
            sizes.append(rays.starts[:, 0] / COLORED["x"])
            assert np.allclose(rays.directions[:, 2], COLORED["N"], rtol=1e-6)
    assert np.allclose(np.array(sizes).T, np.repeat([1000.0, 25.4, 10.0, 304.8, 1.0], 2), rtol=1e-6)


def test_the_rays_that_the_program_writes_are_read(tmp_path: Path) -> None:
    """``trace --rays-out`` and the columns of the same ray database hold the same rays."""
    recorded(tmp_path, "--rays-out", str(tmp_path / "plane.tm25ray"))
    read, expected = (rayfiles.read(str(tmp_path / name)) for name in ("plane.tm25ray", "out/plane.npz"))
    assert len(read.flux) == len(expected.flux) > 100 and read.unit == expected.unit == "W" and read.stated is None
    for key in ("starts", "directions", "flux", "wavelength"):
        np.testing.assert_allclose(getattr(read, key), getattr(expected, key), rtol=1e-6, atol=1e-6)
    again = with_source(source(tmp_path / "plane.tm25ray", cs=cs(z=-8.0)))
    again.add_lens("L", cs(z=8.0), LensConfig(60.0, -60.0, 5.0, glass(), 15.0))
    assert assert_same_rays(again).total_flux_in == pytest.approx(expected.total, rel=1e-6)


# Refusals


def patched(layout: str, at: int, *values: Any) -> Writer:
    """Return what writes a good file, and then spoils it at a byte."""
    def write(path: Path) -> Path:
        if path.suffix == ".tm25ray":
            tm25(path, COLORED, has=("watts", "wavelength"), tables=([(450.0, 0.5), (460.0, 1.0)],))
        else:
            zemax(path, COLORED)
        made = bytearray(path.read_bytes())
        struct.pack_into(layout, made, at, *values)
        path.write_bytes(bytes(made))
        return path

    return write


def cut(write: Writer, bytes_more: int) -> Writer:
    """Return what writes a file that is too short, or too long by zeros."""
    def short(path: Path) -> Path:
        made = write(path).read_bytes()
        path.write_bytes(made[:bytes_more] if bytes_more < 0 else made + bytes(bytes_more))
        return path

    return short


def with_byte(write: Writer, more: bytes) -> Writer:
    """Return what writes a file, and then these bytes."""
    def longer(path: Path) -> Path:
        path.write_bytes(write(path).read_bytes() + more)
        return path

    return longer


def lines(content: str) -> Writer:
    def write(path: Path) -> Path:
        path.write_text(content, encoding="utf-8", newline="")
        return path

    return write


RAY = "0 0 0 0 0 1 1"
#: What writes a file that is refused, its ending, and what is said of it.
REFUSED: dict[str, tuple[str, Writer, str]] = {
    "no TM-25": (".tm25ray", patched("<4s", 0, b"TM26"), "it does not begin with TM25, but with the bytes 54 4d 32 36"),
    "a version": (".tm25ray", patched("<i", 4, 2020), "the version is 2020; version 2013 is read"),
    "no flag": (".tm25ray", patched("<i", 260, 0), "the flag of the direction is 0; flags are 0 or 1"),
    "a flag of 2": (".tm25ray", patched("<i", 276, 2), "the flag of the Stokes parameters is 2"),
    "no flux": (".tm25ray", patched("<i", 264, 0), "its rays have neither radiant nor luminous flux"),
    "a negative total": (".tm25ray", patched("<f", 16, -1.0), "the total flux is -1.0; it is 0 or more"),
    "one wavelength of none": (".tm25ray", patched("<if", 60, 1, math.nan), "the spectral identifier is 1, and a wavelength of nan nm"),
    "wavelengths of none": (".tm25ray", lambda path: tm25(path, BARE, identifier=2), "is 2, without a wavelength of each ray"),
    "a spectrum of none": (".tm25ray", lambda path: tm25(path, BARE, identifier=3), "is 3, with 0 spectral tables"),
    "several spectra": (".tm25ray", patched("<i", 60, 4), "is 4: rays choose among several spectra; export a wavelength for each"),
    "an identifier": (".tm25ray", patched("<i", 60, 5), "the spectral identifier is 5; 0 none, 1 one"),
    "tables below 0": (".tm25ray", patched("<i", 76, -1), "the number of spectral tables is -1"),
    "a table behind the end": (".tm25ray", patched("<i", 76, 100_000), "spectral table|the file ends before"),
    "a table without pairs": (".tm25ray", patched("<i", 36_288, 0), "spectral table 1 has 0 pairs"),
    "a table that is too long": (".tm25ray", patched("<i", 36_288, 60_000), "spectral table 1 ends at byte 516292"),
    "a spectrum that falls": (".tm25ray", patched("<f", 36_300, 440.0), "the spectrum has the pair 440 nm, 1; wavelengths rise"),
    "columns below 0": (".tm25ray", patched("<i", 80, -1), "the number of additional columns is -1"),
    "a text below 0": (".tm25ray", patched("<i", 84, -4), "0 additional columns and a text of -4 bytes"),
    "a text behind the end": (".tm25ray", patched("<i", 84, 1 << 30), "the file is cut off, or its header is wrong"),
    "rays that are not there": (".tm25ray", patched("<Q", 20, 401), "401 rays of 32 bytes end at byte .*: fetch or export it again"),
    "rays of another world": (".tm25ray", patched("<Q", 20, 1 << 63), "rays of 32 bytes end at byte"),
    "an end that is missing": (".tm25ray", cut(lambda path: tm25(path, BARE), -1), "400 rays of 28 bytes end at byte 47488, and the"),
    "more than the rays": (".tm25ray", cut(lambda path: tm25(path, BARE), 28), "a ray file ends with its last ray"),
    "no header": (".tm25ray", cut(lambda path: tm25(path, BARE), 288 - 47_488), "the file ends within its header of 36288 bytes"),
    "no rays": (".tm25ray", lambda path: tm25(path, columns(0)), "the file has no rays with light"),
    "a big-endian file": (".dat", patched(">i", 0, 1010), "it is a Zemax source file in big-endian order"),
    "an unknown start": (".sdf", patched("<i", 0, 7), "it is of no known format: it begins with the bytes 07 00 00 00"),
    "a unit": (".dat", patched("<i", 136, 5), "the unit of length is 5; 0 is for m, 1 for in"),
    "a unit below 0": (".dat", patched("<i", 136, -1), "the unit of length is -1; 0 is for m, 1 for in"),
    "a format": (".dat", patched("<i", 192, 1), "the format of rays is 1; 0 is for flux only"),
    "a kind of flux": (".dat", patched("<i", 196, 1), "the kind of flux is 1; 0 is for W, and 1 for lm"),
    "a short binary file": (".sdf", cut(lambda path: zemax(path, COLORED), -4), "400 rays of 32 bytes end at byte 13008"),
    "a NaN": (".dat", patched("<f", 208, math.nan), "the position of ray 0 is none; give finite numbers"),
    "a direction": (".dat", patched("<f", 208 + 32 + 20, 3.0), "the direction of ray 1 is none; give unit vectors"),
    "a flux below 0": (".dat", patched("<f", 208 + 64 + 24, -0.5), "the flux of ray 2 is none; give finite numbers of 0 or more"),
    "a wavelength of 0": (".dat", patched("<f", 208 + 96 + 28, 0.0), "the wavelength of ray 3 is none; give finite numbers above 0"),
    "no text": (".dat", lines(""), "the file is empty; the first line is the number of rays"),
    "a first line": (".dat", lines(f"{RAY}\n{RAY}\n"), "its first line is no header of a text source file"),
    "half a ray": (".dat", lines(f"1.5 4\n{RAY}\n"), "1.5 rays cannot be, in a file of"),
    "too many rays": (".dat", lines(f"1e9 4\n{RAY}\n"), "1e\\+09 rays cannot be, in a file of"),
    "rays without end": (".dat", lines(f"inf 4\n{RAY}\n"), "inf rays cannot be"),
    "a unit of a text": (".sdf", lines(f"1 7\n{RAY}\n"), "the unit of length is 7; 0 is for m"),
    "a ray too few": (".dat", lines(f"2 4\n{RAY}.00000000000000\n"), "the file ends after 1 of 2 rays"),
    "a ray too many": (".dat", lines(f"1 4\n{RAY}\n{RAY}\n"), "more lines follow the 1 rays of the first line"),
    "a word": (".dat", lines(f"2 4\n{RAY}\n0 0 0 0 0 up 1\n"), "ray 1 is '0 0 0 0 0 up 1', and not 7 numbers"),
    "an underscore": (".dat", lines("1 4\n0 0 0 0 0 1 1_0\n"), "ray 0 is '0 0 0 0 0 1 1_0', and not 7 numbers"),
    "one wavelength more": (".dat", lines(f"2 4\n{RAY}\n{RAY} 0.5\n"), "ray 1 is '0 0 0 0 0 1 1 0.5', and not 7 numbers"),
    "one wavelength less": (".dat", lines(f"2 4\n{RAY} 0.5\n{RAY}\n"), "ray 1 is '0 0 0 0 0 1 1', and not 8 numbers"),
    "digits of another script": (".dat", lines("6 4\n" + f"{RAY}\n" * 5 + "0 0 0 0 0 1 \u0661\n"), "ray 5 is .*, and not 7"),
    "letters of another code": (".dat", with_byte(lines("5 4\n" + f"{RAY}\n" * 5), b"\xff"), "it is no text"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_understood_is_refused_as_the_program_refuses_it(name: str, tmp_path: Path) -> None:
    ending, write, words = REFUSED[name]
    path = write(tmp_path / f"spoilt{ending}")
    with pytest.raises(nsq_gpu.UsageError, match=f"spoilt{ending}: .*({words})"):
        rayfiles.read(str(path))
    assert_refused_by_the_program(path, total_flux=1.0)


#: Few rays, and small files of them that are spoilt at random.
FEW = {name: column[:20] for name, column in COLORED.items()}
SPOILT: dict[str, Writer] = {
    "a.tm25ray": lambda path: tm25(path, FEW, has=("watts", "wavelength"), identifier=2, tables=([(450.0, 1.0), (460.0, 2.0)],),
                                   names=("phase",), text=b"of a lamp"),
    "b.tm25ray": lambda path: tm25(path, FEW, has=("lumens",), identifier=1, single=500.0),
    "c.dat": lambda path: zemax(path, FEW),
    "d.sdf": lambda path: zemax(path, FEW, layout=0, kind=1, single=0.5),
    "e.dat": lambda path: text(path, FEW, wavelength=True),
    "f.sdf": lambda path: text(path, FEW),
}


def spoil(content: bytes, draw: random.Random) -> bytes:
    """Return a file in which one to three places are changed, left out or put in, most of them in its header."""
    made = bytearray(content)
    regions = [(0, 120), (256, 288), (36_288, 36_330)] if content[:4] == b"TM25" else [(0, 208), (0, 20)]
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        low, high = draw.choice([*regions, (0, len(made))])
        at = draw.randrange(min(low, len(made) - 1), min(high, len(made)))
        how = draw.choice(["byte", "letter", "cut", "put", "number"])
        if how == "byte":
            made[at] = draw.randrange(256)
        elif how == "letter":
            made[at] = draw.choice(b"0123456789 .-+einfaN_\n\r\t\x1a")
        elif how == "cut":
            del made[at : at + draw.choice([1, 4, 28, 32])]
        elif how == "put":
            made[at:at] = draw.choice([bytes(4), b" ", b"\n", b"\r\n", b"\t", b"\x1a", b"0"])
        else:
            made[at // 4 * 4 : at // 4 * 4 + 4] = struct.pack("<i", draw.choice([0, 1, 2, 3, 4, -1, 1000, 2**31 - 1, -(2**31)]))
    return bytes(made)


@pytest.mark.parametrize("file", SPOILT)
def test_spoilt_files_are_refused_by_both_readers_or_by_none(file: str, tmp_path: Path) -> None:
    path, draw = tmp_path / file, random.Random(file)
    good = SPOILT[file](path).read_bytes()
    content = document(with_source(source(path, LISTED, total_flux=1.0)))
    accepted = 0
    with session() as one:
        for number in range(150):
            path.write_bytes(spoilt := spoil(good, draw))
            try:
                # The source refuses what the program refuses of it: wavelengths that the spectrum has not, and invisible lumens.
                source(path, LISTED, total_flux=1.0).generate(np.arange(1), NSQRng(1))
                mine = ""
            except nsq_gpu.UsageError as error:
                mine = str(error)
            try:
                one.request(content, {"num_rays": 10})
                theirs = ""
            except nsq_gpu.NsqGpuError as error:
                theirs = str(error)
            assert bool(mine) == bool(theirs), (number, mine, theirs, spoilt[:300])
            accepted += not mine
    assert 8 < accepted < 120


def test_spoilt_columns_are_refused_as_no_ray_file(tmp_path: Path) -> None:
    path, draw = tmp_path / "a.npz", random.Random(1)
    np.savez(path, **FEW)  # type: ignore[arg-type]
    good = path.read_bytes()
    refused = 0
    for _ in range(400):
        made = bytearray(good)
        made[draw.choice([draw.randrange(len(made)), draw.randrange(200), len(made) - draw.randrange(1, 600)])] = draw.randrange(256)
        path.write_bytes(bytes(made))
        try:
            rayfiles.read(str(path))
        except nsq_gpu.UsageError as error:
            assert str(error).startswith(str(path))
            refused += 1
    assert 100 < refused < 400


def test_a_header_that_states_another_flux_binds_where_the_scene_says_none(tmp_path: Path) -> None:
    path = tm25(tmp_path / "a.tm25ray", BARE, total=99.0)
    with pytest.raises(nsq_gpu.UsageError, match=r"a.tm25ray: it states 99 W, and the flux of its rays is .* W in all; correct the file"):
        with_source(source(path, LISTED)).trace(10, backend=NumpyBackend(seed=3))
    assert_refused_by_the_program(path)
    assert_same_rays(with_source(source(path, LISTED, total_flux=2.0)))


def test_lumens_of_light_that_nobody_sees_are_refused(tmp_path: Path) -> None:
    path = tm25(tmp_path / "a.tm25ray", columns(lines=[1.06]), has=("lumens", "wavelength"), identifier=2)
    lamp = source(path, Spectrum([0.5, 1.06], [1.0, 1.0]))
    with pytest.raises(nsq_gpu.UsageError, match=r"ray \d+ has a flux in lm, and nobody sees light of its wavelength; give a file whose"):
        lamp.generate(np.arange(5), NSQRng(1))
    assert_refused_by_the_program(path, spectrum={"wavelengths": [0.5, 1.06], "weights": [1.0, 1.0]})


def test_rays_too_many_to_hold_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rayfiles, "MOST_RAYS", 399)
    for file, write in [*FILES.values(), *(("a.dat", write) for write in TEXTS.values())]:
        with pytest.raises(nsq_gpu.UnsupportedSceneError, match="it has 400 rays, and for Optiland's backends at most 399 are read; trace"):
            rayfiles.read(str(write(tmp_path / file)))
    # The program takes them.
    np.savez(tmp_path / "a.npz", **COLORED)  # type: ignore[arg-type]
    lamp = source(tmp_path / "a.npz", LISTED)
    assert with_source(lamp).trace(100, backend=live.backend()).total_flux_in == pytest.approx(COLORED["flux"].sum())
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match=r"a.npz: it has 400 rays, and for Optiland's backends at most"):
        lamp.generate(np.arange(5), NSQRng(1))


def test_a_file_is_read_when_it_is_needed(tmp_path: Path) -> None:
    """A large file of a maker costs nothing here while the program alone traces it."""
    path = patched("<i", 4, 2020)(tmp_path / "a.tm25ray")
    lamp = source(path)
    with pytest.raises(nsq_gpu.UsageError, match="the version is 2020"):
        _ = lamp.total_flux
    tm25(path, BARE)
    assert lamp.total_flux == pytest.approx(BARE["flux"].sum(), rel=1e-6)
    path.unlink()
    with pytest.raises(nsq_gpu.UsageError, match="a.tm25ray: .*; give the path of a ray file"):
        _ = lamp.total_flux
