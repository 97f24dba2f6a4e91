"""Checks that documents and comments can be read once: short sentences, and no phrases that make a reader go back.

    python3 tests/house/words.py                  this tree; the exit code is 1 if anything is found
    python3 tests/house/words.py --by room        how many of each kind in each room, without the places
    python3 tests/house/words.py --only cpu       what is found in files with `cpu` in their paths
    python3 tests/house/words.py --self-test      plants errors in copies of sentences, and checks that each is found

*Long sentences* have more than 25 words. They are looked for in Markdown and in every comment of src/ and shaders/.
Headings, tables, blocks of code and the targets of links are left out. A name in backticks is one word, and so is a row
of such names: "`a`, `b` and `c`". A number with its unit is two words. A colon or a semicolon does not end a sentence.

*Banned phrases* are looked for in the same texts, and in headings and tables. Names in backticks are left out. A stacked
negation is two words such as "no", "not" or "without", with at most three words between. A comma, an "and" or an "or"
parts them, and "None if" is free.

In *texts of the program*, phrases alone are looked for: their lengths are free. These are the strings of src/, comments
above `#[arg(` or `#[command(`, which are texts of `--help`, and all strings and comments of python/nsq_gpu. Docstrings are
strings.

*Gaps* are ten spaces or more between two words of a text of the program: a line that was joined to the one before it.
"""

import argparse
import ast
import re
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MOST_WORDS = 25

DOCUMENTS = ["*.md", "docs/**/*.md", "benches/README.md", "python/**/*.md"]
# Files whose Markdown is left out, each with its reason.
NO_DOCUMENTS = {
    "target/": "builds",
    ".venv/": "builds",
}

FIRST_NEGATION = r"(?:no|not|none(?! if\b)|never|nothing|nobody|nowhere|neither|cannot)"
NEXT_NEGATION = r"(?:no|not|none|never|nothing|nobody|nowhere|neither|without|unless|cannot)"
PHRASES = {
    "tell": r"\b(?:tell|tells|told|telling)\b",
    "that of": r"\b(?:that|those) of\b",
    "none where": r"\bnone where\b",
    "negations": rf"\b{FIRST_NEGATION}(?:\s+(?!(?:and|or|nor|but)\b)[\w'`-]+){{0,3}}\s+{NEXT_NEGATION}\b",
}
GAP = re.compile(r"\w[,.;:]? {10,}\w")
# What a text has in which a phrase can be, whatever marks stand between the words: all else need not be read closely.
LIKELY = re.compile(rf"\btell|\btold|\b(?:that|those)\W+of|\bnone\W+where|\b{FIRST_NEGATION}\b.*\b{NEXT_NEGATION}\b", re.I | re.S)

# (end of the path, words of the sentence): the reason why it stays.
SCHEMA = "text of `nsq-gpu schema`, a contract"
EXCEPTIONS = {
    ("CONTRIBUTING.md", "lone, told, taken for granted"): "names the word that is banned",
    ("scene/json.rs", "in the order in which they are tried"): SCHEMA,
    ("scene/json.rs", "stands behind the element and before the next one"): SCHEMA,
    ("scene/json.rs", "Most rays that come of one launched ray"): SCHEMA,
    ("measured/mod.rs", "Azimuths about the specular direction"): SCHEMA,
    ("shapes/mod.rs", "The geometric normal points local +z"): SCHEMA,
    ("sources/pupil.rs", "which fills the entrance pupil uniformly"): SCHEMA,
}

ABBREVIATIONS = r"(?:\b(?:e\.g|i\.e|cf|vs|al|Fig|Figs|Eq|Eqs|No|Nos|Sec|Ch|Vol|pp|ca|approx|St|Dr|Mr|Inc)\.|(?:(?<=[(] )|(?<=[(])|(?<=, )|(?<=\. ))[A-Z]\.)"


