"""What a real server takes is what the shape that it links to lets pass, as pySHACL has it; and the other way round."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import httpx
import pyshacl
import pytest
import rdflib
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, Triple, serialize

from rosld.adapters.model import Choice, Descriptor, ParameterType, Range
from rosld.ontology.vocab import rdf, ros
from rosld.server.http.link import parse
from rosld.shapes.message import SHACL_SHACL
from tests.server.robots.made_up import MadeUp, served
from tests.shapes.crawl import CONFORMS_TO, CONSTRAINED_BY
from tests.shapes.values import SOME, graph, parsed, typed

N_TRIPLES = {"Content-Type": "application/n-triples"}
TYPES = "https://w3id.org/rosld/types/"
STRANGE = NamedNode("http://example.org/strange")
DECLARED = {
    "/lamp/level": (5, Descriptor(ParameterType.INTEGER, range=Range(0, 20, 5))),
    "/lamp/gain": (0.5, Descriptor(ParameterType.DOUBLE, range=Range(0.0, 100.0))),
    "/lamp/free_gain": (0.5, Descriptor(ParameterType.DOUBLE)),
    "/lamp/name": ("Ada", Descriptor(ParameterType.STRING)),
    "/lamp/lit": (True, Descriptor(ParameterType.BOOLEAN)),
    "/lamp/mode": (1, Descriptor(ParameterType.INTEGER, choices=(Choice(0, "off"), Choice(1, "on")))),
}
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
"""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    robot = MadeUp()
    robot.capabilities = replace(robot.capabilities, parameter_trees=False)
    robot.owners = ("/lamp",)
    robot.declared = {name: descriptor for name, (_, descriptor) in DECLARED.items()}
    for name, (value, _) in DECLARED.items():
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
    path: Path = tmp_path_factory.mktemp("limits") / "limits.ttl"
    path.write_text(LIMITS)
    with served(robot, shapes=(path,), max_publish_rate=1e6) as http:
        yield http


def linked_shape(client: httpx.Client, url: str) -> rdflib.Graph:
    """The shapes graph that a resource says its writes are constrained by."""
    link = ", ".join(client.get(url).headers.get_list("link"))
    (shape,) = {each.target for each in parse(link) if each.rel == CONSTRAINED_BY}
    answer = client.get(shape, headers={"Accept": "application/n-triples"})
    assert answer.status_code == 200, answer.text
    links = parse(", ".join(answer.headers.get_list("link")))
    assert SHACL_SHACL in {each.target for each in links if each.rel == CONFORMS_TO}
    return parsed(answer.text)


def is_taken(client: httpx.Client, url: str, triples: Sequence[Triple], method: str = "PUT") -> bool:
    """What the server makes of a body."""
    content = serialize(triples, format=RdfFormat.N_TRIPLES)
    answer = client.request(method, url, content=content, headers=N_TRIPLES)
    assert answer.is_success or answer.status_code == 422, answer.text
    return answer.is_success


def conforms(shapes: rdflib.Graph, triples: Sequence[Triple]) -> bool:
    """What pySHACL makes of it."""
    return bool(pyshacl.validate(graph(triples), shacl_graph=shapes)[0])


def conforming(shapes: rdflib.Graph, bodies: Sequence[Sequence[Triple]], node: NamedNode) -> list[bool]:
    """The same of many bodies about `node`, looked at together, for which the nodes of each have other names."""
    prefixes = [f"http://example.org/{number}/" for number in range(len(bodies))]
    together = [
        Triple(_apart(one.subject, node, prefix), one.predicate, _apart(one.object, node, prefix))
        for prefix, triples in zip(prefixes, bodies, strict=True)
        for one in triples
    ]
    targeted = rdflib.Graph()
    for subject, predicate, object in shapes:
        is_target = predicate == rdflib.SH.targetNode and str(object) == node.value
        for target in [rdflib.URIRef(prefix) for prefix in prefixes] if is_target else [object]:
            targeted.add((subject, predicate, target))
    _, report, _ = pyshacl.validate(graph(together), shacl_graph=targeted)
    assert isinstance(report, rdflib.Graph)
    broken = {f"{str(each).rpartition('/')[0]}/" for each in report.objects(None, rdflib.SH.focusNode)}
    return [prefix not in broken for prefix in prefixes]


N = TypeVar("N")


