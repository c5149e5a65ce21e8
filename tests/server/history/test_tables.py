"""Topics as tables: by columns or message by message they are the same, and say what the messages say."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from rosld.adapters.base import MessageFilter, MessagePage, RecordedMessage, RecordedTopic
from rosld.adapters.model import Encoding, MessageSchema, Sample, TypeRef
from rosld.ontology.fields import field_at
from rosld.server.history import table_files, tables
from rosld.server.history.message_columns import DURATION, TIME
from rosld.server.history.table_files import csv_pieces
from rosld.server.history.tables import NoTable, Rows, TopicTable, pieces
from tests.server.history.test_columns import LIBRARIES, TYPES, made

START = 1_700_000_000_000_000_123
MIXED = """int64 index
bool[] flags
bool yes
string[] words
uint8[4] address
byte[] octets
builtin_interfaces/Duration left
builtin_interfaces/Time[] stamps
geometry_msgs/Vector3 speed
diagnostic_msgs/DiagnosticStatus[] status
std_msgs/Empty nothing
std_msgs/Empty[] nothings
float64[2] pair
===
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
===
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
===
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
===
MSG: std_msgs/Empty
===
MSG: diagnostic_msgs/DiagnosticStatus
byte level
string name
diagnostic_msgs/KeyValue[] values
===
MSG: diagnostic_msgs/KeyValue
string key
string value
""".replace("===", "=" * 80)


class Recorded:
    """A recording of one topic in memory."""

    name, first = "made_up", 0

    def __init__(self, samples: Sequence[Sample], schemas: Iterable[MessageSchema], page: int = 1000) -> None:
        self._samples = samples
        self._schemas = {each.ref: each for each in schemas}
        self._page = page
        self.topics = {"/a b": RecordedTopic("/a b", samples[0].schema, len(samples))}

    def types_of(self, topic: str) -> set[TypeRef]:
        return {each.schema for each in self._samples}

    def schema(self, ref: TypeRef) -> MessageSchema:
        return self._schemas[ref]

    def select(self, wanted: MessageFilter, limit: int) -> MessagePage:
        assert wanted.topics == frozenset({"/a b"})
        found = [
            RecordedMessage(number, "/a b", each)
            for number, each in enumerate(self._samples)
            if wanted.start <= number < wanted.end and wanted.from_ns <= each.received_ns <= wanted.to_ns
        ]
        most = min(limit, self._page)
        return MessagePage(found[:most], found[most].index if len(found) > most else None)


def spoken(
    schema: MessageSchema, encoding: Encoding, messages: Sequence[Any], publisher: str = "/robot"
) -> list[Sample]:
    return [
        Sample(
            schema.codec.encode(each, encoding), encoding, schema.ref, publisher, START + number * 1_000_001, number + 1
        )
        for number, each in enumerate(messages)
    ]


def whole(recording: Any, rows: Rows = Rows()) -> pa.Table:  # noqa: B008
    table = TopicTable(recording, "/a b")
    return pa.concat_tables([table.schema.empty_table(), *table.parts(rows)])


def parquet_bytes(recording: Any, rows: Rows = Rows()) -> bytes:  # noqa: B008
    table = TopicTable(recording, "/a b")
    return b"".join(pieces("parquet", (table.schema, table.parts(rows)), table.footer))


def parquet_file(recording: Any, rows: Rows = Rows()) -> parquet.ParquetFile:  # noqa: B008
    return parquet.ParquetFile(io.BytesIO(parquet_bytes(recording, rows)))


def plain(value: Any) -> Any:
    """Return a value of a message as Arrow's Python values are."""
    if hasattr(value, "__msgtype__"):
        if value.__msgtype__ in (TIME, DURATION):
            return value.sec * 10**9 + value.nanosec
        members = {name: plain(each) for name, each in vars(value).items() if name[0].islower()}
        return 0 if set(members) <= {"structure_needs_at_least_one_member"} else members
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype.itemsize == 1 and value.dtype.kind in "iu" else value.tolist()
    return [plain(each) for each in value] if isinstance(value, list) else value


