"""Templates: the quads between the braces of INSERT and DELETE, read by the parser of TriG.

What may stand there is TriG with variables, and few differences: a variable becomes an IRI that nobody can guess, the
full stops that TriG wants are put where SPARQL lets them be left out, and what only TriG allows is refused before.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from pyoxigraph import BlankNode, DefaultGraph, NamedNode, Quad, RdfFormat, Triple, parse

from rosld.server.http.problem import Problem
from rosld.server.sparql.lexer import Kind, Token, place
from rosld.server.sparql.update.operations import Hole, QuadTemplate, Slot

_HOLE = f"urn:x-hole:{secrets.token_hex(16)}:"
_WORDS = frozenset({"A", "TRUE", "FALSE"})
_OPEN, _CLOSE = "([{", ")]}"


def read_template(
    found: Sequence[Token], text: str, prefixes: Mapping[str, str], base: str
) -> tuple[QuadTemplate, ...]:
    """The quads of a block, whose tokens within the braces are `found`; `prefixes` are all that hold there.

    Raises a 400 Problem for what is no block of quads, saying where.
    """
    if not found:
        return ()
    used = {token.text.partition(":")[0] for token in found if token.kind is Kind.NAME}
    for name in used - prefixes.keys():
        where = next(token.start for token in found if token.text.startswith(f"{name}:"))
        raise Problem(400, f"The prefix {name}: at {place(text, where)} is not declared.")
    head = "".join(f"@prefix {name}: <{prefixes[name]}> ." for name in sorted(used))
    pieces = [_Piece(head, found[0].start), *_as_trig(found, text)]
    try:
        quads = list(parse("".join(piece.text for piece in pieces), RdfFormat.TRIG, base_iri=base))
    except SyntaxError as error:
        at = place(text, _origin(pieces, error.lineno or 1, error.offset or 1))
        words = error.msg.partition(": ")[2] or error.msg
        raise Problem(400, f"The quads at {at} cannot be read: {words}.") from error
    except ValueError as error:
        raise Problem(400, f"The quads at {place(text, found[0].start)} cannot be read: {error}.") from error
    return tuple(map(_quad, quads))


class _Piece(NamedTuple):
    """A piece of TriG, and where in the update it comes from."""

    text: str
    at: int


def _origin(pieces: Sequence[_Piece], line: int, column: int) -> int:
    """Where that stands in the update which is at a line and a column, both from 1, of the pieces joined."""
    lines = "".join(piece.text for piece in pieces).split("\n")
    rest = sum(len(each) + 1 for each in lines[: line - 1]) + column - 1
    for piece in pieces:
        if rest < len(piece.text):
            return piece.at
        rest -= len(piece.text)
    return pieces[-1].at


def _as_trig(found: Sequence[Token], text: str) -> Iterator[_Piece]:
    """The block as TriG, its tokens a blank apart where they were."""
    depth, ended = 0, True
    before: Token | None = None
    graph = 0
    """Tokens of a GRAPH clause still to come: its name and its brace."""
    for token in found:
        _check(token, before, text, graph)
        if before is not None and before.end != token.start:
            yield _Piece(" ", token.start)
        if graph:
            graph -= 1
            depth += graph == 0
        elif token.is_mark(*_OPEN):
            depth += 1
        elif token.is_mark(*_CLOSE):
            depth -= 1
        if token.is_word("GRAPH"):
            if depth:
                raise _misplaced(token, text)
            if not ended:
                yield _Piece(" . ", token.start)
            graph = 2
        if depth == 0 and token.is_mark("}"):
            ended = True
        elif depth == 0 and token.is_mark(".") and ended:
            if before is None or not before.is_mark("}"):
                raise _misplaced(token, text)
            before = token  # a full stop after a graph, which TriG has not
            continue
        else:
            ended = token.is_mark(".")
        yield _Piece(_written(token), token.start)
        before = token
    if graph or depth:
        raise _misplaced(found[-1], text)
    if not ended:
        yield _Piece(" .", found[-1].end)


def _check(token: Token, before: Token | None, text: str, graph: int) -> None:
    """Refuse what TriG would take and SPARQL has not."""
    if graph == 2 and token.kind not in (Kind.IRI, Kind.NAME, Kind.VARIABLE):
        raise _misplaced(token, text)
    if (token.is_mark("{") is False and graph == 1) or (token.is_mark("{") and graph != 1):
        raise _misplaced(token, text)
    if token.kind is Kind.WORD and not graph and token.text.upper() not in _WORDS and not token.is_word("GRAPH"):
        raise _misplaced(token, text)
    if token.text == "A":
        raise _misplaced(token, text)
    if token.kind is Kind.LANGUAGE and (before is None or before.kind is not Kind.STRING):
        raise _misplaced(token, text)
    if token.kind is Kind.VARIABLE and before is not None and before.is_mark("^^"):
        raise _misplaced(token, text)


def _misplaced(token: Token, text: str) -> Problem:
    return Problem(400, f"{token.text} at {place(text, token.start)} cannot stand in a block of quads.")


def _written(token: Token) -> str:
    if token.kind is Kind.VARIABLE:
        return f"<{_HOLE}{token.text[1:]}>"
    if token.kind is Kind.WORD and token.text.upper() in ("TRUE", "FALSE"):
        return token.text.lower()
    return token.text


def _quad(quad: Quad) -> QuadTemplate:
    graph = quad.graph_name
    named = None if isinstance(graph, DefaultGraph) else _slot(graph)
    if isinstance(named, BlankNode) or isinstance(quad.subject, Triple) or isinstance(quad.object, Triple):
        raise Problem(400, "Triples about triples, and graphs without a name, are not known here.")
    return QuadTemplate(_slot(quad.subject), _slot(quad.predicate), _slot(quad.object), named)  # type: ignore[arg-type]


def _slot(term: object) -> Slot:
    if isinstance(term, NamedNode) and term.value.startswith(_HOLE):
        return Hole(term.value.removeprefix(_HOLE))
    return term  # type: ignore[return-value]


def holes_of(quads: Sequence[QuadTemplate]) -> tuple[str, ...]:
    """The names of the holes, each once."""
    return tuple(dict.fromkeys(slot.name for quad in quads for slot in quad if isinstance(slot, Hole)))


def has_blank_nodes(quads: Sequence[QuadTemplate]) -> bool:
    """Whether a blank node stands in them."""
    return any(isinstance(slot, BlankNode) for quad in quads for slot in quad)
