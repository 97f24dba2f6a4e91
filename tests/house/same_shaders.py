"""Compares what two programs trace scenes by: each composed shader, in every tier.

    python3 tests/house/same_shaders.py OLD NEW              OLD and NEW are programs, or folders of their shaders
    python3 tests/house/same_shaders.py OLD NEW --keep DIR   keeps the shaders, in DIR/old and DIR/new

A shader is `same to the letter`, but for the header and comments; or the `same module`, but for names and the order of
declarations (tests/house/eraser.rs has the rules); or the first lines that differ are shown. Exit code 1 if one differs.
What `nsq-gpu shader` prints depends on the adapter: on a processor it has the CPU backend's stages.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[2]
TIERS = [(precision, portable) for precision in ["f32", "df64", "f64"] for portable in [False, True]]


def dump(program, folder):
    """Writes the shader of every scene and tier."""
    folder.mkdir(parents=True, exist_ok=True)
    scenes = sorted(ROOT.glob("scenes/*.json"))

    def write(work):
        scene, (precision, portable) = work
        command = [program, "shader", f"scenes/{scene.name}", "--precision", precision, *["--portable"] * portable]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        name = f"{scene.stem} {precision}{' portable' if portable else ''}.wgsl"
        # A refusal is compared, too.
        text = done.stdout if done.returncode == 0 else f"// refused: {done.stderr}"
        (folder / name).write_text(text)

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        list(threads.map(write, [(scene, tier) for scene in scenes for tier in TIERS]))


def letters(text):
    """A shader without comments and empty lines."""
    return [line for line in (line.split("//")[0].rstrip() for line in text.splitlines()) if line]


def folder_of(given, kept):
    given = Path(given).resolve()
    if given.is_dir():
        return given
    dump(given, kept)
    return kept


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old")
    parser.add_argument("new")
    parser.add_argument("--keep", type=Path, help="the folder where the shaders stay")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        kept = (options.keep or Path(temporary)).resolve()
        old, new = folder_of(options.old, kept / "old"), folder_of(options.new, kept / "new")
        names = sorted(path.name for path in old.glob("*.wgsl"))
        if names != sorted(path.name for path in new.glob("*.wgsl")):
            sys.exit("the two folders hold shaders of different names")
        read = lambda folder, name: letters((folder / name).read_text())  # noqa: E731
        others = [name for name in names if read(old, name) != read(new, name)]
        print(f"{len(names) - len(others)} of {len(names)} shaders are the same to the letter, but for comments")
        if not others:
            return 0
        with tempfile.TemporaryDirectory() as rest:
            for place, folder in [("old", old), ("new", new)]:
                (Path(rest) / place).mkdir()
                for name in others:
                    (Path(rest) / place / name).write_text((folder / name).read_text())
            folders = {"NSQ_GPU_SHADERS_BEFORE": f"{rest}/old", "NSQ_GPU_SHADERS_AFTER": f"{rest}/new"}
            test = "two_folders_of_shaders_hold_the_same_modules"
            command = ["cargo", "test", "--quiet", "--test", "same_module", "--", "--ignored", "--exact", test, "--nocapture"]
            return subprocess.run(command, cwd=ROOT, env=os.environ | folders).returncode


if __name__ == "__main__":
    sys.exit(main())
