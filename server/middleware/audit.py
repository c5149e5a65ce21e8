"""Audit: every write, also a refused one, leaves a receipt that its response links to."""

from __future__ import annotations

import time
from urllib.parse import quote

from starlette.responses import Response
from starlette.types import Scope

from rosld.ontology.urls import Space
from rosld.ontology.vocab import prov
from rosld.server.auth import enforcement
from rosld.server.auth.rules import ANONYMOUS
from rosld.server.http.problem import one_line
from rosld.server.middleware import Handler
from rosld.server.receipts.audit import AuditEntry, excerpt
from rosld.server.receipts.journal import Journal
from rosld.server.rest.exchange import Exchange

Header = tuple[bytes, bytes]
ABSENT = frozenset({404, 410})
_REFUSED = frozenset({403, *ABSENT})
REASON, CLIENT = "rosld-reason", "rosld-client"
"""Header fields with words of the client for its receipt: why it writes, and the name of its program."""


class Recorder:
    """Writer of receipts to the journal of a server."""

    def __init__(self, journal: Journal, space: Space) -> None:
        self._journal = journal
        self._space = space
        self._before = f"<{space.container('activity')}"
        self._after = f'>; rel="{prov.has_provenance.value}"'

    def note(self, exchange: Exchange, scope: Scope, response: Response) -> str:
        """Record a write and return the identifier of its receipt; `scope` is that of the original request."""
        context, body = exchange.audit, exchange.consumed_body
        stored_body, digest = (None, None) if body is None else excerpt(body)
        length = context.length if body is None else len(body)
        if context.sent is not None:
            digest = context.sent.digest()
        return self._journal.add(
            AuditEntry(
                exchange.agent,
                context.started_ns,
                time.time_ns(),
                exchange.method,
                self._space.base + _path(scope["raw_path"], len(self._space.path)),
                scope["query_string"],
                exchange.header("content-type"),
                stored_body,
                length,
                digest,
                context.plan,
                context.touched,
                context.matched,
                response.status_code,
                _location(response) if response.status_code == 201 else None,
                context.refusal,
                _own_words(exchange, REASON),
                _own_words(exchange, CLIENT),
            ),
            context.receipt,
        )

    def link(self, id: str) -> Header:
        """Return the Link field that leads to a receipt."""
        return b"link", f"{self._before}{id}{self._after}".encode("latin-1")


class Audit:
    """Receipts of writes, recorded before the response is sent."""

    def __init__(self, next: Handler, journal: Journal, space: Space) -> None:
        self._next = next
        self._recorder = Recorder(journal, space)
        self._space = space

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does, with a link to the receipt of a write."""
        scope = exchange.request.scope
        response = await self._next(exchange)
        if response.status_code in _REFUSED:
            self._note_refusal(exchange, response.status_code)
        if exchange.audit.is_write:
            id = exchange.audit.receipt = self._recorder.note(exchange, scope, response)
            headers = response.raw_headers
            if exchange.audit.leads_to_page:
                headers = [
                    (name, _with_receipt(value, id) if name == b"location" else value) for name, value in headers
                ]
            response.raw_headers = [*headers, self._recorder.link(id)]
        return response

    def _note_refusal(self, exchange: Exchange, status: int) -> None:
        """Record writes refused for lack of permission or of a resource; of anonymous agents only the former."""
        if exchange.agent == ANONYMOUS:
            if status in ABSENT:
                exchange.audit.mark_read_only()
        elif enforcement.is_write(exchange.method, enforcement.location_of(exchange.request.scope, self._space)):
            exchange.audit.begin()


def _with_receipt(location: bytes, id: str) -> bytes:
    """Return the URL of a page with the parameter that shows a receipt."""
    return location + (b"&" if b"?" in location else b"?") + f"receipt={id}".encode("ascii")


def _own_words(exchange: Exchange, name: str) -> str | None:
    """Return the text of a field, which is UTF-8 (ASGI decodes it as Latin-1), on one line."""
    value = exchange.header(name)
    if value is None:
        return None
    text = value.encode("latin-1").decode("utf-8", "replace")
    return one_line(text) or None


def _path(raw: bytes, root: int) -> str:
    """Return the path below the base, percent-encoded for use in a URL."""
    return quote(raw[root:], safe="/%:@!$&'()*+,;=~")


def _location(response: Response) -> str | None:
    for name, value in response.raw_headers:
        if name.lower() == b"location":
            return value.decode("latin-1")
    return None
