"""One rosld for the folder, over real HTTP; each test has its own container under `/data/`."""

from __future__ import annotations

import itertools
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import httpx
import pytest
from pyoxigraph import NamedNode, RdfFormat, Triple, parse

from rosld.ontology.vocab import ldp
from rosld.server.http.fields import Link, parse_links
from tests.serving_thread import ServingThread

TURTLE = "text/turtle"
ROBOT = (
    *("", "topics/", "topics/aircraft/", "nodes/", "services/", "parameters/", "parameters/aircraft/"),
    *("resources/", "resources/aircraft/", "mappings/", "types/", "shapes/", "calls/", "queries/", "bags/"),
)
"""The robot's containers."""
_COUNTED = itertools.count(1)


@dataclass(frozen=True)
class Served:
    """A running server: its entry URL and a client for it."""

    url: str
    http: httpx.Client

    def at(self, path: str) -> Place:
        """Return the URL of a path."""
        return Place(self.url + path, self.http)

    def place(self, name: str) -> Place:
        """Create a new Basic container under `/data/`."""
        made = self.at(f"data/{name}-{next(_COUNTED)}/")
        answer = made.send("PUT", model="BasicContainer")
        assert answer.status_code == 201, answer.text
        return made


@dataclass(frozen=True)
class Place:
    """A container and requests to its members; a name that is a whole URL stands for that URL."""

    url: str
    http: httpx.Client

    def at(self, name: str) -> str:
        """Return the URL of a member."""
        return name if name.startswith("http") else self.url + name

    def send(
        self,
        method: str,
        name: str = "",
        body: bytes | str = b"",
        media_type: str | None = None,
        *,
        model: str | None = None,
        **headers: str,
    ) -> httpx.Response:
        """Send a request; a Link header requests `model`, a header `If_Match="x"` is sent as `If-Match: x`."""
        sent = {name.replace("_", "-"): value for name, value in headers.items()}
        if media_type is not None:
            sent["Content-Type"] = media_type
        if model is not None:
            sent["Link"] = f'<{ldp.iri}{model}>; rel="type"'
        content = body.encode() if isinstance(body, str) else body
        return self.http.request(method, self.at(name), content=content or None, headers=sent)

    def get(self, name: str = "", **headers: str) -> httpx.Response:
        return self.send("GET", name, **headers)

    def put(self, name: str, turtle: str, *, model: str | None = None, **headers: str) -> httpx.Response:
        """Send a PUT of Turtle that must succeed."""
        answer = self.send("PUT", name, turtle, TURTLE, model=model, **headers)
        assert answer.status_code in (200, 201, 204), answer.text
        return answer

    def post(self, turtle: str = "", *, to: str = "", model: str | None = None, **headers: str) -> str:
        """Send a POST of Turtle that must create a resource; return its URL."""
        answer = self.send("POST", to, turtle or "<> <http://ex.org/p> 1 .", TURTLE, model=model, **headers)
        assert answer.status_code == 201, answer.text
        return answer.headers["location"]

    def graph(self, name: str = "", **headers: str) -> set[Triple]:
        """Return the triples of a resource."""
        answer = self.get(name, **({"Accept": TURTLE} | headers))
        assert answer.status_code == 200, answer.text
        return triples(answer)

    def objects(self, name: str, predicate: NamedNode, **headers: str) -> set[object]:
        """Return the objects of a predicate of the resource itself; IRIs as text."""
        url = NamedNode(self.at(name))
        found = (each for each in self.graph(name, **headers) if each.subject == url and each.predicate == predicate)
        return {each.object.value if isinstance(each.object, NamedNode) else each.object for each in found}

    def contained(self, name: str = "", **headers: str) -> set[object]:
        """Return the URLs of the members of a container."""
        return self.objects(name, ldp.contains, **headers)


def triples(answer: httpx.Response) -> set[Triple]:
    """Return the triples of a response in any RDF syntax."""
    syntax = RdfFormat.from_media_type(answer.headers["content-type"].partition(";")[0])
    assert syntax is not None, answer.headers["content-type"]
    return {quad.triple for quad in parse(answer.content, format=syntax, base_iri=str(answer.url))}


def links(answer: httpx.Response) -> list[Link]:
    """Return the links of a response."""
    return list(parse_links(", ".join(answer.headers.get_list("link"))))


def models(answer: httpx.Response) -> set[str]:
    """Return the local names of the LDP types that a response links to."""
    return {each.target.removeprefix(ldp.iri) for each in links(answer) if each.rel == "type"}


@contextmanager
def running(*arguments: str) -> Iterator[Served]:
    """Run a server and end it in an orderly way."""
    server = ServingThread.of_command(*arguments, "--port", "0")
    try:
        with httpx.Client(timeout=15) as http:
            yield Served(server.url(), http)
        assert server.poll() is None, "the server died during the tests"
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait(60)


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    """The embedded aircraft."""
    with running("aircraft", "--max-publish-rate", "100000") as one:
        yield one


@pytest.fixture(scope="module")
def demanding() -> Iterator[Served]:
    """A server that requires If-Match."""
    with running("aircraft", "--demand-if-match") as one:
        yield one


@pytest.fixture
def place(served: Served, request: pytest.FixtureRequest) -> Place:
    """A container for one test."""
    return served.place(re.sub(r"[^a-z0-9]+", "-", request.node.name.lower())[:40].strip("-"))


@pytest.fixture
def robots(served: Served) -> list[Place]:
    """The robot's containers."""
    return [served.at(path) for path in ROBOT]


@pytest.fixture
def containers(served: Served, robots: list[Place]) -> list[Place]:
    """A container under `/data/`, and the robot's."""
    return [served.place("any"), *robots]


@pytest.fixture
def kinds(place: Place) -> dict[str, str]:
    """URLs of one resource of every interaction model."""
    place.put("rdf", "<> <http://ex.org/p> 1 .")
    assert place.send("PUT", "file.txt", "some words", "text/plain").status_code == 201
    place.put("basic/", "", model="BasicContainer")
    place.put("direct/", "", model="DirectContainer")
    place.put("indirect/", f"<> <{ldp.iri}insertedContentRelation> <http://ex.org/topic> .", model="IndirectContainer")
    models = ("RDFSource", "NonRDFSource", "BasicContainer", "DirectContainer", "IndirectContainer")
    names = ("rdf", "file.txt", "basic/", "direct/", "indirect/")
    return {model: place.at(name) for model, name in zip(models, names, strict=True)}
