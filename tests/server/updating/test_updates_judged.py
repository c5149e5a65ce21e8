"""Random sequences of updates come to what plain pyoxigraph makes of them, however they are drawn.

Their literals are such as plain pyoxigraph keeps; `tests/server/test_terms_in_sparql.py` has the others.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from typing import Any

import httpx
import pyoxigraph
import pytest
from hypothesis import example, given, reject, settings
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn
from pyoxigraph import BlankNode, CanonicalizationAlgorithm, Dataset, DefaultGraph, NamedNode, Quad, RdfFormat, Triple

from rosld.server.http.problem import Problem
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.graph_source import GraphEntry
from rosld.server.sparql.materializer import Materializer
from rosld.server.sparql.needs import Needs
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.query_service import QueryService
from rosld.server.sparql.syntax.lexer import DEFAULT_BOUNDS
from rosld.server.sparql.update.evaluate import GraphChange
from rosld.server.sparql.update.executor import UpdateEvaluator
from rosld.server.sparql.update.operations import Modify
from rosld.server.sparql.update.parser import read_update
from tests.server.sparql.local import LocalProcess
from tests.server.updating.merged_update import run_update

BASE = "http://robot/"
GRAPHS = tuple(f"{BASE}data/g{number}" for number in range(4))
"""The last is not there at the beginning."""
START = f"""
<urn:a> <urn:p> "1"^^<http://www.w3.org/2001/XMLSchema#integer> <{GRAPHS[0]}> .
<urn:a> <urn:p> "7"^^<http://www.w3.org/2001/XMLSchema#integer> <{GRAPHS[0]}> .
<urn:a> <urn:q> _:one <{GRAPHS[0]}> .
_:one <urn:p> "x"@en <{GRAPHS[0]}> .
_:one <urn:p> _:two <{GRAPHS[0]}> .
<urn:b> <urn:p> "2.5"^^<http://www.w3.org/2001/XMLSchema#decimal> <{GRAPHS[1]}> .
<urn:b> <urn:p> <urn:a> <{GRAPHS[1]}> .
<urn:a> <urn:p> "1"^^<http://www.w3.org/2001/XMLSchema#integer> <{GRAPHS[2]}> .
_:three <urn:q> "true"^^<http://www.w3.org/2001/XMLSchema#boolean> <{GRAPHS[2]}> .
_:three <urn:q> _:three <{GRAPHS[2]}> .
"""
Graphs = Mapping[str, list[str]]
"""Graphs by their names, as canonical N-Triples; those without triples are left out."""
MAX_BLANKS = 6


def canonical(quads: Sequence[Quad]) -> Graphs:
    """What quads say, whatever their blank nodes are called. No two graphs share one here.

    To canonicalise many blank nodes takes for ever: where there are, they are all taken as one, and counted.
    """
    found = {}
    for graph in GRAPHS:
        triples = [quad.triple for quad in quads if quad.graph_name == NamedNode(graph)]
        blanks = {term for triple in triples for term in (triple.subject, triple.object) if isinstance(term, BlankNode)}
        if len(blanks) <= MAX_BLANKS:
            dataset = Dataset(Quad(*triple) for triple in triples)
            dataset.canonicalize(CanonicalizationAlgorithm.UNSTABLE)
            said = [str(quad) for quad in dataset]
        else:
            said = [f"{len(blanks)} blank nodes", *(" ".join(map(_anonymous, triple)) for triple in triples)]
        if said:
            found[graph] = sorted(said)
    return found


def _anonymous(term: object) -> str:
    return "_:" if isinstance(term, BlankNode) else str(term)


def start() -> list[Quad]:
    """The quads that everything begins with, as a store has them."""
    store = pyoxigraph.Store()
    store.load(START.encode(), RdfFormat.N_QUADS)
    return list(store)


# Made up at random

TERMS = st.sampled_from(["<urn:a>", "<urn:b>", "<urn:c>"])
THINGS = TERMS | st.sampled_from(["1", "7", "2.5", "'x'", "'x'@en", "true", "[]", "[ <urn:p> 1 ]", "( 1 <urn:a> )"])
VERBS = st.sampled_from(["<urn:p>", "<urn:q>"])
NAMES = st.sampled_from([f"<{graph}>" for graph in GRAPHS])
GROUPS = st.sampled_from(
    [
        "?s <urn:p> ?o",
        "?s ?p ?o",
        "?s <urn:q> ?o . OPTIONAL { ?o <urn:p> ?n }",
        "?s <urn:p> ?o BIND(?o + 1 AS ?n)",
        "?s <urn:p>/<urn:p>* ?o",
        "{ ?s <urn:p> ?o } UNION { ?o <urn:q> ?s }",
        "?s <urn:p> ?o MINUS { ?s <urn:q> ?x }",
        "FILTER NOT EXISTS { <urn:a> <urn:q> ?x } VALUES (?s ?o) { (<urn:a> 7) (<urn:b> UNDEF) }",
        "{ SELECT ?s (COUNT(*) AS ?o) WHERE { ?s ?p ?x } GROUP BY ?s }",
        "",
    ]
)
TEMPLATES = st.sampled_from(
    ["?s <urn:p> ?o", "?s ?p ?o", "?s <urn:q> ?n", "<urn:c> <urn:p> ?o , 7", "?o <urn:q> ?s", "?o ?s ?p", ""]
)
WITH_BLANKS = TEMPLATES | st.sampled_from(["?s <urn:p> [ <urn:q> ?o ]", "_:x <urn:p> ?s ; <urn:q> _:x"])


@dataclass(frozen=True)
class Told:
    """An operation in words for rosld, and in words that mean the same to pyoxigraph."""

    here: str
    there: str = field(default="")

    @property
    def words(self) -> str:
        """For pyoxigraph."""
        return self.there or self.here


def _around(draw: DrawFn, block: str) -> str:
    """A block within a graph, which may be the one that a variable stands for."""
    return f"GRAPH {draw(NAMES | st.just('?g'))} {{ {block} }}" if block else ""


@st.composite
def data(draw: DrawFn) -> Told:
    """INSERT DATA or DELETE DATA."""
    triples = " . ".join(f"{draw(TERMS)} {draw(VERBS)} {draw(THINGS)}" for _ in range(draw(st.integers(0, 3))))
    verb = "INSERT" if draw(st.booleans()) or "[" in triples or "(" in triples else "DELETE"
    return Told(f"{verb} DATA {{ GRAPH {draw(NAMES)} {{ {triples} }} }}")


@st.composite
def modification(draw: DrawFn) -> Told:
    """DELETE, INSERT or both, by WITH, USING, GRAPH, or over the union of all."""
    deletes, inserts, group = draw(TEMPLATES), draw(WITH_BLANKS), draw(GROUPS)
    kind = draw(st.sampled_from(["with", "using", "graph", "union", "pattern"]))
    if kind == "pattern":
        return Told(f"DELETE WHERE {{ GRAPH {draw(NAMES | st.just('?g'))} {{ ?s {draw(VERBS)} ?o . ?o ?p ?n }} }}")
    if kind == "with":
        return Told(f"WITH {draw(NAMES)} DELETE {{ {deletes} }} INSERT {{ {inserts} }} WHERE {{ {group} }}")
    deletes, inserts = _around(draw, deletes), _around(draw, inserts)
    if kind == "using":
        using = f"USING {draw(NAMES)} USING {draw(NAMES)} USING NAMED {draw(NAMES)}"
        held = f"{{ {group} }} GRAPH ?g {{ ?x ?y ?z }}"
        return Told(f"DELETE {{ {deletes} }} INSERT {{ {inserts} }} {using} WHERE {{ {held} }}")
    if kind == "graph":
        return Told(f"DELETE {{ {deletes} }} INSERT {{ {inserts} }} WHERE {{ GRAPH ?g {{ {group} }} }}")
    everything = " ".join(f"USING <{graph}> USING NAMED <{graph}>" for graph in GRAPHS)
    head, tail = f"DELETE {{ {deletes} }} INSERT {{ {inserts} }}", f"WHERE {{ {group} GRAPH ?g {{ ?x <urn:q> ?z }} }}"
    return Told(f"{head} {tail}", f"{head} {everything} {tail}")


@st.composite
def management(draw: DrawFn) -> Told:
    """An operation on whole graphs that are there."""
    verb, target, source = draw(st.sampled_from(["CLEAR", "DROP", "ADD", "COPY", "MOVE"])), draw(NAMES), draw(NAMES)
    if verb in ("CLEAR", "DROP"):
        return Told(f"{verb} SILENT GRAPH {target}")
    return Told(f"INSERT DATA {{ GRAPH {source} {{ <urn:a> <urn:p> 1 }} }} ; {verb} {source} TO {target}")


OPERATIONS = data() | modification() | management()


# In process


class Room:
    """A source of the graphs as they are at the beginning: of such as stand, or of such as have live values."""

    revision = 0
    writes = 0

    def __init__(self, live: bool) -> None:
        quads = start()
        self._live = live
        self._texts = {
            graph: "".join(f"{quad.triple} .\n" for quad in quads if quad.graph_name == NamedNode(graph))
            for graph in GRAPHS[:3]
        }

    def _entries(self) -> list[GraphEntry]:
        return [GraphEntry(graph, 1, partial(str, text), partial(parsed, text)) for graph, text in self._texts.items()]

    def descriptions(self) -> Mapping[str, GraphEntry]:
        return {entry.iri: entry for entry in self._entries()}

    async def documents_of(self, terms: Collection[str]) -> Collection[str]:
        return ()

    async def live(self, needs: Needs, *, deadline: float) -> Sequence[GraphEntry]:
        return [entry for entry in self._entries() if self._live and entry.iri in needs.documents]


def parsed(text: str) -> list[Triple]:
    """The triples of N-Triples."""
    return [quad.triple for quad in pyoxigraph.parse(text.encode(), RdfFormat.N_TRIPLES)]


def drawn(text: str, live: bool) -> tuple[GraphChange, ...]:
    """What an update comes to."""

    async def drawing() -> tuple[GraphChange, ...]:
        process, analyser = LocalProcess(), Analyser(BASE, "https://w3id.org/rosld/types/")
        service = QueryService(process, Materializer(process, Room(live)), analyser)
        operations = read_update(UpdateRequest(text), {}, BASE, DEFAULT_BOUNDS)
        return (await UpdateEvaluator(service, analyser).evaluate(operations)).changes

    try:
        return asyncio.run(asyncio.wait_for(drawing(), 60))
    except Problem as problem:
        if "more than 100000 solutions" not in problem.detail:
            raise
        reject()


def made_of(changes: Sequence[GraphChange]) -> list[Quad]:
    """The quads after changes, as a store has them: a change may be spelt as it was asked for."""
    graphs: dict[str, Any] = {}
    for quad in start():
        graphs.setdefault(quad.graph_name.value, []).append(quad.triple)
    for change in changes:
        graphs[change.graph] = change.after or ()
    store = pyoxigraph.Store()
    store.extend(Quad(*triple, NamedNode(graph)) for graph, triples in graphs.items() for triple in triples)
    return list(store)


def made_there(operations: Sequence[Told]) -> list[Quad]:
    """The quads after the same by pyoxigraph."""
    store = pyoxigraph.Store()
    store.load(START.encode(), RdfFormat.N_QUADS)
    for each in operations:
        run_update(store, each.words, BASE)
    assert not [quad for quad in store if isinstance(quad.graph_name, DefaultGraph)]
    return list(store)


@given(st.lists(OPERATIONS, min_size=1, max_size=4), st.booleans())
@settings(max_examples=60, deadline=None)
@example([Told(f"WITH <{GRAPHS[3]}> INSERT {{ <urn:a> <urn:p> 1 }} WHERE {{ }}")], False)
@example([Told(f"WITH <{GRAPHS[3]}> INSERT {{ ?s <urn:p> 1 }} WHERE {{ GRAPH ?g {{ ?s <urn:q> ?o }} }}")], False)
def test_a_sequence_comes_to_what_pyoxigraph_makes_of_it(operations: list[Told], live: bool) -> None:
    changes = drawn(" ; ".join(each.here for each in operations), live)
    assert canonical(made_of(changes)) == canonical(made_there(operations))
    for change in changes:
        assert change.was_there or change.after is not None
    assert len({change.graph for change in changes}) == len(changes)


@given(modification() | data(), st.booleans())
@settings(max_examples=60, deadline=None)
def test_one_operation_comes_to_the_same_drawn_over_copies(operation: Told, live: bool) -> None:
    """Without another before it a WHERE is asked of what is there, and only the changes are drawn."""
    changes = drawn(operation.here, live)
    assert canonical(made_of(changes)) == canonical(made_there([operation]))


def test_what_was_asked_first_has_no_part_in_what_is_asked_next() -> None:
    """Copies suffice where no WHERE follows another operation; else the dataset itself is changed, in a child."""
    first = f"INSERT DATA {{ GRAPH <{GRAPHS[3]}> {{ <urn:a> <urn:p> 1 }} }}"
    second = f"INSERT {{ GRAPH <{GRAPHS[3]}> {{ ?s <urn:q> ?g }} }} WHERE {{ GRAPH ?g {{ ?s <urn:p> 1 }} }}"
    for text, number in ((f"{first} ; {second}", 4), (f"{second} ; {first}", 3)):
        operations = read_update(UpdateRequest(text), {}, BASE, DEFAULT_BOUNDS)
        assert [isinstance(each, Modify) and each.where is not None for each in operations].count(True) == 1
        [change] = drawn(text, False)
        assert not change.was_there
        assert len(change.after or ()) == number


# Over HTTP


@pytest.fixture(scope="module")
def plane(start_server: Callable[..., Any]) -> httpx.Client:
    """An aircraft of this module's own."""
    client: httpx.Client = start_server("aircraft").http
    return client


