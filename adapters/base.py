"""The adapter contract: what a kind of ROS system must offer so that rosld can serve it.

Outsiders implement `Adapter` and publish a factory in the entry-point group `rosld.adapters`, under the scheme of
their sources (`myros` for `rosld serve myros://...`). The built-in adapters are found the same way, and
`tests/contracts/` runs one suite on each of them.

Rules, each of which a contract test holds:

- All methods are called on the server's event loop; no call blocks it. A live adapter does its I/O on a thread of
  its own, so that a busy server never makes a robot's publisher wait.
- Deadlines are absolute times of the running loop (`loop.time()`). Cancelling an await stops waiting, it undoes
  nothing.
- Errors are `rosld.adapters.model`'s; each tells whether the robot may have received the request.
- Reconnection is the adapter's business: the graph goes `Stale`, never empty, and subscriptions stay valid.
- Looking leaves no trace in the robot's system; whatever was registered is unregistered by `close`.
- What rosld publishes is a sample of the publisher `graph.own_node` like anyone's: any subscription to that topic,
  made before or after, shows it, with no subscription to ourselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, TypeAlias

from msgspec import Struct, field

from rosld.adapters.model import Encoding, GoalEvent, GoalId, Graph, Operation, Qos, Ref, Sample, Schema, TypeRef
from rosld.adapters.model import ParameterValue as ParameterValue


class Capabilities(Struct, frozen=True):
    """What an adapter's kind of system can do at all, for what `allows` cannot tell thing by thing.

    `system` names it ("ROS 1", "recording", ...); `encoding` is what `publish` and `call` take and `call` returns;
    `parameter_trees`: parameters form one tree of namespaces (ROS 1), so that a namespace can be read and deleted
    whole; `parameter_server`: parameters that have no node in the graph are kept by a server, of whose changes nodes
    are not told (ROS 1); `writes`: anything can be written at all; `creates_topics`: a topic that is not there may be
    published;
    `qos`: publishers and subscribers have a quality of service; `hidden_names`: a name with a segment that begins with
    an underscore is hidden (ROS 2), and listings leave it out unasked.
    `mapping` and `limits` are documents that this kind of robot comes with (RDF, opaque to adapters), None for most.
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
        ...


class Subscription(Protocol):
    """A counted interest in one topic."""

    def latest(self) -> Sequence[Sample]:
        """Return the newest sample of each publisher (the newest `depth` of each), the one that came last at the end.

        Cheap: the very same sequence object comes back while nothing new has arrived.
        """
        ...

    def watch(self, wake: Callable[[], None]) -> Watch:
        """Call `wake` on the server's loop after something new arrived: coalesced, carrying nothing."""
        ...

    def close(self) -> None:
        """Give this interest back. Idempotent."""
        ...


class Sink(Protocol):
    """Receives the changes of an adapter. Thread-safe, never blocks, never raises."""

    def graph_changed(self, graph: Graph) -> None:
        """The computation graph is now `graph`; several changes may come as one."""
        ...

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        """Something became known of a goal, of rosld's or another's. Feedback may be left out where it comes fast."""
        ...

    def parameter_changed(self, name: str) -> None:
        """A hint that the value of this parameter (or of something below it) should be read again."""
        ...


class NullSink:
    """A `Sink` that ignores everything; a subclass overrides what it listens to."""

    def graph_changed(self, graph: Graph) -> None:
        """Not of interest."""

    def goal_changed(self, goal: GoalId, event: GoalEvent) -> None:
        """Not of interest."""

    def parameter_changed(self, name: str) -> None:
        """Not of interest."""


class RecordedTopic(Struct, frozen=True):
    """A topic of a recording: its type, how many messages, and why they cannot be decoded (None: they can)."""

    name: str
    type: TypeRef
    count: int
    unreadable: str | None = None


class RecordedMessage(Struct, frozen=True):
    """Message `index` (from 0, in recorded order) of a recording.

    `is_opening`: it was sent before the recording begins, and opens it, for it is latched.
    """

    index: int
    topic: str
    sample: Sample
    is_opening: bool = False


FOR_EVER = 1 << 62
"""A time in ns, and a number of messages, that none is above."""


