# make render   render the demo scene into out/demo.png (statistics beside it, in out/demo.json)
# make test     run the whole test suite
# make package  build the Blender extension's zips into dist/
# make clean    remove what was rendered, built and cached here, but for the environment
#
# PYTHON=...    the Python to use (3.13 or 3.11); the newest usable one is found otherwise
# VENV=...      the folder of the environment (default .venv)
# TEST_JOBS=... processes that run tests side by side (default: as many as there are cores, 4 at most)
# TESTS=...     what to run instead of every test, as pytest takes it
PYTHON ?=
VENV ?= .venv
TESTS ?=
TEST_JOBS ?= auto

venv_python := $(VENV)/bin/python
export PYTHON VENV

.PHONY: help environment render test package clean

help:
	@sed -n 's/^# //p' Makefile

environment:
	@sh scripts/environment.sh

render: environment
	@$(MAKE) --no-print-directory out/demo.blend
	$(venv_python) scripts/render.py out/demo.blend -o out/demo.png --json out/demo.json
	@echo "rendered out/demo.png; statistics are in out/demo.json" >&2

# made by the Blender of the environment that is used: another one makes it again
out/demo.blend: $(wildcard scripts/make_demo*.py) out/demo.environment
	$(venv_python) scripts/make_demo.py $@

# changes only when the environment is another one
out/demo.environment: environment
	@mkdir -p out
	@cmp -s $(VENV)/raybatch-environment $@ || cp $(VENV)/raybatch-environment $@

test: environment
	$(venv_python) -m pytest -n $(TEST_JOBS) --maxprocesses 4 --dist loadfile $(TESTS)

package: environment
	$(venv_python) scripts/package.py

clean:
	rm -rf out dist build .cache
