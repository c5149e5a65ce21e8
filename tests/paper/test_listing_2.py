"""The paper's Listing 2: the aircraft as resources that are read and updated (level two), by names alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest
from pyoxigraph import NamedNode

from rosld.ontology.vocab import rdf, ros, sh

POWER = "/resources/aircraft/power"
SPEED = "/resources/aircraft/engine/speed"
DIRECTION = "/resources/aircraft/engine/direction"
TURTLE = {"Content-Type": "text/turtle"}
RESULT, REPORT, IN = (sh.iri + name for name in ("result", "ValidationReport", "in"))


def written(answer: httpx.Response) -> None:
    """The write was carried out, and no resource was made."""
    assert answer.status_code == 204, answer.text
    assert "location" not in answer.headers


def refused(flight: Any, url: str, value: object) -> None:
    """A value is outside of the line's range: 422 with the SHACL report, from rosld and not from the robot."""
    answer = flight.put(url, value)
    assert (answer.status_code, answer.json()["title"]) == (422, "Does not fit"), answer.text
    assert answer.json()["violations"]
    assert "words" not in answer.json()  # the robot was not asked
    report = flight.send("PUT", url, value, "text/turtle")
    triples = {(one.subject.value, one.predicate.value, one.object.value) for one in flight.triples(report)}
    assert any(each[1:] == (rdf.type.value, REPORT) for each in triples)
    assert any(predicate == RESULT for _, predicate, _ in triples)


def shape(flight: Any, url: str) -> dict[str, set[str]]:
    """The constraints on the value of a resource, as the affordance in its representation has them."""
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
    """The items of an rdf:List."""
    items: list[str] = []
    while node != rdf.nil:
        after = {one.predicate: one.object for one in triples if one.subject == node}
        items.append(after[rdf.first].value)
        node = after[rdf.rest]
    return items


# /aircraft/power : on | off


def test_power_is_read_as_on_or_off(flight: Any) -> None:
    for state, word in (("off", "off"), ("standing", "on")):
        flight.in_state(state)
        assert flight.json(POWER) == word
        assert flight.said(POWER, rdf.value) == {word}
        assert flight.robot.ask("/aircraft/get_power") == word


def test_power_is_updated_to_on_or_off(flight: Any) -> None:
    flight.off()
    for word in ("on", "off"):
        written(flight.put(POWER, word))
        assert flight.robot.ask("/aircraft/get_power") == word
        assert flight.json(POWER) == word


def test_power_takes_nothing_else_and_its_shape_says_so(flight: Any) -> None:
    flight.off()
    assert shape(flight, POWER)["in"] == {"on", "off"}
    for value in ("maybe", "ON", ""):
        refused(flight, POWER, value)
    for value in (1, True, ["on"], {"data": "maybe"}, {"power": "on"}):
        assert flight.put(POWER, value).status_code == 422
    assert flight.robot.ask("/aircraft/get_power") == "off"


def test_power_joins_the_getter_and_the_setter_that_are_named_after_it(flight: Any) -> None:
    assert flight.said(POWER, ros.readsFrom) == {"/services/aircraft/get_power"}
    assert flight.said(POWER, ros.writesTo) == {"/services/aircraft/set_power"}
    assert flight.allowed(POWER) == {"GET", "PUT", "PATCH"}


# /aircraft/engine/speed : 0 - 1000


def test_speed_is_read_as_a_number_from_the_topic(flight: Any) -> None:
    flight.flying()
    assert flight.said(SPEED, ros.readsFrom) == {"/topics/aircraft/engine/speed"}
    assert flight.json(SPEED) == flight.robot.hear("/aircraft/engine/speed") == 20.0
    assert {float(value) for value in flight.said(SPEED, rdf.value)} == {20.0}


def test_speed_is_updated_through_its_setter(flight: Any) -> None:
    flight.standing()
    assert "/services/aircraft/engine/set_speed" in flight.said(SPEED, ros.writesTo)
    written(flight.put(SPEED, 10))
    flight.until(lambda: flight.json(SPEED) == 10.0, "the speed")
    assert flight.robot.hear("/aircraft/engine/speed") == 10.0


@pytest.mark.parametrize("value", [0, 1000])
def test_speed_takes_the_ends_of_its_range(flight: Any, value: float) -> None:
    flight.standing()
    written(flight.put(SPEED, value))


