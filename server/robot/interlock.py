"""Write interlock: the last check of every write to the robot, which refuses all writes while it is stopped."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from datetime import datetime, timezone
from typing import TypeVar

from msgspec import Struct

from rosld.adapters.model import RosError, Sent
from rosld.server.runtime.dry_run import end_dry_run

_T = TypeVar("_T")


class StopState(Struct, frozen=True):
    """The stop of the robot: who stopped it, when (wall-clock nanoseconds), and the reason, if given.

    `url` is its resource, `id` confirms a release by a person without a name.
    """

    stopped_by: str
    since_ns: int
    reason: str | None = None
    url: str | None = None
    id: str = ""

    @property
    def sentence(self) -> str:
        """Time of the stop as a sentence without a full stop, containing no text of clients."""
        return f"The robot was stopped at {self._moment}"

    @property
    def words(self) -> str:
        """Sentence for people: agent, time and reason of the stop, the reason as a quotation."""
        why = f": {json.dumps(self.reason, ensure_ascii=False)}" if self.reason else ""
        return f"The robot was stopped by {self.stopped_by} at {self._moment}{why}"

    @property
    def _moment(self) -> str:
        return f"{datetime.fromtimestamp(self.since_ns / 1e9, timezone.utc):%Y-%m-%d %H:%M:%S} UTC"


class Stopped(RosError):
    """The robot is stopped: nothing was sent (`sent` is NO), or sending was interrupted (MAYBE)."""

    def __init__(self, stop_state: StopState, *, sent: Sent = Sent.NO) -> None:
        effect = (
            "This write was refused" if sent is Sent.NO else "This write was interrupted, and may have been carried out"
        )
        super().__init__(f"{stop_state.sentence}. {effect}.", sent=sent)
        self.stop_state = stop_state


class Holder(Struct, frozen=True):
    """Holder of a topic: their name, and the URL of the hold."""

    name: str
    hold: str


class TopicHeld(RosError):
    """An agent holds the topic: nothing else is published on it meanwhile."""

    def __init__(self, topic: str, holder: Holder) -> None:
        super().__init__(f"{topic} is held: change the hold {holder.hold}, or wait for it to end.")
        self.holder = holder


class WriteInterlock:
    """Gate for writes to the robot, closed while it is stopped and in dry runs.

    A stop interrupts writes under way. Only the hold of a topic in `held` publishes to it.
    """

    def __init__(self) -> None:
        self.stop_state: StopState | None = None
        self.held: dict[str, Holder] = {}
        """Holders by topic."""
        self.writes = 0
        """Number of writes that have ended, successful or not."""
        self._running: set[_RunningWrite] = set()
        self._loop: asyncio.AbstractEventLoop | None = None

    def engage(self, stop_state: StopState) -> None:
        """Refuse all writes from now on, and interrupt those under way."""
        self.stop_state = stop_state
        for each in self._running:
            each.interrupt()

    def release(self) -> None:
        """Accept writes again."""
        self.stop_state = None

    def require_open(self) -> None:
        """Raise Stopped if the robot is stopped."""
        if self.stop_state is not None:
            raise Stopped(self.stop_state)

    def require_free(self, topic: str) -> None:
        """Raise TopicHeld if an agent holds the topic."""
        holder = self.held.get(topic)
        if holder is not None:
            raise TopicHeld(topic, holder)

    async def run(self, write: Callable[[], Awaitable[_T]]) -> _T:
        """Run a write. Raises Stopped if the robot is stopped before it ends."""
        self.require_open()
        end_dry_run()
        loop = self._loop = self._loop or asyncio.get_running_loop()  # makes a system call before Python 3.12
        task = asyncio.current_task(loop)
        assert task is not None
        running = _RunningWrite(task)
        self._running.add(running)
        try:
            return await write()
        except asyncio.CancelledError:
            if running.is_interrupted and self.stop_state is not None:
                running.resume()
                raise Stopped(self.stop_state, sent=Sent.MAYBE) from None
            raise
        finally:
            self.writes += 1
            self._running.discard(running)

    async def run_always(self, write: Callable[[], Awaitable[_T]]) -> _T:
        """Run a write that must reach the robot even while it is stopped."""
        end_dry_run()
        try:
            return await write()
        finally:
            self.writes += 1


class _RunningWrite:
    """A running write and its task."""

    def __init__(self, task: asyncio.Task[object]) -> None:
        self._task = task
        self.is_interrupted = False

    def interrupt(self) -> None:
        """Interrupt the operation where it waits."""
        if not self.is_interrupted:
            self.is_interrupted = True
            self._task.cancel()

    def resume(self) -> None:
        """Let the task continue, because only its write was cancelled."""
        uncancel = getattr(self._task, "uncancel", None)  # Python 3.11 and later count
        if uncancel is not None:
            uncancel()
