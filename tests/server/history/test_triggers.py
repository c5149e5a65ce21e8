"""Recordings triggered by a condition on a value, a goal or a mapping, once or repeatedly."""

from __future__ import annotations

import re
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any

import pyshacl
import pytest
import rdflib

from tests.crawl.description import Description
from tests.server.auth.conftest import token, tokens
from tests.server.history.test_recordings import MERGE_PATCH, ROS, SPEED, count, end, value
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
HTML = {"Accept": "text/html"}
POWER = "/resources/aircraft/power"
RPM = "/resources/aircraft/engine/speed"


@pytest.fixture(scope="module")
def armed(start_server: Callable[..., Any]) -> Any:
    """An aircraft with a history of one topic."""
    server = start_server("aircraft", "--history", SPEED)
    until(lambda: count(server.http, "/bags/history/") > 30, "a past")
    return server


def order(http: Any, name: str, **how: Any) -> Any:
    return http.post("/bags/", json={"name": name, "topics": [SPEED], **how}, headers=JSON)


def power(http: Any, is_on: bool) -> None:
    answer = http.post(f"/services/aircraft/{'start' if is_on else 'stop'}", json={})
    assert answer.status_code == 201, answer.text
    until(lambda: http.get(POWER, headers=JSON).json() == ("on" if is_on else "off"), "the power")


def test_a_recording_waits_for_a_condition_on_a_topic_and_begins_before_it(armed: Any) -> None:
    http = armed.http
    made = order(http, "fast", before=3600, trigger={"resource": f"/topics{SPEED}", "condition": "data < -1"})
    assert made.status_code == 201, made.text
    assert value(http, "/bags/fast/", "recordingStatus") == "armed"
    assert value(http, "/bags/fast/", "triggerCondition") == "data < -1"
    assert value(http, "/bags/fast/", "triggerCount") == "0"
    assert f"{armed.url}bags/fast/" in http.get("/bags/", headers={"Accept": "application/n-triples"}).text
    assert http.get("/bags/fast/messages/", headers=JSON).status_code == 404
    assert order(http, "fast").status_code == 409
    assert http.delete("/bags/fast/").status_code == 204
    assert http.get("/bags/fast/").status_code == 404
    made = order(http, "slow", before=3600, trigger={"resource": f"/topics{SPEED}", "condition": "data = 0"})
    assert made.status_code == 201
    until(lambda: value(http, "/bags/slow/", "recordingStatus") == "recording", "the trigger, which holds already")
    until(lambda: count(http, "/bags/slow/") > 30, "the past")
    end(http, "/bags/slow/")
    assert http.delete("/bags/slow/").status_code == 204


def test_a_trigger_begins_recordings_again_and_again_within_its_limit(armed: Any) -> None:
    http = armed.http
    trigger = {"resource": POWER, "condition": "value = 'on'", "limit": 2}
    assert order(http, "flight", duration=0.2, trigger=trigger).status_code == 201
    for number in (1, 2):
        power(http, is_on=True)
        path = f"/bags/flight-{number}/"
        until(lambda path=path: http.get(path).status_code == 200, "the recording")
        until(lambda path=path: value(http, path, "recordingStatus") is None, "its end")
        if number == 1:
            assert value(http, "/bags/flight/", "triggerCount") == "1"
            assert value(http, "/bags/flight/", "recordingStatus") == "armed"
        power(http, is_on=False)
    assert http.get("/bags/flight/").status_code == 404, "it waits no more"
    for number in (1, 2):
        assert http.delete(f"/bags/flight-{number}/").status_code == 204


def test_a_goal_that_ends_badly_triggers_a_recording(armed: Any) -> None:
    http = armed.http
    power(http, is_on=True)
    trigger = {"resource": "/resources/aircraft/fly/status", "condition": "value = 'canceled'"}
    assert order(http, "bad", trigger=trigger).status_code == 201
    goal = http.post("/actions/aircraft/fly", json={"distance": 90000})
    assert goal.status_code == 201
    assert value(http, "/bags/bad/", "recordingStatus") == "armed"
    http.delete(goal.headers["location"])
    until(lambda: value(http, "/bags/bad/", "recordingStatus") == "recording", "the trigger")
    assert http.delete("/bags/bad/").status_code == 204
    power(http, is_on=False)


