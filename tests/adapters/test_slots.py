"""Slots: the newest samples of each publisher, and the notification of waiting tasks."""

from __future__ import annotations

import asyncio

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.slots import Slot


def sample(publisher: str, sequence: int) -> Sample:
    return Sample(b"", Encoding.ROS1, TypeRef("std_msgs/msg/Empty", "0"), publisher, sequence, sequence)


async def test_a_closed_subscription_wakes_nobody_not_even_when_a_wake_was_due() -> None:
    slot = Slot()
    wakes: list[int] = []
    subscription = slot.subscribe()
    subscription.watch(lambda: wakes.append(1))
    slot.put(sample("/a", 1))
    subscription.close()
    subscription.watch(lambda: wakes.append(2)).close()
    await asyncio.sleep(0)
    slot.put(sample("/a", 2))
    await asyncio.sleep(0)
    assert wakes == []
    assert len(slot.watches) == 0


async def test_one_who_raises_on_waking_keeps_nobody_else_from_waking() -> None:
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
    slot = Slot()
    woken = asyncio.Event()

    def fail() -> None:
        raise RuntimeError("on purpose")

    slot.subscribe().watch(fail)
    slot.subscribe().watch(woken.set)
    slot.put(sample("/a", 1))
    await asyncio.wait_for(woken.wait(), 60)
