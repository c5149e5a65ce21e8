"""The context of resources: the session with the robot, and the state of one run of the server."""

from __future__ import annotations

import gc
import secrets
from collections.abc import Hashable, Mapping, Sequence
from functools import cached_property

from rosld.adapters.base import Adapter, Recording
from rosld.adapters.model import RosError
from rosld.server.history.history import NAME as HISTORY
from rosld.server.history.history import History
from rosld.server.history.recordings import Recordings
from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.latest_values import LatestValues
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.hypermedia.property_reader import PropertyReader
from rosld.server.pictures.picture_cache import PictureCache
from rosld.server.policies import active_limits, stored_mappings, stored_queries
from rosld.server.policies.active_limits import ActiveLimits, initial_limits
from rosld.server.policies.stored_mappings import initial_mappings, load_stored_mappings
from rosld.server.receipts.journal import Journal
from rosld.server.rest.state import State
from rosld.server.robot.diagnostic_states import LevelTimes
from rosld.server.robot.hold_store import Holds
from rosld.server.robot.session import Session
from rosld.server.robot.software_stop import SoftwareStop, StopCommand
from rosld.server.runtime.offload import WorkerPool
from rosld.server.runtime.signals import Signal
from rosld.server.runtime.version_cache import VersionCache
from rosld.server.settings import Settings
from rosld.server.sparql.syntax.lexer import QueryBounds
from rosld.server.storage import RecordChange
from rosld.server.storage.sqlite import open_records
from rosld.shapes.limits import Limits


class Robot(Session):
    """The session with a robot, what is in force for it, what is kept beside it, and what is known of its resources."""

    def __init__(self, adapter: Adapter, settings: Settings) -> None:
        super().__init__(adapter, settings)
        self.instance_id = secrets.token_hex(4)
        self.states: VersionCache[State] = VersionCache()
        self.workers = WorkerPool()
        self.active_limits = ActiveLimits(tuple(initial_limits(settings, adapter, self.space)), self.space)
        self.records = open_records(
            settings.data,
            roots=(stored_mappings.ROUTE, stored_queries.ROUTE, active_limits.ROUTE),
            versions=settings.versions,
        )
        self.receipts = Journal(
            settings.data,
            limit=settings.receipts_kept,
            age=settings.receipts_age,
            excerpt_bytes=settings.receipt_excerpt,
        )
        self.record_changes = Signal()
        self.queries = stored_queries.StoredQueries(
            self.records, self.space, QueryBounds(size=settings.query_size_limit)
        )
        self.mappings = Mappings(initial_mappings(settings, adapter, self.space))
        self.property_reader = PropertyReader(
            adapter,
            self.topics,
            self.goals,
            self.schemas,
            self.space,
            freshness=settings.freshness,
            patience=settings.call_deadline,
        )
        self.affordances: AffordanceService[State] = AffordanceService(
            self, self.mappings, self.property_reader, self.states, lambda: self.limits
        )
        self.holds = Holds(self)
        self.bags = Recordings(adapter, settings, self.schemas.get, self.schemas.definition_of)
        self.software_stop = SoftwareStop(
            self, self.holds, lambda: self.mappings.mapping_set.stop_commands(), self._is_at_rest
        )

    @cached_property
    def latest_values(self) -> LatestValues:
        """The newest value of each topic in brief, as far as it is at hand."""
        return LatestValues(self.topics, self.schemas)

    @cached_property
    def level_times(self) -> LevelTimes:
        """Since when the parts that tell of themselves are at their levels."""
        return LevelTimes()

    @cached_property
    def pictures(self) -> PictureCache:
        """The pictures that somebody looks at."""
        return PictureCache()

    @property
    def revision(self) -> Hashable:
        """Another one whenever anything has changed but values and what clients keep."""
        return (
            IdentityKey(self.adapter.graph),
            self.schemas.count,
            self.calls.revision,
            self.goals.revision,
            self.holds.revision,
            self.software_stop.revision,
            self.history.digests.revision,
            self.queries.version,
            self.bags.revision,
            IdentityKey(self.active_limits.current),
            IdentityKey(self.mappings.mapping_set),
            IdentityKey(self.affordances.last_tree),
        )

    async def _is_at_rest(self, command: StopCommand) -> bool:
        """Whether what a mapping's stop is about says, read now, that it is at rest."""
        conditions = self.mappings.mapping_set.at_rest_when(command)
        if not conditions:
            return False
        tree = await self.affordances.tree()
        try:
            readings = await self.affordances.read(tree.properties_in(conditions), refresh=True)
        except RosError:
            return False
        return self.affordances.snapshot(tree, readings).results.hold(conditions)

    @property
    def history(self) -> History:
        """What is recorded all the time."""
        return self.bags.history

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """The recordings that can be read, by name: the history, those of clients, those of the source."""
        own = {HISTORY: self.history.recording} if self.history.is_kept else {}
        return {**own, **self.bags.finished, **self.adapter.recordings}

    @property
    def storage_problems(self) -> tuple[str, ...]:
        """Why not everything can be stored just now, in sentences; none where it can."""
        found = (self.records.failure, self.receipts.failure, self.history.problem)
        return tuple(problem for problem in found if problem is not None)

    @property
    def limits(self) -> Limits:
        """The limits on what is written that are in force now."""
        return self.active_limits.current

    async def start(self) -> None:
        """Open the session, and put into force what is kept. Raises what `Adapter.open` raises."""
        await self.open()
        self.records.watch(self._kept)
        self.receipts.start()
        await self.bags.start()
        self.changes.watch(self.bags.refresh)
        self.active_limits.load_stored(self.records)
        await load_stored_mappings(self.mappings, self.records, self.settings, self.space)
        gc.collect()
        gc.freeze()  # what is loaded now stays: looking through it again and again would hold everybody up
        self.follow()

    async def stop(self) -> None:
        """Give everything back to the robot; idempotent."""
        self.holds.close("rosld ended")
        self.pictures.close()
        await self.workers.close()
        await self.holds.wait_closed()
        await self.software_stop.wait_ended()
        await self.receipts.close()
        await self.property_reader.stop()
        await self.bags.stop()
        await self.close()
        await self.records.close()

    def _kept(self, changes: Sequence[RecordChange]) -> None:
        for each in changes:
            self.queries.on_record_change(each)
            self.record_changes.emit(each.path)


class IdentityKey:
    """Compares by identity: a version that costs nothing to compare."""

    __slots__ = ("value",)

    def __init__(self, value: object) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, IdentityKey) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)
