# make render   render the demo scene into out/demo.png (statistics beside it, in out/demo.json)
# make test     check the sources, then run the whole test suite
# make check    check the sources and run the fast tests: some minutes
# make format   format and mend the sources
# make test-all run everything there is on the CPU, for hours, and note it in docs/testing.md; run again, it goes on
# make test-gpu run what needs no Blender on a CUDA device; PART=1/3, 2/3 and 3/3 run a third each
# make package  build the Blender extension's zips into dist/
# make wheel    build the library, RayBatch without Blender, into dist/
# make repository  put the zips into dist/repository, with the list from which Blender installs and updates them
# make docs     build the site of the documents into build/docs/site, and check its links
# make clean    remove what was rendered, built and cached here, but for the environment
#
# PYTHON=...    the Python to use (3.13 or 3.11); the newest usable one is found otherwise
# VENV=...      the folder of the environment (default .venv)
# TEST_JOBS=... processes that run tests side by side (default: one more than there are cores, 4 at most; some wait)
# TESTS=...     what to run instead of every test, as pytest takes it
# PART=I/N      of make test-gpu: which share
# BLENDER=...   of make repository: Blender's program (default blender)
PYTHON ?=
VENV ?= .venv
TESTS ?=
TEST_JOBS ?= $(shell expr $$(getconf _NPROCESSORS_ONLN 2>/dev/null || echo 2) + 1)
PART ?= 1/1
BLENDER ?=
COMPILE_AHEAD ?= wait

venv_python := $(VENV)/bin/python
export PYTHON VENV
# many processes run the same modules: each would compile their sources anew
unexport PYTHONDONTWRITEBYTECODE

sources := raybatch_addon scripts tests
native_headers = $(shell find raybatch_addon/core/native -name '*.h' 2>/dev/null)
# files, the longest first, go to processes as these get ready
pytest := $(venv_python) -m pytest -n $(TEST_JOBS) --maxprocesses 4 --dist loadfile --no-loadscope-reorder

# what the environment compiles ahead serves the tests
check test test-all: export RAYBATCH_KERNEL_CACHE ?= $(CURDIR)/.cache/kernels
check test test-all: export COMPILE_AHEAD = all
# how kernels of the environment are optimised there: as tests/conftest.py has it for others
check test: OPTIMISATION = 1
# these need no kernels of the environment
lint format package wheel repository docs: export COMPILE_AHEAD = later

.PHONY: help environment render lint format check test test-all test-gpu package wheel repository docs clean

help:
	@sed -n 's/^# //p' Makefile

environment:
	@RAYBATCH_OPTIMISATION=$${RAYBATCH_OPTIMISATION:-$(OPTIMISATION)} \
		sh scripts/environment/environment.sh $(COMPILE_AHEAD)

# compiles what the demo needs first, and then, in the background, what any scene can begin with
render: export COMPILE_AHEAD = later
render: environment
	@$(MAKE) --no-print-directory out/demo.blend
	$(venv_python) scripts/render.py out/demo.blend -o out/demo.png --json out/demo.json
	@echo "rendered out/demo.png; statistics are in out/demo.json" >&2
	@sh scripts/environment/environment.sh start

# made by the Blender of the environment that is used: another one makes it again
out/demo.blend: $(wildcard scripts/make_demo*.py) out/demo.environment
	$(venv_python) scripts/make_demo.py $@

# changes only when the environment is another one
out/demo.environment: environment
	@mkdir -p out
	@cmp -s $(VENV)/raybatch-environment $@ || cp $(VENV)/raybatch-environment $@

lint: environment
	$(venv_python) -m ruff check $(sources)
	$(venv_python) -m ruff format --check $(sources)
	$(venv_python) -m mypy
	$(if $(native_headers),$(VENV)/bin/clang-format --dry-run --Werror $(native_headers))

format: environment
	$(venv_python) -m ruff check --fix $(sources)
	$(venv_python) -m ruff format $(sources)
	$(if $(native_headers),$(VENV)/bin/clang-format -i $(native_headers))

check: environment lint
	$(pytest) --fast

test: environment lint
	$(pytest) $(TESTS)

test-all: environment
	$(venv_python) scripts/testing/everything.py

test-gpu:
	$(if $(wildcard $(venv_python)),$(venv_python),python3) scripts/testing/gpu.py --part $(PART) \
		--out out/testing/gpu-$(subst /,-of-,$(PART)).json

package: environment
	$(venv_python) scripts/package.py

wheel: environment
	$(venv_python) scripts/wheel.py

repository: environment
	$(venv_python) scripts/extension/repository.py --build --blender "$(BLENDER)"

docs: environment
	$(venv_python) scripts/docs_site/build.py

clean:
	rm -rf out dist build .cache
	rm -f $(VENV)/raybatch-kernels-*
