"""Conditional requests (RFC 9110 13) and byte ranges (RFC 9110 13.1.5, 14, 15.3.7, 15.5.17)."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.conditional import (
    MAX_RANGES,
    ETag,
    PreconditionResult,
    ReceivedTag,
    Span,
    evaluate,
    frame_parts,
    is_unchanged,
    parse,
    parse_ranges,
    select_ranges,
)
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
        with pytest.raises(ValueError, match="valid entity tag"):
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


SIZE = 10_000
TAG = '"a-1.any"'


def test_one_range_is_one_span() -> None:
    for text, span in (
        ("bytes=0-499", Span(0, 500)),
        ("bytes=500-999", Span(500, 1000)),
        ("bytes=9500-", Span(9500, 10_000)),
        ("bytes=-500", Span(9500, 10_000)),
        ("bytes=0-0", Span(0, 1)),
        ("bytes=-1", Span(9999, 10_000)),
        ("bytes=9999-20000", Span(9999, 10_000)),
        ("bytes=-20000", Span(0, 10_000)),
        ("Bytes = 0 - 499 ", Span(0, 500)),
        ("bytes=,0-499,,", Span(0, 500)),
        ("bytes=20000-,0-499", Span(0, 500)),
    ):
        assert parse_ranges(text, SIZE) == (span,)


def test_what_cannot_be_read_is_ignored_and_all_is_sent() -> None:
    assert parse_ranges(None, SIZE) is None
    invalid = ("", "bytes", "bytes=", "bytes=-", "bytes=a-b", "bytes=5-4", "bytes=0-1;2-3", "items=0-5", "bytes 0-5")
    for text in (*invalid, "bytes=0-1,x", "bytes=١-٢", "bytes=" + "9" * 30 + "-", "bytes=--5"):
        assert parse_ranges(text, SIZE) is None
    for text in ("bytes=0-", "bytes=-5", "bytes=5-9"):
        assert parse_ranges(text, 0) is None


def test_what_no_byte_satisfies_is_416_and_tells_the_size() -> None:
    for text in ("bytes=10000-", "bytes=-0", "bytes=20000-30000,10000-10001", "bytes=99999999999-"):
        with pytest.raises(Problem, match="0 to 9999") as refused:
            parse_ranges(text, SIZE)
        assert refused.value.status == 416
        assert refused.value.headers == {"Content-Range": "bytes */10000"}


def test_too_many_ranges_are_ignored() -> None:
    many = ",".join(f"{number * 200}-{number * 200}" for number in range(MAX_RANGES))
    assert len(parse_ranges(f"bytes={many}", SIZE) or ()) == MAX_RANGES
    assert parse_ranges(f"bytes={many},9999-9999", SIZE) is None
    assert parse_ranges("bytes=" + "0-0," * 1_000_000, SIZE) is None
    assert parse_ranges("bytes=" + "," * 1_000_000, SIZE) is None


def test_if_range_lets_ranges_be_sent_for_the_same_strong_tag_alone() -> None:
    for same in (None, TAG, f" {TAG} "):
        assert select_ranges("bytes=0-9", same, TAG, SIZE) == (Span(0, 10),)
    assert select_ranges(None, TAG, TAG, SIZE) is None
    date = "Sat, 21 Nov 2026 05:00:00 GMT"
    for other in ('"a-2.any"', f"W/{TAG}", date, "*", "", f'{TAG}, "b"', "a-1.any"):
        assert select_ranges("bytes=0-9", other, TAG, SIZE) is None
        assert select_ranges("bytes=20000-", other, TAG, SIZE) is None
        assert not is_unchanged(other, TAG)
    assert not is_unchanged('W/"a"', 'W/"a"')


def test_nothing_is_injected_into_a_part_and_no_boundary_is_foreseen() -> None:
    with pytest.raises(ValueError, match="control"):
        frame_parts((Span(0, 1),), 10, "text/plain\r\nX: y")
    assert frame_parts((), 0, "a/b").boundary != frame_parts((), 0, "a/b").boundary


_positions = st.none() | st.integers(0, 200)


@given(st.lists(st.tuples(_positions, _positions), min_size=1, max_size=10), st.integers(1, 150))
def test_spans_hold_every_byte_that_was_asked_for_and_none_twice(
    asked: list[tuple[int | None, int | None]], size: int
) -> None:
    text = ",".join(f"{'' if first is None else first}-{'' if last is None else last}" for first, last in asked)
    wanted: set[int] = set()
    for first, last in asked:
        if first is None:
            wanted |= set(range(max(0, size - (last or 0)), size))
        else:
            wanted |= set(range(first, size if last is None else min(last + 1, size)))
    try:
        spans = parse_ranges(f"bytes={text}", size)
    except Problem:
        assert not wanted
        return
    if spans is None:
        assert any(first is None is last or (None not in (first, last) and first > last) for first, last in asked)  # type: ignore[operator]
        return
    told = [byte for span in spans for byte in range(span.start, span.stop)]
    assert len(told) == len(set(told))
    assert wanted <= set(told) <= set(range(size))


@given(st.text(max_size=100) | st.from_regex(r"bytes=[0-9,\- ]{0,60}", fullmatch=True), st.integers(0, 1000))
def test_no_text_whatever_makes_reading_fail(text: str, size: int) -> None:
    try:
        spans = parse_ranges(text, size)
    except Problem:
        return
    assert spans is None or all(0 <= span.start < span.stop <= size for span in spans)
