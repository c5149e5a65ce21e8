"""Follower of faults: of diagnostics, errors in the log, goals, calls, nodes and topics."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import time
from collections.abc import Mapping
from typing import Any, cast

from msgspec import Struct, field

from rosld.adapters.model import GoalStatus, Graph, Kind, Message, Ref, RosError, Stale
from rosld.ontology.describe_faults import FaultKey, FaultKind, Severity
from rosld.ontology.neutral_message import COMMANDS
from rosld.server.history.topic_feed import TopicFeed
from rosld.server.http.problem import one_line
from rosld.server.robot.calls import CallState
from rosld.server.robot.diagnostic_states import DIAGNOSTIC_ARRAY, Level, read_states
from rosld.server.robot.faults import Faults, pattern_of
from rosld.server.robot.session import Session
from rosld.server.robot.write_policy import RESERVED
from rosld.server.runtime.tasks import Background, loop_time

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
_FAILED: frozenset[CallState | GoalStatus | None] = frozenset(
    {CallState.FAILED, CallState.REFUSED, CallState.UNKNOWN, CallState.NOT_SENT, GoalStatus.ABORTED, GoalStatus.LOST}
)
_ROBOT = FaultKey(FaultKind.ROBOT, None)

_log = logging.getLogger("rosld")


class FaultFollower(Background):
    """Follower of all faults of one robot. It subscribes to diagnostics and the log only if it `subscribes`."""

    def __init__(self, session: Session, *, subscribes: bool) -> None:
        self.faults = faults = Faults()
        self._session = session
        self._reports = _Reports(session, faults) if subscribes else None
        live = () if session.adapter.capabilities.system == "recording" else (_Nodes(faults), _Rhythms(session, faults))
        self._watchers: tuple[_Outcomes | _Nodes | _Rhythms, ...] = (_Outcomes(session, faults), *live)

    async def stop(self) -> None:
        """Stop following. Idempotent."""
        await super().stop()
        if self._reports is not None:
            await self._reports.follow(frozenset())

    async def _run(self) -> None:
        while True:
            try:
                graph = self._session.graph
                if self._reports is not None:
                    await self._reports.look(graph)
                for each in self._watchers:
                    each.look(graph)
                horizon = loop_time() - LOG_QUIET_SECONDS
                for fault in self.faults.lasting(FaultKind.LOG):
                    if fault.heard_at < horizon:
                        self.faults.heal(fault.key, fault.last_ns)
            except Exception:
                _log.exception("faults could not be followed; retrying")
            await asyncio.sleep(PERIOD)


class _Reports(Struct):
    """The topics of diagnostics and of the log, each with its queue."""

    session: Session
    faults: Faults
    feeds: dict[str, TopicFeed] = field(default_factory=dict)
    graph: Graph | None = None

    async def look(self, graph: Graph) -> None:
        """Follow these topics of the graph, and report what they say."""
        if graph is not self.graph:
            self.graph = graph
            await self.follow(_reporting_topics(graph))
        for topic, feed in self.feeds.items():
            for sample in feed.take():
                with contextlib.suppress(RosError, ValueError):  # undecodable: the topic itself shows why
                    schema = await self.session.schemas.message(sample.schema)
                    message = cast(Any, schema.codec.decode(sample.data, sample.encoding))
                    if schema.ref.name == DIAGNOSTIC_ARRAY:
                        self._read_diagnostics(topic, message, sample.received_ns)
                    elif levels := _LOGS.get(schema.ref.name):
                        self._read_log(graph, topic, message, levels, sample.received_ns)

    async def follow(self, topics: frozenset[str]) -> None:
        """Subscribe to these topics, and unsubscribe from all others."""
        for topic in self.feeds.keys() - topics:
            self.feeds.pop(topic).subscription.close()
        for topic in topics - self.feeds.keys():
            try:
                subscription = await self.session.adapter.subscribe(topic, depth=_DEPTH)
                self.feeds[topic] = TopicFeed(topic, subscription, _DEPTH)
            except RosError:
                self.graph = None  # the next look tries again

    def _read_diagnostics(self, topic: str, message: Message, received_ns: int) -> None:
        source = Ref(Kind.TOPIC, topic)
        known = {fault.key for fault in self.faults.lasting(FaultKind.DIAGNOSTIC, source)}
        for state in read_states(topic, message, {}, received_ns):
            key = FaultKey(FaultKind.DIAGNOSTIC, source, one_line(state.name), topic)
            if state.level is Level.OK:
                self.faults.heal(key, received_ns)
            elif key in known or len(known) < MAX_PARTS:
                known.add(key)
                self.faults.report(key, _LEVELS[state.level], state.message, received_ns)

    def _read_log(self, graph: Graph, topic: str, line: Any, levels: Mapping[int, Severity], received_ns: int) -> None:
        severity = levels.get(line.level[0] if isinstance(line.level, bytes) else line.level)
        if severity is None:
            return
        node, words = _node_of_logger(str(line.name), graph), one_line(line.msg)
        source = Ref(Kind.TOPIC, topic) if node is None else Ref(Kind.NODE, node)
        part = pattern_of(words if node is not None else f"{one_line(line.name)}: {words}")
        key = FaultKey(FaultKind.LOG, source, part, topic)
        known = {fault.key for fault in self.faults.lasting(FaultKind.LOG, source)}
        if len(known) >= MAX_PATTERNS and key not in known:
            key = FaultKey(FaultKind.LOG, source, "other errors", topic)
        self.faults.report(key, severity, words, received_ns)


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
    log = [name for name in _LOG_TOPICS if published.get(name, frozenset()) & _LOGS.keys()]
    return frozenset((*(direct or states), *log[:1]))


def _node_of_logger(logger: str, graph: Graph) -> str | None:
    """Return the node of a logger, which in ROS 2 has dots (`arm.driver.bus` of `/arm/driver`); None if unknown."""
    name = logger if logger.startswith("/") else "/" + logger.replace(".", "/")
    while name and name not in graph.nodes:
        name = name.rpartition("/")[0]
    return name or None


class _Outcomes(Struct):
    """Goals and calls that failed, or succeeded again."""

    session: Session
    faults: Faults
    revisions: tuple[int, int] = (0, 0)
    known: dict[tuple[str, str], CallState | GoalStatus] = field(default_factory=dict)

    def look(self, graph: Graph) -> None:
        """Report the outcomes since the last look."""
        calls, goals = self.session.calls, self.session.goals
        if self.revisions == (calls.revision, goals.revision):
            return
        self.revisions = calls.revision, goals.revision
        before, self.known = self.known, {}
        for call in calls.all():
            key = FaultKey(FaultKind.CALL, Ref(Kind.SERVICE, call.service))
            words = call.words or f"the call {call.state.value}"
            self._note(("calls", call.id), before, key, call.state, words, call.answered_ns or call.created_ns)
        for goal in goals.all():
            key = FaultKey(FaultKind.GOAL, Ref(Kind.ACTION, goal.action))
            words = goal.words or f"the goal was {goal.status.value}"
            self._note(("goals", goal.id), before, key, goal.status, words, goal.ended_ns or goal.updated_ns)

    def _note(
        self,
        path: tuple[str, str],
        known: Mapping[tuple[str, str], CallState | GoalStatus],
        key: FaultKey,
        state: CallState | GoalStatus,
        words: str,
        time_ns: int,
    ) -> None:
        self.known[path], before = state, known.get(path)
        if state in _FAILED and before not in _FAILED:
            self.faults.report(key, Severity.ERROR, words, time_ns, path)
        elif state in (CallState.SUCCEEDED, GoalStatus.SUCCEEDED) and state is not before:
            self.faults.heal(key, time_ns)


class _Nodes(Struct):
    """Nodes that vanished or came back, and whether the robot can be reached at all.

    Nodes do not register again with a restarted master, so after it, and while the robot cannot be reached, all nodes
    are forgotten. `missing` has the loop times at which known nodes left the graph.
    """

    faults: Faults
    graph: Graph | None = None
    known: dict[str, None] = field(default_factory=dict)
    missing: dict[str, float] = field(default_factory=dict)

    def look(self, graph: Graph) -> None:
        """Report nodes that have been missing for a while, once each."""
        if isinstance(graph.state, Stale):
            self.faults.report(_ROBOT, Severity.ERROR, f"cannot be reached: {graph.state.why}", graph.state.since_ns)
            self.known.clear()
            return
        if graph is not self.graph:
            self._learn(graph)
        horizon, now_ns = loop_time() - GONE_SECONDS, time.time_ns()
        gone = [name for name, since in self.missing.items() if since < horizon]
        if len(gone) > 1 and len(gone) == len(self.known):
            self.faults.report(_ROBOT, Severity.ERROR, f"all {len(gone)} nodes vanished", now_ns)
            return
        self.faults.heal(_ROBOT)
        for name in gone:
            del self.known[name], self.missing[name]
            node = graph.nodes.get(name)
            words = "the node vanished" if node is None else f"the node vanished: {node.unreachable}"
            self.faults.report(FaultKey(FaultKind.NODE, Ref(Kind.NODE, name)), Severity.ERROR, words, now_ns)

    def _learn(self, graph: Graph) -> None:
        """Note which nodes of a new graph are known, missing, or back."""
        if self.graph is not None and graph.master != self.graph.master:
            self.known.clear()
        self.graph = graph
        present = {name for name, node in graph.nodes.items() if node.unreachable is None and name != graph.own_node}
        self.known.update((name, None) for name in sorted(present) if not _PASSING.search(name))
        while len(self.known) > _MAX_NODES:
            self.known.pop(next(iter(self.known)))
        now = loop_time()
        self.missing = {name: self.missing.get(name, now) for name in self.known if name not in present}
        for fault in self.faults.lasting(FaultKind.NODE):
            if fault.key.name in present:
                self.faults.heal(fault.key)


class _Rhythm(Struct):
    """The messages of a topic: the newest one, when it was noticed, and since when they came without a long pause."""

    newest_ns: int
    heard_at: float
    steady_since: float


class _Rhythms(Struct):
    """Topics that are subscribed to for other reasons, and fell silent or speak again."""

    session: Session
    faults: Faults
    rhythms: dict[str, _Rhythm] = field(default_factory=dict)

    def look(self, graph: Graph) -> None:
        """Report topics that have fallen silent, once each."""
        before, self.rhythms = self.rhythms, {}
        if isinstance(graph.state, Stale):
            return
        for name in self.session.topics.subscribed():
            view = self.session.topics.peek(name)
            newest = None if view is None else view.newest
            if view is not None and newest is not None and newest.publisher != graph.own_node:
                self.rhythms[name] = self._judge(graph, name, before.get(name), newest.received_ns, view.rate)
        for fault in self.faults.lasting(FaultKind.TOPIC):
            rhythm = self.rhythms.get(fault.key.name)
            if rhythm is not None and rhythm.newest_ns > fault.last_ns:
                self.faults.heal(fault.key, rhythm.newest_ns)

    def _judge(self, graph: Graph, name: str, rhythm: _Rhythm | None, newest_ns: int, rate: float | None) -> _Rhythm:
        """Return the rhythm of a topic now, and report it if it was steady and is silent."""
        now = loop_time()
        if rhythm is None:
            return _Rhythm(newest_ns, now, now)
        is_silent = rate is not None and now - rhythm.heard_at > max(SILENT_SECONDS, SILENT_PERIODS / rate)
        if newest_ns != rhythm.newest_ns:
            return _Rhythm(newest_ns, now, now if is_silent else rhythm.steady_since)
        if is_silent and rhythm.heard_at - rhythm.steady_since >= STEADY_SECONDS and _is_steady(graph, name):
            words = f"no message, after {rate:.3g} per second"
            self.faults.report(FaultKey(FaultKind.TOPIC, Ref(Kind.TOPIC, name)), Severity.WARNING, words, newest_ns)
            rhythm.steady_since = now
        return rhythm


def _is_steady(graph: Graph, name: str) -> bool:
    """Whether a topic is published all the time: those of goals and commands, and of vanished nodes, are not."""
    topic = graph.topics[name]
    if name in RESERVED or graph.is_of_action(name) or any(ref.name in COMMANDS for ref in topic.types):
        return False
    return any(each.unreachable is None for each in topic.publishers)
