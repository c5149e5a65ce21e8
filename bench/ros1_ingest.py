"""ROS 1 ingest: messages a second that rosld's subscription takes while nobody reads, against a raw receive loop.

    python bench/ros1_ingest.py [--seconds 3] [--rounds 3]

One sender, a real publisher in the eyes of a real rosmaster, writes the same frames as fast as they are taken: to
rosld's adapter, and to a bare asyncio protocol that receives in bulk, walks the frames and counts them. Both run in
turn, on a thread of their own, in one process, and the best round of each counts. The target is a ratio of 0.9.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import xmlrpc.client
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rosld.adapters.base import AdapterOptions
from rosld.adapters.ros1 import adapter
from rosld.adapters.ros1.publications import SlaveApi, XmlRpcServer
from rosld.adapters.ros1.tcpros import decode_header, encode_header

ROSMASTER = "/usr/bin/rosmaster"
TOPIC = "/bench/ingest"
DEFINITION = "string data\n"
MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
SIZES = {"64 B": 64, "4.4 kB": 4_400, "1 MB": 1_000_000}
BATCH = 1_000_000


class Deaf:
    """A sink that ignores everything."""

    def graph_changed(self, graph: object) -> None: ...

    def parameter_changed(self, name: str) -> None: ...


class Sender:
    """The publisher's side of the Slave API."""

    def __init__(self, port: int) -> None:
        self.port = port

    def topics(self) -> list[tuple[str, str]]:
        """The one topic."""
        return [(TOPIC, "std_msgs/String")]


def _frames(size: int) -> bytes:
    """Return frames of strings, about a megabyte in total."""
    body = struct.pack("<I", size) + b"x" * size
    one = struct.pack("<I", len(body)) + body
    return one * max(1, BATCH // len(one))


def _pour(connection: socket.socket, frames: bytes) -> None:
    """Answer the header of a subscriber, then write frames until it disconnects."""
    with connection:
        (length,) = struct.unpack("<I", connection.recv(4, socket.MSG_WAITALL))
        decode_header(connection.recv(length, socket.MSG_WAITALL))
        fields = {"callerid": "/sender", "type": "std_msgs/String", "md5sum": MD5, "message_definition": DEFINITION}
        connection.sendall(encode_header({**fields, "topic": TOPIC, "latching": "0"}))
        try:
            while True:
                connection.sendall(frames)
        except OSError:
            return


def send(size: int, master: str) -> None:
    """Publish, in a separate process, until stdin ends."""
    listening = socket.create_server(("127.0.0.1", 0))
    port = listening.getsockname()[1]
    frames = _frames(size)

    def accept() -> None:
        while True:
            connection, _ = listening.accept()
            threading.Thread(target=_pour, args=(connection, frames), daemon=True).start()

    async def slave() -> None:
        server = XmlRpcServer(SlaveApi(master, "127.0.0.1", Sender(port), lambda _: None).answer)
        uri = f"http://127.0.0.1:{await server.start('127.0.0.1')}/"
        xmlrpc.client.ServerProxy(master).registerPublisher("/sender", TOPIC, "std_msgs/String", uri)
        print(port, flush=True)
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)

    threading.Thread(target=accept, daemon=True).start()
    asyncio.run(slave())


