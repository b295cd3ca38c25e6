# make setup | paper | test | check | lint | docs | wheel | bench | soak | prove | reference | mutants | tiers | lock
PYTHON ?= $(shell command -v python3.11 || command -v python3)
# Each of hundreds of processes would compile all modules again.
unexport PYTHONDONTWRITEBYTECODE
BIN := .venv/bin
READY := .venv/.ready
COMPLETE := .venv/.complete
WRITING := .venv/.writing
# It takes packages from where pip would; of several indexes any may have what is locked, which its hash tells.
UV = "$(PYTHON)" .ci/with_settings_of_pip.py $(BIN)/uv
INSTALL = $(UV) pip install --quiet --python $(BIN)/python --require-hashes --index-strategy unsafe-best-match \
  --constraint requirements.lock --requirement pyproject.toml
TIER = not thorough and not soak
DRAW ?= 1
N ?= 300
SECONDS ?= 7000

.PHONY: setup paper test check lint docs wheel bench soak prove reference mutants tiers lock clean
.DEFAULT_GOAL := test

setup: $(READY)

# Built anew only when the lock or the project's description changes.
$(READY): requirements.lock pyproject.toml
	@"$(PYTHON)" -c 'import pip, sys, venv; assert sys.version_info >= (3, 11)' 2>/dev/null || \
	  { echo 'gaitsweep needs Python 3.11 or later, with pip and venv: make PYTHON=/path/to/python3' >&2; exit 1; }
	test -x $(BIN)/python || "$(PYTHON)" -m venv --without-pip .venv
	sed -n '/^uv==/,/[^\]$$/p' requirements.lock >.venv/uv.txt
	"$(PYTHON)" -m pip --python $(BIN)/python install --quiet --disable-pip-version-check --require-hashes -r .venv/uv.txt
	$(INSTALL) --group setup --extra cluster --extra proof
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --editable .
	touch $@

# With all that tests and measurements use.
$(COMPLETE): $(READY)
	$(INSTALL) --all-extras
	touch $@

# With what the site of the documentation takes.
$(WRITING): $(READY)
	$(INSTALL) --extra docs
	touch $@

paper: $(READY)
	$(BIN)/gaitsweep run paper
	$(BIN)/gaitsweep report data/archive/*.nc -o reports

test: $(COMPLETE)
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "$(TIER)"

# All tests but the soaks.
check: TIER = not soak
check: lint test

lint: $(COMPLETE)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/air.py

# The site, always anew, so that it shows what the code does now; a warning is an error. Pictures of pages are taken
# where what they show has changed.
docs: $(WRITING) $(COMPLETE)
	$(BIN)/python docs/tables.py
	$(BIN)/python docs/pictures.py
	rm -rf build/docs build/doctrees
	$(BIN)/python -m sphinx -q -j 2 -W --keep-going -c docs -d build/doctrees . build/docs
	@echo build/docs/index.html

# What setuptools built before would go into the wheel too.
wheel: $(READY)
	rm -rf build/lib build/bdist.* dist
	$(BIN)/uv build --quiet --wheel --no-build-isolation --python $(BIN)/python .

bench: $(COMPLETE)
	PYTHONPATH=tests $(BIN)/python -m benchmarks -o reports

# All tests, the long ones too for two hours, and the branches of the code that they reach. Begun again, it goes on.
soak: $(COMPLETE)
	SOAK_SECONDS=$(SECONDS) $(BIN)/python -m coverage run -m pytest -m "soak or not soak" --timeout=3600
	$(BIN)/python -m coverage combine --quiet
	$(BIN)/python -m coverage report --skip-covered

prove: $(COMPLETE)
	PYTHONPATH=tests $(BIN)/python -m soak.certificates data/reference/proofs

reference: $(COMPLETE)
	PYTHONPATH=tests $(BIN)/python -m soak.reference data/reference

# Mutants of the core drawn by lot, two at a time; the same command resumes. AGAIN=100 tries again, by 100 s of
# tests of each tier, those that `make test` did not notice.
mutants: $(COMPLETE)
	$(BIN)/python tests/mutants/draw.py $(DRAW) $(N) $(AGAIN)

# Choose the tests of `make test`: those that docs name, then those that reach most, in so many seconds of processor time.
BUDGET ?= 350
tiers: $(COMPLETE)
	$(BIN)/python tests/mutants/tiers.py $(BUDGET)

# Write the lock anew from the ranges in pyproject.toml: one version of each package for every Python that it allows,
# with the files of the main index alone; others often have some of them only.
lock:
	UV_INDEX= UV_FIND_LINKS= $(UV) pip compile --quiet --universal --python-version 3.11 --generate-hashes --all-extras --group setup \
	  --fork-strategy fewest --no-header --no-annotate --output-file requirements.lock pyproject.toml

clean:
	rm -rf .venv build dist mutants data/archive
	find reports -mindepth 1 ! -name README.md -delete
