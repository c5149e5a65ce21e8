"""Access: trusted hosts and origins (the Fetch Standard), authentication, and authorization by the path."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from starlette.responses import Response

from rosld.ontology.urls import Location, Space
from rosld.server.auth import enforcement
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.permissions import Permissions
from rosld.server.http.fields import Link
from rosld.server.http.origin import OriginPolicy, check_host, check_origin, cors_headers
from rosld.server.http.problem import Problem
from rosld.server.http.token_redaction import LENGTH, PREFIX, contains_token
from rosld.server.middleware import Handler, is_preflight
from rosld.server.middleware.audit import ABSENT
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.resource import Resource
from rosld.server.routing.dispatcher import options


class CrossOriginHeaders:
    """Adds CORS headers to responses, if any origin may read them or the request names one."""

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
    """Check of Host (421) and of the origin of writes (403)."""

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
    """Responses to preflight requests, with the methods of the resource that `resolve` finds.

    `resolve` returns None if methods must not be revealed to unauthenticated clients.
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
    """Add CORS headers to a response, joining Vary. The header list is copied: it may belong to a cached rendering."""
    names = {name.encode("latin-1") for name in headers}
    others = [pair for pair in response.raw_headers if pair[0] not in names]
    varied = [value.decode("latin-1") for name, value in response.raw_headers if name == b"vary"]
    vary = dict.fromkeys(part.strip() for value in (*varied, headers.get("vary", "")) for part in value.split(","))
    joined = {**headers, "vary": ", ".join(part for part in vary if part)} if "vary" in headers else headers
    response.raw_headers = [
        *others,
        *((name.encode("latin-1"), value.encode("latin-1")) for name, value in joined.items()),
    ]


_WITHOUT_PERMISSIONS = frozenset({401, *ABSENT})
"""Statuses of responses without WAC-Allow, which could reveal whether a resource exists."""


class AccessHeaders:
    """Adds the permissions of the agent (WAC-Allow) and a link to their description (`rel="acl"`) to responses.

    Unauthenticated requests count as anonymous.
    """

    def __init__(self, next: Handler, authenticator: Authenticator, space: Space) -> None:
        self._next = next
        self._authenticator = authenticator
        self._space = space
        self._acl = Link(f"{space.base}acl", "acl")

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does, with the headers."""
        exchange.auth = self._authenticator.anonymous
        response = await self._next(exchange)
        place = enforcement.location_of(exchange.request.scope, self._space)
        permissions, public = exchange.permissions, self._authenticator.anonymous.permissions
        if response.status_code in _WITHOUT_PERMISSIONS and not _may_know(permissions, place, response.status_code):
            place = None
        response.raw_headers = enforcement.with_auth_headers(
            response.raw_headers, permissions, public, place, exchange.answering, self._acl
        )
        return response


class Authentication:
    """Authentication of the agent, and authorization by the path (401, 403, 404)."""

    def __init__(self, next: Handler, authenticator: Authenticator, space: Space) -> None:
        self._next = next
        self._authenticator = authenticator
        self._space = space

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does. Raises Problems."""
        exchange.auth = await self._authenticator.authenticate(exchange.header("authorization"))
        if not exchange.permissions.is_unrestricted:
            place = enforcement.location_of(exchange.request.scope, self._space)
            enforcement.require_path(exchange.permissions, exchange.method, place)
        return await self._next(exchange)


def _may_know(permissions: Permissions, place: Location | None, status: int) -> bool:
    """Whether an agent may know that nothing exists at a place."""
    return status in ABSENT and place is not None and permissions.may_know_any_type(place)


_MARK = PREFIX.encode("ascii")


class RejectTokensInUrls:
    """Refusal of URLs that contain an access token (400); resources with such names can still be deleted."""

    def __init__(self, next: Handler, space: Space) -> None:
        self._next = next
        self._space = space

    def __call__(self, exchange: Exchange) -> Awaitable[Response]:
        """Answer as the next handler does. Raises a 400 Problem."""
        scope = exchange.request.scope
        target: bytes = scope["raw_path"] + b"?" + scope["query_string"]
        may_have_one = len(target) > LENGTH and (_MARK in target or b"%" in target)
        if may_have_one and exchange.method != "DELETE" and contains_token(target.decode("latin-1")):
            if enforcement.is_write(exchange.method, enforcement.location_of(scope, self._space)):
                exchange.audit.begin()
            sentence = (
                "The URL contains a token: send it as 'Authorization: Bearer TOKEN' instead, and have it replaced."
            )
            raise Problem(400, sentence)
        return self._next(exchange)
