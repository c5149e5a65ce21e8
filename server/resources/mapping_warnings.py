"""What the mappings that a server begins with name in vain, told in its log."""

from __future__ import annotations

import asyncio
import logging

from rosld.server.hypermedia.affordance_service import AffordanceService
from rosld.server.hypermedia.mappings import Mappings
from rosld.server.rest.state import State
from rosld.server.runtime.tasks import loop_time

_DISCOVERY = 5.0
"""Seconds that a robot is given to be discovered: in ROS 2 nodes are heard of one after the other."""
_AGAIN = 0.5
_log = logging.getLogger("rosld")


async def log_mapping_warnings(affordances: AffordanceService[State], mappings: Mappings) -> None:
    """Log what the mappings name that is not there, or cannot be offered, once the robot can have been discovered."""
    until = loop_time() + _DISCOVERY
    while found := await _warnings(affordances, mappings):
        if loop_time() > until:
            for url, words in found:
                _log.warning("The mapping %s names in vain: %s", url, words)
            return
        await asyncio.sleep(_AGAIN)


async def _warnings(affordances: AffordanceService[State], mappings: Mappings) -> list[tuple[str, str]]:
    """The mapping documents' URLs, and what of each is not there now."""
    urls = tuple(mappings.documents)
    return [(url, words) for url in urls for words in await affordances.mapping_warnings(url)]