class MessageFilter(Struct, frozen=True):
    """Which messages of a recording: of `topics` (None: all), recorded from `from_ns` to `to_ns`, both included.

    Their indexes are from `start` on and below `end`.
    """

    topics: frozenset[str] | None = None
    from_ns: int = 0
    to_ns: int = FOR_EVER
    start: int = 0
    end: int = FOR_EVER


class MessagePage(NamedTuple):
    """Some messages in the order of their indexes, and the `start` of those that come after them; None: there are none.

    What cannot be read is left out.
    """

    messages: Sequence[RecordedMessage]
    next: int | None


PAGE_BYTES = 16 * 1024 * 1024
"""Bytes of messages after which a page ends, whatever its limit."""


class Recording(Protocol):
    """A recording (a ROS bag) that can be read message by message."""

    @property
    def name(self) -> str:
        """The name in URLs."""
        ...

    @property
    def path(self) -> Path:
        """The path of the file or folder."""
        ...

    @property
    def format(self) -> str:
        """The format of its file, for people."""
        ...

    @property
    def first(self) -> int:
        """The index of the first message that it still holds: 0 but where the oldest are removed."""
        ...

    @property
    def count(self) -> int:
        """The number of messages from the first on."""
        ...

    @property
    def start_ns(self) -> int:
        """When the first was recorded; 0 where there is none."""
        ...

    @property
    def end_ns(self) -> int:
        """When the last was recorded; 0 where there is none."""
        ...

    @property
    def topics(self) -> Mapping[str, RecordedTopic]:
        """The topics by name."""
        ...

    @property
    def silent(self) -> Sequence[str]:
        """The names and globs of chosen topics without a message in this recording."""
        ...

    def message(self, index: int) -> RecordedMessage:
        """Message `index`; raises NotFound outside first to first+count-1. Quick, but reads the disk."""
        ...

    def topic_of(self, index: int) -> str | None:
        """Return the topic of message `index`, None where there is no such message. Quick, and reads no message."""
        ...

    def messages(self) -> Iterator[RecordedMessage]:
        """Return all messages in recorded order, those that cannot be decoded included."""
        ...

    @property
    def identity(self) -> str:
        """An identifier (letters and digits) that no other recording has, also none of the same name.

        While it is the same a message's index means the same message.
        """
        ...

    def times_between(self, start: int, end: int) -> tuple[int, int] | None:
        """Times in ns that all messages from index `start` and below `end` lie between; None where there is none."""
        ...

    @property
    def settled(self) -> int:
        """The index below which no message comes any more."""
        ...

    def latest_at(self, topic: str, time_ns: int) -> RecordedMessage | None:
        """The message of a topic that was the newest at a time; None where there was none. Raises Unreachable."""
        ...

    def select(self, criteria: MessageFilter, limit: int) -> MessagePage:
        """Return at most `limit` messages, of about `PAGE_BYTES`; no more is read than these take."""
        ...

    def schema(self, ref: TypeRef) -> Schema:
        """Return the schema of a type of this recording; raises UnknownType."""
        ...


