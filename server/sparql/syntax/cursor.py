"""A cursor over the tokens of a text, which resolves prefixed names and IRIs and reports syntax errors."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from difflib import get_close_matches
from typing import NoReturn, Protocol

from pyoxigraph import NamedNode, RdfFormat, parse

from rosld.ontology.body import expanded_body_error, expansion_limit
from rosld.server.http.problem import Problem
from rosld.server.sparql.syntax.lexer import CheckedText, line_and_column, unescape_codepoints
from rosld.server.sparql.syntax.token import KEYWORDS, Kind, Token
from rosld.server.sparql.syntax.tree import TYPE

_MAX_QUOTED = 40


class Span(Protocol):
    """A piece of the text, from `start` up to and excluding `end`."""

    @property
    def start(self) -> int:
        """Position of its first character."""
        ...

    @property
    def end(self) -> int:
        """Position after its last character."""
        ...


class Cursor:
    """Reader of tokens. `token` is the next one, `key` its mark or its keyword in capitals ("" for others).

    Its methods raise a Problem 400 for unexpected tokens: one sentence with the token, its position and what was
    expected.
    """

    def __init__(self, checked: CheckedText, prefixes: Mapping[str, str], base: str) -> None:
        self.text = checked.text
        self.prefixes = dict(prefixes)
        self.base = base
        self._left = expansion_limit(len(checked.text))
        self._written = checked.written
        self._what = checked.what
        self._tokens = (*checked.tokens, Token(Kind.END, "", len(checked.text)))
        self._at = -1
        self.token = self._tokens[-1]
        self.key = ""
        self.advance()

    def advance(self) -> Token:
        """Take the next token, which must not be the end."""
        taken = self.token
        self._at += 1
        self.token = token = self._tokens[self._at]
        kind = token.kind
        self.key = token.text if kind is Kind.MARK else token.text.upper() if kind is Kind.WORD else ""
        return taken

    @property
    def is_at_end(self) -> bool:
        """Whether no token is left."""
        return self.token.kind is Kind.END

    @property
    def position(self) -> int:
        """Number of tokens taken."""
        return self._at

    def taken_since(self, position: int) -> tuple[Token, ...]:
        """Return the tokens taken since a position."""
        return self._tokens[position : self._at]

    @property
    def following(self) -> Token:
        """The token after the next one."""
        return self._tokens[min(self._at + 1, len(self._tokens) - 1)]

    @property
    def end(self) -> int:
        """End of the last token taken."""
        return self._tokens[self._at - 1].end

    def take(self, *keys: str) -> bool:
        """Take the next token if it is one of these marks or keywords; return whether it was."""
        if self.key in keys and self.key:
            self.advance()
            return True
        return False

    def expect(self, key: str, why: str = "") -> Token:
        """Take this mark or keyword; `why` states its purpose in the error message."""
        if self.key != key:
            self.fail_expecting(f"{key} {why}".rstrip())
        return self.advance()

    def expect_variable(self, expected: str = "a variable") -> Token:
        """Take a variable."""
        if self.token.kind is not Kind.VARIABLE:
            self.fail_expecting(expected)
        return self.advance()

    # --- IRIs

    def prologue(self) -> None:
        """Take the declarations before a query or an operation."""
        while True:
            if self.take("PREFIX"):
                name = self.token
                if name.kind is Kind.END:
                    self.fail_expecting("the name of a prefix, such as ex:,")
                if name.kind is not Kind.NAME or name.text.index(":") != len(name.text) - 1:
                    self.fail_at(name, "is not a prefix name: it must end in a colon and contain no other, such as ex:")
                self.advance()
                self.prefixes[name.text[:-1]] = self._declared_iri(name.text)
            elif self.take("BASE"):
                self.base = self._declared_iri("BASE")
            else:
                return

    def _declared_iri(self, name: str) -> str:
        if self.token.kind is not Kind.IRI:
            self.fail_expecting(f"the IRI of {name} in <>")
        return self.iri(self.advance())

    def expect_iri(self, expected: str = "an IRI") -> str:
        """Take an IRI or a prefixed name and return the IRI."""
        if self.token.kind is not Kind.IRI and self.token.kind is not Kind.NAME:
            self.fail_expecting(expected)
        iri = self.iri(self.token)
        self.advance()
        return iri

    def iri(self, token: Token) -> str:
        """Return the IRI of a token. Raises a Problem 413 if all IRIs together are too long for the text's size."""
        iri = self._resolve(token) if token.kind is Kind.IRI else self._expand(token)
        self._left -= len(iri)
        if self._left < 0:
            raise Problem(413, str(expanded_body_error(len(self.text))))
        return iri

    def _expand(self, token: Token) -> str:
        prefix, _, local = token.text.partition(":")
        namespace = self.prefixes.get(prefix)
        if namespace is None:
            written = self._written[token.start : token.start + len(prefix)]
            near = did_you_mean(written, self.prefixes, ":")
            where = line_and_column(self.text, token.start)
            raise Problem(400, f"The prefix {_short(written)}: is not declared{near}, at {where}.")
        return namespace + (_unslash(local) if "\\" in local else local)

    def _resolve(self, token: Token) -> str:
        """Return the IRI as the store will resolve it; its own parser resolves IRIs that are not plainly absolute."""
        iri = token.text[1:-1]
        if "\\" in iri:
            iri = unescape_codepoints(iri)
        if _is_plain(iri):
            return iri
        try:
            [quad] = parse(f"<{iri}> <{TYPE}> <{TYPE}> .", RdfFormat.TURTLE, base_iri=self.base or None)
        except (SyntaxError, ValueError):
            self.fail_at(token, "is not an IRI, or a relative one without a base")
        assert isinstance(quad.subject, NamedNode)
        return quad.subject.value

    # --- words

    def fail_at(self, span: Span, words: str) -> NoReturn:
        """Raise a Problem about a piece of the text."""
        raise Problem(400, f"{self._where_is(span)} {words}.")

    def fail_expecting(self, expected: str) -> NoReturn:
        """Raise a Problem: the next token is not what was expected."""
        token = self.token
        if token.kind is Kind.END:
            words = f"The {self._what} ends where {expected} is expected"
            if opened := self._innermost_open():
                words += f", and {self._where_is(opened)} is not closed"
            raise Problem(400, f"{words}.")
        if self.key == "<":
            self.fail_at(token, "does not begin an IRI: it is not closed, or contains a space, a quote or a bracket")
        if token.kind is Kind.WORD and self.key not in ("A", "TRUE", "FALSE") and self.key not in KEYWORDS:
            near = did_you_mean(self.key, KEYWORDS)
            self.fail_at(token, f"is not a SPARQL keyword{near}; expected {expected}")
        self.fail_at(token, f"is unexpected; expected {expected}")

    def fail_unknown(self, expected: str) -> NoReturn:
        """Raise a Problem: the next token is not a term."""
        if self.token.kind is Kind.WORD and self.key not in KEYWORDS:
            hint = "put it in quotes, or write it as a variable (?) or with a prefix"
            self.fail_at(self.token, f"is not a term{did_you_mean(self.key, KEYWORDS)}: {hint}")
        self.fail_expecting(expected)

    def _where_is(self, span: Span) -> str:
        return f"{_short(self._written[span.start : span.end])} at {line_and_column(self.text, span.start)}"

    def _innermost_open(self) -> Token | None:
        opened: list[Token] = []
        for token in self._tokens[: self._at]:
            if token.is_mark("(", "[", "{"):
                opened.append(token)
            elif token.is_mark(")", "]", "}") and opened:
                opened.pop()
        return opened[-1] if opened else None


def did_you_mean(text: str, known: Collection[str], mark: str = "") -> str:
    """Return a suggestion in brackets after a blank, or an empty string if no known text is similar."""
    found = get_close_matches(text, sorted(known), 1, 0.8) if len(text) <= _MAX_QUOTED else []
    return f" ({found[0]}{mark}?)" if found else ""


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _MAX_QUOTED else f"{line[: _MAX_QUOTED - 3]}..."


def _is_plain(iri: str) -> bool:
    scheme, colon, rest = iri.partition(":")
    return bool(colon) and scheme.isascii() and scheme.isalnum() and "/." not in rest and rest[:1] != "."


def _unslash(local: str) -> str:
    """Remove the backslashes that escape punctuation in a local name."""
    parts = iter(local)
    return "".join(next(parts, "") if character == "\\" else character for character in parts)
