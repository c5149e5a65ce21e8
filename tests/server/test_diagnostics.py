"""Diagnostics at /diagnostics: states and messages, the worst first, live, with their history if it is recorded."""

from __future__ import annotations

import time
from typing import Any

import pytest
from rdflib import Graph, Namespace

from rosld.server.robot.diagnostic_states import DiagnosticState, Level, LevelTimes, changes_of, state_at, worst_first
from tests.waiting import until

ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
JSON = {"Accept": "application/json"}
STATUS = Namespace("https://w3id.org/rosld/types/diagnostic_msgs/msg/DiagnosticStatus#")


def said(*parts: tuple[str, int, str]) -> dict[str, Any]:
    """Return a DiagnosticArray of parts: name, level, message."""
    status = [
        {"level": level, "name": name, "message": message, "hardware_id": f"hw-{name}",
         "values": [{"key": "volts", "value": "12.1"}, {"key": "<i>", "value": "</dd>"}]}
        for name, level, message in parts
    ]  # fmt: skip
    return {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}, "status": status}


def test_the_worst_comes_first_whoever_said_it_and_is_found_in_every_form(robot: Any, serving: Any) -> None:
    robot.topic("/diagnostics", ARRAY, said(("drive", 0, "fine"), ("battery", 1, "low"), ("arm", 2, "jammed")))
    robot.topic("/more/diagnostics", ARRAY, said(("eye", 3, "blind")))
    http = serving()
    found = http.get("diagnostics", headers=JSON).json()["states"]
    assert [(each["name"], each["level"]) for each in found] == [
        ("arm", "ERROR"), ("eye", "STALE"), ("battery", "WARN"), ("drive", "OK")
    ]  # fmt: skip
    assert found[0]["values"] == {"volts": "12.1", "<i>": "</dd>"}
    assert (found[0]["hardware"], found[0]["topic"]) == ("hw-arm", f"{http.base_url}topics/diagnostics")
    robot.publishes("/diagnostics", said(("battery", 2, "empty")))
    again = until(
        lambda: (told := http.get("diagnostics", headers=JSON).json()["states"])[0]["name"] == "battery" and told,
        "the newest error first",
    )
    assert [each["name"] for each in again] == ["battery", "arm", "eye", "drive"]  # folded: the other parts remain
    turtle = Graph().parse(data=http.get("diagnostics").text, format="turtle")
    told = turtle.subject_objects(STATUS["level"])
    levels = {(str(turtle.value(node, STATUS["name"])), int(str(level))) for node, level in told}
    assert levels == {("battery", 2), ("arm", 2), ("eye", 3), ("drive", 0)}
    page = http.get("diagnostics", headers={"Accept": "text/html"}).text
    assert page.index("battery") < page.index("eye") < page.index("drive")
    assert page.count('<span class="level error">Error</span>') == 2
    assert "&lt;i&gt;" in page
    assert "<i>" not in page
    one = http.get("diagnostics?name=arm", headers={"Accept": "text/html"}).text
    assert "It is not recorded" in one
    assert http.get("diagnostics?name=leg").status_code == 404


def test_a_robot_without_diagnostics_says_so(serving: Any) -> None:
    http = serving()
    assert http.get("diagnostics", headers=JSON).json() == {"states": []}
    assert "no topic has the type" in http.get("diagnostics", headers={"Accept": "text/html"}).text


def test_what_a_part_said_before_is_told_where_it_is_recorded(robot: Any, serving: Any) -> None:
    robot.topic("/diagnostics", ARRAY, said(("arm", 0, "fine")))
    http = serving(history=("/diagnostics",))
    until(lambda: http.get("bags/history/", headers=JSON).status_code == 200, "the history")
    for level, message in ((0, "fine"), (1, "warm"), (1, "warm"), (2, "<hot>"), (0, "fine")):
        robot.publishes("/diagnostics", said(("arm", level, message)))

        def is_heard(level: int = level, message: str = message) -> bool:
            told = http.get("diagnostics?name=arm", headers=JSON).json()
            newest = told.get("changes", [{}])[0]
            return (newest.get("level"), newest.get("message")) == (Level(level).name, message)

        until(is_heard, f"{message} among the changes")
    changes = http.get("diagnostics?name=arm", headers=JSON).json()["changes"]
    assert [each["level"] for each in changes][:4] == ["OK", "ERROR", "WARN", "OK"]
    page = http.get("diagnostics?name=arm", headers={"Accept": "text/html"}).text
    assert "&lt;hot&gt;" in page


def state(name: str, level: Level, received: float = 0.0, message: str = "") -> DiagnosticState:
    return DiagnosticState("/diagnostics", name, "", level, message, (), int(received * 1e9), level)


@pytest.mark.parametrize(
    ("silent", "period", "is_stale"), [(4.9, 1, False), (5.1, 1, True), (20, 10, False), (31, 10, True)]
)
def test_a_part_is_stale_once_it_has_been_silent(silent: float, period: float, is_stale: bool) -> None:
    judged = state_at(state("a", Level.OK, 100.0), int((100 + silent) * 1e9), period)
    assert (judged.level is Level.STALE) == is_stale
    assert judged.reported_level is Level.OK


def test_a_level_has_the_time_since_when_it_lasts() -> None:
    times, now = LevelTimes(), time.time_ns()
    levels = (Level.OK, Level.OK, Level.ERROR, Level.ERROR, Level.OK)
    heard = [times.note(state("a", level, second), now).since_ns // 10**9 for second, level in enumerate(levels)]
    assert heard == [0, 0, 2, 2, 4]
    late = times.note(state_at(state("a", Level.OK, 4), 60 * 10**9, 1.0), 60 * 10**9)
    assert (late.level, late.since_ns) == (Level.STALE, 60 * 10**9)
    found = worst_first([times.note(state(name, level, second), 0) for name, level, second in (
        ("calm", Level.OK, 9), ("old", Level.ERROR, 5), ("new", Level.ERROR, 7))])  # fmt: skip
    assert [each.name for each in found] == ["new", "old", "calm"]
    told = [(number, state("a", level)) for number, level in enumerate((Level.OK, Level.OK, Level.WARN))]
    assert [each.time_ns for each in changes_of(told)] == [2, 0]
