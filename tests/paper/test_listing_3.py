"""The paper's Listing 3: complex resources whose links and actions depend on the state (level three)."""

from __future__ import annotations

import re
from collections.abc import Callable
from html import unescape
from itertools import product
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode

from rosld.ontology.vocab import av, htv, ldp, rdf, sh
from tests.paper.conftest import AIRCRAFT, ENGINE, JSON, MERGE_PATCH, Flight
from tests.waiting import until

pytestmark = pytest.mark.slow

POWER, START, STOP = f"{AIRCRAFT}power", f"{AIRCRAFT}start", f"{AIRCRAFT}stop"
SPEED, DIRECTION = f"{ENGINE}speed", f"{ENGINE}direction"
LISTING = {
    "off": {"power": "off", "start": START},
    "standing": {"power": "on", "stop": STOP, "engine": ENGINE},
    "flying": {"power": "on", "engine": ENGINE},
}
"""Lines of the listing for the resource of the aircraft in each state: a value, and the links."""
ABSENT = {"off": ("stop", "engine"), "standing": ("start",), "flying": ("start", "stop")}


def not_offered(flight: Flight, condition: NamedNode, method: str, path: str, value: object = None, **how: str) -> None:
    """Check that the request is refused (409) with the report of a condition on this relation, in JSON and in RDF."""
    refused = flight.send(method, path, value, **how)
    assert (refused.status_code, refused.json()["title"]) == (409, "Not on offer now"), refused.text
    assert [one["path"] for one in refused.json()["violations"]] == [condition.value.removeprefix(av.iri)]
    again = flight.send(method, path, value, "text/turtle", **how)
    assert again.status_code == 409
    said = {(one.predicate, one.object) for one in flight.triples(again)}
    assert (rdf.type, NamedNode(sh.iri + "ValidationReport")) in said
    assert (NamedNode(sh.iri + "resultPath"), condition) in said


def not_there(flight: Flight, method: str, path: str, value: object = None, **how: str) -> None:
    """Check that the resource is missing now (404), and that the response says why."""
    answer = flight.send(method, path, value, **how)
    assert (answer.status_code, answer.json()["title"]) == (404, "Not on offer now"), answer.text
    assert answer.json()["violations"]


def forms(flight: Flight, path: str) -> set[tuple[str, str]]:
    """Return the method and the path of each form in a representation."""
    triples = flight.triples(path)
    methods = {one.subject: one.object.value for one in triples if one.predicate == htv.methodName}
    targets = {one.subject: flight.path(one.object.value) for one in triples if one.predicate.value.endswith("Target")}
    return {(methods[form], targets[form]) for form in methods}


# /aircraft


def test_aircraft_shows_exactly_the_lines_of_the_listing_in_each_state(flight: Flight) -> None:
    for state, lines in LISTING.items():
        flight.in_state(state)
        assert flight.relations() == lines
        assert flight.get(AIRCRAFT, JSON).content == f'{{"power":"{lines["power"]}"}}'.encode()
        assert flight.said(AIRCRAFT, ldp.contains) == {POWER, *lines.values()} - {"on", "off"}
        assert flight.said(AIRCRAFT, av.power) == {flight.ask("/aircraft/get_power")}


def test_the_single_entry_leads_to_the_aircraft_and_no_further_than_is_offered(flight: Flight) -> None:
    flight.off()
    assert "/resources/" in flight.said("/", ldp.contains)
    assert AIRCRAFT in flight.said("/resources/", ldp.contains)
    assert ENGINE not in flight.said("/resources/", ldp.contains)
    moved = flight.get(AIRCRAFT.rstrip("/"))
    assert (moved.status_code, flight.path(moved.headers["location"])) == (308, AIRCRAFT)


# linkrel : start -> /aircraft, and linkrel : stop -> /aircraft


