"""A real server accepts exactly the bodies that conform to its linked shapes according to pySHACL."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import httpx
import pytest
import rdflib
from pyoxigraph import BlankNode, Literal, NamedNode, Triple
from pyshacl.shapes_graph import ShapesGraph

from rosld.ontology.vocab import rdf, ros
from tests.shapes.limited_robot import (
    DECLARED,
    RELATIONS,
    TYPES,
    UNDECLARED,
    VALUES,
    difference,
    is_malformed,
    is_taken,
    linked_shape,
    point,
    put_together,
    served_robot,
    stamped,
)
from tests.shapes.values import JSON, compiled, graph, typed, validate

pytestmark = pytest.mark.slow

STRANGE = NamedNode("http://example.org/strange")


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    with served_robot(tmp_path_factory.mktemp("limits")) as http:
        yield http


def conforms(shapes: ShapesGraph, triples: Sequence[Triple]) -> bool:
    """Whether a body conforms according to pySHACL."""
    return validate(graph(triples), shapes)[0]


def conforming(shapes: rdflib.Graph, bodies: Sequence[Sequence[Triple]], node: NamedNode) -> list[bool]:
    """Return which of many bodies about `node` conform, validated together."""
    together = put_together(shapes, bodies, node)
    return together.conforming(validate(together.data, compiled(together.shapes))[1])


@pytest.mark.parametrize(
    ("path", "predicate"),
    [
        *((f"resources/arm/{name}", rdf.value) for name in ("grip", "words", "label")),
        *((f"parameters{name}", ros.value) for name in (*DECLARED, *UNDECLARED)),
    ],
)
def test_a_value_is_taken_where_it_conforms(client: httpx.Client, path: str, predicate: NamedNode) -> None:
    url = NamedNode(str(client.base_url.join(f"/{path}")))
    values = [*VALUES, *(typed(text, rdf.JSON) for text in JSON)] if path.startswith("parameters") else VALUES
    values = [each for each in values if not (path.removeprefix("parameters") in UNDECLARED and is_malformed(each))]
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
        assert not conforms(compiled(shapes), body)


def test_a_message_without_fields_need_not_be_told(client: httpx.Client) -> None:
    url = str(client.base_url.join("/topics/ready"))
    bodies = [[], [Triple(NamedNode(f"{url}#message"), rdf.type, NamedNode(f"{TYPES}std_msgs/msg/Empty"))]]
    shapes = compiled(linked_shape(client, url))
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
    shapes = compiled(linked_shape(client, url))
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
    shapes = compiled(linked_shape(client, url.value))
    by_server = [is_taken(client, url.value, body) for body in bodies]
    assert not difference(bodies, by_server, [conforms(shapes, body) for body in bodies])
    assert sum(by_server) == 2


@pytest.fixture
def related(client: httpx.Client) -> Iterator[httpx.Client]:
    """The same robot with limits that relate values."""
    kept = client.put("/shapes/relations", content=RELATIONS, headers={"Content-Type": "text/turtle"})
    assert kept.status_code == 201, kept.text
    yield client
    client.delete("/shapes/relations")


def test_limits_that_relate_values_are_in_the_linked_shape(related: httpx.Client) -> None:
    limits = rdflib.URIRef(str(related.base_url.join("/shapes/limits")))
    url = str(related.base_url.join("/topics/aim"))
    node, place = NamedNode(f"{url}#message"), BlankNode("p")
    head = [each for each in stamped(url)[:-3] if "frame_id" not in each.predicate.value]
    frame, header = NamedNode(f"{TYPES}std_msgs/msg/Header#frame_id"), BlankNode("h")
    bodies = [
        [*head, Triple(header, frame, name), *point(place, *values)]
        for name in (Literal("map"), Literal("base"), typed("bWFw", "base64Binary"), typed("6d6170", "hexBinary"))
        for values in (("1", "2", "3"), ("2", "1", "3"), ("-1", "2", "3"), ("0", "0", "7"), ("1e0", "1.0", "-7"))
    ]
    shapes = linked_shape(related, url)
    assert limits not in shapes.objects(None, rdflib.RDFS.seeAlso)
    by_server = [is_taken(related, url, body) for body in bodies]
    assert not difference(bodies, by_server, conforming(shapes, bodies, node))
    assert 1 < sum(by_server) < len(bodies) / 2


def test_limits_that_relate_the_fields_of_a_property_are_in_the_linked_shape(related: httpx.Client) -> None:
    url = NamedNode(str(related.base_url.join("/resources/arm/range")))
    node, iri = BlankNode("v"), f"{TYPES}made_up/srv/SetRange_Request"
    is_one = [Triple(url, rdf.value, node), Triple(node, rdf.type, NamedNode(iri))]
    bodies = [
        [*is_one, Triple(node, NamedNode(f"{iri}#low"), low), Triple(node, NamedNode(f"{iri}#high"), high)]
        for low in (Literal(1), Literal(2.5))
        for high in (Literal(1), Literal(2.0), Literal(3.5))
    ]
    shapes = compiled(linked_shape(related, url.value))
    by_server = [is_taken(related, url.value, body) for body in bodies]
    assert not difference(bodies, by_server, [conforms(shapes, body) for body in bodies])
    assert 0 < sum(by_server) < len(bodies)


@pytest.mark.parametrize(("path", "type"), [("text", "std_msgs/msg/String"), ("speed", "std_msgs/msg/Float64")])
def test_logic_of_limits_is_in_the_linked_shape(related: httpx.Client, path: str, type: str) -> None:
    test_a_message_of_one_field_is_taken_where_it_conforms(related, path, type, "data")


def test_limits_that_no_shape_of_what_is_written_can_say_are_linked(client: httpx.Client) -> None:
    range = f"{TYPES}made_up/srv/SetRange_Request#"
    more = f"""@prefix sh: <http://www.w3.org/ns/shacl#> . @prefix rdf: <{rdf.iri}> .
        <#range> a sh:NodeShape ; sh:targetNode <../resources/arm/range> ;
          sh:property [ sh:path rdf:value ; sh:property [ sh:path <{range}low> ; sh:disjoint <{range}high> ] ] ."""
    url = str(client.base_url.join("/resources/arm/range"))
    limits = rdflib.URIRef(str(client.base_url.join("/shapes/limits")))
    assert limits not in linked_shape(client, url).objects(None, rdflib.RDFS.seeAlso)
    kept = client.put("/shapes/more", content=more, headers={"Content-Type": "text/turtle"})
    assert kept.status_code == 201, kept.text
    assert limits in linked_shape(client, url).objects(None, rdflib.RDFS.seeAlso)
    client.delete("/shapes/more")
    assert limits not in linked_shape(client, url).objects(None, rdflib.RDFS.seeAlso)


def test_what_is_not_there_has_no_shape(client: httpx.Client) -> None:
    for path in ("/parameters/lamp/none?shape", "/resources/arm/none?shape", "/topics/none?shape"):
        assert client.get(path).status_code == 404
