"""Event streams (WHATWG HTML 9.2): event frames, and the changes of a resource as an endless response."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Hashable, Iterator
from typing import TypeAlias

from msgspec import Struct
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.auth.rate_limit import TokenBucket
from rosld.server.events import query_params
from rosld.server.events.broadcaster import RETRY_SECONDS, Broadcaster, Broadcasters, Observation, Waiter
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.rest.resource import Resource
from rosld.server.rest.state import MessageState, State

SendChunk: TypeAlias = Callable[[bytes], Awaitable[None]]
"""Function that sends a part of the body."""
Headers: TypeAlias = "list[tuple[bytes, bytes]]"


class EndlessResponse(Response):
    """A response that counts as a reader at its client's address as long as it lasts.

    `last_chunk` ends the body.
    """

    last_chunk = b""

    def __init__(self, broadcasters: Broadcasters, headers: Headers) -> None:
        self.status_code = 200
        self.body = b""
        self.background = None
        self.raw_headers = headers
        self._broadcasters = broadcasters

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response."""

        async def send_chunk(chunk: bytes) -> None:
            await send({"type": "http.response.body", "body": chunk, "more_body": True})

        with self._broadcasters.count_reader(scope), self.lasting():
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            await self.run(send_chunk, receive)
        await send({"type": "http.response.body", "body": self.last_chunk, "more_body": False})

    def lasting(self) -> contextlib.AbstractContextManager[object]:
        """Return the context manager around the response."""
        return contextlib.nullcontext()

    async def run(self, send_chunk: SendChunk, receive: Receive) -> None:
        """Write the body, until the reader disconnects or the server ends."""
        await self._broadcasters.run_for_client(self.write(send_chunk), receive)

    async def write(self, send_chunk: SendChunk) -> None:
        """Write the body, as long as the reader is permitted to read."""
        raise NotImplementedError


def endless_headers(media_type: str) -> Headers:
    """Return the headers of an endless response, which neither caches nor proxies may hold back."""
    media = (b"content-type", media_type.encode("ascii"))
    return [media, (b"cache-control", b"no-store"), (b"x-accel-buffering", b"no")]


KEEP_ALIVE_COMMENT = b":\n\n"
"""Comment that keeps proxies from closing an idle stream (WHATWG HTML 9.2.7)."""


def opening_frame(retry_seconds: float) -> bytes:
    """Return the first bytes of a stream: the time after which a disconnected client reconnects."""
    return b"retry: %d\n\n" % round(retry_seconds * 1000)


def skipped_comment(count: int) -> bytes:
    """Return the comment with the number of messages skipped before an event."""
    return b": skipped %d\n" % count


def event_frame(data: bytes, id: str | None = None, name: str | None = None) -> bytes:
    """Return the frame of an event. Clients send `id` back as Last-Event-ID; `name` is its type (default "message").

    Raises ValueError for an id or a name that would end its line.
    """
    lines = []
    for field, value in (("event", name), ("id", id)):
        if value is not None:
            if not value.isprintable():
                raise ValueError(f"{value!r} is not a valid {field} of an event")
            lines.append(f"{field}: {value}".encode())
    lines += [b"data: " + line for line in data.splitlines() or [b""]]
    return b"\n".join(lines) + b"\n\n"


KEEP_ALIVE_SECONDS = 15.0


class EventWriter:
    """Writer of an event stream. `quiet`: seconds without an event after which a keep-alive is due."""

    def __init__(self, send_chunk: SendChunk, quiet: float = KEEP_ALIVE_SECONDS) -> None:
        self.quiet = quiet
        self._send_chunk = send_chunk
        self._last_write = time.monotonic()

    @property
    def silence(self) -> float:
        """Seconds since the last write."""
        return time.monotonic() - self._last_write

    async def open(self) -> None:
        """Write the opening frame."""
        await self.send(opening_frame(RETRY_SECONDS))

    async def send(self, chunk: bytes) -> None:
        """Write a frame."""
        self._last_write = time.monotonic()
        await self._send_chunk(chunk)

    async def keep_alive(self) -> None:
        """Write a keep-alive comment if it is due."""
        if self.silence >= self.quiet:
            await self.send(KEEP_ALIVE_COMMENT)


