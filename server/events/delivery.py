"""Delivery of notifications of channels, over HTTP (StreamingHTTPChannel2023) or WebSocket (WebSocketChannel2023)."""

from __future__ import annotations

import asyncio
import time
import uuid

import orjson
from msgspec import Struct
from starlette.types import Message, Receive, Scope, Send

from rosld.ontology.notifications import ACTIVITY_CONTEXT, CONTEXT, Activity, channel_type, with_context
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.server.events.broadcaster import Broadcaster, Broadcasters, Observation, Waiter
from rosld.server.events.event_stream import KEEP_ALIVE_SECONDS, EndlessResponse, Headers, SendChunk, endless_headers
from rosld.server.events.notification_channels import Channel, Channels
from rosld.server.http.origin import OriginPolicy, check_host
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render

_RDF = {"text/turtle": Syntax.TURTLE, "application/n-triples": Syntax.N_TRIPLES}


class Delivery(Struct, eq=False):
    """Sender of a channel's notifications by `send`; calls `idle` after each period without one."""

    channels: Channels
    broadcasters: Broadcasters
    channel: Channel
    send: SendChunk
    idle: SendChunk | None

    async def run(self) -> None:
        """Deliver until the topic is removed permanently, or this is cancelled."""
        with self.channels.attach_receiver(self.channel):
            await self._pause(self.channel.seconds_to_start)
            with self.broadcasters.subscribe(self.channel.resource) as broadcaster:
                await self._follow(broadcaster)

    async def _follow(self, broadcaster: Broadcaster) -> None:
        waiter = Waiter()
        version = 0
        while True:
            if broadcaster.version == version:
                await self._wait(broadcaster, waiter, version)
                if broadcaster.version == version:
                    await self._keep_alive()
                    continue
            await self._pause(self.channel.due - time.monotonic())
            version = broadcaster.version
            observation = broadcaster.current() or await broadcaster.observe()
            may_read = self.channel.auth.is_valid()
            if may_read:
                await self._notify(observation)
            if observation.is_final or not may_read:
                self.channels.close(self.channel)
                return

    async def _notify(self, observation: Observation) -> None:
        channel = self.channel
        news, receiver_state = self.channels.next_notification(channel, observation)
        if news is None:
            channel.last_sent = receiver_state
            return
        chunk = notification(observation, news, channel.terms.accept)
        channel.due = time.monotonic() + channel.terms.interval
        await self.send(chunk)
        channel.last_sent = receiver_state

    async def _wait(self, broadcaster: Broadcaster, waiter: Waiter, version: int) -> None:
        """Wait until the topic may have changed, or the keep-alive time has passed."""
        if self.idle is None:
            await broadcaster.wait(waiter, version)
            return
        timer = asyncio.get_running_loop().call_later(KEEP_ALIVE_SECONDS, waiter.wake)
        try:
            await broadcaster.wait(waiter, version)
        finally:
            timer.cancel()

    async def _pause(self, seconds: float) -> None:
        """Sleep, sending keep-alives."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            await asyncio.sleep(min(left, KEEP_ALIVE_SECONDS))
            if left > KEEP_ALIVE_SECONDS:
                await self._keep_alive()

    async def _keep_alive(self) -> None:
        if self.idle is not None:
            await self.idle(b"\n")


def notification(observation: Observation, activity: Activity, media_type: str) -> bytes:
    """Return the notification of an observation, rendered once for all channels with the same content."""
    key = f"{media_type} {activity}"
    found = observation.chunks.get(key)
    if found is None:
        found = observation.chunks[key] = _write(activity, media_type)
    return found


def _write(news: Activity, media_type: str) -> bytes:
    id, published = uuid.uuid4().urn, time.time_ns() // 1_000_000 * 1_000_000
    syntax = _RDF.get(media_type)
    if syntax is not None:
        return serialize(news.document(id, published), syntax)
    return orjson.dumps(with_context(news.members(id, published), ACTIVITY_CONTEXT, CONTEXT))


LINES = "application/x-ndjson"
"""Media type of JSON-LD notifications, one per line; Turtle and N-Triples notifications form one document."""


def channel_headers(channel: Channel) -> Headers:
    """Return the headers of the response."""
    accept = channel.terms.accept
    kind = LINES if accept.endswith("json") else f"{accept}; charset=utf-8" if accept.startswith("text/") else accept
    return endless_headers(kind)


class ChannelStream(EndlessResponse):
    """Response with the notifications of a channel, until its reader disconnects, it ends, or the server ends."""

    def __init__(self, channels: Channels, broadcasters: Broadcasters, channel: Channel, headers: Headers) -> None:
        super().__init__(broadcasters, [*channel_headers(channel), *headers])
        self._channels = channels
        self._channel = channel

    async def run(self, send_chunk: SendChunk, receive: Receive) -> None:
        async def send_notification(chunk: bytes) -> None:
            await send_chunk(chunk.rstrip(b"\n") + b"\n")

        await send_chunk(b"")
        delivery = Delivery(self._channels, self._broadcasters, self._channel, send_notification, send_chunk)
        await self._broadcasters.run_for_client(delivery.run(), receive, self._channel.seconds_left)


NORMAL, GOING_AWAY, TOO_BIG = 1000, 1001, 1009
"""Close codes (RFC 6455 7.4.1)."""
_CLOCKS_NS = 100_000_000
"""Nanoseconds by which the loop's clock and the wall clock may differ at the end of a channel."""
_MESSAGE_CHARACTERS = 4096
"""Maximum length of a message of a receiver, which is ignored anyway."""
CLOSE_SECONDS = 0.5
"""Seconds that a blocked receiver may delay the close frame."""


