"""The rover as a rospy and as an rclpy node: driven, held, stopped, sent to goals, configured, recorded over HTTP."""

from __future__ import annotations

import io
import math
import re
import tarfile
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags import rosbag2
from rosbags.highlevel import AnyReader

from rosld.adapters.rover.graph import CMD_VEL, LATCHED, NAVIGATE_TO, PERIODIC, SET_LIGHTS
from tests.adapters.ros1 import system as ros1
from tests.rover.rovers import STANDSTILL, Rover, running
from tests.rover.test_questions import check_questions
from tests.server.history.mcap_files import decode, read
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
MERGE_PATCH = {"Content-Type": "application/merge-patch+json"}
AHEAD = {**STANDSTILL, "linear": {"x": 0.2, "y": 0.0, "z": 0.0}}
TOPICS = ("/odom", "/map", "/tf_static")
GRIPPER = "gripper"


@pytest.fixture(scope="module", params=["rospy", pytest.param("kilted", marks=pytest.mark.ros2)])
def rover(
    request: pytest.FixtureRequest, start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Rover]:
    """A rover on ROS and a node that publishes a static frame, behind a rosld that records both."""
    folder = tmp_path_factory.mktemp(request.param)
    history = [word for topic in TOPICS for word in ("--history", topic)]
    options = ("--data", str(folder / "data"), "--stop-cancels", "others", *history)
    with running(request.param, start_server, folder / "ros", "battery=0.4", *options) as found:
        if request.param == "rospy":
            found.system.node("tf_node.py", GRIPPER, "static")
        else:
            found.system.node("static_frame.py", GRIPPER)
        until(lambda: len(messages(found, "history", "/tf_static")) == 2, "the frames of two nodes")
        yield found


def test_every_topic_that_it_publishes_has_a_message(rover: Rover) -> None:
    for topic in (*PERIODIC, *LATCHED):
        assert rover.hear(topic)


def test_it_is_driven_and_stands_when_its_hold_lapses_or_is_stopped(rover: Rover) -> None:
    rover.drive(0.2, 0.8)
    until(lambda: rover.velocity() == (0.2, 0.8), "the velocity")
    rover.drive(0.0)
    rover.stands()
    held = rover.http.post(f"/topics{CMD_VEL}", params={"rate": 20, "lease": 1}, json=AHEAD)
    assert held.status_code == 201, held.text
    until(lambda: rover.velocity()[0] == 0.2, "motion")
    until(lambda: rover.http.get(held.headers["location"]).status_code == 410, "the end of the lease")
    rover.stands()

    assert rover.http.post(f"/topics{CMD_VEL}", params={"rate": 20, "lease": 5}, json=AHEAD).status_code == 201
    until(lambda: rover.velocity()[0] == 0.2, "motion")
    stopped = rover.http.post("/stop", headers=JSON).json()
    assert (stopped["stopped"], stopped["warning"]) == (True, None)
    rover.stands()
    assert rover.http.put(f"/topics{CMD_VEL}", json=AHEAD).status_code == 423
    assert rover.send(1.0, 0.0).status_code == 423
    assert release(rover.http).status_code == 204
    rover.drive(0.0)


def faults(rover: Rover) -> dict[str, str]:
    """Return the states of the faults by their kinds."""
    listed = rover.http.get("/faults/?offer").json().get("members", ())
    found = [rover.http.get(f"/faults/{id}", headers=JSON).json() for id in listed]
    return {each["kind"]: each["state"] for each in found}


def test_a_goal_is_reached_aborted_rejected_or_canceled_by_the_stop(rover: Rover) -> None:
    assert rover.end_of(rover.send(500.0, 0.0).headers["location"])["status"] == "aborted"
    until(lambda: faults(rover) == {"goal": "active", "log": "active"}, "an aborted goal and what the log says of it")
    goal = (0.5, -1.0) if math.dist(rover.place(), (0.5, -1.0)) > 0.3 else (0.0, -1.0)
    told = rover.end_of(rover.send(*goal).headers["location"])
    assert (told["status"], told["result"] and told["result"]["message"]) == ("succeeded", "arrived"), told
    assert told["feedback"]["distance_remaining"] < 5
    until(lambda: faults(rover)["goal"] == "healed", "the fault healed")
    assert rover.send(1.0, 0.0, frame="moon").status_code == 409
    pursued = rover.send(4.4, -3.4).headers["location"]
    until(lambda: rover.velocity() != (0.0, 0.0), "motion")
    steps = {step["does"]: step["state"] for step in rover.http.post("/stop", headers=JSON).json()["steps"]}
    assert steps == {f"publish zero on {CMD_VEL}": "Succeeded", f"cancel all goals of {NAVIGATE_TO}": "Succeeded"}
    assert rover.end_of(pursued)["status"] == "canceled"
    rover.stands()
    assert release(rover.http).status_code == 204


def test_parameters_and_services_take_effect(rover: Rover) -> None:
    limit = "/parameters/rover/max_speed"
    until(lambda: "?shape" in rover.http.get(limit).headers.get("link", ""), "the declared range")
    assert rover.http.put(limit, json=1.5).status_code == 422
    assert rover.http.put(limit, json=0.2).status_code == 204
    rover.drive(0.4, 1.0)
    until(lambda: rover.velocity() == (0.2, 1.0), "the speed within the limit")
    assert rover.http.put(limit, json=0.5).status_code == 204
    rover.drive(0.0)
    rover.stands()
    for on in (True, False):
        assert rover.http.post(f"/services{SET_LIGHTS}", json={"data": on}).status_code == 201
        until(lambda wanted=on: rover.hear("/lights") == {"data": wanted}, "the lights")