def comparable(array: pa.ChunkedArray) -> list[Any]:
    def whole_numbers(type: pa.DataType) -> pa.DataType:
        if pa.types.is_temporal(type):
            return pa.int64()
        if pa.types.is_list(type):
            return pa.list_(whole_numbers(type.value_type))
        if pa.types.is_struct(type):
            return pa.struct([(each.name, whole_numbers(each.type)) for each in type])
        return type

    return array.cast(whole_numbers(array.type)).to_pylist()


@pytest.mark.slow
@pytest.mark.parametrize("encoding", list(Encoding), ids=lambda each: each.value)
def test_columns_are_what_each_message_says(encoding: Encoding, monkeypatch: pytest.MonkeyPatch) -> None:
    library, random = LIBRARIES[encoding], Random(7)
    mixed = library.learn_message("made_up/msg/Mixed", MIXED)
    for schema in (*(library.find(TypeRef(each)) for each in TYPES), mixed):
        for lengths in (lambda: 2, lambda: 0, lambda: random.randrange(4)):
            messages = [made(schema.ref.name, random, schema, lengths) for _ in range(20)]
            recording = Recorded(spoken(schema, encoding, messages), [schema], page=11)
            monkeypatch.setattr(tables, "_LEAST_ROWS", 1)
            by_columns = whole(recording)
            monkeypatch.setattr(tables, "_LEAST_ROWS", 99)
            one_by_one = whole(recording)
            assert by_columns.schema.equals(one_by_one.schema, check_metadata=True)
            for name in by_columns.schema.names:
                both = comparable(by_columns[name]), comparable(one_by_one[name])
                assert str(both[0]) == str(both[1]), f"{schema.ref.name} {name}"
            assert by_columns["index"].to_pylist() == list(range(20))
            assert comparable(by_columns["received"]) == [START + number * 1_000_001 for number in range(20)]
            for name in by_columns.schema.names[3:]:
                told = [plain(field_at(schema, each, name.removesuffix("_"))[1]) for each in messages]
                assert str(comparable(by_columns[name])) == str(told), f"{schema.ref.name} {name}"
    assert {"index_", "left", "stamps", "speed.x", "pair"} <= set(by_columns.schema.names)
    assert "nothing" not in by_columns.schema.names


def of_type(
    text: str, values: Sequence[dict[str, Any]], name: str = "made_up/msg/Row"
) -> tuple[MessageSchema, list[Sample]]:
    schema = LIBRARIES[Encoding.CDR].learn_message(name, text)
    return schema, spoken(schema, Encoding.CDR, [schema.codec.build(name, each) for each in values])


def test_units_types_and_names_are_in_the_schema() -> None:
    schema = LIBRARIES[Encoding.CDR].find(TypeRef("nav_msgs/msg/Odometry"))
    messages = [made(schema.ref.name, Random(1), schema, lambda: 3)]
    table = whole(Recorded(spoken(schema, Encoding.CDR, messages), [schema]))
    assert table.schema.metadata[b"type"] == b"nav_msgs/msg/Odometry"
    assert table.schema.metadata[b"hash"].startswith(b"RIHS01_")
    assert (table.schema.metadata[b"topic"], table.schema.metadata[b"recording"]) == (b"/a b", b"made_up")
    assert table.schema.field("twist.twist.linear.x").metadata[b"unit"].endswith(b"/M-PER-SEC")
    assert table.schema.field("header.stamp").type == pa.timestamp("ns", "UTC")
    assert table.schema.field("pose.covariance").type == pa.list_(pa.float64(), 36)


