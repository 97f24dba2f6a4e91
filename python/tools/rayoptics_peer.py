"""Traces rays through lens files by rayoptics, which reads them by a reader of its own: a program of its own, in an environment of its own.

    python3 -m venv peer && peer/bin/pip install rayoptics==0.9.8
    python -m tools.prescriptions --rayoptics peer/bin/python FILES..

Reads from stdin, as JSON, a list of files and rays: {"file", "unit": mm a unit of the file, "wavelength": [um], "rays": [[x, y, z, L, M, N], ..]},
with places [mm] and directions in the frame of surface 1. Writes for each file where rays meet the surfaces, in the same frame:
{"places": (surfaces, rays, 3) [mm]} with null where a ray is lost, or {"error"}.
"""

from __future__ import annotations

import json
import logging
import math
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np


def _model(path: Path) -> Any:
    if path.suffix.lower() == ".zmx":
        from rayoptics.zemax import zmxread

        return zmxread.read_lens_file(path)[0]
    from rayoptics.codev import cmdproc

    return cmdproc.read_lens(path)[0]


def _traced(given: dict[str, Any]) -> dict[str, Any]:
    from rayoptics.elem.transform import compute_global_coords
    from rayoptics.raytr import raytrace

    model = _model(Path(given["file"]))
    model.update_model()
    sequence = model["seq_model"]
    frames = compute_global_coords(sequence, 1)
    is_far = not abs(frames[0][1][2]) < 1e9
    rotations = [frame[0] if frame[0] is not None else np.eye(3) for frame in frames]
    unit = given["unit"]
    rays = np.array(given["rays"])
    found = np.full((sequence.get_num_surfaces(), len(rays), 3), np.nan)
    for number in range(len(rays)):
        place, direction = rays[number, :3] / unit, rays[number, 3:]
        if is_far:
            # The object is moved to where the ray starts.
            sequence.gaps[0].thi = -float(place[2])
            model.update_model()
            place = np.array([place[0], place[1], 0.0])
        else:
            place, direction = rotations[0].T @ (place - frames[0][1]), rotations[0].T @ direction
        try:
            steps, _, _ = raytrace.trace_raw(sequence.path(1000.0 * given["wavelength"][number]), place, direction, 1000.0 * given["wavelength"][number])
        except Exception:
            continue
        for surface, step in enumerate(steps[1:], start=1):
            place = step[0]
            if surface == len(steps) - 1:
                # A defocus is kept apart.
                place = place + step[1] * (model["optical_spec"]["focus"].focus_shift / step[1][2])
            found[surface, number] = unit * (rotations[surface] @ place + frames[surface][1])
    return {"places": [[[None if math.isnan(value) else float(value) for value in point] for point in row] for row in found]}


def main() -> None:
    """Trace what stands on stdin."""
    logging.disable(logging.CRITICAL)
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    answers = []
    output, sys.stdout = sys.stdout, sys.stderr
    for given in json.load(sys.stdin):
        try:
            answers.append(_traced(given))
        except BaseException as error:
            answers.append({"error": f"{type(error).__name__}: {error}"})
    json.dump(answers, output)


if __name__ == "__main__":
    main()
