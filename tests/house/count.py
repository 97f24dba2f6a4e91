"""Counts what a newcomer has to read and to hold in mind, by rules that hold for any version of the code.

    python3 tests/house/count.py                        this tree
    python3 tests/house/count.py OTHER --way FILE       another tree, whose way to the device stands in FILE

*Lines* are those with code or a comment; empty lines are none. What is between `#[cfg(test)]` and the end of its item is left
out, and so is a file that such an item names (`mod tests;`). Of benches/, results/, tests/ and data are left out.

*Types on the way* of a plain trace, from the scene file to the device. The way is a list of functions, tests/house/way.txt. A star
marks what a user of the library calls; each other function is called by a function before it, which is checked. Counted are the
structs, enums and traits of src/ that these functions name in their signatures or are methods of.

*Loops that dispatch* are files with a loop over ranges of rays that hands them to the device. Such a loop calls a submitter, itself
or by functions of its file, and makes ranges or goes over them. Submitters are what is called submit, submit_..., dispatch, or the `trace` of a
strategy or an addition. The rooms are the engine and its additions.

*Ways in which WGSL varies* are mechanisms that decide which text or module a scene gets, beside constants and calls: a table of
slots; files that an extension puts in the place of a slot's own; renaming of functions in text; other replacing in text;
rewriting of naga's representation. Each is found by the words of `MECHANISMS`, and shown with the number of its places.
"""

import argparse
import re
import sys
from collections import defaultdict
from pathlib import Path

HERE = Path(__file__).parent
# `software` is the name that the room `cpu` had in older trees.
SUBMITTING_ROOMS = {"engine", "cpu", "software", "paths", "derivatives", "guide"}
SUBMITTER = r"\b(?:submit(?:_\w+)?|dispatch)\(|\b(?:strategy|additions?|addition\.\w+)\.trace\("
CUTS_RANGES = r"\bfor range in\b|\blet range\b|\bRayRange(?:::of\(| \{)"
MECHANISMS = {
    # Slots with a table of their twins.
    "slots": (r"^\s*\"[a-z_]+/[a-z_]+\"\s+\[", "src/program"),
    "files in the place of a slot's": (r"\bfn replaces\s*\(", "src"),
    "renaming in text": (r"\btext\.rename\(", "src"),
    "replacing in text": (r"\b(?:statement|text|wgsl|row|line|source\(\))\.replace\(", "src/program src/cpu src/software src/engine src/paths src/derivatives src/guide"),
    "rewriting of the representation": (r"\bpub(?:\([a-z ]+\))? fn rewrite\s*\(", "src"),
}


def blanked(text):
    """Rust with comments and the insides of strings blanked; lines stay where they are."""
    out, i, n = [], 0, len(text)
    keep_lines = lambda piece: "".join(c if c == "\n" else " " for c in piece)  # noqa: E731
    while i < n:
        c = text[i]
        if text.startswith("//", i):
            end = text.find("\n", i)
            end = n if end < 0 else end
            out.append(keep_lines(text[i:end]))
        elif text.startswith("/*", i):
            end = text.find("*/", i)
            end = n if end < 0 else end + 2
            out.append(keep_lines(text[i:end]))
        elif c == '"' or (c in "rb" and re.match(r'(?:b?r#*"|b")', text[i : i + 8]) and (i == 0 or not (text[i - 1].isalnum() or text[i - 1] == "_"))):
            raw = re.match(r'b?r(#*)"', text[i : i + 8])
            if raw:
                close = '"' + raw.group(1)
                end = text.find(close, i + raw.end()) + len(close)
            else:
                end = text.index('"', i) + 1
                while text[end] != '"':
                    end += 2 if text[end] == "\\" else 1
                end += 1
            out.append('"' + keep_lines(text[i + 1 : end - 1]) + '"')
        elif c == "'" and re.match(r"'(?:\\.[^']*|[^\\'])'", text[i : i + 12]):
            end = i + re.match(r"'(?:\\.[^']*|[^\\'])'", text[i : i + 12]).end()
            out.append("' " + " " * (end - i - 3) + "'")
        else:
            out.append(c)
            end = i + 1
        i = end
    return "".join(out)


def closing(code, opening):
    """The position after the brace that closes the one at `opening`."""
    depth = 0
    for i in range(opening, len(code)):
        depth += {"{": 1, "}": -1}.get(code[i], 0)
        if depth == 0:
            return i + 1
    return len(code)


