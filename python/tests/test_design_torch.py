"""Operands and problems with Torch: gradients on the graph, Optiland's Torch optimiser, functions of a map. ``make test-torch`` runs it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import optiland.backend as be  # noqa: E402
from optiland.optimization import OptimizationProblem, TorchAdamOptimizer  # noqa: E402
from optiland.optimization.operand.operand import operand_registry  # noqa: E402

import nsq_gpu  # noqa: E402
from nsq_gpu.design import Flux, TorchFunction  # noqa: E402
from tests.test_design_operands import DIRECT, optic, program, sequential_focus, singlet, spot  # noqa: E402, F401
from tests.test_design_problem import problem  # noqa: E402
from tests.test_design_problem import singlet as scene_of_singlet  # noqa: E402

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def as_it_was(program: None) -> Iterator[None]:
    yield
    with_torch()
    be.grad_mode.disable()
    be.set_backend("numpy")


def with_torch() -> None:
    be.set_backend("torch")
    be.set_precision("float64")


def lens(thickness: float = 93.0) -> Any:
    """Return a lens with wide faces, which the light keeps clear of."""
    return optic([{"radius": 100.0, "thickness": 4.0, "material": "N-BK7", "is_stop": True, "aperture": 13.0},
                  {"radius": -100.0, "thickness": thickness, "aperture": 13.0}], 20.0)


def slopes(operand: str, data: dict[str, Any], thickness: float = 93.0) -> list[float]:
    """Return the derivatives of an operand by the front's radius and the last thickness, by Torch."""
    with_torch()
    found = lens(thickness)
    variables = OptimizationProblem()
    variables.add_variable(found, "radius", surface_number=1)
    variables.add_variable(found, "thickness", surface_number=2)
    optimizer = TorchAdamOptimizer(variables)
    for variable, parameter in zip(variables.variables, optimizer.params, strict=True):
        variable.update(parameter)
    variables.update_optics()
    value = operand_registry.get(operand)(optic=found, **data)
    gradient = torch.autograd.grad(value, optimizer.params)
    # Optiland's variables are radii over 100 and thicknesses over 10.
    return [float(gradient[0]) / 100.0, float(gradient[1]) / 10.0]


def differences(operand: str, data: dict[str, Any], steps: tuple[float, float], thickness: float = 93.0) -> list[float]:
    """Return the same by long steps of whole lenses, with numbers alone."""
    be.set_backend("numpy")
    found = []
    for step, move in zip(steps, (lambda optic, by: optic.updater.set_radius(100.0 + by, 1),
                                  lambda optic, by: optic.updater.set_thickness(thickness + by, 2)), strict=True):
        sides = []
        for side in (-step, step):
            moved = lens(thickness)
            move(moved, side)
            sides.append(float(operand_registry.get(operand)(optic=moved, **data)))
        found.append((sides[1] - sides[0]) / (2 * step))
    return found


@pytest.mark.parametrize(("operand", "more"), [
    ("nsq_rms_radius", {"where": DIRECT}), ("nsq_uniformity", {"where": DIRECT, "kernel": 0.05, "region": (-0.5, 0.5, -0.5, 0.5)}),
    ("nsq_flux", {"where": DIRECT, "circle": (0.0, 0.0, 0.1)})])
def test_rays_that_are_walked_back_have_the_slopes_of_whole_lenses(operand: str, more: dict[str, Any]) -> None:
    data = {"detector_size": (1.6, 1.6), "num_rays": 16_000, "blocks": 8, **more}
    notes = len(nsq_gpu.register_operands().notes)
    assert slopes(operand, data) == pytest.approx(differences(operand, data, (0.1, 0.05)), rel=0.05)
    said = [text for _, text in nsq_gpu.register_operands().notes[notes:]]
    assert not any("crosses edges" in text for text in said)


def data_of_flux() -> dict[str, Any]:
    return {"detector_size": (1.6, 1.6), "num_rays": 8_000, "blocks": 8, "where": DIRECT}


def test_each_lens_is_checked_for_light_that_crosses_edges() -> None:
    """Of the first lens all light lies within the detector; of the second, which has the same shape, much lies beside it."""
    data = data_of_flux()
    inside = slopes("nsq_flux", data)
    assert np.abs(inside).max() < 1e-5
    found = slopes("nsq_flux", data, 70.0)
    # So few rays have a noisy difference; without the light that crosses the edge it is below 1e-6.
    assert found == pytest.approx(differences("nsq_flux", {**data, "num_rays": 64_000}, (2.0, 1.0), 70.0), rel=0.6)
    assert any("crosses edges" in said for _, said in nsq_gpu.register_operands().notes)


