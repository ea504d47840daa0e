# Every target makes the environment it needs in .venv; a stamp file per step makes the second call quick.
PYTHON ?= python3

COMMA := ,
VENV := .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/stamps
ROS_SETUP := /opt/ros/jazzy/setup.bash
# Where a ROS installation is sourced, rclpy comes from there and the wheels are left out: the two do not mix.
ROS := $(if $(ROS_DISTRO),$(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo installation))
ROS_FROM := $(or $(ROS),wheels)
EXTRAS := bench dev docs plot teach view
# Beside an installation all but the wheels' lines are wanted, which pip cannot be told: rtarm itself requires them.
WITHOUT_WHEELS := import tomllib; \
  project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
  print(*(x for x in project["dependencies"] if not x.startswith("rtarm")), sep="\n"); \
  print(*(x for extra in "$(EXTRAS)".split() for x in project["optional-dependencies"][extra]), sep="\n")
INTERFACES := $(shell find rosfront/interfaces -type f -not -name '*.pyc')
COMPILED := $(wildcard config/*.py config/drives/*.py) $(shell find motion shm rtloop -name '*.py')
SOURCES := config motion shm rtloop rosfront sim rtarm ros handbook bench tests

# Set by the ROS wheels inside a Python of theirs: an inherited one would make ours skip its library path.
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# Minutes that `make soak` takes, trials that `make trials` makes, inputs that `make fuzz` tries.
MINUTES ?= 60
TRIALS ?= 200
CASES ?= 1000000
SEED ?= 1

.PHONY: help env demo test test-live test-all test-vm check docs reference bench trials ros-trials bus-trials bus-trials-live soak fuzz dist test-dist clean

help:
	@echo 'make demo     play a recorded MoveIt goal on a simulated arm, VIEW=1 to watch and move it in a browser'
	@echo 'make test     run the tests in virtual time, and a handful with real processes: some minutes'
	@echo 'make test-live  run the tests with real processes, ROS, browsers and terminals'
	@echo 'make test-vm  run tests/vm in a small virtual machine that has SocketCAN'
	@echo 'make test-all  all of these, and test-dist: what CI runs besides check and docs'
	@echo 'make check    ruff and mypy'
	@echo 'make docs     build the documentation into build/site'
	@echo 'make reference  make the pages of docs/reference anew from the code'
	@echo 'make bench    run the benchmarks'
	@echo 'make trials   hurt the processes of an arm in motion, TRIALS=200 times'
	@echo 'make ros-trials  kill ROS processes beside an arm, TRIALS=200 times'
	@echo 'make bus-trials  hurt the bus of an arm in virtual time, TRIALS=200 times in each way'
	@echo 'make bus-trials-live  the same with real processes, once in each way'
	@echo 'make soak     random goals and faults for MINUTES=60'
	@echo 'make fuzz     hostile inputs, CASES=1000000 of them'
	@echo 'make dist     build the wheel and the source distribution into dist'
	@echo 'make test-dist  install the wheel into an empty environment and play its demo (downloads some hundred MB)'
	@echo 'make env      only make the environment in $(VENV)'
	@echo 'make clean    remove the environment and all caches'

env: $(STAMPS)/warm

demo: env
	$(BIN)/rtarm demo$(if $(VIEW), --view)

# What hangs in C code no signal interrupts: all stacks are printed, that worker ends, and the guardian leaves no process.
PYTEST := $(BIN)/python tests/guardian.py $(BIN)/python -m pytest --numprocesses=2 --dist=loadfile \
  -o faulthandler_timeout=600 -o faulthandler_exit_on_timeout=true

test: env
	$(PYTEST) -m 'not process or smoke'

test-live: env $(STAMPS)/colcon
	$(PYTEST) -m 'process and not smoke'

test-all: test test-live test-vm test-dist

test-vm: $(STAMPS)/interfaces
	$(BIN)/python tests/vm/boot.py

check: $(STAMPS)/interfaces
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Not with --quiet, which hides warnings and lets them pass.
docs: $(STAMPS)/packages
	$(BIN)/python -m mkdocs build

reference: $(STAMPS)/interfaces
	$(BIN)/python -m handbook docs/reference

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

soak: env
	PYTHONPATH=tests $(BIN)/python -m soak --minutes $(MINUTES) --seed $(SEED)

# What fails is kept in fuzz-corpus and made again by its name: PYTHONPATH=tests python -m fuzz --again NAME
fuzz: env
	PYTHONPATH=tests $(BIN)/python -m fuzz --cases $(CASES) --seed $(SEED)

# The wheel is made from the source distribution, so neither can lack what the other has.
dist: $(STAMPS)/packages
	@rm -rf dist
	@$(BIN)/python -c 'from setuptools import build_meta; build_meta.build_sdist("dist")' >/dev/null
	@$(BIN)/pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist dist/rtarm-*.tar.gz
	@cp constraints.txt dist/
	@ls -l dist

test-dist: dist
	$(BIN)/python tests/packages/from_nothing.py dist/rtarm-*.whl

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find $(wildcard $(SOURCES)) -name __pycache__ -type d -prune -exec rm -rf {} +

# One environment, for one origin of ROS: with another it is made anew.
$(STAMPS)/ros-from-$(ROS_FROM):
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null || { \
	  echo "$(PYTHON) is `$(PYTHON) --version 2>/dev/null || echo missing`, rtarm needs Python 3.11 to 3.13: install one and name it, as in 'make env PYTHON=python3.12'." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "$(PYTHON) cannot make virtual environments: install its venv module with 'apt-get install python3-venv' and run make again." >&2; exit 1; }
	@if [ -z "$(ROS)" ] && [ -e $(ROS_SETUP) ]; then echo "ROS 2 comes from wheels; to use the installation, source $(ROS_SETUP) and run make again"; fi
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV)
	@mkdir -p $(STAMPS) && touch $@

$(STAMPS)/packages: pyproject.toml constraints.txt $(STAMPS)/ros-from-$(ROS_FROM)
	@echo 'installing the packages into $(VENV), ROS 2 from $(ROS_FROM), about a minute the first time …'
	@$(BIN)/pip install --quiet --constraint constraints.txt 'setuptools>=77'
ifdef ROS
	@$(BIN)/python -c '$(WITHOUT_WHEELS)' >$(STAMPS)/requirements.txt
	@$(BIN)/pip install --quiet --constraint constraints.txt --requirement $(STAMPS)/requirements.txt
	@$(BIN)/pip install --quiet --no-deps --use-pep517 --no-build-isolation --editable .
else
	@$(BIN)/pip install --quiet --constraint constraints.txt --use-pep517 --no-build-isolation \
	  --editable ".[$(subst $() ,$(COMMA),$(EXTRAS))]"
endif
	@touch $@

$(STAMPS)/interfaces: $(INTERFACES) $(STAMPS)/packages
	@$(BIN)/python -m rosfront.interfaces.build
	@touch $@

# colcon builds the ROS packages in a test.
$(STAMPS)/colcon: ros/colcon.txt $(STAMPS)/ros-from-$(ROS_FROM)
	@$(PYTHON) -m venv $(VENV)/colcon
	@$(VENV)/colcon/bin/pip install --quiet --requirement ros/colcon.txt
	@touch $@

# Compiles the control cycle into numba's cache, so that neither the demo nor a test waits for the compiler.
$(STAMPS)/warm: $(COMPILED) $(STAMPS)/interfaces
	@$(BIN)/python -m rtloop.warm
	@touch $@
