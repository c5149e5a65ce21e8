"""What was sent once and before, the map and the frames that stand still, opens every recording of a real robot."""

from __future__ import annotations

import io
import re
import tarfile
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags import rosbag2
from rosbags.highlevel import AnyReader

from tests.adapters.ros1 import system as ros1
from tests.rover.rovers import Rover, running
from tests.server.history.mcap_files import decode, read
from tests.waiting import until

JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
MERGE_PATCH = {"Content-Type": "application/merge-patch+json"}
TOPICS = ("/odom", "/map", "/tf_static")
GRIPPER = "gripper"
EACH = [pytest.param("rospy"), pytest.param("kilted", marks=pytest.mark.ros2)]


@pytest.fixture(params=EACH)
def recorded(request: pytest.FixtureRequest, serve: Callable[..., Any], tmp_path: Path) -> Any:
    """A real rover, and another node that publishes a frame that stands still, behind a rosld with a history."""
    history = [word for topic in TOPICS for word in ("--history", topic)]
    with running(request.param, serve, tmp_path / "ros", "", "--data", str(tmp_path / "data"), *history) as rover:
        if request.param == "rospy":
            rover.system.node("tf_node.py", GRIPPER, "static")
        else:
            rover.system.node("static_frame.py", GRIPPER)
        until(lambda: len(messages(rover, "history", "/tf_static")) == 2, "the frames of two nodes")
        yield rover


def messages(rover: Rover, bag: str, topic: str) -> list[Any]:
    """The messages of a topic of a recording."""
    found: list[Any] = rover.json(f"/bags/{bag}/messages/?topic={topic}")["messages"]
    return found


def count(rover: Rover, bag: str, topic: str) -> int:
    """How many messages a recording has of a topic."""
    subject = f"<{rover.url}bags/{bag}/#topic/{topic[1:]}> <https://w3id.org/rosld#count> "
    told = rover.http.get(f"/bags/{bag}/", headers=NTRIPLES).text.splitlines()
    return next((int(line.split('"')[1]) for line in told if line.startswith(subject)), 0)


def frames_of(told: Collection[tuple[str, Any]]) -> set[str]:
    """The frames that stand still, of decoded messages."""
    return {each.child_frame_id for topic, message in told if topic == "/tf_static" for each in message.transforms}


@pytest.mark.timeout(300)
def test_a_recording_opens_with_the_map_and_the_frames_that_were_sent_before(recorded: Rover, tmp_path: Path) -> None:
    rover = recorded
    until(lambda: count(rover, "history", "/odom") >= 40, "two seconds, after the map")
    for name, before in (("now", 0), ("then", 0.5)):
        order = {"name": name, "topics": [*TOPICS, "/nothing"], "before": before}
        assert rover.http.post("/bags/", json=order).status_code == 201
        until(lambda name=name: count(rover, name, "/odom") >= 15, "messages")
        silent = f'<{rover.url}bags/{name}/> <https://w3id.org/rosld#silentTopic> "/nothing" .'
        assert silent in rover.http.get(f"/bags/{name}/", headers=NTRIPLES).text
        ended = rover.http.patch(f"/bags/{name}/", content='{"status": "ended"}', headers=MERGE_PATCH | NTRIPLES)
        assert ended.status_code == 200, ended.text
        assert [line for line in ended.text.splitlines() if "silentTopic" in line] == [silent], (
            "of the others some came"
        )
        assert "/nothing" in rover.http.get(f"/bags/{name}/", headers={"Accept": "text/html"}).text

        opening = [one for topic in TOPICS for one in messages(rover, name, topic) if one.get("opening")]
        assert [one["topic"] for one in opening] == ["/map", "/tf_static", "/tf_static"]
        assert [len(messages(rover, name, topic)) for topic in ("/map", "/tf_static")] == [1, 2], "each once"
        told = rover.http.get(opening[0]["url"], headers=NTRIPLES).text
        assert '<https://w3id.org/rosld#opensRecording> "true"' in told
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(rover.http.get(f"/bags/{name}/file").content)
        check_file(path)
    assert [count(rover, "history", topic) for topic in ("/map", "/tf_static")] == [1, 2]
    if rover.name == "rospy":
        check_bag(rover, tmp_path)
    else:
        check_rosbag2(rover, tmp_path)


