"""Malicious recordings: small files that claim, inflate to or index more data than they contain."""

from __future__ import annotations

import asyncio
import bz2
import random
import sqlite3
import struct
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from lz4.frame import compress as lz4_compress  # type: ignore[import-untyped]

from rosld.adapters.base import AdapterOptions, NullSink
from rosld.adapters.model import Encoding, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.recording import byte_source, storage
from rosld.adapters.recording.adapter import RecordingAdapter, open_storage
from rosld.adapters.recording.byte_source import MAX_PIECE, decompress, decompress_zstd
from rosld.adapters.recording.storage import Damaged, OpenBudget

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
MIB = 1 << 20


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def record(op: int, body: bytes) -> bytes:
    """Return a record of an MCAP file (https://mcap.dev/spec)."""
    return struct.pack("<BQ", op, len(body)) + body


HEADER = MAGIC + record(1, text("ros2") + text("made"))
CHANNEL = record(3, struct.pack("<H", 1) + text("std_msgs/msg/String") + text("ros2msg") + text("string data\n"))
CHANNEL += record(4, struct.pack("<HH", 1, 1) + text("/x") + text("cdr") + struct.pack("<I", 0))
END = record(0x0F, bytes(4)) + record(2, bytes(20)) + MAGIC


def chunk(data: bytes, compression: str, claimed: int, crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, claimed, crc) + text(compression)
    return record(6, head + struct.pack("<Q", len(data)) + data)


