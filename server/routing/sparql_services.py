"""The SPARQL services of a run of the server, composed once."""

from __future__ import annotations

from collections.abc import Callable

from rosld.server.resources.ldp.record_graphs import RecordGraphs
from rosld.server.resources.past_messages import RecordedPast
from rosld.server.resources.sparql_update.service import UpdateService
from rosld.server.rest.resource import Resource
from rosld.server.routing.live_graphs import OTHER_ROUTES, RobotGraphs
from rosld.server.routing.router import ResourceFactory
from rosld.server.routing.services import Services
from rosld.server.runtime.tasks import KeyedLock
from rosld.server.runtime.version_cache import IdentityKey
from rosld.server.settings import Settings
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.query_limits import Limits
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.receipt_graphs import ReceiptGraphs
from rosld.server.sparql.restricted import RestrictedDatasets
from rosld.server.sparql.syntax.lexer import QueryBounds, ServiceAllowlist
from rosld.server.sparql.update.executor import UpdateEvaluator


class SparqlServices:
    """Queries and updates over the states of the robot's resources, in a separate process."""

    def __init__(self, services: Services, factory: ResourceFactory) -> None:
        session, space, settings = services.session, services.session.space, services.session.settings
        self._services = services
        self.process = QueryProcess(settings.query_concurrency, settings.query_queue)
        self.graphs = RobotGraphs(factory)
        """Source of the dataset."""
        record_graphs = RecordGraphs(services.documents.records, space.base, services.queries.description, OTHER_ROUTES)
        self.materializer = Materializer(
            self.process, self.graphs, record_graphs, ReceiptGraphs(services.receipts, space)
        )
        self._analyser = Analyser(space.base, space.types, reach=ServiceAllowlist(frozenset(settings.allow_service)))
        self.queries = QueryService(
            self.process,
            self.materializer,
            self._analyser,
            session.message_ages,
            _limits(settings),
            RestrictedDatasets(self.process, lambda: IdentityKey(session.graph)),
            RecordedPast(session, services.recordings),
        )

    def updates(self, at: Callable[[str], Resource], keyed_lock: KeyedLock) -> UpdateService:
        """Return the runner of updates on the resources that `at` finds by path below the base."""
        services = self._services
        return UpdateService(
            services.session,
            services.affordances,
            services.documents,
            UpdateEvaluator(self.queries, self._analyser),
            self._analyser,
            QueryBounds(size=services.session.settings.body_limit),
            at,
            keyed_lock,
        )


def _limits(settings: Settings) -> Limits:
    return Limits(
        settings.query_time_limit,
        settings.query_memory_limit,
        settings.query_row_limit,
        settings.query_concurrency,
        settings.query_queue,
    )
