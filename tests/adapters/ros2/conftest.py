"""Fixtures: a real ROS 2 system a module, and rosld's adapter opened on it. Without one only pure tests are here."""

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
from tests.adapters.ros2.system import Ros2System
from tests.adapters.session import Session, Told

collect_ignore_glob = [] if "ROSLD_ROS2_PYTHON" in os.environ else ["test_live_*.py"]


class Ros2Session(Session):
    """An open adapter of ROS 2, whose discovery takes its time."""

    def deadline(self, seconds: float = 30.0) -> float:
        return super().deadline(seconds)

    async def text(self, data: str) -> tuple[TypeRef, bytes]:
        """A std_msgs/String as it is published."""
        schema = await self.adapter.schema(TypeRef("std_msgs/msg/String"), deadline=self.deadline())
        assert isinstance(schema, MessageSchema)
        made = schema.codec.build(schema.ref.name, {"data": data})
        return schema.ref, schema.codec.encode(made, Encoding.CDR)

    async def trigger(self, service: str, seconds: float = 30.0) -> str:
        """Call a std_srvs/Trigger; its message."""
        schema = await self.adapter.schema(TypeRef("std_srvs/srv/Trigger"), deadline=self.deadline())
        assert isinstance(schema, ServiceSchema)
        request = schema.request.codec.build(schema.request.ref.name, {})
        data = schema.request.codec.encode(request, Encoding.CDR)
        answer = await self.adapter.call(service, schema.ref, data, deadline=self.deadline(seconds))
        return str(schema.response.codec.decode(answer, Encoding.CDR).message)  # type: ignore[attr-defined]


Opening: TypeAlias = "Callable[..., AbstractAsyncContextManager[Ros2Session]]"


@pytest.fixture(scope="module")
def ros() -> Iterator[Ros2System]:
    """A robot in a domain of its own, for the tests of one module."""
    system = Ros2System()
    try:
        system.node("robot.py", "200")
        yield system
    finally:
        system.close()


@pytest.fixture
def lone_ros() -> Iterator[Ros2System]:
    """An empty domain for one test alone."""
    system = Ros2System()
    try:
        yield system
    finally:
        system.close()


@pytest.fixture
def opened() -> Opening:
    """`async with opened(ros) as session`: rosld's adapter, open on a system, closed at the end."""

    @asynccontextmanager
    async def opening(system: Ros2System, **options: Any) -> AsyncIterator[Ros2Session]:
        told = Told()
        made = adapter(system.source, AdapterOptions(**options))
        await made.open(told, deadline=asyncio.get_running_loop().time() + 60)
        try:
            yield Ros2Session(made, told)
        finally:
            await made.close()

    return opening
