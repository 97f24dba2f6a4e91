"""The loop of an optimisation: stages of one number of rays each, by SciPy's or Torch's optimisers."""

from __future__ import annotations

import contextlib
import inspect
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from nsq_gpu.arguments import flag, missing, near
from nsq_gpu.design import checking
from nsq_gpu.design.log import Log, Step
from nsq_gpu.design.objectives import merit
from nsq_gpu.design.problem import CHECKED_HERE
from nsq_gpu.display import Displayed, Summary, number
from nsq_gpu.errors import Interrupted, NsqGpuError, SceneError, UsageError, with_partial

if TYPE_CHECKING:
    from nsq_gpu.design.problem import Problem, Value

#: Methods of SciPy with gradients, and without.
_WITH_GRADIENTS = ("L-BFGS-B", "SLSQP", "TNC", "trust-constr")
_WITHOUT = ("Nelder-Mead", "Powell", "COBYLA", "differential_evolution")
#: Classes of ``torch.optim``.
_OF_TORCH = ("Adam", "AdamW", "SGD", "RMSprop", "Adagrad", "Adadelta", "Adamax", "NAdam", "RAdam")
METHODS = (*_WITH_GRADIENTS, *_WITHOUT, *_OF_TORCH)
#: Options of SciPy's methods.
_OPTIONS: dict[str, tuple[str, ...]] = {
    "L-BFGS-B": ("disp", "maxcor", "ftol", "gtol", "eps", "maxfun", "maxiter", "iprint", "maxls", "finite_diff_rel_step", "workers"),
    "SLSQP": ("disp", "ftol", "eps", "maxiter", "iprint", "finite_diff_rel_step", "workers"),
    "TNC": ("disp", "eps", "scale", "offset", "mesg_num", "maxCGit", "eta", "stepmx", "accuracy", "minfev", "ftol", "xtol", "gtol",
            "rescale", "finite_diff_rel_step", "maxfun", "workers"),
    "trust-constr": ("gtol", "xtol", "barrier_tol", "sparse_jacobian", "initial_tr_radius", "initial_constr_penalty",
                     "initial_barrier_parameter", "initial_barrier_tolerance", "factorization_method", "finite_diff_rel_step",
                     "maxiter", "verbose", "disp", "workers", "subproblem_maxiter"),
    "Nelder-Mead": ("disp", "maxiter", "maxfev", "return_all", "initial_simplex", "xatol", "fatol", "adaptive"),
    "Powell": ("disp", "xtol", "ftol", "maxiter", "maxfev", "direc", "return_all"),
    "COBYLA": ("rhobeg", "maxiter", "disp", "catol", "tol"),
    "differential_evolution": ("strategy", "maxiter", "popsize", "tol", "mutation", "recombination", "seed", "rng", "disp", "polish",
                               "init", "atol", "updating", "constraints", "integrality", "vectorized"),
}
#: Where a merit has fallen to this share within a stage, optimisers see it on a new scale.
_FALLEN = 0.1
#: Noise decides where the gradient is below so many of its standard errors.
_SIGMAS = 2.0
#: By how much more rays a design is judged on fresh draws.
_FRESH = 4
#: How much worse than the worst a design is that cannot be traced.
_REFUSED = 10.0


@dataclass(frozen=True, repr=False)
class Design(Displayed):
    """What an optimisation found: the best variables, and what is known of them."""

    #: Best values of the variables, by name. ``session.sweep(scene, {name: [value]}, n)`` traces them.
    numbers: dict[str, float]
    #: Their standard errors: how far noise may have moved the minimum. NaN where it is not known.
    standard_errors: dict[str, float]
    #: Merit and operands on the draws of the optimisation, which flatter the design.
    value: Value
    #: Merit and operands on draws that the optimisation has not seen, of four times the rays; None of a stopped one.
    fresh: Value | None
    #: Steps and notes.
    log: Log
    #: Why it ended.
    reason: str
    #: True if it was stopped.
    partial: bool = False

    @property
    def x(self) -> np.ndarray:
        """Return the variables as an array."""
        return np.array(list(self.numbers.values()))

    def plot(self, **options: Any) -> Any:
        """Draw the merit over the steps: :meth:`nsq_gpu.design.Log.plot`."""
        return self.log.plot(**options)

    def _summary(self) -> Summary:
        rows = [[name, number(value, 7), number(self.standard_errors[name], 2)] for name, value in self.numbers.items()]
        judged = self.value if self.fresh is None else self.fresh
        rows += [[name, number(found.value, 6), number(found.standard_error, 2)] for name, found in judged.operands.items()]
        rows.append(["merit", number(judged.value, 5), number(judged.standard_error, 2)])
        title = f"Design: {len(self.log)} steps, {'stopped: ' if self.partial else ''}{self.reason}"
        return Summary(title, ["", "value", "error"], rows)


