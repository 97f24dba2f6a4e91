"""Writes ``benches/stability/cases.json``: ``python -m tools.make_stability [NAME ...]`` from the folder ``python``.

Each case is a scene where tracers fail, with readings whose exact values are computed here to 60 digits. An answer of
a tier is right if it is the exact answer to a scene whose numbers differ from the written ones by a few roundings of
that tier: so the interval that a tier must hit is what ``ROUNDINGS`` roundings of each number do to the exact answer.
Readings that chance decides must lie within five standard deviations. What Optiland's NumPy backend reads stands
beside. Names on the command line choose the cases to write anew; the others stay. Needs optiland 0.6.3 and mpmath.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import acos, cos, exp, floor, mpf, pi, quad, sin, sqrt
from tests import oracle

from tools.exact import (
    Conic,
    Ray,
    Sphere,
    pass_surface,
    reflect_off,
    rotation,
    to_plane,
    transmittance,
    turned,
    unit,
)

Json = dict[str, Any]
Numbers = dict[str, mpf]

CASES = Path(__file__).resolve().parents[2] / "benches" / "stability" / "cases.json"

#: Roundings of each number of a scene that an answer may differ by.
ROUNDINGS = 8
#: Half a unit in the last place of 1; of df64, what a product may be rounded by.
EPSILON = {"f32": mpf(2) ** -24, "df64": 5 * mpf(2) ** -48, "f64": mpf(2) ** -53}
#: What totals are counted in, of a new ray's weight.
QUANTUM = mpf(2) ** -52
#: Standard deviations for what chance decides.
SIGMAS = 5


@dataclass(frozen=True)
class Number:
    """A number of the scene: the size that its rounding is relative to, by default its own.

    ``written`` is the size of the coordinates that the file holds, which are doubles whatever the tier.
    """

    value: mpf
    size: mpf | None = None
    written: mpf = mpf(0)


@dataclass(frozen=True)
class Reading:
    """What is read of the result, and its exact value as a function of the case's numbers."""

    name: str
    source: Json
    exact: Callable[[Numbers], mpf | None] | None = None
    #: Errors that the arithmetic makes on top of the scene's numbers' own, in roundings of this size.
    size: mpf = mpf(1)
    expected: mpf = mpf(0)
    sigma: mpf | None = None


@dataclass(frozen=True)
class Case:
    name: str
    group: str
    scene: Json
    readings: list[Reading]
    numbers: dict[str, Number] = field(default_factory=dict)
    num_rays: int = 1
    max_depth: int = 16
    #: Events whose roundings add up; 0 where the numbers as they are decide, but for how a tier holds them.
    events: int = 1
    #: The part of the message that the scene must be refused with.
    refused: str | None = None
    #: False where the reference would take too long.
    reference: bool = True


# Scenes.


def frame(x: float = 0.0, y: float = 0.0, z: float = 0.0, ry: float = 0.0, **more: Any) -> Json:
    return {"x": x, "y": y, "z": z, "rx": 0.0, "ry": ry, "rz": 0.0, **more}


def pencil(cs: Json, **more: Any) -> Json:
    return {"type": "point", "cs": cs, "half_angle_deg": 0.0, "total_flux": 1.0,
            "spectrum": {"wavelengths": [0.5], "weights": [1.0]}, **more}


def inside(medium: str) -> Json:
    return {"medium": {"type": "medium", "name": medium}}


def towards(angle: float, distance: float = 1.0, **more: Any) -> Json:
    """A pencil through the origin at an angle from z, in the plane y = 0."""
    return pencil(frame(-distance * math.sin(angle), 0.0, -distance * math.cos(angle), ry=angle), **more)


def database(name: str, cs: Json, side: float, absorb: bool = True) -> Json:
    return {"name": name, "type": "ray_database", "cs": cs, "width": side, "height": side, "absorb": absorb}


def pixels(name: str, cs: Json, side: float, num: int = 1, absorb: bool = True) -> Json:
    return {"name": name, "type": "irradiance", "cs": cs, "width": side, "height": side, "num_pixels_x": num,
            "num_pixels_y": num, "splat": "hard", "absorb": absorb}


def surface(name: str, shape: Json, cs: Json, interaction: str, **more: Any) -> Json:
    return {"name": name, "shape": shape, "cs": cs, "interaction": interaction, **more}


def boundary(name: str, shape: Json, cs: Json, front: str, back: str) -> Json:
    def side(medium: str) -> Json | None:
        return {"type": "medium", "name": medium} if medium else None

    return surface(name, shape, cs, "refractive", material_front=side(front), material_back=side(back))


def mirror(name: str, shape: Json, cs: Json, reflectance: float = 1.0) -> Json:
    return surface(name, shape, cs, "reflective", reflectance=reflectance)


def disk(radius: float) -> Json:
    return {"type": "plane", "aperture_radius": radius}


def conic(radius: float, conic_constant: float, aperture: float) -> Json:
    return {"type": "conic", "radius": radius, "conic": conic_constant, "aperture_radius": aperture}


def scene(sources: list[Json], surfaces: list[Json], detectors: list[Json], media: Json | None = None,
          **sampling: Any) -> Json:
    named = [{"name": f"source {i}", **source} for i, source in enumerate(sources)]
    indices = {name: {"type": "constant", "n": n, "k": k} for name, (n, k) in (media or {}).items()}
    return {"nsq_schema_version": 1, "components": [], "sources": named, "detectors": detectors,
            "nsq_gpu": {"version": 1, "media": indices, "surfaces": surfaces,
                        "sampling": {"rr_start_flux": 0.0, **sampling}}}


