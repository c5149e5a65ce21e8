"""Follower of faults: of diagnostics, errors in the log, goals, calls, nodes and topics."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import time
from collections.abc import Iterable, Mapping
from typing import Any, cast

from msgspec import Struct

from rosld.adapters.model import GoalStatus, Graph, Kind, Message, Ref, RosError, Sample, Stale
from rosld.ontology.describe_faults import FaultKey, FaultKind, Severity
from rosld.ontology.neutral_message import COMMANDS
from rosld.server.history.topic_feed import TopicFeed
from rosld.server.http.problem import one_line
from rosld.server.robot.calls import CallState
from rosld.server.robot.diagnostic_states import DIAGNOSTIC_ARRAY, Level, read_states
from rosld.server.robot.faults import Faults, pattern_of
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import RESERVED
from rosld.server.runtime.tasks import end_tasks, loop_time

PERIOD = 0.5
"""Seconds between looks."""
LOG_QUIET_SECONDS = 60.0
"""Seconds without a repetition after which an error in the log is healed."""
GONE_SECONDS = 2.0
"""Seconds after which a node that left the graph has vanished: shorter absences are restarts."""
STEADY_SECONDS = 20.0
"""Seconds for which a topic must have had messages at its rate, so that its silence is a fault."""
SILENT_SECONDS, SILENT_PERIODS = 5.0, 10
"""A topic is silent after both: seconds, and periods of its rate."""
MAX_PATTERNS = 20
"""Maximum number of different errors in the log of one node; all others are one fault."""
MAX_PARTS = 300
"""Maximum number of lasting faults of one topic of diagnostics; all others are left to /diagnostics."""
_PASSING = re.compile(r"/_|_\d{9,}$|/launch_ros_\d+$|/transform_listener_impl_\w+$")
"""Names of nodes that come and go: hidden ones, anonymous ones, and helpers of other nodes."""
_MAX_NODES = 10_000
_DEPTH = 128
_LOGS: Mapping[str, Mapping[int, Severity]] = {
    "rosgraph_msgs/msg/Log": {8: Severity.ERROR, 16: Severity.FATAL},
    "rcl_interfaces/msg/Log": {40: Severity.ERROR, 50: Severity.FATAL},
}
"""Severities by the levels of a type of log messages."""
_LOG_TOPICS = ("/rosout_agg", "/rosout")
"""Topics of the log, the best first: for the former of ROS 1, one node has collected the messages of all others."""
_LEVELS = {Level.WARN: Severity.WARNING, Level.STALE: Severity.WARNING, Level.ERROR: Severity.ERROR}
_FAILED_CALLS = frozenset({CallState.FAILED, CallState.REFUSED, CallState.UNKNOWN, CallState.NOT_SENT})
_FAILED_GOALS = frozenset({GoalStatus.ABORTED, GoalStatus.LOST})
_ROBOT = FaultKey(FaultKind.ROBOT, None)

_log = logging.getLogger("rosld")


class FaultFollower:
    """Follower of all faults of one robot. It subscribes to diagnostics and the log only if it `subscribes`."""

    def __init__(self, session: Session, *, subscribes: bool) -> None:
        self.faults = faults = Faults()
        self._reports = _Reports(session, faults) if subscribes else None
        live = () if session.adapter.recordings else (_Nodes(session, faults), _Rhythms(session, faults))
        self._watchers: tuple[_Watcher, ...] = (_Outcomes(session, faults), *live)
        self._session = session
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Start following; requires a running loop."""
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def stop(self) -> None:
        """Stop following. Idempotent."""
        if self._task is not None:
            await end_tasks([self._task])
        if self._reports is not None:
            self._reports.close()

    async def _run(self) -> None:
        while True:
            try:
                graph = self._session.graph
                if self._reports is not None:
                    await self._reports.look(graph)
                for each in self._watchers:
                    each.look(graph)
                self._heal_quiet()
            except Exception:
                _log.exception("faults could not be followed; the next look tries again")
            await asyncio.sleep(PERIOD)

    def _heal_quiet(self) -> None:
        horizon = loop_time() - LOG_QUIET_SECONDS
        for fault in self.faults.lasting():
            if fault.key.kind is FaultKind.LOG and fault.heard_at < horizon:
                self.faults.heal(fault.key, fault.last_ns)


