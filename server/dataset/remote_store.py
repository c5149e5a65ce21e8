"""Store behind any SPARQL 1.1 endpoint: queries by the SPARQL 1.1 Protocol, changes by SPARQL 1.1 Update."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from urllib.parse import urlencode

import pyoxigraph
from pyoxigraph import Literal, NamedNode, QueryResultsFormat, QuerySolution, QuerySolutions, parse_query_results

from rosld.server.dataset.base import Edit
from rosld.server.dataset.endpoint_client import Endpoint, StoreError, StoreUnreachable

_LABEL = re.compile(r'"(?:[^"\\]|\\.)*"|<[^>]*>|_:([^\s.<"]+(?:\.+[^\s.<"]+)*)')


def check_changes(graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> tuple[dict[str, str | None], list[Edit]]:
    """Return the changes parsed and serialized again: pure N-Triples, and no blank node label in two texts.

    Raises ValueError naming the first graph with invalid N-Triples or an invalid IRI.
    """
    return (
        {name: None if text is None else _reserialize(name, text) for name, text in graphs.items()},
        [
            Edit(edit.graph, _reserialize(edit.graph, edit.added), _reserialize(edit.graph, edit.removed))
            for edit in edits
        ],
    )


def _reserialize(name: str, text: str) -> str:
    graph = pyoxigraph.NamedNode(name)
    if not text:
        return ""
    read = pyoxigraph.Store()
    try:
        read.load(text.encode(), pyoxigraph.RdfFormat.N_TRIPLES)
    except (SyntaxError, UnicodeEncodeError) as error:
        raise ValueError(f"no N-Triples for {graph.value!r}: {error}") from error
    written = read.dump(format=pyoxigraph.RdfFormat.N_TRIPLES, from_graph=pyoxigraph.DefaultGraph())
    assert written is not None
    return written.decode()


def split_parts(text: str, size: int) -> Iterator[str]:
    """Yield the lines in parts of about `size` characters; lines that share a blank node stay in one part.

    A label stands for another node in another request, so triples connected by blank nodes are never separated, and
    their part may be larger.
    """
    if len(text) <= size:
        yield text
        return
    part: list[str] = []
    size_so_far = 0
    for lines in _connected_lines([f"{line}\n" for line in text.split("\n") if line]):
        length = sum(map(len, lines))
        if part and size_so_far + length > size:
            yield "".join(part)
            part, size_so_far = [], 0
        part += lines
        size_so_far += length
    if part:
        yield "".join(part)


def _connected_lines(lines: Sequence[str]) -> Iterator[Sequence[str]]:
    """Yield the lines in groups that share no blank nodes with each other."""
    groups = _Groups()
    joined: dict[str, list[str]] = {}
    for line in lines:
        labels = [match[1] for match in _LABEL.finditer(line) if match[1]]
        if labels:
            groups.join(labels)
            joined.setdefault(labels[0], []).append(line)
        else:
            yield (line,)
    groups_by_label: dict[str, list[str]] = {}
    for label, members in joined.items():
        groups_by_label.setdefault(groups.of(label), []).extend(members)
    yield from groups_by_label.values()


class _Groups:
    """Disjoint sets of labels."""

    def __init__(self) -> None:
        self._above: dict[str, str] = {}

    def of(self, label: str) -> str:
        """Return the representative of the label's group."""
        above = self._above
        above.setdefault(label, label)
        while above[label] != label:
            above[label] = label = above[above[label]]
        return label

    def join(self, labels: Sequence[str]) -> None:
        """Merge the groups of these labels."""
        first = self.of(labels[0])
        for label in labels[1:]:
            self._above[self.of(label)] = first


_JSON = "application/sparql-results+json"
_FORM = "application/x-www-form-urlencoded"
_UPDATE = "application/sparql-update"


class RemoteStore:
    """A store that may be shared with others. Raises StoreError if its endpoints fail or refuse."""

    def __init__(self, query: Endpoint, update: Endpoint) -> None:
        self._query = query
        self._update = update

    @property
    def url(self) -> str:
        """URL of the query endpoint."""
        return self._query.url

    @property
    def connections(self) -> int:
        """Number of connections made. While it does not change, the same servers have responded."""
        return self._query.connections + self._update.connections

    def set_timeout(self, seconds: float) -> None:
        """Set the maximum seconds of later requests."""
        self._query.seconds = self._update.seconds = seconds

    def interrupt(self) -> None:
        """Abort the current requests from another thread: they raise StoreUnreachable."""
        self._query.interrupt()
        self._update.interrupt()

    def graphs_with_prefix(self, prefix: str) -> list[str]:
        """Return the IRIs of the named graphs with this prefix."""
        pattern = f"FILTER(STRSTARTS(STR(?g), {Literal(prefix)}))" if prefix else ""
        rows = self.select(f"SELECT DISTINCT ?g {{ GRAPH ?g {{ ?s ?p ?o }} {pattern} }}")
        return [name.value for row in rows if isinstance(name := row["g"], NamedNode)]

    def replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        """Replace each graph by its N-Triples, or drop it (None), then apply the edits in order.

        Sends one request, which is one transaction if the server makes it one (SPARQL 1.1 Update 2.2); Oxigraph does.
        Raises ValueError for invalid N-Triples or an invalid IRI.
        """
        if graphs or edits:
            update = "\n".join(_update_text(*check_changes(graphs, edits)))
            self._update.post(update.encode(), _UPDATE, "*/*;q=0.1")

    def select(self, query: str) -> list[QuerySolution]:
        """Return the solutions of a SELECT query."""
        answer = self._query.post(urlencode({"query": query}).encode(), _FORM, _JSON)
        try:
            if answer.media_type == _JSON:
                results = parse_query_results(answer.body, format=QueryResultsFormat.JSON)
                if isinstance(results, QuerySolutions):
                    return [*results]
        except (SyntaxError, ValueError, OSError) as error:
            raise StoreUnreachable(f"{self.url} responds with malformed results.", str(error)) from error
        raise StoreUnreachable(f"{self.url} does not respond with results.", answer.media_type)


def _update_text(graphs: Mapping[str, str | None], edits: Sequence[Edit]) -> Iterator[str]:
    """Yield a DROP and an INSERT DATA per graph: parsed faster than one INSERT DATA. Raises ValueError."""
    for name, ntriples in graphs.items():
        iri = str(NamedNode(name))
        yield f"DROP SILENT GRAPH {iri};"
        if ntriples:
            yield f"INSERT DATA{{GRAPH {iri}{{{ntriples}}}}};"
    for edit in edits:
        iri = str(NamedNode(edit.graph))
        if edit.removed:
            yield f"DELETE DATA{{GRAPH {iri}{{{edit.removed}}}}};"
        if edit.added:
            yield f"INSERT DATA{{GRAPH {iri}{{{edit.added}}}}};"


__all__ = ["RemoteStore", "StoreError"]
