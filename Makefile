# demo: the paper's aircraft at http://127.0.0.1:8080/     test: all tests     check: style and types
# bench: the table of ratios     clean: back to a fresh clone
#
# Each of them makes .venv when it is missing or pyproject.toml has changed. PYTHON=python3.12 chooses another Python.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
PORT ?= 8080

.PHONY: demo test check bench clean venv debian

demo: $(READY)
	$(BIN)/rosld serve aircraft --port $(PORT)

test: $(READY) debian
	$(BIN)/python -m pytest

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python bench

venv: $(READY)

$(READY): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
		{ echo "rosld needs Python 3.10 or newer: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "$(PYTHON) has no venv: install it (on Debian: apt-get install python3-venv)" >&2; exit 1; }
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

# What the tests use beside Python, from Debian: a real ROS 1, a browser and Node. Without them their tests are skipped
# by name, and fail where CI=true.
debian:
	@test -x /usr/bin/rosmaster || .ci/debian tests/debian-ros.txt
	@command -v chromium >/dev/null || .ci/debian tests/debian-browser.txt
	@command -v npm >/dev/null || .ci/debian tests/debian-node.txt

clean:
	rm -rf .venv build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis tests/agents/node_modules
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