class _Watcher:
    """Base of the watchers, which look at everything after each period."""

    def __init__(self, session: Session, faults: Faults) -> None:
        self._session = session
        self._faults = faults

    def look(self, graph: Graph) -> None:
        """Report what has changed."""
        raise NotImplementedError

    def _lasting(self, kind: FaultKind) -> Iterable[tuple[FaultKey, str, int]]:
        """Return the keys of the lasting faults of a kind, with the names of their sources and their last times."""
        of_kind = [(each.key, each.last_ns) for each in self._faults.lasting() if each.key.kind is kind]
        return [(key, key.source.name, last_ns) for key, last_ns in of_kind if key.source is not None]


class _Reports:
    """The topics of diagnostics and of the log, each with its queue."""

    def __init__(self, session: Session, faults: Faults) -> None:
        self._session = session
        self._faults = faults
        self._feeds: dict[str, TopicFeed] = {}
        self._graph: Graph | None = None

    async def look(self, graph: Graph) -> None:
        """Follow these topics of the graph, and report what they say."""
        if graph is not self._graph:
            self._graph = graph
            await self._follow(_reporting_topics(graph))
        for topic, feed in self._feeds.items():
            for sample in feed.take():
                with contextlib.suppress(RosError, ValueError):  # undecodable: the topic itself shows why
                    await self._read(graph, topic, sample)

    async def _follow(self, wanted: frozenset[str]) -> None:
        for topic in self._feeds.keys() - wanted:
            self._feeds.pop(topic).subscription.close()
        for topic in wanted - self._feeds.keys():
            try:
                subscription = await self._session.adapter.subscribe(topic, depth=_DEPTH)
            except RosError:
                self._graph = None  # the next look tries again
                continue
            self._feeds[topic] = TopicFeed(topic, subscription, _DEPTH)

    def close(self) -> None:
        """Close all subscriptions."""
        for feed in self._feeds.values():
            feed.subscription.close()

    async def _read(self, graph: Graph, topic: str, sample: Sample) -> None:
        schema = await self._session.schemas.message(sample.schema)
        message = schema.codec.decode(sample.data, sample.encoding)
        if sample.schema.name == DIAGNOSTIC_ARRAY:
            self._read_diagnostics(topic, message, sample.received_ns)
        elif sample.schema.name in _LOGS:
            self._read_log(graph, topic, message, _LOGS[sample.schema.name], sample.received_ns)

    def _read_diagnostics(self, topic: str, message: Message, received_ns: int) -> None:
        source = Ref(Kind.TOPIC, topic)
        known = self._known(FaultKind.DIAGNOSTIC, source)
        for state in read_states(topic, message, {}, received_ns):
            key = FaultKey(FaultKind.DIAGNOSTIC, source, one_line(state.name), topic)
            if state.level is Level.OK:
                self._faults.heal(key, received_ns)
            elif key in known or len(known) < MAX_PARTS:
                known.add(key)
                self._faults.reached(key, _LEVELS[state.level], state.message, received_ns)

    def _known(self, kind: FaultKind, source: Ref) -> set[FaultKey]:
        """Return the keys of the lasting faults of a source."""
        keys = (fault.key for fault in self._faults.lasting())
        return {key for key in keys if key.kind is kind and key.source == source}

    def _read_log(
        self, graph: Graph, topic: str, message: Message, levels: Mapping[int, Severity], received_ns: int
    ) -> None:
        line = cast(Any, message)
        severity = levels.get(int(line.level))
        if severity is None:
            return
        node, words = _node_of_logger(str(line.name), graph), one_line(line.msg)
        source = Ref(Kind.TOPIC, topic) if node is None else Ref(Kind.NODE, node)
        part = pattern_of(words) if node is not None else pattern_of(f"{one_line(line.name)}: {words}")
        key = FaultKey(FaultKind.LOG, source, part, topic)
        known = self._known(FaultKind.LOG, source)
        if len(known) >= MAX_PATTERNS and key not in known:
            key = FaultKey(FaultKind.LOG, source, "other errors", topic)
        self._faults.occurred(key, severity, words, received_ns)


