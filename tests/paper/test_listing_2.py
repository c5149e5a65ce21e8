"""The paper's Listing 2: the aircraft as resources that are read and updated (level two), by names alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode

from rosld.ontology.vocab import ldp, rdf, ros, sh
from tests.paper.conftest import Flight
from tests.waiting import until

pytestmark = pytest.mark.slow

POWER = "/resources/aircraft/power"
SPEED = "/resources/aircraft/engine/speed"
DIRECTION = "/resources/aircraft/engine/direction"
RESULT, REPORT, IN = (sh.iri + name for name in ("result", "ValidationReport", "in"))


def written(answer: httpx.Response) -> None:
    """Check that the write was carried out, without creating a resource."""
    assert answer.status_code == 204, answer.text
    assert "location" not in answer.headers


def refused(flight: Flight, url: str, value: object) -> None:
    """Check that a value outside of the line's range is 422 with a SHACL report by rosld, not by the robot."""
    answer = flight.put(url, value)
    assert (answer.status_code, answer.json()["title"]) == (422, "Does not fit"), answer.text
    assert answer.json()["violations"]
    assert "words" not in answer.json()  # the robot was not called
    report = flight.send("PUT", url, value, "text/turtle")
    triples = {(one.subject.value, one.predicate.value, one.object.value) for one in flight.triples(report)}
    assert any(each[1:] == (rdf.type.value, REPORT) for each in triples)
    assert any(predicate == RESULT for _, predicate, _ in triples)


def shape(flight: Flight, url: str) -> dict[str, set[str]]:
    """Return the constraints on the value of a resource, from the affordance in its representation."""
    triples = flight.triples(url)
    of = NamedNode(flight.absolute(url) + "#property")
    (top,) = (one.object for one in triples if one.subject == of and one.predicate == ros.shape)
    (part,) = (one.object for one in triples if one.subject == top and one.predicate == sh.property)
    found: dict[str, set[str]] = {}
    for one in triples:
        if one.subject == part:
            items = listed(triples, one.object) if one.predicate.value == IN else [one.object.value]
            found.setdefault(one.predicate.value.removeprefix(sh.iri), set()).update(items)
    return found


def listed(triples: Any, node: Any) -> list[str]:
    """Return the items of an rdf:List."""
    items: list[str] = []
    while node != rdf.nil:
        after = {one.predicate: one.object for one in triples if one.subject == node}
        items.append(after[rdf.first].value)
        node = after[rdf.rest]
    return items


def test_power_joins_its_getter_and_its_setter(flight: Flight) -> None:
    assert flight.said(POWER, ros.readsFrom) == {"/services/aircraft/get_power"}
    assert flight.said(POWER, ros.writesTo) == {"/services/aircraft/set_power"}
    assert flight.allowed(POWER) == {"GET", "PUT", "PATCH"}
    flight.off()
    for word in ("on", "off"):
        written(flight.put(POWER, word))
        assert flight.ask("/aircraft/get_power") == flight.json(POWER) == word
        assert flight.said(POWER, rdf.value) == {word}


def test_power_takes_nothing_but_on_and_off_and_its_shape_says_so(flight: Flight) -> None:
    flight.off()
    assert shape(flight, POWER)["in"] == {"on", "off"}
    for value in ("maybe", "ON", ""):
        refused(flight, POWER, value)
    for value in (1, True, ["on"], {"data": "maybe"}, {"power": "on"}):
        assert flight.put(POWER, value).status_code == 422
    assert flight.ask("/aircraft/get_power") == "off"


def test_speed_joins_its_topic_and_its_setter(flight: Flight) -> None:
    flight.standing()
    assert flight.said(SPEED, ros.readsFrom) == {"/topics/aircraft/engine/speed"}
    assert "/services/aircraft/engine/set_speed" in flight.said(SPEED, ros.writesTo)
    for value in (0, 1000, 10):
        written(flight.put(SPEED, value))
    until(lambda: flight.json(SPEED) == 10.0, "the speed")
    assert flight.robot_speed() == 10.0
    assert {float(value) for value in flight.said(SPEED, rdf.value)} == {10.0}


