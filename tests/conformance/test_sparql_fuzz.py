"""Whatever query or update is sent, the server lives, says why not, and answers what is right as the store does itself.

Well-formed queries are made by a grammar and compared with pyoxigraph over the same triples; mangled ones are made of
these, of the queries that come with rosld and of a list of what has hurt others. The same is sent in each run;
more with `ROSLD_FUZZ_EXAMPLES` (100), others with `ROSLD_FUZZ_SEED` (0).
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyoxigraph import NamedNode, QueryBoolean, QuerySolutions, RdfFormat, Store, parse

from tests.conformance.fuzzing import fuzzing
from tests.server.conftest import Served, start_server

__all__ = ["start_server"]
pytestmark = pytest.mark.slow

LIMIT = 1.0
"""Seconds a query may take."""
PATIENCE = LIMIT + 9.0
"""Seconds in which every answer has come, on a machine that is busy with other things."""
P, X = "http://p.example/", "http://x.example/"
TRIPLES = "".join(
    f"<{X}{n}> <{P}next> <{X}{(n * 7 + 3) % 12}> .\n"
    f'<{X}{n}> <{P}name> "n{n % 5}" .\n'
    f"<{X}{n}> <{P}size> {n % 4} .\n"
    f"<{X}{n}> a <{P}{'Odd' if n % 2 else 'Even'}> .\n"
    for n in range(12)
)


class Server:
    """A served aircraft that keeps the triples in one graph, and a client of it."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.http = served.http
        self.graph = f"{served.url}data/fuzzed"
        put = self.http.put("/data/fuzzed", content=TRIPLES, headers={"Content-Type": "text/turtle"})
        assert put.status_code == 201, put.text
        said = self.http.get("/sparql", params={"query": _EVERYTHING, "default-graph-uri": self.graph, "format": "nt"})
        self.store = Store()
        for quad in parse(said.content, RdfFormat.N_TRIPLES):
            self.store.add(quad)

    def query(self, text: str, **parameters: str) -> httpx.Response:
        """The answer to a query, which is sound."""
        accept = "application/n-triples, application/sparql-results+json, application/problem+json"
        headers = {"Accept": accept}
        return self._sound(lambda: self.http.post("/sparql", data={"query": text, **parameters}, headers=headers))

    def direct(self, path: str, media_type: str, text: bytes) -> httpx.Response:
        """The answer to a text of a media type, which is sound."""
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
            assert problem["reason"] in ("time", "memory", "rows", "busy")
        return answer


_EVERYTHING = "CONSTRUCT { ?s ?p ?o } WHERE { ?s ?p ?o }"


@pytest.fixture(scope="module")
def server(start_server: Callable[..., Served]) -> Server:
    limits = ("--setting", "query_time_limit", str(LIMIT), "--query-row-limit", "20000")
    return Server(start_server("aircraft", *limits))


# A grammar of queries

VARIABLES = st.sampled_from(["?a", "?b", "?c", "?d"])
NODES = st.sampled_from([f"<{X}{n}>" for n in (0, 1, 5, 11)])
LITERALS = st.sampled_from(['"n1"', '"n9"', "0", "2", "1.5", "1e3", "true", '"x"@en', '"n1"^^<http://p.example/T>'])
STEPS = st.sampled_from([f"<{P}next>", f"<{P}name>", f"<{P}size>", "a"])


