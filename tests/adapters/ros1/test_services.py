"""Services of a real ROS 1: called, refused in the node's words, hanging, vanishing, and with a discovered type."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.model import (
    Encoding,
    Kind,
    Operation,
    Ref,
    Refused,
    Sent,
    ServiceSchema,
    TypeRef,
    Unreachable,
)
from tests.adapters.ros1.conftest import opened
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session

pytestmark = pytest.mark.slow

TRIGGER = TypeRef("std_srvs/srv/Trigger", "937c9679a518e3a18d831e57125ea522")


@pytest.fixture(scope="module")
def node(ros: RosSystem) -> RosSystem:
    """The system with a node whose services fail in every way."""
    ros.node("services_node.py")
    return ros


async def call(session: Session, service: str, **values: Any) -> Any:
    """Return the decoded response of a service called with these values."""
    ref = await session.until(lambda: session.graph.services[service].type, f"the type of {service}")
    schema = await session.schema(ref)
    assert isinstance(schema, ServiceSchema)
    request = schema.request.codec.build(schema.request.ref.name, values)
    data = schema.request.codec.encode(request, Encoding.ROS1)
    answer = await session.call(service, ref, data)
    return schema.response.codec.decode(answer, Encoding.ROS1)


async def test_services_are_typed_by_asking_and_called(node: RosSystem) -> None:
    async with opened(node) as session:
        await session.until(lambda: all(each.type for each in session.graph.services.values()), "all types")
        service = session.graph.services["/works"]
        assert (service.type, service.uncallable, service.providers) == (TRIGGER, None, ("/services_node",))
        assert session.adapter.allows(Ref(Kind.SERVICE, "/works")) == {Operation.CALL}
        loggers = session.graph.services["/services_node/get_loggers"].type
        assert loggers is not None
        assert loggers.name == "roscpp/srv/GetLoggers"
        answer = await call(session, "/echoes", data=True)
        assert (answer.success, answer.message) == (True, "you said True")
        empty = session.graph.services["/does_nothing"].type
        assert empty is not None
        assert await session.call("/does_nothing", empty, b"") == b""


async def test_a_service_of_another_md5_is_refused_and_not_called(node: RosSystem) -> None:
    async with opened(node) as session:
        with pytest.raises(Refused) as caught:
            await session.call("/works", TypeRef(TRIGGER.name, "0" * 32), b"")
        assert caught.value.sent is Sent.NO
        assert "md5sum" in (caught.value.words or "")


async def test_a_node_that_dies_while_called_may_have_done_it(lone_ros: RosSystem) -> None:
    lone_ros.node("services_node.py")
    async with opened(lone_ros) as session:
        with pytest.raises(Unreachable) as caught:
            await session.call("/vanishes", TRIGGER, b"")
        assert caught.value.sent is Sent.MAYBE
        with pytest.raises(Unreachable) as again:
            await session.call("/works", TRIGGER, b"")
        assert again.value.sent is Sent.NO


def test_a_service_without_a_definition_is_listed_and_says_what_to_do(ros: RosSystem, tmp_path: Path) -> None:
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
