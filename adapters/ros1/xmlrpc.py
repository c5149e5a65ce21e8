"""XML-RPC for the Master and Slave APIs of ROS 1, with an HTTP client.

Every document is untrusted: no DOCTYPE (so no entities), limited size and depth, limited headers.
"""

from __future__ import annotations

import asyncio
import xmlrpc.client
from collections.abc import Awaitable, Callable
from datetime import datetime
from typing import NamedTuple, TypeAlias
from xml.parsers import expat

from rosld.adapters.model import Refused, Sent, TimedOut, Unreachable
from rosld.adapters.model.parameter import ParameterValue

MAX_BYTES = 64 * 1024 * 1024
MAX_HEADER = 16 * 1024
MAX_DEPTH = 400  # elements; nested structs take three each
MAX_IDLE = 2

Dial: TypeAlias = Callable[[], Awaitable[tuple[asyncio.StreamReader, asyncio.StreamWriter]]]


class Malformed(ValueError):
    """A document that is not XML-RPC, or exceeds the limits."""


class Answer(NamedTuple):
    """Response of a ROS API: a code (1 success, 0 failure, -1 the caller's error), a message, and the value."""

    code: int
    words: str
    value: ParameterValue


def encode_call(method: str, *arguments: ParameterValue) -> bytes:
    """Return the document of a call."""
    return xmlrpc.client.dumps(arguments, method).encode()


def encode_answer(answer: Answer) -> bytes:
    """Return the document of an answer."""
    return xmlrpc.client.dumps(([*answer],), methodresponse=True).encode()


def encode_fault(words: str) -> bytes:
    """Return the document of a fault."""
    return xmlrpc.client.dumps(xmlrpc.client.Fault(1, words), methodresponse=True).encode()


def decode_call(document: bytes) -> tuple[str, list[ParameterValue]]:
    """Return method and arguments of a call. Raises Malformed."""
    arguments, method = _parse(document)
    if not isinstance(method, str):
        raise Malformed("no methodCall")
    return method, [_value(argument) for argument in arguments]


def decode_answer(document: bytes) -> Answer:
    """Return the answer in a document. Raises Malformed, and Refused for a fault."""
    arguments, _ = _parse(document)
    match [_value(argument) for argument in arguments]:
        case [[int(code), words, value]]:
            return Answer(code, str(words), value)
        case other:
            raise Malformed(f"expected [code, words, value], not {str(other)[:80]!r}")


def _parse(document: bytes) -> tuple[tuple[object, ...], str | None]:
    target = xmlrpc.client.Unmarshaller(use_builtin_types=True)
    parser = _parser(target)
    try:
        parser.Parse(document, True)
        return target.close(), target.getmethodname()
    except xmlrpc.client.Fault as fault:
        raise Refused("the call failed", words=str(fault.faultString)) from fault
    except Malformed:
        raise
    except (expat.ExpatError, ValueError, TypeError, LookupError, AttributeError, xmlrpc.client.Error) as error:
        raise Malformed(f"not XML-RPC: {error}") from error


def _parser(target: xmlrpc.client.Unmarshaller) -> expat.XMLParserType:
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise Malformed(f"nested more than {MAX_DEPTH} elements deep")
        target.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        target.end(tag)

    def doctype(*_: object) -> None:
        raise Malformed("XML-RPC does not allow a DOCTYPE")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = target.data
    parser.StartDoctypeDeclHandler = doctype
    target.xml(None, None)  # type: ignore[arg-type]  # no encoding: expat gives str
    return parser


def _value(value: object) -> ParameterValue:
    if isinstance(value, (bool, int, float, str, bytes, datetime)):
        return value
    if isinstance(value, (list, tuple)):
        return [_value(each) for each in value]
    if isinstance(value, dict):
        return {str(key): _value(each) for key, each in value.items()}
    raise Malformed(f"XML-RPC cannot represent a {type(value).__name__}")


