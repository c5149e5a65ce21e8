"""Missing resources: similar names for readers, and methods that make them (RFC 9110 10.2.1)."""

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


@pytest.mark.slow
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


ABSENT = (
    "/nodes/absent", "/topics/absent", "/services/absent", "/actions/absent", "/calls/absent", "/goals/absent",
    "/holds/absent", "/activity/absent", "/bags/absent", "/parameters/absent", "/types/absent/msg/Absent",
    "/shapes/absent/msg/Absent", "/shapes/absent", "/queries/absent", "/mappings/absent", "/data/absent",
    "/data/absent/", "/resources/absent", "/resources/absent/", "/channels/absent", "/.well-known/absent", "/absent",
    "/nodes/absent/", "/services/absent/", "/parameters/absent/",
)  # fmt: skip


def allowed(http: httpx.Client, path: str) -> set[str]:
    """Return the methods that OPTIONS and GET state for a URL; empty if they do not."""
    answers = (http.options(path), http.get(path))
    return {each for answer in answers for each in answer.headers.get("allow", "").split(", ")} - {""}


def test_what_is_absent_allows_no_get(http: httpx.Client) -> None:
    wrong = {
        path: (http.get(path).status_code, allowed(http, path))
        for path in ABSENT
        if http.get(path).status_code != 404 or not allowed(http, path).isdisjoint({"GET", "HEAD"})
    }
    assert not wrong, wrong


def test_what_is_gone_allows_no_get(own_aircraft: httpx.Client) -> None:
    http = own_aircraft
    made = [
        http.post("/services/aircraft/start").headers["location"],
        http.post("/topics/cockpit/display?rate=1&lease=5", json={"data": "x"}).headers["location"],
    ]
    for url in made:
        assert {"GET", "HEAD", "DELETE"} <= set(http.options(url).headers["allow"].split(", "))
        assert http.delete(url).status_code == 204
        assert http.get(url).status_code == 410
        assert allowed(http, url).isdisjoint({"GET", "HEAD"})
