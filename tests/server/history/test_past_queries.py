"""SPARQL over the past via HTTP: `docs/how-to/past.md` is true, third parties read the same, permissions apply."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest

from tests.server.auth.conftest import rule, token, tokens
from tests.server.history.mcap_files import decode, read
from tests.server.robots.made_up import MadeUp, Serving
from tests.waiting import once_started, until

pytestmark = pytest.mark.slow

CSV = {"Accept": "text/csv"}
TEXT = (Path(__file__).parents[3] / "docs" / "how-to" / "past.md").read_text("utf-8")
EXAMPLE = re.compile(r"^\*\*(\d+)\. (.*?)\*\*.*?```sparql\n(.*?)```\n\n```csv\n(.*?)```\n", re.DOTALL | re.MULTILINE)
EXAMPLES = {number: (query, printed) for number, _, query, printed in EXAMPLE.findall(TEXT)}
RULES = (
    rule("anna", "read write control administer", "/**")
    + rule("guest", "read", "/sparql", "/bags/**", "/topics/**")
    + rule("guest", "read", "/topics/battery_state", deny=True)
    + rule("stranger", "read", "/sparql", "/topics/**")
)


class Driven(NamedTuple):
    """A rover that was driven until its battery was low: its client, and its recording as read by third parties."""

    url: str
    http: httpx.Client
    messages: dict[str, list[Any]]


@pytest.fixture(scope="module")
def driven(start_server: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory) -> Driven:
    """Do the steps of the document."""
    folder = tmp_path_factory.mktemp("driven")
    (folder / "auth.toml").write_text(RULES + tokens("anna", "guest", "stranger"))
    served = start_server("rover:?battery=0.202", "--history", "*", "--auth", str(folder / "auth.toml"))
    http = served.http
    http.headers["Authorization"] = f"Bearer {token('anna')}"
    seen = "SELECT (COUNT(*) AS ?n) WHERE { </topics/%s> ros:past ?message }"
    until(lambda: int(ask(http, seen % "odom")[1][0]) > 20, "some odometry")
    answer = http.put("/topics/cmd_vel", json={"linear": {"x": 0.3}, "angular": {"z": 0.4}})
    assert answer.status_code == 204, answer.text
    until(lambda: len(ask(http, EXAMPLES["2"][0])) > 1, "a low battery")
    until(lambda: len(ask(http, EXAMPLES["3"][0])) > 1 and len(ask(http, EXAMPLES["5"][0])) > 1, "a movement")
    http.put("/topics/cmd_vel", json={})
    http.post("/bags/", json={"name": "drive", "topics": ["*"], "before": 600, "duration": 0.5})
    until(lambda: http.get("/bags/drive/messages/0").status_code == 200, "the recording")
    path = folder / "drive.mcap"
    path.write_bytes(http.get("/bags/drive/file").content)
    messages: dict[str, list[Any]] = {}
    for one, (topic, message) in zip(sorted(read(path), key=lambda one: one.time_ns), decode(path), strict=True):
        assert one.topic == topic
        messages.setdefault(topic, []).append(message)
    return Driven(served.url, http, messages)


def ask(http: httpx.Client, query: str, **headers: str) -> list[list[str]]:
    answer = http.post("/sparql", data={"query": query}, headers=CSV | headers)
    assert answer.status_code == 200, answer.text
    return list(csv.reader(io.StringIO(answer.text)))


def refusal(http: httpx.Client, query: str, status: int) -> str:
    answer = http.post("/sparql", data={"query": query}, headers={"Accept": "application/problem+json, text/csv;q=0.5"})
    assert answer.status_code == status, answer.text
    return str(answer.json()["detail"])


def test_the_ten_examples_answer_as_printed(driven: Driven) -> None:
    assert list(EXAMPLES) == [str(number) for number in range(1, 11)]
    for number, (query, printed) in EXAMPLES.items():
        expected = list(csv.reader(io.StringIO(printed)))
        found = ask(driven.http, query)
        assert found[0] == expected[0], number
        assert len(found) > 1, number
        assert all(len(row) == len(found[0]) and all(row) for row in found[1:]), number
        shapes = {tuple(map(kind, row)) for row in found[1:]}
        assert shapes & {tuple(map(kind, row)) for row in expected[1:]}, number


def kind(value: str) -> str:
    """Return the kind of a value by its form."""
    if re.fullmatch(r"-?[0-9.eE+-]+", value):
        return "number"
    return "time" if re.match(r"\d{4}-", value) else "duration" if value.startswith("PT") else "term"


def test_examples_come_to_what_others_read_in_the_recording(driven: Driven) -> None:
    odometry, transforms = driven.messages["/odom"], driven.messages["/tf"] + driven.messages["/tf_static"]
    fastest, east, north, count = map(float, ask(driven.http, EXAMPLES["9"][0])[1])
    assert fastest == max(each.twist.twist.linear.x for each in odometry)
    assert east == max(each.pose.pose.position.x for each in odometry)
    assert north == max(each.pose.pose.position.y for each in odometry)
    assert count == len(odometry)
    children = [transform.child_frame_id for message in transforms for transform in message.transforms]
    rows = ask(driven.http, EXAMPLES["10"][0])[1:]
    assert {row[0]: int(row[1]) for row in rows} == {child: children.count(child) for child in children}
    least = "SELECT (MIN(?p) AS ?least) { </topics/battery_state> ros:past ?m . ?m ros:recordedIn </bags/drive/> ; "
    least += "<https://w3id.org/rosld/types/sensor_msgs/msg/BatteryState#percentage> ?p }"
    charges = [each.percentage for each in driven.messages["/battery_state"]]
    assert float(ask(driven.http, least)[1][0]) == pytest.approx(min(charges))


def test_nobody_is_told_of_messages_that_they_may_not_read(driven: Driven) -> None:
    topics = "SELECT DISTINCT ?topic WHERE { ?topic ros:past ?message }"
    mine = {row[0] for row in ask(driven.http, topics)[1:]}
    theirs = {row[0] for row in ask(driven.http, topics, Authorization=f"Bearer {token('guest')}")[1:]}
    assert mine - theirs == {f"{driven.url}topics/battery_state"}
    assert theirs
    named = EXAMPLES["1"][0].replace("(MIN(?charge) AS ?least) (COUNT(*) AS ?messages)", "*")
    assert len(ask(driven.http, named)) > 1
    assert len(ask(driven.http, named, Authorization=f"Bearer {token('guest')}")) == 1
    senders = "SELECT ?by WHERE { </topics/odom> ros:past ?message . ?message ros:sentBy ?by }"
    assert len(ask(driven.http, senders)) > 1
    assert len(ask(driven.http, senders, Authorization=f"Bearer {token('guest')}")) == 1, "nodes are hidden"
    assert len(ask(driven.http, topics, Authorization=f"Bearer {token('stranger')}")) == 1, "recordings are hidden"


def test_a_recording_whose_first_message_is_denied_tells_of_the_others(
    robot: MadeUp, serving: Serving, tmp_path: Path
) -> None:
    (tmp_path / "auth.toml").write_text(RULES + tokens("anna", "guest"))
    for name in ("/battery_state", "/open"):
        robot.topic(name, "std_msgs/msg/String")
    http = serving(auth=tmp_path / "auth.toml", history=("*",), data=tmp_path / "data")
    anna, guest = ({"Authorization": f"Bearer {token(name)}"} for name in ("anna", "guest"))
    query = "SELECT ?topic WHERE { ?topic ros:past ?message }"

    def topics(agent: dict[str, str]) -> list[str]:
        return [row[0].rpartition("/")[2] for row in ask(http, query, **agent)[1:]]

    until(lambda: robot.subscribed() >= {"/battery_state", "/open"}, "the history")
    robot.publishes("/battery_state", {"data": "first"})
    until(lambda: topics(anna) == ["battery_state"], "the first message")
    robot.publishes("/open", {"data": "second"})
    until(lambda: len(topics(anna)) == 2, "the second message")
    assert topics(guest) == ["open"]


def test_what_cannot_be_asked_of_the_past_says_how_it_can(driven: Driven) -> None:
    for query, words in (
        ("SELECT * { GRAPH ?g { ?topic ros:past ?m } }", "GRAPH"),
        ("SELECT * { ?topic ros:past ?m . ?m ros:recordedIn </bags/lost/> }", "no recording"),
        ("SELECT * FROM </topics/odom> { ?topic ros:past ?m }", "FROM </bags/history/>"),
    ):
        assert words in refusal(driven.http, query, 400)


def test_a_query_out_of_time_says_what_was_large_and_how_to_join(driven: Driven) -> None:
    pairs = "</topics/odom> ros:past ?one , ?other , ?third , ?fourth . </topics/imu> ros:past ?fifth , ?sixth ."
    data = {"query": f"SELECT (COUNT(*) AS ?n) {{ {pairs} }}", "timeout": "0.3"}
    accept = {"Accept": "text/csv, application/problem+json"}
    answer = once_started(lambda: driven.http.post("/sparql", data=data, headers=accept))
    assert (answer.status_code, answer.json()["reason"]) == (503, "time")
    assert re.search(r"\d+ of /odom", answer.json()["detail"])
    assert "ros:asOf" in answer.json()["detail"]


def test_a_message_in_time_needs_a_variable_and_is_nil_before_the_first(driven: Driven) -> None:
    words = refusal(driven.http, "SELECT * { FILTER(ros:asOf(</topics/odom>, NOW()) = ?m) }", 400)
    assert "BIND(ros:asOf(" in words
    early = '"2000-01-01T00:00:00Z"^^xsd:dateTime'
    query = f"SELECT * {{ BIND(ros:asOf(</topics/odom>, {early}) AS ?m) OPTIONAL {{ ?m ros:received ?t }} }}"
    assert ask(driven.http, query)[1] == ["http://www.w3.org/1999/02/22-rdf-syntax-ns#nil", ""]
    assert "ros:sqrt" in refusal(driven.http, "SELECT (ros:sqrt(4) AS ?x) {}", 400)
    assert "HAVING" in refusal(driven.http, "SELECT * { FILTER(ros:median(?x) > 4) }", 400)


def test_a_topic_that_a_recording_lacks_is_no_empty_answer_and_the_history_is_none_of_its_remedies(
    driven: Driven,
) -> None:
    made = driven.http.post("/bags/", json={"name": "narrow", "topics": ["/odom"], "before": 60, "duration": 0})
    assert made.status_code == 201, made.text
    until(lambda: driven.http.get("/bags/narrow/messages/0").status_code == 200, "the recording")
    words = refusal(driven.http, "SELECT * { </topics/imu> ros:past ?m . ?m ros:recordedIn </bags/narrow/> }", 400)
    assert f"/imu is not recorded in <{driven.url}bags/narrow/>" in words
    assert "--history" not in words


def test_from_says_which_recording_is_meant(driven: Driven) -> None:
    for name in ("drive", "history"):
        found = ask(driven.http, f"SELECT ?m FROM </bags/{name}/> {{ </topics/odom> ros:past ?m }}")
        assert found[1][0].startswith(f"{driven.url}bags/{name}/messages/")


def test_an_update_does_not_read_the_past(driven: Driven) -> None:
    text = "INSERT { GRAPH </data/x> { ?m ros:sequence 1 } } WHERE { ?topic ros:past ?m }"
    answer = driven.http.post("/sparql", content=text, headers={"Content-Type": "application/sparql-update"})
    assert answer.status_code == 400
    assert "ros:past is not allowed in updates" in answer.text


def test_where_nothing_is_recorded_a_query_is_told_how_to_record(http: httpx.Client, serve: Callable[..., Any]) -> None:
    assert "--history" in refusal(http, "SELECT * { ?topic ros:past ?m }", 400)
    other = serve("aircraft", "--history", "/nothing").http
    words = refusal(other, "SELECT * { </topics/aircraft/engine/speed> ros:past ?m }", 400)
    assert "--history /aircraft/engine/speed" in words