def plain(text):
    """Markdown or rustdoc without its marks: a name in backticks becomes CODE, a link its text."""
    text = re.sub(r"<!--.*?-->", " ", text, flags=re.S)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", " ", text)
    text = re.sub(r"(`+)(?!`).+?(?<!`)\1(?!`)", "CODE", text, flags=re.S)
    text = re.sub(r"\$[^$\n]+\$", "CODE", text)
    for _ in range(2):
        text = re.sub(r"\[([^\[\]]*)\]\([^()\s]*(?:\([^()]*\)[^()\s]*)*\)", r"\1", text)
        text = re.sub(r"\[([^\[\]]*)\]\[[^\[\]]*\]", r"\1", text)
    text = re.sub(r"\\([\[\]_*|])", r"\1", text)
    text = re.sub(r"https?://\S+", "CODE", text)
    text = re.sub(r"</?[a-z][^>]*>", " ", text)
    text = re.sub(r"\*\*|__|(?<!\w)[*_](?=\w)|(?<=[\w.,:;?!)])\*(?!\w)", "", text)
    row = r"CODE(?:\[[^\]]*\])?"
    text = re.sub(rf"{row}(?:(?:,|;|,? (?:and|or|to|not|x))\s+{row})+", "CODE", text)
    return text


def sentences(text):
    """The sentences of a paragraph."""
    text = " ".join(plain(text).split())
    kept = re.sub(ABBREVIATIONS, lambda found: found.group().replace(".", "\0"), text)
    parts = re.split(r"(?<=[.?!])[)\"'\]]*\s+(?=[\"'(\[]*[A-Z0-9])|(?<=[.?!][)\"'])\s+(?=[\"'(\[]*[A-Z0-9])", kept)
    return [part.replace("\0", ".") for part in parts if part.strip()]


def num_words(sentence):
    return len([word for word in sentence.split() if re.search(r"\w", word)])


def cells(lines):
    """(number of its line, text) of each heading and cell of a table, where phrases are looked for, but no words counted."""
    fence = False
    for number, line in lines:
        bare = line.strip()
        fence ^= bare.startswith(("```", "~~~"))
        if not fence and bare.startswith(("|", "#")):
            yield from ((number, cell) for cell in bare.split("|"))


def paragraphs(lines):
    """(number of its first line, text) of each paragraph and list item; `lines` are (number, text)."""
    start, held, fence = None, [], None
    for number, line in lines:
        bare = line.strip()
        mark = re.match(r"(`{3,}|~{3,}|:{3,})", bare)
        if fence:
            if mark and bare.startswith(fence) and not bare.strip(fence[0]):
                fence = None
            continue
        ends = not bare or mark or re.match(r"#{1,6}\s|\||</?(?:p|img|a|div|details|summary)\b|---+$|\[[^\]]+\]:\s|\([\w-]+\)=$", bare)
        item = re.match(r"(?:[-*+]|\d+[.)])\s+(.*)", bare)
        if (ends or item) and held:
            yield start, "\n".join(held)
            held = []
        if mark:
            fence = mark.group(1) if bare[0] != ":" else None
        elif not ends:
            if not held:
                start = number
            held.append(re.sub(r"^>\s?", "", item.group(1) if item else bare))
    if held:
        yield start, "\n".join(held)


def without_front_matter(text):
    lines = list(enumerate(text.splitlines(), 1))
    if lines and lines[0][1] == "---":
        end = next((i for i, (_, line) in enumerate(lines[1:], 1) if line == "---"), 0)
        lines = lines[end + 1 :]
    hidden, in_list, is_code, kept = False, False, False, []
    for number, line in lines:
        hidden = hidden or line.startswith("<!--")
        # An indented block of code begins below an empty line, and not within an item of a list.
        is_code = re.match(r" {4}|\t", line) and not in_list and (is_code or not kept or not kept[-1][1].strip())
        if re.match(r"\S", line):
            in_list = re.match(r"(?:[-*+]|\d+[.)])\s", line) is not None
        kept.append((number, "" if hidden or is_code else line))
        if "-->" in line:
            hidden = False
    return kept


