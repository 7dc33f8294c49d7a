# make demo   install into .venv and run the main job on a virtual actuator
# make test   install with the tests' dependencies and run every test
# make check  lint, types, import contracts, and the C core under strict warnings
# make wheel  build the wheel, audit it, and run the demo from it in a new environment
# make bench  measure speed and accuracy, write benchmarks/*.json and the README's table

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
SOURCES := pyproject.toml CMakeLists.txt README.md $(wildcard core/* src/*.cpp src/*.h src/dehyst/* src/dehyst/*/*)

.PHONY: demo test check wheel bench clean

demo: $(VENV)/.report
	$(BIN)/dehyst demo

test: $(VENV)/.test
	$(BIN)/python -m pytest -n auto --dist loadfile

check: $(VENV)/.check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	sh core/check.sh

wheel: $(VENV)/.release
	.ci/wheel $(BIN)/python

bench: $(VENV)/.test
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/accuracy.py
	$(BIN)/python benchmarks/paper.py
	$(BIN)/python benchmarks/coverage.py
	$(BIN)/python benchmarks/solver.py
	$(BIN)/python benchmarks/size.py
	$(BIN)/python benchmarks/latency.py
	$(BIN)/python benchmarks/threads.py
	$(BIN)/python benchmarks/saturation.py
	$(BIN)/python benchmarks/calibration.py
	$(BIN)/python benchmarks/faults.py
	$(BIN)/python benchmarks/loop.py
	$(BIN)/python benchmarks/figure.py
	$(BIN)/python benchmarks/readme.py
	$(BIN)/python benchmarks/control_page.py
	$(BIN)/python benchmarks/safety_page.py
	$(BIN)/python benchmarks/architecture.py

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.report: $(BIN)/python $(SOURCES)
	$(BIN)/python -m pip install --quiet '.[report]'
	touch $@

$(VENV)/.test: $(BIN)/python $(SOURCES)
	$(BIN)/python -m pip install --quiet '.[test]'
	touch $@ $(VENV)/.report

$(VENV)/.check: $(BIN)/python $(SOURCES)
	$(BIN)/python -m pip install --quiet '.[test,check]'
	touch $@ $(VENV)/.test $(VENV)/.report

$(VENV)/.release: $(BIN)/python $(SOURCES)
	$(BIN)/python -m pip install --quiet '.[release]'
	touch $@

clean:
	rm -rf build dist dehyst-demo $(VENV)
