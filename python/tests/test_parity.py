"""The comparison against a stand-in for the binary: it must accept the oracle's own result, and no wrong one."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import os
import shlex
import sys
import warnings
from pathlib import Path
from unittest import mock

import numpy as np

from tests import oracle, parity
from tests.agreement import compare, compare_statistically
from tests.mock_binary import inject

SCENES = Path(__file__).resolve().parents[2] / "scenes"
MOCK = f"{shlex.quote(sys.executable)} -m tests.mock_binary"
NUM_RAYS = 3000


def run_parity(scene: str, fault: str = "", *options: str) -> tuple[int, str]:
    with mock.patch.dict(os.environ, {"NSQ_MOCK_FAULT": fault}), contextlib.redirect_stdout(io.StringIO()) as out:
        code = parity.main([str(SCENES / scene), "--binary", MOCK, "-n", str(NUM_RAYS), *options])
    return code, out.getvalue()


def test_accepts_the_oracle() -> None:
    for scene in ("telephoto_spectral.json", "ball_lens_ghosts.json"):
        code, output = run_parity(scene)
        assert code == 0, output


def test_rejects_a_wrong_binary() -> None:
    code, output = run_parity("bench_lens.json", "pixel")
    assert code == 1 and "FAIL" in output
    code, output = run_parity("bench_lens.json", "no such fault")
    assert code == 1 and "RuntimeError" in output


def test_f32_reports_counts_and_judges_their_rate() -> None:
    code, output = run_parity("bench_lens.json", "count", "--precision", "f32")
    assert "1 counts differ" in output and code == 1, output
    code, output = run_parity("bench_lens.json", "total", "--precision", "f32")
    assert code == 0, output


def test_rejects_each_fault() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        map_result = oracle.run(SCENES / "bench_lens.json", NUM_RAYS)
        row_result = oracle.run(SCENES / "cemented_achromat_auto.json", NUM_RAYS)
    for fault, result in [*((fault, map_result) for fault in ("count", "total", "pixel", "nan", "hits")),
                          ("row", row_result)]:
        wrong = copy.deepcopy(result)
        inject(fault, wrong)
        assert compare(wrong, result).violations, fault
        assert not compare(copy.deepcopy(result), result).violations


def test_ring_at_the_pole_counts_as_one_bin() -> None:
    result = _far_field(np.ones((4, 6)))
    turned = copy.deepcopy(result)
    turned["detectors"]["sky"]["intensity"][0] = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert not compare(turned, result).violations
    turned["detectors"]["sky"]["intensity"][1] = [6.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert compare(turned, result).violations


def _far_field(intensity: np.ndarray) -> oracle.Json:
    detector = {"kind": "far_field", "intensity": intensity, "theta": np.arange(4.0), "phi": np.arange(6.0),
                "total_flux": 1.0, "num_rays_hit": 24, "transmissive": False}
    diagnostics = {"unreached_geometry": [], "medium_stack_underflows": 0, "split_budget_saturated": False,
                   "depth_truncated_flux_fraction": 0.0, "rr_killed_flux_fraction": 0.0}
    return {**dict.fromkeys(oracle.COUNTS, 0), **dict.fromkeys(oracle.FLUXES, 1.0), "flux_conservation_error": 0.0,
            "diagnostics": diagnostics, "detectors": {"sky": detector}}


def test_statistical_comparison() -> None:
    """Independent runs pass; the same runs with two percent less reflectance do not."""
    document = json.loads((SCENES / "mirror_ball_billiard.json").read_text(encoding="utf-8"))
    dimmed = copy.deepcopy(document)
    for surface in dimmed["nsq_gpu"]["surfaces"]:
        surface["reflectance"] *= 0.98
    runs = [[parity.trace_with_oracle(scene, NUM_RAYS, seed) for seed in seeds]
            for scene, seeds in ((document, range(8)), (document, range(100, 108)), (dimmed, range(8)))]
    assert not compare_statistically(runs[0], runs[1]).violations
    assert compare_statistically(runs[2], runs[1]).violations
