"""ASGI middleware between the HTTP server and the resources, composed in `app.py`.

A handler answers a request, and may delegate to the next one.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TypeAlias

from starlette.responses import Response

from rosld.server.rest.exchange import Exchange

Handler: TypeAlias = Callable[[Exchange], Awaitable[Response]]
"""Answers a request. `dispatch.ErrorResponses` turns exceptions into responses.

Handlers pass responses, not ASGI messages: adding a header is appending to a list, without a wrapper of `send`. A
handler that only inspects the request is not a coroutine function: it returns the awaitable of the next handler. Eight
more coroutines would take 5 us of a GET, which takes 60.
"""


def is_preflight(exchange: Exchange) -> bool:
    """Whether a request is a CORS-preflight request (the Fetch Standard)."""
    return exchange.method == "OPTIONS" and exchange.header("access-control-request-method") is not None
