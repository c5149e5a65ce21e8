"""Graphviz reads the graph of a robot with any names, and finds the same vertices and edges."""

from __future__ import annotations

import json
import subprocess
from typing import Any

import pytest

from rosld.adapters.model import Endpoint, Graph, Node, Topic
from rosld.ontology.urls import Space
from rosld.server.diagrams.diagram import Diagram, Selection, Traffic, draw_graph
from rosld.server.diagrams.svg import write_dot
from tests.interop.missing import require

HOSTILE = ('/a"b', "/c\\N", "/d\\", "/<table>", "/e->f;", "/日本", "/g\nh", "/&amp;")


def read(dot: str) -> Any:
    """Return the layout by Graphviz, as JSON."""
    done = subprocess.run(["dot", "-Tjson"], input=dot.encode(), capture_output=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(autouse=True)
def graphviz() -> None:
    require("dot")


def test_the_graph_of_a_robot_is_laid_out(server: Any) -> None:
    told = server.http.get("/graph?all=true", headers={"Accept": "application/json"}).json()
    found = read(server.http.get("/graph?all=true", headers={"Accept": "text/vnd.graphviz"}).text)
    assert {each["URL"] for each in found["objects"]} == {each["url"] for each in told["vertices"]}
    urls = {each["_gvid"]: each["URL"] for each in found["objects"]}
    assert {(urls[each["tail"]], urls[each["head"]]) for each in found["edges"]} == {
        (each["source"], each["target"]) for each in told["edges"]
    }


def test_names_are_text_to_graphviz() -> None:
    topics = {name: Topic(name, (), (Endpoint("/n"),)) for name in HOSTILE}
    graph = Graph(1, nodes={"/n": Node("/n")}, topics=topics)
    diagram: Diagram = draw_graph(graph, Space("http://robot/"), Selection(), lambda _: Traffic(), lambda _: True)
    found = read(write_dot(diagram))
    assert len(found["objects"]) == len(HOSTILE) + 1
    assert len(found["edges"]) == len(HOSTILE)
