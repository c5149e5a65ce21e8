"""A 404 says what was near, in every container of the robot, to those who may read it."""

from __future__ import annotations

import httpx
import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Action, TypeRef
from rosld.adapters.rover import rover_adapter
from tests.server.robots.made_up import MadeUp, Serving, served

HTML = {"Accept": "text/html"}


@pytest.fixture
def http(robot: MadeUp, serving: Serving) -> httpx.Client:
    robot.topic("/battery_state", "sensor_msgs/msg/BatteryState")
    robot.topic("/camera/front/image_raw", "sensor_msgs/msg/Image")
    robot.answer("/lights/get_level", "made_up/srv/GetByte", value=1)
    robot.offer("/lights/blink", "std_srvs/srv/Trigger", lambda _: {"success": True})
    robot.strange(Action("/navigate_to", TypeRef("nav2_msgs/action/NavigateToPose")))
    robot.parameter("/drive/max_speed", 0.5)
    return serving()


@pytest.mark.parametrize(
    ("asked", "near"),
    [
        ("topics/battery", ["topics/battery_state"]),
        ("topics/batery", ["topics/battery_state"]),
        ("topics/batery_state", ["topics/battery_state"]),
        ("topics/image_raw", ["topics/camera/front/image_raw"]),
        ("topics/camra/", ["topics/camera/"]),
        ("services/blink", ["services/lights/blink"]),
        ("actions/navigate_too", ["actions/navigate_to"]),
        ("nodes/robott", ["nodes/robot"]),
        ("parameters/drive/max_sped", ["parameters/drive/max_speed"]),
        ("parameters/drives/", ["parameters/drive/"]),
        ("resources/lights/levl", ["resources/lights/level"]),
        ("resources/light/", ["resources/lights/"]),
    ],
)
def test_what_is_spelt_wrong_is_answered_with_what_is_near(http: httpx.Client, asked: str, near: list[str]) -> None:
    answer = http.get(f"/{asked}")
    assert answer.status_code == 404, answer.text
    assert answer.json()["near"] == [f"{http.base_url}{each}" for each in near]
    page = http.get(f"/{asked}", headers=HTML).text
    assert f'<a href="/{near[0]}">' in page


def test_names_of_the_rover_are_found_by_words_that_are_spelt_wrong() -> None:
    meant = {
        "batery": "battery_state",
        "cmdvel": "cmd_vel",
        "camra_info": "camera/camera_info",
        "diagnostcs": "diagnostics",
        "imgae": "camera/image_raw",
        "comprssed": "camera/image_raw/compressed",
    }
    with served(rover_adapter("rover", AdapterOptions())) as http:
        for misspelt, name in meant.items():
            near = http.get(f"/topics/{misspelt}").json()["near"]
            assert near[0] == f"{http.base_url}topics/{name}", misspelt
            assert len(near) <= 3, near
        for unlike in ("laser", "battery_level"):
            assert "near" not in http.get(f"/topics/{unlike}").json()


def test_what_is_near_is_linked_in_rdf(http: httpx.Client) -> None:
    answer = http.get("/topics/battery", headers={"Accept": "text/turtle"})
    assert answer.status_code == 404
    assert f"{http.base_url}topics/battery_state" in answer.text


def test_a_write_to_a_name_that_is_spelt_wrong_is_answered_so_too(http: httpx.Client) -> None:
    answer = http.post("/services/lights/blinc")
    assert (answer.status_code, answer.json()["near"]) == (404, [f"{http.base_url}services/lights/blink"])


@pytest.mark.parametrize("asked", ["topics/gripper", "nothing", "goals/battery_state", "topics/"])
def test_where_nothing_is_near_nothing_is_told(http: httpx.Client, asked: str) -> None:
    assert "near" not in http.get(f"/{asked}").text


def test_where_something_of_what_is_there_is_missing_no_other_name_is_told(http: httpx.Client) -> None:
    answer = http.get("/topics/battery_state?field=no.such.field")
    assert (answer.status_code, answer.json().get("near")) == (404, None)
