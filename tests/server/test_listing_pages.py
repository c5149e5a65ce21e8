"""Pages of completed operations: goals, calls, receipts, with names and times, and highlighted failures."""

from __future__ import annotations

import re
from collections.abc import Callable

import httpx
import rdflib

from tests.server.conftest import Served
from tests.server.robots.made_up import MadeUp, Serving

ROS = rdflib.Namespace("https://w3id.org/rosld#")
HTML = {"Accept": "text/html"}
FAR = {"pose": {"header": {"frame_id": "map"}, "pose": {"position": {"x": 90.0, "y": 90.0}}}}


def rows(http: httpx.Client, path: str) -> list[str]:
    """Return the rows of the table of members, as HTML."""
    page = http.get(path, headers=HTML)
    assert page.status_code == 200, page.text
    found = re.search(r'<table class="members">.*?</table>', page.text, re.DOTALL)
    return re.findall(r"<tr data-key.*?</tr>", found[0], re.DOTALL) if found else []


def said(http: httpx.Client, path: str) -> rdflib.Graph:
    return rdflib.Graph().parse(data=http.get(path, headers={"Accept": "application/n-triples"}).text, format="nt")


def words(row: str) -> str:
    return " ".join(re.sub(r"<[^>]+>", " ", row.replace("<wbr>", "")).split())


def test_goals_are_listed_by_action_status_and_times_and_those_that_failed_stand_out(
    serve: Callable[..., Served],
) -> None:
    http = serve("rover:?rate=10").http
    goal = http.post("/actions/navigate_to", json=FAR).headers["location"]
    http.get(goal, params={"until": "status = 'aborted'", "timeout": "60"}).raise_for_status()
    [row] = rows(http, "/goals/")
    assert 'class="failed"' in row
    assert re.match(r"/navigate_to aborted \d{4}-\d\d-\d\d .* UTC", words(row))
    assert row.count("<time datetime=") == 2
    listed = said(http, "/goals/")
    assert (rdflib.URIRef(goal), ROS.status, ROS.Aborted) in listed
    told = said(http, goal)
    assert all(triple in told for triple in listed.triples((rdflib.URIRef(goal), None, None)))


def test_a_listing_of_goals_is_in_another_state_whenever_a_goal_is(serve: Callable[..., Served]) -> None:
    http = serve("rover").http
    near = {"pose": {**FAR["pose"], "pose": {"position": {"x": 1.5}}}}
    goal = http.post("/actions/navigate_to", json=near).headers["location"]
    known = http.get("/goals/", headers={"Accept": "text/turtle"}).headers["etag"]
    http.delete(goal)
    changed = http.get("/goals/", params={"after": known, "timeout": "60"}, headers={"Accept": "text/turtle"})
    assert changed.status_code == 200
    assert changed.headers["etag"] != known
    http.get(goal, params={"until": "status != 'executing' and status != 'canceling'", "timeout": "60"})
    [row] = rows(http, "/goals/")
    assert "executing" not in row


def test_calls_and_receipts_are_listed_by_names_and_what_was_refused_stands_out(
    robot: MadeUp, serving: Serving
) -> None:
    robot.offer("/dock", "std_srvs/srv/Trigger", lambda _: {"success": True})
    http = serving()
    http.post("/services/dock", json={}).raise_for_status()
    assert http.post("/services/dock", json={"wrong": 1}).status_code == 422
    [call] = rows(http, "/calls/")
    assert words(call).startswith("/dock succeeded 2")
    assert 'class="failed"' not in call
    made = said(http, "/calls/").value(predicate=ROS.state, object=ROS.Succeeded)
    assert (made, ROS.isCallOf, rdflib.URIRef(f"{http.base_url}services/dock")) in said(http, "/calls/")
    page = re.search(r'href="([^"]+)"', call)
    assert page
    assert "<h1><bdi>/dock</bdi></h1>" in http.get(http.base_url.join("/calls/").join(page[1]), headers=HTML).text
    refused, made = rows(http, "/activity/")
    assert words(refused).startswith("POST /services/dock 2")
    assert 'class="failed"' in refused
    assert 'class="failed"' not in made


def test_numbers_have_six_digits_where_they_have_more_and_are_no_integers(robot: MadeUp, serving: Serving) -> None:
    shown = {
        "Float64": (0.1511648796956807, '<bdi class="value number" title="0.1511648796956807">0.151165</bdi>'),
        "UInt64": (1795526226687342044, '<bdi class="value number">1795526226687342044</bdi>'),
        "String": ("0.30000000000000004 m", "0.30000000000000004 m"),
    }
    for name, (data, _) in shown.items():
        robot.topic(f"/{name}", f"std_msgs/msg/{name}", {"data": data})
    http = serving()
    for name, (_, text) in shown.items():
        http.get(f"/topics/{name}")
        assert text in http.get(f"/topics/{name}", headers=HTML).text
