"""Services of a real ROS 2 system: concurrent, hanging and vanishing."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rosld.adapters.model import NotFound, Refused, Sent, TimedOut, TypeRef, Unreachable
from tests.adapters.ros2.conftest import opened

pytestmark = pytest.mark.slow


async def test_a_hundred_services_are_called_at_once_while_one_hangs(lone_ros: Any) -> None:
    lone_ros.node("robot.py", "100")
    async with opened(lone_ros) as session:
        names = [f"/many/service_{number}" for number in range(100)]
        await session.until(lambda: all(name in session.graph.services for name in names))
        hanging = asyncio.create_task(session.trigger("/hangs", 3.0))
        for _ in range(2):
            answers = await asyncio.gather(*(session.trigger(name, 60.0) for name in names))
            assert answers == ["off"] * 100
        with pytest.raises(TimedOut) as late:
            await hanging
        assert late.value.sent is Sent.MAYBE
        for type, data in (("std_srvs/srv/Trigger", b"\0\1\0\0\0"), ("std_srvs/srv/SetBool", b"")):
            with pytest.raises(Refused, match="/set_power") as caught:
                await session.call("/set_power", TypeRef(type), data, seconds=2)
            assert caught.value.sent is Sent.NO


async def test_a_server_that_goes_away_while_it_is_waited_for_is_unreachable_and_may_have_acted(lone_ros: Any) -> None:
    robot = lone_ros.node("robot.py")
    async with opened(lone_ros) as session:
        await session.until(lambda: "/hangs" in session.graph.services)
        assert await session.trigger("/get_power") == "off"
        hanging = asyncio.create_task(session.trigger("/hangs", 40.0))
        await asyncio.sleep(0.3)
        robot.kill()
        with pytest.raises(Unreachable) as caught:  # and not TimedOut, as it would be in the end
            await hanging
        assert caught.value.sent is Sent.MAYBE
        await session.until(lambda: session.graph.state.__class__.__name__ == "Stale")
        with pytest.raises((Unreachable, TimedOut, NotFound)) as again:
            await session.trigger("/get_power", 0.5)
        assert again.value.sent is Sent.NO
        lone_ros.node("robot.py")
        await session.until(lambda: session.graph.state.__class__.__name__ == "Live")
        await session.until(lambda: "/get_power" in session.graph.services)
        assert await session.trigger("/get_power") == "off"
