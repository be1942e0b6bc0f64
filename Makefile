# The tasks of this project; `make` alone lists them.
PYTHON ?= .venv/bin/python

.DEFAULT_GOAL := help
.PHONY: help setup test check times long lint bench docs site wheel scenes

help: ## list the tasks
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*##/\t/' | expand -t 10

setup: ## make .venv with everything that development needs
	python3 -m venv .venv
	$(PYTHON) -m pip install --quiet -e '.[dev]'

# What pytest makes of the tests' assertions is kept for the next run: 15 s in each process.
test check times long: export PYTHONDONTWRITEBYTECODE =

test: ## run the fast tests
	$(PYTHON) -m pytest -m "not slow and not long"

check: ## run all tests but for the long ones
	$(PYTHON) -m pytest

times: check ## run them, and report the dearest cases and fixtures
	$(PYTHON) -m tools.times

long: ## run the long tests and checks, with many generated cases: an hour, for the night
	$(PYTHON) -m tools.long

lint: ## check style, types and layers, and that what is generated is up to date
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy
	$(PYTHON) -c "from importlinter.cli import lint_imports_command as lint; lint()" --no-cache
	$(PYTHON) -m tools.build_kitchen --check
	$(PYTHON) -m tools.build_hall --check
	$(PYTHON) -m tools.build_chaos --check
	$(PYTHON) tools/write_reference.py --check
	$(MAKE) --no-print-directory site wheel

bench: ## print the tables of the benchmarks
	$(PYTHON) -m benchmarks

docs: ## write the manual's generated pages
	$(PYTHON) tools/write_reference.py

site: ## build the manual as a site, in build/site; a page that is not listed and a dead link are errors
	$(PYTHON) -m zensical build --strict --config-file mkdocs.yml

wheel: ## build the wheel and the source distribution, in dist, and check what they say of themselves
	rm -rf dist
	$(PYTHON) -m build --no-isolation >/dev/null
	$(PYTHON) -m twine check --strict dist/*

scenes: ## write the files of the scenes that are shipped
	$(PYTHON) -m tools.build_kitchen
	$(PYTHON) -m tools.build_hall
	$(PYTHON) -m tools.build_chaos
