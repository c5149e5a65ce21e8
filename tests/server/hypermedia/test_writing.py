"""Writing: the current writer of a property, the lowering of contents, and the effects on the robot."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any, cast

import pytest
from msgspec.structs import replace
from pyoxigraph import Literal

from rosld.adapters.aircraft import Aircraft
from rosld.adapters.base import Adapter, AdapterOptions, Published
from rosld.adapters.model import (
    Graph,
    Kind,
    MessageSchema,
    Operation,
    Parameter,
    Primitive,
    Ref,
    Refused,
    Sent,
    Service,
    ServiceSchema,
    TimedOut,
    Topic,
    TypeRef,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.ontology.violations import LoweringError
from rosld.ontology.vocab import xsd
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.catalogue import (
    ParameterSource,
    Property,
    Setter,
    TopicSource,
    Writer,
)
from rosld.server.hypermedia.property_writer import (
    WriteOutcome,
    carry_out,
    current_writer,
    not_writable_reason,
    plan_write,
)
from rosld.server.hypermedia.value import StoredValue
from rosld.server.robot.calls import UnreadableResponse
from rosld.server.robot.session import Session
from rosld.server.settings import Settings
from rosld.shapes.value import OpenShape, ScalarShape, value_shape


def writer_of(robot: Session, own: Property) -> Writer | None:
    return current_writer(robot.adapter, robot.settings, own)


def reason_of(robot: Session, own: Property) -> str:
    return not_writable_reason(robot.adapter, robot.settings, own)


class Fake:
    """The part of an adapter that writing needs."""

    def __init__(self, graph: Graph, allowed: Iterable[Operation] = Operation) -> None:
        self.graph = graph
        self.capabilities = replace(Aircraft(AdapterOptions()).capabilities, system="fake")
        self.recordings: dict[str, object] = {}
        self.allowed = frozenset(allowed)
        self.sent: list[bytes] = []
        self.answer: bytes | Exception = b""
        self.matched = 1

    def allows(self, ref: Ref) -> frozenset[Operation]:
        known = {Kind.SERVICE: self.graph.services, Kind.TOPIC: self.graph.topics, Kind.PARAMETER: {}}[ref.kind]
        return self.allowed if ref.name in known or ref.kind is Kind.PARAMETER else frozenset()

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        self.sent.append(request)
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    async def publish(self, topic: str, type: TypeRef, data: bytes, *, latch: bool, deadline: float) -> Published:
        self.sent.append(data)
        assert not latch
        return Published(self.matched)


def message_schema(definition: str, name: str = "made_up/msg/Thing") -> MessageSchema:
    return TypeLibrary(ros_version=1).learn_message(name, definition)


def service(definition: str) -> ServiceSchema:
    return TypeLibrary(ros_version=1).learn_service("made_up/srv/Set", definition)


X = "/robot/x"
SET = service("float32 value\n---\nbool success\nstring message")
SETTER = Setter("/robot/set_x", SET)
TOPIC = TopicSource(X, message_schema("float32 data"))
WHOLE_GRAPH = Graph(
    1,
    services={"/robot/set_x": Service("/robot/set_x", SET.ref, ("/robot",))},
    topics={X: Topic(X, (TypeRef("made_up/msg/Thing"),))},
    parameters={X: Parameter(X)},
)


def robot(
    graph: Graph = WHOLE_GRAPH, allowed: Iterable[Operation] = Operation, **settings: Any
) -> tuple[Session, Fake]:
    fake = Fake(graph, allowed)
    own = Session(cast(Adapter, fake), Settings(**{"allow_publish": (X,), **settings}))
    return own, fake


def writable(*writers: Writer) -> Property:
    return Property(X, OpenShape(), (), writers or (SETTER, ParameterSource(X), TOPIC))


def test_the_first_writer_that_may_write_now_does() -> None:
    everything = writable()
    assert writer_of(robot()[0], everything) is SETTER
    no_service = dataclasses.replace(WHOLE_GRAPH, services={})
    assert writer_of(robot(no_service)[0], everything) == ParameterSource(X)
    assert writer_of(robot(WHOLE_GRAPH, {Operation.SET_PARAMETER})[0], everything) == ParameterSource(X)
    assert writer_of(robot(dataclasses.replace(no_service, parameters={}))[0], everything) is TOPIC
    assert writer_of(robot(WHOLE_GRAPH, {Operation.PUBLISH})[0], everything) is TOPIC
    assert writer_of(robot(WHOLE_GRAPH, {Operation.PUBLISH}, allow_publish=())[0], everything) is None
    assert writer_of(robot(Graph(1))[0], everything) is None
    assert writer_of(robot()[0], Property(X, OpenShape())) is None


def test_why_nothing_writes_is_told_of_every_writer() -> None:
    told = reason_of(robot(Graph(1))[0], writable())
    assert told == (
        "The service /robot/set_x no longer exists. The parameter /robot/x no longer exists. "
        "The topic /robot/x no longer exists."
    )
    uncallable = {"/robot/set_x": Service("/robot/set_x", SET.ref, (), "its definition is not known")}
    nothing = robot(dataclasses.replace(WHOLE_GRAPH, services=uncallable), ())[0]
    assert reason_of(nothing, writable()) == (
        "The service /robot/set_x cannot be called: its definition is not known. "
        "The parameter /robot/x of this fake cannot be set. Nothing can be published on /robot/x of a fake."
    )
    assert reason_of(robot()[0], writable(TopicSource(X, None))) == "The type of /robot/x is not known."
    with pytest.raises(Problem) as caught:
        plan_write(robot(Graph(1))[0], writable(), 1)
    assert (caught.value.status, "/robot/set_x" in caught.value.detail) == (405, True)
    assert reason_of(robot()[0], Property(X, OpenShape())) == ("/robot/x has no writable setter, parameter or topic.")


async def test_the_answer_of_a_setter_is_the_outcome_of_the_write() -> None:
    own, fake = robot()
    written: list[tuple[Kind, str]] = []
    own.add_write_listener(lambda kind, name: written.append((kind, name)))
    for answer in (b"\x01\x00\x00\x00\x00", b"\x01\x04\x00\x00\x00done"):
        fake.answer = answer
        assert await carry_out(own, plan_write(own, writable(), 1)) is WriteOutcome.DONE
    for answer, words in ((b"\x00\x08\x00\x00\x00too fast", "too fast"), (b"\x00\x00\x00\x00\x00", None)):
        fake.answer = answer
        with pytest.raises(Refused) as refused:
            await carry_out(own, plan_write(own, writable(), 1))
        assert (refused.value.words, refused.value.sent) == (words, Sent.YES)
    fake.answer = b"\x00"
    with pytest.raises(UnreadableResponse) as unreadable:
        await carry_out(own, plan_write(own, writable(), 1))
    assert unreadable.value.sent is Sent.YES
    fake.answer = TimedOut("no answer", sent=Sent.MAYBE)
    with pytest.raises(TimedOut) as late:
        await carry_out(own, plan_write(own, writable(), 1))
    assert late.value is fake.answer
    assert written == [(Kind.SERVICE, "/robot/set_x")] * len(fake.sent)
    with pytest.raises(LoweringError, match="out of its range"):
        plan_write(own, writable(), 1e300)


async def test_a_message_that_nobody_heard_is_told() -> None:
    own, fake = robot()
    fake.matched = 0
    assert await carry_out(own, plan_write(own, writable(TOPIC), 1)) is WriteOutcome.UNHEARD
    fake.matched = 1
    assert await carry_out(own, plan_write(own, writable(TOPIC), 1)) is WriteOutcome.DONE


def test_a_parameter_beside_something_typed_keeps_to_that_type() -> None:
    own = robot()[0]
    typed = Property(X, ScalarShape(Primitive("float64")), (), (ParameterSource(X),))
    for content, stored in ((5, 5.0), (Literal(5), 5.0), (Literal("INF", datatype=xsd.double), math.inf)):
        plan = plan_write(own, typed, content)
        assert isinstance(plan.value, StoredValue)
        assert (plan.value.value, type(plan.value.value)) == (stored, float)
    with pytest.raises(LoweringError, match="expected a float64"):
        plan_write(own, typed, "fast")
    point = message_schema("float64 x\nfloat64 y")
    whole = Property(X, value_shape(point, point.type.fields), (), (ParameterSource(X),))
    plan = plan_write(own, whole, {"x": 1, "y": 2})
    assert isinstance(plan.value, StoredValue)
    assert plan.value.value == {"x": 1, "y": 2}
    with pytest.raises(LoweringError) as caught:
        plan_write(own, whole, {"x": 1})
    assert [each.path for each in caught.value.violations] == ["y"]
