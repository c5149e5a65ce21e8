"""Monitoring of requests: counts, identifiers, the log of requests, and traces."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from starlette.responses import Response

from rosld.server.http.request_id import FIELD
from rosld.server.http.token_redaction import redact_tokens
from rosld.server.middleware import Handler
from rosld.server.rest.exchange import Exchange
from rosld.server.runtime.timings import RequestTimings
from rosld.server.runtime.tracing import Tracing, current_request_id

_log = logging.getLogger("rosld.requests")
_READS = frozenset({"GET", "HEAD", "OPTIONS"})
_FIELD = FIELD.encode("ascii")
_NOTHING: Sequence[tuple[bytes, bytes]] = ()


class Monitor:
    """Counter of answered requests, which it `logs` with `--log-format json`."""

    def __init__(self, timings: RequestTimings, *, logs: bool) -> None:
        self.timings = timings
        self.logs = logs

    def start(self, exchange: Exchange) -> None:
        """Name a request that begins in the log of what it does."""
        current_request_id.set(exchange.request_id)

    def answered(self, exchange: Exchange, response: Response, seconds: float) -> Sequence[tuple[bytes, bytes]]:
        """Count a request, and return the fields that identify it.

        Successful reads have them only if the client identified its request, because most responses are of this kind.
        """
        scope, status, headers = exchange.request.scope, response.status_code, exchange.headers
        path, method = scope["raw_path"], scope["method"]
        self.timings.add(path, method, status, seconds)
        if self.logs:
            self._log(exchange, path, method, status, seconds)
        if status < 400 and method in _READS and FIELD not in headers and "traceparent" not in headers:
            return _NOTHING
        return ((_FIELD, exchange.request_id.encode("ascii")),)

    def _log(self, exchange: Exchange, path: bytes, method: str, status: int, seconds: float) -> None:
        shown, receipt = redact_tokens(path.decode("latin-1")), exchange.audit.receipt
        members = {
            "method": method,
            "path": shown,
            "route": self.timings.route(path),
            "status": status,
            "duration": round(seconds, 6),
            "agent": exchange.agent.name,
            **({} if receipt is None else {"receipt": receipt}),
        }
        _log.info("%s %s %d", method, shown, status, extra={"members": members})


class Traced:
    """Spans of requests (OpenTelemetry semantic conventions for HTTP servers)."""

    def __init__(self, next: Handler, tracing: Tracing, timings: RequestTimings) -> None:
        self._next = next
        self._tracing = tracing
        self._timings = timings

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does."""
        scope = exchange.request.scope
        method, route = scope["method"], self._timings.route(scope["raw_path"])
        host, _, port = exchange.headers.get("host", "").partition(":")
        attributes: dict[str, str | int] = {
            "http.request.method": method,
            "http.route": route,
            "url.path": redact_tokens(scope["raw_path"].decode("latin-1")),
            "url.scheme": scope.get("scheme", "http"),
            "server.address": host,
            "network.protocol.version": scope["http_version"],
            **({"server.port": int(port)} if port.isdecimal() else {}),
        }
        if (program := exchange.header("user-agent")) is not None:
            attributes["user_agent.original"] = program[:200]
        with self._tracing.request(f"{method} {route}", exchange.headers, attributes) as (span, trace):
            if FIELD not in exchange.headers:
                exchange.request_id = trace
            response = await self._next(exchange)
            span.set_attribute("http.response.status_code", response.status_code)
            if response.status_code >= 500:
                span.set_attribute("error.type", str(response.status_code))
                self._tracing.mark_failed(span)
            return response
