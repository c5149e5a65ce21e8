"""The paper's Listing 3: complex resources whose links and actions come and go with the state (level three)."""

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

AIRCRAFT, ENGINE = "/resources/aircraft/", "/resources/aircraft/engine/"
POWER, START, STOP = f"{AIRCRAFT}power", f"{AIRCRAFT}start", f"{AIRCRAFT}stop"
SPEED, DIRECTION = f"{ENGINE}speed", f"{ENGINE}direction"
MERGE_PATCH = "application/merge-patch+json"
LISTING = {
    "off": {"power": "off", "start": START},
    "standing": {"power": "on", "stop": STOP, "engine": ENGINE},
    "flying": {"power": "on", "engine": ENGINE},
}
"""What the resource of the aircraft shows in each state, as the listing has it: a value, and links to follow."""
ABSENT = {"off": ("stop", "engine"), "standing": ("start",), "flying": ("start", "stop")}
STATES = tuple(LISTING)
SYNTAXES = (
    "text/turtle",
    "application/ld+json",
    "application/n-triples",
    "application/rdf+xml",
    "text/n3",
    "application/n-quads",
    "application/trig",
    "application/json",
    "text/html",
)


def not_offered(flight: Any, condition: NamedNode, verb: str, path: str, value: object = None, **how: str) -> None:
    """The request is refused (409) with the report of a condition on this relation, in JSON and in RDF."""
    refused = flight.send(verb, path, value, **how)
    assert (refused.status_code, refused.json()["title"]) == (409, "Not on offer now"), refused.text
    assert [one["path"] for one in refused.json()["violations"]] == [flight.name_of(condition)]
    again = flight.send(verb, path, value, "text/turtle", **how)
    assert again.status_code == 409
    said = {(one.predicate, one.object) for one in flight.triples(again)}
    assert (rdf.type, NamedNode(sh.iri + "ValidationReport")) in said
    assert (NamedNode(sh.iri + "resultPath"), condition) in said


def not_there(flight: Any, verb: str, path: str, value: object = None, **how: str) -> None:
    """The answer says that something is not there now (404), and why."""
    answer = flight.send(verb, path, value, **how)
    assert (answer.status_code, answer.json()["title"]) == (404, "Not on offer now"), answer.text
    assert answer.json()["violations"]


def forms(flight: Any, path: str) -> set[tuple[str, str]]:
    """The forms in a representation: the verb and the path of each."""
    triples = flight.triples(path)
    dispatcher = {one.subject: one.object.value for one in triples if one.predicate == htv.methodName}
    targets = {one.subject: flight.path(one.object.value) for one in triples if one.predicate.value.endswith("Target")}
    return {(dispatcher[form], targets[form]) for form in dispatcher}


# /aircraft


@pytest.mark.parametrize("state", STATES)
def test_aircraft_shows_exactly_the_lines_of_the_listing_in_each_state(flight: Any, state: str) -> None:
    flight.in_state(state)
    assert flight.relations(AIRCRAFT) == LISTING[state]
    assert flight.json(AIRCRAFT) == {"power": LISTING[state]["power"]}
    contained = {POWER, *LISTING[state].values()} - {"on", "off"}
    assert flight.said(AIRCRAFT, ldp.contains) == contained


def test_aircraft_as_json_is_exactly_its_power(flight: Any) -> None:
    flight.off()
    answer = flight.get(AIRCRAFT, "application/json")
    assert answer.headers["content-type"] == "application/json"
    assert answer.content == b'{"power":"off"}'


def test_aircraft_without_its_slash_leads_to_it(flight: Any) -> None:
    moved = flight.get("/resources/aircraft")
    assert (moved.status_code, flight.path(moved.headers["location"])) == (308, AIRCRAFT)


def test_the_single_entry_leads_to_the_aircraft_and_no_further_than_is_offered(flight: Any) -> None:
    flight.off()
    assert "/resources/" in flight.said("/", ldp.contains)
    assert AIRCRAFT in flight.said("/resources/", ldp.contains)
    assert ENGINE not in flight.said("/resources/", ldp.contains)


# linkrel : start -> /aircraft