class XmlRpcClient:
    """Client of one server, with persistent connections (at most two idle)."""

    def __init__(self, uri: str, path: str, dial: Dial, *, keep_alive: bool) -> None:
        self.uri = uri
        self._path = path or "/RPC2"
        self._host = uri.partition("//")[2].partition("/")[0]
        self._dial = dial
        self._keep_alive = keep_alive
        self._idle: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

    async def call(self, method: str, *arguments: ParameterValue, timeout: float) -> Answer:
        """Return the answer to a call. Raises Unreachable, TimedOut, or Refused for a fault."""
        return self.decode(await self.request(encode_call(method, *arguments), timeout=timeout))

    def decode(self, document: bytes) -> Answer:
        """Return the response in a document of this server. Raises Unreachable if it is malformed."""
        try:
            return decode_answer(document)
        except Malformed as error:
            raise Unreachable(f"{self.uri} does not speak ROS 1's XML-RPC: {error}", sent=Sent.MAYBE) from error

    async def request(self, document: bytes, *, timeout: float) -> bytes:
        """Return the response document. Raises Unreachable, TimedOut."""
        progress = [Sent.NO]
        try:
            return await asyncio.wait_for(self._exchange(document, progress), max(timeout, 0.0))
        except asyncio.TimeoutError as error:
            raise TimedOut(f"{self.uri} did not answer in time", sent=progress[0]) from error
        except (OSError, EOFError, Malformed) as error:
            raise Unreachable(f"{self.uri} cannot be reached: {_words(error)}", sent=progress[0]) from error

    def close(self) -> None:
        """Close the idle connections."""
        for _, writer in self._idle:
            writer.close()
        self._idle.clear()

    async def _exchange(self, document: bytes, progress: list[Sent]) -> bytes:
        while self._idle:  # an idle connection may be dead: try the next one, and finally a new one
            connection = self._idle.pop()
            try:
                return await self._request_over(connection, document, progress)
            except (OSError, EOFError):
                continue
        return await self._request_over(await self._dial(), document, progress)

    async def _request_over(
        self, connection: tuple[asyncio.StreamReader, asyncio.StreamWriter], document: bytes, progress: list[Sent]
    ) -> bytes:
        reader, writer = connection
        is_reusable = False
        try:
            progress[0] = Sent.MAYBE
            writer.write(self._head(len(document)) + document)
            body, is_reusable = await _read_response(reader)
            is_reusable = is_reusable and self._keep_alive and len(self._idle) < MAX_IDLE
            return body
        finally:
            if is_reusable:
                self._idle.append(connection)
            else:
                writer.close()

    def _head(self, length: int) -> bytes:
        connection = "keep-alive" if self._keep_alive else "close"
        return (
            f"POST {self._path} HTTP/1.1\r\nHost: {self._host}\r\nUser-Agent: rosld\r\nContent-Type: text/xml\r\n"
            f"Connection: {connection}\r\nContent-Length: {length}\r\n\r\n"
        ).encode("latin-1", "replace")


async def read_head(reader: asyncio.StreamReader) -> tuple[str, dict[str, str]]:
    """Return first line and header fields (in lower case) of an HTTP message. Raises Malformed, EOFError."""
    try:
        head = await reader.readuntil(b"\r\n\r\n")
    except asyncio.LimitOverrunError as error:
        raise Malformed("its HTTP header does not end") from error
    first, *lines = head.decode("latin-1").split("\r\n")
    pairs = (line.partition(":") for line in lines if ":" in line)
    return first, {name.strip().lower(): value.strip() for name, _, value in pairs}


def content_length(fields: dict[str, str], limit: int = MAX_BYTES) -> int | None:
    """Return the Content-Length in header fields, or None. Raises Malformed."""
    stated = fields.get("content-length")
    if stated is None:
        return None
    if not stated.isascii() or not stated.isdigit() or len(stated) > 12 or int(stated) > limit:
        raise Malformed(f"a Content-Length of {stated[:20]!r}")
    return int(stated)


async def _read_response(reader: asyncio.StreamReader) -> tuple[bytes, bool]:
    """Return the body of a response, and whether the connection may be used again."""
    status, fields = await read_head(reader)
    if " 200" not in status[:13]:
        raise Malformed(f"it answers {status[:60]!r}")
    length = content_length(fields)
    if length is None:
        return await _read_to_end(reader), False
    body = await reader.readexactly(length)
    return body, status.startswith("HTTP/1.1") and fields.get("connection", "").lower() != "close"


async def _read_to_end(reader: asyncio.StreamReader) -> bytes:
    body = bytearray()
    while piece := await reader.read(65536):
        body += piece
        if len(body) > MAX_BYTES:
            raise Malformed(f"its answer is longer than {MAX_BYTES} bytes")
    return bytes(body)


def _words(error: BaseException) -> str:
    if isinstance(error, asyncio.IncompleteReadError):
        return "the connection closed before the response was complete"
    return str(error) or type(error).__name__
