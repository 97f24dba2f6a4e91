"""Illumination by CIE 171:2006: cases 5.2, 5.3, 5.4 and 5.8, each beside the print of CIE and an exact value.

    python benches/cie171.py                     # all four cases, as tables in Markdown
    python benches/cie171.py --case 5.2 --rays 1e6
    python benches/cie171.py --radiance          # a lamp's file beside Radiance's ies2rad and rtrace, through pyradiance

Scenes are traced by the command. Its illuminance in a pixel is held against the exact mean over this pixel, which is
computed here: by a closed form, averaged by quadrature. Exit code 1 says that some value is off by more than four standard
errors, or that light was lost at the depth limit without a warning.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import json
import math
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "python"))

from nsq_gpu import find_binary  # noqa: E402

Json = dict[str, Any]
#: The illuminance of points, shape (..., 3) [m].
Illuminance = Callable[[np.ndarray], np.ndarray]

GREEN = {"wavelengths": [0.555], "weights": [1.0]}
#: Edge of a pixel, and the longer edge of pixels of case 5.3 [m].
PIXEL, STRIP = 0.1, 0.2
#: On the axis, of the lamps of cases 5.2 and 5.3 [cd].
INTENSITY = 1000.0
#: Of the lamps of cases 5.4 and 5.8 [lm].
LUMENS = 10_000.0
#: Edges of the room of cases 5.3 and 5.4 [m], and where its lamp of 5.4 is.
ROOM, LAMP = (4.0, 4.0, 3.0), (1.0, 1.5, 2.0)
#: Edge of the cube of case 5.8 [m], how far before its floor the detector is [mm], and what CIE prints by reflectance [lx].
CUBE, GAP = 4.0, 0.01
INDIRECT = {0.05: 5.48, 0.1: 11.6, 0.2: 26.0, 0.3: 44.6, 0.4: 69.4, 0.5: 104.0, 0.6: 156.0, 0.7: 243.0, 0.8: 417.0, 0.9: 937.0,
            0.95: 1979.0}
#: In the cube a ray brings light many times, so that fewer rays are enough.
CUBE_SHARE = 64
DEPTH, TOO_FEW_EVENTS = 512, 8
SOBOL = ("--sampler", "sobol")
#: How far off a value may be: standard errors, and a share of it. Between its angles a lamp's table is linear, so 1e-5 too low.
MOST_ERRORS, ROUNDING = 4.0, 2e-5
#: Radiance makes a small sphere of a point, and computes in single precision.
OF_RADIANCE = 1e-3


@dataclass(frozen=True)
class Row:
    """A value that was traced, beside what is right: the latter at the point itself, and over the pixel about it."""

    place: str
    printed: float | None
    point: float
    exact: float
    ours: float
    error: float
    allowed: float = ROUNDING
    #: Grave ones, of the report.
    warnings: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        return not self.warnings and abs(self.ours - self.exact) <= MOST_ERRORS * self.error + self.allowed * self.exact

    def __str__(self) -> str:
        apart = self.ours - self.exact
        errors = f"{apart / self.error:+.1f}" if self.error else "-"
        printed = "-" if self.printed is None else f"{self.printed:g}"
        return (f"| {self.place} | {printed} | {self.point:.3f} | {self.exact:.3f} | {self.ours:.3f} | {self.error:.3f} "
                f"| {100.0 * apart / self.exact:+.2f} % | {errors} |" + ("" if self.holds else " **off**"))


#: What the command wrote: its report, and the arrays of each detector.
Traced = tuple[Json, dict[str, dict[str, np.ndarray]]]
#: Traces a scene with these options of the command, and with one of so many rays.
Trace = Callable[..., Traced]


def tracer(binary: str, num_rays: int) -> Trace:
    """Return what traces by this command."""

    def trace(scene: Json, *options: str, share: int = 1) -> Traced:
        with tempfile.TemporaryDirectory() as folder:
            path, results = Path(folder, "scene.json"), Path(folder, "results")
            path.write_text(json.dumps(scene), encoding="utf-8")
            done = subprocess.run([binary, "trace", str(path), "-n", str(num_rays // share), "--photometric", "--standard-error",
                                   "on", "--no-pictures", "--progress", "never", "-o", str(results), *options],
                                  capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
            if done.returncode:
                raise SystemExit(f"cie171.py: {done.stderr.strip()}")
            return (json.loads((results / "report.json").read_text(encoding="utf-8")),
                    {path.stem: dict(np.load(path)) for path in results.glob("*.npz")})

    return trace


def measured(arrays: dict[str, np.ndarray], key: str, index: tuple[int, ...] = ()) -> tuple[float, float]:
    """Return a value and its standard error."""
    return float(arrays[key][index]), float(arrays[f"{key}_standard_error"][index])


def frame(x: float = 0.0, y: float = 0.0, z: float = 0.0, rx: float = 0.0, ry: float = 0.0) -> Json:
    """Return a frame: places in m, rotations in quarters of a turn."""
    return {"x": 1e3 * x, "y": 1e3 * y, "z": 1e3 * z, "rx": 0.5 * math.pi * rx, "ry": 0.5 * math.pi * ry}


def detector(name: str, cs: Json, width: float, height: float, pixels: tuple[int, int] | None = None, **keys: Any) -> Json:
    """Return a detector of pixels of the usual size, edges in m."""
    nx, ny = pixels or (round(width / PIXEL), round(height / PIXEL))
    return {"type": "irradiance", "name": name, "cs": cs, "width": 1e3 * width, "height": 1e3 * height, "num_pixels_x": nx,
            "num_pixels_y": ny, "splat": "hard", **keys}


def room(source: Json, detectors: list[Json], **block: Any) -> Json:
    return {"nsq_schema_version": 1, "components": [], "sources": [{"name": "lamp", "spectrum": GREEN, **source}],
            "detectors": detectors, "nsq_gpu": {"version": 1, **block}}


def over_pixel(illuminance: Illuminance, point: Sequence[float], u: int, v: int, width: float = PIXEL) -> float:
    """Return the mean over the pixel about a point, its width along the axis ``u`` and its height along ``v``: by quadrature."""
    places, weights = np.polynomial.legendre.leggauss(6)
    points = np.broadcast_to(np.asarray(point, float), (6, 6, 3)).copy()
    points[..., u] += 0.5 * width * places[:, None]
    points[..., v] += 0.5 * PIXEL * places
    return float(weights @ illuminance(points) @ weights / 4.0)


def compared(place: str, printed: float, illuminance: Illuminance, point: Sequence[float], u: int, v: int,
             found: tuple[float, float], width: float = PIXEL) -> Row:
    at_point = float(illuminance(np.asarray(point, float)))
    return Row(place, printed, at_point, over_pixel(illuminance, point, u, v, width), *found)


def point_source(trace: Trace) -> list[Row]:
    """5.2: a Lambertian point source, 3 m above the floor. E = I0 h^2 / d^4."""
    height = 3.0
    printed = {(0.0, 0.0): 111.11, (0.5, 0.0): 105.21, (1.0, 0.0): 90.02, (1.5, 0.0): 71.11, (0.5, 0.5): 99.73, (1.0, 0.5): 85.64,
               (1.5, 0.5): 68.06, (1.0, 1.0): 74.36, (1.5, 1.0): 59.98, (1.5, 1.5): 49.39}
    angles = np.linspace(0.0, 90.0, 361)
    candela = np.cos(np.radians(angles)).clip(1e-16) * INTENSITY
    lamp = {"type": "tabulated", "cs": frame(z=height, rx=2), "polar_angles_deg": angles.tolist(), "intensity": [candela.tolist()],
            "intensity_units": "cd"}
    # Its pixels have their middles at 0, 0.1, ..., 1.5 m.
    _, maps = trace(room(lamp, [detector("floor", frame(0.75, 0.75), 1.6, 1.6)]), *SOBOL)

    def illuminance(point: np.ndarray) -> np.ndarray:
        return INTENSITY * height**2 / (point[..., 0]**2 + point[..., 1]**2 + height**2) ** 2

    rows = []
    for (x, y), value in printed.items():
        found = measured(maps["floor"], "illuminance", (round(y / PIXEL), round(x / PIXEL)))
        rows.append(compared(f"({x:g}, {y:g})", value, illuminance, (x, y, 0.0), 0, 1, found))
    return rows


def of_polygon(point: np.ndarray, corners: np.ndarray, normal: Sequence[float], luminance: float) -> np.ndarray:
    """Return what a Lambertian polygon brings to points of a plane that does not cut it: Lambert's formula of 1760."""
    towards = corners - point[..., None, :]
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    following = np.roll(towards, -1, axis=-2)
    across = np.cross(towards, following)
    sine = np.linalg.norm(across, axis=-1)
    angle = np.arctan2(sine, np.sum(towards * following, axis=-1))
    return np.asarray(0.5 * luminance * np.abs(np.sum(angle / sine * (across @ np.asarray(normal)), axis=-1)))