def test_link_start_appears_as_long_as_the_aircraft_is_not_started(flight: Any) -> None:
    flight.off()
    assert flight.said(AIRCRAFT, av.start) == {START}
    assert ("POST", START) in forms(flight, AIRCRAFT)
    assert forms(flight, START) == {("POST", START)}
    for state in ("standing", "flying"):
        flight.in_state(state)
        assert flight.said(AIRCRAFT, av.start) == set()
        assert ("POST", START) not in forms(flight, AIRCRAFT)
        not_there(flight, "GET", START)


def test_link_start_leads_back_to_the_aircraft_which_is_started(flight: Any) -> None:
    flight.off()
    answer = flight.post(START)
    assert answer.status_code == 200, answer.text
    assert flight.path(answer.headers["content-location"]) == AIRCRAFT
    assert flight.relations(answer) == LISTING["standing"]
    assert flight.robot.ask("/aircraft/get_power") == "on"


def test_start_while_started_is_refused_and_nothing_is_called(flight: Any) -> None:
    flight.flying()
    before = flight.calls()
    not_offered(flight, av.power, "POST", START)
    assert flight.calls() == before
    assert flight.robot.ask("/aircraft/get_power") == "on"


# linkrel : stop -> /aircraft


def test_link_stop_appears_as_long_as_the_aircraft_is_started_and_its_speed_is_zero(flight: Any) -> None:
    flight.standing()
    assert flight.said(AIRCRAFT, av.stop) == {STOP}
    assert ("POST", STOP) in forms(flight, AIRCRAFT)
    assert forms(flight, STOP) == {("POST", STOP)}
    for state in ("flying", "off"):
        flight.in_state(state)
        assert flight.said(AIRCRAFT, av.stop) == set()
        assert ("POST", STOP) not in forms(flight, AIRCRAFT)
        not_there(flight, "GET", STOP)


def test_link_stop_leads_back_to_the_aircraft_which_is_stopped(flight: Any) -> None:
    flight.standing()
    answer = flight.post(STOP)
    assert answer.status_code == 200, answer.text
    assert flight.path(answer.headers["content-location"]) == AIRCRAFT
    assert flight.relations(answer) == LISTING["off"]
    assert flight.robot.ask("/aircraft/get_power") == "off"


def test_stop_while_not_started_is_refused_and_nothing_is_called(flight: Any) -> None:
    flight.off()
    before = flight.calls()
    not_offered(flight, av.power, "POST", STOP)
    assert flight.calls() == before


def test_stop_while_flying_is_refused_and_the_robot_flies_on(flight: Any) -> None:
    flight.flying()
    before = flight.calls()
    not_offered(flight, av.speed, "POST", STOP)
    assert flight.calls() == before
    assert flight.robot.ask("/aircraft/get_power") == "on"
    assert flight.robot.hear("/aircraft/engine/speed") == 20.0


def test_stop_right_after_the_speed_was_set_is_refused_by_the_mapping_or_by_the_robot(flight: Any) -> None:
    flight.standing()
    assert flight.put(SPEED, 20).status_code == 204
    assert flight.post(STOP).status_code in (409, 422)  # whether or not the topic has told of the new speed
    assert flight.robot.ask("/aircraft/get_power") == "on"


def test_link_stop_comes_back_when_the_speed_is_zero_again_and_who_waits_is_told(flight: Any) -> None:
    flight.flying()
    before = flight.get(AIRCRAFT).headers["etag"]
    assert flight.put(SPEED, 0).status_code == 204
    told = flight.http.get(AIRCRAFT, params={"after": before, "timeout": "10"}, headers={"Accept": "text/turtle"})
    assert told.status_code == 200
    assert flight.relations(told) == LISTING["standing"]
    assert flight.robot.hear("/aircraft/engine/speed") == 0.0


# linkrel : engine -> /aircraft/engine


def test_link_engine_appears_as_long_as_the_aircraft_is_started(flight: Any) -> None:
    for state in ("standing", "flying"):
        flight.in_state(state)
        assert flight.said(AIRCRAFT, av.engine) == {ENGINE}
        assert ENGINE in flight.said(AIRCRAFT, ldp.contains)
        assert flight.get(ENGINE).status_code == 200
    flight.off()
    assert flight.said(AIRCRAFT, av.engine) == set()
    assert ENGINE not in flight.said(AIRCRAFT, ldp.contains)


