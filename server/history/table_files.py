"""Tables of Arrow as Parquet, Arrow and CSV, in pieces. Needs pyarrow: import this module when needed."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
from pyarrow import csv, parquet

from rosld.ontology.literals import base64_text, json_numbers, special_float

_GROUP_ROWS = 65_536
_GROUP_BYTES = 32 * 1024 * 1024
"""Size of a row group, after which it is written: what a table needs of memory does not depend on its length."""


def table_of_columns(columns: Mapping[str, Sequence[float | None]], units: Mapping[str, str | None]) -> pa.Table:
    """Return columns of numbers, of which `time` is in ns, as a table, with their units (QUDT)."""
    arrays, fields = [], []
    for name, values in columns.items():
        is_whole = any(isinstance(each, int) for each in values)
        type = pa.timestamp("ns", "UTC") if name == "time" else pa.int64() if is_whole else pa.float64()
        arrays.append(pa.array(values, type))
        unit = units.get(name)
        fields.append(pa.field(name, type, metadata=None if unit is None else {"unit": unit}))
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields))


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


def parquet_pieces(
    schema: pa.Schema, parts: Iterable[pa.Table], footer: Callable[[], Mapping[str, str]] = dict
) -> Iterator[bytes]:
    """Yield the bytes of a Parquet file, by row groups; `footer` is metadata that is known at the end."""
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
    if pa.types.is_string(type):
        yield path
    elif pa.types.is_struct(type):
        for each in type:
            yield from _text_columns(f"{path}.{each.name}", each.type)
    elif pa.types.is_list(type) or pa.types.is_fixed_size_list(type):
        yield from _text_columns(f"{path}.list.element", type.value_type)


def _row_groups(parts: Iterable[pa.Table]) -> Iterator[pa.Table]:
    held: list[pa.Table] = []
    for part in filter(len, parts):
        held.append(part)
        if sum(map(len, held)) >= _GROUP_ROWS or sum(each.nbytes for each in held) >= _GROUP_BYTES:
            yield pa.concat_tables(held)
            held = []
    if held:
        yield pa.concat_tables(held)


def arrow_pieces(schema: pa.Schema, parts: Iterable[pa.Table]) -> Iterator[bytes]:
    """Yield the bytes of a stream of Arrow's IPC."""
    sink = _Pieces()
    with pa.ipc.new_stream(sink, schema) as writer:
        for part in parts:
            writer.write_table(part)
            yield sink.take()
    yield sink.take()


def csv_pieces(schema: pa.Schema, parts: Iterable[pa.Table]) -> Iterator[bytes]:
    """Yield a table as CSV: times as xsd:dateTime, durations in seconds, octets in base64, arrays in JSON."""
    sink = _Pieces()
    for place, part in enumerate(chain([schema.empty_table()], parts)):
        columns = [_csv_column(each.combine_chunks()) for each in part.columns]
        options = csv.WriteOptions(include_header=place == 0)
        csv.write_csv(pa.Table.from_arrays(columns, schema.names), sink, options)
        yield sink.take()


def _csv_column(array: pa.Array) -> pa.Array:
    """Return the values as pyarrow writes them: numbers and texts."""
    type = array.type
    if pa.types.is_list(type) or pa.types.is_fixed_size_list(type):
        return pa.array(_json_texts(array), pa.string())
    if pa.types.is_temporal(type) or pa.types.is_binary(type) or pa.types.is_fixed_size_binary(type):
        return pa.array(_values(array), pa.string())
    return array


def _json_texts(array: pa.Array) -> list[str | None]:
    """Return lists as JSON; numbers that JSON does not have are texts, such as "NaN"."""
    element = array.type.value_type
    if array.null_count or not (pa.types.is_integer(element) or pa.types.is_floating(element)):
        return [None if each is None else orjson.dumps(each).decode() for each in _values(array)]
    numbers, ends = array.flatten().to_numpy(), np.cumsum(array.value_lengths().to_numpy()).tolist()
    return [json_numbers(numbers[start:end]) for start, end in zip([0, *ends], ends, strict=False)]


def _values(array: pa.Array) -> list[Any]:
    """Return values as Python objects that JSON can represent."""
    type = array.type
    if pa.types.is_timestamp(type):
        from pyarrow import compute  # takes as long to import as the rest of pyarrow

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