def check_origin(site: OriginPolicy, origin: str | None) -> None:
    """Raise a 403 Problem for a page of a foreign origin: browsers let every page open a WebSocket."""
    if origin is None or site.allows_any_origin or origin.lower() in site.origins or origin in site.shared_origins:
        return
    raise Problem(
        403, f"Pages of {origin[:200]!r} may not read this server. To allow it, start the server with --cors-origin."
    )


def handshake_headers(scope: Scope, name: bytes) -> list[str]:
    """Return the values of all fields of one name."""
    return [value.decode("latin-1") for field, value in scope["headers"] if field == name]


def check_request(site: OriginPolicy, scope: Scope) -> None:
    """Raise Problems for a handshake with another host (421), or from a page of a foreign origin (403)."""
    check_host(site, handshake_headers(scope, b"host"))
    origins = handshake_headers(scope, b"origin")
    check_origin(site, origins[0] if origins else None)


async def reject_handshake(scope: Scope, send: Send, problem: Problem) -> None:
    """Answer a handshake with a problem (RFC 6455 4.2.2)."""
    if "websocket.http.response" not in scope.get("extensions", {}):
        await send({"type": "websocket.close", "code": 1008, "reason": problem.title})
        return
    rendered = render(problem)
    headers = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in rendered.headers.items()]
    await send({"type": "websocket.http.response.start", "status": rendered.status, "headers": headers})
    await send({"type": "websocket.http.response.body", "body": rendered.body})


class WebSocketReceiver:
    """WebSocket connection that receives the notifications of a channel."""

    def __init__(self, channels: Channels, broadcasters: Broadcasters, channel: Channel) -> None:
        self._channels = channels
        self._broadcasters = broadcasters
        self._channel = channel
        self._has_left = False

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Accept the connection, and deliver until either side closes it."""
        await send({"type": "websocket.accept", "subprotocol": self._subprotocol(scope)})

        async def send_text(chunk: bytes) -> None:
            await send({"type": "websocket.send", "text": chunk.decode()})

        async def wait_for_disconnect() -> Message:
            while True:
                message = await receive()
                is_too_big = len(message.get("text") or message.get("bytes") or "") > _MESSAGE_CHARACTERS
                if is_too_big:
                    await close(send, TOO_BIG, "what a receiver says is ignored")
                if is_too_big or message["type"] == "websocket.disconnect":
                    self._has_left = True
                    return {"type": "http.disconnect"}

        delivery = Delivery(self._channels, self._broadcasters, self._channel, send_text, None)
        is_done = await self._broadcasters.run_for_client(
            delivery.run(), wait_for_disconnect, self._channel.seconds_left
        )
        if not self._has_left:
            code, reason = self._ending(is_done)
            await close(send, code, reason)

    def _ending(self, is_done: bool) -> tuple[int, str]:
        if is_done:
            return NORMAL, "the topic is permanently gone"
        end = self._channel.terms.end_at
        if end is not None and time.time_ns() >= end - _CLOCKS_NS:
            return NORMAL, "endAt has passed"
        if not self._channels.has(self._channel):
            return NORMAL, "the channel was deleted"
        if self._channel.receiver is not None:
            return NORMAL, "another connection receives from this channel"
        return GOING_AWAY, "the server is shutting down"

    def _subprotocol(self, scope: Scope) -> str | None:
        """Return the name of the channel type if the client offers it: browsers need one of their offers chosen."""
        name = self._channel.terms.type
        known = (name, channel_type(name).value)
        return next((one for one in scope.get("subprotocols", ()) if one in known), None)


async def close(send: Send, code: int, reason: str) -> None:
    """Close a WebSocket; a blocked receiver may delay this by half a second."""
    try:
        await asyncio.wait_for(send({"type": "websocket.close", "code": code, "reason": reason}), CLOSE_SECONDS)
    except (asyncio.TimeoutError, OSError):
        return
