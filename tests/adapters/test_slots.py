"""Slots: the newest samples of each publisher, and the wakes of those who wait."""

from __future__ import annotations

import asyncio

import pytest

from rosld.adapters.model import Encoding, Sample, TypeRef
from rosld.adapters.slots import Slot


def sample(publisher: str, sequence: int) -> Sample:
    return Sample(b"", Encoding.ROS1, TypeRef("std_msgs/msg/Empty", "0"), publisher, sequence, sequence)


def test_the_newest_of_each_publisher_is_shown_in_order_of_receipt() -> None:
    slot = Slot()
    for each in (sample("/b", 1), sample("/a", 2), sample("/b", 3)):
        slot.put(each)
    assert [(each.publisher, each.sequence) for each in slot.latest()] == [("/a", 2), ("/b", 3)]


def test_a_deeper_subscription_keeps_what_was_there_and_more_from_then_on() -> None:
    slot = Slot()
    slot.put(sample("/a", 1))
    slot.put(sample("/a", 2))
    deep = slot.subscribe(3)
    for number in (3, 4, 5):
        slot.put(sample("/a", number))
    assert [each.sequence for each in deep.latest()] == [3, 4, 5]
    assert [each.sequence for each in slot.latest()] == [5]
    with pytest.raises(ValueError, match="depth of 0"):
        slot.subscribe(0)


def test_a_dropped_publisher_is_forgotten_and_subscriptions_are_counted() -> None:
    slot = Slot()
    slot.put(sample("/a", 1))
    slot.drop("/a")
    slot.drop("/never")
    assert slot.latest() == ()
    one, two = slot.subscribe(), slot.subscribe()
    one.close()
    one.close()
    assert slot.subscriptions == 1
    two.close()
    assert slot.subscriptions == 0
    assert two.latest() == ()


async def test_what_arrives_in_one_turn_of_the_loop_wakes_once() -> None:
    slot = Slot()
    wakes: list[int] = []
    subscription = slot.subscribe()
    subscription.watch(lambda: wakes.append(slot.latest()[-1].sequence))
    for number in range(1, 6):
        slot.put(sample("/a", number))
    assert wakes == []
    await asyncio.sleep(0)
    assert wakes == [5]


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
