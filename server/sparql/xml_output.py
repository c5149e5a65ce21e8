"""Results as XML, which has no way to write most control characters (XML 1.0, 2.2).

The store's writer writes them as they are, which no reader takes, and so carriage returns, which readers turn into line
feeds (2.11): these are written as references here. Nothing is passed on before the end is seen, or so much that an
answer is no longer held back: what then comes too late to be answered otherwise breaks off.
"""

from __future__ import annotations

import io
import re
from typing import BinaryIO

from rosld.server.http.problem import Problem

MAX_HELD_BYTES = 32 * 1024 * 1024
"""Bytes that are held back."""
_NO_CHARACTER = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]|\xef\xbf[\xbe\xbf]")
REASON = {"reason": "xml"}


def not_in_xml(words: str) -> Problem:
    """The Problem of an answer that XML cannot carry: another format can."""
    return Problem(406, words, extra=dict(REASON))


class XmlOutput(io.RawIOBase):
    """Passes XML on once it is known to be well-formed, or to have more than `limit` bytes."""

    def __init__(self, output: BinaryIO, limit: int) -> None:
        super().__init__()
        self._output = output
        self._limit = limit
        self._held: list[bytes] | None = []
        self._size = 0
        self._rest = b""

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Take bytes. Raises Problem 406 for a character that XML has not."""
        piece = bytes(data)
        if found := _NO_CHARACTER.search(self._rest + piece):
            number = ord(found[0].decode())
            raise not_in_xml(f"XML cannot carry the character U+{number:04X}, which is in the results: ask for JSON.")
        self._rest = piece[-2:]
        self._pass_on(piece.replace(b"\r", b"&#13;"))
        return len(piece)

    def _pass_on(self, piece: bytes) -> None:
        if self._held is None:
            self._output.write(piece)
            return
        self._held.append(piece)
        self._size += len(piece)
        if self._size > self._limit:
            self.finish()

    def finish(self) -> None:
        """Pass on what is held back."""
        held, self._held = self._held, None
        for piece in held or ():
            self._output.write(piece)
