"""Checks that figures in the documents are those that commands print and that the source has.

    NSQ_GPU_BINARY=target/debug/nsq-gpu python3 tests/house/claims.py    the cheap claims; the exit code is 1 if one is false
    python3 tests/house/claims.py --dear          also those that take long
    python3 tests/house/claims.py --only start    the claims of files with `start` in their paths
    python3 tests/house/claims.py --self-test     plants false claims, and checks that each is found

A claim is a comment that begins a line, below the sentence, the table or the block of code that it is about:

    <!-- claim: COMMAND => WHAT IT PRINTS == WHAT THE TEXT SAYS -->

Both sides are patterns. `#` is a number, in digits or as a word; `#%` is one in percent; `~#` is one whose last zeros are
rounded; `*` is anything on the line. The text is searched from the marker up to the heading above. Each number of the text
must be the printed one, rounded to the digits that the text has. Numbers stand in the text alone: text and claim cannot drift.

    <!-- claim: file src/engine/rounds.rs => MOST: usize = # == at most # rounds -->     a file of the repository
    <!-- claim: count scenes/*.json => # == the # scenes -->                             the number of files
    <!-- claim: printed -->                the block or the table above is printed by its own `$` lines, or by the block before
    <!-- claim: printed by COMMAND -->     or by this command; `except A or B` leaves out lines that hold such a pattern
    <!-- claim: run -->                    runs the block above, for what it leaves behind

In a block `...` stands for anything. `dear claim:` marks what takes long. The commands of a page run one after the other in
one temporary folder, with links to the repository's folders, which no command may change. Figures of traces are those of a
processor: where a graphics processor comes first, claims about the source alone are looked at.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = ["*.md", "docs/**/*.md", "benches/*.md", "scenes/*.md"]
MARKER = re.compile(r"(?<!`)<!-- (dear )?claim: (.*?)\s*-->", re.S)
FENCE = re.compile(r"^( *)(```+)(\S*)[^\n]*\n(.*?)^\1\2 *$", re.M | re.S)
TABLE = re.compile(r"^(?:\|[^\n]*\n)+", re.M)
WORDS = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen " \
    "eighteen nineteen twenty".split()
NUMBER = rf"(?<!\d)[-+]?\d[\d,_]*(?:\.\d+)?(?:e[-+]?\d+)?(?:\^-?\d+|\s<<\s\d+)?(?!\d)|\b(?:{'|'.join(WORDS)})\b"


def pattern(text, anything=r"[^\n]*?"):
    """A pattern of a claim as a regular expression."""
    known = {"#": f"({NUMBER})", "~#": f"({NUMBER})", "#%": rf"({NUMBER})\s?%", "*": anything}
    parts = re.split(r"(~#|#%|#|\*|\s+)", text.strip())
    return re.compile("".join(known.get(part, r"\s+" if part.isspace() else re.escape(part)) for part in parts if part), re.I)


def value(text):
    """A number, and half of what its last digit stands for."""
    text = re.sub("[_,]", "", text.lower())
    power = re.fullmatch(r"([-+]?\d+)(\^|\s<<\s)(-?\d+)", text)
    if text in WORDS or power:
        return (float(WORDS.index(text)) if not power else
                float(power[1]) ** int(power[3]) if power[2] == "^" else float(power[1]) * 2.0 ** int(power[3])), 0.0
    mantissa, _, exponent = text.partition("e")
    decimals, exponent = len(mantissa.partition(".")[2]), int(exponent or 0)
    return float(text), 0.0 if not decimals and exponent > 0 else 0.5 * 10.0 ** (exponent - decimals)


def compare(printed, said, output, text):
    """What is wrong with a claim, or None."""
    left, right = pattern(printed), pattern(said, ".*?")
    if not left.groups or left.groups != right.groups:
        return "each `#` of one side needs one on the other"
    found, shown = left.search(output), list(right.finditer(text))
    if not shown or not found:
        return f"nothing printed is like {printed!r}: {output[-400:]!r}" if shown else f"the text does not say {said!r}"
    for mark, number, of_text in zip(re.findall(r"~#|#%|#", said), found.groups(), shown[-1].groups()):
        unit, (a, _) = 0.01 if mark == "#%" else 1.0, value(number)
        b, half = (unit * part for part in value(of_text))
        digits = of_text.replace(",", "")
        half = 0.5 * 10.0 ** (len(digits) - len(digits.rstrip("0"))) if mark == "~#" else half
        if abs(a - b) > half * (1 + 1e-9) + 1e-9 * abs(a):
            return f"the text says {of_text}, and printed is {number}"
    return None


def compare_lines(shown, output, left_out):
    """What of a block of code was not printed, in its order, or None."""
    shown, printed = ([" ".join(line.split()) for line in text.splitlines()] for text in (shown, output))
    shown = [line for line in shown if line not in ("", "...") and not any(pattern(one).search(line) for one in left_out)]
    at = 0
    for line in shown:
        wanted = re.compile(".*".join(re.escape(part) for part in line.split("...")))
        place = next((i for i in range(at, len(printed)) if wanted.fullmatch(printed[i])), None)
        if place is None:
            alike = next((other for other in printed if other.split()[:1] == line.split()[:1]), output[-300:])
            return f"not printed: {line!r}, but {alike!r}"
        at = place + 1
    return None if shown else "the block has no line to look for"


def commands(kind, body):
    """The commands of a block of code, and what it shows of their output."""
    if kind == "python":
        return ["python3 - <<'END'\n" + body + "END"], ""
    lines = re.sub(r"\\\n\s*", "", body).splitlines()
    own = [re.sub(r"\s+# .*", "", line[2:]) for line in lines if line.startswith("$ ")]
    return own, "\n".join(line for line in lines if not line.startswith("$ "))


def claims(page):
    """(line, whether it is dear, its text, what stands above it up to a heading, blocks and tables above) of each claim."""
    fences = [(found.start(), found.end(), found[3], found[4]) for found in FENCE.finditer(page)]
    is_code = lambda at: any(start < at < end for start, end, _, _ in fences)  # noqa: E731
    tables = [(found.start(), found.end(), "table", found[0]) for found in TABLE.finditer(page) if not is_code(found.start())]
    headings = [0, *(found.start() for found in re.finditer(r"^#+ ", page, re.M) if not is_code(found.start()))]
    for found in MARKER.finditer(page):
        start = found.start()
        if not is_code(start):
            above = page[max(at for at in headings if at <= start) : start]
            begins = not page[page.rfind("\n", 0, start) + 1 : start].strip()
            # Markdown without the marks that stand between the words of a sentence.
            plain = re.sub(r"\[([^\[\]]*)\]\([^()]*\)", r"\1", MARKER.sub(" ", above))
            plain = " ".join(re.sub(r"[`\\]|\*\*", "", plain).split())
            yield page.count("\n", 0, start) + 1, found[1], " ".join(found[2].split()) if begins else None, plain, \
                [(kind, body) for _, end, kind, body in sorted(fences + tables) if end <= start]


def fault(claim, text, blocks, run):
    """What is wrong with a claim, or None. `run` gives what a command prints."""
    if claim is None:
        return "a claim begins its line"
    form = re.fullmatch(r"(printed|run)(?: by (.*?))?(?: except (.*))?", claim)
    if not form:
        parts = re.fullmatch(r"(.*?) => (.*) == (.*)", claim)
        return compare(parts[2], parts[3], run(parts[1]), text) if parts else "a claim is COMMAND => ... == ..."
    own, shown = commands(*blocks[-1]) if blocks else ([], "")
    if not own and form[1] == "printed":
        own = next((found for block in blocks[-2::-1] if (found := commands(*block)[0])), [])
    if not own and not form[2]:
        return "no block above has a command"
    output = run(form[2] or "\n".join(own))
    return None if form[1] == "run" else compare_lines(shown, output, form[3].split(" or ") if form[3] else [])


def runner(folder):
    """What runs the commands of a page in this folder."""
    program, done = Path(os.environ.get("NSQ_GPU_BINARY") or ROOT / "target/debug/nsq-gpu").resolve(), {}
    for entry in ROOT.iterdir():
        if not entry.name.startswith(".") and not entry.name.endswith("-out"):
            (folder / entry.name).symlink_to(entry)
    variables = os.environ | {"NSQ_GPU_BINARY": str(program), "PYTHONPATH": str(ROOT / "python"), "PATH": os.pathsep.join(
        [str(program.parent), str(Path(sys.executable).parent), os.environ["PATH"]])}

    def run(command):
        kind, _, rest = command.partition(" ")
        if kind == "file":
            return (ROOT / rest).read_text(encoding="utf-8")
        if kind == "count":
            return str(len(list(ROOT.glob(rest))))
        if command not in done:
            done[command] = subprocess.run(["bash", "-c", command], cwd=folder, env=variables, text=True, check=False,
                                           stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT).stdout
        return done[command]

    return run


PRINTED = {"a": "flux   0.6745404  844,137 rays\nsize 1 << 20\n1 warning\n", "b": "  one   1.25 W\nother\n",
           "c": "68.99\nshare 0.69\n", "d": "| d |\n|---|\n| 5 |\n"}
BLOCK, FLUX = "```console\n$ b\none 1.25 W\n```\n", "<!-- claim: a => flux # == flux of # W -->"
# Pages whose claims are true, and pages whose claims are false.
TRUE = [
    f"A flux of 0.6745 W.\n{FLUX}\n", f"```\n{FLUX}\n```\nA flux of 1 W: `{FLUX}`\n",
    "So `844,137` rays\nhave 0.675 W.\n<!-- claim: a => flux * # rays == So # rays have -->\n",
    "At most 1,048,576, or 2^20.\n<!-- claim: a => size # == most #, or -->\n<!-- claim: a => size # == or # -->\n",
    "There is one warning.\n<!-- claim: a => # warning == is # warning -->\n",
    "It is 69 %, about 70.\n<!-- claim: c => share # == is #%, -->\n<!-- claim: c => # == about ~# -->\n",
    f"{BLOCK}\n<!-- claim: printed -->\n", "| d |\n|---|\n| 5 |\n\n<!-- claim: printed by d -->\n",
    "```\nother\none 1.26 W\n```\n<!-- claim: printed by b except two or one -->\n",
    "```console\n$ b\n```\nText:\n```\none ... W\nother\n```\n<!-- claim: printed -->\n",
]
FALSE = [
    f"A flux of 0.6746 W.\n{FLUX}\n", f"A flux of 0.67454041 W.\n{FLUX}\n", f"A flux of 0.6745 W.\n## Next\n{FLUX}\n",
    f"A flux of 0.6745 W. {FLUX}\n", f"A flux of 0.6745 W.\n{FLUX.replace(' == ', ' = ')}\n",
    "So 844,138 rays.\n<!-- claim: a => * # rays == So # rays -->\n", "So 5.\n<!-- claim: a => watts # == So # -->\n",
    "At most 2^21.\n<!-- claim: a => size # == most # -->\n", "Two warnings.\n<!-- claim: a => # warning == # warnings -->\n",
    "It is 70 %.\n<!-- claim: c => share # == is #% -->\n", "About 70.\n<!-- claim: c => # == About # -->\n",
    f"{BLOCK.replace('25', '26')}\n<!-- claim: printed -->\n", f"{BLOCK}\n<!-- claim: printed except one -->\n",
    "| d |\n|---|\n| 6 |\n\n<!-- claim: printed by d -->\n",
    "```\nother\none 1.25 W\n```\n<!-- claim: printed by b -->\n",
]


def self_test():
    wrong = 0
    for page in TRUE + FALSE:
        found = [fault(claim, text, blocks, PRINTED.__getitem__) for _, _, claim, text, blocks in claims(page)]
        if any(found) != (page in FALSE):
            wrong += 1
            print(f"PLANTED {page!r}, found {found}")
    print(f"{len(TRUE + FALSE)} planted pages, {wrong} judged wrongly")
    return 1 if wrong else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--self-test", action="store_true", help="check the check")
    parser.add_argument("--dear", action="store_true", help="also what takes long")
    parser.add_argument("--only", default="", help="files with this in their paths")
    options = parser.parse_args()
    if options.self_test:
        return self_test()
    begun, num, wrong, left_out = time.monotonic(), 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        on_processor = "this is your processor" in runner(Path(folder))("nsq-gpu adapters")
    for path in sorted({path for glob in DOCUMENTS for path in ROOT.glob(glob)}):
        name = path.relative_to(ROOT).as_posix()
        with tempfile.TemporaryDirectory() as folder:
            run = runner(Path(folder))
            for line, dear, claim, text, blocks in claims(path.read_text(encoding="utf-8") if options.only in name else ""):
                if dear and not options.dear or not on_processor and not (claim or "").startswith(("file ", "count ")):
                    left_out += 1
                    continue
                start = time.monotonic()
                found = fault(claim, text, blocks, run)
                num, wrong = num + 1, wrong + (found is not None)
                print(f"{name}:{line}: {found or 'holds'} ({time.monotonic() - start:.1f} s): {claim}", flush=True)
    why = "they are dear" if on_processor else "no processor comes first here"
    why = f"; {left_out} left out: {why}" if left_out else ""
    print(f"{num} claims in {time.monotonic() - begun:.0f} s, {wrong} false{why}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
