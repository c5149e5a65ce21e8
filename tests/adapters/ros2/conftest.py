"""Fixtures: a real ROS 2 system, and rosld's adapter opened on it. Without one, only the pure tests run."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractAsyncContextManager
from typing import Any

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Encoding, MessageSchema, ServiceSchema, TypeRef
from rosld.adapters.ros2 import adapter
from tests.adapters.session import Session, opened_on
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


def opened(system: System, more: str = "", **options: Any) -> AbstractAsyncContextManager[Ros2Session]:
    """Open rosld's adapter on a system; close it at the end."""
    return opened_on(adapter(system.source + more, AdapterOptions(**options)), seconds=60, kind=Ros2Session)
