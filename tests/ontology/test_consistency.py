"""What the server says is consistent with what it says that its terms mean, and with the ontologies of others.

The reasoner is reasonable, an implementation of OWL 2 RL by W3C's rules. `make interop` gives the same to HermiT.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeAlias

import httpx
import pytest
from pyoxigraph import RdfFormat, Triple, parse
from rdflib import Graph

from rosld.ontology.vocab import PREFIXES, ros
from tests.ontology import robots
from tests.ontology.crawl import Crawl
from tests.ontology.reasoning import closure, contradictions, of_triples, ontologies

Robot: TypeAlias = Callable[[], AbstractContextManager[httpx.Client]]
TURTLE = "".join(f"@prefix {prefix}: <{iri}> . " for prefix, iri in PREFIXES.items())


@pytest.fixture(scope="module")
def aircraft() -> Iterator[Crawl]:
    """What the aircraft says."""
    with robots.aircraft() as http:
        yield robots.told(http)


def judged(found: Crawl) -> list[str]:
    graph = ontologies()
    graph += of_triples(found.triples())
    return contradictions(closure(graph))


def test_the_ontologies_are_consistent_and_every_class_can_have_instances() -> None:
    graph = ontologies()
    own = [iri for iri in ros.terms().values() if iri.value.rpartition("#")[2][0].isupper()]
    graph += of_triples(triples("".join(f"[] a <{iri.value}> . " for iri in own if iri not in STATES)))
    assert contradictions(closure(graph)) == []


STATES = {iri for name, iri in ros.terms().items() if name in ("FieldConstraintComponent", "StepConstraintComponent")}


def test_what_the_aircraft_says_is_consistent(aircraft: Crawl) -> None:
    assert {"goals", "calls", "holds", "activity"} <= {url.split("/")[3] for url in aircraft.graphs}
    assert judged(aircraft) == []


def test_what_the_rover_says_is_consistent() -> None:
    with robots.rover() as http:
        assert judged(robots.told(http)) == []


def test_what_a_real_ros_1_says_is_consistent(tmp_path: Path) -> None:
    with robots.a_ros_1(tmp_path) as http:
        assert judged(robots.told(http)) == []


@pytest.mark.ros2
def test_what_a_real_ros_2_says_is_consistent() -> None:
    with robots.a_ros_2("jazzy") as http:
        assert judged(robots.told(http)) == []


MISTAKES = (
    "<urn:receipt> a ros:Write ; prov:generated <urn:call> . <urn:call> a ros:Call .",
    "<urn:message> a ros:Message ; prov:wasAttributedTo <urn:node> . <urn:message> a prov:Activity .",
    "<urn:thing> a ros:Topic , ros:Node .",
    "<urn:node> ros:publishes <urn:service> . <urn:service> a ros:Service .",
    "<urn:node> ros:provides <urn:node> . <urn:node> ros:publishes <urn:topic> . <urn:topic> ros:client <urn:node> .",
    "<urn:goal> ros:status ros:Executing , ros:Aborted .",
    "<urn:robot> ros:state ros:Live , ros:Stale .",
    '<urn:goal> ros:goalId "a" , "b" .',
    '<urn:topic> ros:rate "1"^^xsd:integer .',
    "<urn:topic> ros:name <urn:name> .",
    '<urn:node> ros:publishes "chatter" .',
    "<urn:call> ros:isCallOf <urn:one> . <urn:one> a ros:Service , ros:Parameter .",
    '<urn:robot> ros:longestPause "1"^^xsd:double ; ros:reliability "reliable" ; ros:runId "a" .',
)


@pytest.fixture(scope="module")
def found() -> list[str]:
    """What is found wrong in all mistakes together, each of which is about IRIs of its own."""
    graph = ontologies()
    for number, mistake in enumerate(MISTAKES):
        graph += of_triples(triples(mistake.replace("urn:", f"urn:{number}:")))
    return contradictions(closure(graph))


@pytest.mark.parametrize("number", range(len(MISTAKES)), ids=MISTAKES)
def test_a_mistake_is_found(found: list[str], number: int) -> None:
    assert [each for each in found if f"urn:{number}:" in each] != []


def triples(turtle: str) -> list[Triple]:
    found = parse(TURTLE + turtle, format=RdfFormat.TURTLE)
    return [Triple(each.subject, each.predicate, each.object) for each in found]


def test_the_graph_that_is_judged_has_what_was_crawled(aircraft: Crawl) -> None:
    assert len(of_triples(aircraft.triples())) == len(aircraft.triples()) > 4_000
    assert isinstance(ontologies(), Graph)
