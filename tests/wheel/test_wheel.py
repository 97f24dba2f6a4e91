"""What `make wheel` wrote is installed where there is no Rust, and does a user's first job there.

`make test-wheel` runs this. The commands and the code are those of docs/start.md, "With the wheel".
"""

import json
import os
import platform
import re
import resource
import shutil
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import pytest
from elftools.elf.elffile import ELFFile

ROOT = Path(__file__).parents[2]
DIST = ROOT / "dist"
PLATFORM = f"manylinux_2_17_{platform.machine()}"
# From `pip install`, with packages in pip's cache, to the first picture. Of processors [s], because others may use them too.
TWO_MINUTES = 120
# What a user's shell hands on, and what points to a driver here. No HOME: pip's settings alone come from there.
HANDED_ON = ("LANG", "TMPDIR", "XDG_RUNTIME_DIR", "VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES")


def run(command, **options):
    """Run a command that must succeed, and return what it printed."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, f"{command}:\n{done.stdout}{done.stderr}"
    return done.stdout


def only(pattern):
    """Return the one file of dist/ that fits."""
    found = list(DIST.glob(pattern))
    assert len(found) == 1, f"dist/ has {found} for {pattern}: make wheel"
    return found[0]


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def with_the_wheel(language):
    """Return the blocks of code of the page's section."""
    page = (ROOT / "docs/start.md").read_text(encoding="utf-8")
    return blocks(page.split("\n## With the wheel\n")[1].split("\n## ")[0], language)


class Clock:
    """What has passed since its start, on the wall and on processors [s]."""

    def __init__(self):
        self.start = self._now()

    def _now(self):
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.monotonic(), used.ru_utime + used.ru_stime

    def passed(self):
        return [now - start for now, start in zip(self._now(), self.start, strict=True)]


class Bare:
    """A virtual environment with the wheel and what pip brings with it. Neither cargo nor the repository is in reach."""

    def __init__(self, folder, wheel):
        self.prefix, self.home = folder / "venv", folder / "home"
        self.home.mkdir()
        run([sys.executable, "-m", "venv", self.prefix])
        pip = [self.prefix / "bin/pip", "--disable-pip-version-check", "--quiet"]
        run([*pip, "download", wheel, "-d", folder / "cached"])
        shutil.rmtree(folder / "cached")
        self.clock = Clock()
        run([*pip, "install", wheel], env={**os.environ, "PATH": self.path()})

    def path(self):
        folders = [self.prefix / "bin", Path("/usr/bin"), Path("/bin")]
        return os.pathsep.join(str(folder) for folder in folders if not (folder / "cargo").exists())

    def run(self, command, **more):
        handed_on = {name: os.environ[name] for name in HANDED_ON if name in os.environ}
        environment = {**handed_on, "HOME": str(self.home), "PATH": self.path(), "MPLBACKEND": "Agg", **more}
        return run(command, cwd=self.home, env=environment)

    def program(self):
        return self.prefix / "bin/nsq-gpu"

    def python(self, code):
        return self.run([self.prefix / "bin/python", "-c", code])


@pytest.fixture(scope="session")
def bare(tmp_path_factory):
    return Bare(tmp_path_factory.mktemp("bare"), only("*.whl"))


@pytest.fixture(scope="session")
def first_picture(bare):
    """Do what the page says, and return what has passed since `pip install` began."""
    bare.python(with_the_wheel("python")[0])
    return bare.clock.passed()


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    """Unpack the source distribution, outside of the repository."""
    folder = tmp_path_factory.mktemp("source")
    with tarfile.open(only("*.tar.gz")) as archive:
        archive.extractall(folder, filter="data")
    (unpacked,) = folder.iterdir()
    assert ROOT not in unpacked.parents
    return unpacked


def colours(bare, picture):
    """Return how many colours a picture has."""
    code = f"from PIL import Image; print(len(Image.open({str(picture)!r}).convert('RGB').getcolors(1 << 24)))"
    return int(bare.python(code))


def test_the_tag_is_the_one_that_auditwheel_finds():
    wheel = only("*.whl")
    shown = " ".join(run([sys.executable, "-m", "auditwheel", "show", wheel]).split())
    assert f'is consistent with the following platform tag: "{PLATFORM}"' in shown, shown
    assert wheel.stem.endswith(f"-py3-none-manylinux2014_{platform.machine()}.{PLATFORM}"), wheel.name


