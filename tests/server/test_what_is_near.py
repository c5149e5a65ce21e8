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


def test_a_misspelt_name_is_answered_with_those_near_it(http: httpx.Client) -> None:
    for asked, near in {
        "topics/battery": "topics/battery_state",
        "topics/batery": "topics/battery_state",
        "topics/batery_state": "topics/battery_state",
        "topics/image_raw": "topics/camera/front/image_raw",
        "topics/camra/": "topics/camera/",
        "services/blink": "services/lights/blink",
        "actions/navigate_too": "actions/navigate_to",
        "nodes/robott": "nodes/robot",
        "parameters/drive/max_sped": "parameters/drive/max_speed",
        "parameters/drives/": "parameters/drive/",
        "resources/lights/levl": "resources/lights/level",
        "resources/light/": "resources/lights/",
    }.items():
        answer = http.get(f"/{asked}")
        assert (answer.status_code, answer.json()["near"]) == (404, [f"{http.base_url}{near}"])
        assert f'<a href="/{near}">' in http.get(f"/{asked}", headers=HTML).text
    assert f"{http.base_url}topics/battery_state" in http.get("/topics/battery", headers={"Accept": "text/turtle"}).text
    written = http.post("/services/lights/blinc")
    assert (written.status_code, written.json()["near"]) == (404, [f"{http.base_url}services/lights/blink"])
    for asked in ("topics/gripper", "nothing", "goals/battery_state", "topics/"):
        assert "near" not in http.get(f"/{asked}").text, asked
    field = http.get("/topics/battery_state?field=no.such.field")
    assert (field.status_code, field.json().get("near")) == (404, None)


def test_topics_of_the_rover_are_found_by_misspelt_words() -> None:
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