class Adapter(Protocol):
    """One ROS system, live, embedded or recorded."""

    @property
    def capabilities(self) -> Capabilities:
        """The capabilities of this kind of system; constant."""
        ...

    @property
    def graph(self) -> Graph:
        """The computation graph as last known; immutable."""
        ...

    @property
    def recordings(self) -> Mapping[str, Recording]:
        """The recordings this source offers, by name; empty for most."""
        ...

    async def open(self, sink: Sink, *, deadline: float) -> None:
        """Connect. When it returns the graph is there; Stale for a robot that is off, which is then waited for.

        Raises Unreachable for what no waiting helps (a middleware that does not start), NotFound for a missing file.
        """
        ...

    async def close(self) -> None:
        """Leave without a trace: quick (two seconds at most) and idempotent."""
        ...

    def allows(self, ref: Ref) -> frozenset[Operation]:
        """What ROS can do with this thing now: pure, from the graph.

        Unknown things allow nothing, but a topic that is not there allows PUBLISH where `creates_topics`, and a
        parameter SET_PARAMETER. A node allows CHANGE_STATE while a transition of its lifecycle is legal.
        """
        ...

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        """Return the schema of a type; without a hash, the one in use. Raises UnknownType."""
        ...

    def known_types(self) -> Sequence[TypeRef]:
        """Return the types in use or met so far (what `/types/` lists); cheap."""
        ...

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        """Begin to receive a topic: counted, and fine before a publisher is there. Returns at once."""
        ...

    def age_ns(self, sample: Sample) -> int:
        """How many nanoseconds ago a sample was received, by the clock of its system.

        That of the wall, or of the playing where it is a recording. Never negative; cheap, and called in any thread.
        """
        ...

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        """Publish, advertising first if need be and then waiting for a subscriber to match until `deadline`.

        With no match by then the message is still handed over and `matched` is 0. Raises Refused, Unreachable.
        """
        ...

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        """Advertise a topic without publishing, so that its subscribers are connected when something is published.

        Waits for a subscriber to match until `deadline`; that none does is no error. Where it is advertised already it
        is made to suit those who subscribe now. Raises Refused, Unreachable, UnknownType.
        """
        ...

    async def unadvertise(self, topic: str) -> None:
        """Stop advertising what rosld advertised; NotFound where it advertised nothing."""
        ...

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        """Call a service. Raises Refused with the node's words, TimedOut, Unreachable, NotFound."""
        ...

    async def send_goal(self, action: str, type: TypeRef, goal: bytes, *, deadline: float) -> GoalId:
        """Send a goal and return its id once it is accepted; what follows is announced to the sink.

        `goal` is a message of the type's goal. Raises Refused (with the server's words) where it is rejected, TimedOut,
        Unreachable, NotFound.
        """
        ...

    async def cancel_goal(self, goal: GoalId, *, deadline: float) -> None:
        """Request the cancellation of a goal of any sender; the sink reports the outcome. Raises Refused, NotFound."""
        ...

    async def cancel_goals(self, action: str, *, deadline: float) -> None:
        """Ask for all goals of an action to be canceled, whoever sent them; there may be none.

        Raises Refused, TimedOut, Unreachable, NotFound.
        """
        ...

    async def follow_goals(self, action: str, *, deadline: float) -> Watch:
        """Announce all goals of an action to the sink, those of others too, until the watch is closed. Counted.

        Returns once what can be known of them now was told, at the latest at the deadline. Of goals that rosld sent it
        is told without this, until they have ended. Raises NotFound.
        """
        ...

    async def change_state(self, node: str, transition: str, *, deadline: float) -> None:
        """Have a managed node make a transition, named by its label.

        When it returns or raises, the graph has the state that the node told afterwards, where it told one. Raises
        Refused where the transition is not legal now (`sent` is NO) or the node did not make it (YES), and for nodes
        without a lifecycle; TimedOut, Unreachable, NotFound.
        """
        ...

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        """Return the values of those names that exist; a name that is a tree gives a dict, `/` all."""
        ...

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        """Set them, all or none where ROS can. Raises Refused naming the parameter."""
        ...

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        """Delete them (trees whole). Raises NotFound."""
        ...


MESSAGE_LIMIT = 256 * 1024 * 1024


class AdapterOptions(Struct, frozen=True):
    """The options of `rosld serve` that concern adapters; each adapter takes what applies to it.

    `qos` are profiles for topics by glob: the first that fits holds, where it says something. `message_limit` are the
    most bytes that a message or a response may have which a robot's node announces and rosld then reads,
    `recording_index_limit` the most memory that the index of a recording may take, where strangers may have made it.
    """

    types: tuple[Path, ...] = ()
    ros_ip: str | None = None
    host_map: Mapping[str, str] = field(default_factory=dict)
    qos: tuple[tuple[str, Qos], ...] = ()
    rate: float = 1.0
    once: bool = False
    message_limit: int = MESSAGE_LIMIT
    recording_index_limit: int | None = None


Factory: TypeAlias = Callable[[str, AdapterOptions], Adapter]
"""Makes an adapter (not yet open) from a source as given on the command line. Raises ValueError for a bad source."""
