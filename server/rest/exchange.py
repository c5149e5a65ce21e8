"""The request that a resource answers: its query, headers and body, each checked when it is read."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from functools import cached_property, lru_cache
from types import MappingProxyType
from urllib.parse import parse_qsl

from starlette.requests import Request
from starlette.types import Receive, Scope

from rosld.ontology.charsets import UTF_8
from rosld.server.auth.agent import Agent
from rosld.server.auth.authenticator import UNRESTRICTED
from rosld.server.auth.enforcement import Protected
from rosld.server.auth.permissions import Permissions
from rosld.server.auth.rate_limit import Client
from rosld.server.http.body import TIMEOUT, codec_for, read_body, read_chunks, to_utf8
from rosld.server.http.negotiation import MediaType, Preferences, parse_media_type, parse_prefer
from rosld.server.http.problem import Problem
from rosld.server.receipts.audit_context import AuditContext
from rosld.server.runtime.process_memory import PER_BYTE, PROCESS_MEMORY

_NOTHING: Mapping[str, str] = MappingProxyType({})


class Exchange:
    """A request: `method` (after a form said which), `query` (the first value of each name), headers, body."""

    def __init__(self, request: Request, body_limit: int, body_seconds: float = TIMEOUT) -> None:
        self.request = request
        self.method = request.method
        self.headers = _fields(request.scope["headers"])
        """The header fields by lower-case name; several of one name are joined by commas (RFC 9110 5.3)."""
        self._body_limit = body_limit
        self._body_seconds = body_seconds
        self._body: bytes | None = None
        self.typed: Sequence[tuple[str, str]] = ()
        self.auth = UNRESTRICTED
        """Who asks, and what they may do."""
        self.client: Client | None = None
        """Whose limits it counts against, once it was let pass."""
        self.audit = AuditContext()
        """What it tells of its write, for its receipt."""
        self.answering: Protected | None = None
        """The resource that answers, once it is known."""

    @property
    def agent(self) -> Agent:
        """The agent that sent the request."""
        return self.auth.permissions.agent

    @property
    def permissions(self) -> Permissions:
        """The permissions of the agent."""
        return self.auth.permissions

    @cached_property
    def query(self) -> Mapping[str, str]:
        """The query's parameters; of a name that occurs twice the first counts. Raises a 400 Problem."""
        raw = self.request.scope["query_string"]
        return _remembered(raw) if len(raw) <= 4096 else _query(raw)

    def header(self, name: str) -> str | None:
        """Return the value of a header field, None where it is missing; `name` is in lower case."""
        return self.headers.get(name)

    @property
    def hosts(self) -> Sequence[str]:
        """Every Host field of the request."""
        return [value.decode("latin-1") for name, value in self.request.scope["headers"] if name == b"host"]

    @property
    def receive(self) -> Receive:
        """The ASGI callable that receives the body."""
        return self.request.receive

    @property
    def accept(self) -> str | None:
        """The Accept field."""
        return self.headers.get("accept")

    @property
    def prefer(self) -> Preferences:
        """The request's preferences (RFC 7240)."""
        return parse_prefer(self.header("prefer"))

    @property
    def media_type(self) -> str:
        """The media type of a body that is to be read, without parameters.

        Raises a 415 Problem where the body states none, or a charset that is not read here.
        """
        found = self._content_type
        if found is None:
            raise Problem(415, "The request has a body of unknown type: send Content-Type.")
        codec_for(found)
        return found.essence

    @property
    def codec(self) -> str:
        """The Python codec of the charset that the body states, UTF-8 where it states none. Raises a 415 Problem."""
        found = self._content_type
        return UTF_8 if found is None else codec_for(found)

    @property
    def essence(self) -> str | None:
        """The media type of the body without parameters; None without Content-Type."""
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
        """Whether it has If-Match or If-None-Match (RFC 9110 13.1)."""
        return "if-match" in self.headers or "if-none-match" in self.headers

    def override(self, method: str, media_type: str, body: bytes, query: Mapping[str, str] = _NOTHING) -> None:
        """Replace the request by the one that a form means; `query` is added to the present query."""
        if query:
            self.__dict__["query"] = MappingProxyType({**self.query, **query})
        self.method = method
        self.headers = {**self.headers, "content-type": media_type}
        self._body = body

    def redirect_internally(self, scope: Scope) -> None:
        """Turn into the same request to another URL of this server, which `scope` has."""
        self.request = Request(scope, self.request.receive)
        self.__dict__.pop("query", None)

    async def raw_body(self) -> bytes:
        """Return the body as sent. Raises Problems: 413 too large, 415 compressed, 400 truncated."""
        if self._body is None:
            self._body = await read_body(self, limit=self._body_limit, timeout=self._body_seconds)
            PROCESS_MEMORY.require(len(self._body) * PER_BYTE, f"a body of {len(self._body)} bytes")
        return self._body

    async def body(self) -> bytes:
        """Return the whole body in UTF-8, whatever charset it states; raises Problems as `raw_body`.

        Raises a 415 Problem for a charset that is not read here, and a 400 Problem for bytes that are none of it.
        """
        return self.to_utf8(await self.raw_body() if self._body is None else self._body)

    def to_utf8(self, data: bytes) -> bytes:
        """Return a part of the body in UTF-8. Raises a 415 and a 400 Problem as `body`."""
        found = self._content_type
        return data if found is None else to_utf8(data, found)

    @property
    def consumed_body(self) -> bytes | None:
        """The body if it was read completely; for a form, its meaning."""
        return self._body

    async def chunks(self, *, limit: int) -> AsyncIterator[bytes]:
        """The body as it comes, for a write that streams; raises the Problems of `body`."""
        async for chunk in read_chunks(self, limit=limit, timeout=self._body_seconds):
            self.audit.hash_chunk(chunk)
            yield chunk

    def query_values(self, name: str) -> list[str]:
        """The values of a parameter that may be there several times, each once; none that is empty.

        Raises a 400 Problem.
        """
        pairs = query_pairs(self.request.scope["query_string"])
        return list(dict.fromkeys(value.strip() for each, value in pairs if each == name and value.strip()))

    def query_flag(self, name: str) -> bool:
        """Return the boolean `?name=`. Raises a 400 Problem for values other than true and false."""
        if not self.request.scope["query_string"]:
            return False
        value = self.query.get(name, "false").lower()
        if value not in ("true", "false", ""):
            raise Problem(400, f"?{name}={value} is neither true nor false.")
        return value != "false"


def _fields(raw: Iterable[tuple[bytes, bytes]]) -> Mapping[str, str]:
    found: dict[str, str] = {}
    for raw_name, raw_value in raw:
        name, value = raw_name.decode("latin-1"), raw_value.decode("latin-1")
        found[name] = f"{found[name]}, {value}" if name in found else value
    return found


def _query(raw: bytes) -> Mapping[str, str]:
    return MappingProxyType(dict(reversed(query_pairs(raw))))


def query_pairs(raw: bytes) -> list[tuple[str, str]]:
    """Return the names and values of a query string. Raises a 400 Problem."""
    try:
        return parse_qsl(raw.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=200)
    except (UnicodeDecodeError, ValueError) as error:
        raise Problem(400, f"The query string cannot be read: {error}.") from error


_remembered = lru_cache(maxsize=256)(_query)
