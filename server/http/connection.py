"""Connections: uvicorn's HTTP/1.1 protocol with bounds on what a stranger may send before a request is one."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from rosld.server.http import problem
from rosld.server.http.problem import Problem

HEAD_BYTES = 64 * 1024
HEAD_SECONDS = 20.0
LINGER_SECONDS = 2.0
"""How long a client may go on sending after its answer: closing at once would reset it before it has read why."""


class Connection(HttpToolsProtocol):
    """Ends connections whose request line and headers are too large (431) or too slow (408); says 400 in RFC 9457."""

    _head_is_open = True
    _head_size = 0
    _impatience: asyncio.TimerHandle | None = None
    _is_over = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A client connected, and has a while to say what it wants."""
        super().connection_made(transport)
        self._impatience = self.loop.call_later(HEAD_SECONDS, self._too_slow)

    def connection_lost(self, exc: Exception | None) -> None:
        """The client has gone."""
        self._be_patient()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Bytes came."""
        if self._is_over:
            return
        if self._head_is_open:
            self._head_size += len(data)
        super().data_received(data)
        if self._is_over or not self._head_is_open or not self._head_size or self.transport.is_closing():
            return
        if self._head_size > HEAD_BYTES:
            self._end(Problem(431, f"The request line and the headers are larger than {HEAD_BYTES} bytes."))
        elif self._impatience is None:
            self._impatience = self.loop.call_later(HEAD_SECONDS, self._too_slow)

    def on_headers_complete(self) -> None:
        """The head of a request is there."""
        self._head_is_open, self._head_size = False, 0
        self._be_patient()
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """A request is there; what follows is the head of the next."""
        self._head_is_open, self._head_size = True, 0
        super().on_message_complete()

    def send_400_response(self, msg: str) -> None:
        """What came is no HTTP."""
        self._end(Problem(400, "This is no HTTP request that can be read."))

    def _too_slow(self) -> None:
        self._impatience = None
        self._end(Problem(408, f"No whole request came within {HEAD_SECONDS:g} s."))

    def _be_patient(self) -> None:
        if self._impatience is not None:
            self._impatience.cancel()
            self._impatience = None

    def _end(self, ending: Problem) -> None:
        """Tell why, unless an answer to an earlier request is under way, and close when the client has heard it."""
        if self._is_over or self.transport.is_closing():
            return
        self._is_over = True
        self._be_patient()
        if self.cycle is not None and not self.cycle.response_complete:
            self.transport.close()
            return
        self.transport.write(_response(ending))
        self.transport.write_eof()
        self._impatience = self.loop.call_later(LINGER_SECONDS, self.transport.close)


def _response(ending: Problem) -> bytes:
    rendered = problem.render(ending)
    headers = {**rendered.headers, "content-length": str(len(rendered.body)), "connection": "close"}
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items())
    return f"HTTP/1.1 {ending.status} {ending.title}\r\n{lines}\r\n".encode("latin-1") + rendered.body
