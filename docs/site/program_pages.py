"""The reference that the program and the package write themselves.

A page asks for it by a comment on a line of its own, such as ``<!-- site: options -->``: in the repository the page reads
as it stands, and on the site the comment gives way to what the program says at the time of the build. The claims that
tests/house/claims.py checks are comments as well, which the site leaves out."""

import importlib
import inspect
import json
import os
import re
import subprocess
import textwrap

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

MARKER = re.compile(r"^<!-- site: (.*?) -->$", re.MULTILINE)
CLAIM = re.compile(r"^ *<!-- (?:dear )?claim: .*?-->$", re.MULTILINE | re.DOTALL)
#: What Markdown would read as its own, outside of code.
MARKDOWN = re.compile(r"([\\*_\[\]<>|$])")
CODE = re.compile(r"(`[^`]*`)")
#: How an entry of a help begins: an option or an argument, and its text where that stands on the same line.
ENTRY = re.compile(r"^ {2,6}(?P<head>[-<\[]\S*(?: \S+)*)(?: {2,}(?P<text>.*))?$")


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("source-read", expand)
    return {"parallel_read_safe": True}


def expand(app: Sphinx, page: str, source: list[str]) -> None:
    source[0] = MARKER.sub(lambda found: generated(page, found[1]), CLAIM.sub("", source[0]))


def generated(page: str, what: str) -> str:
    name, *arguments = what.split()
    if name not in WRITERS:
        raise ExtensionError(f"{page}: `site: {what}` is not known; there are {', '.join(WRITERS)}")
    return WRITERS[name](*arguments)


def said(*arguments: str) -> str:
    """What the program prints."""
    return subprocess.run([os.environ["NSQ_GPU_BINARY"], *arguments], check=True, capture_output=True, text=True).stdout


def escaped(text: str) -> str:
    """Plain text as Markdown; what stands in backticks is code."""
    return "".join(part if part.startswith("`") else MARKDOWN.sub(r"\\\1", part) for part in CODE.split(text))


def options() -> str:
    return "\n\n".join(options_of(command) for command in commands())


def commands() -> list[str]:
    listed = sections(said("--help"))["Commands"]
    return [name for name in re.findall(r"^  ([a-z]\S*) ", "\n".join(listed), re.MULTILINE) if name != "help"]


def options_of(command: str) -> str:
    parts = sections(said(command, "--help"))
    written = [f"## {command}", escaped("\n".join(parts.pop(""))), f"```{{program}} nsq-gpu {command}\n```"]
    for name, lines in parts.items():
        if name == "Usage":
            written.append("```text\n" + "\n".join(lines).strip() + "\n```")
        else:
            written += [entry(*found) for found in entries(lines)]
    return "\n\n".join(written)


def sections(text: str) -> dict[str, list[str]]:
    """The lines of a help under each of its headings; those before the first are under the empty one."""
    parts: dict[str, list[str]] = {"": []}
    name = ""
    for line in text.splitlines():
        heading = re.match(r"^(Usage|[A-Z][A-Za-z ]*(?=:$)):(?: (.*))?$", line)
        if heading:
            name = heading[1]
            parts[name] = [heading[2] or ""]
        else:
            parts[name].append(line)
    return parts


def entries(lines: list[str]) -> list[tuple[str, str]]:
    """The options of a section, each with its text."""
    found: list[tuple[str, list[str]]] = []
    for line in lines:
        start = ENTRY.match(line)
        if start:
            found.append((start["head"], [start["text"] or ""]))
        elif found:
            found[-1][1].append(line)
        elif line.strip():
            raise ExtensionError(f"a help has a line that belongs to no option: {line!r}")
    return [(head, f"{text[0]}\n{textwrap.dedent(chr(10).join(text[1:]))}".strip()) for head, text in found]


def entry(head: str, text: str) -> str:
    return f"````{{option}} {head}\n{escaped(text)}\n````"


def schema() -> str:
    root = json.loads(said("schema"))
    return "\n\n".join(described(name, part) for name, part in {"Scene file": root, **root["$defs"]}.items())


