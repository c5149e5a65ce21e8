"""Faults at /faults/: what is wrong is one resource, however often it is reported, until it heals."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode, Triple

from rosld.adapters.model import Action, GoalStatus, Kind, Ref, TypeRef
from rosld.ontology.describe_faults import FaultKey, FaultKind, FaultState, Severity
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ros
from rosld.server.robot import fault_follower
from rosld.server.robot.fault_follower import MAX_PATTERNS
from rosld.server.robot.faults import Faults, pattern_of
from tests.server.auth.conftest import rule, token, tokens
from tests.server.robots.made_up import MadeUp
from tests.waiting import until

ARRAY, LOG = "diagnostic_msgs/msg/DiagnosticArray", "rosgraph_msgs/msg/Log"
JSON = {"Accept": "application/json"}
ERROR, FATAL, WARN = 8, 16, 4
PREFIX = "PREFIX ros: <https://w3id.org/rosld#> "
Found = dict[str, Any]


def said(*parts: tuple[str, int, str]) -> Found:
    return {"status": [{"name": name, "level": level, "message": words} for name, level, words in parts]}


def logged(level: int, words: str, node: str = "/robot") -> Found:
    return {"level": level, "name": node, "msg": words}


def faults(http: httpx.Client) -> dict[str, Found]:
    """Return the faults by label, as plain JSON."""
    listed = http.get("faults/?offer").json().get("members", ())
    answers = (http.get(f"faults/{id}", headers=JSON) for id in listed)
    return {answer.json()["label"]: answer.json() for answer in answers if answer.is_success}


def fault(http: httpx.Client, label: str, **expected: object) -> Found:
    """Wait for a fault with these members."""

    def there() -> Found | None:
        found = faults(http).get(label)
        return found if found is not None and expected.items() <= found.items() else None

    found: Found = until(there, f"{label} with {expected}")
    return found


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the times after which something is wrong, or healed."""
    for name, value in {
        "PERIOD": 0.02, "GONE_SECONDS": 0.1, "STEADY_SECONDS": 0.3, "SILENT_SECONDS": 0.3, "SILENT_PERIODS": 2,
        "LOG_QUIET_SECONDS": 1.0,
    }.items():  # fmt: skip
        monkeypatch.setattr(fault_follower, name, value)


