"""Small lens files, and what is right of each: a corpus with a file for each card of each format."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nsq_gpu.lensfiles import read_lens
from nsq_gpu.lensfiles.glasses import index_of


@dataclass
class Read:
    """What was read of a file."""

    optic: Any
    reading: Any

    @property
    def surfaces(self) -> list[Any]:
        return self.optic.surfaces.surfaces

    def sag(self, x: float, y: float, surface: int = 1) -> float:
        return number(self.surfaces[surface].geometry.sag(np.array([x]), np.array([y])))

    def radius(self, surface: int = 1) -> float:
        return number(self.surfaces[surface].geometry.radius)

    def place(self, surface: int) -> np.ndarray:
        return np.array([number(getattr(self.surfaces[surface].geometry.cs, key)) for key in "xyz"])

    def axes(self, surface: int) -> np.ndarray:
        return np.asarray(self.surfaces[surface].geometry.cs.get_effective_transform()[1], dtype=float)

    def index(self, surface: int = 1, wavelength: float = 0.5875618) -> float:
        return index_of(self.surfaces[surface].material_post, wavelength)

    def lets(self, x: float, y: float, surface: int = 1) -> bool:
        """Tell whether light passes the aperture there."""
        aperture = self.surfaces[surface].aperture
        return aperture is None or bool(np.all(aperture.contains(np.array([x]), np.array([y]))))

    def pupil(self) -> float:
        return number(self.optic.paraxial.EPD())


def number(value: Any) -> float:
    return float(np.squeeze(np.asarray(value)))


@dataclass
class Example:
    """A file for a card: what is right of it, or what its refusal or the report says."""

    card: str
    text: str
    right: Callable[[Read], Any] | None = None
    #: What the refusal says.
    refused: str | None = None
    #: What the report says.
    remarked: str | None = None
    #: The card says nothing of the light.
    passed_over: bool = False


def read(folder: Path, name: str, text: str | bytes, **options: Any) -> Read:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    return Read(*read_lens(path, **options))


def near(value: float, wanted: float, error: float = 1e-9) -> bool:
    return abs(value - wanted) <= error * max(1.0, abs(wanted))


def conic(r: float, radius: float, k: float = 0.0) -> float:
    """Return the sag of a conic."""
    return r * r / (radius * (1.0 + math.sqrt(1.0 - (1.0 + k) * r * r / radius**2)))


# Zemax

#: Lines before the surfaces, by the card's name.
ZEMAX_HEADER = {"MODE": "MODE SEQ", "UNIT": "UNIT MM X W X CM MR CPMM", "ENPD": "ENPD 10", "GCAT": "GCAT SCHOTT", "FTYP": "FTYP 0 0 2 1 0 0 0",
                "XFLN": "XFLN 0 0", "YFLN": "YFLN 0 5", "WAVM": "WAVM 1 0.5875618 1", "PWAV": "PWAV 1"}
GLASS = "GLAS N-BK7 0 0 1.5168 64.17 0"


def zmx(header: Sequence[str] = (), face: Sequence[str] = (), *, without: str = "", before: Sequence[Sequence[str]] = (),
        object_at: str = "INFINITY", stop: Sequence[str] = ("STOP",), image: Sequence[str] = (), trailer: Sequence[str] = ()) -> str:
    """Return a singlet of radii 50 and -50 mm, 5 mm thick; lines take the place of the lines of the same cards."""
    lines = {**ZEMAX_HEADER, **{line.split()[0]: line for line in header}}
    for name in without.split():
        lines.pop(name, None)
    first = {"CURV": "CURV 0.02 0 0 0 0 \"\"", "DISZ": "DISZ 5", "GLAS": GLASS, **{line.split()[0] + line.split()[1] if line.split()[0] in ("PARM", "XDAT") else
                                                                                  line.split()[0]: line for line in face}}
    surfaces = [["CURV 0", f"DISZ {object_at}"], *before, [*stop, *(value for value in first.values() if value.split()[-1] != "NONE" or value.startswith("COAT"))],
                ["CURV -0.02", "DISZ 45"], ["CURV 0", "DISZ 0", *image]]
    rows = list(lines.values())
    for index, own in enumerate(surfaces):
        rows += [f"SURF {index}", *(f"  {line}" for line in own)]
    return "\r\n".join([*rows, *trailer]) + "\r\n"


def typed(name: str, *more: str, conic: float = 0.0) -> str:
    return zmx(face=[f"TYPE {name}", f"CONI {conic}", *more])


def breaks(*parms: float, order: int = 0, thickness: float = 3.0) -> str:
    lines = ["TYPE COORDBRK", *(f"PARM {index} {value}" for index, value in enumerate((*parms, order), start=1)), f"DISZ {thickness}"]
    return zmx(before=[["CURV 0", "DISZ 10"], lines])


def turned(x: float = 0.0, y: float = 0.0, z: float = 0.0, *, reverse: bool = False) -> np.ndarray:
    """Return the axes of a frame that is turned about x, the new y and the new z (degrees), right-handed; the other way round if reversed."""
    a, b, c = np.radians((x, y, z))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x if reverse else about_x @ about_y @ about_z


_ORDER_0, _ORDER_1 = turned(20, 30, 40), turned(20, 30, 40, reverse=True)

ZEMAX = [
    # The whole lens
    Example("MODE", zmx(["MODE NSC"]), refused="sequential mode"),
    Example("MODE", zmx(), lambda r: near(r.radius(), 50.0) and near(r.place(2)[2], 5.0) and near(r.place(3)[2], 50.0)),
    Example("UNIT", zmx(["UNIT IN"]), lambda r: near(r.radius(), 1270.0) and near(r.place(3)[2], 1270.0) and near(r.pupil(), 254.0)),
    Example("UNIT", zmx(["UNIT CM"]), lambda r: near(r.radius(), 500.0)),
    Example("UNIT", zmx(["UNIT METER"]), remarked="multiplied by 1000"),
    Example("UNIT", zmx(["UNIT FURLONG"]), refused="write MM, CM, IN or METER"),
    Example("NAME", zmx(["NAME two words"]), lambda r: r.optic.name == "two words"),
    Example("ENPD", zmx(["ENPD 12"]), lambda r: near(r.pupil(), 12.0)),
    Example("FNUM", zmx(["FNUM 5 0"], without="ENPD"), lambda r: near(r.pupil(), number(r.optic.paraxial.f2()) / 5.0)),
    # The slope at the image is 1 / (2 F).
    Example("FNUM", zmx(["FNUM 5 1", "FTYP 1 0 2 1"], without="ENPD", object_at="200"), lambda r: near(abs(number(r.optic.paraxial.marginal_ray()[1][-1])), 0.1, 1e-6)),
    Example("OBNA", zmx(["OBNA 0.02 0", "FTYP 1 0 2 1"], without="ENPD", object_at="200"), lambda r: r.optic.aperture.ap_type == "objectNA" and r.optic.aperture.value == 0.02),
    Example("OBNA", zmx(["OBNA 3 1", "FTYP 1 0 2 1"], without="ENPD", object_at="200"), lambda r: near(r.optic.aperture.value, math.sin(math.radians(3.0)))),
    # The stop is the front, so the pupil is as large.
    Example("FLOA", zmx(["FLOA"], ["DIAM 4 0 0 0 1"], without="ENPD"), lambda r: near(r.pupil(), 8.0)),
    Example("FTYP", zmx(["FTYP 1 0 2 1"], object_at="200"), lambda r: type(r.optic.fields.field_definition).__name__ == "ObjectHeightField"),
    Example("FTYP", zmx(["FTYP 4 0 2 1"]), refused="theodolite"),
    Example("FTYP", zmx(["FTYP 1 1 2 1", "OBNA 0.02 0"], without="ENPD", object_at="200"), lambda r: r.optic.obj_space_telecentric),
    Example("FTYP", zmx(["FTYP 0 0 2 1 0 0 1"]), remarked="afocal"),
    Example("FTYP", zmx(["FTYP 0 0 1 1"]), lambda r: len(r.optic.fields.fields) == 1),
    Example("XFLN", zmx(["XFLN 1 2"]), lambda r: [f.x for f in r.optic.fields.fields] == [1.0, 2.0]),
    Example("YFLN", zmx(["YFLN 7 -3"]), lambda r: [f.y for f in r.optic.fields.fields] == [7.0, -3.0]),
    Example("XFLD", zmx(["XFLD 1 2", "FTYP 0"], without="XFLN"), lambda r: [f.x for f in r.optic.fields.fields] == [1.0, 2.0]),
    Example("YFLD", zmx(["YFLD 7 -3 0 0 0 0 0 0 0 0 0 0", "FTYP 0"], without="XFLN YFLN"), lambda r: [f.y for f in r.optic.fields.fields] == [7.0, -3.0]),
    Example("FWGN", zmx(["FWGN 0.5 0"]), lambda r: [f.weight for f in r.optic.fields.fields] == [0.5, 0.0]),
    Example("FWGN", zmx(["FWGN 1 -2"]), refused="below 0"),
    Example("FWGT", zmx(["FWGT 0.5 2"]), lambda r: [f.weight for f in r.optic.fields.fields] == [0.5, 2.0]),
    *(Example(name, zmx([f"{name} 0 0.25"]), lambda r, key=key: near(getattr(r.optic.fields.fields[1], key), 0.25))
      for name, key in {"VDXN": "decenter_x", "VDYN": "decenter_y", "VCXN": "vx", "VCYN": "vy", "ZVDX": "decenter_x", "ZVDY": "decenter_y",
                        "ZVCX": "vx", "ZVCY": "vy"}.items()),
    Example("VCYN", zmx(["VCYN 0 1"]), refused="closes the pupil"),
    Example("WAVM", zmx(["WAVM 1 0.65 2"]), lambda r: [(w.value, w.weight) for w in r.optic.wavelengths.wavelengths] == [(0.65, 2.0)]),
    Example("WAVM", zmx(["WAVM 1 -0.65 2"]), refused="from 0.05 to 100 um"),
    Example("WAVL", zmx(["WAVL 0.48 0.58 0.65", "FTYP 0", "PWAV 2"], without="WAVM"), lambda r: [w.value for w in r.optic.wavelengths.wavelengths] == [0.48, 0.58, 0.65]),
    Example("WWGT", zmx(["WAVL 0.48 0.58", "WWGT 1 3", "FTYP 0"], without="WAVM"), lambda r: [w.weight for w in r.optic.wavelengths.wavelengths] == [1.0, 3.0]),
    Example("PWAV", zmx(["WAVL 0.48 0.58", "FTYP 0", "PWAV 2"], without="WAVM"), lambda r: r.optic.primary_wavelength == 0.58),
    Example("PWAV", zmx(["PWAV 2"]), refused="none of the file's"),
    Example("RAIM", zmx(["RAIM 0 2 1 1 0 0 0 0 0"]), lambda r: r.optic.ray_tracer.ray_aiming_config["mode"] == "robust"),
    Example("RAIM", zmx(["RAIM 0 0 1 1 0 0 0 0 0"]), lambda r: r.optic.ray_tracer.ray_aiming_config["mode"] == "paraxial"),
    Example("RAIM", zmx(["RAIM 0 1 1 1 0 0 0 0 0"]), remarked="paraxial size of the stop"),
    Example("GCAT", zmx(["GCAT HOYA"], ["GLAS F2 0 0 1.5 40 0"]), remarked="the catalogues of the file (HOYA) do not have it"),
    Example("COFN", zmx(["COFN QF COATING.DAT"]), lambda r: r.surfaces[1].interaction_model.coating is None),
    *(Example(name, zmx([f"{name} 1 2 3"]), passed_over=True) for name in
      "VERS NOTE AUTH TITL LANG LUID DBDT STUD EERA IWDP PFIL PICB HYPR OMMA SDMA ROPD GLRS GSTD NSCD FCOM DMFS BLNK TCED".split()),
    Example("ENVD", zmx(["ENVD 2.0E+1 1 0"]), passed_over=True),
    Example("ENVD", zmx(["ENVD 50 1 1"]), remarked="temperature"),
    Example("POLS", zmx(["POLS 1 0 1 0 0 1 0"]), passed_over=True),
    Example("POLS", zmx(["POLS 0 1 0 0 0 1 0"]), remarked="polarisation"),
    Example("GFAC", zmx(["GFAC 1 1"]), remarked="apodisation"),
    Example("PUSH", zmx(["PUSH 0 0 1 0 0 0"]), remarked="aiming"),
    Example("VANN", zmx(["VANN 0 0"]), passed_over=True),
    Example("VANN", zmx(["VANN 0 10"]), refused="tangent angle"),
    Example("ZVAN", zmx(["ZVAN 0 10"]), refused="tangent angle"),
    *(Example(name, zmx([f"{name} 1 1"]), refused="known here") for name in ("PUPD", "CONF", "WAVN", "WWGN")),
    Example("XYZW", zmx(["XYZW 1 1"]), remarked="the card is unknown, and was left out"),
    Example("WAVM", zmx(["WAVM 1 587.6 1"]), refused="from 0.05 to 100 um"),
    Example("WAVM", zmx(["WAVM 1 4.0 1"]), remarked="the index of N-BK7 at 4 um is extrapolated"),
    Example("WAVM", zmx(["FTYP 0 0 2 3"]), remarked="only 1 are stated"),
    # A file without counts fills up its 24 slots.
    Example("WAVM", zmx(["FTYP 0 0", *(f"WAVM {slot} 0.55 1" for slot in ())]).replace("WAVM 1 0.5875618 1", "\r\n".join(
        ["WAVM 1 0.65 1", *(f"WAVM {slot} 0.55 1" for slot in range(2, 25))])), lambda r: [w.value for w in r.optic.wavelengths.wavelengths] == [0.65]),
    Example("FTYP", zmx(["FTYP 0 0 -2 1"]), refused="below 0"),
    Example("FTYP", zmx(["FTYP 0"], without="XFLN YFLN").replace("WAVM", "YFLD 7 5 0\r\nWAVM"), lambda r: [f.y for f in r.optic.fields.fields] == [7.0, 5.0, 0.0]),
    Example("VCYN", zmx(["VCYN 0.1"]), refused="ends after 1 of 2 fields"),
    Example("FWGN", zmx(["FWGN 2"]), refused="ends after 1 of 2 fields"),
    Example("WWGT", zmx(["WAVL 0.48 0.58 0.65", "WWGT 1", "FTYP 0"], without="WAVM"), refused="1 weights stand for 3 wavelengths"),
    Example("RAIM", zmx(["RAIM 0 2"]), lambda r: r.optic.ray_tracer.ray_aiming_config["mode"] == "robust"),
    Example("ENPD", zmx(trailer=["ENPD 20"]), refused="stands behind the last surface"),
    Example("CURV", zmx(trailer=["CURV -0.01"]), refused="stands behind the last surface"),
    Example("DISZ", zmx(object_at="0"), refused="the object's distance is 0"),
    Example("DISZ", zmx(object_at="-1e13"), refused="the object's distance is -inf"),
    Example("DISZ", zmx(face=["DISZ 5_0"]), refused="no finite number"),
    Example("GLAS", zmx(["FNUM 5 0"], without="ENPD").replace("SURF 0\r\n", "SURF 0\r\n  GLAS MIRROR\r\n"), refused="the object is a mirror"),
    Example("GLAS", zmx(face=["GLAS N-BK7?# 0 0 1.5 40"]), refused="no catalogue has the glass N-BK7?#"),
    Example("GLAS", zmx(face=["GLAS mirror", "DISZ -30", "COAT AR"]), remarked="the mirror reflects all light"),
    Example("GLAS", zmx(face=["GLAS ___blank 1 0 1.6 50 0"]), lambda r: near(r.index(), 1.6, 1e-6)),
    Example("TYPE", breaks().replace("TYPE COORDBRK", "TYPE COORDBRK\r\n  GLAS SF6 0 0 1.8 25"), refused="a coordinate break is no surface"),
    Example("TYPE", breaks(), remarked="In the file its surface 2 is 3"),
    Example("CLAP", zmx().replace("SURF 0\r\n", "SURF 0\r\n  CLAP 0 3 0\r\n"), remarked="the object's aperture"),
    Example("STOP", zmx(stop=[]).replace("SURF 0\r\n", "SURF 0\r\n  STOP\r\n"), refused="the object or the image is the stop"),
    Example("STOP", zmx(stop=[], image=["STOP"]), refused="the object or the image is the stop"),
    # Glass before a face, or behind one: both end at the diameter.
    Example("DIAM", zmx().replace("CURV -0.02", "CURV 0\r\n  DIAM 4 1 0 0 1"), lambda r: not r.lets(0.0, 4.1, 2)),
    Example("DIAM", zmx(before=[["CURV 0.001", "DISZ 5", "DIAM 4 1 0 0 1"]]), lambda r: r.lets(0.0, 4.1)),
    Example("SQAP", zmx(face=["SQAP 3 4 45"]), refused="a third number (45)"),
    Example("COMM", zmx(face=["COMM a\u2028CURV 0.5"]), lambda r: near(r.radius(), 50.0)),
    *(Example("XDAT", typed("XASPHERE", f"XDAT 1 {count}", "XDAT 2 10"), refused=said) for count, said in (("-3", "from 0 to 230"), ("1e9", "from 0 to 230"), ("1.9", "not a whole number"))),
    # Surfaces
    Example("CURV", zmx(face=["CURV -0.01"]), lambda r: near(r.radius(), -100.0)),
    Example("CURV", zmx(face=["CURV 0,025"]), lambda r: near(r.radius(), 40.0)),
    Example("CONI", zmx(face=["CONI -0.7"]), lambda r: near(r.sag(0.0, 4.0), conic(4.0, 50.0, -0.7))),
    Example("DISZ", zmx(face=["DISZ 7.5"]), lambda r: near(r.place(2)[2], 7.5)),
    Example("DISZ", zmx(face=["DISZ INFINITY"]), refused="infinite"),
    Example("STOP", zmx(), lambda r: r.surfaces[1].is_stop and not r.surfaces[2].is_stop),
    Example("COMM", zmx(face=["COMM the front"]), lambda r: r.surfaces[1].comment == "the front"),
    Example("DIAM", zmx(face=["DIAM 4 1 0 0 1"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1)),
    Example("DIAM", zmx(face=["DIAM 4 0 0 0 1"]), lambda r: r.lets(0.0, 9.0)),
    Example("CLAP", zmx(face=["CLAP 1 4 0"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1) and not r.lets(0.5, 0.5)),
    Example("CLAP", zmx(["UNIT CM"], ["CLAP 0 4 0"]), lambda r: r.lets(0.0, 39.0) and not r.lets(0.0, 41.0)),
    Example("FLAP", zmx(face=["FLAP 0 4 0"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1)),
    Example("OBSC", zmx(face=["OBSC 0 2 0"]), lambda r: not r.lets(0.0, 1.9) and r.lets(0.0, 2.1) and r.lets(0.0, 90.0)),
    Example("OBSC", zmx(face=["OBSC 2 0 0"]), refused="smaller one stands first"),
    Example("SQAP", zmx(face=["SQAP 3 2 0"]), lambda r: r.lets(2.9, 1.9) and not r.lets(3.1, 0.0) and not r.lets(0.0, 2.1)),
    Example("SQOB", zmx(face=["SQOB 3 2 0"]), lambda r: not r.lets(2.9, 1.9) and r.lets(3.1, 0.0) and r.lets(0.0, 2.1)),
    Example("ELAP", zmx(face=["ELAP 4 2 0"]), lambda r: r.lets(3.9, 0.0) and not r.lets(3.9, 1.0) and not r.lets(0.0, 2.1)),
    Example("ELOB", zmx(face=["ELOB 4 2 0"]), lambda r: not r.lets(3.9, 0.0) and r.lets(3.9, 1.0) and r.lets(0.0, 2.1)),
    Example("SPID", zmx(face=["SPID 0.5 3 0"]), lambda r: not r.lets(4.0, 0.2) and r.lets(-4.0, 0.0) and r.lets(4.0, 0.3)
            and not r.lets(4.0 * math.cos(2.0944), 4.0 * math.sin(2.0944))),
    Example("SPID", zmx(face=["SPID 1 3 0"]), refused="do not say which is the number"),
    Example("OBDC", zmx(face=["CLAP 0 2 0", "OBDC 1 3"]), lambda r: r.lets(1.0, 4.9) and not r.lets(1.0, 0.9)),
    Example("OBDC", zmx(face=["OBDC 1 3", "SQAP 1 1 0"]), lambda r: r.lets(1.9, 3.9) and not r.lets(0.0, 0.0)),
    Example("COAT", zmx(face=["COAT AR"]), remarked="the coating AR is not at hand"),
    Example("COAT", zmx(face=["COAT NONE"]), lambda r: r.surfaces[1].interaction_model.coating is None),
    Example("GLAS", zmx(), lambda r: near(r.index(), 1.5168, 1e-5)),
    Example("GLAS", zmx(["GCAT SCHOTT"], ["GLAS SF6 0 0 1.80518 25.43"]), lambda r: near(r.index(), 1.80518, 1e-5)),
    # The gas of that name has 1.0007.
    Example("GLAS", zmx(face=["GLAS SF6 0 0 1.80518 25.43"], without="GCAT"), lambda r: near(r.index(), 1.80518, 1e-5)),
    Example("GLAS", zmx(face=["GLAS ___BLANK 1 0 1.6 50 0"]), lambda r: near(r.index(), 1.6, 1e-6)),
    Example("GLAS", zmx(face=["GLAS ___BLANK 1 0 1.6 0 0"]), lambda r: r.index(1, 0.4) == r.index(1, 0.9) == 1.6),
    Example("GLAS", zmx(face=["GLAS ___BLANK 1 0 1.6 20000 0"]), lambda r: r.index(1, 0.4) == r.index(1, 0.9) == 1.6 and "Buchdahl" not in str(r.reading.remarks)),
    Example("GLAS", zmx(face=["GLAS ___BLANK 1 0 1.6 50 0.1"]), remarked="dPgF"),
    Example("GLAS", zmx(face=["GLAS LUMICERAZ 0 0 1.5 40"]), refused="no catalogue has the glass LUMICERAZ; nearest names"),
    Example("GLAS", zmx(face=["GLAS N-BK7 0 0 1.7 64.17"]), refused="states nd = 1.7"),
    Example("GLAS", zmx(face=["GLAS N-BK7 0 0 1.5168 30"]), refused="Vd = 30"),
    Example("GLAS", zmx(face=["GLAS N-BK7 0 0 1.5172 64.17"]), remarked="where the file states 1.5172"),
    Example("GLAS", zmx(face=["GLAS N-BK7 4 0 1.5 40 0 0 0 0 0.01 0"]), refused="offset"),
    Example("GLAS", zmx(face=["GLAS BK7 1.5168 64.17"]), lambda r: near(r.index(), 1.5168, 1e-5)),
    Example("GLAS", zmx(face=["GLAS BK7 0 0 1.5 40"]), remarked="took its place"),
    Example("GLAS", zmx(face=["GLAS CAF2 0 0 1.43385 94.996"]), lambda r: near(r.index(), 1.43385, 1e-5)),
    Example("GLAS", zmx(face=["GLAS 517642 0 0 1.5 40"]), lambda r: near(r.index(), 1.517, 1e-6)),
    Example("GLAS", zmx(face=["GLAS MIRROR", "DISZ -30"]), lambda r: r.surfaces[1].interaction_model.is_reflective),
    *(Example(name, zmx(face=[f"{name} 1 2 3"]), passed_over=True) for name in
      "FIMP SSID LUID HIDE MIRR SLAB POPS MEMA OEMA PPAR PZUP CRVP MAZH MAZA CHHT CHAN TCOM TOLE EDGE VCON VPAR VDSZ PKUP TCMM".split()),
    *(Example(name, zmx(face=[f"{name} 0 1"]), refused="file of the user") for name in ("UDAP", "UDAD", "UDAO", "USAP")),
    Example("SCBD", zmx(face=["SCBD 1 0 0 0 0 0 0 0"]), passed_over=True),
    Example("SCBD", zmx(face=["SCBD 1 0 0 0 0 90 0 0"]), refused="coordinate breaks"),
    Example("GDAT", zmx(face=["GDAT 3 3 1 1"]), refused="grid"),
    Example("GARR", zmx(face=["GARR 1 0 0 0 0"]), refused="grid"),
    Example("SCAT", zmx(face=["SCAT 1"]), refused="BSDF"),
    Example("NSCO", zmx(face=["NSCO 1"]), refused="non-sequential"),
    Example("XYZW", zmx(face=["XYZW 1"]), refused="the card is unknown, and may change the light"),
    Example("DIAN", zmx(face=["DIAN 1"]), refused="did you mean DIAM"),
    # VCON is as near, and says nothing of the light.
    Example("CONY", zmx(face=["CONY -1"]), refused="did you mean CONI"),
    # Shapes
    Example("TYPE", typed("STANDARD", conic=-1.2), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0, -1.2))),
    Example("PARM", typed("EVENASPH", "PARM 1 1e-4", "PARM 2 -2e-6", "PARM 8 1e-17", conic=-0.5),
            lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0, -0.5) + 1e-4 * 5**2 - 2e-6 * 5**4 + 1e-17 * 5**16)),
    Example("PARM", zmx(["UNIT CM"], ["TYPE EVENASPH", "PARM 2 -2e-4"]), lambda r: near(r.sag(0.0, 50.0), 10.0 * (conic(5.0, 50.0) - 2e-4 * 5**4))),
    Example("PARM", typed("ODDASPHE", "PARM 1 1e-3", "PARM 3 -2e-5"), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0) + 5e-3 - 2e-5 * 5**3)),
    Example("PARM", typed("EVENASPH", "PARM 9 1"), refused="parameter 9 of EVENASPH"),
    Example("PARM", typed("STANDARD", "PARM 1 1"), refused="parameter 1 of STANDARD"),
    Example("XDAT", typed("XASPHERE", "XDAT 1 2", "XDAT 2 10", "XDAT 3 0.01", "XDAT 4 -0.02"),
            lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0) + 0.01 * 0.5**2 - 0.02 * 0.5**4)),
    Example("XDAT", typed("XOSPHERE", "XDAT 1 3", "XDAT 2 10", "XDAT 3 0.01", "XDAT 5 -0.02"),
            lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0) + 0.01 * 0.5 - 0.02 * 0.5**3)),
    # Terms x, y, x^2, x y, y^2: the twelfth is x^2 y^2.
    Example("XDAT", typed("XPOLYNOM", "XDAT 1 12", "XDAT 2 10", "XDAT 3 0.01", "XDAT 7 -0.02", "XDAT 14 0.3"),
            lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0) + 0.01 * 0.3 - 0.02 * 0.4**2 + 0.3 * 0.3**2 * 0.4**2)),
    Example("XDAT", typed("XPOLYNOM", "XDAT 1 2", "XDAT 2 0", "XDAT 3 0.01"), refused="normalisation radius"),
    # The profile along y is turned about an axis parallel to y.
    Example("TYPE", typed("TOROIDAL", "PARM 1 80", "PARM 2 1e-4", conic=-0.5),
            lambda r: near(r.sag(0.0, 4.0), conic(4.0, 50.0, -0.5) + 1e-4 * 16) and near(r.sag(4.0, 0.0), conic(4.0, 80.0))),
    Example("TYPE", typed("TOROIDAL"), lambda r: near(r.sag(0.0, 4.0), conic(4.0, 50.0)) and r.sag(4.0, 0.0) == 0.0),
    Example("XDAT", typed("TOROIDAL", "XDAT 1 3"), refused="Zernike"),
    Example("TYPE", zmx(face=["TYPE BICONICX", "CURV 0", "PARM 1 30", "PARM 2 -0.5"]), lambda r: near(r.sag(4.0, 2.0), conic(4.0, 30.0, -0.5))),
    Example("TYPE", typed("BICONICX", "PARM 1 30"), refused="another form in Optiland"),
    Example("TYPE", typed("DGRATING", "PARM 1 0.2"), refused="grating"),
    Example("TYPE", typed("PARAXIAL", "PARM 1 50"), refused="perfect"),
    Example("TYPE", typed("SZERNSAG"), refused="the surface type SZERNSAG cannot be carried"),
    # Frames
    Example("TYPE", breaks(1.0, 2.0, 20.0, 30.0, 40.0), lambda r: np.allclose(r.axes(2), _ORDER_0, atol=1e-12)
            and np.allclose(r.place(2), np.array([1.0, 2.0, 10.0]) + 3.0 * _ORDER_0[:, 2], atol=1e-12)),
    Example("TYPE", breaks(1.0, 2.0, 20.0, 30.0, 40.0, order=1), lambda r: np.allclose(r.axes(2), _ORDER_1, atol=1e-12)
            and np.allclose(r.place(2), [0.0, 0.0, 10.0] + _ORDER_1 @ [1.0, 2.0, 3.0], atol=1e-12)),
    Example("SURF", zmx().replace("SURF 2", "SURF 3"), refused="surface 3 follows surface 1"),
    Example("SURF", zmx(trailer=["MNUM 2 1", "TOL TOFF 0 0"]), remarked="2 configurations"),
]

# CODE V

CODEV_HEAD = {"RDM": "RDM;LEN", "TIT": "TITLE 'a; lens! of two'", "EPD": "EPD 10.0", "DIM": "DIM M", "WL": "WL 587.5618", "REF": "REF 1", "XAN": "XAN 0.0 0.0",
              "YAN": "YAN 0.0 5.0"}


def seq(header: Sequence[str] = (), face: Sequence[str] = (), *, without: str = "", first: str = "S 50.0 5.0 NBK7_SCHOTT", second: Sequence[str] = ("S -50.0 45.0",),
        before: Sequence[str] = (), object_at: str = "0.1e14", image: Sequence[str] = ("SI 0.0 0.0",), stop: str = " STO", end: Sequence[str] = ()) -> str:
    """Return a singlet of radii 50 and -50 mm, 5 mm thick; lines take the place of the lines of the same commands."""
    lines = {**CODEV_HEAD, **{line.split()[0].split(";")[0][:3]: line for line in header}}
    for name in without.split():
        lines.pop(name, None)
    return "\n".join([*lines.values(), f"SO 0.0 {object_at}", *before, first, stop, *(f"  {line}" for line in face), *second, *image, *end, "GO"]) + "\n"


def _series(r: float) -> float:
    return sum(value * r**power for value, power in zip((1e-5, -2e-7, 3e-9, -4e-11, 5e-13, -6e-15, 7e-17, -8e-19, 9e-21), range(4, 22, 2), strict=True))


_LETTERS = "A 1e-5; B -2e-7; C 3e-9; D -4e-11; E 5e-13; F -6e-15; G 7e-17; H -8e-19; J 9e-21"
_TILT = turned(-20.0, -30.0, 40.0)
_MIRROR = ("S 0.0 -20.0 REFL",)


def tilt(*lines: str) -> str:
    return seq(before=["S 0.0 10.0", "S 0.0 7.0", *lines])


CODEV = [
    Example("RDM", seq(["RDM N;LEN"], first="S 0.02 5.0 NBK7_SCHOTT", second=["S -0.02 45.0"]), lambda r: near(r.radius(), 50.0) and near(r.radius(2), -50.0)),
    Example("RDM", seq(without="RDM"), remarked="taken for a radius"),
    Example("RDM", seq(without="RDM", first="S 0.02 5.0 NBK7_SCHOTT", second=["S -0.02 45.0"]), lambda r: near(r.radius(), 50.0)),
    Example("RDM", seq(["FNO 5"], without="RDM EPD", first="S 0.9 1.0 NBK7_SCHOTT", second=["S -1.1 1.0"]), refused="RDM is not stated"),
    Example("DIM", seq(["DIM I"]), lambda r: near(r.radius(), 1270.0) and near(r.place(3)[2], 1270.0) and near(r.pupil(), 254.0)),
    Example("DIM", seq(["DIM C"]), remarked="multiplied by 10"),
    Example("DIM", seq(["DIM X"]), refused="write M, C or I"),
    Example("TIT", seq(), lambda r: r.optic.name == "a; lens! of two"),
    Example("EPD", seq(["EPD 12"]), lambda r: near(r.pupil(), 12.0)),
    Example("FNO", seq(["FNO 5"], without="EPD"), lambda r: near(r.pupil(), number(r.optic.paraxial.f2()) / 5.0)),
    # 1 / (2 NA), and NA at the object by the magnification.
    Example("FNO", seq(["FNO 5", "XOB 0 0", "YOB 0 1"], without="EPD XAN YAN", object_at="200"),
            lambda r: near(r.optic.aperture.value, 0.1 * abs(number(r.optic.paraxial.magnification())))),
    Example("NA", seq(["NA 0.1"], without="EPD"), lambda r: near(r.pupil(), 0.2 * number(r.optic.paraxial.f2()))),
    Example("NAO", seq(["NAO 0.02", "XOB 0 0", "YOB 0 1"], without="EPD XAN YAN", object_at="200"), lambda r: near(r.optic.aperture.value, 0.02)),
    Example("WL", seq(["WL 656.3 587.6 486.1", "REF 2"]), lambda r: np.allclose([w.value for w in r.optic.wavelengths.wavelengths], [0.6563, 0.5876, 0.4861])),
    Example("WTW", seq(["WL 656.3 587.6", "WTW 1 3"]), lambda r: [w.weight for w in r.optic.wavelengths.wavelengths] == [1.0, 3.0]),
    Example("WTW", seq(["WTW 1 3"]), refused="2 weights stand for 1 wavelengths"),
    Example("REF", seq(["WL 656.3 587.6", "REF 2"]), lambda r: r.optic.primary_wavelength == 0.5876),
    Example("REF", seq(["WL 656.3 587.6 486.1"], without="REF"), remarked="587.6 nm is taken"),
    Example("XAN", seq(["XAN 1.0 2.0"]), lambda r: [f.x for f in r.optic.fields.fields] == [1.0, 2.0]),
    Example("YAN", seq(["YAN 7.0 -3.0"]), lambda r: [f.y for f in r.optic.fields.fields] == [7.0, -3.0]),
    *(Example(name, seq([f"{name} 1.0 2.0"], without="XAN YAN", object_at="200"),
              lambda r, axis=name[0].lower(), kind=kind: [getattr(f, axis) for f in r.optic.fields.fields] == [1.0, 2.0]
              and type(r.optic.fields.field_definition).__name__ == kind)
      for name, kind in {"XOB": "ObjectHeightField", "YOB": "ObjectHeightField", "XIM": "ParaxialImageHeightField", "YIM": "ParaxialImageHeightField",
                         "XRI": "RealImageHeightField", "YRI": "RealImageHeightField"}.items()),
    Example("YOB", seq(["YOB 0 1"]), refused="one kind is needed"),
    Example("WTF", seq(["WTF 0.5 2"]), lambda r: [f.weight for f in r.optic.fields.fields] == [0.5, 2.0]),
    # The pupil reaches from -(1 - VL) to 1 - VU.
    *(Example(name, seq([f"{name} 0 0.4"]), lambda r, axis=axis, sign=sign: near(getattr(r.optic.fields.fields[1], f"v{axis}"), 0.2)
              and near(getattr(r.optic.fields.fields[1], f"decenter_{axis}"), sign * 0.2))
      for name, axis, sign in (("VUX", "x", -1), ("VLX", "x", 1), ("VUY", "y", -1), ("VLY", "y", 1))),
    Example("VUY", seq(["VUY 0 1.0", "VLY 0 1.0"]), refused="the pupil of field 2 is closed"),
    Example("TEL", seq(["TEL Y", "NAO 0.02", "YOB 0 1"], without="EPD XAN YAN", object_at="200"), lambda r: r.optic.obj_space_telecentric),
    Example("TEL", seq(["TEL N"]), lambda r: not r.optic.obj_space_telecentric),
    Example("CA", seq(["CA NO"], ["CIR 3"]), remarked="CA NO"),
    Example("CA", seq(["CA"], ["CIR 3"]), lambda r: not r.lets(0.0, 4.0)),
    # Glasses
    Example("S", seq(), lambda r: near(r.index(), 1.5168, 1e-5) and near(r.radius(), 50.0) and near(r.place(2)[2], 5.0)),
    Example("S", seq(first="S 50.0 5.0 1.5168:64.17"), lambda r: near(r.index(), 1.5168, 1e-6)),
    Example("S", seq(first="S 50.0 5.0 517000.520000"), lambda r: near(r.index(), 1.517, 1e-6)),
    Example("S", seq(first="S 50.0 5.0 500.700"), lambda r: near(r.index(), 1.5, 1e-6)),
    Example("S", seq(first="S 50.0 5.0 517642"), lambda r: near(r.index(), 1.517, 1e-6)),
    Example("S", seq(first="S 50.0 5.0 'LUMICERAZ'"), refused="no catalogue has the glass LUMICERAZ"),
    Example("S", seq(first="S 50,0 5,5 NBK7_SCHOTT"), lambda r: near(r.place(2)[2], 5.5)),
    Example("S", seq(first="S 50.0 5.0 NBK7_SCHOTT REFL", second=["S -50.0 -45.0"]), lambda r: r.surfaces[1].interaction_model.is_reflective),
    Example("S1", seq(first="S1 50.0 5.0 NBK7_SCHOTT", second=["S2 -50.0 45.0"]), lambda r: near(r.radius(2), -50.0)),
    Example("S1", seq(first="S1 50.0 5.0 NBK7_SCHOTT", second=["S3 -50.0 45.0"]), refused="surface 3 follows surface 1"),
    Example("SO", seq(object_at="200", header=["YOB 0 1"], without="XAN YAN"), lambda r: near(r.place(0)[2], -200.0)),
    Example("SI", seq(image=["SI 0.0 0.5"]), lambda r: near(r.place(3)[2], 50.5)),
    Example("SI", seq(image=[]), refused="is no image; write SI"),
    Example("PRV", seq(["PRV\n PWL 700.0 587.5618 400.0\n 'MINE' 1.61 1.62 1.65\nEND"], first="S 50.0 5.0 'MINE'"), lambda r: near(r.index(), 1.62, 1e-9)),
    Example("PWL", seq(["PRV\n PWL 700.0 587.5618\n 'MINE' 1.61\nEND"], first="S 50.0 5.0 'MINE'"), refused="1 indices for 2 wavelengths"),
    Example("PRV", seq(["PRV\n PWL 700.0\n 'MINE' LAU 2.25 0 0\nEND"], first="S 50.0 5.0 'MINE'"), refused="given by a formula"),
    Example("GLA", seq(end=["GLA S1 SF6_SCHOTT"]), lambda r: near(r.index(), 1.80518, 1e-5)),
    Example("RMD", seq(face=["RMD REFL"], second=["S -50.0 -45.0"]), lambda r: r.surfaces[1].interaction_model.is_reflective),
    # Shapes
    Example("STO", seq(stop="", second=["S -50.0 45.0", " STO"]), lambda r: r.surfaces[2].is_stop and not r.surfaces[1].is_stop),
    Example("STO", seq(stop="", before=["S 0 5; S 0 5; STO"]), lambda r: r.surfaces[2].is_stop and not r.surfaces[1].is_stop),
    Example("STO", seq(stop="", end=["STO S2"]), lambda r: r.surfaces[2].is_stop),
    Example("STO", seq(stop=""), remarked="surface 1 is taken"),
    Example("SLB", seq(face=["SLB \"front\""]), lambda r: r.surfaces[1].comment == "front"),
    Example("SPH", seq(face=["SPH"]), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0))),
    Example("CON", seq(face=["CON", "K -0.7"]), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0, -0.7))),
    Example("K", seq(face=["K -0.7"]), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0, -0.7))),
    Example("ASP", seq(face=["ASP", "K -0.5", _LETTERS]), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0, -0.5) + _series(5.0), 1e-12)),
    Example("ASP", seq(["DIM C"], ["ASP", _LETTERS]), lambda r: near(r.sag(30.0, 40.0), 10.0 * (conic(5.0, 50.0) + _series(5.0)), 1e-12)),
    *(Example(name, seq(face=["ASP", f"{name} 1e-{power}"]), lambda r, power=power: near(r.sag(3.0, 4.0), conic(5.0, 50.0) + 0.5**power, 1e-12))
      for name, power in zip("ABCDEFGHJ", range(4, 22, 2), strict=True)),
    Example("RDY", seq(end=["RDY S1 80.0"]), lambda r: near(r.radius(), 80.0)),
    Example("CUY", seq(end=["CUY S1 0.01"]), lambda r: near(r.radius(), 100.0)),
    Example("THI", seq(end=["THI S1 8.0"]), lambda r: near(r.place(2)[2], 8.0)),
    Example("THI", seq(end=["THI S2 HMY 0.0"]), lambda r: near(r.place(3)[2], 50.0)),
    Example("THI", seq(end=["THI S7 8.0"]), refused="there is no surface S7"),
    Example("THI", seq(end=["THI S1..2 8.0"]), refused="range of surfaces"),
    Example("CYL", seq(face=["CYL"]), lambda r: near(r.sag(0.0, 4.0), conic(4.0, 50.0)) and r.sag(4.0, 0.0) == 0.0),
    Example("CYL", seq(first="S 0.0 5.0 NBK7_SCHOTT", face=["CYL", "RDX 30.0"]), lambda r: near(r.sag(0.0, 4.0), conic(4.0, 30.0)) and near(abs(r.axes(1)[0, 1]), 1.0)),
    Example("CYL", seq(face=["CYL", "RDX 30.0"]), refused="curved in both directions"),
    Example("YTO", seq(face=["YTO", "RDX 80.0", "K -0.5", "A 1e-5"]),
            lambda r: near(r.sag(0.0, 4.0), conic(4.0, 50.0, -0.5) + 1e-5 * 4**4) and near(r.sag(4.0, 0.0), conic(4.0, 80.0))),
    Example("YTO", seq(face=["YTO"]), refused="without a radius along x"),
    Example("XTO", seq(face=["XTO", "RDX 80.0", "A 1e-5"]),
            lambda r: near(r.sag(0.0, 4.0), conic(4.0, 80.0) + 1e-5 * 4**4) and near(r.sag(4.0, 0.0), conic(4.0, 50.0)) and near(abs(r.axes(1)[0, 1]), 1.0)),
    Example("RDX", seq(face=["RDX 80.0"]), refused="needs CYL, XTO or YTO"),
    Example("CUX", seq(face=["YTO", "CUX 0.0125"]), lambda r: near(r.sag(4.0, 0.0), conic(4.0, 80.0))),
    # Tilts: ADE and BDE are left-handed.
    *(Example(name, tilt(f"{name} 2.5"), lambda r, axis=axis: near(r.place(2)[axis], (0.0, 0.0, 10.0)[axis] + 2.5))
      for axis, name in enumerate(("XDE", "YDE", "ZDE"))),
    Example("ZDE", tilt("ZDE 2.5"), lambda r: near(r.place(3)[2], 19.5)),
    Example("ZDE", tilt("ZDE 2.5", "DAR"), lambda r: near(r.place(3)[2], 17.0)),
    Example("ADE", tilt("ADE 20"), lambda r: np.allclose(r.axes(2), turned(x=-20.0), atol=1e-12)),
    Example("BDE", tilt("BDE 20"), lambda r: np.allclose(r.axes(2), turned(y=-20.0), atol=1e-12)),
    Example("CDE", tilt("CDE 20"), lambda r: np.allclose(r.axes(2), turned(z=20.0), atol=1e-12)),
    Example("ADE", tilt("XDE 1; YDE 2", "CDE 40; BDE 30; ADE 20"), lambda r: np.allclose(r.axes(2), _TILT, atol=1e-12) and np.allclose(r.place(2), [1.0, 2.0, 10.0])
            and np.allclose(r.place(3), [1.0, 2.0, 10.0] + 7.0 * _TILT[:, 2], atol=1e-12) and np.allclose(r.axes(3), _TILT, atol=1e-12)),
    Example("DAR", tilt("YDE 2; ADE 20", "DAR"), lambda r: np.allclose(r.axes(2), turned(x=-20.0)) and np.allclose(r.place(2), [0.0, 2.0, 10.0])
            and np.allclose(r.axes(3), np.eye(3), atol=1e-12) and np.allclose(r.place(3), [0.0, 0.0, 17.0], atol=1e-12)),
    Example("REV", tilt("YDE 2; ADE 20", "REV"), lambda r: np.allclose(r.axes(2), np.eye(3)) and np.allclose(r.axes(3), turned(x=20.0), atol=1e-12)
            and np.allclose(r.place(3), [0.0, 0.0, 10.0] + turned(x=20.0) @ [0.0, -2.0, 7.0], atol=1e-12)),
    # A mirror at 45 degrees turns the axis by 90: what follows lies at 20 mm along it.
    Example("BEN", seq(before=["S 0.0 10.0", "S 0.0 -20.0 REFL", "ADE 45; BEN"], first="S 50.0 -5.0 NBK7_SCHOTT", second=["S -50.0 -45.0"]),
            lambda r: np.allclose(np.abs(r.place(3)), [0.0, 20.0, 10.0], atol=1e-12) and np.allclose(np.abs(r.place(4)), [0.0, 25.0, 10.0], atol=1e-12)),
    Example("BEN", tilt("ADE 45; BEN"), refused="is not a mirror"),
    Example("BEN", seq(before=["S 0.0 -20.0 REFL", "ADE 45; BDE 10; BEN"]), refused="two axes"),
    # Apertures
    Example("CIR", seq(face=["CIR 4"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1)),
    Example("CIR", seq(face=["CIR CLR 4"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1)),
    Example("CIR", seq(face=["CIR EDG 4"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1)),
    Example("CIR", seq(face=["CIR EDG 6", "CIR 4"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1)),
    Example("CIR", seq(face=["CIR OBS L'A' 2"]), lambda r: not r.lets(0.0, 1.9) and r.lets(0.0, 2.1) and r.lets(0.0, 90.0)),
    Example("CIR", seq(face=["CIR 4", "CIR OBS 2"]), lambda r: not r.lets(0.0, 1.9) and r.lets(0.0, 2.1) and not r.lets(0.0, 4.1)),
    Example("CIR", seq(["DIM C"], ["CIR 4"]), lambda r: r.lets(0.0, 39.0) and not r.lets(0.0, 41.0)),
    Example("CIR", seq(face=["CIR HOL 2"]), refused="a hole through glass"),
    Example("CIR", seq(first="S -100.0 -45.0 REFL", second=[], face=["CIR 8", "CIR HOL 2"]), lambda r: not r.lets(0.0, 1.9) and r.lets(0.0, 2.1)),
    Example("REX", seq(first="S -100.0 -45.0 REFL", second=[], face=["REX HOL 2", "REY HOL 1"]), refused="no disk about the axis"),
    Example("CIR", seq(face=["CIR L'A' 2", "CIR L'B' 3"]), refused="several clear apertures"),
    Example("CIR", seq(face=["CIR 0"]), refused="write a size above 0"),
    Example("REX", seq(face=["REX 3", "REY 2"]), lambda r: r.lets(2.9, 1.9) and not r.lets(3.1, 0.0) and not r.lets(0.0, 2.1)),
    Example("REY", seq(face=["REY 2"]), lambda r: r.lets(90.0, 1.9) and not r.lets(0.0, 2.1)),
    Example("ELX", seq(face=["ELX 4", "ELY 2"]), lambda r: r.lets(3.9, 0.0) and not r.lets(3.9, 1.0)),
    Example("ELY", seq(face=["ELX OBS 4", "ELY OBS 2"]), lambda r: not r.lets(3.9, 0.0) and r.lets(3.9, 1.0)),
    Example("ADX", seq(face=["CIR 2", "ADX 1"]), lambda r: r.lets(2.9, 0.0) and not r.lets(-1.1, 0.0)),
    Example("ADY", seq(face=["REX 1", "REY 2", "ADY 3"]), lambda r: r.lets(0.0, 4.9) and not r.lets(0.0, 0.9)),
    Example("ARO", seq(face=["REX 1", "REY 2", "ARO 30"]), refused="the sense in which an aperture is turned"),
    Example("ARO", seq(face=["CIR 4", "ARO 30"]), lambda r: r.lets(0.0, 3.9)),
    Example("CIG", seq(face=["CIG 2 1 0 0"]), lambda r: r.lets(2.9, 0.0) and not r.lets(-1.1, 0.0)),
    Example("REG", seq(face=["REG 1 2 0 3 0"]), lambda r: r.lets(0.0, 4.9) and not r.lets(0.0, 0.9)),
    Example("ELG", seq(face=["ELG 4 2 0 0 0"]), lambda r: r.lets(3.9, 0.0) and not r.lets(3.9, 1.0)),
    # The last command counts.
    Example("RDY", seq(face=["CUY 0.01", "RDY 80"]), lambda r: near(r.radius(), 80.0)),
    Example("CUX", seq(face=["YTO", "RDX 30", "CUX 0.0125"]), lambda r: near(r.sag(4.0, 0.0), conic(4.0, 80.0))),
    Example("SPH", seq(face=["CYL", "SPH"]), lambda r: near(r.sag(4.0, 0.0), conic(4.0, 50.0))),
    Example("SPH", seq(face=["CON", "K -5", "SPH"]), refused="which SPH has not"),
    Example("YTO", seq(face=["XTO", "RDX 30", "YTO", "RDX 80"]), lambda r: near(r.sag(4.0, 0.0), conic(4.0, 80.0)) and near(r.sag(0.0, 4.0), conic(4.0, 50.0))),
    Example("RDY", seq(face=["RDY INF"]), lambda r: r.sag(3.0, 4.0) == 0.0),
    Example("THI", seq(object_at="100", end=["THI SO INF"]), lambda r: r.optic.object_surface.is_infinite),
    Example("THI", seq(end=["THI S2 HMY 0.0"]), remarked="the number is solved for"),
    Example("CUY", seq(end=["CUY S2 UMY -0.2"]), remarked="the number is solved for"),
    Example("THI", seq(end=["THI S2 XYZ 0.0"]), refused="XYZ is not known here"),
    Example("THI", seq(end=["THI S2 50 60"]), refused="values, but takes"),
    Example("K", seq(face=["K -1 3"]), refused="values, but takes"),
    Example("DAR", tilt("YDE 2", "DAR NO"), refused="values, but takes"),
    Example("RDM", seq(end=["RDM N"]), refused="write RDM before it"),
    Example("RMD", seq(first="S -100.0 -45.0 REFL", second=[], face=["RMD REFR"]), refused="a mirror by its glass"),
    Example("S1", seq(end=["S1 70"], image=[]) + "SI 0 0\n", refused="stated a second time"),
    Example("S0", seq().replace("SO 0.0", "S0 0.0"), lambda r: near(r.radius(), 50.0) and len(r.surfaces) == 4),
    Example("S0", seq(second=["S -50.0 45.0", "S0 0.0 100.0"]), refused="is not the first surface"),
    Example("SO", seq().replace("SO 0.0 0.1e14", "SO 0.0"), refused="the object has no distance"),
    Example("SO", seq().replace("SO 0.0 0.1e14", "SO 0.0 100 REFL"), refused="the object is a mirror"),
    Example("S", seq(first="S 50.0 5.0 1.5168"), refused="no catalogue has the glass 1.5168"),
    Example("S", seq(first="S 50.0 5.0 NBK7_SCHOTT REFR 3.0"), refused="values, but takes"),
    Example("PRV", seq(["PRV\n PWL 486 587.5618 656\n 'G1' 1.53 1.52 1.51\nEND\nPRV\n PWL 587 900 1000\n 'G2' 1.6 1.5 1.4\nEND"], first="S 50.0 5.0 'G1'"),
            lambda r: near(r.index(), 1.52)),
    Example("PWL", seq(["PRV\n PWL 900 1000\n 'G1' 1.53 1.52\nEND"], first="S 50.0 5.0 'G1'"), refused="do not cover the lens's"),
    *(Example(name, seq([f"{name} 0.1 0.2 0.3"]), refused="3 numbers for 2 fields") for name in ("VUY", "WTF")),
    Example("XAN", seq(["XAN 1 2 3"]), refused="numbers for 3 fields"),
    Example("WTW", seq(["WTW 1"], without="WL"), refused="states no wavelength"),
    Example("TEL", seq(["TEL Y"]), refused="fields are angles"),
    # Other commands
    *(Example(name, seq(face=[f"{name} 1"]), passed_over=True) for name in
      "LEN NEW INI UID CLS DER DOR GO END EOD CWL THM CUM LOT ZLB CCY CCX THC GLC KC KYC KXC AC BC CC DC EC FC GC HC JC XDC YDC ZDC ADC BDC CDC CUC SCC HCC "
      "GRC PCD DLR DLT DLN DLF DLZ DLA TRX TRY DSX DSY BTX BTY TIR CMP VIE DRA BLT BLD".split()),
    Example("TEM", seq(["TEM 20.0"]), passed_over=True),
    Example("TEM", seq(["TEM 60.0"]), remarked="temperature"),
    Example("PRE", seq(["PRE 500.0"]), remarked="pressure"),
    Example("MLT", seq(face=["MLT coat.mul"]), remarked="coating"),
    Example("AFI", seq(["AFI Y"]), remarked="afocal"),
    Example("AFC", seq(["AFC Y"]), remarked="afocal"),
    Example("PIK", seq(end=["PIK THI S2 Z1 THI S1 Z1 -1.0"]), remarked="picked up"),
    Example("PIM", seq(end=["PIM"]), remarked="the thickness that the file states is taken"),
    *(Example(name, seq([f"{name} 1.0"]), remarked="apodisation") for name in ("PUX", "PUY", "PUI")),
    Example("ZOO", seq(["ZOO 1"]), passed_over=True),
    Example("ZOO", seq(["ZOO 3"]), refused="zoom positions"),
    *(Example(name, seq([f"{name} N"]), passed_over=True) for name in ("WID", "POL", "IC")),
    *(Example(name, seq([f"{name} Y"]), refused=said) for name, said in {"WID": "wide-angle", "POL": "polarisation", "IC": "other intersection"}.items()),
    *(Example(name, seq(face=[f"{name} 0.0"]), passed_over=True) for name in ("CUF", "XOD", "YOD", "ZOD")),
    *(Example(name, seq(face=[f"{name} 1.0"]), refused=said) for name, said in {"CUF": "Fresnel", "XOD": "pivot", "YOD": "pivot", "ZOD": "pivot"}.items()),
    *(Example(name, seq(face=[f"{name} 1"]), refused=said) for name, said in {
        "RET": "frame", "GLB": "frame", "AAS": "anamorphic", "ANA": "anamorphic", "SPS": "special", "SCO": "special", "UDS": "user's own", "SPL": "spline",
        "DIF": "grating", "GRT": "grating", "GRO": "grating", "GRS": "grating", "GRX": "grating", "GRY": "grating", "GRZ": "grating", "HOE": "hologram",
        "HOR": "diffractive", "HWL": "diffractive", "HCT": "diffractive", "HCO": "diffractive", "MFL": "perfect", "MOD": "perfect", "GRN": "gradient",
        "GRD": "gradient", "THG": "gradient", "DEF": "deformation", "INT": "surface error", "IFR": "surface error", "GL1": "non-sequential",
        "GL2": "non-sequential", "NSS": "non-sequential", "INS": "list of surfaces", "DEL": "list of surfaces"}.items()),
    *(Example(name, seq(face=[f"{name} x"]), refused="a program, not a lens") for name in
      ("IN", "RES", "IF", "ELS", "FOR", "WHI", "UNT", "LCL", "GBL", "NUM", "STR", "EVA", "FCT", "RTN", "GOT")),
    Example("^X", seq(face=["^x == 3"]), refused="a program, not a lens"),
    Example("XYZ", seq(face=["XYZ 1"]), refused="the card is unknown, and may change the light"),
    Example("XYZ", seq(["XYZ 1"]), remarked="the card is unknown, and was left out"),
]

# OSLO


def oslo(face: Sequence[str] = (), header: Sequence[str] = (), *, glass: str = "GLA BK7", last: Sequence[str] = (), end: Sequence[str] = (), beam: str = "EBR 5.0",
         field: str = "ANG 5.0", object_at: str = "1.0e20", unit: str = "UNI 1.0", radius: str = "RD 50.0", thickness: str = "TH 5.0", back: str = "RD -50.0") -> str:
    rows = ['LEN NEW "test" 100.0 3', beam, field, unit, *header, "AIR", f"TH {object_at}", "AP 1.0e18", "NXT", glass, radius, thickness, "AST", *face, "NXT", "AIR",
            back, "TH 45.0", *last, "NXT", "AIR", "TH 0.0", "AP 10.0", "WV 0.5875618", "END 3", *end]
    return "\n".join(rows) + "\n"


OSLO = [
    Example("LEN", oslo(), lambda r: near(r.radius(), 50.0) and near(r.place(2)[2], 5.0) and near(r.place(3)[2], 50.0) and near(r.index(), 1.5168, 1e-5)),
    Example("EBR", oslo(beam="EBR 6.0"), lambda r: near(r.pupil(), 12.0)),
    Example("FNO", oslo(beam="FNO 5.0"), lambda r: near(r.pupil(), number(r.optic.paraxial.f2()) / 5.0)),
    Example("NAP", oslo(beam="NAP 0.1"), lambda r: near(r.pupil(), 0.2 * number(r.optic.paraxial.f2()))),
    Example("NAO", oslo(beam="NAO 0.02", field="OBH 1.0", object_at="200.0"), lambda r: near(r.optic.aperture.value, 0.02)),
    Example("PUK", oslo(beam="PUK 0.1"), lambda r: near(r.pupil(), 0.2 * number(r.optic.paraxial.f2()))),
    Example("ANG", oslo(field="ANG 7.0"), lambda r: near(max(f.y for f in r.optic.fields.fields), 7.0)),
    Example("ANG", oslo(), remarked="the largest field alone"),
    Example("OBH", oslo(field="OBH 2.0", object_at="200.0"), lambda r: near(max(f.y for f in r.optic.fields.fields), 2.0)),
    Example("GIH", oslo(field="GIH 2.0"), lambda r: near(math.tan(math.radians(max(f.y for f in r.optic.fields.fields))) * number(r.optic.paraxial.f2()), 2.0)),
    Example("UNI", oslo(unit="UNI 25.4"), lambda r: near(r.radius(), 1270.0) and near(r.pupil(), 254.0)),
    Example("UNI", oslo(unit="UNI 25.4"), remarked="multiplied by 25.4"),
    Example("AIR", oslo(), lambda r: near(r.index(2), 1.0)),
    Example("AIF", oslo(last=["AIF"]), lambda r: near(r.index(2), 1.0)),
    Example("RFL", oslo(glass="RFL"), lambda r: r.surfaces[1].interaction_model.is_reflective),
    Example("RFH", oslo(glass="RFH"), lambda r: r.surfaces[1].interaction_model.is_reflective),
    Example("GLA", oslo(glass="GLA SF6"), lambda r: near(r.index(), 1.80518, 1e-5)),
    Example("GLA", oslo(glass="GLA 1.6"), lambda r: near(r.index(), 1.6)),
    Example("GLA", oslo(glass="GLA LUMICERAZ"), refused="no catalogue has the glass LUMICERAZ"),
    Example("GLF", oslo(glass="GLF SF6"), lambda r: near(r.index(), 1.80518, 1e-5)),
    Example("RD", oslo(radius="RD 80.0"), lambda r: near(r.radius(), 80.0)),
    Example("RDF", oslo(radius="RDF 80.0"), lambda r: near(r.radius(), 80.0)),
    Example("CV", oslo(radius="CV 0.01"), lambda r: near(r.radius(), 100.0)),
    Example("CVF", oslo(radius="CVF 0.01"), lambda r: near(r.radius(), 100.0)),
    Example("CVX", oslo(["CVX 0.0125"]), lambda r: near(r.sag(4.0, 0.0), conic(4.0, 80.0)) and near(r.sag(0.0, 4.0), conic(4.0, 50.0))),
    Example("RDX", oslo(["RDX 80.0"]), lambda r: near(r.sag(4.0, 0.0), conic(4.0, 80.0))),
    Example("TH", oslo(thickness="TH 8.0"), lambda r: near(r.place(2)[2], 8.0)),
    Example("THF", oslo(thickness="THF 8.0"), lambda r: near(r.place(2)[2], 8.0)),
    Example("AP", oslo(["AP CHK 4.0"]), lambda r: r.lets(0.0, 3.9) and not r.lets(0.0, 4.1)),
    Example("AP", oslo(["AP 4.0"]), lambda r: r.lets(0.0, 4.1)),
    Example("APF", oslo(["APF CHK 4.0"]), lambda r: not r.lets(0.0, 4.1)),
    Example("APCK", oslo(["AP CHK 4.0"], ["APCK OFF"]), lambda r: r.lets(0.0, 4.1)),
    Example("CC", oslo(["CC -0.7"]), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0, -0.7))),
    *(Example(name, oslo([f"{name} 1e-{power}"]), lambda r, power=power: near(r.sag(3.0, 4.0), conic(5.0, 50.0) + 0.5**power, 1e-12))
      for name, power in zip(("AD", "AE", "AF", "AG"), (4, 6, 8, 10), strict=True)),
    Example("ASP", oslo(["ASP ASR 4", "AS1 1e-4", "AS2 1e-5"]), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0) + 1e-4 * 25 + 1e-5 * 625)),
    Example("ASP", oslo(["ASP ZRR 4"]), refused="asphere type ZRR is not mapped"),
    Example("AST", oslo(), lambda r: r.surfaces[1].is_stop),
    # Tilts are left-handed about x and y.
    *(Example(name, oslo([f"{name} 2.5"]), lambda r, axis=axis: near(r.place(1)[axis], 2.5)) for axis, name in enumerate(("DCX", "DCY", "DCZ"))),
    Example("TLA", oslo(["TLA 20.0"]), lambda r: np.allclose(r.axes(1), turned(x=-20.0), atol=1e-12)),
    Example("TLB", oslo(["TLB 20.0"]), lambda r: np.allclose(r.axes(1), turned(y=-20.0), atol=1e-12)),
    Example("TLC", oslo(["TLC 20.0"]), lambda r: np.allclose(r.axes(1), turned(z=20.0), atol=1e-12)),
    Example("DT", oslo(["DT -1", "DCY 2.0", "TLA 20.0"]), lambda r: np.allclose(r.place(1), turned(x=-20.0) @ [0.0, 2.0, 0.0], atol=1e-12)),
    Example("GC", oslo(last=["GC 1", "DCZ 6.0"]), lambda r: near(r.place(2)[2], 6.0)),
    Example("RCO", oslo(["TLA 20.0", "RCO"]), lambda r: np.allclose(r.axes(2), np.eye(3), atol=1e-12)),
    Example("BEN", oslo(["TLA 45.0", "BEN"], glass="RFL"), lambda r: np.allclose(np.abs(r.place(2)), [0.0, 5.0, 0.0], atol=1e-9)),
    *(Example(name, oslo([f"{name} 10.0", "TLA 20.0", "TLB 20.0"]), lambda r: not np.allclose(r.place(1), 0.0)) for name in ("TOX", "TOY", "TOZ")),
    Example("WV", oslo(header=["WV 0.65 0.48"]), lambda r: r.optic.wavelengths.wavelengths[0].value == 0.5875618),
    Example("WW", oslo(header=["WW 2.0"]), lambda r: r.optic.wavelengths.wavelengths[0].weight == 2.0),
    Example("NXT", oslo(), lambda r: len(r.surfaces) == 4),
    Example("GTO", oslo(last=["GTO 1", "RD 80.0", "GTO 2"]), lambda r: near(r.radius(), 80.0)),
    Example("END", oslo(), lambda r: len(r.surfaces) == 4),
    Example("PY", oslo(last=["PY 0.0"]), lambda r: abs(number(r.optic.paraxial.marginal_ray()[0][-1])) < 1e-6),
    Example("PYC", oslo(last=["PYC 2.0"]), lambda r: near(abs(number(r.optic.paraxial.chief_ray()[0][-1])), 2.0, 1e-6)),
    Example("PU", oslo(last=["PU -0.2"]), lambda r: near(number(r.optic.paraxial.marginal_ray()[1][-1]), -0.2, 1e-6)),
    Example("PUC", oslo(last=["PUC 0.1"]), lambda r: near(number(r.optic.paraxial.chief_ray()[1][-1]), 0.1, 1e-4)),
    Example("EC", oslo(["EC 5.0"]), lambda r: near(r.sag(0.0, 5.0), r.place(2)[2] + r.sag(0.0, 5.0, 2), 1e-6)),
    Example("PK", oslo(back="RD -60.0", last=["PK CVM 1"]), lambda r: near(r.radius(2), -50.0)),
    Example("TELE", oslo(beam="NAO 0.02", field="OBH 1.0", object_at="200.0", header=["TELE ON"]), lambda r: r.optic.obj_space_telecentric),
    Example("LMO", oslo(["LMO ELE"]), lambda r: near(r.radius(), 50.0)),
    Example("LMO", oslo(["LMO NSS"]), refused="non-sequential groups"),
    Example("ATD", oslo(["CC -0.7", "ATD"]), lambda r: near(r.sag(3.0, 4.0), conic(5.0, 50.0))),
    Example("CXD", oslo(["CVX 0.0125", "CXD"]), lambda r: near(r.sag(4.0, 0.0), conic(4.0, 50.0))),
    Example("APD", oslo(["APD"]), lambda r: near(r.radius(), 50.0)),
    Example("GCD", oslo(last=["GC 1", "GCD"]), lambda r: near(r.place(2)[2], 5.0)),
    Example("RCD", oslo(["TLA 20.0", "RCO", "RCD"]), lambda r: np.allclose(r.axes(2), turned(x=-20.0), atol=1e-12)),
    Example("BED", oslo(["TLA 20.0", "BEN", "BED"]), lambda r: np.allclose(r.axes(2), turned(x=-20.0), atol=1e-12)),
    Example("PFD", oslo(["PFD"]), lambda r: near(r.radius(), 50.0)),
    Example("TDD", oslo(["TLA 20.0", "TDD"]), lambda r: np.allclose(r.axes(1), np.eye(3))),
    Example("CSD", oslo(last=["PU -0.2", "CSD"]), lambda r: near(r.radius(2), -50.0)),
    Example("TSD", oslo(last=["PY 0.0", "TSD"]), lambda r: near(r.place(3)[2], 50.0)),
    *(Example(name, oslo([f"{name} \"a\" 1"]), passed_over=True) for name in "DRW LDP CBK ELMDF1 ELMDF2 BDI BDD VX PF LMN LME DES NOT".split()),
    Example("SNO", oslo(["SNO1 \"a note; of two\""]), passed_over=True),
    Example("TCE", oslo(["TCE 71.0"]), passed_over=True),
    Example("GOR", oslo(["GOR 0"]), passed_over=True),
    *(Example(name, oslo([f"{name} 1"]), refused=said) for name, said in {
        "APN": "special apertures", "ATP": "special apertures", "DFR": "diffractive", "DOE": "diffractive", "HOR": "hologram", "GSP": "grating", "GOR": "grating",
        "PFL": "perfect", "PFM": "perfect", "GRC": "gradient", "GDT": "gradient", "ARY": "arrays", "COT": "coatings"}.items()),
    Example("XYZ", oslo(["XYZ 1"]), refused="the card is unknown, and may change the light"),
    Example("XYZ", oslo(header=["XYZ 1"]), remarked="the card is unknown, and was left out"),
    Example("GLA", oslo(glass="GLA 517642"), refused="write an index from 1 to 10"),
    Example("GLA", oslo(glass="GLA E5"), refused="no catalogue has the glass E5"),
    Example("GLA", oslo(["GLA bk7"], glass="GLA BK7"), lambda r: near(r.index(), 1.5168, 1e-5)),
    Example("EBR", oslo(beam=""), refused="states no aperture"),
    Example("ANG", oslo(field=""), remarked="no field is stated"),
    Example("WV", oslo().replace("WV 0.5875618\n", ""), remarked="no wavelength (WV) is stated"),
    Example("AST", oslo().replace("AST\n", ""), remarked="no surface is the stop"),
    Example("RFL", oslo(beam="FNO 5.0").replace("AIR\nTH 1.0e20", "RFL\nTH 1.0e20"), refused="the object is a mirror"),
    Example("END", oslo(end=["ANG 20"]), remarked="stands behind END"),
    Example("AP", oslo().replace("AP 10.0", "AP CHK 10.0"), remarked="the image's aperture was left out"),
    Example("CFG", oslo(end=["CFG NEW", "XYZ 1 2 3", "END"]), refused="override is not mapped"),
]

CORPUS = {".zmx": ZEMAX, ".seq": CODEV, ".len": OSLO}
