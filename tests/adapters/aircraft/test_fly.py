"""The action of the aircraft: what it takes, how far it flies, how it ends."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.aircraft.flight import Declined, Flight
from rosld.adapters.aircraft.fly import MAX_DISTANCE, PACE, FlyGoal, accept, cancel, end_of
from rosld.adapters.model import GoalStatus

ON, OFF = Flight(on=True), Flight()


@pytest.mark.parametrize("distance", [math.nan, math.inf, -math.inf, -1.0, MAX_DISTANCE + 1])
def test_no_goal_is_taken_beyond_its_range(distance: float) -> None:
    with pytest.raises(Declined, match="between 0 and 100000"):
        accept(ON, None, "a", distance, 0)


def test_no_goal_is_taken_while_off_or_underway() -> None:
    with pytest.raises(Declined, match="off"):
        accept(OFF, None, "a", 1.0, 0)
    with pytest.raises(Declined, match="flies already"):
        accept(ON, FlyGoal("b", 1.0, 0), "a", 1.0, 0)


@given(st.floats(0, MAX_DISTANCE), st.lists(st.integers(0, 10**13)))
def test_it_never_flies_back_nor_too_far(distance: float, times: list[int]) -> None:
    fly = accept(ON, None, "a", distance, 0)
    flown = [fly.flown_at(now) for now in sorted(times)]
    assert flown == sorted(flown)
    assert all(0 <= each <= distance for each in flown)
    arrives = math.ceil(distance / PACE * 1e9) + 1000
    assert end_of(fly, ON, arrives) is not None


def test_it_ends_canceled_aborted_or_arrived() -> None:
    fly = accept(ON, None, "a", 10 * PACE, 0)
    assert end_of(fly, ON, 1) is None
    ends = [end_of(cancel(fly), ON, 1), end_of(fly, OFF, 1), end_of(fly, ON, 10 * 10**9)]
    assert [end and end.status for end in ends] == [GoalStatus.CANCELED, GoalStatus.ABORTED, GoalStatus.SUCCEEDED]
