"""Writing: who writes a property now, what a content is lowered to, and what becomes of it on the robot."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import replace
from typing import Any, TypeVar, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import LoweringError
from rosld.ontology.vocab import rdf, xsd
from rosld.server.http.problem import Problem
from rosld.server.hypermedia.catalogue import (
    Catalogue,
    OpenKind,
    ParameterSource,
    Property,
    ScalarKind,
    Setter,
    TopicSource,
    Writer,
)
from rosld.server.hypermedia.conventions import catalogue
from rosld.server.hypermedia.property_writer import (
    PlannedWrite,
    WriteOutcome,
    carry_out,
    current_writer,
    lower_content,
    not_writable_reason,
    plan_write,
)
from rosld.server.hypermedia.type_inference import value_kind
from rosld.server.hypermedia.value import StoredValue
from rosld.server.robot.calls import UnreadableResponse
from rosld.server.robot.session import Session
from rosld.server.settings import Settings

T = TypeVar("T")

LIFTING = LiftSettings()
LIBRARY = TypeLibrary(ros_version=1)
POWER, SPEED, SEATS, DISPLAY = "/aircraft/power", "/aircraft/engine/speed", "/aircraft/seats", "/cockpit/display"


def run(main: Awaitable[T]) -> T:
    return asyncio.run(main)  # type: ignore[arg-type]


def writer_of(robot: Session, own: Property) -> Writer | None:
    return current_writer(robot.adapter, robot.settings, own)


def reason_of(robot: Session, own: Property) -> str:
    return not_writable_reason(robot.adapter, robot.settings, own)


class Flight:
    """The embedded aircraft as a robot, with what was written to it."""

    def __init__(self, **settings: Any) -> None:
        self.adapter = Aircraft(AdapterOptions())
        self.robot = Session(self.adapter, Settings(**settings))
        self.written: list[tuple[Kind, str]] = []
        self.robot.add_write_listener(lambda kind, name: self.written.append((kind, name)))
        self.catalogue: Catalogue = catalogue(self.adapter.graph, LIBRARY.find)

    def property(self, name: str) -> Property:
        return self.catalogue.properties[name]

    def plan(self, name: str, content: object) -> PlannedWrite:
        return plan_write(self.robot, self.property(name), content)


def flown(test: Callable[[Flight], Awaitable[None]], **settings: Any) -> None:
    async def main() -> None:
        flight = Flight(**settings)
        await flight.robot.open()
        try:
            await test(flight)
        finally:
            await flight.robot.close()

    run(main())


def violations(error: LoweringError) -> list[tuple[str, str]]:
    return [(each.path, each.message) for each in error.violations]


def test_what_does_not_fit_is_refused_before_anything_moves() -> None:
    async def main(flight: Flight) -> None:
        for content in (5, None, {"data": "on", "more": 1}, ["on"], Literal(5)):
            with pytest.raises(LoweringError) as caught:
                flight.plan(POWER, content)
            assert violations(caught.value) == [("", "expected a string")]
        with pytest.raises(LoweringError, match="expected a string without a language"):
            flight.plan(POWER, Literal("on", language="en"))
        for content in (None, [None], Literal("x", datatype=xsd.anyURI), Literal("x", language="en")):
            with pytest.raises(LoweringError):
                flight.plan(SEATS, content)

    flown(main)


def test_a_parameter_takes_whatever_parameters_can_be() -> None:
    async def main(flight: Flight) -> None:
        values = [
            (Literal("7", datatype=xsd.short), 7),
            (Literal("0.1", datatype=xsd.double), 0.1),
            (Literal("INF", datatype=xsd.float), math.inf),
            (Literal('["a",1]', datatype=rdf.JSON), ["a", 1]),
            (["a", 1], ["a", 1]),
            ({"@value": "NaN", "@type": "xsd:string"}, "NaN"),
            ({"a": {"b": True}}, {"a": {"b": True}}),
        ]
        for content, stored in values:
            plan = flight.plan(SEATS, content)
            assert isinstance(plan.value, StoredValue)
            assert (plan.value.value, type(plan.value.value)) == (stored, type(stored))
        assert (plan.writer, plan.data) == (ParameterSource(SEATS), b"")
        assert await carry_out(flight.robot, plan) is WriteOutcome.DONE
        assert flight.written == [(Kind.PARAMETER, SEATS)]

    flown(main)


def test_each_property_of_the_aircraft_has_the_writer_it_should() -> None:
    async def main(flight: Flight) -> None:
        writers = {name: writer_of(flight.robot, own) for name, own in flight.catalogue.properties.items()}
        assert {name: writer.name for name, writer in writers.items() if writer is not None} == {
            **{name: name for name in flight.catalogue.by_parameter},
            POWER: "/aircraft/set_power",
            SPEED: "/aircraft/engine/set_speed",
            "/aircraft/engine/direction": "/aircraft/engine/set_direction",
            DISPLAY: DISPLAY,
        }

    flown(main)


class Fake:
    """What an adapter does for writing."""

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
    return Property(X, OpenKind(), (), writers or (SETTER, ParameterSource(X), TOPIC))


def test_the_first_writer_that_may_write_now_does() -> None:
    everything = writable()
    assert writer_of(robot()[0], everything) is SETTER
    no_service = replace(WHOLE_GRAPH, services={})
    assert writer_of(robot(no_service)[0], everything) == ParameterSource(X)
    assert writer_of(robot(WHOLE_GRAPH, {Operation.SET_PARAMETER})[0], everything) == ParameterSource(X)
    assert writer_of(robot(replace(no_service, parameters={}))[0], everything) is TOPIC
    assert writer_of(robot(WHOLE_GRAPH, {Operation.PUBLISH})[0], everything) is TOPIC
    assert writer_of(robot(WHOLE_GRAPH, {Operation.PUBLISH}, allow_publish=())[0], everything) is None
    assert writer_of(robot(Graph(1))[0], everything) is None
    assert writer_of(robot()[0], Property(X, OpenKind())) is None


def test_why_nothing_writes_is_told_of_every_writer() -> None:
    told = reason_of(robot(Graph(1))[0], writable())
    assert told == (
        "There is no service /robot/set_x any more. There is no parameter /robot/x any more. "
        "There is no topic /robot/x any more."
    )
    uncallable = {"/robot/set_x": Service("/robot/set_x", SET.ref, (), "its definition is not known")}
    nothing = robot(replace(WHOLE_GRAPH, services=uncallable), ())[0]
    assert reason_of(nothing, writable()) == (
        "The service /robot/set_x cannot be called: its definition is not known. "
        "The parameter /robot/x of this fake cannot be set. Nothing can be published on /robot/x of a fake."
    )
    assert reason_of(robot()[0], writable(TopicSource(X, None))) == "The type of /robot/x is not known."
    with pytest.raises(Problem) as caught:
        plan_write(robot(Graph(1))[0], writable(), 1)
    assert (caught.value.status, "/robot/set_x" in caught.value.detail) == (405, True)
    assert reason_of(robot()[0], Property(X, OpenKind())) == (
        "/robot/x has no setter, no parameter and no topic that could be written."
    )


def test_the_answer_of_a_setter_is_the_outcome_of_the_write() -> None:
    async def main() -> None:
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
        with pytest.raises(LoweringError, match="beyond its range"):
            plan_write(own, writable(), 1e300)

    run(main())


def test_a_message_that_nobody_heard_is_told() -> None:
    async def main() -> None:
        own, fake = robot()
        fake.matched = 0
        assert await carry_out(own, plan_write(own, writable(TOPIC), 1)) is WriteOutcome.UNHEARD
        fake.matched = 1
        assert await carry_out(own, plan_write(own, writable(TOPIC), 1)) is WriteOutcome.DONE

    run(main())


def test_a_parameter_beside_something_typed_keeps_to_that_type() -> None:
    own = robot()[0]
    typed = Property(X, ScalarKind(Primitive("float64")), (), (ParameterSource(X),))
    for content, stored in ((5, 5.0), (Literal(5), 5.0), (Literal("INF", datatype=xsd.double), math.inf)):
        plan = plan_write(own, typed, content)
        assert isinstance(plan.value, StoredValue)
        assert (plan.value.value, type(plan.value.value)) == (stored, float)
    with pytest.raises(LoweringError, match="expected a float64"):
        plan_write(own, typed, "fast")
    point = message_schema("float64 x\nfloat64 y")
    whole = Property(X, value_kind(point, point.type.fields), (), (ParameterSource(X),))
    plan = plan_write(own, whole, {"x": 1, "y": 2})
    assert isinstance(plan.value, StoredValue)
    assert plan.value.value == {"x": 1, "y": 2}
    with pytest.raises(LoweringError) as caught:
        plan_write(own, whole, {"x": 1})
    assert [each.path for each in caught.value.violations] == ["y"]


FLOAT, INTEGER = message_schema("float64 data"), message_schema("int64 data")


def test_a_message_takes_the_object_of_its_fields_and_no_literal() -> None:
    schema = message_schema("float64 x\nfloat64 y")
    message = lower_content(schema, {"x": 1, "y": "NaN"}, LIFTING)
    assert getattr(message, "x") == 1.0  # noqa: B009
    for content in (Literal(1), 1, [1, 2], "x", None):
        with pytest.raises(LoweringError) as caught:
            lower_content(schema, content, LIFTING)
        assert [each.path for each in caught.value.violations] == [""]
    with pytest.raises(LoweringError) as caught:
        lower_content(schema, {"x": "far", "z": 1}, LIFTING)
    assert {each.path for each in caught.value.violations} == {"x", "y", "z"}


def test_a_literal_counts_by_its_own_datatype() -> None:
    whole = message_schema("int64 data")
    with pytest.raises(LoweringError):
        lower_content(whole, Literal("5"), LIFTING)
    assert getattr(lower_content(whole, Literal("5", datatype=xsd.decimal), LIFTING), "data") == 5  # noqa: B009
    number = message_schema("float64 data")
    with pytest.raises(LoweringError):
        lower_content(number, Literal("NaN"), LIFTING)


@settings(deadline=None)
@given(st.floats(), st.integers(-(2**63), 2**63 - 1))
def test_numbers_arrive_exactly(number: float, whole: int) -> None:
    lexical = "NaN" if math.isnan(number) else repr(number).replace("inf", "INF")
    message = lower_content(FLOAT, Literal(lexical, datatype=xsd.double), LIFTING)
    data = getattr(message, "data")  # noqa: B009
    assert data == number or (math.isnan(data) and math.isnan(number))
    for content in (whole, str(whole), Literal(str(whole), datatype=xsd.integer)):
        assert getattr(lower_content(INTEGER, content, LIFTING), "data") == whole  # noqa: B009
