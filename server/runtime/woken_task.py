"""Background tasks: work that is done again whenever something may have changed, and the end of any task."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

_AGAIN_SECONDS = 0.5
"""Seconds after which a task that has not ended is cancelled again."""

_log = logging.getLogger("rosld")


class WokenTask:
    """Does `work` once started and after each `wake`, one run after the other; wakes during a run are one more run.

    A run that fails is logged. To be used on the server's loop.
    """

    def __init__(self, work: Callable[[], Awaitable[None]]) -> None:
        self._work = work
        self._woken = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def wake(self) -> None:
        """Do the work again, once it has started."""
        self._woken.set()

    def start(self) -> None:
        """Do the work now, and from now on."""
        self._woken.set()
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def stop(self) -> None:
        """Cancel what is under way, and do nothing more. Idempotent."""
        if self._task is not None:
            await end_tasks([self._task])

    async def _run(self) -> None:
        while True:
            await self._woken.wait()
            self._woken.clear()
            try:
                await self._work()
            except Exception:
                _log.exception("background work failed; it runs again at the next change")


async def end_tasks(tasks: Iterable[asyncio.Future[Any]]) -> None:
    """Cancel tasks until they have ended, whatever came of them.

    Once is not enough: before Python 3.12, `asyncio.wait_for` drops a cancellation that comes just as its wait is over
    (python/cpython#86296), so that a task that waits in a loop goes on for ever.
    """
    pending = {*tasks}
    while pending:
        for each in pending:
            each.cancel()
        _, pending = await asyncio.wait(pending, timeout=_AGAIN_SECONDS)
