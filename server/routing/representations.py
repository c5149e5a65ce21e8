"""Representations of resources: a state in the media type, and within the permissions, of a request (RFC 9110 3.2)."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

from starlette.responses import Response

from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import CannotCarry, Syntax
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.html.page import Notice
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.fields import to_uri
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, HTML, JSON, OFFERS, VARIANTS
from rosld.server.rest.large import LargeDocuments
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.resource import Resource
from rosld.server.rest.responses import RawResponse, file_stream, resource_headers
from rosld.server.rest.state import Rendering, State

_JSON_IS_JSONLD = {JSON: Syntax.JSON_LD.media_type}
_MAX_RENDERINGS = 64
"""Maximum number of cached representations and redactions of a state."""
CONTENT_FIELDS = (b"content-type", b"content-length")
"""Fields that responses without content omit."""


class Representations:
    """Renderer of the representations of states. `instance_id` identifies this run of the server in ETags."""

    def __init__(self, instance_id: str, pages: PageRenderer, large: LargeDocuments) -> None:
        self._instance_id = instance_id
        self._pages = pages
        self._large = large

    def name(self, state: State) -> str:
        """Return the state part of the ETags of a state's representations."""
        return f"{state.scope or self._instance_id}-{state.tag}"

    async def represent(
        self,
        resource: Resource,
        state: State,
        media_type: str,
        permissions: Permissions = ALLOW_ALL,
        notices: Sequence[Notice] = (),
    ) -> Rendering:
        """Return the representation in a media type, cached with the state or rendered now. Raises a 406 Problem.

        Agents with the same rights share bytes; a page, which has forms, belongs to one agent, and one with `notices`
        to a single request.
        """
        variant = _variant(media_type, permissions)
        if not permissions.is_unrestricted:
            state = redacted_state(resource, state, permissions)
        if media_type == HTML and (self._pages.version is not None or notices):
            return await self._render(resource, state, media_type, variant, permissions, notices)
        found = state.renderings.get(variant)
        if found is None:
            if len(state.renderings) >= _MAX_RENDERINGS:
                state.renderings.clear()
            found = state.renderings[variant] = await self._render(resource, state, media_type, variant, permissions)
        return found

    async def preferred(self, exchange: Exchange, resource: Resource, state: State) -> Rendering:
        """Return the representation that the request prefers, cached or rendered now. Raises a 406 Problem."""
        return await self.represent(resource, state, negotiate(exchange), exchange.permissions)

    async def _render(
        self,
        resource: Resource,
        state: State,
        media_type: str,
        variant: str,
        permissions: Permissions,
        notices: Sequence[Notice] = (),
    ) -> Rendering:
        if media_type == HTML:
            body = await self._pages.page(resource, state, notices, permissions)
        elif media_type == JSON and state.plain is not None:
            body = state.plain()
        elif state.is_large:
            raise Problem(406, "This is too large to send here: GET it, or subscribe to its notifications.")
        elif state.is_long:
            body = await asyncio.to_thread(_serialize, state, _JSON_IS_JSONLD.get(media_type, media_type))
        else:
            body = _serialize(state, _JSON_IS_JSONLD.get(media_type, media_type))
        name = f"{self._instance_id}-{digest(body)}" if media_type == HTML else self.name(state)  # a page shows more
        etag = str(ETag(name, variant + state.part))
        headers = {**_headers(resource, state, media_type, etag), "content-length": str(len(body))}
        if media_type == HTML:
            headers |= self._pages.headers
        return Rendering(body, encode_headers(headers), etag)

    async def read_large(
        self, exchange: Exchange, resource: Resource, state: State, media_type: str, *, unchanged: bool
    ) -> Response:
        """Return the response to GET or HEAD of a large state from a file created by a worker process (not for HEAD).

        Without a representation its length is unknown, and HEAD may omit it (RFC 9110 9.3.2). `unchanged`: the client
        has it already, and gets a 304. Raises a 406 Problem if the media type cannot represent the state.
        """
        permissions = exchange.permissions
        variant = _variant(media_type, permissions)
        syntax = _JSON_IS_JSONLD.get(media_type, media_type)
        etag = str(ETag(self.name(state), variant + state.part))
        headers = _headers(resource, state, media_type, etag)
        if unchanged or is_not_modified(exchange, Rendering(b"", [], etag)):
            return RawResponse(
                304, b"", encode_headers({name: headers[name] for name in headers if name != "content-type"})
            )
        if exchange.method == "HEAD":
            return RawResponse(200, b"", encode_headers(headers))
        try:
            file, size = await self._large.file(
                (resource.url, etag, syntax), redacted_state(resource, state, permissions), syntax
            )
        except CannotCarry as error:
            raise _cannot_carry(media_type, error) from error
        return file_stream(encode_headers({**headers, "content-length": str(size)}), file, size)

    def unmet(self, exchange: Exchange, resource: Resource, state: State) -> Response:
        """Return a 204 after `?timeout=`, with the ETag of the actual state."""
        media_type = negotiate(exchange)
        etag = str(ETag(self.name(state), _variant(media_type, exchange.permissions) + state.part))
        headers = _headers(resource, state, media_type, etag)
        del headers["content-type"]
        return RawResponse(204, b"", encode_headers({**headers, "content-location": to_uri(resource.url)}))

    def receipt_notices(self, exchange: Exchange, media_type: str) -> Sequence[Notice]:
        """Return the notices of a page about the write that led to it (`?receipt=`)."""
        if media_type != HTML or b"receipt=" not in exchange.request.scope["query_string"]:
            return ()
        return self._pages.receipt_notices(exchange.query.get("receipt", ""), exchange.permissions)


