"""The contract of the middleware: a handler answers a request, and may ask the next one to."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeAlias

from starlette.responses import Response

from rosld.server.rest.exchange import Exchange

Handler: TypeAlias = Callable[[Exchange], Awaitable[Response]]
"""Answers a request. What it raises is made an answer by `error_responses.py`.

Responses, not ASGI messages, pass from one to the next: a header is added to a list, without a wrapper of `send`. A
handler that only looks at the request is no coroutine function: it returns what the next one returns, to be awaited
there. Eight coroutines more would take 5 us of a GET, which takes 60.
"""


def is_preflight(exchange: Exchange) -> bool:
    """Whether a browser asks what another site's page may send (Fetch, CORS-preflight request)."""
    return exchange.method == "OPTIONS" and exchange.header("access-control-request-method") is not None
