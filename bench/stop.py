"""Latency of the stop in ms at full load: from the request until a base without a watchdog receives zero.

    python bench/stop.py [--rounds 100] [--robots rover ros1 jazzy kilted] [--options=--stop-ready]

In each round another node commands the base, once, so that it drives on; then the robot is stopped, and released. The
base is the embedded rover, a rospy node or an rclpy node, without a mapping, and its own clock measures when the first
zero was received. On ROS the command is another node's: rosld publishes to the base for the first time with each stop,
unless the server has the option --stop-ready. The load: 8 clients with queries that run into the time limit, 16 calls
of a service that does not answer, and 16 clients that read as fast as possible. For comparison, the same without load.
Target: 200 ms, every time.
"""

from __future__ import annotations

import argparse
import asyncio
import http.client
import json
import logging
import math
import os
import queue
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlencode

sys.path.insert(0, str(Path(__file__).parents[1]))

from rosld.adapters.base import AdapterOptions, Published
from rosld.adapters.model import TimedOut, TypeRef
from rosld.adapters.rover.adapter import CMD_VEL, SET_LIGHTS, Rover
from rosld.adapters.rover.simulation import read_source
from tests.adapters.ros1 import system as ros1
from tests.ros2 import distros
from tests.server.robots.made_up import served

AIM = 200.0
HEAVY = "/sparql?" + urlencode({"query": "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i }", "timeout": 2})
JSON = {"Content-Type": "application/json", "Accept": "application/json"}
AHEAD = '{"linear": {"x": 0.2, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}'
PATIENCE = 60.0
_CDR_HEADER = 4

ROSPY_BASE = """
import time, rospy
from geometry_msgs.msg import Twist
speed = 0.0
def drive(command):
    global speed
    if command.linear.x != speed:
        speed = command.linear.x
        print(speed, time.monotonic(), flush=True)
rospy.init_node("base")
rospy.Subscriber("/cmd_vel", Twist, drive, queue_size=100)
print("ready", flush=True)
rospy.spin()
"""
ROSPY_COMMANDER = """
import sys, threading, time, rospy
from geometry_msgs.msg import Twist
from std_msgs.msg import String
from std_srvs.srv import Trigger
rospy.init_node("commander")
to = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
state = rospy.Publisher("/state", String, queue_size=1, latch=True)
state.publish("driving")
rospy.Service("/slow", Trigger, lambda _: time.sleep(3600))
while not to.get_num_connections():
    time.sleep(0.01)
ahead = Twist()
ahead.linear.x = 0.2
print("ready", flush=True)
for _ in sys.stdin:
    to.publish(ahead)
"""
RCLPY_BASE = """
import time, rclpy
from geometry_msgs.msg import Twist
rclpy.init()
node = rclpy.create_node("base")
speed = 0.0
def drive(command):
    global speed
    if command.linear.x != speed:
        speed = command.linear.x
        print(speed, time.monotonic(), flush=True)
node.create_subscription(Twist, "/cmd_vel", drive, 100)
print("ready", flush=True)
rclpy.spin(node)
"""
RCLPY_COMMANDER = """
import sys, threading, time, rclpy
from geometry_msgs.msg import Twist
from std_msgs.msg import String
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("commander")
to, state = node.create_publisher(Twist, "/cmd_vel", 1), node.create_publisher(String, "/state", 1)
slow = node.create_service(Trigger, "/slow", lambda _, response: response)
def tell():
    while True:
        state.publish(String(data="driving"))
        time.sleep(0.1)
threading.Thread(target=tell, daemon=True).start()
while not to.get_subscription_count():
    time.sleep(0.01)
ahead = Twist()
ahead.linear.x = 0.2
print("ready", flush=True)
for _ in sys.stdin:
    to.publish(ahead)
"""


class Client:
    """One persistent connection."""

    def __init__(self, address: str) -> None:
        self._connection = http.client.HTTPConnection(address, timeout=60)

    def ask(self, method: str, path: str, body: str | None = None, headers: dict[str, str] = JSON) -> int:
        """Return the status of a response, whose body is then in `body`."""
        self._connection.request(method, path, body, headers)
        answer = self._connection.getresponse()
        self.body = answer.read()
        return answer.status


