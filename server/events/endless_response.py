"""Responses that go on until their reader leaves, may not read any more, or the server ends."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable
from typing import TypeAlias

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from rosld.server.events.broadcaster import Broadcasters

Tell: TypeAlias = Callable[[bytes], Awaitable[None]]
"""Sends a part of the body."""
Headers: TypeAlias = "list[tuple[bytes, bytes]]"


class EndlessResponse(Response):
    """A response that counts among the readers of its client's address for as long as it lasts.

    `last_chunk` is what ends the body.
    """

    last_chunk = b""

    def __init__(self, broadcasters: Broadcasters, headers: Headers) -> None:
        self.status_code = 200
        self.body = b""
        self.background = None
        self.raw_headers = headers
        self._broadcasters = broadcasters

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""

        async def tell(chunk: bytes) -> None:
            await send({"type": "http.response.body", "body": chunk, "more_body": True})

        with self._broadcasters.count_reader(scope), self.lasting():
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            await self.run(tell, receive)
        await send({"type": "http.response.body", "body": self.last_chunk, "more_body": False})

    def lasting(self) -> contextlib.AbstractContextManager[object]:
        """What is entered before the response begins, and left before it ends."""
        return contextlib.nullcontext()

    async def run(self, tell: Tell, receive: Receive) -> None:
        """Write the body, until the reader leaves or the server ends."""
        await self._broadcasters.run_for_client(self.write(tell), receive)

    async def write(self, tell: Tell) -> None:
        """Write the body, for as long as the reader may read."""
        raise NotImplementedError
