"""Questions in words, asked of robots that nobody mapped: what a person expects is among the first three results."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from rosld.adapters.model import Encoding, MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.lower import lowerer
from rosld.server.resources.find import MAX_BYTES
from tests.rover.conftest import StartRover
from tests.rover.rovers import STANDSTILL, Rover
from tests.waiting import until

pytestmark = pytest.mark.slow

OF_A_ROVER = {
    "where is the robot": "topics/odom",
    "how do I make it turn left": "topics/cmd_vel",
    "what does the camera see": "topics/camera/image_raw",
    "is anything wrong?": "topics/diagnostics",
    "drive forward": "topics/cmd_vel",
    "how much battery is left": "topics/battery_state",
    "go to the kitchen": "actions/navigate_to",
    "stop": "stop",
    "turn on the headlights": "services/set_lights",
    "how fast is it going": "topics/odom",
    "limit the maximum speed": "parameters/rover/max_speed",
    "distance to the nearest obstacle": "topics/scan",
    "show me a picture": "topics/camera/image_raw",
    "floor plan": "topics/map",
    "send it back to the charger": "services/dock",
    "halt immediately": "stop",
    "is it tilted": "topics/imu",
    "log messages": "topics/rosout",
    "which way is it facing": "topics/odom",
    "lidar data": "topics/scan",
    "are the lamps lit": "topics/lights",
    "batery charge": "topics/battery_state",
    "navigate to a goal": "actions/navigate_to",
    "coordinate frames": "topics/tf",
    "velocity command": "topics/cmd_vel",
    "what is the robot called": "parameters/rover/robot_name",
    "stop before it hits an obstacle": "parameters/rover/stop_before_obstacles",
    "What can I do with this?": "queries/what-can-be-done",
    "video stream": "topics/camera/image_raw",
}
"""The path that is expected for each question; the rover has the names of ROS' customs, and actions of its own type."""
OF_A_RECORDING = {
    "where was the robot": "topics/loc/estimate",
    "battery": "topics/juice",
    "satellite position": "topics/fix0",
    "did it touch anything": "topics/base/sensors",
    "how hot did it get": "topics/core",
    "picture from the camera": "topics/eye/left",
    "how far did the wheels turn": "topics/base/sensors",
    "arm angles": "topics/limbs",
    "force on the gripper": "topics/feel",
    "planned route": "topics/ahead",
    "3d depth data": "topics/c0",
}
HELD_OUT_OF_A_ROVER = {
    "how do I get it to come back?": "services/dock",
    "is there something in front of the robot": "topics/scan",
    "rotate in place": "topics/cmd_vel",
    "how long until the power runs out": "topics/battery_state",
    "let me look through its eyes": "topics/camera/image_raw",
    "send the robot to a position": "actions/navigate_to",
    "gentle driving mode": "parameters/rover/drive_mode",
    "gyroscope readings": "topics/imu",
}
HELD_OUT_OF_A_RECORDING = {
    "how full was the accumulator": "topics/juice",
    "how close was the nearest wall": "topics/whiskers",
}
"""Questions that were written after the thesaurus, and did not change it."""
TYPES = {
    "/loc/estimate": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/juice": "acme_msgs/msg/PowerPack",
    "/fix0": "sensor_msgs/msg/NavSatFix",
    "/base/sensors": "acme_msgs/msg/BaseState",
    "/base/soll": "geometry_msgs/msg/Twist",
    "/core": "sensor_msgs/msg/Temperature",
    "/eye/left": "sensor_msgs/msg/CompressedImage",
    "/limbs": "sensor_msgs/msg/JointState",
    "/feel": "geometry_msgs/msg/WrenchStamped",
    "/ahead": "nav_msgs/msg/Path",
    "/c0": "sensor_msgs/msg/PointCloud2",
    "/whiskers": "sensor_msgs/msg/Range",
    "/rosout": "rcl_interfaces/msg/Log",
}
"""Topics of a recorded robot with its vendor's names and, in part, types."""
DEFINITIONS = {
    "acme_msgs/msg/PowerPack": "float32 voltage\nfloat32 current\nfloat32 state_of_charge\nuint8 cells",
    "acme_msgs/msg/BaseState": "bool bumper_left\nbool bumper_right\nint32 left_encoder\nint32 right_encoder",
}
MEASURED: dict[str, tuple[str, dict[str, object]]] = {
    "/battery": ("sensor_msgs/msg/BatteryState", {"voltage": 24.0, "temperature": 31.0}),
    "/lidar": ("sensor_msgs/msg/LaserScan", {"ranges": [1.5, 3.0]}),
    "/odom": ("nav_msgs/msg/Odometry", {"pose": {"covariance": [0.1] * 36}, "child_frame_id": "base_link"}),
}
"""Types and values of recorded topics."""
OF_WRITES_FAULTS_AND_THE_BODY = frozenset({5, 7, 14, 16, 17, 18})
DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "questions.md"
_EXAMPLE = re.compile(r"^\*\*(\d+)\. (.*?)\*\*(.*?)\n\n```sparql\n(.*?)```", re.MULTILINE | re.DOTALL)
_OF_ROS = ("ros:", "w3id.org/rosld")
JSON = {"Accept": "application/json"}


