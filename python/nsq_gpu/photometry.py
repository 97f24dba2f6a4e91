"""Lumens and watts: how bright the eye finds the light of a spectrum."""

from __future__ import annotations

from typing import Any

import numpy as np
import optiland.backend as be
from optiland.colorimetry.constants import CIE_1931_2DEG, WAVELENGTHS_STD
from optiland.nonsequential.sources.base import Spectrum

from nsq_gpu.errors import UsageError

#: Luminous efficacy where the eye sees best [lm/W].
PEAK = 683.002
#: A spectrum whose efficacy is a smaller part of the peak has no visible light.
_LEAST = 1e-6

#: Photometric maps of a kind of detectors: their array, and its unit.
MAPS = {"irradiance": ("illuminance", "lx"), "far_field": ("luminous_intensity", "cd")}
#: Arrays of a photometric detector; each has a standard error, where errors are known.
ARRAYS = ("illuminance", "luminous_intensity", "luminous_flux")

#: Wavelengths of the table, 0.380 to 0.780 in steps of 0.001 [um], and the eye's response there: y-bar of CIE 1931.
_WAVELENGTHS = np.asarray(WAVELENGTHS_STD, dtype=np.float64) / 1000.0
_RESPONSE = np.asarray([y for _, y, _ in CIE_1931_2DEG], dtype=np.float64)


def v_lambda(wavelength_um: Any) -> np.ndarray:
    """Return the eye's response V at wavelengths [um]: CIE 1931, linear between nanometres, and 0 outside 0.380 to 0.780 um."""
    asked = np.asarray(be.to_numpy(wavelength_um), dtype=np.float64)
    return np.asarray(np.interp(asked, _WAVELENGTHS, _RESPONSE, left=0.0, right=0.0))


def is_visible(efficacy: Any) -> Any:
    """Return whether light of an efficacy [lm/W] has lumens worth the name."""
    return efficacy >= _LEAST * PEAK


def luminous_efficacy(spectrum: Spectrum) -> float:
    """Return the lumens of a watt of this spectrum [lm/W]: the mean of 683.002 V over its weights.

    Raises:
        UsageError: The spectrum has no visible light.
    """
    weights = np.asarray(be.to_numpy(spectrum.weights), dtype=np.float64)
    efficacy = PEAK * float((weights * v_lambda(spectrum.wavelengths)).sum() / weights.sum())
    if not is_visible(efficacy):
        shown = ", ".join(f"{wavelength:g}" for wavelength in spectrum.wavelengths[:4])
        more = ", ..." if len(spectrum.wavelengths) > 4 else ""
        raise UsageError(f"spectrum: its light, at {shown}{more} um, is not visible, and has no lumens; give total_flux in W, or "
                         "wavelengths from 0.38 to 0.78 um")
    return efficacy


def watts(lumens: float, spectrum: Spectrum) -> float:
    """Return the watts of so many lumens of this spectrum; :func:`luminous_efficacy` says what is raised."""
    return lumens / luminous_efficacy(spectrum)
