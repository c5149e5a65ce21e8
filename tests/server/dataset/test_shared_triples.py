"""The default graph is a set: a triple that several graphs have is found there once, whatever was changed before."""

from __future__ import annotations

import os
import pickle
from collections import Counter
from random import Random

import pytest
from pyoxigraph import DefaultGraph, NamedNode, Quad, QueryBoolean, QuerySolutions, RdfFormat, Store, parse

from rosld.server.dataset import Edit, MemoryStore
from rosld.server.dataset import shared_triples as module
from rosld.server.dataset.encoding import encode_ntriples
from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.process.work import QueryWork

H = "http://h/"
GRAPHS = [f"{H}g{number}" for number in range(4)]
TRIPLES = [
    f"<{H}{subject}> <{H}{predicate}> {object} .\n"
    for subject in "ab"
    for predicate in "pq"
    for object in (f"<{H}a>", f"<{H}b>", '"01"^^<http://www.w3.org/2001/XMLSchema#integer>', "_:n")
]
QUERIES = [
    "SELECT * { ?s ?p ?o }",
    "SELECT (COUNT(*) AS ?n) { ?s <p> ?o }",
    "SELECT (COUNT(*) AS ?n) { <a> ?p ?o }",
    "SELECT * { ?s <p> <b> . ?s <q> ?o }",
    "SELECT * { <a> <p>/<q> ?o }",
    "SELECT * { ?s (<p>|<q>)+ <b> }",
    "SELECT * { <a> ^<p> ?s }",
    "SELECT ?s ?n { ?s <q> <a> { SELECT ?s (COUNT(*) AS ?n) { ?s ?p ?o } GROUP BY ?s } }",
    "SELECT * { GRAPH ?g { ?s <p> ?o } }",
    "SELECT * { ?s <p> ?o GRAPH ?g { ?s ?p ?o } }",
    "SELECT * { GRAPH <g1> { ?s ?p ?o } OPTIONAL { ?o <q> ?x } }",
    "SELECT * { ?s <q> ?o MINUS { GRAPH <g2> { ?s <q> ?o } } }",
    "SELECT * { ?s <q> ?o FILTER EXISTS { ?s <p> ?x } FILTER NOT EXISTS { GRAPH <g0> { ?s ?p ?o } } }",
    "SELECT * FROM <g0> FROM <g1> { ?s ?p ?o }",
    "SELECT * FROM <g0> { ?s ?p ?o }",
    "SELECT * FROM <g2> FROM <g3> FROM NAMED <g0> { ?s <p> ?o . GRAPH ?g { ?s ?p ?o } }",
    "SELECT * FROM NAMED <g0> { ?s <p> ?o }",
    "ASK { <b> <q> <a> }",
    "CONSTRUCT { ?s ?p ?o } WHERE { ?s ?p ?o }",
    "DESCRIBE <a>",
]


def answer(store: MemoryStore, text: str) -> object:
    """The answer as the query process finds it: in a fork, which may change the dataset, where a triple may repeat."""
    analysis = Analyser(H, f"{H}types/").analyse_once(text)
    default, named = analysis.default_graphs, analysis.named_graphs
    lookups, names = analysis.lookups, analysis.names_graphs
    work = QueryWork(analysis.text, H, {}, default, named, None, None, frozenset(), lookups, names)
    if not store.may_repeat(lookups):
        return comparable(work.results(store))
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            os.write(writing, pickle.dumps(comparable(work.results(store))))
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        found: object = pickle.load(pipe)
    os.waitpid(pid, 0)
    return found


def expected(store: MemoryStore, text: str) -> object:
    """The answer over the same graphs, with all triples in the default graph, too."""
    analysis = Analyser(H, f"{H}types/").analyse_once(text)
    whole = Store()
    for graph in store.graphs():
        node = NamedNode(graph)
        whole.add_graph(node)
        quads = [*parse(encode_ntriples(store.ntriples(graph) or "").encode(), RdfFormat.N_TRIPLES)]
        whole.extend(Quad(*quad.triple, node) for quad in quads)
        if graph in analysis.default_graphs or not (analysis.default_graphs or analysis.named_graphs):
            whole.extend(quads)
    named = [*map(NamedNode, analysis.named_graphs)]
    dataset = {"default_graph": DefaultGraph(), "named_graphs": named} if analysis.default_graphs or named else {}
    return comparable(whole.query(analysis.text, base_iri=H, **dataset))


def comparable(found: object) -> object:
    if isinstance(found, QueryBoolean):
        return bool(found)
    if not isinstance(found, QuerySolutions):
        return {str(each) for each in found}  # type: ignore[attr-defined]
    names = [each.value for each in found.variables]
    return Counter(tuple((name, str(row[name])) for name in names) for row in found)


def changes(random: Random) -> tuple[dict[str, str | None], list[Edit]]:
    """A change at random: graphs that say something else, or are gone, and edits."""
    graphs: dict[str, str | None] = {}
    for graph in random.sample(GRAPHS, random.randint(0, 2)):
        graphs[graph] = random.choice([None, "", text(random), text(random)])
    edits = [Edit(random.choice(GRAPHS), named(random), named(random)) for _ in range(random.randint(0, 2))]
    return graphs, edits


def text(random: Random) -> str:
    return "".join(random.choices(TRIPLES, k=random.randint(1, 12)))


def named(random: Random) -> str:
    return "".join(line for line in random.choices(TRIPLES, k=3) if "_:" not in line)


@pytest.mark.parametrize("limit", [100_000, 3])
@pytest.mark.parametrize("large", [1024 * 1024, 100])
@pytest.mark.parametrize("seed", range(3))
def test_a_triple_of_several_graphs_is_found_once(
    monkeypatch: pytest.MonkeyPatch, seed: int, limit: int, large: int
) -> None:
    monkeypatch.setattr(module, "MAX_TRIPLES", limit)
    monkeypatch.setattr("rosld.server.dataset.memory_store._LARGE", large)
    random, store = Random(seed), MemoryStore()
    for _ in range(5):
        store.replace(*changes(random))
        for query in QUERIES:
            assert answer(store, query) == expected(store, query), query
