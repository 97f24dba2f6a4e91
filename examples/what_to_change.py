"""How does each pixel of an image answer to a radius, and to where the lens stands?

Prints what the image gains, and draws both maps of derivatives beside the image::

    python examples/what_to_change.py docs/gradients.png
"""

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import nsq_gpu

NAMES = {"L1.r1": "a radius that grows", "L1.z": "a lens that moves along"}
HALF = 1.0  # half the width of the image [mm]

scene = nsq_gpu.load_scene("docs/example.json")
image = scene.trace(1_000_000, seed=0, backend=nsq_gpu.NsqGpuBackend()).detectors["image"].irradiance
found = nsq_gpu.jacobian(scene, list(NAMES), 1_000_000)

figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.0), layout="constrained")
place = {"origin": "lower", "extent": (-HALF, HALF, -HALF, HALF)}
figure.colorbar(axes[0].imshow(image, cmap="inferno", **place), label="W/mm²", shrink=0.8)
axes[0].set_title("the image")
for axis, (name, what) in zip(axes[1:], NAMES.items(), strict=True):
    gained = found[name, "image"]
    print(f"{name}: {gained.flux:.3e} ± {gained.standard_error:.1e} W/mm")
    most = abs(gained.map).max()
    shown = axis.imshow(gained.map, cmap="RdBu_r", vmin=-most, vmax=most, **place)
    figure.colorbar(shown, label="W/mm² a mm", shrink=0.8)
    axis.set_title(f"{name}: {what}", fontsize=10)
for axis in axes:
    axis.set(xlabel="x [mm]")
axes[0].set(ylabel="y [mm]")
figure.savefig(sys.argv[1] if len(sys.argv) > 1 else "gradients.png", dpi=120)
