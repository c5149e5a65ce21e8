"""Holds and the stop on a real ROS 1: what a rospy node hears when whoever commands it is gone."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from tests import waiting
from tests.adapters.ros1.system import RosSystem, running
from tests.processes import Process
from tests.server.test_holds import KEEPER, STILL, ahead

TOPIC = "/topics/cmd_vel"


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        yield system


@pytest.fixture(scope="module")
def wheels(ros: RosSystem) -> Process:
    """A node that is driven."""
    return ros.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")


@pytest.fixture
def served(ros: RosSystem, wheels: Process, serve: Callable[..., Any]) -> Any:
    """rosld on it."""
    return serve(ros.source, "--setting", "publish_wait", "5")


def held(http: httpx.Client, x: float, lease: float = 5) -> str:
    answer = http.post(TOPIC, params={"rate": 50, "lease": lease}, json=ahead(x))
    assert answer.status_code == 201, answer.text
    return str(answer.headers["location"])


def hears(wheels: Process, message: Any) -> None:
    """The node hears this message, next or later."""
    while json.loads(wheels.line("heard").removeprefix("heard ")) != message:
        pass


def listen_for_ever(wheels: Process) -> None:
    while True:
        wheels.line("heard", timeout=2)


def test_the_robot_stands_still_when_the_client_the_lease_or_the_stop_ends_a_hold(wheels: Process, served: Any) -> None:
    http = served.http
    hold = held(http, 1)
    keeper = subprocess.Popen([sys.executable, "-c", KEEPER, f"{hold}?keep=true"], stdout=subprocess.PIPE, text=True)
    try:
        assert keeper.stdout is not None
        assert any("data: " in line for line in keeper.stdout)
        hears(wheels, ahead(1))
    finally:
        keeper.kill()
        keeper.wait()
    hears(wheels, STILL)

    held(http, 2, lease=0.5)
    hears(wheels, ahead(2))
    hears(wheels, STILL)

    heard = len(wheels.seen)
    with httpx.Client(base_url=http.base_url) as gone:  # nobody is there to renew it
        assert gone.post(TOPIC, params={"for": 3}, json=ahead(4)).status_code == 201
    hears(wheels, ahead(4))
    hears(wheels, STILL)
    said = [json.loads(line.removeprefix("heard ")) for line in wheels.seen[heard:] if line.startswith("heard {")]
    assert 20 <= said.count(ahead(4)) <= 31, "three seconds at 10 Hz"

    held(http, 3)
    hears(wheels, ahead(3))
    assert http.post("/stop").status_code == 200
    hears(wheels, STILL)
    assert http.put(TOPIC, json=ahead(9)).status_code == 423
    assert http.delete("/stop").status_code == 204

    assert json.dumps(ahead(9)) not in " ".join(wheels.seen)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_the_robot_stands_still_when_a_signal_ends_the_server(
    wheels: Process, served: Any, number: signal.Signals
) -> None:
    held(served.http, 40 + number)
    hears(wheels, ahead(40 + number))
    served.http.close()
    served.process.send_signal(number)
    assert served.process.wait(10) == 0
    hears(wheels, STILL)


def test_the_robot_stands_still_when_another_node_begins_to_publish(
    ros: RosSystem, wheels: Process, served: Any
) -> None:
    hold = held(served.http, 6)
    hears(wheels, ahead(6))
    other = ros.publish("/cmd_vel", "geometry_msgs/Twist", "{linear: {x: 0.5}}", rate=1)
    try:
        hears(wheels, STILL)
        waiting.until(lambda: served.http.get(hold).status_code == 410, "the hold has ended")
        assert "is published by /rostopic" in served.http.get(hold).json()["detail"]
        hears(wheels, ahead(0.5))
        assert json.dumps(ahead(6)) not in " ".join(wheels.seen[-3:])
    finally:
        other.stop()


def test_a_server_that_is_killed_says_nothing_more_so_the_robot_itself_must_stop(wheels: Process, served: Any) -> None:
    held(served.http, 5)
    hears(wheels, ahead(5))
    served.process.kill()
    served.process.wait(60)
    with pytest.raises(AssertionError, match="no line"):
        listen_for_ever(wheels)
    last = [line for line in wheels.seen if line.startswith("heard")][-1]
    assert json.loads(last.removeprefix("heard ")) == ahead(5)
