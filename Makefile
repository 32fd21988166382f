# The commands of the README. Every target sets .venv up first where that is not done yet.
#   make demo     a complete small study on virtual specimens, to the report
#   make test     the test suite
#   make verify   the long verification: expected, got, error
#   make bench    the speed comparisons
#   make elements error of every element against unknowns and seconds: docs/elements.md
#   make gallery  the shipped studies that are quick, run and photographed for the documentation,
#                 and the cookbook with what its cells show
#   make docs     the documentation site: docs/_build/index.html
#   make newest   the test suite with the newest versions of all packages instead of the locked ones
#   make other-processors   TESTS=... as other processors and installations would run them;
#                           SETTINGS="--setting superlu+numba-generic" for some of them
#   make check    the gates: style, types, layers, generated code, doctests

PYTEST_WORKERS ?= 2
ready := .venv/.ready
# pytest-xdist uses the cores; threads inside a worker would only get in each other's way. A file's
# tests stay in one worker, which makes what they share (a study that has run) once. In their own
# order, the doctests come last, and no worker is left with a slow file of few tests.
one_thread := OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 NUMBA_NUM_THREADS=1

export PYTHON

.PHONY: help setup newest demo test other-processors verify bench elements gallery docs check lint format-check types layers generated doctests

help:
	@sed -n 's/^#   //p' Makefile

setup: $(ready)

# The mark is written last, so that a set-up that was stopped is done again.
$(ready): pyproject.toml requirements.lock scripts/installer.lock scripts/setup.sh scripts/system_libraries.py
	@sh scripts/setup.sh
	@touch $@

newest:
	@NEWEST=1 sh scripts/setup.sh
	@touch $(ready)
	@$(MAKE) --no-print-directory test

demo: $(ready)
	@.venv/bin/study demo

test: $(ready)
	@$(one_thread) .venv/bin/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile --no-loadscope-reorder -q

other-processors: $(ready)
	@.venv/bin/python scripts/other_processors.py --workers $(PYTEST_WORKERS) $(SETTINGS) $(TESTS)

verify: $(ready)
	@$(one_thread) .venv/bin/python -m pytest -m verify -s -q tests

bench: $(ready)
	@.venv/bin/python -m benchmarks

elements: $(ready)
	@$(one_thread) .venv/bin/python docs/elements.py measure
	@.venv/bin/python docs/elements.py draw

gallery: $(ready)
	@PYTHONPATH=. .venv/bin/python docs/gallery_pictures.py
	@PYTHONPATH=. .venv/bin/python docs/reference.py

# Warnings are errors: a broken link, a page in no table of contents, a docstring that no one can read.
docs: $(ready)
	@.venv/bin/python -m sphinx -W --keep-going -q docs docs/_build
	@echo "docs/_build/index.html"

check: lint format-check types layers generated doctests

lint: $(ready)
	@.venv/bin/ruff check .

format-check: $(ready)
	@.venv/bin/ruff format --check --output-format concise .

types: $(ready)
	@.venv/bin/mypy

layers: $(ready)
	@.venv/bin/lint-imports

generated: $(ready)
	@.venv/bin/python scripts/generate_kernels.py --check

doctests: $(ready)
	@$(one_thread) .venv/bin/python -m pytest -q --doctest-modules study
