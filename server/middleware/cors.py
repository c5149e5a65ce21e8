"""Cross-origin resource sharing (the Fetch Standard): the hosts and origins that requests may name, and its headers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from starlette.responses import Response

from rosld.server.http.origin import OriginPolicy, check_host, check_origin, cors_headers
from rosld.server.middleware.handler import Handler, is_preflight
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Resource
from rosld.server.routing.dispatcher import options


class CrossOriginHeaders:
    """Says with every answer which pages may read it, where any may or one asks."""

    def __init__(self, next: Handler, site: OriginPolicy) -> None:
        self._next = next
        self._site = site

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does, with the headers."""
        origin = exchange.header("origin")
        if origin is None and not self._site.shared_origins and not self._site.allows_any_origin:
            return self._next(exchange)
        return self._shared(exchange, origin)

    async def _shared(self, exchange: Exchange, origin: str | None) -> Response:
        response = await self._next(exchange)
        _share(response, cors_headers(self._site, exchange.method, origin))
        return response


class TrustedHosts:
    """Refuses requests for another host (421), and writes of pages that nothing is shared with (403)."""

    def __init__(self, next: Handler, site: OriginPolicy) -> None:
        self._next = next
        self._site = site

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does. Raises Problems."""
        if exchange.header("host") not in self._site.hosts:  # several are joined, and then none of these
            check_host(self._site, exchange.hosts)
        check_origin(self._site, exchange.method, exchange.header("origin"), exchange.header("sec-fetch-site"))
        return self._next(exchange)


class Preflight:
    """Answers preflight requests, with the methods of the resource that `resolve` finds.

    None: it is not known who asks, and nothing is told of the resource.
    """

    def __init__(self, next: Handler, site: OriginPolicy, resolve: Callable[[Exchange], Resource | None]) -> None:
        self._next = next
        self._site = site
        self._resolve = resolve

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer a preflight request, and any other as the next handler does. Raises Problems as `resolve`."""
        return self._answer(exchange) if is_preflight(exchange) else self._next(exchange)

    async def _answer(self, exchange: Exchange) -> Response:
        resource = self._resolve(exchange)
        response = Response(status_code=204, headers={"vary": "Accept"} if resource is None else options(resource))
        _share(response, cors_headers(self._site, "OPTIONS", exchange.header("origin"), preflight=True))
        return response


def _share(response: Response, headers: Mapping[str, str]) -> None:
    """Add CORS headers to a response, joining Vary. The header list is copied: it may belong to a kept rendering."""
    names = {name.encode("latin-1") for name in headers}
    kept = [pair for pair in response.raw_headers if pair[0] not in names]
    varied = [value.decode("latin-1") for name, value in response.raw_headers if name == b"vary"]
    vary = dict.fromkeys(part.strip() for value in (*varied, headers.get("vary", "")) for part in value.split(","))
    joined = {**headers, "vary": ", ".join(part for part in vary if part)} if "vary" in headers else headers
    response.raw_headers = [
        *kept,
        *((name.encode("latin-1"), value.encode("latin-1")) for name, value in joined.items()),
    ]