@contextmanager
def rosmaster() -> Iterator[str]:
    """Run a real rosmaster on a free port; yield its URI."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        environment = {"ROS_HOME": folder, "ROS_LOG_DIR": folder, "ROS_IP": "127.0.0.1", "PATH": "/usr/bin:/bin"}
        process = subprocess.Popen(
            [ROSMASTER, "--core", "-p", str(port)],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            _wait_for(port)
            yield f"http://127.0.0.1:{port}"
        finally:
            process.terminate()
            process.wait(10)


def _wait_for(port: int) -> None:
    until = time.monotonic() + 20
    while time.monotonic() < until:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise SystemExit("rosmaster did not start")


@contextmanager
def sender(size: int, master: str) -> Iterator[int]:
    """Run a sender; yield its TCPROS port."""
    command = [sys.executable, __file__, "--send", str(size), "--master", master]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield int(process.stdout.readline())
    finally:
        process.kill()
        process.wait(10)


class RawReceiver(asyncio.BufferedProtocol):
    """The baseline: receives in bulk, walks the frames, counts them."""

    def __init__(self) -> None:
        self.count = 0
        self._buffer = bytearray(2 * 1024 * 1024)
        self._view = memoryview(self._buffer)
        self._end = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        hello = {"callerid": "/raw", "topic": TOPIC, "type": "*", "md5sum": "*"}
        transport.write(encode_header(hello))  # type: ignore[attr-defined]

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._view[self._end :]

    def buffer_updated(self, nbytes: int) -> None:
        buffer, unpack = self._buffer, struct.Struct("<I").unpack_from
        end = self._end + nbytes
        position = 0
        while end - position >= 4:
            stop = position + 4 + unpack(buffer, position)[0]
            if stop > end:
                break
            position = stop
            self.count += 1
        rest = end - position
        if position and rest:
            buffer[:rest] = buffer[position:end]
        self._end = rest


def raw_rate(port: int, seconds: float) -> float:
    """Return the frames per second of the bare protocol, on its own thread."""
    rates: list[float] = []

    async def receive() -> None:
        transport, protocol = await asyncio.get_running_loop().create_connection(RawReceiver, "127.0.0.1", port)
        await asyncio.sleep(0.3)
        began, first = time.monotonic(), protocol.count
        await asyncio.sleep(seconds)
        rates.append((protocol.count - first) / (time.monotonic() - began))
        transport.abort()

    thread = threading.Thread(target=lambda: asyncio.run(receive()))
    thread.start()
    thread.join()
    return rates[0]


async def rosld_rate(master: str, seconds: float) -> float:
    """Return the messages per second of rosld's subscription without readers."""
    opened = adapter(f"ros1://{master.removeprefix('http://')}", AdapterOptions())
    await opened.open(Deaf(), deadline=asyncio.get_running_loop().time() + 10)
    try:
        subscription = await opened.subscribe(TOPIC)
        arrived = asyncio.Event()
        watch = subscription.watch(arrived.set)
        await asyncio.wait_for(arrived.wait(), 10)
        watch.close()
        await asyncio.sleep(0.3)
        began, first = time.monotonic(), subscription.latest()[0].sequence
        await asyncio.sleep(seconds)
        return (subscription.latest()[0].sequence - first) / (time.monotonic() - began)
    finally:
        await opened.close()


def measure(seconds: float, rounds: int) -> list[tuple[str, float, float]]:
    """Return (size, raw frames per second, rosld's messages per second) for each size, the best of some rounds."""
    rows = []
    with rosmaster() as master:
        for name, size in SIZES.items():
            with sender(size, master) as port:
                raw, ours = [], []
                for _ in range(rounds):
                    raw.append(raw_rate(port, seconds))
                    ours.append(asyncio.run(rosld_rate(master, seconds)))
            rows.append((name, max(raw), max(ours)))
    return rows


def main() -> None:
    """Measure and print one line per size."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    options.add_argument("--seconds", type=float, default=2.0)
    options.add_argument("--rounds", type=int, default=3)
    options.add_argument("--send", type=int, help=argparse.SUPPRESS)
    options.add_argument("--master", default=os.environ.get("ROS_MASTER_URI", ""), help=argparse.SUPPRESS)
    chosen = options.parse_args()
    if chosen.send is not None:
        send(chosen.send, chosen.master)
    elif not Path(ROSMASTER).exists():
        print("ros1 ingest: skipped, there is no rosmaster here (apt-get install python3-rosmaster)")
    else:
        for name, raw, ours in measure(chosen.seconds, chosen.rounds):
            rates = f"{ours:>10,.0f}/s  raw {raw:>10,.0f}/s"
            print(f"ros1 ingest of {name:>6}: {rates}  ratio {ours / raw:.2f}  (target 0.90)")


if __name__ == "__main__":
    main()
