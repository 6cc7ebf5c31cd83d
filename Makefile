# Every target sets up what it needs: an own environment in .venv from the lock files, then the project itself.
# A second call finds the stamps in .venv and starts at once; a changed lock file makes the environment anew.

# The first of these that is new enough; `make PYTHON=/path/to/python3` names another.
USABLE := import ensurepip, sys, venv; sys.exit(sys.version_info < (3, 11))
PYTHON := $(shell for python in $$PYTHON python3.11 python3.12 python3.13 python3; do \
	"$$python" -c '$(USABLE)' 2>/dev/null && echo "$$python" && exit; done; echo python3)
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
SCENARIO ?= parts-3-easy

.DELETE_ON_ERROR:
.PHONY: run test fuzz test-browser test-container test-ros2 test-wheels test-machines test-arm64 test-old-x86 check format docs
.PHONY: check-types check-rules peers ros2 viewers lock hooks clean

run: .venv/.project
	$(BIN)/dynpf run $(SCENARIO)

test: .venv/.dev
	$(BIN)/pytest --numprocesses 2

# Hostile files and payloads, for an hour or so; FILES, PAYLOADS and SEED say how many, and which.
fuzz: .venv/.dev
	$(BIN)/python -m checks.fuzz --files $(or $(FILES),100000) --payloads $(or $(PAYLOADS),1000000) --seed $(or $(SEED),0)

# Pages in Chromium, driven by the npm packages of tests/browser/package-lock.json; `.ci/browser --install` installs the rest.
test-browser: .venv/.dev
	$(BIN)/pytest -m browser tests/browser

test-container: .venv/.dev
	$(BIN)/pytest -m container

# Live robots, with ROS 2's own packages and an independent implementation of rmw_zenoh as the other side.
test-ros2: .venv/.dev .venv-ros2/.installed
	$(BIN)/pytest -m ros2 --numprocesses 2 tests/ros2

# The wheels in fresh environments, with the oldest and the newest packages (docs/library.md); shows what was measured.
test-wheels: .venv/.dev
	$(BIN)/pytest -m wheels -rP tests/wheels

# The same bytes under every choice of kernels here, and on another processor in emulation (docs/machines.md).
# JOBS and SETTINGS take those whose names begin with one of their words, CPU one of QEMU's processors.
MACHINES = $(BIN)/python -m checks.machines $(if $(JOBS),--jobs $(JOBS))
test-machines: .venv/.dev
	$(MACHINES) $(if $(SETTINGS),--settings $(SETTINGS))

test-arm64 test-old-x86: .venv/.dev
	$(MACHINES) --cpu "$(CPU)" $(@:test-%=%)

# Types take as long as all else, and both are done at once.
check: .venv/.dev
	@$(MAKE) --no-print-directory --jobs 2 --output-sync=target check-types check-rules

check-types: .venv/.dev
	$(BIN)/mypy

check-rules: .venv/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/python -m checks.pure_code
	$(BIN)/python -m checks.portable_code
	$(BIN)/python -m checks.data_code
	$(BIN)/python -m checks.sizes
	$(BIN)/python -m checks.system_names
	$(BIN)/python -m pip check

format: .venv/.dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# The references of topics and scenarios, the README's figures, and its picture of two runs.
docs: .venv/.dev
	$(BIN)/python -m docs.readme
	$(BIN)/python -m docs.reference
	$(BIN)/python -m docs.figures

# The libraries that `dynpf bench` and tests/unit/peers compare with, in an environment of their own.
peers: .venv-peers/.installed

# The other side of tests/ros2, in an environment of its own, too.
ros2: .venv-ros2/.installed

# Rerun, which reads in tests what dynpf exports; beside .venv, whose packages it uses.
viewers: .venv-viewers/.installed

# Keeps the versions that are locked, as far as pyproject.toml lets it; `make lock UPGRADE=1` takes the newest.
COMPILE = $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --fork-strategy fewest \
	--no-emit-index-url --no-emit-find-links --custom-compile-command 'make lock' $(if $(UPGRADE),--upgrade)
