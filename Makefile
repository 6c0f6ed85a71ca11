# make demo | make test | make bench. PYTHON chooses the interpreter the environment is made with.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
SEED   ?= 7
BENCH  ?= all
TSC    := tests/browser/node_modules/.bin/tsc
# Per cent of lines and branches that the tests must reach: all of all, short tests of missions of all, and these of what
# decides in a mission. A little is left for machines without a browser.
FLOOR       ?= 86
PARTS_FLOOR ?= 57
CORE_FLOOR  ?= 97

.PHONY: demo test coverage bench lint kernels licences protocol page-types docs screenshots wheel env clean

env: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

# The pip that older Pythons bring resolves the many packages of 'dev' slowly.
$(VENV)/.installed-dev: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check --upgrade pip
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $(VENV)/.installed $@

demo: $(VENV)/.installed
	$(BIN)/fieldkit demo --seed $(SEED)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# NOTICE against the dependencies that are declared, and against what these say of their licences.
licences: $(VENV)/.installed-dev
	$(BIN)/pytest -q -n 0 tests/system/test_notice.py

# What every process of the tests would compile for itself where they all begin at once.
kernels: $(VENV)/.installed-dev
	$(BIN)/python -m compileall -q fieldkit calibration drivers mission
	$(BIN)/python -m mission.lab.kernels

# Three at a time on two cores: many tests wait for a wire or a clock. Traced, tests take up to half as long again:
# what the others reach counts in 'make coverage' alone.
test: $(VENV)/.installed-dev
	$(MAKE) --jobs 2 lint kernels
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder --cov --cov-report=
	@echo "reached by short tests of missions, of the lines and branches of what decides in a mission, in per cent:"
	$(BIN)/coverage report --include='mission/core/*,mission/safety/*' --fail-under=$(CORE_FLOOR)
	@echo "and of everything:"
	$(BIN)/coverage report --format=total --fail-under=$(PARTS_FLOOR)

coverage: $(VENV)/.installed-dev
	FIELDKIT_COVERAGE=all $(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder --cov --cov-report=
	@echo "reached by all tests, of all lines and branches, in per cent:"
	$(BIN)/coverage report --format=total --fail-under=$(FLOOR)

# The types of the page's JavaScript, from the models in Python.
protocol: $(VENV)/.installed-dev
	$(BIN)/python -m mission.lab.page_types

# The page's JavaScript against these types, by TypeScript's compiler. It needs npm; nothing is built, nobody else needs it.
page-types: $(TSC)
	$(TSC) -p tests/browser

$(TSC): tests/browser/package.json
	npm install --prefix tests/browser --no-package-lock --no-audit --no-fund --silent
	touch $@

# The manual, offline, with warnings as errors; 'fieldkit docs' opens it.
docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --site-dir fieldkit/_manual

# The manual's pictures of the page, from an emulated walk; needs chromium.
screenshots: $(VENV)/.installed-dev
	$(BIN)/python docs/screenshots.py

# A wheel that carries the manual.
wheel: docs
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

bench: $(VENV)/.installed-dev
	$(BIN)/fieldkit bench $(BENCH)

clean:
	rm -rf $(VENV) tests/browser/node_modules build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis fieldkit/_manual
