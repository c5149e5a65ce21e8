"""Nodes of a real ROS 2 system that appear, disappear, and do not answer."""

from __future__ import annotations

import re
import signal
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.model import TimedOut
from tests.adapters.ros2.conftest import opened

pytestmark = pytest.mark.slow


async def test_a_node_that_is_killed_and_started_again_is_missed_and_found_and_counts_from_one(lone_ros: Any) -> None:
    first = lone_ros.node("robot.py")
    lone_ros.node("odd.py", "twin", "bystander")
    async with opened(lone_ros) as session:
        subscription = await session.adapter.subscribe("/counter")
        (before,) = await session.first(subscription)
        await session.until(lambda: subscription.latest()[-1].sequence > 3)
        first.kill()
        await session.until(lambda: "/talker" not in session.graph.nodes)
        assert "/bystander" in session.graph.nodes
        assert "/counter" not in session.graph.topics
        assert subscription.latest()
        lone_ros.node("robot.py")
        await session.until(lambda: "/talker" in session.graph.nodes)
        # A message may be received before the node of its publisher is known.
        await session.until(
            lambda: "/talker" in [each.publisher for each in subscription.latest() if each.epoch > before.epoch],
            "a message of the node that is there again",
        )


async def test_a_node_that_answers_nothing_is_told_as_such_and_holds_up_nobody(lone_ros: Any) -> None:
    lone_ros.node("robot.py")
    lone_ros.node("odd.py", "silent", "silent")
    async with opened(lone_ros) as session:
        node = await session.until(
            lambda: (found := session.graph.nodes.get("/silent")) and found.unreachable and found
        )
        assert "did not answer" in node.unreachable
        assert session.graph.nodes["/listener"].unreachable is None
        await session.until(lambda: "/listener/seats" in session.graph.parameters)
        tree = (await session.get_parameters(["/"], seconds=1))["/"]
        assert tree["listener"]["seats"] == 2
        with pytest.raises(TimedOut):
            await session.get_parameters(["/silent/x"], seconds=0.5)


def mapped() -> set[str]:
    """Return the shared memory files that this process has mapped, except those common to all processes."""
    lines = Path("/proc/self/maps").read_text("ascii").splitlines()
    found = {line.rpartition("/dev/shm/")[2] for line in lines if "/dev/shm/fast" in line}
    return {name for name in found if re.search(r"_port7\d{3}\b", name) is None}


def shared() -> set[str]:
    """Return the shared memory files of all processes."""
    return {path.name for path in Path("/dev/shm").iterdir()}


async def test_leaving_leaves_no_shared_memory_behind(lone_ros: Any) -> None:
    before = mapped() | shared()  # killed nodes leave theirs
    async with opened(lone_ros) as session:
        ref, data = await session.text("is anybody here?")
        await session.adapter.subscribe("/asked")
        await session.publish("/asked", ref, data, seconds=0.1)
        ours = mapped() - before
        assert ours
    assert not {name.removesuffix(" (deleted)") for name in ours} & shared()


async def test_nothing_of_ours_stays_and_signals_are_left_alone(ros: Any) -> None:
    handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    async with opened(ros) as onlooker:
        async with opened(ros) as session:
            ref, data = await session.text("hello")
            await session.publish("/brand/new", ref, data, seconds=0.3)
            assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == handlers
            await onlooker.until(lambda: session.graph.own_node in onlooker.graph.nodes)
            await onlooker.until(lambda: any("_rosld" in name for name in onlooker.graph.nodes))
        await onlooker.until(lambda: not any("rosld" in name for name in onlooker.graph.nodes))
        assert "/brand/new" not in onlooker.graph.topics
