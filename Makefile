# Everything sets itself up: a fresh machine needs Python 3.11 and make, no root and no activated environment.
#   make demo    the main job on a simulated rig
#   make test    the tests and doctests; make test COVERAGE=yes measures branch coverage, too
#   make long    the tests marked slow: whole diagnoses, fits, campaigns, outages
#   make check   style, types and import arrows
#   make bench   every benchmark, one after another
# Another interpreter: make test PYTHON=/path/to/python3

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
# also where PYTHONDONTWRITEBYTECODE is set: else a diagnosis would compile 215 modules, 0.4 s
COMPILE := $(BIN)/python -m compileall -q sim drivers service
# one more than there are cores: a third of the time a test waits for a server or a device
JOBS   ?= $(shell expr $$(env -u OMP_NUM_THREADS nproc 2>/dev/null || echo 1) + 1)

# modules are compiled once, not by every process that a test starts
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help demo test long check bench clean
.DELETE_ON_ERROR:

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "make %-7s %s\n", $$1, $$2}' $(firstword $(MAKEFILE_LIST))

demo: $(VENV)/.demo ## commission a simulated rig, from nothing to result.json and a report
	$(BIN)/ambit demo

PYTEST = OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist loadscope --no-loadscope-reorder

test: $(VENV)/.dev ## the tests and doctests; with COVERAGE=yes their branch coverage, too
	$(PYTEST) -m "not slow" $(if $(COVERAGE),--cov --cov-report=term) $(ARGS)

long: $(VENV)/.dev ## the tests marked slow: whole diagnoses, fits, campaigns, outages
	$(PYTEST) -m slow $(ARGS)

check: $(VENV)/.dev ## ruff, mypy (strict but for benchmarks), import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy --strict sim drivers service
	$(BIN)/mypy --follow-imports=silent --allow-any-generics --no-warn-return-any --allow-untyped-defs \
	  --allow-untyped-calls benchmarks
	$(BIN)/lint-imports --no-logo

bench: $(VENV)/.bench ## every benchmarks/*.py, one after another, on one thread
	@status=0; for file in $(sort $(wildcard benchmarks/*.py)); do \
	  case $$file in */_*) continue;; esac; \
	  echo "== $$file"; \
	  OMP_NUM_THREADS=1 $(BIN)/python "$$file" || { status=1; echo "failed: $$file" >&2; }; \
	done; exit $$status

clean: ## remove the environment, caches and output
	rm -rf $(VENV) build dist out htmlcov .coverage .coverage.* coverage.xml *.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# One environment, three stages; each stamp is renewed when the pins or the project file change.
$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer not found: install it, or say make PYTHON=..." >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "$(PYTHON) is older than Python 3.11: install a newer one, or say make PYTHON=..." >&2; exit 1; }
	@"$(PYTHON)" -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "$(PYTHON) cannot make a virtual environment: on Debian, install python3-venv" >&2; exit 1; }

$(VENV)/.demo: pyproject.toml constraints.txt | $(BIN)/python
	@echo 'installing into $(VENV), a minute or two'
	@$(PIP) -e .
	@$(COMPILE)
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	@echo 'installing into $(VENV), a minute or two'
	@$(PIP) -e '.[dev]'
	@$(COMPILE)
	@touch $@ $(VENV)/.demo

$(VENV)/.bench: pyproject.toml constraints.txt | $(BIN)/python
	@echo 'installing into $(VENV), a minute or two'
	@$(PIP) -e '.[dev,bench]'
	@$(COMPILE)
	@touch $@ $(VENV)/.dev $(VENV)/.demo
