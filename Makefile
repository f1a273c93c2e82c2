# Every target bootstraps what it needs from a stock python3 (3.11 or newer): a virtual environment in .venv, pinned by constraints.txt.
PYTHON ?= python3
VENV := .venv
AGENT_PYTHON ?= python3.9
AGENT_VENV := build/agent-python
LOWEST_VENV := build/lowest
# Tests that need no extra, and the implementations with which they compare.
LOWEST_TESTS := tests/unit/graph tests/unit/commands tests/unit/record tests/unit/sim_core
LOWEST_ORACLES := mcap-ros2-support opencv-python-headless pymap3d pyproj scipy trimesh
BIN := $(VENV)/bin
# Errors and warnings alone, so that a first `make run` shows the run and not a hundred lines of pip.
PIP_INSTALL = $(BIN)/python -m pip --quiet install --disable-pip-version-check --no-input -c constraints.txt
# Many tests wait for processes that they started, of the slow ones most; a worker costs some seconds to begin.
SLOW_WORKERS := PYTEST_XDIST_AUTO_NUM_WORKERS=$$((2 * $$(getconf _NPROCESSORS_ONLN)))
SIDE_BY_SIDE := -n auto --dist loadscope --no-loadscope-reorder
FAST_WORKERS := PYTEST_XDIST_AUTO_NUM_WORKERS=$$(($$(getconf _NPROCESSORS_ONLN) + 1))

.PHONY: run package test test-fast test-medium test-slow test-realtime test-nightly checks test-agent test-lowest lint format types dialect check-dialect pages docs pictures bench bench-compare bench-pages bench-analyze bench-identify figures figures-of-vehicles paper soak soak-long chaos wheel wheels dist sbom audit mutate fuzz lock clean
.DEFAULT_GOAL := run
# Tests start hundreds of processes; without kept bytecode each compiles the whole package.
unexport PYTHONDONTWRITEBYTECODE

$(VENV)/.run: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "xitl needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) -V). Try: make PYTHON=python3.11" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' || \
		{ echo "$(PYTHON) has no venv module. On Debian or Ubuntu: apt install python3-venv" >&2; exit 2; }
	@$(PYTHON) -m venv $(VENV)
	@echo "installing xitl and what it needs into $(VENV)/, some 360 MB: a minute or so, the first time only"
	@$(PIP_INSTALL) -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.run
	@echo "installing what tests and checks need into $(VENV)/, another 1.2 GB: some minutes, the first time only"
	@$(PIP_INSTALL) --no-compile -e '.[dev]' # the tests compile what they import, a small part
	@touch $@

$(VENV)/.mutate: $(VENV)/.dev
	@$(PIP_INSTALL) -e '.[dev,mutation]'
	@touch $@

$(VENV)/.fuzz: $(VENV)/.dev
	@$(PIP_INSTALL) -e '.[dev,fuzz]'
	@touch $@

$(VENV)/.wheels: $(VENV)/.dev
	@$(PIP_INSTALL) -e '.[dev,wheels]'
	@touch $@

$(VENV)/.audit: $(VENV)/.dev
	@$(PIP_INSTALL) -e '.[dev,audit]'
	@touch $@

run: $(VENV)/.run  ## inspect the log boom in current, waves and gusts
	$(BIN)/xitl sim --profile sitl

package: $(VENV)/.run  ## xitl-agent.pyz, the agent in one file for a board
	$(BIN)/xitl agent package

test:  ## all tests, one stage after the other
	$(MAKE) test-fast
	$(MAKE) test-medium
	$(MAKE) test-slow
	$(MAKE) test-realtime
	$(MAKE) test-nightly

test-fast: $(VENV)/.dev  ## the tests to run all day: up to 0.1 s of processor time each (PYTEST=arguments)
	$(FAST_WORKERS) $(BIN)/python -m pytest -m "not medium and not slow and not realtime" -n auto $(PYTEST)

test-medium: $(VENV)/.dev  ## those that take up to 2 s of processor time each
	$(FAST_WORKERS) $(BIN)/python -m pytest -m "medium and not slow and not realtime" -n auto

test-slow: $(VENV)/.dev  ## those that take or wait for seconds, beside each other
	$(SLOW_WORKERS) $(BIN)/python -m pytest -m "slow and not realtime and not nightly" $(SIDE_BY_SIDE)

