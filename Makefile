# make demo        traces a Cooke triplet into demo-out/
# make test        the tests in Rust and in Python, beside Optiland's NumPy backend
# make lint        formatting, words of documents and comments, clippy
# make bench       measures how fast this machine traces, against Optiland, into bench-out/ (BENCH_ARGS for more)
# make bench-live  times traces that stay in one process, beside NumPy, and Torch and Dr.Jit where they are installed
# make accuracy    draws error against time for every tier, sampler and setting, and beside Optiland, into accuracy-out/
# make test-plain  the same bits from a build without the CPU backend
# make test-long   the tests that take long, which `make test` leaves out (LONG_ARGS: some of them)
# make gpu-report  what this machine's adapter does: agreement, bits, speed, into gpu-report-out/; wants no network
# make test-random the comparison with NumPy on RANDOM_SCENES random scenes from RANDOM_SEED (`make test` has 36)
# make test-torch  the comparison with Optiland's Torch backend, and Optiland's own tests of scenes (installs gigabytes)
# make notebooks   runs docs/notebooks, and writes them with what they show into notebooks-out/, for Jupyter
# make docs        builds the pages as a site, .docs/site/index.html; a broken link fails, and so does a false figure
# make wheel       a wheel for any Linux on x86_64, and a source distribution, into dist/ (a whole release build)
# make test-wheel  installs that wheel where there is no Rust, and does a first job there
# make test-docs   looks at the site in Chromium: dead links, missing pictures, cut tables, the search
# make test-drivers  the same bits from a second driver, SwiftShader, out of Debian's package chromium-common
# make clean       removes what the others made
#
# Each installs what is missing, and needs no network once everything is there.

SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:

# Mesa complains on stderr where this is unset.
export XDG_RUNTIME_DIR ?= /tmp
# Where backtraces are asked for, wgpu's checks would take one at every lock. Panics have theirs.
export RUST_LIB_BACKTRACE ?= 0

PYTHON = python3
DEMO_SCENE = scenes/cooke_triplet.json
DEMO_RAYS = 1e6
BENCH_ARGS = --quick
ACCURACY_ARGS =
# Torch takes part where `make test-torch` has installed it.
PEER_PYTHON = $(firstword $(wildcard .venv-torch/bin/python) .venv/bin/python)
# Tests at once in each of two programs. Tests share devices, and often wait for them: so there are more than processors.
TEST_THREADS = $$(nproc 2>/dev/null || echo 1)
# NumPy computes in one thread. Neighbours stay together: they share what the reference traced.
PYTEST_WORKERS = -n auto --maxprocesses 8 --dist worksteal
# Runs the Rust tests, two programs at a time.
RUST_TESTS = $(PYTHON) tests/by_time.py
SECOND_DRIVER = VK_ADD_DRIVER_FILES=$(abspath .drivers)/usr/lib/chromium/vk_swiftshader_icd.json
# Optiland's own tests of scenes, in one process and in their order: one leaves on that every constant wants a gradient.
OPTILANDS_TESTS = tests/nonsequential
RANDOM_SCENES = 200
LONG_ARGS =
REPORT_ARGS =
RANDOM_SEED = 1
# Runs a part of the tests, and says what it took beside its budget [s].
PART = $(abspath .ci/part)
# Tests run the program that checks for overflows. The demo and what is timed run the release, for which BINARY and
# BUILD_ARGS change together; `pip install ./python` takes the same build.
TARGET_FOLDER = $(or $(CARGO_TARGET_DIR),target)
BINARY = $(abspath $(TARGET_FOLDER)/debug/nsq-gpu)
BUILD_ARGS =
# The release takes longer.
BUILD_BUDGET = $(if $(BUILD_ARGS),420,360)
FAST_BINARY = $(abspath $(TARGET_FOLDER)/release/nsq-gpu)
# `unoptimised` makes a wheel for tests of its packing alone, in half the time.
WHEEL_PROFILE = release
# What measures stands beside what it measures.
FAST_BENCH = $(dir $(FAST_BINARY))nsq-bench

.PHONY: demo docs notebooks test-docs browser wheel test-wheel bench bench-live accuracy fast-binary lint test in-turn prepared compiled test-rust test-python test-random test-torch test-drivers test-long test-plain test-bare gpu-report build adapter display rust-components clean

demo:
	@$(MAKE) --no-print-directory adapter BINARY=$(FAST_BINARY) BUILD_ARGS="--release -p nsq-gpu"
	@$(FAST_BINARY) trace $(DEMO_SCENE) -n $(DEMO_RAYS) --standard-error on -o demo-out

fast-binary:
	@$(MAKE) --no-print-directory adapter BINARY=$(FAST_BINARY) BUILD_ARGS=--release

bench: fast-binary .venv/installed
	@$(FAST_BENCH) --against optiland --python .venv/bin/python -o bench-out --overwrite $(BENCH_ARGS)
	@.venv/bin/python benches/draw.py bench-out

