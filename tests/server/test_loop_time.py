"""The time of loops."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
import uvloop

from rosld.server.runtime.tasks import loop_time


@pytest.mark.parametrize("make", [asyncio.new_event_loop, uvloop.new_event_loop])
def test_a_loop_tells_its_time_by_the_clock_that_deadlines_are_told_by(
    make: Callable[[], asyncio.AbstractEventLoop],
) -> None:
    async def difference() -> float:
        return min(abs(asyncio.get_running_loop().time() - loop_time()) for _ in range(100))

    loop = make()
    try:
        assert loop.run_until_complete(difference()) < 0.01
    finally:
        loop.close()