def column(detector: str, name: str, take: str = "mean") -> Json:
    return {"detector": detector, "column": name, "take": take}


def total(detector: str) -> Json:
    return {"detector": detector, "column": "total_flux", "take": "total"}


def pixel(detector: str, x: int, y: int) -> Json:
    """The flux in the pixel of a column and a row [W]."""
    return {"detector": detector, "take": "pixel", "pixel": [x, y]}


def field_of_result(name: str) -> Json:
    return {"field": name}


#: Where reflection is never, or always, drawn: the probability that both tracers clip it to.
CLIPPED = mpf(1e-12)


# Cases.


def angle_numbers(angle: float) -> dict[str, Number]:
    """The direction's components are the sine and cosine of the angle, each rounded."""
    return {"L": Number(sin(mpf(angle))), "N": Number(cos(mpf(angle)))}


def direction_of(n: Numbers) -> list[mpf]:
    return unit([n["L"], mpf(0), n["N"]])


def interface(name: str, group: str, angle: float, n1: float, n2: float) -> Iterator[Case]:
    """One boundary: all transmitted, then all reflected."""
    media = {"first": (n1, 0.0), "second": (n2, 0.0)}
    face = boundary("face", {"type": "plane"}, frame(), "first", "second")
    wide = [database("reflected", frame(z=-2.0), 1e8), database("transmitted", frame(z=1.0), 1e8)]
    numbers = {**angle_numbers(angle), "n1": Number(mpf(n1)), "n2": Number(mpf(n2))}

    def share(n: Numbers) -> mpf:
        return transmittance(n["n1"], n["n2"], direction_of(n)[2])

    def bent(n: Numbers) -> mpf:
        return n["n1"] / n["n2"] * direction_of(n)[0]

    def all_drawn(probability: float) -> Json:
        return scene([towards(angle, **inside("first"))], [face], wide, media, reflect_prob=probability)

    passed = share({key: number.value for key, number in numbers.items()})
    # At the critical angle a tier may see no light pass; a total, unlike a row's weight, is then 0.
    edge = abs(n1 / n2 * math.sin(angle) - 1.0) < 1e-5
    light = total("transmitted") if edge else column("transmitted", "weight")
    through = [Reading("T", light, lambda n: share(n) / (1 - CLIPPED), size=max(passed, QUANTUM if edge else 0))]
    if not edge:
        through.append(Reading("direction L", column("transmitted", "L"), bent))
    yield Case(f"{name}, transmitted", group, all_drawn(0.0), through, numbers)
    if passed > 0:
        back = [Reading("R", column("reflected", "weight"), lambda n: (1 - share(n)) / (1 - CLIPPED), size=1 - passed)]
        yield Case(f"{name}, reflected", group, all_drawn(1.0), back, numbers)


def grazing() -> Iterator[Case]:
    for degrees in (89.0, 89.99, 89.9999):
        yield from interface(f"grazing at {degrees} deg", "grazing incidence", math.radians(degrees), 1.0, 1.5)


def critical_angle() -> Iterator[Case]:
    for what, offset in (("1e-6 below", -1e-6), ("1e-12 below", -1e-12), ("1e-12 above", 1e-12)):
        angle = math.asin((1.0 + offset) / 1.5)
        yield from interface(f"{what} the critical angle", "total reflection", angle, 1.5, 1.0)


def cement() -> Iterator[Case]:
    for step in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0):
        yield from interface(f"n2/n1 - 1 = {step:g}", "nearly equal indices", math.pi / 3, 1.5, 1.5 * (1.0 + step))


def tangents() -> Iterator[Case]:
    radius = 10.0
    for gap in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0, -1e-12):
        height = radius * (1.0 - gap)
        ball = mirror("ball", {"type": "sphere", "radius": radius}, frame())
        document = scene([pencil(frame(x=height, z=-20.0))], [ball], [database("screen", frame(z=20.0), 1e4)])

        def turned_by(n: Numbers) -> mpf:
            return sin(2 * acos(n["height"] / n["radius"])) if n["height"] < n["radius"] else mpf(0)

        numbers = {"height": Number(mpf(height)), "radius": Number(mpf(radius))}
        yield Case(f"mirror ball met at R (1 - {gap:g})", "tangent hits", document,
                   [Reading("direction L", column("screen", "L"), turned_by)], numbers)


GERMANIUM = {"germanium": (4.0, 0.0)}
STATISTICAL_RAYS = 100_000


def binomial(name: str, source: Json, share: mpf, rays: int = STATISTICAL_RAYS) -> Reading:
    return Reading(name, source, expected=share, sigma=sqrt(share * (1 - share) / rays))


def thin_plates() -> Iterator[Case]:
    for thickness in (1.0, 1e-3, 1e-6, 1e-9, 1e-12):
        faces = [boundary("front", disk(5.0), frame(z=2.0), "", "germanium"),
                 boundary("back", disk(5.0), frame(z=2.0 + thickness), "germanium", "")]
        document = scene([pencil(frame())], faces, [pixels("behind", frame(z=10.0), 10.0)], GERMANIUM)
        yield Case(f"plate {thickness:g} mm thick", "thin gaps and plates", document,
                   [binomial("T", total("behind"), mpf(8) / 17)], num_rays=STATISTICAL_RAYS, max_depth=64)


