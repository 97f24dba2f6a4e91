"""Finds the material of a glass's name, and holds it against the index that the file states.

Optiland's search returns the best match of all materials: SF6 becomes a gas. Here a name must be a glass of refractiveindex.info's
catalogues, where hyphens and case are ignored, or an error is raised.
"""

from __future__ import annotations

import difflib
import functools
import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import optiland.backend as be
from optiland.materials import AbbeMaterial, IdealMaterial, MaterialFile
from optiland.materials.registry import MaterialRegistry

from nsq_gpu.lensfiles.cards import Card, Reading

#: Fraunhofer's lines d, F and C [um].
LINE_D, LINE_F, LINE_C = 0.5875618, 0.4861327, 0.6562725
#: Differences of nd and of Vd, as a share, beyond which a glass is another one, and beyond which the report gives both.
_OTHER_ND, _OTHER_VD = 1e-3, 0.02
_TOLD_ND, _TOLD_VD = 5e-5, 2e-3
#: How many times that plastics and crystals of one name differ.
_SPREAD = 5.0
#: An Abbe number from which on the index is constant: it differs by less than 1e-4 (n - 1) between the lines F and C.
_NO_DISPERSION = 1e4
#: nd and Vd that Zemax writes where it states none.
_PLACEHOLDERS = {(1.5, 40.0), (0.0, 0.0)}
#: Crystals, liquids and plastics that lens programs know by name: entries of the catalogue.
_OTHERS = {
    "CAF2": "main/CaF2/Malitson.yml", "BAF2": "main/BaF2/Malitson.yml", "LIF": "main/LiF/Li.yml", "MGF2": "main/MgF2/Dodge-o.yml",
    "SILICA": "main/SiO2/Malitson.yml", "FSILICA": "main/SiO2/Malitson.yml", "FUSEDSILICA": "main/SiO2/Malitson.yml",
    "QUARTZ": "main/SiO2/Ghosh-o.yml", "SAPPHIRE": "main/Al2O3/Malitson-o.yml", "WATER": "main/H2O/Daimon-20.0C.yml",
    "ZNSE": "main/ZnSe/Connolly.yml", "ZNS": "main/ZnS/Debenham.yml", "GERMANIUM": "main/Ge/Burnett.yml",
    "SILICON": "main/Si/Salzberg.yml", "GAAS": "main/GaAs/Skauli.yml",
    "PMMA": "organic/(C5H8O2)n - poly(methyl methacrylate)/Szczurowski.yml",
    "ACRYLIC": "organic/(C5H8O2)n - poly(methyl methacrylate)/Szczurowski.yml",
    "POLYCARB": "organic/(C16H14O3)n - polycarbonate/Sultanova.yml", "POLYSTYR": "organic/(C8H8)n - polystyren/Sultanova.yml",
}
#: Where a name without a catalogue is looked for first: Hikari's old names are Schott's.
_FIRST = ("schott", "hikari")
#: What the report calls the source of these.
_NO_CATALOGUE = "refractiveindex.info"
#: Catalogues of lens programs that refractiveindex.info has under another name.
_CATALOGUES = {"nikon": "hikari"}
#: Where Optiland has its catalogue.
_DATA = Path(str(resources.files("optiland.database"))) / "data-nk"


@dataclass(frozen=True)
class _Entry:
    name: str
    catalogue: str
    filename: str
    #: Wavelengths [um] for which its numbers were made.
    lowest: float = 0.0
    highest: float = math.inf


def plain(name: str) -> str:
    """Return a name without what programs write in several ways: case, hyphens, underscores and spaces."""
    return re.sub(r"[-_\s]", "", name.upper())


@functools.cache
def _entries() -> dict[str, list[_Entry]]:
    """Return the glasses of all catalogues, and those that the user registered with Optiland, by plain name."""
    found: dict[str, list[_Entry]] = {}
    seen = set()
    registry = MaterialRegistry.instance()
    for row in registry._get_combined_df().to_dict("records"):
        if row["group"] in ("glass", "user") and row["filename"] not in seen:
            seen.add(row["filename"])
            entry = _Entry(str(row["filename_no_ext"]), str(row["catalog_dir"]), str(row["filename"]), float(row["min_wavelength"]),
                           float(row["max_wavelength"]))
            found.setdefault(plain(entry.name), []).append(entry)
    return found