def described(name: str, part: dict) -> str:
    """A definition of the schema: its keys, or what it may be."""
    written = [f"## {name}", escaped(part.get("description", ""))]
    choices = part.get("oneOf", [])
    if "properties" in part:
        written.append(keys(part))
    elif all("properties" in choice and "const" in choice["properties"].get("type", {}) for choice in choices):
        for choice in choices:
            written.append(f"### {name}: {choice['properties']['type']['const']}")
            written += [escaped(choice.get("description", "")), keys(choice)]
    else:
        written.append("\n".join(f"- {a_kind(choice)}{explained(choice)}" for choice in choices))
    return "\n\n".join(line for line in written if line)


def explained(choice: dict) -> str:
    return f": {escaped(choice['description'])}" if "description" in choice else ""


def keys(part: dict) -> str:
    rows = ["| key | is | left out | means |", "|---|---|---|---|"]
    for key, value in part["properties"].items():
        if key != "$schema":
            name = f"**`{key}`**" if key in part.get("required", []) else f"`{key}`"
            rows.append(f"| {name} | {a_kind(value)} | {default(value)} | {escaped(value.get('description', ''))} |")
    return "\n".join(rows)


def default(value: dict) -> str:
    return f"`{json.dumps(value['default'])}`" if "default" in value else ""


def a_kind(value: dict) -> str:
    """What a value may be, in words."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if "enum" in value:
        return " or ".join(f"`{json.dumps(one)}`" for one in value["enum"])
    if "anyOf" in value or "oneOf" in value:
        return " or ".join(a_kind(one) for one in value.get("anyOf", value.get("oneOf")))
    if "properties" in value:
        return "an object of " + ", ".join(f"`{key}`, {a_kind(one)}" for key, one in value["properties"].items())
    if not isinstance(value.get("additionalProperties", False), bool):
        return f"by name: {a_kind(value['additionalProperties'])}"
    kinds = value.get("type", "any value")
    kinds = [kinds] if isinstance(kinds, str) else kinds
    return " or ".join(plain_kind(kind, value) for kind in kinds) + limits(value)


def plain_kind(kind: str, value: dict) -> str:
    if kind != "array":
        return {"null": "`null`", "string": "text", "boolean": "`true` or `false`", "integer": "whole number"}.get(kind, kind)
    size = {value.get("minItems"), value.get("maxItems")}
    many = f"{size.pop()} of" if len(size) == 1 and None not in size else "list of"
    return f"{many} {a_kind(value.get('items', {}))}"


def limits(value: dict) -> str:
    low, high = value.get("minimum"), value.get("maximum")
    if low is None and high is None:
        return ""
    if low is None or high is None:
        return f", at least {low}" if high is None else f", at most {high}"
    return f", {low} to {high}"


def members(module_name: str) -> str:
    """The public names of a module, from their docstrings: functions, classes, then exceptions and warnings."""
    module = importlib.import_module(module_name)
    names = getattr(module, "__all__", None) or own_names(module)
    for name in names:
        if not inspect.getdoc(getattr(module, name)):
            raise ExtensionError(f"{module_name}.{name} is public and has no docstring")
    directives = "\n\n".join(directive(module, name) for name in sorted(names, key=lambda name: order(module, name)))
    return f"````{{eval-rst}}\n{directives}\n````"


def own_names(module) -> list[str]:
    return [name for name, value in vars(module).items() if not name.startswith("_")
            and (inspect.isclass(value) or inspect.isfunction(value)) and value.__module__ == module.__name__]


def order(module, name: str) -> tuple[int, str]:
    value = getattr(module, name)
    if inspect.isclass(value):
        return (2 if issubclass(value, BaseException) else 1), name
    return 0, name


def directive(module, name: str) -> str:
    rank, _ = order(module, name)
    if rank == 0:
        return f".. autofunction:: {module.__name__}.{name}"
    kind = "autoclass" if rank == 1 else "autoexception"
    return f".. {kind}:: {module.__name__}.{name}\n   :members:\n   :show-inheritance:"


WRITERS = {"options": options, "schema": schema, "members": members}
