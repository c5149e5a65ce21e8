"""Nodes of a real ROS 2 system that come, go, and do not answer; and their parameters."""

from __future__ import annotations

import asyncio
import re
import signal
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.model import Kind, Operation, Ref, Refused, TimedOut


def test_a_node_that_is_killed_and_started_again_is_missed_and_found_and_counts_from_one(
    lone_ros: Any, opened: Any
) -> None:
    first = lone_ros.node("robot.py")
    lone_ros.node("odd.py", "twin", "bystander")

    async def scenario() -> None:
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
            # A message may come before it is known which node its publisher belongs to.
            await session.until(
                lambda: "/talker" in [each.publisher for each in subscription.latest() if each.epoch > before.epoch],
                "a message of the node that is there again",
            )

    asyncio.run(scenario())


def test_a_node_that_answers_nothing_is_told_as_such_and_holds_up_nobody(lone_ros: Any, opened: Any) -> None:
    lone_ros.node("robot.py")
    lone_ros.node("odd.py", "silent", "silent")

    async def scenario() -> None:
        async with opened(lone_ros) as session:
            node = await session.until(
                lambda: (found := session.graph.nodes.get("/silent")) and found.unreachable and found
            )
            assert "did not answer" in node.unreachable
            assert session.graph.nodes["/listener"].unreachable is None
            await session.until(lambda: "/listener/seats" in session.graph.parameters)
            tree = (await session.adapter.get_parameters(["/"], deadline=session.deadline(1)))["/"]
            assert tree["listener"]["seats"] == 2
            with pytest.raises(TimedOut):
                await session.adapter.get_parameters(["/silent/x"], deadline=session.deadline(0.5))

    asyncio.run(scenario())


def mapped() -> set[str]:
    """The files of shared memory that this process has from its middleware, but for those that all processes share."""
    lines = Path("/proc/self/maps").read_text("ascii").splitlines()
    found = {line.rpartition("/dev/shm/")[2] for line in lines if "/dev/shm/fast" in line}
    return {name for name in found if re.search(r"_port7\d{3}\b", name) is None}


def test_leaving_leaves_no_shared_memory_behind(lone_ros: Any, opened: Any) -> None:
    before = mapped() | {path.name for path in Path("/dev/shm").iterdir()}  # nodes that were killed leave theirs

    async def scenario() -> None:
        async with opened(lone_ros) as session:
            ref, data = await session.text("is anybody here?")
            await session.adapter.subscribe("/asked")
            await session.adapter.publish("/asked", ref, data, deadline=session.deadline(0.1))
            ours = mapped() - before
            assert ours
        assert [name for name in ours if (Path("/dev/shm") / name.removesuffix(" (deleted)")).exists()] == []

    asyncio.run(scenario())


def test_parameters_of_all_kinds_are_named_by_their_node(ros: Any, opened: Any) -> None:
    async def scenario() -> None:
        async with opened(ros) as session:
            await session.until(lambda: "/listener/seats" in session.graph.parameters)
            wanted = {
                "/listener/seats": 2,
                "/listener/speed": 1.5,
                "/listener/name": "Ada",
                "/listener/flying": False,
                "/listener/camera.exposures": [1.0, 2.0],
                "/listener/bytes": b"\x01\xff",
                "/listener/odd/name with spaces": [1, 2],
            }
            assert wanted.keys() <= session.graph.parameters.keys()
            assert {session.graph.parameters[name].node for name in wanted} == {"/listener"}
            found = await session.adapter.get_parameters(list(wanted), deadline=session.deadline())
            assert found == wanted
            assert [type(found[name]) for name in ("/listener/seats", "/listener/speed")] == [int, float]
            own = session.graph.own_node
            assert not any(name.startswith(f"{own}/") for name in session.graph.parameters)

    asyncio.run(scenario())


def test_what_another_sets_comes_by_the_events_of_its_node(ros: Any, opened: Any) -> None:
    async def scenario() -> None:
        async with opened(ros) as one, opened(ros) as other:
            name = "/free/told.by.event"
            await one.until(lambda: Operation.SET_PARAMETER in one.adapter.allows(Ref(Kind.PARAMETER, name)))
            await other.until(lambda: Operation.SET_PARAMETER in other.adapter.allows(Ref(Kind.PARAMETER, name)))
            await one.adapter.set_parameters({name: 1}, deadline=one.deadline())
            await other.until(lambda: name in other.told.parameters)
            await other.until(lambda: name in other.graph.parameters)
            await one.adapter.delete_parameters([name], deadline=one.deadline())
            await other.until(lambda: name not in other.graph.parameters)

    asyncio.run(scenario())


def test_what_a_node_declared_cannot_be_deleted_and_read_only_is_told(ros: Any, opened: Any) -> None:
    async def scenario() -> None:
        async with opened(ros) as session:
            await session.until(lambda: "/listener/seats" in session.graph.parameters)
            with pytest.raises(Refused, match="/listener/seats"):
                await session.adapter.set_parameters({"/listener/seats": "two"}, deadline=session.deadline())
            with pytest.raises(Refused, match="/listener/never") as caught:
                await session.adapter.set_parameters({"/listener/never": 1}, deadline=session.deadline())
            assert caught.value.words

    asyncio.run(scenario())


def test_nothing_of_ours_stays_and_signals_are_left_alone(ros: Any, opened: Any) -> None:
    async def scenario() -> None:
        handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
        async with opened(ros) as onlooker:
            async with opened(ros) as session:
                ref, data = await session.text("hello")
                await session.adapter.publish("/brand/new", ref, data, deadline=session.deadline(0.3))
                assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == handlers
                await onlooker.until(lambda: session.graph.own_node in onlooker.graph.nodes)
                await onlooker.until(lambda: any("_rosld" in name for name in onlooker.graph.nodes))
            await onlooker.until(lambda: not any("rosld" in name for name in onlooker.graph.nodes))
            assert "/brand/new" not in onlooker.graph.topics

    asyncio.run(scenario())
