"""The binary against NumpyBackend, live, on every scene in its turn: ray for ray in f64, by counts in f32."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from tests import live, parity
from tests.conftest import ROOT
from tests.oracle import Json

NUM_RAYS = 100_000
SCENES = sorted((ROOT / "scenes").glob("*.json"))
CHAOTIC = [scene for scene in SCENES if parity.is_chaotic(scene)]


def options(precision: str) -> argparse.Namespace:
    return argparse.Namespace(num_rays=NUM_RAYS, seed=0, precision=precision)


@pytest.fixture(scope="module", params=[scene for scene in live.in_turn(SCENES) if scene not in CHAOTIC], ids=lambda path: path.stem)
def traced(request: pytest.FixtureRequest) -> tuple[Path, Json]:
    """A scene and the oracle's result, which both precisions are compared with."""
    document = json.loads(request.param.read_text(encoding="utf-8"))
    return request.param, parity.trace_with_oracle(document, NUM_RAYS, 0)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_ray_for_ray(traced: tuple[Path, Json], precision: str, command: list[str], report) -> None:
    scene, theirs = traced
    report(precision, scene, parity.check_ray_for_ray(command, scene, theirs, options(precision)))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("scene", CHAOTIC, ids=lambda path: path.stem)
@pytest.mark.in_turn
def test_statistically(scene: Path, precision: str, command: list[str], report) -> None:
    report(precision, scene, parity.check(command, scene, options(precision)))
