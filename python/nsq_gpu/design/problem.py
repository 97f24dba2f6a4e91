"""``Problem``: variables with bounds, operands with targets, and a budget; values and gradients with their standard errors."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene

from nsq_gpu.arguments import PRECISIONS, answering, check_mapping, flag, near, of_names
from nsq_gpu.binary import find_binary
from nsq_gpu.design import checking
from nsq_gpu.design.log import Log
from nsq_gpu.design.maps import FEWEST_BLOCKS, Estimate, Maps, jackknife, jackknife_errors
from nsq_gpu.design.objectives import Objective, check_objectives, merit
from nsq_gpu.design.tracing import Asked, Json, Tracer
from nsq_gpu.display import Displayed, Summary, number
from nsq_gpu.errors import NsqGpuWarning, SceneError, UsageError, warn
from nsq_gpu.gradients import _asked, warn_of_lost
from nsq_gpu.scene_file import parsed
from nsq_gpu.session import shared_session
from nsq_gpu.units import unit_of

#: How gradients are found.
GRADIENTS = ("auto", "reverse", "differences")
#: Rays by which precision and depth are found, which then are frozen.
_FIRST_RAYS = 64
#: Rays of a trace that looks for light at edges, and how many such traces there are. The program takes no more for that.
_CHECK_RAYS, _CHECKS = 2**15, 2
#: A check holds for places whose variables differ by at most this share of their ranges; and where a stage begins or ends.
CHECKED_NEAR, CHECKED_HERE = 0.1, 0.01
#: By how much of itself the merit rises where second derivatives are found.
_RISE = 0.03
#: What is one trace: the filter, and whether rays are guided.
_Group = tuple[str | None, bool]


@dataclass(frozen=True, repr=False)
class Value(Displayed):
    """The merit of a design, with what each operand has."""

    #: Sum of squares of what is missed.
    value: float
    #: Its standard error.
    standard_error: float
    #: About how much noise has added to the merit, which is a sum of squares; it is not taken off.
    bias: float
    #: By the operands' names.
    operands: dict[str, Estimate]
    #: Rays of each trace.
    num_rays: int

    def __float__(self) -> float:
        return self.value

    def _summary(self) -> Summary:
        rows = [[name, number(found.value, 6), number(found.standard_error, 2)] for name, found in self.operands.items()]
        return Summary(f"Value: {number(self.value)} ± {number(self.standard_error, 2)}, {self.num_rays:,} rays",
                       ["operand", "value", "error"], rows)


@dataclass(frozen=True, repr=False)
class Gradient(Displayed):
    """What the merit gains by a unit of each variable."""

    #: Names of the variables.
    names: list[str]
    values: np.ndarray
    #: Standard errors; NaN where they were not asked for.
    standard_errors: np.ndarray
    #: How each was found: ``"reverse"`` or ``"differences"``.
    found_by: list[str]
    #: By how much the gradient differs without each block of rays; shape (blocks, variables).
    influences: np.ndarray

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype=dtype)

    def _summary(self) -> Summary:
        rows = [[name, number(value, 5), number(error, 2), f"1/{unit_of(name) or 'unit'}", by]
                for name, value, error, by in zip(self.names, self.values, self.standard_errors, self.found_by, strict=True)]
        return Summary("Gradient of the merit", ["variable", "d merit", "error", "unit", "found by"], rows)


class Problem:
    """A scene whose numbers are to be chosen, so that operands come near to what is wanted of them.

    The merit is the sum of ``(weight * (value - target))**2`` over the operands. For one choice of seed, guide, precision and depth
    the merit is a function that optimisers may compare: all of them are frozen, and renewing them is a restart that the log has.

    A value's standard error comes from blocks of rays. A gradient is found by walking rays back, or by differences of
    traces by common draws, where rays are guided, pixels are hard, or light crosses edges; the log says so.

    >>> from nsq_gpu.design import RmsRadius
    >>> problem = nsq_gpu.Problem(scene, {"L1.r1": (20, 60), "L1.z": (0, 5)}, [RmsRadius(detector="image", target=0)])
    >>> design = problem.minimize(max_rays=1_000_000)
    >>> design.numbers, design.fresh

    Args:
        scene: The live scene, or its file.
        variables: Bounds (least, largest) by the names of numbers, as in :meth:`nsq_gpu.Session.sweep`.
        operands: Operands of :mod:`nsq_gpu.design`.
        num_rays: Rays of a trace, in all blocks together.
        blocks: Blocks of rays, at least 4.
        seed: Seed of the draws.
        gradient: ``"reverse"`` or ``"differences"``. ``"auto"`` walks rays back where all light that changes can be seen there.
        step: Half of a difference's step, as a share of a variable's range.
        max_depth: Largest number of events of a ray. None takes 16, and four times the surfaces where rays are guided.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        adapter: A part of the adapter's name.
        binary: Path of the program.

    Raises:
        UnknownNameError: A variable is the name of nothing.
        UsageError: Bounds or operands make no sense.
    """

    @checking.by_names
    def __init__(self, scene: NSQScene | str | os.PathLike[str], variables: Mapping[str, tuple[float, float]],
                 operands: Objective | Sequence[Objective], *, num_rays: int = 20_000, blocks: int = 10, seed: int = 0,
                 gradient: str = "auto", step: float = 0.005, max_depth: int | None = None, precision: str = "auto",
                 adapter: str | None = None, binary: str | os.PathLike[str] | None = None) -> None:
        check_mapping("variables", variables, '{"L1.r1": (20.0, 60.0)}')
        if not variables:
            raise UsageError('variables is empty; give one at least, such as {"L1.r1": (20.0, 60.0)}')
        self.names = [checking.text("variables: a name", name, 'the name of a number, such as "L1.r1"') for name in variables]
        self.bounds = np.array([_bounds(name, variables[name]) for name in self.names])
        self._gradient = checking.one_of("gradient", gradient, GRADIENTS)
        self._step = checking.number("step", step, "a share of the range of a variable, more than 0 and at most 0.1", above=0.0, most=0.1)
        blocks = checking.whole("blocks", blocks, FEWEST_BLOCKS)
        self._plain = Asked(checking.rays_of("num_rays", num_rays, blocks) // blocks * blocks, blocks, checking.seed_of("seed", seed),
                            None if max_depth is None else checking.depth_of("max_depth", max_depth),
                            checking.one_of("precision", precision, PRECISIONS))
        if adapter is not None:
            checking.text("adapter", adapter, "a part of an adapter's name, or None")
        if binary is not None:
            checking.path("binary", binary)
        try:
            names, self._text, place = _asked(scene, self.names)
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"scene: {scene} cannot be read: {getattr(error, 'strerror', None) or error}; name a scene file") from None
        program = find_binary(binary)
        session = shared_session(program, adapter)
        self._tracer = Tracer(session, program, name=str(place["name"]), folder=place["folder"])
        self._document: Json = parsed(self._text)
        self._detectors: list[Json] = list(self._document["detectors"])
        self.operands = check_objectives(operands, {entry["name"]: entry["type"] for entry in self._detectors})
        self.labels = _labels(self.operands)
        checking.whole("blocks", blocks, max(of.fewest_blocks for of in self.operands))
        with answering(self._text, names):
            start = session.numbers(self._text, names)
        #: The scene's own values of the variables, within bounds.
        self.x0 = np.clip(np.array([start[name] for name in names]), *self.bounds.T)
        self._by_differences: set[str] | None = None
        #: Places where light at edges was looked for, as shares of ranges, by the operands' places.
        self._checked: dict[int, list[np.ndarray]] = {}
        #: Notes that a fresh log begins with.
        self._notes: list[str] = []
        self._is_frozen = False
        self._gradients: dict[Any, Gradient] = {}
        #: Notes of what was chosen. Each :meth:`minimize` begins a log of its own, which then is this one.
        self.log = self._fresh_log()
        for name, own, within in zip(names, start.values(), self.x0, strict=True):
            if own != within:
                self._note(f"{name} is {own:g} in the scene, which is beyond its bounds; the start is {within:g}")
        self._num_first = len(self._notes)

    def _fresh_log(self) -> Log:
        """Return a log without steps, which has the notes of what was chosen."""
        return Log(self.names, self.labels, notes=[(0, said) for said in self._notes], settings={})

    def _note(self, message: str) -> None:
        """Keep a note of what was chosen, for all logs to come."""
        if message not in self._notes:
            self._notes.append(message)
            self.log.note(message)

    # What is frozen

    @property
    def num_rays(self) -> int:
        """Return the rays of a trace, in all blocks together: a multiple of the number of blocks."""
        return self._plain.num_rays

    @num_rays.setter
    def num_rays(self, count: int) -> None:
        blocks = self._plain.blocks
        self._plain = replace(self._plain, num_rays=checking.rays_of("num_rays", count, blocks) // blocks * blocks)

    @checking.by_names
    def renew(self, seed: int | None = None) -> None:
        """Take other draws, and learn guides anew; the log has it. Values before and after are of different functions.

        Args:
            seed: The new seed; None takes the next one.
        """
        self._plain = replace(self._plain, seed=self._plain.seed + 1 if seed is None else checking.seed_of("seed", seed))
        self._tracer.forget_guides()
        self._tracer.forget()
        self._gradients.clear()
        self._by_differences = None
        self._checked.clear()
        del self._notes[self._num_first:]
        self._note(f"restart: seed {self._plain.seed}, and guides are learned anew")

    def settings(self) -> Json:
        """Return what is frozen, and what it is of."""
        self._freeze()
        return {"scene": hashlib.sha256(self._text.encode()).hexdigest(), "variables": {name: list(pair) for name, pair in
                zip(self.names, self.bounds.tolist(), strict=True)}, "operands": [_described(of) for of in self.operands],
                "seed": self._plain.seed, "blocks": self._plain.blocks, "gradient": self._gradient, "step": self._step, "precision": self._plain.precision,
                "max_depth": self._plain.max_depth}

    def _freeze(self) -> None:
        """Find precision and depth once, and keep them."""
        if self._is_frozen:
            return
        asked = replace(self._plain, num_rays=_FIRST_RAYS, blocks=1)
        report = self._tracer.session.request(self._text, asked.options(0), numbers=self.numbers(self.x0), **self._tracer.place).report
        depth = self._plain.max_depth
        if depth is None:
            depth = max(16, 4 * len(report["surfaces"])) if any(of.guide for of in self.operands) else int(report["max_depth"])
        self._plain = replace(self._plain, precision=report["precision"], max_depth=depth)
        self._is_frozen = True
        for of in self.operands:
            if of.where is not None:
                # A filter that makes no sense is refused now.
                asked = replace(asked, where=of.where, precision=report["precision"], max_depth=depth)
                self._tracer.session.request(self._text, asked.options(0), **self._tracer.place)

    def _asked(self, group: _Group) -> Asked:
        """Return how the light of a group is traced."""
        where, guide = group
        asked = replace(self._plain, where=where)
        if not guide:
            return asked
        file, is_new = self._tracer.guide(self._document, where, max_depth=asked.max_depth, seed=asked.seed)
        if is_new:
            self._note(f"a guide was learned in the scene as it was given, for {where or 'all light'}, and stays")
        return replace(asked, guide=file)

    # Values

    @checking.by_names
    def numbers(self, x: Any) -> dict[str, float]:
        """Return variables by their names, from an array in the order of ``names``, or from such a dictionary."""
        if isinstance(x, Mapping):
            for name in x:
                if name not in self.names:
                    raise UsageError(f"x has {name!r}, which is no variable; {near(str(name), self.names)}")
            missing = [name for name in self.names if name not in x]
            if missing:
                raise UsageError(f"x lacks {', '.join(map(repr, missing))}; give a number for each of {', '.join(self.names)}")
            x = [x[name] for name in self.names]
        values = checking.array("x", x, f"a number for each of {', '.join(self.names)}").ravel()
        if values.shape != (len(self.names),):
            raise UsageError(f"x has {values.size} numbers; give {len(self.names)}, of {', '.join(self.names)}")
        if not np.isfinite(values).all():
            raise UsageError(f"x is {values}; give finite numbers")
        return dict(zip(self.names, map(float, values), strict=True))

    @checking.by_names
    def value(self, x: Any = None) -> Value:
        """Return the merit, and each operand's value, with standard errors.

        Args:
            x: Variables, in an array or by name. None takes the scene's values.

        Raises:
            SceneError: The scene cannot be traced with these numbers.
        """
        groups = self._groups(self._numbers(x))
        count = self._plain.blocks
        values = self._values(groups)
        others = np.array([self._values(_without(groups, block)) for block in range(count)])
        merits = np.array([merit(self.operands, row) for row in others])
        found = jackknife(merit(self.operands, values), merits)
        operands = {label: jackknife(value, column) for label, value, column in zip(self.labels, values, others.T, strict=True)}
        return Value(found.value, found.standard_error, found.bias, operands, self.num_rays)

    @checking.by_names
    def maps(self, x: Any = None, *, where: str | None = None, guide: bool = False) -> Maps:
        """Return the maps of irradiance detectors, by blocks of rays."""
        group = checking.filter_of("where", where), flag("guide", guide)
        return self._groups(self._numbers(x), [group])[group]

    def _numbers(self, x: Any) -> dict[str, float]:
        self._freeze()
        numbers = self.numbers(self.x0 if x is None else x)
        beyond = [f"{name} = {value:g}" for (name, value), (low, high) in zip(numbers.items(), self.bounds, strict=True)
                  if not low - 1e-9 * (high - low) <= value <= high + 1e-9 * (high - low)]
        if beyond:
            warn(f"{', '.join(beyond)}: beyond the bounds of the problem, and traced all the same; give the problem wider bounds",
                 NsqGpuWarning)
        return numbers

    def _groups(self, numbers: Mapping[str, float], groups: Sequence[_Group] | None = None) -> dict[_Group, Maps]:
        """Return the maps of each group of operands, which share a trace."""
        wanted = groups or list(dict.fromkeys((of.where, of.guide) for of in self.operands))
        try:
            return {group: self._tracer.maps(self._text, self._asked(group), numbers, self._detectors) for group in wanted}
        except (SceneError, UsageError) as error:
            raise of_names(error, self._text, numbers) from None

    def _values(self, groups: Mapping[_Group, Maps]) -> list[float]:
        return [of.value(groups[of.where, of.guide]) for of in self.operands]

    # Gradients

    @checking.by_names
    def gradient(self, x: Any = None, *, errors: bool = True) -> Gradient:
        """Return what the merit gains by a unit of each variable, with standard errors.

        Args:
            x: Variables, in an array or by name. None takes the scene's values.
            errors: False leaves standard errors of reverse passes away, which takes half of the time.

        Raises:
            SceneError: The scene cannot be traced with these numbers.
        """
        errors, numbers = flag("errors", errors), self._numbers(x)
        key = (tuple(numbers.values()), self._plain)
        known = self._gradients.get(key)
        if known is not None and not (errors and np.isnan(known.standard_errors).any()):
            return known
        self._choose(numbers, CHECKED_NEAR)
        count, size = self._plain.blocks, len(self.names)
        values, influences = np.zeros(size), np.full((count, size), np.nan)
        while walked := [index for index, name in enumerate(self.names) if name not in self._found_by_differences]:
            names = [self.names[index] for index in walked]
            try:
                values[walked], influences[:, walked] = self._walked(numbers, names, errors)
                break
            except UsageError as error:
                self._take_differences(error, names)
        by_differences = self._found_by_differences
        for index, name in enumerate(self.names):
            if name in by_differences:
                values[index], influences[:, index] = self._difference(numbers, index)
        found = Gradient(self.names, values, jackknife_errors(influences),
                         ["differences" if name in by_differences else "reverse" for name in self.names], influences)
        if len(self._gradients) > 256:
            self._gradients.clear()
        self._gradients[key] = found
        return found

    @property
    def _found_by_differences(self) -> set[str]:
        """Return the variables whose derivatives are differences."""
        return self._by_differences or set()

    def _choose(self, numbers: Mapping[str, float], near_by: float) -> bool:
        """Decide which derivatives are differences, and note why; return whether there are more of them than before.

        Light comes to edges somewhere on the way, so what was decided far from here is looked at again.
        """
        before = set(self._found_by_differences)
        if self._by_differences is None:
            self._by_differences = set()
            why = self._no_reverse() if self._gradient != "differences" else None
            if why is not None:
                self._all_by_differences(why)
            elif self._gradient == "differences":
                self._by_differences = set(self.names)
        names = [name for name in self.names if name not in self._found_by_differences]
        while names:
            try:
                crossed = self._not_confirmed(numbers, names, near_by)
            except UsageError as error:
                self._take_differences(error, names)
            else:
                if crossed:
                    self._note_crossed(crossed)
                break
            names = [name for name in self.names if name not in self._found_by_differences]
        if self._found_by_differences == before:
            return False
        self._gradients.clear()
        return True

    def _all_by_differences(self, why: str) -> None:
        """Take differences for all variables.

        Raises:
            UsageError: Rays were to be walked back.
        """
        if self._gradient == "reverse":
            self._by_differences = None
            raise UsageError(f"{why}; take gradient='differences', or 'auto'")
        self._note(f"gradients are differences by common draws: {why}")
        self._by_differences = set(self.names)

    def _take_differences(self, error: UsageError, names: Sequence[str]) -> None:
        """Take differences for the variables that an error names as acting at edges alone; where it names none, for all."""
        alone = {name for name in names if f"`{name}` acts at edges alone" in str(error)}
        if not alone or self._gradient == "reverse":
            self._all_by_differences(str(error))
            return
        self._note(f"{', '.join(sorted(alone))} acts at edges alone; its derivative is a difference by common draws")
        self._by_differences = self._found_by_differences | alone
        self._gradients.clear()

    def _note_crossed(self, crossed: set[str]) -> None:
        """Note that light crosses edges, and take differences unless rays were to be walked back."""
        listed = ", ".join(sorted(crossed))
        if self._gradient == "reverse":
            self._note(f"light crosses edges where {listed} changes; the gradient leaves that light out, as asked")
            return
        self._note(f"light crosses edges where {listed} changes; its derivative is a difference by common draws")
        self._by_differences = self._found_by_differences | crossed

    def _no_reverse(self) -> str | None:
        """Return why rays cannot be walked back; None if they can."""
        guided = next((label for of, label in zip(self.operands, self.labels, strict=True) if not of.has_adjoints), None)
        if guided is not None:
            return f"the light of {guided} is guided"
        splats = {entry["name"]: entry.get("splat", "hard") for entry in self._detectors if entry["type"] == "irradiance"}
        hard = next((of.detector for of in self.operands if splats[of.detector] == "hard"), None)
        return None if hard is None else f"pixels of {hard} are hard, and a ray that moves within one changes nothing"

    def _not_confirmed(self, numbers: Mapping[str, float], names: Sequence[str], near_by: float) -> set[str]:
        """Return the variables by which short differences of two traces do not confirm derivatives of the interior.

        Each operand's own value is checked, since a merit says nothing of an operand that is met. An operand is looked at where it
        was not yet, which means no nearer than ``near_by``. The rays are others than the blocks', and many: few rays see
        little of an edge. They count for no budget.
        """
        place = self.shares_of(np.array(list(numbers.values())))
        if self._gradient == "reverse":
            # The log says it once, and nothing else depends on it.
            near_by = np.inf
        due = [index for index in range(len(self.operands))
               if all(np.abs(place - known).max() > near_by for known in self._checked.get(index, []))]
        if not due:
            return set()
        groups, crossed, spent = self._groups(numbers), set(), self._tracer.num_rays
        for index in due:
            of = self.operands[index]
            group = of.where, of.guide
            adjoints = {name: np.asarray(array).sum(axis=0) for name, array in of.value_and_adjoints(groups[group])[1].items()}
            if not all(np.isfinite(array).all() for array in adjoints.values()) or not any(array.any() for array in adjoints.values()):
                # No light, or so: this place has no verdict.
                continue
            for check in range(_CHECKS):
                asked = replace(self._asked(group), num_rays=_CHECK_RAYS, blocks=1, seed=self._plain.seed + 2**32 + check)
                _, answer = self._tracer.gradient(self._text, asked, 0, names, adjoints, numbers, check_edges=True)
                crossed |= {row["parameter"] for row in answer["not_confirmed"]}
            self._checked.setdefault(index, []).append(place)
        self._tracer.num_rays = spent
        return crossed

    def shares_of(self, x: np.ndarray) -> np.ndarray:
        """Return variables as shares of their ranges."""
        low, high = self.bounds.T
        return np.asarray((x - low) / (high - low))

    def _adjoints(self, groups: Mapping[_Group, Maps]) -> dict[_Group, dict[str, np.ndarray]]:
        """Return what the merit gains by a watt in each pixel of each block, by group and detector."""
        found: dict[_Group, dict[str, np.ndarray]] = {group: {} for group in groups}
        for of in self.operands:
            value, adjoints = of.value_and_adjoints(groups[of.where, of.guide])
            factor = 2.0 * of.weight**2 * of.missed(value)
            for name, array in adjoints.items():
                known = found[of.where, of.guide].get(name, 0.0)
                found[of.where, of.guide][name] = known + factor * array
        return found

    def _walked(self, numbers: Mapping[str, float], names: Sequence[str], errors: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradient by walking rays back, and by how much it differs without each block.

        A block matters twice: its rays make a part of the derivatives of the map, and a part of the adjoints. What its adjoints
        change is seen by the rays of the next block, which are independent of it.
        """
        groups, count = self._groups(numbers), self._plain.blocks
        adjoints = self._adjoints(groups)

        def walk(group: _Group, block: int, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
            values, answer = self._tracer.gradient(self._text, self._asked(group), block, names, arrays, numbers)
            warn_of_lost(answer["num_lost"])
            return values

        parts = np.array([sum(walk(group, block, {name: array[block] for name, array in of.items()}) for group, of in adjoints.items())
                          for block in range(count)])
        total = parts.sum(axis=0)
        if not errors:
            return total, np.full((count, len(names)), np.nan)
        whole = {group: {name: array.sum(axis=0) for name, array in of.items()} for group, of in adjoints.items()}
        influences = np.empty((count, len(names)))
        for block in range(count):
            without = self._adjoints(_without(groups, block))
            changed = {group: {name: array.sum(axis=0) - whole[group][name] for name, array in of.items()} for group, of in without.items()}
            seen = sum(walk(group, (block + 1) % count, arrays) for group, arrays in changed.items())
            influences[block] = (total - count * parts[block]) / (count - 1) + seen
        return total, influences

    def _difference(self, numbers: Mapping[str, float], index: int) -> tuple[float, np.ndarray]:
        """Return the derivative by a variable from traces by common draws, and by how much it differs without each block."""
        low, high = self.bounds[index]
        here, step = numbers[self.names[index]], self._step * (high - low)
        if low + step <= here <= high - step:
            weights = {-step: -0.5 / step, step: 0.5 / step}
        else:
            # At a bound all points lie within.
            side = step if here < low + step else -step
            weights = {0.0: -1.5 / side, side: 2.0 / side, 2.0 * side: -0.5 / side}
        points = [(self._groups({**numbers, self.names[index]: here + by}), weight) for by, weight in weights.items()]
        value = sum(weight * merit(self.operands, self._values(groups)) for groups, weight in points)
        others = np.array([sum(weight * merit(self.operands, self._values(_without(groups, block))) for groups, weight in points)
                           for block in range(self._plain.blocks)])
        return float(value), others - value

    # For other optimisers

    def for_scipy(self) -> dict[str, Any]:
        """Return what ``scipy.optimize.minimize`` takes.

        >>> scipy.optimize.minimize(**problem.for_scipy(), method="SLSQP")
        """
        return {"fun": lambda x: float(self.value(x)), "x0": self.x0.copy(), "jac": lambda x: self.gradient(x, errors=False).values,
                "bounds": [tuple(pair) for pair in self.bounds.tolist()]}

    @checking.by_names
    def loss(self, x: Any) -> Any:
        """Return the merit of a tensor of variables, on its graph: for ``torch.optim``, or any function of it.

        >>> x = torch.tensor(problem.x0, requires_grad=True)
        >>> problem.loss(x).backward()
        """
        if not hasattr(x, "detach"):
            raise checking.refused("x", x, "a tensor of Torch, such as torch.tensor(problem.x0, requires_grad=True)")
        from nsq_gpu.design.torch_graph import Number

        numbers = x.detach().cpu().double().numpy()
        return Number.apply(float(self.value(numbers)), lambda: [self.gradient(numbers, errors=False).values], x)

    @checking.by_names
    def spread(self, x: Any) -> np.ndarray:
        """Return standard errors of variables near a minimum: by how much noise moves it, and how far off it is.

        The first part is the gradient's noise through the inverse of the matrix of second derivatives, which are differences of
        gradients. The second part is the gradient itself through that matrix: what the optimiser left undone. A
        variable at a bound has the error 0. NaN where the matrix says that this is no minimum.
        """
        here = np.array(list(self._numbers(x).values()))
        low, high = self.bounds.T
        size = high - low
        first = self.gradient(here)
        free = [index for index in range(len(here)) if not self._is_held(here, first.values, index)]
        found = np.zeros(len(here))
        if not free:
            return found
        merit_here, at = float(self.value(here)), (here[free] - low[free]) / size[free]

        def gradient_at(u: np.ndarray) -> np.ndarray:
            moved = here.copy()
            moved[free] = low[free] + u * size[free]
            return np.asarray(self.gradient(moved, errors=False).values[free] * size[free])

        try:
            _, axes = np.linalg.eigh(np.array([_second(gradient_at, at, axis, merit_here, 2.0 * self._step) for axis in np.eye(len(free))]))
            # A valley is a thousand times flatter along than across: its curvature shows along its own axis alone.
            second = np.array([_second(gradient_at, at, axis, merit_here, 2.0 * self._step) @ axis for axis in axes.T])
        except SceneError:
            second = np.zeros(1)
        if not (second > 0.0).all():
            found[free] = np.nan
            return found
        moved = (first.influences[:, free] * size[free]) @ axes / second @ axes.T * size[free]
        left = (first.values[free] * size[free]) @ axes / second @ axes.T * size[free]
        found[free] = np.hypot(jackknife_errors(moved), left)
        return found

    def _is_held(self, x: np.ndarray, gradient: np.ndarray, index: int) -> bool:
        """Return whether a variable lies at a bound, beyond which the merit falls."""
        low, high = self.bounds[index]
        close = 1e-9 * (high - low)
        return bool((x[index] <= low + close and gradient[index] > 0.0) or (x[index] >= high - close and gradient[index] < 0.0))

    @checking.by_names
    def minimize(self, method: str = "L-BFGS-B", *, x0: Any = None, max_rays: int | None = None, budget: float | None = None,
                 steps: int = 100, growth: int = 4, tolerance: float = 1e-6, errors: bool = True,
                 callback: Callable[[Any], Any] | None = None, log: str | os.PathLike[str] | None = None,
                 resume: Log | str | os.PathLike[str] | None = None, **options: Any) -> Any:
        """Look for the variables of the least merit; return a :class:`nsq_gpu.design.Design`.

        A stage has one number of rays. It ends where noise decides, or where the optimiser has converged. Noise decides where the
        whole gradient is what noise makes of none, by Hotelling's test: a component may be within its error while all together are
        not. The next stage begins at the best place with ``growth`` times the rays. Within a stage, and so within a line search,
        nothing is renewed. Where a stage begins and ends, light at edges is looked for again.

        Each call has a log of its own, and leaves ``num_rays`` as it was.

        Args:
            method: A method of ``scipy.optimize.minimize``, ``"differential_evolution"``, or a class of ``torch.optim``, such as
                ``"Adam"``.
            x0: Where to begin. None takes the scene's own numbers.
            max_rays: Rays of a trace in the last stage. None takes 16 times ``num_rays``.
            budget: Rays of all traces together, after which no step begins; rays that look for edges do not count. None has no end.
            steps: Most steps of this call, in all stages together.
            growth: By which factor rays grow from stage to stage.
            tolerance: Where an optimiser has converged: change of the merit over itself, or of variables over their range.
            errors: True finds standard errors of the variables at the end, by differences of gradients.
            callback: Called after each step with the :class:`nsq_gpu.design.Step`; a true answer stops.
            log: File to which the log is written after each step. A file that exists is refused, unless ``resume`` names it, too.
            resume: Log of an optimisation that was stopped, or its file: go on from its best place.
            options: Further options: of ``torch.optim`` such as ``lr``, of SciPy's method else.

        Raises:
            UsageError: An argument makes no sense, the log is of another problem, or no light comes to a detector at the start.
            NsqGpuError: A trace failed. After a step, ``partial`` is the best design so far.
            Interrupted: Ctrl-C ended it; ``partial`` is the best design so far.
        """
        from nsq_gpu.design.minimizing import minimize

        return minimize(self, method, x0=x0, max_rays=max_rays, budget=budget, steps=steps, growth=growth, tolerance=tolerance,
                        errors=errors, callback=callback, log_file=log, resume=resume, options=options)

    @property
    def rays_so_far(self) -> int:
        """Return the rays of all traces so far."""
        return self._tracer.num_rays


def _second(gradient: Callable[[np.ndarray], np.ndarray], at: np.ndarray, axis: np.ndarray, merit_here: float, step: float) -> np.ndarray:
    """Return the second derivatives along an axis, from gradients on both sides, where the merit is a few percent larger."""
    for _ in range(3):
        # No point may lie beyond a bound.
        ends = [np.clip(at + side * step * axis, 0.0, 1.0) for side in (-1.0, 1.0)]
        apart = float(np.linalg.norm(ends[1] - ends[0]))
        found = (gradient(ends[1]) - gradient(ends[0])) / apart
        wanted = np.sqrt(2.0 * _RISE * merit_here / max(abs(float(found @ axis)), 1e-300))
        if 0.4 * step < wanted < 2.5 * step or merit_here <= 0.0:
            break
        step = min(max(wanted, 1e-5), 0.1)
    return np.asarray(found)


def _bounds(name: str, given: Any) -> tuple[float, float]:
    """Return the bounds of a variable."""
    wanted = "its least and its largest value, such as (20.0, 60.0)"
    low, high = checking.numbers(f"variables: the range of {name}", given, 2, wanted)
    if not low < high:
        raise checking.refused(f"variables: the range of {name}", given, wanted)
    return low, high


def _labels(operands: Sequence[Objective]) -> list[str]:
    """Return a name for each operand, no two the same."""
    found: list[str] = []
    for of in operands:
        label, count = of.label, 2
        while label in found:
            label, count = f"{of.label} {count}", count + 1
        found.append(label)
    return found


def _described(of: Objective) -> str:
    """Return an operand as a text, by which a log knows it again."""
    shown = {name: _shown(value) for name, value in vars(of).items()}
    return f"{type(of).__name__}({', '.join(f'{name}={value!r}' for name, value in shown.items())})"


def _shown(value: Any) -> Any:
    """Return a field of an operand; of an array its hash, and of a function its name with its code's hash."""
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]
    if not callable(value):
        return value
    code = getattr(value, "__code__", None)
    said = "" if code is None else hashlib.sha256(_code(code).encode()).hexdigest()[:16]
    return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__qualname__)} {said}".strip()


def _code(code: Any) -> str:
    """Return what a function does, as a text without places in memory."""
    constants = [_code(of) if hasattr(of, "co_code") else repr(sorted(map(repr, of))) if isinstance(of, frozenset) else repr(of)
                 for of in code.co_consts]
    return repr((code.co_code, code.co_names, constants))


def _without(groups: Mapping[_Group, Maps], block: int) -> dict[_Group, Maps]:
    """Return maps without one block of rays."""
    return {group: {name: of.without(block) for name, of in maps.items()} for group, maps in groups.items()}
