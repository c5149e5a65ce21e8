"""Scheduling of requests in iterations of the loop, and the clock of deadlines."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
import uvloop

from rosld.server.middleware.limits import RequestScheduler
from rosld.server.runtime.tasks import loop_time


def test_no_turn_begins_more_than_it_may_and_everybody_has_one_in_order() -> None:
    async def run() -> list[list[int]]:
        turns, begun = RequestScheduler(limit=4), list[list[int]]()

        async def ask(number: int) -> None:
            await turns.wait_turn()
            begun[-1].append(number)

        asked = [asyncio.ensure_future(ask(number)) for number in range(18)]
        while not all(each.done() for each in asked):
            begun.append([])
            await asyncio.sleep(0)
        return [each for each in begun if each]

    found = asyncio.run(run())
    assert [number for turn in found for number in turn] == list(range(18))
    assert max(map(len, found)) <= 4


def test_who_has_gone_takes_no_turn() -> None:
    async def run() -> bool:
        turns = RequestScheduler(limit=1)
        first, gone, last = (asyncio.ensure_future(turns.wait_turn()) for _ in range(3))
        await first
        gone.cancel()
        await asyncio.wait_for(last, 60)
        return gone.cancelled()

    assert asyncio.run(run())


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
