"""What an update makes of one graph without a store is what it makes of it in one, or it is left to the store."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import pyoxigraph
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn
from pyoxigraph import NamedNode, Quad, RdfFormat, Triple

from rosld.server.sparql.analysis import Analyser
from rosld.server.sparql.lexer import BOUNDS
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.update.drawing import GraphChange
from rosld.server.sparql.update.operations import Modify
from rosld.server.sparql.update.reading import read_update
from rosld.server.sparql.update.sketch import sketched

BASE = "http://robot/"
GRAPH = f"{BASE}topics/cmd_vel"
XSD = "http://www.w3.org/2001/XMLSchema#"
ANALYSER = Analyser(BASE, "https://w3id.org/rosld/types/", prefixes={})


def sketch(text: str, triples: Collection[Triple]) -> Sequence[GraphChange] | None:
    """What an update comes to, None where a store must say."""
    [operation] = read_update(UpdateRequest(text), {}, BASE, BOUNDS)
    assert isinstance(operation, Modify)
    if operation.where is None:
        return sketched(operation, None, GRAPH, triples)
    analysis = ANALYSER.analyse(operation.where.query)
    return sketched(operation, analysis.plan, GRAPH, triples) if analysis.plain else None


def parsed(lines: str) -> list[Triple]:
    return [quad.triple for quad in pyoxigraph.parse(lines.encode(), RdfFormat.N_TRIPLES)]


def stored(triples: Collection[Triple]) -> pyoxigraph.Store:
    store = pyoxigraph.Store()
    store.extend(Quad(*triple, NamedNode(GRAPH)) for triple in triples)
    return store


def held(store: pyoxigraph.Store) -> set[Triple]:
    return {quad.triple for quad in store}


TWIST = parsed(
    f'<{GRAPH}#m> <urn:x> "0.5"^^<{XSD}double> .\n'
    f'<{GRAPH}#m> <urn:name> "old" .\n'
    f'<{GRAPH}#m> <urn:on> "true"^^<{XSD}boolean> .\n'
    f"<{GRAPH}#m> <urn:at> <{GRAPH}#t> .\n"
    f'<{GRAPH}#t> <urn:sec> "7"^^<{XSD}integer> .\n'
)


def around(block: str) -> str:
    return f"GRAPH <{GRAPH}> {{ {block} }}"


def data(verb: str, block: str) -> str:
    return f"{verb} DATA {{ {around(block)} }}"


def moved(deletes: str, inserts: str, where: str) -> str:
    return f"DELETE {{ {around(deletes)} }} INSERT {{ {around(inserts)} }} WHERE {{ {around(where)} }}"


@pytest.mark.parametrize(
    ("update", "gone", "come"),
    [
        (moved("?m <urn:x> ?o", "?m <urn:x> 1.5e0", "?m <urn:x> ?o"), "urn:x", "1.5e0"),
        (moved("?m <urn:name> ?o", "?m <urn:name> 'new'", "?m <urn:name> ?o"), "urn:name", "new"),
        (moved("?m <urn:on> ?o", "?m <urn:on> false", "?m <urn:on> ?o"), "urn:on", "false"),
        (moved("?t <urn:sec> ?o", "?t <urn:sec> 8", "?m <urn:at> ?t . ?t <urn:sec> ?o"), "urn:sec", "8"),
        (moved("?t <urn:sec> ?o", "?t <urn:sec> 8", "?m <urn:at>/<urn:sec> ?o . ?m <urn:at> ?t"), "urn:sec", "8"),
        (f"DELETE WHERE {{ {around('?m <urn:name> ?o')} }}", "urn:name", None),
        (data("INSERT", "<urn:a> <urn:b> 1"), None, "1"),
        (data("DELETE", f"<{GRAPH}#m> <urn:name> 'old'"), "urn:name", None),
    ],
)
def test_the_commonest_updates_need_no_store(update: str, gone: str | None, come: str | None) -> None:
    found = sketch(update, TWIST)
    assert found is not None
    [change] = found
    assert change.graph == GRAPH
    assert set(change.before or ()) == set(TWIST)
    after = set(change.after or ())
    assert [each.predicate.value for each in set(TWIST) - after] == ([gone] if gone else [])
    assert [getattr(each.object, "value", None) for each in after - set(TWIST)] == ([come] if come else [])


@pytest.mark.parametrize(
    "update",
    [
        moved("?m <urn:x> ?o", "?m <urn:x> ?o", "?m <urn:x> ?o"),
        moved("?m <urn:none> ?o", "?m <urn:none> 1", "?m <urn:none> ?o"),
        data("DELETE", "<urn:a> <urn:b> <urn:c>"),
        data("INSERT", f"<{GRAPH}#m> <urn:name> 'old'"),
    ],
)
def test_what_changes_nothing_is_no_change(update: str) -> None:
    assert sketch(update, TWIST) == ()


@pytest.mark.parametrize(
    "update",
    [
        moved("?m <urn:x> ?o", "?m <urn:x> 0.50e0", "?m <urn:x> ?o"),
        moved("?m <urn:x> ?o", "?m <urn:x> ?n", "?m <urn:x> ?o BIND(?o + 1 AS ?n)"),
        moved("?m <urn:x> ?o", "?m <urn:x> 1.0", "?m <urn:x> ?o FILTER(?o < 3)"),
        moved("?m <urn:x> ?o", "?m <urn:x> 1.0", "?m <urn:x> ?o FILTER NOT EXISTS {}"),
        moved("?m <urn:x> ?o", "?m <urn:x> 1.0", "?m <urn:x> ?o ; <urn:sec> 7"),
        moved("?m ?p ?o", "?m <urn:x> 1.0", "?m ?p ?o"),
        moved("?m <urn:x> ?o", "?m <urn:x> 1.0", "?m <urn:x> ?o OPTIONAL { ?m <urn:none> ?n }"),
        moved("?m <urn:x> ?o", "?m <urn:x> 1.0", "?m <urn:at>* ?m . ?m <urn:x> ?o"),
        moved("?m <urn:x> ?o", "?m <urn:x> 1.0", "{ SELECT * { ?m <urn:x> ?o } LIMIT 1 }"),
        f"INSERT {{ GRAPH <{GRAPH}2> {{ ?m <urn:x> ?o }} }} WHERE {{ {around('?m <urn:x> ?o')} }}",
        data("DELETE", f"<{GRAPH}#t> <urn:sec> 07"),
    ],
)
def test_what_may_come_to_something_else_is_left_to_the_store(update: str) -> None:
    assert sketch(update, TWIST) is None


def test_what_would_take_long_is_left_to_the_store() -> None:
    many = parsed("".join(f"<urn:s{each}> <urn:p> <urn:o{each}> .\n" for each in range(300)))
    assert sketch(moved("?a <urn:p> ?b", "", "?a <urn:p> ?b"), many) is None
    few = many[:100]
    assert sketch(moved("?a <urn:p> ?b", "", "?a <urn:p> ?b . ?c <urn:p> ?d"), few) is None
    assert sketch(moved("?a <urn:p> ?b", "", "?a <urn:p> ?b"), few)
    large = parsed("".join(f"<urn:s> <urn:p{each}> <urn:o> .\n" for each in range(3000)))
    assert sketch(data("INSERT", "<urn:a> <urn:b> 1"), large) is None


# As a store has it

NODES = st.sampled_from(["<urn:a>", "<urn:b>", "_:one", "_:two"])
LITERALS = st.sampled_from(
    [
        *(f'"{value}"^^<{XSD}{kind}>' for kind in ("integer", "int", "decimal", "double", "float")
          for value in ("1", "01", "2", "-0", "0", "1.0", "1e0")),
        *(f'"{value}"^^<{XSD}boolean>' for value in ("true", "false", "1", "0")),
        f'"NaN"^^<{XSD}double>', f'"INF"^^<{XSD}double>', f'"2026-11-22T10:00:00Z"^^<{XSD}dateTime>',
        f'"2026-11-22T10:00:00.0Z"^^<{XSD}dateTime>', f'"x"^^<{XSD}string>', '"x"', '"x"@en', '"x"@EN', '"1"',
        '"1"^^<urn:own>', f'"0.1"^^<{XSD}float>', f'"0.10000000149"^^<{XSD}float>', f'"9007199254740993"^^<{XSD}long>',
        f'"9007199254740992"^^<{XSD}integer>',
    ]
)  # fmt: skip
VERBS = st.sampled_from(["<urn:p>", "<urn:q>"])
GROUPS = st.sampled_from(
    [
        "?s <urn:p> ?o", "?s <urn:p> ?o ; <urn:q> ?n", "?s <urn:p> ?o . ?n <urn:q> ?o", "?s <urn:p> ?n . ?n <urn:q> ?o",
        "<urn:a> <urn:p> ?o", "?s <urn:p> <urn:b>", "?s <urn:p> ?s", "?s <urn:q>/<urn:p> ?o", "?s ^<urn:p> ?o",
        "?s <urn:p> ?o . ?n <urn:q> ?m", "[] <urn:p> ?o", "?s <urn:p> 1", "?s <urn:p> ?o , ?n", "?o <urn:p> ?o",
    ]
)  # fmt: skip


@st.composite
def graphs(draw: DrawFn) -> str:
    """N-Triples of a few statements, some of them of one value."""
    lines = [f"{draw(NODES)} {draw(VERBS)} {draw(NODES | LITERALS)} .\n" for _ in range(draw(st.integers(0, 8)))]
    return "".join(lines)


@st.composite
def updates(draw: DrawFn) -> str:
    """An update of the graph."""

    def written(*slots: st.SearchStrategy[str]) -> str:
        return " . ".join(" ".join(map(draw, slots)) for _ in range(draw(st.integers(0, 2))))

    iris = st.sampled_from(["<urn:a>", "<urn:b>"])
    if draw(st.booleans()):
        return (
            f"{draw(st.sampled_from(['INSERT', 'DELETE']))} DATA {{ {around(written(iris, VERBS, iris | LITERALS))} }}"
        )
    holes = st.sampled_from(["?s", "?o", "?n", "?none"])
    deletes, inserts = (written(iris | holes, VERBS | holes, iris | holes | LITERALS) for _ in range(2))
    return moved(deletes, inserts, draw(GROUPS))


ONE = f'<urn:a> <urn:p> "1"^^<{XSD}integer> .\n'


@given(graphs(), updates())
@settings(max_examples=1500, deadline=None)
@example(f"{ONE}{ONE.replace('1', '01')}", data("DELETE", ONE.removesuffix(" .\n")))
@example(ONE.replace("integer", "int"), moved("?s <urn:p> ?o", "?s <urn:p> 1", "?s <urn:p> ?o"))
def test_it_comes_to_what_a_store_makes_of_it(lines: str, update: str) -> None:
    triples = parsed(lines)
    found = sketch(update, triples)
    if found is None:
        return
    store = stored(triples)
    before = held(store)
    store.update(update, base_iri=BASE)
    after = triples if not found else found[0].after
    assert after is not None
    assert held(stored(after)) == held(store)
    assert (found == ()) == (held(store) == before)
