"""The SPARQL endpoint `/sparql`: queries by GET and POST, a page, and a service description."""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Iterable, Mapping, Sequence

from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple
from starlette.responses import Response, StreamingResponse

from rosld.ontology.document import Document
from rosld.ontology.triples import statements, text, triples_about
from rosld.ontology.vocab import rdf, rdfs, ros, sd
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.history.tables import TableParts
from rosld.server.html.page import Notice, NoticeLevel, PageResults, SparqlPage, StoredQueryLink
from rosld.server.html.render import render_sparql
from rosld.server.html.site import QUERY_EDITOR_POLICY
from rosld.server.http.body import FORM
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import (
    ANYTHING,
    BOOLEAN,
    TEXT,
    URI,
    JsonSchema,
    MessageSchemas,
    json_array,
    json_object,
)
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.ldp.bodies import single_chunk
from rosld.server.resources.tables import table_response
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.formats import COLUMNS, HTML, RDF_BODIES
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.path_item import FORMAT, PathItem, QueryParameter, WriteMethod
from rosld.server.rest.resource import READ, Answer, Resource
from rosld.server.rest.responses import RawResponse
from rosld.server.rest.state import State
from rosld.server.runtime.process_memory import PROCESS_MEMORY
from rosld.server.sparql import disconnect
from rosld.server.sparql.disconnect import Disconnected
from rosld.server.sparql.math_functions import AGGREGATES
from rosld.server.sparql.protocol import (
    QUERY_MEDIA_TYPE,
    UPDATE_MEDIA_TYPE,
    QueryRequest,
    UpdateRequest,
    posted_request,
    query_request,
)
from rosld.server.sparql.query_limits import describe_limits
from rosld.server.sparql.query_service import QueryAnswer, QueryService
from rosld.server.sparql.result_tables import table_of_results
from rosld.server.sparql.results import GRAPHS, QUADS, SOLUTIONS, XML_REASON, media_types_of, without_xml
from rosld.server.sparql.ros_functions import functions
from rosld.server.sparql.update.base import UpdateRunner

ROWS = 500
"""Maximum number of result rows on a page."""

FORMATS: Mapping[str, str] = {
    "html": HTML,
    "json": "application/sparql-results+json, application/ld+json;q=0.9",
    "xml": "application/sparql-results+xml, application/rdf+xml;q=0.9",
    "csv": "text/csv",
    "tsv": "text/tab-separated-values",
    "ttl": "text/turtle",
    "jsonld": "application/ld+json",
    "nt": "application/n-triples",
    "rdf": "application/rdf+xml",
    "rdfxml": "application/rdf+xml",
    "n3": "text/n3",
    "nq": "application/n-quads",
    "trig": "application/trig",
    **COLUMNS,
}
"""Accept values by `?format=`; results and graphs have different media types for JSON and XML."""
_ALSO: Mapping[str, str] = {"turtle": "ttl", "json-ld": "jsonld", "rdf+xml": "rdf", "rdf xml": "rdf", "ntriples": "nt"}
"""Aliases of formats that some clients send by default (SPARQLWrapper does, with every query)."""
OFFERS = (*SOLUTIONS, *(media_type for media_type in GRAPHS if media_type not in SOLUTIONS), HTML)

GRAPH_FORMS = ("CONSTRUCT", "DESCRIBE")
"""The forms of queries whose results are graphs."""
_PROTOCOL = frozenset({"query", "update", "default-graph-uri", "named-graph-uri"})
"""Query parameters that make a GET a (possibly invalid) query."""


def available_formats(form: str | None) -> Mapping[str, str]:
    """Return the `FORMATS` of results of a query of this form, except pages."""
    offers = (*media_types_of(form), *(() if form in GRAPH_FORMS else COLUMNS.values()))
    return {name: accept for name, accept in FORMATS.items() if choose_offer(accept, offers) is not None}


_OF_GRAPHS = frozenset({"graph", "default", "all"})
"""Parameters of the graph store."""


def accept_of(exchange: Exchange, formats: Collection[str] = FORMATS.keys()) -> str | None:
    """Return the Accept field, or its replacement by `?format=`. Raises a 406 Problem for a format not in `formats`."""
    if exchange.format is None:
        return exchange.accept
    wanted = _ALSO.get(exchange.format, exchange.format)
    if wanted not in formats:
        raise Problem(406, f"?format={wanted} is unknown here; choose from {', '.join(formats)}.")
    return FORMATS[wanted]


def prefers_page(accept: str | None) -> bool:
    """Whether HTML is preferred to all other formats of results."""
    return choose_offer(accept, OFFERS) == HTML


