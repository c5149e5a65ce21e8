"""The flight model, without any clock."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.aircraft.flight import (
    ACCELERATION,
    Declined,
    Flight,
    set_heading,
    set_power,
    set_speed,
    start,
    stop,
)

SECOND = 10**9
speeds = st.floats(0, 1000)
directions = st.floats(0, 360)
moments = st.integers(0, 3600 * SECOND)


def test_at_start_it_is_off_at_rest_and_heads_north() -> None:
    flight = Flight()
    assert (flight.power, flight.speed_at(0), flight.direction) == ("off", 0.0, 0.0)


def test_speed_changes_by_a_hundred_a_second_and_reaches_the_commanded_one_exactly() -> None:
    flight = set_speed(start(Flight(), 0), 250.0, 0)
    assert flight.speed_at(SECOND) == 100.0
    assert flight.speed_at(2 * SECOND) == 200.0
    assert flight.speed_at(5 * SECOND // 2) == 250.0
    assert flight.speed_at(3600 * SECOND) == 250.0


def test_speed_falls_as_it_rises() -> None:
    flight = set_speed(set_speed(start(Flight(), 0), 300.0, 0), 50.0, 10 * SECOND)
    assert flight.speed_at(11 * SECOND) == 200.0
    assert flight.speed_at(13 * SECOND) == 50.0


@given(speeds, speeds, moments, moments)
def test_no_command_makes_the_speed_jump(first: float, second: float, told: int, later: int) -> None:
    flight = set_speed(start(Flight(), 0), first, 0)
    again = set_speed(flight, second, told)
    assert again.speed_at(told) == pytest.approx(flight.speed_at(told))
    gone = abs(again.speed_at(told + later) - flight.speed_at(told))
    assert gone <= ACCELERATION * later / SECOND + 1e-6


@given(speeds, moments)
def test_the_speed_is_the_commanded_one_after_ten_seconds_at_most(speed: float, told: int) -> None:
    flight = set_speed(start(Flight(), 0), speed, told)
    assert flight.speed_at(told + 10 * SECOND) == speed


@given(directions, moments)
def test_turning_leaves_the_speed_as_it_is(direction: float, told: int) -> None:
    flight = set_speed(start(Flight(), 0), 700.0, 0)
    turning = set_heading(flight, direction, told)
    assert turning.direction == direction
    assert turning.speed_at(told) == flight.speed_at(told)
    assert turning.speed_at(told + 10 * SECOND) == 700.0


def test_a_speed_or_a_direction_out_of_range_is_declined_naming_it() -> None:
    for value in (-0.1, 1000.1, math.nan, math.inf, -math.inf, 1e308):
        with pytest.raises(Declined, match=re.escape(f"between 0 and 1000, not {value:g}")):
            set_speed(start(Flight(), 0), value, 0)
    for value in (-1.0, 360.1, math.nan, math.inf):
        with pytest.raises(Declined, match="between 0 and 360"):
            set_heading(start(Flight(), 0), value, 0)
    for value in (0.0, 1000.0):
        assert set_speed(start(Flight(), 0), value, 0).commanded == value
    assert math.copysign(1, set_speed(start(Flight(), 0), -0.0, 0).commanded) == 1


def test_nothing_is_set_while_off() -> None:
    with pytest.raises(Declined, match="the aircraft is off"):
        set_speed(Flight(), 10.0, 0)
    with pytest.raises(Declined, match="the aircraft is off"):
        set_heading(Flight(), 10.0, 0)


def test_starting_twice_is_declined_in_either_way() -> None:
    flight = start(Flight(), 0)
    with pytest.raises(Declined, match="already started"):
        start(flight, 1)
    with pytest.raises(Declined, match="already started"):
        set_power(flight, "on", 1)


def test_it_is_not_switched_off_while_it_moves_but_once_it_stands() -> None:
    flight = set_speed(start(Flight(), 0), 100.0, 0)
    for off in (lambda now: stop(flight, now), lambda now: set_power(flight, "off", now)):
        with pytest.raises(Declined, match="still moves at 50"):
            off(SECOND // 2)
    braked = set_speed(flight, 0.0, SECOND)
    with pytest.raises(Declined):
        stop(braked, 3 * SECOND // 2)
    assert not stop(braked, 2 * SECOND).on


def test_a_speed_that_is_only_commanded_does_not_keep_it_from_stopping() -> None:
    flight = set_speed(start(Flight(), 0), 100.0, 7)
    off = stop(flight, 7)
    assert off.speed_at(3600 * SECOND) == 0.0


def test_stopping_what_is_off_changes_nothing_and_other_words_for_the_power_are_declined() -> None:
    assert stop(Flight(), 5).power == "off"
    for word in ("", "On", "ON", "true", "1", "o\nn"):
        with pytest.raises(Declined, match="'on' or 'off'"):
            set_power(Flight(), word, 0)