def test_what_people_ask_in_words_or_in_public_terms_is_found(rover: Rover) -> None:
    check_questions(rover)


def messages(rover: Rover, bag: str, topic: str) -> list[Any]:
    """Return the messages of a topic of a recording."""
    found: list[Any] = rover.json(f"/bags/{bag}/messages/?topic={topic}")["messages"]
    return found


def count(rover: Rover, bag: str, topic: str) -> int:
    """Return the number of messages of a topic in a recording."""
    subject = f"<{rover.url}bags/{bag}/#topic/{topic[1:]}> <https://w3id.org/rosld#count> "
    told = rover.http.get(f"/bags/{bag}/", headers=NTRIPLES).text.splitlines()
    return next((int(line.split('"')[1]) for line in told if line.startswith(subject)), 0)


def frames_of(told: Collection[tuple[str, Any]]) -> set[str]:
    """Return the static frames in decoded messages."""
    return {each.child_frame_id for topic, message in told if topic == "/tf_static" for each in message.transforms}


def test_a_recording_opens_with_the_map_and_the_frames_that_were_sent_before(rover: Rover, tmp_path: Path) -> None:
    for name, before in (("now", 0), ("then", 0.5)):
        order = {"name": name, "topics": [*TOPICS, "/nothing"], "before": before}
        assert rover.http.post("/bags/", json=order).status_code == 201
        until(lambda name=name: count(rover, name, "/odom") >= 15, "messages")
        silent = f'<{rover.url}bags/{name}/> <https://w3id.org/rosld#silentTopic> "/nothing" .'
        ended = rover.http.patch(f"/bags/{name}/", content='{"status": "ended"}', headers=MERGE_PATCH | NTRIPLES)
        assert ended.status_code == 200, ended.text
        assert [line for line in ended.text.splitlines() if "silentTopic" in line] == [silent]

        opening = [one for topic in TOPICS for one in messages(rover, name, topic) if one.get("opening")]
        assert [one["topic"] for one in opening].count("/map") == 1
        frames = [one["message"]["transforms"][0]["child_frame_id"] for one in opening if one["topic"] == "/tf_static"]
        assert sorted(set(frames)) == [GRIPPER, "laser"]
        assert len(messages(rover, name, "/map")) == 1
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(rover.http.get(f"/bags/{name}/file").content)
        check_file(path)
    if rover.name == "rospy":
        check_bag(rover, tmp_path)
    else:
        check_rosbag2(rover, tmp_path)


def check_bag(rover: Rover, folder: Path) -> None:
    """Check that ROS 1's own tools read the bag of a recording, and play it for a late subscriber."""
    answer = rover.http.get("/bags/then/file", headers={"Accept": "application/x-rosbag"})
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/x-rosbag"), answer.text
    assert answer.headers["content-disposition"] == 'attachment; filename="then.bag"'
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
        until(lambda: {"frame gripper", "frame laser"} <= set(late.seen), "the frames of both nodes, sent before")


def is_over(line: str) -> bool:
    """Whether a line of a player shows a time after the end of the bag."""
    found = re.search(r"Duration: ([0-9.]+) / ([0-9.]+)", line)
    return found is not None and float(found[1]) > float(found[2])


def check_rosbag2(rover: Rover, folder: Path) -> None:
    """Check that rosbags reads the folder of a ROS 2 bag."""
    answer = rover.http.get("/bags/then/file?format=rosbag2")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/x-tar"), answer.text
    with tarfile.open(fileobj=io.BytesIO(answer.content)) as archive:
        archive.extractall(folder, filter="data")
    with rosbag2.Reader(folder / "then") as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
        assert counts == {topic: count(rover, "then", topic) for topic in TOPICS}
        kept = {each.topic for each in reader.connections if each.ext.offered_qos_profiles}  # type: ignore[union-attr]
        assert kept == {"/map", "/tf_static"}
    with AnyReader([folder / "then"]) as bag:
        found = [(one.topic, bag.deserialize(data, one.msgtype)) for one, _, data in bag.messages()]
    assert frames_of(found) >= {GRIPPER, "laser"}
    refused = rover.http.get("/bags/then/file", headers={"Accept": "application/x-rosbag"})
    assert refused.status_code == 406
    assert "of ROS 2" in refused.text


def check_file(path: Path) -> None:
    """Check that the file has the map and all frames at its beginning, according to other MCAP readers."""
    read(path)
    decoded = decode(path)
    assert "/map" in {topic for topic, _ in decoded}
    assert frames_of(decoded) >= {GRIPPER, "laser"}
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages())
    start = min(message.log_time for _, _, message in found)
    marked = [(channel.topic, message) for _, channel, message in found if channel.metadata.get("rosld.opening") == "1"]
    assert {topic for topic, _ in marked} == {"/map", "/tf_static"}
    assert all(one.log_time == start and one.publish_time < start for _, one in marked)
    assert all(one.log_time == one.publish_time for _, _, one in found if one not in [each for _, each in marked])
