"""Robustness: nodes and masters that are killed and restarted, masters that hang, a server that is busy."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time

import pytest

from rosld.adapters.base import AdapterOptions, NullSink
from rosld.adapters.model import Live, Stale, TimedOut, TypeRef, Unreachable
from rosld.adapters.ros1 import adapter
from tests.adapters.ros1.conftest import opened
from tests.adapters.ros1.system import RosSystem

pytestmark = pytest.mark.slow

STRING = TypeRef("std_msgs/msg/String")


async def test_a_master_that_never_answers_is_waited_for_and_the_graph_says_so_in_time() -> None:
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        mute = adapter(f"ros1://127.0.0.1:{silent.getsockname()[1]}", AdapterOptions())
        await mute.open(NullSink(), deadline=asyncio.get_running_loop().time() + 0.5)
        assert isinstance(mute.graph.state, Stale)
        assert "does not answer in time" in mute.graph.state.why
        await mute.close()


async def test_a_killed_node_is_unreachable_until_it_comes_back_under_its_name_in_a_new_epoch(ros: RosSystem) -> None:
    async with opened(ros) as session:
        first = await asyncio.to_thread(ros.node, "latched_node.py", "phoenix", "/phoenix", "first")
        subscription = await session.adapter.subscribe("/phoenix")
        (before,) = await session.first(subscription)
        await asyncio.to_thread(first.kill)
        await session.until(lambda: session.graph.nodes["/phoenix"].unreachable, "the node is unreachable")
        assert subscription.latest() == (before,)
        await asyncio.to_thread(ros.node, "latched_node.py", "phoenix", "/phoenix", "second")
        await session.until(lambda: subscription.latest()[0] is not before, "the restarted node's message")
        (after,) = subscription.latest()
        assert (await session.decoded(after)).data == "second"
        assert after.publisher == before.publisher
        assert after.epoch > before.epoch
        await session.until(lambda: session.graph.nodes["/phoenix"].unreachable is None, "it is reachable again")


async def test_the_graph_goes_stale_with_the_master_and_everything_returns_with_a_new_one(lone_ros: RosSystem) -> None:
    ros = lone_ros
    async with opened(ros) as session:
        talker = await asyncio.to_thread(ros.publish, "/chatter", "std_msgs/String", "data: x", rate=50)
        await session.until(lambda: "/chatter" in session.graph.topics)
        subscription = await session.adapter.subscribe("/chatter")
        await session.first(subscription)
        await session.publish("/ours", STRING, b"\1\0\0\0x", seconds=0.5)
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
            await session.get_parameters(["/"], seconds=1)

        await asyncio.to_thread(ros.start_master)
        await session.until(lambda: isinstance(session.graph.state, Live), "the graph is live again")
        await session.until(lambda: ros.publishers("/ours") == [session.graph.own_node], "registered again")
        await asyncio.to_thread(talker.stop)
        other = await asyncio.to_thread(ros.node, "latched_node.py", "anew", "/chatter", "after the storm")
        await session.until(
            lambda: any(sample.publisher == "/anew" for sample in subscription.latest()), "the new publisher"
        )
        await asyncio.to_thread(other.stop)


def hang(ros: RosSystem) -> None:
    """Suspend the master; it is suspended when this returns."""
    ros.master_process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, ros.master_process.pid, os.WSTOPPED | os.WNOWAIT)


async def test_a_hanging_master_makes_the_graph_stale_and_keeps_nobody_waiting(ros: RosSystem) -> None:
    async with opened(ros) as session, opened(ros) as other:
        await other.publish("/ours", STRING, b"\1\0\0\0x", seconds=0.5)
        hang(ros)
        try:
            with pytest.raises(TimedOut):
                await session.set_parameters({"/x": 1}, seconds=0.5)
            await session.until(lambda: isinstance(session.graph.state, Stale), "stale")
            await asyncio.wait_for(other.adapter.close(), 30)
            await other.adapter.close()
        finally:
            ros.master_process.send_signal(signal.SIGCONT)
        await session.until(lambda: isinstance(session.graph.state, Live), "live")


async def test_a_publisher_without_a_queue_keeps_its_rate_while_the_servers_loop_is_stopped(ros: RosSystem) -> None:
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
