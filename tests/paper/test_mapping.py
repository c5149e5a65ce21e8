"""`docs/reference/mapping.md` lists the tests of each line of the paper, and every test of this folder."""

from __future__ import annotations

import ast
import re
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
NAMED = re.compile(r"(tests/[\w/]+\.py)::(test_\w+)")


def functions_of(path: Path) -> set[tuple[str, str]]:
    """Return the tests of a file, each with the path of the file."""
    name = path.relative_to(ROOT).as_posix()
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    functions = (node.name for node in ast.parse(path.read_text("utf-8")).body if isinstance(node, kinds))
    return {(name, function) for function in functions if function.startswith("test_")}


def test_the_document_names_every_test_here_and_none_that_does_not_exist() -> None:
    named = set(NAMED.findall((ROOT / "docs" / "reference" / "mapping.md").read_text("utf-8")))
    written = set[tuple[str, str]]().union(*(functions_of(ROOT / path) for path, _ in named))
    assert named <= written
    assert set[tuple[str, str]]().union(*map(functions_of, HERE.glob("test_*.py"))) <= named
