"""What a conversion carried, and what it had to estimate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from optiland.nonsequential.convert import ConversionReport


@dataclass(frozen=True)
class Carried:
    """A part of the prescription that the scene has, beside radii, distances and glasses.

    >>> [(part.component, part.what, part.origins) for part in report.carried]
    [('L1.front', 'even asphere, 3 coefficients', ('lens.zmx:14: TYPE', 'lens.zmx:17: PARM'))]
    """

    #: The surface of the prescription.
    index: int
    #: ``"shape"``, ``"decentre"``, ``"tilt"``, ``"coating"`` or ``"aperture"``.
    kind: str
    #: The scene's component, or detector.
    component: str
    #: What was carried.
    what: str
    #: Where it comes from: cards of a lens file, or the surface of the Optic.
    origins: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.component}: {self.what}, from {shortened(self.origins)}"


def shortened(origins: Sequence[str]) -> str:
    """Return places in a file as one text: the lines, and the names of the cards."""
    cards = [found.groups() for place in origins if (found := re.fullmatch(r"(.*):(\d+): (\S+)", place))]
    if len(cards) < len(origins):
        return ", ".join(origins)
    lines, names = (dict.fromkeys(card[part] for card in cards) for part in (1, 2))
    return f"{cards[0][0]}:{','.join(lines)} ({', '.join(names)})"


@dataclass
class LensReport(ConversionReport):
    """Optiland's report, and what the conversion of this package adds to it.

    >>> scene = nsq_gpu.from_optic(optic)
    >>> print(scene.conversion_report.summary())
    >>> scene.trace(100_000, max_depth=scene.conversion_report.max_depth)
    """

    #: The components of each surface of the prescription, by its index: its face, or its stop; () of one that does nothing.
    components: dict[int, tuple[str, ...]] = field(default_factory=dict)
    #: Aspheres, decentres, tilts, coatings and apertures, each with the place that it comes from.
    carried: list[Carried] = field(default_factory=list)
    #: Width and height of the detector [mm], and why it is so large.
    detector_size: tuple[float, float] = (0.0, 0.0)
    detector_reason: str = ""
    #: Diameter of the circle about the detector's middle that takes the light of all fields, with a margin of 10 % [mm].
    image_circle: float = 0.0
    #: Events that light needs from the source to the detector; what a ghost needs comes on top.
    max_depth: int = 0
    #: Surfaces whose aperture the prescription states, and which absorb what it clips.
    stated_apertures: list[str] = field(default_factory=list)
    #: Surfaces whose coatings are tables by wavelength and angle: thin films, averaged over polarisation, and tables as given.
    averaged_coatings: list[str] = field(default_factory=list)
    #: Elements without an edge, and why.
    without_edge: dict[str, str] = field(default_factory=dict)
    #: Of a lens file: what each name of a glass was taken for.
    glasses: dict[str, str] = field(default_factory=dict)
    #: Of a lens file: cards that say nothing of the light, and how often they occur.
    passed_over: dict[str, int] = field(default_factory=dict)
    #: What the user should know beside all this.
    remarks: list[str] = field(default_factory=list)

    def summary(self) -> str:
        """Return the report as text."""
        lines = [f"{len(self.components)} surfaces; light needs {self.max_depth} events"]
        lines += [f"surface {index}: {', '.join(names) or 'does nothing to light'}" for index, names in self.components.items()]
        width, height = self.detector_size
        lines.append(f"Detector image: {width:.4g} x {height:.4g} mm, {self.detector_reason}; the image circle is "
                     f"{self.image_circle:.4g} mm wide")
        lines += [f"Carried: {part}" for part in self.carried]
        lines += [super().summary()]
        if self.stated_apertures:
            lines.append(f"Apertures as stated: {', '.join(self.stated_apertures)}")
        if self.averaged_coatings:
            lines.append(f"Coatings by angle (thin films averaged over polarisation, R and T to 1e-5 but for a critical angle's neighbourhood): {', '.join(self.averaged_coatings)}")
        lines += [f"No edge on {name}: {reason}" for name, reason in self.without_edge.items()]
        lines += [f"Glass {name}: {found}" for name, found in self.glasses.items()]
        if self.passed_over:
            counts = (f"{name} ({count})" if count > 1 else name for name, count in sorted(self.passed_over.items()))
            lines.append(f"Cards skipped, without meaning for light: {', '.join(counts)}")
        return "\n".join(lines + self.remarks)
