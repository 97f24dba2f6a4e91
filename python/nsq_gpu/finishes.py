"""Surfaces as workshops name them: black paint, black anodised aluminium, a polish, fine-ground glass, dust by its level.

>>> edge = SurfaceConfig(**finish("black paint"))
>>> scene.add_lens("L1", frame, LensConfig(..., edge=edge))
>>> mirror = SurfaceConfig(**polished(0.0015, 0.55, reflectance=0.9))
>>> scene.add_mirror("M1", frame, MirrorConfig(-200.0, 0.9, surface=mirror))

Each returns keywords of Optiland's SurfaceConfig, as :func:`nsq_gpu.bsdf.by_tis` does. A surface has one BSDF, so each finish has one
lobe. Each entry of :data:`FINISHES` says where its numbers are from, and what one lobe leaves out. Black surfaces of this list differ
by a factor of three: where a number matters, measure yours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from optiland.nonsequential.bsdf import LambertianBSDF
from optiland.nonsequential.components.configs import InteractionType

from nsq_gpu.arguments import near
from nsq_gpu.bsdf import ABg, KCorrelation, _between, _positive, by_tis
from nsq_gpu.errors import UnknownNameError, UsageError

#: Above this total integrated scatter, the law of smooth surfaces is off by 5 %: 1 - exp(-0.1) is 0.095.
_SMOOTH = 0.1
#: The slope of the distribution of IEST-STD-1246, and the area that it counts particles on [m^2].
_SLOPE, _AREA = 0.926, 0.1
#: The area that is covered, of which :data:`_DUST` is the BSDF.
_DUST_COVERAGE = 1e-3
#: A, B and g of dust by wavelength [um].
_DUST = {0.45: (9.137e-5, 6.243e-6, 1.806), 0.65: (7.997e-5, 1.407e-5, 1.828), 0.825: (1.056e-4, 2.995e-5, 1.771),
         1.6: (1.311e-4, 1.44e-4, 1.712)}

#: B_um and s of :func:`polished` for diamond-turned aluminium: l = 0.002 and s = 2.0 at 0.65 um. ESA's model of the stray light of
#: Proba-V has them, with 82 /sr for 6 nm rms (github.com/ttsiodras/straylight, src/harvey_psf.cpp, given by CSL).
DIAMOND_TURNED = {"B_um": 325.0, "s": 2.0}


@dataclass(frozen=True)
class Finish:
    """A finish of :func:`finish`: its numbers, and where they are from."""

    #: All the light that comes back at normal incidence, scattered or not.
    reflectance: float
    #: Where the numbers are from.
    source: str
    #: What the one lobe leaves out.
    left_out: str
    #: Polar angles of scatter [deg], shape (S,), and by angle of incidence [deg] the BSDF at those [1/sr]. None is Lambertian.
    theta_s: tuple[float, ...] | None = None
    rows: dict[float, tuple[float, ...]] | None = None


_HENNINGER = ("1 - the solar absorptance {} of {}, Henninger, NASA RP-1121, 1984, as DynTherM has it (Materials.Paints.BlackCoatings)")
_LOFT = ("measured at 650 nm: {}, LOFT Group, University of Arizona, github.com/ua-loft/bsdf-tools (MIT), data/processed/fred/{}.txt, "
         "2025; averaged over the azimuth here")
_LAMBERTIAN = ("Of Lambertian shape. Black paints are nearly so at normal incidence, and scatter forwards at grazing incidence (FRED's "
               "help, Flat Black Paint). The number is an average over the sun's spectrum.")
_RING = "A table has no azimuth: the lobe about the mirrored ray is a ring about the normal. At 70 deg its peak was {:.1f} /sr."
_POLAR = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0)
# Measured at 10, 30, 50 and 70 deg of incidence, to 80 deg of scatter. Beyond those, the next value stays.
_ANODISED = {
    10.0: (0.0320, 0.0303, 0.0254, 0.0205, 0.0163, 0.0132, 0.0114, 0.0108, 0.0114, 0.0114),
    30.0: (0.0204, 0.0204, 0.0204, 0.0199, 0.0180, 0.0158, 0.0141, 0.0134, 0.0146, 0.0146),
    50.0: (0.0119, 0.0123, 0.0130, 0.0148, 0.0172, 0.0200, 0.0218, 0.0238, 0.0265, 0.0265),
    70.0: (0.00849, 0.00878, 0.00945, 0.0113, 0.0148, 0.0223, 0.0390, 0.0723, 0.0993, 0.0993),
}
_NICKEL = {
    10.0: (0.0510, 0.0475, 0.0388, 0.0285, 0.0198, 0.0140, 0.0104, 0.00819, 0.00642, 0.00642),
    30.0: (0.0287, 0.0291, 0.0284, 0.0261, 0.0221, 0.0179, 0.0145, 0.0125, 0.0111, 0.0111),
    50.0: (0.0134, 0.0140, 0.0159, 0.0181, 0.0205, 0.0228, 0.0243, 0.0265, 0.0301, 0.0301),
    70.0: (0.0069, 0.00734, 0.00914, 0.0120, 0.0171, 0.0262, 0.0419, 0.0677, 0.111, 0.111),
}

#: All finishes of :func:`finish` by name.
FINISHES = {
    "black paint": Finish(0.05, "1 - the solar absorptance 0.95 of black epoxy and of black polyurethane paint: Fortescue, Swinerd and "
                          "Stark, Spacecraft Systems Engineering, 4th edition, Wiley, 2011, table 11.3", _LAMBERTIAN),
    "chemglaze black paint": Finish(0.04, _HENNINGER.format(0.96, "Chemglaze black paint, later Aeroglaze"), _LAMBERTIAN),
    "catalac black paint": Finish(0.04, _HENNINGER.format(0.96, "Catalac black paint"), _LAMBERTIAN),
    "parsons black paint": Finish(0.02, _HENNINGER.format(0.98, "Parsons black paint"), _LAMBERTIAN),
    "black delrin": Finish(0.04, _HENNINGER.format(0.96, "Delrin, black plastic"), _LAMBERTIAN),
    "black polyethylene": Finish(0.07, _HENNINGER.format(0.93, "polyethylene, black plastic"), _LAMBERTIAN),
    "black anodised aluminium": Finish(0.0525, _LOFT.format("Anoplate AnoBlack EC1 on aluminium 6061", "AnoBlackEC1onAlum"),
                                       _RING.format(1.8), _POLAR, _ANODISED),
    "black nickel": Finish(0.0646, _LOFT.format("AnoBlack NiTE, an electroless nickel, on Invar", "AnoBlackNiTEonINVAR"),
                           _RING.format(2.7), _POLAR, _NICKEL),
}

#: What else names a finish.
_ALSO = {"anodised": "black anodised aluminium", "black anodised": "black anodised aluminium", "aeroglaze": "chemglaze black paint",
         "aeroglaze z306": "chemglaze black paint", "z306": "chemglaze black paint", "chemglaze z306": "chemglaze black paint",
         "black electroless nickel": "black nickel"}


def finish(name: str) -> dict[str, Any]:
    """Return a black surface by its name: keywords of Optiland's SurfaceConfig.

    >>> scene.add_mirror("baffle", frame, MirrorConfig(math.inf, 0.05, surface=SurfaceConfig(**finish("black paint"))))

    All that such a surface sends back is scattered. The names stand in :data:`FINISHES`, in any case: ``"black paint"``,
    ``"chemglaze black paint"``, ``"catalac black paint"``, ``"parsons black paint"``, ``"black delrin"``, ``"black polyethylene"``,
    ``"black anodised aluminium"`` and ``"black nickel"``. What they send back does not depend on the wavelength.

    Args:
        name: The name; of an anodised surface, "anodized" and "aluminum" will do.

    Returns:
        ``interaction``, ``reflectance``, ``bsdf`` and ``scatter_fraction``.

    Raises:
        UnknownNameError: There is no such finish; the message has the nearest name.
    """
    entry = FINISHES[_known(name)]
    if entry.rows is None:
        return _mirror(entry.reflectance, {"bsdf": LambertianBSDF(1.0), "scatter_fraction": 1.0})
    # Optiland has 0 beyond a table.
    incident = (0.0, *entry.rows, 90.0)
    rows = [*entry.rows.values()]
    table = {"theta_i": incident, "theta_s": entry.theta_s, "bsdf": [rows[0], *rows, rows[-1]]}
    from nsq_gpu.scene_file import _tabulated

    # The table has the level.
    return _mirror(1.0, {"bsdf": _tabulated(table, Path()), "scatter_fraction": 1.0})


def polished(roughness_um: float, wavelength_um: float, reflectance: Any = None, *, delta_n: float | None = None, B_um: float = 63.28,  # noqa: N803
             s: float = 1.5) -> dict[str, Any]:
    """Return a polished surface: a mirror of a ``reflectance``, or a face of a lens by its ``delta_n``.

    >>> SurfaceConfig(**polished(0.0015, 0.55, reflectance=0.95))    # a mirror of 15 Angstrom rms
    >>> SurfaceConfig(**polished(0.0015, 0.55, delta_n=0.52))        # a face of N-BK7 in air

    The share of the light that scatters is (2 pi delta_n roughness / wavelength)^2, the total integrated scatter of a smooth surface.
    It goes into a K-correlation lobe, :meth:`nsq_gpu.bsdf.KCorrelation.from_roughness`. Its shape is FRED's default for polished
    optics: a shoulder L of 0.01 and a slope S of -1.5 (help.photonengr.com, Harvey-Shack). There, slopes are -0.5 to -2, and below -2.5
    for super-polished surfaces. FRED names no wavelength; the shoulder is taken at 0.6328 um.

    Args:
        roughness_um: Root mean square roughness [um] at frequencies up to 1 / wavelength_um.
        wavelength_um: Wavelength of the light in its medium [um].
        reflectance: Reflectance of a mirror: a number, a function of the wavelength or a coating, as SurfaceConfig has it.
        delta_n: Difference of the refractive indices at a lens's face, whose Fresnel reflection stays as it is. What is scattered
            goes with the light.
        B_um: 2 pi times the typical wavelength of the surface [um]; :data:`DIAMOND_TURNED` has the value of turned aluminium.
        s: Slope of the BSDF at large angles.

    Returns:
        ``bsdf`` and ``scatter_fraction``; of a mirror ``interaction`` and ``reflectance``, too.

    Raises:
        ValueError: An argument is out of range, or the surface is too rough for the law of smooth ones.
        UsageError: Neither or both of ``reflectance`` and ``delta_n`` are given.
    """
    step = _index_step(reflectance, delta_n)
    scattered = (2.0 * math.pi * step * _positive("roughness_um", roughness_um) / _positive("wavelength_um", wavelength_um)) ** 2
    if scattered > _SMOOTH:
        raise ValueError(f"roughness_um is {roughness_um}: {scattered:.3g} of the light would scatter, and the law of smooth surfaces "
                         f"holds up to {_SMOOTH}; give less, or take ground()")
    lobe = KCorrelation.from_roughness(roughness_um, B_um, s, wavelength_um, delta_n=step,
                                       transmissive_fraction=0.0 if delta_n is None else 1.0)
    return _mirror(reflectance, by_tis(lobe))


def ground(roughness_um: float, wavelength_um: float, reflectance: Any = None, *, delta_n: float | None = None) -> dict[str, Any]:
    """Return a ground surface: a mirror of a ``reflectance``, or a face of a lens by its ``delta_n``.

    >>> SurfaceConfig(**ground(0.5, 0.55, delta_n=0.52))    # a fine-ground face of N-BK7

    The share exp(-(2 pi delta_n roughness / wavelength)^2) is mirrored or refracted (Bennett and Porteus, J. Opt. Soc. Am. 51, 123,
    1961, for delta_n = 2). The rest is scattered as Lambertian. That shape is an assumption, not measured: the lobes of real ground
    glass are narrower, and depend on the grit.

    Args:
        roughness_um: Root mean square roughness [um].
        wavelength_um: Wavelength of the light in its medium [um].
        reflectance: Reflectance of a mirror: a number, a function of the wavelength or a coating, as SurfaceConfig has it.
        delta_n: Difference of the refractive indices at a lens's face. What is scattered goes with the light.

    Returns:
        ``bsdf`` and ``scatter_fraction``; of a mirror ``interaction`` and ``reflectance``, too.

    Raises:
        ValueError: An argument is out of range.
        UsageError: Neither or both of ``reflectance`` and ``delta_n`` are given.
    """
    step = _index_step(reflectance, delta_n)
    phase = 2.0 * math.pi * step * _positive("roughness_um", roughness_um) / _positive("wavelength_um", wavelength_um)
    return _mirror(reflectance, {"bsdf": LambertianBSDF(1.0, 0.0 if delta_n is None else 1.0), "scatter_fraction": -math.expm1(-(phase**2))})


def dusty(level: float, wavelength_um: float, reflectance: Any) -> dict[str, Any]:
    """Return a mirror with dust on it, by its cleanliness level of IEST-STD-1246.

    >>> SurfaceConfig(**dusty(300, 0.65, reflectance=0.9))

    The amount is :func:`coverage`. The shape is as in ESA's model of the stray light of Proba-V: two lobes for 1000 ppm, fitted to
    Mie scattering at 0.45, 0.65, 0.825 and 1.6 um (github.com/ttsiodras/straylight, src/particulate_contamination_harvey_psf.cpp).
    One ABg lobe stands for the two here: it has their total integrated scatter, and their BSDF within a factor of two up to 90 deg.
    Between those wavelengths, height, width and slope are interpolated; beyond them the lobe is scaled as diffraction is.

    Left out: the level changes the amount alone, not the share of large particles; and dust absorbs nothing.

    Args:
        level: The level, such as 300, from 5 to 1000.
        wavelength_um: Wavelength of the light [um], from 0.36 to 2.
        reflectance: Reflectance of the clean mirror: a number, a function of the wavelength or a coating.

    Returns:
        ``interaction``, ``reflectance``, ``bsdf`` and ``scatter_fraction``.

    Raises:
        ValueError: An argument is out of range.
        UsageError: There is no reflectance.
    """
    if reflectance is None:
        raise UsageError("reflectance is None; give the clean mirror's, such as 0.9: the model of dust is one of mirrors")
    amount = coverage(level) / _DUST_COVERAGE
    wavelength = _between("wavelength_um", wavelength_um, 0.36, 2.0)
    known = np.log([*_DUST])
    at = np.clip(math.log(wavelength), known[0], known[-1])
    heights, shoulders, slopes = zip(*((math.log(a / b), math.log(b) / g, g) for a, b, g in _DUST.values()), strict=True)
    height, shoulder, g = (float(np.interp(at, known, of)) for of in (heights, shoulders, slopes))
    # Of diffraction, the width grows as the wavelength, and the height falls as the square of that.
    wider = math.log(wavelength) - at
    b0, b = amount * math.exp(height - 2.0 * wider), math.exp(g * (shoulder + wider))
    return _mirror(reflectance, by_tis(ABg(b0 * b, b, g)))


def coverage(level: float) -> float:
    """Return the share of a surface that dust of a cleanliness level of IEST-STD-1246 covers: 2.5e-4 at level 300.

    The standard has N particles of x um and more on 0.1 m^2: log10 N = 0.926 (log10(level)^2 - log10(x)^2). The share is the integral
    of their areas from 1 um to the level, of disks of the diameter x. Fibres cover less than such a disk.

    Args:
        level: The level, from 5 to 1000.

    Raises:
        ValueError: The level is out of range.
    """
    top = math.log10(_between("level", level, 5.0, 1000.0))
    # Of x^2 dN over u = log10 x, by parts: a bracket and a Gaussian integral about 1 / 0.926.
    width = math.sqrt(_SLOPE * math.log(10.0))
    within = math.erf(width * (top - 1.0 / _SLOPE)) + math.erf(width / _SLOPE)
    gaussian = 10.0 ** (1.0 / _SLOPE) * 0.5 * math.sqrt(math.pi) / width * within
    squares = 1.0 - 10.0 ** (2.0 * top - _SLOPE * top**2) + 2.0 * math.log(10.0) * gaussian
    return 10.0 ** (_SLOPE * top**2) * 0.25 * math.pi * squares * 1e-12 / _AREA


def _known(name: Any) -> str:
    """Return the name as :data:`FINISHES` has it."""
    if not isinstance(name, str):
        raise UsageError(f"name is {name!r}; give the name of a finish, such as 'black paint'")
    plain = " ".join(name.lower().replace("anodiz", "anodis").replace("aluminum", "aluminium").replace("_", " ").replace("-", " ").split())
    plain = _ALSO.get(plain, plain)
    if plain not in FINISHES:
        raise UnknownNameError(f"there is no finish {name!r}; {near(plain, FINISHES)} Polish, ground glass and dust have functions of their own")
    return plain


def _index_step(reflectance: Any, delta_n: float | None) -> float:
    """Return the step of the refractive index that a surface's height is seen by."""
    if (reflectance is None) == (delta_n is None):
        raise UsageError("give a mirror's reflectance, such as reflectance=0.9, or a lens's delta_n, such as delta_n=0.52: one of the two")
    return 2.0 if delta_n is None else _positive("delta_n", abs(delta_n))


def _mirror(reflectance: Any, scatters: dict[str, Any]) -> dict[str, Any]:
    """Return what scatters as a mirror's keywords; without a reflectance, as it is."""
    if reflectance is None:
        return scatters
    if isinstance(reflectance, int | float):
        reflectance = _between("reflectance", reflectance, 0.0, 1.0)
    return {"interaction": InteractionType.REFLECTIVE, "reflectance": reflectance, **scatters}
