# make demo   install into .venv and show the main job; says where the report is
# make test   install the development tools and run the whole test suite
# make lint   ruff and mypy;   make docs   the documentation site;   make clean
VENV := .venv
BIN := $(VENV)/bin
OUT := out
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
  $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { command -v $$p; break; }; done)

.PHONY: demo test lint docs clean
.DEFAULT_GOAL := help

.PHONY: help
help:
	@sed -n 's/^# //p' Makefile

demo: $(VENV)/installed
	$(BIN)/patu demo --force -o $(OUT)/demo

test: $(VENV)/installed-dev
	$(BIN)/pytest -n auto --dist worksteal --durations=10

lint: $(VENV)/installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

docs: $(VENV)/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir $(OUT)/site
	@echo "Documentation: $(OUT)/site/index.html"

clean:
	rm -rf $(VENV) $(OUT) build dist *.egg-info

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "No Python 3.11 or newer was found. Install it, or say where: make PYTHON=/path/to/python3.11" >&2; exit 2; }
	@rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)

# editable: what is changed in the checkout is what runs, and these need no repeating
$(VENV)/installed: $(BIN)/python pyproject.toml
	@echo "Installing into $(VENV), a minute or two"
	@$(PIP) -e .
	@touch $@

$(VENV)/installed-dev: $(BIN)/python pyproject.toml
	@echo "Installing with the development tools into $(VENV), a minute or two"
	@$(PIP) -e '.[dev]'
	@touch $@ $(VENV)/installed
