"""The SPARQL endpoint `/sparql`: queries by GET and POST, a page for people, a description of itself for machines."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence

from pyoxigraph import Literal, NamedNode, Triple
from starlette.responses import Response, StreamingResponse

from rosld.ontology.document import Document
from rosld.ontology.vocab import rdf, ros, xsd
from rosld.server import html
from rosld.server.html import Notice, Results, SparqlPage, StoredQuery
from rosld.server.html.page import Tone
from rosld.server.http import negotiation
from rosld.server.http.problem import Problem
from rosld.server.ldp.exchange import Exchange
from rosld.server.ldp.pages import Pages
from rosld.server.ldp.prepared import Prepared
from rosld.server.ldp.resource import READ, Answer, Resource
from rosld.server.ldp.state import State
from rosld.server.robot import Robot
from rosld.server.sparql.endpoint import QueryAnswer, QueryService
from rosld.server.sparql.protocol import DIRECT, FORM, QueryRequest, query_request
from rosld.server.sparql.results import GRAPHS, SOLUTIONS

SD = "http://www.w3.org/ns/sparql-service-description#"
HTML = "text/html"
ROWS = 500
"""Rows of a result that a page shows."""

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
}
"""What `?format=` stands for; results and graphs have different names for JSON and XML."""
OFFERS = (*SOLUTIONS, *(media_type for media_type in GRAPHS if media_type not in SOLUTIONS), HTML)


def wished(exchange: Exchange) -> str | None:
    """The Accept field of a request, which `?format=` replaces; a 406 Problem for a format that is unknown."""
    wanted = exchange.query.get("format")
    if not wanted:
        return exchange.accept
    if wanted not in FORMATS:
        raise Problem(406, f"?format={wanted} is unknown; there are {', '.join(FORMATS)}.")
    return FORMATS[wanted]


def prefers_page(accept: str | None) -> bool:
    """Whether HTML is preferred to every machine-readable form of results."""
    return negotiation.choose(accept, OFFERS) == HTML


def told(answer: QueryAnswer) -> Response:
    """The response with the results of a query; streamed ones break off where they cannot be finished."""
    if isinstance(answer.body, bytes):
        length = (b"content-length", b"%d" % len(answer.body))
        kind = (b"content-type", answer.content_type.encode("ascii"))
        return Prepared(200, answer.body, [kind, length, *_STANDING])
    stream: AsyncIterator[bytes] = answer.body
    headers = {name.decode(): value.decode() for name, value in _STANDING}
    return StreamingResponse(stream, headers={**headers, "Content-Type": answer.content_type})


_STANDING = ((b"vary", b"Accept"), (b"cache-control", b"no-cache"))


async def results_of(service: QueryService, request: QueryRequest) -> Results:
    """The first rows of the answer to a query, for a page."""
    table = await service.table(request, ROWS + 1)
    return Results(table.variables, table.rows, table.boolean, ROWS)


class SparqlResource(Resource):
    """The endpoint."""

    kind = "SPARQL"
    takes_forms = False
    accepts: Mapping[str, Sequence[str]] = {"POST": (DIRECT, FORM)}

    def __init__(self, robot: Robot, service: QueryService, pages: Pages, examples: Sequence[StoredQuery]) -> None:
        super().__init__(f"{robot.space.base}sparql")
        self.robot = robot
        self._service = service
        self._pages = pages
        self._examples = tuple(examples)

    def methods(self) -> frozenset[str]:
        return READ | {"POST"}

    async def state(self) -> State:
        return self.robot.states.get(self.url, 0, lambda: State(lambda: Document(self.url, self._description())))

    def _description(self) -> tuple[Triple, ...]:
        """SPARQL 1.1 Service Description: what this endpoint speaks, and how long a query may take."""
        service = NamedNode(self.url)
        formats = {media_type for media_type in (*SOLUTIONS, *GRAPHS) if "/json" not in media_type}
        return (
            Triple(service, rdf.type, NamedNode(f"{SD}Service")),
            Triple(service, NamedNode(f"{SD}endpoint"), service),
            Triple(service, NamedNode(f"{SD}supportedLanguage"), NamedNode(f"{SD}SPARQL11Query")),
            Triple(service, NamedNode(f"{SD}feature"), NamedNode(f"{SD}UnionDefaultGraph")),
            Triple(
                service,
                ros.timeLimit,
                Literal(str(self.robot.settings.query_time_limit), datatype=xsd.double),
            ),
            *(
                Triple(
                    service,
                    NamedNode(f"{SD}resultFormat"),
                    NamedNode(f"https://www.iana.org/assignments/media-types/{each}"),
                )
                for each in sorted(formats)
            ),
        )

    async def special(self, exchange: Exchange) -> Response | None:
        accept = wished(exchange)
        if "query" not in exchange.query:
            return self._page() if prefers_page(accept) else None
        return await self._answer(query_request("GET", exchange.request.scope["query_string"]), accept)

    async def post(self, exchange: Exchange) -> Answer:
        body = await exchange.body()
        query_string = exchange.request.scope["query_string"]
        return await self._answer(
            query_request("POST", query_string, exchange.header("content-type"), body), wished(exchange)
        )

    async def _answer(self, request: QueryRequest, accept: str | None) -> Response:
        if not prefers_page(accept):
            return told(await self._service.answer(request, accept))
        try:
            return self._page(request.text, await results_of(self._service, request))
        except Problem as problem:
            return self._page(request.text, None, problem)

    def _page(self, text: str = "", results: Results | None = None, problem: Problem | None = None) -> Response:
        notices = () if problem is None else (Notice(problem.detail, Tone.ERROR),)
        page = SparqlPage(self._pages.site, text, self._examples, results, notices)
        headers = {**self._pages.headers, "Vary": "Accept", "Cache-Control": "no-cache"}
        status = 200 if problem is None else problem.status
        return Response(html.render_sparql(page), status, headers, "text/html; charset=utf-8")
