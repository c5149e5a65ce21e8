"""W3C's tests of SPARQL 1.1 Update, over HTTP: the suite's own files (`w3c/`), with its graphs moved below `/data/`.

The default graph for writes is the default document. A WHERE reads the union of all graphs, so WITH names the default
document there. Deviations are in `DIFFERENT`, and in `docs/reference/conformance.md` with the reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rdflib import RDF, RDFS, Graph, Namespace
from rdflib.collection import Collection
from rdflib.term import Node

from rosld.server.sparql.syntax.lexer import tokens
from rosld.server.sparql.syntax.token import Kind, Token
from tests.conformance.sparql.conftest import new_store

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from tests.conformance.sparql.conftest import Endpoint, Store

SUITE = Path(__file__).parent / "w3c"
PAGE = SUITE.parents[2].parent / "docs" / "reference" / "conformance.md"
MF = Namespace("http://www.w3.org/2001/sw/DataAccess/tests/test-manifest#")
UT = Namespace("http://www.w3.org/2009/sparql/tests/test-update#")
EXAMPLE = "http://example.org/"
DEFAULT = ""
"""Name of the default graph in dictionaries of graphs."""
GRAPHS = (
    *(f"{EXAMPLE}g{number}" for number in range(1, 5)),
    *(f"http://www.example.com/g{number}" for number in range(1, 3)),
    "http://www.example.org",
    "http://www.example.org/",
)
"""Names of all other graphs of the suite."""

SERVER_TRIPLES = frozenset({*(f"insert-where-0{number}" for number in range(1, 5)), "insert-using-01", "insert-05a"})
"""Tests whose `?s ?p ?o` also matches the server's own statements about a graph: a FILTER removes them."""
DIFFERENT = SERVER_TRIPLES


@dataclass(frozen=True)
class Case:
    """A test of the suite: its request, the graphs before and after it (Turtle files by name)."""

    name: str
    kind: str
    request: Path
    before: Mapping[str, Path]
    after: Mapping[str, Path]

    def __str__(self) -> str:
        return f"{self.request.parent.name}/{self.name}"


def cases() -> Iterator[Case]:
    """Yield all tests from the manifests."""
    for path in sorted(SUITE.glob("*/manifest.ttl")):
        manifest = Graph().parse(path, format="turtle", publicID=path.as_uri())
        for entries in manifest.objects(None, MF.entries):
            for entry in Collection(manifest, entries):
                kind = manifest.value(entry, RDF.type)
                action, result = manifest.value(entry, MF.action), manifest.value(entry, MF.result)
                request = manifest.value(action, UT.request) or action
                name = str(entry).rpartition("#")[2]
                graphs = (graphs_of(manifest, node) for node in (action, result))
                yield Case(name, str(kind).removeprefix(str(MF)), file_of(request), *graphs)


def graphs_of(manifest: Graph, node: Node | None) -> Mapping[str, Path]:
    """Return the graphs of a state of the dataset."""
    found = {
        str(manifest.value(each, RDFS.label)): manifest.value(each, UT.graph)
        for each in manifest.objects(node, UT.graphData)
    }
    default = manifest.value(node, UT.data)
    return {name: file_of(each) for name, each in (found | ({DEFAULT: default} if default else {})).items()}


def file_of(node: Node | None) -> Path:
    """Return the file of the suite that a manifest names."""
    return Path(str(node).removeprefix("file://"))


CASES = tuple(cases())
EVALUATED = tuple(case for case in CASES if case.kind == "UpdateEvaluationTest")
POSITIVE = tuple(case for case in CASES if case.kind == "PositiveUpdateSyntaxTest11")
NEGATIVE = tuple(case for case in CASES if case.kind.startswith("Negative"))


# Renaming of graphs in requests


def moved(text: str, names: Mapping[str, str]) -> str:
    """Return an update with its graphs renamed, whose WHERE reads the default document."""
    default, read = f"<{names[DEFAULT]}>", [each for each in tokens(text) if each.kind is not Kind.COMMENT]
    found = "".join(_written(each, names) for each in read)
    return "".join(_with(default, part) for part in re.split(r"(;(?=[^{}]*(?:INSERT|DELETE|DROP)))", found))


