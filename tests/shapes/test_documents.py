"""Documents of robots conform to the shapes that they link to: the first document of each kind of all robots."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib.resources import files

import pytest
import rdflib
from pyoxigraph import NamedNode
from pyshacl.shapes_graph import ShapesGraph

from rosld.ontology.vocab import rdf, sh
from rosld.shapes.message import SHACL_SHACL
from tests.crawl.site import CONFORMS_TO, Site, document, site
from tests.shapes.values import validate

pytestmark = pytest.mark.slow

WITHOUT_SHAPE = {"queries/graph", ".well-known/wot"}
"""A query that constructs a graph, and a Thing Description, which W3C's own shapes cover (tests/server/hypermedia)."""
TARGETS = (sh.targetClass, NamedNode(sh.iri + "targetSubjectsOf"))
PREFIXES = """@prefix rdf: <http://www.w3.org/1999/02/22-rdf-syntax-ns#> .
@prefix map: <https://w3id.org/rosld/mapping#> . @prefix ros: <https://w3id.org/rosld#> .
"""
CLASSES = {
    "aircraft": {
        "Graph", "Container", "Node", "Topic", "Service", "Action", "Parameter", "Call", "Goal", "Write", "Hold",
        "Stop", "Property", "ComplexResource", "ActionResource", "Type", "Query", "Source", "File", "SparqlEndpoint",
        "Dataset", "ServerStatus", "Subscriptions", "SubscriptionService", "Authorization",
    },
    "rover": {"Graph", "Node", "Topic", "Action", "Stop", "Property", "Type", "Write"},
    "recording": {"Graph", "Node", "Topic", "Bag", "Record", "Container", "Type"},
    "ros1": {"Graph", "Node", "Topic", "Service", "Action", "Parameter", "Call", "Goal", "Property", "Type", "Write"},
    "ros2": {"Graph", "Node", "Topic", "Service", "Action", "Parameter", "Call", "Property", "Type", "Write"},
}  # fmt: skip
each_robot = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.ros2] if name == "ros2" else []) for name in CLASSES]
)
_JUDGED: set[frozenset[str]] = set()
_COMPILED: dict[tuple[str, str], ShapesGraph] = {}


def violations(robot: Site, url: str) -> str:
    """Return the violations of the shapes graphs that a document links to, according to pySHACL."""
    linked = dict.fromkeys(map(document, robot.documents[url].links(CONFORMS_TO)))
    return "".join(violations_of(robot, url, shapes) for shapes in linked)


def violations_of(robot: Site, url: str, shapes: str) -> str:
    conforms, _, words = validate(graph(robot, url), compiled(robot, shapes))
    return "" if conforms else words


def kind_of(robot: Site, url: str) -> frozenset[str]:
    """Return the classes, properties and shapes of a document, by which those of other robots are recognized."""
    said = robot.documents[url]
    terms = (each.object if each.predicate == rdf.type else each.predicate for each in said.triples)
    return frozenset(str(each).replace(robot.base, "/") for each in (*terms, *said.links(CONFORMS_TO)))


def compiled(robot: Site, shapes: str) -> ShapesGraph:
    if shapes == document(SHACL_SHACL):
        return shacl_shacl()
    key = (shapes, text(robot, shapes))
    if key not in _COMPILED:
        _COMPILED[key] = ShapesGraph(graph(robot, shapes))
    return _COMPILED[key]


def text(robot: Site, url: str) -> str:
    return robot.documents[url].text


def graph(robot: Site, url: str) -> rdflib.Graph:
    return rdflib.Graph().parse(data=text(robot, url), format="turtle", publicID=url)


@cache
def shacl_shacl() -> ShapesGraph:
    """Return W3C's shapes of shapes graphs (SHACL 1.0, appendix C), as shipped with pySHACL."""
    turtle = (files("pyshacl.assets") / "shacl-shacl.ttl").read_text()
    return ShapesGraph(rdflib.Graph().parse(data=turtle, format="turtle", publicID=SHACL_SHACL))


def targets_of(robot: Site, shape: str) -> set[object]:
    """Return the classes and properties whose instances and subjects are targets of a shape."""
    said = robot.documents[document(shape)].triples
    return {each.object for each in said if each.subject == NamedNode(shape) and each.predicate in TARGETS}


def is_target(robot: Site, url: str, targets: set[object]) -> bool:
    """Whether the resource at a URL, or a node within it, is one of these targets."""
    own = {url.removesuffix(".meta"), url.partition("?")[0]}  # a page is about its container
    return any(
        (each.object if each.predicate == rdf.type else each.predicate) in targets
        for each in robot.documents[url].triples
        if isinstance(each.subject, NamedNode) and document(each.subject.value) in own
    )


@each_robot
def test_every_document_conforms_to_the_shapes_that_it_links_to(name: str) -> None:
    robot = site(name)
    kept = f"{robot.base}data/"  # statements of clients about other resources are theirs
    kinds = {kind_of(robot, url): url for url in robot.of_each_kind() if not url.startswith(kept)}
    wrong = {url: words for kind, url in kinds.items() if kind not in _JUDGED and (words := violations(robot, url))}
    _JUDGED.update(kinds)
    assert not wrong, "\n".join(f"{url}\n{words}" for url, words in wrong.items())
    unlinked = {url.removeprefix(robot.base) for url, said in robot.documents.items() if not said.links(CONFORMS_TO)}
    assert unlinked <= WITHOUT_SHAPE


@each_robot
def test_every_resource_is_itself_judged_by_the_shape_that_its_document_links_to(name: str) -> None:
    robot = site(name)
    shapes = {url: shape for url in robot.documents for shape in robot.documents[url].links(CONFORMS_TO)[:1]}
    # The IRI of an ontology is permanent, wherever it is served.
    own = {
        url: shape
        for url, shape in shapes.items()
        if document(shape) == f"{robot.base}shapes/documents" and not shape.endswith("#Ontology")
    }
    assert CLASSES[name] <= {shape.partition("#")[2] for shape in own.values()}
    targets = {shape: targets_of(robot, shape) for shape in own.values()}
    assert not [url for url, shape in own.items() if not is_target(robot, url, targets[shape])]


def test_a_document_that_says_something_else_does_not_conform() -> None:
    aircraft = site("aircraft")
    for path, wrong in {
        "nodes/aircraft": "<> ros:publishes <http://elsewhere/> .",
        "topics/aircraft/engine/speed": "<> ros:name 5 .",
        "services/aircraft/start": "<> ros:provider [ ] .",
        "stop": "<> ros:stopped 'no' .",
        "parameters/aircraft/seats": "<> ros:value 1 , 2 .",
        "": "<> ros:state ros:Running .",
    }.items():
        said = aircraft.documents[aircraft.base + path]
        broken = replace(
            aircraft, answers={**aircraft.answers, said.url: replace(said, text=said.text + PREFIXES + wrong)}
        )
        assert violations(broken, said.url), path


def test_the_shape_of_mappings_finds_no_fault_with_what_is_no_mapping() -> None:
    aircraft = site("aircraft")
    documents = [url for url in aircraft.of_each_kind() if "/data/" not in url]
    assert not [url for url in documents if violations_of(aircraft, url, f"{aircraft.base}shapes/mapping")]
