"""Reads lens files of OSLO (.len).

The cards are checked here, with a table; Optiland's reader, which follows OSLO's Program Reference and Optics Reference, then reads
them. Names of glasses are looked up here, and what Optiland's reader leaves out is refused.
"""

from __future__ import annotations

import os
import re
import tempfile
import warnings
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.fileio.oslo.reader.converter import OsloToOpticConverter
from optiland.fileio.oslo.reader.parser import OsloDataParser
from optiland.fileio.oslo.syntax import tokenize

from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.lensfiles import glasses
from nsq_gpu.lensfiles.cards import SAVE_WITHOUT_IT, Card, Fate, Reading, number_of, table

#: Cards before END.
CARDS = table(
    carried="LEN EBR OBH ANG GIH UNI AIR RFL RFH AIF GLA GLF RD RDF CV CVF CVX RDX TH THF AP APF APCK ASP AST CC AD AE AF AG DCX DCY DCZ DT GC "
            "RCO BEN TOX TOY TOZ TLA TLB TLC WV WW NXT GTO END PY PYC PU PUC EC PK FNO NAO NAP PUK TELE LMO ATD CXD APD GCD RCD BED "
            "PFD TDD CSD TSD",
    no_light="DES NOT SNO TCE DRW LDP CBK ELMDF1 ELMDF2 BDI BDD VX PF LMN LME",
    remarked={},
    refused={
        **dict.fromkeys(("APN", "ATP"), ("special apertures cannot be carried", "write a circular aperture (AP CHK)")),
        "DFR": ("a diffractive surface has no place in a scene", SAVE_WITHOUT_IT),
        "DOE": ("a diffractive surface has no place in a scene", SAVE_WITHOUT_IT),
        "HOR": ("a hologram has no place in a scene", SAVE_WITHOUT_IT),
        "GSP": ("a grating has no place in a scene", SAVE_WITHOUT_IT),
        "GOR": ("a grating has no place in a scene", SAVE_WITHOUT_IT, lambda card: card.is_zero),
        **dict.fromkeys(("PFL", "PFM"), ("a perfect lens has no glass that light could meet", SAVE_WITHOUT_IT)),
        **dict.fromkeys(("GRC", "GDT"), ("a gradient index cannot be carried", SAVE_WITHOUT_IT)),
        "ARY": ("arrays of lenses cannot be carried", SAVE_WITHOUT_IT),
        "COT": ("coatings of OSLO's table are not known here", "remove it, and give a coating to the scene's component"),
    })
#: What Optiland's reader leaves out and only remarks: other configurations than the first.
_FOOTER = {"CFG", "LEN", "CSLV"}


def read(text: str, reading: Reading) -> Any:
    """Return Optiland's Optic of a file.

    Raises:
        UnsupportedSceneError: A card is refused, with its line.
        UsageError: A card makes no sense.
    """
    materials = {name: glasses.find(reading, card, name) for name, card in _check(text, reading).items()}
    # Optiland reads files alone: this one is in UTF-8, whatever the user's is in.
    handle, path = tempfile.mkstemp(suffix=".len")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            data = OsloDataParser(path).parse()
            _check_left_out(data, reading)
            _check_light(data, reading)
            optic = OsloToOpticConverter(data, material_overrides=materials).convert()
    except NsqGpuError:
        raise
    except (ValueError, RuntimeError, ArithmeticError, LookupError) as error:
        raise UsageError(f"{reading.path.name}: cannot read it as a lens of OSLO: {str(error).replace(path, reading.path.name)}") from error
    finally:
        os.unlink(path)
    for index, surface in enumerate(optic.surfaces.surfaces[1:], start=1):
        if not np.isfinite(be.to_numpy(surface.geometry.cs.z)).all():
            reading.broken(f"cannot read it as a lens of OSLO: the thickness before surface {index} is infinite; only the object's "
                           "may be")
    reading.remarks += sorted({str(warning.message).replace(path, reading.path.name) for warning in heard
                               if "import may be incomplete" not in str(warning.message)})
    if data.units != 1.0:
        reading.remark(None, f"lengths are multiplied by {data.units:g} (UNI), since a scene is in mm")
    for surface, what in ((optic.surfaces.surfaces[0], "object"), (optic.surfaces.surfaces[-1], "image")):
        if surface.aperture is not None:
            reading.remark(None, f"the {what}'s aperture was left out")
            surface.aperture = None
    return optic


