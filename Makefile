# `make help` lists the targets; each sets up the environment it needs.
PYTHON ?= python3
VENV := .venv
PY := $(VENV)/bin/python
PIP := $(PY) -m pip --disable-pip-version-check install --quiet
# Pinned exactly: a looser requirement may install gigabytes of GPU packages on a CPU machine.
TORCH := torch==2.13.0
# Tests start many processes: without bytecode each would compile every module again.
PYTEST := env -u PYTHONDONTWRITEBYTECODE $(PY) -m pytest
# Only comparisons with MuJoCo's own renderer use OpenGL; EGL needs no display.
export MUJOCO_GL ?= egl

.PHONY: help demo best test test-thorough test-ray check format lint types fast-tests docs snippets torture mutate bench bench-compare clean

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

demo: $(VENV)/.runtime ## set up .venv, train two small agents, write runs/demo/report.html
	$(PY) -m knowarm demo

# The recipe of the shipped policy zoo/irb120-full-fast. After Ctrl-C, `make best` resumes.
BEST := irb120-full-fast
best: $(VENV)/.runtime ## train and evaluate the best recipe so far in runs/best (99 % success)
	$(PY) -m knowarm train $(BEST) --runs runs/best \
	  $(if $(wildcard runs/best/$(BEST)/0/checkpoints),--resume)
	$(PY) -m knowarm evaluate runs/best/$(BEST)/0

test: $(VENV)/.dev ## set up .venv, run all tests
	$(PYTEST) -n 2 --dist worksteal --durations 25

test-thorough: $(VENV)/.dev ## run all tests with full products, large samples and many kills
	KNOWARM_TESTS_THOROUGH=1 $(PYTEST) -n 2 --dist worksteal --durations 25

check: format-check lint types fast-tests ## format, lint, types and fast tests: what every commit must pass

format: $(VENV)/.dev ## format the code
	$(PY) -m ruff format .
	$(PY) -m ruff check --fix .

.PHONY: format-check
format-check: $(VENV)/.dev
	$(PY) -m ruff format --check .

lint: $(VENV)/.dev ## run ruff
	$(PY) -m ruff check .

types: $(VENV)/.dev ## run mypy
	$(PY) -m mypy

fast-tests: $(VENV)/.dev ## run the fast tests
	$(PYTEST) -q -n 2 --dist worksteal -m "not slow and not browser and not opengl"

# Ray stays out of .venv, which the tests need as users have it.
RAY := $(CURDIR)/build/ray
test-ray: $(VENV)/.dev ## install Ray beside .venv, and run a study on a cluster of two nodes
	test -e $(RAY)/bin/ray || $(PIP) --target $(RAY) 'ray>=2.54'
	PATH="$(RAY)/bin:$$PATH" PYTHONPATH=$(RAY) $(PY) -m pytest tests/study/test_ray.py

torture: $(VENV)/.dev ## kill and damage it for twenty minutes or more: docs/reliability.md
	$(PY) -m tests.robustness.torture

# All of [tool.mutmut] in pyproject.toml, or a part: make mutate MUTANTS='knowarm.learn.losses*'
MUTANTS :=
mutate: $(VENV)/.dev ## change the numeric modules in small ways, one by one: do the tests notice?
	$(VENV)/bin/mutmut run $(foreach each,$(MUTANTS),'$(each)')
	$(VENV)/bin/mutmut results

docs: $(VENV)/.dev ## build and check the documentation site in docs/_build/html
	$(PY) -m sphinx -W --keep-going -q -b html docs docs/_build/html
	$(PY) scripts/check_site.py docs/_build/html

snippets: $(VENV)/.dev ## run every command and code block of the documentation, shortened
	$(PYTEST) -q -n 2 --dist worksteal --durations 25 tests/snippets/test_snippets.py

bench: $(VENV)/.runtime ## measure the speed of this machine: simulation, images, training
	$(PY) -m benchmarks.speed --json runs/bench/speed.json

bench-compare: $(VENV)/.dev ## compare the speed with Gymnasium + OpenGL, MuJoCo Warp and sb3-contrib
	$(PY) -m benchmarks.compare_world --json runs/bench/compare-world.json
	$(PY) -m benchmarks.compare_learn --json runs/bench/compare-learn.json

clean: ## remove the environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache build dist mutants
