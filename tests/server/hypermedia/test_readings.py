"""Readings: who is asked for a value, how often, and what becomes of it when the robot does not behave."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar, cast

import pytest

from rosld.adapters.aircraft import Aircraft
from rosld.adapters.base import Adapter, AdapterOptions, ParameterValue, Subscription
from rosld.adapters.model import (
    Encoding,
    Endpoint,
    Graph,
    MessageSchema,
    Refused,
    RosError,
    Sample,
    Schema,
    ServiceSchema,
    Topic,
    TypeRef,
    UnknownType,
    Unreachable,
    freeze,
)
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.slots import Slot
from rosld.ontology.lift import LiftSettings
from rosld.ontology.lower import lowerer
from rosld.ontology.urls import Space
from rosld.server.hypermedia.catalogue import Getter, OpenKind, ParameterSource, Property, TopicSource
from rosld.server.hypermedia.property_reader import PropertyReader
from rosld.server.hypermedia.type_inference import value_fields
from rosld.server.hypermedia.value import Reading, plain_json
from rosld.server.robot.goals import Goals
from rosld.server.robot.live_topics import LiveSettings, LiveTopics
from rosld.server.robot.schemas import Schemas

T = TypeVar("T")

SPACE = Space("http://127.0.0.1:8080/")
LIFTING = LiftSettings()
LIBRARY = TypeLibrary(ros_version=1)
FRESHNESS, PATIENCE = 1.0, 10.0


def goals_of(adapter: Adapter) -> Goals:
    """The goals of a robot, none of which has a schema at hand."""
    return Goals(adapter, lambda _: None, limit=10, age=60.0, idle=10.0)


class Clock(asyncio.SelectorEventLoop):
    """A loop whose time can be put forward."""

    skipped = 0.0

    def time(self) -> float:
        return super().time() + self.skipped

    def skip(self, seconds: float) -> None:
        self.skipped += seconds


def run(main: Callable[[Clock], Awaitable[T]]) -> T:
    """Run a test on such a loop; nothing it began may be left over."""
    loop = Clock()
    try:
        return loop.run_until_complete(main(loop))  # type: ignore[arg-type]
    finally:
        loop.run_until_complete(cancel_all())
        loop.close()


async def cancel_all() -> None:
    left = asyncio.all_tasks() - {cast("asyncio.Task[object]", asyncio.current_task())}
    for task in left:
        task.cancel()
    await asyncio.gather(*left, return_exceptions=True)


def soon(seconds: float = 5.0) -> float:
    return asyncio.get_running_loop().time() + seconds


async def turns(count: int = 5) -> None:
    """Let everything run that can."""
    for _ in range(count):
        await asyncio.sleep(0)


def plain(reading: Reading) -> object:
    """The value as JSON; the failure's text where there is none."""
    return plain_json(reading.value, LIFTING).decode() if reading.value is not None else reading.failure


GET = LIBRARY.find(TypeRef("rosld_aircraft/srv/GetNumber"))
ASKED = "/robot/get_x"


def getter(name: str, schema: Schema = GET) -> Getter:
    assert isinstance(schema, ServiceSchema)
    return Getter(name, schema, value_fields(schema))


def number(value: float) -> bytes:
    assert isinstance(GET, ServiceSchema)
    message = lowerer(GET.response).from_json({"data": value})
    return GET.response.codec.encode(message, Encoding.ROS1)


class Fake:
    """What an adapter does for readings: services answer as they are told to, topics are slots."""

    def __init__(self) -> None:
        self.capabilities = replace(Aircraft(AdapterOptions()).capabilities, system="fake")
        self.calls: list[str] = []
        self.deadlines: list[float] = []
        self.running = 0
        self.max_running = 0
        self.begun = asyncio.Event()
        self.release = asyncio.Event()
        self.hangs = False
        self.answers: Callable[[int], bytes] = number
        self.stored: dict[str, ParameterValue] | Exception = {}
        self.fetched: list[Sequence[str]] = []
        self.slots: dict[str, Slot] = {}
        self.topics: dict[str, Topic] = {}
        self.unknown: set[str] = set()
        self.subscribed: list[str] = []

    @property
    def graph(self) -> Graph:
        return Graph(1, topics=freeze(self.topics))

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        assert request == b""
        self.calls.append(service)
        self.deadlines.append(deadline)
        turn = len(self.calls)
        self.running += 1
        self.max_running = max(self.running, self.max_running)
        try:
            self.begun.set()
            if self.hangs:
                await self.release.wait()
            return self.answers(turn)
        finally:
            self.running -= 1

    async def get_parameters(self, names: Sequence[str], *, deadline: float) -> Mapping[str, ParameterValue]:
        self.fetched.append(names)
        if self.hangs:
            await self.release.wait()
        if isinstance(self.stored, Exception):
            raise self.stored
        return {name: self.stored[name] for name in names if name in self.stored}

    async def schema(self, ref: TypeRef, *, deadline: float) -> Schema:
        if ref.name in self.unknown:
            raise UnknownType(f"nobody knows {ref.name}")
        return LIBRARY.find(ref)

    async def subscribe(self, topic: str, *, depth: int = 1) -> Subscription:
        self.subscribed.append(topic)
        return self.slots.setdefault(topic, Slot()).subscribe(depth)

    def say(self, topic: str, kind: str, value: object, sequence: int = 1) -> None:
        """Somebody publishes."""
        schema = LIBRARY.find(TypeRef(kind))
        assert isinstance(schema, MessageSchema)
        data = value if isinstance(value, bytes) else None
        if data is None:
            data = schema.codec.encode(lowerer(schema).from_json(value), Encoding.ROS1)
        self.advertise(topic, schema.ref)
        sample = Sample(data, Encoding.ROS1, schema.ref, "/talker", 1000 + sequence, sequence)
        self.slots.setdefault(topic, Slot()).put(sample)

    def advertise(self, topic: str, ref: TypeRef) -> None:
        self.topics[topic] = Topic(topic, (ref,), (Endpoint("/talker", ref),))


