"""Files that a call was asked to write: whole or not at all, and never over what is meant to stay.

The command's twin is ``src/cli/output_file.rs``.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import stat
from pathlib import Path

from nsq_gpu.errors import UsageError


def check(path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Refuse a place where a file would be lost, or where something else than a file stands.

    An empty file may be replaced: nothing in it could be lost.

    Raises:
        UsageError: The place is taken; the message says by what.
    """
    _may_replace(Path(path), overwrite)


def write(path: str | os.PathLike[str], text: str, overwrite: bool = False) -> None:
    """Write a text file in one step. An existing file stays whole until then, and for good if something fails.

    A file that holds this very text already is left alone. One that this process wrote, and nobody has changed since, is
    replaced.

    Raises:
        UsageError: The place is taken; the message says by what.
        OSError: The file cannot be written.
    """
    path, data = Path(path), text.encode("utf-8")
    if path.is_file() and not path.is_symlink() and path.stat().st_size == len(data) and path.read_bytes() == data:
        return
    replaces = _may_replace(path, overwrite)
    new = path.with_name(f".nsq-gpu-{secrets.token_hex(8)}")
    try:
        _write_new(new, data)
        if replaces:
            os.chmod(new, stat.S_IMODE(path.stat().st_mode))
            os.replace(new, path)
        else:
            _rename_to_new(new, path)
        _written[os.path.abspath(path)] = hashlib.sha256(data).digest()
    finally:
        new.unlink(missing_ok=True)


def write_all(folder: Path, files: dict[str, bytes], overwrite: bool, leave: set[str]) -> None:
    """Write files that belong together, whose last one names the others, and take away those that are to leave.

    Until all are written nothing changes. A call that is killed later leaves a folder without the last one.

    Raises:
        UsageError: A place was taken meanwhile.
        OSError: A file cannot be written.
    """
    stage = folder / f".nsq-gpu-{secrets.token_hex(8)}"
    stage.mkdir()
    try:
        for name, data in files.items():
            _write_new(stage / name, data)
        if overwrite:
            (folder / list(files)[-1]).unlink(missing_ok=True)
        for name in leave:
            (folder / name).unlink(missing_ok=True)
        for name in files:
            if overwrite:
                os.replace(stage / name, folder / name)
            else:
                _rename_to_new(stage / name, folder / name)
    finally:
        for name in files:
            (stage / name).unlink(missing_ok=True)
        stage.rmdir()


def _write_new(path: Path, data: bytes) -> None:
    with open(path, "xb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _may_replace(path: Path, overwrite: bool) -> bool:
    """Return whether there is a file that may be replaced; refuse a place that is taken."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return False
    mode = found.st_mode
    if stat.S_ISDIR(mode):
        raise UsageError(f"{path}: is a folder; give the name of a file")
    if stat.S_ISLNK(mode):
        raise UsageError(f"{path}: is a link, and links are not written through; give another name")
    if not stat.S_ISREG(mode):
        raise UsageError(f"{path}: is a pipe or a device; give another name")
    if found.st_size and not overwrite and not _is_own(path):
        raise UsageError(f"{path}: exists; overwrite=True (--overwrite) replaces it, or give another name")
    return True


#: Hashes of the files that this process wrote, by their paths.
_written: dict[str, bytes] = {}


def _is_own(path: Path) -> bool:
    """Return whether a file is as this process wrote it."""
    known = _written.get(os.path.abspath(path))
    return known is not None and hashlib.sha256(path.read_bytes()).digest() == known


def _rename_to_new(new: Path, path: Path) -> None:
    """Rename a file to a name that is not in use, even if somebody takes it at this moment."""
    try:
        os.link(new, path)
    except FileExistsError:
        raise UsageError(f"{path}: was made by somebody else meanwhile; give another name") from None
    except OSError:
        # Some file systems have no links.
        if os.path.lexists(path):
            raise UsageError(f"{path}: was made by somebody else meanwhile; give another name") from None
        os.rename(new, path)
