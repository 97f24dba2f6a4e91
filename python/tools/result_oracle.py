"""Writes tests/data/result_oracle.json: what Optiland 0.6.3 reports of one trace, and the ray counts behind it.

The scene has every bin of Optiland's ledger that needs no glass: an absorbing stop, a half-silvered mirror, a
transmissive detector, absorbing ones of every kind, escaped rays and rays at the depth limit. Every ray weighs 1 or,
after the mirror, 1/2, so that all sums are whole numbers of half weights: `half_units`.

Usage: python result_oracle.py > ../../tests/data/result_oracle.json
"""

import json

import numpy as np

from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.configs import MirrorConfig
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry
from optiland.nonsequential.detectors.configs import (
    FarFieldDetectorConfig,
    IrradianceDetectorConfig,
    RayDatabaseConfig,
    SpectralDetectorConfig,
)
from optiland.nonsequential.scene import NSQScene
from optiland.nonsequential.sources import PointSourceConfig, Spectrum

NUM_RAYS = 2000
TOTAL_FLUX = 1.7
MAX_ROWS = 100
FLUX_PER_RAY = TOTAL_FLUX / NUM_RAYS


def build_scene():
    scene = NSQScene()
    spectrum = Spectrum(np.array([0.45, 0.62]), np.array([1.0, 3.0]))
    source = PointSourceConfig(spectrum=spectrum, total_flux=TOTAL_FLUX, half_angle_deg=40.0)
    scene.add_source("lamp", CoordinateSystem(), source)
    for name, z in [("stop", 5.0), ("spare", -100.0)]:
        disk = FinitePlaneGeometry(aperture_radius=0.4)
        scene.add_component(name, AbsorbingComponent(CoordinateSystem(z=z), disk, name=name))
    mirror = MirrorConfig(radius=float("inf"), reflectance=0.5, aperture_radius=8.0)
    scene.add_mirror("mirror", CoordinateSystem(z=20.0), mirror)
    grid = dict(num_pixels_x=6, num_pixels_y=5, splat="hard")
    scene.add_detector(
        "tap", CoordinateSystem(z=10.0), IrradianceDetectorConfig(width=8.0, height=7.0, absorb=False, **grid)
    )
    scene.add_detector(
        "spectral",
        CoordinateSystem(z=-10.0),
        SpectralDetectorConfig(width=20.0, height=19.0, wl_min=0.4, wl_max=0.7, num_bins=3, **grid),
    )
    scene.add_detector("far", CoordinateSystem(z=-20.0), FarFieldDetectorConfig(num_theta=9, num_phi=8))
    scene.add_detector("rays", CoordinateSystem(z=30.0), RayDatabaseConfig(width=25.0, height=25.0, max_rays=MAX_ROWS))
    return scene


def half_units(flux):
    """The whole number of half weights behind each sum."""
    counts = np.asarray(flux) / (0.5 * FLUX_PER_RAY)
    assert np.allclose(counts, np.round(counts), atol=1e-6)
    return np.round(counts).astype(int).ravel().tolist()


def solid_angles(pattern):
    widths = np.radians(90.0 / len(pattern.theta)) * np.radians(360.0 / len(pattern.phi))
    return np.sin(np.radians(pattern.theta))[:, None] * widths


def main():
    scene = build_scene()
    result = scene.trace(num_rays=NUM_RAYS, max_depth=3, seed=11)
    tap, spectral, far, rays = (result.detectors[name] for name in ["tap", "spectral", "far", "rays"])
    database = scene.detectors[3]
    stop = scene.surfaces[0]
    names = [field for field in vars(result) if field.startswith(("num_", "total_", "flux_"))]
    diagnostics = vars(result.diagnostics) | {
        "detectors": [vars(detector) for detector in result.diagnostics.detectors]
    }
    counted = half_units(
        [stop._absorbed_flux, result.total_flux_escaped, result.total_flux_lost, database._total_flux]
    )
    detected = sum(half_units(spectral.irradiance * 20.0 * 19.0 / 30)) + sum(half_units(far.intensity * solid_angles(far)))
    document = {
        "half_units": {
            "tap": half_units(tap.irradiance * 8.0 * 7.0 / 30),
            "spectral": half_units(spectral.irradiance * 20.0 * 19.0 / 30),
            "far": half_units(far.intensity * solid_angles(far)),
            "stop": counted[0],
            "escaped": counted[1],
            "depth": counted[2],
            "rays": counted[3],
            # What is left of the weight launched is what the mirror took.
            "mirror": 2 * NUM_RAYS - detected - sum(counted),
        },
        "rays_recorded": database._num_rays_hit,
        "result": {name: getattr(result, name) for name in names},
        "diagnostics": diagnostics,
        "num_warnings": len(result.diagnostics.warnings()),
        "tap": {key: getattr(tap, key).tolist() for key in ["irradiance", "x_coords", "y_coords"]},
        "spectral": {
            key: getattr(spectral, key).tolist() for key in ["irradiance", "x_coords", "y_coords", "wavelengths"]
        },
        "far": {key: getattr(far, key).tolist() for key in ["intensity", "theta", "phi"]},
        "rays": {key: getattr(rays, key).tolist() for key in ["x", "y", "z", "L", "M", "N", "flux", "wavelength"]},
    }
    print(json.dumps(document))


main()