@dataclass(frozen=True)
class Robot:
    """A base behind a server: its command, the speeds that it received with their times, and its load."""

    address: str
    command: Callable[[], None]
    speeds: queue.Queue[tuple[float, float]]
    service: str
    topic: str

    def told(self, still: bool, patience: float = PATIENCE) -> float:
        """Return when the base next received zero, or another speed; infinity if it did not."""
        while True:
            try:
                speed, moment = self.speeds.get(timeout=patience)
            except queue.Empty:
                return math.inf
            if (speed == 0.0) is still:
                return moment


class Watched(Rover):
    """The rover, which records the speeds that it receives; its lights are never switched."""

    def __init__(self, options: AdapterOptions) -> None:
        super().__init__(read_source("rover"), options)
        self.speeds: queue.Queue[tuple[float, float]] = queue.Queue()

    async def publish(
        self, topic: str, type: TypeRef, data: bytes, *, latch: bool = False, deadline: float
    ) -> Published:
        published = await super().publish(topic, type, data, latch=latch, deadline=deadline)
        if topic == CMD_VEL:
            self.speeds.put((float(any(data[_CDR_HEADER:])), time.monotonic()))
        return published

    async def call(self, service: str, type: TypeRef, request: bytes, *, deadline: float) -> bytes:
        await asyncio.sleep(max(0.0, deadline - asyncio.get_running_loop().time()))
        raise TimedOut(f"{service} does not answer")


@contextmanager
def rover() -> Iterator[Robot]:
    """Serve the embedded rover here; rosld itself commands it."""
    adapter = Watched(AdapterOptions())
    with served(adapter, call_deadline=30.0) as client:
        address = client.base_url.netloc.decode()

        def command() -> None:
            assert Client(address).ask("PUT", f"/topics{CMD_VEL}", AHEAD) == 204

        yield Robot(address, command, adapter.speeds, SET_LIGHTS, "/odom")


@contextmanager
def rospy(options: Sequence[str]) -> Iterator[Robot]:
    """Run a rospy base under a rosmaster."""
    with tempfile.TemporaryDirectory() as folder, ros1.running(Path(folder)) as system:
        python = [ros1.PYTHON, "-c"]
        with (
            node([*python, ROSPY_BASE], system.environment) as base,
            node([*python, ROSPY_COMMANDER], system.environment) as commander,
            of_nodes(sys.executable, system.source, dict(os.environ), base, commander, options) as robot,
        ):
            yield robot


@contextmanager
def rclpy(name: str, options: Sequence[str]) -> Iterator[Robot]:
    """Run an rclpy base of a distro."""
    python = distros.made(name).python
    with distros.free_domain() as domain:
        environment = distros.environment(domain)
        with (
            node([python, "-c", RCLPY_BASE], environment) as base,
            node([python, "-c", RCLPY_COMMANDER], environment) as commander,
            of_nodes(python, f"ros2:?domain={domain}", environment, base, commander, options) as robot,
        ):
            yield robot


