"""`rosld info`, `ls`, `query`, `cut` and `completion`: recordings on the command line, in tables and in JSON."""

from __future__ import annotations

import csv
import io
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet
import pytest
from click.testing import CliRunner, Result
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from rosld.server.cli.failure import ExitCode
from rosld.server.cli.main import main
from tests.runs import START_NS, write_run
from tests.server.history.mcap_files import read

_ZERO = QosTime(0, 0)
LATCHED = Qos(
    *(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, _ZERO, _ZERO),
    *(QosLiveliness.AUTOMATIC, _ZERO),
    avoid_ros_namespace_conventions=False,
)
Message = tuple[str, int, bytes]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of runs, whose battery falls to 0.6 and 0.85, and of a file that is none."""
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder / "long.mcap", seconds=30, seed=1)
    (folder / "monday").mkdir()
    write_run(folder / "monday" / "short.bag", seconds=5, seed=2)
    write_run(folder / "monday" / "folder", seconds=2, seed=3)
    (folder / "broken.mcap").write_bytes(b"no recording")
    return folder


def write_latched(path: Path) -> Path:
    """Write a latched description, then a number every 0.1 s for 10 s: a bag of ROS 1, or a folder of ROS 2."""
    is_bag = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_bag else Stores.ROS2_JAZZY)
    types = store.types
    serialize = store.serialize_ros1 if is_bag else store.serialize_cdr
    writer = Writer1(path) if is_bag else Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)
    with writer:
        frames = {"latching": 1} if is_bag else {"offered_qos_profiles": (LATCHED,)}
        static = writer.add_connection("/description", "std_msgs/msg/String", typestore=store, **frames)
        speed = writer.add_connection("/speed", "std_msgs/msg/Float64", typestore=store)
        writer.write(static, START_NS, serialize(types["std_msgs/msg/String"]("<robot/>"), "std_msgs/msg/String"))
        for number in range(100):
            value = float(number % 50)
            data = serialize(types["std_msgs/msg/Float64"](value), "std_msgs/msg/Float64")
            writer.write(speed, START_NS + number * 100_000_000, data)
    return path


def run(*arguments: object, code: int = 0) -> Result:
    result = CliRunner().invoke(main, list(map(str, arguments)))
    assert result.exit_code == code, result.output
    return result


def messages(path: Path) -> Iterator[Message]:
    """Yield topic, time and bytes of each message, read by mcap or rosbags."""
    if path.suffix == ".mcap":
        yield from sorted((each.topic, each.time_ns, each.data) for each in read(path))
        return
    with AnyReader([path]) as reader:
        yield from ((connection.topic, time, bytes(data)) for connection, time, data in reader.messages())


def test_info_says_what_a_recording_contains_to_people_and_programs(runs: Path) -> None:
    path = runs / "long.mcap"
    found = json.loads(run("info", path, "--json").stdout)
    assert (found["path"], found["format"], found["messages"]) == (str(path), "MCAP", 30 * 74)
    assert (found["size"], found["start"]) == (path.stat().st_size, "2023-11-14T22:13:20Z")
    assert found["duration"] == pytest.approx(30, abs=0.1)
    topics = {each["name"]: each for each in found["topics"]}
    assert topics["/odom"] == {"name": "/odom", "type": "nav_msgs/msg/Odometry", "messages": 600, "rate": 20.01}
    shown = run("info", path, "--from", 10, "--to", 20, "--topic", "/odom").stdout
    assert "nav_msgs/msg/Odometry" in shown
    assert "messages: 201" in shown
    assert "/imu" not in shown
    assert "rosld ls" in run("info", runs, code=2).stderr
    both = run("info", path, runs / "broken.mcap", runs / "nowhere.bag", "--json", code=3)
    assert [each["name"] for each in json.loads(both.stdout)] == ["long"]
    assert "broken.mcap" in both.stderr
    assert "nowhere.bag" in both.stderr


def test_ls_lists_recordings_and_chooses_them_by_the_numbers_in_their_messages(runs: Path) -> None:
    table = run("ls", runs).stdout
    assert all(name in table for name in ("long.mcap", "monday/short.bag", "monday/folder", "broken.mcap"))
    assert "cannot be read" in table
    listed = json.loads(run("ls", runs, "--json").stdout)
    assert [Path(each["path"]).name for each in listed] == ["folder", "long.mcap", "short.bag", "broken.mcap"]
    assert [each["messages"] for each in listed[:3]] == [2 * 74, 30 * 74, 5 * 74]
    one = json.loads(run("ls", runs / "long.mcap", runs / "monday" / "folder", "--topic", "/imu", "--json").stdout)
    assert [each["messages"] for each in one] == [2 * 74, 30 * 74]
    for where, names in (
        ("battery_state.percentage < 0.7", ["long"]),
        ("/battery_state.percentage < 0.88 AND odom.twist.twist.linear.x >= 0", ["long", "short"]),
        ("battery_state.percentage > 0.99", []),
        ("diagnostics.status[0].level = 0", ["folder", "long", "short"]),
    ):
        found = run("ls", runs, "--where", where, "--json", code=6)  # one is not readable
        assert [each["name"] for each in json.loads(found.stdout)] == names, where
        assert "broken.mcap" in found.stderr
    for where in ("battery_state.percntage < 1", "percentage < 1", "battery_state.percentage < low"):
        assert where.partition(" ")[0] in run("ls", runs, "--where", where, code=2).stderr


@pytest.mark.slow
def test_query_answers_as_a_server_of_the_source_does(runs: Path, tmp_path: Path) -> None:
    path, file = runs / "monday" / "short.bag", tmp_path / "question.rq"
    file.write_text("SELECT ?topic (COUNT(?m) AS ?n) { ?topic ros:past ?m } GROUP BY ?topic ORDER BY DESC(?n)")
    rows = list(csv.DictReader(run("query", path, f"@{file}").stdout.splitlines()))
    assert rows[0] == {"topic": "http://127.0.0.1:8080/topics/imu", "n": "250"}
    table = run("query", path, f"@{file}", "--format", "table").stdout.splitlines()
    assert table[0].split() == ["topic", "n"]
    assert table[1].split() == ["topics/imu", "250"]
    typed = run("query", path, f"@{file}", "--format", "parquet").stdout_bytes
    assert pyarrow.parquet.read_table(io.BytesIO(typed)).column("n").to_pylist()[0] == 250
    wrong = run("query", path, "SELECT nonsense", code=2)
    assert "nonsense" in wrong.stderr
    assert run("query", "http://127.0.0.1:1/", "ASK {}", code=4).stdout == ""


@pytest.mark.parametrize("name", ["run.bag", "run"])
def test_a_cut_has_the_bytes_of_the_original_and_opens_with_latched_messages(tmp_path: Path, name: str) -> None:
    source = write_latched(tmp_path / name)
    whole = list(messages(source))
    start, end = START_NS + 3_000_000_000, START_NS + 5_000_000_000
    within = [each for each in whole if start <= each[1] <= end]
    opening = ("/description", start, whole[0][2])
    for target in (tmp_path / "cut.mcap", tmp_path / f"cut-{name}"):
        run("cut", source, "-o", target, "--from", 3, "--to", "2023-11-14T22:13:25Z")
        assert sorted(messages(target)) == sorted([*within, opening])
    run("cut", source, "-o", tmp_path / "one.mcap", "--from", 3, "--to", 5, "--topic", "/sp*")
    assert list(messages(tmp_path / "one.mcap")) == within
    assert "already exists" in run("cut", source, "-o", tmp_path / "one.mcap", code=5).stderr
    piped = run("cut", source, "-o", "-", "--around", 4, "--before", 1, "--after", 0.5).stdout_bytes
    (tmp_path / "piped.mcap").write_bytes(piped)
    assert len(list(messages(tmp_path / "piped.mcap"))) == 16 + 1


def test_each_event_is_cut_out_and_overlapping_ones_once(tmp_path: Path) -> None:
    source = write_latched(tmp_path / "run.bag")
    options = ["--topic", "/speed", "--before", 0.5, "--after", 0.5]
    run("cut", source, "-o", tmp_path / "top.mcap", "--around", "speed.data >= 49", *options)
    found = [list(messages(tmp_path / f"top-{number}.mcap")) for number in (1, 2)]
    assert [len(each) for each in found] == [11, 6]
    assert found[0][5][1] == START_NS + 4_900_000_000
    run("cut", source, "-o", tmp_path / "joined.mcap", "--around", 2, "--around", 2.9, *options)
    assert len(list(messages(tmp_path / "joined.mcap"))) == 20
    nothing = run("cut", source, "-o", tmp_path / "none.mcap", "--around", "speed.data > 50", code=1)
    assert "nothing was found to cut around" in nothing.stderr
    assert not list(tmp_path.glob("none*"))
    wrong = run("cut", source, "-o", tmp_path / "none.mcap", "--around", "speed.date > 50", code=2)
    assert "no field 'date'" in wrong.stderr


@pytest.mark.slow
def test_a_query_finds_the_events(tmp_path: Path) -> None:
    source = write_latched(tmp_path / "run.bag")
    number = "https://w3id.org/rosld/types/std_msgs/msg/Float64#data"
    query = f"SELECT ?m ?at {{ <topics/speed> ros:past ?m . ?m ros:received ?at ; <{number}> ?n FILTER(?n > 48.5) }}"
    run("cut", source, "-o", tmp_path / "top.mcap", "--around", query, "--before", 1, "--after", 0.05)
    assert len(list(messages(tmp_path / "top-2.mcap"))) == 11 + 1


def test_an_interruption_has_its_own_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rosld.server.cli.info.info", interrupted)
    assert "interrupted" in run("info", "x.bag", code=130).stderr


def test_the_reference_names_all_commands_and_exit_codes() -> None:
    text = (Path(__file__).parents[3] / "docs" / "reference" / "commands.md").read_text("utf-8")
    assert all(f"`{name} " in text for name in main.commands)
    assert all(f"| {code} | " in text for code in ExitCode)


@pytest.mark.slow
def test_shells_complete_commands_and_a_pipe_has_no_colours(runs: Path) -> None:
    for shell in ("bash", "zsh", "fish"):
        assert "_ROSLD_COMPLETE" in run("completion", shell).stdout
    script = run("completion", "bash").stdout
    subprocess.run(["bash", "-n"], input=script.encode(), check=True)
    coloured = CliRunner().invoke(main, ["ls", str(runs)], color=True).stdout
    assert "\x1b[1m" in coloured
    plain = CliRunner(env={"NO_COLOR": "1"}).invoke(main, ["ls", str(runs)], color=True).stdout
    assert "\x1b" not in plain
