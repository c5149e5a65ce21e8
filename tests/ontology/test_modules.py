"""The modules of the ontology agree with the constants for their terms in Python."""

from __future__ import annotations

from collections import Counter
from importlib.resources import files
from itertools import combinations

import pytest
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, parse

from rosld.ontology.modules import (
    ALIGNMENTS,
    CORE,
    MODULES,
    OWN,
    VERSION,
    home_of_terms,
    module_iri,
    module_path,
    module_triples,
    served_triples,
    term_url,
)  # fmt: skip
from rosld.ontology.vocab import (
    PREFIXES,
    av,
    cora,
    dcterms,
    geo,
    ldp,
    mapping,
    owl,
    prov,
    qudt,
    rdf,
    rdfs,
    ros,
    rparts,
    sosa,
    td,
    xsd,
)
from tests.ontology.reasoning import VOCABULARIES
from tests.ontology.vocab_stub import STUB, stub

dcat, ease, soma = (
    "http://www.w3.org/ns/dcat#",
    "http://www.ease-crc.org/ont/ROS.owl#",
    "http://www.ease-crc.org/ont/SOMA.owl#",
)
VANN, SKOS = "http://purl.org/vocab/vann/", "http://www.w3.org/2004/02/skos/core#"
OURS = (ros, mapping, av)


def objects(name: str, subject: NamedNode, predicate: NamedNode) -> list[object]:
    return [each.object for each in module_triples(name) if (each.subject, each.predicate) == (subject, predicate)]


def terms_of(*names: str) -> dict[NamedNode, str]:
    """Return the terms that modules define, with the module of each."""
    return {NamedNode(iri): home for iri, home in home_of_terms().items() if home in names}


def every(*names: str) -> list[Triple]:
    return [triple for name in names for triple in module_triples(name)]


def test_every_file_is_a_module() -> None:
    folder = files("rosld.ontology")
    own = {each.name for each in folder.iterdir() if each.name.endswith(".ttl")}
    aligned = {f"align/{each.name}" for each in folder.joinpath("align").iterdir()}
    assert own | aligned == {module_path(name) for name in MODULES}


def test_a_file_holds_one_ontology_with_its_title_version_licence_and_citation() -> None:
    for name in MODULES:
        ontologies = {each.subject for each in module_triples(name) if each.object == owl.Ontology}
        iri = NamedNode(module_iri(name))
        assert ontologies == {iri}, name
        assert objects(name, iri, NamedNode(owl.iri + "versionIRI")) == [NamedNode(module_iri(name, VERSION))], name
        assert objects(name, iri, NamedNode(owl.iri + "versionInfo")) == [Literal(VERSION)], name
        once = ("title", "description", "creator", "created", "modified", "license", "bibliographicCitation")
        for term in (*once, "issued", "publisher"):
            found = objects(name, iri, NamedNode(dcterms.iri + term))
            assert len(found) == 1 or (found and term not in once), term
        assert len(objects(name, iri, NamedNode("http://purl.org/ontology/bibo/status"))) == 1, name


def test_a_module_imports_the_modules_whose_terms_it_uses() -> None:
    for name in MODULES:
        imports = set(objects(name, NamedNode(module_iri(name)), NamedNode(owl.iri + "imports")))
        reached, waiting = set[str](), {module_iri(name)}
        while waiting:
            reached |= waiting
            modules = [module for module in MODULES if module_iri(module) in waiting]
            found = {each.object for each in every(*modules) if each.predicate.value == f"{owl.iri}imports"}
            waiting = {each.value for each in found if isinstance(each, NamedNode)} - reached
        homes = home_of_terms()
        for triple in module_triples(name):
            if triple.predicate == NamedNode(SKOS + "scopeNote"):
                continue
            for term in (triple.subject, triple.object):
                if isinstance(term, NamedNode) and term.value in homes:
                    assert module_iri(homes[term.value]) in reached, (triple, reached)
        if name in ALIGNMENTS:
            foreign = [
                each for each in imports if isinstance(each, NamedNode) and not each.value.startswith("https://w3id")
            ]
            assert len(foreign) == 1, name


def test_a_module_that_defines_terms_declares_their_prefix() -> None:
    for name in OWN:
        iri = NamedNode(module_iri(name))
        [prefix], [namespace] = (
            objects(name, iri, NamedNode(f"{VANN}preferredNamespace{end}")) for end in ("Prefix", "Uri")
        )
        assert isinstance(prefix, Literal), name
        assert isinstance(namespace, Literal), name
        assert PREFIXES[prefix.value] == namespace.value, name


