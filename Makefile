# SPDX-License-Identifier: Apache-2.0
# Every target makes the virtual environment it needs by itself; nothing outside this folder is touched.
VENV := .venv
PY := $(VENV)/bin/python
PROJECT_FILES := pyproject.toml setup.py setup.cfg

EXTRAS_demo := ros,mesh,demo
EXTRAS_test := ros,mesh,sun,bag,fleet,terrain,demo,benchmark,dose,photometry,test
EXTRAS_dev := ros,mesh,sun,bag,fleet,terrain,demo,benchmark,dose,photometry,test,dev
EXTRAS_benchmark := ros,mesh,demo,benchmark,dose

# A ROS 2 that is sourced in this shell, or the ROS wheels of another environment, must not mix with the wheels in .venv.
unexport PYTHONPATH PYTHONHOME

# Without byte code each process of the tests rewrites the assertions of 250 modules, and each program that a test starts
# compiles the package: a quarter of `make quick`.
unexport PYTHONDONTWRITEBYTECODE
ifdef LD_LIBRARY_PATH
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport LD_LIBRARY_PATH
else
colon := :
empty :=
space := $(empty) $(empty)
split = $(subst $(colon),$(space),$(1))
LD_LIBRARY_PATH := $(subst $(space),$(colon),$(filter-out $(patsubst %,%/%,/opt/ros $(call split,$(AMENT_PREFIX_PATH))),$(call split,$(LD_LIBRARY_PATH))))
endif
endif
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE AMENT_PREFIX_PATH COLCON_PREFIX_PATH CMAKE_PREFIX_PATH

# A name in PATH may be a stub that cannot run, or a Python without venv: each candidate is tried, not looked up.
PYTHON_OK := import sys, venv, ensurepip; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 12))
FIND_PYTHON = for p in $(or $(PYTHON),python3.12 python3.11 python3.10 python3 python); do \
	if "$$p" -c '$(PYTHON_OK)' >/dev/null 2>&1; then echo "$$p"; exit 0; fi; done; \
	echo "No Python that fits: tried $(or $(PYTHON),python3.12 python3.11 python3.10 python3 python)." >&2; \
	echo "Needed is Python 3.10, 3.11 or 3.12 with its venv module (Debian, Ubuntu: apt install python3-venv); name it with make PYTHON=/path/to/python." >&2; \
	exit 1

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test mutants quick benchmark lint format types wheel clean distclean FORCE

help: ## this list
	@echo "make <target>, with PYTHON=<interpreter> to choose the Python that .venv is made with"
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  \1@\2/p' Makefile | awk -F@ '{ printf "%-12s%s\n", $$1, $$2 }'

demo: $(VENV)/.has-demo ## play a moving scene through the node, pictures into demo_output/; DATA=<folder> plays recorded depth images; UV=1 a robot with a UV tube in a room, or in the mesh DATA=<file>
	@$(PY) -m shadow_tracer.apps.demo.demo $(if $(UV),--uv,--node) $(if $(DATA),--data "$(DATA)") $(ARGS)

test: $(VENV)/.has-test ## all tests of the package, on up to four cores; ARGS="-k name" passes options to pytest, ARGS="-n 0" takes one process
	@$(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile -m "not mutant" $(ARGS)

mutants: $(VENV)/.has-test ## tests of the tests: in copies without a safeguard some of them must fail; ARGS as for test
	@$(PY) -m pytest -q -n auto --maxprocesses 4 --dist worksteal -m mutant $(ARGS)

quick: $(VENV)/.has-test ## the tests of the inner loop: of each function one case, none over a second, of each pipeline its default variant; ARGS as for test, ARGS="--few-cases 0 -k name" takes all cases
	@$(PY) -m pytest -q -n auto --maxprocesses 4 --dist loadfile -m "not slow" --default-variants --few-cases 1 --find-slow $(ARGS)

benchmark: $(VENV)/.has-benchmark ## the suite beside Embree, wp.Mesh and others, figures and plots into benchmark_output/; ARGS="--quick" is short
	@$(PY) benchmark/suite.py --out benchmark_output $(ARGS)

HEADERS = $(shell find shadow_tracer -name '*.h')

lint: $(VENV)/.has-dev ## ruff, clang-format and clang-tidy: rules and layout
	@$(PY) -m ruff check .
	@$(PY) -m ruff format --check .
	@$(VENV)/bin/clang-format --dry-run -Werror $(HEADERS)
	@$(PY) .ci/check_headers.py

format: $(VENV)/.has-dev ## ruff and clang-format: mend what can be mended
	@$(PY) -m ruff check --fix .
	@$(PY) -m ruff format .
	@$(VENV)/bin/clang-format -i $(HEADERS)

types: $(VENV)/.has-dev ## mypy
	@$(PY) -m mypy

wheel: $(VENV)/.has-dev ## source archive, and the wheel made from it, into dist/
	@rm -rf build dist
	@$(PY) -m build --outdir dist . >build.log || { cat build.log; exit 1; }
	@rm build.log && ls dist/*

clean: ## remove what was built, not .venv
	rm -rf build install log dist demo_output benchmark_output *.egg-info .pytest_cache .mypy_cache .ruff_cache .tidy_cache
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -print0 | xargs -0 rm -rf

distclean: clean ## remove .venv too
	rm -rf $(VENV)

# An environment whose Python has gone is rebuilt, and so is one made with another Python than the PYTHON=... wished for.
IDENTITY := -c 'import sys; print(sys.base_prefix, sys.version)'
ifneq ($(shell test -x $(PY) && echo there),there)
$(VENV)/.made: FORCE
else ifdef PYTHON
ifneq ($(shell "$(PYTHON)" $(IDENTITY) 2>/dev/null),$(shell $(PY) $(IDENTITY) 2>/dev/null))
$(VENV)/.made: FORCE
endif
endif

$(VENV)/.made:
	@python=$$($(FIND_PYTHON)) && echo "Making $(VENV) with $$("$$python" --version)" && "$$python" -m venv --clear $(VENV)
	@touch $@

# The package itself is installed editable: the sources here are what runs.
$(VENV)/.has-%: $(VENV)/.made $(PROJECT_FILES)
	@echo "Installing what '$*' needs into $(VENV) (the first time this loads about 300 MB)"
	@$(PY) -m pip install -qq --disable-pip-version-check "pip>=22.3"
	@$(PY) -m pip install -qq --disable-pip-version-check --editable ".[$(EXTRAS_$*)]"
	@touch $@
