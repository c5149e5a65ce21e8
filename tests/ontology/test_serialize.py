"""Documents in every syntax: third-party readers find the same triples in all of them."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Sequence
from typing import TypeAlias

import numpy as np
import pytest
import rdflib
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import (
    BlankNode,
    CanonicalizationAlgorithm,
    Dataset,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    RdfFormat,
    Triple,
    parse,
)

from rosld.adapters.model import MessageSchema
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.document import Document, Envelope, LiftedMessage
from rosld.ontology.lift import lifter
from rosld.ontology.serialize import serialize, serialize_named
from rosld.ontology.syntax import CannotCarry, Syntax
from rosld.ontology.vocab import ldp, rdf, rdfs, ros, xsd

logging.getLogger("rdflib.term").setLevel(logging.CRITICAL)  # these tests are about ill-typed literals

FORMATS = {syntax: RdfFormat.from_media_type(syntax.media_type) for syntax in Syntax}
RDFLIB_FORMATS = {
    Syntax.TURTLE: "turtle",
    Syntax.JSON_LD: "json-ld",
    Syntax.N_TRIPLES: "nt11",
    Syntax.RDF_XML: "xml",
    Syntax.N3: "n3",
    Syntax.N_QUADS: "nquads",
    Syntax.TRIG: "trig",
}
Node: TypeAlias = NamedNode | BlankNode

URL = "http://127.0.0.1:8080/topics/turtle1/pose"

# fmt: off
TEXTS = st.sampled_from([
    "", " ", '"', '"""', "\\", "\\n", "\n", "a\nb\n", "\r\n", '\n"""', '"\n', "\n\\", "\t", "\x00", "\x7f", "\x85",
    "\u2028", "\ufffe", "<&>", "]]>", "@id", "@type", "ros:name", "true", "42", "💡", "a\\", "{}", "[]", "_:b0", "null",
]) | st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
# fmt: on
XML_TEXTS = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="\ufffe\uffff", min_codepoint=32)
    | st.sampled_from("\t\n\r"),
    max_size=12,
)

IRIS = [
    "http://h/", "http://h", "http://h/a/", "http://h/%2F", "urn:x:y", "ros:foo:bar", "name:x", "xsd:double", "ldp:x",
    "mailto:a@b", "http://ü/é", "tag:a,b:c", "type:x", "id:y", "http://h/x?q=1&r='2'", "http://www.w3.org/ns/ldp#1",
    "https://w3id.org/rosld/types/geometry_msgs/msg/Twist#linear",
    *(f"https://w3id.org/rosld#{name}" for name in ("", "name", "a.b")),
    *(f"{URL}{fragment}" for fragment in ("", "#", "#message", "#from/talker", "#a.b")),
]  # fmt: skip
NODES = st.sampled_from(IRIS).map(NamedNode)
BLANKS = st.sampled_from([BlankNode(label) for label in "abcdef"])
PREDICATES = st.sampled_from(
    [ros.name, ros.latest, ros.value, ros.rate, rdf.type, rdf.first, rdf.rest, rdfs.label, ldp.contains]
    + [
        NamedNode(iri)
        for iri in ("http://h/p", "urn:p:q", "name:p", "http://h/x#y-z", "http://purl.org/dc/terms/title")
    ]
)
DATATYPES = st.sampled_from(
    [xsd.integer, xsd.double, xsd.float, xsd.boolean, xsd.decimal, xsd.dateTime, xsd.byte, rdf.JSON]
    + [NamedNode(iri) for iri in ("http://h/dt", "urn:dt", "ros:dt")]
)
LEXICALS = st.sampled_from(
    ["1", "01", "-0", "1.0", ".5", "1.", "1e5", "1E+05", "NaN", "INF", "true", "TRUE", "1", "[1,2]", ""]
)


WITHOUT_XML = tuple(syntax for syntax in Syntax if syntax is not Syntax.RDF_XML)


def literals(texts: st.SearchStrategy[str]) -> st.SearchStrategy[Literal]:
    """Return literals of all kinds."""
    return (
        texts.map(Literal)
        | st.builds(lambda text, tag: Literal(text, language=tag), texts, st.sampled_from(["en", "de-ch"]))
        | st.builds(lambda text, datatype: Literal(text, datatype=datatype), LEXICALS | texts, DATATYPES)
    )


def graphs(texts: st.SearchStrategy[str] = TEXTS) -> st.SearchStrategy[list[Triple]]:
    """Return a few triples that share nodes, including well-formed and broken lists."""
    objects = NODES | BLANKS | literals(texts) | st.just(rdf.nil)
    triples = st.builds(Triple, NODES | BLANKS, PREDICATES, objects)
    lists = st.builds(rdf_list, NODES | BLANKS, PREDICATES, st.lists(objects, max_size=4))
    return st.lists(triples.map(lambda triple: [triple]) | lists, max_size=8).map(
        lambda parts: [t for part in parts for t in part]
    )


def rdf_list(subject: Node, predicate: NamedNode, elements: Sequence[Node | Literal]) -> list[Triple]:
    """Return a well-formed rdf:List and the link to it."""
    cells = [BlankNode() for _ in elements]
    nodes: list[Node] = [*cells, rdf.nil]
    triples = [Triple(subject, predicate, nodes[0])]
    for cell, element, rest in zip(cells, elements, nodes[1:], strict=True):
        triples += [Triple(cell, rdf.first, element), Triple(cell, rdf.rest, rest)]
    return triples


def canonical(triples: Iterable[Triple]) -> set[str]:
    """Return the triples with canonical blank nodes: equal for isomorphic graphs."""
    dataset = Dataset(Quad(t.subject, t.predicate, t.object, DefaultGraph()) for t in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.RDFC_1_0)
    return {str(quad.triple) for quad in dataset}


def read(data: bytes, syntax: Syntax) -> list[Triple]:
    """Return the triples that pyoxigraph reads, all of them in the default graph."""
    quads = list(parse(data, format=FORMATS[syntax]))
    assert all(quad.graph_name == DefaultGraph() for quad in quads)
    return [quad.triple for quad in quads]


def rdflib_read(data: bytes, syntax: Syntax) -> list[Triple]:
    """Return the triples that rdflib reads, with unnormalized literals."""
    normalize, rdflib.NORMALIZE_LITERALS = rdflib.NORMALIZE_LITERALS, False
    try:
        dataset = rdflib.Dataset()
        dataset.default_graph.parse(data, format=RDFLIB_FORMATS[syntax])
    finally:
        rdflib.NORMALIZE_LITERALS = normalize
    return [Triple(_node(s), NamedNode(str(p)), _term(o)) for s, p, o, _ in dataset.quads()]


def _node(term: rdflib.term.Node) -> Node:
    if isinstance(term, rdflib.BNode):
        return BlankNode("r" + term.encode().hex())
    return NamedNode(str(term))


def _term(term: rdflib.term.Node) -> Node | Literal:
    if isinstance(term, rdflib.Literal):
        if term.language:
            return Literal(str(term), language=term.language)
        return Literal(str(term), datatype=NamedNode(str(term.datatype)) if term.datatype else xsd.string)
    return _node(term)


@pytest.mark.slow
@given(graphs())
def test_pyoxigraph_reads_what_was_written(triples: list[Triple]) -> None:
    expected = canonical(triples)
    for syntax in WITHOUT_XML:
        assert canonical(read(serialize(Document(URL, tuple(triples)), syntax), syntax)) == expected, syntax


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Parsing weird boolean")
@settings(max_examples=40)  # rdflib is slow
@given(graphs(XML_TEXTS))
def test_both_readers_read_what_was_written_wherever_xml_can_carry_it(triples: list[Triple]) -> None:
    expected = canonical(triples)
    for syntax in Syntax:
        data = serialize(Document(URL, tuple(triples)), syntax)
        assert canonical(rdflib_read(data, syntax)) == expected, syntax
    data = serialize(Document(URL, tuple(triples)), Syntax.RDF_XML)
    assert canonical(read(data, Syntax.RDF_XML)) == expected


def ring(size: int) -> list[Triple]:
    nodes = [BlankNode() for _ in range(size)]
    return [Triple(node, ros.latest, nodes[(i + 1) % size]) for i, node in enumerate(nodes)]


def chain(size: int) -> list[Triple]:
    nodes: list[Node] = [NamedNode(URL), *(BlankNode() for _ in range(size))]
    return [Triple(nodes[i], ros.latest, nodes[i + 1]) for i in range(size)]


def nested_lists(depth: int) -> list[Triple]:
    triples = rdf_list(NamedNode(URL), ros.value, [Literal("innermost")])
    for _ in range(depth):
        head = triples[0].object
        assert isinstance(head, BlankNode)
        triples = [*rdf_list(NamedNode(URL), ros.value, [head]), *triples[1:]]
    return triples


@pytest.mark.slow
def test_rings_long_chains_and_deep_lists_neither_hang_nor_get_lost() -> None:
    for triples in (ring(1), ring(2), ring(40), chain(5000), nested_lists(60)):
        for syntax in Syntax:
            data = serialize(Document(URL, tuple(triples)), syntax)
            assert len(set(read(data, syntax))) == len(triples), syntax  # canonicalizing cycles takes for ever


def document(*triples: tuple[NamedNode, NamedNode, NamedNode | BlankNode | Literal]) -> Document:
    return Document(URL, tuple(Triple(*triple) for triple in triples))


TOPIC = NamedNode(URL)
POSE = document(
    (TOPIC, rdf.type, ros.Topic),
    (TOPIC, rdf.type, ldp.Resource),
    (TOPIC, ros.name, Literal("/turtle1/pose")),
    (TOPIC, ros.definition, Literal("float64 x\nfloat64 y\n")),
    (TOPIC, ros.rate, Literal("62.5", datatype=xsd.double)),
    (TOPIC, ros.latest, NamedNode(URL + "#message")),
    (NamedNode(URL + "#message"), ros.sequence, Literal("42", datatype=xsd.integer)),
)


def test_turtle_is_as_a_person_would_write_it() -> None:
    assert serialize(POSE, Syntax.TURTLE).decode() == (
        f"@base <{URL}> .\n"
        "@prefix ldp: <http://www.w3.org/ns/ldp#> .\n"
        "@prefix ros: <https://w3id.org/rosld#> .\n"
        "@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .\n"
        "\n"
        f"<{URL}> a ros:Topic, ldp:Resource ;\n"
        '    ros:name "/turtle1/pose" ;\n'
        '    ros:definition """float64 x\nfloat64 y\n""" ;\n'
        '    ros:rate "62.5"^^xsd:double ;\n'
        "    ros:latest <#message> .\n"
        "\n"
        "<#message> ros:sequence 42 .\n"
    )


def test_json_ld_is_compact_nested_and_self_contained() -> None:
    assert json.loads(serialize(POSE, Syntax.JSON_LD)) == {
        "@context": {
            "@base": URL,
            "ros": "https://w3id.org/rosld#",
            "ldp": "http://www.w3.org/ns/ldp#",
            "xsd": "http://www.w3.org/2001/XMLSchema#",
            "name": {"@id": "https://w3id.org/rosld#name"},
            "definition": {"@id": "https://w3id.org/rosld#definition"},
            "rate": {"@id": "https://w3id.org/rosld#rate", "@type": "xsd:double"},
            "latest": {"@id": "https://w3id.org/rosld#latest", "@type": "@id"},
            "sequence": {"@id": "https://w3id.org/rosld#sequence", "@type": "xsd:integer"},
        },
        "@id": URL,
        "@type": ["ros:Topic", "ldp:Resource"],
        "name": "/turtle1/pose",
        "definition": "float64 x\nfloat64 y\n",
        "rate": "62.5",
        "latest": {"@id": "#message", "sequence": "42"},
    }


def test_lists_and_nested_blank_nodes_have_no_labels() -> None:
    inner = BlankNode()
    triples = [*rdf_list(TOPIC, ros.value, [Literal("a"), inner]), Triple(inner, rdfs.label, Literal("b"))]
    for syntax in (Syntax.TURTLE, Syntax.JSON_LD):
        assert b"_:" not in serialize(Document(URL, tuple(triples)), syntax)


def test_iris_that_look_like_compact_iris_take_the_prefix_away() -> None:
    data = serialize(document((NamedNode("ros:foo:bar"), ros.name, Literal("x"))), Syntax.JSON_LD)
    assert "ros" not in json.loads(data)["@context"]
    assert read(data, Syntax.JSON_LD) == [Triple(NamedNode("ros:foo:bar"), ros.name, Literal("x"))]


@pytest.mark.parametrize("character", ["\x00", "\x0b", "\x1f", "\ufffe", "\uffff"])
def test_rdf_xml_refuses_characters_that_xml_does_not_have(character: str) -> None:
    with pytest.raises(CannotCarry, match=f"U\\+{ord(character):04X}"):
        serialize(document((TOPIC, ros.name, Literal(f"a{character}b"))), Syntax.RDF_XML)


@pytest.mark.parametrize(
    "predicate",
    ["http://h/p/", "http://h/#1", "urn:1", rdf.iri + "li", rdf.iri + "about", "http://www.w3.org/2000/xmlns/a"],
)
def test_rdf_xml_refuses_properties_that_are_no_names_of_elements(predicate: str) -> None:
    with pytest.raises(CannotCarry, match="name of an element"):
        serialize(document((TOPIC, NamedNode(predicate), Literal("x"))), Syntax.RDF_XML)


def test_triple_terms_go_where_rdf_1_2_is_known_and_are_refused_elsewhere() -> None:
    term = Triple(TOPIC, ros.name, Literal("x"))
    doc = Document(URL, (Triple(TOPIC, rdfs.seeAlso, term),))
    for syntax in (Syntax.TURTLE, Syntax.N_TRIPLES, Syntax.TRIG, Syntax.N_QUADS):
        assert read(serialize(doc, syntax), syntax) == list(doc.triples)
    for syntax in (Syntax.JSON_LD, Syntax.RDF_XML):
        with pytest.raises(CannotCarry, match="triple term"):
            serialize(doc, syntax)


@pytest.mark.parametrize("syntax", [Syntax.N_QUADS, Syntax.TRIG])
def test_as_a_part_of_a_dataset_a_document_is_the_graph_of_its_name(syntax: Syntax) -> None:
    doc = document((TOPIC, ros.name, Literal("x")))
    quads = list(parse(serialize_named(doc, syntax), format=FORMATS[syntax]))
    assert quads == [Quad(*triple, NamedNode(URL)) for triple in doc.triples]


# Documents with messages

LIBRARY = TypeLibrary(ros_version=1)


def learnt(name: str, definition: str) -> MessageSchema:
    return LIBRARY.learn_message(name, definition)


POINT = learnt("one_msgs/msg/Value", "float64 x\nstring name\nfloat32[] xs\n")
OTHER = learnt(
    "other_msgs/msg/Value",
    f"int64 x\none_msgs/Value[] inner\n{'=' * 80}\nMSG: one_msgs/Value\nfloat64 x\nstring name\nfloat32[] xs\n",
)


def carrying(*nodes: str) -> Document:
    """Return messages of two types that need the same prefix, under several nodes."""
    value = POINT.codec.build(POINT.ref.name, {"x": float("inf"), "name": 'a"\n\x00', "xs": np.array([1, 2], "f4")})
    other = OTHER.codec.build(OTHER.ref.name, {"x": 2**53 + 1, "inner": [value, value]})
    messages = [(POINT, value), (OTHER, other)] * len(nodes)
    carried = tuple(
        LiftedMessage(node, lifter(schema), message, Envelope(10**18, 3, "http://127.0.0.1:8080/nodes/a"))
        for node, (schema, message) in zip(nodes, messages, strict=False)
    )
    links = tuple(Triple(TOPIC, ros.latestFrom, NamedNode(URL + node)) for node in nodes)
    return Document(URL, (*POSE.triples[:4], *links), carried)


CARRYING = [carrying("#message"), carrying("#request", "#response"), carrying("#message", "#from/b", "#from/c")]


def test_messages_are_the_same_in_every_syntax_whether_linked_or_not() -> None:
    for document in (*CARRYING, Document(URL, (), CARRYING[0].messages), Document(URL, ())):
        for syntax in WITHOUT_XML:
            assert canonical(read(serialize(document, syntax), syntax)) == canonical(document.all_triples()), syntax
    nested = json.loads(serialize(carrying("#message"), Syntax.JSON_LD))
    assert nested["latestFrom"]["@id"] == "#message"
    assert "@graph" not in nested
    with pytest.raises(CannotCarry, match=r"U\+0000"):
        serialize(CARRYING[0], Syntax.RDF_XML)


@pytest.mark.parametrize("name", ["Größe-é", "名前", "x·y"])
def test_rdf_xml_has_properties_of_any_letters_that_every_reader_reads_back(name: str) -> None:
    triple = Triple(TOPIC, NamedNode(f"http://h/vokabular#{name}"), Literal("x"))
    data = serialize(Document(URL, (triple,)), Syntax.RDF_XML)
    assert read(data, Syntax.RDF_XML) == [triple]
    graph = rdflib.Graph().parse(data=data, format="xml")
    assert set(graph.predicates()) == {rdflib.URIRef(triple.predicate.value)}
