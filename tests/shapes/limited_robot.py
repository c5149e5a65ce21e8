"""A robot with limits, whose responses to bodies are compared to SHACL validators on its linked shapes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import httpx
import rdflib
from msgspec.structs import replace
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, serialize

from rosld.adapters.model import Choice, Descriptor, ParameterType, Range
from rosld.ontology.parameters import lower_term
from rosld.ontology.violations import LoweringError
from rosld.ontology.vocab import rdf, ros, xsd
from rosld.server.http.fields import parse_links
from rosld.shapes.message import SHACL_SHACL
from tests.crawl.site import CONFORMS_TO, CONSTRAINED_BY
from tests.server.robots.made_up import MadeUp, served
from tests.shapes.values import SOME, graph, parsed

N_TRIPLES = {"Content-Type": "application/n-triples"}
TYPES = "https://w3id.org/rosld/types/"
DECLARED = {
    "/lamp/level": (5, Descriptor(ParameterType.INTEGER, range=Range(0, 20, 5))),
    "/lamp/gain": (0.5, Descriptor(ParameterType.DOUBLE, range=Range(0.0, 100.0))),
    "/lamp/name": ("Ada", Descriptor(ParameterType.STRING)),
    "/lamp/lit": (True, Descriptor(ParameterType.BOOLEAN)),
    "/lamp/mode": (1, Descriptor(ParameterType.INTEGER, choices=(Choice(0, "off"), Choice(1, "on")))),
    "/lamp/counts": ([1], Descriptor(ParameterType.INTEGER_ARRAY)),
    "/lamp/names": (["a"], Descriptor(ParameterType.STRING_ARRAY)),
    "/lamp/octets": (b"a", Descriptor(ParameterType.BYTE_ARRAY)),
}
UNDECLARED = {"/lamp/anything": 1, "/lamp/bounded": 1}
LIMITS = f"""
    @prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <{rdf.iri}> . @prefix ros: <{ros.iri}> .
    @prefix float: <{TYPES}std_msgs/msg/Float64#> . @prefix point: <{TYPES}geometry_msgs/msg/Point#> .
    <#grip> a sh:NodeShape ; sh:targetNode <resources/arm/grip> ;
      sh:property [ sh:path rdf:value ; sh:minInclusive 0 ; sh:maxExclusive 100 ] .
    <#words> a sh:NodeShape ; sh:targetNode <resources/arm/words> ;
      sh:property [ sh:path rdf:value ; sh:in ( "a" "ab" "1" ) ] .
    <#label> a sh:NodeShape ; sh:targetNode <resources/arm/label> ;
      sh:property [ sh:path rdf:value ; sh:pattern "^a" ; sh:maxLength 4 ] .
    <#speed> a sh:NodeShape ; sh:targetNode <topics/speed> ;
      sh:property [ sh:path ros:latest ;
        sh:property [ sh:path float:data ; sh:minInclusive 0 ; sh:maxInclusive 200 ] ] .
    <#point> a sh:NodeShape ; sh:targetClass <{TYPES}geometry_msgs/msg/Point> ;
      sh:property [ sh:path point:x ; sh:minInclusive -1 ; sh:maxInclusive 1000 ] .
    <#name> a sh:NodeShape ; sh:targetNode <parameters/lamp/name> ;
      sh:property [ sh:path ros:value ; sh:pattern "^a" ] .
    <#bounded> a sh:NodeShape ; sh:targetNode <parameters/lamp/bounded> ;
      sh:property [ sh:path ros:value ; sh:minInclusive 0 ; sh:maxExclusive 100.5e0 ] .
