"""How often a topic may be published to, by arithmetic alone."""

from __future__ import annotations

import pytest

from rosld.server.robot.publish_rate import PublishLimiter


def passing(limiter: PublishLimiter, now: float, topic: str = "/a") -> int:
    """How many publishes pass at this moment."""
    return next(count for count in range(1000) if limiter.wait(topic, now) > 0)


@pytest.mark.parametrize(("rate", "burst"), [(10.0, 10), (1.0, 1), (0.5, 1)])
def test_a_burst_is_one_seconds_worth_however_long_nothing_was_published(rate: float, burst: int) -> None:
    limiter = PublishLimiter(rate)
    assert passing(limiter, 0.0) == burst
    assert passing(limiter, 3600.0) == burst


def test_after_a_burst_the_rate_holds_and_the_wait_is_told() -> None:
    limiter = PublishLimiter(10.0)
    passing(limiter, 0.0)
    assert limiter.wait("/a", 0.05) == pytest.approx(0.05)
    assert sum(limiter.wait("/a", 0.05 + step / 100) == 0.0 for step in range(1, 201)) == 20


def test_each_topic_has_its_own_rate() -> None:
    limiter = PublishLimiter(3.0)
    assert (passing(limiter, 0.0, "/a"), passing(limiter, 0.0, "/b")) == (3, 3)
