"""Runs the tests that take long: those of tests/long.txt, which `make test` leaves out.

    python3 tests/long.py                          all of them
    python3 tests/long.py 2000_seeds               those whose names have this
    python3 tests/long.py --first 7 --seconds 600  from the seventh on, and round, as many as begin within ten minutes

Prints which ones ran, and what they took. Exit code 1 if one failed.
"""

import argparse
import os
import re
import subprocess
import sys
import time
from pathlib import Path

from in_turn import in_turn

LIST = Path(__file__).with_name("long.txt")
# In the place of a test: all that its program ignores.
ALL = "*"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", default="", help="only tests whose names have this")
    parser.add_argument("--first", type=int, default=0, help="the number of the test to begin with; past the last, it goes round")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no test begins later than this")
    options = parser.parse_args()
    tests = [line.split() for line in LIST.read_text().splitlines() if line and not line.startswith("#")]
    tests = [(program, test) for program, test in tests if options.part in test]
    if not tests:
        parser.error(f"no long test has {options.part!r} in its name")
    start, ran, failed = time.monotonic(), [], []
    for program, test in in_turn(tests, options.first, time.time() + options.seconds):
        begun = time.monotonic()
        command = ["cargo", "test", "--quiet", "--test", program, "--", "--ignored"]
        command += [] if test == ALL else ["--exact", test]
        # A test without an end of its own takes what time is left, an hour at most.
        left = str(min(3600, max(60, int(options.seconds - (begun - start))))) if options.seconds < float("inf") else "3600"
        environment = os.environ | {"NSQ_GPU_SOAK_SECONDS": left}
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
        # A name that no test has would pass for a test that did.
        is_right = done.returncode == 0 and bool(re.search(r"\b[1-9]\d* passed" if test == ALL else r"\b1 passed", done.stdout))
        if not is_right:
            failed.append(f"{program} {test}")
            print(done.stdout + done.stderr)
        ran.append(f"{program} {test}")
        print(f"{'passed' if is_right else 'FAILED'}  {time.monotonic() - begun:5.0f} s  {program} {test}", flush=True)
    print(f"{len(ran)} of {len(tests)} long tests ran, {len(failed)} failed: {', '.join(failed) or 'none'}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
