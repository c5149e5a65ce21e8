"""SPARQL's tokens, in time linear in the text, and what is refused before a parser sees it (SPARQL 1.1, 19.8).

The store's parser is a native library: deep nesting and long chains overflow its stack and end the whole process,
large joins keep its optimiser busy for minutes, and SERVICE and LOAD really call out. None of this can be switched
off or stopped there, so it is refused here, on tokens, before.

That parser asks for no blank between keywords (`SERVICESILENT` is two of them to it) and reads `<` as "less than"
wherever an operator may stand. So the checks hold for every way to cut the text, not for one; comments are blanked
before the text goes on, as the one place where two readings could hide something from each other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from rosld.server.http.problem import Problem


class Kind(Enum):
    """The kinds of token; `SPACE` and `COMMENT` mean nothing, `ERROR` is what begins no token."""

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


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a query or an update may be at most.

    `size` is in characters; `depth` counts open brackets; `steps` are keywords, operators and brackets (each can be
    one more frame on the parser's stack: it overflows near 2,000); `joins` are triple patterns, which is what the
    optimiser's time grows with (its cube: 64 patterns on one variable take 0.1 s, 200 take 10 s).
    """

    size: int = 64 * 1024
    depth: int = 128
    steps: int = 1000
    joins: int = 64


BOUNDS = Bounds()


@dataclass(frozen=True, slots=True)
class Reach:
    """Where a text may have the server send requests to: URLs that SERVICE may name, letter by letter."""

    services: frozenset[str] = frozenset()


NOWHERE = Reach()

_BASE = (
    "A-Za-z\u00c0-\u00d6\u00d8-\u00f6\u00f8-\u02ff\u0370-\u037d\u037f-\u1fff\u200c\u200d\u2070-\u218f\u2c00-\u2fef"
    "\u3001-\ud7ff\uf900-\ufdcf\ufdf0-\ufffd\U00010000-\U000effff"
)
_MORE = "0-9\u00b7\u0300-\u036f\u203f\u2040"
_RUN = re.compile(f"[{_BASE}](?:[{_BASE}_{_MORE}.-]*[{_BASE}_{_MORE}-])?")
_WORD = re.compile(f"[{_BASE}][{_BASE}_{_MORE}-]*")
_ENCODED = r"%[0-9A-Fa-f]{2}|\\[_~.\-!$&'()*+,;=/?#@%]"
_LOCAL = re.compile(rf"(?:[{_BASE}_:0-9]|{_ENCODED})(?:[{_BASE}_{_MORE}:.-]|{_ENCODED})*")
_TOKEN = re.compile(
    "|".join(
        f"(?P<{kind}>{pattern})"
        for kind, pattern in (
            ("SPACE", r"[ \t\r\n]+"),
            ("COMMENT", r"#[^\r\n]*"),
            ("IRI", r"<[^\x00-\x20<>\"{}|^`]*>"),
            ("STRING", r'"""(?:[^"\\]|\\.|"(?!""))*"""' r"|'''(?:[^'\\]|\\.|'(?!''))*'''"),
            ("STRING1", r'"(?!"")(?:[^"\\\r\n]|\\.)*"' r"|'(?!'')(?:[^'\\\r\n]|\\.)*'"),
            ("VARIABLE", rf"[?$][{_BASE}_0-9][{_BASE}_{_MORE}]*"),
            ("BLANK", rf"_:[{_BASE}_0-9](?:[{_BASE}_{_MORE}.-]*[{_BASE}_{_MORE}-])?"),
            ("LANGUAGE", r"@[A-Za-z]+(?:-[A-Za-z0-9]+)*"),
            ("NUMBER", r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][+-]?[0-9]+|[0-9]*\.[0-9]+|[0-9]+"),
            ("MARK", r"\^\^|&&|\|\||!=|<=|>=|<<|>>|\{\||\|\}|[][(){}.,;?*/|+!^<>=~@-]"),
        )
    ),
    re.DOTALL,
)
_KINDS = {**Kind.__members__, "STRING1": Kind.STRING}
_ESCAPE = re.compile(r"\\u([0-9A-Fa-f]{4})|\\U([0-9A-Fa-f]{8})")
_UPDATES = frozenset({"INSERT", "DELETE", "LOAD", "CLEAR", "DROP", "CREATE", "ADD", "MOVE", "COPY", "WITH"})
_OPEN, _CLOSE = frozenset("([{"), frozenset(")]}")
_NO_STEPS = frozenset({".", ",", ";", "^^"})


