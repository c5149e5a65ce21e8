"""The store on pyoxigraph, in memory."""

from __future__ import annotations

import ctypes
import logging
import re
import sys
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count, islice
from typing import IO, TypeAlias, cast

import pyoxigraph

from rosld.server.memory import MEMORY, resident
from rosld.server.store.base import Edit, Function, QueryError, Results, Term
from rosld.server.store.update import operations
from rosld.server.store.wear import Wear

_log = logging.getLogger("rosld.sparql")

_LARGE = 1024 * 1024
"""Characters from which on new graphs are loaded, in half the time and memory that an update takes."""
_ROUNDS = 3
"""Times that a new store takes over what changed meanwhile, each time less, before nothing may change until it has."""
_LABEL = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:')

_Change: TypeAlias = tuple[Mapping[str, str | None], Sequence[Edit]]


class MemoryStore:
    """The `Store` that rosld brings along. It renews itself whenever it is worn (`wear.py`)."""

    in_memory = True
    takes_functions = True

    def __init__(self, dataset: pyoxigraph.Store | None = None) -> None:
        self._store = pyoxigraph.Store() if dataset is None else dataset
        self._changing = threading.Lock()
        self._versions = count(1)
        self._version = 0
        self._wear = Wear()
        self._renewal: threading.Thread | None = None
        self._meanwhile: list[_Change] = []  # what changed since the renewal began
        self._told: list[Callable[[Collection[str], Sequence[Edit]], None]] = []
        self._functions: tuple[Mapping[str, Function], dict[pyoxigraph.NamedNode, Function]] = ({}, {})

    @property
    def version(self) -> int:
        return self._version

    @contextmanager
    def still(self) -> Iterator[None]:
        with self._changing:
            yield

    def lookup(
        self, subject: Term | None, predicate: pyoxigraph.NamedNode | None, object: Term | None, most: int
    ) -> Sequence[pyoxigraph.Quad]:
        """At most so many statements, of all graphs, with this subject, predicate and object (None: any)."""
        place = cast("pyoxigraph.NamedNode | None", subject)
        return [*islice(self._store.quads_for_pattern(place, predicate, object, None), most)]

    def graphs(self) -> Collection[str]:
        return [graph.value for graph in self._store.named_graphs() if isinstance(graph, pyoxigraph.NamedNode)]

    def replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        if not graphs and not edits:
            return
        try:
            self._carry_out(graphs, edits)
        except SyntaxError:
            # Most likely two texts use one label for a blank node, which one update cannot.
            try:
                self._carry_out(_relabelled(graphs), edits)
            except SyntaxError as error:
                raise ValueError(f"no N-Triples for {_first(graphs, edits)}: {error}") from error
        # Drawn after the change: a version read before a query begins is never newer than what the query sees.
        self._version = next(self._versions)
        for told in self._told:
            told(graphs, edits)

    def laid_open(self) -> pyoxigraph.Store:
        """The dataset itself, for whoever may change it: a process of its own, which takes it along when it ends."""
        return self._store

    def watch(self, told: Callable[[Collection[str], Sequence[Edit]], None]) -> None:
        """Call `told` after each change from now on, with the graphs replaced and the edits; in any thread."""
        self._told.append(told)

    def ntriples(self, graph: str) -> str | None:
        """What a graph holds now, None where there is none of that name."""
        node, store = pyoxigraph.NamedNode(graph), self._store
        if not store.contains_named_graph(node):
            return None
        held = store.dump(format=pyoxigraph.RdfFormat.N_TRIPLES, from_graph=node)
        assert held is not None
        return held.decode()

    def _carry_out(self, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> None:
        with self._changing:
            _change(self._store, graphs, edits)
            if self._renewal is not None:
                self._meanwhile.append((graphs, edits))
            self._wear.replaced(graphs, edits)
            if self._wear.worn and self._renewal is None:
                self._renewal = threading.Thread(target=self._renew, name="store-renewal", daemon=True)
                self._renewal.start()

    def _renew(self) -> None:
        """Have another store take over, with the same in it. Queries that have begun go on with the old one."""
        try:
            MEMORY.require(resident(), "a new dataset in place of one with many gaps")
            new = pyoxigraph.Store()
            new.load(self._store.dump(format=pyoxigraph.RdfFormat.N_QUADS), pyoxigraph.RdfFormat.N_QUADS)
            for _ in range(_ROUNDS):
                self._repeat(new)
            with self._changing:
                self._repeat(new)
                self._store = new
        except MemoryError as error:
            _log.warning("the dataset goes on as it is: %s", error)
        except Exception:  # what is there stays in use
            _log.exception("the dataset cannot be renewed, and goes on as it is")
        finally:
            with self._changing:
                self._wear.renewed()
                self._meanwhile.clear()
                self._renewal = None
        _give_back()

    def _repeat(self, new: pyoxigraph.Store) -> None:
        """Carry out on the new store what was done to the old. What the copy had already is done once more: no harm."""
        number = len(self._meanwhile)
        for graphs, edits in self._meanwhile[:number]:
            _change(new, graphs, edits)
        del self._meanwhile[:number]

    def query(
        self,
        text: str,
        *,
        base: str | None = None,
        prefixes: Mapping[str, str] = {},
        functions: Mapping[str, Function] = {},
        default_graphs: Sequence[str] = (),
        named_graphs: Sequence[str] = (),
    ) -> Results:
        chosen = bool(default_graphs or named_graphs)
        try:
            return self._store.query(
                text,
                base_iri=base,
                prefixes=dict(prefixes),
                use_default_graph_as_union=not chosen,
                default_graph=[*map(pyoxigraph.NamedNode, default_graphs)] if chosen else None,
                named_graphs=[*map(pyoxigraph.NamedNode, named_graphs)] if chosen else None,
                custom_functions=self._named(functions),
            )
        except (SyntaxError, ValueError, RuntimeError) as error:
            raise QueryError(str(error)) from error

    def _named(self, functions: Mapping[str, Function]) -> dict[pyoxigraph.NamedNode, Function]:
        """The functions by node; the last mapping asked for is kept, as it is nearly always the same."""
        known, named = self._functions
        if known is not functions:
            named = {pyoxigraph.NamedNode(name): function for name, function in functions.items()}
            self._functions = (functions, named)
        return named


def _give_back() -> None:
    """Let the system have the memory of what is no more.

    The allocator keeps it for the thread that asked for it, and the next store is made by another thread.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


class _Text:
    """A file to be read, of pieces that are made as they are read."""

    def __init__(self, pieces: Iterator[str]) -> None:
        self._pieces = pieces
        self._rest = b""

    def read(self, size: int) -> bytes:
        """Up to so many bytes; none at the end."""
        while len(self._rest) < size:
            found = [*islice(self._pieces, 64)]
            if not found:
                break
            self._rest += "".join(found).encode()
        taken, self._rest = self._rest[:size], self._rest[size:]
        return taken


def _change(store: pyoxigraph.Store, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> None:
    """In one transaction, which the text of one update is, and one load."""
    size = sum(len(text) for text in graphs.values() if text) + sum(len(edit.added) for edit in edits)
    if size > _LARGE and _only_adds(store, graphs, edits):
        source = cast("IO[bytes]", _Text(_blocks(_relabelled(graphs), edits)))
        store.load(source, pyoxigraph.RdfFormat.TRIG)
    else:
        store.update("\n".join(operations(graphs, edits)))


def _only_adds(store: pyoxigraph.Store, graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> bool:
    there = (store.contains_named_graph(pyoxigraph.NamedNode(name)) for name in graphs)
    return not any(edit.removed for edit in edits) and not any(there)


def _first(graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> str:
    names = [repr(name) for name in dict.fromkeys((*graphs, *(edit.graph for edit in edits)))]
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")


def _blocks(graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> Iterator[str]:
    """The same as TriG, where there is nothing but additions."""
    for name, ntriples in (*graphs.items(), *((edit.graph, edit.added) for edit in edits)):
        if ntriples:
            yield f"{pyoxigraph.NamedNode(name)}{{{ntriples}}}\n"


def _relabelled(graphs: Mapping[str, str | None]) -> dict[str, str | None]:
    """The same graphs with labels of blank nodes that no two of them share."""
    return {
        name: _with_label(text, f"_:g{at}-") if text and "_:" in text else text
        for at, (name, text) in enumerate(graphs.items())
    }


def _with_label(text: str, label: str) -> str:
    return _LABEL.sub(lambda match: label if match[0] == "_:" else match[0], text)
