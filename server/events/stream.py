"""The event stream of one resource: its present state at once, then each change, no faster than the reader takes it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

from starlette.responses import Response
from starlette.types import Message, Receive, Scope, Send

from rosld.adapters.model import RosError
from rosld.server.errors import problem_of
from rosld.server.events import asked, frame
from rosld.server.events.feed import RETRY_SECONDS, Feed, Feeds, Moment, Sleeper
from rosld.server.events.pace import Pace
from rosld.server.http import problem as problems
from rosld.server.http.problem import Problem
from rosld.server.ldp.resource import Resource
from rosld.server.ldp.state import State

KEEP_ALIVE_SECONDS = 15.0
GONE, PROBLEM = "gone", "problem"
"""The types of the events that tell why there is no state. EventSource's own event is called "error", so these are not.

After `gone` the stream goes on and tells when the resource is there again, as nodes are restarted all the time, and an
EventSource that comes back to a 404 gives up for ever. What is deleted for good (410) ends it.
"""
Headers: TypeAlias = "list[tuple[bytes, bytes]]"
HEADERS: Headers = [
    (b"content-type", f"{asked.EVENT_STREAM}; charset=utf-8".encode("ascii")),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
    (b"vary", b"Accept"),
]


@dataclass(frozen=True, slots=True)
class Telling:
    """How states are told: `render` gives the representation called `variant`, `name` the state part of the ETag."""

    variant: str
    render: Callable[[State], Awaitable[bytes]]
    name: Callable[[State], str]

    async def chunk(self, moment: Moment) -> bytes:
        """The event that tells of a moment: made once for all who read this variant."""
        chunk = moment.chunks.get(self.variant)
        if chunk is None:
            chunk = moment.chunks[self.variant] = await self._event(moment.state)
        return chunk

    async def _event(self, state: State | Problem) -> bytes:
        try:
            if isinstance(state, State):
                return frame.event(await self.render(state), self.name(state))
            problem = state
        except Problem as error:  # this state cannot be told in this format
            problem = error
        name = GONE if problem.status in (404, 410) or problem.status < 400 else PROBLEM
        return frame.event(problems.render(problem).body, name=name)


class EventStream(Response):
    """A response that goes on until its reader leaves, its resource is gone for good, or the server ends."""

    def __init__(
        self, feeds: Feeds, resource: Resource, telling: Telling, rate: float, known: str | None, headers: Headers
    ) -> None:
        self.status_code = 200
        self.body = b""
        self.background = None
        self.raw_headers = [*HEADERS, *headers]
        self._feeds = feeds
        self._resource = resource
        self._telling = telling
        self._pace = Pace(rate)
        self._known = known
        """The state that the reader has, as it says itself."""
        self._spoke = 0.0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        await self._feeds.hold(self._tell(send), receive)
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _tell(self, send: Send) -> None:
        await self._send(send, frame.opening(RETRY_SECONDS))
        try:
            async with self._feeds.following(self._resource) as feed:
                await self._follow(feed, send)
        except (Problem, RosError) as error:
            problem = problem_of(error) if isinstance(error, RosError) else error
            await self._send(send, await self._telling.chunk(Moment("", problem)))

    async def _follow(self, feed: Feed, send: Send) -> None:
        loop = asyncio.get_running_loop()
        sleeper = Sleeper()
        told: Moment | None = None
        version = 0
        with self._alarm(loop, sleeper):
            while True:
                await feed.wait(sleeper, version)
                if feed.version == version:
                    await self._keep_alive(send)
                    continue
                if (seconds := self._pace.wait(time.monotonic())) > 0.0:
                    await asyncio.sleep(seconds)
                version = feed.version
                moment = await feed.look()
                if moment is told:
                    continue
                told = moment
                if not self._is_known(moment):
                    self._pace.passed(time.monotonic())
                    await self._send(send, await self._telling.chunk(moment))
                if isinstance(moment.state, Problem) and moment.state.status == 410:
                    return

    def _is_known(self, moment: Moment) -> bool:
        """Whether the reader had this state before the stream began; asked of the first moment only."""
        known, self._known = self._known, None
        return isinstance(moment.state, State) and asked.is_state(known, self._telling.name(moment.state))

    async def _send(self, send: Send, chunk: bytes) -> None:
        self._spoke = time.monotonic()
        message: Message = {"type": "http.response.body", "body": chunk, "more_body": True}
        await send(message)

    async def _keep_alive(self, send: Send) -> None:
        if time.monotonic() - self._spoke >= KEEP_ALIVE_SECONDS:
            await self._send(send, frame.KEEP_ALIVE)

    @contextlib.contextmanager
    def _alarm(self, loop: asyncio.AbstractEventLoop, sleeper: Sleeper) -> Iterator[None]:
        """Wakes the sleeper when nothing was sent for a while. One timer, not one an event."""
        timer: asyncio.TimerHandle

        def ring() -> None:
            nonlocal timer
            quiet = time.monotonic() - self._spoke
            if quiet >= KEEP_ALIVE_SECONDS:
                sleeper.wake()
                quiet = 0.0
            timer = loop.call_later(KEEP_ALIVE_SECONDS - quiet, ring)

        timer = loop.call_later(KEEP_ALIVE_SECONDS, ring)
        try:
            yield
        finally:
            timer.cancel()