@pytest.mark.usefixtures("quick")
def test_a_state_that_lasts_is_one_fault_which_heals_and_comes_back(robot: MadeUp, serving: Any) -> None:
    robot.topic("/diagnostics", ARRAY)
    robot.topic("/diagnostics_agg", ARRAY)
    http = serving()
    until(lambda: robot.subscribed() == {"/diagnostics"}, "a look at diagnostics, without the aggregated ones")
    for volts in (11.9, 11.8, 11.7):
        robot.publishes("/diagnostics", said(("battery", 1, f"low: {volts} V"), ("laser", 0, "fine")))
    first = fault(http, "battery", state="active", severity="warning", count=1)
    assert {"battery"} == faults(http).keys()
    topic = f"{http.base_url}topics/diagnostics"
    assert (first["kind"], first["source"], first["topic"], first["healed"]) == ("diagnostic", topic, topic, None)
    robot.publishes("/diagnostics", said(("battery", 2, "empty")))
    worse = fault(http, "battery", severity="error", words="empty")
    assert (worse["count"], worse["first"], worse["last"]) == (1, first["first"], first["first"])
    robot.publishes("/diagnostics", said(("battery", 0, "good")))
    assert fault(http, "battery", state="healed")["healed"] > first["first"]
    robot.publishes("/diagnostics", said(("battery", 1, "low: 11.9 V")))
    again = fault(http, "battery", state="active", count=2, healed=None)
    assert (again["url"], again["first"]) == (first["url"], first["first"])
    assert again["last"] > first["last"]


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_errors_of_the_log_are_told_apart_by_their_words_but_not_by_numbers(robot: MadeUp, serving: Any) -> None:
    robot.topic("/rosout", LOG)
    http = serving()
    until(lambda: robot.subscribed() == {"/rosout"}, "a look at the log")
    for level, words in ((ERROR, "motor 3: 81.5 C"), (FATAL, "motor 4: 0x1f C"), (WARN, "a warning")):
        robot.publishes("/rosout", logged(level, words))
    found = fault(http, "motor #: # C", count=2, severity="fatal", words="motor 4: 0x1f C")
    assert (found["kind"], found["source"]) == ("log", f"{http.base_url}nodes/robot")
    robot.publishes("/rosout", logged(ERROR, f"<b>\x00\n\x1b[31mQ {'x' * 5000}", "no node"), odd=(b"Q", b"\xff"))
    until(lambda: len(faults(http)) == 2, "the hostile words")
    odd = next(each for each in faults(http).values() if each["label"] != "motor #: # C")
    assert odd["source"] == f"{http.base_url}topics/rosout"
    assert odd["words"].startswith("<b> [31m xxx")
    assert len(odd["words"]) < 600
    page = http.get(odd["url"], headers={"Accept": "text/html"}).text
    assert "<b> [" not in page
    fault(http, "motor #: # C", state="healed")
    for number in range(3 * MAX_PATTERNS):
        robot.publishes("/rosout", logged(ERROR, "another " + "abcdefghij"[number % 10] * (1 + number // 10)))
    fault(http, "other errors", count=2 * MAX_PATTERNS)


@pytest.mark.usefixtures("quick")
def test_goals_and_calls_fail_until_one_succeeds(robot: MadeUp, serving: Any) -> None:
    robot.strange(Action("/dig", TypeRef("example_interfaces/action/Fibonacci"), ("/robot",)))
    robot.answer("/grip", "std_srvs/srv/Trigger", success=False, message="jammed")
    http = serving()
    called = http.post("services/grip", json={}).headers["location"]
    found = fault(http, "/grip", state="active", kind="call", words="jammed")
    assert (found["source"], found["activity"]) == (f"{http.base_url}services/grip", called)
    robot.answer("/grip", "std_srvs/srv/Trigger", success=True)
    http.post("services/grip", json={})
    fault(http, "/grip", state="healed")
    robot.goal("/dig", "1", GoalStatus.EXECUTING)
    robot.goal("/dig", "1", GoalStatus.ABORTED, "hit a rock")
    found = fault(http, "/dig", state="active", words="hit a rock")
    assert (found["source"], found["activity"]) == (f"{http.base_url}actions/dig", f"{http.base_url}goals/1")
    robot.goal("/dig", "2", GoalStatus.SUCCEEDED)
    fault(http, "/dig", state="healed", count=1)


@pytest.mark.usefixtures("quick")
def test_nodes_vanish_but_a_new_master_is_no_fault_and_a_lost_robot_is_one(robot: MadeUp, serving: Any) -> None:
    names = [f"/node_{letter}" for letter in "abcdefghij"]
    robot.has_nodes(*names, "/_hidden", "/rostopic_1234_1700000000000")
    http = serving()
    assert faults(http) == {}
    robot.has_nodes(*names[1:])
    found = fault(http, "/node_a", state="active", kind="node")
    assert found["source"] == f"{http.base_url}nodes/node_a"
    robot.has_nodes(*names)
    fault(http, "/node_a", state="healed")
    robot.goes_stale("the cable is cut")
    fault(http, "robot", state="active", words="cannot be reached: the cable is cut", source=f"{http.base_url}#robot")
    robot.has_nodes("/rosout", master="2")
    fault(http, "robot", state="healed")
    robot.has_nodes(*names, "/rosout", master="2")
    until(lambda: http.get("nodes/node_j").is_success, "the nodes")
    time.sleep(0.2)  # longer than a node may be away
    robot.has_nodes(master="2")
    fault(http, "robot", state="active", count=2, words="all 11 nodes vanished")
    assert faults(http).keys() == {"/node_a", "robot"}


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_a_topic_that_somebody_reads_may_fall_silent(robot: MadeUp, serving: Any) -> None:
    for name in ("/speed", "/unread"):
        robot.topic(name, "std_msgs/msg/Float64", {"data": 1})
    robot.topic("/cmd_vel", "geometry_msgs/msg/Twist", {})
    http = serving(subscribe=("/speed", "/cmd_vel"))
    until(lambda: robot.subscribed() == {"/speed", "/cmd_vel"}, "the subscriptions")
    for number in range(25):
        for name in ("/speed", "/unread"):
            robot.publishes(name, {"data": number})
        robot.publishes("/cmd_vel", {})
        time.sleep(0.05)
    found = fault(http, "/speed", state="active", severity="warning")
    assert found["words"].startswith("no message, after ")
    assert faults(http).keys() == {"/speed"}
    robot.publishes("/speed", {"data": 0})
    fault(http, "/speed", state="healed")


@pytest.fixture
def low(robot: MadeUp, serving: Any) -> tuple[httpx.Client, Found]:
    """A client of a robot with a low battery, and the fault."""
    robot.topic("/diagnostics", ARRAY, said(("battery", 1, "low"), ("arm", 2, "jammed")))
    http = serving(history=("/diagnostics",))
    return http, fault(http, "battery")


@pytest.mark.slow
def test_a_fault_is_acknowledged_by_every_kind_of_patch_and_nothing_else_of_it_can_be_changed(
    robot: MadeUp, low: tuple[httpx.Client, Found], triples_of: Callable[[httpx.Response], set[Triple]]
) -> None:
    http, found = low
    url, path = found["url"], f"faults/{found['id']}"
    merge, update, n3 = "application/merge-patch+json", "application/sparql-update", "text/n3"
    change = "DELETE { <> ros:state ?was } INSERT { <> ros:state ros:FaultAcknowledged } WHERE { <> ros:state ?was }"
    solid = f"""@prefix solid: <http://www.w3.org/ns/solid/terms#> . @prefix ros: <https://w3id.org/rosld#> .
        _:it a solid:InsertDeletePatch ; solid:deletes {{ <{url}> ros:state ros:FaultActive }} ;
        solid:inserts {{ <{url}> ros:state ros:FaultAcknowledged }} ."""

    def patched(body: str, kind: str) -> int:
        return http.patch(path, content=body, headers={"Content-Type": kind}).status_code

    assert http.delete(path).status_code == 409
    assert http.patch(path, params={"dry-run": "true"}, json={"state": "acknowledged"}).is_success
    refused = [
        ('{"state": "healed"}', merge), ('{"state": "acknowledged", "count": 5}', merge), ("{}", merge),
        (PREFIX + change.replace("FaultAcknowledged", "FaultHealed"), update),
        (PREFIX + change + ' ; INSERT DATA { <> ros:words "fine" }', update),
        (solid.replace("ros:FaultAcknowledged }", 'ros:FaultAcknowledged ; ros:words "fine" }'), n3),
    ]  # fmt: skip
    assert [patched(*each) for each in refused] == [422] * len(refused)
    assert fault(http, "battery")["state"] == "active"
    for body, kind in (
        ('{"state": "acknowledged"}', merge), (PREFIX + change, update), (solid, n3),
        ('{"state": "acknowledged"}', "application/json"),
    ):  # fmt: skip
        assert patched(body, kind) == 204
        assert fault(http, "battery")["state"] == "acknowledged"
        for level in (0, 1):
            robot.publishes("/diagnostics", said(("battery", level, "said")))
            fault(http, "battery", state=("healed", "active")[level])
    assert Triple(NamedNode(url), ros.state, ros.FaultActive) in triples_of(http.get(path))
    robot.publishes("/diagnostics", said(("battery", 0, "good")))
    fault(http, "battery", state="healed")
    assert patched('{"state": "acknowledged"}', merge) == 409
    assert http.delete(path).status_code == 204
    assert http.get(path).status_code == 410
    assert http.get("faults/ffffffffffff").status_code == 404
    robot.publishes("/diagnostics", said(("battery", 1, "low")))
    assert fault(http, "battery", state="active", count=1)["url"] == url


def test_a_fault_is_found_in_queries_words_pages_streams_and_in_the_cockpit(low: tuple[httpx.Client, Found]) -> None:
    http, found = low
    query = PREFIX + "SELECT ?words { ?fault a ros:Fault ; ros:severity 'error' ; ros:words ?words }"
    rows = http.get("sparql", params={"query": query}, headers={"Accept": "text/csv"}).text
    assert rows.split() == ["words", "jammed"]
    hits = http.get("find", params={"q": "jammed"}, headers=JSON).json()["results"]
    assert [each["kind"] for each in hits] == ["fault"]
    page = http.get("faults/", headers={"Accept": "text/html"}).text
    assert "battery" in page
    assert "acknowledged" in http.get(found["url"], headers={"Accept": "text/html"}).text
    cockpit = http.get("cockpit/default", headers={"Accept": "text/html"}).text
    assert re.search('battery</bdi></th><td><span class="level [a-z]+">Warning</span> <bdi class="value">low', cockpit)
    assert [each["topic"] for each in http.get(found["recording"], headers=JSON).json()["messages"]] == ["/diagnostics"]
    offer = http.get(f"{found['url']}?offer").json()
    assert [each["method"] for each in offer["do"]] == ["PATCH", "DELETE"]
    with http.stream("GET", "faults/", headers={"Accept": "text/event-stream"}) as stream:
        lines = stream.iter_lines()
        next(line for line in lines if "jammed" in line)
        http.patch(f"faults/{found['id']}", json={"state": "acknowledged"})
        next(line for line in lines if "FaultAcknowledged" in line)


@pytest.mark.slow
def test_who_may_not_read_a_source_does_not_see_its_faults(robot: MadeUp, serving: Any, tmp_path: Path) -> None:
    robot.topic("/diagnostics", ARRAY, said(("battery", 1, "low")))
    robot.topic("/rosout", LOG, logged(ERROR, "broken"))
    rights = tmp_path / "auth.toml"
    rights.write_text(
        tokens("ann", "bob") + rule("ann bob", "read", "/**") + rule("bob", "read", "/topics/rosout", deny=True)
    )
    rights.chmod(0o600)
    http = serving(auth=rights)
    query = {"query": PREFIX + "SELECT ?words { ?fault a ros:Fault ; ros:words ?words }"}
    seen = {}
    for agent, wanted in (("ann", {"battery", "broken"}), ("bob", {"battery"})):
        http.headers["Authorization"] = f"Bearer {token(agent)}"
        until(lambda wanted=wanted: faults(http).keys() == wanted, f"what {agent} may see")
        rows = http.get("sparql", params=query, headers={"Accept": "text/csv"}).text
        hits = http.get("find", params={"q": "broken"}, headers=JSON).json()["results"]
        cockpit = http.get("cockpit/default", headers={"Accept": "text/html"}).text
        seen[agent] = ("broken" in rows, "fault" in {each["kind"] for each in hits}, "broken" in cockpit)
        if agent == "ann":
            url = faults(http)["broken"]["url"]
    assert seen == {"ann": (True, True, True), "bob": (False, False, False)}
    assert http.get(url).status_code == 404
    assert http.patch(url, json={"state": "acknowledged"}).status_code == 404


def test_the_number_of_faults_is_limited_and_healed_ones_leave_first() -> None:
    kept = Faults(limit=100)
    keys = [FaultKey(FaultKind.DIAGNOSTIC, Ref(Kind.TOPIC, "/diagnostics"), f"part {n}") for n in range(10_000)]
    for number, key in enumerate(keys):
        kept.report(key, Severity.ERROR, f"words {number}", number)
        if number:
            kept.heal(key, number)
    assert len(kept.all()) == 100
    assert (kept.all()[0].key, kept.all()[0].state) == (keys[0], FaultState.ACTIVE)
    assert kept.about(keys[5000].id, Space("http://robot/")) == ()
    assert pattern_of("0x1F at 12.5 in\n 3") == "# at # in #"


def test_a_quiet_server_subscribes_to_nothing(robot: MadeUp, serving: Any) -> None:
    robot.topic("/diagnostics", ARRAY, said(("battery", 1, "low")))
    http = serving(faults="quiet")
    robot.goal("/dig", "1", GoalStatus.ABORTED, "hit a rock")
    fault(http, "/dig")
    assert robot.subscribed() == set()
