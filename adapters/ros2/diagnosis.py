"""Checks of this machine for `rosld check` of ROS 2: its Python, variables, network and shared memory."""

from __future__ import annotations

import contextlib
import importlib
import os
import pwd
import selectors
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from rosld.adapters.base import AdapterOptions, Finding
from rosld.adapters.model import Graph
from rosld.adapters.ros2.adapter import read_source, require_rclpy

_GROUP = "239.255.0.1"
_FIRST_PORT, _GAIN = 7400, 250
"""Group and ports of discovery (RTPS 2.5, 9.6.2.4): a participant of domain N announces itself at 7400 + 250 N."""
_LISTEN = 4.0
"""Seconds to listen for participants: Fast DDS announces itself every three, Cyclone DDS every thirty."""
_ROUTER = ("localhost", 7447)
_SHARED = Path("/dev/shm")
_OTHERS = (
    ("ROS_STATIC_PEERS", "only these peers are contacted besides those found by multicast"),
    ("ROS_DISCOVERY_SERVER", "the nodes of the robot must use the same discovery server"),
    ("FASTRTPS_DEFAULT_PROFILES_FILE", "its profiles apply to rosld, too"),
    ("FASTDDS_DEFAULT_PROFILES_FILE", "its profiles apply to rosld, too"),
    ("CYCLONEDDS_URI", "its configuration applies to rosld, too"),
)


def diagnose(source: str, options: AdapterOptions, graph: Graph | None) -> Iterator[Finding]:
    """Yield what concerns a source; without any node of the robot, also what the network says."""
    try:
        domain = read_source(source).domain
    except ValueError:
        return  # reported already
    try:
        require_rclpy()
    except ValueError:
        yield from _pythons()
        return
    rmw = str(importlib.import_module("rclpy.utilities").get_rmw_implementation_identifier())
    if domain is None:
        domain = int(os.environ.get("ROS_DOMAIN_ID") or 0)
    yield Finding("ok", "middleware", f"{rmw}, domain {domain}, ROS {os.environ.get('ROS_DISTRO', '(not sourced)')}")
    yield from range_findings(os.environ)
    if "fastrtps" in rmw:
        yield from memory_findings(_SHARED)
    if graph is None or all(node == graph.own_node for node in graph.nodes):
        yield from _network(rmw, domain)


def _pythons() -> Iterator[Finding]:
    """Yield how to get rclpy: the installed ROS releases, and the Python that each is for."""
    version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    for found in sorted(Path("/opt/ros").glob("*/lib/python3*/site-packages/rclpy")):
        python, release = found.parts[-3], found.parts[3]
        text = f"{found.parents[4]} is installed, for {python}; rosld runs on {version} ({sys.executable})"
        if python == version:
            yield Finding("error", "rclpy", text, f"source /opt/ros/{release}/setup.bash, then start rosld")
        else:
            step = f"install rosld for {python}: {python} -m venv --system-site-packages, with the ROS sourced"
            yield Finding("error", "rclpy", text, step)


