"""Authentication, authorization by the path, and the headers that tell rights."""

from __future__ import annotations

from starlette.responses import Response

from rosld.ontology.urls import Location, Space
from rosld.server.auth import enforcement
from rosld.server.auth.authenticator import Authenticator
from rosld.server.auth.permissions import Permissions
from rosld.server.http import link
from rosld.server.middleware.audit import ABSENT
from rosld.server.middleware.handler import Handler
from rosld.server.rest.exchange import Exchange

_TELLING_NOTHING = frozenset({401, *ABSENT})
"""Statuses of answers that say nothing of what may be done: it might tell whether anything is there."""


class AccessHeaders:
    """Says with every answer what its reader may do (WAC-Allow), and where rights are described (`rel="acl"`).

    Until it is known who asks, it is nobody in particular.
    """

    def __init__(self, next: Handler, authenticator: Authenticator, space: Space) -> None:
        self._next = next
        self._authenticator = authenticator
        self._space = space
        self._acl = link.Link(f"{space.base}acl", "acl")

    async def __call__(self, exchange: Exchange) -> Response:
        """Answer as the next handler does, with the headers."""
        exchange.auth = self._authenticator.anonymous
        response = await self._next(exchange)
        place = enforcement.location_of(exchange.request.scope, self._space)
        permissions, public = exchange.permissions, self._authenticator.anonymous.permissions
        if response.status_code in _TELLING_NOTHING and not _may_know(permissions, place, response.status_code):
            place = None
        response.raw_headers = enforcement.with_auth_headers(
            response.raw_headers, permissions, public, place, exchange.answering, self._acl
        )
        return response


class Authentication:
    """Authenticates the agent, and refuses what the path alone forbids (401, 403, 404)."""

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
    """Whether an agent may know that there is nothing at a place."""
    return status in ABSENT and place is not None and permissions.may_know_any_type(place)
