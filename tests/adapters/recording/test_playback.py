"""The clock of a playback, without any clock."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.recording.player import Playback

SECOND = 10**9
playbacks = st.builds(
    Playback,
    duration_ns=st.integers(0, 3600 * SECOND),
    count=st.integers(0, 10**6),
    rate=st.floats(0.01, 100),
)
moments = st.integers(0, 7 * 24 * 3600 * SECOND)


def test_recordings_of_no_duration_play_too_and_a_rate_that_is_none_is_refused_naming_it() -> None:
    for count in (0, 1, 5):
        playback = Playback(0, count)
        assert 10**6 <= playback.period_ns <= SECOND
        assert playback.position(10 * SECOND).epoch >= 10
    for rate in (0.0, -1.0, math.nan, math.inf):
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