bench-live: fast-binary .venv/installed
	@$(PEER_PYTHON) benches/live.py --binary $(FAST_BINARY) $(LIVE_ARGS)

accuracy: fast-binary .venv/installed
	@$(PEER_PYTHON) benches/accuracy.py --binary $(FAST_BINARY) --against optiland -o accuracy-out --overwrite $(ACCURACY_ARGS)

# With the program, which writes a part of the reference, and traces what notebooks show. Only what notebooks printed is kept.
# Then figures on the pages are compared with what their commands print.
docs: adapter .venv-docs/installed
	@rm -rf .docs/site .docs/doctrees
	@NSQ_GPU_BINARY=$(BINARY) .venv-docs/bin/sphinx-build -q -W --keep-going -c docs/site -d .docs/doctrees . .docs/site
	@$(PART) "claims, planted" 10 $(PYTHON) tests/house/claims.py --self-test
	@NSQ_GPU_BINARY=$(BINARY) $(PART) claims 90 .venv-docs/bin/python tests/house/claims.py
	@echo "written: .docs/site/index.html"

test-docs: docs browser
	@NSQ_GPU_BINARY=$(BINARY) .venv-docs/bin/python -m pytest -rs -q docs/site

# zig links against glibc 2.17, which every Linux with glibc and Python 3.11 has; no library comes along.
wheel: .venv-wheel/installed
	@$(call needs_cargo)
	rm -rf dist
	export PATH=$(abspath .venv-wheel/bin):$$PATH; cd python; \
		maturin build --locked --zig --profile $(WHEEL_PROFILE) --compatibility manylinux_2_17 --out ../dist; \
		maturin sdist --out ../dist

test-wheel: adapter wheel
	NSQ_GPU_BINARY=$(BINARY) .venv-wheel/bin/python -m pytest -p no:cacheprovider tests/wheel

notebooks: adapter .venv/installed
	@cd python && NSQ_GPU_BINARY=$(BINARY) NSQ_GPU_NOTEBOOKS=$(abspath notebooks-out) $(PART) notebooks 140 \
		../.venv/bin/python -m pytest -q --durations=5 tests/test_notebooks.py
	@echo "written: notebooks-out"

test: in-turn prepared test-rust test-python

# Packages of Python are fetched and unpacked while Rust compiles.
prepared:
	@$(call needs_cargo)
	@$(MAKE) --no-print-directory -j2 compiled .venv/installed

compiled:
	@$(PART) "program and tests, built" 430 cargo test --no-run

# Tests of many cases take a third of them, other ones with each commit.
in-turn test-rust test-python: export NSQ_GPU_TURN ?= $(shell git rev-list --count HEAD 2>/dev/null || echo all)

in-turn:
	@[ "$(NSQ_GPU_TURN)" = all ] || echo "turn $(NSQ_GPU_TURN): tests of many cases take a third of them; NSQ_GPU_TURN=all takes all"

lint: rust-components
	@$(PART) format 10 cargo fmt --check
	@$(PART) words 10 $(PYTHON) tests/house/words.py
	@$(PART) "words, planted" 10 $(PYTHON) tests/house/words.py --self-test
	@$(PART) clippy 150 cargo clippy --workspace --all-targets -- -D warnings

test-rust: adapter display
	@cargo test --quiet --no-run
	@$(PART) "Rust tests" 720 env RUST_TEST_THREADS="$${RUST_TEST_THREADS:-$(TEST_THREADS)}" $(RUST_TESTS)

# Without the CPU backend: the plain loop alone. With the viewer, so that dependencies are those of all other tests.
test-plain: adapter
	cargo test -p nsq-gpu --no-default-features --features viewer --test plain

# Without the viewer, too: other dependencies, which are checked anew.
test-bare:
	cargo check -p nsq-gpu --no-default-features

test-long: adapter rust-components
	$(PYTHON) tests/long.py $(LONG_ARGS)

gpu-report:
	$(PYTHON) benches/gpu_report.py --binary $(firstword $(wildcard $(FAST_BINARY)) $(BINARY)) -o gpu-report-out $(REPORT_ARGS)

test-python: adapter .venv/installed
	@cd python && NSQ_GPU_BINARY=$(BINARY) $(PART) "Python tests" 380 ../.venv/bin/python -m pytest -rs $(PYTEST_WORKERS) tests \
		--ignore tests/test_torch.py --ignore tests/test_torch_lenses.py

test-random: adapter .venv/installed
	cd python && NSQ_GPU_BINARY=$(BINARY) NSQ_GPU_RANDOM_SCENES=$(RANDOM_SCENES) NSQ_GPU_RANDOM_SEED=$(RANDOM_SEED) \
		../.venv/bin/python -m pytest $(PYTEST_WORKERS) tests/test_random.py

