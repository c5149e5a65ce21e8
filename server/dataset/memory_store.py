"""The store on pyoxigraph, in memory, for one thread."""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from typing import NamedTuple

from pyoxigraph import BlankNode, DefaultGraph, NamedNode, Quad, RdfFormat, Store, Triple, parse

from rosld.server.dataset.base import AggregateFunction, Edit, Function, QueryError, Results
from rosld.server.dataset.encoding import decode_ntriples, decode_triple, encode_ntriples
from rosld.server.dataset.private_functions import FUNCTIONS
from rosld.server.runtime.process_memory import trim

_LARGE = 1024 * 1024
"""Minimum characters of a text that is parsed twice rather than held as quads, which take ten times its memory."""
_MAX_CACHED_GRAPH = 8 * 1024 * 1024
"""Maximum characters of a graph whose lines are remembered, so that its next replacement costs only the difference."""
_MAX_CACHED = 32 * 1024 * 1024
"""Maximum characters of all remembered graphs; the least recently replaced one is forgotten first."""
_SLICE = 1000
"""Number of quads added or copied at a time: about two milliseconds."""
_FREE = 4000
"""Number of triples below which the size of a store does not matter."""
_STEPS = 32
"""Number of skipped removed triples (65 ns in each of two graphs) that cost as much as copying a triple (4 us)."""
_MAX_GARBAGE_RATIO = 4
"""Maximum number of removed triples in memory for each present one."""
_DEFAULT = DefaultGraph()
_LABEL = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:(?![a-f][0-9a-f]{23,31}(?:[\s.]|$))')
"""Start of a blank node label that may stand for another node in another graph.

Random labels (hexadecimal numbers of 128 bits) stand for the same node in all graphs: this is how a copy of a graph
shares its blank nodes with it.
"""


class _Step(NamedTuple):
    """A checked change of a graph; `removed_count` and `added_count` are approximate numbers of triples.

    Triples are quads of the default graph, as the parser returns them, which saves a conversion.
    """

    graph: NamedNode
    drop: bool
    removed: Sequence[Quad]
    added: Callable[[], Iterable[Quad]]
    removed_count: int
    added_count: int


class _Write(NamedTuple):
    """A change of a graph in the store: drop it, remove quads, add quads."""

    graph: NamedNode | DefaultGraph
    drop: bool = False
    removed: Sequence[Quad] = ()
    added: Sequence[Quad] = ()


