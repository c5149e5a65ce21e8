"""A clock that only moves on request, and recordings that play by it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.base import AdapterOptions, NullSink
from rosld.adapters.recording import RecordingAdapter


class Clock:
    """A clock that only moves on request."""

    def __init__(self) -> None:
        self.now = 1_000_000_007

    def __call__(self) -> int:
        return self.now

    def forward(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


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
