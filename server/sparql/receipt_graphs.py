"""Receipts as named graphs: the receipts added and removed since a version, and the container that lists them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from rosld.ontology.describe_activities import Receipt, activity_document
from rosld.ontology.describe_graph import container_document
from rosld.ontology.serialize import serialize
from rosld.ontology.syntax import Syntax
from rosld.ontology.urls import Space
from rosld.ontology.vocab import ldp, rdf
from rosld.server.dataset import Edit
from rosld.server.receipts.journal import Journal, JournalEntry
from rosld.server.sparql.needs import Needs, StatedTerms
from rosld.server.sparql.stored_sync import Changes

TITLE = "Activity"
_PAGE = 200
"""Maximum number of receipts per part, after which the loop may run."""
_SIZE = 2500
"""Approximate number of characters per receipt."""


class ReceiptGraphs:
    """Graphs of a journal: a `ChangeSource`. A removal is only reported if the receipt was reported before."""

    def __init__(self, journal: Journal, space: Space) -> None:
        self._journal = journal
        self._space = space
        self._container = space.container("activity")
        self._terms = _terms(space)
        self._reported = 0
        self._removed: list[tuple[int, str]] = []
        journal.on_dropped(self._note_dropped)

    @property
    def version(self) -> int:
        """Number that increases with each change."""
        return self._journal.version

    def may_match(self, needs: Needs) -> bool:
        """Whether a query can match triples of receipts."""
        return needs.asks_graphs or needs.may_match_below(self._container, self._terms)

    def last_change(self, graph: str) -> int:
        """Return an upper bound of the version of the last change of a graph."""
        return self.version if graph.startswith(self._container) else 0

    def changes(self, after: int) -> Iterator[Changes]:
        """Yield the changes after a version, in parts."""
        self._removed = [(version, id) for version, id in self._removed if version > after]
        if after == 0:
            head = serialize(container_document(self._container, (), TITLE), Syntax.N_TRIPLES).decode()
            yield Changes({self._container: lambda: head}, (), len(head))
        self._reported = self._journal.version
        removed_ids = [id for version, id in self._removed if version > after]
        yield from self._parts(self._journal.after(after), removed_ids)

    def _parts(self, fresh: Sequence[JournalEntry], removed_ids: Sequence[str]) -> Iterator[Changes]:
        if removed_ids:
            urls = [self._space.activity(id) for id in removed_ids]
            edit = Edit(self._container, removed="".join(map(self._line, urls)))
            yield Changes(dict.fromkeys(urls), (edit,), len(edit.removed))
        for start in range(0, len(fresh), _PAGE):
            page = {self._space.activity(entry.id): entry for entry in fresh[start : start + _PAGE]}
            edit = Edit(self._container, added="".join(map(self._line, page)))
            graphs = {url: partial(_text, entry, self._space) for url, entry in page.items()}
            yield Changes(graphs, (edit,), len(edit.added) + _SIZE * len(page))

    def _line(self, url: str) -> str:
        return f"<{self._container}> {ldp.contains} <{url}> .\n"

    def _note_dropped(self, entry: JournalEntry) -> None:
        if entry.number <= self._reported:
            self._removed.append((self._journal.version, entry.id))


def _terms(space: Space) -> StatedTerms:
    """Return the terms of a receipt that has every property, and of the container."""
    container = container_document(space.container("activity"), [space.activity("0")], TITLE)
    creations = (space.base, space.call("0"))
    documents = (
        container,
        *(activity_document(_EVERYTHING._replace(made=one, touched=(space.topic("/t"),)), space) for one in creations),
    )
    triples = [triple for document in documents for triple in document.all_triples()]
    classes = frozenset(str(one.object)[1:-1] for one in triples if one.predicate == rdf.type)
    return StatedTerms(frozenset(one.predicate.value for one in triples), classes)


_EVERYTHING = Receipt(
    1, "0", "-", None, 0, 0, "PUT", "/", "text/turtle", 1, "-", "-", True, ("-",), ("urn:x",), 1, 200, None, *"---"
)


def _text(entry: JournalEntry, space: Space) -> str:
    return serialize(activity_document(entry.receipt, space), Syntax.N_TRIPLES).decode()
