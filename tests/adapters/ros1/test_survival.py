"""What rosld survives: nodes and masters that are killed and restarted, masters that hang, a server that is busy."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time

import pytest

from rosld.adapters.base import AdapterOptions
from rosld.adapters.model import Live, Stale, TimedOut, TypeRef, Unreachable
from rosld.adapters.ros1 import adapter
from tests.adapters.ros1.conftest import Opening
from tests.adapters.ros1.system import RosSystem

STRING = TypeRef("std_msgs/msg/String")


class Deaf:
    """A sink that does not care."""

    def graph_changed(self, graph: object) -> None: ...

    def parameter_changed(self, name: str) -> None: ...


def test_a_master_that_never_answers_is_waited_for_and_the_graph_says_so_in_time() -> None:
    async def attempt() -> None:
        with socket.socket() as silent:
            silent.bind(("127.0.0.1", 0))
            silent.listen()
            mute = adapter(f"ros1://127.0.0.1:{silent.getsockname()[1]}", AdapterOptions())
            await mute.open(Deaf(), deadline=asyncio.get_running_loop().time() + 0.5)
            assert isinstance(mute.graph.state, Stale)
            assert "does not answer in time" in mute.graph.state.why
            await mute.close()

    asyncio.run(attempt())


def test_a_killed_node_comes_back_under_its_name_in_a_new_epoch(ros: RosSystem, opened: Opening) -> None:
    async def live() -> None:
        async with opened(ros) as session:
            first = await asyncio.to_thread(ros.node, "latched_node.py", "phoenix", "/phoenix", "first")
            subscription = await session.adapter.subscribe("/phoenix")
            (before,) = await session.first(subscription)
            await asyncio.to_thread(first.kill)
            assert subscription.latest() == (before,)
            second = await asyncio.to_thread(ros.node, "latched_node.py", "phoenix", "/phoenix", "second")
            await session.until(lambda: subscription.latest()[0] is not before, "the restarted node's message")
            (after,) = subscription.latest()
            assert (await session.decoded(after)).data == "second"
            assert after.publisher == before.publisher
            assert after.epoch > before.epoch
            await session.until(lambda: session.graph.nodes["/phoenix"].unreachable is None, "it is reachable again")
            await asyncio.to_thread(second.stop)

    asyncio.run(live())


def test_a_killed_node_is_shown_as_unreachable_while_the_master_lists_it(ros: RosSystem, opened: Opening) -> None:
    async def live() -> None:
        async with opened(ros) as session:
            node = await asyncio.to_thread(ros.node, "latched_node.py", "victim", "/victim", "last words")
            subscription = await session.adapter.subscribe("/victim")
            await session.first(subscription)
            await asyncio.to_thread(node.kill)
            await session.until(lambda: session.graph.nodes["/victim"].unreachable, "the node is unreachable")
            assert (await session.decoded(subscription.latest()[0])).data == "last words"

    asyncio.run(live())


def test_the_graph_goes_stale_with_the_master_and_everything_returns_with_a_new_one(
    lone_ros: RosSystem, opened: Opening
) -> None:
    ros = lone_ros

    async def live() -> None:
        async with opened(ros) as session:
            talker = await asyncio.to_thread(ros.publish, "/chatter", "std_msgs/String", "data: x", rate=50)
            await session.until(lambda: "/chatter" in session.graph.topics)
            subscription = await session.adapter.subscribe("/chatter")
            await session.first(subscription)
            await session.adapter.publish("/ours", STRING, b"\1\0\0\0x", deadline=session.deadline(0.05))
            known = session.graph.topics.keys()

            await asyncio.to_thread(ros.kill_master)
            stale = await session.until(lambda: isinstance(session.graph.state, Stale) and session.graph.state)
            assert isinstance(stale, Stale)
            assert abs(stale.since_ns - time.time_ns()) < 30e9
            assert "127.0.0.1" in stale.why
            assert session.graph.topics.keys() == known
            count = subscription.latest()[0].sequence
            await session.until(lambda: subscription.latest()[0].sequence > count, "messages without a master")
            with pytest.raises((Unreachable, TimedOut)):
                await session.adapter.get_parameters(["/"], deadline=session.deadline(1))

            await asyncio.to_thread(ros.start_master)
            await session.until(lambda: isinstance(session.graph.state, Live), "the graph is live again")
            await session.until(lambda: ros.publishers("/ours") == [session.graph.own_node], "registered again")
            await asyncio.to_thread(talker.stop)
            other = await asyncio.to_thread(ros.node, "latched_node.py", "anew", "/chatter", "after the storm")
            await session.until(
                lambda: any(sample.publisher == "/anew" for sample in subscription.latest()), "the new publisher"
            )
            await asyncio.to_thread(other.stop)

    asyncio.run(live())


def hang(ros: RosSystem) -> None:
    """Stop the master; it does nothing more when this returns."""
    ros.master_process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, ros.master_process.pid, os.WSTOPPED | os.WNOWAIT)


def test_closing_is_quick_even_when_the_master_hangs(lone_ros: RosSystem, opened: Opening) -> None:
    async def live() -> None:
        async with opened(lone_ros) as session:
            await session.adapter.publish("/ours", STRING, b"\1\0\0\0x", deadline=session.deadline(0.05))
            hang(lone_ros)
            try:
                await asyncio.wait_for(session.adapter.close(), 30)
                await session.adapter.close()
            finally:
                lone_ros.master_process.send_signal(signal.SIGCONT)

    asyncio.run(live())


def test_a_hanging_master_makes_the_graph_stale_and_keeps_nobody_waiting_beyond_the_deadline(
    lone_ros: RosSystem, opened: Opening
) -> None:
    async def live() -> None:
        async with opened(lone_ros) as session:
            hang(lone_ros)
            try:
                with pytest.raises(TimedOut):
                    await session.adapter.set_parameters({"/x": 1}, deadline=session.deadline(0.5))
                await session.until(lambda: isinstance(session.graph.state, Stale), "stale")
            finally:
                lone_ros.master_process.send_signal(signal.SIGCONT)
            await session.until(lambda: isinstance(session.graph.state, Live), "live")

    asyncio.run(live())


def test_a_publisher_without_a_queue_keeps_its_rate_while_the_servers_loop_is_stopped(
    ros: RosSystem, opened: Opening
) -> None:
    async def block() -> None:
        async with opened(ros) as session:
            steady = await asyncio.to_thread(ros.node, "steady_node.py", "/steady")
            subscription = await session.adapter.subscribe("/steady")
            before = (await session.first(subscription))[0].sequence
            began = time.monotonic()
            time.sleep(2.5)  # noqa: ASYNC251  the server's loop stands still
            stopped = time.monotonic() - began
            received = subscription.latest()[0].sequence - before
            lines = [line for line in steady.seen if line.startswith("longest")]
            assert received > 0.7 * 200 * stopped
            assert max(float(line.split()[1]) for line in lines) < 0.5
            assert lines[-1].endswith(" 1")
            await asyncio.to_thread(steady.stop)

    asyncio.run(block())
