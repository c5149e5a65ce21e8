"""Fuzzing of queries and updates: the server survives and explains every refusal.

They are derived from the queries shipped with rosld and from a list of known vulnerabilities of others. Each run sends
the same; `ROSLD_FUZZ_EXAMPLES` (100) sends more, `ROSLD_FUZZ_SEED` (0) others.
`tests/server/sparql/test_differential.py` compares the answers to well-formed queries with pyoxigraph's.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conformance.fuzzing import fuzzing
from tests.server.conftest import Served, start_server
from tests.waiting import until

__all__ = ["start_server"]
pytestmark = pytest.mark.slow

LIMIT = 1.0
"""Maximum duration of a query in seconds."""
PATIENCE = LIMIT + 9.0
"""Maximum duration of a response in seconds, on a busy machine."""
P, X = "http://p.example/", "http://x.example/"
TRIPLES = "".join(
    f"<{X}{n}> <{P}next> <{X}{(n * 7 + 3) % 12}> .\n"
    f'<{X}{n}> <{P}name> "n{n % 5}" .\n'
    f"<{X}{n}> <{P}size> {n % 4} .\n"
    f"<{X}{n}> a <{P}{'Odd' if n % 2 else 'Even'}> .\n"
    for n in range(12)
)


class Server:
    """A served aircraft that stores the triples in one graph, and its client."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.http = served.http
        self.graph = f"{served.url}data/fuzzed"
        put = self.http.put("/data/fuzzed", content=TRIPLES, headers={"Content-Type": "text/turtle"})
        assert put.status_code == 201, put.text
        self.before = self.everything()

    def everything(self) -> list[str]:
        """Return the triples of the graph."""
        query = "CONSTRUCT { ?s ?p ?o } WHERE { ?s ?p ?o }"
        parameters = {"query": query, "default-graph-uri": self.graph, "format": "nt"}
        answer = until(
            lambda: (found := self.http.get("/sparql", params=parameters)).is_success and found, "the dataset"
        )
        return sorted(answer.text.splitlines())

    def direct(self, path: str, media_type: str, text: bytes) -> httpx.Response:
        """Return the response to a text of a media type, after checking that it is sound."""
        return self._sound(lambda: self.http.post(path, content=text, headers={"Content-Type": media_type}))

    def _sound(self, send: Callable[[], httpx.Response]) -> httpx.Response:
        begun = time.monotonic()
        try:
            answer = send()
        except httpx.RemoteProtocolError:  # stopped in the middle: the connection broke, as it must
            answer = httpx.Response(299)
        assert time.monotonic() - begun < PATIENCE
        assert self.served.process.poll() is None, "the server died"
        assert answer.status_code < 500 or answer.status_code == 503, f"{answer.status_code}: {answer.text[:500]}"
        if answer.status_code >= 400:
            problem = answer.json()
            assert problem["status"] == answer.status_code
            assert len(problem["detail"]) > 10
            assert "Traceback" not in problem["detail"]
        if answer.status_code == 503:
            assert problem["reason"] in ("time", "memory", "rows", "busy", "starting")
        return answer


@pytest.fixture(scope="module")
def server(start_server: Callable[..., Served]) -> Server:
    limits = ("--setting", "query_time_limit", str(LIMIT), "--query-row-limit", "20000")
    return Server(start_server("aircraft", *limits))


# Mutations

