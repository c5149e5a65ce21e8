"""Parameter trees as the master of ROS 1 keeps them."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.adapters.model import NotFound, Refused
from rosld.adapters.parameters import Tree, check, deep_copy, leaves, read_name, with_value, without_name

names = st.lists(st.sampled_from("abc"), min_size=1, max_size=4).map(lambda steps: "/" + "/".join(steps))
values = st.one_of(st.integers(-9, 9), st.booleans(), st.text(max_size=3), st.lists(st.integers(0, 9), max_size=2))


@given(st.lists(st.tuples(names, values), min_size=1, max_size=8))
def test_what_was_set_last_is_read_and_nothing_given_is_changed(settings: list[tuple[str, Any]]) -> None:
    tree: Tree = {}
    for name, value in settings:
        before = deep_copy(tree)
        changed = with_value(tree, name, value)
        assert tree == before
        tree = changed
        assert read_name(tree, name) == value
    assert all(read_name(tree, name) is not None for name in leaves(tree))


@given(st.lists(st.tuples(names, values), min_size=1, max_size=8))
def test_what_is_deleted_is_gone_with_all_below_it(settings: list[tuple[str, Any]]) -> None:
    tree: Tree = {}
    for name, value in settings:
        tree = with_value(tree, name, value)
    name = settings[-1][0]
    tree = without_name(tree, name)
    assert read_name(tree, name) is None
    assert not any(leaf == name or leaf.startswith(name + "/") for leaf in leaves(tree))


def test_names_and_trees_are_those_of_the_master() -> None:
    assert with_value({"a": 1}, "/a/b", 2) == {"a": {"b": 2}}, "a scalar on the way becomes a namespace"
    assert read_name({"a": {"b": 1}}, "//a//b/") == 1, "empty segments count for nothing"
    empty = with_value({}, "/a", {})
    assert read_name(empty, "/a") == {}
    assert list(leaves(empty)) == []
    assert read_name({"a": 1}, "/") == {"a": 1}
    assert with_value({"a": 1}, "/", {"b": 2}) == {"b": 2}
    with pytest.raises(Refused, match="dict"):
        with_value({}, "/", 1)
    with pytest.raises(Refused, match="cannot be deleted"):
        without_name({"a": 1}, "/")
    with pytest.raises(NotFound, match="/a/c"):
        without_name({"a": {"b": 1}}, "/a/c")


def test_what_xml_rpc_does_not_carry_is_refused_by_name() -> None:
    for value in (1, -(2**31), 1.5, True, "x", b"\0", [1, "a"], {"a": {"b": []}}, datetime(2026, 1, 1)):
        check("/a", value)
    nest: Any = 1
    for _ in range(1000):
        nest = [nest]
    for wrong, words in (
        (2**31, "32 bits"),
        (None, "None"),
        ({"a": [None]}, "/p/a"),
        ({"": 1}, "key ''"),
        ({"a/b": 1}, "key 'a/b'"),
        ({1: 1}, "key 1"),
        ({1, 2}, "no value"),
        (nest, "deep"),
    ):
        with pytest.raises(Refused, match="/p") as caught:
            check("/p", wrong)
        assert words in caught.value.sentence
