"""Cockpits over HTTP: the default one of the robot, stored ones, and invalid ones."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode, Triple
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from rosld.ontology.cockpit import read_cockpit
from rosld.server.auth.tokens import token_digest
from tests.server.auth.conftest import rule
from tests.server.robots.made_up import MadeUp, served
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

TURTLE = {"Content-Type": "text/turtle"}
PAGE = {"Accept": "text/html"}
PREFIX = "@prefix ros: <https://w3id.org/rosld#> . @prefix dcterms: <http://purl.org/dc/terms/> .\n"
VOLTAGE = '<bdi>voltage</bdi></dt><dd class="told"><bdi class="value number">[0-9.]+'
FOREIGN = "http://elsewhere.example"
Reader = Callable[[httpx.Response], set[Triple]]


@pytest.fixture(scope="module")
def rover(start_server: Callable[..., Any]) -> httpx.Client:
    """A rover whose documents have versions."""
    client: httpx.Client = start_server("rover", "--versions", "5").http
    return client


def put(rover: httpx.Client, name: str, turtle: str) -> httpx.Response:
    return rover.put(f"/cockpit/{name}", content=PREFIX + turtle, headers=TURTLE)


def fields(page: str, action: str) -> dict[str, str]:
    """Return the pairs of the page's form for an action, as initially filled in."""
    start = page.index(f'action="{action}"') if action else page.index("<h2>Panels</h2>")
    form = page[start : page.index("</form>", start)]
    found = {}
    for tag in re.findall(r"<input[^>]*>", form):
        given = dict(re.findall(r'([a-z]+)="([^"]*)"', tag))
        if given.get("type") != "checkbox":
            found[given["name"]] = html.unescape(given.get("value", ""))
    for name, options in re.findall(r'<select name="([^"]+)">(.*?)</select>', form):
        found[name] = re.findall(r"<option selected>([^<]+)", options)[0]
    return found


def test_the_default_cockpit_is_made_from_what_the_robot_has(rover: httpx.Client, triples_of: Reader) -> None:
    url = f"{rover.base_url}cockpit/default"
    triples = triples_of(rover.get(url, headers={"Accept": "text/turtle"}))
    panels = read_cockpit(triples, url).panels
    shown = {(each.kind and each.kind.value, each.shows[0].removeprefix(str(rover.base_url))) for each in panels}
    assert {
        ("picture", "topics/camera/image_raw"),
        ("drive", "topics/cmd_vel"),
        ("plot", "topics/odom"),
        ("value", "topics/odom"),
        ("value", "topics/battery_state"),
        ("value", "diagnostics"),
        ("button", "stop"),
        ("space", "space"),
    } <= shown
    entry = triples_of(rover.get("/", headers={"Accept": "text/turtle"}))
    assert NamedNode(url) in {each.object for each in entry}
    refused = rover.put("/cockpit/default", content="", headers=TURTLE)
    assert refused.status_code == 405
    assert "another name" in refused.json()["detail"]


def test_joints_are_plotted_and_transforms_drawn_and_a_topic_without_a_message_says_so(triples_of: Reader) -> None:
    robot = MadeUp()
    robot.topic("/joint_states", "sensor_msgs/msg/JointState", published=True, heard=False)
    robot.topic("/tf", "tf2_msgs/msg/TFMessage", published=True, heard=False)
    robot.topic("/words", "std_msgs/msg/String")
    with served(robot) as http:
        url = f"{http.base_url}cockpit/default"
        panels = read_cockpit(triples_of(http.get(url, headers={"Accept": "text/turtle"})), url).panels
        page = http.get(url, headers=PAGE).text
    shown = {each.kind and each.kind.value: (each.shows[0], each.fields) for each in panels}
    assert shown["plot"] == (f"{http.base_url}topics/joint_states", ("position",))
    assert shown["space"] == (f"{http.base_url}space", ())
    assert "No message received yet." in page
    assert "ros:Topic" not in page


