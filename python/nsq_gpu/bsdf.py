"""Scattering laws as the field names them. They trace on Optiland's NumpyBackend and TorchBackend as well.

>>> polish = ABg(A=1e-3, B=1e-4, g=2.0)
>>> scene.add_mirror("M1", frame, MirrorConfig(..., surface=SurfaceConfig(**by_tis(polish))))
"""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
from optiland.nonsequential.bsdf import BaseBSDF, HarveyShackBSDF, LambertianBSDF, TabulatedBSDF
from optiland.nonsequential.rng import EventSlot
from scipy.integrate import quad
from scipy.interpolate import RegularGridInterpolator

from nsq_gpu.errors import UnsupportedSceneError, without_gradient
from nsq_gpu.measured import MeasuredBSDF as MeasuredBSDF

#: Two directions differ by at most so much in direction cosines. Lobes are drawn up to there.
_LONGEST_OFFSET = 2.0
#: Knots of Optiland's table of a Harvey-Shack lobe.
_KNOTS = 4096
#: Sums round.
_EXCESS = 1e-9


def ABg(A: float, B: float, g: float, transmissive_fraction: float = 0.0) -> HarveyShackBSDF:  # noqa: N802, N803
    """Return the ABg lobe, A / (B + beta^g), as the Harvey-Shack lobe that it is.

    Here beta is the distance of direction cosines from the specular direction. The Harvey-Shack lobe b0 / (1 + (beta / l0)^s) has
    b0 = A / B, l0 = B^(1/g) and s = g.

    Args:
        A: Height of the lobe's flank: the BSDF is A / beta^g beyond the shoulder [1/sr].
        B: The shoulder is at beta = B^(1/g).
        g: Slope of the flank.
        transmissive_fraction: Fraction of the scattered rays that go straight on.

    Raises:
        ValueError: An argument is out of range.
    """
    a, b, slope = _number("A", A), _number("B", B), _number("g", g)
    if not a > 0.0:
        raise ValueError(f"A is {a}: the lobe scatters nothing; give a number above 0 [1/sr]")
    if b == 0.0:
        raise ValueError("B is 0: then the BSDF has no level at the specular direction, where it is A / B; "
                         "give a number above 0, such as 1e-5 for a shoulder at 1e-5^(1/g)")
    if b < 0.0:
        raise ValueError(f"B is {b}: the BSDF would be negative about the specular direction; give a number above 0")
    if slope == 0.0:
        raise ValueError("g is 0: then the BSDF is the same in all directions; give a number above 0, or a LambertianBSDF")
    _between("g", slope, 0.0, 1e3)
    try:
        b0, l0 = a / b, b ** (1.0 / slope)
    except OverflowError:
        b0, l0 = a / b, math.inf
    if not 1e-12 <= l0 <= 1e12:
        raise ValueError(f"B is {b} and g is {slope}: the shoulder B^(1/g) is {l0}; give a B whose shoulder lies from 1e-12 to 1e12")
    if not b0 <= 1e30:
        raise ValueError(f"A is {a} and B is {b}: A / B, the level at the specular direction, is {b0}; give at most 1e30 [1/sr]")
    return HarveyShackBSDF(b0, l0, slope, _between("transmissive_fraction", transmissive_fraction, 0.0, 1.0))


