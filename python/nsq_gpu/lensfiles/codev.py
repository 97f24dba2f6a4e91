"""Reads lens files of CODE V (.seq).

No public page describes the format. What a command means is confirmed by rayoptics, which reads it as well (``codev/cmdproc.py``), or
by the public converters from CODE V. Where those do not decide, the command is refused. Tilts ADE and BDE are left-handed, CDE is
right-handed; a surface is moved first, then turned about its x, its new y and its new z.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from optiland.materials import DataMaterial, IdealMaterial
from optiland.physical_apertures import RadialAperture

from nsq_gpu.errors import UnsupportedSceneError
from nsq_gpu.lensfiles import glasses
from nsq_gpu.lensfiles.cards import SAVE_WITHOUT_IT, Card, Reading, number_of, table
from nsq_gpu.lensfiles.system import INFINITE, FileField, FileSurface, System, all_but, both, disk, ellipse, rectangle, rotation_about, tilted
from nsq_gpu.shapes import ENDLESS

#: mm a unit.
UNITS = {"M": 1.0, "MM": 1.0, "C": 10.0, "CM": 10.0, "I": 25.4, "IN": 25.4, "INC": 25.4, "INCH": 25.4, "INCHES": 25.4}
#: Coefficients of an asphere, and the power of r of each.
POWERS = dict(zip("ABCDEFGHJ", range(4, 22, 2), strict=True))


def _is_no(card: Card) -> bool:
    return bool(card.words) and card.words[0].upper() in ("N", "NO")


def _is_zero(card: Card) -> bool:
    return card.is_zero


def _is_one(card: Card) -> bool:
    return card.words == ("1",)


#: Cards anywhere.
CARDS = table(
    carried="RDM DIM TIT EPD FNO NA NAO WL WTW REF XAN YAN XOB YOB XIM YIM XRI YRI WTF VUX VLX VUY VLY TEL CA PRV PWL STO SLB SPH CON ASP "
            "CYL XTO YTO K A B C D E F G H J RDY CUY RDX CUX THI GLA RMD XDE YDE ZDE ADE BDE CDE DAR BEN REV CIR REX REY ELX ELY CIG REG ELG "
            "ADX ADY ARO",
    # Names, optimisation, tolerances and drawing.
    no_light="LEN NEW INI UID CLS DER DOR GO END EOD CWL THM CUM LOT ZLB CCY CCX THC GLC KC KYC KXC AC BC CC DC EC FC GC HC JC XDC YDC ZDC "
             "ADC BDC CDC CUC SCC HCC GRC PCD DLR DLT DLN DLF DLZ DLA TRX TRY DSX DSY BTX BTY TIR CMP VIE DRA BLT BLD",
    remarked={
        "TEM": ("indices are not corrected for the air's temperature", lambda card: 20.0 <= card.number(0) <= 22.0),
        "PRE": ("indices are not corrected for the air's pressure", lambda card: card.number(0) == 760.0),
        "MLT": "a coating was left out: the face is bare, and reflects by Fresnel's law",
        **dict.fromkeys(("AFI", "AFC"), "the image is afocal: the detector shows where light meets the image surface, and not angles"),
        "PIK": "a number is picked up from another: the one that the file states is taken",
        "PIM": "the image's place is solved for: the thickness that the file states is taken",
        **dict.fromkeys(("PUX", "PUY", "PUI"), "the pupil's apodisation was left out: the source of a field fills the pupil uniformly"),
    },
    refused={
        "ZOO": ("zoom positions cannot be carried", "save one position as a file of its own", _is_one),
        "WID": ("aiming of a wide-angle lens is not known here", "set WID N", _is_no),
        "POL": ("rays of a scene carry no polarisation", "set POL N", _is_no),
        "IC": ("the other intersection of a ray and a surface cannot be carried", "set IC N", _is_no),
        "CUF": ("a Fresnel surface cannot be carried", SAVE_WITHOUT_IT, _is_zero),
        **dict.fromkeys(("XOD", "YOD", "ZOD"), ("a pivot of tilts is not known here", "write the shift as XDE, YDE and ZDE", _is_zero)),
        "RET": ("a return to another surface's frame is not known here", "write the tilts by XDE .. CDE"),
        "GLB": ("a frame by a global reference is not known here", "write the tilts by XDE .. CDE"),
        **dict.fromkeys(("AAS", "ANA"), ("an anamorphic asphere cannot be carried", SAVE_WITHOUT_IT)),
        "SPS": ("a special surface cannot be carried", SAVE_WITHOUT_IT),
        "SCO": ("a coefficient of a special surface cannot be carried", SAVE_WITHOUT_IT),
        "UDS": ("a surface of the user's own cannot be carried", SAVE_WITHOUT_IT),
        "SPL": ("a spline cannot be carried", SAVE_WITHOUT_IT),
        "DIF": ("a grating or diffractive surface has no place in a scene", SAVE_WITHOUT_IT),
        **dict.fromkeys(("GRT", "GRO", "GRS", "GRX", "GRY", "GRZ"), ("a grating has no place in a scene", SAVE_WITHOUT_IT)),
        "HOE": ("a hologram has no place in a scene", SAVE_WITHOUT_IT),
        **dict.fromkeys(("HOR", "HWL", "HCT", "HCO"), ("a diffractive surface has no place in a scene", SAVE_WITHOUT_IT)),
        **dict.fromkeys(("MFL", "MOD"), ("a paraxial (perfect) lens has no glass that light could meet", SAVE_WITHOUT_IT)),
        **dict.fromkeys(("GRN", "GRD"), ("a gradient index cannot be carried", SAVE_WITHOUT_IT)),
        "THG": ("a thermal gradient cannot be carried", SAVE_WITHOUT_IT),
        "DEF": ("a deformation cannot be carried", SAVE_WITHOUT_IT),
        **dict.fromkeys(("INT", "IFR"), ("a measured surface error cannot be carried", SAVE_WITHOUT_IT)),
        **dict.fromkeys(("GL1", "GL2"), ("media of non-sequential surfaces cannot be carried", SAVE_WITHOUT_IT)),
        "NSS": ("non-sequential surfaces cannot be carried", SAVE_WITHOUT_IT),
        **dict.fromkeys(("INS", "DEL"), ("commands that change the list of surfaces are not followed", "save the lens in CODE V, and convert that file")),
        **dict.fromkeys(("IN", "RES", "IF", "ELS", "FOR", "WHI", "UNT", "LCL", "GBL", "NUM", "STR", "EVA", "FCT", "RTN", "GOT"),
                        ("the file is a program, not a lens", "run it in CODE V, and save the lens")),
    })

#: Commands of fields, and what kind of field each states.
_FIELD_TYPES = {"XAN": "angle", "YAN": "angle", "XOB": "object_height", "YOB": "object_height", "XIM": "paraxial_image_height",
                "YIM": "paraxial_image_height", "XRI": "real_image_height", "YRI": "real_image_height"}
_APERTURE_KINDS = ("CLR", "OBS", "EDG", "HOL")
#: Decenters along x, y and z, and tilts about them.
_DECENTERS = ("XDE", "YDE", "ZDE", "ADE", "BDE", "CDE")


@dataclass(eq=False)
class _Given:
    """A surface and its commands; the last of a name counts."""

    start: Card
    kind: str
    radius: float
    thickness: float
    glass: tuple[Card, str] | None = None
    is_mirror: bool = False
    cards: dict[str, Card] = field(default_factory=dict)
    #: Commands of its apertures, in their order.
    apertures: list[Card] = field(default_factory=list)


def read(text: str, reading: Reading) -> System:
    """Return what a file says.

    Raises:
        UnsupportedSceneError: A command is refused, with its line.
        UsageError: A command makes no sense, with its line.
    """
    return _Reader(reading).system(text)


def statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line on which a command begins, and its words. Quotes hold blanks together, and stay."""
    pending, start = "", 0
    for line, row in enumerate(text.splitlines(), start=1):
        row = re.sub(r"""("[^"]*"|'[^']*')|!.*""", lambda found: found.group(1) or "", row).rstrip()
        start = start if pending else line
        if row.endswith("&"):
            pending += row[:-1] + " "
            continue
        for part in re.findall(r"""(?:"[^"]*"|'[^']*'|[^;"']|["'])+""", pending + row):
            words = re.findall(r"""(?:[^\s"']|"[^"]*"|'[^']*'|["'])+""", part)
            if words:
                yield start, words
        pending = ""
    if pending.split():
        yield start, pending.split()


