"""Fixtures: a real ROS 1 system per module, and rosld's adapter opened on it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any, TypeAlias

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros1 import adapter
from tests.adapters.ros1 import system as ros1
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session, Told

Opening: TypeAlias = "Callable[..., AbstractAsyncContextManager[Session]]"


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


@pytest.fixture
def opened() -> Opening:
    """`async with opened(ros) as session`: rosld's adapter, open on a system, closed at the end."""

    @asynccontextmanager
    async def opening(system: RosSystem, **options: Any) -> AsyncIterator[Session]:
        told = Told()
        made = adapter(system.source, AdapterOptions(**options))
        await made.open(told, deadline=asyncio.get_running_loop().time() + 10)
        try:
            yield Session(made, told)
        finally:
            await made.close()

    return opening


@pytest.fixture
def free_port() -> int:
    """Return a port without a listener."""
    return ros1.free_port()
