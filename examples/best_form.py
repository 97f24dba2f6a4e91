"""The lens of best form: which bending of a lens of index 1.5 gives the smallest spot of a distant point?

The answer of third-order theory for a thin lens is a shape factor of 2 (n^2 - 1) / (n + 2) = 0.714. This lens is 2 mm thick,
so the script also finds its own best form without any gradient: by a search over exact rays of the meridian. Then the script
starts from a symmetric lens, whose shape factor is 0, and follows the gradient. It needs Torch.
"""

import argparse
import time

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", type=int, default=20_000)
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--torch", action="store_true", help="trace by Optiland's TorchBackend")
    options = parser.parse_args()
    be.set_backend("torch")
    be.set_precision("float64")
    if options.torch:
        from optiland.nonsequential.backends.torch_backend import TorchBackend

        backend = TorchBackend(seed=1)
    else:
        # Only the light that passes straight through: ghosts are no part of the spot.
        backend = NsqGpuBackend(seed=1, precision="f64", where="reflections == 0")
    shape = torch.tensor(0.0, dtype=torch.float64, requires_grad=True)
    distance = torch.tensor(FOCAL_LENGTH, dtype=torch.float64, requires_grad=not options.torch)
    optimizer = torch.optim.Adam([{"params": [shape], "lr": 0.05}, {"params": [distance], "lr": 0.05}])
    start = time.perf_counter()
    for step in range(options.steps + 1):
        optimizer.zero_grad()
        result = backend.trace(scene(shape, distance), options.rays, max_depth=8)
        loss = mean_square_radius(result.detectors["image"].data)
        if step % 20 == 0:
            print(f"step {step:3}: shape factor {shape.item():7.4f}, image at {distance.item():8.4f} mm, "
                  f"RMS radius {1e3 * loss.item() ** 0.5:7.2f} um, {time.perf_counter() - start:6.1f} s")
        loss.backward()
        optimizer.step()
    best = best_form()
    print(f"best form by exact rays and a search: {best:.4f}, RMS radius {1e3 * smallest_square(best) ** 0.5:.2f} um; "
          f"of a thin lens: {2.0 * (INDEX**2 - 1.0) / (INDEX + 2.0):.4f}")


if __name__ == "__main__":
    main()
