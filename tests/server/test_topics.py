"""Topics over HTTP: read in every syntax, written by publishing."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import httpx
from pyoxigraph import NamedNode, Triple

from tests.server.conftest import Served
from tests.server.robots.asking import SYNTAXES
from tests.waiting import until

ROS = "https://w3id.org/rosld#"
TYPES = "https://w3id.org/rosld/types/"
Triples = Callable[[httpx.Response], set[Triple]]
SPEED = "/topics/aircraft/engine/speed"
DISPLAY = "/topics/cockpit/display"
JSON = {"Accept": "application/json"}
TURTLE = {"Content-Type": "text/turtle"}
STRING = f"{TYPES}std_msgs/msg/String"


def message(text: str) -> str:
    """Return a String message in Turtle."""
    return f"<#message> a <{STRING}> ; <{STRING}#data> {json.dumps(text)} ."


def test_a_topic_says_the_same_in_every_syntax_and_can_be_put_back_in_each(
    http: httpx.Client, triples_of: Triples
) -> None:
    http.put(DISPLAY, content=message("same"), headers=TURTLE)
    said = triples_of(http.get(DISPLAY, headers={"Accept": "text/turtle"}))
    for syntax in SYNTAXES:
        other = http.get(DISPLAY, headers={"Accept": syntax})
        assert other.headers["content-type"].startswith(syntax)
        assert triples_of(other) == said, syntax
        answer = http.put(DISPLAY, content=other.content, headers={"Content-Type": syntax})
        assert answer.status_code == 204, (syntax, answer.text)
        said = triples_of(http.get(DISPLAY, headers={"Accept": "text/turtle"}))
    assert http.get(DISPLAY, headers=JSON).json() == {"data": "same"}
    assert http.get(SPEED, headers={"Accept": "*/*"}).headers["content-type"].startswith("text/turtle")
    assert http.get(SPEED, headers=JSON).json() == {"data": 0.0}, "the message as ROS has it"


def test_a_topic_without_a_message_is_null_and_takes_no_patch(own_aircraft: httpx.Client) -> None:
    assert own_aircraft.get(DISPLAY, headers=JSON).text == "null"
    assert f"{ROS}latest" not in own_aircraft.get(DISPLAY).text
    headers = {"Content-Type": "application/merge-patch+json", "If-Match": "*"}
    assert own_aircraft.patch(DISPLAY, content='{"data": "x"}', headers=headers).status_code == 409


def test_the_latest_message_has_its_type_time_number_and_publisher(http: httpx.Client, triples_of: Triples) -> None:
    found = triples_of(http.get(SPEED))
    url = str(http.base_url.join(SPEED))
    node = NamedNode(f"{url}#message")
    about = {triple.predicate.value: triple.object for triple in found if triple.subject == node}
    assert about[f"{ROS}sentBy"] == NamedNode(str(http.base_url.join("/nodes/aircraft")))
    assert about[f"{ROS}received"].datatype.value.endswith("#dateTime")
    assert about[f"{TYPES}std_msgs/msg/Float64#data"].datatype.value.endswith("#double")


def test_patches_change_the_latest_message_and_need_if_match(http: httpx.Client) -> None:
    http.put(DISPLAY, json={"data": "one"})
    etag = http.get(DISPLAY).headers["etag"]
    merge = {"Content-Type": "application/merge-patch+json"}
    assert http.patch(DISPLAY, content='{"data": "two"}', headers=merge).status_code == 428
    assert http.patch(DISPLAY, content='{"data": "two"}', headers=merge | {"If-Match": etag}).status_code == 204
    assert http.patch(DISPLAY, content='{"data": "three"}', headers=merge | {"If-Match": etag}).status_code == 412
    assert http.get(DISPLAY, headers=JSON).json() == {"data": "two"}
    headers = {"Content-Type": "application/sparql-update", "If-Match": http.get(DISPLAY).headers["etag"]}
    data = f"<{STRING}#data>"
    update = f'DELETE {{ ?m {data} ?old }} INSERT {{ ?m {data} "swapped" }} WHERE {{ ?m {data} ?old }}'
    assert http.patch(DISPLAY, content=update, headers=headers).status_code == 204
    assert http.get(DISPLAY, headers=JSON).json() == {"data": "swapped"}


def test_the_name_and_type_that_the_server_states_may_be_repeated_but_not_changed(http: httpx.Client) -> None:
    same = f'<> <{ROS}name> "/cockpit/display" ; <{ROS}hasMessageType> <{STRING}> . {message("same")}'
    assert http.put(DISPLAY, content=same, headers=TURTLE).status_code == 204
    other = f'<> <{ROS}name> "/elsewhere" . {message("other")}'
    answer = http.put(DISPLAY, content=other, headers=TURTLE)
    assert answer.status_code == 409
    assert "constrainedBy" in answer.headers["link"]


def test_more_publishes_than_the_limit_are_429_with_retry_after(serve: Callable[..., Served]) -> None:
    served = serve("aircraft", "--max-publish-rate", "3")
    with ThreadPoolExecutor(10) as pool:
        answers = list(pool.map(lambda number: served.http.put(DISPLAY, json={"data": str(number)}), range(30)))
    codes = [answer.status_code for answer in answers]
    assert set(codes) == {204, 429}
    assert codes.count(204) >= 3
    assert {answer.headers["retry-after"] for answer in answers if answer.status_code == 429} == {"1"}
    assert served.http.get(DISPLAY).status_code == 200


def test_age_is_a_header_and_the_rate_is_in_the_rdf(http: httpx.Client, triples_of: Triples) -> None:
    answer = http.get(SPEED)
    assert int(answer.headers["age"]) <= 2

    def rates() -> list[float]:
        said = triples_of(http.get(SPEED))
        return [float(str(getattr(each.object, "value", ""))) for each in said if each.predicate.value == f"{ROS}rate"]

    assert until(rates, "a rate that was measured")[0] > 0.0
