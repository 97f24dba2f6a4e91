"""Optics with 60 digits: what the cases of ``make_stability`` are compared with.

Vectors are lists of three ``mpf``, lengths in mm. The formulas are the textbook's, cancellations and all: at 60 digits
they do no harm, and they are not the forms that the tracer evaluates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from mpmath import matrix, mp, mpf, sqrt

mp.dps = 60

Vector = list[mpf]


def dot(a: Vector, b: Vector) -> mpf:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def along(a: Vector, t: mpf, b: Vector) -> Vector:
    """Return a + t b."""
    return [x + t * y for x, y in zip(a, b, strict=True)]


def unit(a: Vector) -> Vector:
    length = sqrt(dot(a, a))
    return [x / length for x in a]


@dataclass(frozen=True)
class Ray:
    position: Vector
    direction: Vector
    weight: mpf = mpf(1)


@dataclass(frozen=True)
class Conic:
    """Curvature 1/R, conic constant K, and the vertex's z on the axis."""

    curvature: mpf
    conic: mpf
    z: mpf

    def crossing(self, ray: Ray, accept: Callable[[mpf], bool] = lambda t: t > 0) -> mpf | None:
        """Return the nearest accepted distance to the sheet through the vertex."""
        c, k = self.curvature, 1 + self.conic
        p, d = [ray.position[0], ray.position[1], ray.position[2] - self.z], ray.direction
        quadratic = c * (d[0] ** 2 + d[1] ** 2 + k * d[2] ** 2)
        linear = c * (p[0] * d[0] + p[1] * d[1] + k * p[2] * d[2]) - d[2]
        constant = c * (p[0] ** 2 + p[1] ** 2 + k * p[2] ** 2) - 2 * p[2]
        found = [t for t in roots(quadratic, linear, constant)
                 if accept(t) and 1 - k * c * (p[2] + t * d[2]) >= 0]
        return min(found) if found else None

    def normal(self, point: Vector) -> Vector:
        c = self.curvature
        return unit([-c * point[0], -c * point[1], 1 - (1 + self.conic) * c * (point[2] - self.z)])


@dataclass(frozen=True)
class Sphere:
    """A sphere about a point, its normal inward."""

    radius: mpf
    centre: Vector

    def crossing(self, ray: Ray, accept: Callable[[mpf], bool] = lambda t: t > 0) -> mpf | None:
        p = along(ray.position, mpf(-1), self.centre)
        found = [t for t in roots(mpf(1), dot(p, ray.direction), dot(p, p) - self.radius**2) if accept(t)]
        return min(found) if found else None

    def normal(self, point: Vector) -> Vector:
        return unit([c - x for c, x in zip(self.centre, point, strict=True)])


def roots(a: mpf, b: mpf, c: mpf) -> list[mpf]:
    """Solve a t^2 + 2 b t + c = 0 in real numbers."""
    if a == 0:
        return [] if b == 0 else [-c / (2 * b)]
    discriminant = b * b - a * c
    if discriminant < 0:
        return []
    return [(-b - sqrt(discriminant)) / a, (-b + sqrt(discriminant)) / a]


def reflected(direction: Vector, normal: Vector) -> Vector:
    return along(direction, -2 * dot(direction, normal), normal)


def refracted(direction: Vector, normal: Vector, n1: mpf, n2: mpf) -> Vector | None:
    """Refract by Snell's law; None beyond the critical angle."""
    cosine = dot(direction, normal)
    n = normal if cosine > 0 else [-x for x in normal]
    cosine, eta = abs(cosine), n1 / n2
    square = 1 - eta * eta * (1 - cosine * cosine)
    if square < 0:
        return None
    return unit([eta * d + (sqrt(square) - eta * cosine) * x for d, x in zip(direction, n, strict=True)])


def transmittance(n1: mpf, n2: mpf, cosine: mpf) -> mpf:
    """Return the unpolarised transmittance by Fresnel; 0 beyond the critical angle."""
    square = 1 - (n1 / n2) ** 2 * (1 - cosine * cosine)
    if square < 0:
        return mpf(0)
    inside = sqrt(square)
    product = 4 * n1 * n2 * cosine * inside
    return (product / (n1 * cosine + n2 * inside) ** 2 + product / (n2 * cosine + n1 * inside) ** 2) / 2


def at(ray: Ray, distance: mpf) -> Ray:
    return replace(ray, position=along(ray.position, distance, ray.direction))


def pass_surface(ray: Ray, shape: Conic | Sphere, n1: mpf, n2: mpf, **where: Callable[[mpf], bool]) -> Ray:
    """Move a ray to a surface and refract it there."""
    moved = at(ray, _met(shape.crossing(ray, **where)))
    normal = shape.normal(moved.position)
    direction = refracted(moved.direction, normal, n1, n2)
    if direction is None:
        raise ValueError("totally reflected")
    weight = moved.weight * transmittance(n1, n2, abs(dot(moved.direction, normal)))
    return Ray(moved.position, direction, weight)


def reflect_off(ray: Ray, shape: Conic | Sphere, **where: Callable[[mpf], bool]) -> Ray:
    """Move a ray to a mirror and reflect it there."""
    moved = at(ray, _met(shape.crossing(ray, **where)))
    return replace(moved, direction=reflected(moved.direction, shape.normal(moved.position)))


def to_plane(ray: Ray, z: mpf) -> Ray:
    """Move a ray to the plane at this z."""
    return at(ray, (z - ray.position[2]) / ray.direction[2])


def _met(distance: mpf | None) -> mpf:
    if distance is None:
        raise ValueError("the surface is not met")
    return distance


def rotation(rx: float, ry: float, rz: float) -> matrix:
    """Return Rz Ry Rx of angles that are doubles, with their exact sines."""
    from mpmath import cos, sin

    x, y, z = mpf(rx), mpf(ry), mpf(rz)
    about_x = matrix([[1, 0, 0], [0, cos(x), -sin(x)], [0, sin(x), cos(x)]])
    about_y = matrix([[cos(y), 0, sin(y)], [0, 1, 0], [-sin(y), 0, cos(y)]])
    about_z = matrix([[cos(z), -sin(z), 0], [sin(z), cos(z), 0], [0, 0, 1]])
    return about_z * about_y * about_x


def turned(r: matrix, v: Vector) -> Vector:
    return list(r * matrix(v))
