"""The contract of stores, run on each of them."""

from __future__ import annotations

import threading
import time

import pytest
from pyoxigraph import Literal, QueryBoolean, QuerySolutions, QueryTriples

from rosld.server.dataset import Edit, MemoryStore, QueryError, Store

G, H = "http://h/g", "http://h/h"
P = "<http://h/p>"


@pytest.fixture(params=["memory", "remote"])
def store(request: pytest.FixtureRequest) -> Store:
    if request.param == "memory":
        return MemoryStore()
    made: Store = request.getfixturevalue("oxigraph").store()
    return made


def ask(store: Store, pattern: str, **dataset: tuple[str, ...]) -> bool:
    found = store.query(f"ASK {{ {pattern} }}", **dataset)  # type: ignore[arg-type]
    assert isinstance(found, QueryBoolean)
    return bool(found)


def count(store: Store, pattern: str = "?s ?p ?o") -> int:
    found = store.query(f"SELECT * {{ {pattern} }}")
    assert isinstance(found, QuerySolutions)
    return len(list(found))


def test_the_default_graph_is_the_union_of_all_named_graphs(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n', H: f'<{H}> {P} "2" .\n'})
    assert count(store) == 2
    assert ask(store, f'GRAPH <{G}> {{ ?s {P} "1" }}')
    assert not ask(store, f'GRAPH <{G}> {{ ?s {P} "2" }}')


def test_replacing_forgets_what_a_graph_held_and_leaves_the_others(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n', H: f'<{H}> {P} "2" .\n'})
    store.replace({G: f'<{G}> {P} "3" .\n'})
    assert not ask(store, f'?s {P} "1"')
    assert ask(store, f'?s {P} "2"')
    assert ask(store, f'?s {P} "3"')


def test_dropping_a_graph_takes_its_name_away_and_a_graph_that_is_not_there_may_be_dropped(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n'})
    store.replace({G: None, H: None})
    assert list(store.graphs()) == []


def test_version_changes_with_the_dataset_and_only_then(store: Store) -> None:
    before = store.version
    count(store)
    store.replace({})
    assert store.version == before
    store.replace({G: f'<{G}> {P} "1" .\n'})
    assert store.version != before


def test_blank_nodes_of_one_label_in_two_graphs_stay_apart(store: Store) -> None:
    store.replace({G: f'_:b {P} "in <_:b> \\" _:b" .\n', H: f'_:b {P} "2" .\n'})
    assert count(store, f'?s {P} "2" . ?s {P} ?o') == 1
    assert ask(store, f'?s {P} "in <_:b> \\" _:b"')


def test_malformed_text_is_refused_and_changes_nothing(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n'})
    version = store.version
    with pytest.raises(ValueError, match="http://h/"):
        store.replace({G: f'<{G}> {P} "2" .\n', H: "this is no triple"})
    assert ask(store, f'?s {P} "1"')
    assert store.version == version


def test_a_name_that_is_no_iri_is_refused(store: Store) -> None:
    with pytest.raises(ValueError, match="IRI"):
        store.replace({"> } ; CLEAR ALL #": None})


def test_a_dataset_can_be_chosen_for_a_query(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n', H: f'<{H}> {P} "2" .\n'})
    assert not ask(store, f'?s {P} "2"', default_graphs=(G,))
    assert not ask(store, f'?s {P} "1"', named_graphs=(G,))
    assert ask(store, f'GRAPH ?g {{ ?s {P} "1" }}', named_graphs=(G,))
    assert not ask(store, f'GRAPH ?g {{ ?s {P} "2" }}', named_graphs=(G,))


def test_prefixes_and_base_hold_within_a_query(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n'})
    found = store.query("SELECT ?o { <g> h:p ?o }", base="http://h/", prefixes={"h": "http://h/"})
    assert isinstance(found, QuerySolutions)
    assert [row["o"] for row in found] == [Literal("1")]


def test_a_store_that_takes_functions_calls_them_and_another_refuses_them(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n'})

    def answer() -> list[object]:
        found = store.query(
            "SELECT (<http://h/twice>(?o) AS ?x) { ?s ?p ?o }",
            functions={"http://h/twice": lambda term: Literal(int(term.value) * 2)},
        )
        assert isinstance(found, QuerySolutions)
        return [row["x"] for row in found]

    if isinstance(store, MemoryStore):
        assert answer() == [Literal(2)]
    else:
        with pytest.raises(QueryError, match="functions"):
            answer()


def test_constructed_triples_come_as_triples(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n'})
    found = store.query("CONSTRUCT WHERE { ?s ?p ?o }")
    assert isinstance(found, QueryTriples)
    assert [str(triple) for triple in found] == [f'<{G}> {P} "1"']


def test_what_is_no_query_is_told_in_the_words_of_the_parser(store: Store) -> None:
    with pytest.raises(QueryError, match="1:16"):
        store.query("SELECT * ?x { }")


def test_results_are_those_of_the_moment_the_query_began(store: Store) -> None:
    store.replace({G: "".join(f'<{G}> {P} "{n}" .\n' for n in range(1000))})
    found = store.query("SELECT * { ?s ?p ?o }")
    store.replace({G: None})
    assert isinstance(found, QuerySolutions)
    assert len(list(found)) == 1000


def test_no_query_sees_a_part_of_a_replacement(store: Store) -> None:
    if isinstance(store, MemoryStore):
        return  # it belongs to one thread
    names = [f"http://h/{n}" for n in range(50)]
    store.replace({name: f'<{name}> {P} "0" .\n' for name in names})
    ended = threading.Event()

    def write() -> None:
        for turn in range(1, 60):
            store.replace({name: f'<{name}> {P} "{turn}" .\n' for name in names})
        ended.set()

    writer = threading.Thread(target=write)
    writer.start()
    seen = []
    while not ended.is_set():
        found = store.query(f"SELECT ?o (COUNT(*) AS ?n) {{ ?s {P} ?o }} GROUP BY ?o")
        assert isinstance(found, QuerySolutions)
        seen.append([(row["o"], row["n"]) for row in found])
    writer.join()
    assert seen
    assert all(len(groups) == 1 and groups[0][1] == Literal(50) for groups in seen)


def objects(store: Store, graph: str = G) -> list[str]:
    found = store.query(f"SELECT ?o {{ GRAPH <{graph}> {{ ?s ?p ?o }} }} ORDER BY ?o")
    assert isinstance(found, QuerySolutions)
    return [row["o"].value for row in found]


def test_an_edit_changes_what_it_names_and_leaves_the_rest_of_its_graph(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n<{G}> {P} "2" .\n', H: f'<{G}> {P} "2" .\n'})
    store.replace({}, [Edit(G, added=f'<{G}> {P} "3" .\n', removed=f'<{G}> {P} "2" .\n<{G}> {P} "none" .\n')])
    assert objects(store) == ["1", "3"]
    assert objects(store, H) == ["2"]


def test_edits_are_done_in_their_order_after_graphs_are_replaced(store: Store) -> None:
    store.replace({G: f'<{G}> {P} "1" .\n'})
    line = f'<{G}> {P} "2" .\n'
    store.replace({G: f'<{G}> {P} "3" .\n'}, [Edit(G, added=line), Edit(G, removed=line), Edit(H, added=line)])
    assert objects(store) == ["3"]
    assert objects(store, H) == ["2"]


def test_a_malformed_edit_is_refused_and_changes_nothing(store: Store) -> None:
    version = store.version
    with pytest.raises(ValueError, match=H):
        store.replace({G: f'<{G}> {P} "1" .\n'}, [Edit(H, added="this is no triple")])
    assert list(store.graphs()) == []
    assert store.version == version


def test_very_many_new_graphs_come_all_at_once_their_blank_nodes_apart(store: Store) -> None:
    names = [f"http://h/{number}" for number in range(3000)]
    graphs: dict[str, str | None] = {name: f'<{name}> {P} _:b .\n_:b {P} "{"x" * 400} _:b" .\n' for name in names}
    store.replace({**graphs, "http://h/none": None}, [Edit(names[7], added=f'<{names[7]}> {P} "more" .\n')])
    assert len(store.graphs()) == 3000
    assert count(store) == 6001
    assert count(store, f"?s {P} ?b . ?b {P} ?o") == 3000
    with pytest.raises(ValueError, match="http://h/"):
        store.replace(
            {name + "/": text and text + ("no" if name == names[2999] else "") for name, text in graphs.items()}
        )
    assert count(store) == 6001


def test_a_graph_that_is_replaced_very_often_stays_as_quick() -> None:
    store = MemoryStore()
    text = "".join(f'<{G}> <http://h/p{number}> "VALUE {number}" .\n' for number in range(20))

    def seconds(turns: range) -> float:
        best = float("inf")
        for turn in turns:
            store.replace({G: text.replace("VALUE", str(turn))})
            begun = time.perf_counter()
            assert len(objects(store)) == 20
            best = min(best, time.perf_counter() - begun)
        return best

    first = seconds(range(20))
    for turn in range(20, 3000):
        store.replace({G: text.replace("VALUE", str(turn))})
    assert seconds(range(3000, 3200)) < 5 * first + 0.001
    assert objects(store)[0] == "3199 0"


def test_what_is_replaced_while_a_store_renews_itself_is_in_the_new_one() -> None:
    store = MemoryStore()
    others = {f"http://h/{number}": f'<{G}> {P} _:b .\n_:b {P} "{number}" .\n' for number in range(3000)}
    store.replace(others)
    inner = store.dataset
    turn = 0
    while store.dataset is inner or turn < 500:
        turn += 1
        line = f'<{G}> {P} "{turn}" .\n'
        before = f'<{G}> {P} "{turn - 1}" .\n'
        store.replace({H: line * 5}, [Edit(G, added=line, removed=before)])
        assert turn < 100_000
    assert objects(store) == objects(store, H) == [str(turn)]
    assert len(store.graphs()) == 3002
    assert count(store, f"?s {P} ?b . ?b {P} ?o") == 3000
