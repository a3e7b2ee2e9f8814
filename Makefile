# Everything a user types. `make demo` and `make test` set up all they need by themselves.
SHELL := /bin/bash
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO ?= build/demo

# How many tests run at a time.
WORKERS ?= $(shell n=$$(nproc); echo $$((n < 4 ? n : 4)))
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

.PHONY: help env demo test test-quick test-long test-random test-programs lint format docs dist figures perf schemas structure mutants nightly clean

help:
	@echo "make demo   record a synthetic scene, curate it, show the label error, exports, a leaderboard"
	@echo "make test   all tests (make test-quick: without the slow ones; make test-long: long runs;"
	@echo "            make test-random: in another order each time)"
	@echo "make lint   ruff and mypy"
	@echo "make docs   the documentation site in build/site"
	@echo "make figures   the measured figures of docs/results/ in README, guides and cards"
	@echo "make dist   wheel and source distribution in build/dist"
	@echo "make perf   tables of timings and ratios (make perf PERF=perf/render.py: of some scripts)"
	@echo "make mutants   small changes of the code that no test notices (up to 2 hours)"
	@echo "make nightly   what make test leaves out: site, wheel, schemas, structure, short perf and mutants"
	@echo "make structure   modules, circles of imports, files per flow"
	@echo "make env    the environment in $(VENV) alone"

env: $(VENV)/.complete

$(VENV)/.complete: pyproject.toml constraints.txt tools/make-env tools/system-libraries
	@tools/make-env "$(PYTHON)" "$(VENV)"

demo: env
	@$(BIN)/python -m sensors.synthetic demo "$(DEMO)"
	@echo "== which method restores the depth of glass and metal?"
	@rm -rf "$(DEMO)/benchmark"  # scored anew: the recording may have changed
	@$(BIN)/std-bench --method raw nearest telea colorization planes swindrnet nlspn dfnet compactdr \
		std-restore --preset compact --data "$(DEMO)" --split scenes --out "$(DEMO)/benchmark" --no-speed >/dev/null
	@$(BIN)/std-report "$(DEMO)/benchmark"

test: env test-programs
	@$(PYTEST)

test-quick: env test-programs
	@$(PYTEST) -m "not slow and not long"

# What `make test` has in short.
test-long: env test-programs
	@$(PYTEST) -m long -o faulthandler_timeout=7500

test-random: env test-programs
	@$(PYTEST) -p randomly

# Only tests need a virtual display and a browser.
test-programs:
	@tools/system-libraries test

lint: env
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

format: env
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

# The site in build/site. It fails on a broken link, a public name without docstring, a Python block
# that does not run, or an option that does not exist.
docs: env
	@tools/make-env "$(PYTHON)" "$(VENV)" docs
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --clean

# Figures live in docs/results/*.csv; pages show them between invisible comments (tools/figures.py).
figures: env
	@$(BIN)/python tools/figures.py

dist: env
	@$(BIN)/python tools/make_dist.py --out build/dist

# Scripts with their options: PERF="perf/core.py 'perf/render.py --frames 1'".
PERF ?= perf/*.py
NIGHTLY_PERF := perf/core.py 'perf/render.py --frames 2' 'perf/bench_score.py --frames 4'

perf: env
	@for script in $(PERF); do echo "== $$script"; $(BIN)/python $$script || exit 1; done

structure: env
	@$(BIN)/python tools/structure.py --flows

mutants: env
	@tools/make-env "$(PYTHON)" "$(VENV)" mutants
	@$(BIN)/python tools/mutants.py $(MUTANTS)

schemas: env
	@$(BIN)/std-curate schema --out schemas

# Every target that a reader is offered and that neither `make lint` nor `make test` runs. It fails on
# schemas that are not those of the code.
nightly: env
	@$(MAKE) docs dist structure schemas
	@git diff --exit-code --stat -- schemas || { echo "error: schemas/ is stale; commit what make schemas wrote" >&2; exit 1; }
	@tools/try-wheel
	@$(MAKE) perf PERF="$(NIGHTLY_PERF)"
	@$(MAKE) mutants MUTANTS="--count 24"

clean:
	rm -rf build $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis *.egg-info
