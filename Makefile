# Two commands do everything on a machine that has Python >= 3.11 and make:
#   make demo    the main job on the built-in virtual rig, ends with a report
#   make test    lint, types, layers and the whole test suite
# make test-thorough runs the tests with all their cases (hours; the suite of make test runs a part of them).
# make setup installs everything and compiles what the usual commands need, once for each state of their sources.
# make docs builds the documentation site from the installed wheel into out/docs, with warnings as errors.
# make platforms resolves the dependencies from wheels alone for Linux, Windows and macOS.
# make wheel builds the wheel into out/dist and starts the command from it, outside this folder's environment.
# make campaign checks the numbers and logs of a demo campaign, and runs the examples of README and docs on its files.
# make commands carries out every command that the pages show, on the files of make demo.
# After a change of a tutorial's code, make tutorials executes all of them again and keeps their outputs.
# pre-commit calls make format and make layers at a commit, make types at a push (.pre-commit-config.yaml).
# The uv that wrote uv.lock is used: the one on the PATH if it has that version, else pip puts it into .tools.

UV_VERSION := 0.13.9
PYTHON ?= python3
ifeq ($(word 2,$(shell uv --version 2>/dev/null)),$(UV_VERSION))
UV := uv
UV_FILE :=
else
UV := .tools/uv-$(UV_VERSION)/bin/uv
UV_FILE := $(UV)
endif

# Many images of containers forbid Python to keep compiled files: the hundreds of processes that the tests start would
# compile the project anew, each time.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: demo test test-thorough tutorials docs platforms wheel campaign commands setup format lint layers types duplicates clean installed

demo: installed
	$(UV) run --no-sync rig demo --out out/demo
	@echo "For the rig command in this shell: source .venv/bin/activate"

test: installed lint
	$(UV) run --no-sync pytest -n 2 --dist worksteal

test-thorough: installed
	RIG_TESTS_THOROUGH=1 $(UV) run --no-sync pytest -n 2 --dist worksteal -o faulthandler_timeout=14400

tutorials: installed
	$(UV) run --no-sync python -m tests.tutorials.notebooks

docs: | $(UV_FILE)
	UV_PROJECT_ENVIRONMENT=out/docs-venv $(UV) sync --frozen --no-editable --no-default-groups --group docs --quiet \
		--reinstall-package pendulum-balancer-rig
	out/docs-venv/bin/sphinx-build --fail-on-warning --keep-going --quiet --builder html docs out/docs
	@echo "Open out/docs/index.html"

platforms: | $(UV_FILE)
	mkdir -p out
	for platform in linux windows macos; do for python in 3.11 3.14; do \
		$(UV) pip compile --quiet --python-platform $$platform --python-version $$python --only-binary :all: \
			--all-extras pyproject.toml --output-file out/requirements-$$platform-$$python.txt || exit 1; \
	done; done

wheel: | $(UV_FILE)
	rm -rf out/dist
	$(UV) build --quiet --out-dir out/dist
	$(UV) tool run --isolated --from out/dist/*.whl rig --version

campaign: installed
	.ci/campaign

commands: installed
	test -d out/demo || $(UV) run --no-sync rig demo --out out/demo
	$(UV) run --no-sync python -m tests.run_documented_commands

format: installed
	$(UV) run --no-sync ruff check --fix .
	$(UV) run --no-sync ruff format .

lint: layers
	$(UV) run --no-sync ruff check .
	$(UV) run --no-sync ruff format --check .
	$(MAKE) --jobs 2 types duplicates

layers: installed
	$(UV) run --no-sync lint-imports

types: installed
	$(UV) run --no-sync pyright
	mkdir -p out
	for package in */py.typed; do \
		$(UV) run --no-sync pyright --ignoreexternal --verifytypes $${package%/*} >out/types.txt \
			|| { cat out/types.txt; exit 1; }; \
	done

duplicates: installed
	$(UV) run --no-sync pylint --score=n $(patsubst %/py.typed,%,$(wildcard */py.typed)) benchmarks tests examples

setup: installed
	$(UV) run --no-sync python -m rig_cli.first_start

installed: | $(UV_FILE)
	$(UV) sync --frozen --inexact --quiet --compile-bytecode

.tools/uv-$(UV_VERSION)/bin/uv:
	$(PYTHON) -m venv .tools/uv-$(UV_VERSION)
	.tools/uv-$(UV_VERSION)/bin/python -m pip install --quiet --disable-pip-version-check "uv==$(UV_VERSION)"

clean:
	rm -rf .venv .tools out .pytest_cache .ruff_cache .hypothesis .import_linter_cache