def two_plates(gap: float, backward: bool, listed_backward: bool) -> Json:
    def face(name: str, z: float, front: str, back: str) -> Json:
        return boundary(name, disk(5.0), frame(z=z), front, back)

    faces = [face("1 front", 2.0, "", "germanium"), face("1 back", 3.0, "germanium", ""),
             face("2 front", 3.0 + gap, "", "germanium"), face("2 back", 4.0 + gap, "germanium", "")]
    start, end = (frame(z=8.0, ry=math.pi), frame(z=-4.0)) if backward else (frame(), frame(z=10.0))
    order = faces[::-1] if listed_backward else faces
    return scene([pencil(start)], order, [pixels("behind", end, 10.0)], GERMANIUM)


def contacts() -> Iterator[Case]:
    # Four faces of R = 0.36: (1 - R) / (1 + 3 R) (Stokes).
    share = mpf("0.64") / (1 + 3 * mpf("0.36"))
    read = [binomial("T", total("behind"), share)]
    for gap in (1e-3, 1e-6, 1e-9, 1e-12):
        yield Case(f"two plates {gap:g} mm apart", "thin gaps and plates", two_plates(gap, False, False), read,
                   num_rays=STATISTICAL_RAYS, max_depth=200)
    for name, backward, listed in (("lit from the front", False, False), ("lit from behind", True, False),
                                   ("listed backward, lit from the front", False, True),
                                   ("listed backward, lit from behind", True, True)):
        yield Case(f"two plates in contact, {name}", "faces in contact", two_plates(0.0, backward, listed), read,
                   num_rays=STATISTICAL_RAYS, max_depth=200)


def cemented() -> Iterator[Case]:
    """Two lenses whose curved faces touch: as one cemented face, but with vacuum of no thickness between."""
    height, (r1, r2, r3) = 4.0, (50.0, -40.0, -150.0)
    for tilt in (0.0, 0.3):
        base = frame(rx=0.0, ry=tilt)

        def place(z: float, base: Json = base) -> Json:
            return {**frame(z=z), "reference_cs": base}

        media = {"crown": (1.5, 0.0), "flint": (1.7, 0.0)}
        faces = [boundary("1", conic(r1, 0.0, 10.0), place(0.0), "", "crown"),
                 boundary("2", conic(r2, 0.0, 10.0), place(6.0), "crown", ""),
                 boundary("3", conic(r2, 0.0, 10.0), place(6.0), "", "flint"),
                 boundary("4", conic(r3, 0.0, 10.0), place(9.0), "flint", "")]
        source = pencil({**frame(x=height, z=-10.0), "reference_cs": base})
        document = scene([source], faces, [database("screen", place(30.0), 50.0)], media, reflect_prob=0.0)

        def behind(n: Numbers) -> Ray:
            ray = Ray([n["height"], mpf(0), mpf(-10)], unit([n["slope"], mpf(0), mpf(1)]))
            index = [mpf(1), mpf(1.5), mpf(1), mpf(1.7), mpf(1)]
            for i, (radius, z) in enumerate(((r1, 0), (r2, 6), (r2, 6), (r3, 9))):
                shape = Conic(1 / (mpf(radius) + n["radius"]), mpf(0), mpf(z))
                # The second face of the contact is met where the ray stands.
                ray = pass_surface(ray, shape, index[i], index[i + 1], accept=lambda t: t > -mpf(10) ** -40)
            return ray

        def direction(n: Numbers, tilt: float = tilt) -> mpf:
            return turned(rotation(0.0, tilt, 0.0), behind(n).direction)[0]

        numbers = {"height": Number(mpf(height), mpf(30)), "radius": Number(mpf(0), mpf(50)),
                   "slope": Number(mpf(0), mpf(1))}
        yield Case(f"lenses in contact on a curved face, turned by {tilt}", "faces in contact", document,
                   [Reading("direction L", column("screen", "L"), direction),
                    Reading("T", total("screen"), lambda n: behind(n).weight / (1 - CLIPPED) ** 4)],
                   numbers, events=4)


def long_radii() -> Iterator[Case]:
    height = 5.0
    for power in (3, 6, 9, 12, 15, None):
        radius = 0.0 if power is None else 10.0**power
        faces = [boundary("front", conic(radius, 0.0, 10.0), frame(), "", "glass"),
                 boundary("back", conic(0.0, 0.0, 10.0), frame(z=5.0), "glass", "")]
        document = scene([pencil(frame(x=height, z=-10.0))], faces, [database("screen", frame(z=100.0), 50.0)],
                         {"glass": (1.5, 0.0)}, reflect_prob=0.0)

        def behind(n: Numbers, radius: float = radius) -> Ray:
            curvature = 1 / mpf(radius) if radius else mpf(0)
            ray = Ray([n["height"], mpf(0), mpf(-10)], unit([n["slope"], mpf(0), mpf(1)]))
            ray = pass_surface(ray, Conic(curvature, mpf(0), mpf(0)), mpf(1), n["index"])
            return to_plane(pass_surface(ray, Conic(mpf(0), mpf(0), mpf(5)), n["index"], mpf(1)), mpf(100))

        numbers = {"height": Number(mpf(height), mpf(50)), "slope": Number(mpf(0), mpf(1)), "index": Number(mpf(1.5))}
        yield Case("flat lens" if power is None else f"lens of radius 1e{power} mm", "long radii", document,
                   [Reading("direction L", column("screen", "L"), lambda n: behind(n).direction[0]),
                    Reading("x", column("screen", "x"), lambda n: behind(n).position[0], size=mpf(50))],
                   numbers, events=3)


