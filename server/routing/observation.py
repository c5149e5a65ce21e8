"""Changes of a resource: long polling (`?after=`, `?until=`) and event streams."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from starlette.responses import Response

from rosld.server.auth import enforcement
from rosld.server.auth.errors import invalid_token
from rosld.server.auth.redaction import redact_problem
from rosld.server.events import query_params
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.event_stream import HEADERS, EventStream, StreamEnd, StreamFormat
from rosld.server.events.long_poll import Until, wait_for_state
from rosld.server.events.motion_stream import MotionStream
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import HTML, VARIANTS
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Motion, Resource
from rosld.server.rest.responses import RawResponse, resource_headers
from rosld.server.rest.state import State
from rosld.server.routing.representations import Representations, encode_headers, event_media_type, redacted_state


class Observation:
    """Answers requests that stay open until a resource changes, or for as long as somebody looks."""

    def __init__(self, representations: Representations, broadcasters: Broadcasters, pages: PageRenderer) -> None:
        self._representations = representations
        self._broadcasters = broadcasters
        self._pages = pages

    async def wait_until(self, exchange: Exchange, resource: Resource, state: State) -> tuple[State, bool]:
        """The state of which `?until=` holds, once there is one, else the one after `?timeout=`; and whether it holds.

        Raises a 401 Problem where the rights of who asks have ended meanwhile.
        """
        until, seconds = self._until(exchange, resource), query_params.parse_timeout(exchange.query)
        after = exchange.query.get("after")

        def is_wanted(found: State) -> bool:
            return until.holds(found) and not query_params.is_state(after, self._representations.name(found))

        if is_wanted(state):
            return state, True
        found = await wait_for_state(self._broadcasters, resource, is_wanted, exchange.request, seconds)
        if not exchange.auth.is_valid():
            raise invalid_token("Your rights have changed meanwhile.")
        if isinstance(found, Problem):
            raise found
        return (found, True) if found is not None else (await resource.state(), False)

    async def wait_for_another(self, exchange: Exchange, resource: Resource, state: State) -> None:
        """Wait until the state is another than that of `?after=`, at most for `?timeout=`. Raises Problems."""
        after, seconds = exchange.query["after"], query_params.parse_timeout(exchange.query)
        if query_params.is_state(after, self._representations.name(state)):

            def is_another(found: State) -> bool:
                return not query_params.is_state(after, self._representations.name(found))

            await wait_for_state(self._broadcasters, resource, is_another, exchange.request, seconds)

    async def stream(self, exchange: Exchange, resource: Resource) -> Response:
        """The changes of a resource as an event stream (WHATWG HTML 9.2). Raises Problems, all before it begins."""
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
            until.holds(first)  # for what it refuses
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
        """The pictures of a motion, each replacing the one before, as fast as the client reads. Raises Problems."""
        rate = query_params.parse_rate(exchange.query, query_params.MOTION_RATE)
        self._broadcasters.require_capacity(exchange.request.client)
        stream = MotionStream(
            self._broadcasters, motion, rate, encode_headers(resource_headers(resource)), exchange.auth.is_valid
        )
        return RawResponse(200, b"", stream.raw_headers) if exchange.method == "HEAD" else stream

    def _until(self, exchange: Exchange, resource: Resource) -> Until:
        return Until(exchange.query["until"], partial(redacted_state, resource, permissions=exchange.permissions))
