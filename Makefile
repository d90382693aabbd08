# Each target makes the environment that it needs in .venv; nothing has to be set up first.
# `make help` lists the targets. `make PYTHON=python3.12 test` takes another interpreter.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
# Each test process computes on one thread: together they fill the machine.
PYTEST := OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python -m pytest
PARALLEL := -n auto --maxprocesses 8

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow test-gpu check format clean

help: ## Show this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | while IFS="$$(printf '\t')" read -r name text; \
		do printf '  make %-10s %s\n' "$$name" "$$text"; done

demo: $(VENV)/.core ## Evolve a shape and write pictures and meshes to demo-output/
	$(BIN)/levelflow demo -o demo-output

test: $(VENV)/.test ## Run the tests, but for the slow ones and those that need a GPU
	$(PYTEST) $(PARALLEL) -m "not slow and not gpu" $(ARGS)

test-slow: $(VENV)/.test ## Run the slow tests
	$(PYTEST) $(PARALLEL) -m "slow and not gpu" $(ARGS)

test-gpu: $(VENV)/.test ## Run the tests that need a GPU
	$(PYTEST) -m gpu $(ARGS)

check: $(VENV)/.dev ## Lint, check the format and the types
	@failed=; for step in "ruff check ." "ruff format --check ." "mypy"; do \
		echo "$$step"; $(BIN)/$$step || failed="$$failed [$$step]"; \
	done; if [ -n "$$failed" ]; then echo "failed:$$failed"; exit 1; fi

format: $(VENV)/.dev ## Put the code into its format, and repair what lint can repair
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

clean: ## Remove the environment, caches and the output of the demo
	rm -rf $(VENV) build dist demo-output .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The environment is made anew whenever its description changes.
$(VENV)/.made: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "levelflow needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1)." \
			"Try: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' || { \
		echo "$(PYTHON) cannot make environments; install its venv module (on Debian: python3-venv)." >&2; exit 1; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.core: $(VENV)/.made
	$(PIP) -e .
	touch $@

$(VENV)/.test: $(VENV)/.made
	$(PIP) -e '.[test]'
	touch $@ $(VENV)/.core

$(VENV)/.dev: $(VENV)/.made
	$(PIP) -e '.[dev]'
	touch $@ $(VENV)/.core $(VENV)/.test
