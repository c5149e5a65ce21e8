"""The lifespan of the application (ASGI): start and stop of everything that runs in the background."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from typing import TypeAlias

from msgspec import Struct
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rosld.server.runtime.tasks import end_tasks
from rosld.server.runtime.watchdog import Watchdog
from rosld.server.sparql.process.client import QueryProcess

Job: TypeAlias = Callable[[], Awaitable[None]]


class Lifespan(Struct, eq=False):
    """Start of the query process, the robot and background jobs, and their end in reverse order.

    `start` opens the robot, and `stop` releases it. `watchdog` is None if another application starts it.
    `background` jobs run until the end; then `closings` are called.
    """

    start: Job
    stop: Job
    process: QueryProcess
    watchdog: Watchdog | None
    background: Sequence[Job]
    closings: Sequence[Job]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Start, and stop on request. Raises what opening the robot raises."""
        await receive()
        await self.process.start()
        try:
            await self.start()
        except BaseException:
            await self.process.close()
            await self.stop()
            raise
        if self.watchdog is not None:
            self.watchdog.start()
        background = [asyncio.ensure_future(run()) for run in self.background]
        await send({"type": "lifespan.startup.complete"})
        await receive()
        if self.watchdog is not None:
            self.watchdog.stop()
        await end_tasks(background)
        for close in self.closings:
            await close()
        await self.process.close()
        await self.stop()
        await send({"type": "lifespan.shutdown.complete"})


@asynccontextmanager
async def lifespan(app: ASGIApp) -> AsyncIterator[None]:
    """Start the app and, at the end, stop it in the same task, as apps expect. Raises what the app raises."""
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
    """Send one event and wait for its answer, or for the end of the app."""
    await to_app.put({"type": f"lifespan.{name}"})
    answer = asyncio.ensure_future(from_app.get())
    try:
        await asyncio.wait({running, answer}, return_when=asyncio.FIRST_COMPLETED)
        if answer.done() and answer.result()["type"] == f"lifespan.{name}.complete":
            return
        await running  # raises the error
        if answer.done():
            raise RuntimeError(answer.result().get("message", f"the app failed at {name}"))
    finally:
        answer.cancel()
