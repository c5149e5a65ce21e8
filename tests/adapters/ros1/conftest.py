"""Fixtures: a real ROS 1 system a module, and rosld's adapter opened on it."""

from __future__ import annotations

import asyncio
import importlib.util
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import pytest

from rosld.adapters.base import AdapterOptions, Subscription
from rosld.adapters.model import Graph, Sample
from rosld.adapters.ros1 import Ros1Adapter, adapter


def _sibling(name: str) -> Any:
    """A module beside this file; tests are no package."""
    full = f"ros1_tests_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, Path(__file__).parent / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        sys.modules[full] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[full])
    return sys.modules[full]


if TYPE_CHECKING:
    from tests.adapters.ros1.system import RosSystem
else:
    RosSystem = _sibling("system").RosSystem


class Told:
    """A sink that keeps what it was told."""

    def __init__(self) -> None:
        self.graphs: list[Graph] = []
        self.parameters: list[str] = []

    def graph_changed(self, graph: Graph) -> None:
        self.graphs.append(graph)

    def parameter_changed(self, name: str) -> None:
        self.parameters.append(name)


class Session:
    """An open adapter with the waiting that tests need."""

    def __init__(self, opened: Ros1Adapter, told: Told) -> None:
        self.adapter = opened
        self.told = told

    @property
    def graph(self) -> Graph:
        return self.adapter.graph

    def deadline(self, seconds: float = 5.0) -> float:
        return asyncio.get_running_loop().time() + seconds

    async def until(self, true: Callable[[], Any], what: str = "what was waited for", timeout: float = 20.0) -> Any:
        end = time.monotonic() + timeout
        while not (found := true()):
            assert time.monotonic() < end, f"never came: {what}"
            await asyncio.sleep(0.02)
        return found

    async def first(self, subscription: Subscription, count: int = 1) -> list[Sample]:
        """The newest samples, once there are as many as this."""
        await self.until(lambda: len(subscription.latest()) >= count, f"{count} samples")
        return list(subscription.latest())

    async def decoded(self, sample: Sample) -> Any:
        schema = await self.adapter.schema(sample.schema, deadline=self.deadline())
        return schema.codec.decode(sample.data, sample.encoding)  # type: ignore[union-attr]


Opening: TypeAlias = "Callable[..., AbstractAsyncContextManager[Session]]"


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A real rosmaster, for the tests of one module."""
    _sibling("system").require_ros()
    system = RosSystem(tmp_path_factory.mktemp("ros"))
    try:
        system.start_master()
        yield system
    finally:
        system.close()


@pytest.fixture
def lone_ros(tmp_path: Path) -> Iterator[RosSystem]:
    """A real rosmaster for one test alone, which may kill it."""
    _sibling("system").require_ros()
    system = RosSystem(tmp_path)
    try:
        system.start_master()
        yield system
    finally:
        system.close()


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
    """A port nobody listens on."""
    return int(_sibling("system").free_port())
