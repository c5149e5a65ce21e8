"""Parsing of triples: terms, property lists, collections and paths (SPARQL 1.1, 19.8, rules 52 to 106)."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TypeAlias

from pyoxigraph import Literal, NamedNode

from rosld.ontology.vocab import rdf, xsd
from rosld.server.http.problem import Problem
from rosld.server.sparql.syntax.cursor import Cursor
from rosld.server.sparql.syntax.lexer import CheckedText
from rosld.server.sparql.syntax.token import MEMBERS, Kind, Token
from rosld.server.sparql.syntax.tree import (
    TYPE,
    Chain,
    Choice,
    Constant,
    Group,
    Inverse,
    Iri,
    Path,
    PathStep,
    Pattern,
    Repeat,
    Term,
    Value,
    Variable,
    WrittenChain,
    may_be_empty,
    path_predicates,
)

Verb: TypeAlias = "Path | Variable"
AddPattern: TypeAlias = "Callable[[Term, Verb, Term], object]"
"""Callback for parsed triples."""

_TERMS = frozenset({Kind.VARIABLE, Kind.IRI, Kind.NAME, Kind.BLANK, Kind.STRING, Kind.NUMBER})
_MARKS = frozenset({"[", "(", "+", "-", "TRUE", "FALSE"})
_OF_PATHS = frozenset({"/", "|", "*", "+", "?"})
_ENDS = frozenset({".", "]", "}", "{", *MEMBERS})
_NODE = "a variable, an IRI, a blank node or a literal"
_OBJECT = f"the object of a triple ({_NODE})"
_MEMBER = f"{_NODE}, or )"
_PREDICATE = "a predicate (an IRI, a variable, a or a path)"
_FIRST, _REST, _NIL = PathStep(rdf.first.value), PathStep(rdf.rest.value), Iri(rdf.nil.value)
_ESCAPE = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|U([0-9A-Fa-f]{8})|(.))", re.DOTALL)
_CHARACTERS = {"t": "\t", "n": "\n", "r": "\r", "b": "\b", "f": "\f"}


class TripleParser(Cursor):
    """Parser of triples, which counts the patterns that the store will have to join.

    `literals` are those of patterns, templates and data.
    """

    def __init__(self, checked: CheckedText, prefixes: Mapping[str, str], base: str, max_joins: int) -> None:
        super().__init__(checked, prefixes, base)
        self.joins = 0
        self.literals: list[Constant] = []
        self.block = 0
        """Number of the current basic graph pattern: blank node labels are scoped to one (5.1.1)."""
        self._max_joins = max_joins
        self._fresh = 0
        self._labels: dict[str, int] = {}

    def new_blank_node(self) -> Variable:
        """Return a blank node without a label."""
        self._fresh += 1
        return Variable(f"[{self._fresh}]")

    def count_join(self) -> None:
        """Count one more join. Raises Problem 400 beyond the limit."""
        self.joins += 1
        if self.joins > self._max_joins:
            raise Problem(400, f"The query joins more than {self._max_joins} patterns: split it.")

    @property
    def is_at_triples(self) -> bool:
        """Whether triples may begin here."""
        return self.token.kind in _TERMS or self.key in _MARKS

    # --- triples

    def triples(self, add: AddPattern, *, is_pattern: bool) -> None:
        """Parse the triples of one subject; patterns may have paths, and their labels are scoped to one block."""
        is_bare = self.key in ("[", "(") and not self.following.is_mark("]", ")")
        subject = self._node(add, "a subject", is_pattern)
        if not (is_bare and (self.key in (".", "}") or self.is_at_end)):
            self._properties(subject, add, is_pattern)

    def triples_to_brace(self, add: AddPattern, what: str) -> None:
        """Parse the triples of a template, up to but excluding the closing brace."""
        while self.key != "}":
            if self.key == "{" or self.key in MEMBERS:
                self.fail_at(self.token, f"is not allowed in {what}, which takes only triples")
            if not self.is_at_triples:
                self.fail_expecting("a triple or }")
            self.triples(add, is_pattern=False)
            if self.key != "}":
                self.expect(".", "or }")

    def _properties(self, subject: Term, add: AddPattern, is_pattern: bool) -> None:
        while True:
            verb = self._verb(is_pattern)
            while True:
                add(subject, verb, self._node(add, _OBJECT, is_pattern))
                if not self.take(","):
                    break
            if not self.take(";"):
                return
            while self.take(";"):
                pass
            if self.key in _ENDS or self.is_at_end:
                return

    def _verb(self, is_pattern: bool) -> Verb:
        if self.token.kind is Kind.VARIABLE:
            return Variable(self.advance().text[1:])
        if is_pattern and not (self.token.kind in (Kind.IRI, Kind.NAME) and not self.following.is_mark(*_OF_PATHS)):
            return self._path()
        return PathStep(self._type_or_iri("a predicate (an IRI, a variable or a)" if not is_pattern else _PREDICATE))

    def _node(self, add: AddPattern, expected: str, is_pattern: bool) -> Term:
        if self.take("["):
            node = self.new_blank_node()
            if not self.take("]"):
                self._properties(node, add, is_pattern)
                self.expect("]", "or ; and a predicate")
            return node
        if self.take("("):
            return self._collection(add, is_pattern)
        token = self.token
        term = self.term(expected)
        if is_pattern and token.kind is Kind.BLANK and self._labels.setdefault(token.text, self.block) != self.block:
            self.fail_at(token, "is already used in another group of triples: use a variable instead")
        return term

    def _collection(self, add: AddPattern, is_pattern: bool) -> Term:
        head: Term = _NIL
        before: Term | None = None
        while not self.take(")"):
            cell = self.new_blank_node()
            if before is None:
                head = cell
            else:
                add(before, _REST, cell)
            add(cell, _FIRST, self._node(add, _MEMBER, is_pattern))
            before = cell
        if before is not None:
            add(before, _REST, _NIL)
        return head

    def term(self, expected: str) -> Term:
        """Parse a variable, an IRI, a blank node with a label or a literal."""
        token = self.token
        if token.kind is Kind.VARIABLE:
            return Variable(self.advance().text[1:])
        if token.kind is Kind.IRI or token.kind is Kind.NAME:
            return Iri(self.expect_iri())
        if token.kind is Kind.BLANK:
            return Variable(self.advance().text)
        literal = self.literal()
        if literal is None:
            self.fail_unknown(expected)
        self.literals.append(literal)
        return literal.term

    # --- literals

    def literal(self) -> Constant | None:
        """Parse a literal, with its sign, if one is next."""
        token = self.token
        if token.kind is Kind.STRING:
            return self._string(self.advance())
        if token.kind is Kind.NUMBER:
            self.advance()
            return _number(token.start, token.text)
        if self.key in ("+", "-"):
            number = self.following
            if number.kind is Kind.NUMBER and number.start == token.end:
                self.advance()
                self.advance()
                return _number(token.start, token.text + number.text)
        elif self.key in ("TRUE", "FALSE"):
            self.advance()
            value = Literal(token.text.lower(), datatype=NamedNode(xsd.boolean.value))
            return Constant(token.start, token.end, Kind.WORD, Value(value))
        return None

    def _string(self, token: Token) -> Constant:
        lexical = _lexical(token.text)
        following = self.token
        try:
            if following.kind is Kind.LANGUAGE:
                self.advance()
                value = Literal(lexical, language=following.text[1:])
            elif self.take("^^"):
                datatype = self.expect_iri("the IRI of a datatype")
                return Constant(
                    token.start, self.end, Kind.NUMBER, Value(Literal(lexical, datatype=NamedNode(datatype)))
                )
            else:
                value = Literal(lexical)
        except ValueError as error:
            self.fail_at(following, f"is not valid after a string: {error}")
        return Constant(token.start, self.end, Kind.STRING, Value(value))

    # --- paths

    def _path(self) -> Path:
        parts = [self._sequence()]
        while self.take("|"):
            parts.append(self._sequence())
        return parts[0] if len(parts) == 1 else Choice(tuple(parts))

    def _sequence(self) -> Path:
        starts = [self.token.start]
        parts = [self._element()]
        while self.take("/"):
            starts.append(self.token.start)
            parts.append(self._element())
        return parts[0] if len(parts) == 1 else Chain(tuple(parts), tuple(starts), self.end)

    def _element(self) -> Path:
        is_inverse = self.take("^")
        path = self._primary()
        if self.key in ("*", "+", "?") and self.key:
            path = Repeat(path, self.advance().text != "+")
        return Inverse(path) if is_inverse else path

    def _primary(self) -> Path:
        if self.take("("):
            path = self._path()
            self.expect(")", "after the path")
            return path
        if self.take("!"):
            self._negated_property_set()
            return Choice(())
        return PathStep(self._type_or_iri(_PREDICATE))

    def _negated_property_set(self) -> None:
        """Parse a negated property set, whose members do not constrain the possible predicates."""
        if not self.take("("):
            self._negated_one()
            return
        while not self.take(")"):
            self._negated_one()
            if self.key != ")":
                self.expect("|", "or )")

    def _negated_one(self) -> None:
        self.take("^")
        self._type_or_iri("a predicate (an IRI or a)")

    def _type_or_iri(self, expected: str) -> str:
        if self.token.text == "a":
            self.advance()
            return TYPE
        return self.expect_iri(expected)

    # --- patterns

    def add_path(self, group: Group, subject: Term, path: Verb, object: Term) -> None:
        """Add the patterns of `subject path object` to a group: one per step of a chain, joined by fresh variables."""
        if isinstance(path, Variable):
            self._add(group, Pattern(subject, None, object, verb=path))
        elif isinstance(path, PathStep):
            self._add(group, Pattern(subject, frozenset({path.iri}), object))
        elif isinstance(path, Inverse):
            self.add_path(group, object, path.path, subject)
        elif isinstance(path, Chain):
            ends = [subject, *(self.new_blank_node() for _ in path.parts[1:]), object]
            before = len(group.patterns)
            for at, part in enumerate(path.parts):
                self.add_path(group, ends[at], part, ends[at + 1])
            steps = tuple(part.iri for part in path.parts if isinstance(part, PathStep))
            if len(steps) == len(path.parts):
                group.chains.append(WrittenChain(path.starts, path.end, steps, tuple(group.patterns[before:])))
        else:
            predicates = path_predicates(path)
            is_simple = (
                isinstance(path, Choice)
                and all(isinstance(part, PathStep) for part in path.parts)
                and len(predicates or ()) == len(path.parts) > 0
            )
            self._add(group, Pattern(subject, predicates, object, not is_simple, may_be_empty(path)))

    def _add(self, group: Group, pattern: Pattern) -> None:
        self.count_join()
        group.patterns.append(pattern)
        for term in (pattern.subject, pattern.verb, pattern.object):
            if isinstance(term, Variable) and not term.is_blank:
                group.visible.add(term.name)


def _number(start: int, text: str) -> Constant:
    name = "double" if "e" in text.lower() else "decimal" if "." in text else "integer"
    return Constant(start, start + len(text), Kind.NUMBER, Value(Literal(text, datatype=NamedNode(xsd.iri + name))))


def _lexical(text: str) -> str:
    """Return the text between the quotes, with escapes replaced."""
    length = 3 if text[:3] in ('"""', "'''") and len(text) >= 6 else 1
    inside = text[length:-length]
    return _ESCAPE.sub(_character, inside) if "\\" in inside else inside


def _character(escape: re.Match[str]) -> str:
    code = escape[1] or escape[2]
    return chr(int(code, 16)) if code else _CHARACTERS.get(escape[3], escape[3])
