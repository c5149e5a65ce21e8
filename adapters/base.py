"""The adapter contract: the interface between rosld and a kind of ROS system.

Third parties implement `Adapter` and publish a factory in the entry-point group `rosld.adapters`, under the scheme of
their sources (`myros` for `rosld serve myros://...`). The built-in adapters are found the same way, and
`tests/contracts/` runs one suite on each of them.

Rules, each verified by a contract test:

- All methods are called on the server's event loop; no call blocks it. A live adapter does its I/O on a thread of
  its own, so that a busy server never delays a robot's publisher.
- Deadlines are absolute times of the running loop (`loop.time()`). Cancelling an await stops waiting; it undoes
  nothing.
- Errors are those of `rosld.adapters.model`; each states whether the robot may have received the request.
- The adapter reconnects by itself: meanwhile the graph is `Stale`, never empty, and subscriptions stay valid.
- Reading leaves no trace in the robot's system; `close` unregisters everything that was registered.
- Messages that rosld publishes are samples of the publisher `graph.own_node`: every subscription to the topic, older
  or newer, delivers them without a ROS subscription to rosld itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias

from msgspec import Struct, field

from rosld.adapters.catalogue import Catalogue
from rosld.adapters.model import (
    Encoding,
    GoalEvent,
    GoalId,
    Graph,
    NotFound,
    Operation,
    Qos,
    Ref,
    Refused,
    Sample,
    Schema,
    TypeRef,
    without_lifecycle,
)
from rosld.adapters.model import ParameterValue as ParameterValue
from rosld.adapters.model.recorded import RecordedMessage as RecordedMessage
from rosld.adapters.model.recorded import RecordedTopic as RecordedTopic


class Capabilities(Struct, frozen=True):
    """Capabilities of a kind of system as a whole; `Adapter.allows` answers for a single thing.

    - `system`: its name ("ROS 1", "recording", ...); `encoding`: of messages that are sent, and of responses.
    - `writes`: the system accepts writes; `creates_topics`: publishing may create a topic.
    - `parameter_trees`: parameters form one tree of namespaces, which can be read and deleted whole (ROS 1).
    - `parameter_server`: parameters belong to no node, and nodes are not notified of changes (ROS 1).
    - `qos`: publishers and subscribers have a quality of service (ROS 2).
    - `hidden_names`: names with a segment that begins with an underscore are hidden; listings omit them (ROS 2).
    - `mapping`, `limits`: RDF documents supplied with this kind of robot, opaque to adapters; None for most.
    """

    system: str
    encoding: Encoding
    writes: bool
    creates_topics: bool
    parameter_trees: bool
    qos: bool = False
    hidden_names: bool = False
    parameter_server: bool = False
    mapping: Path | None = None
    limits: Path | None = None


class Published(Struct, frozen=True):
    """Result of a publish: the number of subscribers connected when the message was handed over."""

    matched: int


class Watch(Protocol):
    """A running watch of a subscription."""

    def close(self) -> None:
        """Stop waking. Idempotent."""


class Subscription(Protocol):
    """A reference-counted subscription to one topic, used on the server's loop."""

    def latest(self) -> Sequence[Sample]:
        """Return the newest `depth` samples of each publisher, the most recently received last.

        Cheap: returns the identical sequence object until a new sample arrives.
        """

    def watch(self, wake: Callable[[], None]) -> Watch:
        """Call `wake` without arguments on the server's loop after new samples arrive; calls are coalesced."""

    def close(self) -> None:
        """Release this reference to the subscription. Idempotent."""


class Sink(Protocol):
    """Receives the changes of an adapter, from any thread. Never blocks, never raises."""

    def graph_changed(self, graph: Graph) -> None:
        """Receive the new computation graph; one call may cover several changes."""

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        """Receive an update about a goal of rosld or of another client. Frequent feedback may be dropped."""

    def parameter_changed(self, name: str) -> None:
        """Receive a hint that the value of this parameter (or of one below it) should be read again."""


class NullSink:
    """A `Sink` that ignores everything; subclasses override the events they need."""

    def graph_changed(self, graph: Graph) -> None:
        """Not of interest."""

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        """Not of interest."""

    def parameter_changed(self, name: str) -> None:
        """Not of interest."""


FOR_EVER = 1 << 62
"""Upper bound of any time in ns and of any number of messages."""


class MessageFilter(Struct, frozen=True):
    """Filter for messages of a recording: of `topics` (None: all), recorded from `from_ns` to `to_ns` (inclusive).

    Indexes range from `start` (inclusive) to `end` (exclusive).
    """

    topics: frozenset[str] | None = None
    from_ns: int = 0
    to_ns: int = FOR_EVER
    start: int = 0
    end: int = FOR_EVER