BURST = 1.25
"""Capacity of the token bucket of a slow stream, in events: one may be a quarter of an interval early.

So the jitter of a topic exactly as fast as the requested rate neither delays nor drops a value. In any time t at most
rate * t + 1.25 events pass, plus those of `JITTER_SECONDS`.
"""
JITTER_SECONDS = 0.05
"""Seconds that a message may be late; the following ones may then exceed the rate."""
GONE, PROBLEM, UNTIL = "gone", "problem", "until"
"""Types of the events without a state; "error" is avoided because it is EventSource's own event.

After `gone` the stream continues, and reports when the resource exists again, because nodes are often restarted and an
EventSource that reconnects to a 404 gives up for ever. Permanent removal (410) ends the stream. `until` is the last
event of a stream with a condition: whether it is true for the last state, or the time is over.
"""
HEADERS: Headers = [*endless_headers(f"{query_params.EVENT_STREAM}; charset=utf-8"), (b"vary", b"Accept")]


def _always() -> bool:
    return True


def _constant_version() -> Hashable:
    return None


def _unredacted(problem: Problem) -> Problem:
    return problem


class StreamFormat(Struct, frozen=True):
    """Format of states: `render` returns the representation `variant`, `name` the state part of the ETag."""

    variant: str
    render: Callable[[State], Awaitable[bytes]]
    name: Callable[[State], str]
    is_valid: Callable[[], bool] = _always
    """Whether the reader is still permitted to read."""
    redact_problem: Callable[[Problem], Problem] = _unredacted
    """Function that removes from a problem what the reader may not see."""
    version: Callable[[], Hashable] = _constant_version
    """Version of the other content of an event: every page shows whether the robot is stopped, for example."""

    async def chunk(self, observation: Observation) -> bytes:
        """Return the event of an observation, rendered once for all readers of this variant."""
        key = self.variant, self.version()
        chunk = observation.chunks.get(key)
        if chunk is None:
            chunk = observation.chunks[key] = await self._event(observation.state)
        return chunk

    async def _event(self, state: State | Problem) -> bytes:
        try:
            if isinstance(state, State):
                return event_frame(await self.render(state), self.name(state))
            problem = state
        except Problem as error:  # this state has no representation in this format
            problem = error
        problem = self.redact_problem(problem)
        name = GONE if problem.status in (404, 410) or problem.status < 400 else PROBLEM
        return event_frame(render(problem).body, name=name)


class StreamEnd(Struct, frozen=True):
    """End of a stream: once `holds` returns True (it may raise Problems), or after some seconds."""

    holds: Callable[[State], bool]
    seconds: float | None


