"""The `Adapter` of ROS 2 systems whose middleware is rmw_zenoh: that of ROS 2, over zenoh instead of rclpy."""

from __future__ import annotations

import importlib
import os

from rosld.adapters.base import AdapterOptions
from rosld.adapters.bridge_connection import read_source
from rosld.adapters.ros2.adapter import Ros2Adapter, Source
from rosld.adapters.ros2.middleware import Participant
from rosld.adapters.ros2.system import unique_name
from rosld.adapters.ros2.wait_set import Waiter

PORT = 7447
_DOMAINS = tuple(map(str, range(233)))


def adapter(source: str, options: AdapterOptions) -> ZenohAdapter:
    """Return the adapter for a source such as `zenoh:` (the router on this machine) or `zenoh://robot:7447?domain=1`.

    Raises ValueError for other sources, and if zenoh is not installed.
    """
    read = read_source(source, PORT, ("domain",))
    domain = read.options.get("domain") or os.environ.get("ROS_DOMAIN_ID") or "0"
    if "/" in read.address or read.authorization or domain not in _DOMAINS:
        raise ValueError(f"write zenoh://HOST:{PORT}?domain=0, with a domain from 0 to {len(_DOMAINS) - 1}")
    for module in ("zenoh", "xxhash"):
        try:
            importlib.import_module(module)
        except ImportError as error:
            raise ValueError(f"zenoh: needs a package that is missing ({error}): pip install 'rosld[zenoh]'") from error
    return ZenohAdapter(f"tcp/{read.address}", int(domain), options)


class ZenohAdapter(Ros2Adapter):
    """A ROS 2 system, reached through a router of zenoh, to which rosld connects again by itself."""

    _middleware = "zenoh"

    def __init__(self, endpoint: str, domain: int, options: AdapterOptions) -> None:
        super().__init__(Source(domain), options)
        self._endpoint = endpoint

    def _join(self) -> tuple[Participant, Waiter]:
        from rosld.adapters.ros2.zenoh_participant import ZenohParticipant, ZenohWaiter

        name = f"_{unique_name()}"
        return ZenohParticipant(self._endpoint, name, self._domain or 0, "/", self._library), ZenohWaiter()
