"""W3C's evaluation tests of SPARQL 1.1 Query, run by the query process: the suite's own files (`w3c/query-evaluation`).

They query the process, not the server, whose graphs also state when they were created. Numbers are compared by value,
as computed ones may have any form.
"""

from __future__ import annotations

import asyncio
import csv
import io
import re
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias
from urllib.parse import unquote

import pytest
from pyoxigraph import (
    BlankNode,
    Literal,
    QueryBoolean,
    QueryResultsFormat,
    QuerySolutions,
    RdfFormat,
    parse,
    parse_query_results,
)
from rdflib import RDF, Graph, Namespace, URIRef
from rdflib.collection import Collection
from rdflib.term import Node

from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.process.client import QueryProcess
from rosld.server.sparql.process.work import AnswerWork, QueryWork
from rosld.server.sparql.query_limits import Limits
from tests.conformance.sparql.conftest import canonical

pytestmark = pytest.mark.slow

SUITE = Path(__file__).parent / "w3c" / "query-evaluation"
PAGE = SUITE.parents[3].parent / "docs" / "reference" / "conformance.md"
BASE = "http://w3c.example/"
MF = Namespace("http://www.w3.org/2001/sw/DataAccess/tests/test-manifest#")
QT = Namespace("http://www.w3.org/2001/sw/DataAccess/tests/test-query#")
DAWGT = Namespace("http://www.w3.org/2001/sw/DataAccess/tests/test-dawg#")
DIFFERENT = frozenset({"agg-empty-group", "strdt03", "strlang03", "strbefore01", "strafter01"})
"""Deviations from the final versions of SPARQL and RDF 1.1; the page has the reasons."""
NUMERIC = re.compile(r"#(?:integer|decimal|double|float)$")
Results: TypeAlias = "bool | Counter[tuple[object, ...]] | set[str]"


@dataclass(frozen=True, eq=False)
class Case:
    """A test of the suite: the query, the graphs of its dataset by name, and its results."""

    name: str
    query: Path
    default: Sequence[str]
    named: Sequence[str]
    result: Path

    def __str__(self) -> str:
        return f"{self.query.parent.name}/{self.name}"


def cases() -> Iterator[Case]:
    """Yield all approved evaluation tests from the manifests of W3C."""
    for path in sorted(SUITE.glob("*/manifest.ttl")):
        manifest = Graph().parse(path, format="turtle", publicID=f"{BASE}{path.parent.name}/")
        for entries in manifest.objects(None, MF.entries):
            for entry in Collection(manifest, entries):
                kinds, approval = set(manifest.objects(entry, RDF.type)), manifest.value(entry, DAWGT.approval)
                if approval == DAWGT.Approved and kinds & {MF.QueryEvaluationTest, MF.CSVResultFormatTest}:
                    yield case_of(manifest, entry)


def case_of(manifest: Graph, entry: Node) -> Case:
    action = manifest.value(entry, MF.action)
    default, named = (
        [str(each) for each in manifest.objects(action, kind) if isinstance(each, URIRef)]
        for kind in (QT.data, QT.graphData)
    )
    query, result = manifest.value(action, QT.query), manifest.value(entry, MF.result)
    return Case(str(entry).rpartition("#")[2], file_of(str(query)), default, named, file_of(str(result)))


def file_of(url: str) -> Path:
    """Return the file of the suite that a manifest names."""
    return SUITE / unquote(url.removeprefix(BASE))


def url_of(path: Path) -> str:
    return BASE + path.relative_to(SUITE).as_posix()


CASES = tuple(cases())


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    one = asyncio.new_event_loop()
    yield one
    one.close()


@pytest.fixture(scope="module")
def process(loop: asyncio.AbstractEventLoop) -> Iterator[QueryProcess]:
    """A query process shared by all tests."""
    one = QueryProcess(2, 4)
    loop.run_until_complete(one.start())
    yield one
    loop.run_until_complete(one.close())


# Queries


