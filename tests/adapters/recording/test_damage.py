"""Unusual, truncated, damaged and invalid recordings."""

from __future__ import annotations

import asyncio
import bz2
import os
import socket
import sqlite3
import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1

from rosld.adapters.base import AdapterOptions, NullSink
from rosld.adapters.model import NotFound, RosError, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.recording import RecordingAdapter
from rosld.adapters.recording.adapter import open_storage
from rosld.adapters.recording.bag import Bag
from tests.adapters.recording import recorder
from tests.adapters.recording.recorder import opened, said

MESSAGE, CHUNK = 2, 5
"""Op codes of records of a bag."""

OLD_HEADER = """Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: roslib/Header
uint32 seq
time stamp
string frame_id
"""


def refused(path: Path) -> str:
    """Return the message with which a path is rejected: one line that contains it."""

    async def scenario() -> RosError:
        adapter = RecordingAdapter(path, AdapterOptions())
        with pytest.raises((Unreachable, NotFound)) as caught:
            await adapter.open(NullSink(), deadline=asyncio.get_running_loop().time() + 10)
        await adapter.close()
        return caught.value

    error = asyncio.run(scenario())
    assert str(path) in error.sentence
    assert "\n" not in error.sentence
    return error.sentence


# Unusual connections


def test_the_old_header_is_read(tmp_path: Path) -> None:
    path = tmp_path / "old.bag"
    with Writer1(path) as writer:
        connection = writer.add_connection(
            "joint_states", "sensor_msgs/msg/JointState", msgdef=OLD_HEADER, md5sum="3066dcd76a6cfaef579bd0f34173e9fd"
        )
        header = struct.pack("<IIII", 7, 1, 2, 4) + b"base"
        writer.write(connection, 10**9, header + struct.pack("<I", 0) * 4)
    with opened(path) as bag:
        (topic,) = bag.topics.values()
        assert (topic.name, topic.unreadable) == ("/joint_states", None)
        recorded = bag.message(0)
        message = bag.schema(recorded.sample.schema).codec.decode(recorded.sample.data, recorded.sample.encoding)
        assert (message.header.seq, message.header.frame_id) == (7, "base")


async def test_one_odd_connection_leaves_the_others_readable(tmp_path: Path, play: Any) -> None:
    path = tmp_path / "odd.bag"
    with Writer1(path) as writer:
        kind = recorder.ROS1.types["std_msgs/msg/String"]
        good = writer.add_connection("/good", "std_msgs/msg/String", typestore=recorder.ROS1)
        lacking = writer.add_connection("/lacking", "my_msgs/msg/X", msgdef="other_msgs/Y y\n", md5sum="1" * 32)
        lying = writer.add_connection("/lying", "my_msgs/msg/Z", msgdef="float64 z\n", md5sum="2" * 32)
        broken = writer.add_connection("/broken", "my_msgs/msg/W", msgdef="float64 z z z =\n[]", md5sum="3" * 32)
        nameless = writer.add_connection("/nameless", "/msg/", msgdef="float64 z\n", md5sum="4" * 32)
        for connection in (lacking, lying, broken, nameless):
            writer.write(connection, 10**9, b"whatever")
        writer.write(good, 2 * 10**9, recorder.ROS1.serialize_ros1(kind("hello"), kind.__msgtype__))
    with opened(path) as bag:
        words = {name: topic.unreadable for name, topic in bag.topics.items()}
        assert words.pop("/good") is None
        assert "other_msgs/msg/Y" in str(words["/lacking"])
        assert "2" * 32 in str(words["/lying"])
        assert all(words.values())
        assert [each.sample.data for each in bag.messages()][:4] == [b"whatever"] * 4
        assert said(bag, bag.message(4)) == "hello"
    async with play(path) as adapter:
        assert adapter.graph.topics["/lying"].unreadable == words["/lying"]
        assert set(adapter.graph.topics) == {"/good", "/lacking", "/lying", "/broken", "/nameless"}
        assert [each.data for each in (await adapter.subscribe("/lacking")).latest()] == [b"whatever"]


def test_channels_of_an_mcap_that_are_not_ros_are_listed_and_the_others_read(tmp_path: Path) -> None:
    path = recorder.write_rosbag2(tmp_path / "run", recorder.lines(count=3)) / "run.mcap"
    data = path.read_bytes()
    path.write_bytes(_with_json_channel(data))
    with opened(path) as bag:
        assert "json" in str(bag.topics["/settings"].unreadable)
        assert [said(bag, each) for each in bag.messages() if each.topic == "/chatter"] == ["0", "1", "2"]
        assert bag.topics["/settings"].count == 1


