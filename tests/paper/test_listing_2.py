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


JOINED: dict[str, tuple[str, str, tuple[Any, ...]]] = {
    POWER: ("/services/aircraft/get_power", "/services/aircraft/set_power", ("off", "on")),
    SPEED: ("/topics/aircraft/engine/speed", "/services/aircraft/engine/set_speed", (0.0, 1000.0, 10.0)),
    DIRECTION: ("/services/aircraft/engine/get_direction", "/services/aircraft/engine/set_direction", (0.0, 123.25)),
}
"""Source, target and values over the whole range of each resource."""
JUDGED: dict[str, tuple[dict[str, set[str]], object, tuple[object, ...]]] = {
    POWER: ({"in": {"on", "off"}}, "on", ("maybe", "ON", "")),
    SPEED: ({"minInclusive": {"0"}, "maxInclusive": {"1000"}}, 0.0, (-0.5, 1000.5, 5000, "NaN")),
    DIRECTION: ({"minInclusive": {"0"}, "maxInclusive": {"360"}}, 45.0, (-0.5, 360.5)),
}
"""Constraints, a value and refused values of each resource."""


def test_a_getter_or_topic_and_a_setter_are_one_resource(flight: Flight) -> None:
    flight.standing()
    for url, (reads, writes, values) in JOINED.items():
        assert flight.said(url, ros.readsFrom) == {reads}
        assert writes in flight.said(url, ros.writesTo)
        assert flight.allowed(url) == {"GET", "PUT", "PATCH"}
        for value in values:
            written(flight.put(url, value))
        until(lambda url=url, value=values[-1]: flight.json(url) == value, url)
        (shown,) = flight.said(url, rdf.value)
        assert type(values[-1])(shown) == values[-1]
    assert (flight.ask("/aircraft/get_power"), flight.ask("/aircraft/engine/get_direction")) == ("on", 123.25)
    assert flight.robot_speed() == 10.0


def test_a_resource_takes_nothing_beyond_its_range_and_its_shape_says_so(flight: Flight) -> None:
    flight.standing()
    written(flight.put(DIRECTION, 45))
    for url, (constraints, value, others) in JUDGED.items():
        found = shape(flight, url)
        assert {name: found.get(name) for name in constraints} == constraints
        for other in others:
            refused(flight, url, other)
        assert flight.json(url) == value
    for other in (1, True, ["on"], {"data": "maybe"}, {"power": "on"}):
        assert flight.put(POWER, other).status_code == 422


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
