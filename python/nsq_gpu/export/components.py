"""Live components -> lenses, mirrors and doublets of schema version 1 where they are still what their configs say,
else single surfaces.

The tracer of Optiland reads surfaces alone, and users may change those after the component was built. So the surfaces
are the truth, and a config is believed only if building it anew gives them.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from optiland.nonsequential.components.doublet import Doublet
from optiland.nonsequential.components.lens import Lens
from optiland.nonsequential.components.mirror import Mirror
from optiland.nonsequential.scene import NSQScene

from nsq_gpu.export.materials import Media, catalog_name
from nsq_gpu.export.surfaces import surface
from nsq_gpu.export.values import Json, coordinate_system, number, optional, radius

#: Fields of configs that hold a SurfaceConfig.
_SLOTS = ("front", "cemented", "back", "edge", "rim", "surface")
#: What a surface's document may hold beside what its component says.
_OVERRIDES = ("interaction", "reflectance", "bsdf", "scatter_fraction", "coating")


@dataclass
class Components:
    """The sections of the file that describe components, and the labels of all surfaces in the order of the scene."""

    components: list[Json] = field(default_factory=list)
    surfaces: list[Json] = field(default_factory=list)
    overrides: dict[str, Json] = field(default_factory=dict)
    order: list[str] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)

    def order_needed(self) -> bool:
        """Return whether the order differs from the file's own: components first."""
        return self.order != [item["name"] for item in (*self.components, *self.surfaces)]


def components(scene: NSQScene, media: Media) -> Components:
    """Return all components of a scene."""
    found = Components()
    for name, compound in zip(scene.component_names, scene.component_registry.compounds, strict=True):
        if not _add_compound(found, name, compound, media):
            _add_surfaces(found, name, compound, media)
    return found


def _add_compound(found: Components, name: str, compound: Any, media: Media) -> bool:
    """Add a component of version 1, unless it is none or its surfaces are no longer what its config says."""
    kind = _KINDS.get(type(compound))
    if kind is None or compound.name != name or not kind.fits(compound._config):
        return False
    glasses = {key: compound.surfaces[index].material_front for key, index in kind.glasses.items()}
    live = [surface(part, _label(part, name, index), media) for index, part in enumerate(compound.surfaces)]
    written = _rebuilt(compound, glasses, media)
    if written != live:
        return False
    plain = _rebuilt(compound, {**glasses, **dict.fromkeys(_slots(compound._config))}, media)
    found.components.append(_document(kind, name, compound, glasses, media))
    for bare, part in zip(plain, live, strict=True):
        change = _override(bare, part)
        if change:
            found.overrides[part["name"]] = change
    found.order.append(name)
    found.labels.extend(part["name"] for part in live)
    return True


def _label(part: Any, name: str, index: int) -> str:
    return part.name or f"{name}.{index}"


def _slots(config: Any) -> list[str]:
    return [item.name for item in dataclasses.fields(config) if item.name in _SLOTS]


def _rebuilt(compound: Any, changes: dict[str, Any], media: Media) -> list[Json]:
    """Return the surfaces that a component's config, with these changes, builds."""
    fresh = copy.copy(compound)
    fresh._config = dataclasses.replace(compound._config, **changes)
    return [surface(part, part.name, media) for part in fresh._build()]


def _override(bare: Json, part: Json) -> Json:
    """Return what the surface has and the component alone would not give it."""
    change = {key: part[key] for key in _OVERRIDES if key in part and part[key] != bare.get(key)}
    aperture = part["shape"].get("aperture_radius")
    if aperture != bare["shape"].get("aperture_radius"):
        change["aperture_radius"] = aperture
    return change


def _add_surfaces(found: Components, name: str, compound: Any, media: Media) -> None:
    """Add a component as single surfaces."""
    parts = compound.surfaces
    for index, part in enumerate(parts):
        label = name if len(parts) == 1 else _label(part, name, index)
        found.surfaces.append(surface(part, label, media))
        found.order.append(label)
        found.labels.append(label)


# Configs


@dataclass(frozen=True)
class _Kind:
    """A kind of component in version 1."""

    type: str
    config: Callable[[Any, str], Json]
    #: The index of a surface whose front medium is the glass, by the config's name of the glass.
    glasses: dict[str, int]
    fits: Callable[[Any], bool] = lambda config: True


def _document(kind: _Kind, name: str, compound: Any, glasses: dict[str, Any], media: Media) -> Json:
    place = f"component {name!r}"
    config = kind.config(compound._config, place)
    for key, glass in glasses.items():
        known = catalog_name(glass, getattr(compound._config, key))
        config[key] = known if known is not None else media.reference(glass, place)
    return {"type": kind.type, "name": name, "cs": coordinate_system(compound.coordinate_system, place),
            "config": config}


def _lens(config: Any, place: str) -> Json:
    return {
        "r1": radius(config.r1, f"{place}: r1"),
        "r2": radius(config.r2, f"{place}: r2"),
        "thickness": number(config.thickness, f"{place}: thickness"),
        "front_aperture_radius": number(config.front_aperture_radius, f"{place}: front_aperture_radius"),
        "back_aperture_radius": optional(config.back_aperture_radius, f"{place}: back_aperture_radius"),
        "conic1": number(config.conic1, f"{place}: conic1"),
        "conic2": number(config.conic2, f"{place}: conic2"),
    }


def _doublet(config: Any, place: str) -> Json:
    radii = {key: radius(getattr(config, key), f"{place}: {key}") for key in ("r1", "r2", "r3")}
    keys = ("thickness1", "thickness2", "aperture_radius", "conic1", "conic2", "conic3")
    return {**radii, **{key: number(getattr(config, key), f"{place}: {key}") for key in keys}}


def _mirror(config: Any, place: str) -> Json:
    keys = ("reflectance", "conic", "aperture_radius")
    return {"radius": radius(config.radius, f"{place}: radius"),
            **{key: number(getattr(config, key), f"{place}: {key}") for key in keys}}


def _constant_reflectance(config: Any) -> bool:
    """Return whether version 1 can hold a mirror's reflectance."""
    return isinstance(config.reflectance, int | float) or hasattr(config.reflectance, "item")


_KINDS: dict[type, _Kind] = {
    Lens: _Kind("lens", _lens, {"material": 1}),
    Doublet: _Kind("doublet", _doublet, {"material1": 1, "material2": 2}),
    Mirror: _Kind("mirror", _mirror, {}, _constant_reflectance),
}
