"""Runs the Rust tests, two programs at a time, and begins no further program after a time.

    python3 tests/by_time.py                              all of them
    python3 tests/by_time.py --first 7 --until 1764377000 from the seventh on, and round, until that time [s since 1970]

Two at a time, because a program's last test often keeps one processor alone. What a program printed stands together.

For machines that end a run which takes too long. Programs that were not begun are named at the end. `--first` turns with
each run, so that every program has its turn.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

from in_turn import in_turn

PROGRAMS_AT_ONCE = 2


def programs() -> list[list[str]]:
    """Return the arguments of `cargo test` for each test program, libraries and documentation first."""
    built = subprocess.run(["cargo", "test", "--no-run"], stderr=subprocess.PIPE, text=True)
    if built.returncode:
        sys.exit(built.stderr)
    found = re.findall(r"^ *Executable tests/\S+ \(.*/([a-z0-9_]+)-[0-9a-f]+(?:\.exe)?\)", built.stderr, re.MULTILINE)
    return [["--lib", "--bins"], ["--doc"], *(["--test", name] for name in dict.fromkeys(found))]


def passes(program: list[str]) -> bool:
    """Run a program, print what it printed, and say whether all of its tests passed."""
    begun = time.monotonic()
    command = ["cargo", "test", "--no-fail-fast", *program]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    print(f"{done.stdout}{program[-1]}: {time.monotonic() - begun:.0f} s\n", flush=True)
    return done.returncode == 0


def main() -> int:
    """Run them; return 1 if one failed."""
    parser = argparse.ArgumentParser(description="Runs the Rust tests until a time.")
    parser.add_argument("--first", type=int, default=0, help="the program to begin with, counted round")
    parser.add_argument("--until", type=float, default=float("inf"), help="begin no program after this time [s since 1970]")
    options = parser.parse_args()
    order = list(in_turn(programs(), options.first, float("inf")))

    def outcome(program: list[str]) -> bool | None:
        return passes(program) if time.time() <= options.until else None

    # Where Ctrl-C ends it, `map` cancels what has not begun.
    with ThreadPoolExecutor(PROGRAMS_AT_ONCE) as pool:
        outcomes = list(zip(order, pool.map(outcome, order), strict=True))
    ran = [program for program, passed in outcomes if passed is not None]
    failed = [program[-1] for program, passed in outcomes if passed is False]
    print(f"{len(ran)} of {len(order)} test programs ran, {len(failed)} failed: {', '.join(failed) or 'none'}")
    left_out = [program[-1] for program, passed in outcomes if passed is None]
    if left_out:
        print(f"not begun for lack of time: {', '.join(left_out)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
