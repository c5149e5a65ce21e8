"""The same robot, embedded and on real ROS systems: what it says and does through a rosld that has no mapping of it."""

from __future__ import annotations

import base64
import math

import cv2
import httpx
import numpy as np

from rosld.adapters.rover import camera, scan
from rosld.adapters.rover.topics import CMD_VEL, DOCK, LATCHED, PERIODIC, SET_LIGHTS
from tests.rover.conftest import StartRover
from tests.rover.rovers import Rover
from tests.waiting import until

CAMERA = "/topics/camera/image_raw"
TURTLE = {"Accept": "text/turtle"}
TYPES = {
    CMD_VEL: "geometry_msgs/msg/Twist",
    **{name: each.type for name, each in PERIODIC.items()},
    **{name: each.type for name, each in LATCHED.items()},
}


def stopped(rover: Rover) -> None:
    """Have it stand."""
    rover.drive(0.0)
    until(lambda: rover.velocity() == (0.0, 0.0), "standstill")


def test_its_topics_have_the_types_of_the_standard_packages(rover: Rover) -> None:
    for topic, type in TYPES.items():
        told = rover.http.get(f"/topics{topic}", headers=TURTLE).text
        assert f"ros:hasMessageType <https://w3id.org/rosld/types/{type}>" in told


def test_every_topic_that_it_publishes_has_a_message(rover: Rover) -> None:
    for topic in (*PERIODIC, *LATCHED):
        assert rover.hear(topic)


def test_it_drives_on_as_it_was_told_last_until_it_is_told_to_stand(rover: Rover) -> None:
    rover.drive(0.2, 0.8)
    until(lambda: rover.velocity() == (0.2, 0.8), "the velocity")
    stamp = rover.hear("/odom")["header"]["stamp"]
    until(lambda: rover.hear("/odom")["header"]["stamp"]["sec"] > stamp["sec"] + 2, "seconds without a command")
    assert rover.velocity() == (0.2, 0.8)
    stopped(rover)
    there = rover.place()
    rover.drive(0.0)
    assert rover.place() == there


def test_a_goal_is_reached_with_feedback_on_the_way(rover: Rover) -> None:
    x, y = rover.place()
    goal = (0.5, -1.0) if math.dist((x, y), (0.5, -1.0)) > 0.5 else (-0.5, -1.0)
    sent = rover.send(*goal)
    assert sent.status_code == 201, sent.text
    told = rover.end_of(sent.headers["location"])
    assert told["status"] == "succeeded"
    assert told["result"]["message"] == "arrived"
    assert told["feedback"]["distance_remaining"] < 5
    assert math.dist(rover.place(), goal) < 0.1


def test_a_goal_fails_in_words_where_no_way_leads(rover: Rover) -> None:
    for place, words in (((30.0, 0.0), "outside the map"), ((0.0, 2.6), "an obstacle stands at")):
        told = rover.end_of(rover.send(*place).headers["location"])
        assert told["status"] == "aborted"
        assert words in told["result"]["message"]


def test_a_goal_in_an_unknown_frame_is_rejected(rover: Rover) -> None:
    assert rover.send(1.0, 0.0, frame="moon").status_code == 409


def test_a_goal_is_canceled_and_the_rover_stands(rover: Rover) -> None:
    sent = rover.send(4.4, -3.4)
    goal = sent.headers["location"]
    until(lambda: rover.velocity() != (0.0, 0.0), "motion")
    assert rover.http.delete(goal).status_code == 202
    assert rover.end_of(goal)["status"] == "canceled"
    until(lambda: rover.velocity() == (0.0, 0.0), "standstill")


def test_a_crate_that_no_map_shows_ends_a_goal_on_its_way(start_rover: StartRover) -> None:
    rover = start_rover("pose=3.5,0,1.57&rate=4")
    told = rover.end_of(rover.send(3.5, 3.0).headers["location"])
    assert (told["status"], "not on the map" in told["result"]["message"]) == ("aborted", True)
    assert rover.place()[1] < 1.4


def test_the_lights_are_switched_by_a_service_and_told_by_a_latched_topic(rover: Rover) -> None:
    for on in (True, False):
        answer = rover.http.post(f"/services{SET_LIGHTS}", json={"data": on})
        assert answer.status_code == 201, answer.text
        until(lambda wanted=on: rover.hear("/lights") == {"data": wanted}, "the lights")


def test_driving_takes_from_the_battery_and_the_dock_gives_back(start_rover: StartRover) -> None:
    rover = start_rover("battery=0.21&rate=20&pose=-4.2,-3.2,0")
    rover.drive(0.4, 1.0)
    until(lambda: rover.hear("/battery_state")["percentage"] < 0.2, "a low battery")
    stopped(rover)
    assert rover.hear("/battery_state")["current"] < 0
    until(lambda: "low" in str(rover.hear("/diagnostics")), "a diagnosis")
    if call(rover, DOCK)["success"] is False:
        rover.end_of(rover.send(-4.2, -3.2).headers["location"])
        assert call(rover, DOCK)["success"] is True
    until(lambda: rover.hear("/battery_state")["current"] > 0, "charging")
    until(lambda: rover.hear("/battery_state")["percentage"] > 0.25, "a fuller battery")


