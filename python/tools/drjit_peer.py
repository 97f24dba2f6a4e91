"""Traces Optiland's benchmark lens with a Dr.Jit kernel written by hand: the peer of ``nsq-bench --against drjit``.

Says on stdout which versions it runs, then answers each line of stdin, both in JSON::

    {"scene": "scene.json", "num_rays": 1000000, "precision": "f32"}
        ->  {"num_rays": 1000000, "seconds": 0.01, "detected": 921500}

This is no off-the-shelf tool but the strongest rival on a processor that could be built: one kernel, compiled by LLVM, that
knows the scene's shape (a lens of two spherical caps and a rim, a collimated source before it, a detector behind it, all on
the axis), and the scene's numbers as constants. It takes what it pleases where this program may not: PCG32 with a stream for
each ray of the launch, the nearest pixel for a splat, an epsilon of 1e-3 mm before every surface, sums in floating point.

``seconds`` runs from the first draw to the histogram; compiling is apart.
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

# Dr.Jit's arrays of LLVM come with Mitsuba's variant.
import drjit as dr
import drjit.llvm as dl
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_mono")

REALS = {"f32": dl.Float32, "f64": dl.Float64}
MAX_DEPTH = 16
#: No nearer is searched for a surface [mm].
EPSILON = 1e-3
FRONT, BACK, DETECTOR, RIM = 1, 2, 3, 4


class Lens:
    """The numbers of the scene, in mm."""

    def __init__(self, document: dict[str, Any]) -> None:
        (lens,), (source,), (detector,) = document["components"], document["sources"], document["detectors"]
        config = lens["config"]
        self.radius, self.thickness = config["r1"], config["thickness"]
        self.aperture = config["front_aperture_radius"]
        self.index = document["nsq_gpu"]["media"][config["material"]["name"]]["n"]
        self.beam, self.source_z = source["aperture_radius"], source["cs"]["z"]
        self.detector_z, self.half_width = detector["cs"]["z"], detector["width"] / 2
        self.pixels = detector["num_pixels_x"]
        is_square = detector["height"] == detector["width"] and detector["num_pixels_y"] == self.pixels
        if config["r2"] != -self.radius or not is_square or source["type"] != "collimated":
            raise ValueError("this is not the lens that the kernel was written for")


@dr.syntax
def trace(lens: Lens, num_rays: int, seed: int, real: Any) -> Any:
    """The histogram of the detector, row by row."""
    radius, thickness, aperture, half_width = lens.radius, lens.thickness, lens.aperture, lens.half_width
    draws = dl.PCG32(num_rays, dr.opaque(dl.UInt64, seed))
    distance = real(lens.beam) * dr.sqrt(real(draws.next_float32()))
    sine, cosine = dr.sincos(real(2 * math.pi) * real(draws.next_float32()))
    x, y, z = distance * cosine, distance * sine, real(lens.source_z)
    dx, dy, dz = real(0), real(0), real(1)
    histogram = dr.zeros(real, lens.pixels**2)
    active, inside, depth = dl.Bool(True), dl.Bool(False), dl.UInt32(0)
    while active & (depth < MAX_DEPTH):
        best, kind = real(1e30), dl.UInt32(0)
        # The front cap.
        centre = z - radius
        b = dx * x + dy * y + dz * centre
        discriminant = b * b - (x * x + y * y + centre * centre - radius * radius)
        root = dr.sqrt(dr.maximum(discriminant, 0))
        near, far = -b - root, -b + root
        hz, hx, hy = z + near * dz, x + near * dx, y + near * dy
        on = (discriminant > 0) & (near > EPSILON) & (hz < radius * 0.5) & (hx * hx + hy * hy <= aperture * aperture)
        best, kind = dr.select(on, near, best), dr.select(on, FRONT, kind)
        hz, hx, hy = z + far * dz, x + far * dx, y + far * dy
        on = (discriminant > 0) & (far > EPSILON) & (far < best)
        on &= (hz < radius * 0.5) & (hx * hx + hy * hy <= aperture * aperture)
        best, kind = dr.select(on, far, best), dr.select(on, FRONT, kind)
        # The back cap.
        centre = z - (thickness - radius)
        b = dx * x + dy * y + dz * centre
        discriminant = b * b - (x * x + y * y + centre * centre - radius * radius)
        root = dr.sqrt(dr.maximum(discriminant, 0))
        near, far = -b - root, -b + root
        hz, hx, hy = z + near * dz, x + near * dx, y + near * dy
        on = (discriminant > 0) & (near > EPSILON) & (near < best)
        on &= (hz > thickness - radius * 0.5) & (hx * hx + hy * hy <= aperture * aperture)
        best, kind = dr.select(on, near, best), dr.select(on, BACK, kind)
        hz, hx, hy = z + far * dz, x + far * dx, y + far * dy
        on = (discriminant > 0) & (far > EPSILON) & (far < best)
        on &= (hz > thickness - radius * 0.5) & (hx * hx + hy * hy <= aperture * aperture)
        best, kind = dr.select(on, far, best), dr.select(on, BACK, kind)
        # The detector.
        to_plane = (lens.detector_z - z) / dz
        hx, hy = x + to_plane * dx, y + to_plane * dy
        on = (to_plane > EPSILON) & (to_plane < best) & (dr.abs(hx) < half_width) & (dr.abs(hy) < half_width)
        best, kind = dr.select(on, to_plane, best), dr.select(on, DETECTOR, kind)
        # The rim.
        a, b = dx * dx + dy * dy, x * dx + y * dy
        discriminant = b * b - a * (x * x + y * y - aperture * aperture)
        to_rim = (-b + dr.sqrt(dr.maximum(discriminant, 0))) / dr.maximum(a, 1e-12)
        hz = z + to_rim * dz
        on = inside & (discriminant > 0) & (to_rim > EPSILON) & (to_rim < best) & (hz > 0) & (hz < thickness)
        best, kind = dr.select(on, to_rim, best), dr.select(on, RIM, kind)
        x += best * dx
        y += best * dy
        z += best * dz
        if kind == DETECTOR:
            scale = real(lens.pixels / (2 * half_width))
            column, row = dl.UInt32((x + half_width) * scale), dl.UInt32((y + half_width) * scale)
            cell = dr.minimum(row, lens.pixels - 1) * lens.pixels + dr.minimum(column, lens.pixels - 1)
            dr.scatter_reduce(dr.ReduceOp.Add, histogram, real(1), cell)
        # Fresnel's law, one branch drawn.
        refracts = (kind == FRONT) | (kind == BACK)
        centre = dr.select(kind == FRONT, real(radius), real(thickness - radius))
        inverse = real(1 / radius)
        nx, ny, nz = x * inverse, y * inverse, (z - centre) * inverse
        incident = -(dx * nx + dy * ny + dz * nz)
        sign = dr.select(incident < 0, real(-1), real(1))
        nx, ny, nz, incident = nx * sign, ny * sign, nz * sign, incident * sign
        eta = dr.select(inside, real(lens.index), real(1 / lens.index))
        sine_squared = eta * eta * (1 - incident * incident)
        refracted = dr.sqrt(dr.maximum(1 - sine_squared, 0))
        across = (eta * incident - refracted) / (eta * incident + refracted)
        along = (incident - eta * refracted) / (incident + eta * refracted)
        reflectance = dr.select(sine_squared >= 1, real(1), real(0.5) * (across * across + along * along))
        reflects = real(draws.next_float32()) < reflectance
        k = eta * incident - refracted
        dx = dr.select(refracts, dr.select(reflects, dx + 2 * incident * nx, eta * dx + k * nx), dx)
        dy = dr.select(refracts, dr.select(reflects, dy + 2 * incident * ny, eta * dy + k * ny), dy)
        dz = dr.select(refracts, dr.select(reflects, dz + 2 * incident * nz, eta * dz + k * nz), dz)
        inside = dr.select(refracts, inside ^ (~reflects), inside)
        active = refracts
        depth += 1
    return histogram


def timed(lens: Lens, num_rays: int, seed: int, precision: str) -> tuple[float, int]:
    """Seconds, and the number of rays that the detector caught."""
    start = time.perf_counter()
    histogram = trace(lens, num_rays, seed, REALS[precision])
    dr.eval(histogram)
    dr.sync_thread()
    seconds = time.perf_counter() - start
    return seconds, round(float(np.array(histogram).sum(dtype=np.float64)))


def main() -> None:
    """Answer until stdin ends."""
    answers, sys.stdout = sys.stdout, sys.stderr
    versions = {package: version(package) for package in ("drjit", "mitsuba")}
    print(json.dumps({**versions, "python": platform.python_version()}), file=answers, flush=True)
    seed = 0
    for line in sys.stdin:
        request = json.loads(line)
        lens = Lens(json.loads(Path(request["scene"]).read_text(encoding="utf-8")))
        seed += 1
        seconds, detected = timed(lens, request["num_rays"], seed, request["precision"])
        answer = {"num_rays": request["num_rays"], "seconds": seconds, "detected": detected}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
