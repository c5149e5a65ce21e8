"""Tokens in URLs: refused, for URLs are logged, linked and remembered."""

from __future__ import annotations

from collections.abc import Awaitable

from starlette.responses import Response

from rosld.ontology.urls import Space
from rosld.server.auth import enforcement
from rosld.server.http.problem import Problem
from rosld.server.http.token_redaction import LENGTH, PREFIX, contains_token
from rosld.server.middleware.handler import Handler
from rosld.server.rest.exchange import Exchange

_MARK = PREFIX.encode("ascii")


class RejectTokensInUrls:
    """Refuses a URL that has a token of rosld in it (400). What has such a name already can be deleted."""

    def __init__(self, next: Handler, space: Space) -> None:
        self._next = next
        self._space = space

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does. Raises a 400 Problem."""
        scope = exchange.request.scope
        asked: bytes = scope["raw_path"] + b"?" + scope["query_string"]
        may_have_one = len(asked) > LENGTH and (_MARK in asked or b"%" in asked)
        if may_have_one and exchange.method != "DELETE" and contains_token(asked.decode("latin-1")):
            if enforcement.is_write(exchange.method, enforcement.location_of(scope, self._space)):
                exchange.audit.begin()
            sentence = "The URL has a token in it: send it as 'Authorization: Bearer TOKEN', and have it replaced."
            raise Problem(400, sentence)
        return self._next(exchange)
