"""Pages of large containers (LDP Paging 1.0)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import NamedNode, Triple

from rosld.ontology.vocab import ldp, rdf, xhv
from rosld.server.http import link, prefer
from rosld.server.http.problem import Problem
from rosld.server.ldp.paging import MOST, Page, Place, first_page, most_asked, page_of, read_place

ROOT = "http://host/data/"


def asked(text: str) -> prefer.Preferences:
    return prefer.parse(text)


@pytest.mark.parametrize(("token", "place"), [("0", Place()), ("4711", Place(4711)), ("20-5", Place(20, 5))])
def test_a_token_names_a_place_and_back(token: str, place: Place) -> None:
    assert read_place(token) == place
    assert place.token == token


@pytest.mark.parametrize("token", ["", "-1", "x", "1.5", "01", "5-0", "5-1001", "5-", "²", "9" * 30, "1-2-3", " 1"])
def test_a_token_that_names_no_place_is_404_and_says_where_to_begin(token: str) -> None:
    with pytest.raises(Problem, match=r"from [?]page=0") as refused:
        read_place(token)
    assert refused.value.status == 404


@given(st.integers(0, 10**18 - 1), st.integers(1, MOST))
def test_every_place_has_a_token(after: int, most: int) -> None:
    assert read_place(Place(after, most).token) == Place(after, most)


def test_a_container_of_few_members_is_told_at_once() -> None:
    assert first_page(ROOT, 0, prefer.NONE) is None
    assert first_page(ROOT, MOST, prefer.NONE) is None


def test_a_container_of_many_members_sends_to_its_first_page() -> None:
    found = first_page(ROOT, MOST + 1, prefer.NONE)
    assert found is not None
    assert (found.status, found.headers["Location"]) == (303, f"{ROOT}?page=0")
    assert "Prefer" in found.headers["Vary"]


def test_who_prefers_small_pages_gets_them() -> None:
    found = first_page(ROOT, 11, asked('return=representation; max-member-count="10"'))
    assert found is not None
    assert found.headers["Location"] == f"{ROOT}?page=0-10"
    assert first_page(ROOT, 10, asked("return=representation; max-member-count=10")) is None


@pytest.mark.parametrize(
    ("text", "most"),
    [
        ("return=representation; max-member-count=10", 10),
        ('return=representation; include="x"; max-member-count="0010"', 10),
        ("return=representation; max-member-count=99999", MOST),
        ("return=representation; max-member-count=7; max-member-count=8", 7),
        ("return=representation; max-member-count=0", None),
        ("return=representation; max-member-count=-1", None),
        ("return=representation; max-member-count=ten", None),
        ("return=representation; max-member-count=" + "9" * 50, None),
        ("return=representation", None),
        ("return=minimal; max-member-count=10", None),
        ("max-member-count=10", None),
        ("", None),
    ],
)
def test_the_size_of_pages_is_a_preference_that_may_be_ignored(text: str, most: int | None) -> None:
    assert most_asked(asked(text)) == most


def test_every_page_but_the_last_has_a_next() -> None:
    place = Place(0, 3)
    assert page_of(ROOT, place, [2, 5, 7, 9]) == Page(ROOT, "0-3", "0-3", next="7-3")
    assert page_of(ROOT, place, [2, 5, 7]).next is None
    assert page_of(ROOT, place, []).next is None


def test_a_page_says_what_it_is_and_what_its_neighbours_are() -> None:
    page = Page(ROOT, "3", "0", "2", "4", "9")
    links = {(each.rel, each.target) for each in link.parse(link.render(page.links('"a-7.any"')))}
    assert links == {
        ("type", "http://www.w3.org/ns/ldp#Page"),
        ("first", f"{ROOT}?page=0"),
        ("prev", f"{ROOT}?page=2"),
        ("next", f"{ROOT}?page=4"),
        ("last", f"{ROOT}?page=9"),
        ("canonical", ROOT),
    }
    assert page.links('"a-7.any"')[-1].attributes == (("etag", "a-7.any"),)
    assert [step.rel for step in page.steps()] == ["first", "prev", "next", "last"]


def test_rdf_says_the_same() -> None:
    here, container = NamedNode(f"{ROOT}?page=3"), NamedNode(ROOT)
    assert set(Page(ROOT, "3", "0", next="4").triples()) == {
        Triple(here, rdf.type, ldp.Page),
        Triple(here, ldp.pageSequence, container),
        Triple(here, xhv.first, NamedNode(f"{ROOT}?page=0")),
        Triple(here, xhv.next, NamedNode(f"{ROOT}?page=4")),
    }


@given(
    st.sets(st.integers(1, 60), max_size=40),
    st.integers(1, 10),
    st.lists(st.tuples(st.booleans(), st.integers(1, 60)), max_size=8),
)
def test_whoever_follows_next_meets_all_that_was_there_all_the_while_once(
    numbers: set[int], most: int, changes: list[tuple[bool, int]]
) -> None:
    there, lasting, newest = set(numbers), set(numbers), 1000
    met: list[int] = []
    token: str | None = Place(0, most).token
    while token is not None:
        place = read_place(token)
        found = sorted(each for each in there if each > place.after)[: most + 1]
        met += found[:most]
        token = page_of(ROOT, place, found).next
        if changes:
            is_made, number = changes.pop()
            newest += 1
            there, lasting = (there | {newest}, lasting) if is_made else (there - {number}, lasting - {number})
    assert len(met) == len(set(met))
    assert lasting <= set(met)
