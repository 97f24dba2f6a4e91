"""The table of paths, made in Python from the events that NumpyBackend records; and the filter, by Python's own grammar.

The records say which surfaces a ray met, but not what happened there. The law of reflection and Snell's law say that, with
the normal of Optiland's surface and the indices of its media: a ray was scattered where it leaves by neither.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest import mock

import numpy as np
from optiland.nonsequential import NSQScene
from optiland.nonsequential._utils import distribute_ray_budget
from optiland.nonsequential.backends.numpy_backend import NumpyBackend
from optiland.nonsequential.bsdf import SpecularBRDF
from optiland.nonsequential.components.base import BaseComponent
from optiland.nonsequential.components.refractive import RefractiveComponent
from optiland.nonsequential.ray_bundle import NSQRayBundle
from optiland.nonsequential.rng import EventSlot, NSQRng

from nsq_gpu.export import export
from tests import live

#: Largest distance of a direction from the one by the law.
LAW = 1e-9
#: Largest distance of a hit that is found again from the recorded one, in units of the extent of the records.
PLACE = 1e-9

Step = tuple[str, str]


@dataclass(frozen=True, order=True)
class Path:
    """What happened to a ray, from its source to a detector."""

    source: str
    steps: tuple[Step, ...]
    detector: str

    @property
    def text(self) -> str:
        return " > ".join([self.source, *(f"{letters} {name}" for letters, name in self.steps), self.detector])

    def count(self, *kinds: str) -> int:
        return sum(letters in kinds for letters, _ in self.steps)


@dataclass
class Sum:
    """The light of one path."""

    num_rays: int = 0
    flux: float = 0.0
    #: Flux by the ray that was launched.
    by_ray: dict[int, float] = field(default_factory=dict)

    def add(self, root: int, flux: float) -> None:
        self.num_rays += 1
        self.flux += flux
        self.by_ray[root] = self.by_ray.get(root, 0.0) + flux

    def standard_error(self, launched: int) -> float:
        """Return the standard error of the flux, of so many launched rays."""
        squares = math.fsum(flux**2 for flux in self.by_ray.values())
        return math.sqrt(max(squares - self.flux**2 / launched, 0.0) * launched / (launched - 1.0))


@dataclass
class Table:
    """The light of a scene by its path, and the rays that each source launched."""

    paths: dict[Path, Sum]
    launched: dict[str, int]

    def kept(self, keeps: Callable[[Path], bool]) -> Table:
        return dataclasses.replace(self, paths={path: found for path, found in self.paths.items() if keeps(path)})

    def flux(self, detector: str) -> float:
        return math.fsum(found.flux for path, found in self.paths.items() if path.detector == detector)

    def num_rays(self, detector: str) -> int:
        return sum(found.num_rays for path, found in self.paths.items() if path.detector == detector)

    def error(self, path: Path) -> float:
        return self.paths[path].standard_error(self.launched[path.source])


def numpy_table(scene: NSQScene, num_rays: int, seed: int = 0) -> Table:
    """Trace a scene with NumpyBackend, and sum up every deposit by its path."""
    labels = export(scene).surface_labels
    with _numbered(scene), _parents() as parents, live.quiet():
        result = scene.trace(num_rays, backend=NumpyBackend(seed=seed), seed=seed, record_paths=True)
        events = live.sorted_paths(result)
        chains = _chains(events, parents)
        kinds = _kinds_of_steps(scene, events, chains, seed)
    surfaces = [f"surface {index}" for index in range(len(labels))]
    names = dict(zip(surfaces, labels, strict=True))
    detectors = {f"detector {index}": name for index, name in enumerate(scene.detector_names)}
    sources = {f"source {index}": name for index, name in enumerate(scene.source_names)}
    met, ray_ids, flux = (events[key].tolist() for key in ("component_name", "ray_id", "flux"))
    paths: dict[Path, Sum] = {}
    for ray, (chain, first) in chains.items():
        source, root = sources[met[chain[0]]], ray_ids[chain[0]]
        steps: list[Step] = []
        for place, event in enumerate(chain[1:], 1):
            if met[event] in detectors and place >= first:
                path = Path(source, tuple(steps), detectors[met[event]])
                # Where a split ray is totally reflected, Optiland follows a transmitted branch of no flux.
                if flux[event] > 0.0 or all(letters for letters, _ in steps):
                    paths.setdefault(path, Sum()).add(root, flux[event])
            elif met[event] in names and place + 1 < len(chain):
                steps.append((kinds[event, chain[place + 1]], names[met[event]]))
        assert ray_ids[chain[-1]] == ray
    launched = distribute_ray_budget(num_rays, [float(source.total_flux) for source in scene.sources])
    return Table(paths, dict(zip(scene.source_names, launched, strict=True)))


@contextmanager
def _numbered(scene: NSQScene) -> Iterator[None]:
    """Name everything by its number: events know things by their names alone, and Optiland leaves some without any."""
    things = [(kind, index, thing) for kind, found in
              (("source", scene.sources), ("surface", scene.surfaces), ("detector", scene.detectors))
              for index, thing in enumerate(found)]
    before = [vars(thing).get("name") for _, _, thing in things]
    for kind, index, thing in things:
        thing.name = f"{kind} {index}"
    try:
        yield
    finally:
        for (_, _, thing), name in zip(things, before, strict=True):
            if name is None:
                del thing.name
            else:
                thing.name = name


@contextmanager
def _parents() -> Iterator[dict[int, tuple[int, int]]]:
    """Note of each ray that a split made its parent and the parent's event, which Optiland does not record."""
    parents: dict[int, tuple[int, int]] = {}
    plain = NSQRayBundle.select

    def select(self: NSQRayBundle, idx: np.ndarray, ray_id: np.ndarray | None = None) -> NSQRayBundle:
        if ray_id is not None:
            of = zip(self.ray_id[idx].tolist(), self.bounce[idx].tolist(), strict=True)
            parents.update(zip(ray_id.tolist(), of, strict=True))
        return plain(self, idx, ray_id)

    with mock.patch.object(NSQRayBundle, "select", select):
        yield parents