def far_away() -> Iterator[Case]:
    """Optiland's benchmark lens, turned, at a distance from the origin."""
    radius, beam = 10.0, 10.0
    for power in (3, 5, 7, 8, 9):
        distance = 10.0**power
        base = {"x": distance, "y": -distance, "z": distance, "rx": 0.3, "ry": 0.2, "rz": 0.1}

        def place(z: float, base: Json = base) -> Json:
            return {**frame(z=z), "reference_cs": base}

        faces = [boundary("front", conic(100.0, 0.0, 12.5), place(0.0), "", "glass"),
                 boundary("back", conic(-100.0, 0.0, 12.5), place(5.0), "glass", "")]
        light = {**pencil(place(-25.0)), "type": "collimated", "aperture_radius": radius}
        del light["half_angle_deg"]
        rays = 20_000
        document = scene([light], faces, [pixels("screen", place(150.0), 50.0, 64)], {"glass": (1.5, 0.0)},
                         reflect_prob=0.0)

        def passed(height: mpf) -> mpf:
            ray = Ray([height, mpf(0), mpf(-25)], [mpf(0), mpf(0), mpf(1)])
            ray = pass_surface(ray, Conic(1 / mpf(100), mpf(0), mpf(0)), mpf(1), mpf(1.5))
            return pass_surface(ray, Conic(-1 / mpf(100), mpf(0), mpf(5)), mpf(1.5), mpf(1)).weight

        mean = quad(lambda h: passed(h) * 2 * h / beam**2, [0, beam])
        square = quad(lambda h: passed(h) ** 2 * 2 * h / beam**2, [0, beam])
        far = Reading("T", total("screen"), expected=mean / (1 - CLIPPED) ** 2,
                      sigma=sqrt((square - mean**2) / rays) + mpf(2) ** -24)
        yield Case(f"lens at 1e{power} mm, turned", "far from the origin", document, [far], num_rays=rays)

        # A single ray, whose direction says more than the flux.
        lone = scene([pencil({**frame(x=3.0, z=-25.0), "reference_cs": base})], faces,
                     [database("screen", place(150.0), 50.0)], {"glass": (1.5, 0.0)}, reflect_prob=0.0)

        def direction(n: Numbers) -> mpf:
            ray = Ray([n["height"], mpf(0), mpf(-25)], unit([n["slope"], mpf(0), mpf(1)]))
            ray = pass_surface(ray, Conic(1 / mpf(100), mpf(0), mpf(0)), mpf(1), mpf(1.5))
            ray = pass_surface(ray, Conic(-1 / mpf(100), mpf(0), mpf(5)), mpf(1.5), mpf(1))
            return turned(rotation(0.3, 0.2, 0.1), ray.direction)[0]

        numbers = {"height": Number(mpf(3), mpf(100), mpf(distance)), "slope": Number(mpf(0), mpf(1))}
        yield Case(f"ray through a lens at 1e{power} mm, turned", "far from the origin", lone,
                   [Reading("direction L", column("screen", "L"), direction)], numbers, events=3)


def caps() -> Iterator[Case]:
    for short in (1e-2, 1e-6, 1e-12):
        height = 5.0 * (1.0 - short)
        dome = boundary("dome", conic(5.0, 0.0, 5.0), frame(), "", "glass")
        document = scene([pencil(frame(x=height, z=-10.0))], [dome], [database("screen", frame(z=20.0), 500.0)],
                         {"glass": (1.5, 0.0)}, reflect_prob=0.0)

        def bent(n: Numbers) -> Ray | None:
            if n["height"] >= n["radius"]:
                return None
            ray = Ray([n["height"], mpf(0), mpf(-10)], [mpf(0), mpf(0), mpf(1)])
            return pass_surface(ray, Conic(1 / n["radius"], mpf(0), mpf(0)), mpf(1), mpf(1.5))

        def direction(n: Numbers, bent: Any = bent) -> mpf:
            ray = bent(n)
            return mpf(0) if ray is None else ray.direction[0]

        def share(n: Numbers, bent: Any = bent) -> mpf:
            ray = bent(n)
            return mpf(1) if ray is None else ray.weight / (1 - CLIPPED)

        numbers = {"height": Number(mpf(height)), "radius": Number(mpf(5))}
        yield Case(f"hemisphere met at R (1 - {short:g})", "hemispheres", document,
                   [Reading("direction L", column("screen", "L"), direction),
                    Reading("T", total("screen"), share)], numbers)
    # The aplanatic point of a hyperhemisphere: sin u' = n sin u.
    angle = 2.0
    ball = boundary("ball", {"type": "sphere", "radius": 5.0}, frame(), "", "glass")
    z = 5.0 / 1.5
    source = pencil({**frame(z=z, ry=angle)}, **inside("glass"))
    wide = [database("screen", frame(z=-20.0), 1e3), database("front", frame(z=20.0), 1e3)]
    document = scene([source], [ball], wide, {"glass": (1.5, 0.0)}, reflect_prob=0.0)

    def aplanatic(n: Numbers) -> mpf:
        ray = Ray([mpf(0), mpf(0), mpf(z)], unit([n["L"], mpf(0), n["N"]]))
        return pass_surface(ray, Sphere(n["radius"], [mpf(0)] * 3), mpf(1.5), mpf(1)).direction[0]

    yield Case("hyperhemisphere left backward from its aplanatic point", "hemispheres", document,
               [Reading("direction L", column("screen", "L"), aplanatic)],
               {**angle_numbers(angle), "radius": Number(mpf(5))})