def test_a_recording_that_does_not_tell_who_published_has_panels(
    start_server: Callable[..., Any], tmp_path: Path, triples_of: Reader
) -> None:
    types = get_typestore(Stores.ROS1_NOETIC)
    point = types.types["geometry_msgs/msg/Point"]
    with Writer(tmp_path / "walk.bag") as bag:
        topic = bag.add_connection("/walk/point", point.__msgtype__, typestore=types)
        bag.write(topic, 1_700_000_000_000_000_000, types.serialize_ros1(point(x=1.0, y=2.0, z=3.0), point.__msgtype__))
    served = start_server(str(tmp_path / "walk.bag"))
    url = f"{served.url}cockpit/default"
    panels = read_cockpit(triples_of(served.http.get(url, headers={"Accept": "text/turtle"})), url).panels
    assert [each.shows for each in panels] == [(f"{served.url}{path}",) for path in ("topics/walk/point", "faults/")]


def test_a_page_without_scripts_has_pictures_values_and_forms(rover: httpx.Client) -> None:
    until(lambda: re.search(VOLTAGE, rover.get("/cockpit/default", headers=PAGE).text), "a voltage")
    answer = rover.get("/cockpit/default", headers=PAGE)
    page = answer.text
    assert '<img src="/topics/camera/image_raw?format=jpeg&amp;width=960"' in page
    assert rover.get("/topics/camera/image_raw?format=jpeg&width=960").headers["content-type"] == "image/jpeg"
    assert 'name="linear.x"' in page
    assert 'action="/set_lights"' not in page
    assert 'action="/services/set_lights"' in page
    assert "style=" not in page
    assert answer.headers["content-security-policy"].startswith("default-src 'none'")
    sent = fields(page, "/services/set_lights")
    came_from = {"Referer": f"{rover.base_url}cockpit/default"}
    done = rover.post("/services/set_lights", data=sent | {"data": "true"}, headers=came_from)
    assert done.status_code == 303
    assert done.headers["location"].startswith(f"{rover.base_url}cockpit/default?receipt=")
    assert "set_lights" in rover.get(done.headers["location"], headers=PAGE).text


def test_a_copy_is_kept_changed_and_deleted_by_forms_with_versions(rover: httpx.Client, triples_of: Reader) -> None:
    page = rover.get("/cockpit/default", headers=PAGE).text
    made = rover.post("/cockpit/", data=fields(page, "/cockpit/") | {"name": "night watch"})
    assert made.status_code == 303
    url = made.headers["location"].partition("?")[0]
    assert url == f"{rover.base_url}cockpit/night-watch"
    before = read_cockpit(triples_of(rover.get(url)), url)
    assert len(before.panels) > 6

    stale = fields(rover.get(url, headers=PAGE).text, "")
    sent = stale | {"title": "Night", "panel.1.remove": "true", "panel.2.column": "5", "panel.2.row": "2"}
    sent |= {"panel.3.shows": "topics/imu#linear_acceleration.z", "panel.3.kind": "plot"}
    done = rover.post(url, data=sent)
    assert done.status_code == 303, done.text
    after = read_cockpit(triples_of(rover.get(url)), url)
    assert after.title == "Night"
    assert len(after.panels) == len(before.panels) - 1
    assert (after.panels[0].area.column, after.panels[0].area.row) == (5, 2)
    assert ("linear_acceleration.z",) in {each.fields for each in after.panels}
    assert rover.post(url, data=stale).status_code == 409
    wrong = rover.post(url, data=fields(rover.get(url, headers=PAGE).text, "") | {"panel.1.width": "40"})
    assert wrong.status_code == 422
    assert "panel.1.width" in wrong.text

    times = re.findall(r"at=[^>]+", rover.get(f"{url}?timemap").text)
    assert len(times) == 2
    former = triples_of(rover.get(f"{url}?{times[0]}", headers={"Accept": "text/turtle"}))
    assert read_cockpit(former, url).panels == before.panels
    assert "Night" in rover.get("/cockpit/", headers=PAGE).text
    assert rover.delete(url).status_code == 204
    assert rover.get(url).status_code == 410