def _bare(word: str) -> str:
    return word.strip("'\"")


class _Reader:
    def __init__(self, reading: Reading) -> None:
        self.reading = reading
        self.header: dict[str, Card] = {}
        self.surfaces: list[_Given] = []
        #: Cards of the aperture in their order: the last counts.
        self.aperture: Card | None = None
        self.stop: tuple[Card, int] | None = None
        self.private: dict[str, tuple[Card, list[float], list[float]]] = {}
        self.private_lines: list[float] = []

    @property
    def unit(self) -> float:
        return self.reading.unit

    def system(self, text: str) -> System:
        self._collect(text)
        found = System()
        dim, title, radius = (self.header.get(name) for name in ("DIM", "TIT", "RDM"))
        self.reading.read_unit("DIM", dim, UNITS, "M, C or I")
        found.name = _bare(" ".join(title.words)) or None if title is not None else None
        if not self.surfaces:
            self.reading.broken("cannot read it as a lens of CODE V: no line begins with S, SO or SI")
        self._add_ends()
        self._fields(found)
        self._wavelengths(found)
        self._surfaces(found, curvatures=_is_no(radius) if radius is not None else self._are_curvatures())
        self._aperture(found)
        return found

    # Commands

    def _collect(self, text: str) -> None:
        in_private = False
        for line, words in statements(text):
            name = words[0].upper()
            name = name if re.fullmatch(r"S\d+", name) else name[:3]
            number = len(self.surfaces) - 1 if self.surfaces else None
            if name in ("SO", "S", "SI") or re.fullmatch(r"S\d+", name):
                number = len(self.surfaces) if name in ("SO", "S", "SI") else int(name[1:])
            card = self.reading.card(name, words[1:], line, number)
            if in_private:
                if name == "END":
                    in_private = False
                elif name == "PWL":
                    self.private_lines = card.numbers()
                else:
                    self._private(self.reading.card(_bare(words[0]), words[1:], line, None))
            elif name == "PRV":
                in_private = True
            elif name in ("SO", "S", "SI") or re.fullmatch(r"S\d+", name):
                self._start(card)
            elif name.startswith(("^", "@")):
                card.refuse("the file is a program, not a lens", "run it in CODE V, and save the lens")
            else:
                self._command(card)
        if in_private:
            self.reading.broken("the private catalogue (PRV) has no END")

    def _private(self, card: Card) -> None:
        if not card.words:
            card.broken("a private glass has no numbers")
        try:
            number_of(card.words[0])
        except ValueError:
            card.refuse(f"the private glass {card.name} is given by a formula ({_bare(card.words[0])}), which is not known here",
                        "state its index at each wavelength of PWL, or give glasses={...}")
        values = card.numbers()
        if len(values) != len(self.private_lines):
            card.broken(f"the private glass {card.name} has {len(values)} indices for {len(self.private_lines)} wavelengths (PWL); write as many indices as wavelengths")
        self.private[glasses.plain(card.name)] = (card, self.private_lines, values)

    def _start(self, card: Card) -> None:
        """Begin a surface."""
        card.only(4)
        kind = "SO" if card.name == "S0" else card.name if card.name in ("SO", "SI") else "S"
        words = list(card.words)
        endless = [word.upper() in ("INF", "INFINITY") for word in (*words[:2], "", "")]
        if kind == "SO" and len(words) < 2:
            card.broken("the object has no distance")
        given = _Given(card, kind, 0.0 if endless[0] else card.number(0, 0.0), INFINITE if endless[1] else card.number(1, 0.0))
        if len(words) > 2:
            given.glass = (card, words[2])
        if len(words) > 3:
            if words[3].upper() not in ("REFL", "REFR"):
                card.refuse(f"{words[3]} behind the glass is not known here", "write REFL for a mirror")
            given.is_mirror = words[3].upper() == "REFL"
        if kind == "SO" and self.surfaces:
            card.broken("the object (SO) is not the first surface")
        if self.surfaces and self.surfaces[-1].kind == "SI":
            card.broken("a surface follows the image (SI)")
        if kind == "S" and card.name != "S":
            number, expected = int(card.name[1:]), len(self.surfaces) + (0 if self.surfaces and self.surfaces[0].kind == "SO" else 1)
            if number < expected:
                card.refuse("the surface is stated a second time", f"change it by RDY {card.name}, THI {card.name} and GLA {card.name}")
            if number > expected:
                card.broken(f"surface {number} follows surface {expected - 1}")
        self.surfaces.append(given)

    def _target(self, card: Card) -> tuple[Card, _Given | None]:
        """Return a command without the surface that it names, and that surface."""
        if card.words and re.fullmatch(r"[Ss]\d+\.\.\S+", card.words[0]):
            card.refuse("a command for a range of surfaces is not followed", "write it for each surface")
        named = re.fullmatch(r"S(\d+|O|I)", card.words[0].upper()) if card.words else None
        if named is None:
            return card, self.surfaces[-1] if self.surfaces else None
        word = named.group(1)
        has_object = bool(self.surfaces) and self.surfaces[0].kind == "SO"
        index = 0 if word == "O" else len(self.surfaces) - 1 if word == "I" else int(word) - (0 if has_object else 1)
        if not 0 <= index < len(self.surfaces):
            card.broken(f"there is no surface {card.words[0]} yet")
        return Card(card.name, card.words[1:], card.place), self.surfaces[index]

    def _command(self, card: Card) -> None:
        named, target = self._target(card)
        # What follows the image belongs to it only where it says so.
        in_surface = target is not None and (target.kind != "SI" or named is not card)
        if not self.reading.is_carried(named, CARDS, in_surface=in_surface):
            return
        name = named.name
        if name in ("THI", "CUY", "CUX", "RDY", "RDX") and named.words and named.words[0][0].isalpha():
            word = named.words[0].upper()
            if word in _SOLVES:
                self.reading.remark(named, "the number is solved for: the one that the file states is taken")
                return
            if word not in ("INF", "INFINITY") or name in ("CUY", "CUX"):
                named.refuse(f"{word} is not known here", "write a number")
            named = Card(name, (str(INFINITE) if name == "THI" else "0", *named.words[1:]), named.place)
        named.only(_MOST_WORDS.get(name, 10_000))
        if name == "STO":
            if target is None:
                named.broken("no surface stands before the stop")
            self.stop = (named, self.surfaces.index(target))
        elif name in ("EPD", "FNO", "NA", "NAO"):
            self.aperture = named
        elif name in _HEADER:
            if name == "RDM" and self.surfaces:
                named.broken("radii or curvatures are chosen behind the first surface; write RDM before it")
            self.header[name] = named
        elif target is None:
            named.broken("no surface stands before the command")
        elif name == "THI":
            target.thickness = named.number(0)
        elif name == "GLA":
            target.glass = (named, named.words[0] if named.words else "AIR")
        elif name == "RMD":
            mode = named.words[0].upper() if named.words else ""
            if mode not in ("REFL", "REFR"):
                named.refuse(f"the mode {' '.join(named.words)} is not known here", "write REFL for a mirror")
            if mode == "REFR" and target.glass is not None and _bare(target.glass[1]).upper() == "REFL":
                named.broken("the surface is a mirror by its glass (REFL)")
            target.is_mirror = mode == "REFL"
        elif name in ("CIR", "REX", "REY", "ELX", "ELY", "CIG", "REG", "ELG", "ADX", "ADY", "ARO"):
            target.apertures.append(named)
        else:
            # The last one counts, also of commands that say the same in two ways.
            target.cards.pop(name, None)
            target.cards[name] = named

    def _add_ends(self) -> None:
        """Add an object or an image where the file has none."""
        if self.surfaces[0].kind != "SO":
            self.reading.remark(None, "there is no object (SO): it is taken as far away")
            self.surfaces.insert(0, _Given(self.surfaces[0].start, "SO", 0.0, INFINITE))
            self.stop = (self.stop[0], self.stop[1] + 1) if self.stop is not None else None
        if self.surfaces[-1].kind != "SI":
            self.surfaces[-1].start.broken("the last surface is no image; write SI")

    def _are_curvatures(self) -> bool:
        """Return whether a file that states no RDM has curvatures: the other reading must be none of a lens."""
        values = [abs(given.radius) for given in self.surfaces if given.radius]
        if not values:
            return False
        gaps = [abs(given.thickness) for given in self.surfaces if abs(given.thickness) < INFINITE]
        least = 0.5 * self.aperture.number(0) if self.aperture is not None and self.aperture.name == "EPD" else 0.01 * max(gaps)
        radii, curvatures = min(values) >= least, 1.0 / max(values) >= least
        if radii == curvatures:
            raise UnsupportedSceneError(f"{self.reading.path.name}: RDM is not stated, and the first number of an S line may be a radius or a "
                                        "curvature; write RDM (radii) or RDM N (curvatures) before the first surface")
        what, other = ("a radius", "a curvature") if radii else ("a curvature", "a radius")
        self.reading.remark(None, "RDM is not stated: the first number of an S line is taken for "
                            f"{what}. Taken for {other}, a surface would be too small: its radius would be below {least:.3g}")
        return curvatures

    # The light

    def _fields(self, found: System) -> None:
        lists = {name: self.header[name].numbers() for name in (*_FIELD_TYPES, "WTF", "VUX", "VLX", "VUY", "VLY") if name in self.header}
        kinds = {_FIELD_TYPES[name] for name in lists if name in _FIELD_TYPES}
        if len(kinds) > 1:
            self.header[[name for name in lists if name in _FIELD_TYPES][-1]].broken(f"fields are stated as {' and as '.join(sorted(kinds))}; one "
                                                                                    "kind is needed")
        found.field_type = kinds.pop() if kinds else "angle"
        count = max((len(lists[name]) for name in lists if name in _FIELD_TYPES), default=1)
        length = 1.0 if found.field_type == "angle" else self.unit
        for name, numbers in lists.items():
            if len(numbers) != count:
                self.header[name].broken(f"the list has {len(numbers)} numbers for {count} fields")

        def value(index: int, *names: str, default: float = 0.0) -> float:
            values = next((lists[name] for name in names if name in lists), [])
            return values[index] if index < len(values) else default

        for index in range(count):
            x, y = (length * value(index, f"{axis}AN", f"{axis}OB", f"{axis}IM", f"{axis}RI") for axis in "XY")
            edges = [(value(index, f"VU{axis}"), value(index, f"VL{axis}")) for axis in "XY"]
            compress = [0.5 * (upper + lower) for upper, lower in edges]
            for axis, closed in zip("XY", compress, strict=True):
                if not closed < 1.0:
                    (self.header.get(f"VU{axis}") or self.header[f"VL{axis}"]).broken(f"the pupil of field {index + 1} is closed: the upper and the "
                                                                                     "lower share that are cut add up to 2 or more")
            weight = value(index, "WTF", default=1.0)
            if weight < 0.0:
                self.header["WTF"].broken(f"the weight {weight:g} of field {index + 1} is below 0")
            found.fields.append(FileField(x, y, weight, (compress[0], compress[1]),
                                          (0.5 * (edges[0][1] - edges[0][0]), 0.5 * (edges[1][1] - edges[1][0]))))
        found.is_telecentric = "TEL" in self.header and not _is_no(self.header["TEL"])

    def _wavelengths(self, found: System) -> None:
        lines = self.header.get("WL")
        values = lines.numbers() if lines is not None else []
        weights = self.header["WTW"].numbers() if "WTW" in self.header and values else [1.0] * len(values)
        if lines is not None and len(weights) != len(values):
            self.header["WTW"].broken(f"{len(weights)} weights stand for {len(values)} wavelengths (WL)")
        if any(not 10.0 <= line <= 1e6 for line in values) or any(weight < 0.0 for weight in weights) or values and not any(weights):
            (lines or self.header["WTW"]).broken("wavelengths are from 10 to 1,000,000 nm, and weights at least 0, not all of them 0")
        found.wavelengths = [(line / 1000.0, weight) for line, weight in zip(values, weights, strict=True)]
        reference = self.header.get("REF")
        found.primary = reference.whole(0) - 1 if reference is not None else len(values) // 2
        if values and not 0 <= found.primary < len(values):
            reference.broken(f"wavelength {found.primary + 1} is the reference, but there are {len(values)}")
        if reference is None and len(values) > 1:
            self.reading.remark(None, f"no reference wavelength (REF) is stated: {values[found.primary]:g} nm is taken")

    def _aperture(self, found: System) -> None:
        card = found.aperture_card = self.aperture
        if card is None:
            return
        value = card.number(0)
        if not value > 0.0:
            card.broken(f"an aperture of {value:g} lets no light in; write a number above 0")
        # CODE V's F-number is 1 / (2 NA) at the conjugate in use.
        found.aperture = {"EPD": ("EPD", value * self.unit), "FNO": ("image_na", 0.5 / value), "NA": ("image_na", value),
                          "NAO": ("object_na", value)}[card.name]

    # Surfaces

    def _surfaces(self, found: System, *, curvatures: bool) -> None:
        position, rotation = np.zeros(3), np.eye(3)
        for number, given in enumerate(self.surfaces):
            surface = self._surface(given, number, curvatures=curvatures)
            self.reading.cards[number] = [*given.cards.values(), *given.apertures]
            far = abs(given.thickness) >= INFINITE
            surface.thickness = math.copysign(math.inf, given.thickness) if far else given.thickness * self.unit
            if number == 0:
                surface.position = np.array([0.0, 0.0, -surface.thickness])
                if any(self._number(given, name) for name in _DECENTERS):
                    given.start.refuse("a tilted or decentred object cannot be carried", "tilt the surfaces behind it")
            elif far:
                given.start.broken("its thickness is infinite; only the object's may be")
            else:
                if given.kind == "SI":
                    # The image's thickness is a defocus, along the axis before it.
                    if given.thickness and any(self._number(given, name) for name in _DECENTERS):
                        self.reading.remark(given.start, "the image is tilted or decentred: its defocus is taken along the axis before it")
                    position = position + rotation[:, 2] * surface.thickness
                    surface.thickness = 0.0
                position, rotation = self._place(given, surface, position, rotation)
            if surface.numbers.pop("turned", False):
                surface.rotation = surface.rotation @ rotation_about(2, 90.0)
            found.surfaces.append(surface)
        self._set_stop(found)

    def _place(self, given: _Given, surface: FileSurface, position: np.ndarray, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place a surface in the frame that is handed on to it; return the frame of the next one."""
        shift = np.array([self._number(given, name) * self.unit for name in _DECENTERS[:3]])
        alpha, beta, gamma = (self._number(given, name) for name in _DECENTERS[3:])
        turned = tilted((-alpha, -beta, gamma))
        step = np.array([0.0, 0.0, surface.thickness])
        kinds = [name for name in ("DAR", "BEN", "REV") if name in given.cards]
        if len(kinds) > 1:
            given.cards[kinds[1]].broken(f"the surface has {kinds[0]} as well; keep one of them")
        if kinds == ["REV"]:
            surface.position, surface.rotation = position, rotation
            return position + rotation @ turned.T @ (step - shift), rotation @ turned.T
        surface.position, surface.rotation = position + rotation @ shift, rotation @ turned
        if kinds == ["DAR"]:
            return position + rotation @ step, rotation
        behind = surface.rotation
        if kinds == ["BEN"]:
            card = given.cards["BEN"]
            if surface.material != "mirror":
                card.broken("the surface is not a mirror; write REFL as its glass, or DAR in the place of BEN")
            if alpha and beta or gamma:
                card.refuse("a bend about two axes is not known here", "keep one of ADE and BDE, and no CDE")
            behind = behind @ turned
        return surface.position + behind @ step, behind

    def _set_stop(self, found: System) -> None:
        index = 1
        if self.stop is None:
            self.reading.remark(None, "no surface is the stop (STO): surface 1 is taken")
        else:
            card, index = self.stop
            if index == 0 or index == len(self.surfaces) - 1 and len(self.surfaces) > 2:
                card.broken("the object or the image cannot be the stop")
        if index >= len(found.surfaces):
            return
        stop = found.surfaces[index]
        stop.is_stop = True
        if np.abs(stop.position[:2]).max() > 1e-12 or abs(stop.rotation[2, 2] - 1.0) > 1e-12:
            # A paraxial pupil knows no tilts and decenters.
            found.aims_at_stop = True
            self.reading.remark(None, "the stop is off the axis, or tilted: rays are aimed at it")
        elif index > 1 and any(field.x or field.y for field in found.fields):
            self.reading.remark(None, "rays are aimed at the paraxial pupil; in CODE V the chief ray of a field goes through the middle of the "
                                "stop itself")

    def _number(self, given: _Given, name: str) -> float:
        return given.cards[name].number(0) if name in given.cards else 0.0

    def _surface(self, given: _Given, number: int, *, curvatures: bool) -> FileSurface:
        label = given.cards.get("SLB")
        found = FileSurface(given.start, number, _bare(" ".join(label.words)) if label is not None else "")

        def radius_of(value: float, is_curvature: bool) -> float:
            return (self.unit / value if is_curvature else value * self.unit) if value else math.inf

        radius = radius_of(given.radius, curvatures)
        along_x = None
        for name, card in given.cards.items():
            if name in ("RDY", "CUY"):
                radius = radius_of(card.number(0), name == "CUY")
            elif name in ("RDX", "CUX"):
                along_x = radius_of(card.number(0), name == "CUX")
        found.shape, found.numbers = self._shape(given, radius, along_x)
        found.material = self._material(given)
        found.aperture = self._opening(given, is_mirror=found.material == "mirror")
        if found.numbers.get("turned") and type(found.aperture).__name__ not in ("NoneType", "RadialAperture"):
            given.start.refuse("an aperture that is no disk about the axis cannot be carried on a surface that is curved along x",
                               "turn the lens by 90 degrees")
        return found

    def _shape(self, given: _Given, radius: float, along_x: float | None) -> tuple[str, dict[str, Any]]:
        cards = given.cards
        kind = next((name for name in reversed(cards) if name in ("SPH", "CON", "ASP", "CYL", "XTO", "YTO")), None)
        k = self._number(given, "K")
        last = max((index for index, name in enumerate(POWERS) if name in cards), default=-1)
        series = [0.0] + [self._number(given, name) * self.unit ** (1 - power) for name, power in POWERS.items()][:last + 1]
        series = series if any(series) else []
        if kind == "SPH" and (k or series) or kind == "CON" and series:
            cards[kind].refuse(f"the surface has {'a conic constant or ' if kind == 'SPH' else ''}coefficients, which {kind} has not", "write ASP, or leave them out")
        if kind in (None, "SPH", "CON", "ASP"):
            if along_x is not None:
                cards["RDX" if "RDX" in cards else "CUX"].refuse("a curvature along x needs CYL, XTO or YTO", "write the kind of the surface")
            return ("even_asphere", {"radius": radius, "conic": k, "coefficients": series}) if series else (
                "standard", {"radius": radius, "conic": k})
        card = cards[kind]
        if kind == "CYL":
            if along_x in (None, math.inf):
                return "toroidal", {"radius_y": radius, "radius_x": math.inf, "conic": k, "toroidal_coeffs_poly_y": series}
            if math.isfinite(radius) or k or series:
                card.refuse("a cylinder that is curved in both directions, or curved along x with a conic or with coefficients, is not known here",
                            "write it as YTO")
            return "toroidal", {"radius_y": along_x, "radius_x": math.inf, "conic": 0.0, "toroidal_coeffs_poly_y": [], "turned": True}
        if along_x is None:
            card.refuse("a toroid without a radius along x (RDX) is not known here", "write RDX; 0 is a straight line")
        profile, other = (radius, along_x) if kind == "YTO" else (along_x, radius)
        return "toroidal", {"radius_y": profile, "radius_x": other, "conic": k, "toroidal_coeffs_poly_y": series, "turned": kind == "XTO"}

    def _material(self, given: _Given) -> Any:
        if given.kind == "SI":
            return "air"
        card, word = given.glass or (given.start, "AIR")
        token = _bare(word)
        if given.is_mirror or token.upper() == "REFL":
            return "mirror"
        if token.upper() == "AIR" or not token:
            return "air"
        if glasses.plain(token) in self.private:
            return self._private_glass(token)
        model = self._model(card, token)
        if model is not None:
            nd, vd = model
            if glasses.has_dispersion(vd):
                self.reading.remark(card, f"the glass {token} is taken as nd = {nd:.6g}, Vd = {vd:.5g}, and Optiland's model of Buchdahl")
            return glasses.model(nd, vd)
        name, _, catalogue = token.rpartition("_")
        if not name:
            return glasses.find(self.reading, card, token)
        return glasses.find(self.reading, card, name, () if catalogue.upper() in ("SPECIAL", "OLD") else (catalogue,))

    def _model(self, card: Card, token: str) -> tuple[float, float] | None:
        """Return nd and Vd of a glass that is written by them."""
        if re.fullmatch(r"[\d.]+:[\d.]+", token):
            nd, vd = (number_of(part) for part in token.split(":"))
        elif re.fullmatch(r"\d{3,}\.\d+", token):
            whole, part = token.split(".")
            nd, vd = 1.0 + int(whole) / 10.0 ** len(whole), 100.0 * float(f"0.{part}")
        elif (numbers := glasses.numbers_of_code(token)) is not None:
            nd, vd = numbers
        else:
            return None
        if not 1.0 < nd < 10.0:
            card.broken(f"the glass {token} has an index of {nd:g}; write one between 1 and 10")
        return nd, vd

    def _private_glass(self, token: str) -> Any:
        card, known, values = self.private[glasses.plain(token)]
        self.reading.glasses_found[token] = f"the file's private glass: {', '.join(f'{value:g}' for value in values)}"
        if not min(values) >= 1.0 or max(values) > 10.0:
            card.broken(f"the indices are from {min(values):g} to {max(values):g}; write indices from 1 to 10")
        if len(set(values)) == 1:
            return IdealMaterial(values[0])
        used = self.header["WL"].numbers() if "WL" in self.header else []
        if used and not min(known) <= min(used) <= max(used) <= max(known):
            card.broken(f"its wavelengths (PWL) are from {min(known):g} to {max(known):g} nm, and do not cover the lens's (WL)")
        if not set(used) <= set(known):
            self.reading.remark(card, f"the private glass {token}: indices between the wavelengths of PWL are interpolated linearly")
        lines, indices = zip(*sorted(zip((line / 1000.0 for line in known), values, strict=True)), strict=True)
        return DataMaterial.from_samples(list(lines), list(indices), name=token)

    # Apertures

    def _opening(self, given: _Given, *, is_mirror: bool) -> Any:
        if not given.apertures:
            return None
        switch = self.header.get("CA")
        if switch is not None and _is_no(switch):
            self.reading.remark(given.apertures[0], "apertures are switched off (CA NO): none clips")
            return None
        sizes: dict[tuple[str, str], dict[str, Card]] = {}
        for card in given.apertures:
            kind, label, words = "CLR", "", list(card.words)
            while words and (words[0].upper() in _APERTURE_KINDS or re.fullmatch(r"""[Ll]['"].*['"]""", words[0])):
                word = words.pop(0)
                kind, label = (word.upper(), label) if word.upper() in _APERTURE_KINDS else (kind, _bare(word[1:]))
            sizes.setdefault((kind, label), {})[card.name] = Card(card.name, tuple(words), card.place)
        clear = [key for key in sizes if key[0] == "CLR"]
        if len(clear) > 1:
            next(iter(sizes[clear[1]].values())).refuse("how several clear apertures of one surface act together is not known here",
                                                        "give the surface one")
        # Where no clear aperture is stated, the edge is where the part ends.
        wanted = clear or [key for key in sizes if key[0] == "EDG"]
        opening = None
        for key in wanted:
            opening = both(opening, self._region(sizes[key]))
        for key in sizes:
            if key[0] == "HOL":
                card = next(iter(sizes[key].values()))
                hole = self._region(sizes[key])
                if not is_mirror:
                    card.refuse("a hole through glass cannot be carried", "remove it, or write an obscuration (OBS)")
                if type(hole) is not RadialAperture:
                    card.refuse("a hole that is no disk about the axis cannot be carried", "write CIR HOL, or an obscuration (OBS)")
                opening = both(opening, disk(ENDLESS, float(hole.r_max)))
            elif key[0] == "OBS":
                opening = both(opening, all_but(self._region(sizes[key])))
        return opening

    def _region(self, cards: dict[str, Card]) -> Any:
        """Return the disk, rectangle or ellipse of the commands of one aperture."""
        def length(name: str, index: int = 0, default: float = 0.0) -> float:
            return cards[name].number(index, default) * self.unit if name in cards else default

        families = [family for family, names in {"circle": ("CIR", "CIG"), "rectangle": ("REX", "REY", "REG"), "ellipse": ("ELX", "ELY", "ELG")}.items()
                    if any(name in cards for name in names)]
        some = next(iter(cards.values()))
        if len(families) != 1:
            some.broken("an aperture is a circle (CIR), a rectangle (REX, REY) or an ellipse (ELX, ELY): one of them is needed")
        family = families[0]
        general = next((name for name in ("CIG", "REG", "ELG") if name in cards), None)
        count = 1 if family == "circle" else 2
        if general is not None:
            x, y, turn = length(general, count), length(general, count + 1), cards[general].number(count + 2, 0.0)
            half = [length(general, index) for index in range(count)]
        else:
            x, y, turn = length("ADX"), length("ADY"), cards["ARO"].number(0) if "ARO" in cards else 0.0
            names = {"circle": ("CIR",), "rectangle": ("REX", "REY"), "ellipse": ("ELX", "ELY")}[family]
            half = [length(name) if name in cards else ENDLESS for name in names]
        if turn and family != "circle":
            cards[general or "ARO"].refuse("the sense in which an aperture is turned is not known here", "write it without a turn")
        if not min(half) > 0.0:
            some.broken(f"the aperture has a size of {min(half):g}; write a size above 0")
        if family == "circle":
            return disk(half[0], 0.0, x, y)
        return (rectangle if family == "rectangle" else ellipse)(half[0], half[1], x, y)


#: Ways to solve for a number.
_SOLVES = {f"{kind}{axis}" for kind in ("UM", "UC", "IM", "IC", "HM", "HC", "AP") for axis in "YX"} | {"OAL", "PIM", "PIX", "RED", "EFL", "ETH"}
#: How many words commands have, of those whose further words would be left out.
_MOST_WORDS = {**dict.fromkeys(("DAR", "BEN", "REV", "SPH", "CON", "ASP", "CYL", "XTO", "YTO", "STO"), 0),
               **dict.fromkeys(("K", *POWERS, "RDY", "CUY", "RDX", "CUX", "THI", "GLA", "RMD", "XDE", "YDE", "ZDE", "ADE", "BDE", "CDE", "EPD", "FNO",
                                "NA", "NAO", "REF", "DIM"), 1)}
#: Commands of the whole lens.
_HEADER = {"RDM", "DIM", "TIT", "WL", "WTW", "REF", *_FIELD_TYPES, "WTF", "VUX", "VLX", "VUY", "VLY", "TEL", "CA"}
