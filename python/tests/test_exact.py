"""Where rays meet searched surfaces, against arithmetic of 40 digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpmath import chebyt, cos, findroot, lu_solve, matrix, mp, mpf, pi, sqrt
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.reflective import ReflectiveComponent
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.nonsequential.materials.nsq_material import VACUUM
from optiland.nonsequential.sources.configs import CollimatedSourceConfig, PointSourceConfig

from nsq_gpu.shapes import Biconic, Chebyshev, EvenAsphere, OddAsphere, Polynomial, Toroidal, Zernike
from tests import live

mp.dps = 40
RADIUS = 8.0


def conic(radius: float, constant: float, square: Any) -> Any:
    c = 1 / mpf(radius)
    return c * square / (1 + sqrt(1 - (1 + mpf(constant)) * c * c * square))


def even(x: Any, y: Any) -> Any:
    s = x * x + y * y
    return conic(30.0, -0.5, s) + mpf(1e-4) * s**2 - mpf(2e-6) * s**3


def odd(x: Any, y: Any) -> Any:
    s = x * x + y * y
    return conic(-40.0, 0.5, s) + mpf(0.02) * sqrt(s) - mpf(1e-3) * sqrt(s) ** 3


def toroid(x: Any, y: Any) -> Any:
    height, r = conic(50.0, -0.5, y * y) + mpf(1e-4) * y**2, mpf(-35)
    # Turned about z = r: (r - z)^2 + x^2 = (r - height)^2.
    return r + sqrt((r - height) ** 2 - x * x)


ROWS = [[0.0, 0.02, -1e-3], [0.03, 1e-3], [2e-3]]
WAVES = [[0.0, 0.1, -0.05], [0.05, 0.02, 0.01]]


def powers(x: Any, y: Any) -> Any:
    return conic(60.0, 0.0, x * x + y * y) + sum(mpf(c) * x**i * y**j for i, row in enumerate(ROWS) for j, c in enumerate(row))


def waves(x: Any, y: Any) -> Any:
    return conic(60.0, -0.5, x * x + y * y) + sum(
        mpf(c) * chebyt(i, x / 9) * chebyt(j, y / 10) for i, row in enumerate(WAVES) for j, c in enumerate(row))


def zernike(x: Any, y: Any) -> Any:
    u, v = x / 9, y / 9
    s = u * u + v * v
    # Fringe: tilt, power, astigmatism, coma, sphere.
    return conic(-70.0, 0.0, 81 * s) + mpf(0.05) * u + mpf(0.1) * (2 * s - 1) + mpf(0.03) * (u * u - v * v) + mpf(
        0.02) * (3 * s - 2) * v + mpf(0.01) * (6 * s * s - 6 * s + 1)


SURFACES: dict[str, tuple[Any, Callable[[Any, Any], Any]]] = {
    "even asphere": (EvenAsphere(30.0, -0.5, RADIUS, [0.0, 1e-4, -2e-6]), even),
    "odd asphere": (OddAsphere(-40.0, 0.5, RADIUS, [0.02, 0.0, -1e-3]), odd),
    "biconic": (Biconic(40.0, -30.0, RADIUS, 0.5, -1.0), lambda x, y: conic(40.0, 0.5, x * x) + conic(-30.0, -1.0, y * y)),
    "toroid": (Toroidal(-35.0, 50.0, RADIUS, -0.5, [1e-4]), toroid),
    "polynomial": (Polynomial(60.0, 0.0, RADIUS, ROWS), powers),
    "Chebyshev": (Chebyshev(60.0, -0.5, RADIUS, WAVES, 9.0, 10.0), waves),
    "Zernike": (Zernike(-70.0, 0.0, RADIUS, [0.0, 0.05, 0.0, 0.1, 0.03, 0.0, 0.0, 0.02, 0.01], "fringe", 9.0), zernike),
}


@pytest.mark.parametrize("distance", [15.0, 1e6])
@pytest.mark.parametrize("name", SURFACES)
def test_a_ray_meets_a_surface_to_a_few_units_in_the_last_place(name: str, distance: float) -> None:
    shape, sag = SURFACES[name]
    scene = NSQScene()
    scene.add_component("mirror", ReflectiveComponent(CoordinateSystem(), shape, 1.0, name="mirror"))
    half_angle = math.degrees(math.atan(0.9 * RADIUS / distance))
    lamp = PointSourceConfig(live.Spectrum(np.array([0.5]), np.array([1.0])), half_angle_deg=half_angle)
    scene.add_source("lamp", CoordinateSystem(x=0.3, y=-0.2, z=-distance), lamp)
    scene.add_detector("film", CoordinateSystem(z=-distance - 1.0), live.IrradianceDetectorConfig(1.0, 1.0, 2, 2))
    events = scene.trace(200, backend=live.backend(), record_paths=200).ray_paths["events"]
    births = {int(event["ray_id"]): event for event in events if event["event_type"] == "birth"}
    hits = [event for event in events if event["component_name"] == "mirror" and event["bounce"] <= 1]
    assert len(hits) > 100
    worst = 0.0
    for hit in hits:
        x, y, z = (mpf(float(hit[axis])) for axis in "xyz")
        born = births[int(hit["ray_id"])]
        largest = max(abs(float(event[axis])) for event in (hit, born) for axis in "xyz")
        step = mpf(10) ** -15
        slopes = [(sag(x + dx, y + dy) - sag(x - dx, y - dy)) / (2 * step) for dx, dy in ((step, 0), (0, step))]
        normal = np.array([-float(slopes[0]), -float(slopes[1]), 1.0])
        # Beside the surface; along the ray it is so much over the cosine of incidence.
        worst = max(worst, abs(float(z - sag(x, y))) / float(np.linalg.norm(normal)) / float(np.spacing(largest)))
    assert worst <= 8.0, f"{worst} units in the last place of the largest coordinate"


def test_a_toroid_has_two_foci() -> None:
    """A narrow beam onto a concave mirror comes together at half of each radius."""
    scene = NSQScene()
    shape = Toroidal(-40.0, -100.0, RADIUS)
    scene.add_component("mirror", ReflectiveComponent(CoordinateSystem(z=200.0), shape, 1.0, name="mirror"))
    width = 0.02
    beam = CollimatedSourceConfig(live.Spectrum(np.array([0.5]), np.array([1.0])), aperture_radius=width)
    scene.add_source("beam", CoordinateSystem(), beam)
    scene.add_detector("film", CoordinateSystem(z=-1.0), live.IrradianceDetectorConfig(50.0, 50.0, 2, 2))
    events = scene.trace(200, backend=live.backend(), record_paths=200).ray_paths["events"]
    ends = np.sort(events[(events["event_type"] == "hit") & (events["component_name"] == "")], order="ray_id")
    starts = np.sort(events[events["component_name"] == "mirror"], order="ray_id")
    assert len(ends) == len(starts) == 200
    for axis, cosine, radius in (("x", "L", 40.0), ("y", "M", 100.0)):
        # Along the reflected ray, from the mirror to where it crosses the axis.
        reach = -starts[axis] / ends[cosine]
        # Aberration is of the order of width^2 over the shorter focal length.
        np.testing.assert_allclose(reach * np.abs(ends["N"]), radius / 2.0, atol=width**2 / 20.0)


def test_a_cartesian_oval_images_a_point_to_a_point() -> None:
    """The path |P - object| + n |image - P| is one for all rays: the oval, written as a conic and its powers of r."""
    n, before, behind, radius = mpf(1.5), mpf(60), mpf(90), mpf(5)

    def height(square: Any) -> Any:
        return findroot(lambda z: sqrt((before + z) ** 2 + square) + n * sqrt((behind - z) ** 2 + square) - before - n * behind,
                        square / 40)

    # By the vertex: n / R - 1 / R = 1 / before + n / behind.
    vertex = (n - 1) / (1 / before + n / behind)
    nodes = [radius**2 * (1 - cos(pi * (2 * k + 1) / 20)) / 2 for k in range(10)]
    terms = matrix([[square ** (i + 1) for i in range(10)] for square in nodes])
    rest = matrix([height(square) - conic(vertex, 0.0, square) for square in nodes])
    coefficients = [float(value) for value in lu_solve(terms, rest)]
    shape = EvenAsphere(float(vertex), 0.0, float(radius), coefficients)
    scene = NSQScene()
    scene.add_component("oval", RefractiveComponent(CoordinateSystem(), shape, VACUUM, live.glass(1.5), name="oval"))
    lamp = PointSourceConfig(live.Spectrum(np.array([0.5]), np.array([1.0])), half_angle_deg=math.degrees(math.atan(0.07)))
    scene.add_source("lamp", CoordinateSystem(z=-60.0), lamp)
    scene.add_detector("image", CoordinateSystem(z=90.0), live.IrradianceDetectorConfig(1.0, 1.0, 2, 2))
    events = scene.trace(300, backend=live.backend(), record_paths=300).ray_paths["events"]
    ends = events[(events["event_type"] == "hit") & (events["component_name"] == "") & (events["bounce"] == 1)]
    assert len(ends) > 250
    assert np.hypot(ends["x"], ends["y"]).max() < 1e-9
