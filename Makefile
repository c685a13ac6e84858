# Targets: demo, test, lint, docs, lessons, wheel. Each creates .venv and installs what it needs, once.
PYTHON ?= python3
BIN := .venv/bin
SEED ?= 0
DEMO := runs/uiuc-$(SEED)

# Matrices are small: threads of BLAS would only wait for each other.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.PHONY: demo test lint docs lessons wheel
.DEFAULT_GOAL := demo

demo: .venv/installed
	$(BIN)/sato run uiuc --seed $(SEED) --out $(DEMO)
	$(BIN)/sato check $(DEMO)
	$(BIN)/sato plot $(DEMO)
	@echo
	@echo "The run, its summary and its figures are in $(DEMO):"
	@ls $(DEMO)
	@echo "To see it move: $(BIN)/sato animate $(DEMO)"

test: .venv/installed-dev
	$(BIN)/python -m pytest

lint: .venv/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: .venv/installed-dev
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html
	@echo "The pages are in docs/_build/html/index.html"

# Execute the lessons in full, and build the pages with their outputs.
lessons: .venv/installed-dev
	$(BIN)/python -m sphinx -W --keep-going -b html -D nb_execution_mode=force docs docs/_build/html
	@echo "The lessons are in docs/_build/html/lessons/index.html"
	@echo "The notebooks with outputs are in docs/_build/jupyter_execute/lessons"

# Build the wheel, install it into an empty environment, and run every built-in scenario from it.
wheel: .venv/installed-dev
	rm -rf build/wheel && mkdir -p build/wheel
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/wheel/venv
	build/wheel/venv/bin/python -m pip install --quiet build/wheel/*.whl
	cd build/wheel && ../../$(BIN)/python ../../scripts/try_wheel.py venv/bin/sato

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed: make PYTHON=/path/to/it")'
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/installed-dev: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch .venv/installed $@
