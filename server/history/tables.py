"""Topics of recordings as flat tables for Parquet, Arrow and CSV, by pyarrow (the extra `rosld[parquet]`).

One row a message, one column a leaf field, named by its path (`twist.twist.linear.x`). Before them stand `received`
(the time of recording), `index` (the number in the recording) and `publisher`; a field of one of these names gets an
underscore at its end. Messages whose layout is the same are converted by columns, the others are decoded one by one.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, Protocol, TypeAlias

import numpy as np
import orjson
from numpy.typing import NDArray

from rosld.adapters.base import FOR_EVER, MessageFilter, RecordedMessage, Recording
from rosld.adapters.model import (
    OCTETS,
    STRINGS,
    Array,
    Field,
    FieldType,
    MessageSchema,
    Nested,
    Primitive,
    TypeRef,
    UnknownType,
)
from rosld.ontology.literals import base64_text, json_numbers, special_float
from rosld.ontology.units import quantity_at
from rosld.server.history.message_block import Layout, MessageBlock, layout_of

if TYPE_CHECKING:
    import pyarrow as pa

TableParts: TypeAlias = "tuple[pa.Schema, Iterable[pa.Table]]"
"""A table as its schema and its parts."""
TIME, DURATION = "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"
OWN = ("received", "index", "publisher")
"""Columns of every table, before those of the fields."""
_PAGE = 4096
"""Number of messages read at a time."""
_LEAST_ROWS = 8
"""Number of messages of one layout below which decoding them is as fast as reading their columns."""
_GROUP_ROWS = 65_536
_GROUP_BYTES = 32 * 1024 * 1024
"""Size of a row group, after which it is written: what a table needs of memory does not depend on its length."""
_NUMBERS = {"bool": "?", "byte": "i1", "char": "u1", "float32": "f4", "float64": "f8"} | {
    f"{sign}int{bits}": f"{sign or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_Lengths = NDArray[np.int64]


class NoPyarrow(ValueError):
    """Why no table can be written: pyarrow is not installed."""


class NoTable(ValueError):
    """Why a topic has no table: a sentence without its full stop."""


def require_pyarrow() -> None:
    """Raise NoPyarrow unless pyarrow is installed."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise NoPyarrow("tables need pyarrow: pip install 'rosld[parquet]'") from error


# Values of one field in many messages, in two sources


class _Source(Protocol):
    """Values of a field in the order of the messages, those of an array one after the other."""

    def __len__(self) -> int: ...

    def numbers(self, kind: str) -> NDArray[Any]:
        """Return the values as numbers of a dtype."""
        ...

    def texts(self) -> tuple[_Lengths, bytes]:
        """Return the length in bytes of each string, and their bytes."""
        ...

    def field(self, field: Field) -> _Source:
        """Return the values of a field of these messages."""
        ...

    def elements(self, kind: Array) -> tuple[_Lengths, _Source]:
        """Return the length of each array, and their elements."""
        ...


class _Decoded(NamedTuple):
    """Values of a field of decoded messages."""

    values: Sequence[Any]

    def numbers(self, kind: str) -> NDArray[Any]:
        return np.asarray(self.values, kind)

    def texts(self) -> tuple[_Lengths, bytes]:
        texts = [each.encode("utf-8", "surrogateescape") for each in self.values]
        return np.array([len(each) for each in texts], np.int64), b"".join(texts)

    def field(self, field: Field) -> _Source:
        return _Decoded([getattr(each, field.attribute) for each in self.values])

    def elements(self, kind: Array) -> tuple[_Lengths, _Source]:
        lengths = np.array([len(each) for each in self.values], np.int64)
        if isinstance(kind.element, Primitive) and kind.element.name in _NUMBERS and len(lengths):
            return lengths, _Decoded(np.concatenate(self.values))  # type: ignore[arg-type]
        return lengths, _Decoded([each for one in self.values for each in one])

    def __len__(self) -> int:
        return len(self.values)


