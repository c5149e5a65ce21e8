"""Pages of large containers (LDP Paging 1.0)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.negotiation import Preferences, parse_prefer
from rosld.server.http.problem import Problem
from rosld.server.rest.paging import (
    MAX_PAGE_SIZE,
    LdpPage,
    PagePosition,
    last_page_size,
    last_position,
    page_of,
    page_of_names,
    parse_named_position,
    parse_position,
    requested_page_size,
)

ROOT = "http://host/data/"


def asked(text: str) -> Preferences:
    return parse_prefer(text)


def test_a_token_that_names_no_place_is_404_and_says_where_to_begin() -> None:
    for token in ("", "-1", "x", "1.5", "01", "5-0", "5-1001", "5-", "²", "9" * 30, "1-2-3", " 1"):
        with pytest.raises(Problem, match=r"from [?]page=0") as refused:
            parse_position(token)
        assert refused.value.status == 404


def test_a_token_that_names_no_place_among_names_is_404() -> None:
    for token in ("", "1", "7-5", ":", "0:a", "1001:a", ":a b", ":\u00e9", "x", ":" + "a" * 5000):
        with pytest.raises(Problem, match=r"from [?]page=0") as refused:
            parse_named_position(token)
        assert refused.value.status == 404


def test_the_size_of_pages_is_a_preference_that_may_be_ignored() -> None:
    for text, limit in (
        ("return=representation; max-member-count=10", 10),
        ('return=representation; include="x"; max-member-count="0010"', 10),
        ("return=representation; max-member-count=99999", MAX_PAGE_SIZE),
        ("return=representation; max-member-count=7; max-member-count=8", 7),
        ("return=representation; max-member-count=0", None),
        ("return=representation; max-member-count=-1", None),
        ("return=representation; max-member-count=ten", None),
        ("return=representation; max-member-count=" + "9" * 50, None),
        ("return=representation", None),
        ("return=minimal; max-member-count=10", None),
        ("max-member-count=10", None),
        ("", None),
    ):
        assert requested_page_size(asked(text)) == limit


@given(st.sets(st.integers(1, 200), max_size=60), st.integers(1, 12))
def test_pages_are_walked_backwards_as_forwards(numbers: set[int], limit: int) -> None:
    ordered = sorted(numbers)

    def at(token: str) -> tuple[LdpPage, list[int]]:
        place = parse_position(token)
        found = [each for each in ordered if each > place.after][: limit + 1]
        before = [each for each in ordered[::-1] if each <= place.after][: limit + 1]
        last = last_position(limit, len(ordered), ordered[::-1][: last_page_size(len(ordered), limit) + 1])
        return page_of(ROOT, place, found, before, last), found[:limit]

    def walked(token: str | None, rel: str) -> list[tuple[str, list[int]]]:
        steps = []
        while token is not None:
            page, found = at(token)
            steps.append((token, found))
            token = page.next if rel == "next" else page.prev
        return steps

    forwards = walked(PagePosition(0, limit).token, "next")
    last = at(forwards[0][0])[0].last
    assert last == forwards[-1][0]
    assert walked(last, "prev") == forwards[::-1]


@given(st.sets(st.text("abc/", min_size=1), max_size=40), st.sets(st.text("abc/", min_size=1)), st.integers(1, 9))
def test_names_are_walked_both_ways_and_none_is_missed_that_was_there_all_the_while(
    lasting: set[str], others: set[str], limit: int
) -> None:
    met: list[str] = []
    first = PagePosition(0, limit)
    token: str | None = first.token
    there = lasting | others
    while token is not None:
        page, told = page_of_names(ROOT, parse_named_position(token), sorted(there))
        met += told
        token = page.next
        there = lasting
    assert len(met) == len(set(met))
    assert lasting <= set(met)
    names = sorted(lasting)
    page, back = page_of_names(ROOT, parse_named_position(page_of_names(ROOT, first, names)[0].last or ""), names)
    while page.prev is not None:
        page, told = page_of_names(ROOT, parse_named_position(page.prev), names)
        back = [*told, *back]
    assert list(back) == names
