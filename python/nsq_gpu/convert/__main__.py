"""``python -m nsq_gpu.convert LENS -o scene.json``: writes a lens of a file as a scene that ``nsq-gpu`` traces."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from nsq_gpu import placing
from nsq_gpu.convert import from_file
from nsq_gpu.errors import NsqGpuError, UsageError
from nsq_gpu.export import export_scene
from nsq_gpu.lensfiles import SUFFIXES


def _size(text: str) -> tuple[float, float]:
    """Return the width and the height of a text such as ``24,36``."""
    try:
        width, height = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no width and height; write both in mm, such as 24,36") from None
    return width, height


def main(arguments: Sequence[str] | None = None) -> int:
    """Convert a file; return the exit code, which is the one of ``nsq-gpu`` for what went wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m nsq_gpu.convert",
        description="Writes a lens as a scene that nsq-gpu traces, and prints what was carried and what was estimated.",
        epilog="Example: python -m nsq_gpu.convert lens.zmx -o scene.json && nsq-gpu trace scene.json -n 1e6 -o out")
    parser.add_argument("lens", help=f"a file whose name ends with {', '.join(SUFFIXES)}")
    parser.add_argument("-o", "--output", metavar="SCENE", help="the scene's file; without it the report alone is printed")
    parser.add_argument("--pixels", type=int, default=256, metavar="N", help="pixels of the image along x and along y [256]")
    parser.add_argument("--size", type=_size, metavar="W,H",
                        help="width and height of the detector [mm], such as 24,36 [as wide as the image circle or the last "
                             "element]")
    parser.add_argument("--edges", choices=["absorbing", "polished"], default="absorbing", help="what edges of lenses do")
    parser.add_argument("--margin", type=float, default=1.03, help="radius of faces over the radius of their rays [1.03]")
    parser.add_argument("--unknown", choices=["refuse", "remark"], default="refuse",
                        help="what becomes of an unknown card of a surface: remark leaves it out, and says so [refuse]")
    parser.add_argument("--overwrite", action="store_true", help="let -o replace a file that exists; never the lens itself")
    given = parser.parse_args(arguments)
    try:
        if given.output is not None:
            if os.path.exists(given.output) and os.path.samefile(given.lens, given.output):
                raise UsageError(f"{given.output}: the scene would be written over the lens; give another name")
            placing.check(given.output, given.overwrite)
        scene = from_file(given.lens, detector_pixels=(given.pixels, given.pixels), detector_size=given.size,
                          edges=given.edges, margin=given.margin, unknown=given.unknown)
        if given.output is not None:
            export_scene(scene, given.output, overwrite=given.overwrite)
    except NsqGpuError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code or 1
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(scene.conversion_report.summary())
    return 0


if __name__ == "__main__":
    sys.exit(main())
