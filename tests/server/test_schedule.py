"""Times of a held message: never twice for one time, without accumulating delays, never after the lease."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.robot.schedule import LeaseExpired, Publish, Schedule, Wait

periods = st.floats(0.02, 10.0)
origins = st.floats(0.0, 1e6)
delays = st.lists(st.floats(0.0, 0.5), min_size=1, max_size=60)


def run(schedule: Schedule, delays: list[float]) -> list[tuple[float, int]]:
    """Return the times and indexes of publishes if each look is this much too late."""
    published: list[tuple[float, int]] = []
    now = schedule.origin
    for delay in delays:
        match schedule.step(now):
            case Wait(until=until):
                assert until > now
                now = until + delay
            case Publish(after=after):
                published.append((now, after.tick - 1))
                assert after.due > now
                schedule = after
                now = after.due + delay
            case LeaseExpired():
                break
    return published


@given(periods, origins)
def test_a_punctual_publisher_publishes_at_every_beat_without_drift(period: float, origin: float) -> None:
    published = run(Schedule(period, origin, math.inf), [0.0] * 50)
    assert [beat for _, beat in published] == list(range(50))
    assert all(at == pytest.approx(origin + beat * period, abs=1e-9) for at, beat in published)


@given(periods, origins, delays)
def test_no_beat_is_repeated_or_early_and_missed_ones_are_left_out(
    period: float, origin: float, delays: list[float]
) -> None:
    published = run(Schedule(period, origin, math.inf), delays)
    beats = [beat for _, beat in published]
    assert beats == sorted(set(beats))
    for at, beat in published:
        assert at >= origin + beat * period - 1e-9
        assert at < origin + (beat + 1) * period + 1e-6 or beat == 0


@given(periods, origins, st.floats(0.001, 5.0), delays)
def test_nothing_is_published_when_the_lease_is_over(
    period: float, origin: float, lease: float, delays: list[float]
) -> None:
    schedule = Schedule(period, origin, origin + lease)
    assert all(at < origin + lease for at, _ in run(schedule, delays))
    assert schedule.step(origin + lease) == LeaseExpired()
    waiting = schedule.step(origin - 1.0)
    assert isinstance(waiting, Wait)
    assert waiting.until <= origin + lease


@given(periods, origins, st.floats(0.0, 100.0))
def test_renewing_the_lease_does_not_move_a_beat(period: float, origin: float, more: float) -> None:
    schedule = Schedule(period, origin, origin + 1.0, tick=3)
    assert schedule.with_lease(origin + more).due == schedule.due


@given(periods, periods, origins, st.integers(1, 1000))
def test_another_rate_counts_from_the_beat_that_came_last(
    period: float, other: float, origin: float, beat: int
) -> None:
    schedule = Schedule(period, origin, math.inf, beat)
    last = origin + (beat - 1) * period
    changed = schedule.with_period(other)
    assert changed.due == pytest.approx(last + other)
    assert schedule.with_period(period) == schedule