HOSTILE = [
    "SELECT * WHERE " + "{" * 60 + "}" * 60,
    "SELECT * WHERE { ?s ?p " + "[ ?p " * 60 + "]" * 60 + " }",
    "SELECT * WHERE { FILTER(" + "(" * 60 + "1" + ")" * 60 + ") }",
    "SELECT * WHERE { FILTER(" + "!" * 300 + "true) }",
    "SELECT * WHERE { ?s " + "^" * 60 + "<a:b> ?o }",
    "SELECT * WHERE { ?s (" + "<a:b>/" * 50 + "<a:b>)* ?o }",
    "SELECT * WHERE { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i } ORDER BY ?a ?d",
    "SELECT (COUNT(*) AS ?n) { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l }",
    "SELECT * { ?a (<a:b>|!<a:b>)* ?b . ?c (<a:b>|!<a:b>)* ?d }",
    'SELECT * { ?s ?p ?o FILTER(REGEX(?o, "^(((a+)+)+)+$")) }',
    'SELECT (REPLACE("aaaaaaaaaa", "a", "$0$0$0$0") AS ?x) {}',
    "SELECT * { " + " ".join(f"OPTIONAL {{ ?a ?p{n} ?b{n} }}" for n in range(12)) + " }",
    "SELECT * { " + " ".join(f"{{ ?a ?p{n} ?b }} UNION {{}}" for n in range(12)) + " }",
    "SELECT * { " + " ".join(f"VALUES ?v{n} {{ 1 2 3 4 5 6 7 8 9 }}" for n in range(9)) + " }",
    "SELECT * { ?s ?p ?o } LIMIT 99999999999999999999",
    "SELECT * { BIND(1/0 AS ?x) BIND(0.0/0.0 AS ?y) BIND(<a:b>(1) AS ?z) }",
    "DESCRIBE *",
    "CONSTRUCT { ?s ?p ?o . ?o ?p ?s . [] ?p [ ?p ?o ] } WHERE { ?s ?p ?o }",
    "SELECT ?x { { SELECT (1 AS ?x) {} } UNION { SELECT (2 AS ?x) {} } } VALUES ?x { UNDEF }",
    "PREFIX : <http://a/> SELECT * { :a\\,b :c\\%41 '''x''', \"\"\"y\"\"\"@en-x, 1.e1 , .5, -0.0 }",
    "SELECT * { << ?s ?p ?o >> ?a ?b }",
    "SELECT (GROUP_CONCAT(?x; SEPARATOR=',') AS ?y) { ?s ?p ?x }",
    "INSERT DATA { GRAPH </data/x> { <a:b> <c:d> 1 } }",
    "DELETE { ?s ?p ?o } INSERT { ?s ?p 2 } WHERE { ?s ?p ?o }",
    "WITH </data/fuzzed> DELETE { ?s ?p ?o } WHERE { ?s ?p ?o FILTER(?o = 1) }",
    "CLEAR ALL", "DROP SILENT GRAPH <a:b>", "COPY DEFAULT TO <a:b>", "LOAD <http://127.0.0.1:9/>", "CREATE GRAPH <a:b>",
    "INSERT { ?a ?b ?c } WHERE { ?a ?b ?c . ?d ?e ?f . ?g ?h ?i . ?j ?k ?l . ?m ?n ?o }",
]  # fmt: skip
SHIPPED = [file.read_text("utf-8") for file in files("rosld.queries").iterdir() if file.name.endswith(".rq")]
SPLINTERS = [
    "{", "}", "(", ")", "[", "]", "<", ">", "<<", "'", '"', '"""', "\\", "\\u0000", "\\uD800", "#", "\n", "\x00",
    "\ud800", "\ufeff", "?", "$", "?x", "_:b", "@", "^^", "*", "+", "|", "/", "!", ".", ";", ",", "=", "a", "SERVICE",
    "LOAD", "SELECT", "{}", "UNION", "OPTIONAL", "FILTER", "BIND(", "AS ?x)", "VALUES ?x {", "GRAPH ?g {", "LIMIT 1",
    "OFFSET -1", "BASE <x>", "1e400", ":", "99999999999999999999999999", "\U0001f600", "{" * 200, "(" * 2000,
    "!" * 5000, "^" * 3000, "?s ?p ?o . " * 100, "-" * 4000,
]  # fmt: skip


@lru_cache
def _cuts(text: str) -> Sequence[str]:
    """Return a text in pieces: words, blanks, marks."""
    return re.findall(r"\w+|\s+|[^\w\s]", text)


@st.composite
def mangled(draw: Any, texts: st.SearchStrategy[str]) -> str:
    """Return a text with pieces dropped, doubled, exchanged and inserted from elsewhere."""
    pieces = list(_cuts(draw(texts)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(0, len(pieces) - 1)))
        until = at + draw(st.integers(0, 6))
        how = draw(st.sampled_from(["drop", "double", "many", "put", "put", "exchange", "steal"]))
        if how == "drop":
            del pieces[at:until]
        elif how == "double":
            pieces[at:at] = pieces[at:until]
        elif how == "many":
            pieces[at:at] = pieces[at:until] * draw(st.sampled_from([5, 50, 500]))
        elif how == "put":
            pieces[at:at] = [draw(st.sampled_from(SPLINTERS))]
        elif how == "exchange" and pieces:
            other = draw(st.integers(0, len(pieces) - 1))
            pieces[at], pieces[other] = pieces[other], pieces[at]
        else:
            donor = _cuts(draw(texts))
            begin = draw(st.integers(0, max(0, len(donor) - 1)))
            pieces[at:at] = donor[begin : begin + 10]
    return "".join(pieces)[:100_000]


TEXTS = st.sampled_from([*HOSTILE, *SHIPPED])


def test_what_has_hurt_others_is_answered(server: Server) -> None:
    for text in HOSTILE:
        server.direct("/sparql", "application/sparql-query", text.encode())
        server.direct("/sparql?dry-run=true", "application/sparql-update", text.encode())


def test_a_query_that_was_mangled_is_answered(server: Server) -> None:
    @fuzzing()
    @given(text=mangled(TEXTS), timeout=st.sampled_from(["", "0.3", "1"]))
    def attempt(text: str, timeout: str) -> None:
        more = f"?timeout={timeout}" if timeout else ""
        server.direct(f"/sparql{more}", "application/sparql-query", text.encode("utf-8", "surrogatepass"))

    attempt()


def test_an_update_that_was_mangled_is_answered_and_only_planned(server: Server) -> None:
    @fuzzing(0.5)
    @given(text=mangled(TEXTS))
    def attempt(text: str) -> None:
        server.direct("/sparql?dry-run=true", "application/sparql-update", text.encode("utf-8", "surrogatepass"))

    attempt()


def test_after_all_that_the_dataset_is_as_it_was(server: Server) -> None:
    assert server.everything() == server.before
    assert server.http.get("/resources/aircraft/power", headers={"Accept": "application/json"}).json() is not None