class Source:
    """A file of Rust without its tests."""

    def __init__(self, path, root):
        self.path = path.relative_to(root)
        text = path.read_text()
        code = blanked(text)
        self.num_test_lines, self.test_files = 0, []
        for match in reversed(list(re.finditer(r"#\[cfg\(test\)\]", code))):
            end = min((i for i in (code.find("{", match.end()), code.find(";", match.end())) if i >= 0), default=len(code))
            named = re.search(r"\bmod\s+(\w+)\s*$", code[match.end() : end])
            if code[end : end + 1] == "{":
                end = closing(code, end)
            elif named:
                self.test_files.append(named.group(1))
            test = text[match.start() : end + 1]
            self.num_test_lines += sum(1 for line in test.splitlines() if line.strip())
            text, code = text[: match.start()] + text[end + 1 :], code[: match.start()] + code[end + 1 :]
        self.text, self.code = text, code

    def lines(self):
        """The numbers of lines with code, and with a comment alone."""
        pairs = [(line, bare) for line, bare in zip(self.text.splitlines(), self.code.splitlines()) if line.strip()]
        comments = sum(1 for line, bare in pairs if not bare.strip())
        return len(pairs) - comments, comments


def sources(root, folder):
    files = [Source(path, root) for path in sorted((root / folder).rglob("*.rs")) if not set(path.relative_to(root).parts[1:]) & {"results", "tests", "target"}]
    tests = set()
    for file in files:
        base = file.path.parent if file.path.name in ("mod.rs", "lib.rs", "main.rs") else file.path.with_suffix("")
        tests |= {base / f"{name}.rs" for name in file.test_files}
    return [file for file in files if file.path not in tests]


def plain_lines(paths, comment):
    """The same of files of WGSL or Python."""
    code = comments = 0
    for path in paths:
        for line in path.read_text().splitlines():
            if line.strip().startswith(comment):
                comments += 1
            elif line.strip():
                code += 1
    return code, comments


class Function:
    def __init__(self, file, owner, name, signature, body):
        self.file, self.owner, self.name, self.signature, self.body = file, owner, name, signature, body

    def calls(self, name):
        return re.search(rf"\b{name}\s*(?:::<[^>]*>)?\(", self.body) is not None

    def is_called(self, qualified):
        owner, name = qualified.rsplit("::", 1)
        path = self.file.path
        stem = path.parent.name if path.name == "mod.rs" else path.stem
        return self.name == name and owner in (self.owner, stem, f"{path.parent.name}/{stem}")


def functions(files):
    found = []
    for file in files:
        code = file.code
        owners = []
        for match in re.finditer(r"^[ \t]*(?:unsafe )?(?:pub(?:\([^)]*\))? )?(?:impl|trait)\b([^{;]*)\{", code, re.M):
            head = re.sub(r"<[^<>]*(?:<[^<>]*>[^<>]*)*>", "", match.group(1))
            head = head.split(" for ")[-1].split(" where ")[0].split(":")[0]
            name = re.findall(r"[A-Z]\w*", head)
            owners.append((match.end() - 1, closing(code, match.end() - 1), name[0] if name else ""))
        for match in re.finditer(r"\bfn\s+(\w+)", code):
            depth, end = 0, match.end()
            while end < len(code) and not (depth == 0 and code[end] in "{;"):
                depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(code[end], 0)
                end += 1
            body = code[end : closing(code, end)] if code[end : end + 1] == "{" else ""
            inside = [name for start, stop, name in owners if start < match.start() < stop]
            found.append(Function(file, inside[-1] if inside else "", match.group(1), code[match.end() : end], body))
    return found


def loops(body):
    """The bodies of a function's loops."""
    for match in re.finditer(r"\b(?:for\b[^;{}]*\bin\b[^{;]*|while\b[^{]*|loop\s*)\{", body):
        yield body[match.start() : closing(body, match.end() - 1)]
    for match in re.finditer(r"\b(?:try_)?for_each\(", body):
        depth, end = 1, match.end()
        while end < len(body) and depth:
            depth += {"(": 1, ")": -1}.get(body[end], 0)
            end += 1
        yield body[match.start() : end]


