"""Reading topics of a real ROS 1: values, several publishers, several types, and no trace."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from rosld.adapters.model import Kind, Live, MessageSchema, Operation, Ref, Refused, TypeRef, UnknownType
from tests.adapters.ros1.conftest import Opening
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session

TWIST = "{linear: {x: 0.1, y: -2.5, z: 1.0e+300}, angular: {x: 0.0, y: -0.0, z: 3.0}}"
IMAGE = "{height: 2, width: 3, encoding: mono8, step: 3, data: [1, 2, 3, 250, 251, 252]}"
SCAN = "{angle_min: -1.5, angle_max: 1.5, ranges: [0.5, .inf, 2.25], intensities: []}"
FIX = (
    "{latitude: 49.01, longitude: 8.41, position_covariance: [1, 0, 0, 0, 2, 0, 0, 0, 3], position_covariance_type: 2}"
)
STRING = "data: 'quotes \" and ümlauts 🤖'"


def plain(value: Any, schema: MessageSchema) -> Any:
    """A decoded message as nested dicts."""
    if hasattr(value, "__msgtype__"):
        fields = schema.types[value.__msgtype__].fields
        return {field.name: plain(getattr(value, field.attribute), schema) for field in fields}
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, list):
        return [plain(each, schema) for each in value]
    return value


def numbers(value: Any) -> Any:
    """What rostopic printed, with the floats that YAML takes for strings as floats."""
    if isinstance(value, dict):
        return {key: numbers(each) for key, each in value.items()}
    if isinstance(value, list):
        return [numbers(each) for each in value]
    return float(value) if value in ("inf", "1e+300") else value


@pytest.mark.parametrize(
    ("name", "type_name", "value"),
    [
        ("twist", "geometry_msgs/Twist", TWIST),
        ("image", "sensor_msgs/Image", IMAGE),
        ("scan", "sensor_msgs/LaserScan", SCAN),
        ("fix", "sensor_msgs/NavSatFix", FIX),
        ("text", "std_msgs/String", STRING),
    ],
)
def test_a_topic_reads_as_rostopic_echo_prints_it(
    ros: RosSystem, opened: Opening, name: str, type_name: str, value: str
) -> None:
    publishing = ros.publish(f"/read/{name}", type_name, value)
    echoed = ros.echo(f"/read/{name}")

    async def read() -> Any:
        async with opened(ros) as session:
            sample = (await session.first(await session.adapter.subscribe(f"/read/{name}")))[0]
            assert sample.schema.name == type_name.replace("/", "/msg/")
            schema = await session.adapter.schema(sample.schema, deadline=session.deadline())
            assert isinstance(schema, MessageSchema)
            return plain(await session.decoded(sample), schema)

    try:
        mine = asyncio.run(read())
    finally:
        publishing.stop()
    echoed = numbers(echoed)
    for each in (mine, echoed):
        each.get("header", {}).pop("seq", None)
        each.get("header", {}).pop("stamp", None)
    assert mine == echoed


def test_the_graph_is_what_the_master_says(ros: RosSystem, opened: Opening) -> None:
    publishing = ros.publish("/graph/chatter", "std_msgs/String", "data: x", name="graph_talker")
    listening = ros.node("listener.py", "/graph/chatter", "std_msgs/String")

    async def look() -> None:
        async with opened(ros) as session:
            graph = session.graph
            assert isinstance(graph.state, Live)
            assert graph.master is not None
            assert graph.master.uri == f"http://127.0.0.1:{ros.port}"
            topic = graph.topics["/graph/chatter"]
            assert topic.type == TypeRef("std_msgs/msg/String")
            assert [each.node for each in topic.publishers] == ["/graph_talker"]
            assert [each.node.startswith("/listener") for each in topic.subscribers] == [True]
            assert graph.own_node not in graph.nodes
            await session.until(lambda: session.graph.nodes["/graph_talker"].uri, "the node's address")
            assert session.graph.nodes["/graph_talker"].uri == ros.master.lookupNode("/test", "/graph_talker")[2]
            ref = Ref(Kind.TOPIC, "/graph/chatter")
            assert session.adapter.allows(ref) == {Operation.SUBSCRIBE, Operation.PUBLISH}

    asyncio.run(look())
    publishing.stop()
    listening.stop()


def test_the_revision_rises_by_one_a_change_and_unchanged_entries_are_shared(ros: RosSystem, opened: Opening) -> None:
    publishing = ros.publish("/shared/one", "std_msgs/String", "data: x")

    async def look() -> None:
        async with opened(ros) as session:
            await session.until(lambda: all(each.uri for each in session.graph.nodes.values()), "addresses")
            before = session.graph
            second = await asyncio.to_thread(ros.publish, "/shared/two", "std_msgs/String", "data: y")
            after = await session.until(lambda: "/shared/two" in session.graph.topics and session.graph)
            assert after.topics["/shared/one"] is before.topics["/shared/one"]
            revisions = [graph.revision for graph in session.told.graphs]
            assert revisions == list(range(revisions[0], revisions[0] + len(revisions)))
            assert after.parameters is before.parameters
            await asyncio.to_thread(second.stop)

    asyncio.run(look())
    publishing.stop()


def test_reading_leaves_no_trace_at_the_master(ros: RosSystem, opened: Opening) -> None:
    publishing = ros.publish("/trace/chatter", "std_msgs/String", "data: x")
    before = sorted(map(sorted, ros.master.getSystemState("/test")[2]))

    async def read() -> None:
        async with opened(ros) as session:
            await session.first(await session.adapter.subscribe("/trace/chatter"))
            await session.adapter.subscribe("/trace/nobody_publishes_this")
            await session.adapter.get_parameters(["/"], deadline=session.deadline())
            assert sorted(map(sorted, ros.master.getSystemState("/test")[2])) == before
            assert ros.master.lookupNode("/test", session.graph.own_node)[0] == -1

    asyncio.run(read())
    assert sorted(map(sorted, ros.master.getSystemState("/test")[2])) == before
    publishing.stop()


def test_latest_is_the_same_object_until_something_new_arrives(ros: RosSystem, opened: Opening) -> None:
    latched = ros.node("latched_node.py", "same_node", "/same", "hello")

    async def read() -> None:
        async with opened(ros) as session:
            subscription = await session.adapter.subscribe("/same")
            assert subscription.latest() == ()
            (sample,) = await session.first(subscription)
            assert (sample.latched, sample.sequence, sample.epoch) == (True, 1, 0)
            assert subscription.latest() is subscription.latest()
            assert session.graph.topics["/same"].publishers[0].latched
            again = await session.adapter.subscribe("/same")
            assert again.latest()[0] is subscription.latest()[0]

    asyncio.run(read())
    latched.stop()


def test_two_publishers_are_two_samples_and_deeper_subscriptions_see_more(ros: RosSystem, opened: Opening) -> None:
    one = ros.publish("/two/publishers", "std_msgs/String", "data: one", name="two_one")
    other = ros.publish("/two/publishers", "std_msgs/String", "data: other", name="two_other")

    async def read() -> None:
        async with opened(ros) as session:
            subscription = await session.adapter.subscribe("/two/publishers")
            deep = await session.adapter.subscribe("/two/publishers", depth=3)
            samples = await session.first(subscription, 2)
            assert {sample.publisher for sample in samples} == {"/two_one", "/two_other"}
            assert len({(await session.decoded(sample)).data for sample in samples}) == 2
            deepest = await session.first(deep, 6)
            assert len(deepest) == 6
            assert len(subscription.latest()) == 2
            assert [each.received_ns for each in deepest] == sorted(each.received_ns for each in deepest)
            mine = [each.sequence for each in deepest if each.publisher == "/two_one"]
            assert mine == list(range(mine[0], mine[0] + 3))
            deep.close()
            deep.close()

    asyncio.run(read())
    one.stop()
    other.stop()


def test_two_types_on_one_topic_are_both_shown_and_it_is_not_writable(ros: RosSystem, opened: Opening) -> None:
    text = ros.publish("/two/types", "std_msgs/String", "data: one", name="types_text")
    number = ros.publish("/two/types", "std_msgs/Int32", "data: 5", name="types_number")

    async def read() -> None:
        async with opened(ros) as session:
            samples = await session.first(await session.adapter.subscribe("/two/types"), 2)
            assert {(await session.decoded(sample)).data for sample in samples} == {"one", 5}
            names = {"std_msgs/msg/String", "std_msgs/msg/Int32"}
            await session.until(lambda: {each.name for each in session.graph.topics["/two/types"].types} == names)
            topic = session.graph.topics["/two/types"]
            assert topic.type is None
            assert all(each.hash for each in topic.types)
            assert session.adapter.allows(Ref(Kind.TOPIC, "/two/types")) == {Operation.SUBSCRIBE}

    asyncio.run(read())
    text.stop()
    number.stop()


def test_tf_from_three_nodes_is_three_publishers(ros: RosSystem, opened: Opening) -> None:
    nodes = [ros.node("tf_node.py", child) for child in ("left", "right", "base")]

    async def read() -> set[str]:
        async with opened(ros) as session:
            samples = await session.first(await session.adapter.subscribe("/tf", depth=10), 6)
            messages = [await session.decoded(sample) for sample in samples]
            return {transform.child_frame_id for message in messages for transform in message.transforms}

    assert asyncio.run(read()) == {"left", "right", "base"}
    for node in nodes:
        node.stop()


def test_a_relay_in_cpp_is_read_as_any_node(ros: RosSystem, opened: Opening) -> None:
    publishing = ros.publish("/relay/in", "geometry_msgs/Twist", TWIST)
    relay = ros.start(["/usr/lib/topic_tools/relay", "/relay/in", "/relay/out"])
    ros.until(lambda: ros.publishers("/relay/out"), "the relay")

    async def read() -> Any:
        async with opened(ros) as session:
            (sample,) = await session.first(await session.adapter.subscribe("/relay/out"))
            assert sample.schema.hash == "9f195f881246fdfa2798d1d3eebca84a"
            await session.until(lambda: [each for each in session.graph.services.values() if each.type], "types")
            relayed = [name for name in session.graph.services if "relay" in name]
            await session.until(lambda: session.graph.services[relayed[0]].type, "a roscpp service's type")
            return (await session.decoded(sample)).linear.z

    assert asyncio.run(read()) == 1.0e300
    relay.stop()
    publishing.stop()


def test_a_definition_that_cannot_be_read_leaves_the_topic_listed_and_says_why(ros: RosSystem, opened: Opening) -> None:
    odd = ros.node("odd_type_node.py")

    async def read() -> None:
        async with opened(ros) as session:
            (sample,) = await session.first(await session.adapter.subscribe("/odd"))
            words = await session.until(lambda: session.graph.topics["/odd"].unreadable, "the reason")
            assert "nowhere_msgs" in words
            with pytest.raises(UnknownType, match="nowhere_msgs"):
                await session.adapter.schema(sample.schema, deadline=session.deadline())
            assert Operation.PUBLISH not in session.adapter.allows(Ref(Kind.TOPIC, "/odd"))

    asyncio.run(read())
    odd.stop()


def test_a_subscription_made_before_its_publisher_gets_its_messages(ros: RosSystem, opened: Opening) -> None:
    async def read() -> None:
        async with opened(ros) as session:
            subscription = await session.adapter.subscribe("/early")
            woken = asyncio.Event()
            watch = subscription.watch(woken.set)
            node = await asyncio.to_thread(ros.node, "latched_node.py", "early_node", "/early", "bird")
            await asyncio.wait_for(woken.wait(), 60)
            assert (await session.decoded(subscription.latest()[0])).data == "bird"
            watch.close()
            watch.close()
            await asyncio.to_thread(node.stop)

    asyncio.run(read())


def test_subscribing_again_never_gives_two_samples_one_identity(ros: RosSystem, opened: Opening) -> None:
    publishing = ros.publish("/identity", "std_msgs/String", "data: x", rate=50)

    async def read() -> None:
        async with opened(ros) as session:
            identities = set()
            for _ in range(3):
                subscription = await session.adapter.subscribe("/identity")
                (sample,) = await session.first(subscription)
                identities.add((sample.publisher, sample.epoch, sample.sequence, sample.received_ns))
                subscription.close()
            assert len({each[:3] for each in identities}) == 3

    asyncio.run(read())
    publishing.stop()


def test_a_host_name_that_does_not_resolve_is_tried_at_the_masters_host(ros: RosSystem, opened: Opening) -> None:
    node = ros.node("latched_node.py", "lost_node", "/lost", "found", ROS_HOSTNAME="no-such-host.invalid", ROS_IP="")

    async def read() -> str:
        async with opened(ros) as session:
            (sample,) = await session.first(await session.adapter.subscribe("/lost"))
            assert session.graph.nodes["/lost_node"].unreachable is None
            return str((await session.decoded(sample)).data)

    assert asyncio.run(read()) == "found"
    node.stop()


def test_a_host_that_does_not_answer_is_shown_as_unreachable_until_it_is_mapped(
    ros: RosSystem, opened: Opening
) -> None:
    node = ros.node("latched_node.py", "far_node", "/far", "away", ROS_HOSTNAME="127.1.2.3", ROS_IP="127.1.2.3")
    name = "far-away.invalid"
    uri = ros.master.lookupNode("/test", "/far_node")[2]
    ros.master.registerPublisher("/ghost", "/ghosts", "std_msgs/String", uri.replace("127.1.2.3", name))

    async def read(session: Session) -> str:
        await session.adapter.subscribe("/ghosts")
        await session.until(lambda: session.graph.nodes["/ghost"].unreachable, "the node is unreachable")
        await session.until(lambda: session.graph.topics["/ghosts"].publishers[0].unreachable, "the endpoint as well")
        return session.graph.nodes["/ghost"].unreachable or ""

    async def unmapped() -> str:
        async with opened(ros, host_map={name: "127.7.7.7"}) as session:
            return await read(session)

    words = asyncio.run(unmapped())
    assert "far-away.invalid" in words
    ros.master.unregisterPublisher("/ghost", "/ghosts", uri.replace("127.1.2.3", name))
    node.stop()


def test_a_type_nobody_knows_is_unknown_and_the_way_out_is_named(ros: RosSystem, opened: Opening) -> None:
    async def ask() -> None:
        async with opened(ros) as session:
            with pytest.raises(UnknownType, match="--types"):
                await session.adapter.schema(TypeRef("no_msgs/msg/Such"), deadline=session.deadline())

    asyncio.run(ask())


def test_publishing_another_type_than_the_topics_is_refused(ros: RosSystem, opened: Opening) -> None:
    publishing = ros.publish("/typed", "std_msgs/String", "data: x")

    async def attempt() -> None:
        async with opened(ros) as session:
            with pytest.raises(Refused, match="std_msgs/msg/String"):
                await session.adapter.publish(
                    "/typed", TypeRef("std_msgs/msg/Int32"), b"\0\0\0\0", deadline=session.deadline()
                )
            assert session.graph.own_node not in ros.publishers("/typed")

    asyncio.run(attempt())
    publishing.stop()