async def answer_query(
    service: QueryService,
    request: QueryRequest,
    accept: str | None,
    disconnected: Disconnected | None = None,
    permissions: Permissions = ALLOW_ALL,
) -> Response:
    """Return the response with the results of a query, in another accepted format if XML cannot represent them."""
    if accept is not None and any(each in accept for each in COLUMNS.values()):
        form = service.check(request.text).form
        chosen = choose_offer(accept, (*media_types_of(QUADS if request.quads else form), *COLUMNS.values()))
        table = next((name for name, media_type in COLUMNS.items() if media_type == chosen), None)
        if table is not None and form not in GRAPH_FORMS and not request.quads:
            return await _table(await service.answer(request, _JSON, disconnected, permissions), table)
    try:
        answer = await service.answer(request, accept, disconnected, permissions)
    except Problem as problem:
        other = without_xml(service.check(request.text).form, accept) if problem.extra == XML_REASON else None
        if other is None:
            raise
        answer = await service.answer(request, other, disconnected, permissions)
    return results_response(answer)


_JSON = "application/sparql-results+json"
_MAX_TABLE = 64 * 1024 * 1024
"""Maximum number of bytes of results in JSON that are made into a table."""
_PER_BYTE = 8
"""Bytes of memory needed per byte of such results, measured with numbers, times and IRIs."""


async def _table(answer: QueryAnswer, format: str) -> Response:
    """Return the response with results as a table. Raises Problems: 406 without pyarrow, 503 for too many results."""
    parts, size = [], 0
    async for part in single_chunk(answer.body) if isinstance(answer.body, bytes) else answer.body:
        parts.append(part)
        size += len(part)
        if size > _MAX_TABLE:
            words = f"The results exceed {_MAX_TABLE >> 20} MiB in JSON, the limit of tables: "
            raise Problem(503, f"{words}request text/csv, which is streamed, or fewer rows.")

    PROCESS_MEMORY.require(size * _PER_BYTE, f"a table of {size} bytes of results")

    def make() -> TableParts:
        table = table_of_results(b"".join(parts))
        return table.schema, (table,)

    return await table_response(format, make, "results", dict(_unread(answer)))


def results_response(answer: QueryAnswer) -> Response:
    """Return the response with the results of a query; a stream is aborted if it cannot be completed.

    The field `Unread-Graphs` of a partial answer lists the documents that could not be read (RFC 9651 3.1).
    """
    fixed_headers = (*_FIXED_HEADERS, *((name.encode(), value.encode("ascii")) for name, value in _unread(answer)))
    if isinstance(answer.body, bytes):
        length = (b"content-length", b"%d" % len(answer.body))
        kind = (b"content-type", answer.content_type.encode("ascii"))
        return RawResponse(200, answer.body, [kind, length, *fixed_headers])
    stream: AsyncIterator[bytes] = answer.body
    headers = {name.decode(): value.decode() for name, value in fixed_headers}
    return StreamingResponse(stream, headers={**headers, "Content-Type": answer.content_type})


def _unread(answer: QueryAnswer) -> Iterable[tuple[str, str]]:
    if answer.unread:
        yield "unread-graphs", ", ".join(f'"{url}"' for url in sorted(answer.unread)[:_MAX_UNREAD])


_FIXED_HEADERS: tuple[tuple[bytes, bytes], ...] = ((b"vary", b"Accept"), (b"cache-control", b"no-cache"))
_MAX_UNREAD = 100
"""Maximum number of documents in the header of a partial answer."""


async def page_results(
    service: QueryService,
    request: QueryRequest,
    disconnected: Disconnected | None = None,
    permissions: Permissions = ALLOW_ALL,
) -> PageResults:
    """Return the first rows of the answer to a query, for a page."""
    table = await service.table(request, ROWS + 1, disconnected, permissions)
    left = "; ".join(f"{url}: {reason}" for url, reason in sorted(table.unread.items())[:_MAX_UNREAD])
    note = f"The answer is partial. Not read: {left}." if left else ""
    return PageResults(table.variables, table.rows, table.boolean, ROWS, note)


_FORMATS: Mapping[str, str] = {
    "application/sparql-results+json": "SPARQL_Results_JSON",
    "application/sparql-results+xml": "SPARQL_Results_XML",
    "text/csv": "SPARQL_Results_CSV",
    "text/tab-separated-values": "SPARQL_Results_TSV",
    "text/turtle": "Turtle",
    "application/ld+json": "JSON-LD",
    "application/n-triples": "N-Triples",
    "application/rdf+xml": "RDF_XML",
    "text/n3": "N3",
    "application/n-quads": "N-Quads",
    "application/trig": "TriG",
}
"""W3C names of formats (https://www.w3.org/ns/formats/)."""


