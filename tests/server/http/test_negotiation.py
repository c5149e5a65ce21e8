"""Content negotiation (RFC 9110 12.5.1) and preferences (RFC 7240)."""

from __future__ import annotations

import string
import weakref

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.fields import quote_string
from rosld.server.http.negotiation import (
    MediaType,
    Preference,
    Preferences,
    choose_offer,
    parse_media_type,
    parse_prefer,
    preference_applied,
)

OFFERS = ("text/turtle", "application/ld+json", "application/json", "text/html")


def test_the_most_wanted_offer_is_chosen() -> None:
    for accept, chosen in (
        (None, "text/turtle"),
        ("", "text/turtle"),
        (" , ,", "text/turtle"),
        ("*/*", "text/turtle"),
        ("application/*", "application/ld+json"),
        ("application/json, text/turtle", "text/turtle"),
        ("application/json, text/turtle;q=0.9", "application/json"),
        ("TEXT/HTML", "text/html"),
        ("text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8", "text/html"),
        ("*/*, text/turtle;q=0", "application/ld+json"),
        ("text/*;q=0.5, text/html;q=0.1, */*;q=0.2", "text/turtle"),
        ("text/turtle;q=0.000, */*;q=0.001", "application/ld+json"),
        ('application/ld+json;profile="http://www.w3.org/ns/json-ld#compacted"', "application/ld+json"),
        ("text/turtle;charset=UTF-8", "text/turtle"),
        ("text/turtle;version=1.2", "text/turtle"),
        ('text/turtle;note="a,b;q=0";q=0.1, application/json;q=0.05', "application/json"),
        ("text/turtle;q=1;ext=foo, application/json;q=0.9", "text/turtle"),
        ("application/json ; q=0.5 , text/html ; q=0.6", "text/html"),
        ("garbage, application/json", "application/json"),
        ("garbage", "text/turtle"),
        ("text/html;q=2", "text/turtle"),
        ("text/html;q=0.1234", "text/turtle"),
        ("text/html;q=NaN", "text/turtle"),
        ("text/html;q=-1", "text/turtle"),
        ("*/html", "text/turtle"),
        ('text/html;a="unfinished', "text/turtle"),
    ):
        assert choose_offer(accept, OFFERS) == chosen


def test_what_accepts_nothing_that_is_offered_gets_nothing() -> None:
    for accept in (
        *("image/png", "text/turtle;q=0", "*/*;q=0", "text/turtle;charset=iso-8859-1", "text/turtle;level=1"),
        *("image/png, garbage", "application/xml"),
    ):
        assert choose_offer(accept, OFFERS) is None


def test_who_wants_xml_alone_gets_rdf_xml() -> None:
    for accept in ("application/xml", "text/xml;charset=utf-8", "image/png, application/xml;q=0.1"):
        assert choose_offer(accept, (*OFFERS, "application/rdf+xml")) == "application/rdf+xml"


def test_who_takes_something_else_than_xml_gets_that() -> None:
    for accept in ("text/html,application/xml;q=0.9,*/*;q=0.8", "application/xml, text/html;q=0.1"):
        assert choose_offer(accept, (*OFFERS, "application/rdf+xml")) == "text/html"


def test_an_offer_with_parameters_is_matched_by_its_own_range_first() -> None:
    offers = ("text/html", "text/html;level=1")
    assert choose_offer("text/html;level=1;q=0.9, text/html;q=0.5", offers) == "text/html;level=1"


class Kept(str):
    """A text that tells whether it is still referenced."""


def test_a_long_field_is_answered_without_being_kept() -> None:
    short, long = (
        Kept(", ".join(f"application/x{n}" for n in range(size)) + ", application/json") for size in (2, 500)
    )
    kept = [weakref.ref(short), weakref.ref(long)]
    assert [choose_offer(accept, OFFERS) for accept in (short, long)] == ["application/json"] * 2
    del short, long
    assert [each() is None for each in kept] == [False, True]


_weights = st.integers(0, 1000).map(lambda thousandths: f"{thousandths / 1000:.3f}")
_ranges = st.sampled_from([*OFFERS, "text/*", "application/*", "*/*", "image/png"])
_accepts = st.lists(st.tuples(_ranges, _weights), min_size=1, max_size=8)


@given(_accepts)
def test_the_choice_is_the_first_of_the_offers_with_the_greatest_weight(members: list[tuple[str, str]]) -> None:
    def weight(offer: str) -> float:
        kind = offer.partition("/")[0]
        for matching in (offer, f"{kind}/*", "*/*"):
            found = [float(weight) for range_, weight in members if range_ == matching]
            if found:
                return found[0]
        return 0.0

    best = max(OFFERS, key=weight)
    assert choose_offer(", ".join(f"{range_};q={weight}" for range_, weight in members), OFFERS) == (
        best if weight(best) > 0 else None
    )


@given(st.text(max_size=200))
def test_no_text_whatever_makes_negotiation_fail(accept: str) -> None:
    assert choose_offer(accept, OFFERS) in (*OFFERS, None)


_tokens = st.text(string.ascii_lowercase + string.digits + "+-.", min_size=1, max_size=8)
_values = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=12)


@given(_tokens, _tokens, st.dictionaries(_tokens.filter(lambda name: name != "charset"), _values, max_size=3))
def test_a_media_type_is_read_as_it_was_written(kind: str, subtype: str, parameters: dict[str, str]) -> None:
    written = MediaType(kind, subtype, tuple(sorted(parameters.items())))
    assert parse_media_type(str(written)) == written


def test_what_is_no_media_type_is_refused() -> None:
    for text in ("", "text", "text/", "/turtle", "text/tur tle", "text/a;b=c;b=d", "text/a;=b", "a/b;c=d e"):
        with pytest.raises(ValueError):  # noqa: PT011 - each has its own sentence
            parse_media_type(text)


def test_wait_is_read_beside_others() -> None:
    assert parse_prefer("respond-async, wait=10").wait == 10
    assert parse_prefer("wait=soon").wait is None
    assert parse_prefer("wait=99999999999999").wait is None
    assert parse_prefer("wait=²").wait is None


def test_what_was_applied_is_told_and_nothing_is_injected() -> None:
    assert preference_applied("return=minimal", "wait=5") == "return=minimal, wait=5"
    with pytest.raises(ValueError, match="control"):
        preference_applied("return=minimal\r\nSet-Cookie: a=b")


_names = st.text(string.ascii_lowercase + string.digits + "-", min_size=1, max_size=8)
_preferences = st.builds(Preference, _values, st.lists(st.tuples(_names, _values), max_size=3).map(tuple))


@given(st.dictionaries(_names, _preferences, max_size=4))
def test_preferences_are_read_as_they_were_written(named: dict[str, Preference]) -> None:
    written = (
        "; ".join(f"{key}={quote_string(value)}" for key, value in ((name, one.value), *one.parameters))
        for name, one in named.items()
    )
    assert parse_prefer(", ".join(written)) == Preferences(named)


@given(st.text(max_size=200))
def test_no_text_whatever_makes_reading_fail(text: str) -> None:
    assert parse_prefer(text).wait is None or "wait" in text.lower()
