"""How long does a trace take that stays in one process? Each turn traces a new scene object with four numbers changed.

    make bench-live                              # beside NumPy, and what is installed of Torch and Dr.Jit
    python benches/live.py --turns 50 --num-rays 10000 --adapter NAME

The scene is one lens of N-BK7, a beam and an irradiance map of 64 x 64 pixels. The lens' radius, its thickness, the
beam's radius and the map's place differ from turn to turn. All interpreters take their turn on each scene, one after the
other. A turn's time is the time of the trace alone, without the making of the scene.

Dr.Jit's loop is `python/tools/drjit_peer.py`: a kernel written by hand for this lens, which reads the four numbers. LLVM
before 16 crashes in it on processors with AVX-512; `DRJIT_LIBLLVM_PATH` names another one.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "python"))

import optiland.backend as be
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import Material
from optiland.nonsequential import LensConfig, NSQMaterial, NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig

import nsq_gpu
from nsq_gpu.export import export

Trace = Callable[[NSQScene], object]
PIXELS = 64


def singlet(turn: int) -> NSQScene:
    """The lens of a turn: four numbers that a designer turns."""
    step = turn % 100
    scene = NSQScene()
    scene.add_source("beam", CoordinateSystem(z=-20.0), CollimatedSourceConfig(Spectrum([0.5876], [1.0]), aperture_radius=8.0 - 0.01 * step))
    radius, thickness = 60.0 + 0.1 * step, 5.0 + 0.01 * step
    scene.add_lens("L", CoordinateSystem(), LensConfig(radius, -radius, thickness, NSQMaterial(Material("N-BK7")), 10.0))
    scene.add_detector("image", CoordinateSystem(z=55.0 + 0.05 * step), IrradianceDetectorConfig(20.0, 20.0, PIXELS, PIXELS))
    return scene


def with_session(num_rays: int, precision: str, adapter: str | None, binary: str | None) -> Trace:
    backend = nsq_gpu.NsqGpuBackend(precision=precision, adapter=adapter, binary=binary)
    return lambda scene: scene.trace(num_rays, backend=backend)


def with_numpy(num_rays: int) -> Trace:
    return lambda scene: scene.trace(num_rays, backend=NumpyBackend())


def with_torch(num_rays: int) -> Trace:
    import torch
    from optiland.nonsequential.backends.torch_backend import TorchBackend

    # Its threads spin while they wait, which starves a device in software on the same cores.
    torch.set_num_threads(1)

    def trace(scene: NSQScene) -> None:
        be.set_backend("torch")
        be.set_precision("float64")
        try:
            with torch.no_grad():
                scene.trace(num_rays, backend=TorchBackend())
        finally:
            be.set_backend("numpy")

    return trace


def with_drjit(num_rays: int, precision: str) -> Trace:
    import drjit as dr
    from tools import drjit_peer

    real = drjit_peer.REALS[precision]

    def trace(scene: NSQScene) -> None:
        lens = drjit_peer.Lens(export(scene).document)
        # Read, not compiled in: Dr.Jit keeps the compiled kernel.
        [lens.index] = lens.index  # at the one wavelength
        for name in ("radius", "thickness", "aperture", "index", "beam", "source_z", "detector_z", "half_width"):
            setattr(lens, name, dr.opaque(real, getattr(lens, name)))
        drjit_peer.timed(lens, num_rays, 1, precision)

    return trace


def interpreters(num_rays: int, adapter: str | None, binary: str | None) -> dict[str, Trace]:
    """Those that are installed; the others are said to be skipped, by name."""
    found = {f"nsq-gpu {precision}": with_session(num_rays, precision, adapter, binary) for precision in ("f64", "f32")}
    found["NumPy f64"] = with_numpy(num_rays)
    for name, make in {"Torch f64": lambda: with_torch(num_rays),
                       "Dr.Jit f64": lambda: with_drjit(num_rays, "f64"),
                       "Dr.Jit f32": lambda: with_drjit(num_rays, "f32")}.items():
        try:
            found[name] = make()
        except ImportError as error:
            print(f"SKIPPED: {name}: {error}")
    return found


def measure(traces: dict[str, Trace], turns: int) -> dict[str, list[float]]:
    """Seconds of each interpreter by turn; the first turn starts it."""
    seconds: dict[str, list[float]] = {name: [] for name in traces}
    for turn in range(turns + 1):
        for name, trace in traces.items():
            be.set_backend("numpy")
            scene = singlet(turn)
            start = time.perf_counter()
            trace(scene)
            seconds[name].append(time.perf_counter() - start)
    return seconds


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num-rays", type=int, default=10_000)
    parser.add_argument("--turns", type=int, default=30, help="turns after the first")
    parser.add_argument("--adapter", help="part of the adapter's name, as `nsq-gpu adapters` prints it")
    parser.add_argument("--binary", help="the built command")
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    be.set_precision("float64")
    seconds = measure(interpreters(given.num_rays, given.adapter, given.binary), given.turns)
    with nsq_gpu.Session(adapter=given.adapter, binary=given.binary) as session:
        print(f"{given.num_rays} rays, {given.turns} turns, {session.hello()['adapter']}; load {os.getloadavg()[0]:.1f}")
    print(f"{'':14}{'first [ms]':>11}{'median [ms]':>13}{'slowest [ms]':>14}{'a second':>10}")
    for name, times in seconds.items():
        later = times[1:]
        print(f"{name:14}{1e3 * times[0]:11.1f}{1e3 * statistics.median(later):13.1f}{1e3 * max(later):14.1f}"
              f"{1 / statistics.median(later):10.0f}")


if __name__ == "__main__":
    main()
