"""Choice of the quality of service for reading and publishing."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.model import Endpoint, Qos, mismatches
from rosld.adapters.ros2.profiles import (
    apply_override,
    is_compatible,
    override_for,
    publishing_profile,
    reading_profile,
)

PROFILES = st.builds(
    Qos,
    reliability=st.sampled_from(["reliable", "best_effort", None]),
    durability=st.sampled_from(["volatile", "transient_local", None]),
    deadline_ns=st.none() | st.integers(1, 10**10),
    liveliness=st.sampled_from(["automatic", "manual_by_topic"]),
    lease_ns=st.none() | st.integers(1, 10**10),
)
ENDPOINTS = st.lists(st.builds(Endpoint, node=st.just("/n"), qos=PROFILES), max_size=5)
LATCHED = Endpoint("/map", qos=Qos("reliable", "transient_local"))
PLAIN = Endpoint("/talker", qos=Qos("reliable", "volatile"))


@given(ENDPOINTS, st.booleans())
def test_all_subscribers_accept_what_we_publish_with(subscribers: list[Endpoint], latch: bool) -> None:
    ours = Endpoint("/rosld", qos=publishing_profile(subscribers, latch=latch))
    assert not mismatches([ours], subscribers)
    assert ours.qos is not None
    assert not latch or ours.qos.durability == "transient_local"


@given(ENDPOINTS, st.integers(1, 200))
def test_what_we_read_with_holds_nobody_back_unless_all_keep_their_messages(
    publishers: list[Endpoint], depth: int
) -> None:
    ours = reading_profile(publishers, depth)
    assert ours.depth >= depth
    assert not mismatches(
        [each for each in publishers if each.qos and each.qos.reliability], [Endpoint("/_", qos=ours)]
    )
    latched = publishers and all(
        each.qos is not None and (each.qos.reliability, each.qos.durability) == ("reliable", "transient_local")
        for each in publishers
    )
    assert (ours.reliability == "reliable") == bool(latched)


def test_a_latched_topic_is_read_as_its_publisher_keeps_it() -> None:
    assert reading_profile([LATCHED], 1).durability == "transient_local"
    assert reading_profile([LATCHED, PLAIN], 1).durability == "volatile"
    assert reading_profile([], 1) == Qos("best_effort", "volatile", "keep_last", 1)


def test_the_first_glob_that_fits_overrides_what_it_says_and_nothing_else() -> None:
    overrides = (("/camera/*", Qos("best_effort")), ("/*", Qos("reliable", depth=7)))
    assert override_for("/camera/image", overrides) == Qos("best_effort")
    assert override_for("/odom", overrides) == Qos("reliable", depth=7)
    assert override_for("/odom", ()) == Qos()
    assert apply_override(Qos("reliable", "volatile", depth=1), Qos("best_effort")) == Qos(
        "best_effort", "volatile", depth=1
    )


def test_our_own_reader_counts_as_a_subscriber_only_where_it_matches() -> None:
    reliable, best = Qos("reliable", "volatile"), Qos("best_effort", "volatile")
    kept = Qos("reliable", "transient_local")
    assert is_compatible(best, reliable)
    assert is_compatible(best, best)
    assert is_compatible(kept, kept)
    assert not is_compatible(reliable, best)
    assert not is_compatible(kept, reliable)