def _apart(term: N, node: NamedNode, prefix: str) -> N | NamedNode:
    if term == node:
        return NamedNode(prefix)
    return NamedNode(prefix + term.value) if isinstance(term, BlankNode) else term


def difference(
    bodies: Sequence[Sequence[Triple]], by_server: Sequence[bool], by_shape: Sequence[bool]
) -> list[tuple[str, bool]]:
    """The bodies about which the two differ, each with the server's verdict."""
    verdicts = zip(bodies, by_server, by_shape, strict=True)
    return [(" ".join(map(str, body)), taken) for body, taken, conforms in verdicts if taken != conforms]


VALUES = (*SOME, NamedNode("http://h/x"), rdf.nil, BlankNode("b"))


TEXTS = ("resources/arm/words", "resources/arm/label")
OCTETS = (typed("61", "hexBinary"), typed("YQ==", "base64Binary"))


@pytest.mark.parametrize(
    ("path", "predicate"),
    [
        *((f"resources/arm/{name}", rdf.value) for name in ("grip", "words", "label")),
        *((f"parameters{name}", ros.value) for name in DECLARED),
    ],
)
def test_a_value_is_taken_where_it_conforms(client: httpx.Client, path: str, predicate: NamedNode) -> None:
    url = NamedNode(str(client.base_url.join(f"/{path}")))
    # Text that has limits is written as text: octets that come to it pass the server, and no shape could tell.
    values = [value for value in VALUES if not (path in TEXTS and value in OCTETS)]
    bodies: list[list[Triple]] = [[Triple(url, predicate, value)] for value in values]
    bodies += [
        [],
        [Triple(url, STRANGE, Literal("1"))],
        [Triple(url, predicate, value) for value in (Literal("a"), Literal("ab"))],
        [Triple(url, predicate, Literal("a")), Triple(url, STRANGE, Literal("1"))],
    ]
    by_server = [is_taken(client, url.value, body) for body in bodies]
    assert not difference(bodies, by_server, conforming(linked_shape(client, url.value), bodies, url))
    assert 0 < sum(by_server) < len(bodies)


@pytest.mark.parametrize(
    ("path", "type", "field"),
    [("speed", "std_msgs/msg/Float64", "data"), ("text", "std_msgs/msg/String", "data")],
)
def test_a_message_of_one_field_is_taken_where_it_conforms(
    client: httpx.Client, path: str, type: str, field: str
) -> None:
    url = str(client.base_url.join(f"/topics/{path}"))
    node, class_ = NamedNode(f"{url}#message"), NamedNode(TYPES + type)
    is_one = Triple(node, rdf.type, class_)
    bodies = [[is_one, Triple(node, NamedNode(f"{class_.value}#{field}"), value)] for value in VALUES]
    by_server = [is_taken(client, url, body) for body in bodies]
    assert not difference(bodies, by_server, conforming(linked_shape(client, url), bodies, node))
    assert 0 < sum(by_server) < len(bodies)


def point(subject: NamedNode | BlankNode, *values: str) -> list[Triple]:
    class_ = f"{TYPES}geometry_msgs/msg/Point"
    double = NamedNode("http://www.w3.org/2001/XMLSchema#double")
    return [
        Triple(subject, NamedNode(f"{class_}#{axis}"), Literal(value, datatype=double))
        for axis, value in zip("xyz", values, strict=True)
    ]


def stamped(url: str) -> list[Triple]:
    """A PointStamped that is sent to a topic."""
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


def test_a_message_is_taken_where_it_conforms_whatever_is_missing_or_more(client: httpx.Client) -> None:
    url = str(client.base_url.join("/topics/aim"))
    whole = stamped(url)
    bodies = [whole]
    for number, (subject, predicate, object) in enumerate(whole[1:], 1):
        rest = [*whole[:number], *whole[number + 1 :]]
        bodies.append(rest)
        bodies += [[*rest, Triple(subject, predicate, value)] for value in (Literal("x"), Literal(5), subject)]
        bodies.append([*whole, Triple(subject, predicate, Literal("another"))])
        bodies.append([*whole, Triple(subject, STRANGE, object)])
    bodies.append([*whole, Triple(BlankNode("more"), STRANGE, Literal(1))])
    bodies.append([*whole[:-3], *point(BlankNode("p"), "1001", "0", "0")])
    bodies.append([*whole[:-3], *point(BlankNode("p"), "1000", "NaN", "INF")])
    bodies.append([*whole[:-3], *point(BlankNode("p"), "NaN", "0", "0")])
    shapes = linked_shape(client, url)
    by_server = [is_taken(client, url, body) for body in bodies]
    assert not difference(bodies, by_server, conforming(shapes, bodies, NamedNode(f"{url}#message")))
    assert 1 < sum(by_server) < len(bodies)
    for body in ([], whole[1:], [*whole[1:], Triple(whole[0].subject, rdf.type, NamedNode(f"{TYPES}no/msg/No"))]):
        assert not is_taken(client, url, body)
        assert not conforms(shapes, body)