def _formats(media_types: Iterable[str]) -> list[NamedNode]:
    names = sorted({_FORMATS[media_type] for media_type in media_types if media_type in _FORMATS})
    return [NamedNode(f"http://www.w3.org/ns/formats/{name}") for name in names]


def _dataset(service: NamedNode) -> Iterable[Triple]:
    """Return the description of the dataset: a named graph per resource, and their union as the default graph."""
    dataset, default = (NamedNode(f"{service.value}#{name}") for name in ("dataset", "default"))
    return (
        *triples_about(service, (sd.feature, sd.UnionDefaultGraph), (sd.defaultDataset, dataset)),
        *triples_about(dataset, (rdf.type, sd.Dataset), (sd.defaultGraph, default)),
        *triples_about(default, (rdf.type, sd.Graph)),
    )


def _extensions(service: NamedNode) -> Iterable[Triple]:
    for iri in sorted(functions(lambda url: None)):
        yield from triples_about(service, (sd.extensionFunction, NamedNode(iri)))
        yield from triples_about(NamedNode(iri), (rdf.type, sd.Function))
    for iri in sorted(AGGREGATES):
        yield from triples_about(service, (sd.extensionAggregate, NamedNode(iri)))
        yield from triples_about(NamedNode(iri), (rdf.type, sd.Aggregate))


RESULTS = tuple(dict.fromkeys((*SOLUTIONS, *GRAPHS, *COLUMNS.values(), HTML)))
"""The media types of results."""
RESULT_FORMAT = replace(FORMAT, schema={"type": "string", "enum": [*FORMATS]})
PARTIAL = QueryParameter(
    "partial", "Whether to accept a result without the values that cannot be read.", {"type": "boolean"}
)
TIMEOUT = QueryParameter(
    "timeout", "The time limit of the query in seconds.", {"type": "number", "exclusiveMinimum": 0}
)
_GRAPHS: JsonSchema = json_array(URI)
_QUERY = QueryParameter("query", "A query (SPARQL 1.1 Protocol 2.1); without one the endpoint describes itself.")
_OF_BOTH = (
    QueryParameter("default-graph-uri", "The graphs whose union is the default graph.", _GRAPHS),
    QueryParameter("named-graph-uri", "The named graphs.", _GRAPHS),
    RESULT_FORMAT,
)
_OF_CLIENTS = tuple(
    QueryParameter(name, "Ignored: some clients use this name for `format`.") for name in ("output", "results")
)
_OF_UPDATES = (
    QueryParameter("using-graph-uri", "The graphs whose union is the default graph of an update.", _GRAPHS),
    QueryParameter("using-named-graph-uri", "The named graphs of an update.", _GRAPHS),
)
_NO_QUERY = QueryRequest("")
_EXAMPLES = 100
"""Stored queries that the page of the endpoint lists: those that come with rosld first."""


