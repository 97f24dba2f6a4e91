"""Scene files -> live scenes, checked by the command."""

from __future__ import annotations

import os
from pathlib import Path

from optiland.nonsequential import NSQScene

from nsq_gpu import scene_file
from nsq_gpu.binary import ENVIRONMENT, find_binary
from nsq_gpu.errors import BinaryNotFoundError
from nsq_gpu.process import run


def load_scene(path: str | Path) -> NSQScene:
    """Build the scene of a file; see :func:`nsq_gpu.scene_file.read_document` for what its text may hold.

    Where the command is installed it reads the file first: it knows every key, and the place of what is wrong.

    Raises:
        OSError: The file, or one that it names, cannot be read.
        ValueError: It is not UTF-8, not JSON, or holds what Optiland has not.
        NsqGpuError: The command refuses it.
    """
    path = Path(path)
    document = scene_file.read_document(path)
    try:
        binary = find_binary()
    except BinaryNotFoundError:
        # A program that is named must be there.
        if os.environ.get(ENVIRONMENT):
            raise
    else:
        check_scene(binary, path)
    return scene_file.scene_from_dict(document, path.parent)


def check_scene(binary: str, path: Path) -> None:
    """Refuse what the command refuses of a file.

    Raises:
        NsqGpuError: It does; the message has the place.
    """
    run([binary, "check", "--", str(path)])
