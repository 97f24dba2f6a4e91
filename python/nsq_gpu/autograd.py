"""Results on Torch's graph: a trace is a function of the tensors that its scene holds, and ``backward`` traces again.

Torch is imported here alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

from nsq_gpu.gradients import Jacobian

#: Kinds of splats of irradiance detectors whose maps carry a graph. TorchBackend has none for hard ones.
_SMOOTH = ("bilinear", "gaussian")


@dataclass
class Traced:
    """A trace that waits for its derivatives."""

    #: Names of the parameters, in the order of their tensors.
    names: list[str]
    #: Traces with derivatives by numbers of these names.
    trace: Callable[[list[str]], Jacobian]
    #: Irradiance detectors with a graph: name, and area of a pixel [mm^2].
    areas: dict[str, float]
    #: Sides of detectors by the names of their numbers, in which the area is in proportion: detector, and length [mm].
    sides: dict[str, tuple[str, float]]
    _found: Jacobian | None = field(default=None, repr=False)

    def derivative(self, name: str, detector: str) -> np.ndarray:
        """Return the derivative of the flux in each pixel [W per unit], row by row."""
        if self._found is None:
            # Kept: the graph may be walked again.
            self._found = self.trace(self.names)
        map_ = self._found[name, detector].map
        assert map_ is not None
        slope = map_ * self.areas[detector]
        side = self.sides.get(name)
        if side is not None and side[0] == detector:
            slope = slope + self._found.maps[detector] * self.areas[detector] / side[1]
        return slope.ravel()


class _Trace(torch.autograd.Function):
    """Gives maps as they were traced, and derivatives by tracing again."""

    @staticmethod
    def forward(ctx: Any, traced: Traced, maps: list[torch.Tensor], *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        ctx.traced = traced
        ctx.tensors = [(tensor.shape, tensor.dtype, tensor.device) for tensor in tensors]
        return tuple(data.clone() for data in maps)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        detectors = list(ctx.traced.areas)
        images = [adjoint.detach().cpu().numpy().astype(np.float64).ravel() for adjoint in adjoints]
        found = []
        for name, (shape, dtype, device) in zip(ctx.traced.names, ctx.tensors, strict=True):
            total = sum(float(image @ ctx.traced.derivative(name, detector))
                        for image, detector in zip(images, detectors, strict=True))
            found.append(torch.full(shape, total, dtype=dtype, device=device))
        return (None, None, *found)


def attach(scene: Any, traced: Traced, tensors: list[torch.Tensor]) -> None:
    """Put the maps of a traced scene's detectors on the graph of these tensors."""
    live = dict(zip(scene.detector_names, scene.detectors, strict=True))
    maps = [torch.as_tensor(live[name]._data).detach() for name in traced.areas]
    for name, data in zip(traced.areas, _Trace.apply(traced, maps, *tensors), strict=True):
        live[name]._data = data


def areas_of(scene: Any) -> tuple[dict[str, float], dict[str, tuple[str, float]]]:
    """Return the areas of pixels of detectors whose maps carry a graph, and the sides of all of them."""
    areas, sides = {}, {}
    for name, live in zip(scene.detector_names, scene.detectors, strict=True):
        if getattr(live, "splat", None) in _SMOOTH and hasattr(live, "_data"):
            width, height = float(live.width), float(live.height)
            areas[name] = width / int(live.num_pixels_x) * (height / int(live.num_pixels_y))
            label = f'"{name}"' if "." in name or "," in name else name
            sides |= {f"{label}.width": (name, width), f"{label}.height": (name, height)}
    return areas, sides
