"""Notation3 as patches are written in: statements and formulae."""

# The parser's names.
# ruff: noqa: N802

from __future__ import annotations

from typing import NamedTuple, NoReturn, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode


class RefusedSyntax(Exception):
    """Something that N3 has and patches do not."""


class Variable(NamedTuple):
    """A variable by its name, without the question mark."""

    name: str

    def __str__(self) -> str:
        return f"?{self.name}"


class Formula:
    """Content of braces, or of the whole document: its statements in order. Equal only to itself."""

    def __init__(self) -> None:
        self.statements: list[Statement] = []
        self.existentials: dict[str, Node] = {}

    def close(self) -> Formula:
        """The term that it is."""
        return self

    def newUniversal(self, name: str, why: object = None) -> NoReturn:
        """Raise an error: variables are written `?name` only."""
        raise RefusedSyntax("@forAll is not read here: write ?variables")

    def declareExistential(self, name: str) -> NoReturn:
        """Raise an error: blank nodes are written `_:name` or `[]` only."""
        raise RefusedSyntax("@forSome is not read here: write blank nodes")


Node: TypeAlias = "NamedNode | BlankNode | Literal | Variable | Formula"


class Statement(NamedTuple):
    """One statement. In N3, any term can have any position."""

    subject: Node
    predicate: Node
    object: Node