def area_source(trace: Trace) -> list[Row]:
    """5.3: a Lambertian square of 1 m^2 in the middle of the ceiling, on a wall and on the floor of a black room."""
    x, y, z = ROOM
    on_wall = {2.75: 32.68, 2.25: 75.09, 1.75: 81.38, 1.25: 69.12, 0.75: 53.41, 0.25: 39.90}
    on_floor = {0.25: 61.27, 0.75: 79.18, 1.25: 95.52, 1.75: 105.89}
    lamp = {"type": "extended", "cs": frame(x / 2, y / 2, z, rx=2), "width": 1e3, "height": 1e3,
            "total_flux_lumens": math.pi * INTENSITY}
    # Strips along the middles of wall and floor; black walls are left out.
    _, maps = trace(room(lamp, [detector("wall", frame(x / 2, 0.0, z / 2, rx=1), STRIP, z, (1, round(z / PIXEL))),
                                detector("floor", frame(x / 2, y / 2), STRIP, y, (1, round(y / PIXEL)))]), *SOBOL)
    corners = np.array([[x / 2 + i, y / 2 + j, z] for i, j in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))])
    rows = []
    for name, printed, normal, axis in (("wall", on_wall, (0.0, 1.0, 0.0), 2), ("floor", on_floor, (0.0, 0.0, 1.0), 1)):
        for place, value in printed.items():
            point = [x / 2, 0.0, 0.0]
            point[axis] = place
            rows.append(compared(f"{name}, {'xyz'[axis]} = {place:g}", value,
                                 lambda points, normal=normal: of_polygon(points, corners, normal, INTENSITY), point, 0, axis,
                                 measured(maps[name], "illuminance", (int(place / PIXEL), 0)), STRIP))
    return rows


