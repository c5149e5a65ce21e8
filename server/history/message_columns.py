"""Messages of one type as arrays of Arrow, a column for each leaf field. Needs pyarrow: import this module when needed.

A column is named by the path of its field (`twist.twist.linear.x`). Messages of one layout are converted by columns of
their bytes, others from decoded messages.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pyarrow as pa
from msgspec import Struct
from numpy.typing import NDArray

from rosld.adapters.model import OCTETS, STRINGS, Array, Field, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.units import quantity_at
from rosld.server.history.message_block import Layout

TIME, DURATION = "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"
_NUMBERS = {"bool": "?", "byte": "i1", "char": "u1", "float32": "f4", "float64": "f8"} | {
    f"{sign}int{bits}": f"{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_Lengths: TypeAlias = NDArray[np.int64]


class DecodedValues(Struct, frozen=True):
    """Values of a field of decoded messages."""

    values: Sequence[Any]

    def numbers(self, kind: str) -> NDArray[Any]:
        return np.asarray(self.values, kind)

    def texts(self) -> tuple[_Lengths, bytes]:
        texts = [each.encode("utf-8", "surrogateescape") for each in self.values]
        return np.array([len(each) for each in texts], np.int64), b"".join(texts)

    def field(self, field: Field) -> MessageValues:
        return DecodedValues([getattr(each, field.attribute) for each in self.values])

    def elements(self, kind: Array) -> tuple[_Lengths, MessageValues]:
        lengths = np.array([len(each) for each in self.values], np.int64)
        if isinstance(kind.element, Primitive) and kind.element.name in _NUMBERS and len(lengths):
            return lengths, DecodedValues(np.concatenate(self.values))  # type: ignore[arg-type]
        return lengths, DecodedValues([each for one in self.values for each in one])

    def __len__(self) -> int:
        return len(self.values)


class RowValues:
    """Values at the same places of messages of one layout, for each of some paths."""

    def __init__(self, data: NDArray[np.uint8], layout: Layout, paths: Sequence[tuple[str, ...]] = ((),)) -> None:
        self._data = data
        self._layout = layout
        self._paths = paths

    def __len__(self) -> int:
        return len(self._data) * len(self._paths)

    def numbers(self, kind: str) -> NDArray[Any]:
        if not self._paths:
            return np.empty(0, kind)
        cells = np.concatenate([self._layout.cells(self._data, path) for path in self._paths], axis=1)
        return cells.reshape(-1).astype(kind, copy=False)

    def texts(self) -> tuple[_Lengths, bytes]:
        return self._lengths(), self.numbers("u1").tobytes()

    def field(self, field: Field) -> MessageValues:
        return RowValues(self._data, self._layout, [(*path, field.name) for path in self._paths])

    def elements(self, kind: Array) -> tuple[_Lengths, MessageValues]:
        if isinstance(kind.element, Primitive) and kind.element.name in _NUMBERS:
            return self._lengths(), self
        counts = self._layout.counts
        paths = [(*path, str(number)) for path in self._paths for number in range(counts[path])]
        return self._lengths(), RowValues(self._data, self._layout, paths)

    def _lengths(self) -> _Lengths:
        return np.tile(np.array([self._layout.counts[path] for path in self._paths], np.int64), len(self._data))


MessageValues: TypeAlias = "DecodedValues | RowValues"
"""Values of a field in the order of the messages, those of an array one after the other."""


class _Leaf(NamedTuple):
    """A field that is a column; `fields` lead to it."""

    path: str
    fields: tuple[Field, ...]
    kind: FieldType


class MessageColumns:
    """Conversion of messages of one type into arrays, a column for each leaf field."""

    def __init__(self, schema: MessageSchema) -> None:
        self.schema = schema
        self.leaves = tuple(self._leaves(schema.ref.name, ()))
        self.fields = tuple(self._field(each.path, each.path, each.kind) for each in self.leaves)

    def arrays_of(self, source: MessageValues) -> list[pa.Array]:
        """Return the columns of messages."""
        found: dict[tuple[Field, ...], MessageValues] = {(): source}
        arrays = []
        for leaf in self.leaves:
            for depth in range(1, len(leaf.fields) + 1):
                if leaf.fields[:depth] not in found:
                    found[leaf.fields[:depth]] = found[leaf.fields[: depth - 1]].field(leaf.fields[depth - 1])
            arrays.append(self._array(leaf.kind, found[leaf.fields], leaf.path))
        return arrays

    def _leaves(self, name: str, fields: tuple[Field, ...]) -> Iterator[_Leaf]:
        for field in self.schema.types[name].fields:
            within = (*fields, field)
            if isinstance(field.type, Nested) and field.type.name not in (TIME, DURATION):
                yield from self._leaves(field.type.name, within)
            else:
                yield _Leaf(".".join(each.name for each in within), within, field.type)

    def _field(self, name: str, path: str, kind: FieldType) -> pa.Field:
        """Return a field of Arrow, with the unit (QUDT) of its numbers as metadata."""
        unit = quantity_at(self.schema, path).unit
        return pa.field(name, self._type(kind, path), metadata=None if unit is None else {"unit": unit})

    def _type(self, kind: FieldType, path: str) -> pa.DataType:
        if isinstance(kind, Nested):
            if kind.name in (TIME, DURATION):
                return pa.timestamp("ns", "UTC") if kind.name == TIME else pa.duration("ns")
            fields = self.schema.types[kind.name].fields
            within = [self._field(each.name, f"{path}.{each.name}", each.type) for each in fields]
            return pa.struct(within) if within else pa.uint8()  # Parquet has no structure without members
        if isinstance(kind, Array):
            if isinstance(kind.element, Primitive) and kind.element.name in OCTETS:
                return pa.binary(kind.length or -1)
            return pa.list_(self._type(kind.element, path), kind.length or -1)
        return pa.string() if kind.name in STRINGS else pa.from_numpy_dtype(np.dtype(_NUMBERS[kind.name]))

    def _array(self, kind: FieldType, source: MessageValues, path: str) -> pa.Array:
        type = self._type(kind, path)
        if isinstance(kind, Nested):
            fields = self.schema.types[kind.name].fields
            if kind.name in (TIME, DURATION):
                seconds, rest = (source.field(field).numbers("i8") for field in fields)
                return pa.array(seconds * 1_000_000_000 + rest).view(type)
            if not fields:
                return pa.array(np.zeros(len(source), np.uint8))
            within = [self._array(each.type, source.field(each), f"{path}.{each.name}") for each in fields]
            return pa.StructArray.from_arrays(within, fields=list(type))
        if isinstance(kind, Array):
            lengths, elements = source.elements(kind)
            if pa.types.is_fixed_size_binary(type):
                octets = elements.numbers("u1").tobytes()
                return pa.FixedSizeBinaryArray.from_buffers(type, len(lengths), [None, pa.py_buffer(octets)])
            if pa.types.is_binary(type):
                return _of_bytes(type, lengths, elements.numbers("u1").tobytes())
            values = self._array(kind.element, elements, path)
            if pa.types.is_fixed_size_list(type):
                return pa.FixedSizeListArray.from_arrays(values, type=type)
            return pa.ListArray.from_arrays(pa.array(_offsets(lengths)), values, type=type)
        if kind.name in STRINGS:
            return _strings(*source.texts())
        return pa.array(source.numbers(_NUMBERS[kind.name]), type)


def _offsets(lengths: _Lengths) -> NDArray[np.int32]:
    offsets = np.zeros(len(lengths) + 1, np.int32)
    np.cumsum(lengths, out=offsets[1:])
    return offsets


def _of_bytes(type: pa.DataType, lengths: _Lengths, octets: bytes) -> pa.Array:
    """Return an array of strings or octets that stand one after the other."""
    buffers = [None, pa.py_buffer(_offsets(lengths).tobytes()), pa.py_buffer(octets)]
    return pa.Array.from_buffers(type, len(lengths), buffers)


def _strings(lengths: _Lengths, octets: bytes) -> pa.Array:
    """Return an array of strings; bytes that are not UTF-8 are replaced by U+FFFD."""
    if octets.isascii():
        return _of_bytes(pa.string(), lengths, octets)
    ends = np.cumsum(lengths).tolist()
    texts = (octets[start:end] for start, end in zip([0, *ends], ends, strict=False))
    return pa.array([each.decode("utf-8", "replace") for each in texts], pa.string())
