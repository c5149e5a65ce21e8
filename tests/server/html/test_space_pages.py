"""Views of space in a real browser: drawing, moving and following, and their text."""

from __future__ import annotations

import math
import time
from typing import Any

import httpx
import numpy as np
import pytest

from tests.server.robots.made_up import MadeUp, served
from tests.server.robots.point_clouds import CLOUD, cloud_message

pytestmark = pytest.mark.slow

CANVAS = "document.querySelector('.space canvas')"
DATA = f"{CANVAS}.dataset"
DARK_PIXELS = f"""(() => {{
  const context = {CANVAS}.getContext('2d'), {{ width, height }} = {CANVAS};
  return context.getImageData(0, 0, width, height).data.filter((each, at) => at % 4 === 0 && each < 60).length;
}})()"""


def test_all_is_drawn_goes_on_and_can_be_hidden_and_followed(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}space")
    tab.until(f"{DATA}.things === '/map /scan /odom' && Number({DATA}.messages) > 20")
    tab.until(f"{DARK_PIXELS} > 2000")
    assert tab.run("document.querySelector('.space [role=status]').textContent") == "Live"
    tab.run("document.querySelector('.legend li:nth-child(2) input').click()")
    tab.until(f"{DATA}.things === '/map /odom'")
    tab.until("document.querySelector('.space select').options.length === 6")
    assert tab.run("[...document.querySelectorAll('.why')].map((each) => each.textContent).join('')") == ""


def drag(tab: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    for kind, (x, y) in (("mouseMoved", start), ("mousePressed", start), ("mouseMoved", end), ("mouseReleased", end)):
        tab.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)


def aim(tab: Any) -> tuple[float, float]:
    """Choose a goal on the map, 120 pixels from the left and the top, heading up; return its position in space."""
    tool = "[...document.querySelectorAll('.space .controls button')].at(-1)"
    tab.until(f"!{tool}.hidden")
    tab.run(f"void {CANVAS}.scrollIntoView({{block: 'center'}})")
    centre = "(({x, y, width, height}) => [x + width / 2, y + height / 2])"
    tab.press(*tab.run(f"{centre}({tool}.getBoundingClientRect())"))
    tab.until(f"{CANVAS}.classList.contains('aiming')")
    x, y = tab.run(f"(({{x, y}}) => [x + 120, y + 120])({CANVAS}.getBoundingClientRect())")
    tab.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    words = tab.until("document.querySelector('.space .readout').textContent.match(/^(.*), (.*) m in map$/)?.slice(1)")
    drag(tab, (x, y), (x, y - 40))
    tab.until("document.querySelector('dialog[open]')")
    return float(words[0]), float(words[1])


def press_key(tab: Any, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        tab.send("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=27)


def test_a_click_on_the_map_sends_the_goal_of_an_action_after_it_was_confirmed(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}space")
    tab.until(f"{DATA}.things === '/map /scan /odom'")
    aim(tab)
    press_key(tab, "Escape")
    tab.until("!document.querySelector('dialog')")
    goals = f"{rover.base_url}actions/navigate_to"
    assert "goals/" not in rover.get(goals, headers={"Accept": "text/turtle"}).text
    place = aim(tab)
    assert tab.run("document.querySelector('dialog pre').textContent").startswith("POST /actions/navigate_to")
    tab.run("document.querySelector('dialog [type=submit]').click()")
    goal = tab.until("document.querySelector('.space .readout a')?.getAttribute('href')")
    sent = rover.get(goal, headers={"Accept": "application/json"}).json()["goal"]["pose"]
    assert sent["header"]["frame_id"] == "map"
    assert sent["header"]["stamp"]["sec"] == pytest.approx(time.time(), abs=60)
    position, turn = sent["pose"]["position"], sent["pose"]["orientation"]
    assert (position["x"], position["y"]) == pytest.approx(place, abs=0.02)
    assert (turn["z"], turn["w"]) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)), abs=1e-3)


def test_a_goal_topic_takes_the_pose_in_a_cockpit_unless_the_robot_is_stopped(tab: Any) -> None:
    robot = MadeUp()
    robot.topic("/goal_pose", "geometry_msgs/msg/PoseStamped", published=False, heard=True)
    robot.topic("/told", "geometry_msgs/msg/PoseStamped", {"header": {"frame_id": "map"}}, heard=True)
    robot.topic("/cmd_vel", "geometry_msgs/msg/Twist", published=False, heard=True)
    with served(robot) as http:
        goals = http.get("/space", headers={"Accept": "application/json"}).json()["goals"]
        assert [(each["method"], each["url"]) for each in goals] == [("PUT", f"{http.base_url}topics/goal_pose")]
        tab.open(f"{http.base_url}cockpit/default")
        tab.until(f"{DATA}.things === '/told'")
        place = aim(tab)
        tab.run("document.querySelector('dialog [type=submit]').click()")
        tab.until("document.querySelector('.space .readout').textContent.startsWith('Sent to ')")
        (sent,) = robot.sent["/goal_pose"]
        position = sent["pose"]["position"]
        assert (position["x"], position["y"]) == pytest.approx(place, abs=0.02)
        assert sent["header"]["frame_id"] == "map"
        http.post("/stop").raise_for_status()
        tab.until("[...document.querySelectorAll('.space .controls button')].at(-1).hidden")
        assert http.get("/space", headers={"Accept": "application/json"}).json()["goals"] == []
        tab.open("about:blank")