def solid_angle(distance: float, ends: Sequence[float], others: Sequence[float]) -> float:
    """Return the solid angle of a rectangle, whose edges are so far to either side of the foot of the perpendicular [sr]."""
    return sum(math.atan(a * b / (distance * math.sqrt(a * a + b * b + distance**2))) for a in ends for b in others)


def conservation(trace: Trace) -> list[Row]:
    """5.4: what of an isotropic lamp arrives on each wall of a black room, and on all."""
    x, y, z = ROOM
    walls = {"floor": (frame(x / 2, y / 2), x, y, 2, 0), "ceiling": (frame(x / 2, y / 2, z), x, y, 2, 1),
             "left": (frame(0.0, y / 2, z / 2, ry=1), z, y, 0, 0), "right": (frame(x, y / 2, z / 2, ry=1), z, y, 0, 1),
             "front": (frame(x / 2, 0.0, z / 2, rx=1), x, z, 1, 0), "back": (frame(x / 2, y, z / 2, rx=1), x, z, 1, 1)}
    lamp = {"type": "point", "cs": frame(*LAMP), "half_angle_deg": 180.0, "total_flux_lumens": LUMENS}
    _, maps = trace(room(lamp, [detector(name, cs, width, height) for name, (cs, width, height, _, _) in walls.items()]), *SOBOL)
    sides = [(LAMP[axis], ROOM[axis] - LAMP[axis]) for axis in range(3)]
    rows = []
    for name, (_, _, _, axis, end) in walls.items():
        exact = LUMENS * solid_angle(sides[axis][end], *(sides[other] for other in range(3) if other != axis)) / (4.0 * math.pi)
        rows.append(Row(name, None, exact, exact, *measured(maps[name], "luminous_flux")))
    return [*rows, Row("all, arriving", LUMENS, LUMENS, LUMENS, sum(row.ours for row in rows), 0.0)]


