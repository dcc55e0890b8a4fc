# One vocabulary for people, hooks and CI.  make demo | test | check | bench | setup | up | down
.DEFAULT_GOAL := help
.PHONY: help setup demo check lint format types imports services docs test bench findings pictures up down audit sbom clean
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
	@echo "make test    the tests; make test-unit  those that need neither a server nor a process (tests/README.md)"
	@echo "make check   formatting, lint, types, import contracts, Compose and Kubernetes files, documents"
	@echo "make docs    the site of the documents, into build/docs"
	@echo "make bench   timings beside their peers', into bench.json (QUICK=1: within a minute; BASELINE=another checkout: beside its)"
	@echo "make findings  what libraries do otherwise than expected, each with pinned packages; needs the package index"
	@echo "make up      Prefect, MLflow and a worker for a team, with a login; needs Docker (infra/compose/README.md)"
	@echo "make down    end them; what they hold stays"
	@echo "make audit   known holes of the pinned packages; asks the package index"
	@echo "make sbom    sbom.json: what is installed (CycloneDX)"
	@echo "make setup   install everything into .venv (the others do it when needed)"

setup: .venv/dev.stamp

demo: .venv/run.stamp
	@$(BIN)/hfb demo

# Each part is a hook of .pre-commit-config.yaml as well.
check: lint format types imports services docs

lint: .venv/dev.stamp
	@$(BIN)/ruff check .

format: .venv/dev.stamp
	@$(BIN)/ruff format --check --quiet .

types: .venv/dev.stamp
	@$(BIN)/mypy

imports: .venv/dev.stamp
	@said=$$($(BIN)/lint-imports --no-logo) || { echo "$$said"; exit 1; }

services: .venv/dev.stamp
	@said=$$($(BIN)/python -m pytest tests/infra/test_files.py) || { echo "$$said"; exit 1; }

# Warnings are errors. What has not changed is not built again.
docs: .venv/dev.stamp
	@$(BIN)/python -m sphinx --builder html --conf-dir docs --fail-on-warning --keep-going --quiet . build/docs

# Which tests share a process, and in which order they begin: tests/kinds.py.
TEST = $(BIN)/python -m pytest --numprocesses logical --maxprocesses 4 --durations 20 --durations-min 5
test: .venv/dev.stamp
	@$(TEST)

test-unit: .venv/dev.stamp
	@$(TEST) -m unit

bench: .venv/dev.stamp
	@HFB_BENCH=$(if $(filter-out 0,$(QUICK)),quick,full) $(BIN)/python -m pytest tests/bench --benchmark-enable

# The images of the documents: the rooms from the import contracts, the moving picture from a demo's result.
pictures: .venv/dev.stamp
	@$(BIN)/python docs/images/rooms.py
	@$(BIN)/hfb demo --quiet --out build/demo > /dev/null
	@$(BIN)/python docs/images/moving.py build/demo

findings:
	@changed=; for script in findings/*.sh; do echo "== $$script"; bash "$$script" || changed="$$changed $$script"; done; \
		test -z "$$changed" || { echo "no longer so:$$changed"; exit 1; }

# Of a team: HFB_HOST=name of this machine, HFB_DATA=folder with clips, GPU=1, HA=1.  Whoever runs it owns the files.
HFB_HOST ?= localhost
export HFB_HOST
export HFB_STATE ?= $(CURDIR)/runs/team
export HFB_DATA ?= $(CURDIR)/runs/team/data
export HFB_BIND ?= $(if $(filter localhost,$(HFB_HOST)),127.0.0.1,0.0.0.0)
export HFB_UID ?= $(or $(filter-out 0,$(shell id -u)),1000)
export HFB_GID ?= $(or $(filter-out 0,$(shell id -g)),1000)
export HFB_CPUS ?= $(shell nproc 2> /dev/null || echo 2)
export HFB_NOTIFY
COMPOSE = docker compose --file infra/compose/compose.yaml $(if $(filter-out 0,$(HA)),--file infra/compose/compose.ha.yaml) \
	$(if $(HFB_NOTIFY),--file infra/compose/compose.notify.yaml) \
	$(if $(filter-out 0,$(GPU)),--profile gpu)

up:
	@infra/compose/prepare.sh "$(HFB_STATE)" "$(HFB_HOST)" "$(HFB_DATA)"
	@$(COMPOSE) up --build --detach
	@echo "Prefect  https://$(HFB_HOST):4200   login: $(HFB_STATE)/secrets/prefect_auth; the administrator's: prefect_admin"
	@echo "MLflow   https://$(HFB_HOST):5000   login: admin, $(HFB_STATE)/secrets/mlflow_admin"
	@echo "clips    $(HFB_DATA)/clips"

down:
	@$(COMPOSE) --profile gpu down

# A package that the index does not know is no reason to stop, and no pass: it is named at the end.
audit: .venv/audit.stamp
	@$(BIN)/python infra/audit/audit.py .venv/audit/bin/pip-audit constraints.txt

sbom: .venv/run.stamp .venv/audit.stamp
	@.venv/audit/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --of JSON -o sbom.json $(BIN)/python
	@echo "sbom.json"

clean:
	rm -rf .venv build *.egg-info

# Stamps are newer than what they were made from: an edit of either file installs again.
.venv/run.stamp: pyproject.toml constraints.txt
	@test -n "$(PYTHON)" || { echo "hfb needs Python 3.11, 3.12 or 3.13; name one with make PYTHON=/path/to/python"; exit 1; }
	@echo "installing into .venv (about three minutes; once)"
	@$(PYTHON) -m venv .venv
	@$(PIP) install --retries 1 --extra-index-url $(TORCH_INDEX) --no-deps $$(grep '^torch==' constraints.txt)
	@$(PIP) install --constraint constraints.txt --editable .
	-@$(BIN)/python -m hfb.kernels.ready
	@touch $@

.venv/dev.stamp: .venv/run.stamp
	@echo "installing the tools for development"
	@$(PIP) install --constraint constraints.txt --editable '.[dev]'
	@touch $@

.venv/audit.stamp: .venv/run.stamp infra/audit/requirements.txt
	@echo "installing the tools of audits"
	@$(PYTHON) -m venv .venv/audit
	@.venv/audit/bin/python -m pip --disable-pip-version-check --quiet install --no-deps --requirement infra/audit/requirements.txt
	@touch $@
