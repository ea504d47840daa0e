# Every target makes the environment it needs in .venv: packaging/environment.py, at once where nothing has changed.
PYTHON ?= python3

VENV := .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/stamps
ENVIRONMENT := @$(PYTHON) packaging/environment.py --venv $(VENV)
SOURCES := compilation config motion shm sentences rtarm_interfaces rtloop rosfront sim rtarm ros handbook bench examples tests

# Set by the ROS wheels inside a Python of theirs: an inherited one would make ours skip its library path.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
# Images of containers set it: each of some hundred processes would then compile every module that it imports.
unexport PYTHONDONTWRITEBYTECODE
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# Minutes that `make soak` takes, trials that `make trials` makes, inputs that `make fuzz` tries, mutants.
MINUTES ?= 60
TRIALS ?= 200
CASES ?= 1000000
COUNT ?= 80
SEED ?= 1
# Where `make test-arm64` keeps its Debian and what is compiled there, some GB, and which of its stages it does: all.
RTARM_ARM64 ?= $(HOME)/.cache/rtarm-arm64
STAGES ?=

.PHONY: help env tools lock demo test test-live test-uncompiled test-checked test-all test-vm test-arm64 transcripts mutants check docs reference names keep bench trials ros-trials bus-trials bus-trials-live stop-trials soak fuzz dist test-dist clean

help:
	@echo 'make demo     play a recorded MoveIt goal on a simulated arm, VIEW=1 to watch and move it in a browser'
	@echo 'make test     run the tests in virtual time, and a handful with real processes: some minutes'
	@echo 'make test-live  run the tests with real processes, ROS, browsers and terminals'
	@echo 'make test-uncompiled  run the tests of leaf functions and codecs without the compiler'
	@echo 'make test-checked  let hostile writers run against the cycle with every index checked: some minutes'
	@echo 'make test-vm  run tests/vm in a small virtual machine that has SocketCAN'
	@echo 'make test-all  all of these but mutants, and test-dist: what CI runs besides check and docs'
	@echo 'make test-arm64  as root: run the tests that need no ROS, and the install page, in an emulated ARM64 Debian in RTARM_ARM64=FOLDER'
	@echo 'make transcripts  hold what the control cycle says against recordings'
	@echo 'make mutants  make small errors in leaf functions, COUNT=80 of them, each of which a test must notice'
	@echo 'make check    ruff and mypy'
	@echo 'make docs     build the documentation into build/site'
	@echo 'make reference  make the pages of docs/reference, and pictures of the code, anew'
	@echo 'make names    add new names that users build on to the lists of stable names'
	@echo 'make keep     at a release: keep files of this version, which later ones must go on reading'
	@echo 'make bench    run the benchmarks'
	@echo 'make trials   hurt the processes of an arm in motion, TRIALS=200 times'
	@echo 'make ros-trials  kill ROS processes beside an arm, TRIALS=200 times'
	@echo 'make bus-trials  hurt the bus of an arm in virtual time, TRIALS=200 times in each way'
	@echo 'make bus-trials-live  the same with real processes, once in each way'
	@echo 'make stop-trials  stop an arm in virtual time beside those who go on sending, TRIALS=200 times beside each'
	@echo 'make soak     random goals and faults for MINUTES=60'
	@echo 'make fuzz     hostile inputs, CASES=1000000 of them'
	@echo 'make dist     build the wheel and the source distribution into dist'
	@echo 'make test-dist  install the wheel into an empty environment and play its demo (downloads some hundred MB)'
	@echo 'make env      only make the environment in $(VENV)'
	@echo 'make lock     pin the packages anew in constraints.txt'
	@echo 'make clean    remove the environment and all caches'

env:
	$(ENVIRONMENT) all

# All packages and ROS messages; nothing of the cycle is compiled.
tools:
	$(ENVIRONMENT) tools

demo:
	$(ENVIRONMENT) demo
	$(BIN)/rtarm demo$(if $(VIEW), --view)

# What hangs in C code no signal interrupts: all stacks are printed, that worker ends, and the guardian leaves no process.
PYTEST := $(BIN)/python tests/guardian.py $(BIN)/python -m pytest --numprocesses=2 --dist=loadfile \
  -o faulthandler_timeout=1800 -o faulthandler_exit_on_timeout=true