class KCorrelation(HarveyShackBSDF):
    """The K-correlation lobe: b0 / (1 + (B beta)^2)^(s/2).

    Here beta is the distance of direction cosines from the specular direction. B and s are parameters of a surface's power spectral
    density, sigma^2 B^2 (s - 2) / (2 pi (1 + (B f)^2)^(s/2)); with B over the wavelength, because f is beta over the wavelength
    (Dittman, K-correlation power spectral density and surface scatter model, Proc. SPIE 6291, 2006). FRED and Zemax have s, too;
    the C of the literature's two-dimensional density is s - 1.

    To Optiland it is a Harvey-Shack lobe whose sampling is its own.

    Args:
        b0: Level at the specular direction [1/sr].
        B: Inverse of the shoulder: 2 pi times the typical wavelength of the surface, over the wavelength of the light.
        s: Slope of the BSDF beyond the shoulder.
        transmissive_fraction: Fraction of the scattered rays that go straight on.

    Raises:
        ValueError: An argument is out of range.
    """

    def __init__(self, b0: float, B: float, s: float, transmissive_fraction: float = 0.0) -> None:  # noqa: N803
        level = _number("b0", b0)
        if not level > 0.0:
            raise ValueError(f"b0 is {level}: the lobe scatters nothing; give a number above 0 [1/sr]")
        self.B = _between("B", B, 1e-12, 1e12)
        super().__init__(_between("b0", level, 0.0, 1e30), 1.0 / self.B, _between("s", s, 0.0, 1e3),
                         _between("transmissive_fraction", transmissive_fraction, 0.0, 1.0))

    @classmethod
    def from_roughness(cls, sigma_um: float, B_um: float, s: float, wavelength_um: float, *,  # noqa: N803
                       reference_wavelength_um: float | None = None, delta_n: float = 2.0,
                       transmissive_fraction: float = 0.0) -> KCorrelation:
        """Return the lobe of a rough surface at one wavelength, from what FRED and Zemax ask for.

        The lobe's total integrated scatter is (2 pi delta_n sigma / wavelength)^2. This holds while that is far below 1. The
        cosines of the density's BSDF are left out, because the lobe depends on beta alone.

        Args:
            sigma_um: Root mean square roughness [um], over spatial frequencies from 0 to 1 / reference_wavelength_um.
            B_um: 2 pi times the typical wavelength of the surface [um].
            s: Slope of the two-dimensional power spectral density.
            wavelength_um: Wavelength of the light in its medium [um].
            reference_wavelength_um: Wavelength at which sigma_um was found [um]; the light's wavelength if None.
            delta_n: Difference of the refractive indices; 2 for a mirror.
            transmissive_fraction: Fraction of the scattered rays that go straight on.

        Raises:
            ValueError: An argument is out of range.
        """
        sigma, wavelength = _positive("sigma_um", sigma_um), _positive("wavelength_um", wavelength_um)
        reference = wavelength if reference_wavelength_um is None else _positive("reference_wavelength_um", reference_wavelength_um)
        step, b = _positive("delta_n", abs(_number("delta_n", delta_n))), _positive("B_um", B_um)
        # The roughness counts up to the frequency 1 / wavelength: of what the reference sees, more at a shorter one.
        seen = cls(1.0, b / reference, s).scattered_within(1.0) * (b / reference) ** 2
        b0 = (2.0 * math.pi * step * sigma / wavelength * (b / wavelength)) ** 2 / seen
        return cls(b0, b / wavelength, s, transmissive_fraction)

    def _power_and_logarithm(self, beta: float) -> tuple[float, float]:
        return 1.0 - 0.5 * self.s, math.log1p((self.B * beta) ** 2)

    def scattered_within(self, beta: float) -> float:
        """Return the integral of the lobe over distances of direction cosines up to ``beta``."""
        p, t = self._power_and_logarithm(beta)
        grown = t if p == 0.0 else math.expm1(p * t) / p
        return math.pi * self.b0 * grown / self.B**2

    def offset(self, share: Any) -> np.ndarray:
        """Return the distances within which shares of all that is scattered lie."""
        u = np.asarray(share, dtype=np.float64)
        p, t = self._power_and_logarithm(_LONGEST_OFFSET)
        if p == 0.0:
            return np.sqrt(np.expm1(u * t)) / self.B
        change = u * math.expm1(p * t)
        # Far below 1, a power is the sum of what the share lacks of 1, and of the rest.
        powers = np.where(np.abs(change) < 0.29, np.log1p(np.maximum(change, -0.5)), np.log((1.0 - u) + u * math.exp(p * t)))
        return np.sqrt(np.expm1(powers / p)) / self.B

    def _abg(self, beta: Any) -> Any:
        return self.b0 / (1.0 + (self.B * beta) ** 2) ** (0.5 * self.s)

    @property
    def total_integrated_scatter(self) -> float:
        """The integral of the lobe over all distances of direction cosines, clipped to 1 as Optiland's is."""
        return min(self.scattered_within(_LONGEST_OFFSET), 1.0)

    def sample(self, num_rays: int, incident_dirs: Any, normals: Any, wavelengths: Any, rng: Any, ray_id: Any,
               bounce: Any) -> tuple[Any, Any, Any]:
        """Draw scattered directions, weights and sides: Optiland's own contract."""
        # Optiland's sampler interpolates in a table. Where its knots are the draws themselves, it gives the values there.
        table = HarveyShackBSDF(self.b0, self.l0, self.s, self.transmissive_fraction)
        draws = np.unique(rng.uniform(ray_id, bounce, EventSlot.BSDF_U1)) if num_rays else np.zeros(1)
        table._cdf_grid, table._beta_grid = draws, self.offset(draws)
        return table.sample(num_rays, incident_dirs, normals, wavelengths, rng, ray_id, bounce)


def tis(bsdf: BaseBSDF) -> float:
    """Return the total integrated scatter: the share of light at normal incidence that scatters into the hemisphere.

    It is the integral of BSDF cos(theta) over solid angles, which is the integral of the BSDF over the unit disk of direction cosines. For
    the ``scatter_fraction`` of a surface see :func:`by_tis`.

    Raises:
        UnsupportedSceneError: The BSDF has no level.
    """
    if type(bsdf) is KCorrelation:
        return bsdf.scattered_within(1.0)
    if type(bsdf) is HarveyShackBSDF:
        return _harvey_shack_within_disk(bsdf)
    return _of_weights(bsdf)[0]


