"""WebSocket connections: uvicorn's protocol, counted among the connections of the server."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from rosld.server.serving.connections import Connections

if TYPE_CHECKING:
    from uvicorn._types import ASGISendEvent

TRY_AGAIN_LATER = 1013
"""Why a connection is closed (RFC 6455 7.4.1, as registered at IANA)."""


class WebSocketConnection(WebSocketsSansIOProtocol):
    """A WebSocket that says when it was last sent something, and that can be ended to make room for others."""

    _connections: Connections | None = None
    _when_lost: Sequence[Callable[[], None]] = ()

    def count(self, connections: Connections, when_lost: Sequence[Callable[[], None]]) -> None:
        """Count it from now on; `when_lost` are called when it has ended."""
        self._connections, self._when_lost = connections, when_lost

    def connection_lost(self, exc: Exception | None) -> None:
        """The client has gone."""
        if self._connections is not None:
            self._connections.close(self)
        for each in self._when_lost:
            each()
        super().connection_lost(exc)

    async def send(self, message: ASGISendEvent) -> None:
        """Send what the application says."""
        if self._connections is not None and not self.disconnected:
            self._connections.note_activity(self)
        await super().send(message)

    def end_idle(self) -> None:
        """Close it: the client is told to try again later."""
        self.stop_keepalive()
        if self.handshake_complete and not self.close_sent and not self.transport.is_closing():
            self.queue.put_nowait({"type": "websocket.disconnect", "code": TRY_AGAIN_LATER})
            self.conn.send_close(TRY_AGAIN_LATER, "room is needed for others")
            self.transport.write(b"".join(self.conn.data_to_send()))
        self.transport.close()
