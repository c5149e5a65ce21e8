"""The store behind any SPARQL 1.1 endpoint: queries by the SPARQL 1.1 Protocol, changes by SPARQL 1.1 Update."""

from __future__ import annotations

import threading
from collections.abc import Collection, Mapping, Sequence
from itertools import count
from urllib.parse import urlencode

import pyoxigraph

from rosld.server.dataset.base import Edit, Function, QueryError, Results
from rosld.server.dataset.endpoint_client import Endpoint, Response, StoreError, StoreRefused, StoreUnreachable
from rosld.server.dataset.ntriples import check_changes
from rosld.server.dataset.update_text import update_text

_JSON = "application/sparql-results+json"
_GRAPH = "application/n-triples"
_FORM = "application/x-www-form-urlencoded"
_UPDATE = "application/sparql-update"


class RemoteStore:
    """A `Store` that others may use too. Raises StoreError where its endpoints do not do what they are asked.

    `version` concerns what is changed through this object alone. A replacement is one request, which is one
    transaction where the server makes it one (SPARQL 1.1 Update 2.2); Oxigraph does. Asking Oxigraph, the default graph
    is the union of all graphs, as the contract has it; other servers have a setting for that.
    """

    def __init__(self, query: Endpoint, update: Endpoint) -> None:
        self._query = query
        self._update = update
        self._changing = threading.Lock()
        self._versions = count(1)
        self._version = 0

    @property
    def version(self) -> int:
        return self._version

    @property
    def url(self) -> str:
        """Where queries go."""
        return self._query.url

    @property
    def connections(self) -> int:
        """How many connections were made: while it is the same, the same servers have answered."""
        return self._query.connections + self._update.connections

    def set_timeout(self, seconds: float) -> None:
        """Requests from now on take no longer than so many seconds."""
        self._query.seconds = self._update.seconds = seconds

    def interrupt(self) -> None:
        """End the requests that are under way, from another thread: they raise Unreachable."""
        self._query.interrupt()
        self._update.interrupt()

    def graphs(self) -> Collection[str]:
        return self.graphs_with_prefix("")

    def graphs_with_prefix(self, beginning: str) -> list[str]:
        """The IRIs of the named graphs that begin so."""
        pattern = f"FILTER(STRSTARTS(STR(?g), {pyoxigraph.Literal(beginning)}))" if beginning else ""
        found = self.query(f"SELECT DISTINCT ?g {{ GRAPH ?g {{ ?s ?p ?o }} {pattern} }}")
        assert isinstance(found, pyoxigraph.QuerySolutions)
        return [name.value for row in found if isinstance(name := row["g"], pyoxigraph.NamedNode)]

    def replace(self, graphs: Mapping[str, str | None], edits: Sequence[Edit] = ()) -> None:
        if not graphs and not edits:
            return
        update = "\n".join(update_text(*check_changes(graphs, edits)))
        with self._changing:
            self._update.post(update.encode(), _UPDATE, "*/*;q=0.1")
            self._version = next(self._versions)

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
        if functions:
            raise QueryError("a store behind an endpoint takes no functions of this process")
        form = [("query", _prologue(base, prefixes) + text)]
        form += [("default-graph-uri", graph) for graph in default_graphs]
        form += [("named-graph-uri", graph) for graph in named_graphs]
        if len(form) == 1:
            form.append(("union-default-graph", "true"))
        try:
            answer = self._query.post(urlencode(form).encode(), _FORM, f"{_JSON}, {_GRAPH};q=0.9")
        except StoreRefused as error:
            if error.status == 400:
                raise QueryError(str(error)) from error
            raise
        return self._results(answer)

    def _results(self, answer: Response) -> Results:
        try:
            if answer.media_type == _JSON:
                found = _parse(answer.body)
                if isinstance(found, pyoxigraph.QuerySolutions):
                    for _ in found:  # so that what is malformed is told here and not to who reads it
                        pass
                    return _parse(answer.body)
                return found
            if answer.media_type == _GRAPH:
                graph = pyoxigraph.Store()
                graph.load(answer.body, pyoxigraph.RdfFormat.N_TRIPLES)
                return graph.query("CONSTRUCT WHERE { ?s ?p ?o }")
        except (SyntaxError, ValueError, OSError) as error:
            raise StoreUnreachable(f"{self.url} answers with malformed results.", str(error)) from error
        raise StoreUnreachable(f"{self.url} answers with something else than results.", answer.media_type)


def _parse(body: bytes) -> Results:
    return pyoxigraph.parse_query_results(body, format=pyoxigraph.QueryResultsFormat.JSON)


def _prologue(base: str | None, prefixes: Mapping[str, str]) -> str:
    """On the first line of the text, so that lines are those of the query in what the endpoint says of it."""
    named = "".join(f"PREFIX {prefix}: {pyoxigraph.NamedNode(iri)} " for prefix, iri in prefixes.items())
    return (f"BASE {pyoxigraph.NamedNode(base)} " if base else "") + named


__all__ = ["RemoteStore", "StoreError"]
