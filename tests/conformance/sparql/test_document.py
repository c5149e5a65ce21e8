"""`docs/reference/conformance.md` and the tests agree: every test case of W3C has its row, every row its test."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parents[2] / "docs" / "reference" / "conformance.md"
CASES = frozenset(
    [
        "query_post_form",
        "query_dataset_default_graphs_get",
        "query_dataset_default_graphs_post",
        "query_dataset_named_graphs_post",
        "query_dataset_named_graphs_get",
        "query_dataset_full",
        "query_multiple_dataset",
        "query_get",
        "query_content_type_select",
        "query_content_type_ask",
        "query_content_type_describe",
        "query_content_type_construct",
        "update_dataset_default_graph",
        "update_dataset_default_graphs",
        "update_dataset_named_graphs",
        "update_dataset_full",
        "update_post_form",
        "update_post_direct",
        "update_base_uri",
        "query_post_direct",
        "bad_query_method",
        "bad_multiple_queries",
        "bad_query_wrong_media_type",
        "bad_query_missing_form_type",
        "bad_query_missing_direct_type",
        "bad_query_non_utf8",
        "bad_query_syntax",
        "bad_update_get",
        "bad_multiple_updates",
        "bad_update_wrong_media_type",
        "bad_update_missing_form_type",
        "bad_update_non_utf8",
        "bad_update_syntax",
        "bad_update_dataset_conflict",
        "put__initial_state",
        "get_of_put__initial_state",
        "put__graph_already_in_store",
        "get_of_put__graph_already_in_store",
        "put__default_graph",
        "get_of_put__default_graph",
        "put__mismatched_payload",
        "delete__existing_graph",
        "get_of_delete__existing_graph",
        "delete__nonexistent_graph",
        "post__existing_graph",
        "get_of_post__existing_graph",
        "post__multipart_formdata",
        "get_of_post__multipart_formdata",
        "post__create__new_graph",
        "get_of_post__create__new_graph",
        "get_of_post__after_noop",
        "head_on_an_existing_graph",
        "head_on_a_nonexisting_graph",
    ]
)
"""The cases of both of W3C's manifests, by their local names."""


def told() -> Iterator[str]:
    """The cases in the rows of the page."""
    section = PAGE.read_text("utf-8").partition("## SPARQL Protocol")[2].partition("\n## ")[0]
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 3 and cells[1] in ("met", "met differently"):
            yield from re.findall(r"`(\w+)`", cells[0])


def written() -> Iterator[str]:
    for path in HERE.glob("test_*.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                yield node.name.removeprefix("test_")


def test_every_case_has_one_row() -> None:
    assert sorted(told()) == sorted(CASES)


def test_every_case_has_a_test() -> None:
    """Those for GET and POST are one test for both."""
    tests = set(written())
    assert not [case for case in CASES if not tests & {case, re.sub(r"_(get|post)$", "", case)}]