def test_speed_takes_nothing_beyond_0_to_1000_and_its_shape_says_so(flight: Any) -> None:
    flight.flying()
    found = shape(flight, SPEED)
    assert (found["minInclusive"], found["maxInclusive"]) == ({"0"}, {"1000"})
    for value in (-0.5, 1000.5, 5000, "NaN"):
        refused(flight, SPEED, value)
    assert flight.robot.hear("/aircraft/engine/speed") == 20.0


# /aircraft/engine/direction : 0 - 360


def test_direction_is_read_as_a_number_from_its_getter(flight: Any) -> None:
    flight.standing()
    written(flight.put(DIRECTION, 123.25))
    assert flight.said(DIRECTION, ros.readsFrom) == {"/services/aircraft/engine/get_direction"}
    assert flight.json(DIRECTION) == flight.robot.ask("/aircraft/engine/get_direction") == 123.25
    assert {float(value) for value in flight.said(DIRECTION, rdf.value)} == {123.25}


def test_direction_is_updated_through_its_setter(flight: Any) -> None:
    flight.standing()
    assert flight.said(DIRECTION, ros.writesTo) == {"/services/aircraft/engine/set_direction"}
    for value in (0, 360, 270):
        written(flight.put(DIRECTION, value))
        assert flight.json(DIRECTION) == value
    assert flight.robot.ask("/aircraft/engine/get_direction") == 270.0


def test_direction_takes_nothing_beyond_0_to_360_and_its_shape_says_so(flight: Any) -> None:
    flight.standing()
    written(flight.put(DIRECTION, 45))
    found = shape(flight, DIRECTION)
    assert (found["minInclusive"], found["maxInclusive"]) == ({"0"}, {"360"})
    for value in (-0.5, 360.5):
        refused(flight, DIRECTION, value)
    assert flight.robot.ask("/aircraft/engine/get_direction") == 45.0


# Further than the listing


@pytest.mark.parametrize(
    ("media_type", "body"),
    [
        ("text/turtle", "<> {value} 33.5 ."),
        ("application/n-triples", '<{url}> {value} "33.5"^^<http://www.w3.org/2001/XMLSchema#double> .'),
        ("application/ld+json", '{{"@id": "{url}", "{iri}": 33.5}}'),
    ],
)
def test_a_value_is_put_in_rdf_as_well(flight: Any, media_type: str, body: str) -> None:
    flight.standing()
    iri = rdf.value.value
    content = body.format(value=f"<{iri}>", iri=iri, url=flight.absolute(DIRECTION))
    written(flight.http.put(DIRECTION, content=content, headers={"Content-Type": media_type}))
    assert flight.json(DIRECTION) == 33.5


def test_a_value_is_patched_with_sparql(flight: Any) -> None:
    flight.standing()
    update = f"DELETE {{ <> <{rdf.value.value}> ?old }} INSERT {{ <> <{rdf.value.value}> 12.5 }} "
    update += f"WHERE {{ <> <{rdf.value.value}> ?old }}"
    written(flight.http.patch(DIRECTION, content=update, headers={"Content-Type": "application/sparql-update"}))
    assert flight.json(DIRECTION) == 12.5


def test_a_write_can_ask_that_nothing_has_changed_meanwhile(flight: Any) -> None:
    flight.standing()
    old = flight.get(DIRECTION).headers["etag"]
    written(flight.put(DIRECTION, (flight.json(DIRECTION) + 1) % 360))
    guarded = {"Content-Type": "application/json", "If-Match": old}
    assert flight.http.put(DIRECTION, content="7", headers=guarded).status_code == 412
    assert flight.json(DIRECTION) != 7


@pytest.fixture
def unmapped(flight: Any, beside: Callable[..., Any]) -> Any:
    """The same aircraft without its mapping."""
    other = beside(mapped=False)
    listed = other.said("/mappings/", NamedNode("http://www.w3.org/ns/ldp#contains"))
    for one in listed:
        assert other.http.delete(one).status_code == 204
    return other


def test_start_and_stop_are_actions_that_the_names_alone_do_not_make_properties(unmapped: Any) -> None:
    for name in ("start", "stop"):
        assert unmapped.allowed(f"/resources/aircraft/{name}") == {"GET", "POST"}


def test_the_listing_needs_no_mapping(unmapped: Any) -> None:
    assert unmapped.json("/resources/aircraft/").keys() == {"power", "registration", "seats"}
    assert unmapped.json("/resources/aircraft/engine/").keys() == {"speed", "direction", "cylinders"}
    for url in (POWER, SPEED, DIRECTION):
        assert unmapped.allowed(url) == {"GET", "PUT", "PATCH"}
