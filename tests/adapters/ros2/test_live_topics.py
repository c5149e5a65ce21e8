"""Topics of a real ROS 2 system: quality of service, latched messages, several publishers, rosld's own endpoints."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rosld.adapters.model import Mismatch, Qos, mismatches
from tests.adapters.ros2.conftest import opened

pytestmark = pytest.mark.slow


async def test_the_quality_of_service_of_every_endpoint_is_in_the_graph(ros: Any) -> None:
    async with opened(ros) as session:
        published = {"/counter", "/description", "/_hidden/topic"}
        await session.until(lambda: published <= {name for name, it in session.graph.topics.items() if it.publishers})
        await session.until(lambda: "/shy/display" in session.graph.topics)
        (counter,) = session.graph.topics["/counter"].publishers
        assert (counter.node, counter.qos.reliability, counter.qos.durability) == (
            "/talker",
            "reliable",
            "volatile",
        )
        (latched,) = session.graph.topics["/description"].publishers
        assert (latched.latched, latched.qos.durability) == (True, "transient_local")
        assert not any("_rosld" in name for name in session.graph.nodes)
        (shy,) = session.graph.topics["/shy/display"].subscribers
        assert (shy.node, shy.qos.reliability, shy.qos.deadline_ns) == ("/listener", "best_effort", None)


async def test_a_latched_message_reaches_a_late_look_and_a_second_look_and_counts_once(ros: Any) -> None:
    async with opened(ros) as session:
        one = await session.adapter.subscribe("/description")
        (early,) = await session.first(one)
        assert early.latched  # even if it was received before its publisher was known
        sample = await session.until(lambda: one.latest()[0].publisher and one.latest()[0])
        assert (await session.decoded(sample)).data == "a robot"
        assert sample.latched
        deep = await session.adapter.subscribe("/description", depth=40)
        assert list(await session.first(deep)) == [sample]
        await asyncio.sleep(0.3)
        assert list(deep.latest()) == [sample]
        one.close()
        deep.close()
        (again,) = await session.first(await session.adapter.subscribe("/description"))
        assert again.data == sample.data


async def test_two_nodes_that_do_not_hear_each_other_are_a_mismatch_and_both_are_read(ros: Any) -> None:
    odd = [ros.node("odd.py", way, way) for way in ("shouter", "strict", "late")]
    async with opened(ros) as session:
        topic = await session.until(
            lambda: (found := session.graph.topics.get("/loud")) and found.publishers and found.subscribers and found
        )
        assert mismatches(topic.publishers, topic.subscribers) == (
            Mismatch("/shouter", "/strict", "reliability", "best_effort", "reliable"),
        )
        (sample,) = await session.first(await session.adapter.subscribe("/loud"))
        assert (await session.decoded(sample)).data == "hey"
        samples = await session.first(await session.adapter.subscribe("/history", depth=5), 3)
        assert [(await session.decoded(each)).data for each in samples] == ["one", "two", "three"]
        assert [each.sequence for each in samples] == [1, 2, 3]
    for node in odd:
        node.stop()


async def test_two_publishers_of_one_topic_are_both_read(ros: Any) -> None:
    twins = [ros.node("odd.py", "twin", name) for name in ("castor", "pollux")]
    async with opened(ros) as session:
        await session.until(lambda: "/shared" in session.graph.topics)
        await session.until(lambda: len(session.graph.topics["/shared"].publishers) == 2)
        subscription = await session.adapter.subscribe("/shared", depth=20)
        await session.until(lambda: len({bytes(each.data) for each in subscription.latest()}) == 2, "a word of both")
        texts = {(await session.decoded(each)).data for each in subscription.latest()}
        assert texts == {"castor", "pollux"}
        heard = {each.publisher for each in subscription.latest()}
        assert heard <= {"/castor", "/pollux", ""}
        if heard == {"/castor", "/pollux"}:  # where the middleware reports the sender of a message
            for each in subscription.latest():
                assert each.publisher == "/" + (await session.decoded(each)).data
    for node in twins:
        node.stop()


async def test_what_rosld_publishes_reaches_reliable_best_effort_and_latched_subscribers_at_once(lone_ros: Any) -> None:
    robot = lone_ros.node("robot.py")
    async with opened(lone_ros) as session:
        for topic, heard in (("/cockpit/display", ""), ("/shy/display", "shy "), ("/latched/display", "latched ")):
            await session.until(lambda topic=topic: topic in session.graph.topics)
            ref, data = await session.text(f"for {topic}")
            published = await session.publish(topic, ref, data)
            assert published.matched == 1
            await asyncio.to_thread(robot.line, f"{heard}heard for {topic}")
        (ours,) = session.graph.topics["/latched/display"].publishers
        assert ours.qos.durability == "transient_local"


async def test_an_own_sample_is_one_sample_though_the_middleware_echoes_it(ros: Any) -> None:
    async with opened(ros) as session:
        subscription = await session.adapter.subscribe("/cockpit/display", depth=10)
        for number in range(5):
            ref, data = await session.text(f"number {number}")
            published = await session.publish("/cockpit/display", ref, data)
            assert published.matched == 1  # rosld's own reader does not count
        await asyncio.sleep(0.3)
        samples = subscription.latest()
        assert [each.publisher for each in samples] == [session.graph.own_node] * 5
        assert [each.sequence for each in samples] == [1, 2, 3, 4, 5]
        late = await session.adapter.subscribe("/cockpit/display")
        assert [each.sequence for each in late.latest()] == [5]
        ref, data = await session.text("keep this")
        await session.publish("/latched/display", ref, data, latch=True)
        latched = await session.adapter.subscribe("/latched/display")
        await asyncio.sleep(0.3)
        assert [(each.publisher, each.latched) for each in latched.latest()] == [(session.graph.own_node, True)]


async def test_two_that_begin_to_publish_before_they_know_each_other_have_two_names(ros: Any) -> None:
    async def publish(session: Any) -> None:
        ref, data = await session.text(f"hello from {session.graph.own_node}")
        await session.publish("/shared/topic", ref, data, seconds=0.3)

    async def hears(session: Any, subscription: Any, other: Any) -> None:
        names = {session.graph.own_node, other.graph.own_node}
        assert len(names) == 2
        await session.until(lambda: names == {each.node for each in session.graph.topics["/shared/topic"].publishers})
        texts: set[str] = set()
        while texts != {f"hello from {name}" for name in names}:
            await publish(other)
            await asyncio.sleep(0.1)
            texts = {(await session.decoded(sample)).data for sample in subscription.latest()}

    async with opened(ros) as first, opened(ros) as second:
        heard = [await session.adapter.subscribe("/shared/topic") for session in (first, second)]
        await asyncio.gather(publish(first), publish(second))
        await hears(first, heard[0], second)
        await hears(second, heard[1], first)


async def test_the_source_says_the_namespace_and_the_user_the_quality_of_service(ros: Any) -> None:
    qos = (("/brand/*", Qos("best_effort", "transient_local", depth=3)),)
    async with opened(ros, "&namespace=/robot1", qos=qos) as session:
        ref, data = await session.text("hello")
        await session.publish("/brand/new", ref, data, seconds=0.3)
        assert session.graph.own_node.startswith("/robot1/rosld_")
        assert session.graph.own_node in session.graph.nodes
        (ours,) = session.graph.topics["/brand/new"].publishers
        assert (ours.qos.reliability, ours.qos.durability) == ("best_effort", "transient_local")


async def test_names_that_ros_2_does_not_allow_are_refused_and_harm_nobody(ros: Any) -> None:
    async with opened(ros) as session:
        ref, data = await session.text("hello")
        for name in ("/with space", "/ü", "/a//b", "/1a", "/a/"):
            with_error = asyncio.create_task(session.publish(name, ref, data, seconds=0.3))
            (result,) = await asyncio.gather(with_error, return_exceptions=True)
            assert type(result).__name__ == "Refused", name
            assert name in str(result)
            await session.adapter.subscribe(name)
        assert session.graph.own_node not in session.graph.nodes
