"""Work that is done again whenever something may have changed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable


class WokenTask:
    """Does `work` once started and after each `wake`, one run after the other; wakes during a run are one more run.

    To be used on the server's loop.
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
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task

    async def _run(self) -> None:
        while True:
            await self._woken.wait()
            self._woken.clear()
            await self._work()
