"""What waits to be told brings any store to what the dataset holds, whatever fails in between."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.server.dataset import Edit
from rosld.server.dataset.pending_changes import PendingChanges

GRAPHS = ("http://h/a", "http://h/b")
LINES = tuple(f'<http://h/s> <http://h/p> "{number}" .\n' for number in range(3))
STEPS = st.one_of(
    st.tuples(st.just("replace"), st.sampled_from(GRAPHS), st.frozensets(st.sampled_from(LINES))),
    st.tuples(st.just("add"), st.sampled_from(GRAPHS), st.sampled_from(LINES)),
    st.tuples(st.just("remove"), st.sampled_from(GRAPHS), st.sampled_from(LINES)),
    st.tuples(st.sampled_from(["tell", "fail", "fail after it was carried out"]), st.just(""), st.just("")),
)


@given(st.lists(STEPS, max_size=40), st.integers(1, 2))
def test_whatever_fails_the_other_store_ends_up_the_same(
    steps: list[tuple[str, str, str | frozenset[str]]], limit: int
) -> None:
    here: dict[str, set[str]] = {graph: set() for graph in GRAPHS}
    there: dict[str, set[str]] = {graph: set() for graph in GRAPHS}
    pending = PendingChanges()

    def tell(kind: str) -> None:
        taken = pending.take(limit)
        if taken is None:
            return
        if kind != "fail":
            for graph, edits in taken.entries.items():
                if edits is None:
                    there[graph] = set(here[graph])
                for edit in edits or ():
                    there[graph] -= {edit.removed}
                    there[graph] |= {edit.added} - {""}
        if kind != "tell":
            pending.give_back(taken)

    for kind, graph, value in steps:
        if kind == "replace":
            here[graph] = set(value)
            pending.add([graph])
        elif kind == "add":
            here[graph].add(str(value))
            pending.add((), [Edit(graph, added=str(value))])
        elif kind == "remove":
            here[graph].discard(str(value))
            pending.add((), [Edit(graph, removed=str(value))])
        else:
            tell(kind)
    assert len(pending) <= len(GRAPHS)
    while pending.since is not None:
        tell("tell")
    assert there == here
    assert len(pending) == 0


def test_edits_that_come_to_more_than_may_wait_become_the_whole_graph() -> None:
    pending = PendingChanges()
    for _ in range(100):
        pending.add((), [Edit(GRAPHS[0], added="x" * 10_000), Edit(GRAPHS[1], added="y")])
    taken = pending.take(10)
    assert taken is not None
    assert taken.entries[GRAPHS[0]] is None
    assert taken.entries[GRAPHS[1]] == (Edit(GRAPHS[1], added="y"),) * 100


def test_where_more_graphs_wait_than_may_all_are_forgotten_and_that_is_told() -> None:
    pending = PendingChanges(limit=10)
    for number in range(1000):
        pending.add([f"http://h/{number}"])
        assert len(pending) <= 10
    assert pending.overflowed
    pending.clear()
    pending.replace_all([f"http://h/{number}" for number in range(1000)])
    pending.add(["http://h/more"])
    assert not pending.overflowed
    assert len(pending) == 1001


def test_since_is_the_oldest_change_that_waits_until_it_is_told() -> None:
    pending = PendingChanges()
    assert pending.since is None
    pending.add([GRAPHS[0]])
    since = pending.since
    pending.add([GRAPHS[1]])
    assert pending.since == since
    taken = pending.take(10)
    assert taken is not None
    assert taken.since == since
    assert pending.since is None
    pending.add([GRAPHS[1]])
    pending.give_back(taken)
    assert pending.since == since
