"""Conditional requests (RFC 9110 13)."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.conditional import ETag, PreconditionResult, ReceivedTag, evaluate, parse
from rosld.server.http.problem import Problem

NOW = ETag("b00t-42", "ttl")


def judged(
    method: str, current: ETag | None = NOW, *, if_match: str | None = None, if_none_match: str | None = None
) -> PreconditionResult:
    return evaluate(method, current, if_match=if_match, if_none_match=if_none_match)


def test_a_tag_that_could_not_be_read_back_is_not_made() -> None:
    assert str(NOW) == '"b00t-42.ttl"'
    parts = (("", "ttl"), ("a", ""), ('a"', "ttl"), ("a", "t.l"), ("a\r\nX: y", "ttl"), ("a b", "ttl"), ("ä", "ttl"))
    for state, variant in parts:
        with pytest.raises(ValueError, match="no entity tag"):
            ETag(state, variant)


def test_a_tag_of_odd_characters_matches_nothing_and_what_is_no_tag_is_400() -> None:
    for field in ('"no tag of ours"', '"a b", "c"', '"\t"', '"{}"', '"é"', '"a\\"'):
        assert judged("PUT", if_match=field) is PreconditionResult.PRECONDITION_FAILED
        assert judged("PUT", if_none_match=field) is PreconditionResult.PROCEED
    for field in ("b00t-42.ttl", '"a" "b"', '"open', 'w/"a"', '*, "a"', '"a";q=1', "", ",", '"a\x01"'):
        with pytest.raises(Problem, match="400"):
            judged("PUT", if_match=field)


_opaque = st.text(st.characters(min_codepoint=0x21, max_codepoint=0x7E, exclude_characters='"'), max_size=12)
_tags = st.lists(st.builds(ReceivedTag, _opaque, st.booleans()), min_size=1, max_size=5)


@given(_tags)
def test_a_list_of_tags_is_read_as_it_was_written(tags: list[ReceivedTag]) -> None:
    written = " , ".join(f'{"W/" if tag.weak else ""}"{tag.opaque}"' for tag in tags)
    assert parse(written) == tuple(tags)


_parts = st.text(string.ascii_letters + string.digits + "-_", min_size=1, max_size=8)


@given(_parts, _parts, _parts, _parts)
def test_a_tag_matches_exactly_its_state_for_writes_and_itself_for_reads(a: str, b: str, v: str, w: str) -> None:
    current, sent = ETag(a, v), ETag(b, w)
    assert (judged("PUT", current, if_match=str(sent)) is PreconditionResult.PROCEED) == (a == b)
    assert (judged("GET", current, if_none_match=str(sent)) is PreconditionResult.NOT_MODIFIED) == (current == sent)


@given(st.text(max_size=100))
def test_no_text_whatever_makes_a_precondition_fail_otherwise_than_by_400_and_412(text: str) -> None:
    assert _status(text) in ((0,) if text.strip(" \t") == "*" else (400, 412))


def _status(if_match: str) -> int:
    try:
        return judged("PUT", if_match=if_match).value
    except Problem as problem:
        return problem.status