def test_every_term_is_a_constant_and_is_defined_once() -> None:
    assert set(terms_of(*OWN)) == {term for space in OURS for term in space.terms.values()}
    defined = Counter(each.subject for each in every(*OWN) if each.predicate == rdfs.isDefinedBy)
    assert [term for term, times in defined.items() if times != 1] == []


def test_the_stub_names_every_term() -> None:
    assert STUB.read_text("utf-8") == stub(), "write it again: python tests/ontology/vocab_stub.py"


@pytest.mark.slow
def test_every_term_has_an_english_label_and_comment() -> None:
    for term, home in terms_of(*OWN).items():
        assert objects(home, term, rdfs.isDefinedBy) == [NamedNode(module_iri(home))]
        assert objects(home, term, rdf.type)
        (label,), (comment,) = objects(home, term, rdfs.label), objects(home, term, rdfs.comment)
        assert isinstance(label, Literal)
        assert (label.language, bool(label.value)) == ("en", True)
        assert isinstance(comment, Literal)
        assert (comment.language, comment.value.endswith(".")) == ("en", True)


def test_no_label_stands_for_two_terms() -> None:
    """Neither do two terms differ by case alone."""
    labels = Counter(each.object.value.lower() for each in every(*OWN) if each.predicate == rdfs.label)
    names = Counter(term.value.lower() for term in terms_of(*OWN))
    assert [label for label, times in [*labels.items(), *names.items()] if times > 1] == []


def test_classes_and_individuals_of_classes_begin_with_a_capital_and_properties_do_not() -> None:
    for term, home in terms_of(*OWN).items():
        types = objects(home, term, rdf.type)
        local = term.value.partition("#")[2]
        if not any(isinstance(each, NamedNode) and each.value.endswith(("#Function", "#Aggregate")) for each in types):
            assert local[0].isupper() != (rdf.Property in types), term


def test_domains_and_ranges_are_declared_classes_or_datatypes() -> None:
    for name in MODULES:
        classes = {each.subject for each in module_triples(name) if each.object == owl.Class}
        for triple in module_triples(name):
            if triple.predicate in (rdfs.domain, rdfs.range):
                assert triple.object in classes | set(xsd.terms.values()), triple


def test_every_term_that_a_module_uses_is_declared_in_it() -> None:
    for name in MODULES:
        declared = {each.subject for each in module_triples(name) if each.predicate == rdf.type}
        builtin = (rdf.iri, rdfs.iri, owl.iri, xsd.iri, "http://purl.org/ontology/bibo/status/")
        documents = (NamedNode(owl.iri + "imports"), NamedNode(owl.iri + "versionIRI"), rdfs.seeAlso, rdfs.isDefinedBy)
        for triple in module_triples(name):
            is_about_documents = triple.predicate in documents or triple.predicate.value.startswith(dcterms.iri)
            for term in (triple.subject, triple.predicate, *([] if is_about_documents else [triple.object])):
                if isinstance(term, NamedNode) and not term.value.startswith(builtin):
                    assert term in declared, triple


def test_inverse_properties_have_domain_and_range_the_other_way_round() -> None:
    homes = terms_of(*OWN)
    pairs = [each for each in every(*OWN) if each.predicate == NamedNode(owl.iri + "inverseOf")]
    assert len(pairs) >= 8
    for pair in pairs:
        assert isinstance(pair.subject, NamedNode)
        assert isinstance(pair.object, NamedNode)
        for one, other in ((pair.subject, pair.object), (pair.object, pair.subject)):
            domain, range = objects(homes[one], one, rdfs.domain), objects(homes[other], other, rdfs.range)
            assert not (domain and range) or domain == range, pair


def test_classes_of_one_module_are_told_apart() -> None:
    """They are in an owl:AllDisjointClasses, except subclasses, and the states, which overlap."""
    disjoint = set()
    for name in OWN:
        for each in module_triples(name):
            if each.predicate == NamedNode(owl.iri + "members"):
                disjoint |= set(combinations(sorted(_members(name, each.object), key=str), 2))
    assert len(disjoint) > 200
    parents = {(each.subject, each.object) for each in every(*OWN) if each.predicate == rdfs.subClassOf}
    assert not disjoint & (parents | {(b, a) for a, b in parents})


