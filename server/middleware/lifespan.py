"""The lifespan of the application (ASGI): start and stop of everything that runs in the background."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeAlias

from starlette.types import Receive, Scope, Send

from rosld.server.runtime.tasks import end_tasks
from rosld.server.runtime.watchdog import Watchdog
from rosld.server.sparql.process.client import QueryProcess

Job: TypeAlias = Callable[[], Awaitable[None]]


class Lifespan:
    """Start of the query process, the robot and background jobs, and their end in reverse order.

    `start` opens the robot, and `stop` releases it. `background` jobs run until the end; then `closings` are called.
    """

    def __init__(
        self,
        start: Job,
        stop: Job,
        process: QueryProcess,
        watchdog: Watchdog,
        background: Sequence[Job],
        closings: Sequence[Job],
    ) -> None:
        self._start = start
        self._stop = stop
        self._process = process
        self._watchdog = watchdog
        self._background = background
        self._closings = closings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Start, and stop on request. Raises what opening the robot raises."""
        await receive()
        await self._process.start()
        try:
            await self._start()
        except BaseException:
            await self._process.close()
            raise
        self._watchdog.start()
        background = [asyncio.ensure_future(run()) for run in self._background]
        await send({"type": "lifespan.startup.complete"})
        await receive()
        self._watchdog.stop()
        await end_tasks(background)
        for close in self._closings:
            await close()
        await self._process.close()
        await self._stop()
        await send({"type": "lifespan.shutdown.complete"})
