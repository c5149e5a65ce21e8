"""The lifespan of an ASGI app, run by us: so that an error at startup arrives as itself and not as a logged text."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from starlette.types import ASGIApp, Message


@asynccontextmanager
async def lifespan(app: ASGIApp) -> AsyncIterator[None]:
    """Starts the app and, at the end, stops it. Raises what the app raises; both run in one task, as apps expect."""
    to_app: asyncio.Queue[Message] = asyncio.Queue()
    from_app: asyncio.Queue[Message] = asyncio.Queue()
    scope = {"type": "lifespan", "asgi": {"version": "3.0", "spec_version": "2.0"}, "state": {}}

    async def run() -> None:
        await app(scope, to_app.get, from_app.put)

    running = asyncio.create_task(run())
    try:
        await _step("startup", running, to_app, from_app)
        try:
            yield
        finally:
            await _step("shutdown", running, to_app, from_app)
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def _step(
    name: str, running: asyncio.Task[None], to_app: asyncio.Queue[Message], from_app: asyncio.Queue[Message]
) -> None:
    """Sends one event and waits for its answer, or for the app's end."""
    await to_app.put({"type": f"lifespan.{name}"})
    answer = asyncio.ensure_future(from_app.get())
    try:
        await asyncio.wait({running, answer}, return_when=asyncio.FIRST_COMPLETED)
        if answer.done() and answer.result()["type"] == f"lifespan.{name}.complete":
            return
        await running  # raises what went wrong
        if answer.done():
            raise RuntimeError(answer.result().get("message", f"the app failed at {name}"))
    finally:
        answer.cancel()
