"""Makes surfaces of a scene from the faces of a prescription: lenses with edges, mounts, mirrors, stops."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from optiland.nonsequential import NSQMaterial, NSQScene
from optiland.nonsequential.bsdf.base import BaseBSDF
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.base import BaseComponent
from optiland.nonsequential.components.geometry.analytic.annulus import AnnularPlaneGeometry
from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry
from optiland.nonsequential.components.geometry.analytic.frustum import CylindricalFrustumGeometry
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry
from optiland.nonsequential.components.reflective import ReflectiveComponent
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.nonsequential.materials.nsq_material import VACUUM

from nsq_gpu.coatings import TabulatedCoating
from nsq_gpu.convert.prescription import Face, Rays
from nsq_gpu.convert.report import LensReport
from nsq_gpu.errors import UnsupportedSceneError
from nsq_gpu.shapes import ENDLESS, Aperture

#: How much larger an opening is than the rays that were traced, which are not all: the share of its radius.
_ROOM = 1e-3
#: Outer radius of a mount or a stop, over the largest radius of all faces.
_MOUNT = 1.5
#: Faces nearer than that are one face that light meets twice [mm].
_SAME = 1e-9


@dataclass
class Part:
    """A face as the scene has it; light may meet it several times."""

    face: Face
    radius: float
    #: Media on the sides of -z and of +z of its frame.
    front: NSQMaterial | None
    back: NSQMaterial | None
    #: Its radius may be made smaller.
    is_free: bool
    indices: list[int] = field(default_factory=list)
    name: str = ""


@dataclass
class Gap:
    """Glass between two faces that follow each other."""

    first: Part
    second: Part
    medium: NSQMaterial


@dataclass(frozen=True)
class Element:
    """A lens, a mirror or a single face of the scene."""

    name: str
    #: The diameter of its largest face [mm].
    width: float


def build(scene: NSQScene, faces: list[Face], rays: Rays, edges: str | BaseBSDF, margin: float,
          report: LensReport) -> tuple[list[dict[str, Any]], Element | None]:
    """Add all surfaces of a lens to a scene and to the report.

    Returns:
        What moves as one, as scene files list it, and the element that light meets last.
    """
    parts, gaps, stops = _arranged(faces, margin)
    crossing = _shrink(parts, gaps)
    elements = _elements(parts, gaps)
    outer = _MOUNT * max(part.radius for part in parts) if parts else 0.0
    outer = max([outer, *(_MOUNT * _opening(face) for face in stops)])
    for part in parts:
        scene.add_component(part.name, _component(part, report))
        if not isinstance(part.face.stated, Aperture):
            continue
        if part.face.is_mirror:
            report.remarks.append(f"{part.name}: light beside its aperture, and through a hole of it, goes on")
        for number, absorbs in enumerate(_absorbing(part.face), start=1):
            name = f"{part.name}.mask" if number == 1 else f"{part.name}.mask_{number}"
            scene.add_component(name, AbsorbingComponent(part.face.frame(), part.face.form.clipped(part.radius, absorbs), name=name))
    mounted: set[int] = set()
    for element in elements:
        if _add_edges(scene, element, rays, edges, outer, report):
            mounted |= {id(part) for gap in element for part in (gap.first, gap.second)}
    for part in parts:
        if not part.face.clips or part.face.is_mirror:
            continue
        if not part.face.form.is_round:
            _add_collar(scene, part, outer)
        if id(part) not in mounted:
            _add_ring(scene, part, rays, outer, report)
    for number, face in enumerate(stops):
        _add_stop(scene, face, "stop" if number == 0 else f"stop_{number + 1}", gaps, rays, outer, report)
    report.remarks += [f"{first.name} and {second.name} cross {height:.4g} mm off the axis, where light goes: light beyond meets "
                       "them in the other order" for first, second, height in crossing]
    by_index = {index: part.name for part in parts for index in part.indices}
    for face in faces:
        names = report.components.get(face.index, ())
        report.components[face.index] = ((by_index[face.index],) if face.index in by_index else ()) + names
    report.components = dict(sorted(report.components.items()))
    report.max_depth = sum(not face.does_nothing for face in faces) + 1
    moving = _moving(parts, {report.components[face.index][0]: face.index for face in stops if report.components[face.index]},
                     list(scene.component_names))
    return moving, _last(parts, elements)


def _moving(parts: list[Part], stops: dict[str, int], names: list[str]) -> list[dict[str, Any]]:
    """Return lenses, mirrors and single faces in the order of light: their faces, what moves along, and what is behind each.

    Args:
        parts: All faces of the scene.
        stops: The index of each stop in the prescription, by its name.
        names: The names of all components.
    """
    spans: dict[str, list[int]] = {}
    faces: dict[str, list[str]] = {}
    for part in sorted(parts, key=lambda part: part.indices[0]):
        label = part.name.split(".")[0]
        spans.setdefault(label, []).extend(part.indices)
        faces.setdefault(label, []).append(part.name)
    found = [{"name": label, "faces": own, "parts": [name for name in names if name.startswith(f"{label}.") and name not in own]}
             for label, own in faces.items()]
    for name, index in stops.items():
        # A stop in glass is a part of the lens.
        for element in found:
            if min(spans[element["name"]]) < index < max(spans[element["name"]]):
                element["parts"].append(name)
                break
    ends = [max(spans[element["name"]]) for element in found]
    if any(end > min(spans[other["name"]]) for end, other in zip(ends, found[1:], strict=False)):
        # Light comes back to an element: what is behind it is before it, too.
        return found
    inside = {name for element in found for name in element["parts"]}
    for element, first, last in zip(found, ends, [*ends[1:], math.inf], strict=False):
        element["behind"] = [name for name, index in stops.items() if first < index < last and name not in inside]
    return found


def _last(parts: list[Part], elements: list[list[Gap]]) -> Element | None:
    """Return the element that light meets last; None if there is none."""
    if not parts:
        return None
    last = max(parts, key=lambda part: max(part.indices))
    own = [part for gaps in elements for gap in gaps for part in (gap.first, gap.second)
           if any(last in (known.first, known.second) for known in gaps)]
    return Element(last.name.split(".")[0], 2.0 * max(part.radius for part in [last, *own]))


def _absorbing(face: Face) -> list[Aperture]:
    """Return what of a face absorbs: all that the aperture of glass leaves out, and what stands before a mirror."""
    return _obstacles(face.stated) if face.is_mirror else [face.stated.inverse()]


def _obstacles(aperture: Aperture) -> list[Aperture]:
    """Return what an aperture takes away from another: obscurations, as of a telescope."""
    if aperture.outline == "difference":
        return [aperture.parts[1], *_obstacles(aperture.parts[0])]
    return [obstacle for part in aperture.parts for obstacle in _obstacles(part)] if aperture.outline == "intersection" else []


def _opening(face: Face) -> float:
    """Return how far from the axis the opening of a stop reaches [mm]."""
    if isinstance(face.stated, Aperture):
        return face.stated.reach() if face.stated.reach() < ENDLESS else face.ray_radius * (1.0 + _ROOM)
    return face.ray_radius * (1.0 + _ROOM) if face.stated is None else face.stated


def _arranged(faces: list[Face], margin: float) -> tuple[list[Part], list[Gap], list[Face]]:
    """Return the faces of the scene, the glass between them, and what clips light where nothing else is."""
    parts: list[Part] = []
    gaps: list[Gap] = []
    stops: list[Face] = []
    last: Part | None = None
    for face in faces:
        if face.does_nothing:
            if face.clips:
                stops.append(face)
            continue
        part = _part(face, parts, margin)
        if last is not None and face.before is not None and part is not last:
            pair = {id(last), id(part)}
            if all({id(gap.first), id(gap.second)} != pair for gap in gaps):
                gaps.append(Gap(last, part, face.before))
        last = part
    return parts, gaps, stops


def _part(face: Face, parts: list[Part], margin: float) -> Part:
    """Return the face as the scene has it: a new one, or one that light met before."""
    if face.ray_radius > face.form.reach * (1.0 + 1e-9):
        raise UnsupportedSceneError(f"{face.place}: rays meet it up to {face.ray_radius:.6g} mm off the axis, but a scene's "
                                    f"{face.form.kind.__name__} ends where its form first ends in any direction, at "
                                    f"{face.form.reach:.6g} mm")
    radius = min(_opening(face) if face.clips else face.ray_radius * margin, face.form.reach)
    if not radius > 0.0:
        raise UnsupportedSceneError(f"{face.place}: all rays meet it on its axis, so nothing says how large it is; state its aperture, "
                                    "and give a surface of no curvature an infinite radius")
    sides = (face.before, face.behind) if face.is_forward else (face.behind, face.before)
    for part in parts:
        # Faces that follow each other in one place are two, with nothing between them.
        if not _is_same(part.face, face) or part is parts[-1] and part.indices[-1] == face.index - 1:
            continue
        first = part.face
        if first.is_mirror != face.is_mirror or (part.front, part.back) != sides:
            raise UnsupportedSceneError(f"{face.place} lies in the place of {first.place}, and is no second passage of it: one of "
                                        "them is a mirror, or their media differ; move one of them along the axis a little, such as by 0.001 mm")
        for what, one, other in (("coating", _numbers(first.coating), _numbers(face.coating)), ("aperture", first.stated, face.stated)):
            if one != other:
                raise UnsupportedSceneError(f"{face.place} is a second passage of {first.place}, with another {what}; give both the "
                                            "same")
        part.radius = part.radius if first.stated is not None else max(part.radius, radius)
        part.indices.append(face.index)
        return part
    parts.append(Part(face, radius, *sides, is_free=not face.clips, indices=[face.index]))
    return parts[-1]


def _numbers(coating: Any) -> tuple[Any, ...] | None:
    if isinstance(coating, TabulatedCoating):
        return coating.numbers()
    return None if coating is None else (float(coating.transmittance), float(coating.reflectance))


def _is_same(one: Face, other: Face) -> bool:
    """Return whether two surfaces of the prescription are one that light meets twice."""
    turned = one.rotation.T @ other.rotation
    same_place = np.abs(one.position - other.position).max() <= _SAME
    are_conics = one.form.is_conic and other.form.is_conic
    if same_place and abs(turned[2, 2] + 1.0) < 1e-12 and are_conics and one.form.radius == -other.form.radius:
        raise UnsupportedSceneError(f"{other.place} is {one.place} seen from the other side; give both one frame")
    same_form = one.form == other.form or one.form.is_flat and other.form.is_flat
    return bool(same_place and same_form and np.abs(turned - np.eye(3)).max() < 1e-12)


def _along(first: Part, second: Part) -> float | None:
    """Return where the second vertex lies on the axis of the first [mm]; None if they have no common axis."""
    turned = first.face.rotation.T @ second.face.rotation
    x, y, z = first.face.rotation.T @ (second.face.position - first.face.position)
    has_axis = abs(turned[2, 2] - 1.0) < 1e-12 and max(abs(x), abs(y)) <= _SAME * (1.0 + abs(z))
    return float(z) if has_axis else None


def _shrink(parts: list[Part], gaps: list[Gap]) -> list[tuple[Part, Part, float]]:
    """Make faces that would cross within their margin as small as the rays allow, or as their crossing is.

    Return faces that cross where light goes, and how far from the axis [mm].
    """
    found = []
    pairs = [(gap.first, gap.second) for gap in gaps]
    pairs += [pair for pair in zip(parts, parts[1:], strict=False) if pair not in pairs]
    for first, second in pairs:
        z = _along(first, second)
        if z is None or z == 0.0:
            continue

        def apart(height: float, first: Part = first, second: Part = second, z: float = z) -> float:
            return math.copysign(1.0, z) * _between(first, second, height, height, z)

        common = min(first.radius, second.radius)
        if apart(common) > 0.0:
            continue
        # Bisection for where they meet; NaN counts as met.
        low, high = 0.0, common
        for _ in range(100):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if apart(middle) > 0.0 else (low, middle)
        for part in (first, second):
            if part.is_free and part.radius > low:
                part.radius = max(low, min(part.radius, part.face.ray_radius * (1.0 + _ROOM)))
        if min(first.radius, second.radius) > low * (1.0 + _ROOM):
            found.append((first, second, low))
    return found


def _between(first: Part, second: Part, height: float, other_height: float, z: float) -> float:
    """Return how far the second face lies behind the first at distances from the axis, where both come nearest [mm]."""
    turned = first.face.rotation.T @ second.face.rotation
    apart = z + second.face.form.around(other_height, math.atan2(turned[1, 0], turned[0, 0])) - first.face.form.around(height)
    return float(apart.min() if z > 0.0 else apart.max())


def _elements(parts: list[Part], gaps: list[Gap]) -> list[list[Gap]]:
    """Name the faces; return the gaps of each lens, in their order."""
    groups: list[list[Gap]] = []
    for gap in gaps:
        joined = [group for group in groups
                  if any(part in (gap.first, gap.second) for known in group for part in (known.first, known.second))]
        for group in joined:
            groups.remove(group)
        groups.append([known for group in joined for known in group] + [gap])
    order = {id(part): place for place, part in enumerate(parts)}
    groups.sort(key=lambda group: min(order[id(gap.first)] for gap in group))
    for number, group in enumerate(groups, start=1):
        own = sorted({id(part): part for gap in group for part in (gap.first, gap.second)}.values(), key=lambda part: order[id(part)])
        names = {2: ["front", "back"], 3: ["front", "cemented", "back"]}.get(len(own), [f"face_{i + 1}" for i in range(len(own))])
        for part, name in zip(own, names, strict=True):
            part.name = f"L{number}.{name}"
    free = [part for part in parts if not part.name]
    mirrors = [part for part in free if part.face.is_mirror]
    for number, part in enumerate(mirrors, start=1):
        part.name = f"M{number}"
    for part in free:
        part.name = part.name or f"face_{part.face.index}"
    return groups


def _component(part: Part, report: LensReport) -> BaseComponent:
    face = part.face
    form = face.form
    if part.radius >= form.reach:
        # An asphere needs its slope at the rim.
        part.radius = form.reach * (1.0 - (1e-9 if form.is_conic else 1e-3))
    if isinstance(face.stated, Aperture):
        shape: Any = form.clipped(part.radius, face.stated)
    elif not form.is_conic:
        shape = form.shape(part.radius)
    elif not form.is_flat:
        shape = ConicGeometry(form.radius, form.conic, part.radius)
    else:
        shape = FinitePlaneGeometry(aperture_radius=part.radius)
    (report.estimated_apertures if face.stated is None else report.stated_apertures).append(part.name)
    front, back = (VACUUM if medium is None else medium for medium in (part.front, part.back))
    if face.is_mirror:
        if face.coating is None:
            report.mirror_reflectance_defaulted.append(part.name)
        if isinstance(face.coating, TabulatedCoating):
            report.averaged_coatings.append(part.name)
            reflectance: Any = face.coating
        else:
            reflectance = 1.0 if face.coating is None else float(face.coating.reflectance)
        return ReflectiveComponent(face.frame(), shape, reflectance, material_front=front, name=part.name)
    if isinstance(face.coating, TabulatedCoating):
        report.averaged_coatings.append(part.name)
    (report.uncoated_surfaces if face.coating is None else report.coated_surfaces).append(part.name)
    return RefractiveComponent(face.frame(), shape, front, back, name=part.name, coating=face.coating)


def _add_edges(scene: NSQScene, gaps: list[Gap], rays: Rays, edges: str | BaseBSDF, outer: float, report: LensReport) -> bool:
    """Close the glass of a lens from rim to rim, and mount it, so that no light slips past; return whether it is mounted."""
    lens = gaps[0].first.name.split(".")[0]
    widest: tuple[float, Gap, float] | None = None
    for number, gap in enumerate(gaps, start=1):
        name = f"{lens}.edge" if len(gaps) == 1 else f"{lens}.edge_{number}"
        shape, reason = _edge(gap)
        if shape is None:
            report.without_edge[name] = reason
            continue
        scene.add_component(name, _edge_component(gap, shape, edges, name))
        rims = [part.face.form.rim(part.radius) for part in (gap.first, gap.second)]
        missing = max(high - low for low, high in rims)
        if missing > 1e-9:
            report.remarks.append(f"{name} is a frustum between faces that are not round: up to {missing:.4g} mm of the glass beside "
                                  "their rims has no edge, and light may leave there")
        if widest is None or max(gap.first.radius, gap.second.radius) > widest[0]:
            middle = 0.5 * (shape.z_front + shape.z_back)
            widest = (max(gap.first.radius, gap.second.radius), gap, float(middle))
    if widest is None:
        report.remarks.append(f"{lens} has no mount: light may pass beside it")
        return False
    _, gap, z = widest
    inner = 0.5 * (gap.first.radius + gap.second.radius)
    crossing = _largest_crossing(gap.first.face, z, rays, beyond=inner)
    if crossing is not None:
        inner = crossing * (1.0 + _ROOM)
        report.remarks.append(f"{lens}.mount: its opening of {inner:.6g} mm leaves a gap, since rays of a field cross it")
    outer = _reaching(gap.first.face, z, rays, outer)
    if inner < outer:
        geometry = AnnularPlaneGeometry(inner_radius=inner, outer_radius=outer, z_offset=z)
        scene.add_component(f"{lens}.mount", AbsorbingComponent(gap.first.face.frame(), geometry, name=f"{lens}.mount"))
    return True


def _add_collar(scene: NSQScene, part: Part, outer: float) -> None:
    """Continue a face that clips light and is not round beyond its rim: a flat ring would leave gaps beside that."""
    form, radius = part.face.form, part.radius
    reach = min(outer, 0.999 * form.reach)
    if radius < reach:
        shape = form.clipped(reach, Aperture("ellipse", radius, radius, inverted=True))
        scene.add_component(f"{part.name}.collar", AbsorbingComponent(part.face.frame(), shape, name=f"{part.name}.collar"))


def _add_ring(scene: NSQScene, part: Part, rays: Rays, outer: float, report: LensReport) -> None:
    """Add an absorbing ring around a face that clips light and has no mount."""
    z = 0.5 * sum(part.face.form.rim(part.radius))
    crossing = _largest_crossing(part.face, z, rays, beyond=part.radius)
    inner = part.radius if crossing is None else crossing * (1.0 + _ROOM)
    if crossing is not None:
        report.remarks.append(f"{part.name}.ring: its opening of {inner:.6g} mm leaves a gap, since rays of a field cross it")
    shape = AnnularPlaneGeometry(inner_radius=inner, outer_radius=max(_reaching(part.face, z, rays, outer), 2.0 * inner), z_offset=z)
    scene.add_component(f"{part.name}.ring", AbsorbingComponent(part.face.frame(), shape, name=f"{part.name}.ring"))


def _reaching(face: Face, z: float, rays: Rays, outer: float) -> float:
    """Return the outer radius of an absorbing plate at z of a face's frame that no launched ray passes beside [mm]."""
    return max(outer, (1.0 + 50.0 * _ROOM) * (_largest_crossing(face, z, rays, beyond=0.0, launched=True) or 0.0))


