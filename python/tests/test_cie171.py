"""``benches/cie171.py``: its cases hold with few rays, and a lamp that is too strong or light that is lost is noticed."""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "benches"))

import cie171
from cie171 import CASES, Json, Trace, Traced

#: A wall needs few rays. Single pixels need more, until 5 % are many standard errors.
RAYS, MANY = 1 << 18, 1 << 22


@pytest.fixture
def few_reflectances(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cie171, "INDIRECT", {reflectance: cie171.INDIRECT[reflectance] for reflectance in (0.2, 0.95)})


@pytest.fixture
def trace(command: list[str], few_reflectances: None) -> Trace:
    return cie171.tracer(command[0], RAYS)


def stronger(trace: Trace, factor: float) -> Trace:
    """Return a trace of lamps that are stronger by this factor."""

    def traced(scene: Json, *options: str, **keys: int) -> Traced:
        changed = copy.deepcopy(scene)
        for lamp in changed["sources"]:
            if "total_flux_lumens" in lamp:
                lamp["total_flux_lumens"] *= factor
            else:
                lamp["intensity"] = (factor * np.array(lamp["intensity"])).tolist()
        return trace(changed, *options, **keys)

    return traced


@pytest.mark.parametrize("case", CASES)
def test_case(case: str, trace: Trace) -> None:
    rows = CASES[case](trace)
    assert not (off := [str(row) for row in rows if not row.holds]), off
    # What CIE prints has three to five digits; a pixel is small.
    assert all(row.point == pytest.approx(row.printed, rel=6e-3) for row in rows if row.printed)
    assert all(row.exact == pytest.approx(row.point, rel=4e-3) for row in rows)


@pytest.mark.parametrize(("case", "num_rays"), [("5.2", MANY), ("5.3", MANY), ("5.4", RAYS), ("5.8", RAYS)])
@pytest.mark.usefixtures("few_reflectances")
def test_a_stronger_lamp_is_noticed(case: str, num_rays: int, command: list[str], capsys: pytest.CaptureFixture[str],
                                    monkeypatch: pytest.MonkeyPatch) -> None:
    """By 5 %, and the program that is run says so by its exit code."""
    original = cie171.tracer
    monkeypatch.setattr(cie171, "tracer", lambda binary, rays: stronger(original(binary, rays), 1.05))
    assert cie171.main(["--binary", *command, "--case", case, "--rays", str(num_rays)]) == 1
    assert "**off**" in capsys.readouterr().out


def test_light_lost_at_the_depth_limit_is_told(trace: Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cie171.depth_is_told(trace)
    monkeypatch.setattr(cie171, "TOO_FEW_EVENTS", cie171.DEPTH)
    assert not cie171.depth_is_told(trace)


def test_formulas() -> None:
    """A polygon's formula is the integral over it; the walls of a room fill the sphere."""
    corners = np.array([[-0.5, -0.5, 3.0], [0.5, -0.5, 3.0], [0.5, 0.5, 3.0], [-0.5, 0.5, 3.0]])
    places, weights = np.polynomial.legendre.leggauss(12)
    x, y = np.meshgrid(0.5 * places, 0.5 * places)
    integral = weights @ (100.0 * 9.0 / ((x - 0.3) ** 2 + (y - 0.7) ** 2 + 9.0) ** 2) @ weights / 4.0
    assert cie171.of_polygon(np.array([0.3, 0.7, 0.0]), corners, (0.0, 0.0, 1.0), 100.0) == pytest.approx(integral, rel=1e-9)
    sides = [(1.0, 3.0), (1.5, 2.5), (2.0, 1.0)]
    walls = [cie171.solid_angle(side[end], *(sides[:axis] + sides[axis + 1:])) for axis, side in enumerate(sides) for end in (0, 1)]
    assert sum(walls) == pytest.approx(4.0 * np.pi, rel=1e-12)


def test_radiance_is_skipped_by_name(command: list[str], capsys: pytest.CaptureFixture[str],
                                     monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cie171.importlib.util, "find_spec", lambda name: None)
    assert cie171.main(["--binary", *command, "--radiance"]) == 0
    assert capsys.readouterr().out == "SKIPPED: Radiance: pyradiance is not installed\n"
