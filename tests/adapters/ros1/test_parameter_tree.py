"""Parameter trees as values: names, odd keys, changes, and values rejected before anything is sent."""

from __future__ import annotations

from datetime import datetime, timezone

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rosld.adapters.model import Refused
from rosld.adapters.model.parameter import ParameterValue
from rosld.adapters.ros1.parameters import assign, by_name, check, differences, find, leaves, without

plain_keys = st.text(alphabet="abc", min_size=1, max_size=2)
scalars = st.integers(-5, 5) | st.booleans() | st.floats(allow_nan=True) | st.text(max_size=3)


def trees(of: st.SearchStrategy[str]) -> st.SearchStrategy[dict[str, ParameterValue]]:
    """Build trees from paths and their values, which is far cheaper than building each namespace."""
    return st.lists(st.tuples(st.lists(of, min_size=1, max_size=4), scalars | st.just({})), max_size=8).map(grown)


def grown(leaves: list[tuple[list[str], ParameterValue]]) -> dict[str, ParameterValue]:
    """Return the tree with these leaves; of two conflicting ones, the first remains."""
    tree: dict[str, ParameterValue] = {}
    for (*path, last), value in leaves:
        node: ParameterValue = tree
        for key in path:
            node = node.setdefault(key, {}) if isinstance(node, dict) else None
        if isinstance(node, dict):
            node.setdefault(last, dict(value) if isinstance(value, dict) else value)
    return tree


@settings(max_examples=30)
@given(trees(plain_keys))
def test_every_leaf_of_a_plain_tree_is_found_by_its_name(tree: dict[str, ParameterValue]) -> None:
    for name, leaf in by_name(leaves(tree)).items():
        assert find(tree, name[1:]) is leaf.value
        assert not leaf.odd


def test_empty_segments_and_slashes_in_keys_have_names() -> None:
    named = by_name(leaves({"dict": {"a/b": 1, "": 2, "c": {"": {"d": 3}}}}))
    assert {name: leaf.value for name, leaf in named.items()} == {"/dict/a/b": 1, "/dict/": 2, "/dict/c//d": 3}
    assert all(leaf.odd for leaf in named.values())
    assert by_name(leaves({"a": {"b": {}}}))["/a/b"].value == {}, "an empty tree is a leaf"


@settings(max_examples=30)
@given(trees(plain_keys), st.lists(plain_keys, min_size=1, max_size=3), scalars)
def test_assign_does_to_the_leaves_what_the_master_does_to_the_tree(
    tree: dict[str, ParameterValue], path: list[str], value: ParameterValue
) -> None:
    before = by_name(leaves(tree))
    node = tree
    for key in path[:-1]:
        below = node.get(key)
        node[key] = node = below if isinstance(below, dict) else {}  # type: ignore[assignment]
    node[path[-1]] = value
    after = by_name(leaves(tree))
    assert not differences(assign(before, "/" + "/".join(path), value), after)


@settings(max_examples=30)
@given(trees(plain_keys), trees(plain_keys))
def test_differences_name_exactly_what_changed(old: dict[str, ParameterValue], new: dict[str, ParameterValue]) -> None:
    one, other = by_name(leaves(old)), by_name(leaves(new))
    changed = set(differences(one, other))
    for name in one.keys() | other.keys():
        same = name in one and name in other and repr(one[name].value) == repr(other[name].value)
        assert (name in changed) is not same


def test_without_takes_a_tree_whole_and_nothing_beside_it() -> None:
    named = by_name(leaves({"a": {"b": 1, "c": 2}, "ab": 3}))
    assert set(without(named, "/a")) == {"/ab"}


CHANGED = (
    *(2**31, -(2**31) - 1, float("nan"), float("inf"), None, 1j),
    *("a\x01b", "a\r\nb", "\ud800", "\ufffe"),
    *([1, [2**40]], {"a": {"b": None}}, {"\x00": 1}, {1: 1}),
    *(datetime(2026, 1, 1, tzinfo=timezone.utc), datetime(2026, 1, 1, 0, 0, 0, 5)),
)
"""Values that XML-RPC cannot represent exactly."""


def test_a_value_that_the_wire_would_change_is_refused_naming_the_parameter() -> None:
    for value in CHANGED:
        with pytest.raises(Refused, match="/robot/name"):
            check("/robot/name", value)  # type: ignore[arg-type]
    nest: list[ParameterValue] = []
    nest.append(nest)
    with pytest.raises(Refused, match="deep"):
        check("/x", nest)
    with pytest.raises(Refused, match="root"):
        check("/", 5)
    for kept in (2**31 - 1, -(2**31), True, 0.5, "tab\tnewline\n\U0001f916", b"\0\xff", [], {}):
        check("/x", kept)