test-realtime: $(VENV)/.dev  ## those that keep up with a board, with nodes of ROS or with the clock, one at a time and alone
	$(BIN)/python -m pytest -m "realtime and not nightly"

test-nightly: $(VENV)/.dev  ## those that .ci/run leaves out: more seeds, pages, kills, platforms and an emulated board
	$(SLOW_WORKERS) $(BIN)/python -m pytest -m "nightly and not realtime" $(SIDE_BY_SIDE)
	$(BIN)/python -m pytest -m "nightly and realtime"

checks: lint types check-dialect docs wheel  ## everything else that has to pass

$(AGENT_VENV)/.made: Makefile
	$(AGENT_PYTHON) -m venv $(AGENT_VENV)
	$(AGENT_VENV)/bin/python -m pip install --disable-pip-version-check --no-input \
		hypothesis numpy pygeomag pymap3d pymavlink pyserial pytest python-can
	@touch $@

test-agent: $(AGENT_VENV)/.made  ## the agent's fast tests on the oldest Python of a board (AGENT_PYTHON=python3.9)
	$(AGENT_VENV)/bin/python -m pytest tests/unit/agent -m "not slow and not realtime"

$(LOWEST_VENV)/.made: Makefile pyproject.toml tools/lowest_versions.py
	rm -rf $(LOWEST_VENV)
	$(PYTHON) -m venv $(LOWEST_VENV)
	$(LOWEST_VENV)/bin/python tools/lowest_versions.py > build/lowest.txt
	$(LOWEST_VENV)/bin/python -m pip --quiet install --disable-pip-version-check --no-input \
		-c build/lowest.txt -e . hypothesis pytest pytest-xdist $(LOWEST_ORACLES)
	@touch $@

test-lowest: $(LOWEST_VENV)/.made  ## a run, its analysis and tests of the core with the lowest versions that pyproject.toml permits
	$(LOWEST_VENV)/bin/xitl --help > /dev/null
	$(LOWEST_VENV)/bin/xitl sim sitl --duration 20 --out build/lowest/run --overwrite
	$(LOWEST_VENV)/bin/xitl logs analyze build/lowest/run > /dev/null
	$(FAST_WORKERS) $(LOWEST_VENV)/bin/python -m pytest $(LOWEST_TESTS) -m "not slow and not realtime" -n auto \
		-W ignore::DeprecationWarning

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(VENV)/.dev
	$(BIN)/mypy

dialect: $(VENV)/.dev  ## regenerate the codec after an edit of agent/wire/xitl.xml or fleet.xml
	$(BIN)/python tools/generate_dialect.py

check-dialect: $(VENV)/.dev
	$(BIN)/python tools/generate_dialect.py --check

pages: $(VENV)/.dev  ## renew the generated parts of docs/ after an edit of a topic, a profile key or a public docstring
	$(BIN)/python tools/generate_topics.py
	$(BIN)/python tools/generate_profile_reference.py
	$(BIN)/python tools/generate_api.py

docs: $(VENV)/.dev  ## the site of docs/ in build/site, every link and anchor checked
	$(BIN)/zensical build --strict
	$(BIN)/python tools/check_site.py build/site

pictures: $(VENV)/.dev  ## make the pictures of README and docs/ anew, from runs; some minutes, needs Chromium
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tools.pictures

bench: $(VENV)/.dev  ## measure; asserts nothing; writes build/bench/*.json (ONLY=word of a name, OUT=file)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.bench $(if $(ONLY),--only "$(ONLY)") $(if $(OUT),--out "$(OUT)")

bench-compare: $(VENV)/.dev  ## two results or two commits in pairs, with intervals: A=old B=new (ONLY=word, PAIRS=number)
	$(BIN)/python -m tests.bench.compare $(A) $(B) $(if $(ONLY),--only "$(ONLY)") $(if $(PAIRS),--pairs $(PAIRS))

bench-pages: $(VENV)/.dev  ## keep the results in KEEP=file, and write the tables of speed in docs/
	PYTHONPATH=. $(BIN)/python tools/write_bench.py $(KEEP)