def types_on_the_way(files, way):
    known = set()
    for file in files:
        known |= set(re.findall(r"\b(?:struct|enum|trait)\s+([A-Z]\w*)", file.code))
    all_functions = functions(files)
    hops, problems = [], []
    for line in way:
        qualified = line.lstrip("* ")
        matching = [function for function in all_functions if function.is_called(qualified)]
        # With and without a cargo feature, a function stands twice in a file.
        if len(matching) != 1 and len({function.file for function in matching}) != 1:
            problems.append(f"{qualified}: {len(matching)} functions of that name")
            continue
        function = matching[0]
        if qualified == line and not any(hop.calls(function.name) for hop in hops):
            problems.append(f"{qualified}: no function before it calls it")
        hops.append(function)
    types = []
    for hop in hops:
        names = [hop.owner, *re.findall(r"\b[A-Z]\w*", hop.signature)]
        types += [name for name in dict.fromkeys(names) if name in known and name not in types]
    return types, len(hops), problems


def dispatching_loops(files):
    rooms = [file for file in files if len(file.path.parts) > 1 and file.path.parts[1] in SUBMITTING_ROOMS]
    by_file = defaultdict(list)
    for function in functions(rooms):
        by_file[function.file.path].append(function)
    found = []
    for path, own in by_file.items():
        others = [function for function in own if not re.fullmatch(SUBMITTER, f"{function.name}(")]

        def with_called(text, seen=frozenset()):
            called = [f for f in others if f.name not in seen and re.search(rf"\b{f.name}\(", text)]
            seen |= {f.name for f in called}
            return text + "".join(with_called(f.body, seen) for f in called)

        bodies = [(f.name, with_called(body)) for f in others for body in loops(f.body)]
        names = [name for name, body in bodies if re.search(SUBMITTER, body) and re.search(CUTS_RANGES, body)]
        if names:
            found.append(f"{path}: {', '.join(dict.fromkeys(names))}")
    return found


def mechanisms(files):
    found = {}
    for name, (pattern, folders) in MECHANISMS.items():
        within = [file for file in files if any(str(file.path).startswith(folder) for folder in folders.split())]
        # Strings are what is looked for, so comments alone are left out.
        places = sum(len(re.findall(pattern, re.sub(r"//[^\n]*", "", file.text), re.M)) for file in within)
        if places:
            found[name] = places
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tree", nargs="?", type=Path, default=HERE.parents[1])
    parser.add_argument("--way", type=Path, default=HERE / "way.txt", help="the functions on the way to the device")
    options = parser.parse_args()
    root = options.tree.resolve()
    src = sources(root, "src")
    rows = defaultdict(lambda: [0, 0, 0])

    def add(row, code, comments, tests=0):
        rows[row] = [a + b for a, b in zip(rows[row], (code, comments, tests))]

    for file in src:
        room = f"src/{file.path.parts[1]}" if len(file.path.parts) > 2 else "src, root"
        add(room, *file.lines(), file.num_test_lines)
    add("shaders", *plain_lines(sorted((root / "shaders").rglob("*.wgsl")), "//"))
    for file in sources(root, "benches"):
        add("benches, Rust", *file.lines(), file.num_test_lines)
    python = [path for path in sorted((root / "benches").rglob("*.py")) if not set(path.relative_to(root).parts) & {"results", "tests"}]
    add("benches, Python", *plain_lines(python, "#"))
    print(f"| {'room':22} | code | comment | both | its tests |\n|---|---|---|---|---|")
    for row, (code, comments, tests) in rows.items():
        print(f"| {row:22} | {code:,} | {comments:,} | {code + comments:,} | {tests:,} |")
    code, comments = (sum(row[i] for row in rows.values()) for i in (0, 1))
    print(f"| {'all of these':22} | {code:,} | {comments:,} | **{code + comments:,}** | |")
    tools = plain_lines(sorted((root / "python/tools").glob("*.py")), "#")
    print(f"| {'(not in it: python/tools)':22} | {tools[0]:,} | {tools[1]:,} | {sum(tools):,} | |\n")
    way = [line.strip() for line in options.way.read_text().splitlines() if line.strip() and not line.startswith("#")]
    types, num_hops, problems = types_on_the_way(src, way)
    print(f"types on the way of a plain trace: {len(types)}, by {num_hops} functions\n  {', '.join(types)}")
    found = dispatching_loops(src)
    print(f"loops that dispatch: {len(found)}")
    print("".join(f"  {loop}\n" for loop in found), end="")
    ways = mechanisms(src)
    print(f"ways in which WGSL varies: {len(ways)}\n  {', '.join(f'{name} ({num})' for name, num in ways.items())}")
    for problem in problems:
        print(f"NOT THE WAY: {problem}")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