class Bench:
    """Readings of a fake robot."""

    def __init__(self, freshness: float = FRESHNESS, patience: float = PATIENCE, first: float = 0.0) -> None:
        self.fake = Fake()
        adapter = cast(Adapter, self.fake)
        schemas = Schemas(adapter)
        self.topics = LiveTopics(adapter, schemas, LiveSettings(first_value=first))
        self.readings = PropertyReader(
            adapter, self.topics, goals_of(adapter), schemas, SPACE, freshness=freshness, patience=patience
        )

    def property(self, *readers: TopicSource | Getter | ParameterSource, name: str = "/robot/x") -> Property:
        return Property(name, OpenKind(), readers or (getter(ASKED),))

    async def read(
        self, *readers: TopicSource | Getter | ParameterSource, within: float = 5.0, refresh: bool = False
    ) -> Reading:
        found = await self.readings.read([self.property(*readers)], deadline=soon(within), refresh=refresh)
        return found["/robot/x"]


def benched(test: Callable[[Bench, Clock], Awaitable[None]], **how: float) -> None:
    async def main(loop: Clock) -> None:
        bench = Bench(**how)
        await test(bench, loop)
        await bench.readings.stop()
        await bench.topics.stop()
        await turns()
        assert len(asyncio.all_tasks()) == 1, "something is left running"

    run(main)


def test_a_reader_that_is_cancelled_takes_the_call_from_nobody() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.hangs = True
        impatient, patient = (asyncio.ensure_future(bench.read()) for _ in range(2))
        await bench.fake.begun.wait()
        impatient.cancel()
        with suppress(asyncio.CancelledError):
            await impatient
        bench.fake.release.set()
        assert plain(await patient) == "1.0"
        assert len(bench.fake.calls) == 1

    benched(main)


def test_a_call_goes_on_when_all_its_readers_have_gone_and_its_answer_is_kept() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.hangs = True
        reader = asyncio.ensure_future(bench.read())
        await bench.fake.begun.wait()
        reader.cancel()
        bench.fake.release.set()
        await turns()
        assert plain(await bench.read()) == "1.0"
        assert len(bench.fake.calls) == 1

    benched(main)


def refuses(error: RosError | Exception) -> Callable[[int], bytes]:
    def answer(turn: int) -> bytes:
        raise error

    return answer


def test_a_reading_anew_shares_only_calls_that_began_after_it() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.hangs = True
        before = asyncio.ensure_future(bench.read())
        await turns()
        anew = [asyncio.ensure_future(bench.read(refresh=True)) for _ in range(3)]
        await turns()
        assert len(bench.fake.calls) == 2
        after = asyncio.ensure_future(bench.read())
        await turns()
        assert len(bench.fake.calls) == 2
        bench.fake.release.set()
        assert plain(await before) in ("1.0", "2.0")
        assert [plain(each) for each in await asyncio.gather(*anew, after)] == ["2.0"] * 4
        assert plain(await bench.read()) == "2.0", "the older answer does not replace the newer"

    benched(main)


def test_readings_anew_of_a_getter_that_hangs_do_not_pile_up() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.hangs = True
        readers = []
        for _ in range(30):
            readers.append(asyncio.ensure_future(bench.read(refresh=True)))
            await turns()
        assert len(bench.fake.calls) == 2
        bench.fake.release.set()
        found = [plain(each) for each in await asyncio.gather(*readers)]
        assert found == ["1.0", "2.0", *["3.0"] * 28]
        assert bench.fake.max_running == 2

    benched(main)