# power : on | off


@pytest.mark.parametrize("state", STATES)
def test_power_of_the_aircraft_is_on_or_off(flight: Any, state: str) -> None:
    flight.in_state(state)
    assert flight.said(AIRCRAFT, av.power) == {flight.robot.ask("/aircraft/get_power")}


@pytest.mark.parametrize(("state", "offered"), [("off", True), ("standing", True), ("flying", False)])
def test_power_offers_to_be_written_only_while_the_aircraft_stands(flight: Any, state: str, offered: bool) -> None:
    flight.in_state(state)
    assert (("PUT", POWER) in forms(flight, AIRCRAFT)) is offered
    assert (("PUT", POWER) in forms(flight, POWER)) is offered
    assert ("GET", POWER) in forms(flight, POWER)


def test_power_is_written_while_the_aircraft_stands(flight: Any) -> None:
    flight.off()
    assert flight.put(POWER, "on").status_code == 204
    assert flight.relations() == LISTING["standing"]
    assert flight.patch(AIRCRAFT, {"power": "off"}).status_code == 204
    assert flight.relations() == LISTING["off"]
    assert flight.robot.ask("/aircraft/get_power") == "off"


def test_power_written_while_flying_is_refused_and_the_robot_flies_on(flight: Any) -> None:
    flight.flying()
    not_offered(flight, av.speed, "PUT", POWER, "off")
    not_offered(flight, av.speed, "PATCH", AIRCRAFT, {"power": "off"}, type=MERGE_PATCH)
    assert flight.robot.ask("/aircraft/get_power") == "on"
    assert flight.robot.hear("/aircraft/engine/speed") == 20.0


# /aircraft/engine


def test_engine_exists_as_long_as_the_aircraft_is_started(flight: Any) -> None:
    for state in ("standing", "flying"):
        flight.in_state(state)
        for url in (ENGINE, SPEED, DIRECTION):
            assert flight.get(url).status_code == 200
    flight.off()
    for url in (ENGINE, SPEED, DIRECTION, f"{ENGINE}cylinders", f"{ENGINE}limits/"):
        not_there(flight, "GET", url)


def test_engine_that_is_not_there_takes_nothing_and_the_robot_is_not_asked(flight: Any) -> None:
    flight.off()
    for url, value in ((SPEED, 20), (DIRECTION, 90)):
        not_there(flight, "PUT", url, value)
    not_there(flight, "PATCH", ENGINE, {"speed": 20}, type=MERGE_PATCH)
    flight.standing()
    assert flight.robot.hear("/aircraft/engine/speed") == 0.0


def test_link_aircraft_leads_back_from_the_engine(flight: Any) -> None:
    flight.standing()
    assert flight.said(ENGINE, av.aircraft) == {AIRCRAFT}


def test_engine_shows_exactly_the_lines_of_the_listing(flight: Any) -> None:
    flight.standing()
    assert flight.put(DIRECTION, 90).status_code == 204
    found = flight.relations(ENGINE)
    assert found.keys() == {"aircraft", "speed", "direction"}
    assert (float(found["speed"]), float(found["direction"])) == (0.0, 90.0)
    assert flight.said(ENGINE, ldp.contains) == {SPEED, DIRECTION}
    assert flight.json(ENGINE) == {"speed": 0.0, "direction": 90.0}


# speed : 0 - 1000


def test_speed_of_the_engine_is_read_and_written(flight: Any) -> None:
    flight.flying()
    assert {float(value) for value in flight.said(ENGINE, av.speed)} == {20.0}
    assert flight.patch(ENGINE, {"speed": 10}).status_code == 204
    flight.until(lambda: flight.json(ENGINE)["speed"] == 10.0, "the speed")
    assert flight.robot.hear("/aircraft/engine/speed") == 10.0
    assert flight.patch(ENGINE, {"speed": 1001}).status_code == 422


# direction : 0 - 360


