"""The rover embedded, as a rospy node and as an rclpy node, each behind a rosld that has no mapping of it.

Tests elsewhere use them too: import the fixtures `rover` and `start_rover` of `tests.rover.conftest`, with `serve` and
`start_server` of the server's tests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from rosld.adapters.rover.topics import CMD_VEL, DOCK, LATCHED, NAVIGATE_TO, PERIODIC, SET_LIGHTS
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
    """A rover behind a server.

    `source` is what the server serves, `how` are the Python and the environment that it needs, `system` is the ROS that
    the node runs in and `node` its process, None for the embedded rover.
    """

    name: str
    url: str
    http: httpx.Client
    source: str
    how: Mapping[str, Any] = field(default_factory=dict)
    system: Any = None
    node: Process | None = None

    def json(self, path: str) -> Any:
        """What is at a path, as plain JSON."""
        answer = self.http.get(path, headers={"Accept": JSON}, follow_redirects=True)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def hear(self, topic: str) -> Any:
        """The newest message of a topic, once there is one."""
        return until(lambda: self.json(f"/topics{topic}"), f"a message on {topic}")

    def drive(self, speed: float, turn_rate: float = 0.0) -> None:
        """Command a velocity."""
        linear, angular = {**STANDSTILL["linear"], "x": speed}, {**STANDSTILL["angular"], "z": turn_rate}
        answer = self.http.put(f"/topics{CMD_VEL}", json={"linear": linear, "angular": angular})
        assert answer.status_code == 204, answer.text

    def velocity(self) -> tuple[float, float]:
        """How it moves, by its odometry."""
        twist = self.hear("/odom")["twist"]["twist"]
        return twist["linear"]["x"], twist["angular"]["z"]

    def place(self) -> tuple[float, float]:
        """Where it is, by its odometry."""
        position = self.hear("/odom")["pose"]["pose"]["position"]
        return position["x"], position["y"]

    def send(self, x: float, y: float, *, frame: str = "map") -> httpx.Response:
        """Send a goal."""
        pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
        stamp = self.hear("/odom")["header"]["stamp"]  # whose fields are called otherwise in each ROS
        header = {"stamp": dict.fromkeys(stamp, 0), "frame_id": frame}
        given = {**header, "seq": 0} if "seq" in self.hear("/odom")["header"] else header
        return self.http.post(f"/actions{NAVIGATE_TO}", json={"pose": {"header": given, "pose": pose}})

    def end_of(self, goal: str) -> Any:
        """A goal, by its URL, once it has ended."""
        return until(lambda: (told := self.json(goal))["status"] not in UNDER_WAY and told, "the end of the goal")

    def complete(self) -> None:
        """Wait until the server has found the whole rover, and somebody gets what is published for it."""
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


Start = Callable[..., Any]
"""Starts a server with these arguments of `rosld serve`."""


@contextmanager
def embedded(start: Start, folder: Path, begins: str, *arguments: str) -> Iterator[Rover]:
    """The embedded rover."""
    served = start(_source(begins), *arguments)
    yield Rover("embedded", served.url, served.http, _source(begins))


@contextmanager
def rospy(start: Start, folder: Path, begins: str, *arguments: str) -> Iterator[Rover]:
    """The rospy rover under a rosmaster of its own."""
    with ros1.running(folder) as system:
        ros1.require("the rover", "numpy", "diagnostic_msgs", "dynamic_reconfigure")
        node = system.start([ros1.PYTHON, str(NODES / "rospy_rover.py"), _source(begins)])
        node.line("ready")
        served = start(system.source, *arguments)
        yield Rover("rospy", served.url, served.http, system.source, system=system, node=node)


def rclpy(distro: str) -> Callable[..., AbstractContextManager[Rover]]:
    """The rclpy rover of a distro, in a domain of its own."""

    @contextmanager
    def run(start: Start, folder: Path, begins: str, *arguments: str) -> Iterator[Rover]:
        with ros2.running(distro) as system:
            node = system.node("rclpy_rover.py", _source(begins), folder=NODES)
            how = {"python": system.python, "environment": system.environment}
            served = start(system.source, *arguments, **how)
            yield Rover(distro, served.url, served.http, system.source, how, system, node)

    return run


def _source(begins: str) -> str:
    return f"rover:?{begins}" if begins else "rover"


ROVERS: Mapping[str, Callable[..., AbstractContextManager[Rover]]] = {
    "embedded": embedded,
    "rospy": rospy,
    "kilted": rclpy("kilted"),
}
"""How each is run: with what starts servers, a folder, how the rover begins (`battery=0.21&rate=10`), and arguments."""


@contextmanager
def running(name: str, start: Start, folder: Path, begins: str = "", *arguments: str) -> Iterator[Rover]:
    """A rover that is complete."""
    with ROVERS[name](start, folder, begins, *arguments) as rover:
        rover.complete()
        yield rover
