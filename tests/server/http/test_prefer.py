"""Preferences (RFC 7240)."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.negotiation import Preference, Preferences, parse_prefer, preference_applied, render_prefer


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
_values = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=12)
_preferences = st.builds(Preference, _values, st.lists(st.tuples(_names, _values), max_size=3).map(tuple))


@given(st.dictionaries(_names, _preferences, max_size=4))
def test_preferences_are_read_as_they_were_written(named: dict[str, Preference]) -> None:
    assert parse_prefer(render_prefer(Preferences(named))) == Preferences(named)


@given(st.text(max_size=200))
def test_no_text_whatever_makes_reading_fail(text: str) -> None:
    assert parse_prefer(text).wait is None or "wait" in text.lower()