async def answer(process: QueryProcess, case: Case) -> tuple[str, bytes]:
    """Return the media type and the results."""
    analysis = Analyser(BASE, "http://types.example/", prefixes={}).analyse_once(
        f"BASE <{url_of(case.query)}>\n{case.query.read_text('utf-8')}"
    )
    default = analysis.default_graphs or tuple(case.default) or (f"{BASE}none",)
    named = analysis.named_graphs or tuple(case.named)
    process.change({name: text_of(file_of(name), name) for name in {*default, *named} if file_of(name).exists()})
    media_type = MEDIA_TYPES.get(case.result.suffix, "application/sparql-results+json")
    if analysis.form == "CONSTRUCT":
        media_type = "application/n-triples"
    query = QueryWork(analysis.text, BASE, analysis.prefixes, default, named, functions=analysis.functions)
    limits = Limits(20.0)
    return media_type, await process.result(AnswerWork(query, media_type, 10_000), limits, time.monotonic() + 20)


MEDIA_TYPES = {
    ".csv": "text/csv",
    ".tsv": "text/tab-separated-values",
    ".srx": "application/sparql-results+xml",
    ".srj": "application/sparql-results+json",
}


def text_of(path: Path, url: str) -> str:
    """Return a document of the suite as N-Triples."""
    return "".join(f"{quad.triple} .\n" for quad in parse(path.read_bytes(), syntax_of(path), base_iri=url))


def syntax_of(path: Path) -> RdfFormat:
    return RdfFormat.RDF_XML if path.suffix == ".rdf" else RdfFormat.TURTLE


# Comparison


def read(media_type: str, data: bytes) -> Results:
    """Return results for comparison."""
    if media_type == "application/n-triples":
        return canonical([quad.triple for quad in parse(data, RdfFormat.N_TRIPLES)])
    if media_type == "text/csv":
        return Counter(map(row_of, csv.DictReader(io.StringIO(data.decode(), newline=""))))
    syntax = QueryResultsFormat.from_media_type(media_type)
    assert syntax is not None
    return counted(parse_query_results(data, syntax))


def row_of(row: Mapping[str, str]) -> tuple[object, ...]:
    """Return a row of CSV, which has no types."""
    return tuple((name, cell_of(cell)) for name, cell in sorted(row.items()))


def cell_of(cell: str) -> object:
    try:
        return float(cell)
    except ValueError:
        return "_:" if cell.startswith("_:") else cell


def counted(found: QueryBoolean | QuerySolutions) -> Results:
    if isinstance(found, QueryBoolean):
        return bool(found)
    names = sorted(each.value for each in found.variables)
    return Counter(tuple((name, value_of(row[name])) for name in names if row[name] is not None) for row in found)


def expected(case: Case) -> Results:
    """Return the results that W3C expects."""
    path = case.result
    if path.suffix in MEDIA_TYPES:
        return read(MEDIA_TYPES[path.suffix], path.read_bytes())
    return canonical([quad.triple for quad in parse(path.read_bytes(), syntax_of(path), base_iri=url_of(path))])


def value_of(term: object) -> object:
    """Return a term for comparison: the value of a number, and None for a blank node."""
    if isinstance(term, Literal) and NUMERIC.search(term.datatype.value):
        return term.datatype.value, float(term.value)
    return "_:" if isinstance(term, BlankNode) else str(term)


@pytest.mark.parametrize("section", sorted({case.query.parent.name for case in CASES}))
def test_a_query_comes_to_what_w3c_expects(
    loop: asyncio.AbstractEventLoop, process: QueryProcess, section: str
) -> None:
    of_section = [case for case in CASES if case.query.parent.name == section]
    found = {case: read(*loop.run_until_complete(answer(process, case))) for case in of_section}
    wrong = [str(case) for case in found if (found[case] == expected(case)) != (case.name not in DIFFERENT)]
    assert not wrong, wrong


def test_the_page_says_what_is_different_and_of_how_many() -> None:
    section = PAGE.read_text("utf-8").partition("\n## SPARQL 1.1 Query\n")[2].partition("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    assert sorted(name for row in rows for name in re.findall(r"`([\w-]+)`", row[0])) == sorted(DIFFERENT)
    assert f"the {len(CASES)} of evaluation" in " ".join(section.split())
    assert len(CASES) == 183