def cube(trace: Trace, reflectance: float, events: int) -> Row:
    """Return the indirect illuminance of the floor, from rays of at most so many events."""
    half = CUBE / 2
    turned = {"floor wall": frame(z=-half), "ceiling": frame(z=half), "left": frame(-half, ry=1), "right": frame(half, ry=1),
              "front": frame(y=-half, rx=1), "back": frame(y=half, rx=1)}
    white = {"shape": {"type": "plane", "width": 1e3 * CUBE, "height": 1e3 * CUBE}, "interaction": "reflective",
             "reflectance": reflectance, "bsdf": {"type": "lambertian"}, "scatter_fraction": 1.0}
    lamp = {"type": "point", "cs": frame(), "half_angle_deg": 180.0, "total_flux_lumens": LUMENS}
    floor = detector("floor", frame(z=-half + 1e-3 * GAP), CUBE, CUBE, (1, 1), absorb=False)
    scene = room(lamp, [floor], surfaces=[{"name": name, "cs": cs, **white} for name, cs in turned.items()])
    report, maps = trace(scene, "--max-depth", str(events), "--min-flux-fraction", "0.01", "--where", "scatterings >= 1",
                         share=CUBE_SHARE)
    direct = LUMENS / (6.0 * CUBE**2)
    exact = direct * reflectance / (1.0 - reflectance)
    # Light passes the detector on its way to the floor and on its way back; the lamp's own light is kept on the latter alone.
    seen, error = (value / (1.0 + reflectance) for value in measured(maps["floor"], "illuminance", (0, 0)))
    ours = seen - reflectance * direct / (1.0 + reflectance)
    return Row(f"reflectance {reflectance:g}", INDIRECT[reflectance], exact, exact, ours, error,
               warnings=tuple(report["diagnostics"]["grave"]))


def interreflection(trace: Trace) -> list[Row]:
    """5.8: the indirect illuminance of a diffuse cube, Phi rho / (A (1 - rho)), by its reflectance."""
    return [cube(trace, reflectance, DEPTH) for reflectance in INDIRECT]


def depth_is_told(trace: Trace) -> bool:
    """Whether too few events lose light, and the report warns of it; says both."""
    row = cube(trace, max(INDIRECT), TOO_FEW_EVENTS)
    print(f"\n{row.place}, at most {TOO_FEW_EVENTS} events: {row.ours:.1f} lx, {100.0 * (row.ours / row.exact - 1.0):+.1f} %. "
          f"The report: {'; '.join(row.warnings) or 'no warning'}")
    return row.ours < 0.5 * row.exact and any("depth limit" in warning for warning in row.warnings)


CASES: dict[str, Callable[[Trace], list[Row]]] = {"5.2": point_source, "5.3": area_source, "5.4": conservation,
                                                  "5.8": interreflection}


