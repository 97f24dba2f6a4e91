"""Random scenes against NumpyBackend, ray by ray, or by expectations where rays are split.

NSQ_GPU_RANDOM_SCENES=200 traces more of them.
"""

from __future__ import annotations

import itertools
import os

import pytest
from optiland.nonsequential.backends.numpy_backend import NumpyBackend

from tests import live, random_scenes

pytestmark = pytest.mark.in_turn

#: Each feature alone, then in pairs.
NUM_SCENES = int(os.environ.get("NSQ_GPU_RANDOM_SCENES", random_scenes.NUM_COVERING))
SEED = int(os.environ.get("NSQ_GPU_RANDOM_SEED", "1"))
NUM_RAYS = 2000
SCENES = list(itertools.islice(enumerate(random_scenes.combinations(SEED)), NUM_SCENES))


def test_every_feature_is_traced_alone_and_in_a_pair() -> None:
    found = list(itertools.islice(random_scenes.combinations(SEED), random_scenes.NUM_COVERING))
    for number in (1, 2):
        assert {name for features in found if len(features) == number for name in features} == set(
            random_scenes.FEATURES)


@pytest.mark.parametrize(("number", "features"), SCENES, ids=lambda value: str(value) if isinstance(value, int)
                         else "+".join(value))
def test_equals_numpy(number: int, features: tuple[str, ...]) -> None:
    with live.quiet():
        scene = random_scenes.build(features, 1000 * SEED + number)
    if scene.sampling_policy.split_depth > 0:
        live.assert_agrees_with_numpy(scene, NUM_RAYS)
        return
    result, ours = live.traced(scene, NUM_RAYS, live.backend(), seed=number, record_paths=200)
    reference, theirs = live.traced(scene, NUM_RAYS, NumpyBackend(), seed=number, record_paths=200)
    found = live.agreement(ours, theirs)
    assert not found.violations, (features, found.violations)
    live.assert_same_paths(result, reference)
    reached = set(scene.component_names) - set(ours["diagnostics"]["unreached_geometry"])
    assert reached or not scene.component_names, "some ray meets something"
