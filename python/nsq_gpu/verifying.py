"""What of a result in a folder is proven: ``nsq-gpu verify``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from nsq_gpu.binary import find_binary
from nsq_gpu.errors import UsageError
from nsq_gpu.integrity import REPORT
from nsq_gpu.process import answer

Json = dict[str, Any]


class Finding(NamedTuple):
    """Something that is wrong with a result."""

    file: str
    #: The place in the file; empty if that is the whole file.
    place: str
    problem: str


@dataclass(frozen=True)
class Verification:
    """What was found out about a result."""

    #: ``proven``, ``consistent``, ``whole``, ``damaged`` or ``different``.
    verdict: str
    #: What is wrong.
    findings: list[Finding]
    #: What could not be looked at, and why.
    notes: list[str]
    #: All that ``nsq-gpu verify --json`` prints.
    report: Json

    @property
    def holds(self) -> bool:
        """True if the result is proven, or consistent with other rays."""
        return self.verdict in ("proven", "consistent")


def verify(folder: str | os.PathLike[str], *, scene: str | os.PathLike[str] | None = None, sample: int = 3,
           adapter: str | None = None, binary: str | None = None) -> Verification:
    """Say what of a result is proven: its files by hashes and sums, its numbers by rays that are traced again.

    >>> nsq_gpu.verify("results").verdict
    'proven'

    Args:
        folder: What ``nsq-gpu trace -o`` or ``merge -o`` wrote.
        scene: The scene file that was traced; by default the one that the result names.
        sample: Ranges of the proof that are traced again, 1 to 64; without a proof so many 64ths of the rays.
        adapter: A part of the adapter's name.
        binary: Path of the program.

    Returns:
        What was found, also where the result is damaged or different: ``holds`` is then false.

    Raises:
        UsageError: There is no result in the folder.
        NsqGpuError: One of its subclasses, where nothing could be traced.
    """
    folder = Path(folder)
    if not (folder / REPORT).is_file():
        what = "there is no such folder" if not folder.exists() else f"has no {REPORT}"
        raise UsageError(f"{folder}: {what}; give a folder that `nsq-gpu trace -o` wrote")
    options = {"scene": scene, "sample": sample, "adapter": adapter}
    arguments = [f"--{name}={os.fspath(value) if name == 'scene' else value}" for name, value in options.items()
                 if value is not None]
    command = [find_binary(binary), "verify", "--json", *arguments, "--", str(folder)]
    report: Json = answer(command)
    findings = [Finding(**found) for found in report["findings"]]
    return Verification(report["verdict"], findings, report["notes"], report)
