"""Which cards of a lens file a part of a scene comes from."""

from __future__ import annotations

import re

from nsq_gpu.lensfiles.cards import Card, Reading, number_of

#: By the kind of a part, the names of the cards that may state it, in all formats.
_NAMES = {
    "shape": "TYPE CONI PARM XDAT K A B C D E F G H J SPH CON ASP CYL XTO YTO RDX CUX CC AD AE AF AG CVX",
    "decentre": "COORDBRK XDE YDE ZDE ADE BDE CDE DAR BEN REV DCX DCY DCZ TLA TLB TLC TOX TOY TOZ DT RCO BED RCD TDD",
    "tilt": "COORDBRK ADE BDE CDE DAR BEN REV TLA TLB TLC DT RCO BED RCD TDD",
    "coating": "COAT",
    "aperture": "CLAP FLAP OBSC SQAP SQOB ELAP ELOB SPID OBDC DIAM CIR REX REY ELX ELY CIG REG ELG ADX ADY ARO AP APF "
                "APCK",
}
#: A frame is handed on from surface to surface.
_HANDED_ON = ("decentre", "tilt")


def origins(reading: Reading, index: int, kind: str) -> tuple[str, ...]:
    """Return the places of the cards that a part of a surface comes from, as ``lens.zmx:14: PARM``.

    Of a frame they are the places in the last surface up to this one that states one.
    """
    names = set(_NAMES[kind].split())
    found: list[Card] = []
    for known in range(index, -1 if kind in _HANDED_ON else index - 1, -1):
        found = [card for card in reading.cards.get(known, ()) if card.name in names and not _is_zero(card)]
        if found:
            break
    return tuple(re.sub(r": surface \w+: ", ": ", card.place) for card in found)


def _is_zero(card: Card) -> bool:
    """Return whether a card states nothing but zeros, or the plain type."""
    if card.name == "TYPE":
        return [word.upper() for word in card.words] == ["STANDARD"]
    # Of a parameter the first word is its place.
    values = card.words[1:2] if card.name in ("PARM", "XDAT", "COORDBRK") else card.words
    try:
        return bool(values) and not any(map(number_of, values))
    except ValueError:
        return False
