"""Equal messages from every format of recordings."""

from __future__ import annotations

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.model import Encoding, TypeRef
from tests.adapters.recording import recorder
from tests.adapters.recording.recorder import opened, said

STRING = "std_msgs/msg/String"


def some_lines() -> list[Any]:
    """Return two topics whose messages interleave, written out of order."""
    one = recorder.lines("/one", 40, 0.1, "/a")
    two = [recorder.Line(0.05 + each * 0.2, "/two", f"two {each}", "/b") for each in range(20)]
    return [*two, *one]


@pytest.mark.parametrize(("compression", "chunk"), [("none", 1), ("bz2", 500), ("lz4", 1 << 20)])
def test_a_ros1_bag_is_read_in_recorded_order(tmp_path: Path, compression: str, chunk: int) -> None:
    lines = some_lines()
    path = recorder.write_rosbag1(tmp_path / "run.bag", lines, compression=compression, chunk=chunk)
    with opened(path) as bag:
        assert bag.notes == ()
        expected = sorted(lines, key=lambda line: line.seconds)
        assert [said(bag, each) for each in bag.messages()] == [line.text for line in expected]
        assert [each.sample.publisher for each in bag.messages()] == [line.node for line in expected]
        assert {each.sample.encoding for each in bag.messages()} == {Encoding.ROS1}
        assert bag.topics["/one"].type == TypeRef(STRING, "992ce8a1687cec8c8bd883ec73ca41d1")
        assert (bag.topics["/one"].count, bag.topics["/two"].count) == (40, 20)


def test_a_ros2_folder_of_any_storage_is_read_in_recorded_order_and_so_is_its_file_alone(tmp_path: Path) -> None:
    lines = some_lines()
    expected = [line.text for line in sorted(lines, key=lambda line: line.seconds)]
    for storage, compression, version in (
        ("mcap", "none", 9),
        ("mcap", "storage", 9),
        ("mcap", "file", 8),
        ("mcap", "message", 9),
        ("sqlite3", "none", 9),
        ("sqlite3", "none", 8),
        ("sqlite3", "file", 9),
        ("sqlite3", "message", 8),
    ):
        name = f"{storage}_{compression}_{version}"
        how = {"storage": storage, "compression": compression, "version": version}
        folder = recorder.write_rosbag2(tmp_path / name, lines, **how)
        with opened(folder) as bag:
            assert (bag.name, bag.notes) == (name, ())
            assert [said(bag, each) for each in bag.messages()] == expected, name
            assert {each.sample.encoding for each in bag.messages()} == {Encoding.CDR}
            assert bag.topics["/one"].type.name == STRING
            assert bag.topics["/one"].type.hash.startswith("RIHS01_")
        if compression == "none":
            (file,) = (each for each in folder.iterdir() if each.suffix != ".yaml")
            alone = tmp_path / f"{name}.data"
            shutil.copy(file, alone)
            with opened(alone) as bag:
                assert (bag.name, [said(bag, each) for each in bag.messages()]) == (name, expected)


def test_a_folder_of_several_files_is_one_recording(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for number in range(3):
        lines = [recorder.Line(number + each / 10, "/chatter", f"{number}.{each}") for each in range(5)]
        part = recorder.write_rosbag2(tmp_path / f"part_{number}", lines, storage="sqlite3" if number == 1 else "mcap")
        for path in part.glob("part_*"):
            shutil.copy(path, folder)
    with opened(folder) as bag:
        assert [said(bag, each) for each in bag.messages()] == [f"{n}.{e}" for n in range(3) for e in range(5)]
        assert [each.sample.sequence for each in bag.messages()] == list(range(1, 16))
        assert bag.topics["/chatter"].count == 15
        assert "metadata.yaml" in bag.notes[0]


def test_a_recording_may_hold_nothing(tmp_path: Path) -> None:
    for path in (
        recorder.write_rosbag1(tmp_path / "empty.bag", []),
        recorder.write_rosbag2(tmp_path / "empty", []),
        recorder.write_rosbag2(tmp_path / "empty3", [], storage="sqlite3"),
    ):
        with opened(path) as bag:
            assert (bag.count, dict(bag.topics), list(bag.messages())) == (0, {}, [])


def test_messages_are_not_held_in_memory_but_read_when_asked_for(tmp_path: Path) -> None:
    path = recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(count=2000))
    with opened(path) as bag:
        before = bag.message(10).sample.data
    with opened(path) as bag:
        written = path.read_bytes()
        with path.open("r+b") as file:
            file.seek(written.index(before))
            file.write(b"x" * len(before))
        assert bag.message(10).sample.data == b"x" * len(before)


def test_a_recording_can_be_read_by_several_threads_at_once(tmp_path: Path) -> None:
    path = recorder.write_rosbag1(tmp_path / "run.bag", recorder.lines(count=300), compression="bz2", chunk=1000)
    with opened(path) as bag, ThreadPoolExecutor(4) as threads:
        readings = threads.map(lambda _: [said(bag, each) for each in bag.messages()], range(8))
        assert all(reading == [str(each) for each in range(300)] for reading in readings)