def test_no_cargo_is_in_reach(bare):
    assert shutil.which("cargo", path=bare.path()) is None
    assert shutil.which("nsq-gpu", path=bare.path()) == str(bare.program())


def test_symbols_are_stripped(bare):
    with bare.program().open("rb") as file:
        names = [section.name for section in ELFFile(file).iter_sections()]
    assert ".text" in names
    assert not [name for name in names if name == ".symtab" or name.startswith(".debug")]


def test_the_first_picture_takes_less_than_two_minutes(bare, first_picture, capsys):
    wall, processors = first_picture
    with capsys.disabled():
        print(f"\nfrom pip install to the first picture: {wall:.0f} s, of processors {processors:.0f} s")
    assert colours(bare, bare.home / "ghosts.png") > 100
    assert processors < TWO_MINUTES


def test_the_command_traces_what_python_wrote_to_the_same_flux(bare, first_picture):
    for command in with_the_wheel("console")[-1].splitlines():
        bare.run(["sh", "-c", command.removeprefix("$ ")])
    report = json.loads((bare.home / "results/report.json").read_text(encoding="utf-8"))
    flux = report["detectors"]["image"]["total_flux"]
    in_python = bare.python(
        "import nsq_gpu\n"
        "scene = nsq_gpu.load_scene('triplet.json')\n"
        "result = scene.trace(1_000_000, max_depth=32, backend=nsq_gpu.NsqGpuBackend())\n"
        "print(repr(float(result.detectors['image'].total_flux)))"
    )
    assert flux == float(in_python) > 0.1
    assert colours(bare, bare.home / "window.png") > 100


def test_the_first_cells_of_a_notebook_run(bare):
    """A notebook shows the last expression of a cell, such as a result, as HTML."""
    page = (ROOT / "docs/how-to/notebooks.md").read_text(encoding="utf-8")
    scene = bare.home / "docs/example.json"
    scene.parent.mkdir()
    shutil.copy(ROOT / "docs/example.json", scene)
    shown = bare.python("\n".join([*blocks(page, "python")[:4], "print(result._repr_html_())"]))
    assert "<table" in shown and ">image<" in shown, shown
    assert (bare.home / "run_1/report.json").is_file()


def test_the_bits_are_those_of_the_tested_build(bare):
    """Another linker and an old C library change no result."""
    scene, tallies = ROOT / "scenes/cooke_triplet.json", []
    for name, program in (("wheel", bare.program()), ("build", os.environ["NSQ_GPU_BINARY"])):
        bare.run([program, "trace", scene, "-n", "1e5", "-o", name])
        tallies.append((bare.home / name / "tally.bin").read_bytes())
    assert tallies[0] == tallies[1]


def test_libraries_of_the_environment_are_looked_for(bare):
    """A conda environment brings its own Vulkan loader."""
    done = subprocess.run(
        [bare.program(), "adapters"], capture_output=True, text=True, check=False, env={"LD_DEBUG": "libs", "HOME": str(bare.home)}
    )
    tried = [Path(path).resolve() for path in re.findall(r"trying file=(\S+/libvulkan\.so\.1)$", done.stderr, re.MULTILINE)]
    assert bare.prefix.resolve() / "lib/libvulkan.so.1" in tried, tried


def test_the_source_distribution_has_what_git_has(source):
    listed = run(["git", "ls-files", "src", "shaders", "python/nsq_gpu", "Cargo.toml", "Cargo.lock", "build.rs", "LICENSE-*"], cwd=ROOT)
    names = [name.removeprefix("python/") for name in listed.split()]
    assert "src/scene/catalog.bin" in names and "nsq_gpu/__init__.py" in names
    assert [name for name in names if not (source / name).is_file()] == []


def test_the_source_distribution_compiles_outside_of_the_repository(source):
    """Each shader and table is compiled in, so that none can be missing. Dependencies are taken from the build."""
    target = os.environ.get("CARGO_TARGET_DIR", str(ROOT / "target"))
    run(["cargo", "check", "--quiet", "--offline"], cwd=source, env={**os.environ, "CARGO_TARGET_DIR": target})
