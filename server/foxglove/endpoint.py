"""The endpoint `/foxglove`: checks of the handshake, and one connection from its acceptance to its end."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rosld.adapters.model.foxglove_protocol import SUBPROTOCOLS
from rosld.server.auth.authenticator import UNRESTRICTED, Authenticator
from rosld.server.auth.errors import not_visible
from rosld.server.auth.rules import ANONYMOUS
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.events.delivery import GOING_AWAY, NORMAL, close, handshake_headers
from rosld.server.foxglove.connection import Connection
from rosld.server.foxglove.offers import Offers
from rosld.server.http.problem import Problem
from rosld.server.mcp.transport import Caller, Transport
from rosld.server.robot.session import Session

SEGMENT = "foxglove"


class FoxgloveService:
    """The connections of one server; their writes are requests to the server, sent by `transport`."""

    def __init__(
        self,
        session: Session,
        broadcasters: Broadcasters,
        authenticator: Authenticator | None,
        transport: Transport,
        instance_id: str,
    ) -> None:
        self._broadcasters = broadcasters
        self._authenticator = authenticator
        self._transport = transport
        self._offers = Offers(session, instance_id)
        self.path = f"{session.space.path}{SEGMENT}".encode("ascii")

    async def receiver(self, scope: Scope) -> ASGIApp:
        """Return the application for a WebSocket. Raises Problems: 400, 401, 429, 503."""
        chosen = next((each for each in scope.get("subprotocols", ()) if each in SUBPROTOCOLS), None)
        if chosen is None:
            raise Problem(400, f"Ask for the subprotocol {SUBPROTOCOLS[0]}.")
        self._broadcasters.require_capacity(scope["client"])
        fields = handshake_headers(scope, b"authorization")
        sent, auth = fields[0] if fields else None, UNRESTRICTED
        if self._authenticator is not None:
            auth = await self._authenticator.authenticate(sent)
            if auth.permissions.agent == ANONYMOUS and not auth.permissions.rights.rules:
                raise not_visible(ANONYMOUS)
        program = (*handshake_headers(scope, b"user-agent"), SEGMENT)[0][:200]
        caller = Caller(sent, program, scope["client"])

        async def serve(scope: Scope, receive: Receive, send: Send) -> None:
            await send({"type": "websocket.accept", "subprotocol": chosen})
            connection = Connection(self._offers, self._transport, auth, caller, send)
            has_left = False

            async def read() -> Message:
                nonlocal has_left
                while (message := await receive())["type"] != "websocket.disconnect":
                    if message["type"] == "websocket.receive":
                        await connection.handle(message.get("bytes") or message.get("text") or "")
                has_left = True
                return {"type": "http.disconnect"}

            with self._broadcasters.count_reader(scope):
                ended = await self._broadcasters.run_for_client(connection.run(), read)
            if not has_left:
                code, reason = (NORMAL, "the permissions have changed") if ended else (GOING_AWAY, "the server ends")
                await close(send, code, reason)

        return serve
