"""Plots in a real browser: drawing, zooming, saving and sharing, and the small ones next to numbers."""

from __future__ import annotations

import html
import json
import re
from typing import Any

import httpx
import pytest

pytestmark = pytest.mark.slow

ODOMETRY = "topics/odom%23"
POINTS = "Number(document.querySelector('figure[data-part]').dataset.points)"
STATUS = "document.querySelector('[data-part=status]').textContent"
LABELS = "[...document.querySelectorAll('.u-legend .u-label')].slice(1).map((each) => each.textContent)"
SAVED = """new Promise((resolve) => {
  const create = URL.createObjectURL;
  URL.createObjectURL = (blob) => { resolve(%s); return create(blob); };
  document.querySelector('[data-part=%s]').click();
})"""


def opened(tab: Any, http: httpx.Client, query: str) -> Any:
    tab.open(f"{http.base_url}plot?{query}")
    tab.until(f"{POINTS} > 20")
    return tab


def test_messages_are_drawn_as_they_come_with_what_is_recorded_before_them(tab: Any, rover: httpx.Client) -> None:
    field = "header.stamp.nanosec"
    opened(tab, rover, f"y={ODOMETRY}{field}&y=topics/battery_state%23percentage")
    assert tab.run(STATUS) == "Live"
    drawn = tab.run(POINTS)
    tab.until(f"{POINTS} > {drawn} + 40")
    lines = tab.run(SAVED % ("blob.text()", "csv")).split("\r\n")
    assert lines[0] == f"time,/odom {field},/battery_state percentage"
    rows = [line.split(",") for line in lines[1:] if line]
    assert [at for at, *_ in rows] == sorted(at for at, *_ in rows)
    columns = rover.get(f"/topics/odom?series={field}&points=10000", headers={"Accept": "application/json"}).json()
    recorded = set(columns["value"])
    saved = [float(row[1]) for row in rows if row[1]]
    assert len(saved) > 40
    assert set(saved[2:-40]) <= recorded


def test_dragging_and_a_pause_hold_what_is_seen_which_goes_on_and_is_saved_as_a_picture(
    tab: Any, rover: httpx.Client
) -> None:
    opened(tab, rover, f"y={ODOMETRY}twist.twist.linear.x")
    tab.run("void document.querySelector('.u-over').scrollIntoView({block: 'center'})")
    box = json.loads(tab.run("JSON.stringify(document.querySelector('.u-over').getBoundingClientRect())"))
    y = box["top"] + box["height"] / 2
    for kind, share in (("mouseMoved", 0.6), ("mousePressed", 0.6), ("mouseMoved", 0.9), ("mouseReleased", 0.9)):
        at = {"x": box["left"] + box["width"] * share, "y": y}
        tab.send("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **at)
    tab.until(f"{STATUS} === 'Zoomed'")
    tab.until("document.querySelector('[data-part=pause]').textContent === 'Go on'")
    tab.run("document.querySelector('.u-over').dispatchEvent(new MouseEvent('dblclick', {bubbles: true}))")
    tab.until(f"{STATUS} === 'Live'")
    for status in ("Zoomed", "Live"):
        tab.run("document.querySelector('[data-part=pause]').click()")
        tab.until(f"{STATUS} === '{status}'")
    kind, size = tab.run(SAVED % ("[blob.type, blob.size]", "png"))
    assert (kind, size > 1000) == ("image/png", True)


def test_joints_have_their_names_beside_their_lines(tab: Any, robot: Any, serving: Any) -> None:
    robot.topic("/joints", "sensor_msgs/msg/JointState", {"name": ["<b>", "right"], "position": [1, 2]})
    tab.open(f"{serving().base_url}plot?y=topics/joints%23position")
    tab.until(f"{LABELS}.length === 2")
    assert tab.run(LABELS) == ["position <b>", "position right"]
    robot.publishes("/joints", {"name": ["left", "right"], "position": [1, 2]})
    tab.until(f"{LABELS}[0] === 'position left'")


def test_numbers_of_a_page_have_small_plots_that_lead_to_large_ones(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}topics/odom")
    link = "document.querySelector('a.plot[href$=\"%23twist.twist.linear.x\"]')"
    tab.until(f"{link}.querySelector('polyline').getAttribute('points').split(' ').length > 3")
    tab.leave(f"{link}.click()")
    tab.until(f"{POINTS} > 5")
    assert tab.run("document.querySelector('h1').textContent") == "twist.twist.linear.x"


def labels(page: str) -> list[str]:
    """Return the labels of the lines of a plot, as passed to its script."""
    [found] = re.findall(r'data-plot="([^"]*)"', page)
    return [each["label"] for each in json.loads(html.unescape(found))["y"]]


def test_a_page_without_scripts_tells_the_numbers_and_takes_another(rover: httpx.Client) -> None:
    page = rover.get("/plot?y=topics/odom%23twist.twist.linear.x", headers={"Accept": "text/html"}).text
    assert '<a href="/topics/odom?series=twist.twist.linear.x&amp;format=csv">' in page
    assert '<input type="hidden" name="y" value="topics/odom#twist.twist.linear.x">' in page
    assert 'class="controls" hidden' in page
    assert labels(page) == ["twist.twist.linear.x"]
    assert "&#34;unit&#34;: &#34;m/s&#34;" in page
    query = "y=topics/odom%23twist.twist.linear.x&y=topics/battery_state%23percentage"
    several = rover.get(f"/plot?{query}", headers={"Accept": "text/html"}).text
    assert labels(several) == ["/odom twist.twist.linear.x", "/battery_state percentage"]
    assert rover.get("/plot", headers={"Accept": "text/html"}).status_code == 200
