r"""W3C's syntax tests of SPARQL 1.0 and 1.1 Query: valid queries are accepted, others rejected with a sentence.

Two positive tests are omitted: `syntax-lit-08` (SPARQL 1.1 removed decimals without digits after the point) and
`qname-escape-01` (its `\:` is not in the grammar).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from rosld.server.dataset import MemoryStore
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.ros_functions import unknown_functions

if TYPE_CHECKING:
    from tests.conformance.sparql.conftest import Endpoint

SUITE = Path(__file__).parent / "w3c"
POSITIVE, NEGATIVE = (sorted(SUITE.glob(f"query-{kind}/*.rq")) for kind in ("positive", "negative"))
PLACE = re.compile(r" at \d+:\d+\b")
UNREADABLE = re.compile(r"\\u|U\+|expected one of|\n")


def test_what_is_a_query_is_taken() -> None:
    refused = []
    for path in POSITIVE:
        try:
            analysis = Analyser("http://h/", "http://t/").analyse(path.read_text("utf-8"))
            functions = unknown_functions(analysis.functions)
            MemoryStore().query(analysis.text, base="http://h/", prefixes=analysis.prefixes, functions=functions)
        except Exception as error:
            refused.append((path.stem, error))
    assert not refused, refused
    assert len(POSITIVE) == 208


def test_what_is_no_query_is_refused_in_a_sentence_that_says_where(endpoint: Endpoint) -> None:
    wrong = []
    for path in NEGATIVE:
        answer = endpoint.query(path.read_text("utf-8"))
        detail = answer.json()["detail"] if answer.status_code == 400 else ""
        says_where = PLACE.search(detail) or detail.startswith("The query ends where ")
        is_sentence = detail.endswith(".") and len(detail) < 180 and not UNREADABLE.search(detail)
        if not (says_where and is_sentence):
            wrong.append((path.stem, answer.status_code, detail))
    assert not wrong, wrong
    assert len(NEGATIVE) == 85
