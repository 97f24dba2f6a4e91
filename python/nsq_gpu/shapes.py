"""Shapes that Optiland's non-sequential engine lacks. They trace on its NumpyBackend and TorchBackend as well."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry


@dataclass(frozen=True)
class Aperture:
    """A part of the plane across the axis of a surface, which need be neither round nor on the axis."""

    #: What bounds it.
    outline: Literal["ellipse", "rectangle"]
    #: Semi-axes along x and y [mm].
    semi_axis_x: float
    semi_axis_y: float
    #: Its middle [mm].
    x: float = 0.0
    y: float = 0.0
    #: Radius of a round hole about its middle [mm].
    hole_radius: float = 0.0
    #: True for all that it leaves out.
    inverted: bool = False

    def holds(self, x: Any, y: Any) -> Any:
        """Return an array that is True at points of the aperture; x and y are in mm."""
        u, v = x - self.x, y - self.y
        along, across = u * (1.0 / self.semi_axis_x), v * (1.0 / self.semi_axis_y)
        if self.outline == "rectangle":
            inside = (abs(along) <= 1.0) & (abs(across) <= 1.0)
        else:
            inside = along * along + across * across <= 1.0
        return (inside & (u * u + v * v >= self.hole_radius * self.hole_radius)) != self.inverted

    def reach(self) -> float:
        """Return the largest distance of its points from the axis [mm], were it not inverted."""
        if self.outline == "rectangle":
            return math.hypot(abs(self.x) + self.semi_axis_x, abs(self.y) + self.semi_axis_y)
        return math.hypot(self.x, self.y) + max(self.semi_axis_x, self.semi_axis_y)


class ClippedConic(ConicGeometry):
    """A conic within a semi-diameter and an aperture.

    Args:
        radius: Radius of curvature at the vertex [mm]; infinite for a plane.
        conic: Conic constant.
        aperture_radius: Semi-diameter [mm], beyond which there is nothing whatever the aperture says.
        aperture: The part across the axis that there is.
    """

    def __init__(self, radius: float, conic: float, aperture_radius: float, aperture: Aperture) -> None:
        super().__init__(radius, conic, aperture_radius)
        self.aperture = aperture

    def _root_valid(self, *arguments: Any) -> tuple[Any, Any, Any]:
        valid, x, y = super()._root_valid(*arguments)
        return valid & self.aperture.holds(x, y), x, y
