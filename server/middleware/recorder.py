"""Recorder: the one place that records writes, when their answers are ready and before they are sent."""

from __future__ import annotations

import time
from functools import lru_cache
from urllib.parse import quote

from starlette.responses import Response
from starlette.types import Scope

from rosld.ontology.urls import Space
from rosld.ontology.vocab import prov
from rosld.server.receipts.audit_entry import AuditEntry, excerpt
from rosld.server.receipts.journal import Journal
from rosld.server.rest.exchange import Exchange

Header = tuple[bytes, bytes]


class Recorder:
    """Records the writes of one server in its journal."""

    def __init__(self, journal: Journal, space: Space) -> None:
        self._journal = journal
        self._space = space
        self._before = f"<{space.container('activity')}"
        self._after = f'>; rel="{prov.has_provenance.value}"'

    def note(self, exchange: Exchange, scope: Scope, response: Response) -> str:
        """Note a write; the identifier of its receipt. `scope` is the request as it came."""
        account, body = exchange.audit, exchange.consumed_body
        kept, digest = (None, None) if body is None else excerpt(body)
        length = account.length if body is None else len(body)
        if account.sent is not None:
            digest = account.sent.digest()
        return self._journal.add(
            AuditEntry(
                exchange.agent,
                account.started_ns,
                time.time_ns(),
                exchange.method,
                self._space.base + _path(scope["raw_path"], len(self._space.path)),
                scope["query_string"],
                exchange.header("content-type"),
                kept,
                length,
                digest,
                account.plan,
                account.touched,
                account.matched,
                response.status_code,
                _location(response) if response.status_code == 201 else None,
                account.refusal,
            )
        )

    def link(self, id: str) -> Header:
        """The Link field that says where a receipt is."""
        return b"link", f"{self._before}{id}{self._after}".encode("latin-1")


@lru_cache(maxsize=4096)
def _path(raw: bytes, root: int) -> str:
    """The path below the base of a path as it was sent, fit to stand in a URL."""
    return quote(raw[root:], safe="/%:@!$&'()*+,;=~")


def _location(response: Response) -> str | None:
    for name, value in response.raw_headers:
        if name.lower() == b"location":
            return value.decode("latin-1")
    return None
