"""Topics of recordings as flat tables, by pyarrow (the extra `rosld[parquet]`), which is imported when it is needed.

One row a message. Before the columns of its fields stand `received` (the time of recording), `index` (the number in the
recording) and `publisher`; a field of one of these names gets an underscore at its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from rosld.adapters.base import FOR_EVER, MessageFilter, RecordedMessage, Recording
from rosld.adapters.model import MessageSchema, TypeRef, UnknownType
from rosld.server.history.message_block import MessageBlock, layout_of

if TYPE_CHECKING:
    import pyarrow as pa

    from rosld.server.history.message_columns import MessageColumns, MessageValues

TableParts: TypeAlias = "tuple[pa.Schema, Iterable[pa.Table]]"
"""A table as its schema and its parts."""
OWN = ("received", "index", "publisher")
"""Columns of every table, before those of the fields."""
_PAGE = 4096
"""Number of messages read at a time."""
_LEAST_ROWS = 8
"""Number of messages of one layout below which decoding them is as fast as reading their columns."""


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


class Rows(NamedTuple):
    """The rows of a table: messages of a recording from `start` to `end` (exclusive), recorded between two times.

    `most` is their maximum number.
    """

    start: int = 0
    end: int = FOR_EVER
    from_ns: int = 0
    to_ns: int = FOR_EVER
    most: int = FOR_EVER


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

        from rosld.server.history.message_columns import MessageColumns

        self.unreadable = 0
        """Number of messages that were left out, because they cannot be decoded."""
        self._recording = recording
        self._topic = topic
        self._may_read = may_read
        self._shown = shown
        self._types: dict[TypeRef, tuple[MessageColumns, Sequence[str]]] = {}
        own = (pa.timestamp("ns", "UTC"), False), (pa.int64(), False), (pa.string(), True)
        fields = {name: pa.field(name, *kind) for name, kind in zip(OWN, own, strict=True)}
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

    def footer(self) -> Mapping[str, str]:
        """Return metadata that is known when all parts are read."""
        return {"unreadable": str(self.unreadable)}

    def parts(self, rows: Rows = ALL) -> Iterator[pa.Table]:
        """Yield the table in parts, in the order of the messages. Slow: call it in a thread."""
        start: int | None = max(rows.start, self._recording.first)
        left = rows.most
        while start is not None and left > 0:
            wanted = MessageFilter(frozenset({self._topic}), rows.from_ns, rows.to_ns, start, rows.end)
            page = self._recording.select(wanted, min(_PAGE, left))
            left -= len(page.messages)
            start = page.next
            yield self.table_of(page.messages)

    def table_of(self, messages: Iterable[RecordedMessage]) -> pa.Table:
        """Return messages of the topic as a table; those that cannot be decoded are counted and left out."""
        import pyarrow as pa

        from rosld.server.history.message_columns import DecodedValues, RowValues

        if self._may_read is not None:
            messages = [each for each in messages if self._may_read(each.index)]
        parts: list[pa.Table] = []
        single: dict[TypeRef, list[RecordedMessage]] = {}
        for block in MessageBlock.grouped(messages):
            ref, rows, members = block.channel.type, block.rows, list(block.messages())
            assert rows is not None
            if ref not in self._types:
                self.unreadable += len(members)
                continue
            schema, layout = self._types[ref][0].schema, None
            if len(members) >= _LEAST_ROWS:
                layout = layout_of(rows, schema, block.channel.encoding)
            if layout is None:
                single.setdefault(ref, []).extend(members)
            else:
                parts.append(self._part(ref, members, RowValues(rows.data, layout)))
        for ref, members in single.items():
            decoded = list(self._decode(ref, members))
            values = DecodedValues([message for _, message in decoded])
            parts.append(self._part(ref, [each for each, _ in decoded], values))
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

    def _part(self, ref: TypeRef, messages: Sequence[RecordedMessage], values: MessageValues) -> pa.Table:
        import pyarrow as pa

        columns, names = self._types[ref]
        nodes = [each.sample.publisher for each in messages]
        named = {each: each if each and (self._shown is None or self._shown(each)) else None for each in set(nodes)}
        arrays = {
            "received": pa.array(np.array([each.sample.received_ns for each in messages], np.int64)),
            "index": pa.array([each.index for each in messages], pa.int64()),
            "publisher": pa.array([named[each] for each in nodes], pa.string()),
            **dict(zip(names, columns.arrays_of(values), strict=True)),
        }
        arrays["received"] = arrays["received"].view(pa.timestamp("ns", "UTC"))
        count = len(messages)
        whole = [arrays[each.name] if each.name in arrays else pa.nulls(count, each.type) for each in self.schema]
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


def pieces(format: str, table: TableParts, footer: Callable[[], Mapping[str, str]] = dict) -> Iterator[bytes]:
    """Yield the bytes of a table as `parquet`, `arrow` or `csv`; `footer` is metadata that is known at the end."""
    from rosld.server.history import table_files

    if format == "parquet":
        return table_files.parquet_pieces(*table, footer)
    return (table_files.arrow_pieces if format == "arrow" else table_files.csv_pieces)(*table)
