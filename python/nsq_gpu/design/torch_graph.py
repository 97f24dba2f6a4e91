"""Operands and problems on Torch's graph. Torch is imported here alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import optiland.backend as be
import torch
from torch.autograd.function import once_differentiable

from nsq_gpu.design.objectives import Objective, RmsRadius
from nsq_gpu.design.steps import scale_of
from nsq_gpu.errors import SceneError, UsageError
from nsq_gpu.export import to_json

#: Length of a step, over the scale of a number. Sizes that from_optic finds stay, so a longer step would make light miss them.
_STEP = 2e-3
#: Shapes of scenes whose gradients were checked for light that crosses edges, and whether the check has confirmed them.
_checked: dict[str, bool] = {}


class Number(torch.autograd.Function):  # type: ignore[misc, unused-ignore]
    """A number with a gradient that is computed when it is asked for."""

    @staticmethod
    def forward(ctx: Any, value: float, gradient: Callable[[], Sequence[Any]], *tensors: torch.Tensor) -> torch.Tensor:
        ctx.gradient = gradient
        ctx.tensors = [(tensor.shape, tensor.dtype, tensor.device) for tensor in tensors]
        like = tensors[0]
        return torch.tensor(value, dtype=like.dtype, device=like.device)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, adjoint: torch.Tensor) -> tuple[Any, ...]:
        found = [torch.as_tensor(np.asarray(value, dtype=float), dtype=dtype, device=device).reshape(shape) * adjoint
                 for value, (shape, dtype, device) in zip(ctx.gradient(), ctx.tensors, strict=True)]
        return None, None, *found


def operand_on_graph(evaluation: Any, exported: Any, fields: Sequence[str], objective: Objective) -> torch.Tensor:
    """Return an operand's value as a tensor, on the graph of the numbers that the optimiser may change."""
    documents = evaluation.alone(_plain(exported.document), fields)
    maps = [evaluation.maps_of(document, objective) for document in documents]
    value = evaluation.of(objective, maps)
    wanted = _of_variables(exported.wanted) if torch.is_grad_enabled() else {}
    if not wanted:
        constant: Any = be.array(value)
        return constant.detach()  # type: ignore[no-any-return]
    if objective.has_adjoints:
        def walked() -> list[float]:
            found = _walked_back(evaluation, documents, maps, objective, value, list(wanted))
            return found if found is not None else _by_numbers(evaluation, documents, objective, list(wanted))

        return Number.apply(value, walked, *wanted.values())
    leaves = _leaves(wanted.values())
    slopes = [_slopes(wanted, leaf) for leaf in leaves]
    evaluation.log.note_once(f"{evaluation.name}: guided light has no gradient; differences by common draws take its place, two traces "
                             "for each variable")

    def differences() -> list[np.ndarray]:
        return [np.array([_difference(evaluation, documents, objective, slope) for slope in of_leaf]) for of_leaf in slopes]

    return Number.apply(value, differences, *leaves)


def _plain(document: Any) -> Any:
    """Return a document whose numbers are plain ones."""
    if isinstance(document, dict):
        return {key: _plain(value) for key, value in document.items()}
    if isinstance(document, list):
        return [_plain(value) for value in document]
    return float(document) if isinstance(document, float) else document


def _leaves(tensors: Any) -> list[torch.Tensor]:
    """Return the leaves that tensors are computed from; where some are an optimiser's parameters, these alone."""
    found: dict[int, torch.Tensor] = {}
    for tensor in tensors:
        if tensor.is_leaf:
            found[id(tensor)] = tensor
        todo, seen = [tensor.grad_fn], set()
        while todo:
            node = todo.pop()
            if node is None or node in seen:
                continue
            seen.add(node)
            if hasattr(node, "variable"):
                found[id(node.variable)] = node.variable
            todo += [child for child, _ in node.next_functions]
    parameters = [leaf for leaf in found.values() if isinstance(leaf, torch.nn.Parameter)]
    return parameters or list(found.values())


