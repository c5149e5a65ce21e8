"""A robot simulated by a test, and served: its resources appear and disappear, and all calls are counted."""

from __future__ import annotations

import asyncio
import copy
import inspect
import json
import signal
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

import httpx
import pytest

from rosld.adapters import parameters as trees
from rosld.adapters.base import Adapter, Capabilities, Published, Recording, Sink, Subscription
from rosld.adapters.model import (
    Action,
    Descriptor,
    Encoding,
    Endpoint,
    GoalEvent,
    GoalId,
    GoalStatus,
    Graph,
    Kind,
    Master,
    MessageSchema,
    Node,
    NotFound,
    Operation,
    Parameter,
    Ref,
    Refused,
    Sample,
    Schema,
    Sent,
    Service,
    ServiceSchema,
    Stale,
    TimedOut,
    Topic,
    TypeRef,
    Unreachable,
    freeze,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.parameter_messages import operations_on
from rosld.adapters.slots import Slot
from rosld.ontology.lift import LiftSettings, lifter
from rosld.ontology.lower import lowerer
from tests.serving_thread import ServingThread

T = TypeVar("T")

Act: TypeAlias = Callable[[dict[str, Any]], "Mapping[str, Any] | Awaitable[Mapping[str, Any]]"]
"""Effect of a service: from its request to its response, both as plain JSON; missing fields have ROS's defaults."""

ROBOT, LISTENER, ROSLD = "/robot", "/listener", "/rosld"
PATIENCE = 20.0
TYPES = {
    "made_up/srv/GetByte": "---\nint8 value",
    "made_up/srv/SetByte": "int8 value\n---\nbool success\nstring message",
    "made_up/srv/GetWords": "---\nstring words",
    "made_up/srv/SetWords": "string words\n---",
    "made_up/srv/GetLabel": "---\nbool success\nstring message\nstring label",
    "made_up/srv/GetRange": "---\nfloat64 low\nfloat64 high",
    "made_up/srv/SetRange": "float64 low\nfloat64 high\n---\nbool success\nstring message",
    "made_up/srv/GetCorners": "---\nint32[4] corners",
    "made_up/srv/SetCorners": "int32[4] corners\n---",
    "made_up/srv/GetPose": "---\ngeometry_msgs/Pose pose",
    "made_up/srv/SetPose": "geometry_msgs/Pose pose\n---\nbool success\nstring message",
    "made_up/srv/GetBlob": "---\nuint8[] data",
    "made_up/srv/Aim": "float64 azimuth\nfloat64 elevation\n---\nbool hit",
}
_LIFTING = LiftSettings(inline_limit=1 << 62)


@dataclass
class _Topic:
    type: TypeRef
    published: bool
    heard: bool
    slot: Slot = field(default_factory=Slot)
    sequence: int = 0


class MadeUp:
    """An `Adapter` of services that are functions, and of topics and parameters, all of which a test can change.

    `calls` counts the calls of each service, `reads` those for the value of each parameter; `sent` are the published
    messages, as plain JSON; `sets` are the groups of parameters set together, `owners` the nodes of parameters that are
    not the system's, and `declared` their declarations. Methods may be called from the test's thread and on the loop.
    """

    capabilities = Capabilities("made-up", Encoding.ROS1, writes=True, creates_topics=False, parameter_trees=True)
    recordings: Mapping[str, Recording] = MappingProxyType({})
    catalogue: None = None

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()
        self.reads: Counter[str] = Counter()
        self.sent: dict[str, list[Any]] = {}
        self.owners: tuple[str, ...] = ()
        self.nodes: tuple[str, ...] = (ROBOT, LISTENER)
        self.declared: dict[str, Descriptor] = {}
        self.sets: list[Mapping[str, ParameterValue]] = []
        self.graph = Graph(0)
        self.master: Master | None = None
        self._library = TypeLibrary(ros_version=1)
        for name, text in TYPES.items():
            self._library.learn_service(name, text)
        self._services: dict[str, tuple[ServiceSchema, Act]] = {}
        self._topics: dict[str, _Topic] = {}
        self._parameters: trees.Tree = {}
        self._strange: list[Topic | Service | Action] = []
        self._held: dict[str, asyncio.Event] = {}
        self._sink: Sink | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._loop_thread = 0
        self._happened = threading.Condition()

    # For tests

    def offer(self, name: str, type: str, act: Act) -> None:
        """Add a service with this name."""
        schema = self._library.find(TypeRef(type))
        assert isinstance(schema, ServiceSchema)
        self.run(lambda: self._revised(self._services.__setitem__, name, (schema, act)))

    def answer(self, name: str, type: str, **values: Any) -> None:
        """Add a service that always returns the same response."""
        self.offer(name, type, lambda _: values)

    def variable(
        self, name: str, kind: str, *, get: str | None = "get_{}", set: str | None = "set_{}", **values: Any
    ) -> dict[str, Any]:
        """Add a getter and a setter of `made_up/srv/GetKIND` and `SetKIND`, and return the values between them."""
        namespace, _, own = name.rpartition("/")

        def written(request: dict[str, Any]) -> Mapping[str, Any]:
            values.update(request)
            return {"success": True} if "success" in TYPES[f"made_up/srv/Set{kind}"] else {}

        if get is not None:
            self.offer(f"{namespace}/{get.format(own)}", f"made_up/srv/Get{kind}", lambda _: values)
        if set is not None:
            self.offer(f"{namespace}/{set.format(own)}", f"made_up/srv/Set{kind}", written)
        return values

    def withdraw(self, name: str) -> None:
        """Remove a service, also from the graph."""
        self.run(lambda: self._revised(self._services.pop, name))

    def break_off(self, name: str) -> None:
        """Break a service, which stays in the graph."""
        self.run(lambda: self._services.pop(name))

    def topic(self, name: str, type: str, value: Any = None, *, published: bool = True, heard: bool = False) -> None:
        """Add a topic with a publishing or a subscribing node, or both, and optionally its first message."""
        self.topics([name], type, published=published, heard=heard)
        if value is not None:
            self.publishes(name, value)

    def topics(self, names: Iterable[str], type: str, *, published: bool = True, heard: bool = False) -> None:
        """Add topics of one type, all with one change of the graph."""
        ref = self._message(type).ref
        added = {name: _Topic(ref, published, heard) for name in names}
        self.run(lambda: self._revised(self._topics.update, added))

    def slot(self, name: str) -> Slot:
        """Return the slot of a topic, which counts its subscriptions."""
        return self._topics[name].slot

    def subscribed(self) -> set[str]:
        """Return the topics with a subscription."""
        return {name for name, topic in self._topics.items() if topic.slot.subscriptions}

    def forget(self, name: str) -> None:
        """Remove a topic, with all its endpoints."""
        self.run(lambda: self._revised(self._topics.pop, name))

    def publishes(self, name: str, value: Any, *, odd: tuple[bytes, bytes] = (b"", b"")) -> None:
        """Publish a message as the robot; `odd` are bytes in it, and what replaces them."""
        self.run(lambda: self._put(name, ROBOT, self._encoded(name, value).replace(*odd)))

    def strange(self, *things: Topic | Service | Action) -> None:
        """Add names to the graph about which nothing else is known."""
        self.run(lambda: self._revised(self._strange.extend, things))

    def parameter(self, name: str, value: ParameterValue) -> None:
        """Set the value of a parameter."""
        self.run(lambda: self._parameters_are(trees.with_value(self._parameters, name, value)))

    def lose_parameter(self, name: str) -> None:
        """Break a parameter, which stays in the graph."""
        self._parameters = trees.without_name(self._parameters, name)

    def has_nodes(self, *nodes: str, master: str = "1") -> None:
        """Set the nodes of the graph, and the run of its master."""
        self.nodes, self.master = nodes, Master("http://robot:11311/", master)
        self.run(lambda: self._revised(lambda: None))

    def goal(self, action: str, id: str, status: GoalStatus, words: str | None = None) -> None:
        """Report the status of a goal, as its action server does."""
        assert self._sink is not None
        self._sink.goal_changed(GoalId(action, id), GoalEvent(time.time_ns(), status, words))

    def goes_stale(self, why: str) -> None:
        """Make the robot unreachable; the graph is the last known one."""
        self.run(lambda: self._announce(replace(self.graph, state=Stale(time.time_ns(), why))))

    def hold(self, name: str) -> None:
        """Let calls of this service hang until `release`."""
        self.run(lambda: self._held.__setitem__(name, asyncio.Event()))

    def release(self, name: str) -> None:
        """Answer the calls that hang."""
        self.run(lambda: self._held.pop(name).set())

    def until(self, true: Callable[[], object], what: str = "what was waited for") -> None:
        """Wait for a condition on the calls."""
        with self._happened:
            assert self._happened.wait_for(true, PATIENCE), f"never came: {what}"

    def run(self, act: Callable[[], T]) -> T:
        """Run a function on the loop that serves the robot, or directly on that loop or before the robot is served."""
        if self._loop is None or not self._loop.is_running() or self._loop_thread == threading.get_ident():
            return act()

        async def on_the_loop() -> T:
            return act()

        return asyncio.run_coroutine_threadsafe(on_the_loop(), self._loop).result(PATIENCE)

    # The adapter

    async def open(self, sink: Sink, *, deadline: float) -> None:
        self._sink, self._loop, self._loop_thread = sink, asyncio.get_running_loop(), threading.get_ident()
        self._revised(lambda: None)

    async def close(self) -> None:
        self._sink = None

    def allows(self, ref: Ref) -> frozenset[Operation]:
        graph = self.graph
        if ref.kind is Kind.TOPIC and ref.name in graph.topics:
            return frozenset({Operation.SUBSCRIBE, Operation.PUBLISH})
        if ref.kind is Kind.SERVICE and ref.name in graph.services:
            return frozenset({Operation.CALL})
        if ref.kind is Kind.ACTION and ref.name in graph.actions:
            return frozenset({Operation.SEND_GOAL})
        if ref.kind is Kind.PARAMETER:
            return operations_on(self.declared.get(ref.name))
        return frozenset()

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        return self._library.find(ref)

    def known_types(self) -> Sequence[TypeRef]:
        return [*(one.type for one in self._topics.values()), *(one.ref for one, _ in self._services.values())]

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        return (self._topics[topic].slot if topic in self._topics else Slot()).subscribe(depth)

    def age_ns(self, sample: Sample) -> int:
        return max(0, time.time_ns() - sample.received_ns)

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        there = self._topics[topic]
        schema = self._message(there.type.name)
        self.sent.setdefault(topic, []).append(_plain(schema, data))
        self._put(topic, ROSLD, data)
        return Published(int(there.heard))

    async def advertise(self, topic: str, type: TypeRef, *, deadline: float) -> None:
        self._message(type.name)

    async def unadvertise(self, topic: str) -> None:
        raise NotFound(f"rosld does not advertise {topic}")

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        with self._happened:
            self.calls[service] += 1
            self._happened.notify_all()
        held = self._held.get(service)
        if held is not None:
            try:
                await asyncio.wait_for(held.wait(), deadline - asyncio.get_running_loop().time())
            except (asyncio.TimeoutError, TimeoutError) as error:
                raise TimedOut(f"{service} did not respond", sent=Sent.MAYBE) from error
        if service not in self._services:
            raise Unreachable(f"the node of {service} does not answer")
        schema, act = self._services[service]
        answered = act(_plain(schema.request, request))
        values = await answered if inspect.isawaitable(answered) else answered
        return schema.response.codec.encode(
            lowerer(schema.response, _LIFTING).from_json(dict(values), defaults=True), Encoding.ROS1
        )

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        self.reads.update(names)
        found = {name: trees.read_name(self._parameters, name) for name in names}
        return {name: copy.deepcopy(value) for name, value in found.items() if value is not None}

    async def set_parameters(self, values: Mapping[str, ParameterValue], *, deadline: float) -> None:
        self.sets.append(values)
        tree = self._parameters
        for name, value in values.items():
            if value == "refused":
                raise Refused(f"{name} cannot be {value!r}")
            tree = trees.with_value(tree, name, value)
        self._parameters_are(tree)

    async def delete_parameters(self, names: Sequence[str], *, deadline: float) -> None:
        tree = self._parameters
        for name in names:
            tree = trees.without_name(tree, name)
        self._parameters_are(tree)

    # Implementation

    def _message(self, type: str) -> MessageSchema:
        schema = self._library.find(TypeRef(type))
        assert isinstance(schema, MessageSchema)
        return schema

    def _encoded(self, topic: str, value: Any) -> bytes:
        schema = self._message(self._topics[topic].type.name)
        return schema.codec.encode(lowerer(schema, _LIFTING).from_json(value, defaults=True), Encoding.ROS1)

    def _put(self, name: str, publisher: str, data: bytes) -> None:
        topic = self._topics[name]
        topic.sequence += 1
        topic.slot.put(Sample(data, Encoding.ROS1, topic.type, publisher, time.time_ns(), topic.sequence))

    def _owner(self, name: str) -> str | None:
        return next((node for node in self.owners if name.startswith(f"{node}/")), None)

    def _parameters_are(self, tree: trees.Tree) -> None:
        self._parameters = tree
        self._revised(lambda: None)

    def _odd(self, kind: type[T]) -> dict[str, T]:
        return {one.name: one for one in self._strange if isinstance(one, kind)}

    def _revised(self, change: Callable[..., object], *arguments: object) -> None:
        change(*arguments)
        graph = Graph(
            0,
            master=self.master,
            nodes=freeze({name: Node(name) for name in self.nodes}),
            topics=freeze({name: _told(name, one) for name, one in self._topics.items()} | self._odd(Topic)),
            services=freeze(
                {name: Service(name, one.ref, (ROBOT,)) for name, (one, _) in self._services.items()}
                | self._odd(Service)
            ),
            actions=freeze(self._odd(Action)),
            parameters=freeze(
                {
                    name: Parameter(name, self._owner(name), self.declared.get(name))
                    for name in trees.leaves(self._parameters)
                }
            ),
        )
        self._announce(graph)

    def _announce(self, graph: Graph) -> None:
        self.graph = replace(graph, revision=self.graph.revision + 1)
        if self._sink is not None:
            self._sink.graph_changed(self.graph)


def _told(name: str, topic: _Topic) -> Topic:
    publishers = (Endpoint(ROBOT, topic.type),) if topic.published else ()
    return Topic(name, (topic.type,), publishers, (Endpoint(LISTENER, topic.type),) if topic.heard else ())


def _plain(schema: MessageSchema, data: bytes) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(lifter(schema, _LIFTING).json(schema.codec.decode(data, Encoding.ROS1), ""))
    return found


class Counted:
    """Any adapter, with the calls of its services counted."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self.calls: Counter[str] = Counter()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._adapter, name)

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        self.calls[service] += 1
        await asyncio.sleep(0)  # as on a wire: other tasks run between the request and the response
        answer = await self._adapter.call(service, type, request, deadline=deadline)
        await asyncio.sleep(0)
        return answer


@contextmanager
def served(adapter: Adapter, **settings: Any) -> Iterator[httpx.Client]:
    """Yield a client of a server of this adapter, on a free port and a separate thread."""
    server = ServingThread.of_adapter(adapter, **settings)
    try:
        with httpx.Client(base_url=server.url(), timeout=PATIENCE) as client:
            yield client
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait(PATIENCE)


Serving: TypeAlias = Callable[..., httpx.Client]


@pytest.fixture
def robot() -> MadeUp:
    """A new simulated robot."""
    return MadeUp()


@pytest.fixture
def serving(robot: MadeUp) -> Iterator[Serving]:
    """`serving(SETTINGS)` serves that robot until the test ends."""
    with ExitStack() as stack:
        yield lambda **settings: stack.enter_context(served(robot, **settings))