def _members(name: str, first: object) -> list[NamedNode]:
    found: list[NamedNode] = []
    while isinstance(first, BlankNode):
        [value] = [each.object for each in module_triples(name) if (each.subject, each.predicate) == (first, rdf.first)]
        assert isinstance(value, NamedNode)
        found.append(value)
        [first] = [each.object for each in module_triples(name) if (each.subject, each.predicate) == (first, rdf.rest)]
    return found


def test_alignments_speak_of_terms_that_exist_and_define_none() -> None:
    known = set(terms_of(*OWN)) | {NamedNode(module_iri(name, v)) for name in MODULES for v in ("", VERSION)}
    for triple in every(*ALIGNMENTS):
        for term in (triple.subject, triple.object):
            if (
                isinstance(term, NamedNode)
                and term.value.startswith("https://w3id.org/rosld")
                and VERSION not in term.value
            ):
                assert term in known, triple


def test_every_foreign_term_of_an_alignment_and_every_such_constant_exists() -> None:
    """The files of the other vocabularies declare it, in SOSA's case that of the edition of 2023."""
    declared: dict[str, set[str]] = {}
    for path in VOCABULARIES.glob("*.ttl"):
        for quad in parse(path.read_bytes(), format=RdfFormat.TURTLE):
            if quad.predicate == rdf.type and isinstance(quad.subject, NamedNode):
                declared.setdefault(quad.subject.value, set()).add(path.stem)
    constants = {each for space in (sosa, qudt, geo, cora, rparts, ldp, prov, td) for each in space.terms.values()}
    aligned = {each for triple in every(*ALIGNMENTS) for each in (triple.subject, triple.object)}
    spaces = (sosa.iri, qudt.iri, geo.iri, cora.iri, rparts.iri, ldp.iri, prov.iri, td.iri, dcat, ease, soma)
    foreign = {each.value for each in constants | aligned if isinstance(each, NamedNode)}
    found = {iri for iri in foreign if iri.startswith(spaces) and iri not in spaces}
    assert len(found) > 90
    assert {iri for iri in found if iri not in declared} == {td.hasInstanceConfiguration.value}, "W3C's context has it"
    assert {iri for iri in found if iri.startswith(sosa.iri) and "sosa-2023" not in declared[iri]} == set()


def test_no_term_that_sosa_has_given_up_is_used() -> None:
    used = {term.value for each in every(*MODULES) for term in each if isinstance(term, NamedNode)}
    ssn = "http://www.w3.org/ns/ssn/"
    assert not {iri for iri in used if iri.startswith(ssn)}
    assert not used & {f"http://www.w3.org/ns/sosa/{name}" for name in ("ObservableProperty", "ActuatableProperty")}


def test_the_core_leads_to_every_module_and_to_every_other_term_of_its_namespace() -> None:
    core = NamedNode(module_iri(CORE))
    linked = set(objects(CORE, core, rdfs.seeAlso))
    assert linked == {NamedNode(module_iri(name)) for name in MODULES if name != CORE}
    served = set(served_triples(CORE))
    for iri, home in home_of_terms().items():
        if iri.startswith(ros.iri):
            assert Triple(NamedNode(iri), rdfs.isDefinedBy, NamedNode(module_iri(home))) in served, iri


@pytest.mark.parametrize(
    ("iri", "place"),
    [
        (ros.Topic.value, "ontology#Topic"),
        (ros.Call.value, "ontology/interaction#Call"),
        (ros.MessageType.value, "ontology/types#MessageType"),
        (f"{ros.iri}none", "ontology#none"),
        (mapping.path.value, "ontology/mapping#path"),
        (av.power.value, "ontology/aircraft#power"),
        ("https://w3id.org/rosld", "ontology"),
        ("https://w3id.org/rosld/align-prov", "ontology/align-prov"),
        (f"https://w3id.org/rosld/{VERSION}/types", "ontology/types"),
        ("https://w3id.org/rosld/none", None),
    ],
)
def test_a_term_is_found_in_the_module_that_defines_it(iri: str, place: str | None) -> None:
    assert term_url(iri, "http://h/") == (None if place is None else f"http://h/{place}")


def test_the_shape_of_mappings_speaks_of_every_term_and_of_no_other() -> None:
    text = files("rosld.shapes").joinpath("mapping.ttl").read_bytes()
    triples = [quad.triple for quad in parse(text, format=RdfFormat.TURTLE, base_iri="http://x/")]
    named = {each.object for each in triples if isinstance(each.object, NamedNode)}
    spoken = {each for each in named if each.value.startswith(mapping.iri)}
    assert spoken == set(mapping.terms.values())
