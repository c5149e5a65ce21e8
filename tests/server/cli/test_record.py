"""`rosld record`: a source recorded into a file that other tools read."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from rosbags import rosbag2

from rosld.server.cli.main import main
from tests.forked import ForkedCommand
from tests.server.history.mcap_files import decode, read
from tests.waiting import until

pytestmark = pytest.mark.slow


def record(*arguments: object, code: int = 0) -> Result:
    """Run the command in this process; return its exit code."""
    result = CliRunner().invoke(main, ["record", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result


def test_a_source_is_recorded_for_a_while(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    options = ["--duration", "1", "--topic", "/odom", "--topic", "/camera/*", "--topic", "/odm"]
    done = record("rover", "-o", path, *options)
    found = read(path)
    topics = {one.topic for one in found}
    assert "/odom" in topics
    assert all(topic == "/odom" or topic.startswith("/camera/") for topic in topics)
    assert f"{path}: {len(found)} messages on {len(topics)} topics" in done.stderr
    assert "rosld: no messages received on /odm\n" in done.stderr
    assert len(decode(path)) == len(found)


def test_a_name_without_a_suffix_is_the_folder_of_a_ros_2_bag_and_each_ros_has_its_own(tmp_path: Path) -> None:
    command, folder = ("rover", "--duration", "1", "-o"), tmp_path / "drive"
    done = record(*command, folder)
    assert f"{folder}: " in done.stderr
    with rosbag2.Reader(folder) as reader:
        assert {"/odom", "/map", "/tf_static"} <= {each.topic for each in reader.connections}
        assert f"{folder}: {reader.message_count} messages" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["drive"], "nothing else is left"
    for name in ("drive.bag", "drive.db3"):
        refused = record(*command, tmp_path / name, code=2)
        assert "the messages are of ROS 2; use FILE.mcap or FOLDER, a ROS 2 bag" in refused.stderr


def test_a_pipe_gets_mcap(tmp_path: Path) -> None:
    piped = record("rover", "-o", "-", "--duration", "1", "--topic", "/odom")
    path = tmp_path / "piped.mcap"
    path.write_bytes(piped.stdout_bytes)
    assert {one.topic for one in read(path)} == {"/odom"}
    assert "-: " in piped.stderr


def test_a_signal_ends_it_and_the_file_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    process = ForkedCommand("record", "rover", "-o", str(path))
    active = tmp_path / "run.mcap.active"
    until(lambda: active.exists() and active.stat().st_size > 10_000, "some messages on the disk")
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) == 0
    assert len(read(path)) > 10
    assert not active.exists()


def test_what_is_there_is_not_written_over_and_what_cannot_be_recorded_is_refused(tmp_path: Path) -> None:
    path, other = tmp_path / "run.mcap", tmp_path / "other.mcap"
    path.write_bytes(b"mine")
    (tmp_path / "drive.bag").write_bytes(b"")
    for arguments, code, words in (
        (("rover", "-o", path), 5, "already exists"),
        ((tmp_path / "drive.bag", "-o", other), 2, "is already a recording"),
        (("rovre", "-o", other), 2, "rovre is not a live source"),
        (("rover", "-o", other, "--topic", "odom"), 2, "--topic odom: must begin with a slash or a star"),
    ):
        assert words in record(*arguments, code=code).stderr
    assert path.read_bytes() == b"mine"
    assert not other.exists()
