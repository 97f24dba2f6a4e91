"""Live materials -> ``nsq_gpu.media``: what each is at the wavelengths that the sources emit."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.materials import IdealMaterial, Material
from optiland.nonsequential import NSQMaterial

from nsq_gpu.export.values import Json, number, numbers, refuse

#: The version of Optiland whose catalog the program holds: there, and only there, a name means the same entry.
CATALOG_VERSION = "0.6.3"

#: What n and k must be, so that the refusal can name the surface.
_LOWEST = {"n": np.nextafter(0.0, 1.0), "k": 0.0}


class Media:
    """The media of one scene. One live object is one medium, because Optiland knows media apart by identity."""

    def __init__(self, wavelengths: Iterable[float]) -> None:
        self.wavelengths = sorted(set(wavelengths))
        #: ``nsq_gpu.media``.
        self.documents: dict[str, Json] = {}
        self._names: dict[int, str] = {}
        # An id is unique only as long as its object lives.
        self._kept: list[Any] = []

    def reference(self, material: Any, place: str) -> Json | None:
        """Return what stands for a material in the file, which then holds its values."""
        if material is None or (type(material) is NSQMaterial and material.optiland_material is None):
            return None
        if isinstance(material, str):
            material = NSQMaterial.from_glass(material)
        if id(material) not in self._names:
            document = self._document(material, place)
            name = self._free_name(material)
            self._names[id(material)] = name
            self._kept.append(material)
            self.documents[name] = document
        return {"type": "medium", "name": self._names[id(material)]}

    def table(self, values: Any, place: str) -> list[float]:
        """Return one finite number per wavelength, from an array or a constant."""
        found = numbers(values, place)
        count = len(self.wavelengths)
        if len(found) not in (1, count):
            raise refuse(place, f"{len(found)} values for {count} wavelengths", "return one value per wavelength")
        return found * count if len(found) == 1 else found

    def wavelength_array(self) -> Any:
        """Return the wavelengths [um] as Optiland hands them to its materials."""
        return be.array(np.array(self.wavelengths))

    def _document(self, material: Any, place: str) -> Json:
        inner = getattr(material, "optiland_material", None)
        if type(material) is NSQMaterial and type(inner) is IdealMaterial:
            return {"type": "constant", "n": number(inner.index, f"{place}: n"),
                    "k": number(inner.absorp, f"{place}: k")}
        return {"type": "table", "wavelengths": self.wavelengths, "n": self._values(material, "n", place),
                "k": self._values(material, "k", place)}

    def _values(self, material: Any, which: str, place: str) -> list[float]:
        place = f"{place}: {which} of {_label(material)}"
        try:
            found = getattr(material, which)(self.wavelength_array())
        except Exception as error:
            raise refuse(place, f"it cannot be evaluated at {self.wavelengths} um ({error})",
                         "give a material that covers the wavelengths of the sources") from error
        values = self.table(found, place)
        for wavelength, value in zip(self.wavelengths, values, strict=True):
            if value < _LOWEST[which]:
                raise refuse(place, f"it is {value} at {wavelength} um", "give n above 0 and k of at least 0")
        return values

    def _free_name(self, material: Any) -> str:
        label = re.sub(r"[/\\\x00-\x1f\x7f]", "_", _label(material))[:100] or "medium"
        names = (label if count == 1 else f"{label} {count}" for count in range(1, len(self.documents) + 2))
        return next(name for name in names if name not in self.documents)


def _label(material: Any) -> str:
    inner = getattr(material, "optiland_material", None) or material
    name = getattr(material, "nsq_gpu_name", None) or getattr(inner, "name", None)
    if isinstance(name, str) and name:
        return name
    if type(inner) is IdealMaterial:
        return f"n = {float(inner.index.item()):g}"
    return type(inner).__name__


@functools.cache
def _optilands_version() -> str:
    return metadata.version("optiland")


@functools.cache
def _glasses() -> Path:
    return Path(str(resources.files("optiland.database"))) / "data-nk" / "glass"


def catalog_name(material: Any, written: Any) -> str | None:
    """Return the glass name that a config was written with, if the program is sure to take it for the same entry.

    Sure it is where the name is the entry's own, the entry is a glass (the program holds all of those) of the
    package's own database, and the package is the one whose search made the program's catalog.
    """
    inner = getattr(material, "optiland_material", None)
    if not isinstance(written, str) or type(inner) is not Material or inner.name != written:
        return None
    if _optilands_version() != CATALOG_VERSION:
        return None
    entry = Path(inner.filename)
    return written if _glasses() in entry.parents and entry.stem.lower() == written.lower() else None
