# Midspan. `make` lists the targets; `make demo` and `make test` each set up everything they need.

BIN := .venv/bin

.PHONY: help setup demo mix bench-peers test test-fast test-all test-bytecode test-embedded-master test-everywhere test-arm64 lint types check bench screenshots dist deb lock clean
.DEFAULT_GOAL := help

# each process receives one file at a time; bytecode is cached, otherwise each process would compile all tests and programs
pytest = PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX='$(CURDIR)/.cache/bytecode' $(BIN)/python -m pytest \
    -o cache_dir=.cache/pytest --dist loadfile --no-loadscope-reorder

# 5: no test was selected; 1: tests failed, which are rerun at the end (with STRICT=1 the run ends instead)
go_on = case $$? in 5) ;; 1) $(if $(STRICT),exit 1,red=1) ;; *) exit 1 ;; esac
again = [ -z "$$red" ] || $(BIN)/python scripts/unsteady.py
forget = rm -rf .cache/pytest .cache/first-run

help: ## list the targets
	@sed -n 's/^\([a-z0-9-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 22

test test-all: export BROWSER = yes # for the tests of the console
test test-all: export KILTED = yes # programs of another release of ROS 2

setup: ## install what is missing; the other targets run it first
	@scripts/setup.sh

demo: setup ## a simulated R1 sent to rooms by YARP, ROS 1 and ROS 2 clients (STAY=1 stays, JSON=FILE, PNG=FILE write)
	@$(BIN)/midspan demo $(if $(PNG),--png '$(PNG)') $(if $(filter-out 0,$(STAY)),--stay) $(if $(JSON),--json '$(JSON)')

mix: setup ## clients of all four sides over three kinds of planners (JSON=FILE writes the table)
	@$(BIN)/python -m tests.peers.navigation.mix_table $(if $(JSON),--json '$(JSON)')

test: setup ## test Midspan on this machine with the real middlewares (ARGS='tests/hub -k latched' for some tests)
	@$(forget); $(pytest) -n 5 -m 'not thorough and not long' $(ARGS) || $(go_on); $(again)

test-fast: setup ## tests without middlewares, for the edit loop
	@$(pytest) -n 4 --fast -m 'not thorough and not long and not alone' $(ARGS)

test-all: setup ## all tests, including fuzzing, packages and a first run in a bare clone
	@$(forget); $(pytest) -n 6 $(ARGS) || $(go_on); $(again)

test-bytecode: # for .ci/run, after the set-up: one process compiles the tests, which takes three times as long as their import
	@$(pytest) -n 0 -qq --collect-only

test-embedded-master: setup ## the tests with ROS 1, on Midspan's own master instead of roscore
	@MIDSPAN_TEST_MASTER=embedded $(pytest) -n 5 tests/contract tests/interop tests/adapters/ros1 $(ARGS)

test-everywhere: setup ## the demo and the ROS 1 tests in other releases and with other Pythons (ARGS='trixie 3.13' for some)
	@$(BIN)/python scripts/everywhere.py $(ARGS)

test-arm64: setup ## the arm64 wheel under qemu in Debian 12 and 13 (needs root, debootstrap, qemu; ARGS=trixie for one)
	@$(BIN)/python scripts/arm64.py $(ARGS)

lint: setup ## ruff (rules and format), import cycles and sizes
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/python scripts/house.py --check

types: setup ## mypy
	@$(BIN)/mypy

check: lint types test ## lint, types and tests

bench-peers: setup ## install the libraries that the benchmarks compare with
	@$(BIN)/python -m pip install -q --disable-pip-version-check -c requirements.lock $$($(BIN)/python -c \
	    "import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['dependency-groups']['bench'])")

bench: bench-peers ## every benchmark, one after the other
	@set -e; for file in $$(grep -l __main__ benchmarks/*.py); do echo "== $$file"; $(BIN)/python $$file; done

arch = $(if $(ARCH),--arch '$(ARCH)')

dist: setup ## wheels and source distributions of midspan and yarp-compat, into dist/ (Linux; ARCH=arm64)
	@$(BIN)/python scripts/dist.py $(arch)

deb: dist ## Debian packages for Debian 12 and 13, Ubuntu 24.04 and 26.04, into dist/ (ARGS=bookworm for one, ARCH=arm64)
	@$(BIN)/python scripts/deb.py $(arch) $(ARGS)

screenshots: ## update the docs' screenshots of the console; ARGS=FOLDER: all views, for inspection
	@$(MAKE) -s setup BROWSER=yes
	@PYTHONPATH=. $(BIN)/python scripts/screenshots.py $(ARGS)

lock: setup ## resolve the newest compatible versions, and write the lock files
	@$(BIN)/python scripts/lock.py

clean: ## remove the virtual environment, compiled kernels and the tools' files (built message packages stay cached)
	rm -rf .venv .cache build dist bridge/kernels.json *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
	find bridge navigation sim -name '*.so' -delete
