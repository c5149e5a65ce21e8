"""`docs/reference/conformance.md` and the tests agree: every test case of W3C has its row, every row its test."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).parent
PAGE = HERE.parents[2] / "docs" / "reference" / "conformance.md"
COUNT = 53
"""Number of cases in the manifests of W3C."""


def told() -> Iterator[str]:
    """Yield the cases in the rows of the page."""
    section = PAGE.read_text("utf-8").partition("## SPARQL Protocol")[2].partition("\n## ")[0]
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 3 and cells[1] in ("met", "met differently"):
            yield from re.findall(r"`(\w+)`", cells[0])


def test_every_case_has_one_row_and_a_test_that_names_it() -> None:
    """The name of the test, or its docstring for several cases; the test of a write includes its GET."""
    cases = list(told())
    assert len(cases) == len(set(cases)) == COUNT
    tests = "".join(path.read_text("utf-8") for path in HERE.glob("test_*_*.py"))
    names = set(re.findall(r"def test_(\w+)\(|`(\w+)`", tests))
    found = {one or other for one, other in names}
    assert not [case for case in cases if not {case, re.sub(r"^get_of_|_(get|post)$", "", case)} & found]
