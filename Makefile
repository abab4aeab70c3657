# `make paper` and `make test` do everything from a bare Python 3.11: virtual environment, pinned
# and tested dependencies, then the work.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: paper test test-slow lint docs figures brax-baseline clean

paper: $(READY)
	$(BIN)/fntg train --preset paper --seeds 30

test: $(READY)
	$(BIN)/python -m pytest

test-slow: $(READY)
	$(BIN)/python -m pytest -m slow

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(READY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

figures: $(READY)
	for n in 5 6 7 8; do $(BIN)/python experiments/fig$$n.py || exit; done

# PPO as people would use it, in an environment of its own: brax's release does not run with our jax.
brax-baseline: .venv-brax/.ready
	FNTG_XLA_FLAGS=off .venv-brax/bin/python -m experiments.optimizers --methods brax-ppo-mlp $(BRAX_OPTIONS)

.venv-brax/.ready: requirements-brax.txt
	$(PYTHON) -m venv .venv-brax
	.venv-brax/bin/python -m pip install --quiet --disable-pip-version-check -r $<
	.venv-brax/bin/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	touch $@

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev,compare,gym,docs]'
	touch $@

clean:
	rm -rf $(VENV) .venv-brax build *.egg-info
