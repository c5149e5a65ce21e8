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


def test_a_scalar_on_the_way_becomes_a_namespace() -> None:
    assert with_value({"a": 1}, "/a/b", 2) == {"a": {"b": 2}}


def test_empty_segments_count_for_nothing() -> None:
    assert read_name({"a": {"b": 1}}, "//a//b/") == 1


def test_an_empty_tree_is_there_but_no_leaf() -> None:
    tree = with_value({}, "/a", {})
    assert read_name(tree, "/a") == {}
    assert list(leaves(tree)) == []


def test_the_root_can_be_read_and_replaced_by_a_dict_but_not_deleted() -> None:
    assert read_name({"a": 1}, "/") == {"a": 1}
    assert with_value({"a": 1}, "/", {"b": 2}) == {"b": 2}
    with pytest.raises(Refused, match="dict"):
        with_value({}, "/", 1)
    with pytest.raises(Refused, match="cannot be deleted"):
        without_name({"a": 1}, "/")


def test_deleting_what_is_not_there_names_it() -> None:
    with pytest.raises(NotFound, match="/a/c"):
        without_name({"a": {"b": 1}}, "/a/c")


@pytest.mark.parametrize(
    "value", [1, -(2**31), 1.5, True, "x", b"\0", [1, "a"], {"a": {"b": []}}, datetime(2026, 1, 1)]
)
def test_what_xml_rpc_carries_is_accepted(value: object) -> None:
    check("/a", value)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (2**31, "32 bits"),
        (None, "None"),
        ({"a": [None]}, "/p/a"),
        ({"": 1}, "key ''"),
        ({"a/b": 1}, "key 'a/b'"),
        ({1: 1}, "key 1"),
        ({1, 2}, "no value"),
    ],
)
def test_what_it_does_not_carry_is_refused_by_name(value: object, words: str) -> None:
    with pytest.raises(Refused, match="/p") as caught:
        check("/p", value)
    assert words in caught.value.sentence


def test_deep_nesting_is_refused() -> None:
    value: Any = 1
    for _ in range(1000):
        value = [value]
    with pytest.raises(Refused, match="deep"):
        check("/p", value)
