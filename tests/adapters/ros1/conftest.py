"""A real ROS 1 system per module, and rosld's adapter opened on it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros1 import adapter
from tests.adapters.ros1 import system as ros1
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session, opened_on


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A real rosmaster for the tests of one module."""
    with ros1.running(tmp_path_factory.mktemp("ros")) as system:
        yield system


@pytest.fixture
def lone_ros(tmp_path: Path) -> Iterator[RosSystem]:
    """A real rosmaster for one test, which may kill it."""
    with ros1.running(tmp_path) as system:
        yield system


def opened(system: RosSystem, **options: Any) -> AbstractAsyncContextManager[Session]:
    """Open rosld's adapter on a system; close it at the end."""
    return opened_on(adapter(system.source, AdapterOptions(**options)))
