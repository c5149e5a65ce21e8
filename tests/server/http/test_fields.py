"""Header fields: web links (RFC 8288)."""

from __future__ import annotations

import string
from urllib.parse import unquote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.http.fields import Link, parse_links, render_links, to_uri

LDP = "http://www.w3.org/ns/ldp#"


def test_a_title_beyond_ascii_is_extended() -> None:
    assert str(Link("/topics/höhe", "item")) == '</topics/h%C3%B6he>; rel="item"'
    written = str(Link("/a", "up", title="Höhe %"))
    assert written == "</a>; rel=\"up\"; title*=UTF-8''H%C3%B6he%20%25"
    assert parse_links(written)[0].title == "Höhe %"


def test_nothing_can_be_injected() -> None:
    for bad in (
        Link("/a>; rel=evil, </b", "up"),
        Link("/a\r\nX: y", "up"),
        Link("/a b", "up"),
        Link("/a", "up\r\nX: y"),
        Link("/a", "up", type="text/html\n"),
        Link("/a", "up", anchor="#\x00"),
        Link("/a", "up", attributes=(("bad name", "x"),)),
        Link("/a", "up", attributes=(("x", "y\r"),)),
    ):
        with pytest.raises(ValueError):  # noqa: PT011 - each has its own sentence
            str(bad)


def test_links_of_a_client_are_read() -> None:
    read = parse_links(f'<{LDP}BasicContainer>; rel="type"; foo, <a,b;c>;rel=next , nonsense, <x>, <y>; rel=a; rel=b')
    assert [(one.target, one.rel) for one in read] == [(f"{LDP}BasicContainer", "type"), ("a,b;c", "next"), ("y", "a")]
    assert read[0].attributes == (("foo", ""),)


_targets = st.text(string.ascii_letters + string.digits + "-._~:/?#[]@!$&'()*+,;=%éλ", max_size=20)
_plain = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=12)
_attributes = st.dictionaries(st.sampled_from(["x", "foo", "hreflang", "media"]), _plain, max_size=3).map(
    lambda found: tuple(found.items())
)
_titles = st.none() | st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
_links = st.builds(Link, _targets, _plain, st.none() | _plain, _titles, st.none() | _targets, _attributes)


@given(st.lists(_links, max_size=4))
def test_links_are_read_as_they_were_written(links: list[Link]) -> None:
    written = render_links(links)
    assert written.isascii()
    assert not set(written) & {"\r", "\n", "\0"}
    read = parse_links(written)
    assert [(one.rel, one.type, one.title, one.attributes) for one in read] == [
        (one.rel, one.type, one.title, one.attributes) for one in links
    ]
    assert [unquote(one.target) for one in read] == [unquote(one.target) for one in links]


@given(st.text(max_size=200))
def test_no_text_whatever_makes_reading_fail(text: str) -> None:
    for one in parse_links(text):
        assert to_uri(one.target) == one.target
