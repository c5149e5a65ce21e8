"""Audit: every write leaves a receipt, also a refused one, and its answer links to it."""

from __future__ import annotations

from starlette.responses import Response

from rosld.ontology.urls import Space
from rosld.server.auth import enforcement
from rosld.server.auth.agent import ANONYMOUS
from rosld.server.middleware.handler import Handler
from rosld.server.middleware.recorder import Recorder
from rosld.server.rest.exchange import Exchange

ABSENT = frozenset({404, 410})
_REFUSED = frozenset({403, *ABSENT})


class Audit:
    """Records a write when its answer is ready, before it is sent."""

    def __init__(self, next: Handler, recorder: Recorder, space: Space) -> None:
        self._next = next
        self._recorder = recorder
        self._space = space

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does, with a link to the receipt of a write."""
        scope = exchange.request.scope
        response = await self._next(exchange)
        if response.status_code in _REFUSED:
            self._note_refusal(exchange, response.status_code)
        if exchange.audit.is_write:
            id = self._recorder.note(exchange, scope, response)
            headers = response.raw_headers
            if exchange.audit.leads_to_page:
                headers = [
                    (name, _with_receipt(value, id) if name == b"location" else value) for name, value in headers
                ]
            response.raw_headers = [*headers, self._recorder.link(id)]
        return response

    def _note_refusal(self, exchange: Exchange, status: int) -> None:
        """Have a write of a known agent leave a receipt where it was refused for want of rights, or of anything there.

        Of nobody in particular, what is not there leaves none.
        """
        if exchange.agent == ANONYMOUS:
            if status in ABSENT:
                exchange.audit.mark_read_only()
        elif enforcement.is_write(exchange.method, enforcement.location_of(exchange.request.scope, self._space)):
            exchange.audit.begin()


def _with_receipt(location: bytes, id: str) -> bytes:
    """The URL of a page that tells of a receipt."""
    return location + (b"&" if b"?" in location else b"?") + f"receipt={id}".encode("ascii")
