# `make` lists the targets. Every target sets up what it needs: an environment in .venv with the
# versions of constraints.txt and this checkout installed in place.

PYTHON ?= python3
VENV = .venv
BIN = $(VENV)/bin
INSTALLED = $(VENV)/.installed
# The package as a user gets it, for tools that must not see the source folders: they read
# calibration/ as `calibration` and not as `gonio.calibration` (docs/adr/0001-one-import-name.md).
COPY = build/installed

export PIP_DISABLE_PIP_VERSION_CHECK = 1

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test lint types doctest docs copy constraints bench papers clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' Makefile | expand -t 14

# A marker file, so that nothing is installed twice; a change of either list installs again.
$(INSTALLED): constraints.txt pyproject.toml
	@command -v $(PYTHON) >/dev/null || { \
	    echo "gonio needs Python 3.11 or newer and finds no $(PYTHON):" \
	         "install it or name another with 'make PYTHON=...'." >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "gonio needs Python 3.11 or newer and $(PYTHON) is $$($(PYTHON) -V 2>&1):" \
	         "name another with 'make PYTHON=...'." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	    echo "$(PYTHON) has no venv module:" \
	         "install it (Debian and Ubuntu: apt-get install python3-venv)." >&2; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@echo "Installing into $(VENV): a minute or two the first time."
	$(BIN)/python -m pip install --quiet --require-hashes -r constraints.txt
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation -e .
	@touch $@

demo: export PATH := $(CURDIR)/$(BIN):$(PATH)
demo: $(INSTALLED)  ## simulate, reduce, fit and plot one material into demo/
	@mkdir -p demo
	gonio simulate rolled_aluminum --seed 1 -o demo/rolled_aluminum.gonio
	gonio reduce demo/rolled_aluminum.gonio -o demo/rolled_aluminum.nc
	gonio fit demo/rolled_aluminum.nc --model ward --self-calibrate --posterior --seed 1 --truth demo/rolled_aluminum.gonio -o demo/rolled_aluminum.json
	gonio plot demo/rolled_aluminum.json -o demo/rolled_aluminum.png

# A process for each core, and one thread of BLAS in each: more would wait for each other's core. A
# process takes half of what another has left when its own tests are done; most files stay together
# and share what is slow to make.
test: export OPENBLAS_NUM_THREADS = 1
test: $(INSTALLED)  ## run the tests
	$(BIN)/python -m pytest -n auto --dist worksteal

bench: $(INSTALLED)  ## time the loops against numpy and other programs, BENCH='--only peers' some
	$(BIN)/python -m benchmarks $(BENCH)

papers: $(INSTALLED)  ## every table and figure of the papers anew, and the table of agreement
	$(BIN)/python notebooks/run.py $(PAPERS)

lint: $(INSTALLED)  ## check style and formatting with ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: copy  ## check the types of the installed package with mypy
	cd $(COPY) && "$(CURDIR)/$(BIN)/mypy" --config-file "$(CURDIR)/pyproject.toml" --strict -p gonio

doctest: copy  ## run the examples in the docstrings of the installed package
	cd $(COPY) && "$(CURDIR)/$(BIN)/python" -m pytest -c "$(CURDIR)/pyproject.toml" --rootdir . \
	    -p no:cacheprovider --doctest-modules gonio

# Offline: nothing is fetched, and the pages of models and commands are made from the installation.
docs: $(INSTALLED)  ## build the documentation site into build/docs
	@rm -rf build/docs
	$(BIN)/sphinx-build -q -n -W --keep-going -d build/doctrees docs build/docs
	@echo "open build/docs/index.html"

# numba trusts machine code beside a source whose time has not changed: both go into the copy, so
# that the examples do not compile again what the tests have compiled.
# setuptools puts whatever an earlier build left in build/lib into the next one: start empty.
# build/docs stays: `make -j2 types docs` makes both at once.
copy: $(INSTALLED)
	@rm -rf build/lib build/bdist.* $(COPY)
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --no-compile \
	    --target $(COPY) .
	@for part in gonio calibration fitting data; do \
	    to="$(CURDIR)/$(COPY)/gonio"; [ $$part = gonio ] || to="$$to/$$part"; \
	    (cd $$part && find . -name '*.py' -exec touch -c -r {} "$$to/{}" ';' && \
	        find . -name '*.nb[ci]' | tar -cf - -T - | tar -xf - -C "$$to") || exit; \
	done

# Pins stay where pyproject.toml still allows them; `make constraints UPGRADE=--upgrade` renews all.
# pip's own configuration is left out, so that the hashes are those that everyone is served.
constraints: export PIP_CONFIG_FILE = /dev/null
constraints: export PIP_FIND_LINKS =
constraints:  ## write constraints.txt anew from pyproject.toml
	@mkdir -p build
	$(PYTHON) -m venv --clear build/pip-tools
	build/pip-tools/bin/python -m pip install --quiet pip-tools
	grep -v '^# ' constraints.txt > build/constraints.txt
	build/pip-tools/bin/pip-compile --quiet --extra test --extra docs --generate-hashes \
	    --allow-unsafe --strip-extras --no-header --no-emit-index-url --no-emit-find-links \
	    --no-emit-trusted-host $(UPGRADE) -o build/constraints.txt pyproject.toml
	{ grep '^# ' constraints.txt | head -n 3; cat build/constraints.txt; } > build/pinned.txt
	mv build/pinned.txt constraints.txt

clean:  ## remove everything that make has made
	rm -rf $(VENV) build dist demo docs/_generated notebooks/.results *.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis
