# The two commands of the README are `make demo` and `make test`; each makes its own .venv from the lock.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
TRUEUP := $(BIN)/trueup
# Two processes share the cores, and threads of BLAS would wait for those of the other.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal --durations=60 --durations-min=10

.PHONY: demo test test-long test-all attack install lint bench acceptance pages docs lock clean

demo: $(VENV)/.base
	$(TRUEUP) demo --out runs/demo --overwrite

# What a change is tried with; test-long has the rest, and both together are what must hold before it lands.
test: install lint
	$(PYTEST) -m "not long and not slow"
	$(BIN)/mkdocs build --strict --quiet --site-dir $(VENV)/site

test-long: install
	$(PYTEST) -m "long and not slow"

test-all: install lint
	$(PYTEST)
	$(BIN)/mkdocs build --strict --quiet --site-dir $(VENV)/site

# TRUEUP_MUTATIONS damaged files for every parser (10000 if not given); a parser that is done is not attacked again.
attack: install
	PYTHONPATH=.:tests $(BIN)/python -m attack

lint: install
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

install: $(VENV)/.dev

bench: $(VENV)/.rivals
	$(BIN)/python -m benchmarks

acceptance: $(VENV)/.rivals
	$(BIN)/python -m benchmarks.acceptance

pages: install
	$(BIN)/python -m benchmarks.pages

docs: install
	$(BIN)/mkdocs build --strict

lock: install
	$(BIN)/python scripts/lock.py

$(VENV)/.venv:
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet -c requirements.lock pip
	touch $@

$(VENV)/.base: $(VENV)/.venv pyproject.toml requirements.lock
	$(PIP) install --quiet -c requirements.lock -e '.[plan,learn]'
	touch $@

$(VENV)/.dev: $(VENV)/.venv pyproject.toml requirements.lock
	$(PIP) install --quiet -c requirements.lock -e '.[dev]'
	touch $@ $(VENV)/.base

$(VENV)/.rivals: $(VENV)/.dev
	$(PIP) install --quiet -c requirements.lock -e '.[rivals]'
	touch $@

clean:
	rm -rf $(VENV) build dist site .mypy_cache .ruff_cache .hypothesis
