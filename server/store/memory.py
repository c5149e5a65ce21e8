"""The store on pyoxigraph: in memory, or on disk where a path is given."""

from __future__ import annotations

import re
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path

import pyoxigraph

from rosld.server.store.base import Function, QueryError, Results

_LABEL = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:')


class MemoryStore:
    """The `Store` that rosld brings along."""

    def __init__(self, path: Path | None = None) -> None:
        self._store = pyoxigraph.Store(None if path is None else str(path))
        self._in_memory = path is None
        self._changing = threading.Lock()
        self._versions = count(1)
        self._version = 0
        self._functions: tuple[Mapping[str, Function], dict[pyoxigraph.NamedNode, Function]] = ({}, {})

    @property
    def version(self) -> int:
        return self._version

    @property
    def in_memory(self) -> bool:
        return self._in_memory

    @contextmanager
    def still(self) -> Iterator[None]:
        with self._changing:
            yield

    def graphs(self) -> Collection[str]:
        return [graph.value for graph in self._store.named_graphs() if isinstance(graph, pyoxigraph.NamedNode)]

    def replace(self, graphs: Mapping[str, str | None]) -> None:
        if not graphs:
            return
        try:
            self._update(_operations(graphs))
        except SyntaxError:
            # Most likely two texts use one label for a blank node, which one update cannot.
            try:
                self._update(_operations(_relabelled(graphs)))
            except SyntaxError as error:
                raise ValueError(f"no N-Triples for {_first(graphs)}: {error}") from error
        # Drawn after the change: a version read before a query begins is never newer than what the query sees.
        self._version = next(self._versions)

    def _update(self, operations: Iterator[str]) -> None:
        """Carry them out in one transaction, which only the text of one update is."""
        text = "\n".join(operations)
        with self._changing:
            self._store.update(text)

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


def _first(graphs: Mapping[str, str | None]) -> str:
    names = [repr(name) for name in list(graphs)[:3]]
    return ", ".join(names) + (", ..." if len(graphs) > len(names) else "")


def _operations(graphs: Mapping[str, str | None]) -> Iterator[str]:
    """One DROP and one INSERT DATA a graph: parsed faster than one INSERT DATA for all."""
    for name, ntriples in graphs.items():
        iri = str(pyoxigraph.NamedNode(name))  # ValueError for what is no IRI
        yield f"DROP SILENT GRAPH {iri};"
        if ntriples:
            yield f"INSERT DATA{{GRAPH {iri}{{{ntriples}}}}};"


def _relabelled(graphs: Mapping[str, str | None]) -> dict[str, str | None]:
    """The same graphs with labels of blank nodes that no two of them share."""
    return {name: text and _with_label(text, f"_:g{at}-") for at, (name, text) in enumerate(graphs.items())}


def _with_label(text: str, label: str) -> str:
    return _LABEL.sub(lambda match: label if match[0] == "_:" else match[0], text)
