"""Reading topics of a real ROS 1: values, several publishers, several types, and no trace."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from rosld.adapters.model import Kind, Live, MessageSchema, Operation, Ref, Refused, TypeRef, UnknownType
from tests.adapters.ros1.conftest import opened
from tests.adapters.ros1.system import RosSystem
from tests.processes import Process

pytestmark = pytest.mark.slow

TWIST = "{linear: {x: 0.1, y: -2.5, z: 1.0e+300}, angular: {x: 0.0, y: -0.0, z: 3.0}}"
FIX = (
    "{latitude: 49.01, longitude: 8.41, position_covariance: [1, 0, 0, 0, 2, 0, 0, 0, 3], position_covariance_type: 2}"
)
READ = {
    "/read/twist": ("geometry_msgs/Twist", TWIST),
    "/read/image": ("sensor_msgs/Image", "{height: 2, width: 3, encoding: mono8, step: 3, data: [1, 2, 3, 250, 252]}"),
    "/read/scan": ("sensor_msgs/LaserScan", "{angle_min: -1.5, ranges: [0.5, .inf, 2.25], intensities: []}"),
    "/read/fix": ("sensor_msgs/NavSatFix", FIX),
    "/read/text": ("std_msgs/String", "data: 'quotes \" and ümlauts 🤖'"),
}
"""The type and the message of each topic that is read."""


@pytest.fixture(scope="module")
def speaker(ros: RosSystem) -> Process:
    """A node that publishes."""
    words = [word for topic, (type, value) in READ.items() for word in (topic, type, value)]
    return ros.node("speaking_node.py", "speaker", *words)


def plain(value: Any, schema: MessageSchema) -> Any:
    """Return a decoded message as nested dicts."""
    if hasattr(value, "__msgtype__"):
        fields = schema.types[value.__msgtype__].fields
        return {field.name: plain(getattr(value, field.attribute), schema) for field in fields}
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list):
        return [plain(each, schema) for each in value]
    return value


def numbers(value: Any) -> Any:
    """Return the value of a YAML document, converting floats that YAML parses as strings."""
    if isinstance(value, dict):
        return {key: numbers(each) for key, each in value.items()}
    if isinstance(value, list):
        return [numbers(each) for each in value]
    return float(value) if value in ("inf", "1e+300") else value


async def test_a_topic_reads_as_rostopic_echo_prints_it(ros: RosSystem, speaker: Process) -> None:
    said = [line.split(" ", 2) for line in speaker.seen if line.startswith("says /read")]
    async with opened(ros) as session:
        for _, topic, text in said:
            sample = (await session.first(await session.adapter.subscribe(topic)))[0]
            assert sample.schema.name == READ[topic][0].replace("/", "/msg/")
            schema = await session.schema(sample.schema)
            assert isinstance(schema, MessageSchema)
            mine, echoed = plain(await session.decoded(sample), schema), numbers(json.loads(text))
            for each in (mine, echoed):
                each.get("header", {}).pop("seq", None)
                each.get("header", {}).pop("stamp", None)
            assert mine == echoed


async def test_the_graph_is_what_the_master_says_and_reading_leaves_no_trace_there(
    ros: RosSystem, speaker: Process
) -> None:
    listening = ros.node("listener.py", "/read/text", "std_msgs/String")
    before = sorted(map(sorted, ros.master.getSystemState("/test")[2]))
    async with opened(ros) as session:
        graph = session.graph
        assert isinstance(graph.state, Live)
        assert graph.master is not None
        assert graph.master.uri == f"http://127.0.0.1:{ros.port}"
        topic = graph.topics["/read/text"]
        assert topic.type == TypeRef("std_msgs/msg/String")
        assert [each.node for each in topic.publishers] == ["/speaker"]
        assert [each.node.startswith("/listener") for each in topic.subscribers] == [True]
        assert graph.own_node not in graph.nodes
        await session.until(lambda: session.graph.nodes["/speaker"].uri, "the node's address")
        assert session.graph.nodes["/speaker"].uri == ros.master.lookupNode("/test", "/speaker")[2]
        allowed = session.adapter.allows(Ref(Kind.TOPIC, "/read/text"))
        assert allowed == {Operation.SUBSCRIBE, Operation.PUBLISH}
        await session.first(await session.adapter.subscribe("/read/text"))
        await session.adapter.subscribe("/nobody_publishes_this")
        assert sorted(map(sorted, ros.master.getSystemState("/test")[2])) == before
        assert ros.master.lookupNode("/test", session.graph.own_node)[0] == -1
        with pytest.raises(Refused, match="std_msgs/msg/String"):
            await session.publish("/read/text", TypeRef("std_msgs/msg/Int32"), b"\0\0\0\0")
    assert sorted(map(sorted, ros.master.getSystemState("/test")[2])) == before
    listening.stop()


@pytest.mark.usefixtures("speaker")
async def test_a_node_in_cpp_is_read_and_hears_as_any_node(ros: RosSystem) -> None:
    relays = [
        ros.start(["/usr/lib/topic_tools/relay", source, f"{source}/relayed"]) for source in ("/read/twist", "/said")
    ]
    ros.until(lambda: ros.publishers("/read/twist/relayed"), "the relay")
    ros.until(lambda: dict(ros.master.getSystemState("/test")[2][1]).get("/said"), "the other relay")
    async with opened(ros) as session:
        (sample,) = await session.first(await session.adapter.subscribe("/read/twist/relayed"))
        assert sample.schema.hash == "9f195f881246fdfa2798d1d3eebca84a"
        assert (await session.decoded(sample)).linear.z == 1.0e300
        relayed = next(name for name in session.graph.services if "relay" in name)
        await session.until(lambda: session.graph.services[relayed].type, "a roscpp service's type")
        ref, back = TypeRef("std_msgs/msg/String"), await session.adapter.subscribe("/said/relayed")

        async def say() -> None:
            while not back.latest():  # the relay advertises with its first message
                sent = await session.publish("/said", ref, b"\5\0\0\0round")
                assert sent.matched == 1
                await asyncio.sleep(0.05)

        await asyncio.wait_for(say(), 30)
        assert (await session.decoded(back.latest()[0])).data == "round"
    for relay in relays:
        relay.stop()


async def test_a_subscription_made_before_its_publisher_gets_the_latched_message(ros: RosSystem) -> None:
    async with opened(ros) as session:
        subscription = await session.adapter.subscribe("/early")
        assert subscription.latest() == ()
        woken = asyncio.Event()
        watch = subscription.watch(woken.set)
        node = await asyncio.to_thread(ros.node, "latched_node.py", "early_node", "/early", "bird")
        await asyncio.wait_for(woken.wait(), 60)
        (sample,) = subscription.latest()
        assert (await session.decoded(sample)).data == "bird"
        assert (sample.latched, sample.sequence, sample.epoch) == (True, 1, 0)
        assert subscription.latest() is subscription.latest()
        assert (await session.adapter.subscribe("/early")).latest()[0] is sample
        await session.until(lambda: session.graph.topics["/early"].publishers[0].latched, "that it is latched")
        watch.close()
        watch.close()
        await asyncio.to_thread(node.stop)


async def test_a_definition_that_cannot_be_read_leaves_the_topic_listed_and_says_why(ros: RosSystem) -> None:
    odd = ros.node("odd_type_node.py")
    async with opened(ros) as session:
        (sample,) = await session.first(await session.adapter.subscribe("/odd"))
        words = await session.until(lambda: session.graph.topics["/odd"].unreadable, "the reason")
        assert "nowhere_msgs" in words
        with pytest.raises(UnknownType, match="nowhere_msgs"):
            await session.schema(sample.schema)
        assert Operation.PUBLISH not in session.adapter.allows(Ref(Kind.TOPIC, "/odd"))
    odd.stop()


def test_a_host_name_that_does_not_resolve_is_tried_at_the_masters_host(ros: RosSystem) -> None:
    node = ros.node("latched_node.py", "lost_node", "/lost", "found", ROS_HOSTNAME="no-such-host.invalid", ROS_IP="")

    async def read() -> str:
        async with opened(ros) as session:
            (sample,) = await session.first(await session.adapter.subscribe("/lost"))
            assert session.graph.nodes["/lost_node"].unreachable is None
            return str((await session.decoded(sample)).data)

    assert asyncio.run(read()) == "found"
    node.stop()


async def test_a_host_that_does_not_resolve_is_shown_as_unreachable(ros: RosSystem) -> None:
    name, uri = "far-away.invalid", "http://far-away.invalid:9/"
    ros.master.registerPublisher("/ghost", "/ghosts", "std_msgs/String", uri)
    async with opened(ros, host_map={name: "127.7.7.7"}) as session:
        await session.adapter.subscribe("/ghosts")
        words = await session.until(lambda: session.graph.nodes["/ghost"].unreachable, "the node is unreachable")
        assert name in words
        await session.until(lambda: session.graph.topics["/ghosts"].publishers[0].unreachable, "the endpoint, too")
        with pytest.raises(UnknownType, match="--types"):
            await session.schema(TypeRef("no_msgs/msg/Such"))
    ros.master.unregisterPublisher("/ghost", "/ghosts", uri)