def _path(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.one_of(
        st.tuples(inner, st.sampled_from(["*", "+", "?"])).map(lambda two: f"({two[0]}){two[1]}"),
        st.tuples(inner, st.sampled_from(["/", "|"]), inner).map(lambda three: f"({''.join(three)})"),
        inner.map("^({})".format),
        STEPS.map("!({})".format),
    )


PATHS = st.recursive(STEPS, _path, max_leaves=3)
TRIPLE = st.builds("{} {} {} .".format, VARIABLES | NODES, PATHS | VARIABLES, VARIABLES | NODES | LITERALS)
ATOMS = VARIABLES | LITERALS | NODES


def _expression(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    names = ["STR", "ISIRI", "STRLEN", "UCASE", "DATATYPE", "ABS", "!", "-", "LANG", "SHA1", "COALESCE"]
    called = st.builds("{}({})".format, st.sampled_from(names), inner)
    operators = ["=", "!=", "<", ">=", "&&", "||", "+", "*", "/", "-"]
    joined = st.builds("({} {} {})".format, inner, st.sampled_from(operators), inner)
    more = st.builds(
        "{}({}, {})".format, st.sampled_from(["CONCAT", "CONTAINS", "STRSTARTS", "SAMETERM"]), inner, inner
    )
    choice = st.builds("IF({}, {}, {})".format, inner, inner, inner)
    member = st.builds("({} IN ({}, {}))".format, inner, inner, inner)
    pattern = st.builds("REGEX(STR({}), {})".format, inner, st.sampled_from(['"n[0-3]"', '"(a*)*$"', '"("', '"."']))
    return called | joined | more | choice | member | pattern


EXPRESSIONS = st.recursive(ATOMS, _expression, max_leaves=5)
FILTERS = EXPRESSIONS.map("FILTER({})".format)
_FRESH = st.sampled_from(["?x", "?y", "?z"])
VALUES = st.lists(NODES | LITERALS | st.just("UNDEF"), max_size=3).map(
    lambda terms: f"VALUES ?a {{ {' '.join(terms)} }}"
)


def _groups(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.one_of(
        inner.map("OPTIONAL {{ {} }}".format),
        inner.map("MINUS {{ {} }}".format),
        inner.map("FILTER NOT EXISTS {{ {} }}".format),
        inner.map("FILTER EXISTS {{ {} }}".format),
        st.builds("{{ {} }} UNION {{ {} }}".format, inner, inner),
        inner.map("{{ SELECT DISTINCT ?a ?b {{ {} }} }}".format),
        inner.map("{{ SELECT ?a (COUNT(*) AS ?n) {{ {} }} GROUP BY ?a }}".format),
        st.lists(inner, min_size=2, max_size=3).map(" ".join),
    )


BODIES = st.recursive(st.lists(TRIPLE, min_size=1, max_size=3).map(" ".join) | FILTERS | VALUES, _groups, max_leaves=5)
WHERES = st.builds("{{ {} {} }}".format, BODIES, st.just("") | EXPRESSIONS.map(lambda one: f"BIND({one} AS ?bound)"))
PROJECTIONS = st.sampled_from(["*", "?a ?b", "DISTINCT ?a ?c", "(COUNT(*) AS ?n)", "(SUM(?c) AS ?n) (MIN(?b) AS ?m)"])
CORRECT = st.one_of(
    st.builds("SELECT {} {}".format, PROJECTIONS, WHERES),
    st.builds("SELECT ?a (COUNT(?b) AS ?n) {} GROUP BY ?a HAVING (COUNT(?b) > 1)".format, WHERES),
    WHERES.map("ASK {}".format),
    st.builds("CONSTRUCT {{ ?a <{}> ?b . ?b ?c ?d }} WHERE {}".format, st.just(f"{P}made"), WHERES),
)


def expected(store: Store, text: str) -> object:
    """What pyoxigraph makes of a query: words where it refuses."""
    try:
        found = store.query(text)
        if isinstance(found, QueryBoolean):
            return bool(found)
        if isinstance(found, QuerySolutions):
            names = [variable.value for variable in found.variables]
            return sorted(
                tuple(sorted((name, str(row[name])) for name in names if row[name] is not None)) for row in found
            )
        return sorted({str(triple) for triple in found})
    except (SyntaxError, RuntimeError, ValueError):
        return None


def told(answer: httpx.Response) -> object:
    """The same of an answer."""
    if answer.headers["content-type"].startswith("application/sparql-results+json"):
        found = answer.json()
        if "boolean" in found:
            return found["boolean"]
        return sorted(
            tuple(sorted((name, _term(value)) for name, value in row.items())) for row in found["results"]["bindings"]
        )
    return sorted({str(quad.triple) for quad in parse(answer.content, RdfFormat.N_TRIPLES)})


def _term(value: Mapping[str, str]) -> str:
    from pyoxigraph import BlankNode, Literal

    if value["type"] == "uri":
        return str(NamedNode(value["value"]))
    if value["type"] == "bnode":
        return str(BlankNode(value["value"]))
    language, datatype = value.get("xml:lang"), value.get("datatype")
    return str(Literal(value["value"], language=language, datatype=NamedNode(datatype) if datatype else None))


def test_a_query_that_is_right_is_answered_as_the_store_does(server: Server) -> None:
    compared: Counter[str] = Counter()

    @fuzzing()
    @given(text=CORRECT)
    def attempt(text: str) -> None:
        answer = server.query(text, **{"default-graph-uri": server.graph})
        if answer.status_code == 200:
            ours = told(answer)
            assert ours == expected(server.store, text)
            compared[text.partition(" ")[0]] += 1
        elif answer.status_code == 400:
            refused = "joins more than" in answer.text or "can be read as" in answer.text
            assert refused or expected(server.store, text) is None, answer.text
            compared["refused"] += 1
        else:
            compared[str(answer.status_code)] += 1

    attempt()
    assert compared.total() > 2 * compared["refused"]


# What is mangled

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
    """A text in pieces: words, blanks, marks."""
    import re

    return re.findall(r"\w+|\s+|[^\w\s]", text)


@st.composite
def mangled(draw: Any, texts: st.SearchStrategy[str]) -> str:
    """A text with pieces dropped, doubled, exchanged and put in from elsewhere."""
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


TEXTS = st.sampled_from([*HOSTILE, *SHIPPED]) | CORRECT


def test_what_has_hurt_others_is_answered(server: Server) -> None:
    for text in HOSTILE:
        server.query(text)
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
    answer = server.query(_EVERYTHING, **{"default-graph-uri": server.graph})
    assert told(answer) == expected(server.store, _EVERYTHING)
    assert (
        json.loads(server.http.get("/resources/aircraft/power", headers={"Accept": "application/json"}).text)
        is not None
    )
