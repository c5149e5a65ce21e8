"""Stored queries: `/queries/` lists them, `/queries/NAME?param=value` runs one in any result format."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TypeAlias

from pyoxigraph import NamedNode
from starlette.responses import Response

from rosld.ontology.describe_containers import container_document
from rosld.ontology.document import Document
from rosld.ontology.triples import RDF_SOURCE, about, text
from rosld.ontology.urls import Location, Space
from rosld.ontology.vocab import dcterms, rdf, ros
from rosld.server import html
from rosld.server.html import Notice, QueryPage, QueryParameter, Results
from rosld.server.html.page import Tone
from rosld.server.http import negotiation
from rosld.server.http.conditional import ETag, guard
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.pages import Pages
from rosld.server.ldp.prepared import Prepared
from rosld.server.ldp.resource import BASIC_CONTAINER, RESOURCE, Resource, moved
from rosld.server.ldp.resource import RDF_SOURCE as SOURCE_LINK
from rosld.server.ldp.standing import standing_headers
from rosld.server.ldp.state import State, digest
from rosld.server.resources.sparql import HTML, OFFERS, results_of, told, wished
from rosld.server.robot import Robot
from rosld.server.sparql.endpoint import QueryService
from rosld.server.sparql.protocol import DIRECT, QueryRequest
from rosld.server.sparql.stored import Parameter, StoredQuery, bind

Queries: TypeAlias = Mapping[str, StoredQuery]
_DESCRIPTIONS = ("text/turtle", "application/ld+json", "application/n-triples", "application/rdf+xml", "text/n3")


class QueryContainer(Resource):
    """`/queries/`."""

    kind = "Queries"
    title = "Queries"
    links = (RESOURCE, SOURCE_LINK, BASIC_CONTAINER)

    def __init__(self, robot: Robot, queries: Queries) -> None:
        super().__init__(robot.space.container("queries"))
        self.robot = robot
        self._queries = queries

    async def state(self) -> State:
        return self.robot.states.get(self.url, 0, lambda: State(partial(container, self._queries, self.robot.space)))


def container(queries: Queries, space: Space) -> Document:
    """The container of the stored queries, each with its purpose."""
    document = container_document(space.container("queries"), map(space.query, queries), "Queries")
    said = [triple for query in queries.values() for triple in describe(query, space).triples]
    return Document(document.url, (*document.triples, *said))


def describe(query: StoredQuery, space: Space) -> Document:
    """A stored query: its purpose, its parameters, its text."""
    url = space.query(query.name)
    triples = about(
        NamedNode(url),
        (rdf.type, ros.Query),
        *RDF_SOURCE,
        (ros.name, text(query.name)),
        (dcterms.description, text(query.purpose)),
        *((ros.queryParameter, text(parameter.name)) for parameter in query.parameters),
        (ros.text, text(query.text)),
    )
    return Document(url, tuple(triples))


class QueryResource(Resource):
    """One stored query. Its results come in every format; its RDF description and its text are there too."""

    kind = "Stored query"

    def __init__(self, robot: Robot, query: StoredQuery, service: QueryService, pages: Pages) -> None:
        super().__init__(robot.space.query(query.name))
        self.title = query.name
        self.robot = robot
        self._query = query
        self._service = service
        self._pages = pages

    async def state(self) -> State:
        return self.robot.states.get(self.url, 0, lambda: State(partial(describe, self._query, self.robot.space)))

    async def special(self, exchange: Exchange) -> Response | None:
        accept = wished(exchange)
        given = {name: value for name, value in exchange.query.items() if name != "format"}
        chosen = negotiation.choose(accept, (*OFFERS, DIRECT))
        if chosen == DIRECT:
            return Response(self._query.text, media_type=f"{DIRECT}; charset=utf-8")
        if chosen == HTML:
            return await self._page(given)
        sample = bind(self._query, self._samples(given), self.robot.space.base)
        is_graph = self._service.check(sample).form in _GRAPH_FORMS
        if chosen in _DESCRIPTIONS and not is_graph and not given:
            return None
        return self._identified(exchange, told(await self._service.answer(self._request(given), accept)))

    def _identified(self, exchange: Exchange, answer: Response) -> Response:
        """Results with what every answer about the query says, and an entity tag where they are there at once."""
        for name, value in standing_headers(self).items():
            answer.headers[name] = value
        if isinstance(answer, Prepared):
            etag = ETag(digest(bytes(answer.body)), "results")
            answer.headers["etag"] = str(etag)
            if_match, if_none_match = exchange.header("if-match"), exchange.header("if-none-match")
            if guard(exchange.method, etag, if_match=if_match, if_none_match=if_none_match):
                headers = {**standing_headers(self), "etag": str(etag), "vary": "Accept"}
                return Response(status_code=304, headers=headers)
        return answer

    def _samples(self, given: Mapping[str, str]) -> Mapping[str, str]:
        """What is given, and for what must be given and is not, anything: to see which form the query has."""
        lacking = {one.name: _ANYTHING[one.type.value] for one in self._query.parameters if one.default is None}
        return {**lacking, **given}

    def _request(self, given: Mapping[str, str]) -> QueryRequest:
        return QueryRequest(bind(self._query, given, self.robot.space.base))

    async def _page(self, given: Mapping[str, str]) -> Response:
        """The page: with results where all parameters are there, with the reason where they are not."""
        results: Results | None = None
        notices: tuple[Notice, ...] = ()
        status = 200
        if given or all(one.default is not None for one in self._query.parameters):
            try:
                results = await results_of(self._service, self._request(given))
            except Problem as problem:
                notices, status = (Notice(problem.detail, Tone.ERROR),), problem.status
        query = self._query
        page = QueryPage(
            self._pages.site,
            html.StoredQuery(self.url, query.name, query.purpose, query.text),
            tuple(
                QueryParameter(one.name, one.about, given.get(one.name, one.default or "")) for one in query.parameters
            ),
            results,
            notices,
        )
        headers = {**self._pages.headers, "Vary": "Accept", "Cache-Control": "no-cache"}
        return Response(html.render_query(page), status, headers, "text/html; charset=utf-8")


def _parameter(one: Parameter, given: Mapping[str, str]) -> QueryParameter:
    return QueryParameter(one.name, one.about, given.get(one.name, one.default or ""))


_ANYTHING = {"iri": "/", "string": "", "integer": "0", "double": "0"}
_GRAPH_FORMS = ("CONSTRUCT", "DESCRIBE")


def query_room(robot: Robot, location: Location, *, queries: Queries, service: QueryService, pages: Pages) -> Resource:
    """`/queries/` and below."""
    match location.segments:
        case ():
            url = robot.space.container("queries")
            if not location.is_container:
                raise moved(url)
            return QueryContainer(robot, queries)
        case (name,) if name in queries and not location.is_container:
            return QueryResource(robot, queries[name], service, pages)
    raise Problem(404, f"There is no stored query there; {robot.space.container('queries')} lists them.")
