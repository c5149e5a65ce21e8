"""`docs/reference/mapping.md` and these tests are one: each test named there is here, each test here is named there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

HERE = Path(__file__).parent
NAMED = re.compile(r"tests/paper/(test_\w+\.py)::(test_\w+)")


def named() -> set[tuple[str, str]]:
    """The tests that the document names."""
    return set(NAMED.findall((HERE.parents[1] / "docs" / "reference" / "mapping.md").read_text("utf-8")))


def written() -> set[tuple[str, str]]:
    """The tests there are."""
    return {
        (path.name, node.name)
        for path in HERE.glob("test_*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    }


def test_every_test_that_the_document_names_exists() -> None:
    assert not named() - written()


def test_every_test_is_named_in_the_document() -> None:
    assert not written() - named()
