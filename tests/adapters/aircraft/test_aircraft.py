"""The aircraft as an adapter, beyond the contract suite."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise

import pytest

from rosld.adapters.aircraft import adapter
from rosld.adapters.aircraft.adapter import Aircraft
from rosld.adapters.base import AdapterOptions, NullSink
from rosld.adapters.model import (
    Encoding,
    MessageSchema,
    Refused,
    Sample,
    ServiceSchema,
    TypeRef,
)

SPEED = "/aircraft/engine/speed"


@asynccontextmanager
async def fly() -> AsyncIterator[Aircraft]:
    """Open an aircraft."""
    aircraft = Aircraft(AdapterOptions())
    await aircraft.open(NullSink(), deadline=soon())
    try:
        yield aircraft
    finally:
        await aircraft.close()


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


async def test_the_speed_comes_ten_times_a_second_also_while_off_and_reaches_what_is_commanded() -> None:
    async with fly() as aircraft:
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


async def test_a_busy_loop_leaves_messages_out_but_does_not_fall_behind() -> None:
    async with fly() as aircraft:
        subscription = await aircraft.subscribe(SPEED, depth=50)
        time.sleep(1.05)  # noqa: ASYNC251 the loop is what is to be kept busy
        await asyncio.sleep(0.02)
        assert 2 <= len(subscription.latest()) < 6, "of the ten that would have been sent meanwhile most are left out"


async def test_what_does_not_fit_a_service_or_a_topic_is_refused() -> None:
    async with fly() as aircraft:
        number, trigger = TypeRef("rosld_aircraft/srv/SetNumber"), TypeRef("std_srvs/srv/Trigger", "0" * 32)
        for request in (b"", b"\xff" * 3, b"\0" * 9):
            with pytest.raises(Refused) as caught:
                await aircraft.call("/aircraft/engine/set_speed", number, request, deadline=soon())
            assert caught.value.words
        with pytest.raises(Refused, match="is a std_srvs/srv/Trigger"):
            await aircraft.call("/aircraft/start", TypeRef("std_srvs/srv/SetBool"), b"\1", deadline=soon())
        with pytest.raises(Refused):
            await aircraft.call("/aircraft/start", trigger, b"", deadline=soon())
        ref, data = await text(aircraft, "fast")
        with pytest.raises(Refused, match=r"carries std_msgs/msg/Float64, not this std_msgs/msg/String"):
            await aircraft.publish(SPEED, ref, data, deadline=soon())
        with pytest.raises(Refused, match="is not a message type"):
            await aircraft.publish("/x", TypeRef("std_srvs/srv/Trigger"), b"", deadline=soon())


def test_the_source_names_nothing_but_the_aircraft() -> None:
    assert adapter("aircraft", AdapterOptions()).capabilities.system == "aircraft"
    with pytest.raises(ValueError, match="only one aircraft"):
        adapter("aircraft://boeing", AdapterOptions())
