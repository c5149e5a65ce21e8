"""The request that a resource answers: its query, headers and body, each validated when read."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from urllib.parse import parse_qsl

from starlette.requests import Request
from starlette.types import Receive, Scope

from rosld.adapters.base import FOR_EVER
from rosld.ontology.charsets import UTF_8
from rosld.server.auth.authenticator import UNRESTRICTED
from rosld.server.auth.enforcement import Protected
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.rate_limit import Client
from rosld.server.auth.rules import Agent
from rosld.server.http.body import TIMEOUT, codec_for, read_body, read_chunks, to_utf8
from rosld.server.http.conditional import ETag, check_preconditions
from rosld.server.http.negotiation import MediaType, Preferences, choose_offer, parse_media_type, parse_prefer
from rosld.server.http.problem import Problem
from rosld.server.http.request_id import request_id
from rosld.server.receipts.audit import AuditContext
from rosld.server.runtime.process_memory import PER_BYTE, PROCESS_MEMORY

_NOTHING: Mapping[str, str] = MappingProxyType({})


class Exchange:
    """A request: `method` (as overridden by a form), `query` (the first value of each name), headers, body."""

    def __init__(self, request: Request, body_limit: int, body_seconds: float = TIMEOUT) -> None:
        self.request = request
        self.method = request.method
        self.headers = _fields(request.scope["headers"])
        """Header fields by lower-case name; several with one name are joined by commas (RFC 9110 5.3)."""
        self._body_limit = body_limit
        self._body_seconds = body_seconds
        self._body: bytes | None = None
        self.typed: Sequence[tuple[str, str]] = ()
        self.auth = UNRESTRICTED
        """Permissions of the agent."""
        self.client: Client | None = None
        """Client whose limits apply, after admission."""
        self.audit = AuditContext()
        """Audit of its write, for the receipt."""
        self.answering: Protected | None = None
        """Resource that answers, once known."""

    @property
    def agent(self) -> Agent:
        """Agent that sent the request."""
        return self.auth.permissions.agent

    @property
    def permissions(self) -> Permissions:
        """Permissions of the agent."""
        return self.auth.permissions

    @cached_property
    def query(self) -> Mapping[str, str]:
        """Parameters of the query, by name; the first of several with one name counts. Raises a 400 Problem."""
        raw = self.request.scope["query_string"]
        return MappingProxyType(dict(reversed(query_pairs(raw)))) if raw else _NOTHING

    @property
    def format(self) -> str | None:
        """The value of `?format=`, which overrides Accept; None without one. Raises a 400 Problem."""
        return self.query.get("format") or None

    def preferred(self, formats: Mapping[str, str], offers: tuple[str, ...]) -> str | None:
        """Return the media type in `formats` that `?format=` names, or without it the offer that Accept prefers.

        None if there is none. Raises a 400 Problem.
        """
        wanted = self.query.get("format")
        return formats.get(wanted) if wanted else choose_offer(self.accept, offers)

    @cached_property
    def request_id(self) -> str:
        """Identifier of the request, for its response and the log."""
        return request_id(self.headers)

    def check_preconditions(self, current: ETag | None) -> bool:
        """Return whether a read is answered with 304. Raises a 412 Problem if a precondition fails."""
        if_match, if_none_match = self.header("if-match"), self.header("if-none-match")
        return check_preconditions(self.method, current, if_match=if_match, if_none_match=if_none_match)

    def header(self, name: str) -> str | None:
        """Return the value of a header field (name in lower case), None if it is missing."""
        return self.headers.get(name)

    @property
    def hosts(self) -> Sequence[str]:
        """Host fields of the request."""
        return [value.decode("latin-1") for name, value in self.request.scope["headers"] if name == b"host"]

    @property
    def receive(self) -> Receive:
        """ASGI callable that receives the body."""
        return self.request.receive

    @property
    def accept(self) -> str | None:
        """The Accept field."""
        return self.headers.get("accept")

    @property
    def prefer(self) -> Preferences:
        """Preferences of the request (RFC 7240)."""
        return parse_prefer(self.header("prefer"))

    @property
    def media_type(self) -> str:
        """Media type of the body without parameters, for reading.

        Raises a 415 Problem if the body has no media type, or an unsupported charset.
        """
        found = self._content_type
        if found is None:
            raise Problem(415, "The request has a body but no Content-Type: send one.")
        codec_for(found)
        return found.essence

    @property
    def codec(self) -> str:
        """Python codec of the body's charset, by default UTF-8. Raises a 415 Problem."""
        found = self._content_type
        return UTF_8 if found is None else codec_for(found)

    @property
    def essence(self) -> str | None:
        """Media type of the body without parameters, None without Content-Type."""
        found = self._content_type
        return None if found is None else found.essence

    @property
    def _content_type(self) -> MediaType | None:
        stated = self.header("content-type")
        try:
            return None if stated is None else parse_media_type(stated)
        except ValueError as error:
            raise Problem(415, f"Content-Type: {error}.") from error

    @property
    def is_conditional(self) -> bool:
        """Whether the request has If-Match or If-None-Match (RFC 9110 13.1)."""
        return "if-match" in self.headers or "if-none-match" in self.headers

    def override(self, method: str, media_type: str, body: bytes, query: Mapping[str, str] = _NOTHING) -> None:
        """Replace the request by the meaning of a form; `query` is added to the present query."""
        if query:
            self.__dict__["query"] = MappingProxyType({**self.query, **query})
        self.method = method
        self.headers = {**self.headers, "content-type": media_type}
        self._body = body

    def redirect_internally(self, scope: Scope) -> None:
        """Redirect the request to another URL of this server, given by `scope`."""
        self.request = Request(scope, self.request.receive)
        self.__dict__.pop("query", None)

    async def raw_body(self) -> bytes:
        """Return the body as sent. Raises Problems: 413 too large, 415 compressed, 400 truncated."""
        if self._body is None:
            self._body = await read_body(self, limit=self._body_limit, timeout=self._body_seconds)
            PROCESS_MEMORY.require(len(self._body) * PER_BYTE, f"a body of {len(self._body)} bytes")
        return self._body

    async def body(self) -> bytes:
        """Return the complete body in UTF-8, whatever its charset. Raises Problems as `raw_body` does.

        Also raises a 415 Problem for an unsupported charset, and a 400 Problem for bytes that are invalid in it.
        """
        return self.to_utf8(await self.raw_body() if self._body is None else self._body)

    def to_utf8(self, data: bytes) -> bytes:
        """Return a part of the body in UTF-8. Raises 415 and 400 Problems as `body` does."""
        found = self._content_type
        return data if found is None else to_utf8(data, found)

    @property
    def consumed_body(self) -> bytes | None:
        """Body if it was read completely; for a form, its meaning."""
        return self._body

    async def chunks(self, *, limit: int) -> AsyncIterator[bytes]:
        """Yield the body as it arrives, for a streaming write. Raises the Problems of `body`."""
        async for chunk in read_chunks(self, limit=limit, timeout=self._body_seconds):
            self.audit.hash_chunk(chunk)
            yield chunk

    def query_values(self, name: str) -> list[str]:
        """Return the non-empty values of a parameter that may be repeated, each once.

        Raises a 400 Problem.
        """
        pairs = query_pairs(self.request.scope["query_string"])
        return list(dict.fromkeys(value.strip() for each, value in pairs if each == name and value.strip()))

    def query_integer(self, name: str, default: int, least: int, most: int) -> int:
        """Return the integer `?name=`. Raises a 400 Problem for others than from `least` to `most`."""
        text = self.query.get(name)
        if text is None:
            return default
        if not (text.isascii() and text.isdecimal() and len(text) < 19 and least <= int(text) <= most):
            bound = f"from {least}" if most == FOR_EVER else f"from {least} to {most}"
            raise Problem(400, f"?{name}={text[:20]} must be an integer {bound}.")
        return int(text)

    def query_flag(self, name: str) -> bool:
        """Return the boolean `?name=`. Raises a 400 Problem for values other than true and false."""
        if not self.request.scope["query_string"]:
            return False
        value = self.query.get(name, "false").lower()
        if value not in ("true", "false", ""):
            raise Problem(400, f"?{name}={value} must be true or false.")
        return value != "false"


def _fields(raw: Iterable[tuple[bytes, bytes]]) -> Mapping[str, str]:
    found: dict[str, str] = {}
    for raw_name, raw_value in raw:
        name, value = raw_name.decode("latin-1"), raw_value.decode("latin-1")
        found[name] = f"{found[name]}, {value}" if name in found else value
    return found


def query_pairs(raw: bytes) -> list[tuple[str, str]]:
    """Return the names and values of a query string. Raises a 400 Problem."""
    try:
        return parse_qsl(raw.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=200)
    except (UnicodeDecodeError, ValueError) as error:
        raise Problem(400, f"The query string cannot be read: {error}.") from error
