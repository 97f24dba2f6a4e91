"""Hands the tensors of a prescription on to its scene, so that a loss of the scene has gradients by radii and thicknesses.

A scene is made from numbers. If a number of the prescription is a tensor with ``requires_grad``, the scene holds the tensor in its
place: in shapes and frames of faces, in the image's frame, and in mirrors. Media are the prescription's own.
"""

from __future__ import annotations

import math
from typing import Any

from optiland.coatings import SimpleCoating
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQScene

from nsq_gpu.convert.report import LensReport
from nsq_gpu.errors import ResultWarning, UnsupportedSceneError, wants_gradient, warn
from nsq_gpu.export.values import all_want_gradients
from nsq_gpu.frames import number_of

#: Numbers of a scene's shape, and the numbers of Optiland's geometries that they are, the first that exists.
_NUMBERS = {"radius": ("radius",), "conic": ("k",), "coefficients": ("coefficients",), "radius_x": ("Rx", "R_rot"), "radius_y": ("Ry", "R_yz"),
            "conic_x": ("kx",), "conic_y": ("ky",), "coeffs_poly_y": ("coeffs_poly_y",), "norm_x": ("norm_x",), "norm_y": ("norm_y",),
            "norm_radius": ("norm_radius",)}
_FRAME = ("x", "y", "z", "rx", "ry", "rz")


def attach(scene: NSQScene, optic: Any, report: LensReport) -> None:
    """Put the tensors of an optic that want gradients into its scene.

    Raises:
        UnsupportedSceneError: A tensor has no place in the scene, so that its gradient would be dropped, and somebody named it.
    """
    surfaces = optic.surfaces.surfaces
    components = dict(zip(scene.component_names, scene.surfaces, strict=True))
    attached = False
    owners: dict[str, int] = {}
    for index, names in report.components.items():
        component = components.get(names[0]) if names and not names[0].startswith("stop") else None
        geometry = surfaces[index].geometry
        if component is None:
            continue
        place = f"surface {index}"
        if names[0] in owners:
            _refuse_second(place, owners[names[0]], geometry, surfaces[owners[names[0]]].geometry)
            continue
        owners[names[0]] = index
        attached |= _attach_shape(component.geometry, geometry, place)
        cs = _frame(surfaces, index)
        if cs is not None:
            component.cs = cs
            attached = True
        coating = getattr(surfaces[index].interaction_model, "coating", None)
        if type(coating) is SimpleCoating and wants_gradient(coating.reflectance) and hasattr(component, "reflectance"):
            component.reflectance = coating.reflectance
            attached = True
    cs = _frame(surfaces, len(surfaces) - 1)
    if cs is not None:
        scene.detectors[0].cs = cs
        attached = True
    if wants_gradient(surfaces[0].thickness):
        _drop("surface 0: the object's distance wants a gradient, but the light of the fields has none", "detach it")
    if attached:
        report.remarks.append("tensors that want gradients are kept in faces, media and the image; the light of the fields, sizes, edges, mounts "
                              "and stops are numbers")


def _drop(problem: str, remedy: str) -> None:
    """Refuse a tensor whose gradient would be dropped; where nobody named those that want gradients, warn."""
    if not all_want_gradients():
        raise UnsupportedSceneError(f"{problem}; {remedy}")
    warn(f"{problem}; {remedy}, else it gets no gradient", ResultWarning)


def _frame_wants(cs: Any) -> bool:
    return any(wants_gradient(getattr(cs, key)) for key in _FRAME) or cs.reference_cs is not None and _frame_wants(cs.reference_cs)


def _frame(surfaces: list[Any], index: int) -> CoordinateSystem | None:
    """Return the frame of a surface with the tensors that it depends on; None if none wants a gradient.

    Optiland detaches thicknesses where it adds a surface, and keeps them beside the frame.
    """
    cs = surfaces[index].geometry.cs
    steps = [surface.thickness for surface in surfaces[1:index] if wants_gradient(surface.thickness)]
    if not steps or wants_gradient(cs.z):
        return cs if _frame_wants(cs) else None
    if cs.reference_cs is not None or any(number_of(getattr(surface.geometry.cs, key)) for surface in surfaces[1:index] for key in _FRAME[3:]):
        _drop(f"surface {index}: a thickness before it wants a gradient, but frames are tilted, and Optiland keeps no graph of "
              "thicknesses there", "give the surface's place as a tensor")
        return cs if _frame_wants(cs) else None
    z = cs.z
    for step in steps:
        z = z + (step - step.detach())
    return CoordinateSystem(cs.x, cs.y, z.reshape(()), cs.rx, cs.ry, cs.rz)


def _leaves(value: Any) -> list[Any]:
    """Return a number, or the numbers of lists, one by one."""
    return [leaf for item in value for leaf in _leaves(item)] if isinstance(value, list | tuple) else [value]


def _wants(value: Any) -> bool:
    return any(wants_gradient(leaf) for leaf in _leaves(value))


def _tensors(geometry: Any) -> dict[str, Any]:
    """Return the numbers of a geometry that want gradients, by their names in a scene's shape."""
    found = {}
    for name, keys in _NUMBERS.items():
        value = next((getattr(geometry, key) for key in keys if hasattr(geometry, key)), None)
        # A radius without an end has no derivative: the surface is a plane.
        if _wants(value) and not (name.startswith("radius") and not math.isfinite(number_of(value))):
            found[name] = value
    return found


def _attach_shape(shape: Any, geometry: Any, place: str) -> bool:
    found = _tensors(geometry)
    for name, value in found.items():
        if not hasattr(shape, name):
            if name == "conic":
                # A plane has none.
                continue
            _drop(f"{place}: its {name} wants a gradient, but the scene's {type(shape).__name__} has none", "detach it")
            continue
        own = getattr(shape, name)
        if isinstance(own, list):
            # Zeros at the end are no coefficients of the scene.
            value = _listed(value)
            if len(value) < len(own) or any(wants_gradient(item) for item in _leaves(value[len(own):])):
                _drop(f"{place}: a coefficient of 0 at the end wants a gradient", "give it a value that is not 0, or detach it")
            value = value[:len(own)]
        setattr(shape, name, value)
    return bool(found)


def _listed(value: Any) -> list[Any]:
    """Return a list, or the parts of a tensor, as a list of numbers and tensors."""
    return list(value.unbind()) if hasattr(value, "unbind") else list(value)


def _refuse_second(place: str, first: int, geometry: Any, other: Any) -> None:
    """Refuse tensors of a second passage of a face that are not the first one's, whose place they have."""
    own = {**_tensors(geometry), **{key: getattr(geometry.cs, key) for key in _FRAME if wants_gradient(getattr(geometry.cs, key))}}
    for name, value in own.items():
        known = getattr(other.cs, name) if name in _FRAME else _tensors(other).get(name)
        if known is not value:
            _drop(f"{place} is the same face as surface {first}, met a second time",
                  f"its {name} needs the same tensor as surface {first}")
