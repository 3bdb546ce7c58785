# Two commands are all a newcomer needs: `make serve` and `make test`.
# Each makes .venv if it is missing and installs what it needs; a change of pyproject.toml installs again.

PYTHON ?= python3
HOST ?= 127.0.0.1
PORT ?= 8000
# Installed first and by itself, so that pip's configured index decides on the build (CPU or GPU).
TORCH ?= torch==2.13.0

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
COMMA := ,
# Installs packages, and compiles numba's loops meanwhile, so that the first start need not. pip's own
# bytecode would cost ten seconds more; Python makes it for the modules that are imported.
define install_and_compile
	@echo "Installing $(1) into $(VENV): $(2) on two cores, once"
	@$(PIP) install --no-compile numba
	@{ PYTHONPATH=trajectory $(BIN)/python -m anchorflow_trajectory.warm_up $(3) $(4); } & loops=$$!; \
	echo "Installing what is missing, and compiling meanwhile" && \
	$(PIP) install --no-compile $(1) && echo "Installed." && wait $$loops
endef

# The controller's loops as well: several processes of tests would compile them at the same time.
COMPILE_CONTROLLER := && PYTHONPATH=trajectory:client:control $(BIN)/python -m anchorflow_control.warm_up

.DEFAULT_GOAL := help
.PHONY: help serve toolkit test lint format bench docs walkthrough image clean

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

serve: $(VENV)/.service  ## Serve the default bundle at HOST and PORT (127.0.0.1, 8000); installs no torch
	@echo "Loading the bundle"
	@$(BIN)/anchorflow serve --host $(HOST) --port $(PORT)

toolkit: $(VENV)/.toolkit  ## Add what training and export need (torch, onnx) to .venv

# One thread of torch a worker: where each has as many as cores, most of their time is waiting. And
# bytecode is kept: the servers that tests start by the dozen would compile every module anew. Two
# workers more than there are cores: many tests wait for a browser or for servers.
test: $(VENV)/.dev  ## Run every test, on every core
	OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest \
		--numprocesses $$(( $$(getconf _NPROCESSORS_ONLN) + 2 )) --dist worksteal

lint: $(VENV)/.dev  ## Check style, import walls and types
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright --pythonpath $(BIN)/python

format: $(VENV)/.dev  ## Format the code and mend what ruff can mend
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

bench: $(VENV)/.dev  ## Measure quality, latency and load into benchmarks/results/ (minutes)
	$(BIN)/anchorflow bench quality
	$(BIN)/anchorflow bench latency
	$(BIN)/anchorflow bench load

docs: $(VENV)/.docs  ## Build the documentation into site/; a warning is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

walkthrough: $(VENV)/.dev  ## Type what the documentation prints, in a fresh checkout (half an hour)
	$(BIN)/python docs/walkthrough.py

image:  ## Build the image with buildah, run it, ask it for anchors (as root; skips where it cannot)
	docker/build_and_try.sh

clean:  ## Remove .venv, caches and what was built
	rm -rf $(VENV) artefacts dist site .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/.created:
	@echo "Making $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.service: pyproject.toml $(VENV)/.created
	$(call install_and_compile,--editable '.[service$(COMMA)language]',about a minute,still)
	@touch $@

$(VENV)/.toolkit: pyproject.toml $(VENV)/.created
	@echo "Installing $(TORCH)"
	@$(PIP) install '$(TORCH)'
	$(call install_and_compile,--editable '.[service$(COMMA)train$(COMMA)plot]',two to three minutes)
	@touch $@

$(VENV)/.docs: pyproject.toml $(VENV)/.created
	@echo "Installing --editable '.[docs]'"
	@$(PIP) install --editable '.[docs]'
	@touch $@

$(VENV)/.dev: pyproject.toml $(VENV)/.created
	@echo "Installing $(TORCH)"
	@$(PIP) install '$(TORCH)'
	$(call install_and_compile,--editable '.[dev]',two to three minutes,,$(COMPILE_CONTROLLER))
	@touch $@
