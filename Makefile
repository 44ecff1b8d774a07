# Each target works as the very first command typed: it creates .venv with pip and installs exactly what it needs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OLDEST := .venv.oldest
# Python compiles a module when it is first imported, and keeps what it compiled in .venv, even where the environment says
# not to. pip would compile all modules of all libraries, which takes a third of the installation.
export PYTHONDONTWRITEBYTECODE :=
export PYTHONPYCACHEPREFIX :=
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal

.PHONY: demo demo-train serve test test-processors test-oldest fuzz mutants lint bench docs clean

demo: $(VENV)/.installed-demo
	$(BIN)/zoedepth demo --out demo

demo-train: $(VENV)/.installed-train,synthetic
	$(BIN)/zoedepth demo-train --out demo-train

# The page in the browser, and the API. Open the address that it prints.
serve: $(VENV)/.installed-serve,exr,mesh,heic
	$(BIN)/zoedepth serve

test: $(VENV)/.installed-dev
	$(PYTEST)

# The numeric tests as other processors compute, and as a user without root's rights. SWITCHES="avx2 1-thread" runs some.
test-processors: $(VENV)/.installed-dev
	scripts/processors.sh $(BIN)/python $(SWITCHES)

# The tests with the lowest versions that pyproject.toml promises. uv, because pip cannot choose the lowest.
test-oldest: $(OLDEST)/.installed-dev
	OMP_NUM_THREADS=1 $(OLDEST)/bin/python -m pytest -n auto --maxprocesses 4 --dist worksteal

# The fuzz tests with other examples every time; what failed is kept in .hypothesis and tried first. Each round is short.
ROUNDS ?= 10
fuzz: $(VENV)/.installed-dev
	for round in $$(seq $(ROUNDS)); do $(PYTEST) -m hypothesis --hypothesis-profile=fuzz || exit 1; done

# Faults put into the code one at a time, to see whether a test notices (hours; MODULE=zoedepth.pareto: a minute).
MODULE ?= zoedepth
mutants: $(VENV)/.installed-dev,mutants
	OMP_NUM_THREADS=1 $(BIN)/mutmut run '$(MODULE).*'
	$(BIN)/mutmut results | grep -v 'not checked' || true

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/codespell

bench: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks

docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build --strict

clean:
	rm -rf $(VENV) $(OLDEST) demo demo-train site mutants

# The stamp is written last, so an interrupted installation is taken up again.
$(VENV)/.installed-%: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --no-compile --editable '.[$*]'
	@touch $@

$(OLDEST)/.installed-dev: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python $(OLDEST)
	$(BIN)/uv pip install --quiet --system-certs --python $(OLDEST)/bin/python --resolution lowest-direct --editable '.[dev]'
	@touch $@

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)
