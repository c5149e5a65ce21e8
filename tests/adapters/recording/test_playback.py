"""The clock of a playback, without any clock."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.recording.playback import Playback, Position

SECOND = 10**9
playbacks = st.builds(
    Playback,
    duration_ns=st.integers(0, 3600 * SECOND),
    count=st.integers(0, 10**6),
    rate=st.floats(0.01, 100),
)
moments = st.integers(0, 7 * 24 * 3600 * SECOND)


def test_it_begins_at_the_first_message() -> None:
    assert Playback(10 * SECOND, 11).position(0) == Position(0, 0)


def test_it_goes_as_fast_as_the_rate_says() -> None:
    assert Playback(10 * SECOND, 11, rate=2.0).position(3 * SECOND) == Position(0, 6 * SECOND)
    assert Playback(10 * SECOND, 11, rate=0.5).position(3 * SECOND) == Position(0, 3 * SECOND // 2)


def test_a_loop_ends_after_showing_the_last_message_for_as_long_as_messages_last() -> None:
    playback = Playback(10 * SECOND, 11)
    assert playback.position(11 * SECOND - 1) == Position(0, 11 * SECOND - 1)
    assert playback.position(11 * SECOND) == Position(1, 0)
    assert playback.position(25 * SECOND) == Position(2, 3 * SECOND)


def test_played_once_it_rests_at_the_end() -> None:
    playback = Playback(10 * SECOND, 11, once=True)
    assert playback.position(3600 * SECOND) == Position(0, 10 * SECOND)


@pytest.mark.parametrize(("duration", "count"), [(0, 0), (0, 1), (0, 5)])
def test_recordings_of_no_duration_play_too(duration: int, count: int) -> None:
    playback = Playback(duration, count)
    assert 10**6 <= playback.period_ns <= SECOND
    assert playback.position(10 * SECOND).epoch >= 10


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan, math.inf])
def test_a_rate_that_is_none_is_refused_naming_it(rate: float) -> None:
    with pytest.raises(ValueError, match=str(rate)):
        Playback(1, 1, rate=rate)


@given(playbacks, moments, moments)
def test_it_never_goes_back(playback: Playback, one: int, other: int) -> None:
    earlier, later = sorted((one, other))
    assert playback.position(earlier) <= playback.position(later)


@given(playbacks, moments)
def test_a_position_is_reached_when_it_says_and_not_before(playback: Playback, elapsed: int) -> None:
    position = playback.position(elapsed)
    due = playback.elapsed_at(position)
    assert due <= elapsed + 1000
    assert playback.position(due + 1000) >= position
