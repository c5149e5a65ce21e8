"""rosbridge: what is special about a robot behind a bridge; the contract suite tests the rest."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from rosld.adapters.aircraft import adapter as aircraft
from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Encoding, MessageSchema, Stale, TypeRef, UnknownType
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.model.plain import message_of, plain_of
from rosld.adapters.rosbridge import adapter
from rosld.adapters.rosbridge.protocol import decode_message, definition_of
from rosld.adapters.rover import rover_adapter
from tests.adapters.rosbridge.bridge import Bridge, cbor
from tests.adapters.session import Session, opened_on


@asynccontextmanager
async def opened(bridge: Bridge, query: str = "") -> AsyncIterator[Session]:
    """Run the bridge and open an adapter."""
    bridge.start()
    try:
        async with opened_on(adapter(bridge.source + query, AdapterOptions())) as session:
            yield session
    finally:
        bridge.stop()


def rover(*, raw: bool = True) -> Bridge:
    return Bridge(lambda: rover_adapter("rover", AdapterOptions()), raw=raw)


async def test_the_version_of_ros_is_the_bridges() -> None:
    async with opened(Bridge(lambda: aircraft("aircraft", AdapterOptions()))) as session:
        can = session.adapter.capabilities
        assert (can.system, can.encoding) == ("ROS 1", Encoding.ROS1)
        assert "/aircraft/engine/speed" in session.graph.topics
    async with opened(rover()) as session:
        can = session.adapter.capabilities
        assert (can.system, can.encoding) == ("ROS 2", Encoding.CDR)
    async with opened(rover(), "?ros=1") as session:
        assert isinstance(session.graph.state, Stale)
        assert "?ros=2" in session.graph.state.why


async def test_what_rosld_publishes_is_not_received_again_from_the_bridge() -> None:
    async with opened(rover()) as session:
        schema = await session.schema(TypeRef("geometry_msgs/msg/Twist"))
        data = schema.codec.encode(message_of(schema, {"linear": {"x": 0.125}}), Encoding.CDR)
        subscription = await session.adapter.subscribe("/cmd_vel", depth=10)
        for _ in range(3):
            await session.publish("/cmd_vel", schema.ref, data)
        await asyncio.sleep(0.2)  # the echoes arrive meanwhile
        assert [each.publisher for each in subscription.latest()] == [session.graph.own_node] * 3
        publishers = session.graph.topics["/cmd_vel"].publishers
        assert [each.node for each in publishers] == [session.graph.own_node]


async def test_a_type_that_is_not_known_here_is_described_by_the_bridge() -> None:
    async with opened(rover()) as session:
        schema = await session.schema(TypeRef("odd_msgs/msg/Odd"))
        assert [each.name for each in schema.type.fields] == ["stamp", "names", "pair"]
        with pytest.raises(UnknownType, match="rosapi"):
            await session.schema(TypeRef("no_such_msgs/msg/Thing"))


async def test_a_bridge_without_rosapi_is_stale_and_the_reason_says_what_to_start() -> None:
    bridge = rover()
    bridge.without_rosapi = True
    async with opened(bridge) as session:
        assert isinstance(session.graph.state, Stale)
        assert "rosapi" in session.graph.state.why


def test_an_unknown_version_of_ros_is_refused() -> None:
    with pytest.raises(ValueError, match="ros="):
        adapter("rosbridge://h?ros=3", AdapterOptions())


def test_messages_in_cbor_are_read_and_others_refused() -> None:
    message = {"op": "publish", "msg": {"bytes": b"\xff" * 300, "secs": 70000}, "topic": "/ä"}
    assert decode_message(cbor(message)) == message
    for bad in (
        b"",
        b"\xa1",
        b"\xbf",
        cbor(message)[:-1],
        b"\x81" * 50,
        b"\x9a\xff\xff\xff\xff",
        b"\xf6",
    ):
        with pytest.raises(ValueError, match=r"."):
            decode_message(bad)
    assert math.isnan(decode_message('{"op": "publish", "msg": {"data": NaN}}')["msg"]["data"])


def test_plain_values_become_messages_and_messages_plain_values() -> None:
    library = TypeLibrary(ros_version=1)
    imu = library.find(TypeRef("sensor_msgs/msg/Imu"))
    image = library.find(TypeRef("sensor_msgs/msg/Image"))
    assert isinstance(imu, MessageSchema)
    assert isinstance(image, MessageSchema)
    stamped = message_of(
        imu, {"header": {"stamp": {"secs": 3, "nsecs": 4}}, "linear_acceleration_covariance": [None] * 9}
    )
    plain = plain_of(imu, stamped, ros1=True)
    assert plain["header"]["stamp"] == {"secs": 3, "nsecs": 4}
    assert all(map(math.isnan, plain["linear_acceleration_covariance"]))
    assert plain_of(image, message_of(image, {"data": "AAEC"}), ros1=True)["data"] == "AAEC"
    for values, words in (
        ({"orientation": {"w": "up"}}, "w of geometry_msgs/msg/Quaternion"),
        ({"orientation_covariance": [1.0]}, "exactly 9"),
        ({"speed": 1}, "no field 'speed'"),
    ):
        with pytest.raises(ValueError, match=words):
            message_of(imu, values)


def test_definitions_are_derived_from_rosapis_descriptions() -> None:
    outer = {
        "type": "a/Outer",
        "fieldnames": ["x", "inner"],
        "fieldtypes": ["double", "a/Inner"],
        "fieldarraylen": [0, 3],
    }
    inner = {"type": "a/Inner", "fieldnames": ["on"], "fieldtypes": ["boolean"], "fieldarraylen": [-1]}
    schema = TypeLibrary(ros_version=2).learn_message("a/msg/Outer", definition_of([outer, inner]))
    assert {each.name for each in schema.types.values()} == {"a/msg/Outer", "a/msg/Inner"}
