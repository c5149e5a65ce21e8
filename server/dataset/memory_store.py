"""The store on pyoxigraph, in memory, for one thread."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import count, islice
from typing import NamedTuple, cast

from pyoxigraph import BlankNode, DefaultGraph, Literal, NamedNode, Quad, RdfFormat, Store, Triple, parse

from rosld.server.dataset.base import Edit, Function, QueryError, Results, Term
from rosld.server.dataset.encoding import decode_ntriples, decode_triple, encode_ntriples, encode_triple
from rosld.server.dataset.garbage_estimate import GarbageEstimate
from rosld.server.dataset.private_functions import FUNCTIONS
from rosld.server.dataset.shared_triples import Lookup, SharedTriples, may_share
from rosld.server.runtime.process_memory import trim

_LARGE = 1024 * 1024
"""Characters from which on a text is read twice rather than held as quads, which take ten times its memory.

Without blank nodes, which it would rename, the store reads it the second time: in a third of the time.
"""
_REMEMBERED_GRAPH = 8 * 1024 * 1024
"""Characters of a graph whose lines are remembered, so that the next text of it costs what differs."""
_REMEMBERED = 32 * 1024 * 1024
"""Characters of all graphs that are remembered; the one that was replaced longest ago goes first."""
_SLICE = 1000
"""Quads copied at a time to a new store: about two milliseconds."""
_LABEL = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:(?![a-f][0-9a-f]{23,31}(?:[\s.]|$))')
"""Where a label begins that other graphs may have for other nodes.

