"""One rosld for the folder, over real HTTP; each test has its own container under `/data/`."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import httpx
import pytest
from pyoxigraph import CanonicalizationAlgorithm, Dataset, NamedNode, Quad, RdfFormat, Triple, parse

from rosld.ontology.vocab import dcterms, ldp, rdf
from tests.conformance.ldp.conftest import TURTLE, running, triples

EX = "http://example.org/"
_COUNTED = itertools.count(1)


@dataclass(frozen=True)
class Endpoint:
    """A server: the URL of its entry, and a client for it."""

    url: str
    http: httpx.Client

    def query(self, text: str, **parameters: str | list[str]) -> httpx.Response:
        """Send a query by GET."""
        return self.http.get(f"{self.url}sparql", params={"query": text, **parameters})

    def ask(self, text: str, **parameters: str | list[str]) -> bool:
        """Return the answer to an ASK."""
        return boolean(self.query(text, **parameters))

    def post(self, body: bytes | str, media_type: str | None, query: str = "", **headers: str) -> httpx.Response:
        """Send a POST to the endpoint."""
        content = body.encode() if isinstance(body, str) else body
        typed = {} if media_type is None else {"Content-Type": media_type}
        return self.http.post(f"{self.url}sparql{query}", content=content, headers=typed | headers)

    def form(self, beside: str = "", /, **fields: str | list[str]) -> httpx.Response:
        """Post a form to the endpoint; an underscore in a name stands for a hyphen."""
        return self.http.post(
            f"{self.url}sparql{beside}", data={name.replace("_", "-"): value for name, value in fields.items()}
        )


@dataclass(frozen=True)
class Store:
    """A container under `/data/` and its graphs, named by `?graph=` or by their own URLs."""

    endpoint: Endpoint
    url: str
    direct: bool = False

    def at(self, name: str) -> str:
        """Return the name of a graph; a whole IRI is unchanged."""
        return name if ":" in name else self.url + name

    def send(
        self, method: str, name: str, body: bytes | str = b"", media_type: str | None = None, **headers: str
    ) -> httpx.Response:
        """Send a request for a graph; a header `If_Match="x"` is sent as `If-Match: x`."""
        sent = {key.replace("_", "-"): value for key, value in headers.items()}
        if media_type is not None:
            sent["Content-Type"] = media_type
        content = (body.encode() if isinstance(body, str) else body) or None
        if self.direct:
            return self.endpoint.http.request(method, self.at(name), content=content, headers=sent)
        url = f"{self.endpoint.url}graphs"
        return self.endpoint.http.request(method, url, params={"graph": self.at(name)}, content=content, headers=sent)

    def put(self, name: str, turtle: str) -> str:
        """Put a graph; return its name."""
        answer = self.send("PUT", name, turtle, TURTLE)
        assert answer.status_code in (201, 204), answer.text
        return self.at(name)

    def holds(self, name: str, turtle: str) -> bool:
        """Whether a graph has exactly these triples, besides the server's own about it."""
        answer = self.send("GET", name, Accept=TURTLE)
        assert answer.status_code == 200, answer.text
        url = NamedNode(self.at(name))
        said = (each for each in triples(answer) if not _is_managed(each, url))
        wanted = parse(turtle.encode(), RdfFormat.TURTLE, base_iri=url.value)
        return canonical(said) == canonical(quad.triple for quad in wanted)


def boolean(answer: httpx.Response) -> bool:
    """Return the answer to an ASK in JSON."""
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/sparql-results+json"
    found = answer.json()["boolean"]
    assert isinstance(found, bool)
    return found


def canonical(graph: Iterable[Triple]) -> set[str]:
    """Return a graph with canonical blank nodes: equal for isomorphic graphs."""
    dataset = Dataset(Quad(each.subject, each.predicate, each.object) for each in graph)
    dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
    return {str(quad) for quad in dataset}


def _is_managed(triple: Triple, url: NamedNode) -> bool:
    if triple.subject != url:
        return False
    kind = triple.object.value if triple.predicate == rdf.type and isinstance(triple.object, NamedNode) else ""
    return kind.startswith(ldp.iri) or triple.predicate in (dcterms.created, dcterms.modified)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[Endpoint]:
    """The embedded aircraft."""
    with running("aircraft", "--max-publish-rate", "100000") as served:
        yield Endpoint(served.url, served.http)


@pytest.fixture(scope="module")
def read_only() -> Iterator[Endpoint]:
    """A read-only server."""
    with running("aircraft", "--read-only") as served:
        yield Endpoint(served.url, served.http)


def new_store(endpoint: Endpoint, *, direct: bool = False) -> Store:
    """Create a new container."""
    return Store(endpoint, f"{endpoint.url}data/of-{next(_COUNTED)}/", direct)


@pytest.fixture
def store(endpoint: Endpoint) -> Store:
    """A container for one test, with graphs named by `?graph=`."""
    return new_store(endpoint)


@pytest.fixture(params=("indirect", "direct"))
def graphs(request: pytest.FixtureRequest, endpoint: Endpoint) -> Store:
    """A container for one test, with graphs named by `?graph=`, and by their own URLs."""
    return new_store(endpoint, direct=request.param == "direct")


@pytest.fixture
def three(store: Store) -> tuple[str, str, str]:
    """The names of three graphs with one triple each: `ex:data1 a ex:Kind1` and so on."""
    one, two, three = (store.put(f"{n}", f"<{EX}data{n}> a <{EX}Kind{n}> .") for n in (1, 2, 3))
    return one, two, three
