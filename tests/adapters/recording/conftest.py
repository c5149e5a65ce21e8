"""Recordings for the tests, and a clock that only moves on request."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager, AbstractContextManager, asynccontextmanager, contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import tests.adapters.recording.recorder
from rosld.adapters.base import AdapterOptions, NullSink, RecordedMessage
from rosld.adapters.recording import RecordingAdapter
from rosld.adapters.recording.bag import Bag


class Clock:
    """A clock that only moves on request."""

    def __init__(self) -> None:
        self.now = 1_000_000_007

    def __call__(self) -> int:
        return self.now

    def forward(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


@pytest.fixture(scope="session")
def recorder() -> ModuleType:
    """Return `recorder.py`, which creates recordings."""
    return tests.adapters.recording.recorder


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def play(clock: Clock) -> Callable[..., AbstractAsyncContextManager[RecordingAdapter]]:
    """`async with play(path, once=True) as adapter`: a recording that plays by the fixed clock."""

    @asynccontextmanager
    async def playing(path: Path, **options: Any) -> AsyncIterator[RecordingAdapter]:
        adapter = RecordingAdapter(path, AdapterOptions(**options), clock=clock)
        await adapter.open(NullSink(), deadline=asyncio.get_running_loop().time() + 20)
        try:
            yield adapter
        finally:
            await adapter.close()

    return playing


@pytest.fixture
def opened() -> Callable[[Path], AbstractContextManager[Bag]]:
    """Return a context manager for the open recording at a path."""

    @contextmanager
    def open_bag(path: Path) -> Iterator[Bag]:
        adapter = RecordingAdapter(path, AdapterOptions())

        async def open_adapter() -> None:
            await adapter.open(NullSink(), deadline=asyncio.get_running_loop().time() + 20)

        run(open_adapter())
        (bag,) = adapter.recordings.values()
        assert isinstance(bag, Bag)
        try:
            yield bag
        finally:
            run(adapter.close())

    return open_bag


def run(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine on a separate loop, even inside another loop."""
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, work).result()


@pytest.fixture
def said() -> Callable[[Bag, RecordedMessage], str]:
    """Return the text of a recorded `std_msgs/msg/String`."""

    def text(bag: Bag, recorded: RecordedMessage) -> str:
        schema: Any = bag.schema(recorded.sample.schema)
        return str(schema.codec.decode(recorded.sample.data, recorded.sample.encoding).data)

    return text
