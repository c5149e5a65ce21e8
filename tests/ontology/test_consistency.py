"""The server's statements are consistent with the ontology of their terms, and with third-party ontologies.

The reasoner is reasonable, an implementation of OWL 2 RL by W3C's rules. `make interop` runs HermiT on the same.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from pyoxigraph import NamedNode, RdfFormat, Triple, parse
from rdflib import Graph

from rosld.ontology.vocab import PREFIXES, ros
from tests.crawl.robots import ROBOTS
from tests.crawl.site import Site, site
from tests.ontology.reasoning import closure, contradictions, of_triples, ontologies

pytestmark = pytest.mark.slow

TURTLE = "".join(f"@prefix {prefix}: <{iri}> . " for prefix, iri in PREFIXES.items())
ROOMS = {"goals", "calls", "holds", "activity", "topics", "nodes", "services", "actions", "parameters", "types"}
CHANGING = (ros.state, ros.status, ros.statusWord, ros.briefValue)
"""Properties of members in listings, which are those of an earlier moment."""
WITHOUT_INSTANCES = ("FieldConstraintComponent", "StepConstraintComponent")
"""Individuals with names like those of classes."""


def told(robot: Site, most: int = 2) -> Iterable[Triple]:
    """Yield the statements of a robot's first documents of each kind, without changing ones about other resources."""
    for url in robot.of_each_kind(most):
        for triple in robot.documents[url].triples:
            is_own = not isinstance(triple.subject, NamedNode) or triple.subject.value.partition("#")[0] == url
            if is_own or triple.predicate not in CHANGING:
                yield triple


def all_robots() -> Graph:
    """The ontologies, an instance of each class, and the statements of all robots."""
    graph = ontologies()
    own = [iri for name, iri in ros.terms.items() if name[0].isupper() and name not in WITHOUT_INSTANCES]
    graph += of_triples(triples("".join(f"[] a <{iri.value}> . " for iri in own)))
    for name in ROBOTS:
        graph += of_triples(told(site(name)))
    return graph


@pytest.mark.ros2
def test_what_the_robots_say_is_consistent_and_every_class_can_have_instances() -> None:
    graph = all_robots()
    assert len(graph) > 30_000
    for name in ROBOTS:
        base = site(name).base
        rooms = {
            str(each).removeprefix(base).partition("/")[0] for each in graph.subjects() if str(each).startswith(base)
        }
        assert name == "recording" or rooms >= ROOMS, name
    assert contradictions(closure(graph)) == []


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


def test_a_mistake_is_found() -> None:
    graph = ontologies()
    for number, mistake in enumerate(MISTAKES):  # each is about distinct IRIs
        graph += of_triples(triples(mistake.replace("urn:", f"urn:{number}:")))
    found = contradictions(closure(graph))
    missed = [mistake for n, mistake in enumerate(MISTAKES) if not any(f"urn:{n}:" in each for each in found)]
    assert not missed, missed


def triples(turtle: str) -> list[Triple]:
    found = parse(TURTLE + turtle, format=RdfFormat.TURTLE)
    return [Triple(each.subject, each.predicate, each.object) for each in found]
