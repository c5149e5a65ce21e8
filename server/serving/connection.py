"""Connections: uvicorn's HTTP/1.1 protocol (RFC 9112) with limits on the input before and between requests."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import NamedTuple

import httptools
import uvicorn
from msgspec import Struct
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import render
from rosld.server.serving.connections import Connections, WebSocketConnection

Headers = Sequence[tuple[bytes, bytes]]
_VERSIONS = ("1.0", "1.1")
LONGEST_TARGET = 0xFFFF
"""Maximum number of bytes of a request target that httptools can split into path and query."""


class RequestHead(NamedTuple):
    """Request line and header fields, the names in lower case."""

    method: bytes
    target: bytes
    version: str
    headers: Headers

    @property
    def size(self) -> int:
        """Number of bytes of the head, without white space around values."""
        line = len(self.method) + len(self.target) + len("  HTTP/1.1\r\n")
        return line + sum(len(name) + len(value) + len(": \r\n") for name, value in self.headers) + len("\r\n")

    @property
    def is_websocket_handshake(self) -> bool:
        """Whether the request opens a WebSocket, and has no body (RFC 6455 4.2.1).

        Java's client states a body of zero bytes.
        """
        names = {name for name, _ in self.headers}
        return (
            self.method == b"GET"
            and self.version == "1.1"
            and [value.strip(b" \t").lower() for value in self._values(b"upgrade")] == [b"websocket"]
            and {b"sec-websocket-key", b"sec-websocket-version"} <= names
            and b"transfer-encoding" not in names
            and set(self._values(b"content-length")) <= {b"0"}
        )

    @property
    def without_upgrade(self) -> bytes:
        """Head without its `Upgrade` fields."""
        lines = [b"%b %b HTTP/%b\r\n" % (self.method, self.target, self.version.encode("ascii"))]
        lines += [b"%b: %b\r\n" % (name, value) for name, value in self.headers if name != b"upgrade"]
        return b"".join((*lines, b"\r\n"))

    def check(self) -> None:
        """Raise the Problem of a request that cannot be read completely or unambiguously."""
        if len(self.target) > LONGEST_TARGET:
            raise Problem(431, f"The request line is longer than {LONGEST_TARGET} bytes.")
        if self.version not in _VERSIONS:
            raise Problem(505, f"HTTP/{self.version} is not supported: send HTTP/1.1.")
        if self.method == b"CONNECT":
            raise Problem(501, "This server is not a proxy: CONNECT is not supported.")
        codings = self._values(b"transfer-encoding")
        if codings and self.version == "1.0":
            raise Problem(400, "An HTTP/1.0 request cannot have a Transfer-Encoding (RFC 9112 6.1).")
        if codings and [coding.strip(b" \t").lower() for coding in codings] != [b"chunked"]:
            named = b", ".join(codings).decode("latin-1")[:200]
            raise Problem(501, f"Only the transfer coding chunked is supported, not {named!r}.")

    def _values(self, name: bytes) -> list[bytes]:
        return [value for each, value in self.headers if each == name]


_FRAMING_RATIO = 16
"""Allowed bytes of chunk sizes, chunk extensions and trailers for each byte of a chunked body.

