"""Writes ``tests/oracle/gradients/``: derivatives of irradiance maps by Optiland's TorchBackend, in float64.

Run ``../.venv-torch/bin/python -m tools.make_gradients [NAME ...]`` from the folder ``python``; it takes minutes. With
``--check`` it writes nothing: it compares the derivatives with central differences of TorchBackend's own maps.

A scene NAME has two files. ``NAME.scene.json`` is the scene. ``NAME.json`` holds the map of one detector [W per pixel,
row by row] and, for every parameter by its name in the scene file, the derivatives of the map and of its sum. A Lambertian
reflectance has no name there; it stands apart.

These are derivatives of one trace's estimate, not of its expectation: all draws, and which surface a ray hits, are
held. Torch attaches the following.

- The distance to a conic: through the roots of the quadratic. Normals, refraction and reflection: everywhere.
- A branch at a Fresnel surface: its weight is R / p or T / (1 - p) of the detached probability p, which is R unless the
  scene gives one. So is the weight of a scattering branch: f / f or (1 - f) / (1 - f) of the scatter fraction f, the
  denominators detached. A ray that scatters off a refractive surface has both weights.
- Roulette: a survivor's flux, times a detached factor.
- Absorption in media: k, and the length of the way.
- Bilinear and Gaussian splats: the weights, by the point that a ray hits and by the detector's width and height. The
  pixels that they belong to are held.

It silently detaches, so that there are no derivatives of these here: all frames, thicknesses (the frame of a lens' back
face), apertures, a coating's reflectance and transmittance, a mirror's constant reflectance (a function of the
wavelength is attached, hence the function below), and the directions of scattered rays, which follow neither the normal
nor the ray. It refuses the total flux of other than collimated sources, and all other numbers of sources.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np
import optiland.backend as be
import torch
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import IdealMaterial
from optiland.nonsequential import (
    CollimatedSourceConfig,
    DoubletConfig,
    IrradianceDetectorConfig,
    LensConfig,
    MirrorConfig,
    NSQMaterial,
    NSQScene,
    Spectrum,
    SurfaceConfig,
)
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.backends.torch_backend import TorchBackend
from optiland.nonsequential.bsdf import LambertianBSDF
from optiland.nonsequential.ir.scene_ir import SamplingPolicy

from nsq_gpu import scene_file
from nsq_gpu.export import export_scene
from tools.make_scenes import SCENES_DIR

GRADIENTS_DIR = SCENES_DIR.parent / "tests" / "oracle" / "gradients"

NUM_RAYS = 2000
SEED = 1
MAX_DEPTH = 16
DETECTOR = "screen"
#: The probability of reflection by which derivatives are checked: where it is fixed, no draw depends on a parameter.
CHECKED_PROBABILITY = 0.3
#: Step of the central differences, relative.
STEP = 1e-6
#: Largest difference of a derivative of a pixel from its difference, relative to the map's largest.
TOLERANCE = 1e-4

#: Parameters by their names: floats, or tensors.
Values = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A scene as a function of its parameters, and their values."""

    build: Callable[[Values], NSQScene]
    values: dict[str, float]
    #: Parameters that have no name in a scene file.
    unnamed: dict[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.build.__name__

    @property
    def all_values(self) -> dict[str, float]:
        return self.values | self.unnamed


# Scenes


def beam(scene: NSQScene, radius: float = 3.0, total_flux: Any = 1.0, wavelengths: tuple[float, ...] = (0.55,)) -> None:
    """A beam along z, a little tilted and decentred, so that no derivative vanishes by symmetry."""
    spectrum = Spectrum(np.array(wavelengths), np.ones(len(wavelengths)))
    scene.add_source("beam", CoordinateSystem(x=0.4, y=-0.3, rx=0.02, ry=0.03), CollimatedSourceConfig(
        spectrum=spectrum, total_flux=total_flux, aperture_radius=radius))


def glass(name: str, n: Any, k: Any = 0.0) -> NSQMaterial:
    material = NSQMaterial(IdealMaterial(n, k))
    material.nsq_gpu_name = name
    return material


def screen(scene: NSQScene, cs: CoordinateSystem, width: Any = 8.0, height: Any = 8.0, **more: Any) -> None:
    grid = {"num_pixels_x": 12, "num_pixels_y": 12} | more
    scene.add_detector(DETECTOR, cs, IrradianceDetectorConfig(width=width, height=height, **grid))


def singlet(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene)
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
        r1=p["L.r1"], r2=p["L.r2"], thickness=5.0, material=glass("glass", p["glass.n"]), front_aperture_radius=10.0))
    screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0))
    return scene