@contextmanager
def node(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Run a process, wait until it reports that it is ready, and kill it at the end."""
    with subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@contextmanager
def of_nodes(
    python: str,
    source: str,
    environment: dict[str, str],
    base: subprocess.Popen[str],
    commander: subprocess.Popen[str],
    options: Sequence[str],
) -> Iterator[Robot]:
    """Run the base and its commander with a rosld in its own process."""
    for each in (base, commander):
        assert each.stdout is not None
        assert each.stdout.readline().strip() == "ready"
    speeds: queue.Queue[tuple[float, float]] = queue.Queue()

    def listen() -> None:
        assert base.stdout is not None
        for line in base.stdout:
            speed, moment = map(float, line.split())
            speeds.put((speed, moment))

    def command() -> None:
        assert commander.stdin is not None
        commander.stdin.write("\n")

    threading.Thread(target=listen, daemon=True).start()
    serve = [python, "-m", "rosld", "serve", source, "--port", "0", "--setting", "call_deadline", "30"]
    serve += options
    with subprocess.Popen(
        serve, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        try:
            assert server.stdout is not None
            address = server.stdout.readline().strip().removeprefix("http://").rstrip("/")
            client = Client(address)
            until = time.monotonic() + PATIENCE
            while not all(client.ask("GET", path) == 200 for path in ("/topics/cmd_vel", "/services/slow")):
                assert time.monotonic() < until, "the robot was not found"
                time.sleep(0.1)
            yield Robot(address, command, speeds, "/slow", "/state")
        finally:
            server.kill()


ROBOTS: dict[str, Callable[[Sequence[str]], AbstractContextManager[Robot]]] = {
    "rover": lambda _: rover(),
    "ros1": rospy,
    "jazzy": lambda options: rclpy("jazzy", options),
    "kilted": lambda options: rclpy("kilted", options),
}


def load(address: str, service: str, topic: str) -> None:
    """Generate the whole load, for ever."""

    def again(path: str) -> None:
        client = Client(address)
        while True:
            client.ask("GET", path)

    def call() -> None:
        client = Client(address)
        while True:
            client.ask("POST", f"/services{service}", "{}")
            time.sleep(0.01)

    works: list[Callable[[], None]] = [lambda: again(HEAVY)] * 8 + [call] * 16 + [lambda: again(f"/topics{topic}")] * 16
    for work in works:
        threading.Thread(target=work, daemon=True).start()
    time.sleep(3)
    print("ready", flush=True)
    time.sleep(3600)


def press(address: str) -> None:
    """Stop the robot at each input line, print the time of the request, then release it."""
    client = Client(address)
    for _ in sys.stdin:
        moment = time.monotonic()
        assert client.ask("POST", "/stop") == 200
        told = json.loads(client.body)
        if told["warning"] or any(step["words"] for step in told["steps"]):
            print(told["warning"], told["steps"], file=sys.stderr, flush=True)
        print(moment, flush=True)
        client.ask("GET", "/stop", headers={"Accept": "text/html"})
        confirm = client.body.split(b'name="?confirm" value="')[1].split(b'"')[0].decode()
        while client.ask("DELETE", f"/stop?confirm={confirm}") == 409:
            time.sleep(0.01)
        print("released", flush=True)


def measured(robot: Robot, rounds: int) -> list[float]:
    """Return the milliseconds from each request until the base received zero."""
    found = []
    with subprocess.Popen(
        [sys.executable, __file__, "--press", robot.address],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        bufsize=1,
    ) as pressing:
        assert pressing.stdin is not None
        assert pressing.stdout is not None
        for _ in range(rounds):
            robot.command()
            robot.told(still=False, patience=10.0)  # a base that was not stopped drives already
            pressing.stdin.write("\n")
            pressed = float(pressing.stdout.readline())
            found.append((robot.told(still=True, patience=10.0) - pressed) * 1e3)
            assert pressing.stdout.readline().strip() == "released"
        pressing.stdin.close()
    return sorted(found)


def measure(name: str, rounds: int, options: Sequence[str]) -> bool:
    """Print the rows of a robot; return whether it always stopped in time."""
    with ROBOTS[name](options) as robot:
        rows = {"alone": measured(robot, rounds)}
        command = [sys.executable, __file__, "--load", robot.address, robot.service, robot.topic]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as loading:
            try:
                assert loading.stdout is not None
                loading.stdout.readline()
                rows["at full load"] = measured(robot, rounds)
            finally:
                loading.kill()
    for row, found in rows.items():
        tenth = found[int(0.9 * (len(found) - 1))]
        print(f"{name + ', ' + row:24}{statistics.median(found):9.1f}{tenth:9.1f}{found[-1]:9.1f}", flush=True)
    return all(found[-1] < AIM for found in rows.values())


def main() -> None:
    """Print the table; return 1 if a base stopped too late."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=100)
    parser.add_argument("--robots", nargs="+", choices=list(ROBOTS), default=list(ROBOTS))
    parser.add_argument("--options", nargs="*", default=[])
    parser.add_argument("--load", nargs=3)
    parser.add_argument("--press")
    asked = parser.parse_args()
    if asked.load:
        load(*asked.load)
    elif asked.press:
        press(asked.press)
    else:
        logging.disable(logging.ERROR)
        print(f"{'request to base, ms':24}{'median':>9}{'90 %':>9}{'most':>9}")
        in_time = [measure(name, asked.rounds, asked.options) for name in asked.robots]
        sys.exit(0 if all(in_time) else 1)


if __name__ == "__main__":
    main()