test-torch: adapter .venv-torch/installed .venv-torch/optiland
	cd python && NSQ_GPU_BINARY=$(BINARY) ../.venv-torch/bin/python -m pytest -rs tests/test_torch.py tests/test_torch_lenses.py tests/test_design_torch.py \
		tests/test_export.py::test_torch_tensors_are_values
	cd .venv-torch/optiland && NSQ_GPU_BINARY=$(BINARY) PYTHONPATH=$(abspath python) ../bin/python -m pytest -rs -p tools.optilands_tests \
		$(OPTILANDS_TESTS)

# For the commands alone: `adapter` looks for a driver without it.
test-drivers: adapter .drivers/installed
	$(SECOND_DRIVER) $(BINARY) adapters | grep SwiftShader
	$(SECOND_DRIVER) cargo test --test strict -- --ignored drivers_on_processors_give_the_same_bits

build:
	@$(call needs_cargo)
	@$(PART) build $(BUILD_BUDGET) cargo build $(BUILD_ARGS)

# wgpu needs a Vulkan loader and a driver on Linux. Where the program finds no adapter, lavapipe is one in software.
adapter: build
	@if ! $(BINARY) adapters >/dev/null 2>&1; then \
		echo "no adapter was found: installing Vulkan in software"; \
		$(call apt_install,libvulkan1 mesa-vulkan-drivers); \
		$(BINARY) adapters >/dev/null; \
	fi

# One test opens a real window, on a display in software; without one it says by name that it is skipped.
display: build
	@if ! command -v xvfb-run >/dev/null && command -v apt-get >/dev/null; then \
		echo "installing a display in software"; \
		( $(call apt_install,xvfb xauth) ) || echo "the test of a real window will be skipped" >&2; \
	fi

# The site is looked at in Chromium; without it these tests are skipped by name.
browser:
	@if ! command -v chromedriver >/dev/null && command -v apt-get >/dev/null; then \
		echo "installing a browser"; \
		( $(call apt_install,chromium chromium-driver) ) || echo "the tests in a browser will be skipped" >&2; \
	fi

rust-components:
	@cargo fmt --version >/dev/null 2>&1 && cargo clippy --version >/dev/null 2>&1 \
		|| rustup component add rustfmt clippy

.venv/installed: python/requirements.txt
	@$(call python_environment,.venv,$<)

.venv-torch/installed: python/requirements-torch.txt python/requirements.txt
	@$(call python_environment,.venv-torch,$<)

# Tests are in Optiland's source package alone.
.venv-torch/optiland: .venv-torch/installed
	rm -rf $@ $@.part && mkdir $@.part
	.venv-torch/bin/python -m pip download --quiet --disable-pip-version-check --no-deps --no-binary optiland -d $@.part \
		"$$(.venv-torch/bin/python -m pip freeze | grep '^optiland==')"
	tar -xzf $@.part/optiland-*.tar.gz --strip-components 1 -C $@.part && mv $@.part $@

# Borrows the packages of .venv: Optiland alone is a gigabyte.
.venv-docs/installed: python/requirements-docs.txt .venv/installed
	@rm -rf .venv-docs && $(PYTHON) -m venv .venv-docs
	@.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))' \
		>"$$(.venv-docs/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/borrowed.pth"
	@$(call python_environment,.venv-docs,$<)

.venv-wheel/installed: python/requirements-wheel.txt
	@$(call python_environment,.venv-wheel,$<)

# Unpacked, not installed: no other program finds the driver.
.drivers/installed:
	@command -v apt-get >/dev/null || { echo "SwiftShader is taken from a package of Debian" >&2; exit 1; }
	mkdir -p .drivers
	cd .drivers && apt-get download -qq chromium-common && dpkg -x chromium-common_*.deb . && rm chromium-common_*.deb
	touch $@

clean:
	cargo clean
	rm -rf demo-out notebooks-out bench-out accuracy-out gpu-report-out dist .venv .venv-torch .venv-docs .venv-wheel .docs .drivers

needs_cargo = command -v cargo >/dev/null || { echo "cargo is missing: see https://rustup.rs" >&2; exit 1; }

# $(call python_environment,FOLDER,REQUIREMENTS): Debian packs ensurepip apart from Python.
python_environment = \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || { $(call apt_install,python3-venv); }; \
	echo "installing $(2) into $(1)"; \
	$(PYTHON) -m venv $(1); \
	$(1)/bin/python -m pip install --quiet --disable-pip-version-check -r $(2); \
	touch $(1)/installed

# $(call apt_install,PACKAGES): as root or through sudo; elsewhere says what is needed.
apt_install = \
	if ! command -v apt-get >/dev/null; then \
		echo "please install what Debian calls: $(1)" >&2; exit 1; \
	elif [ "$$(id -u)" = 0 ]; then as_root=; \
	elif command -v sudo >/dev/null; then as_root=sudo; \
	else echo "please install, as root: apt-get install $(1)" >&2; exit 1; \
	fi; \
	$$as_root apt-get update -qq && $$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $(1)