def absorbing_singlet(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene)
    material = glass("glass", p["glass.n"], p["glass.k"])
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
        r1=p["L.r1"], r2=-45.0, thickness=5.0, material=material, front_aperture_radius=10.0))
    screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0))
    return scene


def aspheric_singlet(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene, radius=5.0)
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
        r1=p["L.r1"], r2=-35.0, thickness=7.0, material=glass("glass", 1.6), front_aperture_radius=10.0,
        conic1=p["L.conic1"], conic2=p["L.conic2"]))
    screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0), 10.0, 10.0)
    return scene


def curved_mirror(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene)
    scene.add_mirror("M", CoordinateSystem(z=50.0, ry=0.2), MirrorConfig(
        radius=p["M.radius"], conic=p["M.conic"], reflectance=reflectance(p["M.reflectance"]), aperture_radius=10.0))
    # The mirror turns the beam by 0.4 rad.
    screen(scene, CoordinateSystem(x=-6.9, y=-1.0, z=30.0, ry=0.4), 5.0, 5.0)
    return scene


def reflectance(value: Any) -> Any:
    """Torch attaches no constant, but what a function returns."""
    return (lambda _: value) if isinstance(value, torch.Tensor) else value


def two_lenses(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene)
    scene.add_lens("A", CoordinateSystem(z=15.0), LensConfig(
        r1=p["A.r1"], r2=p["A.r2"], thickness=5.0, material=glass("crown", 1.52), front_aperture_radius=10.0))
    scene.add_lens("B", CoordinateSystem(z=25.0, x=0.2, rx=0.03), LensConfig(
        r1=p["B.r1"], r2=p["B.r2"], thickness=3.0, material=glass("flint", 1.7), front_aperture_radius=10.0))
    screen(scene, CoordinateSystem(x=1.4, y=-1.0, z=38.0))
    return scene


def doublet(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene)
    scene.add_doublet("D", CoordinateSystem(z=15.0), DoubletConfig(
        r1=p["D.r1"], r2=p["D.r2"], r3=p["D.r3"], thickness1=5.0, thickness2=2.5, conic2=p["D.conic2"],
        material1=glass("crown", p["crown.n"]), material2=glass("flint", p["flint.n"]), aperture_radius=9.0))
    screen(scene, CoordinateSystem(x=1.4, y=-1.0, z=38.0))
    return scene


def tilted_screen(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene)
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
        r1=p["L.r1"], r2=-45.0, thickness=5.0, material=glass("glass", 1.52), front_aperture_radius=10.0))
    screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0, rx=0.3, rz=0.2), p["screen.width"], p["screen.height"], num_pixels_y=10)
    return scene


def gaussian_screen(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene)
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
        r1=p["L.r1"], r2=-45.0, thickness=5.0, material=glass("glass", 1.52), front_aperture_radius=10.0))
    screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0), p["screen.width"], p["screen.height"], splat="gaussian", splat_sigma=0.7)
    return scene


def scattering_mirror(p: Values) -> NSQScene:
    """A flat mirror at 45 degrees that scatters a part of its light."""
    scene = NSQScene()
    beam(scene)
    lobe = LambertianBSDF(reflectance_value=p["M.surface.bsdf.reflectance_value"])
    scene.add_mirror("M", CoordinateSystem(z=30.0, rx=np.pi / 4), MirrorConfig(
        radius=float("inf"), reflectance=reflectance(p["M.reflectance"]), aperture_radius=12.0,
        surface=SurfaceConfig(bsdf=lobe, scatter_fraction=p["M.surface.scatter_fraction"])))
    screen(scene, CoordinateSystem(x=1.2, y=15.0, z=31.0, rx=np.pi / 2), 14.0, 14.0)
    return scene