# A string, a character, or a comment of Rust or WGSL.
TOKEN = re.compile(r'b?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|\'(?:\\.[^\']*|[^\\\'])\'|(//[^\n]*|/\*.*?\*/)', re.S)


def comments(text):
    """The lines of each block of comments, as (number, text)."""
    blocks, last = [], None
    for found in TOKEN.finditer(text):
        comment = found.group(2)
        if comment is None:
            continue
        number = text.count("\n", 0, found.start()) + 1
        mark = re.match(r"//[/!]?|/\*[*!]?", comment).group()
        begins = text.rfind("\n", 0, found.start()) + 1
        alone = not text[begins : found.start()].strip()
        body = comment[len(mark) :].removesuffix("*/")
        lines = [(number + i, re.sub(r"^ ?", "", line)) for i, line in enumerate(body.split("\n"))]
        if last is not None and alone and last[0] == mark and last[1] == number - 1:
            blocks[-1].extend(lines)
        else:
            blocks.append(lines)
        last = (mark, number) if alone else None
    return blocks


def rust_strings(text):
    """(number of its first line, text) of each string of Rust."""
    for found in TOKEN.finditer(text):
        string = re.fullmatch(r'b?(r?)#*"(.*)"#*', found.group(), re.S)
        if string:
            body = string.group(2)
            if not string.group(1):
                # A backslash at the end of a line joins it to the next one.
                body = re.sub(r"\\\n\s*", "", body)
                body = re.sub(r"\\(.)", lambda escape: "\n" if escape.group(1) == "n" else escape.group(1), body)
            # What a format shows is CODE.
            yield text.count("\n", 0, found.start()) + 1, re.sub(r"\{[\w.]*(?::[^{}\n]*)?\}", "CODE", body)


def python_texts(text):
    """(number of its first line, text) of each string and each block of comments of Python. What f-strings show is CODE."""
    # Lines within strings are no comments.
    inside = set()
    nodes = [ast.parse(text)]
    while nodes:
        node = nodes.pop()
        parts = node.values if isinstance(node, ast.JoinedStr) else [node]
        texts = [part.value if isinstance(part, ast.Constant) else "CODE" for part in parts]
        if isinstance(node, (ast.JoinedStr, ast.Constant)) and all(isinstance(part, str) for part in texts):
            inside.update(range(node.lineno + 1, node.end_lineno + 1))
            yield node.lineno, "".join(texts)
        # A string within braces of an f-string is a string of its own.
        nodes += (child for child in ast.iter_child_nodes(node)
                  if not (isinstance(node, ast.JoinedStr) and isinstance(child, ast.Constant)))
    start, held = None, []
    for number, line in enumerate(text.splitlines() + [""], 1):
        alone = re.match(r"\s*#:?\s*(.*)", line) if number not in inside else None
        if not alone and held:
            yield start, " ".join(held)
            held = []
        if alone:
            start = start if held else number
            held.append(alone.group(1))
        elif number not in inside and (after := re.search(r"\s{2}#:? (.*)", line)):
            yield number, after.group(1)


def is_help(source, last):
    """True if a comment that ends in this line is what `--help` says."""
    following = next((line.strip() for line in source[last:] if line.strip()), "")
    return following.startswith(("#[arg(", "#[command("))


def findings(path, text):
    """(line, kind, sentence) of what is wrong in a file."""
    for counted, number, paragraph in texts(path, text):
        if not counted and not path.endswith(".md") and GAP.search(paragraph):
            yield number, "gap", paragraph.strip()
        if not counted and not path.endswith(".md") and not LIKELY.search(paragraph):
            continue
        for sentence in sentences(paragraph):
            if any(path.endswith(end) and words in sentence for end, words in EXCEPTIONS):
                continue
            # The line is the paragraph's: a sentence may begin anywhere in a line.
            words = num_words(sentence)
            if counted and words > MOST_WORDS:
                yield number, "long", f"({words} words) {sentence}"
            for kind, pattern in PHRASES.items():
                # Python's None is a value, such as "None for no limit".
                searched = re.sub(r"\bNone\b", "CODE", sentence) if kind == "negations" and path.endswith(".py") else sentence
                if re.search(pattern, searched, re.I):
                    yield number, kind, sentence


