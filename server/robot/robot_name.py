"""Name of the robot: the parameter `/robot_name`, the name in its URDF, or its host's name."""

from __future__ import annotations

import ipaddress
import re
import socket
from html import unescape
from urllib.parse import urlsplit

from rosld.adapters.base import Adapter
from rosld.adapters.model import Graph, RosError

_MAX_NAME = 60
"""Characters of a name."""
_PARAMETER = "/robot_name"
_DESCRIPTION = "robot_description"
_URDF_NAME = re.compile(r"<robot\b[^<>]{0,2000}?\sname\s*=\s*[\"']([^\"'<>]{1,200})[\"']")
_URDF_BEGIN = 20_000
"""Characters of a URDF in which its first element is looked for."""


def shown_name(text: str) -> str:
    """Return a name fit to be shown: on one line, without characters that nobody sees, and cut."""
    return "".join(filter(str.isprintable, " ".join(text[: 4 * _MAX_NAME].split())))[:_MAX_NAME].strip()


def naming_parameters(graph: Graph) -> tuple[str, ...]:
    """Return the parameters of a graph that may name the robot, the best first."""
    described = sorted(name for name in graph.parameters if name.rpartition("/")[2] == _DESCRIPTION)
    return (*((_PARAMETER,) if _PARAMETER in graph.parameters else ()), *described[:1])


async def read_robot_name(adapter: Adapter, graph: Graph, *, deadline: float) -> str | None:
    """Return what the robot's parameters say that it is called; None where they do not."""
    for name in naming_parameters(graph):
        try:
            value = (await adapter.get_parameters([name], deadline=deadline)).get(name)
        except RosError:
            continue
        if isinstance(value, str):
            found = _URDF_NAME.search(value[:_URDF_BEGIN]) if name != _PARAMETER else None
            text = value if name == _PARAMETER else unescape(found[1]) if found else ""
            if shown := shown_name(text):
                return shown
    return None


def host_name(uri: str | None) -> str:
    """Return the name of the machine at a URI; that of this one where the URI is of loopback or there is none."""
    host = (urlsplit(uri).hostname if uri is not None else None) or "localhost"
    try:
        is_here = ipaddress.ip_address(host).is_loopback
    except ValueError:
        is_here = host == "localhost"
    return shown_name(socket.gethostname() if is_here else host)