def _edge(gap: Gap) -> tuple[CylindricalFrustumGeometry | None, str]:
    """Return the edge of a piece of glass in the frame of its first face; None and the reason where it has none."""
    z = _along(gap.first, gap.second)
    if z is None:
        return None, "its faces have no common axis"
    if not math.copysign(1.0, z) * _between(gap.first, gap.second, gap.first.radius, gap.second.radius, z) > 0.0:
        return None, "its faces cross at their rims"
    one, other = gap.first.face.form.rim(gap.first.radius), gap.second.face.form.rim(gap.second.radius)
    # Between the innermost points of both rims, so that the edge never stands out of the glass.
    first, second = (one[1], z + other[0]) if z > 0.0 else (one[0], z + other[1])
    if not (second - first) * z > 0.0:
        return None, "its faces are not round, and their rims leave no room for a frustum between them"
    ends = [(first, gap.first.radius), (second, gap.second.radius)]
    (z_front, r_front), (z_back, r_back) = ends if first < second else ends[::-1]
    return CylindricalFrustumGeometry(r_front=r_front, r_back=r_back, z_front=z_front, z_back=z_back), ""


def _edge_component(gap: Gap, shape: Any, edges: str | BaseBSDF, name: str) -> BaseComponent:
    cs = gap.first.face.frame()
    if edges == "absorbing":
        return AbsorbingComponent(cs, shape, gap.medium, name=name)
    # Its normal points outward: glass in front of it, what is around the lens behind.
    bsdf = None if edges == "polished" else edges
    return RefractiveComponent(cs, shape, gap.medium, VACUUM, bsdf=bsdf, name=name)


