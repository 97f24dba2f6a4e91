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
from optiland.nonsequential import NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
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
scene.add_detector("desk", CoordinateSystem(z=HEIGHT), IrradianceDetectorConfig(
    width=1600.0, height=800.0, num_pixels_x=64, num_pixels_y=32))

result = scene.trace(2**24, seed=0, backend=NsqGpuBackend(photometric=True, sampler="sobol", standard_error=True))
desk = result.detectors["desk"]

below = desk.illuminance[15:17, 31:33].mean()
error = np.sqrt((desk.illuminance_standard_error[15:17, 31:33] ** 2).sum()) / 4.0
even = result.figures("desk", cells=(16, 8))["desk"].whole["min_over_mean"]
formula = LUMENS / (math.pi * (HEIGHT**2 + RADIUS**2) * 1e-6)
print(f"on the desk:     {desk.luminous_flux:.2f} +- {desk.luminous_flux_standard_error:.2f} lm of {LUMENS:.0f} lm")
print(f"below the lamp:  {below:.1f} +- {error:.1f} lx; of a Lambertian disk: {formula:.1f} lx")
print(f"at the corner:   {desk.illuminance[0, 0]:.1f} +- {desk.illuminance_standard_error[0, 0]:.1f} lx")
print(f"least over mean: {even.value:.3f} +- {even.standard_error:.3f}")
print(f"wanted: {WANTED:.0f} lx, so a lamp of {LUMENS * WANTED / below:.0f} lm")

figure, axes = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
result.plot("desk", ax=axes, cmap="inferno")
lines = axes.contour(desk.x_coords, desk.y_coords, desk.illuminance, [150, 200, 250, 300], colors="white", linewidths=0.8)
axes.clabel(lines, fmt="%d lx")
axes.set_title("A lamp of 1,000 lm, 1 m above a desk")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "desk_lamp.png", dpi=120)