def test_a_condition_of_a_mapping_triggers_a_recording_also_when_ordered_in_rdf(armed: Any) -> None:
    http = armed.http
    shape = f"{armed.url}mappings/aircraft#started"
    body = f'<> <{ROS}recordsTopic> "{SPEED}" ; <{ROS}name> "started" ; <{ROS}triggerShape> <{shape}> .'
    made = http.post("/bags/", content=body, headers={"Content-Type": "text/turtle"})
    assert made.status_code == 201, made.text
    assert value(http, "/bags/started/", "recordingStatus") == "armed"
    assert (
        f"<{ROS}triggerShape> <{shape}>" in http.get("/bags/started/", headers={"Accept": "application/n-triples"}).text
    )
    power(http, is_on=True)
    until(lambda: value(http, "/bags/started/", "recordingStatus") == "recording", "the trigger")
    assert http.delete("/bags/started/").status_code == 204
    power(http, is_on=False)


def test_what_a_recording_is_ordered_by_is_told_by_the_container_in_shacl_and_json_schema(armed: Any) -> None:
    http = armed.http
    shape, constrains = f"{armed.url}shapes/recording", 'rel="http://www.w3.org/ns/ldp#constrainedBy"'
    assert f"<{shape}>; {constrains}" in http.get("/bags/", headers=JSON).headers["link"]
    refused = http.post("/bags/", content="<> a <#T> .", headers={"Content-Type": "text/turtle"})
    assert refused.status_code == 422
    assert f"<{shape}>; {constrains}" in refused.headers["link"]
    graph = shacl_graph(http.get("/shapes/recording", headers={"Accept": "text/turtle"}).text, shape)
    trigger = f'<{ROS}triggerCondition> "data < -1" ; <{ROS}triggerResource> </topics{SPEED}>'
    named = f'<{ROS}name> "shaped" ; <{ROS}secondsBefore> 1'
    for body, fits in (
        (f'<> <{ROS}recordsTopic> "{SPEED}", "/camera/*" ; {named} ; {trigger} .', True),
        (f'<> <{ROS}recordsTopic> "aircraft" .', False),
        (f'<> <{ROS}recordsTopic> "*" ; <{ROS}secondsLong> -1 .', False),
        (f'<> <{ROS}recordsTopic> "*" ; <{ROS}name> "../x" .', False),
        (f'<> <{ROS}recordsTopic> "*" ; {trigger} ; <{ROS}triggerLimit> 101 .', False),
    ):
        data = rdflib.Graph().parse(data=body, format="turtle", publicID=f"{armed.url}bags/")
        assert pyshacl.validate(data, shacl_graph=graph)[0] is fits, body
        answer = http.post("/bags/", content=body, headers={"Content-Type": "text/turtle"})
        assert answer.status_code == (201 if fits else 422), answer.text
    assert http.delete("/bags/shaped/").status_code == 204
    description = Description(http.get("/openapi.json?below=/bags/").json())
    body = description.resolved(description.document["paths"]["/bags/"]["post"]["requestBody"])
    members = description.resolved(body["content"]["application/json"]["schema"])["properties"]
    of_cuts = {"of", "from", "to", "around", "after"}
    assert members.keys() == {"topics", "name", "before", "duration", "trigger", *of_cuts}
    assert all("description" in description.resolved(each) for each in members.values())


def shacl_graph(text: str, url: str) -> rdflib.Graph:
    return rdflib.Graph().parse(data=text, format="turtle", publicID=url)


