"""Recordings made to cost more than they are: small files that claim, inflate to or index more than there is."""

from __future__ import annotations

import sqlite3
import struct
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from lz4.frame import compress as lz4_compress  # type: ignore[import-untyped]

from rosld.adapters.model import Unreachable
from rosld.adapters.recording import byte_source
from rosld.adapters.recording.byte_source import MAX_PIECE, decompress, decompress_zstd
from rosld.adapters.recording.files import open_storage
from rosld.adapters.recording.open_budget import OpenBudget
from rosld.adapters.recording.storage import Damaged

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
MIB = 1 << 20


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def record(op: int, body: bytes) -> bytes:
    """A record of an MCAP file (https://mcap.dev/spec)."""
    return struct.pack("<BQ", op, len(body)) + body


HEADER = MAGIC + record(1, text("ros2") + text("made"))
CHANNEL = record(3, struct.pack("<H", 1) + text("std_msgs/msg/String") + text("ros2msg") + text("string data\n"))
CHANNEL += record(4, struct.pack("<HH", 1, 1) + text("/x") + text("cdr") + struct.pack("<I", 0))
END = record(0x0F, bytes(4)) + record(2, bytes(20)) + MAGIC


def chunk(data: bytes, compression: str, claimed: int, crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, claimed, crc) + text(compression)
    return record(6, head + struct.pack("<Q", len(data)) + data)


def peak(work: Callable[[], object]) -> int:
    """The most memory that Python's objects took while `work` ran, in bytes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_a_chunk_that_claims_more_than_a_message_may_have_is_not_decompressed(compression: str) -> None:
    def refused() -> None:
        with pytest.raises(Damaged, match=f"claims to hold {1 << 31} bytes, and {MAX_PIECE} are the most"):
            decompress(compression, b"whatever", 1 << 31)

    assert peak(refused) < MIB


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_memory_is_taken_for_what_a_chunk_holds_and_not_for_what_it_claims(compression: str) -> None:
    import bz2

    data = {"zstd": zstd.compress, "lz4": lz4_compress, "bz2": bz2.compress}[compression](bytes(1000))

    def refused() -> None:
        with pytest.raises(Damaged, match="holds other than"):
            decompress(compression, data, MAX_PIECE)

    assert peak(refused) < 8 * MIB


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_a_chunk_of_several_steps_is_decompressed_whole_and_never_beyond_its_size(compression: str) -> None:
    import bz2
    import random

    whole = random.Random(1).randbytes(3 * MIB) + bytes(5 * MIB) + b"end"
    data = {"zstd": zstd.compress, "lz4": lz4_compress, "bz2": bz2.compress}[compression](whole)
    assert decompress(compression, data, len(whole)) == whole
    for claimed in (len(whole) - 1, len(whole) + 1, 0):
        with pytest.raises(Damaged, match="holds other than"):
            decompress(compression, data, claimed)
    with pytest.raises(Damaged):
        decompress(compression, data[: len(data) // 2], len(whole))


def test_a_message_that_inflates_beyond_a_message_is_left_where_the_limit_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(byte_source, "MAX_PIECE", 4 * MIB)
    bomb = zstd.compress(bytes(64 * MIB))
    assert len(bomb) < 64 << 10

    def refused() -> None:
        with pytest.raises(Damaged, match="holds more than the"):
            decompress_zstd(bomb)

    assert peak(refused) < 16 * MIB
    assert decompress_zstd(zstd.compress(bytes(4 * MIB))) == bytes(4 * MIB)


def messages(count: int) -> bytes:
    return record(5, struct.pack("<HIQQ", 1, 0, 10**9, 10**9)) * count


def test_a_small_file_whose_chunks_inflate_to_millions_of_messages_is_refused_within_its_budget(
    tmp_path: Path,
) -> None:
    inner = messages(200_000)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(HEADER + CHANNEL + chunk(zstd.compress(inner), "zstd", len(inner), zlib.crc32(inner)) * 50 + END)
    assert path.stat().st_size < MIB

    def refused() -> None:
        with pytest.raises(Unreachable, match=f"its index takes more than {4 * MIB} bytes"):
            open_storage(path, OpenBudget(4 * MIB))

    assert peak(refused) < 64 * MIB


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


def test_a_recording_that_nobody_waits_for_any_more_is_not_read_further(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(HEADER + CHANNEL + messages(10) + END)
    assert len(open_storage(path).messages.times) == 10
    budget = OpenBudget()
    budget.cancel()
    with pytest.raises(Unreachable, match="called off"):
        open_storage(path, budget)


def test_times_beyond_all_times_end_the_reading_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    late = record(5, struct.pack("<HIQQ", 1, 0, (1 << 64) - 1, 0))
    path.write_bytes(HEADER + CHANNEL + messages(3) + late + messages(3) + END)
    storage = open_storage(path)
    assert len(storage.messages.times) == 3
    assert any("later than can be" in note for note in storage.notes)
    storage.close()


TOPICS = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        (
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT i AS rowid, 1 AS topic_id, i AS timestamp, zeroblob(1000000) AS data FROM n",
            "are a view, not a table",
        ),
        (
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
            "data BLOB GENERATED ALWAYS AS (zeroblob(900000000)))",
            "columns that are generated",
        ),
    ],
)
def test_a_database_whose_rows_are_a_program_is_refused(tmp_path: Path, statement: str, words: str) -> None:
    path = tmp_path / "odd.db3"
    with sqlite3.connect(path) as database:
        database.execute(TOPICS)
        database.execute("INSERT INTO topics VALUES (1, '/x', 'std_msgs/msg/String', 'cdr')")
        database.execute(statement)
    database.close()

    def refused() -> None:
        with pytest.raises(Unreachable, match=words):
            open_storage(path)

    assert peak(refused) < MIB
