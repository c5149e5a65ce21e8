"""Adapters of live systems: the thread that speaks ROS, and the base class of those that have one.

The thread has its own event loop. Sockets are read there and nowhere else, so that a busy server never makes a robot's
publisher wait.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, Generic, Protocol, TypeVar

from rosld.adapters.base import Adapter
from rosld.adapters.model import Graph, Refused, RosError, Schema, TimedOut, TypeRef, Unreachable
from rosld.adapters.model.library import TypeLibrary

_T = TypeVar("_T")
_MAX_AT_ONCE = 1000
_CLOSE_SECONDS = 1.7


class IoThread:
    """An event loop on a daemon thread."""

    def __init__(self, name: str) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._actions: deque[Callable[[], None]] = deque()
        self._wake_scheduled = False
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
        """Run an action on the thread soon, in the order of posts; many posts cost one wake-up."""
        self._actions.append(action)
        if not self._wake_scheduled:
            self._wake_scheduled = True
            if not _call_soon(self.loop, self._drain):
                self._actions.clear()

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
        self._wake_scheduled = False
        for _ in range(min(len(self._actions), _MAX_AT_ONCE)):
            self._actions.popleft()()
        if self._actions and not self._wake_scheduled:  # sockets get their turn in between
            self._wake_scheduled = True
            self.loop.call_soon(self._drain)


def _call_soon(loop: asyncio.AbstractEventLoop, action: Callable[[], object]) -> bool:
    """Schedule a call on another thread's loop; return False if it is closed."""
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


class LiveSystem(Protocol):
    """A system that lives on the thread of its adapter."""

    @property
    def graph(self) -> Graph:
        """The computation graph as last known; any thread may read it."""

    async def close(self) -> None:
        """Leave the system."""


_S = TypeVar("_S", bound=LiveSystem)


class ThreadAdapter(Adapter, Generic[_S]):
    """Base class of adapters of systems that are reached from a thread of their own."""

    def __init__(self, library: TypeLibrary, own_node: str) -> None:
        self._library = library
        self._graph = Graph(0, own_node=own_node)
        self._thread: IoThread | None = None
        self._system: _S | None = None
        self._closing: asyncio.Future[None] | None = None

    @property
    def graph(self) -> Graph:
        """The computation graph as last known."""
        return self._system.graph if self._system else self._graph

    async def close(self) -> None:
        """Leave the system within two seconds, even if it hangs. Idempotent."""
        if self._closing is not None:
            await asyncio.shield(self._closing)
        elif self._thread is not None:
            self._closing = asyncio.ensure_future(self._close(self._thread))
            await asyncio.shield(self._closing)

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types met so far, and those that the graph names."""
        graph = self.graph
        types = dict.fromkeys(self._library.known())
        named = {ref.name for ref in types}
        typed = [ref for topic in graph.topics.values() for ref in topic.types]
        typed += [service.type for service in graph.services.values() if service.type is not None]
        typed += [action.type for action in graph.actions.values() if action.type is not None]
        types.update(dict.fromkeys(ref for ref in typed if ref.hash or ref.name not in named))
        return list(types)

    def _running(self) -> tuple[IoThread, _S]:
        if self._thread is None or self._system is None or self._closing is not None:
            raise Unreachable("the adapter is not open")
        return self._thread, self._system

    async def _schema_in_time(self, name: str, search: Coroutine[Any, Any, Schema], deadline: float) -> Schema:
        """Return the schema that `search` finds on the thread. Raises TimedOut, UnknownType."""
        thread, _ = self._running()
        try:
            return await asyncio.wait_for(thread.run(search), max(seconds_left(deadline), 0.0))
        except asyncio.TimeoutError as error:
            raise TimedOut(f"the definition of {name} was not found in time") from error

    def _require_type(self, topic: str, type: TypeRef) -> None:
        """Raise Refused if the topic exists with other types only."""
        existing = self.graph.topics.get(topic)
        if existing is not None and existing.types and all(type.name != each.name for each in existing.types):
            names = " and ".join(each.name for each in existing.types)
            raise Refused(f"{topic} has the type {names}, not {type.name}")

    async def _close(self, thread: IoThread) -> None:
        began = time.monotonic()
        if self._system is not None:
            try:
                await asyncio.wait_for(thread.run(self._system.close()), _CLOSE_SECONDS)
            except (asyncio.TimeoutError, RosError):
                pass
        await thread.stop(max(0.2, _CLOSE_SECONDS - (time.monotonic() - began)))


def thread_time(deadline: float) -> float:
    """Return a deadline of the running loop as a time of the thread's loop, whose clock is the monotonic one."""
    return time.monotonic() + seconds_left(deadline)


def seconds_left(deadline: float) -> float:
    """Return the seconds until a deadline of the running loop."""
    return deadline - asyncio.get_running_loop().time()
