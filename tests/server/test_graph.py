"""The computation graph at /graph: the same edges in every form, for agents that may see them."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest
from rdflib import RDFS, Graph, URIRef

from rosld.adapters.base import AdapterOptions
from rosld.adapters.registry import adapter_for
from tests.server.robots.made_up import served
from tests.waiting import until

ROS = "https://w3id.org/rosld#"
EDGES = f"""PREFIX ros: <{ROS}>
SELECT ?subject ?predicate ?object WHERE {{
  VALUES ?predicate {{ ros:publishes ros:subscribes ros:provides ros:sendsGoalsTo }}
  ?node a ros:Node . ?subject ?predicate ?object . FILTER(?subject = ?node) }}"""
FORWARD = {"publishes", "sendsGoalsTo"}


@pytest.fixture(scope="module")
def rover() -> Iterator[httpx.Client]:
    with served(adapter_for("rover", AdapterOptions())) as client:
        yield client


def get(http: httpx.Client, path: str = "graph", accept: str = "*/*", **headers: str) -> httpx.Response:
    return http.get(path, headers={"Accept": accept, **headers})


@pytest.mark.slow
def test_each_form_has_the_edges_that_a_query_finds(rover: httpx.Client) -> None:
    answer = rover.post("sparql", data={"query": EDGES}, headers={"Accept": "application/sparql-results+json"})
    rows = answer.json()["results"]["bindings"]
    found = {tuple(row[name]["value"] for name in ("subject", "predicate", "object")) for row in rows}
    assert len(found) >= 14
    turtle = Graph().parse(data=get(rover, "graph?all=true").text, format="turtle")
    said = {tuple(map(str, each)) for each in turtle if str(each[1]).startswith(ROS)}
    assert said == found
    expected = {
        (subject, object) if predicate.removeprefix(ROS) in FORWARD else (object, subject)
        for subject, predicate, object in found
    }
    told = get(rover, "graph?all=true", "application/json").json()
    assert {(each["source"], each["target"]) for each in told["edges"]} == expected
    dot = get(rover, "graph?all=true", "text/vnd.graphviz").text
    urls = dict(re.findall(r'^  "([^"]+)" \[.*URL="([^"]+)"', dot, re.MULTILINE))
    arrows = re.findall(r'^  "([^"]+)" -> "([^"]+)"', dot, re.MULTILINE)
    assert {(urls[source], urls[target]) for source, target in arrows} == expected


def test_it_is_negotiated_and_has_a_tag(rover: httpx.Client) -> None:
    browser = "text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,image/webp,*/*;q=0.8"
    for accept, media_type in (
        ("image/svg+xml", "image/svg+xml"), ("text/vnd.graphviz", "text/vnd.graphviz"), ("*/*", "text/turtle"),
        (browser, "text/html"), ("image/svg+xml;q=0.1, text/turtle;q=0.2", "text/turtle"),
    ):  # fmt: skip
        answer = get(rover, accept=accept)
        assert answer.headers["content-type"].partition(";")[0] == media_type
    drawing = get(rover, "graph?format=svg")
    assert "default-src 'none'" in drawing.headers["content-security-policy"]
    links = [each.get("href") for each in ElementTree.fromstring(drawing.text).iter() if each.tag.endswith("}a")]
    assert {"/nodes/rover", "/topics/cmd_vel", "/services/dock", "/actions/navigate_to"} <= set(links)

    def is_unchanged() -> bool:
        tag = get(rover, "graph?format=svg").headers["etag"]
        return get(rover, "graph?format=svg", **{"If-None-Match": tag}).status_code == 304

    until(is_unchanged, "two moments between which no node comes or goes")
    assert get(rover, "graph?below=camera").status_code == 400
    assert get(rover, "graph?format=gif").status_code == 406


def test_a_part_of_it_is_drawn_and_described(rover: httpx.Client) -> None:
    turtle = Graph().parse(data=get(rover, "graph?below=/camera").text, format="turtle")
    topics = {str(each).rpartition("/topics")[2] for each in turtle.objects(None, URIRef(f"{ROS}publishes"))}
    assert topics == {"/camera/image_raw", "/camera/image_raw/compressed", "/camera/camera_info"}
    page = get(rover, "graph?below=/camera", "text/html").text
    assert "below <bdi>/camera</bdi>" in page
    assert page.count("<rect") == 4


@pytest.mark.slow
def test_red_is_only_what_is_wrong_and_all_forms_say_the_same(robot: Any, serving: Any, monkeypatch: Any) -> None:
    robot.topics(["/unheard", "/recorded", "/steady", "/spoken"], "std_msgs/msg/String")
    robot.topic("/wished", "std_msgs/msg/String", published=False, heard=True)
    monkeypatch.setattr("rosld.server.robot.topic_view._LEAST_NS", 1)  # of a rate that is measured immediately
    http = serving()
    for name in ("recorded", "steady"):
        get(http, f"topics/{name}", "application/json")
    for _ in range(12):
        robot.publishes("/steady", {"data": ""})
        get(http, "topics/steady", "application/json")
        time.sleep(0.03)  # a rate is measured over 0.2 s at least
    monkeypatch.setattr("rosld.server.resources.graph.STALE_SECONDS", 0.0)
    vertices = {each["name"]: each for each in get(http, accept="application/json").json()["vertices"]}
    assert {name for name, each in vertices.items() if each.get("unheard")} == {"/unheard", "/spoken"}
    problems = {name: each["problem"] for name, each in vertices.items() if "problem" in each}
    assert problems.keys() == {"/wished", "/steady"}
    assert problems["/wished"] == "silent: no publishers"
    assert problems["/steady"].startswith("went silent: no message since 20")
    turtle = Graph().parse(data=get(http).text, format="turtle")
    said = {str(thing).rpartition("/topics")[2]: str(words) for thing, words in turtle.subject_objects(RDFS.comment)}
    assert said == problems
    page = get(http, accept="text/html").text
    assert page.count('class="vertex topic bad"') == 2
    assert page.count('class="error"') == 2
    drawing = get(http, "graph?format=svg").text
    assert (drawing.count('topic bad"'), drawing.count('topic unheard"')) == (2, 2)
    robot.publishes("/steady", {"data": ""})
    monkeypatch.undo()
    assert "went silent" not in get(http, accept="text/html").text
