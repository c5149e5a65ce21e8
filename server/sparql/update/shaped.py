"""Updates of one shape: those that differ in their literals alone are read once.

Who moves a robot sends much the same update again and again, with other numbers. So the literals are cut out of the
text; what is left is read with other literals in their places, once, and the update's own are put into what was read.
"""

from __future__ import annotations

import re
import secrets
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

from pyoxigraph import Literal

from rosld.server.http.problem import Problem
from rosld.server.sparql.lexer import Bounds
from rosld.server.sparql.protocol import UpdateRequest
from rosld.server.sparql.update.operations import Home, Modify, Operation, QuadTemplate, Where
from rosld.server.sparql.update.reading import read_update
from rosld.server.sparql.update.templates import has_blank_nodes

_LONGEST = 8 * 1024
"""Characters of an update that is worth keeping the shape of."""
_MOST_LITERALS = 32
_KEPT = 256
_UNUSUAL = r"\\\x00-\x1f\x7f\ufdd0-\ufdef\ufffe\uffff"
_PART = re.compile(
    rf"(?P<string>'[^'{_UNUSUAL}]*'(?!')|\"[^\"{_UNUSUAL}]*\"(?!\"))"
    r"|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][+-]?[0-9]+|[0-9]*\.[0-9]+|[0-9]+)"
    r"|<[^\x00-\x20<>\"{}|^`\\]*>"
    r"|[A-Za-z_?$:@][A-Za-z0-9_?$:@.%/|*+!=&^-]*"
    r"|[ \t\r\n{}()\[\],;.*/|+!=&^-]"
)
"""Pieces as the lexer cuts them, or several of its tokens at once. What is cut otherwise (comments, comparisons,

escapes, whatever is not ASCII outside of strings) matches nowhere.
"""
_WORD = f"w{secrets.token_hex(12)}w"
_NUMBER = f"7{secrets.randbelow(10**20):020d}"


class _Shape(NamedTuple):
    """A text with placeholders in the place of its literals, which are `found` as they stood there."""

    text: str
    found: tuple[str, ...]
    places: tuple[str, ...]


def _shape(text: str) -> _Shape | None:
    """The shape of a text, None where it is not worth having, or not plain."""
    if len(text) > _LONGEST:
        return None
    pieces: list[str] = []
    found: list[str] = []
    places: list[str] = []
    at = 0
    for match in _PART.finditer(text):
        if match.start() != at:
            return None
        at = match.end()
        piece = match[0]
        if match.lastgroup is not None:
            place = _place(piece, len(found))
            found.append(piece)
            places.append(place)
            piece = place
        pieces.append(piece)
    if at != len(text) or not 0 < len(found) <= _MOST_LITERALS:
        return None
    return _Shape("".join(pieces), tuple(found), tuple(places))


def _place(literal: str, number: int) -> str:
    """What stands for a literal: one of the same kind that occurs nowhere else."""
    if literal[0] in "\"'":
        return f"{literal[0]}{_WORD}{number:03d}{literal[0]}"
    if "e" in literal or "E" in literal:
        return f"{_NUMBER}{number:03d}e0"
    return f"{_NUMBER}{number:03d}.5" if "." in literal else f"{_NUMBER}{number:03d}"


class Reader:
    """Reads updates as `read_update` does. `prefixes`, `base` and `bounds` are those of all of them."""

    def __init__(self, prefixes: Mapping[str, str], base: str, bounds: Bounds) -> None:
        self._prefixes = prefixes
        self._base = base
        self._bounds = bounds
        self._kept = lru_cache(maxsize=_KEPT)(self._read)

    def read(self, request: UpdateRequest) -> tuple[Operation, ...]:
        """The operations of an update. Raises Problems, as `read_update` does."""
        shape = _shape(request.text) if len(request.text) <= self._bounds.size else None
        if shape is not None:
            known = self._kept(replace(request, text=shape.text))
            if known is not None:
                return tuple(_filled(each, shape) for each in known)
        return read_update(request, self._prefixes, self._base, self._bounds)

    def _read(self, request: UpdateRequest) -> tuple[Modify, ...] | None:
        """What has this shape; None where that must be read each time: a Problem tells of the text that was sent."""
        try:
            operations = read_update(request, self._prefixes, self._base, self._bounds)
        except Problem:
            return None
        modifies = tuple(each for each in operations if isinstance(each, Modify))
        if len(modifies) < len(operations) or any(has_blank_nodes((*each.deletes, *each.inserts)) for each in modifies):
            return None
        return modifies


def _filled(operation: Modify, shape: _Shape) -> Modify:
    values = {_bare(place): _bare(literal) for place, literal in zip(shape.places, shape.found, strict=True)}
    return Modify(
        _with_values(operation.deletes, values),
        _with_values(operation.inserts, values),
        None if operation.where is None else _where(operation.where, shape),
    )


def _bare(literal: str) -> str:
    return literal[1:-1] if literal[0] in "\"'" else literal


def _with_values(quads: tuple[QuadTemplate, ...], values: Mapping[str, str]) -> tuple[QuadTemplate, ...]:
    return tuple(
        quad._replace(object=_literal(quad.object, values)) if isinstance(quad.object, Literal) else quad
        for quad in quads
    )


def _literal(literal: Literal, values: Mapping[str, str]) -> Literal:
    place = literal.value
    sign = place[:1] if place[:1] in ("+", "-") else ""
    value = values.get(place[len(sign) :])
    if value is None:
        return literal
    if literal.language is not None:
        return Literal(sign + value, language=literal.language)
    return Literal(sign + value, datatype=literal.datatype)


def _where(where: Where, shape: _Shape) -> Where:
    home = where.home and Home(where.home.graph, _written(where.home.query, shape))
    return replace(where, query=_written(where.query, shape), home=home)


def _written(text: str, shape: _Shape) -> str:
    if _WORD in text or _NUMBER in text:
        for place, literal in zip(shape.places, shape.found, strict=True):
            text = text.replace(place, literal)
    return text