"""
RELATIONS = f"""
    @prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <{rdf.iri}> . @prefix ros: <{ros.iri}> .
    @prefix point: <{TYPES}geometry_msgs/msg/Point#> . @prefix range: <{TYPES}made_up/srv/SetRange_Request#> .
    @prefix stamped: <{TYPES}geometry_msgs/msg/PointStamped#> . @prefix header: <{TYPES}std_msgs/msg/Header#> .
    @prefix text: <{TYPES}std_msgs/msg/String#> . @prefix float: <{TYPES}std_msgs/msg/Float64#> .
    <#point> a sh:NodeShape ; sh:targetClass <{TYPES}geometry_msgs/msg/Point> ;
      sh:property [ sh:path point:x ; sh:lessThanOrEquals point:y ; sh:datatype <{xsd.double.value}> ] ;
      sh:not [ sh:property [ sh:path point:z ; sh:hasValue 7.0e0 ] ] .
    <#aim> a sh:NodeShape ; sh:targetNode <../topics/aim> ; sh:property [ sh:path ros:latest ; sh:or (
      [ sh:property [ sh:path stamped:header ; sh:property [ sh:path header:frame_id ; sh:in ( "map" "odom" ) ] ] ]
      [ sh:property [ sh:path stamped:point ; sh:property [ sh:path point:x ; sh:maxInclusive 0 ] ] ] ) ] .
    <#range> a sh:NodeShape ; sh:targetNode <../resources/arm/range> ;
      sh:property [ sh:path rdf:value ; sh:nodeKind sh:IRI ;
        sh:property [ sh:path range:low ; sh:lessThan range:high ] ] .
    <#text> a sh:NodeShape ; sh:targetClass <{TYPES}std_msgs/msg/String> ;
      sh:or ( [ sh:property [ sh:path text:data ; sh:pattern "^a" ] ]
              [ sh:property [ sh:path text:data ; sh:maxLength 1 ] ] ) .
    <#speed> a sh:NodeShape ; sh:targetNode <../topics/speed> ; sh:property [ sh:path ros:latest ; sh:property [
      sh:path float:data ; sh:xone ( [ sh:minInclusive 100 ] [ sh:maxInclusive 5.0e-1 ] ) ] ] .
