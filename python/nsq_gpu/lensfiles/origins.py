"""Which cards of a lens file a part of a scene comes from."""

from __future__ import annotations

import re

from nsq_gpu.lensfiles.cards import Card, Reading, number_of

#: By the kind of a part, the names of the cards that may state it, in all formats.
_NAMES = {
    "shape": "TYPE CONI PARM XDAT K A B C D E F G H J SPH CON ASP CYL XTO YTO RDX CUX CC AD AE AF AG CVX RCO",
    "decentre": "COORDBRK XDE YDE ZDE DAR BEN REV DCX DCY DCZ DT",
    "tilt": "COORDBRK ADE BDE CDE DAR BEN REV TLA TLB TLC DT",
    "coating": "COAT",
    "aperture": "CLAP FLAP OBSC SQAP SQOB ELAP ELOB SPID OBDC DIAM CIR REX REY ELX ELY CIG REG ELG ADX ADY ARO AP APF APCK",
}
#: A frame is handed on from surface to surface.
_HANDED_ON = ("decentre", "tilt")


def origins(reading: Reading, index: int, kind: str) -> tuple[str, ...]:
    """Return the places of the cards that a part of a surface comes from, as ``lens.zmx:14: PARM``.

    Of a frame they are those of the last surface up to this one that states one.
    """
    names = set(_NAMES[kind].split())
    found: list[Card] = []
    for known in range(index, -1 if kind in _HANDED_ON else index - 1, -1):
        found = [card for card in reading.cards.get(known, ()) if card.name in names and not _is_zero(card)]
        if found:
            break
    return tuple(re.sub(r": surface \w+: ", ": ", card.place) for card in found)


def _is_zero(card: Card) -> bool:
    """Tell whether a card states the number 0, or the plain type."""
    try:
        return bool(card.words) and (card.words[-1].upper() == "STANDARD" or number_of(card.words[-1]) == 0.0)
    except ValueError:
        return False
