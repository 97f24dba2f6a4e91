"""Measured scattering: files, refusals, draws against closed forms, distributions against the table, and traces against NumPy."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.components.configs import LensConfig, MirrorConfig, SurfaceConfig
from optiland.nonsequential.detectors.configs import FarFieldDetectorConfig
from optiland.nonsequential.rng import EventSlot, NSQRng
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import chi2

import nsq_gpu
from nsq_gpu.bsdf import MeasuredBSDF, by_tis, tis
from nsq_gpu.export import export, to_json
from nsq_gpu.scene_file import scene_from_dict
from tests import live
from tests.live import cs, glass

pytestmark = pytest.mark.in_turn

INCIDENCES = [0.0, 20.0, 60.0]
RADIALS = [0.0, 5.0, 20.0, 45.0, 90.0, 140.0]

#: Azimuths of tables, and a factor of the values by azimuth [rad] and radial angle [rad].
TABLES: dict[str, tuple[list[float], Callable[[Any, Any], Any]]] = {
    "one azimuth": ([0.0], lambda a, r: 1.0 + 0.0 * a * r),
    "mirrored": ([0.0, 30.0, 90.0, 150.0, 180.0], lambda a, r: 1.0 + 0.8 * np.cos(a) * np.sin(r)),
    "full": ([0.0, 50.0, 90.0, 200.0, 310.0, 360.0], lambda a, r: 1.0 + 0.9 * np.sin(a + 0.5) * np.sin(r)),
    # The values differ at the ends.
    "gap": ([0.0, 90.0, 180.0, 270.0, 360.0], lambda a, r: 0.1 + a * np.sin(r)),
    "closing": ([60.0 * i for i in range(6)], lambda a, r: 1.0 + 0.9 * np.sin(a + 0.5) * np.sin(r)),
    "sector": ([0.0, 40.0, 80.0, 120.0, 360.0], lambda a, r: np.where((a > 0.5) & (a < 1.5), 1.0, 0.0) + 0.0 * r),
}


def values(name: str) -> np.ndarray:
    """Return values of a table, shape (incidences, azimuths, radial angles)."""
    azimuths, factor = TABLES[name]
    i, a, r = np.meshgrid(*map(np.radians, (INCIDENCES, azimuths, RADIALS)), indexing="ij")
    return np.asarray(factor(a, r) * (0.05 + 0.2 / (1.0 + (r / (0.3 + 0.4 * i)) ** 2)) * (1.0 + i))


def measured(name: str, **options: Any) -> MeasuredBSDF:
    return MeasuredBSDF(INCIDENCES, TABLES[name][0], RADIALS, values(name), **options)


def zemax(bsdf: MeasuredBSDF, symmetry: str = "ASymmetrical", gap: str = "  ", end: str = "\n") -> str:
    """Return a BSDF as Zemax writes it."""
    axes = {"AngleOfIncidence": bsdf.angle_of_incidence_deg, "ScatterAzimuth": bsdf.scatter_azimuth_deg,
            "ScatterRadial": bsdf.scatter_radial_deg}
    lines = ["#Data of a test", "Source\tMeasured", f"Symmetry {symmetry}", "SpectralContent Monochrome", f"ScatterType {bsdf.scatter_type}",
             "SampleRotation 1", "0"]
    for name, angles in axes.items():
        lines += [f"{name}{gap}{len(angles)}", gap.join(map(repr, angles.tolist()))]
    lines += ["", "Monochrome", "DataBegin"]
    for k, rows in enumerate(bsdf.values.tolist()):
        if bsdf.given_tis is not None:
            lines.append(f"TIS{gap}{bsdf.given_tis.tolist()[k]!r}")
        lines += [gap.join(map(repr, row)) for row in rows]
    return end.join([*lines, "DataEnd", ""])


def csv(bsdf: MeasuredBSDF, order: tuple[int, ...] = (0, 1, 2, 3)) -> str:
    names = ("angle_of_incidence_deg", "scatter_azimuth_deg", "scatter_radial_deg", "bsdf")
    rows = [(i, a, r, bsdf.values[k, j, n])
            for k, i in enumerate(bsdf.angle_of_incidence_deg) for j, a in enumerate(bsdf.scatter_azimuth_deg)
            for n, r in enumerate(bsdf.scatter_radial_deg)]
    # Every row once, in some order.
    rows = [rows[(7 * place) % len(rows)] for place in range(len(rows))] if len(rows) % 7 else rows[::-1]
    lines = [",".join(names[place] for place in order), *(",".join(repr(float(row[place])) for place in order) for row in rows)]
    return "\n".join(["# a table", f"# scatter_type: {bsdf.scatter_type}", *lines, ""])


def read(folder: Path, name: str, text: str) -> MeasuredBSDF:
    # As it is, without the ends of lines of this machine.
    (folder / name).write_bytes(text.encode("utf-8"))
    return MeasuredBSDF.from_file(folder / name)


def assert_same(one: MeasuredBSDF, other: MeasuredBSDF) -> None:
    for name in ("angle_of_incidence_deg", "scatter_azimuth_deg", "scatter_radial_deg", "values", "tis"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert (one.given_tis is None, one.scatter_type) == (other.given_tis is None, other.scatter_type)


# Files


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("options", [{}, {"tis": [0.1, 0.2, 0.25], "scatter_type": "BTDF"}])
def test_both_formats_say_what_the_arguments_say(name: str, options: dict[str, Any], tmp_path: Path) -> None:
    bsdf = measured(name, **options)
    found = read(tmp_path, "one.bsdf", zemax(bsdf))
    assert_same(found, bsdf)
    assert found.path == tmp_path / "one.bsdf"
    without_tis = measured(name, scatter_type=bsdf.scatter_type)
    assert_same(read(tmp_path, "one.csv", csv(bsdf)), without_tis)
    assert_same(read(tmp_path, "other.CSV", csv(bsdf, (3, 1, 0, 2))), without_tis)


def test_files_may_be_written_in_many_ways(tmp_path: Path) -> None:
    bsdf = measured("mirrored", tis=[0.1, 0.2, 0.25], scatter_type="BTDF")
    text = zemax(bsdf)
    ways = [zemax(bsdf, "PlaneSymmetrical", "\t", "\r\n"), zemax(bsdf, "ASYMMETRICAL4D", " \t "), text.lower(), text.upper(), "\ufeff" + text,
            text.replace("\n", "\n\n"), text.replace("\n", "  # what it is\n"), text.replace("ScatterRadial  6\n", "ScatterRadial  6 "),
            text.replace("20.0  45.0", "20.0\n45.0"), text.rstrip("\n")]
    for place, way in enumerate(ways):
        assert_same(read(tmp_path, f"{place}.BSDF", way), bsdf)
    plain, table = measured("mirrored", scatter_type="BTDF"), csv(bsdf)
    for way in (table.replace("\n", "\r\n"), table.upper(), table.replace(",", "\t, "), "\ufeff" + table, table.replace("\n", "\n\n")):
        assert_same(read(tmp_path, "way.csv", way), plain)
    assert read(tmp_path, "way.csv", table.replace("# scatter_type: BTDF", "#")).scatter_type == "BRDF"


#: What is replaced in a file of Zemax, by what, and what the message says.
BROKEN = {
    "rotations": ("SampleRotation 1\n0", "SampleRotation 2\n0 90",
                  r"f.bsdf:6: SampleRotation has 2 angles: the sample is anisotropic, and surfaces are not; give a file of one rotation"),
    "colours": ("SpectralContent Monochrome", "SpectralContent XYZ", r"f.bsdf:4: SpectralContent is XYZ, a BSDF by colours; give a file"),
    "content": ("SpectralContent Monochrome", "SpectralContent Red", r"f.bsdf:4: SpectralContent is 'Red'; give Monochrome, XYZ"),
    "symmetry": ("ASymmetrical", "Round", r"f.bsdf:3: Symmetry is 'Round'; give PlaneSymmetrical, ASymmetrical, ASymmetrical4D"),
    "scatter type": ("ScatterType BRDF", "ScatterType BSDF", r"f.bsdf:5: ScatterType is 'BSDF'; give BRDF, BTDF"),
    "unknown": ("Monochrome\nDataBegin", "Chrome\nDataBegin", r"f.bsdf:15: 'Chrome' is no word of a tabular BSDF; remove the line"),
    "twice": ("SampleRotation 1\n0", "Symmetry ASymmetrical", r"f.bsdf:6: Symmetry stands here a second time, after line 3; one"),
    "no axis": ("ScatterAzimuth  2\n0.0  180.0", "", r"f.bsdf:15: the data begins, and there was no line ScatterAzimuth; add it above"),
    "no type": ("ScatterType BRDF", "", r"f.bsdf:16: the data begins, and there was no line ScatterType; add it above"),
    "no count": ("ScatterAzimuth  2", "ScatterAzimuth", r"f.bsdf:10: ScatterAzimuth has no number of angles; write it as ScatterAzimuth 2"),
    "few angles": ("ScatterAzimuth  2", "ScatterAzimuth  3", r"f.bsdf:12: 'ScatterRadial' stands where a number is due; give a number"),
    "many angles": ("ScatterAzimuth  2", "ScatterAzimuth  1", r"f.bsdf:11: ScatterAzimuth has 2 angles, and 1 in its number of angles"),
    "no angle": ("0.0  180.0", "0.0  pi", r"f.bsdf:11: 'pi' stands where a number is due"),
    "first azimuth": ("0.0  180.0", "10.0  180.0", r"f.bsdf:10: scatter_azimuth_deg\[0\] is 10; give angles that begin with 0 deg"),
    "last azimuth": ("0.0  180.0", "0.0  90.0", r"f.bsdf:10: scatter_azimuth_deg\[1\] is 90; give angles that end with 180, with 360 or one"),
    "falling": ("0.0  40.0", "40.0  0.0", r"f.bsdf:8: angle_of_incidence_deg\[1\] is 0, after 40; give angles that rise"),
    "value": ("0.3  0.2  0.1", "0.3  x  0.1", r"f.bsdf:19: 'x' stands where a number is due; give a number, such as 0.05"),
    "not finite": ("0.3  0.2  0.1", "0.3  inf  0.1", r"f.bsdf:19: 'inf' stands where a number is due"),
    "negative": ("0.3  0.2  0.1", "0.3  -0.2  0.1", r"f.bsdf:19: it has the number -0.2; give numbers of 0 or more"),
    "short row": ("0.3  0.2  0.1", "0.3  0.2", r"f.bsdf:19: the row has 2 values, and there are 3 radial angles; give one for each"),
    "no row": ("0.3  0.2  0.1\nTIS", "TIS", r"f.bsdf:19: TIS stands where the row of the azimuth 180 at the incidence 0 is due; add the row"),
    "many rows": ("DataEnd", "1 2 3\nDataEnd", r"f.bsdf:23: the rows of all angles are read, and DataEnd is due; remove what is too much"),
    "cut off": ("0.6  0.6  0.5\nDataEnd\n", "", r"f.bsdf: the file ends, and the row of the azimuth 180 at the incidence 40 is due; is it cut"),
    "more": ("DataEnd", "DataEnd\nDataBegin", r"f.bsdf:24: there is more after DataEnd; remove it"),
    "no data": ("DataBegin", "DataEnd", r"f.bsdf:16: 'DataEnd' is no word of a tabular BSDF"),
    "share": ("TIS  0.5", "TIS  50", r"f.bsdf:17: TIS is 50, more light than there is; give a share from 0 to 1"),
    "no share": ("TIS  0.5", "TIS", r"f.bsdf:17: TIS has one number; write it as TIS 0.05"),
    "one share": ("TIS  0.5\n", "", r"f.bsdf:22: the incidence 0 has no TIS, and others have; give it to all or to none"),
    "share of nothing": ("0.5  0.4  0.3\n0.6  0.6  0.5", "0 0 0\n0 0 0",
                         r"f.bsdf:20: tis\[1\] is 0.75, and all values above the surface there are 0; give 0, or values above 0"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_file_of_zemax_is_refused_with_its_line(what: str, tmp_path: Path) -> None:
    bsdf = MeasuredBSDF([0.0, 40.0], [0.0, 180.0], [0.0, 30.0, 90.0], [[[0.4, 0.2, 0.1], [0.3, 0.2, 0.1]], [[0.5, 0.4, 0.3], [0.6, 0.6, 0.5]]],
                        [0.5, 0.75])
    old, new, words = BROKEN[what]
    text = zemax(bsdf)
    assert text.count(old) == 1, "the test replaces one place"
    with pytest.raises(ValueError, match=words):
        read(tmp_path, "f.bsdf", text.replace(old, new))


HEADER = "angle_of_incidence_deg,scatter_azimuth_deg,scatter_radial_deg,bsdf\n"


@pytest.mark.parametrize(("name", "text", "words"), [
    ("f.csv", "", r"f.csv: there is no row; begin the file with the line angle_of_incidence_deg,"),
    ("f.csv", HEADER, r"f.csv: there is no row"),
    ("f.csv", "0,0,0,1\n0,0,90,1\n", r"f.csv:1: it names the columns 0, 0, 0, 1; write angle_of_incidence_deg,scatter_azimuth_deg"),
    ("f.csv", HEADER.replace("bsdf", "bsdf,tis"), r"f.csv:1: it names the columns .*, bsdf, tis; write"),
    ("f.csv", HEADER + "0,0,0\n", r"f.csv:2: it has 3 columns, and the header has 4; give a number in each"),
    ("f.csv", HEADER + "0,0,0,many\n", r"f.csv:2: 'many' stands where a number is due"),
    ("f.csv", HEADER + "0,0,0,-1\n", r"f.csv:2: it has the number -1; give numbers of 0 or more"),
    ("f.csv", HEADER + "0,0,0,1\n0,0,90,1\n0,0,0.0,2\n", r"f.csv:4: incidence 0, azimuth 0, radial 0 stands here a second time, after line 2"),
    ("f.csv", HEADER + "0,0,0,1\n0,0,90,1\n5,0,0,2\n", r"f.csv: incidence 5, azimuth 0, radial 90 is missing; give every combination"),
    ("f.csv", HEADER + "0,0,0,1\n", r"f.csv: scatter_radial_deg has one angle; give two or more"),
    ("f.csv", "# Scatter_Type: BSDF\n" + HEADER + "0,0,0,1\n0,0,9,1\n", r"f.csv:1: scatter_type is 'BSDF'; give 'BRDF' or 'BTDF'"),
    ("f.txt", "", r"f.txt: the name ends with '.txt'; give a Zemax file, .bsdf, or a table, .csv"),
])
def test_a_broken_table_is_refused(name: str, text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=words):
        read(tmp_path, name, text)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.bsdf"):
        MeasuredBSDF.from_file(tmp_path / "none.bsdf")


PLAIN: dict[str, Any] = {"angle_of_incidence_deg": [0.0], "scatter_azimuth_deg": [0.0], "scatter_radial_deg": [0.0, 90.0],
                         "values": [[[0.3, 0.1]]]}


@pytest.mark.parametrize(("change", "words"), [
    ({"angle_of_incidence_deg": []}, r"angle_of_incidence_deg has the shape \(0,\); give a list of angles"),
    ({"angle_of_incidence_deg": [91.0]}, r"angle_of_incidence_deg\[0\] is 91; give angles from 0 to 90 deg"),
    ({"angle_of_incidence_deg": ["zero"]}, r"angle_of_incidence_deg: could not convert string"),
    ({"angle_of_incidence_deg": [math.nan]}, r"angle_of_incidence_deg\[0\]: it is nan; give a finite number"),
    ({"scatter_azimuth_deg": [0.0, 100.0, 190.0]}, r"scatter_azimuth_deg\[2\] is 190; give angles that end with 180, with 360 or one step"),
    ({"scatter_azimuth_deg": [-10.0, 360.0]}, r"scatter_azimuth_deg\[0\] is -10; give angles from 0 to 360 deg"),
    ({"scatter_radial_deg": [5.0, 90.0]}, r"scatter_radial_deg\[0\] is 5; give angles that begin with 0 deg"),
    ({"scatter_radial_deg": [0.0, 181.0]}, r"scatter_radial_deg\[1\] is 181; give angles from 0 to 180 deg"),
    ({"values": [[[0.3, 0.1, 0.2]]]}, r"values has the shape \(1, 1, 3\); give a number for each angle of incidence, azimuth and radial angle: "
                                      r"\(1, 1, 2\)"),
    ({"values": [[[0.3, -0.1]]]}, r"values\[0\]\[0\]\[1\] is -0.1; give numbers of 0 or more"),
    ({"tis": [0.1, 0.2]}, r"tis has the shape \(2,\); give a number for each angle of incidence: \(1,\)"),
    ({"tis": [-0.1]}, r"tis\[0\] is -0.1; give numbers of 0 or more"),
    ({"tis": [0.1], "values": [[[0.0, 0.0]]]}, r"tis\[0\] is 0.1, and all values above the surface there are 0; give 0"),
    ({"scatter_type": "BSDF"}, r"scatter_type is 'BSDF'; give 'BRDF' or 'BTDF'"),
])
def test_arguments_out_of_range_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MeasuredBSDF(**{**PLAIN, **change})


# Draws


class Draws:
    """Random numbers that are given."""

    def __init__(self, u1: Any, u2: Any) -> None:
        self.by_slot = {EventSlot.BSDF_U1: np.asarray(u1), EventSlot.BSDF_U2: np.asarray(u2)}

    def uniform(self, ray_id: Any, bounce: Any, slot: EventSlot) -> np.ndarray:
        return self.by_slot[slot]


NORMAL = np.array([0.3, -0.5, -0.8]) / math.sqrt(0.98)
SIDE = np.cross(NORMAL, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(NORMAL, [0.0, 0.0, 1.0]))


def drawn(bsdf: MeasuredBSDF, theta_deg: float, rng: Any, num_rays: int, normal: np.ndarray = NORMAL,
          side: np.ndarray = SIDE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return directions, weights and sides of light at an angle of incidence, which goes towards ``side``."""
    theta = math.radians(theta_deg)
    incident = math.sin(theta) * side - math.cos(theta) * normal
    rays, bounce = np.arange(num_rays, dtype=np.uint64), np.zeros(num_rays, dtype=np.uint64)
    return bsdf.sample(num_rays, np.tile(incident, (num_rays, 1)), np.tile(normal, (num_rays, 1)), np.full(num_rays, 0.5), rng, rays, bounce)


