"""Parameters with an empty part in their name, which ROS 1 permits (`setParam('/dict', {'': 2})`): nothing breaks."""

from __future__ import annotations

import pytest

from rosld.adapters.model import ParameterValue
from tests.server.robots.made_up import MadeUp, Serving

TREE: dict[str, ParameterValue] = {"": 2, "ok": 1, "tree": {"": {"inner": 3}}, "%": 4, "{x}": 5, " ": 6, "a/b": 7}
EVERYWHERE = (
    "/", "/openapi.json", "/openapi.json?hidden=true", "/parameters/", "/parameters/dict/", "/resources/", "/graphs",
    "/graphs?default", "/.well-known/wot", "/resources/dict/", "/parameters/dict/ok",
)  # fmt: skip


@pytest.mark.slow
def test_a_parameter_with_an_empty_key_breaks_nothing_and_the_others_are_found(robot: MadeUp, serving: Serving) -> None:
    robot.parameter("/dict", TREE)
    http = serving()
    for path in EVERYWHERE:
        for accept in ("*/*", "text/turtle", "application/json", "text/html"):
            answer = http.get(path, headers={"Accept": accept})
            assert answer.status_code in (200, 406), (path, accept, answer.text)
    paths = http.get("/openapi.json").json()["paths"]
    assert "/parameters/dict/ok" in paths
    assert not [path for path in paths if path.startswith("/parameters/") and "~" in path]
    query = "SELECT ?n { ?p a ros:Parameter ; ros:name ?n ; ros:value ?v }"
    rows = http.post("/sparql", data={"query": query}, headers={"Accept": "text/csv"})
    assert "/dict/ok" in rows.text