def test_speed_takes_nothing_beyond_0_to_1000_and_its_shape_says_so(flight: Flight) -> None:
    flight.flying()
    found = shape(flight, SPEED)
    assert (found["minInclusive"], found["maxInclusive"]) == ({"0"}, {"1000"})
    for value in (-0.5, 1000.5, 5000, "NaN"):
        refused(flight, SPEED, value)
    assert flight.robot_speed() == 20.0


def test_direction_joins_its_getter_and_its_setter(flight: Flight) -> None:
    flight.standing()
    assert flight.said(DIRECTION, ros.readsFrom) == {"/services/aircraft/engine/get_direction"}
    assert flight.said(DIRECTION, ros.writesTo) == {"/services/aircraft/engine/set_direction"}
    for value in (0, 360, 123.25):
        written(flight.put(DIRECTION, value))
        assert flight.json(DIRECTION) == flight.ask("/aircraft/engine/get_direction") == value
    assert {float(value) for value in flight.said(DIRECTION, rdf.value)} == {123.25}


def test_direction_takes_nothing_beyond_0_to_360_and_its_shape_says_so(flight: Flight) -> None:
    flight.standing()
    written(flight.put(DIRECTION, 45))
    found = shape(flight, DIRECTION)
    assert (found["minInclusive"], found["maxInclusive"]) == ({"0"}, {"360"})
    for value in (-0.5, 360.5):
        refused(flight, DIRECTION, value)
    assert flight.ask("/aircraft/engine/get_direction") == 45.0


def test_a_value_is_put_in_rdf_and_patched_with_sparql(flight: Flight) -> None:
    flight.standing()
    iri = rdf.value.value
    bodies = {
        "text/turtle": f"<> <{iri}> 33.5 .",
        "application/ld+json": f'{{"@id": "{flight.absolute(DIRECTION)}", "{iri}": 34.5}}',
    }
    for value, (media_type, body) in zip((33.5, 34.5), bodies.items(), strict=True):
        written(flight.http.put(DIRECTION, content=body, headers={"Content-Type": media_type}))
        assert flight.json(DIRECTION) == value
    update = f"DELETE {{ <> <{iri}> ?old }} INSERT {{ <> <{iri}> 12.5 }} WHERE {{ <> <{iri}> ?old }}"
    written(flight.http.patch(DIRECTION, content=update, headers={"Content-Type": "application/sparql-update"}))
    assert flight.json(DIRECTION) == 12.5


def test_a_write_can_ask_that_nothing_has_changed_meanwhile(flight: Flight) -> None:
    flight.standing()
    old = flight.get(DIRECTION).headers["etag"]
    written(flight.put(DIRECTION, (flight.json(DIRECTION) + 1) % 360))
    guarded = {"Content-Type": "application/json", "If-Match": old}
    assert flight.http.put(DIRECTION, content="7", headers=guarded).status_code == 412
    assert flight.json(DIRECTION) != 7


def test_the_listing_needs_no_mapping(serve: Callable[..., Any]) -> None:
    unmapped = Flight(serve("aircraft"))
    for one in unmapped.said("/mappings/", ldp.contains):
        assert unmapped.http.delete(one).status_code == 204
    assert unmapped.json("/resources/aircraft/").keys() == {"power", "registration", "seats"}
    assert unmapped.json("/resources/aircraft/engine/").keys() == {"speed", "direction", "cylinders"}
    for url in (POWER, SPEED, DIRECTION):
        assert unmapped.allowed(url) == {"GET", "PUT", "PATCH"}
    for name in ("start", "stop"):
        assert unmapped.allowed(f"/resources/aircraft/{name}") == {"GET", "POST"}, "an action, and no property"