def texts(path, text):
    """(whether words are counted, number of the first line, text) of each text of a file that is read."""
    if path.endswith(".py"):
        for number, string in sorted(python_texts(text)):
            yield from ((False, number, part) for part in re.split(r"\n\s*\n", string))
        return
    blocks = [without_front_matter(text)] if path.endswith(".md") else comments(text)
    source = text.splitlines()
    for lines in blocks:
        counted = path.endswith(".md") or not is_help(source, lines[-1][0])
        yield from ((counted, *found) for found in paragraphs(lines))
        yield from ((False, *found) for found in cells(lines))
    if path.endswith(".rs"):
        for number, string in rust_strings(text):
            yield from ((False, number, part) for part in string.split("\n"))


def files():
    found = set()
    for pattern in DOCUMENTS:
        found |= set(ROOT.glob(pattern))
    found |= set((ROOT / "src").rglob("*.rs")) | set((ROOT / "shaders").rglob("*.wgsl"))
    found |= set((ROOT / "python/nsq_gpu").rglob("*.py"))
    for path in sorted(found):
        name = path.relative_to(ROOT).as_posix()
        if not any(part in f"{name}/" for part in NO_DOCUMENTS) and not name.startswith("."):
            yield name, path.read_text(encoding="utf-8")


def room(path):
    parts = path.split("/")
    return "/".join(parts[:2]) if len(parts) > 2 else parts[0] if len(parts) == 2 else "top"


LONG = "One two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen " \
    "seventeen eighteen nineteen twenty one two three four five"
