"""Operands of Optiland's optimisers: what a lens's scene sees, beside spot sizes.

>>> nsq_gpu.register_operands()
>>> problem.add_operand("nsq_ghost_peak", target=0, weight=1e3, input_data={"optic": lens, "fields": [1], "kernel": 0.5})
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.optic import Optic

from nsq_gpu.arguments import PRECISIONS, flag, near, wrong_kind
from nsq_gpu.binary import find_binary
from nsq_gpu.convert import from_optic
from nsq_gpu.design import checking
from nsq_gpu.design.log import Log
from nsq_gpu.design.maps import FEWEST_BLOCKS, BlockMaps, Estimate, Maps, jackknife
from nsq_gpu.design.objectives import GHOSTS, Flux, Objective, Peak, RmsRadius, Uniformity
from nsq_gpu.design.steps import LONG, TINY, along, step_between
from nsq_gpu.design.tracing import Asked, Json, Tracer
from nsq_gpu.errors import NsqGpuError, SceneError, UsageError
from nsq_gpu.export import ExportedScene, export, export_wanted, to_json
from nsq_gpu.session import shared_session

#: Width of the kernel of a peak over the image's longer side, where nobody says it.
_KERNEL = 1.0 / 50.0
#: Scenes of an optic that are remembered, so that tiny steps from them are known.
_MOST_BASES = 8
#: A change of a lens, over scales, after which the size of its image is looked at again.
_LARGE = 0.1
#: Input data that all operands take, with what counts where one is missing.
_COMMON: dict[str, Any] = {
    "optic": None, "detector": "image", "where": None, "fields": None, "num_rays": 40_000, "seed": 0, "blocks": 16, "guide": None,
    "max_depth": None, "precision": "auto", "adapter": None, "binary": None, "detector_pixels": (128, 128), "detector_size": None,
    "edges": "absorbing", "margin": 1.03,
}
_OF_REGION: dict[str, Any] = {"region": None, "circle": None}


@dataclass(frozen=True)
class _Kind:
    """A kind of operand."""

    objective: Callable[..., Objective]
    #: Input data of its own.
    own: dict[str, Any]
    is_of_ghosts: bool = False


KINDS = {
    "nsq_flux": _Kind(Flux, _OF_REGION),
    "nsq_ghost_flux": _Kind(Flux, _OF_REGION, True),
    "nsq_ghost_peak": _Kind(Peak, {**_OF_REGION, "kernel": None, "order": 8}, True),
    "nsq_uniformity": _Kind(Uniformity, {**_OF_REGION, "kernel": None}),
    "nsq_rms_radius": _Kind(RmsRadius, {}),
}


@dataclass
class _Frozen:
    """What stays of an optic while its numbers change."""

    #: Width and height of the image [mm].
    size: tuple[float, float] | None = None
    #: Operands whose value was known once, by their names and input data.
    worked: set[str] = field(default_factory=set)
    #: Precision that the program took at first, where it was to choose.
    precision: str | None = None
    #: The scenes that it was last, but for tiny steps, by how they were made.
    bases: dict[str, list[Json]] = field(default_factory=dict)
    #: Files of its guides, by what they are of.
    guides: dict[str, str] = field(default_factory=dict)
    #: The scene whose image was last found to fit the size that is kept, and whether the log says that one does not.
    fitting: Json | None = None
    is_said_to_be_too_small: bool = False
    #: Gradients that were checked for light that crosses edges; :mod:`nsq_gpu.design.torch_graph` has them.
    checked: dict[str, Any] = field(default_factory=dict)


@dataclass
class _State:
    """What all operands of this process share."""

    log: Log = field(default_factory=Log)
    tracers: dict[tuple[str, str | None], Tracer] = field(default_factory=dict)
    optics: weakref.WeakKeyDictionary[Any, _Frozen] = field(default_factory=weakref.WeakKeyDictionary)
    #: The last scene of each optic, by what it was made of.
    scenes: dict[Any, Any] = field(default_factory=dict)


_state = _State()


@checking.by_names
def register_operands() -> Log:
    """Register operands of scenes in ``optiland.optimization``, beside Optiland's own; return their log.

    An operand makes the scene of its optic by :func:`nsq_gpu.from_optic`, and traces each field with a fixed seed. Operands of the
    same light share one trace. Each trace is 16 blocks of rays; noise adds nothing to squares and higher powers of a map, which are
    products of different blocks.

    ===================  ==================================================================================================
    ``nsq_flux``         flux in the image, or in ``region`` or ``circle`` [W]
    ``nsq_ghost_flux``   flux of ghosts: light that was reflected at least twice [W]; rays are guided towards it
    ``nsq_ghost_peak``   the brightest place of ghosts after a Gaussian of the width ``kernel`` [mm]: the sum of E^p over the sum
                         of E^(p-1), with p = ``order`` [W/mm^2]
    ``nsq_uniformity``   the square of the mean irradiance over the mean of its square; 1 is even
    ``nsq_rms_radius``   root mean square distance from the centroid of each field, over the fields [mm]
    ===================  ==================================================================================================

    Input data: ``optic``; ``detector`` ("image"); ``where`` keeps the light whose path matches; ``fields``, a list of the numbers of
    fields, all of them if None; ``num_rays`` of each field (40,000); ``seed`` (0). Beside these ``blocks``, ``guide``, ``max_depth``,
    ``precision``, ``adapter``, ``binary``, and the options of :func:`nsq_gpu.from_optic`. The size of the image stays as in
    the first trace.

    Where a lens cannot be traced on the way, the value is NaN, which Optiland takes for a bad lens, and the log says why. The first
    trace of an operand raises instead.

    With Torch, rays are walked back from operands of plain light. Operands of guided light have differences by common draws, two
    traces for each variable, and the log says so. Sizes that from_optic finds from rays count as constants there.

    >>> log = nsq_gpu.register_operands()
    >>> problem.add_operand("nsq_ghost_flux", target=0, weight=100, input_data={"optic": lens, "fields": [0]})

    Returns:
        Notes of what was done: guides that were learned, lenses that could not be traced, differences in the place of gradients.
    """
    # Optiland's optimisers bring SciPy, and Torch where it is installed.
    from optiland.optimization.operand.operand import operand_registry

    for name in KINDS:
        operand_registry.register(name, _operand(name), overwrite=True)
    return _state.log


@checking.by_names
def operand_estimate(operand: str, **input_data: Any) -> Estimate:
    """Return the value of an operand with its standard error and its bias.

    >>> nsq_gpu.design.operand_estimate("nsq_ghost_flux", optic=lens, fields=[0])

    Args:
        operand: Name of the operand, such as ``"nsq_flux"``.
        input_data: Its input data; :func:`nsq_gpu.register_operands` says which.

    Raises:
        UsageError: There is no such operand, or it takes no such data.
    """
    checking.one_of("operand", operand, list(KINDS))
    return _Evaluation(operand, input_data).estimate()


@checking.by_names
def renew(optic: Any) -> None:
    """Forget what is kept of an optic: the size of its image, its guides and its precision. The next trace finds them anew.

    >>> nsq_gpu.design.renew(lens)

    Values before and after are of different functions. An optimiser that is running must not see both.
    """
    if not isinstance(optic, Optic):
        raise wrong_kind("optic", optic, "give Optiland's Optic")
    _state.optics.pop(optic, None)
    for key in [key for key in _state.scenes if key[0] == id(optic)]:
        del _state.scenes[key]
    _state.log.note("restart: an optic's image size, guides and precision are found anew")


def _operand(name: str) -> Callable[..., Any]:
    def operand(**input_data: Any) -> Any:
        evaluation = _Evaluation(name, input_data)
        frozen = _state.optics.setdefault(evaluation.given["optic"], _Frozen())
        try:
            found = evaluation.value()
            if not np.isfinite(float(found)):
                raise SceneError(f"{name}: it has no value, because too little light comes to {evaluation.given['detector']}")
        except UsageError:
            raise
        except (SceneError, ArithmeticError) as error:
            if evaluation.own not in frozen.worked:
                raise
            _state.log.note_once(f"{name}: a lens cannot be judged, and its value is NaN: {error}")
            return be.array(float("nan"))
        frozen.worked.add(evaluation.own)
        return found

    operand.__name__ = name
    operand.__doc__ = f"{name}: see nsq_gpu.register_operands."
    return operand


class _Evaluation:
    """An operand's value for an optic as it is now."""

    def __init__(self, name: str, input_data: dict[str, Any]) -> None:
        self.name, self.kind = name, KINDS[name]
        known = {**_COMMON, **self.kind.own}
        for word in input_data:
            if word not in known:
                raise UsageError(f"{name} takes no {word!r}; {near(word, known)}")
        self.given = {**known, **input_data}
        if not isinstance(self.given["optic"], Optic):
            raise wrong_kind(f"{name}: optic", self.given["optic"], "give Optiland's Optic as input_data={'optic': lens}")
        #: What the number is of, as far as the input data say it: the scene is not known yet.
        self._wanted = self._take()
        self._depth, self._made = 16, ""
        program = find_binary(self.given["binary"])
        key = (program, self.given["adapter"])
        if key not in _state.tracers:
            _state.tracers[key] = Tracer(shared_session(program, self.given["adapter"]), program)
        self._tracer = _state.tracers[key]

    def _take(self) -> Objective:
        """Take the input data, or refuse them; return their objective."""
        name, given = self.name, self.given
        own = {key: given[key] for key in self.kind.own}
        if self.kind.is_of_ghosts:
            given["guide"] = True if given["guide"] is None else given["guide"]
            if "kernel" in own and own["kernel"] is None:
                # The scene says which one.
                own["kernel"] = 1.0
        given["guide"] = given["guide"] is not None and flag(f"{name}: guide", given["guide"])
        shared = {key: given[key] for key in ("detector", "where", "guide")}
        objective = self.kind.objective(target=0.0, name=name, **shared, **own)
        given.update({key: getattr(objective, key) for key in own if given[key] is not None})
        given["blocks"] = checking.whole(f"{name}: blocks", given["blocks"], max(objective.fewest_blocks, FEWEST_BLOCKS))
        given["num_rays"] = checking.rays_of(f"{name}: num_rays", given["num_rays"], given["blocks"])
        given["seed"] = checking.seed_of(f"{name}: seed", given["seed"])
        checking.one_of(f"{name}: precision", given["precision"], PRECISIONS)
        pixels = "2 whole numbers of 1 or more, such as (128, 128)"
        given["detector_pixels"] = tuple(checking.wholes(f"{name}: detector_pixels", given["detector_pixels"], 2, pixels, 1))
        given["margin"] = checking.number(f"{name}: margin", given["margin"], "a number of 1 or more", least=1.0)
        for key, check in _OR_NONE.items():
            if given[key] is not None:
                given[key] = check(f"{name}: {key}", given[key])
        return objective

    def value(self) -> Any:
        """Return the value, with Torch a tensor that may carry a graph."""
        scene, exported = self._scene()
        fields = self._fields(scene)
        objective = self._objective(scene)
        self._note_of_size(plain(exported.document))
        if be.get_backend() == "torch":
            from nsq_gpu.design.torch_graph import operand_on_graph

            return operand_on_graph(self, exported, fields, objective)
        return be.array(self.number(exported.document, fields, objective))

    def _note_of_size(self, document: Json) -> None:
        """Note where a lens has changed so much that its image would be larger by half than the one that is kept."""
        frozen = _state.optics[self.given["optic"]]
        if frozen.size is None or self.given["detector_size"] is not None or frozen.is_said_to_be_too_small:
            return
        change = np.inf if frozen.fitting is None else step_between(frozen.fitting, document)
        if frozen.fitting is not None and change is not None and change < _LARGE:
            return
        if frozen.fitting is not None:
            options = {key: self.given[key] for key in ("detector_pixels", "edges", "margin")}
            try:
                with _one_path(self.given["optic"]):
                    live = from_optic(self.given["optic"], **options).detectors[0]
                size = float(live.width), float(live.height)
            except (NsqGpuError, ValueError, ArithmeticError):
                return
            if max(size[0] / frozen.size[0], size[1] / frozen.size[1]) > 1.5:
                frozen.is_said_to_be_too_small = True
                _state.log.note(f"{self.name}: the image keeps its first size, {frozen.size[0]:.4g} x {frozen.size[1]:.4g} mm, and the "
                                f"lens as it is now would have {size[0]:.4g} x {size[1]:.4g} mm; light beside it does not count. "
                                "nsq_gpu.design.renew(optic) finds the size anew, detector_size=(width, height) gives it")
        frozen.fitting = document

    def number(self, document: Json, fields: Sequence[str], objective: Objective) -> float:
        """Return the value of a scene. Tiny steps from the last scene are steps of differences, and are made longer."""
        bases = _state.optics[self.given["optic"]].bases.setdefault(self._made, [])
        steps = [(step, base) for base in bases if (step := step_between(base, document)) is not None and step < TINY]
        step, base = min(steps, key=lambda found: found[0], default=(0.0, document))
        if step == 0.0:
            if not steps:
                bases[:-_MOST_BASES] = []
                bases.append(document)
            return self.of(objective, self._maps(document, fields, objective))
        _state.log.note_once(f"{self.name}: the optimiser takes differences over tiny steps; each is one of two traces by common draws, "
                             f"{100.0 * LONG:g} % on either side")
        here, share = self.of(objective, self._maps(base, fields, objective)), LONG / step
        ends = [(place, value) for place in (-share, share) if (value := self._end(base, document, place, fields, objective)) is not None]
        if not ends:
            raise SceneError(f"{self.name}: the lens has no neighbours that can be traced")
        (first, one), (last, other) = (ends[0], ends[1]) if len(ends) > 1 else ((0.0, here), ends[0])
        return here + (other - one) / (last - first)

    def _end(self, base: Json, document: Json, share: float, fields: Sequence[str], objective: Objective) -> float | None:
        """Return the value at an end of a difference; None if it cannot be traced."""
        try:
            found = self.of(objective, self._maps(along(base, document, share), fields, objective))
        except SceneError:
            return None
        return found if np.isfinite(found) else None

    def estimate(self) -> Estimate:
        """Return the value with its errors."""
        scene, exported = self._scene()
        objective = self._objective(scene)
        maps = self._maps(exported.document, self._fields(scene), objective)
        others = [self.of(objective, [{key: of.without(block) for key, of in field.items()} for field in maps])
                  for block in range(self.given["blocks"])]
        return jackknife(self.of(objective, maps), np.array(others))

    def of(self, objective: Objective, maps: Sequence[Maps]) -> float:
        """Return the number of some fields' maps."""
        if isinstance(objective, RmsRadius):
            return float(np.sqrt(np.mean([objective.value(of_field)**2 for of_field in maps])))
        return objective.value(together(maps))

    def _scene(self) -> tuple[Any, ExportedScene]:
        """Return the scene of the optic. The image keeps the size of the first one."""
        given = self.given
        frozen = _state.optics.setdefault(given["optic"], _Frozen())
        found = self._scene_of(frozen)
        faces = sum(isinstance(live, RefractiveComponent) for live in found[0].surfaces)
        self._depth = max(16, 4 * faces)
        return found

    def _scene_of(self, frozen: _Frozen) -> tuple[Any, ExportedScene]:
        given = self.given
        size = given["detector_size"] or frozen.size
        options = {key: given[key] for key in ("detector_pixels", "edges", "margin")}
        self._made = str((given["detector_size"], options))
        # The scenes of one step are the same: lenses differ by their content.
        wants_graph = be.get_backend() == "torch"
        key = None if wants_graph else (id(given["optic"]), _content(given["optic"]), size, str(options))
        if key is not None and key in _state.scenes:
            return _state.scenes[key]  # type: ignore[no-any-return]
        try:
            with _one_path(given["optic"]):
                scene = from_optic(given["optic"], detector_size=size, **options)
        except ValueError as error:
            # Optiland's, of a lens through which no ray comes.
            raise SceneError(f"{self.name}: no scene can be made of the optic: {error}") from error
        if frozen.size is None and given["detector_size"] is None:
            live = scene.detectors[0]
            frozen.size = (float(live.width), float(live.height))
        found = scene, export_wanted(scene) if wants_graph and be.grad_mode.requires_grad else export(scene)
        if key is not None:
            while len(_state.scenes) > 7:
                _state.scenes.pop(next(iter(_state.scenes)))
            _state.scenes[key] = found
        return found

    def _fields(self, scene: Any) -> list[str]:
        """Return the names of the sources of the fields that are asked for."""
        fields, names = self.given["fields"], scene.source_names
        if fields is None:
            return list(names)
        if max(fields) >= len(names):
            wanted = f"a list of numbers of the optic's fields, 0 to {len(names) - 1}, or None"
            raise checking.refused(f"{self.name}: fields", fields, wanted)
        return [names[item] for item in fields]

    def _objective(self, scene: Any) -> Objective:
        given = self.given
        if given["detector"] not in scene.detector_names:
            known = near(given["detector"], scene.detector_names)
            raise UsageError(f"{self.name}: the scene has no detector {given['detector']!r}; {known}")
        found: dict[str, Any] = {}
        if self.kind.is_of_ghosts:
            found["where"] = ghosts_of(scene) if given["where"] is None else given["where"]
            if "kernel" in self.kind.own and given["kernel"] is None:
                found["kernel"] = max(float(scene.detectors[0].width), float(scene.detectors[0].height)) * _KERNEL
        return replace(self._wanted, **found)

    def asked(self, document: Json, objective: Objective, least_rays: int = 0) -> Asked:
        """Return how a field is traced, with ``least_rays`` or more."""
        given = self.given
        frozen = _state.optics.setdefault(given["optic"], _Frozen())
        depth = document["depth"] if given["max_depth"] is None else given["max_depth"]
        precision = frozen.precision if given["precision"] == "auto" and frozen.precision is not None else given["precision"]
        asked = Asked(max(given["num_rays"], least_rays), given["blocks"], given["seed"], depth, precision, objective.where)
        if not objective.guide:
            return asked
        file, is_new = self._tracer.guide(without_depth(document), objective.where, max_depth=asked.max_depth, seed=asked.seed,
                                             precision=asked.precision, known=frozen.guides)
        if is_new:
            source = document["sources"][0]["name"]
            _state.log.note(f"{self.name}: a guide was learned for {source}, and stays")
        return Asked(**{**asked.__dict__, "guide": file})

    def maps_of(self, document: Json, objective: Objective, numbers: dict[str, float] | None = None, least_rays: int = 0) -> Maps:
        """Return the maps of a field."""
        asked = self.asked(document, objective, least_rays)
        plain = without_depth(document)
        found = self._tracer.maps(to_json(plain, indent=None), asked, numbers, plain["detectors"])
        if asked.precision == "auto":
            _state.optics[self.given["optic"]].precision = self._tracer.frozen.get("precision")
        return found

    @property
    def checked(self) -> dict[str, Any]:
        """Return the gradients of the optic that were checked for light that crosses edges."""
        return _state.optics[self.given["optic"]].checked

    @property
    def own(self) -> str:
        """Return what parts this operand's gradients from the gradients of others of the optic."""
        return str((self.name, self._made, sorted((key, repr(value)) for key, value in self.given.items() if key != "optic")))

    @property
    def tracer(self) -> Tracer:
        """Return what traces."""
        return self._tracer

    @property
    def log(self) -> Log:
        """Return the log of all operands."""
        return _state.log

    def _maps(self, document: Json, fields: Sequence[str], objective: Objective) -> list[Maps]:
        return [self.maps_of(of_field, objective) for of_field in self.alone(document, fields)]

    def alone(self, document: Json, fields: Sequence[str]) -> list[Json]:
        """Return a scene for each field, with its light alone, and beside it the depth that ghosts of the scene need."""
        block = {key: value for key, value in document.get("nsq_gpu", {}).items() if key != "elements"}
        found = []
        for name in fields:
            sources = [source for source in document["sources"] if source["name"] == name]
            found.append({**document, "sources": sources, "nsq_gpu": block, "depth": self._depth})
        return found


