"""The vocabularies of mappings and of the aircraft: Turtle and constants say the same."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import pytest
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import PREFIXES, Namespace, av, mapping, rdf, rdfs, ros, sh, xsd

VOCABULARIES = {"mapping.ttl": mapping, "aircraft.ttl": av}
EACH = pytest.mark.parametrize("name", VOCABULARIES)


@cache
def turtle(name: str) -> tuple[Triple, ...]:
    text = files("rosld.ontology").joinpath(name).read_bytes()
    return tuple(quad.triple for quad in parse(text, format=RdfFormat.TURTLE))


def own(space: type[Namespace]) -> NamedNode:
    """The vocabulary itself."""
    return NamedNode(space.iri.rstrip("#"))


def objects(name: str, term: NamedNode, predicate: NamedNode) -> list[object]:
    return [each.object for each in turtle(name) if each.subject == term and each.predicate == predicate]


def classes(name: str) -> set[object]:
    return {each.subject for each in turtle(name) if each.predicate == rdf.type and each.object == rdfs.Class}


@EACH
def test_every_term_of_the_turtle_is_a_constant_and_every_constant_is_in_the_turtle(name: str) -> None:
    space = VOCABULARIES[name]
    assert {each.subject for each in turtle(name)} - {own(space)} == set(space.terms().values())


@EACH
def test_every_term_has_an_english_label_and_comment_and_says_who_defines_it(name: str) -> None:
    for term in VOCABULARIES[name].terms().values():
        (label,), (comment,) = objects(name, term, rdfs.label), objects(name, term, rdfs.comment)
        assert isinstance(label, Literal)
        assert (label.language, bool(label.value)) == ("en", True)
        assert isinstance(comment, Literal)
        assert (comment.language, comment.value.endswith(".")) == ("en", True)
        assert objects(name, term, rdfs.isDefinedBy) == [own(VOCABULARIES[name])]


@EACH
def test_domains_and_ranges_are_classes_that_exist(name: str) -> None:
    known = classes(name) | {ros.ComplexResource, sh.NodeShape, rdf.Property} | set(xsd.terms().values())
    for triple in turtle(name):
        if triple.predicate in (rdfs.domain, rdfs.range):
            assert triple.object in known, triple


@EACH
def test_classes_begin_with_a_capital_and_properties_do_not(name: str) -> None:
    for local, term in VOCABULARIES[name].terms().items():
        assert local[0].isupper() == (term in classes(name)), local
        assert (rdf.Property in objects(name, term, rdf.type)) != (term in classes(name)), local


@EACH
def test_the_vocabulary_says_its_title_and_its_prefix(name: str) -> None:
    space = VOCABULARIES[name]
    said = {each.predicate.value.rpartition("/")[2]: each.object for each in turtle(name) if each.subject == own(space)}
    assert isinstance(said["title"], Literal)
    prefix = said["preferredNamespacePrefix"]
    assert isinstance(prefix, Literal)
    assert PREFIXES[prefix.value] == space.iri
    assert said["preferredNamespaceUri"] == Literal(space.iri)


def test_the_shape_of_mappings_speaks_of_every_term_and_of_no_other() -> None:
    text = files("rosld.shapes").joinpath("mapping.ttl").read_bytes()
    triples = [quad.triple for quad in parse(text, format=RdfFormat.TURTLE, base_iri="http://x/")]
    named = {each.object for each in triples if isinstance(each.object, NamedNode)}
    assert {each for each in named if each.value.startswith(mapping.iri)} == set(mapping.terms().values())
