"""Services of one robot, composed once from the adapter and the settings, and the base class of its resources."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import ClassVar

from rosld.adapters.base import Adapter
from rosld.adapters.model import RosError
from rosld.ontology.describe_graph import ServerProblems
from rosld.ontology.urls import Space
from rosld.server.history.history import History
from rosld.server.history.recordings import Recordings
from rosld.server.html.page import PageResults
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.brief_value import LatestValues
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.hypermedia.property_reader import PropertyReader
from rosld.server.pictures.picture_cache import PictureCache
from rosld.server.policies import active_limits, stored_cockpits, stored_queries
from rosld.server.policies.active_limits import ActiveLimits, initial_limits
from rosld.server.policies.stored_mappings import ROUTE, initial_mappings, load_stored_mappings
from rosld.server.receipts.journal import Journal
from rosld.server.resources.ldp.base import (
    CockpitValidator,
    Documents,
    LimitsValidator,
    MappingValidator,
    QueryValidator,
    Validator,
)
from rosld.server.resources.limit_checks import LimitChecks
from rosld.server.resources.things import ThingDescriptions
from rosld.server.rest.resource import READ, Find, Resource
from rosld.server.rest.state import State
from rosld.server.robot.diagnostic_states import LevelTimes
from rosld.server.robot.fault_follower import FaultFollower
from rosld.server.robot.faults import Faults
from rosld.server.robot.hold_store import Holds
from rosld.server.robot.session import Session
from rosld.server.robot.software_stop import SoftwareStop, StopCommand
from rosld.server.runtime.offload import WorkerPool
from rosld.server.runtime.tasks import Signal
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings
from rosld.server.sparql.query_service import QueryService
from rosld.server.storage.record import RecordChange
from rosld.server.storage.sqlite import Records, open_records

_ROUTES = (ROUTE, stored_queries.ROUTE, active_limits.ROUTE, stored_cockpits.ROUTE)
"""Containers of stored documents that affect the server."""


class Services:
    """All services of one robot, which its resources share."""

    find: Find
    """Finds the resource at a path below the base; set by the router."""
    sparql: QueryService
    """Queries, which read resources; set by the application."""

    def __init__(self, adapter: Adapter, settings: Settings, software_stop: SoftwareStop | None = None) -> None:
        self.session = Session(adapter, settings)
        self.instance_id = secrets.token_hex(4)
        """Identifier of this run of the server."""
        session, space = self.session, self.session.space
        states: VersionCache[State] = VersionCache()
        self.active_limits = ActiveLimits(tuple(initial_limits(settings, adapter, space)), space)
        records = open_records(settings.data, roots=_ROUTES, versions=settings.versions)
        self.receipts = Journal(
            settings.data,
            limit=settings.receipts_kept,
            age=settings.receipts_age,
            excerpt_bytes=settings.receipt_excerpt,
        )
        self.queries = stored_queries.StoredQueries(records, space)
        self.mappings = Mappings(initial_mappings(settings, adapter, space))
        self.property_reader = PropertyReader(session)
        self.affordances: AffordanceService[State] = AffordanceService(
            session, self.mappings, self.property_reader, states, lambda: self.active_limits.current
        )
        self.documents = Documents(
            space,
            settings,
            records,
            self.queries,
            Signal(),
            states,
            WorkerPool(),
            self._validators(records, states),
            self.affordances.mapping_warnings,
        )
        self.holds = Holds(session)
        self._fault_follower = FaultFollower(session, subscribes=settings.faults == "all")
        self.recordings = Recordings(adapter, settings, session.schemas.get, session.schemas.definition_of)
        self.software_stop = software_stop or SoftwareStop(
            session, self.holds, lambda: self.mappings.mapping_set.stop_commands(), self._is_at_rest
        )
        self.pictures = PictureCache(self.instance_id)

    @property
    def space(self) -> Space:
        """URLs of the robot."""
        return self.session.space

    @property
    def settings(self) -> Settings:
        """Settings of the server."""
        return self.session.settings

    @property
    def history(self) -> History:
        """The continuous recording of topics."""
        return self.recordings.history

    @cached_property
    def limit_checks(self) -> LimitChecks:
        """Checks of writes against the limits in force."""
        return LimitChecks(self.session, self.affordances, self.active_limits)

    @cached_property
    def things(self) -> ThingDescriptions:
        """Generator of Thing Descriptions."""
        return ThingDescriptions(self.session, self.affordances, self.software_stop, self.instance_id)

    @cached_property
    def level_times(self) -> LevelTimes:
        """Times since when parts have reported their levels."""
        return LevelTimes()

    @cached_property
    def query_tables(self) -> VersionCache[PageResults]:
        """Results of the queries in cockpits."""
        return VersionCache(64)

    @cached_property
    def latest_values(self) -> LatestValues:
        """Short forms of the latest values of topics."""
        return LatestValues(self.session.topics, self.session.schemas)

    @property
    def states(self) -> VersionCache[State]:
        """Cache of the states of resources."""
        return self.documents.states

    @property
    def faults(self) -> Faults:
        """The faults of the robot."""
        return self._fault_follower.faults

    def _validators(self, records: Records, states: VersionCache[State]) -> Mapping[str, Validator]:
        """Return the validators of documents by route, which also activate documents."""
        space, announce = self.session.space, self.session.changes.emit
        validators: Sequence[Validator] = (
            MappingValidator(self.mappings, space, announce),
            QueryValidator(self.queries, records, space, announce),
            LimitsValidator(self.active_limits, states, space, announce),
            CockpitValidator(space),
        )
        return {each.route: each for each in validators}

    async def _is_at_rest(self, command: StopCommand) -> bool:
        """Whether the target of a mapping's stop command currently reports that it is at rest."""
        conditions = self.mappings.mapping_set.at_rest_when(command)
        if not conditions:
            return False
        tree = await self.affordances.tree()
        try:
            readings = await self.affordances.read(tree.properties_in(conditions), refresh=True)
        except RosError:
            return False
        return self.affordances.snapshot(tree, readings).results.hold(conditions)

    def problems(self) -> ServerProblems:
        """Return the problems of this server: of its storage, and interrupted holds."""
        found = (self.documents.records.failure, self.receipts.failure, self.recordings.history.problem)
        storage = tuple(problem for problem in found if problem is not None)
        return ServerProblems(storage, tuple(map(self.session.space.hold, self.holds.interrupted)))

    async def start(self) -> None:
        """Open the session, and activate stored documents. Raises exceptions of `Adapter.open`."""
        await self.session.open()
        self.documents.records.watch(self._on_record_changes)
        self.receipts.start()
        await self.recordings.start()
        self.session.changes.watch(self.recordings.live.feed.refresh)
        self.session.topics.recorded = self.recordings.live.feed.topics
        self.active_limits.load_stored(self.documents.records)
        await load_stored_mappings(self.mappings, self.documents.records, self.session.settings, self.session.space)
        self.session.follow()
        self._fault_follower.start()
        self.software_stop.start()

    async def stop(self) -> None:
        """Release everything on the robot. Idempotent."""
        self.holds.close("rosld ended")
        self.pictures.close()
        await self.documents.workers.close()
        await self.holds.wait_closed()
        await self.software_stop.wait_ended()
        await self.receipts.close()
        await self.property_reader.stop()
        await self.recordings.stop()
        await self._fault_follower.stop()
        await self.session.close()
        await self.documents.records.close()

    def _on_record_changes(self, changes: Sequence[RecordChange]) -> None:
        for each in changes:
            self.queries.on_record_change(each)
            self.documents.changes.emit(each.path)


class SessionResource(Resource):
    """Base class of resources of one robot."""

    path = ""
    """Path below the base, if the class has only one resource."""
    writes: ClassVar[frozenset[str]] = frozenset()
    """Methods in addition to those that read, unless the server is read-only."""

    def __init__(self, services: Services, url: str | None = None) -> None:
        super().__init__(services.space, services.space.base + self.path if url is None else url)
        self.services = services
        self.session = services.session
        self.states = services.states

    def methods(self) -> frozenset[str]:
        return READ if self.services.settings.read_only else READ | self.writes