class MessagePage(NamedTuple):
    """A page of messages in index order, without unreadable ones, and the `start` of the next page (None: no more)."""

    messages: Sequence[RecordedMessage]
    next: int | None


PAGE_BYTES = 16 * 1024 * 1024
"""Size in bytes of messages after which a page ends, even below its limit."""


class Recording(Protocol):
    """A recording (a ROS bag) that can be read message by message, by several threads at once."""

    @property
    def name(self) -> str:
        """The name in URLs."""

    @property
    def path(self) -> Path:
        """The path of the file or folder."""

    @property
    def format(self) -> str:
        """The human-readable name of the file format."""

    @property
    def encoding(self) -> Encoding:
        """The encoding of the messages, that of the ROS that recorded them."""

    @property
    def first(self) -> int:
        """The index of the first stored message: 0 unless the oldest messages were removed."""

    @property
    def count(self) -> int:
        """The number of stored messages."""

    @property
    def start_ns(self) -> int:
        """The time of the first message in ns; 0 if there is none."""

    @property
    def end_ns(self) -> int:
        """The time of the last message in ns; 0 if there is none."""

    @property
    def topics(self) -> Mapping[str, RecordedTopic]:
        """The topics by name."""

    @property
    def silent(self) -> Sequence[str]:
        """The names and globs of chosen topics without a message in this recording."""

    def message(self, index: int) -> RecordedMessage:
        """Return message `index`; raises NotFound outside first to first+count-1. Fast, but reads the disk."""

    def topic_of(self, index: int) -> str | None:
        """Return the topic of message `index`, or None if there is no such message. Fast: reads no message."""

    def messages(self) -> Iterator[RecordedMessage]:
        """Return all messages in recorded order, including those that cannot be decoded."""

    @property
    def identity(self) -> str:
        """A unique identifier (letters and digits), different even for recordings of the same name.

        Message indexes are stable as long as the identifier is.
        """

    @property
    def content(self) -> str | None:
        """A key of its content, the same after its file was moved; None if the content may change."""

    def times_between(self, start: int, end: int) -> tuple[int, int] | None:
        """Return bounds in ns on the times of messages `start` to `end` (exclusive), or None if there are none."""

    @property
    def settled(self) -> int:
        """The index below which no message will be added."""

    def latest_at(self, topic: str, time_ns: int) -> RecordedMessage | None:
        """Return the newest message of a topic at a time, or None if there was none. Raises Unreachable."""

    def latched_before(self, time_ns: int, selects: Callable[[str], bool]) -> Iterable[tuple[str, Sample]]:
        """Return the latched messages that are in force at a time, with their topics. Raises Unreachable."""

    def select(self, criteria: MessageFilter, limit: int) -> MessagePage:
        """Return at most `limit` messages of about `PAGE_BYTES` in total, reading no others."""

    def density(self, parts: int) -> Mapping[str, Sequence[int]]:
        """Return the numbers of messages in equal parts of the time, by topic; empty if they are not known yet."""

    def schema(self, ref: TypeRef) -> Schema:
        """Return the schema of a type of this recording; raises UnknownType."""


