"""The rover embedded, as a rospy node and as an rclpy node, each behind a rosld without a mapping of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from rosld.adapters.rover.graph import CMD_VEL, DOCK, LATCHED, NAVIGATE_TO, PERIODIC, SET_LIGHTS
from tests.adapters.ros1 import system as ros1
from tests.processes import Process
from tests.ros2 import system as ros2
from tests.waiting import until

NODES = Path(__file__).parent / "nodes"
JSON = "application/json"
STANDSTILL = {"linear": {"x": 0.0, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
UNDER_WAY = ("accepted", "executing", "canceling")


@dataclass(frozen=True)
class Rover:
    """A rover behind a server; `system` is the ROS of its node and `node` its process, if it is on ROS."""

    name: str
    url: str
    http: httpx.Client
    system: Any = None
    node: Process | None = None

    def json(self, path: str) -> Any:
        """Return the resource at a path, as plain JSON."""
        answer = self.http.get(path, headers={"Accept": JSON}, follow_redirects=True)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def hear(self, topic: str) -> Any:
        """Return the newest message of a topic, once there is one."""
        return until(lambda: self.json(f"/topics{topic}"), f"a message on {topic}")

    def drive(self, speed: float, turn_rate: float = 0.0) -> None:
        """Command a velocity."""
        linear, angular = {**STANDSTILL["linear"], "x": speed}, {**STANDSTILL["angular"], "z": turn_rate}
        answer = self.http.put(f"/topics{CMD_VEL}", json={"linear": linear, "angular": angular})
        assert answer.status_code == 204, answer.text

    def velocity(self) -> tuple[float, float]:
        """Return its velocity, from its odometry."""
        twist = self.hear("/odom")["twist"]["twist"]
        return twist["linear"]["x"], twist["angular"]["z"]

    def place(self) -> tuple[float, float]:
        """Return its position, from its odometry."""
        position = self.hear("/odom")["pose"]["pose"]["position"]
        return position["x"], position["y"]

    def send(self, x: float, y: float, *, frame: str = "map") -> httpx.Response:
        """Send a goal."""
        pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        stamp = self.hear("/odom")["header"]["stamp"]  # field names differ between ROS 1 and ROS 2
        header = {"stamp": dict.fromkeys(stamp, 0), "frame_id": frame}
        given = {**header, "seq": 0} if "seq" in self.hear("/odom")["header"] else header
        return self.http.post(f"/actions{NAVIGATE_TO}", json={"pose": {"header": given, "pose": pose}})

    def stands(self) -> None:
        """Wait until it is at rest."""
        until(lambda: self.velocity() == (0.0, 0.0), "standstill")

    def end_of(self, goal: str) -> Any:
        """Return a goal, by its URL, once it has ended."""
        return until(lambda: (told := self.json(goal))["status"] not in UNDER_WAY and told, "the end of the goal")

    def complete(self) -> None:
        """Wait until the server has found the whole rover, and publishing reaches a subscriber."""
        for topic in (*PERIODIC, *LATCHED, CMD_VEL):
            until(lambda path=f"/topics{topic}": self._is_there(path), topic)
        for service in (SET_LIGHTS, DOCK):
            until(lambda path=f"/services{service}": self._is_there(path), service)
        until(lambda: "POST" in self.http.options(f"/actions{NAVIGATE_TO}").headers["allow"], NAVIGATE_TO)
        until(lambda: self._is_there("/parameters/rover/max_speed"), "the parameters")
        self._wait_heard()

    def _wait_heard(self) -> None:
        answers: list[str] = []

        def is_heard() -> bool:
            answer = self.http.put(f"/topics{CMD_VEL}", json=STANDSTILL)
            answers.append(f"{answer.status_code} {answer.text}")
            return answer.status_code == 204

        try:
            until(is_heard, "a subscriber of cmd_vel")
        except AssertionError as late:
            node = self.node and f"; its node ended with {self.node.process.poll()} and printed {self.node.seen[-20:]}"
            raise AssertionError(f"{late}; {len(answers)} writes, the last: {answers[-1]}{node or ''}") from late

    def _is_there(self, path: str) -> bool:
        return self.http.get(path).status_code == 200


@contextmanager
def running(name: str, start: Callable[..., Any], folder: Path, begins: str = "", *arguments: str) -> Iterator[Rover]:
    """Run a complete rover ("embedded", "rospy" or a distro of ROS 2), served by `start` with these arguments.

    `begins` is its initial state (`battery=0.21&rate=10`).
    """
    source = f"rover:?{begins}" if begins else "rover"
    with ExitStack() as ending:
        if name == "embedded":
            served = start(source, *arguments)
            rover = Rover(name, served.url, served.http)
        elif name == "rospy":
            system = ending.enter_context(ros1.running(folder))
            ros1.require("the rover", "numpy", "diagnostic_msgs", "dynamic_reconfigure")
            node = system.start([ros1.PYTHON, str(NODES / "rospy_rover.py"), source])
            node.line("ready")
            served = start(system.source, *arguments)
            rover = Rover(name, served.url, served.http, system, node)
        else:
            domain = ending.enter_context(ros2.running(name))
            node = domain.node("rclpy_rover.py", source, folder=NODES)
            served = start(domain.source, *arguments, python=domain.python, environment=domain.environment)
            rover = Rover(name, served.url, served.http, domain, node)
        rover.complete()
        yield rover