def test_what_is_no_cockpit_is_refused_by_its_shape(rover: httpx.Client) -> None:
    panel = "<> a ros:Cockpit ; ros:hasPanel <#a> . <#a> a ros:PlotPanel ; ros:shows"
    for turtle, words in (
        (f'{panel} "topics/odom" .', "#a ros:shows"),
        (f"{panel} <b> ; ros:gridWidth 13 .", "1 to 12"),
        ("<> dcterms:title 'nothing' .", "describe a cockpit"),
        ("<> a ros:Cockpit ; ros:hasPanel " + ", ".join(f"<#{n}>" for n in range(10_000)) + " .", "60 panels"),
    ):
        answer = put(rover, "refused", turtle)
        assert answer.status_code == 422
        assert words in answer.text
        assert 'shapes/cockpit>; rel="http://www.w3.org/ns/ldp#constrainedBy"' in answer.headers["link"]


def test_what_is_not_there_is_told_in_words_and_nothing_of_others_is_embedded(rover: httpx.Client) -> None:
    panels = {
        "a": "a ros:ValuePanel ; ros:shows <../topics/nothing>",
        "b": f"a ros:PicturePanel ; ros:shows <{FOREIGN}/pixel.png>",
        "c": "a <http://example.org/Gauge> ; ros:shows <../topics/odom>",
        "d": "a ros:ValuePanel ; ros:shows <javascript:alert(1)>",
        "e": "a ros:PlotPanel ; ros:shows <../topics/odom> ; ros:fieldPath 'no.such'",
        "f": "a ros:QueryPanel ; ros:shows <../queries/inventory>",
        "g": "a ros:DrivePanel ; ros:shows <../topics/odom>",
        "h": "a ros:ButtonPanel ; ros:shows <../cockpit/words>",
        "i": "a ros:ValuePanel ; ros:shows <../style.css>",
        "j": "a ros:ValuePanel ; ros:shows <../cockpit/words> ; dcterms:title '<script>alert(1)</script>'",
        "k": "a ros:ValuePanel ; ros:shows <../topics/%2e%2e/x>",
    }
    body = "<> a ros:Cockpit ; ros:hasPanel " + ", ".join(f"<#{name}>" for name in panels) + " .\n"
    assert put(rover, "words", body + "\n".join(f"<#{n}> {said} ." for n, said in panels.items())).status_code == 201
    until(lambda: "<table>" in rover.get("/cockpit/words", headers=PAGE).text, "the rows of a query")
    page = rover.get("/cockpit/words", headers=PAGE)
    for words in (
        "There is no topic /nothing.",
        "is not on this robot",
        "Unknown panel type http://example.org/Gauge",
        "no field",
        "A cockpit can send only to the robot",
        "has no value to show",
        "&lt;script&gt;",
    ):
        assert words in page.text
    assert not re.search(rf'(src|data-motion|action)="[^"]*{FOREIGN}', page.text)
    assert 'href="javascript' not in page.text


def test_a_stopped_robot_is_not_driven_from_a_cockpit(rover: httpx.Client) -> None:
    assert "data-drive" in rover.get("/cockpit/default", headers=PAGE).text
    assert rover.post("/stop").status_code == 200
    try:
        page = rover.get("/cockpit/default", headers=PAGE).text
        assert "data-drive" not in page
        assert "cannot be driven until it is released" in page
        assert 'action="/services/' not in page
    finally:
        assert release(rover).status_code == 204


TOKEN = "token-of-pilot"
RULES = rule("anybody", "read", "/", "/style.css", "/cockpit/**", "/resources/**", "/services/**") + rule(
    "pilot", "read write control", "/**"
)


def test_who_may_not_read_or_write_sees_no_panel_and_no_form_of_it(serve: Callable[..., Any], tmp_path: Path) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text(f'[[token]]\nagent = "pilot"\nsha256 = "{token_digest(TOKEN)}"\n{RULES}')
    plane = serve("aircraft", "--auth", str(rules)).http
    page = plane.get("/cockpit/default", headers=PAGE).text
    assert "power" in page
    assert "/topics/" not in page.partition("<main")[2]
    assert "<form" not in page.partition("<main")[2]
    assert put(plane, "mine", "<> a ros:Cockpit .").status_code == 401
    own = {**PAGE, "Authorization": f"Bearer {TOKEN}"}
    page = plane.get("/cockpit/default", headers=own).text
    assert "/topics/aircraft/engine/speed" in page
    assert 'action="/cockpit/"' in page