BOTH = lab/pyproject.toml --no-emit-package dynpf --group pyproject.toml:build
lock: .venv/.dev
	$(COMPILE) $(BOTH) --output-file requirements.lock
	$(COMPILE) $(BOTH) --group pyproject.toml:dev --constraint requirements.lock --output-file requirements-dev.lock
	$(COMPILE) benchmarks/peers.in --output-file requirements-peers.lock
	$(COMPILE) tests/ros2/oracles.in --output-file requirements-ros2.lock
	$(COMPILE) tests/unit/exporters/viewers.in --constraint requirements-dev.lock --no-emit-package numpy \
		--no-emit-package pillow --no-emit-package pyarrow --output-file requirements-viewers.lock

# Every commit then has to pass `make check`.
HOOK = $(shell git rev-parse --git-path hooks)/pre-commit
hooks:
	mkdir -p $(dir $(HOOK))
	printf '#!/bin/sh\nexec make check\n' > $(HOOK)
	chmod +x $(HOOK)

clean:
	rm -rf .venv .venv-peers .venv-ros2 .venv-viewers tests/browser/node_modules .machines .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache build dist
	find checks docs dynpf experiments formats lab protocol runtime services systems tests -name __pycache__ -prune -exec rm -rf {} +

.venv/.runtime: requirements.lock
	@$(PYTHON) -c '$(USABLE)' 2>/dev/null || { echo "dynpf needs Python 3.11 or newer with its venv module (Debian: apt" \
		"install python3-venv), which '$(PYTHON)' is not; name another one: make PYTHON=/path/to/python3" >&2; exit 1; }
	@echo "Installing the locked dependencies for $$($(PYTHON) --version) into .venv"
	@$(PYTHON) -m venv --clear .venv
	@$(PIP) install --require-hashes --requirement requirements.lock
	@touch $@

.venv/.project: .venv/.runtime pyproject.toml lab/pyproject.toml dynpf/__init__.py
	@$(PIP) install --no-build-isolation --no-deps --editable . --editable lab
	@touch $@

.venv/.dev: .venv/.project requirements-dev.lock
	@$(PIP) install --require-hashes --requirement requirements-dev.lock
	@touch $@

# NumPy 1 has no wheels for Python 3.13 and later.
OLD_ENOUGH := import ensurepip, sys, venv; sys.exit(not (3, 11) <= sys.version_info < (3, 13))
.venv-peers/.installed: requirements-peers.lock
	@python=$$(for python in $(PYTHON) python3.11 python3.12; do \
		"$$python" -c '$(OLD_ENOUGH)' 2>/dev/null && echo "$$python" && exit; done; exit 1) || { echo "the peers need Python" \
		"3.11 or 3.12 with its venv module; name one: make peers PYTHON=/path/to/python3" >&2; exit 1; }; \
	echo "Installing the locked peers for $$("$$python" --version) into .venv-peers"; \
	"$$python" -m venv --clear .venv-peers
	@.venv-peers/bin/python -m pip --disable-pip-version-check --quiet install --require-hashes --requirement requirements-peers.lock
	@touch $@

.venv-ros2/.installed: requirements-ros2.lock
	@python=$$(for python in $(PYTHON) python3.11; do \
		"$$python" -c 'import ensurepip, sys, venv; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null && echo "$$python" && \
		exit; done; exit 1) || { echo "ROS 2 has packages for Python 3.11 alone, which needs its venv module; name one:" \
		"make ros2 PYTHON=/path/to/python3.11" >&2; exit 1; }; \
	echo "Installing the locked packages of ROS 2 for $$("$$python" --version) into .venv-ros2"; \
	"$$python" -m venv --clear .venv-ros2
	@.venv-ros2/bin/python -m pip --disable-pip-version-check --quiet install --require-hashes --requirement requirements-ros2.lock
	@touch $@

.venv-viewers/.installed: requirements-viewers.lock
	@echo "Installing the locked viewers into .venv-viewers"
	@$(PYTHON) -m venv --clear .venv-viewers
	@.venv-viewers/bin/python -m pip --disable-pip-version-check --quiet install --require-hashes --no-deps --requirement $<
	@touch $@
