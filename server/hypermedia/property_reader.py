"""Property reader: the values of properties, read from topics, getters and parameters, cached while they are valid."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, nullcontext, suppress
from itertools import count
from math import inf
from typing import Generic, NamedTuple, TypeAlias, TypeVar
from weakref import WeakValueDictionary

from msgspec import Struct

from rosld.adapters.model import MessageSchema, names
from rosld.server.http.problem import one_line
from rosld.server.hypermedia.catalogue import Getter, GoalSource, ParameterSource, Property, TopicSource, source_url
from rosld.server.hypermedia.source_reader import (
    NO_VALUE,
    ReadResult,
    SourceReader,
    TopicLook,
    decode_value,
    goal_value,
    part_of_goal,
    timeout_message,
)
from rosld.server.hypermedia.value import Reading
from rosld.server.robot.session import Session
from rosld.server.robot.topic_view import TopicView
from rosld.server.runtime.tasks import end_tasks

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

Fetch: TypeAlias = Callable[[Sequence[K]], Awaitable[Mapping[K, V]]]
"""Function that returns the values of all keys and never raises."""

Slot: TypeAlias = "AbstractAsyncContextManager[None]"
"""Context manager in which a fetch runs, such as a semaphore."""

_MAX_ENTRIES = 65536


class CacheEntry(Struct, Generic[V], frozen=True):
    """The result of a fetch that began at turn `started`; valid until the loop time `until`."""

    value: V
    started: int
    until: float


class PendingFetch(Generic[K, V]):
    """A fetch in progress, which continues if its callers stop waiting; `started` is its turn, or 0 if queued."""

    def __init__(self, keys: Sequence[K]) -> None:
        self.keys = keys
        self.started = 0
        self.task: asyncio.Task[Mapping[K, V]]

    async def wait(self, deadline: float) -> Mapping[K, V] | None:
        """Return the values, or None if the fetch does not finish by `deadline` (loop time)."""
        if not self.task.done():
            left = deadline - asyncio.get_running_loop().time()
            await asyncio.wait({self.task}, timeout=max(0.0, left))
        return self.task.result() if self.task.done() and not self.task.cancelled() else None


class SingleFlightCache(Generic[K, V]):
    """Values by key, each valid for `freshness` seconds.

    Every fetch takes a number from `turns` at its start, which orders fetches and callers.
    """

    def __init__(self, freshness: float, turns: Iterator[int]) -> None:
        self._freshness = freshness
        self._turns = turns
        self._entries: dict[K, CacheEntry[V]] = {}
        self._under_way: dict[K, PendingFetch[K, V]] = {}
        self._tasks: set[asyncio.Task[Mapping[K, V]]] = set()

    def find(self, key: K, since: int = 0) -> CacheEntry[V] | None:
        """Return the value if it is valid and its fetch began after the turn `since`."""
        answer = self._entries.get(key)
        if answer is None or answer.started <= since or answer.until <= asyncio.get_running_loop().time():
            return None
        return answer

    def fetch(self, keys: Iterable[K], start: Fetch[K, V], slot: Slot, since: int = 0) -> Sequence[PendingFetch[K, V]]:
        """Return the fetches for all keys: pending ones that begin after `since`, and a new one for the other keys.

        The new one begins once a `slot` is free.
        """
        shared: dict[PendingFetch[K, V], None] = {}
        others = []
        for key in keys:
            pending = self._under_way.get(key)
            if pending is not None and (pending.started == 0 or pending.started > since):
                shared[pending] = None
            else:
                others.append(key)
        if others:
            shared[self._begin(others, start, slot)] = None
        return tuple(shared)

    def invalidate(self, key: K) -> None:
        """Invalidate a value, even while it is being fetched, so that the next read fetches it again."""
        self._entries.pop(key, None)
        pending = self._under_way.get(key)
        if pending is not None and pending.started:
            del self._under_way[key]

    async def stop(self) -> None:
        """Cancel all fetches."""
        await end_tasks(self._tasks)

    def _begin(self, keys: Sequence[K], start: Fetch[K, V], slot: Slot) -> PendingFetch[K, V]:
        pending: PendingFetch[K, V] = PendingFetch(keys)
        pending.task = asyncio.get_running_loop().create_task(self._run(pending, start, slot))
        self._tasks.add(pending.task)
        pending.task.add_done_callback(self._tasks.discard)
        self._under_way.update(dict.fromkeys(keys, pending))
        return pending

    async def _run(self, pending: PendingFetch[K, V], start: Fetch[K, V], slot: Slot) -> Mapping[K, V]:
        answers: Mapping[K, V] = {}
        try:
            async with slot:
                pending.started = next(self._turns)
                answers = await start(pending.keys)
            return answers
        finally:
            self._settle(pending, answers)

    def _settle(self, pending: PendingFetch[K, V], answers: Mapping[K, V]) -> None:
        """Cache the values, except those invalidated meanwhile."""
        until = asyncio.get_running_loop().time() + self._freshness
        for key in pending.keys:
            if self._under_way.get(key) is pending:
                del self._under_way[key]
                if key in answers and self._freshness > 0:
                    self._entries.pop(key, None)
                    self._entries[key] = CacheEntry(answers[key], pending.started, until)
        while len(self._entries) > _MAX_ENTRIES:
            del self._entries[next(iter(self._entries))]


_CALLS = 2
"""Maximum number of concurrent calls of one getter: a second one serves requests that need a newer answer."""
_PARAMETER_CALLS = 4
_MAX_READINGS = 65536


class _Attempt(NamedTuple):
    """A read of some properties: its deadline, its timeout, and the turn that fetches must follow (0 for any)."""

    deadline: float
    seconds: float
    since: int


class _Result(NamedTuple):
    """The result of reading one source, and the loop time until which it is valid; 0.0 if it must not be cached."""

    found: ReadResult
    until: float


class _Kept(Struct):
    """A cached reading: valid until a loop time, and only for the view of its topic or the part of its goal."""

    property: Property
    view: TopicView | None
    part: object
    until: float
    reading: Reading

    def source(self) -> TopicSource | GoalSource | None:
        """Return the source that pushes new values, if any."""
        first = self.property.readers[0] if self.property.readers else None
        return first if isinstance(first, TopicSource | GoalSource) else None


class PropertyReader:
    """Reader of one robot's properties.

    The value of a topic is valid until the next message, that of an action until the next update of its goal; that of a
    getter or a parameter, or a failure, for `freshness` seconds. A call has `call_deadline` seconds, even if its
    callers stop waiting, and is shared by all of them.
    """

    def __init__(self, session: Session) -> None:
        self._topics = session.topics
        self._goals = session.goals
        self._schemas = session.schemas
        self._space = session.space
        freshness = self._freshness = session.settings.freshness
        self._sources = SourceReader(session)
        self._entries: dict[str, _Kept] = {}
        self._silent: set[str] = set()
        self._turns = count(1)
        self._looks: SingleFlightCache[str, TopicLook] = SingleFlightCache(0.0, self._turns)
        self._getters: SingleFlightCache[str, ReadResult] = SingleFlightCache(freshness, self._turns)
        self._parameters: SingleFlightCache[str, ReadResult] = SingleFlightCache(freshness, self._turns)
        self._rooms: WeakValueDictionary[str, asyncio.Semaphore] = WeakValueDictionary()
        self._parameter_room = asyncio.Semaphore(_PARAMETER_CALLS)

    def cached(self, property: Property) -> Reading | None:
        """Return the cached reading if it is still valid, as the same object as before, without I/O."""
        entry = self._entries.get(property.name)
        if entry is None:
            return None
        if entry.property is not property:
            if entry.property != property:
                return None
            entry.property = property  # equal, from another catalogue
        match entry.source():
            case TopicSource(name=topic) if self._topics.find_view(topic) is not entry.view:
                return None
            case GoalSource(name=action) as source:
                goals = self._goals
                if not goals.is_followed(action) or part_of_goal(source, goals.current(action)) is not entry.part:
                    return None
        if entry.until != inf and entry.until <= asyncio.get_running_loop().time():
            return None
        return entry.reading

    async def read(
        self, properties: Sequence[Property], *, deadline: float, refresh: bool = False
    ) -> dict[str, Reading]:
        """Return the readings of properties by name, read concurrently. Never raises; returns by `deadline` (loop).

        `refresh`: call getters and fetch parameters after the start of this call, even if cached values are valid.
        """
        seconds = deadline - asyncio.get_running_loop().time()
        attempt = _Attempt(deadline, seconds, next(self._turns) if refresh else 0)
        readings: dict[str, Reading] = {}
        stored, others = [], []
        for one in properties:
            reading = self._valid_reading(one, attempt.since)
            if reading is not None:
                readings[one.name] = reading
                continue
            entry = self._entries.get(one.name)
            if entry is not None and entry.property != one:
                self.invalidate((one.name,))  # the cached reading has other sources
            if one.readers and isinstance(one.readers[0], ParameterSource):
                stored.append(one)
            else:
                others.append(one)
        if stored or others:
            one_by_one = asyncio.gather(*(self._one(one, attempt) for one in others))
            together, single = await asyncio.gather(self._read_parameters(stored, attempt), one_by_one)
            readings |= together | {one.name: one for one in single}
        return readings

    def invalidate(self, names: Iterable[str]) -> None:
        """Invalidate the readings of these properties, so that later reads fetch them again."""
        for name in names:
            self._entries.pop(name, None)
            self._getters.invalidate(name)
            self._parameters.invalidate(name)

    async def stop(self) -> None:
        """Cancel all pending calls."""
        for answers in (self._looks, self._getters, self._parameters):
            await answers.stop()

    def _valid_reading(self, property: Property, since: int) -> Reading | None:
        """Return the cached reading if it is valid since `since`; pushed values always are."""
        reading = self.cached(property)
        return reading if reading is None or reading.fresh_until is None or not since else None

    async def _one(self, property: Property, attempt: _Attempt) -> Reading:
        """Return the reading of a property, from the first of its sources that has a value."""
        view: TopicView | None = None
        part: object = None
        results: list[_Result] = []
        for reader in property.readers:
            if isinstance(reader, TopicSource):
                view, result = await self._look(reader.name, attempt)
            elif isinstance(reader, Getter):
                result = await self._call(property.name, reader, attempt)
            elif isinstance(reader, GoalSource):
                part, result = await self._read_goal(property.name, reader, attempt)
            else:
                result = (await self._get({property.name: reader.name}, attempt))[property.name]
            if (found := self._valid_reading(property, attempt.since)) is not None:
                return found  # another task waited for the same source
            results.append(result)
            if result.found.value is not None:
                break
        return self._keep(property, view, results, part)

    async def _read_parameters(self, properties: Sequence[Property], attempt: _Attempt) -> dict[str, Reading]:
        """Read the properties that only have parameters, in one request."""
        results = await self._get({one.name: one.readers[0].name for one in properties}, attempt)
        return {
            one.name: self._valid_reading(one, attempt.since) or self._keep(one, None, [results[one.name]])
            for one in properties
        }

    def _keep(
        self, property: Property, view: TopicView | None, results: Sequence[_Result], part: object = None
    ) -> Reading:
        """Return the reading from the results of sources: the value of the last, or the failures of all."""
        found = results[-1].found if results else NO_VALUE
        until = min((one.until for one in results), default=inf) if found.value is None else results[-1].until
        pairs = zip(property.readers, results, strict=False)  # only the last source that is read can have a value
        failed = [(each, one.found) for each, one in pairs if one.found.failure is not None]
        failure, words, about = None, "", tuple[str, ...]()
        if failed and found.value is None:
            failure = "; ".join(str(one.failure) for _, one in failed)
            words = one_line("; ".join(one.words for _, one in failed if one.words))
            about = tuple(source_url(each, self._space) for each, _ in failed)
        fresh_until = None if until == inf else until
        reading = Reading(property.name, found.value, failure, found.read_ns, fresh_until, words or None, about)
        if until > asyncio.get_running_loop().time():
            self._entries.pop(property.name, None)
            self._entries[property.name] = _Kept(property, view, part, until, reading)
            if len(self._entries) > _MAX_READINGS:
                del self._entries[next(iter(self._entries))]
        return reading

    # The sources

    async def _look(self, topic: str, attempt: _Attempt) -> tuple[TopicView | None, _Result]:
        """Return the latest message of a topic, and its view (None if there is no message)."""
        view = self._topics.find_view(topic)
        if view is None and topic in self._silent and self._topics.last_view(topic) is not None:
            return None, self._for_now(NO_VALUE)  # another read has waited for a first message
        schema = self._schemas.find_cached(view.newest.schema) if view is not None and view.newest is not None else None
        failure = None
        if not isinstance(schema, MessageSchema):
            (question,) = self._looks.fetch((topic,), self._read_topics, nullcontext())
            answers = await question.wait(attempt.deadline)
            if answers is None:
                return None, _Result(ReadResult(None, timeout_message(topic, attempt.seconds), None), 0.0)
            view, schema, failure = answers[topic]
        newest = view.newest if view is not None else None
        if newest is None:
            self._silent.add(topic)
            return None, self._for_now(ReadResult(None, failure, None))
        self._silent.discard(topic)
        if not isinstance(schema, MessageSchema):
            return view, self._for_now(ReadResult(None, failure, newest.received_ns))
        found = decode_value(topic, newest, schema, self._space.topic(topic))
        return view, _Result(found, inf) if found.value is not None else self._for_now(found)

    async def _read_goal(self, name: str, source: GoalSource, attempt: _Attempt) -> tuple[object, _Result]:
        """Return the part of the state of an action's goal that the property shows."""
        with suppress(asyncio.TimeoutError, TimeoutError):
            await asyncio.wait_for(self._goals.follow(source.name, deadline=attempt.deadline), attempt.seconds)
        goal = self._goals.current(source.name)
        found = goal_value(source, goal, self._space.url("resources", names.segments(name)))
        return part_of_goal(source, goal), _Result(found, inf)

    def _for_now(self, found: ReadResult) -> _Result:
        return _Result(found, asyncio.get_running_loop().time() + self._freshness)

    async def _read_topics(self, topics: Sequence[str]) -> Mapping[str, TopicLook]:
        return {topic: await self._sources.read_topic(topic) for topic in topics}

    async def _call(self, name: str, getter: Getter, attempt: _Attempt) -> _Result:
        """Return the response of a property's getter."""

        async def ask(keys: Sequence[str]) -> Mapping[str, ReadResult]:
            return {name: await self._sources.call_getter(getter, self._space.url("resources", names.segments(name)))}

        room = self._rooms.setdefault(getter.name, asyncio.Semaphore(_CALLS))
        return (await self._fetch(self._getters, {name: getter.name}, ask, room, attempt))[name]

    async def _get(self, sources: Mapping[str, str], attempt: _Attempt) -> Mapping[str, _Result]:
        """Return the values of parameters, given by the names of their properties."""

        async def ask(keys: Sequence[str]) -> Mapping[str, ReadResult]:
            found = await self._sources.read_parameters([sources[key] for key in keys])
            return {key: found[sources[key]] for key in keys}

        return await self._fetch(self._parameters, sources, ask, self._parameter_room, attempt)

    async def _fetch(
        self,
        answers: SingleFlightCache[str, ReadResult],
        sources: Mapping[str, str],
        ask: Fetch[str, ReadResult],
        room: Slot,
        attempt: _Attempt,
    ) -> Mapping[str, _Result]:
        """Return the results of sources, given by the names of their properties, as far as they arrive in time."""
        found: dict[str, ReadResult] = {}
        unknown = [key for key in sources if answers.find(key, attempt.since) is None]
        for question in answers.fetch(unknown, ask, room, attempt.since):
            found |= await question.wait(attempt.deadline) or {}
        results = {}
        for key, name in sources.items():
            entry = answers.find(key, attempt.since)
            if entry is not None:
                results[key] = _Result(entry.value, entry.until)
            else:
                late_ = ReadResult(None, timeout_message(name, attempt.seconds), None)
                results[key] = _Result(found.get(key, late_), 0.0)
        return results