def test_texts_that_are_not_utf_8_have_replacement_characters() -> None:
    _, samples = of_type("string text", [{"text": "gr\udcfcn" if place % 2 else "grün"} for place in range(20)])
    schema = LIBRARIES[Encoding.CDR].find(samples[0].schema)
    for count in (20, 4):  # by columns, and one by one
        table = whole(Recorded(samples[:count], [schema]))
        assert table["text"].to_pylist() == ["grün", "gr\ufffdn"] * (count // 2)


def test_what_cannot_be_decoded_is_left_out_and_counted() -> None:
    schema, samples = of_type("string text\nint32 number", [{"text": "a", "number": place} for place in range(30)])
    samples[3] = samples[3]._replace(data=samples[3].data[:-6])
    file = parquet_file(Recorded(samples, [schema]))
    assert file.metadata.metadata[b"unreadable"] == b"1"
    assert file.read()["number"].to_pylist() == [each for each in range(30) if each != 3]
    with pytest.raises(NoTable, match="cannot be read"):
        TopicTable(_unknown(samples), "/a b")


def _unknown(samples: Sequence[Sample]) -> Any:
    recording = Recorded(samples, [])
    recording.topics["/a b"] = RecordedTopic("/a b", TypeRef(""), len(samples), "its type is not known")
    recording.types_of = lambda topic: set()  # type: ignore[method-assign]
    return recording


def test_messages_and_nodes_that_may_not_be_read_are_left_out() -> None:
    schema, samples = of_type("int32 x", [{"x": place} for place in range(12)])
    samples[1] = samples[1]._replace(publisher="/secret")
    table = TopicTable(Recorded(samples, [schema]), "/a b", lambda index: index < 10, lambda node: node != "/secret")
    (part,) = table.parts(Rows(most=11))
    assert part["x"].to_pylist() == list(range(10))
    assert part["publisher"].to_pylist() == ["/robot", None, *["/robot"] * 8]


def test_a_topic_of_two_types_is_one_table() -> None:
    one, first = of_type("float64 speed\nint32 gear", [{"speed": 1.0 * place, "gear": place} for place in range(9)])
    two, second = of_type("float64 speed\nstring gear", [{"speed": 9.5, "gear": "R"}], "made_up/msg/Other")
    table = whole(Recorded([*first, *second], [one, two]))
    assert table.schema.names == ["received", "index", "publisher", "speed", "gear", "gear_"]
    assert table["speed"].to_pylist() == [*(1.0 * place for place in range(9)), 9.5]
    assert table["gear"].to_pylist() == [*range(9), None]
    assert table["gear_"].to_pylist() == [*[None] * 9, "R"]
    assert table.schema.metadata[b"type"] == b"made_up/msg/Row made_up/msg/Other"


def test_equal_messages_give_equal_files_in_row_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    schema, samples = of_type("float64 x", [{"x": place / 8} for place in range(100)])
    recording = Recorded(samples, [schema], page=10)
    monkeypatch.setattr(table_files, "_GROUP_ROWS", 30)
    rows = Rows(start=5, end=95, to_ns=START + 90 * 1_000_001)
    assert parquet_bytes(recording, rows) == parquet_bytes(recording, rows)
    assert len(parquet_file(recording, Rows(start=500)).read()) == 0
    read = parquet_file(recording, rows)
    assert [read.metadata.row_group(place).num_rows for place in range(read.num_row_groups)] == [30, 30, 26]
    assert read.read()["x"].to_pylist() == [place / 8 for place in range(5, 91)]


def test_csv_has_times_as_text_and_arrays_as_json() -> None:
    text = "builtin_interfaces/Time at\nbuiltin_interfaces/Duration left\nfloat32[] ranges\nuint8[] data\nstring says\n"
    text += "made_up/Part[] parts\n" + MIXED[MIXED.index("=" * 80) : MIXED.index("MSG: geometry")]
    text += "MSG: made_up/Part\nfloat64 x\nstring name"
    schema = LIBRARIES[Encoding.CDR].learn_message("made_up/msg/Csv", text)
    build = schema.codec.build
    message = build(
        "made_up/msg/Csv",
        {
            "at": build(TIME, {"sec": 1_700_000_000, "nanosec": 5}),
            "left": build(DURATION, {"sec": -1, "nanosec": 500_000_000}),
            "ranges": np.array([0.1, float("nan"), float("inf")], "f4"),
            "data": np.array([1, 255], "u1"),
            "says": 'a "b"\n',
            "parts": [build("made_up/msg/Part", {"x": float("-inf"), "name": "ü"})],
        },
    )
    table = TopicTable(Recorded(spoken(schema, Encoding.CDR, [message]), [schema]), "/a b")
    written = b"".join(csv_pieces(table.schema, table.parts()))
    head, row = written.decode().split("\n", 1)
    assert head == '"received","index","publisher","at","left","ranges","data","says","parts"'
    assert row == (
        '"2023-11-14T22:13:20.000000123Z",0,"/robot","2023-11-14T22:13:20.000000005Z","-0.500000000",'
        '"[0.1,""NaN"",""INF""]","Af8=","a ""b""\n","[{""x"":""-INF"",""name"":""ü""}]"\n'
    )
