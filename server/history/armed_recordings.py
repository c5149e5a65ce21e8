"""Recordings that wait for their triggers. They survive a restart if there is a data folder."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncGenerator, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TypeAlias

from msgspec.structs import replace

from rosld.server.auth.rules import Agent
from rosld.server.history.recording_orders import (
    ARMED,
    RecordingNotes,
    RecordingOrder,
    RecordingRefused,
    Trigger,
    order_from_json,
    order_to_json,
)
from rosld.server.receipts.audit import record_step
from rosld.server.runtime.dry_run import end_dry_run
from rosld.server.runtime.tasks import end_tasks

log = logging.getLogger("rosld.history")
MAX_ARMED = 16
"""Maximum number of recordings that wait for triggers."""
_RETRY_SECONDS = 5.0
"""Seconds after which a failed start is retried."""

MayRecord: TypeAlias = Callable[[str], bool]
"""Whether a topic may be recorded."""


class ArmedRecording:
    """A recording that waits for its trigger and has started `count` recordings so far, ordered by `agent`.

    `suspended` is why it does not wait at the moment. `problem` is why the last recording could not be started.
    """

    def __init__(self, name: str, order: RecordingOrder, agent: Agent, count: int = 0) -> None:
        self.name = name
        self.order = order
        self.agent = agent
        self.count = count
        self.suspended: str | None = None
        self.problem: str | None = None
        self.task: asyncio.Task[None] | None = None
        self._logged: str | None = None

    @property
    def trigger(self) -> Trigger:
        """The trigger of the order."""
        assert self.order.trigger is not None, "an armed recording needs a trigger"
        return self.order.trigger

    def suspend(self, why: str | None) -> None:
        """Set why the recording does not wait (None: it waits). A new reason is logged."""
        self.suspended = why
        if why is not None and why != self._logged:
            self._logged = why
            log.warning("the recording %s, ordered by %s, is suspended: %s", self.name, self.agent.name, why)


Occurrences: TypeAlias = Callable[[ArmedRecording], AsyncGenerator[MayRecord, None]]
"""Yields whenever the condition of a recording becomes true, with a predicate of the topics that may be recorded."""


class ArmedRecordings:
    """The recordings that wait for triggers, by name. Belongs to one event loop.

    `begin` starts a recording, and raises RecordingRefused or OSError; `is_free` returns whether a name is unused.
    """

    def __init__(
        self,
        notes: RecordingNotes,
        begin: Callable[[RecordingOrder, MayRecord], object],
        is_free: Callable[[str], bool],
        retry_seconds: float = _RETRY_SECONDS,
    ) -> None:
        self.all: dict[str, ArmedRecording] = {}
        self._notes = notes
        self._begin = begin
        self._is_free = is_free
        self._retry_seconds = retry_seconds
        self._writer = ThreadPoolExecutor(1, "armed-recordings")
        """A single thread, so that notes are written and removed in the order of the calls."""

    @property
    def revision(self) -> tuple[object, ...]:
        """Value that changes with the state of any waiting recording."""
        return tuple(
            (recording.name, recording.count, recording.suspended, recording.problem) for recording in self.all.values()
        )

    def load(self) -> None:
        """Read the stored orders, which wait once `resume` is called. Unreadable ones are logged and skipped."""
        for name, members in self._notes.read(ARMED).items():
            try:
                recording = _from_note(name, members)
            except (KeyError, TypeError, ValueError) as error:
                log.warning("the armed recording %s cannot be read: %s", name, error)
                continue
            if recording.trigger.limit == 1 and not self._is_free(name):
                with contextlib.suppress(OSError):
                    self._notes.remove(ARMED, name)  # rosld ended between the start of the recording and this removal
                continue
            self.all[name] = recording

    def resume(self, occurrences: Occurrences) -> None:
        """Wait for the triggers of stored orders."""
        for recording in self.all.values():
            if recording.task is None:
                self._start(recording, occurrences)

    async def arm(self, name: str, order: RecordingOrder, agent: Agent, occurrences: Occurrences) -> ArmedRecording:
        """Wait for a trigger; store the order in the folder, if any. Raises RecordingRefused, OSError."""
        if len(self.all) >= MAX_ARMED:
            raise RecordingRefused(
                f"{MAX_ARMED} recordings are already waiting for triggers: delete one first", is_conflict=True
            )
        record_step(f"arm the recording {name}")
        end_dry_run()
        recording = self.all[name] = ArmedRecording(name, order, agent)
        try:
            await self._write(recording)
        except BaseException:
            self.all.pop(name, None)
            raise
        if self.all.get(name) is recording:
            self._start(recording, occurrences)
        return recording

    async def disarm(self, name: str) -> bool:
        """Disarm a recording; return whether it existed. Recordings already started continue. Raises OSError."""
        if name not in self.all:
            return False
        record_step(f"disarm the recording {name}")
        end_dry_run()
        recording = self.all.pop(name)
        if recording.task is not None:
            recording.task.cancel()
        await self._remove(name)
        return True

    async def stop(self) -> None:
        """Stop waiting; stored orders stay."""
        tasks = [recording.task for recording in self.all.values() if recording.task is not None]
        self.all.clear()
        await end_tasks(tasks)
        await asyncio.to_thread(self._writer.shutdown)

    def _start(self, recording: ArmedRecording, occurrences: Occurrences) -> None:
        recording.task = asyncio.get_running_loop().create_task(self._wait(recording, occurrences))

    async def _wait(self, recording: ArmedRecording, occurrences: Occurrences) -> None:
        """Start the recordings of an order until its limit. After a failure, retry every `_RETRY_SECONDS`.

        As at the beginning, a condition that is already true starts a recording.
        """
        while True:
            try:
                if self._has_place(recording) and await self._follow(recording, occurrences):
                    return
            except (RecordingRefused, OSError) as error:
                _fail(recording, f"The recording could not be started: {getattr(error, 'strerror', None) or error}.")
            except Exception as error:  # an unexpected error must not lose the order
                _fail(recording, f"The trigger could not be watched: {type(error).__name__}.", error)
            await asyncio.sleep(self._retry_seconds)

    def _has_place(self, recording: ArmedRecording) -> bool:
        """Whether the order is within the limit. An older release with a higher limit may have stored more."""
        if list(self.all).index(recording.name) < MAX_ARMED:
            return True
        recording.suspend(f"{MAX_ARMED} recordings are already waiting for triggers, the maximum: delete one.")
        return False

    async def _follow(self, recording: ArmedRecording, occurrences: Occurrences) -> bool:
        """Start a recording at each occurrence; return True after the last. Raises what `begin` raises."""
        async with contextlib.aclosing(occurrences(recording)) as found:
            async for may_record in found:
                is_last = self._begin_next(recording, may_record)
                try:
                    await (self._remove(recording.name) if is_last else self._write(recording))
                except OSError as error:
                    log.error("the number of starts of the recording %s cannot be stored: %s", recording.name, error)
                if is_last:
                    return True
        return False

    def _begin_next(self, recording: ArmedRecording, may_record: MayRecord) -> bool:
        """Start the next recording of an order, which is unchanged on failure; return whether it is the last."""
        is_last = recording.count + 1 >= recording.trigger.limit
        previous = dict(self.all)
        if is_last:
            del self.all[recording.name]  # a single recording has the name of its order
        try:
            self._begin(replace(recording.order, name=self._next_name(recording)), may_record)
        except BaseException:
            self.all.clear()
            self.all.update(previous)
            raise
        recording.count += 1
        recording.problem = None
        return is_last

    def _next_name(self, recording: ArmedRecording) -> str:
        if recording.trigger.limit == 1:
            return recording.name
        numbers = range(recording.count + 1, recording.count + 1000)
        names = (f"{recording.name}-{number}" for number in numbers)
        return next(filter(self._is_free, names), f"{recording.name}-{recording.count + 1}")

    async def _write(self, recording: ArmedRecording) -> None:
        await self._in_thread(lambda: self._notes.write(ARMED, recording.name, _to_note(recording)))

    async def _remove(self, name: str) -> None:
        await self._in_thread(lambda: self._notes.remove(ARMED, name))

    async def _in_thread(self, work: Callable[[], None]) -> None:
        """Run work in order on the thread, to the end even if the wait is cancelled."""
        await asyncio.shield(asyncio.get_running_loop().run_in_executor(self._writer, work))


def _fail(recording: ArmedRecording, problem: str, error: Exception | None = None) -> None:
    """Record a failure in its order; repeated failures are logged once."""
    if problem != recording.problem:
        log.error("the recording %s, ordered by %s: %s", recording.name, recording.agent.name, problem, exc_info=error)
    recording.problem = problem


def _to_note(recording: ArmedRecording) -> dict[str, object]:
    agent = {"name": recording.agent.name, "webid": recording.agent.webid}
    return {"order": order_to_json(recording.order), "agent": agent, "count": recording.count}


def _from_note(name: str, members: Mapping[str, object]) -> ArmedRecording:
    """Return the stored order. Raises KeyError, TypeError, ValueError."""
    order, agent, count = members["order"], members["agent"], members["count"]
    if not isinstance(order, dict) or not isinstance(agent, dict) or not isinstance(count, int):
        raise TypeError("its order, its agent or its count is invalid")
    if order.get("trigger") is None:
        raise ValueError("it has no trigger")
    called, webid = agent["name"], agent.get("webid")
    if not isinstance(called, str) or not isinstance(webid, str | None):
        raise TypeError("its agent is invalid")
    return ArmedRecording(name, order_from_json(order), Agent(called, webid), count)
