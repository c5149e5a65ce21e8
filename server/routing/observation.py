"""Observation of a resource: long polling (`?after=`, `?until=`), event streams, and motion streams of pictures."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from functools import partial

from msgspec import Struct
from msgspec.structs import replace
from starlette.responses import Response

from rosld.server.auth import enforcement
from rosld.server.auth.errors import invalid_token
from rosld.server.auth.redaction import redact_problem
from rosld.server.events import query_params
from rosld.server.events.broadcaster import Broadcasters, Waiter
from rosld.server.events.event_stream import (
    HEADERS,
    EndlessResponse,
    EventStream,
    SendChunk,
    StreamEnd,
    StreamFormat,
    endless_headers,
)
from rosld.server.events.long_poll import Until, wait_for_state
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import HTML, VARIANTS
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Motion, Resource
from rosld.server.rest.responses import RawResponse, resource_headers
from rosld.server.rest.state import State
from rosld.server.routing.representations import Representations, encode_headers, event_media_type, redacted_state

_BOUNDARY = "rosld-picture"
MEDIA_TYPE = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"


class Pace(Struct):
    """Limit of one picture per interval of 1/`rate` seconds; the intervals of all readers are aligned.

    So readers with low rates get the same pictures, which are drawn only once.
    """

    rate: float
    _last: int = -1

    def wait(self, now: float) -> float:
        """Return the seconds until the next picture may be sent, 0.0 if one may be sent now."""
        interval = math.floor(now * self.rate)
        return 0.0 if interval > self._last else max(0.001, (self._last + 1) / self.rate - now)

    def take(self, now: float) -> None:
        """Record that a picture is sent in this interval."""
        self._last = math.floor(now * self.rate)


class MotionStream(EndlessResponse):
    """Pictures of one motion, until the reader disconnects, loses its rights, or the server ends.

    A reader gets the newest picture after it has received the previous one; a slow reader skips pictures. Equal
    pictures are drawn once for all readers, and only if a reader receives them.
    """

    last_chunk = f"\r\n--{_BOUNDARY}--\r\n".encode("ascii")

    def __init__(
        self,
        broadcasters: Broadcasters,
        motion: Motion,
        rate: float,
        headers: list[tuple[bytes, bytes]],
        is_valid: Callable[[], bool],
    ) -> None:
        own = [(b"x-content-type-options", b"nosniff"), (b"vary", b"Accept")]
        super().__init__(broadcasters, [*endless_headers(MEDIA_TYPE), *own, *headers])
        self._motion = motion
        self._pace = Pace(rate)
        self._is_valid = is_valid

    async def write(self, send_chunk: SendChunk) -> None:
        waiter, is_new = Waiter(), True

        def wake() -> None:
            nonlocal is_new
            is_new = True
            waiter.wake()

        watch = await self._motion.watch(wake)
        try:
            part = f"--{_BOUNDARY}\r\nContent-Type: {self._motion.media_type}\r\n\r\n".encode("ascii")
            await send_chunk(part)
            while True:
                if not is_new:
                    await waiter.sleep()
                if not self._is_valid():
                    return
                if (seconds := self._pace.wait(time.monotonic())) > 0.0:
                    await asyncio.sleep(seconds)
                is_new = False
                picture = await self._motion.newest()
                if picture is None or not self._is_valid():
                    continue
                self._pace.take(time.monotonic())
                # The head of the next part is sent along: browsers show a picture when they have read that.
                await send_chunk(b"".join((picture, b"\r\n", part)))
        finally:
            watch.close()


class Observation:
    """Responses that stay open until a resource changes, or as long as it is read."""

    def __init__(self, representations: Representations, broadcasters: Broadcasters, pages: PageRenderer) -> None:
        self._representations = representations
        self._broadcasters = broadcasters
        self._pages = pages

    async def wait_until(self, exchange: Exchange, resource: Resource, state: State) -> tuple[State, bool]:
        """Wait for the condition of `?until=`; return the final state and whether it is true (False after `?timeout=`).

        Raises a 401 Problem if the agent's rights have ended meanwhile.
        """
        until, seconds = self._until(exchange, resource), query_params.parse_timeout(exchange.query)
        after = exchange.query.get("after")

        def is_wanted(found: State) -> bool:
            return until.holds(found) and not query_params.is_state(after, self._representations.name(found))

        if is_wanted(state):
            return state, True
        found = await wait_for_state(self._broadcasters, resource, is_wanted, exchange.request, seconds)
        if not exchange.auth.is_valid():
            raise invalid_token("Your permissions have changed.")
        if isinstance(found, Problem):
            raise found
        return (found, True) if found is not None else (await resource.state(), False)

    async def wait_for_another(self, exchange: Exchange, resource: Resource, state: State) -> None:
        """Wait until the state differs from that of `?after=`, at most for `?timeout=`. Raises Problems."""
        after, seconds = exchange.query["after"], query_params.parse_timeout(exchange.query)
        if query_params.is_state(after, self._representations.name(state)):

            def is_another(found: State) -> bool:
                return not query_params.is_state(after, self._representations.name(found))

            await wait_for_state(self._broadcasters, resource, is_another, exchange.request, seconds)

    async def stream(self, exchange: Exchange, resource: Resource) -> Response:
        """Return the changes of a resource as an event stream (WHATWG HTML 9.2). Raises Problems before it begins."""
        media_type = event_media_type(exchange)
        rate = query_params.parse_rate(exchange.query)

        notices = self._representations.receipt_notices(exchange, media_type)

        async def render(state: State) -> bytes:
            return (
                await self._representations.represent(resource, state, media_type, exchange.permissions, notices)
            ).body

        first, until, seconds = await resource.state(), None, None
        await render(first)
        if "until" in exchange.query:
            until = self._until(exchange, resource)
            until.holds(first)  # raises its Problems
            seconds = query_params.parse_timeout(exchange.query) if "timeout" in exchange.query else None
        self._broadcasters.require_capacity(exchange.request.client)
        headers = encode_headers(resource_headers(resource))
        if exchange.method == "HEAD":
            return RawResponse(200, b"", [*HEADERS, *headers])
        mark = exchange.permissions.cache_key if media_type == HTML else ""
        texts = "".join(notice.text for notice in notices)
        variant = f"{VARIANTS[media_type]}-{exchange.permissions.rights_key}{mark}{texts}"
        redact = partial(
            redact_problem,
            permissions=exchange.permissions,
            place=enforcement.location_of(exchange.request.scope, self._pages.space),
        )
        stream_format = StreamFormat(variant, render, self._representations.name, exchange.auth.is_valid, redact)
        if media_type == HTML:
            stream_format = replace(stream_format, version=lambda: self._pages.version)
        known, lease = exchange.header("last-event-id"), resource.keep_alive(exchange)
        end = None if until is None else StreamEnd(until.holds, seconds)
        return EventStream(self._broadcasters, resource, stream_format, rate, known, headers, lease, end)

    def motion(self, exchange: Exchange, resource: Resource, motion: Motion) -> Response:
        """Return the pictures of a motion, each replacing the previous one, at the client's speed. Raises Problems."""
        rate = query_params.parse_rate(exchange.query, query_params.MOTION_RATE)
        self._broadcasters.require_capacity(exchange.request.client)
        stream = MotionStream(
            self._broadcasters, motion, rate, encode_headers(resource_headers(resource)), exchange.auth.is_valid
        )
        return RawResponse(200, b"", stream.raw_headers) if exchange.method == "HEAD" else stream

    def _until(self, exchange: Exchange, resource: Resource) -> Until:
        return Until(exchange.query["until"], partial(redacted_state, resource, permissions=exchange.permissions))