def test_links_appear_as_long_as_they_are_on_offer(flight: Flight) -> None:
    for state in LISTING:
        flight.in_state(state)
        for relation, url, offered in ((av.start, START, "off"), (av.stop, STOP, "standing")):
            is_offered = state == offered
            assert flight.said(AIRCRAFT, relation) == ({url} if is_offered else set())
            assert (("POST", url) in forms(flight, AIRCRAFT)) is is_offered
            if is_offered:
                assert forms(flight, url) == {("POST", url)}
            else:
                not_there(flight, "GET", url)


def test_links_lead_back_to_the_aircraft_which_is_started_and_stopped_once(flight: Flight) -> None:
    flight.off()
    for url, state in ((START, "standing"), (STOP, "off")):
        answer = flight.post(url)
        assert answer.status_code == 200, answer.text
        assert flight.path(answer.headers["content-location"]) == AIRCRAFT
        assert flight.relations(answer) == LISTING[state]
        before = flight.calls()
        not_offered(flight, av.power, "POST", url)
        assert flight.calls() == before
        assert flight.ask("/aircraft/get_power") == LISTING[state]["power"]


def test_stop_while_flying_is_refused_and_the_robot_flies_on(flight: Flight) -> None:
    flight.flying()
    before = flight.calls()
    not_offered(flight, av.speed, "POST", STOP)
    assert flight.calls() == before
    assert flight.ask("/aircraft/get_power") == "on"
    assert flight.robot_speed() == 20.0


def test_stop_right_after_the_speed_was_set_is_refused_by_the_mapping_or_by_the_robot(flight: Flight) -> None:
    flight.standing()
    assert flight.put(SPEED, 20).status_code == 204
    assert flight.post(STOP).status_code in (409, 422)  # whether or not the topic has published the new speed
    assert flight.ask("/aircraft/get_power") == "on"


def test_link_stop_comes_back_when_the_speed_is_zero_again_and_who_waits_is_told(flight: Flight) -> None:
    flight.flying()
    before = flight.get(AIRCRAFT).headers["etag"]
    assert flight.put(SPEED, 0).status_code == 204
    told = flight.http.get(AIRCRAFT, params={"after": before, "timeout": "10"}, headers={"Accept": "text/turtle"})
    assert told.status_code == 200
    assert flight.relations(told) == LISTING["standing"]


# power : on | off


def test_power_is_written_only_while_the_aircraft_stands(flight: Flight) -> None:
    for state in LISTING:
        flight.in_state(state)
        for path in (AIRCRAFT, POWER):
            assert (("PUT", POWER) in forms(flight, path)) is (state != "flying")
        assert ("GET", POWER) in forms(flight, POWER)
    not_offered(flight, av.speed, "PUT", POWER, "off")
    not_offered(flight, av.speed, "PATCH", AIRCRAFT, {"power": "off"}, type=MERGE_PATCH)
    assert flight.ask("/aircraft/get_power") == "on"
    assert flight.robot_speed() == 20.0
    flight.off()
    assert flight.put(POWER, "on").status_code == 204
    assert flight.relations() == LISTING["standing"]
    assert flight.patch(AIRCRAFT, {"power": "off"}).status_code == 204
    assert flight.relations() == LISTING["off"]


# linkrel : engine -> /aircraft/engine, and /aircraft/engine


def test_engine_exists_as_long_as_the_aircraft_is_started(flight: Flight) -> None:
    for state in ("standing", "flying"):
        flight.in_state(state)
        for url in (ENGINE, SPEED, DIRECTION):
            assert flight.get(url).status_code == 200
    flight.off()
    for url in (ENGINE, SPEED, DIRECTION, f"{ENGINE}cylinders", f"{ENGINE}limits/"):
        not_there(flight, "GET", url)
    for url, value in ((SPEED, 20), (DIRECTION, 90)):
        not_there(flight, "PUT", url, value)
    not_there(flight, "PATCH", ENGINE, {"speed": 20}, type=MERGE_PATCH)
    flight.standing()
    assert flight.robot_speed() == 0.0, "the robot was not asked"


