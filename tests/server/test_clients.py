"""How much one client may ask: by name, by address, in a second, at a time."""

from __future__ import annotations

import pytest

from rosld.server.auth import rate_limit as limits
from rosld.server.auth.agent import ANYBODY, Agent
from rosld.server.auth.rate_limit import ClientLimiter, ClientLimits, name_of
from rosld.server.http.problem import Problem

FAR, OTHER = "192.0.2.1", "192.0.2.2"


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def clients(
    clock: Clock, *, rate: float = 10.0, requests: int = 1000, connections: int = 10, loopback: bool = False
) -> ClientLimiter:
    return ClientLimiter(ClientLimits(rate, requests, connections), loopback=loopback, clock=clock)


def passing(of: ClientLimiter, agent: Agent = ANYBODY, address: str = FAR) -> int:
    """How many requests pass at this moment."""
    for number in range(1000):
        try:
            of.leave(of.admit(agent, address))
        except Problem:
            return number
    return 1000


def test_a_client_may_send_two_seconds_worth_at_once_and_its_rate_from_then_on() -> None:
    clock = Clock()
    of = clients(clock)
    assert passing(of) == 20
    clock.now += 1.0
    assert passing(of) == 10
    clock.now += 100.0
    assert passing(of) == 20


def test_a_rate_below_one_a_second_lets_one_pass() -> None:
    clock = Clock()
    of = clients(clock, rate=0.1)
    assert passing(of) == 1
    clock.now += 5.0
    assert passing(of) == 0
    clock.now += 5.1
    assert passing(of) == 1


def test_every_client_has_a_limit_of_its_own_and_who_says_who_they_are_is_known_by_that() -> None:
    of = clients(Clock())
    assert passing(of) == 20
    assert passing(of, address=OTHER) == 20
    assert passing(of, Agent("ann")) == 20
    assert passing(of, Agent("ann"), OTHER) == 0


def test_requests_under_way_are_counted() -> None:
    of = clients(Clock(), requests=2)
    first = of.admit(ANYBODY, FAR)
    of.admit(ANYBODY, FAR)
    with pytest.raises(Problem, match="2 requests") as refused:
        of.admit(ANYBODY, FAR)
    assert (refused.value.status, refused.value.headers["Retry-After"]) == (429, "1")
    of.leave(first)
    assert of.admit(ANYBODY, FAR) is not None


def test_connections_are_counted() -> None:
    of = clients(Clock(), connections=2)
    ended = of.connect(FAR)
    of.connect(FAR)
    with pytest.raises(Problem, match="2 connections"):
        of.connect(FAR)
    of.connect(OTHER)
    ended()
    of.connect(FAR)


def test_this_machine_has_no_limits_unless_it_is_to_have_them() -> None:
    assert passing(clients(Clock()), address="127.0.0.1") == 1000
    assert passing(clients(Clock()), address="::1") == 1000
    assert passing(clients(Clock()), Agent("ann"), "127.0.0.1") == 20
    assert passing(clients(Clock(), loopback=True), address="127.0.0.1") == 20


@pytest.mark.parametrize(
    ("address", "name"),
    [
        ("192.0.2.7", "address 192.0.2.7"),
        ("::ffff:192.0.2.7", "address 192.0.2.7"),
        ("::ffff:127.0.0.1", None),
        ("2001:db8:1:2:3:4:5:6", "address 2001:db8:1:2::/64"),
        ("fe80::1%eth0", "address fe80::/64"),
        ("somewhere", "address somewhere"),
        (None, "address None"),
    ],
)
def test_an_address_is_known_by_its_machine(address: str | None, name: str | None) -> None:
    assert name_of(address, loopback=False) == name


def test_no_number_of_clients_fills_the_memory() -> None:
    clock = Clock()
    of = clients(clock)
    for number in range(30_000):
        of.leave(of.admit(ANYBODY, f"10.{number >> 16}.{number >> 8 & 255}.{number & 255}"))
        clock.now += 0.01
    assert len(of._known) <= 10_001
    assert len(of._names) <= 10_001


def test_a_client_with_an_open_connection_is_not_forgotten_however_many_others_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(limits, "_MOST_KNOWN", 4)
    clock = Clock()
    of = clients(clock, connections=1)
    of.connect(FAR)
    for number in range(10):
        passing(of, address=f"198.51.100.{number}")
        clock.now += 100
    with pytest.raises(Problem, match="1 connections come from your address"):
        of.connect(FAR)
