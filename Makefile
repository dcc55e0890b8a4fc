# One vocabulary for people, hooks and CI.  make demo | test | check | bench | setup
.DEFAULT_GOAL := help
.PHONY: help setup demo check test bench clean
MAKEFLAGS += --no-print-directory

BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet --quiet
# The first Python that constraints.txt has wheels for; override with `make PYTHON=...`.
PYTHON ?= $(firstword $(foreach p,python3 python3.11 python3.12 python3.13,$(shell \
	$(p) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $(p))))
# Where a torch without CUDA comes from, beside the configured indexes. A CUDA build would be gigabytes.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

help:
	@echo "make demo    one blurred picture through the whole chain"
	@echo "make test    the tests"
	@echo "make check   formatting, lint, types and import contracts"
	@echo "make bench   timings beside their peers', into bench.json (QUICK=1: within a minute)"
	@echo "make setup   install everything into .venv (the others do it when needed)"

setup: .venv/dev.stamp

demo: .venv/run.stamp
	@$(BIN)/hfb demo

check: .venv/dev.stamp
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check --quiet .
	@$(BIN)/mypy
	@said=$$($(BIN)/lint-imports --no-logo) || { echo "$$said"; exit 1; }

test: .venv/dev.stamp
	@$(BIN)/python -m pytest

bench: .venv/dev.stamp
	@HFB_BENCH=$(if $(filter-out 0,$(QUICK)),quick,full) $(BIN)/python -m pytest tests/bench --benchmark-enable

clean:
	rm -rf .venv build *.egg-info

# Stamps are newer than what they were made from: an edit of either file installs again.
.venv/run.stamp: pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "hfb needs Python 3.11, 3.12 or 3.13; name one with make PYTHON=/path/to/python"; exit 1; }
	@echo "installing into .venv (about two minutes; once)"
	@$(PYTHON) -m venv .venv
	@$(PIP) install --retries 1 --extra-index-url $(TORCH_INDEX) --no-deps $$(grep '^torch==' constraints.txt)
	@$(PIP) install --constraint constraints.txt --editable .
	@touch $@

.venv/dev.stamp: .venv/run.stamp
	@echo "installing the tools for development"
	@$(PIP) install --constraint constraints.txt --editable '.[dev]'
	@touch $@
