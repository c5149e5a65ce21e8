"""Parameter trees as stored by the master of ROS 1."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest

from rosld.adapters.model import NotFound, Refused
from rosld.adapters.parameters import check, leaves, read_name, with_value, without_name


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
        ({1, 2}, "cannot have such a value"),
        (nest, "deep"),
    ):
        with pytest.raises(Refused, match="/p") as caught:
            check("/p", wrong)
        assert words in caught.value.sentence
