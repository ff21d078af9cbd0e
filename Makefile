# `make demo` and `make test` set up what they need and run; `make help` lists the rest.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip --disable-pip-version-check install --quiet
# One exact pin: a looser one may pull gigabytes of GPU packages onto a machine without a GPU.
TORCH := torch==2.13.0
# Only the comparison with MuJoCo's own renderer draws with OpenGL; EGL needs no display.
export MUJOCO_GL ?= egl

.PHONY: help demo test check format lint types fast-tests bench clean

help: ## list the targets
	@grep -E '^[a-z-]+:.*##' Makefile | sed 's/:.*##/\t/'

$(VENV)/.runtime: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(PIP) $(TORCH)
	$(PIP) -e .
	touch $@

$(VENV)/.dev: $(VENV)/.runtime
	$(PIP) -e '.[dev]'
	touch $@

demo: $(VENV)/.runtime ## set up .venv, train bm and full on IRB120, write runs/demo/report.html
	$(PY) -m knowarm demo

test: $(VENV)/.dev ## set up .venv, run every test
	$(PY) -m pytest -n 2 --dist worksteal

check: format-check lint types fast-tests ## what every commit passes

format: $(VENV)/.dev ## rewrite the code in the project's format
	$(PY) -m ruff format .
	$(PY) -m ruff check --fix .

.PHONY: format-check
format-check: $(VENV)/.dev
	$(PY) -m ruff format --check .

lint: $(VENV)/.dev ## ruff
	$(PY) -m ruff check .

types: $(VENV)/.dev ## mypy
	$(PY) -m mypy

fast-tests: $(VENV)/.dev ## the tests that take seconds
	$(PY) -m pytest -q -n 2 --dist worksteal -m "not slow and not browser and not opengl"

bench: $(VENV)/.dev ## measure this machine: worlds, then learning
	$(PY) -m knowarm bench world --json runs/bench/world.json
	$(PY) -m knowarm bench learn --json runs/bench/learn.json

clean: ## remove caches, the environment and nothing else
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache build dist
