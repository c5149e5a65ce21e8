"""A rosld that was killed on a real ROS 1: another one, started later or next to it, can command the robot."""

from __future__ import annotations

import asyncio
import signal
import threading
import xmlrpc.server
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from rosld.adapters.ros1.master import Hosts, MasterApi, StaleRegistrations
from rosld.adapters.ros1.xmlrpc import XmlRpcClient
from tests.adapters.ros1.system import RosSystem, free_port, running
from tests.waiting import until

pytestmark = pytest.mark.slow

TOPIC = "/topics/cmd_vel"
STILL = {axis: {"x": 0.0, "y": 0.0, "z": 0.0} for axis in ("linear", "angular")}


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster, and a node that receives commands."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        system.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")
        yield system


def killed(served: Any) -> None:
    """Kill a server, as a crash would."""
    served.process.kill()
    served.process.wait(10)


def put(http: httpx.Client) -> int:
    return http.put(TOPIC, json=STILL).status_code


def test_a_rosld_commands_the_robot_at_once_after_one_that_was_killed(
    ros: RosSystem, serve: Callable[..., Any]
) -> None:
    first = serve(ros.source, process=True)
    assert put(first.http) == 204
    killed(first)
    [dead] = ros.publishers("/cmd_vel")
    second = serve(ros.source, process=True)
    assert put(second.http) == 204
    assert dead not in ros.publishers("/cmd_vel")


def test_a_rosld_notices_that_another_one_was_killed(ros: RosSystem, serve: Callable[..., Any]) -> None:
    first, second = serve(ros.source, process=True), serve(ros.source, process=True)
    assert put(first.http) == 204
    until(lambda: put(second.http) == 405, "the second sees the first publish")
    killed(first)
    until(lambda: put(second.http) == 204, "the second commands the robot")


async def removed(ros: RosSystem, topic: str, node: str, own_uri: str | None = None) -> bool:
    """Whether a search for stale registrations removes that of this node."""
    hosts = Hosts({}, "127.0.0.1")
    uri = f"http://127.0.0.1:{ros.port}"
    client = XmlRpcClient(uri, "/RPC2", lambda: hosts.streams("127.0.0.1", ros.port), keep_alive=False)
    leftovers = StaleRegistrations(MasterApi(client, "/rosld_test_1"), hosts, "/rosld_test_1", lambda: own_uri)
    due = leftovers.nodes_to_check({topic: (node,)})
    return [await leftovers.remove(each, topics) for each, topics in due.items()] == [True]


def test_a_rosld_that_lives_keeps_its_registration_even_while_it_is_suspended(
    ros: RosSystem, serve: Callable[..., Any]
) -> None:
    living = serve(ros.source, process=True)
    assert put(living.http) == 204
    [node] = ros.publishers("/cmd_vel")
    assert not asyncio.run(removed(ros, "/cmd_vel", node))
    living.process.send_signal(signal.SIGSTOP)
    try:
        assert not asyncio.run(removed(ros, "/cmd_vel", node))
        assert ros.publishers("/cmd_vel") == [node]
    finally:
        living.process.send_signal(signal.SIGCONT)


def registered(ros: RosSystem, topic: str, node: str, uri: str) -> str:
    assert ros.master.registerPublisher(node, topic, "geometry_msgs/Twist", uri)[0] == 1
    return node


def test_other_nodes_and_other_machines_keep_theirs_though_nobody_answers(ros: RosSystem) -> None:
    nobody, elsewhere = f"http://127.0.0.1:{free_port()}/", f"http://192.0.2.1:{free_port()}/"
    for node, uri, is_removed in (
        ("/driver_7", nobody, False),
        ("/rosld_elsewhere_7", elsewhere, False),
        ("/rosld_here_7", nobody, True),
    ):
        assert asyncio.run(removed(ros, "/others", registered(ros, "/others", node, uri))) is is_removed
    assert sorted(ros.publishers("/others")) == ["/driver_7", "/rosld_elsewhere_7"]


def test_a_process_that_took_over_the_port_is_recognized_by_its_pid(ros: RosSystem) -> None:
    with xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as other:
        other.register_function(lambda caller: [1, "", 8], "getPid")
        thread = threading.Thread(target=other.serve_forever, args=(0.01,))
        thread.start()
        try:
            uri = f"http://127.0.0.1:{other.server_address[1]}/"
            for node, is_dead in (("/rosld_here_8", False), ("/rosld_here_7", True)):
                assert asyncio.run(removed(ros, "/ports", registered(ros, "/ports", node, uri))) is is_dead
        finally:
            other.shutdown()
            thread.join()


def test_registrations_of_our_own_name_are_removed_unless_they_are_ours(ros: RosSystem) -> None:
    """A container has the same process ids again after it was killed."""
    nobody = f"http://127.0.0.1:{free_port()}/"
    node = registered(ros, "/own", "/rosld_test_1", nobody)
    assert not asyncio.run(removed(ros, "/own", node, own_uri=nobody))
    assert asyncio.run(removed(ros, "/own", node))