def asymmetric_lamp() -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Return azimuths, polar angles and candela of a lamp without any symmetry, and the text of its file."""
    azimuths, polar = np.arange(0.0, 361.0, 15.0), np.arange(0.0, 91.0, 5.0)
    c, gamma = np.meshgrid(np.radians(azimuths), np.radians(polar), indexing="ij")
    candela = np.round(500.0 * np.cos(gamma) * (1.0 + np.sin(gamma) * (0.6 * np.cos(c - 0.5) + 0.3 * np.sin(2.0 * c))), 3)
    numbers = (f"1 -1 1 {len(polar)} {len(azimuths)} 1 2 0 0 0", "1 1 10", *(" ".join(f"{value:g}" for value in row) for row in
               (polar, azimuths, *candela)))
    return azimuths, polar, candela, "\n".join(("IESNA:LM-63-2002", "[TEST] none", "[MANUFAC] none", "TILT=NONE", *numbers, ""))


def by_radiance(text: str, folder: Path) -> Illuminance:
    """Return the illuminance that Radiance computes below a lamp."""
    import pyradiance

    path, octree = folder / "lamp.ies", folder / "lamp.oct"
    path.write_text(text, encoding="ascii")
    pyradiance.ies2rad(path, outname=str(path.with_suffix("")))
    octree.write_bytes(pyradiance.oconv(path.with_suffix(".rad")))

    def illuminance(points: np.ndarray) -> np.ndarray:
        rays = "".join(f"{x} {y} {z} 0 0 1\n" for x, y, z in points.reshape(-1, 3))
        found = pyradiance.rtrace(rays.encode(), octree, header=False, irradiance=True, params=["-ab", "0", "-ds", "0", "-dt", "0"])
        # A watt of Radiance has 179 lm, whatever its colour.
        return 179.0 * np.array(found.split(), float)[::3].reshape(points.shape[:-1])

    return illuminance


def beside_radiance(trace: Trace) -> list[Row]:
    """A lamp's file without any symmetry, 2 m above a floor, by Radiance."""
    height, reach = 2.0, 1.2
    azimuths, polar, candela, text = asymmetric_lamp()
    table = RegularGridInterpolator((azimuths, polar), candela)

    def exact(points: np.ndarray) -> np.ndarray:
        x, y = points[..., 0], points[..., 1]
        distance = np.sqrt(x**2 + y**2 + height**2)
        angles = np.degrees(np.stack([np.arctan2(y, x) % (2.0 * np.pi), np.arccos(height / distance)], axis=-1))
        return np.asarray(table(angles) * height / distance**3)

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        theirs = by_radiance(text, Path(folder))
        lamp = {"type": "tabulated", "cs": frame(z=height, rx=2), "file": str(Path(folder, "lamp.ies"))}
        _, maps = trace(room(lamp, [detector("floor", frame(), 2 * reach + PIXEL, 2 * reach + PIXEL)]), *SOBOL)
        for x, y in itertools.product((-reach, 0.0, reach), repeat=2):
            point = (x, y, -height)
            index = round((reach + y) / PIXEL), round((reach + x) / PIXEL)
            rows.append(Row(f"({x:g}, {y:g})", round(over_pixel(exact, point, 0, 1), 3), float(theirs(np.array(point))),
                            over_pixel(theirs, point, 0, 1), *measured(maps["floor"], "illuminance", index), OF_RADIANCE))
    return rows


def table(title: str, rows: list[Row], printed: str = "CIE", exact: str = "exact") -> bool:
    """Print a case; whether all of it holds."""
    print(f"\n{title}\n\n| place | {printed} | {exact}, at the point | {exact}, over the pixel | nsq-gpu | std. error | difference "
          "| in errors |\n|---|---|---|---|---|---|---|---|")
    print("\n".join(map(str, rows)), flush=True)
    return all(row.holds for row in rows)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=float, default=2**26, help=f"rays of a scene; in the cube of 5.8 1/{CUBE_SHARE} of them")
    parser.add_argument("--binary", help="the built command")
    parser.add_argument("--case", nargs="+", choices=CASES, default=list(CASES), help="these alone")
    parser.add_argument("--radiance", action="store_true", help="only a lamp's file beside Radiance, where pyradiance is installed")
    given = parser.parse_args(arguments)
    trace, hold = tracer(find_binary(given.binary), int(given.rays)), True
    if given.radiance:
        if not importlib.util.find_spec("pyradiance"):
            print("SKIPPED: Radiance: pyradiance is not installed")
            return 0
        return 0 if table(f"{beside_radiance.__doc__} [lx]", beside_radiance(trace), "exact", "Radiance") else 1
    for case in given.case:
        unit = "lm" if case == "5.4" else "lx"
        hold &= table(f"{CASES[case].__doc__} [{unit}]", CASES[case](trace))
        if case == "5.8":
            hold &= depth_is_told(trace)
    return 0 if hold else 1


if __name__ == "__main__":
    sys.exit(main())
