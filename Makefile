# Two commands: `make demo` and `make test`. Each makes .venv when it is missing and
# installs what it needs; a second call installs nothing.
PYTHON ?= python3
BIN := .venv/bin
SEED ?= 0
DEMO := runs/uiuc-$(SEED)

# Small matrices: threads of their own would only wait for one another.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.PHONY: demo test lint
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

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed: make PYTHON=/path/to/it")'
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/installed-dev: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch .venv/installed $@
