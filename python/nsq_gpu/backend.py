"""The third interpreter of Optiland's NSQ scenes, beside NumpyBackend and TorchBackend."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential import NSQScene
from optiland.nonsequential._utils import DEFAULT_BATCH_SIZE
from optiland.nonsequential.backends.base import TracerBackend

from nsq_gpu.arguments import PRECISIONS, SAMPLERS, filter_of, flag, of_an_instance, wrong_kind
from nsq_gpu.binary import find_binary
from nsq_gpu.color import ColorOf, checked, colored
from nsq_gpu.edges import shape_of, warn_of_edges
from nsq_gpu.errors import (
    TOLERANCE_NOT_MET,
    NsqGpuError,
    ResultWarning,
    SceneError,
    TraceTimeoutError,
    UsageError,
    error_of,
    warn,
    with_partial,
)
from nsq_gpu.export import ExportedScene, export, export_wanted, to_json
from nsq_gpu.export.values import all_want_gradients, whole_number
from nsq_gpu.gradients import warn_of_lost
from nsq_gpu.integrity import read_report
from nsq_gpu.process import run
from nsq_gpu.progress import Progress, Shown
from nsq_gpu.results import Result, check_paths, fill_scene, in_folder, warn_of
from nsq_gpu.scattering import ScatterProb, ScatterTo, answering, keys_of, scattered, without
from nsq_gpu.session import EXPORTED, Answer, Session, shared_session

#: Most rays of a trace in the process's session; a longer one has a process of its own, which writes its rows to disk.
MOST_SESSION_RAYS = 1_000_000
_SEEDS = 1 << 64
#: Optiland's largest number of events of a ray, where nobody gives one.
OPTILANDS_DEPTH = 16
#: Options of a trace that its gradient does not take.
_FORWARDS_ALONE = ("standard_error", "record_paths", "paths", "guide", "photometric")


class NsqGpuBackend(TracerBackend):
    """Traces scenes on a GPU by the program ``nsq-gpu``.

    ``scene.trace(num_rays, backend=NsqGpuBackend())`` returns what Optiland's own backends return, and leaves live
    detectors and absorbers as they leave them. On failure the live scene stays as it was.

    Args:
        seed: Seed of the draws where ``trace`` is given none; None means 0, as in Optiland.
        precision: ``"f32"``, ``"f64"``, ``"df64"``, or ``"auto"``: f64 where the adapter runs it at a good rate.
        adapter: A part of the adapter's name; see ``nsq-gpu adapters``.
        binary: Path of the program; see :func:`nsq_gpu.find_binary` for where it is looked for otherwise.
        timeout: Longest time of a trace [s]; then it is ended and TraceTimeoutError raised.
        progress: True shows a bar, False none. None shows one after two seconds where tqdm is installed, in a terminal or a
            notebook. A function is called with the rays done, the rays in all, and the rays per second.
        target_error: Stop when every detector's relative error is at most this, 0.01 or "1%". Two errors count. One
            is the flux's. The other is the map's: the sum of the pixels' standard errors over the sum of
            their values. The rays given to ``trace`` are then the most. ToleranceWarning says where it was not met.
        standard_error: True sums second moments, so that results have standard errors, False does not; None does where
            it costs little, where hits say nothing of the error, or where ``target_error`` needs them. With Sobol points,
            True scrambles them in 16 independent ways and gives the errors between these, and None gives none.
        time_limit: Stop after so long [s], and return what was reached; unlike ``timeout``, which gives nothing.
        sampler: ``"pcg"``, Optiland's random numbers, or ``"sobol"``, Owen-scrambled Sobol points, with which errors
            fall faster, but rays are not the ones of Optiland's backends.
        max_depth: Largest number of events of a ray, instead of the one given to ``trace``, which is 16 where the caller
            gives none; ResultWarning says where that takes light, and what to give.
        paths: True sums up light by its path, from its source to a detector. ``result.paths`` is then a
            :class:`nsq_gpu.PathTable`, a structured array with the strongest path first; it is None otherwise.
        gradient: With Optiland's backend set to torch, results carry a graph to tensors of the scene that have
            ``requires_grad``, where TorchBackend's do; ``backward()`` walks rays back. ``"interior"`` is the derivative of light
            that goes on through the surfaces that it meets. None takes such tensors as values, as ``torch.no_grad()`` does.
            With ``be.grad_mode`` on, where every constant is such a tensor, ResultWarning names each that has no derivative,
            once.
        backward_seed: Seed of the draws of ``backward``; None takes the trace's draws. Other draws make the gradient of a
            loss that is not linear in the map unbiased.
        check_edges: ``backward`` compares a gradient with a short difference of two traces, once for scenes of one shape, and
            ResultWarning says where they disagree by more than 3 standard errors: light crosses edges there. False does not.
        where: Keep only the light whose path matches this expression, such as ``"reflections == 2 and not
            hit(mount)"``. Detectors then hold this light alone. The ledger is of all light, with a line
            ``filtered_out``.
        guide: True guides rays to rare light, such as the ghosts of coated lenses and what faint scatterers send: to the light of
            ``where``, or else of all detectors. A pilot learns how, and weights make up for it: all sums stay right on average.
            Where nobody asks for more than 16 events, a ray has 4 for each face. Gradients take plain rays.
        photometric: True says results in lumens, lux and candela as well, for any spectrum, and False does not. None does where
            a source says its flux in lumens, or its intensity in candela. Watts are the same. Pixels then take memory for each
            wavelength.
        color: True gives irradiance and far-field detectors colour, and a list of names those: ``xyz`` with errors, and
            ``chromaticity()``. Results are then photometric. None leaves it to the scene's own ``color``.
        scatter_prob: With this probability rays scatter where a share of the light does; or probabilities by the surface's
            name, such as ``{"M1*": 0.5}``, in which ``*`` stands for any characters. Weights make up for it. None leaves it to
            the scene's own ``scatter_prob``.
        scatter_to: Towards what a share of the scattered rays goes: ``{"M1*": "image"}``, or a list of entries of ``surface``,
            ``target`` and ``share`` (0.5), as scene files have them. A target is a detector, a surface, or one shape: a sphere, a
            disk or a cone. Weights make up for it. None leaves it to the scene's own ``scatter_to``. Gradients take plain rays.

    Raises:
        UsageError: There is no such precision or sampler. A trace raises it where ``where`` makes no sense in the scene.
    """

    def __init__(self, seed: int | None = None, precision: str = "auto", adapter: str | None = None,
                 binary: str | os.PathLike[str] | None = None, timeout: float | None = None,
                 progress: Progress = None, target_error: float | str | None = None,
                 time_limit: float | None = None, standard_error: bool | None = None,
                 sampler: str = "pcg", max_depth: int | None = None, paths: bool = False,
                 where: str | None = None, gradient: str | None = "interior", backward_seed: int | None = None,
                 check_edges: bool = True, guide: bool = False, photometric: bool | None = None,
                 scatter_prob: ScatterProb = None, scatter_to: ScatterTo = None, color: ColorOf = None) -> None:
        for name, given, known in (("precision", precision, PRECISIONS), ("sampler", sampler, SAMPLERS)):
            if given not in known:
                raise UsageError(f"{name} is {given!r}; give one of {', '.join(known)}")
        if isinstance(seed, str | type):
            raise wrong_kind("seed", seed, "give a whole number")
        for name, switch in (("standard_error", standard_error), ("photometric", photometric)):
            if switch not in (None, True, False):
                raise UsageError(f"{name} is {switch!r}; give True, False or None")
        self.seed = seed
        self.precision = precision
        self.adapter = adapter
        self.binary = binary
        self.timeout = timeout
        self.progress = progress
        self.target_error = target_error
        self.time_limit = time_limit
        self.standard_error = standard_error
        self.sampler = sampler
        self.max_depth = max_depth
        self.paths = flag("paths", paths)
        self.where = filter_of(where)
        self.guide = flag("guide", guide)
        self.photometric = photometric
        self.color = checked(color, photometric)
        self.scatter_prob = scatter_prob
        self.scatter_to = scatter_to
        keys_of(scatter_prob, scatter_to)
        if gradient not in ("interior", None):
            raise UsageError(f"gradient is {gradient!r}; give 'interior' or None")
        self.gradient = gradient
        self.backward_seed = backward_seed
        self.check_edges = flag("check_edges", check_edges)
        #: The program's own report of the last trace: its ledger, adapter, precision and more; see the README.
        self.report: dict[str, Any] | None = None
        #: Numbers without a derivative that a warning has named.
        self._told: set[str] = set()

    @of_an_instance
    def trace(self, scene: NSQScene, num_rays: int, max_depth: int = 16, min_flux_fraction: float = 1e-6,
              batch_size: int = DEFAULT_BATCH_SIZE, seed: int | None = None,
              record_paths: bool | int = False) -> Result:
        """Trace a scene.

        Args:
            scene: The live scene.
            num_rays: Rays to launch.
            max_depth: Largest number of events of a ray, unless the backend has one.
            min_flux_fraction: Roulette threshold, as a fraction of the mean flux of a new ray; the larger of it and
                the scene's ``rr_start_flux`` counts.
            batch_size: Ignored: Optiland's suits a CPU, results do not depend on it, and the program sizes its own
                batches for the adapter.
            seed: Seed of the draws, instead of the backend's.
            record_paths: True records the paths of all rays, a number the paths of about so many.

        Raises:
            NsqGpuError: One of its subclasses, by what went wrong.
            Interrupted: Ctrl-C ended the trace. ``partial`` is the result of the rays that were traced, and the live
                detectors hold it too. So it is with TraceTimeoutError.
        """
        binary = find_binary(self.binary)
        exported = export_wanted(scene) if self._differentiates() else export(scene)
        keys = keys_of(self.scatter_prob, self.scatter_to)
        with answering(keys):
            exported = colored(scattered(exported, keys), self.color)
            return self._trace(binary, scene, exported, num_rays, max_depth, min_flux_fraction, seed, record_paths)

    def _trace(self, binary: str, scene: NSQScene, exported: ExportedScene, num_rays: int, max_depth: int, min_flux_fraction: float,
               seed: int | None, record_paths: bool | int) -> Result:
        """Trace what was exported of a scene."""
        if record_paths:
            check_paths(scene, exported.surface_labels)
        options = self._options(num_rays, max_depth, min_flux_fraction, seed, record_paths)
        carries_graph = bool(exported.wanted) and _go_with_gradients(options)
        if carries_graph or options["num_rays"] <= MOST_SESSION_RAYS:
            return self._trace_in_session(binary, scene, exported, options, carries_graph)
        text = to_json(exported.document, indent=None)
        with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name:
            folder = Path(name)
            has_result = (folder / "out" / "report.json").exists

            def result_of(not_met: str | None, partial: bool) -> Result:
                self.report = read_report(folder / "out")
                warn_of(self.report, not_met)
                load = in_folder(folder / "out", self.report)
                return fill_scene(scene, self.report, load, exported.surface_labels, bool(record_paths), partial=partial,
                                  text=text)

            try:
                not_met = self._run(binary, text, options, folder)
            except (KeyboardInterrupt, TraceTimeoutError) as stop:
                raise with_partial(stop, result_of(None, partial=True) if has_result() else None)
            if not has_result():
                raise NsqGpuError(f"{binary} ended without an error, and without a result: is it nsq-gpu?")
            return result_of(not_met, partial=False)

    def _differentiates(self) -> bool:
        """Return whether tensors of the scene are to get gradients."""
        if self.gradient is None or be.get_backend() != "torch":
            return False
        import torch

        return torch.is_grad_enabled()

    def _options(self, num_rays: int, max_depth: int, min_flux_fraction: float, seed: int | None,
                 record_paths: bool | int) -> dict[str, Any]:
        """Return options of the command, by their names."""
        seed = seed if seed is not None else self.seed
        max_depth = max_depth if self.max_depth is None else self.max_depth
        options = {
            "num_rays": whole_number("num_rays", num_rays),
            # Optiland keys its draws by the seed modulo 2^64.
            "seed": whole_number("seed", seed or 0) % _SEEDS,
            "max_depth": whole_number("max_depth", max_depth),
            "min_flux_fraction": float(min_flux_fraction),
            "precision": self.precision,
            "sampler": self.sampler,
        }
        if self.target_error is not None:
            target = self.target_error
            options["target_error"] = target if isinstance(target, str) else float(target)
        if self.standard_error is not None:
            options["standard_error"] = "on" if self.standard_error else "off"
        if self.photometric is not None:
            options["photometric"] = "on" if self.photometric else "off"
        if self.time_limit is not None:
            options["time_limit"] = f"{float(self.time_limit)}s"
        if self.paths:
            options["paths"] = "on"
        if self.where is not None:
            options["where"] = self.where
        if self.guide:
            options["guide"] = "on"
            if self.max_depth is None and max_depth == OPTILANDS_DEPTH:
                # Ghosts pass a lens three times: the program knows how deep that is.
                del options["max_depth"]
        if record_paths:
            options["record_paths"] = "all" if record_paths is True else whole_number("record_paths", record_paths)
        return options

    def _trace_in_session(self, binary: str, scene: NSQScene, exported: ExportedScene, options: dict[str, Any],
                          carries_graph: bool) -> Result:
        """Trace in this process's session."""
        session = shared_session(binary, self.adapter)
        text = to_json(exported.document, indent=None)

        def result_of(answer: Answer, partial: bool) -> Result:
            self.report = answer.report
            warn_of(answer.report, answer.missed_target)
            # The gradient would be of all rays.
            attach = self._attach(session, scene, without(exported), options) if carries_graph and not partial else None
            return fill_scene(scene, answer.report, answer.arrays, exported.surface_labels, "record_paths" in options, attach,
                              partial, text)

        with Shown(self.progress) as shown:
            return session.kept(text, options, result_of, timeout=self.timeout, progress=shown.of_json, name=EXPORTED)

    def _attach(self, session: Session, scene: NSQScene, exported: ExportedScene, options: dict[str, Any]) -> Callable[[], None]:
        """Return what puts the scene's maps on the graph of its tensors."""
        from nsq_gpu.autograd import Traced, attach, smooth_detectors

        text = to_json(exported.document, indent=None)
        options = {name: value for name, value in options.items() if name not in _FORWARDS_ALONE}
        if self.backward_seed is not None:
            options["seed"] = whole_number("backward_seed", self.backward_seed) % _SEEDS
        are_named = not all_want_gradients()

        def gradient(adjoints: dict[str, np.ndarray]) -> list[float]:
            values = dict.fromkeys(exported.wanted, 0.0)
            names = list(values)
            while names:
                shape = shape_of(exported.document, options, names)
                is_due = self.check_edges and shape not in session.checked_shapes
                try:
                    with Shown(self.progress) as shown:
                        answer = session.loss_gradient(text, options, names, adjoints, timeout=self.timeout, name=EXPORTED,
                                                       check_edges=is_due, progress=shown.of_json)
                    break
                except UsageError as error:
                    # The program refuses one number at a time.
                    refused = next((name for name in names if f"`{name}`" in str(error)), None)
                    if are_named or refused is None:
                        raise
                    names.remove(refused)
                    if refused not in self._told:
                        self._told.add(refused)
                        warn(f"{error}; its gradient is 0", ResultWarning)
            else:
                return list(values.values())
            warn_of_lost(answer["num_lost"])
            if is_due:
                session.checked_shapes.add(shape)
                warn_of_edges(answer["not_confirmed"])
            return list((values | dict(zip(names, answer["values"], strict=True))).values())

        traced = Traced(gradient, smooth_detectors(scene))
        return lambda: attach(scene, traced, list(exported.wanted.values()))

    def _run(self, binary: str, text: str, options: dict[str, Any], folder: Path) -> str | None:
        """Trace into ``folder / "out"``; return what is said where the target error was not met."""
        scene_file = folder / "scene.json"
        scene_file.write_text(text, encoding="utf-8")
        # Nobody looks at pictures of a folder that is about to go; and the child ends when stdin closes with us.
        arguments = [f"--{name.replace('_', '-')}={value}" for name, value in options.items()]
        if self.adapter is not None:
            arguments.append(f"--adapter={self.adapter}")
        try:
            with Shown(self.progress) as shown:
                command = [binary, "trace", str(scene_file), *arguments, f"--progress={shown.mode}",
                           f"--output={folder / 'out'}", "--no-pictures", "--watch-stdin"]
                code, said = run(command, self.timeout, shown, accepted=(0, TOLERANCE_NOT_MET), keeps=True)
        except SceneError as error:
            # The file is ours, and gone when the message is read.
            raise SceneError(str(error).replace(f"{scene_file}: ", "the exported scene: "), stderr=error.stderr) from None
        return str(error_of(code, said.splitlines()[-1])) if code == TOLERANCE_NOT_MET else None


def _go_with_gradients(options: dict[str, Any]) -> bool:
    """Return whether results of these options can carry a graph; say so where they cannot.

    Raises:
        UsageError: They cannot, and somebody named the tensors that want gradients.
    """
    name = next((name for name in ("target_error", "time_limit") if name in options), None)
    if name is None and options["sampler"] == "pcg":
        return True
    problem = 'gradients take random numbers; leave out sampler="sobol"' if name is None \
        else f"{name} and gradients do not go together; give one of them up"
    if not all_want_gradients():
        raise UsageError(problem)
    warn(f"{problem}: results carry no graph", ResultWarning)
    return False
