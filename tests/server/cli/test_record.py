"""`rosld record`: a source recorded into a file that others read."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rosbags import rosbag2

from tests.server.history.mcap_files import decode, read
from tests.waiting import until

RECORD = [sys.executable, "-m", "rosld", "record"]


def test_a_source_is_recorded_for_a_while(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    options = ["--duration", "1.5", "--topic", "/odom", "--topic", "/camera/*"]
    done = subprocess.run([*RECORD, "rover", "-o", str(path), *options], capture_output=True, text=True, check=True)
    found = read(path)
    topics = {one.topic for one in found}
    assert "/odom" in topics
    assert all(topic == "/odom" or topic.startswith("/camera/") for topic in topics)
    assert f"{path}: {len(found)} messages of {len(topics)} topics" in done.stderr
    assert len(decode(path)) == len(found)


def test_a_name_without_a_suffix_is_the_folder_of_a_ros_2_bag_and_each_ros_has_its_own(tmp_path: Path) -> None:
    command, folder = [*RECORD, "rover", "--duration", "1", "-o"], tmp_path / "drive"
    done = subprocess.run([*command, str(folder)], capture_output=True, text=True, check=True)
    assert f"{folder}: " in done.stderr
    with rosbag2.Reader(folder) as reader:
        assert {"/odom", "/map", "/tf_static"} <= {each.topic for each in reader.connections}
        assert f"{folder}: {reader.message_count} messages" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["drive"], "nothing else is left"
    for name in ("drive.bag", "drive.db3"):
        refused = subprocess.run([*command, str(tmp_path / name)], capture_output=True, text=True, check=False)
        assert refused.returncode == 1
        assert "the messages are of ROS 2; name a FILE.mcap, or a FOLDER, a ROS 2 bag" in refused.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_and_the_file_is_whole(tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "run.mcap"
    process = subprocess.Popen([*RECORD, "rover", "-o", str(path)], stderr=subprocess.PIPE, text=True)
    active = tmp_path / "run.mcap.active"
    until(lambda: active.exists() and active.stat().st_size > 10_000, "some messages on the disk")
    process.send_signal(number)
    assert process.wait(30) == 0
    assert len(read(path)) > 10
    assert not active.exists()


def test_what_is_there_is_not_written_over_and_a_recording_is_not_recorded(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"mine")
    refused = subprocess.run([*RECORD, "rover", "-o", str(path)], capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "is there already" in refused.stderr
    assert path.read_bytes() == b"mine"
    (tmp_path / "drive.bag").write_bytes(b"")
    for source, words in ((tmp_path / "drive.bag", "is a recording already"), ("rovre", "rovre is no live source")):
        other = str(tmp_path / "other.mcap")
        refused = subprocess.run([*RECORD, str(source), "-o", other], capture_output=True, text=True, check=False)
        assert refused.returncode == 1
        assert words in refused.stderr


def test_a_topic_of_which_nothing_comes_is_named_and_what_can_be_none_is_refused(tmp_path: Path) -> None:
    options = ["--duration", "1", "--topic", "/odom", "--topic", "/odm"]
    command = [*RECORD, "rover", "-o", str(tmp_path / "run.mcap")]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=True)
    assert "rosld: no message came of /odm\n" in done.stderr
    command = [*RECORD, "rover", "-o", str(tmp_path / "none.mcap")]
    refused = subprocess.run([*command, "--topic", "odom"], capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "--topic odom: a topic or a glob begins with a slash or a star" in refused.stderr
    assert not (tmp_path / "none.mcap").exists()
