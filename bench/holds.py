"""Regularity of a hold at 50 Hz: the intervals that a subscriber sees, compared to a bare loop in the same run.

    python bench/holds.py [--seconds 10]

On the aircraft the subscriber is in the same process, and the bare loop is an asyncio task that publishes through the
same adapter at absolute times. On ROS 1 it is a rospy node, and the bare loop is a rospy publisher with `rospy.Rate`.
The ratio is that of the 99th percentiles of the deviations from 20 ms.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

RATE = 50
ROSMASTER, PYTHON = "/usr/bin/rosmaster", "/usr/bin/python3"
TWIST = {"linear": {"x": 1, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
LISTENER = """
import sys, time, rospy
from geometry_msgs.msg import Twist
times = []
def heard(message):
    times.append(time.monotonic())
    if message.linear.x == 0:
        print(*times, flush=True)
        times.clear()
rospy.init_node("wheels", anonymous=True)
rospy.Subscriber("/cmd_vel", Twist, heard, queue_size=1000, tcp_nodelay=True)
print("ready", flush=True)
rospy.spin()
"""
TALKER = """
import sys, rospy
from geometry_msgs.msg import Twist
rospy.init_node("talker", anonymous=True)
to = rospy.Publisher("/cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
while not to.get_num_connections():
    rospy.sleep(0.01)
rate, message = rospy.Rate(50), Twist()
message.linear.x = 1
for _ in range(int(50 * float(sys.argv[1]))):
    to.publish(message)
    rate.sleep()
to.publish(Twist())
rospy.sleep(0.5)
"""


def told(name: str, times: Sequence[float]) -> float:
    """Print the percentiles of the intervals in ms; return that of the deviation from the period."""
    gaps = sorted((after - before) * 1e3 for before, after in pairwise(times[1:-1]))
    off = sorted(abs(gap - 1e3 / RATE) for gap in gaps)
    cells = "".join(f"{gaps[int(part * (len(gaps) - 1))]:9.2f}" for part in (0.01, 0.5, 0.9, 0.99, 1.0))
    print(f"{name:28}{len(gaps):7}{cells}{off[int(0.99 * (len(off) - 1))]:12.2f}")
    return off[int(0.99 * (len(off) - 1))]


def asked(method: str, url: str, body: object = None) -> str:
    """Return the Location of a response."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json"}, method=method)
    with urllib.request.urlopen(request, timeout=10) as answer:
        return str(answer.headers.get("Location", ""))


@contextmanager
def started(*command: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """Run a process, and end it by its handle."""
    process = subprocess.Popen(command, env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(10)


def line(process: subprocess.Popen[str]) -> str:
    """Return the next line that it prints."""
    assert process.stdout is not None
    return process.stdout.readline().strip()


def held(url: str, topic: str, body: object, seconds: float, then: str = "zero") -> None:
    """Hold a topic for some seconds."""
    hold = asked("POST", f"{url}topics{topic}?rate={RATE}&lease=5&then={then}", body)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time.sleep(0.5)
        asked("PATCH", hold)
    asked("DELETE", hold)


async def on_the_aircraft(seconds: float) -> float:
    """Return the ratio on the embedded aircraft, whose subscriber records when the adapter delivers a message."""
    from rosld.adapters.base import AdapterOptions
    from rosld.adapters.registry import adapter_for
    from rosld.server.app import create_app
    from rosld.server.serving.http_server import Server, bind
    from rosld.server.serving.lifespan import lifespan
    from rosld.server.settings import Settings, address

    adapter = adapter_for("aircraft", AdapterOptions())
    sock = bind("127.0.0.1", 0)
    port = sock.getsockname()[1]
    url = address("127.0.0.1", port)
    app = create_app(adapter, Settings(base_url=url, port=port))
    ready = asyncio.Event()
    server = Server(app, ready.set)
    async with lifespan(app):
        serving = asyncio.ensure_future(server.serve(sockets=[sock]))
        await ready.wait()
        times: list[float] = []
        subscription = await adapter.subscribe("/cockpit/display")
        watch = subscription.watch(lambda: times.append(time.monotonic()))
        await asyncio.to_thread(held, url, "/cockpit/display", {"data": "on"}, seconds)
        ours = told("aircraft: hold", times)
        times.clear()
        loop, kind = asyncio.get_running_loop(), adapter.graph.topics["/cockpit/display"].type
        assert kind is not None
        began = loop.time()
        for turn in range(1, int(RATE * seconds)):
            await asyncio.sleep(began + turn / RATE - loop.time())
            await adapter.publish("/cockpit/display", kind, b"\2\0\0\0on", deadline=loop.time() + 1)
        await asyncio.sleep(0.1)
        bare = told("aircraft: bare asyncio", times)
        watch.close()
        subscription.close()
        app.end_streams()
        server.should_exit = True
        await serving
    return ours / bare


def on_ros1(seconds: float) -> float:
    """Return the ratio on a real ROS 1."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        master = {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_HOME": folder}
        ros = {**master, "ROS_LOG_DIR": folder, "PYTHONUNBUFFERED": "1", "PATH": "/usr/bin:/bin"}
        with started(ROSMASTER, "--core", "-p", str(port), **ros):
            _wait_for(port)
            with started(PYTHON, "-c", LISTENER, **ros) as wheels:
                assert line(wheels) == "ready"
                source = f"ros1://127.0.0.1:{port}"
                with started(sys.executable, "-m", "rosld", "serve", source, "--port", "0") as served:
                    held(line(served), "/cmd_vel", TWIST, seconds)
                    ours = told("ROS 1: hold", [float(one) for one in line(wheels).split()])
                with started(PYTHON, "-c", TALKER, str(seconds), **ros):
                    bare = told("ROS 1: bare rospy", [float(one) for one in line(wheels).split()])
    return ours / bare


def _wait_for(port: int) -> None:
    for _ in range(200):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)


def main() -> None:
    """Print the table."""
    import uvloop

    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=10.0)
    seconds = parser.parse_args().seconds
    print(
        f"{'intervals at 50 Hz, ms':28}{'n':>7}{'1 %':>9}{'50 %':>9}{'90 %':>9}{'99 %':>9}{'most':>9}{'off, 99 %':>12}"
    )
    ratios = {"aircraft": uvloop.run(on_the_aircraft(seconds))}
    if Path(ROSMASTER).exists():
        ratios["ROS 1"] = on_ros1(seconds)
    for name, ratio in ratios.items():
        print(f"{name}: deviation {ratio:.2f} of that of the bare loop")


if __name__ == "__main__":
    main()
