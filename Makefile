# make demo     install into .venv and run the main job on a virtual actuator
# make workbench  the same on a page in the browser, with your records
# make test     install, with the tests' dependencies and packages/rivals, run the tests of a push, print the slowest
# make nightly  the same tests and those too slow for a push, with all repeats and examples
# make check    lint, types, import contract, and the C core under strict warnings
# make docs     build the site into build/docs, with all examples run; a warning is an error
# make wasm     compile the core to WebAssembly (needs Debian's clang and lld); commit the result
# make pictures take the pictures of the workbench's tutorial anew
# make built    compile both packages, for all environments
# make wheel    build sdist and wheel, audit both, and run the demo from the wheel in new environments
# make bench    measure speed and accuracy, write benchmarks/*.json and the README's table

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
PYTEST := $(BIN)/python -m pytest -n auto --dist worksteal
RIVALS_SOURCES := $(addprefix packages/rivals/,pyproject.toml CMakeLists.txt README.md core/* bindings/* src/dehyst_rivals/*)
SOURCES := pyproject.toml CMakeLists.txt README.md $(wildcard core/CMakeLists.txt core/*/*.[ch] core/*/*/*.[ch] bindings/* src/dehyst/* src/dehyst/*/* src/dehyst/*/*/*)

.PHONY: built demo workbench test nightly check docs wasm pictures wheel bench clean

demo: $(VENV)/.demo
	$(BIN)/dehyst demo --force

workbench: $(VENV)/.workbench
	$(BIN)/dehyst workbench

test: $(VENV)/.test
	$(PYTEST) --junitxml=build/test-results/push.xml

nightly: $(VENV)/.test
	HYPOTHESIS_PROFILE=nightly $(PYTEST) -m "not fuzz" --junitxml=build/test-results/nightly.xml

check: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	sh core/tests/strict_build.sh

docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going --nitpicky --quiet -d build/doctrees docs build/docs

wasm:
	$(PYTHON) bindings/wasm/build.py

pictures: $(VENV)/.test
	PYTHONPATH=tests/support $(BIN)/python tests/support/workbench_tour.py docs/tutorials/workbench

wheel: $(VENV)/.release
	.ci/wheel $(BIN)/python

bench: $(VENV)/.test
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/accuracy.py
	$(BIN)/python benchmarks/strangers.py --jobs 2
	$(BIN)/python benchmarks/creep.py
	$(BIN)/python benchmarks/coupled_axes.py
	$(BIN)/python benchmarks/paper.py
	$(BIN)/python benchmarks/promise.py
	$(BIN)/python benchmarks/temperature.py
	$(BIN)/python benchmarks/ageing.py
	$(BIN)/python benchmarks/size.py
	$(BIN)/python benchmarks/latency.py
	$(BIN)/python benchmarks/calibration.py
	$(BIN)/python benchmarks/faults.py
	$(BIN)/python benchmarks/learning.py
	$(BIN)/python benchmarks/figures.py
	$(BIN)/python benchmarks/pages.py
	$(BIN)/python benchmarks/architecture.py

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

# Compiled once for all environments; what is imported is compiled to bytecode then: hundreds of processes need it again.
export PIP_COMPILE = 0
unexport PYTHONDONTWRITEBYTECODE
TAG := $(shell $(PYTHON) -c 'import sys; print(sys.implementation.cache_tag)')
WHEEL := build/wheel-$(TAG)
RIVALS := build/rivals-$(TAG)
install = $(BIN)/python -m pip install --quiet --force-reinstall --no-deps $(WHEEL)/*.whl && \
	$(BIN)/python -m pip install --quiet 'dehyst$(1)'
install_rivals = $(BIN)/python -m pip install --quiet --force-reinstall --no-deps $(RIVALS)/*.whl

$(WHEEL)/.built: $(SOURCES) | $(BIN)/python
	rm -rf $(WHEEL)
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir $(WHEEL) .
	touch $@

$(RIVALS)/.built: $(wildcard $(RIVALS_SOURCES)) | $(BIN)/python
	rm -rf $(RIVALS)
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir $(RIVALS) ./packages/rivals
	touch $@

built: $(WHEEL)/.built $(RIVALS)/.built

$(VENV)/.demo: $(BIN)/python $(WHEEL)/.built
	$(call install,)
	touch $@

$(VENV)/.workbench: $(BIN)/python $(WHEEL)/.built
	$(call install,[workbench])
	touch $@ $(VENV)/.demo

$(VENV)/.test: $(BIN)/python $(WHEEL)/.built $(RIVALS)/.built
	$(call install,[test])
	$(install_rivals)
	touch $@ $(VENV)/.demo

$(VENV)/.docs: $(BIN)/python $(WHEEL)/.built
	$(call install,[docs])
	touch $@ $(VENV)/.demo

$(VENV)/.release: $(BIN)/python .ci/release.txt
	$(BIN)/python -m pip install --quiet -r .ci/release.txt
	touch $@

clean:
	rm -rf build dist dehyst-demo docs/gallery docs/reference/api $(VENV)
