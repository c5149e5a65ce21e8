"""Services of a real ROS 1: called, refused with the node's words, hanging, vanishing, and typed by asking."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.model import (
    Encoding,
    Kind,
    NotFound,
    Operation,
    Ref,
    Refused,
    Sent,
    ServiceSchema,
    TimedOut,
    TypeRef,
    Unreachable,
)
from tests.adapters.ros1.conftest import Opening
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session
from tests.processes import Process

TRIGGER = TypeRef("std_srvs/srv/Trigger", "937c9679a518e3a18d831e57125ea522")


@pytest.fixture(scope="module")
def node(ros: RosSystem) -> Iterator[Process]:
    """The node with services that fail in every way."""
    running = ros.node("services_node.py")
    yield running
    running.stop()


async def call(session: Session, service: str, **values: Any) -> Any:
    """The decoded response of a service called with these values."""
    ref = await session.until(lambda: session.graph.services[service].type, f"the type of {service}")
    schema = await session.adapter.schema(ref, deadline=session.deadline())
    assert isinstance(schema, ServiceSchema)
    request = schema.request.codec.build(schema.request.ref.name, values)
    data = schema.request.codec.encode(request, Encoding.ROS1)
    answer = await session.adapter.call(service, ref, data, deadline=session.deadline())
    return schema.response.codec.decode(answer, Encoding.ROS1)


@pytest.mark.usefixtures("node")
def test_a_call_returns_the_nodes_answer(ros: RosSystem, opened: Opening) -> None:
    async def ask() -> None:
        async with opened(ros) as session:
            answer = await call(session, "/echoes", data=True)
            assert (answer.success, answer.message) == (True, "you said True")
            assert (await call(session, "/works")).message == "done"
            empty = session.graph.services["/does_nothing"].type
            assert empty is not None
            assert await session.adapter.call("/does_nothing", empty, b"", deadline=session.deadline()) == b""

    asyncio.run(ask())


@pytest.mark.usefixtures("node")
def test_types_are_learnt_by_asking_and_proved_by_their_md5(ros: RosSystem, opened: Opening) -> None:
    async def look() -> None:
        async with opened(ros) as session:
            await session.until(lambda: all(each.type for each in session.graph.services.values()), "all types")
            service = session.graph.services["/works"]
            assert service.type == TRIGGER
            assert service.uncallable is None
            assert service.providers == ("/services_node",)
            assert session.adapter.allows(Ref(Kind.SERVICE, "/works")) == {Operation.CALL}
            loggers = session.graph.services["/services_node/get_loggers"]
            assert loggers.type is not None
            assert loggers.type.name == "roscpp/srv/GetLoggers"

    asyncio.run(look())


@pytest.mark.usefixtures("node")
@pytest.mark.parametrize(
    ("service", "words"),
    [
        ("/raises", "error processing request: the gripper is jammed"),
        ("/refuses", "service cannot process request: not today"),
    ],
)
def test_a_node_that_raises_refuses_with_its_words(ros: RosSystem, opened: Opening, service: str, words: str) -> None:
    async def ask() -> None:
        async with opened(ros) as session:
            with pytest.raises(Refused) as caught:
                await session.adapter.call(service, TRIGGER, b"", deadline=session.deadline())
            assert caught.value.words == words
            assert caught.value.sent is Sent.YES

    asyncio.run(ask())


def test_a_node_that_hangs_times_out_and_holds_up_nobody(ros: RosSystem, opened: Opening, node: Process) -> None:
    async def ask() -> None:
        async with opened(ros) as session:
            hanging = asyncio.ensure_future(
                session.adapter.call("/hangs", TRIGGER, b"", deadline=session.deadline(1.0))
            )
            await asyncio.to_thread(node.line, "hanging")
            await session.adapter.call("/works", TRIGGER, b"", deadline=session.deadline())
            assert not hanging.done()
            with pytest.raises(TimedOut) as caught:
                await hanging
            assert caught.value.sent is Sent.YES

    asyncio.run(ask())


def test_a_cancelled_call_stops_waiting_only(ros: RosSystem, opened: Opening, node: Process) -> None:
    async def ask() -> None:
        async with opened(ros) as session:
            hanging = asyncio.ensure_future(session.adapter.call("/hangs", TRIGGER, b"", deadline=session.deadline(30)))
            await asyncio.to_thread(node.line, "hanging")
            hanging.cancel()
            with pytest.raises(asyncio.CancelledError):
                await hanging
            await session.adapter.call("/works", TRIGGER, b"", deadline=session.deadline())

    asyncio.run(ask())


@pytest.mark.usefixtures("node")
def test_a_wrong_md5_is_refused_before_anything_is_done(ros: RosSystem, opened: Opening) -> None:
    async def ask() -> None:
        async with opened(ros) as session:
            with pytest.raises(Refused) as caught:
                await session.adapter.call("/works", TypeRef(TRIGGER.name, "0" * 32), b"", deadline=session.deadline())
            assert caught.value.sent is Sent.NO
            assert "md5sum" in (caught.value.words or "")

    asyncio.run(ask())


def test_a_service_that_is_not_there_is_not_found(ros: RosSystem, opened: Opening) -> None:
    async def ask() -> None:
        async with opened(ros) as session:
            with pytest.raises(NotFound, match="/nowhere"):
                await session.adapter.call("/nowhere", TRIGGER, b"", deadline=session.deadline())

    asyncio.run(ask())


def test_a_node_that_dies_while_called_may_have_done_it(lone_ros: RosSystem, opened: Opening) -> None:
    lone_ros.node("services_node.py")

    async def ask() -> None:
        async with opened(lone_ros) as session:
            with pytest.raises(Unreachable) as caught:
                await session.adapter.call("/vanishes", TRIGGER, b"", deadline=session.deadline())
            assert caught.value.sent is Sent.MAYBE
            with pytest.raises(Unreachable) as again:
                await session.adapter.call("/works", TRIGGER, b"", deadline=session.deadline())
            assert again.value.sent is Sent.NO

    asyncio.run(ask())


def test_a_service_without_a_definition_is_listed_and_says_what_to_do(
    ros: RosSystem, opened: Opening, tmp_path: Path
) -> None:
    package = tmp_path / "made_up_msgs" / "srv"
    package.mkdir(parents=True)
    (package / "Fold.srv").write_text("float64 angle\n---\nbool folded\n")
    running = ros.node("made_up_service_node.py", str(tmp_path / "classes"), str(package / "Fold.srv"))

    async def without() -> None:
        async with opened(ros) as session:
            words = await session.until(
                lambda: session.graph.services["/fold"].type and session.graph.services["/fold"].uncallable, "words"
            )
            assert "--types" in words
            assert session.adapter.allows(Ref(Kind.SERVICE, "/fold")) == frozenset()

    async def given() -> None:
        async with opened(ros, types=(tmp_path,)) as session:
            assert (await call(session, "/fold", angle=0.5)).folded is True
            assert session.graph.services["/fold"].uncallable is None

    asyncio.run(without())
    asyncio.run(given())
    running.stop()


def test_the_aircraft_in_rospy_behaves_as_the_paper_has_it(ros: RosSystem, opened: Opening, tmp_path: Path) -> None:
    aircraft = ros.node("aircraft_node.py", str(tmp_path))
    cockpit = ros.node("cockpit_node.py")

    async def fly() -> None:
        async with opened(ros) as session:
            assert (await call(session, "/aircraft/get_power")).data == "off"
            refused = await call(session, "/aircraft/engine/set_speed", data=100.0)
            assert refused.success is False
            assert "off" in refused.message
            assert (await call(session, "/aircraft/set_power", data="on")).success
            assert (await call(session, "/aircraft/get_power")).data == "on"
            for value in (1000.5, -1.0, float("nan"), float("inf")):
                assert not (await call(session, "/aircraft/engine/set_speed", data=value)).success
            assert (await call(session, "/aircraft/engine/set_direction", data=90.0)).success
            assert (await call(session, "/aircraft/engine/get_direction")).data == 90.0
            subscription = await session.adapter.subscribe("/aircraft/engine/speed")
            assert (await call(session, "/aircraft/engine/set_speed", data=50.0)).success
            assert not (await call(session, "/aircraft/stop")).success or not subscription.latest()
            await session.first(subscription)
            schema = await session.adapter.schema(subscription.latest()[0].schema, deadline=session.deadline())

            def speed() -> float:
                return float(schema.codec.decode(subscription.latest()[0].data, Encoding.ROS1).data)  # type: ignore

            await session.until(lambda: speed() == 50.0, "the commanded speed, exactly")
            assert not (await call(session, "/aircraft/set_power", data="off")).success
            assert (await call(session, "/aircraft/engine/set_speed", data=0.0)).success
            await session.until(lambda: speed() == 0.0, "rest")
            assert (await call(session, "/aircraft/stop")).success
            display = TypeRef("std_msgs/msg/String")
            await session.adapter.publish("/cockpit/display", display, b"\2\0\0\0hi", deadline=session.deadline())
            assert await asyncio.to_thread(cockpit.line, "display") == "display hi"

    asyncio.run(fly())
    aircraft.stop()
    cockpit.stop()
