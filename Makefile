# Everything works in .venv, which the first target that needs it sets up; the second run does not.
#   make demo    the main job: a simulated robot opens a cabinet it has never seen
#   make test    the tests
#   make lint    ruff and mypy
#   make check   ruff, mypy and the tests
#   make slow    the statistical and long tests
#   make bench   timings
#   make test-hardware   arm and camera against what stands in for them (docs/hardware.md)
#   make docs    the documentation site, docs/_build/html/index.html
#   make docs-links   whether its links to other sites lead somewhere (needs the network)
#   make peer    the environment of the peer that experiments compare with (.venv-peer)
#   make experiments   every comparison of docs/experiments.md; hours, goes on where it was cut
#   make lock    renew requirements.lock from setup.cfg

PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# Byte code is made at first import: compiling all of it takes longer than the tests need.
INSTALL := $(PIP) install --no-compile
# Which needs leave to be kept: dozens of tests begin a new process.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test lint check slow bench test-hardware docs docs-links peer experiments lock clean

demo: $(READY)
	$(BIN)/akm-fg demo

# In as many processes as there are processors, each with one thread. Four at most: every process
# loads the libraries and makes its own of what the tests share.
WORKERS ?= $(shell n=$$(nproc 2>/dev/null || echo 2); echo $$((n < 4 ? n : 4)))
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

test: $(READY)
	$(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal --benchmark-disable

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

check: lint test

slow: $(READY)
	$(BIN)/python -m pytest -m slow --durations=10

bench: $(READY)
	$(BIN)/python -m pytest -m "slow or not slow" --benchmark-only --benchmark-disable-gc

test-hardware: $(READY)
	$(INSTALL) --no-build-isolation --editable ".[hardware-test]"
	$(BIN)/python -m pytest tests/akm_fg/hardware -m "hardware or not slow" --durations=10

docs: $(READY)
	$(BIN)/python -m sphinx -W --keep-going -q docs docs/_build/html
	@echo "docs/_build/html/index.html"

docs-links: $(READY)
	$(BIN)/python -m sphinx -q -b linkcheck docs docs/_build/links

$(READY): requirements.lock requirements-torch.lock setup.cfg pyproject.toml
	@echo "setting up $(VENV) (once, about two minutes)"
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if v == (3, 11) else "Python 3.11 is needed (PyBullet has no wheel for others), this is %d.%d; set PYTHON=" % v)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(INSTALL) -r requirements.lock
	$(INSTALL) --no-deps --no-build-isolation --editable .
	$(INSTALL) -r requirements-torch.lock || \
	  $(INSTALL) --extra-index-url https://download.pytorch.org/whl/cpu -r requirements-torch.lock || \
	  echo "no CPU build of torch found: exploration goes by geometry alone, and the tests of the paper's method will be skipped"
	touch $@

peer: .venv-peer/.ready

.venv-peer/.ready: experiments/peers/requirements-ripl.txt
	test -x .venv-peer/bin/python || $(PYTHON) -m venv .venv-peer
	.venv-peer/bin/python -m pip --disable-pip-version-check --quiet install --no-compile -r $<
	touch $@

experiments: export OMP_NUM_THREADS := 1
experiments: $(READY) peer
	$(BIN)/python -m experiments.accuracy_grid --part table --method graph --runs 200
	$(BIN)/python -m experiments.accuracy_grid --part table --method paper --runs 48
	$(BIN)/python -m experiments.accuracy_grid --part table --method peer --runs 48
	$(BIN)/python -m experiments.accuracy_grid --part grid --method graph --runs 40
	$(BIN)/python -m experiments.kind_against_travel --runs 100
	$(BIN)/python -m experiments.kind_against_travel --method paper --runs 20
	-$(BIN)/python -m experiments.rendered_recordings --suite furniture-116 --out runs/recordings
	$(BIN)/python -m experiments.surface_gain --recordings runs/recordings
	$(BIN)/python -m experiments.claims.rig_errors --recordings runs/recordings
	$(BIN)/python -m experiments.claims.pose_logs --runs 20
	$(BIN)/python -m experiments.claims.reliability --runs 10000
	$(BIN)/python -m experiments.report

lock:
	rm -rf .venv-lock
	$(PYTHON) -m venv .venv-lock
	.venv-lock/bin/python -m pip --quiet install "setuptools>=77" ".[sim,view,io,realsense,test,docs,dev]"
	( echo "# Exact versions of everything \`make\` installs (CPython 3.11). Renew with \`make lock\`."; \
	  .venv-lock/bin/python -m pip freeze --all --exclude akm-fg --exclude pip ) > requirements.lock
	rm -rf .venv-lock

clean:
	rm -rf $(VENV) .venv-lock .venv-peer build docs/_build *.egg-info .pytest_cache .mypy_cache .ruff_cache .benchmarks
