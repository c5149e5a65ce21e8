"""Declarations of parameters as RDF, as a SHACL shape, and in the validation of values."""

from __future__ import annotations

from dataclasses import replace

import pytest
import rdflib
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode
from rdflib.namespace import RDF, SH

from rosld.adapters.model import Descriptor, ParameterType, ParameterValue, Range
from rosld.ontology.document import Document
from rosld.ontology.parameters import parameter_document
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.ontology.vocab import dcterms, ros, sh
from rosld.shapes.parameter import constraint_url, declared_triples, violations

SPACE = Space("http://127.0.0.1:8080/")
NAME = "/driver/frequency"
URL = SPACE.parameter(NAME)
FREQUENCY = Descriptor(
    ParameterType.INTEGER, "How often it looks.", constraints="A prime is best.", range=Range(10, 60, 10)
)
GAIN = Descriptor(ParameterType.DOUBLE, range=Range(0.0, 1.0, 0.1))


def graph_of(value: ParameterValue, descriptor: Descriptor) -> rdflib.Graph:
    document = parameter_document(NAME, value, SPACE)
    whole = Document(document.url, (*document.triples, *declared_triples(descriptor, URL, SPACE)))
    return rdflib.Graph().parse(serialize(whole, Syntax.N_TRIPLES), format="nt")


def broken(descriptor: Descriptor, value: ParameterValue) -> tuple[str, ...]:
    return tuple(each.message for each in violations(descriptor, NAME, URL, value))


def test_what_is_declared_is_said_in_words_and_as_a_shape() -> None:
    triples = declared_triples(FREQUENCY, URL, SPACE)
    own = {each.predicate: each.object for each in triples if each.subject == NamedNode(URL)}
    assert own[dcterms.description] == Literal("How often it looks.")
    assert own[ros.readOnly].value == "false"  # type: ignore[union-attr]
    assert own[ros.parameterType] == Literal("integer")
    assert own[ros.shape] == NamedNode(f"{URL}#constraint")
    value = {each.predicate: each.object for each in triples if each.subject == NamedNode(f"{URL}#constraint.value")}
    assert [value[one].value for one in (sh.minInclusive, sh.maxInclusive, ros.step)] == ["10", "60", "10"]  # type: ignore[union-attr]
    assert value[sh.description] == Literal("A prime is best.")
    graph = graph_of(20, FREQUENCY)
    assert (rdflib.URIRef(f"{URL}#constraint"), SH.targetNode, rdflib.URIRef(URL)) in graph
    assert (rdflib.URIRef(f"{URL}#constraint"), RDF.type, SH.NodeShape) in graph


@pytest.mark.parametrize("descriptor", [Descriptor(dynamic_typing=True), Descriptor(read_only=True)])
def test_a_parameter_whose_type_may_change_has_no_shape(descriptor: Descriptor) -> None:
    assert constraint_url(URL, descriptor) is None
    assert {each.predicate for each in declared_triples(descriptor, URL, SPACE)} == {ros.readOnly}
    assert broken(descriptor, "anything") == ()


@pytest.mark.parametrize(
    ("descriptor", "value", "words"),
    [
        (FREQUENCY, 0, "must be at least 10, not 0"),
        (FREQUENCY, 70.0, "must be at most 60, not 70.0"),
        (FREQUENCY, 25, "must be on a step (10 and steps of 10 from there, up to 60), which 25 is not"),
        (FREQUENCY, "fast", 'is declared as integer, which "fast" is not'),
        (FREQUENCY, {"a": 1}, 'is declared as integer, which {"a": 1} is not'),
        (GAIN, float("nan"), "must be at least 0.0, not NaN"),
        (GAIN, 0.25, "must be on a step (0.0 and steps of 0.1 from there, up to 1.0), which 0.25 is not"),
        (replace(FREQUENCY, range=None), 2**63, f"must be at most {2**63 - 1}, not {2**63}"),
        (Descriptor(ParameterType.INTEGER_ARRAY), [1, 2.5], "is declared as integer array, which [1,2.5] is not"),
    ],
)
def test_what_does_not_fit_is_told_with_the_value_and_the_bound(
    descriptor: Descriptor, value: ParameterValue, words: str
) -> None:
    assert broken(descriptor, value) == (words,)


values = st.one_of(
    st.integers(-100, 120), st.floats(-100, 120), st.booleans(), st.text("ab1", max_size=3), st.binary(max_size=3)
)
