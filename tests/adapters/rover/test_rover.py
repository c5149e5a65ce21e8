"""The rover as an adapter, beyond the contract suite."""

from __future__ import annotations

import io
from contextlib import AbstractAsyncContextManager
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rosld.adapters.base import AdapterOptions
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
from rosld.adapters.model.plain import message_of
from rosld.adapters.rover import rover_adapter
from rosld.adapters.rover.graph import CMD_VEL, LATCHED, PERIODIC
from rosld.adapters.rover.messages import HEIGHT, WIDTH, pose_stamped
from rosld.adapters.rover.navigation import Pose
from rosld.adapters.rover.simulation import read_source
from tests.adapters.session import Session, opened_on


def live() -> AbstractAsyncContextManager[Session]:
    """Open a rover."""
    return opened_on(rover_adapter("rover", AdapterOptions()))


async def said(session: Session, topic: str) -> Any:
    """Return a decoded message of a topic."""
    (sample,) = (await session.adapter.subscribe(topic)).latest()
    return await session.decoded(sample)


async def test_the_first_who_looks_sees_a_message_at_once_on_every_topic_that_it_publishes() -> None:
    async with live() as session:
        for topic in (*PERIODIC, *LATCHED):
            subscription = await session.adapter.subscribe(topic)
            (sample,) = subscription.latest()
            assert sample.latched == (topic in LATCHED)
            schema = await session.schema(sample.schema)
            assert isinstance(schema, MessageSchema)
            assert schema.codec.encode(schema.codec.decode(sample.data, Encoding.CDR), Encoding.CDR) == sample.data


@pytest.mark.slow
async def test_nothing_is_said_on_a_topic_while_nobody_looks() -> None:
    async with live() as session:
        seen = await session.adapter.subscribe("/scan")
        assert seen.latest()[-1].sequence == 1
        seen.close()
        await session.first(await session.adapter.subscribe("/odom", depth=20), 20)
        assert (await session.adapter.subscribe("/scan")).latest()[-1].sequence == 2


async def test_the_file_of_an_image_holds_the_raw_image() -> None:
    async with live() as session:
        raw, file = await said(session, "/camera/image_raw"), await said(session, "/camera/image_raw/compressed")
        with Image.open(io.BytesIO(bytes(file.data))) as image:
            assert (image.format, image.mode, image.size) == ("PNG", "RGB", (WIDTH, HEIGHT))
            assert image.tobytes() == bytes(raw.data)


async def test_the_image_is_brighter_with_the_lights_on() -> None:
    async with live() as session:
        dark = np.mean((await said(session, "/camera/image_raw")).data)
        schema = await session.schema(TypeRef("std_srvs/srv/SetBool"))
        request = schema.request.codec.encode(message_of(schema.request, {"data": True}), Encoding.CDR)
        await session.call("/set_lights", schema.ref, request)
        subscription = await session.adapter.subscribe("/camera/image_raw")
        before = subscription.latest()
        await session.until(lambda: subscription.latest() is not before)
        assert np.mean((await session.decoded(subscription.latest()[-1])).data) > dark


async def test_parameters_are_declared_with_their_types_ranges_and_words() -> None:
    async with live() as session:
        declared = {name: each.descriptor for name, each in session.graph.parameters.items()}
        assert declared["/rover/max_speed"].range == Range(0.1, 1.0)
        assert declared["/rover/scan_rate"].type is ParameterType.INTEGER
        assert [choice.value for choice in declared["/rover/drive_mode"].choices] == ["eco", "normal", "sport"]
        assert declared["/rover/wheel_separation"].read_only
        allowed = session.adapter.allows(Ref(Kind.PARAMETER, "/rover/wheel_separation"))
        assert allowed == {Operation.GET_PARAMETER}
        assert session.adapter.allows(Ref(Kind.PARAMETER, "/rover/colour")) == frozenset()


