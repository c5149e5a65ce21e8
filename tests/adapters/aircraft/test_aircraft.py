"""The aircraft as an adapter, beyond the contract suite."""

from __future__ import annotations

import asyncio
import time
from contextlib import AbstractAsyncContextManager

import pytest

from rosld.adapters.aircraft import adapter
from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Encoding, Refused, TypeRef
from tests.adapters.session import Session, opened_on

SPEED = "/aircraft/engine/speed"


def fly() -> AbstractAsyncContextManager[Session]:
    """Open an aircraft."""
    return opened_on(adapter("aircraft", AdapterOptions()))


@pytest.mark.slow
async def test_a_busy_loop_leaves_messages_out_but_does_not_fall_behind() -> None:
    async with fly() as session:
        subscription = await session.adapter.subscribe(SPEED, depth=50)
        time.sleep(1.05)  # noqa: ASYNC251 the loop is what is to be kept busy
        await asyncio.sleep(0.02)
        assert 2 <= len(subscription.latest()) < 6, "of the ten that would have been sent meanwhile most are left out"


async def test_what_does_not_fit_a_service_or_a_topic_is_refused() -> None:
    async with fly() as session:
        number, trigger = TypeRef("rosld_aircraft/srv/SetNumber"), TypeRef("std_srvs/srv/Trigger", "0" * 32)
        for request in (b"", b"\xff" * 3, b"\0" * 9):
            with pytest.raises(Refused) as caught:
                await session.call("/aircraft/engine/set_speed", number, request)
            assert caught.value.words
        with pytest.raises(Refused, match="is a std_srvs/srv/Trigger"):
            await session.call("/aircraft/start", TypeRef("std_srvs/srv/SetBool"), b"\1")
        with pytest.raises(Refused):
            await session.call("/aircraft/start", trigger, b"")
        schema = await session.schema(TypeRef("std_msgs/msg/String"))
        data = schema.codec.encode(schema.codec.build(schema.ref.name, {"data": "fast"}), Encoding.ROS1)
        with pytest.raises(Refused, match=r"carries std_msgs/msg/Float64, not this std_msgs/msg/String"):
            await session.publish(SPEED, schema.ref, data)
        with pytest.raises(Refused, match="is not a message type"):
            await session.publish("/x", TypeRef("std_srvs/srv/Trigger"), b"")


def test_the_source_names_nothing_but_the_aircraft() -> None:
    assert adapter("aircraft", AdapterOptions()).capabilities.system == "aircraft"
    with pytest.raises(ValueError, match="only one aircraft"):
        adapter("aircraft://boeing", AdapterOptions())