def _largest_crossing(face: Face, z: float, rays: Rays, beyond: float, launched: bool = False) -> float | None:
    """Return how far from the axis rays cross a plane z of a face's frame, where that is beyond a radius [mm].

    Those that reach the image, or all that are launched.
    """
    chosen = np.isfinite(rays.places).all(axis=(0, 2)) if launched else rays.arrive
    local = (rays.places[:, chosen] - face.position) @ face.rotation
    before, after = local[:-1], local[1:]
    crosses = (before[..., 2] - z) * (after[..., 2] - z) < 0.0
    share = np.divide(z - before[..., 2], after[..., 2] - before[..., 2], out=np.zeros(crosses.shape), where=crosses)
    place = before + share[..., None] * (after - before)
    heights = np.hypot(place[..., 0], place[..., 1])[crosses]
    heights = heights[heights > beyond]
    return float(heights.max()) if len(heights) else None


def _add_stop(scene: NSQScene, face: Face, name: str, gaps: list[Gap], rays: Rays, outer: float, report: LensReport) -> None:
    """Add an absorbing plate with the opening of a stop."""
    opening = _opening(face)
    medium = VACUUM if face.before is None else face.before
    around = [gap for gap in gaps if gap.medium is face.before and gap.first.face.index < face.index < gap.second.face.index]
    # In glass to its edge, and in air as far as light is launched.
    outer = max((gap.first.radius for gap in around), default=_reaching(face, 0.0, rays, outer))
    outer = max([outer, *(gap.second.radius for gap in around)])
    report.components[face.index] = (name,)
    (report.estimated_apertures if face.stated is None else report.stated_apertures).append(name)
    if isinstance(face.stated, Aperture):
        shape = face.form.clipped(min(outer, 0.999 * face.form.reach), face.stated.inverse())
        scene.add_component(name, AbsorbingComponent(face.frame(), shape, medium, name=name))
    elif opening < outer:
        shape = AnnularPlaneGeometry(inner_radius=opening, outer_radius=outer, z_offset=0.5 * sum(face.form.rim(min(opening, 0.999 * face.form.reach))))
        scene.add_component(name, AbsorbingComponent(face.frame(), shape, medium, name=name))
