"""Recordings made for the tests, and a clock that stands where it is put."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import tests.adapters.recording.recorder
from rosld.adapters.base import AdapterOptions, RecordedMessage
from rosld.adapters.model import Graph
from rosld.adapters.recording import RecordingAdapter
from rosld.adapters.recording.bag import Bag


class Sink:
    """Whoever is told."""

    def graph_changed(self, graph: Graph) -> None: ...

    def parameter_changed(self, name: str) -> None: ...


class Clock:
    """A clock that only moves when it is told to."""

    def __init__(self) -> None:
        self.now = 1_000_000_007

    def __call__(self) -> int:
        return self.now

    def forward(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


@pytest.fixture(scope="session")
def recorder() -> ModuleType:
    """`recorder.py`, which makes recordings."""
    return tests.adapters.recording.recorder


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def play(clock: Clock) -> Callable[..., None]:
    """Open a recording under the standing clock and run a scenario with its adapter."""

    def run(path: Path, scenario: Callable[[RecordingAdapter], Awaitable[None]], **options: Any) -> None:
        async def bounded() -> None:
            adapter = RecordingAdapter(path, AdapterOptions(**options), clock=clock)
            await adapter.open(Sink(), deadline=asyncio.get_running_loop().time() + 20)
            try:
                await asyncio.wait_for(scenario(adapter), 30)
            finally:
                await adapter.close()

        asyncio.run(bounded())

    return run


@pytest.fixture
def opened() -> Callable[[Path], Any]:
    """A context manager that gives the open recording of a path."""

    @contextmanager
    def open_bag(path: Path) -> Iterator[Bag]:
        adapter = RecordingAdapter(path, AdapterOptions())

        async def work(closing: bool) -> None:
            if closing:
                await adapter.close()
            else:
                await adapter.open(Sink(), deadline=asyncio.get_running_loop().time() + 20)

        asyncio.run(work(False))
        (bag,) = adapter.recordings.values()
        assert isinstance(bag, Bag)
        try:
            yield bag
        finally:
            asyncio.run(work(True))

    return open_bag


@pytest.fixture
def said() -> Callable[[Bag, RecordedMessage], str]:
    """The text of a recorded `std_msgs/msg/String`."""

    def text(bag: Bag, recorded: RecordedMessage) -> str:
        schema: Any = bag.schema(recorded.sample.schema)
        return str(schema.codec.decode(recorded.sample.data, recorded.sample.encoding).data)

    return text