def _reporting_topics(graph: Graph) -> frozenset[str]:
    """Return the published topics of diagnostics and of the log.

    Aggregated diagnostics repeat the others, so they count only on their own.
    """
    published = {
        name: frozenset(ref.name for ref in topic.types)
        for name, topic in graph.topics.items()
        if topic.publishers or not topic.subscribers
    }
    states = {name for name, types in published.items() if DIAGNOSTIC_ARRAY in types}
    direct = {name for name in states if not name.endswith("_agg")}
    log = next((name for name in _LOG_TOPICS if published.get(name, frozenset()) & _LOGS.keys()), None)
    return frozenset((direct or states) | ({log} if log is not None else set()))


def _node_of_logger(logger: str, graph: Graph) -> str | None:
    """Return the node of a logger, which in ROS 2 has dots (`arm.driver.bus` of `/arm/driver`); None if unknown."""
    name = logger if logger.startswith("/") else "/" + logger.replace(".", "/")
    while name:
        if name in graph.nodes:
            return name
        name = name.rpartition("/")[0]
    return None


class _Outcomes(_Watcher):
    """Goals and calls that failed, or succeeded again."""

    def __init__(self, session: Session, faults: Faults) -> None:
        super().__init__(session, faults)
        self._revisions = (0, 0)
        self._known: dict[tuple[str, str], CallState | GoalStatus] = {}

    def look(self, graph: Graph) -> None:
        calls, goals = self._session.calls, self._session.goals
        revisions = calls.revision, goals.revision
        if revisions == self._revisions:
            return
        self._revisions = revisions
        known = dict[tuple[str, str], CallState | GoalStatus]()
        for call in calls.all():
            known["calls", call.id] = call.state
            key = FaultKey(FaultKind.CALL, Ref(Kind.SERVICE, call.service))
            time_ns, words = call.answered_ns or call.created_ns, call.words or f"the call {call.state.value}"
            self._note(("calls", call.id), key, call.state, _FAILED_CALLS, CallState.SUCCEEDED, words, time_ns)
        for goal in goals.all():
            known["goals", goal.id] = goal.status
            key = FaultKey(FaultKind.GOAL, Ref(Kind.ACTION, goal.action))
            time_ns, words = goal.ended_ns or goal.updated_ns, goal.words or f"the goal was {goal.status.value}"
            self._note(("goals", goal.id), key, goal.status, _FAILED_GOALS, GoalStatus.SUCCEEDED, words, time_ns)
        self._known = known

    def _note(
        self,
        path: tuple[str, str],
        key: FaultKey,
        state: CallState | GoalStatus,
        failed: frozenset[CallState] | frozenset[GoalStatus],
        succeeded: CallState | GoalStatus,
        words: str,
        time_ns: int,
    ) -> None:
        before = self._known.get(path)
        if state is before:
            return
        if state is succeeded:
            self._faults.heal(key, time_ns)
        elif state in failed and before not in failed:
            self._faults.occurred(key, Severity.ERROR, words, time_ns, path)


