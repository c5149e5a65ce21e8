"""The head of an HTTP/1.1 request: whether and how the rest may be read (RFC 9112).

An `Upgrade` that is not accepted is ignored (RFC 9110 7.8), which the parser (llhttp) cannot do: it stops at the end of
the head, and the rest would be read as the next request although it may be the body of this one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rosld.server.http.problem import Problem

Headers = Sequence[tuple[bytes, bytes]]
_VERSIONS = ("1.0", "1.1")
LONGEST_TARGET = 0xFFFF
"""Maximum number of bytes of a request target that httptools can split into path and query."""


class RequestHead(NamedTuple):
    """Request line and header fields, the names in lower case."""

    method: bytes
    target: bytes
    version: str
    headers: Headers

    @property
    def size(self) -> int:
        """Number of bytes of the head, without white space around values."""
        line = len(self.method) + len(self.target) + len("  HTTP/1.1\r\n")
        return line + sum(len(name) + len(value) + len(": \r\n") for name, value in self.headers) + len("\r\n")

    @property
    def is_websocket_handshake(self) -> bool:
        """Whether the request opens a WebSocket, and has no body (RFC 6455 4.2.1).

        Java's client states a body of zero bytes.
        """
        names = {name for name, _ in self.headers}
        return (
            self.method == b"GET"
            and self.version == "1.1"
            and [value.strip(b" \t").lower() for value in self._values(b"upgrade")] == [b"websocket"]
            and {b"sec-websocket-key", b"sec-websocket-version"} <= names
            and b"transfer-encoding" not in names
            and set(self._values(b"content-length")) <= {b"0"}
        )

    @property
    def without_upgrade(self) -> bytes:
        """Head without its `Upgrade` fields."""
        lines = [b"%b %b HTTP/%b\r\n" % (self.method, self.target, self.version.encode("ascii"))]
        lines += [b"%b: %b\r\n" % (name, value) for name, value in self.headers if name != b"upgrade"]
        return b"".join((*lines, b"\r\n"))

    def check(self) -> None:
        """Raise the Problem of a request that cannot be read completely or unambiguously."""
        if len(self.target) > LONGEST_TARGET:
            raise Problem(431, f"The request line is longer than {LONGEST_TARGET} bytes.")
        if self.version not in _VERSIONS:
            raise Problem(505, f"HTTP/{self.version} is not supported: send HTTP/1.1.")
        if self.method == b"CONNECT":
            raise Problem(501, "This server is not a proxy: CONNECT is not supported.")
        codings = self._values(b"transfer-encoding")
        if codings and self.version == "1.0":
            raise Problem(400, "An HTTP/1.0 request cannot have a Transfer-Encoding (RFC 9112 6.1).")
        if codings and [coding.strip(b" \t").lower() for coding in codings] != [b"chunked"]:
            named = b", ".join(codings).decode("latin-1")[:200]
            raise Problem(501, f"Only the transfer coding chunked is supported, not {named!r}.")

    def _values(self, name: bytes) -> list[bytes]:
        return [value for each, value in self.headers if each == name]
