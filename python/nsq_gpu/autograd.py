"""Results on Torch's graph: a trace is a function of the tensors that its scene holds, and ``backward`` walks rays back.

Torch is imported here alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

#: Kinds of splats of irradiance detectors whose maps carry a graph. TorchBackend has none for hard ones.
_SMOOTH = ("bilinear", "gaussian")


@dataclass
class Traced:
    """A trace that waits for what a loss gains by its maps."""

    #: Gives what the loss gains by a unit of each tensor, from what the loss gains by a watt in each pixel of a detector.
    gradient: Callable[[dict[str, np.ndarray]], list[float]]
    #: Detectors whose maps carry a graph.
    detectors: list[str]


class _Trace(torch.autograd.Function):
    """Gives maps as they were traced, and derivatives by walking rays back."""

    @staticmethod
    def forward(ctx: Any, traced: Traced, maps: list[torch.Tensor], *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        ctx.traced = traced
        ctx.tensors = [(tensor.shape, tensor.dtype, tensor.device) for tensor in tensors]
        return tuple(data.clone() for data in maps)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        traced = ctx.traced
        images = [adjoint.detach().cpu().numpy().astype(np.float64) for adjoint in adjoints]
        values = traced.gradient(dict(zip(traced.detectors, images, strict=True)))
        found = [torch.full(shape, value, dtype=dtype, device=device)
                 for value, (shape, dtype, device) in zip(values, ctx.tensors, strict=True)]
        return (None, None, *found)


def attach(scene: Any, traced: Traced, tensors: list[torch.Tensor]) -> None:
    """Put the maps of a traced scene's detectors on the graph of these tensors."""
    live = dict(zip(scene.detector_names, scene.detectors, strict=True))
    maps = [torch.as_tensor(live[name]._data).detach() for name in traced.detectors]
    for name, data in zip(traced.detectors, _Trace.apply(traced, maps, *tensors), strict=True):
        live[name]._data = data


def smooth_detectors(scene: Any) -> list[str]:
    """Return the detectors whose maps carry a graph."""
    return [name for name, live in zip(scene.detector_names, scene.detectors, strict=True)
            if getattr(live, "splat", None) in _SMOOTH and hasattr(live, "_data")]
