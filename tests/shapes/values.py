"""Literals of every RDF datatype for ROS values, well-formed or not, and graphs that do not normalize them."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from functools import cache
from itertools import product

import rdflib
from pyoxigraph import Literal, NamedNode, RdfFormat, Triple, serialize
from pyshacl.graph_abstraction import DataGraph
from pyshacl.shapes_graph import ShapesGraph
from pyshacl.validator import Validator

from rosld.adapters.model import MessageSchema, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.vocab import rdf, xsd

LIBRARIES = {version: TypeLibrary(ros_version=version) for version in (1, 2)}
for _module in [module for name, module in sys.modules.items() if name.startswith("pyshacl.")]:
    if "stringify_node" in vars(_module):
        vars(_module)["stringify_node"] = lambda _graph, node, *_: str(node)
"""pySHACL describes the nodes of every result in Turtle, which takes half of its time."""


@cache
def schema_of(name: str, version: int = 1) -> MessageSchema:
    schema = LIBRARIES[version].find(TypeRef(name))
    assert isinstance(schema, MessageSchema)
    return schema


def graph(triples: Sequence[Triple]) -> rdflib.Graph:
    """Return a graph for pySHACL."""
    text = serialize(triples, format=RdfFormat.N_TRIPLES)
    assert text is not None
    return parsed(text.decode())


def parsed(text: str) -> rdflib.Graph:
    """Return N-Triples for pySHACL with unchanged literals, which rdflib would normalize."""
    normalize, rdflib.NORMALIZE_LITERALS = rdflib.NORMALIZE_LITERALS, False
    try:
        return rdflib.Graph().parse(data=text, format="nt")
    finally:
        rdflib.NORMALIZE_LITERALS = normalize


def compiled(shapes: rdflib.Graph) -> ShapesGraph:
    """Return a shapes graph in the form that pySHACL uses."""
    return ShapesGraph(shapes)


def validate(data: rdflib.Graph, shapes: ShapesGraph) -> tuple[bool, rdflib.Graph, str]:
    """Return the result of `pyshacl.validate`, which would compile the shapes each time."""
    options = {"logger": logging.getLogger("pyshacl")}
    validator = Validator(DataGraph.from_rdflib(data), shacl_graph=rdflib.Graph(), options=options)
    validator.shacl_graph = shapes
    conforms, report, words = validator.run()
    assert isinstance(report, rdflib.Graph)
    return bool(conforms), report, str(words)


def typed(text: str, datatype: NamedNode | str) -> Literal:
    return Literal(text, datatype=datatype if isinstance(datatype, NamedNode) else NamedNode(xsd.iri + datatype))


NUMBERS = ("0", "1", "-1", "5", "127", "128", "255", "-128", "2147483648", "9223372036854775807", "9223372036854775808",
           "18446744073709551615", "18446744073709551616", "1" + "0" * 39, "1" + "0" * 309, "007", "+5")  # fmt: skip
INTEGERS = ("integer", "nonNegativeInteger", "positiveInteger", "nonPositiveInteger", "negativeInteger", "byte",
            "short", "int", "long", "unsignedByte", "unsignedShort", "unsignedInt", "unsignedLong")  # fmt: skip
DECIMALS = ("0.0", "1.0", "-0.0", "0.5", "100.00", ".5", "5.", "255.0", "")
REALS = (*DECIMALS, "3e38", "3.5e38", "1e308", "1.5e1", "1E-400", "nope")
SPECIALS = ("INF", "-INF", "+INF", "NaN")
JSON = ("[]", "[1]", "[1,2,3]", " [ 1 , 2 ] ", "[1.5]", "[1.0]", "[1,2.5,-0.0]", '["NaN","-INF"]', '["a"]',
        '["ab","c"]', "[true]", "[true,false]", "[0,255]", "[256]", "[-1]", "[32768]", "[18446744073709551615]",
        '["18446744073709551615"]', '["1"]', '["007"]', "[1e2]", "[1.7976931348623157e308]", "[3.4028235e38]", "[1e39]",
        "[1e400]", "[null]", "{}", "1", "[1", "[01]", "[[1]]", '["\\ud800"]', '["\\u00e9"]', '["é"]', '["abcd"]',
        '[{"a":1}]', "[1,2,3,4,5]", '[""]')  # fmt: skip
HEX = ("", "00", "0a0B", "0000000000", "000", "zz", " 0a ")
BASE64 = ("", "AA==", "AAA=", "AAAA", "AAAAAA==", "AAAAAAA=", "AAAAAAAA", "%", "=", "A", "A A = =", "w6k=")
LITERALS = (
    *(typed(text, datatype) for text, datatype in product(NUMBERS, ("integer", "double"))),
    *(typed(text, datatype) for text, datatype in product(("5", "-1", "1" + "0" * 39), INTEGERS)),
    *(typed(text, "decimal") for text in DECIMALS),
    *(typed(text, datatype) for text, datatype in product(REALS, ("double", "float"))),
    *(typed(text, datatype) for text, datatype in product(SPECIALS, ("double", "float"))),
    *(typed(text, "boolean") for text in ("true", "false", "1", "0", "yes", " true ")),
    *(typed(text, rdf.JSON) for text in JSON),
    *(typed(text, "hexBinary") for text in HEX),
    *(typed(text, "base64Binary") for text in BASE64),
    *(Literal(text) for text in ("", "a", "ab", "abcd", "abcde", "1")),
    *(typed(text, "dateTime") for text in ("2020-01-01T00:00:00Z", "2020-01-01T00:00:00", "2050-01-01T00:00:00Z")),
    Literal("a", language="en"),
)
"""All of them, in all datatypes."""
SOME = (
    *(typed(text, datatype) for text, datatype in product(
        ("0", "-1", "100", "101", "9223372036854775808", "007"), ("integer", "byte", "unsignedLong", "double"))),
    *(typed(text, datatype) for text, datatype in product(
        ("0.5", "15e-1", "1e309", "nope", "INF", "NaN"), ("double", "float", "integer"))),
    *(typed(text, "decimal") for text in ("0.5", "1.0", ".5", "5.", "")),  # not comparable in pySHACL
    *(typed(text, "boolean") for text in ("true", "false", "1", "0", "yes", " true ")),
    *(typed(text, rdf.JSON) for text in ("1", "[1]", '["a"]', "{}", "[1", '["\\ud800"]')),
    *(typed(text, "hexBinary") for text in ("", "61", "6", " 61 ")),
    *(typed(text, "base64Binary") for text in ("", "YQ==", "YQ")),
    *(Literal(text) for text in ("", "a", "ab", "abcd", "abcde", "1", "true", "é")),
    *(typed("2020-01-01T00:00:00Z", datatype) for datatype in ("dateTime", "date", "duration")),
    typed("a", NamedNode("http://example.org/datatype")),
    Literal("a", language="en"),
)  # fmt: skip
"""A few of each kind."""
