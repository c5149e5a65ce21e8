"""Background tasks on the event loop, the signals that wake them, and the clock of deadlines."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from rosld.adapters.base import Watch

loop_time = time.monotonic
"""What `loop.time()` returns, of asyncio's loops and of uvloop's alike.

To ask for the running loop is a system call before Python 3.12, and a request would do so many times.
"""


class Signal:
    """Wakes its watches whenever it is emitted; to be used on the server's loop."""

    def __init__(self) -> None:
        self._watches: dict[_SignalWatch, None] = {}

    def watch(self, wake: Callable[[], None], concerns: Callable[[str], bool] | None = None) -> Watch:
        """Call `wake` whenever the signal is given, or only when `concerns` says so of what it is about."""
        watch = _SignalWatch(wake, concerns, self._watches)
        self._watches[watch] = None
        return watch

    def emit(self, about: str = "") -> None:
        """Wake those whom it concerns."""
        for watch in tuple(self._watches):
            watch.take(about)


class _SignalWatch:
    """A watch of a signal, for what `concerns` says; None: for everything."""

    def __init__(
        self, wake: Callable[[], None], concerns: Callable[[str], bool] | None, among: dict[_SignalWatch, None]
    ) -> None:
        self._wake = wake
        self._concerns = concerns
        self._among = among

    def take(self, about: str) -> None:
        if self in self._among and (self._concerns is None or self._concerns(about)):
            self._wake()

    def close(self) -> None:
        """Stop waking. Idempotent."""
        self._among.pop(self, None)


class _Every:
    """A watch that wakes at intervals, for what can only be polled."""

    def __init__(self, seconds: float, wake: Callable[[], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._seconds = seconds
        self._wake = wake
        self._timer = self._loop.call_later(seconds, self._ring)

    def _ring(self) -> None:
        self._timer = self._loop.call_later(self._seconds, self._ring)
        self._wake()

    def close(self) -> None:
        """Stop waking. Idempotent."""
        self._timer.cancel()


class _Together:
    """Several watches as one."""

    def __init__(self, watches: tuple[Watch, ...]) -> None:
        self._watches = watches

    def close(self) -> None:
        """Stop waking. Idempotent."""
        for watch in self._watches:
            watch.close()


def call_every(seconds: float, wake: Callable[[], None]) -> Watch:
    """Call `wake` every so many seconds."""
    return _Every(seconds, wake)


def combine_watches(*watches: Watch) -> Watch:
    """Several watches as one: for a resource that is made of several things."""
    return _Together(watches)


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
