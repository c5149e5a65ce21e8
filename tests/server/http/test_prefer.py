"""Preferences (RFC 7240)."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http import prefer
from rosld.server.http.prefer import Preference, Preferences

LDP = "http://www.w3.org/ns/ldp#"


def test_return_is_read_whatever_its_case_and_quotes() -> None:
    assert prefer.parse("return=representation").representation
    assert prefer.parse('Return="MINIMAL"').minimal
    assert prefer.parse("foo, return=minimal; x=y").minimal
    assert prefer.parse("return=minimal, return=representation").minimal
    assert prefer.parse(None) == prefer.NO_PREFERENCES


def test_include_and_omit_are_lists_of_uris() -> None:
    omitted = f"{LDP}PreferMembership {LDP}PreferContainment"
    read = prefer.parse(f'return=representation; include="{LDP}PreferMinimalContainer"; omit="{omitted}"')
    assert read.include == {f"{LDP}PreferMinimalContainer"}
    assert read.omit == {f"{LDP}PreferMembership", f"{LDP}PreferContainment"}
    assert not prefer.parse(f'return=minimal; include="{LDP}PreferMembership"').include


def test_wait_is_read_beside_others() -> None:
    assert prefer.parse("respond-async, wait=10").wait == 10
    assert prefer.parse("wait=soon").wait is None
    assert prefer.parse("wait=99999999999999").wait is None
    assert prefer.parse("wait=²").wait is None


def test_what_is_malformed_is_passed_over() -> None:
    for text in ("", "=", "a=b c", '"', ";;", ",,", "return=", "return = ", "\x00"):
        assert not prefer.parse(text).representation
        assert prefer.parse(f"{text.replace(chr(34), '')}, return=representation").representation or "return" in text


def test_what_was_applied_is_told_and_nothing_is_injected() -> None:
    assert prefer.preference_applied("return=minimal", "wait=5") == "return=minimal, wait=5"
    with pytest.raises(ValueError, match="control"):
        prefer.preference_applied("return=minimal\r\nSet-Cookie: a=b")


_names = st.text(string.ascii_lowercase + string.digits + "-", min_size=1, max_size=8)
_values = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=12)
_preferences = st.builds(Preference, _values, st.lists(st.tuples(_names, _values), max_size=3).map(tuple))


@given(st.dictionaries(_names, _preferences, max_size=4))
def test_preferences_are_read_as_they_were_written(named: dict[str, Preference]) -> None:
    assert prefer.parse(prefer.render(Preferences(named))) == Preferences(named)


@given(st.text(max_size=200))
def test_no_text_whatever_makes_reading_fail(text: str) -> None:
    assert prefer.parse(text).wait is None or "wait" in text.lower()
