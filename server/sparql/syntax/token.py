"""The tokens of SPARQL as values. Apart from the lexer: its patterns take 50 ms to compile, which trees do not need."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Kind(Enum):
    """The kinds of token; `SPACE` and `COMMENT` mean nothing, `ERROR` begins no token, `END` follows the last."""

    IRI = "iri"
    NAME = "prefixed name"
    BLANK = "blank node label"
    VARIABLE = "variable"
    STRING = "string"
    LANGUAGE = "language tag"
    NUMBER = "number"
    WORD = "word"
    MARK = "mark"
    SPACE = "space"
    COMMENT = "comment"
    ERROR = "error"
    END = "end"


class Token(NamedTuple):
    """A piece of the text as it stands there, and where it begins."""

    kind: Kind
    text: str
    start: int

    @property
    def end(self) -> int:
        """Where the next token begins."""
        return self.start + len(self.text)

    def is_mark(self, *marks: str) -> bool:
        """Whether it is one of these punctuation marks."""
        return self.kind is Kind.MARK and self.text in marks

    def is_word(self, *words: str) -> bool:
        """Whether it is one of these keywords, given in capitals."""
        return self.kind is Kind.WORD and self.text.upper() in words
