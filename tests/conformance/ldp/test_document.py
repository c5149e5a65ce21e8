"""`docs/reference/conformance.md` and the tests agree: each clause has a row, each row its tests, each test its row."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
PAGE = HERE.parents[2] / "docs" / "reference" / "conformance.md"
COUNTS = (
    {"4.2.1": 6, "4.2.2": 2, "4.2.4": 6, "4.2.6": 1, "4.2.7": 1, "4.2.8": 2, "4.3.1": 13, "4.3.2": 3, "4.4.1": 2}
    | {"5.2.1": 5, "5.2.3": 14, "5.2.4": 2, "5.2.5": 2, "5.2.7": 1, "5.2.8": 1, "5.3.1": 1}
    | {"5.4.1": 5, "5.4.1.4": 2, "5.4.2": 1, "5.4.3": 1, "5.5.1": 2, "5.5.2": 1}
    | {"6.1": 2, "6.2": 6, "6.3": 3, "7.1": 2, "7.2.2": 4}
)
"""Number of clauses in each section of LDP 1.0."""
CLAUSES = {f"{section}.{number}" for section, count in COUNTS.items() for number in range(1, count + 1)}


class Row(NamedTuple):
    """A row of the table."""

    clause: str
    level: str
    verdict: str
    tests: frozenset[str]


def rows() -> Iterator[Row]:
    for line in PAGE.read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if re.fullmatch(r"[4-7](\.\d+)+", cells[0]):
            yield Row(cells[0], cells[1], cells[2], frozenset(re.findall(r"`(test_\w+)`", cells[-1])))


def written() -> Iterator[str]:
    for path in HERE.glob("test_*.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                yield node.name


ROWS = {row.clause: row for row in rows()}
TESTS = frozenset(written())


def test_every_clause_has_a_row_that_names_tests_which_are_there() -> None:
    assert set(ROWS) - {"7.2.2"} == CLAUSES
    order = [[int(part) for part in clause.split(".")] for clause in ROWS]
    assert order == sorted(order)
    wrong = [
        row
        for row in ROWS.values()
        if not row.tests <= TESTS
        or row.verdict not in ("met", "met differently", "not done", "for clients")
        or (row.level and row.verdict != "for clients" and not row.tests)
        or ("MUST" in row.level and row.verdict == "not done")
    ]
    assert not wrong, wrong


def test_every_test_of_a_clause_is_named_in_its_row() -> None:
    named = {name: re.match(r"test_(\d+(?:_\d+)+)_", name) for name in TESTS}
    unnamed = [name for name, at in named.items() if at and name not in ROWS[at[1].replace("_", ".")].tests]
    assert not unnamed, unnamed
