"""Publishing to a real ROS 1: received, matched, latched on request, validated before registration, unregistered."""

from __future__ import annotations

import asyncio
import json
import socket
from contextlib import suppress
from functools import partial

import pytest

from rosld.adapters.model import Refused, TypeRef
from rosld.adapters.model.library import TypeLibrary
from rosld.adapters.ros1.master import MasterApi
from rosld.adapters.ros1.publications import Publications
from rosld.adapters.ros1.tcpros import encode_header
from rosld.adapters.ros1.types import Types, definition_folders
from rosld.adapters.ros1.xmlrpc import Answer, XmlRpcClient, decode_answer, encode_call
from tests.adapters.ros1.conftest import opened
from tests.adapters.ros1.system import RosSystem
from tests.adapters.session import Session

pytestmark = pytest.mark.slow

STRING = TypeRef("std_msgs/msg/String")


def text(words: str) -> bytes:
    """Return a std_msgs/String as ROS 1 encodes it."""
    data = words.encode()
    return len(data).to_bytes(4, "little") + data


async def test_what_is_published_is_heard_from_the_first_message_on_and_in_order(ros: RosSystem) -> None:
    listening = [ros.node("listener.py", "/hear", "std_msgs/String") for _ in range(2)]
    async with opened(ros) as session:
        for number in range(500):
            data = text(str(number))
            published = await session.publish("/hear", STRING, data, seconds=20)
            assert published.matched == 2
        own = session.graph.own_node
        assert ros.publishers("/hear") == [own]
        assert session.graph.nodes[own].uri
        assert session.graph.topics["/hear"].type == TypeRef(STRING.name, "992ce8a1687cec8c8bd883ec73ca41d1")
        for listener in listening:
            heard = [json.loads((await asyncio.to_thread(listener.line, "heard"))[6:]) for _ in range(500)]
            assert [each["data"] for each in heard] == [str(number) for number in range(500)]


@pytest.mark.parametrize("seconds", [0.3, 1.2])
def test_a_subscriber_that_is_slow_to_notice_the_end_of_a_connection_hears_the_next(
    ros: RosSystem, seconds: float
) -> None:
    """Until it notices, it believes that it is connected; after a second rosld does not wait but notifies it again."""
    listener = ros.node("slow_hangup_node.py", "/slow", str(seconds))

    async def publish_twice() -> None:
        async with opened(ros) as session:
            for words in ("first", "second"):
                published = await session.publish("/slow", STRING, text(words))
                assert published.matched == 1
                assert (await asyncio.to_thread(listener.line, "heard")).split()[1] == words
                await session.adapter.unadvertise("/slow")

    try:
        asyncio.run(publish_twice())
    finally:
        listener.stop()


async def test_a_subscriber_that_comes_within_the_wait_gets_the_message(ros: RosSystem) -> None:
    async with opened(ros) as session:
        publishing = asyncio.ensure_future(session.publish("/late", STRING, text("worth the wait"), seconds=15))
        listener = await asyncio.to_thread(ros.node, "listener.py", "/late", "std_msgs/String")
        assert (await publishing).matched == 1
        assert "worth the wait" in await asyncio.to_thread(listener.line, "heard")
        await asyncio.to_thread(listener.stop)


async def test_a_late_subscriber_hears_what_was_latched_and_nothing_else(ros: RosSystem) -> None:
    async with opened(ros) as session:
        for topic, latch in (("/latched", True), ("/volatile", False)):
            await session.publish(topic, STRING, text("kept"), latch=latch, seconds=0.5)
            listener = await asyncio.to_thread(ros.node, "listener.py", topic, "std_msgs/String")
            await session.publish(topic, STRING, text("new"), latch=latch)
            assert ("kept" if latch else "new") in await asyncio.to_thread(listener.line, "heard")


async def test_an_address_that_does_not_answer_is_never_registered(ros: RosSystem) -> None:
    async with opened(ros, ros_ip="192.0.2.77") as session:
        with pytest.raises(Refused, match="--ros-ip"):
            await session.publish("/never", STRING, text("x"), seconds=10)
        assert ros.publishers("/never") == []


def _handshake(port: int, topic: str, **fields: str) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), timeout=5)
    connection.sendall(encode_header({"callerid": "/raw", "topic": topic, "type": "*", "md5sum": "*", **fields}))
    return connection