def second_sheets() -> Iterator[Case]:
    for name, x, z, angle in (("through the second sheet", 1.5, -10.0, 0.0), ("past the vertex", 0.25, -6.0, 0.04)):
        shape = conic(2.0, -4.0, 3.0)
        document = scene([pencil(frame(x=x, z=z, ry=angle))], [mirror("mirror", shape, frame())],
                         [database("screen", frame(z=-20.0), 1e4), database("missed", frame(z=20.0), 1e4)])

        def back(n: Numbers, z: float = z) -> mpf:
            ray = Ray([n["x"], mpf(0), mpf(z)], unit([n["L"], mpf(0), n["N"]]))
            return reflect_off(ray, Conic(1 / n["radius"], mpf(-4), mpf(0))).direction[0]

        numbers = {**angle_numbers(angle), "x": Number(mpf(x), mpf(20)), "radius": Number(mpf(2))}
        yield Case(f"hyperboloid met {name}", "second sheets", document,
                   [Reading("direction L", column("screen", "L"), back)], numbers)


def conic_constants() -> Iterator[Case]:
    for step in (0.0, 1e-6, -1e-6, 1e-12, -1e-12, 2.220446049250313e-16, -1.1102230246251565e-16):
        constant = -1.0 + step
        shape = conic(-100.0, constant, 40.0)
        document = scene([pencil(frame(x=20.0, z=-200.0))], [mirror("mirror", shape, frame())],
                         [database("screen", frame(z=-300.0), 1e3)])

        def focus(n: Numbers) -> Ray:
            ray = Ray([n["height"], mpf(0), mpf(-200)], unit([n["slope"], mpf(0), mpf(1)]))
            return to_plane(reflect_off(ray, Conic(1 / n["radius"], n["K"], mpf(0))), mpf(-300))

        numbers = {"height": Number(mpf(20), mpf(300)), "slope": Number(mpf(0), mpf(1)),
                   "radius": Number(mpf(-100)), "K": Number(mpf(constant))}
        yield Case(f"mirror of K = -1 {step:+.1e}", "conic constants", document,
                   [Reading("x", column("screen", "x"), lambda n: focus(n).position[0], size=mpf(300)),
                    Reading("direction L", column("screen", "L"), lambda n: focus(n).direction[0])], numbers)


def aperture_edges() -> Iterator[Case]:
    radius = 1.5
    shapes = {"disk": disk(radius), "conic": conic(8.0, 0.0, radius),
              "annulus": {"type": "annulus", "inner_radius": 0.5, "outer_radius": radius},
              "rectangle": {"type": "plane", "width": 2 * radius, "height": 1.0}}
    for kind, shape in shapes.items():
        for where, height in (("on the rim", radius), ("one double beyond it", float(np.nextafter(radius, 2.0)))):
            stop = surface("stop", shape, frame(), "absorbing")
            document = scene([pencil(frame(x=height, z=-1.0))], [stop], [pixels("behind", frame(z=10.0), 10.0)])
            # In f32 the two are the same.
            numbers = {"height": Number(mpf(height))} if height > radius else {}

            def passes(n: Numbers, height: float = height) -> mpf:
                return mpf(1) if n.get("height", mpf(height)) > radius else mpf(0)

            yield Case(f"{kind} met {where}", "aperture edges", document,
                       [Reading("passed", total("behind"), passes, size=mpf(0))], numbers, events=0)


def births() -> Iterator[Case]:
    face = boundary("face", {"type": "plane"}, frame(), "", "glass")
    screen = [database("screen", frame(z=5.0), 50.0)]
    glass = {"glass": (1.5, 0.0)}
    on = scene([towards(0.5, distance=0.0, **inside("glass"))], [face], screen, glass, reflect_prob=0.0)
    yield Case("born on a plane, leaving it", "births", on,
               [Reading("direction L", column("screen", "L"), lambda n: direction_of(n)[0]),
                Reading("T", total("screen"), lambda n: mpf(1))], angle_numbers(0.5))
    side = [database("side", {**frame(x=10.0), "ry": math.pi / 2}, 50.0)]
    along_plane = scene([pencil(frame(ry=math.pi / 2))], [mirror("mirror", disk(20.0), frame())], side)
    yield Case("born on a mirror, along it", "births", along_plane,
               [Reading("passed", total("side"), lambda n: mpf(1))])
    ball = boundary("ball", {"type": "sphere", "radius": 5.0}, frame(), "", "glass")
    deep = scene([pencil(frame(x=2.0, z=1.0, ry=0.4), **inside("glass"))], [ball],
                 [database("screen", frame(z=20.0), 1e3)], glass, reflect_prob=0.0)

    def out(n: Numbers) -> Ray:
        ray = Ray([n["x"], mpf(0), mpf(1)], direction_of(n))
        return pass_surface(ray, Sphere(n["radius"], [mpf(0)] * 3), mpf(1.5), mpf(1))

    numbers = {**angle_numbers(0.4), "x": Number(mpf(2), mpf(5)), "radius": Number(mpf(5))}
    yield Case("born inside glass", "births", deep,
               [Reading("direction L", column("screen", "L"), lambda n: out(n).direction[0]),
                Reading("T", total("screen"), lambda n: out(n).weight / (1 - CLIPPED))], numbers)


