"""The tolerances of a camera lens: which decentre, tilt, space or radius hurts the image most?

The script moves each element of a Cooke triplet by its tolerance, to either side, and traces the lens again by the same rays. It
prints what that does to the blur on the axis and in the corner, and how far the image on the axis moves. Then it draws
all tolerances at once, as a batch of lenses has them.
"""

import argparse

import numpy as np
from optiland.nonsequential import IrradianceDetectorConfig
from optiland.samples.objectives import CookeTriplet

import nsq_gpu
from nsq_gpu.frames import frame

#: What the workshop holds: decentres and spaces [mm], tilts [deg], radii [%].
DECENTRE, SPACE, TILT, RADIUS = 0.02, 0.02, 0.05, 0.1
#: Width of a detector about the middle of each image [mm], and its pixels.
WIDTH, PIXELS = 0.8, 512


def camera():
    """The lens as a scene, with a small detector on the axis and another in the corner."""
    optic = CookeTriplet()
    scene = nsq_gpu.from_optic(optic, detector_size=(WIDTH, WIDTH), detector_pixels=(PIXELS, PIXELS))
    corner = optic.trace_generic(Hx=0, Hy=1, Px=0, Py=0, wavelength=optic.primary_wavelength)
    image = scene.detectors[0].cs
    place = np.array([0.0, float(corner.y[-1]), float(image.z)])
    scene.add_detector("corner", frame(place, np.eye(3)), IrradianceDetectorConfig(WIDTH, WIDTH, PIXELS, PIXELS))
    # What is behind the last element moves with the space there.
    scene.elements[-1]["behind"].append("corner")
    return scene


def figures(sweep):
    """By detector: the blur, an rms radius, and where its middle is in x and y [mm], of each point."""
    found = {}
    centres = ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5) * WIDTH
    for name, maps in sweep.maps.items():
        flux = maps / maps.sum(axis=(1, 2), keepdims=True)
        along = [flux.sum(axis=axis) for axis in (1, 2)]
        middle = np.stack([share @ centres for share in along], axis=1)
        square = sum(share @ centres**2 for share in along)
        found[name] = np.sqrt(square - (middle**2).sum(axis=1)), middle
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=float, default=1e5, help="rays of a trace")
    parser.add_argument("--samples", type=int, default=200, help="lenses of the batch")
    args = parser.parse_args()
    scene = camera()
    lenses = [element["name"] for element in scene.elements]
    tolerances = {f"{lens}.y": (DECENTRE, "mm") for lens in lenses} | {f"{lens}.rx": (TILT, "deg") for lens in lenses}
    tolerances |= {f"gap_{number}": (SPACE, "mm") for number, _ in enumerate(lenses[:-1], start=1)}
    tolerances |= {f"{lens}.{face}.radius": (RADIUS, "%") for lens in lenses for face in ("front", "back")}
    with nsq_gpu.Session() as session:
        nominal = session.numbers(scene, list(tolerances))
        units = {name: {"mm": 1.0, "deg": np.radians(1.0), "%": abs(nominal[name]) / 100.0} for name in nominal}
        sizes = {name: size * units[name][unit] for name, (size, unit) in tolerances.items()}

        def traced(numbers):
            # Rare light that faces reflect would be noise in the blur.
            found = session.sweep(scene, numbers, int(args.rays), zip=True, maps=True, where="reflections == 0")
            return figures(found)

        first = next(iter(nominal))
        as_is = traced({first: [nominal[first]]})
        axis, corner = (1e3 * as_is[where][0][0] for where in ("image", "corner"))
        print(f"as designed: blur {axis:.2f} um on the axis, {corner:.2f} um in the corner")
        rows = []
        for name, size in sizes.items():
            found = traced({name: [nominal[name] - size, nominal[name] + size]})
            # No sign before a zero.
            grows = [round(1e3 * (found[where][0] - as_is[where][0]).max(), 2) + 0.0 for where in ("image", "corner")]
            moves = 1e3 * np.linalg.norm(found["image"][1] - as_is["image"][1], axis=1).max()
            rows.append((name, *grows, moves))
        print(f"{'name':<18}{'tolerance':>14}{'axis [um]':>12}{'corner [um]':>13}{'moves [um]':>12}")
        for name, axis, corner, moves in sorted(rows, key=lambda row: -row[2]):
            tolerance = "{:g} {}".format(*tolerances[name])
            print(f"{name:<18}{tolerance:>14}{axis:>12.2f}{corner:>13.2f}{moves:>12.2f}")
        draws = np.random.default_rng(0)
        numbers = {name: nominal[name] + size * draws.standard_normal(args.samples) for name, size in sizes.items()}
        batch = traced(numbers)
        for where, label in (("image", "on the axis"), ("corner", "in the corner")):
            blur = 1e3 * np.quantile(batch[where][0], [0.5, 0.95])
            print(f"batch of {args.samples}: blur {label} {blur[0]:.2f} um in the middle, 95 % below {blur[1]:.2f} um")


if __name__ == "__main__":
    main()
