"""The cards of a lens file: what each line says, where it stands, and what becomes of it.

A file of Zemax, CODE V or OSLO is a list of cards: a name, and words behind it. ``CURV 0.02`` is a card. Each format has a table
of the cards that it knows, with a :class:`Rule` for each. No card is passed over in silence.
"""

from __future__ import annotations

import difflib
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, NoReturn

from nsq_gpu.errors import UnsupportedSceneError, UsageError


#: What to do with a card that no scene can carry.
SAVE_WITHOUT_IT = "save the lens without it, or trace it in the program that wrote it"


class Fate(Enum):
    """What becomes of a card."""

    #: Its numbers decide what the scene is.
    CARRIED = "carried"
    #: It says nothing of the light: it belongs to the user interface, to tolerances or to an optimisation.
    NO_LIGHT = "without meaning for light"
    #: It may change the light, and is left out: the report says so.
    REMARKED = "remarked"
    #: It changes the light, and no scene can carry it.
    REFUSED = "refused"


@dataclass(frozen=True)
class Rule:
    """What becomes of the cards of one name."""

    fate: Fate
    #: What the card is; the report or the error says it.
    what: str = ""
    #: What the user can do where the card is refused.
    cure: str = ""
    #: True of words that make the card say nothing: such a card is passed over.
    says_nothing: Callable[[Card], bool] | None = None


def table(carried: str, no_light: str, remarked: Mapping[str, Any], refused: Mapping[str, Any]) -> dict[str, Rule]:
    """Return a table of cards.

    Args:
        carried: Names of cards that are carried.
        no_light: Names of cards without meaning for light.
        remarked: By name, what a card is; or that and what makes it say nothing.
        refused: By name, what a card is and the cure; or those two and what makes it say nothing.
    """
    found = {name: Rule(Fate.CARRIED) for name in carried.split()}
    found |= {name: Rule(Fate.NO_LIGHT) for name in no_light.split()}
    for name, given in remarked.items():
        what, says_nothing = (given, None) if isinstance(given, str) else given
        found[name] = Rule(Fate.REMARKED, what, "", says_nothing)
    for name, (what, cure, *says_nothing) in refused.items():
        found[name] = Rule(Fate.REFUSED, what, cure, *says_nothing)
    return found


def number_of(word: str) -> float:
    """Return the number that a word is: also with a decimal comma, or with Fortran's D before the exponent.

    Raises:
        ValueError: The word is no number, or no finite one.
    """
    if "_" in word:
        raise ValueError(word)
    value = float((word.replace(",", ".") if word.count(",") == 1 and "." not in word else word).upper().replace("D", "E"))
    if not math.isfinite(value):
        raise ValueError(word)
    return value


@dataclass(frozen=True)
class Card:
    """One card of a file."""

    name: str
    words: tuple[str, ...]
    #: What errors call it: the file, the line, the surface and the name.
    place: str

    def number(self, index: int, default: float | None = None) -> float:
        """Return a word as a number; the default where the card ends before.

        Raises:
            UsageError: The word is no number, or is missing.
        """
        if index >= len(self.words):
            if default is None:
                raise UsageError(f"{self.place}: word {index + 1} after the name is missing; a number is needed there")
            return default
        try:
            return number_of(self.words[index])
        except ValueError:
            raise UsageError(f"{self.place}: {self.words[index]!r} is no finite number; write one such as 12.5") from None

    def whole(self, index: int, default: int | None = None) -> int:
        """Return a word as a whole number."""
        value = self.number(index, default)
        if value != int(value):
            raise UsageError(f"{self.place}: {self.words[index]} is not a whole number; write one such as 2")
        return int(value)

    def numbers(self) -> list[float]:
        """Return all words as numbers."""
        return [self.number(index) for index in range(len(self.words))]

    def only(self, count: int) -> None:
        """Refuse the card where it has more words than that, which would be left out.

        Raises:
            UsageError: There are more.
        """
        if len(self.words) > count:
            raise UsageError(f"{self.place}: the card has {len(self.words)} values, but takes {count}; remove {' '.join(self.words[count:])!r}")

    @property
    def is_zero(self) -> bool:
        """Return whether all its words are zeros."""
        return not any(self.numbers())

    def refuse(self, what: str, cure: str) -> NoReturn:
        """Refuse the file for this card."""
        raise UnsupportedSceneError(f"{self.place}: {what}; {cure}")

    def broken(self, what: str) -> NoReturn:
        """Refuse the file because the card makes no sense."""
        raise UsageError(f"{self.place}: {what}")


