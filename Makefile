# Everything a fresh clone needs is `make demo` and `make test`; only Python 3.11 to 3.14 must be there.
#   make demo    simulate a kart session, smooth it, say where the report is
#   make test    run every test
#   make test-fast  those to run every few minutes: contracts, readers, mathematics, layers; under a minute
#   make lint    style, types and spelling
#   make bench   the measurements behind the README's tables (minutes)
#   make picture the README's picture, from the demo
#   make notebooks  run the notebooks and put their rendered copies into docs/notebooks
#   make docs    the documents as a site with search, in build/site; `.venv/bin/mkdocs serve` shows it
#   make firmware  the logger's image, with its budget of flash, RAM and stack
#   make flash     writes it onto a board: ST-Link or serial adapter (PORT=/dev/ttyUSB0), by the tool that is there
#   make release   the image as .bin and .hex with checksums, in build/release
#   make emulate   that image, run: a simulated kart session in, lap times out
#   make mutants   mistakes put into the firmware on purpose: the emulated board notices each
#   make install-check  build the wheel, install it into a clean environment, run the demo from it
#   make bounds    the same on every Python found, with the oldest and the newest dependencies allowed
#   make audit     ask whether a weakness of a dependency is known
#   make dependencies  bring the tables of docs/dependencies.md up to date
#   make container an image with smooth in it, of CONTAINER=docker or podman

VENV := .venv
BIN := $(VENV)/bin
DEMO ?= demo
# one process per core; the linear algebra inside each needs no threads of its own
JOBS ?= 2
EMULATED_SECONDS ?= 180
CONTAINER ?= docker
# what make test-fast runs, without tests that are marked slow; CONTRIBUTING.md has the rule
FAST_TESTS := tests/contracts tests/session $(filter-out tests/test_readme.py tests/test_wheel.py,$(wildcard tests/test_*.py)) \
	tests/estimate/factors $(wildcard tests/estimate/model)
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# tests start the command over and over: what a process has compiled the next ones need not
unexport PYTHONDONTWRITEBYTECODE
# of a hundred packages few modules are imported, which are compiled then: half a minute less
WHAT_TESTS_NEED := --quiet --disable-pip-version-check --no-compile

.PHONY: demo test test-fast lint bench picture notebooks docs firmware flash release emulate mutants install-check bounds audit dependencies container clean

demo: $(VENV)/for-running
	@$(BIN)/smooth demo $(DEMO)

test: $(VENV)/for-testing
	@sh .ci/packages.sh
	$(BIN)/python -m pytest -n $(JOBS)

test-fast: $(VENV)/for-testing
	$(BIN)/python -m pytest -n $(JOBS) -m "not slow" $(FAST_TESTS)

lint: $(VENV)/for-linting
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/python .ci/phrases.py

bench: $(VENV)/for-benchmarks
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/thinning.py --jobs $(JOBS)
	$(BIN)/python benchmarks/accuracy.py --preset white --preset kart --preset kart_harsh --jobs $(JOBS)
	$(BIN)/python benchmarks/lap_times.py --jobs $(JOBS)
	$(BIN)/python benchmarks/batch.py

picture: demo
	mkdir -p docs/figures
	$(BIN)/smooth $(DEMO) --no-baseline --out build/picture
	cp build/picture/figures/overview.png docs/figures/demo.png

notebooks: $(VENV)/for-testing
	rm -rf docs/notebooks
	env -u SMOOTH_DATA $(BIN)/jupyter nbconvert --log-level=ERROR --to markdown --execute --output-dir docs/notebooks notebooks/*.ipynb

docs: $(VENV)/for-docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

firmware: $(BIN)/python
	@$(BIN)/python firmware/build.py

flash: firmware
	@$(BIN)/python firmware/flash.py $(if $(PORT),--port $(PORT))

release: firmware
	@$(BIN)/python firmware/flash.py --release build/release

emulate: $(VENV)/for-testing
	@$(BIN)/python firmware/emulator/emulate.py build/emulated --duration $(EMULATED_SECONDS)

mutants: $(VENV)/for-testing
	@$(BIN)/python firmware/emulator/mutants.py

install-check: $(BIN)/python
	@$(BIN)/python .ci/install_check.py

bounds: $(VENV)/for-releasing
	@$(BIN)/python .ci/install_check.py --every-python --bounds both

audit: $(VENV)/for-releasing
	@mkdir -p build
	@$(BIN)/python -m uv pip compile --quiet --extra dask pyproject.toml -o build/audited.txt
	$(BIN)/python -m pip_audit --strict --disable-pip --no-deps -r build/audited.txt

dependencies: $(VENV)/for-releasing
	@$(BIN)/python .ci/dependencies.py

container:
	$(CONTAINER) build -t kart-smoother -f Containerfile .

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(BIN)/python:
	@sh .ci/venv.sh $(VENV)

$(VENV)/for-running: $(BIN)/python pyproject.toml
	@echo "installing kart-smoother into $(VENV) (some minutes the first time)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/for-testing: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install $(WHAT_TESTS_NEED) -e ".[test]"
	@touch $@

$(VENV)/for-linting: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install $(WHAT_TESTS_NEED) -e ".[test,dev]"
	@touch $@ $(VENV)/for-testing

$(VENV)/for-docs: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install $(WHAT_TESTS_NEED) -e ".[docs]"
	@touch $@

$(VENV)/for-benchmarks: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[test,bench]"
	@touch $@

$(VENV)/for-releasing: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[test,dev,bench,dask,release]"
	@touch $@