def tokens(text: str) -> Iterator[Token]:
    """All tokens in order, space and comments included: their texts, joined, are `text`, whatever it is."""
    at = seen = 0
    while at < len(text):
        if word := _WORD.match(text, at):
            # A prefix may hold dots, so a run must be read to its end to know whether a colon follows. A run that is
            # none is not read again from its middle, or `a.a.a.a` would cost the square of its length.
            run = word if at < seen else _RUN.match(text, at) or word
            colon = text.startswith(":", run.end())
            token = Token(Kind.NAME, _name(text, at, run.end()), at) if colon else Token(Kind.WORD, word[0], at)
            seen = max(seen, run.end())
        elif text[at] == ":":
            token = Token(Kind.NAME, _name(text, at, at), at)
        else:
            token = _other(text, at)
        yield token
        at = token.end


def _name(text: str, at: int, colon: int) -> str:
    """The prefixed name that begins at `at`; a dot at its end is a full stop."""
    local = _LOCAL.match(text, colon + 1)
    end = colon + 1 if local is None else local.end()
    while end > colon + 1 and text[end - 1] == "." and text[end - 2] != "\\":
        end -= 1
    return text[at:end]


def _other(text: str, at: int) -> Token:
    match = _TOKEN.match(text, at)
    if match is None:  # a string without an end leaves nothing to be cut after it
        return Token(Kind.ERROR, text[at:] if text[at] in "\"'" else text[at], at)
    return Token(_KINDS[match.lastgroup or ""], match[0], at)


def unescaped(text: str) -> str:
    """Text with its codepoint escapes (SPARQL 1.1, 19.2) replaced. Raises Problem 400 for one that is no character."""
    return _ESCAPE.sub(_character, text)


def _character(match: re.Match[str]) -> str:
    code = int(match[1] or match[2], 16)
    if code > 0x10FFFF or 0xD800 <= code < 0xE000:
        raise Problem(400, f"{match[0]} is no Unicode character.")
    return chr(code)


class Checked(NamedTuple):
    """A text fit to be parsed: comments are blanked, positions as they were. `tokens` are those that mean something."""

    text: str
    tokens: tuple[Token, ...]


def check(text: str, bounds: Bounds = BOUNDS, *, what: str = "query", reach: Reach = NOWHERE) -> Checked:
    """The text, if it may be shown to the store's parser at all.

    Raises Problems: 413 too long, 400 for characters that cannot be there, nesting or length beyond the bounds, escapes
    outside strings and IRIs, triple terms, and SERVICE beyond the reach.
    """
    if len(text) > bounds.size:
        raise Problem(413, f"The {what} has {len(text)} characters; at most {bounds.size} are read.")
    meaning: list[Token] = []
    pieces: list[str] = []
    for token in tokens(text):
        pieces.append(" " * len(token.text) if token.kind is Kind.COMMENT else token.text)
        if token.kind is not Kind.SPACE and token.kind is not Kind.COMMENT:
            _check_token(token, text, reach)
            meaning.append(token)
    found = tuple(meaning)
    _check_targets(found, text, "SERVICE", reach.services)
    _check_shape(found, text, bounds, what)
    return Checked("".join(pieces), found)


def _check_targets(found: tuple[Token, ...], text: str, keyword: str, allowed: frozenset[str]) -> None:
    """Hold that what follows the keyword (and SILENT) is one of these URLs, written in full."""
    for at, token in enumerate(found):
        if token.is_word(keyword):
            following = found[at + 1 : at + 3]
            target = following[-1] if following and following[0].is_word("SILENT") else (*following, None)[0]
            if target is None or target.kind is not Kind.IRI or target.text[1:-1] not in allowed:
                named = "nothing" if target is None else target.text
                raise Problem(
                    400,
                    f"{keyword} at {place(text, token.start)} names {named}: this server asks only what its settings "
                    "list, by its whole URL.",
                )