def test_without_power_it_neither_drives_nor_pursues_a_goal(stranded: Rover) -> None:
    stranded.drive(0.4)
    told = stranded.end_of(stranded.send(1.0, 0.0).headers["location"])
    assert (told["status"], told["result"]["message"]) == ("aborted", "the battery is empty")
    assert stranded.place() == (0.0, 0.0)
    assert "no power" in str(stranded.hear("/diagnostics"))


def call(rover: Rover, service: str) -> dict[str, object]:
    """The response of a service without a request."""
    answer = rover.http.post(f"/services{service}", headers={"Accept": "application/json"})
    assert answer.status_code == 201, answer.text
    return answer.json()


def test_the_laser_measures_walls_that_the_map_has(stranded: Rover) -> None:
    """From the start the wall beyond the door is 4.9 m ahead, and the shelf 4.4 m behind."""
    ranges = stranded.hear("/scan")["ranges"]
    assert len(ranges) == scan.BEAMS
    assert math.isclose(ranges[0], 4.4, abs_tol=1e-3)
    assert math.isclose(ranges[scan.BEAMS // 2], 4.9, abs_tol=1e-3)
    grid = stranded.hear("/map")
    info, data = grid["info"], grid["data"]
    assert (info["width"], info["height"], len(data)) == (100, 80, 8000)

    def occupied(x: float, y: float) -> bool:
        column = int((x - info["origin"]["position"]["x"]) / info["resolution"])
        row = int((y - info["origin"]["position"]["y"]) / info["resolution"])
        return data[row * info["width"] + column] == 100

    assert occupied(4.95, 0.0)
    assert not occupied(4.75, 0.0)
    assert not occupied(0.0, 0.0)


def test_the_camera_gives_the_image_raw_and_as_a_file(rover: Rover) -> None:
    raw = rover.hear("/camera/image_raw")
    assert (raw["width"], raw["height"], raw["encoding"]) == (camera.WIDTH, camera.HEIGHT, "rgb8")
    file = rover.hear("/camera/image_raw/compressed")
    assert file["format"] == "png"
    assert base64.b64decode(file["data"]).startswith(b"\x89PNG")
    told = rover.hear("/camera/camera_info")
    assert (told["width"], told["height"]) == (camera.WIDTH, camera.HEIGHT)


def decoded(file: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR)


def test_the_camera_is_seen_as_it_is(rover: Rover) -> None:
    def is_same() -> bool:
        """The picture has the pixels of the message; the rover may just have moved."""
        file = rover.http.get(CAMERA, headers={"Accept": "image/png"}).content
        raw = rover.hear("/camera/image_raw")
        data = np.frombuffer(base64.b64decode(raw["data"]), np.uint8).reshape(raw["height"], raw["width"], 3)
        return bool((decoded(file)[:, :, ::-1] == data).all())

    until(is_same, "a picture with the pixels of the message")
    jpeg = rover.http.get(f"{CAMERA}?width=80", headers={"Accept": "image/jpeg"})
    assert decoded(jpeg.content).shape == (60, 80, 3)
    stream = cv2.VideoCapture(f"{rover.url}{CAMERA[1:]}?format=mjpeg&rate=20")
    try:
        for _ in range(3):
            is_read, picture = stream.read()
            assert is_read
            assert picture.shape == (120, 160, 3)
    finally:
        stream.release()


def test_its_parts_say_how_they_are(rover: Rover) -> None:
    states = until(lambda: rover.json("/diagnostics")["states"], "what the parts say")
    levels = {each["name"]: each["level"] for each in states}
    assert levels.keys() == {"rover: battery", "rover: drive", "rover: laser", "rover: camera"}
    assert (levels["rover: laser"], levels["rover: camera"]) == ("OK", "OK")
    assert all(each["values"] for each in states)


def test_it_has_no_mapping(rover: Rover) -> None:
    answer: httpx.Response = rover.http.get("/mappings/", headers={"Accept": "text/turtle"})
    assert "ldp:contains" not in answer.text


def test_a_parameter_that_is_set_takes_effect_and_none_beyond_its_range_is(rover: Rover) -> None:
    limit = "/parameters/rover/max_speed"
    until(lambda: "?shape" in rover.http.get(limit).headers.get("link", ""), "what the node declares")
    assert rover.http.put(limit, json=1.5).status_code == 422
    try:
        assert rover.http.put(limit, json=0.2).status_code == 204
        rover.drive(0.4, 1.0)
        until(lambda: rover.velocity() == (0.2, 1.0), "the speed within the limit")
    finally:
        rover.http.put(limit, json=0.5)
        stopped(rover)