# (path, text, kinds that must be found).
PLANTED = [
    ("a.md", f"{LONG}.\n", []),
    ("a.md", f"{LONG} six.\n", ["long"]),
    ("a.md", f"Short.\n\n- An item: {LONG}.\n", ["long"]),
    ("a.md", f"It ends here. {LONG} [six](seven eight).\n", ["long"]),
    ("a.md", f"```\n{LONG} six tells.\n```\n\n| {LONG} six |\n|---|\n\n## {LONG} six\n", []),
    ("a.md", f"{LONG.replace('twenty', '`a`, `b c d` and `e`')}.\n", []),
    ("a.md", f"Short:\n\n    {LONG} six\n    seven.\n\n- An item\n\n    that tells.\n", ["tell"]),
    ("a.md", "| it | tells |\n|---|---|\n| none | where |\n\n## What is told\n", ["tell", "tell"]),
    ("a.md", "The line tells\nnothing new.\n", ["tell"]),
    ("a.md", "The name `told` stays.\n", []),
    ("a.rs", f"//! {LONG}\n//! six.\n", ["long"]),
    ("a.rs", f"//! Short.\n\n/// {LONG} six.\nfn a() {{}}\n", ["long"]),
    ("a.rs", "/// The share, and that\n/// of the rest.\nfn a() {}\n", ["that of"]),
    ("a.rs", f'let a = "// {LONG} six"; // The result; none where it failed.\n', ["none where"]),
    ("a.rs", "let a = '\"'; // It is told.\nlet b = 'c';\n", ["tell"]),
    ("a.rs", f'let a = r#"b " // {LONG} six"#; /* It is not without use. */\n', ["negations"]),
    ("a.rs", "// It is not here, nor there. No, it has no use.\n", []),
    ("a.rs", "/// None if there is no file.\nfn a() {}\n", []),
    ("a.rs", "/// The text that is told.\n#[arg(long)]\na: u32,\n", ["tell"]),
    ("a.rs", f"/// {LONG} six.\n#[command(name = \"a\")]\nenum A {{}}\n", []),
    ("a.rs", f'let a = "{LONG} six";\n', []),
    ("a.rs", 'let told = name.told("a"); let a = \'"\'; let b = \'"\';\n', []),
    ("a.rs", 'refuse("its error is above that of the map");\n', ["that of"]),
    ("a.rs", 'format!("its error is above that \\\n         of the map: {told}");\n', ["that of"]),
    ("a.rs", 'say(r#"the "map" tells"#);\n', ["tell"]),
    ("a.rs", 'say("one\\nno map without\\ntold");\n', ["negations", "tell"]),
    ("a.rs", 'say("see `told`; no map; none if it is dark");\n', []),
    ("a.rs", "/// The text that is told.\n#[inline]\nfn a() {}\n", ["tell"]),
    ("a.rs", 'say("a line, joined            to the next one\\n  deg    W");\n', ["gap"]),
    ("a.wgsl", f"// {LONG} six.\nfn a() {{}}\n", ["long"]),
    ("a.wgsl", f"fn a() {{}}\n// {LONG} six; those of the rest.\n", ["long", "that of"]),
    ("a.py", f'"""{LONG} six."""\n#: {LONG} six.\na = told.that  # {LONG} six.\n', []),
    ("a.py", 'def tell(told):\n    """Return what is told."""\n', ["tell"]),
    ("a.py", 'def a():\n    """Return it.\n\n    Args:\n        b: Those\n            of c.\n    """\n', ["that of"]),
    ("a.py", 'raise Error("its error is above that "\n            "of the map")\n', ["that of"]),
    ("a.py", 'raise Error(f"{told} is no map {told:{told}} without {that} of")\n', ["negations"]),
    ("a.py", "a = f\"{b('that of c')} # told\"  # d\n", ["tell", "that of"]),
    ("a.py", "a = 1  # the one that is told\n#: As that\n#: of b.\n", ["tell", "that of"]),
    ("a.py", 'a = """b\n# told in a text\n"""\n', ["tell"]),
    ("a.py", "#: Limit; None for no limit. None is not known.\na = None\n", []),
    ("a.py", '#: Limit; None where it is free.\na = "told" if 0 else None\n', ["none where", "tell"]),
]


def self_test():
    wrong = 0
    for path, text, kinds in PLANTED:
        found = [kind for _, kind, _ in findings(path, text)]
        if found != kinds:
            wrong += 1
            print(f"PLANTED {kinds} in {path}, found {found}: {text!r}")
    print(f"{len(PLANTED)} planted texts, {wrong} judged wrongly")
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--self-test", action="store_true", help="check the check")
    parser.add_argument("--by", choices=["room", "file"], help="counts alone")
    parser.add_argument("--only", default="", help="files with this in their paths")
    options = parser.parse_args()
    if options.self_test:
        return 1 if self_test() else 0
    counts = Counter()
    used = set()
    for path, text in files():
        used |= {key for key in EXCEPTIONS if path.endswith(key[0]) and key[1] in " ".join(plain(text).split())}
        if options.only not in path:
            continue
        for line, kind, sentence in findings(path, text):
            counts[room(path) if options.by == "room" else path, kind] += 1
            if not options.by:
                print(f"{path}:{line}: {kind}: {sentence}")
    kinds = ["long", *PHRASES, "gap"]
    if options.by:
        print(f"| {'where':44} | {' | '.join(kinds)} |\n|---|{'---|' * len(kinds)}")
        for where in sorted({where for where, _ in counts}):
            print(f"| {where:44} | {' | '.join(str(counts[where, kind]) for kind in kinds)} |")
    unused = [key for key in EXCEPTIONS if key not in used]
    for key in unused:
        print(f"{key}: an exception that nothing needs")
    totals = {kind: sum(num for (_, of), num in counts.items() if of == kind) for kind in kinds}
    print(", ".join(f"{kind}: {num}" for kind, num in totals.items()))
    return 1 if sum(totals.values()) or unused else 0


if __name__ == "__main__":
    sys.exit(main())