def polygons() -> Iterator[Case]:
    """Chords of a circle, each turned by the same angle; a transmissive plane through the centre notes the last one."""
    for name, graze, glass, depth in (("ball lens, 1,000 internal reflections", 0.6, True, 1382),
                                      ("whispering gallery, 5,000 reflections", 1e-2, False, 5031)):
        radius = 5.0
        shape = {"type": "sphere", "radius": radius}
        wall = boundary("ball", shape, frame(), "", "glass") if glass else mirror("wall", shape, frame())
        # From the middle of a chord along x, at the distance R cos(graze) from the centre.
        start = radius * math.cos(graze)
        source = pencil(frame(z=start, ry=math.pi / 2), **(inside("glass") if glass else {}))
        plane = database("plane", frame(), 4 * radius, absorb=False)
        document = scene([source], [wall], [plane], {"glass": (1.5, 0.0)} if glass else None)

        def last(n: Numbers, depth: int = depth) -> mpf:
            middle, level = last_crossing(acos(n["start"] / n["radius"]), depth)
            return n["start"] / cos(level - middle) * cos(level)

        numbers = {"start": Number(mpf(start), mpf(radius)), "radius": Number(mpf(radius))}
        yield Case(name, "many bounces", document,
                   # Each event rounds the direction anew: the angle walks at random, and its sum over the events is
                   # what the place on the circle is off by.
                   [Reading("x", column("plane", "x", "last"), last, size=radius * mpf(depth) ** 1.5)], numbers,
                   max_depth=depth)


def last_crossing(half: mpf, depth: int) -> tuple[mpf, mpf]:
    """Follow chords that each take 2 half of the polar angle, clockwise from the middle of the one at pi / 2.

    A chord's end is an event, and so is a crossing of the plane, where the polar angle is a multiple of pi. Return the
    polar angles of the middle of the last crossing's chord and of the crossing.
    """
    found = None
    events, middle, begin = 0, pi / 2, pi / 2
    while True:
        level = pi * (floor(begin / pi) if begin % pi else floor(begin / pi) - 1)
        if level > middle - half:
            found, events = (middle, level), events + 1
        events += 1
        # The event of the chord's end comes last: a crossing that takes the last event still counts.
        if events >= depth:
            return found
        middle, begin = middle - 2 * half, middle - half


def deep_cavity() -> Iterator[Case]:
    depth = 10_000
    wall = mirror("wall", {"type": "sphere", "radius": 5.0}, frame(), 0.999)
    source = pencil(frame(x=1.0, y=0.5))
    source["half_angle_deg"] = 90.0
    unused = [pixels("unused", frame(z=50.0), 1e-3)]
    document = scene([source], [wall], unused)
    yield Case("sphere of R = 0.999 to depth 10,000", "many bounces", document,
               [Reading("flux left", field_of_result("total_flux_lost"), lambda n: n["R"] ** depth,
                        size=mpf(0.999) ** depth * depth)],
               {"R": Number(mpf(0.999))}, num_rays=64, max_depth=depth)


def kaleidoscopes() -> Iterator[Case]:
    """Two convex mirrors face to face: each reflection magnifies an offset some fourfold."""
    radius, half_gap = 10.0, 5.0
    for power in (1, 3, 5, 7, 9, 12):
        offset = 10.0**-power
        balls = [mirror("right", {"type": "sphere", "radius": radius}, frame(z=half_gap + radius)),
                 mirror("left", {"type": "sphere", "radius": radius}, frame(z=-half_gap - radius))]
        screen = database("screen", {**frame(x=30.0), "ry": math.pi / 2}, 1e4)
        document = scene([pencil(frame(x=offset))], balls, [screen])

        def leave(n: Numbers) -> mpf | None:
            ray = Ray([n["offset"], mpf(0), mpf(0)], unit([n["slope"], mpf(0), mpf(1)]))
            spheres = [Sphere(n["radius"], [mpf(0), mpf(0), s * (half_gap + n["radius"])]) for s in (1, -1)]
            for bounce in range(40):
                try:
                    ray = reflect_off(ray, spheres[bounce % 2])
                except ValueError:
                    # A ray that was magnified from the other side of the axis leaves on the other side.
                    return ray.direction[2] if ray.direction[0] > 0 else None
            raise ValueError("the ray stays")

        numbers = {"offset": Number(mpf(offset), mpf(radius)), "slope": Number(mpf(0), mpf(1)),
                   "radius": Number(mpf(radius))}
        yield Case(f"convex mirrors, from {offset:g} mm off their axis", "chaotic mirrors", document,
                   [Reading("direction N", column("screen", "N"), leave)], numbers, max_depth=40, events=2)


def spectra() -> Iterator[Case]:
    for wavelength, k in ((0.1, 1e-6), (20.0, 1e-4)):
        faces = [boundary("front", disk(5.0), frame(z=1.0), "", "smoke"),
                 boundary("back", disk(5.0), frame(z=11.0), "smoke", "")]
        source = pencil(frame(), spectrum={"wavelengths": [wavelength], "weights": [1.0]})
        document = scene([source], faces, [pixels("behind", frame(z=20.0), 10.0)], {"smoke": (1.0, k)})

        def passed(n: Numbers) -> mpf:
            return exp(-4 * pi * n["k"] * n["length"] * 1000 / n["wavelength"])

        numbers = {"k": Number(mpf(k)), "length": Number(mpf(10), mpf(20)), "wavelength": Number(mpf(wavelength))}
        yield Case(f"absorption at {wavelength:g} um", "spectra", document,
                   [Reading("T", total("behind"), passed)], numbers)


