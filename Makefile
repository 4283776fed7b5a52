# Everything a fresh Debian machine with python3, make and git needs: `make demo`, `make test`.

PYTHON ?= python3
WERROR ?= OFF
PYTEST_ARGS ?= -n auto --dist worksteal
SEEDS ?= 20
RUNS ?= 200
WORKERS ?= 2
export PYTHON

VENV := .venv
BIN := $(abspath $(VENV))/bin
# Modules are compiled as they are imported: most of what is installed never is. And kept, whatever containers like to forbid:
# without them every command takes three seconds more.
unexport PYTHONDONTWRITEBYTECODE
PIP_INSTALL := $(BIN)/python -m pip --disable-pip-version-check --quiet install --no-compile

HEADERS := $(wildcard include/truewrench/*.hpp include/truewrench/*/*.hpp)
# What the compiled modules are made of.
CORE_SOURCES := pyproject.toml CMakeLists.txt $(wildcard cmake/*) \
  $(HEADERS) $(wildcard bindings/*)
CXX_FILES = $(shell git ls-files -co --exclude-standard '*.hpp' '*.cpp')

.PHONY: help demo test test-cpp test-python test-benchmarks bench campaigns docs lint lint-python lint-cpp tidy format stubs lock figures clean

help:
	@echo "make demo     the case of the paper, from motion to pictures, in out/demo"
	@echo "make test     all tests, C++ and Python"
	@echo "make test-benchmarks  every documented command of a benchmark, at its smallest size, and every arm"
	@echo "make bench    time per sample beside other filters, accuracy over a few seeds"
	@echo "make campaigns  random rigs and whole arms in search of failures, RUNS=$(RUNS) of each; goes on where it stood"
	@echo "make docs     the documentation as a site, in out/docs"
	@echo "make lint     format, types and static checks; make format repairs what can be repaired"
	@echo "make tidy     clang-tidy over every C++ test, some minutes"
	@echo "make stubs    type stubs of the compiled modules, after a change of bindings/"
	@echo "make figures  the figures of docs/"
	@echo "make lock     requirements/*.txt from pyproject.toml"
	@echo "make clean    remove everything that make made"

# Set-up, each step once.

$(VENV)/.created:
	scripts/system_packages.sh
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.run: requirements/run.txt | $(VENV)/.created
	$(PIP_INSTALL) --require-hashes -r $<
	touch $@

$(VENV)/.dev: requirements/dev.txt | $(VENV)/.run
	scripts/system_packages.sh test
	$(PIP_INSTALL) --require-hashes -r $<
	touch $@

INSTALL_CORE = $(PIP_INSTALL) --no-build-isolation --no-deps \
  --config-settings cmake.define.TRUEWRENCH_WERROR=$(WERROR) --config-settings cmake.define.TRUEWRENCH_CORES=$(1) -e .

# For this processor alone, in half of the time; and for all.
$(VENV)/.host: $(CORE_SOURCES) $(VENV)/.run
	$(call INSTALL_CORE,host)
	touch $@

$(VENV)/.built: $(CORE_SOURCES) $(VENV)/.run
	$(call INSTALL_CORE,all)
	touch $@ $(VENV)/.host

# What people run.

demo: $(VENV)/.host
	$(BIN)/truewrench demo -o out/demo

test: test-cpp test-python

build/cpp/build.ninja: CMakeLists.txt | $(VENV)/.dev
	$(BIN)/cmake -S . -B build/cpp -G Ninja -DCMAKE_MAKE_PROGRAM=$(BIN)/ninja \
	  -DPython_EXECUTABLE=$(BIN)/python -DCMAKE_EXPORT_COMPILE_COMMANDS=ON -DCMAKE_CXX_FLAGS=-O2 \
	  -DTRUEWRENCH_TESTS=ON -DTRUEWRENCH_WERROR=$(WERROR)

test-cpp: build/cpp/build.ninja
	$(BIN)/cmake --build build/cpp
	$(BIN)/ctest --test-dir build/cpp --output-on-failure --parallel 2

# One process a core: threads of linear algebra beside them take a third longer.
test-python test-benchmarks: export OPENBLAS_NUM_THREADS = 1

test-python: $(VENV)/.built $(VENV)/.dev
	$(BIN)/python -m pytest $(PYTEST_ARGS)

test-benchmarks: $(VENV)/.built $(VENV)/.dev
	$(BIN)/python -m pytest -m campaign $(PYTEST_ARGS)

bench: $(VENV)/.built $(VENV)/.dev
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/efficiency.py --seeds $(SEEDS)

campaigns: $(VENV)/.built $(VENV)/.dev
	for name in healthy grid coverage confident rates chain; do \
	  $(BIN)/python benchmarks/$$name.py --runs $(RUNS) --workers $(WORKERS) --out out/campaigns/$$name || exit 1; done
	$(BIN)/python benchmarks/setup_sweep.py --runs $(RUNS) --healthy $(RUNS) --end-to-end $(RUNS) \
	  --workers $(WORKERS) --out out/campaigns/setup_sweep

docs: $(VENV)/.built $(VENV)/.dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

lint: lint-python lint-cpp

lint-python: $(VENV)/.built $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

lint-cpp: $(VENV)/.dev
	mkdir -p build
	$(BIN)/clang-format --dry-run --Werror $(CXX_FILES)
	printf '#include "%s"\n' $(patsubst include/%,%,$(HEADERS)) > build/headers.cpp
	$(BIN)/clang-tidy --quiet build/headers.cpp -- -std=c++20 -Iinclude \
	  -isystem $$($(BIN)/python -m cmeel cmake)/include/eigen3

tidy: build/cpp/build.ninja
	printf '%s\n' $(wildcard tests/cpp/*.cpp) | xargs -P 2 -n 1 $(BIN)/clang-tidy -p build/cpp --quiet

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/clang-format -i $(CXX_FILES)

stubs: $(VENV)/.built
	$(BIN)/python scripts/make_stubs.py

figures: demo
	$(BIN)/python docs/figures/frames.py
	$(BIN)/python docs/figures/report.py
	cp out/demo/fig3_gain_error.png docs/figures/demo.png

lock: $(VENV)/.created
	$(PIP_INSTALL) uv
	PATH=$(BIN):$$PATH requirements/lock.sh

clean:
	rm -rf $(VENV) build out
