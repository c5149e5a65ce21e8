"""The graph store `/graphs` (SPARQL 1.1 Graph Store HTTP Protocol): graphs by their names, URLs of this server.

`?graph=URL` stands for the resource at that URL; the request is redirected internally to its methods.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple
from urllib.parse import parse_qsl, unquote, urlencode, urljoin

from msgspec.structs import replace
from pyoxigraph import NamedNode, Quad, Triple
from starlette.responses import Response
from starlette.types import Scope

from rosld.ontology.body import parse_dataset
from rosld.ontology.document import Document
from rosld.ontology.triples import labelled, text, triples_about
from rosld.ontology.vocab import dcterms, rdf, rdfs, sd
from rosld.server.auth import enforcement
from rosld.server.http.body import MULTIPART
from rosld.server.http.fields import to_uri
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import ANYTHING, MessageSchemas
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.ldp.base import StoredResource
from rosld.server.resources.ldp.containers import ContainerResource
from rosld.server.resources.ldp.routes import AbsentResource
from rosld.server.resources.ldp.statements import N3_PATCH
from rosld.server.resources.sparql_endpoint import accept_of, answer_query, available_formats
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import FORMATS, OFFERS, RDF_BODIES, SPARQL_UPDATE
from rosld.server.rest.path_item import ANY_TYPE, FORMAT, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import READ, Answer, Resource
from rosld.server.rest.state import State
from rosld.server.settings import Settings
from rosld.server.sparql import results
from rosld.server.sparql.protocol import QueryRequest, requested_timeout
from rosld.server.sparql.update.base import UpdateRunner
from rosld.server.sparql.update.copying import unmanaged_triples
from rosld.server.sparql.update.operations import ChangeData, GraphVerb, ManageGraph, Operation

DATASET_BODIES = ("application/n-quads", "application/trig")
_DIRECTLY = "A graph is named by its URL; GET, PUT, PATCH and DELETE of that URL do the same."
_MAX_PARAMETERS = 200
_LONGEST_CACHED = 4096


class GraphSelection(NamedTuple):
    """Graph selected by a query string: one by its absolute URI, the default graph, all graphs (`?all`), or none.

    `other_parameters` are the percent-encoded parameters outside the protocol.
    """

    graph: str | None
    default: bool
    all: bool
    other_parameters: str


def parse_graph_selection(query_string: bytes, base: str) -> GraphSelection:
    """Return the selected graph (Graph Store Protocol 4.2); relative IRIs are resolved against `base` (4.1).

    Raises a 400 Problem for more than one graph, and for an invalid IRI.
    """
    return _remembered(query_string, base) if len(query_string) <= _LONGEST_CACHED else _parse_query(query_string, base)


def _parse_query(query_string: bytes, base: str) -> GraphSelection:
    try:
        pairs = parse_qsl(
            query_string.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=_MAX_PARAMETERS
        )
    except ValueError as error:
        raise Problem(400, f"The query string cannot be read: {error}.") from error
    graphs = [value for name, value in pairs if name == "graph"]
    defaults = sum(name == "default" for name, _ in pairs)
    all = sum(name == "all" for name, _ in pairs)
    if len(graphs) + defaults + all > 1:
        raise Problem(
            400, "Name one graph: one ?graph=IRI, or ?default (SPARQL 1.1 Graph Store Protocol 4.2); or ?all."
        )
    others = urlencode([(name, value) for name, value in pairs if name not in ("graph", "default", "all")])
    return GraphSelection(_resolved(graphs[0], base) if graphs else None, defaults == 1, all == 1, others)


_remembered = lru_cache(maxsize=256)(_parse_query)


def _resolved(iri: str, base: str) -> str:
    try:
        return to_uri(NamedNode(urljoin(base, iri)).value)
    except ValueError as error:
        raise Problem(400, f"graph={iri[:200]!r} is not an IRI: {error}.") from error


_GRAPH = QueryParameter(
    "graph",
    "The name of a graph: the URL of its resource, which responds alike (SPARQL 1.1 Graph Store HTTP Protocol).",
    {"type": "string", "format": "uri-reference"},
)
_DEFAULT = QueryParameter("default", "Instead of `graph`: the union of all graphs; writes go to the default document.")
_ALL = QueryParameter("all", "Instead of `graph`: all graphs with their names, as N-Quads, TriG or JSON-LD.")
_GRAPH_FORMAT = replace(FORMAT, schema={"type": "string", "enum": [*{**FORMATS, **available_formats("CONSTRUCT")}]})


def _methods(settings: Settings) -> frozenset[str]:
    return READ if settings.read_only else READ | {"PUT", "POST", "PATCH", "DELETE"}


class GraphStore(SessionResource):
    """The graph store, whose only state is that of its graphs."""

    kind = "Graph store"
    shape = "Dataset"
    links = ()
    takes_forms = False
    accepts: Mapping[str, Sequence[str]] = {
        "PUT": RDF_BODIES,
        "POST": (*RDF_BODIES, MULTIPART),
        "PATCH": (SPARQL_UPDATE, N3_PATCH),
    }

    path = "graphs"

    def __init__(self, services: Services, resolve: Callable[[Scope], Resource], updates: UpdateRunner | None) -> None:
        super().__init__(services)
        self._settings = services.settings
        self._resolve = resolve
        self._default = DefaultGraphResource(services, f"{self.url}?default")
        self._all = DatasetResource(services, f"{self.url}?all", updates)

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        of_a_graph = (_GRAPH, _DEFAULT, _ALL)
        return PathItem(
            "The graph store: a graph by its name",
            (*OFFERS, ANY_TYPE),
            ANYTHING,
            (_GRAPH, _DEFAULT, _ALL, _GRAPH_FORMAT),
            {
                "PUT": WriteMethod(accepts=(*self.accepts["PUT"], ANY_TYPE), query=of_a_graph),
                **dict.fromkeys(("POST", "PATCH", "DELETE"), WriteMethod(query=of_a_graph)),
            },
        )

    def methods(self) -> frozenset[str]:
        return _methods(self._settings)

    async def state(self) -> State:
        return self.states.get_or_make(self.url, 0, lambda: State(self.document))

    def document(self) -> Document:
        """Return the description of the graph store."""
        return Document(self.url, self._description())

    def _description(self) -> tuple[Triple, ...]:
        store, default = NamedNode(self.url), NamedNode(self._default.url)
        return (
            *triples_about(
                store,
                (rdf.type, sd.Dataset),
                *labelled(dcterms.title, "The graph store"),
                (rdfs.comment, text(f"Every graph is here by its name: {self.url}?graph=URL. {_DIRECTLY}")),
                (sd.defaultGraph, default),
                (rdfs.seeAlso, NamedNode(f"{self.space.base}sparql")),
                (rdfs.seeAlso, NamedNode(self._all.url)),
            ),
            *triples_about(default, (rdfs.label, text("The default graph: all graphs together"))),
            *triples_about(
                NamedNode(self._all.url), (rdfs.label, text("All graphs with their names, as N-Quads or TriG"))
            ),
        )

    async def select_variant(self, exchange: Exchange) -> Resource:
        """Return the resource whose graph the query string selects.

        Raises a 400 Problem for a write without a graph (SPARQL 1.1 Graph Store Protocol 4.2).
        """
        selection = parse_graph_selection(exchange.request.scope["query_string"], self.url)
        if selection.default and (exchange.method in READ or self._settings.read_only):
            return self._default
        if selection.default:
            document = self.space.base + self._settings.default_document
            return await self._graph(exchange, document, selection.other_parameters)
        if selection.all:
            return self._all
        if selection.graph is not None:
            return await self._graph(exchange, selection.graph, selection.other_parameters)
        if exchange.method == "POST":  # the server chooses a name (Graph Store Protocol 5.5)
            return await self._graph(exchange, self.space.container("data"), selection.other_parameters)
        if exchange.method in READ:
            return self
        raise Problem(
            400, f"Name a graph: {self.url}?graph=IRI, or {self.url}?default (SPARQL 1.1 Graph Store Protocol 4.2)."
        )

    async def _graph(self, exchange: Exchange, graph: str, others: str) -> Resource:
        exchange.redirect_internally(self._scope(exchange, graph, others))
        if not exchange.permissions.is_unrestricted:
            enforcement.require_path(
                exchange.permissions, exchange.method, enforcement.location_of(exchange.request.scope, self.space)
            )
        resource = self._resolve(exchange.request.scope)
        if resource is self:
            raise Problem(400, f"<{graph[:200]}> is the graph store itself, not one of its graphs.")
        if resource.url.partition("?")[0] != graph.partition("?")[0]:  # different IRIs name different graphs
            raise Problem(403, f"The graph <{graph[:200]}> must be named <{resource.url[:200]}>.")
        if exchange.method in ("PUT", "POST"):
            await _prepare(exchange, resource)
        return await resource.select_variant(exchange)

    def _scope(self, exchange: Exchange, graph: str, others: str) -> Scope:
        """Return the scope of the request at the graph's own URL. Raises Problems for graphs elsewhere."""
        space = self.space
        if "#" in graph or not graph.startswith(space.base):
            raise self._elsewhere(exchange.method, graph)
        return {**exchange.request.scope, **_address(graph[len(space.base) :], space.path, others)}

    def _elsewhere(self, method: str, graph: str) -> Problem:
        space, shown = self.space, f"<{graph[:200]}>"
        if method in READ:
            return Problem(404, f"There is no graph {shown}: the names of graphs are URLs below {space.base}")
        container = space.container("data")
        return Problem(
            403, f"The graph {shown} cannot be created: choose a name below {container}, such as {container}NAME"
        )


