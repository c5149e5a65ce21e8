"""The difference between what was told of a graph and what it says."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from rosld.server.dataset import Edit, MemoryStore
from rosld.server.dataset.replica_state import ReplicaState

G = "http://h/g"
LINES = st.lists(
    st.sampled_from([f'<http://h/s> <http://h/p> "{value}" .\n' for value in (1, 2, 3, "\\u2028", "\\u0085")]),
    unique=True,
)


@given(st.lists(LINES, max_size=6))
def test_differences_make_of_each_text_the_next(texts: list[list[str]]) -> None:
    told, here, there = ReplicaState(), MemoryStore(), MemoryStore()
    for lines in texts:
        here.replace({G: "".join(lines)})
        text = here.ntriples(G) or ""
        difference = told.difference(G, text)
        if difference is None:
            there.replace({G: text})
        else:
            there.replace({}, [difference])
        assert sorted((there.ntriples(G) or "").split("\n")) == sorted(text.split("\n"))


def test_what_has_blank_nodes_was_forgotten_or_is_large_is_told_whole() -> None:
    told = ReplicaState()
    line = '<http://h/s> <http://h/p> "1" .\n'
    assert told.difference(G, line) is None
    assert told.difference(G, line) == Edit(G)
    assert told.difference(G, f"_:b <http://h/p> <{G}> .\n") is None
    assert told.difference(G, line) is None
    told.forget(G)
    assert told.difference(G, line) is None
    told.clear()
    assert told.difference(G, line) is None
    assert told.difference(G, line * 5000) is None
    assert told.difference(G, line) is None


def test_what_is_remembered_is_bounded() -> None:
    told = ReplicaState()
    text = '<http://h/s> <http://h/p> "1" .\n' * 1500
    for number in range(1000):
        told.difference(f"{G}{number}", text)
    remembered = next(count for count in range(1000) if told.difference(f"{G}{999 - count}", text) is None)
    assert 0.9 < remembered * len(text) / (32 * 1024 * 1024) <= 1