def range_findings(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Yield the variables that limit which nodes are discovered."""
    only = "only nodes on this machine are discovered"
    if environment.get("ROS_LOCALHOST_ONLY") == "1":
        yield Finding("warning", "discovery", f"ROS_LOCALHOST_ONLY=1: {only}", "unset it for a robot elsewhere")
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if reach in ("LOCALHOST", "OFF"):
        words = only if reach == "LOCALHOST" else "no node is discovered except ROS_STATIC_PEERS"
        step = "set it to SUBNET for a robot elsewhere"
        yield Finding("warning", "discovery", f"ROS_AUTOMATIC_DISCOVERY_RANGE={reach}: {words}", step)
    for name, words in _OTHERS:
        if environment.get(name):
            yield Finding("ok", "discovery", f"{name}={environment[name]}: {words}")


def memory_findings(folder: Path) -> Iterator[Finding]:
    """Yield the users whose Fast DDS segments are in shared memory: messages do not arrive across users."""
    owners: dict[int, int] = {}
    for path in folder.glob("*fastrtps*"):
        with contextlib.suppress(OSError):
            owner = path.stat().st_uid
            owners[owner] = owners.get(owner, 0) + 1
    for owner, count in owners.items():
        if owner == os.geteuid():
            continue
        try:
            user = pwd.getpwuid(owner).pw_name
        except KeyError:
            user = f"number {owner}"
        text = (
            f"{count} segments of Fast DDS belong to the user {user}, and rosld runs as another one: nodes are listed, "
        )
        step = f"run rosld as {user}, or start all nodes with FASTDDS_BUILTIN_TRANSPORTS=UDPv4"
        yield Finding("warning", "shared memory", f"{text}but messages may not arrive", step)


def _network(rmw: str, domain: int) -> Iterator[Finding]:
    """Yield why nothing may have been discovered."""
    if "zenoh" in rmw:
        try:
            socket.create_connection(_ROUTER, 1.0).close()
        except OSError as error:
            step = (
                "start one: ros2 run rmw_zenoh_cpp rmw_zenohd; or set ZENOH_CONFIG_OVERRIDE to connect to the robot's"
            )
            yield Finding("error", "router", f"no Zenoh router at {_ROUTER[0]}:{_ROUTER[1]} ({error})", step)
        return
    if (failure := multicast_failure()) is not None:
        step = "allow UDP multicast to 239.255.0.1 in the firewall; a container needs --network host"
        yield Finding("error", "multicast", f"this machine does not receive its own multicast: {failure}", step)
        return
    yield Finding("ok", "multicast", "this machine receives its own multicast")
    with listening() as announced:
        heard = announced(_LISTEN)
    for other, addresses in sorted(heard.items()):
        hosts = ", ".join(sorted(addresses)[:5])
        if other == domain:
            text = f"participants of domain {domain} announce themselves ({hosts}), but no node was discovered"
            step = f"allow UDP to the ports from {_FIRST_PORT + _GAIN * domain} in the firewalls of both machines"
            yield Finding("error", "discovery", text, f"{step}, and use the same RMW_IMPLEMENTATION")
        else:
            text = f"participants of domain {other} announce themselves ({hosts}), not of domain {domain}"
            yield Finding("error", "discovery", text, f"use ros2:?domain={other}, or set ROS_DOMAIN_ID={other}")
    if not heard:
        text = f"no participant of any domain announced itself within {_LISTEN:g} s"
        step = "is the robot on, and in this network? Its Wi-Fi or switch may drop multicast; see ROS_STATIC_PEERS"
        yield Finding("error", "discovery", text, step)


def multicast_failure() -> str | None:
    """Return why a datagram to the group of discovery does not come back, None if it does. It stays on this machine."""
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sock:
        try:
            _join(sock)
            sock.bind((_GROUP, 0))
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            sock.settimeout(1.0)
            sock.sendto(b"rosld", (_GROUP, sock.getsockname()[1]))
            sock.recv(16)
        except TimeoutError:
            return "it was sent, but did not arrive"
        except OSError as error:
            return error.strerror or str(error)
    return None


@contextlib.contextmanager
def listening() -> Iterator[Callable[[float], dict[int, set[str]]]]:
    """Yield a function that returns, after some seconds, the addresses of announced participants by domain.

    Nothing is sent. The sockets are bound to the group, so that they take no unicast from participants of this machine.
    """
    with contextlib.ExitStack() as opened, selectors.DefaultSelector() as selector:
        for domain in range(233):
            sock = opened.enter_context(contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)))
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with contextlib.suppress(OSError):
                sock.bind((_GROUP, _FIRST_PORT + _GAIN * domain))
                _join(sock)
                sock.setblocking(False)
                selector.register(sock, selectors.EVENT_READ, (domain, sock))

        def announced(seconds: float) -> dict[int, set[str]]:
            found: dict[int, set[str]] = {}
            end = time.monotonic() + seconds
            while (left := end - time.monotonic()) > 0:
                for key, _ in selector.select(left):
                    domain, sock = key.data
                    data, address = sock.recvfrom(2048)
                    if data[:4] == b"RTPS":
                        found.setdefault(domain, set()).add(address[0])
            return found

        yield announced


def _join(sock: socket.socket) -> None:
    membership = socket.inet_aton(_GROUP) + socket.inet_aton("0.0.0.0")
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