class Adapter(Protocol):
    """One ROS system, live, embedded or recorded.

    Methods without a body are required. The others suit a system without services, actions, parameters and writes.
    """

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of this kind of system; constant."""

    @property
    def graph(self) -> Graph:
        """The computation graph as last known; immutable."""

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """The recordings of this source by name; empty for most sources."""
        return {}

    @property
    def catalogue(self) -> Catalogue | None:
        """The catalogue of a source of many recordings, else None."""
        return None

    async def wait_for_recordings(self) -> None:
        """Wait until all recordings of the source are in `recordings`."""
        return

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Connect and load the graph. If the robot is off, the graph is Stale and the adapter keeps trying to connect.

        Raises Unreachable for permanent failures (a middleware that does not start), NotFound for a missing file.
        """

    async def close(self) -> None:
        """Disconnect and unregister everything within two seconds. Idempotent."""

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """Return the operations that ROS allows on a thing now: a pure function of the graph.

        Unknown things allow nothing, except that a missing topic allows PUBLISH if `creates_topics` and a missing
        parameter allows SET_PARAMETER. A node allows CHANGE_STATE while a transition of its lifecycle is legal.
        """

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type: with this hash, or without one as in use now. Raises UnknownType."""

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types that are or were in use, for `/types/`. Cheap."""

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Subscribe to a topic, which need not exist yet, for `depth` samples of each publisher. Returns at once."""

    def age_ns(self, sample: Sample) -> int:
        """Return the nanoseconds since a sample was received, by the wall clock or the playback clock of a recording.

        Never negative, cheap and thread-safe.
        """
        return max(0, time.time_ns() - sample.received_ns)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish a message, advertising the topic and waiting for a subscriber until `deadline` if necessary.

        Without a subscriber by then, the message is still published and `matched` is 0. With `latch`, subscribers that
        come later receive it, too. Raises Refused, Unreachable, UnknownType.
        """
        raise _refusal(self)

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Advertise a topic without publishing, so that subscribers are connected before the first message.

        Waits for a subscriber until `deadline`; having none is no error. An existing advertisement is adapted to the
        current subscribers. Raises Refused, Unreachable, UnknownType.
        """
        raise _refusal(self)

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising a topic. Raises NotFound if rosld does not advertise it."""
        raise NotFound(f"rosld does not advertise {topic}")

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Return a service's response. Raises Refused with the node's message, TimedOut, Unreachable, NotFound."""
        raise _missing(self, "service", service)

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal and return its id once it is accepted; the sink receives later updates.

        `goal` is a goal message of the action type. Raises Refused (with the server's message) if it is rejected,
        TimedOut, Unreachable, NotFound.
        """
        raise _missing(self, "action", action)

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Request the cancellation of a goal of any sender; the sink reports the outcome. Raises Refused, NotFound."""
        raise _missing(self, "action", goal.action)

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Request the cancellation of all goals of an action, regardless of sender; there may be none.

        Raises Refused, TimedOut, Unreachable, NotFound.
        """
        raise _missing(self, "action", action)

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Report all goals of an action, of any sender, to the sink until the watch is closed. Reference-counted.

        Returns once the sink has received the current goals, at the latest at the deadline. Goals that rosld sent are
        reported until they end even without this watch. Raises NotFound.
        """
        raise _missing(self, "action", action)

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """Request a lifecycle transition of a managed node by its label.

        Afterwards, even after an error, the graph has the state that the node reported, if any. Raises Refused if the
        transition is not legal now (`sent` is NO), if the node did not make it (YES) or if the node has no lifecycle;
        TimedOut, Unreachable, NotFound.
        """
        raise without_lifecycle(self.graph.nodes, node)

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the values of those names that exist; the value of a namespace is a dict, and `/` holds everything."""
        return {}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set parameters, atomically where ROS supports that. Raises Refused naming the parameter."""
        raise _refusal(self)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete parameters and whole namespaces. Raises NotFound."""
        raise _missing(self, "parameter", ", ".join(names))


def _refusal(adapter: Adapter) -> Refused:
    return Refused(f"a {adapter.capabilities.system} cannot be written to")


def _missing(adapter: Adapter, kind: str, name: str) -> NotFound:
    return NotFound(f"there is no {kind} {name}: a {adapter.capabilities.system} has none")


MESSAGE_LIMIT = 256 * 1024 * 1024


class AdapterOptions(Struct, frozen=True):
    """The options of `rosld serve` for adapters; each adapter uses those that apply to it.

    - `types`: folders with definitions of types. `qos`: profiles by globs of topics; the first match applies.
    - `ros_ip`, `host_map`: the address at which nodes reach rosld, and addresses of hosts by name (ROS 1).
    - `message_limit`: the maximum size in bytes of a message or response from a node.
    - `rate`, `once`: the speed of playback, and whether it ends instead of looping.
    - `recording_index_limit`: the maximum memory in bytes for the index of an untrusted recording, else None.
    - `recording_name`: the name of a recording, instead of one from its path.
    - `catalogue`: the path of the catalogue of many recordings; None for one in their first folder.
    """

    types: tuple[Path, ...] = ()
    ros_ip: str | None = None
    host_map: Mapping[str, str] = field(default_factory=dict)
    qos: tuple[tuple[str, Qos], ...] = ()
    rate: float = 1.0
    once: bool = False
    message_limit: int = MESSAGE_LIMIT
    recording_index_limit: int | None = None
    catalogue: Path | None = None
    recording_name: str | None = None


Factory: TypeAlias = Callable[[str, AdapterOptions], Adapter]
"""Factory of an unopened adapter from a source on the command line. Raises ValueError for an invalid source."""


class Finding(NamedTuple):
    """Finding of `rosld check`: `level` is "ok", "warning" or "error"; `step` is what to do."""

    level: str
    subject: str
    text: str
    step: str = ""


Diagnose: TypeAlias = "Callable[[str, AdapterOptions, Graph | None], Iterable[Finding]]"
"""`diagnose` in the module `diagnosis` of an adapter's package: findings of this machine about reaching a source.

Called once the adapter is closed again, with its last graph, None if it could not be opened. Changes nothing.
"""