@pytest.mark.parametrize("steps", [0, 1, 2, 3, 4, 6])
def test_whenever_freshness_ends_what_was_asked_before_is_never_known_after(steps: int) -> None:
    """At every turn of the loop between the answer and the reader that gets it."""

    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.hangs = True
        before = asyncio.ensure_future(bench.read())
        await turns()
        bench.fake.release.set()
        await turns(steps)
        bench.readings.invalidate(["/robot/x"])
        after = asyncio.ensure_future(bench.read())
        assert plain(await before) == "1.0"
        assert plain(await after) == "2.0"
        known = bench.readings.cached(bench.property())
        assert known is not None
        assert plain(known) == "2.0"

    benched(main)


def test_parameters_share_calls_and_their_freshness_ends_too() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.stored = {"/robot/x": 1, "/robot/y": 2}
        both = [bench.property(ParameterSource(f"/robot/{key}"), name=f"/robot/{key}") for key in "xy"]
        bench.fake.hangs = True
        readers = [asyncio.ensure_future(bench.readings.read(both, deadline=soon())) for _ in range(50)]
        await turns()
        assert bench.fake.fetched == [["/robot/x", "/robot/y"]]
        bench.fake.release.set()
        found = await asyncio.gather(*readers)
        assert {id(each["/robot/x"]) for each in found} == {id(found[0]["/robot/x"])}
        bench.fake.stored = {"/robot/x": 3, "/robot/y": 4}
        bench.readings.invalidate(["/robot/y"])
        again = await bench.readings.read(both, deadline=soon())
        assert [plain(each) for each in again.values()] == ["1", "4"]
        assert bench.fake.fetched[1:] == [["/robot/y"]]
        anew = await bench.readings.read(both, deadline=soon(), refresh=True)
        assert [plain(each) for each in anew.values()] == ["3", "4"]

    benched(main)


def test_a_parameter_that_has_vanished_or_cannot_be_had_is_told() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        own = ParameterSource("/robot/x")
        assert plain(await bench.read(own)) == "there is no parameter /robot/x any more"
        bench.fake.stored = Unreachable("the master does not answer")
        assert plain(await bench.read(own, refresh=True)) == "/robot/x cannot be read: the master does not answer"
        deep: ParameterValue = 1
        for _ in range(100):
            deep = [deep]
        bench.fake.stored = {"/robot/x": deep}
        assert str(plain(await bench.read(own, refresh=True))).startswith("/robot/x cannot be shown: ")
        bench.fake.hangs = True
        reader = asyncio.ensure_future(bench.read(own, refresh=True, within=2.0))
        await turns()
        loop.skip(2.0)
        assert plain(await reader) == "/robot/x has not answered within 2 s"

    benched(main)


TOPIC = TopicSource("/robot/x", None)


def test_where_all_sources_fail_all_failures_are_told() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.say("/robot/x", "std_msgs/msg/Float64", b"\x00")
        bench.fake.answers = refuses(Refused("no"))
        failure = str(plain(await bench.read(TOPIC, getter(ASKED), ParameterSource("/robot/x"))))
        assert failure.startswith("the latest message of /robot/x cannot be read: 1 bytes are no std_msgs/msg/Float64")
        assert failure.endswith("; /robot/get_x refused: no; there is no parameter /robot/x any more")

    benched(main)


def test_a_message_of_an_unknown_type_is_told() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.unknown = {"std_msgs/msg/Float64"}
        bench.fake.say("/robot/x", "std_msgs/msg/Float64", {"data": 7})
        assert plain(await bench.read(TOPIC)) == "/robot/x cannot be read: nobody knows std_msgs/msg/Float64"
        bench.fake.unknown = set()
        loop.skip(FRESHNESS)
        assert plain(await bench.read(TOPIC)) == "7.0"

    benched(main)


def test_a_topic_that_is_silent_is_waited_for_once() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.advertise("/robot/x", LIBRARY.find(TypeRef("std_msgs/msg/Float64")).ref)
        readers = [asyncio.ensure_future(bench.read(TOPIC)) for _ in range(20)]
        await turns()
        assert not any(each.done() for each in readers)
        loop.skip(3.0)
        readings = await asyncio.gather(*readers)
        assert {(each.value, each.failure) for each in readings} == {(None, None)}
        loop.skip(FRESHNESS)
        assert plain(await asyncio.wait_for(bench.read(TOPIC), 1.0)) is None
        assert bench.fake.subscribed == ["/robot/x"]
        bench.fake.say("/robot/x", "std_msgs/msg/Float64", {"data": 7})
        assert plain(await bench.read(TOPIC)) == "7.0"

    benched(main, first=3.0)


def test_stopping_cancels_what_runs_and_tells_who_waits() -> None:
    async def main(bench: Bench, loop: Clock) -> None:
        bench.fake.hangs = True
        reader = asyncio.ensure_future(bench.read())
        await bench.fake.begun.wait()
        await bench.readings.stop()
        assert bench.fake.running == 0
        assert (await reader).value is None

    benched(main)