async def _requested(session: Session, topic: str, *protocols: str) -> Answer:
    """Return the answer of rosld's Slave API to a node that requests a topic."""
    uri = session.graph.nodes[session.graph.own_node].uri or ""
    host, _, port = uri.removeprefix("http://").rstrip("/").partition(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    body = encode_call("requestTopic", "/raw", topic, [[each] for each in protocols])
    writer.write(b"POST / HTTP/1.0\r\nContent-Length: %d\r\n\r\n" % len(body) + body)
    answer = decode_answer((await reader.read()).partition(b"\r\n\r\n")[2])
    writer.close()
    return answer


async def _tcp_port(session: Session, topic: str) -> int:
    """Return the port that rosld's Slave API reports for a topic."""
    match (await _requested(session, topic, "UDPROS", "TCPROS")).value:
        case ["TCPROS", str(), int(port)]:
            return port
        case other:
            raise AssertionError(other)


async def test_subscribers_that_ask_for_udpros_alone_are_refused(ros: RosSystem) -> None:
    async with opened(ros) as session:
        await session.publish("/asked", STRING, text("x"), seconds=0.5)
        assert (await _requested(session, "/asked", "UDPROS")).code == 0


async def test_a_subscriber_that_never_reads_costs_neither_memory_nor_time(ros: RosSystem) -> None:
    async with opened(ros) as session:
        await session.publish("/heavy", STRING, text("x"), seconds=0.5)
        with _handshake(await _tcp_port(session, "/heavy"), "/heavy") as sleeper:
            megabyte = text("y" * 1_000_000)
            for _ in range(100):
                sent = await session.publish("/heavy", STRING, megabyte)
                assert sent.matched
                await asyncio.sleep(0)
            last = text("the newest")
            await session.publish("/heavy", STRING, last)
            sleeper.settimeout(5)
            received = bytearray()
            while not received.endswith(last):
                received += sleeper.recv(1 << 20)
            assert len(received) < 60_000_000


async def test_a_subscriber_we_cannot_serve_is_told_why_and_garbage_ends_that_connection_only(ros: RosSystem) -> None:
    errors = (
        encode_header({"callerid": "/raw", "topic": "/strict", "md5sum": "0" * 32, "type": "std_msgs/Int32"}),
        encode_header({"callerid": "/raw", "topic": "/nothing_here", "md5sum": "*", "type": "*"}),
        encode_header({"probe": "1", "service": "/strict"}),
    )
    async with opened(ros) as session:
        await session.publish("/strict", STRING, text("x"), latch=True, seconds=0.5)
        port = await _tcp_port(session, "/strict")
        for hello in (*errors, b"\xff\xff\xff\xff" * 4, b"\x08\0\0\0\xff\xff\0\0abcd"):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(hello)
            answer = b""
            with suppress(ConnectionError):
                answer = await asyncio.wait_for(reader.read(), 60)
            assert (b"error=" in answer) is (hello in errors)
            writer.close()
        with _handshake(port, "/strict") as fine:
            assert b"std_msgs/String" in fine.recv(4096)


async def test_rosnode_kill_ends_what_we_publish_and_a_later_publish_begins_anew(ros: RosSystem) -> None:
    async with opened(ros) as session:
        await session.publish("/killed", STRING, text("x"), seconds=0.5)
        await asyncio.to_thread(ros.run, "/usr/bin/rosnode", "kill", session.graph.own_node)
        await session.until(lambda: not ros.publishers("/killed"), "the registration is gone")
        await session.publish("/killed", STRING, text("x"), seconds=0.5)
        assert ros.publishers("/killed") == [session.graph.own_node]


class CountingMaster(MasterApi):
    """A real master that records the topics with a registered publisher."""

    def __init__(self, uri: str) -> None:
        port = int(uri.rpartition(":")[2])
        dial = partial(asyncio.open_connection, "127.0.0.1", port)
        super().__init__(XmlRpcClient(uri, "/RPC2", lambda: asyncio.ensure_future(dial()), keep_alive=False), "/rosld")
        self.registered: list[str] = []

    async def register_publisher(self, topic: str, type_name: str, uri: str, timeout: float) -> list[str]:
        self.registered.append(topic)
        return await super().register_publisher(topic, type_name, uri, timeout)


async def test_a_look_that_began_before_a_registration_does_not_have_it_said_again(ros: RosSystem) -> None:
    """rospy connects twice when it is notified of a publisher twice, and loses the data of the first connection."""
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
