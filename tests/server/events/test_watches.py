"""Watches: how something tells that it may have changed."""

from __future__ import annotations

import asyncio

from rosld.server.runtime.signals import Signal, call_every, combine_watches


def test_a_signal_wakes_its_watches_of_that_subject_until_they_are_closed() -> None:
    woken: list[str] = []
    signal = Signal()
    first = signal.watch(lambda: woken.append("first"))
    signal.watch(lambda: woken.append("second"), lambda about: about.startswith("/a"))
    signal.emit("/b")
    first.close()
    first.close()
    signal.emit("/a/x")
    assert woken == ["first", "second"]


def test_a_watch_may_close_itself_and_others_while_it_is_woken() -> None:
    woken: list[int] = []
    signal = Signal()

    def wake(number: int) -> None:
        woken.append(number)
        for each in watches:
            each.close()

    watches = [signal.watch(lambda number=number: wake(number)) for number in range(3)]
    signal.emit()
    assert woken == [0]


def test_several_watches_are_one_and_what_cannot_tell_is_looked_at_again() -> None:
    async def main() -> None:
        woken = asyncio.Event()
        signal = Signal()
        both = combine_watches(signal.watch(woken.set), call_every(0.01, woken.set))
        for _ in range(3):
            await asyncio.wait_for(woken.wait(), 60)
            woken.clear()
        both.close()
        both.close()
        signal.emit()
        await asyncio.sleep(0.05)
        assert not woken.is_set()

    asyncio.run(main())
