"""What Optiland has, what the exporter writes and what the schema knows must stay the same sets.

In the tracer itself the compiler is the guard: its matches over the scene's kinds name every one of them, which clippy
enforces (``wildcard_enum_match_arm``).
"""

from __future__ import annotations

import importlib
import inspect
import itertools
import json
import pkgutil
import subprocess
from collections.abc import Iterator
from typing import Any

import optiland.nonsequential
import pytest
from optiland.coatings import BaseCoating, BaseCoatingPolarized
from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential.bsdf import BaseBSDF
from optiland.nonsequential.components.base import BaseComponent
from optiland.nonsequential.components.compound import CompoundComponent
from optiland.nonsequential.components.geometry.base import ComponentGeometry
from optiland.nonsequential.detectors.base import BaseDetector
from optiland.nonsequential.sources.base import BaseNSQSource, Spectrum

from nsq_gpu.export import surfaces
from nsq_gpu.export.components import _KINDS as COMPOUNDS
from nsq_gpu.export.detectors import _KINDS as DETECTORS
from nsq_gpu.export.sources import _KINDS as SOURCES
from nsq_gpu.sources import TabulatedSource
from tests import live, random_scenes
from tests.oracle import Json
from tests.test_export import WALKS, With, document, with_pupil

#: Where a file says which variant it means.
KEYS = ("type", "interaction", "splat", "profile", "reflect_prob", "outline", "zernike_type", "intensity_units",
        "scatter_type", "order", "color")
#: Variants that people may write and the exporter does not: n and k of a live material are evaluated, and a live surface has
#: a number.
BY_HAND = {("Medium", "catalog"), ("Material", "catalog"), ("ScatterFraction", "tis")}


@pytest.fixture(scope="module")
def variants() -> set[tuple[str, str]]:
    """Return every variant of the schema: where it is defined, and its name."""
    printed = subprocess.run([live.binary(), "schema"], check=True, capture_output=True, text=True).stdout
    definitions = json.loads(printed)["$defs"]
    return {(name, variant) for name, definition in definitions.items() for variant in _constants(definition)}


def _constants(tree: Any) -> Iterator[str]:
    if isinstance(tree, dict):
        if isinstance(tree.get("const"), str):
            yield tree["const"]
        yield from (value for value in tree.get("enum", []) if isinstance(value, str))
        for value in tree.values():
            yield from _constants(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from _constants(value)


def exported() -> Iterator[Json]:
    """Yield documents of live scenes of all kinds, made by the walk over all fields and at random."""
    for build, base, changes in WALKS.values():
        for name, value in changes.items():
            change = value if isinstance(value, With) else With(value, {})
            with live.quiet():
                scene = build(**{**base, **change.base, name: change.value})
            yield document(scene)
    for units, flux in (("relative", {"total_flux": 1.0}), ("W/sr", {}), ("cd", {})):
        scene = with_pupil(cs=CoordinateSystem(), spectrum=Spectrum.monochromatic(0.55))
        scene.source_registry.add("table", TabulatedSource(CoordinateSystem(), Spectrum.monochromatic(0.55), [0.0, 90.0], [1.0, 0.0],
                                                          intensity_units=units, **flux))
        yield document(scene)
    scene = with_pupil(cs=CoordinateSystem(), spectrum=Spectrum.monochromatic(0.55))
    for detector in scene.detectors:
        detector.color = "xyz"
    yield document(scene)
    features = itertools.islice(random_scenes.combinations(1), len(random_scenes.FEATURES))
    for number, chosen in enumerate(features):
        with live.quiet():
            yield document(random_scenes.build(chosen, number))


def _written(tree: Any) -> Iterator[str]:
    if isinstance(tree, dict):
        yield from (tree[key] for key in KEYS if isinstance(tree.get(key), str))
        for value in tree.values():
            yield from _written(value)
    elif isinstance(tree, list):
        for value in tree:
            yield from _written(value)


def test_the_exporter_writes_every_variant_of_the_schema(variants: set[tuple[str, str]]) -> None:
    written = {name for content in exported() for name in _written(content)}
    never = {variant for variant in variants - BY_HAND if variant[1] not in written}
    # The default of reflect_prob is written by leaving the policy out.
    assert never == {("ReflectProb", "fresnel")} - {("ReflectProb", name) for name in written}
    assert written <= {name for _, name in variants}


def _all_subclasses(base: type) -> set[type]:
    return {base}.union(*map(_all_subclasses, base.__subclasses__()))


def test_every_class_of_optiland_is_known() -> None:
    """Polarised coatings alone have no place in a file: they are refused, since rays carry no polarisation. The package has
    classes of its own beside Optiland's."""
    for module in pkgutil.walk_packages(optiland.nonsequential.__path__, "optiland.nonsequential."):
        importlib.import_module(module.name)
    known = {*surfaces.SHAPES, *surfaces.BSDFS, *surfaces.INTERACTIONS, *COMPOUNDS, *DETECTORS, *SOURCES,
             surfaces.SpecularBRDF, surfaces.SimpleCoating}
    bases = (ComponentGeometry, BaseComponent, CompoundComponent, BaseBSDF, BaseDetector, BaseNSQSource, BaseCoating)
    found = {cls for base in bases for cls in _all_subclasses(base)
             if cls.__module__.startswith("optiland.") and not inspect.isabstract(cls) and cls not in bases
             # Optiland's own wrapper of a single surface.
             and cls.__name__ != "_SingleSurface"}
    unknown = {cls.__name__ for cls in found - known if not issubclass(cls, BaseCoatingPolarized)}
    assert not unknown, "export these classes, or say here why they are refused"
    assert {cls for cls in known if cls.__module__.startswith("optiland.")} <= found