def _with_json_channel(data: bytes) -> bytes:
    """Return an MCAP without summary: `data`, followed by a channel of JSON."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    end = data.index(struct.pack("<BQI", 0x0F, 4, 0))
    schema = struct.pack("<H", 77) + text("Settings") + text("jsonschema") + text("{}")
    channel = struct.pack("<HH", 77, 77) + text("/settings") + text("json") + struct.pack("<I", 0)
    message = struct.pack("<HIQQ", 77, 0, 10**9, 10**9) + b"{}"
    extra = record(3, schema) + record(4, channel) + record(5, message) + record(0x0F, bytes(4))
    return data[:end] + extra + record(2, bytes(20)) + b"\x89MCAP0\r\n"


def test_a_type_defined_in_idl_is_read(tmp_path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    idl = f"{'=' * 80}\nIDL: my_msgs/msg/X\nmodule my_msgs {{ module msg {{ struct X {{ double x; }}; }}; }};\n"
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/x", "my_msgs/msg/X", msgdef=idl, rihs01="RIHS01_" + "0" * 64)
        writer.write(connection, 10**9, b"\x00\x01\x00\x00" + struct.pack("<d", 2.5))
    with opened(tmp_path / "run") as bag:
        sample = bag.message(0).sample
        assert bag.schema(sample.schema).codec.decode(sample.data, sample.encoding).x == 2.5


# Truncated and damaged


def test_a_bag_that_was_cut_short_or_never_finished_gives_all_whole_chunks(tmp_path: Path) -> None:
    for compression in ("none", "lz4"):
        path = tmp_path / f"{compression}.bag.active"
        recorder.write_rosbag1(path, recorder.lines(count=100), compression=compression, chunk=1000)
        whole = path.read_bytes()
        data = bytearray(whole)
        at = data.index(b"index_pos=") + len(b"index_pos=")
        end = int.from_bytes(data[at : at + 8], "little")
        data[at : at + 8] = bytes(8)
        for cut, note in ((bytes(data[: end * 2 // 3]), "never finished"), (whole[: end * 2 // 3], "chunks")):
            path.write_bytes(cut)
            with opened(path) as bag:
                assert bag.name == compression
                assert 10 < bag.count < 100
                assert [said(bag, each) for each in bag.messages()] == [str(each) for each in range(bag.count)]
                assert any(note in each for each in bag.notes)


@pytest.mark.parametrize("compression", ["none", "storage"])
def test_an_mcap_cut_short_gives_all_whole_chunks(tmp_path: Path, compression: str) -> None:
    lines = [recorder.Line(each / 100, "/chatter", f"{each} {os.urandom(20_000).hex()}") for each in range(100)]
    path = recorder.write_rosbag2(tmp_path / "run", lines, compression=compression) / "run.mcap"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with opened(path) as bag:
        assert 0 < bag.count < 100
        assert [said(bag, each) for each in bag.messages()] == [line.text for line in lines[: bag.count]]
        assert bag.notes


def test_a_folder_with_a_missing_or_broken_file_gives_the_others(tmp_path: Path) -> None:
    folder = recorder.write_rosbag2(tmp_path / "run", recorder.lines())
    metadata = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(metadata.replace("- run.mcap", "- run.mcap\n  - gone.mcap"))
    with opened(folder) as bag:
        assert bag.count == 10
        assert any("gone.mcap" in note for note in bag.notes)
    (folder / "metadata.yaml").write_text(": [")
    (folder / "broken.mcap").write_bytes(b"\x89MCAP0\r\nbroken")
    with opened(folder) as bag:
        assert bag.count == 10
        assert any("broken.mcap" in note for note in bag.notes)


def records(data: bytes | bytearray, at: int) -> Iterator[tuple[int, slice]]:
    """Yield the op and the offset of the data of each record of a bag, from an offset on (ROS bag format 2.0)."""
    while at < len(data):
        (length,) = struct.unpack_from("<I", data, at)
        header, at = data[at + 4 : at + 4 + length], at + 4 + length
        (length,) = struct.unpack_from("<I", data, at)
        yield header[header.index(b"op=") + 3], slice(at + 4, at + 4 + length)
        at += 4 + length


async def test_a_damaged_chunk_costs_only_its_own_messages(tmp_path: Path, play: Any, clock: Any) -> None:
    path = recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(count=100), compression="bz2", chunk=1000)
    data = bytearray(path.read_bytes())
    first, second = islice((span for op, span in records(data, 13) if op == CHUNK), 2)
    counts = [sum(op == MESSAGE for op, _ in records(bz2.decompress(data[at]), 0)) for at in (first, second)]
    positions = range(counts[0], sum(counts))
    assert len(positions) > 1
    data[second.start + 20 : second.start + 60] = bytes(40)
    path.write_bytes(data)
    with opened(path) as bag:
        texts = [said(bag, each) for each in bag.messages()]
        assert texts == [str(each) for each in range(100) if each not in positions]
        with pytest.raises(Unreachable, match=f"message {positions[0]} of the recording run"):
            bag.message(positions[0])
    async with play(path) as adapter:
        subscription = await adapter.subscribe("/chatter")
        clock.forward(positions[0] * 0.1 + 0.01)
        assert subscription.latest() == ()
        clock.forward(len(positions) * 0.1)
        assert len(subscription.latest()) == 1


# Not recordings


def test_what_is_no_recording_is_refused_in_a_sentence(tmp_path: Path) -> None:
    assert "there is no recording" in refused(tmp_path / "missing.bag")
    assert "neither metadata.yaml nor" in refused(tmp_path)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "s"))
        assert "No such device" in refused(tmp_path / "s")
    path = tmp_path / "file.bag"
    for content, words in {
        b"": "is empty",
        b"hello, this is no recording at all": "not a ROS 1 bag",
        b"#ROSBAG V1.2\n": "version 1.2",
        b"#ROSBAG V2.0\n": "there is no record",
        b"#ROSBAG V2.0\n\xff\xff\xff\xff": "there is no record",
        b"\x89MCAP0\r\n": "missing",
        b"\x89MCAP0\r\n" + b"\xff" * 100: "cut off",
        b"SQLite format 3\0" + bytes(100): "database",
        encrypted(recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines()).read_bytes()): "encrypted",
    }.items():
        path.write_bytes(content)
        assert words in refused(path)
    other = tmp_path / "other.db3"
    with sqlite3.connect(other) as database:
        database.execute("CREATE TABLE cats (name TEXT)")
    database.close()
    assert "not a database of messages" in refused(other)


def encrypted(data: bytes) -> bytes:
    """Return a bag whose header states that it is encrypted."""
    size = int.from_bytes(data[13:17], "little")
    field = b"encryptor=rosbag/AesCbcEncryptor"
    header = data[17 : 17 + size] + struct.pack("<I", len(field)) + field
    return data[:13] + struct.pack("<I", len(header)) + header + data[17 + size :]


def test_a_chunk_that_claims_to_be_huge_is_not_believed(tmp_path: Path) -> None:
    path = recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(), compression="bz2")
    data = bytearray(path.read_bytes())
    at = data.index(b"size=") + 5
    data[at : at + 4] = b"\xff\xff\xff\xff"
    path.write_bytes(data)
    with opened(path) as bag, pytest.raises(Unreachable, match="states a size of"):
        bag.message(0)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the bytes of a small recording of each format."""
    folder = tmp_path_factory.mktemp("small")
    lines = recorder.lines(count=8)
    return {
        "bag": recorder.write_rosbag1(folder / "a.bag", lines, chunk=200).read_bytes(),
        "bz2": recorder.write_rosbag1(folder / "b.bag", lines, compression="bz2").read_bytes(),
        "mcap": (recorder.write_rosbag2(folder / "c", lines) / "c.mcap").read_bytes(),
        "zstd": (recorder.write_rosbag2(folder / "d", lines, compression="storage") / "d.mcap").read_bytes(),
        "db3": (recorder.write_rosbag2(folder / "e", lines, storage="sqlite3") / "e.db3").read_bytes(),
    }


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(["bag", "bz2", "mcap", "zstd", "db3"]), data=st.data())
def test_whatever_is_damaged_the_file_is_read_as_far_as_it_goes_or_refused(
    small: dict[str, bytes], tmp_path: Path, kind: str, data: Any
) -> None:
    octets = bytearray(small[kind])
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(octets) - 1))
        octets[at] = data.draw(st.integers(0, 255))
    cut = data.draw(st.sampled_from([len(octets), len(octets) * 3 // 4, len(octets) // 2, 50]))
    path = tmp_path / "file"
    path.write_bytes(octets[:cut])
    try:
        storage = open_storage(path)
    except Unreachable:
        return
    try:
        bag = Bag("x", path, storage, TypeLibrary(ros_version=storage.ros_version))
        assert sum(1 for _ in bag.messages()) <= bag.count
    finally:
        storage.close()
