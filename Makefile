# Everything a reader or a developer does with this project; `make help` lists it.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
PROFILE ?= full
RESULTS ?=
SCHEDULER ?=
RESTART ?=
TENSORBOARD ?=
TORCH_INDEX ?=

VENV := .venv
RUN := $(VENV)/bin/python -m
READY := $(VENV)/ready
TORCH := $(shell sed -n 's/^ *"\(torch==[^"]*\)".*/\1/p' pyproject.toml)
RESULTS_OPTION := $(if $(RESULTS),--results $(RESULTS))
RESTART_OPTION := $(if $(RESTART),--restart)
PARAMS_FILE = params/$(if $(filter-out full,$(PROFILE)),$(PROFILE)/)$(EXPERIMENT).yaml

.DEFAULT_GOAL := help
.PHONY: help report numbers lab test check mutants format train experiments status verify bench lock clean

help: ## list what can be made
	@sed -n 's/^\([a-z]*\):[^#]*## \(.*\)/  make \1|\2/p' $(MAKEFILE_LIST) | awk -F'|' '{printf "%-19s %s\n", $$1, $$2}'
	@echo
	@echo "  RESTART=1           begins runs again that cannot be continued here, and keeps what is stored"
	@echo "  PROFILE=quick       small runs of everything, trained from scratch"
	@echo "  RESULTS=folder      where results are kept instead of results/"
	@echo "  TENSORBOARD=1       let TensorBoard follow what make train does"
	@echo "  SCHEDULER=address   a Dask scheduler to train on (docs/cluster.md)"
	@echo "  TORCH_INDEX=address the package index to install torch from, such as one of CPU builds"

# torch is not in the lock: its builds for CPUs and GPUs differ in their hashes and dependencies.
$(READY): environment.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "Python 3.11 or newer is needed; choose one with make PYTHON=..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(RUN) pip install --quiet --require-hashes --requirement environment.lock
	$(RUN) pip install --quiet $(TORCH) $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX))
	$(RUN) pip install --quiet --no-deps --no-build-isolation --editable .
	@$(RUN) atari_dqn.native
	@touch $@

report: $(READY) ## build results/report/index.html and report.pdf from the stored runs
	$(RUN) atari_dqn report --profile $(PROFILE) $(RESULTS_OPTION)

numbers: $(READY) ## renew the numbers of figures, tables and sections in the notebooks' text
	$(RUN) atari_dqn.report.crossrefs

# JupyterLab refuses root, which is who one is in many containers.
lab: $(READY) ## explore in JupyterLab
	$(VENV)/bin/jupyter lab notebooks/explore.ipynb $(if $(filter 0,$(shell id -u)),--allow-root) \
	  --FileContentsManager.pre_save_hook=atari_dqn.report.lab.without_outputs

train: $(READY) ## train an experiment: EXPERIMENT=boxing_final, and AGENT=dqn SEED=1 for one run
	$(if $(EXPERIMENT),,$(error say which: make train EXPERIMENT=boxing_final AGENT=dqn SEED=1))
	$(RUN) atari_dqn train $(PARAMS_FILE) $(if $(AGENT),--agent $(AGENT)) \
	  $(if $(SEED),--seed $(SEED)) $(if $(TENSORBOARD),--tensorboard) $(RESULTS_OPTION) \
	  $(RESTART_OPTION)

experiments: $(READY) ## train every run that is missing or interrupted (hours to days)
	$(RUN) atari_dqn experiments run --profile $(PROFILE) $(RESULTS_OPTION) \
	  $(if $(SCHEDULER),--scheduler $(SCHEDULER)) $(RESTART_OPTION)

status: $(READY) ## show every run of every experiment
	$(RUN) atari_dqn experiments status --profile $(PROFILE) $(RESULTS_OPTION)

verify: $(READY) ## play games of every stored run again and compare them with its tables
	$(RUN) atari_dqn verify --profile $(PROFILE) $(RESULTS_OPTION)

# One process more than two cores, since tests wait for processes and browsers; loadfile: what the
# tests of a file share is made once
test: $(READY) ## run the tests
	$(RUN) pytest -n 3 --dist loadfile --no-loadscope-reorder

mutants: $(READY) ## put faults into the code and see tests fail (minutes)
	$(VENV)/bin/python tests/mutants.py

check: $(READY) ## run the linter, the formatter's check, the order of the floors, the types
	$(RUN) ruff check .
	$(RUN) ruff format --check .
	$(VENV)/bin/lint-imports
	$(RUN) mypy

format: $(READY) ## format the code
	$(RUN) ruff check --fix .
	$(RUN) ruff format .

lock: $(READY) ## renew environment.lock from pyproject.toml
	$(VENV)/bin/uv pip compile pyproject.toml --quiet --extra dev --universal \
	  --python-version 3.11 --generate-hashes --no-emit-package torch --no-annotate --no-header \
	  --no-emit-index-url --no-emit-find-links --upgrade --output-file environment.lock

bench: $(READY) ## measure training speed beside the peers' (an hour; an environment of its own)
	test -d .venv-bench || $(PYTHON) -m venv .venv-bench
	.venv-bench/bin/python -m pip install --quiet $(TORCH) \
	  $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX))
	.venv-bench/bin/python -m pip install --quiet --requirement benchmarks/requirements.txt
	$(VENV)/bin/python benchmarks/throughput.py --peers .venv-bench/bin/python

clean: ## remove everything that can be made again; stored runs, checkpoints and the report stay
	rm -rf $(VENV) .venv-bench results/notebooks
	rm -rf $(foreach small,quick smoke,results/$(small)/notebooks results/$(small)/report)
	rm -rf .pytest_cache .ruff_cache .mypy_cache .import_linter_cache .hypothesis
	find src tests -name __pycache__ -prune -exec rm -rf {} +