Those drawn at random, as hexadecimal numbers of 128 bits, stand for one node in all graphs: that is how a copy of a
graph shares its blank nodes with it.
"""


class _Step(NamedTuple):
    """What is done to one graph: it is dropped, then some quads go, then others come."""

    graph: NamedNode
    drop: bool
    removed: Sequence[Quad]
    added: Callable[[], Iterable[Quad]]
    lost: int
    gained: int
    text: bytes | None = None
    """What is added, where the store can read it itself."""


class MemoryStore:
    """The built-in `Store`. It copies itself, in slices, whenever it holds too much for triples that were removed.

    A graph that is replaced is changed by the lines that differ. Blank nodes keep their labels within a graph, so that
    edits may name them.
    """

    def __init__(self) -> None:
        self._store = Store()
        self._versions = count(1)
        self._version = 0
        self._wear = GarbageEstimate()
        self._shared = SharedTriples()
        self._lines: dict[str, frozenset[str]] = {}
        self._new_lines: dict[str, frozenset[str]] = {}
        self._size = 0
        self._numbers: dict[str, int] = {}
        self._renewal: _Renewal | None = None
        self._functions: tuple[Mapping[str, Function] | None, dict[NamedNode, Function]] = (None, {})

    @property
    def version(self) -> int:
        return self._version

    @property
    def is_mostly_garbage(self) -> bool:
        """Whether the same graphs in a new store would take less than half the memory."""
        return self._wear.is_mostly_garbage

    @property
    def dataset(self) -> Store:
        """The dataset itself. Whoever changes it must be a process that ends afterwards."""
        self._shared.give_up()
        return self._store

    def may_repeat(self, lookups: Iterable[Lookup]) -> bool:
        """Whether patterns of the default graph may match a triple that several graphs have, once for each."""
        return self._shared.may_match(lookups)

    def merge(self, default_graphs: Sequence[str], *, keep_names: bool) -> bool:
        """Have the union of these graphs (none: of all) be a set for the next query; whether it is `is_merged`.

        `keep_names`: what is told of named graphs is as before. Whoever calls this must be a process that ends
        afterwards.
        """
        store = self._store
        if not keep_names and not default_graphs and self._shared.is_known:
            for quad in [*self._shared.copies(store)]:
                store.remove(quad)
            return False
        store.remove_graph(DefaultGraph())
        for graph in [*map(NamedNode, default_graphs)] or (None,):
            store.extend(Quad(*quad.triple) for quad in store.quads_for_pattern(None, None, None, graph))
        return True

    def add_past(self, text: bytes, messages: Iterable[str]) -> None:
        """Add N-Triples about recorded messages to the default graph, without what graphs of single `messages` say.

        Whoever calls this must be a process that ends afterwards. Raises ValueError.
        """
        store = self._store
        try:
            store.load(encode_ntriples(text.decode()).encode(), RdfFormat.N_TRIPLES)
        except SyntaxError as error:
            raise ValueError(f"no N-Triples about the past: {error}") from error
        for message in messages:
            for quad in [*store.quads_for_pattern(None, None, None, NamedNode(message))]:
                store.remove(Quad(*quad.triple))

    def lookup(self, subject: Term | None, predicate: NamedNode | None, object: Term | None, limit: int) -> list[Quad]:
        """At most so many statements with this subject, predicate and object."""
        place = cast("NamedNode | None", subject)
        return [*islice(self._store.quads_for_pattern(place, predicate, object, None), limit)]

    def graphs(self) -> Collection[str]:
        return [graph.value for graph in self._store.named_graphs() if isinstance(graph, NamedNode)]

    def replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        if not graphs and not edits:
            return
        self._new_lines.clear()
        steps = [*(self._replacement(*each) for each in graphs.items()), *map(self._edit, edits)]
        for step in steps:
            self._carry_out(step)
        for name, text in graphs.items():
            self._remember(name, text)
        for edit in edits:
            self._forget(edit.graph)
        self._version = next(self._versions)
        if self._wear.is_due and self._renewal is None:
            self._renewal = _Renewal(self._store)
        self.compact_step()

    def replace_valid(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> list[tuple[str, str]]:
        """As `replace`, but a graph that cannot be stored hides no other: it is left out. These graphs, and why."""
        try:
            self.replace(graphs, edits)
        except ValueError:
            return [*self._replace_one_by_one(graphs, edits)]
        return []

    def _replace_one_by_one(self, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> Iterator[tuple[str, str]]:
        for name, text in graphs.items():
            try:
                self.replace({name: text})
            except ValueError as error:
                with suppress(ValueError):
                    self.replace({name: None})
                yield name, str(error)
        for edit in edits:
            try:
                self.replace({}, [edit])
            except ValueError as error:
                yield edit.graph, str(error)

    def compact_step(self) -> bool:
        """Copy a slice of this store to the one that takes its place; whether there is more to copy."""
        if self._renewal is None:
            return False
        if self._renewal.advance():
            return True
        self._store, self._renewal = self._renewal.store, None
        self._wear.reset()
        trim()
        return False

    def ntriples(self, graph: str) -> str | None:
        """What a graph holds now, None where there is none of that name."""
        node, store = NamedNode(graph), self._store
        if not store.contains_named_graph(node):
            return None
        held = store.dump(format=RdfFormat.N_TRIPLES, from_graph=node)
        assert held is not None
        return decode_ntriples(held).decode()

    def count(self, graph: str, limit: int) -> int:
        """The number of triples of a graph, at most so many."""
        lines = self._lines.get(graph)
        if lines is not None:
            return min(len(lines), limit)
        return sum(1 for _ in islice(self._quads(graph), limit))

    def triples(self, graph: str) -> Sequence[Triple] | None:
        """The triples of a graph, None where it has none."""
        lines = self._lines.get(graph)
        if lines is None:
            return [decode_triple(quad.triple) for quad in self._quads(graph)] or None
        text = self._label(graph, "\n".join(lines))
        return [quad.triple for quad in parse(text.encode(), RdfFormat.N_TRIPLES)]

    def contains(self, graph: str, triple: Triple) -> bool:
        """Whether a graph has a triple, spelt as it is."""
        stored = encode_triple(triple)
        return Quad(stored.subject, stored.predicate, stored.object, NamedNode(graph)) in self._store

    def _quads(self, graph: str) -> Iterator[Quad]:
        """Found by walking past all that are gone: the lines of a graph that was replaced often are read faster."""
        return self._store.quads_for_pattern(None, None, None, NamedNode(graph))

    def extent(self, graph: NamedNode, limit: int) -> tuple[int, int]:
        """The number of triples of a graph, at most so many, and about the characters of their literals."""
        lines = self._lines.get(graph.value)
        if lines is not None:
            return len(lines), sum(len(line) - start for line in lines if (start := line.find('"')) >= 0)
        quads = [*islice(self._quads(graph.value), limit)]
        return len(quads), sum(len(quad.object.value) for quad in quads if isinstance(quad.object, Literal))

    def query(
        self,
        text: str,
        *,
        base: str | None = None,
        prefixes: Mapping[str, str] = {},
        functions: Mapping[str, Function] = {},
        default_graphs: Sequence[str] = (),
        named_graphs: Sequence[str] = (),
        is_merged: bool = False,
        has_past: bool = False,
    ) -> Results:
        chosen = bool(default_graphs or named_graphs)
        default: list[NamedNode | BlankNode | DefaultGraph] = [*map(NamedNode, default_graphs)]
        if is_merged:
            default = [DefaultGraph()]
        elif has_past:
            default.append(DefaultGraph())
        try:
            return self._store.query(
                text,
                base_iri=base,
                prefixes=dict(prefixes),
                use_default_graph_as_union=not chosen and not is_merged,
                default_graph=default if chosen else None,
                named_graphs=[*map(NamedNode, named_graphs)] if chosen else None,
                custom_functions=self._functions_by_node(functions),
            )
        except (SyntaxError, ValueError, RuntimeError) as error:
            raise QueryError(str(error)) from error

    def _functions_by_node(self, functions: Mapping[str, Function]) -> dict[NamedNode, Function]:
        """The functions by node; the last mapping asked for is kept, as it is nearly always the same."""
        known, named = self._functions
        if known is not functions:
            both = {**functions, **FUNCTIONS}
            named = {NamedNode(name): function for name, function in both.items()}
            self._functions = (functions, named)
        return named

    # --- changes

    def _replacement(self, name: str, text: str | None) -> _Step:
        """What makes a graph say what a text says. Raises ValueError."""
        graph = NamedNode(name)
        if not text:
            return _Step(graph, True, (), tuple, self._wear.size(name), 0)
        before = self._lines.get(name)
        if before is None:
            added, data = self._reader(graph, text)
            return _Step(graph, True, (), added, self._wear.size(name), text.count("\n"), data)
        now = self._new_lines[name] = _lines(text)
        gone, come = before - now, now - before
        removed = [*self._read(graph, "\n".join(gone))]
        quads = [*self._read(graph, "\n".join(come))]
        return _Step(graph, False, removed, lambda: quads, len(gone), len(come))

    def _edit(self, edit: Edit) -> _Step:
        """Raises ValueError."""
        graph = NamedNode(edit.graph)
        removed = [*self._read(graph, edit.removed)]
        added, data = self._reader(graph, edit.added)
        return _Step(graph, False, removed, added, len(removed), edit.added.count("\n"), data)

    def _reader(self, graph: NamedNode, text: str) -> tuple[Callable[[], Iterable[Quad]], bytes | None]:
        """What reads a text that has been checked, and what the store may read itself. Raises ValueError."""
        if len(text) < _LARGE:
            quads = [*self._read(graph, text)]
            return lambda: quads, None
        data = self._encode(graph, text)
        deque(_parse(graph, data), maxlen=0)
        return lambda: _quads(graph, data), None if "_:" in text else data

    def _read(self, graph: NamedNode, text: str) -> Iterator[Quad]:
        """The quads of N-Triples within a graph. Raises ValueError."""
        return _quads(graph, self._encode(graph, text)) if text else iter(())

    def _encode(self, graph: NamedNode, text: str) -> bytes:
        """N-Triples as they are stored. Raises ValueError."""
        try:
            return encode_ntriples(self._label(graph.value, text)).encode()
        except UnicodeEncodeError as error:
            raise ValueError(f"no N-Triples for {graph.value!r}: {error}") from error

    def _label(self, graph: str, text: str) -> str:
        """N-Triples with the labels that blank nodes have in the store."""
        if "_:" not in text:
            return text
        label = f"_:g{self._numbers.setdefault(graph, len(self._numbers))}-"
        return _LABEL.sub(lambda match: label if match[0] == "_:" else match[0], text)

    def _carry_out(self, step: _Step) -> None:
        shared, store = self._shared, self._store
        if step.drop:
            shared.drop(step.graph, store)
        shared.remove(step.removed, store)
        _take(store, step)
        if step.text is None or may_share(step.text, store):
            shared.add(step.added(), store, is_new=step.drop)
        _give(store, step)
        self._wear.note(step.graph.value, step.lost, step.gained)
        if self._renewal is not None:
            self._renewal.note(step)

    def _remember(self, name: str, text: str | None) -> None:
        self._forget(name)
        if not text or len(text) > _REMEMBERED_GRAPH:
            return
        lines = self._lines[name] = self._new_lines.pop(name, frozenset()) or _lines(text)
        self._size += sum(map(len, lines))
        while self._size > _REMEMBERED:
            self._forget(next(iter(self._lines)))

    def _forget(self, name: str) -> None:
        self._size -= sum(map(len, self._lines.pop(name, ())))


class _Renewal:
    """A copy of a store, made in slices while that store changes."""

    def __init__(self, old: Store) -> None:
        self.store = Store()
        self._old = old
        self._left = dict.fromkeys(graph for graph in old.named_graphs() if isinstance(graph, NamedNode))
        self._copied: Iterator[Quad] | None = None
        self._later: list[_Step] = []

    def advance(self) -> bool:
        """Copy a slice; whether there is more."""
        copied = 0
        while self._left and copied < _SLICE:
            graph = next(iter(self._left))
            if self._copied is None:  # it sees the graph as it is now, whatever changes while it is copied
                self._copied = self._old.quads_for_pattern(None, None, None, graph)
                if self._old.contains_named_graph(graph):
                    self.store.add_graph(graph)
            part = [*islice(self._copied, _SLICE)]
            self.store.extend(part)
            copied += len(part) + 1
            if len(part) < _SLICE:
                for step in self._later:
                    _apply(self.store, step)
                self._later.clear()
                self._copied = None
                del self._left[graph]
        return bool(self._left)

    def note(self, step: _Step) -> None:
        """This was done to the old store."""
        if step.graph not in self._left:
            _apply(self.store, step)
        elif self._copied is not None and step.graph == next(iter(self._left)):
            self._later.append(step)


def _apply(store: Store, step: _Step) -> None:
    _take(store, step)
    _give(store, step)


def _take(store: Store, step: _Step) -> None:
    if step.drop:
        store.remove_graph(step.graph)
    for quad in step.removed:
        store.remove(quad)


def _give(store: Store, step: _Step) -> None:
    if step.text is None:
        store.extend(step.added())
    else:
        store.load(step.text, RdfFormat.N_TRIPLES, to_graph=step.graph)


def _parse(graph: NamedNode, data: bytes) -> Iterator[Quad]:
    """The triples of N-Triples, in the default graph. Raises ValueError."""
    try:
        yield from parse(data, RdfFormat.N_TRIPLES)
    except SyntaxError as error:
        raise ValueError(f"no N-Triples for {graph.value!r}: {error}") from error


def _quads(graph: NamedNode, data: bytes) -> Iterator[Quad]:
    """The quads of N-Triples within a graph. Raises ValueError."""
    return (Quad(subject, predicate, object, graph) for subject, predicate, object, _ in _parse(graph, data))


def _lines(text: str) -> frozenset[str]:
    """Without their ends. Only a line feed ends one (RDF 1.1 N-Triples, 2): Python knows more."""
    return frozenset(text.split("\n")) - {""}
