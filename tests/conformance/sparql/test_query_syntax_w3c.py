"""W3C's syntax tests of SPARQL 1.0 and 1.1 Query: what is a query is taken, and what is none is refused in a sentence.

Two positive tests are left out: `syntax-lit-08` (SPARQL 1.1 ended decimals without digits after the point) and
`qname-escape-01` (its `\\:` is not in the grammar).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from rosld.server.dataset import MemoryStore
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.ros_functions import unknown_functions

if TYPE_CHECKING:
    from tests.conformance.sparql.conftest import Endpoint

SUITE = Path(__file__).parent / "w3c"
POSITIVE, NEGATIVE = (sorted(SUITE.glob(f"query-{kind}/*.rq")) for kind in ("positive", "negative"))
PLACE = re.compile(r" at \d+:\d+\b")


def test_the_suite_is_there() -> None:
    assert (len(POSITIVE), len(NEGATIVE)) == (208, 85)


@pytest.mark.parametrize("path", POSITIVE, ids=lambda path: path.stem)
def test_what_is_a_query_is_taken(path: Path) -> None:
    analysis = Analyser("http://h/", "http://t/").analyse(path.read_text("utf-8"))
    functions = unknown_functions(analysis.functions)
    MemoryStore().query(analysis.text, base="http://h/", prefixes=analysis.prefixes, functions=functions)


@pytest.mark.parametrize("path", NEGATIVE, ids=lambda path: path.stem)
def test_what_is_no_query_is_refused_in_a_sentence_that_says_where(path: Path, endpoint: Endpoint) -> None:
    answer = endpoint.query(path.read_text("utf-8"))
    assert answer.status_code == 400
    detail = answer.json()["detail"]
    assert PLACE.search(detail) or detail.startswith("The query ends where ")
    assert detail.endswith(".")
    assert len(detail) < 180
    assert not re.search(r"\\u|U\+|expected one of|\n", detail)
