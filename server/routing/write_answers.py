"""What a write is answered with: the representation of what it made or changed, as preferred (RFC 7240 4.2)."""

from __future__ import annotations

from dataclasses import replace

from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.server.http.fields import render_links, to_uri
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.raw_response import RawResponse
from rosld.server.rest.resource import CreatedAnswer, Resource, ShownAnswer
from rosld.server.rest.state import Rendering, State
from rosld.server.routing.representations import Representations
from rosld.server.storage.record import StorageError


class WriteAnswers:
    """Makes the answers to writes that were done."""

    def __init__(self, representations: Representations) -> None:
        self._representations = representations

    async def created(self, exchange: Exchange, resource: Resource, created: CreatedAnswer) -> Response:
        """201 with the new resource as body (RFC 9110 15.3.2), or without where less is preferred.

        It says also what that is which the request was sent to (LDP 5.2.1.4).
        """
        headers = [(b"location", to_uri(created.location).encode("ascii"))]
        is_member = created.location != resource.url
        links, rendering = created.links, None
        if created.state is not None and not exchange.prefer.minimal:
            rendering = await self._outcome(exchange, created.resource, created.state, answer=is_member)
        if rendering is None:
            links = (*(resource if is_member else created.resource).links, *links)
            if links:
                headers.append((b"link", render_links(links).encode("latin-1")))
            headers.append((b"content-length", b"0"))
            if exchange.prefer.minimal:
                headers.append((b"preference-applied", b"return=minimal"))
            return RawResponse(201, b"", headers)
        if is_member:
            types = (replace(each, anchor=resource.url) for each in resource.links if each.rel == "type")
            links = (*links, *types)
        if links:
            headers.append((b"link", render_links(links).encode("latin-1")))
        return RawResponse(201, rendering.body, [*rendering.headers, *headers, (b"content-location", headers[0][1])])

    async def shown(self, exchange: Exchange, shown: ShownAnswer) -> Response:
        """200 with the representation of the resource that shows it (RFC 9110 8.7), or 204 where less is preferred."""
        location = (b"content-location", to_uri(shown.resource.url).encode("ascii"))
        added = [(b"link", render_links(shown.links).encode("latin-1"))] if shown.links else []
        if exchange.prefer.minimal:
            return RawResponse(204, b"", [location, *added, (b"preference-applied", b"return=minimal")])
        rendering = await self._outcome(exchange, shown.resource, shown.state)
        if rendering is None:
            return RawResponse(204, b"", [location, *added])
        headers = rendering.headers
        if exchange.method == "PUT":  # what was sent is not what was saved (RFC 9110 9.3.4)
            headers = [each for each in headers if each[0] != b"etag"]
        return RawResponse(200, rendering.body, [*headers, location, *added])

    async def as_preferred(self, exchange: Exchange, resource: Resource, response: Response) -> Response:
        """The representation after a write instead of an empty 204, where the request prefers it (RFC 7240 4.2)."""
        if not exchange.prefer.representation or response.status_code != 204 or exchange.method == "DELETE":
            return response
        rendering = await self._outcome(exchange, resource)
        if rendering is None:
            return response
        headers = [*rendering.headers, (b"preference-applied", b"return=representation")]
        headers.append((b"content-location", to_uri(resource.url).encode("ascii")))
        if "link" in response.headers:
            headers.append((b"link", response.headers["link"].encode("latin-1")))
        return RawResponse(200, rendering.body, headers)

    async def _outcome(
        self, exchange: Exchange, resource: Resource, state: State | None = None, *, answer: bool = False
    ) -> Rendering | None:
        """What shows a write that was done; None where it cannot be had now, or not as preferred: it is not undone.

        What who asks may not read is not shown, unless it is the `answer` to what was asked, such as a call.
        """
        if not answer and not exchange.permissions.may_read(resource.url):
            return None
        try:
            return await self._representations.preferred(
                exchange, resource, await resource.state() if state is None else state
            )
        except (Problem, RosError, StorageError):
            return None