@lru_cache(maxsize=256)
def _address(below: str, root: str, others: str) -> Scope:
    """Return the location `below` the root of this server, with additional query parameters."""
    path, _, own = below.partition("?")
    return {
        "path": unquote(root + path),
        "raw_path": (root + path).encode("ascii"),
        "query_string": "&".join(part for part in (own, others) if part).encode("ascii"),
    }


async def _prepare(exchange: Exchange, resource: Resource) -> None:
    """Restrict a write to the semantics of the protocol: merging or creating a graph."""
    if exchange.method == "POST" and not isinstance(resource, StoredResource):
        await resource.prepare()
        raise Problem(
            405,
            "POST would merge triples into the state of the robot: write it with PUT or PATCH, as far as it is "
            f"writable, or POST to {resource.url} itself.",
            headers={"Allow": ", ".join(sorted(resource.methods() - {"POST"}))},
        )
    method, makes = exchange.method, isinstance(resource, AbsentResource | ContainerResource)
    if method == "POST" and isinstance(resource, AbsentResource):
        await resource.merge_into(exchange)
    if makes and exchange.essence is not None and exchange.essence not in RDF_BODIES:
        raise Problem(
            415,
            f"Send a graph as {', '.join(RDF_BODIES)}, not as {exchange.essence}.",
            headers={f"Accept-{method.capitalize()}": ", ".join(RDF_BODIES)},
        )