def by_tis(bsdf: BaseBSDF) -> dict[str, Any]:
    """Return the ``bsdf`` and the ``scatter_fraction`` of a surface that has the level of this BSDF.

    What scatters into a direction is then the BSDF that was given, at every incidence. It is what
    ``"scatter_fraction": "tis"`` means in a scene file. A Harvey-Shack and a K-correlation lobe stay as they are. Their fraction
    is their integral over distances of direction cosines up to 2, because up to there they are drawn; what has no direction is lost.
    A Lambertian BSDF and a table carry their level in their weights. They become BSDFs of total integrated scatter 1, and their
    own one is the fraction. Of a measured one, both belong to the first angle of incidence.

    Raises:
        ValueError: The fraction exceeds 1, or is 0.
        UnsupportedSceneError: The BSDF has no level.
    """
    if type(bsdf) is KCorrelation:
        fraction, scatters = bsdf.scattered_within(_LONGEST_OFFSET), bsdf
    elif type(bsdf) is HarveyShackBSDF:
        fraction, scatters = _tabulated_total(bsdf), bsdf
    else:
        fraction, scatters = _of_weights(bsdf)
    if fraction > 1.0 + _EXCESS:
        raise ValueError(f"the total integrated scatter of the {type(bsdf).__name__} is {fraction:.6f}, more light than there is; "
                         f"give a BSDF of {1.0 / fraction:.6f} times the height or less, or a number from 0 to 1 as scatter_fraction")
    if not fraction > 0.0:
        raise ValueError(f"the {type(bsdf).__name__} scatters nothing at normal incidence, where its total integrated scatter is taken; "
                         "give one that does, or a number from 0 to 1 as scatter_fraction")
    return {"bsdf": scatters, "scatter_fraction": min(fraction, 1.0)}


def _harvey_shack_within_disk(bsdf: HarveyShackBSDF) -> float:
    """Return the integral over the unit disk, over ln(1 + beta / l0), in which the lobe is smooth."""

    def density(z: float) -> float:
        ratio = math.expm1(z)
        # Beyond this power, the lobe is 0.
        power = ratio**bsdf.s if bsdf.s * math.log(max(ratio, 1e-300)) < 600.0 else math.inf
        return ratio * math.exp(z) / (1.0 + power)

    end = math.log1p(1.0 / bsdf.l0)
    kinks = [math.log(2.0)] if end > math.log(2.0) else None
    return 2.0 * math.pi * bsdf.b0 * bsdf.l0**2 * float(quad(density, 0.0, end, points=kinks, limit=400, epsabs=0.0)[0])


def _tabulated_total(bsdf: HarveyShackBSDF) -> float:
    """Return the total of Optiland's table of the lobe. Optiland clips its own number to 1."""
    beta = np.linspace(0.0, _LONGEST_OFFSET, _KNOTS)
    density = bsdf._abg(beta) * 2.0 * np.pi * beta
    return float(np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(beta))[-1])


def _of_weights(bsdf: BaseBSDF) -> tuple[float, BaseBSDF]:
    """Return the total integrated scatter of a BSDF whose level is in its weights, and the BSDF without that level."""
    if type(bsdf) is LambertianBSDF:
        return _number("reflectance_value", bsdf.reflectance_value), LambertianBSDF(1.0, bsdf.transmissive_fraction)
    if type(bsdf) is MeasuredBSDF:
        first = float(bsdf.tis[0])
        return first, bsdf.with_tis_1() if first > 0.0 else bsdf
    if type(bsdf) is not TabulatedBSDF:
        raise UnsupportedSceneError(f"a {type(bsdf).__name__} has no total integrated scatter that is known; give a HarveyShackBSDF, an ABg, a "
                                    "KCorrelation, a LambertianBSDF, a TabulatedBSDF or a MeasuredBSDF, or a number from 0 to 1 as scatter_fraction")
    (incident, scattered), values = bsdf._interp.grid, np.asarray(bsdf._interp.values)
    total = _albedo(np.radians(scattered), values[0]) if incident[0] == 0.0 else 0.0
    level = copy.copy(bsdf)
    if total > 0.0:
        level._interp = RegularGridInterpolator(bsdf._interp.grid, values / total, method="linear", bounds_error=False, fill_value=0.0)
    return total, level


def _albedo(theta: np.ndarray, values: np.ndarray) -> float:
    """Return the integral of pi f sin(2 theta) over angles between which f is linear."""
    a, b = theta[:-1], theta[1:]
    slope = (values[1:] - values[:-1]) / (b - a)
    ends = values[:-1] * np.cos(2.0 * a) - values[1:] * np.cos(2.0 * b)
    return float(np.sum(0.5 * np.pi * (ends + slope * (np.sin(2.0 * b) - np.sin(2.0 * a)) / 2.0)))


def _number(name: str, value: Any) -> float:
    try:
        number = float(without_gradient(name, value))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is {value!r}; give a number") from error
    if not math.isfinite(number):
        raise ValueError(f"{name} is {number}; give a finite number")
    return number


def _between(name: str, value: Any, low: float, high: float) -> float:
    number = _number(name, value)
    if not low <= number <= high:
        raise ValueError(f"{name} is {number}; give a number from {low:g} to {high:g}")
    return number


def _positive(name: str, value: Any) -> float:
    number = _number(name, value)
    if not number > 0.0:
        raise ValueError(f"{name} is {number}; give a number above 0")
    return number
