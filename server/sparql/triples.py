"""Reading triples: nodes, property lists, collections and paths, each to the patterns they stand for."""

from __future__ import annotations

from collections.abc import Mapping

from rosld.server.http.problem import Problem
from rosld.server.sparql.cursor import Cursor, Unrecognised
from rosld.server.sparql.lexer import Checked, Kind
from rosld.server.sparql.patterns import (
    TYPE,
    Chain,
    Choice,
    Group,
    Inverse,
    Iri,
    Path,
    Pattern,
    Repeat,
    Step,
    Term,
    Value,
    Variable,
    may_be_empty,
    predicates,
)

_FIRST = "http://www.w3.org/1999/02/22-rdf-syntax-ns#first"
_REST = "http://www.w3.org/1999/02/22-rdf-syntax-ns#rest"
MEMBERS = ("OPTIONAL", "MINUS", "GRAPH", "FILTER", "BIND", "VALUES", "SERVICE")
"""The keywords that begin something of a group that is no triple."""


class TripleReader(Cursor):
    """Reads triples into groups, and counts the patterns that the store will have to join."""

    def __init__(self, query: Checked, prefixes: Mapping[str, str], base: str, most_joins: int) -> None:
        super().__init__(query, prefixes, base)
        self._most_joins = most_joins
        self._fresh = 0
        self.joins = 0

    def new(self) -> Variable:
        """A variable that occurs nowhere else."""
        self._fresh += 1
        return Variable(f"[{self._fresh}]")

    def join(self) -> None:
        """Count one more to join; Problem 400 where it is one too many."""
        self.joins += 1
        if self.joins > self._most_joins:
            raise Problem(400, f"The query joins more than {self._most_joins} patterns: ask it in parts.")

    def triples(self, group: Group) -> None:
        """Triples with one subject each, up to what is no triple."""
        while True:
            token = self.peek()
            if token is None or token.is_mark("{", "}") or token.is_word(*MEMBERS):
                return
            bare = token.is_mark("[", "(")
            subject = self._node(group)
            if not (bare and (self.is_next(".", "}") or self.peek() is None)):
                self._properties(group, subject)
            if not self.take("."):
                return

    def _properties(self, group: Group, subject: Term) -> None:
        while True:
            path = self._verb()
            while True:
                self._add(group, subject, path, self._node(group))
                if not self.take(","):
                    break
            if not self.is_next(";"):
                return
            while self.take(";"):
                pass
            token = self.peek()
            if token is None or token.is_mark(".", "]", "}", "{") or token.is_word(*MEMBERS):
                return

    def _verb(self) -> Path | Variable:
        token = self.peek()
        if token is not None and token.kind is Kind.VARIABLE:
            return Variable(self.next().text[1:])
        return self._alternatives()

    def _node(self, group: Group) -> Term:
        if self.take("["):
            node = self.new()
            if not self.is_next("]"):
                self._properties(group, node)
            self.expect("]")
            return node
        if self.take("("):
            return self._collection(group)
        return self.term()

    def _collection(self, group: Group) -> Term:
        head = cell = self.new()
        first, rest = Step(_FIRST), Step(_REST)
        while not self.take(")"):
            self._add(group, cell, first, self._node(group))
            following = self.new()
            self._add(group, cell, rest, following)
            cell = following
        return head

    def term(self) -> Term:
        """A variable, an IRI, a blank node or a literal."""
        token = self.next()
        if token.kind is Kind.VARIABLE:
            return Variable(token.text[1:])
        if token.kind in (Kind.IRI, Kind.NAME):
            return Iri(self.iri(token))
        if token.kind is Kind.BLANK:
            return Variable(token.text)
        if token.kind is Kind.STRING:
            self._literal_end()
            return Value()
        if token.is_mark("+", "-"):
            token = self.next()
        if token.kind is Kind.NUMBER or token.is_word("TRUE", "FALSE"):
            return Value()
        raise Unrecognised

    def _literal_end(self) -> None:
        token = self.peek()
        if token is not None and token.kind is Kind.LANGUAGE:
            self.skip()
        elif self.take("^^"):
            self.iri(self.next())

    def _alternatives(self) -> Path:
        parts = [self._chain()]
        while self.take("|"):
            parts.append(self._chain())
        return parts[0] if len(parts) == 1 else Choice(tuple(parts))

    def _chain(self) -> Path:
        parts = [self._path_element()]
        while self.take("/"):
            parts.append(self._path_element())
        return parts[0] if len(parts) == 1 else Chain(tuple(parts))

    def _path_element(self) -> Path:
        inverse = self.take("^")
        path = self._path_primary()
        if self.is_next("*", "+", "?"):
            path = Repeat(path, self.next().text != "+")
        return Inverse(path) if inverse else path

    def _path_primary(self) -> Path:
        if self.take("("):
            path = self._alternatives()
            self.expect(")")
            return path
        if self.take("!"):
            self._negated()
            return Choice(())
        token = self.next()
        if token.is_word("A"):
            return Step(TYPE)
        return Step(self.iri(token))

    def _negated(self) -> None:
        """A negated property set, whose members say nothing of what may match."""
        bracket = self.take("(")
        while True:
            self.take("^")
            if not self.take_word("A"):
                self.iri(self.next())
            if not bracket or not self.take("|"):
                break
        if bracket:
            self.expect(")")

    def _add(self, group: Group, subject: Term, path: Path | Variable, object: Term) -> None:
        """The patterns of `subject path object`: a chain is one a step, with fresh variables between."""
        if isinstance(path, Variable):
            self.join()
            group.patterns.append(Pattern(subject, None, object))
        elif isinstance(path, Inverse):
            self._add(group, object, path.path, subject)
        elif isinstance(path, Chain):
            ends = [subject, *(self.new() for _ in path.parts[1:]), object]
            for at, part in enumerate(path.parts):
                self._add(group, ends[at], part, ends[at + 1])
        else:
            self.join()
            simple = isinstance(path, Step) or (
                isinstance(path, Choice) and bool(path.parts) and all(isinstance(part, Step) for part in path.parts)
            )
            group.patterns.append(Pattern(subject, predicates(path), object, not simple, may_be_empty(path)))
