"""Reads all that a server says, as Turtle, and holds each document against the shapes that it links to."""

from __future__ import annotations

import logging
from collections import defaultdict
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files

import httpx
import rdflib
from pyoxigraph import NamedNode, RdfFormat
from pyoxigraph import parse as parse_rdf
from pyshacl.graph_abstraction import DataGraph
from pyshacl.shapes_graph import ShapesGraph
from pyshacl.validator import Validator
from rdflib import RDF, SH, URIRef

from rosld.ontology.vocab import rdf
from rosld.server.http.link import parse
from rosld.shapes.message import SHACL_SHACL

CONFORMS_TO, CONSTRAINED_BY = "http://purl.org/dc/terms/conformsTo", "http://www.w3.org/ns/ldp#constrainedBy"
TURTLE = {"Accept": "text/turtle"}
_VERDICTS: dict[tuple[str, ...], str] = {}
NO_DOCUMENTS = ("?default", "?all", "?field=", "?format=")
"""What is in the URLs of what is no document of one resource."""


@dataclass
class Site:
    """The documents of a server, each with the URLs of the shapes that it links to."""

    base: str
    documents: dict[str, str] = field(default_factory=dict)
    conforms_to: dict[str, tuple[str, ...]] = field(default_factory=dict)
    constrained_by: dict[str, tuple[str, ...]] = field(default_factory=dict)
    compiled: dict[str, ShapesGraph] = field(default_factory=dict)

    def read(self, http: httpx.Client, url: str) -> list[str]:
        """Read what is at a URL, if it is a document; where it leads to."""
        answer = http.get(url, headers=TURTLE, follow_redirects=True)
        url = str(answer.url)
        links = parse(", ".join(answer.headers.get_list("link")))
        if answer.status_code != 200 or not answer.headers["content-type"].startswith("text/turtle"):
            return [link.target for link in links]
        self.documents[url] = answer.text
        self.conforms_to[url] = tuple(link.target for link in links if link.rel == CONFORMS_TO)
        self.constrained_by[url] = tuple(link.target for link in links if link.rel == CONSTRAINED_BY)
        return [*_iris(answer.text, url), *(link.target for link in links)]

    def of_each_kind(self, most: int = 3) -> list[str]:
        """At most so many of the documents that say the same properties of instances of the same classes.

        Of shapes the classes alone count: the shapes of shapes take a hundred times as long as all the others.
        """
        kinds: dict[frozenset[object], list[str]] = defaultdict(list)
        for url, text in self.documents.items():
            quads = list(parse_rdf(text, RdfFormat.TURTLE, base_iri=url))
            classes = {quad.object for quad in quads if quad.predicate == rdf.type}
            linked = {document(shapes) for shapes in self.conforms_to[url]}
            properties = {quad.predicate for quad in quads} if document(SHACL_SHACL) not in linked else set()
            kinds[frozenset([*classes, *properties, *linked])].append(url)
        return [url for urls in kinds.values() for url in urls[:most]]

    def graph(self, url: str) -> rdflib.Graph:
        """The document at a URL."""
        return graph_of(self.documents[url], url)

    def violations(self, url: str) -> str:
        """What a document breaks of the shapes graphs that it links to, as pySHACL tells it; nothing if it conforms."""
        linked = dict.fromkeys(map(document, self.conforms_to[url]))
        return "".join(self.violations_of(url, shapes) for shapes in linked)

    def violations_of(self, url: str, shapes: str) -> str:
        """What a document breaks of the shapes graph at a URL; what several servers say alike is judged once."""
        shaping = "" if shapes == document(SHACL_SHACL) else self.documents[shapes]
        key = tuple(each.replace(self.base, "http://robot/") for each in (url, self.documents[url], shapes, shaping))
        if key not in _VERDICTS:
            _VERDICTS[key] = self._judged(url, shapes)
        return _VERDICTS[key]

    def _judged(self, url: str, shapes: str) -> str:
        # As `pyshacl.validate` does it, which would compile the shapes again for each document.
        validator = Validator(DataGraph.from_rdflib(self.graph(url)), shacl_graph=rdflib.Graph(), options=_options())
        validator.shacl_graph = self._compiled(shapes)
        conforms, _, words = validator.run()
        return "" if conforms else str(words)

    def _compiled(self, shapes: str) -> ShapesGraph:
        if shapes not in self.compiled:
            graph = shacl_shacl() if shapes == document(SHACL_SHACL) else self.graph(shapes)
            self.compiled[shapes] = ShapesGraph(graph)
        return self.compiled[shapes]

    def is_target(self, url: str) -> bool:
        """Whether the resource at a URL, or a node within it, is judged by the first shape that it links to."""
        shape, said = URIRef(self.conforms_to[url][0]), self.graph(url)
        shapes = self._compiled(document(shape)).graph
        kinds, paths = shapes.objects(shape, SH.targetClass), shapes.objects(shape, SH.targetSubjectsOf)
        targets = {node for kind in kinds for node in said.subjects(RDF.type, kind)}
        targets |= {node for path in paths for node in said.subjects(path)}
        own = {url.removesuffix(".meta"), url.partition("?")[0]}  # a page is about its container
        return not own.isdisjoint({document(str(node)) for node in targets})


def _options() -> dict[str, object]:
    return {"logger": logging.getLogger("pyshacl")}


def document(url: str) -> str:
    """A URL without its fragment."""
    return url.partition("#")[0]


def graph_of(turtle: str, url: str) -> rdflib.Graph:
    """Turtle as rdflib reads it."""
    return rdflib.Graph().parse(data=turtle, format="turtle", publicID=url)


@cache
def shacl_shacl() -> rdflib.Graph:
    """W3C's shapes of shapes graphs (SHACL 1.0, appendix C), as pySHACL brings them along."""
    return graph_of((files("pyshacl.assets") / "shacl-shacl.ttl").read_text(), SHACL_SHACL)


def crawl(http: httpx.Client, site: Site) -> Site:
    """Read everything that can be reached from the entry by links, in the documents and in their header fields."""
    waiting, seen = [site.base], set(site.documents)
    while waiting:
        url = document(waiting.pop())
        if url in seen or not url.startswith(site.base) or any(mark in url for mark in NO_DOCUMENTS):
            continue
        seen.add(url)
        waiting += site.read(http, url)
    return site


def _iris(turtle: str, url: str) -> list[str]:
    """The IRIs in a document."""
    quads = parse_rdf(turtle, RdfFormat.TURTLE, base_iri=url)
    return [term.value for quad in quads for term in quad.triple if isinstance(term, NamedNode)]
