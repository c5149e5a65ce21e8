"""A cursor over the tokens of a query, which knows its prefixes and its base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.server.sparql.lexer import Checked, Kind, Token, unescaped
from rosld.server.sparql.patterns import TYPE


class Unrecognised(Exception):
    """The text is no query of SPARQL 1.1 as far as is known here."""


class Cursor:
    """Takes tokens one by one; whatever does not fit raises Unrecognised."""

    def __init__(self, query: Checked, prefixes: Mapping[str, str], base: str) -> None:
        self.text = query.text
        self._tokens = query.tokens
        self._at = 0
        self._prefixes = dict(prefixes)
        self._base = base

    def prefix(self, name: str, iri: str) -> None:
        """Declare a prefix."""
        self._prefixes[name] = iri

    def base(self, iri: str) -> None:
        """Declare what relative IRIs are resolved against."""
        self._base = iri

    def skip(self) -> None:
        """Pass over the next token."""
        self._at += 1

    @property
    def position(self) -> int:
        """The number of tokens that have been taken."""
        return self._at

    def taken_since(self, position: int) -> Sequence[Token]:
        """The tokens that have been taken since a position."""
        return self._tokens[position : self._at]

    def peek(self, ahead: int = 0) -> Token | None:
        """The next token, or one after it; None behind the last."""
        at = self._at + ahead
        return self._tokens[at] if at < len(self._tokens) else None

    def next(self) -> Token:
        """Take the next token."""
        if self._at >= len(self._tokens):
            raise Unrecognised
        self._at += 1
        return self._tokens[self._at - 1]

    def is_next(self, *marks: str) -> bool:
        """Whether one of these marks is next."""
        if self._at >= len(self._tokens):
            return False
        token = self._tokens[self._at]
        return token.kind is Kind.MARK and token.text in marks

    def is_word(self, *words: str) -> bool:
        """Whether one of these keywords is next."""
        token = self.peek()
        return token is not None and token.is_word(*words)

    def take(self, *marks: str) -> bool:
        """Take the next token if it is one of these marks."""
        taken = self.is_next(*marks)
        self._at += taken
        return taken

    def take_word(self, *words: str) -> bool:
        """Take the next token if it is one of these keywords."""
        taken = self.is_word(*words)
        self._at += taken
        return taken

    def expect(self, mark: str) -> None:
        """Take this mark."""
        if not self.take(mark):
            raise Unrecognised

    def prologue(self) -> None:
        """Take the declarations before a query or an operation."""
        while True:
            if self.take_word("PREFIX"):
                name, iri = self.next(), self.next()
                if name.kind is not Kind.NAME or name.text[-1] != ":" or iri.kind is not Kind.IRI:
                    raise Unrecognised
                self.prefix(name.text[:-1], self.iri(iri))
            elif self.take_word("BASE"):
                self.base(self.iri(self.next()))
            else:
                return

    def skip_group(self) -> None:
        """Pass over a group, whatever is in it."""
        self.expect("{")
        depth = 1
        while depth:
            token = self.next()
            depth += token.is_mark("{") - token.is_mark("}")

    def iri(self, token: Token) -> str:
        """The IRI that a token stands for."""
        if token.kind is Kind.IRI:
            return self.resolve(token.text[1:-1])
        if token.kind is not Kind.NAME:
            raise Unrecognised
        prefix, _, local = token.text.partition(":")
        if prefix not in self._prefixes:
            raise Unrecognised
        return self._prefixes[prefix] + _unslashed(local)

    def resolve(self, iri: str) -> str:
        """The IRI as the store will have it: whatever is not plainly absolute is resolved by its own parser."""
        iri = unescaped(iri)
        if _is_plain(iri):
            return iri
        try:
            [quad] = parse(f"<{iri}> <{TYPE}> <{TYPE}> .", RdfFormat.TURTLE, base_iri=self._base or None)
        except (SyntaxError, ValueError) as error:
            raise Unrecognised from error
        if not isinstance(quad.subject, NamedNode):
            raise Unrecognised
        return quad.subject.value


def _is_plain(iri: str) -> bool:
    scheme, colon, rest = iri.partition(":")
    return bool(colon) and scheme.isascii() and scheme.isalnum() and "/." not in rest and rest[:1] != "."


def _unslashed(local: str) -> str:
    """A local name without the backslashes that protect its punctuation."""
    if "\\" not in local:
        return local
    parts = iter(local)
    return "".join(next(parts, "") if character == "\\" else character for character in parts)