def peak(work: Callable[[], object]) -> int:
    """Return the peak memory of Python's objects during `work`, in bytes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


COMPRESSORS = {"zstd": zstd.compress, "lz4": lz4_compress, "bz2": bz2.compress}


def test_memory_is_taken_for_what_a_chunk_holds_and_not_for_what_it_claims() -> None:
    for compression, compress in COMPRESSORS.items():

        def claims_too_much(by: str = compression) -> None:
            with pytest.raises(Damaged, match=f"a size of {1 << 31} bytes, more than the read limit of {MAX_PIECE}"):
                decompress(by, b"whatever", 1 << 31)

        def holds_less(by: str = compression, data: bytes = compress(bytes(1000))) -> None:
            with pytest.raises(Damaged, match="does not contain the stated"):
                decompress(by, data, MAX_PIECE)

        assert peak(claims_too_much) < MIB
        assert peak(holds_less) < 8 * MIB


@pytest.mark.slow
def test_a_chunk_of_several_steps_is_decompressed_whole_and_never_beyond_its_size() -> None:
    whole = random.Random(1).randbytes(5 * MIB // 4) + bytes(2 * MIB) + b"end"
    for compression, compress in COMPRESSORS.items():
        data = compress(whole)
        assert decompress(compression, data, len(whole)) == whole
        for claimed in (len(whole) - 1, len(whole) + 1, 0):
            with pytest.raises(Damaged, match="does not contain the stated"):
                decompress(compression, data, claimed)
        with pytest.raises(Damaged):
            decompress(compression, data[: len(data) // 2], len(whole))


def test_a_message_that_inflates_beyond_a_message_is_left_where_the_limit_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(byte_source, "MAX_PIECE", 4 * MIB)
    bomb = zstd.compress(bytes(64 * MIB))
    assert len(bomb) < 64 << 10

    def refused() -> None:
        with pytest.raises(Damaged, match="exceeds the"):
            decompress_zstd(bomb)

    assert peak(refused) < 16 * MIB
    assert decompress_zstd(zstd.compress(bytes(4 * MIB))) == bytes(4 * MIB)


def messages(count: int) -> bytes:
    return record(5, struct.pack("<HIQQ", 1, 0, 10**9, 10**9)) * count


@pytest.mark.slow
def test_a_small_file_whose_chunks_inflate_to_millions_of_messages_is_refused_within_its_budget(
    tmp_path: Path,
) -> None:
    inner = messages(10_000)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(HEADER + CHANNEL + chunk(zstd.compress(inner), "zstd", len(inner), zlib.crc32(inner)) * 250 + END)
    assert path.stat().st_size < MIB

    def refused() -> None:
        with pytest.raises(Unreachable, match=f"its index takes more than {MIB} bytes"):
            open_storage(path, OpenBudget(MIB))

    assert peak(refused) < 16 * MIB


def test_an_index_that_is_named_again_and_again_is_refused_within_its_budget(tmp_path: Path) -> None:
    head = HEADER + CHANNEL
    data = chunk(b"", "", 0)
    index = record(7, struct.pack("<HI", 1, 16 * 10_000) + struct.pack("<QQ", 10**9, 0) * 10_000)
    at = len(head) + len(data)
    names = struct.pack("<HQ", 1, at) * 1000
    body = struct.pack("<QQQQ", 0, 0, len(head), len(data)) + struct.pack("<I", len(names)) + names
    summary = record(8, body + bytes(8) + text("") + bytes(16)) * 20
    start = at + len(index)
    path = tmp_path / "loop.mcap"
    path.write_bytes(head + data + index + summary + record(2, struct.pack("<QQI", start, 0, 0)) + MAGIC)

    def refused() -> None:
        with pytest.raises(Unreachable, match="its index takes more than"):
            open_storage(path, OpenBudget(4 * MIB))

    assert peak(refused) < 32 * MIB


def described(definitions: dict[str, str], channels: int = 1, more: bytes = b"") -> bytes:
    """Return an MCAP file with these types by name, each with some channels."""
    parts, ends = [HEADER], struct.pack("<I", len(more)) + more
    for number, (name, definition) in enumerate(definitions.items(), 1):
        parts.append(record(3, struct.pack("<H", number) + text(name) + text("ros2msg") + text(definition)))
        for channel in range(channels):
            head = struct.pack("<HH", (number - 1) * channels + channel + 1, number)
            parts.append(record(4, head + text(f"/t{number}/{channel}") + text("cdr") + ends))
    return b"".join(parts) + END


def opened(path: Path, data: bytes) -> RecordingAdapter:
    """Return the recording with these bytes. Raises Unreachable."""
    path.write_bytes(data)

    async def open_it() -> RecordingAdapter:
        adapter = RecordingAdapter(path, AdapterOptions())
        await adapter.open(NullSink(), deadline=asyncio.get_running_loop().time() + 30)
        return adapter

    return asyncio.run(open_it())


@pytest.mark.slow
def test_a_recording_may_have_as_many_channels_as_mcap_allows(tmp_path: Path) -> None:
    adapter = opened(tmp_path / "many.mcap", described({"std_msgs/msg/String": "string data\n"}, 65_535))
    assert len(adapter.graph.topics) == 65_535


@pytest.mark.slow
def test_a_recording_of_more_types_than_its_size_justifies_is_refused_before_they_are_compiled(tmp_path: Path) -> None:
    types = {f"p/msg/T{number}": "string data\n" for number in range(20_000)}
    with pytest.raises(Unreachable, match="of its 20000 types, reading it takes too much work for a file of its size"):
        opened(tmp_path / "types.mcap", described(types))


@pytest.mark.slow
def test_a_chunk_that_is_named_again_and_again_is_not_read_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "_BASE_WORK", 1 << 27)
    inner = record(0x7F, b"") * (MIB // 64)
    head, data = HEADER + CHANNEL, chunk(zstd.compress(inner), "zstd", len(inner))
    body = struct.pack("<QQQQ", 0, 0, len(head), len(data)) + struct.pack("<I", 0)
    summary = record(8, body + bytes(8) + text("") + bytes(16)) * 1000
    path = tmp_path / "again.mcap"
    path.write_bytes(head + data + summary + record(2, struct.pack("<QQI", len(head + data), 0, 0)) + MAGIC)
    with pytest.raises(Unreachable, match="too much work for a file of its size"):
        open_storage(path)


def nested(deep: int) -> str:
    """Return a definition in which each type nests the next one twice."""
    parts = [f"X{number + 1} a\nX{number + 1} b\n" for number in range(deep)]
    return "".join([parts[0], *(f"{'=' * 80}\nMSG: q/X{number}\n{parts[number]}" for number in range(1, deep))]) + (
        f"{'=' * 80}\nMSG: q/X{deep}\nint32 x\n"
    )


def test_a_definition_that_is_made_to_cost_much_makes_its_topic_unreadable_and_nothing_else(tmp_path: Path) -> None:
    costly = {
        nested(40): "has more than 20000 fields",
        "uint8[4000000000] data\n": "have more than 16777216 values",
        f"F[4000000000] data\n{'=' * 80}\nMSG: q/F\n": "have more than 16777216 values",
        "".join(f"int32 f{number}\n" for number in range(20_000)): "take more than 131072 characters",
        f"{'a' * 10_000}/b c\n": "whose definition is not known",
    }
    types = {f"q{number}/msg/X0": text.replace("q/", f"q{number}/") for number, text in enumerate(costly)}
    data = described({**types, "std_msgs/msg/String": "string data\n"})
    (recording,) = opened(tmp_path / "bomb.mcap", data).recordings.values()
    for number, words in enumerate(costly.values(), 1):
        assert words in (recording.topics[f"/t{number}/0"].unreadable or ""), number
    assert recording.topics[f"/t{len(costly) + 1}/0"].unreadable is None


def test_a_message_that_claims_more_elements_than_it_has_bytes_is_none_also_where_elements_take_no_bytes() -> None:
    library = TypeLibrary(ros_version=1)
    schema = library.learn_message("q/msg/E", f"F[] elements\n{'=' * 80}\nMSG: q/F\n")
    with pytest.raises(ValueError, match="an array of 4294967295 elements cannot be in 4 bytes"):
        schema.codec.decode(b"\xff" * 4, Encoding.ROS1)


def qos(profiles: str) -> bytes:
    return text("offered_qos_profiles") + text(profiles)


def test_quality_of_service_is_read_without_a_parser_of_yaml(tmp_path: Path) -> None:
    for profiles, latched in {
        "- history: 1\n  depth: 1\n  durability: 1\n  deadline:\n    sec: 0\n": True,
        "- history: keep_last\n  depth: 1\n  durability: transient_local\n": True,
        "- durability: 1\n  depth: 1\n- depth: 5\n  durability: 2\n": False,
        "- depth: 1\n- durability: 1\n": False,
        "- deadline:\n    durability: 1\n": False,
        "[]": False,
        "": False,
        "- " + "[" * 262_144: False,
        "- durability: [" + "x, " * (8 << 18) + "]": False,
        "- &a {durability: 1}\n" + "- *a\n" * 100_000: False,
    }.items():
        data = described({"std_msgs/msg/String": "string data\n"}, more=qos(profiles))
        bag = opened(tmp_path / "qos.mcap", data)._bag
        assert bag is not None
        assert bag.streams[0].latched is latched, profiles[:80]


def test_metadata_with_aliases_or_deep_nesting_is_left_unread_with_a_note(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(HEADER + CHANNEL + messages(1) + END)
    for metadata, words in (
        ("a: &a [x, x]\nb: [*a, *a]\n", "it has aliases"),
        ("[" * 100_000, "nests deeper than 20 levels"),
        ("[]", "is not a mapping"),
        ("{a: b", "flow mapping"),
        ("x" * (3 << 20), "more than 2097152 bytes"),
    ):
        (tmp_path / "metadata.yaml").write_text(metadata)
        found = open_storage(tmp_path)
        assert any(words in note and "cannot be read" in note for note in found.notes), found.notes
        found.close()


def test_a_recording_that_nobody_waits_for_any_more_is_not_read_further(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(HEADER + CHANNEL + messages(10) + END)
    assert len(open_storage(path).messages.times) == 10
    budget = OpenBudget()
    budget.cancel()
    with pytest.raises(Unreachable, match="cancelled"):
        open_storage(path, budget)


def test_times_beyond_all_times_end_the_reading_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    late = record(5, struct.pack("<HIQQ", 1, 0, (1 << 64) - 1, 0))
    path.write_bytes(HEADER + CHANNEL + messages(3) + late + messages(3) + END)
    found = open_storage(path)
    assert len(found.messages.times) == 3
    assert any("out of range" in note for note in found.notes)
    found.close()


TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"


def test_a_database_whose_rows_are_a_program_is_refused(tmp_path: Path) -> None:
    for number, (words, statement) in enumerate(
        {
            "are a view, not a table": "CREATE VIEW messages AS WITH RECURSIVE n(i) AS "
            "(SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT i AS rowid, 1 AS topic_id, i AS timestamp, zeroblob(1000000) AS data FROM n",
            "columns that are generated": "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
            "timestamp INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(900000000)))",
        }.items()
    ):
        path = tmp_path / f"{number}.db3"
        with sqlite3.connect(path) as database:
            database.execute(TOPICS)
            database.execute("INSERT INTO topics VALUES (1, '/x', 'std_msgs/msg/String', 'cdr')")
            database.execute(statement)
        database.close()

        def refused(path: Path = path, words: str = words) -> None:
            with pytest.raises(Unreachable, match=words):
                open_storage(path)

        assert peak(refused) < MIB
