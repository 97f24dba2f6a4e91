"""Operands and problems on Torch's graph. Torch is imported here alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import optiland.backend as be
import torch
from torch.autograd.function import once_differentiable

from nsq_gpu.design.objectives import Objective, RmsRadius
from nsq_gpu.design.steps import scale_of, step_between
from nsq_gpu.errors import SceneError, UsageError
from nsq_gpu.export import to_json

#: Length of a step, over the scale of a number. Sizes that from_optic finds stay, so a longer step would make light miss them.
_STEP = 2e-3
#: Fewest rays of a field by which a gradient is checked for light that crosses edges: few rays do so.
_CHECK_RAYS = 50_000
#: Length of that check's step, over the scale of a number.
_CHECK_STEP = 2e-3
#: It is done again where a number has changed by so much, over its scale.
_AGAIN = 0.05
#: Light crosses edges where the two ways are apart by more than so many standard errors, and this share of the derivative.
_SIGMAS, _MOST_APART = 3.0, 0.02


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
    from nsq_gpu.design.operands import plain

    document = plain(exported.document)
    wanted = _of_variables(exported.wanted) if torch.is_grad_enabled() else {}
    if not wanted:
        # An optimiser without gradients may take differences over tiny steps.
        constant: Any = be.array(evaluation.number(document, fields, objective))
        return constant.detach()  # type: ignore[no-any-return]
    documents = evaluation.alone(document, fields)
    maps = [evaluation.maps_of(document, objective) for document in documents]
    has_parameters = any(isinstance(leaf, torch.nn.Parameter) for leaf in _leaves(wanted.values()))
    value = evaluation.of(objective, maps) if has_parameters else evaluation.number(document, fields, objective)
    if objective.has_adjoints:
        def walked() -> list[float]:
            return _gradient(evaluation, documents, maps, objective, list(wanted))

        return Number.apply(value, walked, *wanted.values())
    leaves = _leaves(wanted.values())
    slopes = [_slopes(wanted, leaf) for leaf in leaves]
    evaluation.log.note_once(f"{evaluation.name}: guided light has no gradient; differences by common draws take its place, two traces "
                             "for each variable")

    def differences() -> list[np.ndarray]:
        return [np.array([_difference(evaluation, documents, objective, slope) for slope in of_leaf]) for of_leaf in slopes]

    return Number.apply(value, differences, *leaves)


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


def _gradient(evaluation: Any, documents: Sequence[Any], maps: Sequence[Any], objective: Objective, names: list[str]) -> list[float]:
    """Return the gradient by walking rays back, and by differences where rays cannot be, or light crosses edges; the log says so."""
    found: dict[str, float] = {}
    try:
        crossed = _crossed(evaluation, documents, objective, names)
        walked = [name for name in names if name not in crossed]
        if walked:
            parts = _parts(evaluation, documents, maps, _adjoints(evaluation, maps, objective), objective, walked)
            found = dict(zip(walked, parts.sum(axis=0).tolist(), strict=True))
    except (SceneError, UsageError) as error:
        evaluation.log.note_once(f"{evaluation.name}: differences by common draws take the place of its gradient: {error}")
    return [found[name] if name in found else _difference(evaluation, documents, objective, {name: 1.0}) for name in names]


def _adjoints(evaluation: Any, maps: Sequence[Any], objective: Objective) -> list[dict[str, np.ndarray]]:
    """Return what the value gains by a watt in each pixel of each block, by field and detector."""
    from nsq_gpu.design.operands import together

    if not isinstance(objective, RmsRadius):
        return [objective.value_and_adjoints(together(maps))[1]] * len(maps)
    value = evaluation.of(objective, maps)
    found = []
    for of_field in maps:
        radius, adjoints = objective.value_and_adjoints(of_field)
        found.append({name: array * (radius / (value * len(maps))) for name, array in adjoints.items()})
    return found


def _parts(evaluation: Any, documents: Sequence[Any], maps: Sequence[Any], adjoints: Sequence[dict[str, np.ndarray]],
           objective: Objective, names: list[str], least_rays: int = 0) -> np.ndarray:
    """Return what each block of rays adds to the gradient, shape (blocks, names), by walking them back."""
    from nsq_gpu.design.operands import without_depth

    found = np.zeros((next(iter(maps[0].values())).num_blocks, len(names)))
    for document, of_field in zip(documents, adjoints, strict=True):
        asked, text = evaluation.asked(document, objective, least_rays), to_json(without_depth(document), indent=None)
        for block in range(asked.blocks):
            of_block = {name: array[block] for name, array in of_field.items()}
            found[block] += evaluation.tracer.gradient(text, asked, block, names, of_block)[0]
    return found


def _crossed(evaluation: Any, documents: Sequence[Any], objective: Objective, names: list[str]) -> set[str]:
    """Return the numbers by which differences of traces do not confirm that rays are walked back.

    All blocks are compared, with common draws. It is done again where a number of the scene has changed by a few percent.
    """
    from nsq_gpu.design.operands import without_depth

    key = str((evaluation.own, names))
    if key in evaluation.checked:
        before, crossed = evaluation.checked[key]
        change = step_between(before, documents[0])
        if change is not None and change <= _AGAIN:
            return set(crossed)
    here = evaluation.tracer.session.numbers(to_json(without_depth(documents[0]), indent=None), names)
    maps = [evaluation.maps_of(document, objective, None, _CHECK_RAYS) for document in documents]
    adjoints = _adjoints(evaluation, maps, objective)
    parts = _parts(evaluation, documents, maps, adjoints, objective, names, _CHECK_RAYS)
    crossed, is_dark = set(), not any(array.any() for of_field in adjoints for array in of_field.values())
    for column, name in enumerate(names):
        step = _CHECK_STEP * _scale(name, here[name])
        by_blocks = np.zeros(len(parts))
        for document, of_field in zip(documents, adjoints, strict=True):
            for side in (-1.0, 1.0):
                moved = evaluation.maps_of(document, objective, {name: here[name] + side * step}, _CHECK_RAYS)
                by_blocks += side * sum((array * moved[detector].flux).sum(axis=(1, 2)) for detector, array in of_field.items()) / (2.0 * step)
        apart = by_blocks - parts[:, column]
        # Each block's share is a part of a sum.
        error = float(apart.std(ddof=1) * np.sqrt(len(apart)))
        least = _MOST_APART * max(abs(by_blocks.sum()), abs(parts[:, column].sum()))
        if abs(apart.sum()) > _SIGMAS * error + least:
            crossed.add(name)
    if crossed:
        evaluation.log.note_once(f"{evaluation.name}: light crosses edges where {', '.join(sorted(crossed))} changes; differences by "
                                 "common draws take the place of its gradient")
    if not is_dark:
        evaluation.checked[key] = documents[0], crossed
    return crossed


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