def frame(bsdf: MeasuredBSDF, theta_deg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the reference direction, its directions of azimuth 0 and 90, and the normal on its side; by another way."""
    theta, sign = math.radians(theta_deg), -1.0 if bsdf.scatter_type == "BTDF" else 1.0
    up = sign * NORMAL
    reference = math.sin(theta) * SIDE + math.cos(theta) * up
    zero = math.cos(theta) * -SIDE + math.sin(theta) * up
    if theta_deg == 0.0:
        x, y, z = NORMAL
        # Of Duff et al., for a z below 0.
        zero = np.array([1.0 - x * x / (1.0 - z), -x * y / (1.0 - z), x])
    return reference, zero, np.cross(reference, zero), up


def test_an_even_lobe_is_drawn_by_its_closed_form() -> None:
    even = MeasuredBSDF([0.0], [0.0], [0.0, 90.0], [[[0.25, 0.25]]])
    assert even.tis[0] == pytest.approx(0.25 * math.pi, rel=1e-14)
    u1, u2 = (grid.ravel() for grid in np.meshgrid([0.0, 0.1, 0.5, 0.9], [0.0, 0.25, 0.7, 0.999], indexing="ij"))
    directions, weights, transmitted = drawn(even, 0.0, Draws(u1, u2), len(u1))
    reference, zero, ninety, _ = frame(even, 0.0)
    radial, azimuth = np.arccos(1.0 - u2), 2.0 * np.pi * u1
    expected = (np.outer(np.sin(radial) * np.cos(azimuth), zero) + np.outer(np.sin(radial) * np.sin(azimuth), ninety)
                + np.outer(np.cos(radial), reference))
    np.testing.assert_allclose(directions, expected, atol=1e-12)
    np.testing.assert_allclose(weights, 0.25 * 2.0 * math.pi * np.cos(radial), rtol=1e-12, atol=1e-15)
    assert not transmitted.any()


def test_rows_share_the_first_draw_and_the_second_is_the_radial_angle() -> None:
    # Over azimuth, one row rises from 0 to a peak at 180, and falls again; the other one is even. Their radial angles are alike.
    peak = [[0.0, 0.0], [0.4, 0.4]]
    bsdf = MeasuredBSDF([10.0, 50.0], [0.0, 180.0], [0.0, 90.0], [peak, [[0.3, 0.3], [0.3, 0.3]]])
    at = 0.25
    lower, upper = (1.0 - at) * 0.2 * 2.0 * math.pi, at * 0.3 * 2.0 * math.pi
    share = upper / (lower + upper)
    u1, u2 = np.array([0.1 * share, 0.9 * share, share + 0.2 * (1.0 - share), share + 0.8 * (1.0 - share)]), np.array([0.2, 0.4, 0.6, 0.1])
    directions, weights, _ = drawn(bsdf, 20.0, Draws(u1, u2), 4)
    # Of the peak, the share up to an azimuth a below 180 is (a / 180)^2 / 2.
    azimuth = np.pi * np.array([0.2, 1.8, math.sqrt(2.0 * 0.2), 2.0 - math.sqrt(2.0 * 0.2)])
    radial = np.arccos(1.0 - u2)
    reference, zero, ninety, up = frame(bsdf, 20.0)
    expected = (np.outer(np.sin(radial) * np.cos(azimuth), zero) + np.outer(np.sin(radial) * np.sin(azimuth), ninety)
                + np.outer(np.cos(radial), reference))
    np.testing.assert_allclose(directions, expected, atol=1e-12)
    np.testing.assert_allclose(weights, (lower + upper) * np.maximum(expected @ up, 0.0), rtol=1e-12)


def test_azimuth_0_is_a_tangent_of_the_normal_that_the_surface_gives_at_normal_incidence() -> None:
    for scatter_type in ("BRDF", "BTDF"):
        for normal, tangent in (([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]), ([0.0, 0.0, -1.0], [1.0, 0.0, 0.0]), ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]),
                                ([0.0, 1.0, -0.0], [1.0, 0.0, 0.0]), ([1.0, 0.0, -0.0], [0.0, 0.0, -1.0]), ([0.6, 0.0, -0.8], [0.8, 0.0, 0.6])):
            bsdf = MeasuredBSDF(**PLAIN, scatter_type=scatter_type)
            direction = drawn(bsdf, 0.0, Draws([0.0], [0.3]), 1, np.array(normal), np.roll(normal, 1))[0][0]
            reference = np.array(normal) * (-1.0 if scatter_type == "BTDF" else 1.0)
            across = direction - (direction @ reference) * reference
            np.testing.assert_allclose(across / np.linalg.norm(across), tangent, atol=1e-12)


def test_rays_that_hit_nothing_do_no_harm() -> None:
    for axis in np.eye(3):
        for scatter_type in ("BRDF", "BTDF"):
            bsdf = measured("full", scatter_type=scatter_type)
            directions, weights, _ = drawn(bsdf, 90.0, Draws([0.5], [0.5]), 1, np.zeros(3), axis)
            assert np.isfinite(directions).all() and np.isfinite(weights).all()
    # The normals of refractive surfaces may be on the far side of the ray that Fresnel's branch sends on.
    assert drawn(measured("full"), 0.0, Draws([0.5], [0.2]), 1, NORMAL)[1][0] > 0.0
    assert len(drawn(measured("full"), 0.0, Draws([], []), 0)[1]) == 0


# Distributions


def density(bsdf: MeasuredBSDF, theta_deg: float, directions: np.ndarray) -> np.ndarray:
    """Return f cos(theta), scaled as TIS says, by another way than the class's: from the table and the geometry."""
    reference, zero, ninety, up = frame(bsdf, theta_deg)
    azimuths, values = bsdf.scatter_azimuth_deg.tolist(), bsdf.values
    if len(azimuths) == 1:
        azimuths, values = [0.0, 360.0], np.repeat(values, 2, axis=1)
    elif azimuths[-1] == 180.0:
        azimuths = [*azimuths, *(360.0 - azimuth for azimuth in azimuths[-2::-1])]
        values = np.concatenate([values, values[:, -2::-1]], axis=1)
    elif azimuths[-1] != 360.0:
        azimuths, values = [*azimuths, 360.0], np.concatenate([values, values[:, :1]], axis=1)
    if bsdf.given_tis is not None:
        values = values * (bsdf.given_tis / MeasuredBSDF(bsdf.angle_of_incidence_deg, bsdf.scatter_azimuth_deg, bsdf.scatter_radial_deg,
                                                         bsdf.values).tis)[:, None, None]
    table = RegularGridInterpolator((bsdf.angle_of_incidence_deg, azimuths, bsdf.scatter_radial_deg), values, bounds_error=False, fill_value=0.0)
    radial = np.degrees(np.arccos(np.clip(directions @ reference, -1.0, 1.0)))
    azimuth = np.degrees(np.arctan2(directions @ ninety, directions @ zero)) % 360.0
    incidence = np.clip(theta_deg, bsdf.angle_of_incidence_deg[0], bsdf.angle_of_incidence_deg[-1])
    return table(np.stack([np.full_like(radial, incidence), azimuth, radial], axis=-1)) * np.maximum(directions @ up, 0.0)


#: Cells of equal solid angle about the normal.
HEIGHTS, AROUND, WITHIN = 8, 16, 24


def sphere(up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return axes about a normal."""
    return SIDE, np.cross(up, SIDE), up


def shares(bsdf: MeasuredBSDF, theta_deg: float) -> np.ndarray:
    """Return what scatters into each cell of the hemisphere, by midpoints."""
    z = (np.arange(HEIGHTS * WITHIN) + 0.5) / (HEIGHTS * WITHIN)
    phi = 2.0 * np.pi * (np.arange(AROUND * WITHIN) + 0.5) / (AROUND * WITHIN)
    z, phi = np.meshgrid(z, phi, indexing="ij")
    x, y, up = sphere(frame(bsdf, theta_deg)[3])
    s = np.sqrt(1.0 - z * z)
    directions = (s * np.cos(phi))[..., None] * x + (s * np.sin(phi))[..., None] * y + z[..., None] * up
    cell = 2.0 * np.pi / z.size
    return density(bsdf, theta_deg, directions).reshape(HEIGHTS, WITHIN, AROUND, WITHIN).sum(axis=(1, 3)) * cell


def chance(bsdf: MeasuredBSDF, theta_deg: float, expected: np.ndarray, num_rays: int = 100_000) -> float:
    """Return the probability that draws of this distribution are as far from it, by chi-square of the weights in cells."""
    directions, weights, _ = drawn(bsdf, theta_deg, NSQRng(3), num_rays)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=1e-12)
    x, y, up = sphere(frame(bsdf, theta_deg)[3])
    z = directions @ up
    assert not weights[z < -1e-12].any()
    i = np.clip((z * HEIGHTS).astype(int), 0, HEIGHTS - 1)
    j = ((np.arctan2(directions @ y, directions @ x) % (2.0 * np.pi)) * AROUND / (2.0 * np.pi)).astype(int) % AROUND
    cell = i * AROUND + j
    hits, sums, squares = (np.bincount(cell, power, HEIGHTS * AROUND) for power in (weights > 0.0, weights, weights**2))
    full = hits >= 50.0
    sums, squares, wanted = (np.append(per[full], per[~full].sum()) for per in (sums, squares, expected.ravel()))
    means = sums / num_rays
    variances = squares / num_rays**2 - means**2 / num_rays
    known = variances > 0.0
    return float(chi2.sf(((means - wanted)[known] ** 2 / variances[known]).sum(), known.sum()))


@pytest.mark.parametrize("theta_deg", [0.0, 20.0, 47.0, 75.0])
@pytest.mark.parametrize("scatter_type", ["BRDF", "BTDF"])
@pytest.mark.parametrize("name", TABLES)
def test_what_is_drawn_is_the_table(name: str, scatter_type: str, theta_deg: float) -> None:
    bsdf = measured(name, scatter_type=scatter_type, tis=[0.2, 0.5, 0.4] if scatter_type == "BTDF" else None)
    assert 1e-4 < chance(bsdf, theta_deg, shares(bsdf, theta_deg)) < 1.0 - 1e-4


def test_the_test_of_distributions_notices_a_wrong_table() -> None:
    bsdf = measured("full")
    expected = shares(bsdf, 47.0)
    for wrong in (expected[:, ::-1], np.roll(expected, 1, axis=1), expected * 1.05, shares(bsdf, 42.0), shares(measured("mirrored"), 47.0)):
        assert chance(bsdf, 47.0, wrong) < 1e-4


@pytest.mark.parametrize(("scatter_type", "given"), [("BRDF", [0.3, 0.6, 0.05]), ("BTDF", None)])
@pytest.mark.parametrize("name", TABLES)
def test_a_row_scatters_its_share(name: str, scatter_type: str, given: list[float] | None) -> None:
    bsdf = measured(name, tis=given, scatter_type=scatter_type)
    if given is not None:
        np.testing.assert_array_equal(bsdf.tis, given)
    for theta, share in zip(INCIDENCES, bsdf.tis, strict=True):
        np.testing.assert_allclose(shares(bsdf, theta).sum(), share, rtol=2e-3)
        _, weights, transmitted = drawn(bsdf, theta, NSQRng(1), 100_000)
        assert abs(weights.mean() - share) < 5.0 * weights.std() / math.sqrt(len(weights))
        assert (transmitted == (scatter_type == "BTDF")).all()


def test_the_share_of_a_lobe_across_the_horizon_is_exact() -> None:
    # An even hemisphere about the mirrored ray: by symmetry, the part above the surface is a lune.
    for theta in (0.0, 10.0, 45.0, 80.0, 90.0):
        even = MeasuredBSDF([theta], [0.0], [0.0, 90.0], [[[1.0, 1.0]]])
        # The integral of the cosine over the hemisphere about a direction, cut by the surface.
        assert even.tis[0] == pytest.approx(math.pi * (1.0 + math.cos(math.radians(theta))) / 2.0, rel=1e-13)
        # All around: the surface's own hemisphere.
        around = MeasuredBSDF([theta], [0.0], [0.0, 180.0], [[[1.0, 1.0]]])
        assert around.tis[0] == pytest.approx(math.pi, rel=1e-13)


def test_a_row_below_the_surface_and_a_dark_row_scatter_nothing() -> None:
    below = MeasuredBSDF([0.0], [0.0], [0.0, 90.0, 180.0], [[[0.0, 0.0, 1.0]]], tis=[0.0])
    assert below.tis[0] == 0.0 and not drawn(below, 0.0, NSQRng(0), 100)[1].any()
    dark = MeasuredBSDF([0.0, 40.0], [0.0], [0.0, 90.0], [[[0.0, 0.0]], [[0.2, 0.2]]])
    directions, weights, _ = drawn(dark, 0.0, NSQRng(0), 100)
    assert not weights.any()
    np.testing.assert_allclose(directions, np.tile(NORMAL, (100, 1)), atol=1e-12)
    # Between, the level rises from 0.
    levels = [drawn(dark, theta, NSQRng(0), 20_000)[1].mean() for theta in (10.0, 20.0)]
    assert levels[1] / levels[0] == pytest.approx(2.0, rel=0.05)


# Total integrated scatter


def test_tis_is_that_of_the_first_row() -> None:
    for bsdf in (measured("full"), measured("full", tis=[0.2, 0.5, 0.4])):
        assert tis(bsdf) == bsdf.tis[0]
        found = by_tis(bsdf)
        level = found["bsdf"]
        assert found["scatter_fraction"] == bsdf.tis[0] and (level.given_tis is None) == (bsdf.given_tis is None)
        np.testing.assert_allclose(level.tis, bsdf.tis / bsdf.tis[0], rtol=1e-13)
        for theta in (0.0, 33.0, 80.0):
            one, other = (drawn(which, theta, NSQRng(2), 1000) for which in (bsdf, level))
            np.testing.assert_allclose(other[0], one[0], atol=1e-9)
            np.testing.assert_allclose(other[1] * bsdf.tis[0], one[1], rtol=1e-11, atol=1e-14)
    with pytest.raises(ValueError, match=r"MeasuredBSDF is 1\.5.*, more light than there is; give a BSDF of 0\.6.* times the height or less"):
        by_tis(MeasuredBSDF([0.0], [0.0], [0.0, 90.0], [[[0.5, 0.5]]]))
    with pytest.raises(ValueError, match="MeasuredBSDF scatters nothing at normal incidence"):
        by_tis(MeasuredBSDF([0.0], [0.0], [0.0, 90.0], [[[0.0, 0.0]]]))


# Scenes


def slanted(bsdf: MeasuredBSDF, scatter_fraction: float = 1.0) -> NSQScene:
    """Return a mirror that all light meets, at up to 71 degrees, and a far field of what goes back."""
    scene = live.bench()
    scene.add_mirror("M", cs(rx=0.6, ry=-0.2), MirrorConfig(math.inf, 0.9, aperture_radius=100.0,
                                                                   surface=SurfaceConfig(bsdf=bsdf, scatter_fraction=scatter_fraction)))
    scene.add_detector("far", cs(z=-25.0, rx=math.pi), FarFieldDetectorConfig(num_theta=18, num_phi=24))
    return scene


def document(scene: NSQScene) -> dict[str, Any]:
    written: dict[str, Any] = json.loads(to_json(export(scene).document))
    return written


def test_optilands_own_backend_traces_it() -> None:
    """All of a narrow lobe goes on: of the light, the share that scatters, times the reflectance."""
    incidences = np.arange(0.0, 86.0, 5.0)
    narrow = MeasuredBSDF(incidences, [0.0], [0.0, 1.0], np.ones((18, 1, 2)), np.full(18, 0.3))
    result = slanted(narrow).trace(20_000, backend=NumpyBackend(seed=1))
    assert result.total_flux_escaped + result.total_flux_detected == pytest.approx(0.9 * 0.3, rel=0.005)


@pytest.mark.parametrize("suffix", [".bsdf", ".csv"])
def test_a_file_an_export_and_a_scene_file_are_one(suffix: str, tmp_path: Path) -> None:
    for name, options in (("full", {"tis": [0.1, 0.2, 0.25]}), ("closing", {"scatter_type": "BTDF"}), ("one azimuth", {})):
        bsdf = measured(name, **options)
        found = read(tmp_path, f"one{suffix}", zemax(bsdf) if suffix == ".bsdf" else csv(bsdf))
        written = document(slanted(found))
        inline = written["nsq_gpu"]["overrides"]["M.surface"]["bsdf"]
        assert inline["type"] == "measured" and inline["scatter_type"] == bsdf.scatter_type
        assert ("tis" in inline) == (suffix == ".bsdf" and "tis" in options) and "transmissive_fraction" not in inline
        again = scene_from_dict(written)
        assert type(again.surfaces[0].bsdf) is MeasuredBSDF
        assert_same(again.surfaces[0].bsdf, found)
        assert document(again) == written
        by_path = {**inline, "path": f"one{suffix}"}
        written["nsq_gpu"]["overrides"]["M.surface"]["bsdf"] = {key: by_path[key] for key in ("type", "path")}
        assert_same(scene_from_dict(written, tmp_path).surfaces[0].bsdf, found)


def test_a_measured_mirror_equals_numpy_ray_by_ray() -> None:
    for name, options in (("full", {}), ("mirrored", {"tis": [0.2, 0.5, 0.4]}), ("sector", {}), ("one azimuth", {"scatter_type": "BTDF"})):
        live.assert_equals_numpy(slanted(measured(name, **options)), 4000)
    live.assert_equals_numpy(slanted(measured("gap"), 0.6), 4000)


@pytest.mark.parametrize("scatter_type", ["BRDF", "BTDF"])
def test_a_measured_lens_equals_numpy_ray_by_ray(scatter_type: str) -> None:
    scene = live.bench()
    finish = SurfaceConfig(bsdf=measured("closing", scatter_type=scatter_type), scatter_fraction=0.7)
    scene.add_lens("L", cs(), LensConfig(60.0, -60.0, 5.0, glass(), 10.0, front=finish))
    scene.add_detector("far", cs(z=-25.0, rx=math.pi), FarFieldDetectorConfig(num_theta=18, num_phi=24))
    live.assert_equals_numpy(scene, 4000)


def test_a_measured_file_in_a_scene_file_equals_numpy(tmp_path: Path) -> None:
    """The command's own reading of both files, by the share of the first row."""
    bsdf = measured("closing", tis=[0.1, 0.2, 0.25])
    (tmp_path / "one.bsdf").write_text(zemax(bsdf), encoding="utf-8")
    (tmp_path / "one.csv").write_text(csv(bsdf), encoding="utf-8")
    for name in ("one.bsdf", "one.csv"):
        written = document(slanted(bsdf))
        written["nsq_gpu"]["overrides"]["M.surface"] |= {"bsdf": {"type": "measured", "path": name}, "scatter_fraction": "tis"}
        path = tmp_path / "scene.json"
        path.write_text(json.dumps(written), encoding="utf-8")
        scene = nsq_gpu.load_scene(path)
        assert scene.surfaces[0].scatter_fraction == tis(MeasuredBSDF.from_file(tmp_path / name))
        theirs = live.traced(scene, 4000, NumpyBackend())[1]
        ours = live.parity.trace_with_binary([live.binary()], path, 4000, 0, "f64")
        assert not (violations := live.compare(ours, theirs).violations), violations
