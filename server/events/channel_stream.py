"""Channels over HTTP (StreamingHTTPChannel2023): an endless response of notifications."""

from __future__ import annotations

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.delivery import Delivery
from rosld.server.events.notification_channels import Channel, Channels

LINES = "application/x-ndjson"
"""JSON-LD notifications are a line each; those in Turtle and N-Triples are parts of one document."""


def headers_of(channel: Channel) -> list[tuple[bytes, bytes]]:
    """The headers of the response."""
    accept = channel.terms.accept
    kind = LINES if accept.endswith("json") else f"{accept}; charset=utf-8" if accept.startswith("text/") else accept
    return [
        (b"content-type", kind.encode("ascii")),
        (b"cache-control", b"no-store"),
        (b"x-accel-buffering", b"no"),
    ]


class ChannelStream(Response):
    """The notifications of a channel, until its reader leaves, it ends, or the server does."""

    def __init__(
        self, channels: Channels, broadcasters: Broadcasters, channel: Channel, headers: list[tuple[bytes, bytes]]
    ) -> None:
        self.status_code = 200
        self.body = b""
        self.background = None
        self.raw_headers = [*headers_of(channel), *headers]
        self._channels = channels
        self._broadcasters = broadcasters
        self._channel = channel

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""

        async def sent(chunk: bytes) -> None:
            await send({"type": "http.response.body", "body": chunk, "more_body": True})

        async def told(chunk: bytes) -> None:
            await sent(chunk.rstrip(b"\n") + b"\n")

        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        await sent(b"")
        delivery = Delivery(self._channels, self._broadcasters, self._channel, told, sent)
        with self._broadcasters.count_reader(scope):
            await self._broadcasters.run_for_client(delivery.run(), receive, self._channel.seconds_left)
        await send({"type": "http.response.body", "body": b"", "more_body": False})
