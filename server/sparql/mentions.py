"""What clients say of live resources in their own graphs, as far as narrowing rests on the server alone saying it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial

from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.ontology.vocab import rdf, ros
from rosld.server.sparql.change_source import Changes, ChangeSource
from rosld.server.sparql.vocabulary_view import document_of

_LIVE = ("topics/", "parameters/", "resources/", "bags/")
_LISTS = frozenset({rdf.first.value, rdf.rest.value})
_NIL = rdf.nil.value


class Mentions:
    """By predicate or class: the live documents of whose nodes clients say it, as subject or as object.

    Only terms of the ROS vocabulary, of message types and of lists are looked at: narrowing rests on no others.
    """

    def __init__(self, base: str, types: str) -> None:
        self._places = tuple(base + place for place in _LIVE)
        self._terms = (ros.iri, types)
        self._of: dict[str, dict[str, frozenset[str]]] = {}
        self._lists: set[str] = set()

    def documents_of(self, terms: Collection[str]) -> frozenset[str] | None:
        """The documents of which any of these terms is said; None for all: clients say something of the empty list."""
        if self._lists and terms:
            return None
        found = (list(self._of.get(term, {}).values()) for term in terms)
        return frozenset().union(*(documents for graphs in found for documents in graphs))

    def replace(self, graph: str, text: str | None) -> None:
        """What a graph says now, as N-Triples; None: it is gone. In any thread."""
        for graphs in list(self._of.values()):
            graphs.pop(graph, None)
        self._lists.discard(graph)
        if text is not None:
            self.add(graph, text)

    def add(self, graph: str, text: str) -> None:
        """What a graph says in addition. In any thread."""
        if not any(f"<{place}" in text for place in self._places) and f"<{_NIL}> <" not in text:
            return
        for quad in parse(text, RdfFormat.N_TRIPLES):
            if isinstance(quad.subject, NamedNode) and quad.subject.value == _NIL:
                self._lists.add(graph)
            term = quad.object if quad.predicate == rdf.type else quad.predicate
            if not isinstance(term, NamedNode) or not self._is_relied_on(term.value):
                continue
            nodes = (node.value for node in (quad.subject, quad.object) if isinstance(node, NamedNode))
            documents = frozenset(document_of(node) for node in nodes if node.startswith(self._places))
            if documents:
                graphs = self._of.setdefault(term.value, {})
                graphs[graph] = graphs.get(graph, frozenset()) | documents

    def _is_relied_on(self, term: str) -> bool:
        return term.startswith(self._terms) or term in _LISTS


class MentionRecorder:
    """What clients keep, noting what it mentions as it is rendered: a `ChangeSource`."""

    def __init__(self, kept: ChangeSource, mentions: Mentions) -> None:
        self._kept = kept
        self._mentions = mentions

    @property
    def version(self) -> int:
        """As `ChangeSource.version`."""
        return self._kept.version

    def last_change(self, graph: str) -> int:
        """As `ChangeSource.last_change`."""
        return self._kept.last_change(graph)

    def changes(self, after: int) -> Iterator[Changes]:
        """As `ChangeSource.changes`."""
        for part in self._kept.changes(after):
            for edit in part.edits:
                self._mentions.add(edit.graph, edit.added)
            yield part._replace(graphs=self._note(part.graphs))

    def _note(self, graphs: Mapping[str, Callable[[], str] | None]) -> Mapping[str, Callable[[], str] | None]:
        for graph, render in graphs.items():
            if render is None:
                self._mentions.replace(graph, None)
        return {graph: render and partial(self._render, graph, render) for graph, render in graphs.items()}

    def _render(self, graph: str, render: Callable[[], str]) -> str:
        text = render()
        self._mentions.replace(graph, text)
        return text
