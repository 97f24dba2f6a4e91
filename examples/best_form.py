"""The lens of best form: which bending of a lens of index 1.5 gives the smallest spot of a distant point?

The script starts from a symmetric lens, whose shape factor is 0, and follows the gradient of traces. `--search` goes by traces
alone, without a gradient. At the end the script finds the best form once more, by exact rays of the meridian. Third-order theory
says 2 (n^2 - 1) / (n + 2) = 0.714 for a thin lens; this lens is 2 mm thick. The script needs Torch.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import optiland.backend as be
import torch
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import IdealMaterial
from optiland.nonsequential import (
    CollimatedSourceConfig,
    IrradianceDetectorConfig,
    LensConfig,
    NSQMaterial,
    NSQScene,
    Spectrum,
)
from optiland.nonsequential.backends import TorchBackend
from scipy.optimize import minimize

from nsq_gpu import NsqGpuBackend

INDEX = 1.5
FOCAL_LENGTH = 100.0
#: Radius of the beam, thickness of the lens, half the width of the image [mm].
BEAM, THICKNESS, HALF = 10.0, 2.0, 1.0
PIXELS = 64


def scene(shape: torch.Tensor, distance: torch.Tensor) -> NSQScene:
    """A lens of a shape factor (r2 + r1) / (r2 - r1), and an image so far behind it [mm]."""
    power = 1.0 / (FOCAL_LENGTH * (INDEX - 1.0))
    found = NSQScene()
    found.add_source("beam", CoordinateSystem(z=-10.0), CollimatedSourceConfig(
        Spectrum.monochromatic(0.55), total_flux=1.0, aperture_radius=BEAM))
    found.add_lens("lens", CoordinateSystem(z=0.0), LensConfig(
        r1=2.0 / (power * (shape + 1.0)), r2=2.0 / (power * (shape - 1.0)), thickness=THICKNESS,
        material=NSQMaterial(IdealMaterial(INDEX)), front_aperture_radius=1.2 * BEAM))
    found.add_detector("image", CoordinateSystem(z=distance), IrradianceDetectorConfig(
        width=2.0 * HALF, height=2.0 * HALF, num_pixels_x=PIXELS, num_pixels_y=PIXELS))
    return found


def mean_square_radius(data: torch.Tensor) -> torch.Tensor:
    """Of the light on the image [mm^2]."""
    centres = (torch.arange(PIXELS, dtype=torch.float64) + 0.5) * (2.0 * HALF / PIXELS) - HALF
    square = (centres[:, None] ** 2 + centres[None, :] ** 2).ravel()
    return (data * square).sum() / data.sum()


def radii(shape: float) -> tuple[float, float]:
    """Of a thin lens of the focal length [mm]."""
    power = 1.0 / (FOCAL_LENGTH * (INDEX - 1.0))
    return 2.0 / (power * (shape + 1.0)), 2.0 / (power * (shape - 1.0))


def smallest_square(shape: float) -> float:
    """The mean square radius of the spot at its best distance [mm^2], by exact rays of the meridian."""
    # Rays at equal steps of the square of their height stand for equal areas.
    y = BEAM * np.sqrt((np.arange(2000) + 0.5) / 2000)
    z, sine, cosine = np.zeros_like(y), np.zeros_like(y), np.ones_like(y)
    for radius, vertex, n1, n2 in ((radii(shape)[0], 0.0, 1.0, INDEX), (radii(shape)[1], THICKNESS, INDEX, 1.0)):
        # The crossing with the sphere about (vertex + radius, 0), the one near the vertex.
        dz, dy = z - vertex - radius, y
        along = dz * cosine + dy * sine
        t = -along - np.sign(radius) * np.sqrt(along**2 - (dz**2 + dy**2 - radius**2))
        z, y = z + t * cosine, y + t * sine
        # The normal points along the ray; n1 sin i = n2 sin t.
        nz, ny = -(z - vertex - radius) / radius, -y / radius
        cos_i = nz * cosine + ny * sine
        cos_t = np.sqrt(1.0 - (n1 / n2) ** 2 * (1.0 - cos_i**2))
        cosine, sine = (n1 / n2 * cosine + (cos_t - n1 / n2 * cos_i) * nz, n1 / n2 * sine + (cos_t - n1 / n2 * cos_i) * ny)
    slope = sine / cosine
    at_0 = y - slope * z
    # The mean of (at_0 + slope x)^2 is smallest at x = -mean(at_0 slope) / mean(slope^2).
    x = -np.mean(at_0 * slope) / np.mean(slope**2)
    return float(np.mean((at_0 + slope * x) ** 2))


def best_form() -> float:
    """The shape factor of the smallest spot: a golden-section search."""
    low, high = 0.0, 1.0 - 1e-6
    while high - low > 1e-6:
        step = 0.6180339887498949 * (high - low)
        low, high = (low, low + step) if smallest_square(high - step) < smallest_square(low + step) else (high - step, high)
    return 0.5 * (low + high)


def parameters_of(options: argparse.Namespace) -> list[torch.Tensor]:
    """The start: a symmetric lens, and where the image stands [mm]."""
    start = (0.0, FOCAL_LENGTH if options.image is None else options.image)
    is_free = (True, options.image is None)
    return [torch.tensor(value, dtype=torch.float64, requires_grad=free) for value, free in zip(start, is_free)]


def show(num_traces: int, options: argparse.Namespace, values: list[float], loss: float, start: float) -> None:
    shape, distance = values
    print(f"{num_traces:3} traces, {num_traces * options.rays:9,} rays, {time.perf_counter() - start:5.1f} s: "
          f"shape factor {shape:7.4f}, image at {distance:8.4f} mm, RMS radius {1e3 * loss ** 0.5:6.2f} um")


def follow_gradient(loss_of: Callable[..., torch.Tensor], options: argparse.Namespace) -> None:
    """Adam: each step is a trace, and a trace back."""
    values = parameters_of(options)
    free = [value for value in values if value.requires_grad]
    optimizer = torch.optim.Adam(free, lr=0.05)
    start = time.perf_counter()
    for step in range(options.steps + 1):
        optimizer.zero_grad()
        loss = loss_of(*values)
        if step % 20 == 0 or step == options.steps:
            show(step + 1, options, [value.item() for value in values], loss.item(), start)
        loss.backward()
        optimizer.step()


def search(loss_of: Callable[..., torch.Tensor], options: argparse.Namespace) -> None:
    """Nelder and Mead's simplex, which needs no gradient."""
    values = parameters_of(options)
    num_free = sum(value.requires_grad for value in values)
    values = [value.detach() for value in values]
    num_traces = 0
    start = time.perf_counter()

    def loss(free: np.ndarray) -> float:
        nonlocal num_traces
        num_traces += 1
        values[:num_free] = torch.tensor(free, dtype=torch.float64)
        value = loss_of(*values).item()
        if num_traces % 20 == 1:
            show(num_traces, options, [value.item() for value in values], value, start)
        return value

    # A first simplex as wide as ten steps of the gradient's way.
    first = np.array([value.item() for value in values[:num_free]])
    simplex = np.vstack([first, first + 0.5 * np.eye(num_free)])
    found = minimize(loss, first, method="Nelder-Mead",
                     options={"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-10, "maxfev": options.steps + 1})
    values[:num_free] = torch.tensor(found.x, dtype=torch.float64)
    show(num_traces, options, [value.item() for value in values], found.fun, start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", type=int, default=20_000, help="rays of a trace")
    parser.add_argument("--steps", type=int, default=120, help="steps of the gradient, or traces of the search")
    parser.add_argument("--image", type=float, help="keep the image so many mm behind the lens, and bend the lens alone")
    parser.add_argument("--torch", action="store_true",
                        help="trace by Optiland's TorchBackend, which cannot move the image: it stays at --image, or at 100 mm")
    parser.add_argument("--search", action="store_true", help="search without a gradient: Nelder and Mead's simplex")
    options = parser.parse_args()
    if options.image is not None and not 95.0 <= options.image <= 105.0:
        parser.error(f"--image {options.image:g}: the light spreads beyond the image; give 95 to 105 mm")
    be.set_backend("torch")
    be.set_precision("float64")
    backend: Any
    if options.torch:
        options.image = FOCAL_LENGTH if options.image is None else options.image
        backend = TorchBackend(seed=1)
    else:
        # Only the light that passes straight through: ghosts are no part of the spot.
        backend = NsqGpuBackend(seed=1, precision="f64", where="reflections == 0")

    def loss_of(shape: torch.Tensor, distance: torch.Tensor) -> torch.Tensor:
        result = backend.trace(scene(shape, distance), options.rays, max_depth=8)
        return mean_square_radius(result.detectors["image"].data)

    (search if options.search else follow_gradient)(loss_of, options)
    best = best_form()
    print(f"best form by exact rays and a search: {best:.4f}, RMS radius {1e3 * smallest_square(best) ** 0.5:.2f} um; "
          f"of a thin lens: {2.0 * (INDEX**2 - 1.0) / (INDEX + 2.0):.4f}")


if __name__ == "__main__":
    main()