def fluxes() -> Iterator[Case]:
    faces = [boundary("front", disk(5.0), frame(z=1.0), "", "glass")]
    for power in (100, -100):
        flux = 2.0**power
        source = pencil(frame(), total_flux=flux)
        document = scene([source], faces, [pixels("behind", frame(z=20.0), 10.0)], {"glass": (1.5, 0.0)},
                         reflect_prob=0.0)

        def passed(n: Numbers, flux: float = flux) -> mpf:
            return mpf(flux) * transmittance(mpf(1), n["n"], mpf(1)) / (1 - CLIPPED)

        yield Case(f"flux of 2^{power} W", "flux", document,
                   [Reading("flux [W]", total("behind"), passed, size=mpf(flux))], {"n": Number(mpf(1.5))})
    apart = scene([pencil(frame()), pencil(frame(x=1.0), total_flux=1e-12)], [],
                  [pixels("behind", frame(z=20.0), 10.0)])
    yield Case("two sources 1e12 apart in flux", "flux", apart, [], num_rays=10, refused="a quantum is")


def pixel_counts() -> Iterator[Case]:
    for num in (1, 2048, 8192):
        document = scene([pencil(frame(x=0.3, y=0.2))], [], [pixels("screen", frame(z=5.0), 10.0, num)])
        yield Case(f"{num} x {num} pixels", "pixels", document,
                   [Reading("flux", total("screen"), lambda n: mpf(1))], num_rays=1000)
    yield lit_pixels()
    mirrors = [mirror("far", disk(5.0), frame(z=5.0)), mirror("near", disk(5.0), frame(z=-5.0))]
    passing = scene([pencil(frame())], mirrors, [pixels("screen", frame(z=2.0), 2.0, 1, absorb=False)])
    crossings, rays = 1000, 100_000
    # Every second event is a crossing.
    yield Case("1e8 deposits in one pixel", "pixels", passing,
               [Reading("crossings", total("screen"), lambda n: mpf(crossings))],
               num_rays=rays, max_depth=2 * crossings, reference=False)


