"""Stored queries: `/queries/` lists them, `/queries/NAME?param=value` runs one with results in any format.

Queries shipped with rosld are read-only; those of clients are files of SPARQL, stored like `/data/`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from functools import partial
from typing import ClassVar

from msgspec import Struct
from msgspec.structs import replace
from pyoxigraph import NamedNode, Triple
from starlette.responses import Response

from rosld.adapters.base import Watch
from rosld.ontology.document import Document
from rosld.ontology.syntax import Syntax
from rosld.ontology.triples import RDF_SOURCE, labelled, statements, text, triples_about
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import dcterms, ldp, rdfs
from rosld.server.html.page import (
    MemberColumns,
    Notice,
    NoticeLevel,
    PageResults,
    QueryPage,
    StoredQueryLink,
    StoredQueryParameter,
)
from rosld.server.html.render import render_query
from rosld.server.http.body import parse_content_length
from rosld.server.http.conditional import ETag, digest
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.hypermedia.json_schema import ANYTHING, TEXT, JsonSchema, MessageSchemas
from rosld.server.policies.stored_queries import ROUTE, query_triples
from rosld.server.resources.base import Services, SessionResource
from rosld.server.resources.ldp.base import Documents
from rosld.server.resources.ldp.bodies import require_small
from rosld.server.resources.ldp.containers import ContainerResource
from rosld.server.resources.ldp.rdf_sources import DescriptionResource, StoredFile
from rosld.server.resources.ldp.representation import all_members, page_at, state_of
from rosld.server.resources.ldp.routes import AbsentResource, stored_route
from rosld.server.resources.sparql_endpoint import (
    FORMATS,
    GRAPH_FORMS,
    OFFERS,
    PARTIAL,
    RESULT_FORMAT,
    RESULTS,
    TIMEOUT,
    accept_of,
    answer_query,
    available_formats,
    page_results,
    prefers_page,
)
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.pages import PageRenderer
from rosld.server.rest.path_item import FORMAT, PAGE, PathItem, QueryParameter
from rosld.server.rest.resource import READ, Resource
from rosld.server.rest.responses import RawResponse, resource_headers
from rosld.server.rest.state import State
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.sparql import disconnect
from rosld.server.sparql.protocol import QUERY_MEDIA_TYPE, QueryRequest, requested_partial, requested_timeout
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.stored_query import (
    OTHER_SETTINGS,
    ParameterType,
    QueryParameterDeclaration,
    StoredQuery,
    bind_parameters,
)
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS
from rosld.server.storage.record import Put, Record
from rosld.server.storage.record_documents import record_document

_DESCRIPTIONS = frozenset(syntax.media_type for syntax in Syntax)
_ANYTHING = {"iri": "/", "string": "", "integer": "0", "double": "0"}
_TITLE = "Queries"

_LONGEST_SUMMARY = 300
_IRI: JsonSchema = {
    "type": "string",
    "pattern": r"""^(/|[A-Za-z][A-Za-z0-9+.-]*:)([^\x00-\x20\x7f<>"{}|\\^`%\[\]]|%[0-9A-Fa-f]{2})*$""",
}
"""An absolute IRI, or a path below the base."""
_TYPES: Mapping[ParameterType, JsonSchema] = {
    ParameterType.IRI: _IRI,
    ParameterType.STRING: TEXT,
    ParameterType.INTEGER: {"type": "integer"},
    ParameterType.DOUBLE: {"type": "number"},
}


def _query_item(purpose: str, parameters: Iterable[QueryParameterDeclaration]) -> PathItem:
    """Return the path item of a stored query."""
    given = (QueryParameter(one.name, one.about, _TYPES[one.type], one.default is None) for one in parameters)
    return PathItem(
        purpose[:_LONGEST_SUMMARY],
        (*RESULTS, QUERY_MEDIA_TYPE),
        ANYTHING,
        (RESULT_FORMAT, TIMEOUT, PARTIAL, *given),
        streams=False,
    )


class QueryRunner(Struct, frozen=True):
    """Runner of stored queries and renderer of their result pages."""

    service: QueryService
    pages: PageRenderer
    base: str

    async def answer(
        self, exchange: Exchange, resource: Resource, query: StoredQuery, state: str | None = None
    ) -> Response | None:
        """Return the results in the preferred format, or None if the client prefers the query's description.

        `state` is the state part of the ETags of a query that may change; otherwise a digest of the results is used.
        Raises Problems: 400 like `bind_parameters`, 406, and those of the query service.
        """
        given = {name: value for name, value in exchange.query.items() if name not in OTHER_SETTINGS}
        pairs = [(name, value) for name, value in exchange.query.items() if value]
        options = QueryRequest("", timeout=requested_timeout(pairs), partial=requested_partial(pairs))
        if exchange.format in (None, "html") and prefers_page(accept_of(exchange)):
            return await self._page(exchange, resource, query, given, options)
        form = self.service.check(bind_parameters(query, self._samples(query, given), self.base)).form
        is_description = form not in GRAPH_FORMS and not given
        formats = {"html", *available_formats(form), *(available_formats("DESCRIBE") if is_description else ())}
        accept = accept_of(exchange, [name for name in FORMATS if name in formats])
        if is_description and choose_offer(accept, OFFERS) in _DESCRIPTIONS:
            return None
        request = replace(options, text=bind_parameters(query, given, self.base))
        disconnected = disconnect.disconnection_of(exchange.request.receive)
        answer = await answer_query(self.service, request, accept, disconnected, exchange.permissions)
        return self._identify(exchange, resource, answer, state)

    def _identify(self, exchange: Exchange, resource: Resource, answer: Response, state: str | None) -> Response:
        """Return results with the headers of every response about the query, and an entity tag if they are complete."""
        for name, value in resource_headers(resource).items():
            answer.headers[name] = value
        if isinstance(answer, RawResponse):
            found = digest(bytes(answer.body))
            etag = ETag(found, "results") if state is None else ETag(state, f"results-{found}")
            answer.headers["etag"] = str(etag)
            if exchange.check_preconditions(etag):
                headers = {**resource_headers(resource), "etag": str(etag), "vary": "Accept"}
                return Response(status_code=304, headers=headers)
        return answer

    def _samples(self, query: StoredQuery, given: Mapping[str, str]) -> Mapping[str, str]:
        """Return given parameters, and samples for missing ones, to determine the form of the query."""
        lacking = {one.name: _ANYTHING[one.type.value] for one in query.parameters if one.default is None}
        return {**lacking, **given}

    async def _page(
        self,
        exchange: Exchange,
        resource: Resource,
        query: StoredQuery,
        given: Mapping[str, str],
        options: QueryRequest,
    ) -> Response:
        """Return the page, with results if all parameters are given and valid, or with the error."""
        results: PageResults | None = None
        notices: tuple[Notice, ...] = ()
        status, also = 200, dict[str, str]()
        if given or all(one.default is not None for one in query.parameters):
            try:
                request = replace(options, text=bind_parameters(query, given, self.base))
                results = await page_results(
                    self.service, request, disconnect.disconnection_of(exchange.request.receive), exchange.permissions
                )
            except Problem as problem:
                notices, status, also = (Notice(problem.detail, NoticeLevel.ERROR),), problem.status, problem.headers
        page = QueryPage(
            self.pages.site_for(exchange.permissions),
            StoredQueryLink(resource.url, query.name, query.purpose, query.text),
            tuple(
                StoredQueryParameter(one.name, one.about, given.get(one.name, one.default or ""))
                for one in query.parameters
            ),
            results,
            notices,
        )
        fixed_headers = {
            **resource_headers(resource),
            **self.pages.headers,
            "vary": "Accept",
            "cache-control": "no-cache",
        }
        headers = {**also, **fixed_headers}
        return Response(render_query(page), status, headers, "text/html; charset=utf-8")


class ShippedQueryResource(SessionResource):
    """A query shipped with rosld: its results in every format, its RDF description and its text."""

    kind = "Stored query"
    is_cacheable = False

    def __init__(self, services: Services, query: StoredQuery, runner: QueryRunner) -> None:
        super().__init__(services, services.space.query(query.name))
        self.title = query.name
        self._query = query
        self._runner = runner

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        return _query_item(self._query.purpose, self._query.parameters)

    def deny_reason(self, method: str) -> str:
        if self.services.settings.read_only:
            return READ_ONLY
        container = self.space.container("queries")
        return (
            f"{self._query.name} is built into rosld and read-only: PUT a query with another name to {container}NAME."
        )

    async def state(self) -> State:
        return self.states.get_or_make(self.url, 0, self._describe)

    def _describe(self) -> State:
        return State(partial(shipped_document, self.url, self._query), shapes=_shapes(self.space))

    async def custom_get(self, exchange: Exchange) -> Response | None:
        if exchange.preferred({}, (*OFFERS, QUERY_MEDIA_TYPE)) == QUERY_MEDIA_TYPE:
            return Response(self._query.text, media_type=f"{QUERY_MEDIA_TYPE}; charset=utf-8")
        return await self._runner.answer(exchange, self, self._query)


def shipped_document(url: str, query: StoredQuery) -> Document:
    """Return the description of a query shipped with rosld."""
    return Document(url, (*triples_about(NamedNode(url), *RDF_SOURCE), *query_triples(url, query)))


# Queries of clients


class StoredQueryResource(StoredFile):
    """A query of a client: its text, stored byte for byte, and its results in every format."""

    kind = "Stored query"
    writes: ClassVar[frozenset[str]] = frozenset({"PUT", "DELETE"})
    accepts: Mapping[str, Sequence[str]] = {"PUT": (QUERY_MEDIA_TYPE,)}

    def __init__(self, documents: Documents, path: str, runner: QueryRunner) -> None:
        super().__init__(documents, path)
        self._runner = runner

    async def select_variant(self, exchange: Exchange) -> Resource:
        await _require_size(exchange)
        return self

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        query = self.documents.queries.outline(self.require_record())
        return _query_item(query.purpose, query.parameters)

    async def state(self) -> State:
        return _describe(self.documents, self.require_record())

    async def custom_get(self, exchange: Exchange) -> Response | None:
        if exchange.preferred({}, (*OFFERS, QUERY_MEDIA_TYPE)) == QUERY_MEDIA_TYPE:
            return await super().custom_get(exchange)
        record = self.require_record()
        query = await self.documents.queries.executable(record)
        state = f"{self.documents.records.identity}-{record.version}"
        return await self._runner.answer(exchange, self, query, state)


class QueryDescription(DescriptionResource):
    """The description of a query of a client; writes omit the triples derived from the query's text."""

    async def state(self) -> State:
        return _describe(self.documents, self.require_record())

    async def with_triples(
        self, record: Record, triples: Sequence[Triple], expected: int | None, known: Set[Triple] = frozenset()
    ) -> Put:
        require_small(triples)
        own = set(self.documents.queries.description(record))
        return await super().with_triples(record, [one for one in triples if one not in own], expected, known)


class AbsentQueryResource(AbsentResource):
    """A missing query: PUT creates it."""

    def path_item(self, schemas: MessageSchemas) -> PathItem:
        methods = READ if self.documents.settings.read_only else READ | {"PUT", "DELETE"}
        return replace(_query_item("A stored query that can be created", ()), methods=methods)

    async def select_variant(self, exchange: Exchange) -> Resource:
        if exchange.method == "PUT":
            await _require_size(exchange)
        return await super().select_variant(exchange)


class QueryContainer(ContainerResource):
    """`/queries/`: stored queries of clients and those shipped with rosld."""

    item = PathItem("The stored queries", query=(FORMAT, PAGE))

    async def select_variant(self, exchange: Exchange) -> Resource:
        if exchange.method == "POST":
            await _require_size(exchange)
        return await super().select_variant(exchange)

    def is_taken(self, name: str) -> bool:
        return name in self.documents.queries.shipped or super().is_taken(name)

    async def watch(self, wake: Callable[[], None]) -> Watch | None:
        return self.documents.changes.watch(wake, lambda path: path.startswith(ROUTE))

    async def state(self) -> State:
        base = await super().state()
        version = self.documents.queries.version
        return self.documents.states.get_or_make(
            f"{self.url}?{self._place}#{self._parts.variant} with what is shipped",
            (IdentityKey(base), version),
            lambda: replace(
                base, describe=lambda: self._with_shipped(base.document), token=f"{base.tag}-{version}", renderings={}
            ),
        )

    async def with_triples(
        self, record: Record, triples: Sequence[Triple], expected: int | None, known: Set[Triple] = frozenset()
    ) -> Put:
        require_small(triples)
        own = set(self._with_shipped(Document(self.url, ())).triples)
        about_members = {one for one in triples if one.predicate == rdfs.comment and one.subject != NamedNode(self.url)}
        clients = [one for one in triples if one not in own and one not in about_members]
        return await super().with_triples(record, clients, expected, known)

    def listing(self) -> MemberColumns:
        listed = self._shipped() | {url: query.purpose for url, query in self._stored_queries()}
        return MemberColumns(("purpose",), {url: (purpose,) for url, purpose in listed.items()})

    def _with_shipped(self, document: Document) -> Document:
        shown_here = {one.object.value for one in document.triples if one.predicate == ldp.contains}  # type: ignore[union-attr]
        stored = {url: query.purpose for url, query in self._stored_queries() if url in shown_here}
        shipped = self._shipped() if self._parts.containment else {}
        return _list(document, shipped, stored, titled=self._parts.minimal)

    def _shipped(self) -> dict[str, str]:
        """Return the purposes of the queries shipped with rosld, which are on the first page."""
        return _shipped(self.documents) if self._place is None or self._place.after == 0 else {}

    def _stored_queries(self) -> list[tuple[str, StoredQuery]]:
        """Return the stored queries on this page."""
        if self._place is None:
            records = list(self.documents.queries.stored_records())
        else:
            members = page_at(self.documents, self.require_record(), self._place)[1]
            records = [
                one for member in members if (one := self.documents.records.get(member.path)) and one.blob is not None
            ]
        return [(self.space.base + one.path, self.documents.queries.outline(one)) for one in records]


def _shipped(documents: Documents) -> dict[str, str]:
    urls = {documents.space.query(name): query.purpose for name, query in documents.queries.shipped.items()}
    there = {url: documents.records.get(url[len(documents.space.base) :]) is not None for url in urls}
    return {url: purpose for url, purpose in urls.items() if not there[url]}


def _list(document: Document, shipped: Mapping[str, str], stored: Mapping[str, str], *, titled: bool) -> Document:
    """Return the container with its queries' purposes; their classes are in their own graphs only."""
    container = NamedNode(document.url)
    more = triples_about(
        container,
        *labelled(dcterms.title, _TITLE if titled else None),
        *statements(ldp.contains, map(NamedNode, shipped)),
    )
    purposes = {**shipped, **stored}.items()
    said = [
        triple for url, purpose in purposes for triple in triples_about(NamedNode(url), (rdfs.comment, text(purpose)))
    ]
    return Document(document.url, tuple(dict.fromkeys((*document.triples, *more, *said))))


def queries_document(documents: Documents) -> Callable[[], Document]:
    """Return a thread-safe function that returns the document of the current `/queries/` with all members."""
    record = documents.records.get(ROUTE)
    assert record is not None
    url, shipped, stored = (
        documents.space.container("queries"),
        _shipped(documents),
        list(documents.queries.stored_records()),
    )
    members = [documents.space.base + member.path for member in all_members(documents.records, record)]

    def describe() -> Document:
        purposes = {documents.space.base + one.path: documents.queries.outline(one).purpose for one in stored}
        return _list(record_document(record, url, members, ()), shipped, purposes, titled=True)

    return describe


def _describe(documents: Documents, record: Record) -> State:
    """Return the description of a stored query: that of the file, and the triples derived from its text."""
    state = state_of(documents, record)

    def describe() -> Document:
        document = state.document
        return Document(document.url, tuple(dict.fromkeys((*document.triples, *documents.queries.description(record)))))

    def make() -> State:
        return replace(state, describe=describe, shapes=_shapes(documents.space), renderings={})

    url = f"{documents.space.base}{record.path}# with what it says"
    return documents.states.get_or_make(url, IdentityKey(state), make)


def _shapes(space: Space) -> tuple[str, ...]:
    """Return the shapes of a query's description; results have none."""
    return (space.document_shape("Query"),)


async def _require_size(exchange: Exchange) -> None:
    """Raise a 413 Problem if the Content-Length exceeds the limit for queries."""
    limit = 4 * DEFAULT_BOUNDS.size
    if exchange.method in ("PUT", "POST") and (parse_content_length(exchange.header("content-length")) or 0) > limit:
        async for _ in exchange.chunks(limit=limit):
            pass


def query_route(services: Services, runner: QueryRunner, location: Location) -> Resource:
    """Return the resource at `/queries/` or below."""
    documents = services.documents
    found = stored_route(documents, location)
    match found:
        case StoredFile():
            return StoredQueryResource(documents, found.path, runner)
        case DescriptionResource():
            return QueryDescription(documents, found.path + ".meta")
        case ContainerResource() if found.path == ROUTE:
            return QueryContainer(documents, ROUTE)
        case AbsentResource():
            query = services.queries.shipped.get(location.segments[0]) if len(location.segments) == 1 else None
            if query is not None and not location.is_container:
                return ShippedQueryResource(services, query, runner)
            return AbsentQueryResource(documents, found.path)
    return found
