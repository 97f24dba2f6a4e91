"""``use``: makes the backend the default of ``scene.trace``."""

from __future__ import annotations

import functools
import inspect
from typing import Any

from optiland.nonsequential import NSQScene

from nsq_gpu.arguments import check_backend
from nsq_gpu.backend import NsqGpuBackend

_chosen: NsqGpuBackend | None = None
_optilands = NSQScene.trace
#: Arguments of ``NSQScene.trace`` before ``backend``, without ``self``.
_BACKEND_PLACE = list(inspect.signature(_optilands).parameters).index("backend") - 1


@functools.wraps(_optilands)
def _trace(self: NSQScene, *args: Any, **kwargs: Any) -> Any:
    if _chosen is not None and len(args) <= _BACKEND_PLACE and kwargs.get("backend") is None:
        kwargs["backend"] = _chosen
    return _optilands(self, *args, **kwargs)


def use(backend: NsqGpuBackend | None = NsqGpuBackend) -> None:  # type: ignore[assignment]
    """Make a backend the default of ``scene.trace``, until ``use(None)``.

    >>> import nsq_gpu
    >>> nsq_gpu.use()
    >>> scene.trace(100_000)

    A trace that names its own backend keeps it.

    Args:
        backend: The backend; ``NsqGpuBackend()`` if none is given. None makes Optiland's own the default again.

    Raises:
        UsageError: It is no backend, such as the name of a precision.
    """
    global _chosen
    chosen = NsqGpuBackend() if backend is NsqGpuBackend else backend
    if chosen is not None:
        check_backend(chosen)
    _chosen = chosen
    NSQScene.trace = _optilands if _chosen is None else _trace
