"""Scheduling of requests in iterations of the loop, and the clock of deadlines."""

from __future__ import annotations

import asyncio

from rosld.server.middleware.limits import RequestScheduler


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
