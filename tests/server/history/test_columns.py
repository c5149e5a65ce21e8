"""Columns of many messages: their RDF equals that of each single message, or there are none."""

from __future__ import annotations

import struct
from random import Random
from typing import Any

import numpy as np
import pytest

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.schema import Array, FieldType, MessageSchema, Nested, Primitive
from rosld.ontology.column_lift import column_lifter
from rosld.ontology.document import Envelope
from rosld.ontology.lift import LiftSettings, partial_lifter
from rosld.ontology.vocab import rdf, ros
from rosld.server.history.mcap_writer import TopicChunk
from rosld.server.history.message_block import columns_of, number_paths, rows_of

TYPES = (
    "sensor_msgs/msg/Imu",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/BatteryState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/LaserScan",
    "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/UInt8",
    "std_msgs/msg/Empty",
)
LIBRARIES = {Encoding.ROS1: TypeLibrary(ros_version=1), Encoding.CDR: TypeLibrary(ros_version=2)}
DOCUMENT, TOPIC = "http://robot/bags/history/messages/", "http://robot/topics/a%20b"
PAST = ros.past.value
SAID = [each.value for each in (ros.received, ros.sequence, ros.dateTime, rdf.type, rdf.first)]


def value_of(kind: FieldType, random: Random, schema: MessageSchema, lengths: Any) -> Any:
    """Return a value of a field; strings and arrays have the next length from `lengths`."""
    if isinstance(kind, Nested):
        return made(kind.name, random, schema, lengths)
    if isinstance(kind, Array):
        count = kind.length if kind.length is not None else lengths()
        values = [value_of(kind.element, random, schema, lengths) for _ in range(count)]
        if isinstance(kind.element, Primitive) and kind.element.name not in ("string", "wstring"):
            return np.array(values, {"bool": "?", "byte": "i1", "char": "u1"}.get(kind.element.name, kind.element.name))
        return values
    assert isinstance(kind, Primitive)
    if kind.name in ("string", "wstring"):
        return "x" * lengths()
    if kind.name == "bool":
        return random.random() < 0.5
    if kind.name.startswith("float"):
        value = random.choice([random.uniform(-9, 9), random.gauss(0, 1e9), 0.0, -0.0, float("nan"), float("inf")])
        return struct.unpack("<f", struct.pack("<f", value))[0] if kind.name == "float32" else value
    bits = np.iinfo({"byte": "i1", "char": "u1"}.get(kind.name, kind.name))
    return random.choice([random.randint(int(bits.min), int(bits.max)), int(bits.min), int(bits.max)])


def made(name: str, random: Random, schema: MessageSchema, lengths: Any) -> Any:
    fields = schema.types[name].fields
    return schema.codec.build(name, {each.attribute: value_of(each.type, random, schema, lengths) for each in fields})


def leaf(message: Any, path: tuple[str, ...]) -> Any:
    for name in path:
        message = getattr(message, name)
    return message


@pytest.mark.slow
@pytest.mark.parametrize("encoding", Encoding)
def test_columns_say_what_each_message_says(encoding: Encoding) -> None:
    for name in TYPES:
        schema = LIBRARIES[encoding].find(TypeRef(name))
        assert isinstance(schema, MessageSchema)
        for seed in range(15):
            says_the_same(schema, encoding, Random(seed))


def says_the_same(schema: MessageSchema, encoding: Encoding, random: Random) -> None:
    """Check that the columns of a few messages equal the RDF of the messages, if there are any."""
    same = [random.randint(0, 5) for _ in range(20)]
    is_alike = random.random() < 0.6
    chunk = TopicChunk("/a", 0.0)
    messages: list[Any] = []
    for number in range(random.randint(1, 4)):
        turns = iter(same * 500 if is_alike else [random.randint(0, 5) for _ in range(40)] * 500)
        message = made(schema.ref.name, random, schema, turns.__next__)
        octets = schema.codec.encode(message, encoding)
        messages.append(schema.codec.decode(octets, encoding))
        chunk.add(1, number, 1_700_000_000_000_000_000 + number * 20_000_001, octets)
    rows = rows_of(b"".join(chunk.parts))
    if rows is None:
        assert not is_alike
        return
    paths = list(number_paths(schema))
    columns = columns_of(rows, schema, encoding, paths)
    if columns is None:
        assert not is_alike
        return
    for path, column in zip(paths, columns, strict=True):
        expected = [leaf(message, path) for message in messages]
        assert np.array_equal(column, np.array(expected, column.dtype), equal_nan=column.dtype.kind == "f")
    lifts_alike(schema, messages, rows.times.tolist(), encoding, rows, random)


def lifts_alike(
    schema: MessageSchema, messages: list[Any], times: list[int], encoding: Encoding, rows: Any, random: Random
) -> None:
    """Check that lifting all messages with some predicates equals lifting each, line by line."""
    space = LiftSettings().types
    known = [f"{space}{kind.name}#{field.name}" for kind in schema.types.values() for field in kind.fields]
    some = random.choices([*known, *SAID], k=random.randint(0, 6))
    only = frozenset({PAST, *some})
    lifter = partial_lifter(schema, LiftSettings(), only, is_linked=random.random() < 0.5)
    fast = column_lifter(lifter, only, TOPIC, "#message")
    if fast is None:
        return
    columns = columns_of(rows, schema, encoding, fast.paths)
    assert columns is not None
    documents = [f"{DOCUMENT}{number}" for number in range(len(messages))]
    found = fast.ntriples(documents, times, range(1, len(messages) + 1), columns)
    expected = ""
    for number, (document, message, at) in enumerate(zip(documents, messages, times, strict=True)):
        expected += f"<{TOPIC}> <{PAST}> <{document}#message> .\n"
        expected += lifter.ntriples(message, document, "#message", envelope=Envelope(at, number + 1))
    assert found == expected


def test_messages_of_another_length_or_channel_are_no_rows() -> None:
    for channel, octets in ((1, b"\0\1\0\0ab"), (2, b"\0\1\0\0a")):
        chunk = TopicChunk("/a", 0.0)
        chunk.add(1, 0, 1, b"\0\1\0\0a")
        chunk.add(channel, 1, 2, octets)
        assert rows_of(b"".join(chunk.parts)) is None
    assert rows_of(b"") is None


def test_what_is_no_message_of_its_type_has_no_columns() -> None:
    schema = LIBRARIES[Encoding.CDR].find(TypeRef("sensor_msgs/msg/Imu"))
    assert isinstance(schema, MessageSchema)
    for octets in (b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 400, b"\0\1\0\0" + bytes(1000)):
        sample = Sample(octets, Encoding.CDR, schema.ref, "", 1, 1)
        chunk = TopicChunk("/a", 0.0)
        chunk.add(1, 0, 1, sample.data)
        rows = rows_of(b"".join(chunk.parts))
        assert rows is not None
        assert columns_of(rows, schema, Encoding.CDR, list(number_paths(schema))) is None
