"""The rover through a rosld without a mapping of it: its topics, and its reactions to commands."""

from __future__ import annotations

import base64
import math

import cv2
import numpy as np
import pytest

from rosld.adapters.rover.graph import CMD_VEL, DOCK, LATCHED, PERIODIC
from rosld.adapters.rover.messages import BEAMS, HEIGHT, WIDTH
from tests.rover.conftest import StartRover
from tests.rover.rovers import Rover
from tests.waiting import until

pytestmark = pytest.mark.slow

CAMERA = "/topics/camera/image_raw"
TURTLE = {"Accept": "text/turtle"}
PUBLISHED = {**{name: each.type for name, each in PERIODIC.items()}, **{n: each.type for n, each in LATCHED.items()}}


def test_its_topics_have_messages_of_the_types_of_the_standard_packages(rover: Rover) -> None:
    for topic, type in {CMD_VEL: "geometry_msgs/msg/Twist", **PUBLISHED}.items():
        told = rover.http.get(f"/topics{topic}", headers=TURTLE).text
        assert f"ros:hasMessageType <https://w3id.org/rosld/types/{type}>" in told
    for topic in PUBLISHED:
        assert rover.hear(topic)
    assert "ldp:contains" not in rover.http.get("/mappings/", headers=TURTLE).text


def test_without_power_it_neither_drives_nor_pursues_a_goal(start_rover: StartRover) -> None:
    """From the start the wall beyond the door is 4.9 m ahead, and the shelf 4.4 m behind."""
    rover = start_rover("battery=0")
    rover.drive(0.4)
    told = rover.end_of(rover.send(1.0, 0.0).headers["location"])
    assert (told["status"], told["result"]["message"]) == ("aborted", "the battery is empty")
    answer = rover.http.post(f"/services{DOCK}", headers={"Accept": "application/json"})
    assert answer.json()["success"] is False, "it is not at the dock"
    assert rover.place() == (0.0, 0.0)
    assert "no power" in str(rover.hear("/diagnostics"))
    ranges = rover.hear("/scan")["ranges"]
    assert len(ranges) == BEAMS
    assert math.isclose(ranges[0], 4.4, abs_tol=1e-3)
    assert math.isclose(ranges[BEAMS // 2], 4.9, abs_tol=1e-3)
    grid = rover.hear("/map")
    info, data = grid["info"], grid["data"]
    assert (info["width"], info["height"], len(data)) == (100, 80, 8000)

    def occupied(x: float, y: float) -> bool:
        column = int((x - info["origin"]["position"]["x"]) / info["resolution"])
        row = int((y - info["origin"]["position"]["y"]) / info["resolution"])
        return data[row * info["width"] + column] == 100

    assert [occupied(x, 0.0) for x in (4.95, 4.75, 0.0)] == [True, False, False]


def decoded(file: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR)


def test_the_camera_is_seen_as_it_is(rover: Rover) -> None:
    raw = rover.hear("/camera/image_raw")
    assert (raw["width"], raw["height"], raw["encoding"]) == (WIDTH, HEIGHT, "rgb8")
    assert base64.b64decode(rover.hear("/camera/image_raw/compressed")["data"]).startswith(b"\x89PNG")
    assert rover.hear("/camera/camera_info")["width"] == WIDTH

    def is_same() -> bool:
        """Whether the picture has the pixels of the message; the rover may just have moved."""
        file = rover.http.get(CAMERA, headers={"Accept": "image/png"}).content
        raw = rover.hear("/camera/image_raw")
        data = np.frombuffer(base64.b64decode(raw["data"]), np.uint8).reshape(raw["height"], raw["width"], 3)
        return bool((decoded(file)[:, :, ::-1] == data).all())

    until(is_same, "a picture with the pixels of the message")
    jpeg = rover.http.get(f"{CAMERA}?width=80", headers={"Accept": "image/jpeg"})
    assert decoded(jpeg.content).shape == (60, 80, 3)
    stream = cv2.VideoCapture(f"{rover.url}{CAMERA[1:]}?format=mjpeg&rate=20")
    try:
        is_read, picture = stream.read()
        assert is_read
        assert picture.shape == (120, 160, 3)
    finally:
        stream.release()


def test_its_parts_say_how_they_are(rover: Rover) -> None:
    states = until(lambda: rover.json("/diagnostics")["states"], "the diagnostics")
    levels = {each["name"]: each["level"] for each in states}
    assert levels.keys() == {"rover: battery", "rover: drive", "rover: laser", "rover: camera"}
    assert (levels["rover: laser"], levels["rover: camera"]) == ("OK", "OK")
    assert all(each["values"] for each in states)
