"""Stray light by aimed rays: one wall beside raysect's importance sampling, and beside an integral.

    pip install raysect==0.8.1.post1 "numpy<2"      # its wheel is of NumPy 1
    python benches/raysect_stray.py --binary target/release/nsq-gpu --rays 1e6

A square lamp and a square detector lie in one plane, and both face a wall that scatters by Lambert's law. raysect traces
backwards, from the detector, and its wall aims at the lamp. nsq-gpu traces forwards, from the lamp, and its wall aims at
the detector by ``scatter_to``. Each program is also run with plain rays.

Units. The lamp has the radiance L [W/m^2/sr]. raysect takes L per nm, over a band of 1 nm. nsq-gpu takes the flux
pi L (lamp's area) [W], and lengths in mm. raysect's pixel returns the flux [W], and irradiance is flux over the pixel's
area. nsq-gpu's is ``irradiance`` [W/mm^2] times 1e6. The integral is exact, by quadrature:

    E = R / pi * integral over the wall of (L * integral over the lamp of cos cos' / d^2) (mean over the detector of cos cos' / d^2)

Exit code 1 says that two of the three irradiances are more than four standard errors apart, or more than 2 %.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

#: Radiance of the lamp [W/m^2/sr], and reflectance of the wall.
RADIANCE, REFLECTANCE = 1.0, 0.5
#: Edges of wall, lamp and detector, how far the wall is, and how far lamp and detector are from the middle [m].
WALL, LAMP, DETECTOR, HEIGHT, ASIDE = 0.4, 0.02, 0.01, 0.3, 0.06
#: Share of the rays that the wall aims; how far apart two values may be: standard errors, and a share.
SHARE, MOST_ERRORS, MOST = 0.9, 4.0, 0.02


@dataclass(frozen=True)
class Found:
    """An irradiance [W/m^2], its standard error, and what it took."""

    name: str
    irradiance: float
    error: float
    rays: int = 0
    seconds: float = 0.0

    def __str__(self) -> str:
        return (f"| {self.name} | {self.irradiance:.4e} | {self.error:.1e} | {100 * self.error / self.irradiance:.2f} % | {self.rays:,} "
                f"| {self.seconds:.1f} |")


def integral() -> float:
    """Return the irradiance by quadrature; lamp, detector and wall are parallel, so that cos cos' / d^2 = h^2 / d^4."""
    def grid(edge: float, points: int, x: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        places, weights = np.polynomial.legendre.leggauss(points)
        u, v = np.meshgrid(x + 0.5 * edge * places, 0.5 * edge * places)
        return u.ravel(), v.ravel(), (0.25 * edge**2 * np.outer(weights, weights)).ravel()

    x, y, areas = grid(WALL, 80)

    def seen(edge: float, aside: float) -> np.ndarray:
        u, v, parts = grid(edge, 6, aside)
        squares = (x[:, None] - u) ** 2 + (y[:, None] - v) ** 2 + HEIGHT**2
        return np.asarray(HEIGHT**2 / squares**2 @ parts)

    return float(REFLECTANCE / math.pi * RADIANCE * areas @ (seen(LAMP, -ASIDE) * seen(DETECTOR, ASIDE)) / DETECTOR**2)


def by_raysect(samples: int, share: float) -> Found:
    """Return what raysect finds, in one process."""
    from raysect.core import Point3D, SerialEngine, translate
    from raysect.core.math.random import seed
    from raysect.optical import ConstantSF, World
    from raysect.optical.material import Lambert, UniformSurfaceEmitter
    from raysect.optical.observer import Pixel, PowerPipeline0D
    from raysect.primitive import Box

    seed(1)
    world, thin = World(), 1e-6
    wall = Box(Point3D(-WALL / 2, -WALL / 2, 0), Point3D(WALL / 2, WALL / 2, 0.01), world, translate(0, 0, HEIGHT))
    wall.material = Lambert(ConstantSF(REFLECTANCE))
    # The lamp's front is at z = 0. Its sides are too thin to matter, and the wall does not see its back.
    lamp = Box(Point3D(-LAMP / 2, -LAMP / 2, -thin), Point3D(LAMP / 2, LAMP / 2, 0), world, translate(-ASIDE, 0, 0))
    lamp.material = UniformSurfaceEmitter(ConstantSF(1.0), RADIANCE)
    lamp.material.importance = 1.0
    power = PowerPipeline0D(accumulate=False)
    pixel = Pixel([power], x_width=DETECTOR, y_width=DETECTOR, parent=world, transform=translate(ASIDE, 0, 0), pixel_samples=samples,
                  samples_per_task=10_000, spectral_bins=1, min_wavelength=549.5, max_wavelength=550.5, quiet=True,
                  render_engine=SerialEngine(), ray_importance_sampling=share > 0, ray_important_path_weight=share)
    started = time.perf_counter()
    pixel.observe()
    return Found("raysect, importance sampling" if share else "raysect, plain", power.value.mean / DETECTOR**2,
                 power.value.error() / DETECTOR**2, power.value.samples, time.perf_counter() - started)


def by_us(binary: str, rays: int, share: float) -> Found:
    """Return what the command finds."""
    sampling = {"scatter_to": [{"surface": "wall", "target": "floor", "share": share}]} if share else {}
    wall = {"name": "wall", "cs": {"z": 1e3 * HEIGHT}, "shape": {"type": "plane", "width": 1e3 * WALL, "height": 1e3 * WALL},
            "interaction": "reflective", "reflectance": REFLECTANCE, "bsdf": {"type": "lambertian"}, "scatter_fraction": 1.0}
    lamp = {"type": "extended", "name": "lamp", "cs": {"x": -1e3 * ASIDE}, "width": 1e3 * LAMP, "height": 1e3 * LAMP,
            "total_flux": math.pi * RADIANCE * LAMP**2, "spectrum": {"wavelengths": [0.55], "weights": [1.0]}}
    floor = {"type": "irradiance", "name": "floor", "cs": {"x": 1e3 * ASIDE}, "width": 1e3 * DETECTOR, "height": 1e3 * DETECTOR,
             "num_pixels_x": 1, "num_pixels_y": 1, "splat": "hard"}
    scene = {"nsq_schema_version": 1, "components": [], "sources": [lamp], "detectors": [floor],
             "nsq_gpu": {"version": 1, "surfaces": [wall], "sampling": sampling}}
    with tempfile.TemporaryDirectory() as folder:
        path, results = Path(folder, "scene.json"), Path(folder, "results")
        path.write_text(json.dumps(scene), encoding="utf-8")
        started = time.perf_counter()
        done = subprocess.run([binary, "trace", str(path), "-n", str(rays), "--standard-error", "on", "--no-pictures", "--progress",
                               "never", "-o", str(results)], capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
        if done.returncode:
            raise SystemExit(done.stderr.strip())
        arrays = dict(np.load(results / "floor.npz"))
    irradiance, error = (1e6 * float(arrays[key][0, 0]) for key in ("irradiance", "standard_error"))
    return Found("nsq-gpu, `scatter_to`" if share else "nsq-gpu, plain", irradiance, error, rays, time.perf_counter() - started)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default="nsq-gpu", help="the built command")
    parser.add_argument("--rays", type=float, default=1e6, help="rays of each program")
    given = parser.parse_args(arguments)
    if not importlib.util.find_spec("raysect"):
        print("SKIPPED: raysect is not installed")
        return 0
    rays = int(given.rays)
    aimed = [Found("integral", integral(), 0.0), by_raysect(rays, SHARE), by_us(given.binary, rays, SHARE)]
    print("| | W/m^2 | std. error | of it | rays | seconds |\n|---|---|---|---|---|---|")
    print("\n".join(map(str, [*aimed, by_raysect(rays, 0.0), by_us(given.binary, rays, 0.0)])) + "\n")
    holds = True
    for one, other in itertools.combinations(aimed, 2):
        apart, error = other.irradiance - one.irradiance, math.hypot(one.error, other.error)
        holds &= (near := abs(apart) <= min(MOST_ERRORS * error, MOST * one.irradiance))
        print(f"{other.name} beside {one.name}: {100 * apart / one.irradiance:+.2f} %, {apart / error:+.1f} standard errors"
              + ("" if near else ", off"))
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
