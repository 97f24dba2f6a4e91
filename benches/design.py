"""Optimisation: do errors of gradients hold, do both kinds of gradients agree, and what do methods cost?

    python benches/design.py                    all three, in some fifty minutes on two cores
    python benches/design.py --seeds 200        errors over fewer seeds
    python benches/design.py --only methods     one part: errors, agreement or methods

With `.venv-torch/bin/python`, methods has rows of Optiland's TorchBackend, too.

The scene is a singlet in parallel light, whose rim the light keeps clear of, and a screen before its focus. Variables are the first
radius and the place of the screen. The merit is the flux within a circle, and how even the light is.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
#: Pixels a side of the screen of methods.
FINE = 512
#: Range of the screen's place of methods.
PLACES = (50.0, 62.0)
#: Range of the first radius, for the smallest spot 52 mm behind the lens.
RADII = (38.0, 66.0)
#: Rays of each trace where TorchBackend is compared.
TORCH_RAYS = 20_000


def singlet(pixels: int = 64, r1: Any = 60.0, z: Any = 52.0) -> NSQScene:
    """Return the scene, with so many pixels a side. The radius and the place of the screen may be tensors."""
    scene = NSQScene()
    scene.add_source("beam", CoordinateSystem(z=-20.0), CollimatedSourceConfig(Spectrum([0.55], [1.0]), aperture_radius=8.0))
    scene.add_lens("L", CoordinateSystem(), LensConfig(r1, -60.0, 5.0, NSQMaterial(IdealMaterial(1.5168)), 14.0))
    scene.add_detector("image", CoordinateSystem(z=z), IrradianceDetectorConfig(4.0, 4.0, pixels, pixels, splat="bilinear"))
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
        return nsq_gpu.Problem(singlet(FINE), {"image.z": PLACES}, operand, seed=seed, num_rays=num_rays, blocks=BLOCKS, **options)

    judge = spot(999, 1_000_000)
    print(f"methods: image.z for the smallest spot, at most {max_rays:,} rays a trace; merit by 1,000,000 other rays")
    for label, method, options in [("L-BFGS-B, rays walked back", "L-BFGS-B", {"gradient": "reverse"}),
                                   ("L-BFGS-B, differences", "L-BFGS-B", {"gradient": "differences"}),
                                   ("Nelder-Mead", "Nelder-Mead", {}),
                                   ("differential_evolution", "differential_evolution", {})]:
        one = spot(0, 20_000, **options)
        begin = time.perf_counter()
        design = one.minimize(method, max_rays=max_rays)
        row(label, time.perf_counter() - begin, one.rays_so_far, "z", design.numbers["image.z"], judge)
    torch_methods(judge)


def row(label: str, seconds: float, num_rays: int, name: str, found: float, judge: nsq_gpu.Problem) -> None:
    """Print what a method needed, and how good it is."""
    merit = float(judge.value([found]))
    print(f"  {label:34}  {seconds:6.1f} s  {num_rays:>12,} rays  {name} = {found:.3f}  merit {merit:.3e}", flush=True)


def torch_methods(judge: nsq_gpu.Problem) -> None:
    """Print the same of Optiland's TorchBackend: over image.z, or why that has no row, and over L.r1."""
    if importlib.util.find_spec("torch") is None:
        print("  TorchBackend over image.z           no row: Torch is not installed here; .venv-torch/bin/python has it")
        return
    try:
        by_torch("TorchBackend over image.z", "z", 52.0, PLACES, judge)
    except RuntimeError as error:
        print(f"  TorchBackend over image.z           no row: {error}")

    def radius(seed: int, num_rays: int, **options: object) -> nsq_gpu.Problem:
        # TorchBackend keeps no light by its path, so the spot is one of all light.
        operand = RmsRadius(detector="image", target=0)
        return nsq_gpu.Problem(singlet(FINE), {"L.r1": RADII}, operand, seed=seed, num_rays=num_rays, blocks=BLOCKS, **options)

    judge = radius(999, 1_000_000)
    print(f"methods: L.r1 for the smallest spot of all light, {TORCH_RAYS:,} rays a trace; merit by 1,000,000 other rays")
    one = radius(0, TORCH_RAYS, gradient="reverse")
    begin = time.perf_counter()
    # TorchBackend finds no errors of the radius either.
    design = one.minimize("L-BFGS-B", max_rays=TORCH_RAYS, errors=False)
    row("L-BFGS-B, rays walked back", time.perf_counter() - begin, one.rays_so_far, "r1", design.numbers["L.r1"], judge)
    by_torch("L-BFGS-B, TorchBackend's autograd", "r1", 60.0, RADII, judge)


def by_torch(label: str, name: str, start: float, bounds: tuple[float, float], judge: nsq_gpu.Problem) -> None:
    """Print what SciPy's L-BFGS-B needs with merits and gradients of TorchBackend.

    Raises:
        RuntimeError: The merit is on no graph of the number.
    """
    import optiland.backend as be
    import scipy.optimize
    import torch
    from optiland.nonsequential.backends.torch_backend import TorchBackend

    low, high = bounds
    num_traces = 0

    def merit(share: float) -> Any:
        nonlocal num_traces
        num_traces += 1
        number = torch.tensor(low + share * (high - low), dtype=torch.float64, requires_grad=True)
        found = singlet(FINE, **{name: number}).trace(TORCH_RAYS, backend=TorchBackend(seed=0), seed=0).detectors["image"]
        return squared_radius(found, torch), number

    def scaled(scale: float) -> Callable[[Any], tuple[float, list[float]]]:
        def of(u: Any) -> tuple[float, list[float]]:
            found, number = merit(float(u[0]))
            slope = torch.autograd.grad(found, number)[0]
            return float(found) / scale, [float(slope) * (high - low) / scale]

        return of

    be.set_backend("torch")
    be.set_precision("float64")
    begin = time.perf_counter()
    try:
        first, _ = merit((start - low) / (high - low))
        if not first.requires_grad:
            raise RuntimeError(f"its result is on no graph of {name}: optiland.nonsequential's _get_transform makes NumPy arrays of places")
        options = {"method": "L-BFGS-B", "jac": True, "bounds": [(0.0, 1.0)], "tol": 1e-6}
        done = scipy.optimize.minimize(scaled(float(first)), [(start - low) / (high - low)], **options)
    finally:
        be.set_backend("numpy")
    taken = time.perf_counter() - begin
    row(label, taken, num_traces * TORCH_RAYS, name, low + float(done.x[0]) * (high - low), judge)


def squared_radius(found: Any, torch: Any) -> Any:
    """Return the mean square distance from the centroid of a map of TorchBackend, less what linear weights of pixels add."""
    flux = found.data.reshape(FINE, FINE)
    x, y = torch.as_tensor(found.x_coords)[None, :], torch.as_tensor(found.y_coords)[:, None]
    whole = flux.sum()
    centre = (flux * x).sum() / whole, (flux * y).sum() / whole
    pixel = float(x[0, 1] - x[0, 0])
    return (flux * (x**2 + y**2)).sum() / whole - centre[0]**2 - centre[1]**2 - pixel**2 / 3.0


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