A byte in a chunk of its own needs five.
"""
LINGER_SECONDS = 2.0
"""Seconds that a client may still send after the response: closing at once would reset it before it is read."""


def _nothing() -> None:
    pass


def _welcome(address: str | None) -> Callable[[], None]:
    return _nothing


def _is_never(method: bytes, path: bytes) -> bool:
    return False


class ConnectionBounds(Struct, frozen=True):
    """Limits of a connection: bytes of a head, seconds to send one, seconds to read what is sent.

    `connect` counts a connection, and `open_websocket` a WebSocket, of the client at an address. They raise a Problem
    if it has too many, and return a function to call when the connection ends. `is_urgent` returns whether a request
    with this method and path is answered even beyond the maximum number of connections.
    """

    head_bytes: int = 64 * 1024
    head_seconds: float = 20.0
    read_seconds: float = 60.0
    connect: Callable[[str | None], Callable[[], None]] = _welcome
    open_websocket: Callable[[str | None], Callable[[], None]] = _welcome
    is_urgent: Callable[[bytes, bytes], bool] = _is_never


class BoundedConfig(uvicorn.Config):
    """Configuration of uvicorn with limits of connections."""

    bounds = ConnectionBounds()
    connections = Connections(3000)


class Connection(HttpToolsProtocol):
    """Connection with limits: too large (431) or too slow (408) heads end it, and errors are RFC 9457 problems.

    An `Upgrade` to anything but a WebSocket is ignored (RFC 9110 7.8): the head is parsed again without it by a new
    parser, which continues with the body. The first parser's results for that head are discarded.
    """

    _bounds = BoundedConfig.bounds
    _head_is_open = True
    _head_size = 0
    _block_size = 0
    """Bytes received last: a head that began within them is not longer."""
    _framing = 0
    """Remaining bytes of framing allowed for the body of this request."""
    _is_handshake = False
    _is_coded = False
    """Whether the head has a transfer coding."""
    _head_timer: asyncio.TimerHandle | None = None
    _read_timer: asyncio.TimerHandle | None = None
    _release: Callable[[], None] = staticmethod(_nothing)
    _is_over = False
    _refusal: Problem | None = None
    """Problem of a connection on which only urgent requests are answered."""
    _ending: Problem | None = None
    """Problem to send after the responses to the current requests."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer for the first request, and count the connection."""
        super().connection_made(transport)
        config = self.config if isinstance(self.config, BoundedConfig) else BoundedConfig
        self._bounds, self._connections = config.bounds, config.connections
        self._head_timer = self.loop.call_later(self._bounds.head_seconds, self._on_head_timeout)
        try:
            self._release = self._bounds.connect(self.client[0] if self.client else None)
        except Problem as problem:
            self._refusal = problem
        if not self._connections.open(self, is_extra=self._refusal is not None):
            self.end_idle()

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the connection after the client has disconnected."""
        self._cancel_head_timer()
        self.resume_writing()
        self._connections.close(self)
        self._leave_bounds()
        super().connection_lost(exc)

    def end_idle(self) -> None:
        """Close this idle connection to make room for another."""
        self._is_over = True
        self.transport.close()

    def data_received(self, data: bytes) -> None:
        """Parse received bytes, within the limits."""
        if self._is_over:
            return
        self._block_size = len(data)
        if self._head_is_open:
            self._head_size += len(data)
        else:
            self._framing -= len(data)
        self._unset_keepalive_if_required()
        try:
            self._parse(data)
        except httptools.HttpParserError as error:
            cause = error.__context__
            unreadable = _UNREADABLE if self._head_is_open else _UNREADABLE_BODY
            self._end(cause if isinstance(cause, Problem) else unreadable)
        if self._head_size or not self._head_is_open:
            self._check_progress()

    def _parse(self, data: bytes) -> None:
        """Parse bytes; heads with an ignored `Upgrade` are parsed again without it."""
        rest: bytes | memoryview = data
        while True:
            try:
                self.parser.feed_data(rest)
                return
            except httptools.HttpParserUpgrade as upgrade:
                rest = memoryview(rest)[upgrade.args[0] :]
            if self._is_handshake:
                self._become_websocket(is_early=len(rest) > 0)
                return
            head = self._head().without_upgrade
            self.parser = httptools.HttpRequestParser(self)
            self.parser.set_dangerous_leniencies(lenient_data_after_close=True)  # as uvicorn's own
            self.parser.feed_data(head)

    def _head(self) -> RequestHead:
        return RequestHead(self.parser.get_method(), self.url, self.parser.get_http_version(), self.headers)

    def _become_websocket(self, *, is_early: bool) -> None:
        if is_early:
            self._end(Problem(400, "Data follows the WebSocket handshake: wait for the response first (RFC 6455 4.1)."))
        else:
            self.handle_websocket_upgrade()

    def _check_progress(self) -> None:
        """Close the connection of a head that is too large or of chunks without content; time other heads."""
        if self._is_over or self._is_handshake or self.transport.is_closing():
            return
        if not self._head_is_open:
            if self._framing < 0:
                self._end(Problem(431, "The chunk extensions and trailers are much larger than the body."))
            elif self._is_answered:  # this body is not read: it must not keep the connection open
                self.timeout_keep_alive_task = self.loop.call_later(
                    self.timeout_keep_alive, self.timeout_keep_alive_handler
                )
            return
        if self._head_size > self._bounds.head_bytes:
            self._end(self._too_large)
        elif self._head_size and self._head_timer is None:
            self._head_timer = self.loop.call_later(self._bounds.head_seconds, self._on_head_timeout)

    @property
    def _too_large(self) -> Problem:
        return Problem(431, f"The request line and the headers are larger than {self._bounds.head_bytes} bytes.")

    @property
    def _is_answered(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def on_response_complete(self) -> None:
        """Continue after the response to a request."""
        is_last = not self.pipeline
        if is_last:
            self._connections.end_request(self)
        super().on_response_complete()
        if is_last and self._ending is not None and not self.transport.is_closing():
            self._send_problem(self._ending)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a field of the head; fields of a trailer section are discarded (RFC 9110 6.5.1)."""
        if not self._head_is_open:
            return
        name = name.lower()
        if name == b"transfer-encoding":
            self._is_coded = True
        elif name == b"expect" and value.lower() == b"100-continue":
            self.expect_100_continue = True
        self.headers.append((name, value))

    def on_headers_complete(self) -> None:
        """Take a complete head; the scope gets the transport, for code that detects silent clients.

        Raises Problems, which the parser passes on as its own error.
        """
        limit, is_upgrade = self._bounds.head_bytes, self.parser.should_upgrade()
        is_large = self._head_size > limit or self._block_size > limit or len(self.url) > LONGEST_TARGET
        if is_upgrade or is_large or self._is_coded or self.parser.get_http_version() != "1.1":
            self._check(self._head())
            if is_upgrade and not self._is_handshake:
                return
        if not self._connections.start_request(self) and not self._is_urgent(self._head()):
            raise self._refusal or _FULL
        self._head_is_open, self._head_size, self._framing, self._is_coded = False, 0, limit, False
        self._cancel_head_timer()
        self.scope["rosld.transport"] = self.transport  # type: ignore[typeddict-unknown-key]
        super().on_headers_complete()

    def _check(self, head: RequestHead) -> None:
        """Check an unusual head, and note whether it opens a WebSocket. Raises a Problem for an invalid one."""
        if head.size > self._bounds.head_bytes:
            raise self._too_large
        head.check()
        if head.version == "1.0":
            self.expect_100_continue = False  # RFC 9110 10.1.1
        self._is_handshake = self.parser.should_upgrade() and self._is_answered and head.is_websocket_handshake

    def _is_urgent(self, head: RequestHead) -> bool:
        return self._bounds.is_urgent(head.method, httptools.parse_url(head.target).path)

    def on_body(self, body: bytes) -> None:
        """Take a part of a body."""
        self._framing += len(body) * (1 + _FRAMING_RATIO)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Take a complete request; the head of the next one follows."""
        if self.parser.should_upgrade():
            return  # the head is parsed again, or there is no next one
        self._head_is_open, self._head_size = True, 0
        super().on_message_complete()

    def _should_upgrade(self) -> bool:
        return self._is_handshake

    def send_400_response(self, msg: str) -> None:
        """Refuse bytes that are not HTTP."""
        self._end(_UNREADABLE)

    def _on_head_timeout(self) -> None:
        self._head_timer = None
        self._end(Problem(408, f"No complete request arrived within {self._bounds.head_seconds:g} s."))

    def pause_writing(self) -> None:
        """Start the timer for a client that reads more slowly than data is sent."""
        super().pause_writing()
        if self._read_timer is None:
            self._read_timer = self.loop.call_later(self._bounds.read_seconds, self._on_read_timeout)

    def resume_writing(self) -> None:
        """Stop the timer after the client has read most of the data."""
        super().resume_writing()
        if self._read_timer is not None:
            self._read_timer.cancel()
            self._read_timer = None

    def _on_read_timeout(self) -> None:
        """Abort the connection of a client that does not read."""
        self._read_timer = None
        self.transport.abort()

    def handle_websocket_upgrade(self) -> None:
        """Hand the connection over to the WebSocket protocol."""
        try:
            close = self._bounds.open_websocket(self.client[0] if self.client else None)
        except Problem as problem:
            self._end(problem)
            return
        release, self._release = self._release, _nothing
        super().handle_websocket_upgrade()
        websocket = self.transport.get_protocol()
        assert isinstance(websocket, WebSocketConnection)
        self._connections.upgrade(self, websocket)
        websocket.count(self._connections, (close, release))

    def _leave_bounds(self) -> None:
        release, self._release = self._release, _nothing
        release()

    def _cancel_head_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _end(self, ending: Problem) -> None:
        """Send a problem after the responses to earlier requests, and close once the client has received it.

        It is also the response to the request with an invalid body, whose application gets a disconnect.
        """
        if self._is_over or self.transport.is_closing():
            return
        self._is_over = True
        self._cancel_head_timer()
        if self._is_answered:
            self._send_problem(ending)
        elif self._head_is_open:
            self._ending = ending
        else:
            self._refuse_body(ending)

    def _refuse_body(self, ending: Problem) -> None:
        """Answer the newest request, whose body is invalid; only close if its response has begun."""
        if self.cycle.response_started:
            self.transport.close()
            return
        self.cycle.disconnected = True
        self.cycle.message_event.set()
        if self.pipeline:
            self.pipeline.popleft()  # it has not reached the application
            self._ending = ending
        else:
            self.flow.resume_reading()  # unread data would reset the connection on closing, and lose the response
            self._send_problem(ending)

    def _send_problem(self, ending: Problem) -> None:
        self._unset_keepalive_if_required()
        self._connections.end_request(self)
        self.transport.write(_response(ending))
        self.transport.write_eof()
        self._head_timer = self.loop.call_later(LINGER_SECONDS, self.transport.close)


_FULL = Problem(
    503,
    "The maximum number of connections is open; this one accepts only POST /stop. Try again later.",
    headers={"Retry-After": "5"},
)
_UNREADABLE = Problem(400, "This is not a valid HTTP request.")
_UNREADABLE_BODY = Problem(400, "The body is not valid chunked encoding (RFC 9112 7.1). Nothing was done.")


def _response(ending: Problem) -> bytes:
    rendered = render(ending)
    headers = {**rendered.headers, "content-length": str(len(rendered.body)), "connection": "close"}
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return f"HTTP/1.1 {ending.status} {ending.title}\r\n{lines}\r\n".encode("latin-1") + rendered.body
