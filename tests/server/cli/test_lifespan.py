"""Running the lifespan of an app directly."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from starlette.applications import Starlette

from rosld.adapters.model import Unreachable
from rosld.server.serving.lifespan import lifespan


def app(events: list[str], *, at_start: Exception | None = None) -> Starlette:
    @asynccontextmanager
    async def life(app: Starlette) -> AsyncIterator[None]:
        if at_start:
            raise at_start
        events.append("started")
        yield
        events.append("stopped")

    return Starlette(lifespan=life)


def test_an_error_at_start_arrives_as_itself() -> None:
    async def main() -> None:
        async with lifespan(app([], at_start=Unreachable("no master"))):
            pytest.fail("it did not start")

    with pytest.raises(Unreachable, match="no master"):
        asyncio.run(main())


def test_an_app_is_stopped_when_what_it_served_fails() -> None:
    events: list[str] = []

    async def main() -> None:
        async with lifespan(app(events)):
            raise OSError("the port is taken")

    with pytest.raises(OSError, match="taken"):
        asyncio.run(main())
    assert events == ["started", "stopped"]


def test_a_start_that_is_cancelled_leaves_no_task() -> None:
    @asynccontextmanager
    async def never(app: Starlette) -> AsyncIterator[None]:
        await asyncio.Event().wait()
        yield

    async def begin() -> None:
        async with lifespan(Starlette(lifespan=never)):
            pytest.fail("it did not start")

    async def main() -> int:
        starting = asyncio.create_task(begin())
        await asyncio.wait({starting}, timeout=0.05)
        starting.cancel()
        await asyncio.gather(starting, return_exceptions=True)
        return len(asyncio.all_tasks())

    assert asyncio.run(main()) == 1
