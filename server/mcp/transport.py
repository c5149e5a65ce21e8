"""Requests of tools to the server: in process to the composed application, or over HTTP to a running server.

Both pass the same gate as any other client: host, rights, limits, leases, conditions, receipts.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any, Protocol
from urllib.parse import unquote, urlsplit

from msgspec import Struct
from starlette.types import ASGIApp, Message

from rosld.server.http.problem import one_line
from rosld.server.middleware.audit import CLIENT, REASON

Fields = Sequence[tuple[str, str]]
MAX_BODY = 4 * 1024 * 1024
"""Maximum size of a response that is read; streams end there."""
_ENDLESS = ("text/event-stream", "multipart/")


class Answer(Struct):
    """A response; `body` is None if it is too large, or a stream."""

    status: int
    fields: Sequence[tuple[str, str]]
    body: bytes | None

    def field(self, name: str) -> str | None:
        """Return the first value of a header field (name in lower case), None if it is missing."""
        return next((value for each, value in self.fields if each == name), None)


class Caller(Struct, frozen=True):
    """Sender of a request: its credentials, the name of its program, and its address."""

    authorization: str | None = None
    client: str | None = None
    address: tuple[str, int] | None = None

    def fields(self, reason: str | None, others: Fields) -> list[tuple[str, str]]:
        """Return the header fields of a request, with those for its receipt."""
        words = ((CLIENT, self.client), (REASON, reason))
        fields = [*others, *((name, one_line(value)) for name, value in words if value)]
        return fields if self.authorization is None else [*fields, ("authorization", self.authorization)]


class Transport(Protocol):
    """Sender of requests."""

    async def send(self, caller: Caller, method: str, url: str, fields: Fields, body: bytes = b"") -> Answer:
        """Return the response to a request. Cancellation disconnects."""
        ...


class LocalTransport:
    """Transport within the process, to an ASGI application."""

    def __init__(self, app: ASGIApp, max_body: int = MAX_BODY) -> None:
        self._app = app
        self._max_body = max_body

    async def send(self, caller: Caller, method: str, url: str, fields: Fields, body: bytes = b"") -> Answer:
        parts = urlsplit(url)
        fields = [("host", parts.netloc), ("content-length", str(len(body))), *fields]
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": method,
            "scheme": parts.scheme,
            "path": unquote(parts.path),
            "raw_path": parts.path.encode("ascii"),
            "query_string": parts.query.encode("ascii"),
            "root_path": "",
            "headers": [(name.encode("ascii"), value.encode("utf-8")) for name, value in fields],
            "client": caller.address,
            "server": (parts.hostname, parts.port),
        }
        exchange = _LocalExchange(body, self._max_body)
        await self._app(scope, exchange.receive, exchange.send)
        return exchange.answer()


class _LocalExchange:
    """Sides of one request in process: it disconnects once the response is known to be too long."""

    def __init__(self, body: bytes, max_body: int) -> None:
        self._max_body = max_body
        self._request: bytes | None = body
        self._ended = asyncio.Event()
        self._status = 500
        self._fields: Fields = ()
        self._chunks: list[bytes] = []
        self._size = 0

    async def receive(self) -> Message:
        if self._request is not None:
            body, self._request = self._request, None
            return {"type": "http.request", "body": body, "more_body": False}
        await self._ended.wait()
        return {"type": "http.disconnect"}

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self._status = message["status"]
            self._fields = [
                (name.decode("latin-1").lower(), value.decode("latin-1")) for name, value in message["headers"]
            ]
            if any(name == "content-type" and value.startswith(_ENDLESS) for name, value in self._fields):
                self._size = self._max_body + 1
        elif not self._ended.is_set():
            chunk = message.get("body", b"")
            self._size += len(chunk)
            self._chunks.append(chunk)
        if self._size > self._max_body:
            self._ended.set()

    def answer(self) -> Answer:
        return Answer(self._status, self._fields, None if self._size > self._max_body else b"".join(self._chunks))


class RemoteTransport:
    """Transport over HTTP, with a client of httpx."""

    def __init__(self, client: Any) -> None:
        self._client = client

    async def send(self, caller: Caller, method: str, url: str, fields: Fields, body: bytes = b"") -> Answer:
        sent = [(name.encode("ascii"), value.encode("utf-8")) for name, value in fields]
        async with self._client.stream(method, url, headers=sent, content=body, follow_redirects=False) as response:
            found = [(name.lower(), value) for name, value in response.headers.multi_items()]
            received = bytearray()
            if not (response.headers.get("content-type") or "").startswith(_ENDLESS):
                async for chunk in response.aiter_bytes():
                    received += chunk
                    if len(received) > MAX_BODY:
                        break
                else:
                    return Answer(response.status_code, found, bytes(received))
            return Answer(response.status_code, found, None)
