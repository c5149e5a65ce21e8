"""Views of space in a real browser: what is drawn, moved and followed, and what is said."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from tests.server.robots.made_up import MadeUp, served
from tests.server.robots.point_clouds import CLOUD, cloud_message

CANVAS = "document.querySelector('.space canvas')"
DATA = f"{CANVAS}.dataset"
DARK_PIXELS = f"""(() => {{
  const context = {CANVAS}.getContext('2d'), {{ width, height }} = {CANVAS};
  return context.getImageData(0, 0, width, height).data.filter((each, at) => at % 4 === 0 && each < 60).length;
}})()"""


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> httpx.Client:
    http: httpx.Client = start_server("rover", "--history", "/odom").http
    return http


def test_all_is_drawn_goes_on_and_can_be_hidden_and_followed(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}space")
    tab.until(f"{DATA}.things === '/map /scan /odom' && Number({DATA}.messages) > 20")
    tab.until(f"{DARK_PIXELS} > 2000")
    assert tab.run("document.querySelector('.space [role=status]').textContent") == "Live"
    tab.run("document.querySelector('.legend li:nth-child(2) input').click()")
    tab.until(f"{DATA}.things === '/map /odom'")
    tab.until("document.querySelector('.space select').options.length === 6")
    assert tab.run("[...document.querySelectorAll('.why')].map((each) => each.textContent).join('')") == ""


def test_the_page_of_a_scan_has_its_view_which_lives_with_the_page(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}topics/scan")
    tab.until(f"{DATA}.things === '/scan' && Number({DATA}.messages) > 20")
    assert tab.run("document.querySelectorAll('.space canvas').length") == 1
    assert tab.run("document.querySelector('.space figcaption a').getAttribute('href')") == "/space?show=topics/scan"


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