#: How input data are taken that may be None.
_OR_NONE: dict[str, Callable[[str, Any], Any]] = {
    "fields": lambda name, value: checking.wholes(name, value, None, "a list of numbers of the optic's fields, such as [0, 2], or None", 0),
    "max_depth": checking.depth_of,
    "detector_size": lambda name, value: checking.numbers(
        name, value, 2, "a width and a height of more than 0 mm, such as (24.0, 36.0), or None", above=0.0),
    "binary": checking.path,
    "adapter": lambda name, value: checking.text(name, value, "a part of an adapter's name, or None"),
}


def plain(document: Any) -> Any:
    """Return a document whose numbers are plain ones."""
    if isinstance(document, dict):
        return {key: plain(value) for key, value in document.items()}
    if isinstance(document, list):
        return [plain(value) for value in document]
    return float(document) if isinstance(document, float) else document


def without_depth(document: Json) -> Json:
    """Return the document of a scene file."""
    return {key: value for key, value in document.items() if key != "depth"}


def together(maps: Sequence[Maps]) -> Maps:
    """Return the light of all fields together."""
    found: dict[str, BlockMaps] = dict(maps[0])
    for other in maps[1:]:
        found = {name: of.added(other[name]) for name, of in found.items()}
    return found


def ghosts_of(scene: Any) -> str:
    """Return which light is a ghost: reflected at least twice, once or more by a face that refracts, and not scattered."""
    labels = export(scene).surface_labels
    refracting = [label for label, live in zip(labels, scene.surfaces, strict=True) if isinstance(live, RefractiveComponent)]
    mirrors = [live for live in scene.surfaces if type(live).__name__.startswith("Reflect")]
    if not refracting:
        raise UsageError("no face of the optic refracts, and without one there are no ghosts; say by `where` which light is meant")
    if not mirrors:
        return GHOSTS
    by_faces = " or ".join(f'reflected("{label}")' for label in refracting)
    return f"{GHOSTS} and ({by_faces})"


@contextmanager
def _one_path(optic: Any) -> Iterator[None]:
    """Let Optiland unfold the optical axis once while a scene is made, in place of 200 times: half of the time goes there.

    Nothing moves meanwhile. With Torch, whose tensors depend on how they are computed, nothing is kept.
    """
    group: Any = getattr(optic, "surfaces", None)
    if be.get_backend() == "torch" or not hasattr(group, "build_paraxial_path"):
        yield
        return
    path = group.build_paraxial_path()
    vars(group)["build_paraxial_path"] = lambda: path
    try:
        yield
    finally:
        del vars(group)["build_paraxial_path"]


def _content(optic: Any) -> Any:
    """Return what parts an optic from what it was before, or a number that is never the same where it cannot be written."""
    try:
        return repr(optic.to_dict())
    except Exception:
        return object()
