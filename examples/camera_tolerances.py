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

#: What the workshop holds [mm], radii in percent of themselves.
DECENTRE, TILT, SPACE, RADIUS = 0.02, np.radians(0.05), 0.02, 0.1
#: Width of a detector about the middle of each image [mm], and its pixels.
WIDTHS, PIXELS = {"image": 0.4, "corner": 0.8}, 256


def camera():
    """The lens as a scene, with a small detector on the axis and another in the corner."""
    optic = CookeTriplet()
    scene = nsq_gpu.from_optic(optic, detector_size=(WIDTHS["image"],) * 2, detector_pixels=(PIXELS,) * 2)
    corner = optic.trace_generic(Hx=0, Hy=1, Px=0, Py=0, wavelength=optic.primary_wavelength)
    image = scene.detectors[0].cs
    place = np.array([0.0, float(corner.y[-1]), float(image.z)])
    scene.add_detector("corner", frame(place, np.eye(3)), IrradianceDetectorConfig(
        *(WIDTHS["corner"],) * 2, PIXELS, PIXELS))
    # What is behind the last element moves with the space there.
    scene.elements[-1]["behind"].append("corner")
    return scene


def figures(sweep):
    """By detector: the blur, an rms radius, and where its middle is in x and y [mm], of each point."""
    found = {}
    for name, maps in sweep.maps.items():
        centres = ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5) * WIDTHS[name]
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
    tolerances = {f"{lens}.y": DECENTRE for lens in lenses} | {f"{lens}.rx": TILT for lens in lenses}
    tolerances |= {f"gap_{number}": SPACE for number, _ in enumerate(lenses[:-1], start=1)}
    tolerances |= {f"{lens}.{face}.radius": RADIUS for lens in lenses for face in ("front", "back")}
    units = {"y": "mm", "rx": "rad", "radius": "%"}
    with nsq_gpu.Session() as session:
        nominal = session.numbers(scene, list(tolerances))
        sizes = {name: size if not name.endswith("radius") else abs(nominal[name]) * size / 100.0
                 for name, size in tolerances.items()}

        def traced(numbers):
            return figures(session.sweep(scene, numbers, int(args.rays), zip=True, maps=True))

        first = next(iter(nominal))
        as_is = traced({first: [nominal[first]]})
        print(f"as designed: blur {1e3 * as_is['image'][0][0]:.2f} um on the axis, {1e3 * as_is['corner'][0][0]:.2f} um in the corner")
        rows = []
        for name, size in sizes.items():
            found = traced({name: [nominal[name] - size, nominal[name] + size]})
            grows = [1e3 * (found[where][0] - as_is[where][0]).max() for where in ("image", "corner")]
            moves = 1e3 * np.linalg.norm(found["image"][1] - as_is["image"][1], axis=1).max()
            rows.append((name, tolerances[name], *grows, moves))
        print(f"{'name':<18}{'tolerance':>14}{'axis [um]':>12}{'corner [um]':>13}{'moves [um]':>12}")
        for name, size, *found in sorted(rows, key=lambda row: -row[3]):
            unit = units.get(name.rsplit(".", 1)[-1], "mm")
            print(f"{name:<18}{f'{size:.3g} {unit}':>14}{found[0]:>12.2f}{found[1]:>13.2f}{found[2]:>12.2f}")
        draws = np.random.default_rng(0)
        numbers = {name: nominal[name] + size * draws.standard_normal(args.samples) for name, size in sizes.items()}
        batch = traced(numbers)
        for where, label in (("image", "on the axis"), ("corner", "in the corner")):
            blur = 1e3 * np.quantile(batch[where][0], [0.5, 0.95])
            print(f"batch of {args.samples}: blur {label} {blur[0]:.2f} um in the middle, 95 % below {blur[1]:.2f} um")


if __name__ == "__main__":
    main()
