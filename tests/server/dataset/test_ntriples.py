"""Cutting N-Triples loses nothing and parts no blank node."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rosld.server.dataset import Edit
from rosld.server.dataset.ntriples import check_changes, split_parts

NODES = st.one_of(
    st.integers(0, 30).map(lambda number: f"_:b{number}"),
    st.sampled_from(["<http://h/_:b1>", "<http://h/x>", "_:a.b", "_:é"]),
)
VALUES = st.one_of(NODES, st.sampled_from(['"_:b1"', '"\\"_:b2 "@en', '"x"^^<http://h/_:b3>']))
LINES = st.builds(lambda subject, value: f"{subject} <http://h/p> {value} .\n", NODES, VALUES)


def labels(text: str) -> set[str]:
    without = re.sub(r'"(?:[^"\\]|\\.)*"|<[^>]*>', "", text)
    return set(re.findall(r"_:\S+", without))


@given(st.lists(LINES, max_size=60), st.integers(10, 400))
def test_parts_hold_every_line_once_and_share_no_blank_node(lines: list[str], size: int) -> None:
    text = "".join(lines)
    found = list(split_parts(text, size))
    assert sorted("".join(found).splitlines()) == sorted(text.splitlines())
    seen: set[str] = set()
    for part in found:
        assert not labels(part) & seen
        seen |= labels(part)


@given(st.lists(st.just('<http://h/x> <http://h/p> "x" .\n'), min_size=1, max_size=60), st.integers(40, 400))
def test_without_blank_nodes_no_part_is_larger_than_asked_for(lines: list[str], size: int) -> None:
    assert all(len(part) <= size for part in split_parts("".join(lines), size))


def test_long_chains_of_blank_nodes_are_found_without_recursion() -> None:
    chain = "".join(f"_:b{number} <http://h/p> _:b{number + 1} .\n" for number in range(50_000))
    assert list(split_parts(chain, 1000)) == [chain]


@pytest.mark.parametrize(
    "text",
    ["x", "<a> <b> <c> .", "<http://a> <http://b> <http://c> <http://d> .", "<http://a> <http://b> 1 .", "}", "\ud800"],
)
def test_what_is_no_ntriples_is_told_with_the_name_of_its_graph(text: str) -> None:
    for graphs, edits in (({"http://h/g": text}, []), ({}, [Edit("http://h/g", text)])):
        with pytest.raises(ValueError, match="http://h/g"):
            check_changes(graphs, edits)