TF, STRING = "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"
URDF = """<robot name="r"><link name="base_link">
<visual><geometry><box size="1 0.5 0.2"/></geometry><material name="m"><texture filename="http://192.0.2.1/t.png"/></material></visual>
<visual><geometry><mesh filename="package://r/m.stl"/></geometry></visual></link>
<link name="wheel"><visual><geometry><cylinder radius="0.1" length="0.05"/></geometry></visual></link>
<link name="odd"><visual><geometry><sphere radius="0.1"/></geometry></visual></link>
<joint name="j" type="fixed"><parent link="base_link"/><child link="wheel"/></joint>
<joint name="k" type="fixed"><parent link="base_link"/><child link="odd"/></joint></robot>"""
WITHOUT_WEBGL = """
const original = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind.startsWith("webgl") ? null : original.call(this, kind, ...rest);
};
"""


def test_a_cloud_is_drawn_in_three_dimensions_turned_and_lives_and_no_other_host_is_asked(tab: Any) -> None:
    robot = MadeUp()
    robot.topic("/points", CLOUD, cloud_message(np.random.default_rng(1).normal(size=(30_000, 3))))
    with served(robot) as http:
        tab.open(f"{http.base_url}space?show=topics/points&view=3d")
        tab.until(f"{DATA}.points === '20000'")
        tab.run(f"void {CANVAS}.scrollIntoView()")
        seen_from = tab.run(f"{DATA}.camera")
        box = tab.run(f"(({{ x, y }}) => [x, y])({CANVAS}.getBoundingClientRect())")
        for kind, far in (("mousePressed", 50), ("mouseMoved", 150), ("mouseReleased", 150)):
            tab.send("Input.dispatchMouseEvent", type=kind, x=box[0] + far, y=box[1] + 60, button="left", clickCount=1)
        robot.publishes("/points", cloud_message(np.eye(3)))
        tab.until(f"{DATA}.points === '3' && {DATA}.messages === '2'")
        asked = tab.run("performance.getEntriesByType('resource').map((each) => each.name)")
        assert tab.run(f"{DATA}.camera") != seen_from
        tab.open("about:blank")
    assert [each for each in asked if "/three.js" in each]
    assert not [each for each in asked if not each.startswith(str(http.base_url))]


def test_without_webgl_the_page_says_so_and_tells_in_words_what_is_there(tab: Any, rover: httpx.Client) -> None:
    tab.send("Page.addScriptToEvaluateOnNewDocument", source=WITHOUT_WEBGL)
    tab.open(f"{rover.base_url}space?view=3d")
    tab.until("document.querySelector('.space [role=status]').textContent.startsWith('This browser has no WebGL')")
    assert tab.run("document.querySelectorAll('.space canvas').length") == 0
    assert tab.run("document.querySelector('.members').textContent.includes('/scan')")


def test_the_model_of_the_robot_is_where_its_frames_are_is_followed_and_what_is_missing_is_said(tab: Any) -> None:
    robot = MadeUp()
    frames = [("map", "base_link"), ("base_link", "wheel")]
    transforms: list[dict[str, Any]] = [
        {"header": {"frame_id": parent}, "child_frame_id": child, "transform": {"rotation": {"w": 1.0}}}
        for parent, child in frames
    ]
    robot.topic("/tf", TF, {"transforms": transforms})
    robot.topic("/goal", "geometry_msgs/msg/PointStamped", {"header": {"frame_id": "map"}})
    robot.parameter("/robot_description", URDF)
    with served(robot) as http:
        tab.open(f"{http.base_url}space?view=3d")
        model = "document.querySelector('.space .readout').textContent"
        tab.until(f"{model}.startsWith('Model: 2 links')")
        assert "1 mesh is missing" in tab.run(model)
        assert tab.run(model).endswith("1 without a frame.")
        assert tab.run("document.querySelector('.space details:not([hidden]) li').textContent") == "package://r/m.stl"
        tab.until("document.querySelector('.space select').options.length === 4")
        tab.run("document.querySelector('.space select').value = 'base_link'")
        tab.run("document.querySelector('.space select').dispatchEvent(new Event('change'))")
        transforms[0]["transform"] = {"translation": {"x": 1000.0}, "rotation": {"w": 1.0}}
        robot.publishes("/tf", {"transforms": transforms})
        tab.until(f"Math.abs(Number({DATA}.camera.split(' ')[0]) - 1000) < 200")
        robot.topic("/robot_description", STRING, {"data": "<a/>"})
        tab.open(f"{http.base_url}space?view=3d")
        tab.until(f"{model} === 'The model of the robot cannot be read.'")
        asked = tab.run("performance.getEntriesByType('resource').map((each) => each.name)")
        tab.open("about:blank")
    assert [each for each in asked if each.endswith("/topics/robot_description?field=data")], "before the parameter"
