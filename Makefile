# make setup | paper | test | bench | soak | prove | mutants
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
DRAW ?= 1
N ?= 300
SECONDS ?= 7000
STUDIES := $(wildcard data/studies/paper/*.toml)

.PHONY: setup paper test bench soak prove mutants lock clean
.DEFAULT_GOAL := test

setup: $(READY)

# Built anew only when the lock or the project's description changes.
$(READY): requirements.lock pyproject.toml
	test -x $(BIN)/python || $$(command -v $(PYTHON) || command -v python3) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

paper: $(READY)
	$(BIN)/gaitsweep run $(STUDIES)
	$(BIN)/gaitsweep report data/archive/*.nc -o reports

test: $(READY)
	$(BIN)/python -m pytest -n 2 --dist loadfile

bench: $(READY)
	$(BIN)/gaitsweep bench -o reports

# All tests, the long ones too for two hours, and the branches of the code that they reach. Begun again, it goes on.
soak: $(READY)
	SOAK_SECONDS=$(SECONDS) $(BIN)/python -m coverage run -m pytest -m "soak or not soak" --timeout=3600
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report --skip-covered

prove: $(READY)
	$(BIN)/python -m pipeline.cli.prove data/reference/proofs

# Mutants of the core drawn by lot, two at a time; the same command resumes, AGAIN=again retries survivors.
mutants: $(READY)
	$(BIN)/python tests/mutants/draw.py $(DRAW) $(N) $(AGAIN)

# Write the lock anew from the ranges in pyproject.toml; needs pip-tools.
lock:
	pip-compile --generate-hashes --all-extras --allow-unsafe --strip-extras --no-header \
	  --no-annotate --no-emit-index-url --no-emit-trusted-host --no-emit-find-links --no-emit-options \
	  --output-file requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) mutants data/archive
	find reports -mindepth 1 ! -name README.md -delete
