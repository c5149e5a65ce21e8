"""First impression of a robot without a mapping: values and forms, and RDF that is initially folded."""

from __future__ import annotations

import re
from typing import Any

import httpx
import pytest

from tests.waiting import until

pytestmark = pytest.mark.slow

HTML, JSON = {"Accept": "text/html"}, {"Accept": "application/json"}


def page(http: httpx.Client, path: str) -> tuple[str, str]:
    """A page: its visible part and its folded part."""
    whole = http.get(path, headers=HTML).text
    seen, fold, folded = whole.partition('<details class="folded">')
    assert fold, path
    return seen, folded


def test_the_entry_page_begins_with_what_there_is_and_folds_its_rdf(rover: httpx.Client) -> None:
    seen, folded = page(rover, "/")
    cards = re.findall(r'<span class="name">([^<]+)</span>', seen)
    assert cards[:4] == ["Cockpit", "Resources", "Diagnostics", "Space"]
    assert "hydra:IriTemplate" in folded
    assert "hydra:IriTemplate" not in seen


def test_a_page_begins_with_the_value_and_folds_its_rdf(rover: httpx.Client) -> None:
    seen, folded = page(rover, "/parameters/rover/max_speed")
    assert "From 0.1 to 1.0." in seen
    assert "sh:PropertyShape" not in seen
    assert "sh:PropertyShape" in folded
    seen, _ = page(rover, "/topics/camera/image_raw")
    assert '<figure class="picture">' in seen
    assert ">57,600 bytes</a>" in seen
    assert 'class="hex"' not in seen
    assert "a list does not subscribe" in rover.get("/topics/", headers=HTML).text
    assert "a list does not subscribe" not in rover.get("/services/", headers=HTML).text


def test_a_tree_of_parameters_is_a_table_of_their_values(rover: httpx.Client) -> None:
    text = rover.get("/parameters/", headers=HTML).text
    rows = re.findall(r'<tr data-key="/parameters/([^"]+)".*?<td[^>]*>(.*?)</td></tr>', text, re.DOTALL)
    values = {name: re.sub("<[^>]+>", "", value).strip() for name, value in rows}
    assert values["rover/max_speed"] == "0.5"
    assert values["rover/drive_mode"] == "normal"
    assert text.count("<h2") == 2  # its members, and its description


def test_a_goal_or_call_says_first_what_has_become_of_it(rover: httpx.Client, own_aircraft: httpx.Client) -> None:
    header, pose = {"frame_id": "map"}, {"position": {"x": 50.0, "y": 50.0}, "orientation": {"w": 1.0}}
    error = r'<div class="notice error" role="alert">\s*<p><bdi>'
    for goal, status, words in (
        ({"header": header, "pose": pose}, "aborted", error + "The goal was aborted"),
        ({"header": header}, "succeeded", "The goal has succeeded"),
    ):
        url = rover.post("/actions/navigate_to", json={"pose": goal}).headers["location"]
        until(lambda url=url, status=status: rover.get(url, headers=JSON).json()["status"] == status, "the end")
        assert re.search(words, rover.get(url, headers=HTML).text)
    lights = rover.post("/services/set_lights", json={"data": True}).headers["location"]
    good = r'<div class="notice good"[^>]*>\s*<p><bdi>The service has responded'
    assert re.search(good, rover.get(lights, headers=HTML).text)
    faster = own_aircraft.post("/services/aircraft/engine/set_speed", json={"data": 100.0}).headers["location"]
    assert re.search(f"{error}The call has failed: ", own_aircraft.get(faster, headers=HTML).text)


def test_resources_are_a_line_each_and_unfolded_at_will(rover: httpx.Client) -> None:
    for topic in ("odom", "battery_state"):
        rover.get(f"/topics/{topic}")
    seen = rover.get("/resources/", headers=HTML).text
    assert re.search(r'<details class="many"><summary><bdi>voltage [0-9.]+, temperature 25, ', seen)
    assert re.search(r'<details class="many"><summary><bdi>child_frame_id base_link, pose.pose.position.x ', seen)
    lights = seen.partition('<tr data-key="/resources/lights">')[2].partition("</tr>")[0]
    assert "<details" not in lights


def test_a_plot_of_what_stands_still_is_as_near_as_its_numbers(tab: Any, rover: httpx.Client) -> None:
    tab.open(f"{rover.base_url}plot?y=topics/odom%23twist.twist.linear.x")
    of = "((one, other) => chart.scales.y.range(null, one, other))"
    assert tab.run(f"{of}(0, 0)") == [-1, 1]
    assert tab.run(f"{of}(12, 12)") == [10.8, 13.2]
    assert tab.run(f"{of}(null, null)") == [None, None]
    assert tab.run(f"{of}(1, 2)") == pytest.approx([0.9, 2.1])
