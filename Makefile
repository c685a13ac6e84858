# Targets: demo, test, test-thorough, matrix, lint, docs, lessons, gallery, wheel, three. Each creates .venv and installs what it needs.
PYTHON ?= python3
BIN := .venv/bin
SEED ?= 0
DEMO := runs/uiuc-$(SEED)

# Matrices are small: threads of BLAS would only wait for each other.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.PHONY: demo test test-thorough matrix lint docs lessons gallery wheel three
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

# What is drawn at random, in numbers for which the tests have no time: about an hour.
test-thorough: .venv/installed-dev
	$(BIN)/python scripts/mutate_files.py --count 3000
	$(BIN)/python scripts/open_hostile_pages.py
	$(BIN)/python scripts/attack_processes.py --count 100000 --small 1000000 --large 20 --lies 100
	$(BIN)/python scripts/fuzz_calls.py --count 10000
	$(BIN)/python scripts/fuzz_definitions.py --count 500
	$(BIN)/python scripts/fuzz_callbacks.py --count 300
	$(BIN)/python scripts/fuzz_labels.py
	$(BIN)/python scripts/verdicts.py

# The suite on each Python that pyproject.toml names, with its lowest and its newest dependencies.
# Interpreters are found, or given: make matrix PYTHONS="/path/to/python3.12 /path/to/python3.13".
matrix: .venv/installed-dev
	$(BIN)/python scripts/test_matrix.py --python $(PYTHONS)

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

# All pictures of the gallery, or one: make gallery FIGURE=sato-3.
gallery: .venv/installed-dev
	$(BIN)/python scripts/make_gallery.py $(FIGURE)

# Build the wheel, install it into an empty environment, and run every built-in scenario from it.
wheel: .venv/installed-dev
	rm -rf build/wheel && mkdir -p build/wheel
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir build/wheel .
	$(PYTHON) -m venv build/wheel/venv
	build/wheel/venv/bin/python -m pip install --quiet build/wheel/*.whl
	cd build/wheel && ../../$(BIN)/python ../../scripts/try_wheel.py venv/bin/sato

# Bundle the parts of three.js that the player uses; the result is kept in the repository.
THREE := three@0.187.0 esbuild@0.28.2
three:
	rm -rf build/three && mkdir -p build/three
	npm install --silent --no-audit --no-fund --prefix build/three $(THREE)
	cp sato/player/three.js build/three/entry.js
	build/three/node_modules/.bin/esbuild build/three/entry.js --bundle --minify --format=iife \
		--global-name=THREE --legal-comments=eof --log-level=warning --outfile=sato/player/three.min.js
	cp build/three/node_modules/three/LICENSE sato/player/three-LICENSE.txt

.venv/bin/python:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed: make PYTHON=/path/to/it")'
	$(PYTHON) -m venv .venv

.venv/installed: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

.venv/installed-dev: pyproject.toml | .venv/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch .venv/installed $@
