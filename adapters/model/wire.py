"""Wire formats, read and written field by field: slow and exact, including strings that are not UTF-8.

A fallback for messages that rosbags' compiled serializers (`codec.py`) reject. Strings are decoded with surrogate
escapes, so that any bytes are preserved. ROS 1: little endian, no alignment, strings without a terminator. CDR (XCDR1):
a four-byte header, primitives aligned to their size, strings with a terminating NUL.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from typing import TypeAlias, cast

import numpy as np

from rosld.adapters.model.schema import Array, Encoding, FieldType, Message, MessageType, Nested, Primitive

Build: TypeAlias = Callable[[str, Mapping[str, object]], Message]

_FORMATS = {
    "bool": "?",
    "byte": "b",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_DTYPES = {"bool": "?", "byte": "i1", "char": "u1", "int8": "i1", "uint8": "u1", "float32": "f4", "float64": "f8"} | {
    f"{sign}int{bits}": f"{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (16, 32, 64)
}


class Reader:
    """Reads one message from bytes. Methods raise ValueError if the bytes are truncated."""

    def __init__(self, data: bytes, encoding: Encoding, types: Mapping[str, MessageType], build: Build) -> None:
        self._cdr = encoding is Encoding.CDR
        self._order = ">" if self._cdr and data[1:2] == b"\x00" else "<"
        self._data = memoryview(data)[4:] if self._cdr else memoryview(data)
        self._position = 0
        self._types = types
        self._build = build

    def message(self, name: str) -> Message:
        """Return the message of type `name` at the current position."""
        fields = self._types[name].fields
        if not fields and self._cdr:
            self._take(1)
        return self._build(name, {field.attribute: self._value(field.type) for field in fields})

    def end(self) -> None:
        """Raise ValueError unless everything (except CDR's padding) was read."""
        left = len(self._data) - self._position
        if left > (3 if self._cdr else 0):
            raise ValueError(f"{left} bytes are left over after the message")

    def _align(self, size: int) -> None:
        if self._cdr:
            self._position += -self._position % size

    def _take(self, size: int) -> memoryview:
        start, end = self._position, self._position + size
        if end > len(self._data):
            raise ValueError(f"the message ends at byte {len(self._data)}, where byte {end} was needed")
        self._position = end
        return self._data[start:end]

    def _length(self) -> int:
        self._align(4)
        return cast(int, struct.unpack(self._order + "I", self._take(4))[0])

    def _value(self, kind: FieldType) -> object:
        if isinstance(kind, Nested):
            return self.message(kind.name)
        if isinstance(kind, Array):
            return self._array(kind)
        return self._primitive(kind)

    def _primitive(self, kind: Primitive) -> object:
        if kind.name in ("string", "wstring"):
            return self._string()
        code = _FORMATS[kind.name]
        size = struct.calcsize(code)
        self._align(size)
        return struct.unpack(self._order + code, self._take(size))[0]

    def _string(self) -> str:
        octets = bytes(self._take(self._length()))
        return octets[: -1 if self._cdr else None].decode("utf-8", "surrogateescape")

    def _array(self, kind: Array) -> object:
        length = self._length() if kind.length is None else kind.length
        if isinstance(kind.element, Primitive) and kind.element.name in _FORMATS:
            dtype = np.dtype(self._order + _DTYPES[kind.element.name])
            if length:
                self._align(dtype.itemsize)
            values = np.frombuffer(self._take(length * dtype.itemsize), dtype)
            return values.astype(_DTYPES[kind.element.name])
        if length > len(self._data):
            raise ValueError(f"an array of {length} elements cannot be in {len(self._data)} bytes")
        return [self._value(kind.element) for _ in range(length)]


class Writer:
    """Writes one message to bytes. Raises ValueError naming a field that does not fit."""

    def __init__(self, encoding: Encoding, types: Mapping[str, MessageType]) -> None:
        self._cdr = encoding is Encoding.CDR
        self._parts = bytearray()
        self._types = types

    def octets(self) -> bytes:
        """Return the written bytes, with CDR's header if needed."""
        return (b"\x00\x01\x00\x00" if self._cdr else b"") + bytes(self._parts)

    def message(self, name: str, message: object) -> None:
        """Append a message of type `name`."""
        fields = self._types[name].fields
        if not fields and self._cdr:
            self._parts += b"\x00"
        for field in fields:
            try:
                self._value(field.type, getattr(message, field.attribute))
            except (struct.error, TypeError, AttributeError) as error:
                raise ValueError(f"{name} field {field.name}: {error}") from error

    def _align(self, size: int) -> None:
        if self._cdr:
            self._parts += bytes(-len(self._parts) % size)

    def _pack(self, code: str, value: object) -> None:
        self._align(struct.calcsize(code))
        self._parts += struct.pack("<" + code, value)

    def _value(self, kind: FieldType, value: object) -> None:
        if isinstance(kind, Nested):
            self.message(kind.name, value)
        elif isinstance(kind, Array):
            self._array(kind, cast("Iterable[object]", value))
        elif kind.name in ("string", "wstring"):
            self._string(cast(str, value))
        else:
            self._pack(_FORMATS[kind.name], value)

    def _string(self, value: str) -> None:
        octets = value.encode("utf-8", "surrogateescape") + (b"\x00" if self._cdr else b"")
        self._pack("I", len(octets))
        self._parts += octets

    def _array(self, kind: Array, values: Iterable[object]) -> None:
        if isinstance(values, np.ndarray):
            values = values.tolist()
        items = list(values)
        if kind.length is None:
            self._pack("I", len(items))
        elif len(items) != kind.length:
            raise ValueError(f"an array must have exactly {kind.length} elements, not {len(items)}")
        for item in items:
            self._value(kind.element, item)
