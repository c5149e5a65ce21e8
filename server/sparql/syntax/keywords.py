"""The keywords of SPARQL 1.1, and how many arguments its functions take (19.8, rules 121 and 127)."""

from __future__ import annotations


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
