"""Open connections of a server, including WebSockets: their limits, and a reserve for the stop."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

if TYPE_CHECKING:
    from uvicorn._types import ASGISendEvent


RESERVED_CONNECTIONS = 64
"""Number of connections beyond the limit, for requests that are always answered."""
SILENT_SECONDS = 60.0
"""Seconds without output after which a WebSocket may be ended to make room."""


class Endable(Protocol):
    """A connection that can be ended while it is idle."""

    def end_idle(self) -> None:
        """End the connection, with a reason if the protocol has one."""


class Connections:
    """Open connections, at most `limit` and a reserve. Belongs to one loop.

    A new one beyond `limit` replaces the longest idle one: a connection without a current request, or else a WebSocket
    without output for a minute. Otherwise it is placed in the reserve, which replaces idle connections in the same way,
    so that connections without requests cannot fill it.
    """

    def __init__(
        self, limit: int, reserve: int = RESERVED_CONNECTIONS, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock = clock
        self._limit = limit
        self._most_extra = reserve
        self._open: set[Endable] = set()
        self._extra: set[Endable] = set()
        self._idle: OrderedDict[Endable, None] = OrderedDict()
        self._idle_extra: OrderedDict[Endable, None] = OrderedDict()
        self._websockets: OrderedDict[Endable, float] = OrderedDict()

    def __len__(self) -> int:
        return len(self._open) + len(self._extra)

    def open(self, connection: Endable, *, is_extra: bool = False) -> bool:
        """Add a connection, in the reserve if necessary or requested; return False if that is full too."""
        if not is_extra and (len(self._open) < self._limit or self._end_longest_idle()):
            self._open.add(connection)
            self._idle[connection] = None
            return True
        if len(self._extra) >= self._most_extra and not self._end_first(self._idle_extra):
            return False
        self._extra.add(connection)
        self._idle_extra[connection] = None
        return True

    def start_request(self, connection: Endable) -> bool:
        """Record a request in progress; return False if the connection is in the reserve."""
        if connection in self._extra:
            self._idle_extra.pop(connection, None)
            return False
        self._idle.pop(connection, None)
        return True

    def end_request(self, connection: Endable) -> None:
        """Record that the requests on a connection are answered."""
        if connection in self._open:
            idle = self._idle
        elif connection in self._extra:
            idle = self._idle_extra
        else:
            return
        idle[connection] = None
        idle.move_to_end(connection)

    def upgrade(self, connection: Endable, websocket: Endable) -> None:
        """Record that a connection has become a WebSocket."""
        self.close(connection)
        self._open.add(websocket)
        self.note_activity(websocket)

    def note_activity(self, websocket: Endable) -> None:
        """Record output on a WebSocket."""
        self._websockets[websocket] = self._clock()
        self._websockets.move_to_end(websocket)

    def close(self, connection: Endable) -> None:
        """Record that a connection has ended, or will at once."""
        self._open.discard(connection)
        self._extra.discard(connection)
        self._idle.pop(connection, None)
        self._idle_extra.pop(connection, None)
        self._websockets.pop(connection, None)

    def _end_longest_idle(self) -> bool:
        if self._end_first(self._idle):
            return True
        since = next(iter(self._websockets.values()), None)
        if since is None or self._clock() - since < SILENT_SECONDS:
            return False
        return self._end_first(self._websockets)

    def _end_first(self, connections: OrderedDict[Endable, None] | OrderedDict[Endable, float]) -> bool:
        first = next(iter(connections), None)
        if first is None:
            return False
        self.close(first)
        first.end_idle()
        return True


TRY_AGAIN_LATER = 1013
"""Close code (RFC 6455 7.4.1, as registered at IANA)."""


class WebSocketConnection(WebSocketsSansIOProtocol):
    """A WebSocket that records its output, and can be ended to make room for others."""

    _connections: Connections | None = None
    _when_lost: Sequence[Callable[[], None]] = ()

    def count(self, connections: Connections, when_lost: Sequence[Callable[[], None]]) -> None:
        """Count the WebSocket from now on, and call `when_lost` at its end."""
        self._connections, self._when_lost = connections, when_lost

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the connection after the client has disconnected."""
        if self._connections is not None:
            self._connections.close(self)
        for each in self._when_lost:
            each()
        super().connection_lost(exc)

    async def send(self, message: ASGISendEvent) -> None:
        """Send a message of the application."""
        if self._connections is not None and not self.disconnected:
            self._connections.note_activity(self)
        await super().send(message)

    def end_idle(self) -> None:
        """Close the WebSocket, asking the client to try again later."""
        self.stop_keepalive()
        if self.handshake_complete and not self.close_sent and not self.transport.is_closing():
            self.queue.put_nowait({"type": "websocket.disconnect", "code": TRY_AGAIN_LATER})
            self.conn.send_close(TRY_AGAIN_LATER, "closed to make room for others")
            self.transport.write(b"".join(self.conn.data_to_send()))
        self.transport.close()
