"""SPARQL updates: evaluated over the dataset, planned graph by graph, authorized as a whole, then carried out."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Hashable, Iterator, Sequence, Set
from functools import partial
from typing import NamedTuple

from starlette.responses import Response

from rosld.adapters.model import RosError
from rosld.ontology.body import BodyError
from rosld.ontology.violations import LoweringError
from rosld.server.auth.errors import forbidden
from rosld.server.auth.permissions import ALLOW_ALL, Permissions
from rosld.server.dataset.base import TripleChanges
from rosld.server.http.problem import READ_ONLY, Problem
from rosld.server.receipts.audit import record_step
from rosld.server.resources.base import Services
from rosld.server.resources.complex_resource import ComplexResource
from rosld.server.resources.ldp.base import StoredResource, conflict_problem, write_together
from rosld.server.resources.property_action import MemberResource
from rosld.server.resources.sparql_update.report import (
    Outcome,
    RefusedGraphs,
    ReportEntry,
    failed_outcome,
    partial_failure,
    reason,
    report_response,
)
from rosld.server.resources.sparql_update.sources import load_documents, read_graphs
from rosld.server.rest.resource import READ, Plan, Resource, RobotWrite, StorageWrite
from rosld.server.runtime.dry_run import DryRunEnded
from rosld.server.runtime.tasks import KeyedLock
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.syntax.lexer import QueryBounds
from rosld.server.sparql.update.evaluate import (
    GraphChange,
    TooManySteps,
    has_where,
    matched_graphs,
    named_graphs,
)
from rosld.server.sparql.update.executor import Delta, UpdateEvaluator
from rosld.server.sparql.update.operations import GraphGroup, GraphVerb, ManageGraph, Operation
from rosld.server.sparql.update.parser import read_update
from rosld.server.storage.record import Conflict, ConflictCause, Model, Write


def require_rights(operations: Sequence[Operation], permissions: Permissions) -> None:
    """Check permissions before reading any graph, so that errors reveal no data. Raises 401 and 403 Problems.

    A WHERE reads the whole dataset, so it requires permission to read everything.
    """
    if permissions.is_unrestricted:
        return
    sources = [each.source for each in operations if isinstance(each, ManageGraph) and isinstance(each.source, str)]
    for graph in sorted(named_graphs(operations)):
        if graph in sources and not permissions.may_read(graph):
            raise forbidden(permissions.agent, f"read <{graph[:200]}>")
        if not (permissions.may("PUT", graph) or graph in sources):
            raise forbidden(permissions.agent, f"change <{graph[:200]}>")
    if permissions.may_read_all:
        return
    if has_where(operations):
        raise forbidden(
            permissions.agent,
            "send an update with a WHERE, which requires permission to read everything: name the triples",
        )


def require_change(permissions: Permissions, graph: str, resource: Resource) -> None:
    """Check permission to change a graph and everything that changes with it. Raises 401 and 403 Problems."""
    place = permissions.locate(graph)
    if permissions.is_unrestricted or place is None:
        return
    may = permissions.may("PUT", graph) and all(permissions.may("PUT", url) for url in resource.also_changes)
    if not may or (resource.changes_subtree and not permissions.may_subtree("PUT", place)):
        raise forbidden(permissions.agent, f"change <{graph[:200]}>")


def without_silent_failures(
    operations: Sequence[Operation], require: Callable[[Operation], None]
) -> Sequence[Operation]:
    """Return the operations without refused SILENT ones; raise the Problem of any other refused operation."""
    found = []
    for operation in operations:
        try:
            require(operation)
        except Problem:
            if not operation.silent:
                raise
        else:
            found.append(operation)
    return found


def without_silent_on(operations: Sequence[Operation], graphs: Set[str]) -> Sequence[Operation]:
    """Return the operations without SILENT ones that name any of these refused graphs."""
    return [each for each in operations if not (each.silent and graphs & named_graphs([each]))]


ATTEMPTS = 4
"""Maximum number of evaluations of an update whose data changes before it is carried out."""
_LIVE = ("topics", "parameters", "resources")
"""Routes whose graphs contain live values of the robot."""
_PATIENCE = 1.0
"""Seconds that an update waits for other updates of the same graphs."""
_CHANGED = frozenset({ConflictCause.CHANGED, ConflictCause.THERE, ConflictCause.MISSING})
"""Causes of conflicts that require evaluating the update again."""
_INLINE = 16 * 1024
"""Maximum length in characters of an update that is parsed on the loop."""


class _WholeGraphNeeded(Exception):
    """Raised when planning needs the whole content of a graph, and only the change is known."""


class Target(NamedTuple):
    """A graph that an update changes, and the resource whose graph it is."""

    change: GraphChange
    resource: Resource


class PlannedGraph(NamedTuple):
    """The plan for one graph."""

    graph: str
    plan: Plan


class UpdateService:
    """Executor of updates, for use on one loop."""

    def __init__(self, services: Services, analyser: Analyser, keyed_lock: KeyedLock) -> None:
        session = self._session = services.session
        self._affordances = services.affordances
        self._documents = services.documents
        self._evaluator = UpdateEvaluator(services.sparql, analyser)
        self._default = session.space.base + session.settings.default_document
        bounds = QueryBounds(size=session.settings.body_limit)
        self._read_operations = partial(
            read_update, prefixes=analyser.prefixes, base=analyser.base, bounds=bounds, default=self._default
        )
        self._at = services.find
        self._keyed_lock = keyed_lock
        self._update_lock = KeyedLock(_PATIENCE)

    async def answer(self, request: UpdateRequest, *, permissions: Permissions = ALLOW_ALL) -> Response:
        """Carry out an update and return the response. Raises Problems.

        If any graph is refused, nothing is done: 403 if it is not writable, 422 if its new content is invalid, 409 on a
        conflict, 503 if the robot is unreachable. The Problem of an update that fails part-way lists for each graph
        whether its write was done, was not done, or has an unknown outcome.
        """
        if self._session.settings.read_only:
            raise Problem(403, READ_ONLY)
        return await self.carry_out(await self._read(request), permissions=permissions)

    async def carry_out(self, operations: Sequence[Operation], *, permissions: Permissions = ALLOW_ALL) -> Response:
        """Carry out operations like `answer`. Raises Problems."""
        if self._session.settings.read_only:
            raise Problem(403, READ_ONLY)
        operations = self._without_groups(operations, permissions)
        operations = without_silent_failures(operations, lambda each: require_rights([each], permissions))
        operations = without_silent_failures(operations, self._require_manageable)
        settings = self._session.settings
        operations = await load_documents(
            operations, frozenset(settings.allow_load), seconds=settings.query_time_limit, limit=settings.body_limit
        )
        while True:
            try:
                with contextlib.suppress(TooManySteps):
                    if (graphs := self._graphs_needed(operations)) is not None:
                        return await self._evaluate_and_write(operations, permissions, graphs)
                async with self._serialize_updates(operations):
                    return await self._evaluate_and_write(operations, permissions, None)
            except RefusedGraphs as refusal:
                left = without_silent_on(operations, refusal.graphs)
                if len(left) == len(operations):
                    raise
                operations = left

    @contextlib.asynccontextmanager
    async def _serialize_updates(self, operations: Sequence[Operation]) -> AsyncIterator[None]:
        """Run updates that name the same graphs one at a time, so that they do not invalidate each other's evaluation.

        Only an optimization: after `_PATIENCE` seconds an update proceeds without the lock.
        """
        async with contextlib.AsyncExitStack() as held:
            with contextlib.suppress(Problem):
                await held.enter_async_context(self._update_lock.acquire(*named_graphs(operations)))
            yield

    def _graphs_needed(self, operations: Sequence[Operation]) -> frozenset[str] | None:
        """Return the names of all graphs that operations read and write; None if a query worker must evaluate a WHERE.

        A worker costs some milliseconds, but it sees the values of all graphs at one moment.
        """
        matched, changed = matched_graphs(operations), named_graphs(operations)
        if matched is None:
            return None
        for graph in matched:
            resource = self._resource_of(graph)
            if isinstance(resource, StoredResource):
                is_whole = not graph.endswith("/")  # the state of a container may lack members
            else:
                is_whole = resource is not None and graph in changed and self._kind(graph) in _LIVE
            if not is_whole:
                return None
        return matched | changed

    async def _evaluate_and_write(
        self, operations: Sequence[Operation], permissions: Permissions, graphs: frozenset[str] | None
    ) -> Response:
        """Carry out operations that need only these graphs, None for any. Raises TooManySteps with graphs."""
        more: frozenset[str] = frozenset()
        documents: str | None = f"{self._session.space.base}data/"
        locked: frozenset[str] = graphs or frozenset()
        for _ in range(ATTEMPTS):
            # From the second attempt on, a worker evaluates a WHERE under the locks of the graphs that it changes.
            async with self._keyed_lock.acquire(*locked):
                if graphs is not None:
                    delta = await self._evaluate_here(operations, graphs, by_change=documents is not None)
                else:
                    delta = await self._evaluator.evaluate(operations, more, documents)
                    unseen = self._unseen(delta)
                    if unseen - more:
                        more |= unseen
                        delta = await self._evaluator.evaluate(operations, more, documents)
                try:
                    done = await self._write_if_current(delta, permissions, locked)
                except _WholeGraphNeeded:
                    documents = None
                    continue
            if done is not None:
                return done
            locked |= {change.graph for change in delta.changes}
        raise Problem(
            409,
            f"The data of this update changed {ATTEMPTS} times while it was planned; nothing was done.",
            headers={"Retry-After": "1"},
        )

    async def _evaluate_here(
        self, operations: Sequence[Operation], graphs: frozenset[str], *, by_change: bool
    ) -> Delta:
        """Return the changes that operations make to the current graphs, which are all that they need."""
        stored, read = self._documents.records.version, await read_graphs(graphs, self._resource_of)
        changes = await read.changes(operations, by_change=by_change)
        return Delta(changes, read.tokens, stored, graphs, read.resources)

    async def _read(self, request: UpdateRequest) -> Sequence[Operation]:
        if len(request.text) <= _INLINE:
            return self._read_operations(request)
        return await asyncio.to_thread(self._read_operations, request)

    # Kinds of graphs

    def _kind(self, graph: str) -> str | None:
        """Return the route of a graph, or None for a graph outside this server."""
        location = self._session.space.location(graph)
        return None if location is None else location.kind

    def _unseen(self, delta: Delta) -> frozenset[str]:
        """Return the changed graphs with live values that the evaluation did not read."""
        changed = (change.graph for change in delta.changes)
        return frozenset(graph for graph in changed if graph not in delta.tokens and self._kind(graph) in _LIVE)

    def _require_manageable(self, operation: Operation) -> None:
        """Raise a 403 Problem if an operation on whole graphs names a graph that is not stored."""
        if not isinstance(operation, ManageGraph):
            return
        moved = [operation.source] if operation.verb is GraphVerb.MOVE else []
        for graph in (operation.target, *moved):
            if isinstance(graph, str) and not isinstance(self._resource_of(graph), StoredResource):
                words = f"{operation.verb.value} applies only to stored graphs, but <{graph}> is the robot's."
                raise Problem(403, f"{words} Nothing was done.", extra={"graph": graph})

    def _without_groups(self, operations: Sequence[Operation], permissions: Permissions) -> Sequence[Operation]:
        """Return the operations with NAMED and ALL expanded to the documents that the agent may write."""
        found: list[Operation] = []
        for operation in operations:
            if not isinstance(operation, ManageGraph) or not isinstance(operation.target, GraphGroup):
                found.append(operation)
                continue
            made = filter(self.is_stored, named_graphs(found))
            graphs = dict.fromkeys(graph for graph in (*self._stored_documents(), *made) if not graph.endswith("/"))
            if operation.target is GraphGroup.NAMED:
                graphs.pop(self._default, None)
            writable = [graph for graph in graphs if permissions.may("PUT", graph)]
            left = f"{len(graphs) - len(writable)} documents that the agent may not write, "
            record_step(
                f"{operation.verb.value} {operation.target.value}: {len(writable)} documents; unchanged are "
                f"{left if len(writable) < len(graphs) else ''}containers, files, policies and the robot's graphs"
            )
            found += (ManageGraph(operation.verb, graph, silent=True) for graph in writable)
        return found

    def _stored_documents(self) -> Iterator[str]:
        """Yield the graphs of all documents below `/data/`: no containers, no files, no policies."""
        records, after = self._documents.records, 0
        while changes := records.changes_since(after):
            for change in changes:
                record = records.get(change.path)
                if record is not None and record.model is Model.RDF_SOURCE and change.path.startswith("data/"):
                    yield self._session.space.base + change.path
            after = changes[-1].version

    def is_stored(self, graph: str) -> bool:
        """Whether the graph of this name is, or could be, a stored one."""
        return isinstance(self._resource_of(graph), StoredResource)

    def _resource_of(self, graph: str) -> Resource | None:
        """Return the resource of a graph, or None if this server has no resource at that URL."""
        base = self._session.space.base
        if not graph.startswith(base) or "?" in graph or "#" in graph:
            return None
        try:
            resource = self._at("/" + graph[len(base) :])
        except (Problem, ValueError):
            return None
        return resource if resource.url == graph else None

    def _resource(self, graph: str) -> Resource:
        found = self._resource_of(graph)
        if found is None:
            base = self._session.space.base
            raise Problem(403, f"This graph cannot be written here; use graphs below {base}data/.")
        return found

    # Planning and writing

    async def _write_if_current(
        self, delta: Delta, permissions: Permissions, locked: frozenset[str]
    ) -> Response | None:
        """Write the changes and return the response, or None if the data has changed since the evaluation.

        The caller holds the locks of the graphs `locked`.
        """
        targets = await self._targets(delta, permissions)
        async with self._lock_targets(targets, locked):
            if not await self._is_current(delta, targets):
                return None
            plans = await self._plans(targets, permissions)
            if not await self._is_current(delta, targets):
                return None
            return await self._carry_out(plans, permissions)

    async def _targets(self, delta: Delta, permissions: Permissions) -> Sequence[Target]:
        """Return the targets of the changes. Raises RefusedGraphs if any graph is not writable at all."""
        found, reasons = [], []
        for change in delta.changes:
            try:
                resource = delta.resources.get(change.graph)
                if resource is None:
                    resource = self._resource(change.graph)
                    await resource.prepare()
                require_change(permissions, change.graph, resource)
                if resource.methods() <= READ:
                    raise resource.not_allowed("PATCH" if {*resource.accepts} == {"PATCH"} else "PUT", 403)
                found.append(Target(change, resource))
            except (Problem, RosError) as error:
                reasons.append((change.graph, reason(error, permissions, change.graph)))
        if reasons:
            raise RefusedGraphs(reasons)
        return found

    @contextlib.asynccontextmanager
    async def _lock_targets(self, targets: Sequence[Target], locked: Set[str]) -> AsyncIterator[None]:
        """Lock everything that the plans for these targets depend on, except the graphs `locked`."""
        urls = {target.resource.url for target in targets} - locked
        async with self._keyed_lock.acquire(*urls) if urls else contextlib.nullcontext():
            members = [each.resource for each in targets if isinstance(each.resource, MemberResource | ComplexResource)]
            if not members:
                yield
                return
            tree = await self._affordances.tree()
            names = [name for each in members for name in each.affected_names(tree)]
            async with self._affordances.lock(tree, *names, modified=names):
                yield

    async def _is_current(self, delta: Delta, targets: Sequence[Target]) -> bool:
        """Whether the data of the update is unchanged since its evaluation."""
        for target in targets:
            if isinstance(target.resource, StoredResource):
                record = self._documents.records.get(target.resource.path)
                if record is not None and max(record.version, record.listed) > delta.stored:
                    return False
                if (record is not None) != target.change.was_there:
                    return False
        meant = delta.named | {change.graph for change in delta.changes}
        # Some live value changes all the time, so only the graphs that the update names or changes count.
        tokens = [each for each in delta.tokens.items() if each[0] in meant]
        return all([await self._has_token(graph, token, delta.resources.get(graph)) for graph, token in tokens])

    async def _has_token(self, graph: str, token: Hashable, resource: Resource | None) -> bool:
        try:
            return (await (resource or self._resource(graph)).state()).tag == token
        except (Problem, RosError):
            return False

    async def _plans(self, targets: Sequence[Target], permissions: Permissions) -> Sequence[PlannedGraph]:
        """Return a plan for each graph. Raises RefusedGraphs if any is refused."""
        found, reasons = [], []
        for change, resource in targets:
            try:
                found.append(PlannedGraph(change.graph, await self._plan(change, resource)))
            except (Problem, LoweringError, BodyError, RosError) as error:
                reasons.append((change.graph, reason(error, permissions, change.graph)))
        if reasons:
            raise RefusedGraphs(reasons)
        return found

    async def _plan(self, change: GraphChange, resource: Resource) -> Plan:
        await resource.prepare()
        if not isinstance(change.after, TripleChanges):
            return await resource.plan_graph_write(change.after)
        plan = await resource.plan_graph_change(change.after)
        if plan is None:
            raise _WholeGraphNeeded
        return plan

    async def _carry_out(self, plans: Sequence[PlannedGraph], permissions: Permissions) -> Response | None:
        """Carry out the plans: stored graphs in one transaction, then writes to the robot one by one.

        Returns None if a stored graph has changed since the evaluation.
        """
        stored = [(graph, plan) for graph, plan in plans if isinstance(plan, StorageWrite)]
        moves = [(graph, plan) for graph, plan in plans if isinstance(plan, RobotWrite)]
        if moves:
            self._session.interlock.require_open()
        if stored:
            writes: dict[str, Write] = {}
            for graph, plan in stored:
                for write in plan.writes:  # an explicit write of a container precedes an implicit one
                    if write.path not in writes or graph == self._session.space.base + write.path:
                        writes[write.path] = write
            try:
                with contextlib.suppress(DryRunEnded):
                    await write_together(self._documents, tuple(writes.values()))
            except Conflict as error:
                if error.cause in _CHANGED:
                    return None
                graph, problem = self._session.space.base + error.path, conflict_problem(self._session.space, error)
                raise RefusedGraphs([(graph, reason(problem, permissions, graph))]) from error
        entries = [ReportEntry(graph, plan.description, Outcome.DONE) for graph, plan in stored]
        for graph, move in moves:
            record_step(move.description, graph)
        for place, (graph, move) in enumerate(moves):
            try:
                is_received = await move.carry_out()
            except DryRunEnded:
                continue
            except (RosError, Problem) as error:
                fate, problem = failed_outcome(error), reason(error, permissions, graph)
                left = [ReportEntry(name, plan.description, Outcome.LEFT) for name, plan in moves[place + 1 :]]
                raise partial_failure([*entries, ReportEntry(graph, move.description, fate, problem), *left]) from error
            entries.append(ReportEntry(graph, move.description, Outcome.DONE if is_received else Outcome.UNHEARD))
        return report_response(entries)
