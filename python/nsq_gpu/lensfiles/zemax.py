"""Reads sequential lens files of Zemax OpticStudio (.zmx).

No public page describes the format. The meaning of each card comes from the program's help (ansyshelp.ansys.com, OpticStudio User
Guide: Coordinate Break, Toroidal, Biconic, Extended Polynomial, Aperture, Semi-Diameters), from files that the program wrote, and
from rayoptics, which reads such files as well. Where these do not settle the meaning of a card, the card is refused.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from optiland.coatings import SimpleCoating

from nsq_gpu.lensfiles import glasses
from nsq_gpu.lensfiles.cards import SAVE_WITHOUT_IT, Card, Fate, Reading, decode, one, table
from nsq_gpu.lensfiles.system import INFINITE, FileField, FileSurface, System, all_but, disk, ellipse, rectangle, tilted

#: mm a unit.
UNITS = {"MM": 1.0, "CM": 10.0, "IN": 25.4, "INCH": 25.4, "INCHES": 25.4, "METER": 1000.0, "M": 1000.0}

#: Cards before the first surface.
HEADER = table(
    carried="MODE UNIT NAME ENPD FNUM OBNA FLOA FTYP XFLN YFLN XFLD YFLD FWGN FWGT VDXN VDYN VCXN VCYN ZVDX ZVDY ZVCX ZVCY WAVM WAVL "
            "WWGT PWAV RAIM GCAT COFN",
    no_light="VERS NOTE AUTH TITL LANG LUID DBDT STUD EERA IWDP PFIL PICB HYPR OMMA SDMA ROPD GLRS GSTD NSCD FCOM DMFS BLNK TCED",
    remarked={
        "GFAC": ("the pupil's apodisation was left out: the source of a field fills the pupil uniformly",
                 lambda card: card.number(0, 0.0) == 0.0 or card.number(1, 0.0) == 0.0),
        "PUSH": ("a first guess of the pupil for aiming was left out: rays are aimed here without one", lambda card: card.is_zero),
        "ENVD": ("indices are not corrected for the air's temperature and pressure", lambda card: [*card.numbers(), 20.0, 1.0][:2] == [20.0, 1.0]),
        "POLS": ("the light's polarisation was left out: rays of a scene carry none", lambda card: card.words[:7] == tuple("1010010")),
    },
    refused={
        **dict.fromkeys(("VANN", "ZVAN"), ("vignetting that turns the pupil (its tangent angle) cannot be carried", "set it to 0",
                                           lambda card: card.is_zero)),
        "PUPD": ("the pupil's definition in this file is not known here", "save the file by a newer version"),
        "CONF": ("configurations are not known here", "save one configuration as a file of its own"),
        "WAVN": ("wavelengths in this form are not known here", "save the file by a newer version, which writes WAVM"),
        "WWGN": ("weights in this form are not known here", "save the file by a newer version, which writes WAVM"),
    })

#: Cards of a surface.
SURFACE = table(
    carried="TYPE CURV CONI DISZ GLAS STOP COMM DIAM PARM XDAT CLAP FLAP OBSC SQAP SQOB ELAP ELOB SPID OBDC COAT",
    no_light="FIMP SSID LUID HIDE MIRR SLAB POPS MEMA OEMA PPAR PZUP CRVP MAZH MAZA CHHT CHAN TCOM TOLE EDGE VCON VPAR VDSZ PKUP TCMM",
    remarked={},
    refused={
        **dict.fromkeys(("UDAP", "UDAD", "UDAO", "USAP"), ("an aperture from a file of the user cannot be carried", "use an aperture of the program's own")),
        "SCBD": ("the surface's own tilt and decenter cannot be carried", "replace them by coordinate breaks",
                 lambda card: not any(card.numbers()[1:]) and card.number(0) == 1.0),
        **dict.fromkeys(("GDAT", "GARR"), ("a surface of a grid cannot be carried", SAVE_WITHOUT_IT)),
        "SCAT": ("scattering of a surface cannot be carried", "remove it, and give a BSDF to the scene's component"),
        "NSCO": ("objects of the non-sequential mode cannot be carried", SAVE_WITHOUT_IT),
    })

# Notes and the like may stand anywhere.
SURFACE |= {name: rule for name, rule in HEADER.items() if rule.fate is Fate.NO_LIGHT}

#: Surface types that are carried.
_TYPES = {"STANDARD": "standard", "EVENASPH": "even_asphere", "ODDASPHE": "odd_asphere", "XASPHERE": "even_asphere",
          "XOSPHERE": "odd_asphere", "TOROIDAL": "toroidal", "BICONICX": "biconic", "XPOLYNOM": "polynomial"}
#: Other types, by what they are.
_REFUSED_TYPES = {"PARAXIAL": "a paraxial (perfect) lens has no glass that light could meet",
                  **dict.fromkeys(("DGRATING", "EGRATING", "VGRATING"), "a grating has no place in a scene"),
                  **dict.fromkeys(("BINARY_1", "BINARY_2"), "a diffractive surface has no place in a scene"),
                  **dict.fromkeys(("HOLOGRM1", "HOLOGRM2"), "a hologram has no place in a scene"),
                  "NONSEQCO": "objects of the non-sequential mode cannot be carried"}
#: Lists of the fields, by their cards and old names: weights, shifts and compressions of the pupil; and what stands in a missing list.
_FIELD_LISTS = {("FWGN", "FWGT"): 1.0, ("VDXN", "ZVDX"): 0.0, ("VDYN", "ZVDY"): 0.0, ("VCXN", "ZVCX"): 0.0, ("VCYN", "ZVCY"): 0.0}
#: How long a list of fields is that is filled up with zeros, and the wavelength [um] and weight that fill up the slots.
_PADDED, _EMPTY_SLOT, _SLOTS = 12, (0.55, 1.0), 24
#: The most terms that a surface with extra data has.
_MOST_TERMS = 230
#: Kinds of fields. Angles in degrees, heights in the file's unit.
_FIELDS = {0: "angle", 1: "object_height", 2: "paraxial_image_height", 3: "real_image_height"}


def read(text: str, reading: Reading) -> System:
    """Return what a file says.

    Raises:
        UnsupportedSceneError: A card is refused, with its line.
        UsageError: A card makes no sense, with its line.
    """
    header, surfaces, trailer = _cards(text, reading)
    for card in trailer:
        if card.name == "MNUM" and card.whole(0, 1) > 1:
            reading.remark(card, f"the file has {card.words[0]} configurations; the one that it was saved with is read")
        else:
            reading.passed_over[card.name] += 1
    return _Reader(reading, [card for card in header if reading.is_carried(card, HEADER, in_surface=False)],
                   [(start, [card for card in own if reading.is_carried(card, SURFACE, in_surface=True)]) for start, own in surfaces]).system()


def _cards(text: str, reading: Reading) -> tuple[list[Card], list[tuple[Card, list[Card]]], list[Card]]:
    """Return the header, the surfaces with what begins each, and what follows the surfaces."""
    header: list[Card] = []
    surfaces: list[tuple[Card, list[Card]]] = []
    trailer: list[Card] = []
    indented = False
    for line, row in enumerate(text.splitlines(), start=1):
        words = row.split()
        if not words:
            continue
        name = words[0].upper()
        if name == "SURF":
            card = reading.card(name, words[1:], line, None)
            if card.whole(0) != len(surfaces):
                card.broken(f"surface {words[1]} follows surface {len(surfaces) - 1}; surfaces are numbered from 0, without a gap")
            if trailer:
                card.broken("the surface stands behind cards that belong to no surface; indent those cards")
            surfaces.append((card, []))
        elif not surfaces:
            header.append(reading.card(name, words[1:], line, None))
        elif trailer or indented and not row[0].isspace():
            # Cards of a surface are indented; what follows the last one is not: tolerances, operands, configurations.
            if any(name in rules and rules[name].fate is Fate.CARRIED for rules in (HEADER, SURFACE)):
                reading.card(name, words[1:], line, None).broken("the card stands behind the last surface; move the card into the header, or indent "
                                                                 "the card under its surface")
            trailer.append(reading.card(name, words[1:], line, None))
        else:
            indented = indented or row[0].isspace()
            if not row[0].isspace() and name in ("TOL", "MNUM", "MOFF"):
                trailer.append(reading.card(name, words[1:], line, None))
            else:
                surfaces[-1][1].append(reading.card(name, words[1:], line, len(surfaces) - 1))
    return header, surfaces, trailer


class _Reader:
    """Makes a system of the cards that are carried."""

    def __init__(self, reading: Reading, header: list[Card], surfaces: list[tuple[Card, list[Card]]]) -> None:
        self.reading, self.header, self.surfaces = reading, header, surfaces
        self.catalogues: tuple[str, ...] = ()
        #: What is before the surface that is read.
        self.medium: Any = "air"

    @property
    def unit(self) -> float:
        return self.reading.unit

    def system(self) -> System:
        found = System()
        mode, name, unit, catalogues = (self._one(key) for key in ("MODE", "NAME", "UNIT", "GCAT"))
        if mode is not None and mode.words[:1] != ("SEQ",):
            mode.refuse(f"the mode {' '.join(mode.words)} cannot be carried", "save the lens in sequential mode")
        found.name = " ".join(name.words) or None if name is not None else None
        self.reading.read_unit("UNIT", unit, UNITS, "MM, CM, IN or METER")
        self.catalogues = catalogues.words if catalogues is not None else ()
        if not self.surfaces:
            self.reading.broken("cannot read it as a lens of Zemax: no line begins with SURF")
        self._surfaces(found)
        self._light(found)
        self._aperture(found)
        return found

    def _one(self, name: str) -> Card | None:
        return one(self.header, name)

    # The light

    def _aperture(self, found: System) -> None:
        given = [card for name in ("ENPD", "FNUM", "OBNA", "FLOA") if (card := self._one(name)) is not None]
        if len(given) > 1 and given[-1].name != "FLOA":
            given[1].broken(f"the file also states {given[0].name}; one aperture is needed")
        if not given:
            return
        found.aperture_card = card = given[-1]
        if card.name == "FLOA":
            stop = next((own for start, own in self.surfaces if one(own, "STOP")), [])
            size = one(stop, "DIAM")
            if size is None:
                card.broken("the aperture floats by the stop's size, but the stop's surface has no DIAM")
            found.aperture = ("stop_radius", size.number(0) * self.unit)
        else:
            value, flag = card.number(0), card.whole(1, 0)
            if card.name == "ENPD":
                found.aperture = ("EPD", value * self.unit)
            elif flag not in (0, 1):
                card.refuse(f"the kind {flag} of this aperture is not known", "state the diameter of the entrance pupil")
            elif card.name == "FNUM":
                found.aperture = ("working_fno" if flag else "image_fno", value)
            elif flag:
                found.aperture = ("object_cone", value)
            else:
                found.aperture = ("object_na", value)
        if not found.aperture[1] > 0.0:
            card.broken(f"an aperture of {found.aperture[1]:g} lets no light in; write a number above 0")

    def _light(self, found: System) -> None:
        kind = self._one("FTYP")
        num_fields = num_lines = None
        if kind is not None:
            number = kind.whole(0, 0)
            if number not in _FIELDS:
                kind.refuse(f"fields of kind {number} (theodolite angles, for 4) cannot be carried", "give fields as angles or heights")
            found.field_type = _FIELDS[number]
            found.is_telecentric = kind.whole(1, 0) == 1
            # Old files have no counts.
            num_fields, num_lines = (kind.whole(index, 0) or None for index in (2, 3))
            if min(num_fields or 1, num_lines or 1) < 0:
                kind.broken("a number of fields or of wavelengths is below 0")
            if kind.whole(6, 0) == 1:
                self.reading.remark(kind, "image space is afocal: the detector shows where light meets the image surface, and not angles")
        self._fields(found, num_fields)
        self._wavelengths(found, num_lines)
        aiming = self._one("RAIM")
        if aiming is not None:
            mode = aiming.whole(1 if len(aiming.words) > 1 else 0, 0)
            if mode not in (0, 1, 2):
                aiming.refuse(f"the kind {mode} of ray aiming is not known", "set ray aiming to off, paraxial or real")
            found.aims_at_stop = mode != 0
            if mode == 1:
                self.reading.remark(aiming, "rays are aimed at the paraxial size of the stop in Zemax, and at the stop itself here")

    def _fields(self, found: System, stated: int | None) -> None:
        """Read the fields; the file states how many there are, if it is no old one."""
        x, y = (self._column(f"{axis}FLN", f"{axis}FLD") for axis in "XY")
        listed = max(len(x), len(y), 1)
        count = stated or self._old_count(x, y, listed)
        if count > listed:
            self.reading.remark(self._one("FTYP"), f"the number of fields is {count}, but the lists of fields (XFLN, YFLN) end after {listed}: so many are read")
            count = listed
        lists = {names: self._column(*names) or [default] * count for names, default in _FIELD_LISTS.items()}
        for names, values in lists.items():
            if len(values) < count:
                self._card(*names).broken(f"the list ends after {len(values)} of {count} fields")
        length = self.unit if found.field_type != "angle" else 1.0
        for index in range(count):
            weight, shift_x, shift_y, narrow_x, narrow_y = (values[index] for values in lists.values())
            if weight < 0.0:
                self._card("FWGN", "FWGT").broken(f"the weight {weight:g} of field {index + 1} is below 0")
            for names, narrow in ((("VCXN", "ZVCX"), narrow_x), (("VCYN", "ZVCY"), narrow_y)):
                if not narrow < 1.0:
                    self._card(*names).broken(f"{narrow:g} closes the pupil of field {index + 1}; numbers below 1 leave it open")
            place = [length * values[index] if index < len(values) else 0.0 for values in (x, y)]
            found.fields.append(FileField(place[0], place[1], weight, (narrow_x, narrow_y), (shift_x, shift_y)))

    def _old_count(self, x: list[float], y: list[float], listed: int) -> int:
        """Return how many fields a file without a count has: lists of twelve are filled up with zeros."""
        if listed != _PADDED:
            return listed

        def is_empty(index: int) -> bool:
            return all(index >= len(values) or values[index] == 0.0 for values in (x, y))

        while listed > 1 and is_empty(listed - 1):
            listed -= 1
        return listed

    def _card(self, *names: str) -> Card | None:
        """Return the card of the first of these names that the file has."""
        return next((card for name in names if (card := self._one(name)) is not None), None)

    def _column(self, *names: str) -> list[float]:
        card = self._card(*names)
        return card.numbers() if card is not None else []

    def _wavelengths(self, found: System, count: int | None) -> None:
        listed, weights, primary = self._one("WAVL"), self._one("WWGT"), self._one("PWAV")
        slots: dict[int, tuple[float, float]] = {}
        cards: dict[int, Card] = {}
        if listed is not None:
            heavy = weights.numbers() if weights is not None else [1.0] * len(listed.words)
            if len(heavy) != len(listed.words):
                weights.broken(f"{len(heavy)} weights stand for {len(listed.words)} wavelengths (WAVL)")
            slots = {index + 1: (value, heavy[index]) for index, value in enumerate(listed.numbers())}
            cards = dict.fromkeys(slots, listed)
        for card in (card for card in self.header if card.name == "WAVM"):
            slot, value = card.whole(0), (card.number(1), card.number(2, 1.0))
            if slots.get(slot, value) != value:
                card.broken(f"wavelength {slot} stands here a second time")
            slots[slot], cards[slot] = value, card
        if count is None and len(slots) == _SLOTS:
            # A file without a count fills up its slots.
            while len(slots) > 1 and slots[max(slots)] == _EMPTY_SLOT:
                del slots[max(slots)]
        used = [slot for slot in sorted(slots) if count is None or 1 <= slot <= count]
        if used and count is not None and len(used) < count:
            self.reading.remark(cards[used[-1]], f"the number of wavelengths (FTYP) is {count}, but only {len(used)} are stated")
        for slot in used:
            if not 0.05 <= slots[slot][0] <= 100.0 or slots[slot][1] < 0.0:
                cards[slot].broken(f"wavelength {slot} is {slots[slot][0]:g} um with a weight of {slots[slot][1]:g}; wavelengths are from 0.05 to "
                                   "100 um, weights at least 0")
        if used and not any(slots[slot][1] for slot in used):
            cards[used[0]].broken("all wavelengths have a weight of 0")
        found.wavelengths = [slots[slot] for slot in used]
        number = primary.whole(0) if primary is not None else 1
        if primary is not None and number not in used:
            primary.broken(f"wavelength {number} is the primary one, but is none of the file's")
        found.primary = used.index(number) if number in used else 0

    # Surfaces

    def _surfaces(self, found: System) -> None:
        position, rotation = np.zeros(3), np.eye(3)
        breaks: list[Card] = []
        for number, (start, own) in enumerate(self.surfaces):
            kind = one(own, "TYPE")
            name = kind.words[0].upper() if kind is not None and kind.words else "STANDARD"
            thickness = self._thickness(own)
            if name == "COORDBRK":
                if number in (0, len(self.surfaces) - 1):
                    start.broken("a coordinate break cannot be the object or the image")
                if not math.isfinite(thickness):
                    start.broken("the thickness of a coordinate break is infinite")
                for card in own:
                    trivial = card.name in ("TYPE", "DISZ", "PARM", "COMM", "DIAM") or card.name in ("CURV", "CONI") and card.number(0) == 0.0
                    if not trivial:
                        card.broken("a coordinate break is no surface: it has no stop, shape, glass, aperture or coating; give it to a surface")
                parms = self._parms(own)
                shift = np.array([parms.pop(1, 0.0) * self.unit, parms.pop(2, 0.0) * self.unit, 0.0])
                angles = [parms.pop(index, 0.0) for index in (3, 4, 5)]
                reverse = parms.pop(6, 0.0) != 0.0
                self._refuse_rest(own, "PARM", parms, "a coordinate break")
                breaks += [Card("COORDBRK", card.words, card.place) for card in own if card.name == "PARM"]
                turned = tilted(angles, reverse=reverse)
                position = position + rotation @ (turned @ shift if reverse else shift)
                rotation = rotation @ turned
                position = position + rotation[:, 2] * thickness
                continue
            surface = self._surface(start, own, name, kind, number)
            surface.thickness = thickness
            self.reading.cards[len(found.surfaces)], breaks = [*breaks, *own], []
            if number == 0:
                if one(own, "DISZ") is None:
                    start.broken("the object has no distance (DISZ)")
                surface.position = np.array([0.0, 0.0, -thickness])
            else:
                surface.position, surface.rotation = position, rotation
                if math.isfinite(thickness):
                    position = position + rotation[:, 2] * thickness
            found.surfaces.append(surface)
        stops = [surface for surface in found.surfaces if surface.is_stop]
        if len(stops) > 1:
            stops[1].card.broken("a second surface is the stop (STOP); one is needed")
        if stops and stops[0] in (found.surfaces[0], found.surfaces[-1]):
            stops[0].card.broken("the object or the image is the stop (STOP); another surface must be")
        if not stops:
            self.reading.remark(None, "no surface is the stop (STOP): surface 1 is taken")
            if len(found.surfaces) > 1:
                found.surfaces[1].is_stop = True

    def _thickness(self, own: list[Card]) -> float:
        card = one(own, "DISZ")
        if card is None:
            return 0.0
        if card.words[:1] and card.words[0].upper() in ("INFINITY", "INF"):
            return math.inf
        value = card.number(0)
        return math.copysign(math.inf, value) if abs(value) >= INFINITE else value * self.unit

    def _surface(self, start: Card, own: list[Card], name: str, kind: Card | None, number: int) -> FileSurface:
        if name not in _TYPES:
            what = _REFUSED_TYPES.get(name, f"the surface type {name} cannot be carried")
            (kind or start).refuse(what, f"types that can be carried: {', '.join(_TYPES)}, COORDBRK")
        comment = one(own, "COMM")
        found = FileSurface(start, number, " ".join(comment.words) if comment is not None else "", _TYPES[name])
        curvature, conic = (one(own, key) for key in ("CURV", "CONI"))
        c = curvature.number(0) if curvature is not None else 0.0
        radius = self.unit / c if c else math.inf
        k = conic.number(0) if conic is not None else 0.0
        parms, extra = self._parms(own), self._indexed(own, "XDAT", "extra data value")
        found.shape, found.numbers = self._shape(own, name, radius, k, parms, extra)
        found.is_stop = one(own, "STOP") is not None
        found.material = self._material(own)
        found.aperture = self._surface_aperture(own, has_power=found.material == "mirror" or found.material is not self.medium)
        self.medium = found.material if found.material != "mirror" else self.medium
        found.coating = self._coating(own, is_mirror=found.material == "mirror")
        return found

    def _parms(self, own: list[Card]) -> dict[int, float]:
        """Return the parameters that are not 0."""
        # Parameter 0 says how a form goes on beyond its norm.
        return {index: value for index, value in self._indexed(own, "PARM", "parameter").items() if value != 0.0 and index != 0}

    def _indexed(self, own: list[Card], name: str, what: str) -> dict[int, float]:
        """Return the numbers of cards of a name, such as PARM 1 0.5, by their index."""
        found: dict[int, float] = {}
        for card in (card for card in own if card.name == name):
            index, value = card.whole(0), card.number(1)
            if index in found and found[index] != value:
                card.broken(f"{what} {index} stands here a second time")
            found[index] = value
        return found

    def _refuse_rest(self, own: list[Card], name: str, rest: dict[int, float], what: str) -> None:
        if rest:
            index = min(rest)
            card = next(card for card in own if card.name == name and card.whole(0) == index)
            card.refuse(f"parameter {index} of {what} is {rest[index]:g}, which cannot be carried", "set it to 0")

    def _shape(self, own: list[Card], name: str, radius: float, k: float, parms: dict[int, float],
               extra: dict[int, float]) -> tuple[str, dict[str, Any]]:
        base = {"radius": radius, "conic": k}
        parms = dict(parms)

        def series(count: int, step: int, first: int = 1) -> list[float]:
            """Return coefficients of powers of a length [mm], of parameters that stand for powers step, 2 step, ..."""
            values = [parms.pop(first + index, 0.0) for index in range(count)]
            return [value * self.unit ** (1 - step * (index + 1)) for index, value in enumerate(values)]

        if name == "STANDARD":
            found: tuple[str, dict[str, Any]] = ("standard", base)
        elif name in ("EVENASPH", "ODDASPHE"):
            found = (_TYPES[name], {**base, "coefficients": series(8, 2 if name == "EVENASPH" else 1)})
        elif name in ("XASPHERE", "XOSPHERE"):
            found = (_TYPES[name], {**base, "coefficients": self._extended(own, extra, 2 if name == "XASPHERE" else 1)})
        elif name == "TOROIDAL":
            # Parameter 1 is the radius of rotation, and 0 one without an end; the others are of y^2, y^4, ...
            turned = parms.pop(1, 0.0) * self.unit or math.inf
            if extra.get(1, 0.0) != 0.0:
                self._refuse_rest(own, "XDAT", {1: extra[1]}, "a toroid with terms of Zernike")
            found = ("toroidal", {"radius_y": radius, "radius_x": turned, "conic": k, "toroidal_coeffs_poly_y": series(7, 2, 2)})
        elif name == "BICONICX":
            found = self._biconic(own, radius, k, parms.pop(1, 0.0) * self.unit or math.inf, parms.pop(2, 0.0))
        else:
            found = ("polynomial", {**base, "coefficients": self._polynomial(own, extra)})
        self._refuse_rest(own, "PARM", parms, name)
        return found

    def _biconic(self, own: list[Card], radius: float, k: float, radius_x: float, k_x: float) -> tuple[str, dict[str, Any]]:
        # Zemax has one root for both directions, and Optiland one for each: they agree where one direction is straight.
        if radius_x == radius and k_x == k:
            return "standard", {"radius": radius, "conic": k}
        if math.isfinite(radius) and math.isfinite(radius_x):
            one(own, "TYPE").refuse("a biconic that is curved in both directions has another form in Optiland than in Zemax",
                                    "write it as a toroid, or as an extended polynomial")
        return "biconic", {"radius_x": radius_x, "radius_y": radius, "conic_x": k_x, "conic_y": k}

    def _norm(self, own: list[Card], extra: dict[int, float]) -> tuple[int, float]:
        """Return how many extended terms there are, and what lengths are divided by [mm]."""
        card = next((card for card in own if card.name == "XDAT" and card.whole(0) == 1), None)
        count = card.whole(1) if card is not None else 0
        if not 0 <= count <= _MOST_TERMS:
            card.broken(f"{count} terms; from 0 to {_MOST_TERMS} can be")
        norm = extra.get(2, 0.0) * self.unit
        if count > 0 and norm == 0.0:
            next(card for card in own if card.name in ("XDAT", "TYPE")).broken("the normalisation radius (XDAT 2) is 0")
        return count, norm or 1.0

    def _extended(self, own: list[Card], extra: dict[int, float], step: int) -> list[float]:
        count, norm = self._norm(own, extra)
        return [extra.get(index + 3, 0.0) * self.unit / norm ** (step * (index + 1)) for index in range(count)]

    def _polynomial(self, own: list[Card], extra: dict[int, float]) -> list[list[float]]:
        """Return coefficients of x^i y^j. Terms stand in the order x, y, x^2, x y, y^2, x^3, ..."""
        count, norm = self._norm(own, extra)
        terms = [(degree - j, j) for degree in range(1, 22) for j in range(degree + 1)][:count]
        size = max((i + j for i, j in terms), default=0) + 1
        found = [[0.0] * size for _ in range(size)]
        for index, (i, j) in enumerate(terms):
            found[i][j] = extra.get(index + 3, 0.0) * self.unit / norm ** (i + j)
        return found

    def _material(self, own: list[Card]) -> Any:
        card = one(own, "GLAS")
        if card is None:
            return "air"
        if not card.words:
            card.broken("the glass has no name")
        name = card.words[0].upper() if card.words[0].upper() in ("MIRROR", "___BLANK") else card.words[0]
        if name == "MIRROR":
            return "mirror"
        # Old files have the name, nd and Vd; newer ones a solve and its surface between.
        is_short = len(card.words) == 3 and "." in card.words[1]
        code = 0 if is_short else card.whole(1, 0)
        nd, vd = (card.number(1), card.number(2)) if is_short else (card.number(3, 0.0), card.number(4, 0.0))
        if name == "___BLANK":
            if not 1.0 <= nd <= 10.0:
                card.broken(f"a model glass has an index of {nd:g}; write one from 1 to 10")
            if card.number(5, 0.0) != 0.0:
                self.reading.remark(card, f"a model glass of nd = {nd:.6g}, Vd = {vd:.5g}: its dPgF is left out, and dispersion is Optiland's "
                                    "model of Buchdahl")
            elif glasses.has_dispersion(vd):
                self.reading.remark(card, f"a model glass of nd = {nd:.6g}, Vd = {vd:.5g}: dispersion is Optiland's model of Buchdahl")
            return glasses.model(nd, vd)
        if code == 4 and any(card.number(index, 0.0) for index in (9, 10)):
            card.refuse("an offset of a glass's nd or Vd cannot be carried", "set the offsets to 0, or write a model glass")
        if code not in (0, 1, 2, 4):
            card.refuse(f"the kind {code} of this glass is not known", "fix the glass")
        numbers = glasses.numbers_of_code(name)
        if numbers is not None:
            nd, vd = numbers
            self.reading.remark(card, f"the code {name} is taken as nd = {nd:.3f}, Vd = {vd:.1f}, and Optiland's model of Buchdahl")
            return glasses.model(nd, vd)
        return glasses.find(self.reading, card, name, self.catalogues, nd, vd)

    def _surface_aperture(self, own: list[Card], *, has_power: bool) -> Any:
        kinds = [card for card in own if card.name in ("CLAP", "FLAP", "OBSC", "SQAP", "SQOB", "ELAP", "ELOB", "SPID")]
        if len({card.name for card in kinds}) > 1:
            kinds[1].broken(f"the surface also has {kinds[0].name}; Zemax gives a surface one aperture")
        card = one(own, kinds[0].name) if kinds else None
        moved = one(own, "OBDC")
        x, y = (moved.number(index, 0.0) * self.unit for index in (0, 1)) if moved is not None else (0.0, 0.0)
        size = one(own, "DIAM")
        if card is None:
            # A diameter that the user fixed on a surface with power is an aperture ("floating").
            if size is not None and size.whole(1, 0) == 1 and has_power and size.number(0) > 0.0:
                return disk(size.number(0) * self.unit, x=x, y=y)
            return None
        if any(card.numbers()[2:]) and card.name != "SPID":
            card.refuse(f"a third number ({card.words[2]}) of an aperture is not known here", "set it to 0")
        one_, other = card.number(0) * self.unit, card.number(1) * self.unit
        if card.name == "SPID":
            return self._spider(card, x, y)
        if card.name in ("CLAP", "OBSC") and not 0.0 <= one_ < other or card.name == "FLAP" and not other > 0.0:
            card.broken(f"the radii {card.words[0]} and {card.words[1]} enclose nothing; the smaller one stands first")
        if card.name in ("SQAP", "SQOB", "ELAP", "ELOB") and not min(one_, other) > 0.0:
            card.broken(f"the half-widths are {card.words[0]} and {card.words[1]}; write numbers above 0")
        if card.name in ("SQAP", "SQOB"):
            shape = rectangle(one_, other, x, y)
        elif card.name in ("ELAP", "ELOB"):
            shape = ellipse(one_, other, x, y)
        else:
            shape = disk(other, 0.0 if card.name == "FLAP" else one_, x, y)
        return all_but(shape) if card.name in ("OBSC", "SQOB", "ELOB") else shape

    def _spider(self, card: Card, x: float, y: float) -> Any:
        """Return what a spider of arms from the middle outward lets through: the first along +x."""
        given = [card.number(index) for index in (0, 1)]
        whole = [value == int(value) and value > 0.0 for value in given]
        if whole[0] == whole[1]:
            card.refuse(f"files have the width of a spider's arms first, or the number of arms first, and {card.words[0]} and {card.words[1]} do not say which "
                        "is the number", "write a width that is no whole number, such as 2.0001, and a number that is one")
        count, width = (int(given[0]), given[1]) if whole[0] else (int(given[1]), given[0])
        if count > 64 or not width > 0.0:
            card.broken(f"{count} arms of a width of {width:g}; up to 64 arms with a width above 0 can be carried")
        length = 1e5
        arms = [rectangle(0.5 * length, 0.5 * width * self.unit, x + 0.5 * length * math.cos(turn), y + 0.5 * length * math.sin(turn),
                          math.degrees(turn)) for turn in (2.0 * math.pi * index / count for index in range(count))]
        while len(arms) > 1:
            arms = [arms[index] | arms[index + 1] if index + 1 < len(arms) else arms[index] for index in range(0, len(arms), 2)]
        return all_but(arms[0])

    # Coatings

    def _coating(self, own: list[Card], *, is_mirror: bool) -> Any:
        card = one(own, "COAT")
        if card is None or not card.words or card.words[0].upper() in ("NONE", "NULL"):
            return None
        name = card.words[0]
        if name.upper() in self.reading.coatings:
            return self.reading.coatings[name.upper()]
        if name.upper() in self._ideal_coatings:
            return SimpleCoating(*self._ideal_coatings[name.upper()])
        does = "the mirror reflects all light" if is_mirror else "the face is bare, and reflects by Fresnel's law"
        self.reading.remark(card, f"the coating {name} is not at hand: {does}; give "
                            f'coatings={{"{name}": a coating of Optiland}}, or put the file of coatings beside the lens')
        return None

    @cached_property
    def _ideal_coatings(self) -> dict[str, tuple[float, float]]:
        """Return T and R of the ideal coatings in the lens's file of coatings, where it lies beside the lens."""
        found: dict[str, tuple[float, float]] = {}
        path = self._coating_file()
        for line, row in enumerate(decode(path).splitlines() if path is not None else [], start=1):
            words = row.split()
            if words[:1] and words[0].upper() == "IDEAL":
                card = Card("IDEAL", tuple(words[1:]), f"{path.name}:{line}: IDEAL")
                transmittance, reflectance = card.number(1), card.number(2)
                if min(transmittance, reflectance) < 0.0 or transmittance + reflectance > 1.0 + 1e-9:
                    card.broken(f"T = {transmittance:g} and R = {reflectance:g} are no shares of light: both are at least 0, and their sum at most 1")
                found[card.words[0].upper()] = (transmittance, reflectance)
        return found

    def _coating_file(self) -> Path | None:
        """Return the first file of coatings that the header names and that lies beside the lens."""
        words = [word.strip('"') for card in self.header if card.name == "COFN" for word in card.words]
        paths = (self.reading.path.parent / word for word in words if word.upper().endswith(".DAT"))
        return next((path for path in paths if path.is_file()), None)