class _Nodes(_Watcher):
    """Nodes that vanished or came back, and whether the robot can be reached at all.

    After a restart of the master, whose nodes do not register again, only its new nodes count.
    """

    def __init__(self, session: Session, faults: Faults) -> None:
        super().__init__(session, faults)
        self._graph: Graph | None = None
        self._known: dict[str, None] = {}
        self._missing: dict[str, float] = {}

    def look(self, graph: Graph) -> None:
        if isinstance(graph.state, Stale):
            self._faults.reached(_ROBOT, Severity.ERROR, f"cannot be reached: {graph.state.why}", graph.state.since_ns)
            return
        if graph is not self._graph:
            self._learn(graph)
        now = loop_time()
        gone = [name for name, since in self._missing.items() if now - since >= GONE_SECONDS]
        if len(gone) > 1 and len(gone) == len(self._known):
            self._faults.reached(_ROBOT, Severity.ERROR, f"all {len(gone)} nodes vanished", time.time_ns())
            return
        self._faults.heal(_ROBOT)
        for name in gone:
            node = graph.nodes.get(name)
            words = "the node vanished" if node is None else f"the node vanished: {node.unreachable}"
            self._faults.reached(FaultKey(FaultKind.NODE, Ref(Kind.NODE, name)), Severity.ERROR, words, time.time_ns())
        for key, name, _ in self._lasting(FaultKind.NODE):
            if name in self._known and name not in self._missing:
                self._faults.heal(key)

    def _learn(self, graph: Graph) -> None:
        """Note which nodes of a new graph are known, and which are missing since when."""
        if self._graph is not None and graph.master != self._graph.master:
            self._known.clear()
        self._graph = graph
        present = {name for name, node in graph.nodes.items() if node.unreachable is None and name != graph.own_node}
        self._known.update((name, None) for name in sorted(present) if not _PASSING.search(name))
        while len(self._known) > _MAX_NODES:
            self._known.pop(next(iter(self._known)))
        now = loop_time()
        self._missing = {name: self._missing.get(name, now) for name in self._known if name not in present}


class _Rhythm(Struct):
    """The messages of a topic: the newest one, when it was noticed, and since when they came without a long pause."""

    newest_ns: int
    heard_at: float
    steady_since: float


class _Rhythms(_Watcher):
    """Topics that are subscribed to for other reasons, and fell silent or speak again."""

    def __init__(self, session: Session, faults: Faults) -> None:
        super().__init__(session, faults)
        self._rhythms: dict[str, _Rhythm] = {}

    def look(self, graph: Graph) -> None:
        before, self._rhythms = self._rhythms, {}
        if isinstance(graph.state, Stale):
            return
        for name in self._session.topics.subscribed():
            view = self._session.topics.peek(name)
            newest = None if view is None else view.newest
            if view is not None and newest is not None and newest.publisher != graph.own_node:
                self._rhythms[name] = self._judge(graph, name, before.get(name), newest.received_ns, view.rate)
        for key, name, last_ns in self._lasting(FaultKind.TOPIC):
            if name in self._rhythms and self._rhythms[name].newest_ns > last_ns:
                self._faults.heal(key, self._rhythms[name].newest_ns)

    def _judge(self, graph: Graph, name: str, rhythm: _Rhythm | None, newest_ns: int, rate: float | None) -> _Rhythm:
        """Return the rhythm of a topic now, and report it if it was steady and is silent."""
        now = loop_time()
        if rhythm is None:
            return _Rhythm(newest_ns, now, now)
        silence = max(SILENT_SECONDS, SILENT_PERIODS / rate) if rate else float("inf")
        is_silent = now - rhythm.heard_at > silence
        if newest_ns != rhythm.newest_ns:
            return _Rhythm(newest_ns, now, now if is_silent else rhythm.steady_since)
        if is_silent and rhythm.heard_at - rhythm.steady_since >= STEADY_SECONDS and _is_steady(graph, name):
            key = FaultKey(FaultKind.TOPIC, Ref(Kind.TOPIC, name))
            words = f"no message, after {rate:.3g} per second"
            self._faults.reached(key, Severity.WARNING, words, newest_ns)
        return rhythm


def _is_steady(graph: Graph, name: str) -> bool:
    """Whether a topic is published all the time: those of goals and commands, and of vanished nodes, are not."""
    topic = graph.topics[name]
    return (
        name not in RESERVED
        and not graph.is_of_action(name)
        and not any(ref.name in COMMANDS for ref in topic.types)
        and any(each.unreachable is None for each in topic.publishers)
    )