def test_a_message_without_fields_need_not_be_told(client: httpx.Client) -> None:
    url = str(client.base_url.join("/topics/ready"))
    bodies = [[], [Triple(NamedNode(f"{url}#message"), rdf.type, NamedNode(f"{TYPES}std_msgs/msg/Empty"))]]
    shapes = linked_shape(client, url)
    for body in bodies:
        assert is_taken(client, url, body)
        assert conforms(shapes, body)


@pytest.mark.parametrize("path", ["services/arm/aim", "resources/arm/aim"])
def test_a_request_is_taken_where_it_conforms(client: httpx.Client, path: str) -> None:
    url = str(client.base_url.join(f"/{path}"))
    node, class_ = NamedNode(f"{url}#request"), f"{TYPES}made_up/srv/Aim_Request"
    azimuth, elevation = NamedNode(f"{class_}#azimuth"), NamedNode(f"{class_}#elevation")
    is_one = Triple(node, rdf.type, NamedNode(class_))
    whole = [is_one, Triple(node, azimuth, Literal(1)), Triple(node, elevation, Literal(0.5))]
    bodies = [
        whole,
        whole[:2],
        whole[1:],
        [is_one],
        [*whole, Triple(node, azimuth, Literal(2))],
        [*whole[:2], Triple(node, elevation, Literal("1"))],
        [*whole, Triple(node, STRANGE, Literal("1"))],
    ]
    shapes = linked_shape(client, url)
    by_server = [is_taken(client, url, body, "POST") for body in bodies]
    assert not difference(bodies, by_server, [conforms(shapes, body) for body in bodies])
    assert by_server[0]


def test_a_property_that_is_a_message_is_taken_where_it_conforms(client: httpx.Client) -> None:
    url = NamedNode(str(client.base_url.join("/resources/arm/range")))
    node = BlankNode("v")
    bodies: list[list[Triple]] = [[Triple(url, rdf.value, Literal(1))]]
    for class_ in ("SetRange_Request", "GetRange_Response", "Aim_Request"):
        iri = f"{TYPES}made_up/srv/{class_}"
        whole = [
            Triple(url, rdf.value, node),
            Triple(node, rdf.type, NamedNode(iri)),
            Triple(node, NamedNode(f"{iri}#low"), Literal(1)),
            Triple(node, NamedNode(f"{iri}#high"), Literal(2.5)),
        ]
        bodies += [whole, *([*whole[:number], *whole[number + 1 :]] for number in range(4))]
        bodies.append([*whole[:3], Triple(node, NamedNode(f"{iri}#high"), Literal("2"))])
    shapes = linked_shape(client, url.value)
    by_server = [is_taken(client, url.value, body) for body in bodies]
    assert not difference(bodies, by_server, [conforms(shapes, body) for body in bodies])
    assert sum(by_server) == 2


def test_limits_that_are_more_than_bounds_are_linked(client: httpx.Client) -> None:
    target = "<../resources/arm/range>"
    more = f"""@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <{rdf.iri}> .
        <#range> a sh:NodeShape ; sh:targetNode {target} ; sh:property [ sh:path rdf:value ; sh:nodeKind sh:IRI ] ."""
    url = str(client.base_url.join("/resources/arm/range"))
    limits = rdflib.URIRef(str(client.base_url.join("/shapes/limits")))
    assert limits not in linked_shape(client, url).objects(None, rdflib.RDFS.seeAlso)
    kept = client.put("/shapes/more", content=more, headers={"Content-Type": "text/turtle"})
    assert kept.status_code == 201, kept.text
    assert limits in linked_shape(client, url).objects(None, rdflib.RDFS.seeAlso)
    client.delete("/shapes/more")
    assert limits not in linked_shape(client, url).objects(None, rdflib.RDFS.seeAlso)
