"""Statements about deleted resources, about conflicts, and about refused requests."""

from __future__ import annotations

import time
from collections.abc import Callable

import httpx
import pytest

from tests.server.auth.conftest import TURTLE, Guarded, rule

RULES = (
    rule("admin", "read write control administer", "/**")
    + rule("keeper", "read write control", "/**")
    + rule("pilot", "read control", "/topics/cockpit/**", "/holds/**", "/resources/aircraft/start")
    + rule("writer", "read write", "/data/open/**")
    + rule("reader", "read", "/topics/cockpit/**", "/data/open/**", "/graphs")
    + rule("blind", "control", "/topics/cockpit/**")
)
AGENTS = ("admin", "keeper", "pilot", "writer", "reader", "blind")
PROVENANCE = "http://www.w3.org/ns/prov#has_provenance"
DISPLAY = "/topics/cockpit/display"


@pytest.fixture(scope="module")
def aircraft(guard: Callable[..., Guarded]) -> Guarded:
    return guard(RULES, *AGENTS)


def held(agent: httpx.Client, lease: float = 5) -> httpx.Response:
    """Start a hold as an agent."""
    answer = agent.post(DISPLAY, json={"data": "held"}, params={"rate": 1, "lease": lease, "then": "none"})
    assert answer.status_code == 201, answer.text
    return answer


def test_the_hold_is_offered_with_its_form_to_those_who_may_hold_and_to_nobody_else(aircraft: Guarded) -> None:
    def offered(agent: str) -> tuple[bool, bool]:
        told = aircraft[agent].get(DISPLAY, headers={"Accept": "application/n-triples"}).text
        return "#hold>" in told, "{?rate,lease,for,then}" in told

    assert offered("keeper") == offered("pilot") == offered("admin") == (True, True)
    assert offered("reader") == (False, False)


def test_a_hold_of_ones_own_that_lapsed_is_410(aircraft: Guarded) -> None:
    url = held(aircraft["pilot"], lease=0.1).headers["location"]
    deadline = time.monotonic() + 20
    while aircraft["pilot"].get(url).status_code == 200 and time.monotonic() < deadline:
        time.sleep(0.05)
    for agent in ("pilot", "keeper", "admin"):
        assert aircraft[agent].get(url).status_code == 410, agent
        assert aircraft[agent].patch(url, json={}).status_code == 410, agent
    assert aircraft["reader"].get(url).status_code == 404


def test_a_deleted_document_is_410_to_those_who_may_know_of_it(aircraft: Guarded) -> None:
    for path in ("/data/open/plan", "/data/closed"):
        assert aircraft["admin"].put(path, content="<> a <#T> .", headers=TURTLE).status_code == 201
        assert aircraft["admin"].delete(path).status_code == 204
    statuses = {agent: aircraft[agent].get("/data/open/plan").status_code for agent in AGENTS}
    assert statuses == {**dict.fromkeys(AGENTS, 410), "pilot": 404, "blind": 404}
    assert aircraft["writer"].get("/data/open/never").status_code == 404
    assert aircraft["writer"].get("/data/closed").text == aircraft["writer"].get("/data/never").text


def test_who_holds_a_topic_is_told_to_those_who_may_know_of_the_hold(aircraft: Guarded) -> None:
    hold = held(aircraft["keeper"])
    try:
        told, untold = (aircraft[agent].put(DISPLAY, json={"data": "x"}) for agent in ("pilot", "blind"))
        assert (told.status_code, untold.status_code) == (409, 409)
        assert told.json()["holder"] == "keeper"
        assert "keeper" not in untold.text
        assert hold.headers["location"] not in untold.text
    finally:
        aircraft["keeper"].delete(hold.headers["location"])


def test_why_an_action_is_not_on_offer_is_told_to_those_who_may_read_what_it_hangs_on(aircraft: Guarded) -> None:
    assert aircraft["admin"].post("/services/aircraft/start", json={}).status_code == 201
    told, untold = (aircraft[agent].post("/resources/aircraft/start") for agent in ("keeper", "pilot"))
    assert (told.status_code, untold.status_code) == (409, 409)
    assert "power" in told.text
    assert "power" not in untold.text


def test_who_stopped_the_robot_and_why_is_told_to_those_who_may_read_the_stop(aircraft: Guarded) -> None:
    assert aircraft["admin"].post("/stop", json={"reason": "a bird"}).status_code == 200
    try:
        told, untold = (aircraft[agent].put(DISPLAY, json={"data": "x"}) for agent in ("keeper", "pilot"))
        assert (told.status_code, untold.status_code) == (423, 423)
        assert "a bird" in told.text
        assert "a bird" not in untold.text
        assert "admin" not in untold.text
    finally:
        assert aircraft["admin"].delete("/stop").status_code == 204


# Receipts of refused requests


def newest(guarded: Guarded) -> dict[str, object]:
    """Return the newest receipt."""
    listed = guarded["admin"].get("/activity/", headers={"Accept": "application/n-triples", "Prefer": "return=full"})
    urls = [line.split("<")[3].rstrip("> .") for line in listed.text.splitlines() if "#contains>" in line]
    receipts = [guarded["admin"].get(url, headers={"Accept": "application/json"}).json() for url in urls]
    found: dict[str, object] = max(receipts, key=lambda one: one["ended"])
    return found


def test_a_refused_write_of_a_known_agent_leaves_a_receipt_and_nothing_else_does(aircraft: Guarded) -> None:
    for agent, method, path, status in (
        ("reader", "PUT", "/topics/cockpit/display", 403),
        ("reader", "PUT", "/data/closed", 404),
        ("reader", "POST", "/services/aircraft/start", 404),
        ("writer", "DELETE", "/data/open/never", 404),
        ("reader", "PUT", "/graphs?graph=/data/open/x", 403),
    ):
        answer = aircraft[agent].request(method, path, content="<> a <#T> .", headers=TURTLE)
        assert answer.status_code == status, answer.text
        assert PROVENANCE not in answer.headers["link"]
        told = newest(aircraft)
        assert (told["agent"], told["method"], told["status"]) == (agent, method, status)
        assert str(told["url"]).endswith(path)
        assert told.keys().isdisjoint({"plan", "touched"})
    for agent, method, path, status in (
        ("anybody", "PUT", "/topics/cockpit/display", 401),
        ("reader", "GET", "/nowhere", 404),
        ("reader", "OPTIONS", "/nowhere", 404),
        ("keeper", "DELETE", "/services/aircraft/start", 405),
    ):
        assert aircraft[agent].request(method, path).status_code == status
        assert newest(aircraft) == told
