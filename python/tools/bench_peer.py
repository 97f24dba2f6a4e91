"""Traces scene files with Optiland's NumPy backend: the peer of ``nsq-gpu bench --against optiland``.

Says on stdout which versions it runs, then answers each line of stdin, both in JSON::

    {"scene": "scene.json", "num_rays": 100000, "max_depth": 16}  ->  {"num_rays": 100000, "seconds": 0.3}

``seconds`` is Optiland's own ``trace_time_sec``, without the building of the scene. ``scene_file.py`` is looked for
beside this file, where ``nsq-gpu`` puts it, and in the package.
"""

from __future__ import annotations

import json
import platform
import sys
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent.parent / "nsq_gpu"))

import optiland.backend as be
import scene_file
from optiland.nonsequential.backends.numpy_backend import NumpyBackend


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Trace once. The scene is built anew, because its detectors keep what they have seen."""
    scene = scene_file.load_scene(request["scene"])
    result = scene.trace(
        num_rays=request["num_rays"], max_depth=request["max_depth"], seed=0, backend=NumpyBackend(seed=0)
    )
    return {"num_rays": int(result.num_rays_total), "seconds": float(result.trace_time_sec)}


def main() -> None:
    """Answer until stdin ends."""
    answers, sys.stdout = sys.stdout, sys.stderr
    # nsq-gpu says itself which glass of several it takes.
    warnings.simplefilter("ignore")
    be.set_backend("numpy")
    be.set_precision("float64")
    versions = {package: version(package) for package in ("optiland", "numpy")}
    print(json.dumps({**versions, "python": platform.python_version()}), file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), file=answers, flush=True)


if __name__ == "__main__":
    main()
