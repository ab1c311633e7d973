# Midspan. `make` lists the targets; `make demo` and `make test` each set up everything they need.

BIN := .venv/bin

.PHONY: help setup demo mix test lint types check bench lock clean
.DEFAULT_GOAL := help

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 8

setup: ## install what is missing; done by the others
	@scripts/setup.sh

demo: setup ## a simulated R1 sent to rooms by YARP, ROS 1 and ROS 2 clients (STAY=1 stays, JSON=FILE, PNG=FILE write)
	@$(BIN)/midspan demo $(if $(PNG),--png '$(PNG)') $(if $(filter-out 0,$(STAY)),--stay) $(if $(JSON),--json '$(JSON)')

mix: setup ## clients of all four sides over three kinds of planners (JSON=FILE writes the table)
	@$(BIN)/python -m tests.interop.mix_table $(if $(JSON),--json '$(JSON)')

test: setup ## all tests, on the real middlewares (ARGS='tests/hub -k latched' for some)
	@$(BIN)/python -m pytest -p no:cacheprovider -n 3 --dist loadfile --no-loadscope-reorder -m 'not alone' $(ARGS) || [ $$? -eq 5 ] # 5: none chosen
	@$(BIN)/python -m pytest -p no:cacheprovider -m alone $(ARGS) || [ $$? -eq 5 ]

lint: setup ## ruff: rules and format
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .

types: setup ## mypy
	@$(BIN)/mypy

check: lint types test ## lint, types and tests

bench: setup ## every benchmark, one after the other
	@set -e; for file in $$(grep -l __main__ benchmarks/*.py); do echo "== $$file"; $(BIN)/python $$file; done

lock: setup ## choose the newest versions that fit, and write the lock files
	@$(BIN)/python scripts/lock.py

clean: ## remove the virtual environment and what tools left behind (built message packages stay in their cache)
	rm -rf .venv build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
