"""Fixtures: a real ROS 2 system, and rosld's adapter opened on it. Without one, only the pure tests run."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, TypeAlias

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Encoding, MessageSchema, ServiceSchema, TypeRef
from rosld.adapters.ros2 import adapter
from tests.adapters.session import Session, Told
from tests.ros2.system import System, running

collect_ignore_glob = [] if "ROSLD_ROS2_PYTHON" in os.environ else ["test_live_*.py"]


class Ros2Session(Session):
    """An open adapter of ROS 2, whose discovery takes time."""

    def deadline(self, seconds: float = 30.0) -> float:
        return super().deadline(seconds)

    async def text(self, data: str) -> tuple[TypeRef, bytes]:
        """Return a published std_msgs/String."""
        schema = await self.adapter.schema(TypeRef("std_msgs/msg/String"), deadline=self.deadline())
        assert isinstance(schema, MessageSchema)
        made = schema.codec.build(schema.ref.name, {"data": data})
        return schema.ref, schema.codec.encode(made, Encoding.CDR)

    async def trigger(self, service: str, seconds: float = 30.0) -> str:
        """Call a std_srvs/Trigger; return its message."""
        schema = await self.adapter.schema(TypeRef("std_srvs/srv/Trigger"), deadline=self.deadline())
        assert isinstance(schema, ServiceSchema)
        request = schema.request.codec.build(schema.request.ref.name, {})
        data = schema.request.codec.encode(request, Encoding.CDR)
        answer = await self.adapter.call(service, schema.ref, data, deadline=self.deadline(seconds))
        return str(schema.response.codec.decode(answer, Encoding.CDR).message)  # type: ignore[attr-defined]


Opening: TypeAlias = "Callable[..., AbstractAsyncContextManager[Ros2Session]]"


@pytest.fixture(scope="session")
def ros() -> Iterator[System]:
    """A robot, its pilot, and nodes with a lifecycle, for all tests that end none of them."""
    with running() as system:
        for node in ("robot.py", "pilot.py", "managed.py"):
            system.node(node)
        yield system


@pytest.fixture
def lone_ros() -> Iterator[System]:
    """An empty domain for one test."""
    with running() as system:
        yield system


@pytest.fixture
def opened() -> Opening:
    """`async with opened(ros) as session`: rosld's adapter, open on a system, closed at the end."""

    @asynccontextmanager
    async def opening(system: System, more: str = "", **options: Any) -> AsyncIterator[Ros2Session]:
        told = Told()
        made = adapter(system.source + more, AdapterOptions(**options))
        await made.open(told, deadline=asyncio.get_running_loop().time() + 60)
        try:
            yield Ros2Session(made, told)
        finally:
            await made.close()

    return opening
