"""Traces scene files with Optiland's NumPy or Torch backend: the peer of ``nsq-bench`` and ``accuracy.py``.

Says on stdout which versions it runs, then answers each line of stdin, both in JSON::

    {"scene": "scene.json", "num_rays": 100000, "max_depth": 16}  ->  {"num_rays": 100000, "seconds": 0.3}

With ``"map": "name of an irradiance detector"``, and maybe ``"seed"``, the scene is traced with the default sampling
policy and each ray in one pixel, and the answer has ``"map"``: the share of the launched flux in every pixel. The one
argument is the backend, ``numpy`` or ``torch``.

``seconds`` is Optiland's own ``trace_time_sec``, without the building of the scene. ``scene_file.py`` is looked for
beside this file, where ``nsq-bench`` puts it, and in the package.
"""

from __future__ import annotations

import json
import platform
import sys
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent.parent / "nsq_gpu"))

import numpy as np
import optiland.backend as be
import scene_file
from optiland.nonsequential.backends.numpy_backend import NumpyBackend


def load(request: dict[str, Any]) -> Any:
    """The scene, as its file says; for a map with the default policy, and each ray in one pixel."""
    path = Path(request["scene"])
    if "map" not in request:
        return scene_file.load_scene(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    document.get("nsq_gpu", {}).pop("sampling", None)
    for detector in document["detectors"]:
        if detector["type"] == "irradiance":
            detector["splat"] = "hard"
    return scene_file.scene_from_dict(document, path.parent)


def answer(request: dict[str, Any], backend: str) -> dict[str, Any]:
    """Trace once. The scene is built anew, because its detectors keep what they have seen."""
    # Built with NumPy: Optiland's check of a lens' volume fails where Torch is set.
    be.set_backend("numpy")
    scene = load(request)
    seed = request.get("seed", 0)
    options = {"num_rays": request["num_rays"], "max_depth": request["max_depth"], "seed": seed}
    if backend == "torch":
        result = trace_with_torch(scene, options)
    else:
        result = scene.trace(**options, backend=NumpyBackend(seed=seed))
    answered = {"num_rays": int(result.num_rays_total), "seconds": float(result.trace_time_sec)}
    if "map" in request:
        detected = be.to_numpy(result.detectors[request["map"]].data)
        answered["map"] = (np.asarray(detected).ravel() / float(result.total_flux_in)).tolist()
    return answered


def trace_with_torch(scene: Any, options: dict[str, Any]) -> Any:
    """Trace in float64: Torch's default is float32, where Optiland is wrong without a word."""
    import torch
    from optiland.nonsequential.backends.torch_backend import TorchBackend

    # Its threads spin while they wait, which starves a device in software on the same cores.
    torch.set_num_threads(1)
    be.set_backend("torch")
    be.set_precision("float64")
    with torch.no_grad():
        return scene.trace(**options, backend=TorchBackend(seed=options["seed"]))


def versions() -> dict[str, str]:
    """Of what it is made of; of Torch where it is installed."""
    found = {package: version(package) for package in ("optiland", "numpy")}
    try:
        found["torch"] = version("torch")
    except PackageNotFoundError:
        pass
    return {**found, "python": platform.python_version()}


def main() -> None:
    """Answer until stdin ends."""
    answers, sys.stdout = sys.stdout, sys.stderr
    # nsq-gpu says itself which glass of several it takes.
    warnings.simplefilter("ignore")
    be.set_backend("numpy")
    be.set_precision("float64")
    print(json.dumps(versions()), file=answers, flush=True)
    backend = sys.argv[1] if len(sys.argv) > 1 else "numpy"
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line), backend)), file=answers, flush=True)


if __name__ == "__main__":
    main()