class Question(NamedTuple):
    """A question: its number, its words, whether it claims to use public terms alone, and its query."""

    number: int
    words: str
    is_public: bool
    query: str

    @property
    def uses_public_terms(self) -> bool:
        return not any(term in self.query for term in _OF_ROS)


def questions() -> list[Question]:
    text = DOCUMENT.read_text(encoding="utf-8")
    return [Question(int(n), words, "public terms" in note, query) for n, words, note, query in _EXAMPLE.findall(text)]


def ask(http: httpx.Client, query: str) -> list[dict[str, str]]:
    """Return the rows of a SELECT."""
    answer = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert answer.status_code == 200, answer.text
    return list(csv.DictReader(io.StringIO(answer.text)))


def unanswered(http: httpx.Client, without: frozenset[int] = frozenset()) -> dict[str, str]:
    """Return the questions without an answer, except those `without` one on this robot."""
    asked = (one for one in questions() if one.number not in without)
    return {f"{one.number}. {one.words}": one.query for one in asked if not ask(http, one.query)}


def results(http: httpx.Client, question: str) -> list[str]:
    """Return the paths of the first three results."""
    answer = http.get("/find", params={"q": question}, headers=JSON)
    assert answer.status_code == 200, answer.text
    assert len(answer.content) <= MAX_BYTES
    return [httpx.URL(each["url"]).path[1:] for each in answer.json()["results"][:3]]


def missed(http: httpx.Client, expected: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the first results of the questions whose first three lack the expected path."""
    found = {question: results(http, question) for question in expected}
    return {question: paths for question, paths in found.items() if expected[question] not in paths}


def check_questions(rover: Rover) -> None:
    """Check the results of all questions to a rover with 40 % of its battery, which records its odometry."""
    assert missed(rover.http, OF_A_ROVER | HELD_OUT_OF_A_ROVER) == {}
    until(lambda: ask(rover.http, "SELECT ?m { <topics/odom> ros:past ?m } LIMIT 1"), "a recorded place")
    assert rover.http.put("/parameters/rover/low_battery", json=0.5).status_code == 204
    warning = "SELECT ?fault { ?fault a ros:Fault ; ros:severity 'warning' }"
    until(lambda: ask(rover.http, warning), "the fault of the battery")
    assert rover.http.put("/topics/cmd_vel", json=STANDSTILL).status_code == 204
    assert unanswered(rover.http) == {}


def test_what_people_ask_of_a_rover_in_words_or_in_public_terms_is_found(start_rover: StartRover) -> None:
    check_questions(start_rover("battery=0.4", "--history", "/odom"))


def recorded(folder: Path) -> Path:
    """Return a recording with one message of each topic, which nobody reads."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    path = folder / "robot"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for name, kind in TYPES.items():
            connection = writer.add_connection(name, kind, typestore=store)
            writer.write(connection, 1_700_000_000_000_000_000, b"\0\1\0\0")
    return path


def test_what_people_ask_of_a_recording_with_made_up_names_is_found(serve: Callable[..., Any], tmp_path: Path) -> None:
    http = serve(str(recorded(tmp_path))).http
    assert missed(http, OF_A_RECORDING | HELD_OUT_OF_A_RECORDING) == {}


def test_most_of_the_twenty_questions_use_terms_of_public_vocabularies_alone() -> None:
    asked = questions()
    assert [one.number for one in asked] == list(range(1, 21))
    assert all(one.is_public == one.uses_public_terms for one in asked)
    assert sum(one.is_public for one in asked) >= 12


def test_a_recording_that_others_made_answers_the_same_questions(serve: Callable[..., Any], tmp_path: Path) -> None:
    http = serve(str(measured(tmp_path))).http
    assert unanswered(http, OF_WRITES_FAULTS_AND_THE_BODY) == {}


def measured(folder: Path) -> Path:
    """Return a recording of three seconds, written by rosbags."""
    library, store = TypeLibrary(ros_version=2), get_typestore(Stores.ROS2_JAZZY)
    begin = 1_700_000_000
    with Writer(folder / "measured", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, (name, value) in MEASURED.items():
            schema, connection = library.find(TypeRef(name)), writer.add_connection(topic, name, typestore=store)
            assert isinstance(schema, MessageSchema)
            for second in range(begin, begin + 3):
                header = {"header": {"frame_id": "laser", "stamp": {"sec": second}}}
                message = lowerer(schema).from_json({**header, **value}, defaults=True)
                writer.write(connection, (second + 1) * 1_000_000_000, schema.codec.encode(message, Encoding.CDR))
    return folder / "measured"