def _check_token(token: Token, text: str, reach: Reach) -> None:
    if token.kind is Kind.ERROR:
        raise Problem(400, f"{_unread(token, text)} at {place(text, token.start)} begins nothing of SPARQL.")
    if token.kind in (Kind.WORD, Kind.NAME):
        word = token.text.partition(":")[0]
        if reach.services and token.is_word("SERVICE"):
            return
        if "SERVICE" in word.upper() or "service" in word.casefold():
            raise Problem(
                400,
                f"SERVICE at {place(text, token.start)} is refused: this server asks no other. "
                "(A prefix cannot have this name either.)",
            )
    elif token.kind in (Kind.STRING, Kind.IRI) and "\\" in token.text:
        _check_escapes(token, text)
    elif token.is_mark("<<", ">>", "{|", "|}", "~"):
        raise Problem(400, f"{token.text} at {place(text, token.start)}: triple terms and reifiers are not known here.")


def _unread(token: Token, text: str) -> str:
    if token.text[0] in "\"'":
        return "The string without an end"
    if token.text == "\\":
        return "An escape outside strings and IRIs"
    return repr(token.text)


def _check_escapes(token: Token, text: str) -> None:
    """An escaped character must not be one that would end the token, were escapes replaced before all else (19.2)."""
    for match in _ESCAPE.finditer(token.text):
        if _character(match) in "\"'\\<>{}|^`" or ord(_character(match)) <= 0x20:
            raise Problem(400, f"Write the character {match[0]} at {place(text, token.start)} in another way.")
    if token.kind is Kind.IRI and "\\" in _ESCAPE.sub("", token.text):
        raise Problem(400, f"The IRI at {place(text, token.start)} holds a backslash.")


def _check_shape(found: tuple[Token, ...], text: str, bounds: Bounds, what: str) -> None:
    """Check the bounds on depth and steps. Data may be long: what stands in a block after VALUES or DATA is no step."""
    depth = steps = 0
    data: int | None = None
    for token in found:
        if token.kind is Kind.MARK and token.text in _OPEN:
            depth += 1
            if depth > bounds.depth:
                raise Problem(
                    400, f"The {what} nests deeper than {bounds.depth} brackets at {place(text, token.start)}."
                )
        elif token.kind is Kind.MARK and token.text in _CLOSE:
            depth -= 1
            if data == depth and token.text == "}":
                data = None
        if data is None and token.kind in (Kind.MARK, Kind.WORD) and token.text not in _NO_STEPS:
            steps += 1
        if data is None and token.kind is Kind.WORD and token.text.upper().endswith(("VALUES", "DATA")):
            data = depth
    if steps > bounds.steps:
        raise Problem(
            400, f"The {what} has {steps} keywords, operators and brackets; at most {bounds.steps} are taken."
        )


def place(text: str, at: int) -> str:
    """A position as the store's parser tells it: line:column, both from 1."""
    before = text[:at]
    return f"{before.count(chr(10)) + 1}:{at - (before.rfind(chr(10)) + 1) + 1}"


def check_update_of_one_graph(text: str, bounds: Bounds = BOUNDS) -> None:
    """Let pass only a SPARQL Update of its default graph and nothing else.

    Raises Problems: as `check`, and 422 for what reaches beyond: GRAPH, WITH, USING, LOAD, FROM, and operations on
    whole graphs. The check is on letters, wherever a keyword could be cut from them.
    """
    for token in check(text, bounds, what="update").tokens:
        if token.kind in (Kind.WORD, Kind.NAME) and (keyword := _beyond(token)):
            where = place(text, token.start)
            raise Problem(422, f"{keyword} at {where}: an update here concerns this one resource only.")


def _beyond(token: Token) -> str | None:
    word = token.text.partition(":")[0].upper()
    for keyword in _BEYOND:
        if word == keyword or (len(keyword) > 3 and (word.startswith(keyword) or _within(keyword, token))):
            return keyword
    return None


def _within(keyword: str, token: Token) -> bool:
    return token.kind is Kind.WORD and keyword in token.text.upper()


_BEYOND = ("GRAPH", "WITH", "USING", "LOAD", "CLEAR", "DROP", "CREATE", "ADD", "MOVE", "COPY", "FROM")


def update_keyword(found: tuple[Token, ...]) -> str | None:
    """The keyword of the first operation if these tokens are an update, None for anything else."""
    skipping = 0
    for token in found:
        if skipping:
            skipping -= 1
        elif token.is_word("PREFIX"):
            skipping = 2
        elif token.is_word("BASE"):
            skipping = 1
        else:
            return token.text.upper() if token.is_word(*_UPDATES) else None
    return None
