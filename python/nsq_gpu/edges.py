"""Light that crosses edges, such as the rim of a lens: what derivatives of the interior do not see."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from nsq_gpu.arguments import filter_of, flag
from nsq_gpu.errors import ResultWarning, warn


def check_options(where: object, edges: object) -> None:
    """Refuse what derivatives cannot take.

    Raises:
        UsageError: ``where`` is no text, or ``edges`` neither True nor False.
    """
    filter_of(where)
    flag("edges", edges)


def shape_of(document: object, options: Mapping[str, Any], names: Iterable[str]) -> str:
    """Return what scenes have in common that differ in their numbers alone, traced by the same filter."""
    text = json.dumps([without_numbers(document), options.get("where"), sorted(names)])
    return hashlib.sha256(text.encode()).hexdigest()


def without_numbers(document: object) -> object:
    """Return a document with 0 in the place of each number."""
    if isinstance(document, Mapping):
        return {key: without_numbers(value) for key, value in document.items()}
    if isinstance(document, list | tuple):
        return [without_numbers(value) for value in document]
    return document if isinstance(document, str | bool) or document is None else 0


def warn_of_edges(not_confirmed: Iterable[Mapping[str, Any]]) -> None:
    """Warn of derivatives that a difference of two traces does not confirm."""
    said = [f"{found['parameter']}: {found['interior']:.3g} without that light, {found['value']:.3g} +- "
            f"{found['standard_error']:.2g} by a difference of two traces" for found in not_confirmed]
    if said:
        warn("light crosses edges, such as the rim of a lens, and the gradient leaves that light out. What the loss gains by a "
             "unit:\n" + "\n".join(said) + "\nnsq_gpu.loss_gradient(..., edges=True) counts that light; "
             "NsqGpuBackend(check_edges=False) does not look for it", ResultWarning)