def scattering_lens(p: Values) -> NSQScene:
    """A flat front face scatters into the glass; Torch gives scattered rays the Fresnel weight too."""
    scene = NSQScene()
    beam(scene)
    lobe = LambertianBSDF(reflectance_value=p["L.front.bsdf.reflectance_value"], transmissive_fraction=1.0)
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
        r1=float("inf"), r2=p["L.r2"], thickness=5.0, material=glass("glass", p["glass.n"]), front_aperture_radius=10.0,
        front=SurfaceConfig(bsdf=lobe, scatter_fraction=p["L.front.scatter_fraction"])))
    screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0), 14.0, 14.0)
    return scene


def dispersive_singlet(p: Values) -> NSQScene:
    scene = NSQScene()
    beam(scene, total_flux=p["beam.total_flux"], wavelengths=(0.45, 0.55, 0.65))
    scene.add_lens("L", CoordinateSystem(z=20.0), LensConfig(
        r1=p["L.r1"], r2=p["L.r2"], thickness=5.0, material="N-SF11", front_aperture_radius=10.0))
    screen(scene, CoordinateSystem(x=1.2, y=-0.8, z=35.0))
    return scene


def ghosts(p: Values) -> NSQScene:
    """Many reflections, and roulette after some."""
    scene = singlet(p)
    scene.sampling_policy = SamplingPolicy(reflect_prob=0.4)
    return scene


CASES = [
    Case(singlet, {"L.r1": 60.0, "L.r2": -45.0, "glass.n": 1.52}),
    Case(absorbing_singlet, {"L.r1": 60.0, "glass.n": 1.52, "glass.k": 5e-6}),
    Case(aspheric_singlet, {"L.r1": 40.0, "L.conic1": -0.6, "L.conic2": 0.8}),
    Case(curved_mirror, {"M.radius": -80.0, "M.conic": -0.7, "M.reflectance": 0.9}),
    Case(two_lenses, {"A.r1": 50.0, "A.r2": -60.0, "B.r1": -40.0, "B.r2": 90.0}),
    Case(doublet, {"D.r1": 50.0, "D.r2": -35.0, "D.r3": -120.0, "D.conic2": -0.4, "crown.n": 1.52, "flint.n": 1.7}),
    Case(tilted_screen, {"L.r1": 60.0, "screen.width": 9.0, "screen.height": 8.0}),
    Case(gaussian_screen, {"L.r1": 60.0, "screen.width": 9.0, "screen.height": 8.0}),
    Case(scattering_mirror, {"M.surface.scatter_fraction": 0.4, "M.reflectance": 0.9},
         {"M.surface.bsdf.reflectance_value": 0.8}),
    Case(scattering_lens, {"L.r2": -30.0, "glass.n": 1.52, "L.front.scatter_fraction": 0.5},
         {"L.front.bsdf.reflectance_value": 0.8}),
    Case(dispersive_singlet, {"L.r1": 80.0, "L.r2": -70.0, "beam.total_flux": 2.0}),
    Case(ghosts, {"L.r1": 60.0, "L.r2": -45.0, "glass.n": 1.52}),
]


# Derivatives


@contextmanager
def torch_backend() -> Iterator[None]:
    """Optiland's backend is Torch meanwhile, in float64: its default, float32, traces wrongly."""
    be.set_backend("torch")
    be.set_precision("float64")
    yield
    be.set_backend("numpy")


def torch_map(case: Case, values: Values, reflect_prob: float | None = None) -> torch.Tensor:
    """Trace with Torch and return the detector's map [W per pixel].

    Where the probability of reflection is given, there is no roulette either, whose draws depend on the flux.
    """
    scene = case.build(values)
    options = {}
    if reflect_prob is not None:
        scene.sampling_policy = SamplingPolicy(reflect_prob=reflect_prob, rr_start_flux=0.0)
        options["min_flux_fraction"] = 0.0
    result = scene.trace(NUM_RAYS, max_depth=MAX_DEPTH, seed=SEED, backend=TorchBackend(seed=SEED), **options)
    return result.detectors[DETECTOR].data