def test_engine_shows_exactly_the_lines_of_the_listing(flight: Flight) -> None:
    flight.standing()
    assert flight.put(DIRECTION, 90).status_code == 204
    found = flight.relations(ENGINE)
    assert found.pop("aircraft") == AIRCRAFT
    assert {name: float(value) for name, value in found.items()} == {"speed": 0.0, "direction": 90.0}
    assert flight.said(ENGINE, ldp.contains) == {SPEED, DIRECTION}
    assert flight.json(ENGINE) == {"speed": 0.0, "direction": 90.0}


# speed : 0 - 1000 and direction : 0 - 360


def test_speed_and_direction_of_the_engine_are_read_and_written_all_or_none(flight: Flight) -> None:
    flight.standing()
    assert flight.patch(ENGINE, {"speed": 10, "direction": 270}).status_code == 204
    until(lambda: flight.json(ENGINE) == {"speed": 10.0, "direction": 270.0}, "the speed")
    assert {float(value) for value in flight.said(ENGINE, av.speed)} == {10.0}
    assert {float(value) for value in flight.said(ENGINE, av.direction)} == {270.0}
    assert (flight.robot_speed(), flight.ask("/aircraft/engine/get_direction")) == (10.0, 270.0)
    for patch in ({"speed": 1001}, {"direction": 361}, {"direction": 90, "speed": 5000}):
        assert flight.patch(ENGINE, patch).status_code == 422
    assert flight.ask("/aircraft/engine/get_direction") == 270.0


# Hypermedia


def test_nothing_that_is_not_offered_is_in_any_representation(flight: Flight) -> None:
    syntaxes = ("text/turtle", "application/ld+json", "application/trig", JSON, "text/html")
    for state, lines in LISTING.items():
        flight.in_state(state)
        for path, syntax in product((AIRCRAFT, POWER, "/resources/"), syntaxes):
            answer = flight.get(path, syntax)
            shown = said_in(answer)
            for name in ABSENT[state]:
                assert not re.search(rf"\b{name}", shown), f"{name} in {path} as {syntax}"
            for reason in ("must be", "not on offer", "standing", "Condition"):
                assert reason not in shown, f"{reason} in {path} as {syntax}"
            if path == AIRCRAFT and syntax != JSON:
                assert all(re.search(rf"\b{name}", shown) for name in lines)
            if path == AIRCRAFT and syntax == "text/html":
                buttons = re.findall(r'action="[^"]*aircraft/(start|stop)"', answer.text)
                assert set(buttons) == {"start", "stop"} & lines.keys()


def said_in(answer: httpx.Response) -> str:
    """Return all content of a representation: of a page the text and the addresses, without its frame."""
    assert answer.status_code == 200, answer.text
    if not answer.headers["content-type"].startswith("text/html"):
        return str(answer.text)
    page = answer.text[answer.text.index("<main") : answer.text.index("</main>")]
    attributes = re.findall(r'(?:href|action|formaction|id|value|name)="([^"]*)"', page)
    return unescape(" ".join([re.sub(r"<[^>]*>", " ", page), *attributes]))


def test_etags_change_when_links_come_and_go_and_only_then(flight: Flight) -> None:
    seen = {}
    for state in LISTING:
        flight.in_state(state)
        answer = flight.get(AIRCRAFT)
        assert answer.headers["cache-control"] == "no-cache"
        seen[state] = answer.headers["etag"]
        again = flight.http.get(AIRCRAFT, headers={"Accept": "text/turtle", "If-None-Match": seen[state]})
        assert again.status_code == 304
    assert len(set(seen.values())) == len(LISTING)  # standing and flying have the same power, but not the same links
    flight.off()
    assert flight.get(AIRCRAFT).headers["etag"] == seen["off"]