def test_a_lens_that_changes_and_one_of_its_shape_are_checked_again() -> None:
    with_torch()
    be.grad_mode.enable()
    gradients = []
    for found, thickness in ((one := lens(), 93.0), (one, 70.0), (lens(70.0), 70.0)):
        parameter = torch.nn.Parameter(torch.tensor(100.0, dtype=torch.float64))
        found.updater.set_radius(parameter, 1)
        found.updater.set_thickness(thickness, 2)
        value = operand_registry.get("nsq_flux")(optic=found, **data_of_flux())
        gradients.append(float(torch.autograd.grad(value, parameter)[0]))
    assert abs(gradients[0]) < 1e-5
    assert gradients[1] < -1e-3 and gradients[2] < -1e-3


def test_tiny_steps_are_noticed_with_torch_as_the_backend() -> None:
    """Of the flux in a detector that light overfills, a step of 1e-7 alone has almost no derivative."""
    with_torch()
    be.grad_mode.disable()
    found = lens(70.0)
    data = {"optic": found, "detector_size": (1.6, 1.6), "num_rays": 16_000, "blocks": 8, "where": DIRECT}
    value = operand_registry.get("nsq_flux")
    here = float(value(**data))
    found.updater.set_thickness(70.0 + 1e-6, 2)
    slope = (float(value(**data)) - here) / 1e-6
    assert slope == pytest.approx(differences("nsq_flux", {k: v for k, v in data.items() if k != "optic"}, (2.0, 1.0), 70.0)[1], rel=0.6)


def test_guided_light_has_differences_and_the_log_says_so() -> None:
    data = {"detector_size": (16.0, 16.0), "num_rays": 80_000, "blocks": 8, "kernel": 0.5, "order": 4}
    found = np.array([slopes("nsq_ghost_peak", {**data, "seed": seed}) for seed in range(5)])
    # A step of 2 % beside one of 0.2 %, whose noise is the larger one.
    expected = np.array([differences("nsq_ghost_peak", {**data, "seed": seed}, (2.0, 1.0)) for seed in range(5)])
    error = (found - expected).std(axis=0, ddof=1) / np.sqrt(5)
    # Student's t with four degrees of freedom: 99 % lie within 4.6.
    assert (np.abs((found - expected).mean(axis=0)) < 4.6 * error).all()
    assert (np.abs(expected.mean(axis=0)) > 2 * error).any()
    assert any("guided light has no gradient; differences by common draws" in said for _, said in nsq_gpu.register_operands().notes)


def test_values_are_those_without_torch() -> None:
    data = spot(singlet(), num_rays=4000)
    expected = operand_registry.get("nsq_rms_radius")(**data)
    with_torch()
    value = operand_registry.get("nsq_rms_radius")(**spot(singlet(), num_rays=4000))
    assert isinstance(value, torch.Tensor) and float(value) == pytest.approx(float(expected), rel=1e-9)


def test_the_torch_optimiser_finds_the_focus() -> None:
    expected = sequential_focus()
    with_torch()
    found = singlet(95.2)
    variables = OptimizationProblem()
    variables.add_operand("nsq_rms_radius", target=0, weight=10, input_data=spot(found, num_rays=4000, blocks=4))
    variables.add_variable(found, "thickness", surface_number=2, min_val=94.0, max_val=99.0)
    TorchAdamOptimizer(variables).optimize(n_steps=25, lr=0.02, gamma=0.93, disp=False)
    assert float(found.surfaces[2].thickness) == pytest.approx(expected, abs=0.12)


def test_a_function_of_a_map_is_an_operand() -> None:
    own = problem(TorchFunction(detector="image", function=lambda map: map.sum() * (4.0 / 64)**2, target=2.0, name="sum"))
    flux = problem(Flux(detector="image", target=2.0, name="sum"))
    assert own.value().operands["sum"].value == pytest.approx(flux.value().operands["sum"].value, rel=1e-12)
    np.testing.assert_allclose(own.gradient().values, flux.gradient().values, rtol=1e-9, atol=1e-20)
    with pytest.raises(nsq_gpu.UsageError, match="must return one number"):
        problem(TorchFunction(detector="image", function=lambda map: map, target=2.0)).value()


def test_a_loss_is_on_the_graph_of_the_variables() -> None:
    one = problem()
    x = torch.tensor(one.x0, requires_grad=True)
    loss = one.loss(x)
    (3.0 * loss).backward()
    assert float(loss) == float(one.value())
    np.testing.assert_allclose(x.grad.numpy(), 3.0 * one.gradient().values, rtol=1e-12)


def test_adam_finds_what_lbfgs_finds() -> None:
    focus: dict[str, Any] = {"variables": {"image.z": (58.0, 68.0)}, "num_rays": 2000, "scene": scene_of_singlet(z=60.0)}
    adam = problem(**focus).minimize("Adam", max_rays=2000, lr=0.05, steps=60)
    other = problem(**focus).minimize(max_rays=2000)
    error = np.hypot(adam.standard_errors["image.z"], other.standard_errors["image.z"])
    assert adam.numbers["image.z"] == pytest.approx(other.numbers["image.z"], abs=4 * error)