class MemoryStore:
    """A dataset in memory. It copies itself, in slices, when removed triples use too much of it.

    The default graph contains each triple of the named graphs once (SPARQL 1.1 Query, 13.1): Oxigraph's own union
    repeats a triple for each graph (https://github.com/oxigraph/oxigraph/issues/1919).

    Replacing a graph changes only the lines that differ. Blank nodes keep their labels within a graph, so that edits
    can name them.
    """

    def __init__(self) -> None:
        self._store = Store()
        self._garbage = GarbageEstimate()
        self._shared: dict[Quad, int] = {}
        """Number of graphs of each triple that is in more than one graph."""
        self._lines: dict[str, frozenset[str]] = {}
        self._new_lines: dict[str, frozenset[str]] = {}
        self._size = 0
        self._numbers: dict[str, int] = {}
        self._renewal: _Renewal | None = None
        self._is_renewed = True
        self._functions: tuple[Mapping[str, Function] | None, dict[NamedNode, Function]] = (None, {})
        self.is_modified = False
        """Whether the store was changed for a single task, after which it must be discarded."""

    @property
    def is_mostly_garbage(self) -> bool:
        """Whether a new store with the same graphs would take less than half the memory."""
        return self._garbage.is_mostly_garbage

    def add(self, quad: Quad) -> None:
        """Add a quad, as stored, for a single task."""
        self._add(self._mark_changed(quad), [Quad(*quad.triple)])

    def remove(self, quad: Quad) -> None:
        """Remove a quad, as stored, for a single task."""
        self._remove(self._mark_changed(quad), [Quad(*quad.triple)])

    def _mark_changed(self, quad: Quad) -> NamedNode:
        """Mark the store as changed for a single task; return the quad's graph."""
        graph = quad.graph_name
        assert isinstance(graph, NamedNode)
        self.is_modified = True
        self._forget(graph.value)
        return graph

    def graphs(self) -> Collection[str]:
        """Return the IRIs of all named graphs."""
        return [graph.value for graph in self._store.named_graphs() if isinstance(graph, NamedNode)]

    def replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        """Replace each graph by its N-Triples, or drop it (None), then apply the edits in order.

        Labels of blank nodes are local to one text. Raises ValueError, with nothing changed, for invalid N-Triples or
        an invalid IRI.
        """
        if not graphs and not edits:
            return
        self._new_lines.clear()
        steps = [*(self._replacement(*each) for each in graphs.items()), *map(self._edit, edits)]
        for step in steps:
            self._apply_step(step)
        for name, text in graphs.items():
            self._remember(name, text)
        for edit in edits:
            self._forget(edit.graph)
        if self._garbage.is_due and self._renewal is None and self._is_renewed:
            self._renewal = _Renewal(self._store)
        self.compact_step()

    def replace_valid(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> list[tuple[str, str]]:
        """Apply changes like `replace`, but skip graphs that cannot be stored; return these, with the reasons."""
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
        """Copy a slice to the new store; return whether more must be copied."""
        if self._renewal is None or not self._is_renewed:
            return False
        if self._renewal.advance():
            return True
        self._store, self._renewal = self._renewal.store, None
        self._garbage.reset()
        trim()
        return False

    def keep_garbage(self) -> None:
        """Disable compaction: a worker is too short-lived for it."""
        self._is_renewed = False

    def ntriples(self, graph: str) -> str | None:
        """Return the contents of a graph, or None if it does not exist."""
        node, store = NamedNode(graph), self._store
        if not store.contains_named_graph(node):
            return None
        dump = store.dump(format=RdfFormat.N_TRIPLES, from_graph=node)
        assert dump is not None
        return decode_ntriples(dump).decode()

    def count(self, graph: str, limit: int) -> int:
        """Return the number of triples of a graph, at most `limit`."""
        lines = self._lines.get(graph)
        if lines is not None:
            return min(len(lines), limit)
        return sum(1 for _ in islice(self._quads(graph), limit))

    def triples(self, graph: str) -> Sequence[Triple] | None:
        """Return the triples of a graph, or None if it is empty."""
        lines = self._lines.get(graph)
        if lines is None:
            return [decode_triple(quad.triple) for quad in self._quads(graph)] or None
        text = self._label(graph, "\n".join(lines))
        return [quad.triple for quad in parse(text.encode(), RdfFormat.N_TRIPLES)]

    def _quads(self, graph: str) -> Iterator[Quad]:
        """Return the quads of a graph. Slow for a graph that is replaced often: its `_lines` are read faster."""
        return self._store.quads_for_pattern(None, None, None, NamedNode(graph))

    def query(
        self,
        text: str,
        *,
        base: str | None = None,
        prefixes: Mapping[str, str] = {},
        functions: Mapping[str, Function] = {},
        default_graphs: Sequence[str] = (),
        named_graphs: Sequence[str] = (),
        past: bytes | None = None,
        stored_past: bytes = b"",
        aggregates: Mapping[str, AggregateFunction] = {},
    ) -> Results:
        """Start a query; results are computed as they are read. Raises QueryError.

        `default_graphs` and `named_graphs` are the dataset (SPARQL 1.1, 13.2) and override FROM in the text: with
        either given, only these graphs exist. `past` are additional N-Triples in the default graph, and
        `stored_past` those in their stored form.
        """
        source = self._store
        default: list[NamedNode | BlankNode | DefaultGraph] = [*map(NamedNode, default_graphs)]
        named: list[NamedNode | BlankNode] = [*map(NamedNode, named_graphs)]
        try:
            if len(default) > 1 or (past is not None and (default or named)):
                source, default = self._copy(default_graphs, named_graphs), [_DEFAULT]
            if past is not None:
                self.is_modified |= source is self._store
                source.load(encode_ntriples(past.decode()).encode(), RdfFormat.N_TRIPLES)
                source.load(stored_past, RdfFormat.N_TRIPLES)
            is_chosen = bool(default or named)
            return source.query(
                text,
                base_iri=base,
                prefixes=dict(prefixes),
                default_graph=default if is_chosen else None,
                named_graphs=named if is_chosen else None,
                custom_functions=self._functions_by_node(functions),
                custom_aggregate_functions={NamedNode(name): each for name, each in aggregates.items()},
            )
        except (SyntaxError, ValueError, RuntimeError) as error:
            raise QueryError(str(error)) from error

    def _copy(self, default_graphs: Iterable[str], named_graphs: Iterable[str]) -> Store:
        """Return a store of these graphs, because Oxigraph repeats a triple for each merged default graph."""
        copy = Store()
        for graph in default_graphs:
            copy.extend(Quad(*quad.triple) for quad in self._quads(graph))
        for graph in named_graphs:
            copy.extend(self._quads(graph))
        return copy

    def _functions_by_node(self, functions: Mapping[str, Function]) -> dict[NamedNode, Function]:
        """Return the functions by node. Cached for the last mapping, which is nearly always the same."""
        cached, named = self._functions
        if cached is not functions:
            merged = {**functions, **FUNCTIONS}
            named = {NamedNode(name): function for name, function in merged.items()}
            self._functions = (functions, named)
        return named

    # --- changes

    def _replacement(self, name: str, text: str | None) -> _Step:
        """Return the step that replaces a graph by a text. Raises ValueError."""
        graph = NamedNode(name)
        if not text:
            return _Step(graph, True, (), tuple, self._garbage.size(name), 0)
        before = self._lines.get(name)
        if before is None:
            return _Step(graph, True, (), self._reader(graph, text), self._garbage.size(name), text.count("\n"))
        now = self._new_lines[name] = _lines(text)
        old_lines, new_lines = before - now, now - before
        removed = [*self._read(graph, "\n".join(old_lines))]
        added = [*self._read(graph, "\n".join(new_lines))]
        return _Step(graph, False, removed, lambda: added, len(old_lines), len(new_lines))

    def _edit(self, edit: Edit) -> _Step:
        graph = NamedNode(edit.graph)
        removed = [*self._read(graph, edit.removed)]
        added = self._reader(graph, edit.added)
        return _Step(graph, False, removed, added, len(removed), edit.added.count("\n"))

    def _reader(self, graph: NamedNode, text: str) -> Callable[[], Iterable[Quad]]:
        """Return a function that reads the checked text. Raises ValueError."""
        if len(text) < _LARGE:
            quads = [*self._read(graph, text)]
            return lambda: quads
        data = self._encode(graph, text)
        deque(_parse(graph, data), maxlen=0)
        return lambda: _parse(graph, data)

    def _read(self, graph: NamedNode, text: str) -> Iterator[Quad]:
        return _parse(graph, self._encode(graph, text)) if text else iter(())

    def _encode(self, graph: NamedNode, text: str) -> bytes:
        """Return N-Triples in their stored form. Raises ValueError."""
        try:
            return encode_ntriples(self._label(graph.value, text)).encode()
        except UnicodeEncodeError as error:
            raise ValueError(f"no N-Triples for {graph.value!r}: {error}") from error

    def _label(self, graph: str, text: str) -> str:
        """Return N-Triples with the labels that their blank nodes have in the store."""
        if "_:" not in text:
            return text
        label = f"_:g{self._numbers.setdefault(graph, len(self._numbers))}-"
        return _LABEL.sub(lambda match: label if match[0] == "_:" else match[0], text)

    def _apply_step(self, step: _Step) -> None:
        graph = step.graph
        if step.drop:
            self._remove(graph, [Quad(*quad.triple) for quad in self._quads(graph.value)])
            self._write(_Write(graph, True))
        self._remove(graph, step.removed)
        added = iter(step.added())
        while part := [*islice(added, _SLICE)]:
            self._add(graph, part)
        self._garbage.note(graph.value, step.removed_count, step.added_count)

    def _add(self, graph: NamedNode, triples: Iterable[Quad]) -> None:
        added: list[Quad] = []
        new: list[Quad] = []
        shared: set[Quad] = set()
        for triple in triples:
            subject, predicate, object, _ = triple
            quad = Quad(subject, predicate, object, graph)
            if triple not in self._store:
                new.append(triple)
            elif quad not in self._store:
                shared.add(triple)
            added.append(quad)
        for triple in shared:
            self._shared[triple] = self._shared.get(triple, 1) + 1
        self._write(_Write(graph, added=added))
        self._write(_Write(_DEFAULT, added=new))

    def _remove(self, graph: NamedNode, triples: Iterable[Quad]) -> None:
        """Remove triples from a graph, and from the default graph those that no other graph has."""
        removed: list[Quad] = []
        unshared: list[Quad] = []
        for triple in dict.fromkeys(triples):
            subject, predicate, object, _ = triple
            quad = Quad(subject, predicate, object, graph)
            if quad not in self._store:
                continue
            removed.append(quad)
            number = self._shared.pop(triple, 1)
            if number > 2:
                self._shared[triple] = number - 1
            elif number == 1:
                unshared.append(triple)
        self._write(_Write(graph, removed=removed))
        self._write(_Write(_DEFAULT, removed=unshared))

    def _write(self, write: _Write) -> None:
        _apply(self._store, write)
        if self._renewal is not None and self._is_renewed:
            self._renewal.note(write)

    def _remember(self, name: str, text: str | None) -> None:
        self._forget(name)
        if not text or len(text) > _MAX_CACHED_GRAPH:
            return
        lines = self._lines[name] = self._new_lines.pop(name, frozenset()) or _lines(text)
        self._size += sum(map(len, lines))
        while self._size > _MAX_CACHED:
            self._forget(next(iter(self._lines)))

    def _forget(self, name: str) -> None:
        self._size -= sum(map(len, self._lines.pop(name, ())))


class _Renewal:
    """A copy of a store, made in slices while that store changes."""

    def __init__(self, old: Store) -> None:
        self.store = Store()
        self._old = old
        named = (graph for graph in old.named_graphs() if isinstance(graph, NamedNode))
        self._left: dict[NamedNode | DefaultGraph, None] = dict.fromkeys((*named, _DEFAULT))
        self._copied: Iterator[Quad] | None = None
        self._later: list[_Write] = []

    def advance(self) -> bool:
        """Copy a slice; return whether more must be copied."""
        copied = 0
        while self._left and copied < _SLICE:
            graph = next(iter(self._left))
            if self._copied is None:  # the iterator sees the graph as it is now, despite later changes
                self._copied = self._old.quads_for_pattern(None, None, None, graph)
                if isinstance(graph, NamedNode) and self._old.contains_named_graph(graph):
                    self.store.add_graph(graph)
            part = [*islice(self._copied, _SLICE)]
            self.store.extend(part)
            copied += len(part) + 1
            if len(part) < _SLICE:
                for write in self._later:
                    _apply(self.store, write)
                self._later.clear()
                self._copied = None
                del self._left[graph]
        return bool(self._left)

    def note(self, write: _Write) -> None:
        """Apply a change of the old store to the copy."""
        if write.graph not in self._left:
            _apply(self.store, write)
        elif self._copied is not None and write.graph == next(iter(self._left)):
            self._later.append(write)


def _apply(store: Store, write: _Write) -> None:
    if write.drop:
        store.remove_graph(write.graph)
    for quad in write.removed:
        store.remove(quad)
    if write.added:
        store.extend(write.added)


def _parse(graph: NamedNode, data: bytes) -> Iterator[Quad]:
    """Yield the triples of N-Triples, in the default graph. Raises ValueError."""
    try:
        yield from parse(data, RdfFormat.N_TRIPLES)
    except SyntaxError as error:
        raise ValueError(f"no N-Triples for {graph.value!r}: {error}") from error


def _lines(text: str) -> frozenset[str]:
    """Return the lines. Only a line feed ends one (RDF 1.1 N-Triples, 2), unlike for `str.splitlines`."""
    return frozenset(text.split("\n")) - {""}


class GarbageEstimate:
    """Estimate of the memory that a store still holds for removed triples, in lines of N-Triples.

    Oxigraph frees nothing in memory. A removed triple stays in the lists of its graph, its subject and so on, and every
    lookup walks past it: a graph that was replaced ten thousand times takes milliseconds to read. The only remedy is a
    new store, which costs as much as everything in it.
    """

    def __init__(self) -> None:
        self._sizes: dict[str, int] = {}
        self._removed_by_graph: Counter[str] = Counter()
        self._size = 0
        self._removed = 0
        self._skipped = 0

    @property
    def is_due(self) -> bool:
        """Whether skipping removed triples has cost as much as a new store, or they take too much memory."""
        size = max(self._size, _FREE)
        return self._skipped > _STEPS * size or self._removed > _MAX_GARBAGE_RATIO * size

    @property
    def is_mostly_garbage(self) -> bool:
        """Whether a new store would take less than half the memory."""
        return self._removed > max(self._size, _FREE)

    def size(self, graph: str) -> int:
        """Return the number of lines of a graph."""
        return self._sizes.get(graph, 0)

    def note(self, graph: str, removed: int, added: int) -> None:
        """Count the lines that a graph lost and gained."""
        self._sizes[graph] = max(0, self.size(graph) + added - removed)
        if not self._sizes[graph]:
            del self._sizes[graph]
        self._size += added - removed
        if removed:
            self._removed_by_graph[graph] += removed
            self._removed += removed
            self._skipped += self._removed_by_graph[graph]

    def reset(self) -> None:
        """Reset after compaction."""
        self._removed_by_graph.clear()
        self._removed = self._skipped = 0
