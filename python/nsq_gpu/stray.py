"""``stray_surfaces``: which surfaces are to blame for stray light."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene

from nsq_gpu.binary import find_binary
from nsq_gpu.display import MOST_ROWS, Summary, number
from nsq_gpu.errors import SceneError, UsageError
from nsq_gpu.export.values import whole_number
from nsq_gpu.paths import _Table
from nsq_gpu.process import answer
from nsq_gpu.progress import Counter, Progress, Shown
from nsq_gpu.pst_trace import angles_of_axis, point_of
from nsq_gpu.scattering import ScatterProb, ScatterTo, answering, file_of, keys_of
from nsq_gpu.session import EXPORTED, as_written

#: The fields of a row. ``name`` is a text.
FIELDS = np.dtype([
    ("name", object),
    ("receives", np.float64),
    ("sends", np.float64),
    ("sends_standard_error", np.float64),
    ("seen", np.float64),
])


class StraySurfaces(_Table):
    """The surfaces of a scene by the stray light that they send to a detector: a structured array with a row each, the worst first.

    ``found["sends"]`` is a column and ``found[0]`` a row. ``found[(found["receives"] > 0) & (found["seen"] > 0)]`` are those
    that a source lights and that the detector sees. They can send light after one scattering.

    ========================  ======================================================================================
    ``name``                  the surface
    ``receives``              flux that sources send there [W], straight or by mirrors and lenses, and not by scattering
    ``sends``                 detected flux that scattered at this surface, first or later [W]; light that scattered
                              twice counts in two rows
    ``sends_standard_error``  its standard error [W]
    ``seen``                  the share of the detector's view that the surface fills [1], straight or by mirrors and
                              lenses; directions count by their cosine
    ========================  ======================================================================================
    """

    _FIELDS = FIELDS

    def to_pandas(self) -> Any:
        """Return a ``pandas.DataFrame`` with these columns; ``attrs["units"]`` has their units.

        Raises:
            MissingLibraryError: pandas is not installed (``pip install 'nsq-gpu[pandas]'``).
        """
        frame = self._labelled("receives", "sends", "sends_standard_error")
        frame.attrs["units"]["seen"] = "1"
        return frame

    def _summary(self) -> Summary:
        rows = [[str(row["name"]), number(row["receives"], 3), number(row["sends"], 3),
                 number(row["sends_standard_error"], 2), f"{100.0 * row['seen']:.3g} %",
                 "lit and seen" if row["receives"] > 0.0 and row["seen"] > 0.0 else ""] for row in self[:MOST_ROWS]]
        return Summary("Surfaces by the stray light that they send", ["surface", "lit by sources [W]", "scatters to the detector [W]",
                                                                    "error [W]", "seen by the detector", ""], rows, len(self))


def stray_surfaces(scene: NSQScene | str | os.PathLike[str], detector: str, *, num_rays: int = 1_000_000, seed: int = 0,
                   max_depth: int | None = None, precision: str = "auto", scatter_prob: ScatterProb = None,
                   scatter_to: ScatterTo = None, angle_deg: float | None = None, azimuth_deg: float = 0.0,
                   source: str | None = None, pivot: Sequence[float] | None = None, adapter: str | None = None, binary: str | os.PathLike[str] | None = None,
                   timeout: float | None = None, progress: Progress = None, **options: Any) -> StraySurfaces:
    """List surfaces by the stray light that they send to a detector: which of them a source lights, and which the detector sees.

    That is the first list of a stray-light analysis: illuminated and critical objects (Fest, Stray Light Analysis and Control,
    SPIE 2013, section 1.3).

    >>> found = nsq_gpu.stray_surfaces(telescope, "image", scatter_to={"*": "image"})
    >>> found[found["seen"] > 0]["name"]

    Args:
        scene: The live scene, or its file.
        detector: The detector. It has an area: it is no far field.
        num_rays: Rays of the trace that finds what scatters. What is lit and what is seen takes at most 200,000.
        seed: Seed of the draws.
        max_depth: Largest number of events of a ray. None takes twice the surfaces that do not absorb, but at least 16.
        precision: As in :class:`nsq_gpu.NsqGpuBackend`.
        scatter_prob: As in :class:`nsq_gpu.NsqGpuBackend`.
        scatter_to: As in :class:`nsq_gpu.NsqGpuBackend`.
        angle_deg: Turns the source to this angle off its axis first [deg], as :func:`nsq_gpu.pst` does.
        azimuth_deg: The azimuth of the turned source [deg].
        source: The collimated source that is turned. None: a beam that overfills the scene takes the place of all sources.
        pivot: The point about which the source is turned, shape (3,) [mm]. None: the middle of the scene.
        adapter: A part of the adapter's name.
        binary: Path of the program.
        timeout: Longest time of the call [s].
        progress: As in :class:`nsq_gpu.NsqGpuBackend`. The program says nothing until it is done.
        options: Further options of ``nsq-gpu surfaces`` by their names, such as ``sampler="sobol"``.

    Raises:
        UsageError: An argument makes no sense in this scene, such as a name of no detector.
        NsqGpuError: One of its other subclasses, by what went wrong.
        TraceTimeoutError: The call took longer than ``timeout``.
    """
    if not isinstance(detector, str):
        raise UsageError(f"detector is {detector!r}; give a name")
    keys, rays = keys_of(scatter_prob, scatter_to), whole_number("num_rays", num_rays)
    named = {"num_rays": rays, "seed": whole_number("seed", seed), "precision": precision, "detector": detector, "adapter": adapter,
             "max_depth": None if max_depth is None else whole_number("max_depth", max_depth), **as_written(options)}
    if angle_deg is not None:
        angle, azimuth = (angles_of_axis(name, [given])[0] for name, given in (("angle_deg", angle_deg), ("azimuth_deg", azimuth_deg)))
        named |= {"angle": angle, "azimuth": azimuth, "source": source, "pivot": None if pivot is None else point_of(pivot)}
    elif source is not None or pivot is not None:
        raise UsageError("source and pivot say how the source is turned, and angle_deg is None; give an angle, such as angle_deg=0")
    arguments = [f"--{name.replace('_', '-')}={value}" for name, value in named.items() if value is not None]
    with tempfile.TemporaryDirectory(prefix="nsq-gpu-") as name, Shown(progress or False) as shown, answering(keys):
        counted, file = Counter(shown, rays), file_of(scene, keys, Path(name))
        try:
            said = answer([find_binary(binary), "surfaces", "--json", *arguments, "--", str(file)], timeout)
        except SceneError as error:
            if file.parent != Path(name):
                raise
            # The file is ours, and gone when the message is read.
            raise SceneError(str(error).replace(f"{file}: ", f"{EXPORTED}: "), stderr=error.stderr) from None
        counted.add(rays)
    rows = [tuple(entry[field] for field in FIELDS.names or ()) for entry in said["surfaces"]]
    return np.array(rows, dtype=FIELDS).view(StraySurfaces)