class _Enough(Exception):
    """A stage, or all of the optimisation, is over."""

    def __init__(self, reason: str, *, is_end: bool) -> None:
        super().__init__(reason)
        self.reason = reason
        self.is_end = is_end


@dataclass
class _Run:
    """An optimisation on its way. Optimisers see variables as shares of their ranges, from 0 to 1."""

    problem: Problem
    log: Log
    log_file: str | os.PathLike[str] | None
    callback: Callable[[Any], Any] | None
    budget: float
    most_steps: int
    has_gradients: bool
    stage: int = 0
    #: Best place of the stage, and its merit.
    best: np.ndarray | None = None
    best_merit: float = np.inf
    worst: float = 0.0
    #: What optimisers see is the merit over this one: their tests of convergence are against 1.
    scale: float = 1.0
    #: Steps of the log before this run.
    steps_before: int = 0
    rays_before: int = 0
    seconds_before: float = 0.0
    started: float = 0.0

    @property
    def rays(self) -> int:
        return self.problem.rays_so_far + self.rays_before

    def x_of(self, u: np.ndarray) -> np.ndarray:
        low, high = self.problem.bounds.T
        return np.asarray(low + np.clip(u, 0.0, 1.0) * (high - low))

    def merit(self, u: np.ndarray) -> float:
        """Return the merit, and remember the best place. A scene that cannot be traced is worse than all others."""
        if self.rays > self.budget:
            raise _Enough(f"the budget of {self.budget:,.0f} rays is spent", is_end=True)
        x = self.x_of(u)
        try:
            found = self._merit_at(x)
        except SceneError as error:
            if self.best is None:
                raise
            self._note_refused(error)
            return self._refused(x)[0]
        if not np.isfinite(found):
            if self.best is None:
                raise UsageError("the merit has no value at the start, because too little light comes to a detector; begin elsewhere by "
                                 "x0, or give more rays")
            self.log.note_once("a design has no value, because too little light comes to a detector, and counts as a bad one")
            return self._refused(x)[0]
        self.worst = max(self.worst, found)
        if found < self.best_merit:
            self.best, self.best_merit = x, found
        return found

    def _note_refused(self, error: SceneError) -> None:
        self.log.note_once(f"a design cannot be traced, and counts as a bad one: {error}")

    def _refused(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the merit of a design without one, and its gradient by shares of ranges, which leads back to the best place."""
        away = self.problem.shares_of(x) - self.problem.shares_of(x if self.best is None else self.best)
        bad = _REFUSED * (self.worst or 1.0)
        return bad * (1.0 + float(away @ away)), 2.0 * bad * away

    def scaled(self, u: np.ndarray) -> float:
        """Return the merit as optimisers see it."""
        return self.merit(u) / self.scale

    def scaled_gradient(self, u: np.ndarray) -> np.ndarray:
        """Return the gradient of :meth:`scaled`."""
        return self.gradient(u) / self.scale

    def _merit_at(self, x: np.ndarray) -> float:
        problem = self.problem
        groups = problem._groups(problem._numbers(x))
        return merit(problem.operands, problem._values(groups))

    def gradient(self, u: np.ndarray) -> np.ndarray:
        """Return the gradient by shares of ranges."""
        low, high = self.problem.bounds.T
        x = self.x_of(u)
        try:
            found = np.asarray(self.problem.gradient(x, errors=False).values * (high - low))
        except SceneError as error:
            self._note_refused(error)
            return self._refused(x)[1]
        return found if np.isfinite(found).all() else self._refused(x)[1]

    def step(self, u: np.ndarray) -> None:
        """Keep a step in the log; end the stage where noise decides, and the run where somebody wants it.

        Raises:
            _Enough: It is over.
        """
        problem, x = self.problem, self.x_of(u)
        try:
            found = problem.value(x)
        except SceneError as error:
            # An optimiser may stand for a while where nothing can be traced.
            self._note_refused(error)
            return
        if not np.isfinite(found.value):
            return
        self.log.steps.append(Step(len(self.log.steps), self.stage, x.tolist(), found.value, found.standard_error,
                                   [of.value for of in found.operands.values()], [of.standard_error for of in found.operands.values()],
                                   problem.num_rays, self.rays, self.seconds_before + time.monotonic() - self.started))
        self.save()
        if self.callback is not None and self.callback(self.log.steps[-1]):
            raise _Enough("the callback stopped it", is_end=True)
        if len(self.log.steps) - self.steps_before >= self.most_steps:
            raise _Enough(f"{self.most_steps} steps are done", is_end=True)
        if self.has_gradients and self._noise_decides(x):
            raise _Enough("noise decides: the gradient is within its errors", is_end=False)

    def _noise_decides(self, x: np.ndarray) -> bool:
        """Return whether the gradient, in all directions, is what noise makes of none."""
        try:
            found = self.problem.gradient(x)
        except SceneError as error:
            self._note_refused(error)
            return False
        free = [index for index in range(len(x)) if not self.problem._is_held(x, found.values, index)]
        return bool(free) and is_noise(found.values[free], found.influences[:, free])

    def save(self) -> None:
        if self.log_file is not None:
            self.log.save(self.log_file)


def is_noise(gradient: np.ndarray, influences: np.ndarray) -> bool:
    """Return whether noise can have made a gradient, by Hotelling's test: along a valley each component may be within its error, while
    all together are not.

    Of n components and K blocks the statistic is distributed as F with n and K - n degrees of freedom, about 1 where noise alone is. Where
    there are few blocks, half of the covariance is the one of independent components.
    """
    count, size = influences.shape
    apart = influences - influences.mean(axis=0)
    covariance = (count - 1) / count * apart.T @ apart
    if size > count / 2:
        covariance = 0.5 * covariance + 0.5 * np.diag(np.diag(covariance))
    scale = np.sqrt(np.diag(covariance))
    if not (scale > 0.0).all():
        return not gradient.any()
    statistic = float(gradient / scale @ np.linalg.lstsq(covariance / scale / scale[:, None], gradient / scale, rcond=None)[0])
    freedom = max((count - size) / (count - 1), 1.0 / (count - 1))
    return bool(statistic * freedom / size < _SIGMAS**2)


def minimize(problem: Problem, method: str, *, x0: Any, max_rays: int | None, budget: float | None, steps: int, growth: int,
             tolerance: float, errors: bool, callback: Callable[[Any], Any] | None, log_file: str | os.PathLike[str] | None,
             resume: Log | str | os.PathLike[str] | None, options: Mapping[str, Any]) -> Design:
    """Do what :meth:`nsq_gpu.Problem.minimize` says."""
    checking.one_of("method", method, METHODS)
    blocks = problem._plain.blocks
    most = 16 * problem.num_rays if max_rays is None else checking.rays_of("max_rays", max_rays, blocks) // blocks * blocks
    growth, steps = checking.whole("growth", growth, 2), checking.whole("steps", steps, 1)
    most_rays = np.inf if budget is None else checking.number("budget", budget, "a number of rays, more than 0, or None", above=0.0)
    tolerance = checking.number("tolerance", tolerance, "a number of 0 or more", least=0.0)
    errors = flag("errors", errors)
    if callback is not None:
        checking.function("callback", callback, "lambda step: step.merit < 1e-6, or None")
    if not isinstance(resume, Log | str | os.PathLike | None):
        raise checking.refused("resume", resume, "a log, its file, or None")
    _check_options(method, options)
    x = np.array(list(problem.numbers(problem.x0 if x0 is None else x0).values()))
    if log_file is not None:
        Log.check_file(log_file, resume)
    known = resume if resume is None or isinstance(resume, Log) else Log.load(resume)
    log = problem.log = problem._fresh_log()
    run = _Run(problem, log, log_file, callback, most_rays, steps, method not in _WITHOUT)
    num_rays = problem.num_rays
    try:
        if known is not None:
            x = _resumed(problem, run, known)
        low, high = problem.bounds.T
        beyond = [name for name, value, a, b in zip(problem.names, x, low, high, strict=True) if not a <= value <= b]
        if beyond:
            raise UsageError(f"x0 is beyond the bounds of {', '.join(beyond)}")
        return _run(run, method, x, most, growth, tolerance, errors, options)
    finally:
        problem.num_rays = num_rays


def _run(run: _Run, method: str, x: np.ndarray, most: int, growth: int, tolerance: float, errors: bool,
         options: Mapping[str, Any]) -> Design:
    """Run stage after stage from a place; return the design."""
    problem, log = run.problem, run.log
    log.settings.update(problem.settings())
    run.started = time.monotonic()
    run.rays_before -= problem.rays_so_far
    reason = ""
    try:
        while True:
            run.best, run.best_merit = None, np.inf
            try:
                reason = _stage(run, method, problem.shares_of(x), tolerance, options)
                is_end = False
            except _Enough as enough:
                reason, is_end = enough.reason, enough.is_end
            x = x if run.best is None else run.best
            if is_end:
                break
            if run.has_gradients and problem._choose(problem.numbers(x), CHECKED_HERE):
                run.stage += 1
                log.note(f"restart with other derivatives: {reason}, and light crosses edges here")
                continue
            if problem.num_rays >= most:
                break
            problem.num_rays = min(problem.num_rays * growth, most)
            run.stage += 1
            log.note(f"restart with {problem.num_rays:,} rays: {reason}")
        log.note(f"the end: {reason}")
        found = _design(run, x, reason, errors)
    except KeyboardInterrupt as stop:
        best = x if run.best is None else run.best
        log.note("interrupted; the best is kept")
        run.save()
        raise with_partial(stop if not isinstance(stop, Interrupted) else KeyboardInterrupt(), _stopped(run, best, "interrupted")) from None
    except NsqGpuError as error:
        best = x if run.best is None else run.best
        log.note(f"an error ended it: {error}")
        with contextlib.suppress(UsageError):
            run.save()
        raise with_partial(error, _stopped(run, best, f"an error ended it: {error}"))
    run.save()
    return found


def _check_options(method: str, options: Mapping[str, Any]) -> None:
    """Refuse options that are neither of :meth:`nsq_gpu.Problem.minimize` nor of the method, with what was meant."""
    own = [name for name in inspect.signature(minimize).parameters if name not in ("problem", "method", "log_file", "options")] + ["log"]
    known = _OPTIONS.get(method)
    if method in _OF_TORCH:
        try:
            import torch
        except ImportError as error:
            raise missing("Torch", "torch", f"method={method!r} needs") from error
        known = tuple(inspect.signature(getattr(torch.optim, method)).parameters)[1:]
    for name in options:
        if known is not None and name not in known:
            raise UsageError(f"{method} has no option {name!r}; {near(name, [*own, *known])}")


def _resumed(problem: Problem, run: _Run, known: Log) -> np.ndarray:
    """Take up the log of an optimisation that was stopped; return where it was best."""
    own = problem.settings()
    apart = [name for name, value in own.items() if known.settings.get(name) != value]
    if apart:
        raise UsageError(f"the log is of another problem: {', '.join(apart)} differ")
    if not known.steps:
        raise UsageError("the log has no steps; begin anew, without resume")
    last = known.steps[-1]
    best = min((step for step in known.steps if step.stage == last.stage), key=lambda step: step.merit)
    said = {note for _, note in known.notes}
    notes = [*known.notes, *((len(known.steps), note) for _, note in run.log.notes if note not in said)]
    run.log.steps[:], run.log.notes[:] = known.steps, notes
    run.steps_before = len(known.steps)
    problem.num_rays = last.num_rays
    run.stage, run.rays_before, run.seconds_before = last.stage, last.rays_so_far, last.seconds
    run.log.note(f"resumed from step {best.step}")
    return np.array(best.x)


def _stage(run: _Run, method: str, u: np.ndarray, tolerance: float, options: Mapping[str, Any]) -> str:
    """Run an optimiser to its end; return why it ended.

    SciPy's tests of convergence are against 1, so the merit is divided by the start's. Where it has fallen far, that is done
    again.
    """
    first = run.merit(u)
    if run.has_gradients:
        run.problem._choose(run.problem.numbers(run.x_of(u)), CHECKED_HERE)
    run.scale = first if first > 0.0 else 1.0
    if method in _OF_TORCH:
        return _by_torch(run, method, u, tolerance, options)
    run.step(u)
    while True:
        reason = _by_scipy(run, method, u, tolerance, options)
        if method not in _WITH_GRADIENTS or run.best is None or not 0.0 < run.best_merit < _FALLEN * run.scale:
            return reason
        u, run.scale = run.problem.shares_of(run.best), run.best_merit


def _by_scipy(run: _Run, method: str, u: np.ndarray, tolerance: float, options: Mapping[str, Any]) -> str:
    """Run an optimiser of SciPy."""
    try:
        from scipy import optimize
    except ImportError as error:
        raise missing("scipy", "test", f"method={method!r} needs") from error
    bounds = [(0.0, 1.0)] * len(u)
    if method == "differential_evolution":
        given = {"seed": run.problem.settings()["seed"], "polish": False, "tol": max(tolerance, 1e-3), **options}
        found = optimize.differential_evolution(run.scaled, bounds, x0=u, callback=lambda xk, convergence=None: run.step(np.asarray(xk)), **given)
        return str(found.message)
    more: dict[str, Any] = {"jac": run.scaled_gradient} if run.has_gradients else {}
    limits = {"maxiter": run.most_steps, **options}
    if method == "L-BFGS-B":
        limits = {"ftol": tolerance, "gtol": 0.0, **limits}
    given_tolerance = None if method == "L-BFGS-B" else tolerance
    if method in ("COBYLA", "TNC"):
        limits = {key: value for key, value in limits.items() if key != "maxiter" or method == "COBYLA"}

    def callback(u: Any, *more: Any) -> None:
        run.step(np.asarray(u, dtype=float))

    found = optimize.minimize(run.scaled, u, method=method, bounds=bounds, tol=given_tolerance, options=limits, callback=callback, **more)
    return f"{method}: {found.message}"


def _by_torch(run: _Run, method: str, u: np.ndarray, tolerance: float, options: Mapping[str, Any]) -> str:
    """Run an optimiser of Torch until ten steps in a row move no variable by more than the tolerance."""
    try:
        import torch
    except ImportError as error:
        raise missing("Torch", "torch", f"method={method!r} needs") from error
    share = torch.tensor(u, dtype=torch.float64, requires_grad=True)
    optimizer = getattr(torch.optim, method)([share], **{"lr": 0.02, **options})
    quiet = 0
    while quiet < 10:
        before = share.detach().clone()
        run.merit(before.numpy())
        share.grad = torch.as_tensor(run.scaled_gradient(before.numpy()))
        run.step(before.numpy())
        optimizer.step()
        with torch.no_grad():
            share.clamp_(0.0, 1.0)
        quiet = quiet + 1 if float((share.detach() - before).abs().max()) < tolerance else 0
    return f"{method}: variables no longer move"


def _design(run: _Run, x: np.ndarray, reason: str, errors: bool) -> Design:
    """Return the design, with its errors, and judged on draws that the optimisation has not seen."""
    problem = run.problem
    value = problem.value(x)
    spread = np.full(len(x), np.nan)
    if errors:
        try:
            spread = problem.spread(x)
        except SceneError as error:
            run.log.note(f"standard errors of the variables are not known, for designs beside the best cannot be traced: {error}")
    plain = problem._plain
    problem._plain = replace(plain, seed=plain.seed + 2**31, num_rays=_FRESH * plain.num_rays)
    try:
        fresh = problem.value(x)
    finally:
        problem._plain = plain
    return Design(problem.numbers(x), dict(zip(problem.names, spread.tolist(), strict=True)), value, fresh, run.log, reason)


def _stopped(run: _Run, x: np.ndarray, reason: str) -> Design | None:
    """Return the best design so far, without what would take more traces."""
    steps = [step for step in run.log.steps if step.stage == run.stage] or run.log.steps
    if not steps:
        return None
    from nsq_gpu.design.maps import Estimate
    from nsq_gpu.design.problem import Value

    at = min(steps, key=lambda step: step.merit)
    operands = {label: Estimate(value, error) for label, value, error in
                zip(run.problem.labels, at.values, at.standard_errors, strict=True)}
    value = Value(at.merit, at.standard_error, 0.0, operands, at.num_rays)
    unknown = dict.fromkeys(run.problem.names, float("nan"))
    return Design(run.problem.numbers(at.x), unknown, value, None, run.log, reason, True)
