"""The rover as an adapter: what the contract suite does not say of it."""

from __future__ import annotations

import asyncio
import struct
import zlib
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from rosld.adapters.base import Adapter, AdapterOptions
from rosld.adapters.model import (
    Encoding,
    GoalStatus,
    Kind,
    MessageSchema,
    NotFound,
    Operation,
    ParameterType,
    Range,
    Ref,
    Refused,
    TypeRef,
)
from rosld.adapters.rover import camera, rover_adapter
from rosld.adapters.rover.encoder import encode
from rosld.adapters.rover.messages import pose_stamped
from rosld.adapters.rover.navigation import Pose
from rosld.adapters.rover.source import read_source
from rosld.adapters.rover.topics import CMD_VEL, LATCHED, PERIODIC
from tests.adapters.session import Session, Told


def live(scenario: Callable[[Session], Awaitable[None]], source: str = "rover") -> None:
    """Run a scenario with an open rover."""

    async def session() -> None:
        opened: Adapter = rover_adapter(source, AdapterOptions())
        told = Told()
        await opened.open(told, deadline=asyncio.get_running_loop().time() + 5)
        try:
            await asyncio.wait_for(scenario(Session(opened, told)), 120)
        finally:
            await opened.close()

    asyncio.run(session())


async def said(session: Session, topic: str) -> Any:
    """A message of a topic, decoded."""
    (sample,) = (await session.adapter.subscribe(topic)).latest()
    return await session.decoded(sample)


def test_the_first_who_looks_sees_a_message_at_once_on_every_topic_that_it_publishes() -> None:
    async def scenario(session: Session) -> None:
        for topic in (*PERIODIC, *LATCHED):
            subscription = await session.adapter.subscribe(topic)
            (sample,) = subscription.latest()
            assert sample.latched == (topic in LATCHED)
            schema = await session.adapter.schema(sample.schema, deadline=session.deadline())
            assert isinstance(schema, MessageSchema)
            assert schema.codec.encode(schema.codec.decode(sample.data, Encoding.CDR), Encoding.CDR) == sample.data

    live(scenario)


def test_nothing_is_said_on_a_topic_while_nobody_looks() -> None:
    async def scenario(session: Session) -> None:
        seen = await session.adapter.subscribe("/scan")
        assert seen.latest()[-1].sequence == 1
        seen.close()
        await session.first(await session.adapter.subscribe("/odom", depth=20), 20)
        assert (await session.adapter.subscribe("/scan")).latest()[-1].sequence == 2

    live(scenario)


def test_the_file_of_an_image_holds_the_raw_image() -> None:
    async def scenario(session: Session) -> None:
        raw, file = await said(session, "/camera/image_raw"), await said(session, "/camera/image_raw/compressed")
        data = bytes(file.data)
        chunks, at = {}, 8
        while at < len(data):
            (size,) = struct.unpack_from(">I", data, at)
            kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + size]
            assert struct.unpack_from(">I", data, at + 8 + size) == (zlib.crc32(kind + body),)
            chunks[kind], at = body, at + 12 + size
        assert chunks[b"IHDR"] == struct.pack(">IIBBBBB", camera.WIDTH, camera.HEIGHT, 8, 2, 0, 0, 0)
        lines = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(camera.HEIGHT, -1)
        assert not lines[:, 0].any()
        assert lines[:, 1:].tobytes() == bytes(raw.data)

    live(scenario)


def test_the_image_is_brighter_with_the_lights_on() -> None:
    async def scenario(session: Session) -> None:
        dark = np.mean((await said(session, "/camera/image_raw")).data)
        schema = await session.adapter.schema(TypeRef("std_srvs/srv/SetBool"), deadline=session.deadline())
        request = encode(schema.request, {"data": True})
        await session.adapter.call("/set_lights", schema.ref, request, deadline=session.deadline())
        subscription = await session.adapter.subscribe("/camera/image_raw")
        before = subscription.latest()
        await session.until(lambda: subscription.latest() is not before)
        assert np.mean((await session.decoded(subscription.latest()[-1])).data) > dark

    live(scenario)


def test_parameters_are_declared_with_their_types_ranges_and_words() -> None:
    async def scenario(session: Session) -> None:
        declared = {name: each.descriptor for name, each in session.graph.parameters.items()}
        assert declared["/rover/max_speed"].range == Range(0.1, 1.0)
        assert declared["/rover/scan_rate"].type is ParameterType.INTEGER
        assert [choice.value for choice in declared["/rover/drive_mode"].choices] == ["eco", "normal", "sport"]
        assert declared["/rover/wheel_separation"].read_only
        allowed = session.adapter.allows(Ref(Kind.PARAMETER, "/rover/wheel_separation"))
        assert allowed == {Operation.GET_PARAMETER}
        assert session.adapter.allows(Ref(Kind.PARAMETER, "/rover/colour")) == frozenset()

    live(scenario)


