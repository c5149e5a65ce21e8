"""Untrusted patterns: those that RE2 does not support are rejected, others are fast on the worst of texts."""

from __future__ import annotations

import re
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.shapes.components import compile_pattern


@pytest.mark.parametrize(
    "text",
    [r"(.)\1", "(a)?(?(1)b|c)", "(?=(a+)+$)b", "a(?<!b)c", "a" * 3000, r"(\w{1,50}){1,50}", r"[\pL\pN]{900}"],
)
def test_a_pattern_that_has_no_bound_or_is_large_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="pattern"):
        compile_pattern(text)


def test_patterns_that_people_write_are_taken() -> None:
    for text in (
        "", "^$", "on|off", r"^\d{4}-\d{2}-\d{2}$", r"^/[a-z_]+(/[a-z0-9_]+)*$", "^([a-z]+,)*[a-z]+$",
        r"^(?:[a-zA-Z0-9]+\.)+[a-z]{2,}$", r"^\s*\[[^,\[\]{}]+(,[^,\[\]{}]+){34}\]\s*$", "(?i)^RO-[A-Z]{4}$",
        r"^[\w-]{1,200}$",
    ):  # fmt: skip
        assert compile_pattern(text).max_length > 10_000, text


def test_flags_are_those_of_shacl_that_are_known() -> None:
    assert compile_pattern("^ON$", "i").is_found_in("on")
    assert compile_pattern("^y", "m").is_found_in("x\ny")
    assert not compile_pattern("^y").is_found_in("x\ny")
    assert compile_pattern("x.y", "s").is_found_in("x\ny")
    assert not compile_pattern("x.y").is_found_in("x\ny")
    with pytest.raises(ValueError, match="'x'"):
        compile_pattern("a", "x")


@pytest.mark.parametrize(
    ("text", "value", "is_found"),
    [("^.$", "\u00e9", True), ("^.$", "\U0001f916", True), ("^a$", "a\n", False), ("a", "\ud800a", True)],
)
def test_a_text_is_matched_by_its_characters_to_its_end(text: str, value: str, is_found: bool) -> None:
    assert compile_pattern(text).is_found_in(value) is is_found


pieces = st.recursive(
    st.sampled_from(["a", "b", "[ab]", ".", "[^a]", ","]),
    lambda inner: st.one_of(
        st.builds("(?:{}){}".format, inner, st.sampled_from(["*", "+", "?", "{2}", "{0,2}", "{1,9}", "*?"])),
        st.lists(inner, min_size=1, max_size=3).map("".join),
        st.lists(inner, min_size=2, max_size=3).map(lambda each: f"({'|'.join(each)})"),
    ),
    max_leaves=6,
)  # fmt: skip


@pytest.mark.slow
@given(pieces, st.text("ab,", max_size=8), st.booleans())
def test_it_matches_what_python_matches(text: str, value: str, anchored: bool) -> None:
    text = f"^(?:{text})$" if anchored else text
    assert compile_pattern(text).is_found_in(value) is (re.search(text, value) is not None)


@pytest.mark.parametrize(
    "text", ["(a+)+$", "(a|a)*b", "(a|aa)+$", r"(\w+\s?)*$", "(x+x+)+y", "a*a*a*a*a*a*b", "(a{1,100}){1,9}c"]
)
def test_what_takes_others_for_ever_is_quick_on_the_longest_text_it_is_tried_with(text: str) -> None:
    found = compile_pattern(text)
    long = ("a" * found.max_length)[:1_000_000]
    began = time.thread_time()
    found.is_found_in(long[:-1] + "?")
    assert time.thread_time() - began < 10  # doubling a character of these patterns doubles the time
