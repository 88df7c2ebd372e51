# Everything runs in an environment of its own, .venv, made on the first call. Needs git, make and Python 3.11 or newer.
#
#   make demo [SEED=7]   the main job on a virtual robot with a hidden effect
#   make test            the suite (SLOW=yes: with the statistical runs of minutes)
#   make lint            formatting, types, import contracts
#   make audit           the pinned versions against the databases of known vulnerabilities
#   make lock            lock/*.txt of constraints.txt: the SHA-256 of every file that may be installed
#   make docs            the documentation, into site/

PYTHON ?= python3
SEED ?= 1
OUT ?= demo
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install -qq
# Extras of pyproject.toml that development needs. What is installed has a hash in lock/; the project itself comes last.
EXTRAS := test,lint,docs
LOCKED := $(PIP) --require-hashes -r

# A worker for each core, four at most (each may take 3 GB), and one thread each: BLAS threads that fight cost a small
# fit a factor of ten.
WORKERS ?= $(shell n=$$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2); echo $$((n < 4 ? n : 4)))
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help venv demo wheel test test-slow test-studies test-all lint audit lock format docs figures clean

help:
	@sed -n '3,8s/^# *//p' Makefile

venv: $(VENV)/.run

# The stamps are older than what they depend on only when the installation has to be renewed.
$(VENV)/.run: pyproject.toml lock/run.txt | $(BIN)/python
	@echo "installing clampid into $(VENV) (once; takes a minute or two)"
	@$(LOCKED) lock/run.txt
	@$(PIP) --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/.develop: pyproject.toml lock/develop.txt | $(BIN)/python
	@echo "installing clampid with its development tools into $(VENV) (once; takes a minute or two)"
	@$(LOCKED) lock/develop.txt
	@$(PIP) --no-deps --no-build-isolation -e .
	@touch $@ $(VENV)/.run

# A machine may have venv without ensurepip (Debian splits them): then a pip from outside installs into it.
$(BIN)/python:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON): expected Python 3.11 or newer, found none; say which with make PYTHON=…" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 11) else f"expected Python 3.11 or newer, found {v[0]}.{v[1]}; say which with make PYTHON=…")'
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 \
	  || { rm -rf $(VENV); $(PYTHON) -m virtualenv --quiet $(VENV) >/dev/null 2>&1; } \
	  || { rm -rf $(VENV); $(PYTHON) -m venv --without-pip $(VENV) >/dev/null 2>&1 \
	       && $(PYTHON) -m pip --disable-pip-version-check --python $(VENV)/bin/python install --quiet pip >/dev/null 2>&1; } \
	  || { rm -rf $(VENV); \
	       echo "no environment could be made: $(PYTHON) -m venv needs ensurepip; on Debian and Ubuntu: sudo apt install python3-venv" >&2; \
	       exit 1; }

demo: $(VENV)/.run
	$(BIN)/clampid demo --seed $(SEED) --out $(OUT)

# What a user gets who installs the package: the wheel in an environment of its own, away from this folder.
wheel: $(VENV)/.run
	rm -rf build/wheel
	$(BIN)/python -m pip wheel -q --no-deps --no-build-isolation --wheel-dir build/wheel .
	$(MAKE) VENV=build/wheel/venv build/wheel/venv/bin/python
	build/wheel/venv/bin/python -m pip --disable-pip-version-check install -qq --require-hashes -r lock/run.txt
	cd build/wheel && env -u PYTHONPATH venv/bin/python -m pip --disable-pip-version-check install -qq --no-deps *.whl
	cd build/wheel && env -u PYTHONPATH venv/bin/clampid demo --seed $(SEED) --out demo

test: $(VENV)/.develop
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m $(if $(SLOW),"not study","not slow and not study")

test-slow: $(VENV)/.develop
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m slow

test-studies: $(VENV)/.develop
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m study

test-all:
	$(MAKE) test SLOW=yes

lint: $(VENV)/.develop
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# In an environment of its own: what audits is not part of what is audited. Without a network it says so and passes.
audit: | $(BIN)/python
	@$(PYTHON) -m venv build/audit 2>/dev/null && build/audit/bin/python -m pip --disable-pip-version-check install -qq pip-audit 2>/dev/null || true
	@$(BIN)/python .ci/audit.py build/audit/bin/python constraints.txt

# After a change of constraints.txt, or of what pyproject.toml needs. Adds to constraints.txt what it lacks, and removes the rest.
lock: | $(BIN)/python
	@$(PYTHON) -m venv build/lock && build/lock/bin/python -m pip --disable-pip-version-check install -qq uv
	@$(BIN)/python .ci/lock.py build/lock/bin/uv $(EXTRAS)

format: $(VENV)/.develop
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/.develop
	$(BIN)/python docs/check_sentences.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

figures: $(VENV)/.develop
	$(BIN)/python docs/make_figures.py
	$(BIN)/python docs/make_effects.py --picture
	$(BIN)/python docs/make_gallery.py

clean:
	rm -rf $(VENV) site build dist demo .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