def index_of(material: Any, wavelength: float) -> float:
    """Return n at a wavelength [um]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return float(be.to_numpy(material.n(wavelength)).ravel()[0])


def _abbe(material: Any) -> float:
    spread = index_of(material, LINE_F) - index_of(material, LINE_C)
    return (index_of(material, LINE_D) - 1.0) / spread if spread else math.inf


def has_dispersion(vd: float) -> bool:
    """Return whether an index of that Abbe number is not constant; 0, and 10,000 and more, are no dispersion."""
    return vd != 0.0 and vd < _NO_DISPERSION


def model(nd: float, vd: float) -> Any:
    """Return a glass of an index at line d and an Abbe number."""
    return AbbeMaterial(nd, vd, model="buchdahl") if has_dispersion(vd) else IdealMaterial(nd)


def numbers_of_code(word: str) -> tuple[float, float] | None:
    """Return nd and Vd of a six-digit code, and None of another word: 517642 has 1.517 and 64.2 (MIL-G-174)."""
    return (1.0 + int(word[:3]) / 1000.0, int(word[3:]) / 10.0) if re.fullmatch(r"\d{6}", word) else None


def find(reading: Reading, card: Card, name: str, catalogues: Sequence[str] = (), nd: float = 0.0, vd: float = 0.0) -> Any:
    """Return the material of a glass's name.

    Args:
        reading: The file.
        card: The card that names the glass.
        name: The name.
        catalogues: Catalogues that the file states, the preferred one first; empty for all.
        nd: Index at line d that the file states; 0 for none.
        vd: Abbe number that the file states; 0 for none.

    Raises:
        UnsupportedSceneError: No catalogue has the glass, or it has another index there.
    """
    if plain(name) in reading.glasses:
        reading.glasses_found[name] = "as given"
        return reading.glasses[plain(name)]
    is_stated = nd > 1.0 and (nd, vd) not in _PLACEHOLDERS
    candidates, remark = _candidates(name, catalogues)
    if not candidates:
        _not_found(reading, card, name, nd, vd, is_stated)
        return model(nd, vd)
    if not is_stated:
        entry, material = candidates[0]
        n = index_of(material, LINE_D)
        others = [f"nd = {index_of(other, LINE_D):.5f} of {known.catalogue}" for known, other in candidates[1:]
                  if abs(index_of(other, LINE_D) - n) > _OTHER_ND]
        if others and entry.catalogue not in (*_FIRST, *map(_catalogue, catalogues)):
            card.refuse(f"{name} has nd = {n:.5f} of {entry.catalogue}, {', '.join(others)}", "name the catalogue in the file, or give glasses={...}")
        if others:
            remark = "; ".join([*([remark] if remark else []), f"other catalogues have {', '.join(others)}"])
        return _found(reading, card, name, entry, material, remark)

    def distance(pair: tuple[_Entry, Any]) -> float:
        dn, dv = _differences(pair[1], nd, vd)
        return max(dn / _OTHER_ND, dv / _OTHER_VD)

    entry, material = min(candidates, key=distance)
    dn, dv = _differences(material, nd, vd)
    if not distance((entry, material)) <= (_SPREAD if entry.catalogue == _NO_CATALOGUE else 1.0):
        what = (f"the file states nd = {nd:.6g} and Vd = {vd:.5g} for {name}, but {entry.name} of {entry.catalogue} has "
                f"nd = {index_of(material, LINE_D):.6g} and Vd = {_abbe(material):.5g}")
        if reading.unknown != "remark":
            card.refuse(what, f'correct one of them, give glasses={{"{name}": ...}}, or take the stated numbers by unknown="remark" '
                        "(--unknown remark)")
        reading.remark(card, f"{what}: the stated numbers are taken")
        return model(nd, vd)
    if dn > _TOLD_ND or dv > _TOLD_VD:
        remark = (f"{remark}; " if remark else "") + (
            f"nd = {index_of(material, LINE_D):.6g}, Vd = {_abbe(material):.5g}, where the file states {nd:.6g} and {vd:.5g}")
    return _found(reading, card, name, entry, material, remark)


def _differences(material: Any, nd: float, vd: float) -> tuple[float, float]:
    """Return how far an index at line d, and an Abbe number as a share, are from what a file states."""
    try:
        dn = abs(index_of(material, LINE_D) - nd)
        dv = abs(_abbe(material) / vd - 1.0) if vd > 0.0 else 0.0
    except Exception:
        # An entry of the infrared has no visible lines.
        return math.inf, math.inf
    return dn, dv


def _found(reading: Reading, card: Card, name: str, entry: _Entry, material: Any, remark: str) -> Any:
    reading.glasses_found[name] = f"{entry.name} of {entry.catalogue}"
    try:
        reading.glasses_found[name] += f", nd = {index_of(material, LINE_D):.5f}"
    except Exception:
        pass
    if remark:
        reading.remark(card, f"the glass {name} is taken as {entry.name} of {entry.catalogue}: {remark}")
    return material


def _catalogue(name: str) -> str:
    return _CATALOGUES.get(name.lower(), name.lower())


def _candidates(name: str, catalogues: Sequence[str]) -> tuple[list[tuple[_Entry, Any]], str]:
    """Return all entries that a name may mean, the likeliest first, and what is to be said of that."""
    wanted = [_catalogue(name) for name in catalogues]

    def of(key: str) -> list[_Entry]:
        found = _entries().get(key, [])
        order = {catalogue: place for place, catalogue in enumerate(wanted or _FIRST)}
        return sorted(found, key=lambda entry: (order.get(entry.catalogue, len(order)), plain(entry.name) != entry.name.upper()))

    def made(found: list[_Entry]) -> list[tuple[_Entry, Any]]:
        return [(entry, _material(entry)) for entry in found]

    key = plain(name)
    found = of(key)
    if found:
        stated = [entry for entry in found if entry.catalogue in wanted]
        if stated or not wanted:
            return made(stated or found), ""
        return made(found), f"the catalogues of the file ({', '.join(catalogues)}) do not have it"
    if key in _OTHERS:
        return made([_Entry(_OTHERS[key].removesuffix(".yml"), _NO_CATALOGUE, _OTHERS[key])]), "no catalogue of glasses has the name"
    # Names of makers before the glass, as OSLO has them; and glasses without lead that took the place of old ones.
    for prefix in ("H", "O", "P", "J", "E", "K"):
        if name.upper().startswith(f"{prefix}_") and of(plain(name[2:])):
            return made(of(plain(name[2:]))), f"no catalogue has {name}; {prefix}_ stands for its maker"
    successor = [entry for entry in of(f"N{key}") if entry.catalogue == "schott"]
    if successor:
        return made(successor), f"no catalogue has {name} any more; {successor[0].name}, which has no lead, took its place"
    return [], ""


def _material(entry: _Entry) -> Any:
    # By the entry's own file: Optiland's search by name may find another one.
    material = MaterialFile(str(_DATA / entry.filename))
    material.name = entry.name
    material.covers = (entry.lowest, entry.highest)
    return material


def _not_found(reading: Reading, card: Card, name: str, nd: float, vd: float, is_stated: bool) -> None:
    names = sorted({entry.name for entries in _entries().values() for entry in entries})
    near = difflib.get_close_matches(name.upper(), names, 3, 0.3)
    what = f"no catalogue has the glass {name}; nearest names: {', '.join(near) or 'none'}"
    cure = f'correct the name, or give glasses={{"{name}": a material of Optiland}}'
    if not is_stated:
        card.refuse(what, cure)
    if reading.unknown != "remark":
        card.refuse(what, f'{cure}, or take the file\'s own nd = {nd:.6g} and Vd = {vd:.5g} by unknown="remark" (--unknown remark)')
    reading.remark(card, f"{what}: the file's own nd = {nd:.6g} and Vd = {vd:.5g} are taken")
    reading.glasses_found[name] = f"nd = {nd:.6g} and Vd = {vd:.5g}, as the file states"