@dataclass
class Reading:
    """A lens file while it is read, and what is to be said of it."""

    path: Path
    #: What becomes of an unknown card of a surface: "refuse" or "remark".
    unknown: str = "refuse"
    #: Materials that the user gives, by the plain names of glasses (:func:`nsq_gpu.lensfiles.glasses.plain`).
    glasses: Mapping[str, Any] = field(default_factory=dict)
    #: Coatings that the user gives, by names in upper case.
    coatings: Mapping[str, Any] = field(default_factory=dict)
    #: mm a unit of the file.
    unit: float = 1.0
    remarks: list[str] = field(default_factory=list)
    #: How often each card without meaning for light occurs.
    passed_over: Counter[str] = field(default_factory=Counter)
    #: Cards of each surface of the Optic, with the cards of the coordinate breaks before it.
    cards: dict[int, list[Card]] = field(default_factory=dict)
    #: What each glass of the file was taken for.
    glasses_found: dict[str, str] = field(default_factory=dict)

    def card(self, name: str, words: Iterable[str], line: int, surface: int | None) -> Card:
        """Return a card of this file."""
        where = "" if surface is None else f"surface {surface}: "
        return Card(name, tuple(words), f"{self.path.name}:{line}: {where}{name}")

    def remark(self, card: Card | None, text: str) -> None:
        """Keep what the user should know of a card, or of the file as a whole."""
        self.remarks.append(f"{self.path.name if card is None else card.place}: {text}")

    def broken(self, what: str) -> NoReturn:
        """Refuse the file because it makes no sense as a whole."""
        raise UsageError(f"{self.path.name}: {what}")

    def read_unit(self, name: str, card: Card | None, units: Mapping[str, float], choices: str) -> None:
        """Keep how many mm a unit of the file is: 1, unless the card of that name is there; errors say the choices."""
        if card is None:
            self.remark(None, f"no unit ({name}) is stated: lengths are taken as mm")
        elif not card.words or card.words[0].upper() not in units:
            card.broken(f"the unit {' '.join(card.words[:1])!r} is unknown; write {choices}")
        else:
            self.unit = units[card.words[0].upper()]
            if self.unit != 1.0:
                self.remark(card, f"lengths are multiplied by {self.unit:g}, since a scene is in mm")

    def is_carried(self, card: Card, rules: Mapping[str, Rule], *, in_surface: bool) -> bool:
        """Apply the rule of a card; return whether its numbers are to be used.

        Raises:
            UnsupportedSceneError: The card is refused, or is unknown within a surface.
        """
        rule = rules.get(card.name)
        if rule is None:
            near = _nearest(card.name, rules)
            hint = f" (did you mean {near}?)" if near else ""
            if in_surface and self.unknown != "remark":
                card.refuse(f"the card is unknown, and may change the light{hint}", 'remove it, or leave it out by unknown="remark" (--unknown remark)')
            self.remark(card, f"the card is unknown, and was left out{hint}")
            return False
        if rule.fate is Fate.CARRIED:
            return True
        if rule.fate is Fate.NO_LIGHT or rule.says_nothing is not None and rule.says_nothing(card):
            self.passed_over[card.name] += 1
        elif rule.fate is Fate.REFUSED:
            card.refuse(rule.what, rule.cure)
        else:
            self.remark(card, rule.what)
        return False


def _nearest(name: str, rules: Mapping[str, Rule]) -> str | None:
    """Return the card whose name is nearest to a misspelt one; of those that are as near, one that is carried."""
    return max(difflib.get_close_matches(name, rules, 5), default=None,
               key=lambda known: (difflib.SequenceMatcher(None, known, name).ratio(), rules[known].fate is Fate.CARRIED))


def one(cards: Iterable[Card], name: str) -> Card | None:
    """Return the card of a name, or None.

    Raises:
        UsageError: There are two, with other words.
    """
    found = [card for card in cards if card.name == name]
    if any(card.words != found[0].words for card in found):
        found[-1].broken("the card stands here a second time, with other words; one of them must go")
    return found[-1] if found else None


def decode(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 with or without a mark, or Latin-1 as Windows writes it.

    The text is decoded as a whole, before anything is read, so that no card is read twice.

    Raises:
        UsageError: The file is no text, or cannot be read.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror or error}") from error
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        tries = ["utf-16"]
    elif data[:200].count(0) > len(data[:200]) // 4:
        # Letters of the file are ASCII for the most part, so every other byte is 0: the odd ones of little end.
        tries = ["utf-16-le" if data[1:200:2].count(0) >= data[0:200:2].count(0) else "utf-16-be"]
    else:
        tries = ["utf-8-sig", "cp1252", "latin-1"]
    for encoding in tries:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        # Files of old programs may end by Ctrl-Z.
        text = text.rstrip("\x1a\x00")
        # Letters that Python takes for ends of lines, and programs do not.
        text = re.sub("[\x0b\x0c\x85\u2028\u2029]", " ", text)
        if not any(ord(letter) < 32 and letter not in "\t\n\r\f\v" for letter in text):
            return text
    raise UsageError(f"{path}: this is no text, so no lens file of Zemax, CODE V or OSLO in text; save it as text (.zmx, .seq, .len)")