EXTRA = """
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix av: <https://w3id.org/rosld/aircraft#> .
@prefix sh: <http://www.w3.org/ns/shacl#> .
<#extra> a map:ComplexResource ; map:path "/extra/" ; map:existsWhen <#odd> .
<#odd> a sh:NodeShape ; map:about "/aircraft/" ; sh:property [ sh:path av:power ; sh:hasValue "odd" ] .
"""


def test_a_recording_whose_condition_no_mapping_has_any_more_says_so_and_waits_again_once_one_has(armed: Any) -> None:
    http, turtle = armed.http, {"Content-Type": "text/turtle"}
    for again in (False, True):
        assert http.put("/mappings/extra", content=EXTRA, headers=turtle).status_code == 201
        if not again:
            made = order(http, "odd", trigger={"condition": f"{armed.url}mappings/extra#odd"})
            assert made.status_code == 201, made.text
        until(lambda: value(http, "/bags/odd/", "recordingStatus") == "armed", "the condition")
        assert http.delete("/mappings/extra").status_code == 204
        until(lambda: value(http, "/bags/odd/", "recordingStatus") == "suspended", "that the condition is gone")
        assert "No mapping has a condition" in str(value(http, "/bags/odd/", "recordingProblem"))
    assert http.delete("/bags/odd/").status_code == 204


def test_a_trigger_that_makes_no_sense_is_refused_and_says_why(armed: Any) -> None:
    triggers: list[Any] = [
        {"resource": POWER},
        {"condition": "value = 'on'"},
        {"resource": POWER, "condition": "value ="},
        {"resource": POWER, "condition": "speed > 3"},
        {"resource": "/nodes/aircraft", "condition": "value = 1"},
        {"resource": "/topics/none", "condition": "data = 1"},
        {"resource": "http://example.org/", "condition": "data = 1"},
        {"resource": POWER, "condition": "value = 'on'", "limit": 0},
        {"resource": POWER, "condition": "value = 'on'", "limit": 2},
        {"resource": POWER, "condition": "value = 'on'", "colour": "red"},
        "on",
    ]
    for trigger in triggers:
        answer = order(armed.http, "odd", trigger=trigger)
        assert answer.status_code == 422, (trigger, answer.text)
        detail = answer.json()["detail"]
        assert len(detail) > 20
        assert detail.count("is invalid") <= 1
    assert armed.http.get("/bags/odd/").status_code == 404


STATUS = f"<{ROS}recordingStatus>"
UPDATE = f'DELETE {{ ?b {STATUS} ?s }} INSERT {{ ?b {STATUS} "ended" }} WHERE {{ ?b {STATUS} ?s }}'
N3 = (
    "@prefix solid: <http://www.w3.org/ns/solid/terms#> . _:p a solid:InsertDeletePatch ; "
    f'solid:deletes {{ <> {STATUS} "recording" }} ; solid:inserts {{ <> {STATUS} "ended" }} .'
)


def test_a_patch_in_json_or_rdf_ends_a_recording(armed: Any) -> None:
    http = armed.http
    for media_type, body in (
        ("application/sparql-update", UPDATE),
        ("text/n3", N3),
        ("application/merge-patch+json", '{"status": "ended"}'),
    ):
        sent = {"Content-Type": media_type}
        assert order(http, "ending").status_code == 201
        assert media_type in http.options("/bags/ending/").headers["accept-patch"]
        odd = http.patch("/bags/ending/", content=body.replace("ended", "paused"), headers=sent)
        assert odd.status_code == 422, odd.text
        answer = http.patch("/bags/ending/", content=body, headers=sent)
        assert answer.status_code == 200, answer.text
        assert value(http, "/bags/ending/", "recordingStatus") is None
        assert http.delete("/bags/ending/").status_code == 204


def form(page: str, method: str) -> dict[str, str]:
    """Return the hidden fields of the page's form for a method."""
    for each in re.findall(r"<form.*?</form>", page.partition("<main")[2], re.DOTALL):
        hidden = dict(re.findall(r'<input type="hidden" name="([^"]+)" value="([^"]*)"', each))
        if hidden.get("method") == method:
            return {name: unescape(text) for name, text in hidden.items()}
    raise AssertionError(f"there is no form for {method}: {page[-3000:]}")


