"""Channels over WebSocket (WebSocketChannel2023, RFC 6455): one text message a notification, nothing is read.

The server (uvicorn) pings, answers pings, and ends connections that do not answer.
"""

from __future__ import annotations

import asyncio
import time

from starlette.types import Message, Receive, Scope, Send

from rosld.ontology.notifications import channel_type
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.delivery import Delivery
from rosld.server.events.notification_channels import Channel, Channels
from rosld.server.http.origin import OriginPolicy, check_host
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render

NORMAL, GOING_AWAY = 1000, 1001
"""Why a connection is closed (RFC 6455 7.4.1)."""
_CLOCKS_NS = 100_000_000
"""How far the loop's clock and the wall's may be apart when the loop says that the time has come."""
CLOSE_SECONDS = 0.5
"""How long a receiver that takes nothing may keep the server from saying why it closes."""


def check_origin(site: OriginPolicy, origin: str | None) -> None:
    """Raises a 403 Problem for a page that nothing is shared with: browsers let every page open a WebSocket."""
    if origin is None or site.allows_any_origin or origin.lower() in site.origins or origin in site.shared_origins:
        return
    raise Problem(
        403, f"Pages of {origin[:200]!r} may not read here. To let them, start the server with --cors-origin."
    )


def headers_of(scope: Scope, name: bytes) -> list[str]:
    """The values of all fields of one name."""
    return [value.decode("latin-1") for field, value in scope["headers"] if field == name]


def check_request(site: OriginPolicy, scope: Scope) -> None:
    """Raises Problems for a handshake that names another server (421), or is a page's that nothing is shared with."""
    check_host(site, headers_of(scope, b"host"))
    origins = headers_of(scope, b"origin")
    check_origin(site, origins[0] if origins else None)


async def reject_handshake(scope: Scope, send: Send, problem: Problem) -> None:
    """Answer a handshake with a problem instead (RFC 6455 4.2.2)."""
    if "websocket.http.response" not in scope.get("extensions", {}):
        await send({"type": "websocket.close", "code": 1008, "reason": problem.title})
        return
    rendered = render(problem)
    headers = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in rendered.headers.items()]
    await send({"type": "websocket.http.response.start", "status": rendered.status, "headers": headers})
    await send({"type": "websocket.http.response.body", "body": rendered.body})


class WebSocketReceiver:
    """One connection that receives from a channel."""

    def __init__(self, channels: Channels, broadcasters: Broadcasters, channel: Channel) -> None:
        self._channels = channels
        self._broadcasters = broadcasters
        self._channel = channel
        self._has_left = False

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Accept the connection, and deliver until one of both goes."""
        await send({"type": "websocket.accept", "subprotocol": self._subprotocol(scope)})

        async def said(chunk: bytes) -> None:
            await send({"type": "websocket.send", "text": chunk.decode()})

        async def heard() -> Message:
            while True:
                if (await receive())["type"] == "websocket.disconnect":
                    self._has_left = True
                    return {"type": "http.disconnect"}

        delivery = Delivery(self._channels, self._broadcasters, self._channel, said, None)
        is_done = await self._broadcasters.run_for_client(delivery.run(), heard, self._channel.seconds_left)
        if not self._has_left:
            code, reason = self._ending(is_done)
            await _closed(send, code, reason)

    def _ending(self, is_done: bool) -> tuple[int, str]:
        if is_done:
            return NORMAL, "the topic is gone for good"
        end = self._channel.terms.end_at
        if end is not None and time.time_ns() >= end - _CLOCKS_NS:
            return NORMAL, "endAt has passed"
        if not self._channels.has(self._channel):
            return NORMAL, "the channel was deleted"
        if self._channel.receiver is not None:
            return NORMAL, "another connection receives from this channel"
        return GOING_AWAY, "the server is ending"

    def _subprotocol(self, scope: Scope) -> str | None:
        """The name of the channel type, where it is offered: a browser that offers some wants one of them chosen."""
        name = self._channel.terms.type
        known = (name, channel_type(name).value)
        return next((one for one in scope.get("subprotocols", ()) if one in known), None)


async def _closed(send: Send, code: int, reason: str) -> None:
    try:
        await asyncio.wait_for(send({"type": "websocket.close", "code": code, "reason": reason}), CLOSE_SECONDS)
    except (asyncio.TimeoutError, OSError):
        return
