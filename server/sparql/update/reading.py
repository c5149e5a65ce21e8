"""Reading an update: from its text to its operations (the grammar of SPARQL 1.1, 19.8). Pure."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import replace

from pyoxigraph import NamedNode

from rosld.server.http.problem import Problem
from rosld.server.sparql.cursor import Cursor, Unrecognised
from rosld.server.sparql.lexer import Bounds, Checked, Kind, Token, check, place
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.update.operations import (
    Home,
    Load,
    Manage,
    Modify,
    Operation,
    QuadTemplate,
    Several,
    Verb,
    Where,
)
from rosld.server.sparql.update.templates import has_blank_nodes, holes_of, read_template

_UNBOUND = f"unbound_{secrets.token_hex(8)}"
"""A variable that no WHERE binds: projected alone, it has the solutions counted."""


def read_update(
    request: UpdateRequest, prefixes: Mapping[str, str], base: str, bounds: Bounds
) -> tuple[Operation, ...]:
    """The operations of an update; `prefixes` hold where the text does not declare them itself.

    A graph of the request (`using-graph-uri`) is the dataset of each WHERE. Raises Problems: those of `check`, and 400
    for what is no update, or names a dataset in the request and in the text.
    """
    return _Reader(check(request.text, bounds, what="update"), prefixes, base, request).operations()


class _Reader(Cursor):
    def __init__(self, checked: Checked, prefixes: Mapping[str, str], base: str, request: UpdateRequest) -> None:
        super().__init__(checked, prefixes, base)
        self._request = request
        self._known = dict(prefixes)
        self._now = base
        self._prologue = ""
        self._data_labels: set[str] = set()
        self._where_labels: set[str] = set()

    def operations(self) -> tuple[Operation, ...]:
        found: list[Operation] = []
        try:
            while True:
                self._declarations()
                if self.peek() is None:
                    return tuple(found)
                found.append(self._operation())
                if self.peek() is not None and not self.take(";"):
                    raise Unrecognised
        except Unrecognised as error:
            raise self._not_understood() from error

    def _not_understood(self) -> Problem:
        token = self.peek()
        if token is None:
            return Problem(400, "The update ends where something must follow.")
        words = f"{token.text} at {place(self.text, token.start)} is not understood"
        return Problem(400, f"The update cannot be read: {words} (SPARQL 1.1 Update).")

    def _declarations(self) -> None:
        while True:
            begin = self.peek()
            if self.take_word("PREFIX"):
                name = self._prefix_name()
                self._known[name] = self._iri(Kind.IRI)
                self.prefix(name, self._known[name])
            elif self.take_word("BASE"):
                self._now = self._iri(Kind.IRI)
                self.base(self._now)
            else:
                return
            assert begin is not None
            self._prologue += self._since(begin.start) + "\n"

    def _prefix_name(self) -> str:
        token = self.peek()
        if token is None or token.kind is not Kind.NAME or token.text.index(":") != len(token.text) - 1:
            raise Unrecognised
        self.skip()
        return token.text[:-1]

    def _iri(self, *kinds: Kind) -> str:
        """Take an IRI, or only one that is written as these tokens are."""
        token = self.peek()
        if token is None or (kinds and token.kind not in kinds):
            raise Unrecognised
        iri = self.iri(token)
        self.skip()
        return iri

    def _operation(self) -> Operation:
        if self.take_word("LOAD"):
            return self._load()
        for verb in Verb:
            if self.take_word(verb.value):
                return self._manage(verb)
        return self._modify(self._iri() if self.take_word("WITH") else None)

    # Quads

    def _modify(self, graph: str | None) -> Modify:
        """INSERT DATA, DELETE DATA, DELETE WHERE, and DELETE, INSERT or both with a WHERE."""
        if not self.is_word("INSERT", "DELETE"):
            raise Unrecognised
        token = self.next()
        if graph is None and self.take_word("DATA"):
            return self._data(token)
        if graph is None and token.is_word("DELETE") and self.take_word("WHERE"):
            begin = self._at_brace()
            deletes = self._quads()
            self._refuse_blank(deletes, begin)
            return Modify(deletes, (), self._where(self._since(begin), deletes, None))
        deletes, inserts = self._templates(token, graph)
        default, named = self._using()
        if not self.take_word("WHERE"):
            raise Unrecognised
        begin, first = self._at_brace(), self.position
        self.skip_group()
        self._scope_labels(first, self._where_labels, "WHERE")
        using = bool(default or named)
        where = self._where(self._since(begin), (*deletes, *inserts), None if using else graph)
        if using:
            where = replace(where, default_graphs=default, named_graphs=named)
        return Modify(deletes, inserts, where)

    def _data(self, token: Token) -> Modify:
        begin, first = self._at_brace(), self.position
        quads = self._quads()
        if holes := holes_of(quads):
            raise Problem(
                400, f"?{holes[0]} stands in the {token.text.upper()} DATA at {place(self.text, begin)}: none can."
            )
        if token.is_word("INSERT"):
            self._scope_labels(first, self._data_labels, "INSERT DATA")
            return Modify(inserts=quads)
        self._refuse_blank(quads, begin)
        return Modify(deletes=quads)

    def _templates(self, token: Token, graph: str | None) -> tuple[tuple[QuadTemplate, ...], tuple[QuadTemplate, ...]]:
        if token.is_word("INSERT"):
            return (), self._quads(graph)
        begin = self._at_brace()
        deletes = self._quads(graph)
        self._refuse_blank(deletes, begin)
        return deletes, self._quads(graph) if self.take_word("INSERT") else ()

    def _quads(self, graph: str | None = None) -> tuple[QuadTemplate, ...]:
        self.expect("{")
        found: list[Token] = []
        depth = 1
        while True:
            token = self.next()
            depth += token.is_mark("{") - token.is_mark("}")
            if not depth:
                break
            found.append(token)
        return _within(read_template(found, self.text, self._known, self._now), graph)

    def _refuse_blank(self, quads: tuple[QuadTemplate, ...], begin: int) -> None:
        if has_blank_nodes(quads):
            where = place(self.text, begin)
            raise Problem(400, f"A blank node stands in the DELETE at {where}: write a variable (SPARQL 1.1, 19.8).")

    def _scope_labels(self, first: int, known: set[str], clause: str) -> None:
        """Refuse a label of a blank node that an earlier clause of this kind has (SPARQL 1.1 Query, 19.6)."""
        found = {token.text: token for token in self.taken_since(first) if token.kind is Kind.BLANK}
        if again := next((token for label, token in found.items() if label in known), None):
            where = place(self.text, again.start)
            words = f"{again.text} at {where} is a label in another {clause} already: choose another"
            raise Problem(400, f"{words} (SPARQL 1.1, 19.6).")
        known.update(found)

    # WHERE

    def _using(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        default: list[str] = []
        named: list[str] = []
        while self.take_word("USING"):
            chosen = named if self.take_word("NAMED") else default
            chosen.append(self._iri())
        return tuple(default), tuple(named)

    def _at_brace(self) -> int:
        token = self.peek()
        if token is None or not token.is_mark("{"):
            raise Unrecognised
        return token.start

    def _since(self, begin: int) -> str:
        """The text from a place to the token that was taken last."""
        token = self.peek()
        return self.text[begin : len(self.text) if token is None else token.start]

    def _where(self, group: str, quads: tuple[QuadTemplate, ...], graph: str | None) -> Where:
        holes = holes_of(quads)
        if not holes and has_blank_nodes(quads):
            holes = (_UNBOUND,)  # each solution has blank nodes of its own (Update, 3.1.3), so they are counted
        form = f"SELECT {' '.join(f'?{name}' for name in holes)} WHERE" if holes else "ASK"
        query = f"{self._prologue}{form} {group}"
        request = self._request
        if graph is None:
            return Where(query, holes, request.using_graphs, request.using_named_graphs)
        return Where(f"{self._prologue}{form} {{GRAPH <{graph}> {group}}}", holes, home=Home(graph, query))

    # Whole graphs

    def _manage(self, verb: Verb) -> Manage:
        silent = self.take_word("SILENT")
        if verb in (Verb.ADD, Verb.MOVE, Verb.COPY):
            source = self._graph_or_default()
            if not self.take_word("TO"):
                raise Unrecognised
            return Manage(verb, self._graph_or_default(), source, silent)
        if verb is Verb.CREATE or self.is_word("GRAPH"):
            return Manage(verb, self._named(), None, silent)
        for several in Several:
            if self.take_word(several.value):
                return Manage(verb, several, None, silent)
        raise Unrecognised

    def _graph_or_default(self) -> str | Several:
        if self.take_word("DEFAULT"):
            return Several.DEFAULT
        self.take_word("GRAPH")
        return self._iri()

    def _named(self) -> str:
        if not self.take_word("GRAPH"):
            raise Unrecognised
        return self._iri()

    def _load(self) -> Load:
        silent = self.take_word("SILENT")
        document = self._iri()
        return Load(document, self._named() if self.take_word("INTO") else None, silent)


def _within(quads: tuple[QuadTemplate, ...], graph: str | None) -> tuple[QuadTemplate, ...]:
    """WITH: the graph that is meant where none is named."""
    if graph is None:
        return quads
    return tuple(each if each.graph is not None else each._replace(graph=NamedNode(graph)) for each in quads)