async def test_parameters_take_what_they_declare_and_of_several_none_where_one_is_refused() -> None:
    async with live() as session:
        for bad in ({"/rover/scan_rate": 99}, {"/rover/colour": "red"}, {"/rover/wheel_separation": 1.0}):
            with pytest.raises(Refused):
                await session.set_parameters({"/rover/robot_name": "Robby", **bad})
        with pytest.raises(NotFound):
            await session.set_parameters({"/elsewhere/x": 1})
        with pytest.raises(Refused, match="declared by its node"):
            await session.delete_parameters(["/rover/max_speed"])
        await session.set_parameters({"/rover/max_speed": 1})
        assert session.events.parameters == ["/rover/max_speed"]
        values = await session.get_parameters(["/rover/max_speed", "/rover", "/"])
        assert repr(values["/rover/max_speed"]) == "1.0", "a whole number is a double, too"
        assert values["/"] == {"rover": values["/rover"]}
        assert values["/rover"]["robot_name"] == "Rover"


async def test_a_velocity_that_cannot_be_read_is_refused_and_not_published() -> None:
    async with live() as session:
        type = session.graph.topics[CMD_VEL].types[0]
        for kind, data in ((type, b"\0\1\0\0\1"), (TypeRef("std_msgs/msg/String"), b"")):
            with pytest.raises(Refused):
                await session.publish(CMD_VEL, kind, data)
        assert CMD_VEL in session.graph.topics
        assert session.graph.own_node not in session.graph.nodes


async def test_a_goal_that_is_pursued_is_lost_when_the_rover_ends() -> None:
    async with live() as session:
        schema = await session.schema(TypeRef("rosld_rover/action/NavigateTo"))
        pose = await goal(session, 4.4, -3.4)
        await session.adapter.send_goal("/navigate_to", schema.ref, pose, deadline=session.deadline())
    assert session.events.goals[-1][1].status is GoalStatus.LOST


async def goal(session: Session, x: float, y: float) -> bytes:
    """Return the bytes of a goal."""
    schema = await session.schema(TypeRef("rosld_rover/action/NavigateTo"))
    pose = pose_stamped(Pose(x, y, 0.0), 0)
    return schema.goal.codec.encode(message_of(schema.goal, {"pose": pose}), Encoding.CDR)


async def test_what_happens_is_told_in_the_log() -> None:
    async with live() as session:
        subscription = await session.adapter.subscribe("/rosout", depth=5)
        schema = await session.schema(TypeRef("rosld_rover/action/NavigateTo"))
        await session.adapter.send_goal(
            "/navigate_to", schema.ref, await goal(session, 30.0, 0.0), deadline=session.deadline()
        )
        lines = [await session.decoded(sample) for sample in await session.first(subscription, 2)]
        assert lines[0].msg == "navigating to (30, 0)"
        assert "outside the map" in lines[1].msg
        assert [line.level for line in lines] == [20, 40]


def test_a_source_says_how_it_begins_and_a_wrong_one_is_refused_in_a_sentence() -> None:
    start = read_source("rover:?battery=0.21&pose=1,0,1.57&rate=10")
    assert (start.battery, start.pose.x, start.pose.heading, start.rate) == (0.21, 1.0, 1.57, 10.0)
    assert read_source("rover") == read_source("rover:") == read_source("rover:?")
    for source, words in (
        ("rover:moon", "is not a rover"),
        ("rover:?colour=red", "'colour'"),
        ("rover:?battery=2", "battery='2'"),
        ("rover:?battery=nan", "battery='nan'"),
        ("rover:?rate=0", "rate='0'"),
        ("rover:?pose=1,2", "pose='1,2'"),
        ("rover:?pose=4.95,0,0", "cannot start"),
        ("rover:?battery=1&battery=1", "twice"),
        ("rover:?battery", "cannot be read"),
    ):
        with pytest.raises(ValueError, match=words):
            rover_adapter(source, AdapterOptions())
