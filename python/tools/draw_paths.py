"""Draws the maps of paths side by side, on one logarithmic scale, from a folder that ``nsq-gpu paths -o`` wrote.

For ``docs/ghosts.png``, the five ghosts behind the direct light in docs/how-to/ghosts.md::

    python python/tools/draw_paths.py ghosts docs/ghosts.png --ranks 2 6
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.colors import LogNorm

#: The scale reaches so far below the brightest pixel.
DECADES = 3


def draw(folder: Path, picture: Path, first: int, last: int) -> None:
    """Draw the maps of the rows from ``first`` to ``last``."""
    rows = json.loads((folder / "report.json").read_text(encoding="utf-8"))["paths"][first - 1 : last]
    files = [np.load(folder / f"path_{row['rank']}.npz") for row in rows]
    maps = [file["irradiance"] for file in files]
    brightest = max(image.max() for image in maps)
    norm = LogNorm(brightest * 10.0**-DECADES, brightest, clip=True)
    figure, axes = plt.subplots(1, len(rows), figsize=(2.4 * len(rows) + 0.8, 3.0), layout="constrained", squeeze=False)
    for axis, row, file, image in zip(axes[0], rows, files, maps, strict=True):
        x, y = file["x_coords"], file["y_coords"]
        half_x, half_y = (x[1] - x[0]) / 2, (y[1] - y[0]) / 2
        extent = (x[0] - half_x, x[-1] + half_x, y[0] - half_y, y[-1] + half_y)
        shown = axis.imshow(image, norm=norm, origin="lower", extent=extent, cmap="inferno")
        faces = " > ".join(f"{letters} {name}" for letters, name in row["steps"])
        axis.set_title(f"{row['rank']}: {faces}\n{row['flux']:.3g} W", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.set_xlabel("x [mm]", fontsize=7)
    axes[0, 0].set_ylabel("y [mm]", fontsize=7)
    bar = figure.colorbar(shown, ax=axes, pad=0.01)
    bar.set_label("W/mm$^2$", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    figure.savefig(picture, dpi=130)


def main() -> None:
    """Read the arguments, and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the folder of `nsq-gpu paths -o`")
    parser.add_argument("picture", type=Path, help="the file to write")
    parser.add_argument("--ranks", type=int, nargs=2, default=(2, 6), metavar=("FIRST", "LAST"))
    arguments = parser.parse_args()
    draw(arguments.folder, arguments.picture, *arguments.ranks)


if __name__ == "__main__":
    main()
