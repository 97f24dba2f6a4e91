"""Traces benchmark scenes with Mitsuba 3 and Embree: the peer of ``nsq-bench --against mitsuba``.

Says on stdout which versions it runs, then answers each line of stdin, both in JSON::

    {"scene": "scene.json", "num_rays": 1000000}  ->  {"num_rays": 1000000, "seconds": 0.1, "detected": 377000}

Mitsuba renders; what it has for a tracer of rays through optics is its search for the nearest surface. So this is a
kernel around that search, as its users write them: rays of one source (collimated, or extended with a cone), one search
each among all surfaces and the one detector, and a histogram of what the detector caught. A scene where a ray meets
anything that does not end it is refused, because this kernel does not go on from there. Arithmetic is in f32.

``seconds`` runs from the first draw to the histogram on the host; building the scene, and compiling, are apart.
"""

from __future__ import annotations

import json
import math
import platform
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")


class Case:
    """A scene, built once."""

    def __init__(self, document: dict[str, Any]) -> None:
        (self.source,) = document["sources"]
        (detector,) = document["detectors"]
        refuse_what_is_not_traced(self.source, detector)
        surfaces = document.get("nsq_gpu", {}).get("surfaces", [])
        ends = {f"s{i}": shape(surface) for i, surface in enumerate(surfaces)}
        mirrors = {f"m{i}": mirror(component) for i, component in enumerate(document["components"])}
        self.pixels = detector["num_pixels_x"]
        self.width = detector["width"]
        if (detector["height"], detector["num_pixels_y"]) != (self.width, self.pixels):
            raise ValueError("the detector is not square")
        self.scene = mi.load_dict({"type": "scene", **ends, **mirrors, "detector": square(detector)})
        (caught,) = (shape for shape in self.scene.shapes() if shape.id() == "detector")
        self.detector = mi.ShapePtr(caught)
        self.has_mirrors = bool(mirrors)

    def trace(self, num_rays: int, seed: int) -> tuple[float, int]:
        """Seconds, and the number of rays that the detector caught."""
        start = time.perf_counter()
        rays = self.rays(num_rays, seed)
        hit = self.scene.ray_intersect_preliminary(rays, coherent=False)
        is_caught = hit.is_valid() & (hit.shape == self.detector)
        where = rays(hit.t)
        column, row = (mi.UInt32((x / self.width + 0.5) * self.pixels) for x in (where.x, where.y))
        cell = dr.minimum(row, self.pixels - 1) * self.pixels + dr.minimum(column, self.pixels - 1)
        # What met a mirror is counted behind the last pixel.
        counted = hit.is_valid() if self.has_mirrors else is_caught
        counts = dr.zeros(mi.UInt32, self.pixels**2 + 1)
        dr.scatter_reduce(dr.ReduceOp.Add, counts, mi.UInt32(1), dr.select(is_caught, cell, self.pixels**2), counted)
        *histogram, met_mirrors = np.array(counts).tolist()
        seconds = time.perf_counter() - start
        if met_mirrors:
            raise ValueError("a ray met a mirror, from which this kernel does not go on")
        detected = sum(histogram)
        return seconds, detected

    def rays(self, num_rays: int, seed: int) -> Any:
        """Rays as Optiland's sources emit them, with Mitsuba's own draws."""
        draws = mi.PCG32(size=num_rays, initstate=dr.opaque(mi.UInt64, seed))
        u = [draws.next_float32() for _ in range(4)]
        radius = self.source["aperture_radius"] * dr.sqrt(u[0])
        sine, cosine = dr.sincos(2 * math.pi * u[1])
        origin = mi.Point3f(radius * cosine, radius * sine, self.source["cs"].get("z", 0.0))
        if self.source["type"] == "collimated":
            return mi.Ray3f(origin, mi.Vector3f(0, 0, 1))
        z = 1 - u[2] * (1 - math.cos(math.radians(self.source["half_angle_deg"])))
        across = dr.safe_sqrt(1 - z * z)
        sine, cosine = dr.sincos(2 * math.pi * u[3])
        return mi.Ray3f(origin, mi.Vector3f(across * cosine, across * sine, z))


def refuse_what_is_not_traced(source: dict[str, Any], detector: dict[str, Any]) -> None:
    """Sources and detectors stand on the axis and across it, and a detector ends rays."""
    off_axis = [cs.get(name, 0.0) for cs in (source["cs"], detector["cs"]) for name in ("x", "y", "rx", "ry", "rz")]
    if any(off_axis):
        raise ValueError("the source or the detector is off the axis or turned")
    if source["type"] not in ("collimated", "extended") or "aperture_radius" not in source:
        raise ValueError("the source is no disk")
    if detector["type"] != "irradiance" or not detector["absorb"]:
        raise ValueError("the detector is no irradiance map that ends rays")


def shape(surface: dict[str, Any]) -> Any:
    """A surface that ends every ray: a sphere or a mesh."""
    form = surface["shape"]
    if surface["interaction"] != "absorbing":
        raise ValueError("a surface does not absorb")
    place = [surface["cs"].get(axis, 0.0) for axis in "xyz"]
    if form["type"] == "sphere":
        return {"type": "sphere", "center": place, "radius": form["radius"]}
    vertices = np.array(form["vertices"], dtype=np.float32) + np.array(place, dtype=np.float32)
    faces = np.array(form["faces"], dtype=np.uint32)
    mesh = mi.Mesh("mesh", len(vertices), len(faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.ravel()
    parameters.update()
    return mesh


def mirror(component: dict[str, Any]) -> dict[str, Any]:
    """A flat mirror."""
    if component["type"] != "mirror" or math.isfinite(component["config"]["radius"]):
        raise ValueError("a component is no flat mirror")
    return {"type": "disk", "to_world": placed(component["cs"], component["config"]["aperture_radius"])}


def square(detector: dict[str, Any]) -> dict[str, Any]:
    """The detector's area."""
    return {"type": "rectangle", "to_world": placed(detector["cs"], 0.5 * detector["width"])}


def placed(cs: dict[str, float], scale: float) -> Any:
    """Scaled, then moved; what is turned is refused."""
    if any(cs.get(angle, 0.0) for angle in ("rx", "ry", "rz")):
        raise ValueError("a surface is turned")
    place = [cs.get(axis, 0.0) for axis in "xyz"]
    return mi.ScalarTransform4f().translate(place).scale([scale, scale, 1.0])


def main() -> None:
    """Answer until stdin ends."""
    answers, sys.stdout = sys.stdout, sys.stderr
    versions = {package: version(package) for package in ("mitsuba", "drjit")}
    print(json.dumps({**versions, "python": platform.python_version()}), file=answers, flush=True)
    text, case, seed = "", None, 0
    for line in sys.stdin:
        request = json.loads(line)
        scene = Path(request["scene"]).read_text(encoding="utf-8")
        if case is None or scene != text:
            text, case = scene, Case(json.loads(scene))
        seed += 1
        seconds, detected = case.trace(request["num_rays"], seed)
        answer = {"num_rays": request["num_rays"], "seconds": seconds, "detected": detected}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
