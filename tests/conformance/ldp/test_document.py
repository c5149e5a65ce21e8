"""`docs/reference/conformance.md` and the tests agree: each clause has a row, each row its tests, each test its row."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

HERE = Path(__file__).parent
PAGE = HERE.parents[2] / "docs" / "reference" / "conformance.md"
COUNTS = (
    {"4.2.1": 6, "4.2.2": 2, "4.2.4": 6, "4.2.6": 1, "4.2.7": 1, "4.2.8": 2, "4.3.1": 13, "4.3.2": 3, "4.4.1": 2}
    | {"5.2.1": 5, "5.2.3": 14, "5.2.4": 2, "5.2.5": 2, "5.2.7": 1, "5.2.8": 1, "5.3.1": 1}
    | {"5.4.1": 5, "5.4.1.4": 2, "5.4.2": 1, "5.4.3": 1, "5.5.1": 2, "5.5.2": 1}
    | {"6.1": 2, "6.2": 6, "6.3": 3, "7.1": 2, "7.2.2": 4}
)
"""How many clauses each section of LDP 1.0 has."""
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


def test_every_clause_has_a_row() -> None:
    assert set(ROWS) - {"7.2.2"} == CLAUSES
    order = [[int(part) for part in clause.split(".")] for clause in ROWS]
    assert order == sorted(order)


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
def test_every_row_names_tests_that_are_there(row: Row) -> None:
    assert row.tests <= TESTS
    assert row.verdict in ("met", "met differently", "not done", "for clients")
    if row.level and row.verdict != "for clients":
        assert row.tests, f"{row.clause} is met, and nothing shows it"
    if "MUST" in row.level:
        assert row.verdict != "not done"


@pytest.mark.parametrize("test", sorted(name for name in TESTS if re.match(r"test_\d", name)))
def test_every_test_of_a_clause_is_named_in_its_row(test: str) -> None:
    found = re.match(r"test_(\d+(?:_\d+)+)_", test)
    assert found is not None
    assert test in ROWS[found[1].replace("_", ".")].tests
