"""The stop of a base without a mapping, on a real ROS 1: it receives zero, whichever node commanded it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.adapters.ros1.system import RosSystem, running
from tests.processes import Process
from tests.stopping import release
from tests.waiting import until

pytestmark = pytest.mark.slow

TOPIC, TWIST = "/cmd_vel", "geometry_msgs/Twist"
AHEAD = "{linear: {x: 0.5}}"
JSON = {"Accept": "application/json"}


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        yield system


@pytest.fixture
def base(ros: RosSystem) -> Iterator[Process]:
    """A base without a watchdog."""
    process = ros.node("base_node.py", TOPIC)
    try:
        yield process
    finally:
        process.stop()


@pytest.fixture
def served(ros: RosSystem, base: Process, serve: Callable[..., Any]) -> Any:
    """rosld on it."""
    found = serve(ros.source)
    until(lambda: found.http.get(f"topics{TOPIC}").status_code == 200, "the topic")
    return found


def speeds(base: Process) -> list[float]:
    """Return the commands that the base received, in order."""
    return [float(line.split()[1]) for line in base.seen if line.startswith("drive ")]


def test_a_base_that_another_node_commands_or_set_going_and_left_is_told_zero_again_and_again(
    ros: RosSystem, base: Process, served: Any
) -> None:
    other = ros.publish(TOPIC, TWIST, AHEAD, rate=5)
    until(lambda: len(speeds(base)) > 2, "its commands")
    told = served.http.post("stop", headers=JSON).json()
    assert [step["subscribers"] for step in told["steps"]] == [1]
    until(lambda: speeds(base).count(0.0) >= 15, "zero for a second, beside the other's commands")
    assert served.http.put(f"topics{TOPIC}", json={}, params={"defaults": "true"}).status_code == 405
    assert release(served.http).status_code == 204
    until(lambda: speeds(base)[-1] == 0.5, "the other's last command")
    other.stop()
    told = served.http.post("stop", headers=JSON).json()
    step = {"does": "publish zero on /cmd_vel", "state": "Succeeded", "subscribers": 1, "words": None}
    assert (told["steps"], told["warning"]) == ([step], None)
    until(lambda: speeds(base)[-15:] == [0.0] * 15, "zero for a second")
    assert any("rosld" in node for node in ros.publishers(TOPIC))
    assert release(served.http).status_code == 204
    assert ros.publishers(TOPIC) == [], "what was advertised for the stop alone is withdrawn"


def test_a_subscriber_that_cannot_be_reached_holds_up_no_other_and_is_told_of(
    ros: RosSystem, base: Process, served: Any
) -> None:
    ros.master.registerSubscriber("/gone", TOPIC, TWIST, "http://127.0.0.1:9/")
    ros.master.registerSubscriber("/gone", "/dead_vel", TWIST, "http://127.0.0.1:9/")
    try:
        until(lambda: served.http.get("topics/dead_vel").status_code == 200, "the topic")
        told = served.http.post("stop", headers=JSON).json()
        steps = {step["does"]: step for step in told["steps"]}
        reached, failed = steps["publish zero on /cmd_vel"], steps["publish zero on /dead_vel"]
        assert (reached["state"], reached["subscribers"]) == ("Succeeded", 1)
        assert reached["words"] == "1 of 2 subscribers could not be reached"
        assert (failed["state"], failed["words"]) == ("Failed", "no subscriber of /dead_vel could be reached")
        assert "1 of 2 steps to stop it failed" in told["warning"]
        assert speeds(base)[-1] == 0.0
    finally:
        for topic in (TOPIC, "/dead_vel"):
            ros.master.unregisterSubscriber("/gone", topic, "http://127.0.0.1:9/")