"""
"""Limits that are more than bounds of single values."""


VALUES = (*SOME, NamedNode("http://h/x"), rdf.nil, BlankNode("b"))
"""Candidates for a field with one value."""


@contextmanager
def served_robot(folder: Path) -> Iterator[httpx.Client]:
    """A client of a robot with limits, and with declared parameters."""
    robot = MadeUp()
    robot.capabilities = replace(robot.capabilities, parameter_trees=False)
    robot.owners = ("/lamp",)
    robot.declared = {name: descriptor for name, (_, descriptor) in DECLARED.items()}
    for name, value in {**UNDECLARED, **{name: value for name, (value, _) in DECLARED.items()}}.items():
        robot.parameter(name, value)
    robot.variable("/arm/grip", "Byte", value=1)
    robot.variable("/arm/words", "Words", words="a")
    robot.variable("/arm/label", "Words", words="a")
    robot.variable("/arm/range", "Range", low=0, high=1)
    robot.topic("/speed", "std_msgs/msg/Float64", published=False, heard=True)
    robot.topic("/aim", "geometry_msgs/msg/PointStamped", published=False, heard=True)
    robot.topic("/text", "std_msgs/msg/String", published=False, heard=True)
    robot.topic("/ready", "std_msgs/msg/Empty", published=False, heard=True)
    robot.offer("/arm/aim", "made_up/srv/Aim", lambda _: {"hit": True})
    path = folder / "limits.ttl"
    path.write_text(LIMITS)
    with served(robot, shapes=(path,), max_publish_rate=1e6) as http:
        yield http


def linked_shape(client: httpx.Client, url: str) -> rdflib.Graph:
    """Return the shapes graph that a resource links to as the constraint of its writes."""
    link = ", ".join(client.get(url).headers.get_list("link"))
    (shape,) = {each.target for each in parse_links(link) if each.rel == CONSTRAINED_BY}
    answer = client.get(shape, headers={"Accept": "application/n-triples"})
    assert answer.status_code == 200, answer.text
    links = parse_links(", ".join(answer.headers.get_list("link")))
    assert SHACL_SHACL in {each.target for each in links if each.rel == CONFORMS_TO}
    return parsed(answer.text)


def is_taken(client: httpx.Client, url: str, triples: Sequence[Triple], method: str = "PUT") -> bool:
    """Whether the server accepts a body."""
    content = serialize(triples, format=RdfFormat.N_TRIPLES)
    answer = client.request(method, url, content=content, headers=N_TRIPLES)
    assert answer.is_success or answer.status_code == 422, answer.text
    return answer.is_success


def is_malformed(value: object) -> bool:
    """Whether a value is a malformed array of a parameter in rdf:JSON, as any reader of rdf:JSON can see."""
    if not isinstance(value, Literal) or value.datatype != rdf.JSON:
        return False
    try:
        lower_term(value)
    except LoweringError:
        return True
    return False


@dataclass(frozen=True)
class Together:
    """Many bodies about one node as one graph, with the nodes of each renamed."""

    data: rdflib.Graph
    shapes: rdflib.Graph
    prefixes: tuple[str, ...]

    def conforming(self, report: rdflib.Graph) -> list[bool]:
        """Return the bodies without violations in a validation report."""
        broken = {f"{str(each).rpartition('/')[0]}/" for each in report.objects(None, rdflib.SH.focusNode)}
        return [prefix not in broken for prefix in self.prefixes]


def put_together(
    shapes: rdflib.Graph, bodies: Sequence[Sequence[Triple]], node: NamedNode, apart: str = ""
) -> Together:
    """Return bodies about `node`, and their shape with a target in each; `apart` is in the names of their nodes."""
    prefixes = tuple(f"http://example.org/{apart}{number}/" for number in range(len(bodies)))
    data = [
        Triple(_apart(one.subject, node, prefix), one.predicate, _apart(one.object, node, prefix))
        for prefix, triples in zip(prefixes, bodies, strict=True)
        for one in triples
    ]
    targeted = rdflib.Graph()
    for subject, predicate, object in shapes:
        is_target = predicate == rdflib.SH.targetNode and str(object) == node.value
        for target in [rdflib.URIRef(prefix) for prefix in prefixes] if is_target else [object]:
            targeted.add((subject, predicate, target))
    return Together(graph(data), targeted, prefixes)


N = TypeVar("N")


def _apart(term: N, node: NamedNode, prefix: str) -> N | NamedNode:
    if term == node:
        return NamedNode(prefix)
    return NamedNode(prefix + term.value) if isinstance(term, BlankNode) else term


def difference(
    bodies: Sequence[Sequence[Triple]], by_server: Sequence[bool], by_shape: Sequence[bool]
) -> list[tuple[str, bool]]:
    """Return the bodies for which the two differ, each with the server's response."""
    verdicts = zip(bodies, by_server, by_shape, strict=True)
    return [(" ".join(map(str, body)), taken) for body, taken, conforms in verdicts if taken != conforms]


def point(subject: NamedNode | BlankNode, *values: str) -> list[Triple]:
    class_ = f"{TYPES}geometry_msgs/msg/Point"
    double = NamedNode("http://www.w3.org/2001/XMLSchema#double")
    return [
        Triple(subject, NamedNode(f"{class_}#{axis}"), Literal(value, datatype=double))
        for axis, value in zip("xyz", values, strict=True)
    ]


def stamped(url: str) -> list[Triple]:
    """Return a PointStamped for a topic."""
    class_, node = f"{TYPES}geometry_msgs/msg/PointStamped", NamedNode(f"{url}#message")
    header, stamp, where = BlankNode("h"), BlankNode("s"), BlankNode("p")
    time, head = f"{TYPES}builtin_interfaces/msg/Time#", f"{TYPES}std_msgs/msg/Header#"
    return [
        Triple(node, rdf.type, NamedNode(class_)),
        Triple(node, NamedNode(f"{class_}#header"), header),
        Triple(node, NamedNode(f"{class_}#point"), where),
        Triple(header, NamedNode(f"{head}frame_id"), Literal("map")),
        Triple(header, NamedNode(f"{head}seq"), Literal(1)),
        Triple(header, NamedNode(f"{head}stamp"), stamp),
        Triple(stamp, NamedNode(f"{time}sec"), Literal(1)),
        Triple(stamp, NamedNode(f"{time}nanosec"), Literal(1)),
        *point(where, "1", "2", "3"),
    ]