def test_a_person_begins_ends_and_deletes_a_recording_on_its_pages(armed: Any) -> None:
    http = armed.http
    page = http.get("/bags/", headers=HTML).text
    assert f'name="?choice" value="{SPEED}"' in page
    assert page.index('name="duration"') < page.index("<summary>More</summary>") < page.index('name="before"')
    hidden = form(page, "POST")
    filled = {**hidden, "name": "by-hand", "topics": "", "?choice": SPEED, "before": "0", "duration": "0",
              "trigger_resource": "", "trigger_condition": "", "trigger_limit": "1",
              "of": "", "from": "", "to": "", "around": "", "after": "0"}  # fmt: skip
    forged = http.post("/bags/", data={**filled, "name": "forged", "csrf": "x"}, headers=HTML, follow_redirects=False)
    assert forged.status_code == 403
    made = http.post("/bags/", data=filled, headers=HTML, follow_redirects=False)
    assert made.status_code == 303, made.text
    assert made.headers["location"].startswith(f"{armed.url}bags/by-hand/")
    until(lambda: count(http, "/bags/by-hand/") > 0, "a message")
    path = "/bags/by-hand/"
    assert value(http, path, "recordsTopic") == SPEED
    shown = http.get(path, headers=HTML).text
    assert "<bdi>End</bdi></button>" in shown
    assert ">Download</a>" not in shown
    with http.stream("GET", f"{path}?format=html&rate=3", headers={"Accept": "text/event-stream"}) as followed:
        lines = followed.iter_lines()
        assert any("Recording, until it is ended: " in line for line in lines)
        ended = http.post(path, data={**form(shown, "PATCH"), "status": "ended"}, headers=HTML, follow_redirects=False)
        assert ended.status_code == 303, ended.text
        assert any(
            'href="/bags/by-hand/file" rel="enclosure" class="button" download>Download</a>' in line for line in lines
        )
    assert value(http, path, "recordingStatus") is None
    delete_form = form(http.get(path, headers=HTML).text, "DELETE")
    gone = http.post(path, data=delete_form, headers=HTML, follow_redirects=False)
    assert gone.status_code == 303, gone.text
    assert http.get("/bags/by-hand/").status_code == 404
    odd = http.post("/bags/", data={**filled, "topics": "odom"}, headers=HTML, follow_redirects=False)
    assert odd.status_code == 422
    assert "begin with a slash" in odd.text


def test_who_may_not_read_a_value_may_not_wait_for_it(serve: Callable[..., Any], tmp_path: Path) -> None:
    auth = tmp_path / "auth.toml"
    rule = '[[rule]]\nagents = ["anna"]\nmodes = ["read", "write"]\npaths = ["/bags/**", "/topics/**"]\n'
    other = (
        '[[rule]]\nagents = ["ben"]\nmodes = ["read", "write"]\npaths = ["/bags/**", "/topics/aircraft/engine/speed"]\n'
    )
    auth.write_text(rule + other + tokens("anna", "ben"))
    http = serve("aircraft", "--auth", str(auth)).http
    page = http.get("/bags/", headers=HTML | {"Authorization": f"Bearer {token('ben')}"}).text
    assert re.findall(r'name="\?choice" value="([^"]*)"', page) == [SPEED]
    http.headers["Authorization"] = f"Bearer {token('anna')}"
    assert order(http, "x", trigger={"resource": POWER, "condition": "value = 'on'"}).status_code == 403
    shape = f"{http.base_url!s}mappings/aircraft#started"
    assert order(http, "x", trigger={"condition": shape}).status_code == 403
    assert order(http, "x", trigger={"resource": f"/topics{SPEED}", "condition": "data < -1"}).status_code == 201
    content = '{"status": "ended"}'
    assert http.patch("/bags/x/", content=content, headers=MERGE_PATCH).status_code == 204
    assert http.get("/bags/x/").status_code == 404
