# Two commands do everything on a machine that has Python >= 3.11 and make:
#   make demo    the main job on the built-in virtual rig, ends with a report
#   make test    lint, types, layers and the whole test suite
# uv is used where it is installed; otherwise it is put into .tools by pip.

UV := $(shell command -v uv 2>/dev/null)
PYTHON ?= python3
ifeq ($(UV),)
UV := .tools/bin/uv
endif

.PHONY: demo test setup lint clean

demo: setup
	$(UV) run --no-sync rig demo --out out/demo

test: setup lint
	$(UV) run --no-sync pytest -n 2

lint: setup
	$(UV) run --no-sync ruff check .
	$(UV) run --no-sync ruff format --check .
	$(UV) run --no-sync pyright
	$(UV) run --no-sync lint-imports

setup: | $(UV)
	$(UV) sync --frozen --quiet --compile-bytecode

.tools/bin/uv:
	$(PYTHON) -m venv .tools
	.tools/bin/python -m pip install --quiet --disable-pip-version-check "uv>=0.5"

clean:
	rm -rf .venv .tools out .pytest_cache .ruff_cache .hypothesis .import_linter_cache