def _of_variables(wanted: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return the tensors that depend on an optimiser's parameters, by their numbers' names; all of them where none does.

    Where gradients are on, Optiland makes every constant want one.
    """
    has_parameters = {name: any(isinstance(leaf, torch.nn.Parameter) for leaf in _leaves([tensor])) for name, tensor in wanted.items()}
    return {name: tensor for name, tensor in wanted.items() if has_parameters[name] or not any(has_parameters.values())}


def _slopes(wanted: dict[str, torch.Tensor], leaf: torch.Tensor) -> list[dict[str, float]]:
    """Return by how much each number changes with each element of a leaf."""
    found: list[dict[str, float]] = [{} for _ in range(leaf.numel())]
    for name, tensor in wanted.items():
        slope = torch.ones_like(leaf) if tensor is leaf else None
        if slope is None and tensor.grad_fn is not None:
            slope = torch.autograd.grad(tensor.sum(), leaf, retain_graph=True, allow_unused=True)[0]
        if slope is not None:
            for element, value in zip(found, slope.detach().cpu().double().reshape(-1).tolist(), strict=True):
                element[name] = value
    return found


def _walked_back(evaluation: Any, documents: Sequence[Any], maps: Sequence[Any], objective: Objective, value: float,
                 names: list[str]) -> list[float] | None:
    """Return the gradient by walking rays back; None where rays cannot be, or light crosses edges, and the log says so."""
    from nsq_gpu.design.operands import together, without_depth
    from nsq_gpu.edges import shape_of

    shape = shape_of([without_depth(document) for document in documents], {"where": objective.where}, [*names, evaluation.name])
    if not _checked.get(shape, True):
        return None
    gradient = np.zeros(len(names))
    whole = None if isinstance(objective, RmsRadius) else objective.value_and_adjoints(together(maps))[1]
    for document, of_field in zip(documents, maps, strict=True):
        if whole is None:
            radius, adjoints = objective.value_and_adjoints(of_field)
            adjoints = {name: array * (radius / (value * len(maps))) for name, array in adjoints.items()}
        else:
            adjoints = whole
        asked, text = evaluation.asked(document, objective), to_json(without_depth(document), indent=None)
        for block in range(asked.blocks):
            of_block = {name: array[block] for name, array in adjoints.items()}
            is_due = block == 0 and shape not in _checked
            try:
                found, answer = evaluation.tracer.gradient(text, asked, block, names, of_block, check_edges=is_due)
            except (SceneError, UsageError) as error:
                _checked[shape] = False
                evaluation.log.note_once(f"{evaluation.name}: differences by common draws take the place of its gradient: {error}")
                return None
            if is_due and answer["not_confirmed"]:
                _checked[shape] = False
                crossed = ", ".join(row["parameter"] for row in answer["not_confirmed"])
                evaluation.log.note_once(f"{evaluation.name}: light crosses edges where {crossed} changes; differences by common draws "
                                         "take the place of its gradient")
                return None
            gradient += found
    _checked[shape] = True
    return list(gradient)


def _by_numbers(evaluation: Any, documents: Sequence[Any], objective: Objective, names: Sequence[str]) -> list[float]:
    """Return the gradient by differences, a number at a time."""
    return [_difference(evaluation, documents, objective, {name: 1.0}) for name in names]


def _difference(evaluation: Any, documents: Sequence[Any], objective: Objective, slope: dict[str, float]) -> float:
    """Return what an operand gains where numbers change together, each by its slope, from two traces by common draws."""
    from nsq_gpu.design.operands import without_depth

    moved = {name: by for name, by in slope.items() if by}
    if not moved:
        return 0.0
    here = evaluation.tracer.session.numbers(to_json(without_depth(documents[0]), indent=None), list(moved))
    length = _STEP / max(abs(by) / _scale(name, here[name]) for name, by in moved.items())
    sides = []
    for side in (-1.0, 1.0):
        numbers = {name: here[name] + side * length * by for name, by in moved.items()}
        sides.append(evaluation.of(objective, [evaluation.maps_of(document, objective, numbers) for document in documents]))
    return float(sides[1] - sides[0]) / (2.0 * length)


def _scale(name: str, value: float) -> float:
    way = tuple(int(key) if key.isdigit() else key for key in name.replace('"', "").split("."))
    return scale_of(("", "", "", *way), value)