def test_the_answer_to_an_action_is_the_new_representation_with_the_next_links(flight: Flight) -> None:
    for syntax in ("text/turtle", "application/ld+json"):
        flight.off()
        answer = flight.post(START, accept=syntax)
        assert answer.status_code == 200
        now = flight.get(AIRCRAFT, syntax)
        assert (answer.content, answer.headers["etag"]) == (now.content, now.headers["etag"])


def test_a_thing_description_lists_all_affordances_whatever_the_state(flight: Flight) -> None:
    flight.off()
    thing = flight.get(AIRCRAFT, "application/td+json").json()
    # every Thing Description also describes how to stop the robot as a whole
    assert (thing["properties"].keys(), thing["actions"].keys()) == ({"power"}, {"start", "stop", "stopRobot"})
    flight.standing()
    assert flight.get(AIRCRAFT, "application/td+json").json() == thing


def test_sparql_sees_what_is_offered_now(flight: Flight) -> None:
    aircraft = flight.absolute(AIRCRAFT)
    query = f"""SELECT ?relation ?to WHERE {{ GRAPH <{aircraft}> {{
        <{aircraft}> ?relation ?to FILTER(STRSTARTS(STR(?relation), "{av.iri}")) }} }}"""
    results = {"Accept": "application/sparql-results+json"}
    for state in ("off", "standing"):
        flight.in_state(state)
        rows = flight.http.get("/sparql", params={"query": query}, headers=results).json()["results"]["bindings"]
        found = {row["relation"]["value"].removeprefix(av.iri): flight.path(row["to"]["value"]) for row in rows}
        assert found == LISTING[state]


# Level one in addition


def test_level_one_is_not_guarded_by_the_mapping(flight: Flight) -> None:
    flight.flying()
    not_there(flight, "GET", STOP)
    called = flight.post("/services/aircraft/stop", accept=JSON)
    assert (called.status_code, called.json()["success"]) == (201, False)  # it was called; the robot itself refused
    assert flight.path(called.headers["location"]) in flight.calls()


def test_level_one_is_closed_by_resources_only(serve: Callable[..., Any]) -> None:
    closed = Flight(serve("aircraft", "--resources-only", "/aircraft/*"))
    for path in ("/services/aircraft/start", "/services/aircraft/engine/set_speed"):
        refused = closed.post(path, {}, JSON)
        assert refused.status_code == 405
        assert "/resources/" in refused.json()["detail"]
        assert closed.allowed(path) == {"GET"}
    assert closed.allowed("/topics/aircraft/engine/speed") == {"GET"}
    assert closed.put("/topics/aircraft/engine/speed", {"data": 1}).status_code == 405
    assert closed.put("/parameters/aircraft/seats", 3).status_code == 405
    assert closed.http.delete("/parameters/aircraft/seats").status_code == 405
    before = closed.json("/parameters/aircraft/")
    trees = [
        closed.http.delete("/parameters/aircraft/"),
        closed.http.delete("/parameters/aircraft"),
        closed.put("/parameters/aircraft", {"seats": 3}),
        closed.http.post("/parameters/aircraft/", json=3, headers={"Slug": "doors"}),
        closed.patch("/parameters/aircraft/", {"seats": None}),
        closed.patch("/parameters/", {"aircraft": {"seats": 3}}),
        closed.patch("/parameters/", {"aircraft": None}),
    ]
    assert {one.status_code for one in trees} <= {404, 405, 409}, [one.text for one in trees]
    assert closed.json("/parameters/aircraft/") == before
    assert closed.put("/parameters/cockpit/night", False).status_code == 204  # the glob does not match it
    assert closed.json("/topics/aircraft/engine/speed") == {"data": 0.0}  # everybody may read
    assert closed.relations(closed.post(START)) == LISTING["standing"]
    assert closed.put(SPEED, 20).status_code == 204
    until(lambda: closed.json(SPEED) == 20.0, "the speed")
    not_offered(closed, av.speed, "PUT", POWER, "off")
