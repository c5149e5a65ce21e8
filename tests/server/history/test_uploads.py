"""Uploaded recordings: compressed, malicious, truncated, sent twice concurrently, or replacing a broken one."""

from __future__ import annotations

import os
import queue
import resource
import struct
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosld.server.history import recordings
from rosld.server.history.uploads import check_recording
from tests.adapters.recording.recorder import lines, write_rosbag1, write_rosbag2
from tests.adapters.recording.test_hostile_files import CHANNEL, END, HEADER, chunk, messages, record
from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
PROBLEM = {"Accept": "application/problem+json"}
MIB = 1 << 20
UPLOAD_LIMIT = 8 * MIB


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with files of each kind that rosld has left or cannot open."""
    folder = tmp_path_factory.mktemp("data")
    bags = folder / "bags"
    bags.mkdir()
    (bags / ".cut.part").write_bytes(b"#ROSBAG V2.0\n")
    (bags / ".cut.inflated").write_bytes(b"#ROSBAG V2.0\n")
    (bags / ".somebody's").write_bytes(b"not ours")
    (bags / ".no name.part").write_bytes(b"not ours")
    (bags / "notes.part").write_bytes(b"not ours")
    (bags / "broken.mcap").write_bytes(b"\x89MCAP0\r\n" + b"\xff" * 100)
    return folder


@pytest.fixture(scope="module")
def http(data: Path) -> Iterator[Any]:
    """A client of a robot that accepts only small files."""
    with served(MadeUp(), data=data, upload_limit=UPLOAD_LIMIT, upload_index_limit=2 * MIB) as client:
        yield client


def refused(answer: Any, status: int) -> str:
    """Return the message of a refusal."""
    assert answer.status_code == status, answer.text
    return str(answer.json()["detail"])


def left(data: Path) -> list[str]:
    return sorted(path.name for path in (data / "bags").iterdir())


def test_what_a_killed_server_was_receiving_is_removed_at_the_next_start_and_nothing_else(
    http: Any, data: Path
) -> None:
    assert left(data) == [".no name.part", ".somebody's", "broken.mcap", "notes.part"]


def test_the_name_of_a_file_that_cannot_be_opened_is_taken_until_it_is_deleted(
    http: Any, data: Path, tmp_path: Path
) -> None:
    whole = write_rosbag1(tmp_path / "talk.bag", lines()).read_bytes()
    words = refused(http.put("/bags/broken", content=whole, headers=PROBLEM), 409)
    assert "broken.mcap already exists and cannot be opened: DELETE it" in words
    assert not (data / "bags" / "broken.bag").exists()
    assert "cut off" in refused(http.get("/bags/broken/", headers=PROBLEM), 404)
    assert http.delete("/bags/broken/").status_code == 204
    assert not (data / "bags" / "broken.mcap").exists()
    assert http.put("/bags/broken", content=whole).status_code == 201
    assert http.get("/bags/broken/messages/3", headers=JSON).json() == {"data": "3"}
    assert http.delete("/bags/broken/").status_code == 204


def test_a_recording_compressed_by_zstd_is_inflated_and_read(http: Any, tmp_path: Path) -> None:
    sent = [write_rosbag1(tmp_path / "talk.bag", lines())]
    for storage, kind in (("mcap", "mcap"), ("sqlite3", "db3")):
        sent += write_rosbag2(tmp_path / kind, lines(), storage=storage).glob(f"*.{kind}")
    for file in sent:
        assert http.put("/bags/packed", content=zstd.compress(file.read_bytes())).status_code == 201
        assert http.get("/bags/packed/messages/3", headers=JSON).json() == {"data": "3"}
        assert http.get("/bags/packed/file").content == file.read_bytes()
        assert http.delete("/bags/packed/").status_code == 204


def test_what_inflates_beyond_the_limit_of_uploads_is_refused_and_the_setting_is_named(http: Any, data: Path) -> None:
    before = left(data)
    bomb = zstd.compress(b"#ROSBAG V2.0\n" + bytes(16 * UPLOAD_LIMIT))
    assert len(bomb) < 64 << 10
    words = refused(http.put("/bags/bomb", content=bomb, headers=PROBLEM), 413)
    assert f"exceeds the {UPLOAD_LIMIT} bytes that the setting `upload_limit` allows" in words
    for body, reason in (
        (zstd.compress(b"nothing that is a recording"), "not a ROS 1 bag"),
        (zstd.compress(b"#ROSBAG V2.0\n" * 1000)[:-5], "cannot be decompressed"),
        (zstd.compress(zstd.compress(b"#ROSBAG V2.0\n")), "not a ROS 1 bag"),
    ):
        assert reason in refused(http.put("/bags/bomb", content=body, headers=PROBLEM), 422)
    assert left(data) == before


def test_no_hostile_file_ends_the_server_or_fills_its_memory(http: Any, data: Path) -> None:
    before, peak = left(data), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    inner = messages(100_000)
    many = HEADER + CHANNEL + chunk(zstd.compress(inner), "zstd", len(inner)) * 100 + END
    liar = HEADER + CHANNEL + chunk(zstd.compress(b"x"), "zstd", 1 << 40) + END
    deep = HEADER + CHANNEL.replace(b"string data\n", b"[" * 12) + END
    assert "its index takes more than" in refused(http.put("/bags/many", content=many, headers=PROBLEM), 422)
    for body in (liar, deep):
        answer = http.put("/bags/odd", content=body)
        assert answer.status_code in (201, 422), answer.text
        if answer.status_code == 201:
            assert http.get("/bags/odd/messages/").status_code < 500
            assert http.delete("/bags/odd/").status_code == 204
    assert http.get("/topics/").status_code == 200
    assert left(data) == before
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak) * 1024
    assert grown < 256 * MIB, "the chunks hold 300 MB, and the index of all messages 400 MB"


def test_two_that_send_a_recording_of_one_name_at_a_time_do_not_write_into_one_file(
    http: Any, data: Path, tmp_path: Path
) -> None:
    whole = write_rosbag1(tmp_path / "talk.bag", lines()).read_bytes()
    rest: queue.Queue[bytes] = queue.Queue()
    answers: list[Any] = []

    def body() -> Iterator[bytes]:
        yield whole[:100]
        yield rest.get(timeout=60)

    first = threading.Thread(target=lambda: answers.append(http.put("/bags/twice", content=body())))
    first.start()
    until(lambda: any("twice" in name for name in left(data)), "the name is taken by the first")
    assert http.put("/bags/twice", content=b"nothing").status_code == 409
    rest.put(whole[100:])
    first.join()
    assert answers[0].status_code == 201, answers[0].text
    assert http.get("/bags/twice/file").content == whole
    assert http.delete("/bags/twice/").status_code == 204


def test_two_files_of_one_name_are_not_both_opened(tmp_path: Path) -> None:
    bags = tmp_path / "bags"
    bags.mkdir()
    write_rosbag1(bags / "talk.bag", lines())
    os.link(next(write_rosbag2(tmp_path / "talk", lines(count=3)).glob("*.mcap")), bags / "talk.mcap")
    with served(MadeUp(), data=tmp_path) as client:
        assert client.get("/bags/talk/messages/9", headers=JSON).json() == {"data": "9"}


def hang_or_check(path: Path, index_limit: int) -> None:
    """Check a file in a worker; `endless` takes for ever, `slow` until a file called `release` exists."""
    while "endless" in path.name or ("slow" in path.name and not (path.parent / "release").exists()):
        time.sleep(0.01)
    check_recording(path, index_limit)


def test_a_file_that_takes_too_long_to_check_is_given_up_and_holds_up_no_other(
    http: Any, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = write_rosbag1(tmp_path / "talk.bag", lines()).read_bytes()
    before = left(data)
    monkeypatch.setattr(recordings, "check_recording", hang_or_check)
    monkeypatch.setattr(recordings, "check_seconds", lambda path: 1.0 if "endless" in path.name else 60.0)
    answers: list[Any] = []
    slow = threading.Thread(target=lambda: answers.append(http.put("/bags/slow", content=whole, headers=PROBLEM)))
    slow.start()
    assert http.put("/bags/quick", content=whole).status_code == 201
    assert not answers, "the other one is still being checked"
    (data / "bags" / "release").touch()
    slow.join()
    assert answers[0].status_code == 201
    (data / "bags" / "release").unlink()
    assert "takes more than 1 s" in refused(http.put("/bags/endless", content=whole, headers=PROBLEM), 503)
    for name in ("quick", "slow"):
        assert http.delete(f"/bags/{name}/").status_code == 204
    assert left(data) == before


def test_a_bomb_in_the_quality_of_service_of_a_topic_is_not_parsed(http: Any) -> None:
    more = b"".join(
        struct.pack("<I", len(each)) + each
        for each in (b"offered_qos_profiles", b"- durability: [" + b"x, " * (1 << 18) + b"]")
    )
    channel = struct.pack("<HH", 2, 1) + b"\x02\0\0\0/y" + b"\x03\0\0\0cdr" + struct.pack("<I", len(more)) + more
    bomb = zstd.compress(HEADER + CHANNEL + record(4, channel) + messages(1) + END)
    assert len(bomb) < 2_000
    assert http.put("/bags/yaml", content=bomb).status_code == 201
    assert http.delete("/bags/yaml/").status_code == 204