def derivatives(case: Case, reflect_prob: float | None = None) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, float]]:
    """Return the map, and the derivatives of the map and of its sum with respect to each parameter."""
    with torch_backend():
        values = {name: torch.tensor(value, dtype=torch.float64, requires_grad=True)
                  for name, value in case.all_values.items()}
        data = torch_map(case, values, reflect_prob)

        def gradient(scalar: torch.Tensor) -> list[float]:
            return [float(each) for each in torch.autograd.grad(scalar, list(values.values()), retain_graph=True)]

        rows = np.array([gradient(pixel) for pixel in data])
        flux = gradient(data.sum())
    if not np.isfinite(rows).all():
        raise ValueError(f"{case.name}: Torch gives derivatives that are no numbers")
    return data.detach().numpy(), dict(zip(values, rows.T, strict=True)), dict(zip(values, flux, strict=True))


def write(case: Case) -> None:
    """Write the two files of a scene."""
    data, maps, flux = derivatives(case)
    scene = GRADIENTS_DIR / f"{case.name}.scene.json"
    export_scene(case.build(dict(case.all_values)), scene, overwrite=True)
    check_file(scene_file.scene_from_dict(json.loads(scene.read_text(encoding="utf-8")), scene.parent), data)
    parts = [
        ("scene", json.dumps(scene.name)),
        ("optiland", json.dumps(version("optiland"))),
        ("num_rays", json.dumps(NUM_RAYS)),
        ("seed", json.dumps(SEED)),
        ("max_depth", json.dumps(MAX_DEPTH)),
        ("detector", json.dumps(DETECTOR)),
        ("unit of data", json.dumps("W per pixel")),
        ("parameters", _parameters(case.values, maps, flux)),
        ("parameters without a name", _parameters(case.unnamed, maps, flux)),
        ("data", json.dumps(data.tolist())),
    ]
    text = "{\n" + ",\n".join(f"{json.dumps(key)}: {value}" for key, value in parts) + "\n}\n"
    (GRADIENTS_DIR / f"{case.name}.json").write_text(text, encoding="utf-8")


def _parameters(values: dict[str, float], maps: dict[str, np.ndarray], flux: dict[str, float]) -> str:
    """One line for each parameter."""
    lines = [f"{json.dumps(name)}: {json.dumps({'value': value, 'flux': flux[name], 'data': maps[name].tolist()})}"
             for name, value in values.items()]
    return "{\n" + ",\n".join(lines) + "\n}" if lines else "{}"


def check_file(scene: NSQScene, data: np.ndarray) -> None:
    """Refuse a file whose scene is another than the one that Torch traced."""
    found = scene.trace(NUM_RAYS, max_depth=MAX_DEPTH, seed=SEED, backend=NumpyBackend(seed=SEED))
    np.testing.assert_allclose(found.detectors[DETECTOR].data, data, rtol=1e-9, atol=1e-12 * data.max())


# The check


def check(case: Case) -> None:
    """Compare derivatives with central differences, where no draw depends on the parameter."""
    _, maps, _ = derivatives(case, CHECKED_PROBABILITY)
    for name, value in case.all_values.items():
        if name.endswith("scatter_fraction"):
            continue
        difference = central_difference(case, name, value)
        error = np.abs(difference - maps[name]).max() / np.abs(maps[name]).max()
        print(f"{case.name:20} {name:35} d flux {maps[name].sum():13.6e}, differences {difference.sum():13.6e}, "
              f"largest error of a pixel {error:.1e} of the largest")
        if not error < TOLERANCE:
            raise ValueError(f"{case.name}: {name}: the derivative is not the difference")


def central_difference(case: Case, name: str, value: float) -> np.ndarray:
    step = STEP * abs(value)
    with torch_backend(), torch.no_grad():
        above, below = (torch_map(case, case.all_values | {name: value + side}, CHECKED_PROBABILITY).numpy()
                        for side in (step, -step))
    return (above - below) / (2.0 * step)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="scenes, instead of all")
    parser.add_argument("--check", action="store_true", help="compare with central differences, and write nothing")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    for case in CASES:
        if not options.names or case.name in options.names:
            (check if options.check else write)(case)


if __name__ == "__main__":
    main()