class _Rows:
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
        return np.concatenate([self._layout.cells(self._data, path) for path in self._paths], axis=1).reshape(-1)

    def texts(self) -> tuple[_Lengths, bytes]:
        return self._lengths(), self.numbers("u1").tobytes()

    def field(self, field: Field) -> _Source:
        return _Rows(self._data, self._layout, [(*path, field.name) for path in self._paths])

    def elements(self, kind: Array) -> tuple[_Lengths, _Source]:
        if isinstance(kind.element, Primitive) and kind.element.name in _NUMBERS:
            return self._lengths(), self
        counts = self._layout.counts
        paths = [(*path, str(number)) for path in self._paths for number in range(counts[path])]
        return self._lengths(), _Rows(self._data, self._layout, paths)

    def _lengths(self) -> _Lengths:
        return np.tile(np.array([self._layout.counts[path] for path in self._paths], np.int64), len(self._data))


# Types and arrays of Arrow


class _Leaf(NamedTuple):
    """A field that is a column; `fields` lead to it."""

    path: str
    fields: tuple[Field, ...]
    kind: FieldType


class MessageColumns:
    """Conversion of messages of one type into arrays, a column for each leaf field."""

    def __init__(self, schema: MessageSchema) -> None:
        """Raises NoPyarrow."""
        require_pyarrow()
        self.schema = schema
        self.leaves = tuple(self._leaves(schema.ref.name, ()))
        self.fields = tuple(self._field(each.path, each.path, each.kind) for each in self.leaves)

    def arrays_of(self, source: _Source) -> list[pa.Array]:
        """Return the columns of messages."""
        found: dict[tuple[Field, ...], _Source] = {(): source}
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
        import pyarrow as pa

        unit = quantity_at(self.schema, path).unit
        return pa.field(name, self._type(kind, path), metadata=None if unit is None else {"unit": unit})

    def _type(self, kind: FieldType, path: str) -> pa.DataType:
        import pyarrow as pa

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

    def _array(self, kind: FieldType, source: _Source, path: str) -> pa.Array:
        import pyarrow as pa

        type = self._type(kind, path)
        if isinstance(kind, Nested):
            fields = self.schema.types[kind.name].fields
            if kind.name in (TIME, DURATION):
                seconds, rest = (source.field(field).numbers("i8") for field in fields)
                return pa.array(seconds.astype("i8") * 1_000_000_000 + rest).cast(pa.int64()).view(type)
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
    import pyarrow as pa

    buffers = [None, pa.py_buffer(_offsets(lengths).tobytes()), pa.py_buffer(octets)]
    return pa.Array.from_buffers(type, len(lengths), buffers)


def _strings(lengths: _Lengths, octets: bytes) -> pa.Array:
    """Return an array of strings; bytes that are not UTF-8 are replaced by U+FFFD."""
    import pyarrow as pa

    if octets.isascii():
        return _of_bytes(pa.string(), lengths, octets)
    ends = np.cumsum(lengths).tolist()
    texts = (octets[start:end] for start, end in zip([0, *ends], ends, strict=False))
    return pa.array([each.decode("utf-8", "replace") for each in texts], pa.string())


# Tables of topics


class Rows(NamedTuple):
    """The rows of a table: messages of a recording from `start` to `end` (exclusive), recorded between two times."""

    start: int = 0
    end: int = FOR_EVER
    from_ns: int = 0
    to_ns: int = FOR_EVER
    most: int = FOR_EVER
    """Maximum number of rows."""


ALL = Rows()