def redacted_state(resource: Resource, state: State, permissions: Permissions) -> State:
    """Return the state without what the agent may not read; the same object for the same rights."""
    if permissions.is_unrestricted:
        return state
    found = state.redactions.get(permissions.rights_key)
    if found is None:
        if len(state.redactions) >= _MAX_RENDERINGS:
            state.redactions.clear()
        found = state.redactions[permissions.rights_key] = resource.redact(state, permissions)
    return found


def negotiate(exchange: Exchange) -> str:
    """Return the media type of the response: `?format=` takes precedence over Accept. Raises a 406 Problem."""
    if wanted := exchange.format:
        if wanted not in FORMATS:
            raise Problem(406, f"?format={wanted} is unknown; choose from {', '.join(FORMATS)}.")
        return FORMATS[wanted]
    found = choose_offer(exchange.accept, OFFERS)
    if found is None:
        raise Problem(406, f"None of {exchange.accept!r} is available; choose from {', '.join(OFFERS)}.")
    return found


def event_media_type(exchange: Exchange) -> str:
    """Return the media type of an event's data: plain JSON, or that of `?format=`. Raises a 406 Problem."""
    wanted = exchange.query.get("format", "json")
    if wanted not in FORMATS:
        raise Problem(406, f"?format={wanted} cannot be streamed; choose from {', '.join(FORMATS)}.")
    return FORMATS[wanted]


def is_not_modified(exchange: Exchange, rendering: Rendering) -> bool:
    """Whether GET or HEAD is answered with 304. Raises a 412 Problem if If-Match fails (RFC 9110 13.2.2)."""
    if not exchange.is_conditional:
        return False
    state, _, variant = rendering.etag.strip('"').rpartition(".")
    return exchange.check_preconditions(ETag(state, variant))


def encode_headers(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    """Encode header fields for ASGI, in Latin-1."""
    return [(name.encode("latin-1"), value.encode("latin-1")) for name, value in headers.items()]


def _variant(media_type: str, permissions: Permissions) -> str:
    """Return the variant part of the ETags of representations in a media type, for agents of these rights."""
    variant = (
        VARIANTS[media_type] if permissions.is_unrestricted else f"{VARIANTS[media_type]}-{permissions.rights_key}"
    )
    return variant + permissions.cache_key if media_type == HTML else variant


def _headers(resource: Resource, state: State, media_type: str, etag: str) -> dict[str, str]:
    """Return the headers of a representation without its length."""
    return {
        "content-type": f"{media_type}; charset=utf-8" if media_type.startswith("text/") else media_type,
        "etag": etag,
        "vary": "Accept",
        "cache-control": f"max-age={state.max_age}" if state.max_age else "no-cache",
        **resource_headers(resource, shapes=state.shapes),
        **state.headers,
    }


def _serialize(state: State, media_type: str) -> bytes:
    syntax = next(syntax for syntax in Syntax if syntax.media_type == media_type)
    try:
        return serialize(state.document, syntax)
    except CannotCarry as error:
        raise _cannot_carry(media_type, error) from error


def _cannot_carry(media_type: str, error: CannotCarry) -> Problem:
    return Problem(406, f"{media_type} cannot carry this resource: {error}")
