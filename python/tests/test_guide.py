"""Guided rays: the same light on average, far smaller errors of ghosts, and refusals by name."""

import json

import pytest
from optiland.coatings import SimpleCoating
from optiland.nonsequential.ir.scene_ir import SamplingPolicy
from optiland.samples.objectives import CookeTriplet

import nsq_gpu
from nsq_gpu import NsqGpuBackend
from nsq_gpu.export import export


@pytest.fixture(scope="module")
def lens():
    """A triplet whose faces reflect 0.5 %."""
    optic = CookeTriplet()
    for surface in optic.surfaces.surfaces[1:-1]:
        if surface.material_pre is not surface.material_post and not surface.is_stop:
            surface.interaction_model.coating = SimpleCoating(transmittance=0.995, reflectance=0.005)
    return nsq_gpu.from_optic(optic)


def ghosts(scene, num_rays, **options):
    """The three strongest ghosts of a trace."""
    backend = NsqGpuBackend(paths=True, progress=False, max_depth=32, **options)
    paths = scene.trace(num_rays, seed=3, backend=backend).paths
    assert ("guide" in backend.report) == bool(options.get("guide"))
    return paths[paths["reflections"] == 2][:3]


def test_guided_ghosts_are_those_of_plain_rays_with_smaller_errors(lens):
    guided = ghosts(lens, 100_000, guide=True)
    plain = {row["sequence"]: row for row in ghosts(lens, 4_000_000)}
    for row in guided:
        assert row["standard_error"] < 0.06 * row["flux"]
        other = plain[row["sequence"]] if row["sequence"] in plain else None
        if other is not None:
            assert abs(row["flux"] - other["flux"]) < 4 * (row["standard_error"] + other["standard_error"])


def test_a_filter_and_a_guide_keep_the_same_light(lens):
    filtered = ghosts(lens, 100_000, guide=True, where="reflections == 2")
    assert filtered[0]["standard_error"] < 0.06 * filtered[0]["flux"]


def test_refusals_name_what_to_leave_out(lens):
    with pytest.raises(nsq_gpu.UsageError, match="guide is 'yes'; give True or False"):
        NsqGpuBackend(guide="yes")
    policy = lens.sampling_policy
    try:
        lens.sampling_policy = SamplingPolicy(split_depth=4)
        with pytest.raises(nsq_gpu.UsageError, match="split_depth"):
            ghosts(lens, 1000, guide=True)
    finally:
        lens.sampling_policy = policy


def test_a_file_that_guides_rays_is_read_and_written_with_it(lens, tmp_path):
    document = dict(export(lens).document)
    light = {"detector": "image", "where": None}
    document["nsq_gpu"] = {**document["nsq_gpu"], "sampling": {"guide": light}}
    file = tmp_path / "guided.json"
    file.write_text(json.dumps(document))
    scene = nsq_gpu.load_scene(file)
    assert scene.guided_light == light
    assert export(scene).document["nsq_gpu"]["sampling"]["guide"] == light
