"""Design: ghosts, fluxes and uniformity as operands of Optiland's optimisers, and problems of scenes of their own.

>>> import nsq_gpu
>>> nsq_gpu.register_operands()
>>> problem.add_operand("nsq_ghost_peak", target=0, input_data={"optic": lens, "fields": [1]})

>>> from nsq_gpu.design import Flux, Uniformity
>>> problem = nsq_gpu.Problem(scene, {"pipe.r_back": (2, 6)}, [Uniformity(detector="screen", target=1)])
>>> problem.minimize()
"""

from nsq_gpu.design.log import Log, Step
from nsq_gpu.design.maps import BlockMaps, Estimate
from nsq_gpu.design.minimizing import Design
from nsq_gpu.design.objectives import (
    EncircledEnergy,
    Flux,
    GhostFlux,
    GhostPeak,
    MatchMap,
    Objective,
    Peak,
    RmsRadius,
    TorchFunction,
    Uniformity,
)
from nsq_gpu.design.operands import operand_estimate, renew
from nsq_gpu.design.problem import Gradient, Value

__all__ = [
    "BlockMaps",
    "Design",
    "EncircledEnergy",
    "Estimate",
    "Flux",
    "GhostFlux",
    "GhostPeak",
    "Gradient",
    "Log",
    "MatchMap",
    "Objective",
    "Peak",
    "RmsRadius",
    "Step",
    "TorchFunction",
    "Uniformity",
    "Value",
    "operand_estimate",
    "renew",
]
