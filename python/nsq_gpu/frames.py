"""Optiland's frames and numbers, as NumPy has them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.coordinate_system import CoordinateSystem


def number_of(value: Any) -> float:
    """Return one of Optiland's numbers, of whatever backend and shape."""
    return float(np.squeeze(be.to_numpy(value)))


def angles_of(rotation: np.ndarray) -> tuple[float, float, float]:
    """Return Optiland's angles [rad] of axes, the columns of a rotation: the inverse of R = Rz Ry Rx."""
    ry = math.asin(max(-1.0, min(1.0, -rotation[2, 0])))
    if abs(rotation[2, 0]) < 1.0 - 1e-14:
        return math.atan2(rotation[2, 1], rotation[2, 2]), ry, math.atan2(rotation[1, 0], rotation[0, 0])
    return math.atan2(-rotation[1, 2], rotation[1, 1]), ry, 0.0


def frame(position: np.ndarray, rotation: np.ndarray) -> CoordinateSystem:
    """Return a frame with this origin [mm] and these axes, the columns of a rotation."""
    return CoordinateSystem(*(float(part) for part in position), *angles_of(rotation))


def placed(cs: CoordinateSystem) -> tuple[np.ndarray, np.ndarray]:
    """Return the origin of a frame [mm] and its axes, the columns of a rotation: the inverse of :func:`frame`."""
    position, rotation = (be.to_numpy(part).astype(float) for part in cs.get_effective_transform())
    return position.ravel(), rotation
