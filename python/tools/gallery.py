"""Runs Optiland's gallery of non-sequential notebooks twice, without and with ``nsq_gpu.use()``, and prints the times.

The notebooks are in the source archive of Optiland::

    pip download --no-deps --no-binary :all: optiland==0.6.3
    tar xzf optiland-0.6.3.tar.gz
    python tools/gallery.py optiland-0.6.3/docs/gallery/nonsequential

Each notebook runs in a process of its own, its cells one after the other; a line that is no Python, such as
``%matplotlib``, is left out. The time is the sum over all calls of ``scene.trace`` that name no backend.
"""

from __future__ import annotations

import argparse
import functools
import json
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

#: What the child prints before its result.
MARK = "gallery: "


def cells(path: Path) -> list[str]:
    """The notebook's cells of code."""
    found = json.loads(path.read_text(encoding="utf-8"))["cells"]
    texts = ["".join(cell["source"]) for cell in found if cell["cell_type"] == "code"]
    return ["\n".join(line for line in text.splitlines() if not line.lstrip().startswith(("%", "!"))) for text in texts]


def run(path: Path, with_gpu: bool, binary: str | None) -> None:
    """Run a notebook, and print how many traces it made, their rays and their seconds."""
    import matplotlib

    matplotlib.use("Agg")
    warnings.simplefilter("ignore")
    from optiland.nonsequential import NSQScene

    import nsq_gpu

    if with_gpu:
        nsq_gpu.use(nsq_gpu.NsqGpuBackend(binary=binary))
    traced = NSQScene.trace
    told: dict[str, Any] = {"traces": 0, "rays": 0, "seconds": 0.0, "error": None}

    @functools.wraps(traced)
    def trace(self: NSQScene, *arguments: Any, **named: Any) -> Any:
        start = time.perf_counter()
        result = traced(self, *arguments, **named)
        if named.get("backend") is None:
            told["seconds"] += time.perf_counter() - start
            told["traces"] += 1
            told["rays"] += int(result.num_rays_total)
        return result

    NSQScene.trace = trace
    space: dict[str, Any] = {"__name__": "__main__", "display": print}
    try:
        for text in cells(path):
            exec(compile(text, path.name, "exec"), space)
    except Exception as error:
        told["error"] = f"{type(error).__name__}: {error}"
    print(MARK + json.dumps(told))


def child(path: Path, with_gpu: bool, binary: str | None) -> dict[str, Any]:
    """Run a notebook in a process of its own."""
    command = [sys.executable, __file__, str(path.resolve()), "--child", "gpu" if with_gpu else "numpy"]
    command += [] if binary is None else ["--binary", binary]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    for line in done.stdout.splitlines():
        if line.startswith(MARK):
            return json.loads(line[len(MARK):])
    return {"traces": 0, "rays": 0, "seconds": 0.0, "error": done.stderr[-300:]}


def main() -> None:
    """Run all notebooks of a folder, or one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--binary", help="the built command")
    parser.add_argument("--child", choices=["gpu", "numpy"], help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        run(given.folder, given.child == "gpu", given.binary)
        return
    print("| notebook | traces | rays | NumPy [s] | nsq-gpu [s] | |")
    print("|---|---|---|---|---|---|")
    for path in sorted(given.folder.glob("*.ipynb")):
        theirs, ours = (child(path, with_gpu, given.binary) for with_gpu in (False, True))
        remark = theirs["error"] and f"in NumPy: {theirs['error']}" or ours["error"] or ""
        print(f"| `{path.stem}` | {ours['traces']} of {theirs['traces']} | {ours['rays']:.2g} | {theirs['seconds']:.2f} | "
              f"{ours['seconds']:.2f} | {remark} |", flush=True)


if __name__ == "__main__":
    main()