def test_a_parameter_takes_effect_and_whole_numbers_are_doubles_too() -> None:
    async def scenario(session: Session) -> None:
        await session.adapter.set_parameters({"/rover/max_speed": 1}, deadline=session.deadline())
        values = await session.adapter.get_parameters(["/rover/max_speed", "/rover", "/"], deadline=session.deadline())
        assert repr(values["/rover/max_speed"]) == "1.0"
        assert values["/"] == {"rover": values["/rover"]}
        assert session.told.parameters == ["/rover/max_speed"]
        type = session.graph.topics[CMD_VEL].types[0]
        schema = await session.adapter.schema(type, deadline=session.deadline())
        twist = {"linear": {"x": 9.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
        await session.adapter.publish(CMD_VEL, type, encode(schema, twist), deadline=session.deadline())
        odometry = await session.adapter.subscribe("/odom")
        while (await session.decoded(odometry.latest()[-1])).twist.twist.linear.x < 1.0:
            before = odometry.latest()
            await session.until(lambda seen=before: odometry.latest() is not seen)

    live(scenario)


def test_of_several_parameters_none_is_set_where_one_is_refused() -> None:
    async def scenario(session: Session) -> None:
        for bad in ({"/rover/scan_rate": 99}, {"/rover/colour": "red"}, {"/rover/wheel_separation": 1.0}):
            with pytest.raises(Refused):
                await session.adapter.set_parameters({"/rover/robot_name": "Robby", **bad}, deadline=session.deadline())
        with pytest.raises(NotFound):
            await session.adapter.set_parameters({"/elsewhere/x": 1}, deadline=session.deadline())
        with pytest.raises(Refused, match="declared by its node"):
            await session.adapter.delete_parameters(["/rover/max_speed"], deadline=session.deadline())
        found = await session.adapter.get_parameters(["/rover/robot_name"], deadline=session.deadline())
        assert found == {"/rover/robot_name": "Rover"}

    live(scenario)


def test_a_velocity_that_cannot_be_read_is_refused_and_not_published() -> None:
    async def scenario(session: Session) -> None:
        type = session.graph.topics[CMD_VEL].types[0]
        for kind, data in ((type, b"\0\1\0\0\1"), (TypeRef("std_msgs/msg/String"), b"")):
            with pytest.raises(Refused):
                await session.adapter.publish(CMD_VEL, kind, data, deadline=session.deadline())
        assert CMD_VEL in session.graph.topics
        assert session.graph.own_node not in session.graph.nodes

    live(scenario)


def test_a_goal_that_is_pursued_is_lost_when_the_rover_ends() -> None:
    told: list[Told] = []

    async def scenario(session: Session) -> None:
        told.append(session.told)
        schema = await session.adapter.schema(TypeRef("rosld_rover/action/NavigateTo"), deadline=session.deadline())
        pose = await goal(session, 4.4, -3.4)
        await session.adapter.send_goal("/navigate_to", schema.ref, pose, deadline=session.deadline())

    live(scenario)
    assert told[0].goals[-1][1].status is GoalStatus.LOST


async def goal(session: Session, x: float, y: float) -> bytes:
    """The bytes of a goal."""
    schema = await session.adapter.schema(TypeRef("rosld_rover/action/NavigateTo"), deadline=session.deadline())
    return encode(schema.goal, {"pose": pose_stamped(Pose(x, y, 0.0), 0)})


def test_what_happens_is_told_in_the_log() -> None:
    async def scenario(session: Session) -> None:
        subscription = await session.adapter.subscribe("/rosout", depth=5)
        schema = await session.adapter.schema(TypeRef("rosld_rover/action/NavigateTo"), deadline=session.deadline())
        await session.adapter.send_goal(
            "/navigate_to", schema.ref, await goal(session, 30.0, 0.0), deadline=session.deadline()
        )
        lines = [await session.decoded(sample) for sample in await session.first(subscription, 2)]
        assert lines[0].msg == "navigating to (30, 0)"
        assert "outside the map" in lines[1].msg
        assert [line.level for line in lines] == [20, 40]

    live(scenario)


def test_a_source_says_how_it_begins() -> None:
    start = read_source("rover:?battery=0.21&pose=1,0,1.57&rate=10")
    assert (start.battery, start.pose.x, start.pose.heading, start.rate) == (0.21, 1.0, 1.57, 10.0)
    assert read_source("rover") == read_source("rover:") == read_source("rover:?")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("rover:moon", "names no rover"),
        ("rover:?colour=red", "'colour'"),
        ("rover:?battery=2", "battery='2'"),
        ("rover:?battery=nan", "battery='nan'"),
        ("rover:?rate=0", "rate='0'"),
        ("rover:?pose=1,2", "pose='1,2'"),
        ("rover:?pose=4.95,0,0", "cannot start"),
        ("rover:?battery=1&battery=1", "twice"),
        ("rover:?battery", "cannot be read"),
    ],
)
def test_a_source_that_is_wrong_is_refused_in_a_sentence(source: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        rover_adapter(source, AdapterOptions())
