"""WebSockets: handshakes are checked as requests are, and lead to channels of notifications."""

from __future__ import annotations

import asyncio

from starlette.types import Receive, Scope, Send

from rosld.server.auth.rate_limit import RETRY_SECONDS
from rosld.server.events import websocket
from rosld.server.http.origin import OriginPolicy
from rosld.server.http.problem import Problem
from rosld.server.middleware.rate_limits import Admission
from rosld.server.resources.channels import Notifications


class WebSockets:
    """The ASGI application of WebSockets."""

    def __init__(self, site: OriginPolicy, admission: Admission, notifications: Notifications) -> None:
        self._site = site
        self._admission = admission
        self._notifications = notifications

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a WebSocket, or refuse its handshake with a problem."""
        client = scope["client"]
        if not self._admission.admit_websocket(client[0] if client else None):
            await asyncio.sleep(RETRY_SECONDS)
            await websocket.reject_handshake(
                scope, send, Problem(429, "You open too many WebSockets a second: open fewer.")
            )
            return
        try:
            websocket.check_request(self._site, scope)
            receiver = self._notifications.websocket_receiver(scope)
        except Problem as problem:
            await websocket.reject_handshake(scope, send, problem)
            return
        await receiver(scope, receive, send)
