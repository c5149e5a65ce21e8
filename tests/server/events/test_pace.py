"""How often a reader is told."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.server.events.pace import Pace


def test_the_first_event_passes_at_once() -> None:
    assert Pace(1.0).wait(0.0) == 0.0


def test_the_next_waits_most_of_an_interval() -> None:
    pace = Pace(2.0)
    pace.passed(10.0)
    assert pace.wait(10.0) == 0.375
    assert pace.wait(10.375) == 0.0


def test_a_topic_as_fast_as_its_reader_is_not_held_up_by_its_jitter() -> None:
    pace = Pace(10.0)
    for tick in range(1000):
        now = tick / 10 + (0.01 if tick % 2 else -0.01)
        assert pace.wait(now) == 0.0
        pace.passed(now)


@given(st.floats(0.1, 100.0), st.lists(st.floats(0.0, 0.3), min_size=1, max_size=200))
def test_no_span_has_more_events_than_its_rate_allows(rate: float, pauses: list[float]) -> None:
    pace, now, passed = Pace(rate), 0.0, []
    for pause in pauses:
        now += pause
        now += pace.wait(now)
        pace.passed(now)
        passed.append(now)
    for first in range(len(passed)):
        for last in range(first, len(passed)):
            assert last - first + 1 <= rate * (passed[last] - passed[first]) + 1.25 + 1e-6
