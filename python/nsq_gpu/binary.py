"""Where the program ``nsq-gpu`` is."""

from __future__ import annotations

import os
import shutil
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

from nsq_gpu.errors import BinaryNotFoundError

#: Environment variable that names the program.
ENVIRONMENT = "NSQ_GPU_BINARY"
NAME = "nsq-gpu.exe" if os.name == "nt" else "nsq-gpu"


def find_binary(binary: str | os.PathLike[str] | None = None) -> str:
    """Return the path of the program: the argument, else the environment's, else the installed one, else PATH's.

    Raises:
        BinaryNotFoundError: It is at none of these places. A place that was named explicitly is the only one tried.
    """
    for named, by in ((binary, "the argument binary"), (os.environ.get(ENVIRONMENT), ENVIRONMENT)):
        if named:
            return _named(os.fspath(named), by)
    looked = list(_scripts_folders())
    for folder in looked:
        if _runs(folder / NAME):
            return str(folder / NAME)
    found = shutil.which(NAME)
    if found:
        return found
    raise BinaryNotFoundError(
        f"the program {NAME} was not found: not in {', '.join(map(str, looked))}, nor on PATH; install it with "
        f"`pip install ./python`, or name it by NsqGpuBackend(binary=...) or the environment variable {ENVIRONMENT}"
    )


def _named(path: str, by: str) -> str:
    if _runs(Path(path)):
        return path
    found = shutil.which(path)
    if found:
        return found
    raise BinaryNotFoundError(f"{by} names {path!r}, which is no program; give the path of {NAME}")


def _scripts_folders() -> Iterator[Path]:
    """Yield where pip puts programs: beside this interpreter, and for ``pip install --user``."""
    folders = [Path(sys.executable).parent, Path(sysconfig.get_path("scripts"))]
    user_scheme = sysconfig.get_preferred_scheme("user")
    folders.append(Path(sysconfig.get_path("scripts", user_scheme)))
    yield from dict.fromkeys(folders)


def _runs(path: Path) -> bool:
    return path.is_file() and os.access(path, os.X_OK)