class TopicTable:
    """The messages of a topic as a table, read in parts. Belongs to one thread at a time.

    A topic whose messages have several types is one table, too: fields of the same name and type are one column, whose
    value is null in messages without it; one of the same name and another type gets an underscore.
    """

    def __init__(
        self,
        recording: Recording,
        topic: str,
        may_read: Callable[[int], bool] | None = None,
        shown: Callable[[str], bool] | None = None,
    ) -> None:
        """`may_read` says which messages are rows (None: all), `shown` which publishers are named.

        Raises NoTable if no message of the topic can be read, and NoPyarrow.
        """
        require_pyarrow()
        import pyarrow as pa

        self.unreadable = 0
        """Number of messages that were left out, because they cannot be decoded."""
        self._recording = recording
        self._topic = topic
        self._may_read = may_read
        self._shown = shown
        self._types: dict[TypeRef, tuple[MessageColumns, Sequence[str]]] = {}
        fields = {
            "received": pa.field("received", pa.timestamp("ns", "UTC"), nullable=False),
            "index": pa.field("index", pa.int64(), nullable=False),
            "publisher": pa.field("publisher", pa.string()),
        }
        for ref in types_of(recording, topic):
            with suppress(UnknownType):
                schema = recording.schema(ref)
                if isinstance(schema, MessageSchema):
                    columns = MessageColumns(schema)
                    self._types[ref] = columns, [_add_field(fields, field) for field in columns.fields]
        if not self._types:
            reason = recording.topics[topic].unreadable or "their types are not known"
            raise NoTable(f"the messages of {topic} in {recording.name} cannot be read: {reason}")
        metadata = {
            "topic": topic,
            "recording": recording.name,
            "type": " ".join(ref.name for ref in self._types),
            "hash": " ".join(columns.schema.ref.hash or "" for columns, _ in self._types.values()),
        }
        self.schema = pa.schema(list(fields.values()), metadata)

    def parts(self, rows: Rows = ALL) -> Iterator[pa.Table]:
        """Yield the table in parts, in the order of the messages. Slow: call it in a thread."""
        start: int | None = max(rows.start, self._recording.first)
        left = rows.most
        while start is not None and left > 0:
            wanted = MessageFilter(frozenset({self._topic}), rows.from_ns, rows.to_ns, start, rows.end)
            page = self._recording.select(wanted, min(_PAGE, left))
            left -= len(page.messages)
            start = page.next
            if page.messages:
                yield self.table_of(page.messages)

    def table_of(self, messages: Iterable[RecordedMessage]) -> pa.Table:
        """Return messages of the topic as a table; those that cannot be decoded are counted and left out."""
        import pyarrow as pa

        if self._may_read is not None:
            messages = [each for each in messages if self._may_read(each.index)]
        parts: list[pa.Table] = []
        single: dict[TypeRef, list[RecordedMessage]] = {}
        for block in MessageBlock.grouped(messages):
            ref, rows = block.channel.type, block.rows
            assert rows is not None
            if ref not in self._types:
                self.unreadable += len(rows.times)
                continue
            layout = None
            if len(rows.times) >= _LEAST_ROWS:
                layout = layout_of(rows, self._types[ref][0].schema, block.channel.encoding)
            if layout is None:
                single.setdefault(ref, []).extend(block.messages())
                continue
            publishers = [block.channel.publisher] * len(rows.times)
            parts.append(self._part(ref, rows.times, block.numbers(), publishers, _Rows(rows.data, layout)))
        for ref, members in single.items():
            decoded = list(self._decode(ref, members))
            parts.append(
                self._part(
                    ref,
                    np.array([each.sample.received_ns for each, _ in decoded], np.int64),
                    [each.index for each, _ in decoded],
                    [each.sample.publisher for each, _ in decoded],
                    _Decoded([message for _, message in decoded]),
                )
            )
        if not parts:
            return self.schema.empty_table()
        return parts[0] if len(parts) == 1 and not single else pa.concat_tables(parts).sort_by("index")

    def _decode(self, ref: TypeRef, messages: Iterable[RecordedMessage]) -> Iterator[tuple[RecordedMessage, Any]]:
        codec = self._types[ref][0].schema.codec
        for each in messages:
            try:
                yield each, codec.decode(each.sample.data, each.sample.encoding)
            except ValueError:
                self.unreadable += 1

    def _part(
        self, ref: TypeRef, times: NDArray[np.int64], numbers: Sequence[int], publishers: Sequence[str], source: _Source
    ) -> pa.Table:
        import pyarrow as pa

        columns, names = self._types[ref]
        named = {
            each: each if each and (self._shown is None or self._shown(each)) else None for each in set(publishers)
        }
        arrays = {
            "received": pa.array(times).view(pa.timestamp("ns", "UTC")),
            "index": pa.array(numbers, pa.int64()),
            "publisher": pa.array([named[each] for each in publishers], pa.string()),
            **dict(zip(names, columns.arrays_of(source), strict=True)),
        }
        whole = [arrays[each.name] if each.name in arrays else pa.nulls(len(times), each.type) for each in self.schema]
        return pa.Table.from_arrays(whole, schema=self.schema)


