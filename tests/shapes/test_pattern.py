"""Patterns of strangers: what could take for ever is refused, what is taken is quick on the worst of texts."""

from __future__ import annotations

import re
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.shapes.safe_regex import compile_pattern


@pytest.mark.parametrize(
    "text",
    [
        "(a+)+$",
        "(a*)*",
        "(a|a)*b",
        "(a|ab|b)*c",
        "(a|aa)+$",
        r"(\w+\s?)*$",
        "(x+x+)+y",
        "(ab?b?)*$",
        "(a{0,3}){0,3}$",
        "([a-z]+)*1",
        "(?:(?:a+)b?)*$",
        r"(.)\1",
        "(a)?(?(1)b|c)",
        "a*a*a*a*a*a*b",
        "a?" * 40 + "a" * 40,
        "(?i)(a+A?)*$",
        "(?=(a+)+$)b",
        "a" * 3000,
    ],
)
def test_a_pattern_that_could_take_for_ever_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="pattern"):
        compile_pattern(text)


@pytest.mark.parametrize("text", ["(", "[a", "a**", "(?P<a", "(" * 500 + ")" * 500, "\\"])
def test_what_is_no_regular_expression_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"no regular expression|could take for ever"):
        compile_pattern(text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "^$",
        "on|off",
        "^[a-z]+$",
        r"^\d{4}-\d{2}-\d{2}$",
        r"^/[a-z_]+(/[a-z0-9_]+)*$",
        "^([a-z]+,)*[a-z]+$",
        r"^(?:[a-zA-Z0-9]+\.)+[a-z]{2,}$",
        r"^\s*\[[^,\[\]{}]+(,[^,\[\]{}]+){34}\]\s*$",
        "^(ab|cd)*$",
        "(?i)^RO-[A-Z]{4}$",
    ],
)
def test_patterns_that_people_write_are_taken(text: str) -> None:
    assert compile_pattern(text).max_length > 1000


def test_flags_are_those_of_shacl_that_are_known() -> None:
    assert compile_pattern("^ON$", "i").is_found_in("on")
    assert compile_pattern("^y", "m").is_found_in("x\ny")
    assert not compile_pattern("^y").is_found_in("x\ny")
    with pytest.raises(ValueError, match="'x'"):
        compile_pattern("a", "x")


pieces = st.recursive(
    st.sampled_from(["a", "b", "[ab]", ".", "[^a]", ","]),
    lambda inner: st.one_of(
        st.builds("(?:{}){}".format, inner, st.sampled_from(["*", "+", "?", "{2}", "{0,2}", "{1,9}", "*?"])),
        st.lists(inner, min_size=1, max_size=3).map("".join),
        st.lists(inner, min_size=2, max_size=3).map(lambda each: f"({'|'.join(each)})"),
    ),
    max_leaves=6,
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(pieces, st.sampled_from(["a", "ab", "a,", "b", "aab"]), st.booleans())
def test_what_is_taken_is_quick_on_long_texts(text: str, stuff: str, anchored: bool) -> None:
    text = f"^{text}$" if anchored else text + "!"
    try:
        found = compile_pattern(text)
    except ValueError:
        return
    long = (stuff * 3000)[: min(found.max_length, 3000)] + "?"
    began = time.thread_time()
    re.compile(text).search(long)
    assert time.thread_time() - began < 10
