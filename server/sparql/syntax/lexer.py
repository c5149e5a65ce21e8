"""Lexer of SPARQL, linear in the size of the text, and the checks before the text reaches a parser (SPARQL 1.1, 19.8).

The store's parser is a native library: deep nesting and long chains overflow its stack and end the whole process, large
joins occupy its optimiser for minutes, and SERVICE and LOAD really send requests. None of this can be disabled or
stopped there, so it is rejected here, on tokens.

That parser needs no blank between keywords (it reads `SERVICESILENT` as two) and reads `<` as "less than" wherever an
operator may occur. So the checks hold for every way to split the text, not for one; comments are blanked before the
text is passed on, because there two readings could hide something from each other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from string import ascii_letters
from typing import NamedTuple

from msgspec import Struct

from rosld.server.http.problem import Problem
from rosld.server.sparql.syntax.token import Kind, Token


class QueryBounds(Struct, frozen=True):
    """Upper bounds for a query or an update.

    `size` is in characters; `depth` counts open brackets; `steps` are keywords, operators and brackets (each can add a
    frame to the parser's stack, which overflows near 2,000); `joins` are triple patterns, whose cube determines the
    optimiser's time (64 patterns on one variable take 0.1 s, 200 take 10 s).
    """

    size: int = 256 * 1024
    depth: int = 128
    steps: int = 1000
    joins: int = 64


DEFAULT_BOUNDS = QueryBounds()


class ServiceAllowlist(Struct, frozen=True):
    """Endpoints that a text may make the server call: URLs that SERVICE may name, compared as strings."""

    services: frozenset[str] = frozenset()


NO_SERVICES = ServiceAllowlist()

_BASE = (
    "A-Za-z\u00c0-\u00d6\u00d8-\u00f6\u00f8-\u02ff\u0370-\u037d\u037f-\u1fff\u200c\u200d\u2070-\u218f\u2c00-\u2fef"
    "\u3001-\ud7ff\uf900-\ufdcf\ufdf0-\ufffd\U00010000-\U000effff"
)
_MORE = "0-9\u00b7\u0300-\u036f\u203f\u2040"
_RUN = re.compile(f"[{_BASE}](?:[{_BASE}_{_MORE}.-]*[{_BASE}_{_MORE}-])?")
_WORD = re.compile(f"[{_BASE}][{_BASE}_{_MORE}-]*")
_ENCODED = r"%[0-9A-Fa-f]{2}|\\[_~.\-!$&'()*+,;=/?#@%]"
_LOCAL = re.compile(rf"(?:[{_BASE}_:0-9]|{_ENCODED})(?:[{_BASE}_{_MORE}:.-]|{_ENCODED})*")
_SPACE = re.compile(r"[ \t\r\n]+")
_TOKEN = re.compile(
    "|".join(
        f"(?P<{kind}>{pattern})"
        for kind, pattern in (
            ("SPACE", _SPACE.pattern),
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
_ESCAPED = re.compile(r"\\(?:u([0-9A-Fa-f]{4})|U([0-9A-Fa-f]{8})|.)", re.DOTALL)
_OF_NAMES = re.compile(f"[{_BASE}{_MORE}_:.-]")
_SERVICE = re.compile("service", re.IGNORECASE)
_UPDATES = frozenset({"INSERT", "DELETE", "LOAD", "CLEAR", "DROP", "CREATE", "ADD", "MOVE", "COPY", "WITH"})
_OPEN, _CLOSE = frozenset("([{"), frozenset(")]}")
_NEW_MARKS = frozenset({"<<", ">>", "{|", "|}", "~"})
_NO_STEPS = frozenset({".", ",", ";", "^^"})


def tokens(text: str, at: int = 0, *, spaces: bool = True) -> Iterator[Token]:
    """Yield the tokens from `at`, comments included; with `spaces`, their texts join to the text, even if invalid."""
    scanned = 0
    while at < len(text):
        if not spaces and (space := _SPACE.match(text, at)):
            at = space.end()
            continue
        if word := _WORD.match(text, at):
            # A prefix may contain dots, so a run must be read to its end to see whether a colon follows. A run without
            # one is not read again from its middle, or `a.a.a.a` would take quadratic time.
            run = word if at < scanned else _RUN.match(text, at) or word
            colon = text.startswith(":", run.end())
            token = Token(Kind.NAME, _name(text, at, run.end()), at) if colon else Token(Kind.WORD, word[0], at)
            scanned = max(scanned, run.end())
        elif text[at] == ":":
            token = Token(Kind.NAME, _name(text, at, at), at)
        else:
            token = _other(text, at)
        yield token
        at = token.end


def _name(text: str, at: int, colon: int) -> str:
    """Return the prefixed name that starts at `at`; a final dot is a full stop."""
    local = _LOCAL.match(text, colon + 1)
    end = colon + 1 if local is None else local.end()
    while end > colon + 1 and text[end - 1] == "." and text[end - 2] != "\\":
        end -= 1
    return text[at:end]


def _other(text: str, at: int) -> Token:
    match = _TOKEN.match(text, at)
    if match is None:  # an unterminated string extends to the end of the text
        return Token(Kind.ERROR, text[at:] if text[at] in "\"'" else text[at], at)
    return Token(_KINDS[match.lastgroup or ""], match[0], at)


def unescape_codepoints(text: str) -> str:
    """Replace codepoint escapes (SPARQL 1.1, 19.2). Raises Problem 400 for one that is not a character."""
    return _ESCAPE.sub(_character, text)


def _character(match: re.Match[str]) -> str:
    code = int(match[1] or match[2], 16)
    if code > 0x10FFFF or 0xD800 <= code < 0xE000:
        raise Problem(400, f"{match[0]} is not a Unicode character.")
    return chr(code)


class CheckedText(NamedTuple):
    """A text that may be parsed: comments are blanked, positions unchanged. `tokens` exclude spaces and comments.

    `written` is the original text, `what` its kind in error messages.
    """

    text: str
    tokens: tuple[Token, ...]
    written: str
    what: str = "query"


def check_text(
    text: str, bounds: QueryBounds = DEFAULT_BOUNDS, *, what: str = "query", reach: ServiceAllowlist = NO_SERVICES
) -> CheckedText:
    """Return the text if the store's parser may read it.

    Escapes in names are replaced, and prefixes in which that parser might find SERVICE are renamed. Raises Problem 413
    for a text that is too long, and 400 for invalid characters, nesting or length beyond the bounds, triple terms, and
    SERVICE calls that `reach` does not allow.
    """
    if len(text) > bounds.size:
        raise Problem(413, f"The {what} has {len(text)} characters; the limit is {bounds.size}.")
    if "\\" in text:
        text = unescape_names(text)
    comments: list[Token] = []
    meaning: list[Token] = []
    for token in tokens(text, spaces=False):
        (comments if token.kind is Kind.COMMENT else meaning).append(token)
    found = tuple(meaning)
    _check_tokens(found, text)
    if _SERVICE.search(text):
        _check_services(found, text, reach)
    _check_shape(found, text, bounds, what)
    return _rename(CheckedText(_blank_comments(text, comments), found, text, what), _SERVICE)


def _blank_comments(text: str, comments: Sequence[Token]) -> str:
    """Return the text with comments replaced by spaces."""
    pieces: list[str] = []
    at = 0
    for comment in comments:
        pieces += (text[at : comment.start], " " * len(comment.text))
        at = comment.end
    return "".join((*pieces, text[at:]))


def unescape_names(text: str) -> str:
    """Replace the escapes (19.2) of name characters outside of strings and IRIs."""
    pieces: list[str] = []
    at = 0
    while at < len(text):
        for token in tokens(text, at):
            at = token.end
            escape = _ESCAPE.match(text, token.start) if token.kind is Kind.ERROR else None
            if escape is not None and _OF_NAMES.match(_character(escape)):
                pieces.append(_character(escape))
                at = escape.end()
                break
            pieces.append(token.text)
    return "".join(pieces)


def _mask_keywords(name: str, keywords: re.Pattern[str], letter: str) -> Iterator[str]:
    """Yield the pieces of a name with every letter of the keywords in it replaced by `letter`."""
    at = 0
    for match in keywords.finditer(name):
        yield name[at : match.start()] + letter * len(match[0])
        at = match.end()
    yield name[at:]


def _rename(checked: CheckedText, keywords: re.Pattern[str]) -> CheckedText:
    """Rename, at the same length, prefixes that contain a keyword, which another parser might split off."""
    if not keywords.search(checked.text):
        return checked
    used = {token.text.partition(":")[0] for token in checked.tokens if token.kind is Kind.NAME}
    names: dict[str, str] = {}
    for name in sorted(used):
        if keywords.search(name):
            others = ("".join(_mask_keywords(name, keywords, letter)) for letter in ascii_letters)
            names[name] = next(other for other in others if other not in used and not keywords.search(other))
            used.add(names[name])
    if not names:
        return checked
    text = [*checked.text]
    found: list[Token] = []
    for token in checked.tokens:
        prefix = token.text.partition(":")[0]
        if token.kind is Kind.NAME and prefix in names:
            token = token._replace(text=names[prefix] + token.text[len(prefix) :])
            text[token.start : token.end] = token.text
        found.append(token)
    return checked._replace(text="".join(text), tokens=tuple(found))


def _check_targets(found: tuple[Token, ...], text: str, keyword: str, allowed: frozenset[str]) -> None:
    """Check that the keyword (and SILENT) is followed by one of these URLs, written in full."""
    for at, token in enumerate(found):
        if token.is_word(keyword):
            following = found[at + 1 : at + 3]
            target = following[-1] if following and following[0].is_word("SILENT") else (*following, None)[0]
            if target is None or target.kind is not Kind.IRI or target.text[1:-1] not in allowed:
                named = "nothing" if target is None else target.text
                raise Problem(
                    400,
                    f"{keyword} at {line_and_column(text, token.start)} names {named}: this server contacts only the "
                    "URLs in its settings; use the full URL.",
                )


def _check_tokens(found: tuple[Token, ...], text: str) -> None:
    for token in found:
        if token.kind is Kind.MARK:
            if token.text in _NEW_MARKS:
                where = line_and_column(text, token.start)
                raise Problem(400, f"{token.text} at {where}: triple terms and reifiers are not supported.")
        elif (token.kind is Kind.ERROR or "\\" in token.text) and (wrong := lexical_error(token, text)):
            raise Problem(400, wrong)


def _check_services(found: tuple[Token, ...], text: str, reach: ServiceAllowlist) -> None:
    for token in found:
        if (
            token.kind is Kind.WORD
            and _SERVICE.search(token.text)
            and not (reach.services and token.is_word("SERVICE"))
        ):
            raise Problem(
                400,
                f"SERVICE at {line_and_column(text, token.start)} is refused: this server contacts no other endpoints.",
            )
    _check_targets(found, text, "SERVICE", reach.services)


def lexical_error(token: Token, text: str) -> str | None:
    """Return a sentence on why a piece of the text is not a SPARQL token, None for a valid token."""
    wrong: str | None = None
    if token.kind is Kind.ERROR:
        wrong = _unread(token.text)
    elif "\\" in token.text and token.kind is Kind.STRING:
        wrong = next((words for each in _ESCAPED.finditer(token.text) if (words := _wrong_escape(each))), None)
    elif "\\" in token.text and token.kind is Kind.IRI:
        wrong = _wrong_iri(token.text)
    return wrong and wrong.format(where=line_and_column(text, token.start))


def _unread(token: str) -> str:
    if token[0] in "\"'":
        return "The string that begins at {where} is not closed."
    if token == "\\":
        return "The backslash at {where} is not a valid escape there."
    return f"{token!a} at {{where}} is not valid in SPARQL."


def _wrong_escape(escape: re.Match[str]) -> str | None:
    if len(escape[0]) == 2:
        known = escape[0][1] in "tbnrf\"'\\"
        return None if known else "The string at {where} has an invalid escape: write a backslash as two."
    _character(escape)
    return None


def _wrong_iri(iri: str) -> str | None:
    escaped = (_character(match) for match in _ESCAPE.finditer(iri))
    if any(each in '"\\<>{}|^`' or ord(each) <= 0x20 for each in escaped):
        return "The IRI at {where} escapes a character that IRIs cannot contain."
    return "The IRI at {where} contains a backslash, which is not allowed." if "\\" in _ESCAPE.sub("", iri) else None


def _check_shape(found: tuple[Token, ...], text: str, bounds: QueryBounds, what: str) -> None:
    """Check the bounds on depth and steps. Data may be long: the blocks after VALUES and DATA do not count as steps."""
    depth = steps = 0
    data: int | None = None
    for token in found:
        if token.kind is Kind.MARK and token.text in _OPEN:
            depth += 1
            if depth > bounds.depth:
                raise Problem(
                    400,
                    f"The {what} nests deeper than {bounds.depth} brackets at {line_and_column(text, token.start)}.",
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
        raise Problem(400, f"The {what} has {steps} keywords, operators and brackets; the limit is {bounds.steps}.")


def line_and_column(text: str, at: int) -> str:
    """Format a position like the store's parser: line:column, both from 1."""
    before = text[:at]
    return f"{before.count(chr(10)) + 1}:{at - (before.rfind(chr(10)) + 1) + 1}"


def check_update_of_one_graph(text: str, bounds: QueryBounds = DEFAULT_BOUNDS) -> CheckedText:
    """Return the checked text of a SPARQL Update that is limited to its default graph.

    Raises Problems as `check_text` does, and 422 for GRAPH, WITH, USING, LOAD, FROM and operations on whole graphs. The
    check works on letters, wherever a keyword could be split off.
    """
    checked = _rename(check_text(text, bounds, what="update"), _FOREIGN_KEYWORDS)
    for token in checked.tokens:
        if token.kind is Kind.WORD and (keyword := _foreign_keyword(token.text.upper())):
            where = line_and_column(text, token.start)
            raise Problem(422, f"{keyword} at {where}: an update here can change only this resource.")
    return checked


def _foreign_keyword(word: str) -> str | None:
    return next((each for each in _FOREIGN if word == each or (len(each) > 3 and each in word)), None)


_FOREIGN = ("GRAPH", "WITH", "USING", "LOAD", "CLEAR", "DROP", "CREATE", "ADD", "MOVE", "COPY", "FROM")
_FOREIGN_KEYWORDS = re.compile("|".join(_FOREIGN), re.IGNORECASE)


def update_keyword(found: tuple[Token, ...]) -> str | None:
    """Return the keyword of the first operation if these tokens are an update, else None."""
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
