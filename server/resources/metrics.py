"""Metrics: `/metrics` for Prometheus, in its text format or OpenMetrics. Values are read when they are scraped."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import ModuleType

from msgspec import Struct
from starlette.responses import Response

from rosld.server.auth.rate_limit import ClientLimiter
from rosld.server.events.broadcaster import Broadcasters
from rosld.server.http.fields import Link
from rosld.server.http.negotiation import choose_offer
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.json_schema import OBJECT
from rosld.server.resources.base import Services, SessionResource
from rosld.server.rest.exchange import Exchange
from rosld.server.rest.path_item import PathItem
from rosld.server.rest.resource import LDP, RESOURCE
from rosld.server.rest.responses import resource_headers
from rosld.server.runtime.timings import RequestTimings
from rosld.server.runtime.watchdog import Watchdog
from rosld.server.sparql.process.client import QueryProcess

MEDIA_TYPES = ("text/plain", "application/openmetrics-text")


class MetricSources(Struct):
    """The parts of one server whose metrics are read. `connections` returns the number of open ones."""

    services: Services
    process: QueryProcess
    requests: RequestTimings
    watchdog: Watchdog
    clients: ClientLimiter
    broadcasters: Broadcasters
    connections: Callable[[], int] = int


class MetricsResource(SessionResource):
    """The metrics of a server; topics, holds and faults that the agent may not read are not counted."""

    kind = "Metrics"
    item = PathItem("Metrics of the server and the robot, for Prometheus", MEDIA_TYPES, OBJECT, (), streams=False)
    links = (RESOURCE, Link(f"{LDP}NonRDFSource", "type"))

    path = "metrics"

    def __init__(self, sources: MetricSources) -> None:
        super().__init__(sources.services)
        self._sources = sources

    async def custom_get(self, exchange: Exchange) -> Response | None:
        if choose_offer(exchange.accept, MEDIA_TYPES) is None:
            raise Problem(406, f"None of {exchange.accept!r} is available; accept {MEDIA_TYPES[0]}.")
        families = await asyncio.to_thread(_import_families)
        found = families.collect(self._sources, exchange.permissions)
        body, media_type = await asyncio.to_thread(families.render, found, exchange.accept or "")
        headers = {**resource_headers(self), "vary": "Accept", "cache-control": "no-store"}
        return Response(body, headers={**headers, "content-type": media_type})


def _import_families() -> ModuleType:
    """Return the module that needs prometheus_client, whose import takes 70 ms; most servers are never scraped."""
    from rosld.server.resources import metric_families

    return metric_families
