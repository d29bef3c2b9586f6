# The commands of the README. Needs python3 and a network for the first call; everything lands in .venv and .cache.
SHELL := /bin/bash
.ONESHELL:
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

OWN_UV := .cache/uv/bin/uv
UV := $(or $(shell command -v uv),$(OWN_UV))
PYTHON := .venv/bin/python
DEBIAN := libegl1 libosmesa6 libgl1 chromium
PORT ?= 4200
ARGS ?=

.PHONY: help demo test check bench serve clean
help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | column -t -s $$'\t'

demo: .venv/.run ## the reference loop: live progress, then the table and the report (options: ARGS="--seed 1")
	@.venv/bin/hardcase loop $(ARGS)

test: .venv/.test ## everything that the tests need, then all tests
	@$(PYTHON) -m pytest -n 2 --dist loadgroup $(ARGS)

check: .venv/.test ## ruff, pyright, layout guard
	@.venv/bin/ruff check -q .
	.venv/bin/pyright
	$(PYTHON) -m pytest tests/test_layout.py

bench: .venv/.test ## the benchmarks; leave the machine alone meanwhile
	@$(PYTHON) -m pytest -o python_files='bench_*.py' -p no:xdist --timeout 1800 $(ARGS)

serve: .venv/.run ## Prefect server, worker and deployments on this machine, until Ctrl-C
	@$(PYTHON) -m flows.serve --port $(PORT)

clean: ## remove environment and caches; the store stays
	rm -rf .venv .cache .pytest_cache .ruff_cache .hypothesis .benchmarks

# What the product needs. Dry facts about the environment: compiled to bytecode, exactly uv.lock,
# and with the empty Prefect database that the first start would otherwise migrate.
.venv/.run: uv.lock pyproject.toml .python-version | $(UV)
	@$(UV) sync --frozen --no-dev --inexact
	$(PYTHON) -m flows.service.embedded_server prepare
	touch $@

.venv/.test: .venv/.run
	@$(UV) sync --frozen
	missing=$$(dpkg-query -W -f '$${db:Status-Status} $${Package}\n' $(DEBIAN) 2>/dev/null | awk '$$1 == "installed" {print $$2}' \
	  | sort | comm -13 - <(printf '%s\n' $(DEBIAN) | sort) | xargs || true)
	if [ -n "$$missing" ]; then
	  if command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ]; then
	    apt-get update -q && DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends $$missing
	  else
	    echo "some tests of pictures and pages will be skipped; for all: sudo apt-get install -y $$missing" >&2
	  fi
	fi
	touch $@

$(OWN_UV):
	@if ! python3 -m venv .cache/uv >/dev/null 2>&1; then
	  rm -rf .cache/uv
	  echo 'python3 cannot make a virtual environment; install it: sudo apt-get install -y python3-venv' >&2
	  exit 1
	fi
	.cache/uv/bin/python -m pip install -q --disable-pip-version-check 'uv>=0.8,<1'