def _written(token: Token, names: Mapping[str, str]) -> str:
    name = token.text[1:-1] if token.kind is Kind.IRI else EXAMPLE + token.text[1:] if token.kind is Kind.NAME else ""
    return f"<{names[name]}>" if name in names and name else token.text


def _with(default: str, operation: str) -> str:
    """Return an operation with WITH, if that is permitted and missing."""
    if re.search(r"\bWITH\b|\bDATA\b|\bDELETE\s+WHERE\b", operation):
        return operation
    return re.sub(r"\b(INSERT|DELETE)\b", rf"WITH {default} \1", operation, count=1)


def filtered(text: str, base: str) -> str:
    """Return an update whose WHERE ignores the server's statements about its own resources."""
    every = re.compile(r"(WHERE\s*\{\s*(?:GRAPH\s+\S+\s*\{)?\s*(\?s) \?p \?o)\b", re.IGNORECASE)
    return every.sub(rf'\1 FILTER(!(isIRI(\2) && STRSTARTS(STR(\2), "{base}")))', text)


# The tests


@pytest.mark.parametrize("section", sorted({case.request.parent.name for case in EVALUATED}))
def test_an_update_comes_to_what_w3c_expects(endpoint: Endpoint, section: str) -> None:
    of_section = [case for case in EVALUATED if case.request.parent.name == section]
    wrong = {str(case): words for case in of_section if (words := difference(new_store(endpoint), case))}
    assert not wrong, wrong


def difference(store: Store, case: Case) -> str:
    """Run a case in an empty store; return the difference from the result that W3C expects."""
    names = {label: store.at(f"graph-{number}") for number, label in enumerate(GRAPHS)}
    names[DEFAULT] = f"{store.endpoint.url}data/default"
    assert names.keys() >= {*case.before, *case.after}
    for label in {DEFAULT, *case.before}:  # there is always a default graph
        store.put(names[label], case.before[label].read_text("utf-8") if label in case.before else "")
    text = moved(case.request.read_text("utf-8"), names)
    if case.name in SERVER_TRIPLES:
        text = filtered(text, store.endpoint.url)
    answer = store.endpoint.post(text, "application/sparql-update")
    if answer.status_code != 204:
        return f"{answer.status_code}: {answer.text}"
    listed = store.endpoint.http.get(store.url, headers={"Accept": "application/n-triples"}).text
    for label, name in names.items():
        after = case.after[label].read_text("utf-8") if label in case.after else ""
        if label == DEFAULT and store.endpoint.http.get(name).status_code == 410:
            store.put(name, "")
        if (label in case.after or f"<{name}>" in listed) and not store.holds(name, after):
            return f"{label} after {text}"
    return ""


def test_what_is_an_update_to_w3c_is_read_and_what_is_none_refused(endpoint: Endpoint) -> None:
    wrong = []
    for case in (*POSITIVE, *NEGATIVE):
        dry = "?dry-run=true" if case in POSITIVE else ""
        answer = endpoint.post(case.request.read_bytes(), "application/sparql-update", dry)
        if (answer.status_code == 400) is (case in POSITIVE):
            wrong.append((str(case), answer.status_code, answer.text))
    assert not wrong, wrong


def test_the_page_says_what_is_different_and_of_how_many() -> None:
    section = PAGE.read_text("utf-8").partition("\n## SPARQL 1.1 Update\n")[2].partition("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    assert sorted(name for row in rows for name in re.findall(r"`([\w-]+)`", row[0])) == sorted(DIFFERENT)
    assert f"{len(EVALUATED)} of evaluation and {len(POSITIVE) + len(NEGATIVE)} of syntax" in " ".join(section.split())
    assert len(CASES) == len(EVALUATED) + len(POSITIVE) + len(NEGATIVE) == 156
