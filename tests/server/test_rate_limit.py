"""Rate limits as pure computations: of requests per client, of publishes per topic, of events per stream."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.auth import rate_limit
from rosld.server.auth.rate_limit import ClientLimiter, ClientLimits, TokenBucket, client_name
from rosld.server.auth.rules import ANONYMOUS, Agent
from rosld.server.events.event_stream import BURST
from rosld.server.http.problem import Problem
from rosld.server.robot.write_policy import PublishLimiter

FAR, OTHER = "192.0.2.1", "192.0.2.2"


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def limiter_for(
    clock: Clock, *, rate: float = 10.0, requests: int = 1000, connections: int = 10, loopback: bool = False
) -> ClientLimiter:
    return ClientLimiter(ClientLimits(rate, requests, connections), loopback=loopback, clock=clock)


def passing(limiter: ClientLimiter, agent: Agent = ANONYMOUS, address: str = FAR) -> int:
    """Return how many requests pass at this time."""
    for number in range(1000):
        try:
            limiter.release(limiter.acquire(agent, address))
        except Problem:
            return number
    return 1000


def test_a_rate_below_one_a_second_lets_one_pass_and_says_when_the_next_may() -> None:
    clock = Clock()
    limiter = limiter_for(clock, rate=0.1)
    assert passing(limiter) == 1
    clock.now += 4.0
    with pytest.raises(Problem, match=r"0\.1 requests per second") as refused:
        limiter.acquire(ANONYMOUS, FAR)
    assert refused.value.headers["Retry-After"] == "6"
    clock.now += 6.1
    assert passing(limiter) == 1


def test_every_client_has_a_limit_of_its_own_by_agent_or_else_by_address() -> None:
    limiter = limiter_for(Clock())
    assert passing(limiter) == 20
    assert passing(limiter, address=OTHER) == 20
    assert passing(limiter, Agent("ann")) == 20
    assert passing(limiter, Agent("ann"), OTHER) == 0


def test_loopback_has_no_limits_unless_it_is_set_to_have_them() -> None:
    assert passing(limiter_for(Clock()), address="127.0.0.1") == 1000
    assert passing(limiter_for(Clock()), address="::1") == 1000
    assert passing(limiter_for(Clock()), Agent("ann"), "127.0.0.1") == 20
    assert passing(limiter_for(Clock(), loopback=True), address="127.0.0.1") == 20


def test_an_address_stands_for_its_machine() -> None:
    for address, name in (
        ("192.0.2.7", "address 192.0.2.7"),
        ("::ffff:192.0.2.7", "address 192.0.2.7"),
        ("::ffff:127.0.0.1", None),
        ("2001:db8:1:2:3:4:5:6", "address 2001:db8:1:2::/64"),
        ("fe80::1%eth0", "address fe80::/64"),
        ("somewhere", "address somewhere"),
        (None, "address None"),
    ):
        assert client_name(address, loopback=False) == name


@pytest.mark.slow
def test_no_number_of_clients_fills_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rate_limit, "MAX_CLIENTS", 300)
    clock = Clock()
    limiter = limiter_for(clock)

    def held(numbers: range) -> int:
        for number in numbers:
            limiter.release(limiter.acquire(ANONYMOUS, f"10.0.{number >> 8}.{number & 255}"))
            clock.now += 0.01
        own = tracemalloc.Filter(True, rate_limit.__file__)  # servers of other tests run in this process
        return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces([own]).traces)

    tracemalloc.start()
    try:
        few = held(range(1000))
        assert held(range(1000, 6000)) < 3 * few
    finally:
        tracemalloc.stop()


def test_a_client_with_an_open_connection_is_not_forgotten_however_many_others_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rate_limit, "MAX_CLIENTS", 4)
    clock = Clock()
    limiter = limiter_for(clock, connections=1)
    limiter.connect(FAR)
    for number in range(10):
        passing(limiter, address=f"198.51.100.{number}")
        clock.now += 100
    with pytest.raises(Problem, match="1 connections from your address"):
        limiter.connect(FAR)


def publishes(limiter: PublishLimiter, now: float, topic: str = "/a") -> int:
    """Return how many publishes pass at this time."""
    return next(count for count in range(1000) if limiter.wait(topic, now) > 0)


def test_publishing_is_bounded_for_each_topic_by_its_rate_after_a_burst_of_one_second() -> None:
    for rate, burst in ((10.0, 10), (1.0, 1), (0.5, 1)):
        limiter = PublishLimiter(rate)
        assert publishes(limiter, 0.0) == publishes(limiter, 3600.0) == burst
        assert publishes(limiter, 3600.0, "/b") == burst, "each topic has its own rate"
    limiter = PublishLimiter(10.0)
    publishes(limiter, 0.0)
    assert limiter.wait("/a", 0.05) == pytest.approx(0.05)
    assert sum(limiter.wait("/a", 0.05 + step / 100) == 0.0 for step in range(1, 201)) == 20


def test_publishes_that_cannot_wait_delay_others_by_at_most_a_second_and_one_interval() -> None:
    for rate in (10.0, 1.0, 0.5):
        limiter = PublishLimiter(rate)
        for _ in range(100):
            limiter.count("/a", 5.0)
        assert limiter.wait("/a", 5.0) == pytest.approx(1.0 + 1.0 / rate)


def test_a_topic_as_fast_as_its_reader_is_not_held_up_by_its_jitter() -> None:
    bucket = TokenBucket(10.0, BURST)
    for tick in range(100):
        now = tick / 10 + (0.01 if tick % 2 else -0.01)
        assert bucket.wait(now) == 0.0
        bucket.take(now)


@given(
    st.floats(0.1, 100.0),
    st.one_of(st.just(BURST), st.floats(1.0, 20.0)),
    st.lists(st.floats(0.0, 0.3), min_size=1, max_size=50),
)
def test_no_span_has_more_events_than_rate_and_burst_allow(rate: float, burst: float, pauses: list[float]) -> None:
    bucket, now, passed = TokenBucket(rate, burst), 0.0, []
    for pause in pauses:
        now += pause
        now += bucket.wait(now)
        bucket.take(now)
        passed.append(now)
    for first in range(len(passed)):
        for last in range(first, len(passed)):
            assert last - first + 1 <= rate * (passed[last] - passed[first]) + burst + 1e-6
