"""Tokens and keywords of SPARQL. Apart from the lexer: its patterns take 50 ms to compile, which trees do not need."""

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


def _split(text: str) -> tuple[str, ...]:
    return tuple(text.split())


FORMS = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
MEMBERS = ("OPTIONAL", "MINUS", "GRAPH", "SERVICE", "FILTER", "BIND", "VALUES", "LATERAL")
"""The keywords that begin something of a group that is no triple. LATERAL is the store's own."""
MODIFIERS = ("GROUP", "HAVING", "ORDER", "LIMIT", "OFFSET", "VALUES")
AGGREGATES = frozenset(_split("COUNT SUM MIN MAX AVG SAMPLE GROUP_CONCAT"))
ANY_NUMBER = (0, 1000)
ARGUMENTS = {
    **dict.fromkeys(_split("NOW RAND UUID STRUUID"), (0, 0)),
    **dict.fromkeys(
        _split(
            "STR LANG DATATYPE IRI URI ABS CEIL FLOOR ROUND STRLEN UCASE LCASE ENCODE_FOR_URI YEAR MONTH DAY HOURS "
            "MINUTES SECONDS TIMEZONE TZ MD5 SHA1 SHA256 SHA384 SHA512 ISIRI ISURI ISBLANK ISLITERAL ISNUMERIC BOUND"
        ),
        (1, 1),
    ),
    **dict.fromkeys(_split("LANGMATCHES CONTAINS STRSTARTS STRENDS STRBEFORE STRAFTER STRLANG STRDT SAMETERM"), (2, 2)),
    **dict.fromkeys(_split("REGEX SUBSTR"), (2, 3)),
    **dict.fromkeys(_split("COALESCE CONCAT"), ANY_NUMBER),
    "BNODE": (0, 1),
    "IF": (3, 3),
    "REPLACE": (3, 4),
    # of SPARQL 1.2: the store may know them
    **dict.fromkeys(
        _split("TRIPLE SUBJECT PREDICATE OBJECT ISTRIPLE LANGDIR HASLANG HASLANGDIR STRLANGDIR ADJUST"), ANY_NUMBER
    ),
}
"""The least and the most arguments of each function that has a name of its own."""
KEYWORDS = frozenset(
    (
        *(*FORMS, *MEMBERS, *MODIFIERS, *AGGREGATES, *ARGUMENTS),
        *_split("WHERE PREFIX BASE FROM NAMED DISTINCT REDUCED AS BY ASC DESC UNION EXISTS NOT IN SILENT UNDEF"),
        *_split("SEPARATOR INSERT DELETE DATA WITH USING LOAD CLEAR DROP CREATE ADD MOVE COPY INTO TO DEFAULT ALL"),
    )
)
