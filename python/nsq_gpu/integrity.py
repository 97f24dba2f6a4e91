"""Files of a result, refused where they are not as the command wrote them."""

from __future__ import annotations

import hashlib
import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from nsq_gpu.errors import NsqGpuError

Json = dict[str, Any]

REPORT = "report.json"


def read_report(folder: Path) -> Json:
    """Return ``report.json``; one of an older version has no hashes, and is taken as it is.

    Raises:
        NsqGpuError: It is damaged, or was edited.
    """
    path = folder / REPORT
    data = path.read_bytes()
    try:
        report: Json = json.loads(data)
        meta = report.get("meta")
    except (ValueError, AttributeError) as error:
        raise NsqGpuError(f"{path}: is damaged: {error}") from None
    if meta is not None:
        _check_report(path, data, meta)
    return report


def _check_report(path: Path, data: bytes, meta: Any) -> None:
    """Compare the hash of the document with that in it, which stands last and counts as 64 zeros."""
    sha256 = str(meta.get("sha256")).encode() if isinstance(meta, dict) else b""
    before, found, after = data.rpartition(sha256) if len(sha256) == 64 else (data, b"", b"")
    if not found or hashlib.sha256(before + b"0" * 64 + after).hexdigest().encode() != sha256:
        raise NsqGpuError(f"{path}: is damaged, or was edited: its hash is another one")


def load_arrays(folder: Path, name: str, report: Json) -> dict[str, np.ndarray]:
    """Return the arrays of an ``.npz`` file beside a report.

    Raises:
        NsqGpuError: The file is damaged, was edited, or claims to hold more than it does.
    """
    path = folder / name
    meta = report.get("meta")
    if meta is not None:
        known = meta["files"].get(name)
        if known is None or _hash(path) != known["sha256"]:
            raise NsqGpuError(f"{path}: is damaged, was edited, or belongs to another trace: {REPORT} has another hash of it")
    try:
        with zipfile.ZipFile(path) as archive:
            _check_claims(path, archive, path.stat().st_size)
        with np.load(path, allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, OSError, zipfile.BadZipFile, EOFError) as error:
        raise NsqGpuError(f"{path}: is damaged: {error}") from None


def _hash(path: Path) -> str:
    sha256 = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            sha256.update(block)
    return sha256.hexdigest()


def _check_claims(path: Path, archive: zipfile.ZipFile, length: int) -> None:
    """Refuse an archive that would grow when it is unpacked: the command stores arrays as they are."""
    for member in archive.infolist():
        if member.compress_type != zipfile.ZIP_STORED or member.file_size > length:
            raise NsqGpuError(f"{path}: {member.filename!r} would unpack to {member.file_size} bytes, in a file of "
                              f"{length}: the command did not write it")
        with archive.open(member) as stream:
            version = np.lib.format.read_magic(stream)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(stream)
        if math.prod(shape) * dtype.itemsize > member.file_size:
            raise NsqGpuError(f"{path}: {member.filename!r} claims {math.prod(shape) * dtype.itemsize} bytes, in a file "
                              f"of {length}: the command did not write it")
