"""Checks of OOPS! and FOOPS! that a program can do; docs/reference/ontology.md lists all of them.

The numbers are theirs (https://oops.linkeddata.es/catalogue.jsp, https://w3id.org/foops/catalogue).
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from pyoxigraph import NamedNode, Triple

from rosld.ontology.modules import CORE, MODULES, OWN, home_of_terms, module_iri, module_triples
from rosld.ontology.vocab import owl, rdf, rdfs, schema_org

TABLE = (Path(__file__).parents[2] / "docs" / "reference" / "ontology.md").read_text(encoding="utf-8")
FOOPS = [
    "CN1", "DOC1", "FIND1", "FIND2", "FIND3", "FIND_3_BIS", "HTTP1", "OM1", "OM2", "OM3", "OM4.1", "OM4.2", "OM5.1",
    "OM5.2", "PURL1", "RDF1", "URI1", "URI2", "VER1", "VER2", "VOC1", "VOC2", "VOC3", "VOC4",
]  # fmt: skip
DCTERMS, VANN = "http://purl.org/dc/terms/", "http://purl.org/vocab/vann/"
CLASS = NamedNode(owl.iri + "Class")
INVERSE = NamedNode(owl.iri + "inverseOf")
DATATYPE_PROPERTY = NamedNode(owl.iri + "DatatypeProperty")


def triples(*names: str) -> list[Triple]:
    return [each for name in names for each in module_triples(name)]


def own(kind: NamedNode) -> set[NamedNode]:
    """Return the terms of a kind that the modules define."""
    found = {each.subject for each in triples(*OWN) if (each.predicate, each.object) == (rdf.type, kind)}
    return {node for node in found if isinstance(node, NamedNode) and node.value in home_of_terms()}


def header(name: str) -> dict[str, list[object]]:
    """Return the statements of a module about itself."""
    found: dict[str, list[object]] = {}
    for each in module_triples(name):
        if each.subject == NamedNode(module_iri(name)):
            found.setdefault(each.predicate.value, []).append(each.object)
    return found


def test_every_check_is_told_of_once() -> None:
    rows = Counter(re.findall(r"^\| ([A-Z0-9_.]+) \|", TABLE, re.MULTILINE))
    assert rows == Counter([*FOOPS, *(f"P{number:02}" for number in range(1, 42))])


def test_every_test_that_is_named_is_there() -> None:
    folder = Path(__file__).parents[1]
    places = [*folder.glob("ontology/test_*.py"), *folder.glob("server/test_ontology.py")]
    places += [*folder.glob("interop/ontology/test_*.py"), *folder.glob("interop/apache/test_*.py")]
    there = {name for path in places for name in re.findall(r"^def (test_\w+)", path.read_text("utf-8"), re.MULTILINE)}
    named = set(re.findall(r"`(test_\w+)`", TABLE))
    assert named
    assert named <= there


# OOPS!


def test_p03_p21_and_p36_no_name_says_nothing_or_has_a_file_extension() -> None:
    terms = own(CLASS) | own(owl.ObjectProperty) | own(DATATYPE_PROPERTY)
    names = {node.value.rpartition("#")[2].lower() for node in terms}
    assert not names & {"is", "isa", "is_a", "kindof", "other", "others", "misc", "miscellaneous", "thing", "object"}
    assert not [name for name in MODULES if re.search(r"\.(owl|rdf|ttl|n3|rdfxml)\b", module_iri(name))]


def test_p04_every_class_is_connected() -> None:
    relations = (
        rdfs.domain,
        rdfs.range,
        schema_org.domainIncludes,
        schema_org.rangeIncludes,
        rdfs.subClassOf,
        rdf.type,
    )
    connected = {each.object for each in triples(*OWN) if each.predicate in relations}
    connected |= {each.subject for each in triples(*OWN) if each.predicate == rdfs.subClassOf}
    assert not own(CLASS) - connected


def test_p06_no_class_is_a_subclass_of_itself() -> None:
    parents: dict[object, set[object]] = {}
    for each in triples(*MODULES):
        if each.predicate == rdfs.subClassOf:
            parents.setdefault(each.subject, set()).add(each.object)
    for start in parents:
        above, waiting = set[object](), set(parents[start])
        while waiting:
            above |= (found := waiting)
            waiting = {more for one in found for more in parents.get(one, ())} - above
        assert start not in above


def test_p11_most_properties_have_domain_and_range() -> None:
    """The number of the others, whose comments say why, must not grow."""
    properties = own(owl.ObjectProperty) | own(DATATYPE_PROPERTY)
    said = triples(*OWN)
    with_domain = {each.subject for each in said if each.predicate in (rdfs.domain, schema_org.domainIncludes)}
    with_range = {each.subject for each in said if each.predicate in (rdfs.range, schema_org.rangeIncludes)}
    assert len(properties - with_domain) <= 40
    assert len(properties - with_range) <= 20


def test_p19_no_property_has_two_domains_or_ranges() -> None:
    for predicate in (rdfs.domain, rdfs.range):
        times = Counter(each.subject for each in triples(*OWN) if each.predicate == predicate)
        assert [node for node, number in times.items() if number > 1] == []


def test_p25_to_p29_and_p33_no_property_is_its_own_inverse_symmetric_transitive_or_a_chain() -> None:
    said = triples(*MODULES)
    assert not [each for each in said if each.predicate == INVERSE and each.subject == each.object]
    characteristics = {NamedNode(f"{owl.iri}{name}Property") for name in ("Symmetric", "Transitive", "Reflexive")}
    assert not [each for each in said if each.predicate == rdf.type and each.object in characteristics]
    assert not [each for each in said if each.predicate.value == owl.iri + "propertyChainAxiom"]


def test_p40_a_module_defines_terms_of_its_own_namespaces_only() -> None:
    for name in MODULES:
        for each in module_triples(name):
            if each.predicate == rdfs.isDefinedBy and isinstance(each.subject, NamedNode):
                assert each.subject.value.startswith("https://w3id.org/rosld"), each


# FOOPS!


def test_voc1_and_voc2_other_vocabularies_are_used() -> None:
    assert {DCTERMS + "title", VANN + "preferredNamespacePrefix"} <= header(CORE).keys()
    imported = {each.object for each in triples(*MODULES) if each.predicate.value == owl.iri + "imports"}
    assert len([each for each in imported if isinstance(each, NamedNode) and "w3id.org/rosld" not in each.value]) > 5
