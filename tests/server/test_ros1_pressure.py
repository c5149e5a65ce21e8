"""Publishers of a real ROS 1 that send or announce much data: none waits for rosld, and none exhausts its memory."""

from __future__ import annotations

import signal
import socket
import struct
import threading
import time
import xmlrpc.server
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from rosld.adapters.ros1.tcpros import MAX_BYTES, decode_header, encode_header, enlarge, max_permitted_bytes
from tests.adapters.ros1.system import RosSystem, running
from tests.processes import Process
from tests.waiting import until

pytestmark = pytest.mark.slow

STRING = {"type": "std_msgs/String", "md5sum": "992ce8a1687cec8c8bd883ec73ca41d1", "latching": "0"}
MEGABYTE = 1_000_000
HUGE = 511 * 1024 * 1024


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        yield system


@contextmanager
def announcing(ros: RosSystem, topic: str, length: int, data: bytes) -> Iterator[threading.Event]:
    """Run a publisher that announces a message of a length and sends only its beginning, and then sets the event."""
    node, sent, connected = f"/announcing{topic}", threading.Event(), []

    def serve(listening: socket.socket) -> None:
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            connected.append(connection)
            asked = connection.recv(4, socket.MSG_WAITALL)
            decode_header(connection.recv(struct.unpack("<I", asked)[0], socket.MSG_WAITALL))
            hello = {**STRING, "callerid": node, "topic": topic, "message_definition": "string data\n"}
            connection.sendall(encode_header(hello) + struct.pack("<I", length) + data)
            sent.set()

    with socket.create_server(("127.0.0.1", 0)) as listening, ExitStack() as ending:
        slave = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        address = ["TCPROS", "127.0.0.1", listening.getsockname()[1]]
        slave.register_function(lambda *_: [1, "", address], "requestTopic")
        threads = [threading.Thread(target=serve, args=(listening,)), threading.Thread(target=slave.serve_forever)]
        for thread in threads:
            thread.start()
            ending.callback(thread.join)
        ending.callback(slave.server_close)
        ending.callback(slave.shutdown)
        ending.callback(listening.shutdown, socket.SHUT_RDWR)
        uri = f"http://127.0.0.1:{slave.server_address[1]}/"
        ros.master.registerPublisher(node, topic, "std_msgs/String", uri)
        try:
            yield sent
        finally:
            for connection in connected:
                connection.close()


def peak_megabytes(served: Any) -> float:
    """Return the peak memory of a server."""
    told = Path(f"/proc/{served.process.pid}/status").read_text()
    return int(next(line.split()[1] for line in told.splitlines() if line.startswith("VmHWM:"))) / 1024


def test_eight_publishers_that_announce_half_a_gigabyte_each_cost_little(
    ros: RosSystem, serve: Callable[..., Any]
) -> None:
    served = serve(
        ros.source, "--setting", "message_limit", str(2 * HUGE), "--setting", "first_value_wait", "0.1", process=True
    )
    before = peak_megabytes(served)
    with ExitStack() as publishing:
        topics = [f"/big_{number}" for number in range(8)]
        sent = [publishing.enter_context(announcing(ros, topic, HUGE, b"x" * 200_000)) for topic in topics]
        for topic, event in zip(topics, sent, strict=True):
            until(lambda at=topic: served.http.get(f"/topics{at}").status_code == 200, topic)
            assert event.wait(10)
            assert served.http.get(f"/topics{topic}", headers={"Accept": "application/json"}).json() is None
        assert peak_megabytes(served) - before < 150


def test_a_message_longer_than_the_limit_is_not_read_and_the_topic_says_so(
    ros: RosSystem, serve: Callable[..., Any]
) -> None:
    served = serve(ros.source)
    with announcing(ros, "/big", HUGE, b"") as sent:
        until(lambda: served.http.get("/topics/big").status_code == 200, "the topic")
        assert sent.wait(10)
        until(lambda: f"message of {HUGE} bytes" in served.http.get("/topics/big").text, "the reason")
        assert "--setting message_limit" in served.http.get("/topics/big").text


def held_megabytes() -> int:
    """Return how much the kernel buffers for one of our connections, in megabytes."""
    with socket.socket() as probe:
        enlarge(probe, MAX_BYTES)
        granted = probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    return max(granted, max_permitted_bytes(), 2 * MEGABYTE) // MEGABYTE


def longest(lines: Sequence[str]) -> float:
    """Return the longest delay that a steady node reported, in seconds."""
    return max(float(line.split()[1]) for line in lines)


def test_while_rosld_is_suspended_for_a_second_no_publisher_waits(ros: RosSystem, serve: Callable[..., Any]) -> None:
    rate = min(30, held_megabytes())
    steady = ros.node("steady_node.py", "/steady", str(MEGABYTE), str(rate))
    served = serve(ros.source, "--subscribe", "/steady", process=True)
    until(lambda: steady.seen[-1].endswith(" 1"), "rosld reads")
    waited: list[tuple[float, float]] = []
    for _ in range(4):  # the rate of data is measured in seconds in which all processes run, and others use the cores
        time.sleep(3)
        waited.append(suspended(served, steady))
        if waited[-1][0] < waited[-1][1] - 0.7:  # of the second that is reserved for it
            break
    else:
        pytest.fail(f"the publisher waited for most of the time that rosld was suspended: {waited}")
    assert steady.seen[-1].endswith(" 1")


def suspended(served: Any, steady: Process) -> tuple[float, float]:
    """Suspend rosld for more than a second; return the longest delay of a publisher, and its permitted maximum."""
    told = len(steady.seen)
    usual = longest(steady.seen[1:])  # on a busy machine a node waits for other processes, too
    began = time.monotonic()
    served.process.send_signal(signal.SIGSTOP)
    time.sleep(1.2)
    served.process.send_signal(signal.SIGCONT)
    served.http.get("/").raise_for_status()
    took = time.monotonic() - began
    until(lambda: len(steady.seen) > told + 4, "what the publisher noticed")
    return longest(steady.seen[told:]), took + min(usual, 0.5)
