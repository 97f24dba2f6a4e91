"""What a slip of the caller is answered with: the argument, what is wrong with it, and what would be right.

>>> nsq_gpu.use("f32")
UsageError: backend is 'f32', which is a precision; write NsqGpuBackend(precision='f32')
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import Any

import numpy as np
from optiland.nonsequential import NSQScene
from optiland.nonsequential.backends.base import TracerBackend
from optiland.optic import Optic

from nsq_gpu.errors import MissingLibraryError, NsqGpuError, SceneError, UnknownNameError, UsageError
from nsq_gpu.scene_file import parsed

PRECISIONS = ("auto", "f32", "f64", "df64")
SAMPLERS = ("pcg", "sobol")
#: Most names that an error lists.
_MOST_LISTED = 20
#: Longest text of a value that an error shows.
_LONGEST = 100


def refused(name: str, value: object, wanted: str) -> UsageError:
    """Return the error of an argument that is none of what is wanted: a short value is shown, of others the kind."""
    if isinstance(value, np.generic):
        value = value.item()
    is_shown = isinstance(value, str | bytes | int | float | complex | tuple | list | dict | set | None)
    if is_shown and len(repr(value)) <= _LONGEST:
        return UsageError(f"{name} is {value!r}; give {wanted}")
    if is_shown:
        return UsageError(f"{name} is a long {type(value).__name__}; give {wanted}")
    return wrong_kind(name, value, f"give {wanted}")


def flag(name: str, value: object) -> bool:
    """Return a truth value; 0 and 1 are numbers."""
    if not isinstance(value, bool | np.bool_):
        raise refused(name, value, "True or False")
    return bool(value)


def filter_of(where: object) -> str | None:
    """Return a filter of paths, or None; what its words mean, the program says."""
    if where is not None and not isinstance(where, str):
        raise UsageError(f'where is {where!r}; give a text, such as "reflections == 2"')
    return where


def wrong_kind(name: str, value: object, wanted: str) -> UsageError:
    """Return the error of an argument that is no such object; ``wanted`` says what would be right."""
    what = f"{name} is {value!r}"
    if isinstance(value, type):
        return UsageError(f"{name} is the class {value.__name__}; give an instance: {value.__name__}()")
    if isinstance(value, Optic):
        return UsageError(f"{name} is an Optic; make a scene of it: nsq_gpu.from_optic(optic)")
    for option, known in (("precision", PRECISIONS), ("sampler", SAMPLERS)):
        if isinstance(value, str) and value in known:
            return UsageError(f"{what}, which is a {option}; write NsqGpuBackend({option}={value!r})")
    if not isinstance(value, str | int | float | None):
        what = f"{name} is a {type(value).__name__}"
    return UsageError(f"{what}; {wanted}")


def check_backend(value: object) -> None:
    """Refuse what is no backend."""
    if not isinstance(value, TracerBackend):
        raise wrong_kind("backend", value, 'give a backend, such as NsqGpuBackend(), or None for Optiland\'s own')


def check_scene(value: object, *, or_path: bool = False) -> None:
    """Refuse what is no scene; with ``or_path``, its file will do."""
    if isinstance(value, NSQScene) or or_path and isinstance(value, str | os.PathLike):
        return
    if isinstance(value, str | os.PathLike):
        raise UsageError(f"scene is the path {os.fspath(value)!r}; read it: nsq_gpu.load_scene({os.fspath(value)!r})")
    raise wrong_kind("scene", value, "give a scene, an NSQScene" + (", or the path of its file" if or_path else ""))


def check_mapping(name: str, value: object, example: str) -> None:
    """Refuse what is no mapping by name."""
    if not isinstance(value, Mapping):
        raise wrong_kind(name, value, f"give a dictionary, such as {example}")


def near(word: str, known: Iterable[str]) -> str:
    """Return which of the known names is meant; where none is near, all of them."""
    known = list(known)
    meant = difflib.get_close_matches(word, known, 1)
    return f"did you mean {meant[0]!r}?" if meant else f"known here: {', '.join(map(repr, known))}"


class of_an_instance:  # noqa: N801
    """A method that answers by name where it is called on the class: ``scene.trace(n, backend=NsqGpuBackend)``."""

    def __init__(self, method: Callable[..., Any]) -> None:
        self._method = method
        wraps(method)(self)

    def __get__(self, instance: Any, owner: type) -> Callable[..., Any]:
        if instance is not None:
            return self._method.__get__(instance, owner)  # type: ignore[no-any-return]

        @wraps(self._method)
        def of_class(*args: Any, **kwargs: Any) -> Any:
            if not args or not isinstance(args[0], owner):
                raise wrong_kind("backend", owner, "")
            return self._method(*args, **kwargs)

        return of_class


def missing(library: str, extra: str, what: str) -> MissingLibraryError:
    """Return the error of a library that is not installed, with the one command that installs it."""
    return MissingLibraryError(f"{library} is not installed, and {what} it: pip install 'nsq-gpu[{extra}]'")


# Names of numbers


@contextmanager
def answering(scene: str, names: Iterable[str]) -> Iterator[None]:
    """Answer a wrong name of a number of a scene, the text of a file, by the nearest right name."""
    try:
        yield
    except (SceneError, UsageError) as error:
        raise of_names(error, scene, names) from None


def of_names(error: NsqGpuError, scene: str, names: Iterable[str]) -> NsqGpuError:
    """Return what the program says of a wrong name as :class:`UnknownNameError`, with the nearest right name.

    Other errors are returned as they are.
    """
    said = str(error).removeprefix("nsq-gpu: ")
    for name in names:
        label, _, key = name.rpartition(".")
        if f"unknown key `{key}`" in said:
            known = _numbers(scene).get(label.replace('"', ""))
            # Of short names the program knows which is near.
            near = re.search(r"did you mean `[^`]+`\?", said)
            advice = f"{near[0] + ' ' if near else ''}Its numbers: {_listed(known or [])}"
            return UnknownNameError(f'`{name}`: "{label}" has no number `{key}`; {advice}') if known else error
        if f"`{name}` names no number" in said:
            known = [f"{_quoted(entry)}.{name}" for entry, keys in _numbers(scene).items() if name in keys]
            return UnknownNameError(f"{said}; numbers of this name: {_listed(known)}" if known else said)
        if f"`{name}`: nothing in the scene is called" in said or f"has no number `{key}`" in said \
                or "in the scene file, and only numbers that stand there" in said:
            return UnknownNameError(said)
    return error


def _listed(names: list[str]) -> str:
    more = f", and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else ""
    return ", ".join(f"`{name}`" for name in names[:_MOST_LISTED]) + more


def _quoted(name: str) -> str:
    return f'"{name}"' if "." in name or "," in name else name


#: Parts of an entry whose numbers have the entry's name.
PARTS = ("cs", "config", "shape", "bsdf", "coating")


def _numbers(scene: str) -> dict[str, list[str]]:
    """Return the keys of all numbers of a scene file's text by the names of their entries."""
    try:
        document = parsed(scene)
    except ValueError:
        # The program reads more of JSON5.
        return {}
    block = document.get("nsq_gpu") or {}
    lists = [*(document.get(key) or [] for key in ("components", "sources", "detectors")), block.get("surfaces") or []]
    entries = [(entry["name"], entry) for entries in lists for entry in entries]
    entries += [pair for key in ("media", "overrides") for pair in (block.get(key) or {}).items()]
    found: dict[str, list[str]] = {}
    for name, entry in entries:
        known = found.setdefault(name, [])
        known += [key for key in _keys(entry) if key not in known]
    return found


def _keys(entry: Any, way: tuple[str, ...] = ()) -> list[str]:
    if isinstance(entry, dict):
        return [key for name, item in entry.items() if name != "reference_cs"
                for key in _keys(item, way if not way and name in PARTS else (*way, name))]
    if isinstance(entry, list):
        return [key for place, item in enumerate(entry) for key in _keys(item, (*way, str(place)))]
    is_number = isinstance(entry, int | float) and not isinstance(entry, bool)
    return [".".join(way)] if is_number else []