def types_of(recording: Recording, topic: str) -> Sequence[TypeRef]:
    """Return the types of the messages of a topic, that of its description first."""
    own = recording.topics[topic].type
    find: Callable[[str], Iterable[TypeRef]] = getattr(recording, "types_of", lambda _: ())
    others = sorted(set(find(topic)) - {own}, key=lambda ref: (ref.name, ref.hash or ""))
    return [each for each in (own, *others) if each.name]


def _add_field(fields: dict[str, pa.Field], field: pa.Field) -> str:
    """Add a column, and return its name: that of an equal one, or one that is free."""
    name: str = field.name
    while name in fields and (name in OWN or fields[name].type != field.type):
        name += "_"
    fields.setdefault(name, field.with_name(name))
    return name


def table_of_columns(columns: Mapping[str, Sequence[float | None]], units: Mapping[str, str | None]) -> TableParts:
    """Return columns of numbers, of which `time` is in ns, as a table, with their units (QUDT). Raises NoPyarrow."""
    require_pyarrow()
    import pyarrow as pa

    arrays, fields = [], []
    for name, values in columns.items():
        is_whole = any(isinstance(each, int) for each in values)
        type = pa.timestamp("ns", "UTC") if name == "time" else pa.int64() if is_whole else pa.float64()
        arrays.append(pa.array(values, type))
        unit = units.get(name)
        fields.append(pa.field(name, type, metadata=None if unit is None else {"unit": unit}))
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields))
    return table.schema, (table,)


# Files


class _Pieces(io.RawIOBase):
    """File that collects what is written until it is taken."""

    def __init__(self) -> None:
        super().__init__()
        self._pieces: list[bytes] = []
        self._position = 0

    def writable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def write(self, data: Any) -> int:
        piece = bytes(data)
        self._pieces.append(piece)
        self._position += len(piece)
        return len(piece)

    def take(self) -> bytes:
        """Return what was written since the last call."""
        pieces, self._pieces = self._pieces, []
        return b"".join(pieces)


def write_parquet(recording: Recording, topic: str, target: BinaryIO, rows: Rows = ALL) -> tuple[int, int]:
    """Write messages of a topic as a Parquet file, and return the numbers of written and unreadable messages.

    `target` is an open binary file. Equal messages give equal bytes with the same pyarrow. Needs little memory. Raises
    NoTable, NoPyarrow, RosError and OSError.
    """
    table = TopicTable(recording, topic)
    count = 0

    def counted() -> Iterator[pa.Table]:
        nonlocal count
        for part in table.parts(rows):
            count += len(part)
            yield part

    for piece in parquet_pieces(table.schema, counted(), lambda: {"unreadable": str(table.unreadable)}):
        target.write(piece)
    return count, table.unreadable


def parquet_pieces(
    schema: pa.Schema, parts: Iterable[pa.Table], footer: Callable[[], Mapping[str, str]] = dict
) -> Iterator[bytes]:
    """Yield the bytes of a Parquet file, by row groups; `footer` is metadata that is known at the end."""
    from pyarrow import parquet

    sink = _Pieces()
    texts = [path for each in schema for path in _text_columns(each.name, each.type)]
    with parquet.ParquetWriter(sink, schema, version="2.6", compression="zstd", use_dictionary=texts) as writer:
        for group in _row_groups(parts):
            writer.write_table(group, row_group_size=len(group))
            yield sink.take()
        writer.add_key_value_metadata(footer())
    yield sink.take()


def _text_columns(path: str, type: pa.DataType) -> Iterator[str]:
    """Yield the columns of Parquet with strings, whose values are often the same; numbers are not."""
    import pyarrow as pa

    if pa.types.is_string(type):
        yield path
    elif pa.types.is_struct(type):
        for each in type:
            yield from _text_columns(f"{path}.{each.name}", each.type)
    elif pa.types.is_list(type) or pa.types.is_fixed_size_list(type):
        yield from _text_columns(f"{path}.list.element", type.value_type)