def _chains(events: np.ndarray, parents: dict[int, tuple[int, int]]) -> dict[int, tuple[list[int], int]]:
    """Return by ray the events from the birth of its ancestor on, and the place of the first one that is its own."""
    rays, starts = np.unique(events["ray_id"], return_index=True)
    ends = [*starts[1:].tolist(), len(events)]
    bounces, types = events["bounce"].tolist(), events["event_type"].tolist()
    chains: dict[int, tuple[list[int], int]] = {}
    # A child has a larger number than its parent.
    for ray, start, end in zip(rays.tolist(), starts.tolist(), ends, strict=True):
        before: list[int] = []
        if ray in parents:
            parent, bounce = parents[ray]
            before = [event for event in chains[parent][0] if types[event] == "birth"
                      or types[event] == "hit" and bounces[event] <= bounce]
        chain = [*before, *range(start, end)]
        assert types[chain[0]] == "birth"
        chains[ray] = chain, max(len(before), 1)
    return chains


def _kinds_of_steps(scene: NSQScene, events: np.ndarray, chains: dict[int, tuple[list[int], int]],
                    seed: int) -> dict[tuple[int, int], str]:
    """Return T, R, ST or SR by an event at a surface and the ray's next event."""
    triples = {(chain[place], chain[place + 1]): chain[place - 1]
               for chain, _ in chains.values() for place in range(1, len(chain) - 1)}
    found = np.array([(before, event, after) for (event, after), before in triples.items()], dtype=np.int64).reshape(-1, 3)
    kinds: dict[tuple[int, int], str] = {}
    for index, surface in enumerate(scene.surfaces):
        of_surface = found[events["component_name"][found[:, 1]] == f"surface {index}"]
        letters = _kinds_at(surface, *(events[column] for column in of_surface.T), seed)
        kinds.update({(event, after): kind for (_, event, after), kind in zip(of_surface.tolist(), letters, strict=True)})
    return kinds


def _kinds_at(surface: BaseComponent, before: np.ndarray, events: np.ndarray, after: np.ndarray, seed: int) -> list[str]:
    """Return what a surface did to rays: the events before it, at it and after it."""
    if len(events) == 0:
        return []
    ahead, out = _vectors(events, "LMN"), _vectors(after, "LMN")
    normal, across = _normals(surface, before, events)
    # The normal on the ray's side.
    facing = np.where((ahead * normal).sum(axis=1, keepdims=True) < 0.0, normal, -normal)
    cosine = -(ahead * facing).sum(axis=1)
    mirrored = ahead + 2.0 * cosine[:, None] * facing
    is_mirrored = np.linalg.norm(out - mirrored, axis=1) < LAW
    is_refracted = np.zeros_like(is_mirrored)
    if isinstance(surface, RefractiveComponent):
        front, back = (np.broadcast_to(medium.n(events["wavelength"]), cosine.shape)
                       for medium in (surface.material_front, surface.material_back))
        ratio = np.where(across > 0.0, front / back, back / front)
        radicand = 1.0 - ratio**2 * (1.0 - cosine**2)
        bent = ratio * cosine - np.sqrt(np.maximum(radicand, 0.0))
        refracted = ratio[:, None] * ahead + bent[:, None] * facing
        is_refracted = (np.linalg.norm(out - refracted, axis=1) < LAW) & (radicand > 0.0)
    scattered = ~(is_mirrored | is_refracted)
    if surface.bsdf is not None:
        fraction = float(np.clip(surface.scatter_fraction, 1e-6, 1.0 - 1e-6))
        drawn = NSQRng(seed).uniform(after["ray_id"], events["bounce"], EventSlot.SCATTER_BRANCH) < fraction
        # Two lobes may have the direction of a law, and the draw alone tells: a specular one, and one that takes all flux
        # where it leads below the surface.
        is_untold = (after["flux"] == 0.0) | isinstance(surface.bsdf, SpecularBRDF)
        assert not (scattered & ~drawn & is_untold).any(), f"{surface.name}: a law does not hold"
        assert np.array_equal(scattered[~is_untold], drawn[~is_untold]), f"{surface.name}: directions deny Optiland's draws"
        scattered = drawn
    else:
        # Of a ray without flux the direction means nothing.
        assert not (scattered & (after["flux"] > 0.0)).any(), f"{surface.name}: a law does not hold"
    assert not (is_mirrored & is_refracted & ~scattered).any()
    is_back = (out * facing).sum(axis=1) > 0.0
    unscattered = np.select([is_mirrored, is_refracted], ["R", "T"], "")
    lobes = np.where(is_back, "SR", "ST") if surface.bsdf is not None else np.full(is_back.shape, "")
    return np.where(scattered, lobes, unscattered).tolist()