class SparqlResource(SessionResource):
    """The endpoint."""

    kind = "SPARQL"
    shape = "SparqlEndpoint"
    takes_forms = False
    has_own_formats = True
    passes_unknown_parameters = frozenset({"GET", "HEAD"})  # clients send parameters of other endpoints

    path = "sparql"

    def __init__(self, services: Services, pages: PageRenderer, updates: UpdateRunner | None) -> None:
        super().__init__(services)
        self._service = services.sparql
        self._pages = pages
        self._updates = updates
        accepted = (QUERY_MEDIA_TYPE, FORM) if self._updates is None else (QUERY_MEDIA_TYPE, UPDATE_MEDIA_TYPE, FORM)
        self.accepts: Mapping[str, Sequence[str]] = {"POST": accepted}

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        form: JsonSchema = json_object(
            {"query": TEXT}, {"default-graph-uri": _GRAPHS, "named-graph-uri": _GRAPHS, "partial": BOOLEAN}
        )
        update: JsonSchema = json_object(
            {"update": TEXT}, {"using-graph-uri": _GRAPHS, "using-named-graph-uri": _GRAPHS}
        )
        updates = self._updates is not None
        post = WriteMethod(
            sends={"anyOf": [form, update]} if updates else form,
            done=(200, 204) if updates else (200,),
            query=(_QUERY, *_OF_BOTH, *_OF_CLIENTS, TIMEOUT, PARTIAL, *(_OF_UPDATES if updates else ())),
        )
        return PathItem("The SPARQL endpoint", RESULTS, ANYTHING, (_QUERY, *_OF_BOTH, TIMEOUT, PARTIAL), {"POST": post})

    def methods(self) -> frozenset[str]:
        return READ | {"POST"}

    async def state(self) -> State:
        return self.states.get_or_make(self.url, 0, lambda: State(self.document))

    def document(self) -> Document:
        """Return the service description."""
        return Document(self.url, self._description())

    def _description(self) -> tuple[Triple, ...]:
        """Return the SPARQL 1.1 Service Description: languages, formats and limits of queries."""
        service = NamedNode(self.url)
        return (
            *self._languages(service),
            *_dataset(service),
            *describe_limits(service, self._service.limits),
            *triples_about(service, *statements(sd.resultFormat, _formats((*SOLUTIONS, *GRAPHS)))),
            *_extensions(service),
            *triples_about(service, (rdfs.seeAlso, NamedNode(f"{self.space.base}graphs"))),
            *triples_about(service, (ros.hasMirror, self._mirror())),
        )

    def _mirror(self) -> NamedNode | None:
        """Return the URL of the state of replication to another store, or None without one (`--store`)."""
        return NamedNode(f"{self.space.base}mirror") if self.services.settings.store_endpoints else None

    def _languages(self, service: NamedNode) -> Iterable[Triple]:
        languages = [sd.SPARQL11Query] if self._updates is None else [sd.SPARQL11Query, sd.SPARQL11Update]
        inputs = () if self.services.settings.read_only else _formats(RDF_BODIES)
        return triples_about(
            service,
            (rdf.type, sd.Service),
            (rdfs.label, text("SPARQL endpoint")),
            (sd.endpoint, service),
            *statements(sd.supportedLanguage, languages),
            *statements(sd.inputFormat, inputs),
            (sd.defaultEntailmentRegime, NamedNode("http://www.w3.org/ns/entailment/Simple")),
        )

    async def select_variant(self, exchange: Exchange) -> Resource:
        if exchange.method == "POST" and exchange.essence == UPDATE_MEDIA_TYPE and self._updates is None:
            raise self._no_updates()
        return self

    def _no_updates(self) -> Problem:
        if self.services.settings.read_only:
            return Problem(403, "This server is read-only: it accepts queries, but no updates.")
        accepted = ", ".join(self.accepts["POST"])
        return Problem(415, "Only queries are accepted here, not updates.", headers={"Accept-Post": accepted})

    async def custom_get(self, exchange: Exchange) -> Response | None:
        accept = accept_of(exchange)
        if exchange.query.keys().isdisjoint(_PROTOCOL):
            if not exchange.query.keys().isdisjoint(_OF_GRAPHS):
                store = f"{self.space.base}graphs"
                raise Problem(400, f"Read and write graphs at {store}?graph=URL; this endpoint answers queries.")
            return self._page(exchange.permissions) if prefers_page(accept) else None
        request = query_request(exchange.request.scope["query_string"])
        return await self._answer(request, accept, exchange)

    async def post(self, exchange: Exchange) -> Answer:
        """Answer a query or carry out an update (SPARQL 1.1 Protocol 2.1.2, 2.1.3, 2.2)."""
        accept = accept_of(exchange)  # nothing is written if the response could not be given
        body = await exchange.raw_body()
        query_string = exchange.request.scope["query_string"]
        parsed = posted_request(query_string, exchange.header("content-type"), body)
        if isinstance(parsed, QueryRequest):
            exchange.audit.mark_read_only()
            return await self._answer(parsed, accept, exchange)
        return await self._update(parsed, exchange)

    async def _update(self, request: UpdateRequest, exchange: Exchange) -> Response:
        if self._updates is None:
            raise self._no_updates()
        return await self._updates.answer(request, permissions=exchange.permissions)

    async def _answer(self, request: QueryRequest, accept: str | None, exchange: Exchange) -> Response:
        disconnected, permissions = disconnect.disconnection_of(exchange.request.receive), exchange.permissions
        if not prefers_page(accept):
            return await answer_query(self._service, request, accept, disconnected, permissions)
        try:
            results = await page_results(self._service, request, disconnected, permissions)
        except Problem as problem:
            return self._page(permissions, request, problem=problem)
        return self._page(permissions, request, results)

    def _page(
        self,
        permissions: Permissions,
        request: QueryRequest = _NO_QUERY,
        results: PageResults | None = None,
        problem: Problem | None = None,
    ) -> Response:
        notices = () if problem is None else (Notice(problem.detail, NoticeLevel.ERROR),)
        found = self.services.queries.all(limit=_EXAMPLES)
        links = (StoredQueryLink(url, query.name, query.purpose, query.text) for url, query in found)
        examples = tuple(each for each in links if permissions.may_read(each.url))
        page = SparqlPage(self._pages.site_for(permissions), request.text, examples, results, notices, request.partial)
        status, also = (200, {}) if problem is None else (problem.status, problem.headers)
        policy = {"content-security-policy": QUERY_EDITOR_POLICY}
        headers = {**also, **self._pages.headers, **policy, "Vary": "Accept", "Cache-Control": "no-cache"}
        return Response(render_sparql(page), status, headers, "text/html; charset=utf-8")
