"""Thing Descriptions in RDF: equal to their JSON under W3C's context, and conforming to W3C's shapes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pyshacl
import pytest
from pyoxigraph import CanonicalizationAlgorithm, Dataset, Quad, RdfFormat, Triple, parse
from rdflib import RDF, Graph, Literal, URIRef
from rdflib.namespace import SH, XSD

pytestmark = pytest.mark.slow

WOT = Path(__file__).parent / "hypermedia" / "wot"
TD, JS = "https://www.w3.org/2019/wot/td#", "https://www.w3.org/2019/wot/json-schema#"
THING = {"Accept": "application/td+json"}
COUNTS = frozenset(f"{JS}{name}" for name in ("minItems", "maxItems", "minLength", "maxLength"))
NUMBERS = frozenset(
    f"{JS}{name}" for name in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf")
)
AIRCRAFT = ("/resources/aircraft/", "/resources/aircraft/engine/", "/.well-known/wot")
SYNTAXES = {
    "text/turtle": RdfFormat.TURTLE,
    "application/ld+json": RdfFormat.JSON_LD,
    "application/n-triples": RdfFormat.N_TRIPLES,
    "application/rdf+xml": RdfFormat.RDF_XML,
}


@pytest.fixture(scope="module")
def plane(start_server: Callable[..., Any]) -> httpx.Client:
    """The aircraft, started."""
    http: httpx.Client = start_server("aircraft").http
    http.post("/services/aircraft/start", json={})
    return http


def expanded(http: httpx.Client, path: str) -> list[Triple]:
    """Return the triples of a Thing Description by a JSON-LD processor with W3C's context."""
    answer = http.get(path, headers=THING, params={} if path.startswith("/.") else {"format": "td"})
    return expand(answer.json(), f"{http.base_url}{path[1:]}")


def expand(thing: dict[str, Any], base: str) -> list[Triple]:
    context = json.loads((WOT / "context.json").read_text())["@context"]
    context["security"]["@type"] = "xsd:string"
    thing["@context"] = [context if isinstance(each, str) else each for each in thing["@context"]]
    return [each.triple for each in parse(json.dumps(thing), format=RdfFormat.JSON_LD, base_iri=base)]


def served(http: httpx.Client, path: str, media_type: str) -> list[Triple]:
    answer = http.get(path, headers={"Accept": media_type}, params={} if path.startswith("/.") else {"format": "td"})
    assert (answer.status_code, answer.headers["content-type"].partition(";")[0]) == (200, media_type), answer.text
    found = parse(answer.content, format=SYNTAXES[media_type], base_iri=str(answer.url))
    return [each.triple for each in found]


def canonical(triples: list[Triple]) -> Dataset:
    dataset = Dataset(Quad(each.subject, each.predicate, each.object) for each in triples)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return dataset


def violations(triples: list[Triple]) -> str:
    """Return the violations of W3C's shapes."""
    data, said = Graph(), Graph().parse(data="".join(f"{each} .\n" for each in triples), format="nt")
    for subject, predicate, value in said:
        if str(predicate) in NUMBERS and (subject, RDF.type, URIRef(f"{JS}IntegerSchema")) not in said:
            value = Literal(float(str(value)), datatype=XSD.double)
        elif str(predicate) in COUNTS:
            value = Literal(int(str(value)), datatype=XSD.unsignedInt)
        data.add((subject, predicate, value))
    text = (WOT / "td-validation.ttl").read_text().replace("rdf:HTML", "xsd:string")
    shapes = Graph().parse(data=text, format="turtle")
    for shape in list(shapes.subjects(SH.path, URIRef(f"{TD}hasSecurityConfiguration"))):
        shapes.set((shape, SH.nodeKind, SH.Literal))
    for shape in list(shapes.subjects(SH.path, URIRef("http://schema.org/unitCode"))):
        shapes.set((shape, SH.nodeKind, SH.IRI))
        shapes.remove((shape, SH.datatype, None))
    for shape in list(shapes.subjects(SH.path, RDF.type)):  # that requires one of seven classes to be a string
        for demand in (SH.datatype, SH.nodeKind):
            shapes.remove((shape, demand, None))
    conforms, _, report = pyshacl.validate(data, shacl_graph=shapes)
    return "" if conforms else str(report)


def of_robots(plane: httpx.Client, rover: httpx.Client) -> Iterator[tuple[httpx.Client, str]]:
    yield from ((plane, path) for path in AIRCRAFT)
    yield from ((rover, path) for path in ("/.well-known/wot", "/resources/camera/"))


def test_every_syntax_says_what_the_expanded_json_says(plane: httpx.Client, rover: httpx.Client) -> None:
    for http, path in of_robots(plane, rover):
        expected = canonical(expanded(http, path))
        for media_type in SYNTAXES:
            assert canonical(served(http, path, media_type)) == expected, (path, media_type)


def test_the_shapes_of_w3c_find_nothing_wrong(plane: httpx.Client, rover: httpx.Client) -> None:
    for http, path in ((plane, AIRCRAFT[0]), (plane, AIRCRAFT[1]), (rover, "/resources/camera/")):
        assert violations(served(http, path, "text/turtle")) == "", path


def test_the_shapes_of_w3c_find_what_is_missing(plane: httpx.Client) -> None:
    found = served(plane, AIRCRAFT[0], "text/turtle")
    assert violations([each for each in found if each.predicate.value != TD + "title"]) != ""
