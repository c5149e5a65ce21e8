"""The search box of every page: results appear while the user types, and without scripts it opens the search."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, Serving, robot, serving

__all__ = ["robot", "serving"]

pytestmark = pytest.mark.slow

LINKS = "[...document.querySelectorAll('.suggestions a')].map((each) => each.textContent)"
FOCUS = "document.querySelector('.find input').focus()"
HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture
def http(robot: MadeUp, serving: Serving) -> httpx.Client:
    for number in range(12):
        robot.topic(f"/battery_{number:02}/state", "sensor_msgs/msg/BatteryState")
    robot.topic("/camera/image_raw", "sensor_msgs/msg/Image")
    robot.topic(f"/{HOSTILE}", "std_msgs/msg/Float64")
    return serving()


def test_of_many_the_first_are_shown_and_a_link_to_all(tab: Any, http: httpx.Client) -> None:
    tab.open(str(http.base_url))
    tab.run(FOCUS)
    tab.type("battery")
    tab.until(f"{LINKS}.length === 9")
    assert tab.run(LINKS)[-1] == "All 24"
    tab.leave("document.querySelector('.suggestions li:last-child a').click()")
    assert tab.run("location.search") == "?q=battery"
    assert tab.run("document.querySelectorAll('table.found tbody tr').length") == 20


def test_names_of_a_hostile_robot_are_text_and_escape_closes(tab: Any, http: httpx.Client) -> None:
    tab.open(str(http.base_url))
    tab.run(FOCUS)
    tab.type("onerror")
    tab.until(f"{LINKS}.length === 1")
    assert tab.run(LINKS) == [f"/{HOSTILE} std_msgs/msg/Float64"]
    assert tab.run("document.querySelector('.suggestions img')") is None
    tab.type("nosuchthing")
    tab.until("document.querySelector('.suggestions .none')")
    for kind in ("keyDown", "keyUp"):
        tab.send("Input.dispatchKeyEvent", type=kind, key="Escape")
    tab.until("document.querySelector('.suggestions').hidden")


def test_without_scripts_the_box_leads_to_the_search(tab: Any, http: httpx.Client) -> None:
    tab.send("Emulation.setScriptExecutionDisabled", value=True)
    tab.open(str(http.base_url))
    tab.send("Emulation.setScriptExecutionDisabled", value=False)
    tab.run("document.querySelector('.find input').value = 'image'")
    tab.leave("document.querySelector('form.find').submit()")
    assert tab.run("location.href") == f"{http.base_url}find?q=image"
    assert "/camera/image_raw" in tab.run("document.querySelector('table.found').textContent")
