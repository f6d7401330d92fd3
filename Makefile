# One-line wrappers round the `lightstage` command; `make help` lists them.
.DEFAULT_GOAL := help
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
RUN    := $(BIN)/lightstage $(if $(STORE),--store "$(STORE)")

.PHONY: help setup normals performance skin shape stimuli material test quick test-processors chaos lint format bench docs golden clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 18
	@echo "Variables: SESSION=name or capture folder, TO=folder, STORE=folder (default data/), PYTHON=python3"

# What a user needs and what a developer needs have a lock file each, so that the first picture comes sooner.
$(VENV)/.user: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "lightstage needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) -V). Use make PYTHON=..."; exit 2; }
	@echo "making the environment in $(VENV): a minute or two, once"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.developer: requirements-dev.lock $(VENV)/.user
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-dev.lock
	@touch $@

setup: $(VENV)/.user  ## make the environment (the other targets do it themselves)

normals: $(VENV)/.user  ## the main job: SESSION=name or folder, or the virtual rig's demo
	@$(RUN) normals $(if $(SESSION),"$(SESSION)")

performance: $(VENV)/.user  ## the film of a moving subject: SESSION=name or folder, or the virtual rig's
	@$(RUN) performance $(if $(SESSION),"$(SESSION)")

skin: $(VENV)/.user  ## melanin and haemoglobin: SESSION=name or folder, or the virtual rig's demo
	@$(RUN) skin $(if $(SESSION),"$(SESSION)")

shape: $(VENV)/.user  ## a mesh with texture: SESSION=name or folder, or the virtual rig's demo
	@$(RUN) shape $(if $(SESSION),"$(SESSION)")

stimuli: $(VENV)/.user  ## a matched set of face pictures: SESSION="anna ben carla", names or folders
	@$(RUN) stimuli $(SESSION) $(if $(TO),--to "$(TO)")

material: $(VENV)/.user  ## base colour, gloss and normals for renderers: SESSION=name or folder, TO=folder
	@$(RUN) material $(if $(SESSION),"$(SESSION)") --to "$(or $(TO),$(or $(STORE),data)/material/$(notdir $(or $(SESSION),demo)))"

test: $(VENV)/.developer  ## all tests
	@$(BIN)/python -m pytest $(if $(TESTS),$(TESTS),-n 2)

quick: $(VENV)/.developer  ## the tests that take no minute: without ../shared/data, and without those marked slow
	@$(BIN)/python -m pytest -n 2 -m "not slow and not data" $(TESTS)

test-processors: $(VENV)/.developer  ## all tests, as on processors with fewer instructions (half an hour)
	@$(BIN)/python -m tests.processors $(TESTS)

chaos: $(VENV)/.developer  ## faults on purpose, and their table: PART=flips SEED=17 TRIALS=1 makes one again
	@$(BIN)/python -m tests.chaos $(if $(PART),$(addprefix --part ,$(PART))) $(if $(SEED),--seed $(SEED)) \
	  $(if $(TRIALS),--trials $(TRIALS)) $(if $(PART)$(SEED)$(TRIALS),,--table docs/reliability.md)
	@$(if $(PART),,LIGHTSTAGE_EXAMPLES=40 $(BIN)/python -m pytest -n 0 tests/store/test_state_machine.py)

lint: $(VENV)/.developer  ## format, style, types, import contracts
	@$(BIN)/ruff format --check .
	@$(BIN)/ruff check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports --no-cache | tail -12

format: $(VENV)/.developer  ## format the code
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

bench: $(VENV)/.developer  ## every figure of README and docs, measured anew
	@$(BIN)/python -m benchmarks.kernels
	@$(BIN)/python -m benchmarks.pipeline
	@$(BIN)/python -m benchmarks.accuracy

docs: $(VENV)/.developer  ## the figures and tables in docs/ (needs ../shared/data)
	@$(BIN)/python -m benchmarks.accuracy
	@$(BIN)/python -m benchmarks.near_light
	@$(BIN)/python -m benchmarks.reflectance
	@$(BIN)/python -m benchmarks.skin
	@$(BIN)/python -m benchmarks.shape
	@$(BIN)/python -m benchmarks.stimuli
	@$(BIN)/python -m benchmarks.relighting
	@$(BIN)/python -m benchmarks.alignment
	@$(BIN)/python -m benchmarks.moving
	@$(RUN) sequence count --upto 30 --plot docs/figures/sequence_count.png

golden: $(VENV)/.developer  ## accept new pinned digests (say why in the commit)
	@$(BIN)/python -m pytest tests/dag/test_fingerprint.py --golden

clean:  ## remove the environment and caches, not the store
	rm -rf $(VENV) .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -not -path './data/*' -prune -exec rm -rf {} +