class EventStream(EndlessResponse):
    """States of one resource, until the reader disconnects, the resource is permanently removed, or the server ends."""

    def __init__(
        self,
        broadcasters: Broadcasters,
        resource: Resource,
        stream_format: StreamFormat,
        rate: float,
        known: str | None,
        headers: Headers,
        lease: contextlib.AbstractContextManager[float | None],
        end: StreamEnd | None = None,
    ) -> None:
        """Initialize; `lease` is entered as long as the stream lasts, and yields the seconds between keep-alives."""
        super().__init__(broadcasters, [*HEADERS, *headers])
        self._resource = resource
        self._stream_format = stream_format
        self._bucket = TokenBucket(rate, BURST + rate * JITTER_SECONDS)
        self._known = known
        """State that the reader has, according to its request."""
        self._lease = lease
        self._end = end
        self._quiet = KEEP_ALIVE_SECONDS

    @contextlib.contextmanager
    def lasting(self) -> Iterator[None]:
        with self._lease as seconds:
            self._quiet = seconds or KEEP_ALIVE_SECONDS
            yield

    async def run(self, send_chunk: SendChunk, receive: Receive) -> None:
        seconds = None if self._end is None else self._end.seconds
        is_done = await self._broadcasters.run_for_client(self.write(send_chunk), receive, seconds)
        if seconds is not None and not is_done:
            await send_chunk(event_frame(b"false", name=UNTIL))

    async def write(self, send_chunk: SendChunk) -> None:
        writer = EventWriter(send_chunk, self._quiet)
        await writer.open()
        with self._broadcasters.subscribe(self._resource) as broadcaster:
            await self._follow(broadcaster, writer)

    async def _follow(self, broadcaster: Broadcaster, writer: EventWriter) -> None:
        waiter = Waiter()
        # Read before the state: a change meanwhile then has another version, and is not missed.
        version = broadcaster.version
        latest, format_version = await broadcaster.observe(), self._stream_format.version()
        if not self._is_known(latest.state):
            await self._event(writer, latest)
        with _alarm(waiter, writer):
            while not (latest.is_final or await self._is_over(writer, latest.state)):
                await broadcaster.wait(waiter, version)
                if not self._stream_format.is_valid():
                    return
                if broadcaster.version == version:
                    await writer.keep_alive()
                    continue
                if (seconds := self._bucket.wait(time.monotonic())) > 0.0 and not await self._may_end(broadcaster):
                    await asyncio.sleep(seconds)
                version = broadcaster.version
                observation = broadcaster.current() or await broadcaster.observe()
                if not self._stream_format.is_valid():  # once more: the rights may have ended while it waited or read
                    return
                if observation is not latest or self._stream_format.version() != format_version:
                    skipped = _skipped(latest.state, observation.state)
                    latest, format_version = observation, self._stream_format.version()
                    await self._event(writer, observation, skipped)

    async def _may_end(self, broadcaster: Broadcaster) -> bool:
        """Whether this state may end the stream, and so must be sent without delay."""
        if self._end is None:
            return False
        state = (broadcaster.current() or await broadcaster.observe()).state
        try:
            return isinstance(state, State) and self._end.holds(state)
        except Problem:
            return True

    async def _is_over(self, writer: EventWriter, state: State | Problem) -> bool:
        if self._end is None or not isinstance(state, State):
            return False
        try:
            if not self._end.holds(state):
                return False
        except Problem as problem:
            await writer.send(event_frame(render(self._stream_format.redact_problem(problem)).body, name=PROBLEM))
            return True
        await writer.send(event_frame(b"true", name=UNTIL))
        return True

    def _is_known(self, state: State | Problem) -> bool:
        """Whether the reader already has this state, according to its request."""
        return isinstance(state, State) and query_params.is_state(self._known, self._stream_format.name(state))

    async def _event(self, writer: EventWriter, observation: Observation, skipped: int = 0) -> None:
        chunk = await self._stream_format.chunk(observation)
        self._bucket.take(time.monotonic())
        if skipped:
            await writer.send(skipped_comment(skipped))
        await writer.send(chunk)


def _skipped(before: State | Problem, after: State | Problem) -> int:
    """Return the number of messages between two states that are sent one after the other."""
    if not isinstance(before, MessageState) or not isinstance(after, MessageState):
        return 0
    known = {(publisher, epoch): sequence for publisher, epoch, sequence in before.messages}
    return sum(
        max(sequence - known.get((publisher, epoch), sequence) - 1, 0) for publisher, epoch, sequence in after.messages
    )


@contextlib.contextmanager
def _alarm(waiter: Waiter, writer: EventWriter) -> Iterator[None]:
    """Wake the waiter after a period without a write, with one timer instead of one per event."""
    loop = asyncio.get_running_loop()
    timer: asyncio.TimerHandle

    def ring() -> None:
        nonlocal timer
        silence = writer.silence
        if silence >= writer.quiet:
            waiter.wake()
            silence = 0.0
        timer = loop.call_later(writer.quiet - silence, ring)

    timer = loop.call_later(writer.quiet, ring)
    try:
        yield
    finally:
        timer.cancel()