def _check_light(data: Any, reading: Reading) -> None:
    """Refuse a file without an aperture; say what else the file leaves to the reader."""
    if not data.aperture:
        reading.broken("cannot read it as a lens of OSLO: it states no aperture, such as EBR")
    if not data.fields:
        reading.remark(None, "no field is stated: light comes along the axis")
    elif "points" not in data.fields:
        reading.remark(None, "the file states the largest field alone; fields at 0, 0.7 and 1 times that are traced")
    if not any("AST" in surface for surface in data.surfaces.values()):
        reading.remark(None, "no surface is the stop (AST): surface 1 is taken")


def _check_left_out(data: Any, reading: Reading) -> None:
    """Refuse what Optiland's reader leaves out; the first configuration is the lens."""
    for found in data.diagnostics:
        if found.message == "unsupported command":
            # Unknown cards were seen to already.
            continue
        card = reading.card(found.command, (), found.line, found.surface)
        if found.command in _FOOTER:
            reading.remark(card, f"{found.message}: the first configuration is read")
        elif reading.unknown == "remark":
            reading.remark(card, f"{found.message}; it was left out")
        else:
            card.refuse(found.message, 'remove it, or leave it out by unknown="remark" (--unknown remark)')


def _check(text: str, reading: Reading) -> dict[str, Card]:
    """Apply the table to every card before END; return the first card of each glass that is named."""
    surface = 0
    ended = has_lines = False
    named: dict[str, Card] = {}
    for line, row in enumerate(text.splitlines(), start=1):
        row = re.sub(r'("(?:\\.|[^"\\])*")|//.*', lambda found: found.group(1) or "", row)
        for part in re.findall(r'(?:"(?:\\.|[^"\\])*"|[^;"]|")+', row):
            words = tokenize(part)
            if not words:
                continue
            name = words[0].upper()
            card = reading.card(re.sub(r"^(W[VW]|AS|SNO)\d+$", r"\1", name), words[1:], line, surface)
            if card.name == "AS":
                continue
            if ended:
                # Tables of fields and of configurations, and commands that no lens needs.
                if CARDS.get(card.name, CARDS["DES"]).fate is Fate.CARRIED and card.name not in ("TH", "WV", "WW", "END", "LEN"):
                    reading.remark(card, "the card stands behind END, and was left out")
                continue
            # Lens data and the object's are mixed.
            if not reading.is_carried(card, CARDS, in_surface=surface > 0):
                continue
            reading.cards.setdefault(surface, []).append(card)
            if name == "NXT":
                surface += 1
            elif name == "GTO" and card.words:
                surface = card.whole(0)
            elif name in ("RFL", "RFH") and surface == 0:
                card.broken("the object is a mirror; a surface behind it must be")
            elif name == "END":
                ended = True
            elif card.name == "WV":
                has_lines = True
            elif name in ("GLA", "GLF"):
                _check_glass(card, named)
    if not has_lines:
        reading.remark(None, "no wavelength (WV) is stated: OSLO's own are taken")
    return named


def _check_glass(card: Card, named: dict[str, Card]) -> None:
    """Keep the card of a glass that is named, and refuse an index that no glass has."""
    words = [word for word in card.words if word.upper() != "MOD"]
    indices = []
    for word in words:
        try:
            indices.append(number_of(word))
        except ValueError:
            continue
    # Two numbers of a model are its index and Abbe number.
    checked = indices[:1] if len(words) < len(card.words) and len(indices) == 2 else indices
    if not all(1.0 <= index <= 10.0 for index in checked):
        card.broken(f"an index of the glass is {max(checked, key=lambda index: abs(index - 1.5)):g}; write an index from 1 to 10")
    if len(card.words) == 1 and not indices and card.words[0].strip('"').casefold() not in {name.casefold() for name in named}:
        named[card.words[0].strip('"')] = card

