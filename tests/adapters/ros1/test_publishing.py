"""Publishing to a real ROS 1: received, matched, latched only when asked, proved before registered, unregistered."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from functools import partial

import pytest

from rosld.adapters.model import NotFound, Refused, TypeRef, Unreachable
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.ros1.master import MasterApi
from rosld.adapters.ros1.publications import Publications
from rosld.adapters.ros1.tcpros import encode_header
from rosld.adapters.ros1.types import Types, definition_folders
from rosld.adapters.ros1.xmlrpc import XmlRpcClient, decode_answer, encode_call
from tests.adapters.ros1.conftest import Opening
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session

STRING = TypeRef("std_msgs/msg/String")


def text(words: str) -> bytes:
    """A std_msgs/String as ROS 1 encodes it."""
    data = words.encode()
    return len(data).to_bytes(4, "little") + data


def test_what_is_published_is_heard_from_the_first_message_on(ros: RosSystem, opened: Opening) -> None:
    listening = [ros.node("listener.py", "/hear", "std_msgs/String") for _ in range(2)]

    async def publish() -> None:
        async with opened(ros) as session:
            for number in range(3):
                published = await session.adapter.publish(
                    "/hear", STRING, text(f"hello {number}"), deadline=session.deadline()
                )
                assert published.matched == 2
            for listener in listening:
                heard = [json.loads((await asyncio.to_thread(listener.line, "heard"))[6:]) for _ in range(3)]
                assert [each["data"] for each in heard] == ["hello 0", "hello 1", "hello 2"]

    asyncio.run(publish())
    for listener in listening:
        listener.stop()


def test_a_subscriber_in_cpp_hears_it_too(ros: RosSystem, opened: Opening) -> None:
    relay = ros.start(["/usr/lib/topic_tools/relay", "/cpp/in", "/cpp/out"])
    ros.until(lambda: dict(ros.master.getSystemState("/test")[2][1]).get("/cpp/in"), "the relay")

    async def publish() -> None:
        async with opened(ros) as session:
            published = await session.adapter.publish("/cpp/in", STRING, text("round"), deadline=session.deadline())
            assert published.matched == 1
            back = await session.adapter.subscribe("/cpp/out")
            await session.until(lambda: ros.publishers("/cpp/out"), "the relay's output")
            until = time.monotonic() + 10
            while not back.latest() and time.monotonic() < until:
                await session.adapter.publish("/cpp/in", STRING, text("round"), deadline=session.deadline())
                await asyncio.sleep(0.05)
            assert (await session.decoded(back.latest()[0])).data == "round"

    asyncio.run(publish())
    relay.stop()


@pytest.mark.parametrize("seconds", [0.3, 1.2])
def test_a_subscriber_that_is_slow_to_notice_the_end_of_a_connection_hears_the_next(
    ros: RosSystem, opened: Opening, seconds: float
) -> None:
    """While it has not noticed, it takes itself for connected; above a second it is not waited for, but told again."""
    listener = ros.node("slow_hangup_node.py", "/slow", str(seconds))

    async def publish_twice() -> None:
        async with opened(ros) as session:
            for words in ("first", "second"):
                published = await session.adapter.publish("/slow", STRING, text(words), deadline=session.deadline())
                assert published.matched == 1
                assert (await asyncio.to_thread(listener.line, "heard")).split()[1] == words
                await session.adapter.unadvertise("/slow")

    try:
        asyncio.run(publish_twice())
    finally:
        listener.stop()


def test_it_is_registered_while_open_and_leaves_no_trace_after_close(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> str:
        async with opened(ros) as session:
            before = session.graph
            assert before.own_node not in before.nodes
            await session.adapter.publish("/mine", STRING, text("x"), deadline=session.deadline(0.2))
            own = session.graph.own_node
            assert ros.publishers("/mine") == [own]
            topic = session.graph.topics["/mine"]
            assert [each.node for each in topic.publishers] == [own]
            assert topic.type is not None
            assert topic.type.hash == "992ce8a1687cec8c8bd883ec73ca41d1"
            assert session.graph.nodes[own].uri
            return own

    own = asyncio.run(publish())
    assert ros.publishers("/mine") == []
    assert ros.master.lookupNode("/test", own)[0] == -1


def test_nobody_matching_is_waited_for_until_the_deadline_and_told(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> None:
        async with opened(ros) as session:
            for _ in range(2):
                began = time.monotonic()
                published = await session.adapter.publish("/alone", STRING, text("x"), deadline=session.deadline(0.5))
                assert published.matched == 0
                assert time.monotonic() - began > 0.4

    asyncio.run(publish())


def test_a_subscriber_that_comes_within_the_wait_gets_the_message(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> None:
        async with opened(ros) as session:
            publishing = asyncio.ensure_future(
                session.adapter.publish("/late", STRING, text("worth the wait"), deadline=session.deadline(15))
            )
            listener = await asyncio.to_thread(ros.node, "listener.py", "/late", "std_msgs/String")
            assert (await publishing).matched == 1
            assert "worth the wait" in await asyncio.to_thread(listener.line, "heard")
            await asyncio.to_thread(listener.stop)

    asyncio.run(publish())


@pytest.mark.parametrize("latch", [True, False])
def test_a_late_subscriber_hears_what_was_latched_and_nothing_else(
    ros: RosSystem, opened: Opening, latch: bool
) -> None:
    async def publish() -> None:
        async with opened(ros) as session:
            topic = f"/latched_{latch}"
            await session.adapter.publish(topic, STRING, text("kept"), latch=latch, deadline=session.deadline(0.1))
            listener = await asyncio.to_thread(ros.node, "listener.py", topic, "std_msgs/String")
            if latch:
                assert "kept" in await asyncio.to_thread(listener.line, "heard")
            else:
                await session.adapter.publish(topic, STRING, text("new"), deadline=session.deadline())
                assert "new" in await asyncio.to_thread(listener.line, "heard")
            await asyncio.to_thread(listener.stop)

    asyncio.run(publish())


def test_what_rosld_publishes_is_a_sample_of_its_own_at_once(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> None:
        async with opened(ros) as session:
            before = await session.adapter.subscribe("/own", depth=2)
            woken = asyncio.Event()
            before.watch(woken.set)
            for words in ("one", "two", "three"):
                await session.adapter.publish("/own", STRING, text(words), deadline=session.deadline(0.05))
            after = await session.adapter.subscribe("/own")
            assert [sample.publisher for sample in after.latest()] == [session.graph.own_node]
            assert [(await session.decoded(sample)).data for sample in before.latest()] == ["two", "three"]
            assert [sample.sequence for sample in before.latest()] == [2, 3]
            assert after.latest()[0] is before.latest()[-1]
            assert after.latest() is after.latest()
            await asyncio.wait_for(woken.wait(), 60)
            subscribers = dict(ros.master.getSystemState("/test")[2][1])
            assert "/own" not in subscribers

    asyncio.run(publish())


def test_unadvertising_takes_the_registration_back(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> None:
        async with opened(ros) as session:
            await session.adapter.publish("/brief", STRING, text("x"), deadline=session.deadline(0.05))
            await session.adapter.unadvertise("/brief")
            assert ros.publishers("/brief") == []
            assert "/brief" not in session.graph.topics
            with pytest.raises(NotFound):
                await session.adapter.unadvertise("/brief")
            await session.adapter.publish("/brief", STRING, text("x"), deadline=session.deadline(0.05))
            assert ros.publishers("/brief") == [session.graph.own_node]

    asyncio.run(publish())


def test_an_address_that_does_not_answer_is_never_registered(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> None:
        async with opened(ros, ros_ip="192.0.2.77") as session:
            with pytest.raises(Refused, match="--ros-ip"):
                await session.adapter.publish("/never", STRING, text("x"), deadline=session.deadline(10))
            assert ros.publishers("/never") == []

    asyncio.run(publish())


def test_a_thousand_messages_sent_at_once_arrive_in_order(ros: RosSystem, opened: Opening) -> None:
    cockpit = ros.node("cockpit_node.py")

    async def publish() -> None:
        async with opened(ros) as session:
            topic, deadline = "/cockpit/display", session.deadline(20)
            for number in range(1000):
                await session.adapter.publish(topic, STRING, text(str(number)), deadline=deadline)
            for number in range(1000):
                assert await asyncio.to_thread(cockpit.line, "display") == f"display {number}"

    asyncio.run(publish())
    cockpit.stop()


def _handshake(port: int, topic: str, **fields: str) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), timeout=5)
    connection.sendall(encode_header({"callerid": "/raw", "topic": topic, "type": "*", "md5sum": "*", **fields}))
    return connection


async def _tcp_port(session: Session, topic: str) -> int:
    """The port that our own Slave API gives for a topic, asked as any node asks."""
    uri = session.graph.nodes[session.graph.own_node].uri or ""
    host, _, port = uri.removeprefix("http://").rstrip("/").partition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    body = encode_call("requestTopic", "/raw", topic, [["UDPROS"], ["TCPROS"]])
    writer.write(b"POST / HTTP/1.0\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
    answer = decode_answer((await reader.read()).partition(b"\r\n\r\n")[2])
    writer.close()
    match answer.value:
        case ["TCPROS", str(), int(port)]:
            return port
        case other:
            raise AssertionError(other)


def test_a_subscriber_that_never_reads_costs_neither_memory_nor_time(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> None:
        async with opened(ros) as session:
            await session.adapter.publish("/heavy", STRING, text("x"), deadline=session.deadline(0.05))
            with _handshake(await _tcp_port(session, "/heavy"), "/heavy") as sleeper:
                megabyte = text("y" * 1_000_000)
                for _ in range(200):
                    assert (
                        await session.adapter.publish("/heavy", STRING, megabyte, deadline=session.deadline())
                    ).matched
                    await asyncio.sleep(0)
                last = text("the newest")
                await session.adapter.publish("/heavy", STRING, last, deadline=session.deadline())
                sleeper.settimeout(5)
                received = bytearray()
                while not received.endswith(last):
                    received += sleeper.recv(1 << 20)
                assert len(received) < 60_000_000

    asyncio.run(publish())


@pytest.mark.parametrize(
    "hello",
    [
        encode_header({"callerid": "/raw", "topic": "/strict", "md5sum": "0" * 32, "type": "std_msgs/Int32"}),
        encode_header({"callerid": "/raw", "topic": "/nothing_here", "md5sum": "*", "type": "*"}),
        encode_header({"probe": "1", "service": "/strict"}),
    ],
)
def test_a_subscriber_we_cannot_serve_is_told_why(ros: RosSystem, opened: Opening, hello: bytes) -> None:
    async def attempt() -> None:
        async with opened(ros) as session:
            await session.adapter.publish("/strict", STRING, text("x"), deadline=session.deadline(0.05))
            reader, writer = await asyncio.open_connection("127.0.0.1", await _tcp_port(session, "/strict"))
            writer.write(hello)
            assert b"error=" in await asyncio.wait_for(reader.read(), 60)
            writer.close()

    asyncio.run(attempt())


@pytest.mark.parametrize("garbage", [b"\xff\xff\xff\xff" * 4, b"\x08\0\0\0\xff\xff\0\0abcd"])
def test_garbage_on_our_port_ends_that_connection_only(ros: RosSystem, opened: Opening, garbage: bytes) -> None:
    async def attempt() -> None:
        async with opened(ros) as session:
            await session.adapter.publish("/tough", STRING, text("x"), latch=True, deadline=session.deadline(0.05))
            port = await _tcp_port(session, "/tough")
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(garbage)
            try:
                assert await asyncio.wait_for(reader.read(), 60) == b""
            except ConnectionError:
                pass
            writer.close()
            with _handshake(port, "/tough") as fine:
                assert b"std_msgs/String" in fine.recv(4096)

    asyncio.run(attempt())


def test_rosnode_kill_ends_what_we_publish_and_a_later_publish_begins_anew(ros: RosSystem, opened: Opening) -> None:
    async def publish() -> None:
        async with opened(ros) as session:
            await session.adapter.publish("/killed", STRING, text("x"), deadline=session.deadline(0.05))
            await asyncio.to_thread(ros.run, "/usr/bin/rosnode", "kill", session.graph.own_node)
            await session.until(lambda: not ros.publishers("/killed"), "the registration is gone")
            await session.adapter.publish("/killed", STRING, text("x"), deadline=session.deadline(0.05))
            assert ros.publishers("/killed") == [session.graph.own_node]

    asyncio.run(publish())


def test_a_closed_adapter_is_unreachable(ros: RosSystem, opened: Opening) -> None:
    async def attempt() -> None:
        async with opened(ros) as session:
            pass
        await session.adapter.close()
        with pytest.raises(Unreachable):
            await session.adapter.publish("/x", STRING, text("x"), deadline=session.deadline())

    asyncio.run(attempt())


class CountingMaster(MasterApi):
    """A real master, and the topics whose publisher was registered at it."""

    def __init__(self, uri: str) -> None:
        port = int(uri.rpartition(":")[2])
        dial = partial(asyncio.open_connection, "127.0.0.1", port)
        super().__init__(XmlRpcClient(uri, "/RPC2", lambda: asyncio.ensure_future(dial()), keep_alive=False), "/rosld")
        self.registered: list[str] = []

    async def register_publisher(self, topic: str, type_name: str, uri: str, timeout: float) -> list[str]:
        self.registered.append(topic)
        return await super().register_publisher(topic, type_name, uri, timeout)


def test_a_look_that_began_before_a_registration_does_not_have_it_said_again(ros: RosSystem) -> None:
    """rospy that is told twice of a publisher connects twice, and loses what the first connection brought."""

    async def scenario() -> None:
        now = asyncio.get_running_loop().time
        master = CountingMaster(f"http://127.0.0.1:{ros.port}")
        types = Types(TypeLibrary(ros_version=1, folders=definition_folders(())), lambda: None)
        publications = Publications(master, "/rosld", types, lambda: ["127.0.0.1"], lambda: None)
        asked_at = now()
        publishing = asyncio.ensure_future(publications.advertise("/told/once", STRING, now() + 1))
        while not publishing.done():
            publications.register_again({}, asked_at)
            await asyncio.sleep(0)
        assert master.registered == ["/told/once"]
        publications.register_again({}, asked_at)
        await asyncio.sleep(0.1)
        assert master.registered == ["/told/once"]
        publications.register_again({}, now())
        await asyncio.to_thread(ros.until, lambda: len(master.registered) == 2, "the second registration")
        await publications.close()

    asyncio.run(asyncio.wait_for(scenario(), 20))
