"""Fields of MCAP records (https://mcap.dev/spec): little endian; lengths before strings, bytes, maps. No I/O."""

from __future__ import annotations

from typing import ClassVar

MAGIC = b"\x89MCAP0\r\n"
OPENING = "rosld.opening"
"""Key of a channel's metadata that is "1" if its messages are latched ones from before the start of the file."""
SILENT_TOPICS = "rosld.silent_topics"
"""Name of the metadata record whose keys are the selected topics without a message."""


class Fields:
    """Reader of the fields of a record. Raises `too_short` if the record is truncated."""

    too_short: ClassVar[type[Exception]] = ValueError
    errors: ClassVar[str] = "surrogateescape"
    """Error handler for bytes that are not UTF-8."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def uint(self, size: int) -> int:
        """Return an unsigned integer of this size."""
        return int.from_bytes(self._take(size), "little")

    def text(self) -> str:
        """Return a string."""
        return self._take(self.uint(4)).decode("utf-8", self.errors)

    def octets(self) -> bytes:
        """Return bytes after their length."""
        return self._take(self.uint(4))

    def texts(self) -> dict[str, str]:
        """Return a map of strings."""
        inner = type(self)(self.octets())
        texts: dict[str, str] = {}
        while inner.more():
            key = inner.text()
            texts[key] = inner.text()
        return texts

    def more(self) -> bool:
        """Whether anything is left."""
        return self._at < len(self._data)

    def _take(self, size: int) -> bytes:
        data = self._data[self._at : self._at + size]
        if len(data) != size:
            raise self.too_short("a record is shorter than its fields")
        self._at += size
        return data