bench-analyze: $(VENV)/.dev  ## how often `xitl logs analyze` names the right cause (SEEDS=first-last, ONLY=word, OUT=file; ARDUPILOT=1: with a stock ArduPilot), or keep the results in KEEP=file
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.bench.analyze $(if $(SEEDS),--seeds $(SEEDS)) $(if $(ONLY),--only "$(ONLY)") \
		$(if $(ARDUPILOT),--ardupilot) $(if $(OUT),--out "$(OUT)") $(if $(KEEP),--keep "$(KEEP)")

bench-identify: $(VENV)/.dev  ## errors of `xitl identify vessel`, and how often two standard errors contain the truth (SEEDS=first-last)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m tests.bench.identify $(if $(SEEDS),--seeds $(SEEDS))

figures: $(VENV)/.dev  ## the three environments with twenty seeds each, and their table in docs/figures.md
	$(BIN)/xitl campaign environments --out runs/figures --report || test $$? = 1
	$(BIN)/python tools/write_figures.py runs/figures docs/figures.md

figures-of-vehicles: $(VENV)/.dev  ## every vessel in the three environments with twenty seeds each, an hour or more, and the table in docs/vehicles.md
	$(BIN)/xitl campaign vehicles --out runs/figures-of-vehicles --report || test $$? = 1
	$(BIN)/python tools/write_figures.py runs/figures-of-vehicles docs/vehicles.md

paper: $(VENV)/.dev  ## the paper's experiments, and their tables and figures in docs/paper.md
	$(BIN)/xitl paper all --out runs/paper --overwrite --report || test $$? = 1
	$(BIN)/python tools/write_paper.py runs/paper

soak: $(VENV)/.dev  ## ten minutes at 2000 messages a second: what was lost
	$(BIN)/python -m tests.bench.soak

soak-long: $(VENV)/.dev  ## hours of hitl-loopback with stations, companion, view, browser and faults: memory, files, counts (HOURS=2 SEED=1)
	$(BIN)/python -m tests.bench.soak_long $(if $(HOURS),--hours $(HOURS)) $(if $(SEED),--seed $(SEED))

chaos: $(VENV)/.dev  ## random events against host, autopilot and companion, and what holds after each (SEED=1 EVENTS=200)
	$(BIN)/python -m tests.chaos $(if $(SEED),--seed $(SEED)) $(if $(EVENTS),--events $(EVENTS))

dist: $(VENV)/.dev  ## wheel, sdist, agent, bill of materials and checksums in dist/, the same bytes each time
	rm -rf dist
	$(BIN)/python -m hatchling build -t sdist -t wheel
	cd dist && ../$(BIN)/xitl agent package
	$(BIN)/python tools/write_sbom.py dist/xitl.cdx.json
	cd dist && sha256sum * > SHA256SUMS

wheels: $(VENV)/.wheels  ## wheels with the compiled physics for each platform, in dist/ (ONLY=x86_64-linux)
	for platform in $(or $(ONLY),x86_64-linux aarch64-linux x86_64-macos arm64-macos x86_64-windows); do \
		XITL_WHEEL=$$platform $(BIN)/python -m hatchling build -t wheel || exit 1; \
	done

sbom: $(VENV)/.dev  ## the bill of materials of xitl and all extras, build/xitl.cdx.json (CycloneDX)
	$(BIN)/python tools/write_sbom.py build/xitl.cdx.json

audit: $(VENV)/.audit  ## look up the pinned versions in the advisories of PyPI and OSV; needs network
	$(BIN)/python -m pip_audit --strict --requirement constraints.txt --no-deps --disable-pip

wheel: $(VENV)/.dev  ## build the wheel and try it in an environment of its own
	tools/check_wheel.sh

mutate: $(VENV)/.mutate  ## change the lines of the last commit one operator at a time; lists what no test notices (BASE=commit, FILES=paths, COUNT=random changes, SEED=number)
	$(BIN)/python -m tools.mutate $(if $(BASE),--base $(BASE)) $(if $(COUNT),--count $(COUNT)) $(if $(SEED),--seed $(SEED)) $(FILES)

fuzz: $(VENV)/.fuzz  ## search inputs that a parser raises for, led by coverage (ONLY=target, RUNS=inputs of each)
	$(BIN)/python -m tests.fuzz $(ONLY) $(if $(RUNS),-runs=$(RUNS))

lock: $(VENV)/.dev  ## pin today's versions
	tools/lock.sh

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
