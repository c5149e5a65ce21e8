"""Recordings played: a part as a separate robot, also from the history of another server; all topics at one moment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.adapters.recording.recorder import Line, write_rosbag1
from tests.server.history.test_recordings import ROS, SPEED
from tests.waiting import until

pytestmark = pytest.mark.slow

JSON = {"Accept": "application/json"}
NTRIPLES = {"Accept": "application/n-triples"}
START = "2023-11-14T22:13:20"
LINES = [
    Line(0.0, "/name", "a walk", "/walker", latched=True),
    Line(0.1, "/left", "1"),
    Line(0.2, "/right", "2"),
    Line(0.3, "/left", "3"),
    Line(0.4, "/left", "4", "/other"),
    Line(0.5, "/right", "5"),
]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write six lines of three topics."""
    return write_rosbag1(tmp_path_factory.mktemp("bags") / "walk.bag", LINES)


@pytest.fixture(scope="module")
def flown(start_server: Callable[..., Any], bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """An aircraft with a history on disk and an uploaded recording."""
    data = tmp_path_factory.mktemp("data")
    server = start_server("aircraft", "--history", "/aircraft/*", "--data", str(data))
    server.data = data
    assert server.http.put("/bags/walk", content=bag.read_bytes()).status_code == 201
    return server


def told(http: Any, path: str) -> dict[str, str]:
    """Return the texts of the topics, by name."""
    answer = http.get(path, headers=JSON)
    assert answer.status_code == 200, answer.text
    return {one["topic"]: one["message"]["data"] for one in answer.json()["messages"]}


def test_all_topics_of_a_recording_are_as_they_were_at_a_moment(flown: Any) -> None:
    name, expected = {"/name": "a walk"}, dict[str, dict[str, str]]()
    for second, left, right in (
        (".05", "", ""),
        (".1", "1", ""),
        (".35", "3", "2"),
        (".45", "4", "2"),
        (".9", "4", "5"),
    ):
        expected[second] = name | ({"/left": left} if left else {}) | ({"/right": right} if right else {})
    assert {each: told(flown.http, f"/bags/walk/at?time={START}{each}Z") for each in expected} == expected


def test_a_moment_is_the_same_in_every_representation_and_the_end_without_a_time(flown: Any) -> None:
    http = flown.http
    assert told(http, "/bags/walk/at") == {"/name": "a walk", "/left": "4", "/right": "5"}
    assert told(http, "/bags/walk/at?topic=/l*") == {"/left": "4"}
    text = http.get(f"/bags/walk/at?time={START}.35Z", headers=NTRIPLES).text
    assert text.count(f"<{ROS}newestRecord>") == 3
    assert set(http.get("/bags/walk/messages/3", headers=NTRIPLES).text.splitlines()) <= set(text.splitlines())
    page = http.get(f"/bags/walk/at?time={START}.35Z", headers={"Accept": "text/html"})
    assert page.status_code == 200
    assert '/bags/walk/messages/3"' in page.text
    assert told(http, "/bags/walk/at?time=1990-01-01T00:00:00Z") == {}
    for query, status in (("time=then", 400), ("topic=left", 400), ("topic=/none", 404)):
        refused = http.get(f"/bags/walk/at?{query}", headers=JSON)
        assert (refused.status_code, len(refused.json()["detail"]) > 20) == (status, True), query


def test_the_history_of_a_running_robot_has_moments_too(flown: Any) -> None:
    http = flown.http

    def moment() -> dict[str, Any]:
        found: dict[str, Any] = http.get("/bags/history/at?time=-0.2", headers=JSON).json()
        return found if SPEED in {one["topic"] for one in found.get("messages", ())} else {}

    until(moment, "the speed of a moment ago")
    answer = moment()
    for one in answer["messages"]:
        assert one["time"][:26].rstrip("Z") <= answer["time"][:26].rstrip("Z")
    speed = next(one for one in answer["messages"] if one["topic"] == SPEED)
    assert http.get(speed["url"], headers=JSON).json() == speed["message"]


def test_a_part_of_a_recording_is_a_robot_of_its_own(serve: Callable[..., Any], bag: Path) -> None:
    http = serve(f"{bag}?from=0.3&to={START}.45Z&rate=0.01", "--once").http
    messages = http.get("/bags/walk/messages/?limit=9", headers=JSON).json()["messages"]
    assert [(one["topic"], one.get("opening", False)) for one in messages] == [
        ("/name", True),
        ("/left", False),
        ("/left", False),
    ], "what was latched before opens it"
    assert http.get("/topics/left", headers=JSON).json() == {"data": "3"}, "it has only begun"
    assert http.get("/bags/walk/messages/2", headers=JSON).json() == {"data": "4"}


def test_a_part_of_a_history_that_was_kept_is_played_by_another_server(flown: Any, serve: Callable[..., Any]) -> None:
    http = flown.http
    path = f"/bags/history/messages/?topic={SPEED}&limit=1000"
    until(lambda: len(http.get(path, headers=JSON).json().get("messages", ())) > 10, "a past")
    assert flown.stop() == 0
    other = serve(f"{flown.data / 'history'}?from=0&rate=1").http
    found = other.get(path, headers=JSON).json()["messages"]
    assert len(found) > 10
    assert other.get(f"/topics{SPEED}", headers=JSON).status_code == 200
