"""The vocabulary in Turtle and its constants in Python say the same."""

from __future__ import annotations

from importlib.resources import files

import pytest
from pyoxigraph import Literal, NamedNode, RdfFormat, Store, Triple, parse

from rosld.ontology.vocab import PREFIXES, Namespace, ldp, rdf, rdfs, ros, sh, xsd

ROSLD = NamedNode("https://w3id.org/rosld")
OWL = "http://www.w3.org/2002/07/owl#"


def turtle(name: str) -> list[Triple]:
    text = files("rosld.ontology").joinpath(name).read_bytes()
    return [quad.triple for quad in parse(text, format=RdfFormat.TURTLE)]


@pytest.fixture(scope="module")
def vocabulary() -> list[Triple]:
    return turtle("rosld.ttl")


def test_every_term_of_the_turtle_is_a_constant_and_every_constant_is_in_the_turtle(vocabulary: list[Triple]) -> None:
    defined = {t.subject for t in vocabulary if isinstance(t.subject, NamedNode) and t.subject != ROSLD}
    assert defined == set(ros.terms().values())


def test_every_term_has_an_english_label_and_comment_and_says_who_defines_it(vocabulary: list[Triple]) -> None:
    def objects(term: NamedNode, predicate: NamedNode) -> list[object]:
        return [t.object for t in vocabulary if t.subject == term and t.predicate == predicate]

    for term in ros.terms().values():
        (label,), (comment,) = objects(term, rdfs.label), objects(term, rdfs.comment)
        assert isinstance(label, Literal)
        assert label.language == "en"
        assert label.value
        assert isinstance(comment, Literal)
        assert comment.language == "en"
        assert comment.value.endswith(".")
        assert objects(term, rdfs.isDefinedBy) == [ROSLD]
        assert objects(term, rdf.type)


def test_domains_and_ranges_are_classes_of_the_vocabulary_or_datatypes(vocabulary: list[Triple]) -> None:
    classes = {t.subject for t in vocabulary if t.predicate == rdf.type and t.object == rdfs.Class}
    for triple in vocabulary:
        if triple.predicate in (rdfs.domain, rdfs.range):
            assert triple.object in classes | set(xsd.terms().values()), triple


def test_classes_begin_with_a_capital_and_properties_do_not(vocabulary: list[Triple]) -> None:
    types: dict[str, set[object]] = {}
    for triple in vocabulary:
        if triple.predicate == rdf.type and isinstance(triple.subject, NamedNode) and triple.subject != ROSLD:
            types.setdefault(triple.subject.value.removeprefix(ros.iri), set()).add(triple.object)
    for name, kinds in types.items():
        assert name[0].isupper() != bool(kinds & {rdf.Property, ros.Function}), name


def test_alignments_speak_only_of_terms_that_exist() -> None:
    known = set(ros.terms().values())
    for triple in turtle("align.ttl"):
        assert isinstance(triple.subject, NamedNode)
        if triple.subject.value.startswith(ros.iri):
            assert triple.subject in known
            assert not (isinstance(triple.object, NamedNode) and triple.object.value.startswith(ros.iri))


def test_alignments_reach_all_the_vocabularies_they_promise() -> None:
    objects = " ".join(str(t.object) for t in turtle("align.ttl"))
    for iri in (
        "http://www.w3.org/ns/sosa/",
        "http://www.w3.org/ns/ssn/",
        "https://www.w3.org/2019/wot/td#",
        "https://www.w3.org/2019/wot/hypermedia#",
        "http://www.w3.org/ns/prov#",
        ldp.iri,
        "http://www.ease-crc.org/ont/ROS.owl#",
    ):
        assert iri in objects


def test_both_files_load_into_a_store_together() -> None:
    store = Store()
    for name in ("rosld.ttl", "align.ttl"):
        store.load(files("rosld.ontology").joinpath(name).read_bytes(), format=RdfFormat.TURTLE)
    ask = f"ASK {{ <{ros.Node.value}> a <{OWL}Class> ; <{rdfs.subClassOf.value}> <{ldp.RDFSource.value}> }}"
    assert bool(store.query(ask))


def test_a_trailing_underscore_is_no_part_of_a_term() -> None:
    assert sh.or_ == NamedNode("http://www.w3.org/ns/shacl#or")
    assert sh.class_ == NamedNode("http://www.w3.org/ns/shacl#class")


def test_prefixes_are_those_people_know() -> None:
    assert issubclass(ros, Namespace)
    assert PREFIXES["ros"] == "https://w3id.org/rosld#"
    assert PREFIXES["ldp"] == "http://www.w3.org/ns/ldp#"
    assert len(set(PREFIXES.values())) == len(PREFIXES)
