"""What concerns a store behind an endpoint alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from pyoxigraph import BlankNode, QueryBoolean, QuerySolutions, QueryTriples

from rosld.server.dataset import Edit

if TYPE_CHECKING:
    from tests.server.dataset.conftest import Oxigraph

G, H = "http://h/g", "http://h/h"
P = "<http://h/p>"


def test_text_cannot_leave_its_graph(oxigraph: Oxigraph) -> None:
    store = oxigraph.store()
    store.replace({H: f'<{H}> {P} "1" .\n'})
    hostile = f'<{G}> {P} "1" . }} }}; DROP ALL; INSERT DATA {{ GRAPH <{G}> {{ <{G}> {P} "2" .\n'
    for graphs, edits in (({G: hostile}, []), ({}, [Edit(G, added=hostile)]), ({}, [Edit(G, removed=hostile)])):
        with pytest.raises(ValueError, match=G):
            store.replace(graphs, edits)
    assert oxigraph.graphs() == {H}


def test_graphs_are_found_by_what_they_begin_with(oxigraph: Oxigraph) -> None:
    store = oxigraph.store()
    store.replace({G: f'<{G}> {P} "1" .\n', "http://i/g": f'<{G}> {P} "1" .\n'})
    assert store.graphs_with_prefix("http://h/") == [G]
    assert store.graphs_with_prefix('http://h/"\\') == []
    assert set(store.graphs()) == {G, "http://i/g"}


def test_every_form_of_query_comes_back_as_from_a_store_here(oxigraph: Oxigraph) -> None:
    store = oxigraph.store()
    store.replace({G: f'<{G}> {P} _:b .\n_:b {P} "1"@en .\n'})
    asked = store.query("ASK {}")
    assert isinstance(asked, QueryBoolean)
    assert bool(asked)
    selected = store.query("SELECT ?o { ?s ?p ?o FILTER isBlank(?o) }")
    assert isinstance(selected, QuerySolutions)
    assert [type(row["o"]) for row in selected] == [BlankNode]
    described = store.query(f"DESCRIBE <{G}>")
    assert isinstance(described, QueryTriples)
    assert len(list(described)) >= 1