def lit_pixels() -> Case:
    """Beams of 1 to 5 W on the middles of the corner pixels and of one by the centre: each has its own, and no other any."""
    num, side = 8192, 10.0
    lit = [(0, 0), (num - 1, 0), (0, num - 1), (num - 1, num - 1), (num // 2, num // 2)]

    def middle(index: int) -> float:
        return (index + 0.5) * (side / num) - side / 2.0

    sources = [pencil(frame(x=middle(x), y=middle(y)), total_flux=i + 1.0) for i, (x, y) in enumerate(lit)]
    readings = [Reading(f"({x}, {y})", pixel("screen", x, y), lambda n, flux=i + 1: mpf(flux), size=mpf(i + 1))
                for i, (x, y) in enumerate(lit)]
    readings.append(Reading("lit pixels", {"detector": "screen", "take": "lit"}, lambda n: mpf(len(lit))))
    # Rays that no number of them shares among the sources by their flux: weights differ, and so do counts and sums.
    return Case(f"five pixels of {num} x {num}", "pixels",
                scene(sources, [], [pixels("screen", frame(z=5.0), side, num)]), readings, num_rays=53)


def weights() -> Iterator[Case]:
    probability = 0.9999
    face = boundary("face", disk(5.0), frame(z=1.0), "", "glass")
    screens = [database("behind", frame(z=5.0), 10.0), database("before", frame(z=-5.0), 10.0)]
    document = scene([pencil(frame())], [face], screens, {"glass": (1.5, 0.0)}, reflect_prob=probability)
    rays = 200_000

    def heavy(n: Numbers) -> mpf:
        return transmittance(mpf(1), n["n"], mpf(1)) / (1 - n["p"])

    share = transmittance(mpf(1), mpf(1.5), mpf(1))
    sigma = share * sqrt(1 / ((1 - mpf(probability)) * rays))
    yield Case("importance weights of 1e4", "weights", document,
               [Reading("weight", column("behind", "weight"), heavy, size=mpf(10) ** 4),
                Reading("T", total("behind"), expected=share, sigma=sigma)],
               {"n": Number(mpf(1.5)), "p": Number(mpf(probability))}, num_rays=rays)
    for start in (0.0, 0.4):
        yield roulette(start)


def roulette(start: float) -> Case:
    """Between mirrors of R = 1/2 a detector reads 1 + R + R^2 + ... = 2 in passing, with and without roulette."""
    rays, depth = 100_000, 80
    mirrors = [mirror("far", disk(50.0), frame(z=5.0), 0.5), mirror("near", disk(50.0), frame(z=-5.0), 0.5)]
    source = pencil(frame(), half_angle_deg=0.0)
    document = scene([source], mirrors, [pixels("screen", frame(z=2.0), 100.0, 1, absorb=False)])
    document["nsq_gpu"]["sampling"]["rr_start_flux"] = start

    def moments(weight: float, events: int, at_mirror: bool) -> tuple[float, float]:
        """Mean and mean square of what a ray of this weight still brings, about to meet a mirror or the detector."""
        if events == 0 or weight < 1e-14:
            return 0.0, 0.0
        read = 0.0 if at_mirror else weight
        after = 0.5 * weight if at_mirror else weight
        survival = min(max(after / start, 0.05), 1.0) if 0.0 < after < start else 1.0
        mean, square = moments(after / survival, events - 1, not at_mirror)
        return read + survival * mean, read**2 + 2 * read * survival * mean + survival * square

    mean, square = moments(1.0, depth, False)
    sigma = math.sqrt(max(square - mean**2, 0.0) / rays) + 2.0**-20
    name = f"roulette below {start:g}" if start else "without roulette"
    return Case(f"cavity of R = 1/2, {name}", "weights", document,
                [Reading("flux read", total("screen"), expected=mpf(mean), sigma=mpf(sigma))],
                num_rays=rays, max_depth=depth)


GROUPS: list[Callable[[], Iterator[Case]]] = [
    grazing, critical_angle, cement, tangents, thin_plates, contacts, cemented, long_radii, far_away, caps,
    second_sheets, conic_constants, aperture_edges, births, polygons, deep_cavity, kaleidoscopes, spectra, fluxes,
    pixel_counts, weights,
]


# From cases to the file.


def interval(case: Case, reading: Reading, tier: str) -> tuple[list[float], bool]:
    """Return what a tier may read: the exact value, and what roundings of the scene's numbers make of it.

    The second value is true where these roundings may also leave nothing to be read.
    """
    if reading.exact is None:
        assert reading.sigma is not None
        reach = SIGMAS * reading.sigma
        return [float(reading.expected - reach), float(reading.expected + reach)], False
    values = {name: number.value for name, number in case.numbers.items()}
    exact = reading.exact(values)
    low = high = exact
    nothing = False
    for name, number in case.numbers.items():
        size = abs(number.value) if number.size is None else number.size
        step = ROUNDINGS * case.events * (EPSILON[tier] * size + EPSILON["f64"] * number.written)
        changed = [number.value + share * step for share in (-1, -0.5, -0.1, 0.1, 0.5, 1)]
        # The number as f32 holds it; of indices that are the same in f32, both move together.
        held = {other: _in_tier(value, tier) for other, value in values.items()}
        found = [reading.exact({**values, name: value}) for value in changed] + [reading.exact(held)]
        nothing |= any(value is None for value in found)
        moved = [value - exact for value in found if value is not None]
        low += min(0, *moved)
        high += max(0, *moved)
    slack = ROUNDINGS * EPSILON[tier] * reading.size
    return [float(low - slack), float(high + slack)], nothing


def _in_tier(value: mpf, tier: str) -> mpf:
    if tier == "f64":
        return value
    high = np.float32(float(value))
    return mpf(float(high)) if tier == "f32" else mpf(float(high)) + mpf(float(np.float32(float(value - mpf(float(high))))))


def expected(case: Case, reading: Reading) -> float:
    if reading.exact is None:
        return float(reading.expected)
    return float(reading.exact({name: number.value for name, number in case.numbers.items()}))


def written(case: Case) -> Json:
    readings = [{
        "name": reading.name,
        **reading.source,
        "expected": expected(case, reading),
        "by_chance": reading.exact is None,
        **{tier: interval(case, reading, tier)[0] for tier in EPSILON},
        "nothing": [tier for tier in EPSILON if interval(case, reading, tier)[1]],
    } for reading in case.readings]
    reference = measured(case) if case.reference else {"not_run": True}
    for reading, value in zip(readings, reference.get("values", []), strict=False):
        reading["reference"] = value
    refused = reference.get("refused")
    return {"name": case.name, "group": case.group, "num_rays": case.num_rays, "max_depth": case.max_depth,
            "refused": case.refused, "reference_refused": refused,
            "reference_not_run": not case.reference, "readings": readings, "scene": case.scene}


def measured(case: Case) -> Json:
    """What Optiland's NumPy backend reads, or why it does not."""
    try:
        live = oracle.scene_from_dict(case.scene)
        result = oracle.trace(live, oracle.detector_kinds(case.scene), case.num_rays, 0, max_depth=case.max_depth,
                              min_flux_fraction=0.0)
    except Exception as error:  # noqa: BLE001  any refusal belongs in the table
        return {"refused": f"{type(error).__name__}: {error}"[:200]}
    return {"values": [read(case, reading.source, result) for reading in case.readings]}


def read(case: Case, source: Json, result: Json) -> float | None:
    if "field" in source:
        return float(result[source["field"]])
    detector = result["detectors"][source["detector"]]
    if source["take"] == "total":
        return float(detector["total_flux"])
    if source["take"] == "lit":
        return float(np.count_nonzero(detector["irradiance"]))
    if source["take"] == "pixel":
        x, y = source["pixel"]
        num_y, num_x = detector["irradiance"].shape
        screen = next(screen for screen in case.scene["detectors"] if screen["name"] == source["detector"])
        return float(detector["irradiance"][y, x] * (screen["width"] / num_x * (screen["height"] / num_y)))
    rows = detector["num_rays_hit"]
    if rows == 0:
        return None
    values = detector["flux" if source["column"] == "weight" else source["column"]]
    if source["column"] == "weight":
        values = values * (case.num_rays / result["total_flux_in"])
    return float(values[-1] if source["take"] == "last" else values.mean())


def main(names: list[str]) -> None:
    warnings.simplefilter("ignore")
    known = {case["name"]: case for case in json.loads(CASES.read_text())["cases"]} if CASES.exists() and names else {}
    cases = []
    for group in GROUPS:
        for case in group():
            fresh = not names or any(name in (case.name, case.group) for name in names) or case.name not in known
            cases.append(written(case) if fresh else known[case.name])
            if fresh:
                print(case.name, [(r["name"], r["expected"], r["f32"], r["f64"], r.get("reference")) for r in
                                  cases[-1]["readings"]], cases[-1]["reference_refused"] or "", flush=True)
    lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in cases)
    CASES.parent.mkdir(parents=True, exist_ok=True)
    CASES.write_text(f'{{"roundings":{ROUNDINGS},"sigmas":{SIGMAS},"cases":[\n{lines}\n]}}\n', encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
