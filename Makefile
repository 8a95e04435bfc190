# Everything sets itself up: a virtual environment, the pinned dependencies, the package.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
# Processes that test: two more than there are cores, for tests that wait.
TESTERS ?= $(shell $(PYTHON) -c 'import os; print(2 + (os.cpu_count() or 1))')
# One thread per process: the pinned counts do not depend on it, the timings do.
export OPENBLAS_NUM_THREADS ?= 1
# Tests start many processes: what one has compiled the next need not, whatever the shell says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo quick test suite sim clients lerobot cluster lint types bench attack mutants measures docs wheel wheels clean
.DEFAULT_GOAL := demo

INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
NATIVE := CMakeLists.txt $(wildcard planner_service/native/*.cpp planner_service/native/*/* planner_service/certify/native/*)

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(0 if (3, 10) <= sys.version_info[:2] <= (3, 13) else "Python 3.10 to 3.13 is needed, this is " + sys.version.split()[0] + "; name another with: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)

$(BIN)/.ready: pyproject.toml constraints.txt $(NATIVE) | $(BIN)/python  # what planning needs
	$(INSTALL) -e .
	@touch $@

# That and every extra, for the tests. They compile what they import, and the wheel that they build takes what is built here.
$(BIN)/.dev: pyproject.toml constraints.txt $(NATIVE) | $(BIN)/python
	$(INSTALL) scikit-build-core nanobind cmake ninja
	$(INSTALL) --no-compile --no-build-isolation -Cbuild-dir=build/native -e ".[dev]"
	@touch $@ $(BIN)/.ready

$(BIN)/.docs: $(BIN)/.ready  # what the pages are built with, beside that
	$(INSTALL) -e ".[docs]"
	@touch $@

demo: $(BIN)/.ready  ## plan a whole pick-and-place over a bin and print what it cost
	@$(BIN)/planner-service pick-place

quick: $(BIN)/.dev lint  ## the inner loop: the tests of all packages but the slow ones, in a minute
	$(BIN)/python -m pytest tests/unit -m "not (slow or sim or browser or ray or cluster)" --numprocesses auto --dist worksteal

test: $(BIN)/.dev  ## lint, types and the test suite
	@$(MAKE) --no-print-directory --jobs=2 sim types lint
	@$(MAKE) --no-print-directory suite

suite: $(BIN)/.dev  # files in the order in which they are collected; tests/conftest.py has those that wait first
	$(BIN)/python -m pytest -m "not sim and not cluster and not clients and not lerobot" --numprocesses $(TESTERS) --dist loadfile --no-loadscope-reorder

sim: $(BIN)/.dev  # in real time: beside few others
	$(BIN)/python -m pytest -m sim tests/integration/test_simulation.py

clients: $(BIN)/.dev  ## programs in TypeScript and C++ that plan over HTTP, run on the simulated arm; needs node, libcurl, nlohmann-json
	$(BIN)/python -m pytest -m clients tests/integration/test_clients.py

# LeRobot needs Python 3.12, and brings PyTorch: 6 GB in an environment of its own, of which the package's tests make use.
LEROBOT_VENV ?= .venv-lerobot
LEROBOT_PYTHON ?= $(or $(lastword $(wildcard $(HOME)/.pyenv/versions/3.12.*/bin/python)),python3.12)

$(LEROBOT_VENV)/.ready: pyproject.toml constraints.txt integrations/lerobot/pyproject.toml $(NATIVE)
	$(LEROBOT_PYTHON) -m venv $(LEROBOT_VENV)
	$(LEROBOT_VENV)/bin/python -m pip install --quiet --disable-pip-version-check -e ".[sim]" -e "./integrations/lerobot[sim]" "pytest>=8"
	@touch $@

lerobot: $(LEROBOT_VENV)/.ready  ## the package for LeRobot with LeRobot itself, and its commands with the simulated arm
	$(LEROBOT_VENV)/bin/python -m pytest integrations/lerobot/tests

cluster: $(BIN)/.dev  ## the loss of a machine under Ray Serve, apart since Ray now and then fails to start its proxy in time
	$(BIN)/python -m pytest -m cluster tests/unit/serve/test_ray_serve.py

lint: $(BIN)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: $(BIN)/.dev
	$(BIN)/mypy

bench: $(BIN)/.dev  ## the gate: what the smoke suite costs is what is stored
	$(BIN)/python -m benchmarks check

attack: $(BIN)/.dev  ## hostile inputs of every kind for half a minute; docs/figures/attack.md has the long version
	$(BIN)/python -m benchmarks attack --minutes 0.5 --seed 20

mutants: $(BIN)/.dev  ## do the tests notice small faults: 40 in each package, in about an hour; docs/figures/mutants.md has a table
	$(BIN)/python -m benchmarks mutants --out mutants.json

measures: $(BIN)/.dev  ## most tables of docs/figures/measured.md, printed
	$(BIN)/python -m benchmarks all

docs: $(BIN)/.docs  ## the pages and the reference as a site in site/, links checked
	NO_MKDOCS_2_WARNING=true $(BIN)/python -m mkdocs build --strict

wheel: $(BIN)/.dev  ## a wheel in dist/, tested in a fresh virtual environment
	WHEEL_DIR=dist $(BIN)/python -m pytest tests/integration/test_packaging.py

# A Python of each version that wheels are for: pyenv's, or the one on the path.
PYTHONS ?= $(foreach v,3.10 3.11 3.12 3.13,$(or $(lastword $(wildcard $(HOME)/.pyenv/versions/$(v).*/bin/python)),$(shell command -v python$(v))))

wheels:  ## wheels in dist/ for machines such as this, by each Python 3.10 to 3.13 that is found, each tried
	.ci/wheels dist $(PYTHONS)

clean:
	rm -rf $(VENV)
