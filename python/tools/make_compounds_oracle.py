"""Writes ``tests/data/compounds.json``: what Optiland builds from random lenses, doublets and mirrors.

Run ``python -m tools.make_compounds_oracle`` from the folder ``python``.

Each case holds the component as text of a scene file, and either the surfaces that Optiland makes of it (name, shape,
frame, media) or null where it raised NonWatertightVolumeError. Needs optiland 0.6.3.
"""

import json
import math
import random
import sys
from pathlib import Path

import numpy as np

from optiland.coordinate_system import CoordinateSystem
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.base import _get_transform
from optiland.nonsequential.components.volume import NonWatertightVolumeError
from optiland.nonsequential.serialization import _deserialize_component

OUTPUT = Path(__file__).parents[2] / "tests" / "data" / "compounds.json"
SEED = 20260
GLASSES = ["N-BK7", "N-SF5", "N-LAK22", "N-SF6"]


def random_cs(rng: random.Random, depth: int) -> dict:
    """A tilted frame, `depth` frames deep."""
    cs = {key: rng.uniform(-200.0, 200.0) for key in ("x", "y", "z")}
    cs |= {key: rng.uniform(-math.pi, math.pi) for key in ("rx", "ry", "rz")}
    return cs | {"reference_cs": random_cs(rng, depth - 1) if depth else None}


def random_radius(rng: random.Random) -> float:
    return rng.choice([0.0, math.inf, rng.uniform(12.0, 200.0), -rng.uniform(12.0, 200.0)])


def random_conic(rng: random.Random) -> float:
    return rng.choice([0.0, -1.0, rng.uniform(-3.0, 1.0)])


def random_lens(rng: random.Random) -> dict:
    front = rng.uniform(2.0, 12.0)
    config = {
        "r1": random_radius(rng),
        "r2": random_radius(rng),
        # Some are too thin for their faces.
        "thickness": rng.choice([rng.uniform(-1.0, 2.0), rng.uniform(1.0, 15.0)]),
        "material": rng.choice(GLASSES),
        "front_aperture_radius": front,
        "back_aperture_radius": rng.choice([None, front, front + 5e-10, rng.uniform(2.0, 12.0)]),
        "conic1": random_conic(rng),
        "conic2": random_conic(rng),
    }
    return {"type": "lens", "config": config}


def random_doublet(rng: random.Random) -> dict:
    config = {f"r{i}": random_radius(rng) for i in (1, 2, 3)}
    config |= {f"thickness{i}": rng.uniform(0.5, 10.0) for i in (1, 2)}
    config |= {f"material{i}": rng.choice(GLASSES) for i in (1, 2)}
    config |= {f"conic{i}": random_conic(rng) for i in (1, 2, 3)}
    return {"type": "doublet", "config": config | {"aperture_radius": rng.uniform(2.0, 12.0)}}


def random_mirror(rng: random.Random) -> dict:
    config = {
        "radius": random_radius(rng),
        "reflectance": rng.random(),
        "conic": random_conic(rng),
        "aperture_radius": rng.uniform(1.0, 50.0),
    }
    return {"type": "mirror", "config": config}


def catalog_name(material) -> str | None:
    return None if material.optiland_material is None else material.optiland_material.name


def surface_of(component) -> dict:
    translation, rotation = _get_transform(component.cs)
    shape = {key: float(value) for key, value in vars(component.geometry).items()}
    return {
        "name": component.name,
        "kind": type(component).__name__,
        "geometry": type(component.geometry).__name__,
        "shape": shape,
        "translation": np.asarray(translation).tolist(),
        "rotation": np.asarray(rotation).tolist(),
        "front": catalog_name(component.material_front),
        "back": catalog_name(component.material_back),
    }


def case_of(component: dict) -> dict:
    scene = NSQScene()
    text = json.dumps(component)
    try:
        _deserialize_component(component, scene)
    except NonWatertightVolumeError:
        return {"component": text, "surfaces": None}
    return {"component": text, "surfaces": [surface_of(surface) for surface in scene.surfaces]}


def main() -> None:
    rng = random.Random(SEED)
    makers = [random_lens] * 60 + [random_doublet] * 30 + [random_mirror] * 10
    cases = []
    for index, make in enumerate(makers):
        component = make(rng) | {"name": f"C{index}", "cs": random_cs(rng, index % 4)}
        cases.append(case_of(component))
    OUTPUT.write_text(json.dumps({"optiland": "0.6.3", "cases": cases}) + "\n", encoding="utf-8")
    leaky = sum(case["surfaces"] is None for case in cases)
    print(f"{len(cases)} cases, {leaky} refused by Optiland", file=sys.stderr)


if __name__ == "__main__":
    main()
