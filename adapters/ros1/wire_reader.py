"""Reader of ROS 1's message fields one after another, for messages with a fixed definition."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import TypeVar

_T = TypeVar("_T")
_BOOL, _LENGTH, _INT32, _FLOAT64 = struct.Struct("<?"), struct.Struct("<I"), struct.Struct("<i"), struct.Struct("<d")


class WireReader:
    """Reads the fields of a message in order. Methods raise ValueError if the message is truncated."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def skip(self, count: int) -> bytes:
        """Return the next `count` bytes."""
        start, self._at = self._at, self._at + count
        if self._at > len(self._data):
            raise ValueError("the message is cut off")
        return self._data[start : self._at]

    def length(self) -> int:
        """Return the next uint32, the length of the following data."""
        return int(_LENGTH.unpack(self.skip(_LENGTH.size))[0])

    def int32(self) -> int:
        """Return an int32."""
        return int(_INT32.unpack(self.skip(_INT32.size))[0])

    def float64(self) -> float:
        """Return a float64."""
        return float(_FLOAT64.unpack(self.skip(_FLOAT64.size))[0])

    def bool(self) -> bool:
        """Return a bool."""
        return bool(_BOOL.unpack(self.skip(_BOOL.size))[0])

    def text(self) -> str:
        """Return a string; bytes that are not UTF-8 are surrogate escapes."""
        return self.skip(self.length()).decode("utf-8", "surrogateescape")

    def array(self, read: Callable[[], _T], limit: int) -> list[_T]:
        """Return an array of elements returned by `read`. Raises ValueError if it is longer than `limit`."""
        count = self.length()
        if count > limit:
            raise ValueError(f"{count} elements exceed the limit of {limit}")
        return [read() for _ in range(count)]

    def rest(self) -> bytes:
        """Return all remaining bytes."""
        return self._data[self._at :]
