"""The thread that speaks ROS: an event loop of its own, and the two ways onto it from the server's loop.

Sockets are read here and nowhere else, so that a busy server never makes a robot's publisher wait.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from rosld.adapters.model import Unreachable

_T = TypeVar("_T")
_MAX_AT_ONCE = 1000


class IoThread:
    """An event loop on a daemon thread."""

    def __init__(self, name: str) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._posted: deque[Callable[[], None]] = deque()
        self._woken = False
        self._stopped = False

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    async def run(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        """Return the result of a coroutine that runs on the thread. Cancelling the await leaves it running.

        Raises what it raises, or Unreachable once the thread has stopped.
        """
        server = asyncio.get_running_loop()
        answer: asyncio.Future[_T] = server.create_future()

        def done(task: asyncio.Task[_T]) -> None:
            self._tasks.discard(task)
            _call_soon(server, lambda: _settle(answer, task))

        def start() -> None:
            task = self.loop.create_task(coroutine)
            self._tasks.add(task)
            task.add_done_callback(done)

        if self._stopped or not _call_soon(self.loop, start):
            coroutine.close()
            raise Unreachable("the adapter is closed")
        return await answer

    def post(self, action: Callable[[], None]) -> None:
        """Have the thread do this soon, in the order posted; many posts cost one wake-up."""
        self._posted.append(action)
        if not self._woken:
            self._woken = True
            if not _call_soon(self.loop, self._drain):
                self._posted.clear()

    async def stop(self, timeout: float) -> None:
        """Cancel everything on the thread and end it; waits at most `timeout` seconds."""
        if self._stopped:
            return
        self._stopped = True
        if self._thread.is_alive():
            _call_soon(self.loop, self.loop.stop)
            server = asyncio.get_running_loop()
            await server.run_in_executor(None, self._thread.join, timeout)
        else:
            self.loop.close()

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_forever()
            self.loop.run_until_complete(self._cancel_all())
        finally:
            self.loop.close()

    async def _cancel_all(self) -> None:
        tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=0.5)
        await asyncio.sleep(0)  # let closed transports tell their protocols

    def _drain(self) -> None:
        self._woken = False
        for _ in range(min(len(self._posted), _MAX_AT_ONCE)):
            self._posted.popleft()()
        if self._posted and not self._woken:  # sockets get their turn in between
            self._woken = True
            self.loop.call_soon(self._drain)


def _call_soon(loop: asyncio.AbstractEventLoop, action: Callable[[], object]) -> bool:
    """Have another thread's loop do this; False where it is closed."""
    try:
        loop.call_soon_threadsafe(action)
    except RuntimeError:
        return False
    return True


def _settle(answer: asyncio.Future[_T], task: asyncio.Task[_T]) -> None:
    if answer.done():
        if not task.cancelled():
            task.exception()  # nobody waits for it any more
    elif task.cancelled():
        answer.set_exception(Unreachable("the adapter was closed meanwhile"))
    elif error := task.exception():
        answer.set_exception(error)
    else:
        answer.set_result(task.result())
