"""A publisher of a real ROS 1 that sends much data does not wait for rosld."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest

from rosld.adapters.ros1.tcpros import MAX_BYTES, enlarge, max_permitted_bytes
from tests.adapters.ros1.system import RosSystem, running
from tests.processes import Process
from tests.waiting import until

pytestmark = pytest.mark.slow

MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosSystem]:
    """A rosmaster."""
    with running(tmp_path_factory.mktemp("ros")) as system:
        yield system


def held_megabytes() -> int:
    """Return how much the kernel buffers for one of our connections, in megabytes."""
    with socket.socket() as probe:
        enlarge(probe, MAX_BYTES)
        granted = probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    return max(granted, max_permitted_bytes(), 2 * MEGABYTE) // MEGABYTE


def longest(lines: Sequence[str]) -> float:
    """Return the longest delay that a steady node reported, in seconds."""
    return max(float(line.split()[1]) for line in lines)


def test_while_rosld_is_suspended_for_a_second_no_publisher_waits(ros: RosSystem, serve: Callable[..., Any]) -> None:
    rate = min(30, held_megabytes())
    steady = ros.node("steady_node.py", "/steady", str(MEGABYTE), str(rate))
    served = serve(ros.source, "--subscribe", "/steady", process=True)
    until(lambda: steady.seen[-1].endswith(" 1"), "rosld reads")
    waited: list[tuple[float, float]] = []
    for _ in range(4):  # the rate of data is measured in seconds in which all processes run, and others use the cores
        time.sleep(3)
        waited.append(suspended(served, steady))
        if waited[-1][0] < waited[-1][1] - 0.7:  # of the second that is reserved for it
            break
    else:
        pytest.fail(f"the publisher waited for most of the time that rosld was suspended: {waited}")
    assert steady.seen[-1].endswith(" 1")


def suspended(served: Any, steady: Process) -> tuple[float, float]:
    """Suspend rosld for more than a second; return the longest delay of a publisher, and its permitted maximum."""
    told = len(steady.seen)
    usual = longest(steady.seen[1:])  # on a busy machine a node waits for other processes, too
    began = time.monotonic()
    served.process.send_signal(signal.SIGSTOP)
    time.sleep(1.2)
    served.process.send_signal(signal.SIGCONT)
    served.http.get("/").raise_for_status()
    took = time.monotonic() - began
    until(lambda: len(steady.seen) > told + 4, "what the publisher noticed")
    return longest(steady.seen[told:]), took + min(usual, 0.5)