def _row_groups(parts: Iterable[pa.Table]) -> Iterator[pa.Table]:
    import pyarrow as pa

    held: list[pa.Table] = []
    for part in parts:
        held.append(part)
        if sum(map(len, held)) >= _GROUP_ROWS or sum(each.nbytes for each in held) >= _GROUP_BYTES:
            yield pa.concat_tables(held)
            held = []
    if held:
        yield pa.concat_tables(held)


def arrow_pieces(schema: pa.Schema, parts: Iterable[pa.Table]) -> Iterator[bytes]:
    """Yield the bytes of a stream of Arrow's IPC."""
    import pyarrow as pa

    sink = _Pieces()
    with pa.ipc.new_stream(sink, schema) as writer:
        for part in parts:
            writer.write_table(part)
            yield sink.take()
    yield sink.take()


def csv_pieces(schema: pa.Schema, parts: Iterable[pa.Table]) -> Iterator[bytes]:
    """Yield a table as CSV: times as xsd:dateTime, durations in seconds, octets in base64, arrays in JSON."""
    import pyarrow as pa
    from pyarrow import csv

    sink = _Pieces()
    for place, part in enumerate(chain([schema.empty_table()], parts)):
        columns = [_csv_column(each.combine_chunks()) for each in part.columns]
        options = csv.WriteOptions(include_header=place == 0, eol="\r\n")
        csv.write_csv(pa.Table.from_arrays(columns, schema.names), sink, options)
        if place:
            yield sink.take()
    yield sink.take()


def _csv_column(array: pa.Array) -> pa.Array:
    """Return the values as pyarrow writes them: numbers and texts."""
    import pyarrow as pa

    type = array.type
    if pa.types.is_list(type) or pa.types.is_fixed_size_list(type):
        return pa.array(_json_texts(array), pa.string())
    if pa.types.is_struct(type):
        return pa.array([None if each is None else orjson.dumps(each).decode() for each in _values(array)], pa.string())
    if pa.types.is_temporal(type) or pa.types.is_binary(type) or pa.types.is_fixed_size_binary(type):
        return pa.array(_values(array), pa.string())
    return array


def _json_texts(array: pa.Array) -> list[str | None]:
    """Return lists as JSON; numbers that JSON does not have are texts, such as "NaN"."""
    import pyarrow as pa

    element = array.type.value_type
    if array.null_count or not (pa.types.is_integer(element) or pa.types.is_floating(element)):
        return [None if each is None else orjson.dumps(each).decode() for each in _values(array)]
    numbers, ends = array.flatten().to_numpy(), np.cumsum(array.value_lengths().to_numpy()).tolist()
    return [json_numbers(numbers[start:end]) for start, end in zip([0, *ends], ends, strict=False)]


def _values(array: pa.Array) -> list[Any]:
    """Return values as Python objects that JSON can represent."""
    import pyarrow as pa
    from pyarrow import compute

    type = array.type
    if pa.types.is_timestamp(type):
        return list(compute.strftime(array, f"%Y-%m-%dT%H:%M:%S{'' if type.tz is None else 'Z'}").to_pylist())
    if pa.types.is_duration(type):
        return [None if each is None else _seconds(each) for each in array.cast(pa.int64()).to_pylist()]
    if pa.types.is_binary(type) or pa.types.is_fixed_size_binary(type):
        return [None if each is None else base64_text(each) for each in array.to_pylist()]
    if pa.types.is_struct(type):
        columns = [_values(array.field(place)) for place in range(type.num_fields)]
        names = [each.name for each in type]
        rows: list[Any] = [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]
    elif pa.types.is_list(type) or pa.types.is_fixed_size_list(type):
        elements, ends = _values(array.flatten()), np.cumsum(array.value_lengths().fill_null(0).to_numpy()).tolist()
        rows = [elements[start:end] for start, end in zip([0, *ends], ends, strict=False)]
    elif pa.types.is_floating(type):
        return [each if each is None or math.isfinite(each) else special_float(each) for each in array.to_pylist()]
    else:
        return list(array.to_pylist())
    return [row if valid else None for row, valid in zip(rows, array.is_valid().to_pylist(), strict=True)]


def _seconds(nanoseconds: int) -> str:
    whole, rest = divmod(abs(nanoseconds), 1_000_000_000)
    return f"{'-' * (nanoseconds < 0)}{whole}.{rest:09d}"
