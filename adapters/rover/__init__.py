"""Embedded mobile robot in a small world: `rosld serve rover`.

Everything except `adapter.py` needs only numpy, so that a ROS node can run the same robot.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosld.adapters.base import Adapter, AdapterOptions


def rover_adapter(source: str, options: AdapterOptions) -> Adapter:
    """Return the adapter of a source such as `rover` or `rover:?battery=0.21`. Raises ValueError for a bad option."""
    from rosld.adapters.rover.adapter import Rover  # late: a ROS node's Python may lack its dependencies
    from rosld.adapters.rover.simulation import read_source

    return Rover(read_source(source), options)


__all__ = ["rover_adapter"]
