"""Is a lamp enough? A bare lamp of 1,000 lm hangs a metre above a desk; work at an office desk wants 500 lx.

Prints what arrives, beside the formula of a Lambertian disk, and draws the map::

    python examples/desk_lamp.py docs/desk_lamp.png
"""

import math
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQScene, to_photometric
from optiland.nonsequential.detectors.configs import SpectralDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import ExtendedSourceConfig

from nsq_gpu import NsqGpuBackend

LUMENS = 1000.0
WANTED = 500.0  # [lx], EN 12464-1: writing, reading
HEIGHT, RADIUS = 1000.0, 20.0  # [mm]

white = Spectrum(np.array([0.45, 0.50, 0.54, 0.58, 0.62]), np.array([0.25, 0.15, 0.2, 0.2, 0.2]))
scene = NSQScene()
scene.add_source("lamp", CoordinateSystem(),
                 ExtendedSourceConfig(white, total_flux_lumens=LUMENS, aperture_radius=RADIUS))
# Bins of 10 nm, whose middles are the wavelengths of the lamp: 0.40, 0.41, ... um.
scene.add_detector("desk", CoordinateSystem(z=HEIGHT), SpectralDetectorConfig(
    width=1600.0, height=800.0, num_pixels_x=64, num_pixels_y=32, wl_min=0.395, wl_max=0.705, num_bins=31))

result = scene.trace(2**24, seed=0, backend=NsqGpuBackend(sampler="sobol"))
light = to_photometric(result.detectors["desk"])

below = light.data[15:17, 31:33].mean()
corner = light.data[0, 0]
formula = LUMENS / (math.pi * (HEIGHT**2 + RADIUS**2) * 1e-6)
print(f"on the desk:    {light.total:6.1f} lm of {LUMENS:.0f} lm")
print(f"below the lamp: {below:6.1f} lx; of a Lambertian disk: {formula:.1f} lx")
print(f"at the corner:  {corner:6.1f} lx")
print(f"wanted: {WANTED:.0f} lx, so a lamp of {LUMENS * WANTED / below:.0f} lm")

figure, axes = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
image = axes.imshow(light.data, origin="lower", extent=(-800, 800, -400, 400), vmin=0, cmap="inferno")
lines = axes.contour(light.x_coords, light.y_coords, light.data, [150, 200, 250, 300], colors="white", linewidths=0.8)
axes.clabel(lines, fmt="%d lx")
figure.colorbar(image, label="illuminance [lx]")
axes.set(xlabel="x [mm]", ylabel="y [mm]", title="A lamp of 1,000 lm, 1 m above a desk")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "desk_lamp.png", dpi=120)