def test_direction_of_the_engine_is_read_and_written(flight: Any) -> None:
    flight.standing()
    assert flight.patch(ENGINE, {"direction": 270}).status_code == 204
    assert {float(value) for value in flight.said(ENGINE, av.direction)} == {270.0}
    assert flight.robot.ask("/aircraft/engine/get_direction") == 270.0
    assert flight.patch(ENGINE, {"direction": 361}).status_code == 422


def test_a_patch_of_several_is_refused_whole(flight: Any) -> None:
    flight.standing()
    assert flight.put(DIRECTION, 45).status_code == 204
    answer = flight.patch(ENGINE, {"direction": 90, "speed": 5000})
    assert answer.status_code == 422, answer.text
    assert flight.robot.ask("/aircraft/engine/get_direction") == 45.0


# Hypermedia


@pytest.mark.parametrize("state", STATES)
def test_nothing_that_is_not_offered_is_in_any_representation(flight: Any, state: str) -> None:
    flight.in_state(state)
    for path, syntax in product((AIRCRAFT, POWER, "/resources/"), SYNTAXES):
        shown = said_in(flight.get(path, syntax))
        for name in ABSENT[state]:
            assert not re.search(rf"\b{name}", shown), f"{name} in {path} as {syntax}"
        for reason in ("must be", "not on offer", "standing", "Condition"):
            assert reason not in shown, f"{reason} in {path} as {syntax}"
        if path == AIRCRAFT and syntax != "application/json":
            assert all(re.search(rf"\b{name}", shown) for name in LISTING[state])


def said_in(answer: httpx.Response) -> str:
    """All that a representation says: of a page the text and the addresses, without the page's own furniture."""
    assert answer.status_code == 200, answer.text
    if not answer.headers["content-type"].startswith("text/html"):
        return str(answer.text)
    page = answer.text[answer.text.index("<main") : answer.text.index("</main>")]
    attributes = re.findall(r'(?:href|action|formaction|id|value|name)="([^"]*)"', page)
    return unescape(" ".join([re.sub(r"<[^>]*>", " ", page), *attributes]))


def test_a_page_has_buttons_for_what_is_offered_and_no_others(flight: Any) -> None:
    flight.off()
    page = flight.get(AIRCRAFT, "text/html").text
    assert re.search(r'(action|formaction)="[^"]*start"', page)
    flight.standing()
    page = flight.get(AIRCRAFT, "text/html").text
    assert re.search(r'(action|formaction)="[^"]*stop"', page)
    assert not re.search(r'(action|formaction)="[^"]*start"', page)


def test_etags_change_when_links_come_and_go_and_only_then(flight: Any) -> None:
    seen = {}
    for state in STATES:
        flight.in_state(state)
        answer = flight.get(AIRCRAFT)
        assert answer.headers["cache-control"] == "no-cache"
        seen[state] = answer.headers["etag"]
        again = flight.http.get(AIRCRAFT, headers={"Accept": "text/turtle", "If-None-Match": seen[state]})
        assert again.status_code == 304
    assert len(set(seen.values())) == len(STATES)  # of standing and flying, power is the same: the links are not
    flight.off()
    assert flight.get(AIRCRAFT).headers["etag"] == seen["off"]


@pytest.mark.parametrize("syntax", ["text/turtle", "application/ld+json", "application/n-triples"])
def test_the_answer_to_an_action_is_the_new_representation_with_the_next_links(flight: Any, syntax: str) -> None:
    flight.off()
    answer = flight.post(START, accept=syntax)
    assert answer.status_code == 200
    now = flight.get(AIRCRAFT, syntax)
    assert (answer.content, answer.headers["etag"]) == (now.content, now.headers["etag"])


def test_a_flight_needs_only_what_is_offered(flight: Any) -> None:
    flight.off()
    at = flight.post(flight.relations()["start"])
    engine = flight.relations(at)["engine"]
    assert flight.put(next(iter(flight.said(engine, ldp.contains) & {SPEED})), 10).status_code == 204
    flight.until(lambda: flight.json(SPEED) == 10.0, "the speed")
    assert flight.put(SPEED, 0).status_code == 204
    aircraft = flight.relations(engine)["aircraft"]
    flight.until(lambda: "stop" in flight.relations(aircraft), "the link stop")
    done = flight.post(flight.relations(aircraft)["stop"])
    assert flight.relations(done) == LISTING["off"]


