"""A rosld that ended uncleanly on a real ROS 1: the robot can be commanded by the next one, and by one beside it."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import threading
import xmlrpc.server
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from rosld.adapters.ros1.hosts import Hosts
from rosld.adapters.ros1.master import MasterApi
from rosld.adapters.ros1.stale_registrations import StaleRegistrations, own_name, pids
from rosld.adapters.ros1.xmlrpc import XmlRpcClient
from tests.adapters.ros1.system import RosSystem, free_port, running
from tests.waiting import until

TOPIC = "/topics/cmd_vel"
STILL = {axis: {"x": 0.0, "y": 0.0, "z": 0.0} for axis in ("linear", "angular")}


@pytest.fixture
def ros(tmp_path: Path) -> Iterator[RosSystem]:
    """A rosmaster, and a node that is driven."""
    with running(tmp_path) as system:
        system.node("listener.py", "/cmd_vel", "geometry_msgs/Twist")
        yield system


def killed(served: Any) -> None:
    """End a server as a crash would."""
    served.process.kill()
    served.process.wait(10)


def put(http: httpx.Client) -> int:
    return http.put(TOPIC, json=STILL).status_code


def test_the_robot_is_commanded_at_once_by_who_comes_after_a_rosld_that_was_killed(
    ros: RosSystem, serve: Callable[..., Any]
) -> None:
    first = serve(ros.source, process=True)
    assert put(first.http) == 204
    killed(first)
    [dead] = ros.publishers("/cmd_vel")
    second = serve(ros.source, process=True)
    assert put(second.http) == 204
    assert dead not in ros.publishers("/cmd_vel")


def test_a_rosld_that_is_killed_beside_another_is_noticed_by_that_one(
    ros: RosSystem, serve: Callable[..., Any]
) -> None:
    first, second = serve(ros.source, process=True), serve(ros.source, process=True)
    assert put(first.http) == 204
    until(lambda: put(second.http) == 405, "the second sees the first publish")
    killed(first)
    until(lambda: put(second.http) == 204, "the second commands the robot")


async def removed(ros: RosSystem, node: str, own_uri: str | None = None) -> bool:
    """Whether a look for leftovers removes this node's registration of `/cmd_vel`."""
    hosts = Hosts({}, "127.0.0.1")
    uri = f"http://127.0.0.1:{ros.port}"
    client = XmlRpcClient(uri, "/RPC2", lambda: hosts.streams("127.0.0.1", ros.port), keep_alive=False)
    leftovers = StaleRegistrations(MasterApi(client, "/rosld_test_1"), hosts, "/rosld_test_1", lambda: own_uri)
    due = leftovers.nodes_to_check({"/cmd_vel": (node,)})
    return [await leftovers.remove(each, topics) for each, topics in due.items()] == [True]


@pytest.mark.parametrize("number", [None, signal.SIGSTOP])
def test_a_rosld_that_lives_keeps_its_registration_even_while_it_is_suspended(
    ros: RosSystem, serve: Callable[..., Any], number: signal.Signals | None
) -> None:
    living = serve(ros.source, process=True)
    assert put(living.http) == 204
    [node] = ros.publishers("/cmd_vel")
    if number is not None:
        living.process.send_signal(number)
    try:
        assert not asyncio.run(removed(ros, node))
        assert ros.publishers("/cmd_vel") == [node]
    finally:
        living.process.send_signal(signal.SIGCONT)


def registered(ros: RosSystem, node: str, uri: str) -> str:
    assert ros.master.registerPublisher(node, "/cmd_vel", "geometry_msgs/Twist", uri)[0] == 1
    return node


def test_other_nodes_and_other_machines_keep_theirs_though_nobody_answers(ros: RosSystem) -> None:
    nobody = f"http://127.0.0.1:{free_port()}/"
    assert not asyncio.run(removed(ros, registered(ros, "/driver_7", nobody)))
    assert not asyncio.run(removed(ros, registered(ros, "/rosld_elsewhere_7", f"http://192.0.2.1:{free_port()}/")))
    assert asyncio.run(removed(ros, registered(ros, "/rosld_here_7", nobody)))
    assert sorted(ros.publishers("/cmd_vel")) == ["/driver_7", "/rosld_elsewhere_7"]


@pytest.mark.parametrize(("pid", "is_dead"), [(7, False), (8, True)])
def test_a_port_that_another_process_took_over_is_told_apart_by_its_pid(
    ros: RosSystem, pid: int, is_dead: bool
) -> None:
    with xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as other:
        other.register_function(lambda caller: [1, "", pid], "getPid")
        thread = threading.Thread(target=other.serve_forever, args=(0.01,))
        thread.start()
        try:
            uri = f"http://127.0.0.1:{other.server_address[1]}/"
            assert asyncio.run(removed(ros, registered(ros, "/rosld_here_7", uri))) is is_dead
        finally:
            other.shutdown()
            thread.join()


def test_what_our_own_name_has_left_is_removed_unless_it_is_ours(ros: RosSystem) -> None:
    """A container has the same process ids again after it was killed."""
    nobody = f"http://127.0.0.1:{free_port()}/"
    node = registered(ros, "/rosld_test_1", nobody)
    assert not asyncio.run(removed(ros, node, own_uri=nobody))
    assert asyncio.run(removed(ros, node))


def test_our_names_are_told_from_those_of_others() -> None:
    host = re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)
    assert own_name(0) == f"/rosld_{host}_{os.getpid()}"
    assert os.getpid() in pids(own_name(0))
    assert os.getpid() in pids(own_name(3))
    assert pids("/rosld_robot_2_345") == {2, 345}
    assert pids("/rosld_robot") == pids("/driver_1") == pids("/a/rosld_robot_1") == frozenset()
