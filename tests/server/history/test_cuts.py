"""Cuts over HTTP: recordings of a part of a recording or of the history, and around events."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.runs import START_NS
from tests.server.auth.conftest import rule, token, tokens
from tests.server.cli.test_recording_commands import Message, messages, write_latched
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
SPEED = "/aircraft/engine/speed"
MODES = "read write"


@pytest.fixture(scope="module")
def served(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Any:
    """An aircraft with a history and an uploaded recording, for one agent who may not read its topic /speed."""
    folder = tmp_path_factory.mktemp("cuts")
    auth = folder / "auth.toml"
    rules = rule("anna", MODES, "/**") + rule("ben", MODES, "/bags/**") + rule("ben", "read", "/topics/description")
    auth.write_text(rules + tokens("anna", "ben"))
    server = start_server("aircraft", "--history", SPEED, "--auth", str(auth))
    server.http.headers["Authorization"] = f"Bearer {token('anna')}"
    server.file = write_latched(folder / "run.bag")
    assert server.http.put("/bags/run", content=server.file.read_bytes()).status_code == 201
    return server


def cut(served: Any, tmp_path: Path, url: str) -> list[Message]:
    """Return the messages of a recording as its file has them."""
    path = tmp_path / f"{time.monotonic_ns()}.mcap"
    path.write_bytes(served.http.get(f"{url}file").content)
    return list(messages(path))


def test_a_part_of_a_recording_is_a_recording_that_stands_alone(served: Any, tmp_path: Path) -> None:
    order = {"name": "part", "of": "run", "from": 3, "to": "2023-11-14T22:13:25Z"}
    made = served.http.post("/bags/", json=order, headers=JSON)
    assert (made.status_code, made.headers["location"]) == (201, f"{served.url}bags/part/")
    whole, start, end = list(messages(served.file)), START_NS + 3_000_000_000, START_NS + 5_000_000_000
    within = [each for each in whole if start <= each[1] <= end]
    opening = ("/description", start, whole[0][2])
    assert cut(served, tmp_path, made.headers["location"]) == sorted([opening, *within])
    listed = served.http.get("/bags/part/messages/?limit=1", headers=JSON).json()["messages"]
    assert [(each["topic"], each["opening"]) for each in listed] == [("/description", True)]
    again = served.http.post("/bags/", json={**order, "from": 4}, headers=JSON)
    assert again.status_code == 409


@pytest.mark.parametrize(
    "around",
    ["speed.data >= 49", "SELECT ?m ?at { ?m ros:recordedIn <bags/run/> . <topics/speed> ros:past ?m . %s }"],
)
def test_each_event_is_a_recording(served: Any, tmp_path: Path, around: str) -> None:
    if "%s" in around:
        number = "https://w3id.org/rosld/types/std_msgs/msg/Float64#data"
        around %= f"?m ros:received ?at ; <{number}> ?n FILTER(?n > 48.5)"
    name = f"top{len(around)}"
    order = {"name": name, "of": "run", "around": around, "before": 0.5, "after": 0.25, "topics": ["/speed"]}
    made = served.http.post("/bags/", json=order, headers=JSON)
    assert (made.status_code, made.headers["location"]) == (201, f"{served.url}bags/{name}-1/"), made.text
    assert [len(cut(served, tmp_path, f"/bags/{name}-{number}/")) for number in (1, 2)] == [8, 6]


def test_the_history_is_cut_too(served: Any, tmp_path: Path) -> None:
    until(lambda: served.http.get("/bags/history/messages/20").status_code == 200, "a past")
    listed = served.http.get("/bags/history/messages/?start=5&limit=11", headers=JSON).json()["messages"]
    order = {"of": "history", "from": listed[0]["time"], "to": listed[-1]["time"]}
    made = served.http.post("/bags/", json=order, headers=JSON)
    assert made.status_code == 201, made.text
    assert len(cut(served, tmp_path, made.headers["location"])) == 11


def test_what_cannot_be_cut_is_refused_and_says_why(served: Any) -> None:
    for order, words in (
        ({"of": "nothing"}, "There is no recording nothing"),
        ({"of": 3}, "of must be the name"),
        ({"of": "run", "from": "soon"}, "from=soon is neither a time"),
        ({"of": "run", "from": 5, "to": 3}, "From is after to"),
        ({"of": "run", "from": 500}, "no messages of these topics"),
        ({"of": "run", "duration": 3}, "duration is unknown for a cut"),
        ({"of": "run", "around": "speed.date > 1"}, "no field 'date'"),
        ({"of": "run", "around": "speed.data > 100"}, "Nothing was found"),
        ({"of": "run", "around": "SELECT ?m { ?m a ros:Bag }"}, "xsd:dateTime"),
        ({"of": "run", "topics": ["/speed"], "from": 500}, "no messages"),
    ):
        answer = served.http.post("/bags/", json=order, headers=JSON)
        assert (answer.status_code, words in answer.json()["detail"]) == (422, True), answer.text
    page = served.http.get("/bags/", headers={"Accept": "text/html"}).text
    assert 'name="around"' in page


def test_a_cut_has_only_topics_that_the_agent_may_read(served: Any, tmp_path: Path) -> None:
    ben = {**JSON, "Authorization": f"Bearer {token('ben')}"}
    made = served.http.post("/bags/", json={"name": "bens", "of": "run", "to": 3}, headers=ben)
    assert made.status_code == 201, made.text
    assert {each[0] for each in cut(served, tmp_path, "/bags/bens/")} == {"/description"}
    for order in ({"topics": ["/speed"]}, {"around": "speed.data > 48"}):
        assert served.http.post("/bags/", json={"of": "run", **order}, headers=ben).status_code == 403


def test_a_server_of_a_recording_cuts_but_does_not_record(serve: Callable[..., Any], tmp_path: Path) -> None:
    server = serve(str(write_latched(tmp_path / "run.bag")))
    made = server.http.post("/bags/", json={"of": "run", "to": 1, "topics": ["/speed"]}, headers=JSON)
    assert made.status_code == 201, made.text
    assert len(cut(server, tmp_path, made.headers["location"])) == 11
    refused = server.http.post("/bags/", json={"topics": ["*"]}, headers=JSON)
    assert (refused.status_code, "nothing live to record" in refused.json()["detail"]) == (422, True)
