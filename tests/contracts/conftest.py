"""Robots of the contract suite: one session-wide system per kind of adapter.

Each module in `ROBOTS` is next to this file. It has a context manager `robot(folder: Path) -> Iterator[Robot]`, and
`HAS`, the names of the attributes of `Robot` that are not None there ("read_only" if nothing can be written): tests
marked `@needs(...)` run only on robots that have what they need. A new adapter joins the suite with one such module and
one line here.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import pytest

ROBOTS = ["aircraft", "foxglove", "recording", "ros1", "rosbridge", "rosbridge1", "rover", "zenoh"]
if "ROSLD_ROS2_PYTHON" in os.environ:  # the suite runs once more on a Python that has rclpy (tests/adapters/ros2)
    ROBOTS.append("ros2")
EMBEDDED = ("aircraft", "recording", "rover")
"""Robots within the process, whose tests are quick."""


_MODULES = {name: import_module(f"tests.contracts.{name}") for name in ROBOTS}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test on every robot that has what it needs."""
    if "robot" in metafunc.fixturenames:
        needed = frozenset(getattr(metafunc.function, "needed", ()))
        able = [
            pytest.param(name, marks=() if name in EMBEDDED else pytest.mark.slow)
            for name, module in _MODULES.items()
            if needed <= module.HAS
        ]
        metafunc.parametrize("robot", able, indirect=True, scope="session")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Omit the tests that no robot here can run."""
    has = frozenset[str]().union(*(module.HAS for module in _MODULES.values()))
    vain = [item for item in items if not frozenset(getattr(getattr(item, "function", None), "needed", ())) <= has]
    if vain:
        config.hook.pytest_deselected(items=vain)
        items[:] = [item for item in items if item not in vain]


@pytest.fixture(scope="session")
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A running system, as `robot.py` describes it."""
    with _MODULES[request.param].robot(tmp_path_factory.mktemp(request.param)) as running:
        yield running