TURNS = count()


@given(st.lists(data() | modification(), min_size=1, max_size=3).filter(lambda found: not any(map(is_open, found))))
@settings(max_examples=8, deadline=None)
def test_over_http_it_comes_to_the_same(plane: httpx.Client, operations: list[Told]) -> None:
    turn = next(TURNS)
    names = {graph: str(plane.base_url.join(f"/data/turn{turn}/g{at}")) for at, graph in enumerate(GRAPHS)}
    for graph, name in names.items():
        said = "".join(f"{quad.triple} .\n" for quad in start() if quad.graph_name == NamedNode(graph))
        if said:
            put = plane.put(name, content=said.encode(), headers={"Content-Type": "application/n-triples"})
            assert put.status_code == 201, put.text
    text = " ; ".join(each.words for each in operations)
    for graph, name in names.items():
        text = text.replace(graph, name)
    answer = plane.post("/sparql", content=text, headers={"Content-Type": "application/sparql-update"})
    assert answer.status_code == 204, answer.text
    found = pyoxigraph.Store()
    for graph, name in names.items():
        got = plane.get(name, headers={"Accept": "application/n-triples"})
        if got.status_code == 200:
            found.load(got.content, RdfFormat.N_TRIPLES, to_graph=NamedNode(graph))
    told = [quad for quad in found if quad.subject.value not in names.values()]  # the server tells of each resource
    assert canonical(told) == canonical(made_there(operations))


def is_open(told: Told) -> bool:
    """Whether it asks for what is not the same over HTTP: other graphs, and what the server tells of each resource."""
    everywhere = "USING" not in told.words and "GRAPH ?g" in told.words
    return everywhere or any(each in told.words for each in ("?p ", "?y ", "COUNT"))
