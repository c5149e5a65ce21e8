"""Cockpits in a real browser: panels update, drive the robot, and send no requests to other hosts."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest

from tests.server.robots.made_up import MadeUp, served

pytestmark = pytest.mark.slow

LOADED = "JSON.stringify(performance.getEntriesByType('resource').map((each) => [each.name, each.encodedBodySize]))"
PANEL = "[...document.querySelectorAll('.panel')].find((each) => each.querySelector('h2').textContent === '%s')"
SIZES = "[...document.querySelectorAll('.panel')].map((each) => each.getBoundingClientRect().width)"
HEIGHT = "document.querySelector('%s').getBoundingClientRect().height"
MAX_BYTES = 300_000


def test_the_panels_of_the_default_cockpit_move_and_ask_no_other_host(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}cockpit/default")
    battery = f"{PANEL % 'Battery'}.querySelector('.value').textContent"
    charge = tab.run(battery)
    tab.until(f"{battery} !== '{charge}'")
    tab.until("Number(document.querySelector('.panel.plot figure').dataset.points) > 10")
    tab.until("document.querySelector('.panel img').dataset.moving === 'yes'")
    tab.run("void document.querySelector('.panel.space').scrollIntoView()")
    tab.until("Number(document.querySelector('.panel.space canvas').dataset.messages) > 2")
    assert tab.run("document.querySelector('.panel.plot canvas').getBoundingClientRect().height") > 100
    loaded = json.loads(tab.run(LOADED))
    assert {name for name, _ in loaded if not name.startswith(str(rover.base_url))} == set()
    files = [size for name, size in loaded if "?v=" in name]
    assert sum(files) + len(tab.run("document.documentElement.outerHTML")) < MAX_BYTES


def test_the_pad_of_a_cockpit_drives_while_it_is_pressed(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}cockpit/default")
    tab.until("document.querySelector('.panel .stick')")
    tab.run("void document.querySelector('.stick').scrollIntoView({block: 'center'})")
    box = json.loads(tab.run("JSON.stringify(document.querySelector('.stick').getBoundingClientRect())"))
    at = {"x": box["left"] + box["width"] / 2, "y": box["top"] + 10, "button": "left", "clickCount": 1}
    before = rover.get("/topics/odom", headers={"Accept": "application/json"}).json()["pose"]["pose"]["position"]["x"]
    tab.send("Input.dispatchMouseEvent", type="mousePressed", **at)
    tab.until("document.querySelector('.driving').textContent === 'Driving'")
    moved = rover.get(
        f"/topics/odom?until=pose.pose.position.x > {before + 0.05}&timeout=20", headers={"Accept": "application/json"}
    )
    assert moved.status_code == 200
    tab.send("Input.dispatchMouseEvent", type="mouseReleased", **at)
    tab.until("document.querySelector('.driving').textContent === 'Standing'")
    stood = rover.get("/topics/odom?until=twist.twist.linear.x = 0&timeout=20", headers={"Accept": "application/json"})
    assert stood.status_code == 200


def test_the_panel_of_space_is_mostly_its_picture_for_hundreds_of_topics(tab: Any) -> None:
    robot = MadeUp()
    names = [f"/robot_{number:03}/scan" for number in range(300)]
    robot.topics(names, "sensor_msgs/msg/LaserScan")
    for name in names:
        robot.publishes(name, {"header": {"frame_id": name}, "ranges": [1.0], "angle_increment": 0.5, "range_max": 2.0})
    with served(robot) as http:
        tab.send("Emulation.setDeviceMetricsOverride", width=1280, height=800, deviceScaleFactor=1, mobile=False)
        tab.open(f"{http.base_url}cockpit/default")
        tab.until("Number(document.querySelector('.panel.space canvas')?.dataset.messages) > 2")
        panel, picture = (tab.run(HEIGHT % each) for each in (".panel.space", ".panel.space canvas"))
        assert picture > panel / 2
        assert panel < 800
        tab.open("about:blank")


def test_on_a_phone_the_panels_are_one_below_the_other(tab: Any, rover: httpx.Client) -> None:
    tab.send("Emulation.setDeviceMetricsOverride", width=390, height=844, deviceScaleFactor=1, mobile=True)
    tab.open(f"{rover.base_url}cockpit/default")
    assert len(set(tab.run(SIZES))) == 1
    assert tab.run("document.documentElement.scrollWidth") == 390
