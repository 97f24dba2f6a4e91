"""A step of an optimisation, forward and backward: NsqGpuBackend beside Optiland's TorchBackend, on a singlet.

    python3 benches/torch_steps.py [--rays 1e7]

Prints the median time of a warm step of 2,000 rays with one, two and three tensors, then rays a second of long steps.
"""

import argparse
import statistics
import time

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

from nsq_gpu import NsqGpuBackend

#: Two radii [mm], and an index.
START = [120.0, -150.0, 1.5]
TORCH_RAYS = 100_000


def scene(r1, r2, index):
    """A beam of 20 mm, a lens, and a screen of bilinear pixels."""
    found = NSQScene()
    found.add_source("beam", CoordinateSystem(z=-10.0), CollimatedSourceConfig(
        Spectrum.monochromatic(0.55), total_flux=1.0, aperture_radius=10.0))
    found.add_lens("lens", CoordinateSystem(z=0.0), LensConfig(
        r1=r1, r2=r2, thickness=4.0, material=NSQMaterial(IdealMaterial(index)), front_aperture_radius=12.0))
    found.add_detector("image", CoordinateSystem(z=80.0), IrradianceDetectorConfig(
        width=20.0, height=20.0, num_pixels_x=32, num_pixels_y=32, splat="bilinear"))
    return found


def seconds(backend, num_rays, num_tensors):
    """Return the time of one step."""
    tensors = [torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in START[:num_tensors]]
    start = time.perf_counter()
    result = backend.trace(scene(*tensors, *START[num_tensors:]), num_rays)
    (result.detectors["image"].data ** 2).sum().backward()
    return time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=float, default=1e7, help="rays of a long step")
    rays = int(parser.parse_args().rays)
    be.set_backend("torch")
    be.set_precision("float64")
    ours, theirs = NsqGpuBackend(seed=7, precision="f64"), TorchBackend(seed=7)
    for num_tensors in (1, 2, 3):
        times = [seconds(ours, 2000, num_tensors) for _ in range(25)]
        print(f"{num_tensors} tensors, 2,000 rays: NsqGpuBackend {1e3 * statistics.median(times[5:]):.1f} ms a step")
    times = [seconds(theirs, 2000, 1) for _ in range(7)]
    print(f"1 tensor, 2,000 rays: TorchBackend {1e3 * statistics.median(times[2:]):.1f} ms a step")
    for name, backend, num_rays in (("NsqGpuBackend", ours, rays), ("TorchBackend", theirs, TORCH_RAYS)):
        best = statistics.median(seconds(backend, num_rays, 1) for _ in range(3))
        print(f"1 tensor, {num_rays:,} rays: {name} {num_rays / best / 1e6:.2f} million rays a second")


if __name__ == "__main__":
    main()
