"""Plots over HTTP: descriptions of their numbers, and a stream with each message once, as recorded."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import datetime
from typing import Any

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, served
from tests.waiting import until

JSON = {"Accept": "application/json"}
STREAM = {"Accept": "text/event-stream"}
SPEED, TURN = "topics/odom#twist.twist.linear.x", "/topics/odom#header.stamp.nanosec"


def told(http: httpx.Client, *references: str, rows: int) -> list[Any]:
    """Return events of a stream, until it has this many messages of one topic."""
    found: list[Any] = []
    with http.stream("GET", "/plot", params={"y": references}, headers=STREAM, timeout=60) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream"), stream.read()
        for line in stream.iter_lines():
            if line.startswith("data: "):
                found += json.loads(line.removeprefix("data: "))
                if sum(len(each["times"]) for each in found) >= rows:
                    return found
    raise AssertionError("the stream ended")


@pytest.mark.slow
def test_the_stream_tells_every_message_once_and_as_it_is_recorded(rover: httpx.Client) -> None:
    events = told(rover, TURN, rows=40)
    times = [at for each in events for at in each["times"]]
    values = [value for each in events for value in each["values"]["0"]]
    assert times == sorted(set(times))
    assert sum(each["lost"] for each in events) == 0
    recorded = until(
        lambda: (found := recorded_numbers(rover)) and max(found) >= times[-1] - 0.01 and found, "the last message"
    )
    within = [at for at in recorded if times[0] - 0.01 <= at <= times[-1] + 0.01]
    assert len(within) == len(times)
    assert [recorded[at] for at in within] == values


def recorded_numbers(http: httpx.Client) -> dict[float, float]:
    """Return the recorded numbers, by time."""
    query = {"series": "header.stamp.nanosec", "from": "-60", "points": 10_000}
    kept = http.get("/topics/odom", params=query, headers=JSON).json()
    return dict(zip(map(milliseconds, kept["time"]), kept["value"], strict=True))


def milliseconds(text: str) -> float:
    """Return milliseconds since 1970 for a time with nanoseconds."""
    seconds, _, rest = text.removesuffix("Z").partition(".")
    return datetime.fromisoformat(f"{seconds}+00:00").timestamp() * 1000 + int(rest) / 1e6


def test_numbers_of_one_topic_come_together_and_those_of_arrays_as_arrays(rover: httpx.Client) -> None:
    events = told(rover, SPEED, "topics/odom#pose.covariance", "topics/scan#ranges", rows=10)
    odometry = next(each for each in events if each["values"].keys() == {"0", "1"})
    scan = next(each for each in told(rover, "topics/scan#ranges", rows=2) if each["times"])
    assert len(odometry["values"]["0"]) == len(odometry["values"]["1"]) == len(odometry["times"])
    assert len(odometry["values"]["1"][0]) == len(scan["values"]["0"][0]) == 16
    whole = rover.get("/topics/odom?field=pose.covariance").json()
    assert odometry["values"]["1"][0] == whole[:16]


def test_a_plot_names_its_numbers_and_what_is_recorded_of_them(rover: httpx.Client) -> None:
    found = rover.get("/plot", params={"y": [SPEED, "topics/scan#range_max"]}, headers=JSON).json()["y"]
    base = str(rover.base_url)
    assert found == [
        {
            "topic": f"{base}topics/odom",
            "field": "twist.twist.linear.x",
            "type": "float64",
            "series": f"{base}topics/odom?series=twist.twist.linear.x",
            "unit": "m/s",
        },
        {"topic": f"{base}topics/scan", "field": "range_max", "type": "float32", "series": None, "unit": "m"},
    ]
    series = rover.get(found[0]["series"], headers=JSON).json()
    assert series["value"]
    assert series["unit"] == "m/s"


def test_a_property_stands_for_the_topic_that_it_is_read_from(start_server: Callable[..., Any]) -> None:
    http = start_server("aircraft").http
    told_of = http.get("/plot", params={"y": "resources/cockpit/display"}, headers=JSON)
    assert told_of.status_code == 422
    assert "is not a number" in told_of.json()["detail"]
    asked = http.get("/plot", params={"y": f"{http.base_url}resources/aircraft/engine/speed"}, headers=JSON).json()
    assert [(each["topic"], each["field"]) for each in asked["y"]] == [
        (f"{http.base_url}topics/aircraft/engine/speed", "data")
    ]


def test_a_reference_to_no_number_is_refused_in_words(rover: httpx.Client) -> None:
    for reference, status, words in (
        ("nodes/rover#x", 400, "does not name a topic"),
        ("topics/odom", 400, "add the field"),
        ("topics/odom?at=1#x", 400, "does not name a topic"),
        ("http://example.org/topics/odom#x", 400, "does not name a topic"),
        ("topics/nothing#data", 404, "There is no topic /nothing"),
        ("topics/odom#twist.twist.linear.q", 422, "has no field 'twist.twist.linear.q'"),
        ("topics/odom#child_frame_id", 422, "is not a number"),
        ("topics/odom#twist", 422, "is not a number"),
        ("resources/nothing#x", 404, "There is no property"),
        (f"topics/odom#{'x.' * 1000}", 400, "is too long"),
    ):
        for accept in (JSON, STREAM):
            answer = rover.get("/plot", params={"y": reference}, headers=accept)
            assert (answer.status_code, words in answer.json()["detail"]) == (status, True), (reference, answer.text)
    many = [f"topics/odom#pose.covariance.{item}" for item in range(17)]
    assert rover.get("/plot", params={"y": many}, headers=JSON).status_code == 400
    assert rover.get("/plot", params={"y": many[:16]}, headers=JSON).status_code == 200


def test_joints_have_their_names_and_numbers_that_are_not_finite_are_null() -> None:
    robot = MadeUp()
    robot.topic("/joints", "sensor_msgs/msg/JointState", {"name": ["left", "right"], "position": [1, 2], "effort": [3]})
    robot.topic("/odd", "std_msgs/msg/Float64", {"data": "NaN"})
    with served(robot) as http:
        (odd,) = told(http, "topics/odd#data", rows=1)
        (event,) = told(http, "topics/joints#position", "topics/joints#effort", "topics/joints#position.1", rows=1)
    assert event["values"] == {"0": [[1.0, 2.0]], "1": [[3.0]], "2": [2.0]}
    assert event["names"] == {"0": ["left", "right"]}
    assert odd["values"]["0"] == [None]
