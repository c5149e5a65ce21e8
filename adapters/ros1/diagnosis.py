"""Checks of this machine for `rosld check` of ROS 1: the addresses of the master and of rosld."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator, Mapping
from urllib.parse import urlsplit

from rosld.adapters.base import AdapterOptions, Finding
from rosld.adapters.model import Graph
from rosld.adapters.ros1.adapter import master_address
from rosld.adapters.ros1.publications import addresses


def diagnose(
    source: str, options: AdapterOptions, graph: Graph | None, environment: Mapping[str, str] = os.environ
) -> Iterator[Finding]:
    """Yield the address that nodes connect to, and whether it is another machine's."""
    try:
        host, port = master_address(source, environment)
    except ValueError:
        return  # reported already
    yield Finding("ok", "master", f"the address is http://{host}:{port}")
    try:
        master = socket.gethostbyname(host)
    except OSError as error:
        text = f"the host name {host} of the master does not resolve ({error.strerror or error})"
        yield Finding("error", "master", text, "add it to /etc/hosts, or use an address: ros1://10.0.0.1:11311")
        return
    yield from _names(graph, options.host_map)
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sock:
        try:
            sock.connect((master, port))  # chooses a route, and sends nothing
            local = str(sock.getsockname()[0])
        except OSError as error:
            step = "connect this machine to the robot's network"
            yield Finding("error", "network", f"there is no route to {master} ({error.strerror or error})", step)
            return
    own = addresses(options.ros_ip, local, environment)[0]
    step = f"use --ros-ip {local}, or unset ROS_IP and ROS_HOSTNAME"
    try:
        resolved = socket.gethostbyname(own)
    except OSError:
        text = f"nodes connect to rosld at {own}, a name that does not resolve here"
        yield Finding("warning", "address", text, step)
        return
    if resolved.startswith("127.") and not master.startswith("127."):
        text = f"nodes connect to rosld at {own}, which on the robot is the robot itself: nothing that rosld "
        yield Finding("warning", "address", f"{text}publishes arrives", step)
    else:
        yield Finding("ok", "address", f"nodes connect to rosld at {own}")


def _names(graph: Graph | None, known: Mapping[str, str]) -> Iterator[Finding]:
    """Yield the host names of nodes that do not resolve, for which the adapter tries the host of the master."""
    nodes: dict[str, list[str]] = {}
    for node in () if graph is None else graph.nodes.values():
        host = urlsplit(node.uri).hostname if node.uri else None
        if host is not None:
            nodes.setdefault(known.get(host, host), []).append(node.name)
    for host, names in nodes.items():
        try:
            socket.gethostbyname(host)
        except OSError:
            text = f"the host name {host} of {', '.join(names[:5])} does not resolve; the master's is tried"
            yield Finding("warning", "node", text, f"add it to /etc/hosts, or use --host-map {host}=IP")
