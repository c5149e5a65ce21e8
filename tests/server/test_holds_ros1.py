"""Holds and the stop on a real ROS 1: messages that a rospy node receives after its commander has disappeared."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests import waiting
from tests.adapters.ros1.system import RosSystem, running
from tests.forked import ForkedCommand
from tests.processes import Process
from tests.server.disks.server import Server, server_on
from tests.server.test_holds import KEEPER, STILL, ahead
from tests.stopping import release

pytestmark = pytest.mark.slow

TOPIC = "/topics/cmd_vel"
TURTLE, HTML = {"Accept": "text/turtle"}, {"Accept": "text/html"}


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        yield system


@pytest.fixture(scope="module")
def wheels(ros: RosSystem) -> Process:
    """A node that receives commands."""
    return ros.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")


@pytest.fixture
def served(ros: RosSystem, wheels: Process, serve: Callable[..., Any]) -> Any:
    """rosld on it."""
    return serve(ros.source, "--setting", "publish_wait", "5", process=True)


def held(http: httpx.Client, x: float, lease: float = 5) -> str:
    answer = http.post(TOPIC, params={"rate": 50, "lease": lease}, json=ahead(x))
    assert answer.status_code == 201, answer.text
    return str(answer.headers["location"])


def hears(wheels: Process, message: Any) -> None:
    """Check that the node receives this message, as the next or later."""
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
    with httpx.Client(base_url=http.base_url) as gone:  # no client is left to renew it
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
    assert release(http).status_code == 204

    assert json.dumps(ahead(9)) not in " ".join(wheels.seen)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGQUIT])
def test_the_robot_stands_still_when_a_signal_ends_the_server(
    wheels: Process, served: Any, number: signal.Signals
) -> None:
    held(served.http, 40 + number)
    hears(wheels, ahead(40 + number))
    served.http.close()
    served.process.send_signal(number)
    assert served.process.wait(10) == 0
    hears(wheels, STILL)


def held_and_killed(server: Server, wheels: Process, x: float, **how: Any) -> str:
    """Hold the topic, and kill the server when the base drives; return the URL of the hold."""
    waiting.until(lambda: "POST" in server.http.options(TOPIC).headers.get("allow", ""), "the base")
    answer = server.http.post(TOPIC, params={"rate": 50, "lease": 5, **how}, json=ahead(x))
    assert answer.status_code == 201, answer.text
    hears(wheels, ahead(x))
    url = str(answer.headers["location"])
    note = server.folder / "holds" / f"{url.rpartition('/')[2]}.json"
    waiting.until(note.exists, "the note of the hold, which a hold on a slow disk does not wait for")
    server.kill()
    return url


def test_a_rosld_that_is_killed_leaves_the_base_driving_and_the_next_one_stops_it_and_says_so(
    ros: RosSystem, wheels: Process, tmp_path: Path
) -> None:
    with server_on(tmp_path / "data", tmp_path / "log", source=ros.source, forked=True) as server:
        server.start()
        ended = held_and_killed(server, wheels, 5, rate=20)
        with pytest.raises(AssertionError, match="no line"):
            listen_for_ever(wheels)
        last = [line for line in wheels.seen if line.startswith("heard")][-1]
        assert json.loads(last.removeprefix("heard ")) == ahead(5)

        server.start()
        hears(wheels, STILL)
        http = server.http
        waiting.until(lambda: "zero was published to 1 subscriber" in http.get(ended).text, "what became of it")
        assert http.get(ended).status_code == 410
        assert "while anybody held it: zero was published" in http.get("/holds/", headers=TURTLE).text
        assert "rosld was killed while topics were held" in http.get("/", headers=HTML).text
        for path in ("/", "/status"):
            assert f"interruptedHold> <{ended}>" in http.get(path, headers={"Accept": "application/n-triples"}).text
        assert "zero was published to 1 subscriber" in server.log.read_text()
        receipts = re.findall(r"<(http\S+/activity/[^>]+)> \.", http.get("/activity/", headers=TURTLE).text)
        told = [http.get(url, headers=TURTLE).text for url in receipts]
        assert any("end the hold of /cmd_vel, which was interrupted: zero was published" in each for each in told)
        server.kill()
        server.start()
        assert http.get(ended).status_code == 404  # once is enough


def test_a_hold_that_was_interrupted_is_only_told_of_where_another_node_commands_or_nothing_ends_it(
    ros: RosSystem, wheels: Process, tmp_path: Path
) -> None:
    with server_on(tmp_path / "data", tmp_path / "log", source=ros.source, forked=True) as server:
        server.start()
        silent = held_and_killed(server, wheels, 6, then="none")
        server.start()
        waiting.until(lambda: "(then=none)" in server.http.get(silent).text, "what became of it")
        driven = held_and_killed(server, wheels, 7)
        other = ros.publish("/cmd_vel", "geometry_msgs/Twist", "{linear: {x: 0.5}}", rate=5)
        try:
            server.start()
            waiting.until(lambda: "another node publishes on it" in server.http.get(driven).text, "what became of it")
            assert json.dumps(STILL) not in " ".join(wheels.seen[-3:])
        finally:
            other.stop()


def test_a_guard_stops_the_base_as_soon_as_rosld_is_killed(ros: RosSystem, wheels: Process, tmp_path: Path) -> None:
    data, log = tmp_path / "data", tmp_path / "guard.log"
    command = ("guard", ros.source, "--data", str(data))
    with server_on(data, tmp_path / "log", source=ros.source, forked=True) as server, log.open("w") as errors:
        server.start()
        guard = ForkedCommand(*command, errors=errors.fileno())
        try:
            waiting.until(lambda: "POST" in server.http.options(TOPIC).headers.get("allow", ""), "the base")
            hold = server.http.post(TOPIC, params={"rate": 10, "lease": 5}, json=ahead(1)).headers["location"]
            [note] = (data / "holds").iterdir()
            written = note.stat().st_mtime_ns
            assert [server.http.patch(hold, json=ahead(x)).status_code for x in (2, 3)] == [204, 204]
            assert note.stat().st_mtime_ns == written  # a renewal writes nothing
            assert server.http.delete(hold).status_code == 204
            waiting.until(lambda: not note.exists(), "the note of a hold that has ended is gone")
            ended = held_and_killed(server, wheels, 8)
            hears(wheels, STILL)
            waiting.until(lambda: "WARNING rosld: the hold" in log.read_text(), "a warning of the guard")
            server.start()
            waiting.until(lambda: "rosld guard: zero was published" in server.http.get(ended).text, "what became of it")
            waiting.until(lambda: "POST" in server.http.options(TOPIC).headers["allow"], "the base can be commanded")
            assert server.stop() == 0
        finally:
            guard.send_signal(signal.SIGTERM)
            code = guard.wait(30)
        assert code == 0
        assert ForkedCommand(*command, "--once", errors=errors.fileno()).wait(30) == 0
        assert "holds that could not be ended: 0" in log.read_text()
