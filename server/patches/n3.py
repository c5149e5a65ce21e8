"""Statements and formulae of Notation3, in which patches are written."""

# The names are those of rdflib's parser.
# ruff: noqa: N802

from __future__ import annotations

from typing import NamedTuple, NoReturn, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode


class RefusedSyntax(Exception):
    """Syntax of N3 that patches do not support."""


class Variable(NamedTuple):
    """A variable by its name, without the question mark."""

    name: str

    def __str__(self) -> str:
        return f"?{self.name}"


class Formula:
    """Contents of braces, or of the document: statements in order. Equal only to itself."""

    def __init__(self) -> None:
        self.statements: list[Statement] = []
        self.existentials: dict[str, Node] = {}

    def close(self) -> Formula:
        """Return the formula itself, as a term."""
        return self

    def newUniversal(self, name: str, why: object = None) -> NoReturn:
        """Raise an error: variables are written `?name` only."""
        raise RefusedSyntax("@forAll is not supported: write ?variables")

    def declareExistential(self, name: str) -> NoReturn:
        """Raise an error: blank nodes are written `_:name` or `[]` only."""
        raise RefusedSyntax("@forSome is not supported: write blank nodes")


Node: TypeAlias = "NamedNode | BlankNode | Literal | Variable | Formula"


class Statement(NamedTuple):
    """A statement. In N3, any term can have any position."""

    subject: Node
    predicate: Node
    object: Node
