"""The aircraft as an adapter: what the contract suite does not say of it."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Awaitable, Callable
from itertools import pairwise

import pytest

from rosld.adapters.aircraft import adapter
from rosld.adapters.aircraft.adapter import Aircraft
from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import (
    Encoding,
    Graph,
    MessageSchema,
    Refused,
    Sample,
    ServiceSchema,
    TypeRef,
    Unreachable,
)

SPEED = "/aircraft/engine/speed"


class Sink:
    def graph_changed(self, graph: Graph) -> None: ...

    def parameter_changed(self, name: str) -> None: ...


def fly(scenario: Callable[[Aircraft], Awaitable[None]]) -> None:
    async def flight() -> None:
        aircraft = Aircraft(AdapterOptions())
        await aircraft.open(Sink(), deadline=asyncio.get_running_loop().time() + 5)
        try:
            await asyncio.wait_for(scenario(aircraft), 30)
        finally:
            await aircraft.close()

    asyncio.run(flight())


def soon() -> float:
    return asyncio.get_running_loop().time() + 5


async def call(aircraft: Aircraft, name: str, **values: object) -> dict[str, object]:
    ref = aircraft.graph.services[name].type
    assert ref is not None
    schema = await aircraft.schema(ref, deadline=soon())
    assert isinstance(schema, ServiceSchema)
    codec = schema.request.codec
    request = codec.encode(codec.build(schema.request.ref.name, values), Encoding.ROS1)
    response = schema.response.codec.decode(await aircraft.call(name, ref, request, deadline=soon()), Encoding.ROS1)
    return {field.name: getattr(response, field.attribute) for field in schema.response.type.fields}


def value(sample: Sample) -> float:
    return float(struct.unpack("<d", sample.data)[0])


async def text(aircraft: Aircraft, said: str) -> tuple[TypeRef, bytes]:
    schema = await aircraft.schema(TypeRef("std_msgs/msg/String"), deadline=soon())
    assert isinstance(schema, MessageSchema)
    return schema.ref, schema.codec.encode(schema.codec.build(schema.ref.name, {"data": said}), Encoding.ROS1)


def test_it_is_the_system_of_listing_1() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        graph = aircraft.graph
        assert set(graph.nodes) == {"/aircraft", "/cockpit"}
        assert {name: topic.type.name for name, topic in graph.topics.items() if topic.type} == {
            SPEED: "std_msgs/msg/Float64",
            "/cockpit/display": "std_msgs/msg/String",
        }
        assert {name: service.type.name for name, service in graph.services.items() if service.type} == {
            "/aircraft/start": "std_srvs/srv/Trigger",
            "/aircraft/stop": "std_srvs/srv/Trigger",
            "/aircraft/set_power": "rosld_aircraft/srv/SetText",
            "/aircraft/get_power": "rosld_aircraft/srv/GetText",
            "/aircraft/engine/set_speed": "rosld_aircraft/srv/SetNumber",
            "/aircraft/engine/set_direction": "rosld_aircraft/srv/SetNumber",
            "/aircraft/engine/get_direction": "rosld_aircraft/srv/GetNumber",
        }
        assert [each.node for each in graph.topics["/cockpit/display"].subscribers] == ["/cockpit"]

    fly(scenario)


def test_it_is_started_steered_and_read_back() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        assert await call(aircraft, "/aircraft/get_power") == {"data": "off"}
        refusal = await call(aircraft, "/aircraft/engine/set_direction", data=90.0)
        assert refusal["success"] is False
        assert "start it" in str(refusal["message"])
        assert (await call(aircraft, "/aircraft/set_power", data="on"))["success"] is True
        assert await call(aircraft, "/aircraft/get_power") == {"data": "on"}
        assert (await call(aircraft, "/aircraft/start"))["success"] is False
        assert (await call(aircraft, "/aircraft/engine/set_direction", data=90.0))["success"] is True
        assert await call(aircraft, "/aircraft/engine/get_direction") == {"data": 90.0}
        assert (await call(aircraft, "/aircraft/stop"))["success"] is True
        assert await call(aircraft, "/aircraft/get_power") == {"data": "off"}

    fly(scenario)


def test_the_speed_comes_ten_times_a_second_also_while_off_and_reaches_what_is_commanded() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        subscription = await aircraft.subscribe(SPEED, depth=50)
        assert [value(sample) for sample in subscription.latest()] == [0.0]
        await call(aircraft, "/aircraft/start")
        await call(aircraft, "/aircraft/engine/set_speed", data=30.5)
        there = asyncio.Event()
        subscription.watch(lambda: value(subscription.latest()[-1]) == 30.5 and there.set())
        await asyncio.wait_for(there.wait(), 60)
        samples = subscription.latest()
        speeds = [value(sample) for sample in samples]
        assert speeds == sorted(speeds)
        assert [sample.sequence for sample in samples] == list(range(1, len(samples) + 1))
        gaps = [(b.received_ns - a.received_ns) / 1e9 for a, b in pairwise(samples)]
        assert sum(gaps) / len(gaps) == pytest.approx(0.1, abs=0.05)

    fly(scenario)


def test_a_busy_loop_leaves_messages_out_but_does_not_fall_behind() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        subscription = await aircraft.subscribe(SPEED, depth=50)
        time.sleep(0.55)  # noqa: ASYNC251 the loop is what is to be kept busy
        await asyncio.sleep(0.02)
        assert len(subscription.latest()) == 2

    fly(scenario)


def test_bytes_that_are_no_request_are_refused_in_words() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        for request in (b"", b"\xff" * 3, b"\0" * 9):
            with pytest.raises(Refused) as caught:
                await aircraft.call(
                    "/aircraft/engine/set_speed", TypeRef("rosld_aircraft/srv/SetNumber"), request, deadline=soon()
                )
            assert caught.value.words

    fly(scenario)


def test_a_service_is_not_called_with_another_type() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        with pytest.raises(Refused, match="is a std_srvs/srv/Trigger"):
            await aircraft.call("/aircraft/start", TypeRef("std_srvs/srv/SetBool"), b"\1", deadline=soon())
        with pytest.raises(Refused):
            await aircraft.call("/aircraft/start", TypeRef("std_srvs/srv/Trigger", "0" * 32), b"", deadline=soon())

    fly(scenario)


def test_a_topic_carries_one_type_only() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        ref, data = await text(aircraft, "fast")
        with pytest.raises(Refused, match=r"carries std_msgs/msg/Float64, not this std_msgs/msg/String"):
            await aircraft.publish(SPEED, ref, data, deadline=soon())
        with pytest.raises(Refused, match="service type"):
            await aircraft.publish("/x", TypeRef("std_srvs/srv/Trigger"), b"", deadline=soon())

    fly(scenario)


def test_a_latched_publish_says_so_in_the_graph_and_in_the_sample() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        ref, data = await text(aircraft, "hello")
        await aircraft.publish("/cockpit/display", ref, data, deadline=soon())
        subscription = await aircraft.subscribe("/cockpit/display")
        (plain,) = subscription.latest()
        await aircraft.publish("/cockpit/display", ref, data, latch=True, deadline=soon())
        (latched,) = subscription.latest()
        assert (plain.latched, latched.latched) == (False, True)
        assert latched.epoch > plain.epoch
        assert [each.latched for each in aircraft.graph.topics["/cockpit/display"].publishers] == [True]

    fly(scenario)


def test_what_was_advertised_and_given_up_is_no_longer_shown() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        ref, data = await text(aircraft, "hello")
        await aircraft.publish("/cockpit/display", ref, data, deadline=soon())
        subscription = await aircraft.subscribe("/cockpit/display")
        await aircraft.unadvertise("/cockpit/display")
        assert subscription.latest() == ()
        await aircraft.publish("/cockpit/display", ref, data, deadline=soon())
        assert [(sample.epoch, sample.sequence) for sample in subscription.latest()] == [(2, 1)]

    fly(scenario)


def test_a_closed_aircraft_cannot_be_reached() -> None:
    async def scenario(aircraft: Aircraft) -> None:
        ref, data = await text(aircraft, "hello")
        await aircraft.publish("/cockpit/display", ref, data, deadline=soon())
        await aircraft.close()
        assert "/rosld" not in aircraft.graph.nodes
        with pytest.raises(Unreachable):
            await aircraft.publish("/cockpit/display", ref, data, deadline=soon())

    fly(scenario)


def test_the_source_names_nothing_but_the_aircraft() -> None:
    assert adapter("aircraft", AdapterOptions()).capabilities.system == "aircraft"
    with pytest.raises(ValueError, match="only one aircraft"):
        adapter("aircraft://boeing", AdapterOptions())
