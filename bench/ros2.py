"""ROS 2: what rosld costs beside many topics while nobody looks, what a look costs, and how fast a PUT arrives.

    python bench/ros2.py [--topics 200] [--seconds 10] [--puts 300]

One talker publishes on all topics at 50 Hz. A bare rclpy subscriber to all of them on the default executor, and rosld's
adapter, each in its own process, measure their CPU time (target: a ratio of 0.2): the adapter without subscriptions, as
after a minute without reads, and while it is subscribed to all topics that nobody reads. Then rosld reads all of them
once (target: 20 ms). The memory of rosld is compared before and after the run, with a read per second. Finally, strings
are put to a topic over HTTP and published by a bare rclpy publisher in turn; the same subscriber measures their delay.

Runs in the venv of `make ros2`, or in a Python with rclpy.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import http.client
import importlib.util
import json
import os
import random
import resource
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

ROOT = Path(__file__).parents[1]
VENV = ROOT / ".venv-ros2-jazzy" / "bin" / "python"
PERIOD = 0.02
LATENCY = "/bench/latency"
LOOKS = 20


def topic(number: int) -> str:
    """Return the name of a topic."""
    return f"/bench/topic_{number}"


def talk(options: argparse.Namespace) -> None:
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from std_msgs.msg import Float64

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("talker")
    ending = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ending.set())
    publishers = [node.create_publisher(Float64, topic(number), 10) for number in range(options.topics)]
    print("ready", flush=True)
    count, due = 0.0, time.monotonic()
    while not ending.wait(max(0.0, due - time.monotonic())):
        count, due = count + 1, max(due + PERIOD, time.monotonic())
        message = Float64(data=count)
        for publisher in publishers:
            publisher.publish(message)
    rclpy.shutdown()


def listen(options: argparse.Namespace) -> None:
    """Subscribe to all topics on the default executor, as the baseline, and print the CPU time."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import Float64

    rclpy.init()
    node = rclpy.create_node("bare")
    heard = [0] * options.topics

    def hear(number: int) -> None:
        heard[number] += 1

    for number in range(options.topics):
        node.create_subscription(Float64, topic(number), lambda _, number=number: hear(number), 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not all(heard):
        executor.spin_once(timeout_sec=0.1)
    began, used, first = time.monotonic(), time.process_time(), sum(heard)
    while time.monotonic() < began + options.seconds:
        executor.spin_once(timeout_sec=0.1)
    lasted = time.monotonic() - began
    told = {"cpu": (time.process_time() - used) / lasted, "rate": (sum(heard) - first) / lasted}
    print(json.dumps(told), flush=True)
    rclpy.shutdown()


class Deaf:
    """A sink that ignores everything."""

    def graph_changed(self, graph: object) -> None: ...

    def parameter_changed(self, name: str) -> None: ...

    def goal_changed(self, goal: object, event: object) -> None: ...


def held() -> float:
    """Return the memory of this process in megabytes."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


async def until(true: Callable[[], bool]) -> None:
    """Wait until a condition holds."""

    async def seen() -> None:
        while not true():  # noqa: ASYNC110
            await asyncio.sleep(0.1)

    await asyncio.wait_for(seen(), 30)


async def used_in(seconds: float) -> float:
    """Return the share of a core that this process uses during the interval."""
    began, used = time.monotonic(), time.process_time()
    await asyncio.sleep(seconds)
    return (time.process_time() - used) / (time.monotonic() - began)


async def look(options: argparse.Namespace) -> dict[str, float]:
    """Print the CPU time of rosld's adapter before and while it subscribes to all topics, then its memory."""
    from rosld.adapters.base import AdapterOptions
    from rosld.adapters.ros2 import adapter

    opened = adapter(f"ros2:?domain={os.environ['ROS_DOMAIN_ID']}", AdapterOptions())
    await opened.open(Deaf(), deadline=asyncio.get_running_loop().time() + 20)  # type: ignore[arg-type]
    try:
        names = [topic(number) for number in range(options.topics)]
        await until(lambda: opened.graph.topics.keys() >= set(names))
        await asyncio.sleep(2)
        idle = await used_in(options.seconds)
        subscriptions = [await opened.subscribe(name) for name in names]
        await until(lambda: all(one.latest() for one in subscriptions))
        before = held()
        cpu = await used_in(options.seconds)
        took = []
        for _ in range(LOOKS):
            at = time.perf_counter()
            seen = [one.latest() for one in subscriptions]
            took.append(time.perf_counter() - at)
            assert all(seen)
            await asyncio.sleep(options.seconds / LOOKS)
        return {"idle": idle, "cpu": cpu, "look": statistics.median(took), "before": before, "after": held()}
    finally:
        await opened.close()


def receive(options: argparse.Namespace) -> None:
    """Print the delay of each received string, which is the time when it was sent."""
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node("receiver")

    def hear(message: Any) -> None:
        print(time.monotonic_ns() - int(message.data), flush=True)

    node.create_subscription(String, LATENCY, hear, 100)
    print("ready", flush=True)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


def publish(options: argparse.Namespace) -> None:
    """Publish the time for each line read, as the baseline."""
    import rclpy
    from std_msgs.msg import String

    rclpy.init()
    node = rclpy.create_node("sender")
    publisher = node.create_publisher(String, LATENCY, 100)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    print("ready", flush=True)
    for _ in sys.stdin:
        publisher.publish(String(data=str(time.monotonic_ns())))
    rclpy.shutdown()


@contextmanager
def role(name: str, options: argparse.Namespace, domain: int) -> Iterator[subprocess.Popen[str]]:
    """Run a process for one part; end it by its own handle."""
    given = [f"--topics={options.topics}", f"--seconds={options.seconds}"]
    with running([sys.executable, __file__, "--role", name, *given], domain) as process:
        yield process


@contextmanager
def running(command: Sequence[str], domain: int) -> Iterator[subprocess.Popen[str]]:
    """Run a process in a domain, on loopback."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(3)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(10)


def line(process: subprocess.Popen[str]) -> str:
    """Return the next line that a process prints."""
    assert process.stdout is not None
    return process.stdout.readline().strip()


def latencies(options: argparse.Namespace, domain: int) -> tuple[float, float]:
    """Return the median seconds from sending to receiving: of a bare publisher, and of a PUT."""
    with role("receive", options, domain) as receiver:
        assert line(receiver) == "ready"
        with role("publish", options, domain) as sender:
            assert line(sender) == "ready"
            assert sender.stdin is not None
            bare = []
            for _ in range(options.puts):
                print(file=sender.stdin, flush=True)
                bare.append(int(line(receiver)) / 1e9)
        command = [sys.executable, "-m", "rosld", "serve", f"ros2:?domain={domain}", "--port", "0"]
        with running([*command, "--max-publish-rate", "100000"], domain) as server:
            host = urlsplit(line(server)).netloc
            client = http.client.HTTPConnection(host, timeout=20)

            def put() -> int:
                body = json.dumps({"data": str(time.monotonic_ns())})
                client.request("PUT", f"/topics{LATENCY}", body, {"Content-Type": "application/json"})
                answer = client.getresponse()
                answer.read()
                return answer.status

            until = time.monotonic() + 30
            while put() != 204:
                assert time.monotonic() < until, "rosld never found the subscriber"
                time.sleep(0.1)
            line(receiver)
            ours = []
            for _ in range(options.puts):
                assert put() == 204
                ours.append(int(line(receiver)) / 1e9)
            client.close()
    return statistics.median(bare), statistics.median(ours)


def measure(options: argparse.Namespace) -> None:
    """Measure and print."""
    domain = random.SystemRandom().randrange(1, 101)
    with role("talk", options, domain) as talker:
        assert line(talker) == "ready"
        with role("listen", options, domain) as process:
            bare = json.loads(line(process))
        with role("look", options, domain) as process:
            ours = json.loads(line(process))
    baseline = f"bare rclpy {bare['cpu']:.1%} for {bare['rate']:,.0f}/s"
    for when, cpu in (("nobody has looked", ours["idle"]), ("subscribed to, nobody looks", ours["cpu"])):
        print(f"ros2 {options.topics} topics of 50 Hz, {when}: {cpu:.1%} of a core  {baseline}", end="")
        print(f"  ratio {cpu / bare['cpu']:.2f}  (target 0.20)")
    print(f"ros2 one look at all of them: {ours['look'] * 1e3:6.1f} ms  (target 20 ms)")
    grown = ours["after"] - ours["before"]
    print(f"ros2 memory after {2 * options.seconds:g} s: {ours['after']:,.0f} MB, grown by {grown:.1f} MB")
    one, other = latencies(options, domain)
    ratio = other / one
    print(f"ros2 PUT to subscriber: {other * 1e3:.2f} ms  bare rclpy publish {one * 1e3:.2f} ms  ratio {ratio:.1f}")


ROLES = {"talk": talk, "listen": listen, "receive": receive, "publish": publish}


def main() -> int:
    """Run one part, or all parts if there is an rclpy."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--topics", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--puts", type=int, default=300)
    parser.add_argument("--role", choices=[*ROLES, "look"], help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role == "look":
        print(json.dumps(asyncio.run(look(options))), flush=True)
    elif options.role is not None:
        ROLES[options.role](options)
    elif importlib.util.find_spec("rclpy") is not None:
        measure(options)
    elif VENV.exists():
        return subprocess.run([str(VENV), __file__, *sys.argv[1:]], check=False).returncode
    else:
        print("ros2: skipped, there is no rclpy here (make ros2 makes a venv that has one)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
