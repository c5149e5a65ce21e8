"""Profiles as text, and incompatibilities of two qualities of service (DDS 1.4, 2.2.3)."""

from __future__ import annotations

import random
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.model import Endpoint, Mismatch, Qos, mismatch_count, mismatches, read_profile

SECOND = 1_000_000_000


def test_who_requests_more_than_is_offered_hears_nothing() -> None:
    for offered, requested, *told in (
        (Qos("best_effort"), Qos("reliable"), "reliability", "best_effort", "reliable"),
        (Qos(durability="volatile"), Qos(durability="transient_local"), "durability", "volatile", "transient_local"),
        (Qos(liveliness="automatic"), Qos(liveliness="manual_by_topic"), "liveliness", "automatic", "manual_by_topic"),
        (Qos(), Qos(deadline_ns=SECOND), "deadline", "for ever", "1 s"),
        (Qos(deadline_ns=2 * SECOND), Qos(deadline_ns=SECOND // 2), "deadline", "2 s", "0.5 s"),
        (Qos(), Qos(lease_ns=SECOND), "liveliness lease", "for ever", "1 s"),
        (Qos(lease_ns=2 * SECOND), Qos(lease_ns=SECOND), "liveliness lease", "2 s", "1 s"),
    ):
        one, other = Endpoint("/p", qos=offered), Endpoint("/s", qos=requested)
        assert mismatches([one], [other]) == (Mismatch("/p", "/s", *told),)
        assert mismatches([other], [one]) == ()


def test_what_only_concerns_one_side_or_is_not_known_is_no_mismatch() -> None:
    for offered, requested in (
        (Qos(history="keep_last", depth=1), Qos(history="keep_all")),
        (Qos(lifespan_ns=SECOND), Qos()),
        (Qos(), Qos(lifespan_ns=SECOND)),
        (Qos(), Qos(reliability="reliable")),
        (Qos(reliability="best_effort"), Qos()),
        (Qos(reliability="made_up"), Qos(reliability="reliable")),
    ):
        assert mismatches([Endpoint("/p", qos=offered)], [Endpoint("/s", qos=requested)]) == ()


def test_every_pair_that_does_not_fit_is_found_and_no_other() -> None:
    weak, strong = Qos("best_effort"), Qos("reliable")
    publishers = [Endpoint("/p1", qos=weak), Endpoint("/p2", qos=strong), Endpoint("/p3"), Endpoint("/p4", qos=weak)]
    subscribers = [Endpoint("/s1", qos=strong), Endpoint("/s2", qos=weak), Endpoint("/s3")]
    pairs = [(one.publisher, one.subscriber) for one in mismatches(publishers, subscribers)]
    assert pairs == [("/p1", "/s1"), ("/p4", "/s1")]


def test_of_many_pairs_as_many_are_told_as_are_asked_for_and_all_are_counted() -> None:
    weak, strong = Qos("best_effort"), Qos("reliable")
    publishers = [Endpoint(f"/p{number}", qos=replace(weak, depth=number)) for number in range(2000)]
    subscribers = [Endpoint("/s", qos=strong)] * 1000 + [Endpoint("/fits", qos=weak)] * 1000
    assert mismatch_count(publishers, subscribers) == 2_000_000
    assert mismatch_count(subscribers, subscribers) == 1_000_000
    told = mismatches(publishers, subscribers, 3)
    assert [(one.publisher, one.subscriber) for one in told] == [("/p0", "/s"), ("/p1", "/s"), ("/p2", "/s")]
    assert len(mismatches(subscribers, subscribers)) == 1


def test_a_profile_says_what_its_words_say_and_a_word_that_is_no_policy_is_named() -> None:
    for text, profile in (
        ("best_effort,volatile,depth:5", Qos("best_effort", "volatile", depth=5)),
        ("reliable", Qos("reliable")),
        (" keep_all , transient_local ", Qos(durability="transient_local", history="keep_all")),
        ("deadline:0.5,lifespan:2,lease:1e-9", Qos(deadline_ns=SECOND // 2, lifespan_ns=2 * SECOND, lease_ns=1)),
        ("manual_by_topic,keep_last,depth:100000", Qos(None, None, "keep_last", 100_000, liveliness="manual_by_topic")),
    ):
        assert read_profile(text) == profile
    for text, words in (
        ("", "'' is not a policy; choose from best_effort, reliable"),
        ("reliable,", "'' is not a policy"),
        ("besteffort", "'besteffort' is not a policy"),
        ("reliable:1", "'reliable:1' is not a policy"),
        ("reliable,best_effort", "'best_effort' sets the reliability twice"),
        ("depth:0", "'depth:0': the depth must be an integer from 1 to 100000"),
        ("depth:\u0665", "the depth must be"),
        ("depth:" + "9" * 5000, "the depth must be"),
        ("deadline:nan", "'deadline:nan': a deadline is a number of seconds"),
        ("lease:0", "a lease is"),
        ("lifespan:1_0", "a lifespan is"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            read_profile(text)


PROFILES = st.builds(
    Qos,
    reliability=st.sampled_from(["reliable", "best_effort"]),
    durability=st.sampled_from([None, "volatile", "transient_local"]),
    history=st.sampled_from([None, "keep_all", "keep_last"]),
    depth=st.integers(0, 100_000),
    deadline_ns=st.none() | st.integers(1, 10**15),
    lifespan_ns=st.none() | st.integers(1, 10**15),
    liveliness=st.sampled_from([None, "automatic", "manual_by_topic"]),
    lease_ns=st.none() | st.integers(1, 10**15),
)


@given(PROFILES, st.randoms())
def test_every_profile_can_be_written_in_any_order(profile: Qos, order: random.Random) -> None:
    words = [each for each in (profile.reliability, profile.durability, profile.history, profile.liveliness) if each]
    times = {"deadline": profile.deadline_ns, "lifespan": profile.lifespan_ns, "lease": profile.lease_ns}
    words += [f"{name}:{value / 1e9!r}" for name, value in times.items() if value]
    words += [f"depth:{profile.depth}"] if profile.depth else []
    order.shuffle(words)
    assert read_profile(",".join(words)) == profile


@given(st.text(st.sampled_from("adehlnpt:,._0159e-\u0665 ")) | st.text())
def test_any_other_text_is_refused_as_a_value_that_is_wrong(text: str) -> None:
    try:
        found = read_profile(text)
    except ValueError:
        return
    assert found != Qos()
