"""The flight model, without any clock."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.aircraft.adapter import ACCELERATION, Declined, Flight, set_power, set_speed, start, stop

SECOND = 10**9
speeds = st.floats(0, 1000)
moments = st.integers(0, 3600 * SECOND)


@given(speeds, speeds, moments, moments)
def test_no_command_makes_the_speed_jump(first: float, second: float, told: int, later: int) -> None:
    flight = set_speed(start(Flight(), 0), first, 0)
    again = set_speed(flight, second, told)
    assert again.speed_at(told) == pytest.approx(flight.speed_at(told))
    gone = abs(again.speed_at(told + later) - flight.speed_at(told))
    assert gone <= ACCELERATION * later / SECOND + 1e-6


def test_a_speed_that_is_only_commanded_does_not_keep_it_from_stopping() -> None:
    flight = set_speed(start(Flight(), 0), 100.0, 7)
    off = stop(flight, 7)
    assert off.speed_at(3600 * SECOND) == 0.0


def test_stopping_what_is_off_changes_nothing_and_other_words_for_the_power_are_declined() -> None:
    assert stop(Flight(), 5).power == "off"
    for word in ("", "On", "ON", "true", "1", "o\nn"):
        with pytest.raises(Declined, match="'on' or 'off'"):
            set_power(Flight(), word, 0)
