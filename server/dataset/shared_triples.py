"""The triples that several graphs of a store have.

The default graph is the union of graphs: a set, which has each triple once (SPARQL 1.1 Query, 13.1). Oxigraph finds a
triple there once for each graph that has it (https://github.com/oxigraph/oxigraph/issues/1919). So the store counts
which triples these are: a query none of whose patterns can match one of them is answered as it is, any other over a
dataset in which the default graph has each once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import NamedTuple, TypeAlias

from pyoxigraph import BlankNode, NamedNode, Quad, Store, Triple

MAX_TRIPLES = 100_000
"""Triples that are counted: about 50 MB."""
_MAX_SUBJECTS = 10_000
"""Subjects of one change of which it is remembered whether they were known before."""

Subject: TypeAlias = "NamedNode | BlankNode | Triple"
_Key: TypeAlias = tuple[str | None, str | None, str | None]


class Lookup(NamedTuple):
    """What a triple pattern can match: constants, by their IRIs, None for anything."""

    subject: str | None = None
    predicates: tuple[str, ...] | None = None
    object: str | None = None


class SharedTriples:
    """Counts the graphs of each triple that more than one has, and what such triples begin and end with."""

    def __init__(self) -> None:
        self._counts: dict[Triple, int] = {}
        self._keys: Counter[_Key] = Counter()
        self.is_known = True
        """Whether it is known which they are."""

    def give_up(self) -> None:
        """They are not known any more: they are too many, or the store is changed without a word."""
        self.is_known = False
        self._counts.clear()
        self._keys.clear()

    def may_match(self, lookups: Iterable[Lookup]) -> bool:
        """Whether any pattern may match one of them."""
        if self.is_known and not self._counts:
            return False
        return any(map(self._may_match, lookups))

    def _may_match(self, lookup: Lookup) -> bool:
        if not self.is_known:
            return True
        subject, predicates, object = lookup
        if subject is not None and (subject, None, None) not in self._keys:
            return False
        return predicates is None or any((None, predicate, object) in self._keys for predicate in predicates)

    def copies(self, store: Store) -> Iterator[Quad]:
        """The quads of each but one."""
        for triple in self._counts:
            yield from _quads_of(triple, store)[1:]

    def drop(self, graph: NamedNode, store: Store) -> None:
        """Note that a graph is about to be dropped."""
        if self._counts:
            for quad in store.quads_for_pattern(None, None, None, graph):
                self._lose(quad.triple)

    def remove(self, quads: Iterable[Quad], store: Store) -> None:
        """Note that quads are about to be removed, as far as they are there."""
        if self._counts:
            for quad in dict.fromkeys(quads):
                if quad in store:
                    self._lose(quad.triple)

    def add(self, quads: Iterable[Quad], store: Store, *, is_new: bool) -> None:
        """Note that quads are about to be added to the store, as far as they are not there.

        `is_new`: their graph is empty, so that only what speaks of a subject that is known already may be shared.
        """
        known: dict[object, bool] = {}
        seen: set[Quad] = set()
        for quad in quads:
            if not self.is_known:
                return
            if is_new:
                subject = quad.subject
                if subject not in known:
                    if len(known) >= _MAX_SUBJECTS:
                        known.clear()
                    known[subject] = _is_there(subject, store)
                if not known[subject]:
                    continue
            if quad not in seen and self._gain(quad, store):
                seen.add(quad)

    def _gain(self, quad: Quad, store: Store) -> bool:
        """Count a quad whose triple another graph has; False where none has."""
        triple = quad.triple
        count = self._counts.get(triple)
        if count is None:
            graphs = [each.graph_name for each in _quads_of(triple, store)]
            if not graphs or quad.graph_name in graphs:
                return False
            self._counts[triple] = 1 + len(graphs)
            self._keys.update(_keys(triple))
            if len(self._counts) > MAX_TRIPLES:
                self.give_up()
        elif quad not in store:
            self._counts[triple] = count + 1
        return True

    def _lose(self, triple: Triple) -> None:
        count = self._counts.get(triple)
        if count is None:
            return
        if count > 2:
            self._counts[triple] = count - 1
            return
        del self._counts[triple]
        for key in _keys(triple):
            self._keys[key] -= 1
            if not self._keys[key]:
                del self._keys[key]


def _quads_of(triple: Triple, store: Store) -> list[Quad]:
    """The quads of a triple."""
    return [*store.quads_for_pattern(triple.subject, triple.predicate, triple.object, None)]


def may_share(text: bytes, store: Store) -> bool:
    """Whether N-Triples speak of a subject that is known to the store already."""
    for subject in {line.split(None, 1)[0] for line in text.split(b"\n") if line.strip()}:
        if not subject.startswith(b"<") or b"\\" in subject or _is_there(NamedNode(subject[1:-1].decode()), store):
            return True
    return False


def _is_there(subject: Subject, store: Store) -> bool:
    return next(store.quads_for_pattern(subject, None, None, None), None) is not None


def _keys(triple: Triple) -> Iterator[_Key]:
    """What is asked for where a pattern may match a triple."""
    subject, predicate, object = triple
    assert isinstance(predicate, NamedNode)
    yield None, predicate.value, None
    if isinstance(subject, NamedNode):
        yield subject.value, None, None
    if isinstance(object, NamedNode):
        yield None, predicate.value, object.value