class _Whole(SessionResource):
    """All graphs, read by a query."""

    links = ()
    form: str
    request: QueryRequest

    async def custom_get(self, exchange: Exchange) -> Response:
        accept = accept_of(exchange, available_formats(self.form))
        if exchange.method == "HEAD":
            content_type = results.content_type(results.choose_media_type(self.form, accept))
            return Response(headers={"Content-Type": content_type, "Vary": "Accept", "Cache-Control": "no-cache"})
        request = replace(self.request, timeout=requested_timeout(exchange.query.items()))
        return await answer_query(self.services.sparql, request, accept, permissions=exchange.permissions)


class DefaultGraphResource(_Whole):
    """The default graph: the union of all graphs, as in queries. Writes go to the default document."""

    kind = "Default graph"
    form = "CONSTRUCT"
    request = QueryRequest("CONSTRUCT { ?s ?p ?o } WHERE { ?s ?p ?o }")

    def methods(self) -> frozenset[str]:
        return _methods(self.services.settings)


class DatasetResource(_Whole):
    """The dataset: all graphs with their names. PUT and POST write its stored graphs."""

    kind = "Dataset"
    form = results.QUADS
    request = QueryRequest("SELECT ?g ?s ?p ?o WHERE { GRAPH ?g { ?s ?p ?o } }", quads=True)
    accepts: Mapping[str, Sequence[str]] = {"PUT": DATASET_BODIES, "POST": DATASET_BODIES}
    takes_forms = False

    def __init__(self, services: Services, url: str, updates: UpdateRunner | None) -> None:
        super().__init__(services, url)
        self._updates = updates

    def methods(self) -> frozenset[str]:
        return READ if self._updates is None else READ | {"PUT", "POST"}

    async def put(self, exchange: Exchange) -> Answer:
        """Replace each stored graph that the body names; all other graphs are unchanged."""
        return await self._take(exchange, replaces=True)

    async def post(self, exchange: Exchange) -> Answer:
        """Merge the body into the stored graphs that it names."""
        return await self._take(exchange, replaces=False)

    async def _take(self, exchange: Exchange, *, replaces: bool) -> Answer:
        assert self._updates is not None
        data, media_type = await exchange.body(), exchange.media_type
        graphs = await asyncio.to_thread(parse_dataset, data, media_type, self.url)
        strange = next((name for name in graphs if not name.startswith(self.space.base)), None)
        if strange is not None:
            container = f"{self.space.base}data/"
            raise Problem(
                403, f"The graph <{strange[:200]}> cannot be created: choose names below {container}. Nothing was done."
            )
        stored = {name: triples for name, triples in graphs.items() if self._updates.is_stored(name)}
        operations = await asyncio.to_thread(_operations, stored, replaces=replaces)
        return await self._updates.carry_out(operations, permissions=exchange.permissions)


def _operations(graphs: Mapping[str, Sequence[Triple]], *, replaces: bool) -> Sequence[Operation]:
    """Return the operations that make graphs state these triples, except server-managed ones."""
    found: list[Operation] = []
    for name, triples in graphs.items():
        found.append(ManageGraph(GraphVerb.CREATE, name, silent=True))
        if replaces:
            found.append(ManageGraph(GraphVerb.CLEAR, name, silent=True))
        new = unmanaged_triples(name, triples)
        graph = NamedNode(name)
        found.append(ChangeData(inserts=tuple(Quad(each.subject, each.predicate, each.object, graph) for each in new)))
    return found