test: env
	$(PYTEST) -m 'not process or smoke'

test-live: env $(STAMPS)/colcon
	$(PYTEST) -m 'process and not smoke'

# Leaf functions and codecs without the compiler; all of the cycle with every index checked.
UNCOMPILED := motion shm/test_seqlock.py rtloop/*/test_*_codec.py $(patsubst %,rtloop/*/test_%.py,words golden_frames \
  codec_laws drive_frames zdt_targets limits clock path leading following phases)

test-uncompiled: env
	NUMBA_DISABLE_JIT=1 $(PYTEST) -m 'not process' $(addprefix tests/,$(UNCOMPILED))

test-checked: env
	RTARM_LONG=1 $(PYTEST) tests/fuzz/test_fuzz.py -k no_hostile_index

test-all: export RTARM_EXAMPLES := all
test-all: test transcripts test-live test-uncompiled test-checked test-vm test-dist

# `python -m transcripts --record SCENARIO …` with the same path records anew what is meant to change (docs/explanation/testing.md).
transcripts: env
	PYTHONPATH=tests $(BIN)/python -m transcripts --jobs 2

mutants: env
	RTARM_EXAMPLES=all PYTHONPATH=tests $(BIN)/python -m mutants --count $(COUNT) --seed $(SEED) --jobs 2

test-vm: tools
	$(BIN)/python tests/vm/boot.py

test-arm64: export RTARM_ARM64 := $(RTARM_ARM64)
test-arm64:
	@$(PYTHON) packaging/arm64.py $(STAGES)

check: tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Not with --quiet, which hides warnings and lets them pass.
docs: tools
	$(BIN)/python -m mkdocs build

reference: tools
	$(BIN)/python -m handbook docs/reference
	$(BIN)/python -m handbook.pictures docs/pictures

names: tools
	PYTHONPATH=.:tests:tests/rtarm $(BIN)/python -m stable_names
	$(MAKE) reference

keep: env
	PYTHONPATH=.:tests $(BIN)/python -m keep

bench: env
	$(BIN)/rtarm bench
	$(BIN)/python -m pytest bench

trials: env
	PYTHONPATH=tests $(BIN)/python -m process_trials --trials $(TRIALS) --seed $(SEED)

ros-trials: env
	PYTHONPATH=tests $(BIN)/python -m ros_trials --trials $(TRIALS) --seed $(SEED)

bus-trials: env
	PYTHONPATH=tests $(BIN)/python -m bus_trials --trials $(TRIALS) --seed $(SEED)

bus-trials-live: env
	PYTHONPATH=tests $(BIN)/python -m live_bus_trials --seed $(SEED)

stop-trials: env
	PYTHONPATH=tests $(BIN)/python -m stop_trials --trials $(TRIALS) --seed $(SEED)

soak: env
	PYTHONPATH=tests $(BIN)/python -m soak --minutes $(MINUTES) --seed $(SEED)

# What fails is kept in fuzz-corpus and made again by its name: PYTHONPATH=tests python -m fuzz --again NAME
fuzz: env
	PYTHONPATH=tests $(BIN)/python -m fuzz --cases $(CASES) --seed $(SEED)

# The wheel is made from the source distribution, so neither can lack what the other has.
dist: tools
	@rm -rf dist
	@$(BIN)/python -c 'from setuptools import build_meta; build_meta.build_sdist("dist")' >/dev/null
	@$(BIN)/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist dist/rtarm-*.tar.gz
	@cp constraints.txt dist/
	@ls -l dist

# In an environment of its own, which alone has uv: it resolves for every supported Python, whichever runs it.
lock:
	$(PYTHON) -m venv --clear build/lock
	build/lock/bin/pip install --quiet 'uv>=0.9'
	build/lock/bin/python packaging/lock.py

test-dist: dist
	$(BIN)/python tests/packages/from_nothing.py dist/rtarm-*.whl

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find $(wildcard $(SOURCES)) -name __pycache__ -type d -prune -exec rm -rf {} +

# colcon builds the ROS packages in a test.
$(STAMPS)/colcon: ros/colcon.txt | env
	@$(PYTHON) -m venv $(VENV)/colcon
	@$(VENV)/colcon/bin/pip install --quiet --requirement ros/colcon.txt
	@touch $@
