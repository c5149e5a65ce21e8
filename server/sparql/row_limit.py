"""Row counters for the bytes of an answer, to enforce a row limit.

The store's own writers are many times faster than a loop over rows in Python, but do not report rows: the rows are
counted in their output, by marks that can only occur between values, or outside of quoted text.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping
from typing import BinaryIO, cast

from rosld.server.sparql.query_limits import too_many_rows

_UNSEEN = 4 * 1024 * 1024
"""Number of bytes held for counting later."""


def limit_rows(output: BinaryIO, media_type: str, graph: bool, limit: int) -> BinaryIO:
    """Return an output that raises Problem 503 (rows) for more than `limit` rows, or triples of a `graph`.

    Returns `output` itself for a media type whose rows cannot be counted in its bytes.
    """
    if media_type == "application/json":
        media_type = "" if graph else "application/sparql-results+json"
    if media_type not in _COUNTERS:
        return output
    make, shortest = _COUNTERS[media_type]
    return cast("BinaryIO", _RowLimiter(output, make(), limit, min(limit * shortest, _UNSEEN)))


def has_counter(media_type: str) -> bool:
    """Whether the rows of solutions in a media type can be counted in its bytes."""
    return media_type in _COUNTERS


def count_rows(whole: bytes, media_type: str) -> int:
    """Return the number of rows of a complete result in a media type that has a counter."""
    make, _ = _COUNTERS[media_type]
    return make()(whole)


class _RowLimiter(io.RawIOBase):
    """Output that starts counting only when rows of minimum length could exceed the limit; most answers never do."""

    def __init__(self, output: BinaryIO, rows: Callable[[bytes], int], limit: int, harmless: int) -> None:
        super().__init__()
        self._output = output
        self._harmless = harmless
        self._rows = rows
        self._limit = limit
        self._left = limit
        self._unseen: list[bytes] | None = []
        self._size = 0

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        """Pass bytes on, unless a row beyond the limit begins in them."""
        if self._unseen is None:
            self._count(data)
        else:
            self._unseen.append(bytes(data))
            self._size += len(data)
            if self._size > self._harmless:
                everything, self._unseen = b"".join(self._unseen), None
                self._count(everything)
        return self._output.write(data)

    def _count(self, data: bytes) -> None:
        self._left -= self._rows(data)
        if self._left < 0:
            raise too_many_rows(self._limit)


class _Marks:
    """Counter of a mark that never occurs in a value. Handles marks split between chunks."""

    def __init__(self, mark: bytes, before: int = 0) -> None:
        self._mark = mark
        self._rest = b""
        self._before = before

    def __call__(self, data: bytes) -> int:
        text = self._rest + data
        self._rest = text[len(text) - len(self._mark) + 1 :] if len(self._mark) > 1 else b""
        found = text.count(self._mark)
        ignored = min(found, self._before)
        self._before -= ignored
        return found - ignored


class _CsvRows:
    """Counter of line ends outside of quotes; a doubled quote within a field does not affect it."""

    def __init__(self) -> None:
        self._quoted = False
        self._heading = 1

    def __call__(self, data: bytes) -> int:
        if not self._quoted and b'"' not in data:
            found = data.count(b"\n")
        else:
            pieces = data.split(b'"')
            found = sum(piece.count(b"\n") for piece in pieces[self._quoted :: 2])
            self._quoted ^= not len(pieces) % 2
        heading = min(found, self._heading)
        self._heading -= heading
        return found - heading


class _JsonRows:
    r"""Counter of the commas between the objects of `bindings`, plus one for the first object.

    `,{"` separates rows. Within text every quote is escaped, so elsewhere this sequence can only be the end of a text
    that ends in `,{`: then `}` or `,` follows. A row without values is `{}`, which may also occur in text: only where
    it occurs is quoted text tracked (a `{}` split between chunks is missed).
    """

    def __init__(self) -> None:
        self._rest = b""
        self._quoted = False
        self._escape = b""
        self._first = 1

    def __call__(self, data: bytes) -> int:
        text = self._rest + data
        found = text.count(b',{"') - self._rest.count(b',{"') - text.count(b',{"}') - text.count(b',{",')
        self._rest = text[-3:]
        found += self._empty(data)
        if self._first and b'"bindings":[{' in text:
            found, self._first = found + 1, 0
        return found

    def _empty(self, data: bytes) -> int:
        if b"\\" in data or self._escape:
            plain = self._escape + data
            self._escape = b"\\" if (len(plain) - len(plain.rstrip(b"\\"))) % 2 else b""
            data = _ESCAPE.sub(b"", plain[: len(plain) - len(self._escape)])
        quoted, quotes = self._quoted, data.count(b'"')
        self._quoted ^= bool(quotes % 2)
        if b",{}" not in data:
            return 0
        return sum(piece.count(b",{}") for piece in data.split(b'"')[quoted::2])


_ESCAPE = re.compile(rb"\\.", re.DOTALL)
_COUNTERS: Mapping[str, tuple[Callable[[], Callable[[bytes], int]], int]] = {
    "application/sparql-results+json": (_JsonRows, len(",{}")),
    "application/sparql-results+xml": (lambda: _Marks(b"<result>"), len("<result></result>")),
    "application/xml": (lambda: _Marks(b"<result>"), len("<result></result>")),
    "text/xml": (lambda: _Marks(b"<result>"), len("<result></result>")),
    "text/csv": (_CsvRows, 1),
    "text/tab-separated-values": (lambda: _Marks(b"\n", before=1), 1),
    "application/n-triples": (lambda: _Marks(b"\n"), 1),
    "application/n-quads": (lambda: _Marks(b"\n"), 1),
}
"""Row counter of each media type, and the bytes of its shortest row."""