def _normals(surface: BaseComponent, before: np.ndarray, events: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals where rays meet a surface, and on which side of it: above 0 the ray goes from front to back."""
    count = len(events)
    ahead = _vectors(events, "LMN")
    rays = NSQRayBundle(*(before[axis] for axis in "xyz"), *ahead.T, flux=events["flux"], wavelength=events["wavelength"],
                        n_current=np.ones(count), bounce=events["bounce"], alive=np.ones(count, dtype=bool))
    distance, normal, hits, geometric = surface.intersect(rays)
    assert hits.all(), surface.name
    place = _vectors(before, "xyz") + distance[:, None] * ahead
    extent = max(np.abs(_vectors(events, "xyz")).max(), np.abs(_vectors(before, "xyz")).max(), 1.0)
    assert np.abs(place - _vectors(events, "xyz")).max() < PLACE * extent, surface.name
    return normal, (ahead * geometric).sum(axis=1)


def _vectors(events: np.ndarray, keys: str) -> np.ndarray:
    return np.stack([events[key] for key in keys], axis=1)


# The filter


def keeps(expression: str, path: Path) -> bool:
    """Tell whether a filter keeps a path. Names are quoted, so that Python reads the expression."""
    def some(steps: tuple[Step, ...], *kinds: str) -> Callable[[str], bool]:
        return lambda name: any(letters in kinds and _is_called(surface, name) for letters, surface in steps)

    known: dict[str, Any] = {
        "reflections": path.count("R"), "transmissions": path.count("T"), "scatterings": path.count("ST", "SR"),
        "events": len(path.steps),
        "hit": some(path.steps, "T", "R", "ST", "SR"),
        "reflected": some(path.steps, "R"), "transmitted": some(path.steps, "T"),
        "scattered": some(path.steps, "ST", "SR"),
        "first": some(path.steps[:1], "T", "R", "ST", "SR"), "last": some(path.steps[-1:], "T", "R", "ST", "SR"),
        "source": lambda name: _is_like(path.source, name),
        "sequence": lambda pattern: _matches([part.strip() for part in pattern.split(">")],
                                             [path.source, *path.steps, path.detector]),
    }
    return bool(eval(_compiled(expression), {"__builtins__": {}}, known))


_compiled = functools.cache(lambda expression: compile(expression, "where", "eval"))


def _is_called(surface: str, name: str) -> bool:
    """A name is that of a surface, or of its component."""
    return _is_like(surface, name) or "." in surface and _is_like(surface.rpartition(".")[0], name)


def _is_like(text: str, pattern: str) -> bool:
    """Tell whether a text is one for which a pattern stands: ``*`` is any characters."""
    return re.fullmatch(".*".join(map(re.escape, pattern.split("*"))), text) is not None


def _matches(pattern: list[str], parts: list[Any]) -> bool:
    if not pattern:
        return not parts
    if pattern[0] == "*":
        return any(_matches(pattern[1:], parts[skipped:]) for skipped in range(len(parts) + 1))
    return bool(parts) and _is_part(pattern[0], parts[0]) and _matches(pattern[1:], parts[1:])


def _is_part(pattern: str, part: str | Step) -> bool:
    if isinstance(part, str):
        return _is_like(part, pattern)
    letters, _, name = pattern.partition(" ")
    return letters in ("*", part[0]) and _is_called(part[1], name.strip())
