"""Colours of ten spectra beside luxpy, a second referee; colour-science is the first, in ``test_color.py``.

luxpy is under the GPL and large, so that no requirement names it. Nor does it run with NumPy 2.4: ``pip install luxpy matplotlib
"numpy<2.3"`` into an environment of its own, and name that environment's Python: ``NSQ_GPU_LUXPY=/path/to/bin/python``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from tests import live
from tests.test_color import LINES, SPECTRA, colour, wall

#: What luxpy is asked, in its own process: X, Y, Z, x, y, u', v', and CCT and Duv of each spectrum, a row of W at ``LINES``.
ASKED = """
import json, sys
import luxpy, numpy
lines, spectra = json.load(sys.stdin)
nm = numpy.arange(360.0, 831.0)
spd = numpy.zeros((len(spectra) + 1, len(nm)))
spd[0] = nm
spd[1:, numpy.searchsorted(nm, lines)] = spectra
xyz = luxpy.spd_to_xyz(spd, cieobs="1931_2", relative=False, K=683.002)
cct, duv = (luxpy.xyz_to_cct(xyz, cieobs="1931_2", out=out, atol=1e-4, rtol=1e-9) for out in ("cct", "duv"))
found = numpy.hstack([xyz, luxpy.xyz_to_Yxy(xyz)[:, 1:], luxpy.xyz_to_Yuv(xyz)[:, 1:], cct, duv])
json.dump(found.tolist(), sys.stdout)
"""


def fluxes(name: str) -> np.ndarray:
    """Return watts at ``LINES`` of a spectrum, by colour-science's name."""
    return np.asarray(colour.SDS_ILLUMINANTS[name].copy().interpolate(colour.SpectralShape(400, 700, 20)).values) / 100.0


@pytest.fixture(scope="module")
def luxpys() -> dict[str, np.ndarray]:
    python = os.environ.get("NSQ_GPU_LUXPY", sys.executable)
    if subprocess.run([python, "-c", "import luxpy"], capture_output=True).returncode != 0:
        pytest.skip(f"luxpy is not there: {python} cannot import it; NSQ_GPU_LUXPY names a Python that can")
    asked = json.dumps([LINES.tolist(), [fluxes(name).tolist() for name in SPECTRA]])
    answer = subprocess.run([python, "-c", ASKED], input=asked, capture_output=True, text=True, check=True).stdout
    return dict(zip(SPECTRA, np.array(json.loads(answer.splitlines()[-1])), strict=True))


@pytest.mark.filterwarnings("ignore:.*undersampled")
@pytest.mark.parametrize("name", SPECTRA)
def test_colours_are_those_of_luxpy(name: str, luxpys: dict[str, np.ndarray]) -> None:
    expected = luxpys[name]
    result = wall(LINES, fluxes(name)).trace(1600, backend=live.backend(color=["wall"], standard_error=True))
    seen: Any = result.detectors["wall"]
    whole, temperature = seen.chromaticity(whole=True), seen.cct(whole=True)
    # A wall of 16 mm^2, in lux.
    xyz = seen.xyz.mean(axis=(1, 2)) * 16e-6
    found = np.array([*xyz, whole.x, whole.y, whole.u_prime, whole.v_prime, temperature.cct, temperature.duv])
    assert np.allclose(xyz, expected[:3], rtol=1e-12)
    assert np.allclose(found[3:7], expected[3:7], rtol=0.0, atol=1e-12)
    # Ohno's method interpolates between temperatures; luxpy's is iterated to its end.
    assert abs(temperature.cct - expected[7]) < 0.1 and abs(temperature.duv - expected[8]) < 1e-6, found - expected


def test_another_observer_is_noticed(luxpys: dict[str, np.ndarray]) -> None:
    """Light of D65, by the observer of 10 degrees, is far from what luxpy says for that of 2 degrees."""
    of_ten = colour.MSDS_CMFS["CIE 1964 10 Degree Standard Observer"][LINES.astype(float)]
    x, y, z = fluxes("D65") @ of_ten
    assert abs(x / (x + y + z) - luxpys["D65"][3]) > 1e-4
