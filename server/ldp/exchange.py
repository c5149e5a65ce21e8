"""One request being answered, as resources see it: its query, its headers and its body, each checked when asked for."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from functools import cached_property, lru_cache
from types import MappingProxyType
from urllib.parse import parse_qsl

from starlette.requests import Request

from rosld.server.http import media, prefer
from rosld.server.http.body import read_body, read_chunks
from rosld.server.http.problem import Problem


class Exchange:
    """A request: `method` (after a form said which), `query` (the first value of each name), headers, body."""

    def __init__(self, request: Request, body_limit: int) -> None:
        self.request = request
        self.method = request.method
        self._body_limit = body_limit
        self._body: bytes | None = None
        self.typed: Sequence[tuple[str, str]] = ()

    @cached_property
    def query(self) -> Mapping[str, str]:
        """The query's parameters; of a name that occurs twice the first counts. Raises a 400 Problem."""
        raw = self.request.scope["query_string"]
        return _remembered(raw) if len(raw) <= 4096 else _query(raw)

    @cached_property
    def _headers(self) -> Mapping[str, str]:
        """The header fields by lower-case name; several of one name are joined by commas (RFC 9110 5.3)."""
        found: dict[str, str] = {}
        for raw_name, raw_value in self.request.scope["headers"]:
            name, value = raw_name.decode("latin-1"), raw_value.decode("latin-1")
            found[name] = f"{found[name]}, {value}" if name in found else value
        return found

    def header(self, name: str) -> str | None:
        """The value of a header field, None where it is missing; `name` is in lower case."""
        return self._headers.get(name)

    @property
    def hosts(self) -> Sequence[str]:
        """Every Host field of the request."""
        return [value.decode("latin-1") for name, value in self.request.scope["headers"] if name == b"host"]

    @property
    def accept(self) -> str | None:
        """The Accept field."""
        return self._headers.get("accept")

    @cached_property
    def prefer(self) -> prefer.Preferences:
        """The request's preferences (RFC 7240)."""
        return prefer.parse(self.header("prefer"))

    @cached_property
    def media_type(self) -> str:
        """The media type of a body that is to be read, without parameters.

        Raises a 415 Problem where the body states none, or another charset than UTF-8.
        """
        found = self._content_type
        if found is None:
            raise Problem(415, "The request has a body of unknown type: send Content-Type.")
        if found.parameter("charset") not in (None, "utf-8", "utf8"):
            raise Problem(415, f"Content-Type: {self.header('content-type')!r}: bodies are read as UTF-8 only.")
        return found.essence

    @property
    def essence(self) -> str | None:
        """The media type of the body without parameters, whatever its charset; None where it states none."""
        return None if self._content_type is None else self._content_type.essence

    @cached_property
    def _content_type(self) -> media.MediaType | None:
        stated = self.header("content-type")
        try:
            return None if stated is None else media.parse(stated)
        except ValueError as error:
            raise Problem(415, f"Content-Type: {error}.") from error

    def become(self, method: str, media_type: str, body: bytes) -> None:
        """Turn into the request that a form meant."""
        self.method = method
        self.media_type = media_type
        self._body = body

    async def body(self) -> bytes:
        """The whole body; raises Problems for one that is too large (413), compressed (415) or cut off (400)."""
        if self._body is None:
            self._body = await read_body(self.request, limit=self._body_limit)
        return self._body

    def chunks(self, *, limit: int) -> AsyncIterator[bytes]:
        """The body as it comes, for a write that streams; raises the Problems of `body`."""
        return read_chunks(self.request, limit=limit)

    def flag(self, name: str) -> bool:
        """Whether `?name=true` is asked for; raises a 400 Problem for anything but true and false."""
        if not self.request.scope["query_string"]:
            return False
        value = self.query.get(name, "false").lower()
        if value not in ("true", "false", ""):
            raise Problem(400, f"?{name}={value} is neither true nor false.")
        return value != "false"


def _query(raw: bytes) -> Mapping[str, str]:
    try:
        pairs = parse_qsl(raw.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=200)
    except (UnicodeDecodeError, ValueError) as error:
        raise Problem(400, f"The query string cannot be read: {error}.") from error
    return MappingProxyType(dict(reversed(pairs)))


_remembered = lru_cache(maxsize=256)(_query)
