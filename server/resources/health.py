"""Health: `/healthz` and `/readyz` for probes, without authentication. They reveal states, and never why."""

from __future__ import annotations

from collections.abc import Callable

import orjson
from starlette.responses import Response

from rosld.adapters.model import Live
from rosld.ontology.urls import Space
from rosld.server.http.fields import Link
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.http.problem_details import JSON as PROBLEM
from rosld.server.http.problem_details import render
from rosld.server.hypermedia.json_schema import JsonSchema, json_object
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import LDP, RESOURCE, Resource
from rosld.server.rest.responses import resource_headers
from rosld.server.robot.session import Session

TEXT, JSON = "text/plain", "application/json"
_HEADERS = {"cache-control": "no-store", "vary": "Accept", "x-content-type-options": "nosniff"}
_RETRY = {"Retry-After": "1"}


def _item(summary: str, plain: JsonSchema) -> PathItem:
    return PathItem(summary, (TEXT, JSON), plain, (), streams=False)


class HealthResource(Resource):
    """Whether the process and its event loop answer."""

    kind = "Health"
    item = _item("Whether the server answers", json_object(optional={"status": {"const": "ok"}}))
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    def __init__(self, space: Space, name: str = "healthz") -> None:
        super().__init__(space, space.base + name)

    async def custom_get(self, exchange: Exchange) -> Response | None:
        return self.answer(exchange.accept)

    def answer(self, accept: str | None) -> Response:
        """Return the response to a GET."""
        return self._response(accept, "ok", {"status": "ok"})

    def _response(self, accept: str | None, words: str, members: dict[str, str]) -> Response:
        headers = {**resource_headers(self), **_HEADERS}
        if choose_offer(accept, (TEXT, JSON)) == JSON:
            return Response(orjson.dumps(members), headers=headers, media_type=JSON)
        return Response(f"{words}\n", headers=headers, media_type=TEXT)


class ReadinessResource(HealthResource):
    """Whether the robot is connected and the query process runs; otherwise 503."""

    kind = "Readiness"
    item = _item(
        "Whether the robot is connected and queries are answered; 503 if not",
        json_object(
            optional={
                "status": {"const": "ready"},
                "robot": {"enum": ["live", "stale"]},
                "queries": {"enum": ["up", "down"]},
            }
        ),
    )

    def __init__(self, session: Session, has_queries: Callable[[], bool]) -> None:
        super().__init__(session.space, "readyz")
        self._session = session
        self._has_queries = has_queries

    def answer(self, accept: str | None) -> Response:
        robot = "live" if isinstance(self._session.graph.state, Live) else "stale"
        queries = "up" if self._has_queries() else "down"
        parts = {"robot": robot, "queries": queries}
        if (robot, queries) == ("live", "up"):
            return self._response(accept, "ready", {"status": "ready", **parts})
        words = f"robot {robot}, queries {queries}"
        if choose_offer(accept, (PROBLEM, JSON, TEXT)) == TEXT:
            return Response(f"not ready: {words}\n", 503, {**_HEADERS, **_RETRY}, TEXT)
        return render(Problem(503, f"Not ready: {words}.", headers=_RETRY, extra=parts)).response()
