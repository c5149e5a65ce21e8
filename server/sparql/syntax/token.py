"""Tokens and keywords of SPARQL, separate from the lexer, whose patterns take 50 ms to compile."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple


class Kind(Enum):
    """Kind of a token; `SPACE` and `COMMENT` are ignored, `ERROR` is not a valid token, `END` follows the last one."""

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
    """A piece of the text with its position."""

    kind: Kind
    text: str
    start: int

    @property
    def end(self) -> int:
        """Position after the last character."""
        return self.start + len(self.text)

    def is_mark(self, *marks: str) -> bool:
        """Whether the token is one of these punctuation marks."""
        return self.kind is Kind.MARK and self.text in marks

    def is_word(self, *words: str) -> bool:
        """Whether the token is one of these keywords, given in capitals."""
        return self.kind is Kind.WORD and self.text.upper() in words


def _split(text: str) -> tuple[str, ...]:
    return tuple(text.split())


FORMS = ("SELECT", "ASK", "CONSTRUCT", "DESCRIBE")
MEMBERS = ("OPTIONAL", "MINUS", "GRAPH", "SERVICE", "FILTER", "BIND", "VALUES", "LATERAL")
"""Keywords that start a member of a group other than triples. LATERAL is an extension of the store."""
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
    # of SPARQL 1.2, which the store may support
    **dict.fromkeys(
        _split("TRIPLE SUBJECT PREDICATE OBJECT ISTRIPLE LANGDIR HASLANG HASLANGDIR STRLANGDIR ADJUST"), ANY_NUMBER
    ),
}
"""Minimum and maximum number of arguments of each built-in function."""
KEYWORDS = frozenset(
    (
        *(*FORMS, *MEMBERS, *MODIFIERS, *AGGREGATES, *ARGUMENTS),
        *_split("WHERE PREFIX BASE FROM NAMED DISTINCT REDUCED AS BY ASC DESC UNION EXISTS NOT IN SILENT UNDEF"),
        *_split("SEPARATOR INSERT DELETE DATA WITH USING LOAD CLEAR DROP CREATE ADD MOVE COPY INTO TO DEFAULT ALL"),
    )
)