def check_bag(rover: Rover, folder: Path) -> None:
    """ROS 1's own tools read the bag of a recording, and play it for somebody who comes late."""
    answer = rover.http.get("/bags/then/file", headers={"Accept": "application/x-rosbag"})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/x-rosbag"), answer.text
    assert answer.headers["content-disposition"] == 'attachment; filename="then.bag"'
    again = rover.http.get("/bags/then/file?format=bag", headers={"If-None-Match": answer.headers["etag"]})
    assert again.status_code == 304
    bag = folder / "then.bag"
    bag.write_bytes(answer.content)
    told = rover.system.yaml(rover.system.run("/usr/bin/rosbag", "info", "--yaml", str(bag)))
    counts = {each["topic"]: each["messages"] for each in told["topics"]}
    assert counts == {topic: count(rover, "then", topic) for topic in TOPICS}
    refused = rover.http.get("/bags/then/file?format=rosbag2", headers=JSON)
    assert refused.status_code == 406
    assert "The messages of then are of ROS 1" in refused.json()["detail"]
    with ros1.running(folder / "late") as other:
        player = other.start(["/usr/bin/rosbag", "play", "--keep-alive", str(bag)])
        until(lambda: any(is_over(line) for line in player.seen), "the end of the bag, after which the player stays")
        late = other.node("static_listener.py")
        assert late.line("map").split()[1] != "0"
        until(lambda: {"frame gripper", "frame laser"} <= set(late.seen), "the frames of both nodes")


def is_over(line: str) -> bool:
    """Whether a line of a player says that it has played longer than the bag is."""
    found = re.search(r"Duration: ([0-9.]+) / ([0-9.]+)", line)
    return found is not None and float(found[1]) > float(found[2])


def check_rosbag2(rover: Rover, folder: Path) -> None:
    """The folder of a ROS 2 bag is as rosbags reads it."""
    answer = rover.http.get("/bags/then/file?format=rosbag2")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/x-tar"), answer.text
    with tarfile.open(fileobj=io.BytesIO(answer.content)) as archive:
        archive.extractall(folder, filter="data")
    with rosbag2.Reader(folder / "then") as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
        assert counts == {topic: count(rover, "then", topic) for topic in TOPICS}
        kept = {each.topic for each in reader.connections if each.ext.offered_qos_profiles}  # type: ignore[union-attr]
        assert kept == {"/map", "/tf_static"}
    assert frames_of(decode_folder(folder / "then")) >= {GRIPPER, "laser"}
    refused = rover.http.get("/bags/then/file", headers={"Accept": "application/x-rosbag"})
    assert refused.status_code == 406
    assert "of ROS 2" in refused.text


def decode_folder(path: Path) -> list[tuple[str, Any]]:
    """The messages of a ROS 2 bag, decoded by its own definitions."""
    with AnyReader([path]) as bag:
        return [(one.topic, bag.deserialize(data, one.msgtype)) for one, _, data in bag.messages()]


def check_file(path: Path) -> None:
    """A file has the map and all frames at its begin, as those read it who did not write it."""
    read(path)
    decoded = decode(path)
    assert "/map" in {topic for topic, _ in decoded}
    assert frames_of(decoded) >= {GRIPPER, "laser"}
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages())
    start = min(message.log_time for _, _, message in found)
    marked = [(channel.topic, message) for _, channel, message in found if channel.metadata.get("rosld.opening") == "1"]
    assert sorted(topic for topic, _ in marked) == ["/map", "/tf_static", "/tf_static"]
    assert all(one.log_time == start and one.publish_time < start for _, one in marked)
    assert all(one.log_time == one.publish_time for _, _, one in found if one not in [each for _, each in marked])
