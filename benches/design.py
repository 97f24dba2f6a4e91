"""Optimisation: do errors of gradients hold, do both kinds of gradients agree, and what do methods cost?

    python benches/design.py                    all three, in some fifty minutes on two cores
    python benches/design.py --seeds 200        errors over fewer seeds
    python benches/design.py --only methods     one part: errors, agreement or methods

The scene is a singlet in parallel light, whose rim the light keeps clear of, and a screen before its focus. Variables are the first
radius and the place of the screen. The merit is the flux within a circle, and how even the light is.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import scipy.stats

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))

import nsq_gpu  # noqa: E402
from nsq_gpu.design import Flux, RmsRadius, Uniformity  # noqa: E402
from optiland.coordinate_system import CoordinateSystem  # noqa: E402
from optiland.materials import IdealMaterial  # noqa: E402
from optiland.nonsequential import LensConfig, NSQMaterial, NSQScene  # noqa: E402
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig  # noqa: E402
from optiland.nonsequential.sources.base import Spectrum  # noqa: E402
from optiland.nonsequential.sources.configs import CollimatedSourceConfig  # noqa: E402

DIRECT = "reflections == 0"
VARIABLES = {"image.z": (50.0, 56.0), "L.r1": (55.0, 66.0)}
BLOCKS = 10


def singlet(pixels: int = 64) -> NSQScene:
    """Return the scene, with so many pixels a side."""
    scene = NSQScene()
    scene.add_source("beam", CoordinateSystem(z=-20.0), CollimatedSourceConfig(Spectrum([0.55], [1.0]), aperture_radius=8.0))
    scene.add_lens("L", CoordinateSystem(), LensConfig(60.0, -60.0, 5.0, NSQMaterial(IdealMaterial(1.5168)), 14.0))
    scene.add_detector("image", CoordinateSystem(z=52.0), IrradianceDetectorConfig(4.0, 4.0, pixels, pixels, splat="bilinear"))
    return scene


def problem(seed: int, num_rays: int, **options: object) -> nsq_gpu.Problem:
    """Return the problem of two operands."""
    operands = [Flux(detector="image", target=2.0, circle=(0.0, 0.0, 0.9), where=DIRECT),
                Uniformity(detector="image", target=1.0, kernel=0.1)]
    return nsq_gpu.Problem(singlet(), VARIABLES, operands, seed=seed, num_rays=num_rays, blocks=BLOCKS, **options)


def errors(num_seeds: int, num_rays: int) -> None:
    """Print how often 95 % intervals hold the truth, which the mean over all seeds stands for."""
    merits, slopes = [], []
    for seed in range(num_seeds):
        one = problem(1000 * seed, num_rays, gradient="reverse")
        value, gradient = one.value(), one.gradient()
        merits.append((value.value - value.bias, value.standard_error))
        slopes.append((gradient.values, gradient.standard_errors))
    width = scipy.stats.t.ppf(0.975, BLOCKS - 1)
    columns = [("merit", np.array(merits)[:, 0], np.array(merits)[:, 1])]
    columns += [(name, np.array([value[i] for value, _ in slopes]), np.array([error[i] for _, error in slopes]))
                for i, name in enumerate(VARIABLES)]
    print(f"errors: {num_seeds} seeds of {num_rays:,} rays, rays walked back; intervals of 95 %")
    for name, values, sigmas in columns:
        held = np.mean(np.abs(values - values.mean()) < width * sigmas)
        spread = values.std(ddof=1) / np.sqrt(np.mean(sigmas**2))
        print(f"  {name:10}  hold in {100 * held:.1f} %   spread over stated error {spread:.3f}")


def agreement(num_rays: int) -> None:
    """Print gradients of both kinds by many rays."""
    walked = problem(7, num_rays, gradient="reverse").gradient()
    found = problem(7, num_rays, gradient="differences").gradient()
    print(f"agreement: {num_rays:,} rays")
    for i, name in enumerate(VARIABLES):
        sigma = float(np.hypot(walked.standard_errors[i], found.standard_errors[i]))
        off = walked.values[i] - found.values[i]
        print(f"  {name:10}  walked back {walked.values[i]:.6g}   differences {found.values[i]:.6g}   "
              f"{off / sigma:+.1f} sigma, {100 * off / found.values[i]:+.2f} %")


def methods(max_rays: int) -> None:
    """Print what methods need for the smallest spot, each judged by draws that none has seen."""
    def spot(seed: int, num_rays: int, **options: object) -> nsq_gpu.Problem:
        operand = RmsRadius(detector="image", target=0, where=DIRECT)
        return nsq_gpu.Problem(singlet(512), {"image.z": (50.0, 62.0)}, operand, seed=seed, num_rays=num_rays, blocks=BLOCKS, **options)

    judge = spot(999, 1_000_000)
    print(f"methods: image.z for the smallest spot, at most {max_rays:,} rays a trace; merit by 1,000,000 other rays")
    for label, method, options in [("L-BFGS-B, rays walked back", "L-BFGS-B", {"gradient": "reverse"}),
                                   ("L-BFGS-B, differences", "L-BFGS-B", {"gradient": "differences"}),
                                   ("Nelder-Mead", "Nelder-Mead", {}),
                                   ("differential_evolution", "differential_evolution", {})]:
        one = spot(0, 20_000, **options)
        begin = time.perf_counter()
        design = one.minimize(method, max_rays=max_rays)
        taken = time.perf_counter() - begin
        print(f"  {label:28}  {taken:6.1f} s  {one.rays_so_far:>12,} rays  z = {design.numbers['image.z']:.3f}"
              f"  merit {float(judge.value(list(design.numbers.values()))):.3e}")


def main() -> None:
    """Run the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2000)
    parser.add_argument("--rays", type=float, default=1e8, help="rays of the agreement")
    parser.add_argument("--only", choices=["errors", "agreement", "methods"])
    asked = parser.parse_args()
    parts = {"errors": lambda: errors(asked.seeds, 8000), "agreement": lambda: agreement(int(asked.rays)),
             "methods": lambda: methods(320_000)}
    for name, part in parts.items():
        if asked.only in (None, name):
            part()


if __name__ == "__main__":
    main()