def test_a_thing_description_lists_all_affordances_whatever_the_state(flight: Any) -> None:
    flight.off()
    thing = flight.get(AIRCRAFT, "application/td+json").json()
    # every Thing Description also says how to stop the robot as a whole
    assert (thing["properties"].keys(), thing["actions"].keys()) == ({"power"}, {"start", "stop", "stopRobot"})
    flight.standing()
    assert flight.get(AIRCRAFT, "application/td+json").json() == thing


def test_sparql_sees_what_is_offered_now(flight: Any) -> None:
    for state in ("off", "standing"):
        flight.in_state(state)
        query = (
            f"SELECT ?relation ?to WHERE {{ GRAPH <{flight.absolute(AIRCRAFT)}> {{ <{flight.absolute(AIRCRAFT)}> "
            f'?relation ?to FILTER(STRSTARTS(STR(?relation), "{av.iri}")) }} }}'
        )
        results = {"Accept": "application/sparql-results+json"}
        rows = flight.http.get("/sparql", params={"query": query}, headers=results).json()["results"]["bindings"]
        found = {row["relation"]["value"].removeprefix(av.iri): flight.path(row["to"]["value"]) for row in rows}
        assert found == LISTING[state]


# Level one beside it


def test_level_one_is_not_guarded_by_the_mapping(flight: Any) -> None:
    flight.flying()
    not_there(flight, "GET", STOP)
    called = flight.post("/services/aircraft/stop", accept="application/json")
    assert (called.status_code, called.json()["success"]) == (201, False)  # it was called; the robot itself declined
    assert flight.path(called.headers["location"]) in flight.calls()


def test_level_one_is_closed_by_resources_only(flight: Any, beside: Callable[..., Any]) -> None:
    flight.off()
    closed = beside("--resources-only", "/aircraft/*")
    for path in ("/services/aircraft/start", "/services/aircraft/engine/set_speed"):
        refused = closed.post(path, {}, "application/json")
        assert refused.status_code == 405
        assert "/resources/" in refused.json()["detail"]
        assert closed.allowed(path) == {"GET"}
    assert closed.allowed("/topics/aircraft/engine/speed") == {"GET"}
    assert closed.put("/topics/aircraft/engine/speed", {"data": 1}).status_code == 405
    assert closed.put("/parameters/aircraft/seats", 3).status_code == 405
    assert closed.http.delete("/parameters/aircraft/seats").status_code == 405
    assert closed.robot.parameter("/aircraft/seats") == 2
    assert closed.put("/parameters/cockpit/night", False).status_code == 204  # it is no part of the glob
    assert closed.json("/topics/aircraft/engine/speed") == {"data": 0.0}  # reading is open
    assert closed.relations(closed.post(START)) == LISTING["standing"]
    assert closed.put(SPEED, 20).status_code == 204
    closed.until(lambda: closed.json(SPEED) == 20.0, "the speed")
    not_offered(closed, av.speed, "PUT", POWER, "off")
    closed.off()


def test_resources_only_cannot_be_gone_around_by_a_tree_of_parameters(flight: Any, beside: Callable[..., Any]) -> None:
    closed = beside("--resources-only", "/aircraft/*")
    before = closed.robot.parameter("/aircraft")
    attempts = [
        closed.http.delete("/parameters/aircraft/"),
        closed.http.delete("/parameters/aircraft"),
        closed.put("/parameters/aircraft", {"seats": 3}),
        closed.http.post("/parameters/aircraft/", json=3, headers={"Slug": "doors"}),
        closed.patch("/parameters/aircraft/", {"seats": None}),
        closed.patch("/parameters/", {"aircraft": {"seats": 3}}),
        closed.patch("/parameters/", {"aircraft": None}),
    ]
    assert {one.status_code for one in attempts} <= {404, 405, 409}, [one.text for one in attempts]
    assert closed.robot.parameter("/aircraft") == before
